/* organ_motion.h: random organs that move, for tests of tracking: a bumpy organ of organ_views.h, held below and drawn
 * from one shape to another, by a body of its own mesh and law, while it drifts and turns as a whole. A model of it is
 * made apart, from another mesh. */
#ifndef ORGAN_MOTION_H
#define ORGAN_MOTION_H

#include "organ_views.h"

enum { MOTION_PHASES = 4 };

typedef struct motion {
    organ shape;
    double size;                   /* m: diagonal of the box */
    sb_mesh fine;                  /* of what really moves */
    sb_mesh seen;                  /* its surface, of triangles of its own */
    sb_vec3 *phase[MOTION_PHASES]; /* [fine nodes] displacements (m) at 0, 1/3, 2/3 and all of the way */
    sb_embedding_rows rows;        /* of seen's nodes in fine */
    sb_vec3 *now, *seen_now;       /* [fine nodes], [seen nodes] positions (m) */
    sb_vec3 drift, turn;           /* m, rad: of a whole second's sway */
    sb_vec3 jump;                  /* m: added to all */
    sb_mesh outline, coarse;       /* the model's */
    reg_model *model;
} motion;

static inline int motion_fill(const sb_mesh *outline, double cell, sb_element_type type, sb_mesh *mesh)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_surface *skin = NULL;
    sb_shape shape;
    sb_result result;
    memset(&shape, 0, sizeof shape);
    CHECK_OK(sb_surface_create(outline, NULL, &skin, NULL));
    shape.surface = skin;
    def.shapes = &shape;
    def.shape_count = 1;
    def.cell = REAL(cell);
    def.type = type;
    result = sb_mesh_stuff(&def, mesh, NULL, NULL);
    sb_surface_destroy(skin);
    return CHECK_OK(result);
}

/* Prescribes the nodes of the boundary within reach of what lies farthest along a direction. */
static inline void motion_draw(sb_body *body, const motion *m, const sb_boundary *skin, sb_vec3 direction, double reach,
                               sb_vec3 way)
{
    const sb_vec3 *x = m->fine.nodes;
    int far = skin->nodes[0];
    for (int i = 0; i < skin->surface.node_count; i++)
        if (sb_v3_dot(x[skin->nodes[i]], direction) > sb_v3_dot(x[far], direction))
            far = skin->nodes[i];
    for (int i = 0; i < skin->surface.node_count; i++)
        if (sb_v3_norm(sb_v3_sub(x[skin->nodes[i]], x[far])) < REAL(reach))
            CHECK_OK(sb_body_prescribe(body, skin->nodes + i, 1, SB_XYZ, &way, 1));
}

/* The shapes on the way: a Mooney-Rivlin body of tet10, held below, drawn by `depth` sizes at a place above. */
static inline int motion_solve(motion *m, double depth, double reach, unsigned long long *seed)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_boundary skin;
    sb_body *body;
    double d[3];
    int good;
    sb_vec3 up, way;
    organ_direction(seed, d);
    up = sb_v3(REAL(0.6 * d[0]), REAL(0.6 * d[1]), 1);
    organ_direction(seed, d);
    way = sb_v3_sub(sb_v3(REAL(0.5 * d[0]), REAL(0.5 * d[1]), REAL(0.5 * d[2])), up);
    way = sb_v3_scale(REAL(depth * m->size) / sb_v3_norm(way), way);
    def.mesh = &m->fine;
    def.material = sb_material_mooney_rivlin(525, 225, REAL(1.1e-4), 1060);
    body = scene_body(&def);
    if (!body || !CHECK_OK(sb_mesh_boundary(&m->fine, 1, NULL, &skin, NULL)))
        return 0;
    options.load_steps = 2;
    options.tolerance = REAL(1e-3);
    good = 1;
    for (int k = 0; k < MOTION_PHASES; k++) {
        size_t bytes = (size_t)m->fine.node_count * sizeof(sb_vec3);
        m->phase[k] = (sb_vec3 *)calloc(1, bytes);
        motion_draw(body, m, &skin, sb_v3(0, 0, -1), 0.2 * m->size, sb_v3(0, 0, 0));
        motion_draw(body, m, &skin, up, reach * m->size, sb_v3_scale(REAL(k) / (MOTION_PHASES - 1), way));
        good = good && (k == 0 || CHECK_OK(sb_body_solve_static(body, &options, NULL)));
        memcpy(m->phase[k], sb_body_displacements(body), bytes);
    }
    sb_boundary_free(&skin);
    sb_body_destroy(body);
    return good;
}

static inline int motion_hold_seen(motion *m)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    int good;
    def.mesh = &m->fine;
    def.points = m->seen.nodes;
    def.point_count = m->seen.node_count;
    def.kind = SB_EMBED_PLAIN;
    def.max_distance = REAL(0.25 * m->size);
    good = CHECK_OK(sb_embedding_create(&def, &embedding, NULL)) &&
           CHECK_OK(sb_embedding_mapping(embedding, NULL, &m->rows, NULL));
    sb_embedding_destroy(embedding);
    m->now = (sb_vec3 *)calloc((size_t)m->fine.node_count, sizeof(sb_vec3));
    m->seen_now = (sb_vec3 *)calloc((size_t)m->seen.node_count, sizeof(sb_vec3));
    return good && CHECK(m->now && m->seen_now);
}

