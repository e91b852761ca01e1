"""Other materials and lights for Mitsuba scenes: python -m vkdn.materials --scenes SCENES --out VARIED --seed N.

Scenes are few, and each has its floor: a network learns the floor. Each VARIED/<name>/scene.xml is the scene with a
random material in the place of most of its diffuse and plastic ones (a texture or a colour; glossy, varnished, rough
metal or a mirror) and with lights of other strength and tint. Meshes and textures stay where they are, so that the
folders can be given to whatever renders pairs of the scenes; every seed gives others.
"""
import argparse
import math
import random
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

REPLACED = ("diffuse", "plastic", "roughplastic")
KINDS = {"roughplastic": 0.45, "diffuse": 0.25, "mirror": 0.12, "plastic": 0.1, "roughconductor": 0.08}
# Of the materials that can be replaced.
SHARE = 0.7
TEXTURED = 0.7


class Varied:
    """One scene's variation. textures: image files to choose from."""

    def __init__(self, seed, textures):
        self.random, self.textures = random.Random(seed), textures

    def logarithmic(self, low, high):
        return math.exp(self.random.uniform(math.log(low), math.log(high)))

    def reflectance(self, parent, name):
        """A texture, once to eight times as often, or a colour."""
        if self.textures and self.random.random() < TEXTURED:
            texture = add(parent, "texture", type="bitmap", name=name)
            add(texture, "string", name="filename", value=str(self.random.choice(self.textures)))
            times = f"{self.logarithmic(1, 8):.3f}"
            add(add(texture, "transform", name="to_uv"), "scale", x=times, y=times)
            return
        value, colourful = self.random.uniform(0.03, 0.9), self.random.uniform(0, 0.6)
        colour = [value * (1 - colourful * self.random.random()) for _ in range(3)]
        add(parent, "rgb", name=name, value=",".join(f"{c:.3f}" for c in colour))

    def material(self, twosided):
        """Puts another material into a two-sided one."""
        for child in list(twosided):
            twosided.remove(child)
        kind = self.random.choices(list(KINDS), KINDS.values())[0]
        bsdf = add(twosided, "bsdf", type={"mirror": "conductor"}.get(kind, kind))
        if kind == "mirror":
            add(bsdf, "string", name="material", value="none")
            return
        if kind.startswith("rough"):
            add(bsdf, "float", name="alpha", value=f"{self.logarithmic(0.02, 0.35):.3f}")
            add(bsdf, "string", name="distribution", value="ggx")
        if kind.endswith("plastic"):
            add(bsdf, "float", name="int_ior", value=f"{self.random.uniform(1.3, 1.8):.2f}")
            add(bsdf, "boolean", name="nonlinear", value="true")
        names = {"diffuse": "reflectance", "roughconductor": "specular_reflectance"}
        self.reflectance(bsdf, names.get(kind, "diffuse_reflectance"))

    def scene(self, root, folder):
        """Changes a scene in place. folder: where its files are."""
        for twosided in root.iter("bsdf"):
            inner = [child for child in twosided if child.tag == "bsdf"]
            replaceable = twosided.get("type") == "twosided" and len(inner) == 1 and inner[0].get("type") in REPLACED
            if replaceable and self.random.random() < SHARE:
                self.material(twosided)
        for light in root.iter("rgb"):
            if light.get("name") == "radiance":
                light.set("value", self.light(light.get("value")))
        for file in root.iter("string"):
            if file.get("name") == "filename":
                file.set("value", str((folder / file.get("value")).resolve()))

    def light(self, value):
        """Of another strength, twice or half of it as a rule, and a little of another tint."""
        channels = [float(part) for part in re.split(r"[ ,]+", value.strip())]
        strength = math.exp(self.random.gauss(0, 0.7))
        tinted = [c * strength * math.exp(self.random.gauss(0, 0.15)) for c in (channels * 3)[:3]]
        return ",".join(f"{c:.4g}" for c in tinted)


def add(parent, tag, **attributes):
    return ElementTree.SubElement(parent, tag, attributes)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenes", required=True, type=Path, help="folder of <name>/scene.xml")
    p.add_argument("--out", required=True, type=Path)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--textures", type=Path, help="folder of images; default: the scenes' own")
    args = p.parse_args()
    folder = args.textures or args.scenes
    textures = sorted(path.resolve() for path in folder.rglob("*") if path.suffix in (".jpg", ".png"))
    scenes = sorted(args.scenes.glob("*/scene.xml"))
    if not scenes:
        p.error(f"--scenes {args.scenes}: there is no <name>/scene.xml in it")
    for path in scenes:
        tree = ElementTree.parse(path)
        Varied(f"{args.seed} {path.parent.name}", textures).scene(tree.getroot(), path.parent)
        folder = args.out / path.parent.name
        folder.mkdir(parents=True, exist_ok=True)
        tree.write(folder / "scene.xml")


if __name__ == "__main__":
    main()
