/* loads: which few tractions on its surface give a matched organ its shape. Floor 6.
 *
 * A shape shows motion across the surface only. Where an organ was dragged along it, matching finds the motion of least
 * energy, which may be off by the length of the drag. But what moves an organ (the diaphragm, an instrument, a
 * ligament) acts on compact regions; the rest of its surface bears no load. That is what this room adds: of all
 * tractions, of any direction, that bring the surface to the target it takes those that act on little of it,
 *     minimise  sum_s (n_s . (x_s(f) - t_s))^2 / misfit^2 + sum_i |f_i|^2 / w_i
 * in which f are the forces on the surface's nodes, nothing acts inside, and w_i ~ area (traction + floor)^(2 - power)
 * follows from the tractions found the time before (iteratively reweighted least squares for a sum of powers). The
 * traction of w is averaged with the neighbours', so that loads fill regions.
 *
 * The samples s are means over small parts of the surface; what the surface scatters about them, in each part and in
 * all of them, adds to misfit^2, so that noise of the target and corners that facets cut are seen as such. Their
 * responses to all forces are one column each of the inverse stiffness (see direct.h), after which a round is a dense
 * system in the samples:
 *     (G W G^T + misfit^2) y = gap,   f = W G^T y.
 * Rounds repeat that from the shape found, as the stiffness follows it. The match's landmarks are samples of their
 * own, three each; weaken their springs during the match (landmark_stiffness), or loads have the springs' dents to
 * mend.
 *
 * What acts is mostly a body of its own (the diaphragm, an instrument) that goes one way, and with it the region of
 * the surface that it holds. A surface shows how far a region moved across itself; where its normals differ, one common
 * direction is all that agrees with that, and it tells the motion along the surface. So after two rounds the region
 * that bears loads is taken down and its motions' direction estimated; where they are near one, rounds that follow ask
 * for motions in one direction, which they find, too (`drag`). A direction for which many more loads are needed than
 * without it is dropped, and so is a region of fewer than ten parts, too small to be told from what is around it.
 *
 * The organ's pose can be sought with the loads, held nodes included (`pose`): of all poses the one that needs the
 * least loads. That is for a rigid start from a part of a deformed organ, which may be off by more than a centimetre.
 *
 * Where loads act on most of the surface there is nothing to find, and rounds do not come to rest: a last change of
 * more than a hundredth of the organ's size says so, and the match is the better answer then.
 *
 * The tractions are only as good as the material: the error of the corotated law at strains of a tenth bends what is
 * found more than it mends. Give the body a hyperelastic material (sb_body_set_material, e.g. neo-Hookean) after the
 * match, which needs none; Young's modulus does not matter, Poisson's ratio does. A hyperelastic material admits no
 * elements that are inside out, as firm charges may leave them where the target is noisy: end the match with a
 * last_charge of about 2 then. What the match's charges did not press into shape is found here. */
#ifndef REG_LOADS_H
#define REG_LOADS_H

#include "match.h"

/* What loads are found from. Start from reg_default_loads_def(), set match. */
typedef struct reg_loads_def {
    reg_match *match;   /* that has run, by distance (REG_PBSM); borrowed. Its charges, target and landmarks are used,
                         * its body is moved. Dead loads and gravity of the body are taken as known */
    int samples;        /* of the surface that the target shows, [30, 3000]; default 300; fewer where that is less than
                         * half of the organ's. Time and memory grow with their square */
    int rounds;         /* at most, [1, 100]; default 10. One that moves no node by a thousandth of the organ's size is
                         * the last, but for those that a drag is still looked for in */
    int reweights;      /* of the first round, [1, 1000]; default 9; later rounds take a third of that */
    sb_real misfit;     /* of a sample, as share of the organ's size, > 0; default 6e-5: what the coarseness of mesh
                         * and model leaves */
    sb_real power;      /* of the tractions, (0, 2]; default 0.5. 2: tractions are spread as evenly as can be; 1: the
                         * sum of forces is least; below: fewer regions, harder edges */
    sb_real floor;      /* tractions that count as none, in shares of the mean, > 0; default 0.01 */
    sb_real landmark;   /* standard deviation of a landmark's place, as share of the organ's size, [1e-6, 1]; default
                         * 1e-3: a third of a millimetre for a liver, what meshes leave */
    sb_real drag;       /* how far the motion of what bears loads may be off one common direction, as share of the
                         * motion, [0, 1); default 0.01. 0: directions are free */
    sb_real pose;       /* standard deviation of the rigid motion by which the organ, held nodes included, is off its
                         * place, as share of its size, >= 0; default 0: held nodes are where they are to be. 0.01
                         * after a rigid start; supports then move along */
    double max_seconds; /* > 0, with a clock: no round begins that would end later, if it takes as long as the one
                         * before; default 1e9 */
    sb_clock clock;     /* default NULL: times read 0 */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by reg_default_loads_def */
} reg_loads_def;
REG_API reg_loads_def reg_default_loads_def(void);

typedef struct reg_loads_info {
    int rounds;              /* done */
    sb_real mean_distance;   /* of the charges before the last round (m) */
    sb_real sample_misfit;   /* root mean square of the gaps of the surface's samples that the last round left, as it
                              * foresaw (m) */
    sb_real change;          /* largest displacement of a node in the last round (m): see above */
    sb_vec3 drag;            /* unit vector: the direction that loads moved their region in; 0: none in common */
    sb_real loaded;          /* share of the surface's area that bears more than a twentieth of the largest traction */
    double seconds;          /* of all, with a clock; among them for */
    double seconds_response; /* stiffness, its factor and the samples' responses, */
    double seconds_dense;    /* and the systems in the samples */
    sb_error error;          /* when the call failed */
} reg_loads_info;

/* Moves the body of a match to where loads on little of its surface bring it.
 * forces  [nodes of the body] found (N), 0 inside and where nodes are held; or NULL
 * info    or NULL
 * Returns SB_ERROR_ARGUMENT (a field, named), SB_ERROR_UNSUPPORTED (a Laplacian match; a body with pressures, springs,
 * mappings or constraints), SB_ERROR_STATE (its mesh has changed since the match was made), SB_ERROR_INVERTED (element
 * named), SB_ERROR_INDEFINITE,
 * SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED (nothing of the surface is near the target), SB_ERROR_MEMORY; the
 * body is then as before and forces are untouched. All memory is taken at the beginning and released at the end.
 * Deterministic. */
REG_API sb_result reg_loads_run(const reg_loads_def *def, sb_vec3 *forces, reg_loads_info *info);

#endif /* REG_LOADS_H */
