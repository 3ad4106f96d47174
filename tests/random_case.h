/* random_case.h: cases that nobody chose: organs, blobs and blocks, meshed evenly, graded or distorted, of any element,
 * material, integrator, size and stiffness, held at a random side. The same seed gives the same case everywhere. */
#ifndef RANDOM_CASE_H
#define RANDOM_CASE_H

#include "scene.h"

typedef struct random_case {
    unsigned long long seed;
    char name[160]; /* in words, for messages */
    sb_mesh mesh;   /* m, anywhere and turned anyhow */
    sb_material material;
    sb_integration integration;
    sb_integrator integrator;
    sb_mass_kind mass;
    sb_vec3 gravity;       /* m/s^2 */
    sb_real damping;       /* s, of the stiffness */
    sb_real dt;            /* s */
    int *held, held_count; /* nodes without motion */
    sb_vec3 *kick;         /* [node_count] velocities at the start (m/s), 0 at held nodes */
} random_case;

/* Between low and high, evenly in the logarithm. */
static inline double random_scale(unsigned long long *seed, double low, double high)
{
    return exp(check_random_in(seed, log(low), log(high)));
}

static inline int random_below(unsigned long long *seed, int count) { return (int)(check_random(seed) * count); }

static inline sb_vec3 random_direction(unsigned long long *seed)
{
    for (;;) {
        sb_vec3 d = sb_v3(REAL(check_random_in(seed, -1, 1)), REAL(check_random_in(seed, -1, 1)),
                          REAL(check_random_in(seed, -1, 1)));
        sb_real length = sb_v3_norm(d);
        if (length > REAL(0.1) && length < 1)
            return sb_v3_scale(1 / length, d);
    }
}

static inline sb_quat random_turn(unsigned long long *seed)
{
    return sb_quat_from_rotation_vector(sb_v3_scale(REAL(check_random_in(seed, 0, 3)), random_direction(seed)));
}

/* ---- shapes, about 1 m large ---- */

typedef struct random_blob {
    sb_vec3 centres[4];
    sb_real radii[4];
    int count;
} random_blob;

static inline sb_real random_blob_distance(void *user, sb_vec3 point)
{
    const random_blob *blob = (const random_blob *)user;
    sb_real least = SB_REAL_MAX;
    for (int i = 0; i < blob->count; i++)
        least = sb_min(least, sb_v3_norm(sb_v3_sub(point, blob->centres[i])) - blob->radii[i]);
    return least;
}

/* Overlapping balls, stuffed with tets. */
static inline sb_result random_blob_mesh(unsigned long long *seed, sb_element_type type, sb_mesh *mesh)
{
    random_blob blob;
    sb_shape shape;
    sb_stuff_def def = sb_default_stuff_def();
    memset(&shape, 0, sizeof shape);
    blob.count = 1 + random_below(seed, 4);
    for (int i = 0; i < blob.count; i++) {
        blob.radii[i] = REAL(check_random_in(seed, 0.25, 0.4));
        blob.centres[i] = i == 0 ? sb_v3(0, 0, 0)
                                 : sb_v3_madd(blob.centres[i - 1], REAL(0.8) * blob.radii[i], random_direction(seed));
    }
    shape.distance = random_blob_distance;
    shape.user = &blob;
    shape.max_slope = 1;
    def.shapes = &shape;
    def.shape_count = 1;
    def.low = sb_v3(-2, -2, -2), def.high = sb_v3(2, 2, 2);
    def.cell = REAL(0.3);
    def.type = type == SB_TET10 ? SB_TET10 : SB_TET4;
    return sb_mesh_stuff(&def, mesh, NULL, NULL);
}

/* A block whose cells grow along x by up to a factor of 5. The slope of a power vanishes at 0, where it would bring
 * mid-edge nodes to a quarter of their edge, at which an element is singular: elements that have them get a slope above
 * 0. */
static inline void random_grade(unsigned long long *seed, sb_mesh *mesh)
{
    double power = check_random_in(seed, 1.2, 2);
    int is_linear = mesh->element_type == SB_TET4 || mesh->element_type == SB_HEX8;
    for (int i = 0; i < mesh->node_count; i++) {
        double x = (double)mesh->nodes[i].x;
        mesh->nodes[i].x = REAL(is_linear ? pow(x, power) : x * (1 + power * x) / (1 + power));
    }
}

