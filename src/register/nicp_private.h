/* nicp_private: what is inside a reg_nicp. Floor 6, internal: nicp.c makes it, nicp_step.c moves it. */
#ifndef REG_NICP_PRIVATE_H
#define REG_NICP_PRIVATE_H

#include "../softbody/body/body_guest.h"
#include "../softbody/body/load.h"
#include "nicp.h"

/* Points per task of the look at the target: fixed, whatever the threads. */
enum { REGI_NICP_CHUNK = 128 };

/* A vertex of the organ's surface that stands for those around it. */
typedef struct regi_nicp_source {
    int vertex;
    int triangle, corner; /* a triangle that has it; -1: none has */
    sb_real area;         /* m^2 at rest */
    /* of the last look */
    int guess;    /* item of the field that was closest, or -1 */
    int way_back; /* triangle of the skin that was closest to it */
    int visible;
    int paired; /* N_s counts, up to its distance */
    int active;
    sb_vec3 normal;    /* unit, or 0 */
    sb_vec3 direction; /* across the target where it was hit, or across the organ; unit, or 0 */
    sb_vec3 way;       /* to N_s (m) */
    sb_vec3 sum;       /* of the ways to those in V (m) */
    int count;         /* of V */
    sb_real distance;  /* m */
} regi_nicp_source;

/* A point of the target that looks for its source. */
typedef struct regi_nicp_sample {
    sb_vec3 point;  /* m */
    sb_vec3 normal; /* unit, or 0: unknown */
    /* of the last look */
    int guess;   /* triangle of the skin */
    int source;  /* N_t, or -1 */
    sb_vec3 way; /* from the organ's surface to the point (m) */
} regi_nicp_sample;

/* Rows of node weights: the points of def.surface, or the landmarks. */
typedef struct regi_nicp_rows {
    sb_mapping mapping; /* of the arrays below */
    int *start, *nodes;
    sb_real *weights;
} regi_nicp_rows;

struct reg_nicp {
    sb_allocator allocator;
    sb_clock clock;
    sb_body *body;
    sb_mesh mesh;     /* the body's at rest: a copy without free cells */
    int mesh_version; /* of the body's mesh that all of this is about */
    reg_field *field;
    int is_cloud;                    /* the target is one */
    sb_real spacing;                 /* of the target's points (m) */
    sb_surface *skin;                /* the organ's surface as it is now */
    regi_nicp_rows rows;             /* [vertex_count] */
    regi_nicp_rows source_rows;      /* [source_count] */
    regi_nicp_rows landmark_rows;    /* [landmark_count] */
    int surface_load, landmark_load; /* ids of the penalties; 0: none */

    reg_nicp_view view;
    sb_vec3 camera;
    sb_real size;  /* of the organ (m) */
    sb_real young; /* Pa */
    sb_real blending, sliding, least_cosine, outlier_parameter, tolerance, newton_tolerance, least_active;
    reg_outliers outliers;
    sb_real reach, last_reach;               /* m */
    sb_real first_stiffness, last_stiffness; /* Pa/m */
    int increments, iterations, newton, noisy;
    sb_real landmark_stiffness; /* N/m */
    double max_seconds;

    int vertex_count, source_count, sample_count, landmark_count;
    double total_area;            /* m^2 */
    sb_real volume;               /* of the organ, or its grid, at rest (m^3) */
    void *memory;                 /* the one block behind the arrays below */
    sb_vec3 *vertices;            /* [vertex_count] (m) now */
    int *source_of;               /* [vertex_count] the source that stands for it; -1: none does */
    regi_nicp_source *sources;    /* [source_count] */
    regi_nicp_sample *samples;    /* [sample_count] */
    sb_real *distances, *scratch; /* [the larger of both counts] */
    sb_vec3 *goals;               /* [source_count] (m) */
    sb_real *stiffness;           /* [source_count] (N/m) */
    sb_vec3 *lines;               /* [source_count] see sbi_body_set_mapping_lines */
    sb_vec3 *before;              /* [source_count] (m) sources before the balance */
    sb_vec3 *settled;             /* [source_count] (m) sources at the end of the last increment */
    sb_vec3 *targets;             /* [landmark_count] (m) */

    /* state */
    int increment, iteration; /* from 0 */
    int has_settled;
    reg_nicp_info info;
};

/* Writes where rows are now: points[row_count] (m). */
REGI_API void regi_nicp_points(const reg_nicp *nicp, const regi_nicp_rows *rows, sb_vec3 *points);

#endif /* REG_NICP_PRIVATE_H */
