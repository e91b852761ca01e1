"""What counts as an array, for type checkers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, Union

if TYPE_CHECKING:
    import numpy
    import numpy.typing
    from typing_extensions import Buffer, TypeAlias


class SupportsDLPack(Protocol):
    """What hands its samples out by DLPack: tensors of torch, jax and others."""

    def __dlpack__(self, *, stream: Any = None) -> Any: ...

    def __dlpack_device__(self) -> tuple[Any, int]: ...


class SupportsArray(Protocol):
    """What makes itself an array of numpy's."""

    def __array__(self) -> numpy.typing.NDArray[Any]: ...


if TYPE_CHECKING:
    FloatArray: TypeAlias = numpy.typing.NDArray[Union[numpy.float16, numpy.float32]]
    Readable: TypeAlias = Union[numpy.typing.NDArray[Any], SupportsDLPack, SupportsArray, Buffer]
