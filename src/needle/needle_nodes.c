/* needle_nodes: which nodes a rod has. In the tissue those of the remesher's path, outside enough for its bends: they
 * slide along with the needle, and are dropped where they come close to the sleeve or the skin, and made where it gets
 * empty. */
#include "needle_private.h"

#include <string.h>

/* Outside of the tissue edges are between these parts of edge_length: far enough apart that a node made by one rule is
 * not at once the other's. */
static double ndli_nodes_shortest(const ndl_needle *needle) { return 0.5 * needle->edge_length; }
static double ndli_nodes_longest(const ndl_needle *needle) { return 2 * needle->edge_length; }

static ndli_v3 ndli_nodes_tangent(const ndl_rod *rod, int i)
{
    ndli_v3 before = rod->tangent[sbi_max_int(i - 1, 0)], after = rod->tangent[sbi_min_int(i, rod->node_count - 2)];
    ndli_v3 sum = ndli_add(before, after);
    return ndli_scale(1 / ndli_norm(sum), sum);
}

/* The new list while it grows; the last place is for the entry or the tip. */
typedef struct ndli_places {
    ndli_v3 *x, *tangent;
    int count, capacity;
} ndli_places;

static void ndli_nodes_put(ndli_places *list, ndli_v3 x, ndli_v3 tangent)
{
    if (list->count < list->capacity) {
        list->x[list->count] = x;
        list->tangent[list->count++] = tangent;
    }
}

/* Puts x, and before it as many as are needed on the cubic from the last one. */
static void ndli_nodes_reach(ndli_places *list, ndli_v3 x, ndli_v3 tangent, double longest)
{
    ndli_v3 from = list->x[list->count - 1], start = list->tangent[list->count - 1], way = ndli_sub(x, from);
    double length = ndli_norm(way);
    int pieces = length > longest ? (int)(length / (0.5 * longest)) : 1;
    for (int k = 1; k < pieces && list->count < list->capacity - 1; k++) {
        double s = (double)k / pieces, a = length * s * (1 - s) * (1 - s), b = -length * s * s * (1 - s);
        ndli_v3 place = ndli_madd(from, s * s * (3 - 2 * s), way);
        place = ndli_madd(ndli_madd(place, a, start), b, tangent);
        ndli_nodes_put(list, place, ndli_scale(1 / length, way));
    }
    ndli_nodes_put(list, x, tangent);
}

/* Whether an old node outside is still of use between the last one kept and where the outside ends. */
static int ndli_nodes_keeps(const ndl_needle *needle, const ndli_places *list, int i, ndli_v3 end)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 t = ndli_nodes_tangent(rod, i);
    double shortest = ndli_nodes_shortest(needle);
    return ndli_dot(ndli_sub(end, rod->x[i]), t) >= shortest &&
           ndli_dot(ndli_sub(rod->x[i], list->x[list->count - 1]), t) >= shortest;
}

/* Sleeve and outside: to `end`, which is the entry or the tip and of the old rod's node `end_index`. */
static void ndli_nodes_outside(const ndl_needle *needle, ndli_places *list, ndli_v3 end, int end_index)
{
    const ndl_rod *rod = needle->rod;
    double longest = ndli_nodes_longest(needle);
    for (int i = 0; i < 2; i++)
        ndli_nodes_put(list, rod->x[i], rod->tangent[0]);
    for (int i = 2; i < end_index; i++)
        if (list->count < list->capacity - 1 && ndli_nodes_keeps(needle, list, i, end))
            ndli_nodes_reach(list, rod->x[i], ndli_nodes_tangent(rod, i), longest);
    ndli_nodes_reach(list, end, ndli_nodes_tangent(rod, end_index), longest);
}

