/* cut_figures.h: what a half-cut beam is measured by. */
#ifndef CUT_FIGURES_H
#define CUT_FIGURES_H

#include "cut_beam.h"
/* after what names an edge */
#include "cut_drawing.h"

/* Force on the clamped end of a beam whose other end is drawn out by 2 mm. */
static inline double beam_pull(block *b)
{
    sb_static_options options = sb_default_static_options();
    sb_vec3 by = sb_v3(REAL(0.002), 0, 0);
    double sum = 0;
    options.tolerance = REAL(scene_tolerance(1e-9, 1e4));
    CHECK_OK(sb_body_set_gravity(b->body, sb_v3(0, 0, 0)));
    for (int i = 0; i < b->mesh.node_count; i++)
        if (b->mesh.nodes[i].x > beam_size.x - REAL(1e-6))
            CHECK_OK(sb_body_prescribe(b->body, &i, 1, SB_XYZ, &by, 1));
    CHECK_OK(sb_body_solve_static(b->body, &options, NULL));
    for (int i = 0; i < b->mesh.node_count; i++)
        if (b->mesh.nodes[i].x < REAL(1e-6))
            sum += (double)sb_body_reactions(b->body)[i].x;
    return fabs(sum);
}

/* How far a beam's cut is open at the top (m). */
static inline double beam_opening(block *b)
{
    sb_cut_surface *surface = NULL;
    sb_cut_drawing d;
    double sums[2] = {0, 0};
    int counts[2] = {0, 0};
    CHECK_OK(sb_cut_surface_create(b->cut, NULL, &surface, NULL));
    d = sb_cut_surface_get(surface);
    for (int f = 0; f < d.triangle_count; f++)
        for (int k = 0; k < 3 && d.tags[f] == SB_CUT_LIP && is_drawn(&d, f); k++) {
            const int *v = d.triangles[f];
            int far_side =
                sb_v3_cross(sb_v3_sub(d.rest[v[1]], d.rest[v[0]]), sb_v3_sub(d.rest[v[2]], d.rest[v[0]])).x < 0;
            if (d.rest[v[k]].z < beam_size.z - REAL(1e-6))
                continue;
            sums[far_side] += (double)(d.positions[v[k]].x - d.rest[v[k]].x);
            counts[far_side]++;
        }
    sb_cut_surface_destroy(surface);
    CHECK(counts[0] > 0 && counts[1] > 0);
    return sums[1] / counts[1] - sums[0] / counts[0];
}

#endif /* CUT_FIGURES_H */
