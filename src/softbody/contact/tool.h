/* tool: rigid tools as signed distances, and where they stand in space. Floor 4.
 *
 *     sb_tool_def def = sb_default_tool_def();
 *     def.shape = SB_TOOL_SPHERE;
 *     def.radius = 0.005;
 * A contact makes the tool of it and keeps it. */
#ifndef SB_TOOL_H
#define SB_TOOL_H

#include "../base/dense.h"
#include "../mesh/mesh.h"

/* Where a tool stands: a point p of its frame is at position + rotation p in space. */
typedef struct sb_pose {
    sb_vec3 position; /* m: of the frame's origin */
    sb_quat rotation; /* unit quaternion, from the tool's frame to space. Any length but 0 is taken and normalised */
} sb_pose;

/* What a tool is, in its own frame:
 *
 *     sphere       capsules             box, from outside        plane                   mesh
 *                                       ,------------.           frame's z
 *      ,-.        ,------.              | ,--------. |              ^
 *     ( o )      ( o----o \             | |  core  | | half         |  outside           what a closed surface
 *      `-'        `-----.\ \            | `--------' |           ___o___                 has inside
 *                        ( o )          `------------' radius    ///////  inside
 *                         `-'
 * o and what joins them is the skeleton, which is kept from crossing the body's faces; of a box it is the core. */
typedef enum sb_tool_shape {
    SB_TOOL_SPHERE = 1,   /* round the frame's origin */
    SB_TOOL_CAPSULES = 2, /* all that is within `radius` of a chain of segments, which may bend: shafts, catheters */
    SB_TOOL_BOX = 3,      /* round the frame's origin, along its axes, edges and corners rounded: jaws, spatulas */
    SB_TOOL_PLANE = 4,    /* the half space below z = 0 of the frame: tables, walls. Its normal is the frame's z axis */
    SB_TOOL_MESH = 5      /* the inside of a closed surface, as a grid of distances */
} sb_tool_shape;

enum {
    SB_TOOL_MAX_POINTS = 64, /* of a chain */
    SB_TOOL_MIN_CELLS = 16,  /* of a mesh's grid, along its longest side */
    SB_TOOL_MAX_CELLS = 128
};

/* What a tool is made from. Start from sb_default_tool_def(). Fields of other shapes are not read. Lengths that a
 * shape reads must be within 1e-9 ... 1e9 m, coordinates within 1e9 m. */
typedef struct sb_tool_def {
    sb_tool_shape shape;    /* default SB_TOOL_SPHERE */
    sb_real radius;         /* m: of spheres and capsules, > 0, no default. Box: of its rounded edges, at most the
                             * smallest half extent; 0 (default): a tenth of that. A smaller radius needs more
                             * samples on the body's faces and slows the tool down, which may advance by half of it
                             * in each step */
    const sb_vec3 *points;  /* capsules: [point_count] chain in the tool's frame (m), copied. Neighbours may not
                             * coincide; one end may touch the other */
    int point_count;        /* in [2, SB_TOOL_MAX_POINTS] */
    sb_vec3 half;           /* box: half extents (m), > 0, rounding included */
    const sb_mesh *surface; /* mesh: closed surface of tri3 looking outward (m), in the tool's frame; borrowed for
                             * the call */
    int cells;              /* mesh: cells of its grid along the longest side, in [SB_TOOL_MIN_CELLS,
                             * SB_TOOL_MAX_CELLS]; default 48. Details smaller than two cells are rounded off */
    sb_real friction;       /* Coulomb's mu against every body, >= 0; default 0. The only place where it is set */
    sb_pose pose;           /* where it stands at first; default the origin, not turned */
    /* The tool hangs on the pose that it is sent to by a spring, and is where the spring and what it touches balance: a
     * compliant instrument, a hand, a surgeon's wrist. */
    sb_real coupling_stiffness; /* N/m; 0 (default): none, it goes where it is sent */
    sb_real coupling_turning;   /* N m/rad about its position; 0 (default): it turns as it is sent to. Needs
                                 * coupling_stiffness */
    sb_real max_force;          /* N that the spring pulls with at most, > 0; default SB_REAL_MAX */
    unsigned cookie;            /* set by sb_default_tool_def; a def made without it is refused */
} sb_tool_def;

