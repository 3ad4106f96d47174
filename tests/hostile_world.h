/* hostile_world.h: one of each thing that public functions take, small, made when first asked for. */
#ifndef HOSTILE_WORLD_H
#define HOSTILE_WORLD_H

#include "needle.h"
#include "network_scene.h"
#include "register.h"
#include "scene.h"
#include "softbody.h"
#include "wedge.h"

enum { WORLD_NODES = 27, WORLD_CLOUD = 60, WORLD_IMAGE = 1 << 20 };
#define WORLD_FILE "build/test_hostile.tmp"

typedef struct world {
    sb_allocator allocator;
    sb_jobs jobs;
    sb_mesh mesh, hexes, surface; /* 2 x 2 x 2 cells of 2 cm, and the boundary of the tets */
    sb_mesh spoilt;               /* arrays of a mesh that is to have bad content */
    sb_element_table table;
    sb_material material;
    sb_body *body;          /* with every kind of load and a constraint */
    sb_body *live, *idle;   /* whose meshes may change: one is being changed, one is not */
    sb_body_change *change; /* of live */
    sb_body *touched;       /* with a contact of two tools: a sphere, and capsules that may be bent */
    sb_contact *contact;
    sb_contact_def contact_def;
    sb_body *parted; /* with a cut */
    sb_cut *cut;
    sb_cut_surface *cut_surface;
    sb_cut_fine *cut_fine;
    sb_cut_def cut_def;
    sb_body *warm; /* with heat: a source and a wall that cools */
    sb_heat *heat;
    sb_heat_def heat_def;
    int heat_source, heat_wall;
    sb_network *network, *guesser; /* the latter of the grid and its body */
    sb_network_def network_def;
    sb_network_input network_input;
    sb_body *grid_body; /* of the grid */
    sb_haptic *haptic;  /* a hand at the sphere */
    sb_haptic_def haptic_def;
    sb_tool_def tool_def;
    sb_pose tool_pose;
    sb_change_cell change_cell;
    int pressure, springs, mapping, constraint, cable, membrane, cavity, open_cavity;
    sb_cable_def cable_def;
    sb_membrane_def membrane_def;
    sb_cavity_def cavity_def;
    sb_body *plain;          /* for registration: without */
    sb_recording *recording; /* of plain */
    sb_domain domain;
    sb_matrix matrix;
    sb_direct *direct;
    sb_preconditioner *preconditioner;
    sb_pcg_workspace workspace;
    sb_embedding *embedding;
    sb_surface *shape;
    sb_grid grid;
    sb_mixture mixture;
    sb_grid_rows rows;
    sb_particles particles;
    sb_body *cloud_body;         /* of the particles */
    sb_body *pierced, *remeshed; /* of the needle, and of the remesher */
    ndl_needle *needle;
    ndl_remesh *remesh;
    ndl_rod *rod;
    ndl_steer steer;
    ndl_push push;
    int has_steer, has_push;
    reg_cloud cloud;
    reg_cpd *cpd;
    reg_field *field;
    reg_kdtree *tree;
    reg_match *match;
    reg_nicp *nicp;
    int has_file;
    sb_output output; /* a file that is being written */
    /* arguments that are looked at during a call only */
    sb_vec3 vectors[WORLD_CLOUD];
    sb_real reals[4 * WORLD_CLOUD];
    int ints[4 * WORLD_CLOUD];
    sb_quat turns[WORLD_CLOUD];
    sb_constraint_term terms[2];
    sb_parameter parameter;
    sb_recording_slopes slopes;
    sb_body *mover; /* whose motion is recorded */
    sb_recording *moved;
    sb_measurement measurement;
    sb_identify_def identify_def;
    sb_body *still; /* at an equilibrium */
    sb_body *hung;  /* with a free rigid body */
    sb_rigid_def rigid_def;
    int rigid;
    sb_shape solid;
    sb_mapping rows_of_two;
    sb_body_def body_def;
    sb_surface_hit hit;
    ndl_surface_hit entry;
    sb_embedding_def embedding_def;
    sb_grid_def grid_def;
    sb_mixture_def mixture_def;
    sb_particles_def particles_def;
    sb_stuff_def stuff_def;
    sb_field fields[1];
    sb_test_point tests[6];
    sb_load_options load_options;
    sb_image labelled;
    int voxels[8];
    sb_label_def label_def;
    sb_fit_options fit_options;
    sb_modes_options modes_options;
    sb_unload_def unload_def;
    sb_static_options static_options;
    sb_tear_options tear_options;
    sb_pcg_options pcg_options;
    sb_preconditioner_def preconditioner_def;
    sb_direct_def direct_def;
    sb_surface_repair_def repair_def;
    ndl_needle_def needle_def;
    ndl_remesh_def remesh_def;
    ndl_rod_def rod_def;
    ndl_rod_static_options rod_options;
    ndl_tip_pose pose;
    ndl_bevel bevel;
    ndl_obstacle obstacle;
    ndl_plan_def plan_def;
    ndl_plan plan;
    ndl_steer_def steer_def;
    ndl_push_def push_def;
    ndl_guide_def guide_def;
    ndl_push_place place;
    ndl_command command;
    ndl_needle *needles[1];
    reg_rigid motion;
    reg_icp_shape icp_shape;
    reg_icp_options icp_options;
    reg_cpd_options cpd_options;
    reg_field_def field_def;
    reg_match_def match_def;
    reg_nicp_def nicp_def;
    reg_loads_def loads_def;
    reg_model_def organ_model_def;
    reg_model *organ_model;
    reg_infer_def infer_def;
    reg_infer *infer;
    reg_track_def track_def;
    reg_track *track;
    reg_points points_seen;
    reg_landmark landmarks[2];
    reg_curve curve;
    unsigned char *image;
    size_t image_bytes;
} world;

/* Arguments that are the same in every world; those that calls change are put right by world_begin. */
static const sb_mat3 world_identity = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
static const sb_mat3 world_compliance = {{{REAL(0.001), 0, 0}, {0, REAL(0.001), 0}, {0, 0, REAL(0.001)}}};
static const double world_transform[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1};
static const unsigned char world_mask[WORLD_NODES] = {SB_XYZ, SB_X};
static const int world_two[1] = {2}, world_slave[1] = {26}, world_starts[2] = {0, 4}, world_pivots[3] = {0, 1, 2};
static const sb_real world_shares[1] = {REAL(0.3)};
static const sb_real world_warm[WORLD_NODES] = {300, 301, 302, 303, 304, 305, 306, 307, 308, 309, 310, 311, 312, 313,
                                                314, 315, 316, 317, 318, 319, 320, 321, 322, 323, 324, 325, 326};
static const sb_real world_even[8] = {REAL(0.125), REAL(0.125), REAL(0.125), REAL(0.125),
                                      REAL(0.125), REAL(0.125), REAL(0.125), REAL(0.125)};
/* A network of one node and one channel: out = 2 in + 1. */
static const unsigned char world_weights[84] = {
    83, 66, 78,  69, 84, 48, 48,  49, 1, 0, 0,   0,  1, 0, 0,   0,  1, 0, 0, 0,  1, 0, 0,   0,  0,   0,   128, 63,
    0,  0,  128, 63, 0,  0,  128, 63, 0, 0, 128, 63, 0, 0, 128, 62, 1, 0, 0, 0,  1, 0, 0,   0,  1,   0,   0,   0,
    0,  0,  0,   0,  1,  0,  0,   0,  1, 0, 0,   0,  0, 0, 0,   0,  0, 0, 0, 64, 0, 0, 128, 63, 134, 171, 243, 57};
static const float world_floats[1] = {3};
static const sb_real world_spd[9] = {4, 1, 0, 1, 4, 1, 0, 1, 4};
static const ndl_rod_section world_section = {REAL(0.0005), 0, REAL(2e11), REAL(0.3), 8000};
static sb_material world_prony, world_rubber;

