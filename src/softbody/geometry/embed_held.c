/* embed_held: how the points of a follower are held, given away and taken back. */
#include "embed_held.h"

#include "embed_live.h"

SBI_API sbi_embed_held sbi_embed_get_held(const sb_embedding *e, int point)
{
    sbi_embed_held held;
    held.place = e->follower->places[point];
    held.info = e->points[point];
    return held;
}

static int sbi_embed_same_reals(const sb_real *a, const sb_real *b) { return memcmp(a, b, 3 * sizeof *a) == 0; }

SBI_API int sbi_embed_is_held_so(const sb_embedding *e, int point, const sbi_embed_held *held)
{
    const sbi_embed_place *a = e->follower->places + point, *b = &held->place;
    const sb_embedded_point *p = e->points + point, *q = &held->info;
    return a->hold == b->hold && a->cell == b->cell && p->element == q->element &&
           sbi_embed_same_reals(a->parameters, b->parameters) && sbi_embed_same_reals(a->offset, b->offset) &&
           sbi_embed_same_reals(a->carried, b->carried) && sbi_embed_same_reals(p->xi, q->xi) &&
           sbi_embed_same_reals(p->step, q->step) && a->gap == b->gap && p->distance == q->distance;
}

/* ---- whether a mesh can hold a point so ---- */

static int sbi_embed_is_near(const sb_embedding *e, sb_vec3 a, sb_vec3 b)
{
    return sb_v3_norm(sb_v3_sub(a, b)) <= sb_sqrt(SB_EPSILON) * e->scale;
}

/* sum (N_a(xi) + dN_a/dxi . step) X_a over an element, or over one of its faces where `local` lists its nodes. */
static sb_vec3 sbi_embed_held_at(const sbi_embed_follower *f, int cell, const int *local, sb_element_type type,
                                 const sb_real xi[3], const sb_real step[3])
{
    const int *nodes = f->cells + (size_t)cell * (size_t)f->width;
    int count = local ? f->face_nodes : f->width;
    sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3];
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_element_shape(type, xi, shape, slope);
    for (int a = 0; a < count; a++) {
        for (int k = 0; step && k < 3; k++)
            shape[a] += slope[a][k] * step[k];
        sum = sb_v3_madd(sum, shape[a], f->nodes[nodes[local ? local[a] : a]]);
    }
    return sum;
}

/* 1: numbers that a point may be held by, small enough for shape functions and their sums not to overflow. */
static int sbi_embed_is_sane(const sb_embedding *e, const sbi_embed_held *held, int on_face)
{
    const sb_real far = 1 / sb_sqrt(SB_EPSILON), length = e->scale * far; /* farther off no digit is left of a point */
    const sbi_embed_place *place = &held->place;
    const sb_embedded_point *info = &held->info;
    int frame = place->hold == SB_EMBEDDED_FRAME, sane = sb_abs(place->gap) <= length;
    sane = sane && sb_abs(info->distance) <= length;
    for (int k = 0; k < 3; k++) {
        sane = sane && sb_abs(info->xi[k]) <= far && sb_abs(info->step[k]) <= far;
        sane = sane && sb_abs(place->parameters[k]) <= (on_face && k == 2 ? length : far);
        sane = sane && sb_abs(place->offset[k]) <= (frame ? length : far);
        sane = sane && sb_abs(place->carried[k]) * sb_min(1, e->scale * e->scale) <= 1 / SB_EPSILON; /* up to 1/h^2 */
    }
    return sane;
}

/* 1: there is such a cell or outer face, and it holds the point where it is at rest. */
static int sbi_embed_fits(const sb_embedding *e, const sbi_embed_follower *f, int point, const sbi_embed_held *held)
{
    const sbi_embed_place *place = &held->place;
    const sb_embedded_point *info = &held->info;
    int on_face = sbi_embed_is_on_face(place->hold), faces = on_face ? f->faces : 1, cell = place->cell / faces;
    sb_vec3 foot;
    if (place->hold < SB_EMBEDDED_INSIDE || place->hold > SB_EMBEDDED_EXTRAPOLATED ||
        (on_face && e->kind == SB_EMBED_PLAIN) || place->cell < 0 || cell >= f->cell_end ||
        f->cells[cell * f->width] < 0 || info->element != cell || info->hold != place->hold ||
        !sbi_embed_is_sane(e, held, on_face))
        return 0;
    if (!sbi_embed_is_near(e, e->rest[point], sbi_embed_held_at(f, cell, NULL, e->type, info->xi, info->step)))
        return 0;
    if (!on_face)
        return 1;
    foot = sbi_embed_held_at(f, cell, NULL, e->type, info->xi, NULL);
    return f->outer[place->cell] >= 0 && sbi_embed_is_near(e, foot,
                                                           sbi_embed_held_at(f, cell, f->local[place->cell % f->faces],
                                                                             e->face.type, place->parameters, NULL));
}

