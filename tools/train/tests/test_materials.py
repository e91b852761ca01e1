"""Other materials for scenes."""
import unittest
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from vkdn.materials import Varied

SCENE = """<scene version="3.0.0">
  <bsdf type="twosided" id="floor"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
    <string name="filename" value="textures/wood.png"/></texture></bsdf></bsdf>
  <bsdf type="twosided" id="lamp"><bsdf type="roughconductor"><float name="alpha" value="0.1"/></bsdf></bsdf>
  <bsdf type="dielectric" id="glass"/>
  <shape type="ply"><string name="filename" value="models/floor.ply"/><ref id="floor"/></shape>
  <emitter type="area"><rgb name="radiance" value="1, 2, 4"/></emitter>
  <emitter type="constant"><rgb name="radiance" value="3"/></emitter>
</scene>"""


def varied(seed, textures=()):
    root = ElementTree.fromstring(SCENE)
    Varied(seed, list(textures)).scene(root, Path("/scenes/room"))
    return root


class MaterialsTest(unittest.TestCase):
    def test_some_materials_are_others_and_the_rest_stays(self):
        kinds = set()
        for seed in range(200):
            root = varied(seed, [Path("/textures/tiles.png")])
            floor, lamp, glass = root.findall("bsdf")
            self.assertEqual([floor.get("id"), lamp.get("id"), glass.get("type")], ["floor", "lamp", "dielectric"])
            self.assertEqual(lamp[0].get("type"), "roughconductor")
            self.assertEqual(len(floor), 1)
            kinds.add(floor[0].get("type"))
            files = [s.get("value") for s in root.iter("string") if s.get("name") == "filename"]
            self.assertIn("/scenes/room/models/floor.ply", files)
            self.assertTrue(all(file.startswith("/") for file in files))
            self.assertEqual(root.find("shape/ref").get("id"), "floor")
        self.assertEqual(kinds, {"diffuse", "plastic", "roughplastic", "roughconductor", "conductor"})

    def test_lights_are_of_other_strength_and_a_little_of_another_tint(self):
        strengths = []
        for seed in range(200):
            lights = [rgb.get("value").split(",") for rgb in varied(seed).findall("emitter/rgb")]
            first, second = [[float(channel) for channel in light] for light in lights]
            strengths += [first[1] / 2, second[1] / 3]
            self.assertLess(max(second) / min(second), 3)
        self.assertLess(min(strengths), 0.5)
        self.assertGreater(max(strengths), 2)

    def test_a_seed_is_a_scene(self):
        text = lambda root: ElementTree.tostring(root)
        self.assertEqual(text(varied("1 room")), text(varied("1 room")))
        self.assertNotEqual(text(varied("1 room")), text(varied("2 room")))
