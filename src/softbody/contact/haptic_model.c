/* haptic_model: the planes of a frame, and the tool that hangs on a hand among them. */
#include "haptic_model.h"

enum {
    SBI_COUPLING_MOST = 12 /* Newton iterations. Where no contact begins or ends one is exact but for turns */
};
#define SBI_COUPLING_NEAR 1e-4  /* imbalance relative to the forces in balance: one iteration more, and no look back */
#define SBI_COUPLING_SERVES 0.1 /* of an imbalance that an iteration leaves: the factor serves on */
#define SBI_COUPLING_CLOSE 1e-8 /* none more */
#define SBI_COUPLING_LEAST                                                                                             \
    1e-12 /* m or rad: imbalance of the coupling that is none, where there are next to no forces */
#define SBI_FRICTION_FULL (1 - 1e-9)
#define SBI_HAPTIC_LARGE 1e9 /* of an entry of a frame: its squares are far from overflow */

#define SBI_RELAX_KEPT 0.8   /* of what was learned from frames before, with each */
#define SBI_RELAX_MOST 0.8   /* largest share that relaxes */
#define SBI_RELAX_SAME 0.9   /* cosine between normals of one contact in two frames */
#define SBI_RELAX_DOUBT 0.01 /* of the push: changes of it that tell next to nothing */

SBI_API int sbi_haptic_frame_is_sound(const sbi_haptic_frame *frame)
{
    const sbi_turn *q = &frame->pose.rotation;
    int sound = frame->count >= 0 && frame->count <= SBI_HAPTIC_CLUSTERS;
    sound = sound && sbi_d3_within(frame->pose.position, SBI_HAPTIC_LARGE);
    sound = sound && fabs(q->w * q->w + q->x * q->x + q->y * q->y + q->z * q->z - 1) < 1e-6;
    for (int c = 0; sound && c < frame->count; c++) {
        const sbi_haptic_cluster *k = frame->clusters + c;
        sound = sbi_d3_within(k->point, SBI_HAPTIC_LARGE) && sbi_d3_within(k->traction, SBI_HAPTIC_LARGE) &&
                sbi_d3_within(k->torque, SBI_HAPTIC_LARGE) && sbi_d_within(k->push, SBI_HAPTIC_LARGE) &&
                fabs(sbi_d_dot(k->normal, k->normal) - 1) < 1e-6 && sbi_d_within(k->friction, SBI_HAPTIC_LARGE) &&
                k->friction >= 0 && sbi_d_within(k->stiffness, SBI_HAPTIC_LARGE) && k->stiffness >= 0 &&
                sbi_d_within(k->tangential, SBI_HAPTIC_LARGE) && k->tangential >= 0;
    }
    return sound;
}

/* r of a cluster's point in space, counted from the tool's position */
static sbi_d3 sbi_haptic_arm(const sbi_haptic_cluster *cluster, const sbi_d_pose *pose)
{
    return sbi_turn_apply(pose->rotation, cluster->point);
}

/* The plane that pushes most, or -1. */
static int sbi_haptic_strongest(const sbi_haptic_frame *frame)
{
    int best = -1;
    for (int c = 0; c < frame->count; c++)
        if (frame->clusters[c].push > (best < 0 ? 0 : frame->clusters[best].push))
            best = c;
    return best;
}

/* Learns from a frame that follows the one in force: its push is what that one's plane says there, less what the tissue
 * lost of the push of the step before by relaxing. One plane tells; where there are more, their pushes change for other
 * reasons, too. */
static void sbi_haptic_learn(sbi_haptic_model *model, const sbi_haptic_cluster *k, const sbi_haptic_cluster *before,
                             sbi_d3 came)
{
    double lost = k->push - before->push + k->stiffness * sbi_d_dot(k->normal, came);
    double due = k->stiffness * sbi_d_dot(k->normal, model->came), doubt = SBI_RELAX_DOUBT * k->push, share;
    model->fit[0] = SBI_RELAX_KEPT * model->fit[0] + lost * due;
    model->fit[1] = SBI_RELAX_KEPT * model->fit[1] + due * due;
    share = model->fit[0] / (model->fit[1] + doubt * doubt);
    share = share > 0 ? share : 0; /* also of what is no number */
    model->share = share < SBI_RELAX_MOST ? share : SBI_RELAX_MOST;
}

