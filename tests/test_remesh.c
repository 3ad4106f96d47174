/* remesh: random insertions and retractions, what they keep, and what they refuse. */
#include "needle_scene.h"

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
    sb_shape shape[2];
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

/* ---- a body under watch ---- */

static const double remesh_densities[3] = {1000, 1300, 1100}; /* kg/m^3 of the first three regions */

/* Corotated. */
static sb_body *remesh_body(const sb_mesh *mesh, double slack, const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material regions[3];
    sb_body *body = NULL;
    def.mesh = mesh;
    def.slack = REAL(slack);
    def.material = sb_material_corotated(50000, REAL(0.3), REAL(remesh_densities[0]));
    def.region_materials = regions;
    for (int r = 1; r < 3 && mesh->regions; r++) {
        int found = 0;
        for (int e = 0; e < mesh->element_count && !found; e++)
            found = mesh->regions[e] == r;
        if (!found)
            continue;
        regions[def.region_material_count].region = r;
        regions[def.region_material_count++].material =
            sb_material_corotated(50000, REAL(0.3), REAL(remesh_densities[r]));
    }
    if (allocator)
        def.allocator = *allocator;
    return sb_body_create(&def, &body, NULL) == SB_OK ? body : NULL;
}

/* The mesh as it follows from the reports of changes alone, and what these say about quality. */
typedef struct watch {
    sb_body *body;
    int *tets; /* [4 capacity]; [4 t] < 0: none */
    int capacity, faults;
    int *changed, changed_count; /* tets since the last look */
} watch;

static void watch_tet(watch *w, int tet) { w->changed[w->changed_count++ % w->capacity] = tet; }

static int watch_weights(const int *start, const sb_real *weights, int count)
{
    int faults = 0;
    for (int i = 0; start && i < count; i++) {
        double sum = 0;
        for (int k = start[i]; k < start[i + 1]; k++)
            sum += (double)weights[k];
        faults += start[i] < start[i + 1] && !(fabs(sum - 1) < scene_tolerance(1e-12, 64));
    }
    return faults;
}

static void watch_change(void *user, const sb_body *body, const sb_mesh_change *change)
{
    watch *w = (watch *)user;
    (void)body;
    if (!change || change->cell_end > w->capacity) {
        w->faults++;
        return;
    }
    for (int i = 0; i < change->removed_cell_count; i++) {
        int *tet = w->tets + 4 * (size_t)change->removed_cells[i];
        w->faults += tet[0] < 0 || memcmp(tet, change->removed_cell_nodes + 4 * (size_t)i, 4 * sizeof *tet) != 0;
        tet[0] = -1;
    }
    for (int i = 0; i < change->made_cell_count; i++) {
        int *tet = w->tets + 4 * (size_t)change->made_cells[i];
        w->faults += tet[0] >= 0;
        memcpy(tet, change->made_cell_nodes + 4 * (size_t)i, 4 * sizeof *tet);
        watch_tet(w, change->made_cells[i]);
    }
    for (int i = 0; i < change->reshaped_cell_count; i++) {
        w->faults += w->tets[4 * (size_t)change->reshaped_cells[i]] < 0;
        watch_tet(w, change->reshaped_cells[i]);
    }
    w->faults += watch_weights(change->source_start, change->source_weights, change->made_node_count);
    w->faults += watch_weights(change->moved_start, change->moved_weights, change->moved_node_count);
}

static void watch_begin(watch *w, sb_body *body)
{
    sb_body_listener listener;
    int cells = sb_body_element_count(body);
    memset(&listener, 0, sizeof listener);
    listener.user = w;
    listener.follow = watch_change;
    w->body = body;
    w->capacity = 2 * cells;
    w->faults = w->changed_count = 0;
    w->tets = (int *)malloc(4 * (size_t)w->capacity * sizeof(int));
    w->changed = (int *)malloc((size_t)w->capacity * sizeof(int));
    memset(w->tets, -1, 4 * (size_t)w->capacity * sizeof(int));
    for (int t = 0; t < cells; t++)
        memcpy(w->tets + 4 * (size_t)t, sb_body_cell_nodes(body, t), 4 * sizeof(int));
    CHECK_OK(sb_body_listen(body, &listener, NULL, NULL));
}

static void watch_end(watch *w)
{
    CHECK_INT(w->faults, 0);
    for (int t = 0; t < sb_body_element_count(w->body); t++) {
        const int *tet = sb_body_cell_nodes(w->body, t);
        if (!tet ? w->tets[4 * t] >= 0 : memcmp(w->tets + 4 * t, tet, 4 * sizeof(int)) != 0) {
            CHECK_INT(t, -1);
            break;
        }
    }
    free(w->tets);
    free(w->changed);
}

