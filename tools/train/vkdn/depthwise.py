"""Depthwise 3x3 convolution of channels-last maps in Triton, forward and backward, for training on a GPU.

cuDNN has no fast kernel for these in bfloat16. `use(True)` lets every depthwise layer on a GPU run here.
"""
import functools

import torch

_enabled = False


def use(yes):
    global _enabled
    _enabled = yes


def in_use():
    return _enabled


def run(conv, x):
    """`conv` (depthwise 3x3, padding 1) of x [N, H, W, C], C a multiple of 32."""
    return Depthwise.apply(x, conv.weight, conv.bias)


@functools.cache
def kernels():
    """Compiled on first use: a machine without a GPU need not have Triton."""
    from . import depthwise_kernels

    return depthwise_kernels


def convolve(x, taps, bias):
    """taps [9, C] row-major."""
    n, h, w, c = x.shape
    out = torch.empty_like(x)
    block_c = 64 if c % 64 == 0 else 32
    block_p = 2048 // block_c
    grid = (-(-n * h * w // block_p), c // block_c)
    bias_or_any = taps if bias is None else bias
    kernels().convolve[grid](x, taps, bias_or_any, out, n * h * w, h, w, c, bias is not None, block_p, block_c, num_warps=4)
    return out


class Depthwise(torch.autograd.Function):
    """x [N, H, W, C], weight [C, 1, 3, 3], bias [C] -> [N, H, W, C]."""

    @staticmethod
    def forward(ctx, x, weight, bias):
        x = x.contiguous()
        taps = weight.reshape(len(weight), 9).t().contiguous()
        ctx.save_for_backward(x, taps)
        return convolve(x, taps, bias)

    @staticmethod
    def backward(ctx, grad):
        x, taps = ctx.saved_tensors
        grad = grad.contiguous()
        n, h, w, c = x.shape
        pixels = n * h * w
        block_c = 64 if c % 64 == 0 else 32
        block_p = 512 // block_c
        # About eight blocks a multiprocessor, each of whole rounds.
        rounds = max(1, -(-pixels // (block_p * max(1, 1056 // (c // block_c)))))
        parts = -(-pixels // (block_p * rounds))
        sums = torch.empty(parts, 10, c, device=x.device, dtype=torch.float32)
        kernels().sums[(parts, c // block_c)](x, grad, sums, pixels, h, w, c, rounds, block_p, block_c, num_warps=4)
        total = sums.sum(0)
        of_weight = total[:9].t().reshape(c, 1, 3, 3).to(taps.dtype)
        return convolve(grad, taps.flip(0), None), of_weight, total[9].to(taps.dtype)
