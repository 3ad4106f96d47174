"""As much of Conan 2 as the recipe needs, for where it cannot be had."""
import os


class Settings:
    def get_safe(self, name):
        return "Linux" if name == "os" else None


class CppInfo:
    def __init__(self):
        self.properties = {}

    def set_property(self, name, value):
        self.properties[name] = value


class Info:
    def clear(self):
        self.cleared = True


class ConanFile:
    def __init__(self, recipe, package):
        self.recipe_folder = self.source_folder = os.path.dirname(os.path.abspath(recipe))
        self.package_folder = package
        self.settings, self.cpp_info, self.info = Settings(), CppInfo(), Info()
