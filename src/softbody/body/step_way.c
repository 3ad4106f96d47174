/* step_way: parts of the system that is solved, and how far nodes have gone in a static solve, against what. */
#include <math.h>

#include "../solve/sparse_live.h"
#include "step_private.h"

SBI_API const sb_matrix *sbi_step_parts(const sb_body *body)
{
    const sb_matrix *parts = body->elimination ? &body->elimination->matrix : &body->matrix;
    sbi_matrix_list_parts(parts);
    return parts;
}

SBI_API sbi_static_nodes sbi_static_part(const sb_body *b, int part)
{
    sbi_static_nodes nodes = {NULL, b->domain.node_count};
    if (part >= 0) {
        const sb_matrix *parts = sbi_step_parts(b);
        nodes.rows = parts->part_rows + parts->part_start[part];
        nodes.count = parts->part_start[part + 1] - parts->part_start[part];
    }
    return nodes;
}

SBI_API double sbi_static_work(unsigned axes, sb_vec3 a, sb_vec3 b)
{
    double sum = 0;
    sum += axes & SB_X ? fabs((double)a.x * (double)b.x) : 0;
    sum += axes & SB_Y ? fabs((double)a.y * (double)b.y) : 0;
    sum += axes & SB_Z ? fabs((double)a.z * (double)b.z) : 0;
    return sum;
}

SBI_API double sbi_static_largest(unsigned axes, sb_vec3 a)
{
    double largest = axes & SB_X ? fabs((double)a.x) : 0;
    largest = fmax(largest, axes & SB_Y ? fabs((double)a.y) : 0);
    return fmax(largest, axes & SB_Z ? fabs((double)a.z) : 0);
}

SBI_API sb_vec3 sbi_static_way(const sb_body *b, int i) { return sb_v3_sub(b->displacement[i], b->start[i]); }

SBI_API sb_real sbi_static_support_force(const sb_body *b, int part)
{
    sbi_static_nodes nodes = sbi_static_part(b, part);
    double work = 0, longest = 0;
    for (int k = 0; k < nodes.count; k++) {
        int i = sbi_static_node(&nodes, k);
        if (!b->fixed[i])
            continue;
        work += sbi_static_work(b->fixed[i], b->residual[i], sbi_static_way(b, i));
        longest = fmax(longest, sbi_static_largest(b->fixed[i], sbi_static_way(b, i)));
    }
    return longest > 0 ? (sb_real)(work / longest) : 0;
}
