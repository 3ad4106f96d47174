/* skin: triangles between embedded points. */
#include "skin.h"

#include <string.h>

#include "../geometry/embed_held.h"
#include "body_embed.h"
#include "body_private.h"
#include "skin_private.h"

/* The skin, and what it is of. */
typedef struct sbi_skin_embedded {
    sb_skin skin; /* the first: a pointer to one is one to the other */
    sb_allocator allocator;
    sb_embedding *embedding;
    int (*triangles)[3];
    int is_live;            /* 1: the body's mesh may change, and the embedding follows it */
    int *cells, cell_count; /* [cell_count] of the body: the embedding's elements up to the last that holds a point */
} sbi_skin_embedded;

/* Finds the embedding's elements among the body's cells, which are the same in the same order, but may be there several
 * times, as those of a grid are (sb_grid.body_mesh). 0: they are others. */
static int sbi_skin_find_cells(const sbi_skin_embedded *made, const sb_body *body)
{
    size_t width = (size_t)body->domain.nodes_per_cell;
    int cell = 0;
    for (int e = 0; e < made->cell_count; e++) {
        const int *nodes = made->embedding->elements + (size_t)e * width;
        while (cell < body->domain.cell_count &&
               memcmp(body->domain.cells + (size_t)cell * width, nodes, width * sizeof *nodes) != 0)
            cell++;
        if (cell == body->domain.cell_count)
            return 0;
        made->cells[e] = cell;
    }
    return 1;
}

static sb_result sbi_skin_update(sb_skin *skin, const sb_body *body, sb_error *error)
{
    sbi_skin_embedded *made = (sbi_skin_embedded *)skin->user;
    sb_embedding *embedding = made->embedding;
    int follows = embedding->follower && embedding->follower->owner.body == body;
    if (embedding->type != body->domain.element_type)
        return sbi_fail(error, SB_ERROR_STATE, "the skin is embedded in %s, the body is of %s",
                        sb_element_name(embedding->type), sb_element_name(body->domain.element_type));
    if (body->live && !follows)
        return sbi_fail(error, SB_ERROR_STATE,
                        "the skin's embedding does not follow the body, whose mesh may change: sb_embedding_follow");
    if (sbi_embed_is_stale(embedding))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a skin to follow the body's mesh");
    if (!body->live && !sbi_skin_find_cells(made, body))
        return sbi_fail(error, SB_ERROR_STATE, "the skin is embedded in another mesh than the body's");
    made->is_live = body->live != NULL;
    return SB_OK;
}

static void sbi_skin_get_point(const sb_skin *skin, int point, sbi_skin_point *at)
{
    const sbi_skin_embedded *made = (const sbi_skin_embedded *)skin->user;
    const sb_embedded_point *held = made->embedding->points + point;
    at->cell = made->is_live ? held->element : made->cells[held->element];
    memcpy(at->xi, held->xi, sizeof at->xi);
    memcpy(at->step, held->step, sizeof at->step);
}

/* ---- how points are held ---- */

/* The embedding that the body's state needs to know about; NULL: it holds nothing, as the mesh never changes or has
 * just been loaded without memory to place the points. */
static sb_embedding *sbi_skin_get_follower(const sb_skin *skin)
{
    sb_embedding *embedding = ((const sbi_skin_embedded *)skin->user)->embedding;
    const sbi_embed_follower *f = embedding->follower;
    return f && f->owner.body && !f->stale ? embedding : NULL;
}

enum { SBI_SKIN_VECTORS = 5, SBI_SKIN_REALS = 3 * SBI_SKIN_VECTORS + 2 };

/* What a saved point has, in order: those inside have the first alone, and the second where normals are carried. */
static int sbi_skin_list_vectors(const sb_embedding *e, sbi_embed_held *held, sb_real *vectors[SBI_SKIN_VECTORS])
{
    vectors[0] = held->info.xi;
    vectors[1] = held->place.carried;
    vectors[2] = held->info.step;
    vectors[3] = held->place.offset;
    vectors[4] = held->place.parameters;
    return held->place.hold != SB_EMBEDDED_INSIDE ? (int)SBI_SKIN_VECTORS : e->rest_normals ? 2 : 1;
}

