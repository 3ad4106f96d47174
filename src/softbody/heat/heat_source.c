/* heat_source: applicators, fluxes and convection, each a list of matrix rows and what they get. */
#include "heat_private.h"

#include <math.h>
#include <string.h>

/* ---- memory ---- */

static void sbi_heat_source_layout(sbi_heat_source *source, sbi_arena *arena)
{
    size_t count = (size_t)source->count;
    source->value = (sb_real *)sbi_arena_take(arena, 2 + count, sizeof(sb_real));
    source->head = (int *)sbi_arena_take(arena, SBI_HEAT_HEAD + 2 * count, sizeof(int));
    source->at = (int *)sbi_arena_take(arena, count, sizeof(int));
}

SBI_API int sbi_heat_make_source(const sb_heat *heat, sbi_heat_kind kind, int count, sbi_heat_source *source)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(source, 0, sizeof *source);
    source->kind = kind;
    source->count = count;
    sbi_heat_source_layout(source, &arena);
    source->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&heat->body->allocator, arena.used, 1);
    if (!source->memory)
        return 0;
    arena.base = (unsigned char *)source->memory;
    arena.used = 0;
    sbi_heat_source_layout(source, &arena);
    source->surroundings = source->value + 1;
    source->shares = source->value + 2;
    source->head[0] = SBI_HEAT_ADD;
    source->head[1] = (int)kind;
    source->head[2] = count;
    source->rows = source->head + SBI_HEAT_HEAD;
    source->columns = source->rows + count;
    *source->surroundings = 1;
    return 1;
}

SBI_API void sbi_heat_free_sources(const sb_heat *heat, sbi_heat_source *sources, int count)
{
    for (int i = 0; sources && i < count; i++)
        sbi_free(&heat->body->allocator, sources[i].memory);
    sbi_free(&heat->body->allocator, sources);
}

static sb_result sbi_heat_no_memory(int count, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a heat source of %d entries", count);
}

/* ---- the list ---- */

SBI_API sbi_heat_source *sbi_heat_find_source(const sb_heat *heat, int id)
{
    for (int i = 0; heat && i < heat->source_count; i++)
        if (heat->sources[i].id == id)
            return heat->sources + i;
    return NULL;
}

static sb_result sbi_heat_check_value(sbi_heat_kind kind, sb_real value, sb_real surroundings, sb_error *error)
{
    if (!sb_is_finite(value) || !sb_is_finite(surroundings))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "a heat source of %g (surroundings %g) is not finite",
                        (double)value, (double)surroundings);
    if (kind == SBI_HEAT_CONVECTION && (value < 0 || surroundings <= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "convection needs a coefficient >= 0, not %g, and surroundings above 0 K, not %g",
                        (double)value, (double)surroundings);
    return SB_OK;
}

