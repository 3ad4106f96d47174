/* particles: their definition checked, neighbourhoods found, shape functions filled in. */
#include "particles_private.h"

#define SBI_PARTICLES_COOKIE 0x9a271u

SB_API sb_particles_def sb_default_particles_def(void)
{
    sb_particles_def def;
    memset(&def, 0, sizeof def);
    def.method = SB_PARTICLES_GRID;
    def.kernel = SB_KERNEL_CUBIC;
    def.radius_rule = SB_RADIUS_FARTHEST;
    def.dilatation = (sb_real)1.5;
    def.neighbours = 10;
    def.basis = 4;
    def.points_per_cell = 8;
    def.level = 2;
    def.consistent = 1;
    def.cells = 10;
    def.cookie = SBI_PARTICLES_COOKIE;
    return def;
}

/* The table that a cloud shows, and those that bodies of it before its cuts borrow. */
typedef struct sbi_particle_table {
    sb_element_table shown; /* first: sb_particles.table */
    struct sbi_particle_table *before;
} sbi_particle_table;

static void sbi_particle_tables_free(sb_element_table *shown, const sb_allocator *allocator)
{
    for (sbi_particle_table *table = (sbi_particle_table *)shown; table;) {
        sbi_particle_table *before = table->before;
        sbi_free(allocator, table);
        table = before;
    }
}

SB_API void sb_particles_free(sb_particles *particles)
{
    sb_allocator allocator;
    if (!particles)
        return;
    allocator = particles->def.allocator;
    for (int c = 0; c < particles->cut_count; c++)
        sb_surface_destroy(particles->cuts[c]);
    sbi_free(&allocator, particles->cuts);
    sb_mesh_free(&particles->mesh);
    sb_domain_free(&particles->domain);
    sbi_particle_tables_free(particles->table, &allocator);
    sbi_free(&allocator, particles->points);
    sbi_free(&allocator, particles->radii);
    sbi_free(&allocator, particles->shapes);
    sbi_free(&allocator, particles->inner);
    memset(particles, 0, sizeof *particles);
}

/* ---- the definition ---- */

