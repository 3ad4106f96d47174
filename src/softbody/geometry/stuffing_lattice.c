/* stuffing_lattice: the lattice of points, sets of them, distances to the shapes, tasks over them. */
#include "stuffing_private.h"

/* ---- shapes ---- */

/* How far a point lies beyond the first shape's box; negative inside. */
static sb_real sbi_stuffing_beyond_box(const sbi_stuffing *s, sb_vec3 p)
{
    sb_real x = sb_max(s->low.x - p.x, p.x - s->high.x), y = sb_max(s->low.y - p.y, p.y - s->high.y);
    return sb_max(sb_max(x, y), sb_max(s->low.z - p.z, p.z - s->high.z));
}

SBI_API sb_real sbi_stuffing_value(const sbi_stuffing *s, int shape, sb_vec3 p)
{
    const sb_shape *g = s->def->shapes + shape;
    sb_real value;
    if (g->surface)
        return sb_surface_signed_distance(g->surface, p, NULL);
    value = g->distance(g->user, p);
    return shape == 0 && sb_is_finite(value) ? sb_max(value, sbi_stuffing_beyond_box(s, p)) : value;
}

SBI_API sb_real sbi_stuffing_sure_value(const sbi_stuffing *s, int shape, sb_vec3 p)
{
    const sb_shape *g = s->def->shapes + shape;
    return g->surface ? sb_surface_signed_distance_winding(g->surface, p, NULL) : sbi_stuffing_value(s, shape, p);
}

SBI_API int sbi_stuffing_encloses(const sbi_stuffing *s, int shape, sb_vec3 p, sb_real reach)
{
    sb_real beyond = shape == 0 ? sbi_stuffing_beyond_box(s, p) : -SB_REAL_MAX;
    if (!sb_surface_inside(s->def->shapes[shape].surface, p) || beyond >= reach)
        return 0;
    return beyond < -reach ? 1 : -1;
}

static int sbi_stuffing_is_inside(const sbi_stuffing *s, int shape, sb_vec3 p)
{
    return s->def->shapes[shape].surface ? sbi_stuffing_encloses(s, shape, p, 0) : sbi_stuffing_value(s, shape, p) < 0;
}

SBI_API sb_real sbi_stuffing_slope(const sbi_stuffing *s, int shape)
{
    const sb_shape *g = s->def->shapes + shape;
    if (g->surface)
        return 1;
    return shape == 0 && g->max_slope > 0 ? sb_max(g->max_slope, 1) : g->max_slope;
}

SBI_API unsigned char sbi_stuffing_label(uint64_t inside)
{
    unsigned char label = 0;
    if (!(inside & 1))
        return 0;
    for (; inside; inside >>= 1)
        label++;
    return label;
}

SBI_API unsigned char sbi_stuffing_label_at(const sbi_stuffing *s, sb_vec3 p)
{
    if (!sbi_stuffing_is_inside(s, 0, p))
        return 0;
    for (int shape = s->def->shape_count - 1; shape > 0; shape--)
        if (sbi_stuffing_is_inside(s, shape, p))
            return (unsigned char)(shape + 1);
    return 1;
}

SBI_API int sbi_stuffing_separator(int a, int b) { return a == 0 || b == 0 ? 0 : sbi_max_int(a, b) - 1; }

/* ---- the lattice ---- */

SBI_API void sbi_stuffing_coordinates(const sbi_stuffing *s, size_t index, int half[3])
{
    size_t cell = index >> 1;
    int odd = (int)(index & 1);
    half[0] = 2 * (int)(cell % s->stride[1]) + odd;
    half[1] = 2 * (int)(cell % s->stride[2] / s->stride[1]) + odd;
    half[2] = 2 * (int)(cell / s->stride[2]) + odd;
}

/* ---- sets ---- */

SBI_API int sbi_stuffing_set_make(sbi_stuffing *s, sbi_stuffing_set *set)
{
    set->word_count = s->point_count / 64 + 1;
    set->words = (uint64_t *)sbi_alloc_zeroed(&s->def->allocator, set->word_count, sizeof *set->words);
    set->before = (int *)sbi_alloc(&s->def->allocator, set->word_count, sizeof *set->before);
    return set->words && set->before;
}

SBI_API void sbi_stuffing_set_free(sbi_stuffing *s, sbi_stuffing_set *set)
{
    sbi_free(&s->def->allocator, set->words);
    sbi_free(&s->def->allocator, set->before);
}

static int sbi_stuffing_bit_count(uint64_t word)
{
    word -= word >> 1 & 0x5555555555555555u;
    word = (word & 0x3333333333333333u) + (word >> 2 & 0x3333333333333333u);
    word = (word + (word >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return (int)(word * 0x0101010101010101u >> 56);
}

SBI_API int sbi_stuffing_set_number(sbi_stuffing_set *set)
{
    int64_t count = 0;
    for (size_t w = 0; w < set->word_count; w++) {
        set->before[w] = (int)count;
        count += sbi_stuffing_bit_count(set->words[w]);
        if (count > INT_MAX)
            return 0;
    }
    set->count = (int)count;
    return 1;
}

SBI_API int sbi_stuffing_set_rank(const sbi_stuffing_set *set, size_t index)
{
    uint64_t below = set->words[index >> 6] & (((uint64_t)1 << (index & 63)) - 1);
    return set->before[index >> 6] + sbi_stuffing_bit_count(below);
}

SBI_API sb_result sbi_stuffing_too_many(const sbi_stuffing *s)
{
    return sbi_fail(s->error, SB_ERROR_ARGUMENT, "cells of %g m make more than max_elements (%d) elements",
                    (double)s->def->cell, s->def->max_elements);
}

SBI_API sb_result sbi_stuffing_no_memory(const sbi_stuffing *s)
{
    return sbi_fail(s->error, SB_ERROR_MEMORY, "out of memory for a lattice of %d x %d x %d cells", s->n[0], s->n[1],
                    s->n[2]);
}

SBI_API sb_result sbi_stuffing_progress(sbi_stuffing *s, double fraction)
{
    *s->reported = fraction > *s->reported ? fraction : *s->reported;
    if (s->def->progress && s->def->progress(s->def->progress_user, *s->reported))
        return sbi_fail(s->error, SB_ERROR_CANCELLED, "stopped by the progress callback at %.0f %%",
                        100 * *s->reported);
    return SB_OK;
}

SBI_API sb_result sbi_stuffing_run(sbi_stuffing *s, sb_task task, int count)
{
    for (int i = 0; i < count; i++)
        s->failures[i].shape = -1;
    sbi_run(&s->def->jobs, task, s, count);
    for (int i = 0; i < count; i++)
        if (s->failures[i].shape >= 0) {
            const sbi_stuffing_failure *f = s->failures + i;
            return sbi_fail(s->error, SB_ERROR_NOT_FINITE, "the distance of shape %d is not finite at (%g, %g, %g)",
                            f->shape, (double)f->at.x, (double)f->at.y, (double)f->at.z);
        }
    return SB_OK;
}
