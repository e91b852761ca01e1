"""What a type checker says of the package's users; nothing runs it."""

from pathlib import Path

import numpy
import numpy.typing

import vkdenoise

color: numpy.typing.NDArray[numpy.float32] = numpy.zeros((4, 4, 3), numpy.float32)
half: numpy.typing.NDArray[numpy.float16] = numpy.zeros((4, 4, 3), numpy.float16)

clean = vkdenoise.denoise(color, albedo=half, depth=bytearray(64), quality="high", region=(0, 0, 2, 2))
clean[..., 0].mean()
same: numpy.typing.NDArray[numpy.float32] = vkdenoise.denoise(color, out=color)
denoiser = vkdenoise.Denoiser(device=0, weights=Path("weights.safetensors"), cache="off")
denoiser.denoise(color, exposure=1, fireflies="keep")[0]
if denoiser.report is not None:
    factor: float = denoiser.report.exposure
best, layers = denoiser.denoise(color, light_groups={"key": color}, aovs={"Z": half}, alpha="denoise")
best[..., 0].mean()
layers["key"][..., 0].mean()
denoiser.denoise(color, aovs={"Z": half}, progress=lambda share: share < 0.5)[1]["Z"].mean()
vkdenoise.denoise(color, light_groups={"key": color}, progress=print)[0].mean()
names: list[str] = [device.name for device in vkdenoise.devices() if device.usable]

vkdenoise.denoise()  # type: ignore[call-overload]
vkdenoise.denoise(3)  # type: ignore[call-overload]
vkdenoise.denoise(color, quality="best")  # type: ignore[call-overload]
vkdenoise.denoise(color, aovs=[half])  # type: ignore[call-overload]
vkdenoise.denoise(color, progress=0.5)  # type: ignore[call-overload]
vkdenoise.denoise(color, None, None, None, color)  # type: ignore[call-overload]
denoiser.denoise(color, exposure="auto")  # type: ignore[call-overload]
vkdenoise.Denoiser("high")  # type: ignore[call-arg]
denoiser.report.exposure  # type: ignore[union-attr]
