"""PSNR, SSIM and detail on 8-bit display images, relMSE on linear radiance. Images are [H, W, 3] numpy arrays."""
import numpy as np

GAMMA = 2.2


def display(color):
    """Linear radiance -> trunc(255 * clip(color^(1/2.2), 0, 1)), as float64 whole numbers."""
    return np.trunc(255 * np.clip(np.maximum(color, 0).astype(np.float64) ** (1 / GAMMA), 0, 1))


def psnr(image, reference):
    error = ((display(image) - display(reference)) ** 2).mean()
    return float(10 * np.log10(255**2 / error)) if error > 0 else float("inf")


def gaussian_window(size=11, sigma=1.5):
    x = np.arange(size) - size // 2
    g = np.exp(-(x**2) / (2 * sigma**2))
    return g / g.sum()


def blur_valid(image):
    """Separable 11x11 Gaussian of a [H, W, 3] image, only where the window fits."""
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(image, 11, axis)
        image = windows @ gaussian_window()
    return image


def ssim(image, reference):
    """Mean over pixels and channels; NaN for images smaller than the 11x11 window."""
    a, b = display(image), display(reference)
    if min(a.shape[:2]) < 11:
        return float("nan")
    mean_a, mean_b = blur_valid(a), blur_valid(b)
    var_a, var_b = blur_valid(a * a) - mean_a**2, blur_valid(b * b) - mean_b**2
    cov = blur_valid(a * b) - mean_a * mean_b
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    score = (2 * mean_a * mean_b + c1) * (2 * cov + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return float(score.mean())


def relmse(image, reference):
    a, b = image.astype(np.float64), reference.astype(np.float64)
    return float(((a - b) ** 2 / (b**2 + 0.01)).mean())


def detail(image, reference):
    """Correlation of what the 11x11 Gaussian takes from both: 1 where fine texture and edges are the reference's, less where
    they are wiped out, or invented. NaN for images smaller than the window, or without detail."""
    a, b = display(image), display(reference)
    if min(a.shape[:2]) < 11:
        return float("nan")
    a, b = (x[5:-5, 5:-5] - blur_valid(x) for x in (a, b))
    scale = np.sqrt((a**2).sum() * (b**2).sum())
    return float((a * b).sum() / scale) if scale > 0 else float("nan")


METRICS = {"psnr": psnr, "ssim": ssim, "relmse": relmse, "detail": detail}
