/* haptic_publish: the contacts of a step as planes, and their stiffness.
 *
 * Stiffness comes from the system that the step has solved, (A + K) x = b with K of contact: the tool is moved by a
 * unit e, the tissue follows by c, and what touches in a cluster then pushes by
 *     (A + sum dA w w^T K) c = sum dA w K e,    kn = sum of the cluster's e.dA K (e - w.c).
 * The whole tool moves, not the cluster's samples alone: clusters that share the tissue around them would otherwise
 * each be held by the others, and their sum be too stiff. Of a single cluster the sum is the system's energy, in which
 * the error of c counts squared, so that few iterations do. One such column is found in a step, in turn. */
#include <string.h>

#include "haptic_private.h"

#define SBI_CLUSTER_NEAR 0.866               /* cosine of the angle between normals of a cluster */
#define SBI_COLUMN_TOLERANCE ((sb_real)0.01) /* of the solution of a column */
/* Stiffness across the normal over that along it where it was never found: that of a sticking round contact, 2 (1 -
 * nu)/(2 - nu), of what keeps its volume. Mindlin 1949. */
#define SBI_CLUSTER_SHEAR (2 / 3.0)

enum { SBI_COLUMN_NEVER = 1 << 20 }; /* steps since a column was found that never was */

/* Sums over the entries of a cluster, on the tool. */
typedef struct sbi_cluster_sum {
    sbi_d3 push, force, torque; /* N, N, N m about the tool's position */
    sbi_d3 point;               /* N m: of places times their push */
    double weight, stuck, area; /* N: all pushes, those of what sticks; m^2 */
} sbi_cluster_sum;

/* Entries of a tool: they lie side by side. */
typedef struct sbi_cluster_list {
    const sbi_contact_entry *entries;
    int count;
} sbi_cluster_list;

static sbi_cluster_list sbi_haptic_entries(const sb_haptic *haptic)
{
    const sb_contact *contact = haptic->contact;
    sbi_cluster_list list = {contact->entries, 0};
    const sbi_contact_entry *end = contact->entries + contact->entry_count;
    while (list.entries < end && list.entries->tool < haptic->tool)
        list.entries++;
    while (list.entries + list.count < end && list.entries[list.count].tool == haptic->tool)
        list.count++;
    return list;
}

/* ---- clusters ---- */

static double sbi_entry_push(const sbi_contact_entry *entry) { return (double)sb_v3_dot(entry->force, entry->normal); }

/* The entry without a cluster that pushes most, or -1. */
static int sbi_cluster_seed(const sb_haptic *haptic, const sbi_cluster_list *list)
{
    int best = -1;
    for (int i = 0; i < list->count; i++)
        if (haptic->cluster_of[i] < 0 &&
            (best < 0 || sbi_entry_push(list->entries + i) > sbi_entry_push(list->entries + best)))
            best = i;
    return best;
}

/* The cluster whose first entry has the nearest normal. */
static int sbi_cluster_nearest(const sbi_cluster_list *list, const int *seeds, int count, sb_vec3 normal)
{
    int best = 0;
    for (int c = 1; c < count; c++)
        if (sb_v3_dot(list->entries[seeds[c]].normal, normal) > sb_v3_dot(list->entries[seeds[best]].normal, normal))
            best = c;
    return best;
}

/* Shares the entries out, the strongest first. Returns the number of clusters. */
static int sbi_cluster_share_out(sb_haptic *haptic, const sbi_cluster_list *list)
{
    int seeds[SBI_HAPTIC_CLUSTERS], count = 0;
    for (int i = 0; i < list->count; i++)
        haptic->cluster_of[i] = -1;
    for (; count < SBI_HAPTIC_CLUSTERS; count++) {
        int seed = sbi_cluster_seed(haptic, list);
        if (seed < 0)
            break;
        seeds[count] = seed;
        for (int i = 0; i < list->count; i++)
            if (haptic->cluster_of[i] < 0 &&
                (double)sb_v3_dot(list->entries[i].normal, list->entries[seed].normal) >= SBI_CLUSTER_NEAR)
                haptic->cluster_of[i] = count;
        haptic->cluster_of[seed] = count;
    }
    for (int i = 0; i < list->count; i++)
        if (haptic->cluster_of[i] < 0)
            haptic->cluster_of[i] = sbi_cluster_nearest(list, seeds, count, list->entries[i].normal);
    return count;
}

