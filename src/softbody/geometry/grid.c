/* grid: octrees in the cells that a surface cuts, and what comes of them: points, weights, masses. */
#include "grid.h"

#include <string.h>

#define SBI_GRID_COOKIE 0x6e1du

enum {
    SBI_GRID_BLOCK = 4,       /* cells along each edge of a block that is looked at at once */
    SBI_GRID_PROBE_LEVEL = 4, /* how finely the inside of a cell is looked for when the level asked for finds none */
    SBI_GRID_SLAB = 64        /* tasks between two calls of progress */
};

/* What the boxes of a lattice turned out to be. */
enum { SBI_GRID_BAD = 1 << SB_GRID_MAX_SHAPES }; /* no bit of a shape */

SB_API sb_grid_def sb_default_grid_def(void)
{
    sb_grid_def def;
    memset(&def, 0, sizeof def);
    def.method = SB_GRID_WEIGHTED_CELL;
    def.level = 3;
    def.cells = 10;
    def.void_stiffness = (sb_real)1e-4;
    def.max_points = 4000000;
    def.cookie = SBI_GRID_COOKIE;
    return def;
}

SB_API void sb_grid_free(sb_grid *grid)
{
    sb_allocator allocator;
    if (!grid)
        return;
    allocator = grid->allocator;
    sb_mesh_free(&grid->mesh);
    sb_mesh_free(&grid->body_mesh);
    sb_domain_free(&grid->domain);
    sbi_free(&allocator, grid->body_cells);
    sbi_free(&allocator, grid->shares);
    sbi_free(&allocator, grid->lattice);
    sbi_free(&allocator, grid->regions);
    sbi_free(&allocator, grid->region_volumes);
    memset(grid, 0, sizeof *grid);
}

/* ---- what is worked with ---- */

/* A box of the octree. Bits of shapes: bit 0 the outer one, bit i the inner shape i - 1. */
typedef struct sbi_grid_box {
    sb_vec3 centre, half;   /* m */
    unsigned undecided;     /* shapes whose surface may cut the box */
    unsigned inside;        /* shapes that the whole box is inside of */
    int near[SB_GRID_MAX_SHAPES]; /* triangle of each surface that was closest to the last centre, or -1 */
} sbi_grid_box;

/* What one region has of a cell, in shares of the cell. */
typedef struct sbi_grid_part {
    double phi[8];          /* share of each octant */
    double mass[36];        /* int N_a N_b of the pairs a <= b */
    int64_t points;
} sbi_grid_part;

/* A cell that may be kept. */
typedef struct sbi_grid_candidate {
    int box;                /* number in the lattice */
    int level;              /* of its octree */
    int part;               /* its parts start at this times slot_count, or -1: full of one region */
    int slot;               /* that region; of a cut cell: the one with most of it */
    unsigned undecided, inside;
    int first_cell;         /* of the body's mesh */
    int cell_count;         /* there; 0: the cell is dropped */
} sbi_grid_candidate;

typedef struct sbi_grid_work {
    const sb_grid_def *def;
    sb_grid *grid;
    int shape_count, slot_count;
    unsigned open;                       /* shapes, as bits, whose signs only winding numbers tell */
    unsigned char *doubtful[SB_GRID_MAX_SHAPES]; /* [triangles] 1: nor does this one; NULL: it crosses nothing */
    int slot_of[SB_GRID_MAX_SHAPES];     /* slot of each shape's region, or -1: empty */
    int regions[SB_GRID_MAX_SHAPES];     /* [slot_count] */
    unsigned *undecided, *inside;        /* [boxes]; inside SBI_GRID_BAD: a distance was not finite */
    int candidate_count, cut_count;
    sbi_grid_candidate *candidates;      /* [candidate_count] */
    int *cut;                            /* [cut_count] candidates that are cut */
    sbi_grid_part *parts;                /* [cut_count][slot_count] */
    sbi_grid_part full;                  /* of a cell inside */
    double done, total;                  /* tasks, for progress */
    int first_task;                      /* of the slab being run */
    sb_task task;
} sbi_grid_work;

/* Walks an octree and hands points on: to the sums of the cell's parts, or to where finite cells are written. */
typedef struct sbi_grid_walk {
    const sbi_grid_work *work;
    sb_vec3 centre;         /* of the cell (m) */
    int level;
    sbi_grid_part *parts;   /* [slot_count], or NULL: */
    int *at;                /* [slot_count] next point of each region, counted from the cell's first */
    int first_cell;         /* of the body's mesh */
    int bad;                /* 1: a distance was not finite */
} sbi_grid_walk;

/* ---- distances ---- */

static const sb_shape *sbi_grid_get_shape(const sb_grid_def *def, int shape)
{
    return shape == 0 ? &def->outer : def->inner + (shape - 1);
}

/* Signed distance of a closed surface. The triangle found last time is a good guess for the next point; where the closest
 * point is in a face, the sign is that face's. doubtful: as sbi_surface_find_doubtful, or NULL. */
static sb_real sbi_grid_surface_distance(const sb_surface *surface, const unsigned char *doubtful, sb_vec3 point, int *near)
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

static sb_result sbi_grid_find_doubtful(sbi_grid_work *work, sb_error *error)
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
                                    s == 0 ? "def.outer" : "an inner shape", sb_surface_triangle(surface, turned, NULL));
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

/* Looks which surfaces keep clear of what is within `reach` (m) of the box's middle. Returns 0 when a distance is not
 * finite. */
static int sbi_grid_decide(const sbi_grid_work *work, sb_real reach, sbi_grid_box *box)
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

/* Slot of the region that the whole box is of, -1 where it is empty, -2 when that is open. */
static int sbi_grid_slot(const sbi_grid_work *work, unsigned undecided, unsigned inside)
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

static sbi_grid_box sbi_grid_make_box(sb_vec3 centre, sb_vec3 half, unsigned undecided, unsigned inside)
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

/* Middle of a lattice box `index` cells from the origin, or of a block of `width` cells from there. */
static sb_vec3 sbi_grid_middle(const sb_grid *grid, int x, int y, int z, int width)
{
    sb_real reach = (sb_real)0.5 * (sb_real)width;
    return sb_v3(grid->origin.x + grid->cell_size.x * ((sb_real)x + reach),
                 grid->origin.y + grid->cell_size.y * ((sb_real)y + reach),
                 grid->origin.z + grid->cell_size.z * ((sb_real)z + reach));
}

static sb_vec3 sbi_grid_cell_middle(const sb_grid *grid, int box)
{
    int x = box % grid->counts[0], row = box / grid->counts[0];
    return sbi_grid_middle(grid, x, row % grid->counts[1], row / grid->counts[1], 1);
}

/* ---- shape functions of a cell ---- */

