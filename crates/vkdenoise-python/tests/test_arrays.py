"""Where samples may lie, on the way in and out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy
import pytest
from conftest import HEIGHT, WIDTH, Planes, assert_same_bits

import vkdenoise


def structured(plane: numpy.ndarray) -> numpy.ndarray:
    """Samples in records of a size that is no whole number of them."""
    records = numpy.zeros(plane.shape, numpy.dtype([("tag", "u1"), ("value", plane.dtype)]))
    records["value"] = plane
    return records["value"]


def misaligned(plane: numpy.ndarray) -> numpy.ndarray:
    raw = numpy.zeros(plane.nbytes + 1, numpy.uint8)
    view = raw[1:].view(plane.dtype).reshape(plane.shape)
    view[...] = plane
    return view


def planar(plane: numpy.ndarray) -> numpy.ndarray:
    return numpy.moveaxis(numpy.ascontiguousarray(numpy.moveaxis(plane, -1, 0)), 0, -1)


def wider(plane: numpy.ndarray) -> numpy.ndarray:
    """Every second column of rows with something beside them."""
    wide = numpy.full((plane.shape[0], 2 * plane.shape[1] + 5, *plane.shape[2:]), numpy.nan, plane.dtype)
    view = wide[:, 3:-2:2]
    view[...] = plane
    return view


def backwards(plane: numpy.ndarray) -> numpy.ndarray:
    return numpy.ascontiguousarray(plane[::-1, ::-1])[::-1, ::-1]


FORMS: list[Callable[[numpy.ndarray], numpy.ndarray]] = [
    numpy.asfortranarray,
    planar,
    wider,
    backwards,
    structured,
    misaligned,
]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_any_strides_are_read(
    denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray, form: Callable[[numpy.ndarray], numpy.ndarray]
) -> None:
    laid = {name: form(plane) for name, plane in planes.items()}
    assert all(numpy.array_equal(laid[name], plane) for name, plane in planes.items())
    assert not laid["color"].flags.c_contiguous or not laid["color"].flags.aligned
    assert_same_bits(denoiser.denoise(**laid), clean)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_any_strides_are_written(
    denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray, form: Callable[[numpy.ndarray], numpy.ndarray]
) -> None:
    out = form(numpy.zeros_like(clean))
    assert denoiser.denoise(**planes, out=out) is out
    assert_same_bits(out.copy(order="C"), clean)


def test_nothing_beside_the_pixels_is_written(
    denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray
) -> None:
    whole = numpy.full((HEIGHT + 4, 2 * WIDTH + 6, 5), 7, numpy.float32)
    place = numpy.s_[2:-2, 3:-3:2, 1:4]
    denoiser.denoise(**planes, out=whole[place])
    wanted = numpy.full_like(whole, 7)
    wanted[place] = clean
    assert_same_bits(whole, wanted)


def test_one_array_of_all_channels(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    """As renderers give it."""
    joined = numpy.concatenate(
        [planes["color"], planes["albedo"], planes["normal"], planes["depth"][..., None]], axis=2
    )
    color, albedo, normal, depth = joined[..., :3], joined[..., 3:6], joined[..., 6:9], joined[..., 9:]
    assert_same_bits(denoiser.denoise(color, albedo, normal, depth), clean)
    assert_same_bits(denoiser.denoise(color, albedo, normal, joined[..., 9]), clean)


def test_broadcast_planes(denoiser: vkdenoise.Denoiser, planes: Planes) -> None:
    one = numpy.broadcast_to(numpy.float32([0.5, 0.5, 0.25]), (HEIGHT, WIDTH, 3))
    far = numpy.broadcast_to(numpy.float32(4), (HEIGHT, WIDTH))
    wanted = denoiser.denoise(planes["color"], albedo=one.copy(), depth=far.copy())
    assert_same_bits(denoiser.denoise(planes["color"], albedo=one, depth=far), wanted)


def test_axes_of_one(denoiser: vkdenoise.Denoiser) -> None:
    """numpy may give such an axis any stride."""
    for shape in [(1, 1, 3), (1, 9, 3), (9, 1, 3)]:
        color = numpy.random.default_rng(1).random(shape, numpy.float32)
        wanted = denoiser.denoise(color)
        odd = numpy.lib.stride_tricks.as_strided(
            color, shape, [-6 if size == 1 else stride for size, stride in zip(shape, color.strides)]
        )
        assert_same_bits(denoiser.denoise(odd), wanted)


def test_in_place(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    color = planes["color"].copy()
    assert denoiser.denoise(**{**planes, "color": color}, out=color) is color
    assert_same_bits(color, clean)


def test_in_place_with_alpha(denoiser: vkdenoise.Denoiser, planes: Planes) -> None:
    """Alpha, and where nothing is, are of the colour as it was."""
    color = numpy.concatenate([planes["color"], numpy.ones((HEIGHT, WIDTH, 1), numpy.float32)], axis=2)
    color[4:12, 6:30] = 0
    wanted = denoiser.denoise(**{**planes, "color": color})
    both = numpy.zeros((HEIGHT + 3, WIDTH, 4), numpy.float32)
    both[3:] = color
    denoiser.denoise(**{**planes, "color": both[3:]}, out=both[:-3])
    assert_same_bits(both[:-3], wanted)
    denoiser.denoise(**{**planes, "color": color}, out=color)
    assert_same_bits(color, wanted)


def test_out_that_overlaps_a_plane(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    both = numpy.zeros((HEIGHT + 3, WIDTH, 3), numpy.float32)
    both[3:] = planes["color"]
    denoiser.denoise(**{**planes, "color": both[3:]}, out=both[:-3])
    assert_same_bits(both[:-3], clean)
    albedo = planes["albedo"].copy()
    denoiser.denoise(**{**planes, "albedo": albedo}, out=albedo)
    assert_same_bits(albedo, clean)


def test_a_region_of_an_out_that_is_copied(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    out = backwards(numpy.full_like(clean, 7))
    denoiser.denoise(**planes, out=out, region=(4, 6, 20, 12))
    wanted = numpy.full_like(clean, 7)
    wanted[6:18, 4:24] = clean[6:18, 4:24]
    assert_same_bits(out.copy(order="C"), wanted)


def test_sample_types_may_differ(denoiser: vkdenoise.Denoiser, planes: Planes) -> None:
    halves = {name: plane.astype(numpy.float16) for name, plane in planes.items()}
    widened = {name: plane.astype(numpy.float32) for name, plane in halves.items()}
    wanted = denoiser.denoise(**widened)
    assert_same_bits(denoiser.denoise(**{**halves, "color": widened["color"]}), wanted)
    out = numpy.zeros_like(wanted)
    assert_same_bits(denoiser.denoise(**halves, out=out), wanted)
    assert_same_bits(denoiser.denoise(**halves), wanted.astype(numpy.float16))


def test_halves_stop_at_the_largest(denoiser: vkdenoise.Denoiser) -> None:
    color = numpy.full((16, 16, 3), 1e6, numpy.float32)
    found = denoiser.denoise(color, out=numpy.zeros(color.shape, numpy.float16))
    assert (found == 65504).all()


class OnlyDLPack:
    """A tensor of a library that numpy knows nothing of."""

    def __init__(self, array: numpy.ndarray) -> None:
        self.array = array

    def __dlpack__(self, **keywords: Any) -> Any:
        return self.array.__dlpack__(**keywords)

    def __dlpack_device__(self) -> tuple[Any, int]:
        return self.array.__dlpack_device__()


def test_dlpack_in_and_out(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    tensors = {name: OnlyDLPack(plane) for name, plane in planes.items()}
    found = denoiser.denoise(**tensors)
    assert type(found) is numpy.ndarray
    assert_same_bits(found, clean)
    out = OnlyDLPack(planar(numpy.zeros_like(clean)))
    if not numpy.from_dlpack(out).flags.writeable:
        pytest.skip("numpy before 2.1 takes everything of DLPack's for read-only")
    assert denoiser.denoise(**tensors, out=out) is out
    assert_same_bits(out.array.copy(order="C"), clean)


def test_tensors_that_are_written(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    """As torch's, whose DLPack may not say that they can be: numpy takes them for read-only."""

    class Older(OnlyDLPack):
        def __dlpack__(self, **keywords: Any) -> Any:
            return self.array.__dlpack__()

    tensor = Older(numpy.zeros_like(clean))
    assert not numpy.from_dlpack(tensor).flags.writeable
    with pytest.raises(ValueError, match="out is read-only"):
        denoiser.denoise(**planes, out=tensor)

    class OlderArray(Older):
        def __array__(self, dtype: Any = None, copy: bool | None = None) -> numpy.ndarray:
            return self.array

    tensor = OlderArray(numpy.zeros_like(clean))
    assert denoiser.denoise(**planes, out=tensor) is tensor
    assert_same_bits(tensor.array, clean)


