/* knife.h: cuts a body of tets by part of a plane into pieces on copies of nodes, for tests: slow and simple, with no
 * thought of bodies that were cut before. */
#ifndef KNIFE_H
#define KNIFE_H

#include "check.h"
#include "scene.h"

enum { KNIFE_MOST_AROUND = 256 };

/* The plane normal . x = offset, where its points have reach . x > from. Nodes in it are below. */
typedef struct knife {
    sb_vec3 normal, reach;
    double offset, from;
} knife;

static inline double knife_dot(sb_vec3 a, sb_vec3 b)
{
    return (double)a.x * (double)b.x + (double)a.y * (double)b.y + (double)a.z * (double)b.z;
}

/* The whole plane. */
static inline knife knife_plane(sb_vec3 normal, double offset)
{
    knife k;
    k.normal = normal;
    k.offset = offset;
    k.reach = sb_v3(0, 0, 0);
    k.from = -1;
    return k;
}

static inline int knife_above(const knife *k, sb_vec3 x) { return knife_dot(k->normal, x) > k->offset; }

/* Where an edge crosses the plane, 0 at its first end. */
static inline sb_real knife_cross(const knife *k, sb_vec3 a, sb_vec3 b)
{
    double da = knife_dot(k->normal, a) - k->offset, db = knife_dot(k->normal, b) - k->offset, t = da / (da - db);
    return (sb_real)(t < 0 ? 0 : t > 1 ? 1 : t);
}

/* Corner of a tet in its own coordinates. */
static inline sb_vec3 knife_corner(int i) { return sb_v3(REAL(i == 1), REAL(i == 2), REAL(i == 3)); }

/* Where the edge from corner i to corner j of a tet at x crosses the plane, in the tet's coordinates. */
static inline sb_vec3 knife_point(const knife *k, const sb_vec3 *x, int i, int j)
{
    sb_vec3 a = knife_corner(i);
    return sb_v3_madd(a, knife_cross(k, x[i], x[j]), sb_v3_sub(knife_corner(j), a));
}

/* ---- volumes ---- */

typedef struct knife_sums {
    double volume, first[3], second[3][3];
} knife_sums;

/* Adds a tet; places from an origin near by. */
static inline void knife_add_tet(knife_sums *sums, sb_vec3 origin, sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    sb_vec3 corner[4];
    double x[4][3], sum[3] = {0, 0, 0}, e[3][3], v;
    corner[0] = sb_v3_sub(a, origin), corner[1] = sb_v3_sub(b, origin);
    corner[2] = sb_v3_sub(c, origin), corner[3] = sb_v3_sub(d, origin);
    for (int k = 0; k < 4; k++) {
        x[k][0] = (double)corner[k].x, x[k][1] = (double)corner[k].y, x[k][2] = (double)corner[k].z;
        for (int i = 0; i < 3; i++)
            sum[i] += x[k][i];
    }
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++)
            e[k][i] = x[k + 1][i] - x[0][i];
    v = fabs(e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) + e[0][1] * (e[1][2] * e[2][0] - e[1][0] * e[2][2]) +
             e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])) /
        6;
    sums->volume += v;
    for (int i = 0; i < 3; i++) {
        sums->first[i] += v * sum[i] / 4;
        for (int j = 0; j < 3; j++) {
            double squares = sum[i] * sum[j];
            for (int k = 0; k < 4; k++)
                squares += x[k][i] * x[k][j];
            sums->second[i][j] += v * squares / 20;
        }
    }
}

/* The tets of a part of a tet: three of a wedge, or one. */
typedef struct knife_part {
    int count;
    sb_vec3 tets[3][4];
} knife_part;

static inline void knife_put_tet(knife_part *part, sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    sb_vec3 *tet = part->tets[part->count++];
    tet[0] = a, tet[1] = b, tet[2] = c, tet[3] = d;
}

