/* particles_study: bodies without elements beside a thesis: what they cost, and how right they are.
 *
 *     particles_study [OPTIONS]      particles_study --help lists them
 *
 * Tables 3.1 and 3.2 of Brunet, Simulation of soft tissue for augmented reality, 2020: a beam of 10 x 40 x 10
 * particles, E 2000 Pa, nu 0.3, density 6.23, steps of 5 ms, stretched (linear) and bent (corotated) by gravity;
 * point-based animation with SPH and least squares gradients, moving least squares on a grid with one and eight points
 * in a cell, and elements. The thesis says not how large the beam is: here particles are 0.25 m apart. Its figure 3.14:
 * a beam of 20 x 20 x 200 mm, E 50 MPa, nu 0.45, bent by 12 N: how far its end goes, against 44.946 mm of 4 x 40 x 4
 * hex20. Written are the tables with the thesis' numbers beside, the same as CSV, and a chart (SVG). Exit status: 0, 2
 * wrong usage or a file that cannot be written, 3 a solve failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "plot.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, ROWS = 13, KINDS = 5, SIZES = 5, CURVES = 5 };

static const double bent = 44.946; /* mm */

typedef struct settings {
    const char *out; /* NAME.svg and NAME.csv */
    int quick, steps, help;
} settings;

static int complain(const char *what, const sb_error *error)
{
    progress_end();
    fprintf(stderr, "particles_study: %s: %s\n", what, error->message);
    return EXIT_SOLVE;
}

/* ---- beams ------------------------------------------------------------------------------------------------------ */

/* A box along y, its skin, and the bricks whose nodes are the particles. */
typedef struct beam {
    int across, along;
    sb_vec3 size;
    sb_mesh bricks, skin;
    sb_surface *surface;
} beam;

static int make_beam(int across, int along, sb_vec3 size, beam *b)
{
    sb_boundary boundary;
    sb_error error;
    memset(b, 0, sizeof *b);
    b->across = across;
    b->along = along;
    b->size = size;
    if (sb_mesh_beam(SB_HEX8, across, along, across, size, NULL, &b->bricks, &error) ||
        sb_mesh_boundary(&b->bricks, 1, NULL, &boundary, &error))
        return complain("the beam", &error);
    if (!sb_surface_triangulate(&boundary.surface, NULL, &b->skin, &error))
        sb_surface_create(&b->skin, NULL, &b->surface, &error);
    sb_boundary_free(&boundary);
    return b->surface ? 0 : complain("the beam's skin", &error);
}

static void free_beam(beam *b)
{
    sb_surface_destroy(b->surface);
    sb_mesh_free(&b->skin);
    sb_mesh_free(&b->bricks);
}

/* What a row of the tables is of. points 0: tet4 elements; -1: hex8. */
typedef struct kind {
    const char *name;
    sb_particle_method method;
    int points, basis, neighbours;
    double stabilised; /* alpha, or 0 */
} kind;

/* A body of the beam's particles or elements, held at y = 0; nu and the like from the material. */
typedef struct made {
    sb_particles particles;
    sb_mesh mesh;
    sb_body *body;
} made;

static void free_made(made *m)
{
    sb_body_destroy(m->body);
    sb_particles_free(&m->particles);
    sb_mesh_free(&m->mesh);
}

static int make_particles(const beam *b, const kind *k, sb_particles *particles)
{
    sb_particles_def def = sb_default_particles_def();
    sb_error error;
    def.method = k->method;
    def.points_per_cell = k->points;
    def.basis = k->basis;
    def.neighbours = k->neighbours;
    def.dilatation = (sb_real)(k->method == SB_PARTICLES_SPH ? 1 : 1.5);
    def.outer.surface = b->surface;
    def.counts[0] = def.counts[2] = b->across;
    def.counts[1] = b->along;
    def.points = b->bricks.nodes;
    def.point_count = b->bricks.node_count;
    return sb_particles_create(&def, particles, &error) ? complain(k->name, &error) : 0;
}

