/* Tests of saved states and recordings of bodies with everything there is: each element and integrator, two parts that
 * are tied, constraints, pressure, springs, a mapping, fibres and Prony terms, coming and going. */
#include "softbody.h"

#include "check.h"
#include "image.h"
#include "scene.h"
#include "wedge.h"

/* ---- the scene ---- */

typedef struct variety {
    const char *name;
    sb_element_type type; /* SB_CUSTOM: wedges */
    sb_integration integration;
    sb_integrator integrator;
    sb_material_model model; /* those without fibres and Prony terms go without */
    sb_mass_kind mass;
} variety;

static const variety kinds[] = {
    {"tet4 batched", SB_TET4, SB_INTEGRATION_AUTO, SB_EULER, SB_COROTATED, SB_MASS_LUMPED},
    {"tet4 generalised alpha", SB_TET4, SB_INTEGRATION_AUTO, SB_GENERALISED_ALPHA, SB_NEO_HOOKEAN, SB_MASS_CONSISTENT},
    {"tet4 central", SB_TET4, SB_INTEGRATION_AUTO, SB_CENTRAL_DIFFERENCE, SB_NEO_HOOKEAN, SB_MASS_LUMPED},
    {"tet10", SB_TET10, SB_INTEGRATION_AUTO, SB_NEWMARK, SB_STABLE_NEO_HOOKEAN, SB_MASS_LUMPED},
    {"hex8", SB_HEX8, SB_INTEGRATION_AUTO, SB_EULER, SB_NEO_HOOKEAN, SB_MASS_LUMPED},
    {"hex8 central", SB_HEX8, SB_INTEGRATION_AUTO, SB_CENTRAL_DIFFERENCE, SB_COROTATED, SB_MASS_LUMPED},
    {"hex8 B-bar", SB_HEX8, SB_INTEGRATION_BBAR, SB_EULER, SB_NEO_HOOKEAN, SB_MASS_LUMPED},
    {"hex8 B-bar corotated", SB_HEX8, SB_INTEGRATION_BBAR, SB_GENERALISED_ALPHA, SB_COROTATED, SB_MASS_LUMPED},
    {"hex20", SB_HEX20, SB_INTEGRATION_AUTO, SB_EULER, SB_COROTATED, SB_MASS_LUMPED},
    {"hex20 Newmark", SB_HEX20, SB_INTEGRATION_AUTO, SB_NEWMARK, SB_NEO_HOOKEAN, SB_MASS_CONSISTENT},
    {"hex27", SB_HEX27, SB_INTEGRATION_AUTO, SB_GENERALISED_ALPHA, SB_NEO_HOOKEAN, SB_MASS_LUMPED},
    {"wedge", SB_CUSTOM, SB_INTEGRATION_AUTO, SB_EULER, SB_NEO_HOOKEAN, SB_MASS_LUMPED},
    {"wedge central", SB_CUSTOM, SB_INTEGRATION_AUTO, SB_CENTRAL_DIFFERENCE, SB_COROTATED, SB_MASS_LUMPED},
};
enum { KINDS = sizeof kinds / sizeof kinds[0], MOST_NODES = 120, MOST_FACES = 24, MOST_SLAVES = 24 };

/* A mesh of two boxes one behind the other, and what the scene needs to know of it. */
typedef struct stage {
    const variety *kind;
    sb_element_table table;
    sb_mesh mesh;
    int split;                                       /* first node of the second box */
    int corners, faces[MOST_FACES * 4], face_count;  /* of the first box, to which the second is tied */
    int top_corners, top[MOST_FACES * 4], top_count; /* of the second box */
    int slaves[MOST_SLAVES], slave_count;
    int low, high, middle; /* free nodes of the second box */
} stage;

/* Ids of a body's loads and constraints; a copy of them goes with a saved state. */
typedef struct numbers {
    int pressure, springs, mapping, constraint, tie, tied;
} numbers;

static sb_real coordinate(const sb_mesh *mesh, int node, int axis) { return scene_component(mesh->nodes[node], axis); }

/* Local nodes of a face, and its type. */
static sb_element_type face_of(const sb_mesh *mesh, int face, int local[SB_MAX_FACE_NODES])
{
    sb_element_type type = SB_NO_ELEMENT;
    if (!mesh->table) {
        sb_element_face(mesh->element_type, face, local, &type);
        return type;
    }
    memcpy(local, mesh->table->faces[face].nodes, sizeof mesh->table->faces[face].nodes);
    return mesh->table->faces[face].type;
}

/* Faces of elements with corners in [from, to) that lie in a plane; their corner count to *corners. */
static int plane_faces(const sb_mesh *mesh, int from, int to, int axis, double value, int *faces, int *corners)
{
    int n = mesh->table ? mesh->table->node_count : sb_element_node_count(mesh->element_type), count = 0;
    int all = mesh->table ? mesh->table->face_count : sb_element_face_count(mesh->element_type);
    *corners = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int f = 0; f < all && count < MOST_FACES; f++) {
            int local[SB_MAX_FACE_NODES], inside = 1;
            sb_element_type type = face_of(mesh, f, local);
            for (int k = 0; k < sb_element_corner_count(type); k++) {
                int node = mesh->elements[e * n + local[k]];
                inside &= node >= from && node < to && fabs((double)coordinate(mesh, node, axis) - value) < 1e-6;
            }
            if (!inside || (*corners && *corners != sb_element_corner_count(type)))
                continue;
            *corners = sb_element_corner_count(type);
            for (int k = 0; k < *corners; k++)
                faces[count * *corners + k] = mesh->elements[e * n + local[k]];
            count++;
        }
    return count;
}