static sb_result sbi_particles_check_choices(const sb_particles_def *def, sb_error *error)
{
    if (def->method < SB_PARTICLES_SPH || def->method > SB_PARTICLES_GRID)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.method %d is unknown", (int)def->method);
    if (def->kernel < SB_KERNEL_SPIKY || def->kernel > SB_KERNEL_QUARTIC)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.kernel %d is unknown", (int)def->kernel);
    if (def->radius_rule < SB_RADIUS_FIXED || def->radius_rule > SB_RADIUS_MEAN)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.radius_rule %d is unknown", (int)def->radius_rule);
    if (def->basis != 1 && def->basis != 4 && def->basis != 7 && def->basis != 10)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.basis %d is none of 1, 4, 7, 10", def->basis);
    if (def->points_per_cell != 1 && def->points_per_cell != 8)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.points_per_cell %d is neither 1 nor 8", def->points_per_cell);
    if (def->consistent != 0 && def->consistent != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.consistent %d is neither 0 nor 1", def->consistent);
    if (def->level < 0 || def->level > SB_GRID_MAX_LEVEL)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.level %d must be in [0, %d]", def->level, SB_GRID_MAX_LEVEL);
    return SB_OK;
}

static sb_result sbi_particles_check_reach(const sb_particles_def *def, sb_error *error)
{
    int least = def->method == SB_PARTICLES_GRID ? 2 * def->basis : 4;
    if (!(def->radius >= 0) || !sb_is_finite(def->radius) ||
        (def->radius_rule == SB_RADIUS_FIXED && !(def->radius > 0)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.radius %g must be >= 0, with SB_RADIUS_FIXED > 0",
                        (double)def->radius);
    if (!(def->dilatation >= 1) || !(def->dilatation <= 10))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.dilatation %g must be in [1, 10]", (double)def->dilatation);
    if (def->neighbours < 4 || def->neighbours > SB_MAX_NEIGHBOURS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.neighbours %d must be in [4, %d]", def->neighbours,
                        SB_MAX_NEIGHBOURS);
    if (def->radius_rule != SB_RADIUS_FIXED && def->neighbours < least)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.basis %d needs def.neighbours %d or more, not %d", def->basis,
                        least, def->neighbours);
    if (!(def->volume >= 0) || !sb_is_finite(def->volume))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.volume %g must be >= 0", (double)def->volume);
    return SB_OK;
}

static sb_result sbi_particles_check_points(const sb_particles_def *def, sb_error *error)
{
    int has_outer = def->outer.surface || def->outer.distance;
    if (!has_outer && (def->method == SB_PARTICLES_GRID || !def->points))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.outer is needed %s",
                        def->method == SB_PARTICLES_GRID ? "for a grid" : "where def.points is NULL");
    if (!has_outer && def->inner_count != 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.inner goes with def.outer");
    if (def->points && def->point_count < 5)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.point_count %d must be >= 5", def->point_count);
    if (!def->points && (def->point_count != 0 || def->volumes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.point_count and def.volumes go with def.points");
    for (int i = 0; i < def->point_count; i++) {
        if (!sb_v3_is_finite(def->points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "def.points[%d] is not finite", i);
        if (def->volumes && (!(def->volumes[i] > 0) || !sb_is_finite(def->volumes[i])))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "def.volumes[%d] = %g must be > 0", i,
                                 (double)def->volumes[i]);
    }
    return SB_OK;
}

static sb_result sbi_particles_check_def(const sb_particles_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_PARTICLES_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_particles_def");
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
    result = sbi_particles_check_choices(def, error);
    if (result == SB_OK)
        result = sbi_particles_check_reach(def, error);
    return result == SB_OK ? sbi_particles_check_points(def, error) : result;
}

/* ---- neighbourhoods ---- */

enum {
    SBI_POINTS_PER_TASK = 32,
    SBI_POINT_SINGULAR = 1,
    SBI_POINT_CROWDED = 2,
    SBI_POINT_GROWN = 4,
    SBI_POINT_LOST = 8
};

/* What is known of a point before the width of the cells is. */
typedef struct sbi_particle_site {
    int count, found; /* nodes; SBI_POINT_ bits */
    double h, rank;
    int nodes[SBI_PARTICLE_NODES];
} sbi_particle_site;

typedef struct sbi_particles_work {
    const sbi_near *near;
    sb_particles *particles;
    sbi_particle_site *sites; /* [point_count] */
    int point_count;
    const sb_vec3 *points;
    const sb_real *volumes; /* [particle_count] where points are particles */
} sbi_particles_work;

static int sbi_particles_are_points(const sb_particles_def *def) { return def->method != SB_PARTICLES_GRID; }

/* Shape functions and gradients at a point from its neighbours; what its own particle gets follows. */
static int sbi_particles_evaluate(const sbi_particles_work *work, const sbi_neighbours *near, double h, int pseudo,
                                  double *shapes, double (*gradients)[3], double *rank)
{
    const sb_particles_def *def = &work->particles->def;
    *rank = 1;
    if (def->method == SB_PARTICLES_GRID)
        return sbi_moving_shapes(def->kernel, def->basis, h, near, pseudo, shapes, gradients, rank);
    memset(shapes, 0, (size_t)near->count * sizeof *shapes);
    if (def->method == SB_PARTICLES_MLS)
        return sbi_moving_slopes(def->kernel, h, near, pseudo, gradients, rank);
    sbi_sph_slopes(def->kernel, h, near, work->volumes, gradients);
    return 1;
}

/* Finds the neighbours of a point, with a radius that grows until they span space. */
static void sbi_particles_find(const sbi_particles_work *work, int index)
{
    const sb_particles_def *def = &work->particles->def;
    sbi_particle_site *site = work->sites + index;
    double shapes[SBI_PARTICLE_NODES], gradients[SBI_PARTICLE_NODES][3];
    sbi_neighbours near;
    int own = sbi_particles_are_points(def);
    site->found = SBI_POINT_SINGULAR;
    for (int growth = 0; growth < 4 && (site->found & SBI_POINT_SINGULAR); growth++) {
        near.count = 0;
        site->found = growth > 0 ? SBI_POINT_GROWN : 0;
        if (!sbi_near_gather(work->near, def, work->points[index], own ? index : -1, growth, &near, &site->h)) {
            site->found |= SBI_POINT_CROWDED;
            return;
        }
        if (near.count == 0 || !sbi_particles_evaluate(work, &near, site->h, 0, shapes, gradients, &site->rank))
            site->found |= SBI_POINT_SINGULAR;
    }
    if ((site->found & SBI_POINT_SINGULAR) && work->near->cut_count)
        site->found = SBI_POINT_LOST;
    site->count = 0;
    if (own)
        site->nodes[site->count++] = index;
    for (int j = 0; j < near.count; j++)
        site->nodes[site->count++] = near.nodes[j];
}

static void sbi_particles_find_task(void *user, int task)
{
    const sbi_particles_work *work = (const sbi_particles_work *)user;
    int begin = task * SBI_POINTS_PER_TASK;
    int end = begin + sbi_min_int(SBI_POINTS_PER_TASK, work->point_count - begin);
    for (int i = begin; i < end; i++)
        sbi_particles_find(work, i);
}

/* ---- cells ---- */

/* The neighbours that a site has, as its search had found them. */
static void sbi_particles_revisit(const sbi_particles_work *work, int index, int own, sbi_neighbours *near)
{
    const sbi_particle_site *site = work->sites + index;
    sb_vec3 at = work->points[index];
    near->count = site->count - own;
    for (int j = 0; j < near->count; j++) {
        sb_vec3 x = work->near->points[site->nodes[own + j]];
        double *offset = near->offset[j];
        near->nodes[j] = site->nodes[own + j];
        offset[0] = (double)x.x - (double)at.x;
        offset[1] = (double)x.y - (double)at.y;
        offset[2] = (double)x.z - (double)at.z;
        near->distance[j] = sqrt(offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]);
    }
}

/* Masses (m^3) of the pairs a <= b. */
static void sbi_particles_weigh_cell(const sb_particles *particles, int cell)
{
    int n = particles->domain.nodes_per_cell;
    const sb_real *shapes = particles->shapes + (size_t)cell * (size_t)n;
    sb_real *mass = particles->domain.cell_mass + (size_t)cell * (size_t)(n * (n + 1) / 2);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++)
            *mass++ = particles->domain.weights[cell] * shapes[a] * shapes[b];
}

static void sbi_particles_fill(const sbi_particles_work *work, int index)
{
    sb_particles *particles = work->particles;
    const sbi_particle_site *site = work->sites + index;
    int n = particles->domain.nodes_per_cell, own = sbi_particles_are_points(&particles->def);
    int *nodes = particles->domain.cells + (size_t)index * (size_t)n;
    sb_real *out = particles->domain.gradients + 3 * (size_t)index * (size_t)n;
    sb_real *phi = particles->shapes + (size_t)index * (size_t)n;
    double shapes[SBI_PARTICLE_NODES], gradients[SBI_PARTICLE_NODES][3], rank;
    sbi_neighbours near;
    memset(gradients, 0, sizeof gradients);
    memset(shapes, 0, sizeof shapes);
    sbi_particles_revisit(work, index, own, &near);
    if (near.count > 0)
        sbi_particles_evaluate(work, &near, site->h, 1, shapes + own, gradients + own, &rank);
    if (own)
        shapes[0] = 1;
    for (int a = 0; a < n; a++) {
        nodes[a] = site->nodes[sbi_min_int(a, site->count - 1)];
        phi[a] = a < site->count ? (sb_real)shapes[a] : 0;
        for (int k = 0; k < 3; k++)
            out[3 * a + k] = a < site->count ? (sb_real)gradients[a][k] : 0;
    }
    for (int k = 0; k < 3; k++) { /* a translation is no deformation, to rounding */
        out[k] = 0;
        for (int a = 1; a < site->count; a++)
            out[k] -= out[3 * a + k];
    }
    particles->radii[index] = (sb_real)site->h;
    sbi_particles_weigh_cell(particles, index);
}

static void sbi_particles_fill_task(void *user, int task)
{
    const sbi_particles_work *work = (const sbi_particles_work *)user;
    int begin = task * SBI_POINTS_PER_TASK;
    int end = begin + sbi_min_int(SBI_POINTS_PER_TASK, work->point_count - begin);
    for (int i = begin; i < end; i++)
        sbi_particles_fill(work, i);
}

/* Sums up what the searches found; *width: most nodes of a point. */
static sb_result sbi_particles_sum_up(const sbi_particles_work *work, int *width, sb_error *error)
{
    double least = 1;
    *width = 4;
    for (int i = 0; i < work->point_count; i++) {
        const sbi_particle_site *site = work->sites + i;
        sb_vec3 x = work->points[i];
        if (site->found & SBI_POINT_CROWDED)
            return sbi_fail_element(error, SB_ERROR_UNSUPPORTED, i,
                                    "point %d at (%g %g %g) has too many particles about it: a cell has %d at most", i,
                                    (double)x.x, (double)x.y, (double)x.z, SB_MAX_ELEMENT_NODES);
        if (site->found & SBI_POINT_SINGULAR)
            return sbi_fail_element(error, SB_ERROR_MESH, i,
                                    "the neighbours of point %d at (%g %g %g) do not span space", i, (double)x.x,
                                    (double)x.y, (double)x.z);
        work->particles->grown += (site->found & SBI_POINT_GROWN) != 0;
        work->particles->lost += (site->found & SBI_POINT_LOST) != 0;
        least = site->found & SBI_POINT_LOST ? least : fmin(least, site->rank);
        *width = sbi_max_int(*width, site->count);
    }
    work->particles->worst_condition = (sb_real)(1 / least);
    return SB_OK;
}

static sb_result sbi_particles_allocate(sb_particles *particles, int nodes, int points, int width, sb_error *error)
{
    const sb_allocator *allocator = &particles->def.allocator;
    size_t n = (size_t)width, cells = (size_t)points;
    sb_domain *domain = &particles->domain;
    sb_mesh *mesh = &particles->mesh;
    mesh->allocator = domain->allocator = *allocator;
    particles->table = (sb_element_table *)sbi_alloc_zeroed(allocator, 1, sizeof(sbi_particle_table));
    mesh->nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)nodes, sizeof(sb_vec3));
    mesh->elements = (int *)sbi_alloc(allocator, cells, n * sizeof(int));
    mesh->regions = (int *)sbi_alloc(allocator, cells, sizeof(int));
    domain->cells = (int *)sbi_alloc(allocator, cells, n * sizeof(int));
    domain->gradients = (sb_real *)sbi_alloc(allocator, cells, 3 * n * sizeof(sb_real));
    domain->weights = (sb_real *)sbi_alloc(allocator, cells, sizeof(sb_real));
    domain->cell_mass = (sb_real *)sbi_alloc(allocator, cells, n * (n + 1) / 2 * sizeof(sb_real));
    particles->points = (sb_vec3 *)sbi_alloc(allocator, cells, sizeof(sb_vec3));
    particles->radii = (sb_real *)sbi_alloc(allocator, cells, sizeof(sb_real));
    particles->shapes = (sb_real *)sbi_alloc(allocator, cells, n * sizeof(sb_real));
    particles->inner = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)nodes, 1);
    if (!particles->table || !mesh->nodes || !mesh->elements || !mesh->regions || !domain->cells ||
        !domain->gradients || !domain->weights || !domain->cell_mass || !particles->points || !particles->radii ||
        !particles->shapes || !particles->inner)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d points with %d particles each", points, width);
    particles->table->name = "particles";
    particles->table->node_count = particles->table->corner_count = width;
    particles->table->vtk_type = 2;
    mesh->element_type = domain->element_type = SB_CUSTOM;
    mesh->table = domain->table = particles->table;
    mesh->node_count = domain->node_count = nodes;
    mesh->element_count = domain->cell_count = points;
    domain->nodes_per_cell = width;
    domain->points_per_cell = 1;
    return SB_OK;
}

