"""Procedural crops by a path tracer (its folder is given; see README): noisy renders, features and references of
random scenes.

    python -m vkdn.procedural --tracer DIR --out CROPS --seconds 100     # or --crops 500

Goes on in a folder that has some: with another --seed, or they would be the same. Writes files of crops as
`crops.Store.add` takes them; a training may wait for the last (`finished`).
"""
import argparse
import math
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import torch

from .packs import LEVELS

REFERENCE_SAMPLES = 256
NOISIEST_REFERENCE = 0.25  # log rms
DARKEST = 1e-3
CANDIDATES = 3.2  # random views for one worth rendering
SECONDS_A_FILE = 6.0
COMPLETE = "complete"
AHEAD = 3.0  # seconds of rendering at once: many crops fill a GPU to the end better than few


def tracer(folder, device):
    sys.path.insert(0, str(folder))
    from pathtrace import Tracer

    return Tracer(device)


class Generator:
    """crops(n): {color [n, 6, 3, H, W], features [n, 6, 7, H, W], reference [n, 3, H, W], depth_scale [n]}, halves,
    radiance exposed.

    The first three renders sample the lights, the others find them by chance alone: extreme noise with the same mean.
    """

    def __init__(self, folder, device, seed=1, reference_samples=REFERENCE_SAMPLES):
        self.tracer = tracer(folder, device)
        self.device, self.seed, self.half_samples = torch.device(device), seed, reference_samples // 2
        self.round, self.at_once = 0, 16 if self.device.type == "cuda" else 1
        self.found = []

    def scenes(self, n):
        """n scenes worth rendering, exposure factors, depth scales."""
        while sum(len(found[0]) for found in self.found) < n:
            missing = n - sum(len(found[0]) for found in self.found)
            count = min(4096, max(16, int(CANDIDATES * missing)))
            self.found.append(self.tracer.candidates(count, (self.seed * 1000003 + self.round * 7919) & 0x7FFFFFFF))
            self.round += 1
        joined = [torch.cat(parts) for parts in zip(*self.found)]
        self.found = [[t[n:] for t in joined]]
        return [t[:n].contiguous() for t in joined]

    def synchronize(self):
        if self.device.type == "cuda":
            torch.cuda.synchronize()

    def render(self, scenes, exposure, depth_scale):
        """One launch for renders and the halves of the reference, one for renders without light sampling."""
        samples = [*LEVELS, self.half_samples, self.half_samples]
        usual = self.tracer.render(scenes, samples, exposure, net_from=len(LEVELS))
        hard = self.tracer.render(scenes, list(LEVELS), exposure, salt=5, nee=0)
        noisy = torch.cat([usual[:, : len(LEVELS)], hard], 1)
        one, other = usual[:, len(LEVELS), :3], usual[:, len(LEVELS) + 1, :3]
        reference = (one + other) / 2
        error = ((one.log1p() - other.log1p()).square().mean((1, 2, 3)) / 4).sqrt()
        good = (error < NOISIEST_REFERENCE) & (reference.mean((1, 2, 3)) > DARKEST)
        good &= torch.isfinite(reference).flatten(1).all(1)
        half = lambda t: t.clamp(-65504, 65504)[good].half()
        crops = {
            "color": half(noisy[:, :, :3]),
            "features": half(noisy[:, :, 3:10]),
            "reference": half(reference),
            "depth_scale": depth_scale[good],
        }
        return crops, error[good]

    def crops(self, n):
        parts, errors = [], []
        while n > 0:
            count = min(n, self.at_once)
            start = time.time()
            part, error = self.render(*self.scenes(count))
            self.synchronize()
            if count == self.at_once and self.device.type == "cuda":
                self.at_once = int(min(128, max(4, count * min(2.0, AHEAD / (time.time() - start)))))
            parts.append(part)
            errors.append(error)
            n -= count
        joined = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        return joined, torch.cat(errors)


def save(crops, path):
    torch.save(crops, path.with_suffix(".part"))
    os.replace(path.with_suffix(".part"), path)


def write(generator, folder, deadline, most, at_once):
    """Files of some seconds' crops, and none that takes longer than what is left. -> how many crops"""
    count, file, total, begin = at_once, len(list(folder.glob("crops*.pt"))), 0, time.time()
    pending = []
    with ThreadPoolExecutor(1) as saver:
        while time.time() < deadline and total < most:
            start = time.time()
            crops, errors = generator.crops(min(count, most - total) if most < math.inf else count)
            total += len(errors)
            crops = {name: t.cpu() for name, t in crops.items()}
            pending.append(saver.submit(save, crops, folder / f"crops{file:04}.pt"))
            file += 1
            now = time.time()
            spent, left = max(now - start, 1e-3), max(deadline - now, 0.1)
            count = int(max(1, min(256, count * min(4.0, SECONDS_A_FILE / spent, 0.9 * left / spent))))
            print(f"{total} crops after {now - begin:.1f} s, median log error {errors.median():.4f}", flush=True)
        for one in pending:
            one.result()
    return total


def finished(folder, poll=0.1):
    """Yields every file's crops of a folder once it says that no more come."""
    folder = Path(folder)
    while not (folder / COMPLETE).exists():
        time.sleep(poll)
    for path in sorted(folder.glob("crops*.pt")):
        yield torch.load(path, map_location="cpu", weights_only=True)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--tracer", required=True, help="folder of pathtrace.py and its kernels")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--seconds", type=float, default=math.inf)
    p.add_argument("--crops", type=float, default=math.inf, help="at most so many")
    p.add_argument("--reference-samples", type=int, default=REFERENCE_SAMPLES)
    p.add_argument("--seed", type=int, default=1)
    args = p.parse_args()
    if args.seconds == args.crops == math.inf:
        p.error("--seconds or --crops is needed")
    deadline = time.time() + args.seconds
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / COMPLETE).unlink(missing_ok=True)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        generator = Generator(args.tracer, device, args.seed, args.reference_samples)
        write(generator, args.out, deadline, args.crops, 16 if device == "cuda" else 1)
    finally:
        # Whatever happened: who waits for crops goes on with those that are there.
        (args.out / COMPLETE).touch()


if __name__ == "__main__":
    main()
