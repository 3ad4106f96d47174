/* Training of networks: gradients against differences, what is written and run again, same bits, data learnt by heart.
 */
#define TRAIN_REAL double
#include "check.h"
#include "examples/network_train.h"

static void fill(double *values, size_t count, unsigned long long seed)
{
    for (size_t i = 0; i < count; i++)
        values[i] = check_random_in(&seed, -1, 1);
}

static double *random_values(size_t count, unsigned long long seed)
{
    double *values = (double *)malloc(count * sizeof(double));
    fill(values, count, seed);
    return values;
}

static unsigned char *random_mask(size_t count, unsigned long long seed)
{
    unsigned char *mask = (unsigned char *)malloc(count);
    for (size_t i = 0; i < count; i++)
        mask[i] = check_random(&seed) < 0.8;
    return mask;
}

static void make(train_network *n, const int counts[3], int inputs, int levels, int channels, uint64_t seed)
{
    train_begin(n, counts, inputs);
    train_add_unet(n, levels, channels);
    CHECK(train_allocate(n, seed) == 1);
}

/* Every so many weights of all layers of a U-Net, with biases that are not 0. */
static void check_gradient(const int counts[3], int inputs, int levels, int channels, size_t every)
{
    const double h = 1e-6;
    train_network n;
    double *input, *target, largest = 0, off = 0;
    unsigned char *mask;
    unsigned long long seed = 5;
    size_t nodes = train_nodes(counts);
    make(&n, counts, inputs, levels, channels, 3);
    for (size_t i = 0; i < n.weight_count; i++)
        n.weights[i] += check_random_in(&seed, -0.1, 0.1);
    input = random_values((size_t)inputs * nodes, 1), target = random_values(3 * nodes, 2);
    mask = random_mask(nodes, 3);
    train_forward(&n, input);
    CHECK(train_measure(&n, target, mask) > 0.1);
    train_backward(&n);
    for (size_t i = 0; i < n.weight_count; i += every) {
        double before = n.weights[i], more, less;
        n.weights[i] = before + h;
        train_forward(&n, input);
        more = train_measure(&n, target, mask);
        n.weights[i] = before - h;
        train_forward(&n, input);
        less = train_measure(&n, target, mask);
        n.weights[i] = before;
        largest = fmax(largest, fabs(n.gradient[i]));
        off = fmax(off, fabs(n.gradient[i] - (more - less) / (2 * h)));
    }
    CHECK(largest > 0);
    CHECK_NEAR(off / largest, 0, 1e-7);
    train_free(&n);
    free(input), free(target), free(mask);
}

/* Few channels and many, which fill vectors or not, in rows of nodes that fill tiles or not. No number of channels is a
 * multiple of the steps. */
static void test_gradient(void)
{
    static const int counts[3][3] = {{4, 4, 8}, {22, 2, 2}, {2, 6, 4}};
    check_gradient(counts[0], 2, 2, 2, 5);
    check_gradient(counts[1], 7, 1, 11, 61);
    check_gradient(counts[2], 5, 1, 16, 127);
}

/* The library runs what was written as it was trained. */
static void test_file(void)
{
    static const char path[] = "build/test_network_train.tmp";
    static const int counts[3] = {8, 16, 8};
    size_t nodes = train_nodes(counts);
    train_network n;
    sb_network *network = NULL;
    sb_error error;
    double *input = random_values(7 * nodes, 4), off = 0, largest = 0;
    const double *answer;
    float *in = (float *)malloc(7 * nodes * sizeof(float)), *out = (float *)malloc(3 * nodes * sizeof(float));
    make(&n, counts, 7, 3, 3, 8);
    n.spacing[1] = 0.25, n.length = 0.5, n.poisson = 0.4;
    CHECK(train_save(&n, path) == 1);
    if (!CHECK_OK(sb_network_load(path, NULL, &network, &error)))
        printf("%s\n", error.message);
    CHECK(sb_network_get_shape(network).spacing.y == (sb_real)0.25);
    CHECK_NEAR(sb_network_get_shape(network).poisson, 0.4, 1e-7);
    for (size_t i = 0; i < 7 * nodes; i++) {
        in[i] = (float)input[i];
        input[i] = (double)in[i];
    }
    answer = train_forward(&n, input);
    CHECK_OK(sb_network_run(network, in, out));
    for (size_t i = 0; i < 3 * nodes; i++) {
        off = fmax(off, fabs((double)out[i] - answer[i]));
        largest = fmax(largest, fabs(answer[i]));
    }
    CHECK(largest > 0);
    CHECK_NEAR(off / largest, 0, 1e-5);
    CHECK(train_save(&n, "build/no-such-folder/x") == 0);
    remove(path);
    sb_network_destroy(network);
    train_free(&n);
    free(input), free(in), free(out);
}

/* Trains on one sample; returns the root of the last loss over that of the target. */
static double learn(train_network *n, int steps)
{
    static const int counts[3] = {4, 4, 4};
    size_t nodes = train_nodes(counts);
    double *input = random_values(2 * nodes, 4), *target = random_values(3 * nodes, 5), loss = 0;
    unsigned char *mask = random_mask(nodes, 6);
    make(n, counts, 2, 1, 12, 8);
    for (int step = 0; step < steps; step++) {
        train_forward(n, input);
        loss = train_measure(n, target, mask);
        train_backward(n);
        train_adam(n, train_cosine(2e-3, step, steps), 1);
    }
    free(input), free(target), free(mask);
    return sqrt(loss) / sqrt(1.0 / 3);
}

/* A network with more weights than there are numbers learns numbers of chance by heart; twice the same. */
static void test_by_heart(void)
{
    train_network n, again;
    double error = learn(&n, 1500);
    CHECK(error < 0.01);
    if (error >= 0.01)
        printf("%g\n", error);
    train_free(&n);
    learn(&n, 5), learn(&again, 5);
    CHECK(memcmp(n.weights, again.weights, n.weight_count * sizeof *n.weights) == 0);
    train_free(&n), train_free(&again);
}

static void test_rate(void)
{
    CHECK_NEAR(train_cosine(1, 50, 100), 0.5, 1e-12);
    CHECK(train_cosine(1, 0, 1000) < 0.1 && train_cosine(1, 999, 1000) < 1e-5);
    for (int step = 20; step < 999; step++)
        CHECK(train_cosine(1, step, 1000) > train_cosine(1, step + 1, 1000));
}

CHECK_SUITE(network_train, {"gradient", test_gradient}, {"file", test_file}, {"by heart", test_by_heart},
            {"rate", test_rate});
