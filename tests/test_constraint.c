/* Constraints between degrees of freedom and ties between faces: closed forms, merged meshes, patches, balance,
 * chains and circles, undo, memory, violence. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const sb_element_type element_types[] = {SB_TET4, SB_TET10, SB_HEX8};
enum { ELEMENT_TYPES = 3, MANY = 4096 };

/* ---- scenes ---- */

static void set_component(sb_vec3 *v, int axis, sb_real value)
{
    if (axis == 0)
        v->x = value;
    else if (axis == 1)
        v->y = value;
    else
        v->z = value;
}

static sb_constraint_term term(int node, int axis, double coefficient)
{
    sb_constraint_term made;
    made.node = node;
    made.axis = axis;
    made.coefficient = REAL(coefficient);
    return made;
}

/* Adds a node of no element. */
static int add_node(sb_mesh *mesh, sb_vec3 x)
{
    sb_vec3 *nodes = (sb_vec3 *)malloc(((size_t)mesh->node_count + 1) * sizeof(sb_vec3));
    memcpy(nodes, mesh->nodes, (size_t)mesh->node_count * sizeof(sb_vec3));
    nodes[mesh->node_count] = x;
    free(mesh->nodes);
    mesh->nodes = nodes;
    return mesh->node_count++;
}

/* Nodes first <= i < last on a plane; returns how many. */
static int plane_nodes(const sb_mesh *mesh, int first, int last, int axis, double value, int *nodes)
{
    int count = 0;
    for (int i = first; i < last; i++)
        if (fabs((double)scene_component(mesh->nodes[i], axis) - value) < 1e-6)
            nodes[count++] = i;
    return count;
}

/* Corners of the boundary faces of the elements among nodes < last whose corners lie on the plane x = value. */
static int plane_faces(const sb_mesh *mesh, int last, double value, int *faces)
{
    sb_boundary boundary;
    int count = 0;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return 0;
    for (int f = 0; f < boundary.surface.element_count; f++) {
        int corners = sb_element_corner_count(boundary.surface.element_type), on = 1;
        const int *face = boundary.surface.elements + f * sb_element_node_count(boundary.surface.element_type);
        for (int k = 0; k < corners; k++)
            on = on && face[k] < last && fabs((double)mesh->nodes[face[k]].x - value) < 1e-6;
        for (int k = 0; k < corners && on; k++)
            faces[corners * count + k] = face[k];
        count += on;
    }
    sb_boundary_free(&boundary);
    return count;
}

/* Two blocks of size 0.1 that meet at x = 0.1; *split: nodes of the first. */
static sb_mesh two_blocks(sb_element_type type, int first_cells, int second_cells, double shake, int *split)
{
    sb_vec3 size = sb_v3(REAL(0.1), REAL(0.1), REAL(0.1));
    sb_mesh mesh = scene_box(type, 2, first_cells, first_cells, size, shake);
    sb_mesh second = scene_box(type, 3, second_cells, second_cells, size, shake);
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += REAL(0.1);
    *split = mesh.node_count;
    CHECK_OK(sb_mesh_append(&mesh, &second, NULL));
    sb_mesh_free(&second);
    return mesh;
}

/* Ties the second block to the first. */
static sb_tie_report tie_blocks(sb_body *body, const sb_mesh *mesh, int split)
{
    static int faces[MANY], slaves[MANY];
    int corners = mesh->element_type == SB_HEX8 ? 4 : 3, face_count = plane_faces(mesh, split, 0.1, faces);
    int slave_count = plane_nodes(mesh, split, mesh->node_count, 0, 0.1, slaves);
    sb_tie_report report;
    sb_error error;
    memset(&report, 0, sizeof report);
    if (sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, -1, SB_TIE_ALL, &report, &error) !=
        SB_OK) {
        printf("%s\n", error.message);
        CHECK(report.tied_count > 0);
    }
    CHECK_INT(report.tied_count, slave_count);
    CHECK_INT(report.free_count, 0);
    CHECK_INT(report.farthest_node, -1);
    CHECK_NEAR(report.largest_gap, 0, scene_tolerance(1e-12, 10));
    return report;
}

/* A def whose steps solve as exactly as sb_real allows. */
static sb_body_def exact_def(const sb_mesh *mesh, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-13);
    def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
    def.max_iterations = 5000;
    return def;
}

static sb_static_options exact_options(void)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-13);
    return options;
}

static sb_material soft(void) { return sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000)); }

/* ---- closed forms ---- */

/* The top of a block follows a reference node, is given values, or is prescribed: the same shape and forces. */
static void test_shear(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 3, 3, 3, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0.1);
        int reference = add_node(&mesh, sb_v3(REAL(0.05), REAL(0.05), REAL(0.2))), top[MANY], count, first = -1;
        sb_vec3 go = sb_v3(REAL(0.01), REAL(0.002), REAL(-0.005)), force = sb_v3(0, 0, 0), lambda = force;
        sb_body_def def = exact_def(&mesh, sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000)));
        sb_static_options options = exact_options();
        sb_body *body[3];
        double worst = 0;
        count = plane_nodes(&mesh, 0, reference, 2, 0.1, top);
        for (int k = 0; k < 3; k++) {
            body[k] = scene_body(&def);
            scene_fix_plane(body[k], &mesh, 2, 0, SB_XYZ);
            for (int i = 0; i < count && k > 0; i++)
                for (int axis = 0; axis < 3; axis++) {
                    sb_constraint_term terms[2];
                    int id = -1;
                    terms[0] = term(top[i], axis, 2);
                    terms[1] = term(reference, axis, -2);
                    if (i % 7 && k == 1) /* many at a time in test_periodic */
                        continue;
                    CHECK_OK(sb_body_add_constraint(body[k], terms, 3 - k,
                                                    k == 1 ? REAL(0) : 2 * scene_component(go, axis), &id, NULL));
                    if (k == 2 && first < 0)
                        first = id;
                }
        }
        for (int i = 0; i < count; i++) /* the rest of body 1 by supports: both kinds side by side */
            CHECK_OK(sb_body_prescribe(body[0], top + i, 1, SB_XYZ, &go, 1));
        for (int i = 0; i < count; i++)
            if (i % 7)
                CHECK_OK(sb_body_prescribe(body[1], top + i, 1, SB_XYZ, &go, 1));
        CHECK_OK(sb_body_prescribe(body[1], &reference, 1, SB_XYZ, &go, 1));
        for (int k = 0; k < 3; k++)
            CHECK_OK(sb_body_solve_static(body[k], &options, NULL));
        for (int k = 1; k < 3; k++)
            worst =
                fmax(worst, scene_distance(sb_body_displacements(body[0]), sb_body_displacements(body[k]), reference));
        CHECK_NEAR(worst, 0, scene_tolerance(1e-10, 2000) * 0.01);
        for (int i = 0; i < count; i++) {
            if (i % 7 == 0)
                force = sb_v3_add(force, sb_body_reactions(body[0])[top[i]]);
            for (int axis = 0; axis < 3; axis++) {
                sb_real f = 0;
                CHECK_OK(sb_body_constraint_force(body[2], first + 3 * i + axis, &f));
                CHECK_NEAR(2 * f, scene_component(sb_body_reactions(body[0])[top[i]], axis),
                           scene_tolerance(1e-9, 2e4));
                set_component(&lambda, axis, scene_component(lambda, axis) + 2 * f);
            }
        }
        CHECK(sb_v3_norm(force) > REAL(0.01));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(force, sb_body_reactions(body[1])[reference])), 0, scene_tolerance(1e-9, 2e4));
        CHECK_NEAR(sb_v3_norm(sb_v3_add(lambda, scene_sum(sb_body_reactions(body[2]), mesh.node_count))), 0,
                   scene_tolerance(1e-9, 2e4));
        for (int k = 0; k < 3; k++)
            sb_body_destroy(body[k]);
        sb_mesh_free(&mesh);
    }
}

