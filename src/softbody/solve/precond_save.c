/* precond_save: preconditioners as bytes. Floor 1.
 *
 * One walk serves measuring, writing, checking and reading: every value is named once, in its order. */
#include <float.h>
#include <string.h>

#include "precond_private.h"

#define SBI_PRECOND_MAGIC "SBPRECND"
enum { SBI_PRECOND_VERSION = 2 };

typedef enum sbi_precond_pass {
    SBI_PRECOND_MEASURE,
    SBI_PRECOND_WRITE,
    SBI_PRECOND_CHECK, /* of an image: is it this preconditioner's, and in order? */
    SBI_PRECOND_READ   /* cannot fail any more */
} sbi_precond_pass;

typedef struct sbi_precond_walk {
    sbi_precond_pass pass;
    unsigned char *out;      /* WRITE */
    const unsigned char *in; /* CHECK, READ */
    size_t used, size;       /* bytes: passed so far, of the content */
    int overflow;            /* MEASURE: used does not fit size_t */
    sb_result result;        /* CHECK: the first failure; what comes after it is 0 */
    sb_error *error;
} sbi_precond_walk;

static int sbi_precond_is_image(const sbi_precond_walk *w)
{
    return w->pass == SBI_PRECOND_CHECK || w->pass == SBI_PRECOND_READ;
}

/* The object's number goes in, the one that counts comes back. */
static uint64_t sbi_precond_word(sbi_precond_walk *w, uint64_t value, int bytes)
{
    size_t at = w->used;
    if (w->result != SB_OK)
        return 0;
    if (sbi_precond_is_image(w)) {
        if (w->size - at < (size_t)bytes) {
            w->result = sbi_fail(w->error, SB_ERROR_FORMAT, "the saved preconditioner ends too early");
            return 0;
        }
        value = sbi_get_bytes(w->in + at, bytes);
    } else if (w->pass == SBI_PRECOND_WRITE) {
        sbi_put_bytes(w->out + at, value, bytes);
    }
    w->overflow |= !sbi_size_add(&w->used, (size_t)bytes, 1);
    return value;
}

/* What the image and the object must agree on. */
static void sbi_precond_same(sbi_precond_walk *w, uint64_t value, const char *name)
{
    uint64_t got = sbi_precond_word(w, value, 8);
    if (w->pass == SBI_PRECOND_CHECK && w->result == SB_OK && got != value)
        w->result = sbi_fail(w->error, SB_ERROR_STATE,
                             "the preconditioner was saved from another one: %s is %lu "
                             "there, %lu here",
                             name, (unsigned long)got, (unsigned long)value);
}

static double sbi_precond_double(sbi_precond_walk *w, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    bits = sbi_precond_word(w, bits, 8);
    memcpy(&value, &bits, sizeof value);
    return value;
}