/* Signs of local coordinates at the corners, in VTK's order. */
static double sbi_grid_sign(int node, int axis)
{
    static const signed char sign[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                                           {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};
    return (double)sign[node][axis];
}

static void sbi_grid_shape_functions(const double xi[3], double shape[8])
{
    for (int a = 0; a < 8; a++)
        shape[a] = 0.125 * (1 + sbi_grid_sign(a, 0) * xi[0]) * (1 + sbi_grid_sign(a, 1) * xi[1]) *
                   (1 + sbi_grid_sign(a, 2) * xi[2]);
}

/* Gradients (1/m) in a brick of this size. */
static void sbi_grid_gradients(sb_vec3 size, const double xi[3], sb_real *gradients)
{
    const double scale[3] = {0.25 / (double)size.x, 0.25 / (double)size.y, 0.25 / (double)size.z};
    for (int a = 0; a < 8; a++)
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            gradients[3 * a + i] = (sb_real)(sbi_grid_sign(a, i) * (1 + sbi_grid_sign(a, j) * xi[j]) *
                                             (1 + sbi_grid_sign(a, k) * xi[k]) * scale[i]);
        }
}

/* Local coordinates of a point in the cell with this middle. */
static void sbi_grid_local(const sb_grid *grid, sb_vec3 middle, sb_vec3 point, double xi[3])
{
    xi[0] = 2 * ((double)point.x - (double)middle.x) / (double)grid->cell_size.x;
    xi[1] = 2 * ((double)point.y - (double)middle.y) / (double)grid->cell_size.y;
    xi[2] = 2 * ((double)point.z - (double)middle.z) / (double)grid->cell_size.z;
}

/* ---- the octree of a cell ---- */

/* What a point inside adds to the sums of its region: `share` of the cell. */
static void sbi_grid_sum_point(sbi_grid_part *part, const double xi[3], double share, int octant)
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

/* Point p of eight in a box: Gauss's two along each axis, the first axis fastest. */
static sb_vec3 sbi_grid_gauss_point(const sbi_grid_box *box, int p)
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

static void sbi_grid_walk_cell(sbi_grid_walk *walk, const sbi_grid_candidate *candidate)
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

/* ---- running tasks ---- */

static void sbi_grid_slab_task(void *user, int index)
{
    sbi_grid_work *work = (sbi_grid_work *)user;
    work->task(work, work->first_task + index);
}

/* Runs task(work, i) for i in [0, count), by slabs, and tells of progress up to `share` of the whole. */
static sb_result sbi_grid_run(sbi_grid_work *work, sb_task task, int count, double share, sb_error *error)
{
    double before = work->done;
    work->task = task;
    for (int first = 0; first < count; first += SBI_GRID_SLAB) {
        int now = sbi_min_int(SBI_GRID_SLAB, count - first);
        work->first_task = first;
        sbi_run(&work->def->jobs, sbi_grid_slab_task, work, now);
        work->done = before + share * (double)(first + now) / (double)count;
        if (work->def->progress && work->def->progress(work->def->progress_user, work->done))
            return sbi_fail(error, SB_ERROR_CANCELLED, "stopped by the progress callback at %.0f %%", 100 * work->done);
    }
    work->done = before + share;
    return SB_OK;
}

/* ---- which cells the surfaces cut ---- */

static int sbi_grid_blocks(int count) { return (count - 1) / SBI_GRID_BLOCK + 1; }

static void sbi_grid_store_box(const sbi_grid_work *work, int x, int y, int z, const sbi_grid_box *box, int good)
{
    const int *counts = work->grid->counts;
    size_t at = ((size_t)z * (size_t)counts[1] + (size_t)y) * (size_t)counts[0] + (size_t)x;
    work->undecided[at] = good ? box->undecided : 0;
    work->inside[at] = good ? box->inside : (unsigned)SBI_GRID_BAD;
}

/* Task: the cells of a block. */
static void sbi_grid_classify_block(void *user, int index)
{
    const sbi_grid_work *work = (const sbi_grid_work *)user;
    const sb_grid *grid = work->grid;
    const int *counts = grid->counts;
    int bx = sbi_grid_blocks(counts[0]), by = sbi_grid_blocks(counts[1]);
    int x0 = index % bx * SBI_GRID_BLOCK, y0 = index / bx % by * SBI_GRID_BLOCK, z0 = index / bx / by * SBI_GRID_BLOCK;
    sb_vec3 half = sb_v3_scale((sb_real)0.5, grid->cell_size);
    sbi_grid_box block = sbi_grid_make_box(sbi_grid_middle(grid, x0, y0, z0, SBI_GRID_BLOCK),
                                           sb_v3_scale((sb_real)SBI_GRID_BLOCK, half),
                                           (1u << work->shape_count) - 1, 0);
    int good = sbi_grid_decide(work, sb_v3_norm(block.half), &block);
    for (int z = z0; z < sbi_min_int(z0 + SBI_GRID_BLOCK, counts[2]); z++)
        for (int y = y0; y < sbi_min_int(y0 + SBI_GRID_BLOCK, counts[1]); y++)
            for (int x = x0; x < sbi_min_int(x0 + SBI_GRID_BLOCK, counts[0]); x++) {
                sbi_grid_box box = block;
                int fine = good;
                box.centre = sbi_grid_middle(grid, x, y, z, 1);
                box.half = half;
                if (fine && box.undecided)
                    fine = sbi_grid_decide(work, sb_v3_norm(half), &box);
                sbi_grid_store_box(work, x, y, z, &box, fine);
            }
}

/* Lists the cells that are not empty. */
static sb_result sbi_grid_list_candidates(sbi_grid_work *work, int boxes, sb_error *error)
{
    const sb_allocator *allocator = &work->def->allocator;
    for (int pass = 0; pass < 2; pass++) {
        int count = 0, cut = 0;
        for (int i = 0; i < boxes; i++) {
            int slot = sbi_grid_slot(work, work->undecided[i], work->inside[i]);
            if (work->inside[i] == (unsigned)SBI_GRID_BAD)
                return sbi_fail(error, SB_ERROR_NOT_FINITE, "a distance in cell %d of the grid is not finite", i);
            if (slot == -1)
                continue;
            if (pass == 1) {
                sbi_grid_candidate *c = work->candidates + count;
                c->box = i;
                c->level = sbi_max_int(work->def->level, 1);
                c->slot = slot;
                c->part = slot == -2 ? cut : -1;
                c->undecided = work->undecided[i];
                c->inside = work->inside[i];
                c->first_cell = 0;
                c->cell_count = 1;
                if (slot == -2)
                    work->cut[cut] = count;
            }
            count++;
            cut += slot == -2;
        }
        work->candidate_count = count;
        work->cut_count = cut;
        if (pass == 1)
            break;
        work->candidates = (sbi_grid_candidate *)sbi_alloc(allocator, (size_t)count, sizeof *work->candidates);
        work->cut = (int *)sbi_alloc(allocator, (size_t)cut, sizeof(int));
        work->parts = (sbi_grid_part *)sbi_alloc_zeroed(allocator, (size_t)cut,
                                                        (size_t)work->slot_count * sizeof *work->parts);
        if (!work->candidates || !work->cut || !work->parts)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d cells of a grid", count);
    }
    return SB_OK;
}

