/* A body that is being recorded and every public function that changes or moves a body: either the recording plays
 * again to the last bit, or the call is refused by name and changes nothing. The functions are read from the headers:
 * one that is missing here is a failure. */
#include "register.h"

#include "check.h"
#include "scene.h"

enum { MAX_CELLS = 400 };

typedef struct scheme {
    sb_element_type element;
    sb_integrator integrator;
    sb_precond_kind precond;
} scheme;

/* A body of two parts, and what was put on it before the recording began. */
typedef struct actor {
    sb_mesh mesh;
    sb_mesh target; /* its surface, pushed aside */
    sb_boundary boundary;
    sb_body *body;
    reg_match *match; /* made before the recording; NULL where there are constraints */
    reg_nicp *nicp;
    int free_nodes[2], pressure, springs, cable, membrane, cavity, open_cavity, mapping, constraint, rigid;
    void *state;
    size_t state_size;
    const char *path; /* of a state's file */
    const scheme *how;
    sb_error error;
} actor;

typedef enum actor_kind { ACTOR_PLAIN, ACTOR_LOADED, ACTOR_MATCHED, ACTOR_NICP } actor_kind;

typedef struct act {
    const char *name;
    sb_result (*run)(actor *a);
    actor_kind kind;
} act;

/* Explicit steps take no damping by stiffness. */
static sb_real beta_of(const scheme *how) { return how->integrator == SB_CENTRAL_DIFFERENCE ? 0 : REAL(0.01); }

static sb_body *make_body(const sb_mesh *mesh, const scheme *how)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(2e4), REAL(0.4), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = beta_of(how);
    def.integrator = how->integrator;
    def.preconditioner = how->precond;
    def.slack = 1;
    return scene_body(&def);
}

/* ---- acts: one call each ---- */

static sb_material stiffer(void) { return sb_material_corotated(REAL(3e4), REAL(0.3), 1000); }

static sb_result act_material(actor *a)
{
    sb_material material = sb_material_stable_neo_hookean(REAL(1e4), REAL(0.4), REAL(1000));
    return sb_body_set_material(a->body, &material, &a->error);
}
static sb_result act_region(actor *a)
{
    sb_material material = stiffer();
    return sb_body_set_region_material(a->body, 0, &material, &a->error);
}
static sb_result act_fibres(actor *a)
{
    static sb_vec3 fibres[MAX_CELLS];
    for (int e = 0; e < MAX_CELLS; e++)
        fibres[e] = sb_v3(1, REAL(e % 3), 0);
    return sb_body_set_fibres(a->body, fibres, &a->error);
}
static sb_result act_tension(actor *a)
{
    sb_material material = sb_material_stable_neo_hookean(REAL(1e4), REAL(0.4), REAL(1000));
    sb_result result = act_fibres(a);
    if (result == SB_OK)
        result = sb_body_set_material(a->body, &material, &a->error);
    return result == SB_OK ? sb_body_set_tension(a->body, 0, REAL(500), &a->error) : result;
}
static sb_result act_change(actor *a)
{
    sb_body_change *change;
    sb_vec3 x = sb_body_rest_positions(a->body)[a->free_nodes[0]];
    sb_result result = sb_body_change_begin(a->body, &change, &a->error);
    if (result != SB_OK)
        return result;
    result = sb_body_change_move_node(change, a->free_nodes[0], sb_v3_add(x, sb_v3(REAL(1e-4), 0, REAL(1e-4))), NULL,
                                      NULL, 0, &a->error);
    if (result == SB_OK)
        result = sb_body_change_commit(change, &a->error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}
static void act_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    (void)user, (void)body, (void)change;
}
static sb_result act_listen(actor *a)
{
    sb_body_listener listener = {NULL, NULL, act_follow, NULL, NULL};
    return sb_body_listen(a->body, &listener, NULL, &a->error);
}
/* A point that follows the body, through one change of the mesh. */
static sb_result act_embed(actor *a)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    def.mesh = &a->mesh;
    def.points = a->mesh.nodes;
    def.point_count = 1;
    result = sb_embedding_create(&def, &embedding, &a->error);
    if (result == SB_OK)
        result = sb_embedding_follow(embedding, a->body, &a->error);
    if (result == SB_OK)
        result = act_change(a);
    sb_embedding_destroy(embedding);
    return result;
}
static sb_result act_unlisten(actor *a)
{
    sb_body_listener listener = {NULL, NULL, act_follow, NULL, NULL};
    int id;
    sb_result result = sb_body_listen(a->body, &listener, &id, &a->error);
    return result == SB_OK ? sb_body_unlisten(a->body, id) : result;
}
static sb_result act_gravity(actor *a) { return sb_body_set_gravity(a->body, sb_v3(1, 2, -3)); }
static sb_result act_damping(actor *a) { return sb_body_set_damping(a->body, REAL(0.2), beta_of(a->how) / 2); }
static sb_result act_region_damping(actor *a)
{
    if (a->how->integrator == SB_CENTRAL_DIFFERENCE) /* damps all regions alike */
        return SB_OK;
    return sb_body_set_region_damping(a->body, 0, REAL(0.3), beta_of(a->how) / 3, &a->error);
}
static sb_result act_solver(actor *a) { return sb_body_set_solver(a->body, REAL(1e-4), 100); }
static sb_result act_keep_tangent(actor *a)
{
    sb_result result = sb_body_keep_tangent(a->body, REAL(0.05), &a->error);
    return a->how->element != SB_TET4 && CHECK_RESULT(result, SB_ERROR_UNSUPPORTED) ? SB_OK : result;
}
static sb_result act_fix(actor *a) { return sb_body_fix_nodes(a->body, a->free_nodes, 2, SB_Y | SB_Z); }
static sb_result act_prescribe(actor *a)
{
    sb_vec3 way = sb_v3(0, 0, REAL(0.001));
    return sb_body_prescribe(a->body, a->free_nodes, 2, SB_Z, &way, 1);
}
static sb_result act_release(actor *a)
{
    int node = a->boundary.nodes[0];
    return sb_body_release_nodes(a->body, &node, 1, SB_XYZ);
}
static sb_result act_hold(actor *a) { return sb_body_hold(a->body, a->free_nodes, 2, SB_X, NULL); }
static sb_result act_place(actor *a)
{
    sb_vec3 to[2];
    for (int i = 0; i < 2; i++)
        to[i] = sb_v3_add(sb_body_positions(a->body)[a->free_nodes[i]], sb_v3(0, REAL(0.001), 0));
    return sb_body_place(a->body, a->free_nodes, 2, SB_Y, to, NULL);
}
static sb_result act_place_rigid(actor *a)
{
    sb_vec3 centre = a->mesh.nodes[a->free_nodes[0]], position = centre;
    sb_quat turn = {1, 0, 0, REAL(0.01)};
    position.y += REAL(0.001);
    return sb_body_place_rigid(a->body, a->free_nodes, 2, centre, position, turn, NULL);
}
static sb_result act_let_go(actor *a) { return sb_body_release(a->body, a->boundary.nodes, 1, SB_XYZ, NULL); }
static sb_result act_displace(actor *a)
{
    size_t count = (size_t)a->mesh.node_count;
    sb_vec3 *u = (sb_vec3 *)malloc(count * sizeof *u);
    sb_result result;
    memcpy(u, sb_body_displacements(a->body), count * sizeof *u);
    u[a->free_nodes[1]].y += REAL(1e-4);
    result = sb_body_set_displacements(a->body, u);
    free(u);
    return result;
}
static sb_result act_velocities(actor *a)
{
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)a->mesh.node_count, sizeof *v);
    sb_result result;
    v[a->free_nodes[0]].y = REAL(0.01);
    result = sb_body_set_velocities(a->body, v);
    free(v);
    return result;
}
static sb_result act_reset(actor *a)
{
    sb_body_reset(a->body);
    return SB_OK;
}
static sb_result act_energy(actor *a)
{
    sb_energy energy;
    return sb_body_energy(a->body, &energy);
}
static sb_result act_multiply(actor *a)
{
    size_t count = (size_t)a->mesh.node_count;
    sb_vec3 *y = (sb_vec3 *)malloc(count * sizeof *y);
    sb_result result = sb_body_multiply_stiffness(a->body, sb_body_displacements(a->body), y, &a->error);
    free(y);
    return result;
}
static sb_result act_multiply_tangent(actor *a)
{
    size_t count = (size_t)a->mesh.node_count;
    sb_vec3 *y = (sb_vec3 *)malloc(count * sizeof *y);
    const sb_vec3 *u = sb_body_displacements(a->body);
    sb_result result = sb_body_multiply_tangent(a->body, SB_TANGENT_QUASI, u, y, &a->error);
    free(y);
    return result;
}

