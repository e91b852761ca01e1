"""Crops without noise: the features of a real crop under lights that are made up, with a noise of known size.

References are noisy themselves, and a network that is to leave them as they are learns to leave others' noise alone.
Radiance that is computed from albedo and normal has none: what is added is all there is to remove, and fine texture is
all there is to keep. It is there only where features tell of it: without them nothing tells a grain from noise, and
what is learned from such crops is to leave noise alone.
"""
import math

import torch
import torch.nn.functional as F

from .preprocess import MIDDLE_GREY

LIGHTS = 3  # the first from everywhere alike
DARKEST_ALBEDO = 0.02
STRONGEST_GRAIN = 0.8
# Of all noisy ones, in powers of 2 of the relative deviation.
MOST_NOISE, LEAST_NOISE = 0.0, -6.0
# Waves of a shadow over a crop, in powers of 2.
FEWEST_WAVES, MOST_WAVES = 0.0, 4.0


def uniform(like, *shape):
    return torch.rand(*shape, device=like.device)


def grain(features, grained):
    """Factors of albedo [N, 1, H, W] in (0, 1]: textures of one to three pixels, strong, weak or none; 1 where the crop
    is not to be `grained` [N]."""
    n, _, height, width = features.shape
    white = uniform(features, n, 1, height, width)
    soft = F.avg_pool2d(F.pad(white, (1,) * 4, mode="replicate"), 3, 1)
    blend = uniform(features, n, 1, 1, 1)
    texture = (0.5 + (white - 0.5) * blend + 3 * (soft - 0.5) * (1 - blend)).clamp(0, 1)
    strength = STRONGEST_GRAIN * uniform(features, n, 1, 1, 1).square() * (uniform(features, n, 1, 1, 1) < 0.7)
    return 1 - strength * texture * grained[:, None, None, None]


def shadows(features):
    """[N, 1, H, W] in [0, 1]: stripes and, in half of the crops, checkers, with soft or sharp edges, of which no
    feature tells."""
    n, _, height, width = features.shape
    number = lambda: uniform(features, n, 1, 1, 1)
    wave = 2 * math.pi * torch.exp2(FEWEST_WAVES + (MOST_WAVES - FEWEST_WAVES) * number()) / max(height, width)
    turn = 2 * math.pi * number()
    y, x = (torch.arange(size, device=features.device, dtype=torch.float32) for size in (height, width))
    y, x = y[None, None, :, None], x[None, None, None]
    sine = lambda across, down: torch.sin(wave * (across * x + down * y) + 2 * math.pi * number())
    stripes = sine(turn.cos(), turn.sin())
    checkers = stripes * sine(-turn.sin(), turn.cos())
    sharpness = torch.exp2(6 * number() - 1)
    striped = (number() < 0.5).float()
    return torch.sigmoid(sharpness * (striped * (stripes + 0.5) + (1 - striped) * checkers))


def shade(features, grained):
    """[N, 7, H, W] as rendered, [N] -> (radiance of key MIDDLE_GREY [N, 3, H, W], features with its albedo)."""
    n = len(features)
    albedo = features[:, :3].clamp(0, 1) * grain(features, grained)
    normal = F.normalize(features[:, 3:6], dim=1, eps=1e-3)
    light = torch.zeros_like(albedo)
    for i in range(LIGHTS):
        power = torch.exp2(2 * torch.randn(n, 1, 1, 1, device=features.device))
        color = power * (0.5 + 0.5 * uniform(features, n, 3, 1, 1))
        if i == 0:
            light = light + 0.3 * color
        else:
            toward = F.normalize(torch.randn(n, 3, 1, 1, device=features.device), dim=1, eps=1e-3)
            light = light + color * (normal * toward).sum(1, keepdim=True).clamp_min(0) * shadows(features)
    radiance = albedo.clamp_min(DARKEST_ALBEDO) * light
    key = radiance.mean(1, keepdim=True).clamp_min(1e-6).log().mean((1, 2, 3), keepdim=True).exp()
    return radiance * (MIDDLE_GREY / key), torch.cat([albedo, features[:, 3:]], 1)


def noisy(radiance):
    """[N, 3, H, W] with samples that deviate by a factor of mean 1, log-normal, alike all over a crop or less in its
    light, grey, of all colours or in between: half of the crops, the others as they are."""
    n, _, height, width = radiance.shape
    some = (uniform(radiance, n, 1, 1, 1) < 0.5).float()
    # More of strong noise than of weak.
    size = torch.exp2(MOST_NOISE + (LEAST_NOISE - MOST_NOISE) * uniform(radiance, n, 1, 1, 1).square()) * some
    size = size * torch.lerp(torch.ones_like(size), 1.5 * shadows(radiance), uniform(radiance, n, 1, 1, 1))
    common = torch.randn(n, 1, height, width, device=radiance.device)
    own = torch.randn(n, 3, height, width, device=radiance.device)
    grey = uniform(radiance, n, 1, 1, 1)
    deviation = size * (grey.sqrt() * common + (1 - grey).sqrt() * own)
    return radiance * torch.exp(deviation - size.square() / 2)
