/* track: see track.h. */
#include "track.h"

#include <string.h>

#include "../softbody/base/bytes.h"
#include "cloud.h"
#include "track_private.h"

#define REGI_TRACK_COOKIE 0x7472616bu
/* s: evidence of scales fades in that. */
#define REGI_TRACK_FADES 0.1

REG_API reg_track_def reg_default_track_def(void)
{
    reg_track_def def;
    memset(&def, 0, sizeof def);
    def.pose = reg_rigid_identity();
    def.modes = 48;
    def.patches = 300;
    def.most_points = 2000;
    def.memory = 1;
    def.lost_after = 0.5;
    def.cookie = REGI_TRACK_COOKIE;
    return def;
}

/* ---- checks ---- */

static int regi_track_in(sb_real value, sb_real low, sb_real high) { return value >= low && value <= high; }

static sb_result regi_track_check_numbers(const reg_track_def *def, sb_error *error)
{
    sb_real far = 100 * def->model->size;
    if (def->modes < 1 || def->modes > REGI_TRACK_MODES || def->patches < 30 || def->patches > 1000 ||
        def->most_points < 1 || def->most_points > 10000000)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d modes, %d patches, %d points at most: out of range", def->modes,
                        def->patches, def->most_points);
    if (!regi_track_in(def->pose_sd, 0, far) || !regi_track_in(def->motion, 0, far) ||
        !regi_track_in(def->wander, 0, far) || !regi_track_in(def->misfit, 0, far))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "pose_sd %g, motion %g, wander %g, misfit %g: not from 0 to 100 sizes of the organ",
                        (double)def->pose_sd, (double)def->motion, (double)def->wander, (double)def->misfit);
    if (!regi_track_in(def->pose_turn, 0, 10) || !regi_track_in(def->turn, 0, 10) ||
        !(def->memory > 0 && sb_is_finite(def->memory)) || !(def->lost_after > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "pose_turn %g, turn %g, memory %g, lost_after %g: out of range",
                        (double)def->pose_turn, (double)def->turn, (double)def->memory, def->lost_after);
    return SB_OK;
}

/* All that frames may tell of, as they are in these arrays. */
static regi_marks_def regi_track_marks_of(const reg_track_def *def, const reg_landmark *landmarks,
                                          const reg_curve *curves)
{
    regi_marks_def marks;
    marks.landmarks = landmarks;
    marks.landmark_count = def->landmark_count;
    marks.curves = curves;
    marks.curve_count = def->curve_count;
    marks.all = 1;
    return marks;
}

static sb_result regi_track_check(const reg_track_def *def, sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    if (!def || def->cookie != REGI_TRACK_COOKIE || !def->model)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tracker needs a def made by reg_default_track_def, and a model");
    if (def->start && def->start->model != def->model)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the start is of another model");
    if (!regi_infer_is_motion(&def->pose))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the pose is no rigid motion");
    marks = regi_track_marks_of(def, def->landmarks, def->curves);
    result = regi_marks_check_model(&marks, error);
    return result == SB_OK ? regi_track_check_numbers(def, error) : result;
}

/* Fills in what the caller left open. */
static void regi_track_resolve(reg_track *t)
{
    reg_track_def *def = &t->def;
    sb_real size = t->model->size;
    const reg_quality *found = def->start ? &def->start->quality : NULL;
    def->modes = sbi_min_int(def->modes, 3 * t->model->prior.control_count);
    def->motion = def->motion > 0 ? def->motion : (sb_real)0.03 * size;
    def->wander = def->wander > 0 ? def->wander : (sb_real)0.04 * size;
    def->turn = def->turn > 0 ? def->turn : (sb_real)0.15;
    if (!(def->misfit > 0))
        def->misfit = found ? found->misfit : (sb_real)regi_infer_least_misfit(t->model);
    if (!(def->pose_sd > 0))
        def->pose_sd = found ? found->pose_sd[0] : (sb_real)0.02 * size;
    if (!(def->pose_turn > 0))
        def->pose_turn = found ? found->pose_sd[1] : (sb_real)0.05;
}

/* ---- life ---- */