/* Extreme dihedral angles (degrees) of a tet, in double. */
static void tet_angles(const sb_body *body, int tet, double *low, double *high)
{
    double p[4][3], normal[4][3];
    static const int face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
    for (int c = 0; c < 4; c++) {
        sb_vec3 X = sb_body_rest_positions(body)[sb_body_cell_nodes(body, tet)[c]];
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
            double angle =
                57.29577951308232 *
                acos(-(normal[f][0] * normal[g][0] + normal[f][1] * normal[g][1] + normal[f][2] * normal[g][2]));
            *low = angle < *low ? angle : *low;
            *high = angle > *high ? angle : *high;
        }
}

/* Volume (m^3) of the cells at rest. */
/* Volume, and by the densities of the regions, mass. */
typedef struct amount {
    double volume, mass;
} amount;

static amount body_amount(const sb_body *body)
{
    amount sum = {0, 0};
    sb_mesh mesh;
    if (!CHECK_OK(sb_body_get_mesh(body, NULL, &mesh, NULL, NULL, NULL)))
        return sum;
    for (int t = 0; t < mesh.element_count; t++) {
        const int *n = mesh.elements + 4 * (size_t)t;
        sb_vec3 a = mesh.nodes[n[0]], ab = sb_v3_sub(mesh.nodes[n[1]], a), ac = sb_v3_sub(mesh.nodes[n[2]], a);
        double volume = (double)sb_v3_dot(ab, sb_v3_cross(ac, sb_v3_sub(mesh.nodes[n[3]], a))) / 6;
        sum.volume += volume;
        sum.mass += volume * remesh_densities[mesh.regions ? mesh.regions[t] : 0];
    }
    sb_mesh_free(&mesh);
    return sum;
}

/* How many of the edges of a path have a cell. */
static int count_joined(const sb_body *body, const int *path, int count)
{
    int *place = (int *)calloc((size_t)sb_body_node_count(body), sizeof *place), joined = 0; /* on the path, from 1 */
    unsigned char *seen = (unsigned char *)calloc((size_t)count + 1, 1);
    for (int i = 0; i < count; i++)
        place[path[i]] = i + 1;
    for (int t = 0; t < sb_body_element_count(body); t++) {
        const int *n = sb_body_cell_nodes(body, t);
        for (int a = 0; n && a < 4; a++)
            for (int b = 0; place[n[a]] && b < 4; b++)
                if (place[n[b]] == place[n[a]] + 1)
                    seen[place[n[a]]] = 1;
    }
    for (int i = 1; i < count; i++)
        joined += seen[i];
    free(place);
    free(seen);
    return joined;
}

static int is_sound(const sb_body *body, const ndl_remesh *remesh)
{
    sb_error error;
    if (sb_body_live_check(body, &error) == SB_OK && ndl_remesh_check(remesh, &error) == SB_OK)
        return 1;
    printf("%s\n", error.message);
    return 0;
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
    sb_body *body;
    ndl_remesh *remesh;
    sb_mesh mesh;
    double edge, worst, low, high; /* figures while the tip is more than twenty steps deep */
    double worst_at_all, drift;
    double first_volume, first_quality;
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
    p->body = remesh_body(&mesh, 0.1, NULL);
    if (!CHECK(p->body != NULL))
        return 0;
    def.body = p->body;
    watch_begin(&p->eye, p->body);
    p->first_volume = body_amount(p->body).volume;
    if (!CHECK_OK(ndl_remesh_create(&def, &p->remesh, NULL)))
        return 0;
    ndl_remesh_quality(p->remesh, &quality, NULL, NULL);
    p->first_quality = (double)quality;
    return 1;
}

static void programs_end(programs *p)
{
    ndl_remesh_destroy(p->remesh);
    watch_end(&p->eye);
    sb_body_destroy(p->body);
}

