"""Flat weights: pieces where they belong, and the steps of PyTorch's own AdamW and Muon."""
import unittest

import torch
from torch import nn

from vkdn.flat import Layout, Optimizer


class Small(nn.Module):
    def __init__(self):
        super().__init__()
        self.wide, self.tall, self.out_last = nn.Linear(12, 8), nn.Linear(8, 12), nn.Linear(12, 5)
        self.conv = nn.Conv2d(3, 4, 3)


def flattened(model, layout):
    flat = torch.zeros(layout.total)
    for piece, p in zip(layout.views(flat), layout.parameters):
        piece.copy_(p.detach())
    return flat


class FlatTest(unittest.TestCase):
    def test_views_hold_the_parameters(self):
        layout = Layout(model := Small())
        pieces = dict(zip(layout.names, layout.views(flattened(model, layout))))
        for name, p in model.named_parameters():
            self.assertTrue(torch.equal(pieces[name], p), name)
        self.assertEqual(layout.stacks, [[0, 2, 8, 12]])

    def test_steps_are_those_of_pytorch(self):
        torch.manual_seed(1)
        model = Small()
        layout = Layout(model)
        weights = flattened(model, layout)
        gradient = torch.zeros_like(weights)
        ours = Optimizer(layout, weights, gradient, torch.ones_like(weights), clip=1e9)
        ours.rate.fill_(1e-2)
        matrices = [model.wide.weight, model.tall.weight]
        decayed = [model.out_last.weight, model.conv.weight]
        rest = [p for name, p in model.named_parameters() if name.endswith("bias")]
        groups = [{"params": decayed, "weight_decay": 0.02}, {"params": rest, "weight_decay": 0.0}]
        theirs = [
            torch.optim.AdamW(groups, lr=1e-2, betas=(0.9, 0.99)),
            torch.optim.Muon(matrices, lr=1e-2, weight_decay=0.02, adjust_lr_fn="match_rms_adamw"),
        ]
        for _ in range(3):
            for piece, p in zip(layout.views(gradient), layout.parameters):
                p.grad = torch.randn_like(p)
                piece.copy_(p.grad)
            ours.step()
            for optimizer in theirs:
                optimizer.step()
        for name, piece, p in zip(layout.names, layout.views(weights), layout.parameters):
            # PyTorch's Muon iterates in bfloat16.
            tolerance = 3e-3 if name in ("wide.weight", "tall.weight") else 1e-6
            torch.testing.assert_close(piece, p.detach(), rtol=0, atol=tolerance, msg=name)

    def test_a_gradient_that_is_not_finite_moves_nothing_but_by_decay(self):
        layout = Layout(model := Small())
        weights = flattened(model, layout)
        before = weights.clone()
        gradient = torch.full_like(weights, torch.nan)
        optimizer = Optimizer(layout, weights, gradient, torch.ones_like(weights))
        optimizer.rate.fill_(1e-3)
        self.assertEqual(optimizer.step().item(), 0)
        torch.testing.assert_close(weights, before, rtol=1e-4, atol=0)
