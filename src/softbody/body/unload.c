/* unload: fixed point of the forward static solve, mixed after Anderson. */
#include "unload.h"

#include <string.h>

#include "../base/eigen.h"
#include "body_private.h"
#include "load.h"
#include "rigid_private.h"
#include "step_private.h"

#define SBI_UNLOAD_COOKIE 0x0271adu
enum { SBI_UNLOAD_MEMORY = 5, SBI_UNLOAD_HALVINGS = 6, SBI_UNLOAD_MOST_STEPS = 1000 };

SB_API sb_unload_def sb_default_unload_def(void)
{
    sb_unload_def def;
    memset(&def, 0, sizeof def);
    def.body = sb_default_body_def();
    def.statics = sb_default_static_options();
    def.statics.tolerance = (sb_real)1e-9;
    def.statics.forces_only =
        1; /* it starts from the answer, so that no energy or increment is there to compare with */
    def.tolerance = sb_max((sb_real)1e-6, 100 * SB_EPSILON);
    def.max_iterations = 60;
    def.load_steps = 1;
    def.cookie = SBI_UNLOAD_COOKIE;
    return def;
}

/* The search; vectors of [count] each. */
typedef struct sbi_unload {
    const sb_unload_def *def;
    sb_mesh mesh; /* the imaged one, with the trial's nodes */
    int count;
    const sb_vec3 *image;
    sb_vec3 *rest, *gap;                                            /* the trial X, and x* - x(X) */
    sb_vec3 *last_rest, *last_gap;                                  /* of the trial before */
    sb_vec3 *best, *best_gap;                                       /* of the least gap for this share */
    sb_vec3 *reached;                                               /* the rest shape of the share before */
    sb_vec3 *moves[SBI_UNLOAD_MEMORY], *changes[SBI_UNLOAD_MEMORY]; /* differences of rest and gap, the oldest first */
    int known;                                                      /* of them */
    int has_last;
    sb_real least;  /* the gap of best (m) */
    int is_refused; /* def.dress ends the call */
    sb_body *body;  /* of the trial, loaded; or NULL */
    void *memory;
    sb_unload_report *report;
} sbi_unload;

/* ---- one trial ---- */

static sb_real sbi_unload_largest(const sb_vec3 *v, int count)
{
    sb_real largest = 0;
    for (int i = 0; i < count; i++)
        largest = sb_max(largest, sb_v3_norm(v[i]));
    return largest;
}

/* A body at rest in the trial's shape, put into the image and loaded. */
static sb_result sbi_unload_dress(sbi_unload *s, sb_real share, sb_error *error)
{
    sb_body_def def = s->def->body;
    sb_result result;
    int node;
    sb_body_destroy(s->body);
    s->body = NULL;
    memcpy(s->mesh.nodes, s->rest, (size_t)s->count * sizeof *s->rest);
    def.mesh = &s->mesh;
    def.gravity = sb_v3_scale(share, def.gravity);
    result = sb_body_create(&def, &s->body, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < s->count; i++)
        s->gap[i] = sb_v3_sub(s->image[i], s->rest[i]);
    result = sb_body_set_displacements(s->body, s->gap);
    if (result != SB_OK)
        return sbi_fail(error, result, "the trial's rest shape is too far from the image for numbers");
    if (s->def->dress)
        result = s->def->dress(s->def->user, s->body, share, error);
    s->is_refused = result != SB_OK;
    if (result != SB_OK && error->result != result)
        return sbi_fail(error, result, "def.dress returned %d (%s)", (int)result, sb_result_string(result));
    if (result == SB_OK)
        result = sbi_body_refuse_rigids(s->body, "searches for the shape without loads", error);
    node = result == SB_OK ? sbi_body_unsupported_node(s->body) : -1;
    if (node >= 0)
        return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, node,
                             "the part of the mesh with node %d can move freely: support it", node);
    return result;
}

/* gap = the way from where the image wants to go back to it, by one linear system with the tangent there: the forward
 * solve's first iteration, without where a body may fall that is far from its rest shape. */
