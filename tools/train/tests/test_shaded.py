"""Radiance made of features: as the lights have it, of the usual key, with a noise that is right on average."""
import unittest

import torch

from vkdn import shaded
from vkdn.crops import KEY, Batches, Changes, Store
from vkdn.preprocess import MIDDLE_GREY

SIDE = 32


def features(count, side=SIDE):
    """Albedo that differs from crop to crop, normals towards the camera, some depth."""
    albedo = torch.linspace(0.2, 0.9, count).view(-1, 1, 1, 1).expand(-1, 3, side, side)
    normal = torch.tensor([0.0, 0, 1]).view(1, 3, 1, 1).expand(count, 3, side, side)
    return torch.cat([albedo, normal, torch.ones(count, 1, side, side)], 1)


class ShadedTest(unittest.TestCase):
    def setUp(self):
        torch.manual_seed(1)

    def test_radiance_has_the_usual_key_and_follows_the_albedo(self):
        given = features(64, 128)
        given[:, :3, :, :64] *= 0.25
        radiance, told = shaded.shade(given, torch.ones(64, dtype=torch.bool))
        key = radiance.mean(1).log().mean((1, 2)).exp()
        torch.testing.assert_close(key, torch.full_like(key, MIDDLE_GREY), rtol=1e-3, atol=0)
        self.assertTrue((told[:, :3] <= given[:, :3]).all() and (told[:, 3:] == given[:, 3:]).all())
        # What the albedo does not tell is smooth: shadows, of four pixels or more from edge to edge.
        light = (radiance / told[:, :3].clamp_min(shaded.DARKEST_ALBEDO)).mean(1)
        step = (light[:, :, 1:] - light[:, :, :-1]).abs() / light.amax((1, 2), keepdim=True)
        self.assertLess((step > 0.1).float().mean().item(), 0.15)

    def test_some_albedo_is_grained_and_some_is_not(self):
        grained = torch.arange(400) < 200
        _, told = shaded.shade(features(400), grained)
        spread = told[:, 0].flatten(1).std(1) / told[:, 0].flatten(1).mean(1)
        self.assertAlmostEqual((spread[grained] < 1e-6).float().mean().item(), 0.3, delta=0.1)
        self.assertLess(spread[~grained].max().item(), 1e-6)
        self.assertGreater(spread.max().item(), 0.2)

    def test_noise_is_right_on_average_and_half_of_the_crops_have_none(self):
        radiance = torch.full((400, 3, SIDE, SIDE), 2.0)
        noisy = shaded.noisy(radiance)
        still = (noisy == radiance).flatten(1).all(1)
        self.assertAlmostEqual(still.float().mean().item(), 0.5, delta=0.1)
        self.assertAlmostEqual(noisy.mean().item(), 2, delta=0.01)
        deviation = (noisy[~still] / 2).flatten(1).std(1)
        # Log-normal: of a deviation of 1.5 in the logarithm it is 2.9.
        self.assertLess(deviation.max().item(), 2.9)
        self.assertGreater(deviation.max().item(), 1)
        self.assertLess(deviation.min().item(), 0.02)

    def test_batches_have_their_share_and_count_them_as_clean(self):
        store = Store("cpu")
        color = torch.full((2, 3, 3, SIDE, SIDE), 9.0)
        planes = features(2)[:, None].expand(-1, 3, -1, -1, -1)
        store.add(color, planes, color[:, 0], torch.ones(2), False, torch.ones(2))
        batches = Batches(store.finish(), 400, Changes(shaded=0.25, clean=0, hard=0))
        *_, reference, _, _, hard, clean, bare, whole = batches.pick()
        made = (reference - 9).flatten(1).abs().amax(1) > 1e-3
        self.assertTrue((made == clean).all() and not hard.any())
        # Grain that no feature tells of would be noise.
        self.assertTrue((whole == (made & ~bare)).all())
        self.assertAlmostEqual((made & bare).float().sum().item() / made.sum().item(), 0.55, delta=0.13)
        self.assertAlmostEqual(made.float().mean().item(), 0.25, delta=0.07)
        self.assertAlmostEqual(reference[made].mean(1).log().mean().exp().item(), KEY, delta=0.02)


if __name__ == "__main__":
    unittest.main()
