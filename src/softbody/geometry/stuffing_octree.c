/* stuffing_octree: 2. cells merge away from changes of label; the tets between their centres and edges. */
#include "stuffing_private.h"

/* ---- 2. octree and tets ---- */

SBI_API sb_result sbi_stuffing_find_surface(sbi_stuffing *s)
{
    ptrdiff_t offset[2][SBI_STUFF_EDGES];
    size_t begin = 2 * (s->stride[2] + s->stride[1] + 1), end = s->point_count - begin;
    if (!sbi_stuffing_set_make(s, &s->surface))
        return sbi_stuffing_no_memory(s);
    for (int odd = 0; odd < 2; odd++)
        for (int edge = 0; edge < SBI_STUFF_EDGES; edge++) {
            int from[3] = {2 + odd, 2 + odd, 2 + odd}, step[3];
            ptrdiff_t start = (ptrdiff_t)sbi_stuffing_index(s, from);
            sbi_stuffing_step(edge, step);
            for (int axis = 0; axis < 3; axis++)
                from[axis] += step[axis];
            offset[odd][edge] = (ptrdiff_t)sbi_stuffing_index(s, from) - start;
        }
    for (size_t p = begin; p < end; p++) /* the rim has one label: nothing to find there, and none beyond it */
        for (int edge = 0; edge < SBI_STUFF_EDGES; edge++) {
            size_t q = (size_t)((ptrdiff_t)p + offset[p & 1][edge]);
            if (s->labels[p] != s->labels[q]) {
                sbi_stuffing_set_add(&s->surface, p);
                sbi_stuffing_set_add(&s->surface, q);
            }
        }
    if (!sbi_stuffing_set_number(&s->surface))
        return sbi_fail(s->error, SB_ERROR_ARGUMENT, "cells of %g m make too many nodes", (double)s->def->cell);
    return SB_OK;
}

static size_t sbi_stuffing_cell_index(const sbi_stuffing *s, int level, const int cell[3])
{
    size_t nx = (size_t)(s->n[0] >> level), ny = (size_t)(s->n[1] >> level);
    return (size_t)cell[0] + nx * ((size_t)cell[1] + ny * (size_t)cell[2]);
}

static int sbi_stuffing_cell_is_in(const sbi_stuffing *s, int level, const int cell[3])
{
    for (int axis = 0; axis < 3; axis++)
        if (cell[axis] < 0 || cell[axis] >= s->n[axis] >> level)
            return 0;
    return 1;
}

static int sbi_stuffing_is_split(const sbi_stuffing *s, int level, const int cell[3])
{
    return level > 0 && s->split[level][sbi_stuffing_cell_index(s, level, cell)];
}

/* Whether the cell is there at all: a leaf or split, not part of a larger leaf. */
static int sbi_stuffing_exists(const sbi_stuffing *s, int level, const int cell[3])
{
    int parent[3];
    for (int axis = 0; axis < 3; axis++)
        parent[axis] = cell[axis] >> 1;
    return level == s->def->levels || sbi_stuffing_is_split(s, level + 1, parent);
}

/* Sees to it that a cell of this level exists. */
static void sbi_stuffing_need(sbi_stuffing *s, int level, const int cell[3])
{
    int parent[3];
    if (level >= s->def->levels || !sbi_stuffing_cell_is_in(s, level, cell))
        return;
    for (int axis = 0; axis < 3; axis++)
        parent[axis] = cell[axis] >> 1;
    s->split[level + 1][sbi_stuffing_cell_index(s, level + 1, parent)] = 1;
}

/* All tets at a point that is cut or may be warped must be of the smallest cells: those round a corner, or the cell of
 * a centre and its six neighbours. */
static void sbi_stuffing_need_around(sbi_stuffing *s, const int half[3])
{
    int cell[3];
    if (half[0] & 1) {
        for (int axis = 0; axis < 3; axis++)
            cell[axis] = half[axis] >> 1;
        sbi_stuffing_need(s, 0, cell);
        for (int face = 0; face < 6; face++) {
            cell[face >> 1] += face & 1 ? 1 : -1;
            sbi_stuffing_need(s, 0, cell);
            cell[face >> 1] -= face & 1 ? 1 : -1;
        }
        return;
    }
    for (int c = 0; c < 8; c++) {
        for (int axis = 0; axis < 3; axis++)
            cell[axis] = (half[axis] >> 1) - (c >> axis & 1);
        sbi_stuffing_need(s, 0, cell);
    }
}

