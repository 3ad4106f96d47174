"""What the Python package promises. check.py SIZES HASH: sizes of the structs and the hash of native.c, as C prints them."""
import ctypes
import sys

import softbody as sb

sizes = dict(line.split() for line in open(sys.argv[1]))
wrong = [name for name, size in sizes.items() if ctypes.sizeof(getattr(sb.api, name)) != int(size)]
assert len(sizes) > 100 and not wrong, wrong

mesh = sb.Mesh.organ()
body = sb.Body(mesh, sb.corotated(8000, 0.45, 1060), gravity=(0, 0, -9.81))
body.hold([0, 7, 100])
moment, positions = body.save(), body.positions
lowest = min(row[2] for row in positions)
for frame in range(10):
    info = body.step(1 / 60)
    assert info.pcg_iterations > 0 and not info.capped
assert body.hash() == int(sys.argv[2]), "other bits than in C"
assert min(row[2] for row in positions) < lowest, "the array is not the library's memory"
assert abs(sum(row[2] for row in body.reactions)) > 0 and max(body.von_mises()) > 0
body.restore(moment)
assert min(row[2] for row in positions) == lowest
nodes, elements = len(mesh.nodes), mesh.elements
assert len(elements[0]) == 4 and 0 <= min(elements[0]) <= max(elements[0]) < nodes

highest = max(y for _, y, _ in mesh.nodes)
mask = [y > highest / 2 for _, y, _ in mesh.nodes]
body.hold(mask)
assert sum(1 for i in range(nodes) if sb.lib.sb_body_supports(body.raw)[i] == sb.XYZ) >= sum(mask) > 0
body.place([5], [(0, 0, 0.2)])
body.release([5])

mesh.save_vtk("organ.vtk", displacement=body.displacements, von_mises=body.von_mises())
assert len(sb.Mesh.load("organ.vtk", scale=2).nodes) == nodes


def refused(call, result, words):
    try:
        call()
    except sb.Error as error:
        assert error.result == result and words in str(error), error
        return error
    raise AssertionError("not refused: " + words)


assert refused(lambda: sb.Mesh.load("nowhere.vtk"), sb.api.SB_ERROR_FILE, "SB_ERROR_FILE").file == "nowhere.vtk"
refused(lambda: body.hold([nodes]), sb.api.SB_ERROR_INDEX, "SB_ERROR_INDEX")
refused(lambda: body.step(-1), sb.api.SB_ERROR_ARGUMENT, "SB_ERROR_ARGUMENT")
refused(lambda: sb.Body(mesh, sb.corotated(-1, 0.45, 1060)), sb.api.SB_ERROR_MATERIAL, "SB_ERROR_MATERIAL")
held = body.positions
del body, mesh
assert len(held) == nodes and held[0][0] == held[0][0], "the array outlives the body's name"
assert "sb_body_step" in sb.api.DOCUMENTATION
print("fine", "with numpy" if sb.numpy else "without numpy")
