/* The same bits everywhere: hashes of short scenes, recorded once. They must hold for every compiler, optimisation
 * level and number of threads; when a change of the mathematics moves them, print them anew with GOLDEN=1. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

typedef struct golden_scene {
    const char *name;
    sb_element_type type;
    int neo_hookean;
    sb_integrator integrator;
    unsigned long long expected; /* of double */
} golden_scene;

static const golden_scene scenes[] = {
    {"tet4 corotated Euler", SB_TET4, 0, SB_EULER, 0x96e3957aab3fb5c2ULL},
    {"tet10 corotated Newmark", SB_TET10, 0, SB_NEWMARK, 0x1c55f3928a0419f0ULL},
    {"hex8 corotated Euler", SB_HEX8, 0, SB_EULER, 0x7c4ca077579da9c3ULL},
    {"tet4 neo-Hookean Newmark", SB_TET4, 1, SB_NEWMARK, 0x53b0364d661af297ULL},
    {"tet10 neo-Hookean Euler", SB_TET10, 1, SB_EULER, 0x1ed7626bc0203a9cULL},
};

static void test_golden(void)
{
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("golden hashes are of double");
        return;
    }
    for (size_t i = 0; i < sizeof scenes / sizeof scenes[0]; i++) {
        sb_material material = scenes[i].neo_hookean ? sb_material_neo_hookean(REAL(2e4), REAL(0.4), REAL(1000))
                                                     : sb_material_corotated(REAL(2e4), REAL(0.4), REAL(1000));
        unsigned long long hash = scene_play(scenes[i].type, material, scenes[i].integrator, 12, jobs);
        if (getenv("GOLDEN"))
            printf("  %s 0x%016llxULL\n", scenes[i].name, hash);
        if (!CHECK(hash == scenes[i].expected))
            printf("  %s: 0x%016llx\n", scenes[i].name, hash);
    }
}

CHECK_SUITE(golden, {"golden scenes", test_golden});
