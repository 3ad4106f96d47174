/* state_part: parts of a body's state that others keep. In the image each is its name (8 bytes), version (4), size (8)
 * and bytes. */
#include "state_part.h"

#include <string.h>

#include "../base/bytes.h"
#include "body_private.h"

enum { SBI_PART_NAME = 8, SBI_PART_HEAD = SBI_PART_NAME + 4 + 8 };

SBI_API void sbi_state_put(sbi_state_out *out, const void *bytes, size_t size)
{
    if (size == 0)
        return;
    if (out->bytes)
        memcpy(out->bytes + out->used, bytes, size);
    for (size_t i = 0; out->hashes && i < size; i += 8) {
        int width = size - i < 8 ? (int)(size - i) : 8;
        out->hash = sbi_hash_word(out->hash, sbi_get_bytes((const unsigned char *)bytes + i, width));
    }
    out->overflow |= !sbi_size_add(&out->used, size, 1);
}

/* ---- numbers ---- */

static SBI_NOINLINE void sbi_state_put_number(sbi_state_out *out, uint64_t value, int bytes)
{
    unsigned char number[8];
    sbi_put_bytes(number, value, bytes);
    sbi_state_put(out, number, (size_t)bytes);
}

SBI_API void sbi_part_put_int(sbi_state_out *out, int value)
{
    sbi_state_put_number(out, (uint64_t)(uint32_t)value, 4);
}

SBI_API void sbi_part_put_reals(sbi_state_out *out, const sb_real *values, int count)
{
    for (int i = 0; i < count; i++)
        sbi_state_put_number(out, sbi_real_bits(values[i]), 8);
}

SBI_API sbi_part_in sbi_part_read(const unsigned char *bytes, size_t size)
{
    sbi_part_in in;
    in.bytes = bytes;
    in.left = size;
    in.bad = 0;
    return in;
}

SBI_API uint64_t sbi_part_get(sbi_part_in *in, int bytes)
{
    uint64_t value;
    if (in->left < (size_t)bytes) {
        in->bad = 1;
        in->left = 0;
        return 0;
    }
    value = sbi_get_bytes(in->bytes, bytes);
    in->bytes += bytes;
    in->left -= (size_t)bytes;
    return value;
}

SBI_API int sbi_part_get_int(sbi_part_in *in) { return sbi_int_of(sbi_part_get(in, 4)); }

SBI_API void sbi_part_get_reals(sbi_part_in *in, sb_real *values, int count)
{
    for (int i = 0; i < count; i++) {
        values[i] = sbi_real_of(sbi_part_get(in, 8));
        if (sb_is_finite(values[i]))
            continue;
        values[i] = 0;
        in->bad = 1;
    }
}

SBI_API int sbi_part_get_count(sbi_part_in *in, int bytes)
{
    int count = sbi_part_get_int(in);
    if (count >= 0 && (size_t)count <= in->left / (size_t)bytes)
        return count;
    in->bad = 1;
    return 0;
}

/* ---- who has joined ---- */

/* The parts of a body, made when there are none; NULL: no memory. */
static sbi_state_parts *sbi_state_parts_of(sb_body *body)
{
    if (!body->parts)
        body->parts = (sbi_state_parts *)sbi_alloc_zeroed(&body->allocator, 1, sizeof *body->parts);
    return body->parts;
}

static int sbi_state_parts_grow(const sb_body *body, sbi_state_parts *parts)
{
    int capacity = parts->capacity + parts->capacity / 2 + 2;
    sbi_state_part *grown = (sbi_state_part *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof *grown);
    if (!grown)
        return 0;
    if (parts->count)
        memcpy(grown, parts->list, (size_t)parts->count * sizeof *grown);
    sbi_free(&body->allocator, parts->list);
    parts->list = grown;
    parts->capacity = capacity;
    return 1;
}

/* The place of a name, or where it would go. */
static int sbi_state_parts_place(const sbi_state_parts *parts, const char *name)
{
    int at = 0;
    while (at < parts->count && strncmp(parts->list[at].name, name, SBI_PART_NAME) < 0)
        at++;
    return at;
}

static sbi_state_part *sbi_state_parts_find(const sb_body *body, const char *name)
{
    const sbi_state_parts *parts = body->parts;
    int at = parts ? sbi_state_parts_place(parts, name) : 0;
    return parts && at < parts->count && strncmp(parts->list[at].name, name, SBI_PART_NAME) == 0 ? parts->list + at
                                                                                                 : NULL;
}

