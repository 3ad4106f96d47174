/* stuffing_share: how much of each shape a mesh keeps, and which cell would keep what is missing. */
#include "stuffing.h"
#include "surface_tree.h"

#include <stdio.h>

enum {
    SBI_SHARE_LEAST = 400, /* samples of a shape's surface */
    SBI_SHARE_MOST = 20000,
    SBI_SHARE_POINTS = 400000, /* of a box in which a function is sampled */
    SBI_SHARE_STEPS = 200      /* of a search for the far side of a function */
};

/* A point of a shape's surface, with the unit normal that points out of the shape. */
typedef struct sbi_share_sample {
    sb_vec3 at, normal;
    sb_real thickness; /* m */
    int triangle;      /* of a surface */
} sbi_share_sample;

typedef struct sbi_share {
    const sb_stuff_def *def;
    int number; /* of the shape */
    const sb_shape *shape;
    sb_vec3 low, high;         /* box that functions are sampled in */
    sbi_share_sample *samples; /* [SBI_SHARE_MOST] of the surface that lies in the first shape */
    int count, cut_off;        /* cut_off: samples outside of the first shape */
    double volume;             /* of the shape in the first one, m^3; 0: unknown */
    uint64_t dice;
} sbi_share;

/* Uniform in [0, 1), the same numbers each time (splitmix64). */
static sb_real sbi_share_dice(sbi_share *share)
{
    uint64_t z = share->dice += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return (sb_real)((double)((z ^ z >> 31) >> 11) * 1.1102230246251565e-16); /* 2^-53 */
}

static sb_real sbi_share_value(const sb_shape *shape, sb_vec3 p)
{
    return shape->surface ? sb_surface_signed_distance(shape->surface, p, NULL) : shape->distance(shape->user, p);
}

/* Whether the first shape, cut off at its box, contains a point. */
static int sbi_share_is_kept(const sbi_share *share, sb_vec3 p)
{
    const sb_shape *first = share->def->shapes;
    if (first->surface)
        return sb_surface_inside(first->surface, p);
    return p.x > share->low.x && p.y > share->low.y && p.z > share->low.z && p.x < share->high.x &&
           p.y < share->high.y && p.z < share->high.z && first->distance(first->user, p) < 0;
}

static void sbi_share_add(sbi_share *share, sb_vec3 at, sb_vec3 normal, int triangle)
{
    sbi_share_sample *sample = share->samples + share->count;
    if (share->number > 0 && !sbi_share_is_kept(share, at)) {
        share->cut_off++;
        return;
    }
    if (share->count == SBI_SHARE_MOST)
        return;
    sample->at = at;
    sample->normal = normal;
    sample->triangle = triangle;
    sample->thickness = SB_REAL_MAX;
    share->count++;
}

/* Samples each triangle in proportion to its area. */
static void sbi_share_sample_surface(sbi_share *share)
{
    const sb_surface *s = share->shape->surface;
    const double inverse = (double)s->inverse, cell = (double)share->def->cell;
    double area = 0, per, due = 0.5, volume = 0;
    for (int t = 0; t < s->triangle_count; t++) {
        sb_vec3 x[3];
        sbi_surface_corners(s, t, x);
        area += 0.5 * (double)sb_v3_norm(sbi_surface_area_vector(x));
        for (int i = 0; i < 3; i++)
            x[i] = sb_v3_sub(x[i], s->centre);
        volume += (double)sb_v3_dot(x[0], sb_v3_cross(x[1], x[2])) / 6;
    }
    area *= inverse * inverse;
    per = 4 * area / (cell * cell);
    per = per < (double)SBI_SHARE_LEAST ? (double)SBI_SHARE_LEAST : per;
    per = per > 0.9 * (double)SBI_SHARE_MOST ? 0.9 * (double)SBI_SHARE_MOST : per;
    for (int t = 0; t < s->triangle_count && area > 0; t++) {
        sb_vec3 x[3], normal = sbi_surface_unit_normal(s, t);
        sbi_surface_corners(s, t, x);
        due += per * 0.5 * (double)sb_v3_norm(sbi_surface_area_vector(x)) * inverse * inverse / area;
        for (; due >= 1; due -= 1) {
            sb_real v = sbi_share_dice(share), w = sbi_share_dice(share);
            sb_vec3 p = x[0];
            if (v + w > 1)
                v = 1 - v, w = 1 - w;
            p = sb_v3_madd(sb_v3_madd(p, v, sb_v3_sub(x[1], x[0])), w, sb_v3_sub(x[2], x[0]));
            sbi_share_add(share, sb_v3_scale(s->inverse, p), normal, t);
        }
    }
    if (sb_surface_is_closed(s) && share->cut_off == 0)
        share->volume = volume * inverse * inverse * inverse;
}