static int world_law_energy(void *user, const sb_mat3 *F, sb_real *W)
{
    return sb_material_energy((const sb_material *)user, F, NULL, W);
}

static int world_law_stress(void *user, const sb_mat3 *F, sb_mat3 *P)
{
    return sb_material_stress((const sb_material *)user, F, NULL, P);
}

static const sb_material_law world_law = {"rubber", &world_rubber, world_law_energy, world_law_stress, NULL};
static const sb_matrix *world_lent;
static sb_material_history world_history;
static sb_mesh_report world_report;
static sb_index_table world_index_table;
static sb_index_lists world_index_lists;
static sb_boundary world_boundary;
static sb_mesh_sets world_sets;
static sb_embedding_rows world_embedding_rows;

/* What asks for more than a hundred megabytes here asks for nonsense. */
static void *world_alloc(void *user, size_t bytes)
{
    (void)user;
    return bytes > (size_t)100 << 20 ? NULL : malloc(bytes);
}

static void world_release(void *user, void *pointer)
{
    (void)user;
    free(pointer);
}

static double world_clock(void) { return 0; }

static void world_begin(world *w)
{
    memset(w, 0, sizeof *w);
    w->allocator.alloc = world_alloc;
    w->allocator.release = world_release;
    w->material = sb_material_corotated(5000, REAL(0.4), 1000);
    w->table = wedge_table();
    for (int i = 0; i < WORLD_CLOUD; i++) {
        w->vectors[i] = sb_v3(REAL(0.001) * REAL(i % 3), REAL(0.001) * REAL(i % 7), REAL(0.001) * REAL(i % 11));
        w->turns[i] = sb_quat_identity();
    }
    for (int i = 0; i < 4 * WORLD_CLOUD; i++) {
        w->reals[i] = REAL(1) + REAL(0.01) * REAL(i);
        w->ints[i] = i % 8;
    }
    w->pose.position = sb_v3(0, 0, 0);
    w->pose.frame.t = sb_v3(0, 0, 1), w->pose.frame.m1 = sb_v3(1, 0, 0), w->pose.frame.m2 = sb_v3(0, 1, 0);
    w->motion = reg_rigid_identity();
    world_rubber = sb_material_neo_hookean(5000, REAL(0.4), 1000);
    world_prony = sb_material_with_prony(world_rubber, world_shares, world_shares, 1);
    memset(&world_history, 0, sizeof world_history);
    memset(&world_report, 0, sizeof world_report);
    memset(&world_index_table, 0, sizeof world_index_table);
    memset(&world_index_lists, 0, sizeof world_index_lists);
    memset(&world_boundary, 0, sizeof world_boundary);
    memset(&world_sets, 0, sizeof world_sets);
    memset(&world_embedding_rows, 0, sizeof world_embedding_rows);
}

/* ---- softbody ---- */

static sb_mesh *world_mesh(world *w)
{
    if (!w->mesh.nodes)
        CHECK_OK(
            sb_mesh_beam(SB_TET4, 2, 2, 2, sb_v3(REAL(0.04), REAL(0.04), REAL(0.04)), &w->allocator, &w->mesh, NULL));
    if (w->mesh.nodes && !w->mesh.regions)
        w->mesh.regions = (int *)calloc((size_t)w->mesh.element_count, sizeof(int));
    return &w->mesh;
}

static sb_mesh *world_hexes(world *w)
{
    if (!w->hexes.nodes)
        CHECK_OK(
            sb_mesh_beam(SB_HEX8, 2, 2, 2, sb_v3(REAL(0.04), REAL(0.04), REAL(0.04)), &w->allocator, &w->hexes, NULL));
    return &w->hexes;
}

static sb_mesh *world_surface(world *w)
{
    sb_boundary boundary;
    if (w->surface.nodes)
        return &w->surface;
    CHECK_OK(sb_mesh_boundary(world_mesh(w), 1, &w->allocator, &boundary, NULL));
    w->surface = boundary.surface;
    memset(&boundary.surface, 0, sizeof boundary.surface);
    sb_boundary_free(&boundary);
    return &w->surface;
}

/* A mesh's arrays as copies with bad content; what is replaced: see hostile_put_mesh. */
static void world_spoil_mesh(world *w, sb_mesh *mesh, int value)
{
    int width = sb_mesh_element_width(mesh);
    sb_mesh_free(&w->spoilt);
    CHECK_OK(sb_mesh_copy(mesh, NULL, &w->spoilt, NULL));
    if (value == 2)
        w->spoilt.nodes[0].y = REAL(HUGE_VAL) - REAL(HUGE_VAL);
    else
        w->spoilt.elements[value ? width * mesh->element_count - 1 : 0] = value ? INT_MAX : -1;
    mesh->nodes = w->spoilt.nodes;
    mesh->elements = w->spoilt.elements;
}

static sb_body_def *world_body_def(world *w)
{
    w->body_def = sb_default_body_def();
    w->body_def.mesh = world_mesh(w);
    w->body_def.material = w->material;
    w->body_def.allocator = w->allocator;
    w->body_def.gravity = sb_v3(0, 0, REAL(-9.81));
    return &w->body_def;
}

static sb_result world_dress(void *user, sb_body *body, sb_real share, sb_error *error)
{
    const int nodes[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    (void)user;
    (void)share;
    return sb_body_hold(body, nodes, 8, SB_XYZ, error);
}

static sb_unload_def *world_unload_def(world *w)
{
    w->unload_def = sb_default_unload_def();
    w->unload_def.body = *world_body_def(w);
    w->unload_def.dress = world_dress;
    return &w->unload_def;
}

/* Nodes of a corner face of the mesh's boundary, in the numbers of the volume. */
static const int *world_face(world *w)
{
    sb_boundary boundary;
    if (sb_mesh_boundary(world_mesh(w), 0, NULL, &boundary, NULL) == SB_OK) {
        memcpy(w->ints, boundary.surface.elements, 3 * sizeof(int));
        sb_boundary_free(&boundary);
    }
    return w->ints;
}

static sb_mapping *world_mapping(world *w)
{
    static const int starts[2] = {0, 2}, nodes[2] = {13, 14};
    static const sb_real weights[2] = {REAL(0.5), REAL(0.5)};
    w->rows_of_two.row_count = 1;
    w->rows_of_two.row_start = starts;
    w->rows_of_two.nodes = nodes;
    w->rows_of_two.weights = weights;
    return &w->rows_of_two;
}

static sb_constraint_term *world_terms(world *w, int slave)
{
    w->terms[0].node = slave, w->terms[0].axis = 0, w->terms[0].coefficient = 1;
    w->terms[1].node = 25, w->terms[1].axis = 0, w->terms[1].coefficient = -1;
    return w->terms;
}

static sb_cable_def *world_cable_def(world *w)
{
    static const int path[2] = {-1, 26};
    static const sb_vec3 places[2] = {{REAL(0.1), REAL(0.1), REAL(0.3)}, {0, 0, 0}};
    w->cable_def = sb_default_cable_def();
    w->cable_def.count = 2;
    w->cable_def.nodes = path;
    w->cable_def.places = places;
    w->cable_def.stiffness = 1;
    return &w->cable_def;
}

static sb_membrane_def *world_membrane_def(world *w)
{
    w->membrane_def = sb_default_membrane_def();
    w->membrane_def.faces = world_face(w);
    w->membrane_def.face_count = 1;
    w->membrane_def.thickness = REAL(0.001);
    w->membrane_def.shear = 1000;
    return &w->membrane_def;
}

static sb_cavity_def *world_cavity_def(world *w)
{
    w->cavity_def = sb_default_cavity_def();
    w->cavity_def.faces = world_face(w);
    w->cavity_def.face_count = 1;
    w->cavity_def.kind = SB_CAVITY_TABLE;
    w->cavity_def.point_count = 2;
    w->cavity_def.table_volume[0] = REAL(-1e-4);
    w->cavity_def.table_volume[1] = REAL(1e-4);
    w->cavity_def.table_pressure[0] = 20;
    return &w->cavity_def;
}

static sb_body *world_body(world *w)
{
    sb_real k = 10;
    int node = 26;
    if (w->body)
        return w->body;
    CHECK_OK(sb_body_create(world_body_def(w), &w->body, NULL));
    if (!w->body)
        return NULL;
    scene_fix_plane(w->body, world_mesh(w), 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_pressure(w->body, world_face(w), 1, 3, 10, &w->pressure, NULL));
    CHECK_OK(sb_body_add_springs(w->body, &node, 1, &k, 1, w->mesh.nodes + 26, &w->springs, NULL));
    CHECK_OK(sb_body_add_mapping(w->body, world_mapping(w), &k, 1, w->mesh.nodes + 13, &w->mapping, NULL));
    CHECK_OK(sb_body_add_cable(w->body, world_cable_def(w), &w->cable, NULL));
    CHECK_OK(sb_body_add_membrane(w->body, world_membrane_def(w), &w->membrane, NULL));
    CHECK_OK(sb_body_add_cavity(w->body, world_cavity_def(w), &w->cavity, NULL));
    w->cavity_def.kind = SB_CAVITY_PRESSURE;
    CHECK_OK(sb_body_add_cavity(w->body, &w->cavity_def, &w->open_cavity, NULL));
    CHECK_OK(sb_body_add_constraint(w->body, world_terms(w, 23), 2, 0, &w->constraint, NULL));
    CHECK_OK(sb_body_step(w->body, REAL(0.01), NULL));
    return w->body;
}

static void world_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    (void)user, (void)body, (void)change;
}

