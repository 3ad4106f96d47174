#!/usr/bin/env python3
"""The pictures of docs/gallery.md: make gallery runs the example programs that it names and shrinks what they draw.

gallery.py PROGRAMS: the folder of the programs. Needs Pillow."""
import pathlib
import re
import subprocess
import sys
import tempfile

from PIL import Image

SIZE, COLOURS = (640, 480), 224
HERE = pathlib.Path(__file__).parent


def draw(programs, command, picture):
    """Runs `command` in a folder of its own; its picture goes to `picture`."""
    with tempfile.TemporaryDirectory() as folder:
        program, *arguments = command.split()
        print(command, flush=True)
        subprocess.run([programs / program, *arguments, "-o", "out"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        drawn = Image.open(pathlib.Path(folder) / "out.png").convert("RGB").resize(SIZE, Image.LANCZOS)
        drawn.quantize(COLOURS).save(picture, optimize=True)


def main():
    programs = pathlib.Path(sys.argv[1]).resolve()
    page = (HERE / "gallery.md").read_text()
    for picture, command in re.findall(r"!\[[^]]*\]\((gallery/[^)]*)\)\s+`build/([^`]*)`", page):
        (HERE / picture).parent.mkdir(exist_ok=True)
        draw(programs, command, HERE / picture)


if __name__ == "__main__":
    main()
