"""From a frame's planes to the network's inputs and back (numpy). The engine's input and output kernels do the same.

Planes are [H, W, 3] or [H, W], float32, as a renderer writes them; `METADATA` names these rules in a weights file.
"""
from dataclasses import dataclass

import numpy as np

from . import noisy_albedo

METADATA = {"exposure": "auto", "depth": "percentile", "version": 2}
# Weights of these versions run by the same rules: they differ in samples that are no light and in lone bright pixels alone.
VERSIONS = (1, 2)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
MIDDLE_GREY = 0.18
TILE = 8
# The network's range: of exposed radiance, what it is given and what it gives.
RANGE = 2048.0
LARGEST_FLOAT = np.finfo(np.float32).max
# Keys, and times the brightest neighbour: a lone pixel of more is no light.
ABSURD_KEYS = 1e8
# Keys, and times the second-brightest neighbour: fireflies that are mended, and those that are kept.
MENDED_FIREFLY = (1e3, 100)
KEPT_FIREFLY = (8, 8)
MEND_REACH = 4
NOISY = np.float32(0.08)
ENOUGH_LIT = 32
NOISY_SHARE = 0.25


@dataclass
class Statistics:
    """What is one number per frame. key: robust log-mean luminance; depth_scale: 99.9th percentile of valid depths."""

    key: float
    depth_scale: float

    @property
    def exposure(self):
        return MIDDLE_GREY / self.key


def light_of(color):
    """Samples below 0, and those that are not finite, are 0."""
    return np.where(np.isfinite(color), np.maximum(np.nan_to_num(color), 0), 0)


def luminance_of(color):
    """[H, W, 3] -> [H, W], NaN where a sample is not finite."""
    return np.where(np.isfinite(color).all(-1), light_of(color).astype(np.float64) @ LUMINANCE, np.nan)


def per_tile(plane):
    """[H, W, ...] -> sums over tiles of 8x8."""
    rows, columns = np.arange(0, plane.shape[0], TILE), np.arange(0, plane.shape[1], TILE)
    return np.add.reduceat(np.add.reduceat(plane, rows, 0), columns, 1)


def median_of(luminance):
    """Of the lit pixels; 0 where there is none."""
    lit = luminance[luminance > 0]
    return float(np.median(lit)) if lit.size else 0.0


def key_of(color):
    """Log-mean over 8x8 tiles of the mean clipped luminance; black tiles do not count. 0.18 for a black frame."""
    luminance = luminance_of(color)
    median = median_of(luminance)
    if median == 0:
        return MIDDLE_GREY
    # The key is not known yet, the median stands in.
    counted = np.isfinite(luminance) & (light_of(color).max(-1) <= ABSURD_KEYS * median)
    clipped = np.where(counted, np.minimum(np.nan_to_num(luminance), 64 * median), 0)
    total, count = per_tile(clipped), per_tile(counted.astype(np.float64))
    means = total[total > 0] / count[total > 0]
    return float(2 ** np.log2(np.maximum(means, median / 1024)).mean())


def noise_of(color):
    """[tiles in y, tiles in x, 2]: lit pixels of every tile with neighbours on both sides in it, and the noisy ones of them.

    A pixel is noisy that differs from the mean of the two by more than NOISY of what the three have.
    """
    luminance = luminance_of(color).astype(np.float32)
    counts = np.zeros((*luminance.shape, 2))
    left, middle, right = luminance[:, :-2], luminance[:, 1:-1], luminance[:, 2:]
    inside = np.isin(np.arange(1, luminance.shape[1] - 1) % TILE, range(1, TILE - 1))
    with np.errstate(invalid="ignore", over="ignore"):
        lit = inside & (middle > 0) & np.isfinite(left + right)
        outer, half = left / 4 + right / 4, middle / 2
        counts[:, 1:-1] = np.stack([lit, lit & (np.abs(outer - half) > NOISY * (outer + half))], -1)
    return per_tile(counts)


def largest_of(color):
    """The largest sample of each channel, without absurd lone pixels; the median stands in for the key."""
    light, limit = brightness_of(color), ABSURD_KEYS * median_of(luminance_of(color))
    alone = is_alone(light, (limit, MENDED_FIREFLY[1]), 1) if limit > 0 else np.zeros(light.shape, bool)
    return np.where(alone[..., None], 0, light_of(color)).max((0, 1))


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


