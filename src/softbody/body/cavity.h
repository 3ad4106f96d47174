/* cavity: hollows of a body and what fills them: bladder, gall bladder, vessel, insufflated abdomen. Floor 3. */
#ifndef SB_CAVITY_H
#define SB_CAVITY_H

#include "load.h"

/* What a cavity is filled with: how its pressure (Pa, above what surrounds the body) depends on its volume V. None
 * rises with V. */
typedef enum sb_cavity_kind {
    SB_CAVITY_PRESSURE = 0, /* held at def.pressure */
    SB_CAVITY_GAS = 1,      /* (p + ambient) (V / filled)^exponent stays: def.pressure at V = filled */
    SB_CAVITY_LIQUID = 2,   /* p = def.pressure + bulk (1 - V / filled) */
    SB_CAVITY_VOLUME = 3,   /* V = filled, whatever pressure that takes */
    SB_CAVITY_TABLE = 4     /* p between the points of a table, and straight on beyond its ends */
} sb_cavity_kind;

enum { SB_MAX_CAVITY_POINTS = 16 };

typedef struct sb_cavity_def {
    const int *faces; /* [face_count][corners] corner nodes of outer faces of the body, in any order; together all
                       * around the cavity, or with rims that are closed by lids */
    int face_count;
    int corners; /* 3: faces of tets, 4: of hexahedra */
    sb_cavity_kind kind;
    sb_real pressure;                             /* Pa: of SB_CAVITY_PRESSURE, and of gas and liquid when added */
    sb_real ambient;                              /* Pa, >= 0: absolute pressure around the body; of gas */
    sb_real exponent;                             /* >= 0; of gas: 1 isothermal, 1.4 adiabatic air */
    sb_real bulk;                                 /* Pa, > 0: of liquid; water has 2.2e9 */
    int point_count;                              /* of the table, 2 .. SB_MAX_CAVITY_POINTS */
    sb_real table_volume[SB_MAX_CAVITY_POINTS];   /* m^3, ascending */
    sb_real table_pressure[SB_MAX_CAVITY_POINTS]; /* Pa, not ascending */
} sb_cavity_def;

/* SB_CAVITY_PRESSURE of 0, corners 3, ambient 101325, exponent 1, bulk 2.2e9; no faces. */
SB_API sb_cavity_def sb_default_cavity_def(void);

/* Adds a cavity as one load more, by whose id sb_body_load_force and sb_body_remove_load know it, too. The def is
 * copied. `filled`, of gas, liquid and SB_CAVITY_VOLUME, is the cavity's volume when it is added; a table is of V less
 * what was injected since.
 * - V = 1/3 int x.n over the faces, outward of the cavity, and over the lids of open rims: fans from the mean of a
 * rim's corner nodes, which hand the pressure on them to the rim as it follows from V. The force is p dV/dx. Where the
 *   faces close and the pressure is of the contents alone, it sums to 0, as does its torque.
 * - Its energy - int p dV is part of sb_energy.springs and of what line searches go down. The stiffness -dp/dV g g^T
 *   (g = dV/dx) is in every linear system, as a product, not as a block; what the turning of its faces adds is as for
 *   pressures, without that of lids.
 * - Liquid and SB_CAVITY_VOLUME: where -dp/dV is more than 100 times the body's own stiffness to growing (g.Kg /
 * |g|^4), solves take that, with a pressure that is corrected to the law's: static solves until the volume is that of
 * the law's pressure to 1e-11 of it or the tolerance of the forces shows no more; steps of SB_EULER and
 *   SB_GENERALISED_ALPHA once a step, so that the volume follows in a few steps. SB_NEWMARK and SB_CENTRAL_DIFFERENCE
 *   keep energy, and such a correction would swing without end: there the volume is some hundredth of what it grew by
 *   off, and what was injected at once rings. So no bulk is too stiff. Iterations of linear systems are up to 2.5
 *   times those with a given pressure.
 * - A static solve goes evenly from the pressure, `filled` and contents that the last one ended with to the present
 *   ones, and begins a new cavity with no pressure and filled to its present volume.
 * - When the mesh changes, it goes with its faces as pressures do, and rims are found anew. A face of it cannot be cut
 *   through (SB_ERROR_UNSUPPORTED): remove the cavity first. sb_body_modes leaves its stiffness out.
 * Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; no faces; corners; a face that no element has, twice, or between
 * two elements: error->node is its first; rims that touch: error->node; a volume of gas, liquid or SB_CAVITY_VOLUME
 * that is not positive, as that of faces that look out of a solid; numbers or a table out of range), SB_ERROR_INDEX
 * (error->node), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY, SB_ERROR_UNSUPPORTED (faces of cut elements). Source: Bonet and
 * Wood 2008, 8.6 (pressure of enclosed volumes); Rumpel and Schweizerhof 2003 (rank-one part). */
SB_API sb_result sb_body_add_cavity(sb_body *body, const sb_cavity_def *def, int *load_id, sb_error *error);
/* Adds volume (m^3, at the contents' own pressure; negative: takes away) to the contents, between steps, without
 * allocation. SB_ERROR_INDEX; SB_ERROR_ARGUMENT: of SB_CAVITY_PRESSURE, or more than there is; SB_ERROR_NOT_FINITE. */
SB_API sb_result sb_body_inject_cavity(sb_body *body, int load_id, sb_real volume);
/* Of SB_CAVITY_PRESSURE. SB_ERROR_INDEX, SB_ERROR_ARGUMENT (another kind), SB_ERROR_NOT_FINITE. */
SB_API sb_result sb_body_set_cavity_pressure(sb_body *body, int load_id, sb_real pressure);
/* Present volume (m^3), lids included. SB_ERROR_ARGUMENT, SB_ERROR_INDEX. */
SB_API sb_result sb_body_cavity_volume(sb_body *body, int load_id, sb_real *volume);
/* Pressure (Pa) in the last step or static solve; 0 before. */
SB_API sb_result sb_body_cavity_pressure(const sb_body *body, int load_id, sb_real *pressure);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Pressure and contents of a law, as recordings have them. */
SBI_API sb_result sbi_cavity_set(sb_body *body, int load_id, sb_real pressure, sb_real filled);
#endif

#endif /* SB_CAVITY_H */
