/* load: dead loads, follower pressure, springs, penalty mappings. */
#include "load.h"

#include <string.h>

#include "body_private.h"
#include "cable_law.h"
#include "cavity_law.h"
#include "live_private.h"
#include "membrane_law.h"

/* ---- dead loads ---- */

SB_API sb_result sb_body_apply_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform,
                                      sb_error *error)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count, error);
    if (result == SB_OK)
        result = sbi_body_check_vectors(forces, nodes, count, uniform, "forces", error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < count; i++) {
        sb_vec3 f = forces[uniform ? 0 : i];
        if ((f.x != 0 || f.y != 0 || f.z != 0) && body->node_component[nodes[i]] < 0)
            return sbi_fail_node(error, SB_ERROR_INDEX, nodes[i],
                                 "node %d belongs to no element: no force can act on it", nodes[i]);
    }
    for (int i = 0; i < count; i++)
        body->dead_load[nodes[i]] = sb_v3_add(body->dead_load[nodes[i]], forces[uniform ? 0 : i]);
    if (count > 0)
        sbi_body_tell(body, SBI_COMMAND_FORCES, 0, uniform != 0, nodes, (size_t)count, &forces[0].x,
                      uniform ? 3 : 3 * (size_t)count);
    return SB_OK;
}

SB_API sb_result sb_body_add_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform)
{
    return sb_body_apply_forces(body, nodes, count, forces, uniform, NULL);
}

SB_API void sb_body_clear_loads(sb_body *body)
{
    if (!body)
        return;
    memset(body->dead_load, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
    body->traction_count = 0;
    sbi_body_tell(body, SBI_COMMAND_CLEAR_LOADS, 0, 0, NULL, 0, NULL, 0);
}

/* ---- faces ---- */

/* Shape functions of a face type at its quadrature points. */
typedef struct sbi_load_rule {
    sb_element_type type; /* SB_NO_ELEMENT: none yet */
    int count;
    sb_real weights[SB_MAX_QUADRATURE_POINTS];
    sb_real shape[SB_MAX_QUADRATURE_POINTS][SB_MAX_FACE_NODES];
    sb_real gradient[SB_MAX_QUADRATURE_POINTS][SB_MAX_FACE_NODES][3];
} sbi_load_rule;

/* The rule of a part of a face of tri3 or tri6: forces on flat faces are exact, and so is their sum on bent ones. */
static void sbi_load_make_part_rule(sb_element_type type, const sb_real *loads, sbi_load_rule *rule)
{
    sb_real points[3][3];
    rule->type = SB_NO_ELEMENT; /* good for this part only */
    rule->count = sbi_piece_face_points(loads, sb_element_node_count(type), points, rule->weights);
    for (int p = 0; p < rule->count; p++)
        sb_element_shape(type, points[p], rule->shape[p], rule->gradient[p]);
}

/* Makes the rule of a type unless it is there already. */
static void sbi_load_need_rule(sb_element_type type, sbi_load_rule *rule)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3];
    if (rule->type == type)
        return;
    rule->type = type;
    rule->count = sb_element_quadrature(type, SB_QUADRATURE_FACE, points, rule->weights);
    for (int p = 0; p < rule->count; p++)
        sb_element_shape(type, points[p], rule->shape[p], rule->gradient[p]);
}

/* Sum of N_a x_a and of its derivatives by the face's parameters, at point p. */
typedef struct sbi_load_tangents {
    sb_vec3 value, r, s;
} sbi_load_tangents;

static sbi_load_tangents sbi_load_interpolate(const sbi_load_rule *rule, int p, int count, const sb_vec3 *x)
{
    sbi_load_tangents sum = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    for (int a = 0; a < count; a++) {
        sum.value = sb_v3_madd(sum.value, rule->shape[p][a], x[a]);
        sum.r = sb_v3_madd(sum.r, rule->gradient[p][a][0], x[a]);
        sum.s = sb_v3_madd(sum.s, rule->gradient[p][a][1], x[a]);
    }
    return sum;
}

/* ---- traction ---- */

/* 1: faces may be cut, and what of them is material is looked up. */
static int sbi_load_has_pieces(const sb_body *body) { return body->live && body->live->piece_count; }

/* Makes the rule of a face: of the part of it that is material. */
static void sbi_load_need_face_rule(const sb_body *body, const sbi_body_face *face, sbi_load_rule *rule)
{
    sb_real loads[SB_MAX_FACE_NODES];
    int is_part = 0;
    if (sbi_load_has_pieces(body) && !face->inner) {
        sbi_body_face_loads(body, face->nodes, face->count, loads);
        is_part = !sbi_piece_is_whole_face(loads, face->count);
    }
    if (is_part)
        sbi_load_make_part_rule(face->type, loads, rule);
    else
        sbi_load_need_rule(face->type, rule);
}

/* Makes the rule of a row of a pressure. */
static void sbi_load_need_row_rule(const sbi_load *load, int row, sbi_load_rule *rule)
{
    const sb_real *loads = load->weights + load->row_start[row];
    if (load->has_parts && !sbi_piece_is_whole_face(loads, load->row_start[row + 1] - load->row_start[row]))
        sbi_load_make_part_rule(load->face_types[row], loads, rule);
    else
        sbi_load_need_rule(load->face_types[row], rule);
}

SBI_API void sbi_load_weigh_faces(const sb_body *body, sbi_load *load)
{
    load->has_parts = 0;
    if (!sbi_load_has_faces(load) || !sbi_load_has_pieces(body))
        return;
    for (int j = 0; j < load->row_count; j++) {
        sb_real *loads = load->weights + load->row_start[j];
        int count = load->row_start[j + 1] - load->row_start[j];
        sbi_body_face_loads(body, load->nodes + load->row_start[j], count, loads);
        load->has_parts |= !sbi_piece_is_whole_face(loads, count);
    }
}

/* load_a += int t N_a dA over a face of the reference shape. */
static void sbi_load_add_traction(const sb_body *body, const sbi_body_face *face, const sbi_load_rule *rule,
                                  sb_vec3 traction, sb_vec3 *dead_load)
{
    sb_vec3 x[SB_MAX_FACE_NODES];
    for (int a = 0; a < face->count; a++)
        x[a] = body->reference[face->nodes[a]];
    for (int p = 0; p < rule->count; p++) {
        sbi_load_tangents t = sbi_load_interpolate(rule, p, face->count, x);
        sb_real area = rule->weights[p] * sb_v3_norm(sb_v3_cross(t.r, t.s));
        for (int a = 0; a < face->count; a++) {
            sb_vec3 *load = dead_load + face->nodes[a];
            *load = sb_v3_madd(*load, area * rule->shape[p][a], traction);
        }
    }
}

/* Tractions are kept by face where faces may be cut. */
static int sbi_load_keeps_tractions(const sb_body *body)
{
    return body->live && (body->domain.element_type == SB_TET4 || body->domain.element_type == SB_TET10);
}

/* The nodes of a face with as many, as a traction keeps them. */
static sbi_traction sbi_load_traction_on(const int *nodes, int count)
{
    sbi_traction traction;
    for (int k = 0; k < 6; k++)
        traction.nodes[k] = k < count ? nodes[k] : -1;
    traction.stress = sb_v3(0, 0, 0);
    return traction;
}

SBI_API sb_result sbi_body_reserve_tractions(sb_body *body, int more, sb_error *error)
{
    int64_t needed = (int64_t)body->traction_count + more, capacity = needed + needed / 2;
    sbi_traction *grown;
    if (needed <= body->traction_capacity)
        return SB_OK;
    grown = capacity < INT32_MAX ? (sbi_traction *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof(sbi_traction))
                                 : NULL;
    if (!grown)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for tractions on %d faces more", more);
    if (body->traction_count)
        memcpy(grown, body->tractions, (size_t)body->traction_count * sizeof *grown);
    sbi_free(&body->allocator, body->tractions);
    body->tractions = grown;
    body->traction_capacity = (int)capacity;
    return SB_OK;
}

SBI_API void sbi_body_spread_traction(const sb_body *body, const sbi_traction *traction, sb_vec3 *dead_load)
{
    sbi_load_rule rule;
    sbi_body_face face;
    face.type = traction->nodes[3] < 0 ? SB_TRI3 : SB_TRI6;
    face.count = sb_element_node_count(face.type);
    face.inner = 0;
    memcpy(face.nodes, traction->nodes, (size_t)face.count * sizeof *face.nodes);
    rule.type = SB_NO_ELEMENT;
    sbi_load_need_face_rule(body, &face, &rule);
    sbi_load_add_traction(body, &face, &rule, traction->stress, dead_load);
}

