/* nicp: what a non-rigid registration is made from: sources, samples, and the rows that hold them. */
#include "nicp.h"

#include <string.h>

#include "../softbody/body/live_mesh.h"
#include "../softbody/geometry/embed.h"
#include "kdtree.h"
#include "nicp_private.h"
#include "pieces.h"

#define REGI_NICP_COOKIE 0x6e696370u

REG_API reg_nicp_def reg_default_nicp_def(void)
{
    reg_nicp_def def;
    memset(&def, 0, sizeof def);
    def.sources = 4000;
    def.samples = 2000;
    def.view = REG_NICP_ALL;
    def.blending = (sb_real)0.75;
    def.sliding = (sb_real)0.999;
    def.least_cosine = (sb_real)0.3;
    def.outliers = REG_OUTLIERS_MEDIAN;
    def.outlier_parameter = 3;
    def.reach = (sb_real)0.1;
    def.last_reach = (sb_real)0.03;
    def.first_stiffness = 300;
    def.last_stiffness = 30000;
    def.increments = 4;
    def.iterations = 2;
    def.newton = 6;
    def.newton_tolerance = (sb_real)0.07;
    def.tolerance = (sb_real)5e-5;
    def.least_active = (sb_real)0.05;
    def.landmark_stiffness = 50;
    def.max_seconds = 1e9;
    def.cookie = REGI_NICP_COOKIE;
    return def;
}

/* ---- checks ---- */

static sb_result regi_nicp_check_numbers(const reg_nicp_def *def, sb_error *error)
{
    const struct {
        const char *name;
        sb_real value, low, high;
        int above; /* 1: low itself is out of range, too */
    } fields[] = {{"blending", def->blending, 0, 1, 0},
                  {"sliding", def->sliding, 0, 1, 0},
                  {"least_cosine", def->least_cosine, -1, 1, 0},
                  {"reach", def->reach, 0, SB_REAL_MAX, 1},
                  {"last_reach", def->last_reach, 0, def->reach, 1},
                  {"first_stiffness", def->first_stiffness, 0, SB_REAL_MAX, 1},
                  {"last_stiffness", def->last_stiffness, def->first_stiffness, SB_REAL_MAX, 0},
                  {"newton_tolerance", def->newton_tolerance, 0, 1 - SB_EPSILON, 1},
                  {"tolerance", def->tolerance, 0, SB_REAL_MAX, 1},
                  {"least_active", def->least_active, 0, 1, 0},
                  {"landmark_stiffness", def->landmark_stiffness, 0, SB_REAL_MAX, 1},
                  {"sources", (sb_real)def->sources, 4, SB_REAL_MAX, 0},
                  {"samples", (sb_real)def->samples, 0, SB_REAL_MAX, 0},
                  {"increments", (sb_real)def->increments, 1, SB_REAL_MAX, 0},
                  {"iterations", (sb_real)def->iterations, 1, SB_REAL_MAX, 0},
                  {"newton", (sb_real)def->newton, 1, SB_REAL_MAX, 0}};
    for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++)
        if (!sb_is_finite(fields[i].value) || fields[i].value < fields[i].low || fields[i].value > fields[i].high ||
            (fields[i].above && !(fields[i].value > fields[i].low)))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of a registration is %g, out of range", fields[i].name,
                            (double)fields[i].value);
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    return SB_OK;
}