/* How far the tip is beyond the entry; edges are no shorter than a part of the usual. */
static double ndli_nodes_tail(const ndl_needle *needle, ndli_v3 entry)
{
    const ndl_rod *rod = needle->rod;
    return ndli_dot(ndli_sub(rod->x[rod->node_count - 1], entry), rod->tangent[rod->node_count - 2]);
}
static double ndli_nodes_least_tail(const ndl_needle *needle) { return 0.02 * needle->site->mean_edge; }

/* The place on the rod that is nearest to x. */
static ndli_v3 ndli_nodes_on_rod(const ndl_rod *rod, ndli_v3 x)
{
    ndli_v3 best = rod->x[1];
    double least = ndli_norm(ndli_sub(x, best));
    for (int j = 1; j + 1 < rod->node_count; j++) {
        ndli_v3 edge = ndli_sub(rod->x[j + 1], rod->x[j]), place;
        double along = ndli_dot(ndli_sub(x, rod->x[j]), edge) / ndli_dot(edge, edge), far;
        place = ndli_madd(rod->x[j], fmin(fmax(along, 0), 1), edge);
        far = ndli_norm(ndli_sub(x, place));
        if (far < least) {
            least = far;
            best = place;
        }
    }
    return best;
}

/* ---- what belongs to coupled nodes ---- */

/* The old node that a new one is: that of the same tissue node, for a new tip the old tip, else -1. */
static int ndli_nodes_same(const ndl_needle *needle, int old_first, int old_count, int k, int is_tip)
{
    for (int i = 0; i < old_count; i++)
        if (needle->old_path[i] == needle->path[k])
            return old_first + i;
    return is_tip && old_count > 0 ? old_first + old_count - 1 : -1;
}

static int ndli_nodes_nearest(const ndl_needle *needle, int old_first, int old_count, ndli_v3 x)
{
    double nearest = 0;
    int best = -1;
    for (int i = old_first; i < old_first + old_count; i++) {
        ndli_v3 way = ndli_sub(needle->rod->x[i], x);
        double distance = ndli_dot(way, way);
        if (best < 0 || distance < nearest) {
            best = i;
            nearest = distance;
        }
    }
    return best;
}

/* Friction state and contact force of new node first + k. */
static void ndli_nodes_carry(ndl_needle *needle, int old_first, int old_count, int first, int k, int count)
{
    ndli_line *line = &needle->line;
    int same = ndli_nodes_same(needle, old_first, old_count, k, k == count - 1);
    int near = same >= 0 ? same : ndli_nodes_nearest(needle, old_first, old_count, needle->places[first + k]);
    line->state[first + k] = near >= 0 ? needle->old_state[near] : (unsigned char)NDL_STATIC;
    line->contact[first + k] = same >= 0 ? needle->old_contact[same] : ndli_v(0, 0, 0);
}

/* Whether node k of the path, which was its node `old`, is somewhere else in the material since the mesh has followed
 * the tip; new ones are. */
static int ndli_nodes_has_moved(const ndl_needle *needle, int old, int k)
{
    if (!needle->follows)
        return 0;
    return old < 0 || sb_v3_norm(sb_v3_sub(needle->old_X[old], needle->site->mesh->X[needle->path[k]])) > 0;
}

/* From x to a place on the needle; 0 where that is near: there the shaft is drawn to the node. In shares of an edge. */
static const double ndli_nodes_least_gap = 0.01;
static ndli_v3 ndli_nodes_gap_to(const ndl_needle *needle, ndli_v3 x, ndli_v3 place)
{
    ndli_v3 gap = ndli_sub(place, x);
    return ndli_norm(gap) > ndli_nodes_least_gap * needle->site->mean_edge ? gap : ndli_v(0, 0, 0);
}

/* How far node k of the path, which is at x, is from the rod's. An entry that the mesh has where the needle did not
 * come in, or nodes below it that could not be put where the shaft is, do not draw the shaft to them: on curved skin
 * that was up to hundreds of newtons. Later the tip's node comes to the tip. */
