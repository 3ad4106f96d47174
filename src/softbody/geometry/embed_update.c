/* embed_update: positions and normals of the points from those of the nodes, a group of points at a time. */
#include "embed_follow.h"

/* ---- shape functions of SBI_EMBED_LANES points ---- */

/* Simplices, formulas as in sb_element_shape. */
static void sbi_embed_simplex_lanes(sb_element_type type, const sb_real *const xi[3], int slopes,
                                    sbi_embed_lanes *lanes)
{
    static const signed char tri[3][2] = {{0, 1}, {1, 2}, {2, 0}};
    static const signed char tet[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
    const signed char(*edges)[2] = type == SB_TRI6 ? tri : tet;
    sb_real bary[4][SBI_EMBED_LANES];
    int corners = sb_element_corner_count(type), nodes = sb_element_node_count(type), curved = nodes > corners;
    SBI_EMBED_EACH_LANE(l)
    bary[0][l] = 1;
    for (int a = 1; a < corners; a++)
        SBI_EMBED_EACH_LANE(l)
        {
            bary[a][l] = xi[a - 1][l];
            bary[0][l] -= xi[a - 1][l];
        }
    for (int a = 0; a < corners; a++)
        SBI_EMBED_EACH_LANE(l)
    lanes->shape[a][l] = curved ? bary[a][l] * (2 * bary[a][l] - 1) : bary[a][l];
    for (int a = corners; a < nodes; a++) {
        const sb_real *p = bary[edges[a - corners][0]], *q = bary[edges[a - corners][1]];
        SBI_EMBED_EACH_LANE(l)
        lanes->shape[a][l] = 4 * p[l] * q[l];
    }
    for (int a = 0; slopes && a < nodes; a++) {
        int p = a < corners ? a : edges[a - corners][0], q = a < corners ? a : edges[a - corners][1];
        for (int k = 0; k < 3; k++) {
            sb_real dp = (sb_real)((p == k + 1) - (p == 0)), dq = (sb_real)((q == k + 1) - (q == 0));
            SBI_EMBED_EACH_LANE(l)
            lanes->slope[a][k][l] = a >= corners ? 4 * (bary[p][l] * dq + bary[q][l] * dp)
                                    : curved     ? (4 * bary[a][l] - 1) * dp
                                                 : dp;
        }
    }
}

/* quad4 and hex8: products of (1 +- xi_k) / 2. */
static void sbi_embed_box_lanes(int dimension, const sb_real *const xi[3], int slopes, sbi_embed_lanes *lanes)
{
    static const signed char corner[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                             {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
    const sb_real half = (sb_real)0.5;
    sb_real side[3][2][SBI_EMBED_LANES];
    for (int k = 0; k < 3; k++)
        SBI_EMBED_EACH_LANE(l)
        {
            sb_real x = k < dimension ? xi[k][l] : -(sb_real)1;
            side[k][0][l] = half - half * x;
            side[k][1][l] = half + half * x;
        }
    for (int a = 0; a < (1 << dimension); a++) {
        const sb_real *x = side[0][corner[a][0]], *y = side[1][corner[a][1]], *z = side[2][corner[a][2]];
        SBI_EMBED_EACH_LANE(l)
        lanes->shape[a][l] = x[l] * y[l] * z[l];
        if (!slopes)
            continue;
        SBI_EMBED_EACH_LANE(l)
        {
            lanes->slope[a][0][l] = (corner[a][0] ? half : -half) * y[l] * z[l];
            lanes->slope[a][1][l] = (corner[a][1] ? half : -half) * x[l] * z[l];
            lanes->slope[a][2][l] = dimension == 3 ? (corner[a][2] ? half : -half) * x[l] * y[l] : (sb_real)0;
        }
    }
}

/* xi[k]: parameter k of the points. slopes 0: shape functions only. */
static void sbi_embed_shape_lanes(sb_element_type type, const sb_real *const xi[3], int slopes, sbi_embed_lanes *lanes)
{
    int nodes = sb_element_node_count(type);
    if (type == SB_TRI3 || type == SB_TRI6 || type == SB_TET4 || type == SB_TET10) {
        sbi_embed_simplex_lanes(type, xi, slopes, lanes);
        return;
    }
    if (type == SB_QUAD4 || type == SB_HEX8) {
        sbi_embed_box_lanes(sb_element_dimension(type), xi, slopes, lanes);
        return;
    }
    SBI_EMBED_EACH_LANE(l)
    {
        sb_real at[3], shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3];
        at[0] = xi[0][l], at[1] = xi[1][l], at[2] = xi[2][l];
        sb_element_shape(type, at, shape, slopes ? slope : NULL);
        for (int a = 0; a < nodes; a++) {
            lanes->shape[a][l] = shape[a];
            for (int k = 0; slopes && k < 3; k++)
                lanes->slope[a][k][l] = slope[a][k];
        }
    }
}

/* ---- evaluation of a group ---- */

SBI_API void sbi_embed_cell_gather(const sb_embedding *e, const sbi_embed_group *group, const sb_vec3 *x,
                                   sbi_embed_cell *cell)
{
    const sbi_embed_arrays *arrays = &e->arrays;
    const sbi_embed_rows *rows = &arrays->rows[SBI_EMBED_OF_GROUPS];
    size_t entry = (size_t)(group - arrays->groups) * (size_t)rows->width;
    const int *nodes = rows->nodes + entry, *touched = rows->touched + entry;
    cell->type = sbi_embed_is_on_face(group->hold) ? e->face.type : e->type;
    cell->count = group->node_count;
    for (int a = 0; a < group->node_count; a++) {
        cell->x[a] = x[nodes[a]];
        if (group->hold == SB_EMBEDDED_OFFSET)
            cell->normal[a] = arrays->normals[touched[a]];
    }
}

SBI_API void sbi_embed_slot_shape(const sb_embedding *e, sb_embedding_hold hold, sb_element_type type, int count,
                                  int slot, int slopes, sbi_embed_lanes *lanes)
{
    const sb_real *xi[3];
    for (int k = 0; k < 3; k++)
        xi[k] = e->arrays.parameters[k] + slot;
    sbi_embed_shape_lanes(type, xi, slopes || hold >= SB_EMBEDDED_FRAME, lanes);
    if (hold != SB_EMBEDDED_EXTRAPOLATED)
        return;
    for (int a = 0; a < count; a++)
        for (int k = 0; k < 3; k++)
            SBI_EMBED_EACH_LANE(l)
    lanes->shape[a][l] += lanes->slope[a][k][l] * e->arrays.offsets[k][slot + l];
}

SBI_API sb_mat3 sbi_embed_face_frame(sb_vec3 a, sb_vec3 b)
{
    sb_vec3 along = sbi_embed_unit(a), normal = sbi_embed_unit(sb_v3_cross(a, b));
    return sb_m3_columns(along, sb_v3_cross(normal, along), normal);
}

SBI_API void sbi_embed_tangents(const sbi_embed_cell *cell, const sbi_embed_lanes *lanes, sbi_embed_vec3 tangent[3])
{
    for (int k = 0; k < 3; k++)
        sbi_embed_sum(cell->count, lanes->slope[0][k], 3 * SBI_EMBED_LANES, cell->x, &tangent[k]);
}

/* Carried normals from the columns g of the present map: w_0 g_1 x g_2 + w_1 g_2 x g_0 + w_2 g_0 x g_1. */
static void sbi_embed_carry(const sb_embedding *e, int slot, const sbi_embed_vec3 g[3], sbi_embed_vec3 *out)
{
    sb_real unused[SBI_EMBED_LANES];
    SBI_EMBED_EACH_LANE(l)
    {
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int k = 0; k < 3; k++)
            sum = sb_v3_madd(sum, e->arrays.carried[k][slot + l],
                             sb_v3_cross(sbi_embed_lane(&g[(k + 1) % 3], l), sbi_embed_lane(&g[(k + 2) % 3], l)));
        sbi_embed_set_lane(out, l, sum);
    }
    sbi_embed_normalise(out, unused);
}

/* x + d n; carried normals, unless NULL, from the tangents x_,k + d n_,k with n_,k = (I - n n^T) m_,k / |m|. */
static void sbi_embed_slots_offset(const sb_embedding *e, const sbi_embed_cell *cell, const sbi_embed_lanes *lanes,
                                   int slot, sbi_embed_vec3 *at, sbi_embed_vec3 *normal)
{
    sb_real inverse[SBI_EMBED_LANES];
    sbi_embed_vec3 g[3];
    const sb_real *distance = e->arrays.parameters[2] + slot;
    sbi_embed_sum(cell->count, lanes->shape[0], SBI_EMBED_LANES, cell->x, at);
    sbi_embed_sum(cell->count, lanes->shape[0], SBI_EMBED_LANES, cell->normal, &g[2]);
    sbi_embed_normalise(&g[2], inverse);
    sbi_embed_madd(at, distance, &g[2]);
    for (int k = 0; normal && k < 2; k++) {
        sbi_embed_vec3 turn;
        sb_real scale[SBI_EMBED_LANES], along[SBI_EMBED_LANES];
        sbi_embed_sum(cell->count, lanes->slope[0][k], 3 * SBI_EMBED_LANES, cell->x, &g[k]);
        sbi_embed_sum(cell->count, lanes->slope[0][k], 3 * SBI_EMBED_LANES, cell->normal, &turn);
        SBI_EMBED_EACH_LANE(l)
        {
            scale[l] = distance[l] * inverse[l];
            along[l] = -(turn.x[l] * g[2].x[l] + turn.y[l] * g[2].y[l] + turn.z[l] * g[2].z[l]);
        }
        sbi_embed_madd(&turn, along, &g[2]);
        sbi_embed_madd(&g[k], scale, &turn);
    }
    if (normal)
        sbi_embed_carry(e, slot, g, normal);
}

/* x + E o in the frame E of the face. */
static void sbi_embed_slots_frame(const sb_embedding *e, const sbi_embed_cell *cell, const sbi_embed_lanes *lanes,
                                  int slot, sbi_embed_vec3 *at, sbi_embed_vec3 *normal)
{
    sb_real *const *offsets = e->arrays.offsets, *const *carried = e->arrays.carried;
    sbi_embed_vec3 tangent[3];
    sbi_embed_sum(cell->count, lanes->shape[0], SBI_EMBED_LANES, cell->x, at);
    sbi_embed_tangents(cell, lanes, tangent);
    SBI_EMBED_EACH_LANE(l)
    {
        int s = slot + l;
        sb_mat3 frame = sbi_embed_face_frame(sbi_embed_lane(&tangent[0], l), sbi_embed_lane(&tangent[1], l));
        sb_vec3 offset = sb_v3(offsets[0][s], offsets[1][s], offsets[2][s]);
        sbi_embed_set_lane(at, l, sb_v3_add(sbi_embed_lane(at, l), sb_m3_apply(frame, offset)));
        if (normal)
            sbi_embed_set_lane(normal, l, sb_m3_apply(frame, sb_v3(carried[0][s], carried[1][s], carried[2][s])));
    }
}

static void sbi_embed_slots_volume(const sb_embedding *e, const sbi_embed_cell *cell, const sbi_embed_lanes *lanes,
                                   int slot, sbi_embed_vec3 *at, sbi_embed_vec3 *normal)
{
    sbi_embed_vec3 g[3];
    sbi_embed_sum(cell->count, lanes->shape[0], SBI_EMBED_LANES, cell->x, at);
    if (!normal)
        return;
    sbi_embed_tangents(cell, lanes, g);
    sbi_embed_carry(e, slot, g, normal);
}

static void sbi_embed_group_points(const sbi_embed_frame *frame, const sbi_embed_group *group)
{
    const sb_embedding *e = frame->embedding;
    const sbi_embed_arrays *arrays = &e->arrays;
    sb_vec3 *normals = arrays->carried[0] ? frame->normals : NULL;
    sbi_embed_cell cell;
    sbi_embed_cell_gather(e, group, frame->x, &cell);
    for (int block = group->first_block; block >= 0; block = arrays->block_next[block]) {
        int slot = block * SBI_EMBED_LANES;
        const int *point = arrays->slot_point + slot;
        sbi_embed_lanes lanes;
        sbi_embed_vec3 at, normal, *wanted = normals ? &normal : NULL;
        sbi_embed_slot_shape(e, group->hold, cell.type, cell.count, slot, normals != NULL, &lanes);
        if (group->hold == SB_EMBEDDED_OFFSET)
            sbi_embed_slots_offset(e, &cell, &lanes, slot, &at, wanted);
        else if (group->hold == SB_EMBEDDED_FRAME)
            sbi_embed_slots_frame(e, &cell, &lanes, slot, &at, wanted);
        else
            sbi_embed_slots_volume(e, &cell, &lanes, slot, &at, wanted);
        SBI_EMBED_EACH_LANE(l) /* padding writes its point again */
        frame->points[point[l]] = sbi_embed_lane(&at, l);
        for (int l = 0; normals && l < SBI_EMBED_LANES; l++)
            normals[point[l]] = sbi_embed_lane(&normal, l);
    }
}

/* ---- tasks of an update ---- */

static void sbi_embed_task_faces(void *user, int task)
{
    const sbi_embed_frame *frame = (const sbi_embed_frame *)user;
    const sb_embedding *e = frame->embedding;
    const sbi_embed_rows *rows = &e->arrays.rows[SBI_EMBED_OF_FACES];
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_FACES, rows->end);
    for (int f = task * SBI_EMBED_TASK_FACES; f < end; f++) {
        size_t first = (size_t)f * (size_t)rows->width;
        const int *nodes = rows->nodes + first;
        sb_vec3 x[SB_MAX_FACE_NODES];
        if (nodes[0] < 0)
            continue;
        for (int i = 0; i < rows->width; i++)
            x[i] = frame->x[nodes[i]];
        sbi_embed_face_normals(&e->face, x, e->arrays.face_weights + first, e->arrays.face_normals + first);
    }
}

