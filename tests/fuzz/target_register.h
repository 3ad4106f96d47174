/* Targets: registrations of clouds and bodies from bytes: a cap or an error, never a number that is none. */
#ifndef TARGET_REGISTER_H
#define TARGET_REGISTER_H

#include "fuzz.h"

#include "register.h"

enum { FUZZ_MAX_CLOUD = 60 };

/* Up to 60 points, mostly on a small box; some wild ones where the bytes say so. */
static int fuzz_points(fuzz_bytes *bytes, int wild, sb_vec3 *points)
{
    int count = fuzz_byte(bytes) % FUZZ_MAX_CLOUD;
    for (int i = 0; i < count; i++) {
        if (wild) {
            points[i] = fuzz_vector(bytes);
        } else {
            points[i].x = (sb_real)(fuzz_byte(bytes) - 128) / 128;
            points[i].y = (sb_real)(fuzz_byte(bytes) - 128) / 256;
            points[i].z = (sb_real)(fuzz_byte(bytes) % 2);
        }
    }
    return count;
}

static int fuzz_is_motion(const reg_rigid *m)
{
    for (int i = 0; i < 9; i++)
        if (!sb_is_finite(m->rotation.m[i / 3][i % 3]))
            return 0;
    return sb_v3_is_finite(m->translation);
}

static void fuzz_icp(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_vec3 points[4][FUZZ_MAX_CLOUD];
    sb_real weights[FUZZ_MAX_CLOUD];
    reg_icp_shape model, target;
    reg_icp_options options = reg_default_icp_options();
    reg_icp_landmark landmark;
    reg_rigid motion;
    reg_icp_info info;
    sb_error error;
    sb_result result;
    int kind = fuzz_byte(&bytes), more = fuzz_byte(&bytes);
    memset(&model, 0, sizeof model);
    memset(&target, 0, sizeof target);
    options.overlap = (reg_icp_overlap)(kind % 4);
    options.metric = (reg_icp_metric)(kind / 4 % 2);
    options.search = kind / 8 % 2;
    options.outliers = (reg_outliers)(kind / 16 % 5);
    options.outlier_parameter = more & 1 ? fuzz_real(&bytes) : 3;
    options.max_distance = more & 2 ? fuzz_real(&bytes) : SB_REAL_MAX;
    options.sample = more & 4 ? fuzz_byte(&bytes) : 0;
    options.max_iterations = 5;
    for (int i = 0; i < FUZZ_MAX_CLOUD; i++)
        weights[i] = more & 8 ? sb_abs(fuzz_real(&bytes)) : 1;
    model.count = fuzz_points(&bytes, more & 16, points[0]);
    target.count = fuzz_points(&bytes, more & 16, points[1]);
    model.points = points[0];
    target.points = points[1];
    for (int i = 0; i < FUZZ_MAX_CLOUD && (more & 32); i++) {
        points[2][i] = fuzz_vector(&bytes);
        points[3][i] = fuzz_vector(&bytes);
    }
    model.normals = more & 32 ? points[2] : NULL;
    target.normals = more & 32 ? points[3] : NULL;
    model.weights = more & 8 ? weights : NULL;
    if (more & 64) {
        landmark.model = fuzz_vector(&bytes);
        landmark.target = fuzz_vector(&bytes);
        landmark.weight = fuzz_real(&bytes);
        options.landmarks = &landmark;
        options.landmark_count = 1;
    }
    if (more & 128) {
        target.has_camera = fuzz_byte(&bytes) % 2;
        target.camera = fuzz_vector(&bytes);
        options.start_shift_sd = fuzz_real(&bytes);
        options.start_turn_sd = fuzz_real(&bytes);
        options.seen_from = fuzz_vector(&bytes);
        options.seen_from_sd = fuzz_real(&bytes);
        target.sd = fuzz_byte(&bytes) % 2 ? weights : NULL;
    }
    result = reg_icp(&model, &target, &options, &motion, &info, &error);
    if (result == SB_OK)
        FUZZ_REQUIRE(fuzz_is_motion(&motion) && sb_is_finite(info.mean) && sb_is_finite(info.rms) &&
                     info.pose_count >= 1 && fuzz_is_motion(info.poses + info.pose_count - 1));
    else
        FUZZ_REQUIRE(error.result == result && error.message[0]);
}

