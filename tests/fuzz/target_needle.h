/* Targets: images of body, remesher and rod with bytes changed; needles driven by bytes. */
#ifndef TARGET_NEEDLE_H
#define TARGET_NEEDLE_H

#include "fuzz.h"

#include "needle.h"

enum { FUZZ_NEEDLE_STEPS = 16, FUZZ_NEEDLES = 2 };

static inline void fuzz_check_pierced(const sb_body *body)
{
    sb_error error;
    int count = sb_body_node_count(body);
    FUZZ_REQUIRE(sb_body_live_check(body, &error) == SB_OK);
    FUZZ_REQUIRE(fuzz_all_finite(sb_body_positions(body), count) && fuzz_all_finite(sb_body_velocities(body), count));
}

/* A block of 3 cm; cells: along each side. */
static inline sb_body *fuzz_make_block(int cells, sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_vec3 size = sb_v3((sb_real)0.03, (sb_real)0.03, (sb_real)0.03);
    FUZZ_REQUIRE(sb_mesh_beam(SB_TET4, cells, cells, cells, size, NULL, mesh, NULL) == SB_OK);
    def.mesh = mesh;
    def.material = sb_material_corotated((sb_real)2e4, (sb_real)0.45, 1000);
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = (sb_real)0.005;
    def.tolerance = (sb_real)1e-4;
    def.slack = (sb_real)0.2;
    FUZZ_REQUIRE(sb_body_create(&def, &body, NULL) == SB_OK);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].z <= 0)
            FUZZ_REQUIRE(sb_body_hold(body, &i, 1, SB_XYZ, NULL) == SB_OK);
    return body;
}

/* ---- states ---- */

/* A remesher at a needle that is half in. */
typedef struct fuzz_patient {
    sb_mesh mesh;
    sb_body *body;
    ndl_remesh *remesh;
    ndl_rod *rod;
    sb_vec3 entry;
} fuzz_patient;

static inline void fuzz_push(const fuzz_patient *p, double from, double to)
{
    for (int i = 1; i <= 3; i++) {
        sb_real depth = (sb_real)(from + (to - from) * i / 3);
        sb_vec3 X = sb_v3_madd(p->entry, -depth, sb_v3((sb_real)0.2, (sb_real)0.1, 1));
        if (to > from)
            (void)ndl_remesh_penetrate(p->remesh, 0, X, NULL, NULL);
        else
            (void)ndl_remesh_retract(p->remesh, 0, X, NULL, NULL);
        (void)sb_body_step(p->body, (sb_real)0.01, NULL);
    }
}

static inline fuzz_patient fuzz_make_patient(void)
{
    fuzz_patient p;
    ndl_remesh_def def = ndl_default_remesh_def();
    ndl_rod_def rod = ndl_default_rod_def();
    ndl_surface_hit hit;
    ndl_remesh_info info;
    sb_vec3 top = sb_v3((sb_real)0.0163, (sb_real)0.0092, (sb_real)0.05), nodes[6];
    memset(&p, 0, sizeof p);
    p.body = fuzz_make_block(1, &p.mesh);
    def.body = p.body;
    def.max_needles = FUZZ_NEEDLES;
    FUZZ_REQUIRE(ndl_remesh_create(&def, &p.remesh, NULL) == SB_OK);
    FUZZ_REQUIRE(ndl_remesh_hit(p.remesh, top, sb_v3(top.x, top.y, 0), &hit));
    FUZZ_REQUIRE(ndl_remesh_puncture(p.remesh, 0, &hit, &info, NULL) == SB_OK);
    p.entry = info.X;
    fuzz_push(&p, 0, 0.018);
    for (int i = 0; i < 6; i++)
        nodes[i] = sb_v3((sb_real)(0.02 * i), (sb_real)(0.0006 * i * i), 0);
    rod.nodes = nodes;
    rod.node_count = 6;
    rod.capacity = 8;
    FUZZ_REQUIRE(ndl_rod_create(&rod, &p.rod, NULL) == SB_OK);
    FUZZ_REQUIRE(ndl_rod_step(p.rod, (sb_real)0.002, NULL) == SB_OK);
    return p;
}