static sb_result act_stiffness_matrix(actor *a)
{
    const sb_matrix *matrix;
    return sb_body_stiffness_matrix(a->body, SB_TANGENT_EXACT, &matrix, &a->error);
}

static sb_result act_energy_densities(actor *a)
{
    sb_real *values = (sb_real *)malloc((size_t)sb_body_element_count(a->body) * sizeof *values);
    sb_result result = sb_body_energy_densities(a->body, values, &a->error);
    free(values);
    return result;
}
static sb_result act_parts(actor *a)
{
    sb_part parts[2];
    int count;
    return sb_body_parts(a->body, parts, 2, &count, NULL);
}
static sb_result act_rotations(actor *a)
{
    sb_quat *q = (sb_quat *)malloc((size_t)a->mesh.node_count * sizeof *q);
    sb_body_nodal_rotations(a->body, q);
    free(q);
    return SB_OK;
}
static sb_result act_forces(actor *a)
{
    sb_vec3 forces[2] = {{REAL(0.01), 0, 0}, {0, 0, REAL(-0.01)}};
    return sb_body_add_forces(a->body, a->free_nodes, 2, forces, 0);
}

static void first_face(const actor *a, int face[4])
{
    const sb_mesh *surface = &a->boundary.surface;
    int corners = sb_element_corner_count(surface->element_type);
    for (int k = 0; k < corners; k++)
        face[k] = a->boundary.nodes[surface->elements[k]];
}

