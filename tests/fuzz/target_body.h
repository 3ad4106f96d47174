/* Targets: a small mesh, a def and commands, all from bytes; saved states and recordings with bytes changed. */
#ifndef TARGET_BODY_H
#define TARGET_BODY_H

#include "fuzz.h"
#include "wedge.h"

check_state check; /* of wedge.h */

/* ---- random bodies ---- */

enum { FUZZ_MAX_NODES = 100, FUZZ_SUBSTEPS = 40 };

/* Bits of a mesh's shape byte. The first two: cells along x and y. */
enum { FUZZ_REGIONS = 4, FUZZ_ALPHA = 8, FUZZ_CENTRAL = 16, FUZZ_BBAR = 32, FUZZ_FIBRES = 64, FUZZ_TWO_PARTS = 128 };

static sb_element_type fuzz_element_type(int byte)
{
    static const sb_element_type types[3] = {SB_TET4, SB_TET10, SB_HEX8};
    static const sb_element_type others[3] = {SB_HEX20, SB_HEX27, SB_CUSTOM};
    return byte < 192 ? types[byte % 3] : others[byte % 3];
}

/* A beam; custom elements are wedges. The table outlives every body. */
static int fuzz_beam(sb_element_type type, int nx, int ny, sb_mesh *mesh)
{
    static sb_element_table table;
    sb_vec3 size = sb_v3(1, 1, 1);
    table = wedge_table();
    memset(mesh, 0, sizeof *mesh);
    if (type == SB_CUSTOM)
        *mesh = wedge_box(&table, nx, ny, 1, size, 0);
    else if (type == SB_HEX20 || type == SB_HEX27)
        *mesh = scene_box(type, nx, ny, 1, size, 0);
    else if (sb_mesh_beam(type, nx, ny, 1, size, NULL, mesh, NULL) != SB_OK)
        return 0;
    return 1;
}

/* A second part behind the first. */
static int fuzz_append_part(sb_element_type type, sb_mesh *mesh)
{
    sb_mesh second;
    int appended = fuzz_beam(type, 1, 1, &second);
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += 1;
    appended = appended && sb_mesh_append(mesh, &second, NULL) == SB_OK;
    sb_mesh_free(&second);
    return appended;
}

/* A beam with some nodes moved and some indices changed, which may make it useless. */
static int fuzz_make_mesh(fuzz_bytes *bytes, int *flags, sb_mesh *mesh)
{
    sb_element_type type = fuzz_element_type(fuzz_byte(bytes));
    int shape = fuzz_byte(bytes), moves = fuzz_byte(bytes) % 4, swaps = fuzz_byte(bytes) % 16 == 1, entries;
    *flags = shape;
    if (!fuzz_beam(type, 1 + shape % 2, 1 + (type == SB_TET4 ? shape / 2 % 2 : 0), mesh))
        return 0;
    if ((shape & FUZZ_TWO_PARTS) && !fuzz_append_part(type, mesh))
        return 0;
    if (shape & FUZZ_REGIONS)
        mesh->regions = (int *)calloc((size_t)mesh->element_count, sizeof(int));
    for (int e = 0; mesh->regions && e < mesh->element_count; e++)
        mesh->regions[e] = e % 2 ? 7 : -1;
    for (int k = 0; k < moves; k++) {
        sb_vec3 *x = mesh->nodes + fuzz_byte(bytes) % mesh->node_count, d = fuzz_vector(bytes);
        *x = sb_v3_madd(*x, (sb_real)0.4, d);
    }
    entries = mesh->element_count * sb_mesh_element_width(mesh);
    if (swaps)
        mesh->elements[fuzz_byte(bytes) % entries] = fuzz_byte(bytes) - 4;
    return mesh->node_count <= FUZZ_MAX_NODES;
}

/* One to three Prony terms, mostly good ones. */
static sb_material fuzz_prony(fuzz_bytes *bytes, sb_material material)
{
    sb_real g[3], tau[3];
    int count = 1 + fuzz_byte(bytes) % 3;
    for (int i = 0; i < count; i++) {
        g[i] = (sb_real)0.33 * sb_abs(fuzz_real(bytes));
        tau[i] = sb_abs(fuzz_real(bytes));
    }
    return sb_material_with_prony(material, g, tau, count);
}