static inline void fuzz_free_patient(fuzz_patient *p)
{
    ndl_rod_destroy(p->rod);
    ndl_remesh_destroy(p->remesh);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

/* kind 0: the body with its remesher, 1: the rod. */
static size_t fuzz_image_size(const fuzz_patient *p, int kind)
{
    return kind == 0 ? sb_body_state_size(p->body) : ndl_rod_state_size(p->rod);
}
static sb_result fuzz_save_image(const fuzz_patient *p, int kind, unsigned char *image, size_t size)
{
    return kind == 0 ? sb_body_state_save(p->body, image, size) : ndl_rod_save(p->rod, image, size, NULL);
}
static sb_result fuzz_load_image(fuzz_patient *p, int kind, const uint8_t *image, size_t size, sb_error *error)
{
    return kind == 0 ? sb_body_state_load(p->body, image, size, error) : ndl_rod_load(p->rod, image, size, error);
}

/* What was taken must live. */
static void fuzz_live(fuzz_patient *p, int kind)
{
    if (kind == 1) {
        (void)ndl_rod_step(p->rod, (sb_real)0.002, NULL);
        (void)ndl_rod_split_edge(p->rod, 3);
        (void)ndl_rod_step(p->rod, (sb_real)0.002, NULL);
        (void)ndl_rod_merge_node(p->rod, 3);
        return;
    }
    fuzz_check_pierced(p->body);
    (void)sb_body_step(p->body, (sb_real)0.01, NULL);
    fuzz_push(p, 0.018, 0.025);
    fuzz_push(p, 0.025, 0.005);
    ndl_remesh_withdraw(p->remesh, 0, NULL, NULL);
    fuzz_check_pierced(p->body);
}

/* The first byte says which image; the others change some of its bytes. All of them as an image, too. */
static void fuzz_needle_state(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    fuzz_patient p = fuzz_make_patient();
    int kind = fuzz_byte(&bytes) % 2;
    size_t length = fuzz_image_size(&p, kind);
    unsigned char *image = (unsigned char *)malloc(length);
    sb_error error;
    FUZZ_REQUIRE(image && fuzz_save_image(&p, kind, image, length) == SB_OK);
    FUZZ_REQUIRE(fuzz_load_image(&p, kind, image, length, NULL) == SB_OK);
    fuzz_patch_image(&bytes, image, length);
    if (fuzz_load_image(&p, kind, image, length, &error) == SB_OK)
        fuzz_live(&p, kind);
    else
        FUZZ_REQUIRE(error.message[0]);
    if (fuzz_load_image(&p, kind, data, size, &error) != SB_OK)
        FUZZ_REQUIRE(error.message[0]);
    free(image);
    fuzz_free_patient(&p);
}

/* ---- programs ---- */

static ndl_needle *fuzz_make_needle(fuzz_bytes *bytes, sb_body *body)
{
    ndl_friction friction = {20, 1, (sb_real)0.3, (sb_real)0.01, (sb_real)0.0005};
    ndl_needle_def def = ndl_default_needle_def();
    ndl_needle *needle = NULL;
    sb_vec3 aim = fuzz_vector(bytes), tilt = fuzz_vector(bytes);
    int kind = fuzz_byte(bytes);
    sb_error error;
    friction.friction = 50 * sb_abs(fuzz_real(bytes));
    def.body = body;
    def.follow = NDL_REMESH;
    def.direction = sb_v3((sb_real)0.5 * tilt.x, (sb_real)0.5 * tilt.y, -1);
    def.base =
        sb_v3((sb_real)(0.015 + 0.012 * (double)aim.x), (sb_real)(0.015 + 0.012 * (double)aim.y), (sb_real)0.072);
    def.length = (sb_real)0.04;
    def.frictions = &friction;
    def.friction_count = 1;
    def.capacity = kind & 1 ? 16 : 64;
    def.bevel.curvature = kind & 2 ? 20 * fuzz_real(bytes) : 0;
    def.entry_slip = kind & 4 ? (sb_real)0.25 * sb_abs(fuzz_real(bytes)) : def.entry_slip;
    def.bend_length = kind & 8 ? (sb_real)0.01 : 0;
    def.bend_curvature = 10;
    ndl_rod_section_preset(kind & 16 ? NDL_NITINOL_083 : NDL_STYLET_18G, &def.section);
    if (ndl_needle_create(&def, &needle, &error) != SB_OK)
        FUZZ_REQUIRE(!needle && error.message[0]);
    return needle;
}

static ndl_command fuzz_needle_command(fuzz_bytes *bytes)
{
    ndl_command command;
    int kind = fuzz_byte(bytes);
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)0.05 * fuzz_real(bytes);
    if (kind & 1)
        command.twist = 10 * fuzz_real(bytes);
    if (kind & 2)
        command.velocity = sb_v3_scale((sb_real)0.02, fuzz_vector(bytes));
    if (kind & 4)
        command.angular_velocity = fuzz_vector(bytes);
    return command;
}

