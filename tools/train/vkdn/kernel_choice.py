"""Whether the operations in Triton are right here, and faster than PyTorch's own, forward and backward."""
import time

import torch

from . import averages, depthwise, head
from .blocks import depthwise_nhwc

# (side, channels) of a batch's maps, (side, taps) of its means.
MAPS = ((128, 32), (64, 128), (32, 256), (16, 512), (8, 1024))
MEANS = ((128, 25), (128, 9), (64, 25), (32, 25), (16, 25), (8, 25))
LARGEST_ERROR = 0.02


def depthwise_case(batch, side, channels, device):
    """(operation, its inputs, a float32 operation to hold it against)"""
    layer = torch.nn.Conv2d(channels, channels, 3, padding=1, groups=channels).to(device, torch.bfloat16)
    x = torch.randn(batch, side, side, channels, device=device, dtype=torch.bfloat16, requires_grad=True)

    def exact(x, weight, bias):
        return torch.nn.functional.conv2d(x.permute(0, 3, 1, 2), weight, bias, 1, 1, 1, channels).permute(0, 2, 3, 1)

    return lambda x, *_: depthwise_nhwc(layer, x), [x, layer.weight, layer.bias], exact


def average_case(batch, side, taps, device):
    random = lambda channels: torch.rand(batch, channels, side, side, device=device)
    inputs = [t.requires_grad_() for t in (6 * random(taps), random(1), 3 * random(3))]
    return head.average, inputs, head.average_by_taps


def seconds_of(case, batch, side, size, device):
    """Time of one forward and backward, in a graph: what launching costs does not count. Raises where the result is
    wrong."""
    operation, inputs, exact = case(batch, side, size, device)
    wide = [t.detach().float().requires_grad_() for t in inputs]
    y = exact(*wide)
    g = torch.randn_like(y)
    wanted = [y.detach(), *torch.autograd.grad(y, wide, g)]

    def once():
        y = operation(*inputs)
        return [y.detach(), *torch.autograd.grad(y, inputs, g.to(y.dtype))]

    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(2):
            got = once()
    torch.cuda.current_stream().wait_stream(stream)
    for a, b in zip(wanted, got):
        error = ((a - b.float()).norm() / a.norm()).item()
        if not error < LARGEST_ERROR:
            raise ArithmeticError(f"wrong by {error:.3f} at {side}, {size}")
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        for _ in range(4):
            once()
    torch.cuda.synchronize()
    start = time.time()
    for _ in range(3):
        graph.replay()
    torch.cuda.synchronize()
    return (time.time() - start) / 12


def choose(device, batch, log):
    """Lets the faster of both do each operation where there is CUDA; log(event=..., ...) hears of it. Compiling takes
    a while."""
    if device.type != "cuda":
        return
    operations = ("depthwise", depthwise, depthwise_case, MAPS), ("means", averages, average_case, MEANS)
    for name, module, case, sizes in operations:
        times, failed, begin = {}, {}, time.time()
        for yes in (False, True):
            module.use(yes)
            try:
                times[yes] = 0.0
                for size in sizes:
                    times[yes] += seconds_of(case, batch, *size, device)
            except Exception as error:  # whatever Triton cannot do here, PyTorch can
                del times[yes]
                failed["triton" if yes else "pytorch"] = repr(error)[:300]
        module.use(min(times, key=times.get, default=False))
        milliseconds = {"triton" if yes else "pytorch": round(t * 1e3, 3) for yes, t in times.items()}
        spent = round(time.time() - begin, 1)
        log(event="kernels", name=name, milliseconds=milliseconds, failed=failed, triton=module.in_use(), seconds=spent)
