"""Adds the files that Cargo built, from the folder `NERF_WHEEL_FILES`, to a wheel for `NERF_WHEEL_PLATFORM`."""

import os
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Built(BuildHookInterface):
    def initialize(self, version, build_data):
        build_data.update(pure_python=False, tag="py3-none-" + os.environ["NERF_WHEEL_PLATFORM"])
        for path in sorted(Path(os.environ["NERF_WHEEL_FILES"]).resolve().iterdir()):
            folder = "nerf_render" if path.suffix == ".so" else "nerf_render/licenses"
            kind, place = ("shared_scripts", "") if path.name == "nerf-train" else ("force_include", folder + "/")
            build_data[kind][str(path)] = place + path.name
