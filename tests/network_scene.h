/* network_scene.h: weights files made in memory, and networks computed by loops straight from their definitions. */
#ifndef NETWORK_SCENE_H
#define NETWORK_SCENE_H

#include "check.h"
#include "softbody.h"

enum { NETWORK_LAYERS = 24, NETWORK_HEAD = 48, NETWORK_LAYER = 24 };

typedef struct network_layer {
    int kind, kernel, from, inputs, outputs, activation;
    float *weights; /* [kernel^3][inputs][outputs], then [outputs] */
    size_t weight_count;
} network_layer;

typedef struct network_file {
    int counts[3], inputs, layer_count;
    float reals[5]; /* spacing, length, Poisson's ratio */
    network_layer layers[NETWORK_LAYERS];
    unsigned char *bytes;
    size_t size;
} network_file;

static inline void network_put(unsigned char *to, unsigned long word)
{
    for (int i = 0; i < 4; i++)
        to[i] = (unsigned char)(word >> (8 * i) & 0xFF);
}

static inline void network_put_float(unsigned char *to, float value)
{
    unsigned int word;
    memcpy(&word, &value, sizeof word);
    network_put(to, word);
}

/* The checksum of all bytes but the last four, which hold it: bit by bit, as RFC 1952 defines it. */
static inline void network_seal(unsigned char *bytes, size_t size)
{
    unsigned long crc = 0xFFFFFFFFUL;
    for (size_t i = 0; i + 4 < size; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1 ? crc >> 1 ^ 0xEDB88320UL : crc >> 1;
    }
    network_put(bytes + size - 4, crc ^ 0xFFFFFFFFUL);
}

static inline network_file network_begin(int nx, int ny, int nz, int inputs)
{
    network_file file;
    memset(&file, 0, sizeof file);
    file.counts[0] = nx, file.counts[1] = ny, file.counts[2] = nz;
    file.inputs = inputs;
    file.reals[0] = file.reals[1] = file.reals[2] = 0.01f;
    file.reals[3] = 0.1f;
    file.reals[4] = 0.45f;
    return file;
}

static inline int network_channels(const network_file *file)
{
    return file->layer_count ? file->layers[file->layer_count - 1].outputs : file->inputs;
}

/* Adds a layer with random weights of about this size; returns its number. */
static inline int network_add(network_file *file, int kind, int kernel, int from, int outputs, int activation,
                              double size, unsigned long long *random)
{
    network_layer *layer = &file->layers[file->layer_count];
    layer->kind = kind, layer->kernel = kernel, layer->from = from;
    layer->inputs = network_channels(file);
    layer->outputs = outputs, layer->activation = activation;
    if (kind == SB_LAYER_CONVOLUTION || kind == SB_LAYER_UPSAMPLE) {
        layer->weight_count = (size_t)(kernel * kernel * kernel * layer->inputs + 1) * (size_t)outputs;
        layer->weights = (float *)malloc(layer->weight_count * sizeof(float));
        for (size_t i = 0; i < layer->weight_count; i++)
            layer->weights[i] = (float)check_random_in(random, -size, size);
    }
    return file->layer_count++;
}

/* The bytes of the file. */
static inline void network_end(network_file *file)
{
    unsigned char *at;
    file->size = NETWORK_HEAD + NETWORK_LAYER * (size_t)file->layer_count + 4;
    for (int l = 0; l < file->layer_count; l++)
        file->size += 4 * file->layers[l].weight_count;
    file->bytes = (unsigned char *)malloc(file->size);
    memcpy(file->bytes, "SBNET001", 8);
    for (int k = 0; k < 3; k++)
        network_put(file->bytes + 8 + 4 * k, (unsigned long)file->counts[k]);
    network_put(file->bytes + 20, (unsigned long)file->inputs);
    for (int k = 0; k < 5; k++)
        network_put_float(file->bytes + 24 + 4 * k, file->reals[k]);
    network_put(file->bytes + 44, (unsigned long)file->layer_count);
    at = file->bytes + NETWORK_HEAD;
    for (int l = 0; l < file->layer_count; l++, at += NETWORK_LAYER) {
        const network_layer *layer = &file->layers[l];
        const int words[6] = {layer->kind,   layer->kernel,  layer->from,
                              layer->inputs, layer->outputs, layer->activation};
        for (int k = 0; k < 6; k++)
            network_put(at + 4 * k, (unsigned long)words[k]);
    }
    for (int l = 0; l < file->layer_count; l++)
        for (size_t i = 0; i < file->layers[l].weight_count; i++, at += 4)
            network_put_float(at, file->layers[l].weights[i]);
    network_seal(file->bytes, file->size);
}

static inline void network_file_free(network_file *file)
{
    for (int l = 0; l < file->layer_count; l++)
        free(file->layers[l].weights);
    free(file->bytes);
    memset(file, 0, sizeof *file);
}

/* U-Net of the thesis: at each of `levels` two convolutions and pooling, two in the middle, and back with what was
 * pooled joined behind. */
