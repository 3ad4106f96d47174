/* umesh: a network learns how a beam or an organ bends, and says by how much it is off.
 *
 *     umesh generate DATA [OPTIONS]           static solves under forces of chance: a row of DATA for each
 *     umesh train DATA WEIGHTS [OPTIONS]      a U-Net learns the first four fifths of them
 *     umesh evaluate DATA WEIGHTS [OPTIONS]   its errors on the last fifth, and what a solve saves that starts from it
 *     umesh all [OPTIONS]                     one after the other, timed; weights are NAME.sbnet
 *
 * After Brunet, Simulation of soft tissue for augmented reality, 2020, section 5.6. The beam is clamped at one end, of
 * 4 mm cells, E 3000 Pa, nu 0.45, and a patch of its surface is pulled by some force into some direction; one side of
 * it is seen. --organ FILE takes the closed surface of triangles in FILE (m) instead, in a grid of weighted cells: what
 * lies farthest to low x + z is held, the skin that looks up (z) is seen. The network is given the displacements of
 * what is seen and answers with those of all nodes (sb_network). Errors are those of the mean, of the median and of the
 * worst sample: a few are far off, whose force acts where nobody sees it. Targets are the centres of cells that are
 * more than half inside. --shard I/N generates a share of the rows; examples/study/merge.sh joins the files. The same
 * data and seed give the same weights. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a
 * solve failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "picture.h"
#include "plot.h"
#include "shard.h"
#include "umesh_scene.h"

typedef struct settings {
    const char *out, *shard; /* NAME of files */
    tissue_def tissue;
    int samples, seed, levels, channels, epochs, batch, solves, help;
    double rate;
} settings;

/* The tissue, and the samples that were read. */
typedef struct work {
    const settings *set;
    tissue t;
    sb_vec3 *known; /* [t.seen_count] */
    int count;
    float *shapes; /* [count][nodes of the grid][3] (m) */
    float *input, *target, *output;
} work;

static int make_work(work *w)
{
    int status = tissue_make(&w->t, &w->set->tissue);
    if (status)
        return status;
    w->known = (sb_vec3 *)malloc((size_t)w->t.seen_count * sizeof *w->known);
    w->input = (float *)malloc(w->t.nodes * SB_NETWORK_CHANNELS * sizeof(float));
    w->target = (float *)calloc(w->t.nodes, 3 * sizeof(float));
    w->output = (float *)calloc(w->t.nodes, 3 * sizeof(float));
    return w->known && w->input && w->target && w->output ? 0 : no_memory();
}

static void free_work(work *w)
{
    tissue_free(&w->t);
    free(w->known), free(w->shapes), free(w->input), free(w->target), free(w->output);
}

/* ---- generate ---------------------------------------------------------------------------------------------------- */

/* "k,ux,uy,uz,..." in mm of all nodes. */
static int write_sample(work *w, shard *s, int k)
{
    const sb_vec3 *u = sb_body_displacements(w->t.body);
    size_t size = 32 + (size_t)w->t.grid.mesh.node_count * 48, used;
    char *row = (char *)malloc(size);
    int good;
    if (!row)
        return no_memory();
    used = (size_t)snprintf(row, size, "%d", k);
    for (int i = 0; i < w->t.grid.mesh.node_count; i++)
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
             w->set->samples, w->set->seed, w->t.counts[0], w->t.counts[1], w->t.counts[2]);
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
            status = tissue_solve(&w->t, w->set->seed, k, &info);
            if (!status)
                status = write_sample(w, &s, k);
        }
    progress_end();
    shard_close(&s);
    return status;
}