/* Splits what must be split for one level: the parents of split cells, and, so that leaves which share an edge differ
 * by a factor of two at most, the parents of the 18 cells round them. */
static void sbi_stuffing_balance(sbi_stuffing *s, int level)
{
    int cell[3], near_by[3];
    for (cell[2] = 0; cell[2] < s->n[2] >> level; cell[2]++)
        for (cell[1] = 0; cell[1] < s->n[1] >> level; cell[1]++)
            for (cell[0] = 0; cell[0] < s->n[0] >> level; cell[0]++) {
                if (!sbi_stuffing_is_split(s, level, cell))
                    continue;
                for (int d = 0; d < 27; d++) {
                    int step[3] = {d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1};
                    if (step[0] && step[1] && step[2])
                        continue;
                    for (int axis = 0; axis < 3; axis++)
                        near_by[axis] = cell[axis] + step[axis];
                    sbi_stuffing_need(s, level, near_by);
                }
            }
}

SBI_API sb_result sbi_stuffing_grade(sbi_stuffing *s)
{
    for (int level = 1; level <= s->def->levels; level++) {
        size_t count = (size_t)(s->n[0] >> level) * (size_t)(s->n[1] >> level) * (size_t)(s->n[2] >> level);
        s->split[level] = (unsigned char *)sbi_alloc_zeroed(&s->def->allocator, count, 1);
        if (!s->split[level])
            return sbi_stuffing_no_memory(s);
    }
    for (size_t w = 0; s->def->levels > 0 && w < s->surface.word_count; w++)
        for (int bit = 0; bit < 64 && s->surface.words[w]; bit++)
            if (s->surface.words[w] >> bit & 1) {
                int half[3];
                sbi_stuffing_coordinates(s, 64 * w + (size_t)bit, half);
                sbi_stuffing_need_around(s, half);
            }
    for (int level = 1; level < s->def->levels; level++)
        sbi_stuffing_balance(s, level);
    return SB_OK;
}

/* Takes a tet of the lattice in, unless it lies outside: counts it and its points in the first pass, stores it in the
 * second. */
static void sbi_stuffing_add_tet(sbi_stuffing *s, const int *a, const int *b, const int *c, const int *d)
{
    size_t p[4];
    p[0] = sbi_stuffing_index(s, a);
    p[1] = sbi_stuffing_index(s, b);
    p[2] = sbi_stuffing_index(s, c);
    p[3] = sbi_stuffing_index(s, d);
    if (!(s->labels[p[0]] | s->labels[p[1]] | s->labels[p[2]] | s->labels[p[3]]))
        return;
    for (int i = 0; i < 4; i++) {
        if (s->tets)
            s->tets[4 * (size_t)s->tet_count + (size_t)i] = sbi_stuffing_set_rank(&s->active, p[i]);
        else
            sbi_stuffing_set_add(&s->active, p[i]);
    }
    s->tet_count += s->tet_count < INT_MAX;
}

/* A face of a leaf: its cell, the direction it looks in, and the axes along it. */
typedef struct sbi_stuffing_face {
    int level, size; /* of the cell; half cells */
    int cell[3], beyond[3];
    int axis, side, t1, t2;
    int centre[3], low[3]; /* of the cell; of the face */
} sbi_stuffing_face;

/* Corner (i, j) of a face, in units of half its edge: 0, 1, 2. */
static void sbi_stuffing_on_face(const sbi_stuffing_face *f, int i, int j, int half[3])
{
    half[f->axis] = f->low[f->axis];
    half[f->t1] = f->low[f->t1] + i * f->size / 2;
    half[f->t2] = f->low[f->t2] + j * f->size / 2;
}

