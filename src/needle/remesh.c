/* remesh: candidates, their comparison, the stack, smoothing, release.
 *
 * Candidates are tried on a copy of the tets about the tip, the patch, so that nothing needs to be taken back; only the
 * winner is done to the mesh. Two candidates are compared by the qualities they take away and bring: with D and C the
 * multisets a candidate removes and creates, the mesh after A is lexicographically better than after B exactly when
 * C_A + D_B is better than C_B + D_A, since all else is common to both. That is the thesis' comparison over T', the
 * union of what any candidate changes, without that union. */
#include "remesh_private.h"

#include "../softbody/body/body_guest.h"

#include <limits.h>
#include <string.h>

enum { NDLI_VIRTUAL = -1 /* the node to be made, in candidates */ };
enum { NDLI_IN_PATCH = 128 /* mark of tets while a patch is gathered */ };
enum {
    NDLI_USUAL_POOL = 32,  /* slots a split keeps: seldom more than eight tets of four pieces */
    NDLI_USUAL_PATCH = 512 /* tets: twice what graded meshes were seen to need */
};
enum { NDLI_SLIDE_SAMPLES = 10, NDLI_MAX_SUBSTEPS = 1000, NDLI_STUCK = 16, NDLI_RELEASES = 4, NDLI_RATED = 16 };
#define NDLI_REMESH_COOKIE 0x4e444c52u

/* ---- memory ---- */

static void ndli_remesh_layout(ndl_remesh *r, sbi_arena *arena, size_t n)
{
    size_t nodes = 4 * n + 1, tets = 3 * n + 8; /* a split makes at most twice the tets it cuts, or four of one */
    for (int i = 0; i < NDLI_FINALISTS; i++) {
        r->final[i].created.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
        r->final[i].removed.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    }
    r->trial.created.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->trial.removed.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->taken.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->table = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    r->table_whole = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    r->draft.tets = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    r->draft.qualities = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->draft.X = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    r->draft.star_start = (int *)sbi_arena_take(arena, nodes + 2, sizeof(int));
    r->draft.star = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    r->draft.is_free = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    r->draft.moved = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    r->moves = (ndli_node_move *)sbi_arena_take(arena, nodes, sizeof(ndli_node_move));
    r->rating = (sb_real *)sbi_arena_take(arena, NDLI_RATED, sizeof(sb_real));
    r->best_rating = (sb_real *)sbi_arena_take(arena, NDLI_RATED, sizeof(sb_real));
    r->here.tets = (ndli_patch_tet *)sbi_arena_take(arena, n, sizeof(ndli_patch_tet));
    r->undone.tets = (ndli_patch_tet *)sbi_arena_take(arena, n, sizeof(ndli_patch_tet));
    r->moving = (int *)sbi_arena_take(arena, 2 * n + 8, 4 * sizeof(int));
    r->groups = (int *)sbi_arena_take(arena, 2 * n + 8, sizeof(int));
    r->kept = (int *)sbi_arena_take(arena, n + 8, 4 * sizeof(int));
    for (int i = 0; i < 2; i++)
        r->sorted[i] = (sb_real *)sbi_arena_take(arena, 6 * n + 16, sizeof(sb_real));
}

