"""The numbers: those of the command line, to the bit."""

from __future__ import annotations

from typing import Any

import numpy
import pytest
from conftest import HEIGHT, WIDTH, Planes, assert_same_bits, read_exr

import vkdenoise

OPTIONS: list[tuple[dict[str, Any], list[str]]] = [
    ({}, []),
    ({"quality": "fast"}, ["--quality", "fast"]),
    ({"quality": "high"}, ["--quality", "high"]),
    ({"precision": "fp16"}, ["--precision", "fp16"]),
    ({"exposure": 0.8}, ["--exposure", "0.8"]),
    ({"blend": 0.25}, ["--blend", "0.25"]),
    ({"fireflies": "keep"}, ["--fireflies", "keep"]),
    ({"fireflies": "mend"}, ["--fireflies", "mend"]),
    ({"clean_aux": True}, ["--clean-aux"]),
    ({"skip_below": 0.3, "skip_mode": "exact"}, ["--skip-below", "0.3", "--skip-mode", "exact"]),
    ({"quality": "fast", "skip_below": 0.0}, ["--quality", "fast", "--skip-below", "0"]),
]


@pytest.mark.parametrize(("keywords", "arguments"), OPTIONS, ids=lambda option: str(option))
def test_a_frame_has_the_command_lines_bits(
    planes: Planes, command_line: Any, keywords: dict[str, Any], arguments: list[str]
) -> None:
    planes = dict(planes)
    # A firefly, and squares without noise to skip.
    planes["color"] = planes["color"].copy()
    planes["color"][12, 9] = 4e4
    planes["color"][:, 32:] = 0.5
    assert_same_bits(vkdenoise.denoise(**planes, **keywords), command_line(planes, *arguments))


@pytest.mark.parametrize("absent", [["albedo"], ["normal", "depth"], ["albedo", "normal", "depth"]])
def test_features_may_be_missing(planes: Planes, command_line: Any, absent: list[str]) -> None:
    there = {name: plane for name, plane in planes.items() if name not in absent}
    assert_same_bits(vkdenoise.denoise(**there), command_line(there))


def test_options_change_the_result(planes: Planes, clean: numpy.ndarray) -> None:
    """So that the comparisons above compare something."""
    for keywords in [{"skip_below": 10.0}, {"precision": "fp16"}, {"exposure": 0.8}, {"blend": 0.25}]:
        assert not numpy.array_equal(vkdenoise.denoise(**planes, **keywords), clean), keywords
    assert not numpy.array_equal(vkdenoise.denoise(planes["color"]), clean)


def test_it_denoises(planes: Planes, clean: numpy.ndarray) -> None:
    light = numpy.linspace(2.0, 0.2, WIDTH, dtype=numpy.float32)[None, :, None]
    ideal = planes["albedo"] * light
    before, after = (numpy.mean((image - ideal) ** 2) for image in (planes["color"], clean))
    assert after < before / 10


def test_halves_have_the_command_lines_bits(planes: Planes, command_line: Any) -> None:
    halves = {name: plane.astype(numpy.float16) for name, plane in planes.items()}
    # Background, as far as halves go.
    halves["depth"][:8] = 65504
    found = vkdenoise.denoise(**halves)
    assert found.dtype == numpy.float16
    assert_same_bits(found, command_line(halves))


def test_a_file_of_a_renderer(command_line: Any, pytestconfig: pytest.Config) -> None:
    path = pytestconfig.rootpath.parents[1] / "tests" / "data" / "teapot_spp0004.exr"
    crop = numpy.s_[80:128, 96:160]
    color = read_exr(path, ["R", "G", "B"])[crop]
    albedo = read_exr(path, ["albedo.R", "albedo.G", "albedo.B"])[crop]
    normal = read_exr(path, ["N.X", "N.Y", "N.Z"])[crop]
    depth = read_exr(path, ["Z"])[crop]
    planes = {"color": color, "albedo": albedo, "normal": normal, "depth": depth[..., 0]}
    assert_same_bits(vkdenoise.denoise(color, albedo, normal, depth), command_line(planes))


def test_alpha_is_passed_through(planes: Planes, command_line: Any, clean: numpy.ndarray) -> None:
    alpha = numpy.linspace(0.1, 1, HEIGHT * WIDTH, dtype=numpy.float32).reshape(HEIGHT, WIDTH, 1)
    color = numpy.concatenate([planes["color"], alpha], axis=2)
    found = vkdenoise.denoise(**{**planes, "color": color})
    assert_same_bits(found[..., :3].copy(), clean)
    assert_same_bits(found[..., 3:].copy(), alpha)
    # Outside of a cut-out.
    color[5:9, 7:30] = 0
    found = vkdenoise.denoise(**{**planes, "color": color})
    assert not found[5:9, 7:30].any()
    assert_same_bits(found, command_line({**planes, "color": color}))


def test_a_region_has_the_bits_of_the_whole(planes: Planes, clean: numpy.ndarray, command_line: Any) -> None:
    x, y, width, height = region = (9, 5, 24, 17)
    part = numpy.s_[y : y + height, x : x + width]
    found = vkdenoise.denoise(**planes, region=region)
    wanted = planes["color"].copy()
    wanted[part] = clean[part]
    assert_same_bits(found, wanted)
    arguments = ["--region", ",".join(map(str, region))]
    assert_same_bits(found[part].copy(), command_line(planes, *arguments))
    out = numpy.full_like(clean, 7)
    assert vkdenoise.denoise(**planes, region=list(region), out=out) is out
    wanted[...] = 7
    wanted[part] = clean[part]
    assert_same_bits(out, wanted)


def test_noise_that_is_known(planes: Planes) -> None:
    shape = (HEIGHT, WIDTH)
    settled = vkdenoise.denoise(**planes, skip_below=0.01, variance=numpy.zeros(shape, numpy.float32))
    assert_same_bits(settled, planes["color"])
    many = numpy.full((*shape, 1), 6e4, numpy.float16)
    assert_same_bits(vkdenoise.denoise(**planes, skip_below=0.01, samples=many), planes["color"])
    few = numpy.ones(shape, numpy.float32)
    assert not numpy.array_equal(vkdenoise.denoise(**planes, skip_below=0.01, samples=few), planes["color"])


def test_weights_of_ones_own(planes: Planes, clean: numpy.ndarray, pytestconfig: pytest.Config) -> None:
    folder = pytestconfig.rootpath.parents[1] / "weights"
    assert_same_bits(vkdenoise.denoise(**planes, weights=folder / "hybrid_kernels.safetensors"), clean)
    residual = vkdenoise.denoise(**planes, weights=str(folder / "hybrid.safetensors"))
    assert not numpy.array_equal(residual, clean)
