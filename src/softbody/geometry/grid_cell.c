/* grid_cell: distances, and the octree in a cell that a surface cuts: what each region has of it. */
#include "grid_private.h"

/* ---- distances ---- */

/* Signed distance of a closed surface. The triangle found last time is a good guess for the next point; where the
 * closest point is in a face, the sign is that face's. doubtful: as sbi_surface_find_doubtful, or NULL. */
static sb_real sbi_grid_surface_distance(const sb_surface *surface, const unsigned char *doubtful, sb_vec3 point,
                                         int *near)
{
    sb_surface_hit hit;
    sb_vec3 normal;
    if (!sb_surface_closest_from(surface, point, SB_REAL_MAX, *near, &hit))
        return sb_surface_signed_distance(surface, point, NULL);
    *near = hit.triangle;
    if (doubtful && doubtful[hit.triangle])
        return sb_surface_inside(surface, point) ? -hit.distance : hit.distance;
    normal = sb_surface_normal(surface, &hit);
    if (hit.feature != SB_SURFACE_FACE || sb_v3_dot(normal, normal) == 0)
        return sb_surface_signed_distance(surface, point, NULL);
    return sb_v3_dot(sb_v3_sub(point, hit.point), normal) < 0 ? -hit.distance : hit.distance;
}

static sb_real sbi_grid_distance(const sbi_grid_work *work, int shape, sb_vec3 point, int *near)
{
    const sb_shape *s = sbi_grid_get_shape(work->def, shape);
    if (!s->surface)
        return s->distance(s->user, point);
    return work->open >> shape & 1u ? sb_surface_signed_distance_winding(s->surface, point, NULL)
                                    : sbi_grid_surface_distance(s->surface, work->doubtful[shape], point, near);
}

SBI_API sb_result sbi_grid_find_doubtful(sbi_grid_work *work, sb_error *error)
{
    const sb_allocator *allocator = &work->def->allocator;
    for (int s = 0; s < work->shape_count; s++) {
        const sb_surface *surface = sbi_grid_get_shape(work->def, s)->surface;
        size_t triangles = (size_t)sb_surface_triangle_count(surface);
        int found, turned = -1;
        if (!surface)
            continue;
        if (!sbi_surface_find_inside_out(surface, allocator, &turned))
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for marks on %d triangles", (int)triangles);
        if (turned >= 0)
            return sbi_fail_element(error, SB_ERROR_MESH, sb_surface_triangle(surface, turned, NULL),
                                    "the surface of %s is inside out, or a part of it is (element %d belongs to it): "
                                    "sb_surface_repair turns it",
                                    s == 0 ? "def.outer" : "an inner shape",
                                    sb_surface_triangle(surface, turned, NULL));
        if (!sb_surface_is_closed(surface)) {
            work->open |= 1u << s;
            continue;
        }
        work->doubtful[s] = (unsigned char *)sbi_alloc(allocator, triangles, 1);
        found = work->doubtful[s] ? sbi_surface_find_doubtful(surface, work->doubtful[s]) : -1;
        if (found < 0)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for marks on %d triangles", (int)triangles);
        if (found == 0) {
            sbi_free(allocator, work->doubtful[s]);
            work->doubtful[s] = NULL;
        }
    }
    return SB_OK;
}

/* ---- boxes ---- */

SBI_API int sbi_grid_decide(const sbi_grid_work *work, sb_real reach, sbi_grid_box *box)
{
    for (int s = 0; s < work->shape_count && box->undecided; s++) {
        const sb_shape *shape = sbi_grid_get_shape(work->def, s);
        unsigned bit = 1u << s;
        sb_real d, slope = shape->surface ? 1 : shape->max_slope;
        if (!(box->undecided & bit))
            continue;
        d = sbi_grid_distance(work, s, box->centre, &box->near[s]);
        if (!sb_is_finite(d))
            return 0;
        if ((slope == 0 && reach > 0) || sb_abs(d) <= reach * slope)
            continue;
        box->undecided &= ~bit;
        if (d < 0)
            box->inside |= bit;
        else if (s == 0)
            box->undecided = 0; /* nothing else counts outside of the outer shape */
    }
    return 1;
}

