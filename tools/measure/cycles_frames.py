"""Renders test frames with Blender's Cycles, in the layout of the rendered pairs; for measuring, never for training.

    python3 -m venv blender && blender/bin/pip install 'bpy==4.5.*' OpenEXR==3.3.5     # Python 3.11
    blender/bin/python tools/measure/cycles_frames.py OUT

OUT/<scene>/v0 gets sppNNNN.exr (independent noise; albedo, normal and depth as Cycles renders them for denoisers, noisy
where glass and depth of field make them so) and ref.exr. What is there is not rendered again.
"""
import argparse
import math
import tempfile
from pathlib import Path

import bpy
import numpy as np
import OpenEXR

SAMPLES = (1, 4, 16)
PASSES = {
    "R": "Combined.R", "G": "Combined.G", "B": "Combined.B",
    "albedo.R": "Denoising Albedo.R", "albedo.G": "Denoising Albedo.G", "albedo.B": "Denoising Albedo.B",
    "N.X": "Denoising Normal.X", "N.Y": "Denoising Normal.Y", "N.Z": "Denoising Normal.Z",
    "Z": "Denoising Depth.Z",
}


def material(name, color=(0.8, 0.8, 0.8), **inputs):
    """A Principled BSDF; `inputs` by the names of its sockets, spaces as underscores."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    for socket, value in inputs.items():
        shader.inputs[socket.replace("_", " ")].default_value = value
    return made


def textured(name, texture, scale, dark, light, **settings):
    """A material whose colour is a procedural texture between two colours."""
    made = material(name, Roughness=0.6)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    place, ramp = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeValToRGB")
    node = nodes.new(texture)
    node.inputs["Scale"].default_value = scale
    for setting, value in settings.items():
        node.inputs[setting.replace("_", " ")].default_value = value
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (*dark, 1), (*light, 1)
    links.new(place.outputs["Object"], node.inputs["Vector"])
    links.new(node.outputs["Fac"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    return made


def give(chosen):
    """Gives the object that was made last a material."""
    bpy.context.object.data.materials.append(chosen)


def camera(at, to, focal_length, f_stop=None):
    bpy.ops.object.camera_add(location=at)
    made = bpy.context.object
    offset = np.subtract(to, at)
    made.rotation_euler = (
        math.atan2(math.hypot(offset[0], offset[1]), -offset[2]), 0, math.atan2(-offset[0], offset[1]))
    made.data.lens = focal_length
    if f_stop:
        made.data.dof.use_dof, made.data.dof.focus_distance = True, float(np.linalg.norm(offset))
        made.data.dof.aperture_fstop = f_stop
    bpy.context.scene.camera = made


def sky(strength, color):
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (*color, 1), strength
    bpy.context.scene.world = world


def floor():
    """A finely grained floor in daylight: texture that a denoiser may wipe out, glass and metal, a shallow focus."""
    sky(0.6, (0.6, 0.75, 1.0))
    bpy.ops.object.light_add(type="SUN", rotation=(0.7, 0.3, 0.4))
    bpy.context.object.data.energy, bpy.context.object.data.angle = 3.0, 0.05
    bpy.ops.mesh.primitive_plane_add(size=20)
    give(textured("grain", "ShaderNodeTexNoise", 14, (0.12, 0.05, 0.02), (0.55, 0.32, 0.16), Detail=10.0, Roughness=0.75))
    bpy.ops.mesh.primitive_monkey_add(size=1.4, location=(0, 0, 0.7), rotation=(0, 0, 0.5))
    give(material("clay", (0.7, 0.3, 0.2), Roughness=0.8))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5, location=(1.3, -0.8, 0.5), segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    give(material("glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.45))
    bpy.ops.mesh.primitive_cylinder_add(radius=0.35, depth=1.0, location=(-1.4, -0.3, 0.5), vertices=64)
    give(material("brushed metal", (0.9, 0.8, 0.6), Metallic=1.0, Roughness=0.25))
    camera((3.2, -5.2, 2.6), (0.0, -0.2, 0.45), 45, f_stop=1.4)


def room():
    """A room that a window and a lamp light: mostly light from walls, stone, glossy tiles, a vase of glass."""
    sky(1.5, (0.8, 0.9, 1.0))
    walls = material("plaster", (0.75, 0.72, 0.66), Roughness=0.9)
    stone = textured("stone", "ShaderNodeTexNoise", 9, (0.35, 0.12, 0.08), (0.75, 0.6, 0.5), Detail=8.0, Roughness=0.7)
    tiles = textured("tiles", "ShaderNodeTexChecker", 5, (0.05, 0.05, 0.06), (0.8, 0.8, 0.78))
    tiles.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.15
    for location, scale, chosen in (
        ((0, 0, -0.05), (3, 3, 0.05), tiles), ((0, 0, 3.05), (3, 3, 0.05), walls), ((0, 3.05, 1.5), (3, 0.05, 1.5), stone),
        ((3.05, 0, 1.5), (0.05, 3, 1.5), walls), ((0, -3.05, 1.5), (3, 0.05, 1.5), walls),
        ((-3.05, -2, 1.5), (0.05, 1, 1.5), walls), ((-3.05, 2, 1.5), (0.05, 1, 1.5), walls),
        ((-3.05, 0, 0.4), (0.05, 1, 0.4), walls), ((-3.05, 0, 2.8), (0.05, 1, 0.2), walls),
    ):
        bpy.ops.mesh.primitive_cube_add(size=2, location=location)
        bpy.context.object.scale = scale
        give(chosen)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.25, location=(1.6, 1.8, 2.2))
    lamp = material("lamp")
    lamp.node_tree.nodes["Principled BSDF"].inputs["Emission Color"].default_value = (1, 0.7, 0.4, 1)
    lamp.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 60
    give(lamp)
    bpy.ops.mesh.primitive_cylinder_add(radius=0.8, depth=0.08, location=(0.4, 1.0, 0.75), vertices=64)
    give(textured("wood", "ShaderNodeTexWave", 9, (0.16, 0.07, 0.03), (0.5, 0.28, 0.13), Distortion=6.0, Detail=6.0))
    bpy.ops.mesh.primitive_cylinder_add(radius=0.08, depth=0.72, location=(0.4, 1.0, 0.36))
    give(material("steel", (0.8, 0.8, 0.82), Metallic=1.0, Roughness=0.3))
    bpy.ops.mesh.primitive_torus_add(major_radius=0.22, minor_radius=0.1, location=(0.3, 0.8, 0.89))
    bpy.ops.object.shade_smooth()
    give(material("glass", (0.7, 0.95, 0.8), Transmission_Weight=1.0, Roughness=0.0, IOR=1.45))
    bpy.ops.mesh.primitive_monkey_add(size=0.9, location=(-1.2, 1.2, 0.45), rotation=(0, 0, -0.4))
    give(material("jade", (0.2, 0.5, 0.3), Roughness=0.4))
    camera((1.2, -2.6, 1.5), (-0.1, 1.4, 0.95), 28)


def configure(size):
    """Cycles on the CPU, everything that denoisers are given, no denoiser and no clamp of its own."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = False, False
    scene.cycles.sample_clamp_indirect, scene.cycles.pixel_filter_type = 0.0, "BOX"
    scene.cycles.filter_width = 1.0
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    bpy.context.view_layer.cycles.denoising_store_passes = True
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"


