/* bench_network: what a U-Net of three levels and eight channels costs. Prints one line per lattice: name, nodes,
 * milliseconds of an answer, and of a sample and pass of training (median and least of several runs), multiply-adds of
 * an answer, bytes and a checksum. Weights are of chance. Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "examples/network_train.h"
#include "measure.h"

#include <stdio.h>
#include <stdlib.h>

enum { LEVELS = 3, CHANNELS = 8, MOST_RUNS = 101 };
static const char weights[] = "build/bench_network.tmp";

typedef struct spent {
    double middle, least; /* ms */
} spent;

static spent spent_of(double *ms, int runs)
{
    spent s;
    s.middle = median(ms, runs);
    s.least = ms[0];
    return s;
}

static float *random_floats(size_t count, uint64_t seed)
{
    float *values = (float *)malloc(count * sizeof *values);
    for (size_t i = 0; i < count; i++)
        values[i] = (float)(2 * train_random(&seed) - 1);
    return values;
}

static double sum_of(const float *values, size_t count)
{
    double sum = 0;
    for (size_t i = 0; i < count; i++)
        sum += (double)values[i];
    return sum;
}

static spent time_answers(sb_network *network, const float *input, float *output, int runs)
{
    double ms[MOST_RUNS];
    for (int k = 0; k < runs; k++) {
        double begin = now();
        sb_network_run(network, input, output);
        ms[k] = 1e3 * (now() - begin);
    }
    return spent_of(ms, runs);
}

static spent time_training(train_network *n, const float *input, const float *target, const unsigned char *mask,
                           int runs)
{
    double ms[MOST_RUNS];
    for (int k = 0; k < runs; k++) {
        double begin = now();
        train_forward(n, input);
        train_measure(n, target, mask);
        train_backward(n);
        ms[k] = 1e3 * (now() - begin);
    }
    return spent_of(ms, runs);
}

static int run(const char *name, const int counts[3], int runs)
{
    size_t nodes = train_nodes(counts);
    float *input = random_floats(nodes * SB_NETWORK_CHANNELS, 1), *target = random_floats(3 * nodes, 2),
          *output = (float *)calloc(3 * nodes, sizeof(float));
    unsigned char *mask = (unsigned char *)malloc(nodes);
    sb_network_def def = sb_default_network_def();
    sb_network *network = NULL;
    train_network n;
    int good;
    def.jobs = jobs_asked_for();
    memset(mask, 1, nodes);
    train_begin(&n, counts, SB_NETWORK_CHANNELS);
    train_add_unet(&n, LEVELS, CHANNELS);
    good = train_allocate(&n, 1) && train_save(&n, weights) && sb_network_load(weights, &def, &network, NULL) == SB_OK;
    remove(weights);
    if (good) {
        spent answer = time_answers(network, input, output, runs), pass = time_training(&n, input, target, mask, runs);
        sb_network_shape shape = sb_network_get_shape(network);
        printf("%s %lu %.3f %.3f %.3f %.3f %.0f %lu %.9g\n", name, (unsigned long)nodes, answer.middle, answer.least,
               pass.middle, pass.least, shape.multiply_adds, (unsigned long)shape.bytes, sum_of(output, 3 * nodes));
    }
    sb_network_destroy(network);
    train_free(&n);
    free(input), free(target), free(output), free(mask);
    return good ? 0 : 1;
}

int main(void)
{
    static const int beam[3] = {32, 8, 8}, thesis[3] = {32, 40, 16};
    printf("# name nodes answer_ms least_ms training_ms least_ms multiply_adds bytes checksum\n");
    return run("beam", beam, MOST_RUNS) | run("thesis", thesis, 11);
}
