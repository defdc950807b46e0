"""Checks of arguments, and conversion of numpy arrays to structures of the C ABI."""

from __future__ import annotations

import ctypes
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _abi

Shape = tuple[int, ...]
OUTPUTS = {"rgb": 1, "opacity": 2, "ray_distance": 4, "z_depth": 8, "median_distance": 16, "normals": 32}
_F32, _U8 = np.dtype(np.float32), np.dtype(np.uint8)
# A nerf_format by type and channels.
_COLOUR: dict[Any, int] = {(_F32, (3,)): 2, (_U8, (3,)): 1, (_F32, (4,)): 4, (_U8, (4,)): 3}
_FORMATS: dict[str, dict[Any, int]] = {"rgb": _COLOUR, "normals": {(_F32, (3,)): 6}}
_SCALAR: dict[Any, int] = {(_F32, ()): 5}


def numbers(name: str, value: ArrayLike, *shapes: Shape) -> NDArray[np.float32]:
    """Returns `value` as float32, copied only if of another type. `shapes`: allowed shapes; empty for any shape."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected real numbers, found {array.dtype}")
    if shapes and array.shape not in shapes:
        raise ValueError(f"{name}: expected the shape {' or '.join(map(str, shapes))}, found {array.shape}")
    if array.dtype == _F32:
        return array
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def vectors(name: str, value: ArrayLike) -> NDArray[np.float32]:
    array = numbers(name, value)
    if array.shape[-1:] != (3,):
        raise ValueError(f"{name}: expected the shape (..., 3), found {array.shape}")
    return array


def vector(name: str, value: ArrayLike) -> Any:
    """Returns three numbers as a C array of floats."""
    return (ctypes.c_float * 3)(*numbers(name, value, (3,)))


def within(name: str, value: int, least: int, most: int) -> int:
    number = operator.index(value)
    if not least <= number <= most:
        raise ValueError(f"{name}: expected {least} to {most}, found {number}")
    return number


class Column(NamedTuple):
    """Input array: the numbers of ray or point `i` begin `i * stride` bytes after `address`."""

    array: NDArray[np.float32]
    address: int
    stride: int

    @classmethod
    def of(cls, name: str, value: ArrayLike, shape: Shape, width: int) -> Column:
        """Makes a column of `width` numbers per ray from an array of `shape`, or from one element for all rays."""
        array = numbers(name, value, shape, (3,) if width == 3 else ())
        flat = (array if array.shape == shape else np.broadcast_to(array, shape)).reshape(-1, width)
        step, inner = flat.strides
        strided = step >= 4 * width and step % 4 == 0 and (width == 1 or inner == 4)
        if not (flat.flags.aligned and (flat.flags.c_contiguous or strided)):
            flat = flat.copy()
        return cls(flat, flat.ctypes.data, 4 * width if flat.flags.c_contiguous else step)

    def at(self, i: int) -> Any:
        return _abi.Floats(self.address + i * self.stride, self.stride)


class Surface(NamedTuple):
    """Output array: address of the first pixel, strides in bytes, and the `nerf_format` of a pixel."""

    name: str
    array: NDArray[Any]
    address: int
    pixel_stride: int
    row_stride: int
    format: int

    @classmethod
    def of(cls, name: str, array: object, shape: Shape, row: bool) -> Surface:
        """Makes the surface of `array`: `shape` or `[*shape, channels]`. `row`: all pixels form one row."""
        if not isinstance(array, np.ndarray):
            raise TypeError(f"out[{name!r}]: expected a numpy array, found {type(array).__name__}")
        formats, channels = _FORMATS.get(name, _SCALAR), array.shape[len(shape) :]
        found = formats.get((array.dtype, channels))
        if array.shape[: len(shape)] != shape or found is None:
            expected = " or ".join(f"{dtype} {shape + tail}" for dtype, tail in formats)
            raise ValueError(f"out[{name!r}]: expected {expected}, found {array.dtype} {array.shape}")
        if not array.flags.writeable:
            raise ValueError(f"out[{name!r}]: expected an array to write to, found a read-only one")
        if not array.size:
            return cls(name, array, 0, 0, 0, found)
        pixels = array.reshape(1, -1, *channels) if row else array
        (height, width), size = pixels.shape[:2], array.itemsize * (channels or (1,))[0]
        pixel_stride = pixels.strides[1] if width > 1 else size
        row_stride = pixels.strides[0] if height > 1 else width * pixel_stride
        side_by_side = not channels or array.strides[-1] == array.itemsize
        apart = pixel_stride >= size and abs(row_stride) >= (width - 1) * pixel_stride + size
        if not (side_by_side and apart and np.may_share_memory(pixels, array)):
            raise ValueError(
                f"out[{name!r}]: expected channels side by side, pixels in rows and rows apart, "
                f"found strides {array.strides}")
        return cls(name, array, array.ctypes.data, pixel_stride, row_stride, found)

    def at(self, x: int, y: int = 0) -> Any:
        place = self.address + x * self.pixel_stride + y * self.row_stride
        return _abi.Plane(place, self.pixel_stride, self.row_stride, self.format)


def surfaces(
    outputs: Iterable[str] | None, out: Mapping[str, Any] | None, default: Sequence[str],
    there: Sequence[str], shape: Shape, row: bool, read: dict[str, Column],
) -> list[Surface]:  # fmt: skip
    """Makes a surface per output, of an array in `out` or a new one. Arrays must not overlap each other or `read`."""
    if not isinstance(out, (Mapping, type(None))):
        raise TypeError(f"out: expected arrays by name, found {type(out).__name__}")
    named = [outputs] if isinstance(outputs, str) else outputs or ()
    made: list[Surface] = []
    for name in dict.fromkeys([*named, *(out or ())] or default):
        if name not in there:
            raise ValueError(f"outputs: expected some of {', '.join(there)}, found {name!r}")
        channels = (3,) if name in _FORMATS else ()
        array = out[name] if out and name in out else np.empty(shape + channels, np.float32)
        surface = Surface.of(name, array, shape, row)
        others: dict[str, Any] = {**read, **{f"out[{other.name!r}]": other for other in made}}
        for label, other in others.items() if out else ():
            if np.may_share_memory(surface.array, other.array, max_work=10_000):  # type: ignore[arg-type]
                raise ValueError(f"out[{name!r}]: expected memory of its own, found that of {label}")
        made.append(surface)
    return made
