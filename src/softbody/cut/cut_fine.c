/* cut_fine: a fine skin of the user's own: where it is, which of its edges are cut, and what its triangles fall into.
 */
#include "cut_fine.h"

#include <string.h>

#include "../base/bytes.h"
#include "../geometry/embed_search.h"
#include "cut_fine_private.h"

/* ---- which side of a cut a point is on ---- */

/* Pieces of an element, kept while the same one is asked about. */
typedef struct sbi_fine_pieces {
    int tet; /* -1: none yet */
    int cells[SBI_LATTICE_POINTS];
    sbi_parted parted;
} sbi_fine_pieces;

static void sbi_fine_load_pieces(const sb_cut *cut, int tet, sbi_fine_pieces *pieces)
{
    int count = 0;
    if (pieces->tet == tet)
        return;
    pieces->tet = tet;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &pieces->parted);
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
        pieces->cells[count++] = cut->pieces[piece].cell;
}

/* The cell that has the material there, -1: it was taken out. Points outside of the element count as the nearest ones
 * on its faces, more or less. */
static int sbi_fine_cell_at(const sb_cut *cut, int tet, const sb_real at[4], sbi_fine_pieces *pieces)
{
    sb_real inside[4], sum = 0;
    int piece;
    if (sbi_cut_is_whole(cut, tet))
        return cut->pieces[tet].cell;
    sbi_fine_load_pieces(cut, tet, pieces);
    for (int a = 0; a < 4; a++)
        sum += inside[a] = sb_max(at[a], 0);
    for (int a = 0; a < 4; a++)
        inside[a] /= sum;
    piece = sbi_parted_owner_at(&pieces->parted, inside);
    return piece == SBI_PARTED_LOST ? -1 : pieces->cells[piece];
}

static sb_real sbi_fine_find_in(const sb_cut *cut, int tet, sb_vec3 rest, sb_real at[4])
{
    sb_vec3 x[4];
    for (int a = 0; a < 4; a++)
        x[a] = cut->body->reference[cut->tets[4 * (size_t)tet + (size_t)a]];
    return sbi_lattice_barycentrics(x, rest, at);
}

/* Of all that says which cell has the material anywhere in the element of a place. */
static uint64_t sbi_fine_hash_pieces(const sb_cut *cut, const sbi_fine_place *place, sbi_fine_pieces *pieces,
                                     uint64_t hash)
{
    const sbi_parted *parted = &pieces->parted;
    hash = sbi_hash_word(hash, (uint64_t)place->cell);
    if (sbi_cut_is_whole(cut, place->tet))
        return sbi_hash_word(hash, (uint64_t)cut->pieces[place->tet].cell);
    sbi_fine_load_pieces(cut, place->tet, pieces);
    for (int link = 0; link < parted->lattice->link_count; link++) {
        uint64_t t = 0;
        if (!parted->cut[link])
            continue;
        memcpy(&t, &parted->t[link], sizeof parted->t[link]);
        hash = sbi_hash_word(hash, ((uint64_t)link << 8) + parted->cut[link]);
        hash = sbi_hash_word(hash, (uint64_t)parted->rank[link]);
        hash = sbi_hash_word(hash, t);
    }
    for (int point = 0; point < parted->lattice->point_count; point++)
        hash = sbi_hash_word(hash, parted->piece_of[point]);
    for (int piece = 0; piece < parted->piece_count; piece++)
        hash = sbi_hash_word(hash, (uint64_t)pieces->cells[piece]);
    return hash;
}

