"""vkdenoise: a Vulkan compute denoiser for Monte Carlo renders.

    import vkdenoise
    clean = vkdenoise.denoise(color, albedo=albedo, normal=normal, depth=depth)

Every plane is an array with rows first: ``color``, ``albedo`` and ``normal`` of height x width x 3, ``depth`` of
height x width. ``denoise`` has the whole description; a ``Denoiser`` keeps its network and memory on the device
between frames.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, overload

from ._types import (
    Alpha,
    Device,
    Fireflies,
    FloatArray,
    Layers,
    Precision,
    Progress,
    Quality,
    Readable,
    SkipMode,
)
from ._vkdenoise import Cancelled, Denoiser, DeviceError, DeviceInfo, DeviceLostError, Report, __version__, devices

__all__ = [
    "Cancelled",
    "Denoiser",
    "DeviceError",
    "DeviceInfo",
    "DeviceLostError",
    "Report",
    "__version__",
    "denoise",
    "devices",
]

_Out = TypeVar("_Out", bound=Readable)

_lock = threading.Lock()
_last: tuple[tuple[object, ...], Denoiser] | None = None


def _after_fork() -> None:
    global _lock, _last
    # Another thread of the parent's may have held the lock; the parent's device is not this process's.
    _lock, _last = threading.Lock(), None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def _denoiser(
    quality: Quality,
    weights: str | os.PathLike[str] | None,
    precision: Precision,
    blend: float,
    clean_aux: bool,
    skip_below: float | None,
    skip_mode: SkipMode,
    memory_budget: int | None,
    signals: bool,
    device: Device | None,
) -> Denoiser:
    """The last one if it was made of the same options."""
    global _last
    wanted = (quality, weights, precision, blend, clean_aux, skip_below, skip_mode, memory_budget, signals, device)
    key = (*wanted, os.environ.get("VKDENOISE_DEVICE"))
    with _lock:
        if _last is None or _last[0] != key:
            # The old one goes first: the device may not hold both.
            _last = None
            denoiser = Denoiser(
                quality=quality,
                weights=weights,
                precision=precision,
                blend=blend,
                clean_aux=clean_aux,
                skip_below=skip_below,
                skip_mode=skip_mode,
                memory_budget=memory_budget,
                signals=signals,
                device=device,
            )
            _last = (key, denoiser)
        return _last[1]


@overload
def denoise(
    color: Readable,
    albedo: Readable | None = ...,
    normal: Readable | None = ...,
    depth: Readable | None = ...,
    *,
    out: None = ...,
    quality: Quality = ...,
    weights: str | os.PathLike[str] | None = ...,
    precision: Precision = ...,
    exposure: float | None = ...,
    blend: float = ...,
    fireflies: Fireflies = ...,
    clean_aux: bool = ...,
    region: Sequence[int] | None = ...,
    skip_below: float | None = ...,
    skip_mode: SkipMode = ...,
    variance: Readable | None = ...,
    samples: Readable | None = ...,
    memory_budget: int | None = ...,
    device: Device | None = ...,
    light_groups: None = ...,
    aovs: None = ...,
    alpha: Alpha = ...,
    progress: Progress | None = ...,
) -> FloatArray: ...
@overload
def denoise(
    color: Readable,
    albedo: Readable | None = ...,
    normal: Readable | None = ...,
    depth: Readable | None = ...,
    *,
    out: _Out,
    quality: Quality = ...,
    weights: str | os.PathLike[str] | None = ...,
    precision: Precision = ...,
    exposure: float | None = ...,
    blend: float = ...,
    fireflies: Fireflies = ...,
    clean_aux: bool = ...,
    region: Sequence[int] | None = ...,
    skip_below: float | None = ...,
    skip_mode: SkipMode = ...,
    variance: Readable | None = ...,
    samples: Readable | None = ...,
    memory_budget: int | None = ...,
    device: Device | None = ...,
    light_groups: None = ...,
    aovs: None = ...,
    alpha: Alpha = ...,
    progress: Progress | None = ...,
) -> _Out: ...
@overload
def denoise(
    color: Readable,
    albedo: Readable | None = ...,
    normal: Readable | None = ...,
    depth: Readable | None = ...,
    *,
    out: None = ...,
    quality: Quality = ...,
    weights: str | os.PathLike[str] | None = ...,
    precision: Precision = ...,
    exposure: float | None = ...,
    blend: float = ...,
    fireflies: Fireflies = ...,
    clean_aux: bool = ...,
    region: Sequence[int] | None = ...,
    skip_below: float | None = ...,
    skip_mode: SkipMode = ...,
    variance: Readable | None = ...,
    samples: Readable | None = ...,
    memory_budget: int | None = ...,
    device: Device | None = ...,
    light_groups: Layers,
    aovs: Layers | None = ...,
    alpha: Alpha = ...,
    progress: Progress | None = ...,
) -> tuple[FloatArray, dict[str, FloatArray]]: ...
@overload
def denoise(
    color: Readable,
    albedo: Readable | None = ...,
    normal: Readable | None = ...,
    depth: Readable | None = ...,
    *,
    out: None = ...,
    quality: Quality = ...,
    weights: str | os.PathLike[str] | None = ...,
    precision: Precision = ...,
    exposure: float | None = ...,
    blend: float = ...,
    fireflies: Fireflies = ...,
    clean_aux: bool = ...,
    region: Sequence[int] | None = ...,
    skip_below: float | None = ...,
    skip_mode: SkipMode = ...,
    variance: Readable | None = ...,
    samples: Readable | None = ...,
    memory_budget: int | None = ...,
    device: Device | None = ...,
    light_groups: None = ...,
    aovs: Layers,
    alpha: Alpha = ...,
    progress: Progress | None = ...,
) -> tuple[FloatArray, dict[str, FloatArray]]: ...
@overload
def denoise(
    color: Readable,
    albedo: Readable | None = ...,
    normal: Readable | None = ...,
    depth: Readable | None = ...,
    *,
    out: Readable | None,
    quality: Quality = ...,
    weights: str | os.PathLike[str] | None = ...,
    precision: Precision = ...,
    exposure: float | None = ...,
    blend: float = ...,
    fireflies: Fireflies = ...,
    clean_aux: bool = ...,
    region: Sequence[int] | None = ...,
    skip_below: float | None = ...,
    skip_mode: SkipMode = ...,
    variance: Readable | None = ...,
    samples: Readable | None = ...,
    memory_budget: int | None = ...,
    device: Device | None = ...,
    light_groups: Layers | None = ...,
    aovs: Layers | None = ...,
    alpha: Alpha = ...,
    progress: Progress | None = ...,
) -> Any: ...
def denoise(
    color: Readable,
    albedo: Readable | None = None,
    normal: Readable | None = None,
    depth: Readable | None = None,
    *,
    out: Readable | None = None,
    quality: Quality = "balanced",
    weights: str | os.PathLike[str] | None = None,
    precision: Precision = "auto",
    exposure: float | None = None,
    blend: float = 0.0,
    fireflies: Fireflies = "auto",
    clean_aux: bool = False,
    region: Sequence[int] | None = None,
    skip_below: float | None = None,
    skip_mode: SkipMode = "approximate",
    variance: Readable | None = None,
    samples: Readable | None = None,
    memory_budget: int | None = None,
    device: Device | None = None,
    light_groups: Layers | None = None,
    aovs: Layers | None = None,
    alpha: Alpha = "keep",
    progress: Progress | None = None,
) -> Any:
    """Denoises a frame and returns the clean one.

    The denoiser behind it stays for the next call with the same options, with its memory on the device, until one with
    other options. A ``Denoiser`` of your own takes its memory with it when it goes. Threads may call it at the same
    time; their frames take turns.

    Planes
        Arrays of float32 or float16: numpy's, or what has DLPack in the CPU's memory (torch, jax), the buffer protocol
        or ``__array__``. They are read where they lie, whatever their strides; numpy copies an array first whose
        strides are negative or no whole number of samples, or whose samples are not aligned. Other threads go on
        meanwhile: they must not write to the arrays or resize them.

        color     height x width x 3: linear radiance, any brightness. NaN and infinite samples are mended, negative
                  ones are 0. With a fourth channel, alpha: pixels of four zeros stay so.
        albedo    height x width x 3, in 0 to 1.
        normal    height x width x 3: shading normals in -1 to 1, of the world or the camera.
        depth     height x width, or x 1: any unit, larger is farther; 0, negative, not finite or at least 1e9 (in
                  float16 65000) is background.
        variance  height x width, or x 1: what the renderer knows of the variance of the colour's luminance; or
        samples   the same: samples of each pixel. Either tells ``skip_below`` where noise is; else nothing looks at
                  them.
        out       where to write: an array of the color's shape that can be written, of float32 or float16; it may be
                  ``color`` itself. Where it cannot be written in place, or shares memory with a plane, the result is
                  copied into it.

    What goes with the colour (not with ``weights`` of a network that predicts no kernels)
        Each is filtered by the kernels that are predicted for the color, for about a tenth of the frame's time.

        light_groups  a dict of names and arrays of height x width x 3: parts of the color's light. Where they add up
                      to the noisy color, the denoised ones add up to the denoised color.
        aovs          a dict of names and arrays of height x width, x 1 or x 3: anything else that was rendered with the
                      color. Their samples are averaged as they are.
        alpha         "keep": the color's alpha is passed through; "denoise": it is denoised with the color, as edges
                      want that are composited.

    Options
        quality        run time against error: "fast", "balanced" or "high". "fast" skips below 0.02, and keeps feature
                       maps in halves on a CPU too; "high" averages the results of the frame and of the frame
                       turned by half a circle, in twice the time.
        weights        a safetensors file in place of the network that ships.
        precision      "auto", "fp32", "fp16" (feature maps in halves, for half of the memory) or "matrix" (halves in
                       cooperative matrices, where the device has them).
        exposure       the factor that brings the frame to normal brightness; None: from the frame. One for a whole
                       sequence keeps it from flickering: ``Report.exposure`` of its first frame.
        blend          share of the noisy colour in the result, 0 to 1.
        fireflies      lone pixels much brighter than those around: "keep" their light, "mend" them, or "auto": mend
                       where the frame is noisy.
        clean_aux      albedo and normals are free of noise, or were denoised before, and are taken as they are; else
                       albedo is filtered where it is noisy, as in glass and depth of field.
        region         (x, y, width, height) in pixels from the upper left: denoises these alone, for part of the work
                       and with the bits of the whole. All other pixels keep what ``out`` has, or in a new array the
                       color's.
        skip_below     leaves squares of 16x16 pixels alone whose relative noise is below this; 0: none; None: as the
                       quality says.
        skip_mode      "approximate" or "exact": with the bits that nothing skipped would give the rest.
        memory_budget  most bytes of device memory to take; a frame that needs more is cut into tiles, which take no
                       light groups, aovs and alpha.
        device         an index of ``devices()``, part of a name, or "best"; None: ``VKDENOISE_DEVICE`` if that is set,
                       else the best.
        progress       a function that is called in this thread with the share of the work that is done, from 0 to 1,
                       about every 50 ms. The call ends where it returns False or raises.

    Returns
        A new array of the color's shape and type, or ``out``. With ``light_groups`` or ``aovs`` a tuple of it and a
        dict of new arrays, all of them by their names, each of the shape and type that was given.

    Raises (``out`` is then as it was, but for the tiles that were done of a frame that was cut into tiles)
        ValueError   a shape or an option that cannot be, or weights that are damaged; the message names it and what is
                     wanted.
        TypeError    samples that are no float32 or float16.
        MemoryError  the frame does not fit the device, the budget or the host.
        OSError      a weights file that cannot be read.
        DeviceError  no device can run it, or its driver failed; ``DeviceLostError``: the device was lost, and the next
                     call opens it again.
        Cancelled    ``progress`` returned False. What it raises itself is passed on.
    """
    global _last
    # What is no mapping is refused by the denoiser, in its words.
    layers = (light_groups, aovs)
    signals = alpha == "denoise" or any(isinstance(given, Mapping) and len(given) > 0 for given in layers)
    denoiser = _denoiser(
        quality, weights, precision, blend, clean_aux, skip_below, skip_mode, memory_budget, signals, device
    )
    try:
        return denoiser.denoise(
            color,
            albedo,
            normal,
            depth,
            out=out,
            exposure=exposure,
            fireflies=fireflies,
            region=region,
            variance=variance,
            samples=samples,
            light_groups=light_groups,
            aovs=aovs,
            alpha=alpha,
            progress=progress,
        )
    except DeviceLostError:
        with _lock:
            if _last is not None and _last[1] is denoiser:
                _last = None
        raise
