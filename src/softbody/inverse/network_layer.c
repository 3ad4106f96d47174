/* network_layer: the layers' arithmetic. Each number out has one sum, in one order, whatever runs it. */
#include <string.h>

#include "network_private.h"

#if SBI_NETWORK_LANES > 1
typedef float sbi_channels __attribute__((vector_size(SBI_NETWORK_LANES * sizeof(float)), aligned(4), may_alias));
#else
typedef float sbi_channels;
#endif
#define SBI_CHANNELS_AT(pointer) (*(const sbi_channels *)(const void *)(pointer))
#define SBI_CHANNELS_PUT(pointer, value) (*(sbi_channels *)(void *)(pointer) = (value))

/* What a row of nodes is made by. */
typedef struct sbi_network_row {
    const float *in;
    float *out;
    const float *weights, *bias; /* of the vector of channels that is made */
    size_t in_step, out_step;    /* from node to node */
    size_t vector;               /* from the weights of one vector to those of the next */
    int inputs, taps;
    ptrdiff_t offsets[SBI_NETWORK_TAPS]; /* from the node to each tap's */
} sbi_network_row;

/* One vector of eight nodes from x on: as many sums as hide the time that an addition takes. */
static void sbi_network_eight(const sbi_network_row *row, size_t x)
{
    const float *w = row->weights;
    float *out = row->out + x * row->out_step;
    size_t step = row->in_step, to = row->out_step;
    sbi_channels s0 = SBI_CHANNELS_AT(row->bias), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0, s6 = s0, s7 = s0;
    for (int t = 0; t < row->taps; t++) {
        const float *in = row->in + (ptrdiff_t)(x * step) + row->offsets[t];
        for (int c = 0; c < row->inputs; c++, in++, w += SBI_NETWORK_LANES) {
            sbi_channels weights = SBI_CHANNELS_AT(w);
            s0 += weights * in[0];
            s1 += weights * in[step];
            s2 += weights * in[2 * step];
            s3 += weights * in[3 * step];
            s4 += weights * in[4 * step];
            s5 += weights * in[5 * step];
            s6 += weights * in[6 * step];
            s7 += weights * in[7 * step];
        }
    }
    SBI_CHANNELS_PUT(out, s0);
    SBI_CHANNELS_PUT(out + to, s1);
    SBI_CHANNELS_PUT(out + 2 * to, s2);
    SBI_CHANNELS_PUT(out + 3 * to, s3);
    SBI_CHANNELS_PUT(out + 4 * to, s4);
    SBI_CHANNELS_PUT(out + 5 * to, s5);
    SBI_CHANNELS_PUT(out + 6 * to, s6);
    SBI_CHANNELS_PUT(out + 7 * to, s7);
}

/* Two vectors of four nodes: what is spread over a vector serves both, which without AVX is an instruction less. */
static void sbi_network_four_pairs(const sbi_network_row *row, size_t x)
{
    const float *w = row->weights, *v = w + row->vector;
    float *out = row->out + x * row->out_step, *next = out + SBI_NETWORK_LANES;
    size_t step = row->in_step, to = row->out_step;
    sbi_channels s0 = SBI_CHANNELS_AT(row->bias), s1 = s0, s2 = s0, s3 = s0;
    sbi_channels r0 = SBI_CHANNELS_AT(row->bias + SBI_NETWORK_LANES), r1 = r0, r2 = r0, r3 = r0;
    for (int t = 0; t < row->taps; t++) {
        const float *in = row->in + (ptrdiff_t)(x * step) + row->offsets[t];
        for (int c = 0; c < row->inputs; c++, in++, w += SBI_NETWORK_LANES, v += SBI_NETWORK_LANES) {
            sbi_channels first = SBI_CHANNELS_AT(w), second = SBI_CHANNELS_AT(v);
            s0 += first * in[0];
            r0 += second * in[0];
            s1 += first * in[step];
            r1 += second * in[step];
            s2 += first * in[2 * step];
            r2 += second * in[2 * step];
            s3 += first * in[3 * step];
            r3 += second * in[3 * step];
        }
    }
    SBI_CHANNELS_PUT(out, s0);
    SBI_CHANNELS_PUT(out + to, s1);
    SBI_CHANNELS_PUT(out + 2 * to, s2);
    SBI_CHANNELS_PUT(out + 3 * to, s3);
    SBI_CHANNELS_PUT(next, r0);
    SBI_CHANNELS_PUT(next + to, r1);
    SBI_CHANNELS_PUT(next + 2 * to, r2);
    SBI_CHANNELS_PUT(next + 3 * to, r3);
}