static int sbi_load_is_on(const sbi_traction *traction, const sbi_body_face *face)
{
    return memcmp(traction->nodes, face->nodes, (size_t)face->count * sizeof *face->nodes) == 0;
}

/* Where the tractions on the faces of a call begin among those kept, when it was made before. */
static int sbi_load_first_traction(const sb_body *body, const sbi_body_face *face)
{
    int at = 0;
    while (at < body->traction_count && !sbi_load_is_on(body->tractions + at, face))
        at++;
    return at;
}

/* Keeps a traction on a face, with that kept at *at where this is the same face; there is room for one more. So calls
 * that are made each frame do not add up in memory. */
static void sbi_load_keep_traction(sb_body *body, const sbi_body_face *face, sb_vec3 traction, int *at)
{
    sbi_traction *kept = body->tractions + *at;
    if (*at < body->traction_count && sbi_load_is_on(kept, face)) {
        kept->stress = sb_v3_add(kept->stress, traction);
        ++*at;
        return;
    }
    kept = body->tractions + body->traction_count++;
    *kept = sbi_load_traction_on(face->nodes, face->count);
    kept->stress = traction;
    *at = body->traction_count;
}

/* Adds a traction on a face; *at: see sbi_load_keep_traction. */
static void sbi_load_add_face_traction(sb_body *body, const sbi_body_face *face, sbi_load_rule *rule, sb_vec3 traction,
                                       int *at)
{
    if (sbi_load_keeps_tractions(body) && !face->inner)
        sbi_load_keep_traction(body, face, traction, at);
    sbi_load_need_face_rule(body, face, rule);
    sbi_load_add_traction(body, face, rule, traction, body->dead_load);
}

SB_API sb_result sb_body_add_traction(sb_body *body, const int *faces, int face_count, int corners, sb_vec3 traction,
                                      sb_error *error)
{
    sb_result result = SB_OK;
    sbi_load_rule rule;
    sbi_body_face face, twins[SBI_BODY_TWINS];
    int64_t found = 0;
    int at = 0;
    rule.type = SB_NO_ELEMENT;
    if (!body || face_count < 0 || corners < 3 || corners > 4 || (face_count > 0 && !faces))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_traction needs faces of 3 or 4 corners");
    if (!sb_v3_is_finite(traction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the traction is not finite");
    for (int f = face_count - 1; f >= 0 && result == SB_OK; f--) { /* find all faces before any load changes */
        result = sbi_body_get_face(body, faces, f, corners, &face, error);
        found += result == SB_OK ? sbi_body_twin_faces(body, &face, twins) : 0;
    }
    if (result == SB_OK && face_count > 0 && sbi_load_keeps_tractions(body)) {
        result = sbi_body_reserve_tractions(body, (int)(found < INT32_MAX ? found : INT32_MAX), error);
        at = sbi_load_first_traction(body, &face);
    }
    if (result != SB_OK)
        return result;
    for (int f = 0; f < face_count; f++) {
        int count;
        sbi_body_get_face(body, faces, f, corners, &face, NULL);
        count = sbi_body_twin_faces(body, &face, twins);
        for (int k = 0; k < count; k++)
            sbi_load_add_face_traction(body, twins + k, &rule, traction, &at);
    }
    sbi_body_tell(body, SBI_COMMAND_TRACTION, corners, 0, faces, (size_t)face_count * (size_t)corners, &traction.x, 3);
    return SB_OK;
}

/* ---- the list of loads ---- */

SBI_API sbi_load *sbi_load_find(const sb_body *body, int id, int kind)
{
    int low = 0, high = body ? body->load_count : 0;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (body->loads[middle].id < id)
            low = middle + 1;
        else
            high = middle;
    }
    if (!body || low == body->load_count || body->loads[low].id != id || (kind && (int)body->loads[low].kind != kind))
        return NULL;
    return body->loads + low;
}

SBI_API sb_result sbi_load_reserve(sb_body *body, sb_error *error)
{
    int capacity = body->load_capacity + body->load_capacity / 2 + 4;
    sbi_load *grown;
    if (body->last_load_id == INT32_MAX)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "all ids of loads are used up");
    if (body->load_count < body->load_capacity)
        return SB_OK;
    grown = (sbi_load *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof *grown);
    if (!grown)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d loads", capacity);
    if (body->load_count)
        memcpy(grown, body->loads, (size_t)body->load_count * sizeof *grown);
    sbi_free(&body->allocator, body->loads);
    body->loads = grown;
    body->load_capacity = capacity;
    return SB_OK;
}

/* Takes the arrays of a load (measuring or for real). */
static void sbi_load_layout(sbi_load *load, int entries, size_t pairs, sbi_arena *arena)
{
    size_t rows = (size_t)load->row_count;
    load->row_start = (int *)sbi_arena_take(arena, rows + 1, sizeof(int));
    load->nodes = (int *)sbi_arena_take(arena, (size_t)entries, sizeof(int));
    load->blocks = (int *)sbi_arena_take(arena, pairs, sizeof(int));
    load->weights = (sb_real *)sbi_arena_take(arena, (size_t)entries, sizeof(sb_real));
    if (sbi_load_has_faces(load)) {
        load->face_types = (sb_element_type *)sbi_arena_take(arena, rows, sizeof(sb_element_type));
        if (load->kind == SBI_LOAD_CAVITY)
            load->cavity.share = (sb_vec3 *)sbi_arena_take(arena, (size_t)entries, sizeof(sb_vec3));
        return;
    }
    load->stiffness = (sb_real *)sbi_arena_take(arena, rows, sizeof(sb_real));
    load->force = (sb_vec3 *)sbi_arena_take(arena, rows, sizeof(sb_vec3));
    if (load->kind == SBI_LOAD_POTENTIAL) {
        load->lines = (sb_vec3 *)sbi_arena_take(arena, rows, sizeof(sb_vec3));
        return;
    }
    load->balanced_stiffness = (sb_real *)sbi_arena_take(arena, rows, sizeof(sb_real));
    load->target = (sb_vec3 *)sbi_arena_take(arena, rows, sizeof(sb_vec3));
    load->balanced_target = (sb_vec3 *)sbi_arena_take(arena, rows, sizeof(sb_vec3));
    if (load->kind == SBI_LOAD_CABLE)
        sbi_cable_layout(&load->lie, rows, (size_t)entries, arena);
}

SBI_API sb_result sbi_load_make(const sb_allocator *allocator, sbi_load_kind kind, int rows, int entries, size_t pairs,
                                sbi_load *load, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(load, 0, sizeof *load);
    load->kind = kind;
    load->row_count = rows;
    load->pattern_version = -1;
    sbi_load_layout(load, entries, pairs, &arena);
    load->memory = arena.overflow ? NULL : sbi_alloc_zeroed(allocator, arena.used, 1);
    if (!load->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a load of %d rows", rows);
    arena.base = (unsigned char *)load->memory;
    arena.used = 0;
    sbi_load_layout(load, entries, pairs, &arena);
    return SB_OK;
}

SBI_API void sbi_load_release(const sb_allocator *allocator, const sbi_load *load)
{
    sbi_free(allocator, load->line_memory);
    sbi_free(allocator, load->cavity.rim);
    sbi_free(allocator, load->memory);
}

SBI_API void sbi_load_append(sb_body *body, sbi_load *load, int *load_id)
{
    body->guard.stable_step = 0; /* it may be stiff */
    load->id = ++body->last_load_id;
    body->loads[body->load_count++] = *load;
    if (load_id)
        *load_id = load->id;
}

SBI_API sb_result sbi_load_couple(sb_body *body, const sbi_load *load, sb_error *error)
{
    const int whole[2] = {0, load->row_start[load->row_count]};
    int is_cable = load->kind == SBI_LOAD_CABLE, rows = is_cable ? 1 : load->row_count;
    const int *start = is_cable ? whole : load->row_start;
    sbi_body_rows ties = {rows, start, load->nodes, NULL, load->weights};
    sb_result result = sbi_body_reserve_ties(body, &ties, error);
    if (result == SB_OK)
        result = sbi_body_extend_pattern(body, rows, start, load->nodes, error);
    return result;
}

/* ---- pressure ---- */

/* Face number f of a caller's list, which must be of the surface. */
static sb_result sbi_load_outer_face(const sb_body *body, const int *faces, int f, int corners, sbi_body_face *face,
                                     sb_error *error)
{
    sb_result result = sbi_body_get_face(body, faces, f, corners, face, error);
    if (result == SB_OK && face->inner)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, face->nodes[0],
                             "face %d (nodes %d %d %d ...) lies between two elements", f, face->nodes[0],
                             face->nodes[1], face->nodes[2]);
    return result;
}

