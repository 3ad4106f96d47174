/* needle_state: needles in the saved state of their body and in its recording. What is computed anew in each step is
 * not kept; what the remesher knows is its own part, which is checked before this one. */
#include "needle_private.h"

#include <string.h>

#include "image.h"

/* By its name it comes behind the remesher's, which it is checked against. */
static const char ndli_needle_name[] = "needles";
enum { NDLI_NEEDLE_VERSION = 4 };

/* ---- the image ---- */

typedef struct ndli_site_head {
    double mean_edge;
    uint64_t bed; /* hash of what needles that are held have their tracks in; 0: none is in */
    int order, count;
    unsigned char used[NDL_MAX_NEEDLES]; /* 1: there is a needle of that index, and its image follows */
} ndli_site_head;

enum { NDLI_HEAD_VECTORS = 9, NDLI_HEAD_REALS = 5 };

typedef struct ndli_needle_head {
    uint64_t make; /* hash of what its def says beside the rod */
    double reals[NDLI_HEAD_REALS];
    ndli_v3 vectors[NDLI_HEAD_VECTORS];
    int node_count, first, count, shallow, base_given, hold_steps;
    int points; /* of its track */
    int lost;
} ndli_needle_head;

/* The fields that go from step to step, in the order of the head. */
static void ndli_needle_fields(ndl_needle *needle, double *reals[NDLI_HEAD_REALS], ndli_v3 *vectors[NDLI_HEAD_VECTORS])
{
    reals[0] = &needle->edge_length, reals[1] = &needle->fed, reals[2] = &needle->advance;
    reals[3] = &needle->line.cutting, reals[4] = &needle->entering;
    vectors[0] = &needle->outlet, vectors[1] = &needle->axis, vectors[2] = &needle->given_outlet;
    vectors[3] = &needle->given_axis, vectors[4] = &needle->given_director, vectors[5] = &needle->heading;
    vectors[6] = &needle->base_force, vectors[7] = &needle->base_torque, vectors[8] = &needle->aside;
}

static uint64_t ndli_state_hash_real(uint64_t hash, sb_real value)
{
    double wide = (double)value;
    return ndli_image_hash(hash, &wide, sizeof wide);
}

/* Tables, bevel and membranes; of a cutting of the user's own only that there is one. */
static uint64_t ndli_needle_make(const ndl_needle *needle)
{
    uint64_t hash = ndli_state_hash_real((uint64_t)needle->max_trials, needle->entry_slip);
    hash = sbi_hash_word(hash, (uint64_t)needle->bevel.law + (needle->cutting_at ? 256u : 0u));
    hash = ndli_state_hash_real(hash, needle->bevel.angle);
    hash = ndli_state_hash_real(hash, needle->bevel.curvature);
    hash = ndli_state_hash_real(ndli_state_hash_real(hash, needle->bevel.guide), needle->bevel.lag);
    for (int i = 0; i < needle->friction_count; i++) {
        const ndl_friction *f = needle->frictions + i;
        hash = ndli_state_hash_real(ndli_state_hash_real(hash, f->friction), f->viscous);
        hash = ndli_state_hash_real(hash, f->cutting);
        hash = ndli_state_hash_real(ndli_state_hash_real(hash, f->twist_stiffness), f->twist_friction);
    }
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndl_membrane *m = &needle->capsules[i].def;
        hash = ndli_image_hash(hash, m->regions, sizeof m->regions);
        hash = ndli_state_hash_real(ndli_state_hash_real(hash, m->strength), m->thickness);
    }
    return hash;
}

/* stale: the body has got another mesh from others since: a needle is outside of it, as the next step will find. */
static void ndli_needle_fill_head(const ndl_needle *needle, int stale, ndli_needle_head *h)
{
    ndl_needle view = *needle;
    double *reals[NDLI_HEAD_REALS];
    ndli_v3 *vectors[NDLI_HEAD_VECTORS];
    memset(h, 0, sizeof *h);
    ndli_needle_fields(&view, reals, vectors);
    h->make = ndli_needle_make(needle);
    for (int i = 0; i < NDLI_HEAD_REALS; i++)
        h->reals[i] = *reals[i];
    for (int i = 0; i < NDLI_HEAD_VECTORS; i++)
        h->vectors[i] = *vectors[i];
    h->node_count = needle->rod->node_count;
    h->first = stale ? h->node_count : needle->line.first;
    h->count = stale ? 0 : needle->line.count;
    h->shallow = stale ? 0 : needle->shallow;
    h->base_given = needle->base_given;
    h->hold_steps = needle->hold_steps;
    h->points = h->count > 0 ? needle->track.count : 0;
    h->lost = stale && needle->line.count > 0 ? NDLI_LOST_MESH : needle->lost;
    h->reals[4] = h->count > 0 ? h->reals[4] : 0;
}

