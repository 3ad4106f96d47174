/* needle_step: one step of a tissue and its needles. Sleeves are moved and fed, one linear system gives the motion of
 * all, the remesher follows the tips, and the rods' nodes follow the remesher. */
#include "couple_solve.h"
#include "needle_state.h"

#include <string.h>

static double ndli_step_now(const ndl_tissue *t) { return t->clock ? t->clock() : 0.0; }

/* ---- sleeves ---- */

NDL_API sb_result ndl_needle_move_base(ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director)
{
    ndli_v3 axis = ndli_from(direction), side = ndli_from(director);
    double length = ndli_norm(axis), width;
    if (!needle)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(base) || !sb_v3_is_finite(direction) || !sb_v3_is_finite(director))
        return SB_ERROR_NOT_FINITE;
    if (!(length > 0))
        return SB_ERROR_ARGUMENT;
    axis = ndli_scale(1 / length, axis);
    width = ndli_norm(side);
    side = ndli_madd(side, -ndli_dot(side, axis), axis);
    if (width > 0 && !(ndli_norm(side) > 1e-6 * width))
        return SB_ERROR_ARGUMENT;
    if (!(1 + ndli_dot(axis, needle->axis) > 0.01))
        return SB_ERROR_ARGUMENT;
    needle->given_outlet = ndli_from(base);
    needle->given_axis = axis;
    needle->given_director = width > 0 ? ndli_scale(1 / ndli_norm(side), side) : side;
    needle->base_given = 1;
    return SB_OK;
}

/* v turned by the angle |w| about w. */
static ndli_v3 ndli_step_turned(ndli_v3 v, ndli_v3 w)
{
    double angle = ndli_norm(w), s, c;
    ndli_v3 n, out;
    if (!(angle > 0))
        return v;
    sbi_dense_sin_cos(angle, &s, &c);
    n = ndli_scale(1 / angle, w);
    out = ndli_madd(ndli_scale(c, v), s, ndli_cross(n, v));
    return ndli_madd(out, (1 - c) * ndli_dot(n, v), n);
}

/* How far the base's m1, carried with its edge to `axis`, is from the given director (rad). */
static double ndli_step_given_turn(const ndl_needle *needle, ndli_v3 axis)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 d = ndli_rod_transport(rod->tangent[0], axis, rod->director[0]), m1;
    double s, c;
    if (!(ndli_norm(needle->given_director) > 0))
        return 0;
    sbi_dense_sin_cos(rod->theta[0], &s, &c);
    m1 = ndli_madd(ndli_scale(c, d), s, ndli_cross(axis, d));
    return sbi_dense_atan2(ndli_dot(ndli_cross(m1, needle->given_director), axis),
                           ndli_dot(m1, needle->given_director));
}

/* Where the sleeve is after a substep, and how far it turns the needle; `left` substeps, this one counted. */
typedef struct ndli_sleeve {
    ndli_v3 outlet, axis;
    double turn;
} ndli_sleeve;

static ndli_sleeve ndli_step_sleeve(const ndl_needle *needle, const ndl_command *command, double dt, int left)
{
    ndli_v3 spin = ndli_from(command->angular_velocity), swing;
    ndli_sleeve sleeve;
    double along = ndli_dot(spin, needle->axis);
    swing = ndli_madd(spin, -along, needle->axis);
    sleeve.outlet = ndli_madd(needle->outlet, dt, ndli_from(command->velocity));
    sleeve.axis = ndli_step_turned(needle->axis, ndli_scale(dt, swing));
    sleeve.turn = dt * ((double)command->twist + along);
    if (needle->base_given) {
        double share = 1.0 / left;
        ndli_v3 axis = ndli_add(sleeve.axis, ndli_scale(share, ndli_sub(needle->given_axis, sleeve.axis)));
        sleeve.outlet = ndli_madd(sleeve.outlet, share, ndli_sub(needle->given_outlet, sleeve.outlet));
        sleeve.axis = axis;
        sleeve.turn += share * ndli_step_given_turn(needle, ndli_scale(1 / ndli_norm(axis), axis));
    }
    sleeve.axis = ndli_scale(1 / ndli_norm(sleeve.axis), sleeve.axis);
    return sleeve;
}

