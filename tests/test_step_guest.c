/* Tests of guests in a body's step: against the equations of body and guests solved as one dense system, in every
 * material, integrator and preconditioner; momentum; failures that leave nothing behind. Guests are internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/step_private.h"

#include "check.h"
#include "scene.h"

#include "dense_double.h"

/* ---- dense systems --------------------------------------------------------------------------------------- */

/* Solves a x = b in place of b; a is destroyed. */
static int dense_eliminate(double *a, double *b, int n)
{
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[pivot * n + k]))
                pivot = i;
        if (!(fabs(a[pivot * n + k]) > 0))
            return 0;
        for (int j = 0; j < n && pivot != k; j++) {
            double swap = a[k * n + j];
            a[k * n + j] = a[pivot * n + j];
            a[pivot * n + j] = swap;
        }
        if (pivot != k) {
            double swap = b[k];
            b[k] = b[pivot];
            b[pivot] = swap;
        }
        for (int i = k + 1; i < n; i++) {
            double f = a[i * n + k] / a[k * n + k];
            for (int j = k; j < n && f != 0; j++)
                a[i * n + j] -= f * a[k * n + j];
            b[i] -= f * b[k];
        }
    }
    for (int i = n; i-- > 0;) {
        for (int j = i + 1; j < n; j++)
            b[i] -= a[i * n + j] * b[j];
        b[i] /= a[i * n + i];
    }
    return 1;
}

/* ---- guests of springs, dashpots and masses -------------------------------------------------------------- */

/* M a + C v + K q = force, q its own displacements and those of its nodes. A brake's spring gives way at its limit. */
typedef struct device {
    sbi_guest guest;
    int width, size;
    double *k, *c, *m; /* [width][width] */
    double *force;     /* [width] */
    double *g, *load;  /* the rows of the step */
    double *block;     /* [size][size] */
    int *nodes;
    double *unknown;
    double *own[3], *own0[2]; /* displacement, velocity, acceleration of its own; known parts of the step */
    double *x;                /* [width] as committed */
    sbi_guest_step told;
    double brake, limit; /* N/m, N; 0: none. Along z of its last node */
    double hold;         /* N, when it slips */
    int slips;
    double seen; /* acceleration along x that its first node started with (m/s^2) */
    int begins, settles, commits, undos;
    int fail_begin, nan_at, bad_at, calls; /* from which call on; 0: never */
} device;

static double device_component(const sb_vec3 *v, int node, int axis) { return (double)(&v[node].x)[axis]; }

/* Rows from what it is made of. */
static void device_make_rows(device *d)
{
    const sbi_guest_step *t = &d->told;
    int w = d->width, n = d->guest.unknown_count;
    for (int i = 0; i < w; i++) {
        d->load[i] = d->force[i];
        for (int j = 0; j < w; j++) {
            double u, v, a;
            if (j < n) {
                u = d->own[0][j];
                v = d->own0[0][j];
                a = d->own0[1][j];
            } else {
                int node = d->nodes[(j - n) / 3], axis = (j - n) % 3;
                u = device_component(t->displacement, node, axis);
                v = device_component(t->velocity0, node, axis);
                a = device_component(t->acceleration0, node, axis);
            }
            d->load[i] -= d->k[i * w + j] * u + d->c[i * w + j] * v + d->m[i * w + j] * a;
            d->g[i * w + j] =
                d->k[i * w + j] + t->velocity_factor * d->c[i * w + j] + t->acceleration_factor * d->m[i * w + j];
        }
    }
    if (d->brake > 0) {
        d->load[w - 1] += d->slips ? d->hold : 0;
        d->g[w * w - 1] += d->slips ? 0 : d->brake;
    }
}

static sb_result device_begin(void *user, const sbi_guest_step *step, sb_error *error)
{
    device *d = (device *)user;
    int n = d->guest.unknown_count;
    d->told = *step;
    d->begins++;
    if (d->fail_begin && d->begins >= d->fail_begin)
        return sbi_fail(error, SB_ERROR_STATE, "not today");
    d->slips = step->iteration > 0 && d->slips;
    d->seen = (double)step->acceleration[d->nodes[0]].x;
    for (int k = 0; k < n; k++) {
        d->own0[0][k] = step->known_velocity[0] * d->own[1][k] + step->known_velocity[1] * d->own[2][k];
        d->own0[1][k] = step->known_acceleration[0] * d->own[1][k] + step->known_acceleration[1] * d->own[2][k];
    }
    device_make_rows(d);
    for (int i = 0; i < d->size; i++)
        for (int j = 0; j < d->size; j++)
            d->block[i * d->size + j] = d->g[i * d->width + j];
    for (int i = 0; i < d->guest.taken_count; i++)
        for (int j = 0; j < d->guest.taken_count; j++) {
            int q = sb_matrix_find(step->matrix, d->nodes[i], d->nodes[j]);
            for (int c = 0; q >= 0 && c < 9; c++)
                d->block[(n + 3 * i + c / 3) * d->size + n + 3 * j + c % 3] += (double)step->matrix->blocks[q][c];
        }
    for (int i = n; i < d->size; i++) /* prescribed components */
        for (int j = 0; j < d->size && (step->matrix->fixed[d->nodes[(i - n) / 3]] >> (i - n) % 3 & 1); j++)
            d->block[i * d->size + j] = d->block[j * d->size + i] = i == j;
    return dense_factor(d->block, d->size) ? SB_OK : SB_ERROR_INDEFINITE;
}

static void device_multiply(void *user, const double *x, double *y)
{
    device *d = (device *)user;
    d->calls++;
    for (int i = 0; i < d->width; i++) {
        y[i] = 0;
        for (int j = 0; j < d->width; j++)
            y[i] += d->g[i * d->width + j] * x[j];
        if (d->bad_at && d->calls >= d->bad_at) /* no longer positive definite */
            y[i] -= 1e9 * x[i];
    }
    if (d->nan_at && d->calls == d->nan_at)
        y[d->width / 2] = (double)NAN;
}

static void device_residual(void *user, const double *x, double *y)
{
    const device *d = (const device *)user;
    for (int i = 0; i < d->width; i++) {
        y[i] = d->load[i];
        for (int j = 0; j < d->width; j++)
            y[i] -= d->g[i * d->width + j] * x[j];
    }
}

static void device_precondition(void *user, const double *r, double *z)
{
    const device *d = (const device *)user;
    dense_solve(d->block, d->size, r, z);
}

static int device_settle(void *user, const double *x)
{
    device *d = (device *)user;
    double pull = d->brake * x[d->width - 1];
    d->settles++;
    if (!(d->brake > 0) || d->slips || fabs(pull) <= d->limit)
        return 0;
    d->slips = 1;
    d->hold = pull > 0 ? -d->limit : d->limit;
    device_make_rows(d);
    return 1;
}