static const sb_body_listener *world_listener(void)
{
    static const sb_body_listener listener = {NULL, NULL, world_follow, NULL, NULL};
    return &listener;
}

static sb_body *world_make_live(world *w)
{
    sb_body_def def = *world_body_def(w);
    sb_body *body = NULL;
    def.slack = 1;
    CHECK_OK(sb_body_create(&def, &body, NULL));
    return body;
}

static sb_body *world_idle(world *w)
{
    if (!w->idle)
        w->idle = world_make_live(w);
    return w->idle;
}

static sb_body_change *world_change(world *w)
{
    if (!w->live)
        w->live = world_make_live(w);
    if (w->live && !w->change)
        CHECK_OK(sb_body_change_begin(w->live, &w->change, NULL));
    return w->change;
}

static sb_body_change *world_idle_change(world *w)
{
    sb_body_change *change = NULL;
    CHECK_OK(sb_body_change_begin(world_idle(w), &change, NULL));
    return change;
}

/* As many as the mesh has nodes or elements, and more. */
static const int *world_numbers(void)
{
    static const int numbers[500] = {0};
    return numbers;
}

static const sb_real *world_ones(void)
{
    static const sb_real ones[4] = {1, 1, 1, 1};
    return ones;
}

/* Element 0 once more. */
static const sb_change_cell *world_change_cell(world *w)
{
    w->change_cell = sb_default_change_cell();
    w->change_cell.nodes = w->mesh.elements;
    w->change_cell.parent = 0;
    return &w->change_cell;
}

/* A number of that body's listener. */
static int world_listening(world *w)
{
    int id = 0;
    CHECK_OK(sb_body_listen(world_idle(w), world_listener(), &id, NULL));
    return id;
}

static sb_body *world_plain(world *w)
{
    sb_body_def def = *world_body_def(w);
    def.gravity = sb_v3(0, 0, 0);
    if (!w->plain)
        CHECK_OK(sb_body_create(&def, &w->plain, NULL));
    return w->plain;
}

static sb_body *world_still(world *w)
{
    sb_static_options options = sb_default_static_options();
    sb_body_def def = *world_body_def(w);
    def.gravity = sb_v3(0, 0, REAL(-0.1));
    if (w->still)
        return w->still;
    CHECK_OK(sb_body_create(&def, &w->still, NULL));
    scene_fix_plane(w->still, world_mesh(w), 0, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(w->still, &options, NULL));
    return w->still;
}

static const int world_hung_nodes[2] = {25, 26};

static sb_rigid_def *world_rigid_def(world *w)
{
    w->rigid_def = sb_default_rigid_def();
    w->rigid_def.mass = 1;
    w->rigid_def.inertia = sb_m3_identity();
    w->rigid_def.nodes = world_hung_nodes;
    w->rigid_def.node_count = 2;
    return &w->rigid_def;
}

static sb_body *world_hung(world *w)
{
    sb_body_def def = *world_body_def(w);
    if (w->hung)
        return w->hung;
    CHECK_OK(sb_body_create(&def, &w->hung, NULL));
    scene_fix_plane(w->hung, world_mesh(w), 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_rigid(w->hung, world_rigid_def(w), &w->rigid, NULL));
    CHECK_OK(sb_body_step(w->hung, REAL(0.01), NULL));
    return w->hung;
}

static sb_parameter *world_parameters(world *w)
{
    w->parameter.kind = SB_PARAMETER_DENSITY;
    return &w->parameter;
}

static sb_real world_values[1];

static sb_identify_def *world_identify_def(world *w)
{
    static sb_vec3 point;
    sb_mapping_apply(world_mapping(w), sb_body_positions(world_still(w)), &point);
    world_values[0] = 1100;
    memset(&w->measurement, 0, sizeof w->measurement);
    w->measurement.rows = world_mapping(w);
    w->measurement.points = &point;
    w->measurement.sigma_point = REAL(0.01);
    w->identify_def = sb_default_identify_def();
    w->identify_def.body = world_still(w);
    w->identify_def.parameters = world_parameters(w);
    w->identify_def.count = 1;
    w->identify_def.measurements = &w->measurement;
    w->identify_def.max_iterations = 20;
    return &w->identify_def;
}

static sb_contact_def *world_contact_def(world *w)
{
    w->contact_def = sb_default_contact_def();
    w->contact_def.body = world_idle(w);
    w->contact_def.allocator = &w->allocator;
    return &w->contact_def;
}

static sb_heat_def *world_heat_def(world *w)
{
    w->heat_def = sb_default_heat_def();
    w->heat_def.stiffening = 1;
    return &w->heat_def;
}

static sb_heat *world_heat(world *w)
{
    if (w->heat)
        return w->heat;
    CHECK_OK(sb_body_create(world_body_def(w), &w->warm, NULL));
    CHECK_OK(sb_heat_create(w->warm, world_heat_def(w), &w->heat, NULL));
    CHECK_OK(sb_heat_add_source(w->heat, w->mesh.nodes[0], w->mesh.nodes[26], REAL(0.01), 1, &w->heat_source, NULL));
    CHECK_OK(sb_heat_add_convection(w->heat, world_face(w), 1, 3, 10, 290, &w->heat_wall, NULL));
    return w->heat;
}

static sb_network_def *world_network_def(world *w)
{
    w->network_def = sb_default_network_def();
    w->network_def.allocator = w->allocator;
    w->network_def.jobs = w->jobs;
    return &w->network_def;
}

static sb_network *world_network(world *w)
{
    if (!w->network)
        CHECK_OK(sb_network_load_memory(world_weights, sizeof world_weights, world_network_def(w), &w->network, NULL));
    return w->network;
}

static sb_cut_def *world_cut_def(world *w)
{
    w->cut_def = sb_default_cut_def();
    w->cut_def.body = world_idle(w);
    w->cut_def.allocator = w->allocator;
    w->cut_def.front = SB_CUT_GLUE;
    w->cut_def.toughness = REAL(100);
    return &w->cut_def;
}

static sb_cut *world_cut(world *w)
{
    sb_cut_def def = *world_cut_def(w);
    if (w->cut)
        return w->cut;
    w->parted = world_make_live(w);
    def.body = w->parted;
    CHECK_OK(sb_cut_create(&def, &w->cut, NULL));
    return w->cut;
}

static sb_cut_surface *world_cut_surface(world *w)
{
    if (!w->cut_surface)
        CHECK_OK(sb_cut_surface_create(world_cut(w), NULL, &w->cut_surface, NULL));
    return w->cut_surface;
}

