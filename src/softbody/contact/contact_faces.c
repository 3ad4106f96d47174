/* contact_faces: what faces a body has, their samples, areas and places in the matrix. */
#include "contact_faces.h"

#include <string.h>

#include "../body/body_private.h"
#include "../body/live_mesh.h"
#include "../geometry/embed_search.h"

/* ---- rules of samples ---- */

/* Points of a part: of a triangle in the parts' triangle (0, 0), (1, 0), (0, 1), and of the one that fills its cell. */
static const sb_real sbi_contact_centroids[2][1][2] = {{{(sb_real)1 / 3, (sb_real)1 / 3}},
                                                       {{(sb_real)2 / 3, (sb_real)2 / 3}}};
static const sb_real sbi_contact_threes[2][3][2] = {
    {{(sb_real)1 / 6, (sb_real)1 / 6}, {(sb_real)2 / 3, (sb_real)1 / 6}, {(sb_real)1 / 6, (sb_real)2 / 3}},
    {{(sb_real)5 / 6, (sb_real)5 / 6}, {(sb_real)1 / 3, (sb_real)5 / 6}, {(sb_real)5 / 6, (sb_real)1 / 3}}};
/* (1 -+ 1 / sqrt(3)) / 2 */
static const sb_real sbi_contact_gauss[2] = {(sb_real)0.21132486540518711775, (sb_real)0.78867513459481288225};

static int sbi_contact_is_triangle(const sbi_contact_kind *kind) { return kind->corners == 3; }

/* Samples in a part. */
static int sbi_contact_points(const sbi_contact_kind *kind)
{
    return !sbi_contact_is_triangle(kind) ? 4 : kind->nodes == 3 ? 1 : 3;
}

/* Parameters of sample `sample` of n parts a side. Parts of a triangle are numbered along its rows, of which row j has
 * n - j upright ones and between them n - j - 1 others. */
static void sbi_contact_sample_point(const sbi_contact_kind *kind, int n, int sample, sb_real xi[3])
{
    int points = sbi_contact_points(kind), part = sample / points, point = sample % points, row = 0;
    const sb_real side = (sb_real)1 / (sb_real)n;
    const sb_real *at;
    xi[2] = 0;
    if (!sbi_contact_is_triangle(kind)) {
        xi[0] = 2 * side * ((sb_real)(part % n) + sbi_contact_gauss[point % 2]) - 1;
        xi[1] = 2 * side * ((sb_real)(part / n) + sbi_contact_gauss[point / 2]) - 1;
        return;
    }
    while (part >= 2 * (n - row) - 1)
        part -= 2 * (n - row++) - 1;
    at = points == 1 ? sbi_contact_centroids[part % 2][point] : sbi_contact_threes[part % 2][point];
    xi[0] = side * ((sb_real)(part / 2) + at[0]);
    xi[1] = side * ((sb_real)row + at[1]);
}

static sbi_contact_kind sbi_contact_make_kind(sb_element_type type)
{
    sbi_contact_kind kind;
    memset(&kind, 0, sizeof kind);
    kind.type = type;
    kind.nodes = sb_element_node_count(type);
    kind.corners = sb_element_corner_count(type);
    kind.least = type == SB_TRI3 ? 2 : 1;
    kind.most = type == SB_TRI3 ? SBI_CONTACT_MOST_PARTS : SBI_CONTACT_MOST_PARTS / 2;
    kind.part = type == SB_TRI3 ? (sb_real)0.5 : type == SB_TRI6 ? (sb_real)1 : (sb_real)0.85;
    return kind;
}

/* Takes the tables of a kind (measuring or for real). */
static void sbi_contact_layout_rules(sbi_contact_kind *kind, sbi_arena *arena)
{
    for (int n = kind->least; n <= kind->most; n++) {
        sbi_contact_rule *rule = &kind->rules[n];
        size_t values;
        rule->count = sbi_contact_points(kind) * n * n;
        rule->measure = (sb_real)(sbi_contact_is_triangle(kind) ? 0.5 : 4.0) / (sb_real)rule->count;
        values = (size_t)rule->count * (size_t)kind->nodes;
        rule->weights = (sb_real *)sbi_arena_take(arena, values, sizeof(sb_real));
        rule->slopes = (sb_real *)sbi_arena_take(arena, 2 * values, sizeof(sb_real));
    }
}