/* The neighbour is larger: two half pyramids, cut from the middle of its face to its corner. */
static void sbi_stuffing_half_pyramids(sbi_stuffing *s, const sbi_stuffing_face *f)
{
    int i = f->cell[f->t1] & 1 ? 0 : 2, j = f->cell[f->t2] & 1 ? 0 : 2; /* corner at the middle of the large face */
    int middle[3], corner[3], side[3];
    sbi_stuffing_on_face(f, i, j, middle);
    sbi_stuffing_on_face(f, 2 - i, 2 - j, corner);
    sbi_stuffing_on_face(f, 2 - i, j, side);
    sbi_stuffing_add_tet(s, f->centre, middle, corner, side);
    sbi_stuffing_on_face(f, i, 2 - j, side);
    sbi_stuffing_add_tet(s, f->centre, middle, corner, side);
}

/* The neighbours are smaller: eight tets round the middle of the face. */
static void sbi_stuffing_pyramid_of_eight(sbi_stuffing *s, const sbi_stuffing_face *f)
{
    static const int ring[9][2] = {{0, 0}, {1, 0}, {2, 0}, {2, 1}, {2, 2}, {1, 2}, {0, 2}, {0, 1}, {0, 0}};
    int middle[3], a[3], b[3];
    sbi_stuffing_on_face(f, 1, 1, middle);
    for (int k = 0; k < 8; k++) {
        sbi_stuffing_on_face(f, ring[k][0], ring[k][1], a);
        sbi_stuffing_on_face(f, ring[k + 1][0], ring[k + 1][1], b);
        sbi_stuffing_add_tet(s, f->centre, middle, a, b);
    }
}

/* Whether smaller cells put a point in the middle of the edge of a face at side +-1 along t1 (or t2). */
static int sbi_stuffing_has_midpoint(const sbi_stuffing *s, const sbi_stuffing_face *f, int tangent, int side)
{
    int a[3], b[3];
    if (f->level == 0)
        return 0;
    memcpy(a, f->cell, sizeof a);
    memcpy(b, f->beyond, sizeof b);
    a[tangent] += side;
    b[tangent] += side;
    return (sbi_stuffing_cell_is_in(s, f->level, a) && sbi_stuffing_is_split(s, f->level, a)) ||
           (sbi_stuffing_cell_is_in(s, f->level, b) && sbi_stuffing_is_split(s, f->level, b));
}

/* The neighbour is as large: a tet from centre to centre and each edge of the face, or two where the edge is halved. */
static void sbi_stuffing_between_centres(sbi_stuffing *s, const sbi_stuffing_face *f)
{
    int other[3], a[3], b[3], middle[3];
    memcpy(other, f->centre, sizeof other);
    other[f->axis] += f->side * f->size;
    for (int k = 0; k < 4; k++) {
        int along_t2 = k >> 1, end = k & 1 ? 2 : 0; /* the edge at `end` of the axis that it does not run along */
        sbi_stuffing_on_face(f, along_t2 ? end : 0, along_t2 ? 0 : end, a);
        sbi_stuffing_on_face(f, along_t2 ? end : 2, along_t2 ? 2 : end, b);
        if (!sbi_stuffing_has_midpoint(s, f, along_t2 ? f->t1 : f->t2, end - 1)) {
            sbi_stuffing_add_tet(s, f->centre, other, a, b);
            continue;
        }
        for (int axis = 0; axis < 3; axis++)
            middle[axis] = (a[axis] + b[axis]) / 2;
        sbi_stuffing_add_tet(s, f->centre, other, a, middle);
        sbi_stuffing_add_tet(s, f->centre, other, middle, b);
    }
}

