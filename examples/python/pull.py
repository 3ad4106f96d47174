"""An organ, held at its back, is pulled at its tip: force over way. Written to be run cell by cell, or as a program.

python3 pull.py [ORGAN.vtk [SCALE]]
"""

# %% An organ from a file, or a generated one
import sys

import softbody as sb

mesh = sb.Mesh.load(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 1.0) if len(sys.argv) > 1 else sb.Mesh.organ(10)
nodes = [tuple(node) for node in mesh.nodes]
depth = [node[1] for node in nodes]
low, high = min(depth), max(depth)
print("%d nodes, %d elements" % (len(nodes), len(mesh.elements)))

# %% Held at its back third; the frontmost node is what a grasper holds
body = sb.Body(mesh, sb.corotated(8000, 0.45, 1060), tolerance=1e-5)
body.hold([y > high - (high - low) / 3 for y in depth])
tip = depth.index(low)

# %% 30 mm in three seconds
way, force = [], []
for frame in range(181):
    pulled = 0.030 * frame / 180
    x, y, z = nodes[tip]
    body.place([tip], [(x, y - pulled, z)])
    body.step(1 / 60)
    way.append(1e3 * pulled)
    force.append(-body.reactions[tip][1])
print("pulled by %.0f mm it takes %.2f N" % (way[-1], force[-1]))

# %% A picture, where matplotlib is there; a table where it is not
try:
    import matplotlib

    matplotlib.use("Agg" if not hasattr(sys, "ps1") else matplotlib.get_backend())
    import matplotlib.pyplot as plot

    plot.plot(way, force)
    plot.xlabel("way (mm)")
    plot.ylabel("force (N)")
    plot.savefig("pull.png", dpi=120)
    print("pull.png is written")
except ImportError:
    for mm, newton in list(zip(way, force))[::30]:
        print("%5.1f mm %7.3f N %s" % (mm, newton, "#" * int(40 * newton / max(force))))
mesh.save_vtk("pulled.vtk", displacement=body.displacements, von_mises=body.von_mises())
print("pulled.vtk is written")
