/* tool_private: what a tool holds. Internal to contact, floor 4. */
#ifndef SB_TOOL_PRIVATE_H
#define SB_TOOL_PRIVATE_H

#include "tool.h"

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
};

#endif /* SB_TOOL_PRIVATE_H */
