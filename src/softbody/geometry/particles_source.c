/* particles_source: particles and integration points from a shape, or from a cloud of one's own. */
#include "particles_private.h"

SBI_API void sbi_particle_source_free(sbi_particle_source *source, const sb_allocator *allocator)
{
    sbi_free(allocator, source->particles);
    sbi_free(allocator, source->points);
    sbi_free(allocator, source->weights);
    sbi_free(allocator, source->regions);
    sbi_free(allocator, source->samples);
    memset(source, 0, sizeof *source);
}

static sb_result sbi_particle_source_allocate(const sb_particles_def *def, int particles, int points,
                                              sbi_particle_source *source, sb_error *error)
{
    const sb_allocator *allocator = &def->allocator;
    source->particles = (sb_vec3 *)sbi_alloc(allocator, (size_t)particles, sizeof(sb_vec3));
    source->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)points, sizeof(sb_vec3));
    source->weights = (sb_real *)sbi_alloc(allocator, (size_t)points, sizeof(sb_real));
    source->regions = (int *)sbi_alloc_zeroed(allocator, (size_t)points, sizeof(int));
    source->particle_count = particles;
    source->point_count = points;
    if (!source->particles || !source->points || !source->weights || !source->regions)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d particles and %d points", particles, points);
    return SB_OK;
}

/* ---- the grid behind ---- */

static sb_result sbi_particle_grid(const sb_particles_def *def, sb_grid *grid, sb_error *error)
{
    sb_grid_def settings = sb_default_grid_def();
    settings.method = SB_GRID_WEIGHTED_CELL;
    settings.level = sbi_max_int(def->level, 1);
    settings.outer = def->outer;
    settings.inner = def->inner;
    settings.inner_count = def->inner_count;
    settings.low = def->low;
    settings.high = def->high;
    settings.cells = def->cells;
    settings.cell_size = def->spacing;
    for (int k = 0; k < 3; k++)
        settings.counts[k] = def->counts[k];
    settings.void_stiffness = 0;
    settings.allocator = def->allocator;
    settings.jobs = def->jobs;
    return sb_grid_create(&settings, grid, error);
}

static sb_vec3 sbi_particle_corner(const sb_grid *grid, int cell, const double xi[3])
{
    const int *nodes = grid->mesh.elements + 8 * (size_t)cell;
    sb_vec3 low = grid->mesh.nodes[nodes[0]], high = grid->mesh.nodes[nodes[6]];
    return sb_v3((sb_real)((double)low.x + 0.5 * (1 + xi[0]) * ((double)high.x - (double)low.x)),
                 (sb_real)((double)low.y + 0.5 * (1 + xi[1]) * ((double)high.y - (double)low.y)),
                 (sb_real)((double)low.z + 0.5 * (1 + xi[2]) * ((double)high.z - (double)low.z)));
}

static int sbi_particle_is_kept(const sb_grid *grid, int x, int y, int z)
{
    return x >= 0 && y >= 0 && z >= 0 && x < grid->counts[0] && y < grid->counts[1] && z < grid->counts[2] &&
           grid->lattice[(z * grid->counts[1] + y) * grid->counts[0] + x] >= 0;
}

/* Points of the surface, roughly: three by three on each face of a kept cell towards a dropped one, three by three by
 * three in cells that are cut. Counts only without an array. */
static int sbi_particle_list_samples(const sb_grid *grid, sb_vec3 *samples)
{
    int count = 0;
    for (int z = 0; z < grid->counts[2]; z++)
        for (int y = 0; y < grid->counts[1]; y++)
            for (int x = 0; x < grid->counts[0]; x++) {
                int cell = grid->lattice[(z * grid->counts[1] + y) * grid->counts[0] + x];
                int cut = cell >= 0 && grid->shares[cell] < 1 - 64 * SB_EPSILON;
                for (int i = 0; i < 27 && cell >= 0; i++) {
                    const int step[3] = {i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1};
                    const double xi[3] = {(double)step[0], (double)step[1], (double)step[2]};
                    int open = cut;
                    for (int k = 0; k < 3; k++)
                        open |=
                            step[k] && !sbi_particle_is_kept(grid, x + (k == 0 ? step[0] : 0),
                                                             y + (k == 1 ? step[1] : 0), z + (k == 2 ? step[2] : 0));
                    if (open && samples)
                        samples[count] = sbi_particle_corner(grid, cell, xi);
                    count += open;
                }
            }
    return count;
}

