/* material_fit: constants of a material from test data: stress and stretch, relaxation. Floor 2.
 *
 * The hyperelastic models are linear in their constants, so that fits under incompressible kinematics are linear least
 * squares, by rotations row by row: nothing is allocated and the answer does not depend on a start. With the free
 * sides' stretch found for a compressible material, it is a few such solves (Gauss-Newton). All sums are double. */
#ifndef SB_MATERIAL_FIT_H
#define SB_MATERIAL_FIT_H

#include "material.h"

/* How a specimen was loaded, what its strain and stress mean. Stretch: length over rest length, > 0. */
typedef enum sb_test_kind {
    SB_TEST_UNIAXIAL = 1,    /* bar, sides free: stretch and stress along it */
    SB_TEST_EQUIBIAXIAL = 2, /* sheet, pulled alike in its plane: stretch and stress in the plane */
    SB_TEST_PLANAR = 3,      /* wide strip, its width held (pure shear): stretch and stress along it */
    SB_TEST_SIMPLE_SHEAR = 4 /* block, sheared: amount of shear (tangent of the angle), shear stress */
} sb_test_kind;

typedef enum sb_stress_measure {
    SB_STRESS_NOMINAL = 0, /* force per rest area */
    SB_STRESS_CAUCHY = 1   /* force per current area; the same in simple shear */
} sb_stress_measure;

/* One reading of a test. */
typedef struct sb_test_point {
    sb_test_kind kind;
    sb_stress_measure measure;
    sb_real strain; /* stretch (1 at rest) or amount of shear (0 at rest) */
    sb_real stress; /* [Pa] */
} sb_test_point;

typedef struct sb_fit_options {
    int order;        /* of SB_REDUCED_POLYNOMIAL: 1 to 3 constants; others ignore it. Default 2 */
    int relative;     /* 1: errors relative to each stress, whose points of stress 0 do not count (default);
                         0: errors in Pa, so that large stresses rule */
    int nonnegative;  /* 1: no constant below 0, which keeps the material stable; 0: as the data say (default) */
    int compressible; /* 1: free sides move as the material's compressibility says; 0: at constant volume (default).
                         Linear, corotated and St.Venant-Kirchhoff models are always fitted as with 1 */
    sb_real poisson;  /* in (-1, 0.5): bulk modulus in proportion to mu. Default 0.49 */
    sb_real d1;       /* [1/Pa]; > 0: bulk modulus 2/d1, poisson is not read. Default 0 */
    sb_real density;  /* [kg/m^3] > 0 of the result. Default 1000 */
} sb_fit_options;

SB_API sb_fit_options sb_default_fit_options(void);

typedef struct sb_fit_info {
    int points;        /* readings that counted */
    int constants;     /* constants fitted; Prony: terms kept */
    int iterations;    /* least-squares solves */
    sb_real rms;       /* root mean square error: of stress over stress when relative, else [Pa]; Prony: of g */
    sb_real r_squared; /* share of the readings' variance that is explained; 0 when they do not vary */
    /* The least part of a constant's influence that is its own, of 1: below 0.01 the constants answer for
     * each other, so that noise moves them far. */
    sb_real weakest;
    int stable; /* 1: Drucker stable, d(Kirchhoff stress) : d(log strain) > 0, over the range of each test */
    sb_test_kind unstable_kind; /* when not: the first test, and the strain nearest to rest, that is not */
    sb_real unstable_strain;
} sb_fit_info;

/* Fits a model to count readings of any tests together: mu, or c10 and c01, or c10, c20, c30; the compressibility is
 * the options'. options NULL: defaults; info, error may be NULL. Returns SB_OK and *material, which passes
 * sb_material_check; or, with *material and *info untouched: SB_ERROR_ARGUMENT (fewer readings than constants, a
 * stretch <= 0, an option out of range, SB_OGDEN or SB_FUNG, whose exponents no linear fit finds), SB_ERROR_NOT_FINITE,
 * SB_ERROR_INDEFINITE naming a constant that the data do not distinguish from the others (simple shear and planar tests
 * alone see c10 + c01 only), SB_ERROR_MATERIAL (the data ask for mu <= 0), SB_ERROR_NOT_CONVERGED or SB_ERROR_DIVERGED
 * (compressible only). Cost: below a microsecond a reading at constant volume, about 0.1 ms when compressible.
 * Formulas: Ogden, Non-Linear Elastic Deformations, 1984, ch. 7. */
SB_API sb_result sb_material_fit(sb_material_model model, const sb_test_point *data, int count,
                                 const sb_fit_options *options, sb_material *material, sb_fit_info *info,
                                 sb_error *error);

/* Fits Prony terms to the relaxation g(time[k]) of a sudden strain: stress over its value at time 0; time [s] > 0.
 * tau[terms] [s]: the relaxation times to use, each > 0; NULL: spread evenly in log time from the first to the last
 * reading. terms in 1 to SB_MAX_PRONY_TERMS. Nonnegative least squares: terms that the data do not ask for are left
 * out, so fewer may come back. On SB_OK *material, which comes in hyperelastic and in order, has these Prony terms in
 * place of its own. Else it and *info are untouched: SB_ERROR_ARGUMENT (fewer readings than terms, a time or tau <= 0),
 * SB_ERROR_NOT_FINITE, SB_ERROR_INDEFINITE naming a given tau that the data do not distinguish from the others, or
 * SB_ERROR_MATERIAL (the data relax to nothing, or the material is not in order). */
SB_API sb_result sb_material_fit_prony(const sb_real *time, const sb_real *g, int count, const sb_real *tau, int terms,
                                       sb_material *material, sb_fit_info *info, sb_error *error);

/* Fits Prony terms and the shear modulus to storage[count] and loss[count] [Pa] >= 0 of shear that oscillates with
 * omega[count] [rad/s] > 0 (a rheometer's G' and G''), errors relative to |G*| of each reading. tau, terms and errors
 * as above; tau NULL: spread evenly in log time over 1/omega. On SB_OK *material has these terms in place of its own
 * and all of its moduli in proportion, so that mu is the instantaneous modulus and Poisson's ratio stays; info->rms is
 * the relative error of G*. SB_ERROR_ARGUMENT also for fewer than (terms + 1)/2 readings, a modulus below 0, or both 0;
 * SB_ERROR_MATERIAL where the data have no modulus left at low frequencies: they are of a fluid, or end too early. */
SB_API sb_result sb_material_fit_moduli(const sb_real *omega, const sb_real *storage, const sb_real *loss, int count,
                                        const sb_real *tau, int terms, sb_material *material, sb_fit_info *info,
                                        sb_error *error);

#endif /* SB_MATERIAL_FIT_H */