static void sbi_contact_fill_rule(const sbi_contact_kind *kind, int n)
{
    const sbi_contact_rule *rule = &kind->rules[n];
    sb_real *weights = rule->weights, *slopes = rule->slopes;
    for (int i = 0; i < rule->count; i++, weights += kind->nodes, slopes += 2 * kind->nodes) {
        sb_real xi[3], gradient[SB_MAX_FACE_NODES][3];
        sbi_contact_sample_point(kind, n, i, xi);
        sb_element_shape(kind->type, xi, weights, gradient);
        for (int a = 0; a < kind->nodes; a++) {
            slopes[a] = gradient[a][0];
            slopes[kind->nodes + a] = gradient[a][1];
        }
    }
}

/* Shares of a face's area, in its parameters, by the integrals of |N|. */
static void sbi_contact_fill_shares(sbi_contact_kind *kind)
{
    const sbi_contact_rule *rule = &kind->rules[kind->most];
    sb_real sum = 0;
    for (int i = 0; i < rule->count * kind->nodes; i++) {
        kind->shares[i % kind->nodes] += sb_abs(rule->weights[i]);
        sum += sb_abs(rule->weights[i]);
    }
    for (int a = 0; a < kind->nodes; a++)
        kind->shares[a] /= sum;
}

/* Kinds and rules of an element's faces. 0: no memory. */
static int sbi_contact_make_rules(sbi_contact_faces *faces, sbi_element element)
{
    sbi_arena arena = {NULL, 0, 0};
    for (int side = 0; side < sbi_element_face_count(element); side++) {
        int local[SB_MAX_FACE_NODES];
        sb_element_type type = SB_NO_ELEMENT;
        int size = sbi_element_face(element, side, local, &type);
        if (!faces->kinds[size].nodes)
            faces->kinds[size] = sbi_contact_make_kind(type);
        faces->width = sbi_max_int(faces->width, size);
    }
    for (int pass = 0; pass < 2; pass++) {
        for (int size = 1; size <= SB_MAX_FACE_NODES; size++)
            if (faces->kinds[size].nodes)
                sbi_contact_layout_rules(&faces->kinds[size], &arena);
        if (pass == 1)
            break;
        faces->rule_memory = arena.overflow ? NULL : sbi_alloc(&faces->allocator, arena.used, 1);
        if (!faces->rule_memory)
            return 0;
        arena.base = (unsigned char *)faces->rule_memory;
        arena.used = 0;
    }
    for (int size = 1; size <= SB_MAX_FACE_NODES; size++) {
        sbi_contact_kind *kind = &faces->kinds[size];
        for (int n = kind->least; n <= kind->most && kind->nodes; n++)
            sbi_contact_fill_rule(kind, n);
        if (kind->nodes > 4)
            sbi_contact_fill_shares(kind);
    }
    return 1;
}

/* ---- faces that have nothing on their other side ---- */

/* 1 when the corners run through the face the way round in which the second least follows the least: of two faces that
 * touch, one does. */
static int sbi_contact_ascends(const int *corners, int count)
{
    int least = 0;
    for (int a = 1; a < count; a++)
        if (corners[a] < corners[least])
            least = a;
    return corners[(least + 1) % count] < corners[(least + count - 1) % count];
}

static int sbi_contact_side_ascends(const sb_body *body, int cell, int side)
{
    const sb_domain *domain = &body->domain;
    const int *nodes = domain->cells + (size_t)cell * (size_t)domain->nodes_per_cell;
    int local[SB_MAX_FACE_NODES], corners[SB_MAX_FACE_NODES], count;
    sb_element_type type = SB_NO_ELEMENT;
    sbi_element_face(sbi_element_make(domain->element_type, domain->table), side, local, &type);
    count = sb_element_corner_count(type);
    for (int a = 0; a < count; a++)
        corners[a] = nodes[local[a]];
    return sbi_contact_ascends(corners, count);
}

