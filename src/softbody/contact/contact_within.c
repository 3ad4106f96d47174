/* contact_within: whether a point is within an organ: how often a line from it along x leaves the organ, less how often
 * it comes in. Faces that share an edge see the same numbers there, so that no line slips through between two. */
#include "../body/body_private.h"
#include "contact_private.h"

/* What an edge adds to how often the triangle goes around the line, whose place is 0: half open, so that a corner on
 * the line counts for one of its edges. Source: Sunday 2001, winding number of a polygon. */
static int sbi_within_edge(sb_vec3 a, sb_vec3 b)
{
    sb_real left = a.y * b.z - b.y * a.z;
    if (a.z <= 0)
        return b.z > 0 && left > 0;
    return b.z <= 0 && left < 0 ? -1 : 0;
}

/* 1: the line from 0 along x goes out through the triangle; -1: in; 0: it does not meet it. */
static int sbi_within_crossing(sb_vec3 a, sb_vec3 b, sb_vec3 c)
{
    int turns = sbi_within_edge(a, b) + sbi_within_edge(b, c) + sbi_within_edge(c, a);
    sb_vec3 n;
    if (turns == 0)
        return 0;
    n = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a));
    return sb_v3_dot(n, a) * (sb_real)turns > 0 ? turns : 0;
}

static int sbi_within_face(const sb_contact *contact, int face, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way)
{
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[face]];
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    int sum = 0;
    for (int part = 0; part < sbi_closest_part_count(kind); part++) {
        sb_vec3 corners[3];
        for (int k = 0; k < 3; k++) {
            int node = nodes[sbi_closest_part_node(kind, part, k)];
            corners[k] = sb_v3_sub(way ? sb_v3_add(x[node], way[node]) : x[node], at);
        }
        sum += sbi_within_crossing(corners[0], corners[1], corners[2]);
    }
    return sum;
}

/* The sum over faces of an organ, or of all others. */
static int sbi_within_sum(sb_contact *contact, int organ, int others, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way)
{
    sb_vec3 end = {SB_REAL_MAX, at.y, at.z};
    int sum = 0, count = sbi_pairs_query_but(contact, others ? organ : -1, at, end, contact->scratch);
    for (int i = 0; i < count; i++)
        if ((contact->pairs.organs[contact->scratch[i]] != organ) == others)
            sum += sbi_within_face(contact, contact->scratch[i], at, x, way);
    return sum;
}

SBI_API int sbi_pairs_is_within(sb_contact *contact, int organ, sb_vec3 at, const sb_vec3 *x, const sb_vec3 *way)
{
    return sbi_within_sum(contact, organ, 0, at, x, way) > 0;
}

SBI_API int sbi_pairs_is_within_others(sb_contact *contact, int organ, sb_vec3 at, const sb_vec3 *x)
{
    return sbi_within_sum(contact, organ, 1, at, x, NULL) > 0;
}
