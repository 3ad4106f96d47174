/* lattice: points, links and micro-tets of a tet's lattice, their names, and the pieces that cut links leave. */
#include "lattice.h"

#include <string.h>

#include "../mesh/element.h"

/* ---- tables ---- */

typedef struct sbi_lattice_corner {
    signed char at[4]; /* barycentrics in m-ths */
} sbi_lattice_corner;

static sbi_lattice_corner sbi_lattice_middle(sbi_lattice_corner a, sbi_lattice_corner b)
{
    for (int i = 0; i < 4; i++)
        a.at[i] = (signed char)((a.at[i] + b.at[i]) / 2);
    return a;
}

/* The 8 parts of a micro-tet, in the order of corners that keeps their shapes few when they are refined again (Bey
 * 1995); 0 to 3 are corners, 4 to 9 middles of edges as the nodes of a tet10. */
static void sbi_lattice_refine(const sbi_lattice_corner tet[4], sbi_lattice_corner parts[8][4])
{
    static const signed char corners[8][4] = {{0, 4, 6, 7}, {4, 1, 5, 8}, {6, 5, 2, 9}, {7, 8, 9, 3},
                                              {4, 6, 7, 8}, {4, 6, 5, 8}, {6, 7, 8, 9}, {6, 5, 8, 9}};
    sbi_lattice_corner points[10];
    int ends[3];
    memcpy(points, tet, 4 * sizeof *points);
    for (int e = 0; e < 6; e++) {
        sb_element_edge(SB_TET4, e, ends);
        points[4 + e] = sbi_lattice_middle(tet[ends[0]], tet[ends[1]]);
    }
    for (int k = 0; k < 8; k++)
        for (int a = 0; a < 4; a++)
            parts[k][a] = points[(int)corners[k][a]];
}

static int sbi_lattice_find(const sbi_lattice *lattice, const signed char at[4])
{
    return lattice->lookup[at[1]][at[2]][at[3]];
}

static void sbi_lattice_add_point(sbi_lattice *lattice, sbi_lattice_corner point)
{
    signed char *place = &lattice->lookup[point.at[1]][point.at[2]][point.at[3]];
    if (*place >= 0)
        return;
    *place = (signed char)lattice->point_count;
    memcpy(lattice->points[lattice->point_count++], point.at, 4);
}

/* Corners, then middles of edges, then the others. */
static void sbi_lattice_add_points(sbi_lattice *lattice, const sbi_lattice_corner tet[4])
{
    int m = lattice->intervals, ends[3];
    sbi_lattice_corner point;
    memset(lattice->lookup, -1, sizeof lattice->lookup);
    for (int a = 0; a < 4; a++)
        sbi_lattice_add_point(lattice, tet[a]);
    for (int e = 0; e < 6 && m > 1; e++) {
        sb_element_edge(SB_TET4, e, ends);
        sbi_lattice_add_point(lattice, sbi_lattice_middle(tet[ends[0]], tet[ends[1]]));
    }
    for (int i = 0; i <= m; i++)
        for (int j = 0; i + j <= m; j++)
            for (int k = 0; i + j + k <= m; k++) {
                point.at[0] = (signed char)(m - i - j - k);
                point.at[1] = (signed char)i;
                point.at[2] = (signed char)j;
                point.at[3] = (signed char)k;
                sbi_lattice_add_point(lattice, point);
            }
    for (int p = 0; p < lattice->point_count; p++)
        for (int face = 0; face < 4; face++) {
            int corners[SB_MAX_FACE_NODES], on = 0;
            sb_element_face(SB_TET4, face, corners, NULL);
            for (int a = 0; a < 3; a++)
                on += lattice->points[p][corners[a]];
            if (on == m)
                lattice->face_points[face] |= (uint64_t)1 << p;
        }
}

