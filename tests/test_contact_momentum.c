/* What tools give a body that nothing holds is the rate of its momentum, to the step's tolerance of the forces from
 * outside, however fast all fly: random blocks with a tool or two that go along and press, on three scales.
 * CHECK_SLOW=n: n flights; FLIGHT=k: flight k alone. */
#include "contact_scene.h"
#include "random_case.h"

enum { FLIGHT_STEPS = 20 };

typedef struct flight {
    press p;
    sb_vec3 velocity, gravity; /* m/s, m/s^2 */
    sb_vec3 at[2], press[2];   /* tools' places, and what they move by beside the velocity (m/s) */
    sb_quat turns[2];
    int tools[2], tool_count;
    double dt, unit, mass;        /* s, m, kg */
    double rounding;              /* N: of momentum over dt */
    int touched, capped, systems; /* steps with contact; those that were cut short; of all */
} flight;

static sb_body_def flight_def(unsigned long long *seed, double unit, double tolerance)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_AUTO, SB_PRECOND_IC0, SB_PRECOND_MULTIGRID, SB_PRECOND_SSOR};
    sb_body_def def = sb_default_body_def();
    double stiffness = random_scale(seed, 2e3, 1e5) * unit * unit;
    def.material = sb_material_corotated(REAL(stiffness), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, 0, random_below(seed, 3) ? REAL(-9.81 * unit) : 0);
    def.max_newton = 1;
    def.tolerance = REAL(tolerance);
    def.preconditioner = kinds[random_below(seed, 4)];
    return def;
}

static void flight_add_tool(flight *f, unsigned long long *seed)
{
    const double radius = 0.02 * f->unit, near = 2e-4 * f->unit, height = 0.04 * f->unit;
    const int t = f->tool_count++, below = t == 0;
    const double x = check_random_in(seed, 0.02, 0.08), y = check_random_in(seed, 0.02, 0.08);
    sb_tool_def tool;
    f->turns[t] = sb_quat_identity();
    f->at[t] = sb_v3(REAL(f->unit * x), REAL(f->unit * y), REAL(below ? -radius - near : height + radius + near));
    f->press[t] =
        sb_v3_scale(REAL(f->unit), sb_v3(REAL(check_random_in(seed, -0.1, 0.1)), REAL(check_random_in(seed, -0.1, 0.1)),
                                         REAL((below ? 1 : -1) * random_scale(seed, 0.01, 0.2))));
    tool = press_sphere(radius, check_random_in(seed, 0, 1), f->at[t]);
    if (random_below(seed, 3) == 0) { /* a box as high as the sphere, turned about z */
        const double round = 0.7 * radius, half = radius;
        tool = press_box(sb_v3(REAL(half), REAL(half), REAL(half)), round, check_random_in(seed, 0, 1), f->at[t]);
        f->turns[t] = sb_quat_from_rotation_vector(sb_v3(0, 0, REAL(check_random_in(seed, -3, 3))));
        tool.pose.rotation = f->turns[t];
    }
    f->tools[t] = press_add(&f->p, &tool);
}

static flight flight_make(unsigned long long *seed, double tolerance)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    flight f;
    sb_contact_def contact = sb_default_contact_def();
    sb_mesh mesh;
    sb_body_def def;
    sb_vec3 *v;
    int cells = 3 + random_below(seed, 3), tools = 1 + random_below(seed, 2);
    double speed;
    memset(&f, 0, sizeof f);
    f.unit = pow(1000, random_below(seed, 3) - 1);
    mesh = scene_box(types[random_below(seed, 3)], cells, cells, 2,
                     sb_v3(REAL(0.1 * f.unit), REAL(0.1 * f.unit), REAL(0.04 * f.unit)), check_random_in(seed, 0, 0.2));
    for (int i = 0, graded = random_below(seed, 3) == 0; graded && i < mesh.node_count; i++) /* cells of 1 to 4 */
        mesh.nodes[i].x *= REAL(0.3 + 0.7 * (double)mesh.nodes[i].x / (0.1 * f.unit));
    def = flight_def(seed, f.unit, tolerance);
    contact.max_iterations = 20;
    f.p = press_make(mesh, def, contact);
    f.mass = (double)sb_body_mass(f.p.body);
    f.gravity = def.gravity;
    speed = random_below(seed, 4) ? random_scale(seed, 0.1, 30) * f.unit : 0;
    f.velocity = sb_v3_scale(REAL(speed), random_direction(seed));
    v = (sb_vec3 *)malloc((size_t)f.p.mesh.node_count * sizeof *v);
    for (int i = 0; i < f.p.mesh.node_count; i++)
        v[i] = f.velocity;
    CHECK_OK(sb_body_set_velocities(f.p.body, v));
    free(v);
    f.dt = random_scale(seed, 1e-3, 1e-2);
    f.rounding = 64 * (double)SB_EPSILON * f.mass * speed / f.dt;
    while (f.tool_count < tools)
        flight_add_tool(&f, seed);
    return f;
}

