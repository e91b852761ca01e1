"""Wrong use: which exception, what it says, and that nothing was written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy
import pytest
from conftest import HEIGHT, WIDTH, Planes

import vkdenoise

F = numpy.float32


def zeros(*shape: int, dtype: Any = F) -> numpy.ndarray:
    return numpy.zeros(shape, dtype)


@pytest.mark.parametrize(
    ("planes_of", "message"),
    [
        (
            {"color": zeros(4, 5)},
            "color has shape (4, 5); (height, width, 3) is wanted, or (height, width, 4) with alpha",
        ),
        ({"color": zeros(4)}, "color has shape (4,); (height, width, 3)"),
        ({"color": zeros(4, 5, 2)}, "color has shape (4, 5, 2)"),
        ({"color": zeros(4, 5, 5)}, "color has shape (4, 5, 5)"),
        ({"color": zeros(2, 4, 5, 3)}, "color has shape (2, 4, 5, 3)"),
        ({"color": zeros(3, 4, 5)}, "numpy.moveaxis(color, 0, -1) brings its channels last"),
        ({"color": zeros(0, 5, 3)}, "color has shape (0, 5, 3)"),
        ({"color": zeros(4, 0, 3)}, "color has shape (4, 0, 3)"),
        (
            {"albedo": zeros(5, 4, 3)},
            "albedo has shape (5, 4, 3); (4, 5, 3) is wanted, as color has 4 rows of 5 pixels",
        ),
        ({"albedo": zeros(4, 5)}, "albedo has shape (4, 5); (4, 5, 3) is wanted"),
        ({"normal": zeros(4, 5, 4)}, "normal[..., :3] has the first three of its channels"),
        (
            {"depth": zeros(5, 4)},
            "depth has shape (5, 4); (4, 5) is wanted, or (4, 5, 1), as color has 4 rows of 5 pixels",
        ),
        ({"depth": zeros(4, 5, 3)}, "depth has shape (4, 5, 3)"),
        ({"variance": zeros(4, 5, 3)}, "variance has shape (4, 5, 3)"),
        ({"samples": zeros(4)}, "samples has shape (4,)"),
        ({"samples": zeros(4, 5), "variance": zeros(4, 5)}, "both variance and samples are given"),
        ({"out": zeros(4, 5, 4)}, "out has shape (4, 5, 4); color's, (4, 5, 3), is wanted"),
        ({"out": numpy.broadcast_to(F(1), (4, 5, 3))}, "out is read-only"),
        ({"exposure": 0.0}, "exposure"),
        ({"exposure": float("nan")}, "exposure"),
        ({"fireflies": "shoot"}, "'shoot'; it can be"),
        ({"region": (0, 0, 6, 4)}, "it must have pixels and lie within the frame of 5 x 4"),
        ({"region": (0, 0, 0, 4)}, "it must have pixels"),
        ({"region": (-1, 0, 2, 2)}, "region is [-1, 0, 2, 2]; give (x, y, width, height)"),
        ({"features_unchanged": True}, "features_unchanged"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_values_that_cannot_be(denoiser: vkdenoise.Denoiser, planes_of: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        denoiser.denoise(**{"color": zeros(4, 5, 3), **planes_of})
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("plane", "dtype"),
    [
        ("color", "f8"),
        ("color", "u1"),
        ("albedo", "f8"),
        ("normal", "i4"),
        ("depth", ">f4"),
        ("out", "f8"),
        ("color", "O"),
    ],
)
def test_types_that_cannot_be(denoiser: vkdenoise.Denoiser, plane: str, dtype: str) -> None:
    planes = {"color": zeros(4, 5, 3), plane: zeros(4, 5, 3, dtype=dtype)}
    with pytest.raises(TypeError) as raised:
        denoiser.denoise(**planes)
    named = numpy.dtype(dtype)
    assert f"{plane} has dtype {named}; float32 or float16 is wanted, as {plane}.astype(numpy.float32)" in str(
        raised.value
    )


def test_what_is_no_array(denoiser: vkdenoise.Denoiser) -> None:
    for thing in ["frame.exr", None, [[[1.0, 2.0, 3.0]]], object(), 3]:
        with pytest.raises(TypeError, match="color has dtype"):
            denoiser.denoise(thing)


def test_an_out_whose_pixels_are_one(denoiser: vkdenoise.Denoiser) -> None:
    out = numpy.lib.stride_tricks.as_strided(zeros(5, 3), (4, 5, 3), (0, 12, 4))
    with pytest.raises(ValueError, match="out is broadcast"):
        denoiser.denoise(zeros(4, 5, 3), out=out)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"quality": "best"}, "'best'; it can be fast, balanced or high"),
        ({"precision": "fp8"}, "'fp8'; it can be auto, fp32, fp16 or matrix"),
        ({"skip_mode": "half"}, "'half'; it can be exact or approximate"),
        ({"skip_below": -1.0}, "must be a number above 0"),
        ({"blend": 1.5}, "blend"),
        ({"device": -1}, "device is -1; an index of devices() is 0 or above"),
    ],
)
def test_options_that_cannot_be(keywords: dict[str, Any], message: str) -> None:
    for make in (vkdenoise.Denoiser, lambda **options: vkdenoise.denoise(zeros(4, 5, 3), **options)):
        with pytest.raises(ValueError) as raised:
            make(**keywords)
        assert message in str(raised.value)


def test_wrong_keywords(denoiser: vkdenoise.Denoiser) -> None:
    for keywords in [
        {"exposure": "auto"},
        {"region": 3},
        {"region": (1, 2, 3)},
        {"fireflies": 1},
        {"aov": zeros(4, 5, 3)},
    ]:
        with pytest.raises((TypeError, ValueError)):
            denoiser.denoise(zeros(4, 5, 3), **keywords)
    with pytest.raises(TypeError):
        vkdenoise.Denoiser("balanced")


def test_devices_that_are_not_there() -> None:
    assert issubclass(vkdenoise.DeviceLostError, vkdenoise.DeviceError) and issubclass(
        vkdenoise.DeviceError, RuntimeError
    )
    for device in [99, "voodoo"]:
        with pytest.raises(vkdenoise.DeviceError, match=f"no Vulkan device matches '{device}'; there are: 0: "):
            vkdenoise.Denoiser(device=device)


def test_without_a_driver() -> None:
    program = (
        "import vkdenoise, numpy\nassert vkdenoise.devices() == []\nvkdenoise.denoise(numpy.zeros((4, 4, 3), 'f4'))"
    )
    nothing = {**os.environ, "VK_DRIVER_FILES": "/nowhere.json", "VK_ICD_FILENAMES": "/nowhere.json"}
    done = subprocess.run([sys.executable, "-c", program], env=nothing, capture_output=True, text=True)
    assert "vkdenoise.DeviceError: no usable Vulkan device" in done.stderr


def test_the_environment_chooses_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VKDENOISE_DEVICE", "voodoo")
    with pytest.raises(vkdenoise.DeviceError, match="voodoo"):
        vkdenoise.denoise(zeros(4, 5, 3))
    assert vkdenoise.denoise(zeros(4, 5, 3), device=0).shape == (4, 5, 3)


def test_weights_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="cannot read the weights .*absent.safetensors"):
        vkdenoise.Denoiser(weights=tmp_path / "absent.safetensors")
    (tmp_path / "damaged.safetensors").write_bytes(b"nothing of the kind")
    with pytest.raises(ValueError, match="not a sound safetensors file"):
        vkdenoise.Denoiser(weights=str(tmp_path / "damaged.safetensors"))


def test_a_frame_beyond_the_budget(planes: Planes) -> None:
    out = numpy.full((HEIGHT, WIDTH, 3), 7, F)
    with pytest.raises(MemoryError, match="the budget is 1000000: raise the budget"):
        vkdenoise.denoise(**planes, memory_budget=1_000_000, out=out)
    assert (out == 7).all()


def test_frames_that_fit_nowhere(denoiser: vkdenoise.Denoiser) -> None:
    """Their planes are one number each, broadcast."""
    for shape in [(1 << 20, 1 << 20, 3), (1 << 31, 1 << 20, 3), (1 << 33, 2, 3)]:
        with pytest.raises((MemoryError, ValueError)):
            denoiser.denoise(numpy.broadcast_to(F(1), shape))


def test_a_call_that_failed_changes_nothing(denoiser: vkdenoise.Denoiser, planes: Planes, clean: numpy.ndarray) -> None:
    with pytest.raises(ValueError):
        denoiser.denoise(**planes, exposure=-1.0, region=(0, 0, 8, 8))
    assert numpy.array_equal(denoiser.denoise(**planes), clean)
