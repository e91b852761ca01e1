"""What weights answer for when nothing is to be denoised: flat frames, clean frames, the energy of noisy ones.

    pip install vkdenoise-*.whl OpenEXR
    python tools/measure/neutral.py --data PAIRS/test --method balanced --method weights/hybrid.safetensors --method OIDN

Prints a Markdown table, a column for each method: a quality or a file of weights; pytorch:FILE is the training kit's network with
those weights, or a checkpoint's; OIDN is a method too (pip install pyoidn).
"""
import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "train"))
from vkdn import images, metrics  # noqa: E402

ENERGY_SPP = (4, 32)
PYTORCH = "pytorch:"
SMALLER = 4


def denoiser(name):
    """name -> function of (colour [H, W, 3], exposure or None, features) to the clean colour."""
    if name == "OIDN":
        import pyoidn

        def run(color, exposure=None, **features):
            features.pop("depth", None)
            return pyoidn.denoise(color, **features, hdr=True, clean_aux=False, quality="high")

        return run
    if name.startswith(PYTORCH):
        return by_the_kit(name.removeprefix(PYTORCH))
    import vkdenoise

    made = vkdenoise.Denoiser(**({"weights": name} if Path(name).exists() else {"quality": name}))
    return lambda color, exposure=None, **features: made.denoise(color, exposure=exposure, **features)


def by_the_kit(path):
    from vkdn import checkpoint, preprocess
    from vkdn.denoise import denoise

    model, _ = checkpoint.load_model(path)

    def run(color, exposure=None, **features):
        stats = preprocess.statistics(color, features.get("depth"))
        if exposure:
            stats = preprocess.Statistics(preprocess.MIDDLE_GREY / exposure, stats.depth_scale)
        return denoise(model, {"color": color, **features}, stats)

    return run


def change(image, reference):
    """Root mean square of the difference, of the mean."""
    return float(np.sqrt(((image - reference) ** 2).mean()) / reference.mean())


def flat(run):
    """{case: figure} of frames without texture or noise."""
    constant = run(np.ones((48, 64, 3), np.float32))
    ramp = np.broadcast_to(np.linspace(0, 4, 64, dtype=np.float32)[None, :, None], (48, 64, 3)).copy()
    black = run(np.zeros((48, 64, 3), np.float32))
    return {
        "a constant 1: least sample (asked: at least 0.998)": f"{constant.min():.5f}",
        "a constant 1: largest sample": f"{constant.max():.5f}",
        "all black: largest sample (0)": f"{black.max():.1g}",
        "a ramp from 0 to 4: change (at most 0.005)": f"{change(run(ramp), ramp):.4f}",
    }


def means(plane):
    """Of SMALLER x SMALLER pixels each: what is left of the noise is a fourth."""
    height, width, channels = plane.shape
    blocks = plane.reshape(height // SMALLER, SMALLER, width // SMALLER, SMALLER, channels)
    return np.ascontiguousarray(blocks.mean((1, 3)), np.float32)


def of_halves(view, run):
    """{case: figure} where the reference comes in two halves of its samples. What a denoiser takes from one of them is noise
    if that brings it nearer to the other."""
    halves = [view / "ref_a.exr", view / "ref_b.exr"]
    if not all(half.exists() for half in halves):
        return {}
    given, other = (images.read_planes(half)["color"] for half in halves)
    nearer = metrics.psnr(run(given, 1.0), other) - metrics.psnr(given, other)
    itself = metrics.psnr(given, other) + 10 * np.log10(4)
    name = view.parent.name
    return {
        f"{name}, half of the reference: PSNR to the other half, gained (more than 0)": f"{nearer:+.2f} dB",
        f"{name}, reference: its noise by its halves, PSNR": f"{itself:.1f}",
    }


def of_view(view, run):
    """{case: figure} of a rendered view."""
    name, reference = view.parent.name, images.read_planes(view / "ref.exr")["color"]
    clean = run(reference, 1.0)
    small = means(reference)
    small_clean = run(small, 1.0)
    found = {
        f"{name}, reference at exposure 1: change": f"{change(clean, reference):.4f}",
        f"{name}, reference at exposure 1: PSNR to itself": f"{metrics.psnr(clean, reference):.1f}",
        **of_halves(view, run),
        f"{name}, means of 4x4 of its pixels: change (at most 0.005)": f"{change(small_clean, small):.4f}",
        f"{name}, means of 4x4 of its pixels: PSNR to themselves (at least 45 dB)":
            f"{metrics.psnr(small_clean, small):.1f}",
    }
    for spp, path in images.sample_files(view).items():
        if spp in ENERGY_SPP:
            planes = images.read_planes(path)
            color = planes.pop("color")
            energy = run(color, None, **planes).mean() / color.mean() - 1
            found[f"{name}, {spp} samples: energy is off by (at most 0.005)"] = f"{energy:+.4f}"
    return found


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True)
    p.add_argument("--method", action="append", required=True)
    args = p.parse_args()
    columns = {}
    for name in args.method:
        run = denoiser(name)
        columns[Path(name).stem] = flat(run)
        for view in images.find_views(args.data):
            columns[Path(name).stem] |= of_view(view, run)
            print(f"{name}: {view.parent.name}", file=sys.stderr)
    print("| case | " + " | ".join(columns) + " |")
    print("|---" * (1 + len(columns)) + "|")
    for case in next(iter(columns.values())):
        print(f"| {case} | " + " | ".join(column[case] for column in columns.values()) + " |")


if __name__ == "__main__":
    main()
