"""The headers as a Conan 2 package:  conan create ."""
import os
import re

from conan import ConanFile
from conan.tools.files import copy, load


class Softbody(ConanFile):
    name = "softbody"
    description = "Soft tissue, needles and registration, each in a single C header"
    license = "MIT OR Unlicense"
    topics = ("physics", "simulation", "finite-elements", "surgery", "header-only")
    package_type = "header-library"
    settings = "os"
    exports_sources = "softbody.h", "needle.h", "register.h", "LICENSE"
    no_copy_source = True

    def set_version(self):
        header = load(self, os.path.join(self.recipe_folder, "softbody.h"))
        self.version = re.search(r'#define SB_VERSION_STRING "(.*)"', header).group(1)

    def package_id(self):
        self.info.clear()

    def package(self):
        copy(self, "LICENSE", self.source_folder, os.path.join(self.package_folder, "licenses"))
        copy(self, "*.h", self.source_folder, os.path.join(self.package_folder, "include", "softbody"))

    def package_info(self):
        self.cpp_info.bindirs = self.cpp_info.libdirs = []
        self.cpp_info.includedirs = [os.path.join("include", "softbody")]
        self.cpp_info.set_property("cmake_target_name", "softbody::softbody")
        if self.settings.get_safe("os") in ("Linux", "FreeBSD"):
            self.cpp_info.system_libs = ["m"]