static sb_cut_fine *world_cut_fine(world *w)
{
    if (!w->cut_fine)
        CHECK_OK(sb_cut_fine_create(world_cut(w), world_surface(w), NULL, &w->cut_fine, NULL));
    return w->cut_fine;
}

/* A triangle through the mesh. */
static const sb_vec3 *world_blade(void)
{
    static const sb_vec3 corners[3] = {{REAL(0.01), -1, -1}, {REAL(0.01), 1, -1}, {REAL(0.01), 0, 2}};
    return corners;
}

/* One under way in the world's cut, of the blade's first two corners. */
static int world_stroke(world *w)
{
    int stroke = 0;
    CHECK_OK(sb_cut_begin(world_cut(w), world_blade(), 2, &stroke, NULL));
    return stroke;
}

/* The same of scissors. */
static int world_scissors(world *w)
{
    int stroke = 0;
    CHECK_OK(sb_cut_begin(world_cut(w), world_blade(), 3, &stroke, NULL));
    return stroke;
}

/* Clear of the mesh. */
static sb_pose *world_pose(world *w)
{
    w->tool_pose.position = sb_v3(REAL(0.2), REAL(0.2), REAL(0.2));
    w->tool_pose.rotation = sb_quat_identity();
    return &w->tool_pose;
}

static sb_tool_def *world_tool_def(world *w)
{
    w->tool_def = sb_default_tool_def();
    w->tool_def.radius = REAL(0.01);
    w->tool_def.pose = *world_pose(w);
    return &w->tool_def;
}

static sb_contact_point world_touches[4];
static sb_part world_parts[4];
static int world_part_numbers[WORLD_NODES];
static const sb_vec3 *world_chain(void)
{
    static const sb_vec3 chain[2] = {{0, 0, 0}, {0, 0, REAL(0.1)}};
    return chain;
}

static sb_contact *world_contact(world *w)
{
    sb_contact_def def = *world_contact_def(w);
    sb_tool_def tool = *world_tool_def(w);
    int number = 0;
    if (w->contact)
        return w->contact;
    CHECK_OK(sb_body_create(world_body_def(w), &w->touched, NULL));
    def.body = w->touched;
    CHECK_OK(sb_contact_create(&def, &w->contact, NULL));
    CHECK_OK(sb_contact_add_tool(w->contact, &tool, &number, NULL));
    tool.shape = SB_TOOL_CAPSULES;
    tool.points = world_chain();
    tool.point_count = 2;
    CHECK_OK(sb_contact_add_tool(w->contact, &tool, &number, NULL));
    return w->contact;
}

/* Its system is that of the last step. */
static sb_contact *world_stepped(world *w)
{
    sb_contact *contact = world_contact(w);
    CHECK_OK(sb_body_step(w->touched, REAL(0.01), NULL));
    return contact;
}

static sb_tool_state world_hand;
static sb_haptic_def *world_haptic_def(world *w)
{
    w->haptic_def = sb_default_haptic_def();
    w->haptic_def.contact = world_contact(w);
    w->haptic_def.max_force = 3;
    w->haptic_def.max_stiffness = 1000;
    return &w->haptic_def;
}

static sb_haptic *world_haptic(world *w)
{
    if (!w->haptic)
        CHECK_OK(sb_haptic_create(world_haptic_def(w), &w->haptic, NULL));
    return w->haptic;
}

static sb_recording *world_recording(world *w)
{
    if (!w->recording) {
        CHECK_OK(sb_recording_start(world_plain(w), 1, &w->allocator, &w->recording, NULL));
        CHECK_OK(sb_body_step(world_plain(w), REAL(0.01), NULL));
    }
    return w->recording;
}

/* A recording that has ended, so that it may be played on the body. */
static sb_recording *world_ended(world *w)
{
    sb_recording_stop(world_recording(w));
    return w->recording;
}

/* A loss of nothing. */
static void world_slope(void *user, int step, const sb_vec3 *displacements, sb_vec3 *dj_du)
{
    (void)user;
    (void)step;
    (void)displacements;
    (void)dj_du;
}

static const sb_recording_loss world_loss = {world_slope, NULL};

static sb_body *world_mover(world *w)
{
    sb_body_def def = *world_body_def(w);
    def.max_newton = 20;
    def.newton_tolerance = REAL(1e-6);
    def.slack = 0;
    if (!w->mover)
        CHECK_OK(sb_body_create(&def, &w->mover, NULL));
    return w->mover;
}

static sb_recording *world_motion(world *w)
{
    if (w->moved)
        return w->moved;
    CHECK_OK(sb_recording_start(world_mover(w), 0, &w->allocator, &w->moved, NULL));
    CHECK_OK(sb_body_step(world_mover(w), REAL(0.01), NULL));
    sb_recording_stop(w->moved);
    return w->moved;
}

static sb_recording_slopes *world_slopes(world *w)
{
    w->slopes.gradient = w->reals;
    w->slopes.displacement = w->slopes.velocity = w->slopes.force = w->vectors;
    return &w->slopes;
}

static sb_domain *world_domain(world *w)
{
    if (!w->domain.cells)
        CHECK_OK(sb_domain_create(world_mesh(w), SB_INTEGRATION_AUTO, 0, &w->allocator, &w->domain, NULL));
    return &w->domain;
}

/* The pattern of the mesh with 3 on the diagonal and -0.1 beside it. */
static sb_matrix *world_matrix(world *w)
{
    sb_mesh *mesh = world_mesh(w);
    if (w->matrix.blocks)
        return &w->matrix;
    CHECK_OK(sb_matrix_create(mesh->node_count, mesh->element_count, 4, NULL, mesh->elements, &w->allocator, &w->matrix,
                              NULL));
    for (int i = 0; i < w->matrix.row_count; i++)
        for (int q = w->matrix.row_start[i]; q < w->matrix.row_start[i + 1]; q++)
            for (int k = 0; k < 9; k += 4)
                w->matrix.blocks[q][k] = w->matrix.columns[q] == i ? 3 : REAL(-0.1);
    return &w->matrix;
}

static sb_preconditioner_def *world_preconditioner_def(world *w)
{
    w->preconditioner_def = sb_default_preconditioner_def();
    w->preconditioner_def.kind = SB_PRECOND_IC0;
    w->preconditioner_def.positions = world_mesh(w)->nodes;
    w->preconditioner_def.piece_count = 2;
    return &w->preconditioner_def;
}

static sb_preconditioner *world_preconditioner(world *w)
{
    if (!w->preconditioner) {
        CHECK_OK(sb_preconditioner_create(world_preconditioner_def(w), world_matrix(w), &w->allocator,
                                          &w->preconditioner, NULL));
        CHECK_OK(sb_preconditioner_update(w->preconditioner, &w->matrix, NULL, NULL));
    }
    return w->preconditioner;
}

static sb_direct_def *world_direct_def(world *w)
{
    w->direct_def = sb_default_direct_def();
    w->direct_def.positions = world_mesh(w)->nodes;
    return &w->direct_def;
}

static sb_direct *world_direct(world *w)
{
    if (!w->direct) {
        CHECK_OK(sb_direct_create(world_direct_def(w), world_matrix(w), &w->allocator, &w->direct, NULL));
        CHECK_OK(sb_direct_update(w->direct, &w->matrix, NULL));
    }
    return w->direct;
}

static sb_pcg_workspace *world_workspace(world *w)
{
    if (!w->workspace.memory)
        CHECK_OK(sb_pcg_workspace_create(WORLD_NODES, &w->allocator, &w->workspace, NULL));
    return &w->workspace;
}

static sb_embedding_def *world_embedding_def(world *w)
{
    w->embedding_def = sb_default_embedding_def();
    w->embedding_def.mesh = world_mesh(w);
    w->embedding_def.surface = world_surface(w);
    w->embedding_def.allocator = w->allocator;
    return &w->embedding_def;
}