static void sbi_cluster_add(sbi_cluster_sum *sum, const sbi_contact_entry *entry, sbi_d3 position)
{
    sbi_d3 force = sbi_d_scale(-1, sbi_d_of(entry->force)), place = sbi_d_of(entry->point);
    double push = sbi_entry_push(entry);
    sum->push = sbi_d_madd(sum->push, -push, sbi_d_of(entry->normal));
    sum->force = sbi_d_add(sum->force, force);
    sum->torque = sbi_d_add(sum->torque, sbi_d_cross(sbi_d_sub(place, position), force));
    sum->point = sbi_d_madd(sum->point, push, sbi_d_sub(place, position));
    sum->weight += push;
    sum->stuck += entry->sticks ? push : 0;
    sum->area += (double)entry->area;
}

/* Point, normal and forces of a cluster: they are exactly the sums. */
static void sbi_cluster_fill(sbi_haptic_cluster *k, const sbi_cluster_sum *sum, const sbi_d_pose *pose, double friction)
{
    sbi_turn back = sbi_turn_make(pose->rotation.w, -pose->rotation.x, -pose->rotation.y, -pose->rotation.z);
    double size = sbi_d_norm(sum->push), traction;
    memset(k, 0, sizeof *k);
    k->normal = sbi_d_scale(1 / size, sum->push);
    k->point = sbi_turn_apply(back, sbi_d_scale(1 / sum->weight, sum->point));
    k->push = sbi_d_dot(sum->force, k->normal);
    k->traction = sbi_d_madd(sum->force, -k->push, k->normal);
    k->torque = sbi_d_sub(sum->torque, sbi_d_cross(sbi_turn_apply(pose->rotation, k->point), sum->force));
    traction = sbi_d_norm(k->traction);
    k->friction = friction;
    if (friction > 0 && traction > friction * k->push && k->push > 0)
        k->friction = traction / k->push; /* of normals that part, which share less of their pushes than of their sum */
}

SBI_API sbi_d_pose sbi_haptic_pose(const sb_pose *from)
{
    const sb_quat *q = &from->rotation;
    const sbi_turn none = {1, 0, 0, 0};
    sbi_d_pose pose;
    pose.position = sbi_d_of(from->position);
    pose.rotation = sbi_turn_unit(sbi_turn_make((double)q->w, (double)q->x, (double)q->y, (double)q->z), none);
    return pose;
}

/* Clusters without stiffness. sums [SBI_HAPTIC_CLUSTERS] */
static void sbi_haptic_gather(sb_haptic *haptic, const sbi_cluster_list *list, sbi_haptic_frame *frame,
                              sbi_cluster_sum *sums)
{
    const sbi_contact_tool *tool = haptic->contact->tools + haptic->tool;
    memset(frame, 0, sizeof *frame);
    memset(sums, 0, SBI_HAPTIC_CLUSTERS * sizeof *sums);
    frame->pose = sbi_haptic_pose(&tool->balance);
    frame->count = sbi_cluster_share_out(haptic, list);
    for (int i = 0; i < list->count; i++)
        sbi_cluster_add(sums + haptic->cluster_of[i], list->entries + i, frame->pose.position);
    for (int c = 0; c < frame->count; c++)
        sbi_cluster_fill(frame->clusters + c, sums + c, &frame->pose, (double)tool->friction);
}

/* ---- what is known of them ---- */

/* The cluster of the last frame that this one goes on from, or -1. */
static int sbi_haptic_find_known(const sb_haptic *haptic, unsigned taken, sbi_d3 normal)
{
    double nearest = SBI_CLUSTER_NEAR;
    int found = -1;
    for (int o = 0; o < haptic->known_count; o++) {
        double cosine = sbi_d_dot(haptic->known[o].normal, normal);
        if (!(taken >> o & 1u) && cosine >= nearest) {
            nearest = cosine;
            found = o;
        }
    }
    return found;
}

/* What is known of a cluster that was not there: guessed from the strongest of the last frame, as contacts of another
 * size go. */
static sbi_haptic_known sbi_haptic_guess_known(const sb_haptic *haptic, double area)
{
    const sbi_haptic_known *like = haptic->known;
    sbi_haptic_known guess;
    memset(&guess, 0, sizeof guess);
    if (haptic->known_count > 0 && like->area > 0)
        guess.stiffness = like->stiffness * sqrt(area / like->area);
    guess.tangential = SBI_CLUSTER_SHEAR;
    guess.normal_age = guess.tangent_age = SBI_COLUMN_NEVER;
    return guess;
}