static void device_commit(void *user, const double *x)
{
    device *d = (device *)user;
    const sbi_guest_step *t = &d->told;
    d->commits++;
    memcpy(d->x, x, sizeof(double) * (size_t)d->width);
    for (int k = 0; k < d->guest.unknown_count; k++) {
        double v = t->velocity_factor * x[k] + d->own0[0][k], a = t->acceleration_factor * x[k] + d->own0[1][k];
        CHECK(d->unknown[k] == x[k]);
        d->own[0][k] += x[k] / t->level;
        d->own[1][k] += (v - d->own[1][k]) / t->level;
        d->own[2][k] += (a - d->own[2][k]) / t->inertia_level;
        d->unknown[k] = 0;
    }
}

static void device_undo(void *user) { ((device *)user)->undos++; }

static device *device_create(int unknowns, int node_count, const int *nodes, int taken)
{
    device *d = (device *)calloc(1, sizeof *d);
    size_t width = (size_t)(unknowns + 3 * node_count), square = width * width + 1;
    double **squares[] = {&d->k, &d->c, &d->m, &d->g, &d->block};
    double **rows[] = {&d->force,  &d->load,    &d->unknown, &d->own[0], &d->own[1],
                       &d->own[2], &d->own0[0], &d->own0[1], &d->x};
    for (size_t i = 0; i < sizeof squares / sizeof *squares; i++)
        *squares[i] = (double *)calloc(square, sizeof(double));
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        *rows[i] = (double *)calloc(width + 1, sizeof(double));
    d->nodes = (int *)calloc((size_t)node_count + 1, sizeof(int));
    for (int k = 0; k < node_count; k++)
        d->nodes[k] = nodes[k];
    d->width = (int)width;
    d->size = unknowns + 3 * taken;
    d->guest.user = d;
    d->guest.unknown_count = unknowns;
    d->guest.unknown = d->unknown;
    d->guest.node_count = node_count;
    d->guest.nodes = d->nodes;
    d->guest.taken_count = taken;
    d->guest.residual = device_residual;
    d->guest.multiply = device_multiply;
    d->guest.precondition = d->size ? device_precondition : NULL;
    d->guest.begin = device_begin;
    d->guest.settle = device_settle;
    d->guest.commit = device_commit;
    d->guest.undo = device_undo;
    return d;
}

static void device_free(device *d)
{
    free(d->k), free(d->c), free(d->m), free(d->g), free(d->block), free(d->force), free(d->load), free(d->unknown);
    for (int i = 0; i < 3; i++)
        free(d->own[i]);
    free(d->own0[0]), free(d->own0[1]), free(d->x), free(d->nodes), free(d);
}

/* matrix += s (sum of terms)(sum of terms)^T on each axis; columns are of x components. */
static void device_add(const device *d, double *matrix, int terms, const int *columns, const double *factors, double s)
{
    for (int i = 0; i < terms; i++)
        for (int k = 0; k < terms; k++)
            for (int axis = 0; axis < 3; axis++)
                matrix[(columns[i] + axis) * d->width + columns[k] + axis] += s * factors[i] * factors[k];
}

static void device_link(const device *d, double *matrix, int a, int b, double s)
{
    const int columns[2] = {a, b};
    const double factors[2] = {1, -1};
    device_add(d, matrix, 2, columns, factors, s);
}

enum { CHAIN = 4 };

/* Masses on springs and dashpots between two nodes, pulled aside. */
static device *chain_create(int a, int b)
{
    const int nodes[2] = {a, b};
    device *d = device_create(3 * CHAIN, 2, nodes, 0);
    for (int k = 0; k <= CHAIN; k++) {
        int from = k == 0 ? 3 * CHAIN : 3 * (k - 1), to = k == CHAIN ? 3 * CHAIN + 3 : 3 * k;
        device_link(d, d->k, from, to, 40);
        device_link(d, d->c, from, to, 0.3);
    }
    for (int k = 0; k < 3 * CHAIN; k++) {
        d->m[k * (d->width + 1)] = 0.002;
        d->force[k] = k % 3 == 1 ? 0.02 : 0.005;
    }
    return d;
}

/* A beam through nodes, far stiffer than what it is in, that takes them. */
static device *beam_create(int count, const int *nodes)
{
    device *d = device_create(0, count, nodes, count);
    for (int k = 0; k + 1 < count; k++)
        device_link(d, d->k, 3 * k, 3 * k + 3, 1e6);
    for (int k = 0; k + 2 < count; k++) {
        const int columns[3] = {3 * k, 3 * k + 3, 3 * k + 6};
        const double factors[3] = {1, -2, 1};
        device_add(d, d->k, 3, columns, factors, 1e4);
    }
    d->force[1] = 0.01;
    return d;
}

static device *force_create(int a, int b)
{
    const int nodes[2] = {a, b};
    device *d = device_create(0, 2, nodes, 0);
    d->force[0] = 0.02;
    d->force[5] = -0.03;
    d->guest.settle = NULL;
    return d;
}

static device *brake_create(int node, double limit)
{
    device *d = device_create(0, 1, &node, 0);
    d->brake = 60;
    d->limit = limit;
    return d;
}

/* Two masses on springs to the ground and between each other, beside the body. */
static device *lone_create(void)
{
    device *d = device_create(6, 0, NULL, 0);
    device_link(d, d->k, 0, 3, 500);
    for (int k = 0; k < 6; k++) {
        d->k[k * (d->width + 1)] += k < 3 ? 2e4 : 3;
        d->m[k * (d->width + 1)] = 0.01;
        d->force[k] = 0.03 * (k - 2);
    }
    return d;
}

/* ---- scenes ---------------------------------------------------------------------------------------------- */

typedef struct scene_def {
    sb_element_type type;
    sb_material material;
    int fibres;
    sb_integrator integrator;
    int iterated;
    sb_precond_kind precond;
    int moving, constrained, consistent;
    double slack;
    int parts; /* 1: a second box beside the first, which nothing holds but guests */
    int workers;
    double load; /* factor of the forces on the body */
} scene_def;

enum { DEVICES = 5 };

typedef struct scene {
    sb_mesh mesh;
    sb_body *body, *other; /* other: evaluates forces for the reference */
    device *devices[DEVICES];
    const sbi_guest *list[DEVICES];
    sb_vec3 *fibres;
    int *workers;
    int constraint[3]; /* slave and its two masters, along z; slave -1: none */
} scene;

static const double box[3] = {0.06, 0.03, 0.03};

static int scene_corner(const sb_mesh *mesh, double x, double y, double z)
{
    int best = 0;
    double least = 1e30;
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 at = mesh->nodes[i];
        double d = fabs((double)at.x - x) + fabs((double)at.y - y) + fabs((double)at.z - z);
        if (d < least)
            least = d, best = i;
    }
    return best;
}