static void ndli_needle_take_head(ndl_needle *needle, const ndli_needle_head *h)
{
    double *reals[NDLI_HEAD_REALS];
    ndli_v3 *vectors[NDLI_HEAD_VECTORS];
    ndli_needle_fields(needle, reals, vectors);
    for (int i = 0; i < NDLI_HEAD_REALS; i++)
        *reals[i] = h->reals[i];
    for (int i = 0; i < NDLI_HEAD_VECTORS; i++)
        *vectors[i] = h->vectors[i];
    needle->line.first = h->first;
    needle->line.count = h->count;
    needle->shallow = h->shallow;
    needle->track.count = h->points;
    needle->track.spacing = needle->edge_length / (int)NDLI_TRACK_POINTS;
    needle->lost = h->lost;
    needle->base_given = h->base_given;
    needle->hold_steps = h->hold_steps;
    needle->blocked = needle->limited = 0;
}

/* Nodes that have a friction state: one more where its edge is held as it goes in. */
static size_t ndli_needle_states(const ndl_needle *needle, const ndli_needle_head *h)
{
    return (size_t)h->count + (needle->site->embeds && h->count > 0 ? 1 : 0);
}

/* What its nodes in the tissue have. */
static void ndli_needle_walk(ndl_needle *needle, const ndli_needle_head *h, ndli_image *image)
{
    size_t states = ndli_needle_states(needle, h), nodes = (size_t)h->count, points = (size_t)h->points;
    size_t rearmost = (size_t)h->first - (states - nodes);
    ndli_image_part(image, needle->line.state + rearmost, states, 1);
    ndli_image_part(image, needle->line.contact + rearmost, states, sizeof(ndli_v3));
    if (!needle->site->embeds) {
        ndli_image_part(image, needle->path, nodes, sizeof(int));
        ndli_image_part(image, needle->gap + h->first, nodes, sizeof(ndli_v3));
        return;
    }
    ndli_image_part(image, needle->arc + h->first, nodes, sizeof(double));
    ndli_image_part(image, needle->track.X, points, sizeof(ndli_v3));
    ndli_image_part(image, needle->track.arc, points, sizeof(double));
    ndli_image_part(image, needle->track.elements, points, sizeof(int));
}

static void ndli_site_fill_head(const struct ndli_site *site, int stale, ndli_site_head *h)
{
    memset(h, 0, sizeof *h);
    h->mean_edge = site->mean_edge;
    h->bed = stale ? 0 : site->bed.hash;
    h->order = NDLI_IMAGE_ORDER;
    h->count = site->count;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        h->used[i] = site->needles[i] != NULL;
}

static void ndli_site_save(const void *user, sbi_state_out *out)
{
    const struct ndli_site *site = (const struct ndli_site *)user;
    int stale = ndli_site_is_stale(site);
    ndli_site_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.state = out;
    ndli_site_fill_head(site, stale, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_needle view = *site->needles[i];
            ndli_needle_head needle;
            ndli_needle_fill_head(&view, stale, &needle);
            ndli_image_part(&image, &needle, 1, sizeof needle);
            ndli_needle_walk(&view, &needle, &image);
            ndli_rod_put(view.rod, out);
        }
    out->overflow |= image.overflow;
}

/* ---- checks ---- */

static int ndli_state_is_number(const double *values, size_t count)
{
    int good = 1;
    for (size_t i = 0; i < count; i++)
        good &= values[i] - values[i] == 0;
    return good;
}

static int ndli_state_is_unit(ndli_v3 v) { return fabs(ndli_norm(v) - 1) < 1e-6; }