SBI_API int sbi_grid_slot(const sbi_grid_work *work, unsigned undecided, unsigned inside)
{
    if (undecided & 1u)
        return -2;
    if (!(inside & 1u))
        return -1;
    for (int s = work->shape_count - 1; s > 0; s--) {
        if (undecided >> s & 1u)
            return -2;
        if (inside >> s & 1u)
            return work->slot_of[s];
    }
    return work->slot_of[0];
}

SBI_API sbi_grid_box sbi_grid_make_box(sb_vec3 centre, sb_vec3 half, unsigned undecided, unsigned inside)
{
    sbi_grid_box box;
    box.centre = centre;
    box.half = half;
    box.undecided = undecided;
    box.inside = inside;
    for (int s = 0; s < SB_GRID_MAX_SHAPES; s++)
        box.near[s] = -1;
    return box;
}

SBI_API sb_vec3 sbi_grid_middle(const sb_grid *grid, int x, int y, int z, int width)
{
    sb_real reach = (sb_real)0.5 * (sb_real)width;
    return sb_v3(grid->origin.x + grid->cell_size.x * ((sb_real)x + reach),
                 grid->origin.y + grid->cell_size.y * ((sb_real)y + reach),
                 grid->origin.z + grid->cell_size.z * ((sb_real)z + reach));
}

SBI_API sb_vec3 sbi_grid_cell_middle(const sb_grid *grid, int box)
{
    int x = box % grid->counts[0], row = box / grid->counts[0];
    return sbi_grid_middle(grid, x, row % grid->counts[1], row / grid->counts[1], 1);
}

/* ---- shape functions of a cell ---- */

SBI_API void sbi_grid_shape_functions(const double xi[3], double shape[8])
{
    for (int a = 0; a < 8; a++)
        shape[a] = 0.125 * (1 + sbi_grid_sign(a, 0) * xi[0]) * (1 + sbi_grid_sign(a, 1) * xi[1]) *
                   (1 + sbi_grid_sign(a, 2) * xi[2]);
}

SBI_API void sbi_grid_gradients(sb_vec3 size, const double xi[3], sb_real *gradients)
{
    const double scale[3] = {0.25 / (double)size.x, 0.25 / (double)size.y, 0.25 / (double)size.z};
    for (int a = 0; a < 8; a++)
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            gradients[3 * a + i] = (sb_real)(sbi_grid_sign(a, i) * (1 + sbi_grid_sign(a, j) * xi[j]) *
                                             (1 + sbi_grid_sign(a, k) * xi[k]) * scale[i]);
        }
}

SBI_API void sbi_grid_local(const sb_grid *grid, sb_vec3 middle, sb_vec3 point, double xi[3])
{
    xi[0] = 2 * ((double)point.x - (double)middle.x) / (double)grid->cell_size.x;
    xi[1] = 2 * ((double)point.y - (double)middle.y) / (double)grid->cell_size.y;
    xi[2] = 2 * ((double)point.z - (double)middle.z) / (double)grid->cell_size.z;
}

/* ---- the octree of a cell ---- */

SBI_API void sbi_grid_sum_point(sbi_grid_part *part, const double xi[3], double share, int octant)
{
    double shape[8];
    sbi_grid_shape_functions(xi, shape);
    for (int a = 0, at = 0; a < 8; a++) {
        double w = share * shape[a];
        for (int b = a; b < 8; b++, at++)
            part->mass[at] += w * shape[b];
    }
    part->phi[octant] += 8 * share;
    part->points++;
}

