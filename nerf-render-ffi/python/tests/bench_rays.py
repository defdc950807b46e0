"""16,384 rays from numpy against the same call in C, by turns: bench_rays.py SCENE [ROUNDS]

Times are those that the processor gave the one thread of each, so that what else runs changes them little.
"""

import ctypes
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import nerf_render as nerf
import numpy as np

HERE = Path(__file__).resolve().parent


def compiled(folder):
    """rays.c, linked with the package's own library: seconds, and `[n, 3]`, `[n]`, `[n]` of `[n, 6]` rays."""
    built, library = Path(folder, "rays.so"), Path(nerf.__file__).with_name("libnerf_render.so")
    command = ["cc", "-std=gnu11", "-O2", "-fPIC", "-shared", "-I", HERE.parents[2] / "include", HERE / "rays.c"]
    subprocess.run([*command, library, f"-Wl,-rpath,{library.parent}", "-o", built], check=True)
    function = ctypes.CDLL(str(built)).rays_in_c
    function.restype = ctypes.c_double
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]

    def rays_in_c(scene, records):
        n, seen = len(records), np.empty(5 * len(records), np.float32)
        seconds = function(scene._handle.pointer, records.ctypes.data, n, seen.ctypes.data)
        assert seconds >= 0.0
        return seconds, (seen[: 3 * n].reshape(n, 3), seen[3 * n : 4 * n], seen[4 * n :])

    return rays_in_c


def camera_rays(scene, side):
    """`[side, side, 6]`: origins and directions of a camera that sees the whole scene."""
    info = scene.info
    centre = 0.5 * (np.array(info["box_min"]) + info["box_max"])
    c2w = nerf.look_at(centre + [0.0, -0.5 * (info["near_distance"] + info["far_distance"]), 0.3], centre)
    x, y = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side - 0.5])
    dirs = np.stack([x, -y, np.full_like(x, -1.2)], -1) @ c2w[:, :3].T.astype(float)
    records = np.empty((side, side, 6), np.float32)
    records[..., :3], records[..., 3:] = c2w[:, 3], dirs / np.linalg.norm(dirs, axis=-1, keepdims=True)
    return records


def main(path, rounds=200):
    scene = nerf.Scene(path)
    records = camera_rays(scene, 128).reshape(-1, 6)
    n, ratios, seconds = len(records), [], {"C": [], "numpy": [], "numpy, all cores, wall": []}
    out = {"rgb": np.empty((n, 3), "f4"), "opacity": np.empty(n, "f4"), "ray_distance": np.empty(n, "f4")}
    with tempfile.TemporaryDirectory() as folder:
        rays_in_c = compiled(folder)
        for _ in range(rounds):
            took, seen = rays_in_c(scene, records)
            seconds["C"].append(took)
            for name, threads, clock in (("numpy", 1, time.thread_time), (list(seconds)[2], None, time.perf_counter)):
                start = clock()
                scene.rays(records[:, :3], records[:, 3:], out=out, threads=threads)
                seconds[name].append(clock() - start)
            assert all(map(np.array_equal, seen, out.values())), "the bits are others"
            ratios.append(seconds["numpy"][-1] / took)
    for name, times in seconds.items():
        print(f"{name}: median {1e3 * np.median(times):.2f} ms, fewest {1e3 * min(times):.2f} ms")
    fewest = min(seconds["numpy"]) / min(seconds["C"])
    print(f"numpy / C: median of {rounds} {np.median(ratios):.3f}, of the fewest {fewest:.3f}; the same bits")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