static sb_embedding *world_embedding(world *w)
{
    if (!w->embedding)
        CHECK_OK(sb_embedding_create(world_embedding_def(w), &w->embedding, NULL));
    return w->embedding;
}

static sb_embedding *world_following(world *w)
{
    CHECK_OK(sb_embedding_follow(world_embedding(w), world_idle(w), NULL));
    return w->embedding;
}

static sb_surface *world_shape(world *w)
{
    if (!w->shape)
        CHECK_OK(sb_surface_create(world_surface(w), &w->allocator, &w->shape, NULL));
    return w->shape;
}

static sb_surface_hit *world_hit(world *w)
{
    sb_surface_closest(world_shape(w), sb_v3(REAL(0.05), REAL(0.02), REAL(0.02)), 1, &w->hit);
    return &w->hit;
}

static sb_shape *world_solid(world *w)
{
    w->solid.surface = world_shape(w);
    w->solid.max_slope = 1;
    return &w->solid;
}

static sb_grid_def *world_grid_def(world *w)
{
    w->grid_def = sb_default_grid_def();
    w->grid_def.outer = *world_solid(w);
    w->grid_def.cells = 2;
    w->grid_def.level = 1;
    w->grid_def.allocator = w->allocator;
    return &w->grid_def;
}

static sb_grid *world_grid(world *w)
{
    if (!w->grid.mesh.nodes)
        CHECK_OK(sb_grid_create(world_grid_def(w), &w->grid, NULL));
    return &w->grid;
}

static sb_body *world_grid_body(world *w)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = &world_grid(w)->body_mesh;
    def.domain = &w->grid.domain;
    def.material = w->material;
    def.allocator = w->allocator;
    if (!w->grid_body)
        CHECK_OK(sb_body_create(&def, &w->grid_body, NULL));
    return w->grid_body;
}

static sb_network *world_guesser(world *w)
{
    const sb_grid *grid = world_grid(w);
    const sb_real reals[5] = {grid->cell_size.x, grid->cell_size.y, grid->cell_size.z, 1,
                              sb_material_poisson(&w->material)};
    unsigned long long random = 1;
    network_file file;
    if (w->guesser)
        return w->guesser;
    file = network_begin(grid->counts[0] + 1, grid->counts[1] + 1, grid->counts[2] + 1, SB_NETWORK_CHANNELS);
    for (int k = 0; k < 5; k++)
        file.reals[k] = (float)reals[k];
    network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, 3, SB_ACTIVATION_NONE, 0.1, &random);
    network_end(&file);
    CHECK_OK(sb_network_load_memory(file.bytes, file.size, world_network_def(w), &w->guesser, NULL));
    network_file_free(&file);
    return w->guesser;
}

static sb_network_input *world_network_input(world *w)
{
    w->network_input = sb_default_network_input();
    w->network_input.nodes = w->ints;
    w->network_input.displacements = w->vectors;
    w->network_input.count = 1;
    w->network_input.policy = SB_NETWORK_KEEP;
    return &w->network_input;
}

static sb_mixture_def *world_mixture_def(world *w)
{
    w->mixture_def = sb_default_mixture_def();
    w->mixture_def.mesh = world_mesh(w);
    w->mixture_def.shapes = world_solid(w);
    w->mixture_def.shape_count = 1;
    w->mixture_def.level = 2;
    w->mixture_def.allocator = w->allocator;
    return &w->mixture_def;
}

static sb_mixture *world_mixture(world *w)
{
    if (!w->mixture.elements)
        CHECK_OK(sb_mixture_create(world_mixture_def(w), &w->mixture, NULL));
    return &w->mixture;
}

static sb_particles_def *world_particles_def(world *w)
{
    w->particles_def = sb_default_particles_def();
    w->particles_def.outer = *world_solid(w);
    w->particles_def.cells = 3;
    w->particles_def.allocator = w->allocator;
    return &w->particles_def;
}

static sb_particles *world_particles(world *w)
{
    if (!w->particles.mesh.nodes)
        CHECK_OK(sb_particles_create(world_particles_def(w), &w->particles, NULL));
    return &w->particles;
}

static sb_body *world_cloud_body(world *w)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = &world_particles(w)->mesh;
    def.domain = &w->particles.domain;
    def.material = w->material;
    def.allocator = w->allocator;
    if (!w->cloud_body)
        CHECK_OK(sb_body_create(&def, &w->cloud_body, NULL));
    return w->cloud_body;
}

static sb_grid_rows *world_rows(world *w)
{
    if (!w->rows.memory)
        CHECK_OK(sb_grid_map_surface(world_grid(w), world_surface(w), NULL, 0, &w->allocator, &w->rows, NULL));
    return &w->rows;
}

static sb_stuff_def *world_stuff_def(world *w)
{
    w->stuff_def = sb_default_stuff_def();
    w->stuff_def.shapes = world_solid(w);
    w->stuff_def.shape_count = 1;
    w->stuff_def.cell = REAL(0.01);
    w->stuff_def.allocator = w->allocator;
    w->stuff_def.max_elements = 100000;
    return &w->stuff_def;
}

static sb_field *world_fields(world *w)
{
    w->fields[0].name = "stress";
    w->fields[0].location = SB_FIELD_NODES;
    w->fields[0].components = 1;
    w->fields[0].values = w->reals;
    return w->fields;
}

static sb_test_point *world_tests(world *w)
{
    for (int i = 0; i < 6; i++) {
        sb_real stretch = REAL(1.1) + REAL(0.1) * REAL(i);
        w->tests[i].kind = SB_TEST_UNIAXIAL;
        w->tests[i].measure = SB_STRESS_NOMINAL;
        w->tests[i].strain = stretch;
        w->tests[i].stress = 1000 * (stretch - 1 / (stretch * stretch));
    }
    return w->tests;
}

static sb_real *world_decay(world *w, int count)
{
    for (int i = 0; i < count; i++)
        w->reals[i] = REAL(0.5) + REAL(0.5) * sb_exp(REAL(-0.01) * REAL(i));
    return w->reals;
}

#define WORLD_DEFAULT(type, field, make)                                                                               \
    static type *world_##field(world *w)                                                                               \
    {                                                                                                                  \
        w->field = make;                                                                                               \
        return &w->field;                                                                                              \
    }
WORLD_DEFAULT(sb_load_options, load_options, sb_default_load_options())
WORLD_DEFAULT(sb_fit_options, fit_options, sb_default_fit_options())
WORLD_DEFAULT(sb_modes_options, modes_options, sb_default_modes_options())
WORLD_DEFAULT(sb_static_options, static_options, sb_default_static_options())
WORLD_DEFAULT(sb_tear_options, tear_options, sb_default_tear_options())
WORLD_DEFAULT(sb_pcg_options, pcg_options, sb_default_pcg_options())
WORLD_DEFAULT(sb_surface_repair_def, repair_def, sb_default_surface_repair())
WORLD_DEFAULT(ndl_rod_static_options, rod_options, ndl_default_rod_static_options())
WORLD_DEFAULT(ndl_plan_def, plan_def, ndl_default_plan_def(10, REAL(0.15)))
WORLD_DEFAULT(ndl_steer_def, steer_def, ndl_default_steer_def(10, REAL(0.15)))

/* A label image of two by two by two voxels, which stays the world's. */
static sb_image *world_labelled(world *w)
{
    memset(&w->labelled, 0, sizeof w->labelled);
    w->labelled.counts[0] = w->labelled.counts[1] = w->labelled.counts[2] = 2;
    w->labelled.spacing = sb_v3(1, 1, 1);
    w->labelled.direction = sb_m3_identity();
    w->labelled.labels = w->voxels;
    w->voxels[0] = w->voxels[1] = 1;
    return &w->labelled;
}

static sb_label_def *world_label_def(world *w)
{
    w->label_def = sb_default_label_def();
    w->label_def.image = world_labelled(w);
    return &w->label_def;
}

