/* contact_sweep: how far tools go in a step, and whether anything may have passed through one.
 *
 * A tool moves freely while all samples are clear of it (conservative advancement), and by half of its inner radius
 * from there on. After the solve no sample may be, or have been on its straight way against the tool, deeper than 0.6
 * of it, less what a tool that turns or bends makes of straight ways: a face has a sample within 0.36 radii of any of
 * its points, also of the one where a skeleton would go through it, and has more of them for this where it is
 * stretched. Faces are looked for anew then: tissue may go where its velocity did not point to.
 *
 * A step that fails this is done again with less motion of tools, then with none. Tissue that is squeezed between tools
 * without room for it would fail even so: a tool that lies deep in it goes no deeper, and where that was too late those
 * that it presses on give way along its force. Tissue that flies so fast that it would be through a tool in the
 * shortest part of a step is stopped there with its organ, as by an impact without rebound. */
#include <math.h>
#include <string.h>

#include "../body/body_private.h"
#include "contact_private.h"

#define SBI_SWEEP_CLEAR ((sb_real)0.05)   /* of the radius: nearer than this a tool touches */
#define SBI_SWEEP_ADVANCE ((sb_real)0.5)  /* of the inner radius, in a step that touches */
#define SBI_SWEEP_DEEPEST ((sb_real)0.6)  /* of it, in a step */
#define SBI_SWEEP_FARTHEST ((sb_real)0.8) /* of it: on a shorter way none goes deeper than its ends unseen */
#define SBI_SWEEP_SINKS (16 * SB_EPSILON) /* of places in a tool: what is deeper by less is by rounding */
#define SBI_SWEEP_TURNED ((sb_real)0.65)  /* cosine; a skeleton that goes through a face turns normals more */
#define SBI_SWEEP_FULL ((sb_real)0.3)     /* of it: a tool so deep goes no deeper */
#define SBI_SWEEP_GIVE ((sb_real)0.125)   /* of it, by which a tool gives way, times how often it had to */
enum {
    SBI_SWEEP_HOPS = 64,
    SBI_SWEEP_STAYS = 5,
    SBI_SWEEP_GIVES = 2
}; /* tries from which on tools go nowhere, and in
    * how many after it they give way */

/* ---- faces near a tool ---- */

/* Box of a tool on the way between two poses, grown by its radius and by what the straight line between the two misses
 * of a turn. */
static void sbi_sweep_box(const sbi_tool *shape, const sb_vec3 *chain0, const sb_pose *from, const sb_vec3 *chain1,
                          const sb_pose *to, sb_vec3 *low, sb_vec3 *high)
{
    sb_vec3 low1, high1, sides;
    sb_real turn = sb_v3_norm(sbi_pose_rotation(from, to)), grow;
    sbi_tool_bounds(shape, chain0, from, low, high);
    sbi_tool_bounds(shape, chain1, to, &low1, &high1);
    if (sbi_tool_get_shape(shape) == SB_TOOL_PLANE)
        return;
    sides = sb_v3(sb_max(high->x - low->x, high1.x - low1.x), sb_max(high->y - low->y, high1.y - low1.y),
                  sb_max(high->z - low->z, high1.z - low1.z));
    grow = sbi_tool_radius(shape) + sb_v3_norm(sides) * sb_min((sb_real)1, turn * turn / 8);
    *low = sb_v3(sb_min(low->x, low1.x) - grow, sb_min(low->y, low1.y) - grow, sb_min(low->z, low1.z) - grow);
    *high = sb_v3(sb_max(high->x, high1.x) + grow, sb_max(high->y, high1.y) + grow, sb_max(high->z, high1.z) + grow);
}

static int *sbi_sweep_near(const sb_contact *contact, int tool)
{
    return contact->near + (size_t)tool * (size_t)contact->faces->face_room;
}

