/* fuzz: every reader and every body against bytes that mean no good.
 *
 *     fuzz TARGET FILE...                   runs the files; ends with `N passed, 0 failed, 0 skipped`
 *     fuzz TARGET -SECONDS FILE...          then mutations of them for so long, always the same ones
 *     FUZZ_TARGET=TARGET fuzz ...           compiled with FUZZ_LIBFUZZER and -fsanitize=fuzzer: libFuzzer's options
 *
 * A finding aborts; the plain program leaves the input in build/fuzz-TARGET.crash. */
#include "examples/system.h" /* before all that comes from the system */

#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "needle.h"
#include "register.h"

#include "fuzz.h"

#include "target_body.h"
#include "target_case.h"
#include "target_cloud.h"
#include "target_feb.h"
#include "target_geometry.h"
#include "target_igtl.h"
#include "target_inp.h"
#include "target_mesh.h"
#include "target_msml.h"
#include "target_needle.h"
#include "target_network.h"
#include "target_precond.h"
#include "target_register.h"
#include "target_xml.h"

#include <signal.h>
#include <time.h>

static const struct fuzz_target {
    const char *name;
    void (*run)(const uint8_t *data, size_t size);
} fuzz_targets[] = {{"vtk", fuzz_vtk},
                    {"gmsh", fuzz_gmsh},
                    {"tetgen", fuzz_tetgen},
                    {"surface", fuzz_surface},
                    {"geometry", fuzz_geometry},
                    {"mesh", fuzz_mesh},
                    {"case", fuzz_case},
                    {"inp", fuzz_inp},
                    {"xml", fuzz_xml},
                    {"feb", fuzz_feb},
                    {"msml", fuzz_msml},
                    {"state", fuzz_state},
                    {"record", fuzz_record},
                    {"network", fuzz_network},
                    {"body", fuzz_body},
                    {"cloud", fuzz_cloud},
                    {"vtu", fuzz_vtu},
                    {"medit", fuzz_medit},
                    {"needle_state", fuzz_needle_state},
                    {"needle_program", fuzz_needle_program},
                    {"icp", fuzz_icp},
                    {"cpd", fuzz_cpd},
                    {"match", fuzz_match},
                    {"nicp", fuzz_nicp},
                    {"precond", fuzz_precond},
                    {"image", fuzz_image},
                    {"igtl", fuzz_igtl}};
enum { FUZZ_TARGETS = sizeof fuzz_targets / sizeof fuzz_targets[0] };

static const struct fuzz_target *fuzz_find_target(const char *name)
{
    for (int i = 0; i < FUZZ_TARGETS; i++)
        if (name && strcmp(name, fuzz_targets[i].name) == 0)
            return fuzz_targets + i;
    fprintf(stderr, "fuzz: %s is no target\n", name ? name : "(nothing)");
    exit(2);
}

#if defined(FUZZ_LIBFUZZER)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const struct fuzz_target *target;
    if (!target)
        target = fuzz_find_target(getenv("FUZZ_TARGET"));
    target->run(data, size);
    return 0;
}

#else

enum { FUZZ_MAX_SIZE = 4096 };

typedef struct fuzz_input {
    uint8_t *data;
    size_t size;
} fuzz_input;

static uint64_t fuzz_random(uint64_t *state)
{
    uint64_t x = *state;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    *state = x;
    return (x * 2685821657736338717u) >> 16;
}

/* One change in place; returns the new size, at most FUZZ_MAX_SIZE. */
static size_t fuzz_mutate(uint8_t *data, size_t size, uint64_t *state)
{
    static const char numbers[12][21] = {"-1",         "0",  "7",   "4000000000",           "nan",  "1e999",
                                         "2147483647", "-5", "3.5", "18446744073709551616", "1e-9", "x"};
    size_t at = size ? (size_t)(fuzz_random(state) % size) : 0, length = (size_t)(fuzz_random(state) % 20);
    const char *number = numbers[fuzz_random(state) % 12];
    if (size == 0) {
        data[0] = (uint8_t)fuzz_random(state);
        return 1;
    }
    switch (fuzz_random(state) % 9) {
    case 0: data[at] ^= (uint8_t)(1u << fuzz_random(state) % 8); break;
    case 1: data[at] = (uint8_t)fuzz_random(state); break;
    case 2: return at;
    case 3: /* a number of the list over what stands there */
        memcpy(data + at, number, strlen(number) < size - at ? strlen(number) : size - at);
        break;
    case 4: /* cut a piece out */
        length = length < size - at ? length : size - at;
        memmove(data + at, data + at + length, size - at - length);
        return size - length;
    case 5: /* write one place over another */
        if (at + length < size)
            memmove(data + fuzz_random(state) % (size - length), data + at, length);
        break;
    case 6: /* more bytes */
        for (size_t k = 0; k < length && size < FUZZ_MAX_SIZE; k++)
            data[size++] = (uint8_t)fuzz_random(state);
        break;
    case 7: /* a piece twice */
        if (at + length < size && size + length < FUZZ_MAX_SIZE) {
            memmove(data + at + length, data + at, size - at);
            return size + length;
        }
        break;
    default: data[at] = data[fuzz_random(state) % size]; break;
    }
    return size;
}

