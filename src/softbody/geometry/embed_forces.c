/* embed_forces: the transpose of an update: forces on points brought to the nodes. */
#include "embed_follow.h"

/* ---- the transpose ---- */

/* Sums of force contributions of a group, lane by lane. */
typedef struct sbi_embed_sums {
    sbi_embed_vec3 force[SB_MAX_ELEMENT_NODES];
    sbi_embed_vec3 pull[SB_MAX_FACE_NODES];
} sbi_embed_sums;

/* sum_a += weight_a v */
static void sbi_embed_spread_force(int count, const sb_real *weight, int stride, const sbi_embed_vec3 *v,
                                   sbi_embed_vec3 *sum)
{
    for (int a = 0; a < count; a++)
        sbi_embed_madd(&sum[a], weight + a * stride, v);
}

/* Derivative with respect to the sum m of nodal normals: d (F - n (n . F)) / |m|. */
static void sbi_embed_pull_offset(const sb_embedding *e, const sbi_embed_cell *cell, const sbi_embed_lanes *lanes,
                                  int slot, const sbi_embed_vec3 *force, sbi_embed_sums *sums)
{
    sb_real inverse[SBI_EMBED_LANES], along[SBI_EMBED_LANES];
    const sb_real *distance = e->arrays.parameters[2] + slot;
    sbi_embed_vec3 n, pull = *force;
    sbi_embed_sum(cell->count, lanes->shape[0], SBI_EMBED_LANES, cell->normal, &n);
    sbi_embed_normalise(&n, inverse);
    SBI_EMBED_EACH_LANE(l)
    along[l] = -(force->x[l] * n.x[l] + force->y[l] * n.y[l] + force->z[l] * n.z[l]);
    sbi_embed_madd(&pull, along, &n);
    SBI_EMBED_EACH_LANE(l)
    {
        sb_real scale = distance[l] * inverse[l];
        pull.x[l] *= scale;
        pull.y[l] *= scale;
        pull.z[l] *= scale;
    }
    sbi_embed_spread_force(cell->count, lanes->shape[0], SBI_EMBED_LANES, &pull, sums->pull);
}

/* Forces on the tangents a, b that turn the frame which holds offset o: with the moment t = o x F,
 * dW = h . dn + (t . n) (e2 . da) / |a|, h = (t . e2) e1 - (t . e1) e2,
 * dn = (I - n n^T) (da x b + a x db) / |a x b|. */
static void sbi_embed_pull_frame(sb_vec3 a, sb_vec3 b, sb_vec3 coordinates, sb_vec3 force, sb_vec3 *on_a, sb_vec3 *on_b)
{
    sb_mat3 frame = sbi_embed_face_frame(a, b);
    sb_vec3 e1 = sb_m3_column(frame, 0), e2 = sb_m3_column(frame, 1), n = sb_m3_column(frame, 2);
    sb_vec3 moment = sb_v3_cross(sb_m3_apply(frame, coordinates), force), h;
    sb_real area = sb_v3_norm(sb_v3_cross(a, b)), length = sb_v3_norm(a);
    *on_a = *on_b = sb_v3(0, 0, 0);
    if (!(area > 0))
        return;
    h = sb_v3_sub(sb_v3_scale(sb_v3_dot(moment, e2), e1), sb_v3_scale(sb_v3_dot(moment, e1), e2));
    h = sb_v3_scale(1 / area, h);
    *on_a = sb_v3_madd(sb_v3_cross(b, h), sb_v3_dot(moment, n) / length, e2);
    *on_b = sb_v3_cross(h, a);
}

static void sbi_embed_pull_frames(const sb_embedding *e, const sbi_embed_cell *cell, const sbi_embed_lanes *lanes,
                                  int slot, const sbi_embed_vec3 *force, sbi_embed_sums *sums)
{
    sb_real *const *offsets = e->arrays.offsets;
    sbi_embed_vec3 tangent[3], pull[2];
    sbi_embed_tangents(cell, lanes, tangent);
    SBI_EMBED_EACH_LANE(l)
    {
        sb_vec3 on[2];
        sb_vec3 offset = sb_v3(offsets[0][slot + l], offsets[1][slot + l], offsets[2][slot + l]);
        sbi_embed_pull_frame(sbi_embed_lane(&tangent[0], l), sbi_embed_lane(&tangent[1], l), offset,
                             sbi_embed_lane(force, l), &on[0], &on[1]);
        sbi_embed_set_lane(&pull[0], l, on[0]);
        sbi_embed_set_lane(&pull[1], l, on[1]);
    }
    for (int k = 0; k < 2; k++)
        sbi_embed_spread_force(cell->count, lanes->slope[0][k], 3 * SBI_EMBED_LANES, &pull[k], sums->force);
}