/* The same, kept in memory. */
static int keep_samples(work *w)
{
    size_t numbers = 3 * (size_t)w->t.grid.mesh.node_count;
    double begin = seconds_now(), most = 0;
    sb_step_info info;
    int status = 0;
    w->count = w->set->samples;
    w->shapes = (float *)calloc((size_t)w->count, numbers * sizeof(float));
    if (!w->shapes)
        return no_memory();
    for (int k = 0; k < w->count && !status; k++) {
        double largest = 0;
        progress_show((double)k / w->count, "static solves");
        status = tissue_solve(&w->t, w->set->seed, k, &info);
        for (int i = 0; i < w->t.grid.mesh.node_count; i++) {
            sb_vec3 u = sb_body_displacements(w->t.body)[i];
            float *to = w->shapes + (size_t)k * numbers + 3 * (size_t)i;
            to[0] = (float)u.x, to[1] = (float)u.y, to[2] = (float)u.z;
            largest = fmax(largest, (double)sb_v3_norm(u));
        }
        most += largest / w->count;
    }
    progress_end();
    if (!status)
        printf("generated: %d samples of %d nodes, %d of them seen, largest displacement %.1f mm in the mean, %.1f s\n",
               w->count, w->t.grid.mesh.node_count, w->t.seen_count, 1e3 * most, seconds_now() - begin);
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
    size_t numbers = 3 * (size_t)w->t.grid.mesh.node_count;
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

/* Place of a node of the lattice along its longest side, 0 to 1. */
static float place_along(const tissue *t, size_t place)
{
    int at[3], longest = 0;
    train_place(t->counts, place, at);
    for (int axis = 1; axis < 3; axis++)
        if (t->counts[axis] > t->counts[longest])
            longest = axis;
    return (float)at[longest] / (float)(t->counts[longest] - 1);
}

/* Channels of sample k's side, as sb_network_predict has them, and the answer over the size, which is returned (m). */
static double fill_sample(work *w, int k)
{
    const float *u = w->shapes + 3 * (size_t)k * (size_t)w->t.grid.mesh.node_count;
    double size = 0;
    for (int j = 0; j < w->t.seen_count; j++) {
        const float *at = u + 3 * (size_t)w->t.seen[j];
        w->known[j] = sb_v3((sb_real)at[0], (sb_real)at[1], (sb_real)at[2]);
        size = fmax(size, (double)sb_v3_norm(w->known[j]));
    }
    memset(w->input, 0, w->t.nodes * SB_NETWORK_CHANNELS * sizeof(float));
    for (int i = 0; i < w->t.grid.mesh.node_count; i++) {
        float *channel = w->input + w->t.place[i] * SB_NETWORK_CHANNELS;
        channel[4] = (float)(size / w->t.length);
        channel[5] = place_along(&w->t, w->t.place[i]);
        channel[6] = 1;
        for (size_t c = 0; c < 3; c++)
            w->target[3 * w->t.place[i] + c] = size > 0 ? u[3 * (size_t)i + c] / (float)size : 0;
    }
    for (int j = 0; size > 0 && j < w->t.seen_count; j++) {
        float *channel = w->input + w->t.place[w->t.seen[j]] * SB_NETWORK_CHANNELS;
        for (size_t c = 0; c < 3; c++)
            channel[c] = w->target[3 * w->t.place[w->t.seen[j]] + c];
        channel[3] = 1;
    }
    return size;
}

static int test_begin(const work *w) { return w->count - (w->count + 4) / 5; }

/* ---- train ------------------------------------------------------------------------------------------------------- */

static void begin_network(const work *w, train_network *n)
{
    train_begin(n, w->t.counts, SB_NETWORK_CHANNELS);
    train_add_unet(n, w->set->levels, w->set->channels);
    n->spacing[0] = n->spacing[1] = n->spacing[2] = w->t.cell;
    n->length = w->t.length;
    n->poisson = poisson;
}

/* Mean loss of the samples that are not trained with. */
static double validate(work *w, train_network *n)
{
    double sum = 0;
    for (int k = test_begin(w); k < w->count; k++) {
        fill_sample(w, k);
        train_forward(n, w->input);
        sum += train_measure(n, w->target, w->t.mask) / (w->count - test_begin(w));
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
            train_measure(n, w->target, w->t.mask);
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

/* ---- errors ------------------------------------------------------------------------------------------------------ */

/* |answer - truth| / |truth| of all nodes, in the mean square. */
static double error_of(const work *w)
{
    double off = 0, all = 0;
    for (size_t i = 0; i < 3 * w->t.nodes; i++) {
        double difference = (double)w->output[i] - (double)w->target[i];
        off += w->t.mask[i / 3] ? difference * difference : 0;
        all += (double)w->target[i] * (double)w->target[i];
    }
    return all > 0 ? sqrt(off / all) : 0;
}

/* Mean distance (m) of the centres of cells from where they belong, of cells more than half inside. */
static double target_error(const work *w, double size)
{
    const sb_mesh *mesh = &w->t.grid.mesh;
    double sum = 0;
    int count = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        double off[3] = {0, 0, 0};
        if (w->t.grid.shares[e] < (sb_real)0.5)
            continue;
        for (int a = 0; a < 8; a++)
            for (size_t c = 0; c < 3; c++) {
                size_t at = 3 * w->t.place[mesh->elements[8 * e + a]] + c;
                off[c] += size / 8 * ((double)w->output[at] - (double)w->target[at]);
            }
        sum += sqrt(off[0] * off[0] + off[1] * off[1] + off[2] * off[2]);
        count++;
    }
    return count ? sum / count : 0;
}

/* A sample's: relative error, error of targets (m). */
typedef struct score {
    int sample;
    double relative, target;
} score;

static int by_relative(const void *a, const void *b)
{
    double x = ((const score *)a)->relative, y = ((const score *)b)->relative;
    return (x > y) - (x < y);
}

static int by_target(const void *a, const void *b)
{
    double x = ((const score *)a)->target, y = ((const score *)b)->target;
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
        int status = tissue_solve(&w->t, w->set->seed, k, &plain);
        if (status)
            return status;
        fill_sample(w, k);
        sb_body_reset(w->t.body);
        input.nodes = w->t.seen;
        input.displacements = w->known;
        input.count = w->t.seen_count;
        input.policy = SB_NETWORK_START;
        if (sb_network_predict(network, &w->t.grid, w->t.body, &input, &info, &error))
            return complain("a guess", error.message, EXIT_SOLVE);
        without += plain.newton_iterations;
        with += info.solve.newton_iterations;
        taken += info.taken;
    }
    printf("starts: %d solves, %d from the network, %d Newton iterations, %d without\n", count, taken, with, without);
    return 0;
}

/* NAME.csv: errors in order. */
static int write_table(const work *w, const score *sorted, int count)
{
    char name[512];
    sb_output out;
    sb_error error;
    snprintf(name, sizeof name, "%s.csv", w->set->out);
    if (sb_output_open(&out, name, &error))
        return complain(name, error.message, EXIT_USAGE);
    fprintf(out.file, "share of samples,relative error,error of targets (mm)\n");
    for (int i = 0; i < count; i++)
        fprintf(out.file, "%.6g,%.6g,%.6g\n", (i + 0.5) / count, sorted[i].relative, 1e3 * sorted[i].target);
    return sb_output_close(&out, &error) ? complain(name, error.message, EXIT_USAGE) : 0;
}

/* NAME.svg: the same. */
static int write_chart(const work *w, const score *sorted, int count)
{
    char name[512];
    plot p;
    plot_panel *panel;
    double *numbers = (double *)malloc(2 * (size_t)count * sizeof *numbers);
    int good;
    if (!numbers)
        return no_memory();
    for (int i = 0; i < count; i++) {
        numbers[i] = (i + 0.5) / count;
        numbers[count + i] = sorted[i].relative;
    }
    plot_begin(&p, "A network's errors");
    panel = plot_add_panel(&p, "samples it was not trained with", "share of samples", "relative error");
    panel->log_y = 1;
    plot_add_curve(panel, "error up to this share", numbers, numbers + count, count)->markers = 1;
    snprintf(name, sizeof name, "%s.svg", w->set->out);
    good = plot_save_svg(&p, name);
    free(numbers);
    if (!good)
        return complain(name, "cannot be written", EXIT_USAGE);
    printf("%s written\n", name);
    return 0;
}

/* The network's answer for sample k, with what is held where it belongs as sb_network_predict puts it, and how good it
 * is. */
static int answer(work *w, sb_network *network, int k, score *made)
{
    double size = fill_sample(w, k);
    if (sb_network_run(network, w->input, w->output))
        return complain("the network", "gives what is no number", EXIT_SOLVE);
    for (int i = 0; i < w->t.grid.mesh.node_count; i++)
        if (tissue_is_held(&w->t, w->t.grid.mesh.nodes[i]))
            memset(w->output + 3 * w->t.place[i], 0, 3 * sizeof(float));
    made->sample = k;
    made->relative = error_of(w);
    made->target = target_error(w, size);
    return 0;
}

/* scores[count] by relative error. */
static int measure_errors(work *w, sb_network *network, score *scores, int count)
{
    double mean = 0, target = 0, median;
    for (int k = 0; k < count; k++) {
        if (answer(w, network, test_begin(w) + k, scores + k))
            return EXIT_SOLVE;
        mean += scores[k].relative / count;
        target += 1e3 * scores[k].target / count;
    }
    qsort(scores, (size_t)count, sizeof *scores, by_target);
    median = 1e3 * scores[count / 2].target;
    printf("targets: median %.3f mm, mean %.3f, worst %.3f\n", median, target, 1e3 * scores[count - 1].target);
    qsort(scores, (size_t)count, sizeof *scores, by_relative);
    printf("relative error: median %.4f, mean %.4f, worst %.4f of %d samples\n", scores[count / 2].relative, mean,
           scores[count - 1].relative, count);
    return 0;
}

/* ---- picture ----------------------------------------------------------------------------------------------------- */

/* Where the skin goes by the network (m), `to` aside, and how far that is from the truth (mm). */
static void guess_skin(const work *w, double size, sb_vec3 to, sb_vec3 *scratch, sb_vec3 *places, sb_real *distances)
{
    const sb_mapping *rows = &w->t.rows.rows;
    sb_vec3 *off = scratch + w->t.grid.mesh.node_count;
    for (int i = 0; i < w->t.grid.mesh.node_count; i++) {
        const float *u = w->output + 3 * w->t.place[i], *v = w->target + 3 * w->t.place[i];
        sb_real s = (sb_real)size;
        scratch[i] = sb_v3(s * (sb_real)u[0], s * (sb_real)u[1], s * (sb_real)u[2]);
        off[i] = sb_v3_sub(scratch[i], sb_v3(s * (sb_real)v[0], s * (sb_real)v[1], s * (sb_real)v[2]));
    }
    sb_mapping_apply(rows, off, places);
    for (int i = 0; i < rows->row_count; i++)
        distances[i] = 1000 * sb_v3_norm(places[i]);
    sb_mapping_apply(rows, scratch, places);
    for (int i = 0; i < rows->row_count; i++)
        places[i] = sb_v3_add(sb_v3_add(places[i], w->t.skin.nodes[i]), to);
}

enum { SHOWN = 4 };

/* Adds samples from the best fourth to the worst, side by side; returns the largest distance (mm), below 0: no. */
static double add_guesses(work *w, sb_network *network, const score *sorted, int count, picture *p, double high)
{
    size_t nodes = (size_t)w->t.grid.mesh.node_count, rows = (size_t)w->t.skin.node_count;
    sb_vec3 *memory = (sb_vec3 *)malloc((2 * nodes + rows) * sizeof *memory), *places = memory + 2 * nodes;
    sb_real *distances = (sb_real *)malloc(rows * sizeof *distances);
    double apart = (w->t.is_organ ? 1.3 : 2.5) * w->t.cell * w->t.grid.counts[1], most = 0;
    for (int k = 0; k < SHOWN && memory && distances && most >= 0; k++) {
        const score *shown = sorted + (2 * k + 1) * count / (2 * SHOWN);
        sb_mesh skin = w->t.skin;
        sb_vec3 to = sb_v3(0, (sb_real)(apart * k), 0);
        score made;
        if (answer(w, network, shown->sample, &made)) {
            most = -1;
            break;
        }
        guess_skin(w, fill_sample(w, shown->sample), to, memory, places, distances);
        for (size_t i = 0; i < rows; i++)
            most = fmax(most, (double)distances[i]);
        skin.nodes = places;
        picture_add_surface(p, &skin, distances, 0, (sb_real)high);
    }
    most = memory && distances ? most : -1;
    free(memory), free(distances);
    return most;
}

/* NAME.png */
static int draw(work *w, sb_network *network, const score *sorted, int count)
{
    const int width = 1280, height = 960;
    const double high = 1e3 * w->t.cell / 2;
    char name[512], details[160];
    picture p;
    double most;
    int result;
    picture_begin(&p, width, height);
    most = add_guesses(w, network, sorted, count, &p, high);
    picture_render(&p, 55, 30);
    picture_colour_bar(&p, "off the solution", "mm", 0, high, most);
    picture_length_bar(&p);
    snprintf(details, sizeof details, "%d samples learnt; relative error of these %.3f to %.3f", test_begin(w),
             sorted[count / (2 * SHOWN)].relative, sorted[(2 * SHOWN - 1) * count / (2 * SHOWN)].relative);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(),
                 "A network's guesses of what bends");
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(name, sizeof name, "%s.png", w->set->out);
    result = most < 0 ? PICTURE_NO_MEMORY : picture_save_png(&p, name);
    picture_end(&p);
    if (result == PICTURE_NO_FILE)
        return complain(name, "cannot be written", EXIT_USAGE);
    return result == PICTURE_OK ? 0 : no_memory();
}