SBI_API void *sbi_body_find_part(const sb_body *body, const char *name)
{
    const sbi_state_part *part = sbi_state_parts_find(body, name);
    return part ? part->user : NULL;
}

SBI_API sb_result sbi_body_join(sb_body *body, const sbi_state_part *part, sb_error *error)
{
    sbi_state_parts *parts = sbi_state_parts_of(body);
    int at;
    if (!part->name[0] || sbi_state_parts_find(body, part->name))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body's state has a part '%.8s' already", part->name);
    if (!parts || (parts->count == parts->capacity && !sbi_state_parts_grow(body, parts)))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a part '%.8s' of the body's state", part->name);
    at = sbi_state_parts_place(parts, part->name);
    memmove(parts->list + at + 1, parts->list + at, (size_t)(parts->count - at) * sizeof *parts->list);
    parts->list[at] = *part;
    parts->count++;
    return SB_OK;
}

SBI_API void sbi_body_leave(sb_body *body, const char *name)
{
    sbi_state_part *part = sbi_state_parts_find(body, name);
    sbi_state_parts *parts = body->parts;
    if (!part)
        return;
    parts->count--;
    memmove(part, part + 1, (size_t)(parts->list + parts->count - part) * sizeof *part);
}

SBI_API void sbi_state_parts_free(sb_body *body)
{
    if (body->parts)
        sbi_free(&body->allocator, body->parts->list);
    sbi_free(&body->allocator, body->parts);
    body->parts = NULL;
}

/* ---- the image ---- */

SBI_API void sbi_state_parts_put(const sb_body *body, sbi_state_out *out)
{
    for (int i = 0; body->parts && i < body->parts->count; i++) {
        const sbi_state_part *part = body->parts->list + i;
        char name[SBI_PART_NAME] = {0};
        sbi_state_out size;
        memset(&size, 0, sizeof size);
        part->save(part->user, &size);
        memcpy(name, part->name, strlen(part->name));
        sbi_state_put(out, name, sizeof name);
        sbi_state_put_number(out, (uint64_t)part->version, 4);
        sbi_state_put_number(out, size.used, 8);
        part->save(part->user, out);
        out->overflow |= size.overflow;
    }
}

/* One part of an image. */
typedef struct sbi_part_view {
    char name[SBI_PART_NAME + 1];
    int version;
    const unsigned char *bytes;
    size_t size;
} sbi_part_view;

/* Takes the part at bytes + *at and steps on; 0: it ends too early. */
static int sbi_part_next(const unsigned char *bytes, size_t size, size_t *at, sbi_part_view *view)
{
    const unsigned char *head = bytes + *at;
    uint64_t length;
    if (size - *at < SBI_PART_HEAD)
        return 0;
    length = sbi_get_bytes(head + SBI_PART_NAME + 4, 8);
    if (length > size - *at - SBI_PART_HEAD)
        return 0;
    memset(view, 0, sizeof *view);
    memcpy(view->name, head, SBI_PART_NAME);
    view->version = sbi_int_of(sbi_get_bytes(head + SBI_PART_NAME, 4));
    view->bytes = head + SBI_PART_HEAD;
    view->size = (size_t)length;
    *at += SBI_PART_HEAD + view->size;
    return 1;
}

static void sbi_state_parts_give_up_first(const sb_body *owner, int count)
{
    for (int i = 0; i < count; i++)
        if (owner->parts->list[i].give_up)
            owner->parts->list[i].give_up(owner->parts->list[i].user);
}

SBI_API void sbi_state_parts_give_up(const sb_body *owner)
{
    sbi_state_parts_give_up_first(owner, owner->parts ? owner->parts->count : 0);
}

/* Whether part i of the owner may become what the image says. */
static sb_result sbi_state_part_check(const sb_body *owner, const sb_body *body, int i, const sbi_part_view *view,
                                      sb_error *error)
{
    const sbi_state_part *part = owner->parts ? owner->parts->list + i : NULL;
    int order = !part || i == owner->parts->count ? -1 : strncmp(view->name, part->name, SBI_PART_NAME);
    if (order < 0)
        return sbi_fail(error, SB_ERROR_STATE,
                        "the state was saved with a part '%.8s' that the body does not have: make what keeps it first, "
                        "as needles, their mesher or an sb_cut",
                        view->name);
    if (order > 0)
        return sbi_fail(error, SB_ERROR_STATE, "the state was saved without the part '%.8s' that the body has",
                        part->name);
    if (view->version != part->version)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved part '%.8s' has version %d, not %d", part->name,
                        view->version, part->version);
    return part->check(part->user, body, view->bytes, view->size, error);
}