/* A point inside becomes the next one of its region's cells. */
static void sbi_grid_write_point(const sbi_grid_walk *walk, int slot, const double xi[3], double share)
{
    const sb_grid *grid = walk->work->grid;
    double volume = (double)grid->cell_size.x * (double)grid->cell_size.y * (double)grid->cell_size.z;
    size_t at = 8 * (size_t)walk->first_cell + (size_t)walk->at[slot]++;
    grid->domain.weights[at] = (sb_real)((1 - (double)walk->work->def->void_stiffness) * share * volume);
    sbi_grid_gradients(grid->cell_size, xi, grid->domain.gradients + 24 * at);
}

static void sbi_grid_emit(sbi_grid_walk *walk, int slot, sb_vec3 point, double share, int octant)
{
    double xi[3];
    sbi_grid_local(walk->work->grid, walk->centre, point, xi);
    if (walk->parts)
        sbi_grid_sum_point(walk->parts + slot, xi, share, octant);
    else
        sbi_grid_write_point(walk, slot, xi, share);
}

SBI_API sb_vec3 sbi_grid_gauss_point(const sbi_grid_box *box, int p)
{
    const sb_real gauss = (sb_real)0.57735026918962576451;
    return sb_v3(box->centre.x + (p & 1 ? gauss : -gauss) * box->half.x,
                 box->centre.y + (p & 2 ? gauss : -gauss) * box->half.y,
                 box->centre.z + (p & 4 ? gauss : -gauss) * box->half.z);
}

/* The leaf is of one region (slot), or it is cut and its points are looked at one by one (slot -2). Octant -1: the leaf
 * is the whole cell. */
static void sbi_grid_leaf(sbi_grid_walk *walk, const sbi_grid_box *box, int slot, int depth, int octant)
{
    double share = 0.125;
    for (int i = 0; i < depth; i++)
        share *= 0.125;
    for (int p = 0; p < 8 && slot != -1; p++) {
        sb_vec3 point = sbi_grid_gauss_point(box, p);
        int of = slot;
        if (slot == -2) {
            sbi_grid_box single = *box;
            single.centre = point;
            walk->bad |= !sbi_grid_decide(walk->work, 0, &single);
            of = sbi_grid_slot(walk->work, 0, single.inside); /* on a surface: not inside it */
        }
        if (of >= 0)
            sbi_grid_emit(walk, of, point, share, octant < 0 ? p : octant);
    }
}

/* Depth first, children in the order of the points. */
static void sbi_grid_descend(sbi_grid_walk *walk, sbi_grid_box *box, int depth, int octant)
{
    sb_real reach = sb_v3_norm(box->half);
    int slot;
    if (depth == walk->level) /* nothing but its points will be asked for */
        reach *= (sb_real)0.5774;
    walk->bad |= !sbi_grid_decide(walk->work, reach, box);
    slot = sbi_grid_slot(walk->work, box->undecided, box->inside);
    if (slot != -2 || depth == walk->level) {
        sbi_grid_leaf(walk, box, slot, depth, octant);
        return;
    }
    for (int c = 0; c < 8; c++) {
        sb_vec3 half = sb_v3_scale((sb_real)0.5, box->half);
        sbi_grid_box child = *box;
        child.half = half;
        child.centre = sb_v3(box->centre.x + (c & 1 ? half.x : -half.x), box->centre.y + (c & 2 ? half.y : -half.y),
                             box->centre.z + (c & 4 ? half.z : -half.z));
        sbi_grid_descend(walk, &child, depth + 1, depth == 0 ? c : octant);
        memcpy(box->near, child.near, sizeof box->near); /* the next child is not far */
    }
}

SBI_API void sbi_grid_walk_cell(sbi_grid_walk *walk, const sbi_grid_candidate *candidate)
{
    const sb_grid *grid = walk->work->grid;
    sbi_grid_box box;
    walk->centre = sbi_grid_cell_middle(grid, candidate->box);
    walk->level = candidate->level;
    walk->bad = 0;
    box = sbi_grid_make_box(walk->centre, sb_v3_scale((sb_real)0.5, grid->cell_size), candidate->undecided,
                            candidate->inside);
    sbi_grid_descend(walk, &box, 0, -1);
}
