"""Rendered pairs in few bytes, for a machine that trains: python -m vkdn.packs --data PAIRS --out pairs.zip

A pack is a zip of LZMA entries: views.json, a list of what is known of each view (views.py), and "<number>/<plane>"
for each of its planes. Of the halves that a renderer wrote, noisy radiance keeps NOISY bits of mantissa (its own noise
is far larger), references and held- out radiance more; albedo and normals become bytes. Reading needs numpy and the
standard library only.
"""
import argparse
import json
import zipfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np

LEVELS = (1, 4, 32)
FEATURES = ("albedo", "normal", "depth")
MANTISSA = 10
# Bits of mantissa kept.
NOISY, REFERENCE, HELD, DEPTH = 5, 7, 8, 9


def rounded(plane, kept):
    """Halves rounded to `kept` bits of mantissa, as their bits; never up to infinity."""
    bits = np.ascontiguousarray(plane, np.float16).view(np.uint16).astype(np.int32)
    drop = MANTISSA - kept
    if drop == 0:
        return bits
    up = (bits + (1 << (drop - 1)) >> drop) << drop
    return np.where(up & 0x7FFF > 0x7BFF, (bits >> drop) << drop, up)


def halves_to_bytes(plane, kept, smooth):
    """The high bytes, then the low ones; of a `smooth` plane the differences along rows, which compress better."""
    bits = rounded(plane, kept)
    if smooth:
        bits = np.diff(bits >> (MANTISSA - kept), axis=-1, prepend=0) & 0xFFFF
    bits = bits.astype(np.uint16)
    return np.stack([(bits >> 8).astype(np.uint8), (bits & 255).astype(np.uint8)]).tobytes()


def bytes_to_halves(data, shape, kept, smooth):
    high, low = np.frombuffer(data, np.uint8).reshape(2, *shape).astype(np.uint16)
    bits = high << 8 | low
    if smooth:
        bits = np.cumsum(bits, axis=-1, dtype=np.uint16) << (MANTISSA - kept)
    return bits.astype(np.uint16).view(np.float16)


def coding(name, held):
    """(kind, bits kept, whether differences) of a plane."""
    if name.startswith(("albedo", "normal")):
        return "byte", 8, False
    if name.startswith("depth"):
        return "half", DEPTH, True
    if name == "reference":
        return "half", HELD if held else REFERENCE, True
    return "half", HELD if held else NOISY, False


def encode(name, plane, held):
    kind, kept, smooth = coding(name, held)
    if kind == "half":
        return halves_to_bytes(plane, kept, smooth)
    plane = plane.astype(np.float32)
    plane = np.where(np.isfinite(plane), plane, 0)
    if name.startswith("albedo"):
        return np.round(np.clip(plane, 0, 1) * 255).astype(np.uint8).tobytes()
    return np.round(np.clip(plane, -1, 1) * 127).astype(np.int8).tobytes()


def decode(name, data, shape, held):
    """-> halves"""
    kind, kept, smooth = coding(name, held)
    if kind == "half":
        return bytes_to_halves(data, shape, kept, smooth)
    kind, most = (np.uint8, 255) if name.startswith("albedo") else (np.int8, 127)
    return (np.frombuffer(data, kind).reshape(shape) / np.float32(most)).astype(np.float16)


def pack_one(job):
    """(path, held-out scenes) -> (what is known of a view, {plane: its bytes})."""
    from . import views

    about, planes = views.one_view(*job)
    return about, {name: encode(name, plane, about["held"]) for name, plane in planes.items()}


def write(out, views):
    with zipfile.ZipFile(out, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("views.json", json.dumps([about for about, _ in views]))
        for i, (_, planes) in enumerate(views):
            for name, data in planes.items():
                file.writestr(f"{i}/{name}", data)


def read(path, workers=16):
    """[(what is known of a view, {plane: halves})], as views.py has it."""
    with zipfile.ZipFile(path) as file:
        known = list(enumerate(json.loads(file.read("views.json"))))

    def one(job):
        i, about = job
        side = about["side"]
        planes = {}
        with zipfile.ZipFile(path) as file:
            for name in ["reference", *(f"{n}{spp}" for spp in LEVELS for n in ("color", *FEATURES))]:
                shape = (side, side) if name.startswith("depth") else (3, side, side)
                planes[name] = decode(name, file.read(f"{i}/{name}"), shape, about["held"])
        return about, planes

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, known))


def pack(data, out, held_scenes, workers=2):
    """The views of a folder of pairs as a pack."""
    from .images import find_views

    with ProcessPoolExecutor(workers) as pool:
        views = list(pool.map(pack_one, [(path, held_scenes) for path in find_views(data)], chunksize=4))
    write(out, views)
    return len(views)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, help="<scene>/<view>/ directories of pairs with 1, 4 and 32 samples")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--hold-out", default="car2,classroom", help="scenes for validation, comma separated")
    p.add_argument("--workers", type=int, default=2)
    args = p.parse_args()
    count = pack(args.data, args.out, set(filter(None, args.hold_out.split(","))), args.workers)
    print(f"{args.out}: {count} views, {args.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
