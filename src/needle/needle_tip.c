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
    if (needle->site->embeds || needle->shallow || needle->line.count == 0)
        return t;
    f = ndli_tip_gradient(needle->site->mesh, needle->path[needle->line.count - 1]);
    ahead = ndli_tip_mapped(&f, needle->heading);
    return ndli_dot(ahead, t) > 0 ? ndli_tip_unit(ahead) : t;
}

/* How far the way may be from the last edge (rad): a chord lags by half its arc's turn, where it is longer than the
 * shaft's bends, and remeshing moves its nodes. By NDL_BEVEL_CURVATURE that is all there is to it. */
static double ndli_tip_lag(const ndl_needle *needle)
{
    double length = fmax(needle->rod->rest_length[needle->rod->node_count - 2], needle->site->mean_edge);
    double curvature = fabs(ndli_bevel_curvature(&needle->bevel)), lag = ndli_bevel_lag(&needle->bevel);
    if (needle->bevel.law == NDL_BEVEL_CURVATURE)
        return 2 * curvature * length;
    return lag + (1 - fmin(needle->wave / length, 1)) * 2 * fmin(curvature, lag / needle->wave) * length;
}

/* In the material, how far aside a bevel puts the tip that has advanced along the last edge; the needle's heading turns
 * with it. node: of the mesh, about which. */
static ndli_v3 ndli_tip_aside(ndl_needle *needle, int node)
{
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, node), inverse;
    ndli_v3 t = needle->rod->tangent[needle->rod->node_count - 2], heading, way;
    if (!(sb_m3_det(f) > 0) || !(needle->advance > 0))
        return ndli_v(0, 0, 0);
    inverse = sb_m3_inverse(f);
    heading = ndli_tip_unit(ndli_tip_mapped(&f, needle->heading));
    way = ndli_bevel_go(needle, needle->advance, t, ndli_tip_lag(needle), &heading);
    needle->heading = ndli_tip_unit(ndli_tip_mapped(&inverse, heading));
    return ndli_tip_mapped(&inverse, ndli_madd(way, -ndli_dot(way, t), t));
}

/* Along the shaft, about the entry. */
static ndli_v3 ndli_tip_straight(const ndl_needle *needle, int entry)
{
    ndli_v3 t = needle->rod->tangent[needle->rod->node_count - 2];
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, entry);
    if (!(sb_m3_det(f) > 0))
        return t;
    f = sb_m3_inverse(f);
    return ndli_tip_unit(ndli_tip_mapped(&f, t));
}

/* The way of a tip that has just come in. */
static void ndli_tip_begin(ndl_needle *needle)
{
    int count;
    const int *path = ndl_remesh_nodes(needle->site->remesh, needle->index, &count);
    needle->aside = ndli_v(0, 0, 0);
    needle->enters = 1;
    if (count > 0)
        needle->heading = ndli_tip_straight(needle, path[0]);
}

/* A shallow tip goes on, or back, to `depth` (m): its way bends from the skin on, before it has a node. */
static void ndli_tip_go_shallow(ndl_needle *needle, double depth)
{
    int entry = needle->path[0];
    if (needle->advance > 0) {
        needle->aside = ndli_add(needle->aside, ndli_tip_aside(needle, entry));
        return;
    }
    needle->aside = ndli_scale(depth / (depth - needle->advance), needle->aside);
    needle->heading = ndli_tip_unit(ndli_madd(ndli_tip_straight(needle, entry), 2 / depth, needle->aside));
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
    sb_result result;
    if (!ndli_topology_hit(needle->site->mesh, ndli_to(rod->x[last - 1]), ndli_to(rod->x[last]), &hit))
        return SB_OK;
    result = ndli_remesh_puncture_within(remesh, needle->index, &hit, needle->entry_slip, done, &own);
    ndli_tip_begin(needle);
    return ndli_tip_judge(needle, result, &own, error);
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

/* Where the tip is to get nodes of its own: about the entry its bend was measured. */
static void ndli_tip_land(ndl_needle *needle, int entry)
{
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, entry);
    needle->sinks = 1;
    needle->landing = ndli_add(needle->rod->x[needle->rod->node_count - 1], ndli_tip_mapped(&f, needle->aside));
}

/* The tip of a shallow needle: it goes on without the mesh, gets a node when it is deep enough, or leaves. */
static sb_result ndli_tip_cut_shallow(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, entry = needle->path[0];
    ndli_v3 from = ndli_add(ndli_from(mesh->x[entry]), needle->gap[needle->line.first]);
    double depth = ndli_dot(ndli_sub(rod->x[last], from), rod->tangent[last - 1]);
    ndl_remesh_info sunk;
    sb_vec3 X;
    sb_error own;
    sb_result result;
    if (depth < 0)
        return ndl_remesh_withdraw(remesh, needle->index, done, error);
    if (depth > 0)
        ndli_tip_go_shallow(needle, depth);
    if (depth < ndli_tip_deep(needle) || needle->hold_steps > 0)
        return SB_OK;
    ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    ndli_tip_land(needle, entry);
    X = sb_v3_add(X, ndli_to(needle->aside));
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
    needle->reaches = result == SB_OK && !done->outside;
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
    ndli_tip_begin(needle);
}

/* The tip goes back to X. It always gets out: where remeshing does not find a way, or another needle's element is in
 * it, the needle is stretched until its tip would be outside. */
static sb_result ndli_tip_draw_back(ndl_needle *needle, sb_vec3 X, int inside, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    sb_result result = ndl_remesh_retract(remesh, needle->index, X, done, NULL);
    needle->hold_steps = 0;
    needle->reaches = result == SB_OK;
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
    sb_vec3 X; /* where the tip cuts to, first straight on */
    sb_error own;
    sb_result result;
    inside = ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    if (needle->advance < 0) /* where states came out inconsistent its sign, not the state's, counts */
        return ndli_tip_draw_back(needle, X, inside, done, error);
    X = sb_v3_add(X, ndli_to(ndli_tip_aside(needle, needle->path[needle->line.count - 1])));
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    if (result == SB_OK && done->outside)
        result = sbi_fail(&own, SB_ERROR_MESH, "the tip would leave the tissue");
    needle->reaches = result == SB_OK;
    return ndli_tip_judge(needle, result, &own, error);
}

NDLI_API sb_result ndli_needle_follow_tip(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    needle->advance = 0;
    needle->enters = needle->sinks = needle->reaches = 0;
    needle->follows = 1;
    for (int k = 0; k < needle->line.count; k++)
        needle->old_X[k] = needle->site->mesh->X[needle->path[k]];
    if (needle->line.count == 0)
        return ndli_tip_enter(needle, done, error);
    needle->advance = needle->line.slip[ndli_line_foremost(&needle->line)];
    if (needle->advance == 0)
        return SB_OK;
    return needle->shallow ? ndli_tip_cut_shallow(needle, done, error) : ndli_tip_cut_deep(needle, done, error);
}
