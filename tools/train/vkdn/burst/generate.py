"""Renders procedural crops into files until the time for it is over."""
import os
import time
from concurrent.futures import ThreadPoolExecutor

import torch

from ..procedural import Generator
from .common import parse_role, say

SECONDS_A_FILE = 6.0


def save(crops, path):
    torch.save(crops, path.with_suffix(".part"))
    os.replace(path.with_suffix(".part"), path)


def main():
    run = parse_role()
    begin = time.time()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    generator = Generator(run.plan["tracer"], device, seed=run.plan.get("seed", 1), reference_samples=run.plan["reference_samples"])
    say(f"tracer ready after {time.time() - begin:.1f} s")
    run.log(event="tracer", seconds=round(time.time() - begin, 1))
    n = 16 if device == "cuda" else 1
    total, file, begin = 0, 0, time.time()
    pending = []
    with ThreadPoolExecutor(1) as saver:
        while time.time() < run.data_end and total < run.plan.get("most_crops", 10000):
            start = time.time()
            crops, errors = generator.crops(n)
            total += len(errors)
            crops = {name: t.cpu() for name, t in crops.items()}
            pending.append(saver.submit(save, crops, run.work / f"crops{file:04}.pt"))
            spent = max(time.time() - start, 1e-3)
            if file % 4 == 0:
                say(f"{total} crops after {time.time() - begin:.1f} s, median log error {errors.median():.4f}, {generator.at_once} at once")
            file += 1
            # Files of some seconds, and none that takes longer than what is left.
            n = int(max(1, min(256, n * min(4.0, SECONDS_A_FILE / spent, 0.9 * max(run.data_end - time.time(), 0.1) / spent))))
        for one in pending:
            one.result()
    run.log(event="generated", crops=total, seconds=round(time.time() - begin, 1))
    say(f"{total} procedural crops")


if __name__ == "__main__":
    main()
