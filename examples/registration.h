/* registration.h: one registration by any of the methods, for register_liver and insilico: rigid start, matching, and
 * what the motion does to points of the organ. Needs register.h and system.h before it. */
#ifndef REGISTRATION_H
#define REGISTRATION_H

typedef enum method {
    METHOD_PBSM = 0,         /* physics-based shape matching: distance potential */
    METHOD_PBSM_LAPLACE = 1, /* Laplace's potential */
    METHOD_NICP = 2,         /* non-rigid ICP on the elastic body */
    METHOD_ICP = 3,          /* the rigid start alone */
    METHOD_CPD = 4,          /* coherent point drift, which knows of no body */
    METHOD_INFER = 5,        /* loads and pose inferred, with the error to expect */
    METHOD_COUNT = 6
} method;

static const char *const method_names[METHOD_COUNT] = {"pbsm", "pbsm-laplace", "nicp", "icp", "cpd", "infer"};

/* METHOD_COUNT for no such name. */
static inline method method_find(const char *name, size_t length)
{
    int m = 0;
    while (m < METHOD_COUNT && (strlen(method_names[m]) != length || strncmp(method_names[m], name, length) != 0))
        m++;
    return (method)m;
}

/* What a registration is given; everything is borrowed. Zero-initialise. */
typedef struct task {
    const sb_mesh *model;   /* volume mesh (m) */
    const sb_mesh *surface; /* the fine surface it was made from, or NULL: its own boundary is matched */
    const sb_mesh *target;  /* triangles that were seen, or NULL, then: */
    const reg_cloud *cloud;
    int partial; /* 1: the target is a part of the surface */
    int aligned; /* 1: it is in the model's frame already */
    int any;     /* 1: of poses that are about as likely the likelier one is taken; 0: that is an error */
    int linear;  /* 1: a linear material */
    int noisy;
    int facing;       /* 1: which way the target's normals face is not sure: turned where they are found to be */
    int loads;        /* after shape matching: the loads on little of the surface that give that shape */
    const int *fixed; /* [fixed_count] nodes that do not move, but with the whole organ */
    int fixed_count;
    const sb_vec3 *landmarks, *landmark_targets; /* [landmark_count] m */
    int landmark_count;
    const reg_curve *curves; /* [curve_count]; of infer */
    int curve_count;
    const sb_vec3 *camera;    /* m, in the target's frame, or NULL */
    const sb_vec3 *seen_from; /* from the organ to the camera, in the model's frame, within about 30 degrees, or NULL */
    const sb_vec3 *gas;    /* infer: gas may press on what of the skin faces this way, in the model's frame, or NULL */
    double young, poisson; /* Pa */
    int steps;             /* most of them */
    double max_seconds;    /* of the rigid start, and of what follows it */
    void (*progress)(double share, const char *words); /* or NULL */
} task;

/* What came out. Zero-initialise; release with outcome_free. */
typedef struct outcome {
    method how;
    reg_rigid start;      /* model to target */
    reg_icp_info rigid;   /* of the rigid start, or of a look at what is aligned already */
    sb_mesh placed;       /* the model after the start */
    sb_boundary boundary; /* of the placed model */
    sb_mesh seen;         /* the surface that is matched, after the start */
    sb_mesh target;       /* smoothed; or */
    reg_cloud cloud;
    reg_smooth_info smooth; /* what it was like */
    int is_turned;          /* 1: its normals pointed inwards, and were turned */
    int is_placed;          /* 1: the fixed region was seen, and put in its place */
    sb_body *body;          /* of pbsm and nicp */
    reg_cpd *cpd;
    reg_model *organ; /* of infer, */
    reg_infer *infer; /* in the model's frame */
    int iterations;
    double seconds_start, seconds_setup, seconds_run; /* rigid start, what comes before iterations, iterations */
    const char *stop;
} outcome;

static inline void outcome_free(outcome *out)
{
    sb_body_destroy(out->body);
    reg_cpd_destroy(out->cpd);
    reg_infer_destroy(out->infer);
    reg_model_destroy(out->organ);
    sb_mesh_free(&out->seen);
    sb_mesh_free(&out->target);
    reg_cloud_free(&out->cloud);
    sb_boundary_free(&out->boundary);
    sb_mesh_free(&out->placed);
    memset(out, 0, sizeof *out);
}

static inline sb_result task_fail(sb_error *error, sb_result result, const char *message)
{
    memset(error, 0, sizeof *error);
    error->result = result;
    error->element = error->node = -1;
    snprintf(error->message, sizeof error->message, "%s", message);
    return result;
}

static inline void task_show(const task *given, double share, const char *words)
{
    if (given->progress)
        given->progress(share, words);
}

/* ---- the rigid start ------------------------------------------------------------------------------------------- */

/* A shape for reg_icp, and what it is made of. Zero-initialise. */
typedef struct task_shape {
    reg_icp_shape shape;
    reg_cloud cloud;
    sb_surface *tree;
} task_shape;

static inline void task_shape_free(task_shape *s)
{
    reg_cloud_free(&s->cloud);
    sb_surface_destroy(s->tree);
}

static inline sb_result task_shape_of_mesh(const sb_mesh *mesh, task_shape *s, sb_error *error)
{
    sb_result result = reg_cloud_from_mesh(&s->cloud, mesh, NULL, error);
    if (result == SB_OK)
        result = sb_surface_create(mesh, NULL, &s->tree, error);
    s->shape.points = s->cloud.points;
    s->shape.normals = s->cloud.normals;
    s->shape.count = s->cloud.count;
    s->shape.surface = s->tree;
    return result;
}

static inline sb_result task_shape_of_target(const task *given, task_shape *s, sb_error *error)
{
    if (given->target)
        return task_shape_of_mesh(given->target, s, error);
    s->shape.points = given->cloud->points;
    s->shape.normals = given->cloud->normals;
    s->shape.count = given->cloud->count;
    return SB_OK;
}

/* Mean distance (m) of points from a shape after a motion; from the planes through a cloud's points. */
static inline double task_gap(const task_shape *shape, const reg_kdtree *tree, const reg_rigid *motion,
                              const sb_vec3 *points, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++) {
        sb_vec3 at = reg_rigid_apply(motion, points[i]);
        sb_surface_hit hit;
        sb_real squared = 0;
        int nearest;
        if (shape->tree) {
            sum += sb_surface_closest(shape->tree, at, SB_REAL_MAX, &hit) ? (double)hit.distance : 0;
            continue;
        }
        nearest = reg_kdtree_nearest(tree, at, SB_REAL_MAX, &squared);
        if (nearest >= 0 && shape->shape.normals && sb_v3_norm(shape->shape.normals[nearest]) > 0)
            sum +=
                (double)sb_abs(sb_v3_dot(shape->shape.normals[nearest], sb_v3_sub(at, shape->shape.points[nearest])));
        else
            sum += sqrt((double)squared);
    }
    return sum / count;
}

