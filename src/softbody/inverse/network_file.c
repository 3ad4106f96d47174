/* network_file: weights files, which may hold anything. */
#include <string.h>

#include "../base/bytes.h"
#include "network_private.h"

static const char sbi_network_magic[8] = {'S', 'B', 'N', 'E', 'T', '0', '0', '1'};

static uint32_t sbi_network_word(const unsigned char *bytes, size_t at)
{
    return (uint32_t)sbi_get_bytes(bytes + at, 4);
}

static float sbi_network_float(const unsigned char *bytes, size_t at)
{
    uint32_t word = sbi_network_word(bytes, at);
    float value;
    memcpy(&value, &word, sizeof value);
    return value;
}

/* A number in [low, high] as an int; 0: it is none. */
static int sbi_network_number(const unsigned char *bytes, size_t at, uint32_t low, uint32_t high, int *number)
{
    uint32_t word = sbi_network_word(bytes, at);
    if (word < low || word > high)
        return 0;
    *number = (int)word;
    return 1;
}

/* ---- head ---- */

/* Floats from node to node, row to row, plane to plane. */
static void sbi_tensor_measure(sbi_tensor *tensor)
{
    tensor->node = (size_t)sbi_network_padded(tensor->channels);
    tensor->row = ((size_t)tensor->counts[0] + 2) * tensor->node;
    tensor->plane = ((size_t)tensor->counts[1] + 2) * tensor->row;
}

static sb_result sbi_network_check_whole(const unsigned char *bytes, size_t size, sb_error *error)
{
    if (size < SBI_NETWORK_HEAD + SBI_NETWORK_LAYER + 4)
        return sbi_fail(error, SB_ERROR_FORMAT, "%lu bytes are too few for a weights file", (unsigned long)size);
    if (memcmp(bytes, sbi_network_magic, sizeof sbi_network_magic) != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "these are not the bytes of a weights file");
    if (sbi_network_word(bytes, size - 4) != sbi_crc32(bytes, size - 4))
        return sbi_fail(error, SB_ERROR_FORMAT, "the weights file is damaged or cut off: its checksum differs");
    return SB_OK;
}