static void sbi_skin_put_point(const sb_embedding *e, sbi_embed_held held, sbi_state_out *out)
{
    sb_real *vectors[SBI_SKIN_VECTORS], distances[2];
    int count = sbi_skin_list_vectors(e, &held, vectors);
    distances[0] = held.place.gap, distances[1] = held.info.distance;
    sbi_part_put_int(out, (int)held.place.hold);
    sbi_part_put_int(out, held.place.cell);
    for (int k = 0; k < count; k++)
        sbi_part_put_reals(out, vectors[k], 3);
    if (held.place.hold != SB_EMBEDDED_INSIDE)
        sbi_part_put_reals(out, distances, 2);
}

static sbi_embed_held sbi_skin_get_held(const sb_embedding *e, sbi_part_in *in)
{
    sb_real *vectors[SBI_SKIN_VECTORS], distances[2] = {0, 0};
    sbi_embed_held held;
    int count;
    memset(&held, 0, sizeof held);
    held.place.hold = held.info.hold = (sb_embedding_hold)sbi_part_get_int(in);
    held.place.cell = held.info.element = sbi_part_get_int(in);
    if (sbi_embed_is_on_face(held.place.hold))
        held.info.element /= e->follower->faces;
    count = sbi_skin_list_vectors(e, &held, vectors);
    for (int k = 0; k < count; k++)
        sbi_part_get_reals(in, vectors[k], 3);
    if (held.place.hold != SB_EMBEDDED_INSIDE)
        sbi_part_get_reals(in, distances, 2);
    else
        memcpy(held.place.parameters, held.info.xi, sizeof held.info.xi);
    held.place.gap = distances[0], held.info.distance = distances[1];
    return held;
}

static void sbi_skin_save(const sb_skin *skin, sbi_state_out *out)
{
    const sb_embedding *e = sbi_skin_get_follower(skin);
    sbi_part_put_int(out, e ? skin->point_count : 0);
    for (int p = 0; e && p < skin->point_count; p++)
        sbi_skin_put_point(e, sbi_embed_get_held(e, p), out);
}

/* 1: its points are held as what is left says, or that is damaged. */
static int sbi_skin_is_held_so(const sb_embedding *e, int count, sbi_part_in *in)
{
    int same = 1;
    for (int p = 0; p < count && !in->bad; p++) {
        sbi_embed_held held = sbi_skin_get_held(e, in);
        same &= !e->follower->stale && sbi_embed_is_held_so(e, p, &held);
    }
    in->bad |= in->left != 0;
    return same;
}

static sb_result sbi_skin_prepare(sb_embedding *e, const sb_body *body, int count, sbi_part_in *in, sb_error *error)
{
    sbi_embed_slots mesh;
    sbi_embed_held *held = (sbi_embed_held *)sbi_alloc(&e->allocator, (size_t)count, sizeof *held);
    sb_result result;
    if (!held)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a skin of %d points to follow a state", count);
    for (int p = 0; p < count; p++)
        held[p] = sbi_skin_get_held(e, in);
    sbi_body_fill_embed_slots(body, &mesh);
    result = sbi_embed_prepare(e, &mesh, held, error);
    sbi_free(&e->allocator, held);
    return result;
}

static sb_result sbi_skin_check_held(sb_skin *skin, const sb_body *body, sbi_part_in in, sb_error *error)
{
    sb_embedding *e = ((sbi_skin_embedded *)skin->user)->embedding;
    int count = sbi_part_get_int(&in), follows = e->follower && e->follower->owner.body, same;
    sbi_part_in points = in;
    if (in.bad || (count && (count != skin->point_count || !body->live)))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved skin is damaged");
    if (count && !follows)
        return sbi_fail(error, SB_ERROR_STATE, "the skin's embedding does not follow the body any more");
    same = sbi_skin_is_held_so(e, count, &points);
    if (points.bad)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved skin is damaged");
    if (!count || (same && body == e->follower->owner.body))
        return SB_OK;
    return sbi_skin_prepare(e, body, count, &in, error);
}

static int sbi_skin_load(sb_skin *skin)
{
    sb_embedding *e = ((sbi_skin_embedded *)skin->user)->embedding;
    if (!e->follower || !e->follower->prepared)
        return 0;
    sbi_embed_take_prepared(e);
    return 1;
}

static void sbi_skin_give_up(sb_skin *skin)
{
    sb_embedding *e = ((sbi_skin_embedded *)skin->user)->embedding;
    if (e->follower)
        sbi_embed_drop_prepared(e, e->follower);
}