/* What must hold after each step; `deep` when the figures of quality count. */
static void programs_look(programs *p, sb_vec3 X, int deep)
{
    int count;
    const int *nodes = ndl_remesh_nodes(p->remesh, 0, &count);
    sb_real worst;
    amount now = body_amount(p->body);
    double volume = now.volume / p->first_volume - 1;
    double mass =
        (double)sb_body_mass(p->body) / now.mass - 1; /* of several densities it goes with the regions' volumes */
    p->drift = fmax(p->drift, fmax(fabs(volume), fabs(mass)));
    ndl_remesh_quality(p->remesh, &worst, NULL, NULL);
    p->worst_at_all = fmin(p->worst_at_all, (double)worst);
    CHECK(worst > 0);
    if (CHECK(count > 0))
        CHECK(sb_v3_norm(sb_v3_sub(sb_body_rest_positions(p->body)[nodes[count - 1]], X)) <= REAL(p->edge * 1e-6));
    CHECK_INT(count_joined(p->body, nodes, count), count - 1);
    if (!deep)
        return;
    p->worst = fmin(p->worst, (double)worst);
    for (int i = 0; i < p->eye.changed_count && i < p->eye.capacity; i++)
        if (sb_body_cell_in_use(p->body, p->eye.changed[i]))
            tet_angles(p->body, p->eye.changed[i], &p->low, &p->high);
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
    if (!CHECK(ndl_remesh_hit(p->remesh, from, to, &hit)) ||
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
        CHECK(is_sound(p->body, p->remesh));
        programs_step(p, sb_v3(X.x, X.y, X.z + REAL(p->edge)), 1, 0);
        CHECK(ndl_remesh_nodes(p->remesh, 0, NULL) == NULL);
        CHECK(ndl_remesh_is_original(p->remesh));
    }
    CHECK(needle_scene_is_mesh_of(p->body, &p->mesh));
    CHECK_INT(p->failures, 0);
    CHECK(p->drift <= scene_tolerance(1e-12, 1000));
}

/* The bars: 0.7 of the initial quality, 10.3 to 160 degrees, once the tip is twenty steps deep. A lattice without a
 * flaw (and the beam of right-angled tets) has nothing to lose: there 0.7 is not reached in all programs. */
static void check_programs(sb_mesh mesh, double edge, int count, double ratio)
{
    programs p;
    if (mesh.element_count && programs_begin(&p, mesh, edge)) {
        programs_run(&p, check_quick() ? 2 : count, 11);
        CHECK(p.worst >= ratio * p.first_quality);
        CHECK(p.low >= 10.3);
        CHECK(p.high <= 160);
        if (getenv("REMESH_FIGURES"))
            printf("%d tets, quality %.3f, deep %.3f (%.2f), ever %.3f, angles of changed tets %.1f to %.1f, "
                   "drift %.1e, "
                   "%d operations, %.2f nodes smoothed in each\n",
                   mesh.element_count, p.first_quality, p.worst, p.worst / p.first_quality, p.worst_at_all, p.low,
                   p.high, p.drift, p.operations, (double)p.smoothed / p.operations);
        programs_end(&p);
    }
}

static void test_lattice(void)
{
    sb_mesh mesh = block_mesh(7, 7, 6, 0.01, 0);
    check_programs(mesh, 0.01, 40, 0.55);
    sb_mesh_free(&mesh);
}

static void test_shaken(void)
{
    sb_mesh mesh = block_mesh(7, 7, 6, 0.01, 0.12);
    check_programs(mesh, 0.01, 40, 0.7);
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
    check_programs(mesh, 0.008, 40, 0.7);
    sb_mesh_free(&mesh);
}

static void test_two_regions(void)
{
    sb_mesh mesh = stuffed_mesh(2);
    check_programs(mesh, 0.008, 40, 0.7);
    sb_mesh_free(&mesh);
}

/* A conforming mesh of two regions with a sliver of quality 0.1 to start from: its angles are not the bars'. */
static void test_phantom(void)
{
    char name[512];
    sb_mesh mesh;
    programs p;
    memset(&mesh, 0, sizeof mesh);
    if (!check_shared_path(name, sizeof name, "data/phantom/phantom_tet4.vtk")) {
        CHECK_SKIP("no data/phantom/phantom_tet4.vtk");
        return;
    }
    if (CHECK_OK(sb_mesh_load(&mesh, name, NULL, NULL)) && programs_begin(&p, mesh, 0.008)) {
        programs_run(&p, check_quick() ? 2 : 10, 17);
        CHECK(p.worst >= 0.7 * p.first_quality);
        programs_end(&p);
    }
    sb_mesh_free(&mesh);
}

/* ---- single properties ---- */

typedef struct scene {
    sb_mesh mesh;
    sb_body *body;
    ndl_remesh *remesh;
} scene;

static int scene_begin(scene *s, double scale, const sb_allocator *allocator, double slack)
{
    ndl_remesh_def def = ndl_default_remesh_def();
    memset(s, 0, sizeof *s);
    s->mesh = block_mesh(6, 5, 5, 0.01 * scale, 0.05);
    s->body = remesh_body(&s->mesh, slack, allocator);
    if (!CHECK(s->body != NULL))
        return 0;
    def.body = s->body;
    if (allocator)
        def.allocator = *allocator;
    return CHECK_OK(ndl_remesh_create(&def, &s->remesh, NULL));
}

