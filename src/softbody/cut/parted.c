/* parted: flags, lips and moments of the pieces of a tet. */
#include "parted.h"

#include <string.h>

#include "../mesh/element.h"

/* The edge between two corners of a micro-tet, and the face opposite to a corner; faces 0 to 3 here are those without
 * corner 3, 2, 0 and 1. */
static const signed char sbi_parted_edge[4][4] = {{-1, 0, 2, 3}, {0, -1, 1, 4}, {2, 1, -1, 5}, {3, 4, 5, -1}};
static const signed char sbi_parted_opposite[4] = {2, 3, 1, 0};
static const signed char sbi_parted_missing[4] = {3, 2, 0, 1};

/* ---- pieces ---- */

SBI_API void sbi_parted_find(sbi_parted *parted)
{
    const sbi_lattice *lattice = parted->lattice;
    parted->piece_count =
        sbi_lattice_pieces(lattice, parted->cut, sbi_lattice_all(lattice) & ~parted->lost, parted->pieces);
    memset(parted->piece_of, SBI_PARTED_LOST, sizeof parted->piece_of);
    for (int k = 0; k < parted->piece_count; k++)
        for (int p = 0; p < lattice->point_count; p++)
            if (parted->pieces[k] >> p & 1)
                parted->piece_of[p] = (unsigned char)k;
}

SBI_API void sbi_parted_make(const sbi_lattice *lattice, const sbi_cut_links *links, const int nodes[4], int tet,
                             sbi_parted *parted)
{
    parted->lattice = lattice;
    parted->order = sbi_corner_order_make(nodes);
    parted->lost = links->lost ? links->lost[tet] : 0;
    for (int l = 0; l < lattice->link_count; l++) {
        sbi_link_key key = sbi_lattice_key(lattice, &parted->order, tet, l);
        int item = sbi_cut_links_find(links, &key);
        parted->cut[l] = (unsigned char)(item < 0 ? (int)SBI_LINK_WHOLE : (int)links->items[item].state);
        parted->rank[l] = item;
        parted->t[l] = item < 0 ? (sb_real)0.5 : links->items[item].t;
    }
    sbi_parted_find(parted);
}

/* ---- points ---- */

/* 1 when a link's ends are of two pieces. */
static int sbi_parted_is_parting(const sbi_parted *parted, int link)
{
    const unsigned char *ends = parted->lattice->links[link];
    int below = parted->piece_of[ends[0]], above = parted->piece_of[ends[1]];
    return below != above && below != SBI_PARTED_LOST && above != SBI_PARTED_LOST;
}

SBI_API int sbi_parted_is_split(const sbi_parted *parted, int micro)
{
    const unsigned char *corners = parted->lattice->micros[micro];
    int piece = parted->piece_of[corners[0]];
    return parted->piece_of[corners[1]] != piece || parted->piece_of[corners[2]] != piece ||
           parted->piece_of[corners[3]] != piece;
}

/* The point of the link between corners v and w of a micro-tet. */
static void sbi_parted_link_point(const sbi_parted *parted, int micro, int v, int w, sb_real least,
                                  sbi_micro_points *points)
{
    const sbi_lattice *lattice = parted->lattice;
    int edge = sbi_parted_edge[v][w], link = lattice->micro_links[micro][edge], ends[2];
    sb_real t = parted->cut[link] ? parted->t[link] : (sb_real)0.5, first[4], last[4];
    t = sb_min(sb_max(t, least), 1 - least);
    sbi_lattice_ends(lattice, &parted->order, link, ends);
    sbi_lattice_point(lattice, ends[0], first);
    sbi_lattice_point(lattice, ends[1], last);
    for (int a = 0; a < 4; a++) {
        points->tet[edge][a] = (1 - t) * first[a] + t * last[a];
        points->micro[edge][a] = 0;
    }
    points->micro[edge][w] = lattice->micros[micro][w] == ends[1] ? t : 1 - t;
    points->micro[edge][v] = lattice->micros[micro][w] == ends[1] ? 1 - t : t;
}

/* Cut links of a micro-tet among its edges in `mask`, in the order in which they were cut; returns how many. */
static int sbi_parted_cut_edges(const sbi_parted *parted, int micro, int mask, int edges[6])
{
    const unsigned char *links = parted->lattice->micro_links[micro];
    int count = 0;
    for (int edge = 0; edge < 6; edge++) {
        int at = count;
        if (!(mask >> edge & 1) || !parted->cut[links[edge]])
            continue;
        for (; at > 0 && parted->rank[links[edges[at - 1]]] > parted->rank[links[edge]]; at--)
            edges[at] = edges[at - 1];
        edges[at] = edge;
        count++;
    }
    return count;
}

