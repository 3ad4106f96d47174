"""A U-Net with weights in PyTorch's order, computed from the definitions and by the library from what umesh_export writes."""
import ctypes
import random
import sys

import softbody as sb

sys.path.insert(0, sys.argv[1])
import umesh_export as export

chance = random.Random(5)
NODES = (6, 4, 2)  # x, y, z


def tensor(*sides):
    return [tensor(*sides[1:]) for _ in range(sides[0])] if sides else chance.uniform(-1, 1)


def sides(a):
    return range(len(a)), range(len(a[0])), range(len(a[0][0]))


def each(a, function):
    zs, ys, xs = sides(a)
    return [[[function(z, y, x) for x in xs] for y in ys] for z in zs]


def convolve(a, weight, bias, relu):
    reach = len(weight[0][0]) // 2
    taps = [(z, y, x) for z in range(2 * reach + 1) for y in range(2 * reach + 1) for x in range(2 * reach + 1)]

    def node(z, y, x):
        sums = list(bias)
        for tz, ty, tx in taps:
            k, j, i = z + tz - reach, y + ty - reach, x + tx - reach
            if 0 <= k < len(a) and 0 <= j < len(a[0]) and 0 <= i < len(a[0][0]):
                for o, row in enumerate(weight):
                    sums[o] += sum(row[c][tz][ty][tx] * value for c, value in enumerate(a[k][j][i]))
        return [max(0, value) for value in sums] if relu else sums

    return each(a, node)


def pool(a):
    half = [[[None] * (len(a[0][0]) // 2) for _ in range(len(a[0]) // 2)] for _ in range(len(a) // 2)]
    corners = [(z, y, x) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    return each(half, lambda z, y, x: [max(a[2 * z + k][2 * y + j][2 * x + i][c] for k, j, i in corners)
                                       for c in range(len(a[0][0][0]))])


def upsample(a, weight, bias):
    double = [[[None] * (2 * len(a[0][0])) for _ in range(2 * len(a[0]))] for _ in range(2 * len(a))]
    return each(double, lambda z, y, x: [bias[o] + sum(value * weight[c][o][z % 2][y % 2][x % 2] for c, value in
                                                       enumerate(a[z // 2][y // 2][x // 2])) for o in range(len(bias))])


first, deep, up, last = tensor(4, 3, 3, 3, 3), tensor(5, 4, 3, 3, 3), tensor(5, 4, 2, 2, 2), tensor(3, 8, 1, 1, 1)
biases = [tensor(4), tensor(5), tensor(4), tensor(3)]
given = [[[tensor(3) for _ in range(NODES[0])] for _ in range(NODES[1])] for _ in range(NODES[2])]
skip = convolve(given, first, biases[0], True)
back = upsample(convolve(pool(skip), deep, biases[1], True), up, biases[2])
wide = each(back, lambda z, y, x: back[z][y][x] + skip[z][y][x])
expected = convolve(wide, last, biases[3], False)

layers = [export.convolution(first, biases[0], relu=True), export.pool(), export.convolution(deep, biases[1], relu=True),
          export.upsample(up, biases[2]), export.join(0), export.convolution(last, biases[3])]
front = dict(nodes=NODES, spacing=(0.004, 0.004, 0.004), length=0.02, poisson=0.45, inputs=3)
export.write("net.sbnet", layers=layers, **front)
flat = [value for plane in given for row in plane for node in row for value in node]
network, error = ctypes.POINTER(sb.api.sb_network)(), sb.api.sb_error()
result = sb.lib.sb_network_load(b"net.sbnet", None, ctypes.byref(network), ctypes.byref(error))
assert result == 0, error.message
answer = (ctypes.c_float * len(flat))()
assert sb.lib.sb_network_run(network, (ctypes.c_float * len(flat))(*flat), answer) == 0
wanted = [value for plane in expected for row in plane for node in row for value in node]
worst = max(abs(a - b) for a, b in zip(answer, wanted)) / max(map(abs, wanted))
sb.lib.sb_network_destroy(network)
assert worst < 2e-6, worst

for layers, words in (([export.pool(), export.convolution(deep, biases[1])], "layer 1 takes 4 channels of 3"),
                      ([export.join(0)], "joins layer 0")):
    try:
        export.write("bad.sbnet", layers=layers, **front)
        raise AssertionError("not refused: " + words)
    except ValueError as fault:
        assert words in str(fault), fault
print(f"off by {worst:.1e} of the largest")