static inline network_file network_unet(const int counts[3], int levels, int inputs, int channels, double size,
                                        unsigned long long seed)
{
    network_file file = network_begin(counts[0], counts[1], counts[2], inputs);
    int skips[4], width = channels;
    for (int level = 0; level < levels; level++, width *= 2) {
        network_add(&file, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU, size, &seed);
        skips[level] = network_add(&file, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU, size, &seed);
        network_add(&file, SB_LAYER_POOL, 2, 0, width, SB_ACTIVATION_NONE, 0, &seed);
    }
    network_add(&file, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU, size, &seed);
    for (int level = levels - 1; level >= 0; level--) {
        width /= 2;
        network_add(&file, SB_LAYER_UPSAMPLE, 2, 0, width, SB_ACTIVATION_NONE, size, &seed);
        network_add(&file, SB_LAYER_JOIN, 0, skips[level], width + file.layers[skips[level]].outputs,
                    SB_ACTIVATION_NONE, 0, &seed);
        network_add(&file, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU, size, &seed);
    }
    network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, 3, SB_ACTIVATION_NONE, size, &seed);
    network_end(&file);
    return file;
}

/* ---- by definition, in double ---- */

typedef struct network_tensor {
    int counts[3], channels;
    double *data; /* [z][y][x][channel] */
} network_tensor;

static inline network_tensor network_tensor_make(const int counts[3], int channels)
{
    network_tensor t;
    memcpy(t.counts, counts, sizeof t.counts);
    t.channels = channels;
    t.data =
        (double *)calloc((size_t)counts[0] * (size_t)counts[1] * (size_t)counts[2] * (size_t)channels, sizeof(double));
    return t;
}

static inline double *network_at(const network_tensor *t, int x, int y, int z)
{
    return t->data +
           (((size_t)z * (size_t)t->counts[1] + (size_t)y) * (size_t)t->counts[0] + (size_t)x) * (size_t)t->channels;
}

static inline int network_inside(const network_tensor *t, int x, int y, int z)
{
    return x >= 0 && y >= 0 && z >= 0 && x < t->counts[0] && y < t->counts[1] && z < t->counts[2];
}

/* sum over the inputs of w in. */
static inline double network_dot(const network_layer *layer, int tap, const double *in, int out)
{
    double sum = 0;
    for (int c = 0; c < layer->inputs; c++)
        sum += in[c] *
               (double)layer
                   ->weights[((size_t)tap * (size_t)layer->inputs + (size_t)c) * (size_t)layer->outputs + (size_t)out];
    return sum;
}

/* One number of a layer's output. */
static inline double network_number(const network_layer *layer, const network_tensor *in, const network_tensor *joined,
                                    int x, int y, int z, int c)
{
    int k = layer->kernel;
    double sum;
    if (layer->kind == SB_LAYER_JOIN)
        return c < in->channels ? network_at(in, x, y, z)[c] : network_at(joined, x, y, z)[c - in->channels];
    if (layer->kind == SB_LAYER_POOL) {
        sum = network_at(in, 2 * x, 2 * y, 2 * z)[c];
        for (int i = 1; i < 8; i++)
            sum = fmax(sum, network_at(in, 2 * x + i % 2, 2 * y + i / 2 % 2, 2 * z + i / 4)[c]);
        return sum;
    }
    sum = (double)layer->weights[layer->weight_count - (size_t)layer->outputs + (size_t)c];
    if (layer->kind == SB_LAYER_UPSAMPLE)
        sum += network_dot(layer, 4 * (z % 2) + 2 * (y % 2) + x % 2, network_at(in, x / 2, y / 2, z / 2), c);
    else
        for (int t = 0; t < k * k * k; t++) {
            int p = x + t % k - k / 2, q = y + t / k % k - k / 2, r = z + t / (k * k) - k / 2;
            sum += network_inside(in, p, q, r) ? network_dot(layer, t, network_at(in, p, q, r), c) : 0;
        }
    return layer->activation == SB_ACTIVATION_RELU && sum < 0 ? 0 : sum;
}

static inline network_tensor network_layer_by_definition(const network_layer *layer, const network_tensor *in,
                                                         const network_tensor *joined)
{
    int counts[3];
    network_tensor out;
    for (int k = 0; k < 3; k++)
        counts[k] = layer->kind == SB_LAYER_POOL       ? in->counts[k] / 2
                    : layer->kind == SB_LAYER_UPSAMPLE ? 2 * in->counts[k]
                                                       : in->counts[k];
    out = network_tensor_make(counts, layer->outputs);
    for (int z = 0; z < counts[2]; z++)
        for (int y = 0; y < counts[1]; y++)
            for (int x = 0; x < counts[0]; x++)
                for (int c = 0; c < layer->outputs; c++)
                    network_at(&out, x, y, z)[c] = network_number(layer, in, joined, x, y, z, c);
    return out;
}

static inline size_t network_nodes(const network_file *file)
{
    return (size_t)file->counts[0] * (size_t)file->counts[1] * (size_t)file->counts[2];
}

/* The answer, to be freed. */
static inline double *network_by_definition(const network_file *file, const float *input)
{
    network_tensor in = network_tensor_make(file->counts, file->inputs), outs[NETWORK_LAYERS];
    double *answer;
    memset(outs, 0, sizeof outs);
    for (size_t i = 0; i < network_nodes(file) * (size_t)file->inputs; i++)
        in.data[i] = (double)input[i];
    for (int l = 0; l < file->layer_count; l++)
        outs[l] = network_layer_by_definition(&file->layers[l], l ? &outs[l - 1] : &in, &outs[file->layers[l].from]);
    answer = outs[file->layer_count - 1].data;
    for (int l = 0; l + 1 < file->layer_count; l++)
        free(outs[l].data);
    free(in.data);
    return answer;
}

#endif /* NETWORK_SCENE_H */