/* around: how much farther (m) it may go. */
static void sbi_sweep_find_faces(sb_contact *contact, int number, const sb_pose *to, const sb_vec3 *chain,
                                 sb_real around)
{
    sbi_contact_tool *tool = contact->tools + number;
    sb_vec3 low, high;
    sbi_sweep_box(tool->shape, tool->chain_reached, &tool->reached, chain, to, &low, &high);
    if (around < SB_REAL_MAX / 4) { /* that of a plane has no bounds */
        low = sb_v3_sub(low, sb_v3(around, around, around));
        high = sb_v3_add(high, sb_v3(around, around, around));
    }
    tool->face_count =
        sbi_contact_faces_query(contact->faces, low, high, sbi_sweep_near(contact, number), contact->faces->face_room);
}

/* ---- the way ---- */

/* chain = a share of the way between two. */
static void sbi_sweep_bend(const sbi_contact_tool *tool, sb_real share, const sb_vec3 *to, sb_vec3 *chain)
{
    for (int i = 0; i < sbi_tool_point_count(tool->shape); i++) {
        sb_vec3 way = sb_v3_sub(to[i], tool->chain_reached[i]);
        chain[i] = share == 1 ? to[i] : sb_v3_madd(tool->chain_reached[i], share, way);
    }
}

/* Least gap of the faces near a tool at a pose, where the body is. */
static sb_real sbi_sweep_gap(sb_contact *contact, const sbi_tool *shape, const sb_vec3 *chain, const sb_pose *pose,
                             const int *near, int count, int *deepest)
{
    const sbi_contact_faces *faces = contact->faces;
    const sb_vec3 *x = contact->x, up = {0, 0, 1};
    sb_real least = SB_REAL_MAX, radius = sbi_tool_radius(shape);
    for (int f = 0; f < count; f++) {
        int face = near[f], parts = sbi_contact_face_parts(faces, face, radius);
        const sbi_contact_rule *rule = sbi_contact_face_rule(faces, face, parts);
        if (sbi_contact_clearance_at(faces, face, x, shape, chain, pose) > least)
            continue;
        for (int s = 0; s < rule->count; s++) {
            sb_vec3 at = sbi_contact_mean(rule->weights + (size_t)s * faces->sizes[face],
                                          sbi_contact_face_nodes(faces, face), faces->sizes[face], x);
            sb_vec3 normal;
            sb_real gap = sbi_tool_distance(shape, chain, sbi_pose_to_tool(pose, at), up, &normal);
            if (gap < least && deepest)
                *deepest = face;
            least = sb_min(least, gap);
        }
    }
    return least;
}

/* What is left of tools' ways when a step was refused. */
static sb_real sbi_sweep_less(const sbi_touch_step *step)
{
    sb_real less = 1;
    for (int i = 0; i < step->tries; i++)
        less *= (sb_real)0.5;
    return step->tries >= SBI_SWEEP_STAYS ? 0 : less;
}

/* How far a tool may go into the body in a step (m): less the deeper it lies, unless it is on its way out. */
static sb_real sbi_sweep_reach(sb_contact *contact, int number, sb_real way)
{
    sbi_contact_tool *tool = contact->tools + number;
    sb_real inner = sbi_tool_inner_radius(tool->shape), reach = SBI_SWEEP_ADVANCE * inner, depth = 0, share;
    for (int e = 0; e < contact->entry_count; e++)
        if (contact->entries[e].tool == number)
            depth = sb_max(depth, -contact->entries[e].gap);
    if (!(depth > 0) || !(way > 0))
        return reach;
    share = sb_min((sb_real)1, reach / way);
    tool->next = sbi_pose_between(&tool->reached, &tool->wanted, share);
    sbi_sweep_bend(tool, share, tool->chain_wanted, tool->chain_next);
    sbi_sweep_find_faces(contact, number, &tool->next, tool->chain_next, 0);
    if (!(sbi_sweep_gap(contact, tool->shape, tool->chain_next, &tool->next, sbi_sweep_near(contact, number),
                        tool->face_count, NULL) < -depth))
        return reach;
    return reach * sb_max((sb_real)0, 1 - depth / (SBI_SWEEP_FULL * inner));
}