static sb_material fuzz_material(fuzz_bytes *bytes)
{
    int model = fuzz_byte(bytes);
    sb_material m = sb_material_corotated((sb_real)(100 * (1 + fuzz_byte(bytes))), (sb_real)0.3, 1000);
    if (model % 16 == 15)
        m = sb_material_neo_hookean_isochoric(sb_abs(fuzz_real(bytes)), sb_abs(fuzz_real(bytes)), 1000);
    else if (model % 16 == 14)
        m = sb_material_mooney_rivlin(1000 * fuzz_real(bytes), 1000 * fuzz_real(bytes),
                                      (sb_real)0.001 * sb_abs(fuzz_real(bytes)), 1000);
    else if (model % 16 == 13)
        m = sb_material_reduced_polynomial(1000 * sb_abs(fuzz_real(bytes)), 1000 * fuzz_real(bytes),
                                           1000 * fuzz_real(bytes), (sb_real)0.001, 1000);
    else
        m.model = (sb_material_model)(model % 8); /* known ones, 0 too */
    if (model & 32)
        m = sb_material_with_fibres(m, 1000 * fuzz_real(bytes), fuzz_real(bytes));
    if (model & 64)
        m = fuzz_prony(bytes, m);
    if (model >= 192)
        m.lambda = 100 * fuzz_real(bytes);
    if (model >= 224)
        m.density = 1000 * fuzz_real(bytes);
    return m;
}

static sb_body *fuzz_make_body(fuzz_bytes *bytes, int flags, const sb_mesh *mesh)
{
    static const double tolerances[4] = {1e-3, 1e-6, 0.5, 1e-12};
    sb_region_material own;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    sb_vec3 fibres[4 * FUZZ_MAX_NODES];
    int kind = fuzz_byte(bytes), more = fuzz_byte(bytes);
    FUZZ_REQUIRE(mesh->element_count <= 4 * FUZZ_MAX_NODES);
    for (int e = 0; e < mesh->element_count; e++)
        fibres[e] = sb_v3((sb_real)(e % 3), 1, (sb_real)-1);
    def.mesh = mesh;
    def.material = fuzz_material(bytes);
    own.region = 7;
    own.material = def.material;
    if (more & 1) {
        own.material = fuzz_material(bytes);
        def.region_materials = &own;
        def.region_material_count = 1;
    }
    def.fibres = flags & FUZZ_FIBRES ? fibres : NULL;
    def.integrator = kind & 1 ? SB_NEWMARK : SB_EULER;
    def.integrator = flags & FUZZ_ALPHA     ? SB_GENERALISED_ALPHA
                     : flags & FUZZ_CENTRAL ? SB_CENTRAL_DIFFERENCE
                                            : def.integrator;
    def.spectral_radius = kind & 64 ? (sb_real)0.5 : (sb_real)0.9;
    def.max_substeps = FUZZ_SUBSTEPS;
    def.mass = (sb_mass_kind)(kind / 2 % 4 % 3);
    def.preconditioner = (sb_precond_kind)(kind / 8 % 5);
    def.single_rotation = (more & 6) == 6;
    def.integration = more & 8 ? SB_INTEGRATION_CURVED : SB_INTEGRATION_AUTO;
    if ((flags & FUZZ_BBAR) && mesh->element_type != SB_TET4 && mesh->element_type != SB_CUSTOM && !def.single_rotation)
        def.integration = SB_INTEGRATION_BBAR;
    def.max_newton = more & 16 ? 1 + more / 32 % 4 : SB_AUTO;
    def.tolerance = (sb_real)tolerances[more / 64];
    def.max_iterations = 40;
    if (kind >= 128) {
        def.gravity = fuzz_vector(bytes);
        def.damping_mass = fuzz_real(bytes);
        def.damping_stiffness = (sb_real)0.1 * fuzz_real(bytes);
    }
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        FUZZ_REQUIRE(body == NULL && error.result != SB_OK && error.message[0]);
        return NULL;
    }
    return body;
}

/* ---- random commands ---- */

