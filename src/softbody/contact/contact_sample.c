/* contact_sample: nodes of the samples of a step, and samples evaluated at a trial displacement. */
#include "contact_private.h"

/* ---- nodes ---- */

SBI_API int sbi_contact_place_node(sb_contact *contact, int node)
{
    if (contact->node_place[node] < 0) {
        contact->node_place[node] = contact->touch.node_count;
        contact->positions[contact->touch.node_count] = contact->x[node];
        contact->nodes[contact->touch.node_count++] = node;
    }
    return contact->node_place[node];
}

/* ---- evaluation ---- */

static void sbi_contact_evaluate_sample(const sbi_contact_work *work, const sbi_contact_patch *patch,
                                        sbi_contact_sample *s)
{
    const sb_contact *contact = work->contact;
    const sbi_contact_tool *tool = contact->tools + patch->tool;
    int count = contact->faces->sizes[patch->face];
    sb_vec3 u = sbi_contact_mean(s->weights, patch->nodes, count, work->du);
    sb_vec3 fallback = sbi_pose_turn_to_tool(&tool->balance, s->normal), normal;
    sb_vec3 start = sbi_contact_mean(s->weights, patch->nodes, count, contact->positions), slip;
    if (sbi_contact_is_hung(tool))
        s->carried = sb_v3_sub(sbi_pose_to_space(&tool->balance, sbi_pose_to_tool(&tool->from, start)), start);
    slip = sb_v3_sub(u, s->carried);
    s->point = sb_v3_add(start, u);
    s->gap = sbi_tool_distance(tool->shape, tool->chain_balance, sbi_pose_to_tool(&tool->balance, s->point), fallback,
                               &normal);
    s->normal = sbi_pose_turn_to_space(&tool->balance, normal);
    s->slip = sb_v3_norm(sbi_contact_tangential(slip, s->normal));
    if (work->renew)
        s->bound = tool->friction * sb_max((sb_real)0, s->memory - s->k * s->gap);
    s->answer = sbi_contact_law(s->k, s->gap, s->memory, s->normal, slip, s->remembered, s->bound);
}

static void sbi_contact_evaluate_chunk(void *user, int chunk)
{
    const sbi_contact_work *work = (const sbi_contact_work *)user;
    sb_contact *contact = work->contact;
    int first = work->first + chunk * SBI_CONTACT_CHUNK, last = sbi_min_int(first + SBI_CONTACT_CHUNK, work->last);
    for (int p = first; p < last; p++) {
        sbi_contact_patch *patch = contact->patches + p;
        patch->touching = 0;
        for (int i = patch->first; i < patch->first + patch->count; i++) {
            sbi_contact_evaluate_sample(work, patch, contact->samples + i);
            patch->touching += contact->samples[i].answer.state != SBI_CONTACT_OFF;
        }
    }
}

SBI_API void sbi_contact_evaluate_patches(sbi_contact_work *work)
{
    int count = work->last - work->first, chunks = count / SBI_CONTACT_CHUNK + (count % SBI_CONTACT_CHUNK != 0);
    sbi_run(sbi_body_jobs(work->contact->body), sbi_contact_evaluate_chunk, work, chunks);
}

SBI_API void sbi_contact_evaluate_tool(const sbi_contact_work *work, const sbi_contact_tool *tool)
{
    sbi_contact_work own = *work;
    own.first = tool->spring.first;
    own.last = tool->spring.last;
    sbi_contact_evaluate_patches(&own);
}