static sb_vec3 sbi_embed_lane_sum(const sbi_embed_vec3 *v)
{
    sb_vec3 sum = sbi_embed_lane(v, 0);
    for (int l = 1; l < SBI_EMBED_LANES; l++)
        sum = sb_v3_add(sum, sbi_embed_lane(v, l));
    return sum;
}

static void sbi_embed_group_forces(const sbi_embed_frame *frame, const sbi_embed_group *group)
{
    const sb_embedding *e = frame->embedding;
    const sbi_embed_arrays *arrays = &e->arrays;
    size_t entry = (size_t)(group - arrays->groups) * (size_t)arrays->rows[SBI_EMBED_OF_GROUPS].width;
    int is_offset = group->hold == SB_EMBEDDED_OFFSET, left = group->count;
    sbi_embed_cell cell;
    sbi_embed_sums sums;
    sbi_embed_cell_gather(e, group, frame->x, &cell);
    memset(sums.force, 0, sizeof sums.force[0] * (size_t)cell.count);
    memset(sums.pull, 0, sizeof sums.pull);
    for (int block = group->first_block; block >= 0; block = arrays->block_next[block], left -= SBI_EMBED_LANES) {
        int slot = block * SBI_EMBED_LANES;
        sbi_embed_lanes lanes;
        sbi_embed_vec3 force;
        SBI_EMBED_EACH_LANE(l)
        sbi_embed_set_lane(&force, l, l < left ? frame->forces[arrays->slot_point[slot + l]] : sb_v3(0, 0, 0));
        sbi_embed_slot_shape(e, group->hold, cell.type, cell.count, slot, 0, &lanes);
        sbi_embed_spread_force(cell.count, lanes.shape[0], SBI_EMBED_LANES, &force, sums.force);
        if (is_offset)
            sbi_embed_pull_offset(e, &cell, &lanes, slot, &force, &sums);
        else if (group->hold == SB_EMBEDDED_FRAME)
            sbi_embed_pull_frames(e, &cell, &lanes, slot, &force, &sums);
    }
    for (int a = 0; a < cell.count; a++) {
        arrays->rows[SBI_EMBED_OF_GROUPS].forces[entry + (size_t)a] = sbi_embed_lane_sum(&sums.force[a]);
        if (is_offset)
            arrays->pulls[entry + (size_t)a] = sbi_embed_lane_sum(&sums.pull[a]);
    }
}

static void sbi_embed_task_forces(void *user, int task)
{
    const sbi_embed_frame *frame = (const sbi_embed_frame *)user;
    const sbi_embed_arrays *arrays = &frame->embedding->arrays;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_GROUPS, arrays->rows[SBI_EMBED_OF_GROUPS].end);
    for (int g = task * SBI_EMBED_TASK_GROUPS; g < end; g++)
        if (arrays->groups[g].count > 0)
            sbi_embed_group_forces(frame, &arrays->groups[g]);
}

/* From a unit nodal normal to the sum of face normals it is the direction of. */
static void sbi_embed_task_normal_pulls(void *user, int task)
{
    const sbi_embed_arrays *arrays = &((const sbi_embed_frame *)user)->embedding->arrays;
    const sbi_embed_rows *rows = &arrays->rows[SBI_EMBED_OF_GROUPS];
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_NODES, arrays->touched_end);
    for (int i = task * SBI_EMBED_TASK_NODES; i < end; i++) {
        const sbi_embed_touched *touched = &arrays->touched[i];
        sb_vec3 sum = sb_v3(0, 0, 0), n;
        if (touched->node < 0 || touched->normal_users == 0)
            continue;
        n = arrays->normals[i];
        for (int entry = touched->first[SBI_EMBED_OF_GROUPS]; entry >= 0; entry = rows->next[entry])
            if (arrays->groups[entry / rows->width].hold == SB_EMBEDDED_OFFSET)
                sum = sb_v3_add(sum, arrays->pulls[entry]);
        sum = sb_v3_madd(sum, -sb_v3_dot(n, sum), n);
        arrays->normal_pulls[i] = arrays->lengths[i] > 0 ? sb_v3_scale(1 / arrays->lengths[i], sum) : sb_v3(0, 0, 0);
    }
}

/* From the face normals n = a x b / |a x b| to the nodes: q = (I - n n^T) g / |a x b|,
 * f_I = N_I,r b x q - N_I,s a x q. */