static void sbi_embed_task_normals(void *user, int task)
{
    const sbi_embed_arrays *arrays = &((const sbi_embed_frame *)user)->embedding->arrays;
    const int *next = arrays->rows[SBI_EMBED_OF_FACES].next;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_NODES, arrays->touched_end);
    for (int i = task * SBI_EMBED_TASK_NODES; i < end; i++) {
        const sbi_embed_touched *touched = &arrays->touched[i];
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (touched->node < 0 || touched->normal_users == 0)
            continue;
        for (int entry = touched->first[SBI_EMBED_OF_FACES]; entry >= 0; entry = next[entry])
            sum = sb_v3_add(sum, arrays->face_normals[entry]);
        arrays->normals[i] = sbi_embed_unit(sum);
        arrays->lengths[i] = sb_v3_norm(sum);
    }
}

static void sbi_embed_task_points(void *user, int task)
{
    const sbi_embed_frame *frame = (const sbi_embed_frame *)user;
    const sbi_embed_arrays *arrays = &frame->embedding->arrays;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_GROUPS, arrays->rows[SBI_EMBED_OF_GROUPS].end);
    for (int g = task * SBI_EMBED_TASK_GROUPS; g < end; g++)
        if (arrays->groups[g].count > 0)
            sbi_embed_group_points(frame, &arrays->groups[g]);
}

