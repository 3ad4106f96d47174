/* body_kept: room for a tangent that steps keep, and whether it still is one of the body. See step_kept.c. */
#include <string.h>

#include "body_private.h"

/* ---- what is kept ---- */

static void sbi_kept_layout(const sb_body *b, sbi_kept *kept, sbi_arena *arena)
{
    size_t cells = (size_t)sbi_assembly_cell_room(&b->domain), nodes = (size_t)b->node_capacity;
    kept->rotation_count = (cells + SB_POLAR_LANES - 1) / SB_POLAR_LANES * 4 * SB_POLAR_LANES;
    for (int k = 0; k < 2; k++) {
        kept->rotations[k] = (sb_real *)sbi_arena_take(arena, kept->rotation_count, sizeof(sb_real));
        kept->positions[k] = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    }
}

/* Clouds are batched as tet4 are, but nobody has measured how theirs do. */
SBI_API int sbi_kept_fits(const sb_body *b) { return b->domain.element_type == SB_TET4 && b->assembly.batch_quats; }

SBI_API int sbi_kept_take(sb_body *to)
{
    sbi_arena arena;
    sbi_kept *kept, made;
    memset(&arena, 0, sizeof arena);
    memset(&made, 0, sizeof made);
    (void)sbi_arena_take(&arena, 1, sizeof *kept);
    sbi_kept_layout(to, &made, &arena);
    if (arena.overflow)
        return 0;
    arena.base = (unsigned char *)sbi_alloc_zeroed(&to->allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    kept = (sbi_kept *)sbi_arena_take(&arena, 1, sizeof *kept);
    sbi_kept_layout(to, kept, &arena);
    for (size_t i = 0; i < kept->rotation_count; i++) /* lanes without a cell stay none that could overflow */
        kept->rotations[0][i] = kept->rotations[1][i] = (i / SB_POLAR_LANES) % 4 == 0 ? (sb_real)1 : (sb_real)0;
    to->kept = kept;
    return 1;
}

SBI_API void sbi_kept_forget(sb_body *body)
{
    if (body->kept)
        body->kept->made.valid = body->kept->current = 0;
}

SBI_API int sbi_kept_is_valid(const sb_body *b)
{
    const sbi_kept *kept = b->kept;
    return kept && kept->made.valid;
}

SBI_API void sbi_kept_note(sb_body *b, sbi_precond_memory before)
{
    sbi_kept *kept = b->kept;
    size_t nodes = (size_t)b->domain.node_count;
    int slot = 1 - kept->made.slot;
    kept->made.valid = kept->current = 1;
    kept->made.slot = slot;
    kept->made.mass = kept->mass;
    kept->made.stiffness = kept->stiffness;
    kept->made.before = before;
    memcpy(kept->rotations[slot], b->assembly.batch_quats, kept->rotation_count * sizeof(sb_real));
    memcpy(kept->positions[slot], b->position, nodes * sizeof(sb_vec3));
    kept->stamps[slot] = ++kept->count;
}

SBI_API void sbi_kept_save(sb_body *body)
{
    if (body->kept)
        body->kept->saved = body->kept->made;
}

SBI_API void sbi_kept_restore(sb_body *body)
{
    sbi_kept *kept = body->kept;
    if (!kept)
        return;
    if (kept->made.slot != kept->saved.slot)
        kept->current = 0;
    kept->made = kept->saved;
}

/* ---- the setting ---- */

SB_API sb_result sb_body_keep_tangent(sb_body *body, sb_real angle, sb_error *error)
{
    if (!body || !(angle >= 0) || !(angle <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tangent is kept up to an angle of 0 to 1, not %g", (double)angle);
    if (!sbi_kept_fits(body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "only bodies of tet4 keep their tangent");
    if (angle > 0 && !body->kept && !sbi_kept_take(body))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to keep a tangent");
    sbi_kept_forget(body);
    if (body->kept)
        body->kept->angle = angle;
    sbi_body_tell(body, SBI_COMMAND_KEEP_TANGENT, 0, 0, NULL, 0, &angle, 1);
    return SB_OK;
}
