/* rod: creation, supports, loads, nodes and readings of a rod. */
#include "rod_private.h"

static const unsigned ndli_rod_cookie = 0x726f6431u, ndli_rod_static_cookie = 0x726f6432u;
static const double ndli_rod_pi = 3.141592653589793;

/* ---- what a rod is made of ---- */

NDL_API sb_result ndl_rod_section_preset(ndl_rod_preset preset, ndl_rod_section *section)
{
    static const double table[3][5] = {/* outer and inner diameter (mm), GPa, Poisson's ratio, density */
                                       {1.270, 0, 193, 0.29, 8000},
                                       {0.83, 0, 75, 0.33, 6450},
                                       {0.7176, 0.413, 193, 0.29, 8000}};
    const double *row;
    if (!section || preset < NDL_STYLET_18G || preset > NDL_HYPODERMIC_22G)
        return SB_ERROR_ARGUMENT;
    row = table[preset - NDL_STYLET_18G];
    section->radius = (sb_real)(0.5e-3 * row[0]);
    section->inner_radius = (sb_real)(0.5e-3 * row[1]);
    section->young = (sb_real)(1e9 * row[2]);
    section->poisson = (sb_real)row[3];
    section->density = (sb_real)row[4];
    return SB_OK;
}

NDL_API ndl_rod_stiffness ndl_rod_stiffness_of(const ndl_rod_section *section)
{
    ndl_rod_stiffness stiffness;
    double r2, i2, area, bending;
    memset(&stiffness, 0, sizeof stiffness);
    if (!section)
        return stiffness;
    r2 = (double)section->radius * (double)section->radius;
    i2 = (double)section->inner_radius * (double)section->inner_radius, area = ndli_rod_pi * (r2 - i2);
    bending = 0.25 * (double)section->young * ndli_rod_pi * (r2 * r2 - i2 * i2);
    stiffness.stretch = (sb_real)((double)section->young * area);
    stiffness.bending[0] = stiffness.bending[1] = (sb_real)bending;
    stiffness.twist = (sb_real)(bending / (1 + (double)section->poisson));
    stiffness.line_density = (sb_real)((double)section->density * area);
    return stiffness;
}

/* ---- creation ---- */

NDL_API ndl_rod_def ndl_default_rod_def(void)
{
    ndl_rod_def def;
    memset(&def, 0, sizeof def);
    ndl_rod_section_preset(NDL_STYLET_18G, &def.section);
    def.rest = NDL_REST_STRAIGHT;
    def.clamped = 1;
    def.damping_stretch = def.damping_bending = (sb_real)1e-4;
    def.max_newton = 30;
    def.tolerance = (sb_real)1e-6;
    def.cookie = ndli_rod_cookie;
    return def;
}

NDL_API ndl_rod_static_options ndl_default_rod_static_options(void)
{
    ndl_rod_static_options options;
    memset(&options, 0, sizeof options);
    options.max_newton = 500;
    options.tolerance = (sb_real)1e-9;
    options.cookie = ndli_rod_static_cookie;
    return options;
}

NDLI_API int ndli_rod_static_options_valid(const ndl_rod_static_options *options)
{
    return options->cookie == ndli_rod_static_cookie && options->max_newton >= 1 && options->tolerance > 0 &&
           options->tolerance < 1;
}

static int ndli_rod_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_rod_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

static sb_result ndli_rod_check_material(const ndl_rod_def *def, ndl_rod_stiffness *stiffness, sb_error *error)
{
    const ndl_rod_section *s = &def->section;
    if (def->stiffness) {
        *stiffness = *def->stiffness;
    } else {
        if (!ndli_rod_positive(s->radius) || !ndli_rod_not_negative(s->inner_radius) || !(s->inner_radius < s->radius))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "section: radius must be above 0, inner_radius in [0, radius)");
        if (!ndli_rod_positive(s->young) || !ndli_rod_positive(s->density) || !(s->poisson > -1) ||
            !(s->poisson <= (sb_real)0.5))
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "section: young and density must be above 0, poisson in (-1, 0.5]");
        *stiffness = ndl_rod_stiffness_of(s);
    }
    if (!ndli_rod_positive(stiffness->stretch) || !ndli_rod_positive(stiffness->bending[0]) ||
        !ndli_rod_positive(stiffness->bending[1]) || !ndli_rod_positive(stiffness->twist) ||
        !ndli_rod_positive(stiffness->line_density))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "stiffness and line_density must be finite and above 0");
    return SB_OK;
}