static void scene_end(scene *s)
{
    ndl_remesh_destroy(s->remesh);
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
}

static int enter_at(scene *s, int needle, double x, double y, ndl_remesh_info *info)
{
    ndl_surface_hit hit;
    sb_vec3 low, high;
    sb_mesh_bounds(&s->mesh, &low, &high);
    if (!CHECK(ndl_remesh_hit(s->remesh, sb_v3(REAL(x) * high.x, REAL(y) * high.y, 2 * high.z),
                              sb_v3(REAL(x) * high.x, REAL(y) * high.y, 0), &hit)))
        return 0;
    return CHECK_OK(ndl_remesh_puncture(s->remesh, needle, &hit, info, NULL));
}

/* The tip goes down by `steps` of 1/10 of a cell. */
static sb_result go_down(scene *s, int needle, int steps, double cell, ndl_remesh_info *info)
{
    sb_result result = SB_OK;
    for (int i = 0; result == SB_OK && i < steps; i++) {
        int count;
        const int *nodes = ndl_remesh_nodes(s->remesh, needle, &count);
        sb_vec3 X = sb_body_rest_positions(s->body)[nodes[count - 1]];
        X = sb_v3(X.x + REAL(0.01 * cell), X.y, X.z - REAL(0.1 * cell));
        result = ndl_remesh_penetrate(s->remesh, needle, X, info, NULL);
    }
    return result;
}

static sb_vec3 linear_field(sb_vec3 X)
{
    return sb_v3(REAL(0.1) * X.x + REAL(0.3) * X.y, REAL(-0.2) * X.z, REAL(0.1) * X.x);
}

/* Linear fields are interpolated exactly, so they stay linear through any number of operations. */
static void test_linear_fields(void)
{
    scene s;
    double largest = 0;
    if (scene_begin(&s, 1, NULL, 0.1)) {
        sb_vec3 *u = (sb_vec3 *)malloc((size_t)s.mesh.node_count * sizeof *u);
        for (int n = 0; n < s.mesh.node_count; n++)
            u[n] = linear_field(s.mesh.nodes[n]);
        CHECK_OK(sb_body_set_displacements(s.body, u));
        free(u);
        if (enter_at(&s, 0, 0.52, 0.47, NULL))
            CHECK_OK(go_down(&s, 0, 30, 0.01, NULL));
        CHECK(!ndl_remesh_is_original(s.remesh));
        for (int n = 0; n < sb_body_node_count(s.body); n++) {
            sb_vec3 X = sb_body_rest_positions(s.body)[n], x = sb_v3_add(X, linear_field(X));
            if (sb_body_node_in_use(s.body, n))
                largest = fmax(largest, (double)sb_v3_norm(sb_v3_sub(sb_body_positions(s.body)[n], x)));
        }
        CHECK_NEAR(largest, 0, scene_tolerance(1e-15, 4));
    }
    scene_end(&s);
}

static void test_momentum(void)
{
    scene s;
    unsigned long long seed = 3;
    if (scene_begin(&s, 1, NULL, 0.1)) {
        sb_vec3 before, *v = (sb_vec3 *)malloc((size_t)s.mesh.node_count * sizeof *v);
        double size = (double)sb_body_mass(s.body);
        for (int n = 0; n < s.mesh.node_count; n++)
            v[n] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                         REAL(check_random_in(&seed, -1, 1)));
        CHECK_OK(sb_body_set_velocities(s.body, v));
        free(v);
        before = sb_body_momentum(s.body);
        if (enter_at(&s, 0, 0.45, 0.6, NULL))
            CHECK_OK(go_down(&s, 0, 28, 0.01, NULL));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_momentum(s.body), before)), 0, size * scene_tolerance(1e-14, 50));
        CHECK_OK(ndl_remesh_withdraw(s.remesh, 0, NULL, NULL));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_momentum(s.body), before)), 0, size * scene_tolerance(1e-14, 50));
    }
    scene_end(&s);
}