typedef struct fuzz_session {
    fuzz_bytes bytes;
    sb_body *body;
    const sb_mesh *mesh;
    void *saved; /* a state, or NULL */
    size_t saved_size;
    sb_recording *recording; /* or NULL */
} fuzz_session;

/* Up to three nodes, now and then one that does not exist. */
static int fuzz_nodes(fuzz_session *s, int nodes[3])
{
    int count = 1 + fuzz_byte(&s->bytes) % 3;
    for (int i = 0; i < count; i++) {
        int b = fuzz_byte(&s->bytes);
        nodes[i] = b == 255 ? s->mesh->node_count : b == 254 ? -1 : b % s->mesh->node_count;
    }
    return count;
}

static sb_result fuzz_supports(fuzz_session *s, int kind)
{
    int nodes[3], count = fuzz_nodes(s, nodes), axes = fuzz_byte(&s->bytes) % 9;
    sb_vec3 targets[3];
    for (int i = 0; i < 3; i++)
        targets[i] = fuzz_vector(&s->bytes);
    switch (kind) {
    case 0: return sb_body_fix_nodes(s->body, nodes, count, axes);
    case 1: return sb_body_prescribe(s->body, nodes, count, axes, targets, axes & 1);
    case 2: return sb_body_release_nodes(s->body, nodes, count, axes);
    default: return sb_body_add_forces(s->body, nodes, count, targets, axes & 1);
    }
}

static sb_result fuzz_set(fuzz_session *s, int kind)
{
    fuzz_bytes *bytes = &s->bytes;
    sb_material material;
    sb_real a, b;
    int face[4];
    switch (kind) {
    case 0: material = fuzz_material(bytes); return sb_body_set_material(s->body, &material, NULL);
    case 1: material = fuzz_material(bytes); return sb_body_set_region_material(s->body, 7, &material, NULL);
    case 2: return sb_body_set_gravity(s->body, fuzz_vector(bytes));
    case 3: a = fuzz_real(bytes), b = fuzz_real(bytes); return sb_body_set_damping(s->body, a, b);
    case 4: a = fuzz_real(bytes); return sb_body_set_solver(s->body, a, fuzz_byte(bytes) % 50);
    default:
        for (int i = 0; i < 4; i++)
            face[i] = fuzz_byte(bytes) % 32 - 1;
        return sb_body_add_traction(s->body, face, 1, 3 + fuzz_byte(bytes) % 2, fuzz_vector(bytes), NULL);
    }
}

static sb_result fuzz_set_motion(fuzz_session *s, int velocities)
{
    sb_vec3 values[FUZZ_MAX_NODES];
    memset(values, 0, sizeof values);
    for (int i = 0, count = fuzz_byte(&s->bytes) % 6; i < count; i++)
        values[fuzz_byte(&s->bytes) % s->mesh->node_count] = fuzz_vector(&s->bytes);
    return velocities ? sb_body_set_velocities(s->body, values) : sb_body_set_displacements(s->body, values);
}

static void fuzz_save_state(fuzz_session *s)
{
    free(s->saved);
    s->saved_size = sb_body_state_size(s->body);
    s->saved = malloc(s->saved_size);
    FUZZ_REQUIRE(s->saved && sb_body_state_save(s->body, s->saved, s->saved_size) == SB_OK);
}

/* A saved state is always taken back. */
static void fuzz_load_state(fuzz_session *s)
{
    if (s->saved)
        FUZZ_REQUIRE(sb_body_state_load(s->body, s->saved, s->saved_size, NULL) == SB_OK);
}

static void fuzz_static(fuzz_session *s)
{
    sb_static_options options = sb_default_static_options();
    options.load_steps = fuzz_byte(&s->bytes) % 3;
    options.max_newton = fuzz_byte(&s->bytes) % 6;
    options.max_iterations = 40;
    options.keep_progress = fuzz_byte(&s->bytes) & 1;
    fuzz_solve(s->body, &options);
}

