/* contact_within: whether a point is within an organ: how often a line from it leaves the organ, less how often it
 * comes in. Faces that share an edge see the same numbers there, so that no line slips through between two. */
#include "../body/body_private.h"
#include "contact_private.h"

enum { SBI_WITHIN_LINES = 6 }; /* along the axes: x, y, z and back */

/* A line from a point, and what it has met. */
typedef struct sbi_within_line {
    int number; /* below SBI_WITHIN_LINES */
    sb_vec3 at;
    const sb_vec3 *x, *way; /* nodes are at x + way (way NULL: at x) */
    int sum;                /* how often it leaves, less how often it comes in */
    int face;               /* the nearest one through which it leaves, and how far off that is (m); -1: none */
    sb_real distance;
} sbi_within_line;

static sbi_within_line sbi_within_start(int number, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way)
{
    sbi_within_line line;
    line.number = number;
    line.at = at;
    line.x = x;
    line.way = way;
    line.sum = 0;
    line.face = -1;
    line.distance = SB_REAL_MAX;
    return line;
}

/* Turns space so that a line runs along x. */
static sb_vec3 sbi_within_turn(int number, sb_vec3 v)
{
    if (number % 3 == 1)
        v = sb_v3(v.y, v.z, v.x);
    else if (number % 3 == 2)
        v = sb_v3(v.z, v.x, v.y);
    return number < 3 ? v : sb_v3(-v.x, -v.y, v.z);
}

/* What an edge adds to how often the triangle goes around the line, whose place is 0: half open, so that a corner on
 * the line counts for one of its edges. Source: Sunday 2001, winding number of a polygon. */
static int sbi_within_edge(sb_vec3 a, sb_vec3 b)
{
    sb_real left = a.y * b.z - b.y * a.z;
    if (a.z <= 0)
        return b.z > 0 && left > 0;
    return b.z <= 0 && left < 0 ? -1 : 0;
}

/* A triangle, seen from the line's start: the line goes out through it, or in, or does not meet it. */
static void sbi_within_cross(sbi_within_line *line, int face, const sb_vec3 corners[3])
{
    const sb_vec3 a = corners[0], b = corners[1], c = corners[2];
    int turns = sbi_within_edge(a, b) + sbi_within_edge(b, c) + sbi_within_edge(c, a);
    sb_real ahead, far, distance;
    sb_vec3 n;
    if (turns == 0)
        return;
    n = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a));
    ahead = sb_v3_dot(n, a);
    if (!(ahead * (sb_real)turns > 0))
        return;
    line->sum += turns;
    if (turns < 0 || !(n.x > 0))
        return;
    far = sb_max(a.x, sb_max(b.x, c.x)); /* where rounding would take it farther */
    distance = ahead < n.x * far ? ahead / n.x : far;
    if (distance >= line->distance)
        return;
    line->distance = distance;
    line->face = face;
}

static void sbi_within_face(const sb_contact *contact, int face, sbi_within_line *line)
{
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[face]];
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    for (int part = 0; part < sbi_closest_part_count(kind); part++) {
        sb_vec3 corners[3];
        for (int k = 0; k < 3; k++) {
            int node = nodes[sbi_closest_part_node(kind, part, k)];
            sb_vec3 to = sb_v3_sub(line->way ? sb_v3_add(line->x[node], line->way[node]) : line->x[node], line->at);
            corners[k] = sbi_within_turn(line->number, to);
        }
        sbi_within_cross(line, face, corners);
    }
}

/* ---- organs ---- */

/* The sum over faces of an organ, or of all others. */
static int sbi_within_sum(sb_contact *contact, int organ, int others, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way)
{
    sbi_within_line line = sbi_within_start(0, at, x, way);
    sb_vec3 end = {SB_REAL_MAX, at.y, at.z};
    int count = sbi_pairs_query_but(contact, others ? organ : -1, at, end, contact->scratch);
    for (int i = 0; i < count; i++)
        if ((contact->pairs.organs[contact->scratch[i]] != organ) == others)
            sbi_within_face(contact, contact->scratch[i], &line);
    return line.sum;
}

SBI_API int sbi_pairs_is_within(sb_contact *contact, int organ, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way)
{
    return sbi_within_sum(contact, organ, 0, at, x, way) > 0;
}

SBI_API int sbi_pairs_is_within_others(sb_contact *contact, int organ, sb_vec3 at, const sb_vec3 *x)
{
    return sbi_within_sum(contact, organ, 1, at, x, NULL) > 0;
}

/* ---- tools ---- */

/* The faces that a line may meet, in contact->scratch. */
static int sbi_within_query(sb_contact *contact, const sbi_within_line *line)
{
    sb_vec3 low = line->at, high = line->at;
    sb_real *ends[SBI_WITHIN_LINES] = {&high.x, &high.y, &high.z, &low.x, &low.y, &low.z};
    *ends[line->number] = line->number < 3 ? SB_REAL_MAX : -SB_REAL_MAX;
    return sbi_contact_faces_query(contact->faces, low, high, contact->scratch, contact->faces->face_room);
}

SBI_API int sbi_contact_surrounds(sb_contact *contact, sb_vec3 at, sb_real *distance)
{
    int face = -1;
    *distance = SB_REAL_MAX;
    for (int number = 0; number < SBI_WITHIN_LINES; number++) {
        sbi_within_line line = sbi_within_start(number, at, contact->x, NULL);
        int count = sbi_within_query(contact, &line);
        for (int i = 0; i < count; i++)
            sbi_within_face(contact, contact->scratch[i], &line);
        if (line.sum <= 0)
            return -1;
        if (line.distance < *distance) {
            *distance = line.distance;
            face = line.face;
        }
    }
    return face;
}

SBI_API int sbi_contact_surrounds_tool(sb_contact *contact, const sbi_tool *shape, const sb_vec3 *chain,
                                       const sb_pose *pose, sb_real *distance)
{
    /* one: a skeleton is in one piece, and deep enough in the tool for samples to see it cross a face */
    sb_vec3 point = sb_v3(0, 0, 0);
    *distance = SB_REAL_MAX;
    if (sbi_tool_skeleton(shape, chain, &point, 1) == 0)
        return -1;
    return sbi_contact_surrounds(contact, sbi_pose_to_space(pose, point), distance);
}
