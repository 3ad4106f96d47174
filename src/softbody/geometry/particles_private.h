/* particles_private: what the makers of particles work on. All in double: moment matrices square what is in them. */
#ifndef SBI_PARTICLES_PRIVATE_H
#define SBI_PARTICLES_PRIVATE_H

#include "particles.h"

#include <math.h>
#include <string.h>

enum { SBI_PARTICLE_NODES = SB_MAX_ELEMENT_NODES, SBI_PARTICLE_BASIS = 10 };

/* ---- particles_kernel.c ---- */

/* w(q) and dw/dq; 0 from q = 1 on. */
SBI_API double sbi_kernel_shape(sb_kernel kernel, double q);
SBI_API double sbi_kernel_shape_slope(sb_kernel kernel, double q);

/* The particles about a point, nearest first. */
typedef struct sbi_neighbours {
    int count;
    int nodes[SBI_PARTICLE_NODES];
    double offset[SBI_PARTICLE_NODES][3]; /* (m) from the point */
    double distance[SBI_PARTICLE_NODES];
} sbi_neighbours;

/* Shape functions (and gradients (1/m), unless NULL) of moving least squares with `basis` monomials at the point. *rank
 * estimates 1 / condition of the moment matrix; below SBI_LEAST_RANK nothing is written and 0 returned, unless
 * `pseudo`: then directions that the neighbours do not span are left out. */
#define SBI_LEAST_RANK 1e-8
SBI_API int sbi_moving_shapes(sb_kernel kernel, int basis, double h, const sbi_neighbours *near, int pseudo,
                              double *shapes, double (*gradients)[3], double *rank);
/* Least squares gradients g_j of u_j - u_0 at a particle (eq. 3.19); as above. */
SBI_API int sbi_moving_slopes(sb_kernel kernel, double h, const sbi_neighbours *near, int pseudo,
                              double (*gradients)[3], double *rank);
/* SPH gradients v_j grad W_j (eq. 3.17); volumes of all particles (m^3). */
SBI_API void sbi_sph_slopes(sb_kernel kernel, double h, const sbi_neighbours *near, const sb_real *volumes,
                            double (*gradients)[3]);

/* ---- particles_near.c ---- */

/* Particles in boxes. */
typedef struct sbi_near {
    const sb_vec3 *points;
    int count;
    double low[3], edge;
    int dims[3];
    int *start, *items; /* [boxes + 1], [count] */
    double rounding;    /* (m) of coordinates */
    sb_surface *const *cuts;
    int cut_count;
    void *memory;
} sbi_near;

SBI_API sb_result sbi_near_create(const sb_vec3 *points, int count, sb_real spacing, const sb_allocator *allocator,
                                  sbi_near *near, sb_error *error);
SBI_API void sbi_near_free(sbi_near *near, const sb_allocator *allocator);
/* The `want` particles nearest to a point but `exclude` (-1: none), mirror groups whole; more where a group is needed
 * for `least` of them, or to have all within `radius` (0: any). Returns 0 when they are more than fit in a cell, beside
 * the excluded one. */
SBI_API int sbi_near_find(const sbi_near *near, sb_vec3 at, int exclude, int want, int least, double radius,
                          sbi_neighbours *out);
/* 1 when a cut crosses the segment. */
SBI_API int sbi_near_is_cut(const sbi_near *near, sb_vec3 from, sb_vec3 to);
/* Neighbours of a point as the def wants them, and the radius h of its kernel; grown by 1.2^growth. */
SBI_API int sbi_near_gather(const sbi_near *near, const sb_particles_def *def, sb_vec3 at, int exclude, int growth,
                            sbi_neighbours *out, double *h);

/* ---- particles_source.c ---- */

/* Particles and integration points before they know of each other. */
typedef struct sbi_particle_source {
    int particle_count, point_count;
    sb_vec3 *particles; /* [particle_count] */
    sb_vec3 *points;    /* [point_count] */
    sb_real *weights;   /* [point_count] (m^3) */
    int *regions;       /* [point_count] */
    sb_vec3 *samples;   /* [sample_count] of the surface */
    int sample_count;
    sb_real volume; /* inside, or 0 */
} sbi_particle_source;

SBI_API sb_result sbi_particle_source_make(const sb_particles_def *def, sbi_particle_source *source, sb_error *error);
SBI_API void sbi_particle_source_free(sbi_particle_source *source, const sb_allocator *allocator);
/* Weights of points that are particles, from their distances (eqs. 3.12, 3.13). */
SBI_API sb_result sbi_particle_source_weigh(const sb_particles_def *def, const sbi_near *near,
                                            sbi_particle_source *source, sb_error *error);

/* ---- particles_correct.c ---- */

/* inner[] = 1 but for neighbours of samples. */
SBI_API void sbi_particles_mark_inner(const sbi_near *near, const sb_vec3 *samples, int sample_count,
                                      sb_particles *particles);
/* Measures the imbalance about inner particles, and corrects it where the def wants that. */
SBI_API sb_result sbi_particles_correct(sb_particles *particles, sb_error *error);

/* ---- cells ---- */

/* Nodes of an integration point, without those that are there for the width. */
SB_INLINE int sbi_particle_cell_count(const sb_particles *particles, int cell)
{
    int count = particles->domain.nodes_per_cell;
    const int *nodes = particles->domain.cells + (size_t)cell * (size_t)count;
    while (count > 1 && nodes[count - 1] == nodes[count - 2])
        count--;
    return count;
}

#endif /* SBI_PARTICLES_PRIVATE_H */