SBI_API sb_result sbi_load_make_faces(const sb_body *body, sbi_load_kind kind, const int *faces, int face_count,
                                      int corners, sbi_load *load, sb_error *error)
{
    size_t rows = 0, entries = 0, pairs = 0;
    sbi_body_face face, twins[SBI_BODY_TWINS];
    sb_result result = SB_OK;
    for (int f = 0; f < face_count && result == SB_OK; f++) {
        size_t twin_count, size;
        result = sbi_load_outer_face(body, faces, f, corners, &face, error);
        twin_count = result == SB_OK ? (size_t)sbi_body_twin_faces(body, &face, twins) : 0;
        size = (size_t)face.count;
        rows += twin_count;
        entries += twin_count * size;
        pairs += twin_count * size * size;
        if (result == SB_OK && entries > INT32_MAX)
            result = sbi_fail(error, SB_ERROR_MEMORY, "%d faces have too many nodes", face_count);
    }
    if (result == SB_OK)
        result = sbi_load_make(&body->allocator, kind, (int)rows, (int)entries, pairs, load, error);
    for (int f = 0, row = 0; f < face_count && result == SB_OK; f++) {
        int count;
        result = sbi_load_outer_face(body, faces, f, corners, &face, error);
        count = sbi_body_twin_faces(body, &face, twins);
        for (int k = 0; k < count; k++, row++) {
            load->face_types[row] = twins[k].type;
            load->row_start[row + 1] = load->row_start[row] + twins[k].count;
            memcpy(load->nodes + load->row_start[row], twins[k].nodes, (size_t)twins[k].count * sizeof *load->nodes);
        }
    }
    if (result == SB_OK)
        sbi_load_weigh_faces(body, load);
    return result;
}

SB_API sb_result sb_body_add_pressure(sb_body *body, const int *faces, int face_count, int corners, sb_real pressure,
                                      int *load_id, sb_error *error)
{
    sbi_load load;
    sb_result result;
    if (!body || face_count < 1 || corners < 3 || corners > 4 || !faces)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_pressure needs a body, and faces of 3 or 4 corners");
    if (!sb_is_finite(pressure))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the pressure is not finite");
    result = sbi_load_make_faces(body, SBI_LOAD_PRESSURE, faces, face_count, corners, &load, error);
    if (result != SB_OK)
        return result;
    result = sbi_load_reserve(body, error);
    if (result != SB_OK) {
        sbi_free(&body->allocator, load.memory);
        return result;
    }
    load.pressure = pressure;
    sbi_load_append(body, &load, load_id);
    sbi_body_tell(body, SBI_COMMAND_ADD_PRESSURE, corners, 0, faces, (size_t)face_count * (size_t)corners, &pressure,
                  1);
    return SB_OK;
}

SB_API sb_result sb_body_set_pressure(sb_body *body, int load_id, sb_real pressure)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_PRESSURE);
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    if (!sb_is_finite(pressure))
        return SB_ERROR_NOT_FINITE;
    body->guard.stable_step = 0;
    load->pressure = pressure;
    sbi_body_tell(body, SBI_COMMAND_PRESSURE, load_id, 0, NULL, 0, &pressure, 1);
    return SB_OK;
}

/* ---- springs and mappings: making and changing ---- */

/* stiffness[count], or one: each finite and >= 0. */
static sb_result sbi_load_check_stiffness(const sb_real *stiffness, int count, int uniform, sb_error *error)
{
    if (!stiffness)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the stiffness is NULL");
    for (int j = 0; j < (uniform ? sbi_min_int(count, 1) : count); j++) {
        if (!sb_is_finite(stiffness[j]))
            return sbi_fail_element(error, SB_ERROR_NOT_FINITE, j, "stiffness %d is not finite", j);
        if (stiffness[j] < 0)
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, j, "stiffness %d is negative: %g", j,
                                    (double)stiffness[j]);
    }
    return SB_OK;
}

static sb_result sbi_load_check_points(const sb_vec3 *points, int count, sb_error *error)
{
    if (!points)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the points are NULL");
    for (int j = 0; j < count; j++)
        if (!sb_v3_is_finite(points[j]))
            return sbi_fail_element(error, SB_ERROR_NOT_FINITE, j, "point %d is not finite", j);
    return SB_OK;
}

static void sbi_load_put_stiffness(sbi_load *load, const sb_real *stiffness, int uniform)
{
    for (int j = 0; j < load->row_count; j++)
        load->stiffness[j] = stiffness[uniform ? 0 : j];
}

/* H^T X of a row, in double. */
static void sbi_load_rest_point(const sb_body *body, const sbi_load *load, int row, double x[3])
{
    x[0] = x[1] = x[2] = 0;
    for (int k = load->row_start[row]; k < load->row_start[row + 1]; k++) {
        sb_vec3 node = body->reference[load->nodes[k]];
        x[0] += (double)load->weights[k] * (double)node.x;
        x[1] += (double)load->weights[k] * (double)node.y;
        x[2] += (double)load->weights[k] * (double)node.z;
    }
}

/* target = y - H^T X */
static void sbi_load_put_points(const sb_body *body, sbi_load *load, const sb_vec3 *points)
{
    for (int j = 0; j < load->row_count; j++) {
        double x[3];
        sbi_load_rest_point(body, load, j, x);
        load->target[j] = sb_v3((sb_real)((double)points[j].x - x[0]), (sb_real)((double)points[j].y - x[1]),
                                (sb_real)((double)points[j].z - x[2]));
    }
}

/* Tells of springs or a mapping as they were given. */
static void sbi_load_tell_rows(sb_body *body, sbi_load_kind kind, const sb_mapping *mapping, const sb_real *stiffness,
                               int uniform, const sb_vec3 *points)
{
    size_t rows = (size_t)mapping->row_count, entries = (size_t)mapping->row_start[rows];
    sbi_command command;
    memset(&command, 0, sizeof command);
    command.code = SBI_COMMAND_ADD_SPRINGS;
    command.b = uniform != 0;
    command.ints = mapping->nodes;
    command.int_count = entries;
    command.reals = &points[0].x;
    command.real_count = 3 * rows;
    command.more_reals[0] = stiffness;
    command.more_real_counts[0] = uniform ? 1 : rows;
    if (kind == SBI_LOAD_MAPPING) {
        command.code = SBI_COMMAND_ADD_MAPPING;
        command.a = mapping->row_count;
        command.ints = mapping->row_start;
        command.int_count = rows + 1;
        command.more_ints = mapping->nodes;
        command.more_int_count = entries;
        command.more_reals[1] = mapping->weights;
        command.more_real_counts[1] = entries;
    }
    sbi_body_tell_command(body, &command);
}

/* Adds a load of checked rows; all or nothing. */
static sb_result sbi_load_add_rows(sb_body *body, sbi_load_kind kind, const sb_mapping *mapping,
                                   const sb_real *stiffness, int uniform, const sb_vec3 *points, int *load_id,
                                   sb_error *error)
{
    int rows = mapping->row_count, entries = mapping->row_start[rows];
    size_t pairs = 0;
    sbi_load load;
    sb_result result;
    for (int j = 0; j < rows; j++) {
        size_t size = (size_t)(mapping->row_start[j + 1] - mapping->row_start[j]);
        if (!sbi_size_add(&pairs, size, size))
            return sbi_fail_element(error, SB_ERROR_MEMORY, j, "row %d is too long", j);
    }
    result = sbi_load_make(&body->allocator, kind, rows, entries, pairs, &load, error);
    if (result != SB_OK)
        return result;
    memcpy(load.row_start, mapping->row_start, ((size_t)rows + 1) * sizeof(int));
    memcpy(load.nodes, mapping->nodes, (size_t)entries * sizeof(int));
    memcpy(load.weights, mapping->weights, (size_t)entries * sizeof(sb_real));
    sbi_load_put_stiffness(&load, stiffness, uniform);
    sbi_load_put_points(body, &load, points);
    result = sbi_load_check_points(load.target, rows, error); /* the difference may overflow */
    if (result == SB_OK)
        result = sbi_load_reserve(body, error);
    if (result == SB_OK)
        result = sbi_load_couple(body, &load, error);
    if (result != SB_OK) {
        sbi_free(&body->allocator, load.memory);
        return result;
    }
    sbi_load_append(body, &load, load_id);
    sbi_load_tell_rows(body, kind, mapping, stiffness, uniform, points);
    return SB_OK;
}

