"""Where albedo and normals are noisy, and the mean albedo there (numpy); docs/neutral.md, "Features", has the rule. The engine's
input kernel does the same (glsl/shared/noisy_albedo.glsl)."""
import numpy as np

REACH = 3
SIDE = 2 * REACH + 1
# Variances from which on a feature counts as noise, and from which on fully: of albedo, and of normals in [0, 1].
ALBEDO = (1e-4, 2e-4)
NORMAL = (0.005 / 4, 0.015 / 4)
# Ratios of the least mean squared difference between neighbours to that between any pixels, the same.
WHITE = (0.6, 0.8)


def mirrored(plane):
    """[H, W, C] -> [H + 2 REACH, W + 2 REACH, C], again and again where the frame is smaller, without repeating the edge."""

    def indices(size):
        at = np.abs(np.arange(-REACH, size + REACH)) % max(2 * (size - 1), 1)
        return np.where(at < size, at, 2 * (size - 1) - at)

    return plane[indices(plane.shape[0])][:, indices(plane.shape[1])]


def sums(plane, rows=SIDE, columns=SIDE):
    """[h, w, ...] -> sums over all windows of so many rows and columns."""
    plane = np.lib.stride_tricks.sliding_window_view(plane, rows, 0).sum(-1)
    return np.lib.stride_tricks.sliding_window_view(plane, columns, 1).sum(-1)


def step(value, low, high):
    return np.clip((value - low) / (high - low), 0, 1)


def mean_and_noise(plane, variances):
    """[H, W, 3] -> means of the windows, [H, W, 3], and how noisy they are, [H, W], from 0 to 1.

    Noise has no direction: neighbours differ in each as much as any two pixels do. Edges, bars and smooth texture have one in
    which they do not.
    """
    around = mirrored(plane.astype(np.float64))
    height, width = plane.shape[:2]
    mean = sums(around) / SIDE**2
    shifted = ((dy, dx) for dy in range(SIDE) for dx in range(SIDE))
    spread = sum(((around[dy : dy + height, dx : dx + width] - mean) ** 2).sum(-1) for dy, dx in shifted)
    squares = lambda a, b: ((a - b) ** 2).sum(-1)
    steps = [
        sums(squares(around[:, 1:], around[:, :-1]), SIDE, SIDE - 1) / (SIDE * (SIDE - 1)),
        sums(squares(around[1:], around[:-1]), SIDE - 1, SIDE) / (SIDE * (SIDE - 1)),
        sums(squares(around[1:, 1:], around[:-1, :-1]), SIDE - 1, SIDE - 1) / (SIDE - 1) ** 2,
        sums(squares(around[1:, :-1], around[:-1, 1:]), SIDE - 1, SIDE - 1) / (SIDE - 1) ** 2,
    ]
    variance = spread / SIDE**2
    ratio = np.min(steps, 0) / np.maximum(2 * variance, 1e-12)
    return mean, step(variance, *variances) * step(ratio, *WHITE)


def filtered(albedo, normal):
    """[H, W, 3] in [0, 1] twice -> the albedo, filtered; normals are mapped from [-1, 1]."""
    mean, noise = mean_and_noise(albedo, ALBEDO)
    noise = noise * mean_and_noise(normal, NORMAL)[1]
    return (albedo + (mean - albedo) * noise[..., None]).astype(np.float32)