static int make_body(const beam *b, const kind *k, sb_body_def *def, made *m)
{
    const sb_mesh *mesh = &m->mesh;
    sb_error error;
    memset(m, 0, sizeof *m);
    if (k->points > 0) {
        int status = make_particles(b, k, &m->particles);
        if (status)
            return status;
        mesh = &m->particles.mesh;
        def->domain = &m->particles.domain;
    } else if (sb_mesh_beam(k->points ? SB_HEX8 : SB_TET4, b->across, b->along, b->across, b->size, NULL, &m->mesh,
                            &error)) {
        return complain("the mesh", &error);
    }
    def->mesh = mesh;
    def->clock = seconds_now;
    if (sb_body_create(def, &m->body, &error))
        return complain("the body", &error);
    for (int i = 0; i < mesh->node_count; i++)
        if ((double)mesh->nodes[i].y < 1e-6 * (double)b->size.y && sb_body_fix_nodes(m->body, &i, 1, SB_XYZ))
            return EXIT_SOLVE;
    if (k->stabilised > 0 && sb_particles_stabilise(&m->particles, m->body, (sb_real)k->stabilised, NULL, &error))
        return complain("the stabilisation", &error);
    return 0;
}

/* ---- tables 3.1 and 3.2 ----------------------------------------------------------------------------------------- */

/* Times in ms: forces, a step of each kind, the conjugate gradients; and their iterations. */
typedef struct costs {
    double force, explicit_step, implicit_step, iterations, solve;
} costs;

typedef struct row {
    kind kind;
    costs thesis[2], ours[2]; /* linear, corotated */
} row;

static int time_steps(const settings *s, const beam *b, const kind *k, int corotated, sb_integrator integrator,
                      costs *out)
{
    sb_body_def def = sb_default_body_def();
    made m;
    int status, done = 0;
    def.material = corotated ? sb_material_corotated(2000, (sb_real)0.3, (sb_real)6.23)
                             : sb_material_linear(2000, (sb_real)0.3, (sb_real)6.23);
    def.gravity = corotated ? sb_v3((sb_real)9.81, 0, 0) : sb_v3(0, (sb_real)9.81, 0);
    def.integrator = integrator;
    if (!corotated || k->points <= 0)                 /* corotated particles have the best there is anyway */
        def.preconditioner = SB_PRECOND_BLOCK_JACOBI; /* mass outweighs stiffness in such steps */
    status = make_body(b, k, &def, &m);
    for (int step = 0; step < s->steps && !status; step++) {
        sb_step_info info;
        if (sb_body_step(m.body, (sb_real)0.005, &info))
            status = complain(k->name, &info.error);
        else if (integrator == SB_CENTRAL_DIFFERENCE) {
            out->explicit_step += 1e3 * info.seconds_total;
            done += info.substeps;
        } else {
            out->force += 1e3 * info.seconds_force / s->steps;
            out->implicit_step += 1e3 * info.seconds_total / s->steps;
            out->iterations += (double)info.pcg_iterations / s->steps;
            out->solve += 1e3 * (info.seconds_precond + info.seconds_solve) / s->steps;
        }
    }
    if (integrator == SB_CENTRAL_DIFFERENCE && done)
        out->explicit_step /= done;
    free_made(&m);
    return status;
}

static void print_costs(const char *name, int neighbours, const costs *t, const costs *o)
{
    printf("%-22s %3d  %6.2f %6.2f  %6.2f %6.2f  %7.2f %7.2f  %3.0f %4.1f  %7.2f %7.2f\n", name, neighbours, t->force,
           o->force, t->explicit_step, o->explicit_step, t->implicit_step, o->implicit_step, t->iterations,
           o->iterations, t->solve, o->solve);
}

static int run_tables(const settings *s, row *rows, FILE *csv)
{
    static const char *const titles[2] = {"Table 3.1: linear, stretched", "Table 3.2: corotated, bent"};
    beam b;
    int status = make_beam(9, 39, sb_v3((sb_real)2.25, (sb_real)9.75, (sb_real)2.25), &b);
    for (int table = 0; table < 2 && !status; table++) {
        printf("%s. ms of one thread, the thesis' number and ours; steps of %d\n", titles[table], s->steps);
        printf("%-22s %3s  %13s  %13s  %15s  %8s  %15s\n", "", "n", "forces", "explicit", "implicit", "it.", "solve");
        for (int r = 0; r < ROWS && !status; r++) {
            costs *ours = &rows[r].ours[table];
            if (s->quick && rows[r].kind.neighbours > 10)
                continue;
            progress_show((double)(table * ROWS + r) / (2 * ROWS), rows[r].kind.name);
            status = time_steps(s, &b, &rows[r].kind, table, SB_EULER, ours);
            if (!status)
                status = time_steps(s, &b, &rows[r].kind, table, SB_CENTRAL_DIFFERENCE, ours);
            progress_end();
            if (status)
                break;
            print_costs(rows[r].kind.name, rows[r].kind.neighbours, &rows[r].thesis[table], ours);
            fprintf(csv, "%s,%s,%d,%g,%g,%g,%g,%g\n", table ? "corotated" : "linear", rows[r].kind.name,
                    rows[r].kind.neighbours, ours->force, ours->explicit_step, ours->implicit_step, ours->iterations,
                    ours->solve);
        }
    }
    free_beam(&b);
    return status;
}

