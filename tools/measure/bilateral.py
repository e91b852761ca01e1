"""A cross-bilateral filter on the network's own inputs: what classic filtering reaches when it is tuned.

Every pixel becomes the mean colour around it, weighted by exp(-d^2 / 2), d the distance in position, log colour, albedo,
normal and depth, each in units of its sigma. `tune_bilateral.py` chose the parameters.
"""
import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F

import bilateral_parameters
from kit import prepare, preprocess

LARGEST_RADIUS = 12


@dataclass(frozen=True)
class Parameters:
    """Sigmas: spatial in pixels; color in log1p of exposed radiance; the features as the network sees them, all in [0, 1].

    guide: a blur in pixels of the log colour that distances are taken of; without it noise holds on to itself.
    bend: the mean is of log1p(bend * radiance). Towards 0 it is of radiance, true on average but open to fireflies; at 1
    of log1p, safe but too dark where few samples carry the light.
    The sigma of a feature that the frame lacks does not matter: it is the same everywhere.
    """

    spatial: float
    color: float
    guide: float
    bend: float
    albedo: float = 1.0
    normal: float = 1.0
    depth: float = 1.0


def blur(image, sigma):
    """Gaussian blur of [C, H, W], the border continued outwards."""
    radius = math.ceil(2.5 * sigma)
    x = torch.arange(-radius, radius + 1)
    kernel = torch.exp(-(x**2) / (2 * sigma**2))
    kernel = (kernel / kernel.sum()).expand(image.shape[0], 1, 1, -1)
    image = F.pad(image[None], (radius,) * 4, mode="replicate")
    rows = F.conv2d(image, kernel, groups=image.shape[1])
    return F.conv2d(rows, kernel.transpose(2, 3), groups=image.shape[1])[0]


def guide_maps(c, aux, parameters):
    """The maps whose differences are the distances, each in units of its sigma. [10, H, W]"""
    features = [aux[:3] / parameters.albedo, aux[3:6] / parameters.normal, aux[6:] / parameters.depth]
    return torch.cat([blur(c, parameters.guide) / parameters.color, *features])


def half_window(radius):
    """Offsets (dy, dx) of a square window, one of each opposite pair, without the centre."""
    offsets = range(-radius, radius + 1)
    return [(dy, dx) for dy in offsets for dx in offsets if (dy, dx) > (0, 0)]


def overlap(offset, size):
    """Slices of one axis: the elements that have a partner `offset` away, and those partners."""
    near = slice(max(-offset, 0), size - max(offset, 0))
    return near, slice(near.start + offset, near.stop + offset)


@torch.inference_mode()
def smooth(c, aux, parameters):
    """Log colour c [3, H, W] and aux [7, H, W], as `prepare` gives them -> filtered log colour [3, H, W]."""
    height, width = c.shape[1:]
    guide = guide_maps(c, aux, parameters)
    # The last channel sums the weights. A pixel's own weight is 1.
    values = torch.cat([torch.log1p(parameters.bend * torch.expm1(c)), torch.ones(1, height, width)])
    total = values.clone()
    radius = min(math.ceil(2 * parameters.spatial), LARGEST_RADIUS, height - 1, width - 1)
    for dy, dx in half_window(radius):
        rows, other_rows = overlap(dy, height)
        columns, other_columns = overlap(dx, width)
        here, there = (..., rows, columns), (..., other_rows, other_columns)
        distance = (guide[here] - guide[there]).square_().sum(0)
        weight = distance.add_((dy * dy + dx * dx) / parameters.spatial**2).mul_(-0.5).exp_()
        total[here].addcmul_(weight, values[there])
        total[there].addcmul_(weight, values[here])
    return torch.log1p(torch.expm1(total[:3] / total[3:]) / parameters.bend)


def filter_frame(planes, parameters):
    """planes: as `images.read_planes` gives them. Returns radiance [H, W, 3]."""
    stats = preprocess.statistics(planes["color"], planes.get("depth"))
    c, aux = prepare(planes, stats)
    to_image = lambda t: t.permute(1, 2, 0).numpy()
    return preprocess.finish(to_image(smooth(c, aux, parameters)), stats.exposure)


def denoise(planes, spp):
    """Filters with the parameters that were tuned for the nearest sample count, with features or without."""
    tuned = bilateral_parameters.WITH_FEATURES if "albedo" in planes else bilateral_parameters.COLOR_ONLY
    nearest = min(tuned, key=lambda known: abs(math.log(known / spp)))
    return filter_frame(planes, Parameters(**tuned[nearest]))
