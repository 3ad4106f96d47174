/* Images with every number of four bytes changed in turn to values that break things, and the right checksum: a load
 * refuses them, or what it makes is sound: it steps, remeshes and takes the true image back. Meant for sanitizers.
 * CHECK_SLOW=1: every word of every image. */
#include "image.h"
#include "needle_scene.h"

/* What an image belongs to. */
typedef struct forged {
    void *user;
    sb_result (*load)(void *user, const unsigned char *image, size_t size, sb_error *error);
    void (*live)(void *user); /* after a load that was taken */
    const unsigned char *image;
    size_t begin, size; /* what lies before `begin` is left alone */
} forged;

typedef struct counts {
    int refused, taken;
} counts;

static void try_value(const forged *f, unsigned char *copy, size_t at, uint32_t value, counts *sum)
{
    sb_error error;
    sb_result result;
    memcpy(copy, f->image, f->size);
    image_put(copy + at, value, 4);
    if (memcmp(copy, f->image, f->size) == 0)
        return;
    image_seal(copy, f->size);
    result = f->load(f->user, copy, f->size, &error);
    if (result == SB_OK) {
        f->live(f->user);
        sum->taken++;
        CHECK_OK(f->load(f->user, f->image, f->size, NULL));
    } else {
        sum->refused++;
        CHECK(error.result == result && error.message[0]);
    }
}

/* Words of the first bytes, and behind them one in `stride`. */
static counts forge(const forged *f, size_t first, size_t stride)
{
    const uint32_t values[8] = {0xFFFFFFFFu, 0x7FFFFFFFu, 0x80000000u, 0, 1, 0x7FF00000u, 100, 0x40000000u};
    unsigned char *copy = (unsigned char *)malloc(f->size);
    counts sum = {0, 0};
    size_t turn = 0;
    if (getenv("CHECK_SLOW"))
        stride = 1;
    for (size_t at = f->begin; copy && at + 12 <= f->size; at += 4) {
        uint32_t own = (uint32_t)image_number(f->image + at, 4);
        if (at > f->begin + first && (at / 4) % stride != 0)
            continue;
        for (size_t k = 0; k < 8; k++)
            try_value(f, copy, at, values[k], &sum);
        try_value(f, copy, at, own + 1, &sum);
        try_value(f, copy, at, own - 1, &sum);
        try_value(f, copy, at, own ^ 1u << turn++ % 32, &sum);
    }
    free(copy);
    return sum;
}

/* ---- a body whose mesh has changed, and its remesher ---- */

typedef struct patient {
    sb_mesh mesh;
    sb_body *body;
    ndl_remesh *remesh;
    sb_vec3 entry;
    forged as_body, as_remesh;
} patient;

static void drive(patient *p, double from, double to, int must)
{
    for (int i = 1; i <= 4; i++) {
        double depth = from + (to - from) * i / 4;
        sb_vec3 X = sb_v3_madd(p->entry, REAL(-depth), sb_v3(REAL(0.2), REAL(0.1), 1));
        sb_result result = to >= from ? ndl_remesh_penetrate(p->remesh, 0, X, NULL, NULL)
                                      : ndl_remesh_retract(p->remesh, 0, X, NULL, NULL);
        CHECK(!must || result == SB_OK);
        result = sb_body_step(p->body, REAL(0.01), NULL);
        CHECK(!must || result == SB_OK);
    }
}

static sb_result load_changed(void *user, const unsigned char *image, size_t size, sb_error *error)
{
    return sb_body_state_load(((patient *)user)->body, image, size, error);
}

static void check_sound(const patient *p)
{
    sb_error error;
    if (!CHECK_OK(sb_body_live_check(p->body, &error)))
        printf("%s\n", error.message);
}

static void live_changed(void *user)
{
    patient *p = (patient *)user;
    check_sound(p);
    for (int i = 0; i < 2; i++)
        (void)sb_body_step(p->body, REAL(0.01), NULL); /* forces may be anything */
    check_sound(p);
    drive(p, 0.018, 0.021, 0);
    ndl_remesh_withdraw(p->remesh, 0, NULL, NULL);
    check_sound(p);
}