/* A periodic cell under a mean strain: opposite faces differ by H L, edge and corner nodes through chains. The shape
 * of a homogeneous cell is u = H x, and the multipliers' work is twice the energy. */
static void test_periodic_cell(void)
{
    static const double h[3][3] = {{0.02, 0.03, -0.01}, {0.01, -0.03, 0.02}, {0.015, 0.005, 0.01}};
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 3, 3, 3, sb_v3(1, 1, 1), 0.1);
        sb_body_def def = exact_def(&mesh, soft());
        sb_static_options options = exact_options();
        sb_constraint_term *terms = (sb_constraint_term *)malloc(MANY * sizeof *terms);
        int *counts = (int *)malloc(MANY * sizeof *counts), count = 0, first = -1, corner = -1;
        sb_real *values = (sb_real *)malloc(MANY * sizeof *values);
        sb_body *body = scene_body(&def);
        sb_energy energy;
        sb_error error;
        double worst = 0, work = 0;
        for (int i = 0; i < mesh.node_count; i++) {
            int face = mesh.nodes[i].x > REAL(0.999)   ? 0
                       : mesh.nodes[i].y > REAL(0.999) ? 1
                       : mesh.nodes[i].z > REAL(0.999) ? 2
                                                       : -1;
            sb_vec3 opposite = mesh.nodes[i];
            if (sb_v3_norm(opposite) < REAL(1e-6))
                corner = i;
            if (face < 0)
                continue;
            set_component(&opposite, face, 0);
            for (int j = 0; j < mesh.node_count; j++)
                for (int axis = 0; axis < 3 && sb_v3_norm(sb_v3_sub(mesh.nodes[j], opposite)) < REAL(1e-5); axis++) {
                    terms[2 * count] = term(i, axis, 1);
                    terms[2 * count + 1] = term(j, axis, -1);
                    values[count] = REAL(h[axis][face]);
                    counts[count++] = 2;
                }
        }
        CHECK_OK(sb_body_add_constraints(body, terms, counts, values, count, &first, NULL));
        CHECK_INT(sb_body_constraint_count(body), count);
        CHECK_RESULT(sb_body_solve_static(body, &options, NULL), SB_ERROR_UNCONSTRAINED);
        CHECK_OK(sb_body_fix_nodes(body, &corner, 1, SB_XYZ)); /* periodicity holds the rotations */
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i];
            for (int a = 0; a < 3; a++)
                worst = fmax(worst, fabs((double)scene_component(sb_body_displacements(body)[i], a) -
                                         (h[a][0] * (double)x.x + h[a][1] * (double)x.y + h[a][2] * (double)x.z)));
        }
        CHECK_NEAR(worst, 0, scene_tolerance(1e-10, 1000) * 0.06);
        for (int c = 0; c < count; c++) {
            sb_real f = 0;
            CHECK_OK(sb_body_constraint_force(body, first + c, &f));
            work += (double)f * (double)values[c];
        }
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(work / (2 * (double)energy.elastic), 1, scene_tolerance(1e-9, 3000));
        CHECK_NEAR(sb_v3_norm(sb_body_reactions(body)[corner]) / (sb_real)work, 0, scene_tolerance(1e-9, 3000));
        /* increments carry the values along evenly; then a value moves alone, and comes back */
        sb_body_reset(body);
        options.load_steps = 3;
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        CHECK_OK(sb_body_set_constraint_value(body, first, REAL(0.1)));
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        CHECK_OK(sb_body_set_constraint_value(body, first, values[0]));
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        CHECK_NEAR(scene_component(sb_v3_sub(sb_body_displacements(body)[terms[0].node],
                                             sb_body_displacements(body)[terms[1].node]),
                                   terms[0].axis),
                   values[0], scene_tolerance(1e-15, 10));
        /* one constraint of a chain removed and put back: another number, the same shape */
        CHECK_OK(sb_body_remove_constraint(body, first + count / 2, NULL));
        CHECK_RESULT(sb_body_remove_constraint(body, first + count / 2, &error), SB_ERROR_INDEX);
        CHECK_INT(sb_body_constraint_count(body), count - 1);
        CHECK_OK(sb_body_add_constraint(body, terms + 2 * (count / 2), 2, values[count / 2], &first, NULL));
        CHECK_INT(first, count);
        sb_body_clear_constraints(body);
        CHECK_INT(sb_body_constraint_count(body), 0);
        CHECK_RESULT(sb_body_constraint_force(body, first, values), SB_ERROR_INDEX);
        CHECK_RESULT(sb_body_solve_static(body, NULL, NULL), SB_ERROR_UNCONSTRAINED);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(terms);
        free(counts);
        free(values);
    }
}

/* A rigid end plate: tip nodes follow the rigid motion of three of them (two unknowns bend, one turns), a moment
 * arrives at the support, and all chains of multipliers balance. */