/* ---- figure 3.14 ------------------------------------------------------------------------------------------------ */

typedef struct curve {
    kind kind;
    int count;
    double particles[SIZES], errors[SIZES]; /* % */
} curve;

/* Forces (N) of the traction across the far end. 0 when memory is short. */
static sb_vec3 *end_forces(const beam *b, const kind *k, const made *m, int node_count)
{
    sb_vec3 traction = sb_v3((sb_real)(12 / (0.02 * 0.02)), 0, 0);
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)node_count, sizeof(sb_vec3));
    int *ends = (int *)malloc((size_t)b->skin.element_count * sizeof(int)), count = 0;
    sb_grid_rows rows;
    for (int e = 0; ends && e < b->skin.element_count; e++) {
        const int *t = b->skin.elements + 3 * e;
        double lowest = 1;
        for (int a = 0; a < 3; a++)
            lowest = fmin(lowest, (double)b->skin.nodes[t[a]].y / (double)b->size.y);
        if (lowest > 1 - 1e-6)
            ends[count++] = e;
    }
    if (forces && ends && k->points > 0 &&
        !sb_particles_map_surface(&m->particles, &b->skin, ends, count, NULL, &rows, NULL)) {
        sb_grid_add_traction(&rows, &traction, 1, forces);
        sb_grid_rows_free(&rows);
    }
    free(ends);
    return forces;
}

/* How far the middle of the end went (mm), or less than 0. */
static double end_moved(const beam *b, const kind *k, const made *m)
{
    sb_vec3 tip = sb_v3(b->size.x / 2, b->size.y, b->size.z / 2), at = tip;
    const sb_vec3 *x = sb_body_positions(m->body);
    sb_grid_rows rows;
    if (k->points > 0) {
        if (sb_particles_map_points(&m->particles, &tip, 1, NULL, &rows, NULL))
            return -1;
        sb_mapping_apply(&rows.rows, x, &at);
        sb_grid_rows_free(&rows);
    } else {
        const double near = 0.75 * (double)b->size.x / b->across; /* one node, or four about it */
        double count = 0;
        at = sb_v3(0, 0, 0);
        for (int i = 0; i < m->mesh.node_count; i++)
            if ((double)sb_v3_norm(sb_v3_sub(m->mesh.nodes[i], tip)) < near) {
                at = sb_v3_add(at, x[i]);
                count++;
            }
        at = sb_v3_scale((sb_real)(1 / count), at);
    }
    return 1e3 * (double)sb_v3_norm(sb_v3_sub(at, tip));
}

static int load_end(const beam *b, const kind *k, made *m)
{
    sb_error error;
    int status = 0;
    if (k->points > 0) {
        int count = m->particles.mesh.node_count;
        sb_vec3 *forces = end_forces(b, k, m, count);
        for (int i = 0; i < count && forces && !status; i++)
            status = sb_body_add_forces(m->body, &i, 1, forces + i, 1) ? EXIT_SOLVE : 0;
        free(forces);
        return forces ? status : EXIT_SOLVE;
    }
    {
        sb_boundary boundary;
        sb_vec3 traction = sb_v3((sb_real)(12 / (0.02 * 0.02)), 0, 0);
        int corners = k->points ? 4 : 3;
        if (sb_mesh_boundary(&m->mesh, 0, NULL, &boundary, &error))
            return complain("the end", &error);
        for (int f = 0; f < boundary.surface.element_count && !status; f++) {
            const int *face = boundary.surface.elements + corners * f;
            double lowest = 1;
            for (int a = 0; a < corners; a++)
                lowest = fmin(lowest, (double)m->mesh.nodes[face[a]].y / (double)b->size.y);
            if (lowest > 1 - 1e-6 && sb_body_add_traction(m->body, face, 1, corners, traction, &error))
                status = complain("the end", &error);
        }
        sb_boundary_free(&boundary);
    }
    return status;
}

