"""Checkpoints: everything needed to go on training, in one file, replaced whole."""
import os
from pathlib import Path

import torch

from . import arch as arch_module
from . import carried, weights
from .model import Denoiser


def save(path, state):
    path = Path(path)
    beside = path.with_suffix(".part")
    torch.save(state, beside)
    os.replace(beside, path)


def load(path):
    return torch.load(path, map_location="cpu", weights_only=True)


def load_model(path):
    """(model with a checkpoint's averaged weights, or those of a weights file or of carried ones; the record of its
    training)."""
    suffix = Path(path).suffix
    if suffix == ".safetensors":
        model, metadata = weights.read(path)
        return model, metadata["training"]
    if suffix == ".zip":
        return carried.read(path), {}
    state = load(path)
    model = Denoiser(arch_module.from_dict(state["architecture"]))
    model.load_state_dict(state["average"])
    return model.eval(), state["record"]