static void test_rigid_plate(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 5, 2, 2, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0);
    sb_body_def def = exact_def(&mesh, soft());
    sb_static_options options = exact_options();
    int tip[MANY], count = plane_nodes(&mesh, 0, mesh.node_count, 0, 0.1, tip), origin = -1, along_y = -1, along_z = -1;
    sb_vec3 load = sb_v3(REAL(0.001), 0, 0), *forces;
    const sb_vec3 *u;
    double torque = 0, reaction = 0;
    sb_body *body = scene_body(&def);
    for (int i = 0; i < count; i++) {
        sb_vec3 x = mesh.nodes[tip[i]];
        origin = x.y + x.z < REAL(1e-6) ? tip[i] : origin;
        along_y = x.y - x.z > REAL(0.0199) ? tip[i] : along_y;
        along_z = x.z - x.y > REAL(0.0199) ? tip[i] : along_z;
    }
    for (int i = 0; i < count; i++) { /* u_x is linear over the plate */
        sb_constraint_term terms[4];
        double y = (double)mesh.nodes[tip[i]].y / 0.02, z = (double)mesh.nodes[tip[i]].z / 0.02;
        if (tip[i] == origin || tip[i] == along_y || tip[i] == along_z)
            continue;
        terms[0] = term(tip[i], 0, 1);
        terms[1] = term(origin, 0, y + z - 1);
        terms[2] = term(along_y, 0, -y);
        terms[3] = term(along_z, 0, -z);
        CHECK_OK(sb_body_add_constraint(body, terms, 4, 0, NULL, NULL));
    }
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_forces(body, &along_z, 1, &load, 1));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    u = sb_body_displacements(body);
    forces = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    for (int i = 0; i < count; i++) {
        double y = (double)mesh.nodes[tip[i]].y / 0.02, z = (double)mesh.nodes[tip[i]].z / 0.02;
        CHECK_NEAR(u[tip[i]].x,
                   (double)u[origin].x + y * (double)(u[along_y].x - u[origin].x) +
                       z * (double)(u[along_z].x - u[origin].x),
                   scene_tolerance(1e-15, 1));
    }
    CHECK(u[along_z].x > u[origin].x);
    for (int i = 0; i < mesh.node_count; i++) { /* about y through the origin: F_x z - F_z x */
        sb_vec3 r = sb_body_reactions(body)[i], x = mesh.nodes[i];
        torque += (double)(r.x * x.z - r.z * x.x);
        reaction += (double)r.x;
    }
    CHECK_NEAR(reaction, -0.001, scene_tolerance(1e-12, 1000));
    CHECK_NEAR(torque, -0.001 * 0.02, scene_tolerance(1e-13, 30));
    free(forces);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- ties ---- */

static sb_mesh merged_copy(const sb_mesh *mesh)
{
    sb_mesh merged;
    memset(&merged, 0, sizeof merged);
    CHECK_OK(sb_mesh_copy(mesh, NULL, &merged, NULL));
    CHECK_OK(sb_mesh_merge_nodes(&merged, -1, NULL, NULL));
    return merged;
}

/* Largest difference of displacements between a body and one of the merged mesh, over the largest displacement. */
static double merged_distance(const sb_body *tied, const sb_mesh *mesh, const sb_body *whole, const sb_mesh *merged)
{
    double worst = 0, largest = 0;
    for (int i = 0; i < mesh->node_count; i++)
        for (int j = 0; j < merged->node_count; j++)
            if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], merged->nodes[j])) < REAL(1e-5)) {
                sb_vec3 u = sb_body_displacements(whole)[j];
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(tied)[i], u)));
                largest = fmax(largest, (double)sb_v3_norm(u));
            }
    CHECK(largest > 1e-6);
    return worst / largest;
}

/* Two blocks tied at matching faces move as their merged mesh. */
static void tied_as_merged(sb_element_type type, int model, int scheme)
{
    int split;
    sb_mesh mesh = two_blocks(type, 2, 2, 0.1, &split), merged = merged_copy(&mesh);
    sb_body_def def = exact_def(&mesh, model == 0   ? soft()
                                       : model == 1 ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                                                    : sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000)));
    sb_static_options options = exact_options();
    sb_body *tied, *whole;
    def.gravity = sb_v3(REAL(0.5), REAL(0.3), REAL(-2));
    def.integrator = scheme == 2 ? SB_NEWMARK : SB_EULER;
    def.mass = scheme == 1 ? SB_MASS_LUMPED : SB_MASS_CONSISTENT;
    def.damping_stiffness = REAL(0.005);
    def.damping_mass = REAL(0.1);
    CHECK_INT(merged.node_count < mesh.node_count, 1);
    tied = scene_body(&def);
    def.mesh = &merged;
    whole = scene_body(&def);
    tie_blocks(tied, &mesh, split);
    scene_fix_plane(tied, &mesh, 0, 0, SB_XYZ);
    scene_fix_plane(whole, &merged, 0, 0, SB_XYZ);
    if (scheme == 0) {
        CHECK_OK(sb_body_solve_static(tied, &options, NULL));
        CHECK_OK(sb_body_solve_static(whole, &options, NULL));
    }
    for (int s = 0; s < 5 && scheme > 0; s++) {
        CHECK_OK(sb_body_step(tied, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(whole, REAL(0.01), NULL));
    }
    CHECK_NEAR(merged_distance(tied, &mesh, whole, &merged), 0, scene_tolerance(1e-9, 5e4));
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(scene_sum(sb_body_reactions(tied), mesh.node_count),
                                    scene_sum(sb_body_reactions(whole), merged.node_count))),
               0, scene_tolerance(1e-8, 5e4));
    sb_body_destroy(tied);
    sb_body_destroy(whole);
    sb_mesh_free(&mesh);
    sb_mesh_free(&merged);
}

static void test_tied_as_merged(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int model = 0; model < 3; model++)
            for (int scheme = 0; scheme < 3; scheme++)
                if (model < 2 || t != 1) /* tet10 neo-Hookean adds time only */
                    tied_as_merged(element_types[t], model, scheme);
}

/* Linear displacement fields of the patches. */
enum patch_field {
    ANY_FIELD,   /* with the first block prescribed: the slaves and the second block follow it */
    NO_TRACTION, /* nothing but stress along the interface */
    ROTATION     /* no stress */
};

static sb_vec3 patch_displacement(enum patch_field field, sb_vec3 x)
{
    if (field == ANY_FIELD)
        return sb_v3(REAL(0.02) * x.x - REAL(0.03) * x.y + REAL(0.01) * x.z, REAL(0.04) * x.x + REAL(0.01) * x.z,
                     REAL(0.02) * x.y - REAL(0.01) * x.z);
    if (field == NO_TRACTION) /* nu = 0.3: e_xx = -3/7 (e_yy + e_zz), e_xy = e_xz = 0 */
        return sb_v3(REAL(-0.03 / 7) * x.x - REAL(0.02) * x.y, REAL(0.02) * x.x + REAL(0.03) * x.y + REAL(0.01) * x.z,
                     REAL(0.03) * x.y - REAL(0.02) * x.z);
    return sb_v3(REAL(0.01) - REAL(0.02) * x.y, REAL(0.02) * x.x + REAL(0.03) * x.z, REAL(-0.03) * x.y);
}

/* Linear displacements on the outside come out linear inside, across non-matching and curved interfaces, where the
 * field is prescribed on the master side or has no traction on the interface. */
