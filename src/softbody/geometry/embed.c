/* embed: creation: where each point is, rings; readings. */
#include "embed_follow.h"
#include "embed_private.h"

#define SBI_EMBED_COOKIE 0x73626d31u

/* ---- creation: where each point is ---- */

/* A creation under way. */
typedef struct sbi_embed_build {
    const sb_embedding_def *def;
    const sb_vec3 *rest; /* the points */
    int count;
    sbi_embed_volume volume;
    sbi_embed_place *places;
    sb_embedding *e;
} sbi_embed_build;

static void sbi_embed_task_place(void *user, int task)
{
    sbi_embed_build *build = (sbi_embed_build *)user;
    const sb_vec3 *normals = build->def->normals;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_BUILD, build->count), hint = build->volume.order[0];
    for (int i = task * SBI_EMBED_TASK_BUILD; i < end; i++) {
        int p = build->e->order[i];
        sbi_embed_place_point(&build->volume, build->def->kind, build->rest[p], normals ? normals + p : NULL, &hint,
                              &build->places[p], &build->e->points[p]);
    }
}

static sb_result sbi_embed_no_memory(sb_error *error, int count)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory to embed %d points", count);
}

/* Places all points and fills the report. */
static sb_result sbi_embed_place_all(sbi_embed_build *build, sb_error *error)
{
    sb_embedding *e = build->e;
    sb_embedding_report *report = &e->report;
    uint32_t *scratch = (uint32_t *)sbi_alloc(&e->allocator, (size_t)build->count, 3 * sizeof(uint32_t));
    if (!scratch)
        return sbi_embed_no_memory(error, build->count);
    report->point_count = build->count;
    report->node_count = build->def->mesh->node_count;
    report->farthest_point = -1;
    sbi_embed_sort(build->rest, build->count, e->order, scratch);
    sbi_free(&e->allocator, scratch);
    sbi_run(&build->def->jobs, sbi_embed_task_place, build, sbi_embed_tasks(build->count, SBI_EMBED_TASK_BUILD));
    for (int i = 0; i < build->count; i++) {
        const sbi_embed_place *place = &build->places[i];
        if (!(place->gap <= build->def->max_distance) || !(place->gap < (sb_real)0.5 * sb_sqrt(SB_REAL_MAX)))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "point %d lies %g m outside the mesh", i,
                                 (double)place->gap);
        e->inside[i] = place->hold == SB_EMBEDDED_INSIDE;
        sbi_embed_report_add(report, place, i);
    }
    return SB_OK;
}

SB_API void sb_embedding_destroy(sb_embedding *embedding)
{
    sb_allocator allocator;
    if (!embedding)
        return;
    allocator = embedding->allocator;
    if (embedding->follower)
        sbi_embed_follower_destroy(embedding);
    else
        sbi_free(&allocator, embedding->elements);
    sbi_embed_arrays_free(&allocator, &embedding->arrays);
    sbi_embed_lists_free(embedding, &embedding->rings);
    sbi_free(&allocator, embedding->points);
    sbi_free(&allocator, embedding->rest);
    sbi_free(&allocator, embedding->rest_normals);
    sbi_free(&allocator, embedding->order);
    sbi_free(&allocator, embedding->inside);
    sbi_free(&allocator, embedding);
}

/* ---- creation: rings ---- */

/* Appends the ring of one point to items and returns how many. pairs[count][2]: the neighbours of the point in each of
 * its triangles, in their orientation. A pair that begins where the one before ended continues its run. */
static int sbi_embed_make_ring(int (*pairs)[2], int count, int *items)
{
    int used = 0;
    for (int i = 0; i < count; i++) {
        int continues = i > 0 && pairs[i][0] == pairs[i - 1][1];
        for (int j = i; i > 0 && !continues && count <= SBI_EMBED_RING && j < count; j++)
            if (pairs[j][0] == pairs[i - 1][1]) {
                int a = pairs[j][0], b = pairs[j][1];
                pairs[j][0] = pairs[i][0], pairs[j][1] = pairs[i][1];
                pairs[i][0] = a, pairs[i][1] = b;
                continues = 1;
            }
        if (!continues)
            items[used++] = ~pairs[i][0];
        items[used++] = pairs[i][1];
    }
    return used;
}

