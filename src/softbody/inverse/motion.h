/* motion: gradients through time: how a loss over a recorded motion answers to parameters, to where and how fast the
 * motion began, and to a force in each step. Floor 4.
 *
 * ```c
 * #include <stdio.h>
 * #include <string.h>
 *
 * #define SB_IMPLEMENTATION
 * #include "softbody.h"
 *
 * static void miss(void *user, int step, const sb_vec3 *u, sb_vec3 *dj_du) // J: half the square of what a node misses
 * {
 *     const sb_vec3 *seen = (const sb_vec3 *)user; // of each step (m)
 *     dj_du[4] = sb_v3_sub(u[4], seen[step]);
 * }
 *
 * int main(void)
 * {
 *     static sb_vec3 seen[20];
 *     sb_recording_loss loss = {miss, seen};
 *     sb_recording_slopes slopes = {NULL, NULL, NULL, NULL};
 *     sb_real slope = 0; // per Pa
 *     sb_parameter young;
 *     sb_recording *recording;
 *     sb_body_def def = sb_default_body_def();
 *     sb_mesh mesh;
 *     sb_body *body;
 *     sb_error error;
 *     int held[9] = {0, 5, 10, 15, 20, 25, 30, 35, 40}; // the end x = 0
 *     memset(&young, 0, sizeof young);
 *     young.kind = SB_PARAMETER_YOUNG;
 *     slopes.gradient = &slope;
 *     if (sb_mesh_beam(SB_TET4, 4, 2, 2, sb_v3((sb_real)0.1, (sb_real)0.02, (sb_real)0.02), NULL, &mesh, &error))
 *         return 1;
 *     def.mesh = &mesh;
 *     def.material = sb_material_neo_hookean(20000, (sb_real)0.4, 1000);
 *     def.gravity = sb_v3(0, 0, (sb_real)-9.81);
 *     def.max_newton = 20; // iterated steps, to
 *     def.newton_tolerance = (sb_real)1e-8;
 *     if (sb_body_create(&def, &body, &error) || sb_body_hold(body, held, 9, SB_XYZ, &error))
 *         return 1;
 *     if (sb_recording_start(body, 0, NULL, &recording, &error))
 *         return 1;
 *     for (int step = 0; step < 20; step++)
 *         if (sb_body_step(body, (sb_real)0.01, NULL))
 *             return 1;
 *     sb_recording_stop(recording);
 *     if (sb_recording_gradient(recording, body, &loss, &young, 1, &slopes, &error))
 *         return printf("%s\n", error.message), 1;
 *     printf("stiffer by 1 kPa: J + %g m^2\n", 1000 * (double)slope);
 *     sb_recording_destroy(recording);
 *     sb_body_destroy(body);
 *     sb_mesh_free(&mesh);
 *     return 0;
 * }
 * ``` */
#ifndef SB_MOTION_H
#define SB_MOTION_H

#include "../body/record.h"
#include "sensitivity.h"

/* A loss J over the steps of a recording. add_slope adds a step's part to dj_du [node_count], which is 0 when it is
 * called: dJ/du (J's unit per m) at the displacements (m) that the step led to. Steps are numbered as in
 * sb_recording_report; it is called once for each that went well, and not in their order. */
typedef struct sb_recording_loss {
    void (*add_slope)(void *user, int step, const sb_vec3 *displacements, sb_vec3 *dj_du);
    void *user; /* handed to it; may be NULL */
} sb_recording_loss;

/* Where gradients go; NULL: not wanted. Untouched on failure. */
typedef struct sb_recording_slopes {
    sb_real *gradient;     /* [parameter_count] dJ/dp */
    sb_vec3 *displacement; /* [node_count] dJ/du (per m) of the shape that the first step began with */
    sb_vec3 *velocity;     /* [node_count] dJ/dv (per m/s) of its speed */
    sb_vec3 *force;        /* [sb_recording_info.steps][node_count] dJ/d(dead force on a node in this step) (per N);
                            * 0 of solves that are no time step, and of steps that failed */
} sb_recording_slopes;

/* Gradient of a loss over all steps of a recording with respect to any number of parameters: one linear solve for each
 * step, whatever their number.
 *   recording   of steps of implicit Euler that are iterated (sb_body_def.max_newton > 1) to newton_tolerance 1e-6 or
 *               less, of any lengths; what was called before the first step is where it began
 *   body        as of sb_recording_replay, and no recording listens to it. It ends as the recording does; on failure it
 *               is what it was before
 *   loss        see above
 *   parameters  [parameter_count], of every kind but SB_PARAMETER_SUPPORT. A parameter that calls changed between steps
 *               has all of its values shifted alike, and one of a load is of the steps in which the load was there
 * Calls between steps count as given: a node held where it was is held at that place, whatever moves it there.
 * Errors: those of sb_body_gradient and sb_recording_replay, about steps by number; SB_ERROR_UNSUPPORTED: another
 * integrator or linearised steps, whose derivatives would need those of the tangent; Prony terms; damping in proportion
 * to stiffness unless all materials are linear; damping by regions; a body whose mesh may change (def.slack); contact
 * that presses; the density of a grid's elements; calls after the first step that set displacements, velocities or a
 * state, or solve for a rest.
 * Cost: the recording is played twice, and per step a tangent is made, factored up to 10,000 nodes, and solved with.
 * Memory, for the time of the call: some 2 sqrt(steps) saved states and displacements.
 * Method: adjoint. With A = M/dt^2 + D/dt + K at the end of a step, backwards: A l = dJ/du + U + V/dt, then
 * U = (M/dt^2 + D/dt) l - V/dt and V = M l/dt of the step before; dJ/dp -= l . dr/dp, dJ/df = l. */
SB_API sb_result sb_recording_gradient(const sb_recording *recording, sb_body *body, const sb_recording_loss *loss,
                                       const sb_parameter *parameters, int parameter_count,
                                       const sb_recording_slopes *slopes, sb_error *error);

#endif /* SB_MOTION_H */
