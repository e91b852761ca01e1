"""A table of PSNR, SSIM and relMSE over a data directory: python -m vkdn.evaluate --weights F --data DIR

--weights takes a weights file or a checkpoint. --png DIR also writes noisy | denoised | reference strips.
"""
import argparse
import struct
import zlib
from pathlib import Path

import numpy as np

from . import checkpoint, metrics
from .denoise import FEATURE_NAMES, denoise
from .images import find_views, read_planes, sample_files


def write_png(path, color):
    """Linear radiance [H, W, 3] as an 8-bit RGB PNG."""
    pixels = metrics.display(color).astype(np.uint8)
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 8, 2, 0, 0, 0)
    Path(path).write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )


def measure(model, view, features, png):
    """Yields (spp, {metric: (noisy, denoised)}) for each noisy file of a view."""
    reference = read_planes(view / "ref.exr")["color"]
    for spp, path in sample_files(view).items():
        planes = read_planes(path)
        output = denoise(model, planes, features=features)
        if png:
            strip = np.concatenate([planes["color"], output, reference], 1)
            write_png(png / f"{view.parent.name}-{view.name}-{spp:04}.png", strip)
        yield spp, {n: (m(planes["color"], reference), m(output, reference)) for n, m in metrics.METRICS.items()}


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--weights", required=True)
    p.add_argument("--data", required=True)
    p.add_argument("--scenes", help="comma separated; default: all")
    p.add_argument("--features", default=",".join(FEATURE_NAMES), help="comma separated; empty for none")
    p.add_argument("--png", type=Path, help="folder for pictures")
    args = p.parse_args()
    if args.png:
        args.png.mkdir(parents=True, exist_ok=True)
    model, _ = checkpoint.load_model(args.weights)
    rows = {}
    print("| view | spp | PSNR noisy | PSNR | SSIM noisy | SSIM | relMSE noisy | relMSE | detail noisy | detail |\n" + "|---" * 10 + "|")

    def show(name, spp, values):
        (a, b), (c, d), (e, f), (g, h) = (values[n] for n in metrics.METRICS)
        print(f"| {name} | {spp} | {a:.2f} | {b:.2f} | {c:.3f} | {d:.3f} | {e:.4f} | {f:.4f} | {g:.3f} | {h:.3f} |")

    for view in find_views(args.data, args.scenes and args.scenes.split(",")):
        for spp, values in measure(model, view, args.features.split(","), args.png):
            show(f"{view.parent.name}/{view.name}", spp, values)
            rows.setdefault(spp, []).append(values)
    for spp, measured in sorted(rows.items()):
        show("mean", spp, {n: np.mean([v[n] for v in measured], 0) for n in metrics.METRICS})


if __name__ == "__main__":
    main()