/* Share of the way (m) to where it is sent on which a tool is clear of the body. */
static sb_real sbi_sweep_free(sb_contact *contact, int number, sb_real way)
{
    sbi_contact_tool *tool = contact->tools + number;
    sb_real clear = SBI_SWEEP_CLEAR * sbi_tool_radius(tool->shape), share = 0;
    sbi_sweep_find_faces(contact, number, &tool->wanted, tool->chain_wanted, 0);
    for (int i = 0; i < SBI_SWEEP_HOPS && share < 1; i++) {
        sb_pose at = sbi_pose_between(&tool->reached, &tool->wanted, share);
        sb_real gap;
        sbi_sweep_bend(tool, share, tool->chain_wanted, tool->chain_next);
        gap = sbi_sweep_gap(contact, tool->shape, tool->chain_next, &at, sbi_sweep_near(contact, number),
                            tool->face_count, NULL);
        if (!(gap > clear))
            break;
        share = gap < way ? share + gap / way : 1; /* without faces the gap has no bound */
    }
    return sb_min((sb_real)1, share);
}

/* Share of the way to where it is sent that a tool may go: free up to the body, which is the share *clear unless the
 * way is short, and some into it. */
static sb_real sbi_sweep_share(sb_contact *contact, int number, const sbi_touch_step *step, sb_real *clear)
{
    sbi_contact_tool *tool = contact->tools + number;
    sb_real less = sbi_sweep_less(step), part = step->part, reach;
    sb_real way = sbi_tool_motion(tool->shape, tool->chain_reached, &tool->reached, tool->chain_wanted, &tool->wanted);
    *clear = 0;
    if (less == 0 || step->dt == 0)
        return less;
    reach = sbi_sweep_reach(contact, number, way);
    if (way <= reach)
        return less * part;
    *clear = sbi_sweep_free(contact, number, way);
    return less * sb_min(part, *clear + reach / way);
}

/* A tool that the body pressed on goes along with it; in the last try it stays. */
static sb_pose sbi_sweep_give_way(const sbi_contact_tool *tool, int times)
{
    sb_pose pose = tool->reached;
    sb_real size = times > SBI_SWEEP_GIVES ? 0 : sb_v3_norm(tool->force),
            way = SBI_SWEEP_GIVE * (sb_real)times * sbi_tool_inner_radius(tool->shape);
    if (size > 0 && sbi_tool_get_shape(tool->shape) != SB_TOOL_PLANE)
        pose.position = sb_v3_madd(pose.position, -way / size, tool->force);
    return pose;
}

/* A tool on a spring begins where its way is no longer clear, and may go from there as far as a rigid one goes. */
static void sbi_sweep_hung(sbi_contact_tool *tool, const sbi_touch_step *step, sb_real clear)
{
    sbi_contact_spring *spring = &tool->spring;
    sb_real less = sbi_sweep_less(step), part = step->part;
    sb_real most =
        less * SBI_SWEEP_ADVANCE * sbi_tool_inner_radius(tool->shape); /* not `reach`: it may be pushed out */
    spring->hand_next = sbi_pose_between(&spring->hand, &tool->wanted, step->factor * part);
    spring->hand_balance = sbi_pose_between(&spring->hand, &spring->hand_next, step->level);
    spring->level = step->level;
    spring->limit = most;
    spring->centre =
        clear > 0 ? sbi_pose_between(&tool->reached, &tool->wanted, less * sb_min(part, clear)) : tool->from;
    if (step->tries > SBI_SWEEP_STAYS)
        spring->centre = tool->next;
    if (!(spring->turning > 0)) { /* it turns by itself, and what is left is for its way */
        sb_pose turned = spring->centre;
        sb_real turn, share;
        turned.rotation = spring->hand_balance.rotation;
        turn = sbi_tool_motion(tool->shape, tool->chain_reached, &spring->centre, tool->chain_reached, &turned);
        share = turn > most / 2 ? most / 2 / turn : 1;
        spring->centre = sbi_pose_between(&spring->centre, &turned, share);
        spring->limit = most - share * turn;
    }
    tool->next = tool->balance = spring->centre;
}

