"""Writes networks that were trained elsewhere as weights files that sb_network_load takes.

    import umesh_export as export

    export.write("liver.sbnet", nodes=(32, 8, 8), spacing=(0.004, 0.004, 0.004), length=0.124, poisson=0.45, inputs=6,
                 layers=[
        export.convolution(model.first.weight, model.first.bias, relu=True),     # 0: torch.nn.Conv3d(6, 8, 3, padding=1)
        export.pool(),                                                           # 1: torch.nn.MaxPool3d(2)
        export.convolution(model.deep.weight, model.deep.bias, relu=True),       # 2
        export.upsample(model.up.weight, model.up.bias),                         # 3: ConvTranspose3d(16, 8, 2, stride=2)
        export.join(0),                                                          # 4: torch.cat((x, out of layer 0), 1)
        export.convolution(model.last.weight, model.last.bias)])                 # 5: Conv3d(16, 3, 1)

Weights are those of PyTorch: Conv3d [out][in][z][y][x], ConvTranspose3d [in][out][z][y][x]; tensors, arrays or lists. A
tensor of a network is [batch][channel][z][y][x] there and [z][y][x][channel] here. nodes, spacing (m) and the rest:
see sb_network_shape. The format stands in softbody.h at sb_network. Mistakes raise ValueError before a byte is written.
"""
import struct
import zlib

CONVOLUTION, POOL, UPSAMPLE, JOIN = 1, 2, 3, 4


def _lists(numbers):
    """Nested lists of a tensor, an array or lists."""
    for name in ("detach", "cpu", "tolist"):
        if hasattr(numbers, name):
            numbers = getattr(numbers, name)()
    return numbers


def _layer(kind, weight, bias, relu):
    """Weights by taps, z slowest, then by channels in and out."""
    weight, bias = _lists(weight), _lists(bias)
    kernel = len(weight[0][0])
    inputs, outputs = (len(weight[0]), len(weight)) if kind == CONVOLUTION else (len(weight), len(weight[0]))
    if kernel not in ((1, 3) if kind == CONVOLUTION else (2,)) or len(bias) != outputs:
        raise ValueError(f"a layer of kind {kind} has a kernel of {kernel} and {len(bias)} biases for {outputs} channels")
    taps = range(kernel)
    numbers = [weight[o][i][z][y][x] if kind == CONVOLUTION else weight[i][o][z][y][x]
               for z in taps for y in taps for x in taps for i in range(inputs) for o in range(outputs)]
    return kind, kernel, 0, inputs, outputs, int(relu), numbers + list(bias)


def convolution(weight, bias, relu=False):
    """torch.nn.Conv3d with a kernel of 3 and padding 1, or of 1; relu: what follows it."""
    return _layer(CONVOLUTION, weight, bias, relu)


def upsample(weight, bias, relu=False):
    """torch.nn.ConvTranspose3d with a kernel and a stride of 2."""
    return _layer(UPSAMPLE, weight, bias, relu)


def pool():
    """torch.nn.MaxPool3d(2)."""
    return POOL, 2, 0, None, None, 0, []


def join(layer):
    """torch.cat((input, output of that layer), 1); layers are counted from 0."""
    return JOIN, 0, layer, None, None, 0, []


def _chain(inputs, layers):
    """Fills in the channels that follow from what is before a layer."""
    outputs = []
    for at, (kind, kernel, source, has, gives, activation, numbers) in enumerate(layers):
        channels = outputs[-1] if outputs else inputs
        if has not in (None, channels):
            raise ValueError(f"layer {at} takes {has} channels of {channels}")
        if kind == JOIN and not 0 <= source < at:
            raise ValueError(f"layer {at} joins layer {source}, which is not before it")
        gives = channels + outputs[source] if kind == JOIN else channels if gives is None else gives
        outputs.append(gives)
        yield (kind, kernel, source, channels, gives, activation), numbers


def write(path, nodes, spacing, length, poisson, inputs, layers):
    """Writes the file; ValueError where layers do not fit one another."""
    chain = list(_chain(inputs, layers))
    data = b"SBNET001" + struct.pack("<4I5fI", *nodes, inputs, *spacing, length, poisson, len(chain))
    data += b"".join(struct.pack("<6I", *words) for words, _ in chain)
    data += b"".join(struct.pack(f"<{len(numbers)}f", *numbers) for _, numbers in chain)
    with open(path, "wb") as file:
        file.write(data + struct.pack("<I", zlib.crc32(data)))
