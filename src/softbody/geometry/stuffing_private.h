/* stuffing_private: the state of a stuffing that its stages hand on. */
#ifndef SBI_STUFFING_PRIVATE_H
#define SBI_STUFFING_PRIVATE_H

#include "stuffing.h"

#include <limits.h>
#include <string.h>

/* ---- stuffing_lattice.c ---- */

#define SBI_STUFF_COOKIE 0x53545546u
#define SBI_STUFF_BLOCK 16                    /* half cells along a block of sampling: 8 cells */
#define SBI_STUFF_ALPHA_LONG ((sb_real)0.285) /* parts of an edge within which its end is warped to the cut */
#define SBI_STUFF_ALPHA_SHORT ((sb_real)0.3975)
#define SBI_STUFF_SHORT ((sb_real)0.8660254037844386) /* length of a short edge in cells */
#define SBI_STUFF_MAX_LEVELS 8
#define SBI_STUFF_EDGES 7   /* edges that a point owns: +x, +y, +z, and four to points half a cell up z */
#define SBI_STUFF_CHUNK 128 /* surface points per task */

/* A set of lattice points that numbers its members in lattice order: count before each word, and bits within it. */
typedef struct sbi_stuffing_set {
    uint64_t *words;
    int *before;
    size_t word_count;
    int count;
} sbi_stuffing_set;

typedef enum sbi_stuffing_state {
    SBI_STUFF_STRICT = 0, /* lies in the region of its label */
    SBI_STUFF_OUTER = 1,  /* on the outer boundary */
    SBI_STUFF_INNER = 2   /* on a face between regions */
} sbi_stuffing_state;

/* A point with an edge to another label. */
typedef struct sbi_stuffing_point {
    int half[3];
    int active; /* its number among the points of the mesh */
    unsigned char label, state;
    sb_real moved;                /* distance from its place in the lattice, in cells */
    sb_real cut[SBI_STUFF_EDGES]; /* fraction along each owned edge to where the label changes; -1: it does not */
} sbi_stuffing_point;

typedef struct sbi_stuffing_failure {
    int shape; /* whose distance was not finite; -1: none */
    sb_vec3 at;
} sbi_stuffing_failure;

typedef struct sbi_stuffing {
    const sb_stuff_def *def;
    sb_error *error;
    sb_vec3 low, high, origin;
    int attempt;           /* 0: the lattice is centred; each other number shifts it in its own way */
    double *reported;      /* fraction that the progress callback was notified of, over all attempts */
    sb_real half;          /* m, half a cell */
    int n[3];              /* cells, multiples of 2^levels */
    size_t stride[3];      /* of cells in labels: 1, n + 1, ... */
    size_t point_count;    /* of the lattice: two per cell, cells of the last layer half used */
    unsigned char *labels; /* [point_count] 1 + shape, 0 outside */
    unsigned char *split[SBI_STUFF_MAX_LEVELS + 1]; /* 1: this cell of size 2^level is made of smaller ones */
    sbi_stuffing_set surface, active;
    int tet_count;
    int *tets;                      /* [tet_count][4] active points */
    sb_vec3 *positions;             /* [active.count] */
    unsigned char *active_label;    /* [active.count] */
    int *point_of;                  /* [active.count] surface point, or -1 */
    sbi_stuffing_point *points;     /* [surface.count] */
    sb_real *values;                /* [surface.count][shapes] distances, where an edge needs them */
    sbi_stuffing_failure *failures; /* one per task of a slice */
    int first;                      /* first block or point of the slice that tasks work on */
    /* what the stencils make */
    int *cut_node; /* [surface.count][7] node of the cut, -1: none yet */
    sb_vec3 *cut_positions;
    int cut_count;
    int *elements; /* [element_count][4] active points, then cuts */
    unsigned char *element_labels;
    int element_count, element_capacity;
} sbi_stuffing;

