/* Every time scheme with everything that acts on a body or is remembered by it: springs, mappings, pressure,
 * constraints, ties, Prony terms, B-bar, quadratic hexes. Closed forms, one scheme against another, balance, undo,
 * memory, violence. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

enum { FIRST = SB_EULER, LAST = SB_CENTRAL_DIFFERENCE };
static const char *const scheme_names[LAST + 1] = {"", "Euler", "Newmark", "generalised alpha", "central difference"};

typedef enum kind { SPRINGS, PRESSURE, MAPPING, CONSTRAINT, TIE, PRONY, BBAR, QUADRATIC, KINDS } kind;
static const char *const kind_names[KINDS] = {"springs", "pressure", "mapping", "constraint",
                                              "tie",     "Prony",    "B-bar",   "hex20"};
static const double spectral_radius = 0.6;

/* ---- scenes ---- */

typedef struct play {
    sb_mesh mesh;
    sb_body *body;
    kind what;
    int tip, second; /* nodes at the free end */
    int load;        /* id of springs, mapping or pressure; 0: none */
    int link;        /* number of the constraint that keeps its gap, -1: none */
    sb_vec3 home[2]; /* points of springs, targets of rows */
} play;

static sb_constraint_term term(int node, int axis, double coefficient)
{
    sb_constraint_term made;
    made.node = node;
    made.axis = axis;
    made.coefficient = REAL(coefficient);
    return made;
}

static int nearest_node(const sb_mesh *mesh, double x, double y, double z)
{
    sb_vec3 at = sb_v3(REAL(x), REAL(y), REAL(z));
    int best = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], at)) < sb_v3_norm(sb_v3_sub(mesh->nodes[best], at)))
            best = i;
    return best;
}

/* Corner nodes, four or three to a face, of the boundary faces whose corners lie on axis = value; returns how many. */
static int plane_faces(const sb_mesh *mesh, int last, int axis, double value, int *faces)
{
    sb_boundary boundary;
    int count = 0;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return 0;
    for (int f = 0; f < boundary.surface.element_count; f++) {
        int corners = sb_element_corner_count(boundary.surface.element_type), on = 1;
        const int *face = boundary.surface.elements + f * sb_element_node_count(boundary.surface.element_type);
        for (int k = 0; k < corners; k++)
            on = on && face[k] < last && fabs((double)scene_component(mesh->nodes[face[k]], axis) - value) < 1e-6;
        for (int k = 0; k < corners && on; k++)
            faces[corners * count + k] = face[k];
        count += on;
    }
    sb_boundary_free(&boundary);
    return count;
}

static int corners_of(const sb_mesh *mesh) { return sb_element_straight(mesh->element_type) == SB_HEX8 ? 4 : 3; }

/* 8 x 4 x 4 cm: a bar, or two blocks that meet at x = 4 cm, the second finer or (same 1) with the same grid. */
static sb_mesh bar(sb_element_type type, int tied, int same)
{
    sb_mesh mesh = scene_box(type, tied ? 1 : 2, 1, 1, sb_v3(REAL(tied ? 0.04 : 0.08), REAL(0.04), REAL(0.04)), 0),
            second;
    if (!tied)
        return mesh;
    second = scene_box(type, 1, same ? 1 : 2, 1, sb_v3(REAL(0.04), REAL(0.04), REAL(0.04)), 0);
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += REAL(0.04);
    CHECK_OK(sb_mesh_append(&mesh, &second, NULL));
    sb_mesh_free(&second);
    return mesh;
}

static void tie_bar(sb_body *body, const sb_mesh *mesh, int split)
{
    int faces[64], slaves[64], count = 0, face_count = plane_faces(mesh, split, 0, 0.04, faces);
    sb_tie_report report;
    for (int i = split; i < mesh->node_count; i++)
        if (fabs((double)mesh->nodes[i].x - 0.04) < 1e-6)
            slaves[count++] = i;
    memset(&report, 0, sizeof report);
    CHECK_OK(
        sb_body_tie_faces(body, faces, face_count, corners_of(mesh), slaves, count, -1, SB_TIE_ALL, &report, NULL));
    CHECK_INT(report.tied_count, count);
}

static sb_material prony_material(sb_material material)
{
    const sb_real g[2] = {REAL(0.4), REAL(0.2)}, tau[2] = {REAL(0.02), REAL(0.3)};
    return sb_material_with_prony(material, g, tau, 2);
}

