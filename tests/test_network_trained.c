/* A trained network and samples that it never saw: what it knows is still known. Both were made by examples/umesh.c;
 * numbers (mm) have three digits:
 *     umesh generate beam.csv --samples 150
 *     umesh train beam.csv tests/data/beam.sbnet --samples 150 --levels 2 --channels 4 --epochs 80 --batch 1 --rate
 * 2e-3 umesh generate seen.csv --samples 5 --seed 9 awk -F, -v OFS=, 'NR > 2 { for (i = 2; i <= NF; i++) $i =
 * sprintf("%.3g", $i) } 1' seen.csv */
#include "check.h"
#include "softbody.h"

enum { ALONG = 32, ACROSS = 8, NODES = ALONG * ACROSS * ACROSS, SAMPLES = 5 };

/* Displacements (mm) of sample k and after it, in the order of the lattice; 0: the file is at its end. */
static int read_sample(FILE *file, double *u)
{
    int k;
    if (fscanf(file, "%d", &k) != 1)
        return 0;
    for (int i = 0; i < 3 * (int)NODES; i++)
        if (fscanf(file, ",%lf", u + i) != 1)
            return 0;
    return 1;
}

/* The side of largest z is seen, but for its clamped end. */
static int is_seen(int i) { return i / ((int)ALONG * (int)ACROSS) == (int)ACROSS - 1 && i % (int)ALONG > 0; }

/* The channels of network_predict.h; returns the largest displacement that is seen. */
static double fill_channels(const double *u, double length, float *input)
{
    double size = 0;
    for (int i = 0; i < (int)NODES; i++)
        if (is_seen(i))
            size = fmax(size, sqrt(u[3 * i] * u[3 * i] + u[3 * i + 1] * u[3 * i + 1] + u[3 * i + 2] * u[3 * i + 2]));
    memset(input, 0, (int)NODES * (int)SB_NETWORK_CHANNELS * sizeof(float));
    for (int i = 0; i < (int)NODES; i++) {
        float *channel = input + i * (int)SB_NETWORK_CHANNELS;
        for (int c = 0; is_seen(i) && c < 3; c++)
            channel[c] = (float)(u[3 * i + c] / size);
        channel[3] = is_seen(i) ? 1 : 0;
        channel[4] = (float)(1e-3 * size / length);
        channel[5] = (float)(i % (int)ALONG) / (float)((int)ALONG - 1);
        channel[6] = 1;
    }
    return size;
}

/* |answer - truth| / |truth| of all nodes. */
static double error_of(sb_network *network, const double *u)
{
    static float input[(int)NODES * (int)SB_NETWORK_CHANNELS], output[NODES * 3];
    double size = fill_channels(u, (double)sb_network_get_shape(network).length, input), off = 0, all = 0;
    CHECK_OK(sb_network_run(network, input, output));
    for (int i = 0; i < 3 * (int)NODES; i++) {
        double difference = size * (double)output[i] - u[i];
        off += difference * difference;
        all += u[i] * u[i];
    }
    return sqrt(off / all);
}

/* Stored with the network: the mean of its relative errors. */
static void test_trained(void)
{
    static const double stored = 0.17;
    static double u[3 * NODES];
    sb_network *network = NULL;
    sb_error error;
    FILE *file = fopen("tests/data/beam_samples.csv", "r");
    char line[128];
    double mean = 0;
    int count = 0;
    if (!CHECK_OK(sb_network_load("tests/data/beam.sbnet", NULL, &network, &error)))
        printf("%s\n", error.message);
    CHECK(file && fgets(line, sizeof line, file) && fgets(line, sizeof line, file));
    for (; file && network && read_sample(file, u); count++)
        mean += error_of(network, u) / (double)SAMPLES;
    CHECK_INT(count, SAMPLES);
    CHECK(mean > 0);
    if (!CHECK(mean < 1.1 * stored))
        printf("%g\n", mean);
    if (file)
        fclose(file);
    sb_network_destroy(network);
}

CHECK_SUITE(network_trained, {"samples", test_trained});
