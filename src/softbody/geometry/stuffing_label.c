/* stuffing_label: 1. the shape that each point of the lattice lies in. */
#include "stuffing_private.h"

/* ---- 1. labels ---- */

/* A cube of the lattice on its way down to single cells: which shapes are decided, and which contain it. */
typedef struct sbi_stuffing_cube {
    int low[3], size; /* half cells; points lie in [low, low + size - 1] */
    uint64_t known, inside;
} sbi_stuffing_cube;

/* Whether a shape contains a point, decided only when its surface is farther away than `reach` (m; 0: anyhow): 1 or 0,
 * or -1: not decided; -2: the distance is not finite. */
static int sbi_stuffing_contains(const sbi_stuffing *s, int shape, sb_vec3 p, sb_real reach)
{
    const sb_shape *g = s->def->shapes + shape;
    sb_real slope = sbi_stuffing_slope(s, shape), value;
    if (g->surface && reach > 0 && sb_surface_closest(g->surface, p, reach, NULL))
        return -1;
    if (g->surface)
        return sbi_stuffing_encloses(s, shape, p, reach);
    if (reach > 0 && slope == 0)
        return -1;
    value = sbi_stuffing_value(s, shape, p);
    if (!sb_is_finite(value))
        return -2;
    return reach > 0 && sb_abs(value) <= slope * reach ? -1 : value < 0;
}

/* Asks the shapes that are not decided yet; `reach` is how far the cube's points lie from p. */
static void sbi_stuffing_ask(const sbi_stuffing *s, sb_vec3 p, sb_real reach, sbi_stuffing_cube *cube,
                             sbi_stuffing_failure *failure)
{
    for (int shape = 0; shape < s->def->shape_count; shape++) {
        uint64_t bit = (uint64_t)1 << shape;
        int inside = cube->known & bit ? -1 : sbi_stuffing_contains(s, shape, p, reach);
        if (inside == -2) {
            failure->shape = shape;
            failure->at = p;
            return;
        }
        if (inside < 0)
            continue;
        cube->known |= bit;
        cube->inside |= inside ? bit : 0;
        if (shape == 0 && !inside) { /* the others do not matter */
            cube->known = ~(uint64_t)0;
            return;
        }
    }
}

static void sbi_stuffing_fill(sbi_stuffing *s, unsigned char label, const int low[3], const int high[3])
{
    int half[3];
    for (half[2] = low[2]; half[2] < high[2]; half[2] += 2)
        for (half[1] = low[1]; half[1] < high[1]; half[1] += 2) {
            half[0] = low[0];
            memset(s->labels + sbi_stuffing_index(s, half), label, (size_t)(high[0] - half[0]));
        }
}

/* One cell: its lower corner and its centre. */
static void sbi_stuffing_label_cell(sbi_stuffing *s, const sbi_stuffing_cube *cube, sbi_stuffing_failure *failure)
{
    for (int odd = 0; odd < 2; odd++) {
        sbi_stuffing_cube point = *cube;
        for (int axis = 0; axis < 3; axis++)
            point.low[axis] += odd;
        sbi_stuffing_ask(s, sbi_stuffing_position(s, point.low), 0, &point, failure);
        s->labels[sbi_stuffing_index(s, point.low)] = sbi_stuffing_label(point.inside);
    }
}

/* Two cells at each end of the lattice stay outside, whatever rounding makes of shapes far from the origin: all edges
 * between labels then belong to points off the rim. */
static void sbi_stuffing_label_cube(sbi_stuffing *s, sbi_stuffing_cube cube, sbi_stuffing_failure *failure)
{
    uint64_t all = ~(uint64_t)0 >> (64 - s->def->shape_count);
    int low[3], high[3];
    if (failure->shape >= 0)
        return;
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = sbi_max_int(cube.low[axis], 4);
        high[axis] = sbi_min_int(cube.low[axis] + cube.size, 2 * s->n[axis] - 2);
        if (low[axis] >= high[axis])
            return;
    }
    if (cube.size == 2) {
        sbi_stuffing_label_cell(s, &cube, failure);
        return;
    }
    if ((cube.known & all) != all) {
        int middle[3];
        for (int axis = 0; axis < 3; axis++)
            middle[axis] = cube.low[axis] + cube.size / 2;
        /* half the diagonal, and a little for rounding; no point is farther from the middle */
        sbi_stuffing_ask(s, sbi_stuffing_position(s, middle), (sb_real)0.8661 * s->half * (sb_real)cube.size, &cube,
                         failure);
    }
    if ((cube.known & all) == all) {
        sbi_stuffing_fill(s, sbi_stuffing_label(cube.inside), low, high);
        return;
    }
    for (int child = 0; child < 8; child++) {
        sbi_stuffing_cube part = cube;
        part.size = cube.size / 2;
        for (int axis = 0; axis < 3; axis++)
            part.low[axis] += child >> axis & 1 ? part.size : 0;
        sbi_stuffing_label_cube(s, part, failure);
    }
}

static int sbi_stuffing_blocks(const sbi_stuffing *s, int axis)
{
    return (2 * s->n[axis] + 2 + SBI_STUFF_BLOCK - 1) / SBI_STUFF_BLOCK;
}

static void sbi_stuffing_label_task(void *user, int index)
{
    sbi_stuffing *s = (sbi_stuffing *)user;
    sbi_stuffing_cube cube;
    int along = sbi_stuffing_blocks(s, 0);
    cube.size = SBI_STUFF_BLOCK;
    cube.low[0] = SBI_STUFF_BLOCK * (index % along);
    cube.low[1] = SBI_STUFF_BLOCK * (index / along);
    cube.low[2] = SBI_STUFF_BLOCK * s->first;
    cube.known = cube.inside = 0;
    sbi_stuffing_label_cube(s, cube, s->failures + index);
}

SBI_API sb_result sbi_stuffing_sample(sbi_stuffing *s)
{
    int layers = sbi_stuffing_blocks(s, 2), count = sbi_stuffing_blocks(s, 0) * sbi_stuffing_blocks(s, 1);
    sb_result result = SB_OK;
    s->labels = (unsigned char *)sbi_alloc_zeroed(&s->def->allocator, s->point_count, 1);
    s->failures =
        (sbi_stuffing_failure *)sbi_alloc(&s->def->allocator, (size_t)sbi_max_int(count, 64), sizeof *s->failures);
    if (!s->labels || !s->failures)
        return sbi_stuffing_no_memory(s);
    for (s->first = 0; s->first < layers && result == SB_OK; s->first++) {
        result = sbi_stuffing_progress(s, 0.5 * s->first / layers);
        if (result == SB_OK)
            result = sbi_stuffing_run(s, sbi_stuffing_label_task, count);
    }
    return result;
}
