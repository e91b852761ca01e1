"""The head's weighted means in Triton, forward and backward, for training on a GPU: one pass where head.py takes one a tap.

`use(True)` lets every mean of three-channel float32 planes on a GPU run here.
"""
import functools
import math

import torch

BLOCK = 128
_enabled = False


def use(yes):
    global _enabled
    _enabled = yes


def in_use():
    return _enabled


@functools.cache
def kernels():
    """Compiled on first use: a machine without a GPU need not have Triton."""
    from . import head_kernels

    return head_kernels


def launch(kernel, *planes, taps, shape):
    n, _, h, w = shape
    pixels = n * h * w
    kernel[(-(-pixels // BLOCK),)](*planes, pixels, h, w, math.isqrt(taps) // 2, taps, BLOCK, num_warps=4)


class Average(torch.autograd.Function):
    """As head.average: logits [N, T, H, W], reliability [N, 1, H, W], image [N, 3, H, W] -> [N, 3, H, W], all float32."""

    @staticmethod
    def forward(ctx, logits, reliability, image):
        planes = [t.contiguous() for t in (logits, reliability, image)]
        out, lse = torch.empty_like(planes[2]), torch.empty_like(planes[1])
        launch(kernels().forward, *planes, out, lse, taps=logits.shape[1], shape=image.shape)
        ctx.save_for_backward(*planes, out, lse)
        return out

    @staticmethod
    def backward(ctx, grad):
        saved = [*ctx.saved_tensors, grad.contiguous()]
        logits, reliability, image = saved[:3]
        of_logits, of_reliability, of_image = torch.empty_like(logits), None, None
        shared = {"taps": logits.shape[1], "shape": image.shape}
        launch(kernels().of_logits, *saved, of_logits, **shared)
        if any(ctx.needs_input_grad[1:]):
            of_reliability, of_image = torch.empty_like(reliability), torch.empty_like(image)
            launch(kernels().of_pixels, *saved, of_reliability, of_image, **shared)
        return of_logits, of_reliability, of_image


def average(logits, reliability, image):
    return Average.apply(logits, reliability, image)
