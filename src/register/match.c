/* match: what a match is made from, and its charges. */
#include "match.h"

#include <string.h>

#include "../softbody/body/live_mesh.h"
#include "../softbody/geometry/embed.h"
#include "match_private.h"
#include "pieces.h"

#define REGI_MATCH_COOKIE 0x6d617463u

enum { REGI_MATCH_TRIANGLES = 4000 }; /* finer surfaces carry their charges at the vertices, which are half as many */

REG_API reg_match_def reg_default_match_def(void)
{
    reg_match_def def;
    memset(&def, 0, sizeof def);
    def.method = REG_PBSM;
    def.cells = 64;
    def.partial = SB_AUTO;
    def.reach = (sb_real)0.1;
    def.last_reach = (sb_real)0.02;
    def.least_cosine = (sb_real)0.5;
    def.least_active = (sb_real)0.1;
    def.sampling = (sb_real)0.015;
    def.first_charge = (sb_real)0.2;
    def.last_charge = 100;
    def.least_growth = (sb_real)1.15;
    def.most_growth = 2;
    def.landmark_stiffness = 50;
    def.settled = (sb_real)0.005;
    def.max_seconds = 1e9;
    def.cookie = REGI_MATCH_COOKIE;
    return def;
}

/* ---- checks ---- */

static sb_result regi_match_check_numbers(const reg_match_def *def, sb_error *error)
{
    const struct {
        const char *name;
        sb_real value, low, high;
    } fields[] = {{"reach", def->reach, 0, SB_REAL_MAX},
                  {"last_reach", def->last_reach, 0, SB_REAL_MAX},
                  {"least_cosine", def->least_cosine, -1, 1},
                  {"least_active", def->least_active, 0, 1},
                  {"sampling", def->sampling, 0, SB_REAL_MAX},
                  {"first_charge", def->first_charge, 0, SB_REAL_MAX},
                  {"last_charge", def->last_charge, def->first_charge, SB_REAL_MAX},
                  {"least_growth", def->least_growth, 1, SB_REAL_MAX},
                  {"most_growth", def->most_growth, def->least_growth, SB_REAL_MAX},
                  {"landmark_stiffness", def->landmark_stiffness, 0, SB_REAL_MAX},
                  {"settled", def->settled, 0, SB_REAL_MAX}};
    for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++)
        if (!sb_is_finite(fields[i].value) || fields[i].value < fields[i].low || fields[i].value > fields[i].high)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of a match is %g, out of range", fields[i].name,
                            (double)fields[i].value);
    if (!(def->reach > 0 && def->last_reach > 0 && def->sampling > 0 && def->first_charge > 0 && def->settled > 0 &&
          def->landmark_stiffness > 0 && def->least_growth > 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "reaches, sampling, charges, settled and landmark_stiffness of a "
                        "match must be above 0, least_growth above 1");
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    return SB_OK;
}