/* Cells of all points in particles whose def and cuts are set: `regions` and `weights` are of the points. */
static sb_result sbi_particles_build(sbi_particles_work *work, const int *regions, const sb_real *weights,
                                     sb_error *error)
{
    sb_particles *particles = work->particles;
    const sb_jobs *jobs = &particles->def.jobs;
    int tasks = (work->point_count - 1) / SBI_POINTS_PER_TASK + 1, width = 0;
    size_t points = (size_t)work->point_count;
    double volume = 0;
    sb_result result = SB_OK;
    work->sites = (sbi_particle_site *)sbi_alloc(&particles->def.allocator, points, sizeof *work->sites);
    if (!work->sites)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the neighbours of %d points", work->point_count);
    sbi_run(jobs, sbi_particles_find_task, work, tasks);
    result = sbi_particles_sum_up(work, &width, error);
    if (result == SB_OK)
        result = sbi_particles_allocate(particles, work->near->count, work->point_count, width, error);
    if (result == SB_OK) {
        memcpy(particles->mesh.nodes, work->near->points, (size_t)work->near->count * sizeof(sb_vec3));
        memcpy(particles->mesh.regions, regions, points * sizeof(int));
        memcpy(particles->domain.weights, weights, points * sizeof(sb_real));
        memcpy(particles->points, work->points, points * sizeof(sb_vec3));
        sbi_run(jobs, sbi_particles_fill_task, work, tasks);
        memcpy(particles->mesh.elements, particles->domain.cells, points * (size_t)width * sizeof(int));
        for (size_t i = 0; i < points; i++)
            volume += (double)weights[i];
        particles->volume = (sb_real)volume;
        particles->spacing = (sb_real)cbrt(volume / work->near->count);
        if (!sb_is_finite(particles->volume) || !(particles->spacing > 0))
            result = sbi_fail(error, SB_ERROR_NOT_FINITE, "the volumes of %d points sum up to %g m^3",
                              work->point_count, volume);
    }
    sbi_free(&particles->def.allocator, work->sites);
    return result;
}

