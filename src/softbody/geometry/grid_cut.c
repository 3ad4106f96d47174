/* grid_cut: which cells are inside, which are cut, and which are kept. */
#include "grid_private.h"

/* ---- running tasks ---- */

static void sbi_grid_slab_task(void *user, int index)
{
    sbi_grid_work *work = (sbi_grid_work *)user;
    work->task(work, work->first_task + index);
}

SBI_API sb_result sbi_grid_run(sbi_grid_work *work, sb_task task, int count, double share, sb_error *error)
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
    sbi_grid_box block =
        sbi_grid_make_box(sbi_grid_middle(grid, x0, y0, z0, SBI_GRID_BLOCK), sb_v3_scale((sb_real)SBI_GRID_BLOCK, half),
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
        work->parts =
            (sbi_grid_part *)sbi_alloc_zeroed(allocator, (size_t)cut, (size_t)work->slot_count * sizeof *work->parts);
        if (!work->candidates || !work->cut || !work->parts)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d cells of a grid", count);
    }
    return SB_OK;
}

SBI_API sb_result sbi_grid_classify(sbi_grid_work *work, sb_error *error)
{
    const int *counts = work->grid->counts;
    const sb_allocator *allocator = &work->def->allocator;
    int boxes = counts[0] * counts[1] * counts[2];
    sb_result result;
    work->undecided = (unsigned *)sbi_alloc(allocator, (size_t)boxes, sizeof(unsigned));
    work->inside = (unsigned *)sbi_alloc(allocator, (size_t)boxes, sizeof(unsigned));
    if (!work->undecided || !work->inside)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d boxes of a grid", boxes);
    result =
        sbi_grid_run(work, sbi_grid_classify_block,
                     sbi_grid_blocks(counts[0]) * sbi_grid_blocks(counts[1]) * sbi_grid_blocks(counts[2]), 0.1, error);
    return result == SB_OK ? sbi_grid_list_candidates(work, boxes, error) : result;
}

/* ---- what is inside the cells that are cut ---- */

SBI_API void sbi_grid_measure_cell(void *user, int index)
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

SBI_API double sbi_grid_part_share(const sbi_grid_part *part)
{
    double sum = 0;
    for (int o = 0; o < 8; o++)
        sum += part->phi[o];
    return 0.125 * sum;
}

SBI_API double sbi_grid_cell_share(const sbi_grid_work *work, const sbi_grid_candidate *c, int *largest)
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

SBI_API sb_result sbi_grid_number_cells(sbi_grid_work *work, int *cells, int *body_cells, sb_error *error)
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
