"""What travels: halves and bytes lose no more than they say, weights come back."""
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch

from vkdn import carried, hashweights, packs
from vkdn.arch import ARCHITECTURES, with_head
from vkdn.model import Denoiser


class PacksTest(unittest.TestCase):
    def test_planes_lose_what_their_coding_says(self):
        random = np.random.default_rng(1)
        for name, largest in (("color4", 2**-6), ("reference", 2**-8), ("depth1", 2**-10)):
            shape = (16, 16) if name.startswith("depth") else (3, 16, 16)
            plane = np.exp(random.uniform(-8, 8, shape)).astype(np.float16)
            back = packs.decode(name, packs.encode(name, plane, False), shape, False)
            error = np.abs(back.astype(float) - plane) / plane
            self.assertLessEqual(error.max(), largest * 1.01, name)
        top = np.full((3, 2, 2), 65504, np.float16)
        self.assertTrue(np.isfinite(packs.decode("color1", packs.encode("color1", top, False), top.shape, False)).all())
        normal = random.uniform(-1, 1, (3, 8, 8)).astype(np.float16)
        back = packs.decode("normal1", packs.encode("normal1", normal, True), normal.shape, True)
        self.assertLess(np.abs(back.astype(float) - normal).max(), 0.6 / 127)

    def test_views_come_back(self):
        random = np.random.default_rng(2)
        plane = lambda *shape: random.random(shape).astype(np.float16)
        planes = {"reference": plane(3, 8, 8)}
        for spp in packs.LEVELS:
            planes |= {f"color{spp}": plane(3, 8, 8), f"albedo{spp}": plane(3, 8, 8), f"normal{spp}": plane(3, 8, 8)}
            planes[f"depth{spp}"] = plane(8, 8)
        about = {"scene": "a", "name": "v0", "held": False, "frame": True, "keys": [1.0] * 3, "depth_scales": [1.0] * 3, "side": 8}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "pairs.zip")
            packs.write(path, [(about, {n: packs.encode(n, p, False) for n, p in planes.items()})])
            ((known, back),) = packs.read(path)
        self.assertEqual(known, about)
        self.assertEqual(back.keys(), planes.keys())
        for name, p in planes.items():
            np.testing.assert_allclose(back[name], p, atol=2**-6, err_msg=name)

    def test_weights_come_back(self):
        model = hashweights.fill(Denoiser(with_head(ARCHITECTURES["hybrid"], "pure")), 1)
        with tempfile.TemporaryDirectory() as folder:
            carried.write(path := Path(folder, "start.zip"), model)
            back = carried.read(path)
        self.assertEqual(back.arch, model.arch)
        for (name, a), b in zip(model.named_parameters(), back.parameters()):
            torch.testing.assert_close(a, b, rtol=2**-8, atol=1e-6, msg=name)