/* Room for patches of so many tets; keeps the one being gathered. */
static int ndli_remesh_scratch(ndl_remesh *r, int needed)
{
    ndl_remesh grown = *r;
    sbi_arena arena;
    size_t n = (size_t)needed + (size_t)needed / 2;
    if (needed <= r->capacity)
        return 1;
    memset(&arena, 0, sizeof arena);
    ndli_remesh_layout(&grown, &arena, n);
    arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(&r->def.allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    ndli_remesh_layout(&grown, &arena, n);
    if (r->here.count)
        memcpy(grown.here.tets, r->here.tets, (size_t)r->here.count * sizeof(ndli_patch_tet));
    if (r->undone.count)
        memcpy(grown.undone.tets, r->undone.tets, (size_t)r->undone.count * sizeof(ndli_patch_tet));
    grown.scratch = arena.base;
    grown.capacity = (int)n;
    sbi_free(&r->def.allocator, r->scratch);
    *r = grown;
    return 1;
}

/* All that one operation may need, before anything changes. */
static int ndli_remesh_reserve(ndl_remesh *r)
{
    ndli_needle *needle = r->needles + r->needle;
    int tets = 2 * r->here.count + 8, counts[3];
    counts[0] = needle->count + 1;
    counts[1] = needle->depth + 1;
    counts[2] = needle->pool_count + tets;
    return ndli_remesh_make_room(r, needle, counts) && ndli_topology_reserve(r->mesh, 1, tets);
}

NDL_API ndl_remesh_def ndl_default_remesh_def(void)
{
    ndl_remesh_def def;
    memset(&def, 0, sizeof def);
    def.max_needles = 4;
    def.interfaces = NDL_INTERFACE_MOVE;
    def.smooth_below = (sb_real)0.55;
    def.release_above = (sb_real)0.6;
    def.max_smoothed = 16;
    def.entry_slip = NDLI_ENTRY_SLIP;
    def.cookie = NDLI_REMESH_COOKIE;
    return def;
}

static sb_result ndli_remesh_check_def(const ndl_remesh_def *def, sb_error *error)
{
    if (!def || def->cookie != NDLI_REMESH_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by ndl_default_remesh_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "body is NULL");
    if (def->max_needles < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_needles is %d", def->max_needles);
    if (def->interfaces != NDL_INTERFACE_KEEP_NODES && def->interfaces != NDL_INTERFACE_MOVE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "interfaces is %d", (int)def->interfaces);
    if (!(def->smooth_below >= 0) || !(def->smooth_below < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "smooth_below is not in [0, 1)");
    if (!(def->release_above >= 0) || !(def->release_above <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "release_above is not in [0, 1]");
    if (!(def->entry_slip >= 0) || !(def->entry_slip <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "entry_slip is not in [0, 1]");
    if (def->max_smoothed < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_smoothed is %d", def->max_smoothed);
    return SB_OK;
}

/* ---- the body's own changes ---- */

/* Others may change the mesh while no needle has. */
static sb_result ndli_remesh_hear(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    const ndl_remesh *r = (const ndl_remesh *)user;
    (void)body;
    (void)change;
    if (r->own || r->stale || ndli_topology_is_original(r->mesh))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_STATE, "needles have changed the mesh: draw them out before others change it");
}

static void ndli_remesh_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    ndl_remesh *r = (ndl_remesh *)user;
    (void)body;
    (void)change;
    r->stale = r->stale || !r->own;
}

/* Reads the body's mesh again once it is another: needles that were in it are not in this one. */
static sb_result ndli_remesh_freshen(ndl_remesh *r, sb_error *error)
{
    if (!r->stale)
        return SB_OK;
    if (!ndli_topology_read(r->mesh, r->body))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to read the mesh that the body now has");
    for (int i = 0; i < r->def.max_needles; i++)
        r->needles[i].count = r->needles[i].depth = r->needles[i].pool_count = 0;
    r->release_cursor = 0;
    r->stale = 0;
    return SB_OK;
}

NDLI_API sb_result ndli_remesh_look(ndl_remesh *remesh, sb_error *error)
{
    sb_result result = ndli_remesh_freshen(remesh, error);
    if (result == SB_OK)
        ndli_topology_look(remesh->mesh, remesh->body);
    return result;
}

NDLI_API void ndli_remesh_set_own(ndl_remesh *remesh, int own) { remesh->own = own; }
NDLI_API int ndli_remesh_is_stale(const ndl_remesh *remesh) { return remesh->stale; }
NDLI_API const ndli_topology *ndli_remesh_topology(const ndl_remesh *remesh) { return remesh->mesh; }

/* ---- the patch ---- */

/* Nodes of the needle counted from its tip; -1 when there are not so many. */
static int ndli_remesh_from_tip(const ndli_needle *needle, int i)
{
    return i < needle->count ? needle->nodes[needle->count - 1 - i] : -1;
}

static int ndli_remesh_is_foreign(const ndl_remesh *r, int node)
{
    return node >= 0 && r->mesh->owner[node] >= 0 && r->mesh->owner[node] != r->needle;
}

static int ndli_remesh_skin_bit(const ndl_remesh *r, int tet, int face)
{
    return r->mesh->neighbours[4 * (size_t)tet + (size_t)face] < 0 ? 1 << face : 0;
}

static void ndli_remesh_begin_gather(ndl_remesh *r)
{
    for (int i = 0; i < r->here.count; i++)
        r->mesh->tet_mark[r->here.tets[i].slot] = NDLI_IN_PATCH;
}

static void ndli_remesh_end_gather(ndl_remesh *r)
{
    for (int i = 0; i < r->here.count; i++)
        r->mesh->tet_mark[r->here.tets[i].slot] = 0;
}

/* Adds the tets of a node that are not there yet; 0: no memory. */
static int ndli_remesh_gather(ndl_remesh *r, int node)
{
    ndli_topology *mesh = r->mesh;
    for (int k = node < 0 ? -1 : mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        ndli_patch_tet *to;
        int tet = k / 4;
        if (mesh->tet_mark[tet] & NDLI_IN_PATCH)
            continue;
        if (!ndli_remesh_scratch(r, r->here.count + 1))
            return 0;
        mesh->tet_mark[tet] |= NDLI_IN_PATCH;
        to = r->here.tets + r->here.count;
        memcpy(to->nodes, mesh->tets + 4 * (size_t)tet, sizeof to->nodes);
        to->slot = tet;
        to->skin = 0;
        to->quality = mesh->qualities[tet];
        for (int c = 0; c < 4; c++)
            to->skin |= ndli_remesh_skin_bit(r, tet, c);
        r->here.count++;
    }
    return 1;
}

/* Tet that was cut, from its parts: the part that has `node` in place of simplex[j] knows the face opposite that. */
static void ndli_remesh_parent(const ndl_remesh *r, const ndli_split *split, const int *parts, ndli_patch_tet *parent)
{
    const ndli_topology *mesh = r->mesh;
    const int *n = mesh->tets + 4 * (size_t)parts[0];
    parent->slot = -1;
    parent->skin = 0;
    for (int c = 0; c < 4; c++)
        parent->nodes[c] = n[c] == split->node ? split->simplex[0] : n[c];
    for (int c = 0; c < 4; c++) {
        int part = parts[0];
        for (int j = 0; j < split->size; j++)
            if (split->simplex[j] == parent->nodes[c])
                part = parts[j];
        parent->skin |= ndli_remesh_skin_bit(r, part, c);
    }
    parent->quality = ndli_tet_quality(mesh->X[parent->nodes[0]], mesh->X[parent->nodes[1]], mesh->X[parent->nodes[2]],
                                       mesh->X[parent->nodes[3]]);
}

static const ndli_split *ndli_remesh_top(const ndli_needle *needle)
{
    return needle->depth ? needle->stack + needle->depth - 1 : NULL;
}

static sb_real ndli_remesh_least_weight(const ndl_remesh *r, const int nodes[4], sb_vec3 X)
{
    const sb_vec3 *p = r->mesh->X;
    sb_real w[4];
    ndli_tet_weights(p[nodes[0]], p[nodes[1]], p[nodes[2]], p[nodes[3]], X, w);
    return sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
}

/* Nodes of the tet that would hold X without the top split. */
static void ndli_remesh_undone_holder(const ndl_remesh *r, const ndli_split *top, sb_vec3 X, int holder[4])
{
    const ndli_needle *needle = r->needles + r->needle;
    ndli_patch_tet parent;
    sb_real most = -SB_REAL_MAX;
    if (!ndli_remesh_has(holder, top->node))
        return;
    for (int g = 0; g < top->count; g++) {
        sb_real least;
        ndli_remesh_parent(r, top, needle->pool + top->first + top->size * g, &parent);
        least = ndli_remesh_least_weight(r, parent.nodes, X);
        if (least > most) {
            most = least;
            memcpy(holder, parent.nodes, sizeof parent.nodes);
        }
    }
}

/* The patch as it would be without the top split, and the qualities that this removes. */
static void ndli_remesh_fill_undone(ndl_remesh *r, const ndli_split *top)
{
    const ndli_needle *needle = r->needles + r->needle;
    r->undone.count = r->taken.count = 0;
    for (int i = 0; i < r->here.count; i++)
        if (ndli_remesh_has(r->here.tets[i].nodes, top->node))
            r->taken.values[r->taken.count++] = r->here.tets[i].quality;
        else
            r->undone.tets[r->undone.count++] = r->here.tets[i];
    for (int g = 0; g < top->count; g++)
        ndli_remesh_parent(r, top, needle->pool + top->first + top->size * g, r->undone.tets + r->undone.count++);
}

/* ---- candidates: their qualities ---- */

static void ndli_remesh_push(ndli_qualities *list, sb_real quality)
{
    list->values[list->count++] = quality;
    list->least = sb_min(list->least, quality);
}

static sb_vec3 ndli_remesh_at(const ndl_remesh *r, int node)
{
    const ndli_candidate *t = &r->trial;
    if (node == NDLI_VIRTUAL || (t->size == 1 && node == t->simplex[0]))
        return t->X;
    return node == t->slid ? t->slid_X : r->mesh->X[node];
}

static sb_real ndli_remesh_quality(const ndl_remesh *r, const int n[4])
{
    return ndli_tet_quality(ndli_remesh_at(r, n[0]), ndli_remesh_at(r, n[1]), ndli_remesh_at(r, n[2]),
                            ndli_remesh_at(r, n[3]));
}

/* A tet that the candidate makes or changes. */
static void ndli_remesh_add(ndl_remesh *r, const int nodes[4])
{
    if (r->trial.slid >= 0 && ndli_remesh_has(nodes, r->trial.slid)) {
        memcpy(r->moving + 4 * (size_t)r->moving_count++, nodes, 4 * sizeof(int));
        return;
    }
    ndli_remesh_push(&r->trial.created, ndli_remesh_quality(r, nodes));
}

static void ndli_remesh_add_children(ndl_remesh *r, const int nodes[4])
{
    for (int j = 0; j < r->trial.size; j++) {
        int child[4];
        for (int c = 0; c < 4; c++)
            child[c] = nodes[c] == r->trial.simplex[j] ? (int)NDLI_VIRTUAL : nodes[c];
        ndli_remesh_add(r, child);
    }
}

/* 0 when a tet that the candidate would change is another needle's. */
static int ndli_remesh_collect(ndl_remesh *r, const ndli_patch *patch)
{
    ndli_candidate *t = &r->trial;
    t->created.count = t->removed.count = r->moving_count = 0;
    t->created.least = t->removed.least = SB_REAL_MAX;
    for (int i = 0; t->undo && i < r->taken.count; i++)
        ndli_remesh_push(&t->removed, r->taken.values[i]);
    for (int i = 0; i < patch->count; i++) {
        const ndli_patch_tet *tet = patch->tets + i;
        int hit = ndli_remesh_holds(tet->nodes, t->simplex, t->size);
        int slides = t->slid >= 0 && ndli_remesh_has(tet->nodes, t->slid);
        if (!hit && !slides) {
            if (tet->slot < 0)
                ndli_remesh_push(&t->created, tet->quality);
            continue;
        }
        for (int c = 0; c < 4; c++)
            if (ndli_remesh_is_foreign(r, tet->nodes[c])) {
                r->conflict = tet->nodes[c];
                return 0;
            }
        if (tet->slot >= 0)
            ndli_remesh_push(&t->removed, tet->quality);
        if (hit && t->size > 1)
            ndli_remesh_add_children(r, tet->nodes);
        else
            ndli_remesh_add(r, tet->nodes);
    }
    return 1;
}

/* Worst quality about the sliding node; anything <= floor when it is not better than floor. The tet that decided goes
 * to the front: it is likely to decide again. */
static sb_real ndli_remesh_moving_least(ndl_remesh *r, sb_real floor)
{
    sb_real least = SB_REAL_MAX;
    for (int i = 0; i < r->moving_count; i++) {
        int *tet = r->moving + 4 * (size_t)i, swap[4];
        least = sb_min(least, ndli_remesh_quality(r, tet));
        if (least > floor)
            continue;
        memcpy(swap, tet, sizeof swap);
        memcpy(tet, r->moving, sizeof swap);
        memcpy(r->moving, swap, sizeof swap);
        return least;
    }
    return least;
}

/* What the sliding node's worst tet must beat for the trial to be among the best. */
static sb_real ndli_remesh_floor(const ndl_remesh *r)
{
    if (r->final_count < NDLI_FINALISTS)
        return 0;
    return sb_max(0, sb_min(r->final[NDLI_FINALISTS - 1].created.least, r->trial.removed.least));
}

/* Puts the sliding node where its worst tet is best: its present place, samples on the segment, and two halvings about
 * the best of these. 0 when all are too bad. */
static int ndli_remesh_slide(ndl_remesh *r, sb_vec3 from, sb_vec3 to)
{
    ndli_candidate *t = &r->trial;
    sb_vec3 way = sb_v3_sub(to, from), present = r->mesh->X[t->slid];
    sb_real floor = ndli_remesh_floor(r), best, at = -1, step = (sb_real)1 / (NDLI_SLIDE_SAMPLES + 1);
    t->slid_X = present;
    best = sb_max(floor, ndli_remesh_moving_least(r, floor));
    for (int i = 1; i <= NDLI_SLIDE_SAMPLES; i++) {
        sb_real q;
        t->slid_X = sb_v3_madd(from, (sb_real)i * step, way);
        q = ndli_remesh_moving_least(r, best);
        if (q > best) {
            best = q;
            at = (sb_real)i * step;
        }
    }
    for (int round = 0; at >= 0 && round < 2; round++) {
        sb_real middle = at;
        step /= 2;
        for (int side = -1; side <= 1; side += 2) {
            sb_real q;
            t->slid_X = sb_v3_madd(from, middle + (sb_real)side * step, way);
            q = ndli_remesh_moving_least(r, best);
            if (q > best) {
                best = q;
                at = middle + (sb_real)side * step;
            }
        }
    }
    t->slid_moves = at >= 0;
    t->slid_X = at >= 0 ? sb_v3_madd(from, at, way) : present;
    return best > floor;
}

/* Where a ray from inside the sliding node's star leaves it. */
static sb_vec3 ndli_remesh_ray_end(const ndl_remesh *r, sb_vec3 from, sb_vec3 direction)
{
    sb_real end = 0;
    for (int i = 0; i < r->moving_count; i++) {
        sb_vec3 p[3], n, w;
        sb_real den, s;
        int k = 0;
        for (int c = 0; c < 4; c++)
            if (r->moving[4 * i + c] != r->trial.slid)
                p[k++] = ndli_remesh_at(r, r->moving[4 * i + c]);
        n = sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(p[2], p[0]));
        den = sb_v3_dot(direction, n);
        s = sb_v3_dot(sb_v3_sub(p[0], from), n);
        if (!(s * den > 0)) /* behind, on the start, or parallel */
            continue;
        s /= den;
        w = sb_v3_madd(from, s, direction);
        if (sb_v3_dot(sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(w, p[0])), n) >= 0 &&
            sb_v3_dot(sb_v3_cross(sb_v3_sub(p[2], p[1]), sb_v3_sub(w, p[1])), n) >= 0 &&
            sb_v3_dot(sb_v3_cross(sb_v3_sub(p[0], p[2]), sb_v3_sub(w, p[2])), n) >= 0)
            end = sb_max(end, s);
    }
    return sb_v3_madd(from, end, direction);
}

static void ndli_remesh_sort(sb_real *a, int count)
{
    for (int i = 1; i < count; i++) {
        sb_real value = a[i];
        int j = i;
        for (; j > 0 && a[j - 1] > value; j--)
            a[j] = a[j - 1];
        a[j] = value;
    }
}

static int ndli_remesh_merge(sb_real *to, const ndli_qualities *a, const ndli_qualities *b)
{
    memcpy(to, a->values, (size_t)a->count * sizeof(sb_real));
    memcpy(to + a->count, b->values, (size_t)b->count * sizeof(sb_real));
    ndli_remesh_sort(to, a->count + b->count);
    return a->count + b->count;
}

/* 1 when the trial leaves a better mesh than b. The minimum decides nearly always. */
static int ndli_remesh_is_better(ndl_remesh *r, const ndli_candidate *b)
{
    const ndli_candidate *t = &r->trial;
    sb_real mine = sb_min(t->created.least, b->removed.least), theirs = sb_min(b->created.least, t->removed.least);
    int n, m;
    if (mine > theirs || mine < theirs)
        return mine > theirs;
    n = ndli_remesh_merge(r->sorted[0], &t->created, &b->removed);
    m = ndli_remesh_merge(r->sorted[1], &b->created, &t->removed);
    for (int i = 0; i < n && i < m; i++)
        if (r->sorted[0][i] > r->sorted[1][i] || r->sorted[0][i] < r->sorted[1][i])
            return r->sorted[0][i] > r->sorted[1][i];
    return n < m; /* a missing entry counts as infinitely good */
}

/* 1 when what the trial brings, so far, is already worse than all that could speak for it. */
static int ndli_remesh_is_lost(const ndl_remesh *r)
{
    sb_real least = r->trial.created.least;
    return !(least > 0) || (r->final_count == NDLI_FINALISTS && least < r->final[NDLI_FINALISTS - 1].created.least &&
                            least < r->trial.removed.least);
}

/* ---- candidates: which ---- */

typedef enum ndli_move {
    NDLI_SNAP_TIP, /* (a) */
    NDLI_AHEAD,    /* (b) another node comes to lie at X_new, the old tip stays on the needle */
    NDLI_UNDO,     /* (c) the top split, which made the tip, is undone first */
    NDLI_DROP      /* (d) the tip stays in the tissue, but not on the needle */
} ndli_move;

/* Nodes between regions may be bound to their place; those that a split made there are not. */
static int ndli_remesh_is_bound(const ndl_remesh *r, int node)
{
    int flags = r->mesh->node_flags[node];
    return (flags & (NDLI_NODE_FIXED | NDLI_NODE_BOUNDARY)) ||
           ((flags & (NDLI_NODE_INTERFACE | NDLI_NODE_CREATED)) == NDLI_NODE_INTERFACE &&
            r->def.interfaces == NDL_INTERFACE_KEEP_NODES);
}

/* The needle's nodes after the tip that X_new will have next to it. */
static int ndli_remesh_anchor(const ndl_remesh *r, ndli_move move)
{
    return ndli_remesh_from_tip(r->needles + r->needle, move == NDLI_AHEAD ? 0 : 1);
}

static int ndli_remesh_may_snap(const ndl_remesh *r, int node, ndli_move move)
{
    if (ndli_remesh_is_bound(r, node))
        return 0;
    if (!(r->mesh->node_flags[node] & NDLI_NODE_NEEDLE))
        return 1;
    return move == NDLI_SNAP_TIP ? node == ndli_remesh_from_tip(r->needles + r->needle, 0)
                                 : move != NDLI_AHEAD && node == ndli_remesh_anchor(r, move);
}

static int ndli_remesh_is_shaft(const ndl_remesh *r, const int edge[2], ndli_move move)
{
    const ndli_needle *needle = r->needles + r->needle;
    int last = move == NDLI_AHEAD ? needle->count - 1 : needle->count - 2;
    for (int i = 0; i < last; i++)
        if ((needle->nodes[i] == edge[0] && needle->nodes[i + 1] == edge[1]) ||
            (needle->nodes[i] == edge[1] && needle->nodes[i + 1] == edge[0]))
            return 1;
    return 0;
}

/* Whether the trial keeps the surface, the walls and the needle's path. */
static int ndli_remesh_is_legal(const ndl_remesh *r, const ndli_patch *patch, ndli_move move)
{
    const ndli_candidate *t = &r->trial;
    int anchor = ndli_remesh_anchor(r, move), joined = move == NDLI_SNAP_TIP;
    if (t->size == 1 && !ndli_remesh_may_snap(r, t->simplex[0], move))
        return 0;
    if (t->size == 2 && ndli_remesh_is_shaft(r, t->simplex, move))
        return 0;
    for (int i = 0; i < patch->count; i++) {
        const ndli_patch_tet *tet = patch->tets + i;
        if (!ndli_remesh_holds(tet->nodes, t->simplex, t->size))
            continue;
        joined |= ndli_remesh_has(tet->nodes, anchor);
        for (int c = 0; t->size > 1 && c < 4; c++) {
            int part = 0; /* of the simplex: the corner that the face lies opposite to */
            for (int j = 0; j < t->size; j++)
                part |= tet->nodes[c] == t->simplex[j];
            if (!part && (tet->skin >> c & 1))
                return 0;
        }
    }
    return joined;
}

/* Puts the trial into its place among the best. */
static void ndli_remesh_rank(ndl_remesh *r)
{
    int last = NDLI_FINALISTS - 1, place = r->final_count;
    while (place > 0 && ndli_remesh_is_better(r, r->final + place - 1))
        place--;
    if (place > last)
        return;
    r->final_count = sbi_min_int(r->final_count + 1, NDLI_FINALISTS);
    {
        ndli_candidate spare = r->final[r->final_count - 1];
        for (int i = r->final_count - 1; i > place; i--)
            r->final[i] = r->final[i - 1];
        r->final[place] = r->trial;
        r->trial = spare;
    }
}

/* Which node slides, and between where. Returns 0 when none does. */
static int ndli_remesh_slider(const ndl_remesh *r, ndli_move move, sb_vec3 *to)
{
    const ndli_needle *needle = r->needles + r->needle;
    int anchor = ndli_remesh_anchor(r, move), next, node;
    if (move == NDLI_SNAP_TIP)
        return -1;
    if (move == NDLI_DROP) {
        node = ndli_remesh_from_tip(needle, 0);
        *to = r->mesh->X[anchor];
        if (r->trial.size == 1 && r->trial.simplex[0] == node)
            return -1;
    } else {
        int snaps_anchor = r->trial.size == 1 && r->trial.simplex[0] == anchor, first = move == NDLI_AHEAD ? 0 : 1;
        node = ndli_remesh_from_tip(needle, first + snaps_anchor);
        next = ndli_remesh_from_tip(needle, first + snaps_anchor + 1);
        if (node < 0 || next < 0)
            return -1;
        *to = r->mesh->X[next];
    }
    return ndli_remesh_is_bound(r, node) ? -1 : node;
}

/* Rates the trial, whose simplex, X and undo are set, and keeps it when it is the best so far. */
static void ndli_remesh_try(ndl_remesh *r, const ndli_patch *patch, ndli_move move)
{
    ndli_candidate *t = &r->trial;
    sb_vec3 to = t->X;
    t->slid = -1;
    t->slid_moves = 0;
    if (!ndli_remesh_is_legal(r, patch, move))
        return;
    t->slid = ndli_remesh_slider(r, move, &to);
    r->info.candidates++;
    if (!ndli_remesh_collect(r, patch) || ndli_remesh_is_lost(r))
        return;
    if (t->slid >= 0) {
        if (move == NDLI_DROP)
            to = ndli_remesh_ray_end(r, t->X, sb_v3_sub(t->X, to));
        if (!ndli_remesh_slide(r, t->X, to))
            return;
        for (int i = 0; i < r->moving_count; i++)
            ndli_remesh_push(&t->created, ndli_remesh_quality(r, r->moving + 4 * (size_t)i));
    }
    t->drops_tip = move == NDLI_DROP;
    if (!ndli_remesh_is_lost(r))
        ndli_remesh_rank(r);
}

/* All standard operations in the tet that holds X_new on up to `most` of its nodes: 15 for 4, the snaps for 1. */
static void ndli_remesh_try_standard(ndl_remesh *r, const ndli_patch *patch, const int holder[4], int most, sb_vec3 X,
                                     ndli_move move)
{
    for (int set = 1; set < 16; set++) {
        ndli_candidate *t = &r->trial;
        if ((set & 1) + (set >> 1 & 1) + (set >> 2 & 1) + (set >> 3) > most)
            continue;
        t->size = 0;
        t->X = X;
        t->undo = move == NDLI_UNDO;
        for (int c = 0; c < 4; c++)
            if (set >> c & 1)
                t->simplex[t->size++] = holder[c];
        ndli_remesh_try(r, patch, move);
    }
}

static void ndli_remesh_try_snap_tip(ndl_remesh *r, int tip, sb_vec3 X)
{
    ndli_candidate *t = &r->trial;
    t->size = 1;
    t->simplex[0] = tip;
    t->X = X;
    t->undo = 0;
    ndli_remesh_try(r, &r->here, NDLI_SNAP_TIP);
}

/* ---- smoothing ----
 * Which candidate is best shows only when the nodes about it have made way, so the best few are compared with that
 * done, on drafts. */

static int ndli_remesh_local(const ndl_remesh *r, int node)
{
    return node == NDLI_VIRTUAL ? r->table_count : r->mesh->node_index[node] - 1;
}

static void ndli_remesh_clear_table(ndl_remesh *r)
{
    for (int i = 0; i < r->table_count; i++)
        r->mesh->node_index[r->table[i]] = 0;
    r->table_count = 0;
}

static void ndli_remesh_enter(ndl_remesh *r, int node)
{
    if (r->mesh->node_index[node])
        return;
    r->table_whole[r->table_count] = 0;
    r->table[r->table_count++] = node;
    r->mesh->node_index[node] = r->table_count;
}

static void ndli_remesh_draft_tet(ndl_remesh *r, const int nodes[4])
{
    int *to = r->draft.tets + 4 * (size_t)r->draft.tet_count++;
    for (int c = 0; c < 4; c++)
        to[c] = ndli_remesh_local(r, nodes[c]);
}

static void ndli_remesh_draft_tets(ndl_remesh *r, const ndli_candidate *c)
{
    const ndli_patch *patch = c->undo ? &r->undone : &r->here;
    int count = c->undo ? r->undone.count : r->core_count;
    r->draft.tet_count = 0;
    for (int i = 0; i < count; i++) {
        const int *nodes = patch->tets[i].nodes;
        int cut = c->size > 1 && ndli_remesh_holds(nodes, c->simplex, c->size);
        for (int j = 0; cut && j < c->size; j++) {
            int child[4];
            for (int k = 0; k < 4; k++)
                child[k] = nodes[k] == c->simplex[j] ? (int)NDLI_VIRTUAL : nodes[k];
            ndli_remesh_draft_tet(r, child);
        }
        if (!cut)
            ndli_remesh_draft_tet(r, nodes);
    }
    r->draft.core_count = r->draft.tet_count;
    for (int i = r->core_count; i < r->here.count; i++)
        ndli_remesh_draft_tet(r, r->here.tets[i].nodes);
}

static sb_real ndli_remesh_draft_quality(const ndli_draft *d, int tet)
{
    const int *n = d->tets + 4 * (size_t)tet;
    return ndli_tet_quality(d->X[n[0]], d->X[n[1]], d->X[n[2]], d->X[n[3]]);
}

static void ndli_remesh_draft_stars(ndl_remesh *r)
{
    ndli_draft *d = &r->draft;
    int nodes = r->table_count + 1;
    memset(d->star_start, 0, ((size_t)nodes + 2) * sizeof(int));
    for (int i = 0; i < 4 * d->tet_count; i++)
        d->star_start[d->tets[i] + 2]++;
    for (int i = 0; i < nodes; i++)
        d->star_start[i + 2] += d->star_start[i + 1];
    for (int i = 0; i < 4 * d->tet_count; i++)
        d->star[d->star_start[d->tets[i] + 1]++] = i;
}

/* Nodes that may make way: inner ones, not on the needle, with all their tets in the draft, none of them another
 * needle's. */
static void ndli_remesh_draft_free(ndl_remesh *r, const ndli_candidate *c)
{
    int tip = ndli_remesh_from_tip(r->needles + r->needle, 0);
    for (int i = 0; i < r->table_count; i++) {
        int node = r->table[i], flags = r->mesh->node_flags[node];
        int fixed = (flags & (NDLI_NODE_BOUNDARY | NDLI_NODE_FIXED)) ||
                    ((flags & NDLI_NODE_INTERFACE) && r->def.interfaces == NDL_INTERFACE_KEEP_NODES);
        if (c->drops_tip && node == tip)
            flags &= ~NDLI_NODE_NEEDLE;
        if ((c->size == 1 && node == c->simplex[0]) || (c->undo && node == tip) || (flags & NDLI_NODE_NEEDLE))
            fixed = 1;
        r->draft.is_free[i] = (unsigned char)(!fixed && r->table_whole[i]);
    }
    for (int t = 0; t < r->draft.tet_count; t++) {
        const int *n = r->draft.tets + 4 * (size_t)t;
        int foreign = 0;
        for (int k = 0; k < 4; k++)
            foreign |= n[k] < r->table_count && ndli_remesh_is_foreign(r, r->table[n[k]]);
        for (int k = 0; foreign && k < 4; k++)
            r->draft.is_free[n[k]] = 0;
    }
    r->draft.is_free[r->table_count] = 0;
}

static void ndli_remesh_make_draft(ndl_remesh *r, const ndli_candidate *c)
{
    ndli_draft *d = &r->draft;
    ndli_remesh_draft_tets(r, c);
    for (int i = 0; i < r->table_count; i++)
        d->X[i] = r->mesh->X[r->table[i]];
    d->X[r->table_count] = c->X;
    if (c->size == 1)
        d->X[ndli_remesh_local(r, c->simplex[0])] = c->X;
    if (c->slid_moves)
        d->X[ndli_remesh_local(r, c->slid)] = c->slid_X;
    d->moved_count = 0;
    ndli_remesh_draft_stars(r);
    ndli_remesh_draft_free(r, c);
    for (int t = 0; t < d->tet_count; t++)
        d->qualities[t] = ndli_remesh_draft_quality(d, t);
}

/* d quality / d X of the corner c of a tet. */
static sb_vec3 ndli_remesh_gradient(const ndli_draft *d, int tet, int c)
{
    static const int facing[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
    const int *n = d->tets + 4 * (size_t)tet;
    sb_vec3 X = d->X[n[c]], p[3], e[3], sum, up;
    sb_real mean = 0, det;
    for (int i = 0; i < 3; i++) {
        p[i] = d->X[n[facing[c][i]]];
        e[i] = sb_v3_sub(X, p[i]);
        mean += sb_v3_dot(e[i], e[i]);
    }
    for (int i = 0; i < 3; i++) {
        sb_vec3 side = sb_v3_sub(p[i], p[(i + 1) % 3]);
        mean += sb_v3_dot(side, side);
    }
    mean /= 6;
    up = sb_v3_cross(sb_v3_sub(p[2], p[0]), sb_v3_sub(p[1], p[0]));
    det = sb_v3_dot(up, e[0]);
    sum = sb_v3_add(e[0], sb_v3_add(e[1], e[2]));
    return sb_v3_scale((sb_real)1.4142135623730951 / (mean * sb_sqrt(mean)), sb_v3_madd(up, -det / (2 * mean), sum));
}

static sb_real ndli_remesh_draft_least(const ndli_draft *d, int node)
{
    sb_real least = SB_REAL_MAX;
    for (int k = d->star_start[node]; k < d->star_start[node + 1]; k++)
        least = sb_min(least, d->qualities[d->star[k] / 4]);
    return least;
}

/* Direction in which all tets near the worst quality get better: the shortest vector in the hull of their gradients
 * (Freitag, Jones, Plassmann), by Gilbert's iteration. */
static sb_vec3 ndli_remesh_ascent(const ndli_draft *d, int node, sb_real least)
{
    sb_vec3 gradients[32], shortest;
    sb_real active = least + (sb_real)0.05;
    int count = 0;
    for (int k = d->star_start[node]; k < d->star_start[node + 1] && count < 32; k++)
        if (d->qualities[d->star[k] / 4] <= active)
            gradients[count++] = ndli_remesh_gradient(d, d->star[k] / 4, d->star[k] % 4);
    shortest = count ? gradients[0] : sb_v3(0, 0, 0);
    for (int i = 0; i < 12 && count > 1; i++) {
        sb_real low = SB_REAL_MAX, share;
        sb_vec3 way;
        int worst = 0;
        for (int j = 0; j < count; j++) {
            sb_real along = sb_v3_dot(shortest, gradients[j]);
            if (along < low) {
                low = along;
                worst = j;
            }
        }
        way = sb_v3_sub(shortest, gradients[worst]);
        share = sb_v3_dot(shortest, way);
        if (!(share > (sb_real)1e-3 * sb_v3_dot(shortest, shortest)))
            break;
        shortest = sb_v3_madd(shortest, -sb_min(1, share / sb_v3_dot(way, way)), way);
    }
    return shortest;
}

/* Worst quality about a node if it were at X; anything <= floor when that is not better than floor. */
static sb_real ndli_remesh_draft_at(ndli_draft *d, int node, sb_vec3 X, sb_real floor)
{
    sb_vec3 present = d->X[node];
    sb_real least = SB_REAL_MAX;
    d->X[node] = X;
    for (int k = d->star_start[node]; k < d->star_start[node + 1] && least > floor; k++)
        least = sb_min(least, ndli_remesh_draft_quality(d, d->star[k] / 4));
    d->X[node] = present;
    return least;
}

/* A better place for a free node; returns the worst quality about it there, or `now` when there is none. */
static sb_real ndli_remesh_improve(ndli_draft *d, int node, sb_real now, sb_vec3 *X)
{
    sb_vec3 way = ndli_remesh_ascent(d, node, now);
    sb_real best = now, size = 0, length = sb_v3_norm(way);
    const int *n = d->tets + 4 * (size_t)(d->star[d->star_start[node]] / 4);
    for (int c = 0; c < 4; c++)
        size = sb_max(size, sb_v3_norm(sb_v3_sub(d->X[n[c]], d->X[node])));
    if (!(length > 0))
        return now;
    for (sb_real step = (sb_real)0.32; step > (sb_real)0.015; step /= 2) {
        sb_vec3 at = sb_v3_madd(d->X[node], step * size / length, way);
        sb_real q = ndli_remesh_draft_at(d, node, at, best);
        if (q > best) {
            best = q;
            *X = at;
        } else if (best > now) {
            break;
        }
    }
    return best;
}

/* Worst tet of the draft's core that is worth work and not among those given up; or -1. */
static int ndli_remesh_worst_near(const ndl_remesh *r, const int *stuck, int stuck_count)
{
    const ndli_draft *d = &r->draft;
    sb_real least = r->def.smooth_below;
    int worst = -1;
    for (int tet = 0; tet < d->core_count; tet++) {
        const int *n = d->tets + 4 * (size_t)tet;
        int known = 0;
        if (!(d->qualities[tet] < least))
            continue;
        for (int j = 0; j < stuck_count; j++)
            known |= stuck[j] == tet;
        if (!known && (d->is_free[n[0]] || d->is_free[n[1]] || d->is_free[n[2]] || d->is_free[n[3]])) {
            least = d->qualities[tet];
            worst = tet;
        }
    }
    return worst;
}

static void ndli_remesh_move_in_draft(ndli_draft *d, int node, sb_vec3 X)
{
    int known = 0;
    d->X[node] = X;
    for (int k = d->star_start[node]; k < d->star_start[node + 1]; k++)
        d->qualities[d->star[k] / 4] = ndli_remesh_draft_quality(d, d->star[k] / 4);
    for (int i = 0; i < d->moved_count; i++)
        known |= d->moved[i] == node;
    if (!known)
        d->moved[d->moved_count++] = node;
}

static void ndli_remesh_smooth(ndl_remesh *r)
{
    const sb_real gain = (sb_real)0.005; /* less is not worth the diffusion that interpolating the state brings */
    ndli_draft *d = &r->draft;
    int stuck[NDLI_STUCK], stuck_count = 0;
    for (int moved = 0; moved < r->def.max_smoothed && stuck_count < NDLI_STUCK;) {
        int tet = ndli_remesh_worst_near(r, stuck, stuck_count), node = -1;
        sb_vec3 X = sb_v3(0, 0, 0), at = X;
        sb_real best = 0;
        if (tet < 0)
            return;
        for (int c = 0; c < 4; c++) {
            int candidate = d->tets[4 * (size_t)tet + (size_t)c];
            sb_real now, q;
            if (!d->is_free[candidate])
                continue;
            now = ndli_remesh_draft_least(d, candidate);
            q = ndli_remesh_improve(d, candidate, now, &at);
            if (q > now + gain && q > best) {
                best = q;
                node = candidate;
                X = at;
            }
        }
        if (node < 0) {
            stuck[stuck_count++] = tet;
            continue;
        }
        ndli_remesh_move_in_draft(d, node, X);
        moved++;
    }
}

/* The draft's lowest qualities, ascending. */
static void ndli_remesh_rate(ndl_remesh *r)
{
    sb_real *low = r->rating;
    for (int i = 0; i < NDLI_RATED; i++)
        low[i] = SB_REAL_MAX;
    for (int t = 0; t < r->draft.tet_count; t++) {
        int at = NDLI_RATED - 1;
        if (!(r->draft.qualities[t] < low[at]))
            continue;
        for (; at > 0 && low[at - 1] > r->draft.qualities[t]; at--)
            low[at] = low[at - 1];
        low[at] = r->draft.qualities[t];
    }
}

static int ndli_remesh_rates_better(const ndl_remesh *r)
{
    for (int i = 0; i < NDLI_RATED; i++)
        if (r->rating[i] > r->best_rating[i] || r->rating[i] < r->best_rating[i])
            return r->rating[i] > r->best_rating[i];
    return 0;
}

/* 1 when the nodes of the tet may have to make way: it touches the end of the needle or a whole edge of a holder. */
static int ndli_remesh_is_near(const ndl_remesh *r, const int nodes[4], const int holders[2][4])
{
    for (int i = 0; i < 3; i++) {
        int node = ndli_remesh_from_tip(r->needles + r->needle, i);
        if (node >= 0 && ndli_remesh_has(nodes, node))
            return 1;
    }
    for (int h = 0; h < 2; h++) {
        int common = 0;
        for (int c = 0; c < 4; c++)
            common += ndli_remesh_has(nodes, holders[h][c]);
        if (common > 1)
            return 1;
    }
    return 0;
}

/* Adds to the patch the tets of all nodes that may make way, and numbers its nodes; 0: no memory. */
static int ndli_remesh_widen(ndl_remesh *r, const int holders[2][4])
{
    int good = 1;
    ndli_remesh_begin_gather(r);
    for (int i = 0; i < r->core_count; i++) {
        ndli_patch_tet tet = r->here.tets[i];
        for (int c = 0; c < 4 && good && ndli_remesh_is_near(r, tet.nodes, holders); c++)
            good = ndli_remesh_gather(r, tet.nodes[c]);
    }
    ndli_remesh_end_gather(r);
    if (!good)
        return 0;
    r->table_count = 0;
    for (int i = 0; i < r->here.count; i++)
        for (int c = 0; c < 4; c++)
            ndli_remesh_enter(r, r->here.tets[i].nodes[c]);
    for (int i = 0; i < r->core_count; i++)
        for (int c = 0; c < 4 && ndli_remesh_is_near(r, r->here.tets[i].nodes, holders); c++)
            r->table_whole[ndli_remesh_local(r, r->here.tets[i].nodes[c])] = 1;
    return 1;
}

/* Keeps what was smoothed in the draft. */
static void ndli_remesh_keep_moves(ndl_remesh *r, const ndli_candidate *c)
{
    r->move_count = 0;
    for (int i = 0; i < r->draft.moved_count; i++)
        if (r->table[r->draft.moved[i]] != (c->slid_moves ? c->slid : -1)) {
            r->moves[r->move_count].node = r->table[r->draft.moved[i]];
            r->moves[r->move_count++].X = r->draft.X[r->draft.moved[i]];
        }
}

static sb_real ndli_remesh_core_least(const ndl_remesh *r)
{
    sb_real least = SB_REAL_MAX;
    for (int t = 0; t < r->draft.core_count; t++)
        least = sb_min(least, r->draft.qualities[t]);
    return least;
}

/* Smooths the finalists' drafts, until one leaves no tet of the core worse than `enough`, and puts the best
 * of them first; 0: no memory. */
static int ndli_remesh_decide(ndl_remesh *r, const int holders[2][4], sb_real enough)
{
    int winner = 0, done = 0;
    if (!ndli_remesh_widen(r, holders))
        return 0;
    for (int i = 0; i < r->final_count && !done; i++) {
        ndli_candidate *c = r->final + i;
        ndli_remesh_make_draft(r, c);
        ndli_remesh_smooth(r);
        ndli_remesh_rate(r);
        done = ndli_remesh_core_least(r) >= enough;
        if (i > 0 && !ndli_remesh_rates_better(r))
            continue;
        winner = i;
        memcpy(r->best_rating, r->rating, NDLI_RATED * sizeof(sb_real));
        r->outcome = ndli_remesh_core_least(r);
        for (int k = 0; k < r->draft.moved_count; k++) /* a freed tip may slide first and be smoothed then */
            if (c->slid_moves && r->table[r->draft.moved[k]] == c->slid)
                c->slid_X = r->draft.X[r->draft.moved[k]];
        ndli_remesh_keep_moves(r, c);
    }
    ndli_remesh_clear_table(r);
    if (winner) {
        ndli_candidate swap = r->final[0];
        r->final[0] = r->final[winner];
        r->final[winner] = swap;
    }
    return 1;
}

/* ---- doing it ---- */

static void ndli_remesh_pop(ndl_remesh *r, int index)
{
    ndli_needle *needle = r->needles + index;
    const ndli_split *top = needle->stack + needle->depth - 1;
    ndli_leaving *leaving = r->leaving + r->leaving_count++;
    leaving->node = top->node;
    leaving->size = top->size;
    memcpy(leaving->simplex, top->simplex, sizeof leaving->simplex);
    ndli_topology_mend(r->mesh, top->node, top->simplex, top->size, needle->pool + top->first, top->count);
    needle->pool_count = top->first;
    needle->depth--;
}

static void ndli_remesh_push_split(ndl_remesh *r, const ndli_candidate *c, int node, int count)
{
    ndli_needle *needle = r->needles + r->needle;
    ndli_split *split = needle->stack + needle->depth++;
    split->node = node;
    split->size = c->size;
    memcpy(split->simplex, c->simplex, sizeof split->simplex);
    split->first = needle->pool_count;
    split->count = count;
    memcpy(needle->pool + needle->pool_count, r->groups, (size_t)(count * c->size) * sizeof(int));
    needle->pool_count += count * c->size;
    r->mesh->owner[node] = r->needle;
}

/* ---- the body follows ---- */

enum { NDLI_MAX_HEIRS = 32 };

typedef struct ndli_heirs {
    int nodes[NDLI_MAX_HEIRS], count;
    sb_real weights[NDLI_MAX_HEIRS];
} ndli_heirs;

static const ndli_leaving *ndli_remesh_leaving(const ndl_remesh *r, int node)
{
    for (int i = 0; i < r->leaving_count; i++)
        if (r->leaving[i].node == node)
            return r->leaving + i;
    return NULL;
}

static void ndli_remesh_add_heir(ndli_heirs *heirs, int node, sb_real weight)
{
    for (int k = 0; k < heirs->count; k++)
        if (heirs->nodes[k] == node) {
            heirs->weights[k] += weight;
            return;
        }
    heirs->nodes[heirs->count] = node;
    heirs->weights[heirs->count++] = weight;
}

/* What refers to a node that goes refers to the corners of the split that made it from then on; those of corners that
 * go, too, stand for them. (Only the first of them once the list is full: a chain of that many splits.) */
static void ndli_remesh_find_heirs(const ndl_remesh *r, int node, ndli_heirs *heirs)
{
    const ndli_leaving *l = ndli_remesh_leaving(r, node);
    heirs->count = 0;
    for (int k = 0; l && k < l->size; k++)
        ndli_remesh_add_heir(heirs, l->simplex[k], (sb_real)1 / (sb_real)l->size);
    for (int i = 0; i < heirs->count;) {
        sb_real weight = heirs->weights[i];
        int parts;
        l = ndli_remesh_leaving(r, heirs->nodes[i]);
        if (!l) {
            i++;
            continue;
        }
        heirs->count--;
        heirs->nodes[i] = heirs->nodes[heirs->count];
        heirs->weights[i] = heirs->weights[heirs->count];
        parts = heirs->count + l->size <= NDLI_MAX_HEIRS ? l->size : 1;
        for (int k = 0; k < parts; k++)
            ndli_remesh_add_heir(heirs, l->simplex[k], weight / (sb_real)parts);
        i = 0;
    }
}

/* Moved nodes first: where their motion comes from is named by the slots of before. Nodes made are free, also between
 * held ones: tissue gives way to a needle, and they must be able to move with its tip, or their tets get flat. Rigid
 * about a stiff wire they made thousands of newtons. */
static sb_result ndli_remesh_send_nodes(ndl_remesh *r, const ndli_topology_change *c, sb_body_change *to,
                                        sb_error *error)
{
    sb_result result = SB_OK;
    int plan = 0;
    for (int i = 0; i < c->node_count && result == SB_OK; i++)
        if (!c->nodes[i].created)
            result = sb_body_change_move_node(to, c->nodes[i].node, c->nodes[i].X, c->nodes[i].sources,
                                              c->nodes[i].weights, 4, error);
    for (int i = 0; i < c->node_event_count && result == SB_OK; i++) {
        int event = c->node_events[i].node, slot = 0;
        ndli_heirs heirs;
        if (event < 0) {
            ndli_remesh_find_heirs(r, ~event, &heirs);
            result = sb_body_change_remove_node(to, ~event, heirs.nodes, heirs.weights, heirs.count, error);
            continue;
        }
        while (!c->nodes[plan].created)
            plan++;
        result = sb_body_change_add_node(to, c->nodes[plan].X, c->nodes[plan].sources, c->nodes[plan].weights, 4,
                                         SB_NODE_COPY, &slot, error);
        SB_ASSERT(result != SB_OK || slot == event);
        plan++;
    }
    return result;
}

static sb_change_cell ndli_remesh_cell(const ndl_remesh *r, int tet, int parent)
{
    sb_change_cell cell = sb_default_change_cell();
    cell.nodes = r->mesh->tets + 4 * (size_t)tet;
    cell.parent = parent;
    return cell;
}

/* 1: a node of the tet has come, maybe in the slot of one that has gone. */
static int ndli_remesh_is_renewed(const ndli_topology_change *c, const int nodes[4])
{
    for (int i = 0; i < c->node_event_count; i++)
        if (c->node_events[i].node >= 0 && ndli_remesh_has(nodes, c->node_events[i].node))
            return 1;
    return 0;
}

static sb_result ndli_remesh_send_tets(ndl_remesh *r, const ndli_topology_change *c, sb_body_change *to,
                                       sb_error *error)
{
    sb_result result = SB_OK;
    for (int i = 0; i < c->tet_event_count && result == SB_OK; i++) {
        int event = c->tet_events[i], slot = 0;
        if (event < 0) {
            result = sb_body_change_remove_cell(to, ~event, error);
        } else {
            sb_change_cell cell = ndli_remesh_cell(r, event, r->mesh->parents[event]);
            result = sb_body_change_add_cell(to, &cell, &slot, error);
            SB_ASSERT(result != SB_OK || slot == event);
        }
    }
    for (int i = 0; i < c->changed_count && result == SB_OK; i++) {
        int tet = c->changed[i];
        sb_change_cell cell = ndli_remesh_cell(r, tet, tet);
        if (memcmp(cell.nodes, sb_body_cell_nodes(r->body, tet), 4 * sizeof(int)) != 0 ||
            ndli_remesh_is_renewed(c, cell.nodes))
            result = sb_body_change_replace_cell(to, tet, &cell, error);
    }
    return result;
}

/* Ends a change of the topology and makes the body's mesh follow. When the body refuses, the topology is as it was at
 * the begin. */
static sb_result ndli_remesh_commit(ndl_remesh *r, sb_error *error)
{
    ndli_topology_change change;
    sb_body_change *to = NULL;
    sb_result result;
    ndli_topology_end(r->mesh, &change);
    result = sb_body_change_begin(r->body, &to, error);
    if (result == SB_OK)
        result = ndli_remesh_send_nodes(r, &change, to, error);
    if (result == SB_OK)
        result = ndli_remesh_send_tets(r, &change, to, error);
    r->own = 1;
    if (result == SB_OK)
        result = sb_body_change_commit(to, error);
    r->own = 0;
    r->leaving_count = 0;
    if (result != SB_OK) {
        sb_body_change_cancel(to);
        ndli_topology_take_back(r->mesh, r->body);
    }
    r->mesh->x = sb_body_positions(r->body);
    return result;
}

/* Plans what the best candidate moves; *slide: the sliding node's number among the plans, or -1. Returns the first of
 * the smoothed nodes. */
static int ndli_remesh_plan_moves(ndl_remesh *r, int *slide)
{
    ndli_topology *mesh = r->mesh;
    const ndli_candidate *c = r->final;
    int first = mesh->change_count;
    for (int i = 0; i < r->move_count; i++)
        ndli_topology_plan(mesh, r->moves[i].node, r->moves[i].X, mesh->node_star[r->moves[i].node] / 4);
    *slide = c->slid_moves ? ndli_topology_plan(mesh, c->slid, c->slid_X, mesh->node_star[c->slid] / 4) : -1;
    return first;
}

/* Does the best candidate; *node: the one at X_new. */
static sb_result ndli_remesh_do(ndl_remesh *r, int start, int *node, sb_error *error)
{
    ndli_topology *mesh = r->mesh;
    ndli_needle *needle = r->needles + r->needle;
    const ndli_candidate *c = r->final;
    int plan, slide, first_move, depth = needle->depth, pool_count = needle->pool_count;
    ndli_split top;
    sb_result result;
    memset(&top, 0, sizeof top);
    if (c->undo) {
        top = needle->stack[depth - 1];
        memcpy(r->kept, needle->pool + top.first, (size_t)(pool_count - top.first) * sizeof(int));
    }
    ndli_topology_begin(mesh);
    plan = ndli_topology_plan(mesh, c->size == 1 ? c->simplex[0] : -1, c->X, start);
    first_move = ndli_remesh_plan_moves(r, &slide);
    if (c->undo)
        ndli_remesh_pop(r, r->needle);
    if (c->size == 1) {
        ndli_topology_move(mesh, plan);
    } else {
        int count = ndli_topology_cut(mesh, c->simplex, c->size, plan, r->groups);
        ndli_remesh_push_split(r, c, mesh->changes[plan].node, count);
    }
    *node = mesh->changes[plan].node;
    for (int i = 0; i < r->move_count; i++)
        ndli_topology_move(mesh, first_move + i);
    if (slide >= 0)
        ndli_topology_move(mesh, slide);
    result = ndli_remesh_commit(r, error);
    if (result != SB_OK) {
        needle->depth = depth;
        needle->pool_count = pool_count;
        if (c->undo) {
            needle->stack[depth - 1] = top;
            memcpy(needle->pool + top.first, r->kept, (size_t)(pool_count - top.first) * sizeof(int));
        }
        return result;
    }
    r->info.smoothed += r->move_count;
    r->info.operation = (ndl_operation)c->size;
    r->info.undone = c->undo;
    return SB_OK;
}

static void ndli_remesh_release_node(ndl_remesh *r, int node)
{
    r->mesh->node_flags[node] = (unsigned char)(r->mesh->node_flags[node] & ~NDLI_NODE_NEEDLE);
    if (!(r->mesh->node_flags[node] & NDLI_NODE_CREATED))
        r->mesh->owner[node] = -1;
}

static void ndli_remesh_add_node(ndl_remesh *r, int node)
{
    ndli_needle *needle = r->needles + r->needle;
    r->mesh->node_flags[node] |= NDLI_NODE_NEEDLE;
    r->mesh->owner[node] = r->needle;
    if (ndli_remesh_from_tip(needle, 0) != node)
        needle->nodes[needle->count++] = node;
}

/* ---- afterwards: release ---- */

static sb_real ndli_remesh_star_least(const ndli_topology *mesh, int node)
{
    sb_real least = SB_REAL_MAX;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
        least = sb_min(least, mesh->qualities[k / 4]);
    return least;
}

/* Worst quality about a node if it were at X; anything <= floor when that is not better than floor. */
static sb_real ndli_remesh_star_at(const ndli_topology *mesh, int node, sb_vec3 X, sb_real floor)
{
    sb_real least = SB_REAL_MAX;
    for (int k = mesh->node_star[node]; k >= 0 && least > floor; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_vec3 p[4];
        for (int c = 0; c < 4; c++)
            p[c] = n[c] == node ? X : mesh->X[n[c]];
        least = sb_min(least, ndli_tet_quality(p[0], p[1], p[2], p[3]));
    }
    return least;
}

/* No tet about the node is another needle's. */
static int ndli_remesh_is_ours(const ndl_remesh *r, int node)
{
    for (int k = r->mesh->node_star[node]; k >= 0; k = r->mesh->corner_next[k])
        for (int c = 0; c < 4; c++)
            if (ndli_remesh_is_foreign(r, r->mesh->tets[4 * (size_t)(k / 4) + (size_t)c]))
                return 0;
    return 1;
}

/* 1: done; 0: the body refuses. */
static int ndli_remesh_move_node(ndl_remesh *r, int node, sb_vec3 X)
{
    ndli_topology *mesh = r->mesh;
    ndli_topology_begin(mesh);
    ndli_topology_move(mesh, ndli_topology_plan(mesh, node, X, mesh->node_star[node] / 4));
    return ndli_remesh_commit(r, NULL) == SB_OK;
}

/* Moves a released node as far towards its own place as the tets about it allow; 1: it moved. */
static int ndli_remesh_send_home(ndl_remesh *r, int node)
{
    ndli_topology *mesh = r->mesh;
    sb_vec3 way = sb_v3_sub(mesh->X0[node], mesh->X[node]);
    sb_real enough;
    if ((mesh->node_flags[node] & NDLI_NODE_NEEDLE) || !ndli_remesh_is_ours(r, node))
        return 0;
    enough = sb_min(ndli_remesh_star_least(mesh, node), r->def.release_above);
    for (int quarters = 4; quarters > 0; quarters--) {
        sb_vec3 X = quarters == 4 ? mesh->X0[node] : sb_v3_madd(mesh->X[node], (sb_real)quarters / 4, way);
        if (ndli_remesh_star_at(mesh, node, X, 0) >= enough) {
            int moved = ndli_remesh_move_node(r, node, X);
            r->info.released += moved;
            return moved;
        }
    }
    return 0;
}

/* Undoes a split whose node no needle needs, if that does no harm; 1: done. */
static int ndli_remesh_pop_spare(ndl_remesh *r, int index)
{
    const ndli_needle *needle = r->needles + index;
    const ndli_split *top = ndli_remesh_top(needle);
    int depth = needle->depth, pool_count = needle->pool_count;
    ndli_patch_tet parent;
    sb_real least = SB_REAL_MAX;
    if (!top || (r->mesh->node_flags[top->node] & NDLI_NODE_NEEDLE))
        return 0;
    for (int g = 0; g < top->count; g++) {
        ndli_remesh_parent(r, top, needle->pool + top->first + top->size * g, &parent);
        least = sb_min(least, parent.quality);
    }
    if (!(least >= sb_min(ndli_remesh_star_least(r->mesh, top->node), r->def.release_above)))
        return 0;
    ndli_topology_begin(r->mesh);
    ndli_remesh_pop(r, index);
    if (ndli_remesh_commit(r, NULL) == SB_OK)
        return 1;
    r->needles[index].depth = depth;
    r->needles[index].pool_count = pool_count;
    return 0;
}

/* A few nodes each time, in turn. */
static void ndli_remesh_release(ndl_remesh *r)
{
    ndli_topology *mesh = r->mesh;
    int tries = sbi_min_int(mesh->displaced_count, NDLI_RELEASES);
    for (int i = 0; i < r->def.max_needles; i++)
        while (ndli_remesh_pop_spare(r, i))
            continue;
    for (int i = 0; i < tries && mesh->displaced_count; i++) {
        r->release_cursor = (r->release_cursor + 1) % mesh->displaced_count;
        ndli_remesh_send_home(r, mesh->displaced[r->release_cursor]);
    }
}

static void ndli_remesh_tidy(ndl_remesh *r)
{
    const ndli_needle *needle = r->needles + r->needle;
    ndli_remesh_release(r);
    r->info.worst_quality = 1;
    for (int i = 0; i < 2 && i < needle->count; i++)
        r->info.worst_quality =
            sb_min(r->info.worst_quality, ndli_remesh_star_least(r->mesh, ndli_remesh_from_tip(needle, i)));
    r->info.X = r->mesh->X[ndli_remesh_from_tip(needle, 0)];
}

/* ---- one operation ---- */

/* The patch about the tip and X_new; holder and undone_holder: the tet that holds X_new, as it is and without the top
 * split. Returns 0 when memory is short. */
static int ndli_remesh_prepare(ndl_remesh *r, sb_vec3 X, int holder[4], int undone_holder[4], int *can_undo)
{
    const ndli_needle *needle = r->needles + r->needle;
    const ndli_split *top = ndli_remesh_top(needle);
    int tip = ndli_remesh_from_tip(needle, 0), good = 1;
    *can_undo = top && top->node == tip && needle->count > 1;
    r->here.count = r->undone.count = 0;
    for (int i = 0; i < 3; i++)
        good = good && ndli_remesh_gather(r, ndli_remesh_from_tip(needle, i));
    memcpy(undone_holder, holder, 4 * sizeof(int));
    if (*can_undo)
        ndli_remesh_undone_holder(r, top, X, undone_holder);
    for (int c = 0; c < 4; c++)
        good = good && ndli_remesh_gather(r, holder[c]) && ndli_remesh_gather(r, undone_holder[c]);
    ndli_remesh_end_gather(r);
    r->core_count = r->here.count;
    r->move_count = 0;
    if (!good)
        return 0;
    if (*can_undo)
        ndli_remesh_fill_undone(r, top);
    return 1;
}

static sb_result ndli_remesh_fail_operation(const ndl_remesh *r, sb_error *error)
{
    if (r->conflict >= 0)
        return sbi_fail_node(error, SB_ERROR_UNSUPPORTED, r->conflict,
                             "needle %d would change an element at node %d of needle %d: needles may share none",
                             r->needle, r->conflict, r->mesh->owner[r->conflict]);
    return sbi_fail_node(error, SB_ERROR_MESH, ndli_remesh_from_tip(r->needles + r->needle, 0),
                         "no operation puts a node at needle %d's tip and leaves sound tets: the step is too long",
                         r->needle);
}

/* Lets the nodes about the tip make way if the tets there are, or would be, worse than they should be. */
static int ndli_remesh_make_way(ndl_remesh *r, const int holders[2][4])
{
    r->before = SB_REAL_MAX;
    for (int i = 0; i < r->core_count; i++)
        r->before = sb_min(r->before, r->here.tets[i].quality);
    r->outcome = r->final[0].created.least;
    r->move_count = 0;
    if (r->def.max_smoothed == 0 || sb_min(r->before, r->outcome) >= r->def.smooth_below)
        return 1;
    return ndli_remesh_decide(r, holders, sb_min(r->before, r->def.smooth_below));
}

/* Takes the tip to X, which tet `start` holds. */
static sb_result ndli_remesh_operate(ndl_remesh *r, sb_vec3 X, int start, int penetrates, sb_error *error)
{
    ndli_needle *needle = r->needles + r->needle;
    int holders[2][4], *holder = holders[0], *undone_holder = holders[1];
    int tip = ndli_remesh_from_tip(needle, 0), can_undo, node, flags, owner, count;
    sb_result result;
    memcpy(holder, r->mesh->tets + 4 * (size_t)start, sizeof holders[0]);
    if (!ndli_remesh_prepare(r, X, holder, undone_holder, &can_undo) || !ndli_remesh_reserve(r))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for remeshing about needle %d", r->needle);
    r->final_count = 0;
    r->conflict = -1;
    ndli_remesh_try_snap_tip(r, tip, X);
    if (penetrates)
        ndli_remesh_try_standard(r, &r->here, holder, 4, X, NDLI_AHEAD);
    if (can_undo)
        ndli_remesh_try_standard(r, &r->undone, undone_holder, 4, X, NDLI_UNDO);
    if (!penetrates && needle->count > 1) /* no split over one that could be undone: stacks would grow on the way out */
        ndli_remesh_try_standard(r, &r->here, holder, can_undo ? 1 : 4, X, NDLI_DROP);
    if (!r->final_count)
        return ndli_remesh_fail_operation(r, error);
    if (!ndli_remesh_make_way(r, (const int(*)[4])holders))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for smoothing about needle %d", r->needle);
    if (r->outcome < sb_min(r->before, r->enough))
        return ndli_remesh_fail_operation(r, error);
    flags = r->mesh->node_flags[tip];
    owner = r->mesh->owner[tip];
    count = needle->count;
    if (r->final[0].undo || r->final[0].drops_tip) {
        needle->count--; /* the old tip is no part of the needle any more */
        ndli_remesh_release_node(r, tip);
    }
    result = ndli_remesh_do(r, start, &node, error);
    if (result != SB_OK) {
        needle->count = count;
        r->mesh->node_flags[tip] = (unsigned char)flags;
        r->mesh->owner[tip] = owner;
        return result;
    }
    ndli_remesh_add_node(r, node);
    r->info.substeps++;
    ndli_remesh_tidy(r);
    return SB_OK;
}

/* ---- calls ---- */

static sb_result ndli_remesh_begin_call(ndl_remesh *r, int needle, int is_in, ndl_remesh_info *info, sb_error *error)
{
    sb_result result;
    if (!r)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "remesh is NULL");
    if (needle < 0 || needle >= r->def.max_needles)
        return sbi_fail(error, SB_ERROR_INDEX, "needle %d of %d", needle, r->def.max_needles);
    result = ndli_remesh_look(r, error);
    if (result != SB_OK)
        return result;
    if (is_in >= 0 && (r->needles[needle].count > 0) != is_in)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "needle %d is %s the tissue", needle,
                        is_in ? "not in" : "already in");
    r->needle = needle;
    r->conflict = -1;
    r->enough = 0;
    memset(&r->info, 0, sizeof r->info);
    r->info.worst_quality = 1;
    if (info)
        *info = r->info;
    return SB_OK;
}

NDL_API sb_real ndl_remesh_limit(const ndl_remesh *remesh, int needle)
{
    const ndli_topology *mesh;
    sb_real shortest = SB_REAL_MAX;
    int tip, behind;
    if (!remesh || needle < 0 || needle >= remesh->def.max_needles || !remesh->needles[needle].count)
        return 0;
    mesh = remesh->mesh;
    tip = ndli_remesh_from_tip(remesh->needles + needle, 0);
    behind = ndli_remesh_from_tip(remesh->needles + needle, 1);
    for (int k = mesh->node_star[tip]; k >= 0; k = mesh->corner_next[k])
        for (int c = 0; c < 4; c++) {
            int node = mesh->tets[4 * (size_t)(k / 4) + (size_t)c];
            if (node != tip && node != behind)
                shortest = sb_min(shortest, sb_v3_norm(sb_v3_sub(mesh->X[node], mesh->X[tip])));
        }
    return shortest / 2;
}

static sb_result ndli_remesh_advance(ndl_remesh *r, sb_vec3 X, int penetrates, sb_error *error)
{
    const ndli_topology *mesh = r->mesh;
    sb_real share = 1; /* of the limit, smaller while no operation is found */
    for (int i = 0; i < NDLI_MAX_SUBSTEPS; i++) {
        int tip = ndli_remesh_from_tip(r->needles + r->needle, 0), last, tet;
        sb_vec3 way = sb_v3_sub(X, mesh->X[tip]), to = X;
        sb_real length = sb_v3_norm(way), limit = share * ndl_remesh_limit(r, r->needle);
        sb_result result;
        last = !(length > limit);
        if (!last)
            to = sb_v3_madd(mesh->X[tip], limit / length, way);
        tet = ndli_topology_find(mesh, mesh->X, to, mesh->node_star[tip] / 4, NULL);
        if (tet < 0) {
            r->info.outside = 1;
            return SB_OK;
        }
        result = ndli_remesh_operate(r, to, tet, penetrates, error);
        if (result == SB_OK && last)
            return SB_OK;
        if (result == SB_ERROR_MESH && share > (sb_real)0.01) {
            share /= 4;
            continue;
        }
        if (result != SB_OK)
            return result;
        share = 1;
    }
    return sbi_fail(error, SB_ERROR_MESH, "needle %d has not come there in %d substeps", r->needle,
                    (int)NDLI_MAX_SUBSTEPS);
}

static sb_result ndli_remesh_move_tip(ndl_remesh *r, int needle, sb_vec3 X, int penetrates, ndl_remesh_info *info,
                                      sb_error *error)
{
    sb_result result = ndli_remesh_begin_call(r, needle, 1, info, error);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(X))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the place for needle %d's tip is not finite", needle);
    r->info.X = r->mesh->X[ndli_remesh_from_tip(r->needles + needle, 0)];
    result = ndli_remesh_advance(r, X, penetrates, error);
    if (info)
        *info = r->info;
    return result;
}