/* outer[cell * sides + side] = 1 for the boundary: where all cells with these corners lie on one side, as those of an
 * immersed grid that share all their nodes do, the first of them. Returns how many, -1: no memory. */
static int sbi_contact_find_outer(const sb_body *body, const sb_allocator *allocator, unsigned char *outer,
                                  unsigned char *skip)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    sbi_mesh_keys keys;
    int count = 0;
    for (int e = 0; e < mesh.element_count; e++)
        skip[e] = !sb_body_cell_in_use(body, e);
    if (!sbi_mesh_keys_make(&mesh, SBI_MESH_SIDES, skip, allocator, &keys))
        return -1;
    memset(outer, 0, (size_t)keys.count);
    for (int begin = 0, end; begin < keys.sorted; begin = end) {
        int first = keys.order[begin], lone = 1, per = keys.per_element;
        end = sbi_mesh_run_end(&keys, begin);
        for (int i = begin + 1; i < end && lone; i++)
            lone = sbi_contact_side_ascends(body, keys.order[i] / per, keys.order[i] % per) ==
                   sbi_contact_side_ascends(body, first / per, first % per);
        outer[first] = (unsigned char)lone;
        count += lone;
    }
    sbi_mesh_keys_free(allocator, &keys);
    return count;
}

/* ---- a face ---- */

/* |x_r cross x_s| at a sample. */
static sb_real sbi_contact_stretch(const sb_real *slopes, const sb_vec3 *x, int nodes)
{
    sb_vec3 r = sb_v3(0, 0, 0), s = sb_v3(0, 0, 0);
    for (int a = 0; a < nodes; a++) {
        r = sb_v3_madd(r, slopes[a], x[a]);
        s = sb_v3_madd(s, slopes[nodes + a], x[a]);
    }
    return sb_v3_norm(sb_v3_cross(r, s));
}

static void sbi_contact_gather(const sbi_contact_faces *faces, const sb_body *body, int face, sb_vec3 *x)
{
    for (int a = 0; a < faces->sizes[face]; a++)
        x[a] = body->reference[sbi_contact_face_nodes(faces, face)[a]];
}

/* Edges through their middle nodes; of quads also the diagonals of a square with such edges. */
static sb_real sbi_contact_length(const sbi_contact_kind *kind, const sb_vec3 *x)
{
    const sb_real square = sb_sqrt((sb_real)0.5);
    sb_real longest = 0;
    for (int a = 0; a < kind->corners; a++) {
        sb_vec3 from = x[a], to = x[(a + 1) % kind->corners];
        sb_vec3 middle = kind->nodes > kind->corners ? x[kind->corners + a] : to;
        longest = sb_max(longest, sb_v3_norm(sb_v3_sub(middle, from)) + sb_v3_norm(sb_v3_sub(to, middle)));
    }
    for (int a = 0; a < 2 && kind->corners == 4; a++)
        longest = sb_max(longest, square * sb_v3_norm(sb_v3_sub(x[a + 2], x[a])));
    return longest;
}

/* Two parts a side: enough for the areas of faces and nodes of straight faces to be exact. */
enum { SBI_CONTACT_AREA_PARTS = 2 };

/* Area of a face and, added to them, those of its nodes; all 0 where it is so flat that its normal is rounding. */
static void sbi_contact_measure(sbi_contact_faces *faces, const sb_body *body, int face)
{
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    const sbi_contact_rule *rule = &kind->rules[SBI_CONTACT_AREA_PARTS];
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sb_vec3 x[SB_MAX_FACE_NODES];
    sb_real area = 0, of_nodes[SB_MAX_FACE_NODES] = {0}, length;
    sbi_contact_gather(faces, body, face, x);
    faces->lengths[face] = length = sbi_contact_length(kind, x);
    for (int i = 0; i < rule->count; i++) {
        const sb_real *weights = rule->weights + i * kind->nodes;
        sb_real part = rule->measure * sbi_contact_stretch(rule->slopes + 2 * i * kind->nodes, x, kind->nodes);
        area += part;
        for (int a = 0; a < kind->nodes; a++)
            of_nodes[a] += part * weights[a];
    }
    faces->areas[face] = area > 16 * SB_EPSILON * length * length ? area : 0;
    faces->flat_count += faces->areas[face] == 0;
    for (int a = 0; a < kind->nodes && faces->areas[face] > 0; a++)
        faces->node_areas[nodes[a]] += kind->nodes > 4 ? area * kind->shares[a] : of_nodes[a];
}