SB_API sb_result sb_body_add_springs(sb_body *body, const int *nodes, int count, const sb_real *stiffness, int uniform,
                                     const sb_vec3 *points, int *load_id, sb_error *error)
{
    sb_mapping mapping;
    sb_result result;
    int *starts;
    sb_real *ones;
    if (!body || !nodes || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_springs needs a body and nodes");
    for (int i = 0; i < count; i++)
        if (sbi_body_check_nodes(body, nodes + i, 1, NULL) != SB_OK)
            return sbi_fail_node(error, SB_ERROR_INDEX, nodes[i], "spring %d names node %d of %d", i, nodes[i],
                                 body->domain.node_count);
        else if (body->node_component[nodes[i]] < 0)
            return sbi_fail_node(error, SB_ERROR_INDEX, nodes[i], "spring %d pulls at node %d, which no element has", i,
                                 nodes[i]);
    result = sbi_load_check_stiffness(stiffness, count, uniform, error);
    if (result == SB_OK)
        result = sbi_load_check_points(points, count, error);
    if (result != SB_OK)
        return result;
    starts = (int *)sbi_alloc(&body->allocator, (size_t)count + 1, sizeof(int));
    ones = (sb_real *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_real));
    for (int i = 0; i <= count && starts && ones; i++) {
        starts[i] = i;
        if (i < count)
            ones[i] = 1;
    }
    mapping.row_count = count;
    mapping.row_start = starts;
    mapping.nodes = nodes;
    mapping.weights = ones;
    result = starts && ones
                 ? sbi_load_add_rows(body, SBI_LOAD_SPRINGS, &mapping, stiffness, uniform, points, load_id, error)
                 : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d springs", count);
    sbi_free(&body->allocator, starts);
    sbi_free(&body->allocator, ones);
    return result;
}

SBI_API sb_result sbi_load_check_mapping(const sb_body *body, const sb_mapping *mapping, sb_error *error)
{
    const int *start = mapping ? mapping->row_start : NULL;
    if (!mapping || mapping->row_count < 1 || !start || !mapping->nodes || !mapping->weights)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mapping needs rows, nodes and weights");
    if (start[0] != 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "row_start begins with %d, not 0", start[0]);
    for (int j = 0; j < mapping->row_count; j++)
        if (start[j + 1] <= start[j])
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, j, "row %d of the mapping is empty or descends", j);
    for (int j = 0; j < mapping->row_count; j++)
        for (int k = start[j]; k < start[j + 1]; k++) {
            if (sbi_body_check_nodes(body, mapping->nodes + k, 1, NULL) != SB_OK)
                return sbi_fail_element(error, SB_ERROR_INDEX, j, "row %d of the mapping names node %d of %d", j,
                                        mapping->nodes[k], body->domain.node_count);
            if (body->node_component[mapping->nodes[k]] < 0 && mapping->weights[k] != 0)
                return sbi_fail_element(error, SB_ERROR_INDEX, j,
                                        "row %d of the mapping has a weight at node %d, which "
                                        "no element has",
                                        j, mapping->nodes[k]);
            if (!sb_is_finite(mapping->weights[k]))
                return sbi_fail_element(error, SB_ERROR_NOT_FINITE, j,
                                        "row %d of the mapping has a weight that is "
                                        "not finite",
                                        j);
        }
    return SB_OK;
}

SB_API sb_result sb_body_add_mapping(sb_body *body, const sb_mapping *mapping, const sb_real *stiffness, int uniform,
                                     const sb_vec3 *targets, int *load_id, sb_error *error)
{
    sb_result result;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_mapping needs a body");
    result = sbi_load_check_mapping(body, mapping, error);
    if (result == SB_OK)
        result = sbi_load_check_stiffness(stiffness, mapping->row_count, uniform, error);
    if (result == SB_OK)
        result = sbi_load_check_points(targets, mapping->row_count, error);
    if (result != SB_OK)
        return result;
    return sbi_load_add_rows(body, SBI_LOAD_MAPPING, mapping, stiffness, uniform, targets, load_id, error);
}

static sb_result sbi_load_set_points(sb_body *body, int load_id, sbi_load_kind kind, const sb_vec3 *points)
{
    sbi_load *load = sbi_load_find(body, load_id, (int)kind);
    sb_result result;
    if (!body || !points)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    result = sbi_load_check_points(points, load->row_count, NULL);
    for (int j = 0; j < load->row_count && result == SB_OK; j++) { /* as sbi_load_put_points will: may overflow */
        double x[3];
        sbi_load_rest_point(body, load, j, x);
        if (!sb_is_finite((sb_real)((double)points[j].x - x[0])) ||
            !sb_is_finite((sb_real)((double)points[j].y - x[1])) ||
            !sb_is_finite((sb_real)((double)points[j].z - x[2])))
            result = SB_ERROR_NOT_FINITE;
    }
    if (result != SB_OK)
        return result;
    sbi_load_put_points(body, load, points);
    sbi_body_tell(body, SBI_COMMAND_POINTS, load_id, (int)kind, NULL, 0, &points[0].x, 3 * (size_t)load->row_count);
    return SB_OK;
}

static sb_result sbi_load_set_stiffness(sb_body *body, int load_id, sbi_load_kind kind, const sb_real *stiffness,
                                        int uniform)
{
    sbi_load *load = sbi_load_find(body, load_id, (int)kind);
    const int kinds[1] = {(int)kind};
    sb_result result;
    if (!body || !stiffness)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    result = sbi_load_check_stiffness(stiffness, load->row_count, uniform, NULL);
    if (result != SB_OK)
        return result;
    sbi_load_put_stiffness(load, stiffness, uniform);
    sbi_body_tell(body, SBI_COMMAND_STIFFNESS, load_id, uniform != 0, kinds, 1, stiffness,
                  uniform ? 1 : (size_t)load->row_count);
    return SB_OK;
}

/* An explicit step has to look at its stable step anew when that went well. */
static sb_result sbi_load_stiffen(sb_body *body, sb_result result)
{
    if (result == SB_OK)
        body->guard.stable_step = 0;
    return result;
}

SB_API sb_result sb_body_move_springs(sb_body *body, int load_id, const sb_vec3 *points)
{
    return sbi_load_set_points(body, load_id, SBI_LOAD_SPRINGS, points);
}

SB_API sb_result sb_body_set_spring_stiffness(sb_body *body, int load_id, const sb_real *stiffness, int uniform)
{
    return sbi_load_stiffen(body, sbi_load_set_stiffness(body, load_id, SBI_LOAD_SPRINGS, stiffness, uniform));
}

SB_API sb_result sb_body_set_mapping_targets(sb_body *body, int load_id, const sb_vec3 *targets)
{
    return sbi_load_set_points(body, load_id, SBI_LOAD_MAPPING, targets);
}

SB_API sb_result sb_body_set_mapping_stiffness(sb_body *body, int load_id, const sb_real *stiffness, int uniform)
{
    return sbi_load_stiffen(body, sbi_load_set_stiffness(body, load_id, SBI_LOAD_MAPPING, stiffness, uniform));
}

SB_API sb_result sb_body_mapping_points(const sb_body *body, int load_id, sb_vec3 *points)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_MAPPING);
    if (!body || !points)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    for (int j = 0; j < load->row_count; j++)
        points[j] = sbi_body_row_value(load, j, body->position);
    return SB_OK;
}

/* ---- values between the last static solve and now ---- */

static sb_real sbi_load_pressure_at(const sbi_load *load, sb_real factor)
{
    return factor == 1 ? load->pressure : load->balanced_pressure + factor * (load->pressure - load->balanced_pressure);
}

static sb_real sbi_load_stiffness_at(const sbi_load *load, int row, sb_real factor)
{
    sb_real from = load->balanced_stiffness ? load->balanced_stiffness[row] : 0;
    return factor == 1 || !load->balanced_stiffness ? load->stiffness[row]
                                                    : from + factor * (load->stiffness[row] - from);
}

static sb_vec3 sbi_load_target_at(const sbi_load *load, int row, sb_real factor)
{
    sb_vec3 from = load->balanced_target[row];
    return factor == 1 ? load->target[row] : sb_v3_madd(from, factor, sb_v3_sub(load->target[row], from));
}

/* What a row's stiffness is k times of, of x: itself, but for what lines leave out. */
static sb_vec3 sbi_load_stiff_part(const sbi_load *load, int row, sb_vec3 x)
{
    sb_vec3 line;
    if (!load->lines)
        return x;
    line = load->lines[row];
    return sb_v3_madd(sb_v3_scale(1 - sb_v3_dot(line, line), x), sb_v3_dot(line, x), line);
}

/* Springs and mappings. */
static int sbi_load_has_targets(const sbi_load *load) { return load->target && load->kind != SBI_LOAD_CABLE; }

/* The force of a row on the body: k (target - H^T u), or what the owner of a potential found. */
static sb_vec3 sbi_load_row_force(const sbi_load *load, int row, const sb_vec3 *u, sb_real factor)
{
    sb_vec3 way;
    if (load->kind == SBI_LOAD_POTENTIAL)
        return load->force[row];
    way = sb_v3_sub(sbi_load_target_at(load, row, factor), sbi_body_row_value(load, row, u));
    return sb_v3_scale(sbi_load_stiffness_at(load, row, factor), sbi_load_stiff_part(load, row, way));
}

