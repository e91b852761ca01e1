"""Progress callbacks: what they are told, and how they end a call."""

from __future__ import annotations

import threading
from typing import Any

import numpy
import pytest
from conftest import HEIGHT, WIDTH, Planes, assert_same_bits

import vkdenoise


def test_shares_grow_from_none_to_all(planes: Planes, clean: numpy.ndarray, denoiser: vkdenoise.Denoiser) -> None:
    shares: list[float] = []
    threads = set()

    def watch(share: float) -> int:
        shares.append(share)
        threads.add(threading.get_ident())
        # As many functions do; nothing but False stops.
        return 0

    assert_same_bits(denoiser.denoise(**planes, progress=watch), clean)
    assert shares[0] == 0 and shares[-1] == 1 and len(shares) > 3
    assert all(isinstance(share, float) for share in shares) and shares == sorted(shares)
    assert threads == {threading.get_ident()}
    again: list[float] = []
    assert_same_bits(vkdenoise.denoise(**planes, progress=again.append), clean)
    assert again == shares


class Stopped(Exception):
    pass


@pytest.mark.parametrize("after", [0, 2])
@pytest.mark.parametrize("how", [False, numpy.False_, Stopped("enough"), KeyboardInterrupt()], ids=repr)
def test_a_call_is_ended(planes: Planes, clean: numpy.ndarray, how: Any, after: int) -> None:
    denoiser = vkdenoise.Denoiser()
    calls: list[float] = []

    def stop(share: float) -> object:
        calls.append(share)
        if len(calls) <= after:
            return None
        if isinstance(how, BaseException):
            raise how
        return how

    out = numpy.full((HEIGHT, WIDTH, 3), 7, numpy.float32)
    wanted = type(how) if isinstance(how, BaseException) else vkdenoise.Cancelled
    with pytest.raises(wanted) as raised:
        denoiser.denoise(**planes, out=out, progress=stop)
    assert raised.value is how or str(raised.value) == "a progress callback returned False"
    assert len(calls) == after + 1 and denoiser.report is None
    assert (out == 7).all()
    assert_same_bits(denoiser.denoise(**planes, out=out), clean)


def test_kept_features_are_given_again(planes: Planes, clean: numpy.ndarray) -> None:
    denoiser = vkdenoise.Denoiser(keep_features=True)
    denoiser.denoise(**planes)
    with pytest.raises(vkdenoise.Cancelled):
        denoiser.denoise(**planes, progress=lambda share: False)
    with pytest.raises(ValueError, match="features_unchanged"):
        denoiser.denoise(planes["color"], features_unchanged=True)
    assert_same_bits(denoiser.denoise(**planes), clean)
    assert_same_bits(denoiser.denoise(planes["color"], features_unchanged=True), clean)


def test_other_threads_take_turns_meanwhile(planes: Planes, clean: numpy.ndarray) -> None:
    """A callback that waits for another thread's Python, while a third waits for the denoiser."""
    denoiser = vkdenoise.Denoiser()
    found: list[numpy.ndarray] = []
    waiting = threading.Thread(target=lambda: found.append(denoiser.denoise(**planes)))

    def watch(share: float) -> None:
        if share == 0:
            waiting.start()
        other = threading.Thread(target=sum, args=([1, 2],))
        other.start()
        other.join(10)
        assert not other.is_alive()

    assert_same_bits(denoiser.denoise(**planes, progress=watch), clean)
    waiting.join(60)
    assert_same_bits(found[0], clean)


def test_a_callback_that_calls_its_denoiser(planes: Planes, clean: numpy.ndarray) -> None:
    denoiser, other = vkdenoise.Denoiser(), vkdenoise.Denoiser()
    for use in (lambda: denoiser.denoise(**planes), lambda: denoiser.memory_required(8, 8)):
        with pytest.raises(RuntimeError, match="cannot use the Denoiser that calls it"):
            denoiser.denoise(**planes, progress=lambda share: use())

    def uses_another(share: float) -> None:
        if share == 0:
            assert_same_bits(other.denoise(**planes), clean)

    assert_same_bits(denoiser.denoise(**planes, progress=uses_another), clean)


def test_what_cannot_be_called(planes: Planes, denoiser: vkdenoise.Denoiser) -> None:
    with pytest.raises(TypeError, match="progress is a float; a function of the share that is done is wanted"):
        denoiser.denoise(**planes, progress=0.5)