/* Where along an edge, from its first end, the side of that ends: in (0, 1). */
static sb_real sbi_fine_find_crossing(const sb_cut_fine *fine, const int ends[2], sbi_fine_pieces pieces[2])
{
    enum { HALVINGS = 24 };
    const sb_real least = (sb_real)1e-3;
    const sbi_fine_place *p = fine->places + ends[0], *q = fine->places + ends[1];
    sb_real low = 0, high = 1;
    for (int i = 0; i < HALVINGS; i++) {
        sb_real middle = (low + high) / 2, at[2][4];
        sb_vec3 x = sb_v3_madd(sb_v3_scale(1 - middle, fine->rest[ends[0]]), middle, fine->rest[ends[1]]);
        sb_real in_first = sbi_fine_find_in(fine->cut, p->tet, x, at[0]);
        sb_real in_last = sbi_fine_find_in(fine->cut, q->tet, x, at[1]);
        int is_first = in_first >= in_last ? sbi_fine_cell_at(fine->cut, p->tet, at[0], pieces) == p->cell
                                           : sbi_fine_cell_at(fine->cut, q->tet, at[1], pieces + 1) != q->cell;
        low = is_first ? middle : low;
        high = is_first ? high : middle;
    }
    return sb_min(sb_max(low, least), 1 - least);
}

/* The same, as it was found before where the elements of both ends are as they were then. */
static sb_real sbi_fine_crossing(sb_cut_fine *fine, int edge)
{
    const int *ends = fine->edges[edge];
    sbi_fine_crossed *known = fine->crossed + edge;
    sbi_fine_pieces pieces[2];
    uint64_t hash = 1;
    pieces[0].tet = pieces[1].tet = -1;
    for (int k = 0; k < 2; k++)
        hash = sbi_fine_hash_pieces(fine->cut, fine->places + ends[k], pieces + k, hash);
    if (known->hash != hash) {
        known->t = sbi_fine_find_crossing(fine, ends, pieces);
        known->hash = hash;
    }
    return known->t;
}

/* ---- vertices and triangles ---- */

/* A vertex between up to three of the skin's, on the side of the first of them. */
static int sbi_fine_add_between(sb_cut_fine *fine, const int corners[3], const sb_real weights[3], int side)
{
    sbi_fine_place place = fine->places[side];
    sb_cut_fine_source source;
    sb_vec3 rest = sb_v3(0, 0, 0);
    for (int k = 0; k < 3; k++) {
        source.vertices[k] = corners[k];
        source.weights[k] = weights[k];
        rest = sb_v3_madd(rest, weights[k], fine->rest[corners[k]]);
    }
    (void)sbi_fine_find_in(fine->cut, place.tet, rest, place.at);
    return sbi_fine_add_vertex(fine, &place, &source, rest);
}

/* Border edge of a triangle of the skin. */
static void sbi_fine_add_seam(sb_cut_fine *fine, int from, int to, int cell)
{
    sbi_fine_border *edge = fine->seam_edges + fine->seam_edge_count++;
    edge->from = from;
    edge->to = to;
    edge->cell = cell;
}

/* ---- what a triangle falls into ---- */

/* A triangle whose corners are v[0..2]; edge k goes from corner k to the next one. */
typedef struct sbi_fine_face {
    int v[3], cells[3];
    int after[3], before[3]; /* seam vertices of corner k on the edges after it and before it, or -1 */
} sbi_fine_face;

static sbi_fine_face sbi_fine_load_face(const sb_cut_fine *fine, int f)
{
    sbi_fine_face face;
    for (int k = 0; k < 3; k++) {
        int v = fine->faces[f][k], after = fine->sides[f][k], before = fine->sides[f][(k + 2) % 3];
        face.v[k] = v;
        face.cells[k] = fine->places[v].cell;
        face.after[k] = fine->is_cut[after] ? fine->seams[after][fine->edges[after][1] == v] : -1;
        face.before[k] = fine->is_cut[before] ? fine->seams[before][fine->edges[before][1] == v] : -1;
    }
    return face;
}

/* The middle of a triangle, on the side of corner k. */
static int sbi_fine_add_middle(sb_cut_fine *fine, const sbi_fine_face *face, int k)
{
    sb_real weights[3];
    weights[0] = weights[1] = weights[2] = (sb_real)1 / 3;
    return sbi_fine_add_between(fine, face->v, weights, face->v[k]);
}