static sb_result regi_nicp_check_rules(const reg_nicp_def *def, sb_error *error)
{
    sb_real distances[2] = {1, 1}, scratch[2];
    if (def->view != REG_NICP_ALL && def->view != REG_NICP_FACING && def->view != REG_NICP_VISIBLE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no view %d of the organ", (int)def->view);
    if (!sb_v3_is_finite(def->camera))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the camera's place is not finite");
    if (reg_outlier_limit(distances, 2, def->outliers, def->outlier_parameter, scratch) < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no rule %d for outliers with the parameter %g",
                        (int)def->outliers, (double)def->outlier_parameter);
    return SB_OK;
}

static sb_result regi_nicp_check_landmarks(const reg_nicp_def *def, sb_error *error)
{
    if (def->landmark_count < 0 || (def->landmark_count > 0 && (!def->landmarks || !def->landmark_targets)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks need points and targets", def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i]) || !sb_v3_is_finite(def->landmark_targets[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    return SB_OK;
}

static sb_result regi_nicp_check(const reg_nicp_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != REGI_NICP_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a registration needs a def made by reg_default_nicp_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a registration needs a body");
    if ((def->target != NULL) == (def->target_points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a registration needs either a target or target_points");
    if (sbi_body_mesh(def->body).element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body of custom elements cannot be registered");
    if (def->grid && !def->surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a body in a grid needs its surface");
    if (def->grid &&
        (sb_body_mesh_version(def->body) != 0 || def->grid->body_mesh.node_count != sb_body_node_count(def->body) ||
         def->grid->body_mesh.element_count != sb_body_element_count(def->body)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body was not made from the grid, or has changed since");
    result = regi_nicp_check_numbers(def, error);
    if (result == SB_OK)
        result = regi_nicp_check_rules(def, error);
    return result == SB_OK ? regi_nicp_check_landmarks(def, error) : result;
}

/* ---- rows ---- */

static void regi_nicp_free_rows(const sb_allocator *allocator, regi_nicp_rows *rows)
{
    sbi_free(allocator, rows->start);
    sbi_free(allocator, rows->nodes);
    sbi_free(allocator, rows->weights);
}

/* Rows chosen[count] of a mapping (NULL: all of them) as rows of one's own. */
static sb_result regi_nicp_copy_rows(const sb_mapping *from, const int *chosen, int count,
                                     const sb_allocator *allocator, regi_nicp_rows *rows, sb_error *error)
{
    size_t entries = 0;
    int at = 0;
    for (int i = 0; i < count; i++) {
        int row = chosen ? chosen[i] : i;
        entries += (size_t)(from->row_start[row + 1] - from->row_start[row]);
    }
    rows->start = (int *)sbi_alloc(allocator, (size_t)count + 1, sizeof(int));
    rows->nodes = (int *)sbi_alloc(allocator, entries, sizeof(int));
    rows->weights = (sb_real *)sbi_alloc(allocator, entries, sizeof(sb_real));
    if (!rows->start || !rows->nodes || !rows->weights)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows of weights", count);
    rows->start[0] = 0;
    for (int i = 0; i < count; i++) {
        int row = chosen ? chosen[i] : i;
        for (int k = from->row_start[row]; k < from->row_start[row + 1]; k++, at++) {
            rows->nodes[at] = from->nodes[k];
            rows->weights[at] = from->weights[k];
        }
        rows->start[i + 1] = at;
    }
    rows->mapping.row_count = count;
    rows->mapping.row_start = rows->start;
    rows->mapping.nodes = rows->nodes;
    rows->mapping.weights = rows->weights;
    return SB_OK;
}

/* Each of the nodes by itself. */
static sb_result regi_nicp_node_rows(const int *nodes, int count, const sb_allocator *allocator, regi_nicp_rows *rows,
                                     sb_error *error)
{
    size_t size = (size_t)count;
    rows->start = (int *)sbi_alloc(allocator, size + 1, sizeof(int));
    rows->nodes = (int *)sbi_alloc(allocator, size, sizeof(int));
    rows->weights = (sb_real *)sbi_alloc(allocator, size, sizeof(sb_real));
    if (!rows->start || !rows->nodes || !rows->weights)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows of weights", count);
    for (int i = 0; i <= count; i++)
        rows->start[i] = i;
    for (int i = 0; i < count; i++) {
        rows->nodes[i] = nodes[i];
        rows->weights[i] = 1;
    }
    rows->mapping.row_count = count;
    rows->mapping.row_start = rows->start;
    rows->mapping.nodes = rows->nodes;
    rows->mapping.weights = rows->weights;
    return SB_OK;
}

static sb_result regi_nicp_grid_rows(const reg_nicp_def *def, const sb_vec3 *points, int count, regi_nicp_rows *rows,
                                     sb_error *error)
{
    sb_grid_rows made;
    sb_result result;
    memset(&made, 0, sizeof made);
    result = sb_grid_map_points(def->grid, points, count, &def->allocator, &made, error);
    if (result == SB_OK)
        result = regi_nicp_copy_rows(&made.rows, NULL, count, &def->allocator, rows, error);
    sb_grid_rows_free(&made);
    return result;
}

/* Rows of points go with the pieces that have their material. */
static void regi_nicp_go_with_pieces(const regi_pieces *pieces, const sb_embedding *embedding, regi_nicp_rows *rows)
{
    const sb_mesh *mesh = pieces->mesh;
    int width = sb_mesh_element_width(mesh);
    for (int i = 0; i < rows->mapping.row_count; i++) {
        sb_embedded_point point;
        const int *from, *to;
        (void)sb_embedding_get_point(embedding, i, &point);
        from = mesh->elements + (size_t)point.element * (size_t)width;
        to = mesh->elements + (size_t)regi_pieces_find(pieces, point.element, point.xi) * (size_t)width;
        for (int k = rows->start[i]; k < rows->start[i + 1]; k++) {
            int a = 0;
            while (a < width - 1 && from[a] != rows->nodes[k])
                a++;
            rows->nodes[k] = to[a];
        }
    }
}

/* Rows of points at rest, through the grid or the elements. */
static sb_result regi_nicp_hold(const reg_nicp *nicp, const reg_nicp_def *def, const regi_pieces *pieces,
                                const sb_vec3 *points, int count, regi_nicp_rows *rows, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_embedding_rows made;
    sb_result result;
    if (def->grid)
        return regi_nicp_grid_rows(def, points, count, rows, error);
    memset(&made, 0, sizeof made);
    embed.mesh = &nicp->mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * nicp->size; /* beyond, the surface and the model are not of one organ */
    embed.allocator = def->allocator;
    embed.jobs = *sbi_body_jobs(def->body);
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &def->allocator, &made, error);
    if (result == SB_OK)
        result = regi_nicp_copy_rows(&made.mapping, NULL, count, &def->allocator, rows, error);
    if (result == SB_OK && pieces->cells)
        regi_nicp_go_with_pieces(pieces, embedding, rows);
    sb_embedding_rows_free(&made);
    sb_embedding_destroy(embedding);
    return result;
}

/* ---- the organ's surface ---- */

/* The surface's triangles as the skin has them give each vertex its area, and a triangle to have a normal by. */
static void regi_nicp_measure(const sb_surface *skin, const sb_vec3 *points, sb_real *areas, int *home)
{
    const sb_real sixth = (sb_real)1 / 6;
    for (int t = 0; t < sb_surface_triangle_count(skin); t++) {
        int c[3];
        sb_vec3 along;
        sb_real area;
        (void)sb_surface_triangle(skin, t, c);
        along = sb_v3_sub(points[c[1]], points[c[0]]);
        area = sixth * sb_v3_norm(sb_v3_cross(along, sb_v3_sub(points[c[2]], points[c[0]])));
        for (int k = 0; k < 3; k++) {
            areas[c[k]] += area;
            home[c[k]] = 3 * t + k + 1; /* 0: none */
        }
    }
}

/* Which vertices stand for which: runs of the order of a tree of them, in which neighbours are neighbours. */
typedef struct regi_nicp_choice {
    int count;       /* of vertices that have an area */
    int *items;      /* [count] vertices */
    sb_vec3 *points; /* [count] */
    int *order;      /* [count] into items */
    sb_real spacing; /* m, mean distance of the points from their nearest */
} regi_nicp_choice;

static void regi_nicp_free_choice(const sb_allocator *allocator, regi_nicp_choice *choice)
{
    sbi_free(allocator, choice->items);
    sbi_free(allocator, choice->points);
    sbi_free(allocator, choice->order);
}

/* From a thousand of the points or so. */
static sb_real regi_nicp_spacing(const reg_kdtree *tree, const regi_nicp_choice *choice)
{
    int stride = 1 + choice->count / 1024, met = 0;
    double sum = 0;
    for (int i = 0; i < choice->count; i += stride) {
        int near[2];
        sb_real squared[2];
        if (reg_kdtree_k_nearest(tree, choice->points[i], 2, near, squared) < 2)
            continue;
        sum += sqrt((double)squared[1]);
        met++;
    }
    return met ? (sb_real)(sum / met) : 0;
}

/* Of the points whose areas (NULL: all count) are not 0. */
static sb_result regi_nicp_order(const sb_vec3 *points, const sb_real *areas, int count, const sb_allocator *allocator,
                                 regi_nicp_choice *choice, sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_result result;
    memset(choice, 0, sizeof *choice);
    choice->items = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    choice->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    choice->order = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    if (!choice->items || !choice->points || !choice->order)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to choose from %d points", count);
    for (int i = 0; i < count; i++)
        if (!areas || areas[i] > 0) {
            choice->items[choice->count] = i;
            choice->points[choice->count++] = points[i];
        }
    if (choice->count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
    result = reg_kdtree_create(choice->points, choice->count, allocator, &tree, error);
    if (result != SB_OK)
        return result;
    regi_kdtree_order(tree, choice->order);
    choice->spacing = regi_nicp_spacing(tree, choice);
    reg_kdtree_destroy(tree);
    return SB_OK;
}

/* First of run i of `count` runs. */
static int regi_nicp_run_start(const regi_nicp_choice *choice, int i, int count)
{
    return (int)((int64_t)i * choice->count / count);
}

/* The one of a run that is nearest to its middle. */
static int regi_nicp_middle(const regi_nicp_choice *choice, int first, int last)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real least = SB_REAL_MAX;
    int best = choice->order[first];
    for (int i = first; i < last; i++)
        sum = sb_v3_add(sum, choice->points[choice->order[i]]);
    sum = sb_v3_scale((sb_real)1 / (sb_real)(last - first), sum);
    for (int i = first; i < last; i++) {
        sb_vec3 d = sb_v3_sub(choice->points[choice->order[i]], sum);
        if (sb_v3_dot(d, d) < least) {
            least = sb_v3_dot(d, d);
            best = choice->order[i];
        }
    }
    return choice->items[best];
}

static void regi_nicp_make_sources(reg_nicp *nicp, const regi_nicp_choice *choice, const sb_real *areas,
                                   const int *home)
{
    for (int v = 0; v < nicp->vertex_count; v++)
        nicp->source_of[v] = -1;
    for (int i = 0; i < nicp->source_count; i++) {
        regi_nicp_source *source = nicp->sources + i;
        int first = regi_nicp_run_start(choice, i, nicp->source_count);
        int last = regi_nicp_run_start(choice, i + 1, nicp->source_count);
        source->vertex = regi_nicp_middle(choice, first, last);
        source->triangle = home[source->vertex] > 0 ? (home[source->vertex] - 1) / 3 : -1;
        source->corner = home[source->vertex] > 0 ? (home[source->vertex] - 1) % 3 : 0;
        source->guess = -1;
        for (int k = first; k < last; k++) {
            int vertex = choice->items[choice->order[k]];
            source->area += areas[vertex];
            nicp->source_of[vertex] = i;
        }
        nicp->total_area += (double)source->area;
    }
}

/* ---- memory ---- */

static void regi_nicp_layout(reg_nicp *nicp, sbi_arena *arena)
{
    size_t vertices = (size_t)nicp->vertex_count, sources = (size_t)nicp->source_count;
    size_t samples = (size_t)nicp->sample_count, larger = sources > samples ? sources : samples;
    nicp->vertices = (sb_vec3 *)sbi_arena_take(arena, vertices, sizeof(sb_vec3));
    nicp->source_of = (int *)sbi_arena_take(arena, vertices, sizeof(int));
    nicp->sources = (regi_nicp_source *)sbi_arena_take(arena, sources, sizeof(regi_nicp_source));
    nicp->samples = (regi_nicp_sample *)sbi_arena_take(arena, samples, sizeof(regi_nicp_sample));
    nicp->distances = (sb_real *)sbi_arena_take(arena, larger, sizeof(sb_real));
    nicp->scratch = (sb_real *)sbi_arena_take(arena, larger, sizeof(sb_real));
    nicp->goals = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->stiffness = (sb_real *)sbi_arena_take(arena, sources, sizeof(sb_real));
    nicp->lines = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->before = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->settled = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->targets = (sb_vec3 *)sbi_arena_take(arena, (size_t)nicp->landmark_count, sizeof(sb_vec3));
}

static sb_result regi_nicp_allocate(reg_nicp *nicp, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_nicp_layout(nicp, &arena);
    nicp->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&nicp->allocator, 1, arena.used);
    if (!nicp->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d sources", nicp->source_count);
    arena.base = (unsigned char *)nicp->memory;
    arena.used = 0;
    regi_nicp_layout(nicp, &arena);
    return SB_OK;
}

/* ---- life ---- */

static sb_result regi_nicp_make_field(reg_nicp *nicp, const reg_nicp_def *def, sb_error *error)
{
    reg_field_def field = reg_default_field_def();
    field.surface = def->target;
    field.points = def->target_points;
    field.normals = def->target_normals;
    field.point_count = def->target_count;
    field.allocator = def->allocator;
    field.jobs = *sbi_body_jobs(def->body);
    return reg_field_create(&field, &nicp->field, error);
}

/* What the penalty is measured with. */
static sb_result regi_nicp_measure_body(reg_nicp *nicp, const sb_mesh *surface, const reg_nicp_def *def,
                                        sb_error *error)
{
    sb_vec3 low, high;
    sb_real share; /* of an element in the cube of the organ's size: its cube root is the element's size */
    sb_mesh_bounds(surface, &low, &high);
    nicp->size = sb_v3_norm(sb_v3_sub(high, low));
    nicp->young = sbi_body_young(nicp->body);
    if (!sb_is_finite(nicp->young) || !(nicp->young > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "the body's Young's modulus is %g", (double)nicp->young);
    share = def->grid ? def->grid->cell_size.x * def->grid->cell_size.y * def->grid->cell_size.z
                      : sb_mesh_volume(&nicp->mesh) / (sb_real)nicp->mesh.element_count;
    nicp->volume = sb_mesh_volume(&nicp->mesh);
    share /= nicp->size * nicp->size * nicp->size;
    nicp->landmark_stiffness = def->landmark_stiffness * nicp->young * nicp->size * sb_exp(sb_log(share) / 3);
    nicp->reach = def->reach * nicp->size;
    nicp->last_reach = def->last_reach * nicp->size;
    nicp->first_stiffness = def->first_stiffness * nicp->young / nicp->size;
    nicp->last_stiffness = def->last_stiffness * nicp->young / nicp->size;
    return SB_OK;
}

static void regi_nicp_set(reg_nicp *nicp, const reg_nicp_def *def)
{
    nicp->allocator = def->allocator;
    nicp->clock = def->clock;
    nicp->body = def->body;
    nicp->mesh_version = sb_body_mesh_version(def->body);
    nicp->view = def->view;
    nicp->camera = def->camera;
    nicp->blending = def->blending;
    nicp->sliding = def->sliding;
    nicp->least_cosine = def->least_cosine;
    nicp->noisy = def->noisy != 0;
    nicp->outliers = def->outliers;
    nicp->outlier_parameter = def->outlier_parameter;
    nicp->tolerance = def->tolerance;
    nicp->newton = def->newton;
    nicp->newton_tolerance = def->newton_tolerance;
    nicp->least_active = def->least_active;
    nicp->increments = def->increments;
    nicp->iterations = def->iterations;
    nicp->landmark_count = def->landmark_count;
    nicp->max_seconds = def->max_seconds;
}

/* Sources from the surface at rest. areas, home: scratch [nodes], zeroed. */
static sb_result regi_nicp_choose_sources(reg_nicp *nicp, const sb_mesh *surface, int most, sb_real *areas, int *home,
                                          sb_error *error)
{
    regi_nicp_choice choice;
    int *chosen;
    sb_result result;
    regi_nicp_measure(nicp->skin, surface->nodes, areas, home);
    result = regi_nicp_order(surface->nodes, areas, surface->node_count, &nicp->allocator, &choice, error);
    if (result == SB_OK) {
        nicp->vertex_count = surface->node_count;
        nicp->source_count = sbi_min_int(choice.count, most);
        result = regi_nicp_allocate(nicp, error);
    }
    if (result == SB_OK)
        regi_nicp_make_sources(nicp, &choice, areas, home);
    regi_nicp_free_choice(&nicp->allocator, &choice);
    if (result != SB_OK)
        return result;
    chosen = (int *)sbi_alloc(&nicp->allocator, (size_t)nicp->source_count, sizeof(int));
    if (!chosen)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d sources", nicp->source_count);
    for (int i = 0; i < nicp->source_count; i++)
        chosen[i] = nicp->sources[i].vertex;
    result = regi_nicp_copy_rows(&nicp->rows.mapping, chosen, nicp->source_count, &nicp->allocator, &nicp->source_rows,
                                 error);
    sbi_free(&nicp->allocator, chosen);
    return result;
}

static sb_result regi_nicp_take_surface(reg_nicp *nicp, const sb_mesh *surface, int most, sb_error *error)
{
    size_t count = (size_t)surface->node_count;
    sb_real *areas = (sb_real *)sbi_alloc_zeroed(&nicp->allocator, count, sizeof(sb_real));
    int *home = (int *)sbi_alloc_zeroed(&nicp->allocator, count, sizeof(int));
    sb_result result = areas && home ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the organ's surface");
    if (result == SB_OK)
        result = regi_nicp_choose_sources(nicp, surface, most, areas, home, error);
    sbi_free(&nicp->allocator, areas);
    sbi_free(&nicp->allocator, home);
    return result;
}

/* The target's points that look for sources; they are counted before there is memory for them. */
static sb_result regi_nicp_choose_samples(reg_nicp *nicp, const reg_nicp_def *def, regi_nicp_choice *choice,
                                          sb_error *error)
{
    const sb_vec3 *points = def->target ? def->target->nodes : def->target_points;
    int count = def->target ? def->target->node_count : def->target_count;
    sb_result result = regi_nicp_order(points, NULL, count, &nicp->allocator, choice, error);
    nicp->sample_count = sbi_min_int(choice->count, def->samples);
    nicp->is_cloud = !def->target;
    nicp->spacing = choice->spacing;
    return result;
}

static void regi_nicp_make_samples(reg_nicp *nicp, const regi_nicp_choice *choice)
{
    for (int i = 0; i < nicp->sample_count; i++) {
        regi_nicp_sample *sample = nicp->samples + i;
        reg_field_hit hit;
        sample->point = choice->points[choice->order[regi_nicp_run_start(choice, i, nicp->sample_count)]];
        sample->guess = -1;
        if (reg_field_closest(nicp->field, sample->point, -1, &hit))
            sample->normal = hit.normal;
    }
}

/* The penalties, without force so far. */
static sb_result regi_nicp_add_loads(reg_nicp *nicp, const reg_nicp_def *def, sb_error *error)
{
    const sb_real none = 0;
    sb_result result;
    regi_nicp_points(nicp, &nicp->source_rows, nicp->goals);
    result =
        sb_body_add_mapping(nicp->body, &nicp->source_rows.mapping, &none, 1, nicp->goals, &nicp->surface_load, error);
    if (result == SB_OK && sbi_body_reserve_mapping_lines(nicp->body, nicp->surface_load) != SB_OK)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the lines of %d sources", nicp->source_count);
    if (result != SB_OK || nicp->landmark_count == 0)
        return result;
    memcpy(nicp->targets, def->landmark_targets, (size_t)nicp->landmark_count * sizeof(sb_vec3));
    return sb_body_add_mapping(nicp->body, &nicp->landmark_rows.mapping, &none, 1, nicp->targets, &nicp->landmark_load,
                               error);
}

static sb_result regi_nicp_build_on(reg_nicp *nicp, const reg_nicp_def *def, const regi_pieces *pieces,
                                    const sb_boundary *skin, sb_error *error)
{
    const sb_mesh *surface = &skin->surface;
    regi_nicp_choice samples;
    sb_result result = sb_surface_create(surface, &def->allocator, &nicp->skin, error);
    if (result == SB_OK)
        result = regi_nicp_measure_body(nicp, surface, def, error);
    if (result == SB_OK)
        result = regi_nicp_make_field(nicp, def, error);
    if (result == SB_OK)
        result = def->surface
                     ? regi_nicp_hold(nicp, def, pieces, surface->nodes, surface->node_count, &nicp->rows, error)
                     : regi_nicp_node_rows(skin->nodes, surface->node_count, &def->allocator, &nicp->rows, error);
    if (result == SB_OK && nicp->landmark_count)
        result = regi_nicp_hold(nicp, def, pieces, def->landmarks, nicp->landmark_count, &nicp->landmark_rows, error);
    if (result != SB_OK)
        return result;
    result = regi_nicp_choose_samples(nicp, def, &samples, error);
    if (result == SB_OK)
        result = regi_nicp_take_surface(nicp, surface, def->sources, error);
    if (result == SB_OK)
        regi_nicp_make_samples(nicp, &samples);
    regi_nicp_free_choice(&nicp->allocator, &samples);
    return result == SB_OK ? regi_nicp_add_loads(nicp, def, error) : result;
}

static sb_result regi_nicp_build(reg_nicp *nicp, const reg_nicp_def *def, sb_error *error)
{
    regi_pieces pieces;
    sb_boundary skin;
    sb_result result = sbi_body_copy_mesh(def->body, &def->allocator, &nicp->mesh, error);
    if (result != SB_OK)
        return result;
    regi_nicp_set(nicp, def);
    result = regi_pieces_make(def->body, &nicp->mesh, &def->allocator, &pieces, error);
    if (result == SB_OK)
        result = regi_pieces_skin(&pieces, def->surface, &skin, error);
    if (result == SB_OK) {
        result = regi_nicp_build_on(nicp, def, &pieces, &skin, error);
        sb_boundary_free(&skin);
    }
    regi_pieces_free(&pieces);
    return result;
}

REG_API sb_result reg_nicp_create(const reg_nicp_def *def, reg_nicp **nicp, sb_error *error)
{
    reg_nicp *made;
    sb_result result = regi_nicp_check(def, error);
    if (result == SB_OK && !nicp)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the registration");
    if (result != SB_OK)
        return result;
    made = (reg_nicp *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a registration");
    made->allocator = def->allocator;
    result = regi_nicp_build(made, def, error);
    if (result != SB_OK) {
        reg_nicp_destroy(made);
        return result;
    }
    reg_nicp_restart(made);
    *nicp = made;
    return SB_OK;
}

REG_API void reg_nicp_destroy(reg_nicp *nicp)
{
    sb_allocator allocator;
    if (!nicp)
        return;
    allocator = nicp->allocator;
    if (nicp->landmark_load)
        (void)sb_body_remove_load(nicp->body, nicp->landmark_load);
    if (nicp->surface_load)
        (void)sb_body_remove_load(nicp->body, nicp->surface_load);
    sb_mesh_free(&nicp->mesh);
    reg_field_destroy(nicp->field);
    sb_surface_destroy(nicp->skin);
    regi_nicp_free_rows(&allocator, &nicp->rows);
    regi_nicp_free_rows(&allocator, &nicp->source_rows);
    regi_nicp_free_rows(&allocator, &nicp->landmark_rows);
    sbi_free(&allocator, nicp->memory);
    sbi_free(&allocator, nicp);
}

REG_API void reg_nicp_restart(reg_nicp *nicp)
{
    double seconds;
    if (!nicp)
        return;
    seconds = nicp->info.seconds;
    memset(&nicp->info, 0, sizeof nicp->info);
    nicp->info.seconds = seconds;
    nicp->info.error.element = nicp->info.error.node = -1;
    nicp->increment = nicp->iteration = nicp->has_settled = 0;
}

/* ---- landmarks and readings ---- */

REG_API sb_result reg_nicp_move_landmarks(reg_nicp *nicp, const sb_vec3 *targets)
{
    if (!nicp || (!targets && nicp->landmark_count))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < nicp->landmark_count; i++)
        if (!sb_v3_is_finite(targets[i]))
            return SB_ERROR_NOT_FINITE;
    if (nicp->landmark_count) {
        sb_result result = sb_body_set_mapping_targets(nicp->body, nicp->landmark_load, targets);
        if (result != SB_OK)
            return result;
        memcpy(nicp->targets, targets, (size_t)nicp->landmark_count * sizeof(sb_vec3));
    }
    nicp->has_settled = nicp->iteration = 0;
    nicp->info.stop = REG_NICP_RUNNING;
    return SB_OK;
}

REG_API void reg_nicp_landmarks(const reg_nicp *nicp, sb_vec3 *points)
{
    if (!nicp || !points || sbi_body_check_version(nicp->body, nicp->mesh_version, NULL) != SB_OK)
        return;
    if (nicp->landmark_count)
        regi_nicp_points(nicp, &nicp->landmark_rows, points);
}

REG_API const sb_body *reg_nicp_body(const reg_nicp *nicp) { return nicp ? nicp->body : NULL; }

REG_API reg_nicp_info reg_nicp_get_info(const reg_nicp *nicp)
{
    reg_nicp_info none;
    if (!nicp) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return nicp->info;
}

REG_API int reg_nicp_surface_count(const reg_nicp *nicp) { return nicp ? nicp->vertex_count : 0; }

REG_API void reg_nicp_positions(const reg_nicp *nicp, sb_vec3 *points)
{
    if (!nicp || !points || sbi_body_check_version(nicp->body, nicp->mesh_version, NULL) != SB_OK)
        return;
    regi_nicp_points(nicp, &nicp->rows, points);
}

REG_API int reg_nicp_source_count(const reg_nicp *nicp) { return nicp ? nicp->source_count : 0; }

REG_API sb_result reg_nicp_get_source(const reg_nicp *nicp, int index, reg_nicp_source *source)
{
    const regi_nicp_source *from;
    if (!nicp || !source)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= nicp->source_count)
        return SB_ERROR_INDEX;
    from = nicp->sources + index;
    source->vertex = from->vertex;
    source->point = nicp->before[index];
    source->goal = nicp->goals[index];
    source->area = from->area;
    source->distance = from->distance;
    source->visible = from->visible;
    source->active = from->active;
    return SB_OK;
}