static int bend(int across, const kind *k, int *particles, double *moved)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    beam b;
    made m;
    int status = make_beam(across, 10 * across, sb_v3((sb_real)0.02, (sb_real)0.2, (sb_real)0.02), &b);
    def.material = sb_material_corotated((sb_real)50e6, (sb_real)0.45, 1000);
    memset(&m, 0, sizeof m);
    if (!status)
        status = make_body(&b, k, &def, &m);
    if (!status)
        status = load_end(&b, k, &m);
    options.tolerance = (sb_real)1e-3;
    if (!status && sb_body_solve_static(m.body, &options, &info))
        status = complain(k->name, &info.error);
    if (!status) {
        *particles = sb_body_node_count(m.body);
        *moved = end_moved(&b, k, &m);
        status = *moved < 0 ? EXIT_SOLVE : 0;
    }
    free_made(&m);
    free_beam(&b);
    return status;
}

static int run_bending(const settings *s, curve *curves, FILE *csv)
{
    int status = 0, count = s->quick ? 2 : SIZES - 1;
    printf("Figure 3.14: a beam bent by 12 N, its end goes by 44.946 mm (hex20); in mm, and what is missing\n");
    for (int c = 0; c < CURVES && !status; c++)
        for (int k = 0; k < count && !status; k++) {
            curve *to = curves + c;
            double moved = 0;
            int particles = 0;
            if (to->kind.basis == 10 && k == 0)
                continue; /* ten monomials want three layers */
            progress_show((double)(c * count + k) / (CURVES * count), to->kind.name);
            status = bend(2 + k + (k == 3), &to->kind, &particles, &moved);
            progress_end();
            if (status)
                break;
            to->particles[to->count] = particles;
            to->errors[to->count++] = 100 * fabs(moved / bent - 1);
            printf("%-32s %6d  %7.2f  %+5.1f %%\n", to->kind.name, particles, moved, 100 * (moved / bent - 1));
            fprintf(csv, "bend,%s,%d,%g,,,,\n", to->kind.name, particles, moved);
        }
    return status;
}

/* ---- output ----------------------------------------------------------------------------------------------------- */

/* The chart; 0 when it cannot be written. */
static int draw(const settings *s, const row *rows, const curve *curves)
{
    static const char *const names[KINDS] = {"SPH", "MLS", "1 point", "8 points", "tet4"};
    static const int at[KINDS] = {0, 3, 6, 9, 12};
    double places[KINDS] = {1, 2, 3, 4, 5}, thesis[KINDS], ours[KINDS];
    char path[512];
    plot p;
    plot_panel *panel;
    for (int k = 0; k < KINDS; k++) {
        thesis[k] = rows[at[k]].thesis[1].implicit_step;
        ours[k] = rows[at[k]].ours[1].implicit_step;
    }
    plot_begin(&p, "Bodies of particles");
    panel = plot_add_panel(&p, "a corotated step of 4,000 particles, 10 neighbours", "method", "ms");
    panel->log_y = 1;
    panel->x_names = names;
    panel->x_name_count = KINDS;
    plot_add_curve(panel, "thesis", places, thesis, KINDS)->markers = 1;
    plot_add_curve(panel, "here", places, ours, KINDS)->markers = 1;
    panel = plot_add_panel(&p, "a bent beam", "particles or nodes", "what the end's way is off by (%)");
    panel->log_x = panel->log_y = 1;
    for (int c = 0; c < CURVES; c++)
        plot_add_curve(panel, curves[c].kind.name, curves[c].particles, curves[c].errors, curves[c].count)->markers = 1;
    snprintf(path, sizeof path, "%s.svg", s->out);
    return plot_save_svg(&p, path);
}

