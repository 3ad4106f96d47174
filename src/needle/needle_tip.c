/* needle_tip: where a needle's tip cuts to, and the mesh that follows it there. */
#include <string.h>

#include "needle_private.h"

/* ---- where the path looks ---- */

/* Deformation gradient about a tissue node: the mean over its tets, by volume. */
static sb_mat3 ndli_tip_gradient(const ndli_topology *mesh, int node)
{
    sb_mat3 sum = sb_m3_zero();
    sb_real total = 0;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        sb_real volume = mesh->volumes[k / 4];
        sum = sb_m3_add(sum, sb_m3_scale(volume, ndli_topology_gradient(mesh, k / 4)));
        total += volume;
    }
    return sb_m3_scale(1 / total, sum);
}

static ndli_v3 ndli_tip_unit(ndli_v3 v) { return ndli_scale(1 / ndli_norm(v), v); }

static ndli_v3 ndli_tip_mapped(const sb_mat3 *f, ndli_v3 v) { return ndli_from(sb_m3_apply(*f, ndli_to(v))); }

NDLI_API ndli_v3 ndli_needle_heading(const ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndli_v3 t = rod->tangent[last - 1], ahead;
    sb_mat3 f;
    if (needle->site->embeds || needle->shallow || needle->line.count == 0 || needle->bevel.law != NDL_BEVEL_CURVATURE)
        return t;
    f = ndli_tip_gradient(needle->site->mesh, needle->path[needle->line.count - 1]);
    ahead = ndli_tip_mapped(&f, needle->heading);
    return ndli_dot(ahead, t) > 0 ? ndli_tip_unit(ahead) : t;
}

/* How far (m, in space) a bevel puts the tip aside that has gone `advance` along the last edge (section 6). By
 * NDL_BEVEL_CURVATURE it leaves the edge for the circle that continues the path, whose heading turns with it. */
static ndli_v3 ndli_tip_aside(const ndl_needle *needle, double advance, double edge, ndli_v3 *heading)
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
    most = 2 * fabs(curvature) * fmax(edge, needle->site->mean_edge); /* a chord lags by half its arc's turn */
    if (size > most) {
        lag = ndli_scale(most / size, lag);
        *heading = ndli_tip_unit(ndli_add(t, lag));
    }
    *heading = ndli_tip_unit(ndli_madd(*heading, curvature * advance, m2));
    return ndli_scale(advance, ndli_madd(lag, 0.5 * curvature * advance, m2));
}

/* Where the tip, now above X, cuts to in the material. */
static sb_vec3 ndli_tip_bevelled(ndl_needle *needle, sb_vec3 X)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, tip = needle->path[needle->line.count - 1];
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, tip), inverse;
    double edge = ndli_norm(ndli_sub(rod->x[last - 1], rod->x[last])) - needle->advance;
    ndli_v3 heading, aside;
    if (!(sb_m3_det(f) > 0) || !(edge > 0))
        return X;
    inverse = sb_m3_inverse(f);
    heading = ndli_tip_unit(ndli_tip_mapped(&f, needle->heading));
    aside = ndli_tip_aside(needle, needle->advance, edge, &heading);
    needle->heading = ndli_tip_unit(ndli_tip_mapped(&inverse, heading));
    return sb_v3_add(X, ndli_to(ndli_tip_mapped(&inverse, aside)));
}

/* The heading of the path that is there: that of the circle through its last three nodes. */
static void ndli_tip_take_heading(ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    ndli_v3 last, before;
    double l, b;
    int count;
    const int *path = ndl_remesh_nodes(needle->site->remesh, needle->index, &count);
    if (count < 2)
        return;
    last = ndli_from(sb_v3_sub(mesh->X[path[count - 1]], mesh->X[path[count - 2]]));
    l = ndli_norm(last);
    needle->heading = ndli_scale(1 / l, last);
    if (count < 3)
        return;
    before = ndli_from(sb_v3_sub(mesh->X[path[count - 2]], mesh->X[path[count - 3]]));
    b = ndli_norm(before);
    needle->heading =
        ndli_tip_unit(ndli_madd(needle->heading, l / (l + b), ndli_sub(needle->heading, ndli_scale(1 / b, before))));
}

/* ---- the mesh follows ---- */

enum { NDLI_HOLD_STEPS = 8 };

