/* needle_stiffness.h: how stiff a needle's base is, the needle deep in a block of gel and pushed aside. */
#ifndef NEEDLE_STIFFNESS_H
#define NEEDLE_STIFFNESS_H

#include "needle_scene.h"

/* A scene's block becomes one of 7 cm without friction; the needle will be 45 mm deep. */
static inline void needle_make_deep(needle_scene *s, ndl_rod_preset preset, double young)
{
    s->size = sb_v3(REAL(0.07), REAL(0.07), REAL(0.07));
    s->materials[0].young = REAL(young), s->materials[0].poisson = REAL(0.45);
    s->frictions[0].friction = s->frictions[0].cutting = 0;
    ndl_rod_section_preset(preset, &s->needle_def.section);
    s->needle_def.base = sb_v3(REAL(0.0353), REAL(0.0341), REAL(0.082));
    s->needle_def.length = REAL(0.011);
    s->body_def.max_iterations = 2000;
}

/* Force over way of its base, pushed aside by half a millimetre and held for `rest` steps of 50 ms (N/m); ends the
 * scene. */
static inline double needle_side_stiffness(needle_scene *s, int rest)
{
    const double way = 0.0005;
    double result = 0;
    ndl_command aside = needle_command(0, 0);
    aside.velocity.x = REAL(way / 0.2);
    if (needle_scene_make(s) && needle_scene_run(s, 0.05, 46, needle_command(0.02, 0))) {
        sb_vec3 before, after;
        ndl_needle_base_wrench(s->needles[0], &before, NULL);
        needle_scene_run(s, 0.05, 4, aside);
        needle_scene_run(s, 0.05, rest, needle_command(0, 0));
        ndl_needle_base_wrench(s->needles[0], &after, NULL);
        result = (double)(after.x - before.x) / way;
        CHECK_NEAR(ndl_needle_depth(s->needles[0]), 0.045, 1e-4);
    }
    needle_scene_free(s);
    return result;
}

#endif /* NEEDLE_STIFFNESS_H */
