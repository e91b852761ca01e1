"""CPU seconds of vkdenoise on a CPU driver against those of the same network in PyTorch, and their ratio.

    python tools/measure/speed.py --bench target/release/vkdenoise-bench [--driver-command tools/lavapipe-backports] \\
        --size 512x512 --runs 15

Runs alternate, so that both meet the same machine, and both are warm. What each side counts:
  vkdenoise   the whole host path of one frame (copies in and out, statistics, pre-processing, network, post-processing), all
              threads of the process, the driver's too
  PyTorch     the network alone, eager, fp32, inference mode, on input padded beforehand to the same multiple; all threads
"""
import argparse
import json
import os
import shlex
import statistics
import subprocess
import time
from contextlib import contextmanager, suppress
from pathlib import Path

# Read when PyTorch loads. Threads that spin while they wait would count as work.
os.environ["OMP_WAIT_POLICY"] = "passive"

import torch  # noqa: E402
from tqdm import tqdm  # noqa: E402

from kit import model, weights  # noqa: E402

SHIPPED = Path(__file__).resolve().parents[2] / "weights" / "hybrid_kernels.safetensors"
THREADS = 2
WARM_UPS = 2


@contextmanager
def bench_process(args, size):
    """A function that runs one pass of the benchmark program and returns its JSON report."""
    command = [*shlex.split(args.driver_command), args.bench, "pass", "--on-request", "--warm-up", str(WARM_UPS)]
    command += ["--size", "{}x{}".format(*size), "--weights", str(args.weights)]
    command += ["--precision", args.precision]
    if args.device:
        command += ["--device", args.device]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as process:

        def run():
            # A program that has ended, with a message of its own, shows by its silence.
            with suppress(BrokenPipeError):
                process.stdin.write(b"\n")
            line = process.stdout.readline()
            if not line:
                raise SystemExit(f"{args.bench} ended with code {process.wait()}")
            return json.loads(line)

        yield run
        process.stdin.close()


def pytorch_network(weights_file, size):
    """A function that runs the network once and returns its CPU seconds. size: (width, height)"""
    torch.set_num_threads(THREADS)
    network = weights.read(weights_file)[0]
    width, height = size
    color, aux = torch.rand(1, 3, height, width), torch.rand(1, 7, height, width)
    color, aux = (model.pad(t, network.arch.multiple) for t in (color, aux))

    def run():
        with torch.inference_mode():
            start = time.process_time()
            network(color, aux, (height, width))
            return time.process_time() - start

    for _ in range(WARM_UPS):
        run()
    return run


def measure(args):
    width, height = size = tuple(map(int, args.size.split("x")))
    run_pytorch = pytorch_network(args.weights, size)
    passes, pytorch = [], []
    with bench_process(args, size) as run_vkdenoise:
        for _ in tqdm(range(args.runs)):
            passes.append(run_vkdenoise())
            pytorch.append(run_pytorch())
    vkdenoise = [p["cpu_s"] for p in passes]
    medians = {"vkdenoise": statistics.median(vkdenoise), "pytorch": statistics.median(pytorch)}
    return {
        "width": width,
        "height": height,
        "precision": args.precision,
        **{key: passes[0][key] for key in ("device", "driver", "device_bytes")},
        "torch": torch.__version__,
        "cpu_s": {"vkdenoise": vkdenoise, "pytorch": pytorch},
        "median_cpu_s": medians,
        "ratio": medians["vkdenoise"] / medians["pytorch"],
    }


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--bench", required=True, help="vkdenoise-bench")
    p.add_argument("--driver-command", default="", help="command that runs the benchmark on another driver")
    p.add_argument("--precision", default="auto", help="of vkdenoise: auto (on a CPU fp32), fp32 or fp16")
    p.add_argument("--device", help="as vkdenoise-bench takes it")
    p.add_argument("--weights", type=Path, default=SHIPPED)
    p.add_argument("--size", default="512x512", help="width x height in pixels")
    p.add_argument("--runs", type=int, default=15)
    p.add_argument("--json", type=Path, help="file for the figures; default: after the table")
    args = p.parse_args()
    result = measure(args)
    print(f"{result['device']} ({result['driver']}), {args.size}, precision {args.precision}, medians of {args.runs} alternating runs\n")
    print("| | CPU seconds | least | most |\n|---|---|---|---|")
    for name, runs in result["cpu_s"].items():
        print(f"| {name} | {statistics.median(runs):.3f} | {min(runs):.3f} | {max(runs):.3f} |")
    print(f"\nratio {result['ratio']:.2f}\n")
    text = json.dumps(result)
    args.json.write_text(text + "\n") if args.json else print(text)


if __name__ == "__main__":
    main()
