/* state: a tissue's state holds what cannot be computed again: mesh, motion, supports, rotations with their lag, the
 * coarse matrix of some steps ago, the ledger. Rows, edges and stiffness are functions of these. A load therefore takes
 * out of the matrix the tets that the state has otherwise, and puts the state's in: its cost follows what differs. */
#include "state.h"

#include "image.h"
#include "rod_private.h"
#include "tissue_private.h"

#include <limits.h>

static const char ndli_tissue_magic[9] = "NDLTISS\x1a";
static const char ndli_rod_magic[9] = "NDLROD\x1a\x1a";

/* ---- what a tissue's image holds ---- */

typedef struct ndli_tissue_head {
    uint64_t make;
    double damping_mass, damping_stiffness, gravity[3], made_mass, made_stiffness;
    double elastic, ledger, work, work_unit, left_at;
    int order, material_count;
    int node_end, tet_end, node_count, tet_count, free_node, free_tet, displaced_count;
    int changed, seen, acceleration_known, ledger_open;
    int coarse_usable, coarse_age, coarse_fresh, coarse_wasted, coarse_width, coarse_count, unused;
} ndli_tissue_head;

/* Where parts begin that are compared or checked before they are read. */
typedef struct ndli_tissue_places {
    size_t lame, X, X0, x, v, a, mass, owner, star, displaced, displaced_at, flags;
    size_t tets, neighbours, next, prev, regions, density, volumes, qualities;
    size_t force, target, target_velocity, reaction, internal, arm, aggregate, role, has_velocity;
    size_t quats, old_quats, stale, centre, inverse_radius, factor;
    size_t end;
} ndli_tissue_places;

static int ndli_state_has_seen(const ndl_tissue *t)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    return t->seen_end == mesh->node_end &&
           memcmp(t->seen_x, mesh->x, (size_t)mesh->node_end * sizeof(sb_vec3)) == 0;
}

static void ndli_state_fill_head(const ndl_tissue *t, ndli_tissue_head *h)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    memset(h, 0, sizeof *h);
    h->make = t->make;
    h->damping_mass = (double)t->damping_mass, h->damping_stiffness = (double)t->damping_stiffness;
    h->gravity[0] = (double)t->gravity.x, h->gravity[1] = (double)t->gravity.y, h->gravity[2] = (double)t->gravity.z;
    h->made_mass = (double)t->coarse.made_mass, h->made_stiffness = (double)t->coarse.made_stiffness;
    h->elastic = t->elastic, h->ledger = t->ledger, h->work = t->work, h->work_unit = t->work_unit;
    h->left_at = t->left_at;
    h->order = NDLI_IMAGE_ORDER;
    h->material_count = t->material_count;
    h->node_end = mesh->node_end, h->tet_end = mesh->tet_end;
    h->node_count = mesh->node_count, h->tet_count = mesh->tet_count;
    h->free_node = mesh->free_node, h->free_tet = mesh->free_tet;
    h->displaced_count = mesh->displaced_count;
    h->changed = t->changed;
    h->seen = ndli_state_has_seen(t);
    h->acceleration_known = t->acceleration_known;
    h->ledger_open = t->ledger_open;
    h->coarse_usable = t->coarse.usable, h->coarse_age = t->coarse.age, h->coarse_fresh = t->coarse.fresh_iterations;
    h->coarse_wasted = t->coarse.wasted, h->coarse_width = t->coarse.width, h->coarse_count = t->coarse.count;
}

static void ndli_state_take_head(ndl_tissue *t, const ndli_tissue_head *h)
{
    ndl_tissue_mesh *mesh = &t->mesh;
    t->damping_mass = (sb_real)h->damping_mass, t->damping_stiffness = (sb_real)h->damping_stiffness;
    t->gravity = sb_v3((sb_real)h->gravity[0], (sb_real)h->gravity[1], (sb_real)h->gravity[2]);
    t->coarse.made_mass = (sb_real)h->made_mass, t->coarse.made_stiffness = (sb_real)h->made_stiffness;
    t->elastic = h->elastic, t->ledger = h->ledger, t->work = h->work, t->work_unit = h->work_unit;
    t->left_at = h->left_at;
    mesh->node_end = h->node_end, mesh->tet_end = h->tet_end;
    mesh->node_count = h->node_count, mesh->tet_count = h->tet_count;
    mesh->free_node = h->free_node, mesh->free_tet = h->free_tet;
    mesh->displaced_count = h->displaced_count;
    t->acceleration_known = h->acceleration_known;
    t->ledger_open = h->ledger_open;
    t->coarse.usable = h->coarse_usable, t->coarse.age = h->coarse_age, t->coarse.fresh_iterations = h->coarse_fresh;
    t->coarse.wasted = h->coarse_wasted, t->coarse.width = h->coarse_width;
}

static size_t ndli_state_lanes(int tets)
{
    return ((size_t)tets + SB_POLAR_LANES - 1) / SB_POLAR_LANES * SB_POLAR_LANES;
}

