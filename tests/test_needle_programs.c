/* Random programs of insertion, turning, holding and drawing back, wholly through the step: the mesh stays sound and is
 * the original one afterwards. CHECK_SLOW=1: 200 programs on each mesh. */
#include "check.h"
#include "scene.h"

#include "needle.h"

#include "../examples/phantom.h"

enum { MOST_STEPS = 4000 };
static const double dt = 0.02;

/* What programs did to a mesh. */
typedef struct programs {
    sb_mesh mesh;
    ndl_friction frictions[3];
    sb_body *body;
    sb_vec3 low, high;
    sb_real quality;      /* of the untouched mesh, */
    double mass, volume;  /* kg, m^3 */
    double least_quality; /* of all, in shares of it */
    double angles[2];     /* degrees: least and most of all dihedral angles */
    double mass_change, volume_change;
    int entered; /* programs that brought the needle into the tissue */
    sb_error error;
} programs;

/* One region, 44 x 32 x 32 mm. */
static sb_real ellipsoid_distance(void *user, sb_vec3 x)
{
    const double a[3] = {0.044, 0.034, 0.032};
    double from[3], square = 0, slope = 0;
    (void)user;
    from[0] = (double)x.x, from[1] = (double)x.y, from[2] = (double)x.z;
    for (int c = 0; c < 3; c++) {
        square += from[c] * from[c] / (a[c] * a[c]);
        slope += from[c] * from[c] / (a[c] * a[c] * a[c] * a[c]);
    }
    return REAL(slope > 0 ? sqrt(square) * (sqrt(square) - 1) / sqrt(slope) : -a[2]);
}

static sb_result stuff(sb_real (*distance)(void *, sb_vec3), double half, double cell, sb_mesh *mesh, sb_error *error)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_shape shape;
    memset(&shape, 0, sizeof shape);
    shape.distance = distance;
    shape.max_slope = 1;
    shape.region = 1;
    def.shapes = &shape;
    def.shape_count = 1;
    def.low = sb_v3(REAL(-half), REAL(-half), REAL(-half));
    def.high = sb_v3(REAL(half), REAL(half), REAL(half));
    def.cell = REAL(cell);
    return sb_mesh_stuff(&def, mesh, NULL, error);
}

static double mesh_volume(const sb_body *body)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    double sum = 0;
    for (int t = 0; t < sb_body_element_count(body); t++) {
        const int *n = sb_body_cell_nodes(body, t);
        if (n)
            sum += (double)sb_v3_dot(sb_v3_sub(X[n[1]], X[n[0]]),
                                     sb_v3_cross(sb_v3_sub(X[n[2]], X[n[0]]), sb_v3_sub(X[n[3]], X[n[0]]))) /
                   6;
    }
    return sum;
}

static int has_region(const sb_mesh *mesh, int region)
{
    for (int e = 0; e < mesh->element_count; e++)
        if ((mesh->regions ? mesh->regions[e] : 0) == region)
            return 1;
    return 0;
}

/* The same numbers of nodes and cells, and each as it was. */
static int is_original(const programs *p)
{
    const sb_vec3 *X = sb_body_rest_positions(p->body);
    int same =
        sb_body_node_count(p->body) == p->mesh.node_count && sb_body_element_count(p->body) == p->mesh.element_count;
    for (int t = 0; t < p->mesh.element_count && same; t++)
        same = sb_body_cell_in_use(p->body, t) &&
               memcmp(sb_body_cell_nodes(p->body, t), p->mesh.elements + 4 * t, 4 * sizeof(int)) == 0;
    return same && memcmp(X, p->mesh.nodes, (size_t)p->mesh.node_count * sizeof *X) == 0;
}

