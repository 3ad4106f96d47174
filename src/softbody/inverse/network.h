/* network: answers of a trained convolutional network on the lattice of a grid. Floor 4.
 *
 * A network maps numbers at the nodes of a regular lattice to numbers at the same nodes: a U-Net, for which
 * examples/umesh.c makes data, which it trains and writes into a weights file. Here it is only loaded and run; it
 * computes in float whatever sb_real is.
 *
 * ```c fragment
 * static float input[8 * 8 * 32 * 7], output[8 * 8 * 32 * 3]; // of the lattice that the network was trained on
 * sb_network *network = NULL;
 * if (sb_network_load("liver.sbnet", NULL, &network, &error) == SB_OK)
 *     sb_network_run(network, input, output);
 * sb_network_destroy(network);
 * ```
 *
 * Weights file, little-endian, u32 and f32 of four bytes:
 *     "SBNET001"                                    8 bytes
 *     u32 nodes along x, y, z; u32 channels in      sides up to 1024, channels up to 4096
 *     f32 spacing of the nodes along x, y, z (m); f32 length (m); f32 Poisson's ratio      of what it was trained for
 *     u32 layers                                    up to 256
 *     for each: u32 kind, kernel, from, channels in, channels out, activation (sb_layer_kind below)
 *     for each with weights: f32 [kernel^3 taps, z slowest, x fastest][in][out], f32 bias [out]
 *     u32 CRC-32 (RFC 1952) of all bytes before
 * Source: Brunet 2020, section 5.6, whose network has 128 channels in its first layer: 89.6 million weights and 140
 * GFLOP an answer, which are not the 3 ms that it states. 8 channels are enough for a few per cent of error. */
#ifndef SB_NETWORK_H
#define SB_NETWORK_H

#include "../body/step.h"

typedef struct sb_network sb_network;

/* The layers of a file. The input of each is the output of the one before, of the first that of the network. */
typedef enum sb_layer_kind {
    SB_LAYER_CONVOLUTION =
        1,                 /* kernel 3 or 1: out(x) = bias + sum over taps t of W_t in(x + t - kernel / 2), 0 outside */
    SB_LAYER_POOL = 2,     /* kernel 2: the largest of 2 x 2 x 2 nodes, which become one; sides must be even */
    SB_LAYER_UPSAMPLE = 3, /* kernel 2: transposed convolution, out(2 x + t) = bias + W_t in(x); sides double */
    SB_LAYER_JOIN = 4      /* kernel 0: behind the channels of the input those of the output of layer `from`, counted
                            * from 0, which has the same sides. `from` is 0 in all other layers */
} sb_layer_kind;

/* What follows a convolution or an upsampling; 0 (none) in other layers. */
typedef enum sb_activation {
    SB_ACTIVATION_NONE = 0,
    SB_ACTIVATION_RELU = 1 /* 0 where it is below 0 */
} sb_activation;

/* What a network is loaded with. Start from sb_default_network_def(). */
typedef struct sb_network_def {
    sb_allocator allocator; /* default malloc */
    sb_jobs jobs;           /* default inline */
    size_t max_bytes;       /* a network that needs more memory is refused, whatever its file says; default 1e9 */
    unsigned cookie;        /* set by sb_default_network_def */
} sb_network_def;
SB_API sb_network_def sb_default_network_def(void);

/* Loads a weights file; def NULL: defaults. Takes all memory, about 4 bytes for each weight and for each channel of
 * each node in each layer. The file may hold anything: all of it is checked before it is used. Errors, with *network
 * untouched: SB_ERROR_FILE, SB_ERROR_FORMAT (not a weights file, cut off, too long, a checksum that differs, or layers
 * that do not fit one another: error.message names the layer), SB_ERROR_NOT_FINITE (a weight), SB_ERROR_UNSUPPORTED
 * (more memory than def.max_bytes), SB_ERROR_ARGUMENT, SB_ERROR_MEMORY. */
SB_API sb_result sb_network_load(const char *path, const sb_network_def *def, sb_network **network, sb_error *error);
/* The same of a file's bytes[size], which are not kept. */
SB_API sb_result sb_network_load_memory(const unsigned char *bytes, size_t size, const sb_network_def *def,
                                        sb_network **network, sb_error *error);
SB_API void sb_network_destroy(sb_network *network); /* NULL is fine */

typedef struct sb_network_shape {
    int counts[3];       /* nodes along x, y, z */
    int inputs, outputs; /* channels */
    int layers;
    sb_vec3 spacing;      /* m, of the nodes it was trained on */
    sb_real length;       /* m, what the channel of the size is relative to: see sb_network_predict */
    sb_real poisson;      /* Poisson's ratio it was trained for: it knows no other */
    double multiply_adds; /* of an answer */
    size_t bytes;         /* of memory */
} sb_network_shape;
SB_API sb_network_shape sb_network_get_shape(const sb_network *network);

/* output[z][y][x][outputs] = the network's answer to input[z][y][x][inputs], all nodes of the lattice. Allocates
 * nothing; same bits for any threads, which share the planes of each layer. Not from two threads at a time. On failure
 * the output is untouched: SB_ERROR_ARGUMENT (NULL), SB_ERROR_NOT_FINITE (the input, or what floats cannot hold came
 * out). Denormal numbers are computed with as any, and take longer. */
SB_API sb_result sb_network_run(sb_network *network, const float *input, float *output);

#endif /* SB_NETWORK_H */