/* No two particles at the same place, beside how far others are: nothing would hold them together. */
static sb_result sbi_particles_check_apart(const sbi_near *near, sb_error *error)
{
    sbi_neighbours found;
    for (int i = 0; i < near->count; i++)
        if (sbi_near_find(near, near->points[i], i, 4, 4, 0, &found) && found.count > 0 &&
            found.distance[0] <= 1e-6 * found.distance[found.count - 1])
            return sbi_fail_node(error, SB_ERROR_MESH, i, "particle %d is where particle %d is", i, found.nodes[0]);
    return SB_OK;
}

/* A guess of the spacing, for boxes: of the volume, or of the box round the points. */
static sb_real sbi_particles_guess_spacing(const sbi_particle_source *source)
{
    double low[3] = {0, 0, 0}, high[3] = {0, 0, 0}, volume = 1;
    for (int i = 0; i < source->particle_count; i++) {
        sb_vec3 p = source->particles[i];
        const double x[3] = {(double)p.x, (double)p.y, (double)p.z};
        for (int k = 0; k < 3; k++) {
            low[k] = i == 0 || x[k] < low[k] ? x[k] : low[k];
            high[k] = i == 0 || x[k] > high[k] ? x[k] : high[k];
        }
    }
    for (int k = 0; k < 3; k++)
        volume *= high[k] - low[k];
    volume = source->volume > 0 ? (double)source->volume : volume;
    return (sb_real)cbrt(volume / source->particle_count);
}