/* ---- evaluate ---------------------------------------------------------------------------------------------------- */

static int report(work *w, sb_network *network)
{
    int count = w->count - test_begin(w), status;
    score *scores = (score *)malloc((size_t)count * sizeof *scores);
    if (!scores)
        return no_memory();
    status = measure_errors(w, network, scores, count);
    if (!status)
        status = write_table(w, scores, count);
    if (!status)
        status = write_chart(w, scores, count);
    if (!status)
        status = draw(w, network, scores, count);
    free(scores);
    return status ? status : compare_starts(w, network);
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
    if (memcmp(shape.counts, w->t.counts, sizeof shape.counts) != 0 || shape.inputs != SB_NETWORK_CHANNELS ||
        shape.outputs != 3)
        status = complain(weights, "is of another lattice", EXIT_USAGE);
    else
        status = report(w, network);
    sb_network_destroy(network);
    return status;
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

/* Data stay in memory. */
static int run_all(work *w)
{
    char weights[512];
    double begin;
    int status = keep_samples(w);
    snprintf(weights, sizeof weights, "%s.sbnet", w->set->out);
    begin = seconds_now();
    if (!status)
        status = train(w, weights);
    if (!status)
        printf("trained in %.1f s\n", seconds_now() - begin);
    return status ? status : evaluate(w, weights);
}

/* ---- the program ------------------------------------------------------------------------------------------------- */

static int run(work *w, const char *const files[3])
{
    int is_generate = strcmp(files[0], "generate") == 0, is_train = strcmp(files[0], "train") == 0;
    int is_all = strcmp(files[0], "all") == 0, status;
    if (!is_generate && !is_train && !is_all && strcmp(files[0], "evaluate") != 0)
        return complain(files[0], "is none of generate, train, evaluate, all", EXIT_USAGE);
    if (!is_all && (!files[1] || (!is_generate && !files[2])))
        return complain(files[0], is_generate ? "needs DATA" : "needs DATA and WEIGHTS", EXIT_USAGE);
    status = make_work(w);
    if (status)
        return status;
    if (is_all)
        return run_all(w);
    if (is_generate)
        return generate(w, files[1]);
    status = read_samples(w, files[1]);
    return status ? status : is_train ? train(w, files[2]) : evaluate(w, files[2]);
}

static int program(int argc, char **argv)
{
    settings set = {"umesh", "1/1", {NULL, 32, 0}, 200, 1, 2, 8, 40, 1, 10, 0, 1e-3};
    const char *files[3] = {NULL, NULL, NULL};
    const option options[] = {
        {"--samples", "N", OPTION_INTEGER, &set.samples, NULL, NULL, 5, 1e6, "static solves, all of a study's"},
        {"--seed", "N", OPTION_INTEGER, &set.seed, NULL, NULL, 0, 1e9, "of chance"},
        {"--along", "N", OPTION_INTEGER, &set.tissue.along, NULL, NULL, 8, 1024,
         "nodes along it, of a beam a multiple of 8"},
        {"--organ", "FILE", OPTION_TEXT, NULL, NULL, &set.tissue.organ, 0, 0, "its surface (m) instead of a beam"},
        {"--force", "N", OPTION_NUMBER, NULL, &set.tissue.force, NULL, 0, 1e6, "the strongest (N); 0: by size"},
        {"--shard", "I/N", OPTION_TEXT, NULL, NULL, &set.shard, 0, 0, "generate: the I-th of N shares"},
        {"--levels", "N", OPTION_INTEGER, &set.levels, NULL, NULL, 1, 3, "train: times that nodes are pooled"},
        {"--channels", "N", OPTION_INTEGER, &set.channels, NULL, NULL, 1, 128, "train: channels of the first layer"},
        {"--epochs", "N", OPTION_INTEGER, &set.epochs, NULL, NULL, 1, 1e6, "train: times that all samples are seen"},
        {"--batch", "N", OPTION_INTEGER, &set.batch, NULL, NULL, 1, 1e4, "train: samples of a step"},
        {"--rate", "R", OPTION_NUMBER, NULL, &set.rate, NULL, 1e-9, 1, "train: of Adam at its largest"},
        {"--solves", "N", OPTION_INTEGER, &set.solves, NULL, NULL, 1, 1e6, "evaluate: starts that are compared"},
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &set.out, 0, 0, "evaluate: NAME.csv, .svg and .png"},
        {"--help", NULL, OPTION_FLAG, &set.help, NULL, NULL, 0, 0, "this text"},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    work w;
    int status;
    if (!options_parse("umesh", options, count, files, 3, argc, argv))
        return EXIT_USAGE;
    if (set.help) {
        puts("umesh generate DATA | train DATA WEIGHTS | evaluate DATA WEIGHTS | all [OPTIONS]: a network learns "
             "how a beam or an organ bends");
        options_print(options, count);
        return 0;
    }
    if (!files[0])
        return complain("the first word", "must be generate, train, evaluate or all", EXIT_USAGE);
    if (!set.tissue.organ && set.tissue.along % 8 != 0)
        return complain("--along", "needs a multiple of 8 for a beam", EXIT_USAGE);
    memset(&w, 0, sizeof w);
    w.set = &set;
    status = run(&w, files);
    free_work(&w);
    return status;
}

int main(int argc, char **argv) { return finish("umesh", program(argc, argv), EXIT_USAGE); }