/* Twice the area vector of the polygons around a point: sums of products of neighbours next to each other, seen from
 * the point so that it does not lose digits far from the origin. */
static void sbi_embed_task_rings(void *user, int task)
{
    const sbi_embed_frame *frame = (const sbi_embed_frame *)user;
    const sbi_embed_lists *rings = &frame->embedding->rings;
    int end = sbi_min_int((task + 1) * SBI_EMBED_TASK_RINGS, rings->rows);
    for (int p = task * SBI_EMBED_TASK_RINGS; p < end; p++) {
        sb_vec3 origin = frame->points[p], sum = sb_v3(0, 0, 0), before = sum;
        for (int k = rings->starts[p]; k < rings->starts[p + 1]; k++) {
            int item = rings->items[k];
            sb_vec3 next = sb_v3_sub(frame->points[item < 0 ? ~item : item], origin);
            if (item >= 0)
                sum = sb_v3_add(sum, sb_v3_cross(before, next));
            before = next;
        }
        frame->normals[p] = sbi_embed_unit(sum);
    }
}

SBI_API void sbi_embed_make_normals(sbi_embed_frame *frame, const sb_jobs *jobs)
{
    const sbi_embed_arrays *arrays = &frame->embedding->arrays;
    if (arrays->rows[SBI_EMBED_OF_FACES].used == 0)
        return;
    sbi_run(jobs, sbi_embed_task_faces, frame,
            sbi_embed_tasks(arrays->rows[SBI_EMBED_OF_FACES].end, SBI_EMBED_TASK_FACES));
    sbi_run(jobs, sbi_embed_task_normals, frame, sbi_embed_tasks(arrays->touched_end, SBI_EMBED_TASK_NODES));
}

SB_API sb_result sb_embedding_update(sb_embedding *embedding, const sb_vec3 *node_positions, sb_vec3 *points,
                                     sb_vec3 *normals, const sb_jobs *jobs)
{
    sbi_embed_frame frame;
    if (!embedding || !node_positions || !points || (normals && !embedding->rest_normals && !embedding->rings.starts))
        return SB_ERROR_ARGUMENT;
    if (sbi_embed_is_stale(embedding))
        return SB_ERROR_MEMORY;
    memset(&frame, 0, sizeof frame);
    frame.embedding = embedding;
    frame.x = node_positions;
    frame.points = points;
    frame.normals = normals;
    sbi_embed_make_normals(&frame, jobs);
    sbi_run(jobs, sbi_embed_task_points, &frame,
            sbi_embed_tasks(embedding->arrays.rows[SBI_EMBED_OF_GROUPS].end, SBI_EMBED_TASK_GROUPS));
    if (normals && !embedding->arrays.carried[0])
        sbi_run(jobs, sbi_embed_task_rings, &frame, sbi_embed_tasks(embedding->rings.rows, SBI_EMBED_TASK_RINGS));
    return SB_OK;
}
