"""Threads and processes."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy
import pytest
from conftest import Planes, assert_same_bits

import vkdenoise


def test_other_threads_go_on(planes: Planes) -> None:
    """While a frame is denoised: with the interpreter's lock held, nothing else would run for the whole call."""
    denoiser = vkdenoise.Denoiser()
    color = numpy.tile(planes["color"], (4, 4, 1))
    denoiser.denoise(color)
    times: list[float] = []
    done = threading.Event()

    def tick() -> None:
        while not done.wait(0.001):
            times.append(time.perf_counter())

    ticking = threading.Thread(target=tick)
    ticking.start()
    begin = time.perf_counter()
    denoiser.denoise(color)
    end = time.perf_counter()
    done.set()
    ticking.join()
    # Not at its ends, where the lock changes hands.
    margin = (end - begin) / 10
    within = [tick for tick in times if begin + margin < tick < end - margin]
    assert len(within) >= 5, f"{len(within)} ticks in {end - begin:.3f} s"


def test_threads_share_a_denoiser(planes: Planes) -> None:
    """Each with frames, sizes and options of its own; the results are those of one after another."""
    denoiser = vkdenoise.Denoiser()

    def frame(i: int) -> numpy.ndarray:
        part = numpy.s_[: 16 + 8 * (i % 3)]
        exposure = 0.5 + i % 2
        return denoiser.denoise(*(plane[part] for plane in planes.values()), exposure=exposure)

    wanted = [frame(i) for i in range(6)]
    with ThreadPoolExecutor(4) as pool:
        for found, one in zip(pool.map(frame, range(6)), wanted):
            assert_same_bits(found, one)


def test_threads_call_the_function(planes: Planes, clean: numpy.ndarray) -> None:
    """With options that differ, so that the denoiser behind it changes while others use it."""
    wanted = {quality: vkdenoise.denoise(**planes, quality=quality) for quality in ("balanced", "fast")}
    assert_same_bits(wanted["balanced"], clean)
    qualities = ["balanced", "fast"] * 2
    with ThreadPoolExecutor(2) as pool:
        found = pool.map(lambda quality: vkdenoise.denoise(**planes, quality=quality), qualities)
        for image, quality in zip(found, qualities):
            assert_same_bits(image, wanted[quality])


def test_the_function_keeps_its_denoiser(planes: Planes, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def counted(**options: object) -> vkdenoise.Denoiser:
        made.append(options)
        return vkdenoise._vkdenoise.Denoiser(**options)

    monkeypatch.setattr(vkdenoise, "Denoiser", counted)
    monkeypatch.setattr(vkdenoise, "_last", None)
    for keywords in [{}, {}, {"exposure": 2.0}, {"precision": "fp16"}, {"precision": "fp16"}, {}]:
        vkdenoise.denoise(**planes, **keywords)
    assert [options["precision"] for options in made] == ["auto", "fp16", "auto"]


def test_a_lost_device_is_opened_again(planes: Planes, clean: numpy.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    class Lost:
        def __init__(self, **options: object) -> None:
            pass

        def denoise(self, *planes: object, **options: object) -> None:
            raise vkdenoise.DeviceLostError("the Vulkan device was lost")

    monkeypatch.setattr(vkdenoise, "_last", None)
    with monkeypatch.context() as lost:
        lost.setattr(vkdenoise, "Denoiser", Lost)
        with pytest.raises(vkdenoise.DeviceLostError):
            vkdenoise.denoise(**planes)
    assert_same_bits(vkdenoise.denoise(**planes), clean)


FORKS = """
import os, numpy, vkdenoise
color = numpy.random.default_rng(1).random((24, 32, 3), numpy.float32)
denoiser = vkdenoise.Denoiser()
wanted = denoiser.denoise(color)
assert (vkdenoise.denoise(color) == wanted).all()
child = os.fork()
if child == 0:
    code = 1
    try:
        denoiser.denoise(color)
    except RuntimeError as error:
        assert "made before a fork" in str(error)
        assert (vkdenoise.denoise(color) == wanted).all()
        code = 0
    finally:
        os._exit(code)
_, status = os.waitpid(child, 0)
assert os.waitstatus_to_exitcode(status) == 0
assert (denoiser.denoise(color) == wanted).all()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_after_a_fork() -> None:
    """The parent's denoiser is refused, the function opens the device anew. Where no other library has threads."""
    done = subprocess.run([sys.executable, "-c", FORKS], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