/* Feeds what is there to be fed: a needle drawn in to its last two edges is held, and so is one without free nodes. */
static void ndli_step_feed(ndl_needle *needle, double length)
{
    ndl_rod *rod = needle->rod;
    double left = rod->rest_length[1] + length;
    if (length == 0)
        return;
    if ((length < 0 && left < 0.2 * needle->edge_length) || (length > 0 && rod->node_count + 4 > rod->capacity) ||
        ndl_rod_feed(rod, (sb_real)length) != SB_OK) {
        needle->limited = 1;
        return;
    }
    needle->fed += length;
}

static void ndli_step_aim(ndl_needle *needle, const ndl_command *command, double dt, int left)
{
    ndl_rod *rod = needle->rod;
    ndli_sleeve sleeve = ndli_step_sleeve(needle, command, dt, left);
    double length = dt * (double)command->insertion;
    needle->pushed = length + ndli_dot(ndli_sub(sleeve.outlet, needle->outlet), sleeve.axis) > 0;
    ndli_step_feed(needle, length);
    rod->target[1] = sleeve.outlet;
    rod->target[0] = ndli_madd(sleeve.outlet, -rod->rest_length[0], sleeve.axis);
    ndli_rod_turn_base(rod, sleeve.turn);
    needle->outlet = sleeve.outlet;
    needle->axis = sleeve.axis;
}

/* ---- tips ---- */

/* Deformation gradient about a tissue node: the mean over its tets, by volume. */
static sb_mat3 ndli_step_gradient(const ndl_tissue_mesh *mesh, int node)
{
    sb_mat3 sum = sb_m3_zero();
    sb_real total = 0;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_real volume = mesh->volumes[k / 4];
        sb_mat3 material, space;
        for (int c = 0; c < 3; c++) {
            sb_vec3 a = sb_v3_sub(mesh->X[n[c + 1]], mesh->X[n[0]]), b = sb_v3_sub(mesh->x[n[c + 1]], mesh->x[n[0]]);
            material.m[0][c] = a.x, material.m[1][c] = a.y, material.m[2][c] = a.z;
            space.m[0][c] = b.x, space.m[1][c] = b.y, space.m[2][c] = b.z;
        }
        sum = sb_m3_add(sum, sb_m3_scale(volume, sb_m3_mul(space, sb_m3_inverse(material))));
        total += volume;
    }
    return sb_m3_scale(1 / total, sum);
}

static ndli_v3 ndli_step_unit(ndli_v3 v) { return ndli_scale(1 / ndli_norm(v), v); }

static ndli_v3 ndli_step_mapped(const sb_mat3 *f, ndli_v3 v) { return ndli_from(sb_m3_apply(*f, ndli_to(v))); }

NDLI_API ndli_v3 ndli_needle_heading(const ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndli_v3 t = rod->tangent[last - 1], ahead;
    sb_mat3 f;
    if (needle->shallow || needle->line.count == 0 || needle->bevel.law != NDL_BEVEL_CURVATURE)
        return t;
    f = ndli_step_gradient(&needle->tissue->mesh, needle->path[needle->line.count - 1]);
    ahead = ndli_step_mapped(&f, needle->heading);
    return ndli_dot(ahead, t) > 0 ? ndli_step_unit(ahead) : t;
}

/* How far (m, in space) a bevel puts the tip aside that has gone `advance` along the last edge (section 6). By
 * NDL_BEVEL_CURVATURE it leaves the edge for the circle that continues the path, whose heading turns with it. */
static ndli_v3 ndli_step_aside(const ndl_needle *needle, double advance, double edge, ndli_v3 *heading)
{
    int last = needle->rod->node_count - 1;
    ndl_frame frame = ndl_rod_frame(needle->rod, last - 1);
    ndli_v3 m2 = ndli_from(frame.m2), t = ndli_from(frame.t), lag;
    double curvature = (double)needle->bevel.curvature, size, most;
    if (needle->bevel.law == NDL_BEVEL_ANGLE) {
        sb_real offset = 0;
        ndl_bevel_offset(&needle->bevel, (sb_real)advance, (sb_real)edge, &offset);
        return ndli_scale((double)offset, m2);
    }
    lag = ndli_madd(*heading, -ndli_dot(*heading, t), t);
    size = ndli_norm(lag);
    most = 2 * fabs(curvature) * fmax(edge, needle->tissue->site->mean_edge); /* a chord lags by half its arc's turn */
    if (size > most) {
        lag = ndli_scale(most / size, lag);
        *heading = ndli_step_unit(ndli_add(t, lag));
    }
    *heading = ndli_step_unit(ndli_madd(*heading, curvature * advance, m2));
    return ndli_scale(advance, ndli_madd(lag, 0.5 * curvature * advance, m2));
}