static ndli_v3 ndli_nodes_gap(const ndl_needle *needle, int old_first, int old_count, int k, int count, ndli_v3 x,
                              ndli_v3 before)
{
    int is_tip = k > 0 && k == count - 1, same = ndli_nodes_same(needle, old_first, old_count, k, 0);
    if (is_tip && needle->reaches)
        return ndli_v(0, 0, 0);
    if (is_tip && needle->sinks)
        return ndli_nodes_gap_to(needle, x, needle->landing);
    if (k == 0 && needle->enters)
        return ndli_nodes_gap_to(needle, x, ndli_nodes_on_rod(needle->rod, x));
    if (needle->sinks || (!is_tip && ndli_norm(before) > 0 && ndli_nodes_has_moved(needle, same - old_first, k)))
        return ndli_nodes_gap_to(needle, x, ndli_nodes_on_rod(needle->rod, x));
    return same < 0 ? ndli_v(0, 0, 0) : needle->old_gap[same];
}

/* ---- all nodes ---- */

/* 1 when a chain that comes from `before` turns at x by less than 60 degrees on its way to `next`. */
static int ndli_nodes_is_smooth(ndli_v3 before, ndli_v3 x, ndli_v3 next)
{
    ndli_v3 after = ndli_sub(next, x);
    return ndli_dot(before, after) > 0.5 * ndli_norm(before) * ndli_norm(after);
}

/* Writes the nodes of the remesher's path that the rod is on to needle->path; returns how many. Where tissue is
 * crushed, as ahead of a skin that does not break, an edge of the path may lie across the needle: the rod passes over
 * the nodes before it, but never over the tip. ahead: where the needle comes from. */
static int ndli_nodes_thread(ndl_needle *needle, const int *path, int count, ndli_v3 ahead)
{
    const sb_vec3 *x = needle->site->mesh->x;
    int *kept = needle->path, last = -1;
    for (int k = 0; k < count; k++) {
        while (last >= 0) {
            ndli_v3 here = ndli_from(x[kept[last]]);
            ndli_v3 before = last > 0 ? ndli_sub(here, ndli_from(x[kept[last - 1]])) : ahead;
            if (ndli_nodes_is_smooth(before, here, ndli_from(x[path[k]])))
                break;
            last--;
        }
        kept[++last] = path[k];
    }
    return last + 1;
}

NDLI_API int ndli_needle_is_threaded(const ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    if (needle->site->embeds)
        return 1;
    for (int i = needle->line.first; i <= ndli_line_foremost(&needle->line); i++) {
        ndli_v3 place = ndli_add(ndli_from(mesh->x[needle->path[i - needle->line.first]]), needle->gap[i]);
        ndli_v3 off = ndli_sub(needle->rod->x[i], place);
        if (ndli_dot(off, off) > 0)
            return 0;
    }
    return 1;
}

/* ---- of a needle that is held by rows: nodes in the tissue stay where they are on the rod ---- */

static int ndli_nodes_are(const ndl_rod *rod, const ndli_places *list)
{
    for (int i = 0; i < list->count && list->count == rod->node_count; i++) {
        ndli_v3 gap = ndli_sub(list->x[i], rod->x[i]);
        if (ndli_dot(gap, gap) > 0)
            return 0;
    }
    return list->count == rod->node_count;
}

/* Nodes from `from` on have numbers that are higher by `more`. */
static void ndli_nodes_shift(ndl_needle *needle, int from, int count, int more)
{
    ndli_line *line = &needle->line;
    size_t n = (size_t)count;
    memmove(line->state + from + more, line->state + from, n);
    memmove(line->contact + from + more, line->contact + from, n * sizeof *line->contact);
    memmove(needle->arc + from + more, needle->arc + from, n * sizeof *needle->arc);
    for (int i = 0; i < from + more; i++)
        line->state[i] = NDL_FREE;
}