/* V - E + F - T is that of a ball after every operation. */
static void test_euler(void)
{
    scene s;
    if (scene_begin(&s, 1, NULL, 0.1) && enter_at(&s, 0, 0.41, 0.52, NULL))
        for (int step = 0; step < 25; step++) {
            sb_mesh mesh;
            sb_index_table edges;
            sb_boundary skin;
            CHECK_OK(go_down(&s, 0, 1, 0.01, NULL));
            if (!CHECK_OK(sb_body_get_mesh(s.body, NULL, &mesh, NULL, NULL, NULL)))
                break;
            if (CHECK_OK(sb_mesh_edges(&mesh, NULL, &edges, NULL))) {
                if (CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &skin, NULL))) {
                    int faces = (4 * mesh.element_count + skin.surface.element_count) / 2;
                    CHECK_INT(mesh.node_count - edges.rows + faces - mesh.element_count, 1);
                    sb_boundary_free(&skin);
                }
                sb_index_table_free(&edges);
            }
            sb_mesh_free(&mesh);
            CHECK(is_sound(s.body, s.remesh));
        }
    scene_end(&s);
}

static unsigned long long cells_hash(const sb_body *body)
{
    unsigned long long hash = 1;
    for (int t = 0; t < sb_body_element_count(body); t++) {
        const int *n = sb_body_cell_nodes(body, t);
        hash = 31 * hash + (n ? scene_hash(n, 4 * sizeof *n) : 7);
    }
    return hash;
}

/* Powers of two scale every number exactly: the same operations happen. */
static void test_scale(void)
{
    static const double scales[3] = {0.0009765625, 1, 1024};
    unsigned long long hash[3] = {0, 0, 0};
    for (int i = 0; i < 3; i++) {
        scene s;
        if (scene_begin(&s, scales[i], NULL, 0.1) && enter_at(&s, 0, 0.53, 0.44, NULL)) {
            CHECK_OK(go_down(&s, 0, 30, 0.01 * scales[i], NULL));
            hash[i] = cells_hash(s.body);
        }
        scene_end(&s);
    }
    CHECK(hash[0] == hash[1] && hash[1] == hash[2]);
}

/* Where a point is in the material, looked for from the tip, wherever that is. */
static void test_find(void)
{
    scene s;
    unsigned long long seed = 9;
    if (scene_begin(&s, 1, NULL, 0.1)) {
        sb_vec3 found = sb_v3(1, 2, 3);
        CHECK_INT(ndl_remesh_material_point(s.remesh, 0, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), &found),
                  0); /* not in */
        CHECK(found.x == 1 && found.y == 2 && found.z == 3);
        for (int i = 0; i < 200 && (i > 0 || enter_at(&s, 0, 0.45, 0.55, NULL)); i++) {
            sb_vec3 X = sb_v3(REAL(check_random_in(&seed, -0.005, 0.065)), REAL(check_random_in(&seed, 0, 0.05)),
                              REAL(check_random_in(&seed, 0, 0.05)));
            int is_in = ndl_remesh_material_point(s.remesh, 0, X, &found);
            if (i % 8 == 0)
                CHECK_OK(go_down(&s, 0, 1, 0.01, NULL));
            if (X.x < 0 || X.x > REAL(0.06)) {
                CHECK_INT(is_in, 0);
                continue;
            }
            CHECK_INT(is_in, 1);
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(found, X)), 0, scene_tolerance(1e-15, 8));
        }
        CHECK_INT(ndl_remesh_material_point(s.remesh, -1, sb_v3(0, 0, 0), &found), 0);
        CHECK_INT(ndl_remesh_material_point(s.remesh, 0, sb_v3(0, 0, 0), NULL), 0);
    }
    scene_end(&s);
}

/* A skin that is pushed in before it breaks: the node of the entry lies below tets that it is a corner of. Points of
 * all others, which have kept their shape, are where they were. */
static void test_find_folded(void)
{
    scene s;
    unsigned long long seed = 11;
    if (scene_begin(&s, 1, NULL, 0.1) && enter_at(&s, 0, 0.52, 0.47, NULL)) {
        int entry = ndl_remesh_nodes(s.remesh, 0, NULL)[0], count = sb_body_node_count(s.body), kept = 0;
        const sb_vec3 *X = sb_body_rest_positions(s.body);
        sb_vec3 *u = (sb_vec3 *)calloc((size_t)count, sizeof *u);
        u[entry] = sb_v3(REAL(0.0005), REAL(0.001), REAL(-0.012));
        CHECK_OK(sb_body_set_displacements(s.body, u));
        for (int i = 0; i < 1000; i++) {
            int t = (int)check_random_in(&seed, 0, sb_body_element_count(s.body));
            const int *n = sb_body_cell_nodes(s.body, t);
            sb_real w[4], sum = 0;
            sb_vec3 x = sb_v3(0, 0, 0), found = x;
            int moved = n == NULL;
            for (int c = 0; c < 4; c++)
                sum += w[c] = REAL(check_random_in(&seed, 0.05, 1));
            for (int c = 0; c < 4 && n; c++) {
                moved |= n[c] == entry;
                x = sb_v3_madd(x, w[c] / sum, X[n[c]]);
            }
            if (moved)
                continue;
            kept++;
            CHECK_INT(ndl_remesh_material_point(s.remesh, 0, x, &found), 1);
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(found, x)), 0, scene_tolerance(1e-15, 8));
        }
        CHECK(kept > 500);
        free(u);
    }
    scene_end(&s);
}