NDLI_API sb_result ndli_remesh_put_first(ndl_remesh *remesh, int needle, sb_vec3 X, sb_real enough,
                                         ndl_remesh_info *info)
{
    const ndli_topology *mesh = remesh->mesh;
    sb_result result = ndli_remesh_begin_call(remesh, needle, 1, info, NULL);
    int tip, tet;
    if (result != SB_OK)
        return result;
    tip = ndli_remesh_from_tip(remesh->needles + needle, 0);
    tet = ndli_topology_find(mesh, mesh->X, X, mesh->node_star[tip] / 4, NULL);
    remesh->enough = enough;
    result = tet < 0 ? SB_ERROR_MESH : ndli_remesh_operate(remesh, X, tet, 1, NULL);
    if (info)
        *info = remesh->info;
    return result;
}

NDL_API sb_result ndl_remesh_penetrate(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                       sb_error *error)
{
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_move_tip(remesh, needle, X_new, 1, info, error);
    ndli_remesh_tell_move(remesh, needle, X_new, 1, result);
    return result;
}

NDL_API sb_result ndl_remesh_retract(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                     sb_error *error)
{
    ndl_remesh_info done;
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_move_tip(remesh, needle, X_new, 0, &done, error);
    if (result == SB_OK && done.outside)
        result = ndl_remesh_withdraw(remesh, needle, NULL, error);
    ndli_remesh_tell_move(remesh, needle, X_new, 0, result);
    if (result == SB_OK && done.outside)
        done.worst_quality = 1;
    if (info && remesh)
        *info = done;
    return result;
}