static sb_result ndli_needle_check_head(const ndl_needle *needle, const ndli_needle_head *h, sb_error *error)
{
    if (h->make != ndli_needle_make(needle))
        return sbi_fail(error, SB_ERROR_STATE, "saved needle %d was made from another def", needle->index);
    if (!ndli_state_is_number(h->reals, NDLI_HEAD_REALS) ||
        !ndli_state_is_number(&h->vectors[0].x, 3 * NDLI_HEAD_VECTORS))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "saved needle %d holds a number that is not finite", needle->index);
    if (h->node_count > needle->rod->capacity)
        return sbi_fail(error, SB_ERROR_STATE, "saved needle %d has %d nodes, this one room for %d", needle->index,
                        h->node_count, needle->rod->capacity);
    if (h->node_count < 2 || h->count < 0 || h->first < 2 || h->first > h->node_count ||
        h->count > h->node_count - h->first || (h->count == 0) != (h->first == h->node_count) || h->points < 0 ||
        h->points > needle->track.capacity || h->lost < NDLI_LOST_NOT || h->lost > NDLI_LOST_TORN ||
        (h->lost == NDLI_LOST_TORN && !needle->site->embeds) || !ndli_state_is_unit(h->vectors[1]) ||
        (h->points > 0 && !ndli_state_is_unit(h->vectors[5])) ||
        (h->points > 0) != (h->count > 0 && needle->site->embeds) || (h->shallow != 0 && h->shallow != 1) ||
        (h->base_given != 0 && h->base_given != 1) || h->hold_steps < 0 || !(h->reals[0] > 0) || !(h->reals[4] >= 0) ||
        (h->reals[4] > 0 && h->points == 0))
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d is damaged", needle->index);
    return SB_OK;
}

static int ndli_image_is_number(const unsigned char *reals, size_t count)
{
    int good = 1;
    for (size_t i = 0; i < count; i++)
        good &= ndli_is_finite(ndli_image_real(reals, i));
    return good;
}

/* The rod is on nodes of the remesher's path, in their order, or at numbers beside them. */
static int ndli_needle_path_holds(const ndl_needle *needle, const unsigned char *path, int count)
{
    int there, at = 0;
    const int *nodes = ndli_remesh_staged_nodes(needle->site->remesh, needle->index, &there);
    for (int i = 0; i < count; i++) {
        int node = ndli_image_int(path, (size_t)i);
        while (at < there && nodes[at] != node)
            at++;
        if (at++ == there)
            return 0;
    }
    return ndli_image_is_number(path + ndli_image_room((size_t)count * sizeof(int)), 3 * (size_t)count);
}

/* Reals that rise from one to the next; *last is the last of them. */
static int ndli_image_rises(const unsigned char *reals, size_t count, double *last)
{
    for (size_t i = 0; i < count; i++) {
        double value = ndli_image_real(reals, i);
        if (!(value >= 0) || !ndli_is_finite(value) || (i > 0 && !(value > *last)))
            return 0;
        *last = value;
    }
    return 1;
}

/* The track is one in the bed, and the rod's nodes are on it in their order. */
static int ndli_needle_track_holds(const ndli_bed *bed, const unsigned char *arcs, const ndli_needle_head *h)
{
    size_t nodes = (size_t)h->count, points = (size_t)h->points;
    const unsigned char *X = arcs + ndli_image_room(nodes * sizeof(double));
    const unsigned char *at = X + ndli_image_room(points * sizeof(ndli_v3));
    const unsigned char *elements = at + ndli_image_room(points * sizeof(double));
    double tip = 0, last = 0;
    for (size_t i = 0; i < points; i++) {
        int element = ndli_image_int(elements, i);
        if (element < 0 || element >= bed->mesh.element_count)
            return 0;
    }
    if (!ndli_image_is_number(X, 3 * points) || !ndli_image_rises(at, points, &tip))
        return 0;
    return ndli_image_rises(arcs, nodes, &last) && (points == 0 || (last == tip && ndli_image_real(at, 0) == 0));
}