static sb_body *scene_make_body(scene *s, const scene_def *what, const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    int tip = scene_corner(&s->mesh, box[0], 0, box[2]);
    sb_vec3 force = sb_v3(REAL(0.01 * what->load), REAL(-0.005 * what->load), REAL(0.012 * what->load));
    def.mesh = &s->mesh;
    def.material = what->material;
    def.fibres = s->fibres;
    def.integrator = what->integrator;
    def.mass = what->consistent ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_mass = REAL(0.7);
    def.damping_stiffness = REAL(0.002);
    def.preconditioner = what->precond;
    def.max_newton = what->iterated ? 40 : 1;
    def.tolerance = REAL(scene_tolerance(1e-10, 30));
    def.newton_tolerance = REAL(1e-9);
    def.max_iterations = 5000;
    def.slack = REAL(what->slack);
    def.jobs = scene_jobs(s->workers);
    if (allocator)
        def.allocator = *allocator;
    body = scene_body(&def);
    scene_fix_plane(body, &s->mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_forces(body, &tip, 1, &force, 1));
    if (what->constrained) {
        sb_constraint_term terms[3];
        for (int k = 0; k < 3; k++) {
            terms[k].node = s->constraint[k];
            terms[k].axis = 2;
            terms[k].coefficient = k == 0 ? REAL(1) : REAL(-0.5);
        }
        CHECK_OK(sb_body_add_constraint(body, terms, 3, 0, NULL, NULL));
    }
    return body;
}

/* A smaller copy at some distance. */
static void scene_add_box(sb_mesh *mesh)
{
    sb_mesh second = scene_box(mesh->element_type, 2, 2, 1, sb_v3(REAL(0.02), REAL(0.02), REAL(0.01)), 0.1);
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i] = sb_v3_add(second.nodes[i], sb_v3(REAL(box[0] + 0.02), 0, 0));
    CHECK_OK(sb_mesh_append(mesh, &second, NULL));
    sb_mesh_free(&second);
}

static scene scene_make(const scene_def *what, const sb_allocator *allocator)
{
    scene s;
    int line[3];
    memset(&s, 0, sizeof s);
    s.workers = (int *)malloc(sizeof(int));
    *s.workers = what->workers ? what->workers : 1;
    s.mesh = scene_box(what->type, 3, 2, 2, sb_v3(REAL(box[0]), REAL(box[1]), REAL(box[2])), 0.2);
    if (what->parts)
        scene_add_box(&s.mesh);
    if (what->fibres) {
        s.fibres = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)s.mesh.element_count);
        for (int e = 0; e < s.mesh.element_count; e++)
            s.fibres[e] = sb_v3(1, REAL(0.3), REAL(-0.2));
    }
    s.constraint[0] = scene_corner(&s.mesh, box[0], box[1], 0);
    s.constraint[1] = scene_corner(&s.mesh, box[0], box[1], box[2]);
    s.constraint[2] = scene_corner(&s.mesh, box[0] * 2 / 3, box[1], 0);
    s.body = scene_make_body(&s, what, allocator);
    s.other = scene_make_body(&s, what, NULL);
    for (int k = 0; k < 3; k++) /* from the support to near the end */
        line[k] = scene_corner(&s.mesh, box[0] * k / 3, box[1] / 2, box[2] / 2);
    s.devices[0] =
        chain_create(scene_corner(&s.mesh, box[0], box[1], box[2]), scene_corner(&s.mesh, 0, box[1], box[2]));
    s.devices[1] = beam_create(3, line);
    s.devices[2] = force_create(scene_corner(&s.mesh, box[0] * 2 / 3, 0, 0), scene_corner(&s.mesh, 0, 0, 0));
    if (what->parts) { /* the chain joins both parts, the forces are on the second one alone */
        int far = scene_corner(&s.mesh, box[0] + 0.04, 0.02, 0.01), close = scene_corner(&s.mesh, box[0] + 0.02, 0, 0);
        s.devices[0]->nodes[1] = close;
        s.devices[2]->nodes[0] = far;
        s.devices[2]->nodes[1] = close;
    }
    s.devices[4] = lone_create();
    s.devices[3] = brake_create(scene_corner(&s.mesh, box[0], box[1] / 2, 0), what->moving ? 0.005 : 1e3);
    for (int k = 0; k < DEVICES; k++)
        s.list[k] = &s.devices[k]->guest;
    return s;
}

static void scene_free(scene *s)
{
    sb_body_destroy(s->body);
    sb_body_destroy(s->other);
    for (int k = 0; k < DEVICES; k++)
        if (s->devices[k])
            device_free(s->devices[k]);
    free(s->fibres);
    free(s->workers);
    sb_mesh_free(&s->mesh);
}

static void scene_move(scene *s, const scene_def *what, int step)
{
    sb_vec3 target = sb_v3(REAL(0.0002 * step), REAL(-0.0003 * step), REAL(0.0004 * step));
    if (!what->moving)
        return;
    for (int i = 0; i < s->mesh.node_count; i++)
        if ((double)s->mesh.nodes[i].x < 1e-9)
            CHECK_OK(sb_body_prescribe(s->body, &i, 1, SB_XYZ, &target, 1));
}

static sb_result scene_step(scene *s, double dt, sb_step_info *info)
{
    return sbi_body_step_with(s->body, REAL(dt), s->list, DEVICES, info);
}

/* A step with those guests only that leave the body's rows to its own preconditioner. */
static sb_result scene_step_beside(scene *s, double dt, sb_step_info *info)
{
    const sbi_guest *list[DEVICES];
    int count = 0;
    for (int g = 0; g < DEVICES; g++)
        if (s->list[g]->taken_count == 0)
            list[count++] = s->list[g];
    return sbi_body_step_with(s->body, REAL(dt), list, count, info);
}

/* ---- the reference --------------------------------------------------------------------------------------- */

/* Dense copy of a matrix of the body, times factor, added. */
static void reference_add(const sb_matrix *matrix, double factor, double *to, int n)
{
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++)
            for (int c = 0; c < 9; c++)
                to[(3 * i + c / 3) * n + 3 * matrix->columns[q] + c % 3] += factor * (double)matrix->blocks[q][c];
}

typedef struct reference {
    int n;        /* components of nodes, guests' unknowns, one multiplier */
    int nodes;    /* components of nodes */
    double *x;    /* [n] the solution: from the start of the step */
    double share; /* of it that the step took */
} reference;