static void live_remesh(void *user)
{
    patient *p = (patient *)user;
    drive(p, 0.018, 0.022, 0);
    check_sound(p);
    drive(p, 0.022, 0.004, 0);
    check_sound(p);
    for (int i = 0; i < 2; i++)
        ndl_remesh_withdraw(p->remesh, i, NULL, NULL);
    check_sound(p);
}

/* The body's image, and in it the remesher's part, which its name begins. */
static int save_patient(patient *p)
{
    size_t size = sb_body_state_size(p->body), at = size > 8 ? size - 8 : 0;
    unsigned char *image = (unsigned char *)malloc(size);
    memset(&p->as_body, 0, sizeof p->as_body);
    p->as_body.user = p;
    p->as_body.load = load_changed;
    p->as_body.live = live_changed;
    p->as_body.image = image;
    p->as_body.begin = 24;
    p->as_body.size = size;
    if (!CHECK_OK(sb_body_state_save(p->body, image, size)))
        return 0;
    while (at > 0 && memcmp(image + at, "mesher\0", 8) != 0)
        at--;
    p->as_remesh = p->as_body;
    p->as_remesh.live = live_remesh;
    p->as_remesh.begin = at + 20; /* behind name, version and size */
    return CHECK(at > 0);
}

/* A small block with one needle deep in and one at its entry. */
static int make_patient(patient *p)
{
    sb_body_def def = needle_scene_body_def();
    ndl_remesh_def remesh = ndl_default_remesh_def();
    memset(p, 0, sizeof *p);
    p->mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(REAL(0.03), REAL(0.02), REAL(0.025)), 0.1);
    def.mesh = &p->mesh;
    def.material = sb_material_corotated(REAL(5e4), REAL(0.45), 1000);
    if (!CHECK_OK(sb_body_create(&def, &p->body, NULL)))
        return 0;
    for (int i = 0; i < p->mesh.node_count; i++)
        if (p->mesh.nodes[i].z < REAL(1e-6))
            CHECK_OK(sb_body_hold(p->body, &i, 1, SB_XYZ, NULL));
    remesh.body = p->body;
    remesh.max_needles = 2;
    if (!CHECK_OK(ndl_remesh_create(&remesh, &p->remesh, NULL)))
        return 0;
    for (int needle = 1; needle >= 0; needle--) {
        ndl_surface_hit hit;
        ndl_remesh_info info;
        sb_vec3 top = sb_v3(needle ? REAL(0.004) : REAL(0.0163), needle ? REAL(0.016) : REAL(0.0092), REAL(0.05));
        if (!CHECK(ndl_remesh_hit(p->remesh, top, sb_v3(top.x, top.y, 0), &hit)) ||
            !CHECK_OK(ndl_remesh_puncture(p->remesh, needle, &hit, &info, NULL)))
            return 0;
        p->entry = info.X;
    }
    drive(p, 0, 0.018, 1);
    CHECK(ndl_remesh_split_count(p->remesh, 0) + ndl_remesh_split_count(p->remesh, 1) > 0);
    return save_patient(p);
}

static void free_patient(patient *p)
{
    ndl_remesh_destroy(p->remesh);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
    free((void *)(uintptr_t)p->as_body.image);
}

static void test_changed_body(void)
{
    check_bad_numbers();
    patient p;
    if (make_patient(&p)) {
        counts sum = forge(&p.as_body, 256, 7);
        CHECK(sum.refused > sum.taken / 4);
        printf("body: %lu bytes, %d refused, %d taken\n", (unsigned long)p.as_body.size, sum.refused, sum.taken);
    }
    free_patient(&p);
}

static void test_remesh(void)
{
    check_bad_numbers();
    patient p;
    if (make_patient(&p)) {
        counts sum = forge(&p.as_remesh, p.as_remesh.size, 1);
        CHECK(sum.refused > 4 * sum.taken);
        printf("remesher: %lu bytes, %d refused, %d taken\n", (unsigned long)(p.as_remesh.size - p.as_remesh.begin),
               sum.refused, sum.taken);
    }
    free_patient(&p);
}

