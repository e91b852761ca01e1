"""Train a network: python -m vkdn.train --data DIR --out DIR --hours H.

Runs on the CPU or a CUDA device. SIGINT and SIGTERM end it with a saved checkpoint; --resume goes on from last.pt.
Writes into --out: last.pt, best.pt (by mean validation PSNR of the averaged weights) and log.jsonl.
"""
import argparse
import json
import math
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

import torch
from tqdm import tqdm

from . import checkpoint, weights
from .arch import ARCHITECTURES
from .blocks import FilmCnn
from .data import Augmentation, TrainingSet, load_views
from .denoise import denoise
from .losses import balanced, relative_l2
from .metrics import psnr
from .model import Denoiser
from .locality import far_moves
from .start import start_as_blur

def learning_rate(step, progress, peak, warm_up, floor=1e-6):
    """Linear warm-up by steps, times a cosine from `peak` to `floor` over `progress` 0..1."""
    cosine = floor + (peak - floor) * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
    return cosine * min(1.0, (step + 1) / warm_up)


class Budget:
    """How far the run is, 0..1: by wall time (--hours, --deadline) or by steps (--steps)."""

    def __init__(self, args, seconds_before):
        self.before, self.start, self.steps = seconds_before, time.time(), args.steps
        if args.deadline:
            self.end = datetime.fromisoformat(args.deadline).timestamp()
        else:
            self.end = self.start + args.hours * 3600 - seconds_before

    def seconds(self):
        return self.before + time.time() - self.start

    def progress(self, step):
        if self.steps:
            return step / self.steps
        return self.seconds() / max(self.seconds() + self.end - time.time(), 1e-9)


def optimizers_of(model, beta2=0.999, muon=False):
    """AdamW that decays matrices and kernels only. With `muon` the matrices go to Muon (Jordan et al. 2024), its steps
    scaled to the size of AdamW's, so that one learning rate serves both."""
    decay, keep, matrices = [], [], []
    for name, p in model.named_parameters():
        if muon and name.endswith(".weight") and p.dim() == 2:
            matrices.append(p)
        else:
            (decay if name.endswith(".weight") and p.dim() > 1 else keep).append(p)
    groups = [{"params": decay, "weight_decay": 0.02}, {"params": keep, "weight_decay": 0.0}]
    adam = torch.optim.AdamW(groups, betas=(0.9, beta2), eps=1e-8, fused=True)
    if not matrices:
        return [adam]
    return [adam, torch.optim.Muon(matrices, weight_decay=0.02, adjust_lr_fn="match_rms_adamw")]


def validate(model, views):
    """Mean PSNR of the held-out views per sample count: {spp: (noisy, denoised)}."""
    sums = {}
    for view in views:
        reference = view.reference.astype("float32")
        for spp, planes in view.noisy.items():
            planes = {n: p.astype("float32") for n, p in planes.items()}
            output = denoise(model, planes, view.frame)
            pair = (psnr(planes["color"], reference), psnr(output, reference))
            sums.setdefault(spp, []).append(pair)
    return {spp: tuple(sum(c) / len(c) for c in zip(*pairs)) for spp, pairs in sums.items()}


def starting_weights(path):
    """The state of a checkpoint's averaged weights, or of a weights file."""
    if Path(path).suffix == ".safetensors":
        return weights.read(path)[0].state_dict()
    return checkpoint.load(path)["average"]


def set_threads(count):
    """The threads of each operation; PyTorch keeps this number per calling thread."""
    if count:
        torch.set_num_threads(count)


