"""Weights files: safetensors of float16 tensors under the model's parameter names, with string metadata.

Metadata keys: "format" (always vkdenoise-1), "architecture", "preprocessing" and "training", the last three JSON.
"""
import json

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from . import arch as arch_module
from . import preprocess
from .model import Denoiser

FORMAT = "vkdenoise-1"


def to_half(name, tensor, mantissa):
    """Rounded to nearest, ties to even, once, to a half with so many bits of mantissa."""
    values = tensor.detach().float()
    step = torch.exp2(torch.frexp(values)[1].clamp_min(-13).float() - 1 - mantissa)
    half = (torch.round(values / step) * step).to(torch.float16).contiguous()
    if not torch.isfinite(half).all():
        raise ValueError(f"{name} does not fit float16")
    return half


def write(path, model, training, mantissa=10):
    """`training`: a JSON-able record of where the weights come from. mantissa: bits kept of each weight."""
    tensors = {name: to_half(name, p, mantissa) for name, p in model.named_parameters()}
    metadata = {
        "format": FORMAT,
        "architecture": json.dumps(model.arch.to_dict()),
        "preprocessing": json.dumps(preprocess.METADATA),
        "training": json.dumps(training),
    }
    save_file(tensors, path, metadata)


def read(path):
    """(model with the rounded weights as float32, metadata with the JSON values parsed)."""
    with safe_open(path, "pt") as file:
        metadata = dict(file.metadata())
        if metadata.get("format") != FORMAT:
            raise ValueError(f"{path}: format {metadata.get('format')!r}, not {FORMAT!r}")
        for key in ("architecture", "preprocessing", "training"):
            metadata[key] = json.loads(metadata[key])
        found = {"version": 1, **metadata["preprocessing"]}
        if {**found, "version": preprocess.METADATA["version"]} != preprocess.METADATA or found["version"] not in preprocess.VERSIONS:
            raise ValueError(f"{path}: other pre-processing: {metadata['preprocessing']}")
        model = Denoiser(arch_module.from_dict(metadata["architecture"]))
        model.load_state_dict({name: file.get_tensor(name).float() for name in file.keys()})
    return model.eval(), metadata