static void sbi_haptic_recognise(sb_haptic *haptic, const sbi_haptic_frame *frame, const sbi_cluster_sum *sums)
{
    sbi_haptic_known fresh[SBI_HAPTIC_CLUSTERS];
    unsigned taken = 0;
    for (int c = 0; c < frame->count; c++) {
        int old = sbi_haptic_find_known(haptic, taken, frame->clusters[c].normal);
        fresh[c] = old < 0 ? sbi_haptic_guess_known(haptic, sums[c].area) : haptic->known[old];
        taken |= old < 0 ? 0u : 1u << old;
        fresh[c].normal = frame->clusters[c].normal;
        fresh[c].area = sums[c].area;
        fresh[c].normal_age = sbi_min_int(fresh[c].normal_age + 1, SBI_COLUMN_NEVER);
        fresh[c].tangent_age = sbi_min_int(fresh[c].tangent_age + 1, SBI_COLUMN_NEVER);
    }
    memcpy(haptic->known, fresh, (size_t)frame->count * sizeof *fresh);
    haptic->known_count = frame->count;
}

/* ---- a column ---- */

/* rhs += a force on a sample of a face */
static void sbi_column_load(sb_haptic *haptic, int face, int parts, int sample, sb_vec3 force)
{
    sbi_contact_load_sample(haptic->contact, face, parts, sample, 1, force, haptic->contact->hung_in);
}

/* Where the tissue there goes by the column. */
static sb_vec3 sbi_column_motion(const sb_haptic *haptic, int face, int parts, int sample)
{
    return sbi_contact_sample_motion(haptic->contact, face, parts, sample, haptic->contact->hung_out);
}

static void sbi_column_clear(sb_haptic *haptic)
{
    memset(haptic->contact->hung_in, 0,
           (size_t)sb_body_node_count(haptic->contact->body) * sizeof *haptic->contact->hung_in);
}

/* 0: it has no sensible answer */
static int sbi_column_solve(sb_haptic *haptic)
{
    return sbi_body_solve_column(haptic->contact->body, haptic->contact->hung_in, haptic->contact->hung_out,
                                 SBI_COLUMN_TOLERANCE) == SB_OK;
}

/* Force from an entry on a tool that has moved by `way` against the tissue. */
static sb_vec3 sbi_column_force(const sbi_contact_entry *entry, sb_vec3 way)
{
    sb_real k[9];
    sbi_contact_stiffness(&entry->answer, entry->normal, entry->area, k);
    return sb_v3(k[0] * way.x + k[1] * way.y + k[2] * way.z, k[3] * way.x + k[4] * way.y + k[5] * way.z,
                 k[6] * way.x + k[7] * way.y + k[8] * way.z);
}

/* Stiffness (N/m) of a cluster against the tool's motion along the unit vector e; not positive: it is not known. */
static double sbi_column_stiffness(sb_haptic *haptic, const sbi_cluster_list *list, int cluster, sbi_d3 along)
{
    sb_vec3 e = sb_v3((sb_real)along.x, (sb_real)along.y, (sb_real)along.z);
    double sum = 0;
    sbi_column_clear(haptic);
    for (int i = 0; i < list->count; i++) {
        const sbi_contact_entry *entry = list->entries + i;
        sbi_column_load(haptic, entry->face, entry->parts, entry->sample, sbi_column_force(entry, e));
    }
    if (!sbi_column_solve(haptic))
        return 0;
    for (int i = 0; i < list->count; i++) {
        const sbi_contact_entry *entry = list->entries + i;
        sb_vec3 follows = sbi_column_motion(haptic, entry->face, entry->parts, entry->sample);
        if (haptic->cluster_of[i] == cluster)
            sum += (double)sb_v3_dot(e, sbi_column_force(entry, sb_v3_sub(e, follows)));
    }
    return sum;
}

/* A direction across the normal: the traction's, if there is one. */
static sbi_d3 sbi_cluster_across(const sbi_haptic_cluster *k)
{
    sbi_d3 n = k->normal, across = k->traction;
    if (!(sbi_d_norm(across) > 1e-6 * fabs(k->push)))
        across = sbi_d_across(fabs(n.x) < 0.6 ? sbi_d(1, 0, 0) : sbi_d(0, 1, 0), n);
    return sbi_d_scale(1 / sbi_d_norm(across), across);
}

