"""Several trainings in a few minutes, on a GPU that is lent: crops are made, networks trained one after another, all
by a deadline.

    python -m vkdn.burst --plan plan.json --seconds 430 --out OUT

Starts vkdn.procedural and vkdn.train as processes of their own, so that none takes the others down. A training that
dies or falls silent goes on from its last checkpoint, at first without Triton, then without a graph as well.
OUT/<name>.safetensors are the results, OUT/table.md and OUT/log.jsonl tell how they came about. The plan is JSON; its
paths are relative to it:

    {
      "crops": {"share": 0.25, "arguments": ["--tracer", "tracer"]},      share: of the time; may be missing
      "train": ["--data", "pairs.zip", "--knee", "0.002"],                arguments of every training
      "trainings": [{"name": "high", "share": 2, "arguments": ["--from", "high.zip"]}, ...]
    }
"""
import argparse
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from . import checkpoint, weights
from .procedural import COMPLETE

SILENCE = 100.0  # seconds after which a trainer counts as hung
LATE = 15.0  # seconds that the last crops may take longer
LEAVE = 5.0  # seconds that writing results and ending take
KIT = Path(__file__).resolve().parent.parent
FALLBACKS = ([], ["--no-triton"], ["--no-triton", "--no-graph"])


def say(*words):
    print(f"[{time.strftime('%H:%M:%S')}]", *words, flush=True)


def die_with_parent():
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def spawn(module, arguments, folder):
    """A module of the kit as a process in the plan's folder."""
    command = [sys.executable, "-u", "-m", f"{__package__}.{module}", *map(str, arguments)]
    paths = [str(KIT), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    return subprocess.Popen(command, cwd=folder, env=environment, preexec_fn=die_with_parent)


def end(process):
    if process is not None:
        if process.poll() is None:
            process.kill()
        process.wait()


class Maker:
    """Makes procedural crops into `folder` until `until`; one that is late is ended, so that nobody waits for it for
    ever."""

    def __init__(self, plan, start, seconds, folder, out):
        self.folder, self.until, self.process = out / "runs" / "crops", start, None
        if "crops" in plan:
            spend = seconds * plan["crops"]["share"]
            self.until = start + spend + LATE
            arguments = [*plan["crops"]["arguments"], "--out", self.folder, "--seconds", spend]
            self.process = spawn("procedural", arguments, folder)

    def arguments(self):
        """Of a training that is to use its crops."""
        return ["--crops", self.folder] if self.process else []

    def check(self):
        if self.process and time.time() > self.until and not (self.folder / COMPLETE).exists():
            say("the maker of crops is ended")
            end(self.process)
            self.folder.mkdir(exist_ok=True)
            (self.folder / COMPLETE).touch()


def wait(process, log, until, maker):
    """Waits for a trainer; ends it when it says nothing in `log` for SILENCE seconds (it may wait for crops) or when
    time is up. -> whether it ended well"""
    silent_from = max(time.time(), maker.until)
    while process.poll() is None:
        maker.check()
        heard = log.stat().st_mtime if log.exists() else 0.0
        if time.time() > until or time.time() - max(heard, silent_from) > SILENCE:
            say("a trainer is ended:", "time is up" if time.time() > until else "it gives no sign of life")
            end(process)
            break
        time.sleep(0.1)
    return process.returncode == 0


def train(entry, plan, folder, out, deadline, maker):
    """One entry of the plan, started again where it fails; its weights go to `out`."""
    run = out / "runs" / entry["name"]
    run.mkdir(parents=True, exist_ok=True)
    common = [*plan["train"], *entry.get("arguments", []), "--out", run, "--deadline", deadline, "--resume"]
    for fallback in FALLBACKS:
        if time.time() > deadline:
            break
        process = spawn("train", [*common, *maker.arguments(), *fallback], folder)
        try:
            ended = wait(process, run / "log.jsonl", deadline + LEAVE, maker)
        finally:
            end(process)
        say(f"{entry['name']} ended with {process.returncode}")
        if ended:
            break
    last = run / "last.pt"
    if last.exists():
        model, record = checkpoint.load_model(last)
        weights.write(out / f"{entry['name']}.safetensors", model, record)


def table(out, names):
    """Every training's first and last evaluation, as Markdown."""
    columns = ["training", "mode", "steps", "a second", "seconds", "PSNR at the start", "at the end"]
    columns += ["clean change", "loss"]
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    psnr = lambda record: " / ".join(f"{after:.2f}" for _, after in record["psnr"].values())
    for name in names:
        records = evaluations(out / "runs" / name / "log.jsonl")
        if not records:
            continue
        first, last = records[0], records[-1]
        losses = [r["loss"] for r in records if r["loss"]]
        span = f"{losses[0]:.5f} to {losses[-1]:.5f}" if losses else ""
        clean = f"{first['clean']['change']:.4f} to {last['clean']['change']:.4f}"
        facts = [name, *(last[key] for key in ("mode", "step", "steps_per_s", "seconds"))]
        facts += [psnr(first), psnr(last), clean, span]
        lines.append("| " + " | ".join(map(str, facts)) + " |")
    lines += ["", "PSNR of held-out views at 1, 4 and 32 samples and under extreme noise, and what clean ones change by."]
    return "\n".join(lines) + "\n"


def evaluations(log):
    if not log.exists():
        return []
    return [r for r in map(json.loads, log.read_text().splitlines()) if r["event"] == "evaluation"]


def run(plan, folder, out, start, seconds):
    """All trainings of the plan, each with its share of what time is left when it starts."""
    over = start + seconds - LEAVE
    maker = Maker(plan, start, seconds, folder, out)
    try:
        entries = plan["trainings"]
        for i, entry in enumerate(entries):
            # The first one begins when there are crops.
            now = max(time.time(), maker.until if i == 0 else 0)
            share = entry["share"] / sum(e["share"] for e in entries[i:])
            train(entry, plan, folder, out, now + share * (over - now), maker)
    finally:
        end(maker.process)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--plan", type=Path, required=True)
    p.add_argument("--seconds", type=float, required=True, help="all in all")
    p.add_argument("--out", type=Path, required=True)
    args = p.parse_args()
    start, out = time.time(), args.out.resolve()
    plan = json.loads(args.plan.read_text())
    names = [entry["name"] for entry in plan["trainings"]]
    roomy = "/dev/shm" if os.path.isdir("/dev/shm") and shutil.disk_usage("/dev/shm").free > 20e9 else None
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="vkdn", dir=roomy) as work:
        (out / "runs").symlink_to(work)
        try:
            run(plan, args.plan.resolve().parent, out, start, args.seconds)
            text = table(out, names)
            (out / "table.md").write_text(text)
            print(text, flush=True)
            logs = ((name, out / "runs" / name / "log.jsonl") for name in names)
            logs = ((name, log.read_text().splitlines()) for name, log in logs if log.exists())
            lines = [json.dumps({"name": name} | json.loads(line)) for name, log in logs for line in log]
            (out / "log.jsonl").write_text("\n".join(lines) + "\n")
        finally:
            (out / "runs").unlink()
    for file in sorted(out.iterdir()):
        say(f"{file.name} {file.stat().st_size / 1e6:.2f} MB")
    say(f"{time.time() - start:.1f} s in all")


if __name__ == "__main__":
    main()
