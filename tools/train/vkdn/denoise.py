"""One whole frame through a model: pre-processing, network, post-processing."""
import numpy as np
import torch

from . import energy, preprocess
from .model import predict

FEATURE_NAMES = ("albedo", "normal", "depth")


def prepare(planes, stats, clean_aux=False):
    """Network inputs of one frame: c [3, H, W], aux [7, H, W]. clean_aux: whether albedo is taken as it is."""
    color = planes["color"]
    c = preprocess.log_color(color, stats.exposure, stats.key)
    features = (planes.get(name) for name in FEATURE_NAMES)
    aux = preprocess.auxiliary(color.shape[:2], *features, stats.depth_scale, clean_aux)
    return [torch.from_numpy(np.ascontiguousarray(m.transpose(2, 0, 1), np.float32)) for m in (c, aux)]


@torch.inference_mode()
def denoise(model, planes, stats=None, features=FEATURE_NAMES, clean_aux=False):
    """planes: as `images.read_planes` gives them; stats: the frame's own unless given; clean_aux: whether albedo is taken as it
    is. Returns radiance [H, W, 3]."""
    used = {n: p for n, p in planes.items() if n == "color" or n in features}
    stats = stats or preprocess.statistics(used["color"], used.get("depth"))
    device = next(model.parameters()).device
    c, aux = prepare(used, stats, clean_aux)
    _, beyond, given = preprocess.split(used["color"], stats.exposure, stats.key)
    output = predict(model, c[None].to(device), aux[None].to(device))[0].permute(1, 2, 0).cpu().numpy()
    largest = preprocess.largest_of(used["color"])
    if model.arch.head:
        radiance = energy.given_back(np.expm1(c.numpy().transpose(1, 2, 0)), np.expm1(output), largest * stats.exposure)
        output = np.log1p(radiance).astype(np.float32)
    return preprocess.finish(output, stats.exposure, largest, beyond, given)
