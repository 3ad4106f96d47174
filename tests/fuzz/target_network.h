/* Target: weights files of networks, without their checksum, which is put behind: what loads runs, twice alike. */
#ifndef TARGET_NETWORK_H
#define TARGET_NETWORK_H

#include "fuzz.h"

/* Runs what was loaded where that is soon done. */
static void fuzz_network_run(sb_network *network)
{
    sb_network_shape shape = sb_network_get_shape(network);
    size_t nodes = (size_t)shape.counts[0] * (size_t)shape.counts[1] * (size_t)shape.counts[2];
    size_t inputs = nodes * (size_t)shape.inputs, outputs = nodes * (size_t)shape.outputs;
    float *numbers;
    sb_result first, again;
    if (shape.multiply_adds > 1e7 || inputs + outputs > 1u << 22)
        return;
    numbers = (float *)calloc(inputs + 2 * outputs, sizeof *numbers);
    FUZZ_REQUIRE(numbers != NULL);
    for (size_t i = 0; i < inputs; i++)
        numbers[i] = (float)(i % 17) / 8 - 1;
    first = sb_network_run(network, numbers, numbers + inputs);
    again = sb_network_run(network, numbers, numbers + inputs + outputs);
    FUZZ_REQUIRE(first == again && (first == SB_OK || first == SB_ERROR_NOT_FINITE));
    FUZZ_REQUIRE(memcmp(numbers + inputs, numbers + inputs + outputs, outputs * sizeof *numbers) == 0);
    for (size_t i = 0; i < outputs; i++)
        FUZZ_REQUIRE(isfinite(numbers[inputs + i]));
    free(numbers);
}

static void fuzz_network(const uint8_t *data, size_t size)
{
    sb_network_def def = sb_default_network_def();
    sb_network *network = NULL;
    sb_error error;
    unsigned char *file = (unsigned char *)malloc(size + 4);
    uint32_t checksum;
    FUZZ_REQUIRE(file != NULL);
    if (size)
        memcpy(file, data, size);
    checksum = sbi_crc32(file, size);
    for (int k = 0; k < 4; k++)
        file[size + (size_t)k] = (unsigned char)(checksum >> 8 * k);
    def.max_bytes = 1 << 24;
    if (sb_network_load_memory(file, size + 4, &def, &network, &error) == SB_OK)
        fuzz_network_run(network);
    else
        FUZZ_REQUIRE(network == NULL && error.message[0] != 0);
    sb_network_destroy(network);
    free(file);
}

#endif /* TARGET_NETWORK_H */