SBI_API sb_result sbi_state_parts_check(const sb_body *owner, const sb_body *body, const unsigned char *bytes,
                                        size_t size, sb_error *error)
{
    int count = owner->parts ? owner->parts->count : 0, i = 0;
    size_t at = 0;
    sb_result result = SB_OK;
    while (at < size && result == SB_OK) {
        sbi_part_view view;
        if (!sbi_part_next(bytes, size, &at, &view))
            result = sbi_fail(error, SB_ERROR_FORMAT, "the saved state holds %lu bytes too many or too few",
                              (unsigned long)(size - at));
        else
            result = sbi_state_part_check(owner, body, i, &view, error);
        i += result == SB_OK;
    }
    if (result == SB_OK && i < count)
        result = sbi_fail(error, SB_ERROR_STATE, "the state was saved without the part '%.8s' that the body has",
                          owner->parts->list[i].name);
    if (result != SB_OK)
        sbi_state_parts_give_up_first(owner, i);
    return result;
}

SBI_API void sbi_state_parts_load(const sb_body *owner, const unsigned char *bytes)
{
    size_t at = 0;
    for (int i = 0; owner->parts && i < owner->parts->count; i++) {
        sbi_part_view view;
        memset(&view, 0, sizeof view);
        (void)sbi_part_next(bytes, (size_t)-1, &at, &view); /* it was checked */
        owner->parts->list[i].load(owner->parts->list[i].user, view.bytes, view.size);
    }
}

/* ---- recording ---- */

SBI_API void sbi_body_mute(sb_body *body)
{
    if (body->parts)
        body->parts->muted++;
}

SBI_API void sbi_body_unmute(sb_body *body)
{
    if (body->parts)
        body->parts->muted--;
}

static void sbi_part_tell(sb_body *body, sbi_command_code code, const char *name, sb_result result, const int *ints,
                          size_t int_count, const sb_real *reals, size_t real_count)
{
    unsigned char bytes[SBI_PART_NAME] = {0};
    int named[SBI_PART_NAME_INTS];
    sbi_command command;
    memset(&command, 0, sizeof command);
    memcpy(bytes, name, strlen(name));
    for (int k = 0; k < SBI_PART_NAME_INTS; k++)
        named[k] = sbi_int_of(sbi_get_bytes(bytes + 4 * k, 4));
    command.code = code;
    command.a = (int)result;
    command.ints = named;
    command.int_count = SBI_PART_NAME_INTS;
    command.more_ints = ints;
    command.more_int_count = int_count;
    command.reals = reals;
    command.real_count = real_count;
    sbi_body_tell_command(body, &command);
}

SBI_API void sbi_body_tell_part(sb_body *body, const char *name, const int *ints, size_t int_count,
                                const sb_real *reals, size_t real_count)
{
    sbi_part_tell(body, SBI_COMMAND_PART, name, SB_OK, ints, int_count, reals, real_count);
}

SBI_API void sbi_body_tell_part_step(sb_body *body, const char *name, sb_result result, const int *ints,
                                     size_t int_count, const sb_real *reals, size_t real_count)
{
    sbi_part_tell(body, SBI_COMMAND_PART_STEP, name, result, ints, int_count, reals, real_count);
}

SBI_API sb_result sbi_state_parts_replay(sb_body *body, const int *ints, size_t int_count, const sb_real *reals,
                                         size_t real_count, sb_error *error)
{
    char name[SBI_PART_NAME + 1] = {0};
    unsigned char bytes[SBI_PART_NAME];
    const sbi_state_part *part;
    if (int_count < SBI_PART_NAME_INTS)
        return sbi_fail(error, SB_ERROR_FORMAT, "the command of a part does not name it");
    for (int k = 0; k < SBI_PART_NAME_INTS; k++)
        sbi_put_bytes(bytes + 4 * k, (uint64_t)(uint32_t)ints[k], 4);
    memcpy(name, bytes, sizeof bytes);
    part = sbi_state_parts_find(body, name);
    if (!part || !part->replay)
        return sbi_fail(error, SB_ERROR_STATE,
                        "the recording holds commands of a part '%.8s' that the body does not have", name);
    return part->replay(part->user, ints + SBI_PART_NAME_INTS, int_count - SBI_PART_NAME_INTS, reals, real_count,
                        error);
}
