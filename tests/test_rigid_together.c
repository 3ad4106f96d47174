/* Free rigid bodies with all that else sits on a body: contact, constraints, cuts, changes of the mesh, each other. */
#include "cut_block.h"

#include "contact_scene.h"
#include "needle_scene.h"
#include "random_case.h"

static sb_mat3 ball(double inertia) { return sb_m3_scale(REAL(inertia), sb_m3_identity()); }

/* Nodes with a coordinate at a level. */
static int *level_nodes(const sb_mesh *mesh, int axis, double level, int *count)
{
    int *nodes = (int *)malloc((size_t)mesh->node_count * sizeof(int));
    *count = 0;
    for (int i = 0; i < mesh->node_count && nodes; i++)
        if (fabs((double)scene_component(mesh->nodes[i], axis) - level) < 1e-6)
            nodes[(*count)++] = i;
    return nodes;
}

static sb_rigid_motion motion_of(const sb_body *body, int id)
{
    sb_rigid_motion motion;
    memset(&motion, 0, sizeof motion);
    CHECK_OK(sb_body_rigid_motion(body, id, &motion));
    return motion;
}

static void print_error(const sb_error *error) { printf("  %s\n", error->message); }

/* ---- contact ---- */

/* A block that lies between two planes, on each side a rigid plate or none, with a load on the upper one: the planes
 * feel it, and the plates feel the tissue. k: which sides have plates; the planes press on their nodes. */
static void test_pressed(void)
{
    for (int k = 0; k < 6; k++) {
        const double side = 0.04;
        sb_body_def def = sb_default_body_def();
        sb_rigid_def rigid = sb_default_rigid_def();
        sb_tool_def floor = press_plane(0.3, sb_v3(0, 0, 0), 0);
        press p;
        int *nodes, count, id = 0, tool;
        double weight, total;
        sb_wrench wrench;
        sb_step_info info;
        def.material = k < 3 ? sb_material_corotated(REAL(5e3), REAL(0.3), 1000)
                             : sb_material_neo_hookean(REAL(5e3), REAL(0.3), 1000);
        def.damping_stiffness = REAL(0.02);
        def.tolerance = sb_max(REAL(1e-8), 100 * SB_EPSILON);
        def.gravity = sb_v3(0, 0, REAL(-9.81));
        p = press_make(scene_box(SB_TET4, 4, 4, 4, sb_v3(REAL(side), REAL(side), REAL(side)), 0), def, press_exact());
        tool = press_add(&p, &floor);
        nodes = level_nodes(&p.mesh, 2, k % 3 == 1 ? 0 : side, &count);
        rigid.mass = REAL(0.02);
        rigid.inertia = ball(1e-5);
        rigid.centre = sb_v3(REAL(side / 2), REAL(side / 2), k % 3 == 1 ? REAL(0) : REAL(side));
        rigid.nodes = nodes;
        rigid.node_count = count;
        CHECK_OK(sb_body_add_rigid(p.body, &rigid, &id, NULL));
        CHECK_OK(sb_body_set_rigid_load(p.body, id, sb_v3(0, 0, REAL(-0.3)), sb_v3(0, 0, 0)));
        for (int i = 0; i < 200; i++)
            if (!CHECK_OK(sb_body_step(p.body, REAL(0.02), &info))) {
                print_error(&info.error);
                break;
            }
        wrench = press_wrench(&p, tool);
        weight = 1000 * side * side * side * 9.81;
        total = 0.3 + weight + 0.02 * 9.81;
        CHECK_NEAR(fabs((double)wrench.force.z), total, scene_tolerance(1e-4, 1e5) * total);
        CHECK_NEAR(motion_of(p.body, id).force.z, 0.3 + 0.02 * 9.81, scene_tolerance(1e-4, 1e5) * total);
        press_free(&p);
        free(nodes);
    }
}

/* ---- constraints ---- */

/* A block whose lower face is tied to a finer one's upper face, which hangs on a rigid body: what ties pull at goes
 * to it. */