/* Cut from edge k to its middle. */
static void sbi_fine_slit(sb_cut_fine *fine, const sbi_fine_face *face, int k)
{
    int next = (k + 1) % 3, last = (k + 2) % 3, middle = sbi_fine_add_middle(fine, face, last);
    sbi_fine_add_triangle(fine, face->v[k], face->after[k], middle, SB_CUT_SKIN, face->cells[k]);
    sbi_fine_add_triangle(fine, middle, face->before[next], face->v[next], SB_CUT_SKIN, face->cells[next]);
    sbi_fine_add_triangle(fine, face->v[next], face->v[last], middle, SB_CUT_SKIN, face->cells[last]);
    sbi_fine_add_triangle(fine, face->v[last], face->v[k], middle, SB_CUT_SKIN, face->cells[last]);
    sbi_fine_add_seam(fine, face->after[k], middle, face->cells[k]);
    sbi_fine_add_seam(fine, middle, face->before[next], face->cells[next]);
}

/* Corner k comes off the other two. */
static void sbi_fine_cut_off(sb_cut_fine *fine, const sbi_fine_face *face, int k)
{
    int next = (k + 1) % 3, last = (k + 2) % 3, cell = face->cells[k];
    if (cell >= 0) {
        sbi_fine_add_triangle(fine, face->v[k], face->after[k], face->before[k], SB_CUT_SKIN, cell);
        sbi_fine_add_seam(fine, face->after[k], face->before[k], cell);
    }
    cell = face->cells[next];
    if (cell >= 0) {
        sbi_fine_add_triangle(fine, face->before[next], face->v[next], face->v[last], SB_CUT_SKIN, cell);
        sbi_fine_add_triangle(fine, face->before[next], face->v[last], face->after[last], SB_CUT_SKIN, cell);
        sbi_fine_add_seam(fine, face->after[last], face->before[next], cell);
    }
}

/* Each corner has a side of its own. */
static void sbi_fine_part(sb_cut_fine *fine, const sbi_fine_face *face)
{
    for (int k = 0; k < 3; k++) {
        int cell = face->cells[k], middle;
        if (cell < 0)
            continue;
        middle = sbi_fine_add_middle(fine, face, k);
        sbi_fine_add_triangle(fine, face->v[k], face->after[k], middle, SB_CUT_SKIN, cell);
        sbi_fine_add_triangle(fine, face->v[k], middle, face->before[k], SB_CUT_SKIN, cell);
        sbi_fine_add_seam(fine, face->after[k], middle, cell);
        sbi_fine_add_seam(fine, middle, face->before[k], cell);
    }
}

static void sbi_fine_add_face(sb_cut_fine *fine, int f)
{
    sbi_fine_face face = sbi_fine_load_face(fine, f);
    const unsigned char *is_cut = fine->is_cut;
    const int *sides = fine->sides[f];
    int cuts[3], count = 0;
    for (int k = 0; k < 3; k++)
        count += cuts[k] = is_cut[sides[k]];
    if (count == 0 && face.cells[0] >= 0)
        sbi_fine_add_triangle(fine, face.v[0], face.v[1], face.v[2], SB_CUT_SKIN, face.cells[0]);
    for (int k = 0; k < 3; k++) {
        if (count == 1 && cuts[k])
            sbi_fine_slit(fine, &face, k);
        if (count == 2 && cuts[k] && cuts[(k + 2) % 3])
            sbi_fine_cut_off(fine, &face, k);
    }
    if (count == 3)
        sbi_fine_part(fine, &face);
}

/* ---- arrays ---- */

