"""The head of predicted kernels: how to average what is there, in place of what to add to it.

Every output pixel is a mean of input pixels: 5x5 kernels over the radiance at full size and over its means over 2x2, 4x4, ...
pixels, mixed by predicted shares. The radiance is divided by the albedo before and multiplied by a smoothed albedo after.
A tap counts by what the pixel predicts for that offset times the reliability of the pixel that is read, so that a firefly can leave
every neighbour's kernel by one number. Nothing outside the (padded) frame is read.

A reflection does not show the texture of what reflects it: with `gloss` the same kernels average the radiance as it is too, and a
predicted share of every pixel is of that.

Parameter names, under "head.": tok, x0, f0, guess make HIDDEN numbers a pixel; out_full makes of them 25 logits, 1 reliability,
3 shares, 1 gate (with `gloss`: the logit of the share that is divided), 9 logits of a 3x3 kernel over the albedo, in this order, out_more the shares beyond three; per level (see LEVELS)
two Linears make the 25 logits of its kernel.
"""
import torch
import torch.nn.functional as F
from torch import nn

from . import averages

SLOPE = 0.01
HIDDEN = 32
TAPS = 5
LOWEST_RELIABILITY = -40.0
LEAST_ALBEDO = 0.05
# Side in pixels of a level's means: its Linears. Its tokens are the U-Net's of that side.
LEVELS = {2: ("mid", "out_mid"), 4: ("low", "out_low"), 8: ("deep", "out_deep"), 16: ("neck", "out_neck")}
FEWEST, MOST = (1, 2, 4), (1, 2, 4, 8, 16)


def bell(side, sigma):
    """Logits of a Gaussian kernel, [side*side]."""
    i = torch.arange(side, dtype=torch.float32) - side // 2
    return (-(i[:, None] ** 2 + i[None] ** 2) / (2 * sigma**2)).flatten()