static row rows[ROWS] = {
    {{"point-based SPH", SB_PARTICLES_SPH, 1, 4, 10, 0},
     {{3.5, 5.64, 47.54, 12, 40.70}, {7.17, 9.11, 51.88, 12, 40.93}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"point-based SPH", SB_PARTICLES_SPH, 1, 4, 20, 0},
     {{6.52, 8.47, 101.40, 13, 87.97}, {12.71, 12.83, 108.16, 13, 88.36}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"point-based SPH", SB_PARTICLES_SPH, 1, 4, 30, 0},
     {{9.99, 10.71, 167.29, 14, 146.69}, {18.43, 18.57, 176.85, 14, 147.64}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"point-based MLS", SB_PARTICLES_MLS, 1, 4, 10, 0},
     {{3.26, 5.81, 50.16, 13, 43.44}, {6.52, 8.08, 53.67, 13, 45.55}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"point-based MLS", SB_PARTICLES_MLS, 1, 4, 20, 0},
     {{6.80, 8.30, 109.4, 14, 95.53}, {11.96, 12.52, 108.15, 14, 94.51}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"point-based MLS", SB_PARTICLES_MLS, 1, 4, 30, 0},
     {{10.48, 11.98, 183.20, 15, 161.30}, {17.17, 17.93, 175.23, 15, 155.98}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"grid 1 point", SB_PARTICLES_GRID, 1, 4, 10, 0},
     {{2.19, 2.94, 37.63, 29, 33.92}, {3.55, 4.12, 42.55, 29, 37.70}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"grid 1 point", SB_PARTICLES_GRID, 1, 4, 15, 0},
     {{2.96, 3.60, 63.28, 30, 58.06}, {4.02, 4.96, 67.70, 30, 59.91}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"grid 1 point", SB_PARTICLES_GRID, 1, 4, 20, 0},
     {{3.53, 4.22, 56.18, 20, 49.88}, {4.17, 5.49, 70.12, 25, 64.27}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"grid 8 points", SB_PARTICLES_GRID, 8, 4, 10, 0},
     {{6.35, 6.61, 41.21, 9, 32.86}, {7.49, 8.29, 51.25, 9, 45.36}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"grid 8 points", SB_PARTICLES_GRID, 8, 4, 15, 0},
     {{7.91, 7.75, 56.05, 9, 45.32}, {8.25, 8.91, 62.23, 10, 58.44}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"grid 8 points", SB_PARTICLES_GRID, 8, 4, 20, 0},
     {{10.06, 10.50, 84.05, 19, 69.93}, {9.99, 10.45, 91.11, 20, 71.89}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
    {{"elements tet4", SB_PARTICLES_GRID, 0, 4, 0, 0},
     {{1.55, 2.34, 45.44, 34, 42.39}, {3.06, 3.75, 58.01, 34, 53.06}},
     {{0, 0, 0, 0, 0}, {0, 0, 0, 0, 0}}},
};

static curve curves[CURVES] = {
    {{"grid 8 points linear", SB_PARTICLES_GRID, 8, 4, 10, 0}, 0, {0}, {0}},
    {{"grid 8 points quadratic", SB_PARTICLES_GRID, 8, 10, 27, 0}, 0, {0}, {0}},
    {{"grid 1 point stabilised", SB_PARTICLES_GRID, 1, 4, 10, 0.02}, 0, {0}, {0}},
    {{"point-based MLS stabilised", SB_PARTICLES_MLS, 1, 4, 10, 0.02}, 0, {0}, {0}},
    {{"elements hex8", SB_PARTICLES_GRID, -1, 4, 0, 0}, 0, {0}, {0}},
};

static int program(int argc, char **argv)
{
    settings s = {"particles_study", 0, 600, 0};
    option list[] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "writes NAME.svg and NAME.csv"},
        {"--quick", NULL, OPTION_FLAG, &s.quick, NULL, NULL, 0, 0, "10 neighbours and coarse beams only"},
        {"--steps", "N", OPTION_INTEGER, &s.steps, NULL, NULL, 1, 1e6, "steps of 5 ms that times are means of"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
    };
    enum { OPTIONS = sizeof list / sizeof list[0] };
    char path[512];
    sb_output csv;
    int status, written;
    if (!options_parse("particles_study", list, OPTIONS, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf(
            "particles_study [OPTIONS]: bodies of particles beside a thesis: what they cost, how right they are\n\n");
        options_print(list, OPTIONS);
        return 0;
    }
    snprintf(path, sizeof path, "%s.csv", s.out);
    if (sb_output_open(&csv, path, NULL) != SB_OK) {
        fprintf(stderr, "particles_study: %s: cannot be written\n", path);
        return EXIT_USAGE;
    }
    fprintf(csv.file,
            "table,method,neighbours_or_particles,forces_ms_or_end_mm,explicit_ms,implicit_ms,iterations,solve_ms\n");
    status = run_tables(&s, rows, csv.file);
    if (!status)
        status = run_bending(&s, curves, csv.file);
    written = sb_output_close(&csv, NULL) == SB_OK;
    if (!status && written)
        written = draw(&s, rows, curves);
    if (!written) {
        fprintf(stderr, "particles_study: %s: cannot be written\n", path);
        status = status ? status : EXIT_USAGE;
    }
    if (!status)
        printf("%s.csv and %s.svg written\n", s.out, s.out);
    return status;
}

int main(int argc, char **argv) { return finish("particles_study", program(argc, argv), EXIT_USAGE); }