static sb_result ndli_rod_check_def(const ndl_rod_def *def, sb_error *error)
{
    if (def->cookie != ndli_rod_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_rod_def()");
    if (!def->nodes || def->node_count < 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a rod needs nodes, at least 2");
    if (def->capacity != 0 && def->capacity < def->node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "capacity %d is below node_count %d", def->capacity, def->node_count);
    if (def->rest < NDL_REST_STRAIGHT || def->rest > NDL_REST_CURVATURE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rest has no such kind");
    if (def->rest == NDL_REST_CURVATURE && !def->rest_curvature)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "NDL_REST_CURVATURE needs rest_curvature");
    if (!sb_v3_is_finite(def->director) || !sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "director or gravity is not finite");
    if (!ndli_rod_not_negative(def->damping_stretch) || !ndli_rod_not_negative(def->damping_bending))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "damping must be finite and not negative");
    if (def->max_newton < 1 || !(def->tolerance > 0) || !(def->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_newton must be at least 1, tolerance in (0, 1)");
    if (def->clamped != 0 && def->clamped != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "clamped must be 0 or 1");
    for (int i = 0; i < def->node_count; i++) {
        if (!sb_v3_is_finite(def->nodes[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d is not finite", i);
        if (def->rest == NDL_REST_CURVATURE &&
            (!sb_is_finite(def->rest_curvature[2 * i]) || !sb_is_finite(def->rest_curvature[2 * i + 1])))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the rest curvature of node %d is not finite", i);
    }
    return SB_OK;
}

/* All arrays, for `nodes` nodes; called once to measure and once to hand out. */
static void ndli_rod_layout(ndl_rod *rod, sbi_arena *arena, int nodes)
{
    size_t n = (size_t)nodes, v = sizeof(ndli_v3), d = sizeof(double), m = sizeof(ndli_m3);
    ndli_v3 **vectors[] = {&rod->x,
                           &rod->v,
                           &rod->a,
                           &rod->director,
                           &rod->tangent,
                           &rod->target,
                           &rod->target_velocity,
                           &rod->force,
                           &rod->reaction,
                           &rod->shape.tangent,
                           &rod->shape.director,
                           &rod->shape.m1,
                           &rod->shape.m2,
                           &rod->shape.binormal,
                           &rod->gradient,
                           &rod->try_x,
                           &rod->best_x,
                           &rod->step_x,
                           &rod->predicted,
                           &rod->damping_tangent,
                           &rod->old_binormal};
    double **reals[] = {&rod->theta,
                        &rod->rest_length,
                        &rod->mass,
                        &rod->cell,
                        &rod->turn,
                        &rod->torque,
                        &rod->reaction_torque,
                        &rod->shape.length,
                        &rod->shape.chi,
                        &rod->shape.twist,
                        &rod->shape.reference,
                        &rod->matrix.turn,
                        &rod->matrix.turn_before,
                        &rod->turn_gradient,
                        &rod->try_theta,
                        &rod->best_theta,
                        &rod->step_theta,
                        &rod->saved_turns,
                        &rod->old_length,
                        &rod->grip,
                        &rod->grip_limit,
                        &rod->anchor,
                        &rod->shape.lag};
    ndli_m3 **matrices[] = {&rod->damping_before, &rod->damping_after, &rod->damping_weight};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (ndli_v3 *)sbi_arena_take(arena, n, v);
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        *reals[i] = (double *)sbi_arena_take(arena, n, d);
    for (size_t i = 0; i < sizeof matrices / sizeof *matrices; i++)
        *matrices[i] = (ndli_m3 *)sbi_arena_take(arena, n, m);
    rod->rest_bend = (double(*)[2])sbi_arena_take(arena, n, 2 * d);
    rod->old_bend = (double(*)[4])sbi_arena_take(arena, n, 4 * d);
    rod->matrix.node = (ndli_m3(*)[3])sbi_arena_take(arena, n, 3 * m);
    rod->matrix.cross = (ndli_v3(*)[4])sbi_arena_take(arena, n, 4 * v);
    rod->held = (unsigned char *)sbi_arena_take(arena, n, 1);
    rod->has_velocity = (unsigned char *)sbi_arena_take(arena, n, 1);
    rod->turn_held = (unsigned char *)sbi_arena_take(arena, n, 1);
    rod->public_x = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    rod->public_v = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    rod->public_reaction = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    rod->band = (double *)sbi_arena_take(arena, n, 4 * (NDLI_ROD_WIDTH + 1) * d);
    rod->unknown = (double *)sbi_arena_take(arena, n, 4 * d);
    rod->saved_nodes = (ndli_v3 *)sbi_arena_take(arena, n, NDLI_ROD_SAVED_NODES * v);
    rod->saved_reals = (double *)sbi_arena_take(arena, n, NDLI_ROD_SAVED_REALS * d);
}

static sb_result ndli_rod_allocate(const ndl_rod_def *def, ndl_rod **rod, sb_error *error)
{
    int nodes = def->capacity ? def->capacity : def->node_count;
    ndl_rod *made = (ndl_rod *)sbi_alloc_zeroed(&def->allocator, 1, sizeof(ndl_rod));
    sbi_arena arena = {NULL, 0, 0};
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a rod");
    made->allocator = def->allocator;
    ndli_rod_layout(made, &arena, nodes);
    made->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&def->allocator, 1, arena.used);
    if (!made->memory) {
        sbi_free(&def->allocator, made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a rod of %d nodes", nodes);
    }
    arena.base = (unsigned char *)made->memory;
    arena.used = 0;
    ndli_rod_layout(made, &arena, nodes);
    made->capacity = nodes;
    made->node_count = def->node_count;
    *rod = made;
    return SB_OK;
}

/* Edges, tangents and the Bishop frame from `director` on, of the first positions. */
static sb_result ndli_rod_first_shape(ndl_rod *rod, ndli_v3 director, sb_error *error)
{
    int bad;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        ndli_v3 e = ndli_sub(rod->x[j + 1], rod->x[j]);
        double length = ndli_norm(e);
        if (!(length > 1e-12 * ndli_rod_reach(rod)) || !ndli_is_finite(length))
            return sbi_fail_node(error, SB_ERROR_MESH, j + 1, "nodes %d and %d are too close or too far", j, j + 1);
        rod->rest_length[j] = length;
        rod->tangent[j] = ndli_scale(1 / length, e);
        rod->director[j] = ndli_rod_across(j ? rod->director[j - 1] : director, rod->tangent[j]);
    }
    bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_MESH, bad, "the rod turns back at node %d", bad);
    for (int j = 1; j < ndli_rod_edges(rod); j++)
        rod->director[j] = ndli_rod_across(
            ndli_rod_transport(rod->tangent[j - 1], rod->tangent[j], rod->director[j - 1]), rod->tangent[j]);
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    return SB_OK;
}

/* Integrated curvature 2 tan(k h/2) of an arc. */
NDLI_API void ndli_rod_bend_to(ndl_rod *rod, int i, double curvature1, double curvature2)
{
    double k = sqrt(curvature1 * curvature1 + curvature2 * curvature2), s, c, factor;
    sbi_dense_sin_cos(0.5 * k * rod->cell[i], &s, &c);
    factor = k > 0 ? 2 * s / (c * k) : 0;
    rod->rest_bend[i][0] = factor * curvature1;
    rod->rest_bend[i][1] = factor * curvature2;
}

static sb_result ndli_rod_set_rest_curvature(ndl_rod *rod, int i, const sb_real *given, sb_error *error)
{
    double k0 = (double)given[0], k1 = (double)given[1];
    if (!(sqrt(k0 * k0 + k1 * k1) * rod->cell[i] < 2.9))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the rest curvature of node %d turns the rod back", i);
    ndli_rod_bend_to(rod, i, k0, k1);
    return SB_OK;
}

static sb_result ndli_rod_set_rest(ndl_rod *rod, const ndl_rod_def *def, sb_error *error)
{
    rod->plain = rod->bending[0] == rod->bending[1];
    for (int i = 1; i < rod->node_count - 1; i++) {
        if (def->rest == NDL_REST_SHAPE) {
            rod->rest_bend[i][0] = ndli_dot(rod->shape.binormal[i], rod->shape.m2[i]);
            rod->rest_bend[i][1] = -ndli_dot(rod->shape.binormal[i], rod->shape.m1[i]);
        } else if (def->rest == NDL_REST_CURVATURE) {
            sb_result result = ndli_rod_set_rest_curvature(rod, i, def->rest_curvature + 2 * i, error);
            if (result != SB_OK)
                return result;
        }
        rod->plain = rod->plain && rod->rest_bend[i][0] == 0 && rod->rest_bend[i][1] == 0;
    }
    return SB_OK;
}

static sb_result ndli_rod_fill(ndl_rod *rod, const ndl_rod_def *def, const ndl_rod_stiffness *stiffness,
                               sb_error *error)
{
    sb_result result;
    rod->stretch = (double)stiffness->stretch;
    rod->bending[0] = (double)stiffness->bending[0];
    rod->bending[1] = (double)stiffness->bending[1];
    rod->torsion = (double)stiffness->twist;
    rod->line_density = (double)stiffness->line_density;
    rod->gravity = ndli_from(def->gravity);
    rod->damping_stretch = (double)def->damping_stretch;
    rod->damping_bending = (double)def->damping_bending;
    rod->max_newton = def->max_newton;
    rod->tolerance = (double)def->tolerance;
    for (int i = 0; i < rod->node_count; i++)
        rod->x[i] = ndli_from(def->nodes[i]);
    result = ndli_rod_first_shape(rod, ndli_from(def->director), error);
    for (int i = 0; def->clamped && i < 2; i++) {
        rod->held[i] = 1;
        rod->target[i] = rod->x[i];
    }
    rod->turn_held[0] = (unsigned char)def->clamped;
    if (result == SB_OK) {
        ndli_rod_rest_changed(rod);
        result = ndli_rod_set_rest(rod, def, error);
    }
    if (result == SB_OK) {
        ndli_rod_relax(rod);
        ndli_rod_publish(rod);
    }
    return result;
}

NDL_API sb_result ndl_rod_create(const ndl_rod_def *def, ndl_rod **rod, sb_error *error)
{
    ndl_rod_stiffness stiffness;
    ndl_rod *made = NULL;
    sb_result result;
    if (!def || !rod)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or rod is NULL");
    memset(&stiffness, 0, sizeof stiffness);
    result = ndli_rod_check_def(def, error);
    if (result == SB_OK)
        result = ndli_rod_check_material(def, &stiffness, error);
    if (result == SB_OK)
        result = ndli_rod_allocate(def, &made, error);
    if (result == SB_OK)
        result = ndli_rod_fill(made, def, &stiffness, error);
    if (result == SB_OK)
        *rod = made;
    else
        ndl_rod_destroy(made);
    return result;
}

NDL_API void ndl_rod_destroy(ndl_rod *rod)
{
    sb_allocator allocator;
    if (!rod)
        return;
    allocator = rod->allocator;
    sbi_free(&allocator, rod->memory);
    sbi_free(&allocator, rod);
}

/* ---- state ---- */

NDLI_API void ndli_rod_publish(ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++) {
        rod->public_x[i] = ndli_to(rod->x[i]);
        rod->public_v[i] = ndli_to(rod->v[i]);
        rod->public_reaction[i] = ndli_to(rod->reaction[i]);
    }
}

/* Copies of the arrays that make the state, or back. */
static void ndli_rod_copy_state(ndl_rod *rod, int save)
{
    ndli_v3 *vectors[NDLI_ROD_SAVED_NODES];
    double *reals[NDLI_ROD_SAVED_REALS];
    size_t n = (size_t)rod->node_count;
    vectors[0] = rod->x, vectors[1] = rod->v, vectors[2] = rod->a;
    vectors[3] = rod->director, vectors[4] = rod->tangent, vectors[5] = rod->reaction;
    reals[0] = rod->theta, reals[1] = rod->reaction_torque, reals[2] = rod->anchor;
    for (size_t k = 0; k < NDLI_ROD_SAVED_NODES; k++)
        memcpy(save ? rod->saved_nodes + k * n : vectors[k], save ? vectors[k] : rod->saved_nodes + k * n,
               n * sizeof(ndli_v3));
    for (size_t k = 0; k < NDLI_ROD_SAVED_REALS; k++)
        memcpy(save ? rod->saved_reals + k * n : reals[k], save ? reals[k] : rod->saved_reals + k * n,
               n * sizeof(double));
}

NDLI_API void ndli_rod_save(ndl_rod *rod) { ndli_rod_copy_state(rod, 1); }
NDLI_API void ndli_rod_restore(ndl_rod *rod) { ndli_rod_copy_state(rod, 0); }

NDLI_API int ndli_rod_moved(ndl_rod *rod)
{
    int bad = ndli_rod_follow(rod);
    if (bad < 0)
        ndli_rod_slip(rod);
    return bad;
}

NDLI_API int ndli_rod_follow(ndl_rod *rod)
{
    int bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    double turned = 0;
    if (bad >= 0)
        return bad;
    rod->director[0] = ndli_rod_across(rod->shape.director[0], rod->shape.tangent[0]);
    rod->tangent[0] = rod->shape.tangent[0];
    for (int j = 1; j < ndli_rod_edges(rod); j++) {
        double before = rod->theta[j]; /* theta[j - 1] has turned already */
        turned += rod->shape.twist[j] - (before - (rod->theta[j - 1] - turned));
        rod->theta[j] = before + turned;
        rod->anchor[j] += turned;
        rod->tangent[j] = rod->shape.tangent[j];
        rod->director[j] = ndli_rod_across(
            ndli_rod_transport(rod->tangent[j - 1], rod->tangent[j], rod->director[j - 1]), rod->tangent[j]);
    }
    ndli_rod_relax(rod);
    return -1;
}

NDLI_API void ndli_rod_rest_changed(ndl_rod *rod)
{
    int n = rod->node_count;
    for (int i = 0; i < n; i++) {
        double before = i > 0 ? rod->rest_length[i - 1] : 0, after = i < n - 1 ? rod->rest_length[i] : 0;
        rod->cell[i] = 0.5 * (before + after);
        rod->mass[i] = rod->line_density * rod->cell[i];
    }
    if (n > 3 && rod->held[0] && rod->held[1]) /* half of node 1's cell lies in the clamp */
        rod->cell[1] = 0.5 * rod->rest_length[1];
    if (n > 3 && rod->held[n - 1] && rod->held[n - 2])
        rod->cell[n - 2] = 0.5 * rod->rest_length[n - 3];
}

/* ---- supports and loads ---- */

static int ndli_rod_has_node(const ndl_rod *rod, int node) { return node >= 0 && node < rod->node_count; }

/* Where a new support or load begins the energy may become another. */
static void ndli_rod_touched(ndl_rod *rod) { rod->energy_monitored = 0; }

static void ndli_rod_set_target(ndl_rod *rod, int node, ndli_v3 position, const ndli_v3 *velocity)
{
    rod->held[node] = 1;
    rod->target[node] = position;
    rod->has_velocity[node] = velocity != NULL;
    if (velocity)
        rod->target_velocity[node] = *velocity;
    ndli_rod_rest_changed(rod);
    ndli_rod_touched(rod);
}

NDL_API sb_result ndl_rod_hold(ndl_rod *rod, int node, sb_vec3 position, const sb_vec3 *velocity)
{
    ndli_v3 v = ndli_v(0, 0, 0);
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    if (!sb_v3_is_finite(position) || (velocity && !sb_v3_is_finite(*velocity)))
        return SB_ERROR_NOT_FINITE;
    if (velocity)
        v = ndli_from(*velocity);
    ndli_rod_set_target(rod, node, ndli_from(position), velocity ? &v : NULL);
    return SB_OK;
}

NDL_API sb_result ndl_rod_release(ndl_rod *rod, int node)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    rod->held[node] = rod->has_velocity[node] = 0;
    if (node < 2)
        rod->base_director_set = 0;
    ndli_rod_rest_changed(rod);
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_turn(ndl_rod *rod, int edge, sb_real angle)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    if (!sb_is_finite(angle))
        return SB_ERROR_NOT_FINITE;
    rod->turn_held[edge] = 1;
    rod->turn[edge] += (double)angle;
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_release_turn(ndl_rod *rod, int edge)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    rod->turn_held[edge] = 0;
    rod->turn[edge] = 0;
    if (edge == 0)
        rod->base_director_set = 0;
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_hold_base(ndl_rod *rod, sb_vec3 position, sb_vec3 tangent, sb_vec3 director,
                                    const sb_vec3 *velocity, const sb_vec3 *angular_velocity)
{
    ndli_v3 t = ndli_from(tangent), x = ndli_from(position), d = ndli_from(director), v0, v1, axis;
    double size = ndli_norm(t);
    if (!rod || !velocity != !angular_velocity)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(position) || !sb_v3_is_finite(tangent) || !sb_v3_is_finite(director) ||
        (velocity && (!sb_v3_is_finite(*velocity) || !sb_v3_is_finite(*angular_velocity))))
        return SB_ERROR_NOT_FINITE;
    if (!(size > 0) || !(ndli_norm(ndli_cross(t, d)) > 1e-6 * size * ndli_norm(d)))
        return SB_ERROR_ARGUMENT;
    t = ndli_scale(1 / size, t);
    axis = ndli_scale(rod->rest_length[0], t);
    v0 = v1 = ndli_v(0, 0, 0);
    if (velocity) {
        v0 = ndli_from(*velocity);
        v1 = ndli_add(v0, ndli_cross(ndli_from(*angular_velocity), axis));
    }
    ndli_rod_set_target(rod, 0, x, velocity ? &v0 : NULL);
    ndli_rod_set_target(rod, 1, ndli_add(x, axis), velocity ? &v1 : NULL);
    rod->turn_held[0] = 1;
    rod->turn[0] = 0;
    rod->base_director_set = 1;
    rod->base_director = ndli_rod_across(d, t);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_force(ndl_rod *rod, int node, sb_vec3 force)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    if (!sb_v3_is_finite(force))
        return SB_ERROR_NOT_FINITE;
    rod->force[node] = ndli_from(force);
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_torque(ndl_rod *rod, int edge, sb_real torque)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    if (!sb_is_finite(torque))
        return SB_ERROR_NOT_FINITE;
    rod->torque[edge] = (double)torque;
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_gravity(ndl_rod *rod, sb_vec3 gravity)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(gravity))
        return SB_ERROR_NOT_FINITE;
    rod->gravity = ndli_from(gravity);
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_damping(ndl_rod *rod, sb_real stretch, sb_real bending)
{
    if (!rod || !ndli_rod_not_negative(stretch) || !ndli_rod_not_negative(bending))
        return SB_ERROR_ARGUMENT;
    rod->damping_stretch = (double)stretch;
    rod->damping_bending = (double)bending;
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_positions(ndl_rod *rod, const sb_vec3 *positions, sb_error *error)
{
    int bad;
    if (!rod || !positions)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rod or positions is NULL");
    for (int i = 0; i < rod->node_count; i++)
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d is not finite", i);
    ndli_rod_save(rod);
    for (int i = 0; i < rod->node_count; i++)
        rod->x[i] = ndli_from(positions[i]);
    bad = ndli_rod_moved(rod);
    if (bad >= 0) {
        ndli_rod_restore(rod);
        return sbi_fail_node(error, SB_ERROR_MESH, bad, "the rod has no length or turns back at node %d", bad);
    }
    for (int i = 0; i < rod->node_count; i++)
        if (rod->held[i])
            rod->target[i] = rod->x[i];
    memset(rod->a, 0, (size_t)rod->node_count * sizeof *rod->a);
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_velocities(ndl_rod *rod, const sb_vec3 *velocities)
{
    if (!rod || !velocities)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < rod->node_count; i++)
        if (!sb_v3_is_finite(velocities[i]))
            return SB_ERROR_NOT_FINITE;
    for (int i = 0; i < rod->node_count; i++)
        rod->v[i] = ndli_from(velocities[i]);
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

/* ---- changing the number of nodes ---- */

/* Opens a place at `at` in an array of `count` things, or closes the one there. */
static void ndli_rod_shift(void *array, size_t size, int at, int count, int open)
{
    char *place = (char *)array + (size_t)at * size;
    size_t rest = (size_t)(count - at) * size;
    if (open)
        memmove(place + size, place, rest);
    else
        memmove(place, place + size, rest - size);
}

static void ndli_rod_shift_all(ndl_rod *rod, int node, int edge, int open)
{
    int n = rod->node_count;
    ndli_v3 *node_vectors[6], *edge_vectors[2];
    double *edge_reals[8];
    node_vectors[0] = rod->x, node_vectors[1] = rod->v, node_vectors[2] = rod->a, node_vectors[3] = rod->target;
    node_vectors[4] = rod->target_velocity, node_vectors[5] = rod->force;
    edge_vectors[0] = rod->director, edge_vectors[1] = rod->tangent;
    edge_reals[0] = rod->theta, edge_reals[1] = rod->rest_length, edge_reals[2] = rod->turn;
    edge_reals[3] = rod->torque, edge_reals[4] = rod->reaction_torque;
    edge_reals[5] = rod->grip, edge_reals[6] = rod->grip_limit, edge_reals[7] = rod->anchor;
    for (int k = 0; k < 6; k++)
        ndli_rod_shift(node_vectors[k], sizeof(ndli_v3), node, n, open);
    ndli_rod_shift(rod->reaction, sizeof(ndli_v3), node, n, open);
    ndli_rod_shift(rod->rest_bend, sizeof *rod->rest_bend, node, n, open);
    ndli_rod_shift(rod->held, 1, node, n, open);
    ndli_rod_shift(rod->has_velocity, 1, node, n, open);
    for (int k = 0; k < 2; k++)
        ndli_rod_shift(edge_vectors[k], sizeof(ndli_v3), edge, n - 1, open);
    for (int k = 0; k < 8; k++)
        ndli_rod_shift(edge_reals[k], sizeof(double), edge, n - 1, open);
    ndli_rod_shift(rod->turn_held, 1, edge, n - 1, open);
    rod->node_count += open ? 1 : -1;
}

/* Tangent at a node: that of the edges on both sides. */
static ndli_v3 ndli_rod_node_tangent(const ndl_rod *rod, int i)
{
    ndli_v3 before = rod->tangent[sbi_max_int(i - 1, 0)], after = rod->tangent[sbi_min_int(i, rod->node_count - 2)];
    ndli_v3 sum = ndli_add(before, after);
    return ndli_scale(1 / ndli_norm(sum), sum);
}

/* Rest curvature (1/m) of node i, or of its neighbour on the other side of the edge where i is an end. */
static void ndli_rod_rest_density(const ndl_rod *rod, int i, int other, double density[2])
{
    int from = i > 0 && i < rod->node_count - 1 ? i : other;
    int known = from > 0 && from < rod->node_count - 1;
    for (int k = 0; k < 2; k++)
        density[k] = known ? rod->rest_bend[from][k] / rod->cell[from] : 0;
}

static void ndli_rod_set_rest_density(ndl_rod *rod, int i, const double density[2])
{
    for (int k = 0; k < 2; k++)
        rod->rest_bend[i][k] = i > 0 && i < rod->node_count - 1 ? density[k] * rod->cell[i] : 0;
}

/* What holds or turns an edge stays at its outer half, when the edge is cut: towards the end that it is next to. */
static void ndli_rod_split_turn(ndl_rod *rod, int edge)
{
    int both = rod->held[edge] && rod->held[edge + 2], outer = edge > 0 && edge + 1 == ndli_rod_edges(rod) - 1;
    int inner_half = outer ? edge : edge + 1;
    if (!both) {
        rod->turn_held[inner_half] = 0;
        rod->turn[inner_half] = 0;
    }
    rod->torque[inner_half] = 0;
}

NDL_API sb_result ndl_rod_split_edge(ndl_rod *rod, int edge)
{
    ndli_v3 middle, bow;
    double densities[3][2];
    int straight;
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    if (rod->node_count == rod->capacity)
        return SB_ERROR_UNSUPPORTED;
    straight = rod->held[edge] && rod->held[edge + 1];
    middle = ndli_scale(0.5, ndli_add(rod->x[edge], rod->x[edge + 1]));
    bow = ndli_sub(ndli_rod_node_tangent(rod, edge), ndli_rod_node_tangent(rod, edge + 1));
    ndli_rod_rest_density(rod, edge, edge + 1, densities[0]);
    ndli_rod_rest_density(rod, edge + 1, edge, densities[2]);
    for (int k = 0; k < 2; k++)
        densities[1][k] = 0.5 * (densities[0][k] + densities[2][k]);
    if (!straight)
        middle = ndli_madd(middle, ndli_norm(ndli_sub(rod->x[edge + 1], rod->x[edge])) / 8, bow);
    ndli_rod_shift_all(rod, edge + 1, edge + 1, 1);
    rod->x[edge + 1] = middle;
    rod->v[edge + 1] = ndli_scale(0.5, ndli_add(rod->v[edge], rod->v[edge + 2]));
    rod->a[edge + 1] = ndli_scale(0.5, ndli_add(rod->a[edge], rod->a[edge + 2]));
    rod->target[edge + 1] = ndli_scale(0.5, ndli_add(rod->target[edge], rod->target[edge + 2]));
    rod->held[edge + 1] = (unsigned char)straight;
    rod->has_velocity[edge + 1] = 0;
    rod->force[edge + 1] = rod->reaction[edge + 1] = ndli_v(0, 0, 0);
    rod->tangent[edge + 1] = rod->tangent[edge];
    rod->director[edge + 1] = rod->director[edge];
    rod->theta[edge + 1] = rod->theta[edge];
    rod->turn_held[edge + 1] = rod->turn_held[edge];
    rod->turn[edge + 1] = rod->turn[edge];
    rod->torque[edge + 1] = rod->torque[edge];
    rod->reaction_torque[edge + 1] = 0;
    ndli_rod_split_grip(rod, edge);
    rod->rest_length[edge] *= 0.5;
    rod->rest_length[edge + 1] = rod->rest_length[edge];
    ndli_rod_split_turn(rod, edge);
    ndli_rod_rest_changed(rod);
    for (int k = 0; k < 3; k++)
        ndli_rod_set_rest_density(rod, edge + k, densities[k]);
    ndli_rod_moved(rod); /* the bow is too flat to fold the rod */
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

/* Takes node i's share of what is conserved to its neighbours: `after` to the next, the rest to the one before. */
static void ndli_rod_share(ndl_rod *rod, int i, double after)
{
    int n = rod->node_count;
    double bend_after = i + 1 == n - 1 ? 0 : i - 1 == 0 ? 1 : after;
    double before_length = rod->rest_length[i - 1], after_length = rod->rest_length[i], light;
    ndli_v3 lost = ndli_scale(0.5 * (before_length + after_length), rod->v[i]);
    for (int k = 0; k < 2 && n > 3; k++) {
        rod->rest_bend[i - 1][k] += (1 - bend_after) * rod->rest_bend[i][k];
        rod->rest_bend[i + 1][k] += bend_after * rod->rest_bend[i][k];
    }
    rod->force[i - 1] = ndli_madd(rod->force[i - 1], 1 - after, rod->force[i]);
    rod->force[i + 1] = ndli_madd(rod->force[i + 1], after, rod->force[i]);
    lost = ndli_madd(ndli_madd(lost, -0.5 * after_length, rod->v[i - 1]), -0.5 * before_length, rod->v[i + 1]);
    light = (rod->held[i - 1] ? 0 : rod->mass[i - 1] / rod->line_density + 0.5 * after_length) +
            (rod->held[i + 1] ? 0 : rod->mass[i + 1] / rod->line_density + 0.5 * before_length);
    for (int k = i - 1; k <= i + 1; k += 2)
        if (!rod->held[k])
            rod->v[k] = ndli_madd(rod->v[k], 1 / light, lost);
}

NDL_API sb_result ndl_rod_merge_node(ndl_rod *rod, int node)
{
    double after, length, turn, lags[2];
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    if (node == 0 || node == rod->node_count - 1 || rod->held[node])
        return SB_ERROR_UNSUPPORTED;
    length = rod->rest_length[node - 1] + rod->rest_length[node];
    after = rod->rest_length[node - 1] / length;
    turn = (1 - after) * (rod->theta[node] - rod->theta[node - 1]);
    /* a rod that a merged edge would fold keeps its node */
    if (!(1 + ndli_dot(rod->tangent[node - 1], rod->tangent[node]) > 1))
        return SB_ERROR_UNSUPPORTED;
    for (int k = 0; k < 2; k++)
        lags[k] = rod->theta[node - 1 + k] - rod->anchor[node - 1 + k];
    ndli_rod_share(rod, node, after);
    rod->theta[node - 1] += rod->turn_held[node - 1] ? 0 : turn;
    rod->rest_length[node] = length;
    rod->turn_held[node] |= rod->turn_held[node - 1];
    rod->turn[node] += rod->turn[node - 1];
    rod->torque[node] += rod->torque[node - 1];
    rod->theta[node] = rod->theta[node - 1];
    ndli_rod_merge_grip(rod, node - 1, node, lags);
    rod->tangent[node] = rod->tangent[node - 1];
    rod->director[node] = rod->director[node - 1];
    ndli_rod_shift_all(rod, node, node - 1, 0);
    ndli_rod_rest_changed(rod);
    ndli_rod_moved(rod);
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_feed(ndl_rod *rod, sb_real length)
{
    double densities[2][2], now;
    if (!rod || rod->node_count < 3)
        return SB_ERROR_ARGUMENT;
    if (!sb_is_finite(length))
        return SB_ERROR_NOT_FINITE;
    now = rod->rest_length[1] + (double)length;
    if (!(now > 1e-3 * rod->rest_length[0]) || !(ndli_norm(ndli_sub(rod->x[2], rod->x[1])) > 2e-3 * now))
        return SB_ERROR_ARGUMENT;
    ndli_rod_rest_density(rod, 1, 2, densities[0]);
    ndli_rod_rest_density(rod, 2, 1, densities[1]);
    rod->rest_length[1] = now;
    ndli_rod_rest_changed(rod);
    for (int k = 0; k < 2; k++)
        ndli_rod_set_rest_density(rod, 1 + k, densities[k]);
    ndli_rod_relax(rod);
    ndli_rod_slip(rod);
    ndli_rod_touched(rod);
    return SB_OK;
}

/* ---- readings ---- */

NDL_API int ndl_rod_node_count(const ndl_rod *rod) { return rod ? rod->node_count : 0; }
NDL_API const sb_vec3 *ndl_rod_positions(const ndl_rod *rod) { return rod ? rod->public_x : NULL; }
NDL_API const sb_vec3 *ndl_rod_velocities(const ndl_rod *rod) { return rod ? rod->public_v : NULL; }
NDL_API const sb_vec3 *ndl_rod_reactions(const ndl_rod *rod) { return rod ? rod->public_reaction : NULL; }
NDL_API sb_real ndl_rod_mass(const ndl_rod *rod, int node)
{
    return rod && node >= 0 && node < rod->node_count ? (sb_real)rod->mass[node] : 0;
}
NDL_API sb_real ndl_rod_rest_length(const ndl_rod *rod, int edge)
{
    return ndli_rod_has_edge(rod, edge) ? (sb_real)rod->rest_length[edge] : 0;
}
NDL_API sb_real ndl_rod_reaction_torque(const ndl_rod *rod, int edge)
{
    return ndli_rod_has_edge(rod, edge) ? (sb_real)rod->reaction_torque[edge] : 0;
}

NDL_API ndl_frame ndl_rod_frame(const ndl_rod *rod, int edge)
{
    ndl_frame frame;
    ndli_v3 t, d, across;
    double s, c;
    memset(&frame, 0, sizeof frame);
    if (!ndli_rod_has_edge(rod, edge))
        return frame;
    t = rod->tangent[edge], d = rod->director[edge], across = ndli_cross(t, d);
    sbi_dense_sin_cos(rod->theta[edge], &s, &c);
    frame.m1 = ndli_to(ndli_madd(ndli_scale(c, d), s, across));
    frame.m2 = ndli_to(ndli_madd(ndli_scale(-s, d), c, across));
    frame.t = ndli_to(t);
    return frame;
}

NDL_API void ndl_rod_tip(const ndl_rod *rod, sb_vec3 *position, ndl_frame *frame)
{
    if (!rod)
        return;
    if (position)
        *position = rod->public_x[rod->node_count - 1];
    if (frame)
        *frame = ndl_rod_frame(rod, rod->node_count - 2);
}

NDL_API void ndl_rod_curvature(const ndl_rod *rod, int node, sb_real curvature[2])
{
    double w[2];
    if (!ndli_rod_is_inner(rod, node) || !curvature)
        return;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    w[0] = ndli_dot(rod->shape.binormal[node], ndli_add(rod->shape.m2[node - 1], rod->shape.m2[node]));
    w[1] = -ndli_dot(rod->shape.binormal[node], ndli_add(rod->shape.m1[node - 1], rod->shape.m1[node]));
    for (int k = 0; k < 2; k++)
        curvature[k] = (sb_real)(0.5 * w[k] / rod->cell[node]);
}

NDL_API sb_real ndl_rod_twist(const ndl_rod *rod, int node)
{
    return ndli_rod_is_inner(rod, node) ? (sb_real)(rod->theta[node] - rod->theta[node - 1]) : 0;
}

NDL_API ndl_rod_energy ndl_rod_energies(const ndl_rod *rod)
{
    ndl_rod_energy none;
    ndl_rod_energy energy;
    ndli_rod_sums sums;
    double kinetic = 0;
    if (!rod) {
        memset(&none, 0, sizeof none);
        return none;
    }
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    sums = ndli_rod_shape_energy(rod);
    for (int i = 0; i < rod->node_count; i++)
        kinetic += 0.5 * rod->mass[i] * ndli_dot(rod->v[i], rod->v[i]);
    energy.stretch = (sb_real)sums.stretch;
    energy.bend = (sb_real)sums.bend;
    energy.twist = (sb_real)sums.twist;
    energy.kinetic = (sb_real)kinetic;
    energy.grip = (sb_real)sums.grip;
    return energy;
}

NDL_API void ndl_rod_forces(ndl_rod *rod, sb_vec3 *forces)
{
    if (!rod || !forces)
        return;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    ndli_rod_set_damping_shape(rod);
    ndli_rod_add_damping_force(rod, rod->v, rod->gradient);
    for (int i = 0; i < rod->node_count; i++)
        forces[i] = ndli_to(ndli_scale(-1, rod->gradient[i]));
}

NDL_API void ndl_rod_base_wrench(const ndl_rod *rod, sb_vec3 *force, sb_vec3 *torque)
{
    ndli_v3 moment;
    if (!rod)
        return;
    moment = ndli_cross(ndli_sub(rod->x[1], rod->x[0]), rod->reaction[1]);
    if (force)
        *force = ndli_to(ndli_add(rod->reaction[0], rod->reaction[1]));
    if (torque)
        *torque = ndli_to(ndli_madd(moment, rod->reaction_torque[0], rod->tangent[0]));
}