static void fuzz_read(sb_body *body)
{
    sb_real values[FUZZ_MAX_NODES * 4];
    sb_energy energy;
    sb_mat3 stress;
    sb_check_report report;
    uint64_t before = sb_body_state_hash(body);
    if (sb_body_energy(body, &energy) == SB_OK)
        FUZZ_REQUIRE(sb_is_finite(energy.elastic) && sb_is_finite(energy.kinetic));
    if (sb_body_stress(body, 0, 0, &stress) == SB_OK)
        FUZZ_REQUIRE(sb_is_finite(sb_von_mises(stress)));
    FUZZ_REQUIRE(sb_body_element_count(body) <= FUZZ_MAX_NODES * 4);
    sb_body_von_mises(body, values);
    sb_body_nodal_von_mises(body, values);
    FUZZ_REQUIRE(sb_body_check(body, &report) == SB_OK);
    FUZZ_REQUIRE(sb_body_state_hash(body) == before);
}

/* ---- loads that follow, constraints ---- */

/* Corners of a face of an element, now and then of none. Returns their number. */
static int fuzz_face(fuzz_session *s, int corners[4])
{
    const sb_mesh *mesh = s->mesh;
    sbi_element element = sbi_element_make(mesh->element_type, mesh->table);
    int e = fuzz_byte(&s->bytes) % mesh->element_count, f = fuzz_byte(&s->bytes), local[SB_MAX_FACE_NODES], count;
    sb_element_type type = SB_NO_ELEMENT;
    sbi_element_face(element, f % sbi_element_face_count(element), local, &type);
    count = sb_element_corner_count(type);
    for (int k = 0; k < count; k++)
        corners[k] = mesh->elements[e * sb_mesh_element_width(mesh) + local[k]];
    if (f > 240)
        corners[0] = f % 2 ? -1 : mesh->node_count / 2;
    return count;
}

/* The id of a load that may be there. */
static int fuzz_load_id(fuzz_session *s) { return 1 + fuzz_byte(&s->bytes) % 8; }

/* Rows of a load, so that its arrays can be made long enough; 0: none. */
static int fuzz_load_rows(const fuzz_session *s, int id)
{
    for (int i = 0; i < s->body->load_count; i++)
        if (s->body->loads[i].id == id)
            return s->body->loads[i].row_count;
    return 0;
}

static sb_result fuzz_add_mapping(fuzz_session *s, const sb_vec3 *points, const sb_real *stiffness)
{
    int start[3] = {0, 0, 0}, nodes[6], rows = 1 + fuzz_byte(&s->bytes) % 2, id;
    sb_real weights[6];
    sb_mapping mapping;
    for (int j = 0; j < rows; j++)
        start[j + 1] = start[j] + fuzz_nodes(s, nodes + start[j]);
    for (int k = 0; k < start[rows]; k++)
        weights[k] = fuzz_real(&s->bytes);
    mapping.row_count = rows;
    mapping.row_start = start;
    mapping.nodes = nodes;
    mapping.weights = weights;
    return sb_body_add_mapping(s->body, &mapping, stiffness, rows & 1, points, &id, NULL);
}

static sb_result fuzz_loads(fuzz_session *s, int kind)
{
    sb_vec3 points[3];
    sb_real stiffness[3];
    int nodes[3], count, face[4], id = kind == 1 || kind > 4 ? fuzz_load_id(s) : 0, rows = fuzz_load_rows(s, id);
    for (int i = 0; i < 3 && kind > 1 && kind < 8; i++) {
        points[i] = fuzz_vector(&s->bytes);
        stiffness[i] = 1000 * sb_abs(fuzz_real(&s->bytes));
    }
    if (rows > 3) /* none of these has more */
        return SB_OK;
    switch (kind) {
    case 0:
        count = fuzz_face(s, face);
        return sb_body_add_pressure(s->body, face, 1, count, 100 * fuzz_real(&s->bytes), &id, NULL);
    case 1: return sb_body_set_pressure(s->body, id, 100 * fuzz_real(&s->bytes));
    case 2:
        count = fuzz_nodes(s, nodes);
        return sb_body_add_springs(s->body, nodes, count, stiffness, count & 1, points, &id, NULL);
    case 3:
    case 4: return fuzz_add_mapping(s, points, stiffness);
    case 5: return sb_body_move_springs(s->body, id, points);
    case 6: return sb_body_set_mapping_targets(s->body, id, points);
    case 7:
        return id & 1 ? sb_body_set_spring_stiffness(s->body, id, stiffness, 0)
                      : sb_body_set_mapping_stiffness(s->body, id, stiffness, 1);
    default: return sb_body_remove_load(s->body, id);
    }
}