static void linear_patch(sb_element_type type, int first, int second, double bulge, enum patch_field field)
{
    int split, held = 0, faces[MANY], slaves[MANY], face_count, slave_count, corners = type == SB_HEX8 ? 4 : 3;
    sb_mesh mesh = two_blocks(type, first, second, 0.1, &split);
    sb_body_def def = exact_def(&mesh, soft());
    sb_static_options options = exact_options();
    sb_tie_report report;
    sb_body *body;
    double worst = 0;
    face_count = plane_faces(&mesh, split, 0.1, faces);
    slave_count = plane_nodes(&mesh, split, mesh.node_count, 0, 0.1, slaves);
    for (int i = 0; i < mesh.node_count; i++) { /* the interface becomes a paraboloid, which quadratic faces hold */
        sb_vec3 *x = mesh.nodes + i;
        double y = (double)x->y - 0.05, z = (double)x->z - 0.05, depth = 1 - fabs((double)x->x - 0.1) / 0.1;
        x->x += REAL(bulge * (y * y + 0.5 * z * z) * depth);
    }
    body = scene_body(&def);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i], u = patch_displacement(field, x);
        int outside = x.x < REAL(1e-6) || x.x > REAL(0.2 - 1e-6) || x.y < REAL(1e-6) || x.y > REAL(0.1 - 1e-6) ||
                      x.z < REAL(1e-6) || x.z > REAL(0.1 - 1e-6) || (field == ANY_FIELD && i < split);
        if (outside)
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        held += outside;
    }
    CHECK_OK(sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, REAL(1e-5), SB_TIE_ALL, &report,
                               NULL));
    CHECK_INT(report.tied_count, slave_count);
    CHECK(report.supported_count > 0 && report.supported_count < slave_count);
    CHECK_INT(report.constraint_count, 3 * (slave_count - report.supported_count));
    CHECK_NEAR(report.largest_gap, 0, scene_tolerance(1e-11, 20));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = patch_displacement(field, mesh.nodes[i]);
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], u)));
    }
    CHECK(held < mesh.node_count);
    CHECK_NEAR(worst / 0.004, 0, scene_tolerance(bulge != 0 ? 1e-8 : 1e-10, 2000));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_linear_patch(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int field = 0; field < 2; field++) {
            enum patch_field which = field == 0 ? ANY_FIELD : NO_TRACTION;
            linear_patch(element_types[t], 3, 4, 0, which);
            linear_patch(element_types[t], 4, 3, 0, which);
            linear_patch(element_types[t], 3, 3, 0, which);
        }
    linear_patch(SB_TET10, 3, 4, 2, ANY_FIELD);
    linear_patch(SB_TET10, 4, 3, -2, ANY_FIELD);
    linear_patch(SB_TET10, 3, 4, 2, ROTATION);
    linear_patch(SB_TET10, 4, 3, -2, ROTATION);
}

/* Tension across tied faces is exact where they match or the slaves' grid refines the masters'; across others the
 * error is small and falls with the elements. */
static double tension_error(sb_element_type type, int first, int second)
{
    int split, corner[3] = {-1, -1, -1};
    sb_mesh mesh = two_blocks(type, first, second, 0, &split);
    sb_body_def def = exact_def(&mesh, soft());
    sb_static_options options = exact_options();
    sb_body *body = scene_body(&def);
    int faces[MANY], face_count = plane_faces(&mesh, mesh.node_count, 0.2, faces);
    double worst = 0;
    tie_blocks(body, &mesh, split);
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    for (int i = 0; i < split; i++)
        if (mesh.nodes[i].x < REAL(1e-6)) {
            if (mesh.nodes[i].y + mesh.nodes[i].z < REAL(1e-6))
                corner[0] = i;
            if (mesh.nodes[i].y - mesh.nodes[i].z > REAL(0.0999))
                corner[1] = i;
        }
    CHECK_OK(sb_body_fix_nodes(body, corner, 1, SB_XYZ));
    CHECK_OK(sb_body_fix_nodes(body, corner + 1, 1, SB_Z));
    CHECK_OK(sb_body_add_traction(body, faces, face_count, type == SB_HEX8 ? 4 : 3, sb_v3(50, 0, 0), NULL));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i], u = sb_v3(REAL(0.01) * x.x, REAL(-0.003) * x.y, REAL(-0.003) * x.z);
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], u)));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return worst / 0.002;
}

static void test_stress_patch(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        double coarse, fine;
        CHECK_NEAR(tension_error(element_types[t], 2, 2), 0, scene_tolerance(1e-10, 1e4));
        CHECK_NEAR(tension_error(element_types[t], 2, 4), 0, scene_tolerance(1e-10, 1e4));
        coarse = tension_error(element_types[t], 2, 3);
        fine = tension_error(element_types[t], 4, 6);
        printf("  %s across 2:3 tied faces: %.2g of the stretch, at half the size %.2g\n",
               sb_element_name(element_types[t]), coarse, fine);
        CHECK(coarse < 0.1 && fine < 0.8 * coarse);
    }
}