/* Adds what the scene is about. */
static void equip(play *p, int split)
{
    sb_real k = 20;
    const sb_real weights[8] = {REAL(0.25), REAL(0.25), REAL(0.25), REAL(0.25), REAL(0.5), REAL(0.5)};
    const int starts[3] = {0, 4, 6};
    int nodes[6], faces[64];
    p->home[0] = p->mesh.nodes[p->tip];
    p->home[1] = p->mesh.nodes[p->second];
    if (p->what == SPRINGS) {
        nodes[0] = p->tip;
        nodes[1] = p->second;
        CHECK_OK(sb_body_add_springs(p->body, nodes, 2, &k, 1, p->home, &p->load, NULL));
    } else if (p->what == MAPPING) { /* the middle of the end, and a row through the whole bar */
        sb_mapping mapping;
        for (int i = 0; i < 4; i++)
            nodes[i] = nearest_node(&p->mesh, 0.08, 0.04 * (i % 2), i < 2 ? 0 : 0.04);
        nodes[4] = p->tip;
        nodes[5] = nearest_node(&p->mesh, 0.04, 0, 0);
        mapping.row_count = 2;
        mapping.row_start = starts;
        mapping.nodes = nodes;
        mapping.weights = weights;
        p->home[0] = sb_v3(REAL(0.08), REAL(0.02), REAL(0.02));
        p->home[1] = sb_v3_scale(REAL(0.5), sb_v3_add(p->mesh.nodes[nodes[4]], p->mesh.nodes[nodes[5]]));
        CHECK_OK(sb_body_add_mapping(p->body, &mapping, &k, 1, p->home, &p->load, NULL));
    } else if (p->what == PRESSURE) {
        int count = plane_faces(&p->mesh, p->mesh.node_count, 2, 0.04, faces);
        CHECK_OK(sb_body_add_pressure(p->body, faces, count, corners_of(&p->mesh), 60, &p->load, NULL));
    } else if (p->what == CONSTRAINT) { /* one node between two others, one that goes with a third */
        sb_constraint_term mean[3], follow[2];
        mean[0] = term(p->tip, 2, 2);
        mean[1] = term(p->second, 2, -1);
        mean[2] = term(nearest_node(&p->mesh, 0.04, 0.04, 0.04), 2, -1);
        follow[0] = term(nearest_node(&p->mesh, 0.08, 0, 0), 1, 1);
        follow[1] = term(p->second, 1, -1);
        CHECK_OK(sb_body_add_constraint(p->body, follow, 2, 0, NULL, NULL));
        CHECK_OK(sb_body_add_constraint(p->body, mean, 3, 0, &p->link, NULL));
    } else if (p->what == TIE) {
        tie_bar(p->body, &p->mesh, split);
        p->link = 0;
    }
}

/* A clamped bar of neo-Hookean (or the given) material, all of whose steps are as exact as sb_real allows. */
static play begin(kind what, sb_integrator integrator, const sb_material *material, sb_jobs jobs,
                  sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    play p;
    memset(&p, 0, sizeof p);
    p.what = what;
    p.link = -1;
    p.mesh = bar(what == QUADRATIC ? SB_HEX20 : SB_HEX8, what == TIE, 0);
    def.mesh = &p.mesh;
    def.material =
        material ? *material : sb_material_neo_hookean(REAL(5e3), REAL(what == BBAR ? 0.45 : 0.3), REAL(1000));
    if (what == PRONY)
        def.material = prony_material(def.material);
    if (what == BBAR)
        def.integration = SB_INTEGRATION_BBAR;
    def.integrator = integrator;
    def.spectral_radius = REAL(spectral_radius);
    def.gravity = sb_v3(REAL(0.3), REAL(0.5), -3);
    def.damping_mass = 2;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-12);
    def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
    def.max_iterations = 3000;
    def.jobs = jobs;
    if (allocator)
        def.allocator = *allocator;
    p.body = scene_body(&def);
    p.tip = nearest_node(&p.mesh, 0.08, 0, 0.04);
    p.second = nearest_node(&p.mesh, 0.08, 0.04, 0.04);
    scene_fix_plane(p.body, &p.mesh, 0, 0, SB_XYZ);
    equip(&p, what == TIE ? 8 : 0);
    return p;
}

static sb_jobs no_jobs(void)
{
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    return jobs;
}

static play begin_plain(kind what, sb_integrator integrator) { return begin(what, integrator, NULL, no_jobs(), NULL); }