SB_API sb_tool_def sb_default_tool_def(void);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal: tools; contact.h is what users see of them ------------------------------------------------------ */

/* A shape. Not changed after creation, so that any number of threads may ask at once. */
typedef struct sbi_tool sbi_tool;

/* Makes a tool of a def, in one block of memory (a mesh takes scratch besides, which goes back). def->pose is checked,
 * but not kept. SB_ERROR_ARGUMENT or _NOT_FINITE (the field is named), _UNSUPPORTED (a surface of other elements than
 * tri3, or thinner than its grid's cells), _MESH or _INDEX (what is wrong with the surface), _MEMORY; *tool is then
 * untouched. Meshes: distances of all nodes of the grid, in parallel on jobs; 0.03 s for 48 cells and
 * 1,000 triangles, 0.4 s for 128. */
SBI_API sb_result sbi_tool_create(const sb_tool_def *def, const sb_allocator *allocator, const sb_jobs *jobs,
                                  sbi_tool **tool, sb_error *error);
SBI_API void sbi_tool_destroy(sbi_tool *tool); /* accepts NULL */

/* Refuses a pose that is not finite or has a rotation of length 0; `name` says in the message what it is. *unit (or
 * NULL) is the pose with a rotation of length 1. */
SBI_API sb_result sbi_tool_pose_check(const sb_pose *pose, const char *name, sb_pose *unit, sb_error *error);
/* Refuses points that are no chain of capsules of this radius, as sbi_tool_create does. */
SBI_API sb_result sbi_tool_chain_check(const sb_vec3 *points, int count, sb_real radius, const char *name,
                                       sb_error *error);

/* Refuses a pose, with a chain as sbi_tool_distance has, at which a point of the tool is farther than 1e9 m from the
 * origin of space, or so far that rounding moves it by a hundredth of the tool's radius: where it is on its way could
 * not be told, and it would come back as if through what lies between. SB_ERROR_ARGUMENT. */
SBI_API sb_result sbi_tool_place_check(const sbi_tool *tool, const sb_vec3 *chain, const sb_pose *pose,
                                       const char *name, sb_error *error);

/* Distance of a point from the tool (m, negative inside), both in the tool's frame, and the unit normal out of the
 * tool, which is the distance's gradient. chain: of capsules, [point_count] in place of the tool's own (NULL: its own),
 * checked by the caller. Where there is no gradient (on the skeleton, but for a box on the middle of its core) the
 * normal is `fallback`, a unit vector. Never NaN: a point that is no number, or too far off for one, has the distance
 * SB_REAL_MAX and the normal `fallback`.
 * Mesh: a C1 function; near the surface some 0.02, at most 0.2 cells from the distance, with a gradient at most 1.1
 * long, whose direction the normal has. From two cells outside of the surface's box on it is a lower bound of the
 * distance, at least 0.7 of it, and the normal is no longer its gradient, but points away from the tool. */
SBI_API sb_real sbi_tool_distance(const sbi_tool *tool, const sb_vec3 *chain, sb_vec3 x, sb_vec3 fallback,
                                  sb_vec3 *normal);
/* The same for x[count], to the bit, faster for chains that replace the tool's own. fallback[count]; gap[count] and
 * normal[count] are written; normal may be the array `fallback`. */
SBI_API void sbi_tool_distances(const sbi_tool *tool, const sb_vec3 *chain, int count, const sb_vec3 *x,
                                const sb_vec3 *fallback, sb_real *gap, sb_vec3 *normal);

SBI_API sb_tool_shape sbi_tool_get_shape(const sbi_tool *tool);
SBI_API int sbi_tool_point_count(const sbi_tool *tool); /* of its chain; 0 for other shapes */
/* Smallest radius (m) of its surface, which says how close samples on faces must be; SB_REAL_MAX for a plane. Mesh: two
 * cells, or its inner radius where that is smaller. */