/* 1 when two motions bring a place of an organ of that size (m) to about the same: 15 degrees, a tenth of the size. */
static inline int task_is_near(const reg_rigid *a, const reg_rigid *b, sb_vec3 place, double size)
{
    reg_rigid back = reg_rigid_inverse(a), between = reg_rigid_compose(&back, b);
    sb_vec3 way = sb_v3_sub(reg_rigid_apply(a, place), reg_rigid_apply(b, place));
    return (double)reg_rigid_angle(&between) < 0.26 && (double)sb_v3_norm(way) < 0.1 * size;
}

/* Where the target shows the fixed region, that tells the organ's place better than a deformed whole: among the start,
 * no motion at all, and what ICP of the region makes of either, the one that brings the region nearest, if it is twice
 * as near, nearer than a hundredth of the organ's size, and no other place altogether. points: [count] the region's. */
static inline sb_result task_place_fixed(const task_shape *target, const sb_vec3 *points, int count, double size,
                                         reg_rigid *motion, int *is_placed, sb_error *error)
{
    reg_icp_options options = reg_default_icp_options();
    task_shape region;
    reg_kdtree *tree = NULL;
    reg_rigid best = *motion;
    double least;
    sb_result result = SB_OK;
    memset(&region, 0, sizeof region);
    if (!target->tree)
        result = reg_kdtree_create(target->shape.points, target->shape.count, NULL, &tree, error);
    if (result != SB_OK)
        return result;
    region.shape.points = points;
    region.shape.count = count;
    options.overlap = REG_ICP_MODEL_PART;
    options.search = 0;
    options.outliers = REG_OUTLIERS_TRIM;
    options.outlier_parameter = (sb_real)0.8;
    least = fmin(0.5 * task_gap(target, tree, motion, points, count), 0.01 * size);
    for (int k = 0; k < 4; k++) {
        reg_rigid tried = k % 2 ? *motion : reg_rigid_identity();
        double gap;
        options.start = tried;
        if (k >= 2 && reg_icp(&region.shape, &target->shape, &options, &tried, NULL, NULL) != SB_OK)
            continue;
        gap = task_gap(target, tree, &tried, points, count);
        if (gap < least && task_is_near(motion, &tried, points[0], size)) {
            least = k == 0 ? 0.7 * gap : gap; /* files of one frame are likelier than a small motion */
            best = tried;
            *is_placed = 1;
        }
    }
    reg_kdtree_destroy(tree);
    *motion = best;
    return SB_OK;
}

static inline sb_result task_use_fixed(const task *given, const task_shape *target, const sb_boundary *boundary,
                                       reg_rigid *motion, int *is_placed, sb_error *error)
{
    unsigned char *fixed = (unsigned char *)calloc((size_t)given->model->node_count, 1);
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)given->model->node_count * sizeof *points);
    sb_result result = SB_OK;
    sb_vec3 low, high;
    int count = 0;
    sb_mesh_bounds(given->model, &low, &high);
    if (fixed && points) {
        for (int i = 0; i < given->fixed_count; i++)
            fixed[given->fixed[i]] = 1;
        for (int i = 0; i < boundary->surface.node_count; i++)
            if (fixed[boundary->nodes[i]])
                points[count++] = given->model->nodes[boundary->nodes[i]];
        if (count >= 12)
            result = task_place_fixed(target, points, count, (double)sb_v3_norm(sb_v3_sub(high, low)), motion,
                                      is_placed, error);
    } else {
        result = task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    }
    free(fixed);
    free(points);
    return result;
}

/* Of an aligned task nothing moves: it is looked at only. */
static inline sb_result task_align(const task *given, const task_shape *model, const task_shape *target, outcome *out,
                                   sb_error *error)
{
    reg_icp_options options = reg_default_icp_options();
    reg_icp_landmark *pairs = (reg_icp_landmark *)malloc((size_t)(given->landmark_count + 1) * sizeof *pairs);
    reg_rigid found;
    sb_result result;
    if (!pairs)
        return task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    for (int i = 0; i < given->landmark_count; i++) {
        pairs[i].model = given->landmarks[i];
        pairs[i].target = given->landmark_targets[i];
        pairs[i].weight = (sb_real)fmin(0.3 / given->landmark_count, 0.01); /* they deform, too */
    }
    options.landmarks = pairs;
    /* one or two tell no pose; what deforms the organ afterwards meets them better */
    options.landmark_count = given->landmark_count >= 3 || out->how == METHOD_ICP ? given->landmark_count : 0;
    options.overlap = given->partial ? REG_ICP_TARGET_PART : REG_ICP_WHOLE;
    options.clock = seconds_now;
    options.max_seconds = fmin(options.max_seconds, given->max_seconds);
    if (given->seen_from) {
        options.seen_from = *given->seen_from;
        options.seen_from_sd = (sb_real)0.5;
    }
    if (given->aligned) {
        options.search = 0;
        options.max_iterations = 1;
    }
    result = reg_icp(&model->shape, &target->shape, &options, &found, &out->rigid, error);
    free(pairs);
    if (result != SB_OK || given->aligned)
        return result;
    out->start = found;
    if (out->rigid.stop == REG_ICP_TIME)
        out->stop = "time_cap";
    if (given->fixed_count > 0)
        result = task_use_fixed(given, target, &out->boundary, &out->start, &out->is_placed, error);
    return result;
}