def test_dlpack_elsewhere_is_refused(denoiser: vkdenoise.Denoiser, planes: Planes) -> None:
    class OnGpu(OnlyDLPack):
        def __dlpack_device__(self) -> tuple[Any, int]:
            return (2, 0)

        def __dlpack__(self, **keywords: Any) -> Any:
            raise AssertionError("nothing of it is to be read")

    with pytest.raises(
        ValueError, match=r"albedo is not in the CPU's memory \(DLPack device type 2\).*albedo\.cpu\(\)"
    ):
        denoiser.denoise(planes["color"], albedo=OnGpu(planes["albedo"]))


def test_dlpack_that_fails_says_which(denoiser: vkdenoise.Denoiser, planes: Planes) -> None:
    class Fails(OnlyDLPack):
        def __dlpack__(self, **keywords: Any) -> Any:
            raise BufferError("it requires a gradient")

    with pytest.raises(TypeError, match="numpy cannot view normal: it requires a gradient") as raised:
        denoiser.denoise(planes["color"], normal=Fails(planes["normal"]))
    assert isinstance(raised.value.__cause__, BufferError)


def test_tensors_of_jax(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    tensors = {name: jax.numpy.asarray(plane) for name, plane in planes.items()}
    assert_same_bits(denoiser.denoise(**tensors), clean)
    with pytest.raises(TypeError, match="color"):
        denoiser.denoise(tensors["color"].astype(jax.numpy.bfloat16))
    # What jax holds never changes.
    with pytest.raises(ValueError, match="out is read-only"):
        denoiser.denoise(**tensors, out=tensors["color"])


def test_the_buffer_protocol(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    views = {name: memoryview(plane) for name, plane in planes.items()}
    assert_same_bits(denoiser.denoise(**views), clean)
    raw = bytearray(clean.nbytes)
    denoiser.denoise(**planes, out=memoryview(raw).cast("f", clean.shape))
    assert raw == clean.tobytes()


def test_what_makes_itself_an_array(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    class Image:
        def __array__(self, dtype: Any = None, copy: bool | None = None) -> numpy.ndarray:
            return planes["color"]

    assert_same_bits(denoiser.denoise(**{**planes, "color": Image()}), clean)


def test_inputs_are_left_as_they_are(denoiser: vkdenoise.Denoiser, planes: Planes) -> None:
    copies = {name: plane.copy() for name, plane in planes.items()}
    for plane in copies.values():
        plane.flags.writeable = False
    denoiser.denoise(**copies)
    for name, plane in planes.items():
        assert_same_bits(copies[name], plane)
