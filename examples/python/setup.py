"""Compiles the headers into a shared library beside the package: `pip wheel .` or `pip install .` in this folder, in a checkout."""
import os
import re
import subprocess
import sys

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
NAME = {"win32": "softbody.dll", "darwin": "libsoftbody.dylib"}.get(sys.platform, "libsoftbody.so")
UNIT = os.path.join(ROOT, "examples", "shared", "softbody.c")


class WithLibrary(build_py):
    def run(self):
        super().run()
        target = os.path.join(self.build_lib, "softbody", NAME)
        command = os.environ.get("CC", "cc").split() + ["-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden"]
        command += os.environ.get("CFLAGS", "").split()
        subprocess.run(command + ["-DSB_SHARED", "-I" + ROOT, UNIT, "-o", target, "-lm"], check=True)


class Platform(Distribution):
    def has_ext_modules(self):  # so that the wheel is named after its platform
        return True


with open(os.path.join(ROOT, "softbody.h"), encoding="utf-8") as header:
    VERSION = re.search(r'#define SB_VERSION_STRING "([^"]+)"', header.read()).group(1)
setup(version=VERSION, cmdclass={"build_py": WithLibrary}, distclass=Platform)
