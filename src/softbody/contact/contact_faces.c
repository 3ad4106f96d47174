/* contact_faces: what faces a body has, their areas, boxes and places in the matrix. */
#include "contact_faces.h"

#include <string.h>

#include "../body/body_private.h"
#include "../body/live_private.h"
#include "../geometry/embed_search.h"

/* ---- faces that have nothing on their other side ---- */

SBI_API const int *sbi_contact_cell_nodes(const sb_body *body, int cell)
{
    return body->domain.cells + (size_t)cell * (size_t)body->domain.nodes_per_cell;
}

SBI_API int sbi_contact_side_ascends(const sbi_contact_side *side, const int *nodes)
{
    int least = 0, count = side->corners;
    for (int a = 1; a < count; a++)
        if (nodes[side->local[a]] < nodes[side->local[least]])
            least = a;
    return nodes[side->local[(least + 1) % count]] < nodes[side->local[(least + count - 1) % count]];
}

/* 1 when parts order[begin] .. order[end - 1] with the same corners lie on one side of them. */
static int sbi_contact_is_outer(const sbi_contact_faces *faces, const sb_body *body, const sbi_mesh_keys *keys,
                                int begin, int end)
{
    int ascends[2] = {0, 0};
    for (int i = begin; i < end; i++) {
        int part = keys->order[i];
        ascends[sbi_contact_side_ascends(&faces->element_sides[part % keys->per_element],
                                         sbi_contact_cell_nodes(body, part / keys->per_element))]++;
    }
    return !ascends[0] || !ascends[1];
}

/* outer[cell * sides + side] = 1 for the boundary: where all cells with these corners lie on one side, as those of an
 * immersed grid that share all their nodes do, the first of them. Returns how many, -1: no memory. skip: [cells]
 * scratch. */
static int sbi_contact_find_outer(const sbi_contact_faces *faces, const sb_body *body, unsigned char *outer,
                                  unsigned char *skip)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    sbi_mesh_keys keys;
    int count = 0;
    for (int e = 0; e < mesh.element_count; e++)
        skip[e] = !sbi_live_has_cell(body, e);
    if (!sbi_mesh_keys_make(&mesh, SBI_MESH_SIDES, skip, &faces->allocator, &keys))
        return -1;
    memset(outer, 0, (size_t)keys.count);
    for (int begin = 0, end; begin < keys.sorted; begin = end) {
        int lone;
        end = sbi_mesh_run_end(&keys, begin);
        lone = sbi_contact_is_outer(faces, body, &keys, begin, end);
        outer[keys.order[begin]] = (unsigned char)lone;
        count += lone;
    }
    sbi_mesh_keys_free(&faces->allocator, &keys);
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
    const sb_vec3 *rest = faces->is_skin ? faces->points : body->reference;
    for (int a = 0; a < faces->sizes[face]; a++)
        x[a] = rest[sbi_contact_face_nodes(faces, face)[a]];
}

/* Edges through their middle nodes; of quads also the diagonals of a square with such edges. */
static sb_real sbi_contact_length(const sbi_contact_kind *kind, const sb_vec3 *x)
{
    const sb_real square = sb_sqrt((sb_real)0.5);
    sb_real longest = 0;
    for (int a = 0; a < kind->corners; a++) {
        sb_vec3 from = x[a], to = x[(a + 1) % kind->corners];
        sb_real edge;
        if (kind->nodes == kind->corners)
            edge = sb_v3_norm(sb_v3_sub(to, from));
        else
            edge = sb_v3_norm(sb_v3_sub(x[kind->corners + a], from)) + sb_v3_norm(sb_v3_sub(to, x[kind->corners + a]));
        longest = sb_max(longest, edge);
    }
    for (int a = 0; a < 2 && kind->corners == 4; a++)
        longest = sb_max(longest, square * sb_v3_norm(sb_v3_sub(x[a + 2], x[a])));
    return longest;
}