/* The input that is being run, for the handler of signals. */
static struct fuzz_current {
    const char *target;
    const uint8_t *data;
    size_t size;
} fuzz_current;

/* Runs an input that lies in memory of its own size, so that a reader past the end is seen. */
static void fuzz_run(const struct fuzz_target *target, const uint8_t *data, size_t size)
{
    uint8_t *exact = (uint8_t *)malloc(size ? size : 1);
    if (!exact)
        return;
    memcpy(exact, data, size);
    fuzz_current.target = target->name;
    fuzz_current.data = data;
    fuzz_current.size = size;
    target->run(exact, size);
    free(exact);
}

/* Writes the input that ended the program. */
static void fuzz_crash(int number)
{
    char path[64];
    FILE *file;
    snprintf(path, sizeof path, "build/fuzz-%s.crash", fuzz_current.target);
    file = fopen(path, "wb");
    if (file) {
        fwrite(fuzz_current.data, 1, fuzz_current.size, file);
        fclose(file);
    }
    signal(number, SIG_DFL);
    raise(number);
}

static long fuzz_run_mutations(const struct fuzz_target *target, const fuzz_input *inputs, int count, double seconds)
{
    uint8_t data[FUZZ_MAX_SIZE + 32];
    uint64_t state = 1;
    time_t start = time(NULL);
    long runs = 0;
    for (; count > 0 && difftime(time(NULL), start) < seconds; runs++) {
        const fuzz_input *input = inputs + fuzz_random(&state) % (uint64_t)count;
        size_t size = input->size;
        memcpy(data, input->data, size);
        for (uint64_t k = 0, changes = 1 + fuzz_random(&state) % 5; k < changes; k++)
            size = fuzz_mutate(data, size, &state);
        fuzz_run(target, data, size);
    }
    return runs;
}

static int fuzz_read_file(const char *path, fuzz_input *input)
{
    FILE *file = fopen(path, "rb");
    input->data = (uint8_t *)malloc(FUZZ_MAX_SIZE);
    input->size = 0;
    if (!file || !input->data) {
        fprintf(stderr, "fuzz: %s cannot be read\n", path);
        return 0;
    }
    input->size = fread(input->data, 1, FUZZ_MAX_SIZE, file);
    fclose(file);
    return 1;
}

int main(int argc, char **argv)
{
    const struct fuzz_target *target = fuzz_find_target(argc > 1 ? argv[1] : NULL);
    double seconds = argc > 2 && argv[2][0] == '-' ? strtod(argv[2] + 1, NULL) : 0;
    int first = argc > 2 && argv[2][0] == '-' ? 3 : 2, count = argc > first ? argc - first : 0, passed = 0;
    fuzz_input *inputs = (fuzz_input *)calloc((size_t)count + 1, sizeof *inputs);
    signal(SIGABRT, fuzz_crash);
    signal(SIGSEGV, fuzz_crash);
    signal(SIGFPE, fuzz_crash);
    for (int i = 0; inputs && i < count; i++)
        if (fuzz_read_file(argv[first + i], inputs + i)) {
            fuzz_run(target, inputs[i].data, inputs[i].size);
            passed++;
        }
    if (seconds > 0 && passed == count)
        printf("%s: %ld mutations\n", target->name, fuzz_run_mutations(target, inputs, count, seconds));
    for (int i = 0; inputs && i < count; i++)
        free(inputs[i].data);
    free(inputs);
    printf("%d passed, %d failed, 0 skipped\n", passed, count - passed);
    return passed != count;
}

#endif