/* Where the tip, now above X, cuts to in the material. */
static sb_vec3 ndli_step_bevelled(ndl_needle *needle, sb_vec3 X)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, tip = needle->path[needle->line.count - 1];
    sb_mat3 f = ndli_step_gradient(&needle->tissue->mesh, tip), inverse;
    double edge = ndli_norm(ndli_sub(rod->x[last - 1], rod->x[last])) - needle->advance;
    ndli_v3 heading, aside;
    if (!(sb_m3_det(f) > 0) || !(edge > 0))
        return X;
    inverse = sb_m3_inverse(f);
    heading = ndli_step_unit(ndli_step_mapped(&f, needle->heading));
    aside = ndli_step_aside(needle, needle->advance, edge, &heading);
    needle->heading = ndli_step_unit(ndli_step_mapped(&inverse, heading));
    return sb_v3_add(X, ndli_to(ndli_step_mapped(&inverse, aside)));
}

/* The heading of the path that is there: that of the circle through its last three nodes. */
static void ndli_step_take_heading(ndl_needle *needle)
{
    const ndl_tissue_mesh *mesh = &needle->tissue->mesh;
    ndli_v3 last, before;
    double l, b;
    int count;
    const int *path = ndl_remesh_nodes(needle->tissue->site->remesh, needle->index, &count);
    if (count < 2)
        return;
    last = ndli_from(sb_v3_sub(mesh->X[path[count - 1]], mesh->X[path[count - 2]]));
    l = ndli_norm(last);
    needle->heading = ndli_scale(1 / l, last);
    if (count < 3)
        return;
    before = ndli_from(sb_v3_sub(mesh->X[path[count - 2]], mesh->X[path[count - 3]]));
    b = ndli_norm(before);
    needle->heading = ndli_step_unit(
        ndli_madd(needle->heading, l / (l + b), ndli_sub(needle->heading, ndli_scale(1 / b, before))));
}

enum { NDLI_HOLD_STEPS = 8 };

/* A tip that the remesher cannot follow stays behind and is held for a while, so that the needle does not go on without
 * it; a collision with another needle is the step's failure, but for a needle that is not pushed: tissue that moves, or a
 * shaft that straightens, must not keep it from being drawn back. */
static sb_result ndli_step_judge(ndl_needle *needle, sb_result result, sb_error *own, sb_error *error)
{
    if (result == SB_OK)
        return SB_OK;
    needle->blocked = 1;
    needle->hold_steps = NDLI_HOLD_STEPS;
    if (result == SB_ERROR_MESH || result == SB_ERROR_MEMORY || (result == SB_ERROR_UNSUPPORTED && !needle->pushed))
        return SB_OK;
    if (error)
        *error = *own;
    return result;
}

static sb_result ndli_step_enter(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->tissue->site->remesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndl_surface_hit hit;
    sb_error own;
    if (!ndl_tissue_mesh_hit(&needle->tissue->mesh, ndli_to(rod->x[last - 1]), ndli_to(rod->x[last]), &hit))
        return SB_OK;
    return ndli_step_judge(needle, ndl_remesh_puncture(remesh, needle->index, &hit, done, &own), &own, error);
}

/* Depths (m) at which a tip gets a node of its own, and loses it. */
static double ndli_step_deep(const ndl_needle *needle) { return 0.5 * needle->tissue->site->mean_edge; }
static double ndli_step_shallow(const ndl_needle *needle) { return 0.4 * needle->tissue->site->mean_edge; }

/* Where the path from the entry gets to that goes straight to X: a bevel bends it from the skin on. *heading: how it
 * looks there. */
