/* network_train.h: trains the networks that softbody.h runs (sb_network). Needs softbody.h, libc and libm only.
 *
 *     train_network n;
 *     train_begin(&n, counts, SB_NETWORK_CHANNELS);
 *     train_add_unet(&n, 3, 8);                         levels, channels of the first
 *     if (!train_allocate(&n, seed))                    weights of chance, the same for the same seed
 *         ...
 *     for (int step = 0; step < steps; step++) {
 *         train_forward(&n, input);
 *         loss = train_measure(&n, target, mask);       and its slope
 *         train_backward(&n);                           adds to the gradient; so do more samples
 *         train_adam(&n, train_cosine(1e-3, step, steps), 1);
 *     }
 *     train_save(&n, "liver.sbnet");
 *     train_free(&n);
 *
 * Sums have one order: the same data and seed give the same weights, bit for bit, on one machine and compiler. Numbers
 * are floats; tests define TRAIN_REAL as double. Source: Kingma and Ba 2015 (Adam); Loshchilov and Hutter 2017
 * (cosine).
 */
#ifndef NETWORK_TRAIN_H
#define NETWORK_TRAIN_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softbody.h"

#ifndef TRAIN_REAL
#define TRAIN_REAL float
#endif
typedef TRAIN_REAL train_real;

enum { TRAIN_LAYERS = 64 };

typedef struct train_layer {
    int kind, kernel, from, inputs, outputs, activation;
    int counts[3];                /* of the output */
    size_t weights, weight_count; /* place of [taps][inputs][outputs] and [outputs] among all */
    train_real *out, *slope;      /* [z][y][x][outputs] and the loss's slope by it */
} train_layer;

typedef struct train_network {
    int counts[3], inputs, layer_count, steps;
    double spacing[3], length, poisson; /* written into the file; default 1, 1, 1, 1 and 0.45 */
    train_layer layers[TRAIN_LAYERS];
    size_t weight_count;
    train_real *weights, *gradient, *mean, *square; /* the last two are Adam's */
    train_real *turned;                             /* [inputs][outputs] of one tap */
    const train_real *input;
} train_network;

/* ---- making ---- */

static inline size_t train_nodes(const int counts[3])
{
    return (size_t)counts[0] * (size_t)counts[1] * (size_t)counts[2];
}

static inline void train_begin(train_network *n, const int counts[3], int inputs)
{
    memset(n, 0, sizeof *n);
    memcpy(n->counts, counts, sizeof n->counts);
    n->inputs = inputs;
    n->spacing[0] = n->spacing[1] = n->spacing[2] = n->length = 1;
    n->poisson = 0.45;
}

/* Adds a layer; returns its number. The caller sees to it that layers fit one another, at most TRAIN_LAYERS. */
static inline int train_add(train_network *n, int kind, int kernel, int from, int outputs, int activation)
{
    train_layer *layer = &n->layers[n->layer_count];
    const train_layer *before = n->layer_count ? layer - 1 : NULL;
    layer->kind = kind, layer->kernel = kernel, layer->from = from;
    layer->inputs = before ? before->outputs : n->inputs;
    layer->outputs = outputs, layer->activation = activation;
    for (int k = 0; k < 3; k++) {
        int side = before ? before->counts[k] : n->counts[k];
        layer->counts[k] = kind == SB_LAYER_POOL ? side / 2 : kind == SB_LAYER_UPSAMPLE ? 2 * side : side;
    }
    if (kind == SB_LAYER_CONVOLUTION || kind == SB_LAYER_UPSAMPLE)
        layer->weight_count = (size_t)(kernel * kernel * kernel * layer->inputs + 1) * (size_t)outputs;
    layer->weights = n->weight_count;
    n->weight_count += layer->weight_count;
    return n->layer_count++;
}

