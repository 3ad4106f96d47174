/* umesh: a network learns how a beam bends, and says by how much it is off.
 *
 *     umesh generate DATA [OPTIONS]           static solves under forces of chance: a row of DATA for each
 *     umesh train DATA WEIGHTS [OPTIONS]      a U-Net learns the first four fifths of them
 *     umesh evaluate DATA WEIGHTS [OPTIONS]   its errors on the last fifth, and what a solve saves that starts from it
 *
 * After Brunet, Simulation of soft tissue for augmented reality, 2020, section 5.6. The beam is clamped at one end, of
 * 4 mm cells, E 3000 Pa, nu 0.45, and a patch of its surface is pulled by some force into some direction; one side of
 * it is seen. The network is given the displacements of that side and answers with those of all nodes (sb_network).
 * Errors are those of the mean, of the median and of the worst sample: a few are far off, whose force acts where nobody
 * sees it. --shard I/N generates a share of the rows; examples/study/merge.sh joins the files. The same data and seed
 * give the same weights. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a solve failed or
 * memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "network_train.h"
#include "options.h"
#include "plot.h"
#include "shard.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, ACROSS = 8 };
static const double cell = 0.004, young = 3000, poisson = 0.45, strongest = 0.02; /* m, Pa, N */

typedef struct settings {
    const char *out, *shard; /* NAME.svg and NAME.csv */
    int samples, seed, along, channels, epochs, batch, solves, help;
    double rate;
} settings;

/* The beam, and the samples that were read. */
typedef struct work {
    const settings *set;
    sb_grid grid;
    sb_body *body;
    int *seen, seen_count; /* nodes of the side */
    sb_vec3 *known;        /* [seen_count] */
    size_t nodes;          /* of the lattice and of the grid */
    size_t *place;         /* [nodes] of the grid's nodes in the lattice */
    unsigned char *mask;   /* [nodes] */
    int count;
    float *shapes; /* [count][nodes of the grid][3] (m) */
    float *input, *target, *output;
} work;

static int complain(const char *about, const char *what, int status)
{
    progress_end();
    fprintf(stderr, "umesh: %s: %s\n", about, what);
    return status;
}

static int no_memory(void) { return complain("memory", "is short", EXIT_SOLVE); }

/* ---- the beam ---------------------------------------------------------------------------------------------------- */

static sb_real beam_distance(void *user, sb_vec3 x)
{
    const work *w = (const work *)user;
    sb_real half = (sb_real)(cell * (ACROSS - 1) / 2), middle = (sb_real)(cell * (w->set->along - 1) / 2);
    sb_real side = sb_max(sb_abs(x.y - half), sb_abs(x.z - half)) - half;
    return sb_max(sb_abs(x.x - middle) - middle, side);
}

static int make_grid(work *w)
{
    sb_grid_def def = sb_default_grid_def();
    sb_error error;
    def.outer.distance = beam_distance;
    def.outer.max_slope = 1;
    def.outer.user = w;
    def.counts[0] = w->set->along - 1;
    def.counts[1] = def.counts[2] = ACROSS - 1;
    def.high = sb_v3((sb_real)(cell * def.counts[0]), (sb_real)(cell * def.counts[1]), (sb_real)(cell * def.counts[2]));
    return sb_grid_create(&def, &w->grid, &error) ? complain("the grid", error.message, EXIT_SOLVE) : 0;
}

static int make_body(work *w)
{
    sb_body_def def = sb_default_body_def();
    sb_error error;
    def.mesh = &w->grid.body_mesh;
    def.domain = &w->grid.domain;
    def.material = sb_material_stable_neo_hookean((sb_real)young, (sb_real)poisson, 1000);
    if (sb_body_create(&def, &w->body, &error))
        return complain("the beam", error.message, EXIT_SOLVE);
    for (int i = 0; i < w->grid.mesh.node_count; i++)
        if (w->grid.mesh.nodes[i].x < (sb_real)(cell / 2) && sb_body_fix_nodes(w->body, &i, 1, SB_XYZ))
            return complain("the beam", "cannot be clamped", EXIT_SOLVE);
    return 0;
}