/* Two parts a side: enough for the areas of faces and nodes of straight faces to be exact. */
enum { SBI_CONTACT_AREA_PARTS = 2 };

/* Area of a face, and what of it is each node's. */
static sb_real sbi_contact_face_area(const sbi_contact_kind *kind, const sb_vec3 *x, sb_real *of_nodes)
{
    const sbi_contact_rule *rule = &kind->rules[SBI_CONTACT_AREA_PARTS];
    sb_real area = 0;
    for (int a = 0; a < kind->nodes; a++)
        of_nodes[a] = 0;
    if (kind->nodes == 3) {
        area = sb_v3_norm(sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]))) / 2;
        of_nodes[0] = of_nodes[1] = of_nodes[2] = area / 3;
        return area;
    }
    for (int i = 0; i < rule->count; i++) {
        const sb_real *weights = rule->weights + i * kind->nodes;
        sb_real part = rule->measure * sbi_contact_stretch(rule->slopes + 2 * i * kind->nodes, x, kind->nodes);
        area += part;
        for (int a = 0; a < kind->nodes; a++)
            of_nodes[a] += part * weights[a];
    }
    for (int a = 0; a < kind->nodes && kind->nodes > 4; a++)
        of_nodes[a] = area * kind->shares[a];
    return area;
}

/* Measures a face and adds to the areas of its nodes, unless it is so flat that its normal is rounding. */
static void sbi_contact_measure(sbi_contact_faces *faces, const sb_body *body, int face)
{
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sb_vec3 x[SB_MAX_FACE_NODES];
    sb_real of_nodes[SB_MAX_FACE_NODES], length, area;
    sbi_contact_gather(faces, body, face, x);
    length = sbi_contact_length(kind, x);
    area = sbi_contact_face_area(kind, x, of_nodes);
    faces->lengths[face] = length;
    faces->areas[face] = area > 16 * SB_EPSILON * length * length ? area : 0;
    faces->flat_count += faces->areas[face] == 0;
    for (int a = 0; a < kind->nodes && faces->areas[face] > 0; a++)
        faces->node_areas[nodes[a]] += of_nodes[a];
}

static void sbi_contact_put_face(sbi_contact_faces *faces, const sb_body *body, int cell, int side)
{
    const int *corners = sbi_contact_cell_nodes(body, cell), face = faces->face_end++;
    int *nodes = faces->nodes + (size_t)face * (size_t)faces->width;
    for (int a = 0; a < faces->element_sides[side].nodes; a++)
        nodes[a] = corners[faces->element_sides[side].local[a]];
    faces->sizes[face] = (unsigned char)faces->element_sides[side].nodes;
    faces->sides[face] = (unsigned char)side;
    faces->keys[face] = cell * faces->side_count + side;
    faces->elements[face] = cell;
    faces->regions[face] = body->cell_material[cell];
    faces->versions[face] = -1;
    sbi_contact_measure(faces, body, face);
}

/* ---- memory ---- */

/* Scratch for the tree's order. */
static void sbi_contact_layout_order(int count, sbi_contact_order *order, sbi_arena *arena)
{
    order->centres = (sb_vec3 *)sbi_arena_take(arena, (size_t)count, sizeof(sb_vec3));
    order->scratch = (uint32_t *)sbi_arena_take(arena, (size_t)count, 3 * sizeof(uint32_t));
    order->faces = (int *)sbi_arena_take(arena, (size_t)count, sizeof(int));
    order->order = (int *)sbi_arena_take(arena, (size_t)count, sizeof(int));
}