static sb_result act_apply(actor *a)
{
    sb_vec3 force = sb_v3(0, REAL(0.01), 0);
    return sb_body_apply_forces(a->body, a->free_nodes, 2, &force, 1, NULL);
}
static sb_result act_traction(actor *a)
{
    int face[4];
    first_face(a, face);
    return sb_body_add_traction(a->body, face, 1, sb_element_corner_count(a->boundary.surface.element_type),
                                sb_v3(0, 0, -20), &a->error);
}
static sb_result act_clear(actor *a)
{
    sb_body_clear_loads(a->body);
    return SB_OK;
}
static sb_result act_add_pressure(actor *a)
{
    int face[4];
    first_face(a, face);
    return sb_body_add_pressure(a->body, face, 1, sb_element_corner_count(a->boundary.surface.element_type), 10,
                                &a->pressure, &a->error);
}
static sb_result act_pressure(actor *a) { return sb_body_set_pressure(a->body, a->pressure, 25); }
static sb_result act_add_springs(actor *a)
{
    sb_real stiffness = 5;
    sb_vec3 points[2] = {{0, 0, 0}, {REAL(0.1), 0, 0}};
    return sb_body_add_springs(a->body, a->free_nodes, 2, &stiffness, 1, points, &a->springs, &a->error);
}
static sb_result act_move_springs(actor *a)
{
    sb_vec3 points[2] = {{0, 0, REAL(0.01)}, {REAL(0.1), REAL(0.01), 0}};
    return sb_body_move_springs(a->body, a->springs, points);
}
static sb_result act_spring_stiffness(actor *a)
{
    sb_real stiffness[2] = {1, 9};
    return sb_body_set_spring_stiffness(a->body, a->springs, stiffness, 0);
}
static sb_result act_add_cable(actor *a)
{
    int nodes[3] = {a->free_nodes[0], -1, a->free_nodes[1]};
    sb_vec3 places[3] = {{0, 0, 0}, {REAL(0.05), REAL(0.1), 0}, {0, 0, 0}};
    sb_cable_def def = sb_default_cable_def();
    def.count = 3;
    def.nodes = nodes;
    def.places = places;
    def.stiffness = 2;
    def.pushes = 1;
    return sb_body_add_cable(a->body, &def, &a->cable, &a->error);
}
static sb_result act_cable_length(actor *a)
{
    sb_real length;
    sb_result result = sb_body_cable_length(a->body, a->cable, &length);
    return result == SB_OK ? sb_body_set_cable_rest_length(a->body, a->cable, REAL(0.9) * length) : result;
}
static sb_result act_cable_stiffness(actor *a) { return sb_body_set_cable_stiffness(a->body, a->cable, 3); }
static sb_result act_move_cable(actor *a)
{
    sb_vec3 places[3] = {{0, 0, 0}, {REAL(0.04), REAL(0.12), REAL(0.01)}, {0, 0, 0}};
    return sb_body_move_cable(a->body, a->cable, places);
}
static sb_result act_add_membrane(actor *a)
{
    sb_membrane_def def = sb_default_membrane_def();
    def.corners = sb_element_corner_count(a->boundary.surface.element_type);
    def.thickness = REAL(0.001);
    def.shear = 5000;
    def.prestretch = REAL(1.02);
    return sb_body_add_membrane(a->body, &def, &a->membrane, &a->error);
}
static sb_result act_membrane(actor *a)
{
    return sb_body_set_membrane(a->body, a->membrane, REAL(0.002), 4000, REAL(1.01));
}
static sb_result act_add_cavity(actor *a)
{
    int face[4];
    sb_cavity_def def = sb_default_cavity_def();
    sb_result result;
    first_face(a, face);
    def.faces = face;
    def.face_count = 1;
    def.corners = sb_element_corner_count(a->boundary.surface.element_type);
    def.kind = SB_CAVITY_PRESSURE;
    def.pressure = 15;
    result = sb_body_add_cavity(a->body, &def, &a->open_cavity, &a->error);
    def.kind = SB_CAVITY_TABLE;
    def.point_count = 2;
    def.table_volume[0] = REAL(-1e-6);
    def.table_volume[1] = REAL(1e-6);
    def.table_pressure[0] = 40;
    return result == SB_OK ? sb_body_add_cavity(a->body, &def, &a->cavity, &a->error) : result;
}
static sb_result act_inject(actor *a) { return sb_body_inject_cavity(a->body, a->cavity, REAL(1e-7)); }
static sb_result act_cavity_pressure(actor *a) { return sb_body_set_cavity_pressure(a->body, a->open_cavity, 5); }
static sb_result act_cavity_volume(actor *a)
{
    sb_real volume;
    return sb_body_cavity_volume(a->body, a->cavity, &volume);
}
/* Explicit bodies have none, and refuse. */
static sb_result act_add_rigid(actor *a)
{
    sb_rigid_def def = sb_default_rigid_def();
    def.mass = 1;
    def.inertia = sb_m3_scale(REAL(1e-4), sb_m3_identity());
    def.centre = a->mesh.nodes[a->free_nodes[1]];
    def.spin = sb_v3(1, 0, 2);
    def.nodes = a->free_nodes + 1;
    def.node_count = 1;
    return a->how->integrator == SB_CENTRAL_DIFFERENCE ? SB_OK : sb_body_add_rigid(a->body, &def, &a->rigid, &a->error);
}
static sb_result act_load_rigid(actor *a)
{
    sb_result result = act_add_rigid(a);
    if (result != SB_OK || a->how->integrator == SB_CENTRAL_DIFFERENCE)
        return result;
    return sb_body_set_rigid_load(a->body, a->rigid, sb_v3(0, 1, 0), sb_v3(0, 0, REAL(0.01)));
}
static sb_result act_remove_rigid(actor *a)
{
    sb_result result = act_add_rigid(a);
    if (result != SB_OK || a->how->integrator == SB_CENTRAL_DIFFERENCE)
        return result;
    CHECK_OK(sb_body_step(a->body, REAL(0.002), NULL));
    return sb_body_remove_rigid(a->body, a->rigid);
}
static sb_result act_add_mapping(actor *a)
{
    int start[2] = {0, 2};
    sb_real weights[2] = {REAL(0.5), REAL(0.5)}, stiffness = 4;
    sb_vec3 goal = sb_v3(REAL(0.05), REAL(0.05), REAL(0.05));
    sb_mapping mapping;
    mapping.row_count = 1;
    mapping.row_start = start;
    mapping.nodes = a->free_nodes;
    mapping.weights = weights;
    return sb_body_add_mapping(a->body, &mapping, &stiffness, 1, &goal, &a->mapping, &a->error);
}
static sb_result act_mapping_targets(actor *a)
{
    sb_vec3 goal = sb_v3(REAL(0.06), 0, REAL(0.05));
    return sb_body_set_mapping_targets(a->body, a->mapping, &goal);
}
static sb_result act_mapping_stiffness(actor *a)
{
    sb_real stiffness = 8;
    return sb_body_set_mapping_stiffness(a->body, a->mapping, &stiffness, 1);
}
static sb_result act_remove_load(actor *a) { return sb_body_remove_load(a->body, a->mapping); }

