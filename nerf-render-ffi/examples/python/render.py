"""Renders rays of a scene into numpy arrays: render.py libnerf_render.so scene.nerf out.npy [side]"""
import ctypes as c
import sys

import numpy as np

library, path, out, side = c.CDLL(sys.argv[1]), sys.argv[2], sys.argv[3], int((sys.argv + [200])[4])
pointer, size, u32 = c.c_void_p, c.c_size_t, c.c_uint32

def structure(name, fields):
    kind = type(name, (c.Structure,), {"_fields_": [("struct_size", size), *fields]})
    return lambda **values: kind(struct_size=c.sizeof(kind), **values)

Floats = type("Floats", (c.Structure,), {"_fields_": [("data", pointer), ("stride", size)]})
Plane = type("Plane", (c.Structure,), {"_fields_": [("data", pointer), ("pixel_stride", size), ("row_stride", c.c_ssize_t), ("format", u32), ("reserved", u32)]})
Target = structure("Target", [(n, Plane) for n in "rgb opacity ray_distance z_depth median normals limit_ray limit_z".split()])
Request = structure("Request", [("scene", pointer), ("instances", pointer), ("count", size), ("options", pointer), ("outputs", u32), ("reserved", u32)])
Rays = structure("Rays", [("count", size), *((n, Floats) for n in "origins dirs t_min t_max random".split()), ("axis", pointer), ("target", pointer)])

def call(name, *arguments):
    message = c.create_string_buffer(256)
    if getattr(library, name)(*arguments, message, size(256)):
        sys.exit(message.value.decode())

scene, worker, needed, align = pointer(), pointer(), size(), size()
call("nerf_scene_open_file", path.encode(), None, c.byref(scene))
request = Request(scene=scene, outputs=1 | 2 | 4)
call("nerf_worker_size", c.byref(request), c.byref(needed), c.byref(align))
home = np.empty(needed.value + align.value, np.uint8)
call("nerf_worker_open", c.byref(request), pointer(-(-home.ctypes.data // align.value) * align.value), needed, c.byref(worker))
rays = np.zeros(side * side, [("origin", "3f4"), ("dir", "3f4"), ("rgb", "3f4"), ("opacity", "f4"), ("distance", "f4")])
x, y = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side - 0.5])
rays["origin"], rays["dir"] = [0, -4, 0.4], np.stack([x, 1.2 + 0 * x, -y - 0.15], -1).reshape(-1, 3)
rays["dir"] /= np.linalg.norm(rays["dir"], axis=1, keepdims=True)
at, step = (lambda field: rays.ctypes.data + rays.dtype.fields[field][1]), rays.itemsize
target = Target(rgb=Plane(at("rgb"), step, 0, 2), opacity=Plane(at("opacity"), step, 0, 5), ray_distance=Plane(at("distance"), step, 0, 5))
call("nerf_render_rays", worker, c.byref(Rays(count=len(rays), origins=Floats(at("origin"), step), dirs=Floats(at("dir"), step), target=c.addressof(target))), None)
np.save(out, rays.reshape(side, side))