static sb_vec3 ndli_step_first_arc(const ndl_needle *needle, sb_vec3 X, ndli_v3 *heading)
{
    const ndl_tissue_mesh *mesh = &needle->tissue->mesh;
    const ndl_bevel *bevel = &needle->bevel;
    ndli_v3 way = ndli_from(sb_v3_sub(X, mesh->X[needle->path[0]])), side;
    double length = ndli_norm(way), curvature = bevel->law == NDL_BEVEL_CURVATURE ? (double)bevel->curvature : 0;
    sb_mat3 f = ndli_step_gradient(mesh, needle->path[0]);
    sb_real aside = (sb_real)(0.5 * curvature * length * length);
    *heading = ndli_scale(1 / length, way);
    if (!(sb_m3_det(f) > 0))
        return X;
    f = sb_m3_inverse(f);
    side = ndli_step_mapped(&f, ndli_from(ndl_rod_frame(needle->rod, needle->rod->node_count - 2).m2));
    side = ndli_rod_across(side, *heading);
    if (bevel->law == NDL_BEVEL_ANGLE)
        ndl_bevel_offset(bevel, (sb_real)length, (sb_real)length, &aside);
    *heading = ndli_step_unit(ndli_madd(*heading, curvature * length, side));
    return sb_v3_madd(X, aside, ndli_to(side));
}

/* The tip of a shallow needle: it goes on without the mesh, gets a node when it is deep enough, or leaves. */
static sb_result ndli_step_cut_shallow(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->tissue->site->remesh;
    const ndl_tissue_mesh *mesh = &needle->tissue->mesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, entry = needle->path[0];
    double depth = ndli_dot(ndli_sub(rod->x[last], ndli_from(mesh->x[entry])), rod->tangent[last - 1]);
    ndli_v3 heading;
    sb_vec3 X;
    sb_error own;
    sb_result result;
    if (depth < 0) {
        ndl_remesh_withdraw(remesh, needle->index, done, NULL);
        return SB_OK;
    }
    if (depth < ndli_step_deep(needle) || needle->hold_steps > 0)
        return SB_OK;
    ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    X = ndli_step_first_arc(needle, X, &heading);
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    needle->heading = heading;
    if (result != SB_OK) /* the first operations may have been done */
        ndli_step_take_heading(needle);
    return ndli_step_judge(needle, result, &own, error);
}

/* A tip that has come back near the skin loses its node: the mesh is that of a first contact again. */
static void ndli_step_make_shallow(ndl_needle *needle)
{
    ndl_remesh *remesh = needle->tissue->site->remesh;
    const ndl_tissue_mesh *mesh = &needle->tissue->mesh;
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first, count;
    const int *path = ndl_remesh_nodes(remesh, needle->index, &count);
    double back = needle->tissue->site->mean_edge;
    sb_vec3 entry;
    ndl_surface_hit hit;
    if (count < 2 || !((double)sb_v3_norm(sb_v3_sub(mesh->X[path[count - 1]], mesh->X[path[0]])) <
                       ndli_step_shallow(needle)))
        return;
    entry = mesh->x[path[0]];
    ndl_remesh_withdraw(remesh, needle->index, NULL, NULL);
    if (ndl_tissue_mesh_hit(mesh, sb_v3_madd(entry, (sb_real)-back, ndli_to(rod->tangent[first - 1])),
                            ndli_to(rod->x[rod->node_count - 1]), &hit))
        ndl_remesh_puncture(remesh, needle->index, &hit, NULL, NULL); /* without success it is out: a little early */
}

/* The tip goes back to X. It always gets out: where remeshing does not find a way, or another needle's element is in it,
 * the needle is stretched until its tip would be outside. */
static sb_result ndli_step_draw_back(ndl_needle *needle, sb_vec3 X, int inside, ndl_remesh_info *done)
{
    ndl_remesh *remesh = needle->tissue->site->remesh;
    sb_result result = ndl_remesh_retract(remesh, needle->index, X, done, NULL);
    needle->hold_steps = 0;
    needle->blocked = result != SB_OK && inside;
    if (result != SB_OK && !inside)
        return ndl_remesh_withdraw(remesh, needle->index, done, NULL);
    ndli_step_take_heading(needle);
    ndli_step_make_shallow(needle);
    return SB_OK;
}