static sb_mesh make_box(const stage *s)
{
    sb_vec3 size = sb_v3(REAL(0.05), REAL(0.05), REAL(0.05));
    return s->kind->type == SB_CUSTOM ? wedge_box(&s->table, 1, 1, 1, size, 0)
                                      : scene_box(s->kind->type, 1, 1, 1, size, 0);
}

static void stage_begin(stage *s, const variety *k)
{
    sb_mesh second;
    memset(s, 0, sizeof *s);
    s->kind = k;
    s->table = wedge_table();
    s->mesh = make_box(s);
    second = make_box(s);
    s->split = s->mesh.node_count;
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += REAL(0.05);
    CHECK_OK(sb_mesh_append(&s->mesh, &second, NULL));
    sb_mesh_free(&second);
    s->mesh.regions = (int *)calloc((size_t)s->mesh.element_count, sizeof(int));
    for (int e = 0; e < s->mesh.element_count; e++)
        s->mesh.regions[e] = 2 * e >= s->mesh.element_count;
    s->face_count = plane_faces(&s->mesh, 0, s->split, 0, 0.05, s->faces, &s->corners);
    s->top_count = plane_faces(&s->mesh, s->split, s->mesh.node_count, 2, 0.05, s->top, &s->top_corners);
    s->low = s->high = s->middle = -1;
    for (int i = s->split; i < s->mesh.node_count; i++) {
        if (coordinate(&s->mesh, i, 0) < REAL(0.051))
            s->slaves[s->slave_count++] = i;
        else if (s->low < 0)
            s->low = i;
        else if (s->middle < 0)
            s->middle = i;
        else
            s->high = i;
    }
    CHECK(s->face_count > 0 && s->top_count > 0 && s->high >= 0 && s->mesh.node_count <= MOST_NODES);
}

static void stage_end(stage *s) { sb_mesh_free(&s->mesh); }

static int is_viscous(const variety *k) { return k->model != SB_COROTATED; }

/* The kind's material; terms: Prony terms, as far as the kind has any. */
static sb_material make_material(const variety *k, double young, int terms)
{
    static const double g[3] = {0.3, 0.2, 0.1}, tau[3] = {0.02, 0.2, 1};
    sb_real shares[3], times[3];
    sb_material m = sb_material_corotated(REAL(young), REAL(0.4), REAL(1000));
    m.model = k->model;
    if (!is_viscous(k))
        return m;
    for (int i = 0; i < 3; i++) {
        shares[i] = REAL(g[i]);
        times[i] = REAL(tau[i]);
    }
    return sb_material_with_prony(sb_material_with_fibres(m, REAL(0.3 * young), REAL(1)), shares, times, terms);
}

static sb_material make_bare_material(const variety *k)
{
    sb_material m = make_material(k, 2e4, 0);
    m.fibre_stiffness = m.fibre_exponent = 0;
    return m;
}

static void make_fibres(const stage *s, int turn, sb_vec3 *fibres)
{
    for (int e = 0; e < s->mesh.element_count; e++)
        fibres[e] = sb_v3(REAL(3), REAL(e % 3), REAL(turn));
    fibres[s->mesh.element_count - 1] = sb_v3(0, 0, 0);
}

/* bare: 1: without fibres and Prony terms. */
static sb_body *make_body(const stage *s, int bare, scene_memory *memory, sb_jobs jobs)
{
    sb_vec3 fibres[MOST_NODES];
    sb_region_material second;
    sb_body_def def = sb_default_body_def();
    make_fibres(s, 0, fibres);
    second.region = 1;
    second.material = bare ? make_bare_material(s->kind) : make_material(s->kind, 4e4, 2);
    def.mesh = &s->mesh;
    def.material = bare ? second.material : make_material(s->kind, 2e4, 1);
    def.region_materials = &second;
    def.region_material_count = 1;
    def.fibres = is_viscous(s->kind) && !bare ? fibres : NULL;
    def.integration = s->kind->integration;
    def.integrator = s->kind->integrator;
    def.mass = s->kind->mass;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_mass = REAL(5);
    def.damping_stiffness = s->kind->integrator == SB_CENTRAL_DIFFERENCE ? 0 : REAL(0.002);
    def.max_iterations = 100;
    def.jobs = jobs;
    if (memory)
        def.allocator = scene_allocator(memory);
    return scene_body(&def);
}

static sb_body *make_plain_body(const stage *s)
{
    sb_jobs none;
    memset(&none, 0, sizeof none);
    return make_body(s, 0, NULL, none);
}

/* ---- its acts ---- */

static void add_pressure(sb_body *body, const stage *s, double pressure, numbers *ids)
{
    CHECK_OK(sb_body_add_pressure(body, s->top, s->top_count, s->top_corners, REAL(pressure), &ids->pressure, NULL));
}

static void add_springs(sb_body *body, const stage *s, numbers *ids)
{
    int nodes[2] = {s->low, s->high};
    sb_real stiffness[2] = {REAL(2), REAL(3)};
    sb_vec3 points[2] = {s->mesh.nodes[s->low], s->mesh.nodes[s->high]};
    points[0].z += REAL(0.01);
    points[1].y -= REAL(0.005);
    CHECK_OK(sb_body_add_springs(body, nodes, 2, stiffness, 0, points, &ids->springs, NULL));
}