static void sbi_fine_free_arrays(const sb_allocator *allocator, sbi_fine_arrays *arrays)
{
    sbi_free(allocator, arrays->places);
    sbi_free(allocator, arrays->positions);
    sbi_free(allocator, arrays->normals);
    sbi_free(allocator, arrays->rest);
    sbi_free(allocator, arrays->texture);
    sbi_free(allocator, arrays->origins);
    sbi_free(allocator, arrays->sources);
    sbi_free(allocator, arrays->points);
    sbi_fine_free_triangles(allocator, arrays);
    memset(arrays, 0, sizeof *arrays);
}

static int sbi_fine_take_vertices(const sb_allocator *allocator, sbi_fine_arrays *arrays, size_t count)
{
    arrays->places = (sbi_fine_place *)sbi_alloc(allocator, count, sizeof *arrays->places);
    arrays->positions = (sb_vec3 *)sbi_alloc(allocator, count, sizeof(sb_vec3));
    arrays->normals = (sb_vec3 *)sbi_alloc(allocator, count, sizeof(sb_vec3));
    arrays->rest = (sb_vec3 *)sbi_alloc(allocator, count, sizeof(sb_vec3));
    arrays->texture = (sb_real(*)[2])sbi_alloc(allocator, count, sizeof *arrays->texture);
    arrays->origins = (sb_cut_origin *)sbi_alloc(allocator, count, sizeof *arrays->origins);
    arrays->sources = (sb_cut_fine_source *)sbi_alloc(allocator, count, sizeof *arrays->sources);
    arrays->points = (int *)sbi_alloc(allocator, count, sizeof(int));
    return arrays->places && arrays->positions && arrays->normals && arrays->rest && arrays->texture &&
           arrays->origins && arrays->sources && arrays->points;
}

/* Room for so many of both in what comes next, a quarter more than that where it grows; 0: no memory. */
static int sbi_fine_reserve_arrays(sb_cut_fine *fine, int64_t vertices, int64_t triangles)
{
    sbi_fine_arrays *next = &fine->next;
    next->vertex_count = next->triangle_count = 0;
    if (vertices <= next->vertex_room && triangles <= next->triangle_room)
        return 1;
    vertices += vertices / 4;
    triangles += triangles / 4;
    sbi_fine_free_arrays(&fine->allocator, next);
    if (vertices > INT32_MAX || triangles > INT32_MAX ||
        !sbi_fine_take_vertices(&fine->allocator, next, (size_t)vertices) ||
        !sbi_fine_take_triangles(&fine->allocator, next, (size_t)triangles)) {
        sbi_fine_free_arrays(&fine->allocator, next);
        return 0;
    }
    next->vertex_room = (int)vertices;
    next->triangle_room = (int)triangles;
    return 1;
}

static int sbi_fine_reserve_borders(sb_cut_fine *fine, int64_t count)
{
    count += count / 4 + 1;
    fine->seam_edge_count = fine->lip_edge_count = 0;
    if (count <= fine->border_room + fine->border_room / 4)
        return 1;
    sbi_free(&fine->allocator, fine->seam_edges);
    sbi_free(&fine->allocator, fine->lip_edges);
    fine->border_room = 0;
    fine->seam_edges = fine->lip_edges = NULL;
    if (count > INT32_MAX)
        return 0;
    fine->seam_edges = (sbi_fine_border *)sbi_alloc(&fine->allocator, (size_t)count, sizeof *fine->seam_edges);
    fine->lip_edges = (sbi_fine_border *)sbi_alloc(&fine->allocator, (size_t)count, sizeof *fine->lip_edges);
    fine->border_room = fine->seam_edges && fine->lip_edges ? (int)count : 0;
    return fine->border_room > 0;
}

/* ---- an update ---- */

/* The part of the body that a place moves with, when its cell has the nodes of its element still; else -1. */
static int sbi_fine_whole_part(const sb_cut *cut, const sbi_fine_place *place)
{
    const int *uncut = cut->tets + 4 * (size_t)place->tet, *nodes;
    if (place->cell < 0)
        return -1;
    nodes = sb_body_cell_nodes(cut->body, place->cell);
    return memcmp(uncut, nodes, 4 * sizeof *nodes) ? -1 : cut->body->node_component[nodes[0]];
}