/* A release cursor out of range, by name. */
static void test_cursor(void)
{
    patient p;
    if (make_patient(&p)) {
        unsigned char *copy = (unsigned char *)malloc(p.as_remesh.size);
        size_t cursor = p.as_remesh.begin + 3 * 8 + 8 + 4 * 4; /* behind three doubles, a hash and four ints */
        memcpy(copy, p.as_remesh.image, p.as_remesh.size);
        image_put(copy + cursor, 0x7FFFFFFFu, 4);
        image_seal(copy, p.as_remesh.size);
        CHECK_RESULT(sb_body_state_load(p.body, copy, p.as_remesh.size, NULL), SB_ERROR_FORMAT);
        free(copy);
    }
    free_patient(&p);
}

/* ---- rods ---- */

static sb_result load_rod(void *user, const unsigned char *image, size_t size, sb_error *error)
{
    return ndl_rod_load((ndl_rod *)user, image, size, error);
}

static void live_rod(void *user)
{
    ndl_rod *rod = (ndl_rod *)user;
    (void)ndl_rod_step(rod, REAL(0.002), NULL);
    (void)ndl_rod_split_edge(rod, 3);
    (void)ndl_rod_step(rod, REAL(0.002), NULL);
    (void)ndl_rod_merge_node(rod, 3);
}

static void test_rod(void)
{
    check_bad_numbers();
    sb_vec3 nodes[6];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod = NULL;
    forged f;
    unsigned char *image;
    for (int i = 0; i < 6; i++)
        nodes[i] = sb_v3(REAL(0.02 * i), REAL(0.0006 * i * i), REAL(0.0002 * i));
    def.nodes = nodes;
    def.node_count = 6;
    def.capacity = 8;
    def.rest = NDL_REST_SHAPE;
    if (!CHECK_OK(ndl_rod_create(&def, &rod, NULL)))
        return;
    CHECK_OK(ndl_rod_set_force(rod, 3, sb_v3(0, REAL(0.01), REAL(0.02))));
    CHECK_OK(ndl_rod_step(rod, REAL(0.002), NULL));
    memset(&f, 0, sizeof f);
    f.user = rod;
    f.load = load_rod;
    f.live = live_rod;
    f.begin = 24;
    f.size = ndl_rod_state_size(rod);
    f.image = image = (unsigned char *)malloc(f.size);
    if (CHECK_OK(ndl_rod_save(rod, image, f.size, NULL))) {
        counts sum = forge(&f, 160, 3);
        CHECK(sum.refused > 100);
        printf("rod: %lu bytes, %d refused, %d taken\n", (unsigned long)f.size, sum.refused, sum.taken);
    }
    free(image);
    ndl_rod_destroy(rod);
}

/* ---- bodies, recordings, preconditioners ---- */

static sb_result load_body(void *user, const unsigned char *image, size_t size, sb_error *error)
{
    return sb_body_state_load((sb_body *)user, image, size, error);
}

static void live_body(void *user)
{
    sb_energy energy;
    (void)sb_body_step((sb_body *)user, REAL(0.002), NULL);
    (void)sb_body_energy((sb_body *)user, &energy);
    (void)sb_body_step((sb_body *)user, REAL(0.002), NULL);
}

