r"""The PyTorch definition of a network beside the engine: a peer for `vkdenoise-bench pareto`.

    vkdenoise-bench pareto PAIRS \
        --peer 'PyTorch=venv/bin/python tools/measure/pytorch_peer.py weights/hybrid_kernels.safetensors'

Eager, fp32, inference mode, 2 threads; statistics, pre- and post-processing are numpy's and count.
"""
import os
import sys

# Read when PyTorch loads. Threads that spin while they wait would count as work.
os.environ["OMP_WAIT_POLICY"] = "passive"

import torch  # noqa: E402

from kit import run_pytorch, weights  # noqa: E402
from peer import serve  # noqa: E402


def main():
    torch.set_num_threads(2)
    network = weights.read(sys.argv[1])[0]

    def denoise(color, albedo, normal, depth):
        features = {"albedo": albedo, "normal": normal, "depth": None if depth is None else depth[..., 0]}
        return run_pytorch(network, {"color": color} | {n: p for n, p in features.items() if p is not None})

    serve(denoise)


if __name__ == "__main__":
    main()