/* One or two equations of up to four terms. */
static sb_result fuzz_add_constraints(fuzz_session *s)
{
    sb_constraint_term terms[8];
    sb_real values[2];
    int counts[2], count = 1 + fuzz_byte(&s->bytes) % 2, used = 0;
    for (int c = 0; c < count; c++) {
        counts[c] = 1 + fuzz_byte(&s->bytes) % 4;
        values[c] = (sb_real)0.1 * fuzz_real(&s->bytes);
        for (int k = 0; k < counts[c]; k++, used++) {
            terms[used].node = fuzz_byte(&s->bytes) % (s->mesh->node_count + 1);
            terms[used].axis = fuzz_byte(&s->bytes) % 16 % 5 % 4;
            terms[used].coefficient = fuzz_real(&s->bytes);
        }
    }
    return sb_body_add_constraints(s->body, terms, counts, values, count, NULL, NULL);
}

/* Nodes of one part against faces of the other, or whatever the bytes say. */
static sb_result fuzz_tie(fuzz_session *s)
{
    int faces[4], slaves[6], corners = fuzz_face(s, faces), count = 1 + fuzz_byte(&s->bytes) % 5;
    for (int i = 0; i < count; i++)
        slaves[i] = fuzz_byte(&s->bytes) % s->mesh->node_count;
    return sb_body_tie_faces(s->body, faces, 1, corners, slaves, count, fuzz_real(&s->bytes), fuzz_byte(&s->bytes) % 4,
                             NULL, NULL);
}

static sb_result fuzz_constraints(fuzz_session *s, int kind)
{
    int first;
    switch (kind) {
    case 0: return fuzz_add_constraints(s);
    case 1: return fuzz_tie(s);
    case 2:
        first = fuzz_byte(&s->bytes) % 16;
        return sb_body_set_constraint_value(s->body, first, fuzz_real(&s->bytes));
    case 3:
        first = fuzz_byte(&s->bytes) % 16;
        return sb_body_remove_constraints(s->body, first, fuzz_byte(&s->bytes) % 3, NULL);
    default: sb_body_clear_constraints(s->body); return SB_OK;
    }
}

static sb_result fuzz_fibres(fuzz_session *s)
{
    sb_vec3 fibres[4 * FUZZ_MAX_NODES], direction = fuzz_vector(&s->bytes);
    for (int e = 0; e < s->mesh->element_count; e++)
        fibres[e] = e % 4 ? direction : sb_v3(0, 0, 0);
    return sb_body_set_fibres(s->body, fuzz_byte(&s->bytes) % 4 ? fibres : NULL, NULL);
}

static void fuzz_modes(fuzz_session *s)
{
    sb_modes_options options = sb_default_modes_options();
    sb_real frequencies[4] = {0, 0, 0, 0};
    uint64_t before = sb_body_state_hash(s->body);
    int count = fuzz_byte(&s->bytes) % 5;
    options.max_iterations = 4;
    options.at_present = fuzz_byte(&s->bytes) & 1;
    options.tolerance = (sb_real)1e-3;
    if (sb_body_modes(s->body, count, &options, frequencies, NULL, NULL, NULL) == SB_OK)
        for (int i = 0; i < count; i++)
            FUZZ_REQUIRE(sb_is_finite(frequencies[i]));
    FUZZ_REQUIRE(sb_body_state_hash(s->body) == before);
}

/* ---- a recording of the rest of the session ---- */

static void fuzz_start_recording(fuzz_session *s)
{
    if (!s->recording)
        FUZZ_REQUIRE(sb_recording_start(s->body, 3, NULL, &s->recording, NULL) == SB_OK);
}

