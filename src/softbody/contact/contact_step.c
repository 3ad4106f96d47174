/* contact_step: contact within a step: samples near tools, their stiffness and memory, forces and blocks. */
#include <math.h>
#include <string.h>

#include "contact_private.h"

enum { SBI_CONTACT_THINNEST = 5, SBI_CONTACT_ROUNDS = 20 };

/* Overlap that a static solve leaves, over how far the surface was pushed. */
#define SBI_CONTACT_OVERLAP ((sb_real)1e-3)
/* More than forces of a tool change by in a step whose bounds of friction may be foreseen. */
#define SBI_CONTACT_CHANGES ((sb_real)2)

/* ---- nodes and patches ---- */

static void sbi_contact_forget_nodes(sb_contact *contact)
{
    for (int k = 0; k < contact->node_count; k++)
        contact->node_place[contact->nodes[k]] = -1;
    contact->node_count = contact->touch.node_count = contact->patch_count = contact->sample_count = 0;
    sbi_contact_skin_forget(contact);
    sbi_pairs_forget(contact);
}

/* What the samples of a face are looked at with. */
typedef struct sbi_contact_view {
    const sbi_contact_tool *tool;
    int number, face, parts;
    const sb_vec3 *velocity; /* [rows] */
    sb_real dt, reach;       /* s; m */
} sbi_contact_view;

/* Unit normal of a face out of its body, at the start of the step; 0 where it is flat. */
static sb_vec3 sbi_contact_face_normal(const sb_contact *contact, int face)
{
    const int *n = sbi_contact_face_nodes(contact->faces, face);
    const sb_vec3 *x = contact->x;
    sb_vec3 cross = sb_v3_cross(sb_v3_sub(x[n[1]], x[n[0]]), sb_v3_sub(x[n[2]], x[n[0]]));
    sb_real size = sb_v3_norm(cross);
    return size > 0 ? sb_v3_scale(1 / size, cross) : sb_v3(0, 0, 1);
}

/* Takes the samples of a face that are near the tool, where they are or where they would go. 0: no room is left. */
static int sbi_contact_add_samples(sb_contact *contact, const sbi_contact_view *view)
{
    const sbi_contact_faces *faces = contact->faces;
    const int *nodes = sbi_contact_face_nodes(faces, view->face);
    const sb_vec3 *x = contact->x;
    const sbi_contact_rule *rule = sbi_contact_face_rule(faces, view->face, view->parts);
    int count = faces->sizes[view->face];
    sb_vec3 out = sb_v3_scale(-1, sbi_contact_face_normal(contact, view->face));
    sb_vec3 fallback = sbi_pose_turn_to_tool(&view->tool->balance, out);
    for (int s = 0; s < rule->count; s++) {
        const sb_real *weights = rule->weights + (size_t)s * (size_t)count;
        sb_vec3 at = sbi_contact_mean(weights, nodes, count, x), normal, ahead, carried;
        sbi_contact_sample *sample = contact->samples + contact->sample_count;
        sb_real gap = sbi_tool_distance(view->tool->shape, view->tool->chain_balance,
                                        sbi_pose_to_tool(&view->tool->balance, at), fallback, &normal),
                clear = gap;
        if (gap >= view->reach && view->dt > 0) {
            ahead = sb_v3_madd(at, view->dt, sbi_contact_mean(weights, nodes, count, view->velocity));
            gap = sbi_tool_distance(view->tool->shape, view->tool->chain_balance,
                                    sbi_pose_to_tool(&view->tool->balance, ahead), fallback, &normal);
        }
        if (!(gap < view->reach))
            continue;
        if (contact->sample_count == contact->max_contacts)
            return 0;
        carried = sbi_pose_to_space(&view->tool->balance, sbi_pose_to_tool(&view->tool->from, at));
        memset(sample, 0, sizeof *sample);
        sample->patch = contact->patch_count;
        sample->sample = s;
        sample->weights = weights;
        sample->carried = sb_v3_sub(carried, at);
        sample->normal = out;
        sample->start = at;
        sample->clear = sbi_contact_clear(view->tool, clear);
        contact->sample_count++;
    }
    return 1;
}

/* 1 when no sample of a face is near the tool, neither where it is nor where it would go. */
static int sbi_contact_is_far(const sb_contact *contact, const sbi_contact_view *view)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, view->face);
    sb_real square = 0, ahead;
    for (int a = 0; a < contact->faces->sizes[view->face]; a++)
        square += sb_v3_dot(view->velocity[nodes[a]], view->velocity[nodes[a]]);
    ahead = sbi_contact_face_rule(contact->faces, view->face, view->parts)->spread * view->dt * sb_sqrt(square);
    return sbi_contact_clearance_at(contact->faces, view->face, contact->x, view->tool->shape,
                                    view->tool->chain_balance, &view->tool->balance) > view->reach + ahead;
}