static inline sb_mesh random_block(unsigned long long *seed, sb_element_type type)
{
    int n[3];
    for (int k = 0; k < 3; k++)
        n[k] = 1 + random_below(seed, type == SB_TET4 || type == SB_HEX8 ? 4 : 2);
    return scene_box(type, n[0] + 1, n[1], n[2],
                     sb_v3(1, REAL(check_random_in(seed, 0.1, 1)), REAL(check_random_in(seed, 0.1, 1))),
                     check_random(seed) < 0.5 ? 0 : 0.2);
}

static inline const char *random_shape(unsigned long long *seed, sb_element_type type, sb_mesh *mesh)
{
    int kind = random_below(seed, 5), is_tet = type == SB_TET4 || type == SB_TET10;
    sb_result result = SB_OK;
    if (kind == 0 && is_tet && random_blob_mesh(seed, type, mesh) == SB_OK)
        return "blob";
    if (kind == 1 && (type == SB_TET4 || type == SB_HEX8)) {
        result = sb_mesh_organ(type, 4 + random_below(seed, 3), NULL, mesh, NULL);
        for (int i = 0; result == SB_OK && i < mesh->node_count; i++)
            mesh->nodes[i] = sb_v3_scale(5, mesh->nodes[i]);
        return CHECK_OK(result) ? "organ" : "none";
    }
    if (kind == 2) {
        CHECK_OK(sb_mesh_ellipsoid(type, sb_v3(REAL(0.5), REAL(check_random_in(seed, 0.2, 0.5)), REAL(0.4)), 4, NULL,
                                   mesh, NULL));
        return "ellipsoid";
    }
    *mesh = random_block(seed, type);
    if (kind == 3)
        random_grade(seed, mesh);
    return kind == 3 ? "graded block" : "block";
}

/* ---- the case ---- */

static inline sb_material random_material(unsigned long long *seed, const char **name)
{
    double young = random_scale(seed, 1e3, 1e6), poisson = check_random_in(seed, 0, 0.47);
    double density = check_random_in(seed, 500, 3000);
    switch (random_below(seed, 5)) {
    case 0: *name = "corotated"; return sb_material_corotated(REAL(young), REAL(poisson), REAL(density));
    case 1: *name = "linear"; return sb_material_linear(REAL(young), REAL(poisson), REAL(density));
    case 2: *name = "neo-Hookean"; return sb_material_neo_hookean(REAL(young), REAL(poisson), REAL(density));
    case 3: *name = "St. Venant"; return sb_material_svk(REAL(young), REAL(poisson), REAL(density));
    default:
        *name = "stable neo-Hookean";
        return sb_material_stable_neo_hookean(REAL(young), REAL(poisson), REAL(density));
    }
}

/* The lowest tenth or more of the mesh along a random direction, at least one element. */
static inline int random_supports(random_case *c, unsigned long long *seed)
{
    sb_vec3 d = random_direction(seed);
    sb_real low = SB_REAL_MAX, high = -SB_REAL_MAX, level;
    int width = sb_mesh_element_width(&c->mesh), lowest = 0;
    c->held = (int *)malloc((size_t)c->mesh.node_count * sizeof(int));
    if (!CHECK(c->held != NULL))
        return 0;
    for (int i = 0; i < c->mesh.node_count; i++) {
        low = sb_min(low, sb_v3_dot(d, c->mesh.nodes[i]));
        high = sb_max(high, sb_v3_dot(d, c->mesh.nodes[i]));
    }
    level = low + REAL(check_random_in(seed, 0.1, 0.4)) * (high - low);
    for (int i = 0; i < c->mesh.node_count; i++)
        if (sb_v3_dot(d, c->mesh.nodes[i]) <= level)
            c->held[c->held_count++] = lowest = i;
    for (int e = 0; e < c->mesh.element_count; e++) { /* one element whole, or a corner alone could turn */
        const int *nodes = c->mesh.elements + (size_t)e * (size_t)width;
        int has = 0;
        for (int a = 0; a < width; a++)
            has = has || nodes[a] == lowest;
        for (int a = 0; has && a < width; a++) {
            int known = 0;
            for (int k = 0; k < c->held_count; k++)
                known = known || c->held[k] == nodes[a];
            if (!known)
                c->held[c->held_count++] = nodes[a];
        }
        if (has)
            break;
    }
    return 1;
}