/* Between triangles a0 a1 a2 and b0 b1 b2. */
static inline void knife_put_wedge(knife_part *part, const sb_vec3 a[3], const sb_vec3 b[3])
{
    knife_put_tet(part, a[0], a[1], a[2], b[0]);
    knife_put_tet(part, a[1], a[2], b[0], b[1]);
    knife_put_tet(part, a[2], b[0], b[1], b[2]);
}

/* What of the tet at x is on the side of the corners in the mask, in its coordinates. */
static inline knife_part knife_split(const knife *k, const sb_vec3 *x, int mask)
{
    int in[4], out[4], ins = 0, outs = 0;
    sb_vec3 a[3], b[3];
    knife_part part;
    memset(&part, 0, sizeof part);
    for (int i = 0; i < 4; i++) {
        if (mask >> i & 1)
            in[ins++] = i;
        else
            out[outs++] = i;
    }
    if (ins == 4) {
        knife_put_tet(&part, knife_corner(0), knife_corner(1), knife_corner(2), knife_corner(3));
    } else if (ins == 1) {
        knife_put_tet(&part, knife_corner(in[0]), knife_point(k, x, in[0], out[0]), knife_point(k, x, in[0], out[1]),
                      knife_point(k, x, in[0], out[2]));
    } else if (ins == 3) {
        for (int i = 0; i < 3; i++) {
            a[i] = knife_corner(in[i]);
            b[i] = knife_point(k, x, in[i], out[0]);
        }
        knife_put_wedge(&part, a, b);
    } else {
        a[0] = knife_corner(in[0]), b[0] = knife_corner(in[1]);
        for (int i = 0; i < 2; i++) {
            a[i + 1] = knife_point(k, x, in[0], out[i]);
            b[i + 1] = knife_point(k, x, in[1], out[i]);
        }
        knife_put_wedge(&part, a, b);
    }
    return part;
}

/* ---- pieces ---- */

typedef struct knife_piece {
    int tet, mask, cell; /* mask: corners; cell: number in the body, once it was cut */
    int nodes[10];
    knife_part part;
    double share;
    sb_cell_moments moments;
} knife_piece;

typedef struct knife_cut {
    const sb_mesh *mesh;
    knife blade;
    knife_piece *pieces; /* by tet; uncut ones are one piece */
    int count, copies;
    int *copy_of; /* [node of the body - those of the mesh] */
} knife_cut;

static inline void knife_measure(knife_piece *piece)
{
    knife_sums sums;
    sb_vec3 near_by = piece->part.tets[0][0];
    memset(&piece->moments, 0, sizeof piece->moments);
    piece->moments.centroid = near_by;
    for (int pass = 0; pass < 2; pass++) { /* the second about the centroid */
        memset(&sums, 0, sizeof sums);
        for (int t = 0; t < piece->part.count; t++) {
            const sb_vec3 *y = piece->part.tets[t];
            knife_add_tet(&sums, piece->moments.centroid, y[0], y[1], y[2], y[3]);
        }
        if (pass == 0 && sums.volume > 0)
            piece->moments.centroid =
                sb_v3_add(near_by, sb_v3((sb_real)(sums.first[0] / sums.volume), (sb_real)(sums.first[1] / sums.volume),
                                         (sb_real)(sums.first[2] / sums.volume)));
    }
    piece->share = 6 * sums.volume;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3 && sums.volume > 0; j++)
            piece->moments.covariance.m[i][j] = (sb_real)(sums.second[i][j] / sums.volume);
}