static sb_constraint_term term(int node, int axis, double coefficient)
{
    sb_constraint_term made;
    made.node = node;
    made.axis = axis;
    made.coefficient = REAL(coefficient);
    return made;
}
static sb_result act_constraint(actor *a)
{
    sb_constraint_term terms[2];
    terms[0] = term(a->free_nodes[0], 1, 1);
    terms[1] = term(a->free_nodes[1], 1, -1);
    return sb_body_add_constraint(a->body, terms, 2, REAL(1e-4), &a->constraint, &a->error);
}
static sb_result act_constraints(actor *a)
{
    sb_constraint_term terms[2];
    int counts[2] = {1, 1};
    terms[0] = term(a->free_nodes[0], 2, 1);
    terms[1] = term(a->free_nodes[1], 2, 2);
    return sb_body_add_constraints(a->body, terms, counts, NULL, 2, NULL, &a->error);
}
static sb_result act_constraint_value(actor *a)
{
    return sb_body_set_constraint_value(a->body, a->constraint, REAL(-2e-4));
}
static sb_result act_remove_constraints(actor *a)
{
    return sb_body_remove_constraints(a->body, a->constraint, 1, &a->error);
}
static sb_result act_remove_constraint(actor *a)
{
    return sb_body_remove_constraint(a->body, a->constraint, &a->error);
}
static sb_result act_clear_constraints(actor *a)
{
    sb_body_clear_constraints(a->body);
    return SB_OK;
}
/* The second part's side to the first one's face. */
static sb_result act_tie(actor *a)
{
    int corners = sb_element_corner_count(a->boundary.surface.element_type), count = 0, slaves[8];
    int *faces = (int *)malloc((size_t)(a->boundary.surface.element_count * corners) * sizeof(int));
    int half = a->mesh.node_count / 2, face_count = 0;
    sb_result result;
    for (int f = 0; f < a->boundary.surface.element_count; f++) {
        int kept = 0;
        for (int k = 0; k < corners; k++) {
            int node = a->boundary.nodes[a->boundary.surface.elements[f * corners + k]];
            faces[face_count * corners + k] = node;
            kept += node < half;
        }
        face_count += kept == corners;
    }
    for (int i = half; i < a->mesh.node_count && count < 8; i++)
        if ((double)a->mesh.nodes[i].z < 0.0212)
            slaves[count++] = i;
    result = sb_body_tie_faces(a->body, faces, face_count, corners, slaves, count, REAL(0.01), 0, NULL, &a->error);
    free(faces);
    return result;
}
static sb_result act_modes(actor *a)
{
    sb_real frequencies[2];
    return sb_body_modes(a->body, 2, NULL, frequencies, NULL, NULL, &a->error);
}
static sb_result act_stable_step(actor *a)
{
    sb_real dt;
    return sb_body_stable_step(a->body, &dt, &a->error);
}
static sb_result act_load_state(actor *a) { return sb_body_state_load(a->body, a->state, a->state_size, &a->error); }
static sb_result act_load_file(actor *a)
{
    sb_result result = SB_OK;
    FILE *file = fopen(a->path, "wb");
    if (CHECK(file != NULL)) {
        fwrite(a->state, 1, a->state_size, file);
        fclose(file);
        result = sb_body_state_load_file(a->body, a->path, &a->error);
        remove(a->path);
    }
    return result;
}
static sb_result act_step(actor *a) { return sb_body_step(a->body, REAL(0.003), NULL); }
static sb_result act_static(actor *a) { return sb_body_solve_static(a->body, NULL, NULL); }
/* Derivatives leave no trace: in what way, 0 to 2. */
static sb_result act_derive(actor *a, int way)
{
    const sb_vec3 *loss = sb_body_reactions(a->body);
    size_t n = (size_t)sb_body_node_count(a->body);
    sb_vec3 *out;
    sb_parameter p;
    sb_real slope;
    sb_static_options options = sb_default_static_options();
    sb_result result;
    options.forces_only = 1;
    (void)sb_body_remove_load(a->body, a->cavity); /* derivatives know none that resists growing */
    if (sb_body_solve_static(a->body, &options, NULL) != SB_OK)
        return SB_OK;
    out = (sb_vec3 *)malloc(n * sizeof *out);
    memset(&p, 0, sizeof p);
    p.kind = SB_PARAMETER_GRAVITY;
    result = way == 0   ? sb_body_solve_tangent(a->body, loss, out, 1, REAL(1e-3), &a->error)
             : way == 1 ? sb_body_sensitivities(a->body, &p, 1, out, NULL, &a->error)
                        : sb_body_gradient(a->body, loss, NULL, &p, 1, &slope, out, &a->error);
    free(out);
    return result;
}
static sb_result act_identify(actor *a)
{
    sb_identify_def def = sb_default_identify_def();
    const int starts[2] = {0, 1}, node = sb_body_node_count(a->body) - 1;
    const sb_real weight = 1;
    sb_mapping row;
    sb_vec3 point = sb_body_positions(a->body)[node];
    sb_parameter p;
    sb_measurement seen;
    sb_real value = 5000;
    row.row_count = 1, row.row_start = starts, row.nodes = &node, row.weights = &weight;
    memset(&p, 0, sizeof p);
    memset(&seen, 0, sizeof seen);
    p.kind = SB_PARAMETER_YOUNG;
    seen.rows = &row, seen.points = &point, seen.sigma_point = REAL(1e-3);
    def.body = a->body, def.parameters = &p, def.count = 1, def.measurements = &seen, def.max_iterations = 2;
    (void)sb_identify(&def, &value, NULL, NULL, NULL, &a->error); /* found or not: a trace of calls */
    return SB_OK;
}
static sb_result act_solve_tangent(actor *a) { return act_derive(a, 0); }
static sb_result act_sensitivities(actor *a) { return act_derive(a, 1); }
static sb_result act_gradient(actor *a) { return act_derive(a, 2); }
/* Another recording is played on the body that is being recorded. */
static sb_result act_replay(actor *a)
{
    sb_body *other = make_body(&a->mesh, a->how);
    sb_recording *inner = NULL;
    sb_recording_report report;
    sb_result result;
    CHECK_OK(sb_body_fix_nodes(other, a->boundary.nodes, 1, SB_XYZ));
    CHECK_OK(sb_recording_start(other, 0, NULL, &inner, NULL));
    CHECK_OK(sb_body_set_gravity(other, sb_v3(0, 0, -1)));
    CHECK_OK(sb_body_step(other, REAL(0.002), NULL));
    sb_recording_stop(inner);
    result = sb_recording_replay(inner, a->body, &report);
    a->error = report.error;
    sb_recording_destroy(inner);
    sb_body_destroy(other);
    return result;
}
static sb_result act_record_again(actor *a)
{
    sb_recording *second = NULL;
    sb_result result = sb_recording_start(a->body, 0, NULL, &second, &a->error);
    sb_recording_destroy(second);
    return result == SB_ERROR_ARGUMENT ? SB_OK : result; /* one at a time */
}

