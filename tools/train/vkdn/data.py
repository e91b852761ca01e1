"""Training samples from directories of rendered pairs: <root>/<scene>/<view>/{spp####.exr, ref.exr[, frame.exr]}.

All crops are decoded once and kept in memory as halves (about 1 MB per 128x128 view with three noise levels).
"""
from dataclasses import dataclass

import numpy as np
import torch

from . import preprocess
from .images import find_views, read_planes, sample_files

FEATURE_NAMES = ("albedo", "normal", "depth")


@dataclass
class View:
    """One crop. noisy: {spp: planes}; reference [H, W, 3]; frame: the whole frame's statistics, None where unknown."""

    scene: str
    name: str
    noisy: dict
    reference: np.ndarray
    frame: preprocess.Statistics | None


def load_view(path):
    frame = None
    if (path / "frame.exr").exists():
        planes = read_planes(path / "frame.exr")
        frame = preprocess.statistics(planes["color"], planes.get("depth"))
    noisy = {}
    for spp, file in sample_files(path).items():
        noisy[spp] = {name: plane.astype(np.float16) for name, plane in read_planes(file).items()}
    reference = read_planes(path / "ref.exr")["color"].astype(np.float16)
    return View(path.parent.name, path.name, noisy, reference, frame)


def load_views(root, scenes=None, without=()):
    return [load_view(path) for path in find_views(root, scenes, without)]


def prepare(planes, stats, reference=None, exposure=None):
    """Network inputs of one frame: c [3, H, W], aux [7, H, W], and log1p of the exposed reference where given."""
    exposure = exposure or stats.exposure
    color = planes["color"]
    c = preprocess.log_color(color, exposure, stats.key)
    aux = preprocess.auxiliary(color.shape[:2], *(planes.get(n) for n in FEATURE_NAMES), stats.depth_scale)
    maps = [c, aux]
    if reference is not None:
        exposed = np.minimum(np.maximum(reference, 0) * np.float32(exposure), preprocess.RANGE)
        maps.append(np.log1p(exposed))
    return [torch.from_numpy(np.ascontiguousarray(m.transpose(2, 0, 1), np.float32)) for m in maps]