/* Gaps: kept without stress, or closed onto the faces; far nodes stay free or are refused. */
static void test_gaps(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int close = 0; close < 2; close++) {
            int split, faces[MANY], slaves[MANY], face_count, slave_count, corners = t == 2 ? 4 : 3;
            sb_mesh mesh = two_blocks(element_types[t], 2, 3, 0, &split);
            sb_body_def def = exact_def(&mesh, sb_material_corotated(REAL(5e3), REAL(0.3), REAL(1000)));
            sb_tie_report report;
            sb_energy energy;
            sb_error error;
            sb_body *body;
            face_count = plane_faces(&mesh, split, 0.1, faces);
            slave_count = plane_nodes(&mesh, split, mesh.node_count, 0, 0.1, slaves);
            for (int i = split; i < mesh.node_count; i++)
                mesh.nodes[i].x += REAL(0.001);
            body = scene_body(&def);
            CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, REAL(0.0005),
                                           SB_TIE_ALL, &report, &error),
                         SB_ERROR_ARGUMENT);
            CHECK_INT(error.node, slaves[0]);
            CHECK_OK(sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, REAL(0.0005), 0, &report,
                                       &error));
            CHECK_INT(report.free_count, slave_count);
            CHECK_INT(report.constraint_count, 0);
            CHECK(report.farthest_node >= split);
            CHECK_OK(sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, -1,
                                       SB_TIE_ALL | (close ? SB_TIE_CLOSE_GAPS : 0), &report, &error));
            CHECK_NEAR(report.largest_gap, 0.001, scene_tolerance(1e-12, 1));
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            CHECK_OK(sb_body_solve_static(body, NULL, NULL));
            CHECK_OK(sb_body_energy(body, &energy));
            CHECK_NEAR(energy.elastic, 0, 1e-8); /* closing moves the free block without strain */
            for (int k = 0; k < slave_count; k++)
                CHECK_NEAR(sb_body_positions(body)[slaves[k]].x, close ? 0.1 : 0.101, 1e-6);
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* A static solve knows what ties and other constraints hold: hinges and missing ones are found. */
static void test_static_check(void)
{
    int split, faces[MANY], slaves[MANY], face_count, slave_count, hinge[MANY], hinge_count = 0, id;
    sb_mesh mesh = two_blocks(SB_HEX8, 2, 2, 0, &split);
    sb_body_def def = exact_def(&mesh, soft());
    sb_body *body = scene_body(&def);
    sb_check_report check_report;
    sb_constraint_term stop[2];
    sb_step_info info;
    face_count = plane_faces(&mesh, split, 0.1, faces);
    slave_count = plane_nodes(&mesh, split, mesh.node_count, 0, 0.1, slaves);
    for (int k = 0; k < slave_count; k++)
        if (mesh.nodes[slaves[k]].z < REAL(1e-6))
            hinge[hinge_count++] = slaves[k];
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK_INT(info.error.node >= split, 1);
    CHECK_OK(sb_body_tie_faces(body, faces, face_count, 4, hinge, 1, -1, SB_TIE_ALL, NULL, NULL));
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK_OK(sb_body_tie_faces(body, faces, face_count, 4, hinge + 1, hinge_count - 1, -1, SB_TIE_ALL, NULL, NULL));
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK_INT(info.error.node >= split, 1);
    stop[0] = term(mesh.node_count - 1, 0, 1); /* far from the hinge's line */
    stop[1] = term(split - 1, 0, -1);
    CHECK_OK(sb_body_add_constraint(body, stop, 2, 0, &id, NULL));
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    CHECK_OK(sb_body_check(body, &check_report));
    CHECK_INT(check_report.warnings & SB_CHECK_UNSUPPORTED, 0);
    CHECK_OK(sb_body_remove_constraint(body, id, NULL));
    CHECK_OK(sb_body_check(body, &check_report));
    CHECK_INT(check_report.warnings & SB_CHECK_UNSUPPORTED, SB_CHECK_UNSUPPORTED);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- conservation ---- */

/* Two tied free blocks thrown about: momentum stays, and with Newmark the energy of linear ones. */
static void test_conservation(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int newmark = 0; newmark < 2; newmark++) {
            int split;
            sb_mesh mesh = two_blocks(element_types[t], 2, 3, 0.1, &split);
            sb_body_def def = exact_def(&mesh, soft());
            sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3)), momentum, before;
            sb_energy energy;
            double first = 0, worst = 0, lost = 0;
            sb_body *body;
            def.integrator = newmark ? SB_NEWMARK : SB_EULER;
            def.mass = SB_MASS_CONSISTENT;
            body = scene_body(&def);
            tie_blocks(body, &mesh, split);
            for (int i = 0; i < mesh.node_count; i++) /* linear, so that ties hold it */
                v[i] = sb_v3(REAL(0.1) + mesh.nodes[i].y, mesh.nodes[i].z, REAL(0.2) - 2 * mesh.nodes[i].x);
            CHECK_OK(sb_body_set_velocities(body, v));
            momentum = sb_body_momentum(body);
            for (int s = 0; s < 100; s++) {
                double total;
                if (!CHECK_OK(sb_body_step(body, REAL(0.005), NULL)))
                    break;
                CHECK_OK(sb_body_energy(body, &energy));
                total = (double)energy.elastic + (double)energy.kinetic;
                first = s == 0 ? total : first;
                worst = fmax(worst, fabs(total - first));
                before = sb_v3_sub(sb_body_momentum(body), momentum);
                lost = fmax(lost, (double)sb_v3_norm(before) / (double)sb_v3_norm(momentum));
            }
            CHECK_NEAR(lost, 0, scene_tolerance(1e-9, 1e4));
            if (newmark)
                CHECK_NEAR(worst / first, 0, scene_tolerance(1e-9, 1e4));
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
            free(v);
        }
}

/* Force and torque of reactions and loads balance the rates of momentum of a tied body that a tool shakes. */
static void dynamic_balance(int newmark, int material)
{
    int split, tool;
    sb_mesh mesh = two_blocks(SB_TET4, 2, 3, 0.1, &split);
    sb_body_def def = exact_def(&mesh, material == 0 ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                                                     : sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000)));
    sb_vec3 last = sb_v3(0, 0, 0);
    sb_body *body;
    tool = mesh.node_count - 1;
    def.gravity = sb_v3(REAL(0.3), 0, REAL(-9.81));
    def.integrator = newmark ? SB_NEWMARK : SB_EULER;
    def.damping_stiffness = REAL(0.01);
    body = scene_body(&def);
    tie_blocks(body, &mesh, split);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 6; s++) {
        sb_vec3 target = sb_v3(0, 0, REAL(-0.0005) * REAL(s)), before = sb_body_momentum(body), sum, rate;
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Z, &target, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        sum = sb_v3_add(scene_sum(sb_body_reactions(body), mesh.node_count),
                        scene_sum(sb_body_external_forces(body), mesh.node_count));
        rate = sb_v3_scale(100, sb_v3_sub(sb_body_momentum(body), before));
        if (newmark) { /* as the mean of both ends of the step, once the tool's start is over */
            sb_vec3 mean = sb_v3_scale(REAL(0.5), sb_v3_add(sum, last));
            last = sum;
            sum = s > 2 ? mean : rate;
        }
        CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(sum, rate)) / (9.81 * (double)sb_body_mass(body)), 0,
                   scene_tolerance(1e-8, 1e4));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_dynamic_balance(void)
{
    for (int k = 0; k < 4; k++)
        dynamic_balance(k % 2, k / 2);
}

