/* stuffing: isosurface stuffing with several shapes and graded cells.
 *
 * Points of the lattice have integer coordinates in half cells: corners of cells are even triples, centres odd ones.
 * Every tet of the lattice joins the centres of two cells that share a face with an edge of that face. Corners and
 * centres each are a cubic grid of "long" edges (one cell); "short" edges (sqrt(3)/2) run between the two kinds.
 *
 *   1. label     the shape that each point lies in, 0 outside: a byte per point, space far from surfaces in one go
 *   2. octree    cells round a change of label stay small, others merge; enumerate the tets
 *   3. cut       where edges between labels cross the surface, by root finding
 *   4. warp      points close to a cut move onto it and belong to both sides from then on ("zero" points)
 *   5. stencils  what is still cut falls into tets of one label each
 *
 * Several labels. The stencils know two sides, so every tet must see two labels at most, zeros not counted. A tet
 * with a point outside sees the outside and the rest: the outer boundary is always exact. In it, and in tets that see
 * three labels or more, points become zeros where they are until the rule holds; this shifts the face between inner
 * regions, by less than a cell, and no angle is worse for it: a zero at its lattice point is one of the cases that
 * the angles' bounds were found over. What a point counts as in a face depends on the points of that face and on
 * nothing else that the two tets at the face do not share; so they cut it alike.
 *
 * Source: Labelle and Shewchuk, Isosurface stuffing, 2007; for the parity rule that lets both sides match, the order of
 * prisms and the lengths of warps: own derivation, checked over all patterns. */
#include "stuffing.h"

#include <limits.h>
#include <string.h>

#define SBI_STUFF_COOKIE 0x53545546u
#define SBI_STUFF_BLOCK 16         /* half cells along a block of sampling: 8 cells */
#define SBI_STUFF_ALPHA_LONG ((sb_real)0.285)   /* parts of an edge within which its end is warped to the cut */
#define SBI_STUFF_ALPHA_SHORT ((sb_real)0.3975)
#define SBI_STUFF_SHORT ((sb_real)0.8660254037844386) /* length of a short edge in cells */
#define SBI_STUFF_MAX_LEVELS 8
#define SBI_STUFF_EDGES 7          /* edges that a point owns: +x, +y, +z, and four to points half a cell up z */
#define SBI_STUFF_CHUNK 128        /* surface points per task */

/* A set of lattice points that numbers its members in lattice order: count before each word, and bits within it. */
typedef struct sbi_stuffing_set {
    uint64_t *words;
    int *before;
    size_t word_count;
    int count;
} sbi_stuffing_set;

typedef enum sbi_stuffing_state {
    SBI_STUFF_STRICT = 0, /* lies in the region of its label */
    SBI_STUFF_OUTER = 1,  /* on the outer boundary */
    SBI_STUFF_INNER = 2   /* on a face between regions */
} sbi_stuffing_state;

/* A point with an edge to another label. */
typedef struct sbi_stuffing_point {
    int half[3];
    int active;             /* its number among the points of the mesh */
    unsigned char label, state;
    sb_real moved;          /* distance from its place in the lattice, in cells */
    sb_real cut[SBI_STUFF_EDGES]; /* fraction along each owned edge to where the label changes; -1: it does not */
} sbi_stuffing_point;

typedef struct sbi_stuffing_failure {
    int shape; /* whose distance was not finite; -1: none */
    sb_vec3 at;
} sbi_stuffing_failure;

typedef struct sbi_stuffing {
    const sb_stuff_def *def;
    sb_error *error;
    sb_vec3 low, high, origin;
    int attempt;                  /* 0: the lattice is centred; each other number shifts it in its own way */
    double *told;                 /* fraction that the progress callback has heard of, over all attempts */
    sb_real half;                 /* m, half a cell */
    int n[3];                     /* cells, multiples of 2^levels */
    size_t stride[3];             /* of cells in labels: 1, n + 1, ... */
    size_t point_count;           /* of the lattice: two per cell, cells of the last layer half used */
    unsigned char *labels;        /* [point_count] 1 + shape, 0 outside */
    unsigned char *split[SBI_STUFF_MAX_LEVELS + 1]; /* 1: this cell of size 2^level is made of smaller ones */
    sbi_stuffing_set surface, active;
    int tet_count;
    int *tets;                    /* [tet_count][4] active points */
    sb_vec3 *positions;           /* [active.count] */
    unsigned char *active_label;  /* [active.count] */
    int *point_of;                /* [active.count] surface point, or -1 */
    sbi_stuffing_point *points;   /* [surface.count] */
    sb_real *values;              /* [surface.count][shapes] distances, where an edge needs them */
    sbi_stuffing_failure *failures; /* one per task of a slice */
    int first;                    /* first block or point of the slice that tasks work on */
    /* what the stencils make */
    int *cut_node;                /* [surface.count][7] node of the cut, -1: none yet */
    sb_vec3 *cut_positions;
    int cut_count;
    int *elements;                /* [element_count][4] active points, then cuts */
    unsigned char *element_labels;
    int element_count, element_capacity;
} sbi_stuffing;

SB_API sb_stuff_def sb_default_stuff_def(void)
{
    sb_stuff_def def;
    memset(&def, 0, sizeof def);
    def.type = SB_TET4;
    def.max_elements = 20000000;
    def.least_share = (sb_real)0.5;
    def.cookie = SBI_STUFF_COOKIE;
    return def;
}

/* ---- shapes ---- */

/* How far a point lies beyond the first shape's box; negative inside. */
static sb_real sbi_stuffing_beyond_box(const sbi_stuffing *s, sb_vec3 p)
{
    sb_real x = sb_max(s->low.x - p.x, p.x - s->high.x), y = sb_max(s->low.y - p.y, p.y - s->high.y);
    return sb_max(sb_max(x, y), sb_max(s->low.z - p.z, p.z - s->high.z));
}

/* Signed distance of a shape; a function of the first one is cut off at its box. The sign of a surface's is that of the
 * nearest triangle's side: right but where the surface crosses itself. */
static sb_real sbi_stuffing_value(const sbi_stuffing *s, int shape, sb_vec3 p)
{
    const sb_shape *g = s->def->shapes + shape;
    sb_real value;
    if (g->surface)
        return sb_surface_signed_distance(g->surface, p, NULL);
    value = g->distance(g->user, p);
    return shape == 0 && sb_is_finite(value) ? sb_max(value, sbi_stuffing_beyond_box(s, p)) : value;
}

/* The same with the sign of a surface's from its winding number: right wherever that is, at several times the cost. */
static sb_real sbi_stuffing_sure_value(const sbi_stuffing *s, int shape, sb_vec3 p)
{
    const sb_shape *g = s->def->shapes + shape;
    return g->surface ? sb_surface_signed_distance_winding(g->surface, p, NULL) : sbi_stuffing_value(s, shape, p);
}

/* Whether a surface contains all points within `reach` of one, where it is farther away than that (0: the point alone);
 * -1: some of them. The winding number of an open surface can hold for inside what lies beyond its box; of the first
 * shape that is outside. */
static int sbi_stuffing_encloses(const sbi_stuffing *s, int shape, sb_vec3 p, sb_real reach)
{
    sb_real beyond = shape == 0 ? sbi_stuffing_beyond_box(s, p) : -SB_REAL_MAX;
    if (!sb_surface_inside(s->def->shapes[shape].surface, p) || beyond >= reach)
        return 0;
    return beyond < -reach ? 1 : -1;
}

static int sbi_stuffing_is_inside(const sbi_stuffing *s, int shape, sb_vec3 p)
{
    return s->def->shapes[shape].surface ? sbi_stuffing_encloses(s, shape, p, 0) : sbi_stuffing_value(s, shape, p) < 0;
}

/* Largest slope of a shape's function, 0: unknown. */
static sb_real sbi_stuffing_slope(const sbi_stuffing *s, int shape)
{
    const sb_shape *g = s->def->shapes + shape;
    if (g->surface)
        return 1;
    return shape == 0 && g->max_slope > 0 ? sb_max(g->max_slope, 1) : g->max_slope;
}

/* The label that follows from the shapes a point lies in. */
static unsigned char sbi_stuffing_label(uint64_t inside)
{
    unsigned char label = 0;
    if (!(inside & 1))
        return 0;
    for (; inside; inside >>= 1)
        label++;
    return label;
}

static unsigned char sbi_stuffing_label_at(const sbi_stuffing *s, sb_vec3 p)
{
    if (!sbi_stuffing_is_inside(s, 0, p))
        return 0;
    for (int shape = s->def->shape_count - 1; shape > 0; shape--)
        if (sbi_stuffing_is_inside(s, shape, p))
            return (unsigned char)(shape + 1);
    return 1;
}

/* The shape whose surface separates two labels: the outer one, or the one that wins. */
static int sbi_stuffing_separator(int a, int b)
{
    return a == 0 || b == 0 ? 0 : sbi_max_int(a, b) - 1;
}

/* ---- the lattice ---- */

static sb_vec3 sbi_stuffing_position(const sbi_stuffing *s, const int half[3])
{
    return sb_v3(s->origin.x + s->half * (sb_real)half[0], s->origin.y + s->half * (sb_real)half[1],
                 s->origin.z + s->half * (sb_real)half[2]);
}

static size_t sbi_stuffing_index(const sbi_stuffing *s, const int half[3])
{
    size_t row = s->stride[1] * (size_t)(half[1] >> 1) + s->stride[2] * (size_t)(half[2] >> 1);
    size_t cell = (size_t)(half[0] >> 1) + row;
    return 2 * cell + (size_t)(half[0] & 1);
}

/* Inverse of sbi_stuffing_index. */
static void sbi_stuffing_coordinates(const sbi_stuffing *s, size_t index, int half[3])
{
    size_t cell = index >> 1;
    int odd = (int)(index & 1);
    half[0] = 2 * (int)(cell % s->stride[1]) + odd;
    half[1] = 2 * (int)(cell % s->stride[2] / s->stride[1]) + odd;
    half[2] = 2 * (int)(cell / s->stride[2]) + odd;
}

/* Step from a point along one of its own edges. */
static void sbi_stuffing_step(int edge, int step[3])
{
    for (int axis = 0; axis < 3; axis++)
        step[axis] = edge < 3 ? 2 * (edge == axis) : axis == 2 ? 1 : (edge - 3) >> axis & 1 ? 1 : -1;
}

static int sbi_stuffing_is_in(const sbi_stuffing *s, const int half[3])
{
    int odd = half[0] & 1;
    for (int axis = 0; axis < 3; axis++)
        if (half[axis] < 0 || half[axis] + odd > 2 * s->n[axis])
            return 0;
    return 1;
}

/* ---- sets ---- */