/* ---- in and out ---- */

/* 1 when X lies in the planes of all surface faces that the trial changes: then the surface keeps its shape. */
static int ndli_remesh_keeps_skin(const ndl_remesh *r)
{
    const ndli_candidate *t = &r->trial;
    sb_real flat = sb_sqrt(SB_EPSILON) * sb_sqrt(sb_sqrt(SB_EPSILON)); /* volume is kept to the last digits but few */
    for (int i = 0; i < r->here.count; i++) {
        const ndli_patch_tet *tet = r->here.tets + i;
        if (!ndli_remesh_holds(tet->nodes, t->simplex, t->size))
            continue;
        for (int c = 0; c < 4; c++) {
            sb_vec3 p[3], n;
            sb_real size;
            int k = 0, part = 0;
            for (int j = 0; j < t->size; j++)
                part |= tet->nodes[c] == t->simplex[j];
            if (part || !(tet->skin >> c & 1))
                continue;
            for (int j = 0; j < 4; j++)
                if (j != c)
                    p[k++] = r->mesh->X[tet->nodes[j]];
            n = sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(p[2], p[0]));
            size = sb_v3_norm(n);
            if (!(sb_abs(sb_v3_dot(n, sb_v3_sub(t->X, p[0]))) <= flat * size * sb_sqrt(size)))
                return 0;
        }
    }
    return 1;
}