static void reference_system(scene *s, const scene_def *what, const sb_real *u, const double *damping, double *a,
                             double *b, const reference *r, int constrained)
{
    sb_body *o = s->other;
    const sb_body *body = s->body;
    const sbi_guest_step *t = &s->devices[0]->told;
    int n = r->n, count = r->nodes, at = r->nodes;
    double *mass = (double *)calloc((size_t)n * (size_t)n, sizeof(double));
    sb_vec3 *force = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)(count / 3));
    const sb_vec3 *shape = (const sb_vec3 *)(const void *)u;
    double alpha = (double)body->damping_mass, beta = (double)body->damping_stiffness;
    memset(a, 0, sizeof(double) * (size_t)n * (size_t)n);
    memset(b, 0, sizeof(double) * (size_t)n);
    CHECK(sbi_assembly_force(&o->assembly, shape, force) < 0);
    sbi_assembly_tangent(&o->assembly, shape, what->iterated ? SB_TANGENT_EXACT : SB_TANGENT_QUASI, 1, &o->matrix);
    reference_add(&o->matrix, 1, a, n);
    sb_matrix_clear(&o->matrix);
    sbi_body_add_mass(o, 1);
    reference_add(&o->matrix, 1, mass, n);
    for (int i = 0; i < count; i++) {
        b[i] = device_component(body->dead_load, i / 3, i % 3) - device_component(force, i / 3, i % 3);
        for (int j = 0; j < count; j++) {
            double d = (double)u[j] - device_component(body->start, j / 3, j % 3);
            double v = t->velocity_factor * d + device_component(body->velocity0, j / 3, j % 3);
            double acc = t->acceleration_factor * d + device_component(body->acceleration0, j / 3, j % 3);
            double m = mass[i * n + j], k = damping[i * n + j];
            b[i] += m * ((double)(&body->gravity.x)[j % 3] - acc - alpha * v) - beta * k * v;
            a[i * n + j] += (t->acceleration_factor + alpha * t->velocity_factor) * m + beta * t->velocity_factor * k;
        }
    }
    for (int g = 0; g < DEVICES; g++) {
        const device *d = s->devices[g];
        int own = d->guest.unknown_count;
        for (int i = 0; i < d->width; i++) {
            int row = i < own ? at + i : 3 * d->nodes[(i - own) / 3] + (i - own) % 3;
            b[row] += d->load[i];
            for (int j = 0; j < d->width; j++) {
                int column = j < own ? at + j : 3 * d->nodes[(j - own) / 3] + (j - own) % 3;
                double x =
                    j < own ? r->x[column] : (double)u[column] - device_component(body->start, column / 3, column % 3);
                b[row] -= d->g[i * d->width + j] * x;
                a[row * n + column] += d->g[i * d->width + j];
            }
        }
        at += own;
    }
    for (int k = 0; k < 3 && constrained; k++) {
        int dof = 3 * s->constraint[k] + 2;
        double factor = k == 0 ? 1 : -0.5;
        a[at * n + dof] += factor;
        a[dof * n + at] += factor;
        b[at] -= factor * (double)u[dof];
        b[dof] -= factor * r->x[at];
    }
    if (!constrained)
        a[at * n + at] = 1;
    for (int i = 0; i < count; i++)
        if (body->fixed[i / 3] >> i % 3 & 1) {
            double target = device_component(body->target, i / 3, i % 3),
                   start = device_component(body->start, i / 3, i % 3);
            for (int j = 0; j < n; j++)
                a[i * n + j] = i == j;
            b[i] = start + t->level * (target - start) - (double)u[i];
        }
    free(mass);
    free(force);
}

/* Solves the step that the body has just done, in one system with the guests' rows as they ended. `before`: the body's
 * state then. */
static reference reference_solve(scene *s, const scene_def *what, const void *before, size_t bytes, int constrained)
{
    const sbi_guest_step *t = &s->devices[0]->told;
    sb_body *o = s->other;
    reference r;
    double *a, *b, *damping, last = 0;
    sb_real *u;
    r.nodes = 3 * s->mesh.node_count;
    r.n = r.nodes + 1;
    for (int g = 0; g < DEVICES; g++)
        r.n += s->devices[g]->guest.unknown_count;
    r.share = 1;
    r.x = (double *)calloc((size_t)r.n, sizeof(double));
    a = (double *)malloc(sizeof(double) * (size_t)r.n * (size_t)r.n);
    damping = (double *)calloc((size_t)r.n * (size_t)r.n, sizeof(double));
    b = (double *)malloc(sizeof(double) * (size_t)r.n);
    u = (sb_real *)malloc(sizeof(sb_real) * (size_t)r.nodes);
    memcpy(u, s->body->start, sizeof(sb_real) * (size_t)r.nodes);
    CHECK_OK(sb_body_state_load(o, before, bytes, NULL));
    o->assembly.fold_fallback = !what->iterated;
    if (!what->iterated) /* there the stiffness of damping is that of the step, here of its start */
        sbi_assembly_begin_step(&o->assembly, REAL(t->level * t->dt));
    CHECK(sbi_assembly_force(&o->assembly, (const sb_vec3 *)(const void *)u, o->internal) < 0);
    sbi_assembly_tangent(&o->assembly, (const sb_vec3 *)(const void *)u,
                         what->iterated ? SB_TANGENT_SPD : SB_TANGENT_QUASI, 1, &o->matrix);
    sbi_assembly_begin_step(&o->assembly, REAL(t->level * t->dt));
    reference_add(&o->matrix, 1, damping, r.n);
    for (int round = 0; round < (what->iterated ? 30 : 1); round++) {
        double size = 0;
        reference_system(s, what, u, damping, a, b, &r, constrained);
        CHECK(dense_eliminate(a, b, r.n));
        for (int i = 0; i < r.n; i++) {
            r.x[i] += b[i];
            size = fabs(b[i]) > size && i < r.nodes ? fabs(b[i]) : size;
            if (i < r.nodes)
                u[i] = REAL(device_component(s->body->start, i / 3, i % 3) + r.x[i]);
        }
        if (round > 3 && !(size < last))
            break;
        last = size;
    }
    free(a);
    free(damping);
    free(b);
    free(u);
    return r;
}

/* Compares the step with it: nodes where the forces balance, unknowns. */
static void reference_compare(scene *s, reference *r, double tolerance)
{
    const sbi_guest_step *t = &s->devices[0]->told;
    double size = 0, off = 0, own_size = 0, own_off = 0;
    int at = r->nodes;
    for (int i = 0; i < r->nodes; i++) {
        double d =
            device_component(s->body->displacement, i / 3, i % 3) - device_component(s->body->start, i / 3, i % 3);
        double e = fabs(d * t->level - r->share * r->x[i]);
        size = fabs(r->x[i]) > size ? fabs(r->x[i]) : size;
        off = e > off ? e : off;
    }
    for (int g = 0; g < DEVICES; g++)
        for (int k = 0; k < s->devices[g]->guest.unknown_count; k++, at++) {
            double e = fabs(s->devices[g]->x[k] - r->share * r->x[at]);
            own_size = fabs(r->x[at]) > own_size ? fabs(r->x[at]) : own_size;
            own_off = e > own_off ? e : own_off;
        }
    CHECK_NEAR(off / size, 0, tolerance);
    CHECK_NEAR(own_off / own_size, 0, tolerance);
    free(r->x);
}

/* 1: supports moved alone, as a step that cannot iterate may have them; no guest moved then. */
static int is_left_behind(const scene *s)
{
    const sb_body *b = s->body;
    for (int i = 0; i < 3 * b->domain.node_count; i++)
        if (!(sbi_body_held(b, i / 3) >> i % 3 & 1) &&
            device_component(b->displacement, i / 3, i % 3) != device_component(b->start, i / 3, i % 3))
            return 0;
    for (int g = 0; g < DEVICES; g++)
        for (int k = 0; k < s->devices[g]->width; k++) {
            int at = k - s->devices[g]->guest.unknown_count;
            CHECK(s->devices[g]->x[k] == 0 || (at >= 0 && b->fixed[s->devices[g]->nodes[at / 3]]));
        }
    return 1;
}