static sb_result sbi_grid_classify(sbi_grid_work *work, sb_error *error)
{
    const int *counts = work->grid->counts;
    const sb_allocator *allocator = &work->def->allocator;
    int boxes = counts[0] * counts[1] * counts[2];
    sb_result result;
    work->undecided = (unsigned *)sbi_alloc(allocator, (size_t)boxes, sizeof(unsigned));
    work->inside = (unsigned *)sbi_alloc(allocator, (size_t)boxes, sizeof(unsigned));
    if (!work->undecided || !work->inside)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d boxes of a grid", boxes);
    result = sbi_grid_run(work, sbi_grid_classify_block,
                          sbi_grid_blocks(counts[0]) * sbi_grid_blocks(counts[1]) * sbi_grid_blocks(counts[2]), 0.1, error);
    return result == SB_OK ? sbi_grid_list_candidates(work, boxes, error) : result;
}

/* ---- what is inside the cells that are cut ---- */

/* Task: the parts of cut cell `index`. A cell in which the points of its level find nothing is looked at more closely, so
 * that the cells of a grid do not change with the level, and none that is kept is without mass. */
static void sbi_grid_measure_cell(void *user, int index)
{
    sbi_grid_work *work = (sbi_grid_work *)user;
    sbi_grid_candidate *candidate = work->candidates + work->cut[index];
    sbi_grid_walk walk;
    int64_t points = 0;
    memset(&walk, 0, sizeof walk);
    walk.work = work;
    walk.parts = work->parts + (size_t)index * (size_t)work->slot_count;
    for (;; candidate->level++) {
        sbi_grid_walk_cell(&walk, candidate);
        for (int s = 0; s < work->slot_count; s++)
            points += walk.parts[s].points;
        if (points > 0 || walk.bad || candidate->level >= SBI_GRID_PROBE_LEVEL)
            break;
    }
    if (walk.bad)
        candidate->cell_count = -1;
}

static double sbi_grid_part_share(const sbi_grid_part *part)
{
    double sum = 0;
    for (int o = 0; o < 8; o++)
        sum += part->phi[o];
    return 0.125 * sum;
}

/* Share of a cut cell that is inside; *largest: the region that has most of it. */
static double sbi_grid_cell_share(const sbi_grid_work *work, const sbi_grid_candidate *c, int *largest)
{
    double sum = 0, most = -1;
    for (int s = 0; s < work->slot_count; s++) {
        double share = sbi_grid_part_share(work->parts + (size_t)c->part * (size_t)work->slot_count + s);
        sum += share;
        if (share > most) {
            most = share;
            *largest = s;
        }
    }
    return sum;
}

static int sbi_grid_is_sparse(const sb_grid_def *def) { return def->method == SB_GRID_SPARSE || def->level == 0; }

/* Cells of the body's mesh for a cut cell that is kept. */
static int64_t sbi_grid_count_cells(const sbi_grid_work *work, const sbi_grid_candidate *c)
{
    const sb_grid_def *def = work->def;
    int64_t cells = 0;
    if (sbi_grid_is_sparse(def))
        return 1;
    for (int s = 0; s < work->slot_count; s++) {
        int64_t points = work->parts[(size_t)c->part * (size_t)work->slot_count + (size_t)s].points;
        cells += def->method == SB_GRID_WEIGHTED_CELL ? points > 0 : (points + 7) / 8;
    }
    return cells + (def->method == SB_GRID_FINITE_CELL && def->void_stiffness > 0);
}

static int sbi_grid_fit_int(int64_t count) { return count <= INT32_MAX / 64; }

/* Decides what is kept, and where its cells of the body's mesh start. *cells and *body_cells: how many there are. */
static sb_result sbi_grid_number_cells(sbi_grid_work *work, int *cells, int *body_cells, sb_error *error)
{
    const sb_grid_def *def = work->def;
    int64_t total = 0;
    *cells = 0;
    for (int i = 0; i < work->candidate_count; i++) {
        sbi_grid_candidate *c = work->candidates + i;
        int64_t count = 1;
        if (c->cell_count < 0)
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "a distance in cell %d of the grid is not finite", c->box);
        if (c->part >= 0) {
            double share = sbi_grid_cell_share(work, c, &c->slot);
            count = share > 0 && share >= (double)def->least_share ? sbi_grid_count_cells(work, c) : 0;
        }
        total += count;
        if (!sbi_grid_fit_int(total) || (def->method == SB_GRID_FINITE_CELL && 8 * total > (int64_t)def->max_points))
            return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                            "more than %d points at level %d: a lower level or fewer cells, or more max_points",
                            def->method == SB_GRID_FINITE_CELL ? def->max_points : INT32_MAX / 8, def->level);
        c->first_cell = (int)(total - count);
        c->cell_count = (int)count;
        *cells += count > 0;
    }
    *body_cells = (int)total;
    if (total == 0)
        return sbi_fail(error, SB_ERROR_MESH, "no cell of the grid has anything of the body inside");
    return SB_OK;
}

/* ---- meshes ---- */

/* Node of the lattice at corner `node` of a box. */
static size_t sbi_grid_lattice_node(const int *counts, int box, int node)
{
    size_t x = (size_t)(box % counts[0]) + (sbi_grid_sign(node, 0) > 0);
    size_t y = (size_t)(box / counts[0] % counts[1]) + (sbi_grid_sign(node, 1) > 0);
    size_t z = (size_t)(box / counts[0] / counts[1]) + (sbi_grid_sign(node, 2) > 0);
    return (z * (size_t)(counts[1] + 1) + y) * (size_t)(counts[0] + 1) + x;
}

static size_t sbi_grid_lattice_nodes(const int *counts)
{
    return (size_t)(counts[0] + 1) * (size_t)(counts[1] + 1) * (size_t)(counts[2] + 1);
}

/* Numbers the nodes of the kept cells in the order of the lattice; returns how many there are. */
static int sbi_grid_number_nodes(const sbi_grid_work *work, int *numbers)
{
    const int *counts = work->grid->counts;
    size_t nodes = sbi_grid_lattice_nodes(counts);
    int count = 0;
    memset(numbers, 0, nodes * sizeof *numbers);
    for (int i = 0; i < work->candidate_count; i++)
        for (int a = 0; a < 8 && work->candidates[i].cell_count; a++)
            numbers[sbi_grid_lattice_node(counts, work->candidates[i].box, a)] = 1;
    for (size_t k = 0; k < nodes; k++)
        numbers[k] = numbers[k] ? count++ : -1;
    return count;
}

