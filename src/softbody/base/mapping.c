#include "mapping.h"

SB_API void sb_mapping_apply(const sb_mapping *mapping, const sb_vec3 *x, sb_vec3 *out)
{
    if (!mapping || !x || !out)
        return;
    for (int j = 0; j < mapping->row_count; j++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int k = mapping->row_start[j]; k < mapping->row_start[j + 1]; k++)
            sum = sb_v3_madd(sum, mapping->weights[k], x[mapping->nodes[k]]);
        out[j] = sum;
    }
}

SB_API void sb_mapping_spread(const sb_mapping *mapping, const sb_vec3 *f, sb_vec3 *forces)
{
    if (!mapping || !f || !forces)
        return;
    for (int j = 0; j < mapping->row_count; j++)
        for (int k = mapping->row_start[j]; k < mapping->row_start[j + 1]; k++) {
            sb_vec3 *force = forces + mapping->nodes[k];
            *force = sb_v3_madd(*force, mapping->weights[k], f[j]);
        }
}
