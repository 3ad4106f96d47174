/* heat_set: nodes that are held, and what else changes between steps. */
#include "heat_private.h"

#include <string.h>

/* ---- nodes that are held ---- */

static sb_result sbi_heat_check_node(const sb_heat *heat, int node, sb_error *error)
{
    if (node < 0 || node >= heat->node_count || !(heat->volume[node] > 0))
        return sbi_fail_node(error, SB_ERROR_INDEX, node, "node %d is out of range, or of no element", node);
    return SB_OK;
}

static sb_result sbi_heat_check_temperature(sb_real temperature, int node, sb_error *error)
{
    if (!sb_is_finite(temperature))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, node, "the temperature of node %d is not finite", node);
    if (!(temperature > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, node, "the temperature of node %d is %g, not above 0 K", node,
                             (double)temperature);
    return SB_OK;
}

SB_API sb_result sb_heat_hold(sb_heat *heat, const int *nodes, int count, const sb_real *temperatures, int uniform,
                              sb_error *error)
{
    if (!heat || count < 0 || (count > 0 && (!nodes || !temperatures)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_hold needs heat, nodes and temperatures");
    for (int k = 0; k < count; k++) {
        sb_result result = sbi_heat_check_node(heat, nodes[k], error);
        if (result == SB_OK)
            result = sbi_heat_check_temperature(temperatures[uniform ? 0 : k], nodes[k], error);
        if (result != SB_OK)
            return result;
    }
    for (int k = 0; k < count; k++) {
        sb_real temperature = temperatures[uniform ? 0 : k];
        heat->held[nodes[k]] = 1;
        heat->target[nodes[k]] = temperature;
        sbi_heat_tell(heat, SBI_HEAT_HOLD, nodes[k], &temperature, 1);
    }
    return SB_OK;
}

SB_API sb_result sb_heat_release(sb_heat *heat, const int *nodes, int count, sb_error *error)
{
    if (!heat || count < 0 || (count > 0 && !nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_release needs heat and nodes");
    for (int k = 0; k < count; k++) {
        sb_result result = sbi_heat_check_node(heat, nodes[k], error);
        if (result != SB_OK)
            return result;
    }
    for (int k = 0; k < count; k++) {
        heat->held[nodes[k]] = 0;
        sbi_heat_tell(heat, SBI_HEAT_RELEASE, nodes[k], NULL, 0);
    }
    return SB_OK;
}

/* ---- what else changes between steps ---- */

SB_API sb_result sb_heat_set_blood(sb_heat *heat, sb_real temperature)
{
    if (!heat)
        return SB_ERROR_ARGUMENT;
    if (!sb_is_finite(temperature))
        return SB_ERROR_NOT_FINITE;
    if (!(temperature > 0))
        return SB_ERROR_ARGUMENT;
    heat->def.blood = temperature;
    sbi_heat_tell(heat, SBI_HEAT_BLOOD, 0, &temperature, 1);
    return SB_OK;
}

SB_API sb_result sb_heat_set_temperatures(sb_heat *heat, const sb_real *temperatures, sb_error *error)
{
    if (!heat || !temperatures)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_set_temperatures needs heat and temperatures");
    for (int i = 0; i < heat->node_count; i++) {
        sb_result result = sbi_heat_check_temperature(temperatures[i], i, error);
        if (result != SB_OK)
            return result;
    }
    for (int i = 0; i < heat->node_count; i++)
        if (!heat->held[i])
            heat->temperature[i] = temperatures[i];
    sbi_heat_tell(heat, SBI_HEAT_TEMPERATURES, 0, temperatures, (size_t)heat->node_count);
    return SB_OK;
}

SB_API void sb_heat_reset(sb_heat *heat)
{
    if (!heat)
        return;
    for (int i = 0; i < heat->node_count; i++) {
        heat->temperature[i] = heat->def.start;
        heat->damage[i] = 0;
    }
    memset(&heat->balance, 0, sizeof heat->balance);
    if (sbi_heat_stiffen(heat))
        sbi_body_cells_stiffened(heat->body);
    sbi_heat_tell(heat, SBI_HEAT_RESET, 0, NULL, 0);
}
