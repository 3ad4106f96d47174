/* contact_sample: nodes of the samples of a step, and samples evaluated at a trial displacement. */
#include "contact_private.h"

/* ---- nodes ---- */

SBI_API int sbi_contact_place_node(sb_contact *contact, int node)
{
    if (contact->node_place[node] < 0) {
        contact->node_place[node] = contact->node_count;
        contact->positions[contact->node_count] = contact->x[node];
        contact->nodes[contact->node_count++] = node;
        if (contact->skin.source)
            sbi_contact_skin_place(contact, node);
    }
    return contact->node_place[node];
}

/* ---- the body's nodes at a sample ---- */

SBI_API void sbi_contact_load_face(const sb_contact *contact, int face, const sb_real *weights, sb_real factor,
                                   sb_vec3 force, sb_vec3 *out)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    for (int a = 0; a < contact->faces->sizes[face]; a++) {
        if (contact->skin.source) {
            const sbi_contact_row row = sbi_contact_skin_row(&contact->skin, nodes[a]);
            for (int i = 0; i < row.count; i++)
                out[row.nodes[i]] = sb_v3_madd(out[row.nodes[i]], factor * weights[a] * row.weights[i], force);
        } else {
            out[nodes[a]] = sb_v3_madd(out[nodes[a]], factor * weights[a], force);
        }
    }
}

SBI_API void sbi_contact_load_sample(const sb_contact *contact, int face, int parts, int sample, sb_real factor,
                                     sb_vec3 force, sb_vec3 *out)
{
    sbi_contact_load_face(contact, face, sbi_contact_sample_weights(contact->faces, face, parts, sample), factor, force,
                          out);
}

SBI_API sb_vec3 sbi_contact_sample_motion(const sb_contact *contact, int face, int parts, int sample, const sb_vec3 *x)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    const sb_real *weights = sbi_contact_sample_weights(contact->faces, face, parts, sample);
    sb_vec3 sum = {0, 0, 0};
    if (!contact->skin.source)
        return sbi_contact_mean(weights, nodes, contact->faces->sizes[face], x);
    for (int a = 0; a < contact->faces->sizes[face]; a++) {
        const sbi_contact_row row = sbi_contact_skin_row(&contact->skin, nodes[a]);
        sum = sb_v3_madd(sum, weights[a], sbi_contact_mean(row.weights, row.nodes, row.count, x));
    }
    return sum;
}

/* ---- how near a face is ---- */

SBI_API sb_real sbi_contact_clearance(const sbi_contact_faces *faces, int face, const sb_vec3 *x, const sbi_tool *shape,
                                      const sb_vec3 *chain, const sb_pose *pose)
{
    int count = faces->sizes[face], parts = sbi_contact_face_parts(faces, face, sbi_tool_radius(shape));
    sb_vec3 middle = sb_v3(0, 0, 0), normal;
    sb_real square = 0;
    if (!sbi_tool_is_exact(shape))
        return -SB_REAL_MAX;
    for (int a = 0; a < count; a++)
        middle = sb_v3_madd(middle, 1 / (sb_real)count, x[a]);
    for (int a = 0; a < count; a++) {
        sb_vec3 arm = sb_v3_sub(x[a], middle);
        square = sb_max(square, sb_v3_dot(arm, arm));
    }
    return sbi_tool_distance(shape, chain, sbi_pose_to_tool(pose, middle), middle, &normal) -
           sbi_contact_face_rule(faces, face, parts)->spread * sb_sqrt(square);
}

SBI_API sb_real sbi_contact_clearance_at(const sbi_contact_faces *faces, int face, const sb_vec3 *x,
                                         const sbi_tool *shape, const sb_vec3 *chain, const sb_pose *pose)
{
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sb_vec3 own[SB_MAX_FACE_NODES];
    for (int a = 0; a < faces->sizes[face]; a++)
        own[a] = x[nodes[a]];
    return sbi_contact_clearance(faces, face, own, shape, chain, pose);
}

/* ---- evaluation ---- */

SBI_API sb_real sbi_contact_clear(const sbi_contact_tool *tool, sb_real gap)
{
    int turns = sbi_contact_is_hung(tool) && sbi_tool_get_shape(tool->shape) == SB_TOOL_PLANE;
    return sbi_tool_is_exact(tool->shape) && !turns ? gap : 0;
}

