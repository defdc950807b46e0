"""The scene is the file that NERF_SCENE names. Tests of the program need the wheel, those of C a compiler."""

import os
import shutil
import sysconfig
from pathlib import Path

import nerf_render as nerf
import numpy as np
import pytest


@pytest.fixture(scope="session")
def path():
    return Path(os.environ["NERF_SCENE"])


@pytest.fixture
def scene(path):
    with nerf.Scene(path) as scene:
        yield scene


@pytest.fixture(scope="session")
def rays(path):
    """2,500 rays of a camera at the start, `[50, 50, 3]`: origins and directions."""
    info = nerf.Scene(path).info
    centre = 0.5 * (np.array(info["box_min"]) + info["box_max"])
    c2w = nerf.look_at(centre + [0.0, -0.5 * (info["near_distance"] + info["far_distance"]), 0.3], centre)
    x, y = np.meshgrid(*2 * [(np.arange(50) + 0.5) / 50 - 0.5])
    dirs = np.stack([x, -y, np.full_like(x, -1.2)], -1) @ c2w[:, :3].T.astype(float)
    dirs /= np.linalg.norm(dirs, axis=-1, keepdims=True)
    return np.broadcast_to(c2w[:, 3], dirs.shape).copy(), dirs.astype(np.float32)


@pytest.fixture(scope="session")
def program():
    found = shutil.which("nerf-train", path=sysconfig.get_path("scripts"))
    if found is None:
        pytest.skip("nerf-train is not installed beside this Python")
    return found


@pytest.fixture(scope="session")
def compiled_rays(tmp_path_factory):
    """rays.c, linked with the package's own library."""
    import bench_rays

    if shutil.which("cc") is None:
        pytest.skip("no cc")
    return bench_rays.compile_into(tmp_path_factory.mktemp("c"))
