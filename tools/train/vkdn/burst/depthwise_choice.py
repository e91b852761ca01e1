"""Whether the depthwise convolution in Triton is right here, and faster than cuDNN's, forward and backward."""
import time

import torch

from .. import depthwise
from ..blocks import depthwise_nhwc
from .common import say

# (side, channels) of a batch's maps
SHAPES = ((128, 32), (64, 128), (32, 256), (16, 512), (8, 1024))
LARGEST_ERROR = 0.02


def seconds_of(batch, side, channels, device):
    """Time of one forward and backward, in a graph: what launching costs does not count. Raises where the result is wrong."""
    layer = torch.nn.Conv2d(channels, channels, 3, padding=1, groups=channels).to(device, torch.bfloat16)
    x = torch.randn(batch, side, side, channels, device=device, dtype=torch.bfloat16, requires_grad=True)
    inputs = [x, layer.weight, layer.bias]
    g = torch.randn_like(x)
    exact = [t.detach().float().requires_grad_() for t in inputs]
    y = torch.nn.functional.conv2d(exact[0].permute(0, 3, 1, 2), *exact[1:], 1, 1, 1, channels)
    wanted = torch.autograd.grad(y.permute(0, 2, 3, 1), exact, g.float())
    once = lambda: torch.autograd.grad(depthwise_nhwc(layer, x), inputs, g)
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(2):
            got = once()
    torch.cuda.current_stream().wait_stream(stream)
    for a, b in zip(wanted, got):
        error = ((a.float() - b.float()).norm() / a.norm()).item()
        if not error < LARGEST_ERROR:
            raise ArithmeticError(f"wrong by {error:.3f} at {channels} channels")
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


def choose_depthwise(run, device, batch):
    if device.type != "cuda":
        return
    times = {}
    for yes in (False, True):
        depthwise.use(yes)
        try:
            times[yes] = sum(seconds_of(batch, *shape, device) for shape in SHAPES)
        except Exception as error:  # whatever Triton cannot do here, cuDNN can
            say("depthwise", "in Triton" if yes else "by cuDNN", "failed:", repr(error)[:300])
    depthwise.use(min(times, key=times.get, default=False))
    milliseconds = {"triton" if yes else "cudnn": round(t * 1e3, 3) for yes, t in times.items()}
    say("depthwise, ms:", milliseconds, "-> Triton" if depthwise.in_use() else "-> cuDNN")
    run.log(event="depthwise", milliseconds=milliseconds, triton=depthwise.in_use())