/* Sum of all forces, reactions and guests' included, less the change of momentum, along each axis. */
static void check_momentum(const scene *s, double tolerance)
{
    const sb_body *b = s->body;
    const sbi_guest_step *t = &s->devices[0]->told;
    double sum[3] = {0, 0, 0}, size = 0;
    int n = b->domain.node_count;
    sb_vec3 *a = (sb_vec3 *)calloc((size_t)n, sizeof(sb_vec3)), *ma = (sb_vec3 *)calloc((size_t)n, sizeof(sb_vec3));
    for (int i = 0; i < n; i++) {
        sb_vec3 v = sb_v3_madd(b->saved_velocity[i], REAL(t->level), sb_v3_sub(b->velocity[i], b->saved_velocity[i]));
        a[i] = sb_v3_madd(b->velocity0[i], REAL(t->velocity_factor * t->level),
                          sb_v3_sub(b->displacement[i], b->start[i]));
        CHECK((double)sb_v3_norm(sb_v3_sub(a[i], v)) <
              scene_tolerance(1e-9, 1e5)); /* the velocity told is the body's */
        a[i] = sb_v3_madd(b->acceleration0[i], REAL(t->acceleration_factor * t->level),
                          sb_v3_sub(b->displacement[i], b->start[i]));
        a[i] = sb_v3_sub(sb_v3_madd(a[i], b->damping_mass, v), b->gravity);
    }
    sbi_body_mass_multiply(b, a, ma);
    for (int i = 0; i < n; i++)
        for (int axis = 0; axis < 3; axis++) {
            double f = device_component(b->dead_load, i, axis) + device_component(b->reaction, i, axis) -
                       device_component(ma, i, axis);
            sum[axis] += f;
            size += fabs(f);
        }
    for (int g = 0; g < DEVICES; g++) {
        const device *d = s->devices[g];
        double *y = (double *)malloc(sizeof(double) * (size_t)d->width);
        device_residual((void *)(uintptr_t)d, d->x, y);
        for (int k = d->guest.unknown_count; k < d->width; k++)
            sum[(k - d->guest.unknown_count) % 3] += y[k];
        free(y);
    }
    for (int axis = 0; axis < 3; axis++)
        CHECK_NEAR(sum[axis] / size, 0, tolerance);
    free(a);
    free(ma);
}

/* Steps with guests, each against the reference. */
static void check_scene(const scene_def *what, int steps, double dt)
{
    scene s = scene_make(what, NULL);
    size_t bytes = sb_body_state_size(s.body);
    void *before = malloc(bytes);
    int slipped = 0, left = 0;
    for (int step = 1; step <= steps; step++) {
        sb_step_info info;
        reference r;
        scene_move(&s, what, step);
        CHECK_OK(sb_body_state_save(s.body, before, bytes));
        if (!CHECK_OK(scene_step(&s, dt, &info)))
            printf("    %s\n", info.error.message);
        CHECK(!info.capped);
        CHECK(!what->iterated || info.newton_iterations < 25);
        for (int g = 0; g < DEVICES; g++) {
            CHECK_INT(s.devices[g]->commits, step);
            CHECK_INT(s.devices[g]->undos, what->integrator != SB_EULER); /* once to find how it starts */
        }
        slipped |= s.devices[3]->slips;
        if (what->moving && !what->iterated && sb_material_is_hyperelastic(what->material.model) &&
            is_left_behind(&s)) {
            left++;
            continue;
        }
        check_momentum(&s, scene_tolerance(what->iterated ? 1e-7 : 1e-8, 3e4));
        r = reference_solve(&s, what, before, bytes, what->constrained);
        reference_compare(&s, &r, SB_REAL_IS_FLOAT ? 2e-2 : 1e-6);
    }
    CHECK(slipped == what->moving || left > 0);
    free(before);
    scene_free(&s);
}

static scene_def usual(void)
{
    scene_def what;
    memset(&what, 0, sizeof what);
    what.type = SB_TET4;
    what.material = sb_material_corotated(REAL(8e3), REAL(0.4), 1000);
    what.integrator = SB_EULER;
    what.precond = SB_PRECOND_IC0;
    what.load = 1;
    return what;
}

/* ---- tests ----------------------------------------------------------------------------------------------- */

static const sb_integrator integrators[3] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};

/* Every material, linearised and iterated, with every integrator. */
static void test_materials(void)
{
    const sb_real g[2] = {REAL(0.3), REAL(0.2)}, tau[2] = {REAL(0.02), REAL(0.3)};
    const sb_real young = REAL(8e3), nu = REAL(0.4);
    sb_material neo = sb_material_neo_hookean(young, nu, 1000);
    sb_material materials[9];
    materials[0] = sb_material_linear(young, nu, 1000);
    materials[1] = sb_material_corotated(young, nu, 1000);
    materials[2] = neo;
    materials[3] = sb_material_neo_hookean_isochoric(neo.c10, neo.d1, 1000);
    materials[4] = sb_material_stable_neo_hookean(young, nu, 1000);
    materials[5] = sb_material_mooney_rivlin(REAL(0.7) * neo.c10, REAL(0.3) * neo.c10, neo.d1, 1000);
    materials[6] = sb_material_with_prony(neo, g, tau, 2);
    materials[7] = sb_material_with_fibres(neo, REAL(3e3), REAL(0.5));
    materials[8] = sb_material_corotated_invertible(young, nu, 1000);
    for (int m = 0; m < 9; m++)
        for (int iterated = 0; iterated < 2; iterated++)
            for (int i = 0; i < 3; i++) {
                scene_def what = usual();
                what.material = materials[m];
                what.fibres = m == 7;
                what.integrator = integrators[i];
                what.iterated = iterated;
                what.moving = (m + iterated + i) % 2;
                what.constrained = (m + i) % 3 == 0;
                what.consistent = (m + i) % 4 == 1;
                check_scene(&what, 3, 0.01);
            }
}

static void test_elements(void)
{
    const sb_element_type types[3] = {SB_TET10, SB_HEX8, SB_TET4};
    for (int t = 0; t < 3; t++)
        for (int iterated = 0; iterated < 2; iterated++) {
            scene_def what = usual();
            what.type = types[t];
            what.iterated = iterated;
            what.integrator = integrators[(t + iterated) % 3];
            what.moving = 1;
            check_scene(&what, 2, 0.02);
        }
}

/* Two parts that only a guest joins: each part, and a guest that lies in none, to its own tolerance. */
static void test_parts(void)
{
    for (int i = 0; i < 3; i++)
        for (int form = 0; form < 4; form++) {
            scene_def what = usual();
            what.parts = 1;
            what.integrator = integrators[i];
            what.iterated = form % 2;
            what.moving = form / 2;
            what.constrained = form == 1;
            what.material = form == 3 ? sb_material_neo_hookean(REAL(8e3), REAL(0.4), 1000) : what.material;
            what.precond = i == 1 ? SB_PRECOND_MULTIGRID : SB_PRECOND_IC0;
            check_scene(&what, 3, 0.01);
        }
}

