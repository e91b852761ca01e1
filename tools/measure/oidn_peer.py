"""Intel OIDN beside vkdenoise in the stress matrix: a peer for `vkdenoise-bench stress`.

    vkdenoise-bench stress --peer 'OIDN=venv/bin/python tools/measure/oidn_peer.py' --markdown stress.md

Reads frames from standard input and writes the denoised colour to standard output, until the input ends. A frame:
width, height, and whether there are albedo, normal and depth, as five little-endian 32-bit integers; then colour and the
features that there are, interleaved 32-bit floats.
"""
import sys

import numpy as np
import pyoidn


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
        yield color, planes


def denoise(color, albedo, normal):
    """As a renderer's preview would call it. OIDN takes no depth, and a normal only beside an albedo."""
    features = {}
    if albedo is not None:
        features["albedo"] = albedo
        if normal is not None:
            features["normal"] = normal
    return pyoidn.denoise(color, **features, hdr=True, clean_aux=False, quality="high")


def main():
    for color, (albedo, normal, _) in frames(sys.stdin.buffer):
        sys.stdout.buffer.write(np.ascontiguousarray(denoise(color, albedo, normal), "<f4").tobytes())
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