/* depth: of the way, in sizes; reach: of the patch that is drawn; cell: of the model's mesh, in sizes. */
static inline int motion_make(motion *m, unsigned long long seed, double depth, double reach, double cell,
                              const sb_allocator *allocator, const sb_jobs *jobs)
{
    reg_model_def def = reg_default_model_def();
    sb_mat3 as_is = sb_m3_identity(), turned = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(1, 2, REAL(0.5))));
    sb_vec3 low, high;
    double d[3];
    memset(m, 0, sizeof *m);
    m->shape = organ_make(&seed, 0.12, 1, 0);
    organ_direction(&seed, d);
    m->turn = sb_v3(REAL(0.06 * d[0]), REAL(0.06 * d[1]), REAL(0.06 * d[2]));
    organ_direction(&seed, d);
    if (!organ_surface(&m->shape, 14, &as_is, 0, &m->outline) || !organ_surface(&m->shape, 22, &turned, 0, &m->seen))
        return 0;
    sb_mesh_bounds(&m->outline, &low, &high);
    m->size = (double)sb_v3_norm(sb_v3_sub(high, low));
    m->drift = sb_v3(REAL(0.04 * m->size * d[0]), REAL(0.04 * m->size * d[1]), REAL(0.04 * m->size * d[2]));
    if (!motion_fill(&m->seen, 0.09 * m->size, SB_TET10, &m->fine) ||
        !motion_fill(&m->outline, cell * m->size, SB_TET4, &m->coarse))
        return 0;
    def.mesh = &m->coarse;
    def.surface = &m->outline;
    if (allocator)
        def.allocator = *allocator;
    if (jobs)
        def.jobs = *jobs;
    return motion_solve(m, depth, reach, &seed) && motion_hold_seen(m) &&
           CHECK_OK(reg_model_create(&def, &m->model, NULL));
}

static inline void motion_free(motion *m)
{
    reg_model_destroy(m->model);
    sb_embedding_rows_free(&m->rows);
    for (int k = 0; k < MOTION_PHASES; k++)
        free(m->phase[k]);
    free(m->now);
    free(m->seen_now);
    sb_mesh_free(&m->fine);
    sb_mesh_free(&m->seen);
    sb_mesh_free(&m->outline);
    sb_mesh_free(&m->coarse);
}

/* Where everything is at a share of the way, [0, 1], and a share of the sway (any number): now, seen_now. */
static inline void motion_move(motion *m, double share, double sway)
{
    sb_mat3 rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3_scale(REAL(sway), m->turn)));
    double weight[MOTION_PHASES];
    for (int k = 0; k < MOTION_PHASES; k++) { /* Lagrange's */
        weight[k] = 1;
        for (int l = 0; l < MOTION_PHASES; l++)
            weight[k] *= l == k ? 1 : (share * (MOTION_PHASES - 1) - l) / (k - l);
    }
    for (int i = 0; i < m->fine.node_count; i++) {
        sb_vec3 x = m->fine.nodes[i];
        for (int k = 0; k < MOTION_PHASES; k++)
            x = sb_v3_madd(x, REAL(weight[k]), m->phase[k][i]);
        m->now[i] = sb_v3_add(sb_m3_apply(rotation, x), sb_v3_madd(m->jump, REAL(sway), m->drift));
    }
    sb_mapping_apply(&m->rows.mapping, m->now, m->seen_now);
}

/* Points of what is seen now: `count` at random of the nodes whose share of the height along `from` is above `least`
 * and that look there, with noise (m). hidden: nodes within that (m) of the middle of what is seen are not. Returns how
 * many. */
static inline int motion_scan(const motion *m, unsigned long long *seed, sb_vec3 from, double least, double hidden,
                              double noise, int count, sb_vec3 *points)
{
    sb_vec3 *normals = (sb_vec3 *)calloc((size_t)m->seen.node_count, sizeof(sb_vec3)), middle = sb_v3(0, 0, 0);
    double low = 1e30, high = -1e30;
    int made = 0;
    for (int e = 0; e < m->seen.element_count; e++) {
        const int *c = m->seen.elements + 3 * e;
        const sb_vec3 *x = m->seen_now;
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(x[c[1]], x[c[0]]), sb_v3_sub(x[c[2]], x[c[0]]));
        for (int k = 0; k < 3; k++)
            normals[c[k]] = sb_v3_add(normals[c[k]], normal);
    }
    for (int i = 0; i < m->seen.node_count; i++) {
        double h = (double)sb_v3_dot(m->seen_now[i], from);
        low = fmin(low, h), high = fmax(high, h);
        if (h >= high)
            middle = m->seen_now[i];
    }
    for (int tries = 0; tries < 40 * count && made < count; tries++) {
        int i = (int)check_random_in(seed, 0, m->seen.node_count) % m->seen.node_count;
        sb_vec3 x = m->seen_now[i];
        if ((double)sb_v3_dot(x, from) < low + least * (high - low) ||
            (least > 0 && sb_v3_dot(normals[i], from) <= 0) || (double)sb_v3_norm(sb_v3_sub(x, middle)) < hidden)
            continue;
        points[made++] = sb_v3_add(x, sb_v3(REAL(noise * organ_gauss(seed)), REAL(noise * organ_gauss(seed)),
                                            REAL(noise * organ_gauss(seed))));
    }
    free(normals);
    return made;
}

#endif /* ORGAN_MOTION_H */
