"""A weights file between two: python -m vkdn.blend BASE TUNED OUT.safetensors --share 0.3

Every weight is (1 - share) of the base's and share of the tuned one's, which must have started from the base; each is
a checkpoint or a weights file. Where tuning for one property costs another, a part of the way often has most of the
first and loses little of the second (Wortsman et al., "Robust fine-tuning of zero-shot models", 2022).
"""
import argparse

from . import checkpoint, weights


def blended(base, tuned, share):
    """The base, its parameters a share of the way to those of `tuned`, a model of the same architecture."""
    if base.arch != tuned.arch:
        raise ValueError("the two are of different architectures")
    state = tuned.state_dict()
    base.load_state_dict({name: w.lerp(state[name], share) for name, w in base.state_dict().items()})
    return base


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("base")
    p.add_argument("tuned")
    p.add_argument("output")
    p.add_argument("--share", type=float, required=True, help="of the tuned weights, 0 to 1")
    args = p.parse_args()
    (base, record), (tuned, tuning) = (checkpoint.load_model(path) for path in (args.base, args.tuned))
    # What a validation of either said does not hold for the blend.
    kept = lambda record: {key: value for key, value in record.items() if not key.startswith("validation")}
    record = kept(record) | {"blended": {"share": args.share, **kept(tuning)}}
    weights.write(args.output, blended(base, tuned, args.share), record)


if __name__ == "__main__":
    main()
