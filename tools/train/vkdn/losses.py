"""What training minimises."""
import math

import torch
import torch.nn.functional as F

EPSILON = 0.01


def relative_l2(prediction, target, delta, bright=math.inf):
    """Mean of (y - yhat)^2 / (mean_rgb(y)^2 + 0.01) of each sample, in the log domain, [N, 3, H, W] -> [N]. Relative errors
    beyond `delta` count linearly: at 1 spp a few dark pixels beside fireflies would otherwise be most of the gradient.
    No pixel counts as brighter than `bright`: the log of bright light is a relative measure already, and divided by its size
    again lamps and windows weigh next to nothing."""
    scale = torch.rsqrt(target.mean(1, keepdim=True).clamp(max=bright) ** 2 + EPSILON)
    return 2 * F.huber_loss(prediction * scale, target * scale, delta=delta, reduction="none").mean((1, 2, 3))


def balanced(errors, knee):
    """Mean of knee * log(1 + error / knee) over the samples. Without it the crops of one sample per pixel, whose errors are
    ten times those of 32, take nearly all of the gradient; a PSNR is a logarithm as well. A knee of infinity: the plain mean.
    """
    return (errors if math.isinf(knee) else knee * torch.log1p(errors / knee)).mean()