def brightness_of(color):
    """[H, W, 3] -> [H, W]: the brightest sample; +Inf is the largest float."""
    return np.where(color == np.inf, LARGEST_FLOAT, light_of(color)).max(-1)


def is_alone(light, rule, which):
    """[H, W] -> [H, W]: above rule[0], and above rule[1] times the brightest (1) or second-brightest (2) of the neighbours.

    That is a path that found a lamp by chance, not a lamp: light of more than two pixels, and a line of one, has two bright
    neighbours everywhere but at its ends.
    """
    suspect = light > rule[0]
    if not suspect.any():
        return suspect
    around = np.delete(neighbourhood(light.astype(np.float64)), 4, 0)
    return suspect & (light > rule[1] * np.sort(around, 0)[-which])


def is_noisy(color):
    """[H, W]: whether what surrounds a pixel is noisy: more than a quarter of the lit pixels of the 3x3 tiles, or the frame's."""
    counts = noise_of(color)
    lit, noisy = np.moveaxis(neighbourhood(counts).sum(0), -1, 0)
    all_lit, all_noisy = counts.sum((0, 1))
    frame = all_noisy > NOISY_SHARE * all_lit if all_lit else True
    tiles = np.where(lit >= ENOUGH_LIT, noisy > NOISY_SHARE * lit, frame)
    height, width = color.shape[:2]
    return tiles.repeat(TILE, 0).repeat(TILE, 1)[:height, :width]


def lone_pixels(color, key, fireflies="auto"):
    """Two masks [H, W]: pixels that are missing, and fireflies that are kept."""
    infinite, light = (color == np.inf).any(-1), brightness_of(color)
    light_or_none = np.where(infinite, 0, light)

    def alone(keys, ratio, which):
        bright = light_or_none > keys * key
        return bright & is_alone(light, (keys * key, ratio), which) if bright.any() else bright

    absurd = alone(ABSURD_KEYS, MENDED_FIREFLY[1], 1)
    mended, kept = alone(*MENDED_FIREFLY, 2), alone(*KEPT_FIREFLY, 2)
    if not kept.any() and not mended.any():
        return absurd, kept
    keeps = ~is_noisy(color) if fireflies == "auto" else np.full(light.shape, fireflies == "keep")
    return absurd | (mended & ~keeps), kept & keeps & ~absurd


def shifted(plane, dy, dx):
    """[H, W, ...]: the values dy below and dx to the right, zeros outside."""
    out = np.zeros_like(plane)
    height, width = plane.shape[:2]
    rows, columns = slice(max(dy, 0), height + min(dy, 0)), slice(max(dx, 0), width + min(dx, 0))
    to = slice(max(-dy, 0), height + min(-dy, 0)), slice(max(-dx, 0), width + min(-dx, 0))
    if abs(dy) < height and abs(dx) < width:
        out[to] = plane[rows, columns]
    return out


def tile_means(color, median):
    """[tiles, tiles, 3]: means of the finite samples, none for more than 64 medians; those without from the nearest ring of tiles."""
    finite = np.isfinite(color)
    total = per_tile(np.minimum(light_of(color).astype(np.float64), 64 * median))
    count = per_tile(finite.astype(np.float64))
    means, known = total / np.maximum(count, 1), count > 0
    while not known.all() and known.any((0, 1)).any():
        sums, counts = (neighbourhood(p).sum(0) for p in (np.where(known, means, 0), known.astype(np.float64)))
        new = ~known & (counts > 0)
        if not new.any():
            break
        means, known = np.where(new, sums / np.maximum(counts, 1), means), known | new
    return np.where(known, means, 0)