/* Rows through both boxes: the matrix gets blocks that no element has. */
static void add_mapping(sb_body *body, const stage *s, int count, numbers *ids)
{
    int start[3] = {0, 3, 5}, nodes[5] = {1, s->middle, s->high, 0, s->low};
    sb_real weights[5] = {REAL(0.25), REAL(0.5), REAL(0.25), REAL(-0.5), REAL(1.5)}, stiffness = REAL(4);
    sb_vec3 targets[2] = {{REAL(0.05), REAL(0.03), REAL(0.02)}, {REAL(0.08), REAL(0.01), REAL(0.01)}};
    sb_mapping mapping;
    mapping.row_count = count;
    mapping.row_start = start;
    mapping.nodes = nodes;
    mapping.weights = weights;
    CHECK_OK(sb_body_add_mapping(body, &mapping, &stiffness, 1, targets, &ids->mapping, NULL));
}

static void add_tie(sb_body *body, const stage *s, numbers *ids)
{
    sb_tie_report report;
    if (!CHECK_OK(sb_body_tie_faces(body, s->faces, s->face_count, s->corners, s->slaves, s->slave_count, REAL(0.01),
                                    SB_TIE_ALL, &report, NULL)))
        return;
    ids->tie = report.first_constraint;
    ids->tied = report.constraint_count;
}

static void add_constraint(sb_body *body, const stage *s, numbers *ids)
{
    sb_constraint_term terms[2];
    terms[0].node = s->middle;
    terms[1].node = s->high;
    terms[0].axis = terms[1].axis = 1;
    terms[0].coefficient = 1;
    terms[1].coefficient = REAL(-0.75);
    CHECK_OK(sb_body_add_constraint(body, terms, 2, REAL(0.0005), &ids->constraint, NULL));
}

static void play_loads(sb_body *body, const stage *s, numbers *ids, int frame)
{
    sb_vec3 points[2] = {s->mesh.nodes[s->low], s->mesh.nodes[s->high]};
    sb_real stiffness[2] = {REAL(1) + REAL(frame % 7), REAL(2)};
    points[0].x += REAL(0.0002) * REAL(frame % 9);
    if (frame == 0)
        add_springs(body, s, ids);
    if (frame % 24 == 1)
        add_pressure(body, s, 20, ids);
    if (frame % 24 == 4)
        add_mapping(body, s, frame < 30 ? 1 : 2, ids);
    if (frame % 24 == 6)
        CHECK_OK(sb_body_set_pressure(body, ids->pressure, REAL(30 + frame)));
    if (frame % 5 == 2)
        CHECK_OK(sb_body_move_springs(body, ids->springs, points));
    if (frame % 24 == 8)
        CHECK_OK(sb_body_set_spring_stiffness(body, ids->springs, stiffness, frame < 30));
    if (frame % 24 == 9)
        CHECK_OK(sb_body_set_mapping_targets(body, ids->mapping, points));
    if (frame % 24 == 10)
        CHECK_OK(sb_body_set_mapping_stiffness(body, ids->mapping, stiffness, frame < 30));
    if (frame % 24 == 20)
        CHECK_OK(sb_body_remove_load(body, ids->mapping));
    if (frame % 24 == 22)
        CHECK_OK(sb_body_remove_load(body, ids->pressure));
    if (frame == 60) { /* in another order */
        CHECK_OK(sb_body_remove_load(body, ids->springs));
        add_springs(body, s, ids);
    }
}

static void play_constraints(sb_body *body, const stage *s, numbers *ids, int frame)
{
    if (frame == 0)
        add_tie(body, s, ids);
    if (frame % 30 == 3)
        add_constraint(body, s, ids);
    if (frame % 30 == 12)
        CHECK_OK(sb_body_set_constraint_value(body, ids->constraint, REAL(0.001)));
    if (frame % 30 == 15)
        CHECK_OK(sb_body_remove_constraint(body, ids->constraint, NULL));
    if (frame == 70) {
        CHECK_OK(sb_body_remove_constraints(body, ids->tie, ids->tied, NULL));
        add_tie(body, s, ids);
    }
    if (frame == 80) {
        sb_body_clear_constraints(body);
        add_tie(body, s, ids);
    }
}

static void play_rest(sb_body *body, const stage *s, int frame)
{
    sb_vec3 push = sb_v3(REAL(0.01), 0, REAL(0.01)), fibres[MOST_NODES];
    sb_material softer = make_material(s->kind, 1.5e4, 2), firmer = make_material(s->kind, 3e4, 3);
    make_fibres(s, frame % 4, fibres);
    if (frame == 0)
        scene_fix_plane(body, &s->mesh, 0, 0, SB_XYZ);
    if (frame % 20 == 5)
        CHECK_OK(sb_body_add_forces(body, &s->high, 1, &push, 1));
    if (frame % 20 == 15)
        sb_body_clear_loads(body);
    if (frame == 25)
        CHECK_OK(sb_body_set_region_material(body, 0, &softer, NULL));
    if (frame == 65)
        CHECK_OK(sb_body_set_region_material(body, 1, &firmer, NULL));
    if (frame % 40 == 18 && is_viscous(s->kind))
        CHECK_OK(sb_body_set_fibres(body, fibres, NULL));
    if (frame % 40 == 28 && s->kind->integrator != SB_CENTRAL_DIFFERENCE) {
        sb_static_options options = sb_default_static_options();
        options.instantaneous = frame > 40;
        options.max_newton = 6;
        options.keep_progress = 1;
        sb_body_solve_static(body, &options, NULL); /* may fail, alike each time */
    }
}

static void play(sb_body *body, const stage *s, numbers *ids, int from, int to)
{
    int is_explicit = s->kind->integrator == SB_CENTRAL_DIFFERENCE;
    for (int frame = from; frame < to; frame++) {
        play_loads(body, s, ids, frame);
        play_constraints(body, s, ids, frame);
        play_rest(body, s, frame);
        CHECK_OK(sb_body_step(body, is_explicit ? REAL(0.0005) : frame % 2 ? REAL(0.01) : REAL(0.008), NULL));
    }
}

