"""One whole frame through a model: pre-processing, network, post-processing."""
import numpy as np
import torch

from . import preprocess
from .model import predict

FEATURE_NAMES = ("albedo", "normal", "depth")


def prepare(planes, stats):
    """Network inputs of one frame: c [3, H, W], aux [7, H, W]."""
    color = planes["color"]
    c = preprocess.log_color(color, stats.exposure, stats.key)
    aux = preprocess.auxiliary(color.shape[:2], *(planes.get(n) for n in FEATURE_NAMES), stats.depth_scale)
    return [torch.from_numpy(np.ascontiguousarray(m.transpose(2, 0, 1), np.float32)) for m in (c, aux)]


@torch.inference_mode()
def denoise(model, planes, stats=None, features=FEATURE_NAMES):
    """planes: as `images.read_planes` gives them; stats: the frame's own unless given. Returns radiance [H, W, 3]."""
    used = {n: p for n, p in planes.items() if n == "color" or n in features}
    stats = stats or preprocess.statistics(used["color"], used.get("depth"))
    device = next(model.parameters()).device
    c, aux = prepare(used, stats)
    _, beyond, given = preprocess.split(used["color"], stats.exposure, stats.key)
    output = predict(model, c[None].to(device), aux[None].to(device))[0]
    largest = preprocess.largest_of(used["color"])
    return preprocess.finish(output.permute(1, 2, 0).cpu().numpy(), stats.exposure, largest, beyond, given)
