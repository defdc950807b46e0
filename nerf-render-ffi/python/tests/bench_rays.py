"""16,384 rays from numpy against the same call in C, by turns: bench_rays.py SCENE [ROUNDS]

Times of one thread are those that the processor gave it, the fewest of all, so that what else runs changes them little.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import nerf_render as nerf
import numpy as np

HERE = Path(__file__).resolve().parent


def compile_into(folder):
    """rays.c, linked with the package's own library."""
    program, library = folder / "rays", Path(nerf.__file__).parent
    command = ["cc", "-std=gnu11", "-O2", "-I", HERE.parents[2] / "include", HERE / "rays.c", "-o", program]
    subprocess.run([*command, library / "libnerf_render.so", f"-Wl,-rpath,{library}"], check=True)
    return program


def in_c(program, scene, records, folder, repeats=1):
    """Seconds, and what `[n, 6]` rays see: `[n, 3]` colour, `[n]` opacity and ray_distance."""
    records.tofile(folder / "rays.bin")
    command = [program, scene, folder / "rays.bin", folder / "seen.bin", str(repeats)]
    seconds = float(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    seen, n = np.fromfile(folder / "seen.bin", np.float32), len(records)
    return seconds, (seen[: 3 * n].reshape(n, 3), seen[3 * n : 4 * n], seen[4 * n :])


def main(path, rounds=15):
    scene, side = nerf.Scene(path), 128
    info = scene.info
    centre = 0.5 * (np.array(info["box_min"]) + info["box_max"])
    c2w = nerf.look_at(centre + [0.0, -0.5 * (info["near_distance"] + info["far_distance"]), 0.3], centre)
    x, y = np.meshgrid(*2 * [(np.arange(side) + 0.5) / side - 0.5])
    dirs = (np.stack([x, -y, np.full_like(x, -1.4)], -1) @ c2w[:, :3].T.astype(float)).reshape(-1, 3)
    records = np.empty((side * side, 6), np.float32)
    records[:, :3], records[:, 3:] = c2w[:, 3], dirs / np.linalg.norm(dirs, axis=1, keepdims=True)
    n = len(records)
    out = {"rgb": np.empty((n, 3), "f4"), "opacity": np.empty(n, "f4"), "ray_distance": np.empty(n, "f4")}
    clocks = {"numpy": (1, time.thread_time), "numpy, all cores, wall": (None, time.perf_counter)}
    fewest = dict.fromkeys(["C", *clocks], float("inf"))
    with tempfile.TemporaryDirectory() as folder:
        program = compile_into(Path(folder))
        for _ in range(rounds):
            took, seen = in_c(program, path, records, Path(folder), 3)
            fewest["C"] = min(fewest["C"], took)
            for name, (threads, clock) in clocks.items():
                for _ in range(3):
                    start = clock()
                    scene.rays(records[:, :3], records[:, 3:], out=out, threads=threads)
                    fewest[name] = min(fewest[name], clock() - start)
                assert all(map(np.array_equal, seen, out.values())), "the bits are others"
    for name, took in fewest.items():
        print(f"{name}: {1e3 * took:.2f} ms")
    print(f"numpy / C: {fewest['numpy'] / fewest['C']:.3f}; the same bits")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
