"""The U-Net of the whole family. Parameter names are the tensor names of a weights file."""
import torch
import torch.nn.functional as F
from torch import nn

from .blocks import conv_nhwc, make_block

SLOPE = 0.01


def conv3x3(cin, cout, bias=True, stride=1):
    return nn.Conv2d(cin, cout, 3, padding=1, bias=bias, stride=stride)


class AuxStep(nn.Module):
    """conv1x1, depthwise conv3x3, LeakyReLU. [N, C, H, W]"""

    def __init__(self, cin, cout):
        super().__init__()
        self.pointwise = nn.Conv2d(cin, cout, 1)
        self.depthwise = nn.Conv2d(cout, cout, 3, padding=1, groups=cout)

    def forward(self, x):
        return F.leaky_relu(self.depthwise(self.pointwise(x)), SLOPE)


class AuxProjection(nn.ModuleDict):
    """Three steps, each feeding the next, their results concatenated and mixed. [N, 7, H, W] -> [N, C, H, W]"""

    def __init__(self, channels):
        steps = {str(i): AuxStep(7 if i == 0 else channels, channels) for i in range(3)}
        super().__init__({**steps, "out": nn.Conv2d(3 * channels, channels, 1)})

    def forward(self, aux):
        results = []
        for i in range(3):
            results.append(self[str(i)](results[-1] if results else aux))
        return F.leaky_relu(self["out"](torch.cat(results, 1)), SLOPE)


def down(conv, x):
    """[N, H, W, C] -> [N, H/2, W/2, 2C]: conv C->C/2, then channel c*4 + 2*dy + dx."""
    return F.pixel_unshuffle(conv(x.permute(0, 3, 1, 2)), 2).permute(0, 2, 3, 1).contiguous()


def up(conv, x):
    """[N, H, W, 2C] -> [N, 2H, 2W, C]: conv 2C->4C, then the inverse of `down`'s shuffle."""
    return F.pixel_shuffle(conv(x.permute(0, 3, 1, 2)), 2).permute(0, 2, 3, 1).contiguous()