/* The point of a face: the mean of the two crossings that parted it, or its centroid. */
static void sbi_parted_face_point(const sbi_parted *parted, int micro, int face, sbi_micro_points *points)
{
    static const int sides[4] = {1 << 0 | 1 << 1 | 1 << 2, 1 << 0 | 1 << 3 | 1 << 4, 1 << 1 | 1 << 4 | 1 << 5,
                                 1 << 2 | 1 << 3 | 1 << 5};
    const sbi_lattice *lattice = parted->lattice;
    const unsigned char *corners = lattice->micros[micro];
    int at = SBI_MICRO_FACES + face, edges[6], missing = sbi_parted_missing[face];
    int parts = sbi_parted_cut_edges(parted, micro, sides[face], edges) >= 2;
    for (int a = 0; a < 4; a++) {
        int sum = 0; /* of the corners, exact */
        for (int v = 0; v < 4; v++)
            sum += v == missing ? 0 : lattice->points[corners[v]][a];
        points->micro[at][a] = a == missing ? 0 : (sb_real)1 / 3;
        points->tet[at][a] = (sb_real)sum / (sb_real)(3 * lattice->intervals);
        if (parts) {
            points->micro[at][a] = (points->micro[edges[0]][a] + points->micro[edges[1]][a]) / 2;
            points->tet[at][a] = (points->tet[edges[0]][a] + points->tet[edges[1]][a]) / 2;
        }
    }
}

/* Corners that hang together with corner 0 of a micro-tet, as a mask, over edges that are not in `cut`. */
static int sbi_parted_reach(int cut)
{
    int reached = 1, before = 0;
    while (reached != before) {
        before = reached;
        for (int v = 0; v < 4; v++)
            for (int w = 0; w < 4; w++)
                if (v != w && (reached >> v & 1) && !(cut >> sbi_parted_edge[v][w] & 1))
                    reached |= 1 << w;
    }
    return reached;
}

/* The centre: the mean of the crossings between the two parts that the corners first fell into. */
static void sbi_parted_centre(const sbi_parted *parted, int micro, sbi_micro_points *points)
{
    int edges[6], cut = 0, reached = 15, found = sbi_parted_cut_edges(parted, micro, 63, edges), count = 0;
    for (int k = 0; k < found && reached == 15; k++) {
        cut |= 1 << edges[k];
        reached = sbi_parted_reach(cut);
    }
    for (int a = 0; a < 4; a++)
        points->micro[SBI_MICRO_CENTRE][a] = points->tet[SBI_MICRO_CENTRE][a] = 0;
    for (int v = 0; v < 4; v++)
        for (int w = v + 1; w < 4; w++) {
            int edge = sbi_parted_edge[v][w];
            if ((reached >> v & 1) == (reached >> w & 1))
                continue;
            count++;
            for (int a = 0; a < 4; a++) {
                points->micro[SBI_MICRO_CENTRE][a] += points->micro[edge][a];
                points->tet[SBI_MICRO_CENTRE][a] += points->tet[edge][a];
            }
        }
    for (int a = 0; a < 4; a++) {
        points->micro[SBI_MICRO_CENTRE][a] /= (sb_real)count;
        points->tet[SBI_MICRO_CENTRE][a] /= (sb_real)count;
    }
}

SBI_API void sbi_parted_points(const sbi_parted *parted, int micro, sb_real least, sbi_micro_points *points)
{
    for (int v = 0; v < 4; v++)
        for (int w = v + 1; w < 4; w++)
            sbi_parted_link_point(parted, micro, v, w, least, points);
    for (int face = 0; face < 4; face++)
        sbi_parted_face_point(parted, micro, face, points);
    sbi_parted_centre(parted, micro, points);
}

/* ---- parts ---- */

static sb_vec3 sbi_parted_xi(const sb_real barycentrics[4])
{
    return sb_v3(barycentrics[1], barycentrics[2], barycentrics[3]);
}

static sb_vec3 sbi_parted_corner(const sbi_lattice *lattice, int point)
{
    sb_real barycentrics[4];
    sbi_lattice_point(lattice, point, barycentrics);
    return sbi_parted_xi(barycentrics);
}

