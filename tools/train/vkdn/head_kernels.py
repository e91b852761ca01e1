"""The Triton programs of averages.py. Planes are [N, channels, H, W], contiguous; a program takes a block of pixels.

R is half the side of a kernel, T its taps, row-major. A tap outside the image, or of a pixel whose reliability is not above 0, does not
count. Scores are logit + log of the reliability that is read.
"""
import triton
import triton.language as tl


@triton.jit(do_not_specialize=["P", "H", "W"])
def forward(logits, reliability, image, out, lse, P, H, W, R: tl.constexpr, T: tl.constexpr, B: tl.constexpr):
    """out [N, 3, H, W]: the means; lse [N, H, W]: log of the sum of all exp(score)."""
    p = tl.program_id(0) * B + tl.arange(0, B)
    area = H * W
    n = p // area
    at = p % area
    y = at // W
    x = at % W
    inside = p < P
    most = tl.full((B,), -1e30, tl.float32)
    total = tl.zeros((B,), tl.float32)
    red = tl.zeros((B,), tl.float32)
    green = tl.zeros((B,), tl.float32)
    blue = tl.zeros((B,), tl.float32)
    for t in tl.static_range(T):
        dy = t // (2 * R + 1) - R
        dx = t % (2 * R + 1) - R
        there = inside & (y + dy >= 0) & (y + dy < H) & (x + dx >= 0) & (x + dx < W)
        r = tl.load(reliability + n * area + at + dy * W + dx, mask=there, other=0.0)
        counts = there & (r > 0)
        score = tl.load(logits + (n * T + t) * area + at, mask=inside, other=0.0) + tl.log(tl.where(counts, r, 1.0))
        score = tl.where(counts, score, -1e30)
        higher = tl.maximum(most, score)
        shrink = tl.exp(most - higher)
        weight = tl.where(counts, tl.exp(score - higher), 0.0)
        from_ = image + n * 3 * area + at + dy * W + dx
        total = total * shrink + weight
        red = red * shrink + weight * tl.load(from_, mask=there, other=0.0)
        green = green * shrink + weight * tl.load(from_ + area, mask=there, other=0.0)
        blue = blue * shrink + weight * tl.load(from_ + 2 * area, mask=there, other=0.0)
        most = higher
    to = out + n * 3 * area + at
    tl.store(to, red / total, mask=inside)
    tl.store(to + area, green / total, mask=inside)
    tl.store(to + 2 * area, blue / total, mask=inside)
    tl.store(lse + p, most + tl.log(total), mask=inside)


@triton.jit(do_not_specialize=["P", "H", "W"])
def of_logits(logits, reliability, image, out, lse, grad, result, P, H, W, R: tl.constexpr, T: tl.constexpr, B: tl.constexpr):
    """result [N, T, H, W]: the gradient of the logits."""
    p = tl.program_id(0) * B + tl.arange(0, B)
    area = H * W
    n = p // area
    at = p % area
    y = at // W
    x = at % W
    inside = p < P
    here = n * 3 * area + at
    g0 = tl.load(grad + here, mask=inside, other=0.0)
    g1 = tl.load(grad + here + area, mask=inside, other=0.0)
    g2 = tl.load(grad + here + 2 * area, mask=inside, other=0.0)
    mean = g0 * tl.load(out + here, mask=inside, other=0.0)
    mean += g1 * tl.load(out + here + area, mask=inside, other=0.0)
    mean += g2 * tl.load(out + here + 2 * area, mask=inside, other=0.0)
    log_sum = tl.load(lse + p, mask=inside, other=0.0)
    for t in tl.static_range(T):
        dy = t // (2 * R + 1) - R
        dx = t % (2 * R + 1) - R
        there = inside & (y + dy >= 0) & (y + dy < H) & (x + dx >= 0) & (x + dx < W)
        r = tl.load(reliability + n * area + at + dy * W + dx, mask=there, other=0.0)
        counts = there & (r > 0)
        place = (n * T + t) * area + at
        score = tl.load(logits + place, mask=inside, other=0.0) + tl.log(tl.where(counts, r, 1.0))
        weight = tl.where(counts, tl.exp(score - log_sum), 0.0)
        from_ = image + here + dy * W + dx
        value = g0 * tl.load(from_, mask=there, other=0.0)
        value += g1 * tl.load(from_ + area, mask=there, other=0.0)
        value += g2 * tl.load(from_ + 2 * area, mask=there, other=0.0)
        tl.store(result + place, weight * (value - mean), mask=inside)


@triton.jit(do_not_specialize=["P", "H", "W"])
def of_pixels(
    logits, reliability, image, out, lse, grad, of_reliability, of_image, P, H, W, R: tl.constexpr, T: tl.constexpr, B: tl.constexpr
):
    """of_image [N, 3, H, W] and of_reliability [N, 1, H, W]: the gradients of what is read, gathered from all that read it."""
    p = tl.program_id(0) * B + tl.arange(0, B)
    area = H * W
    n = p // area
    at = p % area
    y = at // W
    x = at % W
    inside = p < P
    here = n * 3 * area + at
    r = tl.load(reliability + p, mask=inside, other=0.0)
    counts = inside & (r > 0)
    log_r = tl.log(tl.where(counts, r, 1.0))
    i0 = tl.load(image + here, mask=inside, other=0.0)
    i1 = tl.load(image + here + area, mask=inside, other=0.0)
    i2 = tl.load(image + here + 2 * area, mask=inside, other=0.0)
    of0 = tl.zeros((B,), tl.float32)
    of1 = tl.zeros((B,), tl.float32)
    of2 = tl.zeros((B,), tl.float32)
    of_r = tl.zeros((B,), tl.float32)
    for t in tl.static_range(T):
        # The pixel whose tap t reads this one.
        dy = R - t // (2 * R + 1)
        dx = R - t % (2 * R + 1)
        reads = counts & (y + dy >= 0) & (y + dy < H) & (x + dx >= 0) & (x + dx < W)
        step = dy * W + dx
        score = tl.load(logits + (n * T + t) * area + at + step, mask=reads, other=0.0) + log_r
        log_sum = tl.load(lse + p + step, mask=reads, other=0.0)
        weight = tl.where(reads, tl.exp(score - log_sum), 0.0)
        g0 = tl.load(grad + here + step, mask=reads, other=0.0)
        g1 = tl.load(grad + here + step + area, mask=reads, other=0.0)
        g2 = tl.load(grad + here + step + 2 * area, mask=reads, other=0.0)
        of0 += weight * g0
        of1 += weight * g1
        of2 += weight * g2
        change = g0 * (i0 - tl.load(out + here + step, mask=reads, other=0.0))
        change += g1 * (i1 - tl.load(out + here + step + area, mask=reads, other=0.0))
        change += g2 * (i2 - tl.load(out + here + step + 2 * area, mask=reads, other=0.0))
        of_r += weight * change
    tl.store(of_image + here, of0, mask=inside)
    tl.store(of_image + here + area, of1, mask=inside)
    tl.store(of_image + here + 2 * area, of2, mask=inside)
    tl.store(of_reliability + p, of_r / tl.where(counts, r, 1.0), mask=inside)
