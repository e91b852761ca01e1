"""What the roles share: the plan, the clock, files that say how far things are, the log."""
import argparse
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path

STATE = "state.json"
START = "start"


def say(*words):
    print(f"[{time.strftime('%H:%M:%S')}]", *words, flush=True)


@dataclass
class Run:
    """end, data_end: times (seconds since the epoch) by which all, and the making of data, is over."""

    plan: dict
    out: Path
    work: Path
    end: float
    data_end: float

    @property
    def beat(self):
        """Touched by the trainer while it lives."""
        return self.work / "beat"

    @property
    def generated(self):
        """There once no more crops come."""
        return self.work / "generated"

    def chunks(self):
        return sorted(self.work.glob("crops*.pt"))

    def state(self):
        """{"done": [name], "failures": {name: how often}, "current": name or None}; failures of START came before any training"""
        return json.loads((self.work / STATE).read_text())

    def change(self, **changes):
        beside = self.work / (STATE + ".part")
        beside.write_text(json.dumps(self.state() | changes))
        os.replace(beside, self.work / STATE)

    def note_failure(self):
        """Of the training that was current, or of the start before there was one."""
        state = self.state()
        name = state["current"] or START
        self.change(failures=state["failures"] | {name: state["failures"].get(name, 0) + 1})

    def log(self, **record):
        with open(self.out / "log.jsonl", "a") as file:
            file.write(json.dumps({"time": round(time.time(), 2), **record}) + "\n")

    def table(self):
        """Every training's first and last evaluation, as table.md and on the screen."""
        rows = {}
        for line in open(self.out / "log.jsonl"):
            record = json.loads(line)
            if record["event"] == "evaluation":
                rows.setdefault(record["name"], []).append(record)
        lines = ["| training | mode | steps | a second | seconds | PSNR at the start | at the end | loss |", "|---" * 8 + "|"]
        psnr = lambda record: " / ".join(f"{after:.2f}" for _, after in record["psnr"].values())
        for name, records in rows.items():
            first, last = records[0], records[-1]
            losses = [r["loss"] for r in records if r.get("loss")]
            span = f"{losses[0]:.5f} to {losses[-1]:.5f}" if losses else ""
            facts = [name, last["mode"], last["step"], last.get("steps_per_s", 0), last.get("seconds", 0), psnr(first), psnr(last), span]
            lines.append("| " + " | ".join(map(str, facts)) + " |")
        lines.append("PSNR of held-out views at 1, 4 and 32 samples and under extreme noise, of the averaged weights.")
        text = "\n".join(lines) + "\n"
        (self.out / "table.md").write_text(text)
        print(text, flush=True)


def parse_role():
    """The run that a role's command line tells."""
    p = argparse.ArgumentParser()
    p.add_argument("--plan", type=Path, required=True)
    p.add_argument("--out", type=Path, required=True)
    p.add_argument("--work", type=Path, required=True)
    p.add_argument("--end", type=float, required=True)
    p.add_argument("--data-end", type=float, required=True)
    args = p.parse_args()
    return Run(json.loads(args.plan.read_text()), args.out, args.work, args.end, args.data_end)
