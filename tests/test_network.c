/* Networks: layers by their definitions, threads, hostile files, memory. */
#include "check.h"
#include "network_scene.h"
#include "scene.h"

static sb_network *load(const network_file *file, const sb_network_def *def)
{
    sb_network *network = NULL;
    sb_error error;
    if (!CHECK_OK(sb_network_load_memory(file->bytes, file->size, def, &network, &error)))
        printf("%s\n", error.message);
    return network;
}

static float *random_input(const network_file *file, unsigned long long seed)
{
    size_t count = network_nodes(file) * (size_t)file->inputs;
    float *input = (float *)malloc(count * sizeof(float));
    for (size_t i = 0; i < count; i++)
        input[i] = (float)check_random_in(&seed, -1, 1);
    return input;
}

/* Largest difference from the definition over the largest number, or over 1, the size of what goes in. */
static double worst(const network_file *file, const float *input, const float *output)
{
    size_t count = network_nodes(file) * (size_t)network_channels(file);
    double *expected = network_by_definition(file, input), difference = 0, largest = 1;
    for (size_t i = 0; i < count; i++) {
        difference = fmax(difference, fabs((double)output[i] - expected[i]));
        largest = fmax(largest, fabs(expected[i]));
    }
    free(expected);
    return difference / largest;
}

static double error_of(const network_file *file)
{
    sb_network *network = load(file, NULL);
    float *input = random_input(file, 11),
          *output = (float *)malloc(network_nodes(file) * (size_t)network_channels(file) * sizeof(float));
    double error = 1;
    if (network && CHECK_OK(sb_network_run(network, input, output)))
        error = worst(file, input, output);
    sb_network_destroy(network);
    free(input), free(output);
    return error;
}

/* Each kind of layer alone, with channels and sides that no vector's width divides, and some that all do. */
static void test_layers(void)
{
    static const int channels[6] = {1, 3, 5, 8, 13, 16};
    static const int sides[4][3] = {{1, 1, 1}, {5, 3, 2}, {9, 4, 3}, {16, 2, 5}};
    unsigned long long random = 3;
    for (int s = 0; s < 4; s++)
        for (int i = 0; i < 6; i++)
            for (int o = 0; o < 6; o++)
                for (int kernel = 1; kernel <= 3; kernel += 2) {
                    network_file file = network_begin(sides[s][0], sides[s][1], sides[s][2], channels[i]);
                    network_add(&file, SB_LAYER_CONVOLUTION, kernel, 0, channels[o],
                                o % 2 ? SB_ACTIVATION_RELU : SB_ACTIVATION_NONE, 1, &random);
                    network_end(&file);
                    CHECK_NEAR(error_of(&file), 0, kernel == 3 && i > 3 ? 2e-6 : 1e-6); /* 432 terms in float */
                    network_file_free(&file);
                }
    for (int s = 0; s < 4; s++)
        for (int i = 0; i < 6; i++)
            for (int o = 0; o < 6; o++) { /* pooled, and sampled up again */
                network_file file = network_begin(2 * sides[s][0], 2 * sides[s][1], 2 * sides[s][2], channels[i]);
                network_add(&file, SB_LAYER_POOL, 2, 0, channels[i], SB_ACTIVATION_NONE, 0, &random);
                network_add(&file, SB_LAYER_UPSAMPLE, 2, 0, channels[o],
                            o % 2 ? SB_ACTIVATION_RELU : SB_ACTIVATION_NONE, 1, &random);
                network_end(&file);
                CHECK_NEAR(error_of(&file), 0, 1e-6);
                network_file_free(&file);
            }
    for (int i = 0; i < 6; i++)
        for (int o = 0; o < 6; o++) {
            network_file file = network_begin(3, 2, 4, 2);
            network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, channels[i], SB_ACTIVATION_NONE, 1, &random);
            network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, channels[o], SB_ACTIVATION_NONE, 1, &random);
            network_add(&file, SB_LAYER_JOIN, 0, 0, channels[i] + channels[o], SB_ACTIVATION_NONE, 0, &random);
            network_end(&file);
            CHECK_NEAR(error_of(&file), 0, 2e-6); /* of two layers */
            network_file_free(&file);
        }
}

