"""A checkpoint's averaged weights as a weights file: python -m vkdn.export best.pt weights/hybrid_kernels.safetensors"""
import argparse

from . import checkpoint, weights


def main():
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("checkpoint")
    p.add_argument("output")
    kept = "kept of each weight, 1 to 10: with fewer the file packs smaller (10)"
    p.add_argument("--mantissa", type=int, default=10, metavar="BITS", help=kept)
    args = p.parse_args()
    if not 1 <= args.mantissa <= 10:
        p.error("--mantissa is 1 to 10 bits")
    model, record = checkpoint.load_model(args.checkpoint)
    weights.write(args.output, model, record, args.mantissa)
    back, _ = weights.read(args.output)
    pairs = zip(model.state_dict().values(), back.state_dict().values())
    worst = max(float((a - b).abs().max() / a.abs().max().clamp_min(1e-12)) for a, b in pairs)
    print(f"{args.output}: {sum(p.numel() for p in back.parameters())} parameters, largest relative rounding {worst:.1e}")


if __name__ == "__main__":
    main()
