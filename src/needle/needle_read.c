/* needle_read: what a needle is at. */
#include "needle_private.h"

#include <string.h>

NDL_API const ndl_rod *ndl_needle_rod(const ndl_needle *needle) { return needle ? needle->rod : NULL; }

NDL_API ndl_tip_pose ndl_needle_tip(const ndl_needle *needle)
{
    ndl_tip_pose pose;
    ndli_v3 t, ahead;
    memset(&pose, 0, sizeof pose);
    if (!needle)
        return pose;
    ahead = ndli_needle_heading(needle);
    ndl_rod_tip(needle->rod, &pose.position, &pose.frame);
    t = ndli_from(pose.frame.t);
    pose.frame.m1 = ndli_to(ndli_rod_transport(t, ahead, ndli_from(pose.frame.m1)));
    pose.frame.m2 = ndli_to(ndli_rod_transport(t, ahead, ndli_from(pose.frame.m2)));
    pose.frame.t = ndli_to(ahead);
    return pose;
}

NDL_API void ndl_needle_base_wrench(const ndl_needle *needle, sb_vec3 *force, sb_vec3 *torque)
{
    if (!needle)
        return;
    if (force)
        *force = ndli_to(needle->base_force);
    if (torque)
        *torque = ndli_to(needle->base_torque);
}

NDL_API int ndl_needle_entry(const ndl_needle *needle) { return needle ? needle->line.first : 0; }

static int ndli_needle_is_coupled(const ndl_needle *needle, int node)
{
    return node >= ndli_line_rearmost(&needle->line) && node < needle->line.first + needle->line.count;
}

NDL_API int ndl_needle_body_node(const ndl_needle *needle, int node)
{
    if (!needle)
        return 0;
    return ndli_needle_is_coupled(needle, node) && !needle->site->embeds ? needle->path[node - needle->line.first] : -1;
}

NDL_API const ndl_remesh *ndl_needle_remesh(const ndl_needle *needle) { return needle ? needle->site->remesh : NULL; }

NDL_API ndl_contact ndl_needle_contact(const ndl_needle *needle, int node)
{
    ndl_contact none;
    if (!needle) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return ndli_needle_is_coupled(needle, node) ? (ndl_contact)needle->line.state[node] : NDL_FREE;
}

NDL_API sb_vec3 ndl_needle_contact_force(const ndl_needle *needle, int node)
{
    if (!needle)
        return sb_v3(0, 0, 0);
    return ndli_needle_is_coupled(needle, node) ? ndli_to(needle->line.contact[node]) : sb_v3(0, 0, 0);
}

NDL_API sb_real ndl_needle_depth(const ndl_needle *needle)
{
    double sum = 0;
    if (!needle)
        return 0;
    for (int i = needle->line.first; i + 1 < needle->rod->node_count; i++)
        sum += ndli_norm(ndli_sub(needle->rod->x[i + 1], needle->rod->x[i]));
    return (sb_real)(sum + needle->entering);
}

NDL_API sb_real ndl_needle_fed(const ndl_needle *needle) { return needle ? (sb_real)needle->fed : 0; }
NDL_API sb_real ndl_needle_advance(const ndl_needle *needle) { return needle ? (sb_real)needle->advance : 0; }
NDL_API sb_real ndl_needle_cutting(const ndl_needle *needle) { return needle ? (sb_real)needle->line.cutting : 0; }

NDL_API int ndl_needle_tip_material(const ndl_needle *needle, sb_vec3 *X)
{
    if (!needle)
        return 0;
    if (needle->line.count == 0)
        return 0;
    if (needle->site->embeds)
        *X = ndli_to(ndli_track_at(&needle->track, ndli_track_length(&needle->track)).X);
    else if (needle->shallow)
        ndl_remesh_material_point(needle->site->remesh, needle->index,
                                  ndli_to(needle->rod->x[needle->rod->node_count - 1]), X);
    else
        *X = needle->site->mesh->X[needle->path[needle->line.count - 1]];
    return 1;
}

NDLI_API const ndl_friction *ndli_needle_friction(const ndl_needle *needle, int region)
{
    int i = needle->friction_count == 1 ? 0 : region;
    return i >= 0 && i < needle->friction_count ? needle->frictions + i : NULL;
}