/* U-Net of Brunet 2020, section 5.6: two convolutions and a pooling on each level, two at the bottom, and back. */
static inline void train_add_unet(train_network *n, int levels, int channels)
{
    int skips[8], width = channels;
    for (int level = 0; level < levels; level++, width *= 2) {
        train_add(n, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU);
        skips[level] = train_add(n, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU);
        train_add(n, SB_LAYER_POOL, 2, 0, width, SB_ACTIVATION_NONE);
    }
    train_add(n, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU);
    train_add(n, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU);
    for (int level = levels - 1; level >= 0; level--) {
        width /= 2;
        train_add(n, SB_LAYER_UPSAMPLE, 2, 0, width, SB_ACTIVATION_NONE);
        train_add(n, SB_LAYER_JOIN, 0, skips[level], 2 * width, SB_ACTIVATION_NONE);
        train_add(n, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU);
        train_add(n, SB_LAYER_CONVOLUTION, 3, 0, width, SB_ACTIVATION_RELU);
    }
    train_add(n, SB_LAYER_CONVOLUTION, 1, 0, 3, SB_ACTIVATION_NONE);
}

static inline void train_free(train_network *n)
{
    for (int l = 0; l < n->layer_count; l++) {
        free(n->layers[l].out);
        free(n->layers[l].slope);
    }
    free(n->weights), free(n->turned);
    memset(n, 0, sizeof *n);
}

/* Evenly in [0, 1): xorshift64*. */
static inline double train_random(uint64_t *state)
{
    uint64_t x = *state;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    *state = x;
    return (double)((x * 2685821657736338717u) >> 11) / 9007199254740992.0;
}

/* Weights even in +-sqrt(6 / inputs) (He et al. 2015), biases 0. */
static inline void train_shake(train_network *n, uint64_t seed)
{
    seed = seed * 2 + 1; /* not 0 */
    for (int l = 0; l < n->layer_count; l++) {
        const train_layer *layer = &n->layers[l];
        size_t biases = (size_t)layer->outputs;
        double size = layer->weight_count ? sqrt(6.0 * layer->outputs / (double)(layer->weight_count - biases)) : 0;
        for (size_t i = 0; i + biases < layer->weight_count; i++)
            n->weights[layer->weights + i] = (train_real)(size * (2 * train_random(&seed) - 1));
    }
}

/* Memory and weights of chance; 0: no memory, and nothing is held. */
static inline int train_allocate(train_network *n, uint64_t seed)
{
    int good = 1;
    size_t largest = 1; /* of the taps */
    n->weights = (train_real *)calloc(n->weight_count, 4 * sizeof(train_real));
    for (int l = 0; l < n->layer_count; l++) {
        train_layer *layer = &n->layers[l];
        size_t count = train_nodes(layer->counts) * (size_t)layer->outputs;
        layer->out = (train_real *)calloc(count, sizeof(train_real));
        layer->slope = (train_real *)calloc(count, sizeof(train_real));
        good = good && layer->out && layer->slope;
        count = (size_t)layer->inputs * (size_t)layer->outputs;
        largest = largest < count ? count : largest;
    }
    n->turned = (train_real *)malloc(largest * sizeof(train_real));
    if (!good || !n->weights || !n->turned) {
        train_free(n);
        return 0;
    }
    n->gradient = n->weights + n->weight_count;
    n->mean = n->gradient + n->weight_count;
    n->square = n->mean + n->weight_count;
    train_shake(n, seed);
    return 1;
}

/* ---- products: the sums that all layers with weights are made of ---- */

/* Numbers of a vector, where the compiler has them. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
#if defined(__AVX__)
enum { TRAIN_LANES = 32 / sizeof(train_real) };
#else
enum { TRAIN_LANES = 16 / sizeof(train_real) };
#endif
typedef train_real train_lanes
    __attribute__((vector_size(TRAIN_LANES * sizeof(train_real)), aligned(sizeof(train_real)), may_alias));
#define TRAIN_INLINE static inline __attribute__((always_inline))
#else
enum { TRAIN_LANES = 1 };
typedef train_real train_lanes;
#define TRAIN_INLINE static inline
#endif
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define TRAIN_EACH_ROW(r, rows) _Pragma("GCC unroll 8") for (size_t r = 0; r < (rows); r++)
#else
#define TRAIN_EACH_ROW(r, rows) for (size_t r = 0; r < (rows); r++)
#endif

/* out[rows][columns] += a[rows][terms] b[terms][columns]; columns lie side by side in out and b. */
typedef struct train_product {
    const train_real *a, *b;
    train_real *out;
    size_t rows, terms, columns;
    size_t a_row, a_term, b_term, out_row; /* from one to the next */
} train_product;