static int make_body(programs *p)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material stiff;
    for (int i = 0; i < 3; i++) {
        static const ndl_friction friction = {20, 1, REAL(0.3), REAL(0.01), REAL(0.0005)};
        p->frictions[i] = friction;
    }
    p->frictions[2].cutting = REAL(0.6);
    stiff.region = 2;
    stiff.material = sb_material_corotated(REAL(6e4), REAL(0.45), 1000);
    def.mesh = &p->mesh;
    def.material = sb_material_corotated(REAL(2e4), REAL(0.45), 1000);
    def.region_materials = &stiff;
    def.region_material_count = has_region(&p->mesh, 2);
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = REAL(0.005);
    def.tolerance = REAL(1e-4);
    def.slack = REAL(0.2);
    if (!CHECK_OK(sb_body_create(&def, &p->body, &p->error)))
        return 0;
    sb_mesh_bounds(&p->mesh, &p->low, &p->high);
    for (int i = 0; i < p->mesh.node_count; i++)
        if (p->mesh.nodes[i].z < p->low.z + REAL(0.1) * (p->high.z - p->low.z))
            CHECK_OK(sb_body_fix_nodes(p->body, &i, 1, SB_XYZ));
    p->mass = (double)sb_body_mass(p->body);
    p->volume = mesh_volume(p->body);
    p->least_quality = 1e300;
    p->angles[0] = 180;
    return 1;
}

/* Qualities of the mesh that nothing has been done to. */
static int first_quality(programs *p, sb_real angles[2])
{
    ndl_remesh_def def = ndl_default_remesh_def();
    ndl_remesh *remesh = NULL;
    def.body = p->body;
    if (!CHECK_OK(ndl_remesh_create(&def, &remesh, &p->error)))
        return 0;
    ndl_remesh_quality(remesh, &p->quality, &angles[0], &angles[1]);
    ndl_remesh_destroy(remesh);
    return 1;
}

/* A needle of either kind above the middle of the mesh, nearly upright; most have a bevel. */
static ndl_needle *random_needle(programs *p, unsigned long long *seed)
{
    ndl_needle_def def = ndl_default_needle_def();
    ndl_needle *needle = NULL;
    double x = check_random_in(seed, 0.3, 0.7), y = check_random_in(seed, 0.3, 0.7);
    def.body = p->body;
    def.follow = NDL_REMESH;
    def.base = sb_v3(p->low.x + REAL(x) * (p->high.x - p->low.x), p->low.y + REAL(y) * (p->high.y - p->low.y),
                     p->high.z + REAL(0.04));
    def.direction.x = REAL(check_random_in(seed, -0.1, 0.1));
    def.direction.y = REAL(check_random_in(seed, -0.1, 0.1));
    def.direction.z = -1;
    def.length = REAL(0.038);
    def.frictions = p->frictions;
    def.friction_count = 3;
    def.bevel.curvature = check_random(seed) < 0.7 ? REAL(check_random_in(seed, 0, 12)) : 0;
    ndl_rod_section_preset(check_random(seed) < 0.5 ? NDL_STYLET_18G : NDL_NITINOL_083, &def.section);
    CHECK_OK(ndl_needle_create(&def, &needle, &p->error));
    return needle;
}

static int is_in(const ndl_needle *needle)
{
    return ndl_needle_entry(needle) < ndl_rod_node_count(ndl_needle_rod(needle));
}

static void look_at_mesh(programs *p, const ndl_needle *needle)
{
    sb_real quality = 0, least = 0, most = 180;
    ndl_remesh_quality(ndl_needle_remesh(needle), &quality, &least, &most);
    p->least_quality = fmin(p->least_quality, (double)(quality / p->quality));
    p->angles[0] = fmin(p->angles[0], (double)least);
    p->angles[1] = fmax(p->angles[1], (double)most);
    p->mass_change = fmax(p->mass_change, fabs((double)sb_body_mass(p->body) / p->mass - 1));
    p->volume_change = fmax(p->volume_change, fabs(mesh_volume(p->body) / p->volume - 1));
}

