"""Scenes: opening, rendering, and evaluation at points."""

from __future__ import annotations

import ctypes
import math
import os
import threading
from collections import deque
from collections.abc import Iterable, Mapping
from ctypes import byref, pointer
from typing import Any, Callable, Optional

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _abi
from ._arrays import OUTPUTS, Column, Surface, numbers, surfaces, vector, vectors, within

_TILE = 32  # pixels, both ways
_BATCHES = 1024, 16384  # rays or points: the fewest in one call, and the most
_Out = Optional[Mapping[str, NDArray[Any]]]
_Names = Optional[Iterable[str]]
_Part = tuple[int, int]
_Draw = Callable[[ctypes.c_void_p, _Part], None]


class Result(dict[str, NDArray[Any]]):
    """Requested arrays by name: `result["rgb"]` is the same array as `result.rgb`.

    Shape: `[height, width]` from `render`; from `rays` and `points` that of the rays or points without the last axis. `rgb`
    and `normals` have a further axis of 3 channels. Type: float32. Arrays passed as `out` may differ, see `Scene.render`.

    - `rgb`: colour, display-encoded, over the scene's background.
    - `opacity`: in `[0, 1]`.
    - `ray_distance`: mean distance along the ray, world units; `t_max` or beyond the scene if opacity is 1e-4 or less.
    - `z_depth`: mean distance along the view axis, world units; equal to `ray_distance` if opacity is 1e-4 or less.
    - `median_distance`: distance along the ray at which transmittance falls below one half, world units.
    - `normals`: normal of the surface, world space, unit length; 0 without a surface.
    - `sigma`: density, per world unit.
    """

    rgb: NDArray[Any]
    opacity: NDArray[np.float32]
    ray_distance: NDArray[np.float32]
    z_depth: NDArray[np.float32]
    median_distance: NDArray[np.float32]
    normals: NDArray[np.float32]
    sigma: NDArray[np.float32]

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name in self:
            return self[name]
        raise AttributeError(f"{name}: expected one of {', '.join(self)}; outputs= asks for others")


