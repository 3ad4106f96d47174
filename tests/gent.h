/* gent.h: a material law as a user would bring one, which the library does not have. */
#ifndef GENT_H
#define GENT_H

#include "scene.h"

/* Gent (1996): W = -mu limit/2 ln(1 - (I1b - 3)/limit), and K (J ln J - J + 1): no value at I1b - 3 >= limit. */
typedef struct gent {
    sb_real mu, limit, bulk;
} gent;

static inline int gent_share(const gent *g, const sb_mat3 *F, sb_real *J, sb_real *i)
{
    *J = sb_m3_det(*F);
    if (!(*J > 0))
        return 0;
    *i = sb_m3_ddot(*F, *F) / (sb_cbrt(*J) * sb_cbrt(*J)) - 3;
    return *i < g->limit;
}

static inline int gent_energy(void *user, const sb_mat3 *F, sb_real *W)
{
    const gent *g = (const gent *)user;
    sb_real J, i;
    if (!gent_share(g, F, &J, &i))
        return 0;
    *W = -REAL(0.5) * g->mu * g->limit * sb_log(1 - i / g->limit) + g->bulk * (J * sb_log(J) - J + 1);
    return 1;
}

static inline int gent_stress(void *user, const sb_mat3 *F, sb_mat3 *P)
{
    const gent *g = (const gent *)user;
    sb_real J, i, slope;
    sb_mat3 back;
    if (!gent_share(g, F, &J, &i))
        return 0;
    back = sb_m3_scale(1 / J, sb_m3_cofactor(*F));
    slope = g->mu / (1 - i / g->limit);
    *P = sb_m3_sub(*F, sb_m3_scale(sb_m3_ddot(*F, *F) / 3, back));
    *P = sb_m3_scale(slope / (sb_cbrt(J) * sb_cbrt(J)), *P);
    *P = sb_m3_add(*P, sb_m3_scale(g->bulk * J * sb_log(J), back));
    return 1;
}

static inline sb_material_law gent_law(gent *g)
{
    sb_material_law law;
    law.name = "gent";
    law.user = g;
    law.energy = gent_energy;
    law.stress = gent_stress;
    law.tangent = NULL;
    return law;
}

#endif /* GENT_H */