/* ---- pressure on one face ---- */

/* Positions of a face's nodes at u, and the rule of its type. Returns the number of nodes. */
static int sbi_load_gather(const sb_body *body, const sbi_load *load, int face, const sb_vec3 *u, sb_vec3 *x,
                           sbi_load_rule *rule)
{
    sbi_load_need_row_rule(load, face, rule);
    const int *nodes = load->nodes + load->row_start[face];
    int count = load->row_start[face + 1] - load->row_start[face];
    for (int a = 0; a < count; a++)
        x[a] = sb_v3_add(body->reference[nodes[a]], u[nodes[a]]);
    return count;
}

/* force_a = -p int N_a x_r x x_s dr ds */
static void sbi_body_face_force(const sbi_load_rule *rule, int count, const sb_vec3 *x, sb_real pressure,
                                sb_vec3 *force)
{
    memset(force, 0, (size_t)count * sizeof *force);
    for (int p = 0; p < rule->count; p++) {
        sbi_load_tangents t = sbi_load_interpolate(rule, p, count, x);
        sb_vec3 push = sb_v3_scale(-pressure * rule->weights[p], sb_v3_cross(t.r, t.s));
        for (int a = 0; a < count; a++)
            force[a] = sb_v3_madd(force[a], rule->shape[p][a], push);
    }
}

/* df_a/dx_b = [k_ab]x with k_ab = p int N_a (x_s N_b,r - x_r N_b,s). */
static void sbi_body_face_arms(const sbi_load_rule *rule, int count, const sb_vec3 *x, sb_real pressure,
                               sb_vec3 (*k)[SB_MAX_FACE_NODES])
{
    memset(k, 0, SB_MAX_FACE_NODES * sizeof *k);
    for (int p = 0; p < rule->count; p++) {
        sbi_load_tangents t = sbi_load_interpolate(rule, p, count, x);
        for (int b = 0; b < count; b++) {
            sb_vec3 arm =
                sb_v3_sub(sb_v3_scale(rule->gradient[p][b][0], t.s), sb_v3_scale(rule->gradient[p][b][1], t.r));
            for (int a = 0; a < count; a++)
                k[a][b] = sb_v3_madd(k[a][b], pressure * rule->weights[p] * rule->shape[p][a], arm);
        }
    }
}

/* Symmetrised: [(k_ab - k_ba) / 2]x. What this drops is the boundary term of the patch's rim; inside the faces' shares
 * of it cancel. */
static void sbi_body_face_tangent(const sbi_load_rule *rule, int count, const sb_vec3 *x, sb_real pressure,
                                  const int *blocks, sb_matrix *matrix)
{
    sb_vec3 k[SB_MAX_FACE_NODES][SB_MAX_FACE_NODES];
    sbi_body_face_arms(rule, count, x, pressure, k);
    for (int a = 0; a < count; a++)
        for (int b = 0; b < count; b++) {
            sb_vec3 v = sb_v3_scale((sb_real)0.5, sb_v3_sub(k[a][b], k[b][a]));
            sb_real *block = matrix->blocks[blocks[a * count + b]]; /* stiffness is -df/dx */
            block[1] += v.z;
            block[2] -= v.y;
            block[3] -= v.z;
            block[5] += v.x;
            block[6] += v.y;
            block[7] -= v.x;
        }
}

/* ---- cavities ---- */

/* out += its forces; returns the square of what they are differences of (N^2). */
static double sbi_load_add_cavity(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_real factor, sb_vec3 *out)
{
    double size;
    sbi_cavity_lay(body, load, u, factor);
    sbi_cavity_add_force(load, (sb_real)load->cavity.pressure, out);
    size = load->cavity.stiff * load->cavity.volume;
    return size * size * sbi_cavity_square(load);
}

/* What a face of this load presses with (Pa), where it was laid. */
static sb_real sbi_load_face_pressure(const sbi_load *load, sb_real factor)
{
    return load->kind == SBI_LOAD_CAVITY ? (sb_real)load->cavity.pressure : sbi_load_pressure_at(load, factor);
}

SBI_API void sbi_loads_stiffen(sb_body *body, const sb_vec3 *u, sb_real factor, int renew, sb_real mass)
{
    for (int l = 0; l < body->load_count; l++)
        if (sbi_cavity_is_stiff(body->loads + l) && (renew || body->loads[l].cavity.hold.stiff == 0)) {
            sbi_cavity_lay(body, body->loads + l, u, factor);
            sbi_cavity_stiffen(body, body->loads + l, factor, mass);
        }
}

SBI_API int sbi_loads_are_stiff(const sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        if (sbi_cavity_is_stiff(body->loads + l))
            return 1;
    return 0;
}

SBI_API double sbi_loads_hold_volumes(sb_body *body, const sb_vec3 *u, sb_real factor)
{
    double most = 0;
    for (int l = 0; l < body->load_count; l++)
        if (sbi_cavity_is_stiff(body->loads + l)) {
            double off;
            sbi_cavity_lay(body, body->loads + l, u, factor);
            off = sbi_cavity_hold_pressure(body->loads + l, factor);
            off = off < 0 ? -off : off;
            most = off > most ? off : most;
        }
    return most;
}

/* ---- all loads ---- */

SBI_API const sbi_load *sbi_loads_get(const sb_body *body, int id)
{
    for (int l = 0; l < body->load_count; l++)
        if (body->loads[l].id == id)
            return body->loads + l;
    return NULL;
}

SBI_API int sbi_loads_press(const sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        if (body->loads[l].kind == SBI_LOAD_PRESSURE && body->loads[l].pressure != 0)
            return 1;
    return 0;
}

SBI_API void sbi_load_add_unit_pressure(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_vec3 *out)
{
    sbi_load_rule rule;
    rule.type = SB_NO_ELEMENT;
    for (int j = 0; j < load->row_count; j++) {
        const int *nodes = load->nodes + load->row_start[j];
        sb_vec3 x[SB_MAX_FACE_NODES], force[SB_MAX_FACE_NODES];
        int count = sbi_load_gather(body, load, j, u, x, &rule);
        sbi_body_face_force(&rule, count, x, 1, force);
        for (int a = 0; a < count; a++)
            out[nodes[a]] = sb_v3_add(out[nodes[a]], force[a]);
    }
}

SBI_API void sbi_load_spread_row(const sbi_load *load, int row, sb_vec3 f, sb_vec3 *out)
{
    for (int k = load->row_start[row]; k < load->row_start[row + 1]; k++)
        out[load->nodes[k]] = sb_v3_madd(out[load->nodes[k]], load->weights[k], f);
}

/* Stiffness is -df/dx: the antisymmetric part of it is -[(k_ab + k_ba) / 2]x. */
static void sbi_load_add_skew(const sb_body *body, const sbi_load *load, const sb_vec3 *u, const sb_vec3 *d,
                              sb_real factor, sb_vec3 *out)
{
    sbi_load_rule rule;
    rule.type = SB_NO_ELEMENT;
    for (int j = 0; j < load->row_count; j++) {
        const int *nodes = load->nodes + load->row_start[j];
        sb_vec3 x[SB_MAX_FACE_NODES], k[SB_MAX_FACE_NODES][SB_MAX_FACE_NODES];
        int count = sbi_load_gather(body, load, j, u, x, &rule);
        sbi_body_face_arms(&rule, count, x, load->pressure, k);
        for (int a = 0; a < count; a++)
            for (int b = 0; b < count; b++)
                out[nodes[a]] =
                    sb_v3_madd(out[nodes[a]], -factor / 2, sb_v3_cross(sb_v3_add(k[a][b], k[b][a]), d[nodes[b]]));
    }
}

SBI_API void sbi_loads_add_skew(const sb_body *body, const sb_vec3 *u, const sb_vec3 *x, sb_real factor, sb_vec3 *out)
{
    for (int l = 0; l < body->load_count; l++)
        if (body->loads[l].kind == SBI_LOAD_PRESSURE)
            sbi_load_add_skew(body, body->loads + l, u, x, factor, out);
}

SBI_API void sbi_loads_fill(sb_body *body, const sb_vec3 *u)
{
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        if (load->kind == SBI_LOAD_POTENTIAL)
            load->fill(load->fill_user, u, load->force, load->stiffness, load->lines);
    }
}