/* 1 when the ends of an edge are of pieces that hang together by all nodes that their elements share: what most edges
 * are, at a glance. */
static int sbi_fine_is_whole(const sb_cut_fine *fine, const int ends[2])
{
    return fine->parts[ends[0]] >= 0 && fine->parts[ends[0]] == fine->parts[ends[1]] &&
           fine->places[ends[0]].tet != fine->places[ends[1]].tet;
}

/* Cells of the skin's vertices, and which edges are cut; returns how many. */
static int sbi_fine_find_cuts(sb_cut_fine *fine)
{
    sbi_fine_pieces pieces;
    int count = 0;
    pieces.tet = -1;
    for (int v = 0; v < fine->vertex_count; v++) {
        sbi_fine_place *place = fine->places + v;
        place->cell = sbi_fine_cell_at(fine->cut, place->tet, place->at, &pieces);
        fine->parts[v] = sbi_fine_whole_part(fine->cut, place);
    }
    for (int e = 0; e < fine->edge_count; e++) {
        const int *ends = fine->edges[e];
        int is_cut = !sbi_fine_is_whole(fine, ends) &&
                     sbi_fine_are_apart(fine->cut, fine->places + ends[0], fine->places + ends[1]);
        fine->is_cut[e] = (unsigned char)is_cut;
        count += fine->is_cut[e];
    }
    return count;
}

/* Room for all that cuts of the skin and lips can come to; 0: no memory. */
static int sbi_fine_reserve(sb_cut_fine *fine, int cut_edges)
{
    sb_cut_drawing lips = sb_cut_surface_get(fine->surface);
    int64_t faces = 0, inner = 0;
    for (int f = 0; f < fine->face_count; f++)
        faces += fine->is_cut[fine->sides[f][0]] || fine->is_cut[fine->sides[f][1]] || fine->is_cut[fine->sides[f][2]];
    for (int f = 0; f < lips.triangle_count; f++)
        inner += lips.tags[f] != SB_CUT_SKIN;
    return sbi_fine_reserve_arrays(fine, fine->vertex_count + 4 * (int64_t)cut_edges + 6 * faces + 3 * inner,
                                   fine->face_count + 12 * faces + 4 * inner) &&
           sbi_fine_reserve_borders(fine, 6 * faces + 3 * inner);
}

/* Vertices of the skin, and of its seams on both sides of each cut edge. */
static void sbi_fine_add_vertices(sb_cut_fine *fine)
{
    for (int v = 0; v < fine->vertex_count; v++) {
        sb_cut_fine_source source;
        source.vertices[0] = source.vertices[1] = source.vertices[2] = v;
        source.weights[0] = 1;
        source.weights[1] = source.weights[2] = 0;
        (void)sbi_fine_add_vertex(fine, fine->places + v, &source, fine->rest[v]);
    }
    for (int e = 0; e < fine->edge_count; e++) {
        const int *ends = fine->edges[e];
        sb_real t = fine->is_cut[e] ? sbi_fine_crossing(fine, e) : 0;
        for (int k = 0; k < 2 && fine->is_cut[e]; k++) {
            int corners[3];
            sb_real weights[3];
            corners[0] = ends[0], corners[1] = corners[2] = ends[1];
            weights[0] = 1 - t, weights[1] = t, weights[2] = 0;
            fine->seams[e][k] =
                fine->places[ends[k]].cell < 0 ? -1 : sbi_fine_add_between(fine, corners, weights, ends[k]);
        }
    }
}

