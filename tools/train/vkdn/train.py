"""Train a network: python -m vkdn.train --data PAIRS --out RUN --hours H.

The same on a GPU, where crops lie in its memory and a step is one CUDA graph, and on a CPU. SIGINT and SIGTERM end it
with a saved checkpoint; --resume goes on from last.pt. Writes into --out: last.pt, best.pt (by mean held-out PSNR over
the numbers of samples, of the averaged weights) and log.jsonl.
"""
import json
import math
import os
import signal
import sys
import time
from dataclasses import asdict, fields, replace
from pathlib import Path

import torch

from . import checkpoint, cuda, procedural, views
from .arch import ARCHITECTURES, HEADS
from .crops import Store, arrays
from .fit import Fit, Options
from .held_out import HeldOut, score
from .kernel_choice import choose
from .model import Denoiser
from .options import options_of, parse, schedule_of
from .start import start_as_blur

# Bytes of crops on a GPU; what comes later is left out.
MOST_MEMORY = 30e9


def starting_model(args):
    """A network as asked for, with the start's weights where names and shapes agree, and the names of those that are
    new."""
    source = checkpoint.load_model(args.source)[0] if args.source else None
    arch = ARCHITECTURES[args.arch] if args.arch else source.arch if source else ARCHITECTURES["hybrid"]
    head = HEADS[args.head] if args.head else source.arch.head if source else None
    arch = replace(arch, head=head)
    model = Denoiser(arch)
    if args.blur_start:
        start_as_blur(model)
    if not source:
        return model, []
    theirs = source.state_dict()
    kept = {n: theirs[n] for n, p in model.state_dict().items() if n in theirs and theirs[n].shape == p.shape}
    if not kept:
        raise ValueError(f"{args.source} shares no weights with {arch.name}")
    model.load_state_dict(kept, strict=False)
    return model, sorted(n for n in model.state_dict() if n not in kept)


class Trainer:
    def __init__(self, args):
        self.args, self.device = args, args.device
        self.out = Path(args.out)
        self.out.mkdir(parents=True, exist_ok=True)
        self.best, self.stopped, self.mode = -math.inf, False, "eager"
        last = self.out / "last.pt"
        state = checkpoint.load(last) if args.resume and last.exists() else None
        torch.manual_seed(args.seed + (state["fit"]["steps"] if state else 0))
        model, new = (checkpoint.load_model(last)[0], []) if state else starting_model(args)
        store = self.load()
        self.fit = Fit(model, store, options_of(args))
        self.schedule = schedule_of(args, state["seconds"] if state else 0.0)
        if self.device.type == "cuda" and not args.no_graph and self.fit.capture():
            self.mode = "graph"
        if state:
            self.fit.restore(state["fit"], state["average"])
            self.best = state["best"]
        self.log(event="start", mode=self.mode, step=self.fit.steps, start=args.source, new=len(new), crops=self.crops)

    def log(self, **entry):
        line = json.dumps({"time": round(time.time(), 2), **entry})
        with open(self.out / "log.jsonl", "a") as file:
            file.write(line + "\n")
        print(line, flush=True)

    def load(self):
        """The store of crops; sets the held-out views. Kernels are chosen while procedural crops are still being made,
        and once more when the device is free."""
        args = self.args
        held_scenes = set(filter(None, args.hold_out.split(",")))
        found = views.read(args.data, held_scenes, min(16, os.cpu_count() or 1))
        held = [v for v in found if v[0]["held"]]
        trained = [v for v in found if not v[0]["held"]]
        if not held or not trained:
            raise ValueError(f"{args.data}: scenes to train on and held-out ones ({args.hold_out}) are both needed")
        self.held = HeldOut(views.crops(held), self.device)
        store, real = Store(self.device), arrays(views.crops(trained))
        store.add(real["color"], real["features"], real["reference"], real["depth_scale"], False, real["known"])
        if args.crops:
            if not args.no_triton:
                choose(self.device, args.batch, self.log)
            for crops in procedural.finished(args.crops):
                known = torch.ones(len(crops["reference"]))
                store.add(crops["color"], crops["features"], crops["reference"], crops["depth_scale"], True, known)
                if self.device.type == "cuda" and torch.cuda.memory_allocated() > MOST_MEMORY:
                    break
        store.finish()
        if not args.no_triton:
            choose(self.device, args.batch, self.log)
        self.scenes = sorted({about["scene"] for about, _ in trained})
        self.crops = {"side": store.side, "real": store.real, "procedural": store.count - store.real}
        return store

    def record(self, facts, figures):
        """What a weights file says about its training."""
        options = {f.name: getattr(self.fit.options, f.name) for f in fields(Options)}
        for name in ("parallel", "share", "threads"):
            del options[name]
        options["precision"] = str(options["precision"]).removeprefix("torch.")
        options["changes"] = asdict(options["changes"])
        return {
            "start": Path(self.args.source).name if self.args.source else "blur" if self.args.blur_start else None,
            "steps": facts["step"],
            "hours": round(facts["seconds"] / 3600, 3),
            "lr": self.args.lr,
            "warm_up": self.args.warm_up,
            "seed": self.args.seed,
            "optimizer": "Muon and AdamW",
            **options,
            "scenes": self.scenes,
            "crops": self.crops,
            "held_out": self.held.names,
            "validation": figures,
        }

    def report(self, facts):
        """Evaluates, keeps last.pt and, where it is the best so far, best.pt."""
        cuda.precise(True)
        figures = self.held.measure(self.fit.average)
        cuda.precise(False)
        reached = round(score(figures), 3)
        better, self.best = reached > self.best, max(reached, self.best)
        state = {
            "architecture": self.fit.average.arch.to_dict(),
            "average": self.fit.averaged_model().state_dict(),
            "fit": self.fit.state(),
            "seconds": self.schedule.seconds(),
            "best": self.best,
            "record": self.record(facts, figures),
        }
        checkpoint.save(self.out / "last.pt", state)
        if better:
            checkpoint.save(self.out / "best.pt", state)
        self.log(event="evaluation", mode=self.mode, **facts, **figures, mean=reached)

    def run(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: setattr(self, "stopped", True))
        if self.fit.steps == 0:
            self.report(self.fit.facts(self.schedule, 0.0))
        self.fit.run(self.schedule, self.args.check_minutes * 60, self.report, lambda: self.stopped)


def main():
    args = parse(__doc__)
    if args.threads:
        # Those that take shares of a batch wait while optimizer and evaluation run.
        torch.set_num_threads(max(args.threads, args.parallel))
    cuda.precise(False)
    try:
        trainer = Trainer(args)
    except (ValueError, OSError) as error:
        sys.exit(f"vkdn.train: {error}")
    trainer.run()


if __name__ == "__main__":
    main()
