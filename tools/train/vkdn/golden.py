"""Golden vectors: what PyTorch says a network computes, for the tests of other implementations.

    python -m vkdn.golden trained FRAME.exr OUT WEIGHTS ...    trained weights on two crops of a real frame
    python -m vkdn.golden random FRAME.exr OUT [--arch N] [--head H] [--crop C]   hash weights (see hashweights.py)

Weights are the float16 ones, the arithmetic is float64, results are float32. A crop counts as a whole frame: exposure
and depth scale are its own and stand in the metadata as decimal strings. Tensors, per case prefix ("square." or
"odd.", for random weights none):

    color, albedo, normal [H, W, 3] f16, depth [H, W] f16    the planes, as a renderer writes them
    log_color [H, W, 3] f32                                  network input c
    aux [H, W, 7] f32                                        network input, albedo, normal, depth
    residual.<architecture>[.<head>] [H, W, 3] f32           network output less c, cropped
"""
import argparse

import numpy as np
import torch
from safetensors.torch import save_file

from . import hashweights, preprocess, weights
from .arch import ARCHITECTURES, HEADS, with_head
from .denoise import prepare
from .images import read_planes
from .model import Denoiser, pad, predict

# (top, left, height, width)
CROPS = {"square": (64, 64, 128, 128), "odd": (96, 80, 45, 70)}


class Case:
    """A crop of a frame as a frame of its own."""

    def __init__(self, frame, crop):
        top, left, height, width = crop
        self.planes = {n: p[top : top + height, left : left + width] for n, p in frame.items()}
        self.stats = preprocess.statistics(self.planes["color"], self.planes["depth"])
        self.color, self.aux = (t[None] for t in prepare(self.planes, self.stats))

    def tensors(self):
        out = {n: torch.from_numpy(p.astype(np.float16)) for n, p in self.planes.items()}
        return {**out, "log_color": to_image(self.color), "aux": to_image(self.aux)}

    def metadata(self):
        stats = self.stats
        return {"exposure": repr(stats.exposure), "key": repr(stats.key), "depth_scale": repr(stats.depth_scale)}

    def residual(self, model):
        with torch.inference_mode():
            color, aux = self.color.double(), self.aux.double()
            return to_image(predict(model.double(), color, aux) - color)


def to_image(t):
    """[1, C, H, W] -> [H, W, C] float32"""
    return t[0].permute(1, 2, 0).float().contiguous()


def trained(args):
    models = [weights.read(path)[0] for path in args.weights]
    frame = read_planes(args.frame)
    tensors, about = {}, {}
    for name, crop in CROPS.items():
        case = Case(frame, crop)
        tensors |= {f"{name}.{k}": t for k, t in case.tensors().items()}
        tensors |= {f"{name}.residual.{model.arch.name}": case.residual(model) for model in models}
        about |= {f"{name}.{k}": v for k, v in case.metadata().items()}
    save_file(tensors, args.output, about)


def random(args):
    case = Case(read_planes(args.frame), CROPS[args.crop])
    tensors = case.tensors()
    chosen = {name: ARCHITECTURES[name] for name in args.arch or ARCHITECTURES}
    if args.head:
        chosen = {f"{name}.{head}": with_head(arch, head) for name, arch in chosen.items() for head in args.head}
    for name, arch in chosen.items():
        model = hashweights.fill(Denoiser(arch).eval(), args.seed)
        real = case.color.shape[2:]
        hashweights.check(model, pad(case.color, arch.multiple), pad(case.aux, arch.multiple), real)
        tensors[f"residual.{name}"] = case.residual(model)
    save_file(tensors, args.output, {**case.metadata(), "seed": str(args.seed)})


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = p.add_subparsers(required=True)
    one = commands.add_parser("trained")
    one.set_defaults(run=trained)
    two = commands.add_parser("random")
    two.add_argument("--arch", action="append", choices=ARCHITECTURES, help="may be repeated; default: all ten")
    two.add_argument("--head", action="append", choices=HEADS, help="may be repeated; default: the residual")
    two.add_argument("--crop", choices=CROPS, default="odd", help="square: 128x128, odd: 45x70, which the networks pad")
    two.add_argument("--seed", type=int, default=1)
    two.set_defaults(run=random)
    for command in (one, two):
        command.add_argument("frame", help="EXR with colour, albedo, normal and depth, at least 192x192")
        command.add_argument("output")
    one.add_argument("weights", nargs="+")
    args = p.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