/* What the new frame goes on from. */
static void sbi_haptic_remember(sbi_haptic_model *model, const sbi_haptic_frame *frame)
{
    const sbi_haptic_frame *old = &model->frame;
    int now = sbi_haptic_strongest(frame), before = sbi_haptic_strongest(old);
    sbi_d3 came = sbi_d_sub(frame->pose.position, old->pose.position);
    if (now < 0 || before < 0 ||
        !(sbi_d_dot(frame->clusters[now].normal, old->clusters[before].normal) > SBI_RELAX_SAME)) {
        model->came = sbi_d(0, 0, 0);
        return;
    }
    if (frame->count == 1 && old->count == 1)
        sbi_haptic_learn(model, frame->clusters + now, old->clusters + before, came);
    model->came = came;
}

SBI_API void sbi_haptic_model_relax(sbi_haptic_model *model, sbi_d3 way)
{
    way = sbi_d_add(model->came, way);
    for (int c = 0; c < model->frame.count; c++) {
        const sbi_haptic_cluster *k = model->frame.clusters + c;
        double out = k->stiffness * sbi_d_dot(k->normal, way), push = k->push > 0 ? k->push : 0;
        model->relaxed[c] = push > 0 ? model->share * (out < push ? out : push) : 0; /* farther out nothing touches */
    }
}

SBI_API void sbi_haptic_model_set(sbi_haptic_model *model, const sbi_haptic_frame *frame)
{
    sbi_haptic_remember(model, frame);
    model->frame = *frame;
    sbi_haptic_model_relax(model, sbi_d(0, 0, 0));
    model->factor.size = 0;
    for (int c = 0; c < frame->count; c++) {
        const sbi_haptic_cluster *k = frame->clusters + c;
        model->places[c] = sbi_d_add(frame->pose.position, sbi_haptic_arm(k, &frame->pose));
        model->levers[c] = k->push > 0 ? sbi_d_scale(1 / k->push, k->torque) : sbi_d(0, 0, 0);
        model->gives[c] = k->stiffness > 0 ? 1 / k->stiffness : 0;
        model->gives_across[c] = k->tangential > 0 ? 1 / k->tangential : 0;
        model->anchors[c] = sbi_d_madd(model->places[c], model->gives_across[c], k->traction);
    }
}

/* ---- a plane at a pose ---- */

typedef struct sbi_haptic_touch {
    double push;       /* N */
    sbi_d3 traction;   /* N */
    sbi_d3 arm, place; /* m, of the point: from the tool's position, and in space */
    double kept;       /* share of the traction that friction allows */
    int slides;        /* 1: all of it; a contact that has slid is still there when the next call begins */
} sbi_haptic_touch;

/* axes: the pose's rotation */
static sbi_haptic_touch sbi_haptic_touch_at(const sbi_haptic_model *model, int c, const sbi_d_pose *pose,
                                            const sbi_d_axes *axes)
{
    const sbi_haptic_cluster *k = model->frame.clusters + c;
    sbi_haptic_touch at;
    double bound, square;
    at.arm = sbi_axes_apply(axes, k->point);
    at.place = sbi_d_add(pose->position, at.arm);
    at.push = k->push + model->relaxed[c] - k->stiffness * sbi_d_dot(k->normal, sbi_d_sub(at.place, model->places[c]));
    if (!(at.push > 0))
        at.push = 0;
    at.traction = sbi_d_scale(k->tangential, sbi_d_across(sbi_d_sub(model->anchors[c], at.place), k->normal));
    bound = k->friction * at.push;
    square = sbi_d_dot(at.traction, at.traction);
    at.kept = square > bound * bound ? bound / sqrt(square) : 1;
    at.slides = square > SBI_FRICTION_FULL * SBI_FRICTION_FULL * bound * bound;
    at.traction = sbi_d_scale(at.kept, at.traction);
    return at;
}

SB_INLINE void sbi_haptic_add_touch(const sbi_haptic_model *model, int c, const sbi_haptic_touch *at, sbi_d_wrench *sum)
{
    sbi_d3 force = sbi_d_madd(at->traction, at->push, model->frame.clusters[c].normal);
    sum->force = sbi_d_add(sum->force, force);
    sum->torque = sbi_d_add(sum->torque, sbi_d_cross(at->arm, force));
    sum->torque = sbi_d_madd(sum->torque, at->push, model->levers[c]);
}

