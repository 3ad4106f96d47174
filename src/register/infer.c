/* infer: see infer.h. */
#include "infer.h"

#include <string.h>

#include "cloud.h"
#include "infer_private.h"

#define REGI_INFER_COOKIE 0x696e6672u

REG_API reg_infer_def reg_default_infer_def(void)
{
    reg_infer_def def;
    memset(&def, 0, sizeof def);
    def.start = reg_rigid_identity();
    def.start_turn = (sb_real)0.2;
    def.gravity = 1;
    def.samples = 300;
    def.rounds = 5;
    def.max_seconds = 1e9;
    def.cookie = REGI_INFER_COOKIE;
    return def;
}

/* ---- checks ---- */

REGI_API sb_result regi_infer_check_points(const reg_points *t, sb_error *error)
{
    sb_result result;
    if ((t->points != NULL) == (t->surface != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a target needs either points or a surface");
    if (t->has_camera != 0 && t->has_camera != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "has_camera is %d, not 0 or 1", t->has_camera);
    if (t->has_camera && !sb_v3_is_finite(t->camera))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the camera's place is not finite");
    if (t->surface)
        return SB_OK;
    result = regi_cloud_check(t->points, t->normals, t->count, error);
    for (int i = 0; result == SB_OK && i < t->count; i++)
        if ((t->sd && !(t->sd[i] > 0 && sb_is_finite(t->sd[i]))) ||
            (t->weights && !(t->weights[i] >= 0 && sb_is_finite(t->weights[i]))))
            result = sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "sd or weight of point %d is out of range", i);
    return result;
}

REGI_API int regi_infer_is_motion(const reg_rigid *motion)
{
    sb_mat3 square = sb_m3_sub(sb_m3_tmul(motion->rotation, motion->rotation), sb_m3_identity());
    return sb_v3_is_finite(motion->translation) && sb_m3_ddot(square, square) < (sb_real)1e-6 &&
           sb_m3_det(motion->rotation) > 0;
}

/* Those of a def, that count. */
static regi_marks_def regi_infer_marks_of(const reg_infer_def *def)
{
    regi_marks_def marks;
    marks.landmarks = def->landmarks;
    marks.landmark_count = def->landmark_count;
    marks.curves = def->curves;
    marks.curve_count = def->curve_count;
    marks.all = 0;
    return marks;
}

static sb_result regi_infer_check(const reg_infer_def *def, sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    if (!def || def->cookie != REGI_INFER_COOKIE || !def->model)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "an inference needs a def made by reg_default_infer_def, and a model");
    if (def->samples < 30 || def->samples > 1000 || def->rounds < 1 || def->rounds > 100)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d samples, %d rounds: out of range", def->samples, def->rounds);
    if (!(def->start_sd >= 0 && def->start_sd <= 100 * def->model->size) ||
        !(def->start_turn > 0 && def->start_turn <= 10) || !(def->max_seconds > 0) ||
        (def->gravity != 0 && def->gravity != 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "start_sd %g, start_turn %g, max_seconds %g, gravity %d: out of range", (double)def->start_sd,
                        (double)def->start_turn, def->max_seconds, def->gravity);
    if (!regi_infer_is_motion(&def->start))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the start is no rigid motion");
    marks = regi_infer_marks_of(def);
    result = regi_marks_check_model(&marks, error);
    if (result == SB_OK)
        result = regi_marks_check_seen(&marks, sb_v3(0, 0, 0), SB_REAL_MAX, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; def->pressed && i < def->model->mesh.node_count; i++)
        if (!sb_is_finite(def->pressed[i]) || !(def->pressed[i] >= 0 && def->pressed[i] <= 1))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "node %d is pressed by %g of a pressure: not 0 to 1", i,
                                 (double)def->pressed[i]);
    return regi_infer_check_points(&def->target, error);
}

/* ---- the target ---- */

/* The nodes of a surface, by area (of the mean, so that weights are about 1). */
static void regi_infer_take_surface(reg_infer *f, const sb_mesh *triangles)
{
    sb_real mean = 0;
    for (int i = 0; i < triangles->node_count; i++)
        regi_look_take(f->look.points + i, triangles->nodes[i], sb_v3(0, 0, 0), 0, 0);
    for (int t = 0; t < triangles->element_count; t++) {
        const int *c = triangles->elements + 3 * (size_t)t;
        sb_vec3 a = sb_v3_sub(triangles->nodes[c[1]], triangles->nodes[c[0]]);
        sb_vec3 area = sb_v3_cross(a, sb_v3_sub(triangles->nodes[c[2]], triangles->nodes[c[0]]));
        for (int k = 0; k < 3; k++) {
            f->look.points[c[k]].normal = sb_v3_add(f->look.points[c[k]].normal, area);
            f->look.points[c[k]].weight += sb_v3_norm(area);
        }
        mean += 3 * sb_v3_norm(area) / (sb_real)triangles->node_count;
    }
    for (int i = 0; i < triangles->node_count; i++) {
        f->look.points[i].normal = regi_cloud_unit(f->look.points[i].normal);
        f->look.points[i].weight = mean > 0 ? f->look.points[i].weight / mean : 0;
    }
}

