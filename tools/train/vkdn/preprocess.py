"""From a frame's planes to the network's inputs and back (numpy). The engine's input and output kernels do the same.

Planes are [H, W, 3] or [H, W], float32, as a renderer writes them; `METADATA` names these rules in a weights file.
"""
from dataclasses import dataclass

import numpy as np

METADATA = {"exposure": "auto", "depth": "percentile"}
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
MIDDLE_GREY = 0.18
TILE = 8
LARGEST_HALF = 65504.0
BAD_PIXEL = 1e8
ISOLATED_KEYS = 1e3
ISOLATED_RATIO = 100


@dataclass
class Statistics:
    """What is one number per frame. key: robust log-mean luminance; depth_scale: 99.9th percentile of valid depths."""

    key: float
    depth_scale: float

    @property
    def exposure(self):
        return MIDDLE_GREY / self.key


def is_valid(color):
    """[H, W, 3] -> [H, W]: all three finite and >= 0."""
    return (np.isfinite(color) & (color >= 0)).all(-1)


def key_of(color):
    """Log-mean over 8x8 tiles of the mean clipped luminance; black tiles do not count. 0.18 for a black frame."""
    valid = is_valid(color)
    luminance = np.where(valid, np.where(valid[..., None], color, 0).astype(np.float64) @ LUMINANCE, 0)
    lit = luminance[valid & (luminance > 0)]
    if lit.size == 0:
        return MIDDLE_GREY
    median = np.median(lit)
    rows = np.arange(0, color.shape[0], TILE)
    columns = np.arange(0, color.shape[1], TILE)

    def per_tile(plane):
        return np.add.reduceat(np.add.reduceat(plane, rows, 0), columns, 1)

    # Bad pixels stay out; the key is not known yet, the median stands in.
    counted = valid & (np.where(valid[..., None], color, 0).max(-1) <= BAD_PIXEL * median)
    clipped = np.where(counted, np.minimum(luminance, 64 * median), 0)
    total, count = per_tile(clipped), per_tile(counted.astype(np.float64))
    means = total[total > 0] / count[total > 0]
    return float(2 ** np.log2(np.maximum(means, median / 1024)).mean())


def is_depth(depth):
    return np.isfinite(depth) & (depth > 0) & (depth < 1e9)


def depth_scale_of(depth):
    """Element floor(0.999 * (count - 1)) of the sorted valid depths; 1 where there is none."""
    valid = np.sort(depth[is_depth(depth)], axis=None)
    return float(valid[int(0.999 * (valid.size - 1))]) if valid.size else 1.0


def statistics(color, depth):
    """`depth` may be None."""
    return Statistics(key_of(color), depth_scale_of(depth) if depth is not None else 1.0)


def neighbourhood(plane):
    """[H, W, ...] -> [9, H, W, ...]: every pixel's 3x3 neighbourhood, itself in the middle (index 4), zeros outside."""
    padded = np.pad(plane, ((1, 1), (1, 1)) + ((0, 0),) * (plane.ndim - 2))
    height, width = plane.shape[:2]
    return np.stack([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)])


def is_isolated(brightest, key):
    """[H, W] -> [H, W]: above ISOLATED_KEYS keys and ISOLATED_RATIO times the second-brightest of its neighbours.

    That is a path that found a lamp by chance, not a lamp: light of more than two pixels, and a line of one, has two bright
    neighbours everywhere but at its ends. `brightest` is a pixel's brightest channel, 0 where the pixel is bad.
    """
    suspect = brightest > ISOLATED_KEYS * key
    if not suspect.any():
        return suspect
    around = np.delete(neighbourhood(brightest), 4, 0)
    return suspect & (brightest > ISOLATED_RATIO * np.sort(around, 0)[-2])


def repair(color, key):
    """Bad pixels (not valid, above BAD_PIXEL keys, or isolated) take the mean of their good 3x3 neighbours, else 0."""
    with np.errstate(invalid="ignore"):
        good = is_valid(color) & (color.max(-1) <= BAD_PIXEL * key)
    good &= ~is_isolated(np.where(good, color.max(-1), 0), key)
    if good.all():
        return color
    total = neighbourhood(np.where(good[..., None], color, 0).astype(np.float64)).sum(0)
    count = neighbourhood(good.astype(np.float64)).sum(0)[..., None]
    mean = (total / np.maximum(count, 1)).astype(np.float32)
    return np.where(good[..., None], color, mean)


def log_color(color, exposure, key):
    """[H, W, 3] radiance -> log1p of the repaired, exposed, clamped colour."""
    return np.log1p(np.minimum(repair(color, key) * np.float32(exposure), LARGEST_HALF)).astype(np.float32)


def auxiliary(shape, albedo, normal, depth, depth_scale):
    """The 7 channels albedo, normal, depth, [H, W, 7] in [0, 1]. A plane that is None is missing."""
    out = np.zeros((*shape, 7), np.float32)
    out[..., 3:6] = 0.5
    if albedo is not None:
        out[..., :3] = np.where(np.isfinite(albedo), np.clip(albedo, 0, 1), 0)
    if normal is not None:
        out[..., 3:6] = np.where(np.isfinite(normal), np.clip((normal + 1) / 2, 0, 1), 0.5)
    if depth is not None:
        out[..., 6] = np.where(is_depth(depth), np.clip(depth / np.float32(depth_scale), 0, 1), 0)
    return out


def finish(log_output, exposure):
    """The denoised radiance: max(expm1(output) / exposure, 0)."""
    return np.maximum(np.expm1(log_output) / np.float32(exposure), 0)
