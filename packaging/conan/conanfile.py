"""The libraries for Conan 2, from the tree that this lies in: conan create packaging/conan --build=missing"""

import os

from conan import ConanFile
from conan.tools.cmake import CMake, CMakeDeps, CMakeToolchain, cmake_layout
from conan.tools.files import copy, load


class Iclk(ConanFile):
    name = "iclk"
    description = "Six-degree-of-freedom image alignment with sparse depth in Vulkan compute"
    license = "MIT"
    package_type = "static-library"
    settings = "os", "arch", "compiler", "build_type"
    options = {"system": [True, False]}
    default_options = {"system": False}  # True: Eigen, Ceres, glslang and the Vulkan headers of the machine

    def set_version(self):
        root = os.path.join(self.recipe_folder, "..", "..")
        text = load(self, os.path.join(root, "CMakeLists.txt"))
        self.version = text.split("project(iclk VERSION ")[1].split()[0]

    def export_sources(self):
        root = os.path.join(self.recipe_folder, "..", "..")
        rooms = ("engine", "align", "depth", "refine", "session", "rig", "track", "render", "locate", "shaders")
        for room in ("CMakeLists.txt", "LICENSE", "cmake", "include", "models", *rooms):
            pattern = room if os.path.isfile(os.path.join(root, room)) else f"{room}/*"
            copy(self, pattern, root, self.export_sources_folder)

    def requirements(self):
        if self.options.system:
            return
        self.requires("eigen/3.4.0", transitive_headers=True)
        self.requires("ceres-solver/2.1.0", transitive_headers=True)
        self.requires("vulkan-headers/1.3.239.0", transitive_headers=True)

    def build_requirements(self):
        if not self.options.system:
            self.tool_requires("glslang/1.3.239.0")

    def layout(self):
        cmake_layout(self)

    def generate(self):
        toolchain = CMakeToolchain(self)
        for option in ("ICLK_BUILD_APPS", "ICLK_BUILD_TESTS", "ICLK_BUILD_PYTHON"):
            toolchain.cache_variables[option] = False
        toolchain.cache_variables["ICLK_INSTALL"] = True
        toolchain.generate()
        CMakeDeps(self).generate()

    def build(self):
        cmake = CMake(self)
        cmake.configure()
        cmake.build()

    def package(self):
        CMake(self).install()
        copy(self, "LICENSE", self.source_folder, os.path.join(self.package_folder, "licenses"))

    def package_info(self):
        self.cpp_info.builddirs = ["lib/cmake/iclk"]  # the project's own iclkConfig.cmake is what finds it
        self.cpp_info.set_property("cmake_find_mode", "none")