static size_t sbi_skin_kept_size(const sb_skin *skin)
{
    const sb_embedding *e = ((const sbi_skin_embedded *)skin->user)->embedding;
    return e->follower ? (size_t)skin->point_count * sizeof(sbi_embed_held) : 0;
}

static int sbi_skin_keep(const sb_skin *skin, void *memory)
{
    sb_embedding *e = ((const sbi_skin_embedded *)skin->user)->embedding;
    sbi_embed_held *held = (sbi_embed_held *)memory;
    if (sbi_embed_is_stale(e))
        return 0;
    for (int p = 0; e->follower && p < skin->point_count; p++)
        held[p] = sbi_embed_get_held(e, p);
    return 1;
}

static int sbi_skin_rewind(sb_skin *skin, const void *memory)
{
    sb_embedding *e = ((sbi_skin_embedded *)skin->user)->embedding;
    if (sbi_embed_is_stale(e))
        return 0;
    return !e->follower || sbi_embed_hold(e, (const sbi_embed_held *)memory);
}

/* ---- making one ---- */

static sb_result sbi_skin_check(const sb_embedding *embedding, const sb_mesh *surface, sb_error *error)
{
    int points;
    sb_result result;
    if (!embedding || !surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a skin needs an embedding and triangles");
    result = sbi_mesh_check_arrays(surface, error);
    if (result != SB_OK)
        return result;
    if (surface->element_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a skin needs triangles");
    if (surface->element_type != SB_TRI3)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a skin is of tri3, not of %s",
                        sb_element_name(surface->element_type));
    points = embedding->report.point_count;
    for (int i = 0; i < surface->element_count; i++)
        for (int k = 0; k < 3; k++) {
            int point = surface->elements[3 * (size_t)i + (size_t)k];
            if (point < 0 || point >= points)
                return sbi_fail_element(error, SB_ERROR_INDEX, i, "triangle %d has corner %d, there are %d points", i,
                                        point, points);
        }
    return SB_OK;
}

SB_API sb_result sb_skin_create(sb_embedding *embedding, const sb_mesh *surface, const sb_allocator *allocator,
                                sb_skin **skin, sb_error *error)
{
    sbi_skin_embedded *made;
    sb_result result = sbi_skin_check(embedding, surface, error);
    if (result == SB_OK && !skin)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the skin");
    if (result != SB_OK)
        return result;
    made = (sbi_skin_embedded *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    if (made)
        made->triangles = (int(*)[3])sbi_alloc(allocator, (size_t)surface->element_count, sizeof *made->triangles);
    for (int i = 0; made && i < embedding->report.point_count; i++)
        made->cell_count = sbi_max_int(made->cell_count, embedding->points[i].element + 1);
    if (made)
        made->cells = (int *)sbi_alloc(allocator, (size_t)made->cell_count, sizeof(int));
    if (!made || !made->triangles || !made->cells) {
        if (made) {
            sbi_free(allocator, made->cells);
            sbi_free(allocator, made->triangles);
        }
        sbi_free(allocator, made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a skin of %d triangles", surface->element_count);
    }
    if (allocator)
        made->allocator = *allocator;
    memcpy(made->triangles, surface->elements, (size_t)surface->element_count * sizeof *made->triangles);
    made->embedding = embedding;
    made->skin.user = made;
    made->skin.update = sbi_skin_update;
    made->skin.get_point = sbi_skin_get_point;
    made->skin.save = sbi_skin_save;
    made->skin.check = sbi_skin_check_held;
    made->skin.load = sbi_skin_load;
    made->skin.give_up = sbi_skin_give_up;
    made->skin.kept_size = sbi_skin_kept_size;
    made->skin.keep = sbi_skin_keep;
    made->skin.rewind = sbi_skin_rewind;
    made->skin.point_count = embedding->report.point_count;
    made->skin.face_count = surface->element_count;
    made->skin.triangles = (const int(*)[3])made->triangles;
    *skin = &made->skin;
    return SB_OK;
}

SB_API void sb_skin_destroy(sb_skin *skin)
{
    sbi_skin_embedded *made;
    sb_allocator allocator;
    if (!skin || skin->update != sbi_skin_update)
        return;
    made = (sbi_skin_embedded *)skin->user;
    allocator = made->allocator;
    sbi_free(&allocator, made->triangles);
    sbi_free(&allocator, made->cells);
    sbi_free(&allocator, made);
}