static sb_result sbi_unload_solve(sbi_unload *s, sb_real share, sb_error *error)
{
    sb_step_info info;
    sbi_step step;
    sb_body *b;
    sb_result result = sbi_unload_dress(s, share, error);
    if (result != SB_OK)
        return result;
    s->report->solves++;
    b = s->body;
    memset(&step, 0, sizeof step);
    sbi_step_begin_info(&info);
    step.body = b;
    step.info = &info;
    step.part = step.load_factor = step.loads_factor = 1;
    step.linearised = 1;
    step.linear_tolerance = sb_max((sb_real)1e-8, 64 * SB_EPSILON);
    step.max_iterations = s->def->statics.max_iterations;
    sbi_step_save(b);
    sbi_step_enter(b, sbi_static_duration(&s->def->statics));
    for (int i = 0; i < s->count; i++)
        b->external[i] = sb_v3_madd(b->dead_load[i], b->load_mass[i], b->gravity);
    sbi_loads_begin_static(b);
    result = sbi_step_linearise(&step);
    if (result == SB_OK)
        result = sbi_step_solve_system(&step);
    for (int i = 0; result == SB_OK && i < s->count; i++) {
        s->gap[i] = sb_v3_scale(-1, b->increment[i]);
        if (!sb_v3_is_finite(s->gap[i]))
            result = sbi_fail_node(&info.error, SB_ERROR_DIVERGED, i, "the rest place of node %d is not finite", i);
    }
    sbi_step_restore(b);
    if (result != SB_OK)
        *error = info.error;
    if (result != SB_OK && error->result != result) /* steps name it at their end only */
        return sbi_fail(error, result, "the trial's linear system failed: %s", sb_result_string(result));
    return result;
}

/* The forward solve from the image: report->gap = |x* - x|. */
static sb_result sbi_unload_verify(sbi_unload *s, sb_real tolerance, sb_error *error)
{
    sb_step_info info;
    sb_result result = sb_body_solve_static(s->body, &s->def->statics, &info);
    if (result != SB_OK) {
        *error = info.error;
        return result;
    }
    s->report->gap = 0;
    for (int i = 0; i < s->count; i++) { /* by displacements, which are more precise than positions */
        sb_vec3 way = sb_v3_sub(s->image[i], s->rest[i]);
        s->report->gap = sb_max(s->report->gap, sb_v3_norm(sb_v3_sub(way, sb_body_displacements(s->body)[i])));
    }
    if (s->report->gap <= tolerance)
        return SB_OK;
    return sbi_fail(error, SB_ERROR_INDEFINITE,
                    "the image is in balance, but does not stay there: the body buckles away by %g m",
                    (double)s->report->gap);
}

/* ---- Anderson's mixing ---- */

static double sbi_unload_dot(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)sb_v3_dot(a[i], b[i]);
    return sum;
}

/* Keeps what the last trial teaches. */
static void sbi_unload_remember(sbi_unload *s)
{
    if (s->has_last) {
        int at = s->known;
        if (at == SBI_UNLOAD_MEMORY) {
            sb_vec3 *move = s->moves[0], *change = s->changes[0];
            at = SBI_UNLOAD_MEMORY - 1;
            memmove(s->moves, s->moves + 1, (size_t)at * sizeof s->moves[0]);
            memmove(s->changes, s->changes + 1, (size_t)at * sizeof s->changes[0]);
            s->moves[at] = move;
            s->changes[at] = change;
        }
        for (int i = 0; i < s->count; i++) {
            s->moves[at][i] = sb_v3_sub(s->rest[i], s->last_rest[i]);
            s->changes[at][i] = sb_v3_sub(s->gap[i], s->last_gap[i]);
        }
        s->known = at + 1;
    }
    memcpy(s->last_rest, s->rest, (size_t)s->count * sizeof *s->rest);
    memcpy(s->last_gap, s->gap, (size_t)s->count * sizeof *s->gap);
    s->has_last = 1;
}

/* weights = those of the remembered changes whose sum is nearest to the gap: least squares by the eigenvalues of the
 * normal equations, without what is rounding in them. */
static void sbi_unload_weigh(const sbi_unload *s, double *weights)
{
    enum { M = SBI_UNLOAD_MEMORY };
    double gram[M * M], right[M], values[M], vectors[M * M], scratch[2 * M];
    int n = s->known;
    for (int i = 0; i < n; i++) {
        weights[i] = 0;
        right[i] = sbi_unload_dot(s->changes[i], s->gap, s->count);
        for (int j = 0; j < n; j++)
            gram[i * n + j] = sbi_unload_dot(s->changes[i], s->changes[j], s->count);
    }
    if (n == 0 || !sbi_symmetric_eigen(gram, n, values, vectors, scratch))
        return;
    for (int k = 0; k < n; k++) {
        double along = 0;
        if (!(values[k] > 64 * (double)SB_EPSILON * values[n - 1]))
            continue;
        for (int i = 0; i < n; i++)
            along += vectors[k * n + i] * right[i];
        for (int i = 0; i < n; i++)
            weights[i] += along / values[k] * vectors[k * n + i];
    }
}