static sb_result ndli_step_cut_deep(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->tissue->site->remesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, inside;
    sb_vec3 X;
    sb_error own;
    sb_result result;
    inside = ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    if (needle->advance < 0) /* where states came out inconsistent its sign, not the state's, counts */
        return ndli_step_draw_back(needle, X, inside, done);
    X = ndli_step_bevelled(needle, X);
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    if (result == SB_OK && done->outside)
        result = sbi_fail(&own, SB_ERROR_MESH, "the tip would leave the tissue");
    return ndli_step_judge(needle, result, &own, error);
}

static sb_result ndli_step_cut(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    needle->advance = needle->line.slip[ndli_line_foremost(&needle->line)];
    if (needle->advance == 0)
        return SB_OK;
    return needle->shallow ? ndli_step_cut_shallow(needle, done, error)
                                          : ndli_step_cut_deep(needle, done, error);
}

/* ---- a substep ---- */

typedef struct ndli_stepping {
    ndl_tissue *tissue;
    ndl_needle *const *needles;
    const ndl_command *commands;
    int count;
    ndli_line *lines[NDL_MAX_NEEDLES];
    ndl_step_info *info;
    sb_error *error;
} ndli_stepping;

/* The tissue nodes that needles are on leave the tissue's part of the preconditioner during the solve. */
static void ndli_step_couple_nodes(const ndli_stepping *s)
{
    struct ndli_site *site = s->tissue->site;
    site->coupled_count = 0;
    for (int k = 0; k < s->count; k++)
        for (int i = s->lines[k]->first; i <= ndli_line_foremost(s->lines[k]); i++) {
            int node = s->lines[k]->path[i - s->lines[k]->first];
            if (s->tissue->role[node] != NDLI_ROW_FREE)
                continue;
            ndli_solid_set_role(s->tissue, node, NDLI_ROW_COUPLED);
            site->coupled[site->coupled_count++] = node;
        }
}

static void ndli_step_release_nodes(ndl_tissue *t)
{
    for (int i = 0; i < t->site->coupled_count; i++)
        ndli_solid_set_role(t, t->site->coupled[i], NDLI_ROW_FREE);
    t->site->coupled_count = 0;
}

static void ndli_step_note_solve(ndl_step_info *info, const ndl_couple_info *couple)
{
    info->trials = sbi_max_int(info->trials, couple->trials);
    info->consistent = info->consistent && couple->consistent;
    info->iterations += couple->iterations;
    info->capped = info->capped || couple->capped;
    info->residual = sb_max(info->residual, couple->residual);
}

static int ndli_step_max_trials(const ndli_stepping *s)
{
    int most = 1;
    for (int k = 0; k < s->count; k++)
        most = sbi_max_int(most, s->needles[k]->max_trials);
    return most;
}

/* The tissue's accelerations and the rods' motion; nothing has moved yet. */
static sb_result ndli_step_solve(const ndli_stepping *s, double dt)
{
    ndl_couple_info couple;
    double begin, middle;
    sb_result result;
    ndli_step_couple_nodes(s);
    begin = ndli_step_now(s->tissue);
    s->tissue->led = 1;
    result = ndli_solid_begin(s->tissue, (sb_real)dt, &s->info->tissue, s->error);
    s->tissue->led = 0;
    middle = ndli_step_now(s->tissue);
    s->info->seconds_tissue += middle - begin;
    if (result == SB_OK)
        result = ndli_couple_solve(s->tissue, s->lines, s->count, dt, ndli_step_max_trials(s), &couple, s->error);
    s->info->seconds_couple += ndli_step_now(s->tissue) - middle;
    if (result == SB_OK) {
        ndli_step_note_solve(s->info, &couple);
        ndli_solid_wear(s->tissue, couple.iterations / couple.trials);
    }
    return result;
}

/* What the sleeve has to exert: the balance of the nodes in it, and the frame's torque. */
static void ndli_step_read_base(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    const ndli_v3 *r = needle->line.reaction;
    ndli_v3 arm = ndli_sub(rod->x[0], rod->x[1]);
    needle->base_force = ndli_add(r[0], r[1]);
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    needle->base_torque = ndli_madd(ndli_cross(arm, r[0]), rod->turn_gradient[0], rod->tangent[0]);
}