/* A tip that the remesher cannot follow stays behind and is held for a while, so that the needle does not go on without
 * it; a collision with another needle is the step's failure, but for a needle that is not pushed: tissue that moves, or
 * a shaft that straightens, must not keep it from being drawn back. */
static sb_result ndli_tip_judge(ndl_needle *needle, sb_result result, sb_error *own, sb_error *error)
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

static sb_result ndli_tip_enter(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndl_surface_hit hit;
    sb_error own;
    if (!ndli_topology_hit(needle->site->mesh, ndli_to(rod->x[last - 1]), ndli_to(rod->x[last]), &hit))
        return SB_OK;
    return ndli_tip_judge(
        needle, ndli_remesh_puncture_within(remesh, needle->index, &hit, needle->entry_slip, done, &own), &own, error);
}

/* Depths (m) at which a tip gets a node of its own, and loses it; it loses it from the first of them on where tets
 * about it are worse than would do to get one. */
static double ndli_tip_deep(const ndl_needle *needle) { return 0.5 * needle->site->mean_edge; }
static double ndli_tip_shallow(const ndl_needle *needle) { return 0.4 * needle->site->mean_edge; }

/* Quality of tets with which it gets one: the deeper it is, the less is asked for. */
static sb_real ndli_tip_enough(const ndl_needle *needle, double depth)
{
    double share = depth / ndli_tip_deep(needle);
    return share < 2 ? (sb_real)(0.3 * (2 - share)) : 0;
}

/* Where the path from the entry gets to that goes straight to X: a bevel bends it from the skin on. *heading: how it
 * looks there. */
static sb_vec3 ndli_tip_first_arc(const ndl_needle *needle, sb_vec3 X, ndli_v3 *heading)
{
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_bevel *bevel = &needle->bevel;
    ndli_v3 way = ndli_from(sb_v3_sub(X, mesh->X[needle->path[0]])), side;
    double length = ndli_norm(way), curvature = bevel->law == NDL_BEVEL_CURVATURE ? (double)bevel->curvature : 0;
    sb_mat3 f = ndli_tip_gradient(mesh, needle->path[0]);
    sb_real aside = (sb_real)(0.5 * curvature * length * length);
    *heading = ndli_scale(1 / length, way);
    if (!(sb_m3_det(f) > 0))
        return X;
    f = sb_m3_inverse(f);
    side = ndli_tip_mapped(&f, ndli_from(ndl_rod_frame(needle->rod, needle->rod->node_count - 2).m2));
    side = ndli_rod_across(side, *heading);
    if (bevel->law == NDL_BEVEL_ANGLE)
        ndl_bevel_offset(bevel, (sb_real)length, (sb_real)length, &aside);
    *heading = ndli_tip_unit(ndli_madd(*heading, curvature * length, side));
    return sb_v3_madd(X, aside, ndli_to(side));
}

/* Gives the tip its first node below the entry, at X, or on the way there when that cannot be done in one operation
 * without flat tets: many small ones would leave worse. Below skin that was pushed in X is so far that no tet about the
 * entry may come near half of the way: then places nearer to it are tried. (Not else: pushed-in skin has distorted the
 * tets there, and a node in them does not lie on the needle.) */
static sb_result ndli_tip_sink(ndl_needle *needle, double depth, sb_vec3 X, ndl_remesh_info *done)
{
    sb_real enough = ndli_tip_enough(needle, depth);
    ndl_remesh *remesh = needle->site->remesh;
    sb_vec3 entry = needle->site->mesh->X[needle->path[0]], way = sb_v3_sub(X, entry);
    double length = (double)sb_v3_norm(way), least = 0.5 * ndli_tip_deep(needle);
    sb_result result = SB_ERROR_MESH;
    int found = 0;
    for (int part = 8; result == SB_ERROR_MESH && (part >= 4 || (!found && part * length >= 8 * least));
         part -= part > 4 ? 2 : 1) {
        sb_vec3 to = sb_v3_madd(entry, (sb_real)part / 8, way);
        result = ndli_remesh_put_first(remesh, needle->index, to, enough, done);
        found |= done->candidates > 0;
    }
    return result;
}

