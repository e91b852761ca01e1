"""Held-out views in the device's memory, and PSNR of a network on them, as train.validate measures it."""
import torch

from . import preprocess
from .crops import KEY, LARGEST, arrays, auxiliary, repair
from .packs import LEVELS

HARD = "hard"
HARD_CHANCE = 0.03
HARD_LEVEL = 1


def psnr(image, reference):
    """[N, 3, H, W] twice -> [N] (see metrics.py)."""
    display = lambda t: torch.trunc(255 * t.clamp_min(0).double().pow(1 / 2.2).clamp(0, 1))
    error = (display(image) - display(reference)).square().mean((1, 2, 3))
    return 10 * torch.log10(255**2 / error.clamp_min(1e-12))


class HeldOut:
    """views: as packs.read gives them. Besides the levels there is "hard": four samples a pixel of which three in a hundred
    pixels hold all light, right on average; such a frame's exposure is its own."""

    def __init__(self, views, device):
        planes = arrays(views)
        self.names = [f"{about['scene']}/{about['name']}" for about, _ in views]
        color = planes["color"].float()
        keys = planes["keys"].tolist()
        chance = torch.rand(color[:, HARD_LEVEL, :1].shape, generator=torch.Generator().manual_seed(7)) < HARD_CHANCE
        hard = (color[:, HARD_LEVEL] * chance / HARD_CHANCE).clamp(max=LARGEST)
        for i, frame in enumerate(hard):
            found = preprocess.key_of(frame.permute(1, 2, 0).numpy())  # in units of the view's own exposure
            keys[i].append(found * keys[i][-1] / KEY)
        to = lambda t: t.to(device)
        self.color = to(torch.cat([color, hard[:, None]], 1))
        self.features = to(planes["features"][:, [0, 1, 2, HARD_LEVEL]].float())
        self.depth_scale = to(planes["depth_scale"][:, [0, 1, 2, HARD_LEVEL]])
        keys = torch.tensor(keys)
        # A level's own exposure over that of the stored colour, and of that over the radiance as rendered.
        self.gain = to(keys[:, [len(LEVELS) - 1]] / keys)
        self.exposure = to(KEY / keys[:, len(LEVELS) - 1])
        self.reference = to(planes["reference"].float())

    @torch.no_grad()
    def measure(self, network, at_once=6):
        """{level: (PSNR of the input, of the output)}, means over the views."""
        wide = lambda t: t[:, None, None, None]
        results = {}
        for level, name in enumerate([*map(str, LEVELS), HARD]):
            before, after = [], []
            for first in range(0, len(self.names), at_once):
                rows = slice(first, first + at_once)
                gain, exposure = wide(self.gain[rows, level]), wide(self.exposure[rows])
                color = self.color[rows, level]
                c = torch.log1p((repair(color * gain)).clamp(0, LARGEST))
                aux = auxiliary(self.features[rows, level], self.depth_scale[rows, level])
                output = torch.expm1(network(c, aux).float()).clamp_min(0) / (gain * exposure)
                reference = self.reference[rows] / exposure
                before.append(psnr(color / exposure, reference))
                after.append(psnr(output, reference))
            results[name] = tuple(round(torch.cat(t).mean().item(), 3) for t in (before, after))
        return results