/* One vector of columns of so many rows, a literal: their sums stay in registers. */
TRAIN_INLINE void train_tile(const train_product *p, size_t row, size_t column, size_t rows)
{
    const train_real *a = p->a + row * p->a_row, *b = p->b + column;
    train_real *out = p->out + row * p->out_row + column;
    size_t a_row = p->a_row, out_row = p->out_row;
    train_lanes sums[8];
    TRAIN_EACH_ROW(r, rows)
    sums[r] = *(const train_lanes *)(const void *)(out + r * out_row);
    for (size_t k = 0; k < p->terms; k++, a += p->a_term, b += p->b_term) {
        train_lanes factors = *(const train_lanes *)(const void *)b;
        TRAIN_EACH_ROW(r, rows)
        sums[r] += factors * a[r * a_row];
    }
    TRAIN_EACH_ROW(r, rows)
    *(train_lanes *)(void *)(out + r * out_row) = sums[r];
}

/* Columns that fill no vector. */
static inline void train_rest(const train_product *p, size_t row, size_t column)
{
    for (; column < p->columns; column++) {
        train_real sum = p->out[row * p->out_row + column];
        for (size_t k = 0; k < p->terms; k++)
            sum += p->a[row * p->a_row + k * p->a_term] * p->b[k * p->b_term + column];
        p->out[row * p->out_row + column] = sum;
    }
}

static inline void train_multiply(const train_product *p)
{
    size_t whole = p->columns / TRAIN_LANES * TRAIN_LANES;
    for (size_t row = 0, rows; row < p->rows; row += rows) {
        size_t left = p->rows - row;
        rows = left >= 8 ? 8 : left >= 4 ? 4 : left >= 2 ? 2 : 1;
        for (size_t column = 0; column < whole; column += TRAIN_LANES)
            switch (rows) {
            case 8: train_tile(p, row, column, 8); break;
            case 4: train_tile(p, row, column, 4); break;
            case 2: train_tile(p, row, column, 2); break;
            default: train_tile(p, row, column, 1); break;
            }
        for (size_t r = 0; r < rows; r++)
            train_rest(p, row + r, whole);
    }
}

/* ---- taps ---- */

/* The nodes that a tap of the kernel joins: rows along x of the input's lattice and the output's. */
typedef struct train_tap {
    size_t counts[3], step;         /* nodes; from one to the next in the output, 1 in the input */
    size_t in[3], out[3];           /* the first of each */
    size_t in_side[2], out_side[2]; /* nodes of the lattices along x and y */
} train_tap;

static inline train_tap train_tap_of(const train_layer *layer, const int sides[3], int number)
{
    const int k = layer->kernel, taps[3] = {number % k, number / k % k, number / (k * k)};
    train_tap tap;
    tap.step = layer->kind == SB_LAYER_UPSAMPLE ? 2 : 1;
    for (int axis = 0; axis < 3; axis++) {
        int shift = layer->kind == SB_LAYER_UPSAMPLE ? 0 : taps[axis] - k / 2, beyond = shift < 0 ? -shift : shift;
        tap.counts[axis] = (size_t)(sides[axis] > beyond ? sides[axis] - beyond : 0);
        tap.in[axis] = (size_t)(shift > 0 ? shift : 0);
        tap.out[axis] = (size_t)(layer->kind == SB_LAYER_UPSAMPLE ? taps[axis] : shift < 0 ? -shift : 0);
    }
    for (int axis = 0; axis < 2; axis++) {
        tap.in_side[axis] = (size_t)sides[axis];
        tap.out_side[axis] = (size_t)layer->counts[axis];
    }
    return tap;
}

static inline size_t train_tap_rows(const train_tap *tap)
{
    return tap->counts[0] ? tap->counts[1] * tap->counts[2] : 0;
}

/* The first nodes of a row. */
static inline void train_tap_row(const train_tap *tap, size_t row, size_t *in, size_t *out)
{
    size_t y = row % tap->counts[1], z = row / tap->counts[1];
    *in = ((tap->in[2] + z) * tap->in_side[1] + tap->in[1] + y) * tap->in_side[0] + tap->in[0];
    *out = ((tap->out[2] + z * tap->step) * tap->out_side[1] + tap->out[1] + y * tap->step) * tap->out_side[0] +
           tap->out[0];
}

/* ---- forward ---- */

