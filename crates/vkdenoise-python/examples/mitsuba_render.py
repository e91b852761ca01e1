"""Renders a Cornell box with Mitsuba 3, 16 samples per pixel, and denoises it: noisy.png, clean.png."""

import mitsuba
import numpy
import vkdenoise

mitsuba.set_variant("scalar_rgb")
scene = mitsuba.cornell_box()
aovs = "albedo:albedo,normal:sh_normal,depth:depth"
scene["sensor"]["film"]["rfilter"] = {"type": "box"}  # any other spreads a sample's noise over pixels
scene["integrator"] = {"type": "aov", "aovs": aovs, "image": {"type": "path"}}
render = numpy.array(mitsuba.render(mitsuba.load_dict(scene), spp=16))
color, albedo, normal, depth = numpy.split(render, [3, 6, 9], axis=2)
clean = vkdenoise.denoise(color, albedo, normal, depth)
mitsuba.util.write_bitmap("noisy.png", color)
mitsuba.util.write_bitmap("clean.png", clean)