/* Splits the edge between the first two nodes of a cell by its middle. */
static void split_edge(sb_body *body, int cell)
{
    sb_body_change *change = NULL;
    const sb_vec3 *X = sb_body_rest_positions(body);
    const sb_real halves[2] = {REAL(0.5), REAL(0.5)};
    int ends[2], middle, cells = sb_body_element_count(body);
    sb_error error;
    memcpy(ends, sb_body_cell_nodes(body, cell), sizeof ends);
    CHECK_OK(sb_body_change_begin(body, &change, &error));
    CHECK_OK(sb_body_change_add_node(change, sb_v3_scale(REAL(0.5), sb_v3_add(X[ends[0]], X[ends[1]])), ends, halves, 2,
                                     0, &middle, &error));
    for (int e = 0; e < cells; e++) {
        int at[2] = {-1, -1}, nodes[4];
        memcpy(nodes, sb_body_cell_nodes(body, e), sizeof nodes);
        for (int k = 0; k < 8; k++)
            at[k % 2] = nodes[k / 2] == ends[k % 2] ? k / 2 : at[k % 2];
        for (int side = 0; side < 2 && at[0] >= 0 && at[1] >= 0; side++) {
            sb_change_cell made = sb_default_change_cell();
            int half[4];
            memcpy(half, nodes, sizeof half);
            half[at[side]] = middle;
            made.nodes = half;
            made.parent = e;
            CHECK_OK(side == 0 ? sb_body_change_replace_cell(change, e, &made, &error)
                               : sb_body_change_add_cell(change, &made, NULL, &error));
        }
    }
    if (!CHECK_OK(sb_body_change_commit(change, &error)))
        sb_body_change_cancel(change);
}

/* Guests go on when the mesh has changed about their nodes. */
static void test_changes(void)
{
    for (int i = 0; i < 3; i++)
        for (int iterated = 0; iterated < 2; iterated++) {
            scene_def what = usual();
            size_t bytes;
            void *before;
            scene s;
            what.slack = 0.2;
            what.integrator = integrators[i];
            what.iterated = iterated;
            what.constrained = i == 2;
            what.precond = iterated ? SB_PRECOND_IC0 : SB_PRECOND_BLOCK_JACOBI;
            s = scene_make(&what, NULL);
            for (int step = 0; step < 4; step++) {
                reference r;
                if (step > 0)
                    split_edge(s.body, 7 * step);
                s.mesh.node_count = sb_body_node_count(s.body);
                bytes = sb_body_state_size(s.body);
                before = malloc(bytes);
                CHECK_OK(sb_body_state_save(s.body, before, bytes));
                CHECK_OK(scene_step(&s, 0.01, NULL));
                check_momentum(&s, scene_tolerance(iterated ? 1e-7 : 1e-8, 3e4));
                r = reference_solve(&s, &what, before, bytes, what.constrained);
                reference_compare(&s, &r, SB_REAL_IS_FLOAT ? 2e-2 : 1e-6);
                free(before);
            }
            scene_free(&s);
        }
}

static void test_preconditioners(void)
{
    const sb_precond_kind kinds[7] = {SB_PRECOND_NONE, SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_SSOR,     SB_PRECOND_IC0,
                                      SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY,     SB_PRECOND_MULTIGRID};
    for (int k = 0; k < 7; k++)
        for (int form = 0; form < 4; form++) {
            scene_def what = usual();
            what.precond = kinds[k];
            what.iterated = form % 2;
            what.constrained = form / 2;
            what.moving = form == 1;
            what.integrator = integrators[(k + form) % 3];
            check_scene(&what, 2, 0.01);
        }
}

/* How far the step is from the equations at its end, relative to the forces; unknowns of guests by their own block. */
static double equations_left(scene *s, const scene_def *what, const void *before, size_t bytes)
{
    const sbi_guest_step *t = &s->devices[0]->told;
    int n = 3 * s->mesh.node_count + 1, at = 3 * s->mesh.node_count;
    double *a, *b, *damping, size = 0, off = 0;
    sb_real *u = (sb_real *)malloc(sizeof(sb_real) * (size_t)n);
    reference r;
    for (int g = 0; g < DEVICES; g++)
        n += s->devices[g]->guest.unknown_count;
    r.n = n;
    r.nodes = at;
    r.x = (double *)calloc((size_t)n, sizeof(double));
    a = (double *)malloc(sizeof(double) * (size_t)n * (size_t)n);
    b = (double *)malloc(sizeof(double) * (size_t)n);
    damping = (double *)calloc((size_t)n * (size_t)n, sizeof(double));
    CHECK_OK(sb_body_state_load(s->other, before, bytes, NULL));
    s->other->assembly.fold_fallback = 0;
    CHECK(sbi_assembly_force(&s->other->assembly, s->body->start, s->other->internal) < 0);
    sbi_assembly_tangent(&s->other->assembly, s->body->start, SB_TANGENT_SPD, 1, &s->other->matrix);
    reference_add(&s->other->matrix, 1, damping, n);
    sbi_assembly_begin_step(&s->other->assembly, REAL(t->level * t->dt));
    for (int i = 0; i < r.nodes; i++) {
        double start = device_component(s->body->start, i / 3, i % 3);
        u[i] = REAL(start + t->level * (device_component(s->body->displacement, i / 3, i % 3) - start));
    }
    for (int g = 0; g < DEVICES; g++)
        for (int k = 0; k < s->devices[g]->guest.unknown_count; k++)
            r.x[at++] = s->devices[g]->x[k];
    reference_system(s, what, u, damping, a, b, &r, 0);
    for (int i = 0; i < n; i++)
        off = fabs(b[i]) > off ? fabs(b[i]) : off;
    for (int i = 0; i < s->mesh.node_count; i++)
        size += (double)sb_v3_norm(s->body->internal[i]);
    free(a), free(b), free(damping), free(u), free(r.x);
    return off / size;
}

/* The same step in its parts; *cuts counts increments of which a share was taken. */
static sb_result scene_step_parts(scene *s, double dt, sb_step_info *info, int *cuts)
{
    sbi_step step;
    sb_result result = sbi_step_begin(s->body, REAL(dt), s->list, DEVICES, info, &step);
    do {
        while (result == SB_OK && !step.done) {
            result = sbi_step_solve(&step);
            if (result == SB_OK)
                result = sbi_step_advance(&step);
            *cuts += result == SB_OK && step.cautious;
        }
        if (result == SB_OK)
            result = sbi_step_commit(&step);
    } while (sbi_step_begin_again(&step, &result));
    return result == SB_OK ? result : sbi_step_undo(&step, result);
}

/* Loads that no whole increment can take at once, supports that move far: the iteration ends at the equations all the
 * same, guests' unknowns with it. */
static void test_line_search(void)
{
    int shortened = 0;
    for (int m = 0; m < 3; m++)
        for (int i = 0; i < 3; i++)
            for (int moving = 0; moving < 2; moving++) {
                scene_def what = usual();
                scene s;
                size_t bytes;
                void *before;
                what.material = m == 0   ? sb_material_neo_hookean(REAL(8e3), REAL(0.4), 1000)
                                : m == 1 ? sb_material_stable_neo_hookean(REAL(8e3), REAL(0.4), 1000)
                                         : sb_material_corotated(REAL(8e3), REAL(0.4), 1000);
                what.integrator = integrators[i];
                what.iterated = 1;
                what.moving = moving;
                what.load = 120;
                s = scene_make(&what, NULL);
                s.devices[2]->force[0] = 4;
                s.devices[0]->force[1] = -0.4;
                bytes = sb_body_state_size(s.body);
                before = malloc(bytes);
                for (int step = 0; step < 3; step++) {
                    sb_step_info info;
                    scene_move(&s, &what, 4 * step);
                    CHECK_OK(sb_body_state_save(s.body, before, bytes));
                    if (!CHECK_OK(scene_step_parts(&s, 0.05, &info, &shortened)))
                        printf("    %s\n", info.error.message);
                    CHECK(!info.capped);
                    CHECK_NEAR(equations_left(&s, &what, before, bytes), 0, SB_REAL_IS_FLOAT ? 2e-4 : 1e-8);
                }
                free(before);
                scene_free(&s);
            }
    CHECK(shortened > 0);
}