/* What was recorded plays again, also from its file form, to the same end. */
static void fuzz_replay(fuzz_session *s)
{
    uint64_t end = sb_body_state_hash(s->body);
    size_t size = sb_recording_get_info(s->recording).bytes;
    void *bytes = malloc(size);
    sb_recording *loaded = NULL;
    sb_recording_report report;
    FUZZ_REQUIRE(bytes && sb_recording_save(s->recording, bytes, size) == SB_OK);
    FUZZ_REQUIRE(sb_recording_get_info(s->recording).complete);
    sb_recording_destroy(s->recording);
    FUZZ_REQUIRE(sb_recording_load(bytes, size, NULL, &loaded, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_recording_replay(loaded, s->body, &report) == SB_OK);
    FUZZ_REQUIRE(sb_body_state_hash(s->body) == end);
    sb_recording_destroy(loaded);
    free(bytes);
}

/* ---- the session ---- */

/* What an operation of a byte below 144 does; a setter's result. */
static sb_result fuzz_basic(fuzz_session *s, int op)
{
    if (op < 5)
        return fuzz_supports(s, op);
    if (op < 11)
        return fuzz_set(s, op - 5);
    if (op < 13)
        return fuzz_set_motion(s, op - 11);
    if (op == 13)
        sb_body_clear_loads(s->body);
    else if (op == 14)
        sb_body_reset(s->body);
    else if (op == 15)
        fuzz_static(s);
    else if (op == 16)
        fuzz_save_state(s);
    else if (op == 17)
        fuzz_load_state(s);
    else if (op == 18)
        fuzz_read(s->body);
    else
        fuzz_step(s->body, sb_abs(fuzz_real(&s->bytes)) / 20);
    return SB_OK;
}

/* Of the bytes from 144 on. */
static sb_result fuzz_more(fuzz_session *s, int op)
{
    if (op < 9)
        return fuzz_loads(s, op);
    if (op < 14)
        return fuzz_constraints(s, op - 9);
    if (op == 14)
        return fuzz_fibres(s);
    if (op == 15)
        fuzz_modes(s);
    else if (op == 16)
        fuzz_start_recording(s);
    else
        fuzz_step(s->body, (sb_real)0.01);
    return SB_OK;
}

/* One command; a setter that fails changes nothing. */
static void fuzz_command(fuzz_session *s)
{
    int byte = fuzz_byte(&s->bytes);
    uint64_t before = sb_body_state_hash(s->body);
    sb_result result = byte < 144 ? fuzz_basic(s, byte % 24) : fuzz_more(s, (byte - 144) % 18);
    if (result != SB_OK)
        FUZZ_REQUIRE(sb_body_state_hash(s->body) == before);
    fuzz_check_body(s->body);
}

static void fuzz_body(const uint8_t *data, size_t size)
{
    sb_mesh mesh;
    fuzz_session s;
    int flags;
    memset(&s, 0, sizeof s);
    s.bytes.data = data;
    s.bytes.size = size;
    s.mesh = &mesh;
    if (fuzz_make_mesh(&s.bytes, &flags, &mesh))
        s.body = fuzz_make_body(&s.bytes, flags, &mesh);
    for (int k = 0; s.body && k < 24 && !fuzz_is_empty(&s.bytes); k++)
        fuzz_command(&s);
    if (s.recording)
        fuzz_replay(&s);
    free(s.saved);
    sb_body_destroy(s.body);
    sb_mesh_free(&mesh);
}

/* ---- states and recordings with bytes changed ---- */

/* Kinds of bodies that states and recordings are of. */
static const struct fuzz_known {
    sb_element_type type;
    sb_integrator integrator;
    int hyperelastic, bbar, rich; /* rich: two parts, with loads that follow, constraints, fibres and Prony terms */
} fuzz_known[8] = {{SB_TET4, SB_EULER, 0, 0, 0},
                   {SB_TET10, SB_NEWMARK, 0, 0, 0},
                   {SB_HEX8, SB_EULER, 0, 0, 0},
                   {SB_TET4, SB_EULER, 1, 0, 0},
                   {SB_HEX8, SB_GENERALISED_ALPHA, 1, 1, 1},
                   {SB_TET4, SB_CENTRAL_DIFFERENCE, 1, 0, 1},
                   {SB_CUSTOM, SB_EULER, 0, 0, 1},
                   {SB_HEX20, SB_EULER, 1, 0, 0}};

/* Loads and constraints for a body of two parts, whose first `split` nodes are the first. */
static void fuzz_enrich(sb_body *body, const sb_mesh *mesh, int split)
{
    int far_end = mesh->node_count - 1, start[2] = {0, 2}, nodes[2], slaves[3], count = 0, id;
    sb_real stiffness = 20, weights[2] = {(sb_real)0.5, (sb_real)0.5};
    sb_vec3 target = sb_v3(1, (sb_real)0.5, (sb_real)0.5);
    fuzz_session s;
    sb_constraint_term term;
    sb_mapping mapping;
    uint8_t choice[2] = {0, 0}; /* element and face */
    int face[4], corners, found = 0;
    memset(&s, 0, sizeof s);
    s.bytes.data = choice;
    s.bytes.size = sizeof choice;
    s.mesh = mesh;
    for (corners = 0; choice[1] < 6 && !found; choice[1]++) { /* one of the surface */
        s.bytes.at = 0;
        corners = fuzz_face(&s, face);
        found = sb_body_add_pressure(body, face, 1, corners, 50, &id, NULL) == SB_OK;
    }
    FUZZ_REQUIRE(found);
    nodes[0] = 0;
    nodes[1] = far_end;
    mapping.row_count = 1;
    mapping.row_start = start;
    mapping.nodes = nodes;
    mapping.weights = weights;
    FUZZ_REQUIRE(sb_body_add_springs(body, &far_end, 1, &stiffness, 1, &target, &id, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_body_add_mapping(body, &mapping, &stiffness, 1, &target, &id, NULL) == SB_OK);
    for (int i = split; i < far_end && count < 3; i++)
        slaves[count++] = i;
    FUZZ_REQUIRE(sb_body_tie_faces(body, face, 1, corners, slaves, count, 10, 0, NULL, NULL) == SB_OK);
    term.node = far_end;
    term.axis = 1;
    term.coefficient = 2;
    FUZZ_REQUIRE(sb_body_add_constraint(body, &term, 1, (sb_real)0.02, &id, NULL) == SB_OK);
}

/* A body that has been through something. */
static sb_body *fuzz_known_body(int kind, sb_mesh *mesh, sb_recording **recording)
{
    static const double third = 0.3;
    const struct fuzz_known *known = fuzz_known + kind;
    const sb_real g = (sb_real)third, tau = (sb_real)0.1;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_vec3 push = sb_v3((sb_real)0.1, 0, (sb_real)-0.2), fibres[4 * FUZZ_MAX_NODES];
    int far_end, fixed[2] = {0, 1}, split;
    FUZZ_REQUIRE(fuzz_beam(known->type, 1, 1, mesh));
    split = mesh->node_count;
    FUZZ_REQUIRE(!known->rich || fuzz_append_part(known->type, mesh));
    far_end = mesh->node_count - 1;
    for (int e = 0; e < mesh->element_count; e++)
        fibres[e] = sb_v3(1, 1, 0);
    def.mesh = mesh;
    def.material = known->hyperelastic ? sb_material_neo_hookean(1000, g, 1000) : sb_material_corotated(1000, g, 1000);
    if (known->rich && known->hyperelastic) {
        def.material = sb_material_with_prony(sb_material_with_fibres(def.material, 200, 1), &g, &tau, 1);
        def.fibres = fibres;
    }
    def.integration = known->bbar ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
    def.integrator = known->integrator;
    def.max_iterations = 40;
    def.max_substeps = FUZZ_SUBSTEPS;
    FUZZ_REQUIRE(sb_body_create(&def, &body, NULL) == SB_OK);
    if (recording)
        FUZZ_REQUIRE(sb_recording_start(body, 2, NULL, recording, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_body_fix_nodes(body, fixed, 2, SB_XYZ) == SB_OK);
    FUZZ_REQUIRE(sb_body_add_forces(body, &far_end, 1, &push, 1) == SB_OK);
    if (known->rich)
        fuzz_enrich(body, mesh, split);
    for (int i = 0; i < 3; i++)
        fuzz_step(body, (sb_real)0.02);
    FUZZ_REQUIRE(sb_body_set_gravity(body, push) == SB_OK);
    FUZZ_REQUIRE(sb_body_prescribe(body, &far_end, 1, SB_X, &push, 1) == SB_OK);
    fuzz_step(body, (sb_real)0.02);
    return body;
}

/* 1 when the work that a state asks for has a bound that a fuzz target has time for. */
static int fuzz_is_patient(const sb_body *body)
{
    return body->max_iterations <= 100 && body->max_newton <= 50 &&
           (body->integrator != SB_CENTRAL_DIFFERENCE || body->max_substeps <= 100);
}

static void fuzz_state(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_mesh mesh;
    sb_body *body = fuzz_known_body(fuzz_byte(&bytes) % 8, &mesh, NULL);
    uint64_t before = sb_body_state_hash(body);
    size_t length = sb_body_state_size(body);
    unsigned char *image = (unsigned char *)malloc(length);
    sb_error error;
    FUZZ_REQUIRE(image && sb_body_state_save(body, image, length) == SB_OK);
    fuzz_patch_image(&bytes, image, length);
    if (sb_body_state_load(body, image, length, &error) != SB_OK) {
        FUZZ_REQUIRE(error.message[0] && sb_body_state_hash(body) == before);
    } else {
        sb_static_options options = sb_default_static_options();
        options.max_newton = 4;
        options.max_iterations = 40;
        fuzz_check_body(body);
        FUZZ_REQUIRE(sb_body_set_damping(body, 0, 0) == SB_OK);
        FUZZ_REQUIRE(sb_body_set_solver(body, (sb_real)1e-3, 40) == SB_OK); /* the state may ask for endless work */
        body->max_newton = sbi_min_int(body->max_newton, 5);
        body->max_substeps = sbi_min_int(body->max_substeps, FUZZ_SUBSTEPS);
        fuzz_step(body, (sb_real)0.02);
        fuzz_solve(body, &options);
        fuzz_step(body, (sb_real)0.02);
        fuzz_read(body);
    }
    sb_body_state_load(body, data, size, NULL); /* the bytes themselves */
    free(image);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* 1 when a replay will not ask for more work than a fuzz target has time for. */
static int fuzz_is_short(const sb_recording *recording, sb_body *body)
{
    sbi_record_cursor cursor = sbi_record_begin(recording);
    if (sb_body_state_load(body, recording->data + SBI_RECORD_HEAD, recording->state_size, NULL) == SB_OK &&
        !fuzz_is_patient(body))
        return 0;
    for (int i = 0; i < recording->commands && sbi_record_next(&cursor); i++) {
        const unsigned char *ints = cursor.ints;
        if (cursor.rule->code == SBI_COMMAND_STATE ||
            (cursor.rule->code == SBI_COMMAND_SOLVER && cursor.command.a > 100))
            return 0;
        for (int k = 0; cursor.rule->code == SBI_COMMAND_STATIC && k < 3; k++)
            if (sbi_get_bytes(ints + 4 * k, 4) > 50)
                return 0;
    }
    return 1;
}

static void fuzz_record(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_mesh mesh;
    sb_recording *recording = NULL, *loaded = NULL;
    sb_body *body = fuzz_known_body(fuzz_byte(&bytes) % 8, &mesh, &recording);
    size_t length = sb_recording_get_info(recording).bytes;
    unsigned char *image = (unsigned char *)malloc(length);
    sb_recording_report report;
    sb_error error;
    sb_recording_stop(recording);
    FUZZ_REQUIRE(image && sb_recording_save(recording, image, length) == SB_OK);
    FUZZ_REQUIRE(sb_recording_replay(recording, body, &report) == SB_OK && report.step == -1);
    fuzz_patch_image(&bytes, image, length);
    if (sb_recording_load(image, length, NULL, &loaded, &error) != SB_OK) {
        FUZZ_REQUIRE(error.message[0] && !loaded);
    } else if (fuzz_is_short(loaded, body)) {
        sb_result result = sb_recording_replay(loaded, body, &report);
        FUZZ_REQUIRE(report.error.result == result && (result == SB_OK || report.error.message[0]));
        fuzz_check_body(body);
    }
    sb_recording_destroy(loaded);
    loaded = NULL;
    if (sb_recording_load(data, size, NULL, &loaded, NULL) == SB_OK)
        sb_recording_destroy(loaded);
    sb_recording_destroy(recording);
    free(image);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

#endif /* TARGET_BODY_H */
