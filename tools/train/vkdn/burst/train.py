"""Trains what the plan says and is not done yet, one network after another."""
import os
import time
import traceback
from pathlib import Path

import torch

from .. import carried, packs, weights
from ..arch import ARCHITECTURES, with_head
from ..crops import Changes, Store, arrays
from ..fit import Fit, Options
from ..held_out import HeldOut
from ..model import Denoiser
from .common import parse_role, say
from .kernel_choice import choose

OVERHEAD = 6.0  # seconds for starting a training, until one has been measured
LEAVE = 2.0
MOST_MEMORY = 30e9


def precise(yes):
    """Evaluations in full float32; training may use TF32, its operands come from bfloat16."""
    torch.backends.cudnn.benchmark = not yes
    torch.backends.cudnn.allow_tf32 = not yes
    torch.backends.cuda.matmul.allow_tf32 = not yes


def load(run, device, meanwhile):
    """The store of crops and the held-out views. Calls `meanwhile` and waits for the generator."""
    began = time.time()
    views = packs.read(run.plan["pack"], min(16, os.cpu_count() or 1), run.plan.get("views"))
    held = HeldOut([v for v in views if v[0]["held"]], device)
    real = arrays([v for v in views if not v[0]["held"]])
    store = Store(device)
    store.add(real["color"], real["features"], real["reference"], real["depth_scale"], False, real["known"])
    say(f"{len(views)} views after {time.time() - began:.1f} s")
    meanwhile()
    while not run.generated.exists():
        run.beat.touch()
        time.sleep(0.1)
    procedural = 0
    for path in run.chunks():
        try:
            crops = torch.load(path, map_location="cpu", weights_only=True)
            known = torch.ones(len(crops["reference"]))
            store.add(crops["color"], crops["features"], crops["reference"], crops["depth_scale"], True, known)
            procedural += len(known)
        except (OSError, RuntimeError, EOFError) as error:
            say("lost", path, repr(error)[:200])
        if device.type == "cuda" and torch.cuda.memory_allocated() > MOST_MEMORY:
            break
    store.finish()
    say(f"{store.real} real and {procedural} procedural crops, {len(held.names)} held-out views after {time.time() - began:.1f} s")
    return store, held


def start_of(entry, run):
    """The network to start from: weights of this run's own earlier try, else the plan's, where names and shapes agree."""
    torch.manual_seed(1)
    model = Denoiser(with_head(ARCHITECTURES[entry["arch"]], entry["head"]))
    own = run.out / f"{entry['name']}.safetensors"
    source = weights.read(own)[0] if own.exists() else carried.read(entry["start"])
    theirs = source.state_dict()
    kept = {n: theirs[n] for n, p in model.state_dict().items() if n in theirs and theirs[n].shape == p.shape}
    model.load_state_dict(kept, strict=False)
    new = sorted(n for n, _ in model.named_parameters() if n not in kept)
    say(f"{entry['name']} starts from {own.name if own.exists() else Path(entry['start']).name}; new: {len(new)} tensors")
    return model


class Training:
    """One entry of the plan."""

    def __init__(self, entry, run, store, held, graph):
        self.entry, self.run, self.store, self.held = entry, run, store, held
        plan = run.plan
        self.options = Options(
            batch=entry.get("batch", plan["batch"]),
            rate=entry.get("rate", 1e-3),
            warm_up=plan.get("warm_up", 100),
            precision=getattr(torch, plan.get("precision", "bfloat16")),
            changes=Changes(**plan.get("changes", {})),
        )
        self.fit = Fit(start_of(entry, run), store, self.options)
        self.mode = "eager"
        self.note(self.fit.facts(0, 0))
        if graph and store.device.type == "cuda" and self.fit.capture():
            self.mode = "graph"

    def note(self, facts):
        """Evaluates and logs."""
        precise(True)
        psnr = self.held.measure(self.fit.average)
        precise(False)
        self.run.beat.touch()
        self.run.log(event="evaluation", name=self.entry["name"], mode=self.mode, psnr=psnr, **facts)
        shown = " / ".join(f"{after:.2f}" for _, after in psnr.values())
        say(self.entry["name"], self.mode, {k: facts[k] for k in ("step", "seconds", "steps_per_s", "loss", "gradient")}, shown)
        return psnr

    def report(self, facts):
        psnr = self.note(facts)
        o = self.options
        record = {
            "start": Path(self.entry["start"]).name,
            "steps": facts["step"],
            "seconds": facts["seconds"],
            "batch": o.batch,
            "rate": o.rate,
            "optimizer": "Muon and AdamW",
            "bf16": o.precision == torch.bfloat16,
            "average_decay": o.average_decay,
            "changes": vars(o.changes),
            "crops": {"real": self.store.real, "procedural": self.store.count - self.store.real},
            "held_out": self.held.names,
            "validation_psnr": psnr,
        }
        path = self.run.out / f"{self.entry['name']}.safetensors"
        weights.write(path.with_suffix(".part"), self.fit.averaged_model(), record)
        os.replace(path.with_suffix(".part"), path)


def main():
    run = parse_role()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device.type == "cuda":
        say(torch.cuda.get_device_name(), torch.__version__)
    if "threads" in run.plan:
        torch.set_num_threads(run.plan["threads"])
    precise(False)
    torch.backends.cudnn.benchmark_limit = 6
    state = run.state()
    # After a failure nothing runs in Triton, after a training's second one it runs without a graph.
    consider = lambda: None if state["failures"] else choose(run, device, run.plan["batch"])
    # Once for compiling while crops are made, and once more for the times when the device is free.
    store, held = load(run, device, consider)
    consider()
    overhead = OVERHEAD
    entries = [e for e in run.plan["trainings"] if e["name"] not in state["done"]]
    for i, entry in enumerate(entries):
        tries = run.state()["failures"].get(entry["name"], 0)
        left = run.end - LEAVE - time.time() - overhead * (len(entries) - i)
        seconds = left * entry["share"] / sum(e["share"] for e in entries[i:])
        if tries > 2 or seconds < 1:
            say("no time for", entry["name"])
            continue
        run.change(current=entry["name"])
        try:
            begin = time.time()
            training = Training(entry, run, store, held, graph=tries < 2)
            overhead = max(2.0, min(20.0, time.time() - begin))
            say(f"{entry['name']}: {training.mode}, {seconds:.1f} s, started in {overhead:.1f} s")
            most = run.plan.get("most_steps", float("inf"))
            training.fit.run(seconds, run.plan["every"], training.report, most)
            run.change(done=run.state()["done"] + [entry["name"]])
        except Exception as error:  # one training must not take the others down
            traceback.print_exc()
            run.log(event="failure", name=entry["name"], error=repr(error)[:1500])
            # A device that failed once may fail at everything: the parent starts another process.
            raise SystemExit(3)
        training = None
        if device.type == "cuda":
            torch.cuda.empty_cache()
    run.change(current=None)


if __name__ == "__main__":
    main()