static void test_tied(void)
{
    for (int k = 0; k < 4; k++) {
        static const sb_integrator kinds[] = {SB_EULER, SB_GENERALISED_ALPHA};
        sb_mesh mesh = scene_box(SB_HEX8, 2, 2, 2, sb_v3(REAL(0.2), REAL(0.2), REAL(0.2)), 0);
        sb_mesh second = scene_box(SB_HEX8, 3, 3, 2, sb_v3(REAL(0.2), REAL(0.2), REAL(0.2)), 0);
        sb_body_def def = sb_default_body_def();
        sb_rigid_def rigid = sb_default_rigid_def();
        sb_tie_report report;
        sb_body *body;
        int *hung, hung_count, *slaves, slave_count = 0, *faces, face_count = 0, first = mesh.node_count, id = 0;
        double weight, total;
        sb_boundary boundary;
        for (int i = 0; i < second.node_count; i++)
            second.nodes[i].z += REAL(0.2);
        CHECK_OK(sb_mesh_append(&mesh, &second, NULL));
        def.mesh = &mesh;
        def.material = k < 2 ? sb_material_corotated(REAL(1e5), REAL(0.3), 1000)
                             : sb_material_neo_hookean(REAL(1e5), REAL(0.3), 1000);
        def.integrator = kinds[k % 2];
        def.spectral_radius = 0;
        def.tolerance = REAL(scene_tolerance(1e-11, 64));
        def.newton_tolerance = REAL(scene_tolerance(1e-11, 64));
        def.gravity = sb_v3(REAL(0.5), 0, -1);
        def.damping_mass = 20;
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 2, 0, SB_XYZ);
        hung = level_nodes(&mesh, 2, 0.2, &hung_count);
        slaves = (int *)malloc((size_t)mesh.node_count * sizeof(int));
        for (int i = 0, all = hung_count; i < all; i++) {
            if (i == 0)
                hung_count = 0;
            if (hung[i] >= first)
                slaves[slave_count++] = hung[i];
            else
                hung[hung_count++] = hung[i];
        }
        CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL));
        faces = (int *)malloc((size_t)boundary.surface.element_count * 4 * sizeof(int));
        for (int f = 0; f < boundary.surface.element_count; f++) {
            int upper = 0;
            for (int a = 0; a < 4; a++) {
                int node = boundary.surface.elements[4 * f + a];
                upper += node < first && fabs((double)mesh.nodes[node].z - 0.2) < 1e-6;
            }
            if (upper == 4)
                memcpy(faces + 4 * face_count++, boundary.surface.elements + 4 * f, 4 * sizeof(int));
        }
        CHECK_OK(
            sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, REAL(0.01), SB_TIE_ALL, &report, NULL));
        rigid.mass = 1;
        rigid.inertia = ball(0.01);
        rigid.centre = sb_v3(REAL(0.1), REAL(0.1), REAL(0.2));
        rigid.nodes = slaves;
        rigid.node_count = 1;
        CHECK_RESULT(sb_body_add_rigid(body, &rigid, &id, NULL), SB_ERROR_ARGUMENT);
        rigid.nodes = hung;
        rigid.node_count = hung_count;
        CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
        for (int i = 0; i < 400; i++)
            if (!CHECK_OK(sb_body_step(body, REAL(0.02), NULL)))
                break;
        weight = 1000 * 0.2 * 0.2 * 0.4;
        total = weight + 1;
        { /* the floor holds all of it */
            sb_vec3 held = scene_sum(sb_body_reactions(body), mesh.node_count);
            CHECK_NEAR(held.z, total, scene_tolerance(2e-5, 1e5) * total);
            CHECK_NEAR(held.x, -0.5 * total, scene_tolerance(2e-5, 1e5) * total);
        }
        CHECK_NEAR(motion_of(body, id).force.z, 1, scene_tolerance(2e-5, 1e5) * total);
        CHECK_NEAR(motion_of(body, id).force.x, -0.5, scene_tolerance(2e-5, 1e5) * total);
        CHECK_NEAR(sb_v3_norm(motion_of(body, id).torque), 0, scene_tolerance(2e-5, 1e5) * total);
        sb_boundary_free(&boundary);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        sb_mesh_free(&second);
        free(hung), free(slaves), free(faces);
    }
}

/* ---- several ---- */

/* Rigid bodies on both ends of a bar and in its middle, side by side in elements of their own, that nothing else
 * holds: a load on one is felt by all, and momentum is the load's. */