SB_INLINE sb_vec3 sbi_stuffing_position(const sbi_stuffing *s, const int half[3])
{
    return sb_v3(s->origin.x + s->half * (sb_real)half[0], s->origin.y + s->half * (sb_real)half[1],
                 s->origin.z + s->half * (sb_real)half[2]);
}

SB_INLINE size_t sbi_stuffing_index(const sbi_stuffing *s, const int half[3])
{
    size_t row = s->stride[1] * (size_t)(half[1] >> 1) + s->stride[2] * (size_t)(half[2] >> 1);
    size_t cell = (size_t)(half[0] >> 1) + row;
    return 2 * cell + (size_t)(half[0] & 1);
}

/* Step from a point along one of its own edges. */
SB_INLINE void sbi_stuffing_step(int edge, int step[3])
{
    for (int axis = 0; axis < 3; axis++)
        step[axis] = edge < 3 ? 2 * (edge == axis) : axis == 2 ? 1 : (edge - 3) >> axis & 1 ? 1 : -1;
}

SB_INLINE int sbi_stuffing_is_in(const sbi_stuffing *s, const int half[3])
{
    int odd = half[0] & 1;
    for (int axis = 0; axis < 3; axis++)
        if (half[axis] < 0 || half[axis] + odd > 2 * s->n[axis])
            return 0;
    return 1;
}

SB_INLINE void sbi_stuffing_set_add(sbi_stuffing_set *set, size_t index)
{
    set->words[index >> 6] |= (uint64_t)1 << (index & 63);
}

SB_INLINE int sbi_stuffing_set_has(const sbi_stuffing_set *set, size_t index)
{
    return (int)(set->words[index >> 6] >> (index & 63) & 1);
}

/* Signed distance of a shape; a function of the first one is cut off at its box. The sign of a surface's is that of the
 * nearest triangle's side: right but where the surface crosses itself. */
SBI_API sb_real sbi_stuffing_value(const sbi_stuffing *s, int shape, sb_vec3 p);
/* The same with the sign of a surface's from its winding number: right wherever that is, at several times the cost. */
SBI_API sb_real sbi_stuffing_sure_value(const sbi_stuffing *s, int shape, sb_vec3 p);
/* Whether a surface contains all points within `reach` of one, where it is farther away than that (0: the point alone);
 * -1: some of them. The winding number of an open surface can hold for inside what lies beyond its box; of the first
 * shape that is outside. */
SBI_API int sbi_stuffing_encloses(const sbi_stuffing *s, int shape, sb_vec3 p, sb_real reach);
/* Largest slope of a shape's function, 0: unknown. */
SBI_API sb_real sbi_stuffing_slope(const sbi_stuffing *s, int shape);
/* The label that follows from the shapes a point lies in. */
SBI_API unsigned char sbi_stuffing_label(uint64_t inside);
SBI_API unsigned char sbi_stuffing_label_at(const sbi_stuffing *s, sb_vec3 p);
/* The shape whose surface separates two labels: the outer one, or the one that wins. */
SBI_API int sbi_stuffing_separator(int a, int b);
/* Inverse of sbi_stuffing_index. */
SBI_API void sbi_stuffing_coordinates(const sbi_stuffing *s, size_t index, int half[3]);
SBI_API int sbi_stuffing_set_make(sbi_stuffing *s, sbi_stuffing_set *set);
SBI_API void sbi_stuffing_set_free(sbi_stuffing *s, sbi_stuffing_set *set);
/* Numbers the members. 0 when there are more than an int counts. */
SBI_API int sbi_stuffing_set_number(sbi_stuffing_set *set);
SBI_API int sbi_stuffing_set_rank(const sbi_stuffing_set *set, size_t index);
SBI_API sb_result sbi_stuffing_too_many(const sbi_stuffing *s);
SBI_API sb_result sbi_stuffing_no_memory(const sbi_stuffing *s);
SBI_API sb_result sbi_stuffing_progress(sbi_stuffing *s, double fraction);
/* Runs tasks, one failure record each, and reports the first failure. */
SBI_API sb_result sbi_stuffing_run(sbi_stuffing *s, sb_task task, int count);