typedef struct train_view {
    const train_real *in;
    train_real *slope; /* NULL: of the network's input */
    const int *counts;
} train_view;

static inline train_view train_into(const train_network *n, int l)
{
    train_view view;
    view.in = l ? n->layers[l - 1].out : n->input;
    view.slope = l ? n->layers[l - 1].slope : NULL;
    view.counts = l ? n->layers[l - 1].counts : n->counts;
    return view;
}

static inline void train_place(const int counts[3], size_t node, int at[3])
{
    at[0] = (int)(node % (size_t)counts[0]);
    at[1] = (int)(node / (size_t)counts[0] % (size_t)counts[1]);
    at[2] = (int)(node / ((size_t)counts[0] * (size_t)counts[1]));
}

static inline void train_forward_tap(const train_layer *layer, train_view from, int number, const train_real *w)
{
    train_tap tap = train_tap_of(layer, from.counts, number);
    size_t inputs = (size_t)layer->inputs, outputs = (size_t)layer->outputs;
    train_product p = {NULL, w, NULL, tap.counts[0], inputs, outputs, inputs, 1, outputs, tap.step * outputs};
    for (size_t row = 0; row < train_tap_rows(&tap); row++) {
        size_t in, out;
        train_tap_row(&tap, row, &in, &out);
        p.a = from.in + in * inputs;
        p.out = layer->out + out * outputs;
        train_multiply(&p);
    }
}

static inline void train_forward_weights(const train_network *n, const train_layer *layer, train_view from)
{
    int taps = layer->kernel * layer->kernel * layer->kernel;
    size_t nodes = train_nodes(layer->counts), outputs = (size_t)layer->outputs;
    const train_real *w = n->weights + layer->weights, *bias = w + layer->weight_count - outputs;
    for (size_t i = 0; i < nodes; i++)
        memcpy(layer->out + i * outputs, bias, outputs * sizeof *bias);
    for (int t = 0; t < taps; t++)
        train_forward_tap(layer, from, t, w + (size_t)(t * layer->inputs) * outputs);
    if (layer->activation == SB_ACTIVATION_RELU)
        for (size_t i = 0; i < nodes * outputs; i++)
            layer->out[i] = layer->out[i] < 0 ? 0 : layer->out[i];
}

/* The first of the eight that has the largest number: as sb_network has it, and where the slope goes. */
static inline size_t train_largest(const train_layer *layer, train_view from, size_t i, int c)
{
    size_t best = 0;
    int at[3];
    train_place(layer->counts, i, at);
    for (int k = 0; k < 8; k++) {
        size_t x = (size_t)(2 * at[0] + k % 2), y = (size_t)(2 * at[1] + k / 2 % 2), z = (size_t)(2 * at[2] + k / 4);
        size_t node =
            ((z * (size_t)from.counts[1] + y) * (size_t)from.counts[0] + x) * (size_t)layer->inputs + (size_t)c;
        if (k == 0 || from.in[node] > from.in[best])
            best = node;
    }
    return best;
}

static inline void train_forward_layer(const train_network *n, int l)
{
    const train_layer *layer = &n->layers[l], *joined = &n->layers[layer->from];
    train_view from = train_into(n, l);
    size_t nodes = train_nodes(layer->counts), in = (size_t)layer->inputs, out = (size_t)layer->outputs;
    if (layer->kind == SB_LAYER_CONVOLUTION || layer->kind == SB_LAYER_UPSAMPLE)
        train_forward_weights(n, layer, from);
    for (size_t i = 0; i < nodes; i++) {
        for (int c = 0; layer->kind == SB_LAYER_POOL && c < layer->outputs; c++)
            layer->out[i * out + (size_t)c] = from.in[train_largest(layer, from, i, c)];
        if (layer->kind == SB_LAYER_JOIN) {
            memcpy(layer->out + i * out, from.in + i * in, in * sizeof(train_real));
            memcpy(layer->out + i * out + in, joined->out + i * (out - in), (out - in) * sizeof(train_real));
        }
    }
}

/* The answer to input[z][y][x][inputs], which is used until the backward pass is done. */
static inline const train_real *train_forward(train_network *n, const train_real *input)
{
    n->input = input;
    for (int l = 0; l < n->layer_count; l++)
        train_forward_layer(n, l);
    return n->layers[n->layer_count - 1].out;
}

