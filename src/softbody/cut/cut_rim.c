/* cut_rim: closes a fine skin that is cut: with lips and walls as the cut's surface has them, and with rims between its
 * seams and their borders. Borders are loops, one inside the other, of the same cells; a rim runs along both and goes
 * on where the next diagonal is the shorter one. */
#include <string.h>

#include "cut_fine_private.h"

/* Border edges, and the loops that they make. */
typedef struct sbi_rim_border {
    const sbi_fine_border *edges;
    int edge_count, loop_count;
    int *next;    /* [edge_count] the edge behind it, or -1 */
    int *loop_of; /* [edge_count] or SBI_RIM_OPEN */
    int *first;   /* [loop_count] an edge of it */
} sbi_rim_border;

enum { SBI_RIM_OPEN = -1, SBI_RIM_UNSEEN = -2 };

/* Scratch of a call. */
typedef struct sbi_rim {
    sbi_rim_border seams, lips;
    int *edge_from;  /* [vertices] edge that begins at a point, or -1 */
    int *cell_loops; /* [cells] a loop of lips that the cell has an edge of, or -1 */
    int *votes;      /* [loops of lips] edges of a seam that cells of it have */
    int *is_taken;   /* [loops of lips] */
    int *path;       /* [edges of lips] vertices of a loop, backwards */
    int *table;      /* [2 table_size] 1 + first, and second point of sides of the coarse skin's triangles */
    int table_size;
} sbi_rim;

/* ---- scratch ---- */

static int sbi_rim_table_size(const sb_cut_drawing *drawing)
{
    int64_t size = 64;
    while (size < 6 * (int64_t)drawing->triangle_count)
        size *= 2;
    return size < INT32_MAX / 2 ? (int)size : 0;
}

/* 0: no memory. */
static int sbi_rim_take(sb_cut_fine *fine, const sb_cut_drawing *drawing, sbi_rim *rim)
{
    size_t border = (size_t)fine->border_room, vertices = (size_t)fine->next.vertex_room, needed, table;
    size_t cells = (size_t)sb_body_element_count(fine->cut->body);
    int *at;
    memset(rim, 0, sizeof *rim);
    rim->table_size = sbi_rim_table_size(drawing);
    table = 2 * (size_t)rim->table_size;
    needed = 9 * border + vertices + cells + table;
    if (!rim->table_size)
        return 0;
    if (needed > fine->scratch_room) {
        sbi_free(&fine->allocator, fine->scratch);
        fine->scratch = (int *)sbi_alloc(&fine->allocator, needed + needed / 4, sizeof(int));
        fine->scratch_room = fine->scratch ? needed + needed / 4 : 0;
        if (!fine->scratch)
            return 0;
    }
    at = fine->scratch;
    rim->seams.next = at, at += border;
    rim->seams.loop_of = at, at += border;
    rim->seams.first = at, at += border;
    rim->lips.next = at, at += border;
    rim->lips.loop_of = at, at += border;
    rim->lips.first = at, at += border;
    rim->votes = at, at += border;
    rim->is_taken = at, at += border;
    rim->path = at, at += border;
    rim->edge_from = at, at += vertices;
    rim->cell_loops = at, at += cells;
    rim->table = at;
    memset(rim->cell_loops, -1, cells * sizeof(int));
    memset(rim->table, 0, table * sizeof(int));
    return 1;
}

/* ---- lips and walls ---- */

/* Where a side from one point to another is in the table, or belongs. */
static int sbi_rim_slot(const sbi_rim *rim, int from, int to)
{
    unsigned mask = (unsigned)rim->table_size - 1;
    uint64_t mixed = (((uint64_t)(unsigned)from << 32) ^ (unsigned)to) * UINT64_C(0x9e3779b97f4a7c15);
    unsigned slot = (unsigned)(mixed >> 32) & mask;
    while (rim->table[2 * (size_t)slot] &&
           (rim->table[2 * (size_t)slot] != from + 1 || rim->table[2 * (size_t)slot + 1] != to))
        slot = (slot + 1) & mask;
    return (int)slot;
}

static int sbi_rim_is_drawn(const sb_cut_drawing *drawing, int f)
{
    return drawing->triangles[f][0] != drawing->triangles[f][1];
}

