/* grid_fill: the meshes of the cells that are kept, and their points, weights and masses. */
#include "grid_private.h"

/* ---- meshes ---- */

/* Node of the lattice at corner `node` of a box. */
static size_t sbi_grid_lattice_node(const int *counts, int box, int node)
{
    size_t x = (size_t)(box % counts[0]) + (sbi_grid_sign(node, 0) > 0);
    size_t y = (size_t)(box / counts[0] % counts[1]) + (sbi_grid_sign(node, 1) > 0);
    size_t z = (size_t)(box / counts[0] / counts[1]) + (sbi_grid_sign(node, 2) > 0);
    return (z * (size_t)(counts[1] + 1) + y) * (size_t)(counts[0] + 1) + x;
}

SBI_API size_t sbi_grid_lattice_nodes(const int *counts)
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

SBI_API sb_result sbi_grid_build(sbi_grid_work *work, int *numbers, sb_error *error)
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