/* ---- backward ---- */

/* Slopes by what is before the activation, and their sums by the biases. */
static inline void train_backward_bias(const train_layer *layer, train_real *by_bias)
{
    size_t outputs = (size_t)layer->outputs;
    for (size_t i = 0; i < train_nodes(layer->counts); i++) {
        train_real *slope = layer->slope + i * outputs;
        const train_real *out = layer->out + i * outputs;
        for (size_t o = 0; o < outputs; o++) {
            if (layer->activation == SB_ACTIVATION_RELU && !(out[o] > 0))
                slope[o] = 0;
            by_bias[o] += slope[o];
        }
    }
}

/* Slopes by the weights of a tap, and by the input, for which weights are turned to [outputs][inputs]. */
static inline void train_backward_tap(const train_layer *layer, train_view from, int number, const train_real *turned,
                                      train_real *by_w)
{
    train_tap tap = train_tap_of(layer, from.counts, number);
    size_t inputs = (size_t)layer->inputs, outputs = (size_t)layer->outputs, step = tap.step * outputs;
    train_product by_weights = {NULL, NULL, by_w, inputs, tap.counts[0], outputs, 1, inputs, step, outputs};
    train_product by_input = {NULL, turned, NULL, tap.counts[0], outputs, inputs, step, 1, inputs, inputs};
    for (size_t row = 0; row < train_tap_rows(&tap); row++) {
        size_t in, out;
        train_tap_row(&tap, row, &in, &out);
        by_weights.a = from.in + in * inputs;
        by_weights.b = by_input.a = layer->slope + out * outputs;
        train_multiply(&by_weights);
        if (!from.slope)
            continue;
        by_input.out = from.slope + in * inputs;
        train_multiply(&by_input);
    }
}

static inline void train_turn(const train_real *w, int inputs, int outputs, train_real *turned)
{
    for (int c = 0; c < inputs; c++)
        for (int o = 0; o < outputs; o++)
            turned[o * inputs + c] = w[c * outputs + o];
}

static inline void train_backward_weights(const train_network *n, const train_layer *layer, train_view from)
{
    int taps = layer->kernel * layer->kernel * layer->kernel;
    size_t tap = (size_t)layer->inputs * (size_t)layer->outputs;
    const train_real *w = n->weights + layer->weights;
    train_real *by_w = n->gradient + layer->weights;
    train_backward_bias(layer, by_w + layer->weight_count - (size_t)layer->outputs);
    for (int t = 0; t < taps; t++) {
        if (from.slope)
            train_turn(w + (size_t)t * tap, layer->inputs, layer->outputs, n->turned);
        train_backward_tap(layer, from, t, n->turned, by_w + (size_t)t * tap);
    }
}

static inline void train_backward_layer(const train_network *n, int l)
{
    const train_layer *layer = &n->layers[l], *joined = &n->layers[layer->from];
    train_view from = train_into(n, l);
    size_t in = (size_t)layer->inputs, out = (size_t)layer->outputs;
    if (layer->kind == SB_LAYER_CONVOLUTION || layer->kind == SB_LAYER_UPSAMPLE) {
        train_backward_weights(n, layer, from);
        return;
    }
    for (size_t i = 0; i < train_nodes(layer->counts); i++)
        for (size_t c = 0; c < out; c++) {
            train_real slope = layer->slope[i * out + c];
            if (layer->kind == SB_LAYER_JOIN && c >= in)
                joined->slope[i * (out - in) + c - in] += slope;
            else if (from.slope)
                from.slope[layer->kind == SB_LAYER_POOL ? train_largest(layer, from, i, (int)c) : i * in + c] += slope;
        }
}

/* Mean squared error of the answer over the nodes that the mask [nodes] counts (0 or 1), summed in double; and its
 * slope for train_backward. */
static inline double train_measure(const train_network *n, const train_real *target, const unsigned char *mask)
{
    const train_layer *last = &n->layers[n->layer_count - 1];
    size_t nodes = train_nodes(last->counts), outputs = (size_t)last->outputs, count = 0;
    double sum = 0;
    for (size_t i = 0; i < nodes; i++)
        count += mask[i] ? outputs : 0;
    for (size_t i = 0; i < nodes * outputs; i++) {
        double off = mask[i / outputs] ? (double)last->out[i] - (double)target[i] : 0;
        sum += off * off;
        last->slope[i] = (train_real)(2 * off / (double)count);
    }
    return sum / (double)count;
}