static void sbi_stuffing_face_tets(sbi_stuffing *s, int level, const int cell[3], int axis, int side)
{
    sbi_stuffing_face f;
    f.level = level;
    f.size = 2 << level;
    f.axis = axis;
    f.side = side;
    f.t1 = (axis + 1) % 3;
    f.t2 = (axis + 2) % 3;
    memcpy(f.cell, cell, sizeof f.cell);
    memcpy(f.beyond, cell, sizeof f.beyond);
    f.beyond[axis] += side;
    if (!sbi_stuffing_cell_is_in(s, level, f.beyond))
        return;
    for (int i = 0; i < 3; i++) {
        f.low[i] = f.size * cell[i];
        f.centre[i] = f.low[i] + f.size / 2;
    }
    f.low[axis] += side > 0 ? f.size : 0;
    if (!sbi_stuffing_exists(s, level, f.beyond))
        sbi_stuffing_half_pyramids(s, &f);
    else if (sbi_stuffing_is_split(s, level, f.beyond))
        sbi_stuffing_pyramid_of_eight(s, &f);
    else if (side > 0)
        sbi_stuffing_between_centres(s, &f);
}

/* All tets of the leaves. */
static void sbi_stuffing_walk(sbi_stuffing *s)
{
    s->tet_count = 0;
    for (int level = 0; level <= s->def->levels; level++) {
        int cell[3];
        for (cell[2] = 0; cell[2] < s->n[2] >> level; cell[2]++)
            for (cell[1] = 0; cell[1] < s->n[1] >> level; cell[1]++)
                for (cell[0] = 0; cell[0] < s->n[0] >> level; cell[0]++) {
                    if (!sbi_stuffing_exists(s, level, cell) || sbi_stuffing_is_split(s, level, cell))
                        continue;
                    for (int face = 0; face < 6; face++)
                        sbi_stuffing_face_tets(s, level, cell, face >> 1, face & 1 ? 1 : -1);
                }
    }
}

/* Visits the members of a set in order: position, label and surface point of each active point. */
static void sbi_stuffing_place_points(sbi_stuffing *s)
{
    int next = 0, surface = 0;
    for (size_t p = 0; p < s->point_count; p++) {
        int half[3];
        if (s->active.words[p >> 6] == 0) {
            p |= 63;
            continue;
        }
        if (!sbi_stuffing_set_has(&s->active, p))
            continue;
        sbi_stuffing_coordinates(s, p, half);
        s->positions[next] = sbi_stuffing_position(s, half);
        s->active_label[next] = s->labels[p];
        s->point_of[next] = -1;
        if (sbi_stuffing_set_has(&s->surface, p)) {
            sbi_stuffing_point *point = s->points + surface;
            memset(point, 0, sizeof *point);
            memcpy(point->half, half, sizeof half);
            point->label = s->labels[p];
            point->active = next;
            s->point_of[next] = surface++;
        }
        next++;
    }
}

SBI_API sb_result sbi_stuffing_enumerate(sbi_stuffing *s)
{
    const sb_allocator *allocator = &s->def->allocator;
    size_t shapes = (size_t)s->def->shape_count, points;
    if (!sbi_stuffing_set_make(s, &s->active))
        return sbi_stuffing_no_memory(s);
    sbi_stuffing_walk(s);
    if (s->tet_count == 0)
        return sbi_fail(s->error, SB_ERROR_MESH,
                        "nothing to mesh: no point of a lattice of cells of %g m lies inside the first shape",
                        (double)s->def->cell);
    if (s->tet_count / 4 > s->def->max_elements || !sbi_stuffing_set_number(&s->active))
        return sbi_stuffing_too_many(s);
    points = (size_t)s->active.count;
    s->tets = (int *)sbi_alloc(allocator, (size_t)s->tet_count, 4 * sizeof(int));
    s->positions = (sb_vec3 *)sbi_alloc(allocator, points, sizeof(sb_vec3));
    s->active_label = (unsigned char *)sbi_alloc(allocator, points, 1);
    s->point_of = (int *)sbi_alloc(allocator, points, sizeof(int));
    s->points = (sbi_stuffing_point *)sbi_alloc(allocator, (size_t)s->surface.count, sizeof *s->points);
    s->values = (sb_real *)sbi_alloc(allocator, (size_t)s->surface.count, shapes * sizeof(sb_real));
    if (!s->tets || !s->positions || !s->active_label || !s->point_of || !s->points || !s->values)
        return sbi_stuffing_no_memory(s);
    sbi_stuffing_walk(s);
    sbi_stuffing_place_points(s);
    return SB_OK;
}