static sb_vec3 sbi_share_gradient(const sb_shape *shape, sb_vec3 p, sb_real step)
{
    sb_vec3 x = sb_v3(step, 0, 0), y = sb_v3(0, step, 0), z = sb_v3(0, 0, step);
    sb_vec3 d = sb_v3(sbi_share_value(shape, sb_v3_add(p, x)) - sbi_share_value(shape, sb_v3_sub(p, x)),
                      sbi_share_value(shape, sb_v3_add(p, y)) - sbi_share_value(shape, sb_v3_sub(p, y)),
                      sbi_share_value(shape, sb_v3_add(p, z)) - sbi_share_value(shape, sb_v3_sub(p, z)));
    return sb_v3_scale((sb_real)0.5 / step, d);
}

/* Newton steps from a point near the surface of a function; keeps where they end, if that is near. */
static void sbi_share_project(sbi_share *share, sb_vec3 p, sb_real value, sb_real reach)
{
    const sb_vec3 start = p;
    sb_vec3 gradient = sb_v3(0, 0, 0);
    sb_real square = 0;
    for (int i = 0; i < 4; i++) {
        gradient = sbi_share_gradient(share->shape, p, (sb_real)0.01 * reach);
        square = sb_v3_dot(gradient, gradient);
        if (!(square > 0) || !sb_is_finite(square))
            return;
        p = sb_v3_madd(p, -value / square, gradient);
        value = sbi_share_value(share->shape, p);
        if (!(sb_v3_norm(sb_v3_sub(p, start)) <= reach))
            return;
    }
    if (sb_abs(value) <= (sb_real)0.01 * reach * sb_sqrt(square))
        sbi_share_add(share, p, sb_v3_scale((sb_real)1 / sb_sqrt(square), gradient), -1);
}

/* One random point in each cell of a grid over the box: those inside give the volume, those near the surface
 * samples. */
static void sbi_share_sample_function(sbi_share *share)
{
    sb_vec3 size = sb_v3_sub(share->high, share->low);
    sb_real h = (sb_real)0.5 * share->def->cell, slope = share->shape->max_slope;
    double n[3], share_of_near = 1, boxes, inside = 0;
    h = sb_max(h, (sb_real)cbrt((double)size.x * (double)size.y * (double)size.z / (double)SBI_SHARE_POINTS));
    n[0] = ceil((double)(size.x / h)), n[1] = ceil((double)(size.y / h)), n[2] = ceil((double)(size.z / h));
    boxes = n[0] * n[1] * n[2];
    if (boxes > 4.0 * (double)SBI_SHARE_POINTS)
        return; /* a box that is long and thin beyond reason */
    if (boxes > 2.0 * (double)SBI_SHARE_MOST)
        share_of_near = 4.0 * (double)SBI_SHARE_MOST / boxes;
    for (int k = 0; k < (int)n[2]; k++)
        for (int j = 0; j < (int)n[1]; j++)
            for (int i = 0; i < (int)n[0]; i++) {
                sb_vec3 at = sb_v3((sb_real)i + sbi_share_dice(share), (sb_real)j + sbi_share_dice(share),
                                   (sb_real)k + sbi_share_dice(share));
                sb_vec3 p =
                    sb_v3(share->low.x + at.x * size.x / (sb_real)n[0], share->low.y + at.y * size.y / (sb_real)n[1],
                          share->low.z + at.z * size.z / (sb_real)n[2]);
                sb_real value = sbi_share_value(share->shape, p);
                int is_near = slope == 0 || sb_abs(value) <= slope * h;
                inside += value < 0 && (share->number == 0 || sbi_share_is_kept(share, p));
                if (is_near && sb_is_finite(value) && (double)sbi_share_dice(share) < share_of_near)
                    sbi_share_project(share, p, value, h);
            }
    share->volume = inside / boxes * (double)size.x * (double)size.y * (double)size.z;
}