static void regi_infer_take_cloud(reg_infer *f)
{
    const reg_points *t = &f->def->target;
    for (int i = 0; i < t->count; i++)
        regi_look_take(f->look.points + i, t->points[i], t->normals ? t->normals[i] : sb_v3(0, 0, 0),
                       t->weights ? t->weights[i] : 1, t->sd ? t->sd[i] : 0);
}

/* ---- life ---- */

REGI_API int regi_infer_most_data(const reg_infer *f) { return f->look.patch_count + regi_marks_most_lines(&f->marks); }

static void regi_infer_layout(reg_infer *f, sbi_arena *arena)
{
    size_t n = (size_t)f->node_count, c = (size_t)f->model->prior.control_count, points = (size_t)f->look.point_count;
    size_t patches = (size_t)f->look.patch_count, loads = (size_t)f->loads;
    size_t most = (size_t)regi_infer_most_data(f) + REGI_GAUSS_EXACT, cells = (size_t)f->model->domain.cell_count;
    size_t width = (size_t)f->model->domain.nodes_per_cell, real = sizeof(double), vec = sizeof(sb_vec3);
    f->look.points = (regi_look_point *)sbi_arena_take(arena, points, sizeof(regi_look_point));
    f->look.patch_start = (int *)sbi_arena_take(arena, patches + 1, sizeof(int));
    f->patch_of = (int *)sbi_arena_take(arena, most, sizeof(int));
    f->look.sort = (sb_real *)sbi_arena_take(arena, points + patches, sizeof(sb_real));
    f->averaged = (double *)sbi_arena_take(arena, most, real);
    regi_marks_layout(&f->marks, arena);
    f->raw = (double *)sbi_arena_take(arena, loads, most * real);
    f->root = (double *)sbi_arena_take(arena, c, c * real);
    f->turned_root = (double *)sbi_arena_take(arena, c, c * real);
    f->tile = (double *)sbi_arena_take(arena, most > c ? most : c, REGI_BLOCK_WIDTH * real);
    f->extended = (double *)sbi_arena_take(arena, most, most * real);
    f->local = (double *)sbi_arena_take(arena, c, real);
    f->trial_local = (double *)sbi_arena_take(arena, c, real);
    f->energy = (double *)sbi_arena_take(arena, c + REGI_INFER_POSE, real);
    f->c = (double *)sbi_arena_take(arena, loads, real);
    f->draw = (double *)sbi_arena_take(arena, loads, real);
    f->datum = (double *)sbi_arena_take(arena, most, real);
    f->chances = (double *)sbi_arena_take(arena, loads + REGI_GAUSS_POSES + most, REG_INFER_DRAWS * real);
    f->tractions = (sb_vec3 *)sbi_arena_take(arena, c, vec);
    f->pressing = f->def->pressed ? (sb_vec3 *)sbi_arena_take(arena, c, vec) : NULL;
    f->drift = (double *)sbi_arena_take(arena, REGI_RESPONSE_MODES, most * real);
    f->row = (sb_vec3 *)sbi_arena_take(arena, n, REG_INFER_DRAWS * vec);
    f->skin = (sb_vec3 *)sbi_arena_take(arena, (size_t)f->model->skin.node_count, vec);
    regi_response_layout(&f->response, f->node_count, arena);
    f->forces = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->increment = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->trial = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->before = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->shape = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->errors = (sb_vec3 *)sbi_arena_take(arena, n, REG_INFER_DRAWS * vec);
    f->expected = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    f->cell_force = (sb_vec3 *)sbi_arena_take(arena, cells, width * vec);
    f->poisson_force = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->region = (sb_real *)sbi_arena_take(arena, cells, REGI_INFER_REGIONS * sizeof(sb_real));
}