/* All triangles as the body is cut now. On failure what is drawn is what it was. */
static sb_result sbi_fine_rebuild(sb_cut_fine *fine, sb_error *error)
{
    sbi_fine_arrays now = fine->now;
    if (!sbi_fine_reserve(fine, sbi_fine_find_cuts(fine)))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a skin of %d triangles that is cut", fine->face_count);
    sbi_fine_add_vertices(fine);
    for (int f = 0; f < fine->face_count; f++)
        sbi_fine_add_face(fine, f);
    if (!sbi_fine_close(fine))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for closing a skin that is cut");
    fine->now = fine->next;
    fine->next = now;
    fine->version = sb_body_mesh_version(fine->cut->body);
    return SB_OK;
}

static sb_vec3 sbi_fine_position(const sb_cut_fine *fine, const sbi_fine_place *place)
{
    const sb_body *body = fine->cut->body;
    const sb_vec3 *x = sb_body_positions(body);
    const int *nodes =
        place->cell < 0 ? sbi_cut_tet_nodes(fine->cut, place->tet) : sb_body_cell_nodes(body, place->cell);
    int n = fine->cut->nodes_per_tet;
    sb_real shape[SBI_CUT_NODES];
    sb_vec3 sum = sb_v3(0, 0, 0);
    sbi_cut_get_shape(fine->cut, place->at, shape);
    for (int a = 0; a < n; a++)
        sum = sb_v3_madd(sum, shape[a], x[nodes[a]]);
    return sum;
}

/* Places of vertices, and normals. */
static void sbi_fine_move(sb_cut_fine *fine)
{
    sbi_fine_arrays *now = &fine->now;
    sb_cut_drawing lips = sb_cut_surface_get(fine->surface);
    for (int i = 0; i < now->vertex_count; i++) {
        const sbi_fine_place *place = now->places + i;
        now->positions[i] = place->lip >= 0 ? lips.positions[place->lip] : sbi_fine_position(fine, place);
        now->normals[i] = sb_v3(0, 0, 0);
    }
    for (int f = 0; f < now->triangle_count; f++) {
        const int *v = now->triangles[f];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(now->positions[v[1]], now->positions[v[0]]),
                                     sb_v3_sub(now->positions[v[2]], now->positions[v[0]]));
        for (int k = 0; k < 3; k++)
            now->normals[v[k]] = sb_v3_add(now->normals[v[k]], normal);
    }
    for (int i = 0; i < now->vertex_count; i++) {
        sb_real size = sb_v3_norm(now->normals[i]);
        if (size > 0)
            now->normals[i] = sb_v3_scale(1 / size, now->normals[i]);
    }
}

SB_API sb_result sb_cut_fine_update(sb_cut_fine *fine, sb_error *error)
{
    sb_result result;
    if (!fine)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_fine_update needs a skin");
    result = sb_cut_surface_update(fine->surface, error);
    if (result == SB_OK && fine->version != sb_body_mesh_version(fine->cut->body))
        result = sbi_fine_rebuild(fine, error);
    if (result == SB_OK)
        sbi_fine_move(fine);
    return result;
}

/* ---- creation ---- */

/* Edges of the skin: sorted by their ends, each once. 0: no memory. */
static int sbi_fine_make_edges(sb_cut_fine *fine)
{
    size_t corners = 3 * (size_t)fine->face_count;
    int *start = (int *)sbi_alloc_zeroed(&fine->allocator, (size_t)fine->vertex_count + 1, sizeof(int));
    int *other = (int *)sbi_alloc(&fine->allocator, corners, sizeof(int)); /* higher ends of edges, by the lower one */
    int *number = (int *)sbi_alloc(&fine->allocator, corners, sizeof(int));
    int made = start && other && number;
    for (size_t i = 0; i < corners && made; i++) {
        int a = fine->faces[i / 3][i % 3], b = fine->faces[i / 3][(i + 1) % 3];
        start[sbi_min_int(a, b) + 1]++;
    }
    for (int v = 0; v < fine->vertex_count && made; v++)
        start[v + 1] += start[v];
    for (size_t i = 0; i < corners && made; i++)
        other[i] = -1;
    for (size_t i = 0; i < corners && made; i++) {
        int a = fine->faces[i / 3][i % 3], b = fine->faces[i / 3][(i + 1) % 3];
        int low = sbi_min_int(a, b), high = sbi_max_int(a, b), at = start[low];
        while (other[at] >= 0 && other[at] != high)
            at++;
        if (other[at] < 0) {
            other[at] = high;
            number[at] = fine->edge_count;
            fine->edges[fine->edge_count][0] = low;
            fine->edges[fine->edge_count++][1] = high;
        }
        fine->sides[i / 3][i % 3] = number[at];
        fine->is_border[number[at]] ^= 1;
    }
    sbi_free(&fine->allocator, start);
    sbi_free(&fine->allocator, other);
    sbi_free(&fine->allocator, number);
    return made;
}