/* In to a random depth, now and then a little back on the way, and out again. */
static void run_program(programs *p, unsigned long long seed)
{
    enum { IN, BACK, OUT } phase = IN;
    double height = (double)(p->high.z - p->low.z), depth, speed, twist;
    ndl_needle *needle = random_needle(p, &seed);
    int steps_in = 0;
    if (!needle)
        return;
    depth = check_random_in(&seed, 0.3, 0.75) * height;
    speed = check_random_in(&seed, 0.005, 0.025);
    twist = check_random(&seed) < 0.5 ? 0 : check_random_in(&seed, -5, 5);
    for (int i = 0; i < MOST_STEPS && !(phase == OUT && !is_in(needle)); i++) {
        ndl_command command = {0, 0, {0, 0, 0}, {0, 0, 0}};
        command.insertion = REAL(phase == IN ? speed : phase == BACK ? -0.6 * speed : -1.5 * speed);
        command.twist = REAL(phase == IN ? twist : phase == OUT ? -twist : 0);
        if (!CHECK_OK(ndl_step(p->body, &needle, 1, REAL(dt), &command, NULL, &p->error))) {
            printf("step %d: %s\n", i, p->error.message);
            break;
        }
        if (phase == IN)
            phase = (double)ndl_needle_depth(needle) > depth || (double)ndl_needle_fed(needle) > 0.04 + depth ? OUT
                    : is_in(needle) && check_random(&seed) < 0.01                                             ? BACK
                                                                                                              : IN;
        else if (phase == BACK && (check_random(&seed) < 0.04 || !is_in(needle)))
            phase = IN;
        steps_in = is_in(needle) ? steps_in + 1 : 0;
        p->entered += steps_in == 20;
        if (steps_in > 20 && i % 2 == 0) /* the first ones may take a tet near the entry that was the worst before */
            look_at_mesh(p, needle);
    }
    CHECK(!is_in(needle));
    ndl_needle_destroy(needle);
    CHECK(is_original(p));
}

/* least_quality in shares of the untouched mesh's; least and most angle: those of 10.3 and 160 degrees, but for meshes
 * that begin with others. */
static void run_programs(programs *p, int first, int count)
{
    sb_real angles[2];
    if (make_body(p) && first_quality(p, angles)) {
        for (int i = 0; i < count; i++)
            run_program(p, 2654435761ULL * (unsigned long long)(first + i) + 12345);
        printf("%d programs, %d in: quality %.3f of the first, angles %.1f to %.1f, mass %.1e, volume %.1e\n", count,
               p->entered, p->least_quality, p->angles[0], p->angles[1], p->mass_change, p->volume_change);
        CHECK(p->entered >= count / 2);
        CHECK(p->least_quality >= 0.7);
        CHECK(p->angles[0] >= fmin(10.3, (double)angles[0]) - 1e-4);
        CHECK(p->angles[1] <= fmax(160, (double)angles[1]) + 1e-4);
        CHECK_NEAR(p->mass_change, 0, scene_tolerance(1e-12, 1000));
        CHECK_NEAR(p->volume_change, 0, scene_tolerance(1e-12, 1000));
    }
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

static int program_count(int usual) { return getenv("CHECK_SLOW") ? 200 : check_quick() ? 1 : usual; }
static int first_program(int usual) { return getenv("CHECK_SLOW") ? 0 : usual; }

static void test_block(void)
{
    programs p;
    memset(&p, 0, sizeof p);
    if (CHECK_OK(phantom_make_mesh(&p.mesh, &p.error)))
        run_programs(&p, 0, program_count(1));
}

static void test_organ(void)
{
    programs p;
    memset(&p, 0, sizeof p);
    if (CHECK_OK(stuff(ellipsoid_distance, 0.05, 0.009, &p.mesh, &p.error)))
        run_programs(&p, first_program(28),
                     program_count(2)); /* 28: many small operations left a flat tet at the skin */
}

static void test_phantom_file(void)
{
    char path[512];
    programs p;
    memset(&p, 0, sizeof p);
    if (check_shared_path(path, sizeof path, "data/phantom/phantom_tet4.vtk") &&
        CHECK_OK(sb_mesh_load(&p.mesh, path, NULL, &p.error)))
        run_programs(&p, 0, program_count(1));
}

CHECK_SUITE(needle_programs, {"a block of two tissues", test_block}, {"an organ", test_organ},
            {"the phantom of the shared data", test_phantom_file});