static sb_result sbi_particle_add_samples(const sb_particles_def *def, const sb_grid *grid, sbi_particle_source *source,
                                          sb_error *error)
{
    source->volume = grid->volume;
    source->sample_count = sbi_particle_list_samples(grid, NULL);
    source->samples = (sb_vec3 *)sbi_alloc(&def->allocator, (size_t)source->sample_count, sizeof(sb_vec3));
    if (!source->samples)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d points of the surface", source->sample_count);
    sbi_particle_list_samples(grid, source->samples);
    return SB_OK;
}

/* ---- integration points of the grid ---- */

/* Weight and place of what a cell of the grid's body has; one point in its middle of mass, or those of its octants.
 * Returns how many points there are; source NULL: counts only. */
static int sbi_particle_cell_points(const sb_particles_def *def, const sb_grid *grid, int body_cell,
                                    sbi_particle_source *source, int at)
{
    const double gauss = 0.57735026918962576;
    const sb_real *weights = grid->domain.weights + 8 * (size_t)body_cell;
    double mean[3] = {0, 0, 0}, sum = 0;
    int cell = grid->body_cells[body_cell], count = 0;
    for (int p = 0; p < 8; p++) {
        const double xi[3] = {(p & 1 ? 1 : -1) * gauss, (p & 2 ? 1 : -1) * gauss, (p & 4 ? 1 : -1) * gauss};
        if (!(weights[p] > 0))
            continue;
        if (source && def->points_per_cell == 8) {
            source->points[at + count] = sbi_particle_corner(grid, cell, xi);
            source->weights[at + count] = weights[p];
            source->regions[at + count] = grid->body_mesh.regions[body_cell];
        }
        count++;
        sum += (double)weights[p];
        for (int k = 0; k < 3; k++)
            mean[k] += (double)weights[p] * xi[k];
    }
    if (def->points_per_cell == 8 || count == 0)
        return count;
    for (int k = 0; k < 3; k++)
        mean[k] /= sum;
    if (source) {
        source->points[at] = sbi_particle_corner(grid, cell, mean);
        source->weights[at] = (sb_real)sum;
        source->regions[at] = grid->body_mesh.regions[body_cell];
    }
    return 1;
}

static sb_result sbi_particle_make_grid(const sb_particles_def *def, const sb_grid *grid, sbi_particle_source *source,
                                        sb_error *error)
{
    int points = 0, particles = def->points ? def->point_count : grid->mesh.node_count;
    sb_result result;
    for (int e = 0; e < grid->body_mesh.element_count; e++)
        points += sbi_particle_cell_points(def, grid, e, NULL, 0);
    result = sbi_particle_source_allocate(def, particles, points, source, error);
    if (result != SB_OK)
        return result;
    memcpy(source->particles, def->points ? def->points : grid->mesh.nodes, (size_t)particles * sizeof(sb_vec3));
    for (int e = 0, at = 0; e < grid->body_mesh.element_count; e++)
        at += sbi_particle_cell_points(def, grid, e, source, at);
    return SB_OK;
}

/* ---- points that are particles ---- */

static sb_result sbi_particle_make_lattice(const sb_particles_def *def, const sb_grid *grid,
                                           sbi_particle_source *source, sb_error *error)
{
    const double middle[3] = {0, 0, 0};
    double brick = (double)grid->cell_size.x * (double)grid->cell_size.y * (double)grid->cell_size.z;
    int count = 0;
    sb_result result;
    for (int e = 0; e < grid->mesh.element_count; e++)
        count += grid->shares[e] >= (sb_real)0.5;
    if (count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "no cell of %g m is at least half inside", (double)grid->cell_size.x);
    result = sbi_particle_source_allocate(def, count, count, source, error);
    for (int e = 0, i = 0; e < grid->mesh.element_count && result == SB_OK; e++) {
        if (grid->shares[e] < (sb_real)0.5)
            continue;
        source->particles[i] = source->points[i] = sbi_particle_corner(grid, e, middle);
        source->regions[i] = grid->mesh.regions ? grid->mesh.regions[e] : 0;
        source->weights[i++] = (sb_real)((double)grid->shares[e] * brick);
    }
    return result;
}

