"""A weights file between two checkpoints: python -m vkdn.blend BASE.pt TUNED.pt OUT.safetensors --share 0.3

Every weight is (1 - share) of the base's and share of the tuned one's, which must have started from the base. Where tuning for
one property costs another, a part of the way often has most of the first and loses little of the second (Wortsman et al.,
"Robust fine-tuning of zero-shot models", 2022).
"""
import argparse

from . import checkpoint, weights
from .arch import from_dict
from .model import Denoiser


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("base")
    p.add_argument("tuned")
    p.add_argument("output")
    p.add_argument("--share", type=float, required=True, help="of the tuned weights, 0 to 1")
    args = p.parse_args()
    base, tuned = (checkpoint.load(path) for path in (args.base, args.tuned))
    model = Denoiser(from_dict(base["architecture"])).eval()
    model.load_state_dict({name: w.lerp(tuned["average"][name], args.share) for name, w in base["average"].items()})
    # What a validation of either said does not hold for the blend.
    record = {key: value for key, value in base["record"].items() if key != "validation_psnr"}
    tuning = {key: tuned["record"][key] for key in ("steps", "lr", "locality", "seed")}
    weights.write(args.output, model, record | {"blended": {"share": args.share, **tuning}})


if __name__ == "__main__":
    main()