/* A patch of a face with samples near the tool, if there are any. 0: no room is left. */
static int sbi_contact_add_patch(sb_contact *contact, const sbi_contact_view *view)
{
    sbi_contact_faces *faces = contact->faces;
    sbi_contact_patch *patch = contact->patches + contact->patch_count;
    const int *nodes = sbi_contact_face_nodes(faces, view->face);
    int first = contact->sample_count;
    if (sbi_contact_is_far(contact, view))
        return 1;
    if (contact->patch_count == contact->patch_room)
        return 0;
    if (!sbi_contact_add_samples(contact, view))
        return 0;
    if (contact->sample_count == first)
        return 1;
    memset(patch, 0, sizeof *patch);
    patch->tool = view->number;
    patch->face = view->face;
    patch->parts = view->parts;
    patch->first = first;
    patch->count = contact->sample_count - first;
    for (int a = 0; a < faces->sizes[view->face]; a++)
        patch->nodes[a] = sbi_contact_place_node(contact, nodes[a]);
    for (int i = first; i < contact->sample_count; i++)
        contact->samples[i].area =
            sbi_contact_sample_area(faces, contact->body, view->face, view->parts, contact->samples[i].sample);
    contact->patch_count++;
    return 1;
}

/* How near (m) a sample counts: as far as the face beside it may have been dragged and the tool goes, but no farther
 * than what moves against a tool in a step, of which something may pass through. A sample that comes from beyond is
 * found in the next step. */
static sb_real sbi_contact_reach(const sb_contact *contact, const sbi_contact_tool *tool, int face)
{
    sb_real length = contact->faces->lengths[face];
    if (sbi_tool_get_shape(tool->shape) == SB_TOOL_PLANE)
        return (sb_real)0.5 * length;
    return sb_min(sbi_tool_inner_radius(tool->shape), length + tool->way);
}

/* All patches, with 1/2^thin of the parts that faces should have. 0: no room is left. */
static int sbi_contact_find_patches(sb_contact *contact, const sbi_touch_step *step, int thin)
{
    const sbi_contact_faces *faces = contact->faces;
    sbi_contact_forget_nodes(contact);
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_tool *tool = contact->tools + t;
        const int *near = contact->near + (size_t)t * (size_t)faces->face_room;
        tool->seen = tool->balance;
        for (int f = 0; tool->shape && f < tool->face_count; f++) {
            sbi_contact_view view;
            const sbi_contact_kind *kind = &faces->kinds[faces->sizes[near[f]]];
            view.tool = tool;
            view.number = t;
            view.face = near[f];
            view.parts =
                sbi_max_int(kind->least, sbi_contact_face_parts(faces, near[f], sbi_tool_radius(tool->shape)) >> thin);
            view.velocity = step->velocity;
            view.dt = step->dt;
            view.reach = sbi_contact_reach(contact, tool, near[f]);
            if (!sbi_contact_add_patch(contact, &view))
                return 0;
        }
    }
    return 1;
}

/* ---- stiffness ---- */

/* tr A_aa / 3 (N/m), A of the whole step where this is a part of one: with the stiffness of a part, which is higher the
 * shorter it is, the overlap that the part before has left would be felt as a blow. */
static sb_real sbi_contact_trace(const sb_contact *contact, const sbi_touch_step *step, int node)
{
    const sb_real *a = step->matrix->blocks[sb_matrix_find(step->matrix, node, node)];
    sb_real trace = (a[0] + a[4] + a[8]) / 3;
    if (step->whole_mass == 0)
        return trace;
    return step->whole_stiff * trace + step->whole_mass * sbi_body_diagonal_mass(contact->body, node);
}

/* The same of a skin's points: what a unit pressure everywhere would move them by, each node held alone, inverted. */
static void sbi_contact_measure_points(sb_contact *contact, const sbi_touch_step *step)
{
    const sbi_contact_skin *skin = &contact->skin;
    for (int k = 0; k < skin->list_count; k++)
        skin->loads[k] = sbi_contact_trace(contact, step, skin->list[k]);
    for (int k = 0; k < contact->node_count; k++) {
        const sbi_contact_row row = sbi_contact_skin_row(skin, contact->nodes[k]);
        sb_real way = 0;
        for (int i = 0; i < row.count; i++) {
            sb_real load = skin->loads[skin->place[row.nodes[i]]];
            way += load > 0 ? sb_abs(row.weights[i]) * skin->node_areas[row.nodes[i]] / load : 0;
        }
        contact->stiffness_by_node[k] = way > 0 ? 1 / way : 0;
    }
}

/* tr A_aa / 3 over the node's area, by place; 0 where it has no area or no stiffness. */
static void sbi_contact_measure_nodes(sb_contact *contact, const sbi_touch_step *step)
{
    if (contact->skin.source) {
        sbi_contact_measure_points(contact, step);
        return;
    }
    for (int k = 0; k < contact->node_count; k++) {
        int node = contact->nodes[k];
        sb_real trace = sbi_contact_trace(contact, step, node), area = sbi_contact_node_area(contact->faces, node);
        contact->stiffness_by_node[k] = trace > 0 && area > 0 ? trace / area : 0;
    }
}