/* One vector of one node. */
static void sbi_network_one(const sbi_network_row *row, size_t x)
{
    const float *w = row->weights;
    sbi_channels sum = SBI_CHANNELS_AT(row->bias);
    for (int t = 0; t < row->taps; t++) {
        const float *in = row->in + (ptrdiff_t)(x * row->in_step) + row->offsets[t];
        for (int c = 0; c < row->inputs; c++, w += SBI_NETWORK_LANES)
            sum += SBI_CHANNELS_AT(w) * in[c];
    }
    SBI_CHANNELS_PUT(row->out + x * row->out_step, sum);
}

/* A row of as many vectors as the answer says, of those that are left. Nodes that fill no group are made twice. */
static size_t sbi_network_fill_vectors(const sbi_network_row *row, size_t nodes, size_t left)
{
    size_t x = 0;
    if (left > 1 && nodes >= 4) {
        for (; x < nodes; x += 4)
            sbi_network_four_pairs(row, x + 4 <= nodes ? x : nodes - 4);
        return 2;
    }
    for (; nodes >= 8 && x < nodes; x += 8)
        sbi_network_eight(row, x + 8 <= nodes ? x : nodes - 8);
    for (; x < nodes; x++)
        sbi_network_one(row, x);
    return 1;
}

/* All channels, from the first vector on. */
static void sbi_network_fill_row(sbi_network_row row, size_t nodes, size_t channels)
{
    for (size_t left = channels / SBI_NETWORK_LANES, made; left > 0; left -= made) {
        made = sbi_network_fill_vectors(&row, nodes, left);
        row.out += made * SBI_NETWORK_LANES;
        row.bias += made * SBI_NETWORK_LANES;
        row.weights += made * row.vector;
    }
}

static void sbi_network_activate(const sbi_network_layer *layer, float *row)
{
    size_t floats = (size_t)layer->out.counts[0] * layer->out.node;
    if (layer->activation == SB_ACTIVATION_RELU)
        for (size_t i = 0; i < floats; i++)
            row[i] = row[i] < 0 ? 0 : row[i];
}

/* The taps that a node of the output sees: all of a convolution, centred. */
static void sbi_network_offsets(const sbi_network_layer *layer, const sbi_tensor *in, sbi_network_row *row)
{
    int k = layer->kernel, half = k / 2;
    row->taps = k * k * k;
    for (int t = 0; t < row->taps; t++)
        row->offsets[t] = (ptrdiff_t)in->plane * (t / (k * k) - half) + (ptrdiff_t)in->row * (t / k % k - half) +
                          (ptrdiff_t)in->node * (t % k - half);
}

static void sbi_network_convolve(const sbi_network_layer *layer, const sbi_tensor *in, size_t z)
{
    const sbi_tensor *out = &layer->out;
    sbi_network_row row;
    sbi_network_offsets(layer, in, &row);
    row.inputs = layer->inputs;
    row.in_step = in->node;
    row.out_step = out->node;
    row.vector = (size_t)(row.taps * row.inputs) * SBI_NETWORK_LANES;
    row.weights = layer->weights;
    row.bias = layer->bias;
    for (size_t y = 0; y < (size_t)out->counts[1]; y++) {
        row.out = out->data + z * out->plane + y * out->row;
        row.in = in->data + z * in->plane + y * in->row;
        sbi_network_fill_row(row, (size_t)out->counts[0], out->node);
        sbi_network_activate(layer, row.out);
    }
}