class Denoiser(nn.Module):
    """log1p colour c [N, 3, H, W], aux [N, 7, H, W] -> residual r [N, 3, H, W] in the log domain.

    H and W are multiples of `arch.multiple`; real = (height, width) of the unpadded frame in pixels.
    """

    def __init__(self, arch):
        super().__init__()
        self.arch = arch
        stages, c0, window = arch.stages, arch.channels, arch.window
        width = [c0 * 2**i for i in range(len(stages))]
        self.color_proj = conv3x3(3, c0)
        self.aux_proj = AuxProjection(c0)
        if arch.patch == 2:
            self.patch_embed_x = conv3x3(c0, c0, stride=2)
            self.patch_embed_f = conv3x3(c0, c0, stride=2)
        self.enc = nn.ModuleList(
            nn.ModuleList(make_block(s.block, c, window, s.heads) for _ in range(s.encoder_blocks))
            for s, c in zip(stages, width)
        )
        self.down = nn.ModuleList(conv3x3(c, c // 2, bias=False) for c in width)
        neck = arch.bottleneck
        self.bottleneck = nn.ModuleList(
            make_block(neck.block, 2 * width[-1], window, neck.heads) for _ in range(neck.blocks)
        )
        self.up = nn.ModuleList(conv3x3(2 * c, 4 * c, bias=False) for c in width)
        self.skip = nn.ModuleDict(
            {str(i): nn.Linear(2 * c, c) for i, c in enumerate(width) if not self.wide_decoder(i)}
        )
        self.dec = nn.ModuleList()
        for i, (s, c) in enumerate(zip(stages, width)):
            c, heads = (2 * c, 1) if self.wide_decoder(i) else (c, s.heads)
            self.dec.append(nn.ModuleList(make_block(s.block, c, window, heads) for _ in range(s.decoder_blocks)))
        last = 2 * c0 if self.wide_decoder(0) else c0
        if arch.patch == 2:
            self.patch_unembed = conv3x3(last, 4 * last, bias=False)
        self.output = conv3x3(last, 3)
        self.reset_parameters()

    def wide_decoder(self, stage):
        """Whether this stage's decoder keeps [up, skip] side by side instead of mixing them down to C."""
        return stage == 0 and self.arch.decoder == "baseline"

    def reset_parameters(self):
        """Linear weights truncated normal 0.02, biases 0; convolutions keep PyTorch's default.

        The joint score is a product of two logits, both near 0 at the start, which leaves it nearly no gradient. So the
        bias tables start as a decay with distance: attention begins local and its two factors begin non-zero.
        """
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.trunc_normal_(module.weight, std=0.02, a=-0.04, b=0.04)
                nn.init.zeros_(module.bias)
        side = 2 * self.arch.window - 1
        y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
        distance = torch.hypot((y - side // 2).float(), (x - side // 2).float()).flatten()
        for name, table in self.named_parameters():
            if name.endswith("bias_table"):
                noise = nn.init.trunc_normal_(torch.empty_like(table), std=0.02, a=-0.04, b=0.04)
                with torch.no_grad():
                    table.copy_(2.0 - 0.2 * distance[:, None] + noise)

    def project(self, color, aux):
        """X0 and F0 at token resolution, [N, H/patch, W/patch, C]."""
        x = F.leaky_relu(self.color_proj(color), SLOPE)
        f = self.aux_proj(aux)
        if self.arch.patch == 2:
            x, f = self.patch_embed_x(x), self.patch_embed_f(f)
        return x.permute(0, 2, 3, 1).contiguous(), f.permute(0, 2, 3, 1).contiguous()

    def decode(self, x, f, skip, real, i):
        """Stage i of the decoder; f the features of all levels, skip those of this stage's encoder."""
        x, aux = torch.cat([up(self.up[i], x), skip], -1), f[i]
        if self.wide_decoder(i):
            aux = torch.cat([up(self.up[i], f[i + 1]), aux], -1)
        else:
            x = self.skip[str(i)](x)
        for block in self.dec[i]:
            x = block(x, aux, real)
        return x

    def forward(self, color, aux, real=None):
        height, width = real or color.shape[2:]
        stage_count = len(self.arch.stages)
        strides = [self.arch.patch * 2**i for i in range(stage_count + 1)]
        tokens = [(-(-height // s), -(-width // s)) for s in strides]
        memory = torch.channels_last
        x, f0 = self.project(color.contiguous(memory_format=memory), aux.contiguous(memory_format=memory))
        f, skips = [f0], []
        for i in range(stage_count):
            for block in self.enc[i]:
                x = block(x, f[i], tokens[i])
            skips.append(x)
            x = down(self.down[i], x)
            f.append(down(self.down[i], f[i]))
        for block in self.bottleneck:
            x = block(x, f[-1], tokens[-1])
        for i in reversed(range(stage_count)):
            x = self.decode(x, f, skips[i], tokens[i], i)
        if self.arch.patch == 2:
            x = up(self.patch_unembed, x)
        return conv_nhwc(self.output, x).permute(0, 3, 1, 2)


def mirror_index(size, multiple):
    """Source index of each row of the padded axis: reflection without repeating the edge, again and again."""
    padded = -(-size // multiple) * multiple
    period = max(2 * (size - 1), 1)
    i = torch.arange(padded) % period
    return torch.where(i < size, i, period - i)


def pad(x, multiple):
    """[N, C, H, W] padded right and bottom to the multiple."""
    rows, columns = (mirror_index(size, multiple).to(x.device) for size in x.shape[2:])
    return x[:, :, rows][:, :, :, columns]


def predict(model, color, aux):
    """The residual for inputs of any size: pad, run, crop. [N, 3, H, W], [N, 7, H, W] -> [N, 3, H, W]"""
    height, width = color.shape[2:]
    multiple = model.arch.multiple
    residual = model(pad(color, multiple), pad(aux, multiple), (height, width))
    return residual[:, :, :height, :width]