def spread(x):
    """[N, h, w, 4k] -> [N, 2h, 2w, k]; channel (2*dy + dx)*k + c of a token goes to its pixel (dy, dx)."""
    n, h, w, c = x.shape
    return x.view(n, h, w, 2, 2, c // 4).permute(0, 1, 3, 2, 4, 5).reshape(n, 2 * h, 2 * w, c // 4)


def planes(x):
    """[N, H, W, C] of any type -> [N, C, H, W], at least float32, contiguous."""
    return x.permute(0, 3, 1, 2).to(torch.promote_types(x.dtype, torch.float32)).contiguous()


class WeightedSum(torch.autograd.Function):
    """weights [N, side*side, H, W], image [N, C, H, W] -> sum over taps, zeros outside. One pass a tap, so that nothing of
    side*side*C planes is ever held."""

    @staticmethod
    def forward(ctx, weights, image):
        ctx.save_for_backward(weights, image)
        out = torch.zeros_like(image)
        for tap, part in enumerate(shifted(image, weights.shape[1])):
            out.addcmul_(weights[:, tap : tap + 1], part)
        return out

    @staticmethod
    def backward(ctx, grad):
        weights, image = ctx.saved_tensors
        height, width = image.shape[2:]
        side = round(weights.shape[1] ** 0.5)
        margin = side // 2
        of_weights = torch.empty_like(weights)
        of_image = F.pad(torch.zeros_like(image), (margin,) * 4) if ctx.needs_input_grad[1] else None
        for tap, part in enumerate(shifted(image, side * side)):
            torch.sum(grad * part, 1, out=of_weights[:, tap])
            if of_image is not None:
                y, x = divmod(tap, side)
                of_image[:, :, y : y + height, x : x + width].addcmul_(weights[:, tap : tap + 1], grad)
        if of_image is not None:
            of_image = of_image[:, :, margin : margin + height, margin : margin + width]
        return of_weights, of_image


def shifted(image, taps):
    """The image as each of side*side taps reads it, zeros outside."""
    height, width = image.shape[2:]
    side = round(taps**0.5)
    padded = F.pad(image, (side // 2,) * 4)
    for tap in range(taps):
        y, x = divmod(tap, side)
        yield padded[:, :, y : y + height, x : x + width]


def average(logits, reliability, image):
    """As `average_by_taps`; `averages.use` puts a GPU's own kernel in its place, which works on three channels."""
    if averages.in_use() and image.is_cuda and image.dtype == torch.float32:
        return torch.cat([averages.average(logits, reliability, three) for three in image.split(3, 1)], 1)
    return average_by_taps(logits, reliability, image)


def average_by_taps(logits, reliability, image):
    """[N, T, H, W], [N, 1, H, W], [N, C, H, W]: every pixel's mean over T taps, by exp(logit) times the reliability (above 0) of the
    tap; taps outside the image do not count."""
    counted = torch.cat(list(shifted(reliability, logits.shape[1])), 1)
    scores = (logits + counted.clamp_min(1e-30).log()).masked_fill(counted <= 0, -torch.inf)
    return WeightedSum.apply(scores.softmax(1), image)


def demodulator(albedo):
    """[N, 3, H, W] -> what radiance is divided by: the albedo, at least LEAST_ALBEDO; 1 where it is 0 (lamps, background,
    frames without albedo), and a blend between."""
    has = (albedo.amax(1, keepdim=True) / LEAST_ALBEDO).clamp(0, 1)
    return has * albedo.clamp_min(LEAST_ALBEDO) + (1 - has)


class KernelHead(nn.Module):
    """levels: sides of the means in pixels, (1, 2, 4) or (1, 2, 4, 8, 16); gated: whether the network's residual is mixed in;
    gloss: whether a part of the radiance is not divided by the albedo.

    channels: the U-Net's at stage 0. Tokens of 2x2 pixels only.
    """

    def __init__(self, channels, levels, gated, gloss=False):
        super().__init__()
        if gated and gloss:
            raise ValueError("a head is gated or has gloss: one number a pixel is for either")
        if tuple(levels) not in (FEWEST, MOST):
            raise ValueError(f"levels {levels}: only {FEWEST} and {MOST} are known")
        self.levels, self.gated, self.gloss = tuple(levels), gated, gloss
        self.tok = nn.Linear(channels, 4 * HIDDEN)
        self.x0, self.f0 = nn.Linear(channels, HIDDEN), nn.Linear(channels, HIDDEN)
        self.guess = nn.Linear(6, HIDDEN)
        self.out_full = nn.Linear(HIDDEN, 39)
        if len(levels) > 3:
            self.out_more = nn.Linear(HIDDEN, len(levels) - 3)
        for i, side in enumerate(levels[1:]):
            inner, out = LEVELS[side]
            setattr(self, inner, nn.Linear(channels * 2**i, HIDDEN))
            setattr(self, out, nn.Linear(HIDDEN, 25))
        self.reset_outputs()

    @torch.no_grad()
    def reset_outputs(self):
        """Kernels start as bells of about a pixel, mostly from the full size, pixels as reliable, the gate nearly shut."""
        outs = [module for name, module in self.named_children() if name.startswith("out_")]
        for out in outs:
            nn.init.normal_(out.weight, std=0.02)
            out.bias.copy_(bell(5, 1.0)) if out.out_features == 25 else nn.init.zeros_(out.bias)
        full = self.out_full.bias
        full[:25] = bell(5, 0.8)
        full[25] = -3.0
        full[26:29] = torch.tensor([1.5, 0.0, -1.5])
        full[29] = 3.0 if self.gloss else -3.0
        full[30:] = bell(3, 0.5)
        if len(self.levels) > 3:
            self.out_more.bias.fill_(-4.0)

    def hidden(self, x0, f0, tokens, log_color, direct):
        """What every pixel predicts from, [N, H, W, HIDDEN]."""
        guess = torch.cat([log_color, direct], 1).permute(0, 2, 3, 1).to(x0.dtype)
        return F.leaky_relu(spread(self.tok(tokens)) + self.x0(x0) + self.f0(f0) + self.guess(guess), SLOPE)

    def kernel(self, side, tokens):
        """Logits of a level's kernels, [N, 25, H/side, W/side]."""
        inner, out = (getattr(self, name) for name in LEVELS[side])
        return planes(out(F.leaky_relu(inner(tokens), SLOPE)))

    def forward(self, x0, f0, tokens, log_color, direct, albedo):
        """-> log1p of the denoised exposed radiance [N, 3, H, W].

        x0, f0 [N, H, W, C]: the projections at full size; tokens: for every level after the first the U-Net's of its side,
        finest first (decoder stage 0, 1, ..., or the bottleneck), [N, H/side, W/side, C * 2^i]; log_color, direct [N, 3, H, W]:
        log1p of the exposed radiance, and that plus the network's residual; albedo [N, 3, H, W] in [0, 1].
        """
        h = self.hidden(x0, f0, tokens[0], log_color, direct)
        full = planes(self.out_full(h))
        shares = full[:, 26:29]
        if len(self.levels) > 3:
            shares = torch.cat([shares, planes(self.out_more(h))], 1)
        shares = shares.softmax(1)
        reliability = (-F.softplus(full[:, 25:26])).clamp_min(LOWEST_RELIABILITY).exp()
        a = demodulator(albedo)
        radiance = torch.expm1(log_color)
        image = torch.cat([radiance / a, radiance], 1) if self.gloss else radiance / a
        mixed = shares[:, :1] * average(full[:, :25], reliability, image)
        for i, side in enumerate(self.levels[1:]):
            weight = F.avg_pool2d(reliability, side)
            coarse = F.avg_pool2d(reliability * image, side) / weight
            filtered = average(self.kernel(side, tokens[i]), weight, coarse)
            filtered = F.interpolate(filtered, scale_factor=side, mode="bilinear", align_corners=False)
            mixed = mixed + shares[:, i + 1 : i + 2] * filtered
        divided = mixed[:, :3] * average(full[:, 30:], torch.ones_like(reliability), a)
        if self.gloss:
            divided = torch.lerp(mixed[:, 3:], divided, full[:, 29:30].sigmoid())
        averaged = torch.log1p(divided.clamp_min(0))
        return torch.lerp(direct, averaged, full[:, 29:30].sigmoid()) if self.gated else averaged
