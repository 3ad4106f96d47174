/* embed_place: how one point is held by the elements or faces of a volume mesh. */
#include "embed_private.h"

/* The offset of a point from x(xi) in the parameters of the element, corrected once for rounding. */
static void sbi_embed_find_step(const sbi_embed_volume *volume, sb_vec3 point, sb_embedded_point *info)
{
    sb_mat3 jacobian, inverse;
    sb_vec3 offset = sb_v3_sub(point, sbi_embed_map(volume->mesh, info->element, info->xi, &jacobian)), step;
    inverse = sb_m3_inverse(jacobian);
    step = sb_m3_apply(inverse, offset);
    step = sb_v3_add(step, sb_m3_apply(inverse, sb_v3_sub(offset, sb_m3_apply(jacobian, step))));
    info->step[0] = step.x, info->step[1] = step.y, info->step[2] = step.z;
    info->distance = sb_v3_norm(offset);
}

static void sbi_embed_place_foot(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sbi_embed_place *place,
                                 sb_embedded_point *info)
{
    place->cell = foot->face;
    place->parameters[0] = foot->r;
    place->parameters[1] = foot->s;
    place->parameters[2] = foot->distance;
    info->element = sbi_embed_foot_element(volume, foot, info->xi);
}

/* How a point outside is held. */
static void sbi_embed_place_outside(const sbi_embed_volume *volume, sb_embedding_kind kind, sb_vec3 point,
                                    const sbi_embed_hit *hit, sbi_embed_place *place, sb_embedded_point *info)
{
    sbi_embed_foot foot;
    place->hold = SB_EMBEDDED_EXTRAPOLATED;
    if (kind == SB_EMBED_PLAIN)
        return;
    if (sbi_embed_find_foot(volume, point, hit, &foot)) {
        place->hold = SB_EMBEDDED_OFFSET;
        sbi_embed_place_foot(volume, &foot, place, info);
        return;
    }
    foot = sbi_embed_hit_foot(volume, hit);
    if (foot.face >= 0) {
        sb_vec3 tangent[2], offset = sb_v3_sub(point, sbi_embed_foot_tangents(volume, &foot, tangent));
        offset = sb_m3_tapply(sbi_embed_face_frame(tangent[0], tangent[1]), offset);
        place->hold = SB_EMBEDDED_FRAME;
        sbi_embed_place_foot(volume, &foot, place, info);
        place->offset[0] = offset.x, place->offset[1] = offset.y, place->offset[2] = offset.z;
    }
}

/* Coordinates of a rest normal N that make the carried one: J^T N / det J with the columns J of the map at rest, for
 * cof(F) N = cof(J') J^T N / det J; in the frame of a face E^T N. */
static void sbi_embed_place_normal(const sbi_embed_volume *volume, sb_vec3 normal, const sb_embedded_point *info,
                                   sbi_embed_place *place)
{
    sbi_embed_foot foot;
    sb_mat3 jacobian;
    sb_vec3 at, tangent[2], carried;
    foot.face = place->cell;
    foot.r = place->parameters[0], foot.s = place->parameters[1], foot.distance = place->parameters[2];
    normal = sbi_embed_unit(normal);
    if (place->hold == SB_EMBEDDED_FRAME) {
        sbi_embed_foot_tangents(volume, &foot, tangent);
        carried = sb_m3_tapply(sbi_embed_face_frame(tangent[0], tangent[1]), normal);
    } else {
        if (place->hold == SB_EMBEDDED_OFFSET)
            sbi_embed_foot_map(volume, &foot, &at, &jacobian);
        else
            sbi_embed_map(volume->mesh, info->element, info->xi, &jacobian);
        carried = sb_v3_scale(1 / sb_m3_det(jacobian), sb_m3_tapply(jacobian, normal));
    }
    place->carried[0] = carried.x, place->carried[1] = carried.y, place->carried[2] = carried.z;
}

SBI_API void sbi_embed_place_point(const sbi_embed_volume *volume, sb_embedding_kind kind, sb_vec3 point,
                                   const sb_vec3 *normal, int *hint, sbi_embed_place *place, sb_embedded_point *info)
{
    sbi_embed_hit hit;
    memset(place, 0, sizeof *place);
    memset(info, 0, sizeof *info);
    sbi_embed_closest(volume, point, *hint, &hit);
    *hint = hit.element;
    place->cell = info->element = hit.element;
    place->gap = sb_sqrt(hit.distance2);
    for (int k = 0; k < 3; k++)
        place->parameters[k] = info->xi[k] = hit.xi[k];
    if (hit.distance2 > 0) {
        sbi_embed_place_outside(volume, kind, point, &hit, place, info);
        sbi_embed_find_step(volume, point, info);
        for (int k = 0; place->hold == SB_EMBEDDED_EXTRAPOLATED && k < 3; k++)
            place->offset[k] = info->step[k];
    }
    info->hold = place->hold;
    if (normal)
        sbi_embed_place_normal(volume, *normal, info, place);
    if (sbi_embed_is_on_face(place->hold))
        place->cell = volume->boundary.elements[place->cell] * volume->faces + volume->boundary.faces[place->cell];
}

SBI_API int *sbi_embed_report_count(sb_embedding_report *report, sb_embedding_hold hold)
{
    if (hold == SB_EMBEDDED_INSIDE)
        return &report->inside;
    if (hold == SB_EMBEDDED_OFFSET)
        return &report->offset;
    return hold == SB_EMBEDDED_FRAME ? &report->frame : &report->extrapolated;
}

SBI_API void sbi_embed_report_add(sb_embedding_report *report, const sbi_embed_place *place, int index)
{
    ++*sbi_embed_report_count(report, place->hold);
    if (place->gap > report->max_distance ||
        (place->gap > 0 && place->gap >= report->max_distance && index < report->farthest_point)) {
        report->max_distance = place->gap;
        report->farthest_point = index;
    }
}
