"""The U-Net of the whole family. Parameter names are the tensor names of a weights file."""
import torch
import torch.nn.functional as F
from torch import nn

from .blocks import conv_nhwc, depthwise_nhwc, make_block, pointwise_nhwc
from .head import KernelHead, planes

SLOPE = 0.01


def conv3x3(cin, cout, bias=True, stride=1):
    return nn.Conv2d(cin, cout, 3, padding=1, bias=bias, stride=stride)


class AuxStep(nn.Module):
    """conv1x1, depthwise conv3x3, LeakyReLU. [N, H, W, C]"""

    def __init__(self, cin, cout):
        super().__init__()
        self.pointwise = nn.Conv2d(cin, cout, 1)
        self.depthwise = nn.Conv2d(cout, cout, 3, padding=1, groups=cout)

    def forward(self, x):
        return F.leaky_relu(depthwise_nhwc(self.depthwise, pointwise_nhwc(self.pointwise, x)), SLOPE)


class AuxProjection(nn.ModuleDict):
    """Three steps, each feeding the next, their results concatenated and mixed. [N, H, W, 7] -> [N, H, W, C]"""

    def __init__(self, channels):
        steps = {str(i): AuxStep(7 if i == 0 else channels, channels) for i in range(3)}
        super().__init__({**steps, "out": nn.Conv2d(3 * channels, channels, 1)})

    def forward(self, aux):
        results = []
        for i in range(3):
            results.append(self[str(i)](results[-1] if results else aux))
        return F.leaky_relu(pointwise_nhwc(self["out"], torch.cat(results, -1)), SLOPE)


def down(conv, x):
    """[N, H, W, C] -> [N, H/2, W/2, 2C]: conv C->C/2, then channel c*4 + 2*dy + dx."""
    y = conv_nhwc(conv, x).contiguous()
    n, h, w, c = y.shape
    return y.view(n, h // 2, 2, w // 2, 2, c).permute(0, 1, 3, 5, 2, 4).reshape(n, h // 2, w // 2, 4 * c)


def up(conv, x):
    """[N, H, W, 2C] -> [N, 2H, 2W, C]: conv 2C->4C, then the inverse of `down`'s shuffle."""
    y = conv_nhwc(conv, x).contiguous()
    n, h, w, c = y.shape
    return y.view(n, h, w, c // 4, 2, 2).permute(0, 1, 4, 2, 5, 3).reshape(n, 2 * h, 2 * w, c // 4)


class Denoiser(nn.Module):
    """log1p colour c [N, 3, H, W], aux [N, 7, H, W] -> log1p of the denoised colour [N, 3, H, W]: c + r, r the network's
    residual, or what `arch.head` makes.

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
        if arch.head:
            if arch.patch != 2 or len(stages) != 3:
                raise ValueError("a head of predicted kernels needs three stages of 2x2 patches")
            self.head = KernelHead(last, arch.head.levels, arch.head.gated, arch.head.gloss)

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
        """X0 and F0 at full size, and at token resolution, [N, H, W, C] and [N, H/patch, W/patch, C]."""
        to_nhwc = lambda t: t.permute(0, 2, 3, 1).to(self.output.weight.dtype).contiguous()
        x0 = F.leaky_relu(conv_nhwc(self.color_proj, to_nhwc(color)), SLOPE).contiguous()
        f0 = self.aux_proj(to_nhwc(aux)).contiguous()
        if self.arch.patch == 1:
            return x0, f0, x0, f0
        return x0, f0, conv_nhwc(self.patch_embed_x, x0).contiguous(), conv_nhwc(self.patch_embed_f, f0).contiguous()

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
        x0, f0, x, f_first = self.project(color, aux)
        f, skips = [f_first], []
        for i in range(stage_count):
            for block in self.enc[i]:
                x = block(x, f[i], tokens[i])
            skips.append(x)
            x = down(self.down[i], x)
            f.append(down(self.down[i], f[i]))
        for block in self.bottleneck:
            x = block(x, f[-1], tokens[-1])
        decoded = [x]
        for i in reversed(range(stage_count)):
            x = self.decode(x, f, skips[i], tokens[i], i)
            decoded.insert(0, x)
        if self.arch.patch == 2:
            x = up(self.patch_unembed, x)
        direct = color + planes(conv_nhwc(self.output, x))
        if self.arch.head is None:
            return direct
        return self.head(x0, f0, decoded, color, direct, aux[:, :3])


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
    """The log1p of the denoised colour for inputs of any size: pad, run, crop. [N, 3, H, W], [N, 7, H, W] -> [N, 3, H, W]"""
    height, width = color.shape[2:]
    multiple = model.arch.multiple
    output = model(pad(color, multiple), pad(aux, multiple), (height, width))
    return output[:, :, :height, :width]