/* Takes the arrays (measuring or for real). */
static void sbi_contact_layout(sbi_contact_faces *faces, sbi_arena *arena)
{
    size_t room = (size_t)faces->face_room, width = (size_t)faces->width, nodes = (size_t)faces->node_room;
    sbi_contact_live *live = &faces->live;
    faces->areas = (sb_real *)sbi_arena_take(arena, room, sizeof(sb_real));
    faces->lengths = (sb_real *)sbi_arena_take(arena, room, sizeof(sb_real));
    faces->node_areas = (sb_real *)sbi_arena_take(arena, nodes, sizeof(sb_real));
    faces->marks = (uint64_t *)sbi_arena_take(arena, (size_t)sbi_face_tree_words(faces->face_room), sizeof(uint64_t));
    faces->nodes = (int *)sbi_arena_take(arena, room, width * sizeof(int));
    faces->blocks = (int *)sbi_arena_take(arena, room, width * width * sizeof(int));
    faces->keys = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->elements = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->regions = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->versions = (int *)sbi_arena_take(arena, room, sizeof(int));
    faces->sizes = (unsigned char *)sbi_arena_take(arena, room, 1);
    faces->sides = (unsigned char *)sbi_arena_take(arena, room, 1);
    if (!live->cell_room && !faces->is_skin)
        return;
    sbi_contact_layout_order(faces->face_room, &live->order, arena);
    if (faces->is_skin)
        return;
    live->seen = (int *)sbi_arena_take(arena, room, sizeof(int));
    live->moved = (int *)sbi_arena_take(arena, room, sizeof(int));
    live->outer = (unsigned char *)sbi_arena_take(arena, (size_t)live->cell_room, (size_t)faces->side_count);
    live->gone = (unsigned char *)sbi_arena_take(arena, (size_t)live->cell_room, 1);
    live->near = (unsigned char *)sbi_arena_take(arena, nodes, 1);
}

SBI_API int sbi_contact_take_arrays(sbi_contact_faces *faces)
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

SBI_API int sbi_contact_take_tree(sbi_contact_faces *faces, int nodes)
{
    sbi_face_tree_room room;
    room.faces = faces->face_room;
    room.nodes = nodes;
    room.node_end = faces->node_room;
    room.width = faces->width;
    return sbi_face_tree_create(&room, &faces->allocator, &faces->tree);
}

/* ---- all faces ---- */

SBI_API void sbi_contact_put_faces(sbi_contact_faces *faces, const sb_body *body, const unsigned char *outer)
{
    memset(faces->node_areas, 0, (size_t)faces->node_room * sizeof(sb_real));
    faces->face_end = faces->flat_count = 0;
    for (int e = 0, p = 0; e < body->domain.cell_count; e++)
        for (int side = 0; side < faces->side_count; side++, p++)
            if (outer[p])
                sbi_contact_put_face(faces, body, e, side);
}

SBI_API void sbi_contact_build_tree(sbi_contact_faces *faces, const sb_body *body, const sbi_contact_order *order)
{
    const sb_vec3 *rest = faces->is_skin ? faces->points : body->reference;
    sbi_face_tree_source source;
    int count = 0;
    for (int f = 0; f < faces->face_end; f++) {
        const int *nodes = sbi_contact_face_nodes(faces, f);
        sb_vec3 sum = sb_v3(0, 0, 0);
        int corners = faces->kinds[faces->sizes[f]].corners;
        if (!(faces->areas[f] > 0))
            continue;
        for (int a = 0; a < corners; a++)
            sum = sb_v3_add(sum, rest[nodes[a]]);
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

/* How many nodes have faces; seen: [node_room] scratch. */
static int sbi_contact_count_nodes(const sbi_contact_faces *faces, unsigned char *seen)
{
    int count = 0;
    memset(seen, 0, (size_t)faces->node_room);
    for (int f = 0; f < faces->face_end; f++)
        for (int a = 0; a < faces->sizes[f]; a++) {
            int node = sbi_contact_face_nodes(faces, f)[a];
            count += !seen[node];
            seen[node] = 1;
        }
    return count;
}

SBI_API int sbi_contact_most_nodes(const sbi_contact_faces *faces)
{
    int most = faces->node_room / faces->width;
    return faces->face_room <= most ? faces->face_room * faces->width : faces->node_room;
}

/* ---- creation ---- */

/* The tree of a body whose mesh stays as it is: no larger than it needs to be. 0: no memory. */
static int sbi_contact_make_fixed_tree(sbi_contact_faces *faces, const sb_body *body, unsigned char *scratch)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_contact_order order;
    int ok;
    sbi_contact_layout_order(faces->face_end, &order, &arena);
    arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(&faces->allocator, arena.used, 1);
    arena.used = 0;
    ok = arena.base && sbi_contact_take_tree(faces, sbi_contact_count_nodes(faces, scratch));
    if (ok) {
        sbi_contact_layout_order(faces->face_end, &order, &arena);
        sbi_contact_build_tree(faces, body, &order);
    }
    sbi_free(&faces->allocator, arena.base);
    return ok;
}

/* The same of one that may change. */
static int sbi_contact_make_live_tree(sbi_contact_faces *faces, const sb_body *body)
{
    if (!sbi_contact_take_tree(faces, sbi_contact_most_nodes(faces)))
        return 0;
    sbi_contact_build_tree(faces, body, &faces->live.order);
    return 1;
}

static sb_result sbi_contact_no_memory(const sb_body *body, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the faces of a body of %d elements",
                    body->domain.cell_count);
}