static void end(play *p)
{
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

/* All that can be read, as bits. */
static unsigned long long readings(const play *p)
{
    size_t bytes = (size_t)p->mesh.node_count * sizeof(sb_vec3);
    sb_vec3 force = sb_v3(0, 0, 0), torque = force;
    sb_real pull = 0;
    if (p->load)
        CHECK_OK(sb_body_load_force(p->body, p->load, p->home[0], &force, &torque));
    if (p->link >= 0)
        CHECK_OK(sb_body_constraint_force(p->body, p->link, &pull));
    return scene_hash(sb_body_displacements(p->body), bytes) ^ 3 * scene_hash(sb_body_velocities(p->body), bytes) ^
           5 * scene_hash(sb_body_reactions(p->body), bytes) ^ 7 * scene_hash(sb_body_external_forces(p->body), bytes) ^
           9 * scene_hash(&force, sizeof force) ^ 11 * scene_hash(&torque, sizeof torque) ^
           13 * scene_hash(&pull, sizeof pull);
}

/* ---- one scheme against another ---- */

enum { WATCHED = 4 };
static const double swing_time = 0.12;

/* Where the last nodes are after the swing. */
static void swing(kind what, sb_integrator integrator, int steps, sb_vec3 *where)
{
    play p = begin_plain(what, integrator);
    for (int s = 0; s < steps; s++) {
        sb_step_info info;
        if (!CHECK_OK(sb_body_step(p.body, REAL(swing_time / steps), &info))) {
            printf("%s\n", info.error.message);
            break;
        }
    }
    for (int i = 0; i < WATCHED; i++)
        where[i] = sb_body_displacements(p.body)[p.mesh.node_count - 1 - i];
    end(&p);
}

/* Every scheme tends to the same motion with its order. Lumped slaves weigh a little differently; explicit steps are
 * below the stable one, so that their errors are below those of the others' reference. */
static void test_one_motion(void)
{
    static const int steps[LAST + 1] = {0, 200, 40, 50, 0};
    static const double order[LAST + 1] = {0, 1, 2, 2, 2};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("orders in time need double");
        return;
    }
    for (int what = 0; what < KINDS; what++) {
        sb_vec3 reference[WATCHED], coarse[WATCHED], fine[WATCHED], zero[WATCHED];
        memset(zero, 0, sizeof zero);
        swing((kind)what, SB_NEWMARK, 400, reference);
        printf("  %-10s", kind_names[what]);
        for (int s = FIRST; s <= LAST; s++) {
            int lumped = what == TIE || what == CONSTRAINT, count = steps[s] ? steps[s] : what == QUADRATIC ? 150 : 60;
            double size = scene_distance(reference, zero, WATCHED), first, second;
            swing((kind)what, (sb_integrator)s, count, coarse);
            swing((kind)what, (sb_integrator)s, 2 * count, fine);
            if (s == SB_CENTRAL_DIFFERENCE) {
                CHECK_NEAR(scene_distance(fine, reference, WATCHED) / size, 0, lumped ? 0.05 : 1e-4);
                swing((kind)what, (sb_integrator)s, 8 * count, reference);
            }
            first = scene_distance(coarse, reference, WATCHED) / size;
            second = scene_distance(fine, reference, WATCHED) / size;
            printf(" %s %.1e %.2f%s", scheme_names[s], second, log(first / second) / log(2.0), s == LAST ? "\n" : ",");
            CHECK_NEAR(log(first / second) / log(2.0), order[s], 0.35);
            CHECK(second < (s == SB_EULER ? 0.02 : 0.001));
        }
    }
}

/* ---- closed form: a body on springs that moves as one ---- */

/* One step of each scheme for u'' = -omega^2 u. */
static void oscillate(sb_integrator integrator, double omega, double h, double state[3])
{
    double w = omega * omega, u = state[0], v = state[1], a = state[2], rho = spectral_radius;
    if (integrator == SB_EULER) {
        state[1] = (v - h * w * u) / (1 + h * h * w);
        state[0] = u + h * state[1];
    } else if (integrator == SB_CENTRAL_DIFFERENCE) {
        state[0] = u + h * v + h * h / 2 * a;
        state[2] = -w * state[0];
        state[1] = v + h / 2 * (a + state[2]);
    } else {
        double am = integrator == SB_NEWMARK ? 0 : (2 * rho - 1) / (rho + 1),
               af = integrator == SB_NEWMARK ? 0 : rho / (rho + 1);
        double gamma = 0.5 - am + af, beta = (1 - am + af) * (1 - am + af) / 4;
        double guess = u + h * v + h * h * (0.5 - beta) * a; /* u' = guess + h^2 beta a' */
        state[2] = -(am * a + w * (1 - af) * guess + w * af * u) / (1 - am + w * (1 - af) * h * h * beta);
        state[0] = guess + h * h * beta * state[2];
        state[1] = v + h * ((1 - gamma) * a + gamma * state[2]);
    }
}