/* Draws the anchors of planes along and adds up their energy (J). touches [count] */
static void sbi_haptic_keep(sbi_haptic_model *model, const sbi_haptic_touch *touches, double *stored)
{
    for (int c = 0; c < model->frame.count; c++) {
        const sbi_haptic_touch *at = touches + c;
        *stored += 0.5 * model->gives[c] * at->push * at->push;
        *stored += 0.5 * model->gives_across[c] * sbi_d_dot(at->traction, at->traction);
        if (at->kept < 1)
            model->anchors[c] = sbi_d_madd(at->place, model->gives_across[c], at->traction);
    }
}

/* The wrench at a pose, and what each plane has of it. */
static sbi_d_wrench sbi_haptic_model_at(const sbi_haptic_model *model, const sbi_d_pose *pose,
                                        sbi_haptic_touch *touches)
{
    const sbi_d_axes axes = sbi_turn_axes(pose->rotation);
    sbi_d_wrench sum;
    memset(&sum, 0, sizeof sum);
    for (int c = 0; c < model->frame.count; c++) {
        touches[c] = sbi_haptic_touch_at(model, c, pose, &axes);
        if (touches[c].push > 0)
            sbi_haptic_add_touch(model, c, touches + c, &sum);
    }
    return sum;
}

/* ---- the coupling: Newton's method for the tool's pose ---- */

/* Unknowns: three of the position, then three of a turn in space unless the rotation is rigid. */
typedef struct sbi_haptic_balance {
    int size;                       /* 3 or 6 */
    double b[6];                    /* wrench out of balance; then the way there */
    double least[2], in_balance[2]; /* imbalance that is none; forces and torques in balance */
    double off;                     /* imbalance over what is in balance */
    sbi_d_wrench tissue;
    sbi_haptic_touch touches[SBI_HAPTIC_CLUSTERS];
} sbi_haptic_balance;

/* c += s a b^T, by columns */
static void sbi_haptic_add_outer(sbi_d3 c[3], double s, sbi_d3 a, sbi_d3 b)
{
    c[0] = sbi_d_madd(c[0], s * b.x, a);
    c[1] = sbi_d_madd(c[1], s * b.y, a);
    c[2] = sbi_d_madd(c[2], s * b.z, a);
}

/* Columns of the stiffness of a plane where it touches: what its force loses as the point moves. Where it slides the
 * traction turns with a way across it, and grows with the push: that part is not symmetric. */
static void sbi_haptic_touch_stiffness(const sbi_haptic_cluster *k, const sbi_haptic_touch *at, sbi_d3 c[3])
{
    double size = sbi_d_norm(at->traction), sticks = k->tangential > 0 && !at->slides ? k->tangential : 0;
    c[0] = sbi_d(sticks, 0, 0);
    c[1] = sbi_d(0, sticks, 0);
    c[2] = sbi_d(0, 0, sticks);
    sbi_haptic_add_outer(c, k->stiffness - sticks, k->normal, k->normal);
    if (at->slides && size > 0) {
        sbi_d3 along = sbi_d_scale(1 / size, at->traction), across = sbi_d_cross(k->normal, along);
        sbi_haptic_add_outer(c, at->kept * k->tangential, across, across);
        sbi_haptic_add_outer(c, k->friction * k->stiffness, along, k->normal);
    }
}

/* What each unknown's unit takes from force and torque. */
typedef struct sbi_haptic_columns {
    sbi_d3 force[6], torque[6];
} sbi_haptic_columns;

SB_INLINE void sbi_haptic_add_column(sbi_haptic_columns *columns, int j, sbi_d3 force, sbi_d3 arm)
{
    columns->force[j] = sbi_d_add(columns->force[j], force);
    columns->torque[j] = sbi_d_add(columns->torque[j], sbi_d_cross(arm, force));
}

/* The point moves with the tool: by e_j, and by e_j x arm for a turn. How the arm turns under the force is left out: it
 * is small beside the coupling. */
static void sbi_haptic_columns_touch(sbi_haptic_columns *columns, int size, const sbi_haptic_cluster *k,
                                     const sbi_haptic_touch *at)
{
    sbi_d3 c[3], r = at->arm;
    sbi_haptic_touch_stiffness(k, at, c);
    for (int j = 0; j < 3; j++)
        sbi_haptic_add_column(columns, j, c[j], r);
    if (size < 6)
        return;
    sbi_haptic_add_column(columns, 3, sbi_d_madd(sbi_d_scale(r.y, c[2]), -r.z, c[1]), r);
    sbi_haptic_add_column(columns, 4, sbi_d_madd(sbi_d_scale(r.z, c[0]), -r.x, c[2]), r);
    sbi_haptic_add_column(columns, 5, sbi_d_madd(sbi_d_scale(r.x, c[1]), -r.y, c[0]), r);
}