/* The side of largest z is seen, but for its clamped end. */
static int make_sides(work *w)
{
    const sb_mesh *mesh = &w->grid.mesh;
    w->nodes = (size_t)w->set->along * ACROSS * ACROSS;
    w->seen = (int *)malloc(w->nodes * sizeof *w->seen);
    w->known = (sb_vec3 *)malloc(w->nodes * sizeof *w->known);
    w->place = (size_t *)malloc(w->nodes * sizeof *w->place);
    w->mask = (unsigned char *)calloc(w->nodes, 1);
    w->input = (float *)malloc(w->nodes * SB_NETWORK_CHANNELS * sizeof(float));
    w->target = (float *)calloc(w->nodes, 3 * sizeof(float));
    w->output = (float *)calloc(w->nodes, 3 * sizeof(float));
    if (!w->seen || !w->known || !w->place || !w->mask || !w->input || !w->target || !w->output)
        return no_memory();
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = sb_v3_scale((sb_real)(1 / cell), mesh->nodes[i]);
        size_t at[3] = {(size_t)((double)x.x + 0.5), (size_t)((double)x.y + 0.5), (size_t)((double)x.z + 0.5)};
        w->place[i] = (at[2] * ACROSS + at[1]) * (size_t)w->set->along + at[0];
        w->mask[w->place[i]] = 1;
        if (at[2] == ACROSS - 1 && at[0] > 0)
            w->seen[w->seen_count++] = i;
    }
    return 0;
}

static void free_work(work *w)
{
    sb_body_destroy(w->body);
    sb_grid_free(&w->grid);
    free(w->seen), free(w->known), free(w->place), free(w->mask), free(w->shapes);
    free(w->input), free(w->target), free(w->output);
}

/* ---- generate ---------------------------------------------------------------------------------------------------- */

/* Even in [-1, 1). */
static double chance(uint64_t *state) { return 2 * train_random(state) - 1; }

/* Sample k's force, spread evenly over the surface nodes within 3 cells of one of them. */
static int pull(work *w, int k)
{
    const sb_mesh *mesh = &w->grid.mesh;
    uint64_t state = ((uint64_t)w->set->seed << 32 | (uint64_t)k) * 0x9E3779B97F4A7C15u + 1;
    sb_vec3 direction = sb_v3(0, 0, 0), centre;
    int count = 0, *nodes = (int *)malloc(w->nodes * sizeof *nodes), bad;
    if (!nodes)
        return no_memory();
    while (sb_v3_norm(direction) < (sb_real)0.1 || sb_v3_norm(direction) > 1)
        direction = sb_v3((sb_real)chance(&state), (sb_real)chance(&state), (sb_real)chance(&state));
    centre = sb_v3((sb_real)(cell * (w->set->along - 1) * train_random(&state)), 0, 0);
    centre.y = (sb_real)(cell * (ACROSS - 1) * train_random(&state));
    centre.z = train_random(&state) < 0.5 ? 0 : (sb_real)(cell * (ACROSS - 1));
    if (train_random(&state) < 0.5) {
        sb_real y = centre.y;
        centre.y = centre.z;
        centre.z = y;
    }
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], centre)) < (sb_real)(3 * cell))
            nodes[count++] = i;
    direction = sb_v3_scale((sb_real)(strongest * train_random(&state) / count) / sb_v3_norm(direction), direction);
    sb_body_clear_loads(w->body);
    bad = sb_body_add_forces(w->body, nodes, count, &direction, 1) != SB_OK;
    free(nodes);
    return bad ? complain("the force", "is refused", EXIT_SOLVE) : 0;
}

/* From rest each, so that no sample depends on another. */
static int solve_sample(work *w, int k, sb_step_info *info)
{
    int status = pull(w, k);
    sb_body_reset(w->body);
    if (status)
        return status;
    return sb_body_solve_static(w->body, NULL, info) ? complain("a solve", info->error.message, EXIT_SOLVE) : 0;
}