static void test_limit(void)
{
    scene s;
    ndl_remesh_info info;
    memset(&info, 0, sizeof info);
    if (scene_begin(&s, 1, NULL, 0.1) && enter_at(&s, 0, 0.55, 0.45, &info)) {
        sb_vec3 X = sb_v3_add(info.X, sb_v3(REAL(0.002), 0, REAL(-0.03)));
        CHECK(ndl_remesh_limit(s.remesh, 0) > 0);
        CHECK_OK(ndl_remesh_penetrate(s.remesh, 0, X, &info, NULL)); /* three cells at once */
        CHECK(info.substeps > 3);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(info.X, X)), 0, 1e-9);
        CHECK(is_sound(s.body, s.remesh));
        CHECK_INT((long long)(ndl_remesh_limit(s.remesh, 1) > 0), 0);
    }
    scene_end(&s);
}

/* ---- several needles ---- */

static void test_two_needles(void)
{
    scene s;
    if (scene_begin(&s, 1, NULL, 0.1) && enter_at(&s, 0, 0.22, 0.5, NULL) && enter_at(&s, 2, 0.78, 0.5, NULL)) {
        for (int i = 0; i < 24; i++) {
            CHECK_OK(go_down(&s, 0, 1, 0.01, NULL));
            CHECK_OK(go_down(&s, 2, 1, 0.01, NULL));
        }
        CHECK_OK(ndl_remesh_withdraw(s.remesh, 0, NULL, NULL)); /* first in, first out */
        CHECK(is_sound(s.body, s.remesh));
        CHECK(ndl_remesh_nodes(s.remesh, 2, NULL) != NULL);
        CHECK(!ndl_remesh_is_original(s.remesh));
        CHECK_OK(go_down(&s, 2, 4, 0.01, NULL));
        CHECK_OK(ndl_remesh_withdraw(s.remesh, 2, NULL, NULL));
        CHECK(ndl_remesh_is_original(s.remesh));
    }
    scene_end(&s);
}

static unsigned long long state_hash(const sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    return cells_hash(body) ^ scene_hash(sb_body_rest_positions(body), bytes) ^
           scene_hash(sb_body_positions(body), bytes) ^ scene_hash(sb_body_velocities(body), bytes) ^
           (unsigned long long)sb_body_state_hash(body);
}

/* A needle that comes too near another is refused, and nothing has changed. */
static void test_shared_element(void)
{
    scene s;
    sb_error error;
    if (scene_begin(&s, 1, NULL, 0.1) && enter_at(&s, 0, 0.5, 0.5, NULL)) {
        sb_result result = SB_OK;
        CHECK_OK(go_down(&s, 0, 25, 0.01, NULL));
        if (enter_at(&s, 1, 0.85, 0.5, NULL))
            for (int i = 0; result == SB_OK && i < 60; i++) {
                int count;
                unsigned long long hash = state_hash(s.body);
                const int *nodes = ndl_remesh_nodes(s.remesh, 1, &count);
                sb_vec3 X = sb_body_rest_positions(s.body)[nodes[count - 1]];
                ndl_remesh_info info;
                X = sb_v3(X.x - REAL(0.0006), X.y, X.z - REAL(0.0005));
                result = ndl_remesh_penetrate(s.remesh, 1, X, &info, &error);
                if (result != SB_OK && info.substeps == 0)
                    CHECK(state_hash(s.body) == hash);
            }
        CHECK_RESULT(result, SB_ERROR_UNSUPPORTED);
        CHECK(strstr(error.message, "needle 0") != NULL);
        CHECK(is_sound(s.body, s.remesh));
        CHECK_OK(ndl_remesh_withdraw(s.remesh, 1, NULL, NULL));
        CHECK_OK(ndl_remesh_withdraw(s.remesh, 0, NULL, NULL));
        CHECK(ndl_remesh_is_original(s.remesh));
    }
    scene_end(&s);
}

/* ---- outside, arguments, memory ---- */