static void sbi_particles_keep_def(const sb_particles_def *def, sb_particles *particles)
{
    particles->def = *def;
    particles->def.outer.surface = NULL;
    particles->def.outer.distance = NULL;
    particles->def.outer.user = NULL;
    particles->def.inner = NULL;
    particles->def.points = NULL;
    particles->def.volumes = NULL;
}

static sb_result sbi_particles_make(const sb_particles_def *def, sb_particles *particles, sb_error *error)
{
    const sb_allocator *allocator = &def->allocator;
    sbi_particle_source source;
    sbi_particles_work work;
    sbi_near near;
    sb_result result = sbi_particle_source_make(def, &source, error);
    memset(&near, 0, sizeof near);
    memset(&work, 0, sizeof work);
    if (result == SB_OK)
        result = sbi_near_create(source.particles, source.particle_count, sbi_particles_guess_spacing(&source),
                                 allocator, &near, error);
    if (result == SB_OK && def->points)
        result = sbi_particles_check_apart(&near, error);
    if (result == SB_OK)
        result = sbi_particle_source_weigh(def, &near, &source, error);
    if (result == SB_OK) {
        work.near = &near;
        work.particles = particles;
        work.point_count = source.point_count;
        work.points = source.points;
        work.volumes = source.weights;
        result = sbi_particles_build(&work, source.regions, source.weights, error);
    }
    if (result == SB_OK) {
        sbi_particles_mark_inner(&near, source.samples, source.sample_count, particles);
        result = sbi_particles_correct(particles, error);
    }
    sbi_near_free(&near, allocator);
    sbi_particle_source_free(&source, allocator);
    return result;
}