static sb_result regi_infer_allocate(reg_infer *f, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    int most = regi_infer_most_data(f) + REGI_GAUSS_EXACT;
    sb_result result;
    regi_infer_layout(f, &arena);
    f->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&f->allocator, 1, arena.used);
    if (!f->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for an inference from %d points", f->look.point_count);
    arena.base = (unsigned char *)f->memory;
    arena.used = 0;
    regi_infer_layout(f, &arena);
    result = regi_gauss_create(most, f->loads, &f->allocator, &f->gauss, error);
    f->response.direct = f->model->direct;
    return result;
}

/* Nodes that the rows of a mapping have at most. */
static size_t regi_infer_widest(const sb_mapping *mapping, int rows)
{
    int most = 0;
    for (int i = 0; i < rows; i++)
        most = sbi_max_int(most, mapping->row_start[i + 1] - mapping->row_start[i]);
    return (size_t)most;
}

/* Room for what the inverse goes between: the nodes that patches and lines depend on. */
static sb_result regi_infer_make_between(reg_infer *f, sb_error *error)
{
    const reg_model *m = f->model;
    size_t n = (size_t)f->node_count, lines = (size_t)regi_marks_most_lines(&f->marks),
           dense = (size_t)f->look.patch_count * n;
    size_t points = 3 * (size_t)f->look.point_count * regi_infer_widest(&m->rows.mapping, m->skin.node_count);
    size_t entries = points < dense ? points : dense;
    if (lines > 0)
        entries += 2 * lines * regi_infer_widest(&f->marks.rows.mapping, f->marks.count);
    return sbi_between_create(f->response.direct, regi_infer_most_data(f), m->prior.control_count, entries,
                              &f->allocator, &f->between, error);
}

/* The organ at the start, and what the pose may be about it. */
static sb_result regi_infer_begin(reg_infer *f)
{
    const reg_infer_def *def = f->def;
    const sb_mesh *mesh = &f->model->mesh;
    sb_vec3 middle = sb_v3(0, 0, 0);
    sb_real sd = def->start_sd > 0 ? def->start_sd : (sb_real)0.07 * f->model->size;
    for (int i = 0; i < f->node_count; i++) {
        f->trial[i] = sb_v3_sub(reg_rigid_apply(&def->start, mesh->nodes[i]), mesh->nodes[i]);
        middle = sb_v3_madd(middle, 1 / (sb_real)(i + 1), sb_v3_sub(mesh->nodes[i], middle));
    }
    f->response.centre = reg_rigid_apply(&def->start, middle);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->pose_sd[k] = (double)(k < 3 ? sd : def->start_turn);
    f->temper = f->alike = 1;
    f->gauss.poses = REGI_GAUSS_POSES;
    f->gauss.exact = f->model->held ? 0 : REGI_GAUSS_EXACT;
    sb_body_reset(f->model->body);
    return sb_body_set_displacements(f->model->body, f->trial);
}

/* 1 when there is no time for a round that takes as long as those before. */
static int regi_infer_is_late(const reg_infer *f)
{
    double spent = regi_infer_now(f) - f->begun, round = f->quality.rounds ? spent / f->quality.rounds : 0;
    return f->def->clock && f->quality.rounds > 0 && spent + round >= f->def->max_seconds;
}

static sb_result regi_infer_iterate(reg_infer *f, sb_error *error)
{
    sb_real rest = (sb_real)1e-3 * f->model->size;
    sb_result result = SB_OK;
    f->quality.stop = REG_INFER_ROUNDS;
    for (int round = 0; result == SB_OK && round < f->def->rounds; round++) {
        if (regi_infer_is_late(f)) {
            f->quality.stop = REG_INFER_CAPPED;
            break;
        }
        result = regi_infer_round(f, round, error);
        if (f->quality.change <= rest) {
            f->quality.stop = REG_INFER_CONVERGED;
            break;
        }
    }
    return result == SB_OK ? regi_infer_meet(f) : result;
}

static sb_result regi_infer_make(reg_infer *f, const sb_mesh *triangles, sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    f->node_count = f->model->mesh.node_count;
    f->response.model = f->model;
    f->look.tree = f->model->tree;
    f->look.size = f->model->size;
    f->look.has_camera = f->def->target.has_camera;
    f->look.camera = f->def->target.camera;
    f->loads = 3 * f->model->prior.control_count + REGI_INFER_WEIGHT + (f->def->pressed != NULL);
    f->look.point_count = triangles ? triangles->node_count : f->def->target.count;
    f->look.patch_count = sbi_min_int(f->def->samples, f->look.point_count);
    marks = regi_infer_marks_of(f->def);
    regi_marks_count(&f->marks, &marks, f->model->size);
    result = regi_infer_allocate(f, error);
    if (result != SB_OK)
        return result;
    if (triangles)
        regi_infer_take_surface(f, triangles);
    else
        regi_infer_take_cloud(f);
    result = regi_infer_group(f, f->look.patch_count, error);
    if (result == SB_OK) {
        f->spacing = regi_infer_spacing(f);
        result = regi_marks_place(&f->marks, &marks, &f->model->mesh, &f->allocator, &f->model->jobs, error);
    }
    if (result == SB_OK)
        regi_marks_see(&f->marks, &marks);
    if (result == SB_OK)
        result = regi_infer_make_between(f, error);
    if (result == SB_OK)
        result = regi_infer_begin(f);
    if (result == SB_OK)
        result = regi_infer_iterate(f, error);
    return result == SB_OK ? regi_infer_tell(f, error) : result;
}