SBI_API sb_result sbi_heat_check_source(const sb_heat *heat, sbi_heat_source *source, sb_error *error)
{
    for (int k = 0; k < source->count; k++) {
        int i = source->rows[k], j = source->columns[k];
        if (i < 0 || i >= heat->node_count || j < 0 || j >= heat->node_count || !(heat->volume[i] > 0))
            return sbi_fail_node(error, SB_ERROR_INDEX, i, "node %d of a heat source is out of range, or of no element",
                                 i);
        source->at[k] = sbi_heat_find(heat, i, j);
        if (source->at[k] < 0)
            return sbi_fail_node(error, SB_ERROR_INDEX, i, "nodes %d and %d of a heat source share no element", i, j);
        if (!sb_is_finite(source->shares[k]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the share of node %d in a heat source is not finite",
                                 i);
    }
    return sbi_heat_check_value(source->kind, *source->value, *source->surroundings, error);
}

/* Room for one more. */
static int sbi_heat_reserve(sb_heat *heat)
{
    int capacity = heat->source_capacity ? 2 * heat->source_capacity : 4;
    sbi_heat_source *sources;
    if (heat->source_count < heat->source_capacity)
        return 1;
    sources = (sbi_heat_source *)sbi_alloc(&heat->body->allocator, (size_t)capacity, sizeof *sources);
    if (!sources)
        return 0;
    if (heat->source_count)
        memcpy(sources, heat->sources, (size_t)heat->source_count * sizeof *sources);
    sbi_free(&heat->body->allocator, heat->sources);
    heat->sources = sources;
    heat->source_capacity = capacity;
    return 1;
}

SBI_API sb_result sbi_heat_take_source(sb_heat *heat, sbi_heat_source *source, int *id, sb_error *error)
{
    sb_result result = sbi_heat_check_source(heat, source, error);
    if (result == SB_OK && (heat->last_id == INT32_MAX || !sbi_heat_reserve(heat)))
        result = sbi_heat_no_memory(source->count, error);
    if (result != SB_OK) {
        sbi_free(&heat->body->allocator, source->memory);
        return result;
    }
    source->id = ++heat->last_id;
    heat->sources[heat->source_count++] = *source;
    if (id)
        *id = source->id;
    sbi_heat_tell_source(heat, source);
    return SB_OK;
}

/* ---- applicators ---- */

/* Squared distance of a point from a segment (m^2). */
static double sbi_heat_distance(sb_vec3 x, sb_vec3 from, sb_vec3 to)
{
    sb_vec3 along = sb_v3_sub(to, from), way = sb_v3_sub(x, from);
    double square = (double)sb_v3_dot(along, along), t = square > 0 ? (double)sb_v3_dot(way, along) / square : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    way = sb_v3_sub(way, sb_v3_scale((sb_real)t, along));
    return (double)sb_v3_dot(way, way);
}

/* Weight of a node at the squared distance d2 where the nearest is at least: relative to that one's, so that it never
 * underflows for all; 0 where it is next to nothing. */
static double sbi_heat_bell(double d2, double least, double radius)
{
    double exponent = radius > 0 ? (d2 - least) / (2 * radius * radius) : d2 > least * (1 + 1e-9) ? 1e3 : 0;
    return exponent < 30 ? sbi_dense_exp(-exponent) : 0;
}

SB_API sb_result sb_heat_add_source(sb_heat *heat, sb_vec3 from, sb_vec3 to, sb_real radius, sb_real power, int *id,
                                    sb_error *error)
{
    double least = -1, sum = 0;
    sbi_heat_source source;
    int count = 0;
    if (!heat || radius < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_add_source needs heat and a radius >= 0");
    if (!sb_v3_is_finite(from) || !sb_v3_is_finite(to) || !sb_is_finite(radius))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the place of a heat source is not finite");
    for (int i = 0; i < heat->node_count; i++) {
        double d2 = sbi_heat_distance(heat->body->reference[i], from, to);
        if (heat->volume[i] > 0 && (least < 0 || d2 < least))
            least = d2;
    }
    for (int i = 0; i < heat->node_count; i++) {
        double d2 = sbi_heat_distance(heat->body->reference[i], from, to);
        double weight = heat->volume[i] * sbi_heat_bell(d2, least, (double)radius);
        sum += weight;
        count += weight > 0;
    }
    if (!(sum > 0 && sum <= (double)SB_REAL_MAX))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "a heat source is too far from the body");
    if (!sbi_heat_make_source(heat, SBI_HEAT_SOURCE, count, &source))
        return sbi_heat_no_memory(count, error);
    *source.value = power;
    for (int i = 0, k = 0; i < heat->node_count; i++) {
        double d2 = sbi_heat_distance(heat->body->reference[i], from, to);
        double weight = heat->volume[i] * sbi_heat_bell(d2, least, (double)radius);
        if (!(weight > 0))
            continue;
        source.rows[k] = source.columns[k] = i;
        source.shares[k++] = (sb_real)(weight / sum);
    }
    return sbi_heat_take_source(heat, &source, id, error);
}

SB_API sb_result sb_heat_add_node_source(sb_heat *heat, const int *nodes, int count, const sb_real *shares,
                                         sb_real power, int *id, sb_error *error)
{
    sbi_heat_source source;
    double sum = 0;
    if (!heat || !nodes || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_add_node_source needs heat and nodes");
    for (int k = 0; k < count; k++) {
        if (shares && !sb_is_finite(shares[k]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, nodes[k], "the share of node %d is not finite", nodes[k]);
        sum += shares ? (double)shares[k] : 1.0 / count;
    }
    if (!(fabs(sum - 1) < 1e-3))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the shares of a heat source sum up to %g, not 1", sum);
    if (!sbi_heat_make_source(heat, SBI_HEAT_SOURCE, count, &source))
        return sbi_heat_no_memory(count, error);
    *source.value = power;
    for (int k = 0; k < count; k++) {
        source.rows[k] = source.columns[k] = nodes[k];
        source.shares[k] = shares ? shares[k] : (sb_real)(1.0 / count);
    }
    return sbi_heat_take_source(heat, &source, id, error);
}

SB_API sb_result sb_heat_add_element_source(sb_heat *heat, const int *elements, int count, sb_real density, int *id,
                                            sb_error *error)
{
    const sb_domain *domain;
    sbi_heat_source source;
    if (!heat || (elements ? count < 1 : count != 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_add_element_source needs heat, and elements or none and 0");
    domain = &heat->body->domain;
    count = elements ? count : domain->cell_count;
    for (int k = 0; elements && k < count; k++)
        if (elements[k] < 0 || elements[k] >= domain->cell_count)
            return sbi_fail_element(error, SB_ERROR_INDEX, elements[k], "there is no element %d", elements[k]);
    if (count > INT32_MAX / domain->nodes_per_cell ||
        !sbi_heat_make_source(heat, SBI_HEAT_SOURCE, count * domain->nodes_per_cell, &source))
        return sbi_heat_no_memory(count, error);
    *source.value = density;
    for (int k = 0; k < count; k++) {
        int e = elements ? elements[k] : k, first = k * domain->nodes_per_cell;
        memcpy(source.rows + first, domain->cells + (size_t)e * (size_t)domain->nodes_per_cell,
               (size_t)domain->nodes_per_cell * sizeof(int));
        sbi_heat_lumps(heat->body, e, source.shares + first);
    }
    memcpy(source.columns, source.rows, (size_t)source.count * sizeof(int));
    return sbi_heat_take_source(heat, &source, id, error);
}

/* ---- faces ---- */

/* int N_a dA and int N_a N_b dA of a face at rest (m^2). */
static void sbi_heat_face(const sb_heat *heat, const sbi_body_face *face, double *load, double *gram)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int n = face->count, q = sb_element_quadrature(face->type, SB_QUADRATURE_FACE, points, weights);
    memset(load, 0, (size_t)n * sizeof *load);
    memset(gram, 0, (size_t)(n * n) * sizeof *gram);
    for (int p = 0; p < q; p++) {
        sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3];
        sb_vec3 r = sb_v3(0, 0, 0), s = sb_v3(0, 0, 0);
        double area;
        sb_element_shape(face->type, points[p], shape, gradient);
        for (int a = 0; a < n; a++) {
            sb_vec3 x = heat->body->reference[face->nodes[a]];
            r = sb_v3_madd(r, gradient[a][0], x);
            s = sb_v3_madd(s, gradient[a][1], x);
        }
        area = (double)weights[p] * (double)sb_v3_norm(sb_v3_cross(r, s));
        for (int a = 0; a < n; a++) {
            load[a] += area * (double)shape[a];
            for (int b = 0; b < n; b++)
                gram[a * n + b] += area * (double)shape[a] * (double)shape[b];
        }
    }
}

/* Entries of a face: its load by node, or its Gram matrix; of linear faces that is lumped. */
static int sbi_heat_face_entries(const sbi_body_face *face, sbi_heat_kind kind)
{
    int is_straight = sb_element_straight(face->type) == face->type;
    return kind == SBI_HEAT_SOURCE || is_straight ? face->count : face->count * face->count;
}

static void sbi_heat_put_face(const sb_heat *heat, const sbi_body_face *face, sbi_heat_source *source, int first)
{
    double load[SB_MAX_FACE_NODES], gram[SB_MAX_FACE_NODES * SB_MAX_FACE_NODES];
    int entries = sbi_heat_face_entries(face, source->kind), n = face->count, is_full = entries > n;
    sbi_heat_face(heat, face, load, gram);
    for (int k = 0; k < entries; k++) {
        source->rows[first + k] = face->nodes[is_full ? k / n : k];
        source->columns[first + k] = face->nodes[is_full ? k % n : k];
        source->shares[first + k] = (sb_real)(is_full ? gram[k] : load[k]);
    }
}

static sb_result sbi_heat_add_faces(sb_heat *heat, sbi_heat_kind kind, const int *faces, int face_count, int corners,
                                    sb_real value, sb_real surroundings, int *id, sb_error *error)
{
    size_t count = 0;
    sbi_heat_source source;
    sbi_body_face face;
    if (!heat || !faces || face_count < 1 || corners < 3 || corners > 4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "heat through faces needs faces of 3 or 4 corners");
    for (int f = 0; f < face_count; f++) {
        sb_result result = sbi_body_get_face(heat->body, faces, f, corners, &face, error);
        if (result == SB_OK && face.inner)
            result = sbi_fail_node(error, SB_ERROR_ARGUMENT, face.nodes[0],
                                   "face %d (nodes %d %d %d ...) lies between two elements", f, face.nodes[0],
                                   face.nodes[1], face.nodes[2]);
        if (result != SB_OK)
            return result;
        count += (size_t)sbi_heat_face_entries(&face, kind);
    }
    if (count > INT32_MAX || !sbi_heat_make_source(heat, kind, (int)count, &source))
        return sbi_heat_no_memory(face_count, error);
    *source.value = value;
    *source.surroundings = surroundings;
    for (int f = 0, first = 0; f < face_count; f++) {
        if (sbi_body_get_face(heat->body, faces, f, corners, &face, NULL) != SB_OK)
            continue; /* cannot be: it was found above */
        sbi_heat_put_face(heat, &face, &source, first);
        first += sbi_heat_face_entries(&face, kind);
    }
    return sbi_heat_take_source(heat, &source, id, error);
}

SB_API sb_result sb_heat_add_flux(sb_heat *heat, const int *faces, int face_count, int corners, sb_real flux, int *id,
                                  sb_error *error)
{
    return sbi_heat_add_faces(heat, SBI_HEAT_SOURCE, faces, face_count, corners, flux, 1, id, error);
}

SB_API sb_result sb_heat_add_convection(sb_heat *heat, const int *faces, int face_count, int corners,
                                        sb_real coefficient, sb_real surroundings, int *id, sb_error *error)
{
    return sbi_heat_add_faces(heat, SBI_HEAT_CONVECTION, faces, face_count, corners, coefficient, surroundings, id,
                              error);
}

/* ---- changing and reading ---- */

static sb_result sbi_heat_set(sb_heat *heat, int id, sbi_heat_kind kind, sb_real value, sb_real surroundings)
{
    sbi_heat_source *source = sbi_heat_find_source(heat, id);
    sb_real numbers[2];
    sb_result result;
    if (!heat)
        return SB_ERROR_ARGUMENT;
    if (!source || source->kind != kind)
        return SB_ERROR_INDEX;
    result = sbi_heat_check_value(kind, value, surroundings, NULL);
    if (result != SB_OK)
        return result;
    *source->value = numbers[0] = value;
    *source->surroundings = numbers[1] = surroundings;
    sbi_heat_tell(heat, SBI_HEAT_SET, id, numbers, 2);
    return SB_OK;
}

SB_API sb_result sb_heat_set_source(sb_heat *heat, int id, sb_real value)
{
    return sbi_heat_set(heat, id, SBI_HEAT_SOURCE, value, 1);
}

SB_API sb_result sb_heat_set_convection(sb_heat *heat, int id, sb_real coefficient, sb_real surroundings)
{
    return sbi_heat_set(heat, id, SBI_HEAT_CONVECTION, coefficient, surroundings);
}

SB_API sb_result sb_heat_remove(sb_heat *heat, int id)
{
    sbi_heat_source *source = sbi_heat_find_source(heat, id);
    if (!heat)
        return SB_ERROR_ARGUMENT;
    if (!source)
        return SB_ERROR_INDEX;
    sbi_free(&heat->body->allocator, source->memory);
    heat->source_count--;
    memmove(source, source + 1, (size_t)(heat->sources + heat->source_count - source) * sizeof *source);
    sbi_heat_tell(heat, SBI_HEAT_REMOVE, id, NULL, 0);
    return SB_OK;
}

SB_API sb_result sb_heat_power(const sb_heat *heat, int id, sb_real *power)
{
    const sbi_heat_source *source = sbi_heat_find_source(heat, id);
    double sum = 0;
    if (!heat || !power)
        return SB_ERROR_ARGUMENT;
    if (!source)
        return SB_ERROR_INDEX;
    for (int k = 0; k < source->count; k++)
        sum += (double)source->shares[k] *
               (source->kind == SBI_HEAT_SOURCE
                    ? 1
                    : (double)*source->surroundings - (double)heat->temperature[source->columns[k]]);
    *power = (sb_real)(sum * (double)*source->value);
    return SB_OK;
}