static int sbi_lattice_is_inverted(const signed char (*points)[4], const unsigned char corners[4])
{
    const signed char *o = points[corners[0]], *a = points[corners[1]], *b = points[corners[2]],
                      *c = points[corners[3]];
    int e[3], f[3], g[3];
    for (int i = 0; i < 3; i++) {
        e[i] = a[i + 1] - o[i + 1];
        f[i] = b[i + 1] - o[i + 1];
        g[i] = c[i + 1] - o[i + 1];
    }
    return e[0] * (f[1] * g[2] - f[2] * g[1]) + e[1] * (f[2] * g[0] - f[0] * g[2]) +
               e[2] * (f[0] * g[1] - f[1] * g[0]) <
           0;
}

static void sbi_lattice_add_micro(sbi_lattice *lattice, const sbi_lattice_corner tet[4])
{
    unsigned char *corners = lattice->micros[lattice->micro_count++];
    for (int a = 0; a < 4; a++)
        corners[a] = (unsigned char)sbi_lattice_find(lattice, tet[a].at);
    if (sbi_lattice_is_inverted((const signed char(*)[4])lattice->points, corners)) {
        unsigned char swap = corners[2];
        corners[2] = corners[3];
        corners[3] = swap;
    }
}

static void sbi_lattice_add_micros(sbi_lattice *lattice, const sbi_lattice_corner tet[4], int intervals)
{
    sbi_lattice_corner parts[8][4];
    if (intervals == 1) {
        sbi_lattice_add_micro(lattice, tet);
        return;
    }
    sbi_lattice_refine(tet, parts);
    for (int k = 0; k < 8; k++)
        sbi_lattice_add_micros(lattice, (const sbi_lattice_corner *)parts[k], intervals / 2);
}

static void sbi_lattice_add_links(sbi_lattice *lattice)
{
    unsigned char number[SBI_LATTICE_POINTS][SBI_LATTICE_POINTS]; /* 1: a link; then its number */
    int ends[3];
    memset(number, 0, sizeof number);
    for (int pass = 0; pass < 2; pass++) {
        for (int k = 0; k < lattice->micro_count; k++)
            for (int e = 0; e < 6; e++) {
                int a, b;
                sb_element_edge(SB_TET4, e, ends);
                a = lattice->micros[k][ends[0]];
                b = lattice->micros[k][ends[1]];
                if (pass == 0)
                    number[sbi_min_int(a, b)][sbi_max_int(a, b)] = 1;
                else
                    lattice->micro_links[k][e] = number[sbi_min_int(a, b)][sbi_max_int(a, b)];
            }
        for (int a = 0; a < lattice->point_count && pass == 0; a++)
            for (int b = a + 1; b < lattice->point_count; b++)
                if (number[a][b]) {
                    lattice->links[lattice->link_count][0] = (unsigned char)a;
                    lattice->links[lattice->link_count][1] = (unsigned char)b;
                    number[a][b] = (unsigned char)lattice->link_count++;
                }
    }
}

SBI_API void sbi_lattice_make(int intervals, sbi_lattice *lattice)
{
    sbi_lattice_corner tet[4];
    memset(lattice, 0, sizeof *lattice);
    memset(tet, 0, sizeof tet);
    lattice->intervals = intervals;
    for (int a = 0; a < 4; a++)
        tet[a].at[a] = (signed char)intervals;
    sbi_lattice_add_points(lattice, tet);
    sbi_lattice_add_micros(lattice, tet, intervals);
    sbi_lattice_add_links(lattice);
}

/* ---- what tets around agree on ---- */

SBI_API sbi_corner_order sbi_corner_order_make(const int nodes[4])
{
    sbi_corner_order order;
    for (int a = 0; a < 4; a++) {
        int at = a;
        order.nodes[a] = nodes[a];
        for (; at > 0 && nodes[order.corners[at - 1]] > nodes[a]; at--)
            order.corners[at] = order.corners[at - 1];
        order.corners[at] = (unsigned char)a;
    }
    return order;
}