/* Arrays, faces and tree from what is outside; scratch: [nodes]. */
static sb_result sbi_contact_take_faces(sbi_contact_faces *faces, const sb_body *body, const unsigned char *outer,
                                        unsigned char *scratch, sb_error *error)
{
    sbi_contact_live *live = &faces->live;
    int ok = sbi_contact_take_arrays(faces);
    if (ok)
        sbi_contact_put_faces(faces, body, outer);
    if (ok && faces->flat_count == faces->face_end)
        return sbi_fail(error, SB_ERROR_MESH, "no face of the body's surface has an area: contact has none to act on");
    if (ok && live->cell_room) {
        memcpy(live->outer, outer, (size_t)body->domain.cell_count * (size_t)faces->side_count);
        memcpy(live->seen, faces->keys, (size_t)faces->face_end * sizeof(int));
        live->outer_count = live->seen_count = faces->face_end;
    }
    ok = ok && (live->cell_room ? sbi_contact_make_live_tree(faces, body)
                                : sbi_contact_make_fixed_tree(faces, body, scratch));
    return ok ? SB_OK : sbi_contact_no_memory(body, error);
}

/* Rooms for a body with so many faces. */
static void sbi_contact_set_rooms(sbi_contact_faces *faces, const sb_body *body, int count)
{
    faces->face_room = count;
    faces->node_room = body->domain.node_count;
    if (!body->live)
        return;
    faces->face_room = count < INT32_MAX / 2 ? count + count / 2 + 1 : count;
    faces->node_room = body->node_capacity;
    faces->live.cell_room = sbi_live_cell_room(body);
}

SBI_API sb_result sbi_contact_fill(sbi_contact_faces *faces, const sb_body *body, sb_error *error)
{
    int cells = body->domain.cell_count, count = -1;
    unsigned char *outer = (unsigned char *)sbi_alloc(&faces->allocator, (size_t)cells, (size_t)faces->side_count);
    unsigned char *scratch =
        (unsigned char *)sbi_alloc(&faces->allocator, (size_t)sbi_max_int(cells, body->node_capacity), 1);
    sb_result result;
    if (outer && scratch)
        count = sbi_contact_find_outer(faces, body, outer, scratch);
    if (count >= 0) {
        sbi_contact_set_rooms(faces, body, count);
        result = sbi_contact_take_faces(faces, body, outer, scratch, error);
    } else {
        result = sbi_contact_no_memory(body, error);
    }
    sbi_free(&faces->allocator, outer);
    sbi_free(&faces->allocator, scratch);
    return result;
}

SBI_API void sbi_contact_release_arrays(sbi_contact_faces *faces)
{
    sbi_face_tree_free(&faces->tree, &faces->allocator);
    sbi_free(&faces->allocator, faces->memory);
    faces->memory = NULL;
}

