"""Denoisers that are kept, and what they tell."""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy
import pytest
from conftest import HEIGHT, WIDTH, Planes, assert_same_bits

import vkdenoise


def test_one_denoiser_for_many_frames(planes: Planes, clean: numpy.ndarray) -> None:
    """Options of a call are that call's alone."""
    denoiser = vkdenoise.Denoiser()
    for keywords in [{}, {"exposure": 3.0}, {"fireflies": "mend"}, {"region": (0, 0, 8, 8)}]:
        denoiser.denoise(**planes, **keywords)
        assert_same_bits(denoiser.denoise(**planes), clean)
    small = {name: plane[:16, :24] for name, plane in planes.items()}
    assert denoiser.denoise(**small).shape == (16, 24, 3)
    assert_same_bits(denoiser.denoise(**planes), clean)
    assert_same_bits(denoiser.denoise(planes["color"]), vkdenoise.denoise(planes["color"]))


def test_a_still_camera(planes: Planes, clean: numpy.ndarray) -> None:
    denoiser = vkdenoise.Denoiser(keep_features=True)
    assert_same_bits(denoiser.denoise(**planes), clean)
    again = denoiser.denoise(planes["color"], features_unchanged=True)
    assert_same_bits(again, clean)
    report = denoiser.report
    assert report is not None and report.work < 1
    assert not numpy.array_equal(denoiser.denoise(planes["color"]), clean)


def test_what_a_call_did(planes: Planes) -> None:
    denoiser = vkdenoise.Denoiser()
    assert denoiser.report is None
    first = denoiser.denoise(**planes)
    report = denoiser.report
    assert report is not None
    assert report.exposure > 0 and report.total_ms > 0 and report.work == 1 and report.device_bytes > 1_000_000
    assert report.tiles == 1
    assert report.gpu_ms is None or 0 < report.gpu_ms <= report.total_ms
    assert repr(report).startswith(f"Report(exposure={report.exposure:.3f}"[:20])
    # The first frame's exposure is what the next ones are given.
    assert_same_bits(denoiser.denoise(**planes, exposure=report.exposure), first)
    denoiser.denoise(**planes, region=(0, 0, 8, 8))
    # Of so small a frame it may be all.
    assert denoiser.report is not None and denoiser.report.work <= 1
    assert (denoiser.quality, denoiser.precision) == (
        "balanced",
        "fp32" if denoiser.device.kind == "CPU" else denoiser.precision,
    )
    assert repr(denoiser).startswith('Denoiser(quality="balanced", precision=')
    assert denoiser.device.name in repr(denoiser)


def test_memory_known_beforehand(planes: Planes) -> None:
    denoiser = vkdenoise.Denoiser()
    needed = denoiser.memory_required(HEIGHT, WIDTH)
    assert denoiser.memory_required(2 * HEIGHT, 2 * WIDTH) > needed
    assert vkdenoise.Denoiser(precision="fp16").memory_required(HEIGHT, WIDTH) < needed
    vkdenoise.Denoiser(memory_budget=needed).denoise(**planes)
    with pytest.raises(MemoryError):
        vkdenoise.Denoiser(memory_budget=needed // 4).denoise(**planes)
    with pytest.raises(ValueError, match="empty"):
        denoiser.memory_required(0, 5)


def test_devices_are_those_of_the_command_line() -> None:
    program = os.environ.get("VKDENOISE_CLI") or shutil.which("vkdenoise")
    assert program
    listed = subprocess.run([program, "--list-devices", "--json"], capture_output=True, text=True, check=True).stdout
    found = vkdenoise.devices()
    assert found
    for device, line in zip(found, listed.splitlines(), strict=True):
        row = json.loads(line)
        assert {name: getattr(device, name) for name in row} == row
        assert vkdenoise.Denoiser(device=device.index).device.name == device.name
        assert vkdenoise.Denoiser(device=device.name[:8].lower()).device.index == device.index
        assert device.name in repr(device)
    with pytest.raises(AttributeError):
        found[0].name = "another"


def test_compiled_kernels_are_kept_where_asked(tmp_path: Path, planes: Planes) -> None:
    vkdenoise.Denoiser(cache="off").denoise(**planes)
    denoiser = vkdenoise.Denoiser(cache=tmp_path / "kernels")
    denoiser.denoise(**planes)
    del denoiser
    gc.collect()
    # A driver need not hand them out.
    assert not (tmp_path / "kernels").exists() or list((tmp_path / "kernels").iterdir())


MANY_DENOISERS = """
import ctypes, os, numpy, vkdenoise
color = numpy.random.default_rng(1).random((120, 168, 3), numpy.float32)
resident = []
for _ in range(5):
    denoiser = vkdenoise.Denoiser()
    denoiser.denoise(color)
    needed = denoiser.memory_required(120, 168)
    del denoiser
    # What the C library holds back for the next allocation is not lost.
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/statm") as statm:
        resident.append(int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
assert resident[-1] - resident[1] < needed, (needed, resident)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="where a process's size is read")
def test_memory_goes_with_its_denoiser() -> None:
    """In a process of its own, where nothing else takes memory."""
    subprocess.run([sys.executable, "-c", MANY_DENOISERS], check=True)