static void sbi_contact_put_face(sbi_contact_faces *faces, const sb_body *body, int face, int cell, int side)
{
    const sb_domain *domain = &body->domain;
    const int *corners = domain->cells + (size_t)cell * (size_t)domain->nodes_per_cell;
    int local[SB_MAX_FACE_NODES], *nodes = faces->nodes + (size_t)face * (size_t)faces->width;
    int size = sbi_element_face(sbi_element_make(domain->element_type, domain->table), side, local, NULL);
    for (int a = 0; a < size; a++)
        nodes[a] = corners[local[a]];
    faces->sizes[face] = (unsigned char)size;
    faces->sides[face] = (unsigned char)side;
    faces->elements[face] = cell;
    faces->regions[face] = body->cell_material[cell];
    faces->versions[face] = -1;
    faces->face_count++;
}

/* ---- creation ---- */

/* Takes the arrays by face and by node (measuring or for real). */
static void sbi_contact_layout(sbi_contact_faces *faces, sbi_arena *arena)
{
    size_t room = (size_t)faces->face_room, width = (size_t)faces->width;
    faces->areas = (sb_real *)sbi_arena_take(arena, room, sizeof(sb_real));
    faces->lengths = (sb_real *)sbi_arena_take(arena, room, sizeof(sb_real));
    faces->node_areas = (sb_real *)sbi_arena_take(arena, (size_t)faces->node_room, sizeof(sb_real));
    faces->nodes = (int *)sbi_arena_take(arena, room, width * sizeof(int));
    faces->blocks = (int *)sbi_arena_take(arena, room, width * width * sizeof(int));
    faces->elements = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->regions = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->versions = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->sizes = (unsigned char *)sbi_arena_take(arena, room, 1);
    faces->sides = (unsigned char *)sbi_arena_take(arena, room, 1);
    faces->marks = (uint64_t *)sbi_arena_take(arena, (size_t)sbi_face_tree_words(faces->face_room), sizeof(uint64_t));
}

static int sbi_contact_take_arrays(sbi_contact_faces *faces)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_contact_layout(faces, &arena);
    faces->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&faces->allocator, arena.used, 1);
    if (!faces->memory)
        return 0;
    arena.base = (unsigned char *)faces->memory;
    arena.used = 0;
    sbi_contact_layout(faces, &arena);
    return 1;
}

static sb_result sbi_contact_no_memory(int faces, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for contact on %d faces", faces);
}

/* Scratch for the tree's order. */
typedef struct sbi_contact_order {
    sb_vec3 *centres;  /* [faces] */
    uint32_t *scratch; /* [faces][3] */
    int *faces, *order;
} sbi_contact_order;

static void sbi_contact_layout_order(int count, sbi_contact_order *order, sbi_arena *arena)
{
    order->centres = (sb_vec3 *)sbi_arena_take(arena, (size_t)count, sizeof(sb_vec3));
    order->scratch = (uint32_t *)sbi_arena_take(arena, (size_t)count, 3 * sizeof(uint32_t));
    order->faces = (int *)sbi_arena_take(arena, (size_t)count, sizeof(int));
    order->order = (int *)sbi_arena_take(arena, (size_t)count, sizeof(int));
}

