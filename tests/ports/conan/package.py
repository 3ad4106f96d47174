"""package.py CONANFILE FOLDER: exports, makes the package and prints the compiler's flags."""
import importlib.util
import os
import shutil
import sys

recipe, folder = sys.argv[1:]
spec = importlib.util.spec_from_file_location("recipe", recipe)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
exported = os.path.join(folder, "exported")
os.makedirs(exported)
for name in module.Softbody.exports_sources:
    shutil.copy(os.path.join(os.path.dirname(os.path.abspath(recipe)), name), exported)
shutil.copy(recipe, exported)
package = module.Softbody(os.path.join(exported, "conanfile.py"), os.path.join(folder, "package"))
package.set_version()
package.package_id()
package.package()
package.package_info()
assert os.path.exists(os.path.join(package.package_folder, "licenses", "LICENSE"))
assert package.version and package.info.cleared and package.cpp_info.properties["cmake_target_name"] == "softbody::softbody"
flags = ["-I" + os.path.join(package.package_folder, path) for path in package.cpp_info.includedirs]
print(*flags, *("-l" + name for name in package.cpp_info.system_libs))
