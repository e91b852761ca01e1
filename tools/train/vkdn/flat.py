"""All weights of a network, their moments and averages as flat float32 vectors, and one step of Muon and AdamW on them.

A step of some hundred tensors is thus a handful of operations, reads its rate from the device and waits for nothing, as a CUDA
graph asks.
"""
import math

import torch

MOMENTUM, BETA1 = 0.95, 0.9


def laid_out(flat, p, tall):
    """A piece of a flat vector with p's shape: kernels of convolutions channels-last, `tall` matrices transposed."""
    if p.dim() == 4:
        o, i, h, w = p.shape
        return flat.view(o, h, w, i).permute(0, 3, 1, 2)
    return flat.view(p.shape[1], p.shape[0]).t() if tall else flat.view(p.shape)


class Layout:
    """Where each parameter lies: Muon's matrices by shape, then what else AdamW decays, then the rest.

    Matrices that make outputs (named out_*) are AdamW's: their rows are of one kind each, not to be made orthogonal.
    """

    def __init__(self, model):
        named = list(model.named_parameters())
        of_muon = lambda n, p: p.dim() == 2 and n.endswith(".weight") and "out_" not in n
        decayed = lambda n, p: n.endswith(".weight") and p.dim() > 1
        wide = lambda p: tuple(sorted(p.shape))
        matrices = sorted((x for x in named if of_muon(*x)), key=lambda x: wide(x[1]))
        others = [x for x in named if not of_muon(*x)]
        named = matrices + [x for x in others if decayed(*x)] + [x for x in others if not decayed(*x)]
        self.names = [name for name, _ in named]
        self.parameters = [p for _, p in named]
        self.sizes = [p.numel() for p in self.parameters]
        self.tall = [i < len(matrices) and p.shape[0] > p.shape[1] for i, p in enumerate(self.parameters)]
        self.total = sum(self.sizes)
        self.muon_end = sum(self.sizes[: len(matrices)])
        self.decay_end = self.total - sum(p.numel() for n, p in others if not decayed(n, p))
        self.stacks = []  # [first element, matrices, rows, columns], rows <= columns
        at = 0
        for _, p in matrices:
            if self.stacks and self.stacks[-1][2:] == list(wide(p)):
                self.stacks[-1][1] += 1
            else:
                self.stacks.append([at, 1, *wide(p)])
            at += p.numel()

    def views(self, flat):
        """The flat vector's pieces, by parameter."""
        pieces = flat.split(self.sizes)
        return [laid_out(piece, p, tall) for piece, p, tall in zip(pieces, self.parameters, self.tall)]

    def vector(self, values):
        """A flat vector with the same number for all elements of a parameter; values(name)."""
        parts = [torch.full((size,), float(values(name))) for name, size in zip(self.names, self.sizes)]
        return torch.cat(parts)


def orthogonal(stack, steps=5):
    """The nearest orthogonal matrices, about, of [k, rows <= columns]: Newton-Schulz iteration (Jordan et al., "Muon", 2024)."""
    x = stack.to(torch.bfloat16 if stack.is_cuda else torch.float32)
    x = x / x.float().norm(dim=(1, 2), keepdim=True).clamp_min(1e-7).to(x.dtype)
    for _ in range(steps):
        square = x @ x.transpose(1, 2)
        polynomial = torch.baddbmm(square, square, square, beta=-4.7750, alpha=2.0315)
        x = torch.baddbmm(x, polynomial, x, beta=3.4445)
    return x.float()


class Optimizer:
    """weights, gradient: flat vectors. rate: a tensor of one number that the caller fills; gains: a flat vector of factors to it."""

    def __init__(self, layout, weights, gradient, gains, beta2=0.99, clip=1.0, decay=0.02):
        self.layout, self.weights, self.gradient = layout, weights, gradient
        self.beta2, self.clip = beta2, clip
        self.momentum, self.squares = torch.zeros_like(weights), torch.zeros_like(weights[layout.muon_end :])
        self.gains = gains.to(weights.device)
        decayed = torch.zeros_like(weights)
        decayed[: layout.decay_end] = decay
        self.decayed = decayed
        self.rate, self.count = (torch.zeros((), device=weights.device) for _ in range(2))

    def state(self):
        return [self.momentum, self.squares, self.count]

    @torch.no_grad()
    def step(self):
        """Clips the gradient and applies it; a gradient that is not finite counts as zero. -> its norm"""
        end = self.layout.muon_end
        norm = self.gradient.norm()
        finite = torch.isfinite(norm)
        clipped = self.gradient * (self.clip / (norm + 1e-6)).clamp(max=1)
        gradient = torch.where(finite, clipped, torch.zeros_like(clipped))
        self.count.add_(1)
        self.weights.mul_(1 - self.rate * self.decayed)
        if end:
            momentum = self.momentum[:end].lerp_(gradient[:end], 1 - MOMENTUM)
            update = torch.lerp(gradient[:end], momentum, MOMENTUM)
            for first, count, rows, columns in self.layout.stacks:
                piece = slice(first, first + count * rows * columns)
                turned = orthogonal(update[piece].view(count, rows, columns)).reshape(-1)
                # The size of AdamW's steps, so that one rate serves both.
                self.weights[piece].sub_(turned * self.gains[piece] * (self.rate * 0.2 * math.sqrt(columns)))
        rest = gradient[end:]
        mean = self.momentum[end:].lerp_(rest, 1 - BETA1)
        self.squares.mul_(self.beta2).addcmul_(rest, rest, value=1 - self.beta2)
        unbiased = lambda beta: 1 - torch.exp(self.count * math.log(beta))
        update = (mean / unbiased(BETA1)) / ((self.squares / unbiased(self.beta2)).sqrt() + 1e-8)
        self.weights[end:].sub_(update * self.gains[end:] * self.rate)
        return torch.where(finite, norm, torch.zeros_like(norm))
