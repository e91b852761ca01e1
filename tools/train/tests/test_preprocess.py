"""Keys, bad pixels and missing features."""
import unittest

import numpy as np

from vkdn import preprocess


def grey(value, height=20, width=13):
    return np.full((height, width, 3), value, np.float32)


class PreprocessTest(unittest.TestCase):
    def test_flat_frame(self):
        self.assertAlmostEqual(preprocess.key_of(grey(0.5)), 0.5, places=6)

    def test_black_and_empty_frames(self):
        self.assertEqual(preprocess.key_of(grey(0.0)), 0.18)
        self.assertEqual(preprocess.key_of(grey(np.nan)), 0.18)

    def test_key_scales_and_ignores_bad_pixels(self):
        color = np.random.default_rng(1).random((37, 50, 3)).astype(np.float32)
        key = preprocess.key_of(color)
        self.assertAlmostEqual(preprocess.key_of(color * 1024) / key / 1024, 1, places=6)
        color[3, 4], color[5, 5], color[9, 9] = np.nan, -1, np.inf
        self.assertAlmostEqual(preprocess.key_of(color), key, delta=0.02 * key)

    def test_a_firefly_hardly_moves_the_key(self):
        color = grey(1.0, 64, 64)
        color[7, 7] = 1e6
        # One tile of 64 has the mean (63 + 64) / 64.
        self.assertAlmostEqual(preprocess.key_of(color), 2 ** (np.log2(127 / 64) / 64), places=6)

    def test_black_tiles_do_not_count(self):
        color = grey(0.0, 16, 16)
        color[:8, :8] = 2
        self.assertAlmostEqual(preprocess.key_of(color), 2, places=6)

    def test_repair(self):
        color = grey(1.0, 4, 4)
        color[1, 1], color[1, 2], color[0, 0] = np.nan, 1e9, -1
        color[0, 1] = 3
        fixed = preprocess.repair(color, 1.0)
        # Of the nine pixels around (1, 1) three are bad, one is 3, five are 1.
        np.testing.assert_allclose(fixed[1, 1], 8 / 6, rtol=1e-6)
        np.testing.assert_array_equal(fixed[3], 1)
        np.testing.assert_array_equal(preprocess.repair(grey(np.inf), 1.0), 0)

    def test_isolated_fireflies_are_bad_and_small_lights_are_not(self):
        color = grey(1.0, 12, 12)
        color[1, 1] = 2e3
        color[1, 6:8] = 2e3
        color[5:7, 1:3] = 2e3
        color[5, 6:9] = 2e3
        color[9, 1] = 9e2
        fixed = preprocess.repair(color, 1.0)
        expected = color.copy()
        # One bright pixel and a pair are fireflies, and so are a line's two ends.
        expected[1, 1] = expected[1, 6:8] = 1
        expected[5, 6] = expected[5, 8] = (7 + 2e3) / 8
        np.testing.assert_allclose(fixed, expected, rtol=1e-6)

    def test_auxiliary(self):
        shape = (2, 2)
        missing = preprocess.auxiliary(shape, None, None, None, 1.0)
        np.testing.assert_array_equal(missing[0, 0], [0, 0, 0, 0.5, 0.5, 0.5, 0])
        albedo, normal = np.full((2, 2, 3), 2.0), np.full((2, 2, 3), -1.0)
        albedo[0, 0, 0], normal[0, 0, 1] = np.nan, np.inf
        depth = np.array([[4.0, 0.0], [np.inf, 2e9]])
        aux = preprocess.auxiliary(shape, albedo, normal, depth, 8.0)
        np.testing.assert_array_equal(aux[0, 0], [0, 1, 1, 0, 0.5, 0, 0.5])
        np.testing.assert_array_equal(aux[1], [[1, 1, 1, 0, 0, 0, 0]] * 2)

    def test_depth_scale(self):
        depth = np.arange(1, 2002, dtype=np.float32)[None]
        self.assertEqual(preprocess.depth_scale_of(depth), 1999)
        self.assertEqual(preprocess.depth_scale_of(np.zeros((3, 3))), 1)

    def test_round_trip(self):
        color = np.random.default_rng(2).random((9, 9, 3)).astype(np.float32) * 100
        stats = preprocess.statistics(color, None)
        c = preprocess.log_color(color, stats.exposure, stats.key)
        np.testing.assert_allclose(preprocess.finish(c, stats.exposure), color, rtol=1e-5)