static sb_result sbi_fine_take_skin(sb_cut_fine *fine, const sb_mesh *skin, sb_error *error)
{
    size_t vertices = (size_t)skin->node_count, faces = (size_t)skin->element_count;
    fine->vertex_count = skin->node_count;
    fine->face_count = skin->element_count;
    fine->faces = (int(*)[3])sbi_alloc(&fine->allocator, faces, sizeof *fine->faces);
    fine->sides = (int(*)[3])sbi_alloc(&fine->allocator, faces, sizeof *fine->sides);
    fine->edges = (int(*)[2])sbi_alloc(&fine->allocator, 3 * faces, sizeof *fine->edges);
    fine->seams = (int(*)[2])sbi_alloc(&fine->allocator, 3 * faces, sizeof *fine->seams);
    fine->is_cut = (unsigned char *)sbi_alloc_zeroed(&fine->allocator, 3 * faces, 1);
    fine->is_border = (unsigned char *)sbi_alloc_zeroed(&fine->allocator, 3 * faces, 1);
    fine->places = (sbi_fine_place *)sbi_alloc(&fine->allocator, vertices, sizeof *fine->places);
    fine->rest = (sb_vec3 *)sbi_alloc(&fine->allocator, vertices, sizeof(sb_vec3));
    fine->parts = (int *)sbi_alloc(&fine->allocator, vertices, sizeof(int));
    fine->crossed = (sbi_fine_crossed *)sbi_alloc_zeroed(&fine->allocator, 3 * faces, sizeof *fine->crossed);
    if (!fine->faces || !fine->sides || !fine->edges || !fine->seams || !fine->is_cut || !fine->is_border ||
        !fine->places || !fine->rest || !fine->parts || !fine->crossed)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a skin of %d triangles", skin->element_count);
    memcpy(fine->faces, skin->elements, faces * sizeof *fine->faces);
    memcpy(fine->rest, skin->nodes, vertices * sizeof(sb_vec3));
    if (!sbi_fine_make_edges(fine))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the edges of a skin of %d triangles",
                        skin->element_count);
    return SB_OK;
}

/* Elements of the mesh before any cut that the skin's vertices are in, or nearest to. */
static sb_result sbi_fine_locate(sb_cut_fine *fine, sb_error *error)
{
    const sb_cut *cut = fine->cut;
    sb_mesh mesh;
    sbi_embed_volume volume;
    sb_result result;
    int hint = 0;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TET4;
    mesh.node_count = cut->node_end;
    mesh.nodes = cut->body->reference;
    mesh.element_count = cut->tet_count;
    mesh.elements = cut->tets;
    result = sbi_embed_volume_create(&mesh, SBI_EMBED_NO_SKIN, &fine->allocator, &volume, error);
    if (result != SB_OK)
        return result;
    for (int v = 0; v < fine->vertex_count; v++) {
        sbi_embed_hit hit;
        sbi_embed_closest(&volume, fine->rest[v], hint, &hit);
        hint = fine->places[v].tet = hit.element;
        fine->places[v].lip = -1;
        (void)sbi_fine_find_in(cut, hit.element, fine->rest[v], fine->places[v].at);
    }
    sbi_embed_volume_free(&volume);
    return SB_OK;
}

