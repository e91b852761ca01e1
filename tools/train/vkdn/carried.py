"""Weights in few bytes, to start from elsewhere: python -m vkdn.carried WEIGHTS.safetensors OUT.zip

A zip of LZMA entries: architecture.json and one entry a tensor, halves of seven bits of mantissa (as many as bfloat16 has, in which
training computes).
"""
import argparse
import json
import zipfile

import torch

from . import arch as arch_module
from .model import Denoiser
from .packs import bytes_to_halves, halves_to_bytes

KEPT = 7


def write(path, model):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("architecture.json", json.dumps(model.arch.to_dict()))
        for name, p in model.named_parameters():
            file.writestr(name, halves_to_bytes(p.detach().numpy(), KEPT, smooth=False))


def read(path):
    with zipfile.ZipFile(path) as file:
        model = Denoiser(arch_module.from_dict(json.loads(file.read("architecture.json"))))
        with torch.no_grad():
            for name, p in model.named_parameters():
                p.copy_(torch.from_numpy(bytes_to_halves(file.read(name), tuple(p.shape), KEPT, smooth=False)))
    return model.eval()


def main():
    from . import weights

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("weights")
    p.add_argument("output")
    args = p.parse_args()
    write(args.output, weights.read(args.weights)[0])


if __name__ == "__main__":
    main()
