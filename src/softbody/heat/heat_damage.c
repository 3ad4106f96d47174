/* heat_damage: Arrhenius' law at the nodes, and the stiffness that follows from it. */
#include "heat_private.h"

static const double sbi_heat_gas = 8.314;        /* J/(mol K), to the digits that A and E_a were published with */
static const double sbi_heat_most_exponent = 40; /* ln of 1/s: dead within any step, and far from overflow */
static const double sbi_heat_widest = 1;         /* K over which the rate's trapezoid is taken */
enum { SBI_HEAT_MOST_PARTS = 10000 };

/* A exp(-E_a / (R T)) (1/s) */
static double sbi_heat_rate(const sb_heat *heat, double temperature)
{
    double exponent;
    if (!(temperature > (double)heat->def.harmless))
        return 0;
    exponent = (double)heat->def.log_frequency - (double)heat->def.activation / (sbi_heat_gas * temperature);
    return sbi_dense_exp(exponent < sbi_heat_most_exponent ? exponent : sbi_heat_most_exponent);
}

SBI_API void sbi_heat_harm(sb_heat *heat, double dt)
{
    for (int i = 0; i < heat->node_count; i++) {
        double from = (double)heat->temperature[i], rise = heat->rise[i], sum = 0;
        double wanted = ceil(fabs(rise) / sbi_heat_widest);
        int parts = wanted < 1 ? 1 : wanted < (double)SBI_HEAT_MOST_PARTS ? (int)wanted : (int)SBI_HEAT_MOST_PARTS;
        for (int k = 0; k <= parts; k++)
            sum += (k == 0 || k == parts ? 0.5 : 1) * sbi_heat_rate(heat, from + rise * k / parts);
        sum = (double)heat->damage[i] + dt * sum / parts;
        heat->new_damage[i] = sum < (double)SB_REAL_MAX ? (sb_real)sum : SB_REAL_MAX; /* all dead by far, and finite */
    }
}

SBI_API int sbi_heat_stiffen(sb_heat *heat)
{
    const sb_domain *domain = &heat->body->domain;
    int changed = 0;
    for (int e = 0; heat->stiffness && e < domain->cell_count; e++) {
        const int *cell = domain->cells + (size_t)e * (size_t)domain->nodes_per_cell;
        double dead = 0;
        sb_real factor;
        for (int a = 0; a < domain->nodes_per_cell; a++)
            dead += sbi_heat_dead(heat, cell[a]);
        factor = (sb_real)(1 + (double)heat->def.stiffening * dead / domain->nodes_per_cell);
        changed |= factor < heat->stiffness[e] || factor > heat->stiffness[e];
        heat->stiffness[e] = factor;
    }
    return changed;
}