/* What a user reads of a body beside its state: stresses, forces of loads and constraints. */
static unsigned long long readings_hash(const sb_body *body, const stage *s, const numbers *ids, int constraint)
{
    unsigned long long hash = 0;
    sb_vec3 force = {0, 0, 0}, torque = {0, 0, 0}, forces[2] = {{0, 0, 0}, {0, 0, 0}};
    sb_real multiplier = 0;
    int loads[3];
    loads[0] = ids->pressure;
    loads[1] = ids->springs;
    loads[2] = ids->mapping;
    for (int e = 0; e < s->mesh.element_count; e++)
        for (int p = 0; p < sb_body_point_count(body); p++) {
            sb_mat3 stress;
            if (CHECK_OK(sb_body_stress(body, e, p, &stress)))
                hash = 3 * hash ^ scene_hash(&stress, sizeof stress);
        }
    for (int k = 0; k < 3; k++) {
        sb_body_load_force(body, loads[k], s->mesh.nodes[0], &force, &torque); /* some are not there */
        hash = 3 * hash ^ scene_hash(&force, sizeof force) ^ scene_hash(&torque, sizeof torque);
    }
    CHECK_OK(sb_body_spring_forces(body, ids->springs, forces));
    CHECK_OK(sb_body_constraint_force(body, constraint, &multiplier));
    return hash ^ scene_hash(forces, sizeof forces) ^ scene_hash(&multiplier, sizeof multiplier);
}

static unsigned char *save_state(const sb_body *body, size_t *size)
{
    unsigned char *state;
    *size = sb_body_state_size(body);
    state = (unsigned char *)malloc(*size ? *size : 1);
    CHECK(*size > 0);
    CHECK_OK(sb_body_state_save(body, state, *size));
    return state;
}

/* ---- continuing ---- */

static void check_continues(const char *who, const variety *k, sb_body *body, const stage *s, numbers ids, int from,
                            int to, uint64_t end)
{
    play(body, s, &ids, from, to);
    if (!CHECK(sb_body_state_hash(body) == end))
        printf("  %s: %s goes on differently\n", k->name, who);
}

/* half: 33, where a static solve has balanced all loads, or 50, with loads that are new. */
static void check_kind(const variety *k, int half)
{
    const int end_frame = half + 50;
    stage s;
    numbers ids, then;
    sb_body *a, *fresh;
    stage_begin(&s, k);
    memset(&ids, 0, sizeof ids);
    a = make_plain_body(&s);
    fresh = make_plain_body(&s);
    if (CHECK(a && fresh)) {
        unsigned long long readings;
        unsigned char *state;
        uint64_t middle, end;
        size_t size;
        play(a, &s, &ids, 0, half);
        then = ids;
        state = save_state(a, &size);
        middle = sb_body_state_hash(a);
        readings = readings_hash(a, &s, &ids, ids.tie);
        play(a, &s, &ids, half, end_frame);
        end = sb_body_state_hash(a);
        CHECK(end != middle && scene_all_finite(sb_body_positions(a), s.mesh.node_count));
        CHECK_OK(sb_body_state_load(fresh, state, size, NULL));
        CHECK(sb_body_state_hash(fresh) == middle);
        CHECK(readings_hash(fresh, &s, &then, then.tie) == readings);
        check_continues("a fresh body", k, fresh, &s, then, half, end_frame, end);
        CHECK_OK(sb_body_state_load(a, state, size, NULL)); /* other loads, constraints, couplings */
        CHECK(sb_body_state_hash(a) == middle);
        CHECK(readings_hash(a, &s, &then, then.tie) == readings);
        check_continues("the same body", k, a, &s, then, half, end_frame, end);
        free(state);
    }
    sb_body_destroy(a);
    sb_body_destroy(fresh);
    stage_end(&s);
}

static void test_continue(void)
{
    for (int i = 0; i < KINDS; i += check_quick() ? 2 : 1)
        check_kind(kinds + i, i % 2 ? 50 : 33);
}

/* Saved at every moment and loaded into one other body: the next frame is the same. */
static void test_every_moment(void)
{
    for (int i = 0; i < KINDS; i += 5) {
        stage s;
        numbers ids;
        sb_body *a, *b;
        stage_begin(&s, kinds + i);
        memset(&ids, 0, sizeof ids);
        a = make_plain_body(&s);
        b = make_plain_body(&s);
        for (int frame = 0; a && b && frame < 90; frame++) {
            numbers same = ids;
            size_t size;
            unsigned char *state = save_state(a, &size);
            CHECK_OK(sb_body_state_load(b, state, size, NULL));
            CHECK(sb_body_state_hash(b) == sb_body_state_hash(a));
            free(state);
            play(a, &s, &ids, frame, frame + 1);
            play(b, &s, &same, frame, frame + 1);
            if (!CHECK(sb_body_state_hash(b) == sb_body_state_hash(a))) {
                printf("  %s, frame %d\n", kinds[i].name, frame);
                break;
            }
        }
        sb_body_destroy(a);
        sb_body_destroy(b);
        stage_end(&s);
    }
}