static void fuzz_cpd(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_vec3 source[FUZZ_MAX_CLOUD], target[FUZZ_MAX_CLOUD], mark;
    reg_cpd_options options = reg_default_cpd_options();
    reg_cpd *fit = NULL;
    sb_error error;
    sb_result result;
    int kind = fuzz_byte(&bytes), more = fuzz_byte(&bytes), sources, targets, point;
    options.kind = (reg_cpd_kind)(kind % 5);
    options.shared_frame = kind / 8 % 2;
    options.max_iterations = 8;
    if (more & 1)
        options.outliers = sb_abs(fuzz_real(&bytes));
    if (more & 2)
        options.beta = sb_abs(fuzz_real(&bytes));
    if (more & 4)
        options.lambda = 1000 * sb_abs(fuzz_real(&bytes));
    if (more & 8)
        options.start_sigma = sb_abs(fuzz_real(&bytes));
    if (more & 32)
        options.max_rank = fuzz_byte(&bytes) % 8;
    sources = fuzz_points(&bytes, more & 16, source);
    targets = fuzz_points(&bytes, more & 16, target);
    if (more & 64) {
        point = fuzz_byte(&bytes) - 1;
        mark = fuzz_vector(&bytes);
        options.landmark_count = 1;
        options.landmark_points = &point;
        options.landmark_targets = &mark;
        options.landmark_sigma = sb_abs(fuzz_real(&bytes));
    }
    result = reg_cpd_fit(source, sources, target, targets, &options, &fit, &error);
    if (result == SB_OK)
        FUZZ_REQUIRE(fuzz_all_finite(reg_cpd_moved(fit), sources) && sb_is_finite(reg_cpd_get_info(fit).sigma));
    else
        FUZZ_REQUIRE(!fit && error.result == result && error.message[0]);
    reg_cpd_destroy(fit);
}

/* ---- bodies ---- */

/* A small bar, and its skin or a cloud as target, moved as the bytes say. */
typedef struct fuzz_organ {
    sb_mesh mesh, target;
    sb_body *body;
    sb_vec3 cloud[FUZZ_MAX_CLOUD], normals[FUZZ_MAX_CLOUD], landmarks[2], landmark_targets[2];
    int cloud_count, landmark_count, as_cloud, has_normals;
} fuzz_organ;

static void fuzz_free_organ(fuzz_organ *o)
{
    sb_body_destroy(o->body);
    sb_mesh_free(&o->mesh);
    sb_mesh_free(&o->target);
}