SBI_API int sbi_parted_flags(const sbi_parted *parted, int micro, sb_real least, sbi_flag flags[SBI_FLAGS])
{
    const sbi_lattice *lattice = parted->lattice;
    const unsigned char *corners = lattice->micros[micro];
    sb_real volume = (sb_real)1 / (sb_real)lattice->micro_count;
    sbi_micro_points points;
    int count = 0;
    if (!sbi_parted_is_split(parted, micro)) {
        flags[0].piece = parted->piece_of[corners[0]];
        flags[0].volume = volume;
        for (int v = 0; v < 4; v++)
            flags[0].corners[v] = sbi_parted_corner(lattice, corners[v]);
        return 1;
    }
    sbi_parted_points(parted, micro, least, &points);
    for (int v = 0; v < 4; v++)
        for (int w = 0; w < 4; w++)
            for (int u = 0; u < 4; u++) {
                sbi_flag *flag = flags + count;
                int x = 6 - v - w - u, edge = sbi_parted_edge[v][w], face;
                if (v == w || v == u || w == u)
                    continue;
                face = SBI_MICRO_FACES + sbi_parted_opposite[x];
                flag->piece = parted->piece_of[corners[v]];
                flag->volume =
                    volume * points.micro[edge][w] * points.micro[face][u] * points.micro[SBI_MICRO_CENTRE][x];
                flag->corners[0] = sbi_parted_corner(lattice, corners[v]);
                flag->corners[1] = sbi_parted_xi(points.tet[edge]);
                flag->corners[2] = sbi_parted_xi(points.tet[face]);
                flag->corners[3] = sbi_parted_xi(points.tet[SBI_MICRO_CENTRE]);
                count++;
            }
    return count;
}

/* The piece, of those with flags in a micro-tet, that has the point deepest inside, if deeper than `deepest`; lost 1:
 * or what was taken out. */
static int sbi_parted_deepest(const sbi_parted *parted, int micro, sb_vec3 xi, int lost, int piece, sb_real *deepest)
{
    sbi_flag flags[SBI_FLAGS];
    int count = sbi_parted_flags(parted, micro, 0, flags);
    for (int k = 0; k < count; k++) {
        sb_real of_flag[4], depth = sbi_lattice_barycentrics(flags[k].corners, xi, of_flag);
        if (depth > *deepest && (lost || flags[k].piece != SBI_PARTED_LOST)) {
            piece = flags[k].piece;
            *deepest = depth;
        }
    }
    return piece;
}

/* The micro-tet that has the point deepest inside. */
static int sbi_parted_micro_at(const sbi_parted *parted, sb_vec3 xi)
{
    const sbi_lattice *lattice = parted->lattice;
    sb_real deepest = -SB_REAL_MAX;
    int within = 0;
    for (int micro = 0; micro < lattice->micro_count; micro++) {
        sb_vec3 corners[4];
        sb_real of_micro[4], depth;
        for (int v = 0; v < 4; v++)
            corners[v] = sbi_parted_corner(lattice, lattice->micros[micro][v]);
        depth = sbi_lattice_barycentrics(corners, xi, of_micro);
        within = depth > deepest ? micro : within;
        deepest = sb_max(depth, deepest);
    }
    return within;
}

SBI_API int sbi_parted_owner_at(const sbi_parted *parted, const sb_real at[4])
{
    sb_vec3 xi = sbi_parted_xi(at);
    sb_real deepest = -SB_REAL_MAX;
    return sbi_parted_deepest(parted, sbi_parted_micro_at(parted, xi), xi, 1, SBI_PARTED_LOST, &deepest);
}

SBI_API int sbi_parted_piece_at(const sbi_parted *parted, const sb_real at[4])
{
    const sbi_lattice *lattice = parted->lattice;
    sb_vec3 xi = sbi_parted_xi(at);
    sb_real deepest = -SB_REAL_MAX;
    int within = sbi_parted_micro_at(parted, xi);
    int piece = sbi_parted_deepest(parted, within, xi, 0, parted->piece_of[lattice->micros[within][0]], &deepest);
    if (piece != SBI_PARTED_LOST)
        return piece;
    piece = parted->piece_count > 0 ? 0 : -1;
    for (int micro = 0; micro < lattice->micro_count && parted->piece_count > 1; micro++)
        piece = sbi_parted_deepest(parted, micro, xi, 0, piece, &deepest);
    return piece;
}