/* Torque about the origin of reactions and loads of a bent, tied beam at rest. */
static void test_static_torque(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        int split;
        sb_mesh mesh = two_blocks(element_types[t], 2, 3, 0.1, &split);
        sb_body_def def = exact_def(&mesh, sb_material_corotated(REAL(2e4), REAL(0.4), REAL(1000)));
        sb_static_options options = exact_options();
        sb_vec3 torque = sb_v3(0, 0, 0);
        double weight;
        sb_body *body;
        def.gravity = sb_v3(0, REAL(3), REAL(-9.81));
        body = scene_body(&def);
        tie_blocks(body, &mesh, split);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        weight = 9.81 * (double)sb_body_mass(body);
        for (int i = 0; i < mesh.node_count; i++)
            torque =
                sb_v3_add(torque, sb_v3_cross(sb_body_positions(body)[i],
                                              sb_v3_add(sb_body_reactions(body)[i], sb_body_external_forces(body)[i])));
        CHECK_NEAR((double)sb_v3_norm(torque) / (0.2 * weight), 0, scene_tolerance(1e-9, 5000));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* A constraint's value that moves is followed evenly, by Euler and by Newmark; velocities say so. */
static void test_moving_value(void)
{
    for (int newmark = 0; newmark < 2; newmark++) {
        sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0);
        sb_body_def def = exact_def(&mesh, soft());
        sb_constraint_term drive = term(mesh.node_count - 1, 2, 2), link[2];
        int id, tie, tip = mesh.node_count - 1, second = mesh.node_count - 2;
        sb_real force = 0, pull = 0;
        sb_body *body;
        def.integrator = newmark ? SB_NEWMARK : SB_EULER;
        def.damping_stiffness = REAL(0.002);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_add_constraint(body, &drive, 1, 0, &id, NULL));
        link[0] = term(second, 2, 1);
        link[1] = term(tip, 2, 0.5);
        CHECK_OK(sb_body_add_constraint(body, link, 2, REAL(0.003), &tie, NULL)); /* starts open: closes in one step */
        for (int s = 1; s <= 10; s++) {
            sb_vec3 v, u, before = sb_body_momentum(body), rate, sum;
            CHECK_OK(sb_body_set_constraint_value(body, id, REAL(0.0004) * REAL(s)));
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            v = sb_body_velocities(body)[tip];
            u = sb_body_displacements(body)[tip];
            CHECK_NEAR(u.z, 0.0002 * s, scene_tolerance(1e-15, 1));
            CHECK_NEAR(sb_body_displacements(body)[second].z, 0.003 - 0.0001 * s, scene_tolerance(1e-15, 1));
            CHECK_NEAR(v.z, 0.02, scene_tolerance(1e-12, 1000));
            if (s > 1)
                CHECK_NEAR(sb_body_velocities(body)[second].z, -0.01, scene_tolerance(1e-12, 1000));
            CHECK_OK(sb_body_constraint_force(body, id, &force));
            CHECK_OK(sb_body_constraint_force(body, tie, &pull));
            sum = scene_sum(sb_body_reactions(body), mesh.node_count);
            sum.z += 2 * force + REAL(1.5) * pull;
            rate = sb_v3_scale(100, sb_v3_sub(sb_body_momentum(body), before));
            if (!newmark) /* what constraints and supports push with is what moves the body */
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(sum, rate)), 0, scene_tolerance(1e-9, 1e4) * (double)sb_abs(pull));
            CHECK(force != 0 && pull != 0);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* The reduced mass of two tied cells is singular: where a load asks for what it cannot give, Newmark's start lumps the
 * masses through the ties, and says which constraint does not let it. */
static void test_reduced_mass(void)
{
    sb_vec3 size = sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), load = sb_v3(REAL(0.1), REAL(0.2), REAL(0.3));
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, size, 0), second = scene_box(SB_TET4, 1, 1, 1, size, 0);
    int split = mesh.node_count, tip;
    sb_body_def def = exact_def(&mesh, soft());
    sb_constraint_term bad[3];
    sb_step_info info;
    sb_body *body;
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += REAL(0.1);
    CHECK_OK(sb_mesh_append(&mesh, &second, NULL));
    sb_mesh_free(&second);
    def.mass = SB_MASS_REDUCED;
    def.integrator = SB_NEWMARK;
    body = scene_body(&def);
    tie_blocks(body, &mesh, split);
    tip = mesh.node_count - 1;
    CHECK_OK(sb_body_add_forces(body, &tip, 1, &load, 1));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    CHECK(sb_v3_dot(sb_body_velocities(body)[tip], load) > 0);
    CHECK(scene_all_finite(sb_body_velocities(body), mesh.node_count));
    bad[0] = term(0, 1, 1);
    bad[1] = term(tip, 1, -2);
    bad[2] = term(2, 1, 1);
    CHECK_OK(sb_body_add_constraint(body, bad, 3, 0, NULL, NULL));
    CHECK_RESULT(sb_body_step(body, REAL(0.01), &info), SB_ERROR_UNSUPPORTED);
    CHECK_INT(info.error.node, 0);
    CHECK(strstr(info.error.message, "along y") != NULL);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- order, undo, violence ---- */

/* Hash of a scene with ties, a chain, moving values and a tool; a step that must fail comes in between at fail_at. */
static unsigned long long play(int corotated, sb_integrator integrator, sb_jobs jobs, int fail_at)
{
    int split, tool, id, steps = 8;
    sb_mesh mesh = two_blocks(SB_TET4, 2, 3, 0.1, &split);
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_body_def def = sb_default_body_def();
    sb_constraint_term drive = term(split - 1, 1, 1);
    unsigned long long hash;
    sb_real force = 0;
    sb_body *body;
    tool = mesh.node_count - 1;
    def.mesh = &mesh;
    def.material = corotated ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                             : sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
    def.integrator = integrator;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.jobs = jobs;
    body = scene_body(&def);
    tie_blocks(body, &mesh, split);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_constraint(body, &drive, 1, 0, &id, NULL));
    for (int s = 0; s < steps; s++) {
        sb_vec3 target = sb_v3(0, 0, REAL(-0.001) * REAL(s)), far = sb_v3(0, 0, REAL(1e30));
        CHECK_OK(sb_body_set_constraint_value(body, id, REAL(0.0005) * REAL(s)));
        if (s == fail_at) {
            CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Z, &far, 1));
            CHECK(sb_body_step(body, REAL(SB_REAL_IS_FLOAT ? 1e-30 : 1e-300), NULL) != SB_OK);
        }
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Z, &target, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    CHECK_OK(sb_body_constraint_force(body, id, &force));
    CHECK(force != 0);
    hash = scene_hash(sb_body_displacements(body), bytes) ^ scene_hash(sb_body_velocities(body), bytes) ^
           scene_hash(sb_body_reactions(body), bytes) ^ scene_hash(&force, sizeof force);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_threads(void)
{
    for (int k = 0; k < 4; k++) {
        sb_jobs inline_jobs = {NULL, NULL};
        sb_integrator integrator = k % 2 ? SB_NEWMARK : SB_EULER;
        unsigned long long one = play(k / 2, integrator, inline_jobs, -1);
        for (int workers = 2; workers <= 5; workers += 3)
            CHECK(play(k / 2, integrator, scene_jobs(&workers), -1) == one);
    }
}

static void test_undo(void)
{
    check_bad_numbers();
    for (int k = 0; k < 4; k++) {
        sb_jobs jobs = {NULL, NULL};
        sb_integrator integrator = k % 2 ? SB_NEWMARK : SB_EULER;
        CHECK(play(k / 2, integrator, jobs, 4) == play(k / 2, integrator, jobs, -1));
    }
}

/* The multipliers of a failed call are those of before, too. */
static void test_undo_keeps_forces(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_constraint_term drive = term(mesh.node_count - 1, 0, 1);
    sb_vec3 *kept = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    sb_real before = 0, after = 1;
    sb_step_info info;
    sb_body *body;
    int id;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    def.max_newton = 1;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_constraint(body, &drive, 1, REAL(0.1), &id, NULL));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    memcpy(kept, sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    CHECK_OK(sb_body_constraint_force(body, id, &before));
    CHECK(before > 0);
    CHECK_OK(sb_body_set_constraint_value(body, id, -3));
    CHECK_RESULT(sb_body_step(body, REAL(0.01), &info), SB_ERROR_INVERTED);
    CHECK(info.error.element >= 0);
    CHECK_OK(sb_body_constraint_force(body, id, &after));
    CHECK(before == after);
    CHECK(memcmp(kept, sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3)) == 0);
    CHECK_OK(sb_body_set_constraint_value(body, id, REAL(0.1)));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    sb_body_reset(body);
    CHECK_OK(sb_body_constraint_force(body, id, &after));
    CHECK(after == 0);
    free(kept);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A tied corotated body, torn about for 1,000 steps: ties hold to the last bit, it stays finite and comes to rest. */