/* "k,ux,uy,uz,..." in mm of all nodes. */
static int write_sample(work *w, shard *s, int k)
{
    const sb_vec3 *u = sb_body_displacements(w->body);
    size_t size = 32 + (size_t)w->grid.mesh.node_count * 48, used;
    char *row = (char *)malloc(size);
    int good;
    if (!row)
        return no_memory();
    used = (size_t)snprintf(row, size, "%d", k);
    for (int i = 0; i < w->grid.mesh.node_count; i++)
        used += (size_t)snprintf(row + used, size - used, ",%.6g,%.6g,%.6g", 1e3 * (double)u[i].x, 1e3 * (double)u[i].y,
                                 1e3 * (double)u[i].z);
    snprintf(row + used, size - used, "\n");
    good = shard_write(s, row);
    free(row);
    return good ? 0 : EXIT_USAGE;
}

/* What all shards of a study have in common. */
static void print_heading(const work *w, char *text, size_t size)
{
    snprintf(text, size, "# umesh cases=%d seed=%d nodes=%dx%dx%d\nsample,displacements of all nodes (mm)\n",
             w->set->samples, w->set->seed, w->set->along, (int)ACROSS, (int)ACROSS);
}

static int generate(work *w, const char *path)
{
    char heading[128];
    shard s;
    int status = 0;
    sb_step_info info;
    if (!shard_parse("umesh", w->set->shard, &s))
        return EXIT_USAGE;
    print_heading(w, heading, sizeof heading);
    status = shard_open(&s, path, heading, w->set->samples) ? 0 : EXIT_USAGE;
    if (!status)
        printf("generate: %d samples, shard %d of %d, %d to do\n", w->set->samples, s.index + 1, s.count, s.left);
    for (int k = 0; !status && k < w->set->samples; k++)
        if (shard_is_mine(&s, k)) {
            progress_show((double)k / w->set->samples, "static solves");
            status = solve_sample(w, k, &info);
            if (!status)
                status = write_sample(w, &s, k);
        }
    progress_end();
    shard_close(&s);
    return status;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

/* One number behind a comma. */
static int read_number(FILE *file, float *value)
{
    double number;
    if (fscanf(file, ",%lf", &number) != 1 || !(fabs(number) < 1e6))
        return 0;
    *value = (float)(1e-3 * number);
    return 1;
}

static int read_samples(work *w, const char *path)
{
    char heading[128], found[128] = "";
    FILE *file = fopen(path, "r");
    size_t numbers = 3 * (size_t)w->grid.mesh.node_count;
    int good, k;
    if (!file)
        return complain(path, "cannot be opened", EXIT_USAGE);
    w->count = w->set->samples;
    w->shapes = (float *)calloc((size_t)w->count, numbers * sizeof(float));
    print_heading(w, heading, sizeof heading);
    good = fread(found, 1, strlen(heading), file) == strlen(heading) && strcmp(found, heading) == 0;
    for (int row = 0; w->shapes && good && row < w->count; row++) {
        good = fscanf(file, "%d", &k) == 1 && k >= 0 && k < w->count;
        for (size_t i = 0; good && i < numbers; i++)
            good = read_number(file, w->shapes + (size_t)k * numbers + i);
    }
    fclose(file);
    if (!w->shapes)
        return no_memory();
    return good ? 0 : complain(path, "has not all samples of these --samples, --seed and --along", EXIT_USAGE);
}

/* Channels of sample k's side, as sb_network_predict has them, and the answer over the size, which is returned (m). */
static double fill_sample(work *w, int k)
{
    const float *u = w->shapes + 3 * (size_t)k * (size_t)w->grid.mesh.node_count;
    double size = 0;
    for (int j = 0; j < w->seen_count; j++) {
        const float *at = u + 3 * (size_t)w->seen[j];
        w->known[j] = sb_v3((sb_real)at[0], (sb_real)at[1], (sb_real)at[2]);
        size = fmax(size, (double)sb_v3_norm(w->known[j]));
    }
    memset(w->input, 0, w->nodes * SB_NETWORK_CHANNELS * sizeof(float));
    for (int i = 0; i < w->grid.mesh.node_count; i++) {
        float *channel = w->input + w->place[i] * SB_NETWORK_CHANNELS;
        channel[4] = (float)(size / (cell * w->set->along));
        channel[5] = (float)(w->place[i] % (size_t)w->set->along) / (float)(w->set->along - 1);
        channel[6] = 1;
        for (size_t c = 0; c < 3; c++)
            w->target[3 * w->place[i] + c] = size > 0 ? u[3 * (size_t)i + c] / (float)size : 0;
    }
    for (int j = 0; size > 0 && j < w->seen_count; j++) {
        float *channel = w->input + w->place[w->seen[j]] * SB_NETWORK_CHANNELS;
        for (size_t c = 0; c < 3; c++)
            channel[c] = w->target[3 * w->place[w->seen[j]] + c];
        channel[3] = 1;
    }
    return size;
}

static int test_begin(const work *w) { return w->count - (w->count + 4) / 5; }

/* ---- train ------------------------------------------------------------------------------------------------------- */

static void begin_network(const work *w, train_network *n)
{
    const int counts[3] = {w->set->along, ACROSS, ACROSS};
    train_begin(n, counts, SB_NETWORK_CHANNELS);
    train_add_unet(n, 3, w->set->channels);
    n->spacing[0] = n->spacing[1] = n->spacing[2] = cell;
    n->length = cell * w->set->along;
    n->poisson = poisson;
}

/* Mean loss of the samples that are not trained with. */
static double validate(work *w, train_network *n)
{
    double sum = 0;
    for (int k = test_begin(w); k < w->count; k++) {
        fill_sample(w, k);
        train_forward(n, w->input);
        sum += train_measure(n, w->target, w->mask) / (w->count - test_begin(w));
    }
    return sum;
}

/* Another order for each epoch (Fisher and Yates). */
static void shuffle(int *order, int count, uint64_t *state)
{
    for (int i = count - 1; i > 0; i--) {
        int j = (int)(train_random(state) * (i + 1)), other = order[j];
        order[j] = order[i];
        order[i] = other;
    }
}

/* Weights that do best on what they have not seen are kept in `best`. */
static void train_epochs(work *w, train_network *n, int *order, float *best)
{
    int count = test_begin(w), batch = w->set->batch, steps = w->set->epochs * ((count + batch - 1) / batch);
    uint64_t state = (uint64_t)w->set->seed + 1;
    double least = (double)INFINITY;
    for (int k = 0; k < count; k++)
        order[k] = k;
    for (int epoch = 0; epoch < w->set->epochs; epoch++) {
        double loss;
        shuffle(order, count, &state);
        for (int k = 0; k < count; k++) {
            fill_sample(w, order[k]);
            train_forward(n, w->input);
            train_measure(n, w->target, w->mask);
            train_backward(n);
            if (k % batch == batch - 1 || k == count - 1)
                train_adam(n, train_cosine(w->set->rate, n->steps, steps), k % batch + 1);
            progress_show((epoch + (double)k / count) / w->set->epochs, "training");
        }
        loss = validate(w, n);
        if (loss < least) {
            least = loss;
            memcpy(best, n->weights, n->weight_count * sizeof *best);
        }
    }
    memcpy(n->weights, best, n->weight_count * sizeof *best);
    progress_end();
    printf("trained: %d samples, %d epochs, %lu weights, root of the loss on %d others %.4f\n", count, w->set->epochs,
           (unsigned long)n->weight_count, w->count - count, sqrt(least));
}

static int train(work *w, const char *weights)
{
    train_network n;
    int *order, status = 0;
    float *best;
    begin_network(w, &n);
    if (!train_allocate(&n, (uint64_t)w->set->seed))
        return no_memory();
    order = (int *)malloc((size_t)w->count * sizeof *order);
    best = (float *)malloc(n.weight_count * sizeof *best);
    if (!order || !best)
        status = no_memory();
    else
        train_epochs(w, &n, order, best);
    if (!status && !train_save(&n, weights))
        status = complain(weights, "cannot be written", EXIT_USAGE);
    if (!status)
        printf("%s written\n", weights);
    free(order), free(best);
    train_free(&n);
    return status;
}

/* ---- evaluate ---------------------------------------------------------------------------------------------------- */

/* |answer - truth| / |truth| of all nodes, in the mean square. */
static double error_of(const work *w)
{
    double off = 0, all = 0;
    for (size_t i = 0; i < 3 * w->nodes; i++) {
        double difference = (double)w->output[i] - (double)w->target[i];
        off += w->mask[i / 3] ? difference * difference : 0;
        all += (double)w->target[i] * (double)w->target[i];
    }
    return all > 0 ? sqrt(off / all) : 0;
}

static int by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Newton iterations from rest and from the network, of the first samples of the test. */
static int compare_starts(work *w, sb_network *network)
{
    int without = 0, with = 0, taken = 0, tests = w->count - test_begin(w),
        count = w->set->solves < tests ? w->set->solves : tests;
    for (int k = test_begin(w); k < test_begin(w) + count; k++) {
        sb_network_input input = sb_default_network_input();
        sb_network_info info;
        sb_step_info plain;
        sb_error error;
        int status = solve_sample(w, k, &plain);
        if (status)
            return status;
        fill_sample(w, k);
        sb_body_reset(w->body);
        input.nodes = w->seen;
        input.displacements = w->known;
        input.count = w->seen_count;
        input.policy = SB_NETWORK_START;
        if (sb_network_predict(network, &w->grid, w->body, &input, &info, &error))
            return complain("a guess", error.message, EXIT_SOLVE);
        without += plain.newton_iterations;
        with += info.solve.newton_iterations;
        taken += info.taken;
    }
    printf("starts: %d solves, %d from the network, %d Newton iterations, %d without\n", count, taken, with, without);
    return 0;
}

/* NAME.csv and NAME.svg: errors in order. */
static int write_errors(const work *w, const double *sorted, double *share, int count)
{
    char name[512];
    plot p;
    plot_panel *panel;
    sb_output out;
    sb_error error;
    snprintf(name, sizeof name, "%s.csv", w->set->out);
    if (sb_output_open(&out, name, &error))
        return complain(name, error.message, EXIT_USAGE);
    fprintf(out.file, "share of samples,relative error\n");
    for (int i = 0; i < count; i++) {
        share[i] = (i + 0.5) / count;
        fprintf(out.file, "%.6g,%.6g\n", share[i], sorted[i]);
    }
    if (sb_output_close(&out, &error))
        return complain(name, error.message, EXIT_USAGE);
    plot_begin(&p, "A network's errors on a beam");
    panel = plot_add_panel(&p, "samples it was not trained with", "share of samples", "relative error");
    panel->log_y = 1;
    plot_add_curve(panel, "error up to this share", share, sorted, count)->markers = 1;
    snprintf(name, sizeof name, "%s.svg", w->set->out);
    if (!plot_save_svg(&p, name))
        return complain(name, "cannot be written", EXIT_USAGE);
    printf("%s written\n", name);
    return 0;
}

static int measure_errors(work *w, sb_network *network)
{
    int begin = test_begin(w), count = w->count - begin, status;
    double *errors = (double *)malloc(2 * (size_t)count * sizeof *errors), mean = 0;
    if (!errors)
        return no_memory();
    for (int k = 0; k < count; k++) {
        fill_sample(w, begin + k);
        if (sb_network_run(network, w->input, w->output)) {
            free(errors);
            return complain("the network", "gives what is no number", EXIT_SOLVE);
        }
        errors[k] = error_of(w);
        mean += errors[k] / count;
    }
    qsort(errors, (size_t)count, sizeof *errors, by_size);
    printf("relative error: median %.4f, mean %.4f, worst %.4f of %d samples\n", errors[count / 2], mean,
           errors[count - 1], count);
    status = write_errors(w, errors, errors + count, count);
    free(errors);
    return status;
}

static int evaluate(work *w, const char *weights)
{
    sb_network *network = NULL;
    sb_network_shape shape;
    sb_error error;
    int status;
    if (sb_network_load(weights, NULL, &network, &error))
        return complain(weights, error.message, EXIT_USAGE);
    shape = sb_network_get_shape(network);
    if (shape.counts[0] != w->set->along || shape.counts[1] != ACROSS || shape.counts[2] != ACROSS ||
        shape.inputs != SB_NETWORK_CHANNELS || shape.outputs != 3)
        status = complain(weights, "is of another beam", EXIT_USAGE);
    else
        status = measure_errors(w, network);
    if (!status)
        status = compare_starts(w, network);
    sb_network_destroy(network);
    return status;
}

/* ---- the program ------------------------------------------------------------------------------------------------- */

static int run(work *w, const char *const files[3])
{
    int is_generate = strcmp(files[0], "generate") == 0, is_train = strcmp(files[0], "train") == 0, status;
    if (!is_generate && !is_train && strcmp(files[0], "evaluate") != 0)
        return complain(files[0], "is none of generate, train, evaluate", EXIT_USAGE);
    if (!files[1] || (!is_generate && !files[2]))
        return complain(files[0], is_generate ? "needs DATA" : "needs DATA and WEIGHTS", EXIT_USAGE);
    status = make_grid(w);
    if (!status)
        status = make_body(w);
    if (!status)
        status = make_sides(w);
    if (!status && is_generate)
        return generate(w, files[1]);
    if (!status)
        status = read_samples(w, files[1]);
    return status ? status : is_train ? train(w, files[2]) : evaluate(w, files[2]);
}

static int program(int argc, char **argv)
{
    settings set = {"umesh", "1/1", 200, 1, 32, 8, 40, 4, 10, 0, 1e-3};
    const char *files[3] = {NULL, NULL, NULL};
    const option options[] = {
        {"--samples", "N", OPTION_INTEGER, &set.samples, NULL, NULL, 5, 1e6, "static solves, all of a study's"},
        {"--seed", "N", OPTION_INTEGER, &set.seed, NULL, NULL, 0, 1e9, "of chance"},
        {"--along", "N", OPTION_INTEGER, &set.along, NULL, NULL, 8, 1024, "nodes along the beam, a multiple of 8"},
        {"--shard", "I/N", OPTION_TEXT, NULL, NULL, &set.shard, 0, 0, "generate: the I-th of N shares"},
        {"--channels", "N", OPTION_INTEGER, &set.channels, NULL, NULL, 1, 128, "train: channels of the first layer"},
        {"--epochs", "N", OPTION_INTEGER, &set.epochs, NULL, NULL, 1, 1e6, "train: times that all samples are seen"},
        {"--batch", "N", OPTION_INTEGER, &set.batch, NULL, NULL, 1, 1e4, "train: samples of a step"},
        {"--rate", "R", OPTION_NUMBER, NULL, &set.rate, NULL, 1e-9, 1, "train: of Adam at its largest"},
        {"--solves", "N", OPTION_INTEGER, &set.solves, NULL, NULL, 1, 1e6, "evaluate: starts that are compared"},
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &set.out, 0, 0, "evaluate: NAME.svg and NAME.csv"},
        {"--help", NULL, OPTION_FLAG, &set.help, NULL, NULL, 0, 0, "this text"},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    work w;
    int status;
    if (!options_parse("umesh", options, count, files, 3, argc, argv))
        return EXIT_USAGE;
    if (set.help) {
        puts("umesh generate DATA | train DATA WEIGHTS | evaluate DATA WEIGHTS [OPTIONS]: a network learns a beam");
        options_print(options, count);
        return 0;
    }
    if (!files[0])
        return complain("the first word", "must be generate, train or evaluate", EXIT_USAGE);
    if (set.along % 8 != 0)
        return complain("--along", "needs a multiple of 8", EXIT_USAGE);
    memset(&w, 0, sizeof w);
    w.set = &set;
    status = run(&w, files);
    free_work(&w);
    return status;
}

int main(int argc, char **argv) { return finish("umesh", program(argc, argv), EXIT_USAGE); }
