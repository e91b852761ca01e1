"""Rendered pairs, from a folder or a pack (packs.py), in one form: [(what is known of a view, {plane: halves})].

Known: "scene", "name", "held" (never trained on), "frame" (whether key and depth scale are of the whole frame), "keys"
and "depth_scales" of each of LEVELS, "side". Planes, [3, H, W] or of depth [H, W]: "reference" and, for every number
of samples n of LEVELS, "color<n>", "albedo<n>", "normal<n>", "depth<n>"; a feature that was not rendered is zeros.
"""
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from . import packs, preprocess
from .packs import FEATURES, LEVELS

# Crops of more pixels a side than this are cut up.
LARGEST_SIDE = 256


def one_view(path, held_scenes):
    """A view's folder in that form."""
    from .images import read_planes, sample_files  # OpenEXR: a machine that reads packs need not have it

    files = sample_files(path)
    if missing := [spp for spp in LEVELS if spp not in files]:
        names = ", ".join(f"spp{spp:04}.exr" for spp in missing)
        raise ValueError(f"{path}: no {names}; training takes {LEVELS} samples a pixel")
    frame = None
    if (path / "frame.exr").exists():
        planes = read_planes(path / "frame.exr")
        frame = preprocess.statistics(planes["color"], planes.get("depth"))
    reference = read_planes(path / "ref.exr")["color"]
    height, width = reference.shape[:2]
    if height != width or height % 128:
        raise ValueError(f"{path}: {width}x{height} pixels; training takes squares of a multiple of 128 pixels")
    planes, keys, depth_scales = {"reference": halves(reference)}, [], []
    for spp in LEVELS:
        noisy = read_planes(files[spp])
        stats = frame or preprocess.statistics(noisy["color"], noisy.get("depth"))
        keys.append(stats.key)
        depth_scales.append(stats.depth_scale)
        planes[f"color{spp}"] = halves(noisy["color"])
        for name in FEATURES:
            empty = np.zeros((height, width) if name == "depth" else (height, width, 3))
            planes[f"{name}{spp}"] = halves(noisy.get(name, empty))
    about = {
        "scene": path.parent.name,
        "name": path.name,
        "held": path.parent.name in held_scenes,
        "frame": frame is not None,
        "keys": keys,
        "depth_scales": depth_scales,
        "side": height,
    }
    return about, planes


def halves(plane):
    """[H, W, 3] or [H, W] -> halves with the channels first; a float above what they hold becomes infinite."""
    with np.errstate(over="ignore"):
        plane = plane.astype(np.float16)
    return plane.transpose(2, 0, 1) if plane.ndim == 3 else plane


def from_folder(root, held_scenes):
    from .images import find_views

    return [one_view(path, held_scenes) for path in find_views(root)]


def read(source, held_scenes, workers=16):
    """All views of a folder or a pack; `held_scenes` are held out, beside those that a pack already says are."""
    if Path(source).is_dir():
        views = from_folder(source, held_scenes)
    else:
        views = packs.read(source, workers)
        for about, _ in views:
            about["held"] |= about["scene"] in held_scenes
    if not views:
        raise ValueError(f"{source}: no views")
    return views


def cut(views, side):
    """Larger views in squares of `side` pixels that cover them; the last ones of a row and a column may overlap
    others."""
    pieces = []
    for about, planes in views:
        starts = sorted({*range(0, about["side"] - side + 1, side), about["side"] - side})
        for y in starts:
            for x in starts:
                window = np.s_[..., y : y + side, x : x + side]
                pieces.append((about | {"side": side}, {name: plane[window] for name, plane in planes.items()}))
    return pieces


def crops(views, most=LARGEST_SIDE):
    """Views to train on, all of one size: the smallest one's, at most `most` pixels a side."""
    return cut(views, min(most, *(about["side"] for about, _ in views)))