/* A tip that goes back stays ahead of the node before it; in a step it gets no further than where its last edge began.
 * edge: the one before the motion. */
static void ndli_step_keep_tip_ahead(ndl_needle *needle, ndli_v3 edge)
{
    ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndli_v3 now = ndli_sub(rod->x[last], rod->x[last - 1]);
    if (needle->line.slip[ndli_line_foremost(&needle->line)] < 0 && ndli_dot(now, edge) < 0.1 * ndli_dot(edge, edge))
        rod->x[last] = ndli_madd(rod->x[last - 1], 0.1, edge);
}

/* Largest strain of an edge. */
static double ndli_step_strain(const ndl_rod *rod)
{
    double most = 0;
    for (int j = 0; j + 1 < rod->node_count; j++)
        most = fmax(most, fabs(ndli_norm(ndli_sub(rod->x[j + 1], rod->x[j])) / rod->rest_length[j] - 1));
    return most;
}

/* Linear equations stretch edges that they turn far; needles break at such strains. */
static const double ndli_step_most_strain = 0.01;

/* As the linear system has found it. Returns -1, or the node at which the rod would fold. */
static int ndli_step_move_linear(ndl_needle *needle, double dt)
{
    ndl_rod *rod = needle->rod;
    const ndli_v3 *move = needle->line.move;
    ndli_v3 edge = ndli_sub(rod->x[rod->node_count - 1], rod->x[rod->node_count - 2]);
    for (int i = 0; i < rod->node_count; i++) {
        rod->x[i] = rod->held[i] ? rod->target[i] : ndli_add(rod->x[i], move[i]);
        rod->v[i] = ndli_scale(1 / dt, move[i]);
        rod->a[i] = ndli_v(0, 0, 0);
    }
    ndli_step_keep_tip_ahead(needle, edge);
    return ndli_rod_moved(rod);
}

/* Newton's method for the nodes outside, those in the tissue where the linear system has them; from the state before.
 * 0: not found. */
static int ndli_step_move_nonlinear(ndl_needle *needle, double dt)
{
    ndl_rod *rod = needle->rod;
    const ndli_line *line = &needle->line;
    int done;
    for (int i = line->first; i < line->first + line->count; i++) {
        rod->held[i] = 1;
        rod->has_velocity[i] = 0;
        rod->target[i] = ndli_add(rod->x[i], line->move[i]);
    }
    done = ndli_rod_step_euler(rod, dt);
    for (int i = line->first; i < line->first + line->count; i++)
        rod->held[i] = 0;
    for (int i = 0; i < 2 && done; i++)
        line->reaction[i] = rod->reaction[i];
    return done;
}

static sb_result ndli_step_move_rod(ndl_needle *needle, double dt, sb_error *error)
{
    ndl_rod *rod = needle->rod;
    double before = ndli_step_strain(rod);
    int linear = needle->line.count > 0; /* alone, a rod needs no linear system */
    if (linear) {
        ndli_rod_save(rod);
        linear = ndli_step_move_linear(needle, dt) < 0 && ndli_step_strain(rod) <= before + ndli_step_most_strain;
        if (!linear)
            ndli_rod_restore(rod);
    }
    if (!linear && !ndli_step_move_nonlinear(needle, dt))
        return sbi_fail(error, SB_ERROR_DIVERGED, "needle %d: no motion of the rod was found", needle->index);
    ndli_step_read_base(needle);
    return SB_OK;
}

/* The rod's nodes on those of the path. */
static sb_result ndli_step_renew(ndl_needle *needle, sb_error *error)
{
    int bad = ndli_needle_renew_nodes(needle);
    if (bad < 0)
        return SB_OK;
    if (bad >= needle->rod->capacity)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needle %d: its capacity of %d nodes is too little for what is in the tissue", needle->index,
                        needle->rod->capacity);
    return sbi_fail_node(error, SB_ERROR_DIVERGED, bad, "needle %d would fold at its node %d", needle->index, bad);
}