class Trainer:
    def __init__(self, args):
        self.args = args
        self.device = torch.device(args.device)
        self.out = Path(args.out)
        self.out.mkdir(parents=True, exist_ok=True)
        self.model = Denoiser(ARCHITECTURES[args.arch]).to(self.device)
        if args.blur_start:
            start_as_blur(self.model)
        if args.source:
            self.model.load_state_dict(starting_weights(args.source))
        self.average = Denoiser(ARCHITECTURES[args.arch]).to(self.device).eval()
        self.average.load_state_dict(self.model.state_dict())
        self.parameters = list(self.model.parameters())
        self.optimizers = optimizers_of(self.model, args.beta2, args.muon)
        self.pool = ThreadPoolExecutor(args.parallel, initializer=set_threads, initargs=(args.threads,))
        self.step, self.best, before = 0, -math.inf, 0.0
        if args.resume and (self.out / "last.pt").exists():
            before = self.restore(checkpoint.load(self.out / "last.pt"))
        for module in self.model.modules():
            if isinstance(module, FilmCnn):
                module.mean_jitter = args.film_jitter
        self.budget = Budget(args, before)
        self.stopped = False
        self.validation = None

    def restore(self, state):
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        for optimizer, its_state in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(its_state)
        self.step, self.best = state["step"], state["best"]
        return state["seconds"]

    def state(self):
        return {
            "architecture": self.model.arch.to_dict(),
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizers": [o.state_dict() for o in self.optimizers],
            "step": self.step,
            "best": self.best,
            "seconds": self.budget.seconds(),
            "record": self.record(),
        }

    def record(self):
        """What a weights file says about its training."""
        args = self.args
        return {
            "scenes": sorted({v.scene for v in self.train_views}),
            "views": len(self.train_views),
            "validation_scenes": sorted({v.scene for v in self.held_out}),
            "steps": self.step,
            "batch": args.batch,
            "lr": args.lr,
            "beta2": args.beta2,
            "delta": args.delta,
            "bright": args.bright,
            "knee": args.knee,
            "muon": args.muon,
            "blur_start": args.blur_start,
            "bf16": args.bf16,
            "average_decay": args.average_decay,
            "film_jitter": args.film_jitter,
            "favour": args.favour,
            "locality": args.locality,
            "seed": args.seed,
            "hours": round(self.budget.seconds() / 3600, 2),
            "validation_psnr": self.validation,
        }

    def log(self, entry):
        with open(self.out / "log.jsonl", "a") as file:
            file.write(json.dumps(entry) + "\n")
        tqdm.write(json.dumps(entry))
        sys.stdout.flush()

    def average_weights(self):
        """Exponential moving average of the weights, shorter at the start."""
        decay = min(self.args.average_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.model.parameters()), 1 - decay)

    def share_gradients(self, share):
        """Loss and gradients of a part of a batch, already weighted by its size."""
        color, aux, target = (t.to(self.device, non_blocking=True) for t in share)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.args.bf16):
            output = self.model(color, aux)
        errors = relative_l2(output.float(), target, self.args.delta, self.args.bright)
        weight = len(color) / self.args.batch
        loss = balanced(errors, self.args.knee)
        if self.args.locality:
            loss = loss + self.args.locality * far_moves(self.model, color[:1], aux[:1])
        gradients = torch.autograd.grad(loss * weight, self.parameters)
        return errors.detach().mean().item() * weight, gradients

    def gradients(self, batch):
        """Each thread takes a share when it is free. On a CPU that others use too, this loses far less than parallel loops
        inside every operation, which wait for the slowest core a thousand times a step."""
        shares = zip(*(t.split(self.args.share or self.args.batch) for t in batch))
        losses, gradients = zip(*self.pool.map(self.share_gradients, shares))
        for more in gradients[1:]:
            torch._foreach_add_(gradients[0], more)
        return sum(losses), gradients[0]

    def train_step(self, batch):
        rate = learning_rate(self.step, self.budget.progress(self.step), self.args.lr, self.args.warm_up)
        for group in (g for o in self.optimizers for g in o.param_groups):
            group["lr"] = rate
        loss, gradients = self.gradients(batch)
        for p, gradient in zip(self.parameters, gradients):
            # The fused optimizer reads raw memory; a convolution's gradient may come with channels_last strides.
            p.grad = gradient.contiguous()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.args.clip)
        for optimizer in self.optimizers:
            optimizer.step()
        self.step += 1
        self.average_weights()
        return loss, rate

    def check(self):
        """Validate, keep last.pt and, where it is the best so far, best.pt."""
        figures = validate(self.average, self.held_out)
        self.validation = {f"{spp} spp": [round(x, 3) for x in pair] for spp, pair in figures.items()}
        mean = sum(pair[1] for pair in figures.values()) / len(figures)
        better, self.best = mean > self.best, max(mean, self.best)
        state = self.state()
        checkpoint.save(self.out / "last.pt", state)
        if better:
            checkpoint.save(self.out / "best.pt", state)
        self.log({"step": self.step, "hours": state["record"]["hours"], "psnr": self.validation, "mean": round(mean, 3)})

    def run(self):
        args = self.args
        held = set(filter(None, args.hold_out.split(",")))
        self.train_views = load_views(args.data, without=held)
        self.held_out = load_views(args.data, scenes=held)
        stream = TrainingSet(self.train_views, args.seed + self.step, Augmentation(favour=args.favour))
        ignore = lambda _: signal.signal(signal.SIGINT, signal.SIG_IGN)
        loader = torch.utils.data.DataLoader(
            stream, args.batch, num_workers=args.workers, worker_init_fn=ignore, pin_memory=self.device.type == "cuda"
        )
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: setattr(self, "stopped", True))
        checked, losses = time.time(), []
        bar = tqdm(disable=not sys.stderr.isatty(), initial=self.step, unit="step")
        for batch in loader:
            self.model.train()
            loss, rate = self.train_step(batch)
            losses.append(loss)
            bar.update()
            if self.step % args.log_every == 0:
                mean = sum(losses) / len(losses)
                losses.clear()
                seconds = round(self.budget.seconds(), 1)
                self.log({"step": self.step, "seconds": seconds, "lr": rate, "loss": round(mean, 5)})
            if time.time() - checked > args.check_minutes * 60:
                self.check()
                checked = time.time()
            if self.stopped or self.budget.progress(self.step) >= 1:
                break
        self.check()