static void sbi_sweep_tool(sb_contact *contact, int number, const sbi_touch_step *step)
{
    sbi_contact_tool *tool = contact->tools + number;
    sb_real clear, share = sbi_sweep_share(contact, number, step, &clear) * step->factor, around = 0;
    tool->from = step->stage > 0 ? tool->stage : tool->reached;
    tool->next = sbi_pose_between(&tool->reached, &tool->wanted, share);
    if (step->tries > SBI_SWEEP_STAYS)
        tool->next = sbi_sweep_give_way(tool, step->tries - SBI_SWEEP_STAYS);
    tool->balance = sbi_pose_between(&tool->reached, &tool->next, step->level);
    if (sbi_contact_is_hung(tool)) {
        sbi_sweep_hung(tool, step, clear);
        around = tool->spring.limit;
    }
    sbi_sweep_bend(tool, share, tool->chain_wanted, tool->chain_next);
    sbi_sweep_bend(tool, step->level, tool->chain_next, tool->chain_balance);
    tool->way = around + sbi_tool_motion(tool->shape, tool->chain_reached, &tool->from, tool->chain_next, &tool->next);
    sbi_sweep_find_faces(contact, number, &tool->next, tool->chain_next, around);
}

/* Places at the start of the step. */
static void sbi_sweep_find_places(sb_contact *contact, const sbi_touch_step *step)
{
    const sb_vec3 *rest = sbi_contact_points_at_rest(contact), *start;
    contact->x = sbi_contact_points_now(contact);
    contact->is_static = !(step->dt > 0);
    contact->level = step->level;
    if (!contact->is_static)
        return;
    start = sbi_contact_at_points(contact, step->start, contact->places);
    for (int i = 0; i < sbi_contact_point_count(contact); i++)
        contact->places[i] = sb_v3_add(rest[i], start[i]);
    contact->x = contact->places;
}

/* Tools inside the body: nothing that they do brings them there, but the body may be put over them. */
static int sbi_sweep_count_inside(sb_contact *contact)
{
    int count = 0;
    for (int i = 0; i < contact->max_tools; i++) {
        const sbi_contact_tool *tool = contact->tools + i;
        sb_real distance;
        count += tool->shape &&
                 sbi_contact_surrounds_tool(contact, tool->shape, tool->chain_reached, &tool->reached, &distance) >= 0;
    }
    return count;
}

/* A tool near faces that a static increment would take farther than by half of its inner radius; -1: none. */
static int sbi_sweep_overreaches(const sb_contact *contact)
{
    for (int i = 0; contact->is_static && i < contact->max_tools; i++) {
        const sbi_contact_tool *tool = contact->tools + i;
        if (tool->shape && !sbi_contact_is_hung(tool) && tool->face_count > 0 &&
            tool->way > SBI_SWEEP_ADVANCE * sbi_tool_inner_radius(tool->shape))
            return i;
    }
    return -1;
}

SBI_API sb_result sbi_contact_sweep(sb_contact *contact, const sbi_touch_step *step, sb_error *error)
{
    int far;
    sbi_sweep_find_places(contact, step);
    sbi_contact_faces_refit(contact->faces, contact->x, step->velocity, step->dt);
    contact->step_info.inside = sbi_sweep_count_inside(contact);
    for (int i = 0; i < contact->max_tools; i++)
        if (contact->tools[i].shape)
            sbi_sweep_tool(contact, i, step);
    far = sbi_sweep_overreaches(contact);
    if (far >= 0)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "tool %d goes too far in one increment: take more load_steps",
                        far);
    return SB_OK;
}

