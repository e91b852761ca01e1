"""The denoisers that are compared. Each takes an `Input` and returns linear radiance [H, W, 3], float32."""
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import OpenEXR
import pyoidn

import bilateral
from kit import images, run_pytorch, weights


@dataclass(frozen=True)
class Input:
    """A noisy EXR and its sample count. Methods use the features that the file has."""

    path: Path
    spp: int

    @cached_property
    def planes(self):
        return images.read_planes(self.path)


def write_color_only(source, target):
    """Copies an EXR's R, G, B in their own type and none of its other channels."""
    with OpenEXR.File(str(source), separate_channels=True) as file:
        color = {name: file.channels()[name].pixels for name in images.COLOR}
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, color).write(str(target))


def noisy(frame):
    return frame.planes["color"]


def cross_bilateral(frame):
    return bilateral.denoise(frame.planes, frame.spp)


def oidn(frame):
    """Intel Open Image Denoise as a renderer's preview would call it: features as rendered, not denoised beforehand."""
    features = {name: frame.planes[name] for name in ("albedo", "normal") if name in frame.planes}
    return pyoidn.denoise(frame.planes["color"], **features, hdr=True, clean_aux=False, quality="high")


def vkdenoise(binary, *options):
    """The command line tool, files in and out as its users have it."""

    def run(frame):
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder, "denoised.exr")
            subprocess.run([binary, frame.path, "-o", output, "--quiet", *options], check=True)
            return images.read_planes(output)["color"]

    return run


def pytorch(weights_file):
    """The training kit's own definition of the network: the engine should measure the same."""
    network = weights.read(weights_file)[0]
    return lambda frame: run_pytorch(network, frame.planes)
