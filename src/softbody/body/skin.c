/* skin: triangles between embedded points. */
#include "skin.h"

#include <string.h>

#include "../geometry/embed_follow.h"
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
