/* contact_hung: tools that hang on their pose by a spring.
 *
 * Such a tool has no mass: it is where the surface and the spring balance. For each displacement x that a step asks
 * forces at its pose q(x) is found by Newton's method, in 3 or 6 unknowns, so that the forces are those of a tool that
 * has given way already. What they change by with x is
 *     K = Kxx - Kxq (Kqq + S)^-1 Kqx,    Kxx = sum w w^T k,  Kxq = -sum w k J,  Kqq = sum J^T k J,
 * k the stiffness of a sample, J = [1, -r x] how the tool moves there, S that of the spring. Kxx has its blocks in the
 * matrix; the rest couples all nodes that the tool touches and is multiplied within conjugate gradients. Soft and stiff
 * springs are then the same to the step: nothing is delayed, and there is nothing to swing.
 *
 * In a step the tool may go as far from its centre as a rigid one goes in touch (contact_sweep.c): what would take it
 * farther, as when it slips off an edge, holds it there until the next step. */
#include <string.h>

#include "contact_private.h"

enum { SBI_HUNG_MOST = 24, SBI_HUNG_CUTS = 6, SBI_HUNG_ROUNDS = 3, SBI_HUNG_AT_LIMIT = 3 };

#define SBI_HUNG_CLOSE ((sb_real)1e-9) /* imbalance that is none, of the forces in balance */
#define SBI_HUNG_TURNS ((sb_real)0.3)  /* of the slope at the start, at the end of a way that needs no search */

/* What moves a tool out of balance where it is, and how large the forces are that balance. */
typedef struct sbi_hung_balance {
    sb_real b[6];               /* N, N m about its position: of the spring, less those on the surface */
    sb_real sizes[2], noise[2]; /* N, N m; of rounding */
} sbi_hung_balance;

SB_INLINE void sbi_hung_put(sb_real *out, sb_vec3 v) { out[0] = v.x, out[1] = v.y, out[2] = v.z; }
SB_INLINE sb_vec3 sbi_hung_get(const sb_real *in) { return sb_v3(in[0], in[1], in[2]); }

static sb_vec3 sbi_hung_times(const sb_real k[9], sb_vec3 v)
{
    return sb_v3(k[0] * v.x + k[1] * v.y + k[2] * v.z, k[3] * v.x + k[4] * v.y + k[5] * v.z,
                 k[6] * v.x + k[7] * v.y + k[8] * v.z);
}

/* ---- the balance ---- */

/* Stiffness of the spring along its pull: less where it pulls with all that it may. */
static sb_real sbi_hung_stiffness(const sbi_contact_tool *tool)
{
    const sbi_contact_spring *spring = &tool->spring;
    sb_real length = sb_v3_norm(sb_v3_sub(spring->hand_balance.position, tool->balance.position));
    return spring->stiffness * length > spring->most ? spring->most / length : spring->stiffness;
}

static void sbi_hung_pull(sbi_contact_tool *tool)
{
    sbi_contact_spring *spring = &tool->spring;
    sb_vec3 way = sb_v3_sub(spring->hand_balance.position, tool->balance.position);
    sb_vec3 turn = sbi_pose_turn_to_space(&tool->balance, sbi_pose_rotation(&tool->balance, &spring->hand_balance));
    spring->pull = sb_v3_scale(sbi_hung_stiffness(tool), way);
    spring->twist = sb_v3_scale(spring->turning, turn);
}

/* At the last evaluation. */
static void sbi_hung_measure(const sb_contact *contact, sbi_contact_tool *tool, sbi_hung_balance *balance)
{
    const sbi_contact_spring *spring = &tool->spring;
    sb_vec3 force, torque;
    sb_real reach = 0;
    sbi_hung_pull(tool);
    force = spring->pull, torque = spring->twist;
    balance->sizes[0] = sb_v3_norm(force), balance->sizes[1] = sb_v3_norm(torque);
    for (int p = spring->first; p < spring->last; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        for (int i = patch->first; patch->touching && i < patch->first + patch->count; i++) {
            const sbi_contact_sample *s = contact->samples + i;
            sb_vec3 f = sb_v3_scale(s->area, sbi_contact_stress(s)), arm = sb_v3_sub(s->point, tool->balance.position);
            if (s->answer.state == SBI_CONTACT_OFF)
                continue;
            force = sb_v3_sub(force, f);
            torque = sb_v3_sub(torque, sb_v3_cross(arm, f));
            balance->sizes[0] += sb_v3_norm(f);
            balance->sizes[1] += sb_v3_norm(arm) * sb_v3_norm(f);
            reach = sb_max(reach, sb_v3_norm(arm));
        }
    }
    balance->noise[0] = (sb_real)contact->touch.noise;
    balance->noise[1] = reach * balance->noise[0];
    sbi_hung_put(balance->b, force);
    sbi_hung_put(balance->b + 3, torque);
}