static void test_violence(void)
{
    int split;
    sb_mesh mesh = two_blocks(SB_TET4, 1, 2, 0, &split);
    sb_body_def def = sb_default_body_def();
    unsigned long long seed = 5;
    sb_tie_report report;
    sb_constraint_term equal[2];
    sb_energy energy;
    sb_body *body;
    double far = 0;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.45), REAL(1000));
    def.damping_mass = REAL(2);
    body = scene_body(&def);
    report = tie_blocks(body, &mesh, split);
    CHECK(report.constraint_count > 0);
    equal[0] = term(split + 1, 1, 1);
    equal[1] = term(mesh.node_count - 1, 1, -1);
    CHECK_OK(sb_body_add_constraint(body, equal, 2, 0, NULL, NULL));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 1000; s++) {
        int tool = mesh.node_count - 1;
        sb_vec3 target = sb_v3(REAL(check_random_in(&seed, -0.3, 0.3)), REAL(check_random_in(&seed, -0.3, 0.3)),
                               REAL(check_random_in(&seed, -0.3, 0.3)));
        if (s % 50 == 0 && s < 800)
            CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_XYZ, &target, 1));
        if (s % 50 == 25 || s == 800)
            CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
        if (!CHECK_OK(sb_body_step(body, REAL(0.02), NULL)))
            break;
        CHECK(sb_body_displacements(body)[split + 1].y == sb_body_displacements(body)[mesh.node_count - 1].y);
    }
    CHECK(scene_all_finite(sb_body_positions(body), mesh.node_count));
    CHECK_OK(sb_body_energy(body, &energy));
    far = scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count);
    CHECK_NEAR(far, 0, 1e-3);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- failures ---- */