/* ---- stuffing_label.c ---- */

SBI_API sb_result sbi_stuffing_sample(sbi_stuffing *s);

/* ---- stuffing_octree.c ---- */

/* Finds the points with an edge to another label. */
SBI_API sb_result sbi_stuffing_find_surface(sbi_stuffing *s);
SBI_API sb_result sbi_stuffing_grade(sbi_stuffing *s);
SBI_API sb_result sbi_stuffing_enumerate(sbi_stuffing *s);

/* ---- stuffing_warp.c ---- */

/* What a tet sees: its surface points (-1: a point in the middle of its region), and its labels without zeros. */
typedef struct sbi_stuffing_view {
    const int *nodes; /* active points */
    int point[4];
    int label[4]; /* -1: a zero */
    int outside;  /* a strict point lies outside: the regions count as one side */
    int zeros, inner_zeros;
    int a, b; /* two different labels among the strict, not outside; -1: none */
    int more; /* 1: there are further labels */
} sbi_stuffing_view;

SBI_API void sbi_stuffing_value_task(void *user, int index);
SBI_API void sbi_stuffing_cut_task(void *user, int index);
/* Runs a task over all surface points, in slices, between which progress is reported. */
SBI_API sb_result sbi_stuffing_over_points(sbi_stuffing *s, sb_task task, double from, double to);
SBI_API void sbi_stuffing_look(const sbi_stuffing *s, const int *nodes, sbi_stuffing_view *v);
/* Whether a tet has angles within those of the stencils. */
SBI_API int sbi_stuffing_is_well_shaped(const sb_vec3 corners[4]);
SBI_API sb_vec3 sbi_stuffing_centroid(const sb_vec3 corners[4]);
/* Label of a tet of four zeros: that of its centroid, taken in the lattice, so that it stays when zeros move. Outside
 * when all its points were, not when one is a zero between regions: to the outer boundary that is a point inside. */
SBI_API int sbi_stuffing_label_of_four(const sbi_stuffing *s, const int points[4]);
/* Decides about all zeros: those at the outside, then those between regions; then every tet can be cut. Relaxing ends:
 * four zeros near their places make a regular tet. */
SBI_API void sbi_stuffing_place_zeros(sbi_stuffing *s);

/* ---- stuffing_cut.c ---- */

SBI_API sb_result sbi_stuffing_cut(sbi_stuffing *s);
/* Copies elements and the nodes they use into the mesh, each tet turned so that its volume is positive. */
SBI_API sb_result sbi_stuffing_collect(sbi_stuffing *s, sb_mesh *mesh);

/* ---- stuffing_boundary.c ---- */

#define SBI_STUFF_FAR ((sb_real)0.3) /* cells */
#define SBI_STUFF_ROUNDS 8
#define SBI_STUFF_ATTEMPTS 12     /* places of the lattice that are tried while the boundary is too far off */
#define SBI_STUFF_SPLITS 4        /* rounds of splitting edges where sliding does not do */
#define SBI_STUFF_SAMPLES 16      /* of a triangle: the first few decide whether the others are worth a look */
#define SBI_STUFF_FIRST_SAMPLES 7 /* corners, middles of edges, centre */

/* Brings the boundary close to the surface and reports how close it is. */
SBI_API sb_result sbi_stuffing_finish_boundary(const sbi_stuffing *s, sb_mesh *mesh, sb_real *distance);
/* All but the shares. */
SBI_API void sbi_stuffing_fill_report(const sb_mesh *mesh, sb_real distance, const int cells[3],
                                      sb_stuff_report *report);

#endif /* SBI_STUFFING_PRIVATE_H */