static void regi_track_layout_search(reg_track *t, sbi_arena *arena)
{
    size_t c = (size_t)t->model->prior.control_count, trials = (size_t)t->def.modes + REGI_TRACK_SPARE;
    size_t real = sizeof(double), vec = sizeof(sb_vec3), nodes = (size_t)t->node_count;
    t->root = (double *)sbi_arena_take(arena, c, c * real);
    t->loads = (double *)sbi_arena_take(arena, trials, 3 * c * real);
    t->resultants = (double *)sbi_arena_take(arena, REGI_TRACK_POSE, 3 * c * real);
    t->gram = (double *)sbi_arena_take(arena, trials, trials * real);
    t->vectors = (double *)sbi_arena_take(arena, trials, trials * real);
    t->values = (double *)sbi_arena_take(arena, trials, 3 * real);
    t->moved = (sb_vec3 *)sbi_arena_take(arena, nodes, trials * vec);
    t->tractions = (sb_vec3 *)sbi_arena_take(arena, c, vec);
    t->shape = (sb_vec3 *)sbi_arena_take(arena, nodes, vec);
}

static void regi_track_layout_known(const reg_track *t, regi_track_known *known, sbi_arena *arena)
{
    size_t n = (size_t)t->unknowns;
    known->mean = (double *)sbi_arena_take(arena, n, sizeof(double));
    known->covariance = (double *)sbi_arena_take(arena, n, n * sizeof(double));
}

static void regi_track_layout(reg_track *t, sbi_arena *arena)
{
    size_t nodes = (size_t)t->node_count, skin = (size_t)t->skin_count, q = (size_t)t->def.modes;
    size_t n = (size_t)t->unknowns, points = (size_t)t->def.most_points, patches = (size_t)t->def.patches;
    size_t real = sizeof(double), vec = sizeof(sb_vec3), lines = (size_t)regi_marks_most_lines(&t->marks);
    regi_response_layout(&t->response, t->node_count, arena);
    regi_track_layout_known(t, &t->known, arena);
    regi_track_layout_known(t, &t->next, arena);
    t->arms = (sb_vec3 *)sbi_arena_take(arena, nodes, vec);
    t->modes = (sb_vec3 *)sbi_arena_take(arena, nodes, q * vec);
    t->skin_arms = (sb_vec3 *)sbi_arena_take(arena, skin, vec);
    t->skin_modes = (double *)sbi_arena_take(arena, skin, 3 * q * real);
    t->spread = (double *)sbi_arena_take(arena, n, n * real);
    t->patch_of = (int *)sbi_arena_take(arena, (size_t)t->model->skin.element_count, sizeof(int));
    t->patch_area = (double *)sbi_arena_take(arena, patches, real);
    t->incoming = (regi_look_point *)sbi_arena_take(arena, points, sizeof(regi_look_point));
    t->look.points = (regi_look_point *)sbi_arena_take(arena, points, sizeof(regi_look_point));
    t->look.patch_start = (int *)sbi_arena_take(arena, patches + 1, sizeof(int));
    t->look.sort = (sb_real *)sbi_arena_take(arena, points + patches, sizeof(sb_real));
    t->skin = (sb_vec3 *)sbi_arena_take(arena, skin, vec);
    t->rows = (double *)sbi_arena_take(arena, patches + 3 + lines, n * real);
    t->gaps = (double *)sbi_arena_take(arena, patches + lines, real);
    t->mark_arms = (sb_vec3 *)sbi_arena_take(arena, (size_t)t->marks.count, vec);
    t->mark_modes = (double *)sbi_arena_take(arena, (size_t)t->marks.count, 3 * q * real);
    regi_marks_layout(&t->marks, arena);
    t->information = (double *)sbi_arena_take(arena, n, n * real);
    t->beyond = (double *)sbi_arena_take(arena, q, real);
    t->whole = (double *)sbi_arena_take(arena, n, real);
    t->pull = (double *)sbi_arena_take(arena, n, real);
    t->forecast = (double *)sbi_arena_take(arena, n, real);
    t->small = (double *)sbi_arena_take(arena, q, q * real);
    t->diagonal = (double *)sbi_arena_take(arena, q, real);
    t->beside = (double *)sbi_arena_take(arena, q, real);
    t->along = (double *)sbi_arena_take(arena, q, real);
    t->turns = (double *)sbi_arena_take(arena, n, real);
    t->state = (double *)sbi_arena_take(arena, n, real);
    t->precision = (double *)sbi_arena_take(arena, n, n * real);
    t->precise = (double *)sbi_arena_take(arena, n, n * real);
    t->column = (double *)sbi_arena_take(arena, n, real);
    regi_track_layout_search(t, arena);
}