/* rest <- rest + gap - sum of weights (moves + changes) */
static void sbi_unload_advance(sbi_unload *s)
{
    double weights[SBI_UNLOAD_MEMORY];
    sbi_unload_weigh(s, weights);
    for (int i = 0; i < s->count; i++) {
        sb_vec3 next = sb_v3_add(s->rest[i], s->gap[i]);
        for (int k = 0; k < s->known; k++)
            next = sb_v3_madd(next, (sb_real)-weights[k], sb_v3_add(s->moves[k][i], s->changes[k][i]));
        s->rest[i] = next;
    }
}

/* ---- shares ---- */

/* Back to the best shape, from where it goes on with a part of the plain way and nothing remembered. */
static void sbi_unload_retreat(sbi_unload *s, int failures)
{
    sb_real part = 1;
    for (int i = 0; i < failures; i++)
        part *= (sb_real)0.5;
    for (int i = 0; i < s->count; i++)
        s->rest[i] = sb_v3_madd(s->best[i], part, s->best_gap[i]);
    s->known = s->has_last = 0;
}

/* Errors that smaller loads do not mend. */
static int sbi_unload_is_final(sb_result result)
{
    return result != SB_ERROR_NOT_CONVERGED && result != SB_ERROR_INVERTED && result != SB_ERROR_DIVERGED &&
           result != SB_ERROR_MESH;
}

/* The fixed point for a share of the loads, from rest; the body of the last trial is the answer's. */
static sb_result sbi_unload_share(sbi_unload *s, sb_real share, sb_real tolerance, sb_error *error)
{
    size_t bytes = (size_t)s->count * sizeof *s->rest;
    int failures = 0, has_best = 0;
    s->known = s->has_last = 0;
    for (int k = 0; k < s->def->max_iterations; k++) {
        sb_result result = sbi_unload_solve(s, share, error);
        sb_real gap = result == SB_OK ? sbi_unload_largest(s->gap, s->count) : 0;
        if (result == SB_OK)
            s->report->gap = gap;
        if (result == SB_OK && gap <= tolerance / 4)
            return share < 1 ? SB_OK : sbi_unload_verify(s, tolerance, error);
        if (result != SB_OK && (s->is_refused || sbi_unload_is_final(result) || !has_best))
            return result;
        if (result != SB_OK || (has_best && gap > 4 * s->least)) {
            if (++failures > SBI_UNLOAD_HALVINGS)
                return result == SB_OK ? SB_ERROR_NOT_CONVERGED : result;
            sbi_unload_retreat(s, failures);
            continue;
        }
        if (!has_best || gap < s->least) {
            memcpy(s->best, s->rest, bytes);
            memcpy(s->best_gap, s->gap, bytes);
            s->least = gap;
            has_best = 1;
            failures = 0;
        }
        sbi_unload_remember(s);
        sbi_unload_advance(s);
    }
    return SB_ERROR_NOT_CONVERGED;
}

/* What is said of the share that no rest shape was found for, unless it is of what the caller gave. */
static sb_result sbi_unload_give_up(const sbi_unload *s, sb_real share, sb_result result, sb_error *error)
{
    if (s->is_refused || s->report->solves == 0)
        return result;
    if (result == SB_ERROR_NOT_CONVERGED)
        return sbi_fail(error, result, "no rest shape found under %g of the loads: the gap is %g m of %g m",
                        (double)share, (double)s->report->gap, (double)s->report->size);
    if (result == SB_ERROR_MESH)
        return sbi_fail(error, SB_ERROR_INVERTED,
                        "no rest shape found under %g of the loads: elements of those tried are inside out",
                        (double)share);
    return result;
}

/* Raises the share of the loads to 1; one that fails is halved. */
static sb_result sbi_unload_run(sbi_unload *s, sb_error *error)
{
    size_t bytes = (size_t)s->count * sizeof *s->rest;
    sb_real stride = (sb_real)1 / (sb_real)s->def->load_steps, least = stride / 64, reached = 0;
    const sb_real loose = (sb_real)1e-3; /* of what is on the way only */
    while (reached < 1) {
        sb_real share = reached + stride > 1 - (sb_real)1e-3 * stride ? 1 : reached + stride;
        sb_real tolerance = s->report->size * (share < 1 ? sb_max(loose, s->def->tolerance) : s->def->tolerance);
        sb_result result;
        memset(error, 0, sizeof *error);
        result = sbi_unload_share(s, share, tolerance, error);
        if (result == SB_OK) {
            reached = s->report->share = share;
            s->report->load_steps++;
            memcpy(s->reached, s->rest, bytes);
            continue;
        }
        memcpy(s->rest, s->reached, bytes);
        stride *= (sb_real)0.5;
        if (s->is_refused || s->report->solves == 0 || sbi_unload_is_final(result) || stride < least)
            return sbi_unload_give_up(s, share, result, error);
    }
    return SB_OK;
}

