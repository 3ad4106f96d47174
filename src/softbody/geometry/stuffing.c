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
#include "stuffing_private.h"

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
            return sbi_fail_element(error, SB_ERROR_MESH,
                                    sb_surface_triangle(def->shapes[shape].surface, triangle, NULL),
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
static sb_result sbi_stuffing_make(const sb_stuff_def *def, int attempt, double *reported, sb_mesh *mesh,
                                   sb_real *distance, int cells[3], sb_error *error)
{
    sbi_stuffing s;
    sb_result result;
    memset(&s, 0, sizeof s);
    memset(mesh, 0, sizeof *mesh);
    s.def = def;
    s.error = error;
    s.attempt = attempt;
    s.reported = reported;
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
static sb_result sbi_stuffing_make_best(const sb_stuff_def *def, double *reported, sb_mesh *mesh, sb_real *distance,
                                        int cells[3], sb_error *error)
{
    sb_result result = sbi_stuffing_make(def, 0, reported, mesh, distance, cells, error);
    for (int attempt = 1; attempt < SBI_STUFF_ATTEMPTS && result == SB_OK && *distance > def->cell / 3; attempt++) {
        sb_mesh other;
        sb_real other_distance = 0;
        int other_cells[3];
        sb_result tried = sbi_stuffing_make(def, attempt, reported, &other, &other_distance, other_cells, error);
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
    double reported = 0;
    int cells[3];
    sb_result result = sbi_stuffing_check(def, mesh, error);
    if (result == SB_OK)
        result = sbi_stuffing_check_orientation(def, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    memset(&found, 0, sizeof found);
    result = sbi_stuffing_make_best(def, &reported, &made, &distance, cells, error);
    if (result == SB_OK || result == SB_ERROR_MESH) { /* nothing to mesh: `made` is empty, and the error says why */
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