/* What no deformation mends: a target elsewhere, and two poses that explain it about as well. */
static inline sb_result task_check_start(const task *given, const task_shape *model, const outcome *out,
                                         sb_error *error)
{
    const reg_icp_info *rigid = &out->rigid;
    char message[256];
    sb_vec3 low, high, middle;
    double off;
    sb_surface_bounds(model->tree, &low, &high);
    middle = sb_v3_scale((sb_real)0.5, sb_v3_add(low, high));
    off = (double)rigid->mean + (double)sb_v3_norm(sb_v3_sub(reg_rigid_apply(rigid->poses, middle), middle));
    if (given->aligned && off > 0.3 * (double)sb_v3_norm(sb_v3_sub(high, low))) {
        snprintf(message, sizeof message,
                 "the target is some %.3g m from the model: it is not in the model's frame (--aligned)", off);
        return task_fail(error, SB_ERROR_NOT_CONVERGED, message);
    }
    if (!given->aligned && !given->any && !out->is_placed && rigid->stop != REG_ICP_TIME &&
        rigid->warnings & REG_WARN_AMBIGUOUS) {
        reg_rigid back = reg_rigid_inverse(rigid->poses), between = reg_rigid_compose(rigid->poses + 1, &back);
        snprintf(message, sizeof message,
                 "ambiguous: two poses, %.0f degrees and %.1f mm apart, explain the target about as well. Say from "
                 "where it was seen (--camera, --seen-from), give landmarks, or take the likelier one (--any)",
                 57.3 * (double)reg_rigid_angle(&between),
                 1e3 * (double)sb_v3_norm(sb_v3_sub(reg_rigid_apply(rigid->poses, middle),
                                                    reg_rigid_apply(rigid->poses + 1, middle))));
        return task_fail(error, SB_ERROR_NOT_CONVERGED, message);
    }
    return SB_OK;
}

/* ---- which way the target faces ----------------------------------------------------------------------------------
 * Normals that point inwards pair an organ's front with its back: every method then has an answer, centimetres off. */

/* Turns a cloud's normals, where it has any, and a mesh's triangles; either may be empty. */
static inline void target_turn(sb_mesh *target, reg_cloud *cloud)
{
    for (int i = 0; cloud->normals && i < cloud->count; i++)
        cloud->normals[i] = sb_v3_scale(-1, cloud->normals[i]);
    for (int e = 0; e < target->element_count; e++) {
        int *n = target->elements + 3 * (size_t)e, first = n[0];
        n[0] = n[1];
        n[1] = first;
    }
}

static inline void task_turn(outcome *out)
{
    target_turn(&out->target, &out->cloud);
    out->is_turned = !out->is_turned;
}

/* A cloud without normals gets them: across planes through neighbours, to the side to which the model looks there. */
static inline sb_result task_face_model(const task_shape *model, outcome *out, sb_error *error)
{
    reg_rigid back = reg_rigid_inverse(&out->start);
    sb_result result = reg_cloud_estimate_normals(&out->cloud, 12, NULL, NULL, error);
    for (int i = 0; result == SB_OK && i < out->cloud.count; i++) {
        sb_vec3 *normal = out->cloud.normals + i;
        sb_surface_hit hit;
        sb_surface_closest(model->tree, reg_rigid_apply(&back, out->cloud.points[i]), SB_REAL_MAX, &hit);
        if (sb_v3_dot(sb_surface_normal(model->tree, &hit), sb_m3_apply(back.rotation, *normal)) < 0)
            *normal = sb_v3_scale(-1, *normal);
    }
    return result;
}

/* The rigid start, and which way the target faces. */
static inline sb_result task_align_facing(const task *given, const task_shape *model, outcome *out, sb_error *error)
{
    task_shape target;
    sb_result result;
    memset(&target, 0, sizeof target);
    result = task_shape_of_target(given, &target, error);
    if (given->camera) {
        target.shape.has_camera = 1;
        target.shape.camera = *given->camera;
    }
    if (result == SB_OK) {
        task_show(given, 0, "rigid start");
        result = task_align(given, model, &target, out, error);
    }
    task_shape_free(&target);
    if (result == SB_OK)
        result = task_check_start(given, model, out, error);
    if (result == SB_OK && given->facing && out->rigid.warnings & REG_WARN_INVERTED)
        task_turn(out);
    if (result == SB_OK && given->cloud && !given->cloud->normals && given->cloud->count > 3)
        result = task_face_model(model, out, error);
    return result;
}

/* ---- a smooth skin for a coarse model ---------------------------------------------------------------------------
 * A coarse mesh cuts the corners of a round organ, its nodes lie on it. Curved point-normal triangles (Vlachos et al.
 * 2001) through the nodes are much nearer to what a scan shows than the mesh's facets. */

/* Corner triangles of a boundary whose edges are straight; 0 elements where they are not, or there are quads. */
static inline sb_result skin_corners(const sb_mesh *boundary, sb_mesh *corners, sb_error *error)
{
    int stride = boundary->element_type == SB_TRI6 ? 6 : 3;
    sb_result result = sb_mesh_copy(boundary, NULL, corners, error);
    int straight = boundary->element_type == SB_TRI3 || boundary->element_type == SB_TRI6;
    for (int e = 0; result == SB_OK && e < boundary->element_count && straight; e++) {
        const int *n = boundary->elements + (size_t)stride * (size_t)e;
        for (int c = 0; c < 3; c++) {
            sb_vec3 a = boundary->nodes[n[c]], b = boundary->nodes[n[(c + 1) % 3]];
            sb_vec3 middle = sb_v3_scale((sb_real)0.5, sb_v3_add(a, b));
            corners->elements[3 * (size_t)e + (size_t)c] = n[c];
            if (stride == 6 &&
                sb_v3_norm(sb_v3_sub(boundary->nodes[n[3 + c]], middle)) > (sb_real)1e-4 * sb_v3_norm(sb_v3_sub(b, a)))
                straight = 0;
        }
    }
    if (result == SB_OK)
        corners->element_type = SB_TRI3;
    if (result == SB_OK && !straight)
        corners->element_count = 0;
    return result;
}

static inline sb_vec3 skin_control(sb_vec3 a, sb_vec3 b, sb_vec3 normal, sb_vec3 other)
{
    sb_real lift = sb_v3_dot(normal, other) > (sb_real)0.3 ? sb_v3_dot(sb_v3_sub(b, a), normal) : 0; /* no crease */
    return sb_v3_scale((sb_real)(1.0 / 3), sb_v3_madd(sb_v3_add(sb_v3_scale(2, a), b), -lift, normal));
}

/* Point of the curved triangle with corners p and unit normals n at (u, v, w), which sum to 1. */
static inline sb_vec3 skin_point(const sb_vec3 p[3], const sb_vec3 n[3], double u, double v, double w)
{
    const double at[3] = {u, v, w};
    sb_vec3 sum = sb_v3(0, 0, 0), edges = sum, centre;
    for (int i = 0; i < 3; i++) {
        sum = sb_v3_madd(sum, (sb_real)(at[i] * at[i] * at[i]), p[i]);
        for (int j = 0; j < 3; j++)
            if (j != i) {
                sb_vec3 control = skin_control(p[i], p[j], n[i], n[j]);
                edges = sb_v3_add(edges, control);
                sum = sb_v3_madd(sum, (sb_real)(3 * at[i] * at[i] * at[j]), control);
            }
    }
    edges = sb_v3_scale((sb_real)(1.0 / 6), edges);
    centre = sb_v3_scale((sb_real)(1.0 / 3), sb_v3_add(sb_v3_add(p[0], p[1]), p[2]));
    centre = sb_v3_madd(edges, (sb_real)0.5, sb_v3_sub(edges, centre));
    return sb_v3_madd(sum, (sb_real)(6 * u * v * w), centre);
}