static sb_result sbi_fine_fill(sb_cut_fine *fine, const sb_mesh *skin, sb_error *error)
{
    sb_result result = sb_cut_surface_create(fine->cut, &fine->allocator, &fine->surface, error);
    if (result == SB_OK)
        result = sbi_fine_take_skin(fine, skin, error);
    if (result == SB_OK)
        result = sbi_fine_locate(fine, error);
    return result == SB_OK ? sb_cut_fine_update(fine, error) : result;
}

SB_API sb_result sb_cut_fine_create(sb_cut *cut, const sb_mesh *skin, const sb_allocator *allocator, sb_cut_fine **fine,
                                    sb_error *error)
{
    sb_cut_fine *made;
    sb_result result;
    if (!cut || !skin || !fine)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_fine_create needs a cut, a skin and a place for it");
    if (skin->element_type != SB_TRI3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the skin has elements of type %s, not triangles",
                        sb_element_name(skin->element_type));
    result = sb_mesh_validate(skin, error);
    if (result != SB_OK)
        return result;
    made = (sb_cut_fine *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a skin");
    made->cut = cut;
    made->version = -1;
    if (allocator)
        made->allocator = *allocator;
    result = sbi_fine_fill(made, skin, error);
    if (result != SB_OK) {
        sb_cut_fine_destroy(made);
        return result;
    }
    *fine = made;
    return SB_OK;
}

SB_API void sb_cut_fine_destroy(sb_cut_fine *fine)
{
    sb_allocator allocator;
    if (!fine)
        return;
    allocator = fine->allocator;
    sb_cut_surface_destroy(fine->surface);
    sbi_fine_free_arrays(&allocator, &fine->now);
    sbi_fine_free_arrays(&allocator, &fine->next);
    sbi_free(&allocator, fine->faces);
    sbi_free(&allocator, fine->sides);
    sbi_free(&allocator, fine->edges);
    sbi_free(&allocator, fine->seams);
    sbi_free(&allocator, fine->is_cut);
    sbi_free(&allocator, fine->is_border);
    sbi_free(&allocator, fine->places);
    sbi_free(&allocator, fine->rest);
    sbi_free(&allocator, fine->parts);
    sbi_free(&allocator, fine->crossed);
    sbi_free(&allocator, fine->lip_vertices);
    sbi_free(&allocator, fine->seam_edges);
    sbi_free(&allocator, fine->lip_edges);
    sbi_free(&allocator, fine->scratch);
    sbi_free(&allocator, fine);
}

SB_API sb_cut_fine_drawing sb_cut_fine_get(const sb_cut_fine *fine)
{
    sb_cut_fine_drawing drawing;
    memset(&drawing, 0, sizeof drawing);
    if (!fine)
        return drawing;
    drawing.drawn.vertex_count = fine->now.vertex_count;
    drawing.drawn.triangle_count = fine->now.triangle_count;
    drawing.drawn.positions = fine->now.positions;
    drawing.drawn.normals = fine->now.normals;
    drawing.drawn.rest = fine->now.rest;
    drawing.drawn.texture = (const sb_real(*)[2])fine->now.texture;
    drawing.drawn.origins = fine->now.origins;
    drawing.drawn.points = fine->now.points;
    drawing.drawn.triangles = (const int(*)[3])fine->now.triangles;
    drawing.drawn.tags = fine->now.tags;
    drawing.drawn.cells = fine->now.cells;
    drawing.drawn.triangle_end = fine->now.triangle_count;
    drawing.drawn.first_vertex = fine->vertex_count;
    drawing.sources = fine->now.sources;
    drawing.open_edges = fine->open_edges;
    return drawing;
}