/* What the coupling does to the hand. */
static sbi_d_wrench sbi_haptic_coupling_wrench(const sbi_haptic_coupling *coupling, const sbi_d_pose *hand,
                                               const sbi_d_pose *tool)
{
    sbi_d_wrench felt;
    felt.force = sbi_d_scale(coupling->translation, sbi_d_sub(tool->position, hand->position));
    felt.torque = sbi_d_scale(coupling->rotation, sbi_turn_between(hand->rotation, tool->rotation));
    return felt;
}

/* Imbalance of tissue and coupling at a pose of the tool. */
static void sbi_haptic_balance_at(sbi_haptic_balance *balance, const sbi_haptic_model *model,
                                  const sbi_haptic_coupling *coupling, const sbi_d_pose *hand, const sbi_d_pose *tool)
{
    sbi_d_wrench sum = sbi_haptic_model_at(model, tool, balance->touches), felt;
    balance->size = coupling->rotation > 0 ? 6 : 3;
    balance->tissue = sum;
    felt = sbi_haptic_coupling_wrench(coupling, hand, tool);
    sbi_d_put(balance->b, sbi_d_sub(sum.force, felt.force));
    sbi_d_put(balance->b + 3, sbi_d_sub(sum.torque, felt.torque));
    balance->least[0] = SBI_COUPLING_LEAST * coupling->translation;
    balance->least[1] = SBI_COUPLING_LEAST * coupling->rotation;
    balance->in_balance[0] = sbi_d_norm(sum.force) + sbi_d_norm(felt.force);
    balance->in_balance[1] = sbi_d_norm(sum.torque) + sbi_d_norm(felt.torque);
    balance->off = 0;
    for (int i = 0; i < balance->size; i++) {
        double beyond = fabs(balance->b[i]) - balance->least[i / 3];
        if (!(beyond <= balance->off * balance->in_balance[i / 3]))
            balance->off = beyond / balance->in_balance[i / 3];
    }
}

/* Elimination with row exchanges; n: its size, known to the compiler. */
SB_INLINE void sbi_haptic_eliminate(sbi_haptic_factor *factor, int n)
{
    double(*h)[6] = factor->h;
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            best = fabs(h[i][k]) > fabs(h[best][k]) ? i : best;
        for (int j = 0; j < n && best != k; j++) {
            double swap = h[k][j];
            h[k][j] = h[best][j];
            h[best][j] = swap;
        }
        factor->rows[k] = best;
        factor->inverse[k] = 1 / h[k][k];
        for (int i = k + 1; i < n; i++) {
            h[i][k] *= factor->inverse[k];
            for (int j = k + 1; j < n; j++)
                h[i][j] -= h[i][k] * h[k][j];
        }
    }
}

/* The tangent where the balance was evaluated, eliminated. */
static void sbi_haptic_make_factor(sbi_haptic_factor *factor, const sbi_haptic_model *model,
                                   const sbi_haptic_coupling *coupling, const sbi_haptic_balance *balance)
{
    sbi_haptic_columns columns;
    memset(&columns, 0, sizeof columns);
    for (int c = 0; c < model->frame.count; c++)
        if (balance->touches[c].push > 0)
            sbi_haptic_columns_touch(&columns, balance->size, model->frame.clusters + c, balance->touches + c);
    factor->size = balance->size;
    for (int j = 0; j < balance->size; j++) {
        double column[6];
        sbi_d_put(column, columns.force[j]);
        sbi_d_put(column + 3, columns.torque[j]);
        column[j] += j < 3 ? coupling->translation : coupling->rotation;
        for (int i = 0; i < balance->size; i++)
            factor->h[i][j] = column[i];
    }
    if (factor->size == 6)
        sbi_haptic_eliminate(factor, 6);
    else
        sbi_haptic_eliminate(factor, 3);
}