static int sbi_stuffing_set_make(sbi_stuffing *s, sbi_stuffing_set *set)
{
    set->word_count = s->point_count / 64 + 1;
    set->words = (uint64_t *)sbi_alloc_zeroed(&s->def->allocator, set->word_count, sizeof *set->words);
    set->before = (int *)sbi_alloc(&s->def->allocator, set->word_count, sizeof *set->before);
    return set->words && set->before;
}

static void sbi_stuffing_set_free(sbi_stuffing *s, sbi_stuffing_set *set)
{
    sbi_free(&s->def->allocator, set->words);
    sbi_free(&s->def->allocator, set->before);
}

static void sbi_stuffing_set_add(sbi_stuffing_set *set, size_t index)
{
    set->words[index >> 6] |= (uint64_t)1 << (index & 63);
}

static int sbi_stuffing_set_has(const sbi_stuffing_set *set, size_t index)
{
    return (int)(set->words[index >> 6] >> (index & 63) & 1);
}

static int sbi_stuffing_bit_count(uint64_t word)
{
    word -= word >> 1 & 0x5555555555555555u;
    word = (word & 0x3333333333333333u) + (word >> 2 & 0x3333333333333333u);
    word = (word + (word >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return (int)(word * 0x0101010101010101u >> 56);
}

/* Numbers the members. 0 when there are more than an int counts. */
static int sbi_stuffing_set_number(sbi_stuffing_set *set)
{
    int64_t count = 0;
    for (size_t w = 0; w < set->word_count; w++) {
        set->before[w] = (int)count;
        count += sbi_stuffing_bit_count(set->words[w]);
        if (count > INT_MAX)
            return 0;
    }
    set->count = (int)count;
    return 1;
}

static int sbi_stuffing_set_rank(const sbi_stuffing_set *set, size_t index)
{
    uint64_t below = set->words[index >> 6] & (((uint64_t)1 << (index & 63)) - 1);
    return set->before[index >> 6] + sbi_stuffing_bit_count(below);
}

/* ---- checks and set-up ---- */

static sb_result sbi_stuffing_check_shape(const sb_stuff_def *def, int shape, sb_error *error)
{
    const sb_shape *g = def->shapes + shape;
    if (!g->surface == !g->distance)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "shape %d needs either a surface or a distance function", shape);
    if (!sb_is_finite(g->max_slope))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "max_slope of shape %d is not finite", shape);
    if (g->max_slope < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_slope of shape %d is negative: %g", shape, (double)g->max_slope);
    return SB_OK;
}

static sb_result sbi_stuffing_check(const sb_stuff_def *def, const sb_mesh *mesh, sb_error *error)
{
    sb_result result = SB_OK;
    if (!def || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", def ? "mesh" : "def");
    if (def->cookie != SBI_STUFF_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_stuff_def");
    if (!def->shapes || def->shape_count < 1 || def->shape_count > SB_STUFF_MAX_SHAPES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "stuffing needs 1 to %d shapes, not %d", SB_STUFF_MAX_SHAPES,
                        def->shapes ? def->shape_count : 0);
    for (int shape = 0; shape < def->shape_count && result == SB_OK; shape++)
        result = sbi_stuffing_check_shape(def, shape, error);
    if (result != SB_OK)
        return result;
    if (!sb_is_finite(def->cell))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "cell is not finite");
    if (!(def->cell > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cell is %g m, it must be positive", (double)def->cell);
    if (def->levels < 0 || def->levels > SBI_STUFF_MAX_LEVELS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "levels is %d, it must be 0 to %d", def->levels,
                        SBI_STUFF_MAX_LEVELS);
    if (def->type != SB_TET4 && def->type != SB_TET10)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "stuffing makes SB_TET4 or SB_TET10, not type %d", (int)def->type);
    if (def->max_elements < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_elements is %d, it must be positive", def->max_elements);
    if (!(def->least_share >= 0 && def->least_share <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "least_share is %g, it must be 0 to 1", (double)def->least_share);
    return SB_OK;
}

/* Surfaces, and parts of them, that look inward enclose nothing. */
static sb_result sbi_stuffing_check_orientation(const sb_stuff_def *def, sb_error *error)
{
    for (int shape = 0; shape < def->shape_count; shape++) {
        int triangle = -1;
        if (!def->shapes[shape].surface)
            continue;
        if (!sbi_surface_find_inside_out(def->shapes[shape].surface, &def->allocator, &triangle))
            return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the parts of a surface");
        if (triangle >= 0)
            return sbi_fail_element(error, SB_ERROR_MESH, sb_surface_triangle(def->shapes[shape].surface, triangle, NULL),
                                    "the surface of shape %d is inside out, or a part of it is (element %d belongs to "
                                    "it): sb_surface_repair turns it",
                                    shape, sb_surface_triangle(def->shapes[shape].surface, triangle, NULL));
    }
    return SB_OK;
}

/* Lays the lattice round the first shape, with a cell and a half or more of empty space on each side. */
static sb_result sbi_stuffing_lay_out(sbi_stuffing *s)
{
    static const double spread[3] = {0.8191725133961645, 0.6710436067037893, 0.5497004779019703}; /* no two near */
    const sb_stuff_def *def = s->def;
    double size[3], cells[3], total = 1, start[3], unit = (double)(1 << def->levels);
    s->low = def->low;
    s->high = def->high;
    if (def->shapes[0].surface)
        sb_surface_bounds(def->shapes[0].surface, &s->low, &s->high);
    if (!sb_v3_is_finite(s->low) || !sb_v3_is_finite(s->high))
        return sbi_fail(s->error, SB_ERROR_NOT_FINITE, "the box from low to high is not finite");
    if (!(s->low.x < s->high.x && s->low.y < s->high.y && s->low.z < s->high.z))
        return sbi_fail(s->error, SB_ERROR_ARGUMENT, "the box is empty: low must lie below high along x, y and z");
    size[0] = (double)s->high.x - (double)s->low.x;
    size[1] = (double)s->high.y - (double)s->low.y;
    size[2] = (double)s->high.z - (double)s->low.z;
    for (int axis = 0; axis < 3; axis++) {
        cells[axis] = unit * ceil((ceil(size[axis] / (double)def->cell) + 4) / unit);
        total *= cells[axis] + 1;
    }
    if (!(total <= 8.0 * def->max_elements) || total > 0.25 * (double)((size_t)-1) || total > 1e9 * unit * unit)
        return sbi_fail(s->error, SB_ERROR_ARGUMENT,
                        "cells of %g m make a lattice of %.3g cells: more than 8 for each of max_elements (%d)",
                        (double)def->cell, total, def->max_elements);
    for (int axis = 0; axis < 3; axis++) {
        s->n[axis] = (int)cells[axis];
        start[axis] = -0.5 * (cells[axis] * (double)def->cell - size[axis]);
    }
    for (int axis = 0; axis < 3 && s->attempt > 0; axis++) {
        double place = s->attempt * spread[axis];
        start[axis] += (place - floor(place) - 0.5) * (double)def->cell;
    }
    s->half = (sb_real)0.5 * def->cell;
    s->origin = sb_v3(s->low.x + (sb_real)start[0], s->low.y + (sb_real)start[1], s->low.z + (sb_real)start[2]);
    s->stride[0] = 1;
    s->stride[1] = (size_t)s->n[0] + 1;
    s->stride[2] = s->stride[1] * ((size_t)s->n[1] + 1);
    s->point_count = 2 * s->stride[2] * ((size_t)s->n[2] + 1);
    return SB_OK;
}

static sb_result sbi_stuffing_too_many(const sbi_stuffing *s)
{
    return sbi_fail(s->error, SB_ERROR_ARGUMENT, "cells of %g m make more than max_elements (%d) elements",
                    (double)s->def->cell, s->def->max_elements);
}

static sb_result sbi_stuffing_no_memory(const sbi_stuffing *s)
{
    return sbi_fail(s->error, SB_ERROR_MEMORY, "out of memory for a lattice of %d x %d x %d cells", s->n[0], s->n[1],
                    s->n[2]);
}

static sb_result sbi_stuffing_progress(sbi_stuffing *s, double fraction)
{
    *s->told = fraction > *s->told ? fraction : *s->told;
    if (s->def->progress && s->def->progress(s->def->progress_user, *s->told))
        return sbi_fail(s->error, SB_ERROR_CANCELLED, "stopped by the progress callback at %.0f %%", 100 * *s->told);
    return SB_OK;
}

/* Runs tasks, one failure record each, and reports the first failure. */
static sb_result sbi_stuffing_run(sbi_stuffing *s, sb_task task, int count)
{
    for (int i = 0; i < count; i++)
        s->failures[i].shape = -1;
    sbi_run(&s->def->jobs, task, s, count);
    for (int i = 0; i < count; i++)
        if (s->failures[i].shape >= 0) {
            const sbi_stuffing_failure *f = s->failures + i;
            return sbi_fail(s->error, SB_ERROR_NOT_FINITE, "the distance of shape %d is not finite at (%g, %g, %g)",
                            f->shape, (double)f->at.x, (double)f->at.y, (double)f->at.z);
        }
    return SB_OK;
}

/* ---- 1. labels ---- */

/* A cube of the lattice on its way down to single cells: which shapes are decided, and which contain it. */
typedef struct sbi_stuffing_cube {
    int low[3], size; /* half cells; points lie in [low, low + size - 1] */
    uint64_t known, inside;
} sbi_stuffing_cube;

/* Whether a shape contains a point, told only when its surface is farther away than `reach` (m; 0: anyhow): 1 or 0, or
 * -1: not told; -2: the distance is not finite. */
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

static sb_result sbi_stuffing_sample(sbi_stuffing *s)
{
    int layers = sbi_stuffing_blocks(s, 2), count = sbi_stuffing_blocks(s, 0) * sbi_stuffing_blocks(s, 1);
    sb_result result = SB_OK;
    s->labels = (unsigned char *)sbi_alloc_zeroed(&s->def->allocator, s->point_count, 1);
    s->failures = (sbi_stuffing_failure *)sbi_alloc(&s->def->allocator, (size_t)sbi_max_int(count, 64),
                                                    sizeof *s->failures);
    if (!s->labels || !s->failures)
        return sbi_stuffing_no_memory(s);
    for (s->first = 0; s->first < layers && result == SB_OK; s->first++) {
        result = sbi_stuffing_progress(s, 0.5 * s->first / layers);
        if (result == SB_OK)
            result = sbi_stuffing_run(s, sbi_stuffing_label_task, count);
    }
    return result;
}

/* ---- 2. octree and tets ---- */

/* Finds the points with an edge to another label. */
static sb_result sbi_stuffing_find_surface(sbi_stuffing *s)
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

static sb_result sbi_stuffing_grade(sbi_stuffing *s)
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

static sb_result sbi_stuffing_enumerate(sbi_stuffing *s)
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

/* ---- 3. cuts ---- */

/* The surface point at the other end of an edge of a surface point; own 1: one it owns. -1 when there is none. */
static int sbi_stuffing_neighbour(const sbi_stuffing *s, const sbi_stuffing_point *point, int edge, int own)
{
    int half[3], step[3];
    size_t index;
    sbi_stuffing_step(edge, step);
    for (int axis = 0; axis < 3; axis++)
        half[axis] = point->half[axis] + (own ? step[axis] : -step[axis]);
    if (!sbi_stuffing_is_in(s, half))
        return -1;
    index = sbi_stuffing_index(s, half);
    return sbi_stuffing_set_has(&s->surface, index) ? sbi_stuffing_set_rank(&s->surface, index) : -1;
}

static void sbi_stuffing_value_task(void *user, int index)
{
    sbi_stuffing *s = (sbi_stuffing *)user;
    int begin = s->first + index * SBI_STUFF_CHUNK, end = sbi_min_int(begin + SBI_STUFF_CHUNK, s->surface.count);
    for (int i = begin; i < end; i++) {
        const sbi_stuffing_point *point = s->points + i;
        uint64_t needed = 0;
        for (int k = 0; k < 2 * SBI_STUFF_EDGES; k++) {
            int j = sbi_stuffing_neighbour(s, point, k >> 1, k & 1);
            if (j >= 0 && s->points[j].label != point->label)
                needed |= (uint64_t)1 << sbi_stuffing_separator(s->points[j].label, point->label);
        }
        for (int shape = 0; shape < s->def->shape_count; shape++)
            if (needed >> shape & 1) {
                sb_vec3 p = sbi_stuffing_position(s, point->half);
                sb_real value = sbi_stuffing_value(s, shape, p);
                if (s->def->shapes[shape].surface) /* the label knows better, see sbi_stuffing_value */
                    value = point->label && point->label >= shape + 1 ? -sb_abs(value) : sb_abs(value);
                s->values[(size_t)i * (size_t)s->def->shape_count + (size_t)shape] = value;
                if (!sb_is_finite(value)) {
                    s->failures[index].shape = shape;
                    s->failures[index].at = p;
                    return;
                }
            }
    }
}

/* Where an edge crosses a shape's surface: its ends, the values there, and what is asked in between. */
typedef struct sbi_stuffing_crossing {
    const sbi_stuffing *s;
    int shape;
    int sure; /* 1: sbi_stuffing_sure_value */
    sb_vec3 from, edge;
    sb_real f0, f1;
} sbi_stuffing_crossing;

/* Fraction of the edge at which the function changes sign: regula falsi after Illinois, with a bisection now and then
 * for functions that are far from straight. *residual: the function there, or not finite at the fraction returned. */
static sb_real sbi_stuffing_root(const sbi_stuffing_crossing *c, sb_real *residual)
{
    const sb_real tolerance = sb_max((sb_real)1.5e-8, 32 * SB_EPSILON);
    sb_real ta = 0, tb = 1, t = 0, fa = c->f0, fb = c->f1, enough = tolerance * (sb_abs(fa) + sb_abs(fb));
    int last = 0;
    *residual = 0;
    if (fa == 0 || fb == 0)
        return fa == 0 ? (sb_real)0 : (sb_real)1;
    for (int i = 0; i < 80 && tb - ta > tolerance; i++) {
        sb_real f;
        sb_vec3 p;
        t = i % 4 == 3 ? (sb_real)0.5 * (ta + tb) : ta + (tb - ta) * (fa / (fa - fb));
        p = sb_v3_madd(c->from, t, c->edge);
        f = c->sure ? sbi_stuffing_sure_value(c->s, c->shape, p) : sbi_stuffing_value(c->s, c->shape, p);
        *residual = f;
        if (!sb_is_finite(f) || sb_abs(f) <= enough)
            return t;
        if ((f < 0) == (fa < 0)) {
            fb *= last == 1 ? (sb_real)0.5 : (sb_real)1;
            ta = t;
            fa = f;
            last = 1;
        } else {
            fa *= last == 2 ? (sb_real)0.5 : (sb_real)1;
            tb = t;
            fb = f;
            last = 2;
        }
    }
    return t;
}

/* The cut between two surface points. The quick sign of surfaces can change where there is none (see
 * sbi_stuffing_value): then the surface is not near, and the sure one looks again. */
static sb_real sbi_stuffing_cut_at(const sbi_stuffing *s, int i, int j, sbi_stuffing_failure *failure)
{
    int shape = sbi_stuffing_separator(s->points[i].label, s->points[j].label);
    size_t shapes = (size_t)s->def->shape_count;
    sbi_stuffing_crossing c;
    sb_real t, residual;
    c.s = s;
    c.shape = shape;
    c.sure = 0;
    c.from = sbi_stuffing_position(s, s->points[i].half);
    c.edge = sb_v3_sub(sbi_stuffing_position(s, s->points[j].half), c.from);
    c.f0 = s->values[(size_t)i * shapes + (size_t)shape];
    c.f1 = s->values[(size_t)j * shapes + (size_t)shape];
    t = sbi_stuffing_root(&c, &residual);
    if (s->def->shapes[shape].surface && sb_abs(residual) > (sb_real)1e-3 * s->half) {
        c.sure = 1;
        t = sbi_stuffing_root(&c, &residual);
    }
    if (!sb_is_finite(residual)) {
        failure->shape = shape;
        failure->at = sb_v3_madd(c.from, t, c.edge);
    }
    return t;
}

static void sbi_stuffing_cut_task(void *user, int index)
{
    sbi_stuffing *s = (sbi_stuffing *)user;
    int begin = s->first + index * SBI_STUFF_CHUNK, end = sbi_min_int(begin + SBI_STUFF_CHUNK, s->surface.count);
    for (int i = begin; i < end; i++)
        for (int edge = 0; edge < SBI_STUFF_EDGES; edge++) {
            sbi_stuffing_point *point = s->points + i;
            int j = sbi_stuffing_neighbour(s, point, edge, 1);
            point->cut[edge] = -1;
            if (j < 0 || s->points[j].label == point->label)
                continue;
            point->cut[edge] = sbi_stuffing_cut_at(s, i, j, s->failures + index);
            if (s->failures[index].shape >= 0)
                return;
        }
}

/* Runs a task over all surface points, in slices that let progress be told. */
static sb_result sbi_stuffing_over_points(sbi_stuffing *s, sb_task task, double from, double to)
{
    sb_result result = SB_OK;
    for (s->first = 0; s->first < s->surface.count && result == SB_OK;) {
        int chunks = (s->surface.count - s->first - 1) / SBI_STUFF_CHUNK + 1;
        chunks = sbi_min_int(chunks, 64);
        result = sbi_stuffing_progress(s, from + (to - from) * s->first / s->surface.count);
        if (result == SB_OK)
            result = sbi_stuffing_run(s, task, chunks);
        if (chunks * SBI_STUFF_CHUNK >= s->surface.count - s->first)
            break;
        s->first += chunks * SBI_STUFF_CHUNK;
    }
    return result;
}

/* ---- 4. warping ---- */

/* One edge of a surface point, seen from it. */
typedef struct sbi_stuffing_edge {
    int other;       /* surface point */
    sb_real fraction, length; /* of the cut from the point; of the edge in cells */
    sb_real alpha;
    int inner;       /* 1: between two regions; 0: to the outside */
} sbi_stuffing_edge;

/* Edge k in [0, 14) of a surface point; 0 when no cut is left on it. A cut to the outside lives while its outer end is
 * strict and its inner end is not on the boundary; one between regions lives while both ends are strict. */
static int sbi_stuffing_live_edge(const sbi_stuffing *s, int i, int k, sbi_stuffing_edge *e)
{
    const sbi_stuffing_point *a = s->points + i, *b;
    int own = k < SBI_STUFF_EDGES, edge = k % SBI_STUFF_EDGES;
    e->other = sbi_stuffing_neighbour(s, a, edge, own);
    if (e->other < 0 || s->points[e->other].label == a->label)
        return 0;
    b = s->points + e->other;
    e->inner = a->label != 0 && b->label != 0;
    if (a->state == SBI_STUFF_OUTER || b->state == SBI_STUFF_OUTER || (e->inner && (a->state || b->state)))
        return 0;
    e->fraction = own ? a->cut[edge] : 1 - b->cut[edge];
    e->length = edge < 3 ? (sb_real)1 : SBI_STUFF_SHORT;
    e->alpha = edge < 3 ? SBI_STUFF_ALPHA_LONG : SBI_STUFF_ALPHA_SHORT;
    return 1;
}

/* Makes a point a zero, and moves it to a cut on the edge when there is one. */
static void sbi_stuffing_make_zero(sbi_stuffing *s, int i, sbi_stuffing_state state, const sbi_stuffing_edge *to)
{
    sbi_stuffing_point *point = s->points + i;
    point->state = (unsigned char)state;
    if (to) {
        sb_vec3 a = sbi_stuffing_position(s, point->half), b = sbi_stuffing_position(s, s->points[to->other].half);
        s->positions[point->active] = sb_v3_madd(a, to->fraction, sb_v3_sub(b, a));
        point->moved = to->fraction * to->length;
    }
}

/* Inside, with an edge to the outside: the tets there take it for a point in its place. */
static int sbi_stuffing_is_pinned(const sbi_stuffing *s, int i)
{
    sbi_stuffing_edge e;
    if (s->points[i].label == 0)
        return 0;
    for (int k = 0; k < 2 * SBI_STUFF_EDGES; k++)
        if (sbi_stuffing_live_edge(s, i, k, &e) && !e.inner)
            return 1;
    return 0;
}

/* The nearest cut of a point towards the outside or between regions, among those within alpha, or any. */
static int sbi_stuffing_nearest_cut(const sbi_stuffing *s, int i, int inner, int any, sbi_stuffing_edge *nearest)
{
    sbi_stuffing_edge e;
    int found = 0;
    for (int k = 0; k < 2 * SBI_STUFF_EDGES; k++) {
        if (!sbi_stuffing_live_edge(s, i, k, &e) || e.inner != inner || (!any && !(e.fraction < e.alpha)))
            continue;
        if (!found || e.fraction * e.length < nearest->fraction * nearest->length)
            *nearest = e;
        found = 1;
    }
    return found;
}

/* Warps the points to their nearest cut within alpha: those to the outside first, then those between regions. */
static void sbi_stuffing_warp(sbi_stuffing *s, int inner)
{
    for (int i = 0; i < s->surface.count; i++) {
        sbi_stuffing_edge to;
        if (s->points[i].state != SBI_STUFF_STRICT || !sbi_stuffing_nearest_cut(s, i, inner, 0, &to))
            continue;
        if (inner)
            sbi_stuffing_make_zero(s, i, SBI_STUFF_INNER, sbi_stuffing_is_pinned(s, i) ? NULL : &to);
        else
            sbi_stuffing_make_zero(s, i, SBI_STUFF_OUTER, &to);
    }
}

/* What a tet sees: its surface points (-1: a point in the middle of its region), and its labels without zeros. */
typedef struct sbi_stuffing_view {
    const int *nodes;  /* active points */
    int point[4];
    int label[4];      /* -1: a zero */
    int outside;       /* a strict point lies outside: the regions count as one side */
    int zeros, inner_zeros;
    int a, b;          /* two different labels among the strict, not outside; -1: none */
    int more;          /* 1: there are further labels */
} sbi_stuffing_view;

static void sbi_stuffing_look(const sbi_stuffing *s, const int *nodes, sbi_stuffing_view *v)
{
    v->nodes = nodes;
    v->outside = v->zeros = v->inner_zeros = v->more = 0;
    v->a = v->b = -1;
    for (int i = 0; i < 4; i++) {
        int point = s->point_of[nodes[i]], state = point < 0 ? 0 : s->points[point].state;
        v->point[i] = point;
        v->label[i] = state ? -1 : s->active_label[nodes[i]];
        v->zeros += state != SBI_STUFF_STRICT;
        v->inner_zeros += state == SBI_STUFF_INNER;
        v->outside |= v->label[i] == 0;
        if (v->label[i] <= 0 || v->label[i] == v->a || v->label[i] == v->b)
            continue;
        if (v->a < 0)
            v->a = v->label[i];
        else if (v->b < 0)
            v->b = v->label[i];
        else
            v->more = 1;
    }
}

/* Makes zeros of inner points, the nearest to a face between regions first, until the tet sees two labels at most. */
static void sbi_stuffing_settle_tet(sbi_stuffing *s, const int *nodes)
{
    sbi_stuffing_view v;
    for (;;) {
        int chosen = -1;
        sb_real nearest = SB_REAL_MAX;
        sbi_stuffing_look(s, nodes, &v);
        if (!(v.outside ? v.b >= 0 : v.more))
            return;
        for (int i = 0; i < 4; i++) {
            sbi_stuffing_edge e;
            if (v.label[i] > 0 && sbi_stuffing_nearest_cut(s, v.point[i], 1, 1, &e) &&
                e.fraction * e.length < nearest) {
                nearest = e.fraction * e.length;
                chosen = v.point[i];
            }
        }
        sbi_stuffing_make_zero(s, chosen, SBI_STUFF_INNER, NULL);
    }
}

static void sbi_stuffing_settle(sbi_stuffing *s)
{
    for (int t = 0; t < s->tet_count; t++)
        sbi_stuffing_settle_tet(s, s->tets + 4 * (size_t)t);
}

/* Whether a tet has angles within those of the stencils. */
static int sbi_stuffing_is_well_shaped(const sb_vec3 corners[4])
{
    const sb_real cos_10_7 = (sb_real)0.98260, cos_164_8 = (sb_real)-0.96500;
    sb_real of_smallest, of_largest;
    sbi_mesh_tet_cosines(corners, &of_smallest, &of_largest);
    return of_smallest <= cos_10_7 && of_largest >= cos_164_8;
}

static sb_vec3 sbi_stuffing_centroid(const sb_vec3 corners[4])
{
    return sb_v3_scale((sb_real)0.25, sb_v3_add(sb_v3_add(corners[0], corners[1]), sb_v3_add(corners[2], corners[3])));
}

/* Label of a tet of four zeros: that of its centroid, taken in the lattice, so that it stays when zeros move. Outside
 * when all its points were, not when one is a zero between regions: to the outer boundary that is a point inside. */
static int sbi_stuffing_label_of_four(const sbi_stuffing *s, const int points[4])
{
    sb_vec3 corners[4];
    int label, inner = 0, highest = 0;
    for (int i = 0; i < 4; i++) {
        const sbi_stuffing_point *point = s->points + points[i];
        corners[i] = sbi_stuffing_position(s, point->half);
        inner |= point->state == SBI_STUFF_INNER;
        highest = sbi_max_int(highest, point->label);
    }
    if (highest == 0) /* not among the tets */
        return 0;
    label = sbi_stuffing_label_at(s, sbi_stuffing_centroid(corners));
    return inner && label == 0 ? highest : label;
}

/* A tet of four zeros can be flat. Where one is needed its most displaced point goes half of the way back to its place
 * in the lattice. Any place on the way is one of the cases that the angles' bounds were found over, so no other tet
 * leaves them; only this point leaves the surface. Returns 1 when it moved one. */
static int sbi_stuffing_relax_tet(sbi_stuffing *s, const int *nodes)
{
    sbi_stuffing_view v;
    sbi_stuffing_point *worst = NULL;
    sb_vec3 place, corners[4], *now;
    sbi_stuffing_look(s, nodes, &v);
    if (v.zeros < 4)
        return 0;
    for (int i = 0; i < 4; i++)
        corners[i] = s->positions[nodes[i]];
    if (sbi_stuffing_is_well_shaped(corners) || sbi_stuffing_label_of_four(s, v.point) == 0)
        return 0;
    for (int i = 0; i < 4; i++)
        if (!worst || s->points[v.point[i]].moved > worst->moved)
            worst = s->points + v.point[i];
    place = sbi_stuffing_position(s, worst->half);
    now = s->positions + worst->active;
    worst->moved *= (sb_real)0.5;
    *now = sb_v3_madd(place, (sb_real)0.5, sb_v3_sub(*now, place));
    return 1;
}

/* ---- 4a. a manifold boundary ----
 * Where the shape is about as thin as a cell, parts of it can come to touch at a zero or along an edge of zeros. A zero
 * sees 14 neighbours, the corners of 24 triangles round it. The boundary is a single sheet there when the triangles
 * that have something inside hang together, and those outside, across edges of the triangles. Where it is not, the zero
 * is freed: it goes back to its place and its side, and cuts nearer to it than alpha are put at alpha (angles keep their
 * bounds, the boundary leaves the surface there by less than a third of a cell). Lattices without zeros have manifold
 * boundaries: this ends. */

typedef struct sbi_stuffing_link {
    int step[14][3];       /* to the neighbours: 6 long edges, 8 short */
    int triangle[24][3];
    int beside[24][3];     /* triangle across the edge opposite corner i */
} sbi_stuffing_link;

static int sbi_stuffing_has_corner(const int triangle[3], int corner)
{
    return triangle[0] == corner || triangle[1] == corner || triangle[2] == corner;
}

static void sbi_stuffing_make_link(sbi_stuffing_link *link)
{
    int count = 0;
    for (int k = 0; k < 14; k++)
        for (int axis = 0; axis < 3; axis++)
            link->step[k][axis] = k < 6 ? (k >> 1 == axis ? (k & 1 ? 2 : -2) : 0) : (k - 6) >> axis & 1 ? 1 : -1;
    for (int l = 0; l < 6; l++) /* a long edge and two short ones that lean its way and differ along one axis */
        for (int a = 6; a < 14; a++)
            for (int b = a + 1; b < 14; b++) {
                int axis = l >> 1, bit = 1 << axis, differ = (a - 6) ^ (b - 6);
                if (((a - 6) >> axis & 1) != (l & 1) || (differ & bit) || (differ & (differ - 1)))
                    continue;
                link->triangle[count][0] = l;
                link->triangle[count][1] = a;
                link->triangle[count++][2] = b;
            }
    for (int t = 0; t < 24; t++)
        for (int i = 0; i < 3; i++)
            for (int u = 0; u < 24; u++)
                if (u != t && sbi_stuffing_has_corner(link->triangle[u], link->triangle[t][(i + 1) % 3]) &&
                    sbi_stuffing_has_corner(link->triangle[u], link->triangle[t][(i + 2) % 3]))
                    link->beside[t][i] = u;
}

/* Sides of the 14 neighbours of a zero: +1 inside, -1 outside, 0 on the boundary; their surface points, -1: none. */
static void sbi_stuffing_link_sides(const sbi_stuffing *s, const sbi_stuffing_link *link, int i, int points[14],
                                    int sides[14])
{
    for (int k = 0; k < 14; k++) {
        int half[3];
        size_t index;
        for (int axis = 0; axis < 3; axis++)
            half[axis] = s->points[i].half[axis] + link->step[k][axis];
        index = sbi_stuffing_index(s, half);
        points[k] = sbi_stuffing_set_has(&s->surface, index) ? sbi_stuffing_set_rank(&s->surface, index) : -1;
        sides[k] = points[k] >= 0 && s->points[points[k]].state == SBI_STUFF_OUTER ? 0 : s->labels[index] ? 1 : -1;
    }
}

/* Parts of one side that hang together round a zero. Corners on that side stand for the triangles they belong to;
 * triangles of zeros (bit 14 + t) stand for themselves. */
static int sbi_stuffing_count_parts(const sbi_stuffing_link *link, const int sides[14], const int side_of_triangle[24],
                                    int side)
{
    uint64_t near_by[38], left = 0;
    int parts = 0;
    memset(near_by, 0, sizeof near_by);
    for (int t = 0; t < 24; t++) {
        const int *corner = link->triangle[t];
        int zeros = sides[corner[0]] == 0 && sides[corner[1]] == 0 && sides[corner[2]] == 0;
        for (int i = 0; i < 3; i++) {
            int a = corner[(i + 1) % 3], b = corner[(i + 2) % 3], u = link->beside[t][i], mine, other = 0;
            if (sides[corner[i]] == side)
                left |= (uint64_t)1 << corner[i];
            if (sides[a] == side && sides[b] == side) {
                near_by[a] |= (uint64_t)1 << b;
                near_by[b] |= (uint64_t)1 << a;
            }
            if (sides[a] != 0 || sides[b] != 0)
                continue;
            while (link->triangle[u][other] == a || link->triangle[u][other] == b)
                other++;
            other = link->triangle[u][other];
            mine = zeros ? 14 + t : corner[i];
            if ((zeros ? side_of_triangle[t] : sides[mine]) != side)
                continue;
            left |= (uint64_t)1 << mine;
            if (sides[other] == side)
                near_by[mine] |= (uint64_t)1 << other;
            else if (sides[other] == 0 && side_of_triangle[u] == side)
                near_by[mine] |= (uint64_t)1 << (14 + u);
        }
    }
    for (; left; parts++) {
        uint64_t reached = left & (~left + 1), before = 0;
        while (reached != before) {
            before = reached;
            for (int k = 0; k < 38; k++)
                reached |= reached >> k & 1 ? near_by[k] : 0;
        }
        left &= ~reached;
    }
    return parts;
}

static int sbi_stuffing_is_sheet(const sbi_stuffing *s, const sbi_stuffing_link *link, int i)
{
    int points[14], sides[14], side_of_triangle[24];
    sbi_stuffing_link_sides(s, link, i, points, sides);
    for (int t = 0; t < 24; t++) {
        const int *corner = link->triangle[t];
        int tet[4];
        side_of_triangle[t] = 0;
        if (sides[corner[0]] || sides[corner[1]] || sides[corner[2]])
            continue;
        tet[0] = i;
        for (int k = 0; k < 3; k++)
            tet[1 + k] = points[corner[k]];
        side_of_triangle[t] = sbi_stuffing_label_of_four(s, tet) ? 1 : -1;
    }
    return sbi_stuffing_count_parts(link, sides, side_of_triangle, 1) <= 1 &&
           sbi_stuffing_count_parts(link, sides, side_of_triangle, -1) <= 1;
}

static void sbi_stuffing_free_pinches(sbi_stuffing *s)
{
    sbi_stuffing_link link;
    int changed = 1;
    sbi_stuffing_make_link(&link);
    while (changed) {
        changed = 0;
        for (int i = 0; i < s->surface.count; i++) {
            sbi_stuffing_point *point = s->points + i;
            if (point->state != SBI_STUFF_OUTER || sbi_stuffing_is_sheet(s, &link, i))
                continue;
            point->state = SBI_STUFF_STRICT;
            point->moved = 0;
            s->positions[point->active] = sbi_stuffing_position(s, point->half);
            changed = 1;
        }
    }
}

/* Decides about all zeros: those at the outside, then those between regions; then every tet can be cut. Relaxing ends:
 * four zeros near their places make a regular tet. */
static void sbi_stuffing_place_zeros(sbi_stuffing *s)
{
    int changed = 1;
    sbi_stuffing_warp(s, 0);
    sbi_stuffing_free_pinches(s);
    if (s->def->shape_count > 1) {
        sbi_stuffing_settle(s);
        sbi_stuffing_warp(s, 1);
        sbi_stuffing_settle(s);
    }
    while (changed) {
        changed = 0;
        for (int t = 0; t < s->tet_count; t++)
            changed |= sbi_stuffing_relax_tet(s, s->tets + 4 * (size_t)t);
    }
}

/* ---- 5. stencils ---- */

/* Which of a tet's points are on the side that is cut out (+1), on the other (-1), on the surface (0). */
typedef struct sbi_stuffing_stencil {
    const sbi_stuffing_view *view;
    int p[4], n[4], z[4]; /* local indices of each kind */
    int p_count, n_count, z_count;
    int label;
} sbi_stuffing_stencil;

static int sbi_stuffing_is_long(const sbi_stuffing *s, int a, int b)
{
    return ((s->points[a].half[0] ^ s->points[b].half[0]) & 1) == 0;
}

/* Whether the diagonal of the quadrilateral p1, p2 and their cuts towards n starts at p1, that is, ends at the cut of
 * p2. The three are surface points. Long edges p1-p2 decide by parity, so that the faces round them take turns. */
static int sbi_stuffing_starts_at_first(const sbi_stuffing *s, int p1, int p2, int n)
{
    const int *a = s->points[p1].half, *b = s->points[p2].half, *c = s->points[n].half;
    int odd = a[0] & 1, sign = 1, from_lower, first_is_lower;
    if (sbi_stuffing_is_long(s, p1, n))
        return 0;
    if (sbi_stuffing_is_long(s, p2, n))
        return 1;
    first_is_lower = a[0] + a[1] + a[2] < b[0] + b[1] + b[2];
    for (int axis = 0; axis < 3; axis++)
        if (a[axis] == b[axis])
            sign *= c[axis] > a[axis] ? 1 : -1;
    from_lower = (sign > 0) != odd;
    return from_lower == first_is_lower;
}

static void sbi_stuffing_put_element(sbi_stuffing *s, int label, int a, int b, int c, int d)
{
    if (s->element_count < s->element_capacity) {
        int *nodes = s->elements + 4 * (size_t)s->element_count;
        nodes[0] = a;
        nodes[1] = b;
        nodes[2] = c;
        nodes[3] = d;
        s->element_labels[s->element_count] = (unsigned char)label;
    }
    s->element_count++;
}

/* Node of the cut between two surface points. */
static int sbi_stuffing_cut_between(sbi_stuffing *s, int i, int j)
{
    const int *a = s->points[i].half, *b = s->points[j].half;
    int edge = 0, owner = i, other = j;
    int *node;
    if (sbi_stuffing_is_long(s, i, j)) {
        while (a[edge] == b[edge])
            edge++;
        if (a[edge] > b[edge])
            owner = j;
    } else {
        if (a[2] > b[2])
            owner = j;
        other = owner == i ? j : i;
        edge = 3 + (s->points[other].half[0] > s->points[owner].half[0]) +
               2 * (s->points[other].half[1] > s->points[owner].half[1]);
    }
    other = owner == i ? j : i;
    node = s->cut_node + (size_t)owner * SBI_STUFF_EDGES + edge;
    if (*node < 0) {
        sb_vec3 from = sbi_stuffing_position(s, s->points[owner].half);
        sb_vec3 to = sbi_stuffing_position(s, s->points[other].half);
        sb_real alpha = edge < 3 ? SBI_STUFF_ALPHA_LONG : SBI_STUFF_ALPHA_SHORT;
        sb_real fraction = sb_min(sb_max(s->points[owner].cut[edge], alpha), 1 - alpha); /* beyond: freed points only */
        s->cut_positions[s->cut_count] = sb_v3_madd(from, fraction, sb_v3_sub(to, from));
        *node = s->active.count + s->cut_count++;
    }
    return *node;
}

/* A prism with bottom b and top t, cut so that the diagonal between columns i and j runs from b_i to t_j when before[i]
 * < before[j]. */
static void sbi_stuffing_put_prism(sbi_stuffing *s, int label, const int *b, const int *t, const int *order)
{
    int i = order[0], j = order[1], k = order[2];
    sbi_stuffing_put_element(s, label, b[i], b[j], b[k], t[k]);
    sbi_stuffing_put_element(s, label, b[i], b[j], t[j], t[k]);
    sbi_stuffing_put_element(s, label, b[i], t[i], t[j], t[k]);
}

/* Order of three columns from which of each pair comes first; acyclic for all patterns of the lattice. */
static void sbi_stuffing_order(int first01, int first02, int first12, int order[3])
{
    int rank[3];
    rank[0] = !first01 + !first02;
    rank[1] = first01 + !first12;
    rank[2] = first02 + first12;
    for (int i = 0; i < 3; i++)
        order[rank[i]] = i;
}

/* +++-: the prism between the three points and their cuts. */
static void sbi_stuffing_cut_corner(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int bottom[3], top[3], order[3], p[3], n = c->view->point[c->n[0]];
    for (int i = 0; i < 3; i++) {
        p[i] = c->view->point[c->p[i]];
        bottom[i] = c->view->nodes[c->p[i]];
        top[i] = sbi_stuffing_cut_between(s, p[i], n);
    }
    sbi_stuffing_order(sbi_stuffing_starts_at_first(s, p[0], p[1], n), sbi_stuffing_starts_at_first(s, p[0], p[2], n),
                       sbi_stuffing_starts_at_first(s, p[1], p[2], n), order);
    sbi_stuffing_put_prism(s, c->label, bottom, top, order);
}

/* ++--: the prism along the edge of the two points, with a triangle of cuts at each end. The two faces at that edge
 * decide in opposite ways, so the free quadrilateral of four cuts has no choice left. */
static void sbi_stuffing_cut_half(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int bottom[3], top[3], order[3], p[2], n[2], first01, first02;
    for (int i = 0; i < 2; i++) {
        p[i] = c->view->point[c->p[i]];
        n[i] = c->view->point[c->n[i]];
    }
    bottom[0] = c->view->nodes[c->p[0]];
    top[0] = c->view->nodes[c->p[1]];
    for (int i = 0; i < 2; i++) {
        bottom[1 + i] = sbi_stuffing_cut_between(s, p[0], n[i]);
        top[1 + i] = sbi_stuffing_cut_between(s, p[1], n[i]);
    }
    first01 = sbi_stuffing_starts_at_first(s, p[0], p[1], n[0]);
    first02 = sbi_stuffing_starts_at_first(s, p[0], p[1], n[1]);
    sbi_stuffing_order(first01, first02, first02, order);
    sbi_stuffing_put_prism(s, c->label, bottom, top, order);
}

/* ++-0: the pyramid over the two points and their cuts. */
static void sbi_stuffing_cut_pyramid(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int p1 = c->view->point[c->p[0]], p2 = c->view->point[c->p[1]], n = c->view->point[c->n[0]];
    int a = c->view->nodes[c->p[0]], b = c->view->nodes[c->p[1]], apex = c->view->nodes[c->z[0]];
    int ca = sbi_stuffing_cut_between(s, p1, n), cb = sbi_stuffing_cut_between(s, p2, n);
    if (sbi_stuffing_starts_at_first(s, p1, p2, n)) {
        sbi_stuffing_put_element(s, c->label, a, b, cb, apex);
        sbi_stuffing_put_element(s, c->label, a, cb, ca, apex);
    } else {
        sbi_stuffing_put_element(s, c->label, b, a, ca, apex);
        sbi_stuffing_put_element(s, c->label, b, ca, cb, apex);
    }
}

/* One point: the tet to its cuts and the zeros. */
static void sbi_stuffing_cut_tip(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int nodes[4];
    memcpy(nodes, c->view->nodes, sizeof nodes);
    for (int i = 0; i < c->n_count; i++)
        nodes[c->n[i]] = sbi_stuffing_cut_between(s, c->view->point[c->p[0]], c->view->point[c->n[i]]);
    sbi_stuffing_put_element(s, c->label, nodes[0], nodes[1], nodes[2], nodes[3]);
}

static void sbi_stuffing_apply(sbi_stuffing *s, const sbi_stuffing_view *view, const int sides[4], int sign, int label)
{
    sbi_stuffing_stencil c;
    memset(&c, 0, sizeof c);
    c.view = view;
    c.label = label;
    for (int i = 0; i < 4; i++) {
        if (sides[i] == 0)
            c.z[c.z_count++] = i;
        else if (sides[i] == sign)
            c.p[c.p_count++] = i;
        else
            c.n[c.n_count++] = i;
    }
    if (c.p_count == 0)
        return;
    if (c.n_count == 0)
        sbi_stuffing_put_element(s, label, view->nodes[0], view->nodes[1], view->nodes[2], view->nodes[3]);
    else if (c.p_count == 1)
        sbi_stuffing_cut_tip(s, &c);
    else if (c.p_count == 3)
        sbi_stuffing_cut_corner(s, &c);
    else if (c.n_count == 2)
        sbi_stuffing_cut_half(s, &c);
    else
        sbi_stuffing_cut_pyramid(s, &c);
}

/* Region of the inner part of a tet at the outside whose inner points are all zeros between regions. */
static int sbi_stuffing_label_of_zeros(const sbi_stuffing *s, const int *nodes)
{
    sb_vec3 corners[4];
    int label;
    for (int i = 0; i < 4; i++)
        corners[i] = s->positions[nodes[i]];
    label = sbi_stuffing_label_at(s, sbi_stuffing_centroid(corners));
    for (int i = 0; i < 4 && label == 0; i++)
        label = s->active_label[nodes[i]];
    return label;
}

static void sbi_stuffing_cut_tet(sbi_stuffing *s, const int *nodes)
{
    sbi_stuffing_view v;
    int sides[4];
    sbi_stuffing_look(s, nodes, &v);
    if (v.zeros == 4) {
        int label = sbi_stuffing_label_of_four(s, v.point);
        if (label > 0)
            sbi_stuffing_put_element(s, label, nodes[0], nodes[1], nodes[2], nodes[3]);
        return;
    }
    for (int i = 0; i < 4; i++) {
        int state = v.point[i] < 0 ? 0 : s->points[v.point[i]].state;
        if (v.outside)
            sides[i] = state == SBI_STUFF_OUTER ? 0 : state == SBI_STUFF_STRICT && v.label[i] == 0 ? -1 : 1;
        else
            sides[i] = state ? 0 : v.label[i] == v.a ? 1 : -1;
    }
    if (v.outside) {
        int label = v.a > 0 ? v.a : sbi_stuffing_label_of_zeros(s, nodes);
        sbi_stuffing_apply(s, &v, sides, 1, label);
        return;
    }
    sbi_stuffing_apply(s, &v, sides, 1, v.a);
    if (v.b > 0)
        sbi_stuffing_apply(s, &v, sides, -1, v.b);
}

static sb_result sbi_stuffing_cut(sbi_stuffing *s)
{
    const sb_allocator *allocator = &s->def->allocator;
    size_t edges = (size_t)s->surface.count * SBI_STUFF_EDGES, cuts = 0;
    for (int i = 0; i < s->surface.count; i++)
        for (int edge = 0; edge < SBI_STUFF_EDGES; edge++)
            cuts += s->points[i].cut[edge] >= 0;
    s->cut_node = (int *)sbi_alloc(allocator, edges, sizeof(int));
    s->cut_positions = (sb_vec3 *)sbi_alloc(allocator, cuts, sizeof(sb_vec3));
    if (!s->cut_node || !s->cut_positions || cuts > (size_t)(INT_MAX - s->active.count))
        return sbi_stuffing_no_memory(s);
    memset(s->cut_node, 0xff, edges * sizeof(int)); /* all -1 */
    for (int pass = 0; pass < 2; pass++) { /* count, then fill */
        s->element_count = 0;
        for (int t = 0; t < s->tet_count && s->element_count < INT_MAX - 8; t++)
            sbi_stuffing_cut_tet(s, s->tets + 4 * (size_t)t);
        if (pass == 1)
            break;
        if (s->element_count == 0)
            return sbi_fail(s->error, SB_ERROR_MESH,
                            "nothing to mesh: the first shape is much thinner than cells of %g m everywhere",
                            (double)s->def->cell);
        if (s->element_count > s->def->max_elements)
            return sbi_stuffing_too_many(s);
        s->element_capacity = s->element_count;
        s->elements = (int *)sbi_alloc(allocator, (size_t)s->element_count, 4 * sizeof(int));
        s->element_labels = (unsigned char *)sbi_alloc(allocator, (size_t)s->element_count, 1);
        if (!s->elements || !s->element_labels)
            return sbi_stuffing_no_memory(s);
    }
    return SB_OK;
}

/* ---- the mesh ---- */

static sb_vec3 sbi_stuffing_node(const sbi_stuffing *s, int node)
{
    return node < s->active.count ? s->positions[node] : s->cut_positions[node - s->active.count];
}

/* Copies elements and the nodes they use into the mesh, each tet turned so that its volume is positive. */
static sb_result sbi_stuffing_collect(sbi_stuffing *s, sb_mesh *mesh)
{
    int total = s->active.count + s->cut_count, used = 0;
    int *map = (int *)sbi_alloc_zeroed(&s->def->allocator, (size_t)total, sizeof(int));
    if (!map)
        return sbi_stuffing_no_memory(s);
    for (size_t i = 0; i < 4 * (size_t)s->element_count; i++)
        map[s->elements[i]] = 1;
    for (int node = 0; node < total; node++)
        used += map[node];
    if (!sbi_mesh_allocate(mesh, SB_TET4, used, s->element_count, 1, &s->def->allocator)) {
        sbi_free(&s->def->allocator, map);
        return sbi_stuffing_no_memory(s);
    }
    used = 0;
    for (int node = 0; node < total; node++)
        if (map[node]) {
            mesh->nodes[used] = sbi_stuffing_node(s, node);
            map[node] = used++;
        }
    for (int e = 0; e < s->element_count; e++) {
        int *nodes = mesh->elements + 4 * (size_t)e, *x = s->elements + 4 * (size_t)e;
        for (int i = 0; i < 4; i++)
            nodes[i] = map[x[i]];
        if (sb_mesh_element_volume(mesh, e) < 0) {
            int swap = nodes[2];
            nodes[2] = nodes[3];
            nodes[3] = swap;
        }
        mesh->regions[e] = s->def->shapes[s->element_labels[e] - 1].region;
    }
    sbi_free(&s->def->allocator, map);
    return SB_OK;
}

/* ---- 6. the boundary ----
 * Its nodes lie on the surface, but a triangle between them cuts the corner at ridges and thin parts. Where it leaves
 * the surface by more than SBI_STUFF_FAR its nodes slide along the surface towards what it misses, as long as all tets
 * at them keep angles within the bounds and no triangle becomes worse than the worst was; where that is not enough,
 * edges get a node in the middle, under the same condition. */

#define SBI_STUFF_FAR ((sb_real)0.3) /* cells */
#define SBI_STUFF_ROUNDS 8
#define SBI_STUFF_ATTEMPTS 12          /* places of the lattice that are tried while the boundary is too far off */
#define SBI_STUFF_SPLITS 4             /* rounds of splitting edges where sliding does not do */
#define SBI_STUFF_SAMPLES 16         /* of a triangle: the first few tell whether the others are worth a look */
#define SBI_STUFF_FIRST_SAMPLES 7    /* corners, middles of edges, centre */

typedef struct sbi_stuffing_rim {
    const sbi_stuffing *s;
    sb_mesh *mesh;
    sb_boundary boundary;
    sb_index_lists tets, faces; /* of nodes of the mesh; of nodes of the boundary */
    sb_real *worst;             /* [faces] largest distance of a sample */
} sbi_stuffing_rim;

/* Closest point of the first shape; functions: by Newton steps along the gradient, of a cell at most. p itself where
 * they lead nowhere, as for functions that are no distances at all. */
static sb_vec3 sbi_stuffing_closest(const sbi_stuffing *s, sb_vec3 p)
{
    const sb_shape *g = s->def->shapes;
    const sb_real step = (sb_real)0.01 * s->half;
    const sb_vec3 start = p;
    sb_surface_hit hit;
    sb_real first;
    if (g->surface)
        return sb_surface_closest(g->surface, p, SB_REAL_MAX, &hit) ? hit.point : p;
    first = sb_abs(sbi_stuffing_value(s, 0, p));
    for (int i = 0; i < 4; i++) {
        sb_real value = sbi_stuffing_value(s, 0, p), size, length;
        sb_vec3 n;
        n.x = sbi_stuffing_value(s, 0, sb_v3(p.x + step, p.y, p.z));
        n.y = sbi_stuffing_value(s, 0, sb_v3(p.x, p.y + step, p.z));
        n.z = sbi_stuffing_value(s, 0, sb_v3(p.x, p.y, p.z + step));
        n.x -= sbi_stuffing_value(s, 0, sb_v3(p.x - step, p.y, p.z));
        n.y -= sbi_stuffing_value(s, 0, sb_v3(p.x, p.y - step, p.z));
        n.z -= sbi_stuffing_value(s, 0, sb_v3(p.x, p.y, p.z - step));
        size = sb_v3_norm(n);
        if (!(size > 0) || !sb_is_finite(size))
            break;
        length = sb_min(sb_abs(value) * 2 * step / size, s->def->cell);
        p = sb_v3_madd(p, (value > 0 ? -length : length) / size, n);
    }
    return sb_abs(sbi_stuffing_value(s, 0, p)) < (sb_real)0.1 * first ? p : start;
}

/* Sample k of a triangle: corners, middles of edges, centre, quarters of edges, and between. */
static sb_vec3 sbi_stuffing_sample_point(const sb_mesh *surface, int face, int k)
{
    static const signed char twelfths[SBI_STUFF_SAMPLES][3] = {
        {12, 0, 0}, {0, 12, 0}, {0, 0, 12}, {6, 6, 0}, {0, 6, 6}, {6, 0, 6}, {4, 4, 4}, {9, 3, 0},
        {3, 9, 0},  {0, 9, 3},  {0, 3, 9},  {3, 0, 9}, {9, 0, 3}, {6, 3, 3}, {3, 6, 3}, {3, 3, 6}};
    const int *nodes = surface->elements + 3 * (size_t)face;
    sb_vec3 p = sb_v3(0, 0, 0);
    for (int i = 0; i < 3; i++)
        p = sb_v3_madd(p, (sb_real)twelfths[k][i] / 12, surface->nodes[nodes[i]]);
    return p;
}

/* Largest distance of a triangle's samples; *from (or NULL) the worst of them, *away from there to the surface. Gives
 * up beyond `limit`: what is returned is then some distance above it. Triangles close to the surface at their first
 * samples are not far between them. */
static sb_real sbi_stuffing_face_distance(const sbi_stuffing_rim *rim, int face, sb_real limit, sb_vec3 *from,
                                          sb_vec3 *away)
{
    const sb_real doubtful = (sb_real)0.5 * SBI_STUFF_FAR * rim->s->def->cell;
    sb_real worst = 0;
    for (int i = 0; i < SBI_STUFF_SAMPLES && worst <= limit; i++) {
        int k = i < SBI_STUFF_FIRST_SAMPLES ? SBI_STUFF_FIRST_SAMPLES - 1 - i : i;
        sb_vec3 p, d;
        sb_real distance;
        if (i == SBI_STUFF_FIRST_SAMPLES && worst < doubtful)
            break;
        p = sbi_stuffing_sample_point(&rim->boundary.surface, face, k);
        d = sb_v3_sub(sbi_stuffing_closest(rim->s, p), p);
        distance = sb_v3_norm(d);
        if (away && (distance > worst || i == 0)) {
            *from = p;
            *away = d;
        }
        worst = sb_max(worst, distance);
    }
    return worst;
}

static void sbi_stuffing_measure_task(void *user, int index)
{
    sbi_stuffing_rim *rim = (sbi_stuffing_rim *)user;
    int count = rim->boundary.surface.element_count;
    int end = index < (count - 1) / SBI_STUFF_CHUNK ? (index + 1) * SBI_STUFF_CHUNK : count;
    for (int f = index * SBI_STUFF_CHUNK; f < end; f++)
        rim->worst[f] = sbi_stuffing_face_distance(rim, f, SB_REAL_MAX, NULL, NULL);
}

static void sbi_stuffing_set_node(sbi_stuffing_rim *rim, int node, sb_vec3 x)
{
    rim->boundary.surface.nodes[node] = x;
    rim->mesh->nodes[rim->boundary.nodes[node]] = x;
}

/* Whether a tet is positive and well shaped with node `node` at x. */
static int sbi_stuffing_is_sound(const sb_mesh *mesh, int tet, int node, sb_vec3 x)
{
    const int *nodes = mesh->elements + 4 * (size_t)tet;
    sb_vec3 c[4];
    for (int i = 0; i < 4; i++)
        c[i] = nodes[i] == node ? x : mesh->nodes[nodes[i]];
    return sb_v3_dot(sb_v3_cross(sb_v3_sub(c[1], c[0]), sb_v3_sub(c[2], c[0])), sb_v3_sub(c[3], c[0])) > 0 &&
           sbi_stuffing_is_well_shaped(c);
}

static int sbi_stuffing_tets_are_sound(const sbi_stuffing_rim *rim, int node, sb_vec3 x)
{
    int at = rim->boundary.nodes[node];
    for (int k = rim->tets.offsets[at]; k < rim->tets.offsets[at + 1]; k++)
        if (!sbi_stuffing_is_sound(rim->mesh, rim->tets.items[k], at, x))
            return 0;
    return 1;
}

/* Largest distance of the triangles at a node; gives up beyond `limit`. */
static sb_real sbi_stuffing_distance_round(const sbi_stuffing_rim *rim, int node, sb_real limit)
{
    sb_real worst = 0;
    for (int k = rim->faces.offsets[node]; k < rim->faces.offsets[node + 1] && worst <= limit; k++)
        worst = sb_max(worst, sbi_stuffing_face_distance(rim, rim->faces.items[k], limit, NULL, NULL));
    return worst;
}

/* Slides a node by about `by`, or towards the point that lies too far away, where that brings the triangles round it
 * closer to the surface. Returns 1 when it did. */
static int sbi_stuffing_slide(sbi_stuffing_rim *rim, int node, sb_vec3 from, sb_vec3 by)
{
    static const sb_real scales[6][2] = {
        {1, 0}, {(sb_real)0.5, 0}, {2, 0}, {0, 0}, {0, (sb_real)0.25}, {0, (sb_real)0.5}};
    sb_vec3 start = rim->boundary.surface.nodes[node], best = start;
    sb_real least = 0;
    for (int k = rim->faces.offsets[node]; k < rim->faces.offsets[node + 1]; k++)
        least = sb_max(least, rim->worst[rim->faces.items[k]]);
    least *= (sb_real)0.99; /* gains of less are not worth a round */
    for (int i = 0; i < 6; i++) {
        sb_real distance;
        sb_vec3 step = sb_v3_madd(sb_v3_scale(scales[i][0], by), scales[i][1], sb_v3_sub(from, start));
        sb_vec3 x = sbi_stuffing_closest(rim->s, sb_v3_add(start, step));
        if (!sbi_stuffing_tets_are_sound(rim, node, x))
            continue;
        sbi_stuffing_set_node(rim, node, x);
        distance = sbi_stuffing_distance_round(rim, node, least);
        if (distance < least) {
            least = distance;
            best = rim->boundary.surface.nodes[node];
        }
    }
    sbi_stuffing_set_node(rim, node, best);
    if (sb_v3_norm(sb_v3_sub(best, start)) == 0)
        return 0;
    for (int k = rim->faces.offsets[node]; k < rim->faces.offsets[node + 1]; k++)
        rim->worst[rim->faces.items[k]] = sbi_stuffing_face_distance(rim, rim->faces.items[k], SB_REAL_MAX, NULL, NULL);
    return 1;
}

static sb_result sbi_stuffing_slide_all(sbi_stuffing_rim *rim)
{
    const sb_real enough = SBI_STUFF_FAR * rim->s->def->cell;
    const sb_mesh *surface = &rim->boundary.surface;
    sb_result result;
    int changed = 0;
    for (int f = 0; f < surface->element_count; f++)
        changed |= rim->worst[f] > enough;
    if (!changed)
        return SB_OK;
    result = sb_mesh_node_elements(rim->mesh, &rim->s->def->allocator, &rim->tets, rim->s->error);
    if (result == SB_OK)
        result = sb_mesh_node_elements(surface, &rim->s->def->allocator, &rim->faces, rim->s->error);
    for (int round = 0; round < SBI_STUFF_ROUNDS && changed && result == SB_OK; round++) {
        changed = 0;
        for (int f = 0; f < surface->element_count; f++) {
            for (int i = 0; i < 3 && rim->worst[f] > enough; i++) {
                sb_vec3 from = {0, 0, 0}, away = {0, 0, 0};
                sbi_stuffing_face_distance(rim, f, SB_REAL_MAX, &from, &away);
                changed |= sbi_stuffing_slide(rim, surface->elements[3 * (size_t)f + (size_t)i], from, away);
            }
        }
    }
    return result;
}

/* An edge of the boundary that is to get a node in the middle, at `at` on the surface. */
typedef struct sbi_stuffing_split {
    int a, b; /* nodes of the mesh */
    sb_vec3 at;
} sbi_stuffing_split;

static int sbi_stuffing_tet_has(const sb_mesh *mesh, int tet, int node)
{
    const int *nodes = mesh->elements + 4 * (size_t)tet;
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

/* Whether the tets round an edge stay sound when it is split; taken [tets]: those that other splits change already.
 * Returns how many there are, or 0. */
static int sbi_stuffing_can_split(const sbi_stuffing_rim *rim, const sbi_stuffing_split *split,
                                  const unsigned char *taken)
{
    int count = 0;
    for (int k = rim->tets.offsets[split->a]; k < rim->tets.offsets[split->a + 1]; k++) {
        int tet = rim->tets.items[k];
        if (!sbi_stuffing_tet_has(rim->mesh, tet, split->b))
            continue;
        if (taken[tet] || !sbi_stuffing_is_sound(rim->mesh, tet, split->a, split->at) ||
            !sbi_stuffing_is_sound(rim->mesh, tet, split->b, split->at))
            return 0;
        count++;
    }
    return count;
}

/* Chooses a split for a triangle that is too far from the surface: the edge whose middle is, or its longest one, with
 * the new node where the middle's closest point is or beyond it, towards a ridge; in the last round, if need be, half
 * way to it. Returns how many tets it adds, or 0. */
static int sbi_stuffing_choose_split(const sbi_stuffing_rim *rim, int face, int is_last, const unsigned char *taken,
                                     sbi_stuffing_split *split)
{
    const int *nodes = rim->boundary.surface.elements + 3 * (size_t)face;
    const sb_vec3 *x = rim->boundary.surface.nodes;
    int edge = -1, longest = 0, count = 0, last = is_last ? 1 : 2;
    sb_real farthest = SBI_STUFF_FAR * rim->s->def->cell;
    sb_vec3 middle, away;
    for (int k = 0; k < 3; k++) {
        sb_vec3 p = sbi_stuffing_sample_point(&rim->boundary.surface, face, 3 + k);
        sb_real distance = sb_v3_norm(sb_v3_sub(sbi_stuffing_closest(rim->s, p), p));
        if (distance > farthest) {
            farthest = distance;
            edge = k;
        }
        if (sb_v3_norm(sb_v3_sub(x[nodes[k]], x[nodes[(k + 1) % 3]])) >
            sb_v3_norm(sb_v3_sub(x[nodes[longest]], x[nodes[(longest + 1) % 3]])))
            longest = k;
    }
    edge = edge < 0 ? longest : edge;
    split->a = rim->boundary.nodes[nodes[edge]];
    split->b = rim->boundary.nodes[nodes[(edge + 1) % 3]];
    middle = sbi_stuffing_sample_point(&rim->boundary.surface, face, 3 + edge);
    away = sb_v3_sub(sbi_stuffing_closest(rim->s, middle), middle);
    for (int k = 4; k >= last && count == 0; k--) {
        sb_vec3 at = sb_v3_madd(middle, (sb_real)0.5 * (sb_real)k, away);
        split->at = k > 1 ? sbi_stuffing_closest(rim->s, at) : at;
        count = sbi_stuffing_can_split(rim, split, taken);
    }
    return count;
}

/* The mesh with edges split; no tet has two of them. */
static sb_result sbi_stuffing_apply_splits(const sbi_stuffing_rim *rim, const sbi_stuffing_split *splits, int count,
                                           int added, sb_mesh *result)
{
    const sb_mesh *mesh = rim->mesh;
    int next = mesh->element_count;
    if (mesh->element_count > rim->s->def->max_elements - added)
        return sbi_stuffing_too_many(rim->s);
    if (!sbi_mesh_allocate(result, SB_TET4, mesh->node_count + count, mesh->element_count + added, 1,
                           &rim->s->def->allocator))
        return sbi_fail(rim->s->error, SB_ERROR_MEMORY, "out of memory for a mesh of %d nodes",
                        mesh->node_count + count);
    memcpy(result->nodes, mesh->nodes, (size_t)mesh->node_count * sizeof(sb_vec3));
    memcpy(result->elements, mesh->elements, (size_t)mesh->element_count * 4 * sizeof(int));
    memcpy(result->regions, mesh->regions, (size_t)mesh->element_count * sizeof(int));
    for (int i = 0; i < count; i++) {
        const sbi_stuffing_split *split = splits + i;
        result->nodes[mesh->node_count + i] = split->at;
        for (int k = rim->tets.offsets[split->a]; k < rim->tets.offsets[split->a + 1]; k++) {
            int tet = rim->tets.items[k], *old = result->elements + 4 * (size_t)tet;
            int *half = result->elements + 4 * (size_t)next;
            if (!sbi_stuffing_tet_has(mesh, tet, split->b))
                continue;
            for (int j = 0; j < 4; j++) {
                half[j] = old[j] == split->b ? mesh->node_count + i : old[j];
                old[j] = old[j] == split->a ? mesh->node_count + i : old[j];
            }
            result->regions[next++] = result->regions[tet];
        }
    }
    return SB_OK;
}

/* Splits edges where the boundary is still too far from the surface; *count: how many. */
static sb_result sbi_stuffing_split_all(sbi_stuffing_rim *rim, int is_last, int *count)
{
    const sb_allocator *allocator = &rim->s->def->allocator;
    const sb_real limit = SBI_STUFF_FAR * rim->s->def->cell;
    int faces = rim->boundary.surface.element_count, far = 0, added = 0;
    sbi_stuffing_split *splits;
    unsigned char *taken;
    sb_result result = SB_OK;
    *count = 0;
    for (int f = 0; f < faces; f++)
        far += rim->worst[f] > limit;
    if (far == 0)
        return SB_OK;
    splits = (sbi_stuffing_split *)sbi_alloc(allocator, (size_t)far, sizeof *splits);
    taken = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)rim->mesh->element_count, 1);
    if (!splits || !taken)
        result = sbi_stuffing_no_memory(rim->s);
    for (int f = 0; f < faces && result == SB_OK; f++) {
        sbi_stuffing_split *split = splits + *count;
        int more = rim->worst[f] > limit ? sbi_stuffing_choose_split(rim, f, is_last, taken, split) : 0;
        if (more == 0)
            continue;
        for (int k = rim->tets.offsets[split->a]; k < rim->tets.offsets[split->a + 1]; k++)
            if (sbi_stuffing_tet_has(rim->mesh, rim->tets.items[k], split->b))
                taken[rim->tets.items[k]] = 1;
        added += more;
        ++*count;
    }
    if (result == SB_OK && *count > 0) {
        sb_mesh split;
        result = sbi_stuffing_apply_splits(rim, splits, *count, added, &split);
        if (result == SB_OK) {
            sb_mesh_free(rim->mesh);
            *rim->mesh = split;
        }
    }
    sbi_free(allocator, splits);
    sbi_free(allocator, taken);
    return result;
}

/* Round 0, 1, ... of sliding and splitting: *again tells whether edges were split; then *distance is of before. */
static sb_result sbi_stuffing_refine_boundary(const sbi_stuffing *s, sb_mesh *mesh, int round, int *again,
                                              sb_real *distance)
{
    sbi_stuffing_rim rim;
    sb_result result;
    memset(&rim, 0, sizeof rim);
    rim.s = s;
    rim.mesh = mesh;
    *again = 0;
    *distance = 0;
    result = sb_mesh_boundary(mesh, 1, &s->def->allocator, &rim.boundary, s->error);
    if (result == SB_OK) {
        int count = rim.boundary.surface.element_count;
        rim.worst = (sb_real *)sbi_alloc(&s->def->allocator, (size_t)count, sizeof(sb_real));
        if (rim.worst) {
            sbi_run(&s->def->jobs, sbi_stuffing_measure_task, &rim, (count - 1) / SBI_STUFF_CHUNK + 1);
            result = sbi_stuffing_slide_all(&rim);
        } else {
            result = sbi_fail(s->error, SB_ERROR_MEMORY, "out of memory for a boundary of %d triangles", count);
        }
        for (int f = 0; f < count && result == SB_OK; f++)
            *distance = sb_max(*distance, rim.worst[f]);
        if (result == SB_OK && round < SBI_STUFF_SPLITS)
            result = sbi_stuffing_split_all(&rim, round == SBI_STUFF_SPLITS - 1, again);
    }
    sb_boundary_free(&rim.boundary);
    sb_index_lists_free(&rim.tets);
    sb_index_lists_free(&rim.faces);
    sbi_free(&s->def->allocator, rim.worst);
    return result;
}

/* Brings the boundary close to the surface and tells how close it is. */
static sb_result sbi_stuffing_finish_boundary(const sbi_stuffing *s, sb_mesh *mesh, sb_real *distance)
{
    sb_result result = SB_OK;
    int again = 1;
    for (int round = 0; round <= SBI_STUFF_SPLITS && again && result == SB_OK; round++)
        result = sbi_stuffing_refine_boundary(s, mesh, round, &again, distance);
    return result;
}

/* All but the shares. */
static void sbi_stuffing_fill_report(const sb_mesh *mesh, sb_real distance, const int cells[3], sb_stuff_report *report)
{
    memcpy(report->cells, cells, sizeof report->cells);
    report->node_count = mesh->node_count;
    report->element_count = mesh->element_count;
    report->distance = distance;
    report->volume = sb_mesh_volume(mesh);
    sb_mesh_dihedral_range(mesh, &report->min_dihedral, &report->max_dihedral);
}

static void sbi_stuffing_free(sbi_stuffing *s)
{
    const sb_allocator *allocator = &s->def->allocator;
    sbi_free(allocator, s->labels);
    for (int level = 0; level <= SBI_STUFF_MAX_LEVELS; level++)
        sbi_free(allocator, s->split[level]);
    sbi_stuffing_set_free(s, &s->surface);
    sbi_stuffing_set_free(s, &s->active);
    sbi_free(allocator, s->tets);
    sbi_free(allocator, s->positions);
    sbi_free(allocator, s->active_label);
    sbi_free(allocator, s->point_of);
    sbi_free(allocator, s->points);
    sbi_free(allocator, s->values);
    sbi_free(allocator, s->failures);
    sbi_free(allocator, s->cut_node);
    sbi_free(allocator, s->cut_positions);
    sbi_free(allocator, s->elements);
    sbi_free(allocator, s->element_labels);
}

/* From the def to a tet4 mesh. */
static sb_result sbi_stuffing_build(sbi_stuffing *s, sb_mesh *mesh)
{
    sb_result result = sbi_stuffing_lay_out(s);
    if (result == SB_OK)
        result = sbi_stuffing_sample(s);
    if (result == SB_OK)
        result = sbi_stuffing_find_surface(s);
    if (result == SB_OK)
        result = sbi_stuffing_grade(s);
    if (result == SB_OK)
        result = sbi_stuffing_enumerate(s);
    if (result == SB_OK)
        result = sbi_stuffing_over_points(s, sbi_stuffing_value_task, 0.5, 0.6);
    if (result == SB_OK)
        result = sbi_stuffing_over_points(s, sbi_stuffing_cut_task, 0.6, 0.9);
    if (result != SB_OK)
        return result;
    sbi_stuffing_place_zeros(s);
    result = sbi_stuffing_cut(s);
    if (result == SB_OK)
        result = sbi_stuffing_collect(s, mesh);
    return result;
}

/* A tet4 mesh with one of the lattice's places; *distance (m) of its boundary from the shape. */
static sb_result sbi_stuffing_make(const sb_stuff_def *def, int attempt, double *told, sb_mesh *mesh, sb_real *distance,
                                   int cells[3], sb_error *error)
{
    sbi_stuffing s;
    sb_result result;
    memset(&s, 0, sizeof s);
    memset(mesh, 0, sizeof *mesh);
    s.def = def;
    s.error = error;
    s.attempt = attempt;
    s.told = told;
    result = sbi_stuffing_build(&s, mesh);
    if (result == SB_OK)
        result = sbi_stuffing_progress(&s, 0.9);
    if (result == SB_OK)
        result = sbi_stuffing_finish_boundary(&s, mesh, distance);
    if (result != SB_OK)
        sb_mesh_free(mesh);
    memcpy(cells, s.n, sizeof s.n);
    sbi_stuffing_free(&s);
    return result;
}

/* While the boundary is too far off, as where a thin part ends between lattice points, shifted lattices are tried; the
 * nearest mesh is kept. */
static sb_result sbi_stuffing_make_best(const sb_stuff_def *def, double *told, sb_mesh *mesh, sb_real *distance,
                                        int cells[3], sb_error *error)
{
    sb_result result = sbi_stuffing_make(def, 0, told, mesh, distance, cells, error);
    for (int attempt = 1; attempt < SBI_STUFF_ATTEMPTS && result == SB_OK && *distance > def->cell / 3; attempt++) {
        sb_mesh other;
        sb_real other_distance = 0;
        int other_cells[3];
        sb_result tried = sbi_stuffing_make(def, attempt, told, &other, &other_distance, other_cells, error);
        if (tried == SB_ERROR_MEMORY || tried == SB_ERROR_CANCELLED || tried == SB_ERROR_NOT_FINITE)
            result = tried;
        if (tried != SB_OK)
            continue;
        if (other_distance < *distance) {
            sb_mesh swap = *mesh;
            *mesh = other;
            other = swap;
            *distance = other_distance;
            memcpy(cells, other_cells, sizeof other_cells);
        }
        sb_mesh_free(&other);
    }
    return result;
}

SB_API sb_result sb_mesh_stuff(const sb_stuff_def *def, sb_mesh *mesh, sb_stuff_report *report, sb_error *error)
{
    sb_mesh made, raised;
    sb_stuff_report found;
    sb_real distance = 0;
    double told = 0;
    int cells[3];
    sb_result result = sbi_stuffing_check(def, mesh, error);
    if (result == SB_OK)
        result = sbi_stuffing_check_orientation(def, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    memset(&found, 0, sizeof found);
    result = sbi_stuffing_make_best(def, &told, &made, &distance, cells, error);
    if (result == SB_OK || result == SB_ERROR_MESH) { /* nothing to mesh: `made` is empty, and is told why */
        sb_result kept = sbi_stuffing_measure_shares(def, &made, &found, error);
        result = kept == SB_OK ? result : kept;
    }
    if (result == SB_OK)
        result = sb_mesh_reorder(&made, NULL, NULL, error);
    if (result == SB_OK && def->type == SB_TET10) {
        result = sb_mesh_to_tet10(&made, &def->allocator, &raised, error);
        if (result == SB_OK) {
            sb_mesh_free(&made);
            made = raised;
        }
    }
    if (result == SB_OK && def->progress && def->progress(def->progress_user, 1))
        result = sbi_fail(error, SB_ERROR_CANCELLED, "stopped by the progress callback at the end");
    if (result != SB_OK) {
        sb_mesh_free(&made);
        return result;
    }
    *mesh = made;
    sbi_stuffing_fill_report(mesh, distance, cells, &found);
    if (report)
        *report = found;
    return SB_OK;
}