SBI_API sbi_link_key sbi_lattice_key(const sbi_lattice *lattice, const sbi_corner_order *order, int tet, int link)
{
    const signed char *a = lattice->points[lattice->links[link][0]], *b = lattice->points[lattice->links[link][1]];
    sbi_link_key key = {{-1, -1, -1, 0}};
    int count = 0;
    for (int i = 0; i < 4; i++) {
        int corner = order->corners[i], twice = a[corner] + b[corner]; /* of the link's middle, of 2 m */
        if (twice == 0)
            continue;
        if (count < 3)
            key.at[count] = order->nodes[corner];
        if (count < 2) /* the last one follows from the others */
            key.at[3] = 9 * key.at[3] + twice;
        count++;
    }
    if (count == 4) {
        key.at[0] = tet;
        key.at[1] = key.at[2] = -1;
        key.at[3] = link;
    }
    return key;
}

SBI_API void sbi_lattice_ends(const sbi_lattice *lattice, const sbi_corner_order *order, int link, int ends[2])
{
    int a = lattice->links[link][0], b = lattice->links[link][1], swapped = 0;
    for (int i = 0; i < 4; i++) {
        int corner = order->corners[i], more = lattice->points[a][corner] - lattice->points[b][corner];
        if (more != 0) {
            swapped = more < 0;
            break;
        }
    }
    ends[0] = swapped ? b : a;
    ends[1] = swapped ? a : b;
}

SBI_API sb_vec3 sbi_lattice_place(const sbi_corner_order *order, const sb_real barycentrics[4], const sb_vec3 x[4])
{
    sb_vec3 place = {0, 0, 0};
    for (int i = 0; i < 4; i++) {
        int corner = order->corners[i];
        if (barycentrics[corner] != 0)
            place = sb_v3_madd(place, barycentrics[corner], x[corner]);
    }
    return place;
}

SBI_API sb_vec3 sbi_lattice_place_quadratic(const sbi_corner_order *order, const sb_real barycentrics[4],
                                            const sb_vec3 x[10])
{
    static const signed char middle[4][4] = {{0, 4, 6, 7}, {4, 1, 5, 8}, {6, 5, 2, 9}, {7, 8, 9, 3}};
    sb_vec3 place = {0, 0, 0};
    for (int i = 0; i < 4; i++)
        for (int k = i; k < 4; k++) {
            int p = order->corners[i], q = order->corners[k];
            sb_real weight =
                p == q ? barycentrics[p] * (2 * barycentrics[p] - 1) : 4 * barycentrics[p] * barycentrics[q];
            if (weight != 0)
                place = sb_v3_madd(place, weight, x[(int)middle[p][q]]);
        }
    return place;
}

SBI_API sb_real sbi_lattice_barycentrics(const sb_vec3 x[4], sb_vec3 p, sb_real at[4])
{
    sb_vec3 e = sb_v3_sub(x[1], x[0]), f = sb_v3_sub(x[2], x[0]), g = sb_v3_sub(x[3], x[0]), q = sb_v3_sub(p, x[0]);
    sb_real volume = sb_v3_dot(sb_v3_cross(e, f), g);
    if (volume == 0)
        return -SB_REAL_MAX;
    at[1] = sb_v3_dot(sb_v3_cross(q, f), g) / volume;
    at[2] = sb_v3_dot(sb_v3_cross(e, q), g) / volume;
    at[3] = sb_v3_dot(sb_v3_cross(e, f), q) / volume;
    at[0] = 1 - at[1] - at[2] - at[3];
    return sb_min(sb_min(at[0], at[1]), sb_min(at[2], at[3]));
}

SBI_API void sbi_lattice_point(const sbi_lattice *lattice, int point, sb_real barycentrics[4])
{
    for (int a = 0; a < 4; a++)
        barycentrics[a] = (sb_real)lattice->points[point][a] / (sb_real)lattice->intervals; /* exact */
}

/* ---- pieces ---- */

