"""The architecture value: everything that tells one network of the family from another.

`to_dict`/`from_dict` give the JSON form that stands in the metadata of a weights file (key "architecture"); the engine
parses the same JSON, so field names and order are a contract.
"""
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Block:
    """One kind of block. `ratio` belongs to sh_jsa, `conv` ("standard" or "separable") to film_cnn."""

    kind: str
    ratio: float | None = None
    conv: str | None = None

    def to_dict(self):
        d = {"kind": self.kind}
        if self.kind == "sh_jsa":
            d["ratio"] = self.ratio
        if self.kind == "film_cnn":
            d["conv"] = self.conv
        return d


@dataclass(frozen=True)
class Stage:
    """One resolution of the U-Net: encoder and decoder blocks. `heads` is used by jsa only."""

    encoder_blocks: int
    decoder_blocks: int
    heads: int
    block: Block

    def to_dict(self):
        return {
            "encoder_blocks": self.encoder_blocks,
            "decoder_blocks": self.decoder_blocks,
            "heads": self.heads,
            "block": self.block.to_dict(),
        }


@dataclass(frozen=True)
class Bottleneck:
    blocks: int
    heads: int
    block: Block

    def to_dict(self):
        return {"blocks": self.blocks, "heads": self.heads, "block": self.block.to_dict()}


@dataclass(frozen=True)
class Head:
    """How the output is made of what the U-Net found: by predicted kernels (head.py) over means of `levels` pixels a side,
    `gated` with the residual or alone; with `gloss` a part of the radiance is not divided by the albedo. Networks without one
    add a residual."""

    levels: tuple[int, ...]
    gated: bool
    kind: str = "kernels"
    gloss: bool = False

    def to_dict(self):
        fields = {"kind": self.kind, "levels": list(self.levels), "gated": self.gated}
        return fields | ({"gloss": True} if self.gloss else {})


@dataclass(frozen=True)
class Architecture:
    """`channels` is the width at stage 0 (stage i has channels * 2^i), `window` the side of an attention window in
    tokens, `patch` the side of a token in pixels (1 or 2), `decoder` "baseline" or "symmetric"."""

    name: str
    channels: int
    window: int
    patch: int
    decoder: str
    stages: tuple[Stage, ...]
    bottleneck: Bottleneck
    head: Head | None = None

    @property
    def multiple(self):
        """Width and height of the network's input are multiples of this many pixels."""
        return self.patch * self.window * 2 ** len(self.stages)

    def to_dict(self):
        fields = {
            "name": self.name,
            "channels": self.channels,
            "window": self.window,
            "patch": self.patch,
            "decoder": self.decoder,
            "stages": [s.to_dict() for s in self.stages],
            "bottleneck": self.bottleneck.to_dict(),
        }
        return fields | ({"head": self.head.to_dict()} if self.head else {})


def from_dict(d):
    """The inverse of `Architecture.to_dict`."""
    stages = tuple(Stage(**{**s, "block": Block(**s["block"])}) for s in d["stages"])
    neck = Bottleneck(**{**d["bottleneck"], "block": Block(**d["bottleneck"]["block"])})
    head = d.get("head") and Head(**{**d["head"], "levels": tuple(d["head"]["levels"])})
    return Architecture(**{**d, "stages": stages, "bottleneck": neck, "head": head})


JSA = Block("jsa")
FILM = Block("film_cnn", conv="standard")


def sh_jsa(ratio):
    return Block("sh_jsa", ratio=ratio)


def _build(name, blocks, neck, decoder="baseline", patch=1):
    """`blocks`: one block per stage. Depths are 1,2,4,8 | 2 | 8,4,2 and, at stage 0's decoder, 4 (baseline) or 1."""
    stages = []
    for i, block in enumerate(blocks):
        deep = 2**i
        decoder_blocks = 4 if i == 0 and decoder == "baseline" else deep
        stages.append(Stage(deep, decoder_blocks, deep, block))
    return Architecture(name, 32, 8, patch, decoder, tuple(stages), Bottleneck(2, 2 ** len(blocks), neck))


ARCHITECTURES = {
    a.name: a
    for a in [
        _build("jsa_baseline", [JSA] * 4, JSA),
        *[_build(f"shsa_{round(r * 100):03}", [sh_jsa(r)] * 4, sh_jsa(r)) for r in (1.0, 0.75, 0.5, 0.25)],
        _build("film_cnn", [FILM, FILM, JSA, JSA], JSA),
        _build("symmetric_decoder", [JSA] * 4, JSA, "symmetric"),
        _build("three_stage", [JSA] * 3, JSA, "symmetric"),
        _build("expanded_patch", [JSA] * 3, JSA, "symmetric", patch=2),
        _build("hybrid", [FILM, sh_jsa(0.25), sh_jsa(0.25)], sh_jsa(0.25), "symmetric", patch=2),
    ]
}

PURE = Head((1, 2, 4, 8, 16), gated=False)
GATED = Head((1, 2, 4), gated=True)
GLOSS = replace(PURE, gloss=True)
HEADS = {"residual": None, "pure": PURE, "gloss": GLOSS, "gated": GATED}


def with_head(arch, name):
    """The same U-Net with the head of that name in HEADS."""
    return replace(arch, head=HEADS[name])
