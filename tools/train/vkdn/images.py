"""Reading the EXR planes of a rendered pair."""
import re
from pathlib import Path

import numpy as np
import OpenEXR

SAMPLE_FILE = re.compile(r"spp(\d+)\.exr")
COLOR = ("R", "G", "B")
FEATURES = {"albedo": ("albedo.R", "albedo.G", "albedo.B"), "normal": ("N.X", "N.Y", "N.Z"), "depth": ("Z",)}


def read_planes(path):
    """{"color": [H, W, 3], "albedo": [H, W, 3], "normal": [H, W, 3], "depth": [H, W]}, float32; only what the file has."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.asarray(c.pixels, np.float32) for name, c in file.channels().items()}
    planes = {}
    for plane, names in {"color": COLOR, **FEATURES}.items():
        if all(name in channels for name in names):
            stacked = np.stack([channels[name] for name in names], -1)
            planes[plane] = stacked[..., 0] if len(names) == 1 else stacked
    if "color" not in planes:
        raise ValueError(f"{path}: no R, G, B channels")
    return planes


def sample_files(view):
    """{samples per pixel: path} of a view's noisy files, fewest samples first."""
    found = {int(m[1]): p for p in Path(view).iterdir() if (m := SAMPLE_FILE.fullmatch(p.name))}
    return dict(sorted(found.items()))


def find_views(root, scenes=None, without=()):
    """Sorted view directories <root>/<scene>/<view> that hold a ref.exr; `scenes` limits, `without` excludes."""
    views = sorted(p.parent for p in Path(root).glob("*/*/ref.exr"))
    return [v for v in views if (scenes is None or v.parent.name in scenes) and v.parent.name not in without]