/* One stiffness for a tool and a region: so a plane that is pressed on a body has the same pressure everywhere. */
static void sbi_contact_measure_regions(sb_contact *contact)
{
    size_t places = (size_t)contact->max_tools * (size_t)contact->region_room;
    memset(contact->region_sum, 0, places * sizeof(sb_real));
    memset(contact->region_count, 0, places * sizeof(int));
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        size_t place =
            (size_t)patch->tool * (size_t)contact->region_room + (size_t)contact->faces->regions[patch->face];
        for (int a = 0; a < contact->faces->sizes[patch->face]; a++)
            if (contact->stiffness_by_node[patch->nodes[a]] > 0) {
                contact->region_sum[place] += contact->stiffness_by_node[patch->nodes[a]];
                contact->region_count[place]++;
            }
    }
    for (size_t i = 0; i < places; i++)
        if (contact->region_count[i] > 0)
            contact->region_sum[i] *= contact->stiffness / (sb_real)contact->region_count[i];
}

static void sbi_contact_stiffen(sb_contact *contact, const sbi_touch_step *step)
{
    sbi_contact_measure_nodes(contact, step);
    sbi_contact_measure_regions(contact);
    for (int i = 0; i < contact->sample_count; i++) {
        const sbi_contact_patch *patch = contact->patches + contact->samples[i].patch;
        contact->samples[i].k = contact->region_sum[(size_t)patch->tool * (size_t)contact->region_room +
                                                    (size_t)contact->faces->regions[patch->face]];
    }
}

/* rate m / S of a skin's point, as sbi_contact_measure_points. */
static sb_real sbi_contact_light_point(const sbi_contact_skin *skin, int point, const sbi_touch_step *step)
{
    const sbi_contact_row row = sbi_contact_skin_row(skin, point);
    sb_real way = 0;
    for (int i = 0; i < row.count; i++)
        way += sb_abs(row.weights[i]) * skin->node_areas[row.nodes[i]] / (step->rate * step->masses[row.nodes[i]]);
    return way > 0 ? 1 / way : 0;
}

/* Least of rate m_a / S_a of a patch's nodes, by which no node would have more than its share alone. */
static sb_real sbi_contact_light(const sb_contact *contact, const sbi_contact_patch *patch, const sbi_touch_step *step)
{
    sb_real least = SB_REAL_MAX;
    for (int a = 0; a < contact->faces->sizes[patch->face]; a++) {
        int node = contact->nodes[patch->nodes[a]];
        sb_real area = sbi_contact_node_area(contact->faces, node);
        if (contact->skin.source)
            least = sb_min(least, sbi_contact_light_point(&contact->skin, node, step));
        else
            least = sb_min(least, area > 0 ? step->rate * step->masses[node] / area : 0);
    }
    return least;
}

/* What a force on a node of a face loads the body's nodes with. */
static void sbi_contact_add_node_load(sb_contact *contact, int place, sb_real load)
{
    const sbi_contact_skin *skin = &contact->skin;
    if (skin->source) {
        const sbi_contact_row row = sbi_contact_skin_row(skin, contact->nodes[place]);
        for (int i = 0; i < row.count; i++)
            skin->loads[skin->place[row.nodes[i]]] += sb_abs(row.weights[i]) * load;
    } else {
        contact->stiffness_by_node[place] += load;
    }
}

/* Sum of a row without signs: 1 of a node. */
static sb_real sbi_contact_row_size(const sb_contact *contact, int place)
{
    sb_real sum = 0;
    sbi_contact_row row;
    if (!contact->skin.source)
        return 1;
    row = sbi_contact_skin_row(&contact->skin, contact->nodes[place]);
    for (int i = 0; i < row.count; i++)
        sum += sb_abs(row.weights[i]);
    return sum;
}

/* stiffness_by_node, or of a skin its loads, += what a patch loads nodes with (N/m), which no pattern of motion
 * exceeds: x.K x = sum dA k |sum w_a x_a|^2 <= sum_a |x_a|^2 sum dA k |w_a| sum_b |w_b| */
static void sbi_contact_add_load(sb_contact *contact, const sbi_contact_patch *patch)
{
    int count = contact->faces->sizes[patch->face];
    for (int i = patch->first; i < patch->first + patch->count; i++) {
        const sbi_contact_sample *s = contact->samples + i;
        sb_real sum = 0;
        for (int a = 0; a < count; a++)
            sum += sb_abs(s->weights[a]) * sbi_contact_row_size(contact, patch->nodes[a]);
        for (int a = 0; a < count; a++)
            sbi_contact_add_node_load(contact, patch->nodes[a], s->area * s->k * sum * sb_abs(s->weights[a]));
    }
}

/* Share of its stiffness that a node of a face bears, with all that it is loaded with. */
static sb_real sbi_contact_bearable(const sb_contact *contact, int place, const sbi_touch_step *step)
{
    const sbi_contact_skin *skin = &contact->skin;
    const int node = contact->nodes[place];
    const sb_real one = 1;
    sbi_contact_row row = {1, &node, &one};
    sb_real share = 1;
    if (skin->source)
        row = sbi_contact_skin_row(skin, node);
    for (int i = 0; i < row.count; i++) {
        sb_real load = skin->source ? skin->loads[skin->place[row.nodes[i]]] : contact->stiffness_by_node[place];
        sb_real most = step->rate * step->masses[row.nodes[i]];
        share = load > most ? sb_min(share, most / load) : share;
    }
    return share;
}