/* Unit normals of the nodes, by angles times areas of the faces. */
static inline void skin_normals(const sb_mesh *corners, sb_vec3 *normals)
{
    memset(normals, 0, (size_t)corners->node_count * sizeof *normals);
    for (int e = 0; e < corners->element_count; e++) {
        const int *n = corners->elements + 3 * (size_t)e;
        sb_vec3 ab = sb_v3_sub(corners->nodes[n[1]], corners->nodes[n[0]]);
        sb_vec3 normal = sb_v3_cross(ab, sb_v3_sub(corners->nodes[n[2]], corners->nodes[n[0]]));
        for (int c = 0; c < 3; c++)
            normals[n[c]] = sb_v3_add(normals[n[c]], normal);
    }
    for (int i = 0; i < corners->node_count; i++) {
        sb_real length = sb_v3_norm(normals[i]);
        normals[i] = sb_v3_scale(length > 0 ? 1 / length : 0, normals[i]);
    }
}

/* The nodes and triangles of one curved triangle, cut into cuts x cuts; appended. */
static inline void skin_cut(const sb_mesh *corners, const sb_vec3 *normals, int e, int cuts, sb_mesh *skin)
{
    const int *c = corners->elements + 3 * (size_t)e;
    int first = skin->node_count, row = first;
    sb_vec3 p[3], n[3];
    for (int k = 0; k < 3; k++)
        p[k] = corners->nodes[c[k]], n[k] = normals[c[k]];
    for (int i = 0; i <= cuts; i++)
        for (int j = 0; j <= cuts - i; j++)
            skin->nodes[skin->node_count++] =
                skin_point(p, n, (double)(cuts - i - j) / cuts, (double)j / cuts, (double)i / cuts);
    for (int i = 0; i < cuts; row += cuts + 1 - i, i++)
        for (int j = 0; j < cuts - i; j++) {
            int below = row + j, above = row + cuts + 1 - i + j;
            int *t = skin->elements + 3 * (size_t)skin->element_count++;
            t[0] = below, t[1] = below + 1, t[2] = above;
            if (j < cuts - i - 1) {
                t = skin->elements + 3 * (size_t)skin->element_count++;
                t[0] = below + 1, t[1] = above + 1, t[2] = above;
            }
        }
}

enum { SKIN_TRIANGLES = 10000 };

/* The skin, welded. Boundaries of quads and curved faces come out as their triangulation. */
static inline sb_result task_make_skin(const sb_mesh *boundary, sb_mesh *skin, sb_error *error)
{
    sb_mesh corners;
    sb_vec3 *normals;
    sb_result result;
    int cuts = 1, merged;
    memset(&corners, 0, sizeof corners);
    if (boundary->element_type != SB_TRI3 && boundary->element_type != SB_TRI6)
        return sb_surface_triangulate(boundary, NULL, skin, error);
    result = skin_corners(boundary, &corners, error);
    if (result != SB_OK || corners.element_count == 0 || corners.element_count > SKIN_TRIANGLES / 4) {
        sb_mesh_free(&corners);
        return result != SB_OK ? result : sb_surface_triangulate(boundary, NULL, skin, error);
    }
    while (cuts < 6 && corners.element_count * (cuts + 1) * (cuts + 1) <= SKIN_TRIANGLES)
        cuts++;
    memset(skin, 0, sizeof *skin);
    skin->element_type = SB_TRI3;
    skin->nodes =
        (sb_vec3 *)malloc((size_t)(corners.element_count * (cuts + 1) * (cuts + 2) / 2) * sizeof *skin->nodes);
    skin->elements = (int *)malloc((size_t)(corners.element_count * cuts * cuts) * 3 * sizeof *skin->elements);
    normals = (sb_vec3 *)malloc((size_t)corners.node_count * sizeof *normals);
    if (!skin->nodes || !skin->elements || !normals)
        result = task_fail(error, SB_ERROR_MEMORY, "not enough memory for the skin");
    if (result == SB_OK)
        skin_normals(&corners, normals);
    for (int e = 0; result == SB_OK && e < corners.element_count; e++)
        skin_cut(&corners, normals, e, cuts, skin);
    if (result == SB_OK)
        result = sb_mesh_merge_nodes(skin, -1, &merged, error);
    if (result == SB_OK)
        result = sb_mesh_remove_unreferenced(skin, &merged, error);
    free(normals);
    sb_mesh_free(&corners);
    if (result != SB_OK)
        sb_mesh_free(skin);
    return result;
}

/* Moves all that the start placed. */
static inline void task_place(outcome *out, const reg_rigid *motion)
{
    out->start = reg_rigid_compose(motion, &out->start);
    for (int i = 0; i < out->placed.node_count; i++)
        out->placed.nodes[i] = reg_rigid_apply(motion, out->placed.nodes[i]);
    for (int i = 0; i < out->seen.node_count; i++)
        out->seen.nodes[i] = reg_rigid_apply(motion, out->seen.nodes[i]);
}

/* out->start, out->placed, out->boundary and out->seen. */
static inline sb_result task_start(const task *given, outcome *out, sb_error *error)
{
    task_shape model;
    const sb_mesh *surface;
    sb_result result = sb_mesh_copy(given->model, NULL, &out->placed, error);
    memset(&model, 0, sizeof model);
    out->start = reg_rigid_identity();
    if (result == SB_OK)
        result = sb_mesh_boundary(given->model, 1, NULL, &out->boundary, error);
    surface = given->surface ? given->surface : &out->boundary.surface;
    if (result == SB_OK) {
        result = task_shape_of_mesh(surface, &model, error);
        if (result == SB_OK)
            result = task_align_facing(given, &model, out, error);
    }
    task_shape_free(&model);
    if (result == SB_OK)
        result = given->surface ? sb_surface_triangulate(surface, NULL, &out->seen, error)
                                : task_make_skin(surface, &out->seen, error);
    if (result == SB_OK) {
        reg_rigid start = out->start;
        out->start = reg_rigid_identity();
        task_place(out, &start);
    }
    return result;
}

/* ---- elastic methods ------------------------------------------------------------------------------------------- */

