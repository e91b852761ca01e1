"""What one pixel moves far away from itself.

Attention at the coarsest stage spans 128 pixels, so a firefly or a black pixel may tint a distant wall. The loss runs
a crop twice, the second time with one pixel replaced, and takes the squares of the relative changes more than `FAR`
pixels away. All that is random is drawn on the device: the loss may stand in a graph.
"""
import math

import torch

FAR = 64
BORDER = 40
KEY = 0.18  # of an exposed frame
# Relative to the value and this share of the key: in the dark no small change counts as large.
FLOOR = 1e-2 * KEY


def disturbed(color):
    """[1, 3, H, W] -> it with one pixel near a border black or up to 1000 keys bright, and a mask [H, W] of the pixels
    far from it."""
    height, width = color.shape[2:]
    rows = torch.arange(height, device=color.device)[:, None].expand(height, width)
    columns = torch.arange(width, device=color.device)[None].expand(height, width)
    along, across, side, turn, dark, light = torch.rand(6, device=color.device).unbind()
    depth = (across * BORDER).floor()
    depth = torch.where(side < 0.5, depth, width - 1 - depth)
    # As a share of the width and of the height, so that both kinds of border are met.
    y = (along * height).floor()
    y = torch.where(turn < 0.5, y, (depth * height / width).floor())
    x = torch.where(turn < 0.5, depth, (along * width).floor())
    value = torch.log1p(KEY * torch.exp(3 * math.log(10) * light)) * (dark >= 0.5)
    other = torch.where((rows == y) & (columns == x), value, color)
    return other, ((rows - y).abs() > FAR) | ((columns - x).abs() > FAR)


def far_moves(model, color, aux):
    """Mean plus largest of the squared relative changes of the denoised radiance far from a disturbed pixel, of one
    crop [1, 3, H, W], [1, 7, H, W]. The model computes in full precision: what is asked for is smaller than the
    roundings of bfloat16."""
    other, far = disturbed(color)
    outputs = model(torch.cat([color, other]), torch.cat([aux, aux]))
    value = torch.expm1(outputs[0].detach()).clamp(min=0)
    squares = ((outputs[1] - outputs[0]) * (1 + value) / (value + FLOOR)) ** 2 * far
    return squares.sum() / (3 * far.sum()).clamp(min=1) + squares.amax()
