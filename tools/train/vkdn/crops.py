"""All crops in the device's memory, and augmented batches made there: nothing on the host, no synchronisation, shapes
that stay, so that it can stand inside a CUDA graph. What is changed at random is that of data.py, and more (Changes).

A crop has a reference and several noisy renders, in rows of the store: one for each of LEVELS samples a pixel and, of
`hard` crops, as many more in which paths find lights by chance alone, so that most pixels are black and a few very
bright.
"""
import itertools
import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F

from . import preprocess, shaded
from .packs import FEATURES, LEVELS

KEY = preprocess.MIDDLE_GREY  # of exposed radiance
LARGEST = 65504.0  # what the store's halves hold
LN10 = math.log(10)
# Planes of a stack: colour, albedo, normal, depth, reference.
CHANNELS = 13


@dataclass
class Changes:
    """Chances and sizes of what is changed at random; jitters are standard deviations in stops (log2)."""

    favour: float = 0.3  # a render's chance goes with its sample count to this power
    blend: float = 0.5  # chance to mix two renders of a crop
    shift: int = 16  # pixels
    drop_one: float = 0.1  # chance of each feature to be missing
    drop_all: float = 0.1
    fireflies: float = 0.25
    emitters: float = 0.2
    exposure: float = 0.5  # jitter where the frame of a crop is known
    exposure_crop: float = 1.0
    depth: float = 0.2
    depth_crop: float = 0.7
    hard: float = 0.12  # chance of extreme noise: few bright samples among black ones
    hard_exposure: float = 1.5  # jitter there: the key of such a frame is a matter of luck
    grain: float = 0.12  # chance of noisy features
    real: float = 0.35  # share of rendered crops of real scenes where there are procedural ones
    clean: float = 0.0  # chance to be given the reference, or a mixture of render and reference with little noise
    clean_bare: float = 0.5  # chance of all features to be missing there
    shaded: float = 0.2  # chance of radiance computed from the features, without noise or with a known one (shaded.py)
    clean_below: float = 0.03  # what the render of most samples may be off by there (log rms): references are noisy too


class Store:
    """Crops of one size. Radiance is exposed: its key is KEY."""

    def __init__(self, device):
        self.device, self.parts = torch.device(device), []

    def add(self, color, features, reference, depth_scale, hard, known):
        """color [n, k, 3, H, W], features [n, k, 7, H, W] (albedo, normal, depth, as rendered), reference [n, 3, H,
        W]; depth_scale [n] or [n, k]; k: LEVELS, and as many more where `hard`. known: [n], whether exposure and depth
        scale are the frame's."""
        half = lambda t: torch.as_tensor(t).to(self.device, torch.float16).contiguous()
        radiance = lambda t: half(t).nan_to_num_(0.0, LARGEST, 0.0).clamp_(0, LARGEST)
        scale = torch.as_tensor(depth_scale).to(self.device, torch.float32)
        scale = scale[:, None].expand(-1, color.shape[1]) if scale.dim() == 1 else scale
        known = torch.as_tensor(known).to(self.device, torch.bool)
        features = half(features).nan_to_num_(0.0, 0.0, 0.0)
        self.parts.append((radiance(color), features, radiance(reference), scale, known, hard))

    def finish(self):
        """Real crops must have been added before procedural (`hard`) ones."""
        rows, first = [], 0
        for color, *_, hard in self.parts:
            n, k = color.shape[:2]
            own = first + torch.arange(n * k, device=self.device).view(n, k)
            rows.append(own if hard else own.repeat(1, 2))
            first += n * k
        joined = lambda i: torch.cat([part[i].flatten(0, 1) if i in (0, 1, 3) else part[i] for part in self.parts])
        self.color, self.features, self.reference = joined(0), joined(1), joined(2)
        self.depth_scale, self.known = joined(3), joined(4)
        self.rows = torch.cat(rows)
        # How far the render of most samples is from the reference, whose own noise falls and rises with it.
        pairs = zip(self.color[self.rows[:, len(LEVELS) - 1]].split(64), self.reference.split(64))
        off = lambda a, b: (a.float().log1p() - b.float().log1p()).square().mean((1, 2, 3)).sqrt()
        self.noise = torch.cat([off(*pair) for pair in pairs])
        self.count, self.side = len(self.reference), self.reference.shape[-1]
        self.real = sum(len(part[2]) for part in self.parts if not part[-1])
        self.parts = []
        return self