static inline sb_result task_make_body(const task *given, outcome *out, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_real young = (sb_real)given->young, poisson = (sb_real)given->poisson;
    sb_result result;
    def.mesh = &out->placed;
    def.material =
        given->linear ? sb_material_linear(young, poisson, 1060) : sb_material_corotated(young, poisson, 1060);
    result = sb_body_create(&def, &out->body, error);
    if (result == SB_OK && given->fixed_count > 0 &&
        sb_body_fix_nodes(out->body, given->fixed, given->fixed_count, SB_XYZ) != SB_OK)
        result = task_fail(error, SB_ERROR_MEMORY, "not enough memory for the fixed nodes");
    return result;
}

/* Landmarks after the start; NULL without memory. */
static inline sb_vec3 *task_landmarks(const task *given, const outcome *out)
{
    sb_vec3 *placed = (sb_vec3 *)malloc((size_t)(given->landmark_count + 1) * sizeof *placed);
    for (int i = 0; placed && i < given->landmark_count; i++)
        placed[i] = reg_rigid_apply(&out->start, given->landmarks[i]);
    return placed;
}

static inline const char *match_stop_name(reg_match_stop stop)
{
    switch (stop) {
    case REG_MATCH_RUNNING: return "step_cap";
    case REG_MATCH_SETTLED: return "settled";
    case REG_MATCH_STEP_CAP: return "step_cap";
    case REG_MATCH_TIME_CAP: return "time_cap";
    case REG_MATCH_NO_OVERLAP: return "no_overlap";
    case REG_MATCH_FAILED: return "failed";
    }
    return "unknown";
}

static inline const char *nicp_stop_name(reg_nicp_stop stop)
{
    switch (stop) {
    case REG_NICP_RUNNING: return "step_cap";
    case REG_NICP_CONVERGED: return "converged";
    case REG_NICP_INCREMENTS: return "increments";
    case REG_NICP_STEP_CAP: return "step_cap";
    case REG_NICP_TIME_CAP: return "time_cap";
    case REG_NICP_NO_OVERLAP: return "no_overlap";
    case REG_NICP_FAILED: return "failed";
    }
    return "unknown";
}

static inline sb_result task_run_match(const task *given, reg_match *match, outcome *out, sb_error *error)
{
    reg_match_info info = reg_match_get_info(match);
    sb_result result = SB_OK;
    char words[64];
    for (int i = 0; result == SB_OK && i < given->steps; i++) {
        result = reg_match_run(match, 1, &info);
        snprintf(words, sizeof words, "step %d, %.3f mm from the target", i + 1, 1e3 * (double)info.mean_distance);
        task_show(given, (double)(i + 1) / 40, words);
        if (info.stop != REG_MATCH_STEP_CAP)
            break;
    }
    out->iterations = info.iterations;
    out->stop = match_stop_name(info.stop);
    if (result != SB_OK)
        *error = info.error;
    return result;
}

static inline sb_result task_soften(const task *given, sb_body *body, int hyperelastic)
{
    sb_real young = (sb_real)given->young, poisson = (sb_real)given->poisson;
    sb_material tissue =
        hyperelastic ? sb_material_neo_hookean(young, poisson, 1060) : sb_material_corotated(young, poisson, 1060);
    return sb_body_set_material(body, &tissue, NULL);
}

static inline reg_loads_def task_loads_def(const task *given, const outcome *out, reg_match *match)
{
    reg_loads_def def = reg_default_loads_def();
    sb_vec3 low, high;
    sb_real left;
    sb_mesh_bounds(&out->placed, &low, &high);
    left = out->smooth.left / sb_v3_norm(sb_v3_sub(high, low));
    def.match = match;
    def.clock = seconds_now;
    def.max_seconds = given->max_seconds - out->seconds_run;
    if (out->smooth.noise > out->smooth.left) /* there was noise; samples are means of some 25 points */
        def.misfit = sb_sqrt(def.misfit * def.misfit + (sb_real)0.04 * left * left);
    if (given->fixed_count == 0 || (!given->aligned && !out->is_placed))
        def.pose = (sb_real)0.01;
    return def;
}

/* What a surface shows of motion along itself. 0 where that is not the work of loads on little of it: rounds then do
 * not come to rest, and the match stays as it is. */
static inline int task_find_loads(const task *given, reg_match *match, outcome *out)
{
    reg_loads_def def = task_loads_def(given, out, match);
    size_t n = (size_t)out->placed.node_count;
    sb_vec3 *before = (sb_vec3 *)malloc(n * sizeof *before), low, high;
    reg_loads_info info;
    double begun = seconds_now();
    int found = 0;
    task_show(given, 0.9, "loads on the surface");
    sb_mesh_bounds(&out->placed, &low, &high);
    if (before && def.max_seconds > 0) {
        memcpy(before, sb_body_displacements(out->body), n * sizeof *before);
        found = task_soften(given, out->body, 1) == SB_OK && reg_loads_run(&def, NULL, &info) == SB_OK &&
                info.change < (sb_real)0.01 * sb_v3_norm(sb_v3_sub(high, low));
        if (!found) {
            (void)sb_body_set_displacements(out->body, before);
            (void)sb_body_fix_nodes(out->body, given->fixed, given->fixed_count, SB_XYZ); /* loads move them, too */
            (void)task_soften(given, out->body, 0);
        }
    }
    free(before);
    out->seconds_setup += seconds_now() - begun;
    return found;
}

static inline reg_match_def task_match_def(const task *given, const outcome *out, const sb_vec3 *landmarks)
{
    reg_match_def def = reg_default_match_def();
    def.body = out->body;
    def.surface = &out->seen;
    def.target = given->target;
    def.target_points = given->target ? NULL : given->cloud->points;
    def.target_normals = given->target ? NULL : given->cloud->normals;
    def.target_count = given->target ? 0 : given->cloud->count;
    def.method = out->how == METHOD_PBSM_LAPLACE ? REG_PBSM_LAPLACE : REG_PBSM;
    def.partial = given->partial;
    if (given->noisy) /* a firm charge presses noise into the shape */
        def.last_charge = 2;
    def.landmarks = landmarks;
    def.landmark_targets = given->landmark_targets;
    def.landmark_count = given->landmark_count;
    def.clock = seconds_now;
    def.max_seconds = given->max_seconds;
    return def;
}

