"""What training minimises."""
import math

import torch
import torch.nn.functional as F

from .preprocess import RANGE

EPSILON = 0.01
LOG_RANGE = math.log1p(RANGE)


def relative_l2(prediction, target, delta, bright=math.inf):
    """Mean of (y - yhat)^2 / (mean_rgb(y)^2 + 0.01) of each sample, in the log domain, [N, 3, H, W] -> [N]. Relative
    errors beyond `delta` count linearly: at 1 spp a few dark pixels beside fireflies would otherwise be most of the
    gradient. No pixel counts as brighter than `bright`: the log of bright light is a relative measure already, and
    divided by its size again lamps and windows weigh next to nothing."""
    scale = torch.rsqrt(target.mean(1, keepdim=True).clamp(max=bright) ** 2 + EPSILON)
    return 2 * F.huber_loss(prediction * scale, target * scale, delta=delta, reduction="none").mean((1, 2, 3))


def energy(prediction, target, sides=(16, 64), delta=0.5):
    """Mean of ((o - t) / (o + 0.01))^2 of each sample, o and t the mean radiances of prediction and target over blocks
    of pixels of these sides, [N, 3, H, W] -> [N]. What is best in the log domain is too dark, on average, where it is
    unsure; blocks of radiance are right on average only if their energy is. No gradient flows through the divisor:
    divided by the target, what is best would be too dark again. Relative errors beyond `delta` count linearly, so that
    what was lost with a firefly counts no more than that.
    """
    radiance = [torch.expm1(t.clamp(0, LOG_RANGE)) for t in (prediction, target)]
    total = 0.0
    for side in sides:
        o, t = (F.avg_pool2d(plane, side) for plane in radiance)
        scale = 1 / (o.detach() + EPSILON)
        total = total + 2 * F.huber_loss(o * scale, t * scale, delta=delta, reduction="none").mean((1, 2, 3))
    return total / len(sides)


def balanced(errors, knee):
    """Mean of knee * log(1 + error / knee) over the samples. Without it the crops of one sample per pixel, whose
    errors are ten times those of 32, take nearly all of the gradient; a PSNR is a logarithm as well. A knee of
    infinity: the plain mean.
    """
    return (errors if math.isinf(knee) else knee * torch.log1p(errors / knee)).mean()