static sb_result act_match_create(actor *a)
{
    reg_match_def def = reg_default_match_def();
    reg_match *match = NULL;
    sb_result result;
    def.body = a->body;
    def.target = &a->target;
    result = reg_match_create(&def, &match, &a->error);
    reg_match_destroy(match);
    return result;
}
static sb_result keep_error(actor *a, sb_result result, const sb_error *error)
{
    a->error = *error;
    return result;
}
static sb_result act_match_step(actor *a)
{
    reg_match_info info;
    sb_result result = reg_match_step(a->match, &info);
    return keep_error(a, result, &info.error);
}
static sb_result act_match_run(actor *a)
{
    reg_match_info info;
    sb_result result = reg_match_run(a->match, 5, &info);
    return keep_error(a, result, &info.error);
}
static sb_result act_match_restart(actor *a)
{
    reg_match_restart(a->match);
    return SB_OK;
}
static sb_result act_match_landmarks(actor *a) { return reg_match_move_landmarks(a->match, NULL); }
static sb_result act_loads(actor *a)
{
    reg_loads_def def = reg_default_loads_def();
    reg_loads_info info;
    sb_result result;
    def.match = a->match;
    def.samples = 30;
    def.rounds = 2;
    def.pose = REAL(0.01);
    result = reg_loads_run(&def, NULL, &info);
    return keep_error(a, result, &info.error);
}
static sb_result act_nicp_create(actor *a)
{
    reg_nicp_def def = reg_default_nicp_def();
    reg_nicp *nicp = NULL;
    sb_result result;
    def.body = a->body;
    def.target = &a->target;
    result = reg_nicp_create(&def, &nicp, &a->error);
    reg_nicp_destroy(nicp);
    return result;
}
static sb_result act_nicp_step(actor *a)
{
    reg_nicp_info info;
    sb_result result = reg_nicp_step(a->nicp, &info);
    return keep_error(a, result, &info.error);
}
static sb_result act_nicp_run(actor *a)
{
    reg_nicp_info info;
    sb_result result = reg_nicp_run(a->nicp, 3, &info);
    return keep_error(a, result, &info.error);
}
static sb_result act_nicp_restart(actor *a)
{
    reg_nicp_restart(a->nicp);
    return SB_OK;
}
static sb_result act_nicp_landmarks(actor *a)
{
    sb_vec3 goal = sb_v3(REAL(0.1), 0, REAL(0.01));
    return reg_nicp_move_landmarks(a->nicp, &goal);
}
static sb_result act_nicp_destroy(actor *a)
{
    reg_nicp_destroy(a->nicp);
    a->nicp = NULL;
    return SB_OK;
}
static sb_result act_match_destroy(actor *a)
{
    reg_match_destroy(a->match);
    a->match = NULL;
    return SB_OK;
}

