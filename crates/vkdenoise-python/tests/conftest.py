"""What the tests share: a frame, its denoiser, the command line."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy
import OpenEXR
import pytest

import vkdenoise

HEIGHT, WIDTH = 40, 56
Planes = dict[str, Any]


@pytest.fixture(scope="session")
def planes() -> Planes:
    """A noisy frame with its features, in float32: a disc before a wall, lit from the left."""
    random = numpy.random.default_rng(22)
    y, x = numpy.mgrid[0:HEIGHT, 0:WIDTH].astype(numpy.float32)
    disc = ((x - 20) ** 2 + (y - 18) ** 2 < 150)[..., None]
    albedo = numpy.where(disc, (0.8, 0.2, 0.1), (0.4, 0.5, 0.6))
    normal = numpy.where(disc, (0.0, 0.6, 0.8), (0.0, 0.0, 1.0))
    depth = numpy.where(disc[..., 0], 3.0, 5.0)
    light = numpy.linspace(2.0, 0.2, WIDTH)[None, :, None]
    color = albedo * light * random.gamma(1.5, 1 / 1.5, (HEIGHT, WIDTH, 1))
    made = {"color": color, "albedo": albedo, "normal": normal, "depth": depth}
    return {name: numpy.ascontiguousarray(plane, numpy.float32) for name, plane in made.items()}


@pytest.fixture(scope="session")
def denoiser() -> vkdenoise.Denoiser:
    return vkdenoise.Denoiser()


@pytest.fixture(scope="session")
def clean(denoiser: vkdenoise.Denoiser, planes: Planes) -> numpy.ndarray:
    """The frame denoised, from dense arrays."""
    return denoiser.denoise(**planes)


def write_exr(path: Path, planes: Planes) -> None:
    """Colour (with alpha where it has one) and features, under names that the command line finds."""
    color = planes["color"]
    channels = {name: color[..., i] for i, name in enumerate("RGBA"[: color.shape[2]])}
    for name, axes in {"albedo": "RGB", "normal": "XYZ"}.items():
        if name in planes:
            channels |= {f"{name}.{axis}": planes[name][..., i] for i, axis in enumerate(axes)}
    if "depth" in planes:
        channels["Z"] = planes["depth"]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    dense = {name: numpy.ascontiguousarray(channel) for name, channel in channels.items()}
    OpenEXR.File(header, dense).write(str(path))


def read_exr(path: Path, names: list[str]) -> numpy.ndarray:
    """Channels side by side."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return numpy.stack([channels[name].pixels for name in names], axis=-1)


@pytest.fixture(scope="session")
def command_line(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., numpy.ndarray]:
    """Denoises planes by the command line, with its arguments."""
    program = os.environ.get("VKDENOISE_CLI") or shutil.which("vkdenoise")
    if not program:
        pytest.fail("build the command line (cargo build --release --bin vkdenoise) and name it in VKDENOISE_CLI")

    def run(planes: Planes, *arguments: str) -> numpy.ndarray:
        folder = tmp_path_factory.mktemp("exr")
        write_exr(folder / "in.exr", planes)
        command = [program, str(folder / "in.exr"), "-o", str(folder / "out.exr"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return read_exr(folder / "out.exr", list("RGBA"[: planes["color"].shape[2]]))

    return run


def assert_same_bits(found: numpy.ndarray, wanted: numpy.ndarray) -> None:
    assert found.dtype == wanted.dtype
    assert found.shape == wanted.shape
    differ = found.view(f"u{found.itemsize}") != wanted.view(f"u{wanted.itemsize}")
    assert not differ.any(), (
        f"{differ.sum()} of {differ.size} samples differ, the first at {tuple(numpy.argwhere(differ)[0])}"
    )
