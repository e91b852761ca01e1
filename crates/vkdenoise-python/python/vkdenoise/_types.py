"""The types of arguments, for type checkers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Callable, Literal, Protocol, Union

import numpy
import numpy.typing

Quality = Literal["fast", "balanced", "high"]
Precision = Literal["auto", "fp32", "fp16", "matrix"]
Fireflies = Literal["auto", "keep", "mend"]
SkipMode = Literal["approximate", "exact"]
Device = Union[int, str]
Alpha = Literal["keep", "denoise"]
Progress = Callable[[float], object]


class SupportsDLPack(Protocol):
    """What hands its samples out by DLPack: tensors of torch, jax and others."""

    def __dlpack__(self, *, stream: Any = None) -> Any: ...

    def __dlpack_device__(self) -> tuple[Any, int]: ...


class SupportsArray(Protocol):
    """What makes itself an array of numpy's."""

    def __array__(self) -> numpy.typing.NDArray[Any]: ...


class SupportsBuffer(Protocol):
    """What has the buffer protocol."""

    def __buffer__(self, flags: int, /) -> memoryview: ...


FloatArray = numpy.typing.NDArray[Union[numpy.float16, numpy.float32]]
Readable = Union[numpy.typing.NDArray[Any], SupportsDLPack, SupportsArray, SupportsBuffer]
Layers = Mapping[str, Readable]