static int sbi_hung_is_balanced(const sbi_contact_tool *tool, const sbi_hung_balance *balance)
{
    const sb_real close = sb_max(SBI_HUNG_CLOSE, 16 * SB_EPSILON);
    for (int i = 0; i < (tool->spring.turning > 0 ? 6 : 3); i++)
        if (!(sb_abs(balance->b[i]) <= close * balance->sizes[i / 3] + balance->noise[i / 3]))
            return 0;
    return 1;
}

/* ---- Newton's method for the pose ---- */

/* Kqq + S at the last evaluation, factored. */
static void sbi_hung_factor(const sb_contact *contact, sbi_contact_tool *tool)
{
    sbi_contact_spring *spring = &tool->spring;
    int n = spring->turning > 0 ? 6 : 3;
    const sb_vec3 units[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    sb_real h[6][6];
    memset(h, 0, sizeof h);
    for (int p = spring->first; p < spring->last; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        for (int i = patch->first; patch->touching && i < patch->first + patch->count; i++) {
            const sbi_contact_sample *s = contact->samples + i;
            sb_vec3 arm = sb_v3_sub(s->point, tool->balance.position);
            sb_real k[9];
            if (s->answer.state == SBI_CONTACT_OFF)
                continue;
            sbi_contact_stiffness(&s->answer, s->normal, s->area, k);
            for (int j = 0; j < n; j++) {
                sb_vec3 f = sbi_hung_times(k, j < 3 ? units[j] : sb_v3_cross(units[j - 3], arm));
                sb_vec3 t = sb_v3_cross(arm, f);
                h[0][j] += f.x, h[1][j] += f.y, h[2][j] += f.z;
                h[3][j] += t.x, h[4][j] += t.y, h[5][j] += t.z;
            }
        }
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            spring->factor[n * i + j] = h[i][j] + (i != j ? 0 : i < 3 ? sbi_hung_stiffness(tool) : spring->turning);
    spring->size = sb_cholesky_factor(spring->factor, n) == 0 ? n : 0;
}

/* The tool goes a share of a way from a pose, or as far as it may. */
static void sbi_hung_go(sbi_contact_tool *tool, const sb_pose *from, const sb_real way[6], sb_real share)
{
    sb_pose to = *from;
    sb_real motion;
    to.position = sb_v3_madd(from->position, share, sbi_hung_get(way));
    if (tool->spring.turning > 0)
        to.rotation = sb_quat_normalise(
            sb_quat_mul(sb_quat_from_rotation_vector(sb_v3_scale(share, sbi_hung_get(way + 3))), from->rotation));
    motion = sbi_tool_motion(tool->shape, tool->chain_balance, &tool->spring.centre, tool->chain_balance, &to);
    tool->spring.held = !(motion <= tool->spring.limit);
    tool->balance = tool->spring.held ? sbi_pose_between(&tool->spring.centre, &to, tool->spring.limit / motion) : to;
}

static sb_real sbi_hung_slope(const sbi_contact_tool *tool, const sbi_hung_balance *balance, const sb_real way[6])
{
    sb_real sum = 0;
    for (int i = 0; i < tool->spring.size; i++)
        sum += way[i] * balance->b[i];
    return sum;
}

/* Goes along a way whose end would lie behind where the forces balance on it: to there, by false position. */
static void sbi_hung_search(sb_contact *contact, sbi_contact_tool *tool, const sbi_contact_work *work,
                            const sb_pose *from, const sb_real way[6], sb_real begin, sbi_hung_balance *balance)
{
    sb_real low = 0, high = 1, at_low = begin, at_high = sbi_hung_slope(tool, balance, way);
    for (int i = 0; i < SBI_HUNG_CUTS; i++) {
        sb_real share = (low * at_high - high * at_low) / (at_high - at_low), slope;
        sbi_hung_go(tool, from, way, share);
        sbi_contact_evaluate_tool(work, tool);
        sbi_hung_measure(contact, tool, balance);
        slope = sbi_hung_slope(tool, balance, way);
        if (sb_abs(slope) <= SBI_HUNG_TURNS * begin)
            return;
        if (slope < 0)
            high = share, at_high = slope, at_low *= (sb_real)0.5;
        else
            low = share, at_low = slope, at_high *= (sb_real)0.5;
    }
}

/* Finds where the tool balances with bounds of friction as they are. Returns 1 when it was there already. */
static int sbi_hung_settle(sb_contact *contact, sbi_contact_tool *tool, const sbi_contact_work *work)
{
    sbi_contact_spring *spring = &tool->spring;
    sbi_hung_balance balance;
    int at_limit = 0;
    sbi_hung_measure(contact, tool, &balance);
    for (int i = 0; i < SBI_HUNG_MOST; i++) {
        const sb_pose from = tool->balance;
        sb_real way[6], begin;
        if (sbi_hung_is_balanced(tool, &balance))
            return i == 0;
        sbi_hung_factor(contact, tool);
        if (spring->size == 0 || at_limit == SBI_HUNG_AT_LIMIT)
            return 0;
        memcpy(way, balance.b, sizeof way);
        sb_cholesky_solve(spring->factor, spring->size, way);
        begin = sbi_hung_slope(tool, &balance, way);
        sbi_hung_go(tool, &from, way, 1);
        sbi_contact_evaluate_tool(work, tool);
        sbi_hung_measure(contact, tool, &balance);
        if (sbi_hung_slope(tool, &balance, way) < -SBI_HUNG_TURNS * begin)
            sbi_hung_search(contact, tool, work, &from, way, begin, &balance);
        at_limit += spring->held;
    }
    return 0;
}

/* The pose at the end of the step, where forces balance before it. */
static sb_pose sbi_hung_further(const sb_pose *from, const sb_pose *balance, sb_real level)
{
    sb_pose end = *balance;
    if (level == 1 || !(level > 0)) /* 0: the accelerations that a first step starts from are looked for */
        return end;
    end.position = sb_v3_madd(from->position, 1 / level, sb_v3_sub(balance->position, from->position));
    end.rotation = sb_quat_normalise(sb_quat_mul(
        from->rotation, sb_quat_from_rotation_vector(sb_v3_scale(1 / level, sbi_pose_rotation(from, balance)))));
    return end;
}

SBI_API void sbi_contact_settle_hung(sb_contact *contact, const sbi_contact_work *given)
{
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_tool *tool = contact->tools + t;
        sbi_contact_work work = *given;
        if (!sbi_contact_is_hung(tool))
            continue;
        work.renew = 0;
        for (int round = 0; !sbi_hung_settle(contact, tool, &work) && given->renew && tool->friction > 0; round++) {
            if (round == SBI_HUNG_ROUNDS)
                break;
            sbi_contact_evaluate_tool(given, tool);
        }
        sbi_hung_factor(contact, tool);
        if (tool->spring.held)
            tool->spring.size = 0;
        tool->next = sbi_hung_further(&tool->reached, &tool->balance, tool->spring.level);
    }
}

/* ---- in the system ---- */

/* out -= Kxq (Kqq + S)^-1 Kqx x of a tool */
static void sbi_hung_subtract(const sb_contact *contact, const sbi_contact_tool *tool, const sb_vec3 *x, sb_vec3 *out)
{
    const sbi_contact_spring *spring = &tool->spring;
    sb_real z[6] = {0, 0, 0, 0, 0, 0};
    for (int pass = 0; pass < 2; pass++) {
        for (int p = spring->first; p < spring->last; p++) {
            const sbi_contact_patch *patch = contact->patches + p;
            int count = contact->faces->sizes[patch->face];
            for (int i = patch->first; patch->touching && i < patch->first + patch->count; i++) {
                const sbi_contact_sample *s = contact->samples + i;
                sb_vec3 arm = sb_v3_sub(s->point, tool->balance.position), f, t;
                sb_real k[9];
                if (s->answer.state == SBI_CONTACT_OFF)
                    continue;
                sbi_contact_stiffness(&s->answer, s->normal, s->area, k);
                if (pass == 0) {
                    f = sbi_hung_times(k, sbi_contact_mean(s->weights, patch->nodes, count, x));
                    t = sb_v3_cross(arm, f);
                    z[0] += f.x, z[1] += f.y, z[2] += f.z, z[3] += t.x, z[4] += t.y, z[5] += t.z;
                    continue;
                }
                f = sbi_hung_times(k, sb_v3_add(sbi_hung_get(z), sb_v3_cross(sbi_hung_get(z + 3), arm)));
                for (int a = 0; a < count; a++)
                    out[patch->nodes[a]] = sb_v3_madd(out[patch->nodes[a]], -s->weights[a], f);
            }
        }
        if (pass == 0) {
            sb_cholesky_solve(spring->factor, spring->size, z);
            for (int i = spring->size; i < 6; i++)
                z[i] = 0;
        }
    }
}

SBI_API void sbi_contact_subtract_hung(const sb_contact *contact, const sb_vec3 *x, sb_vec3 *out)
{
    for (int t = 0; t < contact->max_tools; t++)
        if (sbi_contact_is_hung(contact->tools + t) && contact->tools[t].spring.size > 0)
            sbi_hung_subtract(contact, contact->tools + t, x, out);
}

static void sbi_hung_multiply(void *user, const double *x, double *y)
{
    const sb_contact *contact = (const sb_contact *)user;
    const sbi_contact_skin *skin = &contact->skin;
    int count = contact->touch.node_count;
    for (int k = 0; k < count; k++)
        contact->hung_in[k] = sb_v3((sb_real)x[3 * k], (sb_real)x[3 * k + 1], (sb_real)x[3 * k + 2]);
    if (skin->source) {
        sbi_contact_skin_take(contact, NULL, contact->hung_in, skin->du);
        memset(skin->force, 0, (size_t)contact->node_count * sizeof *skin->force);
        sbi_contact_subtract_hung(contact, skin->du, skin->force);
        sbi_contact_skin_give(contact, NULL, skin->force, contact->hung_out);
    } else {
        memset(contact->hung_out, 0, (size_t)count * sizeof *contact->hung_out);
        sbi_contact_subtract_hung(contact, contact->hung_in, contact->hung_out);
    }
    for (int k = 0; k < count; k++) {
        y[3 * k] = (double)contact->hung_out[k].x;
        y[3 * k + 1] = (double)contact->hung_out[k].y;
        y[3 * k + 2] = (double)contact->hung_out[k].z;
    }
}

SBI_API void sbi_contact_begin_hung(sb_contact *contact)
{
    sbi_guest *coupling = &contact->touch.coupling;
    int any = 0;
    for (int t = 0; t < contact->max_tools; t++)
        contact->tools[t].spring.first = contact->tools[t].spring.last = 0;
    for (int p = contact->patch_count; p-- > 0;) {
        sbi_contact_spring *spring = &contact->tools[contact->patches[p].tool].spring;
        spring->last = sbi_max_int(spring->last, p + 1);
        spring->first = p;
        any |= sbi_contact_is_hung(contact->tools + contact->patches[p].tool);
    }
    coupling->user = contact;
    coupling->is_tangent = 1;
    coupling->multiply = sbi_hung_multiply;
    coupling->nodes = contact->touch.nodes;
    coupling->node_count = any ? contact->touch.node_count : 0;
}

/* ---- end ---- */

SBI_API int sbi_contact_is_held(const sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++)
        if (sbi_contact_is_hung(contact->tools + t) && contact->tools[t].spring.held)
            return 1;
    return 0;
}

SBI_API void sbi_contact_keep_springs(sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_spring *spring = &contact->tools[t].spring;
        if (!sbi_contact_is_hung(contact->tools + t))
            continue;
        spring->hand_done = spring->hand_next;
        spring->pull_done = spring->pull;
        spring->twist_done = spring->twist;
    }
}

SBI_API void sbi_contact_commit_springs(sb_contact *contact)
{
    for (int t = 0; t < contact->max_tools; t++) {
        sbi_contact_spring *spring = &contact->tools[t].spring;
        if (!sbi_contact_is_hung(contact->tools + t))
            continue;
        spring->hand = spring->hand_done;
        spring->force = spring->pull_done;
        spring->torque = spring->twist_done;
    }
}

SB_API sb_result sb_contact_coupling(const sb_contact *contact, int tool, sb_wrench *on_tool)
{
    if (!contact || !on_tool)
        return SB_ERROR_ARGUMENT;
    if (tool < 0 || tool >= contact->max_tools || !contact->tools[tool].shape)
        return SB_ERROR_INDEX;
    on_tool->force = contact->tools[tool].spring.force;
    on_tool->torque = contact->tools[tool].spring.torque;
    return SB_OK;
}