/* u: [nodes of the face] */
static void sbi_contact_evaluate_sample(const sbi_contact_tool *tool, const sb_vec3 *u, int count, int renew,
                                        sbi_contact_sample *s)
{
    const sb_vec3 none = {0, 0, 0};
    sb_vec3 normal, way = none, slip = none;
    for (int a = 0; a < count; a++)
        way = sb_v3_madd(way, s->weights[a], u[a]);
    s->point = sb_v3_add(s->start, way);
    s->gap =
        sbi_tool_distance(tool->shape, tool->chain_balance, sbi_pose_to_tool(&tool->balance, s->point), none, &normal);
    s->clear = sbi_contact_clear(tool, s->gap);
    if (sb_v3_dot(normal, normal) > 0) /* else it lies on the skeleton, and keeps the normal that it had */
        s->normal = sbi_pose_turn_to_space(&tool->balance, normal);
    if (renew)
        s->bound = tool->friction * sb_max((sb_real)0, s->memory - s->k * s->gap);
    if (s->memory - s->k * s->gap > 0 || s->bound > 0) { /* it touches, or friction is still to be renewed */
        if (sbi_contact_is_hung(tool))
            s->carried =
                sb_v3_sub(sbi_pose_to_space(&tool->balance, sbi_pose_to_tool(&tool->from, s->start)), s->start);
        slip = sb_v3_sub(way, s->carried);
    }
    s->slip = sb_v3_norm(sbi_contact_tangential(slip, s->normal));
    s->answer = sbi_contact_law(s->k, s->gap, s->memory, s->normal, slip, s->remembered, s->bound);
}

SBI_API void sbi_contact_evaluate_again(sb_contact *contact, sbi_contact_sample *s)
{
    const sbi_contact_patch *patch = contact->patches + s->patch;
    sbi_contact_evaluate_sample(contact->tools + patch->tool, patch->seen, contact->faces->sizes[patch->face], 0, s);
}

/* Takes du of a patch; returns how far (m) its samples and the tool may have moved against each other since the last
 * evaluation. What is no number makes it none. */
static sb_real sbi_contact_take_motion(const sbi_contact_work *work, sbi_contact_patch *patch)
{
    const sb_contact *contact = work->contact;
    sb_real square = 0;
    for (int a = 0; a < contact->faces->sizes[patch->face]; a++) {
        sb_vec3 u = work->du[patch->nodes[a]], way = sb_v3_sub(u, patch->seen[a]);
        square += sb_v3_dot(way, way);
        patch->seen[a] = u;
    }
    return sbi_contact_face_rule(contact->faces, patch->face, patch->parts)->spread * sb_sqrt(square) +
           contact->tools[patch->tool].shift;
}

/* 1 when a sample did not touch and has not come near enough since. */
static int sbi_contact_stays_off(const sbi_contact_sample *s)
{
    return s->answer.state == SBI_CONTACT_OFF && s->bound == 0 && s->k * s->clear > s->memory;
}

static void sbi_contact_evaluate_chunk(void *user, int chunk)
{
    const sbi_contact_work *work = (const sbi_contact_work *)user;
    sb_contact *contact = work->contact;
    int first = work->first + chunk * SBI_CONTACT_CHUNK, last = sbi_min_int(first + SBI_CONTACT_CHUNK, work->last);
    for (int p = first; p < last; p++) {
        sbi_contact_patch *patch = contact->patches + p;
        const sbi_contact_tool *tool = contact->tools + patch->tool;
        sb_real motion = sbi_contact_take_motion(work, patch);
        int count = contact->faces->sizes[patch->face];
        patch->touching = 0;
        for (int i = patch->first; i < patch->first + patch->count; i++) {
            sbi_contact_sample *s = contact->samples + i;
            s->clear -= motion;
            if (sbi_contact_stays_off(s))
                continue;
            sbi_contact_evaluate_sample(tool, patch->seen, count, work->renew, s);
            patch->touching += s->answer.state != SBI_CONTACT_OFF;
        }
    }
}

/* How far tools that give way have gone since their last evaluation. */
static void sbi_contact_follow_tools(const sbi_contact_work *work)
{
    sb_contact *contact = work->contact;
    for (int p = work->first, last = -1; p < work->last; p++) {
        sbi_contact_tool *tool = contact->tools + contact->patches[p].tool;
        if (contact->patches[p].tool == last)
            continue;
        last = contact->patches[p].tool;
        tool->shift = sbi_contact_is_hung(tool) ? sbi_tool_motion(tool->shape, tool->chain_balance, &tool->seen,
                                                                  tool->chain_balance, &tool->balance)
                                                : 0;
        tool->seen = tool->balance;
    }
}

SBI_API void sbi_contact_evaluate_patches(sbi_contact_work *work)
{
    int count = work->last - work->first, chunks = count / SBI_CONTACT_CHUNK + (count % SBI_CONTACT_CHUNK != 0);
    sbi_contact_follow_tools(work);
    sbi_run(sbi_body_jobs(work->contact->body), sbi_contact_evaluate_chunk, work, chunks);
}

SBI_API void sbi_contact_evaluate_tool(const sbi_contact_work *work, const sbi_contact_tool *tool)
{
    sbi_contact_work own = *work;
    own.first = tool->spring.first;
    own.last = tool->spring.last;
    sbi_contact_evaluate_patches(&own);
}
