"""Tables of figures: means over the views with their gains over the noisy input, then every view."""
from dataclasses import asdict, dataclass

import numpy as np

from kit import metrics

METRIC_NAMES = tuple(metrics.METRICS)
TITLES = {"psnr": "PSNR (dB)", "ssim": "SSIM", "relmse": "relMSE", "detail": "detail"}
FORMATS = {"psnr": "{:.2f}", "ssim": "{:.3f}", "relmse": "{:.4f}", "detail": "{:.3f}"}
INTRODUCTION = """# Image quality

Written by `tools/measure/quality.py`; `tools/measure/README.md` says how to run it and what each column is. PSNR and SSIM
are of the 8-bit display images (gamma 2.2), relMSE = mean((a-b)^2 / (b^2 + 0.01)) of linear radiance; its gain is the
factor it fell by. Detail is the correlation with the reference of what a Gaussian of 11x11 pixels takes from the display
image: texture that is wiped out or invented lowers it. In rows without features every method gets the colour alone.
"""


@dataclass(frozen=True, order=True)
class Setting:
    """What a method gets: a frame of so many samples per pixel, with albedo, normal and depth or without."""

    spp: int
    features: bool

    def __str__(self):
        return f"{self.spp} spp" + ("" if self.features else ", no features")


@dataclass(frozen=True)
class Row:
    """The figures of one method on one view."""

    view: str
    setting: Setting
    method: str
    psnr: float
    ssim: float
    relmse: float
    detail: float


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def unique(values):
    """In order of first appearance."""
    return list(dict.fromkeys(values))


def settings_of(rows):
    """Those with features first, each kind by sample count."""
    return sorted({r.setting for r in rows}, key=lambda s: (not s.features, s.spp))


def means(rows, setting, method):
    """{metric: mean over the views}"""
    chosen = [r for r in rows if r.setting == setting and r.method == method]
    return {n: float(np.mean([getattr(r, n) for r in chosen])) for n in METRIC_NAMES}


def gains(rows, setting, method):
    """{metric: gain of the mean over the first method's}; of relMSE, by which factor it fell."""
    before, after = means(rows, setting, rows[0].method), means(rows, setting, method)
    differences = {n: after[n] - before[n] for n in ("psnr", "ssim", "detail")}
    return differences | {"relmse": before["relmse"] / after["relmse"]}


def means_table(rows):
    """One line per setting and method, each metric with its gain."""
    lines = []
    for setting in settings_of(rows):
        for method in unique(r.method for r in rows):
            mean, gain = means(rows, setting, method), gains(rows, setting, method)
            shown = [FORMATS[n].format(mean[n]) for n in METRIC_NAMES]
            if method == rows[0].method:
                better = [""] * len(METRIC_NAMES)
            else:
                better = [f"{gain['psnr']:+.2f} dB", f"{gain['ssim']:+.3f}", f"/ {gain['relmse']:.2f}", f"{gain['detail']:+.3f}"]
            lines.append([setting, method, *(cell for pair in zip(shown, better) for cell in pair)])
    return table(["input", "method", *(cell for n in METRIC_NAMES for cell in (TITLES[n], "gain"))], lines)


def view_table(rows, metric):
    """One line per view and setting, one column per method."""
    columns = unique(r.method for r in rows)
    values = {(r.view, r.setting, r.method): FORMATS[metric].format(getattr(r, metric)) for r in rows}
    lines = [
        [view, setting, *(values[view, setting, method] for method in columns)]
        for view in unique(r.view for r in rows)
        for setting in settings_of(rows)
        if (view, setting, columns[0]) in values
    ]
    return table(["view", "input", *columns], lines)


def markdown(rows):
    views = len({r.view for r in rows})
    parts = [INTRODUCTION, f"## Means over {views} views\n", means_table(rows)]
    for metric in METRIC_NAMES:
        parts += [f"\n## {TITLES[metric]} of each view\n", view_table(rows, metric)]
    return "\n".join(parts) + "\n"


def as_json(rows):
    """{"views": every row, "means": one entry per setting and method with its gains}"""
    every = [
        {"view": r.view, **asdict(r.setting), "method": r.method, **{n: getattr(r, n) for n in METRIC_NAMES}} for r in rows
    ]
    mean = [
        {**asdict(s), "method": m, **means(rows, s, m), "gain": gains(rows, s, m)}
        for s in settings_of(rows)
        for m in unique(r.method for r in rows)
    ]
    return {"views": every, "means": mean}