static void test_outside(void)
{
    scene s;
    ndl_remesh_info info;
    memset(&info, 0, sizeof info);
    if (scene_begin(&s, 1, NULL, 0.1) && enter_at(&s, 0, 0.55, 0.45, &info)) {
        sb_vec3 entry = info.X, X;
        unsigned long long hash;
        CHECK_OK(go_down(&s, 0, 45, 0.01, &info));
        hash = state_hash(s.body);
        CHECK_OK(ndl_remesh_penetrate(s.remesh, 0, sb_v3(info.X.x, info.X.y, REAL(-0.001)), &info, NULL));
        CHECK_INT(info.outside, 1); /* out at the bottom: the tip waits before the skin */
        if (info.substeps == 0)
            CHECK(state_hash(s.body) == hash);
        CHECK(is_sound(s.body, s.remesh));
        X = sb_v3(0, 0, 0);
        CHECK_INT(ndl_remesh_material_point(s.remesh, 0, info.X, &X), 1);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(X, info.X)), 0, scene_tolerance(1e-15, 16));
        CHECK_INT(ndl_remesh_material_point(s.remesh, 0, sb_v3(REAL(0.03), REAL(0.03), 1), &X), 0);
        CHECK_OK(ndl_remesh_retract(s.remesh, 0, sb_v3(entry.x, entry.y, entry.z + REAL(0.002)), &info, NULL));
        CHECK_INT(info.outside, 1);
        CHECK(ndl_remesh_nodes(s.remesh, 0, NULL) == NULL);
        CHECK(ndl_remesh_is_original(s.remesh));
    }
    scene_end(&s);
}