static void ndli_remesh_try_entry(ndl_remesh *r, const int *simplex, int size, sb_vec3 X)
{
    ndli_candidate *t = &r->trial;
    memcpy(t->simplex, simplex, (size_t)size * sizeof(int));
    t->size = size;
    t->X = X;
    t->undo = t->drops_tip = t->slid_moves = 0;
    t->slid = -1;
    if (size == 1 && memcmp(&X, r->mesh->X + simplex[0], sizeof X) != 0 &&
        (r->mesh->node_flags[simplex[0]] & (NDLI_NODE_FIXED | NDLI_NODE_INTERFACE)))
        return;
    if (!ndli_remesh_keeps_skin(r))
        return;
    r->info.candidates++;
    if (!ndli_remesh_collect(r, &r->here) || ndli_remesh_is_lost(r))
        return;
    ndli_remesh_rank(r);
}

/* Nodes and edges of the face not further than `reach` from X, with the entry on them. */
static void ndli_remesh_try_slipped(ndl_remesh *r, const int face[3], sb_vec3 X, sb_real reach)
{
    for (int i = 0; i < 3; i++) {
        int edge[2];
        sb_vec3 a = r->mesh->X[face[i]], along, foot;
        sb_real s;
        edge[0] = face[i];
        edge[1] = face[(i + 1) % 3];
        along = sb_v3_sub(r->mesh->X[edge[1]], a);
        s = sb_v3_dot(sb_v3_sub(X, a), along) / sb_v3_dot(along, along);
        foot = sb_v3_madd(a, s, along);
        if (s > 0 && s < 1 && sb_v3_norm(sb_v3_sub(X, foot)) <= reach)
            ndli_remesh_try_entry(r, edge, 2, foot);
        if (sb_v3_norm(sb_v3_sub(X, a)) <= reach)
            ndli_remesh_try_entry(r, face + i, 1, a);
    }
}