/* b = h^-1 b */
SB_INLINE void sbi_haptic_factor_solve_size(const sbi_haptic_factor *factor, double *b, int n)
{
    for (int k = 0; k < n; k++) {
        double swap = b[k];
        b[k] = b[factor->rows[k]];
        b[factor->rows[k]] = swap;
    }
    for (int i = 1; i < n; i++)
        for (int j = 0; j < i; j++)
            b[i] -= factor->h[i][j] * b[j];
    for (int i = n; i-- > 0;) {
        for (int j = i + 1; j < n; j++)
            b[i] -= factor->h[i][j] * b[j];
        b[i] *= factor->inverse[i];
    }
}

static void sbi_haptic_factor_solve(const sbi_haptic_factor *factor, double *b)
{
    if (factor->size == 6)
        sbi_haptic_factor_solve_size(factor, b, 6);
    else
        sbi_haptic_factor_solve_size(factor, b, 3);
}

/* Moves the tool to where it balances. The factor of the last call serves while it divides the imbalance by ten. *found
 * is what the planes do at the end, or less than SBI_COUPLING_NEAR of the forces from it. */
static void sbi_haptic_balance_find(sbi_haptic_model *model, const sbi_haptic_coupling *coupling,
                                    const sbi_d_pose *hand, sbi_d_pose *tool, sbi_haptic_balance *found)
{
    sbi_haptic_factor *factor = &model->factor;
    double before = 0;
    int near_it = 0;
    if (!(coupling->rotation > 0))
        tool->rotation = hand->rotation;
    for (int iteration = 0; iteration < SBI_COUPLING_MOST && !near_it; iteration++) {
        sbi_haptic_balance_at(found, model, coupling, hand, tool);
        if (found->off <= SBI_COUPLING_CLOSE)
            return;
        if (factor->size != found->size || (iteration > 0 && !(found->off < SBI_COUPLING_SERVES * before)))
            sbi_haptic_make_factor(factor, model, coupling, found);
        near_it = iteration > 0 && found->off <= SBI_COUPLING_NEAR;
        before = found->off;
        sbi_haptic_factor_solve(factor, found->b);
        if (!sbi_d3_within(sbi_d_from(found->b), SBI_HAPTIC_LARGE)) { /* of forged frames: begins anew at the hand */
            *tool = *hand;
            factor->size = 0;
            break;
        }
        tool->position = sbi_d_add(tool->position, sbi_d_from(found->b));
        if (found->size == 6)
            tool->rotation = sbi_turn_further(tool->rotation, sbi_d_from(found->b + 3));
    }
    if (!near_it)
        found->tissue = sbi_haptic_model_at(model, tool, found->touches);
}

/* A hand that pulls with all that the coupling may: as far from the tool of the frame as does so. Farther away it would
 * drive the tool into planes as no step does, and what is off in their directions would count for many times the pull.
 */
static sbi_d_pose sbi_haptic_within_pull(const sbi_haptic_model *model, const sbi_haptic_coupling *coupling,
                                         const sbi_d_pose *hand)
{
    sbi_d_pose held = *hand;
    const sbi_d3 way = sbi_d_sub(hand->position, model->frame.pose.position);
    const double length = sbi_d_norm(way), pull = coupling->translation * length;
    if (model->frame.count > 0 && coupling->most > 0 && pull > coupling->most)
        held.position = sbi_d_madd(model->frame.pose.position, coupling->most / pull, way);
    return held;
}

SBI_API sbi_d_wrench sbi_haptic_model_feel(sbi_haptic_model *model, const sbi_haptic_coupling *coupling,
                                           const sbi_d_pose *given, sbi_d_pose *tool, double *stored)
{
    const sbi_d_pose within = sbi_haptic_within_pull(model, coupling, given), *hand = &within;
    sbi_haptic_balance found;
    sbi_d_wrench felt;
    *stored = 0;
    if (!(coupling->translation > 0)) {
        *tool = *hand;
        felt = sbi_haptic_model_at(model, tool, found.touches);
        sbi_haptic_keep(model, found.touches, stored);
        return felt;
    }
    sbi_haptic_balance_find(model, coupling, hand, tool, &found);
    sbi_haptic_keep(model, found.touches, stored);
    felt = sbi_haptic_coupling_wrench(coupling, hand, tool);
    *stored += sbi_d_dot(felt.force, felt.force) / (2 * coupling->translation);
    if (coupling->rotation > 0)
        *stored += sbi_d_dot(felt.torque, felt.torque) / (2 * coupling->rotation);
    else
        felt.torque = found.tissue.torque;
    return felt;
}
