import fnmatch
import os
import shutil


def load(_conanfile, path):
    with open(path) as file:
        return file.read()


def copy(_conanfile, pattern, source, destination):
    """Conan's patterns match in all folders; recipes see only what they export."""
    os.makedirs(destination, exist_ok=True)
    copied = [name for name in os.listdir(source) if fnmatch.fnmatch(name, pattern)]
    for name in copied:
        shutil.copy(os.path.join(source, name), destination)
    return copied