/* ---- the call ---- */

static sb_result sbi_unload_check(const sb_unload_def *def, const sb_vec3 *rest, sb_error *error)
{
    sb_result result;
    if (!def || !rest)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_unload needs a def and room for the rest shape");
    if (def->cookie != SBI_UNLOAD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_unload_def");
    if (!def->body.mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.body.mesh is NULL");
    if (def->body.domain)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "def.body.domain belongs to one rest shape: it must be NULL");
    if (!(def->tolerance > 0) || !(def->tolerance < 1) || def->max_iterations < 1 || def->load_steps < 1 ||
        def->load_steps > SBI_UNLOAD_MOST_STEPS)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "tolerance must be in (0, 1), max_iterations >= 1 and load_steps 1 to %d",
                        (int)SBI_UNLOAD_MOST_STEPS);
    result = sbi_static_check_options(&def->statics, error);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(def->body.gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.body.gravity is not finite");
    return sb_mesh_validate(def->body.mesh, error);
}

static sb_result sbi_unload_take(sbi_unload *s, const sb_unload_def *def, sb_error *error)
{
    enum { VECTORS = 7 + 2 * SBI_UNLOAD_MEMORY };
    sb_vec3 **arrays[VECTORS] = {&s->rest, &s->gap, &s->last_rest, &s->last_gap, &s->best, &s->best_gap, &s->reached};
    sb_vec3 *at;
    s->def = def;
    s->count = def->body.mesh->node_count;
    s->mesh = *def->body.mesh;
    s->mesh.nodes = NULL;
    for (int k = 0; k < SBI_UNLOAD_MEMORY; k++) {
        arrays[7 + 2 * k] = &s->moves[k];
        arrays[8 + 2 * k] = &s->changes[k];
    }
    s->memory = sbi_alloc(&def->body.allocator, (size_t)s->count, (VECTORS + 1) * sizeof(sb_vec3));
    if (!s->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the search of a rest shape of %d nodes", s->count);
    at = (sb_vec3 *)s->memory;
    s->mesh.nodes = at;
    for (int k = 0; k < VECTORS; k++)
        *arrays[k] = at + (size_t)(k + 1) * (size_t)s->count;
    s->image = def->body.mesh->nodes;
    memcpy(s->rest, s->image, (size_t)s->count * sizeof *s->rest);
    memcpy(s->reached, s->image, (size_t)s->count * sizeof *s->rest);
    return SB_OK;
}

static sb_real sbi_unload_size(const sb_vec3 *nodes, int count)
{
    sb_vec3 low = nodes[0], high = nodes[0];
    for (int i = 1; i < count; i++) {
        low = sb_v3(sb_min(low.x, nodes[i].x), sb_min(low.y, nodes[i].y), sb_min(low.z, nodes[i].z));
        high = sb_v3(sb_max(high.x, nodes[i].x), sb_max(high.y, nodes[i].y), sb_max(high.z, nodes[i].z));
    }
    return sb_v3_norm(sb_v3_sub(high, low));
}

SB_API sb_result sb_body_unload(const sb_unload_def *def, sb_vec3 *rest, sb_body **body, sb_unload_report *report,
                                sb_error *error)
{
    sb_unload_report own_report;
    sb_error own_error;
    sbi_unload s;
    sb_result result;
    report = report ? report : &own_report;
    error = error ? error : &own_error;
    memset(report, 0, sizeof *report);
    memset(&s, 0, sizeof s);
    memset(error, 0, sizeof *error);
    s.report = report;
    result = sbi_unload_check(def, rest, error);
    if (result == SB_OK)
        result = sbi_unload_take(&s, def, error);
    if (result == SB_OK) {
        report->size = sbi_unload_size(s.image, s.count);
        result = sbi_unload_run(&s, error);
    }
    if (result == SB_OK) {
        for (int i = 0; i < s.count; i++)
            report->moved = sb_max(report->moved, sb_v3_norm(sb_v3_sub(s.image[i], s.rest[i])));
        memcpy(rest, s.rest, (size_t)s.count * sizeof *rest);
        if (body) {
            *body = s.body;
            s.body = NULL;
        }
        memset(error, 0, sizeof *error);
    }
    report->error = *error;
    sb_body_destroy(s.body);
    if (s.memory)
        sbi_free(&def->body.allocator, s.memory);
    return result;
}