/* Steps of a match up to the charge; *match is the caller's. */
static inline sb_result task_match_up_to(const task *given, const reg_match_def *def, outcome *out, reg_match **match,
                                         sb_error *error)
{
    double begun = seconds_now(), made;
    sb_result result = reg_match_create(def, match, error);
    made = seconds_now();
    if (result == SB_OK)
        result = task_run_match(given, *match, out, error);
    out->seconds_setup += made - begun;
    out->seconds_run += seconds_now() - made;
    return result;
}

/* Loads begin with a shape that is not pressed on: a firm charge leaves elements that they cannot bear, and landmarks'
 * springs dents. Where there are none the firm charge follows; with landmarks, which lead the way, from the
 * beginning. */
static inline sb_result task_match(const task *given, outcome *out, sb_error *error)
{
    sb_vec3 *landmarks = task_landmarks(given, out);
    reg_match_def firm = task_match_def(given, out, landmarks), soft = firm;
    int wants_loads = given->loads && out->how == METHOD_PBSM, found = 0;
    int led = landmarks && given->landmark_count > 0;
    reg_match *match = NULL;
    sb_result result = landmarks ? SB_OK : task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    if (wants_loads) {
        soft.last_charge = 2;
        soft.landmark_stiffness *= (sb_real)1e-4;
    }
    if (result == SB_OK)
        result = task_match_up_to(given, &soft, out, &match, error);
    if (result == SB_OK && wants_loads && strcmp(out->stop, "settled") == 0)
        found = task_find_loads(given, match, out);
    reg_match_destroy(match);
    match = NULL;
    if (wants_loads && !found && (led || (result == SB_OK && firm.last_charge > soft.last_charge))) {
        int before = out->iterations;
        if (led) {
            sb_body_reset(out->body);
        } else {
            firm.first_charge = 2;
            firm.reach = firm.last_reach;
        }
        result = task_match_up_to(given, &firm, out, &match, error);
        out->iterations += before;
        reg_match_destroy(match);
    }
    free(landmarks);
    return result;
}

static inline sb_result task_run_nicp(const task *given, reg_nicp *nicp, outcome *out, sb_error *error)
{
    reg_nicp_info info = reg_nicp_get_info(nicp);
    sb_result result = SB_OK;
    char words[64];
    for (int i = 0; result == SB_OK && i < given->steps; i++) {
        result = reg_nicp_run(nicp, 1, &info);
        snprintf(words, sizeof words, "look %d, %.3f mm from the target", i + 1, 1e3 * (double)info.mean_distance);
        task_show(given, (double)(i + 1) / 8, words);
        if (info.stop != REG_NICP_STEP_CAP)
            break;
    }
    out->iterations = info.iterations;
    out->stop = nicp_stop_name(info.stop);
    if (result != SB_OK)
        *error = info.error;
    return result;
}

static inline sb_result task_nicp(const task *given, outcome *out, sb_error *error)
{
    reg_nicp_def def = reg_default_nicp_def();
    sb_vec3 *landmarks = task_landmarks(given, out);
    reg_nicp *nicp = NULL;
    double begun = seconds_now(), made;
    sb_result result;
    def.body = out->body;
    def.surface = &out->seen;
    def.target = given->target;
    def.target_points = given->target ? NULL : given->cloud->points;
    def.target_normals = given->target ? NULL : given->cloud->normals;
    def.target_count = given->target ? 0 : given->cloud->count;
    def.noisy = given->noisy;
    if (given->noisy) {
        def.first_stiffness = 100;
        def.last_stiffness = 1000;
    }
    def.landmarks = landmarks;
    def.landmark_targets = given->landmark_targets;
    def.landmark_count = given->landmark_count;
    def.clock = seconds_now;
    def.max_seconds = given->max_seconds;
    result = landmarks ? reg_nicp_create(&def, &nicp, error) : task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    made = seconds_now();
    if (result == SB_OK)
        result = task_run_nicp(given, nicp, out, error);
    out->seconds_setup += made - begun;
    out->seconds_run = seconds_now() - made;
    reg_nicp_destroy(nicp);
    free(landmarks);
    return result;
}

/* ---- coherent point drift -------------------------------------------------------------------------------------- */

enum { TASK_CPD_POINTS = 2000 }; /* of either side: its cost grows with their product */

/* `most` points or all, evenly spread: points[most]; their number, or -1 without memory. Of clouds much larger than
 * that every so many points is looked at. */
static inline int task_spread(const sb_vec3 *from, int count, int most, sb_vec3 *points)
{
    int stride = 1 + count / (20 * most), few = (count - 1) / stride + 1, kept = -1;
    int *chosen = (int *)malloc((size_t)most * sizeof *chosen);
    sb_real *scratch = (sb_real *)malloc((size_t)few * sizeof *scratch);
    sb_vec3 *some = (sb_vec3 *)malloc((size_t)few * sizeof *some);
    if (chosen && scratch && some) {
        for (int i = 0; i < few; i++)
            some[i] = from[(size_t)i * (size_t)stride];
        kept = reg_cloud_spread(some, few, most < few ? most : few, chosen, scratch);
    }
    for (int i = 0; i < kept; i++)
        points[i] = some[chosen[i]];
    free(chosen);
    free(scratch);
    free(some);
    return kept;
}

typedef struct task_cpd_watch {
    const task *given;
} task_cpd_watch;

static inline int task_cpd_progress(void *user, const reg_cpd_info *info)
{
    const task *given = ((task_cpd_watch *)user)->given;
    char words[64];
    snprintf(words, sizeof words, "iteration %d, sigma %.3f mm", info->iterations, 1e3 * (double)info->sigma);
    task_show(given, (double)info->iterations / 150, words);
    return 0;
}

static inline const char *cpd_stop_name(reg_cpd_stop stop)
{
    switch (stop) {
    case REG_CPD_CONVERGED: return "converged";
    case REG_CPD_EXACT: return "exact";
    case REG_CPD_ITERATIONS: return "step_cap";
    case REG_CPD_TIME: return "time_cap";
    }
    return "unknown";
}

