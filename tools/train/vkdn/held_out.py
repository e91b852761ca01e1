"""Held-out views in the device's memory, and what a network makes of them: as `evaluate` and tools/measure/neutral.py
measure it."""
import torch

from . import preprocess, shaded
from .crops import KEY, LARGEST, arrays, auxiliary, repair
from .packs import LEVELS

HARD = "hard"
HARD_CHANCE = 0.03
HARD_LEVEL = 1
# Relative deviation of the noise that shaded crops are given.
SHADED_NOISE = 0.06


def psnr(image, reference):
    """[N, 3, H, W] twice -> [N] (see metrics.py)."""
    display = lambda t: torch.trunc(255 * t.clamp_min(0).double().pow(1 / 2.2).clamp(0, 1))
    error = (display(image) - display(reference)).square().mean((1, 2, 3))
    return 10 * torch.log10(255**2 / error.clamp_min(1e-12))


class HeldOut:
    """views: as views.read gives them, of one size. Besides the levels there is "hard": four samples a pixel of which
    three in a hundred pixels hold all light, right on average; such a frame's exposure is its own."""

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
        self.shaded = self.shade()

    def shade(self):
        """Radiance without noise, the same with some, features: the same at every start."""
        with torch.random.fork_rng():
            torch.manual_seed(7)
            finest = self.features[:, len(LEVELS) - 1].cpu()
            radiance, features = shaded.shade(finest, torch.ones(len(finest), dtype=torch.bool))
            noisy = radiance * (1 + SHADED_NOISE * torch.randn(len(radiance), 1, *radiance.shape[2:])).clamp_min(0)
        return [t.to(self.color.device) for t in (radiance, noisy, features)]

    def parts(self, at_once):
        """Slices of the views; the reference of each as rendered, and the factor that exposes it as the store has
        it."""
        for first in range(0, len(self.names), at_once):
            rows = slice(first, first + at_once)
            exposure = wide(self.exposure[rows])
            yield rows, self.reference[rows] / exposure, exposure

    @torch.no_grad()
    def measure(self, network, at_once=6):
        """{"psnr": {level: (of the input, of the output)}, "energy": {level: by what share of the input's the output's
        mean is off, as a mean of sizes}, "clean": the reference given at exposure 1 without features: {"change": root
        mean square of the change, of the mean, "psnr": to itself}, "shaded": of radiance without any noise the same,
        and with a little {"noisy": PSNR of the input, of the output}}; means over the views."""
        figures = {"psnr": {}, "energy": {}}
        for level, name in enumerate([*map(str, LEVELS), HARD]):
            before, after, off = [], [], []
            for rows, reference, exposure in self.parts(at_once):
                gain, color = wide(self.gain[rows, level]), self.color[rows, level]
                aux = auxiliary(self.features[rows, level], self.depth_scale[rows, level])
                output = denoised(network, color * gain, aux) / (gain * exposure)
                color = color / exposure
                before.append(psnr(color, reference))
                after.append(psnr(output, reference))
                off.append((output.mean((1, 2, 3)) / color.mean((1, 2, 3)) - 1).abs())
            figures["psnr"][name] = tuple(mean(t, 3) for t in (before, after))
            figures["energy"][name] = mean(off, 5)
        return figures | {"clean": self.clean(network, at_once), "shaded": self.shaded_figures(network, at_once)}

    def shaded_figures(self, network, at_once):
        changes, itself, before, after = [], [], [], []
        for first in range(0, len(self.names), at_once):
            rows = slice(first, first + at_once)
            radiance, noisy, features = (t[rows] for t in self.shaded)
            aux = auxiliary(features, self.depth_scale[rows, len(LEVELS) - 1])
            output = denoised(network, radiance, aux)
            changes.append((output - radiance).square().mean((1, 2, 3)).sqrt() / radiance.mean((1, 2, 3)))
            itself.append(psnr(output, radiance))
            before.append(psnr(noisy, radiance))
            after.append(psnr(denoised(network, noisy, aux), radiance))
        return {"change": mean(changes, 5), "psnr": mean(itself, 2), "noisy": (mean(before, 2), mean(after, 2))}

    def clean(self, network, at_once):
        changes, itself = [], []
        for _, reference, _ in self.parts(at_once):
            count = len(reference)
            missing = auxiliary(torch.zeros_like(self.features[:count, 0]), self.depth_scale[:count, 0])
            output = denoised(network, reference, missing)
            changes.append((output - reference).square().mean((1, 2, 3)).sqrt() / reference.mean((1, 2, 3)))
            itself.append(psnr(output, reference))
        return {"change": mean(changes, 5), "psnr": mean(itself, 2)}


def wide(t):
    return t[:, None, None, None]


def mean(parts, digits):
    return round(torch.cat(parts).mean().item(), digits)


def denoised(network, color, aux):
    """Exposed radiance [N, 3, H, W] -> denoised."""
    c = torch.log1p(repair(color).clamp(0, preprocess.RANGE))
    return torch.expm1(network(c, aux).float()).clamp_min(0)


def score(figures):
    """What the best checkpoint is chosen by: the mean PSNR over the numbers of samples."""
    return sum(after for name, (_, after) in figures["psnr"].items() if name != HARD) / len(LEVELS)