/* Puts the faces with area into the tree, along Morton's curve through their corners' centres at rest. */
static void sbi_contact_build_tree(sbi_contact_faces *faces, const sb_body *body, const sbi_contact_order *order)
{
    sbi_face_tree_source source;
    int count = 0;
    for (int f = 0; f < faces->face_end; f++) {
        const int *nodes = sbi_contact_face_nodes(faces, f);
        sb_vec3 sum = sb_v3(0, 0, 0);
        int corners = faces->kinds[faces->sizes[f]].corners;
        if (!(faces->areas[f] > 0))
            continue;
        for (int a = 0; a < corners; a++)
            sum = sb_v3_add(sum, body->reference[nodes[a]]);
        order->centres[count] = sb_v3_scale((sb_real)1 / (sb_real)corners, sum);
        order->faces[count++] = f;
    }
    sbi_embed_sort(order->centres, count, order->order, order->scratch);
    for (int i = 0; i < count; i++)
        order->order[i] = order->faces[order->order[i]];
    source.count = count;
    source.faces = order->order;
    source.nodes = faces->nodes;
    source.sizes = faces->sizes;
    sbi_face_tree_build(&faces->tree, &source);
}

/* How many nodes have faces; uses `scratch` [node_count]. */
static int sbi_contact_count_nodes(const sbi_contact_faces *faces, unsigned char *scratch)
{
    int count = 0;
    memset(scratch, 0, (size_t)faces->node_room);
    for (int f = 0; f < faces->face_end; f++)
        for (int a = 0; a < faces->sizes[f]; a++) {
            unsigned char *seen = scratch + sbi_contact_face_nodes(faces, f)[a];
            count += !*seen;
            *seen = 1;
        }
    return count;
}

static sb_result sbi_contact_make_tree(sbi_contact_faces *faces, const sb_body *body, unsigned char *scratch,
                                       sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_contact_order order;
    sbi_face_tree_room room;
    room.faces = faces->face_count;
    room.nodes = sbi_contact_count_nodes(faces, scratch);
    room.node_end = faces->node_room;
    room.width = faces->width;
    sbi_contact_layout_order(faces->face_count, &order, &arena);
    arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(&faces->allocator, arena.used, 1);
    if (!arena.base || !sbi_face_tree_create(&room, &faces->allocator, &faces->tree)) {
        sbi_free(&faces->allocator, arena.base);
        return sbi_contact_no_memory(faces->face_count, error);
    }
    arena.used = 0;
    sbi_contact_layout_order(faces->face_count, &order, &arena);
    sbi_contact_build_tree(faces, body, &order);
    sbi_free(&faces->allocator, arena.base);
    return SB_OK;
}

/* Arrays, faces in the order of cells and sides, and the tree; outer: what sbi_contact_find_outer found. */
static sb_result sbi_contact_take_faces(sbi_contact_faces *faces, const sb_body *body, const unsigned char *outer,
                                        unsigned char *scratch, sb_error *error)
{
    int sides = sbi_element_face_count(sbi_element_make(body->domain.element_type, body->domain.table));
    if (!sbi_contact_take_arrays(faces))
        return sbi_contact_no_memory(faces->face_room, error);
    for (int p = 0; p < body->domain.cell_count * sides; p++)
        if (outer[p])
            sbi_contact_put_face(faces, body, faces->face_end++, p / sides, p % sides);
    for (int f = 0; f < faces->face_end; f++)
        sbi_contact_measure(faces, body, f);
    if (faces->flat_count == faces->face_count)
        return sbi_fail(error, SB_ERROR_MESH,
                        "no face of the body's surface has an area: contact has nothing to act on");
    return sbi_contact_make_tree(faces, body, scratch, error);
}

static sb_result sbi_contact_fill(sbi_contact_faces *faces, const sb_body *body, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sbi_element element = sbi_element_make(domain->element_type, domain->table);
    size_t sides = (size_t)domain->cell_count * (size_t)sbi_element_face_count(element);
    unsigned char *outer = (unsigned char *)sbi_alloc(&faces->allocator, sides, 1);
    unsigned char *scratch =
        (unsigned char *)sbi_alloc(&faces->allocator, (size_t)sbi_max_int(domain->cell_count, domain->node_count), 1);
    sb_result result = SB_ERROR_MEMORY;
    faces->node_room = domain->node_count;
    faces->face_room = outer && scratch ? sbi_contact_find_outer(body, &faces->allocator, outer, scratch) : -1;
    if (faces->face_room < 0 || !sbi_contact_make_rules(faces, element))
        result =
            sbi_fail(error, SB_ERROR_MEMORY, "no memory for the faces of a body of %d elements", domain->cell_count);
    else
        result = sbi_contact_take_faces(faces, body, outer, scratch, error);
    sbi_free(&faces->allocator, outer);
    sbi_free(&faces->allocator, scratch);
    return result;
}