static inline void random_case_free(random_case *c)
{
    sb_mesh_free(&c->mesh);
    free(c->held);
    free(c->kick);
    memset(c, 0, sizeof *c);
}

static inline sb_integration random_integration(sb_element_type type, unsigned long long *seed)
{
    return type != SB_TET4 && check_random(seed) < 0.5 ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
}

/* violence: 0: gentle, so that answers can be compared; 1: steps and loads of any size. 0 when it could not be made. */
static inline int random_case_make(random_case *c, unsigned long long number, int violence)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    unsigned long long seed = 0x9E3779B97F4A7C15ULL * (number + 1), other = seed;
    sb_element_type type;
    const char *shape, *material;
    double size;
    sb_quat turn;
    sb_vec3 shift;
    memset(c, 0, sizeof *c);
    c->seed = number;
    for (int i = 0; i < 8; i++)
        check_random(&seed);
    type = types[random_below(&seed, 5)];
    shape = random_shape(&seed, type, &c->mesh);
    if (!CHECK(c->mesh.node_count > 0))
        return 0;
    type = c->mesh.element_type;
    size = random_scale(&seed, 0.01, 1);
    turn = random_turn(&seed);
    shift = sb_v3_scale(REAL(size * check_random_in(&seed, 0, 3)), random_direction(&seed));
    for (int i = 0; i < c->mesh.node_count; i++)
        c->mesh.nodes[i] = sb_v3_madd(shift, REAL(size), sb_quat_rotate(turn, c->mesh.nodes[i]));
    c->material = random_material(&seed, &material);
    c->integration = random_integration(type, type == SB_HEX8 ? &seed : &other);
    c->integrator = integrators[random_below(&seed, violence ? 4 : 3)];
    c->mass = check_random(&seed) < 0.5 || c->integrator == SB_CENTRAL_DIFFERENCE ? SB_MASS_LUMPED : SB_MASS_CONSISTENT;
    c->damping = REAL(c->integrator == SB_CENTRAL_DIFFERENCE ? 0 : random_scale(&seed, 1e-4, 1e-2));
    /* gently: what bends it by some hundredths, in a tenth of a second; else anything */
    c->gravity = sb_v3_scale(
        REAL(violence ? random_scale(&seed, 1, 1000)
                      : 0.01 * (double)sb_material_young(&c->material) / ((double)c->material.density * size)),
        random_direction(&seed));
    c->dt = REAL(violence ? random_scale(&seed, 1e-4, 0.1)
                          : 0.3 * size * sqrt((double)c->material.density / (double)sb_material_young(&c->material)));
    if (!random_supports(c, &seed))
        return 0;
    c->kick = (sb_vec3 *)calloc((size_t)c->mesh.node_count, sizeof(sb_vec3));
    if (!CHECK(c->kick != NULL))
        return 0;
    for (int i = 0; violence && i < c->mesh.node_count; i++)
        c->kick[i] = sb_v3_scale(REAL(10 * size * check_random(&seed)), random_direction(&seed));
    for (int k = 0; k < c->held_count; k++)
        c->kick[c->held[k]] = sb_v3(0, 0, 0);
    snprintf(c->name, sizeof c->name, "case %llu: %s of %s, %.3g m, %s, integrator %d", number, shape,
             sb_element_name(type), size, material, (int)c->integrator);
    return 1;
}

/* The body of a case. jobs: zeros for none. tolerance: of the linear systems. */
static inline sb_body *random_case_body(const random_case *c, sb_jobs jobs, double tolerance)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    def.mesh = &c->mesh;
    def.material = c->material;
    def.integration = c->integration;
    def.integrator = c->integrator;
    def.mass = c->mass;
    def.gravity = c->gravity;
    def.damping_stiffness = c->damping;
    def.tolerance = REAL(tolerance);
    def.max_iterations = 3000;
    def.max_substeps = 2000;
    def.newton_tolerance = REAL(scene_tolerance(1e-9, 1e3));
    def.jobs = jobs;
    body = scene_body(&def);
    if (body) {
        CHECK_OK(sb_body_fix_nodes(body, c->held, c->held_count, SB_XYZ));
        CHECK_OK(sb_body_set_velocities(body, c->kick));
    } else {
        printf("%s\n", c->name);
    }
    return body;
}

#endif /* RANDOM_CASE_H */