static sb_result regi_track_allocate(reg_track *t, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sb_result result;
    regi_track_layout(t, &arena);
    t->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&t->allocator, 1, arena.used);
    if (!t->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tracker of %d nodes", t->node_count);
    arena.base = (unsigned char *)t->memory;
    arena.used = 0;
    regi_track_layout(t, &arena);
    result = sb_surface_create(&t->model->skin, &t->allocator, &t->tree, error);
    return result == SB_OK ? sbi_body_make_factor(t->model->body, &t->allocator, &t->response.direct, error) : result;
}

/* Patches of the skin: triangles by the closest of vertices spread evenly. */
static sb_result regi_track_cut_skin(reg_track *t, sb_error *error)
{
    const sb_mesh *skin = &t->model->skin;
    int patches = sbi_min_int(t->def.patches, skin->node_count);
    int *chosen = (int *)sbi_alloc(&t->allocator, (size_t)patches, sizeof *chosen);
    sb_real *scratch = (sb_real *)sbi_alloc(&t->allocator, (size_t)skin->node_count, sizeof *scratch);
    if (chosen && scratch)
        t->patch_count = reg_cloud_spread(skin->nodes, skin->node_count, patches, chosen, scratch);
    sbi_free(&t->allocator, scratch);
    for (int e = 0; chosen && e < skin->element_count; e++) {
        const int *c = skin->elements + 3 * (size_t)e;
        sb_vec3 a = skin->nodes[c[0]], b = skin->nodes[c[1]], d = skin->nodes[c[2]];
        sb_vec3 middle = sb_v3_scale((sb_real)(1.0 / 3), sb_v3_add(a, sb_v3_add(b, d)));
        sb_real nearest = SB_REAL_MAX;
        for (int s = 0; s < t->patch_count; s++) {
            sb_vec3 way = sb_v3_sub(middle, skin->nodes[chosen[s]]);
            if (sb_v3_dot(way, way) < nearest) {
                nearest = sb_v3_dot(way, way);
                t->patch_of[e] = s;
            }
        }
        t->patch_area[t->patch_of[e]] += 0.5 * (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a)));
    }
    t->look.patch_count = t->patch_count;
    sbi_free(&t->allocator, chosen);
    return t->patch_count > 0
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d vertices", skin->node_count);
}

/* shape: where the organ is to begin, as displacements. */
static void regi_track_shape_of(reg_track *t, const reg_infer *start, const reg_rigid *pose)
{
    const sb_vec3 *rest = t->model->mesh.nodes;
    for (int i = 0; i < t->node_count; i++)
        t->shape[i] = start ? start->shape[i] : sb_v3_sub(reg_rigid_apply(pose, rest[i]), rest[i]);
}

/* Where landmarks and curves are on the model; none is seen yet. */
static sb_result regi_track_place_marks(reg_track *t, sb_error *error)
{
    const regi_marks_def marks = regi_track_marks_of(&t->def, t->def.landmarks, t->def.curves);
    regi_marks *m = &t->marks;
    sb_result result = regi_marks_place(m, &marks, &t->model->mesh, &t->allocator, &t->model->jobs, error);
    t->marks_hash = (uint64_t)m->landmark_count;
    for (int i = 0; i < m->curve_count; i++)
        t->marks_hash = sbi_hash_word(t->marks_hash, (uint64_t)(uint32_t)m->starts[i]);
    for (int i = 0; i < m->count; i++) {
        t->marks_hash = sbi_hash_word(t->marks_hash, sbi_real_bits(m->places[i].x));
        t->marks_hash = sbi_hash_word(t->marks_hash, sbi_real_bits(m->places[i].y));
        t->marks_hash = sbi_hash_word(t->marks_hash, sbi_real_bits(m->places[i].z));
    }
    return result;
}

static void regi_track_pose_sd(const reg_track *t, sb_real sd[2])
{
    sd[0] = t->def.pose_sd;
    sd[1] = t->def.pose_turn;
}

