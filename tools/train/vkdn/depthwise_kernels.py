"""The Triton programs of depthwise.py. Maps are [pixels, C]; a program takes a block of pixels and a block of channels."""
import triton
import triton.language as tl


@triton.jit(do_not_specialize=["P", "H", "W"])
def convolve(x, taps, bias, out, P, H, W, C, BIAS: tl.constexpr, BP: tl.constexpr, BC: tl.constexpr):
    """out = bias + sum over the nine taps [9, C] of tap * x of the neighbour, zeros outside each image of H x W pixels."""
    p = tl.program_id(0) * BP + tl.arange(0, BP)
    c = tl.program_id(1) * BC + tl.arange(0, BC)
    column = p % W
    row = (p // W) % H
    total = tl.zeros((BP, BC), tl.float32)
    if BIAS:
        total += tl.load(bias + c)[None, :].to(tl.float32)
    for t in tl.static_range(9):
        dy = t // 3 - 1
        dx = t % 3 - 1
        inside = (p < P) & (row + dy >= 0) & (row + dy < H) & (column + dx >= 0) & (column + dx < W)
        v = tl.load(x + (p + dy * W + dx)[:, None] * C + c[None, :], mask=inside[:, None], other=0.0).to(tl.float32)
        total += v * tl.load(taps + t * C + c)[None, :].to(tl.float32)
    tl.store(out + p[:, None] * C + c[None, :], total.to(out.dtype.element_ty), mask=(p < P)[:, None])


@triton.jit(do_not_specialize=["P", "H", "W", "ROUNDS"])
def sums(x, grad, out, P, H, W, C, ROUNDS, BP: tl.constexpr, BC: tl.constexpr):
    """out[part, 10, C]: sums over a part's pixels of grad times the neighbour at each of the nine taps, then of grad alone."""
    c = tl.program_id(1) * BC + tl.arange(0, BC)
    a0 = tl.zeros((BP, BC), tl.float32)
    a1 = tl.zeros((BP, BC), tl.float32)
    a2 = tl.zeros((BP, BC), tl.float32)
    a3 = tl.zeros((BP, BC), tl.float32)
    a4 = tl.zeros((BP, BC), tl.float32)
    a5 = tl.zeros((BP, BC), tl.float32)
    a6 = tl.zeros((BP, BC), tl.float32)
    a7 = tl.zeros((BP, BC), tl.float32)
    a8 = tl.zeros((BP, BC), tl.float32)
    a9 = tl.zeros((BP, BC), tl.float32)
    first = tl.program_id(0) * ROUNDS * BP
    for i in range(0, ROUNDS):
        p = first + i * BP + tl.arange(0, BP)
        column = p % W
        row = (p // W) % H
        inside = p < P
        here = tl.load(grad + p[:, None] * C + c[None, :], mask=inside[:, None], other=0.0).to(tl.float32)
        a9 += here
        base = x + p[:, None] * C + c[None, :]
        up = inside & (row > 0)
        down = inside & (row < H - 1)
        left = column > 0
        right = column < W - 1
        a0 += here * tl.load(base - (W + 1) * C, mask=(up & left)[:, None], other=0.0).to(tl.float32)
        a1 += here * tl.load(base - W * C, mask=up[:, None], other=0.0).to(tl.float32)
        a2 += here * tl.load(base - (W - 1) * C, mask=(up & right)[:, None], other=0.0).to(tl.float32)
        a3 += here * tl.load(base - C, mask=(inside & left)[:, None], other=0.0).to(tl.float32)
        a4 += here * tl.load(base, mask=inside[:, None], other=0.0).to(tl.float32)
        a5 += here * tl.load(base + C, mask=(inside & right)[:, None], other=0.0).to(tl.float32)
        a6 += here * tl.load(base + (W - 1) * C, mask=(down & left)[:, None], other=0.0).to(tl.float32)
        a7 += here * tl.load(base + W * C, mask=down[:, None], other=0.0).to(tl.float32)
        a8 += here * tl.load(base + (W + 1) * C, mask=(down & right)[:, None], other=0.0).to(tl.float32)
    to = out + tl.program_id(0) * 10 * C + c
    tl.store(to, tl.sum(a0, 0))
    tl.store(to + C, tl.sum(a1, 0))
    tl.store(to + 2 * C, tl.sum(a2, 0))
    tl.store(to + 3 * C, tl.sum(a3, 0))
    tl.store(to + 4 * C, tl.sum(a4, 0))
    tl.store(to + 5 * C, tl.sum(a5, 0))
    tl.store(to + 6 * C, tl.sum(a6, 0))
    tl.store(to + 7 * C, tl.sum(a7, 0))
    tl.store(to + 8 * C, tl.sum(a8, 0))
    tl.store(to + 9 * C, tl.sum(a9, 0))