static void test_several(void)
{
    for (int k = 0; k < 3; k++) {
        static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
        sb_mesh mesh = scene_box(SB_TET4, 8, 2, 2, sb_v3(REAL(0.8), REAL(0.1), REAL(0.1)), 0);
        sb_body_def def = sb_default_body_def();
        sb_vec3 sum = sb_v3(0, 0, 0), force = sb_v3(1, REAL(0.5), REAL(-0.3));
        const double masses[4] = {1, 2, 0.5, 3}, levels[4] = {0, 0.4, 0.5, 0.8};
        int ids[4];
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_corotated(REAL(1e5), REAL(0.3), 1000);
        def.integrator = kinds[k];
        def.tolerance = REAL(scene_tolerance(1e-12, 64));
        body = scene_body(&def);
        for (int i = 0; i < 4; i++) {
            sb_rigid_def rigid = sb_default_rigid_def();
            int count, *nodes = level_nodes(&mesh, 0, levels[i], &count);
            rigid.mass = REAL(masses[i]);
            rigid.inertia = ball(0.01);
            rigid.centre = sb_v3(REAL(levels[i]), REAL(0.05), REAL(0.05));
            rigid.nodes = nodes;
            rigid.node_count = count;
            CHECK_OK(sb_body_add_rigid(body, &rigid, ids + i, NULL));
            free(nodes);
        }
        CHECK_OK(sb_body_set_rigid_load(body, ids[0], force, sb_v3(REAL(0.02), 0, 0)));
        for (int i = 0; i < 100; i++)
            CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        for (int i = 0; i < 4; i++)
            sum = sb_v3_madd(sum, REAL(masses[i]), motion_of(body, ids[i]).velocity);
        for (int e = 0; e < mesh.element_count; e++)
            for (int a = 0; a < 4; a++)
                sum = sb_v3_madd(sum, REAL(250) * sb_mesh_element_volume(&mesh, e),
                                 sb_body_velocities(body)[mesh.elements[4 * e + a]]);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sum, sb_v3_scale(REAL(0.2), force))), 0, scene_tolerance(1e-8, 1e5));
        CHECK((double)motion_of(body, ids[3]).velocity.x > 1e-3);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* A weight at the tip of a soft cantilever swings under gravity, by large turns: energy is kept as well as the scheme
 * does, and shorter steps go the same way. */
static void test_swing(void)
{
    double places[3][2];
    for (int k = 0; k < 4; k++) {
        int alpha = k >= 2, steps = k % 2 ? 600 : 300;
        sb_mesh mesh = scene_box(SB_HEX8, 8, 1, 1, sb_v3(REAL(0.4), REAL(0.05), REAL(0.05)), 0);
        sb_body_def def = sb_default_body_def();
        sb_rigid_def rigid = sb_default_rigid_def();
        int count, id = 0, *nodes = level_nodes(&mesh, 0, 0.4, &count), most = 0;
        double before = 0, worst = 0, turned = 0;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_neo_hookean(REAL(2e5), REAL(0.3), 1000);
        def.integrator = alpha ? SB_GENERALISED_ALPHA : SB_NEWMARK;
        def.gravity = sb_v3(0, 0, REAL(-9.81));
        def.newton_tolerance = REAL(scene_tolerance(1e-9, 1e3));
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        rigid.mass = 0.5;
        rigid.inertia.m[0][0] = REAL(2e-4), rigid.inertia.m[1][1] = REAL(3e-4), rigid.inertia.m[2][2] = REAL(4e-4);
        rigid.centre = sb_v3(REAL(0.43), REAL(0.04), REAL(0.03)); /* beside the axis: it twists, too */
        rigid.nodes = nodes;
        rigid.node_count = count;
        CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
        for (int i = 0; i < steps; i++) {
            sb_rigid_motion m;
            sb_energy energy = {0, 0, 0};
            sb_step_info info;
            sb_vec3 w;
            double sum;
            if (!CHECK_OK(sb_body_step(body, REAL(0.6 / steps), &info))) {
                print_error(&info.error);
                break;
            }
            most = info.newton_iterations > most ? info.newton_iterations : most;
            m = motion_of(body, id);
            CHECK_OK(sb_body_energy(body, &energy));
            w = sb_quat_rotate(sb_quat_conjugate(m.turn), m.spin);
            sum = (double)energy.elastic + (double)energy.kinetic + 0.25 * (double)sb_v3_dot(m.velocity, m.velocity) +
                  1e-4 * (double)(w.x * w.x) + 1.5e-4 * (double)(w.y * w.y) + 2e-4 * (double)(w.z * w.z) +
                  0.5 * 9.81 * (double)(m.centre.z - rigid.centre.z);
            for (int e = 0; e < mesh.element_count; e++)
                for (int a = 0; a < 8; a++)
                    sum += 1000.0 / 8 * (double)sb_mesh_element_volume(&mesh, e) * 9.81 *
                           (double)sb_body_displacements(body)[mesh.elements[8 * e + a]].z;
            worst = fmax(worst, fabs(sum - before));
            turned = fmax(turned, 2 * acos(fmin(1, fabs((double)m.turn.w))));
            if (i == 0)
                worst = fabs(sum);
        }
        if (k != 3) {
            places[k][0] = (double)motion_of(body, id).centre.x;
            places[k][1] = (double)motion_of(body, id).centre.z;
        }
        printf("  swing, %s, %d steps: turned by %.2f rad, energy off by %.2e J of %.2e, at most %d iterations\n",
               alpha ? "generalised alpha" : "Newmark", steps, turned, worst, 0.5 * 9.81 * 0.3, most);
        CHECK(turned > 0.5);
        CHECK(worst < (k % 2 ? 0.01 : 0.03) * 0.5 * 9.81 * 0.3);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(nodes);
    }
    CHECK_NEAR(places[0][0], places[1][0], 2e-3);
    CHECK_NEAR(places[0][1], places[1][1], 2e-3);
}