SB_API sb_result sb_particles_create(const sb_particles_def *def, sb_particles *particles, sb_error *error)
{
    sb_particles made;
    sb_result result;
    if (!def || !particles)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_particles_create needs a def and particles");
    result = sbi_particles_check_def(def, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    sbi_particles_keep_def(def, &made);
    result = sbi_particles_make(def, &made, error);
    if (result == SB_OK)
        *particles = made;
    else
        sb_particles_free(&made);
    return result;
}

/* ---- cuts ---- */

/* Particles about a point that lost a neighbour are inner no more: b is no longer 0 there. */
static void sbi_particles_open(const sb_particles *before, sb_particles *after)
{
    size_t m = (size_t)before->domain.nodes_per_cell, n = (size_t)after->domain.nodes_per_cell;
    memcpy(after->inner, before->inner, (size_t)before->mesh.node_count);
    for (int e = 0; e < before->mesh.element_count; e++) {
        const int *old = before->domain.cells + m * (size_t)e, *made = after->domain.cells + n * (size_t)e;
        int count = sbi_particle_cell_count(before, e), now = sbi_particle_cell_count(after, e);
        if (count == now && memcmp(old, made, (size_t)count * sizeof(int)) == 0)
            continue;
        for (int a = 0; a < count; a++)
            after->inner[old[a]] = 0;
        for (int a = 0; a < now; a++)
            after->inner[made[a]] = 0;
    }
}

/* Old cuts are handed over on success. */
static sb_result sbi_particles_add_cut(const sb_particles *before, const sb_mesh *surface, sb_particles *after,
                                       sb_error *error)
{
    size_t cuts = (size_t)before->cut_count;
    sb_result result;
    after->cuts = (sb_surface **)sbi_alloc(&before->def.allocator, cuts + 1, sizeof(sb_surface *));
    if (!after->cuts)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a cut");
    result = sb_surface_create(surface, &before->def.allocator, &after->cuts[cuts], error);
    if (result != SB_OK)
        return result;
    if (cuts)
        memcpy(after->cuts, before->cuts, cuts * sizeof(sb_surface *));
    after->cut_count = before->cut_count + 1;
    return SB_OK;
}

static sb_result sbi_particles_rebuild(const sb_particles *before, sb_particles *after, sb_error *error)
{
    const sb_allocator *allocator = &before->def.allocator;
    sbi_particles_work work;
    sbi_near near;
    sb_result result =
        sbi_near_create(before->mesh.nodes, before->mesh.node_count, before->spacing, allocator, &near, error);
    if (result != SB_OK)
        return result;
    memset(&work, 0, sizeof work);
    near.cuts = after->cuts;
    near.cut_count = after->cut_count;
    work.near = &near;
    work.particles = after;
    work.point_count = before->mesh.element_count;
    work.points = before->points;
    work.volumes = before->domain.weights;
    result = sbi_particles_build(&work, before->mesh.regions, before->domain.weights, error);
    if (result == SB_OK) {
        sbi_particles_open(before, after);
        result = sbi_particles_correct(after, error);
    }
    sbi_near_free(&near, allocator);
    return result;
}

SB_API sb_result sb_particles_cut(sb_particles *particles, const sb_mesh *surface, sb_error *error)
{
    sb_particles made;
    sb_result result;
    int kept;
    if (!particles || !particles->table || !surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_particles_cut needs particles and a surface");
    memset(&made, 0, sizeof made);
    made.def = particles->def;
    kept = particles->cut_count;
    result = sbi_particles_add_cut(particles, surface, &made, error);
    if (result == SB_OK)
        result = sbi_particles_rebuild(particles, &made, error);
    if (result == SB_OK) {
        particles->cut_count = 0; /* they are the new one's, and so are the tables */
        ((sbi_particle_table *)made.table)->before = (sbi_particle_table *)particles->table;
        particles->table = NULL;
        sb_particles_free(particles);
        *particles = made;
        return SB_OK;
    }
    if (made.cut_count > kept)
        sb_surface_destroy(made.cuts[kept]);
    made.cut_count = 0;
    sb_particles_free(&made);
    return result;
}