/* Adds the loss's slope by the weights to the gradient. */
static inline void train_backward(train_network *n)
{
    for (int l = 0; l + 1 < n->layer_count; l++)
        memset(n->layers[l].slope, 0,
               train_nodes(n->layers[l].counts) * (size_t)n->layers[l].outputs * sizeof(train_real));
    for (int l = n->layer_count - 1; l >= 0; l--)
        train_backward_layer(n, l);
}

/* ---- steps ---- */

/* Rate of a step: from `rate` to 0 along half a cosine, after steps / 50 steps of warm-up, without which ReLUs die. */
static inline double train_cosine(double rate, int step, int steps)
{
    double warm = steps / 50.0;
    double share = step < warm ? (step + 1) / (warm + 1) : 1;
    return share * rate * 0.5 * (1 + cos(3.14159265358979323846 * step / steps));
}

/* A step against the mean gradient of `samples`, which is 0 afterwards. */
static inline void train_adam(train_network *n, double rate, int samples)
{
    const double a = 0.9, b = 0.999, least = 1e-8;
    double first, second;
    n->steps++;
    first = 1 / (1 - pow(a, n->steps));
    second = 1 / (1 - pow(b, n->steps));
    for (size_t i = 0; i < n->weight_count; i++) {
        double g = (double)n->gradient[i] / samples;
        n->mean[i] = (train_real)(a * (double)n->mean[i] + (1 - a) * g);
        n->square[i] = (train_real)(b * (double)n->square[i] + (1 - b) * g * g);
        n->weights[i] -=
            (train_real)(rate * first * (double)n->mean[i] / (sqrt(second * (double)n->square[i]) + least));
        n->gradient[i] = 0;
    }
}

/* ---- the weights file: see network.h in softbody.h ---- */

typedef struct train_file {
    sb_output out;
    uint32_t crc;
} train_file;

static inline void train_put(train_file *f, const void *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        f->crc ^= ((const unsigned char *)bytes)[i];
        for (int bit = 0; bit < 8; bit++)
            f->crc = f->crc & 1 ? f->crc >> 1 ^ 0xEDB88320u : f->crc >> 1;
    }
    fwrite(bytes, 1, size, f->out.file);
}

static inline void train_put_word(train_file *f, uint32_t word)
{
    unsigned char bytes[4];
    for (int i = 0; i < 4; i++)
        bytes[i] = (unsigned char)(word >> (8 * i) & 0xFF);
    train_put(f, bytes, 4);
}

static inline void train_put_float(train_file *f, double value)
{
    float single = (float)value;
    uint32_t word;
    memcpy(&word, &single, sizeof word);
    train_put_word(f, word);
}

/* 1, or 0 when the file cannot be written: then a file that was there stays as it was. */
static inline int train_save(const train_network *n, const char *path)
{
    train_file f;
    f.crc = 0xFFFFFFFFu;
    if (sb_output_open(&f.out, path, NULL))
        return 0;
    train_put(&f, "SBNET001", 8);
    for (int k = 0; k < 3; k++)
        train_put_word(&f, (uint32_t)n->counts[k]);
    train_put_word(&f, (uint32_t)n->inputs);
    for (int k = 0; k < 3; k++)
        train_put_float(&f, n->spacing[k]);
    train_put_float(&f, n->length);
    train_put_float(&f, n->poisson);
    train_put_word(&f, (uint32_t)n->layer_count);
    for (int l = 0; l < n->layer_count; l++) {
        const train_layer *layer = &n->layers[l];
        const int words[6] = {layer->kind,   layer->kernel,  layer->from,
                              layer->inputs, layer->outputs, layer->activation};
        for (int k = 0; k < 6; k++)
            train_put_word(&f, (uint32_t)words[k]);
    }
    for (size_t i = 0; i < n->weight_count; i++)
        train_put_float(&f, (double)n->weights[i]);
    train_put_word(&f, f.crc ^ 0xFFFFFFFFu);
    return sb_output_close(&f.out, NULL) == SB_OK;
}

#endif /* NETWORK_TRAIN_H */