static float sbi_precond_float(sbi_precond_walk *w, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    bits = (uint32_t)sbi_precond_word(w, bits, 4);
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* One 3x3 block, rows of four without the fourths. */
static void sbi_precond_block(sbi_precond_walk *w, float *block, float got[9])
{
    for (int k = 0; k < 9; k++) {
        float *place = block + 4 * (k / 3) + k % 3;
        got[k] = sbi_precond_float(w, w->pass == SBI_PRECOND_WRITE ? *place : 0);
        if (w->pass == SBI_PRECOND_READ)
            *place = got[k];
    }
    for (int k = 3; w->pass == SBI_PRECOND_READ && k < 12; k += 4)
        block[k] = 0;
}

static int sbi_precond_block_is_finite(const float *block)
{
    for (int k = 0; k < 9; k++)
        if (!(block[k] >= -FLT_MAX && block[k] <= FLT_MAX))
            return 0;
    return 1;
}

/* Symmetric and positive definite, as far as single precision tells. */
static int sbi_precond_block_is_definite(const float *b)
{
    double minor = (double)b[0] * (double)b[4] - (double)b[1] * (double)b[3];
    double det = minor * (double)b[8] - (double)b[5] * ((double)b[0] * (double)b[7] - (double)b[1] * (double)b[6]) +
                 (double)b[2] * ((double)b[3] * (double)b[7] - (double)b[4] * (double)b[6]);
    return b[1] == b[3] && b[2] == b[6] && b[5] == b[7] && b[0] > 0 && minor > 0 && det > 0;
}

/* Lower triangular with a positive diagonal, given transposed. */
static int sbi_precond_block_is_pivot(const float *b)
{
    return b[0] > 0 && b[4] > 0 && b[8] > 0 && b[3] == 0 && b[6] == 0 && b[7] == 0;
}

enum { SBI_PRECOND_ANY, SBI_PRECOND_DEFINITE, SBI_PRECOND_PIVOT };

/* Blocks first <= e < last, of one node's row; `demand`: what the last of them must be. */
static void sbi_precond_blocks(sbi_precond_walk *w, float *blocks, int first, int last, int node, int demand)
{
    for (int e = first; e < last && w->result == SB_OK; e++) {
        float got[9];
        sbi_precond_block(w, blocks + 12 * (size_t)e, got);
        if (w->pass != SBI_PRECOND_CHECK || w->result != SB_OK)
            continue;
        if (!sbi_precond_block_is_finite(got))
            w->result = sbi_fail_node(w->error, SB_ERROR_NOT_FINITE, node,
                                      "the saved preconditioner is not finite at node %d", node);
        else if (e == last - 1 && ((demand == SBI_PRECOND_DEFINITE && !sbi_precond_block_is_definite(got)) ||
                                   (demand == SBI_PRECOND_PIVOT && !sbi_precond_block_is_pivot(got))))
            w->result = sbi_fail_node(w->error, SB_ERROR_FORMAT, node,
                                      "the saved preconditioner is not positive definite at node %d", node);
    }
}

/* The complete factor, without its rows' structure. */
static void sbi_precond_factor_values(sbi_precond_walk *w, sb_direct *direct)
{
    size_t count;
    sb_real *values = sbi_direct_values(direct, &count);
    sbi_precond_same(w, (uint64_t)count, "the number of the factor's entries");
    for (size_t k = 0; k < count && w->result == SB_OK; k++) {
        uint64_t word = w->pass == SBI_PRECOND_WRITE ? sbi_real_bits(values[k]) : 0;
        sb_real got = sbi_real_of(sbi_precond_word(w, word, (int)sizeof(sb_real)));
        if (w->pass == SBI_PRECOND_CHECK && w->result == SB_OK && !sb_is_finite(got))
            w->result = sbi_fail(w->error, SB_ERROR_NOT_FINITE, "entry %lu of the saved factor is not finite",
                                 (unsigned long)k);
        if (w->pass == SBI_PRECOND_READ)
            values[k] = got;
    }
}

/* What the last update learnt, and the power of two that it brought the matrix near 1 with. */
static void sbi_precond_numbers(sbi_precond_walk *w, sb_preconditioner *p)
{
    double scale = sbi_precond_double(w, p->matrix_scale);
    sbi_precond_memory memory = sbi_precond_get_memory(p);
    memory.shift = sbi_precond_double(w, memory.shift);
    memory.successes = sbi_int_of(sbi_precond_word(w, (uint64_t)(uint32_t)memory.successes, 4));
    memory.wait = sbi_int_of(sbi_precond_word(w, (uint64_t)(uint32_t)memory.wait, 4));
    if (w->pass == SBI_PRECOND_CHECK && w->result == SB_OK &&
        (!sbi_precond_is_memory(memory) || !(scale > 0) || scale != sbi_precond_power(0.5 / scale)))
        w->result = sbi_fail(w->error, SB_ERROR_FORMAT,
                             "the saved preconditioner has a shift %g or a scale %g that no "
                             "update gives",
                             memory.shift, scale);
    if (w->pass == SBI_PRECOND_READ) {
        p->matrix_scale = scale;
        sbi_precond_set_memory(p, memory);
    }
}

/* All of it. */
static void sbi_precond_pass_over(sb_preconditioner *p, sbi_precond_walk *w)
{
    int rows = p->row_count;
    sbi_precond_same(w, (uint64_t)p->kind, "the kind");
    sbi_precond_same(w, (uint64_t)p->fsai.power, "the power of the pattern");
    sbi_precond_same(w, (uint64_t)rows, "the number of rows");
    sbi_precond_same(w, (uint64_t)p->block_count, "the number of blocks");
    sbi_precond_same(w, p->pattern_hash, "the pattern's checksum");
    sbi_precond_same(w, (uint64_t)p->part[1], "the number of nodes that its factor's first half has");
    sbi_precond_numbers(w, p);
    for (int i = 0; p->inverse && i < rows; i++)
        sbi_precond_blocks(w, p->inverse, i, i + 1, i, SBI_PRECOND_DEFINITE);
    for (int k = 0; p->lower && k < rows; k++)
        sbi_precond_blocks(w, p->lower, p->start[k], p->start[k + 1], p->order[k], SBI_PRECOND_ANY);
    for (int i = 0; p->fsai.rows && i < rows; i++)
        sbi_precond_blocks(w, p->fsai.rows, p->fsai.start[i], p->fsai.start[i + 1], i, SBI_PRECOND_PIVOT);
    if (p->direct)
        sbi_precond_factor_values(w, p->direct);
}

SB_API size_t sb_preconditioner_saved_size(const sb_preconditioner *preconditioner)
{
    sbi_precond_walk walk;
    if (!preconditioner)
        return 0;
    if (preconditioner->kind == SB_PRECOND_MULTIGRID)
        return 0;
    memset(&walk, 0, sizeof walk);
    walk.pass = SBI_PRECOND_MEASURE;
    sbi_precond_pass_over((sb_preconditioner *)(uintptr_t)preconditioner, &walk);
    walk.overflow |= !sbi_size_add(&walk.used, SBI_IMAGE_HEAD + SBI_IMAGE_TAIL, 1);
    return walk.overflow ? 0 : walk.used;
}

SB_API sb_result sb_preconditioner_save(const sb_preconditioner *preconditioner, void *buffer, size_t size)
{
    size_t needed;
    sbi_precond_walk walk;
    if (!preconditioner || !buffer || !preconditioner->ready)
        return SB_ERROR_ARGUMENT;
    if (preconditioner->kind == SB_PRECOND_MULTIGRID)
        return SB_ERROR_UNSUPPORTED;
    needed = sb_preconditioner_saved_size(preconditioner);
    if (needed == 0 || size < needed)
        return SB_ERROR_ARGUMENT;
    memset(&walk, 0, sizeof walk);
    walk.pass = SBI_PRECOND_WRITE;
    walk.out = (unsigned char *)buffer + SBI_IMAGE_HEAD;
    sbi_precond_pass_over((sb_preconditioner *)(uintptr_t)preconditioner, &walk);
    sbi_image_seal((unsigned char *)buffer, needed, SBI_PRECOND_MAGIC, SBI_PRECOND_VERSION);
    return SB_OK;
}

SB_API sb_result sb_preconditioner_load(sb_preconditioner *preconditioner, const void *buffer, size_t size,
                                        sb_error *error)
{
    sbi_precond_walk walk;
    sb_result result;
    if (!preconditioner || !buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_preconditioner_load needs a preconditioner and bytes");
    if (preconditioner->kind == SB_PRECOND_MULTIGRID)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "multigrid is not loaded, but updated");
    result = sbi_image_check((const unsigned char *)buffer, size, SBI_PRECOND_MAGIC, SBI_PRECOND_VERSION,
                             "preconditioner", error);
    if (result != SB_OK)
        return result;
    memset(&walk, 0, sizeof walk);
    walk.pass = SBI_PRECOND_CHECK;
    walk.in = (const unsigned char *)buffer + SBI_IMAGE_HEAD;
    walk.size = size - SBI_IMAGE_HEAD - SBI_IMAGE_TAIL;
    walk.error = error;
    sbi_precond_pass_over(preconditioner, &walk);
    if (walk.result == SB_OK && walk.used != walk.size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved preconditioner goes on after its end");
    if (walk.result != SB_OK)
        return walk.result;
    walk.pass = SBI_PRECOND_READ;
    walk.used = 0;
    sbi_precond_pass_over(preconditioner, &walk);
    if (preconditioner->fsai.rows)
        sbi_fsai_mirror(&preconditioner->fsai);
    if (preconditioner->direct)
        sbi_direct_take_values(preconditioner->direct);
    preconditioner->ready = 1;
    preconditioner->turned = 0;
    preconditioner->coarse.ready = 0;
    preconditioner->attempts = 0;
    return SB_OK;
}