/* Finds the stiffness that was found longest ago, normals first. Across the normal only where most of it sticks: what
 * slides is the law's matter, not the stiffness'. */
static void sbi_haptic_find_column(sb_haptic *haptic, const sbi_cluster_list *list, const sbi_haptic_frame *frame,
                                   const sbi_cluster_sum *sums)
{
    int cluster = 0, tangent = 0, oldest = 0;
    sbi_haptic_known *known;
    double found;
    for (int c = 0; c < frame->count; c++) {
        int sticks = sums[c].stuck > 0.5 * sums[c].weight, age = haptic->known[c].tangent_age;
        if (haptic->known[c].normal_age > oldest)
            cluster = c, tangent = 0, oldest = haptic->known[c].normal_age;
        if (sticks && age - 1 > oldest)
            cluster = c, tangent = 1, oldest = age - 1;
    }
    known = haptic->known + cluster;
    found = sbi_column_stiffness(haptic, list, cluster,
                                 tangent ? sbi_cluster_across(frame->clusters + cluster) : known->normal);
    if (!(found > 0))
        return;
    if (tangent && known->stiffness > 0)
        known->tangential = found / known->stiffness;
    else if (!tangent)
        known->stiffness = found;
    *(tangent ? &known->tangent_age : &known->normal_age) = 0;
}

/* ---- frames ---- */

/* Nothing has touched yet: what is nearest is as stiff as against a newton on it alone. */
static void sbi_haptic_foresee(sb_haptic *haptic, const sbi_contact_nearest *nearest)
{
    double way;
    sbi_column_clear(haptic);
    sbi_column_load(haptic, nearest->face, nearest->parts, nearest->sample, nearest->normal);
    if (!sbi_column_solve(haptic))
        return;
    way = (double)sb_v3_dot(nearest->normal, sbi_column_motion(haptic, nearest->face, nearest->parts, nearest->sample));
    if (!(way > 0))
        return;
    haptic->known[0] = sbi_haptic_guess_known(haptic, 0);
    haptic->known[0].normal = sbi_d_scale(-1, sbi_d_of(nearest->normal));
    haptic->known[0].stiffness = 1 / way;
    haptic->known_count = 1;
}

/* Nothing touches: the plane of what is nearest, so that the first touch need not wait for a step. Stiffness is that of
 * the last contact, and to be found anew in the next. */
static void sbi_haptic_approach(sb_haptic *haptic, sbi_haptic_frame *frame)
{
    const sbi_contact_tool *tool = haptic->contact->tools + haptic->tool;
    const sbi_contact_nearest *nearest = &tool->nearest;
    sbi_cluster_sum one;
    if (!nearest->known)
        return;
    if (haptic->known_count == 0 && haptic->contact->is_solved)
        sbi_haptic_foresee(haptic, nearest);
    haptic->known_count = sbi_min_int(haptic->known_count, 1);
    haptic->known[0].normal_age = haptic->known[0].tangent_age = SBI_COLUMN_NEVER;
    if (haptic->known_count == 0)
        return;
    memset(&one, 0, sizeof one);
    one.push = sbi_d_scale(-1, sbi_d_of(nearest->normal));
    one.point = sbi_d_sub(sbi_d_of(nearest->point), frame->pose.position);
    one.weight = 1;
    frame->count = 1;
    sbi_cluster_fill(frame->clusters, &one, &frame->pose, (double)tool->friction);
    frame->clusters[0].push = -haptic->known[0].stiffness * (double)nearest->gap;
}

SBI_API void sbi_haptic_make_frame(sb_haptic *haptic, sbi_haptic_frame *frame)
{
    sbi_cluster_list list = sbi_haptic_entries(haptic);
    sbi_cluster_sum sums[SBI_HAPTIC_CLUSTERS];
    sbi_haptic_gather(haptic, &list, frame, sums);
    if (frame->count > 0) {
        sbi_haptic_recognise(haptic, frame, sums);
        if (haptic->contact->is_solved)
            sbi_haptic_find_column(haptic, &list, frame, sums);
    } else {
        sbi_haptic_approach(haptic, frame);
    }
    for (int c = 0; c < frame->count; c++) {
        sbi_haptic_cluster *k = frame->clusters + c;
        k->stiffness = haptic->known[c].stiffness;
        k->tangential = k->friction > 0 ? haptic->known[c].tangential * k->stiffness : 0;
    }
}