SBI_API sb_result sbi_contact_faces_create(const sb_body *body, const sb_allocator *allocator,
                                           sbi_contact_faces **faces, sb_error *error)
{
    sbi_contact_faces *made = (sbi_contact_faces *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    sb_result result;
    if (!made)
        return sbi_contact_no_memory(body, error);
    if (allocator)
        made->allocator = *allocator;
    made->region_count = body->material_count;
    if (sbi_contact_make_rules(made, sbi_element_make(body->domain.element_type, body->domain.table)))
        result = sbi_contact_fill(made, body, error);
    else
        result = sbi_contact_no_memory(body, error);
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
    sbi_contact_release_arrays(faces);
    sbi_free(&allocator, faces->rule_memory);
    sbi_free(&allocator, faces);
}

/* ---- of a skin ---- */

SBI_API sb_result sbi_contact_faces_create_skin(const sb_body *body, const sb_allocator *allocator, int face_room,
                                                int point_room, sbi_contact_faces **faces, sb_error *error)
{
    sbi_contact_faces *made = (sbi_contact_faces *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    int ok;
    if (!made)
        return sbi_contact_no_memory(body, error);
    if (allocator)
        made->allocator = *allocator;
    made->is_skin = 1;
    made->region_count = body->material_count;
    made->face_room = face_room;
    made->node_room = point_room;
    ok = sbi_contact_make_rules(made, sbi_element_make(SB_TET4, NULL)); /* its faces are triangles, too */
    made->side_count = 1;
    ok = ok && sbi_contact_take_arrays(made) && sbi_contact_take_tree(made, sbi_contact_most_nodes(made));
    if (!ok) {
        sbi_contact_faces_destroy(made);
        return sbi_contact_no_memory(body, error);
    }
    *faces = made;
    return SB_OK;
}

/* 0: all of the body was taken out (sb_cut_ablate), and its surface with it. */
static int sbi_contact_has_material(const sb_body *body)
{
    int has = 0;
    for (int i = 0; i < body->domain.node_count && !has; i++)
        has = body->node_component[i] >= 0;
    return has;
}

SBI_API sb_result sbi_contact_faces_fill_skin(sbi_contact_faces *faces, const sb_body *body, const int (*triangles)[3],
                                              int count, const int *cells, const sb_vec3 *points, sb_error *error)
{
    faces->points = points;
    memset(faces->node_areas, 0, (size_t)faces->node_room * sizeof(sb_real));
    faces->face_end = count;
    faces->flat_count = 0;
    for (int f = 0; f < count; f++) {
        int cell = sbi_max_int(cells[triangles[f][0]], 0); /* of what is no triangle: any */
        memcpy(faces->nodes + (size_t)f * (size_t)faces->width, triangles[f], sizeof triangles[f]);
        faces->sizes[f] = 3;
        faces->sides[f] = 0;
        faces->keys[f] = f;
        faces->elements[f] = cell;
        faces->regions[f] = body->cell_material[cell];
        faces->versions[f] = -1;
        sbi_contact_measure(faces, body, f);
    }
    if (faces->flat_count == count && sbi_contact_has_material(body))
        return sbi_fail(error, SB_ERROR_MESH, "no triangle of the skin has an area: contact has none to act on");
    sbi_contact_build_tree(faces, body, &faces->live.order);
    return SB_OK;
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

static int sbi_contact_parts(const sbi_contact_kind *kind, sb_real length, sb_real radius)
{
    sb_real parts = length / (kind->part * radius);
    int n = kind->least;
    while (n < kind->most && (sb_real)n < parts)
        n++;
    return n;
}

SBI_API int sbi_contact_face_parts(const sbi_contact_faces *faces, int face, sb_real radius)
{
    return sbi_contact_parts(&faces->kinds[faces->sizes[face]], faces->lengths[face], radius);
}

SBI_API int sbi_contact_stretched_parts(const sbi_contact_faces *faces, int face, const sb_vec3 *x, sb_real radius)
{
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    return sbi_contact_parts(kind, sb_max(faces->lengths[face], sbi_contact_length(kind, x)), radius);
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