SBI_API sb_real sbi_loads_force(sb_body *body, const sb_vec3 *u, sb_real factor)
{
    double size = 0;
    memset(body->follower, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        sbi_load_rule rule;
        rule.type = SB_NO_ELEMENT;
        if (load->kind == SBI_LOAD_CABLE) {
            sbi_cable_lay(body, load, u, factor);
            sbi_cable_add_force(load, body->follower);
            size += sbi_cable_square_size(body, load, u, factor);
            continue;
        }
        if (load->kind == SBI_LOAD_MEMBRANE) {
            size += sbi_membrane_add_force(body, load, u, factor, body->follower);
            continue;
        }
        if (load->kind == SBI_LOAD_CAVITY) {
            size += sbi_load_add_cavity(body, load, u, factor, body->follower);
            continue;
        }
        for (int j = 0; j < load->row_count; j++) {
            const int *nodes = load->nodes + load->row_start[j];
            int count = load->row_start[j + 1] - load->row_start[j];
            sb_vec3 x[SB_MAX_FACE_NODES], force[SB_MAX_FACE_NODES], pull;
            double k, reach;
            if (load->kind == SBI_LOAD_PRESSURE) {
                sbi_load_gather(body, load, j, u, x, &rule);
                sbi_body_face_force(&rule, count, x, sbi_load_pressure_at(load, factor), force);
                for (int a = 0; a < count; a++)
                    body->follower[nodes[a]] = sb_v3_add(body->follower[nodes[a]], force[a]);
                continue;
            }
            pull = sbi_load_row_force(load, j, u, factor);
            for (int a = 0; a < count; a++) {
                sb_vec3 *node = body->follower + nodes[a];
                *node = sb_v3_madd(*node, load->weights[load->row_start[j] + a], pull);
            }
            if (!sbi_load_has_targets(load))
                continue;
            k = (double)sbi_load_stiffness_at(load, j, factor);
            reach = (double)sb_v3_norm(sbi_load_target_at(load, j, factor));
            size += k * reach * k * reach;
        }
    }
    return sb_sqrt((sb_real)size);
}

/* Positions of a load's blocks in the present pattern. */
static void sbi_load_locate(const sb_body *body, sbi_load *load)
{
    int *out = load->blocks;
    if (load->pattern_version == body->pattern_version)
        return;
    for (int j = 0; j < load->row_count; j++)
        for (int a = load->row_start[j]; a < load->row_start[j + 1]; a++)
            for (int b = load->row_start[j]; b < load->row_start[j + 1]; b++)
                *out++ = sb_matrix_find(&body->matrix, load->nodes[a], load->nodes[b]);
    load->pattern_version = body->pattern_version;
}

/* The matrix of sbi_load_stiff_part. */
static void sbi_load_row_form(const sbi_load *load, int row, sb_real *form)
{
    const sb_vec3 line = load->lines[row];
    const sb_real v[3] = {line.x, line.y, line.z}, across = 1 - sb_v3_dot(line, line);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            form[3 * i + j] = v[i] * v[j] + (i == j ? across : 0);
}

/* matrix += k H H^T of a row */
static void sbi_load_row_tangent(const sbi_load *load, int row, const int *blocks, sb_real factor, sb_matrix *matrix)
{
    const sb_real *weights = load->weights + load->row_start[row], k = sbi_load_stiffness_at(load, row, factor);
    int count = load->row_start[row + 1] - load->row_start[row];
    sb_real form[9];
    if (k == 0)
        return;
    if (load->lines)
        sbi_load_row_form(load, row, form);
    for (int a = 0; a < count; a++)
        for (int b = 0; b < count; b++) {
            sb_real value = weights[a] * weights[b] * k, *block = matrix->blocks[*blocks++];
            if (!load->lines) {
                block[0] += value;
                block[4] += value;
                block[8] += value;
            } else {
                for (int c = 0; c < 9; c++)
                    block[c] += value * form[c];
            }
        }
}

SBI_API void sbi_loads_add_tangent(sb_body *body, const sb_vec3 *u, sb_tangent_kind kind, sb_real factor,
                                   sb_matrix *matrix)
{
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        const int *blocks = load->blocks;
        sbi_load_rule rule;
        if (load->kind == SBI_LOAD_CAVITY) /* solves add what its stiffness is beside that of its faces */
            sbi_cavity_lay(body, load, u, factor);
        if ((load->kind == SBI_LOAD_PRESSURE || load->kind == SBI_LOAD_CAVITY) && kind != SB_TANGENT_EXACT)
            continue;
        if (load->kind == SBI_LOAD_CABLE) {
            sbi_cable_lay(body, load, u, factor);
            sbi_cable_add_tangent(load, kind, matrix);
            continue;
        }
        sbi_load_locate(body, load);
        if (load->kind == SBI_LOAD_MEMBRANE) {
            sbi_membrane_add_tangent(body, load, u, kind, factor, matrix);
            continue;
        }
        rule.type = SB_NO_ELEMENT;
        for (int j = 0; j < load->row_count; j++) {
            size_t count = (size_t)(load->row_start[j + 1] - load->row_start[j]);
            sb_vec3 x[SB_MAX_FACE_NODES];
            if (sbi_load_has_faces(load)) {
                sbi_load_gather(body, load, j, u, x, &rule);
                sbi_body_face_tangent(&rule, (int)count, x, sbi_load_face_pressure(load, factor), blocks, matrix);
            } else {
                sbi_load_row_tangent(load, j, blocks, factor, matrix);
            }
            blocks += count * count;
        }
    }
}

SBI_API void sbi_loads_add_slack(sb_body *body, const sb_vec3 *u, sb_matrix *matrix)
{
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        if (load->kind == SBI_LOAD_CABLE) {
            sbi_cable_lay(body, load, u, 1);
            sbi_cable_add_slack(load, matrix);
        }
        if (load->kind == SBI_LOAD_MEMBRANE) {
            sbi_load_locate(body, load);
            sbi_membrane_add_slack(body, load, u, matrix);
        }
        if (load->kind == SBI_LOAD_CAVITY) {
            sbi_cavity_lay(body, load, u, 1);
            sbi_cavity_add_bound(load, matrix);
        }
    }
}

SBI_API void sbi_loads_subtract_product(const sb_body *body, const sb_vec3 *x, sb_real factor, sb_vec3 *out)
{
    for (int l = 0; l < body->load_count; l++) {
        const sbi_load *load = body->loads + l;
        if (load->kind == SBI_LOAD_CABLE) {
            sbi_cable_add_product(load, x, -1, out);
            continue;
        }
        if (load->kind == SBI_LOAD_MEMBRANE)
            sbi_membrane_add_product(body, load, body->displacement, factor, x, -1, out);
        for (int j = 0; !sbi_load_has_faces(load) && j < load->row_count; j++) {
            sb_vec3 part = sbi_load_stiff_part(load, j, sbi_body_row_value(load, j, x));
            sb_vec3 pull = sb_v3_scale(-sbi_load_stiffness_at(load, j, factor), part);
            for (int k = load->row_start[j]; k < load->row_start[j + 1]; k++)
                out[load->nodes[k]] = sb_v3_madd(out[load->nodes[k]], load->weights[k], pull);
        }
    }
}

SBI_API int sbi_loads_are_rows(const sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        if (sbi_load_has_faces(body->loads + l) || body->loads[l].kind == SBI_LOAD_CABLE)
            return 0;
    return 1;
}

/* The mean of the three diagonal entries of what sbi_load_stiff_part is. */
static sb_real sbi_load_mean_part(const sbi_load *load, int row)
{
    sb_real square = load->lines ? sb_v3_dot(load->lines[row], load->lines[row]) : 0;
    return load->lines ? (3 * (1 - square) + square) / 3 : 1;
}

SBI_API void sbi_loads_add_diagonal(const sb_body *body, sb_real factor, sb_real *diagonal)
{
    for (int l = 0; l < body->load_count; l++) {
        const sbi_load *load = body->loads + l;
        for (int j = 0; j < load->row_count; j++) {
            sb_real k = sbi_load_stiffness_at(load, j, factor) * sbi_load_mean_part(load, j);
            for (int a = load->row_start[j]; a < load->row_start[j + 1]; a++)
                diagonal[load->nodes[a]] += k * load->weights[a] * load->weights[a];
        }
    }
}

/* Adds the work of a pressure on a face at x along x + s d: the integrand -p N d.(x_r + s d_r) x (x_s + s d_s). */
static void sbi_body_face_work(const sbi_load_rule *rule, int count, const sb_vec3 *x, const sb_vec3 *d,
                               sb_real pressure, sbi_loads_work *work)
{
    for (int p = 0; p < rule->count; p++) {
        sbi_load_tangents at = sbi_load_interpolate(rule, p, count, x), by = sbi_load_interpolate(rule, p, count, d);
        sb_vec3 turn = sb_v3_add(sb_v3_cross(at.r, by.s), sb_v3_cross(by.r, at.s));
        sb_real scale = -pressure * rule->weights[p];
        work->linear += scale * sb_v3_dot(by.value, sb_v3_cross(at.r, at.s));
        work->quadratic += scale / 2 * sb_v3_dot(by.value, turn);
        work->cubic += scale / 3 * sb_v3_dot(by.value, sb_v3_cross(by.r, by.s));
    }
}

