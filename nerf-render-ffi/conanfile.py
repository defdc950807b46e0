"""conan create nerf-render-ffi: builds with CMake and cargo (Rust 1.89 or newer), and a C and a C++ program against it."""
import os

from conan import ConanFile
from conan.tools.cmake import CMake, CMakeToolchain, cmake_layout
from conan.tools.files import copy, load


class NerfRender(ConanFile):
    name = "nerf_render"
    description = "Renders radiance fields from C and C++"
    license = "MIT OR Apache-2.0"
    settings = "os", "arch", "compiler", "build_type"
    test_package_folder = "../tests/outside"

    def set_version(self):
        config = load(self, os.path.join(self.recipe_folder, "cmake/nerf_renderConfigVersion.cmake"))
        self.version = config.split("PACKAGE_VERSION ")[1].split(")")[0]

    def export_sources(self):
        workspace = os.path.dirname(self.recipe_folder)
        for pattern in ["Cargo.*", "LICENSE*", "include/*", "nerf-core/*", "nerf-render-ffi/*", "nerf-train/*", "tests/*"]:
            copy(self, pattern, workspace, self.export_sources_folder, excludes=["*/target/*", "*/node_modules/*"])

    def layout(self):
        cmake_layout(self, src_folder=".")

    def generate(self):
        CMakeToolchain(self).generate()

    def build(self):
        cmake = CMake(self)
        cmake.configure(build_script_folder="nerf-render-ffi")
        cmake.build()

    def package(self):
        copy(self, "LICENSE*", self.source_folder, os.path.join(self.package_folder, "licenses"))
        CMake(self).install()

    def package_info(self):
        # The package's own CMake files, which have a target for each of the two libraries.
        self.cpp_info.set_property("cmake_find_mode", "none")
        self.cpp_info.builddirs = ["share/cmake/nerf_render"]
        self.cpp_info.set_property("pkg_config_name", "nerf_render")
        self.cpp_info.libs = ["nerf_render"]
        self.cpp_info.system_libs = ["pthread", "dl", "m"] if self.settings.os == "Linux" else []
