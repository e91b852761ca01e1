"""A network of few channels, and few small pairs to train it on."""
from dataclasses import replace

import numpy as np
import OpenEXR
import torch

from vkdn import hashweights, procedural
from vkdn.arch import ARCHITECTURES, with_head
from vkdn.crops import Store, arrays
from vkdn.images import COLOR
from vkdn.images import FEATURES as CHANNELS
from vkdn.model import Denoiser
from vkdn.packs import FEATURES, LEVELS

SIDE = 128


def network(head="pure"):
    return hashweights.fill(Denoiser(replace(with_head(ARCHITECTURES["hybrid"], head), channels=8)), 1)


def view(seed, held=False, side=SIDE):
    """As views.read gives it: a ramp with noise that falls with the number of samples."""
    random = np.random.default_rng(seed)
    reference = np.broadcast_to(np.linspace(0.1, 1, side)[None, None, :], (3, side, side))
    planes = {"reference": reference.astype(np.float16)}
    for spp in LEVELS:
        planes[f"color{spp}"] = (reference * random.gamma(spp, 1 / spp, (3, side, side))).astype(np.float16)
        shapes = {name: (side, side) if name == "depth" else (3, side, side) for name in FEATURES}
        planes |= {f"{name}{spp}": random.random(shape).astype(np.float16) for name, shape in shapes.items()}
    about = {"scene": "held" if held else "shown", "name": f"v{seed}", "held": held, "frame": False}
    return about | {"keys": [0.4] * 3, "depth_scales": [1.0] * 3, "side": side}, planes


def store(count=3):
    found = arrays([view(seed) for seed in range(count)])
    kept = Store("cpu")
    kept.add(found["color"], found["features"], found["reference"], found["depth_scale"], False, found["known"])
    return kept.finish()


def write_crops(folder):
    """A finished folder of two procedural crops, as vkdn.procedural leaves it."""
    found = arrays([view(seed) for seed in (7, 8)])
    twice = lambda t: torch.cat([t, t], 1)
    crops = {"color": twice(found["color"]), "features": twice(found["features"]), "reference": found["reference"]}
    folder.mkdir()
    procedural.save(crops | {"depth_scale": torch.ones(2)}, folder / "crops0000.pt")
    (folder / procedural.COMPLETE).touch()


def write_pairs(root, side=SIDE):
    """Two scenes of one view each, "shown" and "held", as a renderer leaves them."""
    channels = {"color": COLOR, **CHANNELS}
    for seed, held in enumerate((False, True)):
        about, planes = view(seed, held, side)
        folder = root / about["scene"] / about["name"]
        folder.mkdir(parents=True)

        def write(name, *kinds):
            pixels = {}
            for kind, plane in kinds:
                stack = plane[None] if plane.ndim == 2 else plane
                pixels |= dict(zip(channels[kind], map(np.ascontiguousarray, stack)))
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, pixels).write(str(folder / name))

        write("ref.exr", ("color", planes["reference"]))
        for spp in LEVELS:
            write(f"spp{spp:04}.exr", *((kind, planes[f"{kind}{spp}"]) for kind in ("color", *FEATURES)))
