"""CPU seconds of one dense 3x3 convolution on a CPU driver: vkdenoise's forms against ncnn's Vulkan convolution.

    python tools/measure/ncnn_conv.py --profile target/release/vkdenoise-profile --size 256 --channels 32 --rounds 5

Both run on the driver that the Vulkan loader finds, with 32-bit floats; `tools/lavapipe-backports python ...` runs the whole on
another one. Rounds alternate between the two programs, so that both meet the same machine; what is compared are medians of
CPU seconds of all threads, the driver's too.
  vkdenoise   the kernel alone, its maps in device memory (`vkdenoise-profile conv`)
  ncnn        what each of CHAIN - 1 more convolutions adds to a network of one: copies and conversions cancel out. ncnn
              chooses the form itself (Winograd here) unless --direct
"""
import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import ncnn
import numpy as np

CHAIN = 5
WARM_UPS = 2


def network(folder, channels, length, direct):
    """A chain of 3x3 convolutions with bias, zero-padded, of random weights."""
    layers = ["Input input 0 1 m0"]
    for i in range(length):
        layers.append(
            f"Convolution conv{i} 1 1 m{i} m{i + 1} 0={channels} 1=3 2=1 3=1 4=1 5=1 6={9 * channels * channels}"
        )
    text = "\n".join(["7767517", f"{len(layers)} {length + 1}", *layers]) + "\n"
    random = np.random.default_rng(1)
    values = []
    for _ in range(length):
        # A flag of 0: the weights are 32-bit floats.
        values.append(np.zeros(1, np.float32))
        values.append(random.uniform(-0.1, 0.1, 9 * channels * channels).astype(np.float32))
        values.append(random.uniform(-0.1, 0.1, channels).astype(np.float32))
    param, binary = folder / f"{length}.param", folder / f"{length}.bin"
    param.write_text(text)
    binary.write_bytes(b"".join(part.tobytes() for part in values))
    net = ncnn.Net()
    options = net.opt
    options.use_vulkan_compute = True
    for name in ("use_fp16_packed", "use_fp16_storage", "use_fp16_arithmetic", "use_int8_storage", "use_bf16_storage"):
        if hasattr(options, name):
            setattr(options, name, False)
    if direct:
        options.use_winograd_convolution = False
        options.use_sgemm_convolution = False
    if net.load_param(str(param)) or net.load_model(str(binary)):
        raise SystemExit("ncnn does not take the network")
    return net


def cpu_seconds(net, image, length):
    start = time.process_time()
    extractor = net.create_extractor()
    extractor.input("m0", image)
    code, result = extractor.extract(f"m{length}")
    took = time.process_time() - start
    if code or not np.isfinite(np.array(result)).all():
        raise SystemExit("ncnn computed nothing")
    return took


def ncnn_seconds(nets, image, runs):
    samples = {length: [cpu_seconds(net, image, length) for _ in range(runs)] for length, net in nets.items()}
    one, chain = (statistics.median(samples[length]) for length in (1, CHAIN))
    return (chain - one) / (CHAIN - 1)


def vkdenoise_seconds(args):
    command = [args.profile, "conv", "--size", f"{args.size}x{args.size}", "--channels", str(args.channels)]
    command += ["--repeat", str(args.runs), "--warm-up", str(WARM_UPS), "--json"]
    report = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    standard = [way for way in report["variants"] if way["name"] == "direct" or way["name"].startswith("F(")]
    return {way["name"]: way["cpu_ms"]["median"] / 1e3 for way in standard}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--profile", required=True, help="the program vkdenoise-profile")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--channels", type=int, default=32)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--runs", type=int, default=5, help="timed runs of each in a round")
    parser.add_argument("--direct", action="store_true", help="ncnn without Winograd and matrix products")
    args = parser.parse_args()
    print("device of ncnn:", ncnn.get_gpu_info(0).device_name())
    values = np.random.default_rng(2).uniform(0, 1, (args.channels, args.size, args.size)).astype(np.float32)
    image = ncnn.Mat(values).clone()  # a Mat does not keep what it was made of
    rounds = []
    with tempfile.TemporaryDirectory() as folder:
        nets = {length: network(Path(folder), args.channels, length, args.direct) for length in (1, CHAIN)}
        ncnn_seconds(nets, image, WARM_UPS)
        for _ in range(args.rounds):
            rounds.append((vkdenoise_seconds(args), ncnn_seconds(nets, image, args.runs)))
        nets.clear()
    gflop = 2 * 9 * args.channels**2 * args.size**2 / 1e9
    peer = statistics.median(seconds for _, seconds in rounds)
    print(f"ncnn: {peer * 1e3:.1f} ms of CPU time, {gflop / peer:.2f} GFLOP per core-second")
    for name in rounds[0][0]:
        own = statistics.median(ways[name] for ways, _ in rounds)
        ratio = statistics.median(ways[name] / seconds for ways, seconds in rounds)
        print(f"vkdenoise, {name}: {own * 1e3:.1f} ms, {gflop / own:.2f} GFLOP per core-second, ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
