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

    def test_negative_samples_are_zero_and_their_pixels_stay(self):
        color = grey(0.5, 16, 16)
        color[4:12, 4:12] = -0.02, 0.05, 0.9
        seen, beyond, _ = preprocess.repair(color, 0.3)
        np.testing.assert_array_equal(seen[8, 8], np.float32([0, 0.05, 0.9]))
        self.assertFalse(beyond.any())
        color[5, 5, 0] = -1e-7
        self.assertAlmostEqual(preprocess.key_of(color), preprocess.key_of(np.maximum(color, 0)), places=7)

    def test_missing_samples_are_mended_by_channel(self):
        color = grey(1.0, 4, 4)
        color[1, 1], color[1, 2], color[0, 0, 0] = np.nan, 1e9, -np.inf
        color[0, 1] = 3
        fixed, *_ = preprocess.repair(color, 1.0)
        # Of the eight pixels around (1, 1) one is alone and absurdly bright, one has no red, one is 3.
        np.testing.assert_allclose(fixed[1, 1], [8 / 6, 9 / 7, 9 / 7], rtol=1e-6)
        np.testing.assert_array_equal(fixed[0, 0, 1:], 1)
        np.testing.assert_array_equal(fixed[3], 1)

    def test_holes_take_the_nearest_ring_and_far_from_all_a_tile(self):
        color = grey(0.0, 40, 40)
        color[...] = np.arange(40, dtype=np.float32)[None, :, None]
        color[8:32, 8:32] = np.nan
        fixed, *_ = preprocess.repair(color, 1e3)
        self.assertEqual(fixed[15, 8, 0], 7)
        self.assertEqual(fixed[20, 29, 0], 32)
        # The tile in the middle has only the ring of filled ones around, which have their neighbours' means.
        self.assertTrue(15 < fixed[20, 20, 1] < 24)
        np.testing.assert_array_equal(preprocess.repair(grey(np.nan), 1.0)[0], 0)

    def test_infinity_is_a_lamp_or_as_bright_as_what_is_around(self):
        color = grey(1.0, 24, 24)
        color[2, 3], color[3, 4, 1], color[20, 20:22] = np.inf, 4, 50
        color[10:13, 10:13] = np.inf
        fixed, _, given = preprocess.repair(color, 1.0, "mend")
        np.testing.assert_array_equal(np.argwhere(given.any(-1)).mean(0), [11, 11])
        np.testing.assert_array_equal(fixed[2, 3], 4)
        np.testing.assert_array_equal(fixed[10:13, 10:13], 50)
        np.testing.assert_array_equal(preprocess.repair(grey(np.inf), 1.0)[0], 0)

    def test_lone_fireflies_are_mended_or_kept_and_small_lights_are_neither(self):
        color = grey(1.0, 24, 24)
        color[1, 1] = 2e3
        color[1, 6:8] = 2e3
        color[5:7, 1:3] = 2e3
        color[5, 6:9] = 2e3
        color[9, 1] = 9e2
        color[20:22, 20:22] = 1e12
        # One bright pixel and a pair are fireflies, and so are a line's two ends.
        expected = color.copy()
        expected[1, 1] = expected[1, 6:8] = 1
        expected[5, 6] = expected[5, 8] = (7 + 2e3) / 8
        fixed, beyond, _ = preprocess.repair(color, 1.0, "mend")
        np.testing.assert_allclose(fixed, expected, rtol=1e-6)
        self.assertFalse(beyond.any())
        expected[9, 1] = 1
        for fireflies in "keep", "auto":
            fixed, beyond, _ = preprocess.repair(color, 1.0, fireflies)
            np.testing.assert_allclose(fixed, expected, rtol=1e-6)
            np.testing.assert_allclose(fixed + beyond, color, rtol=1e-6)

    def test_auto_mends_where_it_is_noisy(self):
        rng = np.random.default_rng(3)
        noisy = np.ones((64, 64, 3), np.float32)
        noisy[:, 32:] *= rng.exponential(size=(64, 32, 1))
        noisy[10, 10] = noisy[40, 50] = 2e4
        fixed, beyond, _ = preprocess.repair(noisy, 1.0)
        self.assertEqual(beyond[10, 10, 0], 2e4 - 1)
        self.assertEqual(beyond[40, 50, 0], 0)
        self.assertLess(fixed[40, 50, 0], 20)

    def test_what_exceeds_the_range_goes_around(self):
        color = grey(0.2, 32, 32)
        color[8:14, 8:14] = 1e9
        c, beyond, _ = preprocess.split(color, 0.9, 0.2)
        self.assertAlmostEqual(float(c.max()), np.log1p(2048), places=5)
        result = preprocess.finish(c, 0.9, preprocess.largest_of(color), beyond)
        np.testing.assert_allclose(result, color, rtol=1e-5)

    def test_a_result_is_at_most_the_largest_sample(self):
        color = grey(0.0, 16, 16)
        c, beyond, _ = preprocess.split(color, 0.01, 0.18)
        result = preprocess.finish(c + np.float32(0.005), 0.01, preprocess.largest_of(color), beyond)
        np.testing.assert_array_equal(result, 0)
        color[3, 3] = 1e30
        color[8:] = 1.0
        np.testing.assert_array_equal(preprocess.largest_of(color), 1)

    def test_noisy_albedo_is_filtered(self):
        random = np.random.default_rng(3).random((2, 20, 24, 3)).astype(np.float32)
        albedo, normal = random[0], 2 * random[1] - 1
        aux = preprocess.auxiliary((20, 24), albedo, normal, None, 1.0, clean_aux=False)
        self.assertLess(aux[..., :3].var(), 0.1 * albedo.var())
        np.testing.assert_array_equal(aux[..., 3:], preprocess.auxiliary((20, 24), albedo, normal, None, 1.0)[..., 3:])
        # Grain under smooth normals is texture, a rough surface of one colour has nothing to filter; edges and bars are neither.
        x, y = np.meshgrid(np.arange(24), np.arange(20))
        smooth = np.stack([x / 50, y / 40, np.full(x.shape, 0.5)], -1).astype(np.float32)
        bars = [(along % 7 < 2)[..., None] * np.ones(3, np.float32) for along in (x, y, x + y, x - y)]
        cases = [(albedo, smooth), (smooth, smooth), (np.full_like(albedo, 0.5), normal), *((bar, 2 * bar - 1) for bar in bars)]
        inside = slice(3, -3)  # the mirror breaks diagonals
        for a, n in cases:
            kept = preprocess.auxiliary((20, 24), a, n, None, 1.0, clean_aux=False)
            np.testing.assert_array_equal(kept[inside, inside, :3], a[inside, inside])

    def test_small_frames_are_mirrored(self):
        for shape in (1, 1), (1, 7), (2, 3):
            albedo, normal = np.random.default_rng(4).random((2, *shape, 3)).astype(np.float32)
            aux = preprocess.auxiliary(shape, albedo, normal, None, 1.0, clean_aux=False)
            self.assertTrue((aux[..., :3] <= albedo.max((0, 1))).all() and (aux[..., :3] >= albedo.min((0, 1))).all())

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
