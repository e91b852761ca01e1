"""Weights files of this and of earlier pre-processing."""
import json
import tempfile
import unittest
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from vkdn import hashweights, weights
from vkdn.arch import ARCHITECTURES
from vkdn.model import Denoiser


class WeightsTest(unittest.TestCase):
    def test_earlier_versions_are_read_and_others_are_not(self):
        rules = {"exposure": "auto", "depth": "percentile"}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "weights.safetensors"
            weights.write(path, hashweights.fill(Denoiser(ARCHITECTURES["hybrid"]), 1), {})
            with safe_open(path, "pt") as file:
                metadata = dict(file.metadata())
                tensors = {name: file.get_tensor(name) for name in file.keys()}
            self.assertEqual(json.loads(metadata["preprocessing"])["version"], 2)

            def read(preprocessing):
                save_file(tensors, path, {**metadata, "preprocessing": json.dumps(preprocessing)})
                return weights.read(path)

            for known in rules, {**rules, "version": 1}, {**rules, "version": 2}:
                read(known)
            for other in {**rules, "version": 3}, {**rules, "exposure": "none"}, {**rules, "depth": "maximum"}:
                with self.assertRaises(ValueError):
                    read(other)

    def test_fewer_bits_of_mantissa_are_the_nearest(self):
        ties = torch.tensor([1 + 2**-9, 1 + 2**-10, 1 + 3 * 2**-10])
        values = torch.cat([torch.randn(1000), torch.randn(1000) * 1e-6, ties])
        self.assertTrue(torch.equal(weights.to_half("w", values, 10), values.half()))
        nine = weights.to_half("w", values, 9)
        self.assertTrue(torch.all(nine[:1000].view(torch.int16) % 2 == 0))
        self.assertLessEqual(float((nine[:1000].float() / values[:1000] - 1).abs().max()), 2**-10)
        self.assertEqual(nine[-3:].tolist(), [1 + 2**-9, 1.0, 1 + 2 * 2**-9])