static void fuzz_make_organ(fuzz_bytes *bytes, fuzz_organ *o)
{
    sb_body_def def = sb_default_body_def();
    sb_boundary boundary;
    int kind = fuzz_byte(bytes), hold = kind & 1;
    sb_vec3 way = fuzz_vector(bytes);
    memset(o, 0, sizeof *o);
    FUZZ_REQUIRE(sb_mesh_beam(kind & 2 ? SB_HEX8 : SB_TET4, 3, 1, 1, sb_v3(2, 1, 1), NULL, &o->mesh, NULL) == SB_OK);
    def.mesh = &o->mesh;
    def.material = kind & 4 ? sb_material_stable_neo_hookean(1000, (sb_real)0.4, 1000)
                            : sb_material_corotated(1000, (sb_real)0.4, 1000);
    def.max_iterations = 40;
    FUZZ_REQUIRE(sb_body_create(&def, &o->body, NULL) == SB_OK);
    for (int i = 0; i < o->mesh.node_count && hold; i++)
        if (o->mesh.nodes[i].x <= 0)
            FUZZ_REQUIRE(sb_body_fix_nodes(o->body, &i, 1, SB_XYZ) == SB_OK);
    FUZZ_REQUIRE(sb_mesh_boundary(&o->mesh, 1, NULL, &boundary, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_surface_triangulate(&boundary.surface, NULL, &o->target, NULL) == SB_OK);
    sb_boundary_free(&boundary);
    for (int i = 0; i < o->target.node_count; i++)
        o->target.nodes[i] = sb_v3_madd(o->target.nodes[i], (sb_real)0.3 * o->target.nodes[i].x, way);
    for (int k = 0, moves = fuzz_byte(bytes) % 4; k < moves; k++) {
        sb_vec3 *x = o->target.nodes + fuzz_byte(bytes) % o->target.node_count;
        *x = sb_v3_add(*x, fuzz_vector(bytes));
    }
    o->as_cloud = (kind & 8) != 0;
    o->has_normals = (kind & 16) != 0;
    if (o->as_cloud)
        o->cloud_count = fuzz_points(bytes, kind & 32, o->cloud);
    for (int i = 0; i < o->cloud_count && o->has_normals; i++)
        o->normals[i] = fuzz_vector(bytes);
    o->landmark_count = kind / 64 % 3;
    for (int i = 0; i < o->landmark_count; i++) {
        o->landmarks[i] = fuzz_vector(bytes);
        o->landmark_targets[i] = fuzz_vector(bytes);
    }
}

static void fuzz_match(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    fuzz_organ o;
    reg_match_def def = reg_default_match_def();
    reg_match *match = NULL;
    sb_error error;
    int kind;
    fuzz_make_organ(&bytes, &o);
    kind = fuzz_byte(&bytes);
    def.body = o.body;
    def.target = o.as_cloud ? NULL : &o.target;
    def.target_points = o.as_cloud ? o.cloud : NULL;
    def.target_normals = o.as_cloud && o.has_normals ? o.normals : NULL;
    def.target_count = o.cloud_count;
    def.landmarks = o.landmarks;
    def.landmark_targets = o.landmark_targets;
    def.landmark_count = o.landmark_count;
    def.method = (reg_match_method)(kind % 2);
    def.cells = 8;
    def.partial = kind & 2 ? SB_AUTO : kind / 4 % 2;
    def.first_charge = kind & 8 ? 10 * sb_abs(fuzz_real(&bytes)) : def.first_charge;
    def.last_charge = kind & 16 ? 100 * sb_abs(fuzz_real(&bytes)) : def.last_charge;
    if (reg_match_create(&def, &match, &error) != SB_OK)
        FUZZ_REQUIRE(!match && error.message[0]);
    for (int i = 0; match && i < 6; i++) {
        uint64_t before = sb_body_state_hash(o.body);
        reg_match_info info;
        if (reg_match_step(match, &info) != SB_OK)
            FUZZ_REQUIRE(info.error.message[0] && sb_body_state_hash(o.body) == before);
        fuzz_check_body(o.body);
    }
    if (match && (kind & 32)) {
        reg_loads_def loads = reg_default_loads_def();
        reg_loads_info info;
        loads.match = match;
        loads.samples = 30;
        loads.rounds = 2;
        loads.pose = kind & 64 ? (sb_real)0.01 : 0;
        if (reg_loads_run(&loads, NULL, &info) != SB_OK)
            FUZZ_REQUIRE(info.error.message[0]);
        fuzz_check_body(o.body);
    }
    reg_match_destroy(match);
    fuzz_free_organ(&o);
}

static void fuzz_nicp(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    fuzz_organ o;
    reg_nicp_def def = reg_default_nicp_def();
    reg_nicp *nicp = NULL;
    sb_error error;
    int kind;
    fuzz_make_organ(&bytes, &o);
    kind = fuzz_byte(&bytes);
    def.body = o.body;
    def.target = o.as_cloud ? NULL : &o.target;
    def.target_points = o.as_cloud ? o.cloud : NULL;
    def.target_normals = o.as_cloud && o.has_normals ? o.normals : NULL;
    def.target_count = o.cloud_count;
    def.landmarks = o.landmarks;
    def.landmark_targets = o.landmark_targets;
    def.landmark_count = o.landmark_count;
    def.view = (reg_nicp_view)(kind % 4);
    def.camera = fuzz_vector(&bytes);
    def.noisy = kind / 4 % 2;
    def.blending = kind & 8 ? sb_abs(fuzz_real(&bytes)) : def.blending;
    def.sliding = kind & 16 ? sb_abs(fuzz_real(&bytes)) : def.sliding;
    def.first_stiffness = kind & 32 ? 1000 * sb_abs(fuzz_real(&bytes)) : def.first_stiffness;
    if (reg_nicp_create(&def, &nicp, &error) != SB_OK)
        FUZZ_REQUIRE(!nicp && error.message[0]);
    for (int i = 0; nicp && i < 4; i++) {
        reg_nicp_info info;
        if (reg_nicp_step(nicp, &info) != SB_OK)
            FUZZ_REQUIRE(info.error.message[0]);
        fuzz_check_body(o.body);
    }
    reg_nicp_destroy(nicp);
    fuzz_free_organ(&o);
}

#endif /* TARGET_REGISTER_H */
