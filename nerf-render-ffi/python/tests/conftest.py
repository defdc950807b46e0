"""The scene is the file that NERF_SCENE names. Tests of the program need the wheel's, those of C a compiler."""

import os
import shutil
import sysconfig
from pathlib import Path

import bench_rays
import nerf_render as nerf
import numpy as np
import pytest


@pytest.fixture(scope="session")
def path():
    return Path(os.environ["NERF_SCENE"]).resolve()


@pytest.fixture
def scene(path):
    with nerf.Scene(path) as scene:
        yield scene


@pytest.fixture
def rays(scene):
    """2,500 rays of a camera, `[50, 50, 3]` each: origins and directions, which the scene is seen along."""
    records = bench_rays.camera_rays(scene, 50)
    return np.ascontiguousarray(records[..., :3]), np.ascontiguousarray(records[..., 3:])


@pytest.fixture(scope="session")
def program():
    found = shutil.which("nerf-train", path=sysconfig.get_path("scripts"))
    if found is None:
        pytest.skip("nerf-train is not installed beside this Python")
    return found
