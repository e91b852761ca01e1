"""A step: what it minimises, shares of a batch, going on from a saved state."""
import unittest

import torch

from tests import small
from vkdn.fit import Fit, Options
from vkdn.locality import disturbed, far_moves
from vkdn.losses import energy
from vkdn.schedule import Schedule

EXACT = dict(batch=2, precision=torch.float32, film_jitter=0.0)


class LossTest(unittest.TestCase):
    def test_energy_is_least_where_blocks_are_right_on_average(self):
        torch.manual_seed(1)
        # What one noisy input may stand for: blocks that are black or bright, 1 on average.
        targets = torch.log1p(torch.tensor([0.5, 1.5]).repeat(500)[:, None, None, None].expand(-1, 3, 64, 64))

        def slope(level):
            o = torch.full((1, 3, 64, 64), level, requires_grad=True)
            loss = energy(o.log1p().expand(len(targets), -1, -1, -1), targets, delta=10.0).mean()
            return torch.autograd.grad(loss, o)[0].sum().item()

        self.assertLess(slope(0.97), 0)
        self.assertGreater(slope(1.03), 0)

    def test_energy_counts_whole_blocks_alone(self):
        flat = torch.full((1, 3, 64, 64), 0.5)
        checkered = flat + 0.4 * (-1.0) ** (torch.arange(64)[:, None] + torch.arange(64))
        self.assertLess(energy(checkered.log1p(), flat.log1p()).item(), 1e-10)
        self.assertAlmostEqual(energy((1.1 * flat).log1p(), flat.log1p()).item(), (0.05 / 0.56) ** 2, places=5)

    def test_far_moves_are_those_of_one_pixel(self):
        torch.manual_seed(2)
        color = torch.rand(1, 3, 128, 128)
        other, far = disturbed(color)
        moved = (other != color).any(1)[0].nonzero()
        self.assertEqual(len(moved), 1)
        y, x = moved[0]
        self.assertTrue(min(y, x, 127 - y, 127 - x) <= 40)
        self.assertFalse(far[(y - 64).clamp(0) : y + 65, (x - 64).clamp(0) : x + 65].any())
        self.assertTrue(far.any())
        near = lambda c, aux: c + 0 * aux[:, :3]
        self.assertEqual(far_moves(near, color, torch.zeros(1, 7, 128, 128)).item(), 0)
        mean = lambda c, aux: c + c.mean((2, 3), keepdim=True)
        self.assertGreater(far_moves(mean, color, torch.zeros(1, 7, 128, 128)).item(), 0)


class FitTest(unittest.TestCase):
    def test_shares_make_the_gradient_of_the_batch(self):
        store, found = small.store(), []
        # oneDNN rounds differently by the size of a batch, on some processors by 2 % of a gradient.
        with torch.backends.mkldnn.flags(enabled=False):
            for share in (None, 1):
                torch.manual_seed(3)
                fit = Fit(small.network(), store, Options(**EXACT, parallel=2, share=share))
                found.append(fit.gradients_of_batch())
        (loss, error, gradients), (loss1, error1, gradients1) = found
        whole = sum(one.norm().item() ** 2 for one in gradients if one is not None) ** 0.5
        torch.testing.assert_close((loss, error), (loss1, error1))
        for name, one, other in zip(fit.layout.names, gradients, gradients1):
            self.assertEqual(one is None, other is None, name)
            if one is not None:
                self.assertLess((one - other).norm().item(), 1e-2 * max(one.norm().item(), 1e-3 * whole), name)

    def test_terms_of_the_loss_have_their_weights(self):
        store, losses = small.store(), {}
        for name, options in {
            "plain": dict(energy=0.0, clean_weight=1.0),
            "energy": dict(energy=2.0, clean_weight=1.0),
            "clean": dict(energy=0.0, clean_weight=10.0),
            "locality": dict(energy=0.0, clean_weight=1.0, locality=1.0),
        }.items():
            torch.manual_seed(4)
            fit = Fit(small.network("residual"), store, Options(**EXACT, knee=float("inf"), **options))
            fit.inputs[3][:] = torch.tensor([1.0, 0.0])
            losses[name] = fit.gradients_of_batch()[0].item()
        for name in ("energy", "clean", "locality"):
            self.assertGreater(losses[name], 1.001 * losses["plain"], name)

    def test_a_saved_state_goes_on_alike(self):
        store = small.store()
        options = Options(batch=2, precision=torch.float32)
        fit = Fit(small.network(), store, options)
        reports = []

        def run(fit, seed, steps):
            torch.manual_seed(seed)
            fit.inputs = fit.batches.batch()
            fit.run(Schedule(1e-3, warm_up=1, steps=steps), 1e9, reports.append)

        run(fit, 5, 3)
        self.assertEqual(reports[-1]["step"], 3)
        state, average = fit.state(), fit.averaged_model().state_dict()
        run(fit, 6, 4)
        other = Fit(small.network(), store, options)
        other.restore(state, average)
        run(other, 6, 4)
        self.assertEqual(other.steps, 4)
        torch.testing.assert_close(other.weights, fit.weights)
        torch.testing.assert_close(other.averaged, fit.averaged)
        self.assertFalse(torch.equal(fit.averaged, fit.weights))
        with self.assertRaises(ValueError):
            Fit(small.network("residual"), store, options).restore(state, average)


class ScheduleTest(unittest.TestCase):
    def test_rate_rises_and_falls(self):
        schedule = Schedule(1e-3, warm_up=4, floor=0.0, steps=10)
        self.assertAlmostEqual(schedule.rate(0), 0.25e-3)
        self.assertAlmostEqual(schedule.rate(5), 0.5e-3)
        self.assertEqual(schedule.rate(10), 0)

    def test_time_spent_before_counts(self):
        self.assertAlmostEqual(Schedule(1, 1, hours=1, before=1800).progress(0), 0.5, places=3)
        self.assertEqual(Schedule(1, 1, hours=1, before=3600).progress(0), 1)
        self.assertEqual(Schedule(1, 1, deadline=1.0).progress(0), 1)