SBI_API sb_result sbi_contact_faces_create(const sb_body *body, const sb_allocator *allocator,
                                           sbi_contact_faces **faces, sb_error *error)
{
    sbi_contact_faces *made = (sbi_contact_faces *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    sb_result result;
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the faces of a body");
    if (allocator)
        made->allocator = *allocator;
    result = sbi_contact_fill(made, body, error);
    if (result != SB_OK) {
        sbi_contact_faces_destroy(made);
        return result;
    }
    sbi_contact_faces_refit(made, body->position, NULL, 0);
    *faces = made;
    return SB_OK;
}

SBI_API void sbi_contact_faces_destroy(sbi_contact_faces *faces)
{
    sb_allocator allocator;
    if (!faces)
        return;
    allocator = faces->allocator;
    sbi_face_tree_free(&faces->tree, &allocator);
    sbi_free(&allocator, faces->rule_memory);
    sbi_free(&allocator, faces->memory);
    sbi_free(&allocator, faces);
}

/* ---- boxes ---- */

SBI_API void sbi_contact_faces_refit(sbi_contact_faces *faces, const sb_vec3 *x, const sb_vec3 *v, sb_real dt)
{
    sbi_face_tree_refit(&faces->tree, x, v, dt);
}

SBI_API int sbi_contact_faces_query(sbi_contact_faces *faces, sb_vec3 low, sb_vec3 high, int *found, int capacity)
{
    return sbi_face_tree_query(&faces->tree, low, high, faces->marks, found, capacity);
}

/* ---- samples and blocks ---- */

SBI_API int sbi_contact_face_parts(const sbi_contact_faces *faces, int face, sb_real radius)
{
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    sb_real parts = faces->lengths[face] / (kind->part * radius);
    int n = kind->least;
    while (n < kind->most && (sb_real)n < parts)
        n++;
    return n;
}

SBI_API sb_real sbi_contact_faces_thinnest(const sbi_contact_faces *faces, int *face)
{
    sb_real radius = 0;
    for (int f = 0; f < faces->face_end; f++) {
        const sbi_contact_kind *kind = &faces->kinds[faces->sizes[f]];
        sb_real needed = faces->areas[f] > 0 ? faces->lengths[f] / (kind->part * (sb_real)kind->most) : 0;
        if (needed > radius) {
            radius = needed;
            if (face)
                *face = f;
        }
    }
    return radius;
}

SBI_API sb_real sbi_contact_sample_area(const sbi_contact_faces *faces, const sb_body *body, int face, int parts,
                                        int sample)
{
    int nodes = faces->sizes[face];
    const sbi_contact_rule *rule = &faces->kinds[nodes].rules[parts];
    sb_vec3 x[SB_MAX_FACE_NODES];
    if (nodes == 3)
        return faces->areas[face] / (sb_real)rule->count;
    sbi_contact_gather(faces, body, face, x);
    return rule->measure * sbi_contact_stretch(rule->slopes + 2 * sample * nodes, x, nodes);
}

SBI_API const int *sbi_contact_face_blocks(sbi_contact_faces *faces, const sb_body *body, int face)
{
    const int *nodes = sbi_contact_face_nodes(faces, face);
    int size = faces->sizes[face], *blocks = faces->blocks + (size_t)face * (size_t)(faces->width * faces->width);
    if (faces->versions[face] == body->pattern_version)
        return blocks;
    for (int a = 0; a < size; a++)
        for (int b = 0; b < size; b++)
            blocks[a * size + b] = sb_matrix_find(&body->matrix, nodes[a], nodes[b]);
    faces->versions[face] = body->pattern_version;
    return blocks;
}
