"""The Triton programs against PyTorch, by Triton's interpreter: no GPU is needed."""
import importlib.util
import os
import subprocess
import sys
import unittest

CHECK = """
import torch
from torch import nn
from vkdn import averages, depthwise, head

torch.manual_seed(0)
near = lambda a, b: torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)
for taps, height, width in ((25, 9, 13), (9, 5, 4), (25, 2, 3)):
    inputs = [3 * torch.randn(2, taps, height, width), torch.rand(2, 1, height, width), 5 * torch.rand(2, 3, height, width)]
    inputs[1][0, 0, 1, 2] = 0
    for t in inputs:
        t.requires_grad_()
    grad = torch.randn(2, 3, height, width)
    expected, got = head.average_by_taps(*inputs), averages.average(*inputs)
    near(got, expected)
    for a, b in zip(torch.autograd.grad(got, inputs, grad), torch.autograd.grad(expected, inputs, grad)):
        near(a, b)
x, grad = torch.randn(2, 5, 7, 32, requires_grad=True), torch.randn(2, 5, 7, 32)
conv = nn.Conv2d(32, 32, 3, padding=1, groups=32)
inputs = [x, conv.weight, conv.bias]
expected, got = conv(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1), depthwise.run(conv, x)
near(got, expected)
for a, b in zip(torch.autograd.grad(got, inputs, grad), torch.autograd.grad(expected, inputs, grad)):
    near(a, b)
"""


@unittest.skipUnless(importlib.util.find_spec("triton"), "no Triton here")
class TritonTest(unittest.TestCase):
    def test_programs_are_pytorch_s(self):
        # A process of its own: the interpreter is chosen when the programs are imported.
        done = subprocess.run([sys.executable, "-c", CHECK], env=os.environ | {"TRITON_INTERPRET": "1"}, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
