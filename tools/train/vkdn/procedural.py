"""Procedural crops by the path tracer that lies beside the data (its folder is given; see README): noisy renders, features and
references of random scenes, as `crops.Store.add` takes them.
"""
import sys
import time

import torch

from .packs import LEVELS

REFERENCE_SAMPLES = 256
NOISIEST_REFERENCE = 0.25  # log rms
DARKEST = 1e-3
CANDIDATES = 3.2  # random views for one worth rendering
AHEAD = 3.0  # seconds of rendering at once: many crops fill a GPU to the end better than few


def tracer(folder, device):
    sys.path.insert(0, str(folder))
    from pathtrace import Tracer

    return Tracer(device)


class Generator:
    """crops(n): {color [n, 6, 3, H, W], features [n, 6, 7, H, W], reference [n, 3, H, W], depth_scale [n]}, halves, radiance exposed.

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
        usual = self.tracer.render(scenes, [*LEVELS, self.half_samples, self.half_samples], exposure, net_from=len(LEVELS))
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
