"""The head of predicted kernels against a naive loop over pixels, and what its pure form keeps by construction."""
import math
import unittest

import torch

from vkdn import hashweights
from vkdn.head import FEWEST, MOST, KernelHead, WeightedSum, demodulator, spread


def inputs(height, width, channels=8):
    """Random inputs of a head, in the order of its forward."""
    random = torch.Generator().manual_seed(3)
    draw = lambda *shape: torch.randn(*shape, dtype=torch.float64, generator=random)
    log_color = draw(1, 3, height, width).abs()
    tokens = [draw(1, height >> i + 1, width >> i + 1, channels << i) for i in range(4)]
    albedo = draw(1, 3, height, width).clamp(0, 1)
    maps = draw(1, height, width, channels), draw(1, height, width, channels)
    return [*maps, tokens, log_color, log_color + 0.3 * draw(1, 3, height, width), albedo]


def random_head(levels, gated, gloss=False):
    head = KernelHead(8, levels, gated, gloss)
    return hashweights.fill(torch.nn.ModuleDict({"head": head}), 5)["head"].double()


def naive_average(logits, reliability, image, y, x):
    """One pixel's mean. [T], [H][W], [C, H, W]"""
    height, width = reliability.shape
    side = math.isqrt(len(logits))
    total, sums = 0.0, 0.0
    for tap in range(side * side):
        at_y, at_x = y + tap // side - side // 2, x + tap % side - side // 2
        if 0 <= at_y < height and 0 <= at_x < width:
            share = logits[tap].exp() * reliability[at_y, at_x]
            total, sums = total + share, sums + share * image[:, at_y, at_x]
    return sums / total


def naive(head, x0, f0, tokens, log_color, direct, albedo, y, x):
    """One pixel's log1p radiance, by the definition."""
    h = head.hidden(x0, f0, tokens[0], log_color, direct)[0]
    full = head.out_full(h)
    reliability = torch.sigmoid(-full[..., 25])
    a = demodulator(albedo)[0]
    radiance = log_color[0].expm1()
    image = torch.cat([radiance / a, radiance])
    shares = full[y, x, 26:29]
    if len(head.levels) > 3:
        shares = torch.cat([shares, head.out_more(h[y, x])])
    shares = shares.softmax(0)
    mixed = shares[0] * naive_average(full[y, x, :25], reliability, image, y, x)
    for i, side in enumerate(head.levels[1:]):
        blocks = lambda t: t.unflatten(-1, (-1, side)).unflatten(-3, (-1, side)).mean((-3, -1))
        weight = blocks(reliability)
        coarse = blocks(reliability * image) / weight
        logits = head.kernel(side, tokens[i])[0]
        rows, columns = weight.shape
        filtered = lambda r, c: naive_average(logits[:, r, c], weight, coarse, r, c)
        at_y, at_x = (y + 0.5) / side - 0.5, (x + 0.5) / side - 0.5
        level = 0
        for r, c in ((math.floor(at_y) + dy, math.floor(at_x) + dx) for dy in (0, 1) for dx in (0, 1)):
            share = (1 - abs(at_y - r)) * (1 - abs(at_x - c))
            level = level + share * filtered(min(max(r, 0), rows - 1), min(max(c, 0), columns - 1))
        mixed = mixed + shares[i + 1] * level
    gate = full[y, x, 29].sigmoid()
    out = mixed[:3] * naive_average(full[y, x, 30:], torch.ones_like(reliability), a, y, x)
    if head.gloss:
        out = gate * out + (1 - gate) * mixed[3:]
    out = out.log1p()
    return (1 - gate) * direct[0, :, y, x] + gate * out if head.gated else out


class HeadTest(unittest.TestCase):
    def test_is_the_naive_loop(self):
        for levels in (FEWEST, MOST):
            for gated, gloss in ((True, False), (False, False), (False, True)):
                with self.subTest(levels=levels, gated=gated, gloss=gloss), torch.inference_mode():
                    head, given = random_head(levels, gated, gloss), inputs(32, 48)
                    found = head(*given)
                    for y, x in ((0, 0), (31, 47), (1, 46), (13, 20), (16, 31)):
                        torch.testing.assert_close(found[0, :, y, x], naive(head, *given, y, x))

    def test_spread(self):
        x = torch.arange(2 * 3 * 8.0).view(1, 2, 3, 8)
        self.assertEqual(spread(x)[0, 2 * 1 + 1, 2 * 2 + 0, 1], x[0, 1, 2, 2 * 2 + 1])

    def test_gradient_of_the_weighted_sum(self):
        weights = torch.randn(1, 9, 4, 5, dtype=torch.float64, requires_grad=True)
        image = torch.randn(1, 2, 4, 5, dtype=torch.float64, requires_grad=True)
        self.assertTrue(torch.autograd.gradcheck(WeightedSum.apply, (weights, image)))

    def test_pure_kernels_keep_a_constant_and_black(self):
        for gloss in (False, True):
            with self.subTest(gloss=gloss), torch.inference_mode():
                head, (x0, f0, tokens, color, direct, albedo) = random_head(MOST, False, gloss), inputs(32, 48)
                flat, grey = torch.full_like(color, 3.0), torch.full_like(albedo, 0.3)
                torch.testing.assert_close(head(x0, f0, tokens, flat, direct, grey), flat)
                black = head(x0, f0, tokens, torch.zeros_like(color), direct, albedo)
                self.assertEqual(float(black.abs().max()), 0.0)

    def test_gloss_shows_no_texture_of_what_reflects(self):
        """Where nothing is divided by the albedo, a constant stays what it is on any albedo."""
        with torch.inference_mode():
            head, (x0, f0, tokens, color, direct, albedo) = random_head(MOST, False, True), inputs(32, 48)
            head.out_full.weight[29], head.out_full.bias[29] = 0.0, -60.0
            flat = torch.full_like(color, 3.0)
            torch.testing.assert_close(head(x0, f0, tokens, flat, direct, albedo), flat)

    def test_other_levels_are_refused(self):
        with self.assertRaisesRegex(ValueError, "levels"):
            KernelHead(8, (1, 2), False)

    def test_gate_or_gloss(self):
        with self.assertRaisesRegex(ValueError, "gloss"):
            KernelHead(8, MOST, True, True)


if __name__ == "__main__":
    unittest.main()
