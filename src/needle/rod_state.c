/* rod_state: saves what a rod is at, and brings it back to the last bit. */
#include "rod_state.h"

#include <string.h>

#include "image.h"
#include "rod_private.h"

static int ndli_state_is_flag(int value) { return value == 0 || value == 1; }

static const char ndli_rod_magic[9] = "NDLROD\x1a\x1a";

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

/* Returns where the bytes that are no numbers begin. */
static size_t ndli_rod_walk(ndl_rod *rod, int node_count, ndli_image *image)
{
    ndli_v3 *node_vectors[] = {rod->x, rod->v, rod->a, rod->target, rod->target_velocity, rod->force, rod->reaction};
    ndli_v3 *edge_vectors[] = {rod->director, rod->tangent};
    double *edge_reals[] = {rod->theta, rod->rest_length, rod->turn,   rod->torque,
                            rod->grip,  rod->grip_limit,  rod->anchor, rod->reaction_torque};
    size_t n = (size_t)node_count, flags;
    for (size_t i = 0; i < sizeof node_vectors / sizeof *node_vectors; i++)
        ndli_image_part(image, node_vectors[i], n, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof edge_vectors / sizeof *edge_vectors; i++)
        ndli_image_part(image, edge_vectors[i], n - 1, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof edge_reals / sizeof *edge_reals; i++)
        ndli_image_part(image, edge_reals[i], n - 1, sizeof(double));
    ndli_image_part(image, rod->mass, n, sizeof(double));
    ndli_image_part(image, rod->cell, n, sizeof(double));
    ndli_image_part(image, rod->rest_bend, n, 2 * sizeof(double));
    flags = image->used;
    ndli_image_part(image, rod->held, n, 1);
    ndli_image_part(image, rod->has_velocity, n, 1);
    ndli_image_part(image, rod->turn_held, n - 1, 1);
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

static sb_result ndli_rod_check_head(const ndl_rod *rod, const ndli_rod_head *head, sb_error *error)
{
    ndli_rod_head own;
    ndli_rod_fill_head(rod, &own);
    if (head->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved rod is of a machine with another order of bytes");
    if (memcmp(&own, head, 6 * sizeof(double)) != 0 || own.max_newton != head->max_newton)
        return sbi_fail(error, SB_ERROR_STATE, "the saved rod was made from another def");
    if (head->node_count > rod->capacity)
        return sbi_fail(error, SB_ERROR_STATE, "the saved rod has %d nodes, this one room for %d", head->node_count,
                        rod->capacity);
    if (head->node_count < 2 || head->grips < 0 || head->grips >= head->node_count ||
        !ndli_state_is_flag(head->plain) || !ndli_state_is_flag(head->base_director_set) ||
        !ndli_state_is_flag(head->energy_monitored))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod has counts or flags out of their range");
    return SB_OK;
}

NDLI_API sb_result ndli_rod_check(const ndl_rod *rod, const unsigned char *in, size_t size, size_t *used, int *nodes,
                                  sb_error *error)
{
    ndl_rod view = *rod;
    ndli_rod_head head;
    size_t flags;
    sb_result result;
    if (size < sizeof head)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod ends in its head");
    memcpy(&head, in, sizeof head);
    result = ndli_rod_check_head(rod, &head, error);
    if (result != SB_OK)
        return result;
    *used = ndli_rod_measure(&view, head.node_count, &flags);
    *nodes = head.node_count;
    if (*used > size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod ends before its %d nodes do", head.node_count);
    for (size_t at = 0; at < flags; at += sizeof(double)) {
        double value;
        memcpy(&value, in + at, sizeof value);
        if ((at < 15 * sizeof(double) || at >= sizeof head) && value - value != 0)
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "the saved rod holds a number that is not finite");
    }
    return SB_OK;
}

NDLI_API void ndli_rod_put(const ndl_rod *rod, sbi_state_out *out)
{
    ndl_rod view = *rod;
    ndli_rod_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.state = out;
    ndli_rod_fill_head(rod, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_rod_walk(&view, head.node_count, &image);
}

static sb_result ndli_rod_check_image(const ndl_rod *rod, const void *buffer, size_t size, sb_error *error)
{
    size_t told, used;
    int nodes;
    sb_result result = ndli_image_check(buffer, size, ndli_rod_magic, "rod", error);
    if (result != SB_OK)
        return result;
    told = (size_t)sbi_get_bytes((const unsigned char *)buffer + 16, 8) - SBI_IMAGE_HEAD - SBI_IMAGE_TAIL;
    result = ndli_rod_check(rod, (const unsigned char *)buffer + SBI_IMAGE_HEAD, told, &used, &nodes, error);
    if (result == SB_OK && used != told)
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved rod goes on behind its nodes");
    return result;
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