static const act acts[] = {
    {"sb_body_set_material", act_material, ACTOR_LOADED},
    {"sb_body_set_region_material", act_region, ACTOR_LOADED},
    {"sb_body_set_fibres", act_fibres, ACTOR_PLAIN},
    {"sb_body_set_tension", act_tension, ACTOR_PLAIN},
    {"sb_body_set_gravity", act_gravity, ACTOR_LOADED},
    {"sb_body_set_damping", act_damping, ACTOR_LOADED},
    {"sb_body_set_region_damping", act_region_damping, ACTOR_LOADED},
    {"sb_body_set_solver", act_solver, ACTOR_LOADED},
    {"sb_body_keep_tangent", act_keep_tangent, ACTOR_PLAIN},
    {"sb_body_change_begin", act_change, ACTOR_LOADED},
    {"sb_embedding_follow", act_embed, ACTOR_PLAIN},
    {"sb_body_listen", act_listen, ACTOR_PLAIN},
    {"sb_body_unlisten", act_unlisten, ACTOR_PLAIN},
    {"sb_body_fix_nodes", act_fix, ACTOR_PLAIN},
    {"sb_body_prescribe", act_prescribe, ACTOR_PLAIN},
    {"sb_body_release_nodes", act_release, ACTOR_LOADED},
    {"sb_body_hold", act_hold, ACTOR_PLAIN},
    {"sb_body_place", act_place, ACTOR_PLAIN},
    {"sb_body_place_rigid", act_place_rigid, ACTOR_PLAIN},
    {"sb_body_release", act_let_go, ACTOR_LOADED},
    {"sb_body_set_displacements", act_displace, ACTOR_LOADED},
    {"sb_body_set_velocities", act_velocities, ACTOR_LOADED},
    {"sb_body_reset", act_reset, ACTOR_LOADED},
    {"sb_body_energy", act_energy, ACTOR_LOADED},
    {"sb_body_multiply_stiffness", act_multiply, ACTOR_LOADED},
    {"sb_body_multiply_tangent", act_multiply_tangent, ACTOR_LOADED},
    {"sb_body_stiffness_matrix", act_stiffness_matrix, ACTOR_LOADED},
    {"sb_body_energy_densities", act_energy_densities, ACTOR_LOADED},
    {"sb_body_nodal_rotations", act_rotations, ACTOR_LOADED},
    {"sb_body_parts", act_parts, ACTOR_LOADED},
    {"sb_body_add_forces", act_forces, ACTOR_LOADED},
    {"sb_body_apply_forces", act_apply, ACTOR_LOADED},
    {"sb_body_add_traction", act_traction, ACTOR_LOADED},
    {"sb_body_clear_loads", act_clear, ACTOR_LOADED},
    {"sb_body_add_pressure", act_add_pressure, ACTOR_PLAIN},
    {"sb_body_set_pressure", act_pressure, ACTOR_LOADED},
    {"sb_body_add_springs", act_add_springs, ACTOR_PLAIN},
    {"sb_body_move_springs", act_move_springs, ACTOR_LOADED},
    {"sb_body_set_spring_stiffness", act_spring_stiffness, ACTOR_LOADED},
    {"sb_body_add_cable", act_add_cable, ACTOR_PLAIN},
    {"sb_body_set_cable_rest_length", act_cable_length, ACTOR_LOADED},
    {"sb_body_set_cable_stiffness", act_cable_stiffness, ACTOR_LOADED},
    {"sb_body_move_cable", act_move_cable, ACTOR_LOADED},
    {"sb_body_add_membrane", act_add_membrane, ACTOR_PLAIN},
    {"sb_body_set_membrane", act_membrane, ACTOR_LOADED},
    {"sb_body_add_cavity", act_add_cavity, ACTOR_PLAIN},
    {"sb_body_inject_cavity", act_inject, ACTOR_LOADED},
    {"sb_body_set_cavity_pressure", act_cavity_pressure, ACTOR_LOADED},
    {"sb_body_cavity_volume", act_cavity_volume, ACTOR_LOADED},
    {"sb_body_add_rigid", act_add_rigid, ACTOR_PLAIN},
    {"sb_body_set_rigid_load", act_load_rigid, ACTOR_PLAIN},
    {"sb_body_remove_rigid", act_remove_rigid, ACTOR_PLAIN},
    {"sb_body_add_mapping", act_add_mapping, ACTOR_PLAIN},
    {"sb_body_set_mapping_targets", act_mapping_targets, ACTOR_LOADED},
    {"sb_body_set_mapping_stiffness", act_mapping_stiffness, ACTOR_LOADED},
    {"sb_body_remove_load", act_remove_load, ACTOR_LOADED},
    {"sb_body_add_constraint", act_constraint, ACTOR_PLAIN},
    {"sb_body_add_constraints", act_constraints, ACTOR_PLAIN},
    {"sb_body_set_constraint_value", act_constraint_value, ACTOR_LOADED},
    {"sb_body_remove_constraints", act_remove_constraints, ACTOR_LOADED},
    {"sb_body_remove_constraint", act_remove_constraint, ACTOR_LOADED},
    {"sb_body_clear_constraints", act_clear_constraints, ACTOR_LOADED},
    {"sb_body_tie_faces", act_tie, ACTOR_PLAIN},
    {"sb_body_modes", act_modes, ACTOR_LOADED},
    {"sb_body_stable_step", act_stable_step, ACTOR_LOADED},
    {"sb_body_state_load", act_load_state, ACTOR_LOADED},
    {"sb_body_state_load_file", act_load_file, ACTOR_LOADED},
    {"sb_body_step", act_step, ACTOR_LOADED},
    {"sb_body_solve_static", act_static, ACTOR_LOADED},
    {"sb_identify", act_identify, ACTOR_LOADED},
    {"sb_body_solve_tangent", act_solve_tangent, ACTOR_LOADED},
    {"sb_body_sensitivities", act_sensitivities, ACTOR_LOADED},
    {"sb_body_gradient", act_gradient, ACTOR_LOADED},
    {"sb_recording_replay", act_replay, ACTOR_PLAIN},
    {"sb_recording_start", act_record_again, ACTOR_LOADED},
    {"reg_match_create", act_match_create, ACTOR_PLAIN},
    {"reg_match_step", act_match_step, ACTOR_MATCHED},
    {"reg_match_run", act_match_run, ACTOR_MATCHED},
    {"reg_match_restart", act_match_restart, ACTOR_MATCHED},
    {"reg_match_move_landmarks", act_match_landmarks, ACTOR_MATCHED},
    {"reg_match_destroy", act_match_destroy, ACTOR_MATCHED},
    {"reg_loads_run", act_loads, ACTOR_MATCHED},
    {"reg_nicp_create", act_nicp_create, ACTOR_PLAIN},
    {"reg_nicp_step", act_nicp_step, ACTOR_NICP},
    {"reg_nicp_run", act_nicp_run, ACTOR_NICP},
    {"reg_nicp_restart", act_nicp_restart, ACTOR_NICP},
    {"reg_nicp_move_landmarks", act_nicp_landmarks, ACTOR_NICP},
    {"reg_nicp_destroy", act_nicp_destroy, ACTOR_NICP},
};
enum { ACT_COUNT = (int)(sizeof acts / sizeof *acts) };

