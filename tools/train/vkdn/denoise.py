"""One whole frame through a model: pre-processing, network, post-processing."""
import torch

from . import preprocess
from .data import FEATURE_NAMES, prepare
from .model import predict


@torch.inference_mode()
def denoise(model, planes, stats=None, features=FEATURE_NAMES):
    """planes: as `images.read_planes` gives them; stats: the frame's own unless given. Returns radiance [H, W, 3]."""
    used = {n: p for n, p in planes.items() if n == "color" or n in features}
    stats = stats or preprocess.statistics(used["color"], used.get("depth"))
    device = next(model.parameters()).device
    c, aux = prepare(used, stats)
    _, beyond, given = preprocess.split(used["color"], stats.exposure, stats.key)
    r = predict(model, c[None].to(device), aux[None].to(device))[0]
    to_image = lambda t: t.permute(1, 2, 0).cpu().numpy()
    largest = preprocess.largest_of(used["color"])
    return preprocess.finish(to_image(c), to_image(r), stats.exposure, largest, beyond, given)
