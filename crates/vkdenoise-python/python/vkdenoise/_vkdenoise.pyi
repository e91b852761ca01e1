import os
from collections.abc import Sequence
from typing import Any, TypeVar, final, overload

from ._types import (
    Alpha,
    Device,
    Fireflies,
    FloatArray,
    Layers,
    Precision,
    Progress,
    Quality,
    Readable,
    SkipMode,
)

__all__ = ["Cancelled", "Denoiser", "DeviceError", "DeviceInfo", "DeviceLostError", "Report", "__version__", "devices"]

__version__: str

_Out = TypeVar("_Out", bound=Readable)

class Cancelled(Exception): ...
class DeviceError(RuntimeError): ...
class DeviceLostError(DeviceError): ...

@final
class DeviceInfo:
    @property
    def index(self) -> int: ...
    @property
    def name(self) -> str: ...
    @property
    def driver(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def api_version(self) -> str: ...
    @property
    def memory_bytes(self) -> int: ...
    @property
    def missing(self) -> list[str]: ...
    @property
    def usable(self) -> bool: ...

@final
class Report:
    @property
    def exposure(self) -> float: ...
    @property
    def gpu_ms(self) -> float | None: ...
    @property
    def total_ms(self) -> float: ...
    @property
    def work(self) -> float: ...
    @property
    def device_bytes(self) -> int: ...
    @property
    def tiles(self) -> int: ...

@final
class Denoiser:
    def __new__(
        cls,
        *,
        quality: Quality = "balanced",
        weights: str | os.PathLike[str] | None = None,
        precision: Precision = "auto",
        blend: float = 0.0,
        clean_aux: bool = False,
        skip_below: float | None = None,
        skip_mode: SkipMode = "approximate",
        memory_budget: int | None = None,
        keep_features: bool = False,
        signals: bool = False,
        device: Device | None = None,
        cache: str | os.PathLike[str] = ...,
    ) -> Denoiser: ...
    @overload
    def denoise(
        self,
        color: Readable,
        albedo: Readable | None = None,
        normal: Readable | None = None,
        depth: Readable | None = None,
        *,
        out: None = None,
        exposure: float | None = None,
        fireflies: Fireflies = "auto",
        region: Sequence[int] | None = None,
        variance: Readable | None = None,
        samples: Readable | None = None,
        features_unchanged: bool = False,
        light_groups: None = None,
        aovs: None = None,
        alpha: Alpha = "keep",
        progress: Progress | None = None,
    ) -> FloatArray: ...
    @overload
    def denoise(
        self,
        color: Readable,
        albedo: Readable | None = None,
        normal: Readable | None = None,
        depth: Readable | None = None,
        *,
        out: _Out,
        exposure: float | None = None,
        fireflies: Fireflies = "auto",
        region: Sequence[int] | None = None,
        variance: Readable | None = None,
        samples: Readable | None = None,
        features_unchanged: bool = False,
        light_groups: None = None,
        aovs: None = None,
        alpha: Alpha = "keep",
        progress: Progress | None = None,
    ) -> _Out: ...
    @overload
    def denoise(
        self,
        color: Readable,
        albedo: Readable | None = None,
        normal: Readable | None = None,
        depth: Readable | None = None,
        *,
        out: None = None,
        exposure: float | None = None,
        fireflies: Fireflies = "auto",
        region: Sequence[int] | None = None,
        variance: Readable | None = None,
        samples: Readable | None = None,
        features_unchanged: bool = False,
        light_groups: Layers,
        aovs: Layers | None = None,
        alpha: Alpha = "keep",
        progress: Progress | None = None,
    ) -> tuple[FloatArray, dict[str, FloatArray]]: ...
    @overload
    def denoise(
        self,
        color: Readable,
        albedo: Readable | None = None,
        normal: Readable | None = None,
        depth: Readable | None = None,
        *,
        out: None = None,
        exposure: float | None = None,
        fireflies: Fireflies = "auto",
        region: Sequence[int] | None = None,
        variance: Readable | None = None,
        samples: Readable | None = None,
        features_unchanged: bool = False,
        light_groups: None = None,
        aovs: Layers,
        alpha: Alpha = "keep",
        progress: Progress | None = None,
    ) -> tuple[FloatArray, dict[str, FloatArray]]: ...
    @overload
    def denoise(
        self,
        color: Readable,
        albedo: Readable | None = None,
        normal: Readable | None = None,
        depth: Readable | None = None,
        *,
        out: Readable | None,
        exposure: float | None = None,
        fireflies: Fireflies = "auto",
        region: Sequence[int] | None = None,
        variance: Readable | None = None,
        samples: Readable | None = None,
        features_unchanged: bool = False,
        light_groups: Layers | None = None,
        aovs: Layers | None = None,
        alpha: Alpha = "keep",
        progress: Progress | None = None,
    ) -> Any: ...
    def memory_required(self, height: int, width: int) -> int: ...
    @property
    def report(self) -> Report | None: ...
    @property
    def device(self) -> DeviceInfo: ...
    @property
    def quality(self) -> str: ...
    @property
    def precision(self) -> str: ...

def devices() -> list[DeviceInfo]: ...
