"""What one pixel moves far away from itself.

Attention at the coarsest stage spans 128 pixels, so a firefly or a black pixel may tint a distant wall. The loss runs a crop
twice, the second time with one pixel replaced, and takes the squares of the relative changes more than `FAR` pixels away.
"""
import torch

FAR = 64
BORDER = 40
KEY = 0.18  # of an exposed frame
# Relative to the value and this share of the key: in the dark no small change counts as large.
FLOOR = 1e-2 * KEY


def disturbed(color):
    """(`color` with one pixel near a border black or up to 1000 keys bright, mask [H, W] of the pixels far from it)"""
    height, width = color.shape[2:]
    y = torch.randint(height, ()).item()
    x = torch.randint(BORDER, ()).item()
    x = x if torch.rand(()) < 0.5 else width - 1 - x
    if torch.rand(()) < 0.5:
        y, x = x * height // width, y * width // height
    light = 0.0 if torch.rand(()) < 0.5 else KEY * 10 ** (3 * torch.rand(()).item())
    other = color.clone()
    other[:, :, y, x] = torch.log1p(torch.tensor(light))
    rows, columns = torch.arange(height)[:, None], torch.arange(width)[None]
    return other, ((rows - y).abs() > FAR) | ((columns - x).abs() > FAR)


def far_moves(model, color, aux):
    """Mean plus largest of the squared relative changes of the denoised radiance far from a disturbed pixel. In full
    precision: what is asked for is smaller than the roundings of bfloat16."""
    other, far = disturbed(color)
    outputs = model(torch.cat([color, other]), torch.cat([aux, aux]))
    change = (outputs[1] - outputs[0])[:, far]
    value = torch.expm1(outputs[0].detach()[:, far]).clamp(min=0)
    squares = (change * (1 + value) / (value + FLOOR)) ** 2
    return squares.mean() + squares.max()