static sb_image world_no_image;
static const char world_nrrd[] = "NRRD0004\ntype: int\ndimension: 3\nsizes: 2 1 1\nencoding: ascii\n\n1 2\n";

/* ---- files and images ---- */

static const char *world_image_file(world *w)
{
    CHECK_OK(sb_file_save(WORLD_FILE, world_nrrd, sizeof world_nrrd - 1, NULL));
    w->has_file = 1;
    return WORLD_FILE;
}

static const char *world_vtk(world *w)
{
    CHECK_OK(sb_mesh_save_vtk(WORLD_FILE, world_mesh(w), NULL, 0, NULL));
    w->has_file = 1;
    return WORLD_FILE;
}
static const char *world_ply(world *w)
{
    CHECK_OK(sb_mesh_save_ply(WORLD_FILE, world_surface(w), NULL));
    w->has_file = 1;
    return WORLD_FILE;
}
static const char *world_file(world *w)
{
    w->has_file = 1;
    return WORLD_FILE;
}
static const char *world_weights_file(world *w)
{
    FILE *file = fopen(WORLD_FILE, "wb");
    CHECK(file && fwrite(world_weights, sizeof world_weights, 1, file) == 1);
    if (file)
        fclose(file);
    w->has_file = 1;
    return WORLD_FILE;
}
static const char *world_state_file(world *w)
{
    CHECK_OK(sb_body_state_save_file(world_body(w), WORLD_FILE, NULL));
    w->has_file = 1;
    return WORLD_FILE;
}
static const char *world_recording_file(world *w)
{
    CHECK_OK(sb_recording_save_file(world_ended(w), WORLD_FILE, NULL));
    w->has_file = 1;
    return WORLD_FILE;
}

static sb_output *world_output(world *w)
{
    CHECK_OK(sb_output_open(&w->output, WORLD_FILE, NULL));
    w->has_file = 1;
    return &w->output;
}

static void *world_room(world *w, size_t bytes)
{
    free(w->image);
    w->image = (unsigned char *)malloc(bytes + !bytes);
    if (w->image)
        memset(w->image, 0x5A, bytes);
    w->image_bytes = bytes;
    return w->image;
}
static const char *world_text(world *w)
{
    (void)w;
    return "# vtk DataFile Version 3.0\ntet\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n0 0 0 1 0 0 0 1 0 0 0 "
           "1\n"
           "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n";
}

/* Saved states of the world's things, in w->image. */
#define WORLD_IMAGE_OF(name, size, save)                                                                               \
    static void *world_##name##_image(world *w)                                                                        \
    {                                                                                                                  \
        world_room(w, size);                                                                                           \
        CHECK_OK(save);                                                                                                \
        return w->image;                                                                                               \
    }
WORLD_IMAGE_OF(body, sb_body_state_size(world_body(w)), sb_body_state_save(w->body, w->image, w->image_bytes))
WORLD_IMAGE_OF(recording, sb_recording_get_info(world_ended(w)).bytes,
               sb_recording_save(w->recording, w->image, w->image_bytes))
WORLD_IMAGE_OF(preconditioner, sb_preconditioner_saved_size(world_preconditioner(w)),
               sb_preconditioner_save(w->preconditioner, w->image, w->image_bytes))

/* ---- needle ---- */

/* Of tets, held below; linear systems only. */
static sb_body *world_make_tissue(world *w)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    def.mesh = world_mesh(w);
    def.material = sb_material_corotated(50000, REAL(0.4), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.max_newton = 1;
    def.slack = REAL(0.5);
    def.allocator = w->allocator;
    CHECK_OK(sb_body_create(&def, &body, NULL));
    if (body)
        scene_fix_plane(body, def.mesh, 2, 0, SB_XYZ);
    return body;
}

static sb_body *world_pierced(world *w)
{
    if (!w->pierced)
        w->pierced = world_make_tissue(w);
    return w->pierced;
}

static ndl_needle_def *world_needle_def(world *w)
{
    w->needle_def = ndl_default_needle_def();
    w->needle_def.body = world_pierced(w);
    w->needle_def.follow = NDL_REMESH; /* for the calls about what follows */
    w->needle_def.base = sb_v3(REAL(0.0213), REAL(0.0191), REAL(0.091));
    w->needle_def.direction = sb_v3(0, 0, -1);
    w->needle_def.director = sb_v3(1, 0, 0);
    w->needle_def.length = REAL(0.05);
    w->needle_def.capacity = 32;
    w->needle_def.allocator = w->allocator;
    return &w->needle_def;
}

/* A centimetre deep. */
static ndl_needle *world_needle(world *w)
{
    ndl_command command;
    if (w->needle)
        return w->needle;
    CHECK_OK(ndl_needle_create(world_needle_def(w), &w->needle, NULL));
    memset(&command, 0, sizeof command);
    command.insertion = REAL(0.1);
    for (int i = 0; i < 5 && w->needle; i++)
        CHECK_OK(ndl_step(w->pierced, &w->needle, 1, REAL(0.02), &command, NULL, NULL));
    return w->needle;
}

static ndl_needle **world_needles(world *w)
{
    w->needles[0] = world_needle(w);
    return w->needles;
}

static ndl_command *world_command(world *w)
{
    w->command.insertion = REAL(0.01);
    return &w->command;
}

static ndl_remesh_def *world_remesh_def(world *w)
{
    if (!w->remeshed)
        w->remeshed = world_make_tissue(w);
    w->remesh_def = ndl_default_remesh_def();
    w->remesh_def.body = w->remeshed;
    w->remesh_def.allocator = w->allocator;
    return &w->remesh_def;
}

/* The remesher's needle comes from above. */
static const ndl_surface_hit *world_entry(world *w)
{
    ndl_remesh_hit(w->remesh, sb_v3(REAL(0.0213), REAL(0.0191), 1), sb_v3(REAL(0.0213), REAL(0.0191), 0), &w->entry);
    return &w->entry;
}

/* Needle 0 is in the tissue. */
static ndl_remesh *world_remesh(world *w)
{
    if (w->remesh)
        return w->remesh;
    CHECK_OK(ndl_remesh_create(world_remesh_def(w), &w->remesh, NULL));
    CHECK_OK(ndl_remesh_puncture(w->remesh, 0, world_entry(w), NULL, NULL));
    CHECK_OK(ndl_remesh_penetrate(w->remesh, 0, sb_v3(REAL(0.0213), REAL(0.0191), REAL(0.032)), NULL, NULL));
    return w->remesh;
}
static ndl_remesh *world_remesh_outside(world *w)
{
    if (!w->remesh)
        CHECK_OK(ndl_remesh_create(world_remesh_def(w), &w->remesh, NULL));
    return w->remesh;
}

static ndl_rod_def *world_rod_def(world *w)
{
    for (int i = 0; i < 5; i++)
        w->vectors[i] = sb_v3(REAL(0.01) * REAL(i), 0, 0);
    w->rod_def = ndl_default_rod_def();
    w->rod_def.nodes = w->vectors;
    w->rod_def.node_count = 5;
    w->rod_def.capacity = 8;
    w->rod_def.gravity = sb_v3(0, 0, REAL(-9.81));
    w->rod_def.allocator = w->allocator;
    return &w->rod_def;
}

static ndl_rod *world_rod(world *w)
{
    if (!w->rod) {
        CHECK_OK(ndl_rod_create(world_rod_def(w), &w->rod, NULL));
        CHECK_OK(ndl_rod_step(w->rod, REAL(0.01), NULL));
    }
    return w->rod;
}

static ndl_bevel *world_bevel(world *w)
{
    w->bevel.law = NDL_BEVEL_CURVATURE;
    w->bevel.curvature = 10;
    return &w->bevel;
}

static ndl_obstacle *world_obstacle(world *w)
{
    w->obstacle.kind = NDL_OBSTACLE_CAPSULE;
    w->obstacle.a = sb_v3(REAL(0.1), 0, 0), w->obstacle.b = sb_v3(REAL(0.1), 0, REAL(0.1));
    w->obstacle.radius = REAL(0.01);
    return &w->obstacle;
}