/* A failing step leaves no trace in any of it, what the condensed system's preconditioner learnt included. */
static void test_failures_leave_no_trace(void)
{
    check_bad_numbers();
    for (int i = 0; i < KINDS; i++) {
        stage s;
        numbers ids;
        sb_body *body;
        stage_begin(&s, kinds + i);
        memset(&ids, 0, sizeof ids);
        body = make_plain_body(&s);
        if (CHECK(body != NULL)) {
            sb_vec3 force = sb_v3(SB_REAL_MAX / 8, 0, 0);
            uint64_t before;
            play(body, &s, &ids, 0, 8);
            CHECK_OK(sb_body_add_forces(body, &s.high, 1, &force, 1));
            before = sb_body_state_hash(body);
            CHECK(sb_body_step(body, REAL(0.001), NULL) != SB_OK);
            if (!CHECK(sb_body_state_hash(body) == before))
                printf("  %s\n", kinds[i].name);
            CHECK(sb_body_solve_static(body, NULL, NULL) != SB_OK); /* the first that the loads take part in */
            if (!CHECK(sb_body_state_hash(body) == before))
                printf("  %s, static\n", kinds[i].name);
            sb_body_clear_loads(body);
            CHECK_OK(sb_body_step(body, REAL(0.0005), NULL));
        }
        sb_body_destroy(body);
        stage_end(&s);
    }
}

/* ---- memory ---- */

/* Loads with every allocation failing in turn; returns how many did. */
static int load_with_failures(sb_body *body, scene_memory *memory, const unsigned char *state, size_t size)
{
    int failures = 0;
    for (int fail = 1; fail < 200; fail++) {
        uint64_t before = sb_body_state_hash(body);
        sb_error error;
        sb_result result;
        memory->calls = 0;
        memory->fail_at = fail;
        result = sb_body_state_load(body, state, size, &error);
        memory->fail_at = 0;
        if (result == SB_OK)
            break;
        failures++;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(error.result == SB_ERROR_MEMORY && error.message[0]);
        CHECK(sb_body_state_hash(body) == before);
    }
    memory->calls = 0;
    CHECK_OK(sb_body_state_load(body, state, size, NULL)); /* all of it is there now */
    CHECK_INT(memory->calls, 0);
    return failures;
}

static void check_memory(const variety *k)
{
    stage s;
    numbers ids, none;
    scene_memory memory = {0, 0, 0, 0};
    sb_jobs no_jobs;
    sb_body *a, *b;
    memset(&no_jobs, 0, sizeof no_jobs);
    stage_begin(&s, k);
    memset(&ids, 0, sizeof ids);
    none = ids;
    a = make_plain_body(&s);
    b = make_body(&s, 1, &memory, no_jobs);
    if (CHECK(a && b)) {
        unsigned char *rich, *plain;
        uint64_t start = sb_body_state_hash(b);
        size_t rich_size, plain_size;
        int live;
        plain = save_state(b, &plain_size);
        play(a, &s, &ids, 0, 11);
        if (is_viscous(k)) {
            sb_material more = make_material(k, 2e4, 3);
            CHECK_OK(sb_body_set_region_material(a, 1, &more, NULL));
            CHECK_OK(sb_body_step(a, REAL(0.0005), NULL));
        }
        rich = save_state(a, &rich_size);
        CHECK(rich_size > plain_size);
        CHECK(load_with_failures(b, &memory, rich, rich_size) > 20);
        CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
        live = memory.live;
        CHECK(load_with_failures(b, &memory, plain, plain_size) > 5); /* the couplings go, too */
        CHECK(sb_body_state_hash(b) == start && memory.live < live);
        CHECK(load_with_failures(b, &memory, rich, rich_size) > 15);
        CHECK_INT(memory.live, live);
        CHECK_OK(sb_body_state_load(b, plain, plain_size, NULL));
        play(b, &s, &none, 0, 11);
        free(rich);
        free(plain);
    }
    sb_body_destroy(b);
    CHECK_INT(memory.live, 0);
    sb_body_destroy(a);
    stage_end(&s);
}

static void test_memory(void)
{
    check_memory(kinds + 0);
    check_memory(kinds + 1);
    check_memory(kinds + 6);
}

/* ---- what is refused ---- */

/* A rich body with numbers that stand nowhere else. */
static sb_body *make_marked_body(const stage *s, numbers *ids)
{
    sb_body *body = make_plain_body(s);
    sb_real stiffness[2] = {REAL(0.3125), REAL(0.4375)};
    sb_vec3 points[2] = {s->mesh.nodes[s->low], s->mesh.nodes[s->high]};
    memset(ids, 0, sizeof *ids);
    play(body, s, ids, 0, 8);
    points[0].z += REAL(0.015625);
    CHECK_OK(sb_body_set_pressure(body, ids->pressure, REAL(12.375)));
    CHECK_OK(sb_body_set_spring_stiffness(body, ids->springs, stiffness, 0));
    CHECK_OK(sb_body_set_constraint_value(body, ids->constraint, REAL(0.001953125)));
    return body;
}