/* Magnitudes of all that touches (N). */
static double flight_touch(const flight *f)
{
    int count = sb_contact_points(f->p.contact, NULL, 0);
    sb_contact_point *points = (sb_contact_point *)malloc((size_t)(count + 1) * sizeof *points);
    double sum = 0;
    sb_contact_points(f->p.contact, points, count);
    for (int i = 0; i < count; i++)
        sum += (double)sb_v3_norm(points[i].force);
    free(points);
    return sum;
}

/* What the rate of momentum differs by from weight and tools' forces beyond rounding, of their magnitudes; 0 where the
 * step was divided, whose last part alone has the forces that are read, or cut short. */
static double flight_step(flight *f)
{
    sb_vec3 before, rate, forces = sb_v3_scale(REAL(f->mass), f->gravity);
    double weight = (double)sb_v3_norm(forces), off;
    sb_step_info info;
    sb_contact_info seen;
    for (int t = 0; t < f->tool_count; t++) {
        f->at[t] = sb_v3_madd(f->at[t], REAL(f->dt), sb_v3_add(f->velocity, f->press[t]));
        press_move(&f->p, f->tools[t], f->at[t], f->turns[t]);
    }
    before = sb_body_momentum(f->p.body);
    CHECK_OK(sb_body_step(f->p.body, REAL(f->dt), &info));
    rate = sb_v3_scale(REAL(1 / f->dt), sb_v3_sub(sb_body_momentum(f->p.body), before));
    for (int t = 0; t < f->tool_count; t++)
        forces = sb_v3_sub(forces, press_wrench(&f->p, f->tools[t]).force);
    seen = sb_contact_get_info(f->p.contact);
    f->touched += seen.touching > 0;
    f->capped += seen.capped;
    f->systems += seen.iterations;
    if (seen.touching == 0 || seen.capped || info.capped || info.substeps > 1)
        return 0;
    off = (double)sb_v3_norm(sb_v3_sub(rate, forces)) - f->rounding;
    return off / (weight + flight_touch(f));
}

static void test_flights(void)
{
    const double tolerance = 1e-3;
    const char *slow = getenv("CHECK_SLOW"), *one = getenv("FLIGHT");
    const int enough = 15, count = one ? 1 : slow ? atoi(slow) : check_rounds(enough);
    int touched = 0, capped = 0, systems = 0;
    for (int c = one ? atoi(one) : 0, end = c + count; c < end; c++) {
        unsigned long long seed = 0x9E3779B97F4A7C15ULL * (unsigned)(c + 5);
        flight f = flight_make(&seed, tolerance);
        for (int s = 0; s < FLIGHT_STEPS; s++) {
            double off = flight_step(&f);
            if (off > tolerance)
                printf("flight %d step %d: momentum off by %.2e of the forces\n", c, s, off);
            CHECK(off <= tolerance);
        }
        touched += f.touched, capped += f.capped, systems += f.systems;
        press_free(&f.p);
    }
    if (count < enough) /* for means */
        return;
    CHECK(touched > 10 * count);
    CHECK(capped <= touched / 50);
    CHECK(systems < 5 * touched);
}

/* ---- what momentum costs ----------------------------------------------------------------------------------- */

