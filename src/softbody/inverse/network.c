/* network: making and running. */
#include "network.h"

#include <string.h>

#include "../base/input.h"
#include "network_private.h"

#define SBI_NETWORK_COOKIE 0x4e7u

SB_API sb_network_def sb_default_network_def(void)
{
    sb_network_def def;
    memset(&def, 0, sizeof def);
    def.max_bytes = 1000000000;
    def.cookie = SBI_NETWORK_COOKIE;
    return def;
}

/* ---- memory ---- */

/* A tensor with its border. */
static void sbi_tensor_take(sbi_tensor *tensor, sbi_arena *arena)
{
    size_t nodes = ((size_t)tensor->counts[0] + 2) * ((size_t)tensor->counts[1] + 2) * ((size_t)tensor->counts[2] + 2);
    float *data = (float *)sbi_arena_take(arena, nodes, tensor->node * sizeof(float));
    tensor->data = data ? data + tensor->plane + tensor->row + tensor->node : NULL;
}

static void sbi_network_layout(sb_network *network, sbi_arena *arena)
{
    const sb_network_shape *shape = &network->shape;
    size_t nodes = (size_t)shape->counts[0] * (size_t)shape->counts[1] * (size_t)shape->counts[2];
    network->channels = (float *)sbi_arena_take(arena, nodes, (size_t)shape->inputs * sizeof(float));
    network->answer = (float *)sbi_arena_take(arena, nodes, (size_t)shape->outputs * sizeof(float));
    network->guess = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    network->scratch = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    sbi_tensor_take(&network->input, arena);
    for (int l = 0; l < network->shape.layers; l++) {
        sbi_network_layer *layer = network->layers + l;
        size_t inputs = (size_t)sbi_network_taps(layer) * (size_t)layer->inputs;
        sbi_tensor_take(&layer->out, arena);
        if (inputs == 0)
            continue;
        layer->weights = (float *)sbi_arena_take(arena, inputs, layer->out.node * sizeof(float));
        layer->bias = (float *)sbi_arena_take(arena, layer->out.node, sizeof(float));
    }
}

static sb_result sbi_network_take_memory(sb_network *network, size_t most, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_network_layout(network, &arena);
    if (arena.overflow || arena.used > most)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the network needs more memory than def.max_bytes (%lu)",
                        (unsigned long)most);
    network->shape.bytes = arena.used;
    network->memory = sbi_alloc_zeroed(&network->allocator, arena.used, 1);
    if (!network->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a network of %lu bytes", (unsigned long)arena.used);
    arena.base = (unsigned char *)network->memory;
    arena.used = 0;
    sbi_network_layout(network, &arena);
    return SB_OK;
}

/* ---- making ---- */

static sb_result sbi_network_fill(sb_network *network, const unsigned char *bytes, size_t size, size_t most,
                                  sb_error *error)
{
    sb_result result;
    network->layers =
        (sbi_network_layer *)sbi_alloc_zeroed(&network->allocator, SBI_NETWORK_LAYERS, sizeof *network->layers);
    if (!network->layers)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the layers of a network");
    result = sbi_network_read_head(bytes, size, &network->shape, &network->input, network->layers, error);
    if (result == SB_OK)
        result = sbi_network_take_memory(network, most, error);
    if (result == SB_OK)
        result = sbi_network_read_weights(bytes, network, error);
    return result;
}

static sb_result sbi_network_check_def(const sb_network_def *def, sb_error *error)
{
    if (def->cookie != SBI_NETWORK_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_network_def");
    return SB_OK;
}

SB_API sb_result sb_network_load_memory(const unsigned char *bytes, size_t size, const sb_network_def *def,
                                        sb_network **out, sb_error *error)
{
    sb_network_def defaults = sb_default_network_def();
    sb_network *network;
    sb_result result;
    def = def ? def : &defaults;
    if (!bytes || !out)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a network needs the bytes of a weights file and a place");
    result = sbi_network_check_def(def, error);
    if (result != SB_OK)
        return result;
    network = (sb_network *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *network);
    if (!network)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a network");
    network->allocator = def->allocator;
    network->jobs = def->jobs;
    result = sbi_network_fill(network, bytes, size, def->max_bytes, error);
    if (result != SB_OK) {
        sb_network_destroy(network);
        return result;
    }
    *out = network;
    return SB_OK;
}

SB_API sb_result sb_network_load(const char *path, const sb_network_def *def, sb_network **network, sb_error *error)
{
    sb_network_def defaults = sb_default_network_def();
    sbi_file content;
    sb_result result;
    def = def ? def : &defaults;
    if (!path || !network)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a network needs the path of a weights file and a place");
    result = sbi_network_check_def(def, error);
    if (result != SB_OK)
        return result;
    result = sbi_file_read(&def->allocator, path, &content, error);
    if (result == SB_OK) {
        result = sb_network_load_memory((const unsigned char *)content.data, content.size, def, network, error);
        if (result != SB_OK && error)
            sbi_error_set_file(error, path);
    }
    sbi_free(&def->allocator, content.data);
    return result;
}

SB_API void sb_network_destroy(sb_network *network)
{
    sb_allocator allocator;
    if (!network)
        return;
    allocator = network->allocator;
    sbi_free(&allocator, network->memory);
    sbi_free(&allocator, network->layers);
    sbi_free(&allocator, network);
}

SB_API sb_network_shape sb_network_get_shape(const sb_network *network)
{
    sb_network_shape none;
    memset(&none, 0, sizeof none);
    return network ? network->shape : none;
}

/* ---- running ---- */

/* Without the border. */
static int sbi_tensor_is_finite(const sbi_tensor *t)
{
    for (size_t z = 0; z < (size_t)t->counts[2]; z++)
        for (size_t y = 0; y < (size_t)t->counts[1]; y++)
            for (size_t x = 0; x < (size_t)t->counts[0]; x++)
                for (size_t c = 0; c < (size_t)t->channels; c++)
                    if (!isfinite(t->data[z * t->plane + y * t->row + x * t->node + c]))
                        return 0;
    return 1;
}

/* Between a tensor and channels[z][y][x][...] without borders: into the tensor, or out of it. */
static void sbi_tensor_copy(const sbi_tensor *t, const float *in, float *out)
{
    size_t channels = (size_t)t->channels, bytes = channels * sizeof(float), at = 0;
    for (size_t z = 0; z < (size_t)t->counts[2]; z++)
        for (size_t y = 0; y < (size_t)t->counts[1]; y++)
            for (size_t x = 0; x < (size_t)t->counts[0]; x++, at += channels) {
                float *node = t->data + z * t->plane + y * t->row + x * t->node;
                if (in)
                    memcpy(node, in + at, bytes);
                else
                    memcpy(out + at, node, bytes);
            }
}

SB_API sb_result sb_network_run(sb_network *network, const float *input, float *output)
{
    const sbi_tensor *answer;
    if (!network || !input || !output)
        return SB_ERROR_ARGUMENT;
    sbi_tensor_copy(&network->input, input, NULL);
    if (!sbi_tensor_is_finite(&network->input))
        return SB_ERROR_NOT_FINITE;
    for (int l = 0; l < network->shape.layers; l++)
        sbi_network_run_layer(network, l);
    answer = sbi_network_into(network, network->shape.layers);
    if (!sbi_tensor_is_finite(answer))
        return SB_ERROR_NOT_FINITE;
    sbi_tensor_copy(answer, NULL, output);
    return SB_OK;
}