/* A body with all that a state can hold: pressure, springs, mapping, constraint, Prony terms. */
static sb_body *make_body(sb_mesh *mesh, sb_integrator integrator)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    sb_real share = REAL(0.3), time = REAL(0.1), stiffness = 10;
    int last, face[3], start[2] = {0, 2}, pair[2];
    sb_real weights[2] = {REAL(0.5), REAL(0.5)};
    sb_vec3 goal;
    sb_mapping mapping;
    sb_constraint_term terms[2];
    sb_boundary boundary;
    *mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(REAL(0.04), REAL(0.02), REAL(0.02)), 0);
    last = mesh->node_count - 1;
    def.mesh = mesh;
    def.material = sb_material_with_prony(sb_material_stable_neo_hookean(REAL(2e4), REAL(0.4), 1000), &share, &time, 1);
    def.integrator = integrator;
    def.max_iterations = 50;
    body = scene_body(&def);
    if (!body || !CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL)))
        return body;
    for (int k = 0; k < 3; k++)
        face[k] = boundary.nodes[boundary.surface.elements[k]];
    sb_boundary_free(&boundary);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_pressure(body, face, 1, 3, 10, NULL, NULL));
    goal = mesh->nodes[last];
    CHECK_OK(sb_body_add_springs(body, &last, 1, &stiffness, 1, &goal, NULL, NULL));
    pair[0] = last, pair[1] = last - 1;
    mapping.row_count = 1, mapping.row_start = start, mapping.nodes = pair, mapping.weights = weights;
    CHECK_OK(sb_body_add_mapping(body, &mapping, &stiffness, 1, &goal, NULL, NULL));
    terms[0].node = last, terms[0].axis = 1, terms[0].coefficient = 1;
    terms[1].node = last - 1, terms[1].axis = 1, terms[1].coefficient = -1;
    CHECK_OK(sb_body_add_constraint(body, terms, 2, 0, NULL, NULL));
    CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
    return body;
}

static void forge_body(sb_integrator integrator)
{
    sb_mesh mesh;
    sb_body *body = make_body(&mesh, integrator);
    forged f;
    unsigned char *image;
    memset(&f, 0, sizeof f);
    f.user = body;
    f.load = load_body;
    f.live = live_body;
    f.begin = 24;
    f.size = body ? sb_body_state_size(body) : 0;
    f.image = image = (unsigned char *)malloc(f.size + 1);
    if (body && CHECK_OK(sb_body_state_save(body, image, f.size))) {
        counts sum = forge(&f, 200, 5);
        CHECK(sum.refused > 100);
        printf("body: %lu bytes, %d refused, %d taken\n", (unsigned long)f.size, sum.refused, sum.taken);
    }
    free(image);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_body(void)
{
    check_bad_numbers();
    forge_body(SB_NEWMARK);
    forge_body(SB_GENERALISED_ALPHA);
}

/* A recording is played at once, on one body. */
typedef struct player {
    sb_body *body;
    sb_mesh mesh;
} player;

static sb_result load_recording(void *user, const unsigned char *image, size_t size, sb_error *error)
{
    sb_recording *recording = NULL;
    sb_result result = sb_recording_load(image, size, NULL, &recording, error);
    if (result == SB_OK)
        (void)sb_recording_replay(recording, ((player *)user)->body, NULL);
    sb_recording_destroy(recording);
    return result;
}

static void live_recording(void *user) { live_body(((player *)user)->body); }

static void test_recording(void)
{
    player p;
    sb_mesh mesh;
    sb_body *body = make_body(&mesh, SB_NEWMARK);
    sb_recording *recording = NULL;
    forged f;
    unsigned char *image = NULL;
    size_t state = body ? sb_body_state_size(body) : 0;
    p.body = make_body(&p.mesh, SB_NEWMARK);
    memset(&f, 0, sizeof f);
    if (body && p.body && CHECK_OK(sb_recording_start(body, 1, NULL, &recording, NULL))) {
        sb_vec3 way = sb_v3(0, 0, REAL(0.001));
        int node = mesh.node_count - 3;
        CHECK_OK(sb_body_prescribe(body, &node, 1, SB_Z, &way, 1));
        CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        sb_recording_stop(recording);
        f.user = &p;
        f.load = load_recording;
        f.live = live_recording;
        f.begin = 24;
        f.size = sb_recording_get_info(recording).bytes;
        f.image = image = (unsigned char *)malloc(f.size);
        if (CHECK_OK(sb_recording_save(recording, image, f.size))) {
            counts sum = forge(&f, 48, state / 4 > 60 ? 11 : 3);
            CHECK(sum.refused > 20);
            printf("recording: %lu bytes, %d refused, %d taken\n", (unsigned long)f.size, sum.refused, sum.taken);
        }
    }
    free(image);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(p.body);
    sb_mesh_free(&mesh);
    sb_mesh_free(&p.mesh);
}

CHECK_SUITE(forged, {"a cursor", test_cursor}, {"changed body", test_changed_body}, {"remesher", test_remesh},
            {"rod", test_rod}, {"body", test_body}, {"recording", test_recording});
