/* tool_private: what a tool holds. Internal to contact, floor 4. */
#ifndef SB_TOOL_PRIVATE_H
#define SB_TOOL_PRIVATE_H

#include "tool.h"
#include "tool_mesh.h"

/* Lengths (m) whose squares and, in float, squares of whose rounding errors are numbers. */
#define SBI_TOOL_LEAST_LENGTH ((sb_real)1e-9)
#define SBI_TOOL_MOST_LENGTH ((sb_real)1e9)

/* A segment from a to a + way, not of length 0. */
typedef struct sbi_tool_segment {
    sb_vec3 a, way;
    sb_real inverse; /* 1 / |way|^2 */
} sbi_tool_segment;

struct sbi_tool {
    sb_allocator allocator;
    sb_tool_shape shape;
    sb_real radius, inner_radius;
    sb_real least_square; /* m^2: points nearer to the skeleton are on it, as far as rounding lets one know */
    int point_count;
    sb_vec3 *points;            /* [point_count] chain of capsules */
    sbi_tool_segment *segments; /* [point_count - 1] of it */
    sb_vec3 core;               /* half extents of a box's core */
    sbi_tool_grid grid;         /* of a mesh */
};

SB_INLINE sb_real sbi_tool_largest_coordinate(sb_vec3 v)
{
    return sb_max(sb_abs(v.x), sb_max(sb_abs(v.y), sb_abs(v.z)));
}

/* Distance and normal of a point at d from the nearest one of a skeleton, with a radius about it, where d is too short
 * or too long for its square to be of use. */
SB_INLINE sb_real sbi_tool_extreme_distance(sb_vec3 d, sb_real radius, sb_vec3 fallback, sb_vec3 *normal)
{
    sb_real size = sbi_tool_largest_coordinate(d), length;
    *normal = fallback;
    if (!sb_v3_is_finite(d))
        return SB_REAL_MAX;
    if (size <= radius)
        return -radius;
    d = sb_v3(d.x / size, d.y / size, d.z / size);
    length = sb_v3_norm(d);
    *normal = sb_v3_scale((sb_real)1 / length, d);
    return size < SB_REAL_MAX / length ? size * length - radius : SB_REAL_MAX;
}

/* The same for any d; those whose square is not more than least_square are 0. */
SBI_FORCE_INLINE sb_real sbi_tool_round_distance(sb_vec3 d, sb_real radius, sb_real least_square, sb_vec3 fallback,
                                                 sb_vec3 *normal)
{
    sb_real square = sb_v3_dot(d, d), length;
    if (!(square > least_square) || !(square <= SB_REAL_MAX))
        return sbi_tool_extreme_distance(d, radius, fallback, normal);
    length = sb_sqrt(square);
    *normal = sb_v3_scale((sb_real)1 / length, d);
    return length - radius;
}

#endif /* SB_TOOL_PRIVATE_H */