static void sbi_grid_place_nodes(const sb_grid *grid, const int *numbers, sb_vec3 *nodes)
{
    size_t k = 0;
    for (int z = 0; z <= grid->counts[2]; z++)
        for (int y = 0; y <= grid->counts[1]; y++)
            for (int x = 0; x <= grid->counts[0]; x++, k++)
                if (numbers[k] >= 0)
                    nodes[numbers[k]] = sbi_grid_middle(grid, x, y, z, 0);
}

static sb_result sbi_grid_allocate(sbi_grid_work *work, int nodes, int cells, int body_cells, sb_error *error)
{
    sb_grid *grid = work->grid;
    const sb_allocator *allocator = &work->def->allocator;
    size_t count = (size_t)body_cells, boxes = (size_t)(grid->counts[0] * grid->counts[1] * grid->counts[2]);
    sb_domain *domain = &grid->domain;
    domain->allocator = *allocator;
    domain->cells = (int *)sbi_alloc(allocator, count, 8 * sizeof(int));
    domain->gradients = (sb_real *)sbi_alloc_zeroed(allocator, count, 8 * 24 * sizeof(sb_real));
    domain->weights = (sb_real *)sbi_alloc_zeroed(allocator, count, 8 * sizeof(sb_real));
    domain->cell_mass = (sb_real *)sbi_alloc_zeroed(allocator, count, 36 * sizeof(sb_real));
    grid->body_cells = (int *)sbi_alloc(allocator, count, sizeof(int));
    grid->shares = (sb_real *)sbi_alloc(allocator, (size_t)cells, sizeof(sb_real));
    grid->lattice = (int *)sbi_alloc(allocator, boxes, sizeof(int));
    grid->regions = (int *)sbi_alloc(allocator, (size_t)work->slot_count, sizeof(int));
    grid->region_volumes = (sb_real *)sbi_alloc_zeroed(allocator, (size_t)work->slot_count, sizeof(sb_real));
    if (!domain->cells || !domain->gradients || !domain->weights || !domain->cell_mass || !grid->body_cells ||
        !grid->shares || !grid->lattice || !grid->regions || !grid->region_volumes ||
        !sbi_mesh_allocate(&grid->mesh, SB_HEX8, nodes, cells, 1, allocator) ||
        !sbi_mesh_allocate(&grid->body_mesh, SB_HEX8, nodes, body_cells, 1, allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d points of a grid", 8 * body_cells);
    domain->element_type = SB_HEX8;
    domain->node_count = nodes;
    domain->cell_count = body_cells;
    domain->nodes_per_cell = 8;
    domain->points_per_cell = 8;
    for (size_t i = 0; i < boxes; i++)
        grid->lattice[i] = -1;
    memcpy(grid->regions, work->regions, (size_t)work->slot_count * sizeof(int));
    grid->region_count = work->slot_count;
    return SB_OK;
}

/* Elements of both meshes; regions of the first. */
static void sbi_grid_fill_meshes(const sbi_grid_work *work, const int *numbers)
{
    sb_grid *grid = work->grid;
    int cell = 0;
    for (int i = 0; i < work->candidate_count; i++) {
        const sbi_grid_candidate *c = work->candidates + i;
        int *nodes = grid->mesh.elements + 8 * (size_t)cell;
        if (!c->cell_count)
            continue;
        for (int a = 0; a < 8; a++)
            nodes[a] = numbers[sbi_grid_lattice_node(grid->counts, c->box, a)];
        grid->mesh.regions[cell] = work->regions[c->slot];
        grid->lattice[c->box] = cell;
        for (int e = c->first_cell; e < c->first_cell + c->cell_count; e++) {
            memcpy(grid->body_mesh.elements + 8 * (size_t)e, nodes, 8 * sizeof(int));
            grid->body_cells[e] = cell;
        }
        cell++;
    }
    memcpy(grid->domain.cells, grid->body_mesh.elements, (size_t)grid->body_mesh.element_count * 8 * sizeof(int));
}

/* ---- points, weights, masses ---- */

static double sbi_grid_cell_volume(const sb_grid *grid)
{
    return (double)grid->cell_size.x * (double)grid->cell_size.y * (double)grid->cell_size.z;
}

/* The eight points of a brick: weights are shares[8] of an eighth of it. */
static void sbi_grid_fill_brick(const sb_grid *grid, int cell, const double *shares)
{
    sbi_grid_box unit = sbi_grid_make_box(sb_v3(0, 0, 0), sb_v3(1, 1, 1), 0, 0);
    for (int p = 0; p < 8; p++) {
        size_t at = 8 * (size_t)cell + (size_t)p;
        sb_vec3 point = sbi_grid_gauss_point(&unit, p);
        const double xi[3] = {(double)point.x, (double)point.y, (double)point.z};
        grid->domain.weights[at] = (sb_real)(0.125 * shares[p] * sbi_grid_cell_volume(grid));
        sbi_grid_gradients(grid->cell_size, xi, grid->domain.gradients + 24 * at);
    }
}

static void sbi_grid_fill_mass(const sb_grid *grid, int cell, const double *mass)
{
    for (int k = 0; k < 36; k++)
        grid->domain.cell_mass[36 * (size_t)cell + (size_t)k] = (sb_real)(mass[k] * sbi_grid_cell_volume(grid));
}

static void sbi_grid_fill_uncut(const sbi_grid_work *work, const sbi_grid_candidate *c)
{
    sbi_grid_fill_brick(work->grid, c->first_cell, work->full.phi);
    sbi_grid_fill_mass(work->grid, c->first_cell, work->full.mass);
    work->grid->body_mesh.regions[c->first_cell] = work->regions[c->slot];
}

/* One cell for each region; where all of them together have less than the void's stiffness, the largest fills up. */
static void sbi_grid_fill_weighted(const sbi_grid_work *work, const sbi_grid_candidate *c)
{
    const sbi_grid_part *parts = work->parts + (size_t)c->part * (size_t)work->slot_count;
    double least = (double)work->def->void_stiffness;
    int cell = c->first_cell;
    for (int s = 0; s < work->slot_count; s++) {
        double phi[8];
        if (parts[s].points == 0)
            continue;
        for (int p = 0; p < 8; p++) {
            double sum = 0;
            for (int k = 0; k < work->slot_count; k++)
                sum += parts[k].phi[p];
            phi[p] = parts[s].phi[p] + (s == c->slot && sum < least ? least - sum : 0);
        }
        sbi_grid_fill_brick(work->grid, cell, phi);
        sbi_grid_fill_mass(work->grid, cell, parts[s].mass);
        work->grid->body_mesh.regions[cell] = work->regions[s];
        cell++;
    }
}

/* Points of a region's last cell that are left over: no weight, and the gradients of the middle. */
static void sbi_grid_pad(const sb_grid *grid, size_t from, size_t to)
{
    const double middle[3] = {0, 0, 0};
    for (size_t at = from; at < to; at++)
        sbi_grid_gradients(grid->cell_size, middle, grid->domain.gradients + 24 * at);
}

/* The inside points of each region in cells of eight, the first of which has the region's mass; then, for the void,
 * the brick itself with its share of the stiffness. */
static void sbi_grid_fill_finite(const sbi_grid_work *work, const sbi_grid_candidate *c)
{
    const sbi_grid_part *parts = work->parts + (size_t)c->part * (size_t)work->slot_count;
    const sb_grid *grid = work->grid;
    int at[SB_GRID_MAX_SHAPES], cell = c->first_cell;
    sbi_grid_walk walk;
    memset(&walk, 0, sizeof walk);
    walk.work = work;
    walk.at = at;
    walk.first_cell = c->first_cell;
    for (int s = 0; s < work->slot_count; s++) {
        int cells = (int)((parts[s].points + 7) / 8);
        at[s] = 8 * (cell - c->first_cell);
        for (int e = cell; e < cell + cells; e++)
            grid->body_mesh.regions[e] = work->regions[s];
        if (cells)
            sbi_grid_fill_mass(grid, cell, parts[s].mass);
        sbi_grid_pad(grid, 8 * (size_t)cell + (size_t)parts[s].points, 8 * (size_t)(cell + cells));
        cell += cells;
    }
    sbi_grid_walk_cell(&walk, c);
    if (cell < c->first_cell + c->cell_count) {
        double shares[8];
        for (int p = 0; p < 8; p++)
            shares[p] = (double)work->def->void_stiffness;
        sbi_grid_fill_brick(grid, cell, shares);
        grid->body_mesh.regions[cell] = work->regions[c->slot];
    }
}

/* Task: everything of candidate `index`. */
static void sbi_grid_fill_cell(void *user, int index)
{
    const sbi_grid_work *work = (const sbi_grid_work *)user;
    const sbi_grid_candidate *c = work->candidates + index;
    if (!c->cell_count)
        return;
    if (c->part < 0 || sbi_grid_is_sparse(work->def))
        sbi_grid_fill_uncut(work, c);
    else if (work->def->method == SB_GRID_WEIGHTED_CELL)
        sbi_grid_fill_weighted(work, c);
    else
        sbi_grid_fill_finite(work, c);
}

/* Shares of cells and volumes of regions, as the body has them. */
static void sbi_grid_sum_volumes(const sbi_grid_work *work)
{
    sb_grid *grid = work->grid;
    double volumes[SB_GRID_MAX_SHAPES] = {0}, total = 0, cell_volume = sbi_grid_cell_volume(grid);
    int cell = 0, sparse = sbi_grid_is_sparse(work->def);
    for (int i = 0; i < work->candidate_count; i++) {
        const sbi_grid_candidate *c = work->candidates + i;
        int largest;
        if (!c->cell_count)
            continue;
        grid->cut_count += c->part >= 0;
        if (c->part < 0 || sparse) {
            volumes[c->slot] += 1;
            grid->shares[cell++] = 1;
            continue;
        }
        for (int s = 0; s < work->slot_count; s++)
            volumes[s] += sbi_grid_part_share(work->parts + (size_t)c->part * (size_t)work->slot_count + s);
        grid->shares[cell++] = (sb_real)sbi_grid_cell_share(work, c, &largest);
    }
    for (int s = 0; s < work->slot_count; s++) {
        grid->region_volumes[s] = (sb_real)(volumes[s] * cell_volume);
        total += volumes[s] * cell_volume;
    }
    grid->volume = (sb_real)total;
}

static sb_result sbi_grid_build(sbi_grid_work *work, int *numbers, sb_error *error)
{
    sb_grid *grid = work->grid;
    int cells, body_cells, nodes;
    sb_result result = sbi_grid_number_cells(work, &cells, &body_cells, error);
    if (result != SB_OK)
        return result;
    nodes = sbi_grid_number_nodes(work, numbers);
    result = sbi_grid_allocate(work, nodes, cells, body_cells, error);
    if (result != SB_OK)
        return result;
    sbi_grid_place_nodes(grid, numbers, grid->mesh.nodes);
    memcpy(grid->body_mesh.nodes, grid->mesh.nodes, (size_t)nodes * sizeof(sb_vec3));
    sbi_grid_fill_meshes(work, numbers);
    result = sbi_grid_run(work, sbi_grid_fill_cell, work->candidate_count, 1 - work->done, error);
    if (result == SB_OK)
        sbi_grid_sum_volumes(work);
    return result;
}

/* ---- creation ---- */

static sb_result sbi_grid_check_shape(const sb_shape *shape, int inner, sb_error *error)
{
    char name[32] = "def.outer";
    if (inner >= 0) {
        static const char digits[] = "0123456789";
        memcpy(name, "def.inner[  ]", 14);
        name[10] = digits[inner / 10];
        name[11] = digits[inner % 10];
    }
    if (!shape->surface == !shape->distance)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s needs a surface or a distance, and not both", name);
    if (!(shape->max_slope >= 0) || !sb_is_finite(shape->max_slope))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s.max_slope %g must be >= 0", name, (double)shape->max_slope);
    if (shape->region < (inner >= 0 ? SB_GRID_EMPTY : 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s.region %d must be >= 0%s", name, shape->region,
                        inner >= 0 ? " or SB_GRID_EMPTY" : "");
    return SB_OK;
}

static sb_result sbi_grid_check_def(const sb_grid_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_GRID_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_grid_def");
    if (def->method < SB_GRID_SPARSE || def->method > SB_GRID_WEIGHTED_CELL)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.method %d is unknown", (int)def->method);
    if (def->level < 0 || def->level > SB_GRID_MAX_LEVEL)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.level %d must be in [0, %d]", def->level, SB_GRID_MAX_LEVEL);
    if (def->inner_count < 0 || def->inner_count >= SB_GRID_MAX_SHAPES || (def->inner_count > 0 && !def->inner))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.inner is NULL, or def.inner_count %d not in [0, %d]",
                        def->inner_count, SB_GRID_MAX_SHAPES - 1);
    if (!(def->void_stiffness >= 0) || !(def->void_stiffness < 1) || !(def->least_share >= 0) || !(def->least_share < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.void_stiffness %g and def.least_share %g must be in [0, 1)",
                        (double)def->void_stiffness, (double)def->least_share);
    if (def->max_points < 8)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_points %d must be >= 8", def->max_points);
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
    result = sbi_grid_check_shape(&def->outer, -1, error);
    for (int i = 0; i < def->inner_count && result == SB_OK; i++)
        result = sbi_grid_check_shape(def->inner + i, i, error);
    return result;
}

/* The box to cover. */
static sb_result sbi_grid_find_box(const sb_grid_def *def, sb_vec3 *low, sb_vec3 *high, sb_error *error)
{
    *low = def->low;
    *high = def->high;
    if (!sb_v3_is_finite(*low) || !sb_v3_is_finite(*high))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.low or def.high is not finite");
    if (low->x == high->x && low->y == high->y && low->z == high->z) {
        if (!def->outer.surface)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "a distance has no bounds: def.low and def.high are needed");
        sb_surface_bounds(def->outer.surface, low, high);
    }
    if (!(low->x < high->x) || !(low->y < high->y) || !(low->z < high->z))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the box from (%g %g %g) to (%g %g %g) has no volume", (double)low->x,
                        (double)low->y, (double)low->z, (double)high->x, (double)high->y, (double)high->z);
    return SB_OK;
}

/* Cubes of this edge over one axis: how many, and where they begin. Room that is a rounding error gets no cell. */
static double sbi_grid_count_cubes(double low, double high, double edge, double *begin)
{
    double count = ceil((high - low) / edge - 1e-6);
    count = count < 1 ? 1 : count;
    *begin = 0.5 * (low + high) - 0.5 * count * edge;
    return count;
}

static sb_result sbi_grid_lay_out(const sb_grid_def *def, sb_grid *grid, sb_error *error)
{
    sb_vec3 low, high;
    double extent[3], from[3], begin[3], counts[3], edge, longest;
    int given = def->counts[0] != 0 || def->counts[1] != 0 || def->counts[2] != 0;
    sb_result result = sbi_grid_find_box(def, &low, &high, error);
    if (result != SB_OK)
        return result;
    from[0] = (double)low.x, from[1] = (double)low.y, from[2] = (double)low.z;
    extent[0] = (double)high.x - from[0], extent[1] = (double)high.y - from[1], extent[2] = (double)high.z - from[2];
    longest = extent[0] > extent[1] ? extent[0] : extent[1];
    longest = extent[2] > longest ? extent[2] : longest;
    if (given && (def->counts[0] < 1 || def->counts[1] < 1 || def->counts[2] < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.counts %d %d %d must all be >= 1, or all 0", def->counts[0],
                        def->counts[1], def->counts[2]);
    if (!given && !(def->cell_size > 0) && (def->cell_size != 0 || def->cells < 1 || def->cells > 2000))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.cell_size %g must be > 0, or 0 and def.cells %d in [1, 2000]",
                        (double)def->cell_size, def->cells);
    if (!given && !sb_is_finite(def->cell_size))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.cell_size is not finite");
    edge = def->cell_size > 0 ? (double)def->cell_size : longest / def->cells;
    for (int i = 0; i < 3; i++) {
        begin[i] = from[i];
        counts[i] = given ? (double)def->counts[i] : sbi_grid_count_cubes(from[i], from[i] + extent[i], edge, &begin[i]);
    }
    if (!(counts[0] * counts[1] * counts[2] < INT32_MAX / 64))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a grid of %g x %g x %g cells is too large", counts[0], counts[1],
                        counts[2]);
    for (int i = 0; i < 3; i++)
        grid->counts[i] = (int)counts[i];
    grid->origin = sb_v3((sb_real)begin[0], (sb_real)begin[1], (sb_real)begin[2]);
    grid->cell_size = given ? sb_v3((sb_real)(extent[0] / counts[0]), (sb_real)(extent[1] / counts[1]),
                                    (sb_real)(extent[2] / counts[2]))
                            : sb_v3((sb_real)edge, (sb_real)edge, (sb_real)edge);
    return SB_OK;
}