/* Springs at all corners, or one row through their mean, or springs and nodes that follow another. */
static void bob(int how, sb_integrator integrator)
{
    sb_mesh mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    double k = 40000, omega = sqrt(k / 1000), h = 0.02, state[3] = {0.1, 0, -0.1 * omega * omega};
    const int starts[9] = {0, how == 1 ? 8 : 1, 2, 3, 4, 5, 6, 7, 8}, nodes[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_real weights[8], stiffness = REAL(how == 1 ? k : k / 8);
    sb_vec3 points[8], u[8], centre = sb_v3(REAL(0.5), REAL(0.5), REAL(0.5));
    sb_mapping mapping;
    int load = 0;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_linear(100000, REAL(0.3), 1000);
    def.integrator = integrator;
    def.spectral_radius = REAL(spectral_radius);
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-13);
    body = scene_body(&def);
    for (int i = 0; i < 8; i++) {
        weights[i] = REAL(0.125);
        points[i] = how == 1 ? centre : mesh.nodes[i];
        u[i] = sb_v3(REAL(0.1), 0, 0);
    }
    mapping.row_count = 1;
    mapping.row_start = starts;
    mapping.nodes = nodes;
    mapping.weights = weights;
    for (int i = 1; i < 5 && how == 2; i++)
        for (int axis = 0; axis < 3; axis++) {
            sb_constraint_term link[2];
            link[0] = term(i, axis, 1);
            link[1] = term(0, axis, -1);
            CHECK_OK(sb_body_add_constraint(body, link, 2, 0, NULL, NULL));
        }
    if (how == 1)
        CHECK_OK(sb_body_add_mapping(body, &mapping, &stiffness, 1, points, &load, NULL));
    else
        CHECK_OK(sb_body_add_springs(body, nodes, 8, &stiffness, 1, points, &load, NULL));
    CHECK_OK(sb_body_set_displacements(body, u));
    for (int s = 0; s < 40; s++) {
        sb_step_info info;
        sb_vec3 force;
        double before = state[0], level = integrator == SB_GENERALISED_ALPHA ? 1 / (1 + spectral_radius) : 1;
        if (!CHECK_OK(sb_body_step(body, REAL(h), &info)))
            printf("%s\n", info.error.message);
        for (int n = 0; n < (info.substeps ? info.substeps : 1); n++)
            oscillate(integrator, omega, h / (info.substeps ? info.substeps : 1), state);
        CHECK_NEAR(sb_body_displacements(body)[3].x, state[0], scene_tolerance(1e-10, 3e4));
        CHECK_NEAR(sb_body_velocities(body)[3].x, state[1], omega * scene_tolerance(1e-10, 3e4));
        CHECK_OK(sb_body_load_force(body, load, centre, &force, NULL));
        CHECK_NEAR((double)force.x / k, -(before + level * (state[0] - before)), scene_tolerance(1e-10, 3e4));
        CHECK_NEAR(scene_sum(sb_body_external_forces(body), 8).x / force.x, 1, scene_tolerance(1e-9, 1e4));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_bob(void)
{
    for (int how = 0; how < 3; how++)
        for (int s = FIRST; s <= LAST; s++)
            bob(how, (sb_integrator)s);
}

/* ---- stiff springs and explicit steps ---- */

/* The stable step is that of the stiffest spring: 2 sqrt(m/k) of the node it holds, or of what its row moves. Over many
 * steps at nine tenths of it the energy stays. */
static void test_stiff(void)
{
    for (int how = 0; how < 3; how++) {
        kind what = how == 0 ? SPRINGS : how == 1 ? MAPPING : TIE;
        sb_material material = sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000));
        play p = begin(what, SB_CENTRAL_DIFFERENCE, &material, no_jobs(), NULL);
        double most = 0, first = 0, expected, share = what == MAPPING ? 0.25 : 1;
        sb_real soft = 0, stiff = 0, k = REAL(1e6);
        sb_step_info info;
        sb_energy energy;
        CHECK_OK(sb_body_set_gravity(p.body, sb_v3(0, 0, 0)));
        CHECK_OK(sb_body_set_damping(p.body, 0, 0));
        CHECK_OK(sb_body_stable_step(p.body, &soft, NULL));
        CHECK_OK(sb_body_step(p.body, soft, &info));
        if (what == SPRINGS)
            CHECK_OK(sb_body_set_spring_stiffness(p.body, p.load, &k, 1));
        if (what == MAPPING)
            CHECK_OK(sb_body_set_mapping_stiffness(p.body, p.load, &k, 1));
        CHECK_OK(sb_body_stable_step(p.body, &stiff, NULL));
        expected = 2 * sqrt(1000 * 1.28e-4 / 16 / 1e6 / share); /* end nodes have an eighth of a cell of mass */
        printf("  stable step, %s: %.3g s, with 1e6 N/m %.3g s, of one node %.3g s\n", kind_names[what], (double)soft,
               (double)stiff, what == TIE ? 0.0 : expected);
        if (what != TIE)
            CHECK(stiff > REAL(0.6 * expected) && stiff < REAL(1.2 * expected));
        for (int s = 0; s < 200; s++) {
            sb_vec3 *v = (sb_vec3 *)calloc((size_t)p.mesh.node_count, sizeof(sb_vec3));
            v[p.tip] = sb_v3(1, REAL(-0.5), REAL(0.3));
            if (s == 0)
                CHECK_OK(sb_body_set_velocities(p.body, v));
            free(v);
            CHECK_OK(sb_body_energy(p.body, &energy));
            first = s == 0 ? (double)energy.kinetic : first;
            most = fmax(most, (double)energy.elastic + (double)energy.kinetic + (double)energy.springs);
            if (!CHECK_OK(sb_body_step(p.body, 10 * stiff, &info)))
                break;
            CHECK_INT(info.substeps, 12);
        }
        CHECK(most < 3.5 * first && most > 0.5 * first); /* 1/(1 - 0.83^2): so far elastic energy swings */
        end(&p);
    }
}