static ndl_plan *world_plan(world *w)
{
    CHECK_OK(ndl_plan_make(world_plan_def(w), &w->pose, sb_v3(REAL(0.01), REAL(0.01), REAL(0.08)), &w->plan, NULL));
    return &w->plan;
}

static ndl_steer *world_steer(world *w)
{
    if (!w->has_steer)
        CHECK_OK(ndl_steer_begin(world_steer_def(w), &w->steer, NULL));
    w->has_steer = 1;
    return &w->steer;
}

static ndl_push_def *world_push_def(world *w)
{
    w->push_def = ndl_default_push_def();
    w->push_def.compliance = sb_m3_scale(REAL(0.001), sb_m3_identity());
    w->push_def.line_direction = sb_v3(0, 0, 1);
    w->push_def.max_force = 5;
    return &w->push_def;
}

static int world_model(void *user, sb_vec3 point, int place, sb_mat3 *compliance)
{
    (void)user, (void)point, (void)place;
    *compliance = sb_m3_scale(REAL(0.001), sb_m3_identity());
    return 1;
}

static ndl_guide_def *world_guide_def(world *w)
{
    w->place.direction = sb_v3(1, 0, 0);
    w->place.cone = REAL(0.5);
    w->place.max_force = w->place.weight = 1;
    w->guide_def = ndl_default_guide_def(sb_v3(0, 0, REAL(-0.08)), sb_v3(0, 0, 0), sb_v3(0, 0, -1));
    w->guide_def.obstacles = world_obstacle(w);
    w->guide_def.obstacle_count = 1;
    w->guide_def.places = &w->place;
    w->guide_def.place_count = 1;
    w->guide_def.model = world_model;
    w->guide_def.samples = w->guide_def.climbs = 3;
    return &w->guide_def;
}

static ndl_push *world_push(world *w)
{
    if (!w->has_push)
        CHECK_OK(ndl_push_begin(world_push_def(w), &w->push, NULL));
    w->has_push = 1;
    return &w->push;
}

WORLD_IMAGE_OF(rod, ndl_rod_state_size(world_rod(w)), ndl_rod_save(w->rod, w->image, w->image_bytes, NULL))

/* ---- register ---- */

/* Points spread over an ellipsoid. */
static const sb_vec3 *world_points(world *w)
{
    unsigned long long seed = 11;
    for (int i = 0; i < WORLD_CLOUD; i++) {
        sb_vec3 d = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                          REAL(check_random_in(&seed, -1, 1)));
        d = sb_v3_scale(1 / sb_v3_norm(d), d);
        w->vectors[i] = sb_v3(REAL(0.03) * d.x, REAL(0.02) * d.y, REAL(0.04) * d.z);
    }
    return w->vectors;
}

static sb_body *world_fibrous(world *w)
{
    CHECK_OK(sb_body_set_fibres(world_plain(w), world_points(w), NULL));
    return world_plain(w);
}

static reg_cloud *world_cloud(world *w)
{
    if (!w->cloud.points)
        CHECK_OK(reg_cloud_from_points(&w->cloud, world_points(w), NULL, WORLD_CLOUD, &w->allocator, NULL));
    return &w->cloud;
}

static reg_icp_shape *world_icp_shape(world *w)
{
    memset(&w->icp_shape, 0, sizeof w->icp_shape);
    w->icp_shape.points = world_surface(w)->nodes;
    w->icp_shape.count = w->surface.node_count;
    w->icp_shape.surface = world_shape(w);
    return &w->icp_shape;
}

static reg_icp_options *world_icp_options(world *w)
{
    w->icp_options = reg_default_icp_options();
    w->icp_options.clock = world_clock;
    w->icp_options.allocator = w->allocator;
    return &w->icp_options;
}

static reg_cpd_options *world_cpd_options(world *w)
{
    w->cpd_options = reg_default_cpd_options();
    w->cpd_options.max_iterations = 3;
    w->cpd_options.clock = world_clock;
    w->cpd_options.allocator = w->allocator;
    return &w->cpd_options;
}

static reg_cpd *world_cpd(world *w)
{
    if (!w->cpd)
        CHECK_OK(
            reg_cpd_fit(world_points(w), WORLD_CLOUD, w->vectors, WORLD_CLOUD, world_cpd_options(w), &w->cpd, NULL));
    return w->cpd;
}

static reg_field_def *world_field_def(world *w)
{
    w->field_def = reg_default_field_def();
    w->field_def.surface = world_surface(w);
    w->field_def.allocator = w->allocator;
    return &w->field_def;
}

static reg_field *world_field(world *w)
{
    if (!w->field)
        CHECK_OK(reg_field_create(world_field_def(w), &w->field, NULL));
    return w->field;
}

static reg_kdtree *world_tree(world *w)
{
    if (!w->tree)
        CHECK_OK(reg_kdtree_create(world_points(w), WORLD_CLOUD, &w->allocator, &w->tree, NULL));
    return w->tree;
}

static reg_match_def *world_match_def(world *w)
{
    w->match_def = reg_default_match_def();
    w->match_def.body = world_plain(w);
    w->match_def.target = world_surface(w);
    w->match_def.landmarks = w->surface.nodes;
    w->match_def.landmark_targets = w->surface.nodes;
    w->match_def.landmark_count = 2;
    w->match_def.clock = world_clock;
    w->match_def.allocator = w->allocator;
    return &w->match_def;
}

static reg_match *world_match(world *w)
{
    if (!w->match)
        CHECK_OK(reg_match_create(world_match_def(w), &w->match, NULL));
    return w->match;
}

static reg_nicp_def *world_nicp_def(world *w)
{
    w->nicp_def = reg_default_nicp_def();
    w->nicp_def.body = world_plain(w);
    w->nicp_def.target = world_surface(w);
    w->nicp_def.landmarks = w->surface.nodes;
    w->nicp_def.landmark_targets = w->surface.nodes;
    w->nicp_def.landmark_count = 2;
    w->nicp_def.clock = world_clock;
    w->nicp_def.allocator = w->allocator;
    return &w->nicp_def;
}

static reg_nicp *world_nicp(world *w)
{
    if (!w->nicp)
        CHECK_OK(reg_nicp_create(world_nicp_def(w), &w->nicp, NULL));
    return w->nicp;
}

static reg_loads_def *world_loads_def(world *w)
{
    w->loads_def = reg_default_loads_def();
    w->loads_def.match = world_match(w);
    w->loads_def.samples = 30;
    w->loads_def.rounds = 1;
    w->loads_def.allocator = w->allocator;
    return &w->loads_def;
}

static reg_model_def *world_organ_model_def(world *w)
{
    w->organ_model_def = reg_default_model_def();
    w->organ_model_def.mesh = world_mesh(w);
    w->organ_model_def.allocator = w->allocator;
    return &w->organ_model_def;
}

static reg_model *world_organ_model(world *w)
{
    if (!w->organ_model)
        CHECK_OK(reg_model_create(world_organ_model_def(w), &w->organ_model, NULL));
    return w->organ_model;
}

static reg_infer_def *world_infer_def(world *w)
{
    w->infer_def = reg_default_infer_def();
    w->infer_def.model = world_organ_model(w);
    w->infer_def.target.surface = world_surface(w);
    w->infer_def.target.has_camera = 1;
    w->infer_def.target.camera = sb_v3(0, 0, 1);
    w->infer_def.samples = 30;
    w->infer_def.rounds = 1;
    w->infer_def.clock = world_clock;
    return &w->infer_def;
}

static reg_infer *world_infer(world *w)
{
    if (!w->infer)
        CHECK_OK(reg_infer_run(world_infer_def(w), &w->infer, NULL));
    return w->infer;
}

static reg_landmark *world_landmarks(world *w)
{
    for (int k = 0; k < 2; k++) {
        w->landmarks[k].model = w->landmarks[k].seen = world_mesh(w)->nodes[k];
        w->landmarks[k].sd = REAL(0.01);
    }
    return w->landmarks;
}