static sb_result regi_track_make(reg_track *t, sb_error *error)
{
    sb_real sd[2];
    regi_marks_def marks;
    sb_result result;
    t->node_count = t->model->mesh.node_count;
    t->skin_count = t->model->skin.node_count;
    regi_track_resolve(t);
    t->unknowns = t->def.modes + REGI_TRACK_POSE;
    t->wide = sbi_lanes_are_wide();
    t->response.model = t->model;
    t->look.size = t->model->size;
    marks = regi_track_marks_of(&t->def, t->def.landmarks, t->def.curves);
    regi_marks_count(&t->marks, &marks, t->model->size);
    result = regi_track_allocate(t, error);
    if (result == SB_OK)
        result = regi_track_place_marks(t, error);
    if (result == SB_OK)
        result = regi_track_cut_skin(t, error);
    if (result != SB_OK)
        return result;
    t->look.tree = t->tree;
    regi_track_shape_of(t, t->def.start, &t->def.pose);
    regi_track_pose_sd(t, sd);
    return regi_track_linearise(t, t->shape, sd, error);
}

REG_API sb_result reg_track_create(const reg_track_def *def, reg_track **track, sb_error *error)
{
    reg_track *made;
    sb_result result = regi_track_check(def, error);
    if (result == SB_OK && !track)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no place for a tracker");
    if (result != SB_OK)
        return result;
    made = (reg_track *)sbi_alloc_zeroed(&def->model->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tracker");
    made->allocator = def->model->allocator;
    made->model = def->model;
    made->def = *def;
    result = regi_track_make(made, error);
    made->def.start = NULL;
    made->def.landmarks = NULL;
    made->def.curves = NULL;
    if (result == SB_OK)
        *track = made;
    else
        reg_track_destroy(made);
    return result;
}

REG_API void reg_track_destroy(reg_track *track)
{
    sb_allocator allocator;
    if (!track)
        return;
    allocator = track->allocator;
    sb_direct_free(track->response.direct);
    sb_surface_destroy(track->tree);
    sb_embedding_rows_free(&track->marks.rows);
    sbi_free(&allocator, track->memory);
    sbi_free(&allocator, track);
}

REG_API sb_result reg_track_restart(reg_track *track, const reg_infer *start, sb_error *error)
{
    sb_real sd[2];
    if (!track || (start && start->model != track->model))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a restart needs a tracker, and no inference of another model");
    if (start)
        regi_track_shape_of(track, start, NULL);
    else
        (void)reg_track_displacements(track, track->shape);
    regi_track_pose_sd(track, sd);
    return regi_track_linearise(track, track->shape, sd, error);
}

/* ---- frames ---- */

REG_API sb_result reg_track_set_target(reg_track *track, const reg_points *target, sb_error *error)
{
    sb_result result;
    if (!track || !target || target->surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tracker needs a target of points");
    result = regi_infer_check_points(target, error);
    if (result == SB_OK && target->count > track->def.most_points)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "%d points are more than the %d that the tracker has room for",
                          target->count, track->def.most_points);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < target->count; i++)
        regi_look_take(track->incoming + i, target->points[i], target->normals ? target->normals[i] : sb_v3(0, 0, 0),
                       target->weights ? target->weights[i] : 1, target->sd ? target->sd[i] : 0);
    track->incoming_count = target->count;
    track->incoming_has_camera = target->has_camera;
    track->incoming_camera = target->camera;
    track->waiting = 1;
    return SB_OK;
}

REG_API sb_result reg_track_set_features(reg_track *track, const reg_landmark *landmarks, const reg_curve *curves,
                                         sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    if (!track || (track->def.landmark_count > 0 && !landmarks) || (track->def.curve_count > 0 && !curves))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "features need a tracker, and the landmarks and curves of its def");
    marks = regi_track_marks_of(&track->def, landmarks, curves);
    result = regi_marks_check_seen(&marks, track->known.place, 100 * track->model->size, error);
    if (result == SB_OK)
        regi_marks_see(&track->marks, &marks);
    return result;
}

/* 1 when a target agrees with nothing that was expected: its gaps are larger than what is usual, or far fewer of its
 * points can be believed. The first target is usual. */