def arrays(views):
    """Views as `packs.read` gives them -> color [n, k, 3, H, W] exposed by the key of the most samples, features [n,
    k, 7, H, W], reference [n, 3, H, W], depth_scale [n, k], keys [n, k], known [n]: tensors."""
    keys = torch.tensor([about["keys"] for about, _ in views])
    gain = (KEY / keys[:, -1])[:, None, None, None]
    stack = lambda name: torch.stack([torch.from_numpy(planes[name]) for _, planes in views])
    color = torch.stack([(stack(f"color{spp}").float() * gain).clamp(max=LARGEST).half() for spp in LEVELS], 1)
    features = []
    for spp in LEVELS:
        parts = [stack(f"{name}{spp}") for name in FEATURES]
        features.append(torch.cat([*parts[:2], parts[2][:, None]], 1))
    return {
        "color": color,
        "features": torch.stack(features, 1),
        "reference": (stack("reference").float().clamp_min(0) * gain).clamp(max=LARGEST).half(),
        "depth_scale": torch.tensor([about["depth_scales"] for about, _ in views]),
        "keys": keys,
        "known": torch.tensor([about["frame"] for about, _ in views]),
    }


def repair(color):
    """Isolated bright pixels of exposed radiance [N, 3, H, W] take the mean of their good neighbours, as
    `preprocess.repair` has it; bad values were mended when they were stored."""
    height, width = color.shape[2:]
    brightest = color.amax(1, keepdim=True)
    padded = F.pad(brightest, (1,) * 4)
    first = second = torch.zeros_like(brightest)
    for y, x in ((y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1)):
        value = padded[:, :, y : y + height, x : x + width]
        second = torch.maximum(second, torch.minimum(first, value))
        first = torch.maximum(first, value)
    keys, ratio = preprocess.MENDED_FIREFLY
    bad = (brightest > keys * KEY) & (brightest > ratio * second)
    good = (~bad).to(color.dtype)
    around = F.avg_pool2d(torch.cat([color * good, good], 1), 3, 1, 1)
    return torch.where(bad, around[:, :3] / around[:, 3:].clamp_min(1e-6), color)


def auxiliary(features, depth_scale):
    """[N, 7, H, W] as rendered, [N] -> the network's channels in [0, 1] (`preprocess.auxiliary`)."""
    albedo, normal, depth = features.split([3, 3, 1], 1)
    valid = (depth > 0) & (depth < 65000)
    depth = torch.where(valid, (depth / depth_scale[:, None, None, None]).clamp(0, 1), torch.zeros_like(depth))
    return torch.cat([albedo.clamp(0, 1), ((normal + 1) / 2).clamp(0, 1), depth], 1)