/* ---- the body ---- */

/* A bar of 6 x 2 x 2 cm, and a slab above it that nothing holds but what an act ties or a setup springs. */
static int make_mesh(sb_element_type type, sb_mesh *mesh)
{
    sb_mesh second = scene_box(type, 3, 1, 1, sb_v3(REAL(0.06), REAL(0.02), REAL(0.01)), 0);
    int made;
    *mesh = scene_box(type, 3, 1, 1, sb_v3(REAL(0.06), REAL(0.02), REAL(0.02)), 0);
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].z += REAL(0.021);
    made = CHECK_OK(sb_mesh_append(mesh, &second, NULL));
    sb_mesh_free(&second);
    return made && CHECK(mesh->element_count <= MAX_CELLS);
}

static void set_up(actor *a, actor_kind kind)
{
    scene_fix_plane(a->body, &a->mesh, 0, 0, SB_XYZ);
    a->free_nodes[0] = a->mesh.node_count / 2 - 1;
    a->free_nodes[1] = a->mesh.node_count - 1;
    if (kind == ACTOR_LOADED) {
        CHECK_OK(act_add_pressure(a));
        CHECK_OK(act_add_springs(a));
        CHECK_OK(act_add_cable(a));
        CHECK_OK(act_add_membrane(a));
        CHECK_OK(act_add_cavity(a));
        CHECK_OK(act_add_mapping(a));
        CHECK_OK(act_constraint(a));
    }
    if (kind == ACTOR_MATCHED) {
        reg_match_def def = reg_default_match_def();
        def.body = a->body;
        def.target = &a->target;
        CHECK_OK(reg_match_create(&def, &a->match, &a->error));
        CHECK_OK(reg_match_run(a->match, 3, NULL));
    }
    if (kind == ACTOR_NICP) {
        reg_nicp_def def = reg_default_nicp_def();
        sb_vec3 landmark = a->mesh.nodes[a->free_nodes[0]], goal = landmark;
        goal.z += REAL(0.001);
        def.body = a->body;
        def.target = &a->target;
        def.landmarks = &landmark;
        def.landmark_targets = &goal;
        def.landmark_count = 1;
        CHECK_OK(reg_nicp_create(&def, &a->nicp, &a->error));
        CHECK_OK(reg_nicp_step(a->nicp, NULL));
    }
    CHECK_OK(sb_body_step(a->body, REAL(0.002), NULL));
    a->state_size = sb_body_state_size(a->body);
    a->state = malloc(a->state_size);
    CHECK_OK(sb_body_state_save(a->body, a->state, a->state_size));
    CHECK_OK(sb_body_step(a->body, REAL(0.002), NULL));
}

static int make_actor(actor *a, const act *what, const scheme *how)
{
    memset(a, 0, sizeof *a);
    a->path = "build/test_recorded.state";
    if (!make_mesh(how->element, &a->mesh) || !CHECK_OK(sb_mesh_boundary(&a->mesh, 1, NULL, &a->boundary, NULL)) ||
        !CHECK_OK(sb_surface_triangulate(&a->boundary.surface, NULL, &a->target, NULL)))
        return 0;
    for (int i = 0; i < a->target.node_count; i++) {
        double x = (double)a->target.nodes[i].x;
        a->target.nodes[i].z += REAL(2 * x * x);
    }
    a->how = how;
    a->body = make_body(&a->mesh, how);
    if (!a->body)
        return 0;
    set_up(a, what->kind);
    return 1;
}

static void free_actor(actor *a)
{
    reg_match_destroy(a->match);
    reg_nicp_destroy(a->nicp);
    sb_body_destroy(a->body);
    sb_boundary_free(&a->boundary);
    sb_mesh_free(&a->mesh);
    sb_mesh_free(&a->target);
    free(a->state);
}

/* ---- playing again ---- */

static void check_replay(const actor *a, const sb_recording *recording, const scheme *how, const char *name)
{
    sb_recording_report report;
    sb_body *other = make_body(&a->mesh, how);
    if (other) {
        if (!CHECK_OK(sb_recording_replay(recording, other, &report)))
            printf("%s, integrator %d, preconditioner %d: %s\n", name, (int)how->integrator, (int)how->precond,
                   report.error.message);
        if (!CHECK(sb_body_state_hash(other) == sb_body_state_hash(a->body)))
            printf("%s, integrator %d, preconditioner %d: another state\n", name, (int)how->integrator,
                   (int)how->precond);
    }
    sb_body_destroy(other);
}

/* The act while the body is recorded, or just before that begins. */
static void play(const act *what, const scheme *how, int before)
{
    actor a;
    sb_recording *recording = NULL;
    sb_result result = SB_OK;
    if (make_actor(&a, what, how)) {
        if (before)
            result = what->run(&a);
        CHECK_OK(sb_recording_start(a.body, 1, NULL, &recording, NULL));
        CHECK_OK(sb_body_step(a.body, REAL(0.002), NULL));
        if (!before)
            result = what->run(&a);
        if (!CHECK_OK(result))
            printf("%s: %s: %s\n", what->name, sb_result_string(result), a.error.message);
        CHECK_OK(sb_body_step(a.body, REAL(0.002), NULL));
        CHECK_OK(sb_body_step(a.body, REAL(0.001), NULL));
        check_replay(&a, recording, how, what->name);
    }
    sb_recording_destroy(recording);
    free_actor(&a);
}

static void check_scheme(sb_element_type element, sb_integrator integrator, sb_precond_kind precond)
{
    scheme how;
    how.element = element;
    how.integrator = integrator;
    how.precond = precond;
    for (int i = 0; i < ACT_COUNT; i++) {
        play(acts + i, &how, 0);
        play(acts + i, &how, 1);
    }
}