/* Leaves the best entry first among the finalists, with what has to make way for it; 0: no memory. */
static int ndli_remesh_try_entries(ndl_remesh *r, const int holder[4], const int face[3], sb_vec3 X, sb_real slip)
{
    int holders[2][4];
    sb_real longest = 0;
    memcpy(holders[0], holder, sizeof holders[0]);
    memcpy(holders[1], holder, sizeof holders[1]);
    for (int set = 1; set < 8; set++) {
        int simplex[3], size = 0;
        for (int c = 0; c < 3; c++)
            if (set >> c & 1)
                simplex[size++] = face[c];
        ndli_remesh_try_entry(r, simplex, size, X);
    }
    if (r->final_count && !ndli_remesh_make_way(r, (const int(*)[4])holders))
        return 0;
    for (int i = 0; i < 3; i++)
        longest = sb_max(longest, sb_v3_norm(sb_v3_sub(r->mesh->X[face[i]], r->mesh->X[face[(i + 1) % 3]])));
    if (r->final_count && r->outcome >= sb_min(r->before, r->def.smooth_below / 2))
        return 1;
    r->here.count = r->core_count; /* making way has widened it */
    ndli_remesh_try_slipped(r, face, X, slip * longest);
    return !r->final_count || ndli_remesh_make_way(r, (const int(*)[4])holders);
}