def mended(color, good, missing):
    """Missing samples [H, W, 3] become the mean, by channel, of the nearest ring of pixels with good ones; far from all, their
    tile's. `good` [H, W]: pixels whose finite samples may be taken."""
    result, open_ = light_of(color).astype(np.float64), missing.copy()
    usable = good[..., None] & np.isfinite(color)
    planes = np.concatenate([np.where(usable, light_of(color), 0), usable], -1).astype(np.float64)
    for reach in range(1, MEND_REACH + 1):
        if not open_.any():
            return result
        offsets = [(y, x) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1) if max(abs(y), abs(x)) == reach]
        total, count = np.split(sum(shifted(planes, y, x) for y, x in offsets), 2, -1)
        found = open_ & (count > 0)
        result[found] = total[found] / count[found]
        open_ &= ~found
    if open_.any():
        height, width = color.shape[:2]
        means = tile_means(color, median_of(luminance_of(color))).repeat(TILE, 0).repeat(TILE, 1)[:height, :width]
        result[open_] = means[open_]
    return result


def repair(color, key, fireflies="auto"):
    """[H, W, 3] -> what the network is to see, what of the light it is not to (kept fireflies), both [H, W, 3], and where the result
    is what it sees (lamps of +Inf), a mask.

    Negative samples are 0. NaN, -Inf, absurd lone pixels and fireflies are missing. +Inf is the brightest sample around, or
    where two or more neighbours are infinite too, a lamp, the frame's largest. docs/neutral.md has the rules.
    """
    gone, kept = lone_pixels(color, key, fireflies)
    infinite = color == np.inf
    lone = gone | kept
    missing = lone[..., None] | ~(np.isfinite(color) | infinite)
    result = mended(color, ~lone, missing) if missing.any() else light_of(color)
    given = np.zeros(color.shape, bool)
    if infinite.any():
        finite = ~lone[..., None] & np.isfinite(color)
        light = np.where(finite, light_of(color), -1).max(-1)
        around, pixels = neighbourhood(light + 1).max(0) - 1, infinite.any(-1)
        lamp = (neighbourhood(pixels.astype(int)).sum(0) - pixels >= 2) | (around < 0)
        value = np.where(lamp, largest_of(color).max(), around)
        result = np.where(infinite & ~lone[..., None], value[..., None], result)
        given = infinite & lamp[..., None]
    beyond = np.where(kept[..., None], np.maximum(light_of(color) - result, 0), 0)
    return result.astype(np.float32), beyond.astype(np.float32), given


def log_color(color, exposure, key, fireflies="auto"):
    """[H, W, 3] radiance -> log1p of the repaired, exposed, clamped colour."""
    return split(color, exposure, key, fireflies)[0]


def split(color, exposure, key, fireflies="auto"):
    """[H, W, 3] radiance -> the network's colour c; the radiance that goes around it: what is beyond its range, and what is left of
    kept fireflies; and a mask of what is given, all of it: lamps of +Inf, which are nothing but the radiance that goes around."""
    seen, beyond, given = repair(color, key, fireflies)
    with np.errstate(over="ignore"):
        exposed = seen * np.float32(exposure)
    beyond = np.where(given, seen, beyond + np.maximum(seen - RANGE / exposure, 0))
    return np.log1p(np.minimum(exposed, RANGE)).astype(np.float32), beyond.astype(np.float32), given


def auxiliary(shape, albedo, normal, depth, depth_scale, clean_aux=True):
    """The 7 channels albedo, normal, depth, [H, W, 7] in [0, 1]. A plane that is None is missing. Without `clean_aux` the albedo
    is filtered where it is noisy."""
    out = np.zeros((*shape, 7), np.float32)
    out[..., 3:6] = 0.5
    if albedo is not None:
        out[..., :3] = np.where(np.isfinite(albedo), np.clip(albedo, 0, 1), 0)
    if normal is not None:
        out[..., 3:6] = np.where(np.isfinite(normal), np.clip((normal + 1) / 2, 0, 1), 0.5)
    if depth is not None:
        out[..., 6] = np.where(is_depth(depth), np.clip(depth / np.float32(depth_scale), 0, 1), 0)
    if not clean_aux and albedo is not None and normal is not None:
        out[..., :3] = noisy_albedo.filtered(out[..., :3], out[..., 3:6])
    return out


def finish(log_output, exposure, largest=np.inf, beyond=0, given=False):
    """The denoised radiance: max(expm1(output) / exposure, 0), at most the frame's largest samples, and what went around; `given`
    samples are that alone."""
    denoised = np.maximum(np.expm1(log_output) / np.float32(exposure), 0)
    return np.where(given, 0, np.minimum(denoised, np.float32(largest))) + beyond