static reg_curve *world_curves(world *w)
{
    w->curve.model = w->curve.seen = world_mesh(w)->nodes;
    w->curve.model_count = w->curve.seen_count = 2;
    w->curve.sd = REAL(0.01);
    return &w->curve;
}

static reg_track_def *world_track_def(world *w)
{
    w->track_def = reg_default_track_def();
    w->track_def.model = world_organ_model(w);
    w->track_def.start = world_infer(w);
    w->track_def.modes = 2;
    w->track_def.patches = 30;
    w->track_def.landmarks = world_landmarks(w);
    w->track_def.landmark_count = 2;
    w->track_def.curves = world_curves(w);
    w->track_def.curve_count = 1;
    w->track_def.clock = world_clock;
    return &w->track_def;
}

static reg_track *world_track(world *w)
{
    if (!w->track)
        CHECK_OK(reg_track_create(world_track_def(w), &w->track, NULL));
    return w->track;
}

WORLD_IMAGE_OF(track, reg_track_save_size(world_track(w)), reg_track_save(w->track, w->image, w->image_bytes))

static reg_points *world_points_seen(world *w)
{
    const sb_mesh *mesh = world_mesh(w);
    memset(&w->points_seen, 0, sizeof w->points_seen);
    w->points_seen.points = mesh->nodes;
    w->points_seen.count = 3;
    w->points_seen.has_camera = 1;
    w->points_seen.camera = sb_v3(0, 0, 1);
    return &w->points_seen;
}

/* ---- all of it ---- */

static unsigned long long world_mix(unsigned long long hash, const void *data, size_t bytes)
{
    return hash * 31 + scene_hash(data, bytes);
}

static unsigned long long world_step_body(sb_body *body, unsigned long long hash)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    sb_result result = sb_body_step(body, REAL(0.01), NULL);
    hash = world_mix(hash, &result, sizeof result);
    CHECK(scene_all_finite(sb_body_positions(body), sb_body_node_count(body)));
    return world_mix(world_mix(hash, sb_body_positions(body), bytes), sb_body_velocities(body), bytes);
}

static unsigned long long world_step_needles(world *w, unsigned long long hash)
{
    ndl_step_info info;
    sb_result result;
    if (!w->needle)
        return world_step_body(w->pierced, hash);
    result = ndl_step(w->pierced, &w->needle, 1, REAL(0.01), NULL, &info, NULL);
    hash = world_mix(hash, &result, sizeof result);
    CHECK(scene_all_finite(sb_body_positions(w->pierced), sb_body_node_count(w->pierced)));
    return world_mix(hash, sb_body_positions(w->pierced), (size_t)sb_body_node_count(w->pierced) * sizeof(sb_vec3));
}

/* Lets everything there is go on, and gives the bits of where it comes to. */
static unsigned long long world_go_on(world *w)
{
    unsigned long long hash = 1;
    sb_real z[3 * WORLD_NODES];
    if (w->body)
        hash = world_step_body(w->body, hash);
    if (w->match && !w->nicp)
        reg_match_step(w->match, NULL);
    if (w->nicp)
        reg_nicp_step(w->nicp, NULL);
    if (w->plain)
        hash = world_step_body(w->plain, hash);
    if (w->heat) {
        sb_result result = sb_heat_step(w->heat, REAL(0.5), NULL, NULL);
        uint64_t state = sb_body_state_hash(w->warm);
        hash = world_mix(world_mix(hash, &result, sizeof result), &state, sizeof state);
    }
    if (w->pierced)
        hash = world_step_needles(w, hash);
    if (w->rod) {
        sb_result result = ndl_rod_step(w->rod, REAL(0.01), NULL);
        hash = world_mix(hash, &result, sizeof result);
        hash = world_mix(hash, ndl_rod_positions(w->rod), (size_t)ndl_rod_node_count(w->rod) * sizeof(sb_vec3));
    }
    if (w->remesh) {
        hash = world_mix(hash, sb_body_rest_positions(w->remeshed),
                         (size_t)sb_body_node_count(w->remeshed) * sizeof(sb_vec3));
        CHECK_OK(ndl_remesh_check(w->remesh, NULL));
    }
    if (w->preconditioner && w->matrix.row_count == WORLD_NODES) {
        sb_preconditioner_apply(w->preconditioner, w->reals, z);
        hash = world_mix(hash, z, sizeof z);
    }
    if (w->direct && w->matrix.row_count == WORLD_NODES) {
        sb_result result = sb_direct_solve(w->direct, w->reals, z, 1);
        hash = world_mix(world_mix(hash, &result, sizeof result), z, sizeof z);
    }
    if (w->embedding) {
        sb_vec3 points[WORLD_NODES];
        CHECK_OK(sb_embedding_update(w->embedding, w->mesh.nodes, points, NULL, NULL));
        hash = world_mix(hash, points, 26 * sizeof(sb_vec3));
    }
    if (w->shape) {
        sb_real distance = sb_surface_signed_distance(w->shape, sb_v3(REAL(0.07), REAL(0.01), REAL(0.02)), NULL);
        hash = world_mix(hash, &distance, sizeof distance);
    }
    if (w->field) {
        sb_real phi = 0;
        reg_field_at(w->field, sb_v3(REAL(0.07), REAL(0.01), REAL(0.02)), -1, &phi, NULL);
        hash = world_mix(hash, &phi, sizeof phi);
    }
    return hash;
}

static void world_free(world *w)
{
    reg_track_destroy(w->track);
    reg_infer_destroy(w->infer);
    reg_model_destroy(w->organ_model);
    reg_nicp_destroy(w->nicp);
    reg_match_destroy(w->match);
    reg_kdtree_destroy(w->tree);
    reg_field_destroy(w->field);
    reg_cpd_destroy(w->cpd);
    reg_cloud_free(&w->cloud);
    ndl_rod_destroy(w->rod);
    ndl_remesh_destroy(w->remesh);
    ndl_needle_destroy(w->needle);
    sb_body_destroy(w->pierced);
    sb_body_destroy(w->remeshed);
    sb_grid_rows_free(&w->rows);
    sb_grid_free(&w->grid);
    sb_mixture_free(&w->mixture);
    sb_body_destroy(w->cloud_body);
    sb_body_destroy(w->grid_body);
    sb_particles_free(&w->particles);
    sb_surface_destroy(w->shape);
    sb_embedding_destroy(w->embedding);
    sb_pcg_workspace_free(&w->workspace);
    sb_preconditioner_free(w->preconditioner);
    sb_direct_free(w->direct);
    sb_matrix_free(&w->matrix);
    sb_domain_free(&w->domain);
    sb_recording_destroy(w->recording);
    sb_recording_destroy(w->moved);
    sb_body_destroy(w->mover);
    sb_haptic_destroy(w->haptic);
    sb_contact_destroy(w->contact);
    sb_network_destroy(w->network);
    sb_network_destroy(w->guesser);
    sb_heat_destroy(w->heat);
    sb_body_destroy(w->warm);
    sb_cut_surface_destroy(w->cut_surface);
    sb_cut_fine_destroy(w->cut_fine);
    sb_cut_destroy(w->cut);
    sb_body_destroy(w->parted);
    sb_body_destroy(w->touched);
    sb_body_destroy(w->plain);
    sb_body_destroy(w->still);
    sb_body_destroy(w->hung);
    sb_body_destroy(w->live);
    sb_body_destroy(w->idle);
    sb_body_destroy(w->body);
    sb_mesh_free(&w->spoilt);
    sb_mesh_free(&w->surface);
    sb_mesh_free(&w->hexes);
    sb_mesh_free(&w->mesh);
    free(w->image);
    if (w->output.file)
        sb_output_discard(&w->output);
    if (w->has_file)
        remove(WORLD_FILE);
    memset(w, 0, sizeof *w);
}

#endif /* HOSTILE_WORLD_H */
