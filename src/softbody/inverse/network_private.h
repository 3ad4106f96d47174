/* network_private: what the files of the network share. Floor 4. */
#ifndef SB_NETWORK_PRIVATE_H
#define SB_NETWORK_PRIVATE_H

#include "network.h"

/* So many channels at a time. Each has a sum of its own, so that their number does not change a bit. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && defined(__AVX__)
#define SBI_NETWORK_LANES 8
#elif defined(__GNUC__) && !defined(SB_NO_VECTORS)
#define SBI_NETWORK_LANES 4
#else
#define SBI_NETWORK_LANES 1
#endif

enum {
    SBI_NETWORK_TAPS = 27,
    SBI_NETWORK_SIDE = 1024, /* nodes */
    SBI_NETWORK_CHANNELS = 4096,
    SBI_NETWORK_LAYERS = 256,
    SBI_NETWORK_HEAD = 48, /* bytes of a file before the layers, */
    SBI_NETWORK_LAYER = 24 /* and of each */
};

/* Channels of all nodes, and of a border one node wide that stays 0: convolutions need not ask where they are. */
typedef struct sbi_tensor {
    float *data; /* of node (0, 0, 0) */
    int counts[3];
    int channels;
    size_t node, row, plane; /* floats from one to the next; a node has room for whole lanes */
} sbi_tensor;

typedef struct sbi_network_layer {
    sb_layer_kind kind;
    int kernel, from, inputs;
    sb_activation activation;
    sbi_tensor out;
    float *weights; /* [(outputs in whole lanes) / lanes][taps][inputs][lanes] */
    float *bias;    /* [outputs in whole lanes] */
} sbi_network_layer;

struct sb_network {
    sb_allocator allocator;
    sb_jobs jobs;
    sb_network_shape shape;
    sbi_tensor input;
    sbi_network_layer *layers; /* [shape.layers] */
    float *channels, *answer;  /* [nodes][inputs], [nodes][outputs]: of sb_network_predict, */
    sb_vec3 *guess, *scratch;  /* [nodes] */
    void *memory;              /* behind all of these */
};

/* Taps of the kernel; 0: the layer has no weights. */
SB_INLINE int sbi_network_taps(const sbi_network_layer *layer)
{
    if (layer->kind != SB_LAYER_CONVOLUTION && layer->kind != SB_LAYER_UPSAMPLE)
        return 0;
    return layer->kernel * layer->kernel * layer->kernel;
}

/* Channels in whole lanes. */
SB_INLINE int sbi_network_padded(int channels)
{
    return (channels + SBI_NETWORK_LANES - 1) / SBI_NETWORK_LANES * SBI_NETWORK_LANES;
}

/* What layer l begins with. */
SB_INLINE const sbi_tensor *sbi_network_into(const sb_network *network, int l)
{
    return l > 0 ? &network->layers[l - 1].out : &network->input;
}

/* ---- network_layer.c ---- */
/* The output of layer l from those before it. */
SBI_API void sbi_network_run_layer(const sb_network *network, int l);

/* ---- network_file.c ---- */
/* Checks all of a file but its weights, and fills shape and layers, which have no memory yet.
 * *layers: [SBI_NETWORK_LAYERS]. */
SBI_API sb_result sbi_network_read_head(const unsigned char *bytes, size_t size, sb_network_shape *shape,
                                        sbi_tensor *input, sbi_network_layer *layers, sb_error *error);
/* Weights of all layers, which have memory of zeros by now. */
SBI_API sb_result sbi_network_read_weights(const unsigned char *bytes, sb_network *network, sb_error *error);

#endif /* SB_NETWORK_PRIVATE_H */