SBI_API sbi_loads_work sbi_loads_line(sb_body *body, const sb_vec3 *u, const sb_vec3 *du, sb_real factor)
{
    sbi_loads_work work = {0, 0, 0, 0};
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        sbi_load_rule rule;
        rule.type = SB_NO_ELEMENT;
        if (load->kind == SBI_LOAD_CABLE) {
            sbi_cable_lay(body, load, u, factor);
            work.curved += sbi_cable_work(load, du);
            continue;
        }
        if (load->kind == SBI_LOAD_MEMBRANE) {
            work.curved += sbi_membrane_work(body, load, u, factor, du);
            continue;
        }
        if (load->kind == SBI_LOAD_CAVITY) {
            sbi_cavity_lay(body, load, u, factor);
            work.curved += (sb_real)(load->cavity.pressure * sbi_cavity_growth(body, load, du));
            continue;
        }
        for (int j = 0; j < load->row_count; j++) {
            sb_vec3 x[SB_MAX_FACE_NODES], d[SB_MAX_FACE_NODES], way;
            if (load->kind == SBI_LOAD_PRESSURE) {
                int count = sbi_load_gather(body, load, j, u, x, &rule);
                for (int a = 0; a < count; a++)
                    d[a] = du[load->nodes[load->row_start[j] + a]];
                sbi_body_face_work(&rule, count, x, d, sbi_load_pressure_at(load, factor), &work);
                continue;
            }
            way = sbi_body_row_value(load, j, du);
            work.linear += sb_v3_dot(sbi_load_row_force(load, j, u, factor), way);
            work.quadratic -=
                sbi_load_stiffness_at(load, j, factor) / 2 * sb_v3_dot(way, sbi_load_stiff_part(load, j, way));
        }
    }
    return work;
}

static double sbi_load_row_energy(const sbi_load *load, int row, const sb_vec3 *u)
{
    sb_vec3 stretch = sb_v3_sub(load->target[row], sbi_body_row_value(load, row, u));
    return 0.5 * (double)load->stiffness[row] * (double)sb_v3_dot(stretch, stretch);
}

static double sbi_load_curved_energy(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_real factor)
{
    if (load->kind == SBI_LOAD_CAVITY) {
        sbi_cavity_lay(body, load, u, factor);
        return sbi_cavity_energy(load, factor);
    }
    if (load->kind == SBI_LOAD_MEMBRANE)
        return sbi_membrane_energy(body, load, u, factor);
    if (load->kind != SBI_LOAD_CABLE)
        return 0;
    sbi_cable_lay(body, load, u, factor);
    return load->lie.energy;
}

SBI_API double sbi_loads_curved_energy(sb_body *body, const sb_vec3 *u, sb_real factor)
{
    double sum = 0;
    for (int l = 0; l < body->load_count; l++)
        sum += sbi_load_curved_energy(body, body->loads + l, u, factor);
    return sum;
}

/* The same of loads that give no more than they were given: what cavities do is work, as that of pressures. */
static double sbi_load_own_energy(const sb_body *body, sbi_load *load, const sb_vec3 *u)
{
    return load->kind == SBI_LOAD_CAVITY ? 0 : sbi_load_curved_energy(body, load, u, 1);
}

SBI_API double sbi_loads_energy(sb_body *body, const sb_vec3 *u)
{
    double sum = 0;
    for (int l = 0; l < body->load_count; l++) {
        sum += sbi_load_own_energy(body, body->loads + l, u);
        for (int j = 0; sbi_load_has_targets(body->loads + l) && j < body->loads[l].row_count; j++)
            sum += sbi_load_row_energy(body->loads + l, j, u);
    }
    return sum;
}

/* What a row had is its force squared over 2 k. Where k has changed this is too little (stiffer) or too much
 * (softer: the row gave some off), which errs on the safe side of what may come of it. */
SBI_API double sbi_loads_new_energy(sb_body *body)
{
    double sum = 0;
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        double curved = sbi_load_own_energy(body, load, body->displacement);
        sum += curved > load->curved_energy ? curved - load->curved_energy : 0;
        for (int j = 0; sbi_load_has_targets(load) && j < load->row_count; j++) {
            double k = (double)load->stiffness[j], force = (double)sb_v3_dot(load->force[j], load->force[j]);
            double gain = k > 0 ? sbi_load_row_energy(load, j, body->displacement) - 0.5 * force / k : 0;
            sum += gain > 0 ? gain : 0;
        }
    }
    return sum;
}

SBI_API void sbi_loads_begin_static(sb_body *body)
{
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        if (load->kind == SBI_LOAD_CABLE && !load->balanced)
            sbi_cable_relax(body, load);
        if (load->kind == SBI_LOAD_MEMBRANE && !load->balanced)
            sbi_membrane_relax(load);
        if (load->kind == SBI_LOAD_CAVITY && !load->balanced) {
            sbi_cavity_lay(body, load, body->displacement, 1);
            sbi_cavity_relax(load);
        }
        for (int j = 0; sbi_load_has_targets(load) && !load->balanced && j < load->row_count; j++) {
            load->balanced_stiffness[j] = load->stiffness[j];
            load->balanced_target[j] = sbi_body_row_value(load, j, body->displacement);
        }
    }
}

SBI_API void sbi_loads_end_static(sb_body *body, sb_real factor)
{
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        load->balanced_pressure = sbi_load_pressure_at(load, factor);
        if (load->kind == SBI_LOAD_CABLE)
            sbi_cable_settle(load, factor);
        if (load->kind == SBI_LOAD_MEMBRANE)
            sbi_membrane_settle(load, factor);
        if (load->kind == SBI_LOAD_CAVITY)
            sbi_cavity_settle(load, factor);
        load->balanced = 1;
        for (int j = 0; sbi_load_has_targets(load) && j < load->row_count; j++) {
            load->balanced_target[j] = sbi_load_target_at(load, j, factor);
            load->balanced_stiffness[j] = sbi_load_stiffness_at(load, j, factor);
        }
    }
}

/* ---- readings ---- */

/* Adds a nodal force of a load to its net force and torque and to `sum`. */
static void sbi_load_collect(const sb_body *body, const sb_vec3 *u, int node, sb_vec3 f, sbi_load *load, sb_vec3 *sum)
{
    sb_vec3 at = sb_v3_add(body->reference[node], u[node]);
    double fx = (double)f.x, fy = (double)f.y, fz = (double)f.z;
    load->net[0] += fx;
    load->net[1] += fy;
    load->net[2] += fz;
    load->net[3] += (double)at.y * fz - (double)at.z * fy;
    load->net[4] += (double)at.z * fx - (double)at.x * fz;
    load->net[5] += (double)at.x * fy - (double)at.y * fx;
    sum[node] = sb_v3_add(sum[node], f);
}

/* The balance of a cavity is that of its pressure near `linear`, which g is of. */
static void sbi_load_commit_cavity(sb_body *body, sbi_load *load, const sb_vec3 *u, const sb_vec3 *linear,
                                   sb_real factor, int dynamic)
{
    sbi_cavity *cavity = &load->cavity;
    double pressure;
    int node;
    sb_vec3 share;
    sbi_cavity_lay(body, load, linear, factor);
    pressure = cavity->pressure;
    if (u != linear)
        pressure -= cavity->stiff * (sbi_cavity_growth(body, load, u) - sbi_cavity_growth(body, load, linear));
    for (int k = 0; k < sbi_cavity_entries(load); k++)
        if (sbi_cavity_entry(load, k, &node, &share))
            sbi_load_collect(body, u, node, sb_v3_scale((sb_real)pressure, share), load, body->external);
    if (sbi_cavity_is_stiff(load) && (!dynamic || sbi_cavity_corrects(body)))
        cavity->hold.pressure = (sb_real)pressure;
    cavity->read = (sb_real)pressure;
}