/* beta and lambda as tuned for livers; landmarks are points of the source, too. */
static inline sb_result task_fit_cpd(const task *given, outcome *out, sb_vec3 *source, int source_count,
                                     const sb_vec3 *target, int target_count, int *numbers, sb_error *error)
{
    reg_cpd_options options = reg_default_cpd_options();
    task_cpd_watch watch;
    reg_cpd_info info;
    sb_vec3 low, high;
    sb_result result;
    watch.given = given;
    sb_mesh_bounds(&out->placed, &low, &high);
    for (int i = 0; i < given->landmark_count; i++) {
        numbers[i] = source_count;
        source[source_count++] = reg_rigid_apply(&out->start, given->landmarks[i]);
    }
    options.beta = (sb_real)0.7;
    options.lambda = 1000;
    options.shared_frame = 1;
    options.start_sigma = (sb_real)0.05 * sb_v3_norm(sb_v3_sub(high, low));
    options.tolerance = (sb_real)1e-4;
    options.landmark_points = numbers;
    options.landmark_targets = given->landmark_targets;
    options.landmark_count = given->landmark_count;
    options.landmark_sigma = (sb_real)0.003 * sb_v3_norm(sb_v3_sub(high, low));
    options.max_iterations = given->steps;
    options.max_seconds = given->max_seconds;
    options.clock = seconds_now;
    options.progress = task_cpd_progress;
    options.progress_user = &watch;
    result = reg_cpd_fit(source, source_count, target, target_count, &options, &out->cpd, error);
    if (result != SB_OK)
        return result;
    info = reg_cpd_get_info(out->cpd);
    out->iterations = info.iterations;
    out->stop = cpd_stop_name(info.stop);
    out->seconds_setup = info.kernel_seconds;
    out->seconds_run = info.seconds - info.kernel_seconds;
    return SB_OK;
}

static inline sb_result task_cpd(const task *given, outcome *out, sb_error *error)
{
    size_t extra = (size_t)given->landmark_count + 1;
    sb_vec3 *source = (sb_vec3 *)malloc(((size_t)TASK_CPD_POINTS + extra) * sizeof *source);
    sb_vec3 *target = (sb_vec3 *)malloc((size_t)TASK_CPD_POINTS * sizeof *target);
    int *numbers = (int *)malloc(extra * sizeof *numbers), sources = -1, targets = -1;
    sb_result result;
    if (source && target && numbers) {
        sources = task_spread(out->seen.nodes, out->seen.node_count, TASK_CPD_POINTS, source);
        targets = given->target ? task_spread(given->target->nodes, given->target->node_count, TASK_CPD_POINTS, target)
                                : task_spread(given->cloud->points, given->cloud->count, TASK_CPD_POINTS, target);
    }
    result = sources < 0 || targets < 0 ? task_fail(error, SB_ERROR_MEMORY, "not enough memory")
                                        : task_fit_cpd(given, out, source, sources, target, targets, numbers, error);
    free(source);
    free(target);
    free(numbers);
    return result;
}

/* ---- inference -------------------------------------------------------------------------------------------------- */

static inline const char *infer_stop_name(reg_infer_stop stop)
{
    return stop == REG_INFER_CAPPED ? "time_cap" : reg_infer_stop_string(stop);
}

/* out->organ, of the model at rest and of the surface that is matched. */
static inline sb_result task_make_organ(const task *given, outcome *out, sb_error *error)
{
    reg_model_def def = reg_default_model_def();
    reg_rigid back = reg_rigid_inverse(&out->start);
    sb_mesh rest;
    sb_result result = sb_mesh_copy(&out->seen, NULL, &rest, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < rest.node_count; i++)
        rest.nodes[i] = reg_rigid_apply(&back, rest.nodes[i]);
    def.mesh = given->model;
    def.surface = &rest;
    def.poisson = (sb_real)given->poisson;
    def.fixed = given->fixed;
    def.fixed_count = given->fixed_count;
    result = reg_model_create(&def, &out->organ, error);
    sb_mesh_free(&rest);
    return result;
}

/* Landmarks are known to half a hundredth of the organ's size. */
static inline reg_landmark *task_infer_landmarks(const task *given)
{
    reg_landmark *marks = (reg_landmark *)malloc((size_t)(given->landmark_count + 1) * sizeof *marks);
    sb_vec3 low, high;
    sb_mesh_bounds(given->model, &low, &high);
    for (int i = 0; marks && i < given->landmark_count; i++) {
        marks[i].model = given->landmarks[i];
        marks[i].seen = given->landmark_targets[i];
        marks[i].sd = (sb_real)0.005 * sb_v3_norm(sb_v3_sub(high, low));
    }
    return marks;
}

/* Of each node of the model 1 where its skin faces the gas, else 0; NULL: not enough memory. */
static inline sb_real *task_find_pressed(const task *given)
{
    size_t n = (size_t)given->model->node_count;
    sb_real *pressed = (sb_real *)calloc(n + 1, sizeof *pressed);
    sb_vec3 *normals = (sb_vec3 *)calloc(n + 1, sizeof *normals);
    sb_boundary skin;
    int made = pressed && normals && sb_mesh_boundary(given->model, 1, NULL, &skin, NULL) == SB_OK;
    for (int e = 0; made && e < skin.surface.element_count; e++) {
        int width = sb_mesh_element_width(&skin.surface);
        const int *facet = skin.surface.elements + (size_t)e * (size_t)width;
        sb_vec3 x = skin.surface.nodes[facet[0]];
        sb_vec3 area =
            sb_v3_cross(sb_v3_sub(skin.surface.nodes[facet[1]], x), sb_v3_sub(skin.surface.nodes[facet[2]], x));
        for (int a = 0; a < width; a++)
            normals[skin.nodes[facet[a]]] = sb_v3_add(normals[skin.nodes[facet[a]]], area);
    }
    for (size_t i = 0; made && i < n; i++)
        pressed[i] = (sb_real)(sb_v3_dot(normals[i], *given->gas) > 0);
    if (made) {
        sb_boundary_free(&skin);
    } else {
        free(pressed);
        pressed = NULL;
    }
    free(normals);
    return pressed;
}

static inline sb_result task_infer(const task *given, outcome *out, sb_error *error)
{
    reg_infer_def def = reg_default_infer_def();
    reg_landmark *marks = task_infer_landmarks(given);
    sb_real *pressed = given->gas ? task_find_pressed(given) : NULL;
    reg_quality quality;
    double begun = seconds_now();
    sb_result result = marks && (pressed || !given->gas) ? task_make_organ(given, out, error)
                                                         : task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    out->seconds_setup = seconds_now() - begun;
    def.model = out->organ;
    def.target.surface = given->target;
    if (!given->target) {
        def.target.points = given->cloud->points;
        def.target.normals = given->cloud->normals;
        def.target.count = given->cloud->count;
    }
    def.target.has_camera = given->camera != NULL;
    if (given->camera)
        def.target.camera = *given->camera;
    def.landmarks = marks;
    def.landmark_count = given->landmark_count;
    def.curves = given->curves;
    def.curve_count = given->curve_count;
    def.pressed = pressed;
    def.start = out->start;
    def.max_seconds = given->max_seconds;
    def.clock = seconds_now;
    begun = seconds_now();
    task_show(given, 0, "inferring loads and pose");
    if (result == SB_OK)
        result = reg_infer_run(&def, &out->infer, error);
    if (result == SB_OK)
        result = reg_infer_get_quality(out->infer, &quality);
    if (result == SB_OK) {
        out->iterations = quality.rounds;
        out->stop = infer_stop_name(quality.stop);
    }
    out->seconds_run = seconds_now() - begun;
    free(pressed);
    free(marks);
    return result;
}