/* The tip of a shallow needle: it goes on without the mesh, gets a node when it is deep enough, or leaves. */
static sb_result ndli_tip_cut_shallow(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, entry = needle->path[0];
    double depth = ndli_dot(ndli_sub(rod->x[last], ndli_from(mesh->x[entry])), rod->tangent[last - 1]);
    ndl_remesh_info sunk;
    ndli_v3 heading;
    sb_vec3 X;
    sb_error own;
    sb_result result;
    if (depth < 0)
        return ndl_remesh_withdraw(remesh, needle->index, done, error);
    if (depth < ndli_tip_deep(needle) || needle->hold_steps > 0)
        return SB_OK;
    ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    X = ndli_tip_first_arc(needle, X, &heading);
    result = ndli_tip_sink(needle, depth, X, &sunk);
    if (result == SB_ERROR_MESH && depth < 2 * ndli_tip_deep(needle))
        return SB_OK; /* better when it is deeper */
    if (result != SB_OK)
        memset(&sunk, 0, sizeof sunk);
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    done->substeps += sunk.substeps;
    done->candidates += sunk.candidates;
    done->smoothed += sunk.smoothed;
    done->released += sunk.released;
    needle->heading = heading;
    if (result != SB_OK) /* the first operations may have been done */
        ndli_tip_take_heading(needle);
    return ndli_tip_judge(needle, result, &own, error);
}

static int ndli_tip_is_shallow(const ndl_needle *needle, double depth, sb_real quality)
{
    return depth < ndli_tip_shallow(needle) ||
           (depth < ndli_tip_deep(needle) && quality < ndli_tip_enough(needle, depth));
}

/* A tip that has come back near the skin loses its node: the mesh is that of a first contact again. quality: of tets
 * about it */
static void ndli_tip_make_shallow(ndl_needle *needle, sb_real quality)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first, count;
    const int *path = ndl_remesh_nodes(remesh, needle->index, &count);
    double back = needle->site->mean_edge;
    sb_vec3 entry;
    ndl_surface_hit hit;
    if (count < 2 || !ndli_tip_is_shallow(
                         needle, (double)sb_v3_norm(sb_v3_sub(mesh->X[path[count - 1]], mesh->X[path[0]])), quality))
        return;
    entry = mesh->x[path[0]];
    if (ndl_remesh_withdraw(remesh, needle->index, NULL, NULL) != SB_OK)
        return; /* it stays as it is */
    if (ndli_topology_hit(mesh, sb_v3_madd(entry, (sb_real)-back, ndli_to(rod->tangent[first - 1])),
                          ndli_to(rod->x[rod->node_count - 1]), &hit))
        (void)ndli_remesh_puncture_within(remesh, needle->index, &hit, needle->entry_slip, NULL,
                                          NULL); /* without success it is out: a little early */
}

/* The tip goes back to X. It always gets out: where remeshing does not find a way, or another needle's element is in
 * it, the needle is stretched until its tip would be outside. */
static sb_result ndli_tip_draw_back(ndl_needle *needle, sb_vec3 X, int inside, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    sb_result result = ndl_remesh_retract(remesh, needle->index, X, done, NULL);
    needle->hold_steps = 0;
    needle->blocked = result != SB_OK && inside;
    if (result != SB_OK && !inside)
        return ndl_remesh_withdraw(remesh, needle->index, done, error);
    ndli_tip_take_heading(needle);
    ndli_tip_make_shallow(needle, result == SB_OK ? done->worst_quality : 1);
    return SB_OK;
}

static sb_result ndli_tip_cut_deep(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, inside;
    sb_vec3 X;
    sb_error own;
    sb_result result;
    inside = ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    if (needle->advance < 0) /* where states came out inconsistent its sign, not the state's, counts */
        return ndli_tip_draw_back(needle, X, inside, done, error);
    X = ndli_tip_bevelled(needle, X);
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    if (result == SB_OK && done->outside)
        result = sbi_fail(&own, SB_ERROR_MESH, "the tip would leave the tissue");
    return ndli_tip_judge(needle, result, &own, error);
}

NDLI_API sb_result ndli_needle_follow_tip(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    needle->advance = 0;
    if (needle->line.count == 0)
        return ndli_tip_enter(needle, done, error);
    needle->advance = needle->line.slip[ndli_line_foremost(&needle->line)];
    if (needle->advance == 0)
        return SB_OK;
    return needle->shallow ? ndli_tip_cut_shallow(needle, done, error) : ndli_tip_cut_deep(needle, done, error);
}
