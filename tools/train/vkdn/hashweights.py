"""Random test weights that any program can repeat from a seed, so that no file of them is needed.

Element i (row-major, from 0) of the tensor called `name`, all integers modulo 2^64:

    start = fnv1a64(name) XOR (seed * 0xD1B54A32D192ED03)    name in UTF-8; basis 0xCBF29CE484222325, prime 0x100000001B3
    z = start + (i + 1) * 0x9E3779B97F4A7C15                 output i of a SplitMix64 that starts at `start`
    z = (z XOR (z >> 30)) * 0xBF58476D1CE4E5B9
    z = (z XOR (z >> 27)) * 0x94D049BB133111EB
    z = z XOR (z >> 31)
    u = (z >> 40) * 2^-23 - 1                                in [-1, 1), exact in float32
    value = offset + scale * u                               in float64, rounded to float32, then to float16

`last` is the part of the name after the last dot, `owner` the part before it (in "enc.1.0.ffn.expand.weight": weight,
expand). (offset, scale) by the first rule that fits:

    last is bias_table                    0, 2
    owner is norm1, norm1_f or norm2      weight: 1, 0.5; bias: 0, 0.5
    last is bias                          0, 0.3
    else (a weight)                       0, gain * sqrt(3 / fan_in), fan_in the product of all dimensions but the first,
                                          gain by the part before the first dot of the name or by the owner, see GAINS

They are chosen so that joint scores spread over about 10 and that no branch is less than a tenth of its block's output: weights
of the size that training starts from would hide a swapped Q and K. `check` asserts both.
"""
import math

import numpy as np
import torch
import torch.nn.functional as F

from .blocks import FilmCnn, JointAttention, conv_nhwc

# By the first part of the name (down, up, skip) or by the owner; 1 for all others.
GAINS = {"down": 0.7, "up": 0.7, "skip": 0.7, "q": 1.2, "k": 1.2, "qf": 1.2, "kf": 1.2, "v": 7.0, "proj": 0.35,
         "contract": 1.5}
GAMMA = 0x9E3779B97F4A7C15
MASK = 2**64 - 1
NORMS = ("norm1", "norm1_f", "norm2")


def fnv1a64(name):
    h = 0xCBF29CE484222325
    for byte in name.encode():
        h = ((h ^ byte) * 0x100000001B3) & MASK
    return h


def uniform(name, seed, count):
    """`count` float64 in [-1, 1)."""
    start = np.uint64(fnv1a64(name) ^ ((seed * 0xD1B54A32D192ED03) & MASK))
    z = start + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(GAMMA)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (z >> np.uint64(40)).astype(np.float64) * 2.0**-23 - 1


def spread(name, shape):
    """(offset, scale) of a tensor's values."""
    *path, last = name.split(".")
    owner = path[-1]
    if last == "bias_table":
        return 0.0, 2.0
    if owner in NORMS:
        return (1.0, 0.5) if last == "weight" else (0.0, 0.5)
    if last == "bias":
        return 0.0, 0.3
    gain = GAINS.get(path[0], GAINS.get(owner, 1.0))
    return 0.0, gain * math.sqrt(3 / math.prod(shape[1:]))


def fill(model, seed):
    """Every parameter from the seed, rounded to float16 and held as the model's own type."""
    with torch.no_grad():
        for name, p in model.named_parameters():
            offset, scale = spread(name, p.shape)
            values = (offset + scale * uniform(name, seed, p.numel())).astype(np.float32).astype(np.float16)
            p.copy_(torch.from_numpy(values).reshape(p.shape))
    return model


def rms(x):
    return float(x.square().mean().sqrt())


def branches(block, x, f, real):
    """Each branch's size relative to the block's output, and (of attention) the 1st and 99th percentile of the scores."""
    out = block(x, f, real)
    if isinstance(block, JointAttention):
        attended = F.linear(block.attend(x, f), block.proj.weight[:, : block.part])
        middle = x + block.proj(torch.cat([block.attend(x, f), x[..., block.part :]], -1))
        parts = {"attended": attended}
        scores = block.joint_scores(x, f)[0].flatten()[:1000000]
        span = torch.quantile(scores, torch.tensor([0.01, 0.99], dtype=scores.dtype)).tolist()
    else:
        gamma, beta = block.modulation(f, real)
        y = conv_nhwc(block.conv, block.norm1(x))
        middle = x + gamma * y + beta
        parts, span = {"gamma": gamma * y, "beta": beta}, None
    parts["ffn"] = block.ffn(block.norm2(middle))
    return {name: rms(part) / rms(out) for name, part in parts.items()}, span


def check(model, color, aux, real):
    """Assert on one input (see `Denoiser`) that no branch is below 10 % and that every block's joint scores spread over
    10, within a factor (both factors of the product hold the same B, so their middle lies above 0).

    Returns per block (name, {branch: relative size}, score span or None).
    """
    measured, hooks = [], []
    blocks = [m for m in model.modules() if isinstance(m, (JointAttention, FilmCnn))]
    names = {m: n for n, m in model.named_modules()}

    def measure(block, inputs, _output):
        hooks[blocks.index(block)].remove()
        measured.append((names[block], *branches(block, *inputs)))

    hooks.extend(block.register_forward_hook(measure) for block in blocks)
    with torch.inference_mode():
        model(color, aux, real)
    for name, sizes, span in measured:
        assert min(sizes.values()) >= 0.1, f"{name}: a branch is too small: {sizes}"
        if span:
            assert 5 <= span[1] - span[0] <= 40, f"{name}: joint scores span {span}"
    return measured