static int ndli_nodes_renew_rows(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int count = line->count, end = count > 0 ? line->first : rod->node_count - 1, first, bad;
    ndli_places list = {needle->places, needle->place_tangents, 0, 0};
    list.capacity = rod->capacity - sbi_max_int(count - 1, 0);
    ndli_nodes_outside(needle, &list, rod->x[end], end);
    first = list.count - 1;
    list.capacity = rod->capacity;
    for (int i = end + 1; i < rod->node_count; i++)
        ndli_nodes_put(&list, rod->x[i], ndli_v(0, 0, 0));
    if (ndli_nodes_are(rod, &list))
        return -1;
    bad = ndli_rod_reparameterise(rod, list.x, list.count);
    if (bad >= 0)
        return bad;
    if (count > 0)
        ndli_nodes_shift(needle, end - 1, count + 1, first - end);
    line->first = count > 0 ? first : rod->node_count;
    return -1;
}

static int ndli_nodes_renew_path(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    const ndli_topology *mesh = needle->site->mesh;
    int old_first = line->first, old_count = line->count, count, first, bad, shallow;
    const int *path = ndl_remesh_nodes(needle->site->remesh, needle->index, &count);
    int end_index = count > 0 ? sbi_min_int(old_first, rod->node_count - 1) : rod->node_count - 1;
    ndli_places list = {needle->places, needle->place_tangents, 0, 0};
    ndli_v3 end = rod->x[rod->node_count - 1], entry_gap = ndli_v(0, 0, 0);
    if (count > rod->capacity - 4)
        return rod->capacity;
    memcpy(needle->old_path, needle->path, (size_t)old_count * sizeof(int));
    memcpy(needle->old_state, line->state, (size_t)rod->node_count);
    memcpy(needle->old_contact, line->contact, (size_t)rod->node_count * sizeof(ndli_v3));
    memcpy(needle->old_gap, needle->gap, (size_t)rod->node_count * sizeof(ndli_v3));
    shallow = count == 1;
    count = ndli_nodes_thread(needle, path, count, rod->tangent[end_index - 1]);
    path = needle->path;
    if (count > 0) {
        end = ndli_from(mesh->x[path[0]]);
        entry_gap = ndli_nodes_gap(needle, old_first, old_count, 0, count, end, entry_gap);
        end = ndli_add(end, entry_gap);
    }
    list.capacity = rod->capacity - sbi_max_int(count - 1, 0);
    ndli_nodes_outside(needle, &list, end, end_index);
    first = list.count - 1;
    list.capacity = rod->capacity;
    if (count > 0)
        needle->gap[first] = entry_gap;
    for (int k = 1; k < count; k++) {
        ndli_v3 x = ndli_from(mesh->x[path[k]]);
        needle->gap[first + k] = ndli_nodes_gap(needle, old_first, old_count, k, count, x, needle->gap[first + k - 1]);
        ndli_nodes_put(&list, ndli_add(x, needle->gap[first + k]), ndli_v(0, 0, 0));
    }
    needle->enters = needle->sinks = needle->reaches = needle->follows = 0;
    if (shallow && ndli_nodes_tail(needle, end) > ndli_nodes_least_tail(needle))
        ndli_nodes_put(&list, rod->x[rod->node_count - 1], ndli_v(0, 0, 0));
    for (int k = 0; k < count; k++)
        ndli_nodes_carry(needle, old_first, old_count, first, k, count);
    bad = ndli_rod_reparameterise(rod, list.x, list.count);
    if (bad >= 0)
        return bad;
    for (int i = 0; i < rod->node_count; i++)
        if (count == 0 || i < first || i >= first + count)
            line->state[i] = NDL_FREE;
    line->first = count > 0 ? first : rod->node_count;
    line->count = count;
    needle->shallow = shallow;
    return -1;
}

NDLI_API int ndli_needle_renew_nodes(ndl_needle *needle)
{
    return needle->site->embeds ? ndli_nodes_renew_rows(needle) : ndli_nodes_renew_path(needle);
}
