"""Batches made on the device: the same rules as for single frames, and noise that is right on average."""
import unittest

import numpy as np
import torch

from vkdn import preprocess
from vkdn.crops import KEY, Batches, Changes, Store, auxiliary, repair

STILL = dict(blend=0, shift=0, drop_one=0, drop_all=0, fireflies=0, emitters=0, exposure=0, exposure_crop=0, depth=0)
STILL |= dict(depth_crop=0, hard=0, hard_exposure=0, grain=0, clean=0, shaded=0)
SIDE = 16


def store(hard):
    """Three crops of random radiance, features that tell the crop, references twice the colour of the last level."""
    random = torch.Generator().manual_seed(1)
    levels = 6 if hard else 3
    color = torch.rand(3, levels, 3, SIDE, SIDE, generator=random)
    features = torch.arange(3.0).view(3, 1, 1, 1, 1).expand(3, levels, 7, SIDE, SIDE) / 4 + 0.1
    return Store("cpu"), (color, features, 2 * color[:, 2], torch.ones(3), hard, torch.ones(3))


class CropsTest(unittest.TestCase):
    def test_unchanged_crops_come_out_turned_at_most(self):
        kept, parts = store(False)
        kept.add(*parts)
        torch.manual_seed(2)
        c, aux, target, _ = Batches(kept.finish(), 24, Changes(favour=9, **STILL)).batch()
        crops = ((aux[:, 0, 0, 0] - 0.1) * 4).round().long()
        self.assertEqual(set(crops.tolist()), {0, 1, 2})
        for image, crop, reference in zip(c, crops, target):
            sorted_values = lambda t: t.flatten().sort().values
            original = parts[0][crop, 2].half().float()
            torch.testing.assert_close(sorted_values(image.expm1()), sorted_values(original), rtol=1e-5, atol=1e-6)
            torch.testing.assert_close(reference.expm1(), 2 * image.expm1(), rtol=2e-3, atol=1e-3)

    def test_chosen_rows_of_extreme_noise(self):
        kept, parts = store(True)
        kept.add(*parts)
        torch.manual_seed(3)
        c, aux, *_ = Batches(kept.finish(), 8, Changes(favour=9, **STILL | {"hard": 1})).batch()
        for image, value in zip(c, aux[:, 0, 0, 0]):
            original = parts[0][((value - 0.1) * 4).round().long(), 5].half().float()
            torch.testing.assert_close(image.expm1().mean(), original.mean(), rtol=1e-5, atol=1e-6)

    def test_thinned_radiance_is_right_on_average(self):
        kept, parts = store(False)
        kept.add(*parts)
        batches = Batches(kept.finish(), 400)
        torch.manual_seed(4)
        thinned = torch.stack([batches.thinned(torch.ones(400, 3, SIDE, SIDE)) for _ in range(4)])
        self.assertAlmostEqual(thinned.mean().item(), 1, delta=0.03)
        self.assertGreater((thinned == 0).float().mean().item(), 0.4)
        self.assertGreater(thinned.max().item(), 100)

    def test_real_crops_have_their_share(self):
        kept, parts = store(False)
        kept.add(*parts)
        _, (color, features, reference, *rest) = store(True)
        kept.add(color, features, torch.full_like(reference, 9), *rest)
        batches = Batches(kept.finish(), 500, Changes(real=0.25, shaded=0))
        self.assertEqual((kept.real, kept.count), (3, 6))
        torch.manual_seed(5)
        shares = [(batches.pick()[2][:, 0, 0, 0] != 9).float().mean().item() for _ in range(8)]
        self.assertAlmostEqual(sum(shares) / 8, 0.25, delta=0.03)

    def test_clean_crops_are_the_reference_or_near_it(self):
        kept, parts = store(True)
        kept.add(*parts)
        torch.manual_seed(7)
        changes = STILL | {"clean": 1, "clean_bare": 0.5, "clean_below": 9, "hard": 1, "fireflies": 1}
        c, aux, target, clean = Batches(kept.finish(), 400, Changes(**changes)).batch()
        self.assertTrue((clean == 1).all())
        off = (c - target).abs().flatten(1).amax(1)
        self.assertAlmostEqual((off < 1e-3).float().mean().item(), 0.5, delta=0.1)
        # Renders are within 0 to 1, references within 0 to 2: none is more than half a render, or has fireflies.
        self.assertLess((c.expm1() - target.expm1()).abs().max().item(), 1.001)
        bare = (aux[:, 6] == 0).flatten(1).all(1) & (aux[:, :3] == 0).flatten(1).all(1)
        self.assertAlmostEqual(bare.float().mean().item(), 0.5, delta=0.1)

    def test_noisy_references_make_no_clean_crops(self):
        kept, (color, features, reference, *rest) = store(True)
        reference = color[:, 2].clone()
        reference[1:] *= 1.5
        kept.add(color, features, reference, *rest)
        kept.finish()
        torch.manual_seed(8)
        batches = Batches(kept, 200, Changes(**STILL | {"clean": 0.5}))
        _, _, references, _, _, _, clean, *_ = batches.pick()
        shown = torch.tensor([(kept.reference == one.half()).flatten(1).all(1).nonzero().item() for one in references])
        self.assertTrue((shown[clean] == 0).all())
        self.assertTrue((shown[~clean] > 0).any())
        self.assertAlmostEqual(clean.float().mean().item(), 0.5, delta=0.12)
        none = Batches(kept, 200, Changes(**STILL | {"clean": 1, "clean_below": 0}))
        self.assertFalse(none.pick()[6].any())

    def test_repair_and_features_are_those_of_single_frames(self):
        random = np.random.default_rng(6)
        color = random.random((9, 11, 3)).astype(np.float32) * 0.3
        color[2, 3], color[5, 5], color[5, 6], color[0, 0] = 900, 800, 700, 5000
        one = repair(torch.from_numpy(color.transpose(2, 0, 1))[None])[0]
        mended = preprocess.repair(color, KEY, "mend")[0]
        np.testing.assert_allclose(one.permute(1, 2, 0).numpy(), mended, rtol=1e-5)
        self.assertLess(mended.max(), 900)
        planes = random.normal(size=(7, 9, 11)).astype(np.float32)
        got = auxiliary(torch.from_numpy(planes)[None], torch.tensor([0.7]))[0]
        hwc = planes.transpose(1, 2, 0)
        expected = preprocess.auxiliary((9, 11), hwc[..., :3], hwc[..., 3:6], hwc[..., 6], 0.7)
        np.testing.assert_allclose(got.permute(1, 2, 0).numpy(), expected, rtol=1e-6)