static void test_forged_values(void)
{
    enum { NUMBER_COUNT = 10 };
    check_bad_numbers();
    const double endless = 10 * (double)SB_REAL_MAX;
    struct forged {
        double from, to;
        sb_result expected;
        const char *part;
    } numbers_of[NUMBER_COUNT] = {{12.375, endless, SB_ERROR_NOT_FINITE, "pressure"},
                                  {0.3125, -1, SB_ERROR_ARGUMENT, "stiffness"},
                                  {0.3125, endless, SB_ERROR_ARGUMENT, "stiffness"},
                                  {0.001953125, endless, SB_ERROR_NOT_FINITE, "constraint"},
                                  {-0.75, endless, SB_ERROR_NOT_FINITE, "constraint"},
                                  {-0.75, -endless, SB_ERROR_NOT_FINITE, "constraint"},
                                  {0.02, 0, SB_ERROR_MATERIAL, "Prony"},
                                  {12.375, 1, SB_OK, ""},
                                  {0.3125, 0, SB_OK, ""},
                                  {-0.75, 2, SB_OK, ""}};
    stage s;
    numbers ids;
    sb_body *body;
    unsigned char *state, *bad;
    size_t size;
    stage_begin(&s, kinds + 4);
    body = make_marked_body(&s, &ids);
    state = save_state(body, &size);
    bad = (unsigned char *)malloc(size);
    for (int i = 0; i < NUMBER_COUNT; i++) {
        size_t at = image_find_real(state, size, 24, REAL(numbers_of[i].from));
        uint64_t before = sb_body_state_hash(body);
        sb_error error;
        memset(&error, 0, sizeof error);
        memcpy(bad, state, size);
        if (!CHECK(at + sizeof(sb_real) <= size))
            continue;
        image_put_real(bad + at, REAL(numbers_of[i].to));
        image_seal(bad, size);
        CHECK_RESULT(sb_body_state_load(body, bad, size, &error), numbers_of[i].expected);
        if (numbers_of[i].expected != SB_OK) {
            CHECK(sb_body_state_hash(body) == before);
            if (!CHECK(strstr(error.message, numbers_of[i].part) != NULL))
                printf("  message: %s\n", error.message);
        } else {
            sb_body_step(body, REAL(0.01), NULL);
            CHECK(scene_all_finite(sb_body_displacements(body), s.mesh.node_count));
            CHECK_OK(sb_body_state_load(body, state, size, NULL));
        }
    }
    free(bad);
    free(state);
    sb_body_destroy(body);
    stage_end(&s);
}

/* Where whole numbers stand one behind the other, at or after a place; size when nowhere. */
static size_t find_ints(const unsigned char *image, size_t size, size_t from, const int *values, int count)
{
    unsigned char pattern[64];
    for (int i = 0; i < count; i++)
        image_put(pattern + 4 * i, (uint64_t)(uint32_t)values[i], 4);
    for (size_t at = from; at + 4 * (size_t)count <= size; at++)
        if (memcmp(image + at, pattern, 4 * (size_t)count) == 0)
            return at;
    return size;
}

/* A whole number changed: refused with a message that has a part, and without a trace. */
static void check_forged_int(sb_body *body, const unsigned char *state, size_t size, size_t at, int value,
                             sb_result expected, const char *part)
{
    unsigned char *bad = (unsigned char *)malloc(size);
    uint64_t before = sb_body_state_hash(body);
    sb_error error;
    memcpy(bad, state, size);
    memset(&error, 0, sizeof error);
    if (CHECK(at + 4 <= size)) {
        image_put(bad + at, (uint64_t)(uint32_t)value, 4);
        image_seal(bad, size);
        CHECK_RESULT(sb_body_state_load(body, bad, size, &error), expected);
        CHECK(sb_body_state_hash(body) == before);
        if (!CHECK(strstr(error.message, part) != NULL))
            printf("  message: %s\n", error.message);
    }
    free(bad);
}

/* Rows that are no faces, couplings that the matrix does not have, slaves that cannot be. */
static void test_forged_structure(void)
{
    stage s;
    numbers ids;
    sb_body *body;
    unsigned char *state;
    size_t size, at, value;
    stage_begin(&s, kinds + 0);
    body = make_marked_body(&s, &ids);
    state = save_state(body, &size);
    {
        int face[5] = {3, SB_TRI3, s.top[0], s.top[1], s.top[2]}, row[4] = {3, 1, s.middle, s.high};
        int equation[2] = {2, 3 * s.middle + 1};
        at = find_ints(state, size, 24, face, 5);
        check_forged_int(body, state, size, at + 16, s.slaves[0] == s.top[0] ? s.slaves[1] : s.slaves[0],
                         SB_ERROR_FORMAT, "no face");
        check_forged_int(body, state, size, at + 4, SB_QUAD4, SB_ERROR_FORMAT, "no face");
        check_forged_int(body, state, size, at + 8, -1, SB_ERROR_FORMAT, "node of a load");
        at = find_ints(state, size, 24, row, 4); /* of the couplings */
        check_forged_int(body, state, size, at + 4, s.mesh.node_count, SB_ERROR_FORMAT, "coupling row");
        check_forged_int(body, state, size, at + 4, 2, SB_ERROR_FORMAT, "couples");
        at = find_ints(state, size, at + 4, row, 4); /* of the mapping */
        check_forged_int(body, state, size, at + 4, 2, SB_ERROR_FORMAT, "couples");
        check_forged_int(body, state, size, at, 0, SB_ERROR_FORMAT, "row length");
        at = find_ints(state, size, at, equation, 2);
        check_forged_int(body, state, size, at + 4, 1, SB_ERROR_FORMAT, "supported");
        check_forged_int(body, state, size, at + 4, 3 * s.high + 1, SB_ERROR_ARGUMENT, "slave and master");
        check_forged_int(body, state, size, at + 4, 3 * s.mesh.node_count, SB_ERROR_FORMAT, "unknown");
        value = at - sizeof(sb_real);
        check_forged_int(body, state, size, value - 4, ids.constraint + 1, SB_ERROR_FORMAT, "constraint");
    }
    free(state);
    sb_body_destroy(body);
    stage_end(&s);
}

