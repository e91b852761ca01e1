"""Attention against plain loops, shuffles, padding, and that padded tokens stay out of the FiLM mean."""
import math
import unittest

import torch

from vkdn import hashweights
from vkdn.arch import ARCHITECTURES, Block
from vkdn.blocks import make_block
from vkdn.model import Denoiser, down, mirror_index, predict, up


def naive_attention(block, x, f):
    """`JointAttention.attend`, one query, one key, one channel group at a time. [H, W, C] double"""
    a = block.norm1(x[..., : block.part])
    g = block.norm1_f(f[..., : block.part])
    q, k, v, qf, kf = block.q(a), block.k(a), block.v(a), block.qf(g), block.kf(g)
    height, width, _ = x.shape
    dk, dv, n = q.shape[-1] // block.heads, v.shape[-1] // block.heads, block.window
    out = torch.zeros_like(v)
    for y in range(height):
        for x_ in range(width):
            top, left = y // n * n, x_ // n * n
            for head in range(block.heads):
                kk, vv = slice(head * dk, head * dk + dk), slice(head * dv, head * dv + dv)
                scores = []
                for ky in range(top, top + n):
                    for kx in range(left, left + n):
                        bias = block.bias_table[(y - ky + n - 1) * (2 * n - 1) + x_ - kx + n - 1, head]
                        s = q[y, x_, kk] @ k[ky, kx, kk] / math.sqrt(dk) + bias
                        sf = qf[y, x_, kk] @ kf[ky, kx, kk] / math.sqrt(dk) + bias
                        scores.append(s * sf)
                weights = torch.stack(scores).softmax(0)
                values = v[top : top + n, left : left + n, vv].reshape(-1, dv)
                out[y, x_, vv] = weights @ values
    return out


def random_block(kind, channels, window, heads, seed):
    """Hash weights depend on names, and names in a model are dotted."""
    block = make_block(kind, channels, window, heads).eval()
    hashweights.fill(torch.nn.ModuleDict({"block": block}), seed)
    return block


class ModelTest(unittest.TestCase):
    def test_attention_is_the_naive_loop(self):
        for kind, channels, heads in ((Block("jsa"), 12, 2), (Block("sh_jsa", ratio=0.5), 16, 1)):
            with self.subTest(kind), torch.inference_mode():
                block = random_block(kind, channels, 4, heads, 3).double()
                x, f = torch.randn(2, 4, 8, channels, dtype=torch.float64)
                expected = naive_attention(block, x, f)
                torch.testing.assert_close(block.attend(x[None], f[None])[0], expected)

    def test_shuffles(self):
        x = torch.randn(1, 4, 6, 8)
        identity = torch.nn.Conv2d(8, 8, 1, bias=False)
        identity.weight.data = torch.eye(8)[:, :, None, None]
        small = down(identity, x)
        self.assertEqual(small.shape, (1, 2, 3, 32))
        self.assertEqual(small[0, 1, 2, 5 * 4 + 2 * 1 + 0], x[0, 3, 4, 5])
        wide = torch.nn.Conv2d(32, 32, 1, bias=False)
        wide.weight.data = torch.eye(32)[:, :, None, None]
        self.assertTrue(torch.equal(up(wide, small), x))

    def test_mirror(self):
        self.assertEqual(mirror_index(3, 8).tolist(), [0, 1, 2, 1, 0, 1, 2, 1])
        self.assertEqual(mirror_index(1, 4).tolist(), [0, 0, 0, 0])
        self.assertEqual(mirror_index(8, 8).tolist(), list(range(8)))
        self.assertEqual(mirror_index(5, 4).tolist(), [0, 1, 2, 3, 4, 3, 2, 1])

    def test_film_mean_is_of_real_tokens(self):
        block = random_block(Block("film_cnn", conv="separable"), 8, 8, 1, 1)
        x, f = torch.randn(2, 1, 8, 8, 8)
        changed = f.clone()
        changed[:, 5:] = 9
        changed[:, :, 3:] = 9
        self.assertTrue(torch.equal(block(x, f, (5, 3)), block(x, changed, (5, 3))))

    def test_any_size(self):
        model = hashweights.fill(Denoiser(ARCHITECTURES["hybrid"]), 1).eval()
        with torch.inference_mode():
            for size in ((1, 1), (1, 7), (129, 3)):
                r = predict(model, torch.rand(1, 3, *size), torch.rand(1, 7, *size))
                self.assertEqual(r.shape, (1, 3, *size))
                self.assertTrue(r.isfinite().all())