/* ---- changes of the mesh ---- */

static int hang_end(const block *b, double mass, int *count)
{
    sb_rigid_def rigid = sb_default_rigid_def();
    int id = -1, *nodes = level_nodes(&b->mesh, 0, (double)block_size.x, count);
    rigid.mass = REAL(mass);
    rigid.inertia = ball(1e-5);
    rigid.centre = sb_v3(block_size.x, block_size.y / 2, block_size.z / 2);
    rigid.nodes = nodes;
    rigid.node_count = *count;
    CHECK_OK(sb_body_add_rigid(b->body, &rigid, &id, NULL));
    free(nodes);
    return id;
}

/* Nodes at a level of the rest shape are where the rigid body has them; how many there are. */
static int check_hung(const block *b, int id, double level, double mass)
{
    sb_rigid_motion m = motion_of(b->body, id);
    const sb_vec3 *rest = sb_body_rest_positions(b->body), *now = sb_body_positions(b->body);
    sb_vec3 home = sb_v3(block_size.x, block_size.y / 2, block_size.z / 2);
    int count = 0;
    (void)mass;
    for (int i = 0; i < sb_body_node_count(b->body); i++)
        if (sb_body_node_in_use(b->body, i) && fabs((double)rest[i].x - level) < 1e-9) {
            sb_vec3 to = sb_v3_add(m.centre, sb_quat_rotate(m.turn, sb_v3_sub(rest[i], home)));
            count += (double)sb_v3_norm(sb_v3_sub(to, now[i])) < scene_tolerance(1e-13, 8);
        }
    return count;
}

/* A block is cut across, and then through the face that hangs: its parts hang on, and a piece that is cut off falls
 * alone. States of it go on with the same bits. */