static sb_result ndli_step_follow(const ndli_stepping *s, ndl_needle *needle)
{
    ndl_remesh_info done;
    sb_result result;
    double begin = ndli_step_now(s->tissue), middle;
    memset(&done, 0, sizeof done);
    done.worst_quality = 1;
    needle->advance = 0;
    if (needle->line.count == 0)
        result = ndli_step_enter(needle, &done, s->error);
    else
        result = ndli_step_cut(needle, &done, s->error);
    middle = ndli_step_now(s->tissue);
    s->info->seconds_remesh += middle - begin;
    s->info->operations += done.substeps;
    s->info->worst_quality = sb_min(s->info->worst_quality, done.worst_quality);
    if (result != SB_OK)
        return result;
    result = ndli_step_renew(needle, s->error);
    s->info->seconds_needle += ndli_step_now(s->tissue) - middle;
    return result;
}

static sb_result ndli_step_prepare(const ndli_stepping *s, double dt, int left)
{
    static const ndl_command none = {0, 0, {0, 0, 0}, {0, 0, 0}};
    double begin = ndli_step_now(s->tissue);
    for (int k = 0; k < s->count; k++) {
        ndl_needle *needle = s->needles[k];
        sb_result result = ndli_needle_is_threaded(needle) ? SB_OK : ndli_step_renew(needle, s->error);
        if (result != SB_OK)
            return result;
        ndli_step_aim(needle, s->commands ? s->commands + k : &none, dt, left);
        ndli_needle_resist(needle);
        needle->hold_steps = sbi_max_int(0, needle->hold_steps - 1);
    }
    s->info->seconds_needle += ndli_step_now(s->tissue) - begin;
    return SB_OK;
}

static sb_result ndli_step_substep(const ndli_stepping *s, double dt, int left)
{
    sb_result result = ndli_step_prepare(s, dt, left);
    if (result == SB_OK)
        result = ndli_step_solve(s, dt);
    for (int k = 0; k < s->count && result == SB_OK; k++)
        result = ndli_step_move_rod(s->needles[k], dt, s->error);
    if (result == SB_OK)
        result = ndli_solid_commit(s->tissue, s->error);
    ndli_step_release_nodes(s->tissue);
    for (int k = 0; k < s->count && result == SB_OK; k++)
        result = ndli_step_follow(s, s->needles[k]);
    return result;
}

/* ---- a step ---- */

/* A step too long for linear equations, which fold a rod, is taken again in pieces down to this part. */
enum { NDLI_FINEST = 64 };

static const double ndli_step_most_substeps = 1000;

/* How far a command takes a needle in the length of half an edge, and in half a radian. */
static double ndli_step_stride(const ndl_needle *needle, const ndl_command *command, double dt)
{
    const ndl_rod *rod = needle->rod;
    double edge = needle->tissue->site->mean_edge, unit = 0.5 * (edge < needle->edge_length ? edge : needle->edge_length);
    double out = ndli_norm(ndli_sub(rod->x[sbi_min_int(needle->line.first, rod->node_count - 1)], needle->outlet));
    double way = 0, turn = 0;
    if (command) {
        double spin = ndli_norm(ndli_from(command->angular_velocity));
        way = dt * (fabs((double)command->insertion) + ndli_norm(ndli_from(command->velocity)) + out * spin);
        turn = dt * (fabs((double)command->twist) + spin);
    }
    if (needle->base_given) {
        way += ndli_norm(ndli_sub(needle->given_outlet, needle->outlet)) +
               out * ndli_norm(ndli_sub(needle->given_axis, needle->axis));
        turn += ndli_norm(ndli_sub(needle->given_axis, needle->axis)) +
                fabs(ndli_step_given_turn(needle, needle->given_axis));
    }
    return way / unit > turn / 0.5 ? way / unit : turn / 0.5;
}

static int ndli_step_is_command_finite(const ndl_command *c)
{
    return sb_is_finite(c->insertion) && sb_is_finite(c->twist) && sb_v3_is_finite(c->velocity) &&
           sb_v3_is_finite(c->angular_velocity);
}

