"""Adds what Cargo built to the wheel: the files of the folder `NERF_WHEEL_FILES`, for the platform `NERF_WHEEL_PLATFORM`."""

import os
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Built(BuildHookInterface):
    def initialize(self, version, build_data):
        build_data["pure_python"] = False
        build_data["tag"] = "py3-none-" + os.environ["NERF_WHEEL_PLATFORM"]
        for path in sorted(Path(os.environ["NERF_WHEEL_FILES"]).resolve().iterdir()):
            if path.name == "nerf-train":
                build_data["shared_scripts"][str(path)] = path.name
            else:
                folder = "nerf_render" if path.suffix == ".so" else "nerf_render/licenses"
                build_data["force_include"][str(path)] = f"{folder}/{path.name}"