/* Of an explicit substep: as stiff as the nodes' masses admit, of all tools together. */
static void sbi_contact_stiffen_explicit(sb_contact *contact, const sbi_touch_step *step)
{
    memset(contact->stiffness_by_node, 0, (size_t)contact->node_count * sizeof *contact->stiffness_by_node);
    for (int k = 0; k < contact->skin.list_count; k++)
        contact->skin.loads[k] = 0;
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        sb_real k = sbi_contact_light(contact, patch, step);
        for (int i = patch->first; i < patch->first + patch->count; i++)
            contact->samples[i].k = k;
        sbi_contact_add_load(contact, patch);
    }
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        sb_real share = 1;
        for (int a = 0; a < contact->faces->sizes[patch->face]; a++)
            share = sb_min(share, sbi_contact_bearable(contact, patch->nodes[a], step));
        for (int i = patch->first; i < patch->first + patch->count; i++)
            contact->samples[i].k *= share;
    }
}

/* Forces that rounding of places makes (N): the norm of those of all samples. */
static double sbi_contact_noise(const sb_contact *contact)
{
    double sum = 0, place = 0;
    for (int k = 0; k < contact->node_count; k++)
        place = fmax(place, (double)sb_v3_norm(contact->positions[k]));
    for (int i = 0; i < contact->sample_count; i++) {
        double force = (double)(contact->samples[i].area * contact->samples[i].k) * (double)SB_EPSILON * place;
        sum += force * force;
    }
    return sqrt(sum + sbi_pairs_noise_square(contact, place));
}

/* ---- memory ---- */

/* Order of samples: by tool, face, number. */
static int sbi_contact_compare(const sbi_contact_patch *patch, const sbi_contact_sample *sample,
                               const sbi_contact_entry *entry)
{
    if (patch->tool != entry->tool)
        return patch->tool < entry->tool ? -1 : 1;
    if (patch->face != entry->face)
        return patch->face < entry->face ? -1 : 1;
    return sample->sample < entry->sample ? -1 : sample->sample > entry->sample;
}

/* Hands tractions that the last step left over to the samples: both lists are in the same order. */
static void sbi_contact_remember(sb_contact *contact)
{
    int e = 0;
    for (int i = 0; i < contact->sample_count; i++) {
        sbi_contact_sample *sample = contact->samples + i;
        const sbi_contact_patch *patch = contact->patches + sample->patch;
        while (e < contact->entry_count && sbi_contact_compare(patch, sample, contact->entries + e) > 0)
            e++;
        if (e < contact->entry_count && sbi_contact_compare(patch, sample, contact->entries + e) == 0 &&
            contact->entries[e].parts == patch->parts) {
            sample->remembered = contact->entries[e].traction;
            sample->normal = contact->entries[e].normal;
        }
    }
}

/* ---- begin ---- */

static sb_result sbi_contact_begin(void *user, const sbi_touch_step *given, sb_error *error)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_touch_step own = *given; /* with velocities of the points that faces have */
    const sbi_touch_step *step = &own;
    int thin = 0;
    sb_result result = sbi_contact_update_faces(contact, error);
    if (result != SB_OK)
        return result;
    own.velocity = sbi_contact_at_points(contact, given->velocity, contact->skin.velocity);
    contact->is_solved = contact->stopped = 0;
    contact->touch.foresees = contact->foresees = step->linearised && !contact->pairs.kinds;
    contact->is_explicit = step->masses != NULL;
    if (!(step->dt > 0) && !contact->kept) {   /* it replaces entries increment by increment */
        (void)sbi_contact_keep(contact, NULL); /* its faces are up to date */
        contact->kept = 1;
    }
    result = sbi_contact_sweep(contact, step, error);
    if (result != SB_OK)
        return result;
    while (!sbi_contact_find_patches(contact, step, thin)) {
        if (thin++ == SBI_CONTACT_THINNEST) {
            sbi_contact_forget_nodes(contact);
            return sbi_fail(error, SB_ERROR_MEMORY, "more than max_contacts = %d samples of the surface are near tools",
                            contact->max_contacts);
        }
    }
    contact->step_info.thinned = thin > 0;
    result = sbi_pairs_begin(contact, step, error);
    if (result != SB_OK) {
        sbi_contact_forget_nodes(contact);
        return result;
    }
    contact->touch.nodes = contact->skin.source ? contact->skin.list : contact->nodes;
    contact->touch.node_count = contact->skin.source ? contact->skin.list_count : contact->node_count;
    sbi_contact_begin_hung(contact);
    if (contact->is_explicit)
        sbi_contact_stiffen_explicit(contact, step);
    else
        sbi_contact_stiffen(contact, step);
    sbi_contact_remember(contact);
    if (!contact->is_explicit)
        sbi_contact_remember_pressures(contact);
    sbi_pairs_stiffen(contact);
    sbi_pairs_remember(contact);
    contact->touch.noise = sbi_contact_noise(contact);
    contact->step_info.candidates = contact->sample_count + contact->pairs.sample_count;
    contact->step_info.retries = step->tries;
    contact->blocks_current = 0;
    contact->saved_count = 0;
    return SB_OK;
}