/* A linearised step of a hyperelastic body takes a share of the increment: guests take the same. */
static void test_share(void)
{
    int shortened = 0;
    for (int i = 0; i < 3; i++)
        for (int load = 1; load <= 256; load *= 4) {
            scene_def what = usual();
            scene s;
            size_t bytes;
            void *before;
            what.material = sb_material_neo_hookean(REAL(8e3), REAL(0.4), 1000);
            what.integrator = integrators[i];
            what.load = load;
            s = scene_make(&what, NULL);
            bytes = sb_body_state_size(s.body);
            before = malloc(bytes);
            for (int step = 0; step < 2; step++) {
                const sbi_guest_step *t = &s.devices[0]->told;
                reference r;
                int largest = 0;
                CHECK_OK(sb_body_state_save(s.body, before, bytes));
                if (scene_step(&s, 0.02, NULL) != SB_OK) { /* no share was admissible where it ends */
                    CHECK(load > 4 && what.integrator == SB_GENERALISED_ALPHA);
                    break;
                }
                r = reference_solve(&s, &what, before, bytes, 0);
                for (int k = 0; k < r.nodes; k++)
                    largest = fabs(r.x[k]) > fabs(r.x[largest]) ? k : largest;
                r.share = t->level *
                          (device_component(s.body->displacement, largest / 3, largest % 3) -
                           device_component(s.body->start, largest / 3, largest % 3)) /
                          r.x[largest];
                CHECK_NEAR(log2(r.share), floor(log2(r.share) + 0.5), SB_REAL_IS_FLOAT ? 0.1 : 1e-5);
                shortened += r.share < 0.75;
                if (r.share > 0.75)
                    check_momentum(&s, scene_tolerance(1e-8, 3e4));
                reference_compare(&s, &r, SB_REAL_IS_FLOAT ? 2e-2 : 1e-6);
            }
            free(before);
            scene_free(&s);
        }
    CHECK(shortened > 0);
}

/* ---- bits ---- */

/* All that a scene's steps leave behind. */
static unsigned long long scene_bits(const scene *s)
{
    size_t bytes = sb_body_state_size(s->body), n = (size_t)s->mesh.node_count;
    void *state = malloc(bytes);
    unsigned long long hash;
    CHECK_OK(sb_body_state_save(s->body, state, bytes));
    hash = scene_hash(state, bytes) ^ 3 * scene_hash(sb_body_reactions(s->body), n * sizeof(sb_vec3));
    for (int g = 0; g < DEVICES; g++) {
        const device *d = s->devices[g];
        hash = 31 * hash + scene_hash(d->unknown, sizeof(double) * (size_t)d->width);
        for (int k = 0; k < 3; k++)
            hash = 31 * hash + scene_hash(d->own[k], sizeof(double) * (size_t)d->width);
    }
    free(state);
    return hash;
}

static void test_threads(void)
{
    const int workers[3] = {1, 2, 5};
    const sb_precond_kind kinds[3] = {SB_PRECOND_IC0, SB_PRECOND_FSAI, SB_PRECOND_MULTIGRID};
    for (int k = 0; k < 3; k++)
        for (int iterated = 0; iterated < 2; iterated++) {
            unsigned long long first = 0;
            for (int w = 0; w < 3; w++) {
                scene_def what = usual();
                scene s;
                what.precond = kinds[k];
                what.iterated = iterated;
                what.moving = 1;
                what.workers = workers[w];
                s = scene_make(&what, NULL);
                for (int step = 1; step <= 3; step++) {
                    scene_move(&s, &what, step);
                    CHECK_OK(scene_step(&s, 0.01, NULL));
                }
                first = w ? first : scene_bits(&s);
                CHECK(scene_bits(&s) == first);
                scene_free(&s);
            }
        }
}

enum { BREAK_BEGIN, BREAK_LATER, BREAK_NAN, BREAK_INDEFINITE, BREAK_LOAD, BREAKS };

/* Makes the next step fail, or no longer. */
static void scene_break(scene *s, int how, int broken)
{
    device *d = s->devices[how == BREAK_NAN ? 0 : 1], *force = s->devices[2];
    int later = how == BREAK_LATER ? 2 : 1;
    d->fail_begin = broken && how <= BREAK_LATER ? d->begins + later : 0;
    d->nan_at = broken && how == BREAK_NAN ? d->calls + 7 : 0;
    d->bad_at = broken && how == BREAK_INDEFINITE ? d->calls + 4 : 0;
    force->force[1] = broken && how == BREAK_LOAD ? (double)NAN : 0;
}

/* A step that fails leaves body and guests as they were, to the bit, and those after it go as if it had not been. */
static void test_undo(void)
{
    const sb_result results[BREAKS] = {SB_ERROR_STATE, SB_ERROR_STATE, SB_ERROR_DIVERGED, SB_ERROR_INDEFINITE,
                                       SB_ERROR_DIVERGED};
    check_bad_numbers();
    for (int how = 0; how < BREAKS; how++)
        for (int i = 0; i < 3; i++)
            for (int iterated = how == BREAK_LATER; iterated < 2; iterated++) {
                scene_def what = usual();
                scene s, whole;
                unsigned long long before;
                if ((i + how) % 2)
                    what.material = sb_material_neo_hookean(REAL(8e3), REAL(0.4), 1000);
                what.integrator = integrators[i];
                what.iterated = iterated;
                what.moving = how % 2 && iterated;
                what.constrained = i == 1;
                s = scene_make(&what, NULL);
                whole = scene_make(&what, NULL);
                for (int step = 0; step < 4; step++) {
                    sb_step_info info;
                    int undos = s.devices[1]->undos;
                    scene_move(&s, &what, step);
                    scene_move(&whole, &what, step);
                    for (int k = 0; k < s.devices[0]->guest.unknown_count; k++) /* a guess */
                        s.devices[0]->unknown[k] = whole.devices[0]->unknown[k] = 1e-7 * k;
                    if (step % 2 == 1) {
                        before = scene_bits(&s);
                        scene_break(&s, how, 1);
                        CHECK_RESULT(scene_step(&s, 0.01, &info), results[how]);
                        CHECK_INT(info.error.result, results[how]);
                        scene_break(&s, how, 0);
                        CHECK(scene_bits(&s) == before);
                        CHECK(s.devices[1]->undos > undos);
                        CHECK_INT(s.devices[1]->commits, step);
                    }
                    CHECK_OK(scene_step(&s, 0.01, NULL));
                    CHECK_OK(scene_step(&whole, 0.01, NULL));
                    CHECK(scene_bits(&s) == scene_bits(&whole));
                }
                scene_free(&s);
                scene_free(&whole);
            }
}