static void test_bad_constraints(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 2, 2, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = exact_def(&mesh, soft());
    sb_body *body = scene_body(&def);
    sb_constraint_term terms[4], chain[2];
    check_bad_numbers();
    sb_real zero = 0, not_a_number = zero / zero;
    sb_real values[2] = {0, 0}, force = 7;
    int counts[2] = {2, 2}, id = 77, three = 3, last = mesh.node_count - 1;
    sb_error error;
    CHECK_OK(sb_body_fix_nodes(body, &three, 1, SB_Y));
    terms[0] = term(5, 0, 1);
    terms[1] = term(6, 1, 1);
    terms[2] = term(7, 0, 1);
    terms[3] = term(8, 0, 1);
    CHECK_RESULT(sb_body_add_constraint(NULL, terms, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_constraint(body, NULL, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 0, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, not_a_number, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 5);
    CHECK_RESULT(sb_body_add_constraints(body, terms, counts, values, -1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_constraints(body, terms, NULL, values, 2, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_body_add_constraints(body, NULL, NULL, NULL, 0, NULL, &error));
    terms[1].node = mesh.node_count;
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, mesh.node_count);
    terms[1] = term(6, 3, 1);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, 6);
    terms[1] = term(6, 1, (double)not_a_number);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK(strstr(error.message, "node 6 along y") != NULL);
    terms[1] = term(6, 1, 1);
    terms[0] = term(5, 2, 0);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "node 5 along z") != NULL);
    terms[0] = term(5, 2, SB_REAL_IS_FLOAT ? 1e-40 : 1e-310);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    terms[0] = term(3, 1, 1);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "node 3 along y, is supported") != NULL);
    terms[0] = term(6, 1, 2);
    CHECK_RESULT(sb_body_add_constraint(body, terms, 2, 0, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "node 6") != NULL && strstr(error.message, "along y") != NULL);
    terms[0] = term(7, 0, 1);
    terms[1] = term(6, 1, 1);
    CHECK_RESULT(sb_body_add_constraints(body, terms, counts, values, 2, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "node 7 is the slave of two constraints along x") != NULL);
    CHECK_INT(id, 77);
    CHECK_INT(sb_body_constraint_count(body), 0);

    /* a circle of three, closed by the last */
    for (int k = 0; k < 3; k++) {
        chain[0] = term(10 + k, 2, 1);
        chain[1] = term(10 + (k + 1) % 3, 2, 0.5);
        if (k < 2)
            CHECK_OK(sb_body_add_constraint(body, chain, 2, 0, &id, &error));
        else
            CHECK_RESULT(sb_body_add_constraint(body, chain, 2, 0, NULL, &error), SB_ERROR_ARGUMENT);
    }
    CHECK(error.node >= 10 && error.node <= 12);
    CHECK(strstr(error.message, "circle") != NULL && strstr(error.message, "along z") != NULL);
    CHECK_INT(sb_body_constraint_count(body), 2);
    CHECK_INT(id, 1);
    three = 10;
    CHECK_RESULT(sb_body_fix_nodes(body, &three, 1, SB_XYZ), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_body_supports(body)[10], 0);
    CHECK_OK(sb_body_fix_nodes(body, &three, 1, SB_X | SB_Y));
    three = 12; /* the chain's last master */
    CHECK_OK(sb_body_fix_nodes(body, &three, 1, SB_XYZ));
    CHECK_RESULT(sb_body_set_constraint_value(body, 2, 0), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_set_constraint_value(body, 1, not_a_number), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_set_constraint_value(NULL, 1, 0), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_constraint_force(body, -1, &force), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_constraint_force(body, 0, NULL), SB_ERROR_ARGUMENT);
    CHECK(force == 7);
    CHECK_RESULT(sb_body_remove_constraints(body, 0, 3, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_remove_constraints(body, -1, 1, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_remove_constraints(body, 0, -1, &error), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_body_remove_constraints(body, 0, 0, &error));
    CHECK_INT(sb_body_constraint_count(body), 2);
    CHECK_OK(sb_body_remove_constraints(body, 0, 2, &error));
    CHECK_INT(sb_body_constraint_count(body), 0);
    terms[0] = term(last, 0, 1);
    CHECK_OK(sb_body_add_constraint(body, terms, 1, 0, &id, &error));
    CHECK_INT(id, 2);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_bad_ties(void)
{
    int split, faces[MANY], slaves[MANY], face_count, slave_count, kept;
    sb_mesh mesh = two_blocks(SB_HEX8, 2, 2, 0, &split);
    sb_body_def def = exact_def(&mesh, soft());
    sb_body *body = scene_body(&def);
    sb_tie_report report;
    sb_real zero = 0;
    sb_error error;
    face_count = plane_faces(&mesh, split, 0.1, faces);
    slave_count = plane_nodes(&mesh, split, mesh.node_count, 0, 0.1, slaves);
    memset(&report, 3, sizeof report);
    kept = report.tied_count;
    check_bad_numbers();
    CHECK_RESULT(sb_body_tie_faces(NULL, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_tie_faces(body, NULL, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_tie_faces(body, faces, -1, 4, slaves, slave_count, -1, 0, &report, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 5, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, NULL, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, zero / zero, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 4, &report, &error),
                 SB_ERROR_ARGUMENT);
    faces[2] = mesh.node_count;
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_INDEX);
    CHECK_INT(error.node, mesh.node_count);
    faces[2] = mesh.node_count - 1;
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, faces[0]);
    face_count = plane_faces(&mesh, split, 0.1, faces);
    slaves[1] = -1;
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_INDEX);
    slaves[1] = slaves[0];
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, slaves[0]);
    slaves[1] = faces[3];
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error),
                 SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, faces[3]);
    CHECK_INT(report.tied_count, kept);
    plane_nodes(&mesh, split, mesh.node_count, 0, 0.1, slaves);
    CHECK_OK(sb_body_tie_faces(body, faces, 0, 4, slaves, slave_count, -1, 0, &report, &error));
    CHECK_INT(report.free_count, slave_count);
    CHECK_OK(sb_body_tie_faces(body, faces, face_count, 4, slaves, slave_count, -1, 0, &report, &error));
    CHECK_RESULT(sb_body_tie_faces(body, faces, face_count, 4, slaves, 1, -1, 0, &report, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, slaves[0]);
    CHECK_INT(sb_body_constraint_count(body), 3 * slave_count);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Every allocation of adding, tying and removing fails in turn: nothing changes, nothing leaks. */
static void test_allocations(void)
{
    int split, faces[MANY], slaves[MANY], face_count, slave_count, succeeded = 0;
    sb_mesh mesh = two_blocks(SB_TET4, 1, 2, 0, &split);
    sb_body_def def = exact_def(&mesh, soft());
    scene_memory memory = {0, 0, 0, 0};
    sb_constraint_term chain[2];
    sb_error error;
    sb_body *body;
    int live;
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    live = memory.live;
    face_count = plane_faces(&mesh, split, 0.1, faces);
    slave_count = plane_nodes(&mesh, split, mesh.node_count, 0, 0.1, slaves);
    chain[0] = term(split + 1, 1, 1);
    chain[1] = term(slaves[0] == split + 1 ? slaves[1] : slaves[0], 1, -1);
    for (int stage = 0; stage < 3; stage++)
        for (int fail_at = 1; fail_at < 200; fail_at++) {
            int count = sb_body_constraint_count(body), held = memory.live;
            sb_result result;
            memory.calls = 0;
            memory.fail_at = fail_at;
            result = stage == 0
                         ? sb_body_tie_faces(body, faces, face_count, 3, slaves, slave_count, -1, 0, NULL, &error)
                     : stage == 1 ? sb_body_add_constraint(body, chain, 2, 0, NULL, &error)
                                  : sb_body_remove_constraint(body, 0, &error);
            memory.fail_at = 0;
            if (result == SB_OK) {
                CHECK(fail_at > 5);
                succeeded++;
                break;
            }
            CHECK_INT(result, SB_ERROR_MEMORY);
            CHECK_INT(sb_body_constraint_count(body), count);
            CHECK_INT(memory.live, held);
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        }
    CHECK_INT(succeeded, 3);
    memory.calls = 0;
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_INT(memory.calls, 0); /* a step allocates nothing */
    sb_body_clear_constraints(body);
    CHECK_INT(memory.live, live + 1); /* the room of the support test stays for the next constraints */
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

static void test_append(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0),
            other = scene_box(SB_TET4, 2, 1, 1, sb_v3(1, 1, 1), 0);
    sb_mesh hex = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0), empty, copy;
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    int nodes = mesh.node_count, elements = mesh.element_count, regions[64], bad;
    sb_error error;
    memset(&empty, 0, sizeof empty);
    CHECK_RESULT(sb_mesh_append(&mesh, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_append(NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_append(&mesh, &hex, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "hex8") != NULL);
    bad = other.elements[3];
    other.elements[3] = other.node_count;
    CHECK_RESULT(sb_mesh_append(&mesh, &other, &error), SB_ERROR_INDEX);
    other.elements[3] = bad;
    for (int e = 0; e < other.element_count; e++)
        regions[e] = 5 + e;
    other.regions = regions;
    CHECK_OK(sb_mesh_copy(&mesh, &allocator, &copy, &error));
    for (int fail_at = 1; fail_at <= 3; fail_at++) {
        memory.calls = 0;
        memory.fail_at = fail_at;
        CHECK_RESULT(sb_mesh_append(&copy, &other, &error), SB_ERROR_MEMORY);
        CHECK_INT(copy.node_count, nodes);
    }
    memory.fail_at = 0;
    CHECK_OK(sb_mesh_append(&copy, &other, &error));
    CHECK_INT(copy.node_count, nodes + other.node_count);
    CHECK_INT(copy.element_count, elements + other.element_count);
    CHECK_INT(copy.regions[elements - 1], 0);
    CHECK_INT(copy.regions[elements + 1], 6);
    CHECK_INT(copy.elements[4 * elements + 2], other.elements[2] + nodes);
    CHECK_NEAR(scene_distance(copy.nodes + nodes, other.nodes, other.node_count), 0, 0);
    CHECK_OK(sb_mesh_validate(&copy, &error));
    CHECK_INT(memory.live, 3);
    sb_mesh_free(&copy);
    CHECK_INT(memory.live, 0);
    CHECK_OK(sb_mesh_append(&mesh, &mesh, &error));
    CHECK_INT(mesh.node_count, 2 * nodes);
    CHECK(mesh.regions == NULL);
    CHECK_NEAR(sb_mesh_volume(&mesh), 2, 1e-5);
    other.regions = NULL;
    sb_mesh_free(&mesh);
    sb_mesh_free(&other);
    sb_mesh_free(&hex);
}

CHECK_SUITE(constraint, {"shear by equations, values and supports", test_shear},
            {"periodic cell through chains", test_periodic_cell}, {"rigid plate", test_rigid_plate},
            {"tied blocks move as one", test_tied_as_merged}, {"linear patch across ties", test_linear_patch},
            {"stress across ties", test_stress_patch}, {"gaps", test_gaps}, {"static check", test_static_check},
            {"conservation", test_conservation}, {"dynamic balance", test_dynamic_balance},
            {"static torque", test_static_torque}, {"moving value", test_moving_value},
            {"reduced mass", test_reduced_mass}, {"threads", test_threads}, {"undo", test_undo},
            {"undo keeps forces", test_undo_keeps_forces}, {"violence", test_violence},
            {"bad constraints", test_bad_constraints}, {"bad ties", test_bad_ties}, {"allocations", test_allocations},
            {"append", test_append});
