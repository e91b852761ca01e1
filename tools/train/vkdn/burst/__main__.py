"""The parent: starts the other roles, ends them by the deadline, prints the table."""
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

from . import __doc__ as about
from .common import STATE, Run, say

SILENCE = 100.0  # seconds after which a trainer counts as hung
MOST_STARTS = 5
LEAVE = 5.0  # seconds that ending takes


def die_with_parent():
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def spawn(role, args, run):
    module = f"{__package__}.{role}"
    command = [sys.executable, "-u", "-m", module, "--plan", str(args.plan), "--out", str(args.out)]
    command += ["--work", str(run.work), "--end", str(run.end), "--data-end", str(run.data_end)]
    return subprocess.Popen(command, preexec_fn=die_with_parent)


def end(process):
    if process is not None:
        if process.poll() is None:
            process.kill()
        process.wait()


def supervise(args, run):
    names = [entry["name"] for entry in run.plan["trainings"]]
    generator = spawn("generate", args, run) if run.plan.get("tracer") else None
    trainer, starts = None, 0
    try:
        while time.time() < run.end:
            if generator and (generator.poll() is not None or time.time() > run.data_end + 15):
                end(generator)
                say(f"generator ended with {generator.returncode}")
                generator = None
            if generator is None:
                run.generated.touch()
            if trainer and trainer.poll() is None and time.time() - run.beat.stat().st_mtime > SILENCE:
                say("the trainer gives no sign of life")
                end(trainer)
            if trainer and trainer.poll() is not None:
                say(f"trainer ended with {trainer.returncode}")
                if trainer.returncode != 0:
                    run.note_failure()
                trainer = None
            if trainer is None:
                state = run.state()
                left = [n for n in names if n not in state["done"] and state["failures"].get(n, 0) < 3]
                if not left or starts == MOST_STARTS:
                    break
                starts += 1
                run.beat.touch()
                trainer = spawn("train", args, run)
            time.sleep(0.1)
    finally:
        end(generator)
        end(trainer)


def main():
    p = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--plan", type=Path, required=True, help="JSON, see README.md")
    p.add_argument("--seconds", type=float, required=True, help="all in all")
    p.add_argument("--out", type=Path, required=True)
    args = p.parse_args()
    start = time.time()
    args.out.mkdir(parents=True, exist_ok=True)
    roomy = "/dev/shm" if os.path.isdir("/dev/shm") and shutil.disk_usage("/dev/shm").free > 20e9 else None
    with tempfile.TemporaryDirectory(prefix="vkdn", dir=roomy) as work:
        plan = json.loads(args.plan.read_text())
        run = Run(plan, args.out, Path(work), start + args.seconds - LEAVE, start + args.seconds * plan["data_share"])
        (run.work / STATE).write_text(json.dumps({"done": [], "failures": {}, "current": None}))
        run.log(event="start", seconds=args.seconds, plan=plan)
        supervise(args, run)
        run.table()
    for file in sorted(args.out.iterdir()):
        say(f"{file.name} {file.stat().st_size / 1e6:.2f} MB")
    say(f"{time.time() - start:.1f} s in all")


if __name__ == "__main__":
    main()