/* An open fan must start at its rim to be one run: moves the pair that no other leads to to the front. */
static void sbi_embed_start_ring(int (*pairs)[2], int count)
{
    for (int i = 0; count <= SBI_EMBED_RING && i < count; i++) {
        int led_to = 0;
        for (int j = 0; j < count; j++)
            led_to |= pairs[j][1] == pairs[i][0];
        if (!led_to) {
            int a = pairs[i][0], b = pairs[i][1];
            pairs[i][0] = pairs[0][0], pairs[i][1] = pairs[0][1];
            pairs[0][0] = a, pairs[0][1] = b;
            return;
        }
    }
}

/* Writes the rings of all points; pairs: memory for one point's. */
static void sbi_embed_fill_rings(const sb_mesh *surface, const sbi_embed_lists *corners, int (*pairs)[2],
                                 sbi_embed_lists *rings)
{
    int width = sb_element_node_count(surface->element_type);
    rings->rows = corners->rows;
    rings->starts[0] = 0;
    for (int p = 0; p < corners->rows; p++) {
        int count = corners->starts[p + 1] - corners->starts[p];
        for (int i = 0; i < count; i++) {
            int entry = corners->items[corners->starts[p] + i], local = entry % width;
            const int *nodes = surface->elements + (entry - local);
            pairs[i][0] = nodes[(local + 1) % width];
            pairs[i][1] = nodes[(local + width - 1) % width];
        }
        sbi_embed_start_ring(pairs, count);
        rings->starts[p + 1] = rings->starts[p] + sbi_embed_make_ring(pairs, count, rings->items + rings->starts[p]);
    }
}

static int sbi_embed_make_rings(sbi_embed_build *build)
{
    sb_embedding *e = build->e;
    const sb_mesh *surface = build->def->surface;
    int entries, most = 0, ok = 1, (*pairs)[2], *items;
    sbi_embed_lists corners;
    memset(&corners, 0, sizeof corners);
    if (!surface || build->def->normals)
        return 1;
    entries = surface->element_count * sb_element_node_count(surface->element_type);
    ok = sbi_embed_lists_make(e, surface->elements, entries, build->count, &corners);
    for (int p = 0; ok && p < build->count; p++)
        most = sbi_max_int(most, corners.starts[p + 1] - corners.starts[p]);
    pairs = (int(*)[2])sbi_embed_take(e, &ok, (size_t)most, sizeof(int[2]));
    e->rings.starts = (int *)sbi_embed_take(e, &ok, (size_t)build->count + 1, sizeof(int));
    e->rings.items = (int *)sbi_embed_take(e, &ok, (size_t)entries, 2 * sizeof(int));
    if (ok)
        sbi_embed_fill_rings(surface, &corners, pairs, &e->rings);
    sbi_free(&e->allocator, pairs);
    sbi_embed_lists_free(e, &corners);
    if (!ok) /* a surface without rings would look like no surface */
        return 0;
    items = (int *)sbi_embed_take(e, &ok, (size_t)e->rings.starts[build->count], sizeof(int));
    if (!ok)
        return 0;
    memcpy(items, e->rings.items, (size_t)e->rings.starts[build->count] * sizeof(int));
    sbi_free(&e->allocator, e->rings.items);
    e->rings.items = items;
    return 1;
}

/* ---- creation ---- */

SB_API sb_embedding_def sb_default_embedding_def(void)
{
    sb_embedding_def def;
    memset(&def, 0, sizeof def);
    def.kind = SB_EMBED_SMOOTH;
    def.max_distance = SB_REAL_MAX;
    def.cookie = SBI_EMBED_COOKIE;
    return def;
}

static sb_result sbi_embed_check_surface(const sb_embedding_def *def, sb_error *error)
{
    const sb_mesh *surface = def->surface;
    sb_result result = sbi_mesh_check_arrays(surface, error);
    if (result != SB_OK)
        return result;
    if (surface->element_type != SB_TRI3 && surface->element_type != SB_QUAD4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.surface has %s elements; it takes tri3 or quad4",
                        sb_element_name(surface->element_type));
    if (def->points && def->point_count != surface->node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.point_count is %d, but def.surface has %d nodes",
                        def->point_count, surface->node_count);
    if (surface->element_count > INT_MAX / 8)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.surface has more than %d elements", INT_MAX / 8);
    return SB_OK;
}

