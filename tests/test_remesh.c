/* remesh: random insertions and retractions, what they keep, and what they refuse. */
#include "scene.h"

#include "needle.h"

/* ---- meshes ---- */

static int block_corner(const int n[3], int i, int j, int k) { return i + (n[0] + 1) * (j + (n[1] + 1) * k); }

static int block_centre(const int n[3], const int at[3])
{
    return (n[0] + 1) * (n[1] + 1) * (n[2] + 1) + at[0] + n[0] * (at[1] + n[1] * at[2]);
}

static void block_tet(sb_mesh *mesh, int a, int b, int c, int d)
{
    int *to = mesh->elements + 4 * (size_t)mesh->element_count++;
    to[0] = a, to[1] = b, to[2] = c, to[3] = d;
}

/* The four tets (on the surface: two) about the face of a cell. */
static void block_face(sb_mesh *mesh, const int n[3], const int at[3], int axis, int side)
{
    int q[4], other[3], u = (axis + 1) % 3, w = (axis + 2) % 3, centre = block_centre(n, at);
    for (int e = 0; e < 4; e++) {
        int c[3];
        memcpy(c, at, sizeof c);
        c[axis] += side;
        c[u] += e == 1 || e == 2;
        c[w] += e >= 2;
        q[e] = block_corner(n, c[0], c[1], c[2]);
    }
    memcpy(other, at, sizeof other);
    other[axis] += side ? 1 : -1;
    if (other[axis] >= 0 && other[axis] < n[axis]) {
        for (int e = 0; side && e < 4; e++)
            block_tet(mesh, centre, block_centre(n, other), q[e], q[(e + 1) % 4]);
    } else {
        block_tet(mesh, centre, q[0], q[1], q[2]);
        block_tet(mesh, centre, q[0], q[2], q[3]);
    }
}

/* Body-centred cubic lattice of cells of edge h, cut at the faces of a block; inner nodes shaken by up to `shake` h. */
static sb_mesh block_mesh(int nx, int ny, int nz, double h, double shake)
{
    sb_mesh mesh;
    unsigned long long seed = 5;
    int n[3];
    n[0] = nx, n[1] = ny, n[2] = nz;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TET4;
    mesh.node_count = (nx + 1) * (ny + 1) * (nz + 1) + nx * ny * nz;
    mesh.nodes = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    mesh.elements = (int *)malloc((size_t)(nx * ny * nz) * 24 * 4 * sizeof(int));
    for (int k = 0; k <= nz; k++)
        for (int j = 0; j <= ny; j++)
            for (int i = 0; i <= nx; i++) {
                double x[3];
                x[0] = i, x[1] = j, x[2] = k;
                for (int a = 0; a < 3; a++)
                    if (x[a] > 0.5 && x[a] < n[a] - 0.5)
                        x[a] += check_random_in(&seed, -shake, shake);
                mesh.nodes[block_corner(n, i, j, k)] = sb_v3(REAL(h * x[0]), REAL(h * x[1]), REAL(h * x[2]));
            }
    for (int at[3] = {0, 0, 0}; at[2] < nz; at[2]++)
        for (at[1] = 0; at[1] < ny; at[1]++)
            for (at[0] = 0; at[0] < nx; at[0]++) {
                double x[3];
                for (int a = 0; a < 3; a++)
                    x[a] = at[a] + 0.5 + check_random_in(&seed, -shake, shake);
                mesh.nodes[block_centre(n, at)] = sb_v3(REAL(h * x[0]), REAL(h * x[1]), REAL(h * x[2]));
                for (int axis = 0; axis < 3; axis++)
                    for (int side = 0; side < 2; side++)
                        block_face(&mesh, n, at, axis, side);
            }
    CHECK_OK(sb_mesh_orient(&mesh, NULL, NULL));
    return mesh;
}

static sb_real rounded_block(void *user, sb_vec3 p)
{
    double q[3], out = 0, most = -1, radius = 0.012;
    (void)user;
    q[0] = fabs((double)p.x) - 0.04 + radius, q[1] = fabs((double)p.y) - 0.035 + radius;
    q[2] = fabs((double)p.z) - 0.03 + radius;
    for (int a = 0; a < 3; a++) {
        out += q[a] > 0 ? q[a] * q[a] : 0;
        most = q[a] > most ? q[a] : most;
    }
    return REAL(sqrt(out) + (most < 0 ? most : 0) - radius);
}

