/* unload: the shape that a body has without its loads, from the shape that was imaged under them. Floor 3.
 *
 * A scan shows an organ under gravity, pressure and what hangs on it. Simulated from that shape as if it were free of
 * stress it sags a second time. This finds the rest shape X whose equilibrium under the loads is the imaged shape x*:
 *
 * ```c
 * #include "softbody.h"
 * #include <stdio.h>
 * #include <stdlib.h>
 *
 * typedef struct my_organ {
 *     int held[9], tip; // nodes
 *     sb_vec3 weight;   // of what hangs on the tip (N)
 * } my_organ;
 *
 * static sb_result dress(void *user, sb_body *body, sb_real share, sb_error *error)
 * {
 *     const my_organ *organ = user;
 *     sb_vec3 weight = sb_v3_scale(share, organ->weight);
 *     // the body is in the imaged shape: what is held is held there
 *     sb_result result = sb_body_hold(body, organ->held, 9, SB_XYZ, error);
 *     return result == SB_OK ? sb_body_add_forces(body, &organ->tip, 1, &weight, 1) : result;
 * }
 *
 * int main(void)
 * {
 *     my_organ organ = {{0, 5, 10, 15, 20, 25, 30, 35, 40}, 44, {0, 0, (sb_real)-0.2}};
 *     sb_vec3 size = sb_v3((sb_real)0.4, (sb_real)0.1, (sb_real)0.1);
 *     sb_mesh imaged;
 *     sb_error error;
 *     if (sb_mesh_beam(SB_TET4, 4, 2, 2, size, NULL, &imaged, &error) != SB_OK)
 *         return 1;
 *     sb_vec3 *rest = malloc((size_t)imaged.node_count * sizeof *rest);
 *     sb_unload_def def = sb_default_unload_def();
 *     sb_unload_report report;
 *     sb_body *body = NULL;
 *     def.body.mesh = &imaged;
 *     def.body.material = sb_material_neo_hookean((sb_real)2e5, (sb_real)0.4, 1060);
 *     def.body.gravity = sb_v3(0, 0, (sb_real)-9.81);
 *     def.dress = dress;
 *     def.user = &organ;
 *     if (!rest || sb_body_unload(&def, rest, &body, &report, &error) != SB_OK) {
 *         printf("%s\n", error.message);
 *         return 1;
 *     }
 *     printf("at rest a node is up to %g m away, found by %d systems\n", (double)report.moved, report.solves);
 *     sb_body_step(body, (sb_real)0.01, NULL); // goes on from the image, in balance
 *     sb_body_destroy(body);
 *     free(rest);
 *     sb_mesh_free(&imaged);
 *     return 0;
 * }
 * ```
 *
 * Method: the rest shape moves by what the image would (X <- X + x* - x, Sellier 2011), x being the first iteration of
 * the forward solve from the image: one linear system with the tangent there, so that nothing falls over on the way.
 * Anderson's mixing of the last five ways (Walker and Ni 2011) makes it converge where each by itself would not. A
 * forward solve verifies the result. Everything that statics know takes part: elements, materials, loads,
 * constraints. */
#ifndef SB_UNLOAD_H
#define SB_UNLOAD_H

#include "body.h"
#include "step.h"

/* What is known of the imaged body. Start from sb_default_unload_def(). */
typedef struct sb_unload_def {
    sb_body_def body; /* its mesh is in the imaged shape; gravity is multiplied by the share of the loads. domain has to
                       * be NULL (SB_ERROR_UNSUPPORTED). Fibre directions are those at rest */
    /* Adds supports and `share` (0, 1] of the loads to a body that is in the imaged shape; called once for each trial.
     * Pressures act on the imaged surface; tractions are per area of the trial's rest shape, and dead forces stay what
     * they are. Returns SB_OK, or what ends the call (error may be left as it is). NULL: none, gravity alone */
    sb_result (*dress)(void *user, sb_body *body, sb_real share, sb_error *error);
    void *user;
    sb_static_options
        statics;        /* of the verifying solve; default sb_default_static_options() with tolerance 1e-9, forces_only.
                         * instantaneous counts for the search, too: Prony terms as after a sudden load; 0: relaxed */
    sb_real tolerance;  /* largest |x* - x| over the diagonal of the bounding box, (0, 1); default 1e-6, in float
                         * 1e-5 */
    int max_iterations; /* trials for each share of the loads, >= 1; default 60 */
    int load_steps;     /* shares to begin with, 1 to 1000; one that fails is halved, six times; default 1 */
    unsigned cookie;    /* set by sb_default_unload_def */
} sb_unload_def;

SB_API sb_unload_def sb_default_unload_def(void);

typedef struct sb_unload_report {
    int solves;     /* trials in all, a linear system each: 4 to 11 where nodes move by up to a tenth of the size, 8
                     * to 50 up to a third, some hundreds beyond */
    int load_steps; /* shares taken */
    sb_real share;  /* of the loads that is reached, 1 on success */
    sb_real gap;    /* largest |x* - x| at the end (m) */
    sb_real size;   /* diagonal of the imaged bounding box (m) */
    sb_real moved;  /* largest |x* - X| (m) */
    sb_error error; /* as returned */
} sb_unload_report;

/* Finds the rest shape.
 * rest    [node_count] (m) receives it; may be the imaged mesh's own nodes. Held nodes keep their place along the
 *         held axes
 * body    receives the body made from it, with its supports and loads, at rest in the imaged shape: destroy it with
 *         sb_body_destroy. May be NULL. Quadratic elements with lumped masses weigh nodes otherwise in steps than in
 *         statics, and move on from there by some thousandths of their size: SB_MASS_CONSISTENT stays
 * report  may be NULL; written also on failure
 * Makes a body for each trial, from def->body.allocator; the same bits for any number of threads. On failure rest and
 * *body are untouched: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, whatever sb_body_create and dress say of the imaged
 * mesh, SB_ERROR_MEMORY, SB_ERROR_UNCONSTRAINED, or that of the last trial where no rest shape is found
 * (SB_ERROR_NOT_CONVERGED, SB_ERROR_INVERTED, SB_ERROR_INDEFINITE: the image is in balance but buckles away;
 * report->gap and share tell how far it came). What asks too much: an image that its loads, put on as if it were at
 * rest, would move by more than its size; a limit load.
 * Success says that the image is in balance, not that it is stable: a straight column beyond its buckling load returns
 * SB_OK (nothing pushes it aside), and under compression rest shapes need not be the only ones. Where that may be, ask
 * sb_body_modes of *body with options.at_present: SB_ERROR_INDEFINITE where it would buckle. */
SB_API sb_result sb_body_unload(const sb_unload_def *def, sb_vec3 *rest, sb_body **body, sb_unload_report *report,
                                sb_error *error);

#endif /* SB_UNLOAD_H */