SBI_API int sbi_lattice_link_corners(const sbi_lattice *lattice, int link)
{
    const signed char *first = lattice->points[lattice->links[link][0]];
    const signed char *last = lattice->points[lattice->links[link][1]];
    int corners = 0;
    for (int a = 0; a < 4; a++)
        corners |= (first[a] != 0 || last[a] != 0) << a;
    return corners;
}

SBI_API int sbi_lattice_pieces(const sbi_lattice *lattice, const unsigned char *cut, uint64_t points,
                               uint64_t pieces[SBI_LATTICE_POINTS])
{
    uint64_t joined[SBI_LATTICE_POINTS];
    int count = 0;
    memset(joined, 0, sizeof joined);
    for (int l = 0; l < lattice->link_count; l++)
        if (!cut[l]) {
            joined[lattice->links[l][0]] |= (uint64_t)1 << lattice->links[l][1];
            joined[lattice->links[l][1]] |= (uint64_t)1 << lattice->links[l][0];
        }
    for (int first = 0; first < lattice->point_count; first++) {
        uint64_t piece = (uint64_t)1 << first, before = 0;
        if (!(points & piece))
            continue;
        while (piece != before) {
            before = piece;
            for (int p = first; p < lattice->point_count; p++)
                if (piece >> p & 1)
                    piece |= joined[p] & points;
        }
        points &= ~piece;
        pieces[count++] = piece;
    }
    return count;
}

/* Corners of a face in ascending order of their nodes. */
static void sbi_lattice_sort_face(const sbi_lattice *lattice, const sbi_corner_order *order, int face, int sorted[3])
{
    int count = 0;
    for (int i = 0; i < 4; i++)
        if (lattice->face_points[face] >> order->corners[i] & 1)
            sorted[count++] = order->corners[i];
}

/* Place of a point in a face, whose rows are i of the second corner, j of the third. */
static int sbi_lattice_place_in_face(const sbi_lattice *lattice, const int sorted[3], int point)
{
    int i = lattice->points[point][sorted[1]], j = lattice->points[point][sorted[2]];
    return i * (2 * lattice->intervals + 3 - i) / 2 + j;
}

SBI_API unsigned sbi_lattice_face_marks(const sbi_lattice *lattice, const sbi_corner_order *order, int face,
                                        uint64_t piece)
{
    uint64_t on = piece & lattice->face_points[face];
    int sorted[3];
    unsigned marks = 0;
    sbi_lattice_sort_face(lattice, order, face, sorted);
    for (int p = 0; on; p++, on >>= 1)
        if (on & 1)
            marks |= 1u << sbi_lattice_place_in_face(lattice, sorted, p);
    return marks;
}

SBI_API void sbi_lattice_face_places(const sbi_lattice *lattice, const sbi_corner_order *order, int face,
                                     signed char places[SBI_LATTICE_POINTS])
{
    int sorted[3];
    sbi_lattice_sort_face(lattice, order, face, sorted);
    for (int p = 0; p < lattice->point_count; p++)
        if (lattice->face_points[face] >> p & 1)
            places[p] = (signed char)sbi_lattice_place_in_face(lattice, sorted, p);
}

SBI_API void sbi_lattice_find_ringed(const sbi_lattice *lattice, const unsigned char *cut, unsigned char *ringed)
{
    static const signed char triangles[4][3] = {{0, 1, 2}, {0, 4, 3}, {1, 5, 4}, {2, 5, 3}}; /* their edges */
    memset(ringed, 1, (size_t)lattice->link_count);
    for (int k = 0; k < lattice->micro_count; k++)
        for (int f = 0; f < 4; f++) {
            const unsigned char *links = lattice->micro_links[k];
            int count = 0;
            for (int e = 0; e < 3; e++)
                count += cut[links[(int)triangles[f][e]]] != 0;
            for (int e = 0; e < 3 && count != 1; e++)
                ringed[links[(int)triangles[f][e]]] = 0;
        }
}