def parse(argv=None):
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, help="<scene>/<view>/ directories of pairs")
    p.add_argument("--out", required=True, help="folder for checkpoints and the log")
    p.add_argument("--arch", default="hybrid", choices=ARCHITECTURES)
    p.add_argument("--hold-out", default="car2,classroom", help="scenes for validation, comma separated")
    p.add_argument("--hours", type=float, default=1.5, help="the schedule ends after this long in all")
    p.add_argument("--deadline", help="the schedule ends at this local time, ISO format; overrides --hours")
    p.add_argument("--steps", type=int, help="the schedule ends after this many steps; overrides both")
    p.add_argument("--batch", type=int, default=4)
    p.add_argument("--lr", type=float, default=1e-3, help="peak learning rate")
    p.add_argument("--beta2", type=float, default=0.999, help="of AdamW; less suits short runs")
    p.add_argument("--warm-up", type=int, default=200, help="steps")
    p.add_argument("--delta", type=float, default=0.5, help="relative error from which the loss is linear")
    p.add_argument("--bright", type=float, default=1.0, help="log radiance from which the loss takes errors as relative already")
    p.add_argument("--knee", type=float, default=math.inf, help="error of a sample from which it counts by its logarithm")
    p.add_argument("--muon", action="store_true", help="train the matrices with Muon")
    p.add_argument("--blur-start", action="store_true", help="start as a blur (see start.py)")
    p.add_argument("--clip", type=float, default=1.0, help="largest gradient norm")
    p.add_argument("--average-decay", type=float, default=0.998, help="of the moving average of the weights")
    p.add_argument("--locality", type=float, default=0.0, help="weight of what a single pixel moves far away (locality.py)")
    p.add_argument("--favour", type=float, default=0.3, help="a render's chance goes with its sample count to this power")
    p.add_argument("--film-jitter", type=float, default=0.3, help="largest share of another crop in a FiLM mean")
    p.add_argument("--bf16", action="store_true", help="autocast to bfloat16")
    p.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    p.add_argument("--threads", type=int, help="CPU threads of each operation")
    p.add_argument("--parallel", type=int, default=1, help="threads that work on shares of a batch (CPU)")
    p.add_argument("--share", type=int, help="crops in such a share; default: the whole batch")
    p.add_argument("--workers", type=int, default=1, help="processes that prepare samples")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--log-every", type=int, default=50, help="steps")
    p.add_argument("--check-minutes", type=float, default=5.0, help="between validations and checkpoints")
    p.add_argument("--resume", action="store_true", help="go on from last.pt")
    p.add_argument("--from", dest="source", help="checkpoint (its averaged weights) or weights file that a new run starts from")
    return p.parse_args(argv)


def main():
    args = parse()
    set_threads(args.threads)
    torch.manual_seed(args.seed)
    Trainer(args).run()


if __name__ == "__main__":
    main()