/* Pieces of all tets. */
static inline void knife_make_pieces(knife_cut *cut)
{
    const sb_mesh *mesh = cut->mesh;
    int n = mesh->element_type == SB_TET4 ? 4 : 10;
    cut->pieces = (knife_piece *)calloc(2 * (size_t)mesh->element_count, sizeof *cut->pieces);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = mesh->elements + e * n;
        int above = 0, holds = 0;
        sb_vec3 x[4];
        for (int a = 0; a < 4; a++) {
            x[a] = mesh->nodes[nodes[a]];
            above |= knife_above(&cut->blade, x[a]) << a;
        }
        for (int a = 0; a < 4; a++) /* a whole edge across the plane holds the tet together */
            for (int b = 0; b < a; b++)
                if ((above >> a & 1) != (above >> b & 1))
                    holds |= !(knife_dot(cut->blade.reach, sb_v3_madd(x[a], knife_cross(&cut->blade, x[a], x[b]),
                                                                      sb_v3_sub(x[b], x[a]))) > cut->blade.from);
        for (int side = 0; side < 2; side++) {
            int whole = above == 0 || above == 15 || holds;
            knife_piece *piece = cut->pieces + cut->count;
            if (whole && side)
                continue;
            memset(piece, 0, sizeof *piece);
            piece->tet = e;
            piece->mask = whole ? 15 : side ? above : 15 & ~above;
            piece->part = knife_split(&cut->blade, x, piece->mask);
            knife_measure(piece);
            cut->count++;
        }
    }
}

/* Ends of a node: itself, or those of its edge in a tet10. */
static inline void knife_ends(const int *nodes, int local, int ends[2])
{
    int edge[3];
    ends[0] = ends[1] = nodes[local];
    if (local < 4)
        return;
    sb_element_edge(SB_TET10, local - 4, edge);
    ends[0] = nodes[edge[0]];
    ends[1] = nodes[edge[1]];
}

/* 1 when two pieces touch in a face that has both ends: a corner of the face that is in both. */
static inline int knife_touch(const knife_cut *cut, const knife_piece *a, const knife_piece *b, const int ends[2])
{
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10, common = 0, met = 0, found[2] = {0, 0};
    const int *p = cut->mesh->elements + a->tet * n, *q = cut->mesh->elements + b->tet * n;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            if (p[i] == q[j]) {
                common++;
                met |= (a->mask >> i & 1) && (b->mask >> j & 1);
                found[0] |= p[i] == ends[0];
                found[1] |= p[i] == ends[1];
            }
    return a->tet != b->tet && common == 3 && met && found[0] && found[1];
}

/* Index of the piece, of those around a node, that has the material at its place. */
static inline int knife_owner(const knife_cut *cut, const int *around, int count, const int ends[2], sb_vec3 x)
{
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10, side = knife_above(&cut->blade, x);
    for (int k = 0; k < count; k++) {
        const knife_piece *piece = cut->pieces + around[k];
        const int *nodes = cut->mesh->elements + piece->tet * n;
        for (int a = 0; a < 4; a++)
            if (piece->mask >> a & 1 && (nodes[a] == ends[0] || nodes[a] == ends[1]) &&
                (piece->mask == 15 || knife_above(&cut->blade, cut->mesh->nodes[nodes[a]]) == side))
                return k;
    }
    return 0;
}

/* Classes of the pieces around a node: the owner's keeps its number, others get copies. */
static inline sb_result knife_number(knife_cut *cut, sb_body_change *change, const int *around, const int *local,
                                     int count, int flags, sb_error *error)
{
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10, root[KNIFE_MOST_AROUND], ends[2], owner, node;
    const int *nodes = cut->mesh->elements + cut->pieces[around[0]].tet * n;
    node = nodes[local[0]];
    knife_ends(nodes, local[0], ends);
    for (int k = 0; k < count; k++)
        root[k] = k;
    for (int k = 0; k < count; k++)
        for (int j = 0; j < k; j++)
            if (root[j] != root[k] && knife_touch(cut, cut->pieces + around[j], cut->pieces + around[k], ends)) {
                int from = root[k] > root[j] ? root[k] : root[j], to = root[k] < root[j] ? root[k] : root[j];
                for (int i = 0; i < count; i++)
                    root[i] = root[i] == from ? to : root[i];
            }
    owner = root[knife_owner(cut, around, count, ends, cut->mesh->nodes[node])];
    for (int k = 0; k < count; k++) {
        int number = node;
        sb_real one = 1;
        if (root[k] != k)
            continue;
        if (k != owner) {
            sb_result result =
                sb_body_change_add_node(change, cut->mesh->nodes[node], &node, &one, 1, flags, &number, error);
            if (result != SB_OK)
                return result;
            cut->copy_of[number - cut->mesh->node_count] = node;
            cut->copies++;
        }
        for (int i = 0; i < count; i++)
            if (root[i] == k)
                cut->pieces[around[i]].nodes[local[i]] = number;
    }
    return SB_OK;
}

