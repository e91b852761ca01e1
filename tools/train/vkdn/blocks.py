"""The three kinds of U-Net block. Feature maps are [N, H, W, C] (channels last) throughout.

Every block is called as block(x, f, real) -> x: x the colour features, f the auxiliary features of the same shape,
real = (rows, columns) of tokens that carry pixels of the unpadded frame.
"""
import math

import torch
import torch.nn.functional as F
from torch import nn

from . import depthwise


def conv_nhwc(conv, x):
    """A Conv2d on a channels-last map; the permuted view has PyTorch's channels_last strides, so nothing is copied."""
    return conv(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)


def pointwise_nhwc(conv, x):
    """A 1x1 Conv2d on a channels-last map; input channels are filled up to whole octets, which matrix units want."""
    weight = conv.weight.flatten(1)
    more = -weight.shape[1] % 8
    if more:
        weight, x = F.pad(weight, (0, more)), F.pad(x, (0, more))
    return F.linear(x, weight, conv.bias)


def depthwise_nhwc(conv, x):
    """A depthwise 3x3 Conv2d on a channels-last map. `depthwise.use` puts a GPU's own kernel in its place."""
    return depthwise.run(conv, x) if depthwise.in_use() and x.is_cuda else conv_nhwc(conv, x)


class Ffn(nn.Module):
    """Linear C->4C, depthwise conv3x3 (crosses window borders), ReLU, Linear 4C->C."""

    def __init__(self, channels):
        super().__init__()
        wide = 4 * channels
        self.expand = nn.Linear(channels, wide)
        self.depthwise = nn.Conv2d(wide, wide, 3, padding=1, groups=wide)
        self.contract = nn.Linear(wide, channels)

    def forward(self, x):
        return self.contract(F.relu(depthwise_nhwc(self.depthwise, self.expand(x))))