class Scene:
    """A radiance field from a file. Threads may share a scene. As a context manager, the scene closes itself.

    `path`: a `.nerf` file, which is read whole and may change afterwards. Raises `Error` if the file is missing, damaged or
    of another version of the format.
    `info`: description of the scene, by the fields of `nerf_scene_info` in `nerf_render.h`: `box_min`, `eye`, `psnr_db`, …

    Every method releases the GIL while it renders. `threads`: largest number of threads; None for one per core that the
    process may use. Results are bit-identical for any number of threads.
    """

    def __init__(self, path: str | bytes | os.PathLike[Any]) -> None:
        place, info = os.fsencode(path), _abi.SceneInfo()
        if b"\0" in place:
            raise ValueError("path: expected one without NUL, found one in it")
        self._handle: _abi.SceneHandle | None = _abi.SceneHandle(place)
        _abi.library.nerf_scene_describe(self._handle.pointer, byref(info))
        self.info: dict[str, Any] = {name: _plain(getattr(info, name)) for name, _ in info._fields_[1:]}

    def close(self) -> None:
        """Closes the scene; its memory is freed once no thread renders it. A second call does nothing.

        A method that is rendering in another thread raises `ValueError`, as does every later call.
        """
        self._handle = None

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def render(
        self, width: int, height: int, c2w: ArrayLike | None = None, fov: float = 40.0, *,
        outputs: _Names = None, out: _Out = None, threads: int | None = None,
    ) -> Result:  # fmt: skip
        """Renders the image of a perspective camera.

        `width`, `height`: pixels, 1 to 2^23.
        `c2w`: camera-to-world matrix, `[3, 4]` or `[4, 4]`: a rotation (columns right, up, backward) and the position. None
        for the scene file's viewpoint, where a photograph was taken; without one, the start of `nerf-train render`'s orbit.
        `fov`: horizontal field of view, degrees, above 0 and below 180.
        `outputs`: names in `Result`, besides those in `out`. Without any name: rgb, opacity, ray_distance and z_depth.
        `out`: arrays that receive results, by name; gaps between pixels and rows are allowed. float32; `rgb` also uint8. An
        `rgb` array of 4 channels gets premultiplied colour without background, and opacity. An exception may leave arrays
        partly written.
        """
        width, height = within("width", width, 1, 1 << 23), within("height", height, 1, 1 << 23)
        if not 0.0 < fov < 180.0:
            raise ValueError(f"fov: expected degrees above 0 and below 180, found {fov}")
        focal = 0.5 * width / math.tan(0.5 * math.radians(fov))
        camera = _abi.Camera(width=width, height=height, fx=focal, fy=focal, cx=0.5 * width, cy=0.5 * height)
        camera.c2w[:] = (_start(self.info) if c2w is None else _pose(c2w)).ravel().tolist()
        default = ("rgb", "opacity", "ray_distance", "z_depth")
        to = surfaces(outputs, out, default, tuple(OUTPUTS), (height, width), False, {})

        def draw(worker: ctypes.c_void_p, part: _Part) -> None:
            x, y = part
            rect = _abi.Rect(x, y, min(_TILE, width - x), min(_TILE, height - y))
            target = _abi.Target(**{surface.name: surface.at(x, y) for surface in to})
            frame = _abi.Frame(camera=pointer(camera), rect=pointer(rect), target=pointer(target))
            _abi.call("nerf_render", worker, byref(frame), None)

        tiles = [(x, y) for y in range(0, height, _TILE) for x in range(0, width, _TILE)]
        return self._draw(tiles, to, draw, threads)

    def rays(
        self, origins: ArrayLike, dirs: ArrayLike, t_min: ArrayLike | None = None,
        t_max: ArrayLike | None = None, *,
        axis: ArrayLike | None = None, outputs: _Names = None, out: _Out = None, threads: int | None = None,
    ) -> Result:  # fmt: skip
        """Renders given rays. The rays of a camera's pixels give the camera's image, bit for bit.

        `origins`, `dirs`: `[..., 3]`, world space; `dirs` of unit length (squared length within 1e-3 of 1). One of the two
        may be `[3]`, for all rays.
        `t_min`, `t_max`: distances along the ray between which the scene is visible, world units: `[...]`, or one number
        for all rays. None for 0 and infinity.
        `axis`: `[3]`, unit length: the view axis along which `z_depth` is measured.
        `outputs`: names in `Result`, besides those in `out`. Without any name: rgb, opacity, ray_distance, and, if `axis`
        is given, z_depth.
        `out`: arrays that receive results, as in `render`.

        float32 arrays, also fields of structured arrays, are read without a copy; other types are copied.
        """
        shape = max(vectors("origins", origins).shape, vectors("dirs", dirs).shape, key=len)
        read = {"origins": Column.of("origins", origins, shape, 3), "dirs": Column.of("dirs", dirs, shape, 3)}
        for name, limits in (("t_min", t_min), ("t_max", t_max)):
            if limits is not None:
                read[name] = Column.of(name, limits, shape[:-1], 1)
        along = None if axis is None else vector("axis", axis)
        default = ("rgb", "opacity", "ray_distance", "z_depth")[: 3 if along is None else 4]
        to = surfaces(outputs, out, default, tuple(OUTPUTS), shape[:-1], True, read)
        if along is None and any(surface.name == "z_depth" for surface in to):
            raise ValueError("axis: expected three numbers, along which z_depth is measured, found none")

        def structure(count: int, columns: Any, planes: Any) -> Any:
            return _abi.Rays(count=count, axis=along, target=pointer(_abi.Target(**planes)), **columns)

        return self._draw_batches("nerf_render_rays", structure, read, to, math.prod(shape[:-1]), threads)

    def points(
        self, xyz: ArrayLike, dirs: ArrayLike | None = None, *,
        out: _Out = None, threads: int | None = None,
    ) -> Result:  # fmt: skip
        """Evaluates the density `sigma` at points and, if `dirs` is given, the colour `rgb`.

        `xyz`: `[..., 3]`, world space. In empty cells, and outside a bounded scene's box, density is 0 and colour black.
        `dirs`: unit directions from the eye to each point, `[..., 3]`, or `[3]` for all points.
        `out`: float32 arrays that receive `sigma`, `rgb` or both, as in `render`.
        """
        shape, names = vectors("xyz", xyz).shape, ("sigma", "rgb")[: 1 if dirs is None else 2]
        read = {"positions": Column.of("xyz", xyz, shape, 3)}
        if dirs is not None:
            read["dirs"] = Column.of("dirs", dirs, shape, 3)
        to = surfaces(names, out, names, names, shape[:-1], True, read)

        def structure(count: int, columns: Any, planes: Any) -> Any:
            return _abi.Points(count=count, **columns, **planes)

        return self._draw_batches("nerf_query", structure, read, to, math.prod(shape[:-1]), threads)

    def _draw_batches(
        self, name: str, structure: Callable[[int, Any, Any], Any], read: dict[str, Column], to: list[Surface],
        count: int, threads: int | None,
    ) -> Result:  # fmt: skip
        def draw(worker: ctypes.c_void_p, part: _Part) -> None:
            columns = {name: column.at(part[0]) for name, column in read.items()}
            planes = {surface.name: surface.at(part[0]) for surface in to}
            _abi.call(name, worker, byref(structure(part[1], columns, planes)), None)

        threads = _cores() if threads is None else within("threads", threads, 1, 1 << 16)
        batch = min(max(_BATCHES[0], count // (1 if threads == 1 else 4 * threads)), _BATCHES[1])
        batches = [(first, min(batch, count - first)) for first in range(0, count, batch)]
        try:
            return self._draw(batches, to, draw, threads)
        except _abi.Error as error:
            if error.status not in (_abi.STATUS_DIRECTION, _abi.STATUS_RAY):
                raise
        # The message numbers the ray within its batch. One call for all rays numbers it among all, and draws none.
        return self._draw([(0, count)], to, draw, 1)

    def _draw(self, parts: list[_Part], to: list[Surface], draw: _Draw, threads: int | None) -> Result:
        """Renders tiles or batches on this thread and helper threads, each with a worker of its own.

        Helper threads end with the call: a forked process, which has none of them, loses nothing.
        """
        handle = self._handle
        if handle is None:
            raise ValueError("scene: expected an open one, found one that was closed")
        threads = _cores() if threads is None else within("threads", threads, 1, 1 << 16)
        outputs = sum(OUTPUTS.get(surface.name, 0) for surface in to)
        waiting, failures = deque(parts), deque[BaseException]()

        def work() -> None:
            try:
                worker, _memory = _open_worker(handle, outputs)
                while True:
                    try:
                        part = waiting.popleft()
                    except IndexError:
                        return
                    if self._handle is not handle:
                        raise ValueError("scene: expected an open one, found one that was closed while it was drawn")
                    draw(worker, part)
            except BaseException as failure:
                waiting.clear()
                failures.append(failure)

        helpers = [threading.Thread(target=work) for _ in range(min(threads, len(parts)) - 1)]
        for helper in helpers:
            helper.start()
        work()
        for helper in helpers:
            helper.join()
        if failures:
            raise failures.popleft()
        return Result({surface.name: surface.array for surface in to})


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> NDArray[np.float32]:
    """Returns `c2w`, `[3, 4]`, of a camera at `eye` that looks at `target`; `up` points upwards in the image.

    All arguments: `[3]`, world units. Raises `Error` if `eye` equals `target`, or `up` is 0 or parallel to the view axis.
    """
    camera = _abi.Camera()
    places = vector("eye", eye), vector("target", target), vector("up", up)
    _abi.call("nerf_camera_look_at", byref(camera), *places)
    return np.array(camera.c2w, np.float32).reshape(3, 4)


def _start(info: Mapping[str, Any]) -> NDArray[np.float32]:
    """Returns `c2w` of the scene file's viewpoint or, without one, of the start of `nerf-train render`'s orbit."""
    if any(info["up"]):
        return look_at(info["eye"], info["target"], info["up"])
    centre = 0.5 * (np.array(info["box_min"]) + info["box_max"])
    radius, elevation = 0.5 * (info["near_distance"] + info["far_distance"]), math.radians(25.0)
    return look_at(centre + radius * np.array([math.cos(elevation), 0.0, math.sin(elevation)]), centre)


def _pose(value: ArrayLike) -> NDArray[np.float32]:
    array = numbers("c2w", value, (3, 4), (4, 4))
    if len(array) == 4 and not np.array_equal(array[3], [0, 0, 0, 1]):
        raise ValueError(f"c2w: expected the last row 0 0 0 1, found {array[3]}")
    return array[:3]


def _open_worker(handle: _abi.SceneHandle, outputs: int) -> tuple[ctypes.c_void_p, NDArray[np.uint8]]:
    """Opens a worker. Returns the worker and its memory, which must outlive the worker."""
    request = _abi.Request(scene=handle.pointer, outputs=outputs)
    size, align, worker = ctypes.c_size_t(), ctypes.c_size_t(), ctypes.c_void_p()
    _abi.call("nerf_worker_size", byref(request), byref(size), byref(align))
    memory = np.empty(size.value + align.value, np.uint8)
    place = memory.ctypes.data + -memory.ctypes.data % align.value
    _abi.call("nerf_worker_open", byref(request), place, size, byref(worker))
    return worker, memory


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _plain(value: Any) -> Any:
    """Converts a field of a C structure to a str, a tuple or a number."""
    if isinstance(value, _abi.Text):
        return ctypes.string_at(value.data, value.length).decode(errors="replace") if value.data else ""
    return tuple(value) if isinstance(value, ctypes.Array) else value