static inline sb_result knife_number_all(knife_cut *cut, sb_body_change *change, int flags, sb_error *error)
{
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10, nodes = cut->mesh->node_count, *start, *around, *local;
    sb_result result = SB_OK;
    start = (int *)calloc((size_t)nodes + 2, sizeof *start);
    around = (int *)calloc(2 * (size_t)(n * cut->count), sizeof *around);
    local = around + n * cut->count;
    for (int k = 0; k < cut->count; k++)
        for (int a = 0; a < n; a++)
            start[cut->mesh->elements[cut->pieces[k].tet * n + a] + 2]++;
    for (int i = 2; i < nodes + 2; i++)
        start[i] += start[i - 1];
    for (int k = 0; k < cut->count; k++)
        for (int a = 0; a < n; a++) {
            int at = start[cut->mesh->elements[cut->pieces[k].tet * n + a] + 1]++;
            around[at] = k;
            local[at] = a;
        }
    for (int i = 0; i < nodes && result == SB_OK; i++)
        result = knife_number(cut, change, around + start[i], local + start[i], start[i + 1] - start[i], flags, error);
    free(start);
    free(around);
    return result;
}

/* Puts the pieces into the change, those without a neighbour in the cell too. */
static inline sb_result knife_put_cells(knife_cut *cut, sb_body_change *change, sb_error *error)
{
    int n = cut->mesh->element_type == SB_TET4 ? 4 : 10;
    sb_result result = SB_OK;
    for (int k = 0; k < cut->count && result == SB_OK; k++) {
        knife_piece *piece = cut->pieces + k;
        sb_change_cell cell = sb_default_change_cell();
        int first = k == 0 || piece[-1].tet != piece->tet;
        piece->cell = piece->tet;
        if (memcmp(piece->nodes, cut->mesh->elements + piece->tet * n, (size_t)n * sizeof(int)) == 0 &&
            piece->mask == 15)
            continue;
        cell.nodes = piece->nodes;
        cell.parent = piece->tet;
        if (piece->mask != 15) {
            cell.share = (sb_real)piece->share;
            cell.moments = &piece->moments;
        }
        result = first ? sb_body_change_replace_cell(change, piece->tet, &cell, error)
                       : sb_body_change_add_cell(change, &cell, &piece->cell, error);
    }
    return result;
}

static inline void knife_free(knife_cut *cut)
{
    free(cut->pieces);
    free(cut->copy_of);
    memset(cut, 0, sizeof *cut);
}

/* Cuts a body that was made from the mesh and not changed since. flags: of the copies. */
static inline sb_result knife_apply(sb_body *body, const sb_mesh *mesh, knife blade, int flags, knife_cut *cut,
                                    sb_error *error)
{
    sb_body_change *change;
    sb_result result;
    memset(cut, 0, sizeof *cut);
    cut->mesh = mesh;
    cut->blade = blade;
    result = sb_body_change_begin(body, &change, error);
    if (result != SB_OK)
        return result;
    knife_make_pieces(cut);
    cut->copy_of = (int *)calloc((size_t)cut->count * 20 + 1, sizeof *cut->copy_of);
    result = knife_number_all(cut, change, SB_NODE_COPY | flags, error);
    if (result == SB_OK)
        result = knife_put_cells(cut, change, error);
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK) {
        sb_body_change_cancel(change);
        knife_free(cut);
    }
    return result;
}

#endif /* KNIFE_H */