static void test_cut(void)
{
    for (int k = 0; k < 4; k++) {
        block_options options = block_default(k % 2 ? 2 : 1);
        block b;
        int count, id, all;
        size_t size;
        void *state;
        uint64_t hash;
        options.integrator = k < 2 ? SB_EULER : SB_NEWMARK;
        b = block_make(&options);
        CHECK_OK(sb_body_set_gravity(b.body, sb_v3(0, 0, REAL(-2))));
        scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
        id = hang_end(&b, 0.02, &count);
        block_step(&b, 3);
        CHECK_INT(check_hung(&b, id, (double)block_size.x, 0.02), count);
        /* along the block, through the end that hangs */
        block_cut_plane(&b, sb_v3(REAL(0.06), REAL(0.021), REAL(0.025)), sb_v3(REAL(0.05), 1, REAL(0.02)));
        CHECK_OK(sb_body_live_check(b.body, NULL));
        block_step(&b, 3);
        all = check_hung(&b, id, (double)block_size.x, 0.02);
        CHECK(all >= count);
        size = sb_body_state_size(b.body);
        state = malloc(size);
        CHECK_OK(sb_body_state_save(b.body, state, size));
        block_step(&b, 3);
        hash = sb_body_state_hash(b.body);
        CHECK_OK(sb_body_state_load(b.body, state, size, NULL));
        block_step(&b, 3);
        CHECK(sb_body_state_hash(b.body) == hash);
        /* and across: what hangs falls with the rigid body, and turns with it */
        block_cut_plane(&b, sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.05), REAL(0.03)));
        block_step(&b, 20);
        CHECK(check_hung(&b, id, (double)block_size.x, 0.02) >= count);
        CHECK((double)motion_of(b.body, id).velocity.z < -0.1);
        CHECK(scene_all_finite(sb_body_positions(b.body), sb_body_node_count(b.body)));
        /* back to before, which has another mesh */
        CHECK_OK(sb_body_state_load(b.body, state, size, NULL));
        block_step(&b, 3);
        CHECK(sb_body_state_hash(b.body) == hash);
        free(state);
        block_free(&b);
    }
}