static void test_tet4(void) { check_scheme(SB_TET4, SB_NEWMARK, SB_PRECOND_AUTO); }
static void test_hex8(void) { check_scheme(SB_HEX8, SB_EULER, SB_PRECOND_IC0); }
static void test_factor(void) { check_scheme(SB_TET4, SB_GENERALISED_ALPHA, SB_PRECOND_CHOLESKY); }
static void test_multigrid(void) { check_scheme(SB_TET4, SB_NEWMARK, SB_PRECOND_MULTIGRID); }
static void test_explicit(void) { check_scheme(SB_HEX8, SB_CENTRAL_DIFFERENCE, SB_PRECOND_BLOCK_JACOBI); }

/* ---- none is missing ---- */

/* 1 when the declaration takes something by which a body can be changed. */
static int takes_body(const char *declaration)
{
    static const char *const kinds[] = {"sb_body *",       "reg_match *",     "reg_nicp *",
                                        "reg_loads_def *", "reg_match_def *", "reg_nicp_def *"};
    for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++) {
        const char *at = strchr(declaration, '(');
        while (at && (at = strstr(at, kinds[k])) != NULL) {
            int is_def = strstr(kinds[k], "_def") != NULL;
            if (is_def || strncmp(at - 6, "const ", 6) != 0)
                return 1;
            at++;
        }
    }
    return 0;
}

/* Changes of the mesh, which need slack, are recorded and replayed in test_live_mesh.c, and what bears none, second
 * families of fibres and heat, in test_fibres.c and test_heat.c; networks' guesses in test_network_predict.c. Listeners
 * change no body, unloading makes one, and gradients of motions refuse those that are recorded (test_motion.c). */
static int has_act(const char *name)
{
    static const char *const elsewhere[] = {"sb_body_destroy",    "sb_body_create",         "sb_body_change_begin",
                                            "sb_body_listen",     "sb_body_unlisten",       "sb_body_set_second_fibres",
                                            "sb_body_unload",     "sb_particles_stabilise", "sb_heat_create",
                                            "sb_network_predict", "sb_recording_gradient"};
    for (int i = 0; i < ACT_COUNT; i++)
        if (strcmp(acts[i].name, name) == 0)
            return 1;
    for (size_t i = 0; i < sizeof elsewhere / sizeof *elsewhere; i++)
        if (strcmp(name, elsewhere[i]) == 0)
            return 1;
    return 0;
}

/* A match that finds nothing to match leaves a recorded body as it was to the last bit, and no trace in the
 * recording. */
static void test_failed_match(void)
{
    const act match = {"reg_match_step", act_match_step, ACTOR_MATCHED};
    scheme how;
    actor a;
    reg_match_def def = reg_default_match_def();
    sb_recording *recording = NULL;
    how.element = SB_TET4;
    how.integrator = SB_NEWMARK;
    how.precond = SB_PRECOND_AUTO;
    if (make_actor(&a, &match, &how)) {
        reg_match *far = NULL;
        uint64_t hash;
        for (int i = 0; i < a.target.node_count; i++)
            a.target.nodes[i].x += 1;
        def.body = a.body;
        def.target = &a.target;
        def.partial = 1;
        CHECK_OK(reg_match_create(&def, &far, NULL));
        CHECK_OK(sb_recording_start(a.body, 1, NULL, &recording, NULL));
        hash = sb_body_state_hash(a.body);
        CHECK(reg_match_step(far, NULL) == SB_ERROR_NOT_CONVERGED);
        CHECK(sb_body_state_hash(a.body) == hash);
        CHECK_INT(sb_recording_get_info(recording).commands, 0);
        CHECK_OK(sb_body_step(a.body, REAL(0.002), NULL));
        check_replay(&a, recording, &how, "failed match");
        reg_match_destroy(far);
    }
    sb_recording_destroy(recording);
    free_actor(&a);
}

/* Looks at every public declaration of a header. Returns how many change bodies; -1: no such file. */
static int look_through(const char *path)
{
    static char text[1024], name[128];
    char line[512];
    FILE *file = fopen(path, "r");
    int found = 0;
    while (file && fgets(line, sizeof line, file)) {
        const char *end;
        if (strncmp(line, "SB_API ", 7) != 0 && strncmp(line, "REG_API ", 8) != 0)
            continue;
        snprintf(text, sizeof text, "%s", line);
        while (!strchr(text, ';') && !strchr(text, '{') && fgets(line, sizeof line, file))
            strncat(text, line, sizeof text - strlen(text) - 1);
        if (strchr(text, '{') || !strchr(text, ';') || !strchr(text, '(') || !takes_body(text))
            continue; /* definitions stand below the declarations */
        end = strchr(text, '(');
        for (const char *at = end; at > text; at--)
            if (at[-1] == ' ' || at[-1] == '*') {
                snprintf(name, sizeof name, "%.*s", (int)(end - at), at);
                break;
            }
        found++;
        if (!CHECK(has_act(name)))
            printf("%s changes a body and is not tried on a recorded one\n", name);
    }
    if (file)
        fclose(file);
    return file ? found : -1;
}

static void test_all_named(void)
{
    int found = look_through("softbody.h");
    if (found < 0) {
        CHECK_SKIP("the headers are not in the working directory");
        return;
    }
    CHECK(found > 35);
    CHECK(look_through("register.h") > 8);
}

CHECK_SUITE(recorded, {"tet4, Newmark", test_tet4}, {"hex8, Euler, IC(0)", test_hex8},
            {"generalised alpha, factor", test_factor}, {"multigrid", test_multigrid},
            {"central differences", test_explicit}, {"a match that fails", test_failed_match},
            {"no function is missing", test_all_named});