static sb_real ellipsoid(void *user, sb_vec3 p)
{
    double x = ((double)p.x - 0.003) / 0.02, y = (double)p.y / 0.016, z = (double)p.z / 0.014;
    (void)user;
    return REAL((sqrt(x * x + y * y + z * z) - 1) * 0.014);
}

/* A block by isosurface stuffing, with an ellipsoid of region 1 when shapes is 2. */
static sb_mesh stuffed_mesh(int shapes)
{
    sb_mesh mesh;
    sb_stuff_shape shape[2];
    sb_stuff_def def = sb_default_stuff_def();
    memset(&mesh, 0, sizeof mesh);
    memset(shape, 0, sizeof shape);
    shape[0].distance = rounded_block;
    shape[0].max_slope = 1;
    shape[1].distance = ellipsoid;
    shape[1].region = 1;
    def.shapes = shape;
    def.shape_count = shapes;
    def.low = sb_v3(REAL(-0.045), REAL(-0.04), REAL(-0.035));
    def.high = sb_v3(REAL(0.045), REAL(0.04), REAL(0.035));
    def.cell = REAL(0.008);
    CHECK_OK(sb_mesh_stuff(&def, &mesh, NULL, NULL));
    return mesh;
}

static const sb_real densities[2] = {1000, 1300};

/* ---- a tissue under watch ---- */

/* The mesh as it follows from the reports of changes alone, and what these say about quality. */
typedef struct watch {
    ndl_tissue_mesh *tissue;
    int *tets; /* [4 capacity]; [4 t] < 0: none */
    int capacity, faults;
    int *changed, changed_count; /* tets since the last look */
} watch;

static void watch_tet(watch *w, int tet)
{
    if (tet >= w->capacity) {
        w->faults++;
        return;
    }
    memcpy(w->tets + 4 * tet, w->tissue->tets + 4 * tet, 4 * sizeof(int));
    w->changed[w->changed_count++ % w->capacity] = tet;
}

static void watch_change(void *user, const ndl_mesh_change *change)
{
    watch *w = (watch *)user;
    for (int i = 0; i < change->removed_count; i++) {
        w->faults += change->removed[i] >= w->capacity || w->tets[4 * change->removed[i]] < 0;
        w->tets[4 * change->removed[i]] = -1;
    }
    for (int i = 0; i < change->created_count; i++) {
        w->faults += w->tets[4 * change->created[i]] >= 0;
        watch_tet(w, change->created[i]);
    }
    for (int i = 0; i < change->changed_count; i++) {
        w->faults += w->tets[4 * change->changed[i]] < 0;
        watch_tet(w, change->changed[i]);
    }
    for (int i = 0; i < change->node_count; i++) {
        double sum = 0;
        for (int c = 0; c < 4; c++)
            sum += (double)change->nodes[i].weights[c];
        w->faults += !(fabs(sum - 1) < scene_tolerance(1e-12, 64));
    }
}

static void watch_begin(watch *w, ndl_tissue_mesh *tissue)
{
    w->tissue = tissue;
    w->capacity = 2 * tissue->tet_end;
    w->faults = w->changed_count = 0;
    w->tets = (int *)malloc(4 * (size_t)w->capacity * sizeof(int));
    w->changed = (int *)malloc((size_t)w->capacity * sizeof(int));
    memset(w->tets, -1, 4 * (size_t)w->capacity * sizeof(int));
    memcpy(w->tets, tissue->tets, 4 * (size_t)tissue->tet_end * sizeof(int));
    tissue->listener = watch_change;
    tissue->listener_user = w;
}

static void watch_end(watch *w)
{
    CHECK_INT(w->faults, 0);
    for (int t = 0; t < w->tissue->tet_end; t++)
        if (w->tissue->tets[4 * t] < 0 ? w->tets[4 * t] >= 0
                                       : memcmp(w->tets + 4 * t, w->tissue->tets + 4 * t, 4 * sizeof(int)) != 0) {
            CHECK_INT(t, -1);
            break;
        }
    free(w->tets);
    free(w->changed);
}

