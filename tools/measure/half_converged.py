"""Composes frames that are half converged from rendered pairs: an object before a plain background, and an interior
whose lower half has converged. The crops are small, so they are laid out as a mosaic of mirror images, whose borders fit.

    half_converged.py --data PAIRS/test --out DIR        writes object.exr, object_ref.exr, interior.exr, interior_ref.exr
"""
import argparse
from pathlib import Path

import numpy as np
import OpenEXR
from kit import images

CHANNELS = {"color": ("R", "G", "B"), "albedo": ("albedo.R", "albedo.G", "albedo.B"), "normal": ("N.X", "N.Y", "N.Z"),
            "depth": ("Z",), "samples": ("samples.Y",)}
REFERENCE_SAMPLES = 2048
# Of the frame by the object: with the squares of 16x16 pixels at its edge and those beside them it is half of the
# frame.
COVERED = 0.43


def mosaic(plane, size):
    """Mirror images of a plane side by side, cut to size x size."""
    for axis in (0, 1):
        plane = np.concatenate([plane, np.flip(plane, axis)], axis)
        plane = np.concatenate([plane] * -(-size // plane.shape[axis]), axis)
    return plane[:size, :size]


def write(path, planes):
    channels = {}
    for plane, names in CHANNELS.items():
        if plane in planes:
            values = planes[plane].reshape(*planes[plane].shape[:2], -1).astype(np.float32)
            channels |= {name: np.ascontiguousarray(values[..., i]) for i, name in enumerate(names)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))


def read(view, samples, size):
    noisy = images.read_planes(view / f"spp{samples:04}.exr")
    reference = images.read_planes(view / "ref.exr")
    return ({name: mosaic(plane, size) for name, plane in planes.items()} for planes in (noisy, reference))


def disc(size):
    """Whether a pixel lies in the disc."""
    at = np.arange(size) + 0.5 - size / 2
    return np.hypot(at[:, None], at) < size * np.sqrt(COVERED / np.pi)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--object", default="teapot")
    parser.add_argument("--interior", default="living-room")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    noisy, reference = read(args.data / args.object / "v0", args.samples, args.size)
    outside = ~disc(args.size)
    background = np.float32(0.5 * np.median(reference["color"]))
    for planes in (noisy, reference):
        for name, plane in planes.items():
            plane[outside] = background if name == "color" else 0
    write(args.out / "object.exr", noisy)
    write(args.out / "object_ref.exr", reference)

    noisy, reference = read(args.data / args.interior / "v0", args.samples, args.size)
    lower = slice(args.size // 2, None)
    noisy["color"][lower] = reference["color"][lower]
    noisy["samples"] = np.full((args.size, args.size), args.samples, np.float32)
    noisy["samples"][lower] = REFERENCE_SAMPLES
    write(args.out / "interior.exr", noisy)
    write(args.out / "interior_ref.exr", reference)


if __name__ == "__main__":
    main()