SBI_API sb_real sbi_tool_radius(const sbi_tool *tool);
/* Depth (m) of the skeleton: each of its points is at least so deep inside. SB_REAL_MAX for a plane. Mesh: the largest
 * of some depths up to 0.9 of the greatest, at which what is so deep is in one piece and reaches within twice the depth
 * of each side of the surface's box, or else one cell: a thin shaft between thick ends has its part of the skeleton. */
/* 1: the distances of no two points differ by more than they lie apart. */
SBI_API int sbi_tool_is_exact(const sbi_tool *tool);
SBI_API sb_real sbi_tool_inner_radius(const sbi_tool *tool);
/* A box around the tool in space (m); that of a plane is all of it. */
SBI_API void sbi_tool_bounds(const sbi_tool *tool, const sb_vec3 *chain, const sb_pose *pose, sb_vec3 *low,
                             sb_vec3 *high);
/* An upper bound (m) of how far any point of the skeleton moves on the way of sbi_pose_between from `from` to `to`,
 * while its chain goes straight from chain0 to chain1 (NULL: its own); 0 for a plane. The points' speeds are bounded
 * too: a part of the way moves them by no more than its share of the bound. Exact without rotation and bending; a
 * rotation by a (rad) adds a^2 / 2 times the skeleton's distance from the frame's origin, or less. */
SBI_API sb_real sbi_tool_motion(const sbi_tool *tool, const sb_vec3 *chain0, const sb_pose *from, const sb_vec3 *chain1,
                                const sb_pose *to);

/* The skeleton in the tool's frame: how many points it has, the first `capacity` of them in points (may be NULL with
 * capacity 0). A sphere: its centre; capsules: the chain; box: the corners of its core, that at (x, y, z) signs has the
 * bits 1, 2, 4 set where the sign is positive; plane: none; mesh: nodes of its grid on the hull of all that are at
 * least the inner radius deep, at most SBI_TOOL_MAX_SKELETON of them. */
enum { SBI_TOOL_MAX_SKELETON = 256 };
SBI_API int sbi_tool_skeleton(const sbi_tool *tool, const sb_vec3 *chain, sb_vec3 *points, int capacity);
/* Pairs of those points that a segment of the skeleton joins: of capsules and boxes (the edges of the core, of a core
 * without thickness too). How many, the first `capacity` of them in ends. */
SBI_API int sbi_tool_segments(const sbi_tool *tool, int (*ends)[2], int capacity);

/* ---- poses ---- */

SB_INLINE sb_vec3 sbi_pose_to_space(const sb_pose *pose, sb_vec3 point)
{
    return sb_v3_add(pose->position, sb_quat_rotate(pose->rotation, point));
}
SB_INLINE sb_vec3 sbi_pose_to_tool(const sb_pose *pose, sb_vec3 point)
{
    return sb_quat_rotate(sb_quat_conjugate(pose->rotation), sb_v3_sub(point, pose->position));
}
/* The same for directions. */
SB_INLINE sb_vec3 sbi_pose_turn_to_space(const sb_pose *pose, sb_vec3 direction)
{
    return sb_quat_rotate(pose->rotation, direction);
}
SB_INLINE sb_vec3 sbi_pose_turn_to_tool(const sb_pose *pose, sb_vec3 direction)
{
    return sb_quat_rotate(sb_quat_conjugate(pose->rotation), direction);
}
/* The pose at a share in [0, 1] of the way: the position goes straight, the rotation at even speed by the smaller
 * angle. Exactly *from at 0 and *to at 1. Both rotations have length 1. */
SBI_API sb_pose sbi_pose_between(const sb_pose *from, const sb_pose *to, sb_real share);
/* Rotation vector (rad) that takes from's rotation to to's, in from's frame: by the smaller angle. */
SBI_API sb_vec3 sbi_pose_rotation(const sb_pose *from, const sb_pose *to);
#endif

#endif /* SB_TOOL_H */
