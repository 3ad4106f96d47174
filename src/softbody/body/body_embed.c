/* body_embed: an embedding as a listener of a body. */
#include "body_embed.h"

#include <string.h>

#include "../geometry/embed_held.h"
#include "live_private.h"

SBI_API void sbi_body_fill_embed_slots(const sb_body *body, sbi_embed_slots *mesh)
{
    mesh->node_end = body->domain.node_count;
    mesh->cell_end = body->domain.cell_count;
    mesh->nodes = body->reference;
    mesh->cells = body->domain.cells;
    mesh->used = body->live->cells.used;
    mesh->find_cell = body->live->find;
    mesh->find_user = body->live->find_user;
}

static sb_result sbi_body_embed_load(sb_embedding *embedding, const sb_body *body, sb_error *error)
{
    sbi_embed_slots mesh;
    sbi_body_fill_embed_slots(body, &mesh);
    return sbi_embed_follower_load(embedding, &mesh, error);
}

static sb_result sbi_body_embed_refresh(sb_embedding *embedding, sb_error *error)
{
    const sb_body *body = (const sb_body *)embedding->follower->owner.body;
    return body ? sbi_body_embed_load(embedding, body, error) : SB_ERROR_MEMORY;
}

static void sbi_body_embed_leave(sb_embedding *embedding)
{
    sbi_embed_owner *owner = &embedding->follower->owner;
    sb_body_unlisten((sb_body *)owner->body, owner->id);
    owner->body = NULL;
}

/* ---- what the body calls ---- */

static sb_result sbi_body_embed_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    (void)body;
    return sbi_embed_follower_reserve((sb_embedding *)user, change, error);
}

static void sbi_body_embed_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    sb_embedding *embedding = (sb_embedding *)user;
    if (change)
        sbi_embed_follower_follow(embedding);
    else if (embedding->follower->prepared)
        sbi_embed_take_prepared(embedding);
    else if (body->live->find)
        embedding->follower->stale = 1; /* until it is used: who knows of cuts has not loaded yet what it knows */
    else
        sbi_body_embed_load(embedding, body, NULL); /* or it is stale, and tries again later */
}

static void sbi_body_embed_give_up(void *user) { sbi_embed_follower_give_up((sb_embedding *)user); }

static void sbi_body_embed_end(void *user) { ((sb_embedding *)user)->follower->owner.body = NULL; }

SB_API sb_result sb_embedding_follow(sb_embedding *embedding, sb_body *body, sb_error *error)
{
    sb_body_listener listener;
    sb_result result;
    int id;
    if (!embedding || !body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_embedding_follow needs an embedding and a body");
    if (embedding->follower && embedding->follower->owner.body)
        return sbi_fail(error, SB_ERROR_STATE, "the embedding follows a body already");
    if (embedding->type != body->domain.element_type)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "an embedding in %s cannot follow a body of %s",
                        sb_element_name(embedding->type), sb_element_name(body->domain.element_type));
    memset(&listener, 0, sizeof listener);
    listener.user = embedding;
    listener.reserve = sbi_body_embed_reserve;
    listener.follow = sbi_body_embed_follow;
    listener.give_up = sbi_body_embed_give_up;
    listener.end = sbi_body_embed_end;
    result = sbi_live_listen(body, &listener, 1, &id, error); /* contact may be on its points */
    if (result != SB_OK)
        return result;
    result = sbi_body_embed_load(embedding, body, error);
    if (result != SB_OK) {
        sb_body_unlisten(body, id);
        return result;
    }
    embedding->follower->owner.body = body;
    embedding->follower->owner.id = id;
    embedding->follower->owner.refresh = sbi_body_embed_refresh;
    embedding->follower->owner.leave = sbi_body_embed_leave;
    return SB_OK;
}

SB_API sb_result sb_embedding_unfollow(sb_embedding *embedding)
{
    if (!embedding)
        return SB_ERROR_ARGUMENT;
    if (!embedding->follower || !embedding->follower->owner.body)
        return SB_ERROR_STATE;
    sbi_body_embed_leave(embedding);
    return SB_OK;
}