static int regi_track_is_surprise(regi_track_known *next, const reg_track_info *info)
{
    sb_real fresh = next->usual_used > 0 ? (sb_real)0.1 : 1;
    if (fresh < 1 &&
        (info->innovation > 3 * sb_max(1, next->usual_innovation) || info->used < (sb_real)0.75 * next->usual_used))
        return 1;
    next->usual_used += fresh * (info->used - next->usual_used);
    next->usual_innovation += fresh * (info->innovation - next->usual_innovation);
    return 0;
}

/* next: whether the organ agrees with what was expected of it; three targets on end that do not are a jump. */
static void regi_track_judge(reg_track *t, int counted, reg_track_info *info)
{
    regi_track_known *next = &t->next;
    sb_real sd[2];
    info->state = REG_TRACK_PREDICTS;
    if (counted > 0)
        info->state = REG_TRACK_FOLLOWS;
    if (counted > 0 && t->waiting) {
        next->surprises = next->wide == 0 && regi_track_is_surprise(next, info) ? next->surprises + 1 : 0;
        next->wide -= next->wide > 0;
    }
    if (next->surprises == REGI_TRACK_SURPRISES) {
        regi_track_pose_sd(t, sd);
        regi_track_open(t, next, sd);
        info->state = REG_TRACK_JUMPED;
    }
    if (next->blind > t->def.lost_after)
        info->state = REG_TRACK_LOST;
}

static double regi_track_now(const reg_track *t) { return t->def.clock ? t->def.clock() : 0.0; }

REG_API sb_result reg_track_step(reg_track *track, double dt, reg_track_info *info)
{
    reg_track_info told;
    regi_track_known before;
    double begun;
    int counted = 0;
    sb_result result = SB_OK;
    memset(&told, 0, sizeof told);
    told.state = REG_TRACK_PREDICTS; /* of a step that fails: it took nothing in */
    if (!track || !(dt > 0) || !(dt <= 1e9)) {
        result = sbi_fail(&told.error, SB_ERROR_ARGUMENT, "a step needs a tracker and a dt above 0");
        if (info)
            *info = told;
        return result;
    }
    begun = regi_track_now(track);
    track->fresh = 1 - sbi_dense_exp(-dt / REGI_TRACK_FADES);
    regi_track_predict(track, dt);
    if (track->waiting || track->marks.fixed_count > 0 || track->marks.sample_count > 0)
        result = regi_track_take_in(track, &counted, &told);
    if (result == SB_OK) {
        regi_track_judge(track, counted, &told);
        before = track->known;
        track->known = track->next;
        track->next = before;
    }
    track->waiting = 0;
    regi_marks_forget(&track->marks);
    told.time = track->known.time;
    told.blind = track->known.blind;
    told.expected = regi_track_expected(track, &track->known);
    told.seconds = regi_track_now(track) - begun;
    if (info)
        *info = told;
    return result;
}

/* ---- where it is ---- */

REG_API sb_result reg_track_displacements(const reg_track *track, sb_vec3 *displacements)
{
    sb_mat3 rotation;
    if (!track || !displacements)
        return SB_ERROR_ARGUMENT;
    rotation = sb_quat_to_mat3(track->known.turned);
    memcpy(displacements, track->arms, (size_t)track->node_count * sizeof *displacements);
    for (int k = 0; k < track->def.modes; k++) {
        const sb_vec3 *mode = track->modes + (size_t)k * (size_t)track->node_count;
        for (int i = 0; i < track->node_count; i++)
            displacements[i] = sb_v3_madd(displacements[i], (sb_real)track->known.mean[k], mode[i]);
    }
    for (int i = 0; i < track->node_count; i++)
        displacements[i] = sb_v3_sub(sb_v3_add(track->known.place, sb_m3_apply(rotation, displacements[i])),
                                     track->model->mesh.nodes[i]);
    return SB_OK;
}

REG_API sb_result reg_track_covariances(const reg_track *track, sb_mat3 *covariances)
{
    double row[REGI_TRACK_UNKNOWNS];
    if (!track || !covariances)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < track->node_count; i++)
        regi_track_covariance_of(track, i, row, covariances + i);
    return SB_OK;
}

REG_API const char *reg_track_state_string(reg_track_state state)
{
    switch (state) {
    case REG_TRACK_FOLLOWS: return "follows";
    case REG_TRACK_PREDICTS: return "predicts";
    case REG_TRACK_JUMPED: return "jumped";
    case REG_TRACK_LOST: return "lost";
    default: return "unknown state";
    }
}
