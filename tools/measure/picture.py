"""A picture for people: one row per scene, noisy | vkdenoise | OIDN | reference, gamma 2.2, with labels and credits."""
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from kit import metrics

COLUMNS = ("noisy", "vkdenoise", "OIDN", "reference")
# Licences ask for the author's name beside the picture.
CREDITS = {
    "bathroom": '"Contemporary Bathroom" by Mareck (CC0)',
    "living-room": '"The Grey & White Room" by Wig42 (CC BY 3.0)',
    "teapot": '"Utah Teapot" by Benedikt Bitterli (CC0)',
}
# Of `cycles_frames.py`; all others are Mitsuba's.
OF_CYCLES = ("floor", "room")
# Of each image the middle rows are shown: noise hardly compresses, and the picture is meant for a README.
ROWS = 144
GAP = 6
LABEL_HEIGHT = 26
CREDIT_HEIGHT = 22
FONT_SIZE = 15
INK, PAPER = (20, 20, 20), (255, 255, 255)


def label(column, spp):
    names = {"noisy": f"{spp} samples per pixel", "OIDN": "Intel OIDN, high"}
    return names.get(column, column)


def credit_line(scenes):
    renderers = dict.fromkeys("Blender's Cycles" if s in OF_CYCLES else "Mitsuba 3" for s in scenes)
    return "Scenes: " + "; ".join(CREDITS.get(s, s) for s in scenes) + f". Rendered with {' and '.join(renderers)}."


def middle_rows(color):
    top = max(color.shape[0] - ROWS, 0) // 2
    return color[top : top + ROWS]


def compare(images_of, spp):
    """{scene: {column: radiance [H, W, 3]}}, all of one size -> a PIL image. What was not measured has no column."""
    first = next(iter(images_of.values()))
    columns = [c for c in COLUMNS if c in first]
    height, width = middle_rows(first["reference"]).shape[:2]
    size = (len(columns) * (width + GAP) - GAP, LABEL_HEIGHT + len(images_of) * (height + GAP) + CREDIT_HEIGHT)
    canvas = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(FONT_SIZE)
    for i, column in enumerate(columns):
        left = i * (width + GAP)
        draw.text((left + width // 2, LABEL_HEIGHT // 2), label(column, spp), INK, font, anchor="mm")
        for row, outputs in enumerate(images_of.values()):
            pixels = metrics.display(middle_rows(outputs[column])).astype(np.uint8)
            canvas.paste(Image.fromarray(pixels), (left, LABEL_HEIGHT + row * (height + GAP)))
    draw.text((0, size[1] - CREDIT_HEIGHT // 2), credit_line(images_of), INK, ImageFont.load_default(12), anchor="lm")
    return canvas