def to_windows(x, window):
    """[N, H, W, C] -> [N * windows, window*window, C]; windows and tokens row-major."""
    n, h, w, c = x.shape
    x = x.view(n, h // window, window, w // window, window, c)
    return x.transpose(2, 3).reshape(-1, window * window, c)


def from_windows(x, window, n, h, w):
    """[N * windows, heads, window*window, d] -> [N, H, W, heads*d]; head-major channels."""
    heads, d = x.shape[1], x.shape[3]
    x = x.transpose(1, 2).reshape(n, h // window, w // window, window, window, heads * d)
    return x.transpose(2, 3).reshape(n, h, w, heads * d)


def relative_index(window):
    """[T, T] (query, key): entry (dy + window-1) * (2*window-1) + dx + window-1, (dy, dx) = query minus key position."""
    y, x = torch.meshgrid(torch.arange(window), torch.arange(window), indexing="ij")
    y, x = y.flatten(), x.flatten()
    dy, dx = y[:, None] - y[None, :], x[:, None] - x[None, :]
    return (dy + window - 1) * (2 * window - 1) + dx + window - 1


class JointAttention(nn.Module):
    """Joint window attention and FFN: A = softmax((Q K^T s + B) * (Qf Kf^T s + B)), s = 1/sqrt(head width).

    `part` of the channels (the first ones) attend: all of them in jsa, ratio * channels in sh_jsa, whose queries and keys
    are half as wide as its values. The remaining channels go raw into the output projection.
    """

    def __init__(self, channels, window, heads, part, key_width):
        super().__init__()
        self.window, self.heads, self.part = window, heads, part
        self.scale = 1 / math.sqrt(key_width // heads)
        self.norm1 = nn.LayerNorm(part)
        self.norm1_f = nn.LayerNorm(part)
        self.q = nn.Linear(part, key_width)
        self.k = nn.Linear(part, key_width)
        self.v = nn.Linear(part, part)
        self.qf = nn.Linear(part, key_width)
        self.kf = nn.Linear(part, key_width)
        self.bias_table = nn.Parameter(torch.zeros((2 * window - 1) ** 2, heads))
        self.proj = nn.Linear(channels, channels)
        self.norm2 = nn.LayerNorm(channels)
        self.ffn = Ffn(channels)
        self.register_buffer("index", relative_index(window), persistent=False)

    def logits(self, q, k, bias):
        """Scaled scores plus bias, in at least 32 bits whatever the training precision: their product cancels badly."""
        wide = torch.promote_types(q.dtype, torch.float32)
        with torch.autocast(q.device.type, enabled=False):
            return (q.to(wide) * self.scale) @ k.to(wide).transpose(-2, -1) + bias.to(wide)

    def in_windows(self, x, *linears):
        """Several Linears of the same map as one, [N, H, W, part] -> for each [N * windows, heads, T, its width / heads]."""
        weight = torch.cat([linear.weight for linear in linears])
        y = to_windows(F.linear(x, weight, torch.cat([linear.bias for linear in linears])), self.window)
        parts = y.split([linear.out_features for linear in linears], -1)
        return [part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts]

    def joint_scores(self, x, f):
        """[N * windows, heads, T, T]: what the softmax sees, and the values [N * windows, heads, T, d]."""
        q, k, v = self.in_windows(self.norm1(x[..., : self.part]), self.q, self.k, self.v)
        qf, kf = self.in_windows(self.norm1_f(f[..., : self.part]), self.qf, self.kf)
        tokens = len(self.index)
        bias = self.bias_table.index_select(0, self.index.view(-1)).view(tokens, tokens, self.heads).permute(2, 0, 1)
        return self.logits(q, k, bias) * self.logits(qf, kf, bias), v

    def attend(self, x, f):
        """[N, H, W, C] twice -> [N, H, W, part]: the attended values, before the output projection."""
        scores, v = self.joint_scores(x, f)
        return from_windows(scores.softmax(-1).to(v.dtype) @ v, self.window, *x.shape[:3])

    def forward(self, x, f, real):
        mixed = self.attend(x, f)
        if self.part < x.shape[-1]:
            mixed = torch.cat([mixed, x[..., self.part :]], -1)
        x = x + self.proj(mixed)
        return x + self.ffn(self.norm2(x))


class FilmCnn(nn.Module):
    """X' = X + gamma * conv(LN1(X)) + beta, [gamma | beta] = Linear(mean over the real tokens of LN1f(F)); then the FFN.

    `mean_jitter` > 0 mixes, while training, each sample's mean with the one before it in the batch by a random weight up to
    that much: the mean of a crop is not the mean of the frame it stands for.
    """

    def __init__(self, channels, conv):
        super().__init__()
        self.mean_jitter = 0.0
        self.norm1 = nn.LayerNorm(channels)
        self.norm1_f = nn.LayerNorm(channels)
        if conv == "separable":
            self.conv = nn.Sequential()
            self.conv.add_module("depthwise", nn.Conv2d(channels, channels, 3, padding=1, groups=channels))
            self.conv.add_module("pointwise", nn.Conv2d(channels, channels, 1))
        else:
            self.conv = nn.Conv2d(channels, channels, 3, padding=1)
        self.film = nn.Linear(channels, 2 * channels)
        self.norm2 = nn.LayerNorm(channels)
        self.ffn = Ffn(channels)

    def modulation(self, f, real):
        """gamma and beta, [N, 1, 1, C] each."""
        v = self.norm1_f(f[:, : real[0], : real[1]]).mean((1, 2))
        if self.training and self.mean_jitter > 0 and len(v) > 1:
            weight = torch.rand(len(v), 1, device=v.device) * self.mean_jitter
            v = torch.lerp(v, v.detach().roll(1, 0), weight.to(v.dtype))
        return self.film(v)[:, None, None].chunk(2, -1)

    def forward(self, x, f, real):
        gamma, beta = self.modulation(f, real)
        x = x + gamma * conv_nhwc(self.conv, self.norm1(x)) + beta
        return x + self.ffn(self.norm2(x))


def make_block(block, channels, window, heads):
    if block.kind == "jsa":
        return JointAttention(channels, window, heads, channels, channels)
    if block.kind == "sh_jsa":
        part = int(channels * block.ratio)
        return JointAttention(channels, window, 1, part, part // 2)
    if block.kind == "film_cnn":
        return FilmCnn(channels, block.conv)
    raise ValueError(f"unknown block kind {block.kind!r}")