/* An edge between nodes that hang is split, and mended again; a node that hangs is not to be removed. */
static void test_change(void)
{
    block_options options = block_default(1);
    block b = block_make(&options);
    sb_body_change *change;
    sb_error error;
    sb_real half[2] = {REAL(0.5), REAL(0.5)};
    int count, id, pair[2] = {-1, -1}, middle = -1, done = 0, removed = 0;
    uint64_t hash, version;
    scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
    id = hang_end(&b, 0.02, &count);
    sb_cut_destroy(b.cut); /* which would be the mesh's */
    b.cut = NULL;
    block_step(&b, 2);
    for (int e = 0; e < b.mesh.element_count && pair[1] < 0; e++) {
        int found = 0;
        for (int a = 0; a < 4; a++)
            if (fabs((double)(b.mesh.nodes[b.mesh.elements[4 * e + a]].x - block_size.x)) < 1e-9 && found < 2)
                pair[found++] = b.mesh.elements[4 * e + a];
        pair[1] = found == 2 ? pair[1] : -1;
    }
    hash = sb_body_state_hash(b.body);
    CHECK_OK(sb_body_change_begin(b.body, &change, &error));
    for (int e = 0; e < sb_body_element_count(b.body); e++) {
        const int *nodes = sb_body_cell_nodes(b.body, e);
        int has = 0;
        for (int a = 0; a < 4 && nodes; a++)
            has |= nodes[a] == pair[0];
        if (has) {
            CHECK_OK(sb_body_change_remove_cell(change, e, &error));
            removed++;
        }
    }
    CHECK(removed > 0);
    CHECK_OK(sb_body_change_remove_node(change, pair[0], NULL, NULL, 0, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, pair[0]);
    CHECK(strstr(error.message, "hangs on rigid body") != NULL);
    sb_body_change_cancel(change);
    CHECK(sb_body_state_hash(b.body) == hash);
    CHECK_OK(sb_body_change_begin(b.body, &change, &error));
    CHECK_OK(sb_body_change_add_node(change,
                                     sb_v3_scale(REAL(0.5), sb_v3_add(b.mesh.nodes[pair[0]], b.mesh.nodes[pair[1]])),
                                     pair, half, 2, 0, &middle, &error));
    for (int e = 0; e < b.mesh.element_count; e++) {
        const int *nodes = b.mesh.elements + 4 * e;
        int has = 0;
        for (int a = 0; a < 4; a++)
            has += nodes[a] == pair[0] || nodes[a] == pair[1];
        for (int side = 0; side < 2 && has == 2; side++) {
            sb_change_cell cell = sb_default_change_cell();
            int corners[4];
            for (int a = 0; a < 4; a++)
                corners[a] = nodes[a] == pair[side] ? middle : nodes[a];
            cell.nodes = corners;
            cell.parent = e;
            CHECK_OK(side == 0 ? sb_body_change_replace_cell(change, e, &cell, &error)
                               : sb_body_change_add_cell(change, &cell, NULL, &error));
            done++;
        }
    }
    CHECK(done > 0);
    if (!CHECK_OK(sb_body_change_commit(change, &error)))
        print_error(&error);
    version = (uint64_t)sb_body_mesh_version(b.body);
    CHECK(version > 0);
    CHECK_RESULT(sb_body_hold(b.body, &middle, 1, SB_X, &error), SB_ERROR_ARGUMENT); /* it hangs, too */
    block_step(&b, 5);
    CHECK_INT(check_hung(&b, id, (double)block_size.x, 0.02), count + 1);
    block_free(&b);
}

/* ---- needles ---- */

/* A needle goes into a block with a rigid plate below, which feels it; and towards nodes in its way that hang. */
static void test_needle(void)
{
    for (int k = 0; k < 4; k++) {
        needle_scene s = needle_scene_default();
        sb_rigid_def rigid = sb_default_rigid_def();
        int *nodes, count = 0, id = 0, in_the_way = k % 2, done = 0;
        double level = in_the_way ? 0.02 : 0;
        sb_rigid_motion m, before;
        sb_result result = SB_OK;
        sb_vec3 pushed;
        s.needle_def.follow = k < 2 ? NDL_REMESH : NDL_EMBED;
        s.shake = 0;
        if (!needle_scene_make(&s))
            return;
        nodes = level_nodes(&s.mesh, 2, level, &count);
        for (int i = 0, all = count; i < all; i++) {
            if (i == 0)
                count = 0;
            if (!needle_scene_is_side(&s, s.mesh.nodes[nodes[i]]))
                nodes[count++] = nodes[i];
        }
        rigid.mass = REAL(0.005);
        rigid.inertia = ball(1e-6);
        rigid.centre = sb_v3(REAL(0.02), REAL(0.02), REAL(level));
        rigid.nodes = nodes;
        rigid.node_count = count;
        CHECK_OK(sb_body_add_rigid(s.body, &rigid, &id, NULL));
        for (int i = 0; i < 35 && result == SB_OK; i++) {
            ndl_command command = needle_command(0.05, 0);
            uint64_t hash = sb_body_state_hash(s.body);
            before = motion_of(s.body, id);
            result = ndl_step(s.body, s.needles, s.count, REAL(0.02), &command, &s.info, &s.error);
            done += result == SB_OK;
            if (result != SB_OK && (in_the_way == 0 || !CHECK(sb_body_state_hash(s.body) == hash)))
                printf("  needle, %d: %s\n", k, s.error.message);
        }
        m = motion_of(s.body, id);
        if (k == 1) { /* it would take nodes that it came to */
            CHECK(result == SB_ERROR_INDEX && strstr(s.error.message, "hangs on rigid body") != NULL);
        } else if (CHECK_INT(done, 35) && s.info.substeps < 2) { /* what tissue and needle push it by moves it */
            pushed = sb_v3_scale(rigid.mass / REAL(0.02), sb_v3_sub(m.velocity, before.velocity));
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(pushed, m.force)), 0, 3e-5); /* of 0.2 N with NDL_EMBED */
        }
        CHECK(done > 10 && sb_v3_is_finite(m.centre));
        for (int i = 0; i < count; i++) {
            sb_vec3 arm = sb_v3_sub(s.mesh.nodes[nodes[i]], rigid.centre);
            sb_vec3 to = sb_v3_add(m.centre, sb_quat_rotate(m.turn, arm));
            if (!in_the_way)
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(to, sb_body_positions(s.body)[nodes[i]])), 0,
                           scene_tolerance(1e-14, 4));
        }
        free(nodes);
        needle_scene_free(&s);
    }
}

/* ---- random cases ---- */

/* Blocks of random elements, materials, schemes and sizes with a rigid body of random mass on one node or many. Steps
 * go on, keep nodes where they hang, and momentum where nothing holds the block; those that fail change nothing. */