/* ---- evaluation ---- */

/* Forces on the nodes, in the order of samples. */
static void sbi_contact_sum_forces(sb_contact *contact)
{
    sb_vec3 *force = contact->skin.source ? contact->skin.force : contact->touch.force;
    memset(force, 0, (size_t)contact->node_count * sizeof *force);
    contact->touch.touching = 0;
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        int count = contact->faces->sizes[patch->face];
        contact->touch.touching += patch->touching;
        for (int i = patch->first; patch->touching && i < patch->first + patch->count; i++) {
            const sbi_contact_sample *s = contact->samples + i;
            sb_vec3 f = sb_v3_scale(s->area, sbi_contact_stress(s));
            for (int a = 0; s->answer.state != SBI_CONTACT_OFF && a < count; a++)
                force[patch->nodes[a]] = sb_v3_madd(force[patch->nodes[a]], s->weights[a], f);
        }
    }
    sbi_pairs_add_forces(contact, force);
    if (contact->skin.source)
        sbi_contact_skin_give(contact, NULL, force, contact->touch.force);
}

/* How much tools pushed in the last step, and do at the first guess. */
static void sbi_contact_sum_pushes(sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++)
        contact->tools[t].pushed = contact->tools[t].pushes = 0;
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        contact->tools[entry->tool].pushed += sb_v3_dot(entry->force, entry->normal);
    }
    for (int i = 0; i < contact->sample_count; i++) {
        const sbi_contact_sample *s = contact->samples + i;
        contact->tools[contact->patches[s->patch].tool].pushes += s->area * s->answer.pressure;
    }
}

/* Bounds of friction at the first guess of a step. Pressures are stiff, and as tissue coasts they come out too large
 * together by a tenth or so, which the first system mends but for friction: so bounds are those of as much force as in
 * the last step. A blow foretells nothing; tools on springs are where friction lets them be, and are left alone. */
static void sbi_contact_foresee(sb_contact *contact, sbi_contact_work *work)
{
    sbi_contact_sum_pushes(contact);
    for (int i = 0; i < contact->sample_count; i++) {
        const sbi_contact_tool *tool = contact->tools + contact->patches[contact->samples[i].patch].tool;
        if (tool->pushed < SBI_CONTACT_CHANGES * tool->pushes && tool->pushes < SBI_CONTACT_CHANGES * tool->pushed &&
            !sbi_contact_is_hung(tool))
            contact->samples[i].bound *= tool->pushed / tool->pushes;
    }
    work->renew = 0;
    sbi_contact_evaluate_patches(work);
}

static void sbi_contact_evaluate(void *user, const sb_vec3 *du, int renew)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_contact_work work;
    if (contact->skin.source) {
        sbi_contact_skin_take(contact, NULL, du, contact->skin.du);
        du = contact->skin.du;
    }
    work.contact = contact;
    work.du = du;
    work.renew = renew;
    work.first = 0;
    work.last = contact->patch_count;
    sbi_contact_evaluate_patches(&work);
    sbi_contact_settle_hung(contact, &work);
    if (contact->foresees && renew)
        sbi_contact_foresee(contact, &work);
    contact->foresees = 0;
    sbi_pairs_evaluate(contact, du, renew);
    sbi_contact_sum_forces(contact);
    contact->blocks_current = 0;
}

/* ---- stiffness as blocks ---- */

/* blocks [count][count] of a patch: K of its samples with their nodes' weights. */
static void sbi_contact_patch_blocks(const sb_contact *contact, const sbi_contact_patch *patch, sb_real (*blocks)[9])
{
    int count = contact->faces->sizes[patch->face];
    memset(blocks, 0, (size_t)(count * count) * sizeof *blocks);
    for (int i = patch->first; i < patch->first + patch->count; i++) {
        const sbi_contact_sample *s = contact->samples + i;
        sb_real k[9];
        if (s->answer.state == SBI_CONTACT_OFF)
            continue;
        sbi_contact_stiffness(&s->answer, s->normal, s->area, k);
        for (int a = 0; a < count; a++)
            for (int b = 0; b < count; b++) {
                sb_real w = s->weights[a] * s->weights[b];
                for (int c = 0; c < 9; c++)
                    blocks[a * count + b][c] += w * k[c];
            }
    }
}

static void sbi_contact_make_chunk(void *user, int chunk)
{
    const sb_contact *contact = (const sb_contact *)user;
    size_t width = (size_t)contact->faces->width;
    int last = sbi_min_int((chunk + 1) * SBI_CONTACT_CHUNK, contact->patch_count);
    for (int p = chunk * SBI_CONTACT_CHUNK; p < last; p++)
        if (contact->patches[p].touching)
            sbi_contact_patch_blocks(contact, contact->patches + p, contact->blocks + (size_t)p * width * width);
}

