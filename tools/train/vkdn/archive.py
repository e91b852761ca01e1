"""One folder that trains on a machine with a GPU and nothing else: kit, plan, pack of pairs, weights to start from,
tracer.

    python -m vkdn.archive --plan plans/kernels.json --data PAIRS --tracer DIR --out FOLDER --start NAME=FILE ...

A start called NAME becomes NAME.zip, the pairs pairs.zip and the tracer's folder tracer, as the plan calls them.
There, with PyTorch and Triton (nvcc or CuPy for the tracer):  cd FOLDER && python3 -m vkdn.burst --plan plan.json
--seconds 480 --out OUT
"""
import argparse
import json
import shutil
import sys
from pathlib import Path

from . import carried, checkpoint, packs

KIT = Path(__file__).resolve().parent
MOST_MEGABYTES = 60.0


def files_of(plan):
    """The names that a plan's arguments give to files beside it."""
    arguments = [*plan["train"], *(a for entry in plan["trainings"] for a in entry.get("arguments", []))]
    arguments += plan.get("crops", {"arguments": []})["arguments"]
    pairs = zip(arguments, arguments[1:])
    return {value for option, value in pairs if option in ("--data", "--from", "--tracer")}


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--plan", required=True, type=Path)
    p.add_argument("--data", required=True, help="<scene>/<view>/ folders of pairs")
    p.add_argument("--hold-out", default="car2,classroom", help="scenes for validation, comma separated")
    p.add_argument("--tracer", type=Path)
    p.add_argument("--start", action="append", default=[], metavar="NAME=FILE")
    p.add_argument("--out", required=True, type=Path, help="a new folder")
    args = p.parse_args()
    plan = json.loads(args.plan.read_text())
    args.out.mkdir(parents=True)
    shutil.copytree(KIT, args.out / "vkdn", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(args.plan, args.out / "plan.json")
    if args.tracer:
        (args.out / "tracer").mkdir()
        for file in filter(Path.is_file, args.tracer.iterdir()):
            shutil.copyfile(file, args.out / "tracer" / file.name)
    for start in args.start:
        name, _, path = start.partition("=")
        carried.write(args.out / f"{name}.zip", checkpoint.load_model(path)[0])
    packs.pack(args.data, args.out / "pairs.zip", set(filter(None, args.hold_out.split(","))))
    if missing := sorted(name for name in files_of(plan) if not (args.out / name).exists()):
        sys.exit(f"vkdn.archive: the plan asks for {', '.join(missing)}, which nothing here made")
    size = sum(file.stat().st_size for file in args.out.rglob("*") if file.is_file()) / 1e6
    print(f"{args.out}: {size:.1f} MB")
    if size > MOST_MEGABYTES:
        sys.exit(f"vkdn.archive: more than {MOST_MEGABYTES:.0f} MB; give fewer views")


if __name__ == "__main__":
    main()