/* Gives every region a slot. */
static void sbi_grid_list_regions(sbi_grid_work *work)
{
    for (int s = 0; s < work->shape_count; s++) {
        int region = sbi_grid_get_shape(work->def, s)->region, slot = 0;
        work->slot_of[s] = -1;
        if (region == SB_GRID_EMPTY)
            continue;
        while (slot < work->slot_count && work->regions[slot] != region)
            slot++;
        work->slot_of[s] = slot;
        work->regions[slot] = region;
        work->slot_count = sbi_max_int(work->slot_count, slot + 1);
    }
}

/* Sums of a cell that is inside. */
static void sbi_grid_fill_full(sbi_grid_work *work)
{
    sbi_grid_box unit = sbi_grid_make_box(sb_v3(0, 0, 0), sb_v3(1, 1, 1), 0, 0);
    for (int p = 0; p < 8; p++) {
        sb_vec3 point = sbi_grid_gauss_point(&unit, p);
        const double xi[3] = {(double)point.x, (double)point.y, (double)point.z};
        sbi_grid_sum_point(&work->full, xi, 0.125, p);
    }
}

static sb_result sbi_grid_make(sbi_grid_work *work, sb_error *error)
{
    const sb_allocator *allocator = &work->def->allocator;
    int *numbers = NULL;
    sb_result result = sbi_grid_lay_out(work->def, work->grid, error);
    if (result != SB_OK)
        return result;
    sbi_grid_list_regions(work);
    sbi_grid_fill_full(work);
    result = sbi_grid_find_doubtful(work, error);
    if (result == SB_OK)
        result = sbi_grid_classify(work, error);
    if (result == SB_OK)
        result = sbi_grid_run(work, sbi_grid_measure_cell, work->cut_count,
                              work->def->method == SB_GRID_FINITE_CELL ? 0.45 : 0.8, error);
    if (result != SB_OK)
        return result;
    numbers = (int *)sbi_alloc(allocator, sbi_grid_lattice_nodes(work->grid->counts), sizeof(int));
    result = numbers ? sbi_grid_build(work, numbers, error)
                     : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the nodes of a grid");
    sbi_free(allocator, numbers);
    return result;
}