static void sbi_contact_make_blocks(sb_contact *contact)
{
    int chunks = contact->patch_count / SBI_CONTACT_CHUNK + (contact->patch_count % SBI_CONTACT_CHUNK != 0);
    if (!contact->blocks_current)
        sbi_run(sbi_body_jobs(contact->body), sbi_contact_make_chunk, contact, chunks);
    contact->blocks_current = 1;
}

static sb_vec3 sbi_contact_times(const sb_real *m, sb_vec3 v)
{
    return sb_v3(m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
                 m[6] * v.x + m[7] * v.y + m[8] * v.z);
}

/* By places of nodes of faces. */
static void sbi_contact_multiply_faces(sb_contact *contact, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    size_t width = (size_t)contact->faces->width;
    sbi_contact_make_blocks(contact);
    memset(out, 0, (size_t)contact->node_count * sizeof *out);
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        const sb_real(*blocks)[9] = (const sb_real(*)[9])(contact->blocks + (size_t)p * width * width);
        int count = contact->faces->sizes[patch->face];
        for (int b = 0; patch->touching && b < count; b++) {
            unsigned axes = masked ? masked[contact->nodes[patch->nodes[b]]] : 0u;
            sb_vec3 v = sbi_contact_unmasked(axes, x[patch->nodes[b]]);
            for (int a = 0; a < count; a++)
                out[patch->nodes[a]] = sb_v3_add(out[patch->nodes[a]], sbi_contact_times(blocks[a * count + b], v));
        }
    }
    sbi_pairs_multiply(contact, masked, x, out);
    if (contact->touch.couples)
        sbi_contact_subtract_hung(contact, x, out);
    for (int k = 0; masked && k < contact->node_count; k++)
        out[k] = sbi_contact_unmasked(masked[contact->nodes[k]], out[k]);
}

static void sbi_contact_multiply(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    sb_contact *contact = (sb_contact *)user;
    if (!contact->skin.source) {
        sbi_contact_multiply_faces(contact, masked, x, out);
        return;
    }
    sbi_contact_skin_take(contact, masked, x, contact->skin.du);
    sbi_contact_multiply_faces(contact, NULL, contact->skin.du, contact->skin.force);
    sbi_contact_skin_give(contact, masked, contact->skin.force, out);
}

static void sbi_contact_add_blocks(void *user, const unsigned char *masked, sb_matrix *matrix)
{
    sb_contact *contact = (sb_contact *)user;
    size_t width = (size_t)contact->faces->width;
    sbi_contact_make_blocks(contact);
    contact->saved_count = contact->skin.cross_count = 0;
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        const sb_real(*blocks)[9] = (const sb_real(*)[9])(contact->blocks + (size_t)p * width * width);
        int count = contact->faces->sizes[patch->face];
        if (patch->touching && contact->skin.source)
            sbi_contact_skin_add_face(contact, masked, matrix, patch->face, blocks);
        if (contact->skin.source)
            continue;
        const int *places =
            patch->touching ? sbi_contact_face_blocks(contact->faces, contact->body, patch->face) : NULL;
        for (int i = 0; places && i < count * count; i++) {
            sbi_contact_saved *saved = contact->saved + contact->saved_count++;
            unsigned rows = masked ? masked[contact->nodes[patch->nodes[i / count]]] : 0u;
            unsigned columns = masked ? masked[contact->nodes[patch->nodes[i % count]]] : 0u;
            saved->block = places[i];
            memcpy(saved->values, matrix->blocks[places[i]], sizeof saved->values);
            sbi_contact_add_block(matrix->blocks[places[i]], blocks[i], rows, columns);
        }
    }
    sbi_pairs_add_blocks(contact, masked, matrix);
    contact->touch.links |= contact->skin.cross_count > 0;
}

static double sbi_contact_multiply_links(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    sb_contact *contact = (sb_contact *)user;
    double sum = sbi_pairs_multiply_links(contact, masked, x, out);
    return contact->skin.source ? sum + sbi_contact_skin_multiply_links(contact, masked, x, out) : sum;
}

/* Backwards, since faces share blocks. */
static void sbi_contact_restore_blocks(void *user, sb_matrix *matrix)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_pairs_restore_blocks(contact, matrix);
    while (contact->saved_count > 0) {
        const sbi_contact_saved *saved = contact->saved + --contact->saved_count;
        memcpy(matrix->blocks[saved->block], saved->values, sizeof saved->values);
    }
}

/* ---- end ---- */

static int sbi_contact_accept(void *user, const sb_vec3 *u)
{
    sb_contact *contact = (sb_contact *)user;
    contact->touch.apart = 0;
    if (!sbi_contact_is_safe(contact, u))
        return 0;
    sbi_pairs_set_ways(contact, u);
    contact->touch.missed = !sbi_pairs_foresaw(contact);
    contact->touch.apart = !contact->touch.missed && !sbi_pairs_are_safe(contact);
    return !contact->touch.apart && !contact->touch.missed;
}