static void sbi_rim_list_sides(const sbi_rim *rim, const sb_cut_drawing *drawing)
{
    for (int f = 0; f < drawing->triangle_count; f++)
        for (int k = 0; k < 3 && drawing->tags[f] == SB_CUT_SKIN && sbi_rim_is_drawn(drawing, f); k++) {
            int from = drawing->points[drawing->triangles[f][k]];
            int to = drawing->points[drawing->triangles[f][(k + 1) % 3]], slot = sbi_rim_slot(rim, from, to);
            rim->table[2 * (size_t)slot] = from + 1;
            rim->table[2 * (size_t)slot + 1] = to;
        }
}

/* Room for the numbers that vertices and points of the surface have here; 0: no memory. */
static int sbi_rim_reserve_lips(sb_cut_fine *fine, int count)
{
    if (count > fine->lip_room) {
        sbi_free(&fine->allocator, fine->lip_vertices);
        fine->lip_vertices = (int *)sbi_alloc(&fine->allocator, (size_t)count + (size_t)count / 4, 2 * sizeof(int));
        fine->lip_room = fine->lip_vertices ? count + count / 4 : 0;
    }
    if (fine->lip_vertices)
        memset(fine->lip_vertices, -1, 2 * (size_t)fine->lip_room * sizeof(int));
    return count <= fine->lip_room;
}

/* The number here of a vertex of the surface, of a triangle that moves with this cell. */
static int sbi_rim_lip_vertex(sb_cut_fine *fine, const sb_cut_drawing *drawing, int vertex, int cell)
{
    int *number = fine->lip_vertices + vertex, *point = fine->lip_vertices + fine->lip_room + drawing->points[vertex];
    sbi_fine_place place;
    sb_cut_fine_source none;
    if (*number >= 0)
        return *number;
    memset(&none, 0, sizeof none);
    none.vertices[0] = none.vertices[1] = none.vertices[2] = -1;
    place.tet = drawing->origins[vertex].element;
    memcpy(place.at, drawing->origins[vertex].weights, sizeof place.at);
    place.cell = cell;
    place.lip = vertex;
    *number = sbi_fine_add_vertex(fine, &place, &none, drawing->rest[vertex]);
    if (*point < 0)
        *point = *number;
    fine->next.points[*number] = *point;
    memcpy(fine->next.texture[*number], drawing->texture[vertex], sizeof drawing->texture[vertex]);
    return *number;
}

/* All that is inside the body, and which of its edges are on the coarse skin. */
static void sbi_rim_add_lips(sb_cut_fine *fine, const sbi_rim *rim, const sb_cut_drawing *drawing)
{
    for (int f = 0; f < drawing->triangle_count; f++) {
        const int *v = drawing->triangles[f];
        int at[3], cell = drawing->cells[f];
        if (drawing->tags[f] == SB_CUT_SKIN || !sbi_rim_is_drawn(drawing, f))
            continue;
        for (int k = 0; k < 3; k++)
            at[k] = sbi_rim_lip_vertex(fine, drawing, v[k], cell);
        sbi_fine_add_triangle(fine, at[0], at[1], at[2], drawing->tags[f], cell);
        for (int k = 0; k < 3; k++) {
            int next = (k + 1) % 3, slot = sbi_rim_slot(rim, drawing->points[v[next]], drawing->points[v[k]]);
            sbi_fine_border *edge = fine->lip_edges + fine->lip_edge_count;
            if (!rim->table[2 * (size_t)slot])
                continue;
            edge->from = at[k], edge->to = at[next], edge->cell = cell;
            fine->lip_edge_count++;
        }
    }
}

/* ---- loops ---- */

/* Follows edges from one on, gives them a number, and takes it back where they do not come to it again. */
static void sbi_rim_follow(sbi_rim_border *border, int edge)
{
    int number = border->loop_count, at = edge;
    while (at >= 0 && border->loop_of[at] == SBI_RIM_UNSEEN) {
        border->loop_of[at] = number;
        at = border->next[at];
    }
    if (at == edge) {
        border->first[border->loop_count++] = edge;
        return;
    }
    for (at = edge; at >= 0 && border->loop_of[at] == number; at = border->next[at])
        border->loop_of[at] = SBI_RIM_OPEN;
}