SBI_API int sbi_parted_lips(const sbi_parted *parted, int micro, sbi_lip lips[SBI_LIPS])
{
    static const signed char next[4][4] = {
        {0, 2, 3, 1}, {3, 0, 0, 2}, {1, 3, 0, 0}, {2, 0, 1, 0}}; /* v, w, u, x even */
    const unsigned char *corners = parted->lattice->micros[micro];
    sbi_micro_points points;
    int count = 0;
    if (!sbi_parted_is_split(parted, micro))
        return 0;
    sbi_parted_points(parted, micro, 0, &points);
    for (int v = 0; v < 4; v++)
        for (int w = v + 1; w < 4; w++) {
            int edge = sbi_parted_edge[v][w], link = parted->lattice->micro_links[micro][edge];
            int u = next[v][w], x = 6 - v - w - u;
            for (int side = 0; side < 2 && sbi_parted_is_parting(parted, link); side++) {
                sbi_lip *lip = lips + count++;
                int face = SBI_MICRO_FACES + sbi_parted_opposite[side ? u : x];
                lip->below = parted->piece_of[corners[v]];
                lip->above = parted->piece_of[corners[w]];
                lip->link = link;
                lip->place = 2 * edge + side;
                memcpy(lip->corners[0], points.tet[edge], sizeof lip->corners[0]);
                memcpy(lip->corners[side ? 2 : 1], points.tet[face], sizeof lip->corners[0]);
                memcpy(lip->corners[side ? 1 : 2], points.tet[SBI_MICRO_CENTRE], sizeof lip->corners[0]);
            }
        }
    return count;
}

/* ---- moments ---- */

/* Adds volume and first moments of all parts; centres are sums then. */
static void sbi_parted_first_moments(const sbi_parted *parted, sb_real least, sbi_part_moments *moments)
{
    sbi_flag flags[SBI_FLAGS];
    for (int micro = 0; micro < parted->lattice->micro_count; micro++) {
        int count = sbi_parted_flags(parted, micro, least, flags);
        for (int k = 0; k < count; k++) {
            sbi_part_moments *sum = moments + flags[k].piece;
            if (flags[k].piece == SBI_PARTED_LOST)
                continue;
            sum->share += flags[k].volume;
            for (int a = 0; a < 4; a++)
                sum->centre = sb_v3_madd(sum->centre, flags[k].volume / 4, flags[k].corners[a]);
        }
    }
}

/* Adds int (xi - centre)(xi - centre)^T of all parts: of a tet with corners y_i about the centre and volume v it is
 * v/20 (sum y_i y_i^T + s s^T), s the sum of the y_i. */
static void sbi_parted_second_moments(const sbi_parted *parted, sb_real least, sbi_part_moments *moments)
{
    sbi_flag flags[SBI_FLAGS];
    for (int micro = 0; micro < parted->lattice->micro_count; micro++) {
        int count = sbi_parted_flags(parted, micro, least, flags);
        for (int k = 0; k < count; k++) {
            sbi_part_moments *sum = moments + flags[k].piece;
            sb_mat3 about = sb_m3_zero();
            sb_vec3 all = sb_v3(0, 0, 0);
            if (flags[k].piece == SBI_PARTED_LOST)
                continue;
            for (int a = 0; a < 4; a++) {
                sb_vec3 y = sb_v3_sub(flags[k].corners[a], sum->centre);
                all = sb_v3_add(all, y);
                about = sb_m3_add(about, sb_m3_outer(y, y));
            }
            about = sb_m3_add(about, sb_m3_outer(all, all));
            sum->spread = sb_m3_add(sum->spread, sb_m3_scale(flags[k].volume / 20, about));
        }
    }
}

/* Share of a piece that is none: each of its extents is rounding of an edge. Its mass and stiffness may be 0 in float
 * where their inverses are asked for. */
static const sb_real sbi_parted_least = SB_EPSILON * SB_EPSILON * SB_EPSILON;