static void fuzz_check_needle(const ndl_needle *needle)
{
    const ndl_rod *rod = ndl_needle_rod(needle);
    sb_vec3 force, torque;
    ndl_needle_base_wrench(needle, &force, &torque);
    FUZZ_REQUIRE(fuzz_all_finite(ndl_rod_positions(rod), ndl_rod_node_count(rod)));
    FUZZ_REQUIRE(sb_v3_is_finite(force) && sb_v3_is_finite(torque));
}

static int fuzz_is_first_mesh(const sb_body *body, const sb_mesh *mesh)
{
    if (sb_body_node_count(body) != mesh->node_count || sb_body_element_count(body) != mesh->element_count)
        return 0;
    for (int t = 0; t < mesh->element_count; t++)
        if (!sb_body_cell_in_use(body, t) ||
            memcmp(sb_body_cell_nodes(body, t), mesh->elements + 4 * (size_t)t, 4 * sizeof(int)) != 0)
            return 0;
    return memcmp(sb_body_rest_positions(body), mesh->nodes, (size_t)mesh->node_count * sizeof(sb_vec3)) == 0;
}

/* Steps of one or two needles; one that fails changes nothing. In the end they go, and the mesh is the first one. */
static void fuzz_needle_program(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_mesh mesh;
    sb_body *body = fuzz_make_block(1 + fuzz_byte(&bytes) % 3, &mesh);
    ndl_needle *needles[FUZZ_NEEDLES];
    int count = 0, wanted = 1 + fuzz_byte(&bytes) % FUZZ_NEEDLES;
    for (int k = 0; k < wanted; k++) {
        needles[count] = fuzz_make_needle(&bytes, body);
        count += needles[count] != NULL;
    }
    for (int i = 0; i < FUZZ_NEEDLE_STEPS && count && !fuzz_is_empty(&bytes); i++) {
        int times = 1 + fuzz_byte(&bytes) % 8;
        sb_real dt = (sb_real)(fuzz_byte(&bytes) % 4 ? 0.02 : 0.2);
        ndl_command commands[FUZZ_NEEDLES];
        for (int k = 0; k < count; k++)
            commands[k] = fuzz_needle_command(&bytes);
        for (int n = 0; n < times; n++) {
            uint64_t before = sb_body_state_hash(body);
            sb_error error;
            if (ndl_step(body, needles, count, dt, commands, NULL, &error) != SB_OK)
                FUZZ_REQUIRE(error.message[0] && sb_body_state_hash(body) == before);
            fuzz_check_pierced(body);
            for (int k = 0; k < count; k++)
                fuzz_check_needle(needles[k]);
        }
    }
    for (int k = 0; k < count; k++)
        ndl_needle_destroy(needles[k]);
    FUZZ_REQUIRE(fuzz_is_first_mesh(body, &mesh));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

#endif /* TARGET_NEEDLE_H */