/* Each node of the output has one tap: that of its place in the pair along each axis. */
static void sbi_network_upsample(const sbi_network_layer *layer, const sbi_tensor *in, size_t z)
{
    const sbi_tensor *out = &layer->out;
    size_t tap = (size_t)layer->inputs * SBI_NETWORK_LANES;
    sbi_network_row row;
    row.taps = 1;
    row.offsets[0] = 0;
    row.inputs = layer->inputs;
    row.in_step = in->node;
    row.out_step = 2 * out->node;
    row.vector = 8 * tap;
    row.bias = layer->bias;
    for (size_t y = 0; y < (size_t)out->counts[1]; y++) {
        float *to = out->data + z * out->plane + y * out->row;
        row.in = in->data + z / 2 * in->plane + y / 2 * in->row;
        for (size_t x = 0; x < 2; x++) {
            row.out = to + x * out->node;
            row.weights = layer->weights + (4 * (z % 2) + 2 * (y % 2) + x) * tap;
            sbi_network_fill_row(row, (size_t)in->counts[0], out->node);
        }
        sbi_network_activate(layer, to);
    }
}

/* What is not a number stays, so that it is seen in the end. */
static void sbi_network_pool(const sbi_tensor *out, const sbi_tensor *in, size_t z)
{
    for (size_t y = 0; y < (size_t)out->counts[1]; y++)
        for (size_t x = 0; x < (size_t)out->counts[0]; x++) {
            float *to = out->data + z * out->plane + y * out->row + x * out->node;
            const float *from = in->data + 2 * (z * in->plane + y * in->row + x * in->node);
            for (size_t k = 0; k < 8; k++) {
                const float *at = from + k / 4 * in->plane + k / 2 % 2 * in->row + k % 2 * in->node;
                for (int c = 0; c < out->channels; c++)
                    to[c] = k == 0 || !(at[c] <= to[c]) ? at[c] : to[c];
            }
        }
}

static void sbi_network_join(const sbi_tensor *out, const sbi_tensor *first, const sbi_tensor *second, size_t z)
{
    size_t a = (size_t)first->channels, b = (size_t)second->channels;
    for (size_t y = 0; y < (size_t)out->counts[1]; y++)
        for (size_t x = 0; x < (size_t)out->counts[0]; x++) {
            float *to = out->data + z * out->plane + y * out->row + x * out->node;
            memcpy(to, first->data + z * first->plane + y * first->row + x * first->node, a * sizeof(float));
            memcpy(to + a, second->data + z * second->plane + y * second->row + x * second->node, b * sizeof(float));
        }
}

typedef struct sbi_network_task {
    const sbi_network_layer *layer;
    const sbi_tensor *in, *joined;
} sbi_network_task;

/* A plane of the output. */
static void sbi_network_plane(void *user, int z)
{
    const sbi_network_task *task = (const sbi_network_task *)user;
    const sbi_network_layer *layer = task->layer;
    switch (layer->kind) {
    case SB_LAYER_CONVOLUTION: sbi_network_convolve(layer, task->in, (size_t)z); break;
    case SB_LAYER_POOL: sbi_network_pool(&layer->out, task->in, (size_t)z); break;
    case SB_LAYER_UPSAMPLE: sbi_network_upsample(layer, task->in, (size_t)z); break;
    case SB_LAYER_JOIN: sbi_network_join(&layer->out, task->in, task->joined, (size_t)z); break;
    }
}

SBI_API void sbi_network_run_layer(const sb_network *network, int l)
{
    sbi_network_task task;
    task.layer = network->layers + l;
    task.in = sbi_network_into(network, l);
    task.joined = &network->layers[task.layer->from].out;
    sbi_run(&network->jobs, sbi_network_plane, &task, task.layer->out.counts[2]);
}