/* ---- afterwards ---- */

/* Where a tool comes from; what turning moves against it is none of a sphere's. */
static sb_pose sbi_sweep_start(const sbi_contact_tool *tool)
{
    sb_pose start = tool->reached;
    if (sbi_tool_get_shape(tool->shape) == SB_TOOL_SPHERE)
        start.rotation = tool->balance.rotation;
    return start;
}

/* 1 when a sample on the straight way from x0 to x1, both in the tool's frame at the end, comes as deep into the tool.
 */
static int sbi_sweep_way_meets(const sbi_contact_tool *tool, sb_vec3 x0, sb_vec3 x1, sb_real depth)
{
    const sb_vec3 up = {0, 0, 1};
    sb_vec3 way = sb_v3_sub(x1, x0), normal;
    sb_real length = sb_v3_norm(way), done = 0;
    for (int i = 0; done < length; i++) {
        sb_vec3 at = sb_v3_madd(x0, done / length, way);
        sb_real left = sbi_tool_distance(tool->shape, tool->chain_balance, at, up, &normal) + depth;
        if (!(left > 0) || i == SBI_SWEEP_HOPS)
            return 1;
        done += sb_max(left, SBI_SWEEP_CLEAR * sbi_tool_inner_radius(tool->shape));
    }
    return !(sbi_tool_distance(tool->shape, tool->chain_balance, x1, up, &normal) > -depth);
}

/* How far (m) from a straight line samples and skeleton go in the tool's frame: x'' of a way seen from a tool that
 * turns by a is at most 3 a^2 times how far off it is, and 2 a times the way. */
static sb_real sbi_sweep_bow(const sbi_contact_tool *tool, const sb_pose *from, sb_vec3 start, sb_vec3 end)
{
    sb_real turn = sb_v3_norm(sbi_pose_rotation(from, &tool->balance)), bend = 0;
    sb_real far = sb_max(sb_v3_norm(start), sb_v3_norm(end));
    for (int i = 0; i < sbi_tool_point_count(tool->shape); i++)
        bend = sb_max(bend, sb_v3_norm(sb_v3_sub(tool->chain_balance[i], tool->chain_reached[i])));
    return bend + turn * (3 * turn * far + 2 * sb_v3_norm(sb_v3_sub(end, start))) / 8;
}

/* 1 when a sample that went from x0 to x1 is where the skeleton may have crossed its face. */
static int sbi_sweep_is_crossing(const sbi_contact_tool *tool, sb_vec3 x0, sb_vec3 x1)
{
    const sb_vec3 up = {0, 0, 1};
    const sb_pose from = sbi_sweep_start(tool);
    sb_vec3 normal, turned, start = sbi_pose_to_tool(&from, x0), end = sbi_pose_to_tool(&tool->balance, x1);
    sb_real inner = sbi_tool_inner_radius(tool->shape), deepest = SBI_SWEEP_DEEPEST * inner, before, after;
    if (!(sb_v3_norm(sb_v3_sub(end, start)) < SBI_SWEEP_FARTHEST * inner) &&
        sbi_sweep_way_meets(tool, start, end, sb_max((sb_real)0, deepest - sbi_sweep_bow(tool, &from, start, end))))
        return 1;
    before = sbi_tool_distance(tool->shape, tool->chain_reached, start, up, &normal);
    after = sbi_tool_distance(tool->shape, tool->chain_balance, end, up, &turned);
    if (!(before > -deepest) || !(after > -deepest)) /* a body that was put deep into a tool may come out */
        return !(after > -deepest) && after < before - SBI_SWEEP_SINKS * (inner + sb_v3_norm(end));
    return sb_v3_dot(normal, turned) < SBI_SWEEP_TURNED && sbi_sweep_way_meets(tool, start, end, deepest);
}