/* ---- balance ---- */

/* Sum over the components of a that the schemes share. */
static double along(sb_vec3 v, int axis) { return (double)scene_component(v, axis); }

/* Loads, reactions and constraints push as the scheme's own rates of momentum say. */
static void balance(kind what, sb_integrator integrator)
{
    play p = begin_plain(what, integrator);
    double dt = integrator == SB_CENTRAL_DIFFERENCE ? 0.002 : 0.01, alpha = 2, weight, worst = 0;
    double am = (2 * spectral_radius - 1) / (1 + spectral_radius), af = spectral_radius / (1 + spectral_radius);
    double gamma = 0.5 - am + af, rate[3] = {0, 0, 0};
    sb_vec3 last = sb_v3(0, 0, 0), torque = last;
    weight = 3 * (double)sb_body_mass(p.body);
    for (int s = 0; s < 8; s++) {
        sb_vec3 before = sb_body_momentum(p.body), after, sum;
        if (!CHECK_OK(sb_body_step(p.body, REAL(dt), NULL)))
            break;
        after = sb_body_momentum(p.body);
        sum = sb_v3_add(scene_sum(sb_body_reactions(p.body), p.mesh.node_count),
                        scene_sum(sb_body_external_forces(p.body), p.mesh.node_count));
        for (int k = 0; k < 3; k++) {
            double change = (along(after, k) - along(before, k)) / dt, expected, found = along(sum, k);
            if (integrator == SB_EULER) {
                expected = change + alpha * along(after, k);
            } else if (integrator == SB_GENERALISED_ALPHA) {
                double push = found - alpha * ((1 - af) * along(after, k) + af * along(before, k)), next;
                if (s == 0) /* (1 - am) A' + am A = push and (1 - gamma) A + gamma A' = change tell both */
                    rate[k] = ((1 - am) * change - gamma * push) / ((1 - am) * (1 - gamma) - gamma * am);
                next = (change - (1 - gamma) * rate[k]) / gamma;
                expected = found - push + (1 - am) * next + am * rate[k];
                rate[k] = next;
            } else { /* the mean of both ends */
                expected = change + alpha * (along(after, k) + along(before, k)) / 2;
                found = s == 0 ? expected : (found + along(last, k)) / 2;
            }
            worst = fmax(worst, fabs(found - expected) / weight);
        }
        last = sum;
    }
    if (!CHECK_NEAR(worst, 0, scene_tolerance(1e-8, 2e5)))
        printf("  %s, %s\n", kind_names[what], scheme_names[integrator]);
    if (what != PRESSURE && p.load) { /* the net force is that of the rows */
        sb_vec3 forces[2], net;
        CHECK_OK(what == SPRINGS ? sb_body_spring_forces(p.body, p.load, forces)
                                 : sb_body_mapping_forces(p.body, p.load, forces));
        CHECK_OK(sb_body_load_force(p.body, p.load, p.home[0], &net, &torque));
        CHECK_NEAR(scene_distance(&net, forces, 1) / (double)sb_v3_norm(net),
                   (double)sb_v3_norm(forces[1]) / (double)sb_v3_norm(net), 1e-5);
    }
    end(&p);
}