static sb_result ndli_step_check(const ndl_tissue *tissue, ndl_needle *const *needles, int count, sb_real dt,
                                 const ndl_command *commands, int *substeps, sb_error *error)
{
    double most = 0;
    if (!tissue || !needles || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a step needs a tissue, its needles and dt > 0, not %g", (double)dt);
    if (!tissue->site || count != tissue->site->count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d needles given, the tissue has %d", count,
                        tissue->site ? tissue->site->count : 0);
    for (int k = 0; k < count; k++) {
        double stride;
        if (!needles[k] || needles[k]->tissue != tissue)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "needle %d is not of this tissue", k);
        for (int i = 0; i < k; i++)
            if (needles[i] == needles[k])
                return sbi_fail(error, SB_ERROR_ARGUMENT, "needles %d and %d are the same", i, k);
        if (commands && !ndli_step_is_command_finite(commands + k))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "command %d is not finite", k);
        stride = ndli_step_stride(needles[k], commands ? commands + k : NULL, (double)dt);
        most = stride > most ? stride : most;
    }
    if (!(most < ndli_step_most_substeps))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the commands would take %g substeps: too fast for a step of %g s", most,
                        (double)dt);
    *substeps = most > 1 ? (int)most + 1 : 1;
    return SB_OK;
}

static void ndli_step_count_states(const ndli_stepping *s)
{
    for (int k = 0; k < s->count; k++) {
        const ndl_needle *needle = s->needles[k];
        for (int i = needle->line.first; i <= ndli_line_foremost(&needle->line); i++) {
            s->info->dynamic_nodes += ndli_line_is_slipping(&needle->line, i);
            s->info->static_nodes += !ndli_line_is_slipping(&needle->line, i);
        }
        s->info->blocked += needle->blocked;
        s->info->limited += needle->limited;
    }
}

/* Takes needles out that are hardly in, when no step can be made with them: they tear out of the skin. */
static int ndli_step_tear_out(const ndli_stepping *s)
{
    int torn = 0;
    for (int k = 0; k < s->count; k++) {
        ndl_needle *needle = s->needles[k];
        if (needle->line.count == 0 || !((double)ndl_needle_depth(needle) < 0.5 * s->tissue->site->mean_edge))
            continue;
        ndl_remesh_withdraw(s->tissue->site->remesh, needle->index, NULL, NULL);
        if (ndli_needle_renew_nodes(needle) >= 0)
            return 0;
        torn++;
    }
    return torn;
}

static sb_result ndli_step_run(const ndli_stepping *s, double dt, int substeps)
{
    sb_result result = SB_OK;
    memset(s->info, 0, sizeof *s->info);
    s->info->consistent = 1;
    s->info->worst_quality = 1;
    s->info->substeps = substeps;
    for (int i = 0; i < substeps && result == SB_OK; i++)
        result = ndli_step_substep(s, dt / substeps, substeps - i);
    if (result != SB_OK)
        ndli_needle_undo(s->tissue);
    return result;
}

NDL_API sb_result ndl_step(ndl_tissue *tissue, ndl_needle *const *needles, int count, sb_real dt,
                           const ndl_command *commands, ndl_step_info *info, sb_error *error)
{
    ndl_step_info own;
    ndli_stepping s;
    sb_result result;
    double begin;
    int substeps = 1;
    s.info = info ? info : &own;
    memset(s.info, 0, sizeof *s.info);
    result = ndli_step_check(tissue, needles, count, dt, commands, &substeps, error);
    if (result != SB_OK)
        return result;
    s.tissue = tissue;
    s.needles = needles;
    s.commands = commands;
    s.count = count;
    s.error = error;
    begin = ndli_step_now(tissue);
    for (int k = 0; k < count; k++) {
        s.lines[k] = &needles[k]->line;
        needles[k]->blocked = needles[k]->limited = 0;
    }
    if (!ndli_needle_keep(tissue))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to keep the state at the start of a step");
    result = ndli_step_run(&s, (double)dt, substeps);
    for (int finer = 4; result == SB_ERROR_DIVERGED && finer <= NDLI_FINEST; finer *= 4)
        result = ndli_step_run(&s, (double)dt, finer * substeps);
    if (result == SB_ERROR_DIVERGED) {
        int torn = ndli_step_tear_out(&s);
        result = ndli_step_run(&s, (double)dt, substeps);
        s.info->torn = result == SB_OK ? torn : 0;
    }
    for (int k = 0; k < count; k++) {
        needles[k]->base_given = needles[k]->base_given && result != SB_OK;
        ndli_rod_publish(needles[k]->rod);
    }
    ndli_step_count_states(&s);
    s.info->seconds_total = ndli_step_now(tissue) - begin;
    return result;
}
