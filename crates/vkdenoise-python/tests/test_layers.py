"""What goes through the kernels of a colour: light groups, other layers, alpha."""

from __future__ import annotations

from typing import Any

import numpy
import pytest
from conftest import HEIGHT, WIDTH, Planes, assert_same_bits

import vkdenoise

Groups = dict[str, numpy.ndarray]


@pytest.fixture(scope="module")
def layered() -> vkdenoise.Denoiser:
    return vkdenoise.Denoiser(signals=True)


@pytest.fixture(scope="module")
def groups(planes: Planes) -> Groups:
    """Three parts of the colour, which is their sum but for rounding."""
    random = numpy.random.default_rng(7)
    key = random.random((HEIGHT, WIDTH, 1), numpy.float32)
    fill = (1 - key) * random.random((HEIGHT, WIDTH, 1), numpy.float32)
    return {name: planes["color"] * share for name, share in {"key": key, "fill": fill, "rim": 1 - key - fill}.items()}


def assert_sum(parts: Groups, whole: numpy.ndarray) -> None:
    total = sum(part.astype(numpy.float64) for part in parts.values())
    largest = numpy.maximum(whole, numpy.max(numpy.abs(list(parts.values())), axis=0))
    assert (numpy.abs(total - whole) <= 1e-5 * largest).all(), numpy.max(numpy.abs(total - whole) / largest)


def test_light_groups_add_up(
    layered: vkdenoise.Denoiser, planes: Planes, groups: Groups, clean: numpy.ndarray
) -> None:
    color, parts = layered.denoise(**planes, light_groups=groups)
    assert_same_bits(color, clean)
    assert list(parts) == list(groups)
    assert all(part.shape == (HEIGHT, WIDTH, 3) and part.dtype == numpy.float32 for part in parts.values())
    assert_sum(parts, color)
    for name, part in parts.items():
        assert numpy.std(part - numpy.roll(part, 1, 1)) < 0.5 * numpy.std(groups[name] - numpy.roll(groups[name], 1, 1))
    # The function makes a denoiser that takes them.
    again, same = vkdenoise.denoise(**planes, light_groups=groups)
    assert_same_bits(again, clean)
    for name, part in parts.items():
        assert_same_bits(same[name], part)


def test_other_layers_keep_their_shapes(layered: vkdenoise.Denoiser, planes: Planes, groups: Groups) -> None:
    random = numpy.random.default_rng(9)
    flat = random.random((HEIGHT, WIDTH), numpy.float32)
    vectors = random.normal(0, 1, (HEIGHT, WIDTH, 3)).astype(numpy.float32)
    aovs = {"mask": flat, "same": flat[..., None], "halves": flat.astype(numpy.float16), "motion": vectors[::-1]}
    clean, found = layered.denoise(**planes, light_groups={"key": groups["key"]}, aovs=aovs)
    assert list(found) == ["key", *aovs]
    for name, layer in aovs.items():
        assert (found[name].shape, found[name].dtype) == (layer.shape, layer.dtype)
    assert_same_bits(found["same"][..., 0].copy(), found["mask"])
    assert numpy.abs(found["halves"].astype(numpy.float32) - found["mask"]).max() < 2e-3
    # Means of what was given, with less noise.
    for name in ("mask", "motion"):
        assert found[name].std() < 0.5 * aovs[name].std()
    # Light is divided by the albedo on its way, values are not.
    _, other = layered.denoise(**planes, aovs={"key": groups["key"]})
    assert not numpy.array_equal(other["key"], found["key"])
    assert_same_bits(layered.denoise(**planes), clean)