static sb_result sbi_embed_check_points(const sbi_embed_build *build, sb_error *error)
{
    for (int i = 0; i < build->count; i++)
        if (!sb_v3_is_finite(build->rest[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
    for (int i = 0; build->def->normals && i < build->count; i++)
        if (!sb_v3_is_finite(build->def->normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "normal %d has a coordinate that is not finite", i);
    return SB_OK;
}

static sb_result sbi_embed_check_def(const sb_embedding_def *def, sbi_embed_build *build, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != SBI_EMBED_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_embedding_def");
    if (!def->mesh || (!def->points && !def->surface))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh is NULL, or both def.points and def.surface");
    if (def->kind != SB_EMBED_SMOOTH && def->kind != SB_EMBED_PLAIN)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.kind is %d", (int)def->kind);
    if (!(def->max_distance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_distance is %g", (double)def->max_distance);
    if (def->mesh->element_count > INT_MAX / 6)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh has more than %d elements", INT_MAX / 6);
    if (def->mesh->element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "points cannot be embedded in custom elements");
    if (def->surface && (result = sbi_embed_check_surface(def, error)) != SB_OK)
        return result;
    build->def = def;
    build->rest = def->points ? def->points : def->surface->nodes;
    build->count = def->points ? def->point_count : def->surface->node_count;
    if (build->count < 1 || build->count > INT_MAX / 16)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.point_count is %d; it takes 1 to %d", build->count,
                        INT_MAX / 16);
    result = sbi_embed_check_points(build, error);
    if (result == SB_OK)
        result = sb_mesh_validate(def->mesh, error);
    if (result == SB_OK && sb_element_dimension(def->mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "points are embedded in volumes, not in %s",
                        sb_element_name(def->mesh->element_type));
    return result;
}

/* Everything after the checks and the volume. */
static sb_result sbi_embed_build_all(sbi_embed_build *build, sb_error *error)
{
    sb_embedding *e = build->e;
    size_t count = (size_t)build->count;
    size_t entries = (size_t)build->def->mesh->element_count * (size_t)build->volume.width;
    int ok = 1;
    sb_result result;
    e->face = build->volume.face;
    e->kind = build->def->kind;
    e->scale = build->volume.scale;
    e->elements = (int *)sbi_embed_take(e, &ok, entries, sizeof(int));
    e->points = (sb_embedded_point *)sbi_embed_take(e, &ok, count, sizeof(sb_embedded_point));
    e->order = (int *)sbi_embed_take(e, &ok, count, sizeof(int));
    e->inside = (unsigned char *)sbi_embed_take(e, &ok, count, 1);
    e->rest = (sb_vec3 *)sbi_embed_take(e, &ok, count, sizeof(sb_vec3));
    if (build->def->normals)
        e->rest_normals = (sb_vec3 *)sbi_embed_take(e, &ok, count, sizeof(sb_vec3));
    build->places = (sbi_embed_place *)sbi_embed_take(e, &ok, count, sizeof(sbi_embed_place));
    if (!ok)
        return sbi_embed_no_memory(error, build->count);
    memcpy(e->elements, build->def->mesh->elements, entries * sizeof(int));
    memcpy(e->rest, build->rest, count * sizeof(sb_vec3));
    if (build->def->normals)
        memcpy(e->rest_normals, build->def->normals, count * sizeof(sb_vec3));
    result = sbi_embed_place_all(build, error);
    if (result == SB_OK) {
        sbi_embed_parts parts;
        memset(&parts, 0, sizeof parts);
        parts.places = build->places;
        parts.with_normals = build->def->normals != NULL;
        parts.with_offsets = e->report.frame + e->report.extrapolated > 0;
        parts.node_count = build->def->mesh->node_count;
        parts.element_count = build->def->mesh->element_count;
        parts.width = build->volume.width;
        parts.faces = build->volume.faces;
        parts.elements = e->elements;
        parts.outer = build->volume.boundary_face;
        parts.weights = build->volume.weights;
        parts.face = &e->face;
        sbi_embed_fill_local(e->type, parts.local);
        ok = sbi_embed_arrays_fill(&e->allocator, &e->arrays, &parts, e->order, build->count) &&
             sbi_embed_make_rings(build);
    }
    if (result == SB_OK && !ok)
        result = sbi_embed_no_memory(error, build->count);
    return result;
}

SB_API sb_result sb_embedding_create(const sb_embedding_def *def, sb_embedding **embedding, sb_error *error)
{
    sbi_embed_build build;
    sb_result result;
    memset(&build, 0, sizeof build);
    if (!embedding)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "embedding is NULL");
    result = sbi_embed_check_def(def, &build, error);
    if (result != SB_OK)
        return result;
    result = sbi_embed_volume_create(def->mesh, SBI_EMBED_SKIN, &def->allocator, &build.volume, error);
    if (result != SB_OK)
        return result;
    build.e = (sb_embedding *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *build.e);
    if (build.e) {
        build.e->allocator = def->allocator;
        build.e->type = def->mesh->element_type;
        result = sbi_embed_build_all(&build, error);
    } else {
        result = sbi_embed_no_memory(error, build.count);
    }
    sbi_free(&def->allocator, build.places);
    sbi_embed_volume_free(&build.volume);
    if (result == SB_OK)
        *embedding = build.e;
    else
        sb_embedding_destroy(build.e);
    return result;
}

/* ---- readings ---- */

SB_API sb_embedding_report sb_embedding_get_report(const sb_embedding *embedding)
{
    sb_embedding_report none;
    memset(&none, 0, sizeof none);
    none.farthest_point = -1;
    return embedding ? embedding->report : none;
}

SB_API sb_result sb_embedding_get_point(const sb_embedding *embedding, int index, sb_embedded_point *point)
{
    if (!embedding || !point)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= embedding->report.point_count)
        return SB_ERROR_INDEX;
    *point = embedding->points[index];
    point->lost = embedding->inside[index] && point->hold != SB_EMBEDDED_INSIDE;
    return SB_OK;
}

/* Nodes and weights of one point: N_a(xi) + dN_a/dxi . step. */
static void sbi_embed_fill_row(const sb_embedding *e, const sb_embedded_point *point, int *nodes, sb_real *weights)
{
    int width = sb_element_node_count(e->type);
    sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3];
    sb_element_shape(e->type, point->xi, shape, slope);
    for (int a = 0; a < width; a++) {
        nodes[a] = e->elements[(size_t)point->element * (size_t)width + (size_t)a];
        weights[a] =
            shape[a] + slope[a][0] * point->step[0] + slope[a][1] * point->step[1] + slope[a][2] * point->step[2];
    }
}

SB_API sb_result sb_embedding_mapping(const sb_embedding *embedding, const sb_allocator *allocator,
                                      sb_embedding_rows *rows, sb_error *error)
{
    int width, count, *starts, *nodes;
    sb_real *weights;
    size_t entries;
    if (!embedding || !rows)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the embedding or rows is NULL");
    if (embedding->follower && embedding->follower->stale)
        return sbi_fail(error, SB_ERROR_STATE,
                        "the embedding has yet to follow a state that was loaded: update it first");
    width = sb_element_node_count(embedding->type);
    count = embedding->report.point_count;
    if (count > INT_MAX / width)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d rows of %d nodes are more than a mapping can number", count,
                        width);
    entries = (size_t)count * (size_t)width;
    starts = (int *)sbi_alloc(allocator, (size_t)count + 1, sizeof(int));
    nodes = (int *)sbi_alloc(allocator, entries, sizeof(int));
    weights = (sb_real *)sbi_alloc(allocator, entries, sizeof(sb_real));
    if (!starts || !nodes || !weights) {
        sbi_free(allocator, starts);
        sbi_free(allocator, nodes);
        sbi_free(allocator, weights);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows", count);
    }
    for (int i = 0; i <= count; i++)
        starts[i] = i * width;
    for (int i = 0; i < count; i++)
        sbi_embed_fill_row(embedding, &embedding->points[i], nodes + starts[i], weights + starts[i]);
    memset(rows, 0, sizeof *rows);
    if (allocator)
        rows->allocator = *allocator;
    rows->mapping.row_count = count;
    rows->mapping.row_start = rows->row_start = starts;
    rows->mapping.nodes = rows->nodes = nodes;
    rows->mapping.weights = rows->weights = weights;
    return SB_OK;
}

SB_API void sb_embedding_rows_free(sb_embedding_rows *rows)
{
    sb_allocator allocator;
    if (!rows)
        return;
    allocator = rows->allocator;
    sbi_free(&allocator, rows->row_start);
    sbi_free(&allocator, rows->nodes);
    sbi_free(&allocator, rows->weights);
    memset(rows, 0, sizeof *rows);
}