static void test_random(void)
{
    static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    static const sb_element_type types[] = {SB_TET4, SB_HEX8, SB_TET10};
    int failed = 0, steps = 0, rounds = check_rounds(60);
    for (int round = 0; round < rounds; round++) {
        unsigned long long seed = 1000 + (unsigned long long)round;
        double size = pow(10, 3 * (round % 3) - 3), mass, tissue, dt, gravity = 0, worst = 0;
        const char *name;
        sb_mesh mesh = scene_box(types[random_below(&seed, 3)], 4, 2, 2,
                                 sb_v3(REAL(2 * size), REAL(0.6 * size), REAL(0.5 * size)), 0.1);
        sb_body_def def = sb_default_body_def();
        sb_rigid_def rigid = sb_default_rigid_def();
        sb_rigid_motion m;
        sb_vec3 *arms;
        int *nodes = (int *)malloc((size_t)mesh.node_count * sizeof(int)), count = 0, id = 0, held = round % 2;
        int wanted = round % 4 == 0 ? 1 + random_below(&seed, 3) : 1 + random_below(&seed, mesh.node_count / 2);
        sb_body *body;
        def.mesh = &mesh;
        def.material = random_material(&seed, &name);
        def.integrator = kinds[random_below(&seed, 3)];
        def.tolerance = REAL(scene_tolerance(1e-9, 100));
        def.max_iterations = 3000;
        def.newton_tolerance = REAL(scene_tolerance(1e-9, 1e3));
        body = scene_body(&def);
        if (held)
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < 50 * wanted && count < wanted; i++) {
            int node = random_below(&seed, mesh.node_count), again = sb_body_supports(body)[node] != 0;
            for (int j = 0; j < count; j++)
                again |= nodes[j] == node;
            if (!again)
                nodes[count++] = node;
        }
        tissue = (double)sb_body_mass(body);
        mass = tissue * random_scale(&seed, 1e-3, 1e3);
        /* what a wave takes along the block */
        dt = size * sqrt((double)def.material.density / (double)sb_material_young(&def.material)) *
             random_scale(&seed, 0.1, 3);
        gravity = 0.02 * (double)sb_material_young(&def.material) / ((double)def.material.density * size) /
                  (1 + mass / tissue);
        CHECK_OK(sb_body_set_gravity(body, sb_v3_scale(REAL(gravity), random_direction(&seed))));
        rigid.mass = REAL(mass);
        rigid.inertia = ball(mass * size * size * random_scale(&seed, 0.03, 1));
        rigid.inertia.m[1][1] *= REAL(1.3), rigid.inertia.m[2][2] *= REAL(1.7);
        rigid.centre = sb_v3(REAL(check_random_in(&seed, 0, 2 * size)), REAL(check_random_in(&seed, 0, size)), 0);
        rigid.turn = random_turn(&seed);
        rigid.nodes = nodes;
        rigid.node_count = count;
        rigid.velocity = sb_v3_scale(REAL(0.02 * size / dt), random_direction(&seed));
        rigid.spin = sb_v3_scale(REAL(0.02 / dt), random_direction(&seed));
        CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
        arms = (sb_vec3 *)malloc((size_t)count * sizeof *arms);
        m = motion_of(body, id);
        for (int i = 0; i < count; i++)
            arms[i] = sb_quat_rotate(sb_quat_conjugate(m.turn), sb_v3_sub(mesh.nodes[nodes[i]], m.centre));
        for (int i = 0; i < 20; i++) {
            uint64_t hash = sb_body_state_hash(body);
            sb_step_info info;
            steps++;
            if (sb_body_step(body, REAL(dt), &info) != SB_OK) {
                CHECK(sb_body_state_hash(body) == hash);
                if (failed++ < 5)
                    printf("  round %d, %s, scheme %d, %d nodes, mass %.2g of tissue's, step %d: %s\n", round, name,
                           (int)def.integrator, count, mass / tissue, i, info.error.message);
                break;
            }
            m = motion_of(body, id);
            for (int j = 0; j < count; j++) {
                sb_vec3 at = sb_v3_add(m.centre, sb_quat_rotate(m.turn, arms[j]));
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(at, sb_body_positions(body)[nodes[j]])) / size);
            }
        }
        CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 64));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(nodes), free(arms);
    }
    printf("  random: %d of %d cases ended with a step that failed (%d steps)\n", failed, rounds, steps);
    CHECK(failed <= rounds / 10);
}

CHECK_SUITE(rigid_together, {"contact", test_pressed}, {"tied meshes", test_tied}, {"several", test_several},
            {"a swing", test_swing}, {"cuts", test_cut}, {"changes of the mesh", test_change}, {"needles", test_needle},
            {"random cases", test_random});
