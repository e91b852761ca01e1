"""Measures vkdenoise, a cross-bilateral filter and Intel OIDN on a data directory; writes Markdown, JSON and a picture.

    python tools/measure/quality.py --data PAIRS/test --vkdenoise target/release/vkdenoise \\
        --out docs/quality.md --picture docs/comparison.png

Every <scene>/<view>/sppNNNN.exr is measured against its ref.exr, and those of 4 spp once more without features. The JSON
stands beside the Markdown.
"""
import argparse
import json
import tempfile
from pathlib import Path

from tqdm import tqdm

import methods
import picture
import report
from kit import images, metrics

COLOR_ONLY_SPP = 4
PICTURE_SPP = 4
# The column of `--quality high`.
HIGH = "vkdenoise, high"


def inputs_of(view, folder):
    """Yields (setting, Input) of a view; files that have to be made go to `folder`."""
    for spp, path in images.sample_files(view).items():
        yield report.Setting(spp, True), methods.Input(path, spp)
        if spp == COLOR_ONLY_SPP:
            bare = Path(folder, "color-only.exr")
            methods.write_color_only(path, bare)
            yield report.Setting(spp, False), methods.Input(bare, spp)


def chosen_methods(args):
    """{column name: method}; the first is what gains are counted from."""
    chosen = {"noisy": methods.noisy}
    if args.vkdenoise:
        chosen["vkdenoise"] = methods.vkdenoise(args.vkdenoise, *(["--weights", args.weights] if args.weights else []))
    if args.vkdenoise and not args.weights:
        chosen[HIGH] = methods.vkdenoise(args.vkdenoise, "--quality", "high")
    if args.pytorch:
        chosen["PyTorch"] = methods.pytorch(args.pytorch)
    return chosen | {"bilateral": methods.cross_bilateral, "OIDN": methods.oidn}


def measure(views, chosen, pictured):
    """(rows of figures, {scene: {column: radiance [H, W, 3]}} of the scenes in `pictured`)"""
    rows, images_of = [], {}
    for view in tqdm(views):
        scene = view.parent.name
        reference = images.read_planes(view / "ref.exr")["color"]
        with tempfile.TemporaryDirectory() as folder:
            for setting, frame in inputs_of(view, folder):
                outputs = {name: method(frame) for name, method in chosen.items()}
                for name, output in outputs.items():
                    figures = {n: metric(output, reference) for n, metric in metrics.METRICS.items()}
                    rows.append(report.Row(f"{scene}/{view.name}", setting, name, **figures))
                if scene in pictured and setting == report.Setting(PICTURE_SPP, True):
                    images_of[scene] = outputs | {"reference": reference}
    return rows, images_of


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True)
    p.add_argument("--scenes", help="comma separated; default: all")
    p.add_argument("--vkdenoise", help="the command line tool; without it, no such column")
    p.add_argument("--weights", help="for the command line tool, in place of its built-in ones")
    p.add_argument("--pytorch", metavar="WEIGHTS", help="also measure the training kit's network with these weights")
    p.add_argument("--out", type=Path, required=True, help="Markdown file; the JSON takes its name")
    p.add_argument("--picture", type=Path, help="PNG that compares some scenes at 4 spp")
    p.add_argument("--picture-scenes", default="bathroom,living-room", help="comma separated")
    args = p.parse_args()
    views = images.find_views(args.data, args.scenes and args.scenes.split(","))
    rows, images_of = measure(views, chosen_methods(args), args.picture_scenes.split(",") if args.picture else [])
    for path in filter(None, (args.out, args.picture)):
        path.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(report.markdown(rows))
    args.out.with_suffix(".json").write_text(json.dumps(report.as_json(rows), indent=1) + "\n")
    if args.picture:
        picture.compare(images_of, PICTURE_SPP).save(args.picture, optimize=True)
    print(report.means_table(rows))


if __name__ == "__main__":
    main()
