/* cut_rim: closes a fine skin that is cut: with lips and walls as the cut's surface has them, and with rims between its
 * seams and their borders.
 *
 * Seams are loops, and so are borders of lips, but one loop of these may be several of those, and either may have no
 * others beside it. So no loops are matched. Each vertex of a seam goes to the nearest point of the borders on its side
 * of the cut, and a rim follows the way between the points of two that are neighbours. What is left of the borders
 * where such ways do not go along them once is loops again, for the ends of loops cancel, and caps close these. */
#include <string.h>

#include "cut_rim_private.h"

enum { SBI_RIM_STEPS = 32 }; /* of a way between the points of two neighbours, at most; it goes straight then */

/* ---- lips and walls ---- */

static int sbi_rim_is_drawn(const sb_cut_drawing *drawing, int f)
{
    return drawing->tags[f] != SB_CUT_SKIN && drawing->triangles[f][0] != drawing->triangles[f][1];
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

/* All that is inside the body, and in the chain its sides, which cancel but at the borders. */
static void sbi_rim_add_lips(sb_cut_fine *fine, sbi_rim *rim, const sb_cut_drawing *drawing)
{
    rim->first_lip = fine->next.triangle_count;
    for (int f = 0; f < drawing->triangle_count; f++) {
        const int *v = drawing->triangles[f];
        int at[3], cell = drawing->cells[f];
        if (!sbi_rim_is_drawn(drawing, f))
            continue;
        for (int k = 0; k < 3; k++)
            at[k] = sbi_rim_lip_vertex(fine, drawing, v[k], cell);
        sbi_fine_add_triangle(fine, at[0], at[1], at[2], drawing->tags[f], cell);
        for (int k = 0; k < 3; k++)
            sbi_rim_chain_add(&rim->chain, fine->next.points[at[k]], fine->next.points[at[(k + 1) % 3]]);
    }
    rim->lip_end = fine->next.triangle_count;
}

/* ---- borders of lips ---- */

/* Number of a point of the borders, at which a lip that moves with this cell has a vertex. */
static int sbi_rim_add_point(const sb_cut_fine *fine, sbi_rim *rim, int vertex, int cell)
{
    int *number = rim->number_of + fine->next.points[vertex];
    if (*number < 0) {
        *number = rim->point_count;
        rim->cell_of[rim->point_count] = cell;
        rim->vertex_of[rim->point_count++] = vertex;
    }
    return *number;
}

/* Lists the sides of lips that nothing goes along the other way. */
static void sbi_rim_list_borders(sb_cut_fine *fine, sbi_rim *rim)
{
    const sbi_fine_arrays *next = &fine->next;
    memset(rim->number_of, -1, (size_t)next->vertex_count * sizeof(int));
    rim->point_count = fine->lip_edge_count = 0;
    for (int f = rim->first_lip; f < rim->lip_end; f++)
        for (int k = 0; k < 3; k++) {
            int from = next->triangles[f][k], to = next->triangles[f][(k + 1) % 3];
            sbi_fine_border *edge = fine->lip_edges + fine->lip_edge_count;
            if (!sbi_rim_chain_list(&rim->chain, next->points[from], next->points[to]))
                continue;
            edge->cell = next->cells[f];
            edge->from = sbi_rim_add_point(fine, rim, from, edge->cell);
            edge->to = sbi_rim_add_point(fine, rim, to, edge->cell);
            rim->tet_of[fine->lip_edge_count++] = next->places[from].tet;
        }
}

/* Borders as a graph: the points beside each, and edges by the nodes of their cells. */
static void sbi_rim_index_borders(const sb_cut_fine *fine, sbi_rim *rim)
{
    int count = fine->lip_edge_count, nodes = sb_body_node_count(fine->cut->body);
    memset(rim->beside_at, 0, ((size_t)rim->point_count + 2) * sizeof(int));
    memset(rim->edges_at, 0, ((size_t)nodes + 2) * sizeof(int));
    for (int e = 0; e < count; e++) {
        const sbi_fine_border *edge = fine->lip_edges + e;
        const int *corners = sb_body_cell_nodes(fine->cut->body, edge->cell);
        rim->beside_at[edge->from + 2]++;
        rim->beside_at[edge->to + 2]++;
        for (int a = 0; a < 4; a++)
            rim->edges_at[corners[a] + 2]++;
    }
    for (int i = 0; i < rim->point_count; i++)
        rim->beside_at[i + 2] += rim->beside_at[i + 1];
    for (int i = 0; i < nodes; i++)
        rim->edges_at[i + 2] += rim->edges_at[i + 1];
    for (int e = 0; e < count; e++) {
        const sbi_fine_border *edge = fine->lip_edges + e;
        const int *corners = sb_body_cell_nodes(fine->cut->body, edge->cell);
        rim->beside[rim->beside_at[edge->from + 1]++] = edge->to;
        rim->beside[rim->beside_at[edge->to + 1]++] = edge->from;
        for (int a = 0; a < 4; a++)
            rim->edges_of[rim->edges_at[corners[a] + 1]++] = e;
    }
    memset(rim->seen, 0, (size_t)rim->point_count * sizeof(int));
    rim->search = 0;
}

static sb_real sbi_rim_gap(const sb_cut_fine *fine, int a, int b)
{
    return sb_v3_norm(sb_v3_sub(fine->next.rest[a], fine->next.rest[b]));
}

/* The point of the borders that is nearest to a vertex of a seam, of pieces that hang together with its own, or -1. */
static int sbi_rim_nearest(const sb_cut_fine *fine, const sbi_rim *rim, int vertex)
{
    const sbi_fine_place *place = fine->next.places + vertex;
    const int *corners = sb_body_cell_nodes(fine->cut->body, place->cell);
    sb_real least = SB_REAL_MAX;
    int best = -1;
    for (int a = 0; a < 4; a++)
        for (int k = rim->edges_at[corners[a]]; k < rim->edges_at[corners[a] + 1]; k++) {
            int e = rim->edges_of[k], point = fine->lip_edges[e].from;
            sb_real gap = sbi_rim_gap(fine, vertex, rim->vertex_of[point]);
            sbi_fine_place there;
            there.tet = rim->tet_of[e];
            there.cell = fine->lip_edges[e].cell;
            if (gap < least && !sbi_fine_are_apart(fine->cut, place, &there)) {
                least = gap;
                best = point;
            }
        }
    return best;
}

/* ---- ways along borders ---- */

/* The shortest way between two points, all but the first of them, into `way`; returns how many. One that is too long,
 * or is not there, goes straight. */
static int sbi_rim_find_way(sbi_rim *rim, int from, int to, int way[SBI_RIM_STEPS])
{
    int begin = 0, end = 0, count = 0;
    rim->search++;
    rim->seen[from] = rim->search;
    rim->depth[from] = 0;
    rim->queue[end++] = from;
    while (begin < end && rim->seen[to] != rim->search) {
        int at = rim->queue[begin++];
        if (rim->depth[at] == SBI_RIM_STEPS)
            break;
        for (int k = rim->beside_at[at]; k < rim->beside_at[at + 1]; k++) {
            int next = rim->beside[k];
            if (rim->seen[next] == rim->search)
                continue;
            rim->seen[next] = rim->search;
            rim->came_from[next] = at;
            rim->depth[next] = rim->depth[at] + 1;
            rim->queue[end++] = next;
        }
    }
    if (rim->seen[to] != rim->search) {
        way[0] = to;
        return 1;
    }
    count = rim->depth[to];
    for (int i = count; i-- > 0; to = rim->came_from[to])
        way[i] = to;
    return count;
}

/* Goes on from the walk's end to a point. What goes there and back at once is not gone: vertices of the seam that were
 * at its tip, all before number i, are at its foot. */
static void sbi_rim_walk_to(sbi_rim *rim, int i, int point)
{
    int way[SBI_RIM_STEPS], count = 0;
    if (rim->walk[rim->walk_count - 1] != point)
        count = sbi_rim_find_way(rim, rim->walk[rim->walk_count - 1], point, way);
    for (int k = 0; k < count; k++) {
        int last = rim->walk_count - 1;
        if (last == 0 || rim->walk[last - 1] != way[k]) {
            rim->walk[rim->walk_count++] = way[k];
            continue;
        }
        for (int j = i; j-- > 0 && rim->position[j] == last;)
            rim->position[j] = last - 1;
        rim->walk_count--;
    }
    rim->position[i] = rim->walk_count - 1;
}

/* Points that the vertices of a seam go to; those that have none go where the one before them does. 0: nowhere. */
static int sbi_rim_find_points(const sb_cut_fine *fine, sbi_rim *rim)
{
    int count = rim->seam_count, last = -1;
    for (int i = 0; i < count; i++) {
        rim->goes_to[i] = sbi_rim_nearest(fine, rim, rim->seam[i]);
        last = rim->goes_to[i] >= 0 ? rim->goes_to[i] : last;
    }
    for (int i = 0; i < count; i++)
        last = rim->goes_to[i] = rim->goes_to[i] >= 0 ? rim->goes_to[i] : last;
    return last >= 0;
}

/* The walk along the borders beside a seam: from walk[*first] to the last one. */
static void sbi_rim_walk_along(sbi_rim *rim, int *first)
{
    rim->walk[0] = rim->goes_to[0];
    rim->walk_count = 1;
    rim->position[0] = *first = 0;
    for (int i = 1; i < rim->seam_count; i++)
        sbi_rim_walk_to(rim, i, rim->goes_to[i]);
    if (!rim->is_closed)
        return;
    sbi_rim_walk_to(rim, rim->seam_count, rim->goes_to[0]);
    while (rim->walk_count - *first > 2 && rim->walk[*first + 1] == rim->walk[rim->walk_count - 2]) {
        ++*first;
        rim->walk_count--;
    }
}

/* ---- rims ---- */

/* A vertex of the rim where the skin has one: with a normal of its own. */
static int sbi_rim_copy(sb_cut_fine *fine, int vertex)
{
    sbi_fine_place place = fine->next.places[vertex];
    sb_cut_fine_source source = fine->next.sources[vertex];
    int copy = sbi_fine_add_vertex(fine, &place, &source, fine->next.rest[vertex]);
    fine->next.points[copy] = fine->next.points[vertex];
    return copy;
}

/* Where in the walk a vertex of the seam is. */
static int sbi_rim_position(const sbi_rim *rim, int first, int i)
{
    return sbi_min_int(sbi_max_int(rim->position[i], first), rim->walk_count - 1);
}

/* Triangles between a seam and its walk: on along either of them, by the shorter diagonal. */
static void sbi_rim_zip(sb_cut_fine *fine, sbi_rim *rim, int first, const int *cells)
{
    int steps = rim->seam_count - !rim->is_closed, at = first, end = rim->walk_count - 1, i = 0;
    for (int k = 0; k < rim->seam_count; k++)
        rim->seam[k] = sbi_rim_copy(fine, rim->seam[k]);
    while (i < steps || at < end) {
        int seam = rim->seam[i % rim->seam_count], next_seam = rim->seam[(i + 1) % rim->seam_count];
        int lip = rim->vertex_of[rim->walk[at]], next_lip = rim->vertex_of[rim->walk[sbi_min_int(at + 1, end)]];
        int cell = cells[sbi_min_int(i, steps - 1)], goes_on = i < steps && at >= sbi_rim_position(rim, first, i);
        if (goes_on && at < end && at < sbi_rim_position(rim, first, i + 1))
            goes_on = sbi_rim_gap(fine, next_seam, lip) <= sbi_rim_gap(fine, seam, next_lip);
        if (goes_on) {
            sbi_fine_add_triangle(fine, next_seam, seam, lip, SB_CUT_RIM, cell);
            i++;
        } else {
            sbi_fine_add_triangle(fine, seam, lip, next_lip, SB_CUT_RIM, cell);
            at++;
        }
    }
}

/* Closes a seam: by a rim, or where no border is beside it by a cap. 0: no memory. */
static int sbi_rim_close_seam(sb_cut_fine *fine, sbi_rim *rim, const int *cells)
{
    int first = 0, count = rim->seam_count;
    if (!sbi_rim_find_points(fine, rim)) {
        if (!rim->is_closed) {
            rim->open_edges += count - 1;
            return 1;
        }
        if (!sbi_fine_reserve_triangles(fine, count))
            return 0;
        for (int i = 0; i < count; i++)
            rim->walk[i] = sbi_rim_copy(fine, rim->seam[count - 1 - i]);
        sbi_rim_cap(fine, rim->walk, count, cells[0], rim->ring);
        return 1;
    }
    sbi_rim_walk_along(rim, &first);
    if (!sbi_fine_reserve_triangles(fine, count + rim->walk_count))
        return 0;
    for (int k = first; k + 1 < rim->walk_count; k++)
        sbi_rim_chain_step(fine, rim, rim->walk[k], rim->walk[k + 1]);
    sbi_rim_zip(fine, rim, first, cells);
    rim->open_edges += rim->is_closed ? 0 : 2;
    return 1;
}

/* ---- seams ---- */

/* Edges by the vertices that they begin at. Vertices that more edges begin than end at begin a seam that is open. */
static void sbi_rim_index_seams(const sb_cut_fine *fine, sbi_rim *rim)
{
    for (int e = 0; e < fine->seam_edge_count; e++) {
        const sbi_fine_border *edge = fine->seam_edges + e;
        rim->edge_from[edge->from] = rim->edge_from[edge->to] = -1;
        rim->excess[edge->from] = rim->excess[edge->to] = 0;
    }
    for (int e = fine->seam_edge_count; e-- > 0;) {
        const sbi_fine_border *edge = fine->seam_edges + e;
        rim->next_from[e] = rim->edge_from[edge->from];
        rim->edge_from[edge->from] = e;
        rim->excess[edge->from]++;
        rim->excess[edge->to]--;
    }
}

/* Follows a seam from a vertex as far as it goes, and closes it; 0: no memory. */
static int sbi_rim_follow(sb_cut_fine *fine, sbi_rim *rim, int vertex)
{
    int start = vertex, *cells = rim->cells, count = 0;
    while (rim->edge_from[vertex] >= 0) {
        int e = rim->edge_from[vertex];
        rim->edge_from[vertex] = rim->next_from[e];
        rim->seam[count] = vertex;
        cells[count++] = fine->seam_edges[e].cell;
        vertex = fine->seam_edges[e].to;
    }
    rim->is_closed = vertex == start;
    if (!rim->is_closed)
        rim->seam[count++] = vertex;
    rim->seam_count = count;
    return count == 0 || sbi_rim_close_seam(fine, rim, cells);
}

/* Closes all seams, those that are open first; 0: no memory. */
static int sbi_rim_close_seams(sb_cut_fine *fine, sbi_rim *rim)
{
    sbi_rim_index_seams(fine, rim);
    for (int open = 1; open >= 0; open--)
        for (int e = 0; e < fine->seam_edge_count; e++) {
            int from = fine->seam_edges[e].from;
            if (open && rim->excess[from] <= 0)
                continue;
            rim->excess[from] -= open;
            if (rim->edge_from[from] >= 0 && !sbi_rim_follow(fine, rim, from))
                return 0;
        }
    return 1;
}

/* ---- scratch ---- */

/* Lists of a call, one behind the other; at NULL: they are only counted. Returns how many numbers there are. */
static size_t sbi_rim_share_out(const sb_cut_fine *fine, sbi_rim *rim, size_t lips, int *at)
{
    size_t seams = (size_t)fine->seam_edge_count + 2, border = 3 * lips + 2, steps = border + SBI_RIM_STEPS * seams;
    size_t vertices = (size_t)fine->next.vertex_room, nodes = (size_t)sb_body_node_count(fine->cut->body) + 2;
    int *slots = NULL;
    struct {
        int **list;
        size_t size;
    } lists[] = {{&slots, (size_t)rim->chain.size * SBI_RIM_SLOT},
                 {&rim->number_of, vertices},
                 {&rim->edge_from, vertices},
                 {&rim->excess, vertices},
                 {&rim->vertex_of, border},
                 {&rim->cell_of, border},
                 {&rim->tet_of, border},
                 {&rim->beside_at, border + 2},
                 {&rim->beside, 2 * border},
                 {&rim->edges_at, nodes},
                 {&rim->edges_of, 4 * border},
                 {&rim->seen, border},
                 {&rim->depth, border},
                 {&rim->came_from, border},
                 {&rim->queue, border},
                 {&rim->next_from, seams},
                 {&rim->seam, seams},
                 {&rim->cells, seams},
                 {&rim->goes_to, seams},
                 {&rim->position, seams},
                 {&rim->walk, steps},
                 {&rim->jumps, 2 * seams},
                 {&rim->rest_from, border},
                 {&rim->rest_to, steps},
                 {&rim->rest_next, steps},
                 {&rim->stacked, border},
                 {&rim->stack, border},
                 {&rim->ring, border + seams}};
    size_t used = 0;
    for (size_t i = 0; i < sizeof lists / sizeof lists[0]; used += lists[i++].size)
        if (at)
            *lists[i].list = at + used;
    rim->chain.slots = (int(*)[SBI_RIM_SLOT])slots;
    return used;
}

/* 0: no memory. */
static int sbi_rim_take(sb_cut_fine *fine, const sb_cut_drawing *drawing, sbi_rim *rim)
{
    int64_t lips = 0, chain = 64;
    size_t needed;
    memset(rim, 0, sizeof *rim);
    for (int f = 0; f < drawing->triangle_count; f++)
        lips += sbi_rim_is_drawn(drawing, f);
    while (chain < 6 * lips + 2 * (int64_t)fine->seam_edge_count)
        chain *= 2;
    if (chain > INT32_MAX / 8)
        return 0;
    rim->chain.size = (int)chain;
    needed = sbi_rim_share_out(fine, rim, (size_t)lips, NULL);
    if (needed > fine->scratch_room) {
        sbi_free(&fine->allocator, fine->scratch);
        fine->scratch = (int *)sbi_alloc(&fine->allocator, needed + needed / 4, sizeof(int));
        fine->scratch_room = fine->scratch ? needed + needed / 4 : 0;
        if (!fine->scratch)
            return 0;
    }
    (void)sbi_rim_share_out(fine, rim, (size_t)lips, fine->scratch);
    memset(rim->chain.slots, 0, (size_t)chain * sizeof *rim->chain.slots);
    return 1;
}

/* Edges of the skin's own border, and pieces of cut ones. */
static int sbi_rim_count_own(const sb_cut_fine *fine)
{
    int count = 0;
    for (int e = 0; e < fine->edge_count; e++)
        for (int k = 0; k < (fine->is_cut[e] ? 2 : 1) && fine->is_border[e]; k++)
            count += fine->places[fine->edges[e][k]].cell >= 0;
    return count;
}

SBI_API int sbi_fine_close(sb_cut_fine *fine)
{
    sb_cut_drawing drawing = sb_cut_surface_get(fine->surface);
    sbi_rim rim;
    if (!sbi_rim_take(fine, &drawing, &rim) || !sbi_rim_reserve_lips(fine, drawing.vertex_count))
        return 0;
    sbi_rim_add_lips(fine, &rim, &drawing);
    sbi_rim_list_borders(fine, &rim);
    sbi_rim_index_borders(fine, &rim);
    if (!sbi_rim_close_seams(fine, &rim) || !sbi_rim_cap_rest(fine, &rim))
        return 0;
    fine->open_edges = rim.open_edges + sbi_rim_count_own(fine);
    return 1;
}
