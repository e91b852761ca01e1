"""Light given back after the network, where it makes radiance (numpy); `src/kernels/energy.rs` says how and why.

Radiance is exposed, [H, W, 3].
"""
import numpy as np

BLOCK = 64
BOUND = 0.125
CAUTION = 1.5


def room(radiance, largest):
    """How much of what is given back a result takes beside others: nothing where it is the frame's largest sample."""
    return np.sqrt(np.maximum(1 - radiance / np.maximum(largest, 1e-37), 0))


def sums(plane):
    """[H, W, 3] -> [blocks in y, blocks in x, 3]."""
    rows, columns = (np.arange(0, size, BLOCK) for size in plane.shape[:2])
    return np.add.reduceat(np.add.reduceat(plane, rows, 0), columns, 1)


def gains(given, result, largest):
    """Of every block: what it lacks beyond what chance may take, over the light that has room."""
    missing, by_chance = sums(given - result), CAUTION * sums((given - result) ** 2)
    with_room = sums(result * room(result, largest))
    known = (missing**2 > by_chance) & (with_room > 0)
    sure = missing - by_chance / np.where(known, missing, 1)
    return np.where(known, np.clip(sure / np.where(known, with_room, 1), -BOUND, BOUND), 0)


def between(blocks, shape):
    """[blocks in y, blocks in x, 3] -> [H, W, 3], bilinearly between the blocks' middles."""
    for axis in (0, 1):
        middle = (np.arange(shape[axis]) + 0.5) / BLOCK - 0.5
        low = np.floor(middle).astype(int)
        far = np.expand_dims(middle - low, (1 - axis, 2))
        high = np.minimum(low + 1, blocks.shape[axis] - 1)
        blocks = (1 - far) * blocks.take(np.maximum(low, 0), axis) + far * blocks.take(high, axis)
    return blocks


def given_back(given, result, largest):
    """The result with what it lacks of the light that was given; `largest`: the frame's largest samples, exposed."""
    given, result = np.asarray(given, np.float64), np.maximum(np.asarray(result, np.float64), 0)
    gain = between(gains(given, result, largest), result.shape)
    return result * (1 + gain * room(result, largest))