/* The mesh, which rows and edges follow. */
static void ndli_state_walk_mesh(ndl_tissue *t, const ndli_tissue_head *h, ndli_image *image, ndli_tissue_places *p)
{
    ndl_tissue_mesh *mesh = &t->mesh;
    size_t nodes = (size_t)h->node_end, tets = (size_t)h->tet_end;
    p->lame = ndli_image_part(image, t->lame, (size_t)h->material_count, 2 * sizeof(sb_real));
    p->X = ndli_image_part(image, mesh->X, nodes, sizeof(sb_vec3));
    p->X0 = ndli_image_part(image, mesh->X0, nodes, sizeof(sb_vec3));
    p->x = ndli_image_part(image, mesh->x, nodes, sizeof(sb_vec3));
    p->v = ndli_image_part(image, mesh->v, nodes, sizeof(sb_vec3));
    p->a = ndli_image_part(image, mesh->a, nodes, sizeof(sb_vec3));
    p->mass = ndli_image_part(image, mesh->mass, nodes, sizeof(sb_real));
    p->owner = ndli_image_part(image, mesh->owner, nodes, sizeof(int));
    p->star = ndli_image_part(image, mesh->node_star, nodes, sizeof(int));
    p->displaced = ndli_image_part(image, mesh->displaced, (size_t)h->displaced_count, sizeof(int));
    p->displaced_at = ndli_image_part(image, mesh->displaced_at, nodes, sizeof(int));
    p->flags = ndli_image_part(image, mesh->node_flags, nodes, 1);
    p->tets = ndli_image_part(image, mesh->tets, tets, 4 * sizeof(int));
    p->neighbours = ndli_image_part(image, mesh->neighbours, tets, 4 * sizeof(int));
    p->next = ndli_image_part(image, mesh->corner_next, tets, 4 * sizeof(int));
    p->prev = ndli_image_part(image, mesh->corner_prev, tets, 4 * sizeof(int));
    p->regions = ndli_image_part(image, mesh->regions, tets, sizeof(int));
    p->density = ndli_image_part(image, mesh->tet_density, tets, sizeof(sb_real));
    p->volumes = ndli_image_part(image, mesh->volumes, tets, sizeof(sb_real));
    p->qualities = ndli_image_part(image, mesh->qualities, tets, sizeof(sb_real));
}

static void ndli_state_walk_solid(ndl_tissue *t, const ndli_tissue_head *h, ndli_image *image, ndli_tissue_places *p)
{
    size_t nodes = (size_t)h->node_end, tets = (size_t)h->tet_end, lanes = ndli_state_lanes(h->tet_end);
    size_t aggregates = (size_t)h->coarse_count;
    p->force = ndli_image_part(image, t->force, nodes, sizeof(sb_vec3));
    p->target = ndli_image_part(image, t->target, nodes, sizeof(sb_vec3));
    p->target_velocity = ndli_image_part(image, t->target_velocity, nodes, sizeof(sb_vec3));
    p->reaction = ndli_image_part(image, t->reaction, nodes, sizeof(sb_vec3));
    p->internal = ndli_image_part(image, t->internal, h->seen ? nodes : 0, sizeof(sb_vec3));
    p->arm = ndli_image_part(image, t->arm, nodes, sizeof(sb_vec3));
    p->aggregate = ndli_image_part(image, t->aggregate, nodes, sizeof(int));
    p->role = ndli_image_part(image, t->role, nodes, 1);
    p->has_velocity = ndli_image_part(image, t->has_velocity, nodes, 1);
    p->quats = ndli_image_part(image, t->quats, lanes, 4 * sizeof(sb_real));
    p->old_quats = ndli_image_part(image, t->old_quats, lanes, 4 * sizeof(sb_real));
    p->stale = ndli_image_part(image, t->stale_tet, tets, 1);
    p->centre = ndli_image_part(image, t->coarse.centre, aggregates, sizeof(sb_vec3));
    p->inverse_radius = ndli_image_part(image, t->coarse.inverse_radius, aggregates, sizeof(sb_real));
    p->factor = ndli_image_part(image, t->coarse.factor, h->coarse_usable ? 6 * aggregates : 0,
                                ((size_t)h->coarse_width + 1) * sizeof(double));
    p->end = image->used;
}

/* Bytes of an image from its head on, and where they lie. */
static size_t ndli_state_measure(ndl_tissue *t, ndli_tissue_head *h, ndli_tissue_places *places, int *overflow)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    ndli_image_part(&image, h, 1, sizeof *h);
    ndli_state_walk_mesh(t, h, &image, places);
    ndli_state_walk_solid(t, h, &image, places);
    *overflow = image.overflow;
    return image.used;
}