/* A free tet10 block that swings a little, without weight, with a tool `gap` m from it or (0) none: iterations. */
static int iterations_near(sb_precond_kind kind, double gap)
{
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh = scene_box(SB_TET10, 4, 4, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.04)), 0.1);
    sb_vec3 *v = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *v);
    int sum = 0;
    press p;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.4), REAL(1000));
    def.max_newton = 1;
    def.preconditioner = kind;
    p = press_make(mesh, def, sb_default_contact_def());
    for (int i = 0; i < mesh.node_count; i++)
        v[i] = sb_v3(3, REAL(0.01 * sin(50 * (double)mesh.nodes[i].x)), 0);
    CHECK_OK(sb_body_set_velocities(p.body, v));
    for (int s = 0, tool = -1; s < 10; s++) {
        sb_vec3 at = sb_v3(REAL(0.05 + 0.015 * (s + 1)), REAL(0.05), REAL(-0.02 - gap));
        sb_tool_def sphere = press_sphere(0.02, 0, at);
        sb_step_info info;
        if (gap > 0 && s == 0)
            tool = press_add(&p, &sphere);
        if (gap > 0)
            press_move(&p, tool, at, sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.005), &info));
        CHECK(sb_contact_get_info(p.contact).touching == 0);
        sum += info.pcg_iterations;
    }
    free(v);
    press_free(&p);
    return sum;
}

/* A tool that is near and does not touch asks for no more than none. */
static void test_near(void)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_AUTO, SB_PRECOND_IC0, SB_PRECOND_MULTIGRID};
    for (int k = 0; k < 3; k++) {
        int without = iterations_near(kinds[k], 0), with = iterations_near(kinds[k], 1e-3);
        CHECK(without > 0);
        CHECK(with <= without + 2);
    }
}

/* Held blocks with multigrid, whose systems were solved in 5 iterations or, when the compact matrix was left with a
 * direction of its own, in 500. */
static int most_iterations_held(unsigned long long *seed)
{
    sb_body_def def = sb_default_body_def();
    int cells = 3 + random_below(seed, 2), most = 0, held[64], held_count = 0;
    sb_mesh mesh = scene_box(SB_TET4, cells, cells, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.04)), 0);
    double stiffness = random_scale(seed, 1e3, 1e5), dt = random_scale(seed, 1e-3, 2e-2),
           gap = random_scale(seed, 1e-4, 5e-3);
    double speed = random_scale(seed, 0.005, 0.2);
    sb_vec3 at =
        sb_v3(REAL(check_random_in(seed, 0.02, 0.08)), REAL(check_random_in(seed, 0.02, 0.08)), REAL(-0.02 - gap));
    sb_tool_def sphere = press_sphere(0.02, check_random(seed), at);
    press p;
    int tool;
    def.material = random_below(seed, 2) ? sb_material_neo_hookean(REAL(stiffness), REAL(0.4), 1000)
                                         : sb_material_corotated(REAL(stiffness), REAL(0.4), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.max_newton = 1;
    def.integrator = random_below(seed, 2) ? SB_GENERALISED_ALPHA : SB_EULER;
    def.preconditioner = SB_PRECOND_MULTIGRID;
    p = press_make(mesh, def, sb_default_contact_def());
    for (int i = 0; i < mesh.node_count && held_count < 64; i++)
        if (mesh.nodes[i].x == 0)
            held[held_count++] = i;
    CHECK_OK(sb_body_hold(p.body, held, held_count, SB_XYZ, NULL));
    tool = press_add(&p, &sphere);
    for (int s = 0; s < 16; s++) {
        sb_step_info info;
        at.z += REAL(dt * (s < 12 ? speed : -3 * speed));
        press_move(&p, tool, at, sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(dt), &info));
        most = info.pcg_iterations > most ? info.pcg_iterations : most;
    }
    press_free(&p);
    return most;
}

static void test_held(void)
{
    const char *slow = getenv("CHECK_SLOW");
    int count = slow ? atoi(slow) : check_rounds(40), most = 0;
    for (int c = 0; c < count; c++) {
        unsigned long long seed = 0x9E3779B97F4A7C15ULL * (unsigned)(c + 1);
        int mine = most_iterations_held(&seed);
        if (mine > 100)
            printf("held %d: %d iterations in a step\n", c, mine);
        most = mine > most ? mine : most;
    }
    CHECK(most <= 100);
}

CHECK_SUITE(contact_momentum, {"flights", test_flights}, {"near", test_near}, {"held", test_held});