REG_API sb_result reg_infer_run(const reg_infer_def *def, reg_infer **infer, sb_error *error)
{
    sb_mesh triangles;
    reg_infer *made;
    sb_result result = regi_infer_check(def, error);
    if (result == SB_OK && !infer)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no place for an inference");
    if (result != SB_OK)
        return result;
    memset(&triangles, 0, sizeof triangles);
    if (def->target.surface)
        result = sb_surface_triangulate(def->target.surface, &def->model->allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    made = (reg_infer *)sbi_alloc_zeroed(&def->model->allocator, 1, sizeof *made);
    if (made) {
        made->allocator = def->model->allocator;
        made->def = def;
        made->model = def->model;
        made->begun = regi_infer_now(made);
        result = regi_infer_make(made, def->target.surface ? &triangles : NULL, error);
        made->quality.seconds = regi_infer_now(made) - made->begun;
        made->def = NULL;
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for an inference");
    }
    sb_mesh_free(&triangles);
    if (result == SB_OK)
        *infer = made;
    else
        reg_infer_destroy(made);
    return result;
}

REG_API void reg_infer_destroy(reg_infer *infer)
{
    sb_allocator allocator;
    if (!infer)
        return;
    allocator = infer->allocator;
    sb_embedding_rows_free(&infer->marks.rows);
    sbi_between_free(infer->between);
    regi_gauss_free(&infer->gauss);
    sbi_free(&allocator, infer->memory);
    sbi_free(&allocator, infer);
}

/* ---- the answer ---- */

REG_API sb_result reg_infer_displacements(const reg_infer *infer, sb_vec3 *displacements)
{
    if (!infer || !displacements)
        return SB_ERROR_ARGUMENT;
    memcpy(displacements, infer->shape, (size_t)infer->node_count * sizeof *displacements);
    return SB_OK;
}

REG_API sb_result reg_infer_forces(const reg_infer *infer, sb_vec3 *forces)
{
    if (!infer || !forces)
        return SB_ERROR_ARGUMENT;
    memcpy(forces, infer->forces, (size_t)infer->node_count * sizeof *forces);
    return SB_OK;
}

REG_API sb_result reg_infer_expected(const reg_infer *infer, sb_real *expected)
{
    if (!infer || !expected)
        return SB_ERROR_ARGUMENT;
    memcpy(expected, infer->expected, (size_t)infer->node_count * sizeof *expected);
    return SB_OK;
}

REG_API sb_result reg_infer_draw(const reg_infer *infer, int index, sb_vec3 *displacements)
{
    if (!infer || !displacements)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= REG_INFER_DRAWS)
        return SB_ERROR_INDEX;
    for (int i = 0; i < infer->node_count; i++)
        displacements[i] =
            sb_v3_add(infer->shape[i], infer->errors[(size_t)index * (size_t)infer->node_count + (size_t)i]);
    return SB_OK;
}

/* ---- the report ---- */

REG_API sb_result reg_infer_get_quality(const reg_infer *infer, reg_quality *quality)
{
    if (!infer || !quality)
        return SB_ERROR_ARGUMENT;
    *quality = infer->quality;
    return SB_OK;
}

REG_API const char *reg_prior_string(reg_prior_kind prior)
{
    switch (prior) {
    case REG_PRIOR_RIGID: return "rigid";
    case REG_PRIOR_SMOOTH: return "smooth";
    case REG_PRIOR_LOCAL: return "local";
    case REG_PRIOR_GRAVITY: return "gravity";
    case REG_PRIOR_PRESSURE: return "pressure";
    default: return "unknown prior";
    }
}

REG_API const char *reg_infer_stop_string(reg_infer_stop stop)
{
    switch (stop) {
    case REG_INFER_CONVERGED: return "converged";
    case REG_INFER_ROUNDS: return "rounds";
    case REG_INFER_CAPPED: return "time";
    default: return "unknown stop";
    }
}