static sb_result ndli_remesh_check_hit(const ndl_remesh *r, const ndl_surface_hit *hit, sb_error *error)
{
    const ndli_topology *mesh = r->mesh;
    if (!hit)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "hit is NULL");
    if (hit->tet < 0 || hit->tet >= mesh->tet_end || mesh->tets[4 * (size_t)hit->tet] < 0 || hit->face < 0 ||
        hit->face > 3)
        return sbi_fail(error, SB_ERROR_INDEX, "face %d of tet %d", hit->face, hit->tet);
    if (mesh->neighbours[4 * (size_t)hit->tet + (size_t)hit->face] >= 0)
        return sbi_fail_element(error, SB_ERROR_ARGUMENT, hit->tet, "face %d of tet %d is not on the surface",
                                hit->face, hit->tet);
    if (!sb_v3_is_finite(hit->X))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the point of the puncture is not finite");
    return SB_OK;
}

static sb_result ndli_remesh_do_puncture(ndl_remesh *r, const ndl_surface_hit *hit, sb_real slip, sb_error *error)
{
    int holder[4], face[3], k = 0, good = 1, node = -1;
    sb_result result = SB_OK;
    memcpy(holder, r->mesh->tets + 4 * (size_t)hit->tet, sizeof holder);
    for (int c = 0; c < 4; c++)
        if (c != hit->face)
            face[k++] = holder[c];
    r->here.count = r->undone.count = r->move_count = 0;
    for (int c = 0; c < 3; c++)
        good = good && ndli_remesh_gather(r, face[c]);
    ndli_remesh_end_gather(r);
    r->core_count = r->here.count;
    if (!good || !ndli_remesh_reserve(r))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for remeshing about needle %d", r->needle);
    r->final_count = 0;
    if (!ndli_remesh_try_entries(r, holder, face, hit->X, slip))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for smoothing about needle %d", r->needle);
    if (!r->final_count && r->conflict >= 0)
        return ndli_remesh_fail_operation(r, error);
    if (!r->final_count)
        return sbi_fail_element(error, SB_ERROR_MESH, hit->tet, "no sound way to puncture tet %d at that point",
                                hit->tet);
    if (r->final[0].size == 1 && memcmp(&r->final[0].X, r->mesh->X + r->final[0].simplex[0], sizeof(sb_vec3)) == 0)
        node = r->final[0].simplex[0];
    else
        result = ndli_remesh_do(r, hit->tet, &node, error);
    if (result != SB_OK)
        return result;
    r->mesh->node_flags[node] |= NDLI_NODE_BOUNDARY;
    ndli_remesh_add_node(r, node);
    r->info.substeps = 1;
    ndli_remesh_tidy(r);
    return SB_OK;
}

NDLI_API sb_result ndli_remesh_puncture_within(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, sb_real slip,
                                               ndl_remesh_info *info, sb_error *error)
{
    sb_result result = ndli_remesh_begin_call(remesh, needle, 0, info, error);
    if (result == SB_OK)
        result = ndli_remesh_check_hit(remesh, hit, error);
    if (result == SB_OK)
        result = ndli_remesh_do_puncture(remesh, hit, slip, error);
    if (result == SB_OK && info)
        *info = remesh->info;
    return result;
}

NDL_API sb_result ndl_remesh_puncture(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, ndl_remesh_info *info,
                                      sb_error *error)
{
    sb_real slip = remesh ? remesh->def.entry_slip : 0;
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_puncture_within(remesh, needle, hit, slip, info, error);
    ndli_remesh_tell_puncture(remesh, needle, hit, slip, result);
    return result;
}

/* The whole way back at once: whatever lies between, the mesh that comes out is the original one. */
static sb_result ndli_remesh_restore(ndl_remesh *r, sb_error *error)
{
    ndli_topology *mesh = r->mesh;
    sb_result result;
    ndli_topology_begin(mesh);
    for (int i = 0; i < mesh->displaced_count; i++) {
        int node = mesh->displaced[i];
        ndli_topology_plan(mesh, node, mesh->X0[node], mesh->node_star[node] / 4);
    }
    for (int i = 0; i < r->def.max_needles; i++)
        for (r->needles[i].undone = 0; r->needles[i].depth; r->needles[i].undone++)
            ndli_remesh_pop(r, i);
    for (int i = 0; i < mesh->change_count; i++)
        ndli_topology_move(mesh, i);
    result = mesh->change_count || mesh->node_event_count ? ndli_remesh_commit(r, error) : SB_OK;
    for (int i = 0; i < r->def.max_needles && result != SB_OK; i++) {
        ndli_needle *needle = r->needles + i;
        needle->depth = needle->undone;
        if (needle->depth) {
            const ndli_split *top = needle->stack + needle->depth - 1;
            needle->pool_count = top->first + top->size * top->count;
        }
    }
    if (result == SB_OK)
        r->info.released += mesh->change_count;
    return result;
}

/* As much of it as leaves sound tets: other needles are still in. */
static void ndli_remesh_restore_partly(ndl_remesh *r)
{
    int progress = 1;
    for (int round = 0; progress && round < 16; round++) {
        progress = 0;
        for (int i = 0; i < r->def.max_needles; i++)
            while (ndli_remesh_pop_spare(r, i))
                progress = 1;
        for (int i = r->mesh->displaced_count - 1; i >= 0; i--)
            if (i < r->mesh->displaced_count)
                progress |= ndli_remesh_send_home(r, r->mesh->displaced[i]);
    }
}