class Batches:
    """batch(): c [N, 3, H, W], aux [N, 7, H, W], log1p of the reference [N, 3, H, W] and 1 where a crop is clean, else
    0 [N], all float32."""

    def __init__(self, store, size, changes=Changes()):
        self.store, self.size, self.changes = store, size, changes
        to = lambda values: torch.tensor(values, device=store.device)
        chances = list(itertools.accumulate(n**changes.favour for n in LEVELS))
        self.below = [chance / chances[-1] for chance in chances[:-1]]
        self.samples = to([float(n) for n in LEVELS])
        tints = to([[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]])
        rest = torch.arange(6, 10, device=store.device).expand(6, 4)
        self.tints = torch.cat([tints, tints + 3, rest, tints + 10], 1)
        self.line = torch.arange(store.side, device=store.device)
        self.row, self.column = self.line[None, :, None].float(), self.line[None, None, :].float()
        self.eight = torch.arange(8, device=store.device)[None]
        self.missing = to([0.0, 0, 0, 0.5, 0.5, 0.5, 0]).view(1, 7, 1, 1)
        procedural = store.count - store.real
        self.converged = (store.noise < changes.clean_below).nonzero().flatten()
        self.share = changes.real if 0 < store.real < store.count else float(procedural == 0)

    def random(self, *shape):
        return torch.rand(*shape, device=self.store.device)

    def below_of(self, count, *shape):
        """Random whole numbers below `count` (a number or a tensor)."""
        return (self.random(*shape) * count).long().clamp(max=count - 1)

    def chosen(self, chance):
        return self.random(self.size) < chance

    def pick(self):
        """Colour, features, reference, depth scale; masks [N]: the frame is known, the noise is extreme, there is
        hardly any, all features are missing, none is."""
        n, store, changes = self.size, self.store, self.changes
        real = self.chosen(self.share)
        clean = self.chosen(changes.clean * (len(self.converged) > 0))
        made = self.chosen(changes.shaded) & ~clean
        bare = self.chosen(changes.drop_all) | ((clean | made) & self.chosen(changes.clean_bare))
        # No torch.where between numbers: they would be copied to the device, which a graph cannot do.
        count = (real * store.real + ~real * (store.count - store.real)).clamp_min(1)
        crop = (~real * store.real + self.below_of(count, n)).clamp_max(store.count - 1)
        if len(self.converged):
            crop = torch.where(clean, self.converged[self.below_of(len(self.converged), n)], crop)
        u = self.random(n)
        one = sum((u > limit).long() for limit in self.below)
        other = self.below_of(len(LEVELS), n)
        hard = self.chosen(changes.hard) & ~clean & ~made
        # A blend weighs by sample counts: noise of levels and patterns that were not rendered.
        counts = self.samples[one], self.samples[other]
        weight = self.random(n) * counts[1] / (counts[0] + counts[1]) * self.chosen(changes.blend)
        weight = weight[:, None, None, None]
        more = hard.long() * len(LEVELS)
        i, j = (store.rows.flatten()[crop * store.rows.shape[1] + level + more] for level in (one, other))
        take = lambda t, at: t.index_select(0, at).float()
        color = torch.lerp(take(store.color, i), take(store.color, j), weight)
        features = torch.lerp(take(store.features, i), take(store.features, j), weight)
        color = torch.where((hard & real)[:, None, None, None], self.thinned(color), color)
        reference = take(store.reference, crop)
        # Of the clean ones half are the reference itself, half keep 1/2 to 1/64 of the noise.
        noise = torch.exp2(-1 - 5 * self.random(n)) * self.chosen(0.5)
        color = torch.lerp(color, reference, (clean * (1 - noise))[:, None, None, None])
        if changes.shaded:
            finest = store.rows.flatten()[crop * store.rows.shape[1] + len(LEVELS) - 1]
            radiance, told = shaded.shade(take(store.features, finest), ~bare)
            either = lambda one, other: torch.where(made[:, None, None, None], one, other)
            color, features = either(shaded.noisy(radiance), color), either(told, features)
            reference = either(radiance, reference)
        return color, features, reference, store.depth_scale[i], store.known[crop], hard, clean | made, bare, made & ~bare

    def thinned(self, color):
        """Every pixel keeps a part of its radiance and the rest by a chance of 0.3 to 30 %, then as much brighter:
        right on average, mostly dark, a few very bright."""
        n, side = self.size, self.store.side
        chance = torch.exp(LN10 * (-2.5 + 2 * self.random(n, 1, 1, 1)))
        kept = 0.5 * self.random(n, 1, 1, 1) * (self.random(n, 1, 1, 1) < 0.5)
        found = (self.random(n, 1, side, side) < chance) / chance
        return (color * (kept + (1 - kept) * found)).clamp(max=LARGEST)

    def emitters(self, color, reference):
        """A few rectangles of 2 to 12 pixels shine, in render and reference alike: small lights must not be taken for
        noise."""
        n, side = self.size, self.store.side
        count = (1 + self.below_of(3, n)) * self.chosen(self.changes.emitters)
        for k in range(3):
            size = 2 + (self.random(n, 2) * 11).floor()
            start = (self.random(n, 2) * (side - size)).floor()
            corner = lambda t: t[:, None, None]
            (top, left), (bottom, right) = start.unbind(1), (start + size).unbind(1)
            inside = (self.row >= corner(top)) & (self.row < corner(bottom))
            inside = inside & (self.column >= corner(left)) & (self.column < corner(right)) & corner(k < count)
            light = KEY * torch.exp(LN10 * (0.5 + 3.5 * self.random(n, 1))) * (0.6 + 0.4 * self.random(n, 3))
            light = light[:, :, None, None]
            color, reference = (torch.where(inside[:, None], light, t) for t in (color, reference))
        return color, reference

    def fireflies(self, color, clean):
        """A few pixels gain a tinted radiance of 10 to 10^4 keys, but in clean crops."""
        n, side = self.size, self.store.side
        count = (1 + self.below_of(8, n)) * (self.chosen(self.changes.fireflies) & ~clean)
        at = self.below_of(side * side, n, 8)
        live = (self.eight < count[:, None]).float()[:, None]
        light = KEY * torch.exp(LN10 * (1 + 3 * self.random(n, 1, 8))) * (0.3 + 0.7 * self.random(n, 3, 8)) * live
        return color.flatten(2).scatter_add(2, at[:, None].expand(n, 3, 8), light).view_as(color)

    def rotations(self):
        """Uniform random rotation matrices [N, 3, 3], from random unit quaternions."""
        q = torch.randn(self.size, 4, device=self.store.device)
        w, x, y, z = (q / q.norm(dim=1, keepdim=True).clamp_min(1e-6)).unbind(1)
        entries = [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
        return torch.stack(entries, 1).view(self.size, 3, 3)

    def moved(self, stack):
        """Moved by up to `shift` pixels with a mirrored border, one of 8 turns, red, green and blue swapped: one
        gather."""
        n, side = self.size, self.store.side
        by = self.below_of(2 * self.changes.shift + 1, n, 2) - self.changes.shift
        flip = self.random(n, 3) < 0.5

        def axis(k):
            i = (self.line[None] + by[:, k, None]).abs()
            i = torch.where(i < side, i, 2 * (side - 1) - i)
            return torch.where(flip[:, k, None], i.flip(1), i)

        y, x = axis(0), axis(1)
        here = y[:, :, None] * side + x[:, None, :]
        turned = y[:, None, :] * side + x[:, :, None]
        pixel = torch.where(flip[:, 2, None, None], turned, here).view(n, 1, -1)
        tint = self.tints[self.below_of(6, n)][:, :, None]
        index = (tint * (side * side) + pixel).view(n, -1)
        return stack.reshape(n, -1).gather(1, index).view(n, CHANNELS, side, side)

    def grainy(self, aux):
        """Noisy features, as of depth of field, motion and glass: some pixels read others up to 6 pixels away, some
        are scaled."""
        n, side = self.size, self.store.side
        share = self.random(n, 1, 1) * self.chosen(self.changes.grain)[:, None, None]
        reach = 1 + 5 * self.random(n, 1, 1)
        there = []
        for line in (self.line[:, None], self.line[None]):
            offset = ((2 * self.random(n, side, side) - 1) * reach).round().long()
            there.append((line + offset).clamp(0, side - 1))
        here = self.line[:, None] * side + self.line
        there = torch.where(self.random(n, side, side) < share, there[0] * side + there[1], here)
        aux = aux.flatten(2).gather(2, there.view(n, 1, -1).expand(n, 7, -1)).view_as(aux)
        dim = 1 - (self.random(n, 1, side, side) < share[:, None] * 0.3) * self.random(n, 1, side, side)
        return torch.cat([aux[:, :3] * dim, aux[:, 3:]], 1)

    def without(self, aux, bare, whole):
        """Each feature is missing in a tenth of the crops, but of those that are `whole`; all are in `bare` ones."""
        n = self.size
        gone = (self.random(n, 3) < self.changes.drop_one) & ~whole[:, None] | bare[:, None]
        gone = torch.cat([gone[:, :1].expand(n, 3), gone[:, 1:2].expand(n, 3), gone[:, 2:]], 1)[:, :, None, None]
        return torch.where(gone, self.missing, aux)

    @torch.no_grad()
    def batch(self):
        n, changes = self.size, self.changes
        color, features, reference, depth_scale, known, *masks = self.pick()
        hard, clean, bare, whole = masks
        color, reference = self.emitters(color, reference)
        color = repair(self.fireflies(color, clean))
        normal = torch.bmm(self.rotations(), features[:, 3:6].flatten(2)).view(n, 3, *color.shape[2:])
        stack = self.moved(torch.cat([color, features[:, :3], normal, features[:, 6:], reference], 1))
        normal_deviation = lambda: torch.randn(n, device=color.device)
        either = lambda yes, one, other: other + yes * (one - other)
        jitter = either(known, changes.exposure, changes.exposure_crop)
        jitter = either(hard, changes.hard_exposure, jitter)
        gain = torch.exp2(normal_deviation() * jitter)[:, None, None, None]
        # A frame's farthest depth is at least that of any of its crops.
        farther = torch.exp2(normal_deviation().abs() * either(known, changes.depth, changes.depth_crop))
        aux = self.without(self.grainy(auxiliary(stack[:, 3:10], depth_scale * farther)), bare, whole)
        exposed = lambda t: torch.log1p((t * gain).clamp(0, preprocess.RANGE))
        return exposed(stack[:, :3]), aux, exposed(stack[:, 10:]), clean.float()