/* Only tet4. */
static void check_element(sb_element_type type)
{
    ndl_remesh_def def = ndl_default_remesh_def();
    ndl_remesh *remesh = NULL;
    sb_mesh mesh = scene_box(type, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_error error;
    def.body = remesh_body(&mesh, 0.1, NULL);
    if (CHECK(def.body != NULL)) {
        CHECK_RESULT(ndl_remesh_create(&def, &remesh, &error), SB_ERROR_UNSUPPORTED);
        CHECK(remesh == NULL && strstr(error.message, "SB_TET4") != NULL);
    }
    sb_body_destroy(def.body);
    sb_mesh_free(&mesh);
}

static void test_arguments(void)
{
    scene s;
    ndl_remesh_def def = ndl_default_remesh_def();
    ndl_remesh *other = NULL;
    ndl_surface_hit hit;
    sb_body *fixed;
    memset(&hit, 0, sizeof hit);
    if (!scene_begin(&s, 1, NULL, 0.1))
        return;
    CHECK_RESULT(ndl_remesh_create(NULL, &other, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_remesh_create(&def, &other, NULL), SB_ERROR_ARGUMENT);
    fixed = remesh_body(&s.mesh, 0, NULL);
    def.body = fixed;
    CHECK_RESULT(ndl_remesh_create(&def, &other, NULL), SB_ERROR_UNSUPPORTED); /* no slack */
    sb_body_destroy(fixed);
    check_element(SB_HEX8);
    check_element(SB_TET10);
    def.body = s.body;
    CHECK_RESULT(ndl_remesh_create(&def, NULL, NULL), SB_ERROR_ARGUMENT);
    def.max_needles = 0;
    CHECK_RESULT(ndl_remesh_create(&def, &other, NULL), SB_ERROR_ARGUMENT);
    def.max_needles = 1;
    def.smooth_below = REAL(1.5);
    CHECK_RESULT(ndl_remesh_create(&def, &other, NULL), SB_ERROR_ARGUMENT);
    CHECK(other == NULL);
    hit.tet = sb_body_element_count(s.body);
    CHECK_RESULT(ndl_remesh_puncture(s.remesh, 0, &hit, NULL, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_remesh_puncture(s.remesh, 4, &hit, NULL, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_remesh_puncture(s.remesh, 0, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_remesh_puncture(NULL, 0, &hit, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_remesh_penetrate(s.remesh, 0, sb_v3(0, 0, 0), NULL, NULL), SB_ERROR_ARGUMENT); /* not in */
    CHECK_RESULT(ndl_remesh_retract(s.remesh, -1, sb_v3(0, 0, 0), NULL, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_remesh_reserve(s.remesh, 4, 10, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_remesh_reserve(s.remesh, 0, -1, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_remesh_reserve(s.remesh, 0, 2147483647, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_remesh_reserve(NULL, 0, 10, NULL), SB_ERROR_ARGUMENT);
    CHECK_OK(ndl_remesh_withdraw(s.remesh, 0, NULL, NULL));
    check_bad_numbers();
    if (enter_at(&s, 0, 0.5, 0.5, NULL)) {
        sb_real zero = 0;
        CHECK_RESULT(ndl_remesh_penetrate(s.remesh, 0, sb_v3(zero / zero, 0, 0), NULL, NULL), SB_ERROR_NOT_FINITE);
        hit.tet = 0;
        CHECK_RESULT(ndl_remesh_puncture(s.remesh, 0, &hit, NULL, NULL), SB_ERROR_ARGUMENT); /* already in */
    }
    ndl_remesh_destroy(NULL);
    scene_end(&s);
}

/* A program in which allocation number fail_at fails; what it met is tried again and must work. Returns whether one
 * failed. */
static int play_with_failure(int fail_at, scene_memory *memory)
{
    sb_allocator allocator = scene_allocator(memory);
    sb_mesh mesh = block_mesh(3, 3, 3, 0.01, 0);
    ndl_remesh_def def = ndl_default_remesh_def();
    sb_body *body;
    ndl_remesh *remesh = NULL;
    ndl_surface_hit hit;
    memset(memory, 0, sizeof *memory);
    memory->fail_at = fail_at;
    body = remesh_body(&mesh, 0.001, &allocator);
    if (!body)
        body = remesh_body(&mesh, 0.001, &allocator);
    def.body = body;
    def.allocator = allocator;
    if (ndl_remesh_create(&def, &remesh, NULL) != SB_OK)
        CHECK_OK(ndl_remesh_create(&def, &remesh, NULL));
    if (CHECK(body && remesh &&
              ndl_remesh_hit(remesh, sb_v3(REAL(0.016), REAL(0.014), 1), sb_v3(REAL(0.016), REAL(0.014), 0), &hit)))
        for (int i = 0; i < 20; i++) {
            unsigned long long hash = state_hash(body);
            sb_vec3 X = sb_v3_add(hit.X, sb_v3(0, REAL(0.0001 * i), REAL(-0.001 * i)));
            ndl_remesh_info info;
            sb_result result =
                i ? ndl_remesh_penetrate(remesh, 0, X, &info, NULL) : ndl_remesh_puncture(remesh, 0, &hit, &info, NULL);
            if (result == SB_OK)
                continue;
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(info.substeps || state_hash(body) == hash);
            CHECK_OK(ndl_remesh_check(remesh, NULL)); /* sb_body_live_check would ask the allocator */
            CHECK_OK(i ? ndl_remesh_penetrate(remesh, 0, X, &info, NULL)
                       : ndl_remesh_puncture(remesh, 0, &hit, &info, NULL));
        }
    CHECK_OK(ndl_remesh_withdraw(remesh, 0, NULL, NULL));
    CHECK(ndl_remesh_is_original(remesh) && needle_scene_is_mesh_of(body, &mesh));
    ndl_remesh_destroy(remesh);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    CHECK_INT(memory->live, 0);
    return memory->calls >= fail_at;
}

static void test_memory(void)
{
    scene_memory memory;
    int fail_at = 1;
    while (play_with_failure(fail_at, &memory) && fail_at < 2000)
        fail_at++;
    CHECK(fail_at > 8 && fail_at < 2000);
}

/* Once slack has grown, operations ask for nothing. */
static void test_no_allocation(void)
{
    scene_memory memory;
    sb_allocator allocator = scene_allocator(&memory);
    scene s;
    memset(&memory, 0, sizeof memory);
    if (scene_begin(&s, 1, &allocator, 0.2)) {
        int calls = 0;
        for (int cycle = 0; cycle < 3; cycle++) {
            if (enter_at(&s, 0, 0.55, 0.45, NULL))
                CHECK_OK(go_down(&s, 0, 30, 0.01, NULL));
            CHECK_OK(ndl_remesh_withdraw(s.remesh, 0, NULL, NULL));
            if (cycle)
                CHECK_INT(memory.calls, calls);
            calls = memory.calls;
        }
    }
    scene_end(&s);
    CHECK_INT(memory.live, 0);
}

CHECK_SUITE(remesh, {"programs in a lattice", test_lattice}, {"programs in a shaken lattice", test_shaken},
            {"programs in a beam", test_beam}, {"programs in a stuffed block", test_stuffed},
            {"programs in two regions", test_two_regions}, {"programs in the phantom", test_phantom},
            {"linear fields stay linear", test_linear_fields}, {"momentum is kept", test_momentum},
            {"Euler characteristic", test_euler}, {"same operations at any scale", test_scale},
            {"walk to a point", test_find}, {"points in folded tissue", test_find_folded}, {"substeps", test_limit},
            {"two needles", test_two_needles}, {"a shared element", test_shared_element},
            {"a tip outside", test_outside}, {"arguments", test_arguments}, {"allocations that fail", test_memory},
            {"no allocation once slack has grown", test_no_allocation});
