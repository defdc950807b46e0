"""Declares with ctypes the part of the C ABI (`nerf_render.h`) that the package uses. Every call releases the GIL."""

from __future__ import annotations

import ctypes
import os
from ctypes import POINTER, byref, c_char_p, c_size_t, c_ssize_t, c_void_p
from typing import Any

ABI_VERSION = 2
STATUS_DIRECTION, STATUS_RAY = 15, 22
_MESSAGE_BYTES = 4096 + 512  # a path, and the sentence behind it
_U32, _U64, _F32 = ctypes.c_uint32, ctypes.c_uint64, ctypes.c_float


class Error(Exception):
    """A call that the library refused, with the library's message. `status`: a `nerf_status` of `nerf_render.h`."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(status, message)
        self.status = status

    def __str__(self) -> str:
        return str(self.args[1])


class Versioned(ctypes.Structure):
    """Base of C structures whose first field, `struct_size`, is the size of the structure, bytes."""

    def __init__(self, **values: Any) -> None:
        super().__init__(struct_size=ctypes.sizeof(self), **values)


def _structure(name: str, *groups: tuple[Any, str]) -> Any:
    """Declares a structure of the C header. `groups`: a type, and the names of successive fields of this type."""
    fields = [(field, kind) for kind, names in groups for field in names.split()]
    base = Versioned if fields[0][0] == "struct_size" else ctypes.Structure
    return type(name, (base,), {"_fields_": fields})


# fmt: off
Text = _structure("Text", (c_void_p, "data"), (c_size_t, "length"))
Plane = _structure(
    "Plane", (c_void_p, "data"), (c_size_t, "pixel_stride"), (c_ssize_t, "row_stride"), (_U32, "format reserved"))
Floats = _structure("Floats", (c_void_p, "data"), (c_size_t, "stride"))
Rect = _structure("Rect", (_U32, "x y width height"))
SceneInfo = _structure(
    "SceneInfo", (c_size_t, "struct_size"), (_U32, "kind kernel"), (_F32 * 3, "box_min box_max"),
    (_F32, "near_distance far_distance"), (_U32, "samples"), (_F32 * 3, "background"),
    (_U32, "view_dependent occupancy_required"), (_U32 * 3, "occupancy_resolution"), (_F32, "occupied_share"),
    (_U32, "trunk_layers"), (_U32 * 16, "trunk_widths"), (_U32, "colour_layers"), (_U32 * 4, "colour_widths"),
    (_F32, "psnr_db quantisation_loss_db"), (_U32, "steps"), (_U64, "parameters density_macs colour_macs seed"),
    (Text, "data made_by psnr_convention"), (_U32, "picture_width picture_height proposal_samples front_points"),
    (_U64, "proposal_macs"), (_F32, "step"), (_U32, "table_storage"), (_F32, "contraction_radius"),
    (_U32, "contraction_power storage"), (_F32 * 3, "eye target up"), (_F32, "arc"))
Camera = _structure(
    "Camera", (c_size_t, "struct_size"), (_U32, "width height"), (_F32, "fx fy cx cy k1 k2 p1 p2"), (_F32 * 12, "c2w"),
    (_F32, "k3 k4 k5 k6"), (_U32, "lens_model reserved"))
Request = _structure(
    "Request", (c_size_t, "struct_size"), (c_void_p, "scene instances"), (c_size_t, "instance_count"),
    (c_void_p, "options"), (_U32, "outputs reserved"))
Target = _structure(
    "Target", (c_size_t, "struct_size"), (Plane, "rgb opacity ray_distance z_depth median_distance normals"),
    (Plane, "limit_ray_distance limit_z_depth"))
Frame = _structure(
    "Frame", (c_size_t, "struct_size"), (POINTER(Camera), "camera"), (POINTER(Rect), "rect"),
    (POINTER(Target), "target"), (_U32, "width height"), (c_void_p, "progress user"))
Rays = _structure(
    "Rays", (c_size_t, "struct_size count"), (Floats, "origins dirs t_min t_max random"), (POINTER(_F32), "axis"),
    (POINTER(Target), "target"))
Points = _structure("Points", (c_size_t, "struct_size count"), (Floats, "positions dirs"), (Plane, "sigma rgb"))
# fmt: on


def _load() -> ctypes.CDLL:
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "libnerf_render.so")
    try:
        loaded = ctypes.CDLL(path)
    except OSError as error:
        raise ImportError(f"nerf_render: expected its library beside it: {error}") from error
    if loaded.nerf_abi_version() != ABI_VERSION:
        raise ImportError(f"{path}: expected ABI version {ABI_VERSION}, found {loaded.nerf_abi_version()}")
    three = POINTER(_F32)
    for name, arguments in {
        "nerf_scene_open_file": [c_char_p, c_void_p, POINTER(c_void_p)],
        "nerf_camera_look_at": [POINTER(Camera), three, three, three],
        "nerf_worker_size": [POINTER(Request), POINTER(c_size_t), POINTER(c_size_t)],
        "nerf_worker_open": [POINTER(Request), c_void_p, c_size_t, POINTER(c_void_p)],
        "nerf_render": [c_void_p, POINTER(Frame), c_void_p],
        "nerf_render_rays": [c_void_p, POINTER(Rays), c_void_p],
        "nerf_query": [c_void_p, POINTER(Points), c_void_p],
    }.items():
        getattr(loaded, name).argtypes = [*arguments, c_char_p, c_size_t]
    loaded.nerf_scene_describe.argtypes = [c_void_p, POINTER(SceneInfo)]
    loaded.nerf_scene_close.argtypes, loaded.nerf_scene_close.restype = [c_void_p], None
    loaded.nerf_version_text.restype = loaded.nerf_status_text.restype = c_char_p
    return loaded


library = _load()


def call(name: str, *arguments: Any) -> None:
    """Calls the C function `name` with `arguments` and a buffer for a message. Raises `Error` if the call fails."""
    message = ctypes.create_string_buffer(_MESSAGE_BYTES)
    status = getattr(library, name)(*arguments, message, _MESSAGE_BYTES)
    if status:
        sentence: bytes = message.value or library.nerf_status_text(status)
        raise Error(status, sentence.decode(errors="replace"))


class SceneHandle:
    """Scene opened by the library; closed with the last reference. A call in another thread holds a reference."""

    def __init__(self, path: bytes) -> None:
        self.pointer = c_void_p()
        call("nerf_scene_open_file", path, None, byref(self.pointer))

    def __del__(self, close: Any = library.nerf_scene_close) -> None:
        close(self.pointer)