/* The whole of it, three levels deep, on a lattice that is not a cube. */
static void test_unet(void)
{
    static const int counts[3] = {24, 16, 8};
    network_file file = network_unet(counts, 3, 7, 4, 0.2, 5);
    sb_network *network = load(&file, NULL);
    sb_network_shape shape = sb_network_get_shape(network), none = sb_network_get_shape(NULL);
    CHECK_NEAR(error_of(&file), 0, 1e-5); /* floats of 14 layers, one after the other */
    CHECK(shape.counts[0] == 24 && shape.counts[1] == 16 && shape.counts[2] == 8);
    CHECK(shape.inputs == 7 && shape.outputs == 3 && shape.layers == file.layer_count);
    CHECK_NEAR(shape.poisson, 0.45, 1e-7);
    CHECK_NEAR(shape.length, 0.1, 1e-8);
    CHECK_NEAR(shape.spacing.y, 0.01, 1e-8);
    CHECK(shape.bytes > file.size && shape.multiply_adds > 1e6 && none.layers == 0);
    sb_network_destroy(network);
    network_file_free(&file);
}

/* Sums of a layer are those that a hand can do. */
static void test_by_hand(void)
{
    network_file file = network_begin(2, 2, 2, 1);
    sb_network *network;
    float input[8] = {1, 2, 3, 4, 5, 6, 7, 8}, output[8];
    unsigned long long random = 1;
    network_add(&file, SB_LAYER_CONVOLUTION, 3, 0, 1, SB_ACTIVATION_NONE, 0, &random);
    for (int t = 0; t < 27; t++)
        file.layers[0].weights[t] = (float)t;
    file.layers[0].weights[27] = 100;
    network_end(&file);
    network = load(&file, NULL);
    CHECK_OK(sb_network_run(network, input, output));
    /* node (0, 0, 0) sees taps 13, 14, 16, 17, 22, 23, 25, 26 */
    CHECK(output[0] == 100 + 13 * 1 + 14 * 2 + 16 * 3 + 17 * 4 + 22 * 5 + 23 * 6 + 25 * 7 + 26 * 8);
    CHECK(output[7] == 100 + 0 * 1 + 1 * 2 + 3 * 3 + 4 * 4 + 9 * 5 + 10 * 6 + 12 * 7 + 13 * 8);
    sb_network_destroy(network);
    network_file_free(&file);
}

static void test_threads(void)
{
    static const int counts[3] = {16, 8, 24}, workers[4] = {1, 2, 3, 7};
    network_file file = network_unet(counts, 3, 5, 3, 0.3, 9);
    size_t bytes = network_nodes(&file) * 3 * sizeof(float);
    float *input = random_input(&file, 2), *first = (float *)malloc(bytes), *output = (float *)malloc(bytes);
    sb_network *network = load(&file, NULL);
    CHECK_OK(sb_network_run(network, input, first));
    CHECK_OK(sb_network_run(network, input, output)); /* nothing is left over from the last run */
    CHECK(memcmp(first, output, bytes) == 0);
    sb_network_destroy(network);
    for (int k = 0; k < 4; k++) {
        int count = workers[k];
        sb_network_def def = sb_default_network_def();
        def.jobs = scene_jobs(&count);
        network = load(&file, &def);
        memset(output, 0, bytes);
        CHECK_OK(sb_network_run(network, input, output));
        CHECK(memcmp(first, output, bytes) == 0);
        sb_network_destroy(network);
    }
    free(input), free(first), free(output);
    network_file_free(&file);
}