static sb_result sbi_network_read_shape(const unsigned char *bytes, sb_network_shape *shape, sb_error *error)
{
    float reals[5];
    for (size_t axis = 0; axis < 3; axis++)
        if (!sbi_network_number(bytes, 8 + 4 * axis, 1, SBI_NETWORK_SIDE, &shape->counts[axis]))
            return sbi_fail(error, SB_ERROR_FORMAT, "the lattice of the network must have sides of 1 to %d nodes",
                            (int)SBI_NETWORK_SIDE);
    if (!sbi_network_number(bytes, 20, 1, SBI_NETWORK_CHANNELS, &shape->inputs))
        return sbi_fail(error, SB_ERROR_FORMAT, "the network must have 1 to %d channels", (int)SBI_NETWORK_CHANNELS);
    for (size_t k = 0; k < 5; k++) {
        reals[k] = sbi_network_float(bytes, 24 + 4 * k);
        if (!isfinite(reals[k]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE,
                            "spacing, length or Poisson's ratio of the network is not finite");
    }
    if (!(reals[0] > 0 && reals[1] > 0 && reals[2] > 0 && reals[3] > 0 && reals[4] > -1 && reals[4] <= 0.5f))
        return sbi_fail(error, SB_ERROR_FORMAT,
                        "spacing and length of the network must be above 0, Poisson's ratio in (-1, 0.5]");
    shape->spacing = sb_v3((sb_real)reals[0], (sb_real)reals[1], (sb_real)reals[2]);
    shape->length = (sb_real)reals[3];
    shape->poisson = (sb_real)reals[4];
    if (!sbi_network_number(bytes, 44, 1, SBI_NETWORK_LAYERS, &shape->layers))
        return sbi_fail(error, SB_ERROR_FORMAT, "the network must have 1 to %d layers", (int)SBI_NETWORK_LAYERS);
    return SB_OK;
}

/* ---- layers ---- */

/* 1 when all sides of the output can be had from the input's. */
static int sbi_network_sides(sb_layer_kind kind, const int in[3], int out[3])
{
    for (int axis = 0; axis < 3; axis++) {
        out[axis] = kind == SB_LAYER_POOL ? in[axis] / 2 : kind == SB_LAYER_UPSAMPLE ? 2 * in[axis] : in[axis];
        if ((kind == SB_LAYER_POOL && in[axis] % 2 != 0) || out[axis] > SBI_NETWORK_SIDE)
            return 0;
    }
    return 1;
}

/* What is wrong with layer l, whose fields are of their ranges; NULL: nothing. */
static const char *sbi_network_layer_fault(const sbi_network_layer *layers, int l, const sbi_tensor *in)
{
    const sbi_network_layer *layer = layers + l;
    int has_weights = layer->kind == SB_LAYER_CONVOLUTION || layer->kind == SB_LAYER_UPSAMPLE;
    if (layer->inputs != in->channels)
        return "takes another number of channels than the layer before it gives";
    if (layer->kind == SB_LAYER_CONVOLUTION ? layer->kernel != 1 && layer->kernel != 3
                                            : layer->kernel != (layer->kind == SB_LAYER_JOIN ? 0 : 2))
        return "has a kernel that layers of its kind have not";
    if (!has_weights && layer->activation != SB_ACTIVATION_NONE)
        return "has an activation, which layers of its kind have not";
    if (layer->kind == SB_LAYER_POOL && layer->out.channels != layer->inputs)
        return "pools into another number of channels";
    if (layer->kind != SB_LAYER_JOIN)
        return layer->from == 0 ? NULL : "joins no layer, but names one";
    if (layer->from >= l)
        return "joins a layer that is not before it";
    if (memcmp(layers[layer->from].out.counts, in->counts, sizeof in->counts) != 0)
        return "joins a layer with other sides";
    return layer->out.channels == in->channels + layers[layer->from].out.channels
               ? NULL
               : "has not as many channels as both that it joins";
}

static sb_result sbi_network_read_layer(const unsigned char *bytes, int l, const sbi_tensor *in,
                                        sbi_network_layer *layers, sb_error *error)
{
    sbi_network_layer *layer = layers + l;
    size_t at = SBI_NETWORK_HEAD + SBI_NETWORK_LAYER * (size_t)l;
    int kind = 0, activation = 0;
    const char *fault;
    memset(layer, 0, sizeof *layer);
    if (!sbi_network_number(bytes, at, SB_LAYER_CONVOLUTION, SB_LAYER_JOIN, &kind) ||
        !sbi_network_number(bytes, at + 4, 0, 3, &layer->kernel) ||
        !sbi_network_number(bytes, at + 8, 0, SBI_NETWORK_LAYERS, &layer->from) ||
        !sbi_network_number(bytes, at + 12, 1, SBI_NETWORK_CHANNELS, &layer->inputs) ||
        !sbi_network_number(bytes, at + 16, 1, SBI_NETWORK_CHANNELS, &layer->out.channels) ||
        !sbi_network_number(bytes, at + 20, SB_ACTIVATION_NONE, SB_ACTIVATION_RELU, &activation))
        return sbi_fail(error, SB_ERROR_FORMAT, "layer %d of the network has a field out of range", l);
    layer->kind = (sb_layer_kind)kind;
    layer->activation = (sb_activation)activation;
    fault = sbi_network_layer_fault(layers, l, in);
    if (!fault && !sbi_network_sides(layer->kind, in->counts, layer->out.counts))
        fault = layer->kind == SB_LAYER_POOL ? "pools an odd number of nodes" : "has too many nodes along a side";
    if (fault)
        return sbi_fail(error, SB_ERROR_FORMAT, "layer %d of the network %s", l, fault);
    sbi_tensor_measure(&layer->out);
    return SB_OK;
}

/* Multiply-adds and bytes in the file of a layer; 0: a size that no file has. */
static int sbi_network_measure(const sbi_network_layer *layer, const sbi_tensor *in, sb_network_shape *shape,
                               size_t *file)
{
    size_t inputs = (size_t)sbi_network_taps(layer) * (size_t)layer->inputs, outputs = (size_t)layer->out.channels;
    const int *nodes = layer->kind == SB_LAYER_UPSAMPLE ? in->counts : layer->out.counts;
    shape->multiply_adds += (double)inputs * (double)outputs * nodes[0] * nodes[1] * nodes[2];
    return inputs == 0 || (sbi_size_add(file, inputs, 4 * outputs) && sbi_size_add(file, outputs, 4));
}

SBI_API sb_result sbi_network_read_head(const unsigned char *bytes, size_t size, sb_network_shape *shape,
                                        sbi_tensor *input, sbi_network_layer *layers, sb_error *error)
{
    sb_result result = sbi_network_check_whole(bytes, size, error);
    const sbi_tensor *in = input;
    size_t file;
    if (result == SB_OK)
        result = sbi_network_read_shape(bytes, shape, error);
    if (result != SB_OK)
        return result;
    file = SBI_NETWORK_HEAD + SBI_NETWORK_LAYER * (size_t)shape->layers + 4;
    if (file > size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the weights file ends within its layers");
    memcpy(input->counts, shape->counts, sizeof input->counts);
    input->channels = shape->inputs;
    sbi_tensor_measure(input);
    for (int l = 0; l < shape->layers; in = &layers[l++].out) {
        result = sbi_network_read_layer(bytes, l, in, layers, error);
        if (result != SB_OK)
            return result;
        if (!sbi_network_measure(layers + l, in, shape, &file))
            return sbi_fail(error, SB_ERROR_FORMAT, "layer %d of the network has more weights than any file", l);
    }
    if (file != size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the weights file has %lu bytes, its layers have %lu",
                        (unsigned long)size, (unsigned long)file);
    if (memcmp(in->counts, shape->counts, sizeof in->counts) != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "the network ends on another lattice than it begins with");
    shape->outputs = in->channels;
    return SB_OK;
}

/* ---- weights ---- */

/* From [tap][in][out] to vectors of channels. */
static void sbi_network_place(const sbi_network_layer *layer, const unsigned char *bytes)
{
    const size_t lanes = SBI_NETWORK_LANES;
    size_t inputs = (size_t)sbi_network_taps(layer) * (size_t)layer->inputs, outputs = (size_t)layer->out.channels;
    for (size_t i = 0; i < inputs; i++)
        for (size_t o = 0; o < outputs; o++)
            layer->weights[(o / lanes * inputs + i) * lanes + o % lanes] =
                sbi_network_float(bytes, 4 * (i * outputs + o));
    for (size_t o = 0; o < outputs; o++)
        layer->bias[o] = sbi_network_float(bytes, 4 * (inputs * outputs + o));
}

SBI_API sb_result sbi_network_read_weights(const unsigned char *bytes, sb_network *network, sb_error *error)
{
    const unsigned char *at = bytes + SBI_NETWORK_HEAD + SBI_NETWORK_LAYER * (size_t)network->shape.layers;
    for (int l = 0; l < network->shape.layers; l++) {
        const sbi_network_layer *layer = network->layers + l;
        size_t inputs = (size_t)sbi_network_taps(layer) * (size_t)layer->inputs;
        size_t count = inputs > 0 ? (inputs + 1) * (size_t)layer->out.channels : 0;
        for (size_t i = 0; i < count; i++)
            if (!isfinite(sbi_network_float(at, 4 * i)))
                return sbi_fail(error, SB_ERROR_NOT_FINITE, "weight %lu of layer %d of the network is not finite",
                                (unsigned long)i, l);
        if (count > 0)
            sbi_network_place(layer, at);
        at += 4 * count;
    }
    return SB_OK;
}