static void test_balance(void)
{
    for (int what = 0; what < KINDS; what++)
        for (int s = FIRST; s <= LAST; s++)
            balance((kind)what, (sb_integrator)s);
}

/* ---- constraints that move ---- */

/* A value that moves is where it should be at the end of every step, to the last bits, and so are slaves of supports
 * and of slaves; velocities say so; what the constraints push with moves the body. */
static void test_moving_constraints(void)
{
    for (int s = FIRST; s <= LAST; s++) {
        play p = begin_plain(BBAR, (sb_integrator)s);
        sb_constraint_term drive = term(p.second, 2, 2), link[3];
        int id = -1, other = -1, held = nearest_node(&p.mesh, 0, 0, 0);
        double dt = s == SB_CENTRAL_DIFFERENCE ? 0.004 : 0.01;
        CHECK_OK(sb_body_set_gravity(p.body, sb_v3(0, 0, 0)));
        CHECK_OK(sb_body_add_constraint(p.body, &drive, 1, 0, &id, NULL));
        link[0] = term(p.tip, 2, 1);
        link[1] = term(p.second, 2, -0.5);
        link[2] = term(held, 2, -0.25);
        CHECK_OK(
            sb_body_add_constraint(p.body, link, 3, REAL(0.001), &other, NULL)); /* open: closes in the first step */
        for (int n = 1; n <= 12; n++) {
            sb_vec3 target = sb_v3(0, 0, REAL(0.0004 * n)), u, v;
            sb_real force = 0;
            CHECK_OK(sb_body_set_constraint_value(p.body, id, REAL(0.0002) * REAL(n)));
            CHECK_OK(sb_body_prescribe(p.body, &held, 1, SB_XYZ, &target, 1));
            if (!CHECK_OK(sb_body_step(p.body, REAL(dt), NULL)))
                break;
            u = sb_body_displacements(p.body)[p.second];
            v = sb_body_velocities(p.body)[p.second];
            CHECK_NEAR(u.z, 0.0001 * n, scene_tolerance(1e-17, 5e-3));
            CHECK_NEAR(v.z, 0.0001 / dt, scene_tolerance(1e-12, 1000));
            u = sb_body_displacements(p.body)[p.tip];
            v = sb_body_velocities(p.body)[p.tip];
            CHECK_NEAR(u.z, 0.001 + 0.00015 * n, scene_tolerance(1e-17, 5e-3));
            if (n > 1)
                CHECK_NEAR(v.z, 0.00015 / dt, scene_tolerance(1e-12, 1000));
            CHECK_OK(sb_body_constraint_force(p.body, id, &force));
            CHECK(force != 0 && sb_is_finite(force));
        }
        end(&p);
    }
}

/* The pushes of constraints that are no ties count in the balance of momentum; an explicit body's too, whose gap closes
 * during the first call. */
static void test_multipliers(void)
{
    for (int s = FIRST; s <= LAST; s++) {
        play p = begin_plain(BBAR, (sb_integrator)s);
        sb_constraint_term drive[2];
        int id = -1;
        double dt = s == SB_CENTRAL_DIFFERENCE ? 0.002 : 0.01, last = 0, weight = 3 * (double)sb_body_mass(p.body);
        double level = s == SB_GENERALISED_ALPHA ? 1 / (1 + spectral_radius) : 1;
        drive[0] = term(p.tip, 2, 2);
        drive[1] = term(nearest_node(&p.mesh, 0.08, 0.04, 0), 2, -1);
        CHECK_OK(sb_body_add_constraint(p.body, drive, 2, 0, &id, NULL));
        CHECK_OK(sb_body_set_damping(p.body, 0, 0));
        for (int n = 0; n < 60; n++) { /* to rest, where rates are nothing */
            if (n == 2)
                CHECK_OK(sb_body_set_damping(p.body, 60, 0));
            CHECK_OK(sb_body_step(p.body, REAL(dt), NULL));
        }
        for (int n = 0; n < 4; n++) {
            sb_vec3 before = sb_body_momentum(p.body), after;
            sb_real force = 0;
            double sum, change;
            CHECK_OK(sb_body_step(p.body, REAL(dt), NULL));
            after = sb_body_momentum(p.body);
            CHECK_OK(sb_body_constraint_force(p.body, id, &force));
            sum = (double)scene_sum(sb_body_reactions(p.body), p.mesh.node_count).z +
                  (double)scene_sum(sb_body_external_forces(p.body), p.mesh.node_count).z + (double)force;
            change = (double)(after.z - before.z) / dt;
            sum -= 60 * (level * (double)after.z + (1 - level) * (double)before.z);
            if (s == SB_EULER)
                CHECK_NEAR((sum - change) / weight, 0, scene_tolerance(1e-8, 1e5));
            else if (n > 0 && s != SB_GENERALISED_ALPHA)
                CHECK_NEAR(((sum + last) / 2 - change) / weight, 0, scene_tolerance(1e-8, 1e5));
            CHECK(fabs((double)force) > 1e-3 * weight);
            last = sum;
        }
        end(&p);
    }
}