static void sbi_embed_face_forces(const sbi_embed_frame *frame, int f)
{
    const sb_embedding *e = frame->embedding;
    const sbi_embed_arrays *arrays = &e->arrays;
    const sbi_embed_rows *rows = &arrays->rows[SBI_EMBED_OF_FACES];
    int width = rows->width;
    size_t first = (size_t)f * (size_t)width;
    sb_vec3 *out = rows->forces + first, x[SB_MAX_FACE_NODES];
    for (int i = 0; i < width; i++) {
        x[i] = frame->x[rows->nodes[first + (size_t)i]];
        out[i] = sb_v3(0, 0, 0);
    }
    for (int i = 0; i < width; i++) {
        int touched = rows->touched[first + (size_t)i];
        sb_vec3 a = sb_v3(0, 0, 0), b = a, n, q, on_a, on_b;
        sb_real area;
        for (int j = 0; j < width; j++) {
            a = sb_v3_madd(a, e->face.slope[0][j][i], x[j]);
            b = sb_v3_madd(b, e->face.slope[1][j][i], x[j]);
        }
        n = sb_v3_cross(a, b);
        area = sb_v3_norm(n);
        if (arrays->touched[touched].normal_users == 0 || !(area > 0))
            continue;
        n = sb_v3_scale(1 / area, n);
        q = sb_v3_scale(arrays->face_weights[first + (size_t)i] / area, arrays->normal_pulls[touched]);
        q = sb_v3_madd(q, -sb_v3_dot(n, q), n);
        on_a = sb_v3_cross(b, q);
        on_b = sb_v3_cross(q, a);
        for (int j = 0; j < width; j++)
            out[j] = sb_v3_madd(sb_v3_madd(out[j], e->face.slope[0][j][i], on_a), e->face.slope[1][j][i], on_b);
    }
}

static void sbi_embed_task_face_forces(void *user, int task)
{
    const sbi_embed_frame *frame = (const sbi_embed_frame *)user;
    const sbi_embed_rows *rows = &frame->embedding->arrays.rows[SBI_EMBED_OF_FACES];
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_FACES, rows->end);
    for (int f = task * SBI_EMBED_TASK_FACES; f < end; f++)
        if (rows->nodes[(size_t)f * (size_t)rows->width] >= 0)
            sbi_embed_face_forces(frame, f);
}

static void sbi_embed_task_touched(void *user, int task)
{
    const sbi_embed_frame *frame = (const sbi_embed_frame *)user;
    const sbi_embed_arrays *arrays = &frame->embedding->arrays;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_NODES, arrays->touched_end);
    for (int i = task * SBI_EMBED_TASK_NODES; i < end; i++) {
        const sbi_embed_touched *touched = &arrays->touched[i];
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (touched->node < 0)
            continue;
        for (int kind = 0; kind < SBI_EMBED_KINDS; kind++)
            for (int entry = touched->first[kind]; entry >= 0; entry = arrays->rows[kind].next[entry])
                sum = sb_v3_add(sum, arrays->rows[kind].forces[entry]);
        frame->node_forces[touched->node] = sb_v3_add(frame->node_forces[touched->node], sum);
    }
}

SB_API sb_result sb_embedding_forces(sb_embedding *embedding, const sb_vec3 *node_positions,
                                     const sb_vec3 *point_forces, sb_vec3 *node_forces, const sb_jobs *jobs)
{
    const sbi_embed_arrays *arrays;
    sbi_embed_frame frame;
    int nodes, faces;
    if (!embedding || !node_positions || !point_forces || !node_forces)
        return SB_ERROR_ARGUMENT;
    if (sbi_embed_is_stale(embedding))
        return SB_ERROR_MEMORY;
    memset(&frame, 0, sizeof frame);
    frame.embedding = embedding;
    frame.x = node_positions;
    frame.forces = point_forces;
    frame.node_forces = node_forces;
    sbi_embed_make_normals(&frame, jobs);
    arrays = &embedding->arrays; /* of its own after a state was loaded */
    nodes = sbi_embed_tasks(arrays->touched_end, SBI_EMBED_TASK_NODES);
    faces = sbi_embed_tasks(arrays->rows[SBI_EMBED_OF_FACES].end, SBI_EMBED_TASK_FACES);
    sbi_run(jobs, sbi_embed_task_forces, &frame,
            sbi_embed_tasks(arrays->rows[SBI_EMBED_OF_GROUPS].end, SBI_EMBED_TASK_GROUPS));
    if (faces > 0)
        sbi_run(jobs, sbi_embed_task_normal_pulls, &frame, nodes);
    sbi_run(jobs, sbi_embed_task_face_forces, &frame, faces);
    sbi_run(jobs, sbi_embed_task_touched, &frame, nodes);
    return SB_OK;
}