/* The needle at in[size], its track in this bed; used: its bytes. */
static sb_result ndli_needle_check_image(const ndl_needle *needle, const ndli_bed *bed, const unsigned char *in,
                                         size_t size, size_t *used, sb_error *error)
{
    ndl_needle none = *needle;
    ndli_needle_head h;
    ndli_image image;
    const unsigned char *states, *contacts, *rest;
    sb_result result;
    size_t rod, count;
    int good = 1, nodes;
    if (size < sizeof h)
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d ends in its head", needle->index);
    memcpy(&h, in, sizeof h);
    result = ndli_needle_check_head(needle, &h, error);
    if (result != SB_OK)
        return result;
    memset(&image, 0, sizeof image);
    image.used = ndli_image_room(sizeof h);
    ndli_needle_walk(&none, &h, &image);
    if (image.used > size)
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d ends before its nodes do", needle->index);
    count = ndli_needle_states(needle, &h);
    states = in + ndli_image_room(sizeof h);
    contacts = states + ndli_image_room(count);
    rest = contacts + ndli_image_room(count * sizeof(ndli_v3));
    for (size_t i = 0; i < count; i++)
        good &= states[i] > NDL_FREE && states[i] <= NDL_DYNAMIC_BACKWARD;
    if (!good || !ndli_image_is_number(contacts, 3 * count) ||
        !(needle->site->embeds ? ndli_needle_track_holds(bed, rest, &h)
                               : ndli_needle_path_holds(needle, rest, h.count)))
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d is damaged in its nodes", needle->index);
    result = ndli_rod_check(needle->rod, in + image.used, size - image.used, &rod, &nodes, error);
    if (result == SB_OK && nodes != h.node_count)
        result = sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d has %d nodes, its rod %d", needle->index,
                          h.node_count, nodes);
    *used = image.used + (result == SB_OK ? rod : 0);
    return result;
}

static sb_result ndli_site_check_head(const struct ndli_site *site, const ndli_site_head *h, sb_error *error)
{
    if (h->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved needles are of a machine with another order of bytes");
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (h->used[i] != (site->needles[i] != NULL))
            return sbi_fail(error, SB_ERROR_STATE,
                            h->used[i] ? "the state has a needle %d, the body has not"
                                       : "the body has a needle %d, the state has not",
                            i);
    if (h->count != site->count || !(h->mean_edge > 0) || h->mean_edge - h->mean_edge != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved needles are damaged in their head");
    return SB_OK;
}

/* The bed of a state: the one that there is, or one that is made from the mesh before any cut, which an sb_cut of the
 * body knows, or else from the state's. */
static sb_result ndli_site_check_bed(struct ndli_site *site, const sb_body *body, const ndli_site_head *h,
                                     const ndli_bed **bed, sb_error *error)
{
    *bed = &site->bed;
    ndli_bed_free(&site->next_bed);
    if (!h->bed || h->bed == site->bed.hash || !site->embeds)
        return SB_OK;
    *bed = &site->next_bed;
    for (int uncut = sbi_body_has_uncut(site->body); uncut >= 0; uncut--) {
        sb_result result = ndli_bed_create(site->body, body, uncut, &site->allocator, &site->next_bed, error);
        if (result == SB_ERROR_STATE && uncut)
            continue;
        if (result != SB_OK || h->bed == site->next_bed.hash)
            return result;
        ndli_bed_free(&site->next_bed);
    }
    return sbi_fail(error, SB_ERROR_STATE,
                    "the state's needles went into another mesh than those of the body know: load it into a body that "
                    "was made as its body was");
}

static sb_result ndli_site_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                 sb_error *error)
{
    struct ndli_site *site = (struct ndli_site *)user;
    const ndli_bed *bed = NULL;
    ndli_site_head head;
    size_t at = ndli_image_room(sizeof head);
    sb_result result;
    if (size < at)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved needles end in their head");
    memcpy(&head, bytes, sizeof head);
    result = ndli_site_check_head(site, &head, error);
    if (result == SB_OK)
        result = ndli_site_check_bed(site, body, &head, &bed, error);
    for (int i = 0; i < NDL_MAX_NEEDLES && result == SB_OK; i++)
        if (site->needles[i]) {
            size_t used = 0;
            result = ndli_needle_check_image(site->needles[i], bed, bytes + at, size - at, &used, error);
            at += used;
        }
    if (result == SB_OK && at != size)
        result =
            sbi_fail(error, SB_ERROR_FORMAT, "the saved needles have %lu bytes too many", (unsigned long)(size - at));
    if (result != SB_OK)
        ndli_bed_free(&site->next_bed);
    return result;
}

static void ndli_site_give_up(void *user) { ndli_bed_free(&((struct ndli_site *)user)->next_bed); }

/* The body has the mesh that the tracks are in again, or one that was cut from it; hash 0: none is in. */
static void ndli_site_load_bed(struct ndli_site *site, uint64_t hash)
{
    int unknown;
    if (!site->embeds)
        return;
    if (site->next_bed.cells)
        ndli_bed_replace(&site->bed, &site->next_bed);
    /* pieces that nobody knows: the cut that made them was destroyed before the state was saved, in another body */
    unknown = hash && sbi_body_has_pieces(site->body) && !site->bed.was_cut && !sbi_body_has_finder(site->body);
    site->bed.is_lost = !hash || unknown;
    if (hash)
        site->bed.version = unknown ? -1 : sb_body_mesh_version(site->body);
}

static void ndli_site_load(void *user, const unsigned char *bytes, size_t size)
{
    struct ndli_site *site = (struct ndli_site *)user;
    ndli_site_head head;
    ndli_image image;
    (void)size;
    memset(&image, 0, sizeof image);
    image.in = bytes;
    ndli_image_part(&image, &head, 1, sizeof head);
    site->mean_edge = head.mean_edge;
    site->undo_waits = 0;
    ndli_site_load_bed(site, head.bed);
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_needle *needle = site->needles[i];
            ndli_needle_head h;
            ndli_image_part(&image, &h, 1, sizeof h);
            ndli_needle_take_head(needle, &h);
            memset(needle->line.state, NDL_FREE, (size_t)h.node_count);
            ndli_needle_walk(needle, &h, &image);
            ndli_rod_rewind(needle->rod, bytes + image.used);
            image.used += ndli_rod_snapshot_size(needle->rod, h.node_count);
        }
}