/* A face on its way against a tool. */
typedef struct sbi_sweep_face {
    int number, count;
    const int *nodes;
    const sbi_contact_rule *rule;
    sb_vec3 starts[SB_MAX_FACE_NODES], ends[SB_MAX_FACE_NODES]; /* m, in space */
} sbi_sweep_face;

/* With samples as close as tools need them, where the face is stretched too. */
static void sbi_sweep_take_face(const sb_contact *contact, const sbi_contact_tool *tool, int number,
                                sbi_sweep_face *face)
{
    const sbi_contact_faces *faces = contact->faces;
    sb_real radius = sbi_tool_radius(tool->shape);
    int parts;
    face->number = number;
    face->count = faces->sizes[number];
    face->nodes = sbi_contact_face_nodes(faces, number);
    for (int a = 0; a < face->count; a++) {
        face->starts[a] = contact->x[face->nodes[a]];
        face->ends[a] = sb_v3_add(face->starts[a], contact->moved[face->nodes[a]]);
    }
    parts = sbi_max_int(sbi_contact_stretched_parts(faces, number, face->starts, radius),
                        sbi_contact_stretched_parts(faces, number, face->ends, radius));
    face->rule = sbi_contact_face_rule(faces, number, parts);
}

/* 1 when no sample of a face can be crossing: none comes deep enough, nor goes far enough or comes near enough. */
static int sbi_sweep_face_is_clear(const sb_contact *contact, const sbi_contact_tool *tool, const sbi_sweep_face *face)
{
    const sb_pose from = sbi_sweep_start(tool);
    sb_real square = 0, way, gap, inner = sbi_tool_inner_radius(tool->shape);
    for (int a = 0; a < face->count; a++) {
        sb_vec3 against =
            sb_v3_sub(sbi_pose_to_tool(&tool->balance, face->ends[a]), sbi_pose_to_tool(&from, face->starts[a]));
        square += sb_v3_dot(against, against);
    }
    way = face->rule->spread * sb_sqrt(square);
    gap = sbi_contact_clearance(contact->faces, face->number, face->ends, tool->shape, tool->chain_balance,
                                &tool->balance);
    return gap - way > -SBI_SWEEP_DEEPEST * inner && (way < SBI_SWEEP_FARTHEST * inner || gap > way);
}

static int sbi_sweep_face_is_safe(const sb_contact *contact, const sbi_contact_tool *tool, int number)
{
    sbi_sweep_face face;
    sbi_sweep_take_face(contact, tool, number, &face);
    if (sbi_sweep_face_is_clear(contact, tool, &face))
        return 1;
    for (int s = 0; s < face.rule->count; s++) {
        const sb_real *weights = face.rule->weights + (size_t)s * (size_t)face.count;
        sb_vec3 x0 = sb_v3(0, 0, 0), x1 = x0;
        for (int a = 0; a < face.count; a++) {
            x0 = sb_v3_madd(x0, weights[a], face.starts[a]);
            x1 = sb_v3_madd(x1, weights[a], face.ends[a]);
        }
        if (sbi_sweep_is_crossing(tool, x0, x1))
            return 0;
    }
    return 1;
}

/* Faces near tools are those on their ways to displacements u [rows of faces' points]. */
static void sbi_sweep_look(sb_contact *contact, const sb_vec3 *of_nodes)
{
    const sb_vec3 *x = sbi_contact_points_now(contact), *rest = sbi_contact_points_at_rest(contact), *u;
    u = sbi_contact_at_points(contact, of_nodes, contact->skin.moved);
    for (int i = 0; i < sbi_contact_point_count(contact); i++)
        contact->moved[i] = sb_v3_sub(sb_v3_add(rest[i], u[i]), x[i]);
    sbi_contact_faces_refit(contact->faces, x, contact->moved, 1);
    for (int i = 0; i < contact->max_tools; i++)
        if (contact->tools[i].shape)
            sbi_sweep_find_faces(contact, i, &contact->tools[i].next, contact->tools[i].chain_next, 0);
}