static void sbi_rim_find_loops(const int *points, int *edge_from, sbi_rim_border *border)
{
    border->loop_count = 0;
    for (int e = 0; e < border->edge_count; e++)
        edge_from[points[border->edges[e].from]] = edge_from[points[border->edges[e].to]] = -1;
    for (int e = 0; e < border->edge_count; e++) {
        int *from = edge_from + points[border->edges[e].from];
        *from = *from < 0 ? e : *from; /* where a border meets itself one way is left open */
        border->loop_of[e] = SBI_RIM_UNSEEN;
    }
    for (int e = 0; e < border->edge_count; e++)
        border->next[e] = edge_from[points[border->edges[e].to]];
    for (int e = 0; e < border->edge_count; e++)
        if (border->loop_of[e] == SBI_RIM_UNSEEN)
            sbi_rim_follow(border, e);
}

static int sbi_rim_length(const sbi_rim_border *border, int loop)
{
    int length = 1, first = border->first[loop];
    for (int e = border->next[first]; e != first; e = border->next[e])
        length++;
    return length;
}

/* The loop of lips that is not taken yet and has most of the cells of a seam, or -1. */
static int sbi_rim_partner(const sbi_rim *rim, int loop)
{
    int first = rim->seams.first[loop], e = first, best = -1;
    memset(rim->votes, 0, (size_t)rim->lips.loop_count * sizeof(int));
    do {
        int other = rim->cell_loops[rim->seams.edges[e].cell];
        if (other >= 0)
            rim->votes[other]++;
        e = rim->seams.next[e];
    } while (e != first);
    for (int i = 0; i < rim->lips.loop_count; i++)
        if (!rim->is_taken[i] && rim->votes[i] > (best < 0 ? 0 : rim->votes[best]))
            best = i;
    return best;
}

/* ---- rims ---- */

/* Vertices of a loop of lips, backwards from the one that is nearest to a place; returns how many. */
static int sbi_rim_list_path(const sb_cut_fine *fine, const sbi_rim *rim, int loop, sb_vec3 from)
{
    const sb_vec3 *rest = fine->next.rest;
    int count = sbi_rim_length(&rim->lips, loop), nearest = rim->lips.first[loop], e = nearest;
    for (int i = 0; i < count; i++, e = rim->lips.next[e])
        if (sb_v3_norm(sb_v3_sub(rest[rim->lips.edges[e].from], from)) <
            sb_v3_norm(sb_v3_sub(rest[rim->lips.edges[nearest].from], from)))
            nearest = e;
    e = nearest;
    for (int i = count; i-- > 0; e = rim->lips.next[e])
        rim->path[(i + 1) % count] = rim->lips.edges[e].from;
    return count;
}

/* A vertex of the rim where the skin has one: with a normal of its own. */
static int sbi_rim_copy(sb_cut_fine *fine, int vertex)
{
    sbi_fine_place place = fine->next.places[vertex];
    sb_cut_fine_source source = fine->next.sources[vertex];
    int copy = sbi_fine_add_vertex(fine, &place, &source, fine->next.rest[vertex]);
    fine->next.points[copy] = fine->next.points[vertex];
    return copy;
}

static sb_real sbi_rim_gap(const sb_cut_fine *fine, int a, int b)
{
    return sb_v3_norm(sb_v3_sub(fine->next.rest[a], fine->next.rest[b]));
}

/* Around a loop (m); 1 where it has no length. */
static sb_real sbi_rim_way(const sb_cut_fine *fine, const sbi_rim_border *border, int loop)
{
    int first = border->first[loop], e = first;
    sb_real sum = 0;
    do {
        sum += sbi_rim_gap(fine, border->edges[e].from, border->edges[e].to);
        e = border->next[e];
    } while (e != first);
    return sum > 0 ? sum : 1;
}

/* How far a rim has come: shares of the way around both borders. */
typedef struct sbi_rim_progress {
    sb_real seam, lips, seam_way, lips_way;
} sbi_rim_progress;

/* 1 when the seam is to go on to its next vertex, 0 when the lips are: by the shorter diagonal, but for borders that
 * would get ahead of each other by a sixteenth of their way. */