/* ---- undo, threads, memory ---- */

/* The hash of a motion in which step fail_at (0: none) is tried with a load beyond numbers first. */
static unsigned long long play_on(kind what, sb_integrator integrator, int fail_at, sb_jobs jobs)
{
    play p = begin(what, integrator, NULL, jobs, NULL);
    unsigned long long hash;
    for (int s = 1; s <= 6; s++) {
        if (s == fail_at) {
            sb_step_info info;
            sb_real dt = 0;
            hash = readings(&p);
            CHECK_OK(sb_body_set_gravity(p.body, sb_v3(0, 0, SB_REAL_MAX / 2)));
            CHECK(sb_body_step(p.body, REAL(0.01), &info) != SB_OK);
            CHECK(info.error.message[0] && info.load_factor == 0);
            CHECK(readings(&p) == hash);
            CHECK_OK(sb_body_set_gravity(p.body, sb_v3(REAL(0.3), REAL(0.5), -3)));
            CHECK_OK(sb_body_stable_step(p.body, &dt, NULL));
        }
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    }
    hash = readings(&p);
    end(&p);
    return hash;
}

static void test_undo(void)
{
    check_bad_numbers();
    for (int what = 0; what < KINDS; what++)
        for (int s = FIRST; s <= LAST; s++)
            CHECK(play_on((kind)what, (sb_integrator)s, 4, no_jobs()) ==
                  play_on((kind)what, (sb_integrator)s, 0, no_jobs()));
}

static void test_threads(void)
{
    for (int what = 0; what < KINDS; what++)
        for (int s = FIRST; s <= LAST; s++) {
            int workers = 3;
            CHECK(play_on((kind)what, (sb_integrator)s, 0, scene_jobs(&workers)) ==
                  play_on((kind)what, (sb_integrator)s, 0, no_jobs()));
        }
}

static void test_no_allocation(void)
{
    for (int what = 0; what < KINDS; what++)
        for (int s = FIRST; s <= LAST; s++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_allocator allocator = scene_allocator(&memory);
            play p = begin((kind)what, (sb_integrator)s, NULL, no_jobs(), &allocator);
            sb_real dt = 0;
            int calls = memory.calls;
            for (int n = 0; n < 2; n++)
                CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
            CHECK_OK(sb_body_stable_step(p.body, &dt, NULL));
            CHECK_INT(memory.calls, calls);
            end(&p);
            CHECK_INT(memory.live, 0);
        }
}

/* ---- robustness ---- */