static int sbi_contact_hold(void *user, sb_vec3 *u) { return sbi_pairs_hold((sb_contact *)user, u); }

static int sbi_contact_mend(void *user, sb_vec3 *u, int whole) { return sbi_pairs_mend((sb_contact *)user, u, whole); }

static void sbi_contact_stop_body(void *user, sb_vec3 *u) { sbi_contact_stop((sb_contact *)user, u); }

static void sbi_contact_brake(void *user, const sb_vec3 *u, sb_vec3 *v)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_pairs_brake_held(contact, u, v);
    sbi_pairs_brake_mended(contact, v);
    sbi_contact_brake_stopped(contact, u, v);
}

/* A sample in touch becomes an entry. */
static sbi_contact_entry sbi_contact_make_entry(const sbi_contact_patch *patch, const sbi_contact_sample *s)
{
    sbi_contact_entry entry;
    memset(&entry, 0, sizeof entry);
    entry.tool = patch->tool;
    entry.face = patch->face;
    entry.parts = patch->parts;
    entry.sample = s->sample;
    entry.sticks = s->answer.state == SBI_CONTACT_STICKS;
    entry.traction = s->answer.traction;
    entry.gap = s->gap;
    entry.area = s->area;
    entry.point = s->point;
    entry.normal = s->normal;
    entry.force = sb_v3_scale(s->area, sbi_contact_stress(s));
    entry.answer = s->answer;
    return entry;
}

static void sbi_contact_sum_wrenches(sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++)
        contact->tools[t].force = contact->tools[t].torque = sb_v3(0, 0, 0);
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sbi_contact_tool *tool = contact->tools + entry->tool;
        sb_vec3 arm = sb_v3_sub(entry->point, tool->balance.position);
        tool->force = sb_v3_add(tool->force, entry->force);
        tool->torque = sb_v3_add(tool->torque, sb_v3_cross(arm, entry->force));
    }
}

static void sbi_contact_keep_nearest(sb_contact *contact, sbi_contact_sample *s)
{
    const sbi_contact_patch *patch = contact->patches + s->patch;
    sbi_contact_nearest *nearest = &contact->tools[patch->tool].nearest;
    if (nearest->known && !(s->clear < nearest->gap))
        return;
    sbi_contact_evaluate_again(contact, s);
    if (nearest->known && !(s->gap < nearest->gap))
        return;
    nearest->known = 1;
    nearest->face = patch->face;
    nearest->parts = patch->parts;
    nearest->sample = s->sample;
    nearest->gap = s->gap;
    nearest->point = s->point;
    nearest->normal = s->normal;
}

/* Entries of the samples that touch. */
static void sbi_contact_keep_entries(sb_contact *contact)
{
    sbi_contact_entry *fresh = contact->spare;
    int count = 0;
    for (int t = 0; t < contact->max_tools; t++)
        contact->tools[t].nearest.known = 0;
    contact->step_info.touching = contact->step_info.sticking = 0;
    contact->step_info.deepest = 0;
    for (int i = 0; i < contact->sample_count; i++) {
        sbi_contact_sample *s = contact->samples + i;
        if (!(s->answer.pressure > 0)) {
            sbi_contact_keep_nearest(contact, s);
            continue;
        }
        fresh[count] = sbi_contact_make_entry(contact->patches + s->patch, s);
        contact->step_info.touching++;
        contact->step_info.sticking += fresh[count++].sticks;
        contact->step_info.deepest = sb_max(contact->step_info.deepest, -s->gap);
    }
    contact->spare = contact->entries;
    contact->entries = fresh;
    contact->entry_count = count;
    sbi_pairs_keep_entries(contact);
}

/* Tools are where they went. */
static void sbi_contact_arrive(sb_contact *contact)
{
    contact->step_info.lag = 0;
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_tool *tool = contact->tools + t;
        if (!tool->shape)
            continue;
        tool->reached = tool->next;
        for (int i = 0; i < sbi_tool_point_count(tool->shape); i++)
            tool->chain_reached[i] = tool->chain_next[i];
        tool->lag =
            sbi_tool_motion(tool->shape, tool->chain_reached, &tool->reached, tool->chain_wanted, &tool->wanted);
        contact->step_info.lag = sb_max(contact->step_info.lag, tool->lag);
    }
}

/* Overlap of what touches, and how far the surface was pushed there, along the normal (m). */
static void sbi_contact_measure_overlap(const sb_contact *contact, sb_real *overlap, sb_real *pushed)
{
    const sb_vec3 *rest = sbi_contact_points_at_rest(contact);
    *overlap = *pushed = 0;
    for (int p = 0; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        int count = contact->faces->sizes[patch->face];
        for (int i = patch->first; i < patch->first + patch->count; i++) {
            const sbi_contact_sample *s = contact->samples + i;
            sb_vec3 home =
                sbi_contact_mean(s->weights, sbi_contact_face_nodes(contact->faces, patch->face), count, rest);
            if (!(s->answer.pressure > 0))
                continue;
            *overlap = sb_max(*overlap, -s->gap);
            *pushed = sb_max(*pushed, sb_abs(sb_v3_dot(sb_v3_sub(s->point, home), s->normal)));
        }
    }
    sbi_pairs_measure_overlap(contact, overlap, pushed);
}