SB_API sb_result sb_grid_create(const sb_grid_def *def, sb_grid *grid, sb_error *error)
{
    sbi_grid_work work;
    sb_grid made;
    sb_result result;
    if (!def || !grid)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_grid_create needs a def and a grid");
    result = sbi_grid_check_def(def, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    memset(&work, 0, sizeof work);
    made.allocator = def->allocator;
    work.def = def;
    work.grid = &made;
    work.shape_count = 1 + def->inner_count;
    result = sbi_grid_make(&work, error);
    sbi_free(&def->allocator, work.undecided);
    sbi_free(&def->allocator, work.inside);
    sbi_free(&def->allocator, work.candidates);
    sbi_free(&def->allocator, work.cut);
    sbi_free(&def->allocator, work.parts);
    for (int s = 0; s < work.shape_count; s++)
        sbi_free(&def->allocator, work.doubtful[s]);
    if (result == SB_OK)
        *grid = made;
    else
        sb_grid_free(&made);
    return result;
}

/* ---- points of the body in the grid ---- */

SB_API void sb_grid_rows_free(sb_grid_rows *rows)
{
    sb_allocator allocator;
    if (!rows)
        return;
    allocator = rows->allocator;
    sbi_free(&allocator, rows->memory);
    memset(rows, 0, sizeof *rows);
}

/* Rows while they are filled. */
typedef struct sbi_grid_filling {
    const sb_grid *grid;
    int count, next;
    int *row_start, *nodes, *cells;
    sb_real *weights, *areas;
    sb_vec3 *points, *normals;
    sb_real farthest;
    void *memory;
} sbi_grid_filling;

static void sbi_grid_lay_out_rows(sbi_grid_filling *filling, int with_areas, sbi_arena *arena)
{
    size_t n = (size_t)filling->count;
    filling->row_start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    filling->nodes = (int *)sbi_arena_take(arena, n, 8 * sizeof(int));
    filling->cells = (int *)sbi_arena_take(arena, n, sizeof(int));
    filling->weights = (sb_real *)sbi_arena_take(arena, n, 8 * sizeof(sb_real));
    filling->points = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    if (!with_areas)
        return;
    filling->areas = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    filling->normals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
}

static sb_result sbi_grid_begin_rows(sbi_grid_filling *filling, int with_areas, const sb_allocator *allocator,
                                     sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_grid_lay_out_rows(filling, with_areas, &arena);
    filling->memory = arena.overflow ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!filling->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows", filling->count);
    arena.base = (unsigned char *)filling->memory;
    arena.used = 0;
    sbi_grid_lay_out_rows(filling, with_areas, &arena);
    filling->row_start[0] = 0;
    return SB_OK;
}

static void sbi_grid_end_rows(const sbi_grid_filling *filling, const sb_allocator *allocator, sb_grid_rows *rows)
{
    memset(rows, 0, sizeof *rows);
    rows->rows.row_count = filling->count;
    rows->rows.row_start = filling->row_start;
    rows->rows.nodes = filling->nodes;
    rows->rows.weights = filling->weights;
    rows->cells = filling->cells;
    rows->points = filling->points;
    rows->areas = filling->areas;
    rows->normals = filling->normals;
    rows->farthest = filling->farthest;
    rows->memory = filling->memory;
    if (allocator)
        rows->allocator = *allocator;
}

/* Distance of a coordinate from cell `index` along one axis, in cells. */
static double sbi_grid_beyond(double coordinate, int index)
{
    double below = index - coordinate, above = coordinate - index - 1;
    return below > 0 ? below : above > 0 ? above : 0;
}

/* Square of the distance (m^2) between a point, in cells from the origin, and lattice box (x, y, z). */
static double sbi_grid_gap(const sb_grid *grid, const double at[3], int x, int y, int z)
{
    double dx = (double)grid->cell_size.x * sbi_grid_beyond(at[0], x);
    double dy = (double)grid->cell_size.y * sbi_grid_beyond(at[1], y);
    double dz = (double)grid->cell_size.z * sbi_grid_beyond(at[2], z);
    return dx * dx + dy * dy + dz * dz;
}

/* First and last cell along an axis that a point may belong to, given how many cells it may be away. */
static void sbi_grid_range(double coordinate, double reach, int count, int *first, int *last)
{
    double low = floor(coordinate - reach) - 1, high = floor(coordinate + reach) + 1;
    *first = low > 0 ? (low < count ? (int)low : count) : 0;
    *last = high < count - 1 ? (high >= 0 ? (int)high : -1) : count - 1;
}

/* The lattice box of the kept cell that a point is in or nearest to, or -1: none within the longest edge of a cell.
 * *gap (m): how far away it is. */
static int sbi_grid_find_cell(const sb_grid *grid, sb_vec3 point, double *gap)
{
    const double size[3] = {(double)grid->cell_size.x, (double)grid->cell_size.y, (double)grid->cell_size.z};
    const double at[3] = {((double)point.x - (double)grid->origin.x) / size[0],
                          ((double)point.y - (double)grid->origin.y) / size[1],
                          ((double)point.z - (double)grid->origin.z) / size[2]};
    double reach = size[0] > size[1] ? size[0] : size[1], best;
    int first[3], last[3], own[3], inside = 1, found = -1;
    reach = size[2] > reach ? size[2] : reach;
    for (int i = 0; i < 3; i++) {
        sbi_grid_range(at[i], reach / size[i], grid->counts[i], &first[i], &last[i]);
        own[i] = at[i] >= 0 && at[i] < grid->counts[i] ? (int)at[i] : -1;
        inside &= own[i] >= 0;
    }
    *gap = 0;
    if (inside && grid->lattice[(own[2] * grid->counts[1] + own[1]) * grid->counts[0] + own[0]] >= 0)
        return (own[2] * grid->counts[1] + own[1]) * grid->counts[0] + own[0];
    best = reach * reach;
    for (int z = first[2]; z <= last[2]; z++)
        for (int y = first[1]; y <= last[1]; y++)
            for (int x = first[0]; x <= last[0]; x++) {
                int box = (z * grid->counts[1] + y) * grid->counts[0] + x;
                double square = grid->lattice[box] >= 0 ? sbi_grid_gap(grid, at, x, y, z) : 2 * best;
                if (square < best || (square == best && found < 0)) {
                    best = square;
                    found = box;
                }
            }
    *gap = sqrt(best);
    return found;
}

/* Appends the row of a point; `index` names it in errors. */
static sb_result sbi_grid_add_row(sbi_grid_filling *filling, sb_vec3 point, int index, const char *what, sb_error *error)
{
    const sb_grid *grid = filling->grid;
    double xi[3], shape[8], gap;
    int row = filling->next++, box = -1, cell;
    if (!sb_v3_is_finite(point))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "%s %d is not finite", what, index);
    box = sbi_grid_find_cell(grid, point, &gap);
    if (box < 0)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index,
                             "%s %d at (%g %g %g) is more than a cell away from every cell of the grid", what, index,
                             (double)point.x, (double)point.y, (double)point.z);
    cell = grid->lattice[box];
    sbi_grid_local(grid, sbi_grid_cell_middle(grid, box), point, xi);
    sbi_grid_shape_functions(xi, shape);
    memcpy(filling->nodes + 8 * (size_t)row, grid->mesh.elements + 8 * (size_t)cell, 8 * sizeof(int));
    for (int a = 0; a < 8; a++)
        filling->weights[8 * (size_t)row + (size_t)a] = (sb_real)shape[a];
    filling->row_start[row + 1] = 8 * (row + 1);
    filling->cells[row] = cell;
    filling->points[row] = point;
    filling->farthest = sb_max(filling->farthest, (sb_real)gap);
    return SB_OK;
}