/* The first of a tool's faces from place f on that is not safe; face_count: none. */
static int sbi_sweep_next_unsafe(sb_contact *contact, int number, int f)
{
    const sbi_contact_tool *tool = contact->tools + number;
    if (!tool->shape || sbi_tool_get_shape(tool->shape) == SB_TOOL_PLANE)
        return tool->face_count;
    while (f < tool->face_count && sbi_sweep_face_is_safe(contact, tool, sbi_sweep_near(contact, number)[f]))
        f++;
    return f;
}

SBI_API int sbi_contact_is_safe(sb_contact *contact, const sb_vec3 *of_nodes)
{
    sbi_sweep_look(contact, of_nodes);
    for (int i = 0; i < contact->max_tools; i++)
        if (sbi_sweep_next_unsafe(contact, i, 0) < contact->tools[i].face_count)
            return 0;
    return 1;
}

/* ---- a last resort ---- */

/* Nodes of an organ, -1: of all, stay where the step began, but where supports move them. */
static void sbi_sweep_stop_organ(const sb_contact *contact, int organ, sb_vec3 *u)
{
    const sb_body *body = contact->body;
    for (int i = 0; i < body->domain.node_count; i++)
        if (organ < 0 || body->node_component[i] == organ)
            u[i] = sbi_body_pick_axes(body->fixed[i], u[i], body->start[i]);
}

/* Whole organs, since what goes on would stretch what stops; constraints tie them to each other. */
SBI_API void sbi_contact_stop(sb_contact *contact, sb_vec3 *u)
{
    const sb_body *body = contact->body;
    contact->stopped = 1;
    sbi_sweep_look(contact, u);
    for (int t = 0; t < contact->max_tools; t++) {
        int count = contact->tools[t].face_count, stopped = -1;
        for (int f = sbi_sweep_next_unsafe(contact, t, 0); f < count; f = sbi_sweep_next_unsafe(contact, t, f + 1)) {
            int face = sbi_sweep_near(contact, t)[f], node = sbi_contact_face_nodes(contact->faces, face)[0];
            int organ =
                body->node_component[contact->skin.source ? sbi_contact_skin_row(&contact->skin, node).nodes[0] : node];
            if (organ != stopped || f == 0)
                sbi_sweep_stop_organ(contact, body->elimination ? -1 : organ, u);
            stopped = organ;
        }
    }
}

SBI_API void sbi_contact_brake_stopped(const sb_contact *contact, const sb_vec3 *u, sb_vec3 *v)
{
    const sb_body *body = contact->body;
    for (int i = 0; contact->stopped && i < body->domain.node_count; i++) {
        sb_vec3 way = sb_v3_sub(u[i], body->start[i]);
        if (!(sb_v3_dot(way, way) > 0))
            v[i] = sbi_body_pick_axes(body->fixed[i], v[i], sb_v3(0, 0, 0));
    }
}

SBI_API sb_real sbi_contact_depth(sb_contact *contact, const sbi_tool *shape, const sb_vec3 *chain, const sb_pose *pose,
                                  int *element)
{
    sb_vec3 low, high;
    int *near = contact->scratch, count, face = -1;
    sb_real gap;
    contact->x = sbi_contact_points_now(contact);
    sbi_contact_faces_refit(contact->faces, contact->x, NULL, 0);
    sbi_tool_bounds(shape, chain, pose, &low, &high);
    count = sbi_contact_faces_query(contact->faces, low, high, near, contact->faces->face_room);
    gap = sbi_sweep_gap(contact, shape, chain, pose, near, count, &face);
    *element = face >= 0 ? contact->faces->elements[face] : -1;
    return gap < 0 ? -gap : 0;
}