/* An increment of a static solve is done: tools are there. */
static void sbi_contact_keep_stage(sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_tool *tool = contact->tools + t;
        tool->stage = tool->balance;
        for (int i = 0; tool->shape && i < sbi_tool_point_count(tool->shape); i++)
            tool->chain_stage[i] = tool->chain_next[i];
    }
}

/* Tools of a static solve go back to the last increment that was done. */
static void sbi_contact_take_stage(sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_tool *tool = contact->tools + t;
        tool->next = tool->balance = tool->stage;
        for (int i = 0; tool->shape && i < sbi_tool_point_count(tool->shape); i++)
            tool->chain_next[i] = tool->chain_stage[i];
    }
}

/* Samples remember their pressures until they alone hold the surface off the tools. */
static int sbi_contact_balance(void *user, int round)
{
    sb_contact *contact = (sb_contact *)user;
    sb_real overlap, pushed;
    if (sbi_contact_is_held(contact))
        return -1;
    sbi_contact_measure_overlap(contact, &overlap, &pushed);
    if (round <= SBI_CONTACT_ROUNDS && overlap > SBI_CONTACT_OVERLAP * pushed) {
        sbi_contact_keep_pressures(contact, 0);
        sbi_pairs_keep_pressures(contact, 0);
        sbi_contact_remember_pressures(contact);
        sbi_pairs_remember_pressures(contact);
        return 1;
    }
    sbi_contact_keep_pressures(contact, 0);
    sbi_pairs_keep_pressures(contact, 0);
    sbi_contact_keep_entries(contact);
    sbi_contact_keep_stage(contact);
    sbi_contact_keep_springs(contact);
    contact->is_solved = 1; /* until another increment begins */
    return 0;
}

static void sbi_contact_add_done(void *user, sb_real factor, sb_vec3 *out)
{
    const sb_contact *contact = (const sb_contact *)user;
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sbi_contact_load_sample(contact, entry->face, entry->parts, entry->sample, factor, entry->force, out);
    }
    sbi_pairs_add_done(contact, factor, out);
}

static void sbi_contact_commit(void *user)
{
    sb_contact *contact = (sb_contact *)user;
    if (contact->is_static) {
        sbi_contact_take_stage(contact);
    } else {
        if (contact->is_explicit)
            contact->pressure_count = 0; /* by substeps they would swing up: the matrix is too stiff for them */
        else
            sbi_contact_keep_pressures(contact, 1);
        contact->pairs.strayed = contact->is_explicit ? 0 : contact->pairs.straying / contact->touch.share;
        sbi_pairs_keep_pressures(contact, 1);
        sbi_contact_keep_entries(contact);
        sbi_contact_keep_springs(contact);
        contact->is_solved = !contact->is_explicit;
    }
    sbi_contact_commit_springs(contact);
    sbi_contact_sum_wrenches(contact);
    sbi_contact_arrive(contact);
    contact->step_info.iterations = contact->touch.iterations;
    contact->step_info.capped = contact->touch.capped;
    contact->step_info.mended = contact->touch.mended;
    contact->step_info.residual = contact->touch.residual;
    contact->info = contact->step_info;
    contact->kept = 0;
    sbi_contact_forget_nodes(contact);
}

static void sbi_contact_undo(void *user)
{
    sb_contact *contact = (sb_contact *)user;
    contact->touch.links = 0;
    if (contact->kept)
        (void)sbi_contact_rewind(contact, NULL); /* the mesh is the same */
    contact->kept = contact->is_solved = 0;
    sbi_contact_forget_nodes(contact);
}

SBI_API void sbi_contact_join(sb_contact *contact)
{
    sbi_touch *touch = &contact->touch;
    touch->user = contact;
    touch->begin = sbi_contact_begin;
    touch->evaluate = sbi_contact_evaluate;
    touch->multiply = sbi_contact_multiply;
    touch->add_blocks = sbi_contact_add_blocks;
    touch->restore_blocks = sbi_contact_restore_blocks;
    touch->multiply_links = sbi_contact_multiply_links;
    touch->accept = sbi_contact_accept;
    touch->hold = sbi_contact_hold;
    touch->mend = sbi_contact_mend;
    touch->stop = sbi_contact_stop_body;
    touch->brake = sbi_contact_brake;
    touch->share = 1;
    touch->is_last = 1;
    touch->balance = sbi_contact_balance;
    touch->add_done = sbi_contact_add_done;
    touch->commit = sbi_contact_commit;
    touch->undo = sbi_contact_undo;
    touch->kept_size = sbi_contact_kept_size;
    touch->keep = sbi_contact_keep;
    touch->rewind = sbi_contact_rewind;
    sbi_body_set_touch(contact->body, touch);
}