SB_API sb_result sb_grid_map_points(const sb_grid *grid, const sb_vec3 *points, int count, const sb_allocator *allocator,
                                    sb_grid_rows *rows, sb_error *error)
{
    sbi_grid_filling filling;
    sb_result result;
    memset(&filling, 0, sizeof filling);
    if (!grid || !grid->lattice || !rows || !points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_grid_map_points needs a grid, points and a place for the rows");
    if (count > INT32_MAX / 8 - 1)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d points are too many", count);
    filling.grid = grid;
    filling.count = count;
    result = sbi_grid_begin_rows(&filling, 0, allocator, error);
    for (int i = 0; i < count && result == SB_OK; i++)
        result = sbi_grid_add_row(&filling, points[i], i, "point", error);
    if (result == SB_OK)
        sbi_grid_end_rows(&filling, allocator, rows);
    else
        sbi_free(allocator, filling.memory);
    return result;
}

/* ---- surfaces in the grid ---- */

static const int *sbi_grid_triangle(const sb_mesh *surface, const int *triangles, int index)
{
    return surface->elements + 3 * (size_t)(triangles ? triangles[index] : index);
}

/* Into how many pieces along its edges a triangle is cut; 0: one point does for all of it. -1: far too many. */
static int sbi_grid_pieces(const sb_grid *grid, const sb_mesh *surface, const int *nodes)
{
    double smallest = (double)sb_min(sb_min(grid->cell_size.x, grid->cell_size.y), grid->cell_size.z), longest = 0;
    for (int i = 0; i < 3; i++) {
        sb_vec3 edge = sb_v3_sub(surface->nodes[nodes[(i + 1) % 3]], surface->nodes[nodes[i]]);
        double length = (double)sb_v3_norm(edge);
        longest = length > longest ? length : longest;
    }
    longest /= smallest;
    return longest <= 0.5 ? 0 : longest < 10000 ? (int)ceil(longest - 1e-6) : -1;
}

/* Appends a point of weight area/weight_sum at barycentric coordinates (r, s). */
static sb_result sbi_grid_add_surface_point(sbi_grid_filling *filling, const sb_vec3 corners[3], double r, double s,
                                            sb_real area, sb_vec3 normal, int triangle, sb_error *error)
{
    int row = filling->next;
    sb_vec3 point = sb_v3_madd(sb_v3_madd(corners[0], (sb_real)r, sb_v3_sub(corners[1], corners[0])), (sb_real)s,
                               sb_v3_sub(corners[2], corners[0]));
    filling->areas[row] = area;
    filling->normals[row] = normal;
    return sbi_grid_add_row(filling, point, triangle, "a point of triangle", error);
}

/* Appends the points of a triangle. Each piece, upright or upside down in the net of lines parallel to the edges, has the
 * three points of the rule of degree 2. */
static sb_result sbi_grid_add_triangle(sbi_grid_filling *filling, const sb_vec3 corners[3], int pieces, int triangle,
                                       sb_error *error)
{
    static const double rule[3][2] = {{1.0 / 6, 1.0 / 6}, {2.0 / 3, 1.0 / 6}, {1.0 / 6, 2.0 / 3}};
    sb_vec3 cross = sb_v3_cross(sb_v3_sub(corners[1], corners[0]), sb_v3_sub(corners[2], corners[0]));
    sb_real twice = sb_v3_norm(cross);
    sb_result result = SB_OK;
    if (!(twice > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, triangle, "triangle %d has no area", triangle);
    cross = sb_v3_scale(1 / twice, cross);
    if (pieces == 0)
        return sbi_grid_add_surface_point(filling, corners, 1.0 / 3, 1.0 / 3, twice / 2, cross, triangle, error);
    for (int i = 0; i < pieces; i++)
        for (int j = 0; j < pieces - i; j++)
            for (int turned = 0; turned < (j < pieces - i - 1 ? 2 : 1); turned++)
                for (int p = 0; p < 3 && result == SB_OK; p++) {
                    double r = turned ? 1 - rule[p][0] : rule[p][0], s = turned ? 1 - rule[p][1] : rule[p][1];
                    sb_real area = twice / (6 * (sb_real)pieces * (sb_real)pieces);
                    result = sbi_grid_add_surface_point(filling, corners, (i + r) / pieces, (j + s) / pieces, area,
                                                        cross, triangle, error);
                }
    return result;
}

static sb_result sbi_grid_check_triangles(const sb_grid *grid, const sb_mesh *surface, const int *triangles, int count,
                                          const sb_grid_rows *rows, sb_error *error)
{
    sb_result result;
    if (!grid || !grid->lattice || !surface || !rows || (triangles && count < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_grid_map_surface needs a grid, a surface and a place for the rows");
    result = sbi_mesh_check_arrays(surface, error);
    if (result != SB_OK)
        return result;
    if (surface->element_type != SB_TRI3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a surface of tri3 is needed, not of %s",
                        sb_element_name(surface->element_type));
    for (int i = 0; triangles && i < count; i++)
        if (triangles[i] < 0 || triangles[i] >= surface->element_count)
            return sbi_fail_element(error, SB_ERROR_INDEX, triangles[i], "the surface has no triangle %d", triangles[i]);
    return SB_OK;
}

SB_API sb_result sb_grid_map_surface(const sb_grid *grid, const sb_mesh *surface, const int *triangles, int count,
                                     const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error)
{
    sbi_grid_filling filling;
    int64_t total = 0;
    sb_result result = sbi_grid_check_triangles(grid, surface, triangles, count, rows, error);
    if (result != SB_OK)
        return result;
    memset(&filling, 0, sizeof filling);
    count = triangles ? count : surface->element_count;
    for (int i = 0; i < count; i++) {
        int pieces = sbi_grid_pieces(grid, surface, sbi_grid_triangle(surface, triangles, i));
        total += pieces ? 3 * (int64_t)pieces * pieces : 1;
        if (pieces < 0 || total > INT32_MAX / 8 - 1)
            return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the surface has too many points in cells of this size");
    }
    filling.grid = grid;
    filling.count = (int)total;
    result = sbi_grid_begin_rows(&filling, 1, allocator, error);
    for (int i = 0; i < count && result == SB_OK; i++) {
        const int *nodes = sbi_grid_triangle(surface, triangles, i);
        const sb_vec3 corners[3] = {surface->nodes[nodes[0]], surface->nodes[nodes[1]], surface->nodes[nodes[2]]};
        result = sbi_grid_add_triangle(&filling, corners, sbi_grid_pieces(grid, surface, nodes),
                                       triangles ? triangles[i] : i, error);
    }
    if (result == SB_OK)
        sbi_grid_end_rows(&filling, allocator, rows);
    else
        sbi_free(allocator, filling.memory);
    return result;
}

SB_API void sb_grid_add_traction(const sb_grid_rows *rows, const sb_vec3 *tractions, int uniform, sb_vec3 *forces)
{
    const sb_mapping *mapping = rows ? &rows->rows : NULL;
    if (!mapping || !tractions || !forces)
        return;
    for (int j = 0; j < mapping->row_count && rows->areas; j++)
        for (int k = mapping->row_start[j]; k < mapping->row_start[j + 1]; k++) {
            sb_vec3 *force = forces + mapping->nodes[k];
            *force = sb_v3_madd(*force, rows->areas[j] * mapping->weights[k], tractions[uniform ? 0 : j]);
        }
}