static sb_result regi_match_check_landmarks(const reg_match_def *def, sb_error *error)
{
    if (def->landmark_count < 0 || (def->landmark_count > 0 && (!def->landmarks || !def->landmark_targets)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks need points and targets", def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i]) || !sb_v3_is_finite(def->landmark_targets[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    return SB_OK;
}

static sb_result regi_match_check(const reg_match_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != REGI_MATCH_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs a def made by reg_default_match_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs a body");
    if ((def->target != NULL) == (def->target_points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs either a target or target_points");
    if (def->method != REG_PBSM && def->method != REG_PBSM_LAPLACE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no method %d of matching", (int)def->method);
    if (def->partial != SB_AUTO && def->partial != 0 && def->partial != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "partial is %d, not 0, 1 or SB_AUTO", def->partial);
    if (sbi_body_has_constraints(def->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body with constraints cannot be matched");
    if (sbi_body_mesh(def->body).element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body of custom elements cannot be matched");
    result = regi_match_check_numbers(def, error);
    return result == SB_OK ? regi_match_check_landmarks(def, error) : result;
}

/* ---- where the charges sit ---- */

/* Points of a surface that carry its charges. */
typedef struct regi_match_sites {
    int count;
    sb_vec3 *points;
    sb_vec3 *areas; /* vectors (m^2) */
} regi_match_sites;

static void regi_match_free_sites(const sb_allocator *allocator, regi_match_sites *sites)
{
    sbi_free(allocator, sites->points);
    sbi_free(allocator, sites->areas);
}

static void regi_match_place_sites(const sb_mesh *triangles, int at_vertices, regi_match_sites *sites)
{
    const sb_real third = (sb_real)1 / 3;
    for (int t = 0; t < triangles->element_count; t++) {
        const int *c = triangles->elements + 3 * t;
        sb_vec3 a = triangles->nodes[c[0]], b = triangles->nodes[c[1]], d = triangles->nodes[c[2]];
        sb_vec3 area = sb_v3_scale((sb_real)0.5, sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a)));
        if (!at_vertices) {
            sites->points[t] = sb_v3_scale(third, sb_v3_add(a, sb_v3_add(b, d)));
            sites->areas[t] = area;
        }
        for (int k = 0; k < 3 && at_vertices; k++) {
            sites->points[c[k]] = triangles->nodes[c[k]];
            sites->areas[c[k]] = sb_v3_madd(sites->areas[c[k]], third, area);
        }
    }
}

/* Those without area (unused vertices, flat triangles) carry nothing. */
static void regi_match_drop_sites(regi_match_sites *sites)
{
    int kept = 0;
    for (int i = 0; i < sites->count; i++)
        if (sb_v3_norm(sites->areas[i]) > 0) {
            sites->points[kept] = sites->points[i];
            sites->areas[kept++] = sites->areas[i];
        }
    sites->count = kept;
}

static sb_result regi_match_make_sites(const sb_mesh *surface, const sb_allocator *allocator, regi_match_sites *sites,
                                       sb_error *error)
{
    sb_mesh triangles;
    int at_vertices;
    sb_result result = sb_surface_triangulate(surface, allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    at_vertices = triangles.element_count > REGI_MATCH_TRIANGLES;
    sites->count = at_vertices ? triangles.node_count : triangles.element_count;
    sites->points = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)sites->count, sizeof(sb_vec3));
    sites->areas = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)sites->count, sizeof(sb_vec3));
    if (sites->points && sites->areas) {
        regi_match_place_sites(&triangles, at_vertices, sites);
        regi_match_drop_sites(sites);
        if (sites->count == 0)
            result = sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d charges", sites->count);
    }
    sb_mesh_free(&triangles);
    return result;
}

/* Charges of the def's surface, or of the boundary of the body's mesh. */
static sb_result regi_match_find_sites(const regi_pieces *pieces, const reg_match_def *def, regi_match_sites *sites,
                                       sb_error *error)
{
    sb_boundary skin;
    sb_result result = regi_pieces_skin(pieces, def->surface, &skin, error);
    memset(sites, 0, sizeof *sites);
    if (result != SB_OK)
        return result;
    result = regi_match_make_sites(&skin.surface, &def->allocator, sites, error);
    sb_boundary_free(&skin);
    if (result != SB_OK)
        regi_match_free_sites(&def->allocator, sites);
    return result;
}

/* ---- points held by elements ---- */

/* Weights of the nodes, and unless NULL their gradients at rest, of an embedded point. Outside the mesh both are those
 * of the nearest point of the element, carried on linearly: exact for affine motions. */
static void regi_match_weigh(const sb_mesh *mesh, const sb_embedded_point *point, sb_real *weights, sb_vec3 *gradients)
{
    sb_real slope[SB_MAX_ELEMENT_NODES][3];
    sb_mat3 jacobian = sb_m3_zero(), inverse;
    int width = sb_mesh_element_width(mesh);
    const int *nodes = mesh->elements + (size_t)point->element * (size_t)width;
    sb_element_shape(mesh->element_type, point->xi, weights, slope);
    for (int a = 0; a < width; a++) {
        sb_vec3 s = sb_v3(slope[a][0], slope[a][1], slope[a][2]);
        weights[a] += s.x * point->step[0] + s.y * point->step[1] + s.z * point->step[2];
        jacobian = sb_m3_add(jacobian, sb_m3_outer(mesh->nodes[nodes[a]], s));
    }
    inverse = sb_m3_transpose(sb_m3_inverse(jacobian));
    for (int a = 0; a < width && gradients; a++)
        gradients[a] = sb_m3_apply(inverse, sb_v3(slope[a][0], slope[a][1], slope[a][2]));
}

static sb_result regi_match_embed(const sb_mesh *mesh, const sb_vec3 *points, int count, const reg_match_def *def,
                                  sb_real size, sb_embedding **embedding, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    embed.mesh = mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * size; /* beyond, the surface and the model are not of one organ */
    embed.allocator = def->allocator;
    embed.jobs = *sbi_body_jobs(def->body);
    return sb_embedding_create(&embed, embedding, error);
}

/* Fills charges[count] and their rows, by ascending element. start: scratch [elements + 1], zeroed. */
static void regi_match_settle_points(const sb_embedding *embedding, const regi_pieces *pieces, int count, int *start,
                                     regi_match_charge *charges, sb_real *weights, sb_vec3 *gradients)
{
    const sb_mesh *mesh = pieces->mesh;
    size_t width = (size_t)sb_mesh_element_width(mesh);
    sb_embedded_point point;
    for (int i = 0; i < count; i++) {
        (void)sb_embedding_get_point(embedding, i, &point);
        start[regi_pieces_find(pieces, point.element, point.xi) + 1]++;
    }
    for (int e = 0; e < mesh->element_count; e++)
        start[e + 1] += start[e];
    for (int i = 0; i < count; i++) {
        size_t at;
        (void)sb_embedding_get_point(embedding, i, &point);
        point.element = regi_pieces_find(pieces, point.element, point.xi);
        at = (size_t)start[point.element]++;
        charges[at].element = point.element;
        charges[at].index = i;
        charges[at].guess = -1;
        regi_match_weigh(mesh, &point, weights + at * width, gradients ? gradients + at * width : NULL);
    }
}

/* ---- memory ---- */

static void regi_match_layout(reg_match *match, sbi_arena *arena)
{
    size_t charges = (size_t)match->charge_count, all = charges + (size_t)match->landmark_count;
    size_t width = (size_t)match->width, nodes = (size_t)match->mesh.node_count;
    match->charges = (regi_match_charge *)sbi_arena_take(arena, all, sizeof(regi_match_charge));
    match->weights = (sb_real *)sbi_arena_take(arena, all, width * sizeof(sb_real));
    match->gradients = (sb_vec3 *)sbi_arena_take(arena, charges, width * sizeof(sb_vec3));
    match->targets = (sb_vec3 *)sbi_arena_take(arena, (size_t)match->landmark_count, sizeof(sb_vec3));
    match->trial = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    match->last = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
}

static sb_result regi_match_allocate(reg_match *match, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_match_layout(match, &arena);
    match->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&match->allocator, arena.used, 1);
    if (!match->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a match of %d charges", match->charge_count);
    arena.base = (unsigned char *)match->memory;
    arena.used = 0;
    regi_match_layout(match, &arena);
    return SB_OK;
}

/* Charges and landmarks in the elements that hold them. */
static sb_result regi_match_hold(reg_match *match, const reg_match_def *def, const regi_pieces *pieces,
                                 const regi_match_sites *sites, sb_error *error)
{
    sb_mesh mesh = match->mesh;
    size_t charges = (size_t)match->charge_count;
    for (int kind = 0; kind < 2; kind++) {
        const sb_vec3 *points = kind == 0 ? sites->points : def->landmarks;
        int count = kind == 0 ? match->charge_count : match->landmark_count;
        size_t first = kind == 0 ? 0 : charges;
        sb_embedding *embedding = NULL;
        int *start;
        sb_result result;
        if (count == 0)
            continue;
        result = regi_match_embed(&mesh, points, count, def, match->size, &embedding, error);
        if (result != SB_OK)
            return result;
        start = (int *)sbi_alloc_zeroed(&match->allocator, (size_t)mesh.element_count + 1, sizeof(int));
        if (start)
            regi_match_settle_points(embedding, pieces, count, start, match->charges + first,
                                     match->weights + first * (size_t)match->width,
                                     kind == 0 ? match->gradients : NULL);
        sb_embedding_destroy(embedding);
        sbi_free(&match->allocator, start);
        if (!start)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory to sort %d points", count);
    }
    for (size_t i = 0; i < charges; i++) {
        regi_match_charge *charge = match->charges + i;
        sb_vec3 area = sites->areas[charge->index];
        charge->area = sb_v3_norm(area);
        charge->normal = sb_v3_scale((sb_real)1 / charge->area, area);
        match->total_area += (double)charge->area;
    }
    return SB_OK;
}

/* ---- life ---- */

static sb_result regi_match_make_field(reg_match *match, const reg_match_def *def, sb_error *error)
{
    reg_field_def field = reg_default_field_def();
    sb_mesh mesh = match->mesh;
    field.kind = def->method == REG_PBSM_LAPLACE ? REG_FIELD_LAPLACE : REG_FIELD_DISTANCE;
    field.surface = def->target;
    field.points = def->target_points;
    field.normals = def->target_normals;
    field.point_count = def->target_count;
    field.cells = def->cells;
    field.allocator = def->allocator;
    field.jobs = *sbi_body_jobs(match->body);
    sb_mesh_bounds(&mesh, &field.low, &field.high);
    return reg_field_create(&field, &match->field, error);
}

static sb_result regi_match_set(reg_match *match, const reg_match_def *def, sb_error *error)
{
    sb_mesh mesh;
    sb_vec3 low, high;
    sb_real share; /* of an element in the cube of the organ's size: its cube root is the element's size */
    sb_result result = sbi_body_copy_mesh(def->body, &def->allocator, &match->mesh, error);
    if (result != SB_OK)
        return result;
    mesh = match->mesh;
    sb_mesh_bounds(&mesh, &low, &high);
    match->body = def->body;
    match->mesh_version = sb_body_mesh_version(def->body);
    match->shape = sb_body_displacements(def->body);
    match->clock = def->clock;
    match->method = def->method;
    match->width = sb_mesh_element_width(&mesh);
    match->size = sb_v3_norm(sb_v3_sub(high, low));
    match->young = sbi_body_young(def->body); /* what charges are measured with */
    if (!sb_is_finite(match->young) || !(match->young > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "the body's Young's modulus is %g", (double)match->young);
    match->rounding = (sb_real)0.5 * def->sampling * match->size;
    match->first_reach = def->reach * match->size;
    match->last_reach = sb_min(def->last_reach, def->reach) * match->size;
    match->least_cosine = def->least_cosine;
    match->least_active = def->least_active;
    match->first_charge = def->first_charge;
    match->last_charge = def->last_charge;
    match->least_growth = def->least_growth;
    match->most_growth = def->most_growth;
    match->settled = def->settled;
    match->max_seconds = def->max_seconds;
    match->landmark_count = def->landmark_count;
    match->volume = sb_mesh_volume(&mesh);
    share = match->volume / ((sb_real)mesh.element_count * match->size * match->size * match->size);
    match->landmark_stiffness = def->landmark_stiffness * match->young * match->size * sb_exp(sb_log(share) / 3);
    return SB_OK;
}

/* Rows of charges and landmarks, for the body's solver. */
static sb_result regi_match_make_potential(reg_match *match, sb_error *error)
{
    size_t rows = (size_t)match->charge_count + (size_t)match->landmark_count, width = (size_t)match->width;
    int *start, *nodes;
    sb_mapping mapping;
    sb_result result = SB_OK;
    if (rows * width > INT32_MAX)
        return sbi_fail(error, SB_ERROR_MEMORY, "%d charges have too many nodes", match->charge_count);
    start = (int *)sbi_alloc(&match->allocator, rows + 1, sizeof(int));
    nodes = (int *)sbi_alloc(&match->allocator, rows * width, sizeof(int));
    if (!start || !nodes)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d charges", match->charge_count);
    for (size_t i = 0; i <= rows && result == SB_OK; i++)
        start[i] = (int)(i * width);
    for (size_t i = 0; i < rows && result == SB_OK; i++)
        memcpy(nodes + i * width, regi_match_nodes(match, (int)i), width * sizeof(int));
    mapping.row_count = (int)rows;
    mapping.row_start = start;
    mapping.nodes = nodes;
    mapping.weights = match->weights;
    if (result == SB_OK)
        result = sbi_potential_create(match->body, &mapping, regi_match_fill, match, &match->allocator,
                                      &match->potential, error);
    sbi_free(&match->allocator, start);
    sbi_free(&match->allocator, nodes);
    return result;
}

/* The charges, and the rows of all that is held. */
static sb_result regi_match_build_on(reg_match *match, const reg_match_def *def, const regi_pieces *pieces,
                                     sb_error *error)
{
    regi_match_sites sites;
    sb_result result = regi_match_find_sites(pieces, def, &sites, error);
    if (result != SB_OK)
        return result;
    match->charge_count = sites.count;
    result = regi_match_allocate(match, error);
    if (result == SB_OK)
        result = regi_match_hold(match, def, pieces, &sites, error);
    regi_match_free_sites(&def->allocator, &sites);
    return result == SB_OK ? regi_match_make_potential(match, error) : result;
}

static sb_result regi_match_build(reg_match *match, const reg_match_def *def, sb_error *error)
{
    regi_pieces pieces;
    sb_result result = regi_match_set(match, def, error);
    if (result == SB_OK)
        result = regi_match_make_field(match, def, error);
    if (result != SB_OK)
        return result;
    match->partial = def->partial == SB_AUTO ? regi_field_is_open(match->field) : def->partial;
    result = regi_pieces_make(def->body, &match->mesh, &def->allocator, &pieces, error);
    if (result == SB_OK)
        result = regi_match_build_on(match, def, &pieces, error);
    regi_pieces_free(&pieces);
    if (result == SB_OK && match->landmark_count)
        memcpy(match->targets, def->landmark_targets, (size_t)match->landmark_count * sizeof(sb_vec3));
    return result;
}

REG_API sb_result reg_match_create(const reg_match_def *def, reg_match **match, sb_error *error)
{
    reg_match *made;
    sb_result result = regi_match_check(def, error);
    if (result == SB_OK && !match)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the match");
    if (result != SB_OK)
        return result;
    made = (reg_match *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a match");
    made->allocator = def->allocator;
    result = regi_match_build(made, def, error);
    if (result != SB_OK) {
        reg_match_destroy(made);
        return result;
    }
    reg_match_restart(made);
    *match = made;
    return SB_OK;
}

REG_API void reg_match_destroy(reg_match *match)
{
    sb_allocator allocator;
    if (!match)
        return;
    allocator = match->allocator;
    reg_field_destroy(match->field);
    sbi_potential_destroy(match->potential);
    sb_mesh_free(&match->mesh);
    sbi_free(&allocator, match->memory);
    sbi_free(&allocator, match);
}

REG_API void reg_match_restart(reg_match *match)
{
    double seconds;
    if (!match)
        return;
    seconds = match->info.seconds;
    memset(&match->info, 0, sizeof match->info);
    match->info.seconds = seconds;
    match->info.charge = match->first_charge;
    match->info.error.line = 0;
    match->info.error.element = match->info.error.node = -1;
    match->charge = match->first_charge;
    match->reach = match->first_reach;
    match->last_mean = SB_REAL_MAX;
    match->relaxation = 0;
    match->calm = 0;
}

/* ---- landmarks and readings ---- */

REG_API sb_result reg_match_move_landmarks(reg_match *match, const sb_vec3 *targets)
{
    if (!match || (!targets && match->landmark_count))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < match->landmark_count; i++)
        if (!sb_v3_is_finite(targets[i]))
            return SB_ERROR_NOT_FINITE;
    if (match->landmark_count)
        memcpy(match->targets, targets, (size_t)match->landmark_count * sizeof(sb_vec3));
    match->last_mean = SB_REAL_MAX;
    match->relaxation = 0;
    match->calm = 0;
    match->info.stop = REG_MATCH_RUNNING;
    return SB_OK;
}

REG_API void reg_match_landmarks(const reg_match *match, sb_vec3 *points)
{
    if (!match || !points || sbi_body_check_version(match->body, match->mesh_version, NULL) != SB_OK)
        return;
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++)
        points[match->charges[i].index] = regi_match_point(match, i);
}

REG_API const sb_body *reg_match_body(const reg_match *match) { return match ? match->body : NULL; }

REG_API reg_match_info reg_match_get_info(const reg_match *match)
{
    reg_match_info none;
    if (!match) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return match->info;
}

REG_API int reg_match_sample_count(const reg_match *match) { return match ? match->charge_count : 0; }

REG_API sb_result reg_match_get_sample(const reg_match *match, int index, reg_match_sample *sample)
{
    const regi_match_charge *charge;
    if (!match || !sample)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= match->charge_count)
        return SB_ERROR_INDEX;
    charge = match->charges + index;
    sample->point = charge->point;
    sample->area = charge->area;
    sample->distance = charge->distance;
    sample->active = charge->active;
    return SB_OK;
}