SBI_API void sbi_loads_commit(sb_body *body, const sb_vec3 *row_u, const sb_vec3 *pressure_u, sb_real factor,
                              int dynamic)
{
    for (int l = 0; l < body->load_count; l++) {
        sbi_load *load = body->loads + l;
        sbi_load_rule rule;
        memset(load->net, 0, sizeof load->net);
        rule.type = SB_NO_ELEMENT;
        if (load->kind == SBI_LOAD_CABLE)
            sbi_cable_read(body, load, row_u, pressure_u, factor);
        if (load->kind == SBI_LOAD_MEMBRANE)
            load->curved_energy = sbi_membrane_energy(body, load, body->displacement, factor);
        if (load->kind == SBI_LOAD_CAVITY) {
            sbi_load_commit_cavity(body, load, row_u, pressure_u, factor, dynamic);
            continue;
        }
        for (int j = 0; j < load->row_count; j++) {
            const int *nodes = load->nodes + load->row_start[j];
            int count = load->row_start[j + 1] - load->row_start[j];
            sb_vec3 x[SB_MAX_FACE_NODES], force[SB_MAX_FACE_NODES];
            if (load->kind == SBI_LOAD_PRESSURE) {
                sbi_load_gather(body, load, j, pressure_u, x, &rule);
                sbi_body_face_force(&rule, count, x, sbi_load_pressure_at(load, factor), force);
            }
            if (load->kind == SBI_LOAD_MEMBRANE)
                sbi_membrane_face_force(body, load, j, row_u, pressure_u, factor, force);
            if (sbi_load_has_faces(load)) {
                for (int a = 0; a < count; a++)
                    sbi_load_collect(body, row_u, nodes[a], force[a], load, body->external);
                continue;
            }
            if (load->kind != SBI_LOAD_CABLE)
                load->force[j] = sbi_load_row_force(load, j, row_u, factor);
            for (int a = 0; a < count; a++)
                sbi_load_collect(body, row_u, nodes[a],
                                 sb_v3_scale(load->weights[load->row_start[j] + a], load->force[j]), load,
                                 body->external);
        }
    }
}

SB_API sb_result sb_body_load_force(const sb_body *body, int load_id, sb_vec3 about, sb_vec3 *force, sb_vec3 *torque)
{
    const sbi_load *load = sbi_load_find(body, load_id, 0);
    double x = (double)about.x, y = (double)about.y, z = (double)about.z;
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    if (!sb_v3_is_finite(about))
        return SB_ERROR_NOT_FINITE;
    if (force)
        *force = sb_v3((sb_real)load->net[0], (sb_real)load->net[1], (sb_real)load->net[2]);
    if (torque)
        *torque = sb_v3((sb_real)(load->net[3] - (y * load->net[2] - z * load->net[1])),
                        (sb_real)(load->net[4] - (z * load->net[0] - x * load->net[2])),
                        (sb_real)(load->net[5] - (x * load->net[1] - y * load->net[0])));
    return SB_OK;
}

static sb_result sbi_load_get_forces(const sb_body *body, int load_id, sbi_load_kind kind, sb_vec3 *forces)
{
    const sbi_load *load = sbi_load_find(body, load_id, (int)kind);
    if (!body || !forces)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    memcpy(forces, load->force, (size_t)load->row_count * sizeof *forces);
    return SB_OK;
}

SB_API sb_result sb_body_spring_forces(const sb_body *body, int load_id, sb_vec3 *forces)
{
    return sbi_load_get_forces(body, load_id, SBI_LOAD_SPRINGS, forces);
}

SB_API sb_result sb_body_mapping_forces(const sb_body *body, int load_id, sb_vec3 *forces)
{
    return sbi_load_get_forces(body, load_id, SBI_LOAD_MAPPING, forces);
}

/* ---- for guests ---- */

struct sbi_potential {
    sb_allocator allocator;
    sbi_load load;
};

SBI_API sb_result sbi_potential_create(sb_body *body, const sb_mapping *rows, sbi_potential_fill fill, void *user,
                                       const sb_allocator *allocator, sbi_potential **potential, sb_error *error)
{
    int entries = rows->row_start[rows->row_count];
    size_t pairs = 0;
    sbi_potential *made = (sbi_potential *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    sb_result result = made ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for a potential");
    for (int j = 0; j < rows->row_count && result == SB_OK; j++) {
        size_t size = (size_t)(rows->row_start[j + 1] - rows->row_start[j]);
        if (!sbi_size_add(&pairs, size, size))
            result = sbi_fail(error, SB_ERROR_MEMORY, "a potential's rows are too long");
    }
    if (result == SB_OK)
        result = sbi_load_reserve(body, error);
    if (result == SB_OK)
        result = sbi_load_make(allocator, SBI_LOAD_POTENTIAL, rows->row_count, entries, pairs, &made->load, error);
    if (result != SB_OK) {
        sbi_free(allocator, made);
        return result;
    }
    memcpy(made->load.row_start, rows->row_start, ((size_t)rows->row_count + 1) * sizeof(int));
    memcpy(made->load.nodes, rows->nodes, (size_t)entries * sizeof(int));
    memcpy(made->load.weights, rows->weights, (size_t)entries * sizeof(sb_real));
    made->load.fill = fill;
    made->load.fill_user = user;
    made->allocator = *allocator;
    *potential = made;
    return SB_OK;
}

SBI_API void sbi_potential_destroy(sbi_potential *potential)
{
    sb_allocator allocator;
    if (!potential)
        return;
    allocator = potential->allocator;
    sbi_load_release(&allocator, &potential->load);
    sbi_free(&allocator, potential);
}

SBI_API sb_result sbi_potential_lend(sb_body *body, const sbi_potential *potential, sb_error *error)
{
    sb_result result = sbi_load_reserve(body, error);
    if (result == SB_OK)
        body->loads[body->load_count++] = potential->load;
    return result;
}

SBI_API void sbi_potential_return(sb_body *body, sbi_potential *potential)
{
    potential->load = body->loads[--body->load_count];
}

SBI_API sb_result sbi_body_reserve_mapping_lines(sb_body *body, int load_id)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_MAPPING);
    if (!load)
        return SB_ERROR_INDEX;
    if (!load->line_memory)
        load->line_memory = sbi_alloc(&body->allocator, (size_t)load->row_count, sizeof(sb_vec3));
    return load->line_memory ? SB_OK : SB_ERROR_MEMORY;
}

SBI_API sb_result sbi_body_set_mapping_lines(sb_body *body, int load_id, const sb_vec3 *lines)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_MAPPING);
    size_t count = load ? (size_t)load->row_count : 0;
    if (!load)
        return SB_ERROR_INDEX;
    if (lines && sbi_load_check_points(lines, load->row_count, NULL) != SB_OK)
        return SB_ERROR_NOT_FINITE;
    if (lines && sbi_body_reserve_mapping_lines(body, load_id) != SB_OK)
        return SB_ERROR_MEMORY;
    load->lines = lines ? (sb_vec3 *)load->line_memory : NULL;
    if (lines)
        memcpy(load->lines, lines, count * sizeof *lines);
    sbi_body_tell(body, SBI_COMMAND_LINES, load_id, 0, NULL, 0, lines ? &lines[0].x : NULL, lines ? 3 * count : 0);
    return SB_OK;
}

/* ---- removal ---- */

/* equilibrated += what a load exerted in the last static solve, so that the next one lets it fade as a dead load. */
static void sbi_load_fade(sb_body *body, sbi_load *load)
{
    sbi_load_rule rule;
    rule.type = SB_NO_ELEMENT;
    if (load->kind == SBI_LOAD_CAVITY) {
        sbi_cavity_lay(body, load, body->displacement, 0);
        sbi_cavity_add_force(load, load->cavity.read, body->equilibrated);
        return;
    }
    for (int j = 0; j < load->row_count; j++) {
        const int *nodes = load->nodes + load->row_start[j];
        int count = load->row_start[j + 1] - load->row_start[j];
        sb_vec3 x[SB_MAX_FACE_NODES], force[SB_MAX_FACE_NODES];
        if (load->kind == SBI_LOAD_PRESSURE) {
            sbi_load_gather(body, load, j, body->displacement, x, &rule);
            sbi_body_face_force(&rule, count, x, load->balanced_pressure, force);
        }
        if (load->kind == SBI_LOAD_MEMBRANE)
            sbi_membrane_face_force(body, load, j, body->displacement, body->displacement, 0, force);
        for (int a = 0; a < count; a++) {
            sb_vec3 *sum = body->equilibrated + nodes[a];
            *sum = sbi_load_has_faces(load) ? sb_v3_add(*sum, force[a])
                                            : sb_v3_madd(*sum, load->weights[load->row_start[j] + a], load->force[j]);
        }
    }
}

SB_API sb_result sb_body_remove_load(sb_body *body, int load_id)
{
    sbi_load *load = sbi_load_find(body, load_id, 0);
    size_t after;
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    if (load->balanced)
        sbi_load_fade(body, load);
    sbi_load_release(&body->allocator, load);
    after = (size_t)(body->loads + body->load_count - (load + 1));
    memmove(load, load + 1, after * sizeof *load);
    body->load_count--;
    sbi_body_tell(body, SBI_COMMAND_REMOVE_LOAD, load_id, 0, NULL, 0, NULL, 0);
    return SB_OK;
}
