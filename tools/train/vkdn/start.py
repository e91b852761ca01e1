"""A starting point that already smooths, for short training runs.

The network predicts a residual, so most of what it must first learn is to carry the noisy colour through to the end and
subtract it. Here a few channels start as exact copies of the colour on the way in, past the stage-0 skip and out again; the
output starts as `STRENGTH` times (blurred colour - colour). The blocks on the way start with small branches. All other
parameters keep their usual start, and everything can still change.
"""
import torch

from .blocks import FilmCnn

STRENGTH = 0.8
TENT = torch.tensor([0.25, 0.5, 0.25])
BLUR = torch.outer(TENT, TENT)


def copy_channel(conv, target, source, y=1, x=1):
    """Output channel `target` becomes input channel `source` at tap (y, x)."""
    conv.weight[target] = 0
    conv.weight[target, source, y, x] = 1
    if conv.bias is not None:
        conv.bias[target] = 0


@torch.no_grad()
def start_as_blur(model):
    """Needs 2x2 patches and a decoder of C channels at stage 0: the Hybrid and +Expanded Patch."""
    if not (hasattr(model, "patch_embed_x") and "0" in model.skip):
        raise ValueError(f"the blur start needs 2x2 patches and a symmetric decoder, which {model.arch.name} does not have")
    channels, skip = model.arch.channels, model.skip["0"]
    for color in range(3):
        copy_channel(model.color_proj, color, color)
        model.output.weight[color] *= 0.1
        model.output.weight[color, color] = 0
        model.output.weight[color, color, 1, 1] = -STRENGTH
        model.output.weight[color, 3 + color] = STRENGTH * BLUR
        for phase in range(4):
            dy, dx = divmod(phase, 2)
            token = color * 4 + phase
            copy_channel(model.patch_embed_x, token, color, 1 + dy, 1 + dx)
            skip.weight[token] = 0
            skip.weight[token, channels + token] = 1
            copy_channel(model.patch_unembed, token, token)
            blurred = (3 + color) * 4 + phase
            model.patch_unembed.weight[blurred] = 0
            model.patch_unembed.weight[blurred, color * 4 : color * 4 + 4] = BLUR / 4
    model.output.bias.zero_()
    for block in [*model.enc[0], *model.dec[0]]:
        branch = block.film if isinstance(block, FilmCnn) else block.proj
        for last in [branch, block.ffn.contract]:
            last.weight *= 0.1