/* Dragged about for 300 steps, then let go: it comes back to rest. */
static void violent(kind what, sb_integrator integrator)
{
    sb_material material = integrator % 2 && what != PRONY
                               ? sb_material_corotated_invertible(REAL(5e3), REAL(0.35), REAL(1000))
                               : sb_material_stable_neo_hookean(REAL(5e3), REAL(0.35), REAL(1000));
    play p = begin(what, integrator, &material, no_jobs(), NULL);
    unsigned long long seed = 99;
    int failed = 0, drag = nearest_node(&p.mesh, 0.08, 0.04, 0);
    double last = 0;
    CHECK_OK(sb_body_set_gravity(p.body, sb_v3(0, 0, 0)));
    CHECK_OK(sb_body_set_damping(p.body, 20,
                                 integrator == SB_CENTRAL_DIFFERENCE ? 0 : REAL(0.01))); /* in Newmark's favour */
    CHECK_OK(sb_body_set_solver(p.body, REAL(1e-4), 200));
    for (int s = 0, end = check_rounds(300); s < end; s++) {
        sb_vec3 pull = sb_v3(REAL(0.03 * sin(0.13 * s)), REAL(0.03 * cos(0.29 * s)), REAL(0.03 * sin(0.41 * s))),
                points[2];
        points[0] = sb_v3_add(p.home[0], pull);
        points[1] = sb_v3_sub(p.home[1], pull);
        if (what == SPRINGS)
            CHECK_OK(sb_body_move_springs(p.body, p.load, points));
        else if (what == MAPPING)
            CHECK_OK(sb_body_set_mapping_targets(p.body, p.load, points));
        else if (what == PRESSURE)
            CHECK_OK(sb_body_set_pressure(p.body, p.load, REAL(400 * sin(0.1 * s))));
        else if (what == CONSTRAINT)
            CHECK_OK(sb_body_set_constraint_value(p.body, p.link, REAL(0.04 * sin(0.3 * s))));
        if (s % 10 == 0) {
            pull = sb_v3(REAL(check_random_in(&seed, -0.02, 0.02)), REAL(check_random_in(&seed, -0.02, 0.02)),
                         REAL(check_random_in(&seed, -0.02, 0.02)));
            CHECK(sb_body_prescribe(p.body, &drag, 1, what == CONSTRAINT ? SB_X : SB_XYZ, &pull, 1) == SB_OK);
        } else {
            CHECK_OK(sb_body_release_nodes(p.body, &drag, 1, SB_XYZ));
        }
        failed += sb_body_step(p.body, REAL(0.01), NULL) != SB_OK;
        if (!CHECK(scene_all_finite(sb_body_displacements(p.body), p.mesh.node_count)))
            break;
    }
    CHECK_OK(sb_body_release_nodes(p.body, &drag, 1, SB_XYZ));
    if (what == SPRINGS)
        CHECK_OK(sb_body_move_springs(p.body, p.load, p.home));
    else if (what == MAPPING)
        CHECK_OK(sb_body_set_mapping_targets(p.body, p.load, p.home));
    else if (what == PRESSURE)
        CHECK_OK(sb_body_set_pressure(p.body, p.load, 0));
    else if (what == CONSTRAINT)
        CHECK_OK(sb_body_set_constraint_value(p.body, p.link, 0));
    for (int s = 0; s < 100; s++)
        CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
    last = scene_distance(sb_body_positions(p.body), p.mesh.nodes, p.mesh.node_count);
    if (!CHECK(failed <= 3) || !CHECK_NEAR(last, 0, 1e-3))
        printf("  %s, %s: %d failed, %g m from rest\n", kind_names[what], scheme_names[integrator], failed, last);
    end(&p);
}

static void test_violence(void)
{
    for (int what = 0; what < KINDS; what++)
        for (int s = FIRST; s <= LAST; s++)
            violent((kind)what, (sb_integrator)s);
}

/* Constraints whose masses cannot be lumped are refused by name, whatever asks. */
static void test_refusals(void)
{
    play p = begin_plain(BBAR, SB_CENTRAL_DIFFERENCE);
    sb_constraint_term link[3];
    sb_step_info info;
    sb_real dt = -7;
    sb_error error;
    int id = -1;
    link[0] = term(p.tip, 2, 1);
    link[1] = term(p.second, 2, -2);
    link[2] = term(nearest_node(&p.mesh, 0.04, 0, 0), 2, 1);
    CHECK_OK(sb_body_add_constraint(p.body, link, 3, 0, &id, NULL));
    CHECK_RESULT(sb_body_step(p.body, REAL(0.01), &info), SB_ERROR_UNSUPPORTED);
    CHECK_INT(info.error.node, p.tip);
    CHECK_RESULT(sb_body_stable_step(p.body, &dt, &error), SB_ERROR_UNSUPPORTED);
    CHECK(error.node == p.tip && dt == -7);
    CHECK_OK(sb_body_remove_constraint(p.body, id, NULL));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), &info));
    end(&p);
}

CHECK_SUITE(schemes, {"one motion", test_one_motion}, {"a body on springs", test_bob},
            {"stiff springs shorten explicit steps", test_stiff}, {"forces balance", test_balance},
            {"constraints that move", test_moving_constraints}, {"multipliers balance", test_multipliers},
            {"undo leaves no trace", test_undo}, {"same bits for any threads", test_threads},
            {"no allocation", test_no_allocation}, {"300 violent steps", test_violence}, {"refusals", test_refusals});
