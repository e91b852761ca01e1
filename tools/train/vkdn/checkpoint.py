"""Checkpoints: everything needed to go on training, in one file, replaced whole."""
import os
from pathlib import Path

import torch

from . import arch as arch_module
from .model import Denoiser


def save(path, state):
    path = Path(path)
    beside = path.with_suffix(".part")
    torch.save(state, beside)
    os.replace(beside, path)


def load(path):
    return torch.load(path, map_location="cpu", weights_only=True)


def load_model(path):
    """(model with the averaged weights, the checkpoint's state)."""
    state = load(path)
    model = Denoiser(arch_module.from_dict(state["architecture"]))
    model.load_state_dict(state["average"])
    return model.eval(), state