/* ---- all of it ------------------------------------------------------------------------------------------------- */

/* The target without noise and outliers, and with normals: *clean is the task with that. */
static inline sb_result task_clean(const task *given, outcome *out, task *clean, sb_error *error)
{
    sb_result result;
    *clean = *given;
    if (given->target) {
        result = sb_mesh_copy(given->target, NULL, &out->target, error);
        if (result == SB_OK)
            result = reg_cloud_smooth_mesh(&out->target, NULL, &out->smooth, error);
        clean->target = &out->target;
        return result;
    }
    result = reg_cloud_from_points(&out->cloud, given->cloud->points, given->cloud->normals, given->cloud->count, NULL,
                                   error);
    if (result == SB_OK)
        result = reg_cloud_smooth(&out->cloud, NULL, &out->smooth, error);
    clean->cloud = &out->cloud;
    return result;
}

/* Registers. On failure *error says why, and *out is to be freed all the same. */
static inline sb_result task_run(const task *given, method how, outcome *out, sb_error *error)
{
    double begun = seconds_now();
    sb_result result;
    task clean;
    memset(out, 0, sizeof *out);
    out->how = how;
    out->stop = "converged";
    result = task_clean(given, out, &clean, error);
    if (result == SB_OK)
        result = task_start(&clean, out, error);
    out->seconds_start = seconds_now() - begun;
    if (result != SB_OK || how == METHOD_ICP)
        return result;
    if (how == METHOD_CPD)
        return task_cpd(&clean, out, error);
    if (how == METHOD_INFER)
        return task_infer(&clean, out, error);
    begun = seconds_now();
    result = task_make_body(&clean, out, error);
    out->seconds_setup = seconds_now() - begun;
    if (result != SB_OK)
        return result;
    return how == METHOD_NICP ? task_nicp(&clean, out, error) : task_match(&clean, out, error);
}

/* Where points of the model (m) are after the registration, rigid part included: moved[count]. */
static inline sb_result outcome_carry(const outcome *out, const sb_vec3 *points, int count, sb_vec3 *moved,
                                      sb_error *error)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    if (out->infer && count > 0)
        return reg_infer_covariance(out->infer, points, count, moved, NULL, error);
    for (int i = 0; i < count; i++)
        moved[i] = reg_rigid_apply(&out->start, points[i]);
    if (out->cpd)
        reg_cpd_apply(out->cpd, moved, count, moved);
    if (!out->body || count == 0)
        return SB_OK;
    def.mesh = &out->placed;
    def.points = moved;
    def.point_count = count;
    def.kind = SB_EMBED_PLAIN;
    def.max_distance = SB_REAL_MAX;
    result = sb_embedding_create(&def, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_update(embedding, sb_body_positions(out->body), moved, NULL, NULL);
    sb_embedding_destroy(embedding);
    return result;
}

/* Where the model's nodes are: moved[node_count]. Exactly the body's, where there is one. */
static inline void outcome_nodes(const outcome *out, const sb_mesh *model, sb_vec3 *moved)
{
    size_t bytes = (size_t)out->placed.node_count * sizeof *moved;
    if (out->infer) {
        (void)reg_infer_displacements(out->infer, moved);
        for (int i = 0; i < model->node_count; i++)
            moved[i] = sb_v3_add(model->nodes[i], moved[i]);
        return;
    }
    memcpy(moved, out->body ? sb_body_positions(out->body) : out->placed.nodes, bytes);
    if (out->cpd)
        reg_cpd_apply(out->cpd, moved, out->placed.node_count, moved);
}

/* The matched surface where it is now; *surface is the caller's. */
static inline sb_result outcome_surface(const outcome *out, sb_mesh *surface, sb_error *error)
{
    reg_rigid back = reg_rigid_inverse(&out->start);
    sb_vec3 *rest = (sb_vec3 *)malloc((size_t)out->seen.node_count * sizeof *rest);
    sb_result result =
        rest ? sb_mesh_copy(&out->seen, NULL, surface, error) : task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    for (int i = 0; result == SB_OK && i < out->seen.node_count; i++)
        rest[i] = reg_rigid_apply(&back, out->seen.nodes[i]);
    if (result == SB_OK) {
        result = outcome_carry(out, rest, out->seen.node_count, surface->nodes, error);
        if (result != SB_OK)
            sb_mesh_free(surface);
    }
    free(rest);
    return result;
}

static inline int outcome_by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

enum { OUTCOME_POINTS = 100000 }; /* are asked at most */

/* Mean and median distance (m) of the target's points from the registered surface. */
static inline sb_result outcome_distance(const outcome *out, const task *given, double *mean, double *median,
                                         sb_error *error)
{
    const sb_vec3 *points = given->target ? given->target->nodes : given->cloud->points;
    int count = given->target ? given->target->node_count : given->cloud->count, guess = -1;
    int stride = 1 + count / OUTCOME_POINTS, asked = 0;
    sb_mesh surface;
    sb_surface *tree = NULL;
    double sum = 0, *distances = (double *)malloc(((size_t)OUTCOME_POINTS + 1) * sizeof *distances);
    sb_result result = distances ? outcome_surface(out, &surface, error)
                                 : task_fail(error, SB_ERROR_MEMORY, "not enough memory for the distances");
    if (result != SB_OK) {
        free(distances);
        return result;
    }
    result = sb_surface_create(&surface, NULL, &tree, error);
    for (int i = 0; result == SB_OK && i < count; i += stride) {
        sb_surface_hit hit;
        if (sb_surface_closest_from(tree, points[i], SB_REAL_MAX, guess, &hit)) {
            guess = hit.triangle;
            sum += distances[asked++] = (double)hit.distance;
        }
    }
    if (result == SB_OK && asked > 0) {
        qsort(distances, (size_t)asked, sizeof *distances, outcome_by_size);
        *mean = sum / asked;
        *median = distances[asked / 2];
    }
    free(distances);
    sb_surface_destroy(tree);
    sb_mesh_free(&surface);
    return result;
}

#endif /* REGISTRATION_H */
