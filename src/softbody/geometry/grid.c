/* grid: a grid of bricks around a shape: its definition checked, laid out, made. */
#include "grid_private.h"

#define SBI_GRID_COOKIE 0x6e1du

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
    if (!(def->void_stiffness >= 0) || !(def->void_stiffness < 1) || !(def->least_share >= 0) ||
        !(def->least_share < 1))
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
        counts[i] =
            given ? (double)def->counts[i] : sbi_grid_count_cubes(from[i], from[i] + extent[i], edge, &begin[i]);
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