/* ---- taking it ---- */

/* Makes the arrays of updates for the places of f, whose report it makes, too. 0: no memory. */
static int sbi_embed_fill_held(const sb_embedding *e, sbi_embed_follower *f, sbi_embed_arrays *arrays)
{
    sbi_embed_parts parts;
    memset(arrays, 0, sizeof *arrays);
    sbi_embed_fill_report(e, f, &f->report);
    sbi_embed_fill_parts(e, f, &parts);
    if (sbi_embed_arrays_fill(&e->allocator, arrays, &parts, e->order, e->report.point_count))
        return 1;
    sbi_embed_arrays_free(&e->allocator, arrays);
    return 0;
}

SBI_API int sbi_embed_hold(sb_embedding *e, const sbi_embed_held *held)
{
    sbi_embed_follower *f = e->follower;
    size_t count = (size_t)e->report.point_count, same = 0;
    sbi_embed_place *places, *before = f->places;
    sbi_embed_arrays arrays;
    while (same < count && sbi_embed_is_held_so(e, (int)same, held + same))
        same++;
    if (same == count)
        return 1;
    places = (sbi_embed_place *)sbi_alloc(&e->allocator, count, sizeof *places);
    for (size_t p = 0; places && p < count; p++)
        places[p] = held[p].place;
    f->places = places;
    if (!places || !sbi_embed_fill_held(e, f, &arrays)) {
        f->places = before;
        f->report = e->report;
        sbi_free(&e->allocator, places);
        return 0;
    }
    sbi_free(&e->allocator, before);
    for (size_t p = 0; p < count; p++)
        e->points[p] = held[p].info;
    sbi_embed_arrays_free(&e->allocator, &e->arrays);
    e->arrays = arrays;
    e->report = f->report;
    return 1;
}

/* ---- another mesh ---- */

static sb_result sbi_embed_prepare_points(const sb_embedding *e, struct sbi_embed_prepared *next,
                                          const sbi_embed_slots *mesh, const sbi_embed_held *held, sb_error *error)
{
    sbi_embed_follower *f = next->follower;
    const int count = e->report.point_count;
    if (!f || !next->points || !sbi_embed_live_room(e, f, mesh->node_end, mesh->cell_end, 0) ||
        !sbi_embed_live_fill(e, f, mesh))
        return sbi_embed_follow_no_memory(e, error);
    for (int p = 0; p < count; p++) {
        if (!sbi_embed_fits(e, f, p, held + p))
            return sbi_fail_node(error, SB_ERROR_FORMAT, p, "the saved mesh does not hold point %d as the state says",
                                 p);
        f->places[p] = held[p].place;
        next->points[p] = held[p].info;
    }
    return sbi_embed_fill_held(e, f, &next->arrays) ? SB_OK : sbi_embed_follow_no_memory(e, error);
}

SBI_API sb_result sbi_embed_prepare(sb_embedding *e, const sbi_embed_slots *mesh, const sbi_embed_held *held,
                                    sb_error *error)
{
    struct sbi_embed_prepared *next =
        (struct sbi_embed_prepared *)sbi_alloc_zeroed(&e->allocator, 1, sizeof(struct sbi_embed_prepared));
    sb_result result;
    sbi_embed_drop_prepared(e, e->follower);
    if (!next)
        return sbi_embed_follow_no_memory(e, error);
    next->follower = sbi_embed_follower_make(e);
    next->points = (sb_embedded_point *)sbi_alloc(&e->allocator, (size_t)e->report.point_count, sizeof *next->points);
    result = sbi_embed_prepare_points(e, next, mesh, held, error);
    e->follower->prepared = next;
    if (result != SB_OK)
        sbi_embed_drop_prepared(e, e->follower);
    return result;
}

SBI_API void sbi_embed_take_prepared(sb_embedding *e)
{
    sbi_embed_follower *old = e->follower, *f;
    struct sbi_embed_prepared *next = old->prepared;
    if (!next)
        return;
    f = next->follower;
    f->owner = old->owner;
    f->find_cell = old->find_cell;
    f->find_user = old->find_user;
    old->prepared = NULL;
    sbi_embed_arrays_free(&e->allocator, &e->arrays);
    sbi_free(&e->allocator, e->points);
    e->arrays = next->arrays;
    e->points = next->points;
    e->report = f->report;
    e->elements = f->cells;
    e->follower = f;
    sbi_free(&e->allocator, next);
    sbi_embed_follower_free(e, old);
}
