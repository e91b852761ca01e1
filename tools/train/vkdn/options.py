"""The trainer's command line."""
import argparse
import math
from dataclasses import fields

import torch

from .arch import ARCHITECTURES, HEADS
from .crops import Changes
from .fit import Options
from .schedule import Schedule, deadline_of

PRECISIONS = {"float32": torch.float32, "bfloat16": torch.bfloat16}


def parser(about):
    p = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    device = "cuda" if torch.cuda.is_available() else "cpu"

    def number(group, name, text):
        """An option of a step, with its default there."""
        default = getattr(Options(), name[2:].replace("-", "_"))
        group.add_argument(name, type=float, default=default, metavar="X", help=f"{text} ({default})")

    changes = ", ".join(f"{f.name}={f.default}" for f in fields(Changes))
    data = p.add_argument_group("data").add_argument
    data("--data", required=True, help="<scene>/<view>/ folders of pairs, or a pack of them (vkdn.packs)")
    data("--crops", help="folder of procedural crops (vkdn.procedural); waited for while they are being made")
    data("--hold-out", default="car2,classroom", help="scenes for validation, comma separated")
    data("--change", action="append", default=[], metavar="NAME=NUMBER", help=f"what is changed at random: {changes}")
    run = p.add_argument_group("the run").add_argument
    run("--out", required=True, help="folder for checkpoints and the log")
    run("--from", dest="source", help="checkpoint (its averaged weights), weights file or carried weights as a start")
    run("--arch", choices=ARCHITECTURES, help="default: that of --from, or hybrid")
    run("--head", choices=HEADS, help="default: that of --from, or residual; what a start does not have is new")
    run("--blur-start", action="store_true", help="start as a blur (see start.py)")
    run("--resume", action="store_true", help="go on from last.pt, where there is one")
    run("--hours", type=float, default=1.5, help="the schedule ends after this long in all")
    run("--deadline", type=deadline_of, help="it ends at this local time (ISO format or second of the epoch) instead")
    run("--steps", type=int, help="it ends after this many steps instead")
    run("--check-minutes", type=float, default=5.0, help="between evaluations, each with a checkpoint")
    run("--seed", type=int, default=1)
    step = p.add_argument_group("a step")
    step.add_argument("--batch", type=int, default=32 if device == "cuda" else 4)
    step.add_argument("--lr", type=float, default=1e-3, help="peak learning rate")
    step.add_argument("--warm-up", type=int, default=100, help="steps")
    number(step, "--beta2", "of AdamW; more suits long runs")
    number(step, "--clip", "largest gradient norm")
    number(step, "--head-gain", "the head's learning rate, of the rest's")
    number(step, "--average-decay", "of the moving average of the weights")
    number(step, "--film-jitter", "largest share of another crop in a FiLM mean")
    loss = p.add_argument_group("the loss (losses.py, locality.py)")
    number(loss, "--delta", "relative error from which it is linear")
    number(loss, "--bright", "log radiance from which errors count as relative already")
    number(loss, "--knee", "error of a crop from which it counts by its logarithm; inf: never")
    number(loss, "--energy", "weight of the energy of blocks beside the error of pixels")
    number(loss, "--clean-weight", "how many times the error of a clean crop counts")
    number(loss, "--locality", "weight of what a single pixel moves far away")
    machine = p.add_argument_group("the machine").add_argument
    machine("--device", type=torch.device, default=device, help="cuda or cpu")
    machine("--precision", choices=PRECISIONS, help="default: bfloat16 on a GPU, float32 on a CPU")
    machine("--threads", type=int, help="CPU threads of each operation")
    machine("--parallel", type=int, default=1, help="CPU threads that work on shares of a batch")
    machine("--share", type=int, help="crops in such a share; default: the whole batch")
    machine("--no-graph", action="store_true", help="CUDA: no step as one graph")
    machine("--no-triton", action="store_true", help="CUDA: no operations in Triton")
    return p


def parse(about, argv=None):
    p = parser(about)
    args = p.parse_args(argv)
    kinds = {f.name: f.type for f in fields(Changes)}
    changes = {}
    for change in args.change:
        name, _, value = change.partition("=")
        if name not in kinds:
            p.error(f"--change {change}: there are {', '.join(kinds)}")
        try:
            changes[name] = kinds[name](value)
        except ValueError:
            p.error(f"--change {change}: {value!r} is no {kinds[name].__name__}")
    args.changes = Changes(**changes)
    args.precision = PRECISIONS[args.precision or ("bfloat16" if args.device.type == "cuda" else "float32")]
    if not 0 < args.lr < math.inf or args.batch < 1 or (args.share is not None and args.share < 1):
        p.error("--lr, --batch and --share are above 0")
    if args.source and args.blur_start:
        p.error("--from and --blur-start are two starts")
    return args


def options_of(args):
    """What a step depends on."""
    return Options(**{f.name: getattr(args, f.name) for f in fields(Options)})


def schedule_of(args, before):
    """before: seconds spent by earlier runs of this training."""
    return Schedule(args.lr, args.warm_up, hours=args.hours, deadline=args.deadline, steps=args.steps, before=before)