/* What an explicit body knows of its stability stands before the last part, the preconditioner's 20 bytes. */
static void test_forged_guard(void)
{
    stage s;
    numbers ids;
    sb_body *body;
    unsigned char *state;
    size_t size, stable;
    uint64_t before;
    sb_error error;
    stage_begin(&s, kinds + 2);
    memset(&ids, 0, sizeof ids);
    body = make_plain_body(&s);
    play(body, &s, &ids, 0, 3);
    state = save_state(body, &size);
    stable = size - 8 - 20 - (8 + 16 + sizeof(sb_real));
    check_forged_int(body, state, size, stable + sizeof(sb_real) + 8, 17, SB_ERROR_FORMAT, "caution");
    image_put_real(state + stable, -1);
    image_seal(state, size);
    before = sb_body_state_hash(body);
    CHECK_RESULT(sb_body_state_load(body, state, size, &error), SB_ERROR_FORMAT);
    CHECK(strstr(error.message, "stable step") != NULL && sb_body_state_hash(body) == before);
    free(state);
    sb_body_destroy(body);
    stage_end(&s);
}

/* Every byte of a state changed in turn is seen by its checksum; with a right checksum the load is refused without a
 * trace, or the body can go on. */
static void check_forged_bytes(const variety *k, size_t stride)
{
    stage s;
    numbers ids;
    sb_body *body;
    unsigned char *state, *bad;
    size_t size;
    int accepted = 0, refused = 0;
    stage_begin(&s, k);
    body = make_marked_body(&s, &ids);
    state = save_state(body, &size);
    bad = (unsigned char *)malloc(size);
    memcpy(bad, state, size);
    for (size_t at = 0; at < size; at++) {
        uint64_t before = at % 97 ? 0 : sb_body_state_hash(body);
        bad[at] ^= (unsigned char)(1u << at % 8);
        if (!CHECK(sb_body_state_load(body, bad, size, NULL) != SB_OK))
            printf("  byte %lu of %lu\n", (unsigned long)at, (unsigned long)size);
        CHECK(at % 97 || sb_body_state_hash(body) == before);
        bad[at] = state[at];
    }
    for (size_t at = 24; at < size - 8; at += stride) {
        static const unsigned char changes[4] = {0xFF, 0x01, 0x80, 0x10};
        uint64_t before = sb_body_state_hash(body);
        sb_error error;
        memcpy(bad, state, size);
        bad[at] ^= changes[at / stride % 4];
        image_seal(bad, size);
        if (sb_body_state_load(body, bad, size, &error) != SB_OK) {
            CHECK(sb_body_state_hash(body) == before && error.message[0]);
            refused++;
            continue;
        }
        accepted++;
        CHECK_OK(sb_body_set_solver(body, REAL(1e-3), 20));
        if (k->integrator != SB_CENTRAL_DIFFERENCE)
            sb_body_step(body, REAL(0.01), NULL);
        CHECK(scene_all_finite(sb_body_displacements(body), s.mesh.node_count));
        CHECK(scene_all_finite(sb_body_velocities(body), s.mesh.node_count));
        CHECK_OK(sb_body_state_load(body, state, size, NULL));
    }
    if (!CHECK(accepted > 50 && refused > 10))
        printf("  %s: %d accepted, %d refused\n", k->name, accepted, refused);
    free(bad);
    free(state);
    sb_body_destroy(body);
    stage_end(&s);
}

static void test_forged_bytes(void)
{
    check_bad_numbers();
    check_forged_bytes(kinds + 0, 13);
    check_forged_bytes(kinds + 11, 37);
    check_forged_bytes(kinds + 12, 37);
}

/* A body of another custom element, or with another integration, is another body. */
static void test_other_bodies(void)
{
    static sb_real weights[6];
    stage s;
    sb_body *body;
    unsigned char *state;
    size_t size;
    stage_begin(&s, kinds + 11);
    body = make_plain_body(&s);
    state = save_state(body, &size);
    sb_body_destroy(body);
    for (int i = 0; i < 6; i++)
        weights[i] = wedge_weights[i] * (i < 2 ? REAL(0.875) : REAL(1.0625)); /* the same volume */
    s.table.mass_weights = weights;
    body = make_plain_body(&s);
    if (CHECK(body != NULL)) {
        sb_error error;
        CHECK_RESULT(sb_body_state_load(body, state, size, &error), SB_ERROR_STATE);
        CHECK(strstr(error.message, "custom") != NULL);
    }
    sb_body_destroy(body);
    free(state);
    stage_end(&s);
}

/* ---- recordings ---- */

static sb_recording *record_session(const stage *s, int frames, sb_body **body)
{
    sb_recording *recording = NULL;
    numbers ids;
    memset(&ids, 0, sizeof ids);
    *body = make_plain_body(s);
    CHECK_OK(sb_recording_start(*body, 10, NULL, &recording, NULL));
    play(*body, s, &ids, 0, frames);
    if (is_viscous(s->kind)) {
        sb_material bare = make_bare_material(s->kind);
        CHECK_OK(sb_body_set_material(*body, &bare, NULL));
        CHECK_OK(sb_body_set_fibres(*body, NULL, NULL));
        CHECK_OK(sb_body_step(*body, REAL(0.0005), NULL));
    }
    /* refused calls are not recorded */
    CHECK(sb_body_set_pressure(*body, 9999, 1) != SB_OK && sb_body_remove_load(*body, 9999) != SB_OK);
    CHECK(sb_body_remove_constraint(*body, 9999, NULL) != SB_OK);
    return recording;
}