static int sbi_rim_goes_on(const sb_cut_fine *fine, const sbi_rim_progress *progress, const int seam[2],
                           const int lips[2])
{
    const sb_real most = (sb_real)0.0625;
    sb_real next_seam = progress->seam + sbi_rim_gap(fine, seam[0], seam[1]) / progress->seam_way;
    sb_real next_lips = progress->lips + sbi_rim_gap(fine, lips[0], lips[1]) / progress->lips_way;
    if (next_seam - progress->lips > most || next_lips - progress->seam > most)
        return next_seam < next_lips;
    return sbi_rim_gap(fine, seam[1], lips[0]) <= sbi_rim_gap(fine, seam[0], lips[1]);
}

/* Closes what is between a seam and a loop of lips, along both. */
static void sbi_rim_join(sb_cut_fine *fine, const sbi_rim *rim, int loop, int partner)
{
    int first = rim->seams.first[loop], length = sbi_rim_length(&rim->seams, loop), e = first, i = 0, j = 0;
    int count = sbi_rim_list_path(fine, rim, partner, fine->next.rest[rim->seams.edges[first].from]);
    int begin = sbi_rim_copy(fine, rim->seams.edges[first].from), seam[2];
    sbi_rim_progress progress;
    progress.seam = progress.lips = 0;
    progress.seam_way = sbi_rim_way(fine, &rim->seams, loop);
    progress.lips_way = sbi_rim_way(fine, &rim->lips, partner);
    seam[0] = begin;
    seam[1] = length == 1 ? begin : sbi_rim_copy(fine, rim->seams.edges[e].to);
    while (i < length || j < count) {
        int lips[2], goes_on;
        lips[0] = rim->path[j % count], lips[1] = rim->path[(j + 1) % count];
        goes_on = j == count || (i < length && sbi_rim_goes_on(fine, &progress, seam, lips));
        if (!goes_on) {
            sbi_fine_add_triangle(fine, seam[0], lips[0], lips[1], SB_CUT_RIM, rim->seams.edges[e].cell);
            progress.lips += sbi_rim_gap(fine, lips[0], lips[1]) / progress.lips_way;
            j++;
            continue;
        }
        sbi_fine_add_triangle(fine, seam[1], seam[0], lips[0], SB_CUT_RIM, rim->seams.edges[e].cell);
        progress.seam += sbi_rim_gap(fine, seam[0], seam[1]) / progress.seam_way;
        seam[0] = seam[1];
        i++;
        e = i < length ? rim->seams.next[e] : e;
        if (i < length)
            seam[1] = i + 1 == length ? begin : sbi_rim_copy(fine, rim->seams.edges[e].to);
    }
}

/* Finds what belongs together, joins it, and counts what is left open. */
static void sbi_rim_join_all(sb_cut_fine *fine, sbi_rim *rim)
{
    fine->open_edges = fine->seam_edge_count + fine->lip_edge_count;
    for (int e = 0; e < rim->lips.edge_count; e++)
        if (rim->lips.loop_of[e] >= 0)
            rim->cell_loops[rim->lips.edges[e].cell] = rim->lips.loop_of[e];
    memset(rim->is_taken, 0, (size_t)rim->lips.loop_count * sizeof(int));
    for (int loop = 0; loop < rim->seams.loop_count; loop++) {
        int partner = sbi_rim_partner(rim, loop);
        if (partner < 0)
            continue;
        rim->is_taken[partner] = 1;
        fine->open_edges -= sbi_rim_length(&rim->seams, loop) + sbi_rim_length(&rim->lips, partner);
        sbi_rim_join(fine, rim, loop, partner);
    }
}

SBI_API int sbi_fine_close(sb_cut_fine *fine)
{
    sb_cut_drawing drawing = sb_cut_surface_get(fine->surface);
    sbi_rim rim;
    if (!sbi_rim_take(fine, &drawing, &rim) || !sbi_rim_reserve_lips(fine, drawing.vertex_count))
        return 0;
    sbi_rim_list_sides(&rim, &drawing);
    sbi_rim_add_lips(fine, &rim, &drawing);
    rim.seams.edges = fine->seam_edges;
    rim.seams.edge_count = fine->seam_edge_count;
    rim.lips.edges = fine->lip_edges;
    rim.lips.edge_count = fine->lip_edge_count;
    sbi_rim_find_loops(fine->next.points, rim.edge_from, &rim.seams);
    sbi_rim_find_loops(fine->next.points, rim.edge_from, &rim.lips);
    sbi_rim_join_all(fine, &rim);
    return 1;
}