/* How far it is from each sample through the shape to the other side; no farther than `most`. */
static void sbi_share_find_thickness(sbi_share *share, sb_real most)
{
    for (int i = 0; i < share->count; i++) {
        sbi_share_sample *sample = share->samples + i;
        sb_vec3 inward = sb_v3_scale(-1, sample->normal);
        sb_real slope = share->shape->max_slope, at = (sb_real)0.001 * most;
        sample->thickness = most;
        if (share->shape->surface) {
            sb_surface_hit hits[8];
            int count = sb_surface_ray_all(share->shape->surface, sample->at, inward, most, hits, 8);
            for (int k = sbi_min_int(count, 8) - 1; k >= 0; k--)
                if (hits[k].triangle != sample->triangle && hits[k].distance > (sb_real)1e-6 * most)
                    sample->thickness = hits[k].distance;
            continue;
        }
        for (int k = 0; k < SBI_SHARE_STEPS && at < most; k++) {
            sb_real value = sbi_share_value(share->shape, sb_v3_madd(sample->at, at, inward));
            if (!(value < 0)) {
                sample->thickness = at;
                break;
            }
            at += sb_max(slope > 0 ? -value / slope : 0, (sb_real)0.01 * most);
        }
    }
}

/* The thickness that a share of the samples falls below. */
static sb_real sbi_share_quantile(const sbi_share *share, double part, sb_real most)
{
    sb_real low = 0, high = most;
    for (int round = 0; round < 40; round++) {
        sb_real middle = (sb_real)0.5 * (low + high);
        int below = 0;
        for (int i = 0; i < share->count; i++)
            below += share->samples[i].thickness <= middle;
        if (below > part * share->count)
            high = middle;
        else
            low = middle;
    }
    return high;
}

/* Whether the part of the mesh with this region and middle belongs to the shape. Regions may be those of several. */
static int sbi_share_has(const sbi_share *share, const sb_mesh *mesh, int e)
{
    const sb_stuff_def *def = share->def;
    int same = 0, later = 0, others = 0;
    const int *nodes = mesh->elements + 4 * (size_t)e;
    sb_vec3 middle = sb_v3(0, 0, 0);
    for (int k = 0; k < def->shape_count; k++) {
        same |= k == share->number && def->shapes[k].region == mesh->regions[e];
        others |= k != share->number && def->shapes[k].region == mesh->regions[e];
        later |= k > share->number && def->shapes[k].region == mesh->regions[e];
    }
    if (share->number == 0 || (same && !others))
        return 1;
    if (!same && !later)
        return 0;
    for (int i = 0; i < 4; i++)
        middle = sb_v3_madd(middle, (sb_real)0.25, mesh->nodes[nodes[i]]);
    return share->shape->surface ? sb_surface_inside(share->shape->surface, middle)
                                 : sbi_share_value(share->shape, middle) < 0;
}

/* Measures what a mesh of tet4 keeps of the sampled shape: its volume, and how many samples are near its boundary. */
static sb_result sbi_share_measure(const sbi_share *share, const sb_mesh *mesh, double *kept, int *covered,
                                   sb_error *error)
{
    const sb_allocator *allocator = &share->def->allocator;
    sb_boundary boundary;
    sb_surface *skin = NULL;
    sb_mesh part = *mesh;
    sb_result result = SB_OK;
    *kept = 0;
    *covered = 0;
    if (mesh->element_count == 0)
        return SB_OK;
    part.element_count = 0;
    part.elements = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, 4 * sizeof(int));
    if (!part.elements)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the shares of a mesh");
    for (int e = 0; e < mesh->element_count; e++) {
        if (!sbi_share_has(share, mesh, e))
            continue;
        memcpy(part.elements + 4 * (size_t)part.element_count++, mesh->elements + 4 * (size_t)e, 4 * sizeof(int));
        *kept += (double)sb_mesh_element_volume(mesh, e);
    }
    memset(&boundary, 0, sizeof boundary);
    part.regions = NULL;
    part.allocator = *allocator;
    if (part.element_count > 0)
        result = sb_mesh_boundary(&part, 1, allocator, &boundary, error);
    if (result == SB_OK && part.element_count > 0)
        result = sb_surface_create(&boundary.surface, allocator, &skin, error);
    for (int i = 0; skin && i < share->count; i++)
        *covered += sb_surface_closest(skin, share->samples[i].at, (sb_real)0.5 * share->def->cell, NULL);
    sb_surface_destroy(skin);
    sb_boundary_free(&boundary);
    sbi_free(allocator, part.elements);
    return result;
}

