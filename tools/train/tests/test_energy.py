import unittest

import numpy as np

from vkdn import energy


class Energy(unittest.TestCase):
    def test_what_is_missing_of_noise_is_given_back(self):
        rng = np.random.default_rng(1)
        given = rng.exponential(size=(200, 150, 3))
        # A tenth too dark; what is left out of a lone pixel is no bias.
        result = np.full_like(given, 0.9)
        found = energy.given_back(given, result, np.full(3, 50.0))
        self.assertAlmostEqual(found.mean(), given.mean(), delta=0.01)
        given[:], given[20, 30] = 0.9, 500
        np.testing.assert_array_equal(energy.given_back(given, result, np.full(3, 1e9)), result)

    def test_flat_black_and_the_largest_stay(self):
        flat = np.full((70, 90, 3), 0.7)
        np.testing.assert_array_equal(energy.given_back(flat, flat, np.full(3, 0.7)), flat)
        np.testing.assert_array_equal(energy.given_back(flat * 0, flat * 0, np.zeros(3)), flat * 0)
        # A dark result beside a lamp: the lamp takes nothing.
        given = flat.copy()
        given[:, :40] = 20
        result = np.where(given == 20, 20, 0.69)
        found = energy.given_back(given, result, np.full(3, 20.0))
        np.testing.assert_array_equal(found[:, :40], 20)
        self.assertGreater(found[:, 64:].min(), 0.69)

    def test_gains_have_a_bound_and_are_continuous(self):
        given = np.ones((128, 128, 3))
        given[:64] = 9
        found = energy.given_back(given, np.full((128, 128, 3), 0.5), np.full(3, 1e9))
        self.assertAlmostEqual(found.max(), 0.5 * 1.125, places=6)
        self.assertLess(np.abs(np.diff(found[:, 0, 0])).max(), 0.002)


if __name__ == "__main__":
    unittest.main()