def render(samples, seed, out):
    """One frame with the layers of the rendered pairs, in half floats."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.seed = samples, seed
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder, "frame.exr"))
        bpy.ops.render.render(write_still=True)
        with OpenEXR.File(scene.render.filepath, separate_channels=True) as file:
            channels = {name.split(".", 1)[1]: c.pixels for name, c in file.channels().items()}
    layers = {to: channels[name].clip(-65504, 65504) for to, name in PASSES.items()}
    layers["Z"] = np.where(layers["Z"] < 1e4, layers["Z"], 0.0)          # nothing was hit
    halves = {name: np.ascontiguousarray(values, np.float16) for name, values in layers.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    unfinished = out.with_suffix(".part.exr")
    OpenEXR.File(header, halves).write(str(unfinished))
    unfinished.rename(out)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("out", type=Path)
    p.add_argument("--size", type=int, default=384, help="pixels each way")
    p.add_argument("--reference", type=int, default=512, help="samples of the reference")
    args = p.parse_args()
    for make in (floor, room):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        make()
        configure(args.size)
        folder = args.out / make.__name__ / "v0"
        folder.mkdir(parents=True, exist_ok=True)
        frames = {f"spp{samples:04}.exr": samples for samples in SAMPLES} | {"ref.exr": args.reference}
        for seed, (name, samples) in enumerate(frames.items()):
            if not (folder / name).exists():
                render(samples, seed, folder / name)


if __name__ == "__main__":
    main()