SBI_API void sbi_parted_shares(const sbi_parted *parted, sb_real least, sb_real *shares)
{
    sbi_flag flags[SBI_FLAGS];
    memset(shares, 0, (size_t)parted->piece_count * sizeof *shares);
    for (int micro = 0; micro < parted->lattice->micro_count; micro++) {
        int count = sbi_parted_flags(parted, micro, least, flags);
        for (int k = 0; k < count; k++)
            if (flags[k].piece != SBI_PARTED_LOST)
                shares[flags[k].piece] += flags[k].volume;
    }
    for (int k = 0; k < parted->piece_count; k++)
        if (shares[k] < sbi_parted_least)
            shares[k] = 0;
}

SBI_API void sbi_parted_moments(const sbi_parted *parted, sb_real least, sbi_part_moments *moments)
{
    memset(moments, 0, (size_t)parted->piece_count * sizeof *moments);
    sbi_parted_first_moments(parted, least, moments);
    for (int k = 0; k < parted->piece_count; k++) {
        int lowest = 0;
        while (!(parted->pieces[k] >> lowest & 1))
            lowest++;
        if (moments[k].share < sbi_parted_least)
            moments[k].share = 0;
        moments[k].centre = moments[k].share > 0 ? sb_v3_scale(1 / moments[k].share, moments[k].centre)
                                                 : sbi_parted_corner(parted->lattice, lowest);
    }
    sbi_parted_second_moments(parted, least, moments);
    for (int k = 0; k < parted->piece_count; k++)
        if (moments[k].share > 0)
            moments[k].spread = sb_m3_scale(1 / moments[k].share, moments[k].spread);
}

/* Adds a triangle of the face that is of a piece, `area` of the face's, with barycentrics of its corners. */
static void sbi_parted_add_face(sbi_face_moments *moments, int piece, sb_real area, const sb_real *a, const sb_real *b,
                                const sb_real *c)
{
    if (piece == SBI_PARTED_LOST)
        return;
    moments[piece].share += area;
    for (int i = 0; i < 4; i++)
        moments[piece].loads[i] += area * (a[i] + b[i] + c[i]) / 3;
    for (int e = 0; e < 6; e++) { /* int L_i L_j of linear functions: (sum of products + sum times sum) / 12 */
        int ends[3], i, j;
        sb_element_edge(SB_TET4, e, ends);
        i = ends[0], j = ends[1];
        moments[piece].products[e] +=
            area * (a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + (a[i] + b[i] + c[i]) * (a[j] + b[j] + c[j])) / 12;
    }
}

/* Adds the face of a micro-tet opposite to corner x. */
static void sbi_parted_add_micro_face(const sbi_parted *parted, int micro, int x, sbi_face_moments *moments)
{
    const sbi_lattice *lattice = parted->lattice;
    const unsigned char *corners = lattice->micros[micro];
    sb_real area = (sb_real)1 / (sb_real)(lattice->intervals * lattice->intervals), at[4][4];
    int a = x == 0 ? 1 : 0, face = SBI_MICRO_FACES + sbi_parted_opposite[x], whole = 1;
    sbi_micro_points points;
    for (int v = 0; v < 4; v++) {
        sbi_lattice_point(lattice, corners[v], at[v]);
        whole &= v == x || parted->piece_of[corners[v]] == parted->piece_of[corners[a]];
    }
    if (whole) {
        int b = x == 0 || x == 1 ? 2 : 1, c = x == 3 ? 2 : 3;
        sbi_parted_add_face(moments, parted->piece_of[corners[a]], area, at[a], at[b], at[c]);
        return;
    }
    sbi_parted_points(parted, micro, 0, &points);
    for (int v = 0; v < 4; v++)
        for (int w = 0; w < 4; w++)
            if (v != w && v != x && w != x) {
                int edge = sbi_parted_edge[v][w], u = 6 - v - w - x;
                sbi_parted_add_face(moments, parted->piece_of[corners[v]],
                                    area * points.micro[edge][w] * points.micro[face][u], at[v], points.tet[edge],
                                    points.tet[face]);
            }
}

SBI_API void sbi_parted_face(const sbi_parted *parted, int face, sbi_face_moments *moments)
{
    const sbi_lattice *lattice = parted->lattice;
    memset(moments, 0, (size_t)parted->piece_count * sizeof *moments);
    for (int micro = 0; micro < lattice->micro_count; micro++)
        for (int x = 0; x < 4; x++) {
            int on = 0;
            for (int v = 0; v < 4; v++)
                on += v != x && (lattice->face_points[face] >> lattice->micros[micro][v] & 1);
            if (on == 3)
                sbi_parted_add_micro_face(parted, micro, x, moments);
        }
}