static void ndli_state_write(ndl_tissue *t, unsigned char *out)
{
    ndli_tissue_head head;
    ndli_tissue_places places;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.out = out;
    ndli_state_fill_head(t, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_state_walk_mesh(t, &head, &image, &places);
    ndli_state_walk_solid(t, &head, &image, &places);
}

/* ---- taking a state ---- */

/* Marks of tets (turned) whose rotated gradients are to be made anew: rest data differ, or only the rotation. */
enum { NDLI_STATE_TURNED = 1, NDLI_STATE_NEW = 2 };

/* Marks what the state has otherwise; takes tets with other nodes out of the matrix. Returns 1 when there are such. */
static int ndli_state_compare(ndl_tissue *t, const ndli_tissue_head *h, const ndli_tissue_places *p,
                              const unsigned char *in, int tets)
{
    ndl_tissue_mesh *mesh = &t->mesh;
    int nodes = sbi_min_int(mesh->node_end, h->node_end), differs = 0;
    int materials_differ = memcmp(t->lame, in + p->lame, (size_t)t->material_count * 2 * sizeof(sb_real)) != 0;
    for (int i = 0; i < nodes; i++)
        mesh->node_mark[i] = memcmp(mesh->X + i, in + p->X + (size_t)i * sizeof(sb_vec3), sizeof(sb_vec3)) != 0;
    for (int e = 0; e < tets; e++) {
        const int *n = mesh->tets + 4 * (size_t)e;
        int was = e < mesh->tet_end && n[0] >= 0, n_then[4] = {-1, -1, -1, -1}, same, is_new;
        if (e < h->tet_end)
            memcpy(n_then, in + p->tets + (size_t)e * sizeof n_then, sizeof n_then);
        same = was ? memcmp(n, n_then, sizeof n_then) == 0 : n_then[0] < 0;
        if (same && was)
            is_new = materials_differ | t->stale_tet[e] | mesh->node_mark[n[0]] | mesh->node_mark[n[1]] |
                     mesh->node_mark[n[2]] | mesh->node_mark[n[3]];
        else
            is_new = n_then[0] >= 0;
        t->turned[e] = (unsigned char)(is_new ? NDLI_STATE_NEW : 0);
        if (same)
            continue;
        differs = 1;
        if (was && !t->broken)
            ndli_solid_leave(t, e);
        mesh->tet_mark[e] = 1;
    }
    for (int i = 0; i < nodes; i++)
        mesh->node_mark[i] = 0;
    return differs;
}

static void ndli_state_forget_tet(ndl_tissue *t, int tet)
{
    size_t at = (size_t)(tet / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + (size_t)(tet % SB_POLAR_LANES);
    ndli_solid_blank(t, tet);
    for (size_t k = 0; k < 4; k++)
        t->old_quats[at + k * SB_POLAR_LANES] = k == 0 ? (sb_real)1 : (sb_real)0;
}

/* Rest data and rows after the mesh is the state's. */
static void ndli_state_join(ndl_tissue *t, int tets, int differs)
{
    ndl_tissue_mesh *mesh = &t->mesh;
    int whole = t->broken;
    for (int e = 0; e < tets; e++) {
        int is = e < mesh->tet_end && mesh->tets[4 * (size_t)e] >= 0;
        if (is && (t->turned[e] & NDLI_STATE_NEW))
            ndli_solid_measure(t, e);
        else if (e >= mesh->tet_end)
            ndli_state_forget_tet(t, e);
        else if (mesh->tet_mark[e] && !is)
            ndli_solid_blank(t, e);
        if (mesh->tet_mark[e] && is && !whole)
            whole = !ndli_solid_join(t, e);
        mesh->tet_mark[e] = 0;
    }
    if (differs && whole) {
        int made = ndli_solid_rebuild(t);
        SB_ASSERT(made);
        (void)made;
        for (int e = 0; e < mesh->tet_end; e++)
            t->turned[e] = mesh->tets[4 * (size_t)e] >= 0;
    }
}

/* Slots that the state does not know are as they were before anything was in them, so that later states are equal in
 * all bytes, too. */
static void ndli_state_forget_nodes(ndl_tissue *t, int from, int to)
{
    for (int i = from; i < to; i++) {
        t->mesh.node_flags[i] = 0;
        t->role[i] = NDLI_ROW_ABSENT;
        t->has_velocity[i] = 0;
        t->mesh.mass[i] = 0;
        t->mesh.owner[i] = t->mesh.node_star[i] = t->mesh.displaced_at[i] = -1;
        t->force[i] = t->reaction[i] = t->target[i] = t->target_velocity[i] = sb_v3(0, 0, 0);
    }
}

/* Rotated gradients and stiffness where turned, by the state's old rotations. */
static void ndli_state_turn(ndl_tissue *t)
{
    int batches = (int)(ndli_state_lanes(t->mesh.tet_end) / SB_POLAR_LANES);
    for (int batch = 0; batch < batches; batch++) {
        int first = batch * SB_POLAR_LANES, last = sbi_min_int(t->mesh.tet_end, first + SB_POLAR_LANES), any = 0;
        for (int e = first; e < last; e++)
            any |= t->turned[e] = t->turned[e] != 0 && !t->stale_tet[e];
        if (any)
            ndli_solid_rotate(t, batch);
    }
    ndli_solid_stiffness(t);
}

/* Adds to `turned` the tets whose stiffness has another rotation in the state. */
static void ndli_state_compare_rotations(ndl_tissue *t, const ndli_tissue_head *h, const unsigned char *old_quats)
{
    size_t batch_bytes = 4 * SB_POLAR_LANES * sizeof(sb_real);
    int tets = sbi_min_int(t->mesh.tet_end, h->tet_end);
    SB_ASSERT(h->tet_end <= t->tet_room);
    for (int first = 0; first < tets; first += SB_POLAR_LANES) {
        const sb_real *now = t->old_quats + 4 * (size_t)first;
        const unsigned char *then = old_quats + 4 * (size_t)first * sizeof(sb_real);
        int last = sbi_min_int(tets, first + SB_POLAR_LANES);
        if (memcmp(now, then, batch_bytes) == 0)
            continue;
        for (int e = first; e < last; e++)
            for (int k = 0; k < 4; k++) {
                size_t at = (size_t)(k * SB_POLAR_LANES + e - first);
                if (memcmp(now + at, then + at * sizeof(sb_real), sizeof(sb_real)) != 0)
                    t->turned[e] |= NDLI_STATE_TURNED;
            }
    }
}

/* The tissue becomes what the image tells. There is memory. */
static void ndli_state_take(ndl_tissue *t, const unsigned char *in)
{
    ndli_tissue_head head;
    ndli_tissue_places places;
    ndli_image image;
    int overflow, differs, tets, nodes = t->mesh.node_end, whole = t->broken;
    memcpy(&head, in, sizeof head);
    ndli_state_measure(t, &head, &places, &overflow);
    memset(&image, 0, sizeof image);
    image.in = in;
    tets = sbi_min_int(t->tet_room, sbi_max_int(t->mesh.tet_end, head.tet_end)); /* broken: the mesh may have more */
    differs = ndli_state_compare(t, &head, &places, in, tets) | whole;
    ndli_state_compare_rotations(t, &head, in + places.old_quats);
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_state_walk_mesh(t, &head, &image, &places);
    ndli_state_forget_nodes(t, head.node_end, sbi_min_int(nodes, t->node_room));
    ndli_state_take_head(t, &head);
    ndli_state_join(t, tets, differs);
    ndli_state_walk_solid(t, &head, &image, &places);
    ndli_state_turn(t);
    t->inverse_valid = t->coarse.listed = 0;
    t->changed = head.changed;
    t->seen_end = 0;
    if (head.seen) {
        memcpy(t->seen_x, t->mesh.x, (size_t)head.node_end * sizeof(sb_vec3));
        t->seen_end = head.node_end;
    }
}

/* ---- checking a tissue's image ---- */

typedef struct ndli_state_reader {
    const unsigned char *in;
    const ndli_tissue_head *head;
    const ndli_tissue_places *places;
} ndli_state_reader;

static int ndli_state_lives(const ndli_state_reader *r, int node)
{
    return node >= 0 && node < r->head->node_end && r->in[r->places->flags + (size_t)node] != 0;
}

static int ndli_state_tet_lives(const ndli_state_reader *r, int tet)
{
    return tet >= 0 && tet < r->head->tet_end && ndli_image_int(r->in + r->places->tets, 4 * (size_t)tet) >= 0;
}

/* Whether the corner is one of its node's ring: what follows is of a tet in use, and a ring's first has none before it,
 * so that none goes round. */
static int ndli_state_corner_holds(const ndli_state_reader *r, int corner)
{
    const ndli_tissue_places *p = r->places;
    size_t at = (size_t)corner;
    int node = ndli_image_int(r->in + p->tets, at), next = ndli_image_int(r->in + p->next, at);
    int prev = ndli_image_int(r->in + p->prev, at), corners = 4 * r->head->tet_end;
    if (!ndli_state_lives(r, node) || next < -1 || next >= corners || prev < -1 || prev >= corners)
        return 0;
    if (next >= 0 && (!ndli_state_tet_lives(r, next / 4) || ndli_image_int(r->in + p->prev, (size_t)next) != corner ||
                      ndli_image_int(r->in + p->tets, (size_t)next) != node))
        return 0;
    return prev >= 0 ? ndli_image_int(r->in + p->next, (size_t)prev) == corner && ndli_state_tet_lives(r, prev / 4)
                     : ndli_image_int(r->in + p->star, (size_t)node) == corner;
}

static void ndli_state_nodes_of(const ndli_state_reader *r, int tet, int nodes[4])
{
    memcpy(nodes, r->in + r->places->tets + 4 * (size_t)tet * sizeof(int), 4 * sizeof(int));
}

/* Whether the tet has the nodes of another's face, which lies opposite the other's corner. */
static int ndli_state_has_face(const ndli_state_reader *r, int tet, const int other[4], int corner)
{
    int nodes[4], shared = 0;
    ndli_state_nodes_of(r, tet, nodes);
    for (int c = 0; c < 4; c++)
        for (int k = 0; k < 4; k++)
            shared += c != corner && nodes[k] == other[c];
    return shared == 3;
}

/* Whether both sides of the tet's faces know each other, and faces without another side have none. Rings are sound. */
static int ndli_state_faces_hold(const ndli_state_reader *r, int tet)
{
    const ndli_tissue_places *p = r->places;
    int nodes[4];
    ndli_state_nodes_of(r, tet, nodes);
    for (int c = 0; c < 4; c++) {
        int other = ndli_image_int(r->in + p->neighbours, 4 * (size_t)tet + (size_t)c), back = 0;
        int node = nodes[(c + 1) % 4];
        for (int k = 0; other >= 0 && k < 4; k++)
            back |= ndli_image_int(r->in + p->neighbours, 4 * (size_t)other + (size_t)k) == tet;
        if (other >= 0 && (other == tet || !back || !ndli_state_has_face(r, other, nodes, c)))
            return 0;
        for (int k = other < 0 ? ndli_image_int(r->in + p->star, (size_t)node) : -1; k >= 0;
             k = ndli_image_int(r->in + p->next, (size_t)k))
            if (k / 4 != tet && ndli_state_has_face(r, k / 4, nodes, c))
                return 0;
    }
    return 1;
}

static int ndli_state_tet_holds(const ndl_tissue *t, const ndli_state_reader *r, int tet)
{
    int region = ndli_image_int(r->in + r->places->regions, (size_t)tet);
    if (t->material_count > 1 && (region < 0 || region >= t->material_count))
        return 0;
    for (int c = 0; c < 4; c++) {
        int corner = 4 * tet + c, other = ndli_image_int(r->in + r->places->neighbours, (size_t)corner);
        if (!ndli_state_corner_holds(r, corner) || (other != -1 && !ndli_state_tet_lives(r, other)))
            return 0;
        for (int d = 0; d < c; d++)
            if (ndli_image_int(r->in + r->places->tets, (size_t)corner) ==
                ndli_image_int(r->in + r->places->tets, (size_t)(4 * tet + d)))
                return 0;
    }
    return 1;
}

/* Corners in the ring of a node that the checks of corners have passed; -1: what is told of the node is wrong. */
static int ndli_state_node_holds(const ndl_tissue *t, const ndli_state_reader *r, int node)
{
    const ndli_tissue_places *p = r->places;
    size_t at = (size_t)node;
    int role = r->in[p->role + at], flags = r->in[p->flags + at], lives = flags != 0, count = 0;
    int aggregate = ndli_image_int(r->in + p->aggregate, at), place = ndli_image_int(r->in + p->displaced_at, at);
    int original = node < t->mesh.original_nodes, star = ndli_image_int(r->in + p->star, at);
    int created = (flags & NDL_NODE_CREATED) != 0;
    int moved = lives && original &&
                memcmp(r->in + p->X + at * sizeof(sb_vec3), r->in + p->X0 + at * sizeof(sb_vec3), sizeof(sb_vec3)) != 0;
    if (role > NDLI_ROW_ABSENT || (role == NDLI_ROW_ABSENT) != !lives || r->in[p->has_velocity + at] > 1 ||
        (lives && !(flags & NDL_NODE_ALIVE)) || flags > 2 * NDL_NODE_NEEDLE - 1 || aggregate < 0 ||
        aggregate >= t->coarse.count || ndli_image_int(r->in + p->owner, at) < -1 || (original && !lives) ||
        (lives && original == created))
        return -1;
    if (place < -1 || place >= r->head->displaced_count || (place >= 0) != moved ||
        (place >= 0 && ndli_image_int(r->in + p->displaced, (size_t)place) != node))
        return -1;
    if (!lives)
        return 0;
    if (star < 0 || star >= 4 * r->head->tet_end || !ndli_state_tet_lives(r, star / 4) ||
        ndli_image_int(r->in + p->prev, (size_t)star) != -1)
        return -1;
    for (int k = star; k != -1; k = ndli_image_int(r->in + p->next, (size_t)k)) {
        if (ndli_image_int(r->in + p->tets, (size_t)k) != node)
            return -1;
        count++;
    }
    return count;
}

/* Whether a list of free slots has so many, none of them in use. */
static int ndli_state_list_holds(const ndli_state_reader *r, int first, int count, int of_tets)
{
    int end = of_tets ? r->head->tet_end : r->head->node_end;
    for (; count > 0 && first >= 0 && first < end; count--) {
        if (of_tets ? ndli_state_tet_lives(r, first) : ndli_state_lives(r, first))
            return 0;
        first = of_tets ? ndli_image_int(r->in + r->places->neighbours, 4 * (size_t)first)
                        : ndli_image_int(r->in + r->places->star, (size_t)first);
    }
    return count == 0 && first == -1;
}

static sb_result ndli_state_check_topology(const ndl_tissue *t, const ndli_state_reader *r, sb_error *error)
{
    const ndli_tissue_head *h = r->head;
    int tets = 0, nodes = 0;
    int64_t corners = 0;
    for (int e = 0; e < h->tet_end; e++) {
        int lives = ndli_state_tet_lives(r, e);
        if (lives ? !ndli_state_tet_holds(t, r, e) : e < t->mesh.original_tets)
            return sbi_fail_element(error, SB_ERROR_FORMAT, e, "the saved tissue is damaged at tet %d", e);
        tets += lives;
    }
    for (int i = 0; i < h->node_end; i++) {
        int count = ndli_state_node_holds(t, r, i);
        if (count < 0)
            return sbi_fail_node(error, SB_ERROR_FORMAT, i, "the saved tissue is damaged at node %d", i);
        nodes += count > 0;
        corners += count;
    }
    for (int e = 0; e < h->tet_end; e++)
        if (ndli_state_tet_lives(r, e) && !ndli_state_faces_hold(r, e))
            return sbi_fail_element(error, SB_ERROR_FORMAT, e, "the saved tissue is damaged: tet %d and a neighbour "
                                    "disagree", e);
    for (int i = 0; i < h->displaced_count; i++) {
        int node = ndli_image_int(r->in + r->places->displaced, (size_t)i);
        if (!ndli_state_lives(r, node) || ndli_image_int(r->in + r->places->displaced_at, (size_t)node) != i)
            return sbi_fail(error, SB_ERROR_FORMAT, "the saved tissue is damaged: node %d is not displaced", node);
    }
    if (tets != h->tet_count || nodes != h->node_count || corners != 4 * (int64_t)tets ||
        !ndli_state_list_holds(r, h->free_tet, h->tet_end - h->tet_count, 1) ||
        !ndli_state_list_holds(r, h->free_node, h->node_end - h->node_count, 0))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved tissue is damaged: slots in use and free ones disagree");
    return SB_OK;
}

/* ---- numbers ---- */

static sb_real ndli_state_real(const unsigned char *array, size_t i)
{
    sb_real value;
    memcpy(&value, array + i * sizeof value, sizeof value);
    return value;
}

static sb_vec3 ndli_state_vector(const unsigned char *array, int i)
{
    sb_vec3 value;
    memcpy(&value, array + (size_t)i * sizeof value, sizeof value);
    return value;
}

static int ndli_state_is_positive(sb_real value) { return value > 0 && value <= SB_REAL_MAX; }

static int ndli_state_all_finite(const ndli_state_reader *r)
{
    const ndli_tissue_places *p = r->places;
    const ndli_tissue_head *h = r->head;
    const size_t vectors[] = {p->X,     p->X0,     p->x,               p->v,        p->a,
                              p->force, p->target, p->target_velocity, p->reaction, p->arm};
    size_t nodes = 3 * (size_t)h->node_end, aggregates = (size_t)h->coarse_count, factor = 6 * aggregates;
    int good = ndli_image_is_finite(r->in + p->internal, h->seen ? nodes : 0) &&
               ndli_image_is_finite(r->in + p->centre, 3 * aggregates) &&
               ndli_image_is_finite(r->in + p->inverse_radius, aggregates) &&
               ndli_image_is_finite(r->in + p->quats, 4 * ndli_state_lanes(h->tet_end)) &&
               ndli_image_is_finite(r->in + p->old_quats, 4 * ndli_state_lanes(h->tet_end));
    for (size_t k = 0; k < sizeof vectors / sizeof *vectors; k++)
        good = good && ndli_image_is_finite(r->in + vectors[k], nodes);
    for (size_t i = 0; i < 12 + (h->coarse_usable ? factor * ((size_t)h->coarse_width + 1) : 0); i++) {
        double value;
        memcpy(&value, r->in + (i < 12 ? sizeof(uint64_t) + i * sizeof value : p->factor + (i - 12) * sizeof value),
               sizeof value);
        good = good && value - value == 0;
    }
    return good;
}

/* Whether a rotation is one, but for rounding: what is not even near would make numbers that are none. */
static int ndli_state_turns(const unsigned char *quats, int tet)
{
    size_t at = (size_t)(tet / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + (size_t)(tet % SB_POLAR_LANES);
    sb_real square = 0;
    for (size_t k = 0; k < 4; k++) {
        sb_real q = ndli_state_real(quats, at + k * SB_POLAR_LANES);
        square += q * q;
    }
    return square > (sb_real)0.9 && square < (sb_real)1.1;
}

/* Volume and quality that are told and those that the corners have, the density, the rotations. */
static int ndli_state_tet_measures(const ndli_state_reader *r, int tet)
{
    const ndli_tissue_places *p = r->places;
    size_t at = (size_t)tet;
    int n[4];
    sb_vec3 X[4];
    ndli_state_nodes_of(r, tet, n);
    for (int c = 0; c < 4; c++)
        X[c] = ndli_state_vector(r->in + p->X, n[c]);
    return ndli_state_is_positive(ndli_state_real(r->in + p->volumes, at)) &&
           ndli_state_is_positive(ndli_state_real(r->in + p->qualities, at)) &&
           ndli_state_is_positive(ndli_tissue_quality(X[0], X[1], X[2], X[3])) &&
           ndli_state_is_positive(ndli_state_real(r->in + p->density, at)) && r->in[p->stale + at] <= 1 &&
           ndli_state_turns(r->in + p->quats, tet) && ndli_state_turns(r->in + p->old_quats, tet);
}

/* After the topology. */
static sb_result ndli_state_check_numbers(const ndli_state_reader *r, sb_error *error)
{
    const ndli_tissue_places *p = r->places;
    if (!ndli_state_all_finite(r))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the saved tissue holds a number that is not finite");
    for (int m = 0; m < r->head->material_count; m++)
        if (!ndli_state_is_positive(ndli_state_real(r->in + p->lame, 2 * (size_t)m + 1)) ||
            !sb_is_finite(ndli_state_real(r->in + p->lame, 2 * (size_t)m)))
            return sbi_fail(error, SB_ERROR_FORMAT, "the saved tissue is damaged: material %d has no stiffness", m);
    for (int i = 0; i < r->head->node_end; i++)
        if (ndli_state_lives(r, i) && !ndli_state_is_positive(ndli_state_real(r->in + p->mass, (size_t)i)))
            return sbi_fail_node(error, SB_ERROR_FORMAT, i, "the saved tissue is damaged: node %d has no mass", i);
    for (int e = 0; e < r->head->tet_end; e++)
        if (ndli_state_tet_lives(r, e) && !ndli_state_tet_measures(r, e))
            return sbi_fail_element(error, SB_ERROR_FORMAT, e, "the saved tissue is damaged: tet %d is flat, inverted, "
                                    "without mass or not turned by a rotation", e);
    return SB_OK;
}

static int ndli_state_is_flag(int value) { return value == 0 || value == 1; }

static sb_result ndli_state_check_head(const ndl_tissue *t, const ndli_tissue_head *h, sb_error *error)
{
    int limit = INT_MAX / 12 - SB_POLAR_LANES, width = 6 * t->coarse.count - 1;
    if (h->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved tissue is of a machine with another order of bytes");
    if (h->make != t->make || h->material_count != t->material_count || h->coarse_count != t->coarse.count)
        return sbi_fail(error, SB_ERROR_STATE, "the saved tissue was made from another mesh or another def");
    if (h->node_count < 1 || h->tet_count < 1 || h->node_end < h->node_count || h->tet_end < h->tet_count ||
        h->node_end > limit || h->tet_end > limit || h->displaced_count < 0 || h->displaced_count > h->node_count ||
        h->free_node < -1 || h->free_tet < -1 || !ndli_state_is_flag(h->changed) || !ndli_state_is_flag(h->seen) ||
        !ndli_state_is_flag(h->acceleration_known) || !ndli_state_is_flag(h->ledger_open) ||
        !ndli_state_is_flag(h->coarse_usable) || h->coarse_age < 0 || h->coarse_fresh < 0 || h->coarse_wasted < 0 ||
        h->node_end < t->mesh.original_nodes || h->tet_end < t->mesh.original_tets || h->coarse_width < 0 ||
        h->coarse_width > width ||
        !(h->damping_mass >= 0) || !(h->damping_stiffness >= 0))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved tissue has counts or flags out of their range");
    return SB_OK;
}

static sb_result ndli_state_check_tissue(ndl_tissue *t, const void *buffer, size_t size, sb_error *error)
{
    const unsigned char *in;
    ndli_tissue_head head;
    ndli_tissue_places places;
    ndli_state_reader reader;
    int overflow;
    size_t told;
    sb_result result = ndli_image_check(buffer, size, ndli_tissue_magic, "tissue", error);
    if (result != SB_OK)
        return result;
    in = (const unsigned char *)buffer + SBI_IMAGE_HEAD;
    told = (size_t)sbi_get_bytes((const unsigned char *)buffer + 16, 8) - SBI_IMAGE_HEAD - SBI_IMAGE_TAIL;
    if (told < sizeof head)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved tissue ends in its head");
    memcpy(&head, in, sizeof head);
    result = ndli_state_check_head(t, &head, error);
    if (result != SB_OK)
        return result;
    if (ndli_state_measure(t, &head, &places, &overflow) != told || overflow)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved tissue has another size than its counts tell");
    reader.in = in;
    reader.head = &head;
    reader.places = &places;
    result = ndli_state_check_topology(t, &reader, error);
    return result == SB_OK ? ndli_state_check_numbers(&reader, error) : result;
}

/* ---- memory for a state ---- */

/* Edges of the image's mesh, and places for its rows without any to spare; 0: too many to count. */
static int ndli_state_count_rows(ndl_tissue *t, const ndli_tissue_head *h, const ndli_tissue_places *p,
                                 const unsigned char *in, int *slots, int *edges)
{
    int64_t places = 0, ends = 0;
    for (int i = 0; i < h->node_end; i++) {
        int count = 0, alive = in[p->flags + (size_t)i] != 0;
        t->scratch[i] = i + 1;
        for (int k = alive ? ndli_image_int(in + p->star, (size_t)i) : -1; k >= 0;
             k = ndli_image_int(in + p->next, (size_t)k))
            for (int c = 0; c < 4; c++) {
                int j = ndli_image_int(in + p->tets, 4 * (size_t)(k / 4) + (size_t)c);
                count += t->scratch[j] != i + 1;
                t->scratch[j] = i + 1;
            }
        places += (count + NDLI_SOLID_PIECE - 1) / NDLI_SOLID_PIECE * NDLI_SOLID_PIECE;
        ends += count;
    }
    memset(t->scratch, 0, (size_t)h->node_end * sizeof(int));
    if (places > INT_MAX / 8)
        return 0;
    *slots = (int)places;
    *edges = (int)(ends / 2);
    return 1;
}

static sb_result ndli_state_reserve(ndl_tissue *t, const unsigned char *in, sb_error *error)
{
    ndl_tissue_mesh *mesh = &t->mesh;
    ndli_tissue_head head;
    ndli_tissue_places places;
    int overflow, slots = 0, edges = 0;
    memcpy(&head, in, sizeof head);
    ndli_state_measure(t, &head, &places, &overflow);
    if ((head.node_end > mesh->node_capacity || head.tet_end > mesh->tet_capacity) &&
        !ndli_tissue_reserve(mesh, sbi_max_int(0, head.node_end - mesh->node_count),
                             sbi_max_int(0, head.tet_end - mesh->tet_count)))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a tissue of %d nodes", head.node_end);
    if (!ndli_solid_reserve(t, 0, 0) || !ndli_state_count_rows(t, &head, &places, in, &slots, &edges) ||
        !ndli_solid_reserve(t, slots, edges))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the matrix of a tissue of %d nodes", head.node_end);
    return SB_OK;
}

/* ---- tissue: calls ---- */

static size_t ndli_state_size_of(const ndl_tissue *tissue)
{
    ndl_tissue view = *tissue; /* its arrays may then be named by a walk that also reads */
    ndli_tissue_head head;
    ndli_tissue_places places;
    int overflow;
    ndli_state_fill_head(tissue, &head);
    return ndli_state_measure(&view, &head, &places, &overflow);
}

NDL_API size_t ndl_tissue_state_size(const ndl_tissue *tissue)
{
    return tissue ? ndli_state_size_of(tissue) + SBI_IMAGE_HEAD + SBI_IMAGE_TAIL : 0;
}

/* What a needle is at is no part of a state, and the mesh without it is of no use. */
static sb_result ndli_state_refuse_needles(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a tissue with needles is neither saved nor loaded: destroy them first");
}

NDL_API sb_result ndl_tissue_save(const ndl_tissue *tissue, void *buffer, size_t size, sb_error *error)
{
    ndl_tissue view;
    size_t needed;
    if (!tissue || !buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", tissue ? "buffer" : "tissue");
    if (tissue->site)
        return ndli_state_refuse_needles(error);
    if (tissue->broken)
        return sbi_fail(error, SB_ERROR_MEMORY, "a change of the mesh found no memory: no state before a step has");
    needed = ndl_tissue_state_size(tissue);
    if (size < needed)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the state of this tissue takes %lu bytes, not %lu",
                        (unsigned long)needed, (unsigned long)size);
    view = *tissue;
    ndli_state_write(&view, (unsigned char *)buffer + SBI_IMAGE_HEAD);
    sbi_image_seal((unsigned char *)buffer, needed, ndli_tissue_magic, NDLI_IMAGE_VERSION);
    return SB_OK;
}

NDL_API sb_result ndl_tissue_load(ndl_tissue *tissue, const void *buffer, size_t size, sb_error *error)
{
    sb_result result;
    if (!tissue)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tissue is NULL");
    if (tissue->site)
        return ndli_state_refuse_needles(error);
    result = ndli_state_check_tissue(tissue, buffer, size, error);
    if (result == SB_OK)
        result = ndli_state_reserve(tissue, (const unsigned char *)buffer + SBI_IMAGE_HEAD, error);
    if (result == SB_OK)
        ndli_state_take(tissue, (const unsigned char *)buffer + SBI_IMAGE_HEAD);
    return result;
}

NDLI_API size_t ndli_solid_snapshot_size(const ndl_tissue *t) { return ndli_state_size_of(t); }

NDLI_API size_t ndli_solid_snapshot_room(const ndl_tissue *t)
{
    ndl_tissue view = *t;
    ndli_tissue_head head;
    ndli_tissue_places places;
    int overflow;
    ndli_state_fill_head(t, &head);
    head.node_end = head.displaced_count = t->mesh.node_capacity;
    head.tet_end = t->mesh.tet_capacity;
    head.seen = head.coarse_usable = 1;
    head.coarse_width = sbi_max_int(0, 6 * head.coarse_count - 1);
    return ndli_state_measure(&view, &head, &places, &overflow);
}

NDLI_API int ndli_solid_snapshot(ndl_tissue *t, void *buffer)
{
    if (t->broken && !ndli_solid_rebuild(t))
        return 0;
    ndli_state_write(t, (unsigned char *)buffer);
    return 1;
}

NDLI_API void ndli_solid_restore(ndl_tissue *t, const void *buffer)
{
    ndli_state_take(t, (const unsigned char *)buffer);
}

/* ---- rods ---- */

typedef struct ndli_rod_head {
    double stretch, bending[2], torsion, line_density, tolerance; /* the make */
    double gravity[3], damping_stretch, damping_bending, base_director[3], energy_before;
    int order, max_newton, node_count, plain, base_director_set, energy_monitored, grips;
    int none; /* fills the head up to whole doubles */
} ndli_rod_head;

static void ndli_rod_fill_head(const ndl_rod *rod, ndli_rod_head *h)
{
    memset(h, 0, sizeof *h);
    h->stretch = rod->stretch, h->bending[0] = rod->bending[0], h->bending[1] = rod->bending[1];
    h->torsion = rod->torsion, h->line_density = rod->line_density, h->tolerance = rod->tolerance;
    h->gravity[0] = rod->gravity.x, h->gravity[1] = rod->gravity.y, h->gravity[2] = rod->gravity.z;
    h->damping_stretch = rod->damping_stretch, h->damping_bending = rod->damping_bending;
    h->base_director[0] = rod->base_director.x, h->base_director[1] = rod->base_director.y;
    h->base_director[2] = rod->base_director.z;
    h->energy_before = rod->energy_before;
    h->order = NDLI_IMAGE_ORDER;
    h->max_newton = rod->max_newton;
    h->node_count = rod->node_count;
    h->plain = rod->plain;
    h->base_director_set = rod->base_director_set;
    h->energy_monitored = rod->energy_monitored;
    h->grips = rod->grips;
}

static void ndli_rod_take_head(ndl_rod *rod, const ndli_rod_head *h)
{
    rod->gravity = ndli_v(h->gravity[0], h->gravity[1], h->gravity[2]);
    rod->damping_stretch = h->damping_stretch, rod->damping_bending = h->damping_bending;
    rod->base_director = ndli_v(h->base_director[0], h->base_director[1], h->base_director[2]);
    rod->energy_before = h->energy_before;
    rod->node_count = h->node_count;
    rod->plain = h->plain;
    rod->base_director_set = h->base_director_set;
    rod->energy_monitored = h->energy_monitored;
    rod->grips = h->grips;
}

/* Arrays of edges have a place per node, too: whole ones are copied. Returns where the bytes that are no numbers
 * begin. */
static size_t ndli_rod_walk(ndl_rod *rod, int node_count, ndli_image *image)
{
    ndli_v3 *vectors[] = {rod->x,      rod->v,      rod->a,    rod->director,       rod->tangent,
                          rod->target, rod->target_velocity, rod->force, rod->reaction};
    double *reals[] = {rod->theta, rod->rest_length, rod->mass, rod->cell, rod->turn, rod->torque, rod->reaction_torque,
                       rod->grip,  rod->grip_limit,  rod->anchor};
    size_t n = (size_t)node_count, flags;
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        ndli_image_part(image, vectors[i], n, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        ndli_image_part(image, reals[i], n, sizeof(double));
    ndli_image_part(image, rod->rest_bend, n, 2 * sizeof(double));
    flags = image->used;
    ndli_image_part(image, rod->held, n, 1);
    ndli_image_part(image, rod->has_velocity, n, 1);
    ndli_image_part(image, rod->turn_held, n, 1);
    return flags;
}

static size_t ndli_rod_measure(ndl_rod *rod, int node_count, size_t *flags)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.used = sizeof(ndli_rod_head);
    *flags = ndli_rod_walk(rod, node_count, &image);
    return image.used;
}

NDLI_API size_t ndli_rod_snapshot_size(const ndl_rod *rod, int node_count)
{
    ndl_rod view = *rod;
    size_t flags;
    return ndli_rod_measure(&view, node_count, &flags);
}

NDLI_API void ndli_rod_snapshot(const ndl_rod *rod, void *buffer)
{
    ndl_rod view = *rod;
    ndli_rod_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.out = (unsigned char *)buffer;
    ndli_rod_fill_head(rod, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_rod_walk(&view, head.node_count, &image);
}

NDLI_API void ndli_rod_rewind(ndl_rod *rod, const void *buffer)
{
    ndli_rod_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.in = (const unsigned char *)buffer;
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_rod_take_head(rod, &head);
    ndli_rod_walk(rod, head.node_count, &image);
    ndli_rod_publish(rod);
}

static sb_result ndli_rod_check_image(ndl_rod *rod, const void *buffer, size_t size, sb_error *error)
{
    const unsigned char *in;
    ndli_rod_head own, head;
    size_t told, flags;
    sb_result result = ndli_image_check(buffer, size, ndli_rod_magic, "rod", error);
    if (result != SB_OK)
        return result;
    in = (const unsigned char *)buffer + SBI_IMAGE_HEAD;
    told = (size_t)sbi_get_bytes((const unsigned char *)buffer + 16, 8) - SBI_IMAGE_HEAD - SBI_IMAGE_TAIL;
    if (told < sizeof head)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod ends in its head");
    memcpy(&head, in, sizeof head);
    ndli_rod_fill_head(rod, &own);
    if (head.order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved rod is of a machine with another order of bytes");
    if (memcmp(&own, &head, 6 * sizeof(double)) != 0 || own.max_newton != head.max_newton)
        return sbi_fail(error, SB_ERROR_STATE, "the saved rod was made from another def");
    if (head.node_count > rod->capacity)
        return sbi_fail(error, SB_ERROR_STATE, "the saved rod has %d nodes, this one room for %d", head.node_count,
                        rod->capacity);
    if (head.node_count < 2 || head.grips < 0 || head.grips >= head.node_count ||
        ndli_rod_measure(rod, head.node_count, &flags) != told ||
        !ndli_state_is_flag(head.plain) || !ndli_state_is_flag(head.base_director_set) ||
        !ndli_state_is_flag(head.energy_monitored))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod has counts or flags out of their range");
    for (size_t at = 0; at < flags; at += sizeof(double)) {
        double value;
        memcpy(&value, in + at, sizeof value);
        if ((at < 15 * sizeof(double) || at >= sizeof head) && value - value != 0)
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "the saved rod holds a number that is not finite");
    }
    return SB_OK;
}

NDL_API size_t ndl_rod_state_size(const ndl_rod *rod)
{
    return rod ? ndli_rod_snapshot_size(rod, rod->node_count) + SBI_IMAGE_HEAD + SBI_IMAGE_TAIL : 0;
}

NDL_API sb_result ndl_rod_save(const ndl_rod *rod, void *buffer, size_t size, sb_error *error)
{
    size_t needed = ndl_rod_state_size(rod);
    if (!rod || !buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", rod ? "buffer" : "rod");
    if (size < needed)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the state of this rod takes %lu bytes, not %lu",
                        (unsigned long)needed, (unsigned long)size);
    ndli_rod_snapshot(rod, (unsigned char *)buffer + SBI_IMAGE_HEAD);
    sbi_image_seal((unsigned char *)buffer, needed, ndli_rod_magic, NDLI_IMAGE_VERSION);
    return SB_OK;
}

NDL_API sb_result ndl_rod_load(ndl_rod *rod, const void *buffer, size_t size, sb_error *error)
{
    sb_result result;
    if (!rod)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rod is NULL");
    result = ndli_rod_check_image(rod, buffer, size, error);
    if (result == SB_OK)
        ndli_rod_rewind(rod, (const unsigned char *)buffer + SBI_IMAGE_HEAD);
    return result;
}
