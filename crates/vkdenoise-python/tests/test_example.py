"""The example: a render of Mitsuba's, denoised."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mitsuba
import numpy
import pytest


def test_a_render_is_denoised(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    example = pytestconfig.rootpath / "examples" / "mitsuba_render.py"
    done = subprocess.run([sys.executable, str(example)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    mitsuba.set_variant("scalar_rgb")
    noisy, clean = (
        numpy.array(mitsuba.Bitmap(str(tmp_path / name))).astype(numpy.float32) for name in ("noisy.png", "clean.png")
    )
    assert noisy.shape == clean.shape == (256, 256, 3)
    # Of the back wall, without an edge: what differs there is noise.
    noise = [numpy.abs(numpy.diff(image[120:170, 140:190], axis=1)).mean() for image in (noisy, clean)]
    assert noise[1] < noise[0] / 5
    assert abs(clean.mean() - noisy.mean()) < 0.05 * noisy.mean()