static void test_replay(void)
{
    for (int i = 0; i < KINDS; i += 2) {
        int workers = 3;
        stage s;
        sb_body *body, *other;
        sb_recording *recording;
        sb_recording_report report;
        stage_begin(&s, kinds + i);
        recording = record_session(&s, 86, &body);
        other = make_body(&s, 1, NULL, scene_jobs(&workers));
        CHECK(sb_recording_get_info(recording).complete);
        if (!CHECK_OK(sb_recording_replay(recording, other, &report)))
            printf("  %s: %s\n", kinds[i].name, report.error.message);
        CHECK_INT(report.commands, sb_recording_get_info(recording).commands);
        CHECK(sb_body_state_hash(other) == sb_body_state_hash(body));
        sb_recording_destroy(recording);
        sb_body_destroy(body);
        sb_body_destroy(other);
        stage_end(&s);
    }
}

/* A replay on a body whose allocator fails in turn ends with that error and a body that holds. */
static void test_replay_memory(void)
{
    stage s;
    sb_body *body;
    sb_recording *recording;
    sb_jobs none;
    int failures = 0;
    memset(&none, 0, sizeof none);
    stage_begin(&s, kinds + 0);
    recording = record_session(&s, 6, &body);
    for (int fail = 1; fail < 400; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_body *other = make_body(&s, 1, &memory, none);
        sb_recording_report report;
        sb_result result;
        memory.calls = 0;
        memory.fail_at = fail;
        result = sb_recording_replay(recording, other, &report);
        memory.fail_at = 0;
        failures += result != SB_OK;
        if (result != SB_OK)
            CHECK_RESULT(result, SB_ERROR_MEMORY);
        sb_body_destroy(other);
        CHECK_INT(memory.live, 0);
        if (result == SB_OK)
            break;
    }
    CHECK(failures > 20 && failures < 399);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    stage_end(&s);
}

/* The first command of each code with other numbers in its head: refused, or played somehow. */
static void test_forged_commands(void)
{
    static const int changes[6] = {-1, 0, 1, 2, 5, 1 << 30};
    stage s;
    sb_body *body, *other;
    sb_recording *recording;
    unsigned char *bytes;
    size_t size, at;
    int codes[64] = {0}, kinds_of_commands = 0, refused = 0;
    stage_begin(&s, kinds + 1);
    recording = record_session(&s, 32, &body);
    size = sb_recording_get_info(recording).bytes;
    bytes = (unsigned char *)malloc(size);
    CHECK_OK(sb_recording_save(recording, bytes, size));
    other = make_plain_body(&s);
    at = 56 + (size_t)image_number(bytes + 48, 8);
    while (at < size - 8) {
        int code = (int)image_number(bytes + at, 4);
        for (int k = 0; k < 12 && codes[code % 64] == 0; k++) {
            unsigned char *place = bytes + at + (k % 2 ? 4 : 8);
            uint64_t was = image_number(place, 4);
            sb_recording *loaded = NULL;
            image_put(place, (uint64_t)(uint32_t)changes[k / 2], 4);
            image_seal(bytes, size);
            if (sb_recording_load(bytes, size, NULL, &loaded, NULL) == SB_OK)
                refused += sb_recording_replay(loaded, other, NULL) != SB_OK;
            else
                refused++;
            CHECK(scene_all_finite(sb_body_displacements(other), s.mesh.node_count));
            sb_recording_destroy(loaded);
            image_put(place, was, 4);
        }
        kinds_of_commands += codes[code % 64] == 0;
        codes[code % 64] = 1;
        at += 32 + 4 * (size_t)image_number(bytes + at + 12, 4) +
              sizeof(sb_real) * (size_t)image_number(bytes + at + 16, 8) + (size_t)image_number(bytes + at + 24, 8);
    }
    CHECK_INT(at, size - 8);
    CHECK_INT(kinds_of_commands, 17);
    CHECK(refused > 60);
    free(bytes);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(other);
    stage_end(&s);
}

/* Any byte of the commands changed, with a right checksum: refused, or played somehow. */
static void test_forged_recordings(void)
{
    stage s;
    sb_body *body, *other;
    sb_recording *recording;
    unsigned char *bytes, *bad;
    size_t size, from;
    int loaded_count = 0, refused = 0;
    stage_begin(&s, kinds + 0);
    recording = record_session(&s, 11, &body);
    size = sb_recording_get_info(recording).bytes;
    bytes = (unsigned char *)malloc(size);
    bad = (unsigned char *)malloc(size);
    CHECK_OK(sb_recording_save(recording, bytes, size));
    other = make_plain_body(&s);
    from = 56 + sb_body_state_size(other);
    for (size_t at = from; at < size - 8; at += 11) {
        sb_recording *loaded = NULL;
        sb_recording_report report;
        memcpy(bad, bytes, size);
        bad[at] ^= (unsigned char)(at % 2 ? 0x01 : 0xFF);
        image_seal(bad, size);
        if (sb_recording_load(bad, size, NULL, &loaded, NULL) != SB_OK)
            continue;
        loaded_count++;
        refused += sb_recording_replay(loaded, other, &report) != SB_OK;
        CHECK(scene_all_finite(sb_body_displacements(other), s.mesh.node_count));
        sb_recording_destroy(loaded);
    }
    CHECK(loaded_count > 50 && refused > 50);
    free(bytes);
    free(bad);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(other);
    stage_end(&s);
}

CHECK_SUITE(checkpoint, {"continues to the same bits", test_continue}, {"saved at every moment", test_every_moment},
            {"failures leave no trace", test_failures_leave_no_trace}, {"memory", test_memory},
            {"forged values", test_forged_values}, {"forged structure", test_forged_structure},
            {"forged guard", test_forged_guard}, {"forged commands", test_forged_commands},
            {"forged bytes", test_forged_bytes}, {"states of other bodies", test_other_bodies},
            {"recordings play again", test_replay}, {"memory of a replay", test_replay_memory},
            {"forged recordings", test_forged_recordings});