/* The needle's nodes in the tissue are on it (in), or are like others. */
static void ndli_remesh_mark(ndl_remesh *r, int needle, int in)
{
    const ndli_needle *n = r->needles + needle;
    for (int i = 0; i < n->count; i++) {
        if (in) {
            r->mesh->node_flags[n->nodes[i]] |= NDLI_NODE_NEEDLE;
            r->mesh->owner[n->nodes[i]] = needle;
        } else {
            ndli_remesh_release_node(r, n->nodes[i]);
        }
    }
}

static sb_result ndli_remesh_do_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error)
{
    sb_result result = ndli_remesh_begin_call(remesh, needle, -1, info, error);
    int others = 0, count;
    if (result != SB_OK || !remesh->needles[needle].count)
        return result;
    count = remesh->needles[needle].count;
    ndli_remesh_mark(remesh, needle, 0);
    remesh->needles[needle].count = 0;
    for (int i = 0; i < remesh->def.max_needles; i++)
        others += remesh->needles[i].count > 0;
    if (others)
        ndli_remesh_restore_partly(remesh);
    else
        result = ndli_remesh_restore(remesh, error);
    if (result != SB_OK) {
        remesh->needles[needle].count = count;
        ndli_remesh_mark(remesh, needle, 1);
        return result;
    }
    remesh->info.outside = 1;
    if (info)
        *info = remesh->info;
    return SB_OK;
}

NDL_API sb_result ndl_remesh_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error)
{
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_do_withdraw(remesh, needle, info, error);
    ndli_remesh_tell_withdraw(remesh, needle, result);
    return result;
}

NDLI_API void ndli_remesh_let_go(ndl_remesh *remesh, int needle)
{
    if (ndl_remesh_withdraw(remesh, needle, NULL, NULL) == SB_OK)
        return;
    if (!remesh->stale)
        ndli_remesh_mark(remesh, needle, 0);
    remesh->needles[needle].count = 0;
}

NDL_API const int *ndl_remesh_nodes(const ndl_remesh *remesh, int needle, int *count)
{
    int known = remesh && needle >= 0 && needle < remesh->def.max_needles && remesh->needles[needle].count;
    if (count)
        *count = known ? remesh->needles[needle].count : 0;
    return known ? remesh->needles[needle].nodes : NULL;
}

NDL_API int ndl_remesh_material_point(const ndl_remesh *remesh, int needle, sb_vec3 x, sb_vec3 *X)
{
    const ndli_topology *mesh;
    int count, start, tet;
    const int *nodes = ndl_remesh_nodes(remesh, needle, &count);
    sb_real most = -SB_REAL_MAX;
    if (!nodes || !X || !sb_v3_is_finite(x))
        return 0;
    mesh = remesh->mesh;
    start = mesh->node_star[nodes[count - 1]] / 4;
    tet = ndli_topology_find_in_space(mesh, x, start);
    for (int k = tet < 0 ? mesh->node_star[nodes[count - 1]] : -1; k >= 0; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_real w[4], least;
        ndli_tet_weights(mesh->x[n[0]], mesh->x[n[1]], mesh->x[n[2]], mesh->x[n[3]], x, w);
        least = sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
        if (least > most) {
            most = least;
            start = k / 4;
        }
    }
    {
        const int *n = mesh->tets + 4 * (size_t)(tet < 0 ? start : tet);
        sb_real w[4];
        ndli_tet_weights(mesh->x[n[0]], mesh->x[n[1]], mesh->x[n[2]], mesh->x[n[3]], x, w);
        *X = sb_v3(0, 0, 0);
        for (int c = 0; c < 4; c++)
            *X = sb_v3_madd(*X, w[c], mesh->X[n[c]]);
    }
    return tet >= 0;
}

NDL_API int ndl_remesh_split_count(const ndl_remesh *remesh, int needle)
{
    return remesh && needle >= 0 && needle < remesh->def.max_needles ? remesh->needles[needle].depth : 0;
}

NDL_API int ndl_remesh_hit(const ndl_remesh *remesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit)
{
    return remesh && !remesh->stale ? ndli_topology_hit(remesh->mesh, from, to, hit) : 0;
}

NDL_API void ndl_remesh_quality(const ndl_remesh *remesh, sb_real *worst_quality, sb_real *min_dihedral,
                                sb_real *max_dihedral)
{
    if (remesh && !remesh->stale)
        ndli_topology_quality(remesh->mesh, worst_quality, min_dihedral, max_dihedral);
}

NDL_API int ndl_remesh_is_original(const ndl_remesh *remesh)
{
    return remesh && (remesh->stale || ndli_topology_is_original(remesh->mesh));
}

/* Whether the body has these tets at these places. */
static sb_result ndli_remesh_check_cells(const ndl_remesh *r, sb_error *error)
{
    const ndli_topology *mesh = r->mesh;
    const sb_vec3 *X = sb_body_rest_positions(r->body);
    for (int t = 0; t < mesh->tet_end; t++) {
        const int *own = mesh->tets + 4 * (size_t)t, *cell = sb_body_cell_nodes(r->body, t);
        if ((own[0] >= 0) != (cell != NULL) || (cell && memcmp(own, cell, 4 * sizeof(int)) != 0))
            return sbi_fail_element(error, SB_ERROR_MESH, t, "tet %d is not the body's", t);
        for (int c = 0; cell && c < 4; c++)
            if (memcmp(X + cell[c], mesh->X + cell[c], sizeof *X) != 0)
                return sbi_fail_node(error, SB_ERROR_MESH, cell[c], "node %d is elsewhere in the body", cell[c]);
    }
    return SB_OK;
}

NDL_API sb_result ndl_remesh_check(const ndl_remesh *remesh, sb_error *error)
{
    sb_result result;
    if (!remesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "remesh is NULL");
    if (remesh->stale)
        return SB_OK;
    result = ndli_topology_check(remesh->mesh, error);
    return result == SB_OK ? ndli_remesh_check_cells(remesh, error) : result;
}

/* ---- recording ---- */

static sb_result ndli_remesh_repeat(ndl_remesh *r, const int *ints, size_t int_count, const sb_real *reals,
                                    size_t real_count, sb_error *error)
{
    int needle = ints[1];
    if (ints[0] == NDLI_COMMAND_PUNCTURE && int_count == 5 && real_count == 5) {
        ndl_surface_hit hit;
        hit.tet = ints[3], hit.face = ints[4], hit.along = reals[0], hit.X = sb_v3(reals[1], reals[2], reals[3]);
        return ndli_remesh_puncture_within(r, needle, &hit, reals[4], NULL, error);
    }
    if (ints[0] == NDLI_COMMAND_PENETRATE && real_count == 3)
        return ndl_remesh_penetrate(r, needle, sb_v3(reals[0], reals[1], reals[2]), NULL, error);
    if (ints[0] == NDLI_COMMAND_RETRACT && real_count == 3)
        return ndl_remesh_retract(r, needle, sb_v3(reals[0], reals[1], reals[2]), NULL, error);
    if (ints[0] == NDLI_COMMAND_WITHDRAW)
        return ndl_remesh_withdraw(r, needle, NULL, error);
    return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a command of a remesher that there is not");
}

static sb_result ndli_remesh_replay_part(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                         size_t real_count, sb_error *error)
{
    ndl_remesh *r = (ndl_remesh *)user;
    sb_result result;
    if (int_count < 3)
        return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a command of a remesher that ends early");
    if (ints[0] == NDLI_COMMAND_MADE || ints[0] == NDLI_COMMAND_GONE)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "the recorded body's remesher was %s while it was recorded: what "
                        "follows cannot be played",
                        ints[0] == NDLI_COMMAND_MADE ? "made" : "destroyed");
    ndli_remesh_hush(r);
    result = ndli_remesh_repeat(r, ints, int_count, reals, real_count, error);
    ndli_remesh_tell(r, result == SB_ERROR_FORMAT ? NULL : ints, int_count, reals, real_count);
    if (result == SB_ERROR_FORMAT)
        return result;
    if ((int)result != ints[2])
        return sbi_fail(error, SB_ERROR_STATE, "a call of the remesher returns '%s' where '%s' was recorded",
                        sb_result_string(result), sb_result_string((sb_result)ints[2]));
    return SB_OK;
}

/* ---- creation ---- */

static sb_result ndli_remesh_check_body(const sb_body *body, sb_error *error)
{
    if (sbi_body_mesh(body).element_type != SB_TET4)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needles and remeshers need a body of SB_TET4: its elements are others");
    if (sbi_body_node_slots(body).room == 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needles and remeshers change the mesh: make the body with def.slack > 0");
    return SB_OK;
}

static sb_result ndli_remesh_fill(ndl_remesh *r, sb_error *error)
{
    sb_body_listener listener;
    sb_result result;
    memset(&listener, 0, sizeof listener);
    listener.user = r;
    listener.reserve = ndli_remesh_hear;
    listener.follow = ndli_remesh_follow;
    r->needles = (ndli_needle *)sbi_alloc_zeroed(&r->def.allocator, (size_t)r->def.max_needles, sizeof(ndli_needle));
    if (!r->needles || !ndli_remesh_scratch(r, 256) || !ndli_topology_read(r->mesh, r->body))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a remesher of %d needles", r->def.max_needles);
    result = sb_body_listen(r->body, &listener, &r->listener, error);
    return result == SB_OK ? ndli_remesh_join(r, ndli_remesh_replay_part, error) : result;
}

NDL_API sb_result ndl_remesh_create(const ndl_remesh_def *def, ndl_remesh **remesh, sb_error *error)
{
    ndl_remesh *made;
    sb_result result = ndli_remesh_check_def(def, error);
    if (result == SB_OK && !remesh)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "remesh is NULL");
    if (result == SB_OK)
        result = ndli_remesh_check_body(def->body, error);
    if (result != SB_OK)
        return result;
    made = (ndl_remesh *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a remesher of %d needles", def->max_needles);
    made->def = *def;
    made->body = def->body;
    made->mesh = &made->topology;
    made->topology.allocator = def->allocator;
    result = ndli_remesh_fill(made, error);
    if (result != SB_OK) {
        ndl_remesh_destroy(made);
        return result;
    }
    *remesh = made;
    return SB_OK;
}

NDL_API void ndl_remesh_destroy(ndl_remesh *remesh)
{
    sb_allocator allocator;
    if (!remesh)
        return;
    allocator = remesh->def.allocator;
    ndli_remesh_leave(remesh);
    if (remesh->listener)
        sb_body_unlisten(remesh->body, remesh->listener);
    ndli_remesh_free_knowledge(remesh);
    sbi_free(&allocator, remesh->scratch);
    sbi_free(&allocator, remesh);
}

NDL_API sb_result ndl_remesh_reserve(ndl_remesh *remesh, int needle, int nodes, sb_error *error)
{
    ndli_needle *n;
    int counts[3];
    if (!remesh || nodes < 0 || nodes > INT_MAX / (4 * NDLI_USUAL_POOL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no memory can be taken for a needle of %d nodes", nodes);
    if (needle < 0 || needle >= remesh->def.max_needles)
        return sbi_fail(error, SB_ERROR_INDEX, "needle %d of %d", needle, remesh->def.max_needles);
    n = remesh->needles + needle;
    counts[0] = counts[1] = nodes;
    counts[2] = (nodes + 1) * NDLI_USUAL_POOL + 2 * NDLI_USUAL_PATCH + 8;
    if (!ndli_remesh_make_room(remesh, n, counts) || !ndli_remesh_scratch(remesh, NDLI_USUAL_PATCH))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", nodes);
    return SB_OK;
}