/* Region of a point of one's own: that of the last shape it is in. */
static int sbi_particle_region(const sb_particles_def *def, sb_vec3 point)
{
    int region = def->outer.region;
    for (int i = 0; i < def->inner_count; i++) {
        const sb_shape *shape = def->inner + i;
        sb_real d = shape->surface ? sb_surface_signed_distance_winding(shape->surface, point, NULL)
                                   : shape->distance(shape->user, point);
        if (d < 0 && shape->region >= 0)
            region = shape->region;
    }
    return region;
}

static sb_result sbi_particle_make_cloud(const sb_particles_def *def, sbi_particle_source *source, sb_error *error)
{
    sb_result result = sbi_particle_source_allocate(def, def->point_count, def->point_count, source, error);
    for (int i = 0; i < def->point_count && result == SB_OK; i++) {
        source->particles[i] = source->points[i] = def->points[i];
        source->weights[i] = def->volumes ? def->volumes[i] : 0;
        source->regions[i] = sbi_particle_region(def, def->points[i]);
    }
    return result;
}

static void sbi_particle_scale_weights(sbi_particle_source *source, double volume)
{
    double sum = 0;
    for (int i = 0; i < source->point_count; i++)
        sum += (double)source->weights[i];
    for (int i = 0; i < source->point_count && volume > 0 && sum > 0; i++)
        source->weights[i] = (sb_real)((double)source->weights[i] * (volume / sum));
}

/* v_i = m_i / rho_i with m_i = r_i^3, r_i the mean distance of the neighbours, rho_i = sum_j m_j W_ij with i itself:
 * the thesis' factor s drops out. */
static sb_result sbi_particle_weigh_by_distance(const sb_particles_def *def, const sbi_near *near,
                                                sbi_particle_source *source, sb_error *error)
{
    int n = source->point_count;
    sb_real *cube = (sb_real *)sbi_alloc(&def->allocator, (size_t)n, sizeof(sb_real));
    sbi_neighbours found;
    double h = 0;
    if (!cube)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the volumes of %d particles", n);
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < n; i++) {
            double sum = 0;
            if (!sbi_near_gather(near, def, source->points[i], i, 0, &found, &h))
                found.count = 0;
            for (int j = 0; j < found.count && pass == 0; j++)
                sum += found.distance[j] / found.count;
            if (pass == 0) {
                cube[i] = (sb_real)(sum * sum * sum);
                continue;
            }
            sum = (double)cube[i] * sbi_kernel_shape(def->kernel, 0);
            for (int j = 0; j < found.count; j++)
                sum += (double)cube[found.nodes[j]] * sbi_kernel_shape(def->kernel, found.distance[j] / h);
            source->weights[i] = sum > 0 ? (sb_real)((double)cube[i] * h * h * h / sum) : 0;
        }
    sbi_free(&def->allocator, cube);
    return SB_OK;
}

SBI_API sb_result sbi_particle_source_weigh(const sb_particles_def *def, const sbi_near *near,
                                            sbi_particle_source *source, sb_error *error)
{
    sb_result result = SB_OK;
    if (def->method == SB_PARTICLES_GRID)
        return SB_OK;
    if (def->points && !def->volumes)
        result = sbi_particle_weigh_by_distance(def, near, source, error);
    if (result == SB_OK)
        sbi_particle_scale_weights(source, def->volume > 0 ? (double)def->volume : (double)source->volume);
    return result;
}

SBI_API sb_result sbi_particle_source_make(const sb_particles_def *def, sbi_particle_source *source, sb_error *error)
{
    int has_outer = def->outer.surface || def->outer.distance;
    sb_grid grid;
    sb_result result = SB_OK;
    memset(source, 0, sizeof *source);
    memset(&grid, 0, sizeof grid);
    if (has_outer)
        result = sbi_particle_grid(def, &grid, error);
    if (result == SB_OK)
        result = def->method == SB_PARTICLES_GRID ? sbi_particle_make_grid(def, &grid, source, error)
                 : def->points                    ? sbi_particle_make_cloud(def, source, error)
                                                  : sbi_particle_make_lattice(def, &grid, source, error);
    if (result == SB_OK && has_outer)
        result = sbi_particle_add_samples(def, &grid, source, error);
    sb_grid_free(&grid);
    return result;
}