def random_rotation(rng):
    """A uniform random rotation matrix, from a random unit quaternion."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ],
        np.float32,
    )


@dataclass
class Augmentation:
    """Chances and sizes of what is changed at random; jitters are standard deviations in stops (log2).

    A render's chance is in proportion to its sample count to the power `favour`: under little noise there is more to learn.
    """

    favour: float = 0.3

    drop_one: float = 0.1
    blend: float = 0.5
    shift: int = 16
    drop_all: float = 0.1
    fireflies: float = 0.25
    emitters: float = 0.2
    exposure_jitter: float = 0.5
    crop_exposure_jitter: float = 1.0
    crop_depth_jitter: float = 0.7

    def drop(self, planes, rng):
        """Each feature goes in a tenth of the crops, all together in another tenth."""
        if rng.random() < self.drop_all:
            return {"color": planes["color"]}
        return {n: p for n, p in planes.items() if n == "color" or rng.random() >= self.drop_one}

    def pick(self, noisy, rng):
        """One of a view's noisy renders {spp: planes}, or a blend of two of them with a random weight up to that of their
        sample counts: noise of levels and of patterns that were not rendered."""
        counts = list(noisy)
        chances = np.array(counts, float) ** self.favour
        first = counts[rng.choice(len(counts), p=chances / chances.sum())]
        planes = {n: p.astype(np.float32) for n, p in noisy[first].items()}
        if rng.random() >= self.blend or len(counts) == 1:
            return planes
        second = counts[rng.integers(len(counts))]
        weight = np.float32(rng.random() * second / (first + second))
        return {n: p + weight * (noisy[second][n].astype(np.float32) - p) for n, p in planes.items()}

    def moved(self, planes, rng):
        """All planes moved by up to `shift` pixels each way, what comes in at the border mirrored: windows and patches fall
        elsewhere."""
        y, x = rng.integers(-self.shift, self.shift + 1, 2)

        def index(size, by):
            i = np.abs(np.arange(size) + by)
            return np.where(i < size, i, 2 * (size - 1) - i)

        return [p[index(p.shape[0], y)][:, index(p.shape[1], x)] for p in planes]

    def inject_fireflies(self, color, key, rng):
        """A few pixels gain a tinted radiance of 10 to 10^4 keys."""
        count = rng.integers(1, 9)
        y, x = rng.integers(color.shape[0], size=count), rng.integers(color.shape[1], size=count)
        tint = rng.uniform(0.3, 1, (count, 3))
        color = color.copy()
        color[y, x] += key * 10 ** rng.uniform(1, 4, (count, 1)) * tint
        return color

    def paste_emitters(self, color, reference, key, rng):
        """A few rectangles of 2 to 12 pixels shine with 3 to 10^4 keys, in the noisy render and the reference alike: small
        lights must not be taken for noise, and there are few of them in renders of few scenes."""
        color, reference = color.copy(), reference.copy()
        for _ in range(rng.integers(1, 4)):
            height, width = rng.integers(2, 13, 2)
            y, x = rng.integers(color.shape[0] - height), rng.integers(color.shape[1] - width)
            radiance = key * 10 ** rng.uniform(0.5, 4) * rng.uniform(0.6, 1, 3)
            for plane in (color, reference):
                plane[y : y + height, x : x + width] = radiance
        return color, reference

    def frame_statistics(self, view, planes, rng):
        """The frame's key and depth scale where known; else the crop's, made less certain."""
        if view.frame is not None:
            return view.frame, self.exposure_jitter
        stats = preprocess.statistics(planes["color"], planes.get("depth"))
        # A frame's farthest depth is at least that of any of its crops.
        stats.depth_scale *= 2 ** abs(rng.normal(0, self.crop_depth_jitter))
        return stats, self.crop_exposure_jitter


def turn(planes, rng):
    """One of the 8 flips and rotations, applied to where pixels are and to nothing else."""
    quarter, flip = rng.integers(4), rng.random() < 0.5

    def one(plane):
        plane = np.rot90(plane, quarter)
        return plane[:, ::-1] if flip else plane

    return [one(p) for p in planes]


class TrainingSet(torch.utils.data.IterableDataset):
    """An endless stream of (c [3, H, W], aux [7, H, W], log reference [3, H, W]).

    Red, green and blue change places at random: few scenes have few colours.
    """

    def __init__(self, views, seed, augmentation=Augmentation()):
        self.views, self.seed, self.augmentation = views, seed, augmentation

    def sample(self, rng):
        view = self.views[rng.integers(len(self.views))]
        augmentation = self.augmentation
        planes = augmentation.pick(view.noisy, rng)
        reference = view.reference.astype(np.float32)
        stats, jitter = augmentation.frame_statistics(view, planes, rng)
        if rng.random() < augmentation.emitters:
            planes["color"], reference = augmentation.paste_emitters(planes["color"], reference, stats.key, rng)
        if rng.random() < augmentation.fireflies:
            planes["color"] = augmentation.inject_fireflies(planes["color"], stats.key, rng)
        if "normal" in planes:
            planes["normal"] = planes["normal"] @ random_rotation(rng).T
        tint = rng.permutation(3)
        for name in planes.keys() & {"color", "albedo"}:
            planes[name] = planes[name][..., tint]
        planes = augmentation.drop(planes, rng)
        names = list(planes)
        *turned, reference = turn(augmentation.moved([*planes.values(), reference[..., tint]], rng), rng)
        exposure = stats.exposure * 2 ** rng.normal(0, jitter)
        return prepare(dict(zip(names, turned)), stats, reference, exposure)

    def __iter__(self):
        worker = torch.utils.data.get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0])
        while True:
            yield self.sample(rng)