/* What is not finite is refused and leaves the output alone; denormal numbers are numbers. */
static void test_numbers(void)
{
    static const int counts[3] = {8, 8, 8};
    network_file file = network_unet(counts, 1, 2, 3, 0.3, 4);
    size_t count = network_nodes(&file) * 3;
    float *input = random_input(&file, 7), *output = (float *)malloc(count * sizeof(float));
    sb_network *network = load(&file, NULL);
    for (size_t i = 0; i < network_nodes(&file) * 2; i++)
        input[i] *= 1e-39f;
    CHECK_OK(sb_network_run(network, input, output));
    CHECK_NEAR(worst(&file, input, output), 0, 1e-5);
    CHECK_RESULT(sb_network_run(NULL, input, output), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_network_run(network, NULL, output), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_network_run(network, input, NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    output[0] = output[count - 1] = 42;
    for (int k = 0; k < 4; k++) {
        const float bad[4] = {(float)NAN, (float)INFINITY, -(float)INFINITY, 3e38f};
        float before = input[5];
        input[5] = bad[k]; /* the last is finite, and what comes of it is not */
        if (k == 3)
            for (size_t i = 0; i < network_nodes(&file) * 2; i++)
                input[i] = i % 2 ? bad[k] : -bad[k];
        CHECK_RESULT(sb_network_run(network, input, output), SB_ERROR_NOT_FINITE);
        CHECK(output[0] == 42 && output[count - 1] == 42);
        input[5] = before;
    }
    sb_network_destroy(network);
    free(input), free(output);
    network_file_free(&file);
}

static void refuse(const unsigned char *bytes, size_t size, sb_result expected)
{
    sb_network *network = NULL;
    sb_error error;
    CHECK_RESULT(sb_network_load_memory(bytes, size, NULL, &network, &error), expected);
    CHECK(!network && error.result == expected && error.message[0]);
}

/* Each beginning of a file, each with a byte behind it, and each with one byte changed. */
static void test_damaged(void)
{
    static const int counts[3] = {4, 4, 4};
    network_file file = network_unet(counts, 1, 2, 2, 0.3, 4);
    unsigned char *copy = (unsigned char *)malloc(file.size + 1);
    for (size_t size = 0; size < file.size; size++) {
        unsigned char *cut = (unsigned char *)malloc(size + 1); /* of its own, for what watches memory */
        memcpy(cut, file.bytes, size);
        refuse(cut, size, SB_ERROR_FORMAT);
        free(cut);
    }
    memcpy(copy, file.bytes, file.size);
    copy[file.size] = 0;
    refuse(copy, file.size + 1, SB_ERROR_FORMAT);
    for (size_t at = 0; at < file.size; at++) {
        copy[at] ^= (unsigned char)(1 + at % 255);
        refuse(copy, file.size, SB_ERROR_FORMAT);
        copy[at] = file.bytes[at];
    }
    free(copy);
    network_file_free(&file);
}

/* The same with a checksum that is right: what still loads runs; sizes that lie are refused. */
static void test_forged(void)
{
    static const int counts[3] = {4, 8, 4};
    network_file file = network_unet(counts, 2, 2, 2, 0.3, 4);
    unsigned char *copy = (unsigned char *)malloc(file.size);
    size_t head = NETWORK_HEAD + NETWORK_LAYER * (size_t)file.layer_count;
    unsigned long long random = 8;
    int loaded = 0, rounds = check_rounds(5000);
    check_bad_numbers();
    for (int k = 0; k < rounds; k++) {
        static const unsigned long words[8] = {0, 1, 2, 3, 4096, 0x7FFFFFFF, 0x80000000UL, 0xFFFFFFFFUL};
        size_t at = 8 + 4 * (size_t)(check_random(&random) * (double)((head - 8) / 4));
        sb_network_def def = sb_default_network_def();
        sb_network *network = NULL;
        sb_error error;
        sb_result result;
        def.max_bytes = 1 << 20;
        memcpy(copy, file.bytes, file.size);
        if (k % 3)
            network_put(copy + at, words[(int)(check_random(&random) * 8)]);
        else
            copy[(size_t)(check_random(&random) * (double)file.size)] ^= (unsigned char)(1 + k % 255);
        network_seal(copy, file.size);
        result = sb_network_load_memory(copy, file.size, &def, &network, &error);
        if (result == SB_OK) {
            sb_network_shape shape = sb_network_get_shape(network);
            size_t nodes = (size_t)shape.counts[0] * (size_t)shape.counts[1] * (size_t)shape.counts[2];
            float *input = (float *)calloc(nodes * (size_t)shape.inputs, sizeof(float)),
                  *output = (float *)malloc(nodes * (size_t)shape.outputs * sizeof(float));
            result = sb_network_run(network, input, output);
            CHECK(result == SB_OK || result == SB_ERROR_NOT_FINITE);
            loaded++;
            free(input), free(output);
        } else {
            CHECK(result == SB_ERROR_FORMAT || result == SB_ERROR_NOT_FINITE || result == SB_ERROR_UNSUPPORTED);
            CHECK(!network && error.result == result && error.message[0]);
        }
        sb_network_destroy(network);
    }
    CHECK(loaded > rounds / 10);
    free(copy);
    network_file_free(&file);
}

/* One field at a time, with the error that names it. */
static void test_rules(void)
{
    static const int counts[3] = {4, 4, 4};
    static const struct {
        size_t at;
        unsigned long word;
        sb_result expected;
        const char *message;
    } bad[] = {{8, 0, SB_ERROR_FORMAT, "sides"},
               {12, 1025, SB_ERROR_FORMAT, "sides"},
               {20, 4097, SB_ERROR_FORMAT, "channels"},
               {24, 0x7F800000UL, SB_ERROR_NOT_FINITE, "spacing"},
               {28, 0, SB_ERROR_FORMAT, "spacing"},
               {36, 0xBF800000UL, SB_ERROR_FORMAT, "length"},
               {40, 0x3F800000UL, SB_ERROR_FORMAT, "Poisson"},
               {44, 257, SB_ERROR_FORMAT, "256 layers"},
               {44, 200, SB_ERROR_FORMAT, "ends within"},
               {44, 2, SB_ERROR_FORMAT, "bytes, its layers"},
               {48, 5, SB_ERROR_FORMAT, "layer 0"},
               {52, 2, SB_ERROR_FORMAT, "layer 0 of the network has a kernel"},
               {56, 1, SB_ERROR_FORMAT, "joins no layer"},
               {60, 3, SB_ERROR_FORMAT, "layer 0 of the network takes another number"},
               {64, 4, SB_ERROR_FORMAT, "layer 1 of the network takes another number"},
               {68, 2, SB_ERROR_FORMAT, "layer 0"},
               {48 + 24 * 2 + 16, 3, SB_ERROR_FORMAT, "layer 2 of the network pools into"},
               {48 + 24 * 2 + 20, 1, SB_ERROR_FORMAT, "layer 2 of the network has an activation"},
               {48 + 24 * 5 + 8, 5, SB_ERROR_FORMAT, "not before it"},
               {48 + 24 * 5 + 8, 2, SB_ERROR_FORMAT, "other sides"},
               {48 + 24 * 5 + 16, 5, SB_ERROR_FORMAT, "as many channels as both"}};
    network_file file = network_unet(counts, 1, 2, 2, 0.3, 4), odd = network_begin(3, 4, 4, 2);
    unsigned char *copy = (unsigned char *)malloc(file.size);
    unsigned long long random = 1;
    check_bad_numbers();
    for (size_t k = 0; k < sizeof bad / sizeof *bad; k++) {
        sb_network *network = NULL;
        sb_error error;
        memcpy(copy, file.bytes, file.size);
        network_put(copy + bad[k].at, bad[k].word);
        network_seal(copy, file.size);
        CHECK_RESULT(sb_network_load_memory(copy, file.size, NULL, &network, &error), bad[k].expected);
        if (!CHECK(!network && strstr(error.message, bad[k].message)))
            printf("%s, not %s\n", error.message, bad[k].message);
    }
    memcpy(copy, file.bytes, file.size);
    network_put_float(copy + file.size - 8, (float)NAN); /* the last bias */
    network_seal(copy, file.size);
    refuse(copy, file.size, SB_ERROR_NOT_FINITE);
    network_add(&odd, SB_LAYER_POOL, 2, 0, 2, SB_ACTIVATION_NONE, 0, &random);
    network_end(&odd);
    refuse(odd.bytes, odd.size, SB_ERROR_FORMAT);
    network_file_free(&odd);
    odd = network_begin(4, 4, 4, 2);
    network_add(&odd, SB_LAYER_POOL, 2, 0, 2, SB_ACTIVATION_NONE, 0, &random);
    network_end(&odd);
    refuse(odd.bytes, odd.size, SB_ERROR_FORMAT); /* ends on another lattice */
    free(copy);
    network_file_free(&odd);
    network_file_free(&file);
}

/* A small file that asks for the largest tensors there may be: refused before memory is asked for. */
static void test_sizes(void)
{
    network_file file = network_begin(1024, 1024, 1024, 4096);
    scene_memory memory;
    sb_network_def def = sb_default_network_def();
    sb_network *network = NULL;
    unsigned long long random = 1;
    memset(&memory, 0, sizeof memory);
    def.allocator = scene_allocator(&memory);
    network_add(&file, SB_LAYER_POOL, 2, 0, 4096, SB_ACTIVATION_NONE, 0, &random);
    network_add(&file, SB_LAYER_POOL, 2, 0, 4096, SB_ACTIVATION_NONE, 0, &random);
    network_end(&file);
    refuse(file.bytes, file.size, SB_ERROR_FORMAT);
    network_file_free(&file);
    file = network_begin(1024, 1024, 1024, 1);
    network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, 4096, SB_ACTIVATION_NONE, 1, &random);
    network_end(&file);
    CHECK_RESULT(sb_network_load_memory(file.bytes, file.size, &def, &network, NULL), SB_ERROR_UNSUPPORTED);
    CHECK(memory.calls == 2 && memory.live == 0);
    def.max_bytes = (size_t)-1; /* as much as there is: no memory, or no size_t, for it */
    memory.fail_at = 5;
    CHECK(sb_network_load_memory(file.bytes, file.size, &def, &network, NULL) != SB_OK);
    CHECK(memory.live == 0 && !network);
    network_file_free(&file);
}

static void test_files(void)
{
    static const char path[] = "build/test_network.tmp";
    static const int counts[3] = {4, 4, 4};
    network_file file = network_unet(counts, 1, 2, 2, 0.3, 4);
    FILE *out = fopen(path, "wb");
    sb_network_def def = sb_default_network_def(), wrong;
    sb_network *network = NULL;
    sb_error error;
    scene_memory memory;
    memset(&memory, 0, sizeof memory);
    def.allocator = scene_allocator(&memory);
    CHECK(out && fwrite(file.bytes, file.size, 1, out) == 1);
    fclose(out);
    for (int n = 1; !network && n < 20; n++) { /* each allocation fails in turn */
        memory.calls = 0;
        memory.fail_at = n;
        if (sb_network_load(path, &def, &network, &error) != SB_OK) {
            CHECK_RESULT(error.result, SB_ERROR_MEMORY);
            CHECK(!network && memory.live == 0 && error.message[0]);
        }
    }
    CHECK(network && memory.calls == 4); /* file, network, layers, all else */
    {
        float *input = random_input(&file, 3), output[4 * 4 * 4 * 3];
        CHECK_OK(sb_network_run(network, input, output));
        CHECK_NEAR(worst(&file, input, output), 0, 1e-5);
        CHECK(memory.calls == 4);
        free(input);
    }
    sb_network_destroy(network);
    CHECK_INT(memory.live, 0);
    network = NULL;
    memory.fail_at = 0;
    out = fopen(path, "wb");
    CHECK(out && fwrite(file.bytes, file.size - 1, 1, out) == 1);
    fclose(out);
    CHECK_RESULT(sb_network_load(path, &def, &network, &error), SB_ERROR_FORMAT);
    CHECK(strstr(error.file, "test_network") && strstr(error.message, "cut off"));
    remove(path);
    CHECK_RESULT(sb_network_load(path, &def, &network, &error), SB_ERROR_FILE);
    CHECK_RESULT(sb_network_load(NULL, &def, &network, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_network_load_memory(NULL, 5, &def, &network, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_network_load_memory(file.bytes, file.size, &def, NULL, &error), SB_ERROR_ARGUMENT);
    memset(&wrong, 0, sizeof wrong);
    CHECK_RESULT(sb_network_load_memory(file.bytes, file.size, &wrong, &network, &error), SB_ERROR_ARGUMENT);
    CHECK(!network && memory.live == 0);
    sb_network_destroy(NULL);
    network_file_free(&file);
}

CHECK_SUITE(network, {"layers", test_layers}, {"U-Net", test_unet}, {"by hand", test_by_hand},
            {"threads", test_threads}, {"numbers", test_numbers}, {"damaged files", test_damaged},
            {"forged files", test_forged}, {"rules", test_rules}, {"sizes", test_sizes}, {"files", test_files});
