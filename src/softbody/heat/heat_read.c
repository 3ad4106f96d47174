/* heat_read: what heat has come to. */
#include "heat_private.h"

SB_API const sb_real *sb_heat_temperatures(const sb_heat *heat) { return heat ? heat->temperature : NULL; }

SB_API const sb_real *sb_heat_damage(const sb_heat *heat) { return heat ? heat->damage : NULL; }

SB_API void sb_heat_dead_shares(const sb_heat *heat, sb_real *shares)
{
    for (int i = 0; heat && shares && i < heat->node_count; i++)
        shares[i] = (sb_real)sbi_heat_dead(heat, i);
}

SB_API sb_real sb_heat_dead_volume(const sb_heat *heat)
{
    double sum = 0;
    for (int i = 0; heat && i < heat->node_count; i++)
        sum += heat->volume[i] * sbi_heat_dead(heat, i);
    return (sb_real)sum;
}

SB_API void sb_heat_stiffness(const sb_heat *heat, sb_real *factors)
{
    for (int e = 0; heat && factors && e < heat->body->domain.cell_count; e++)
        factors[e] = heat->stiffness ? heat->stiffness[e] : 1;
}

SB_API sb_heat_flows sb_heat_balance(const sb_heat *heat)
{
    static const sb_heat_flows none = {0, 0, 0, 0, 0, 0, 0};
    return heat ? heat->balance : none;
}
