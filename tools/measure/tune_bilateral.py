"""Chooses the parameters of the bilateral filter on training scenes and writes bilateral_parameters.py.

    python tools/measure/tune_bilateral.py --data PAIRS/train [--views 2]

Coordinate search for the best mean PSNR. There is a set for every sample count, which the network is not told, and one for
colour alone. Never run it on test scenes. About 2 s an evaluation, 200 evaluations; OMP_NUM_THREADS=1 is faster beside
other work.
"""
import argparse
import json
import textwrap
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from bilateral import Parameters, filter_frame
from kit import images, metrics

START = Parameters(spatial=4, color=0.5, guide=1, bend=0.1, albedo=0.1, normal=0.15, depth=0.1)
COLOR_ONLY_START = Parameters(spatial=3, color=0.5, guide=1, bend=0.1)
COLOR_ONLY_NAMES = ("spatial", "color", "guide", "bend")
COLOR_ONLY_SPP = 4
# A round tries every parameter once with the next factor both ways, and goes on in a direction that gains.
FACTORS = (2.0, 1.4, 1.2)
LEAST_GAIN = 0.01
TARGET = Path(__file__).with_name("bilateral_parameters.py")
HEADING = "The parameters of the bilateral filter by samples per pixel. Written by tune_bilateral.py, not by hand."


def some_views(root, count):
    """`count` views of each scene, evenly spaced among all of it."""
    scenes = {}
    for view in images.find_views(root):
        scenes.setdefault(view.parent.name, []).append(view)
    return [views[len(views) * i // count] for views in scenes.values() for i in range(min(count, len(views)))]


def load(views, spp, features):
    """[(planes, reference)]"""
    pairs = []
    for view in views:
        planes = images.read_planes(images.sample_files(view)[spp])
        kept = planes if features else {"color": planes["color"]}
        pairs.append((kept, images.read_planes(view / "ref.exr")["color"]))
    return pairs


def mean_psnr(pairs, method):
    return float(np.mean([metrics.psnr(method(planes), reference) for planes, reference in pairs]))


def search(pairs, start, names, label):
    """(best parameters, their mean PSNR)"""
    score = lambda parameters: mean_psnr(pairs, lambda planes: filter_frame(planes, parameters))
    best, best_score = start, score(start)
    progress = tqdm([(factor, name) for factor in FACTORS for name in names], desc=label)
    for factor, name in progress:
        for step in (factor, 1 / factor):
            before = best
            while True:
                trial = replace(best, **{name: getattr(best, name) * step})
                tried = score(trial)
                if tried < best_score + LEAST_GAIN:
                    break
                best, best_score = trial, tried
            if best != before:
                break
        progress.set_postfix(psnr=f"{best_score:.2f}")
    return best, best_score


def rounded(parameters, names):
    return {n: float(f"{v:.3g}") for n, v in asdict(parameters).items() if n in names}


def source_text(note, tables):
    """Python source; tables: {constant: {spp: parameters}}"""
    text = f'"""{HEADING}\n\n{textwrap.fill(note, 118)}\n"""\n'
    for name, table in tables.items():
        rows = "".join(f"    {spp}: {json.dumps(parameters)},\n" for spp, parameters in table.items())
        text += f"{name} = {{\n{rows}}}\n"
    return text


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, help="training pairs")
    p.add_argument("--views", type=int, default=2, help="views of each scene")
    args = p.parse_args()
    views = some_views(args.data, args.views)
    gains = []

    def tune(spp, start, names, features):
        pairs = load(views, spp, features)
        label = f"{spp} spp" + ("" if features else ", colour only")
        best, after = search(pairs, start, names, label)
        gains.append(f"{label} {mean_psnr(pairs, lambda planes: planes['color']):.2f} -> {after:.2f}")
        return rounded(best, names)

    all_names = tuple(asdict(START))
    tables = {
        "WITH_FEATURES": {spp: tune(spp, START, all_names, True) for spp in images.sample_files(views[0])},
        "COLOR_ONLY": {COLOR_ONLY_SPP: tune(COLOR_ONLY_SPP, COLOR_ONLY_START, COLOR_ONLY_NAMES, False)},
    }
    scenes = ", ".join(sorted({v.parent.name for v in views}))
    note = f"Best mean PSNR over {len(views)} views of the training scenes {scenes}. There, noisy -> filtered in dB: "
    TARGET.write_text(source_text(note + "; ".join(gains) + ".", tables))
    print(TARGET.read_text())


if __name__ == "__main__":
    main()