/* 1 when a closed surface's volume is what it encloses: a surface that crosses itself counts parts twice. */
static int sbi_share_trusts_volume(const sbi_share *share)
{
    const sb_surface *s = share->shape->surface;
    sb_surface_place crossings, crowds;
    if (!s)
        return 1;
    memset(&crossings, 0, sizeof crossings);
    memset(&crowds, 0, sizeof crowds);
    return sbi_surface_find_crossings(s, &share->def->allocator, &crossings, &crowds, NULL) == 0 &&
           crossings.count == 0;
}

/* Names the cell that would keep the shape. A third of what may be missing is allowed to be thinner. */
static sb_result sbi_share_fail(sbi_share *share, double volume_share, double surface_share, sb_error *error)
{
    double limit = (double)share->def->least_share, cell = (double)share->def->cell;
    sb_real most = 4 * share->def->cell;
    double needed;
    char of_volume[48] = "";
    if (volume_share >= 0)
        snprintf(of_volume, sizeof of_volume, "%.3g %% of the volume and ", 100 * volume_share);
    sbi_share_find_thickness(share, most);
    needed = (double)sbi_share_quantile(share, (1 - limit) / 3, most) / 1.5;
    needed = needed < 0.7 * cell ? needed : 0.7 * cell;
    return sbi_fail(error, SB_ERROR_MESH,
                    "cells of %g m keep %s%.3g %% of the surface of shape %d, least_share asks for %.3g %%: it is too "
                    "thin for them; try cells of %.2g m",
                    cell, of_volume, 100 * surface_share, share->number, 100 * limit, needed);
}

static sb_result sbi_share_one(sbi_share *share, const sb_mesh *mesh, sb_stuff_report *report, sb_error *error)
{
    double kept, volume = -1, surface = -1, limit = (double)share->def->least_share;
    int covered;
    sb_result result;
    if (share->shape->surface)
        sbi_share_sample_surface(share);
    else
        sbi_share_sample_function(share);
    result = sbi_share_measure(share, mesh, &kept, &covered, error);
    if (result != SB_OK)
        return result;
    if (share->volume > 0)
        volume = kept / share->volume;
    if (share->count > 0)
        surface = (double)covered / share->count;
    report->volume_share[share->number] = (sb_real)volume;
    report->surface_share[share->number] = (sb_real)surface;
    if (surface < 0 || (surface >= limit && (volume < 0 || volume >= limit)))
        return SB_OK;
    /* faces between regions may give way by a cell: an inner shape must be short of both */
    if (share->number > 0 && (surface >= limit || volume >= limit))
        return SB_OK;
    if (surface >= limit && !sbi_share_trusts_volume(share))
        return SB_OK;
    return sbi_share_fail(share, volume, surface, error);
}

SBI_API sb_result sbi_stuffing_measure_shares(const sb_stuff_def *def, const sb_mesh *mesh, sb_stuff_report *report,
                                              sb_error *error)
{
    sbi_share share;
    sb_result result = SB_OK;
    memset(&share, 0, sizeof share);
    share.def = def;
    share.low = def->low;
    share.high = def->high;
    if (def->shapes[0].surface)
        sb_surface_bounds(def->shapes[0].surface, &share.low, &share.high);
    share.samples = (sbi_share_sample *)sbi_alloc(&def->allocator, SBI_SHARE_MOST, sizeof *share.samples);
    if (!share.samples)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the shares of a mesh");
    for (int k = 0; k < def->shape_count && result == SB_OK; k++) {
        share.number = k;
        share.shape = def->shapes + k;
        share.count = share.cut_off = 0;
        share.volume = 0;
        share.dice = 1;
        result = sbi_share_one(&share, mesh, report, error);
    }
    sbi_free(&def->allocator, share.samples);
    return result;
}