/* Extreme dihedral angles (degrees) of a tet, in double. */
static void tet_angles(const ndl_tissue_mesh *tissue, int tet, double *low, double *high)
{
    double p[4][3], normal[4][3];
    static const int face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
    for (int c = 0; c < 4; c++) {
        sb_vec3 X = tissue->X[tissue->tets[4 * tet + c]];
        p[c][0] = (double)X.x, p[c][1] = (double)X.y, p[c][2] = (double)X.z;
    }
    for (int f = 0; f < 4; f++) {
        double a[3], b[3], length;
        for (int k = 0; k < 3; k++) {
            a[k] = p[face[f][1]][k] - p[face[f][0]][k];
            b[k] = p[face[f][2]][k] - p[face[f][0]][k];
        }
        for (int k = 0; k < 3; k++)
            normal[f][k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
        length = sqrt(normal[f][0] * normal[f][0] + normal[f][1] * normal[f][1] + normal[f][2] * normal[f][2]);
        for (int k = 0; k < 3; k++)
            normal[f][k] /= length;
    }
    for (int f = 0; f < 4; f++)
        for (int g = 0; g < f; g++) {
            double angle = 57.29577951308232 * acos(-(normal[f][0] * normal[g][0] + normal[f][1] * normal[g][1] +
                                                      normal[f][2] * normal[g][2]));
            *low = angle < *low ? angle : *low;
            *high = angle > *high ? angle : *high;
        }
}

/* ---- programs ---- */

enum { MAX_STEPS = 400 };

/* A bent path into the tissue from the top, with the needle turned as it goes. */
typedef struct path {
    sb_vec3 points[MAX_STEPS];
    int count;
    double step;
} path;

static void path_make(path *p, sb_vec3 start, double edge, double depth, unsigned long long *seed)
{
    double tilt = check_random_in(seed, 0, 0.35), turn = check_random_in(seed, 0, 6.28), length = 0;
    double radius = check_random_in(seed, 10, 40) * edge, roll = check_random_in(seed, 0, 6.28);
    double twist = check_random_in(seed, -0.3, 0.3) / edge;
    double d[3], u[3], x[3];
    p->step = check_random_in(seed, 0.06, 0.12) * edge;
    d[0] = sin(tilt) * cos(turn), d[1] = sin(tilt) * sin(turn), d[2] = -cos(tilt);
    u[0] = cos(tilt) * cos(turn), u[1] = cos(tilt) * sin(turn), u[2] = sin(tilt);
    x[0] = (double)start.x, x[1] = (double)start.y, x[2] = (double)start.z;
    p->count = 0;
    for (; length < depth && p->count < MAX_STEPS; length += p->step) {
        double dot = 0, size = 0, bend[3], w[3];
        p->points[p->count++] = sb_v3(REAL(x[0]), REAL(x[1]), REAL(x[2]));
        for (int k = 0; k < 3; k++)
            w[k] = d[(k + 1) % 3] * u[(k + 2) % 3] - d[(k + 2) % 3] * u[(k + 1) % 3];
        for (int k = 0; k < 3; k++)
            bend[k] = cos(roll) * u[k] + sin(roll) * w[k];
        roll += twist * p->step;
        for (int k = 0; k < 3; k++)
            d[k] += p->step / radius * bend[k];
        for (int k = 0; k < 3; k++)
            size += d[k] * d[k];
        for (int k = 0; k < 3; k++)
            d[k] /= sqrt(size);
        for (int k = 0; k < 3; k++)
            dot += d[k] * u[k];
        for (int k = 0; k < 3; k++) {
            u[k] -= dot * d[k];
            x[k] += p->step * d[k];
        }
    }
}

typedef struct programs {
    watch eye;
    ndl_tissue_mesh tissue;
    ndl_remesh *remesh;
    sb_mesh mesh;
    double edge, worst, low, high; /* figures while the tip is more than twenty steps deep */
    double worst_at_all, drift, time_steps;
    double first_volume, first_mass, first_quality;
    int operations, smoothed, failures;
} programs;

static int programs_begin(programs *p, sb_mesh mesh, double edge)
{
    ndl_remesh_def def = ndl_default_remesh_def();
    sb_real quality;
    memset(p, 0, sizeof *p);
    p->mesh = mesh;
    p->edge = edge;
    p->worst = p->worst_at_all = 1;
    p->low = 180;
    if (!CHECK_OK(ndl_tissue_mesh_create(&mesh, densities, mesh.regions ? 2 : 1, REAL(0.1), NULL, &p->tissue, NULL)))
        return 0;
    def.tissue = &p->tissue;
    watch_begin(&p->eye, &p->tissue);
    ndl_tissue_mesh_quality(&p->tissue, &quality, NULL, NULL);
    p->first_quality = (double)quality;
    p->first_volume = (double)ndl_tissue_mesh_volume(&p->tissue);
    p->first_mass = (double)ndl_tissue_mesh_mass(&p->tissue);
    return CHECK_OK(ndl_remesh_create(&def, &p->remesh, NULL));
}

static void programs_end(programs *p)
{
    ndl_remesh_destroy(p->remesh);
    watch_end(&p->eye);
    ndl_tissue_mesh_free(&p->tissue);
}

/* What must hold after each step; `deep` when the figures of quality count. */
static void programs_look(programs *p, sb_vec3 X, int deep)
{
    int count;
    const int *nodes = ndl_remesh_nodes(p->remesh, 0, &count);
    sb_real worst;
    double volume = (double)ndl_tissue_mesh_volume(&p->tissue) / p->first_volume - 1;
    double mass = (double)ndl_tissue_mesh_mass(&p->tissue) / p->first_mass - 1;
    p->drift = fmax(p->drift, fmax(fabs(volume), fabs(mass)));
    ndl_tissue_mesh_quality(&p->tissue, &worst, NULL, NULL);
    p->worst_at_all = fmin(p->worst_at_all, (double)worst);
    CHECK(worst > 0);
    if (CHECK(count > 0))
        CHECK(sb_v3_norm(sb_v3_sub(p->tissue.X[nodes[count - 1]], X)) <= REAL(p->edge * 1e-6));
    for (int i = 0; i + 1 < count; i++) {
        int joined = 0;
        for (int k = p->tissue.node_star[nodes[i]]; k >= 0; k = p->tissue.corner_next[k])
            for (int c = 0; c < 4; c++)
                joined |= p->tissue.tets[4 * (k / 4) + c] == nodes[i + 1];
        CHECK(joined);
    }
    if (!deep)
        return;
    p->worst = fmin(p->worst, (double)worst);
    for (int i = 0; i < p->eye.changed_count && i < p->eye.capacity; i++)
        if (p->tissue.tets[4 * p->eye.changed[i]] >= 0)
            tet_angles(&p->tissue, p->eye.changed[i], &p->low, &p->high);
}

static int programs_step(programs *p, sb_vec3 X, int retracts, int deep)
{
    ndl_remesh_info info;
    sb_error error;
    sb_result result;
    p->eye.changed_count = 0;
    result = retracts ? ndl_remesh_retract(p->remesh, 0, X, &info, &error)
                      : ndl_remesh_penetrate(p->remesh, 0, X, &info, &error);
    if (result != SB_OK) {
        p->failures++;
        printf("%s\n", error.message);
        return 0;
    }
    p->operations += info.substeps;
    p->smoothed += info.smoothed;
    if (info.outside)
        return 0;
    programs_look(p, X, deep);
    return 1;
}

static int programs_enter(programs *p, unsigned long long *seed, sb_vec3 *X)
{
    ndl_surface_hit hit;
    ndl_remesh_info info;
    sb_vec3 low, high, from, to;
    sb_mesh_bounds(&p->mesh, &low, &high);
    from.x = low.x + (high.x - low.x) * REAL(check_random_in(seed, 0.3, 0.7));
    from.y = low.y + (high.y - low.y) * REAL(check_random_in(seed, 0.3, 0.7));
    from.z = high.z + REAL(p->edge);
    to = sb_v3(from.x, from.y, low.z);
    if (!CHECK(ndl_tissue_mesh_hit(&p->tissue, from, to, &hit)) ||
        !CHECK_OK(ndl_remesh_puncture(p->remesh, 0, &hit, &info, NULL)))
        return 0;
    *X = info.X;
    return 1;
}

/* Further than an element from all sides but the top: near the skin, flat tets cannot be avoided. */
static int is_inside(sb_vec3 X, sb_vec3 low, sb_vec3 high, double edge)
{
    sb_real margin = REAL(1.25 * edge);
    return X.x > low.x + margin && X.y > low.y + margin && X.z > low.z + margin && X.x < high.x - margin &&
           X.y < high.y - margin;
}

static void programs_run(programs *p, int count, unsigned long long seed)
{
    for (int i = 0; i < count; i++) {
        sb_vec3 X = sb_v3(0, 0, 0), low, high;
        sb_error error;
        path way;
        int last = 0;
        sb_mesh_bounds(&p->mesh, &low, &high);
        if (!programs_enter(p, &seed, &X))
            return;
        path_make(&way, X, p->edge, check_random_in(&seed, 0.45, 0.85) * (double)(high.z - low.z), &seed);
        while (last + 1 < way.count && is_inside(way.points[last + 1], low, high, p->edge) &&
               programs_step(p, way.points[last + 1], 0, last + 1 > 20))
            last++;
        if (i % 4 == 0) /* back a little and in again */
            for (int k = last - 1; k > last - 8 && k > 0; k--)
                if (!programs_step(p, way.points[k], 1, k > 20))
                    break;
        for (int k = last - 1; k > 0 && programs_step(p, way.points[k], 1, k > 20); k--)
            continue;
        CHECK_RESULT(ndl_tissue_mesh_check(&p->tissue, &error), SB_OK);
        programs_step(p, sb_v3(X.x, X.y, X.z + REAL(p->edge)), 1, 0);
        CHECK(ndl_remesh_nodes(p->remesh, 0, NULL) == NULL);
        CHECK(ndl_tissue_mesh_is_original(&p->tissue));
    }
    CHECK(memcmp(p->tissue.tets, p->mesh.elements, 4 * (size_t)p->mesh.element_count * sizeof(int)) == 0);
    CHECK(memcmp(p->tissue.X, p->mesh.nodes, (size_t)p->mesh.node_count * sizeof(sb_vec3)) == 0);
    CHECK_INT(p->failures, 0);
    CHECK(p->drift <= scene_tolerance(1e-12, 1000));
}

/* The bars: 0.7 of the initial quality, 10.3 to 160 degrees, once the tip is twenty steps deep. */
static void check_programs(sb_mesh mesh, double edge, int count, double ratio)
{
    programs p;
    if (mesh.element_count && programs_begin(&p, mesh, edge)) {
        programs_run(&p, check_quick() ? 2 : count, 11);
        CHECK(p.worst >= ratio * p.first_quality);
        CHECK(p.low >= 10.3);
        CHECK(p.high <= 160);
        if (getenv("REMESH_FIGURES"))
            printf("%d tets, quality %.3f, deep %.3f (%.2f), ever %.3f, angles of changed tets %.1f to %.1f, drift %.1e, "
                   "%d operations, %.2f nodes smoothed in each\n",
                   mesh.element_count, p.first_quality, p.worst, p.worst / p.first_quality, p.worst_at_all, p.low, p.high,
                   p.drift, p.operations, (double)p.smoothed / p.operations);
        programs_end(&p);
    }
}

static void test_lattice(void)
{
    sb_mesh mesh = block_mesh(7, 7, 6, 0.01, 0);
    check_programs(mesh, 0.01, 60, 0.6);
    sb_mesh_free(&mesh);
}

static void test_shaken(void)
{
    sb_mesh mesh = block_mesh(7, 7, 6, 0.01, 0.12);
    check_programs(mesh, 0.01, 50, 0.7);
    sb_mesh_free(&mesh);
}

static void test_beam(void)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_beam(SB_TET4, 8, 8, 7, sb_v3(REAL(0.08), REAL(0.08), REAL(0.07)), NULL, &mesh, NULL));
    check_programs(mesh, 0.01, 40, 0.45);
    sb_mesh_free(&mesh);
}

static void test_stuffed(void)
{
    sb_mesh mesh = stuffed_mesh(1);
    check_programs(mesh, 0.008, 50, 0.7);
    sb_mesh_free(&mesh);
}

static void test_two_regions(void)
{
    sb_mesh mesh = stuffed_mesh(2);
    check_programs(mesh, 0.008, 40, 0.7);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(remesh, {"programs in a lattice", test_lattice}, {"programs in a shaken lattice", test_shaken},
            {"programs in a beam", test_beam}, {"programs in a stuffed block", test_stuffed},
            {"programs in two regions", test_two_regions});