static void *used_alloc(void *user, size_t bytes)
{
    void *pointer = malloc(bytes);
    return pointer ? memset(pointer, *(const int *)user, bytes) : NULL;
}

static void used_release(void *user, void *pointer)
{
    (void)user;
    free(pointer);
}

/* What memory held before it was a body's shows in no bit, guesses of guests included. */
static void test_used_memory(void)
{
    const sb_precond_kind kinds[7] = {SB_PRECOND_NONE, SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_SSOR,     SB_PRECOND_IC0,
                                      SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY,     SB_PRECOND_MULTIGRID};
    int fillings[3] = {0, 0xFE, 0xFF}; /* all bytes of the last: a NaN */
    for (int trial = 0; trial < 28; trial++) {
        unsigned long long first = 0;
        for (int f = 0; f < 3; f++) {
            sb_allocator allocator;
            scene_def what = usual();
            scene s;
            allocator.alloc = used_alloc;
            allocator.release = used_release;
            allocator.user = fillings + f;
            what.precond = kinds[trial / 4];
            what.iterated = trial % 2;
            what.integrator = integrators[trial % 3];
            s = scene_make(&what, &allocator);
            for (int step = 1; step <= 3; step++) {
                for (int k = 0; k < s.devices[0]->guest.unknown_count; k++) /* a guess */
                    s.devices[0]->unknown[k] = 1e-7 * k;
                CHECK_OK(trial / 2 % 2 ? scene_step_beside(&s, 0.01, NULL) : scene_step(&s, 0.01, NULL));
            }
            first = f ? first : scene_bits(&s);
            CHECK(scene_bits(&s) == first);
            scene_free(&s);
        }
    }
}

/* Guests that ask for nothing leave the bits of the body alone; so do calls with none. */
static void test_no_guests(void)
{
    for (int i = 0; i < 3; i++)
        for (int iterated = 0; iterated < 2; iterated++) {
            scene_def what = usual();
            scene s, bare;
            what.integrator = integrators[i];
            what.iterated = iterated;
            s = scene_make(&what, NULL);
            bare = scene_make(&what, NULL);
            CHECK_OK(scene_step(&s, 0.01, NULL));
            sb_body_reset(s.body);
            for (int step = 0; step < 3; step++) {
                CHECK_OK(sbi_body_step_with(s.body, REAL(0.01), NULL, 0, NULL));
                CHECK_OK(sb_body_step(bare.body, REAL(0.01), NULL));
                CHECK(memcmp(s.body->displacement, bare.body->displacement,
                             sizeof(sb_vec3) * (size_t)s.mesh.node_count) == 0);
            }
            scene_free(&s);
            scene_free(&bare);
        }
}

/* The acceleration that a body at rest starts from has the guests' forces in it. */
static void test_start(void)
{
    for (int i = 1; i < 3; i++)
        for (int constrained = 0; constrained < 2; constrained++) {
            scene_def what = usual();
            const device *d;
            scene s;
            what.integrator = integrators[i];
            what.constrained = constrained;
            s = scene_make(&what, NULL);
            d = s.devices[2];
            CHECK_OK(sbi_body_step_with(s.body, REAL(0.01), s.list + 2, 1, NULL));
            CHECK_NEAR(d->seen, d->force[0] / (double)s.body->lumped_mass[d->nodes[0]], 1e-3 * d->seen);
            CHECK_INT(d->undos, 1);
            CHECK_OK(sbi_body_step_with(s.body, REAL(0.01), s.list + 2, 1, NULL));
            CHECK_INT(d->undos, 1);
            scene_free(&s);
        }
}

/* ---- memory and arguments ---- */

static void test_memory(void)
{
    for (int constrained = 0; constrained < 2; constrained++) {
        scene_memory memory;
        sb_allocator allocator = scene_allocator(&memory);
        scene_def what = usual();
        sb_step_info info;
        unsigned long long before;
        scene s;
        int calls;
        memset(&memory, 0, sizeof memory);
        what.constrained = constrained;
        what.iterated = 1;
        s = scene_make(&what, &allocator);
        CHECK_OK(sbi_body_step_with(s.body, REAL(0.01), s.list, 1, &info));
        before = scene_bits(&s);
        memory.fail_at = memory.calls + 1;
        CHECK_RESULT(scene_step(&s, 0.01, &info), SB_ERROR_MEMORY);
        CHECK_INT(info.error.result, SB_ERROR_MEMORY);
        CHECK(scene_bits(&s) == before);
        calls = memory.calls;
        CHECK_OK(scene_step(&s, 0.01, &info));
        CHECK_INT(memory.calls, calls + 1);
        CHECK_OK(sbi_body_step_with(s.body, REAL(0.01), s.list + 1, 2, &info));
        CHECK_OK(scene_step(&s, 0.01, &info));
        CHECK_OK(sb_body_step(s.body, REAL(0.01), &info));
        CHECK_INT(memory.calls, calls + 1);
        scene_free(&s);
        CHECK_INT(memory.live, 0);
    }
}

static void test_refused(void)
{
    scene_def what = usual();
    sb_step_info info;
    unsigned long long before;
    scene s;
    int node;
    what.constrained = 1;
    s = scene_make(&what, NULL);
    CHECK_OK(scene_step(&s, 0.01, NULL));
    before = scene_bits(&s);
    node = s.devices[3]->nodes[0];
    s.devices[3]->nodes[0] = s.constraint[0];
    CHECK_RESULT(scene_step(&s, 0.01, &info), SB_ERROR_UNSUPPORTED);
    CHECK_INT(info.error.node, s.constraint[0]);
    s.devices[3]->nodes[0] = s.mesh.node_count;
    CHECK_RESULT(scene_step(&s, 0.01, &info), SB_ERROR_INDEX);
    CHECK_INT(info.error.node, s.mesh.node_count);
    s.devices[3]->nodes[0] = node;
    CHECK_RESULT(sbi_body_step_with(s.body, REAL(0.01), s.list, -1, &info), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sbi_body_step_with(s.body, REAL(0.01), NULL, 1, &info), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sbi_body_step_with(s.body, 0, s.list, DEVICES, &info), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sbi_body_step_with(NULL, REAL(0.01), s.list, DEVICES, &info), SB_ERROR_ARGUMENT);
    CHECK(scene_bits(&s) == before);
    CHECK_INT(s.devices[0]->undos, 0);
    CHECK_OK(scene_step(&s, 0.01, NULL));
    scene_free(&s);
    what = usual();
    s = scene_make(&what, NULL);
    s.body->integrator = SB_CENTRAL_DIFFERENCE;
    CHECK_RESULT(scene_step(&s, 0.01, &info), SB_ERROR_UNSUPPORTED);
    s.body->integrator = SB_EULER;
    scene_free(&s);
}

CHECK_SUITE(step_guest, {"materials", test_materials}, {"elements", test_elements}, {"parts", test_parts},
            {"changes", test_changes}, {"preconditioners", test_preconditioners}, {"line search", test_line_search},
            {"share", test_share}, {"threads", test_threads}, {"undo", test_undo}, {"used memory", test_used_memory},
            {"no guests", test_no_guests}, {"start", test_start}, {"memory", test_memory}, {"refused", test_refused});
