"""The programs of this folder against the package: `conan create nerf-render-ffi` builds and runs them."""
import os

from conan import ConanFile
from conan.tools.build import can_run
from conan.tools.cmake import CMake, cmake_layout


class Outside(ConanFile):
    settings = "os", "arch", "compiler", "build_type"
    generators = "CMakeToolchain", "CMakeDeps"

    def requirements(self):
        self.requires(self.tested_reference_str)

    def layout(self):
        cmake_layout(self)

    def build(self):
        cmake = CMake(self)
        cmake.configure()
        cmake.build()

    def test(self):
        scene = os.path.join(self.recipe_folder, "../../nerf-core/examples/firmware/scene.nerf")
        if can_run(self):
            for program in ["c_shared", "c_static", "cpp_shared", "cpp_static"]:
                self.run(f'"{os.path.join(self.cpp.build.bindir, program)}" < "{scene}" > {program}.rgb', env="conanrun")
                assert os.path.getsize(f"{program}.rgb") == 3 * 37 * 29