def test_none_of_them_is_an_empty_dict(layered: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    for found in (layered.denoise(**planes, aovs={}), vkdenoise.Denoiser().denoise(**planes, aovs={})):
        color, none = found
        assert none == {}
        assert_same_bits(color, clean)


def test_a_region_and_an_out(layered: vkdenoise.Denoiser, planes: Planes, groups: Groups) -> None:
    clean, parts = layered.denoise(**planes, light_groups=groups)
    part = numpy.s_[5:22, 9:33]
    out = planes["color"].copy()
    color, found = layered.denoise(
        out, planes["albedo"], planes["normal"], planes["depth"], light_groups=groups, out=out, region=(9, 5, 24, 17)
    )
    assert color is out
    assert_same_bits(out[part].copy(), clean[part].copy())
    for name, given in groups.items():
        wanted = given.copy()
        wanted[part] = parts[name][part]
        assert_same_bits(found[name], wanted)


def test_an_out_that_is_a_group(layered: vkdenoise.Denoiser, planes: Planes, groups: Groups) -> None:
    clean, parts = layered.denoise(**planes, light_groups=groups)
    shared = groups["fill"].copy()
    color, found = layered.denoise(**planes, light_groups={**groups, "fill": shared}, out=shared)
    assert color is shared
    assert_same_bits(shared, clean)
    assert_same_bits(found["fill"], parts["fill"])


def cutout(planes: Planes) -> Planes:
    """The disc's edge in coverage of four samples, premultiplied; nothing beyond."""
    random = numpy.random.default_rng(4)
    y, x = numpy.mgrid[0:HEIGHT, 0:WIDTH]
    coverage = numpy.clip((28 - numpy.hypot(x - 20, y - 18)) / 16, 0, 1)
    alpha = (random.binomial(4, coverage) / 4).astype(numpy.float32)[..., None]
    return {**planes, "color": numpy.concatenate([planes["color"] * alpha, alpha], axis=2)}


def test_alpha_has_the_command_lines_bits(layered: vkdenoise.Denoiser, planes: Planes, command_line: Any) -> None:
    planes = cutout(planes)
    found = layered.denoise(**planes, alpha="denoise")
    assert_same_bits(found, command_line(planes, "--alpha", "denoise"))
    noisy, alpha = planes["color"][..., 3], found[..., 3]
    assert numpy.std(numpy.diff(alpha)) < 0.5 * numpy.std(numpy.diff(noisy)) and 0 <= alpha.min() <= alpha.max() <= 1
    # Far outside nothing appears; a hole in the edge is filled.
    assert not found[:, 54:].any()
    assert ((noisy == 0) & (alpha > 0)).any()
    kept = layered.denoise(**planes)
    assert_same_bits(kept, layered.denoise(**planes, alpha="keep"))
    assert_same_bits(kept[..., 3].copy(), noisy.copy())
    assert_same_bits(vkdenoise.denoise(**planes, alpha="denoise"), found)


def test_layers_keep_what_is_outside_a_cutout(layered: vkdenoise.Denoiser, planes: Planes) -> None:
    planes = cutout(planes)
    mask = numpy.full((HEIGHT, WIDTH), 0.25, numpy.float32)
    mask[::2] = 0.75
    _, found = layered.denoise(**planes, aovs={"mask": mask}, alpha="denoise")
    assert_same_bits(found["mask"][:, 54:].copy(), mask[:, 54:].copy())
    assert not numpy.array_equal(found["mask"][10:20, 10:20], mask[10:20, 10:20])


def test_cancelled_halfway(layered: vkdenoise.Denoiser, planes: Planes, groups: Groups) -> None:
    out = numpy.full((HEIGHT, WIDTH, 3), 7, numpy.float32)
    with pytest.raises(vkdenoise.Cancelled):
        layered.denoise(**planes, light_groups=groups, out=out, progress=lambda share: share < 0.5)
    assert (out == 7).all()
    clean, parts = layered.denoise(**planes, light_groups=groups)
    assert_sum(parts, clean)


F = numpy.zeros((HEIGHT, WIDTH, 3), numpy.float32)


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"light_groups": {"key": F[..., 0]}}, ValueError, 'light_groups["key"] has shape (40, 56); (40, 56, 3) is'),
        ({"aovs": {"uv": F[..., :2]}}, ValueError, 'aovs["uv"] has shape (40, 56, 2); (40, 56) is wanted, or (40'),
        ({"aovs": {"Z": F[:-1]}}, ValueError, 'aovs["Z"] has shape (39, 56, 3)'),
        ({"aovs": {"Z": F.astype("f8")}}, TypeError, 'aovs["Z"] has dtype float64'),
        ({"aovs": {"a": F}, "light_groups": {"a": F}}, ValueError, '"a" is in both light_groups and aovs'),
        ({"aovs": {3: F}}, TypeError, "aovs has the key 3; a str is wanted"),
        ({"aovs": [F]}, TypeError, "aovs is a list; a dict of names and arrays is wanted"),
        ({"light_groups": F}, TypeError, "light_groups is a ndarray; a dict"),
        ({"alpha": "denoise"}, ValueError, "alpha is 'denoise', and color has none"),
        ({"alpha": "drop"}, ValueError, "alpha is 'drop'; it can be keep or denoise"),
    ],
)
def test_what_is_refused(
    layered: vkdenoise.Denoiser, planes: Planes, keywords: dict[str, Any], error: type[Exception], message: str
) -> None:
    for denoise in (layered.denoise, vkdenoise.denoise):
        with pytest.raises(error) as raised:
            denoise(**planes, **keywords)
        assert message in str(raised.value)


def test_who_takes_them(
    planes: Planes, groups: Groups, denoiser: vkdenoise.Denoiser, pytestconfig: pytest.Config
) -> None:
    with pytest.raises(ValueError, match=r"Denoiser\(signals=True\)"):
        denoiser.denoise(**planes, light_groups=groups)
    residual = pytestconfig.rootpath.parents[1] / "weights" / "hybrid.safetensors"
    for make in (
        lambda: vkdenoise.Denoiser(signals=True, weights=residual),
        lambda: vkdenoise.denoise(**planes, light_groups=groups, weights=residual),
    ):
        with pytest.raises(ValueError, match="predicts no kernels; take the network that ships"):
            make()


def test_not_in_tiles() -> None:
    """A frame that a budget cuts into tiles takes none of them, and without them says how many there were."""
    height, width = 72, 960
    color = numpy.random.default_rng(1).random((height, width, 3), numpy.float32)
    needed = vkdenoise.Denoiser(signals=True).memory_required(height, width)
    denoiser = vkdenoise.Denoiser(signals=True, memory_budget=needed * 9 // 10)
    with pytest.raises(ValueError, match="tiles take no signals"):
        denoiser.denoise(color, aovs={"red": color[..., 0]})
    denoiser.denoise(color)
    assert denoiser.report is not None and denoiser.report.tiles > 1
    assert f"tiles={denoiser.report.tiles}" in repr(denoiser.report)
