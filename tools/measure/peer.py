"""What a peer of vkdenoise-bench does with its standard input and output.

It reads frames until the input ends: width, height, and whether there are albedo, normal and depth, as five little-endian
32-bit integers; then colour and the features that there are, interleaved 32-bit floats. It answers each with the denoised
colour and the CPU seconds that took, a 64-bit float.
"""
import sys
import time

import numpy as np


def read_floats(stream, *shape):
    count = int(np.prod(shape))
    data = stream.read(4 * count)
    if len(data) < 4 * count:
        raise EOFError("a frame ends early")
    return np.frombuffer(data, "<f4").reshape(shape).copy()


def frames(stream):
    while header := stream.read(20):
        width, height, *present = np.frombuffer(header, "<u4")
        color = read_floats(stream, height, width, 3)
        planes = [read_floats(stream, height, width, n) if there else None for n, there in zip((3, 3, 1), present)]
        yield color, *planes


def serve(denoise):
    """`denoise` takes colour, albedo, normal [H, W, 3] and depth [H, W, 1], None where missing; gives colour [H, W, 3]."""
    for frame in frames(sys.stdin.buffer):
        start = time.process_time()
        color = denoise(*frame)
        seconds = time.process_time() - start
        sys.stdout.buffer.write(np.ascontiguousarray(color, "<f4").tobytes() + np.float64(seconds).tobytes())
        sys.stdout.buffer.flush()