NDLI_API sbi_state_part ndli_site_part(struct ndli_site *site)
{
    sbi_state_part part;
    memset(&part, 0, sizeof part);
    memcpy(part.name, ndli_needle_name, sizeof ndli_needle_name);
    part.version = NDLI_NEEDLE_VERSION;
    part.user = site;
    part.save = ndli_site_save;
    part.check = ndli_site_check;
    part.load = ndli_site_load;
    part.give_up = ndli_site_give_up;
    return part;
}

NDLI_API struct ndli_site *ndli_needle_site(const sb_body *body)
{
    return (struct ndli_site *)sbi_body_find_part(body, ndli_needle_name);
}

NDLI_API void ndli_site_leave(const struct ndli_site *site) { sbi_body_leave(site->body, ndli_needle_name); }

/* ---- recording ---- */

NDLI_API void ndli_needle_tell_life(const ndl_needle *needle, ndli_needle_command command)
{
    int ints[2];
    ints[0] = (int)command, ints[1] = needle->index;
    sbi_body_tell_part(needle->site->body, ndli_needle_name, ints, 2, NULL, 0);
}

NDLI_API void ndli_needle_tell_base(const ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director)
{
    const sb_vec3 places[3] = {base, direction, director};
    sb_real reals[9];
    int ints[2];
    ints[0] = NDLI_COMMAND_BASE, ints[1] = needle->index;
    for (int k = 0; k < 3; k++)
        reals[3 * k] = places[k].x, reals[3 * k + 1] = places[k].y, reals[3 * k + 2] = places[k].z;
    sbi_body_tell_part(needle->site->body, ndli_needle_name, ints, 2, reals, 9);
}

NDLI_API void ndli_needle_tell_step(const struct ndli_site *site, ndl_needle *const *needles, int count, sb_real dt,
                                    const ndl_command *commands, sb_result result)
{
    int ints[2 + NDL_MAX_NEEDLES];
    sb_real reals[1 + (int)NDLI_COMMAND_REALS * (int)NDL_MAX_NEEDLES];
    ints[0] = NDLI_COMMAND_STEP, ints[1] = count;
    reals[0] = dt;
    for (int k = 0; k < count; k++) {
        sb_real *to = reals + 1 + NDLI_COMMAND_REALS * k;
        ndl_command c;
        memset(&c, 0, sizeof c);
        if (commands)
            c = commands[k];
        ints[2 + k] = needles[k]->index;
        to[0] = c.insertion, to[1] = c.twist;
        to[2] = c.velocity.x, to[3] = c.velocity.y, to[4] = c.velocity.z;
        to[5] = c.angular_velocity.x, to[6] = c.angular_velocity.y, to[7] = c.angular_velocity.z;
    }
    sbi_body_tell_part_step(site->body, ndli_needle_name, result, ints, 2 + (size_t)count, reals,
                            1 + NDLI_COMMAND_REALS * (size_t)count);
}
