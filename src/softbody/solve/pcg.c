/* pcg: conjugate gradients with fused vector loops. */
#include "pcg.h"
#include "sparse_live.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* ---- workspace ----------------------------------------------------------------------------------------- */

SB_API sb_pcg_options sb_default_pcg_options(void)
{
    sb_pcg_options options;
    options.tolerance = SB_REAL_IS_FLOAT ? 1e-3 : 1e-6;
    options.max_iterations = 1000;
    options.jobs = NULL;
    return options;
}

/* One connected part of the matrix, solved as if it were alone: its own step lengths, its own residual. What the rest
 * of the rows needs does not matter to it: a crumb beside an organ is as good as a crumb alone. */
typedef struct sbi_pcg_part {
    double rhs_square;                /* |rhs|^2 of its rows, */
    double target;                    /* what |r|^2 has to come down to, */
    double goal;                      /* and in the present round */
    double square;                    /* |r|^2 */
    double before;                    /* the same when the round began, */
    double recurred;                  /* and by the recurrence when it ended */
    double alpha, last_rz;            /* step along p, and r.z there */
    double factor;                    /* of the update at work */
    double growth;                    /* r.z over that before; of a better start: how much of x lies along p */
    double softest, last_norm, cross; /* see sbi_pcg_watch */
    double begun;                     /* |r|^2 at the start of the step's first system, without what touches */
    double drift;                     /* largest |sum of r|^2 along an axis that nothing holds; < 0: not asked for */
    int first_chunk;
    int head;            /* the first of the parts that guests join with this one: all of them are kept there as one */
    int next;            /* the next of them, or -1 */
    int loose;           /* axes on which none of its rows is prescribed */
    unsigned char fresh; /* 1: its iteration starts; 0: it goes on along p */
    unsigned char done;  /* 1: nothing is to be done in this round */
    unsigned char eager; /* 1: goes below its target, which rounding kept a round from meeting by a little */
    unsigned char stuck; /* 1: rounding stops its progress all the same */
    unsigned char faint; /* 1: its rhs is nothing beside that of the others */
    unsigned char guessed; /* 1: its start was made better, and nothing has come of that yet */
    unsigned char plain;   /* 1: the preconditioner is not positive definite there; the diagonal takes its place */
} sbi_pcg_part;

SB_API sb_result sb_pcg_workspace_create(int row_count, const sb_allocator *allocator, sb_pcg_workspace *workspace,
                                         sb_error *error)
{
    sb_pcg_workspace made;
    size_t entries, parts, chunks, bytes = 0;
    if (!workspace || row_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a workspace needs row_count >= 1, not %d", row_count);
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    entries = 3 * (size_t)row_count;
    parts = (size_t)sbi_matrix_most_parts(row_count);
    chunks = (size_t)sbi_row_chunks(row_count) + parts;
    if (sbi_size_add(&bytes, chunks, 2 * sizeof(double)) && sbi_size_add(&bytes, 1, sizeof(sbi_pcg_record)) &&
        sbi_size_add(&bytes, parts + 1, sizeof(sbi_pcg_part)) && sbi_size_add(&bytes, entries, 5 * sizeof(sb_real)))
        made.memory = sbi_alloc(allocator, bytes, 1);
    if (!made.memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the vectors of %d rows", row_count);
    made.row_count = row_count;
    made.partial = (double *)made.memory;
    made.record = (sbi_pcg_record *)(void *)(made.partial + 2 * chunks);
    memset(made.record, 0, sizeof *made.record);
    made.parts = made.record + 1;
    made.start = (sb_real *)(void *)((sbi_pcg_part *)made.parts + parts + 1);
    made.residual = made.start + entries;
    made.search = made.residual + entries;
    made.direction = made.search + entries;
    made.product = made.direction + entries;
    *workspace = made;
    return SB_OK;
}

SB_API void sb_pcg_workspace_free(sb_pcg_workspace *workspace)
{
    if (!workspace)
        return;
    sbi_free(&workspace->allocator, workspace->memory);
    sbi_free(&workspace->allocator, workspace->guests);
    memset(workspace, 0, sizeof *workspace);
}

/* ---- vector loops -------------------------------------------------------------------------------------- */

/* What the chunk tasks see. Names follow the usual ones: r residual, z = M^-1 r, p direction, q = A p. */
typedef struct sbi_pcg_state {
    const sb_matrix *matrix;
    const sb_real *rhs;
    sb_real *x, *r, *z, *p, *q;
    const sb_real *start;   /* x as it was given */
    const sb_real *bend;    /* which way the solution may be off it */
    const sb_real *product; /* A times the start, until its residual is made; or NULL */
    sbi_multigrid *compact; /* what multiplies in place of the matrix, or NULL */
    int current;            /* 1: it is known to be of this matrix */
    int part_count;
    sbi_pcg_part *parts;                 /* [part_count + 1] */
    const int *part_rows;                /* rows by part; NULL: one part of all rows */
    int whole[2];                        /* where that one starts and ends */
    const int *part_start;               /* [part_count + 1] */
    double *partial;                     /* [chunks][2] */
    sbi_guest_space *guests;             /* NULL: none */
    const sbi_pcg_extra *extra;          /* NULL: nothing */
    const sbi_pcg_operator *unassembled; /* multiplies in place of the matrix, all rows at once; or NULL */
    int has_plain;                       /* 1: parts are plain */
    double extra_sum;                    /* p.Cp */
    double softest;                      /* largest of the parts' and rounds' */
    const sb_jobs *jobs;
} sbi_pcg_state;

/* Rows of a task: at most SBI_ROW_CHUNK of one part. */
typedef struct sbi_pcg_slice {
    const sbi_pcg_part *part; /* the head of its own */
    const int *rows;          /* NULL: first, first + 1, ... */
    int first, count;
} sbi_pcg_slice;

static sbi_pcg_slice sbi_pcg_slice_of(const sbi_pcg_state *s, int chunk)
{
    sbi_pcg_slice slice;
    int low = 0, high = s->part_count, begin;
    while (high - low > 1) {
        int middle = low + (high - low) / 2;
        if (s->parts[middle].first_chunk <= chunk)
            low = middle;
        else
            high = middle;
    }
    begin = s->part_start[low] + (chunk - s->parts[low].first_chunk) * SBI_ROW_CHUNK;
    slice.part = s->parts + s->parts[low].head;
    slice.count = sbi_min_int(s->part_start[low + 1] - begin, SBI_ROW_CHUNK);
    slice.rows = s->part_rows ? s->part_rows + begin : NULL;
    slice.first = s->part_rows ? slice.rows[0] : begin;
    return slice;
}

/* Cuts the next run of consecutive rows off the slice: *first <= i < *last. 0: there is none. */
static int sbi_pcg_next_run(sbi_pcg_slice *slice, int *first, int *last)
{
    int run = slice->count;
    if (run == 0)
        return 0;
    if (slice->rows && slice->rows[run - 1] - slice->rows[0] != run - 1)
        for (run = 1; slice->rows[run] == slice->rows[0] + run;)
            run++;
    *first = slice->rows ? slice->rows[0] : slice->first;
    *last = *first + run;
    slice->rows = slice->rows ? slice->rows + run : NULL;
    slice->first += run;
    slice->count -= run;
    return 1;
}

/* a.b over a range: eight sums that do not wait for each other. */
static double sbi_pcg_dot(const sb_real *a, const sb_real *b, size_t count)
{
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0;
    size_t k = 0;
    for (; k + 8 <= count; k += 8) {
        s0 += (double)a[k] * (double)b[k];
        s1 += (double)a[k + 1] * (double)b[k + 1];
        s2 += (double)a[k + 2] * (double)b[k + 2];
        s3 += (double)a[k + 3] * (double)b[k + 3];
        s4 += (double)a[k + 4] * (double)b[k + 4];
        s5 += (double)a[k + 5] * (double)b[k + 5];
        s6 += (double)a[k + 6] * (double)b[k + 6];
        s7 += (double)a[k + 7] * (double)b[k + 7];
    }
    for (; k < count; k++)
        s0 += (double)a[k] * (double)b[k];
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7));
}

static void sbi_pcg_square_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    double *sums = s->partial + 2 * (size_t)chunk;
    int first, last;
    sums[0] = sums[1] = 0;
    while (sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, count = 3 * (size_t)(last - first);
        sums[0] += sbi_pcg_dot(s->rhs + begin, s->rhs + begin, count);
        sums[1] += sbi_pcg_dot(s->x + begin, s->x + begin, count);
    }
}

/* to = A v for the rows of a chunk; v is spread where there is a compact matrix. `unassembled` has been there before.
 */
static void sbi_pcg_multiply(const sbi_pcg_state *s, const sb_real *v, sb_real *to, int first, int last)
{
    if (s->compact)
        sbi_multigrid_multiply(s->compact, to, first, last);
    else if (!s->unassembled)
        sbi_matrix_multiply_rows(s->matrix, v, to, first, last);
}

/* The compact matrix's x, and |S x|^2. */
static void sbi_pcg_spread_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    int first, last;
    s->partial[2 * (size_t)chunk] = 0;
    while (sbi_pcg_next_run(&slice, &first, &last))
        s->partial[2 * (size_t)chunk] += sbi_multigrid_spread(s->compact, s->x, first, last);
}

/* r.r */
static void sbi_pcg_norm_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    double sum = 0;
    int first, last;
    while (sbi_pcg_next_run(&slice, &first, &last))
        sum += sbi_pcg_dot(s->r + 3 * (size_t)first, s->r + 3 * (size_t)first, 3 * (size_t)(last - first));
    s->partial[2 * (size_t)chunk] = sum;
}

/* r = rhs - A x, r.r */
static void sbi_pcg_residual_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    double sum = 0;
    int first, last;
    while (sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, end = 3 * (size_t)last;
        if (!s->product)
            sbi_pcg_multiply(s, s->x, s->r, first, last);
        for (size_t k = begin; k < end; k++)
            s->r[k] = s->rhs[k] - (s->product ? s->product[k] : s->r[k]);
        sum += sbi_pcg_dot(s->r + begin, s->r + begin, end - begin);
    }
    s->partial[2 * (size_t)chunk] = sum;
}

/* q = A p, p.q */
static void sbi_pcg_product_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    double sum = 0;
    int first, last;
    while (!slice.part->done && sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, end = 3 * (size_t)last;
        sbi_pcg_multiply(s, s->p, s->q, first, last);
        sum += sbi_pcg_dot(s->p + begin, s->q + begin, end - begin);
    }
    s->partial[2 * (size_t)chunk] = sum;
}

/* x += factor p, r -= factor q; r.r */
static double sbi_pcg_advance_run(const sbi_pcg_state *s, sb_real factor, size_t begin, size_t count)
{
    sb_real *SB_RESTRICT x = s->x + begin, *SB_RESTRICT r = s->r + begin;
    const sb_real *p = s->p + begin, *q = s->q + begin;
    for (size_t k = 0; k < count; k++) {
        x[k] += factor * p[k];
        r[k] -= factor * q[k];
    }
    return sbi_pcg_dot(r, r, count);
}

static void sbi_pcg_advance_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    sb_real factor = (sb_real)slice.part->factor;
    double sum = 0;
    int first, last;
    while (!slice.part->done && sbi_pcg_next_run(&slice, &first, &last))
        sum += sbi_pcg_advance_run(s, factor, 3 * (size_t)first, 3 * (size_t)(last - first));
    s->partial[2 * (size_t)chunk] = sum;
}

/* r.z and q.z */
static void sbi_pcg_dots_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    double *sums = s->partial + 2 * (size_t)chunk;
    int first, last;
    sums[0] = sums[1] = 0;
    while (!slice.part->done && sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, count = 3 * (size_t)(last - first);
        sums[0] += sbi_pcg_dot(s->r + begin, s->z + begin, count);
        sums[1] += slice.part->fresh ? 0 : sbi_pcg_dot(s->q + begin, s->z + begin, count);
    }
}

/* z = r over the diagonal, of plain parts */
static void sbi_pcg_plain_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    int first, last;
    while (slice.part->plain && !slice.part->done && sbi_pcg_next_run(&slice, &first, &last))
        for (int i = first; i < last; i++)
            for (int axis = 0; axis < 3; axis++) {
                sb_real diagonal = s->unassembled ? 1 : s->matrix->blocks[s->matrix->diagonal[i]][4 * axis];
                s->z[3 * (size_t)i + (size_t)axis] = s->r[3 * (size_t)i + (size_t)axis] / (diagonal > 0 ? diagonal : 1);
            }
}

/* p = z + factor p */
static void sbi_pcg_direction_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    sb_real factor = (sb_real)slice.part->factor;
    int first, last;
    while (!slice.part->done && sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, count = 3 * (size_t)(last - first);
        sb_real *SB_RESTRICT p = s->p + begin;
        const sb_real *SB_RESTRICT z = s->z + begin;
        if (slice.part->fresh)
            memset(p, 0, count * sizeof(sb_real));
        for (size_t k = 0; k < count; k++)
            p[k] = z[k] + factor * p[k];
        if (s->compact)
            sbi_multigrid_spread(s->compact, s->p, first, last);
    }
}

/* ---- parts --------------------------------------------------------------------------------------------- */

static int sbi_pcg_is_finite(double value) { return value - value == 0; }

static int sbi_pcg_chunks(const sbi_pcg_state *s) { return s->parts[s->part_count].first_chunk; }

static void sbi_pcg_run(const sbi_pcg_state *s, sb_task task)
{
    sbi_pcg_state mine = *s;
    sbi_run(s->jobs, task, &mine, sbi_pcg_chunks(s));
}

/* 1: the part is kept for itself, or for all that guests join with it. Others are 0 in all they have to reach. */
static int sbi_pcg_is_head(const sbi_pcg_state *s, const sbi_pcg_part *part) { return part - s->parts == part->head; }

/* The guest's share of a sum, if it belongs to the part. */
static double sbi_pcg_guest_sum(const sbi_pcg_state *s, const sbi_pcg_part *part, int which)
{
    double sum = 0;
    for (int g = 0; s->guests && g < s->guests->count; g++)
        if (s->guests->work[g].part == part->head)
            sum += s->guests->work[g].sums[which];
    return sum;
}

/* The sum over a part of the chunks' first (0) or second (1) partial sums, in order, and that of its guests. */
static double sbi_pcg_sum(const sbi_pcg_state *s, const sbi_pcg_part *part, int which)
{
    double sum = 0;
    if (!sbi_pcg_is_head(s, part))
        return 0;
    for (int c = part->head; c >= 0; c = s->parts[c].next)
        for (int k = s->parts[c].first_chunk; k < s->parts[c + 1].first_chunk; k++)
            sum += s->partial[2 * (size_t)k + (size_t)which];
    return s->guests ? sum + sbi_pcg_guest_sum(s, part, which) : sum;
}

/* Runs a task that ends with r.r and takes it over, of parts that are at work or (all) of all. */
static void sbi_pcg_run_square(sbi_pcg_state *s, sb_task task, int all)
{
    sbi_pcg_run(s, task);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        if (all || !part->done)
            part->square = sbi_pcg_sum(s, part, 0);
}

/* r.r of all rows */
static double sbi_pcg_whole_square(const sbi_pcg_state *s)
{
    double sum = 0;
    for (int c = 0; c < s->part_count; c++)
        sum += s->parts[c].square;
    return sum;
}

/* The parts of the matrix, or all of it as one where the preconditioner couples them. */
static void sbi_pcg_find_parts(sbi_pcg_state *s, int joint)
{
    const sb_matrix *a = s->matrix;
    int chunks = 0;
    sbi_matrix_list_parts(a);
    s->part_count = joint || s->extra ? 1 : a->part_count;
    s->whole[0] = 0;
    s->whole[1] = a->row_count;
    s->part_rows = s->part_count > 1 ? a->part_rows : NULL;
    s->part_start = s->part_count > 1 ? a->part_start : s->whole;
    for (int c = 0; c < s->part_count; c++) {
        double begun = s->parts[c].begun;
        memset(s->parts + c, 0, sizeof *s->parts);
        s->parts[c].begun = begun;
        s->parts[c].first_chunk = chunks;
        s->parts[c].fresh = 1;
        s->parts[c].drift = -1;
        s->parts[c].head = c;
        s->parts[c].next = -1;
        chunks += sbi_row_chunks(s->part_start[c + 1] - s->part_start[c]);
    }
    s->parts[s->part_count].first_chunk = chunks;
}

/* x = 0 of the parts whose rhs is 0. */
static void sbi_pcg_clear_idle(const sbi_pcg_state *s)
{
    for (int c = 0; c < s->part_count; c++)
        for (int k = s->part_start[c]; s->parts[s->parts[c].head].rhs_square == 0 && k < s->part_start[c + 1]; k++)
            memset(s->x + 3 * (size_t)(s->part_rows ? s->part_rows[k] : k), 0, 3 * sizeof(sb_real));
}

/* Sum of r over the rows of a part, on its loose axes; its square. */
static double sbi_pcg_drift_square(const sbi_pcg_state *s, const sbi_pcg_part *part)
{
    double sum[3] = {0, 0, 0}, square = 0;
    for (int c = part->head; c >= 0; c = s->parts[c].next)
        for (int k = s->part_start[c]; k < s->part_start[c + 1]; k++) {
            size_t row = 3 * (size_t)(s->part_rows ? s->part_rows[k] : k);
            for (size_t axis = 0; axis < 3; axis++)
                sum[axis] += (double)s->r[row + axis];
        }
    for (int g = 0; s->guests && g < s->guests->count; g++)
        if (s->guests->work[g].part == part->head)
            sbi_guest_add_taken(s->guests->work + g, sum);
    for (int axis = 0; axis < 3; axis++)
        square += part->loose >> axis & 1 ? sum[axis] * sum[axis] : 0;
    return square;
}

/* Square of what the recurrence can count of a part's residual. */
static double sbi_pcg_least_square(const sbi_pcg_part *part)
{
    const double epsilon = (double)SB_EPSILON;
    return epsilon * epsilon / 16 * part->rhs_square;
}

/* 1: the residual of a part meets `bound`. A guess alone does not, however good: the next step would guess by it, and
 * what it leaves would add up. Where it leaves nothing that an iteration could take, it does. */
static int sbi_pcg_meets(const sbi_pcg_state *s, const sbi_pcg_part *part, double bound)
{
    if (part->guessed && !part->faint && part->square > sbi_pcg_least_square(part))
        return 0;
    return part->square <= bound && (part->drift < 0 || sbi_pcg_drift_square(s, part) <= part->drift);
}

/* 1: all parts meet their targets, but for those that are stuck. */
static int sbi_pcg_all_meet(const sbi_pcg_state *s)
{
    for (const sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        if (!part->stuck && !sbi_pcg_meets(s, part, part->target))
            return 0;
    return 1;
}

/* What the solve is to reach. Single precision of the preconditioner holds nothing of parts whose forces are below that
 * of the largest by more than its range: those are left alone. */
static void sbi_pcg_set_targets(sbi_pcg_state *s, double tolerance, double rhs_square)
{
    const double range = (double)FLT_MIN / (double)FLT_EPSILON;
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        part->faint = part->rhs_square < range * range * rhs_square;
        part->target = part->faint ? range * range * rhs_square : tolerance * tolerance * part->rhs_square;
    }
}

/* ---- the iteration ------------------------------------------------------------------------------------- */

static void sbi_pcg_wake_guests(const sbi_pcg_state *s)
{
    for (int g = 0; g < s->guests->count; g++)
        s->guests->work[g].done = 0;
}

/* q = (A + C) p */
static void sbi_pcg_run_product(sbi_pcg_state *s)
{
    if (s->unassembled)
        s->unassembled->multiply(s->unassembled->user, s->p, s->q);
    sbi_pcg_run(s, sbi_pcg_product_task);
    s->extra_sum = s->extra && !s->parts[0].done ? s->extra->multiply(s->extra->user, s->p, s->q) : 0;
}

/* r -= C x; q is for scratch, which goes no further than its round where there is no compact matrix. */
static void sbi_pcg_subtract_extra(sbi_pcg_state *s)
{
    size_t count = 3 * (size_t)s->matrix->row_count;
    memset(s->q, 0, count * sizeof(sb_real));
    (void)s->extra->multiply(s->extra->user, s->x, s->q);
    for (size_t k = 0; k < count; k++)
        s->r[k] -= s->q[k];
}

/* What guests have of a motion p along which their own unknowns rest, and all of it subtracted from their residuals. */
static void sbi_pcg_deflate_guests(const sbi_pcg_state *s)
{
    sbi_pcg_wake_guests(s);
    for (int g = 0; g < s->guests->count; g++)
        memset(s->guests->work[g].search, 0, (size_t)s->guests->work[g].guest->unknown_count * sizeof(double));
    sbi_guest_multiply(s->guests, s->p, s->q);
    for (int g = 0; g < s->guests->count; g++)
        sbi_guest_advance(s->guests->work + g, 1);
    sbi_guest_measure(s->guests);
}

/* Subtracts the coarse space's part from the residual, as its deflation requires. Uses p and q. */
static void sbi_pcg_deflate(sbi_pcg_state *s, sb_preconditioner *preconditioner)
{
    if (!preconditioner || (s->guests && !sbi_guest_is_deflated(s->guests, preconditioner)) ||
        !sbi_precond_coarse_solve(preconditioner, s->r, s->p, sqrt(sbi_pcg_whole_square(s))))
        return;
    s->compact = NULL; /* a preconditioner with a coarse space has none */
    for (int c = 0; c < s->part_count; c++) {
        s->parts[c].done = 0;
        s->parts[c].factor = 1;
    }
    sbi_pcg_run_product(s);
    if (s->guests)
        sbi_pcg_deflate_guests(s);
    sbi_pcg_run_square(s, sbi_pcg_advance_task, 1);
}

static void sbi_pcg_direct_guests(const sbi_pcg_state *s)
{
    for (int g = 0; s->guests && g < s->guests->count; g++) {
        sbi_guest_work *work = s->guests->work + g;
        if (!work->done)
            sbi_guest_direct(work, s->parts[work->part].factor, s->parts[work->part].fresh);
    }
}

/* Also what is left for their own blocks, which is what their residual counts by. */
static void sbi_pcg_advance_guests(const sbi_pcg_state *s)
{
    for (int g = 0; s->guests && g < s->guests->count; g++)
        if (!s->guests->work[g].done)
            sbi_guest_advance(s->guests->work + g, s->parts[s->guests->work[g].part].factor);
    if (s->guests)
        sbi_guest_measure(s->guests);
}

/* Parts of fewer than half of the rows on which the preconditioner is not positive definite begin anew without it:
 * crumbs that single precision cannot hold. Softening it would spoil it for all others. Returns how many parts are not
 * positive definite, the crumbs among them negative. SB_ERROR_DIVERGED in *result. */
static int sbi_pcg_find_indefinite(sbi_pcg_state *s, sb_result *result)
{
    int found = 0, made = 0;
    for (int c = 0; c < s->part_count; c++) {
        sbi_pcg_part *part = s->parts + c;
        double rz = part->done ? 1 : sbi_pcg_sum(s, part, 0);
        int small = s->part_start[c + 1] - s->part_start[c] < s->matrix->row_count / 2;
        if (!sbi_pcg_is_finite(rz))
            *result = SB_ERROR_DIVERGED;
        if (rz > 0)
            continue;
        found++;
        if (!small || part->plain)
            continue;
        part->plain = part->fresh = 1;
        made++;
    }
    s->has_plain |= made > 0;
    return made ? -made : found;
}

/* Takes the sums of r.z and q.z and sets what p goes on with. SB_ERROR_NOT_CONVERGED: with the preconditioner softened,
 * or without it in some parts, try again. */
static sb_result sbi_pcg_turn(sbi_pcg_state *s, sb_preconditioner *preconditioner)
{
    sb_result result = SB_OK;
    int indefinite = sbi_pcg_find_indefinite(s, &result);
    if (result != SB_OK || indefinite < 0)
        return result != SB_OK ? result : SB_ERROR_NOT_CONVERGED;
    if (indefinite) {
        if (!preconditioner || !sbi_precond_soften(preconditioner))
            return SB_ERROR_INDEFINITE;
        for (int c = 0; c < s->part_count; c++)
            s->parts[c].fresh = 1;
        return SB_ERROR_NOT_CONVERGED;
    }
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double rz;
        if (part->done)
            continue;
        rz = sbi_pcg_sum(s, part, 0);
        part->factor = part->fresh ? 0 : -part->alpha * sbi_pcg_sum(s, part, 1) / part->last_rz;
        part->growth = part->fresh ? 0 : rz / part->last_rz;
        part->last_rz = rz;
    }
    return SB_OK;
}

/* Follows the smallest eigenvalue of M^-1 A as the iteration sees it: step lengths and growths make the factor L^T of
 * Lanczos' tridiagonal matrix, |L^-T|^2 is 1 over its smallest eigenvalue, and the vector z that L^-T stretches most is
 * followed by its size, that of the last column q of L^-T, and z.q (Duff and Voemel 2002; Meurant and Tichy 2019). */
static void sbi_pcg_watch(sbi_pcg_state *s, sbi_pcg_part *part, double last_alpha)
{
    if (part->fresh) {
        part->softest = part->last_norm = part->cross = part->alpha;
    } else {
        double ratio = sqrt(part->growth * part->alpha / last_alpha), mixed = -ratio * part->cross;
        double norm = ratio * ratio * part->last_norm + part->alpha, half = (part->softest - norm) / 2;
        double root = sqrt(half * half + mixed * mixed), old = mixed, fresh = root - half, size;
        size = sqrt(old * old + fresh * fresh);
        part->softest = (part->softest + norm) / 2 + root;
        part->cross = size > 0 ? (old * mixed + fresh * norm) / size : mixed;
        part->last_norm = norm;
    }
    if (part->softest > s->softest)
        s->softest = part->softest;
}

/* Takes the sums of p.q and sets how far to go along p. */
static sb_result sbi_pcg_measure(sbi_pcg_state *s, sb_pcg_info *info)
{
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double pq, last_alpha = part->alpha;
        if (part->done)
            continue;
        pq = sbi_pcg_sum(s, part, 0) + (part == s->parts ? s->extra_sum : 0);
        if (!sbi_pcg_is_finite(pq))
            return SB_ERROR_DIVERGED;
        if (pq <= 0) {
            info->negative_curvature = 1;
            return SB_ERROR_INDEFINITE;
        }
        part->factor = part->alpha = part->last_rz / pq;
        sbi_pcg_watch(s, part, last_alpha);
        part->fresh = part->guessed = 0;
    }
    return SB_OK;
}

/* Marks the parts that have reached their goals; 1: all have. */
static int sbi_pcg_mark_done(sbi_pcg_state *s)
{
    int all = 1;
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        part->done = part->done || part->stuck || sbi_pcg_meets(s, part, part->goal);
        all &= part->done;
    }
    for (int g = 0; s->guests && g < s->guests->count; g++)
        s->guests->work[g].done = s->parts[s->guests->work[g].part].done;
    return all;
}

/* z = r over the diagonal that `unassembled` has. */
static void sbi_pcg_scale(const sbi_pcg_state *s)
{
    const sb_real *diagonal = s->unassembled->diagonal;
    for (int i = 0; i < s->matrix->row_count; i++)
        for (int k = 3 * i; k < 3 * i + 3; k++)
            s->z[k] = s->r[k] / diagonal[i];
}

/* z = M^-1 r */
static void sbi_pcg_precondition(sbi_pcg_state *s, sb_preconditioner *preconditioner)
{
    if (s->unassembled && s->unassembled->diagonal)
        sbi_pcg_scale(s);
    else if (s->guests)
        sbi_guest_precondition(s->guests, preconditioner, s->r, s->z, sqrt(sbi_pcg_whole_square(s)));
    else if (preconditioner)
        sbi_precond_apply(preconditioner, s->r, s->z, sqrt(sbi_pcg_whole_square(s)));
    else
        memcpy(s->z, s->r, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
}

/* Iterates until each part has reached its goal, in plain PCG with the flexible beta = (r_new - r).z_new / (r.z)_old:
 * with r_new - r = -alpha q it costs one more sum and makes up for a preconditioner that rounding keeps from being
 * quite symmetric. */
static sb_result sbi_pcg_iterate(sbi_pcg_state *s, sb_preconditioner *preconditioner, int max_iterations,
                                 sb_pcg_info *info)
{
    for (int c = 0; c < s->part_count; c++)
        s->parts[c].done = 0;
    while (!sbi_pcg_mark_done(s)) {
        sb_result result;
        if (info->iterations >= max_iterations) {
            info->capped = 1;
            return SB_ERROR_NOT_CONVERGED;
        }
        sbi_pcg_precondition(s, preconditioner);
        if (s->has_plain)
            sbi_pcg_run(s, sbi_pcg_plain_task);
        sbi_pcg_run(s, sbi_pcg_dots_task);
        for (int g = 0; s->guests && g < s->guests->count; g++)
            if (!s->guests->work[g].done)
                sbi_guest_dots(s->guests->work + g, s->parts[s->guests->work[g].part].fresh);
        result = sbi_pcg_turn(s, preconditioner);
        if (result == SB_ERROR_NOT_CONVERGED)
            continue;
        if (result != SB_OK)
            return result;
        sbi_pcg_run(s, sbi_pcg_direction_task);
        sbi_pcg_direct_guests(s);
        sbi_pcg_run_product(s);
        if (s->guests)
            sbi_guest_multiply(s->guests, s->p, s->q);
        result = sbi_pcg_measure(s, info);
        if (result != SB_OK)
            return result;
        sbi_pcg_advance_guests(s);
        sbi_pcg_run_square(s, sbi_pcg_advance_task, 0);
        if (!sbi_pcg_is_finite(sbi_pcg_whole_square(s)))
            return SB_ERROR_DIVERGED;
        info->iterations++;
    }
    return SB_OK;
}

/* r = rhs - A x, and the guests' rows at x. */
static void sbi_pcg_guest_residual(sbi_pcg_state *s)
{
    sbi_pcg_wake_guests(s);
    if (s->compact) /* it has the x of its last product */
        sbi_pcg_run(s, sbi_pcg_spread_task);
    sbi_pcg_run(s, sbi_pcg_residual_task);
    if (s->extra)
        sbi_pcg_subtract_extra(s);
    sbi_guest_residual(s->guests, s->x, s->x, s->r);
    sbi_guest_measure(s->guests);
    sbi_pcg_run_square(s, sbi_pcg_norm_task, 1);
}

/* r = rhs - A x with the matrix itself, when the residual in r is of the compact one. */
static void sbi_pcg_true_residual(sbi_pcg_state *s)
{
    sbi_multigrid *compact = s->compact;
    s->compact = NULL;
    if (s->unassembled && !s->product)
        s->unassembled->multiply(s->unassembled->user, s->x, s->r);
    if (s->guests)
        sbi_pcg_guest_residual(s);
    else
        sbi_pcg_run_square(s, sbi_pcg_residual_task, 1);
    if (s->extra && !s->guests) {
        sbi_pcg_subtract_extra(s);
        sbi_pcg_run_square(s, sbi_pcg_norm_task, 1);
    }
    s->compact = compact;
}

/* r = rhs - A x, with the compact matrix where that is known to be of this one. */
static void sbi_pcg_first_residual(sbi_pcg_state *s)
{
    if (!s->compact || !s->current) {
        sbi_pcg_true_residual(s);
        return;
    }
    sbi_pcg_run(s, sbi_pcg_spread_task);
    sbi_pcg_run_square(s, sbi_pcg_residual_task, 1);
}

/* 1 when the residuals meet their targets also with all that the compact matrix's may be off. */
static int sbi_pcg_is_sure(sbi_pcg_state *s)
{
    double deviation;
    if (!s->current)
        return 0;
    deviation = sbi_multigrid_deviation(s->compact);
    sbi_pcg_run(s, sbi_pcg_spread_task);
    for (int g = 0; s->guests && g < s->guests->count; g++)
        s->guests->work[g].sums[0] = 0; /* its product is its own */
    for (const sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        if (!part->stuck && !(sqrt(part->square) + deviation * sqrt(sbi_pcg_sum(s, part, 0)) <= sqrt(part->target)))
            return 0;
    return 1;
}

/* 1 when an iteration's result can stand without a look at the true residual: what was found without the compact
 * matrix, and with it what is sure. That it is indefinite may come from its rounding. */
static int sbi_pcg_is_final(sbi_pcg_state *s, sb_result result, int verify)
{
    if (!s->compact)
        return result != SB_OK || !verify;
    if (result == SB_OK)
        return !verify && sbi_pcg_is_sure(s);
    if (result == SB_ERROR_NOT_CONVERGED)
        return s->current;
    return result != SB_ERROR_INDEFINITE;
}

/* Sets the goals of a round: the targets, not below what the recurrence can count; with the compact matrix a few digits
 * at a time. The eager halve |r| once more: few iterations, by which x moves far enough to be rounded afresh. */
static void sbi_pcg_set_goals(sbi_pcg_state *s)
{
    const double digits = 1e-3;
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double least = sbi_pcg_least_square(part);
        double wanted = part->eager ? part->target / 4 : part->target;
        part->goal = wanted > least ? wanted : least;
        if (s->compact && part->goal < digits * digits * part->square)
            part->goal = digits * digits * part->square;
    }
}

/* What the true residual, now in r, says about the round that ended with `result`. */
typedef struct sbi_pcg_verdict {
    int missed;  /* parts that have not met their targets */
    int moving;  /* those of them that go on */
    int worse;   /* 1: one is farther off than before the round, */
    int drifted; /* 1: or than the recurrence said */
} sbi_pcg_verdict;

static sbi_pcg_verdict sbi_pcg_judge(sbi_pcg_state *s, sb_result result)
{
    const double other = 1.1; /* by a third of it in another direction: along the last one the next ones could grow */
    sbi_pcg_verdict verdict = {0, 0, 0, 0};
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double square = part->square, least = part->before > 4 * part->target ? 0.25 : 0.99;
        part->fresh = result != SB_OK || !s->compact || square > other * part->recurred;
        if (sbi_pcg_meets(s, part, part->target))
            continue;
        verdict.missed++;
        /* not even halved, or where less was to be done, no better: the last digit of x is reached, or nearly */
        if (square > least * part->before && !s->compact) {
            part->stuck = part->stuck || part->eager || square > 4 * part->target;
            part->eager = 1;
        }
        if (part->stuck)
            continue;
        verdict.moving++;
        verdict.worse |= square > part->before;
        verdict.drifted |= square > 1.5 * part->recurred;
    }
    return verdict;
}

/* x, and guests' unknowns, as they were given. */
static void sbi_pcg_go_back(const sbi_pcg_state *s)
{
    memcpy(s->x, s->start, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
    for (int g = 0; s->guests && g < s->guests->count; g++)
        sbi_guest_go_back(s->guests->work + g);
}

/* Back to the start, without the compact matrix: it is none of this one. */
static void sbi_pcg_restart(sbi_pcg_state *s)
{
    sbi_pcg_go_back(s);
    sbi_pcg_clear_idle(s);
    sbi_pcg_true_residual(s);
    for (int c = 0; c < s->part_count; c++)
        s->parts[c].fresh = 1;
    s->compact = NULL;
}

/* Goes on without the compact matrix. Along a direction that it was multiplied with the next ones grow without end. */
static void sbi_pcg_leave_compact(sbi_pcg_state *s)
{
    for (int c = 0; s->compact && c < s->part_count; c++)
        s->parts[c].fresh = 1;
    s->compact = NULL;
}

/* SB_OK unless a part is stuck. */
static sb_result sbi_pcg_success(const sbi_pcg_state *s)
{
    for (int c = 0; c < s->part_count; c++)
        if (s->parts[c].stuck)
            return SB_ERROR_NOT_CONVERGED;
    return SB_OK;
}

/* Solves, checking the true residual where the recurrence cannot be trusted. With the compact matrix the true one
 * replaces it every few digits, and the iteration goes on as if nothing had happened: what the compact one is off by is
 * then a share of the little that is left to add to x. */
static sb_result sbi_pcg_refine(sbi_pcg_state *s, sb_preconditioner *preconditioner, const sb_pcg_options *options,
                                sb_pcg_info *info)
{
    double tolerance = options->tolerance;
    int verify = tolerance * tolerance * tolerance < (double)SB_EPSILON;
    if (s->compact && s->current &&
        sbi_pcg_all_meet(s)) /* a start as good as that: without the compact one's rounding */
        sbi_pcg_true_residual(s);
    for (int c = 0; c < s->part_count; c++)
        s->parts[c].before = s->parts[c].square;
    for (int round = 0;; round++) {
        sb_result result;
        sbi_pcg_verdict verdict;
        if (sbi_pcg_all_meet(s))
            return sbi_pcg_success(s);
        sbi_pcg_deflate(s, preconditioner);
        if (!sbi_pcg_is_finite(sbi_pcg_whole_square(s)))
            return SB_ERROR_DIVERGED;
        sbi_pcg_set_goals(s);
        result = sbi_pcg_iterate(s, preconditioner, options->max_iterations, info);
        info->residual_is_true = 0;
        if (sbi_pcg_is_final(s, result, verify))
            return result == SB_OK ? sbi_pcg_success(s) : result;
        for (int c = 0; c < s->part_count; c++)
            s->parts[c].recurred = s->parts[c].square;
        sbi_pcg_true_residual(s);
        info->residual_is_true = 1;
        if (!sbi_pcg_is_finite(sbi_pcg_whole_square(s)))
            return SB_ERROR_DIVERGED;
        verdict = sbi_pcg_judge(s, result);
        if (verdict.missed == 0)
            return SB_OK;
        if (verdict.moving == 0 || result == SB_ERROR_NOT_CONVERGED)
            return SB_ERROR_NOT_CONVERGED;
        if (s->compact && verdict.worse && round == 0 && !s->current)
            sbi_pcg_restart(s);
        else if (verdict.worse || verdict.drifted || result != SB_OK)
            sbi_pcg_leave_compact(s);
        info->negative_curvature = 0; /* of the compact matrix, if any */
        for (int c = 0; c < s->part_count; c++)
            s->parts[c].before = s->parts[c].square;
    }
}

static int sbi_pcg_valid(const sb_matrix *matrix, const sb_preconditioner *preconditioner, const sb_real *rhs,
                         const sb_real *x, const sb_pcg_options *options, const sb_pcg_workspace *workspace)
{
    if (!matrix || !rhs || !x || !workspace || workspace->row_count != matrix->row_count)
        return 0;
    if (preconditioner && sbi_precond_rows(preconditioner) != matrix->row_count)
        return 0;
    return options->tolerance >= 0 && sbi_pcg_is_finite(options->tolerance) && options->max_iterations >= 0;
}

/* |rhs|^2 of each part and of all, and |x|^2 of those with something to solve. */
static void sbi_pcg_begin_parts(sbi_pcg_state *s, double *rhs_square, double *x_square)
{
    *rhs_square = *x_square = 0;
    sbi_pcg_run(s, sbi_pcg_square_task);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        part->rhs_square = sbi_pcg_sum(s, part, 0);
        *rhs_square += part->rhs_square;
        if (part->rhs_square != 0)
            *x_square += sbi_pcg_sum(s, part, 1);
    }
    sbi_pcg_clear_idle(s);
}

/* Parts that nothing holds along an axis keep their momentum along it. The start of a step coasts, and what is left of
 * the residual is a force: of a body that flies fast gravity is but a small share of M v / dt, which the tolerance
 * is of, and would be left out altogether once the body is fast enough. So the sum of forces that are left, over those
 * that the start left, has to meet the tolerance, too. (|sum of r| <= sqrt(rows) |r|: nothing is asked of what starts
 * from 0 or of forces that are in balance.) */
static void sbi_pcg_set_drifts(sbi_pcg_state *s, double tolerance, double outside)
{
    const double rounding = 16 * (double)SB_EPSILON;
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        int held = 0;
        double rows = 0, least = rounding * rounding * part->rhs_square;
        if (!sbi_pcg_is_head(s, part))
            continue;
        for (int c = part->head; c >= 0; c = s->parts[c].next) {
            rows += s->part_start[c + 1] - s->part_start[c];
            for (int k = s->part_start[c]; k < s->part_start[c + 1] && held < SB_XYZ; k++)
                held |= s->matrix->fixed[s->part_rows ? s->part_rows[k] : k];
        }
        part->loose = SB_XYZ & ~held;
        if (!part->loose)
            continue;
        part->drift = rows * part->begun;
        if (outside >= 0 && outside * outside < part->drift)
            part->drift = fmax(outside * outside, SBI_PCG_WITHIN * SBI_PCG_WITHIN * part->drift);
        part->drift *= tolerance * tolerance;
        if (part->drift < rows * least)
            part->drift = rows * least;
        if (rows == 0) /* a guest without nodes, of which its residual tells all */
            part->drift = (double)INFINITY;
    }
}

/* |v|^2 on the axes of a row that nothing prescribes. */
static double sbi_pcg_free_square(const sb_matrix *matrix, int row, const sb_real *v)
{
    double square = 0;
    for (int axis = 0; axis < 3; axis++)
        if (!(matrix->fixed[row] >> axis & 1))
            square += (double)v[axis] * (double)v[axis];
    return square;
}

/* Norm of what touches (N). */
static double sbi_pcg_touch(const sb_matrix *matrix, const sbi_pcg_demand *demand)
{
    double square = 0;
    for (int k = 0; k < demand->node_count; k++)
        square += sbi_pcg_free_square(matrix, demand->nodes[k], &demand->force[k].x);
    return sqrt(square);
}

/* |r|^2 of the parts without what touches the body. */
static void sbi_pcg_measure_untouched(sbi_pcg_state *s, const sbi_pcg_demand *demand)
{
    sbi_pcg_state other = *s;
    memcpy(s->z, s->r, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
    other.r = s->z;
    for (int k = 0; k < demand->node_count; k++) {
        const sb_real *force = &demand->force[k].x;
        for (int axis = 0; axis < 3; axis++)
            if (!(s->matrix->fixed[demand->nodes[k]] >> axis & 1))
                other.r[3 * (size_t)demand->nodes[k] + (size_t)axis] -= force[axis];
    }
    sbi_pcg_run(&other, sbi_pcg_norm_task);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        part->begun = sbi_pcg_sum(&other, part, 0);
}

/* What the step begins with is kept for its later systems. Where links have joined or parted parts since then each has
 * its rows' share. */
static void sbi_pcg_keep_begun(sbi_pcg_state *s, const sbi_pcg_demand *demand, sbi_pcg_record *record)
{
    double sum = 0, each = record->begun * record->begun / (double)s->matrix->row_count;
    if (demand->later && record->part_count != s->part_count)
        for (int c = 0; c < s->part_count; c++)
            s->parts[c].begun = each * (s->part_start[c + 1] - s->part_start[c]);
    else if (!demand->later && demand->node_count > 0)
        sbi_pcg_measure_untouched(s, demand);
    else if (!demand->later)
        for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
            part->begun = part->square;
    record->part_count = s->part_count;
    if (demand->later)
        return;
    for (const sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        sum += part->begun;
    record->begun = sqrt(sum);
    record->met = sbi_pcg_touch(s->matrix, demand);
}

/* The share of |rhs| that a touched step's tolerance is of: forces of contact (where it has opened, those that it
 * opened from), or what the step began with, of |rhs| without what is prescribed. In the first system, whose right-hand
 * side is that of the step, no more than 1. */
static double sbi_pcg_touched_share(const sbi_pcg_state *s, const sbi_pcg_demand *demand, const sbi_pcg_record *record)
{
    double touch = demand->is_touched ? sbi_pcg_touch(s->matrix, demand) : record->met, rhs = 0;
    double scale = fmax(touch, record->begun);
    for (int i = 0; i < s->matrix->row_count; i++)
        rhs += sbi_pcg_free_square(s->matrix, i, s->rhs + 3 * (size_t)i);
    rhs = sqrt(rhs);
    return rhs > 0 && (demand->later || scale < rhs) ? scale / rhs : 1;
}

/* Targets, and where an axis is free what may be left in sum. */
static void sbi_pcg_demand_all(sbi_pcg_state *s, const sbi_pcg_demand *demand, double tolerance, sbi_pcg_record *record,
                               double rhs_square, int moves)
{
    double share = 1;
    sbi_pcg_keep_begun(s, demand, record);
    if (demand->is_touched || demand->later)
        share = sbi_pcg_touched_share(s, demand, record);
    sbi_pcg_set_targets(s, tolerance * share, rhs_square);
    if (moves && (demand->current || demand->later))
        sbi_pcg_set_drifts(s, tolerance, demand->node_count > 0 ? demand->outside : -1);
    record->loose = moves ? SB_XYZ : 0;
    for (const sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        if (sbi_pcg_is_head(s, part))
            record->loose &= part->drift >= 0 ? part->loose : 0;
}

/* The worst part's |r| / |rhs|. */
static double sbi_pcg_relative(const sbi_pcg_state *s)
{
    double worst = 0;
    for (const sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double square = part->rhs_square > 0 && !part->faint ? part->square / part->rhs_square : 0;
        worst = square > worst ? square : worst;
    }
    return sqrt(worst);
}

/* What every solve starts with. */
static sbi_pcg_state sbi_pcg_make_state(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                        sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace)
{
    sbi_pcg_state state;
    memset(&state, 0, sizeof state);
    state.matrix = matrix;
    state.rhs = rhs;
    state.x = x;
    state.start = workspace->start;
    state.r = workspace->residual;
    state.z = workspace->search;
    state.p = workspace->direction;
    state.q = workspace->product;
    state.partial = workspace->partial;
    state.parts = (sbi_pcg_part *)workspace->parts;
    state.jobs = options->jobs;
    state.extra = workspace->extra;
    state.unassembled = workspace->unassembled;
    state.compact = preconditioner && !state.extra ? sbi_precond_compact(preconditioner) : NULL;
    memcpy(workspace->start, x, 3 * (size_t)matrix->row_count * sizeof(sb_real));
    return state;
}

/* SB_ERROR_DIVERGED puts the start back. */
static sb_result sbi_pcg_finish(const sbi_pcg_state *s, sb_result result, sb_pcg_info *report, sb_pcg_info *info)
{
    if (result == SB_ERROR_DIVERGED) {
        sbi_pcg_go_back(s);
        report->residual_is_true = 0;
    }
    report->residual = sbi_pcg_relative(s);
    if (info)
        *info = *report;
    return result;
}

/* 1 when each part has something to solve. */
static int sbi_pcg_none_idle(const sbi_pcg_state *s)
{
    for (int c = 0; c < s->part_count; c++)
        if (s->parts[c].rhs_square == 0)
            return 0;
    return 1;
}

static void sbi_pcg_begin_residual(sbi_pcg_state *s, const sbi_pcg_demand *demand, double rhs_square, double x_square)
{
    if (rhs_square > 0 && x_square == 0) { /* no product needed */
        memcpy(s->r, s->rhs, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        for (int c = 0; c < s->part_count; c++)
            s->parts[c].square = s->parts[c].rhs_square;
    } else if (rhs_square > 0 && demand->goes_on && sbi_pcg_none_idle(s)) {
        sbi_pcg_run_square(s, sbi_pcg_norm_task, 1);
    } else if (rhs_square > 0) {
        sbi_pcg_first_residual(s);
    } else {
        memset(s->r, 0, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
    }
}

/* ---- a better start ------------------------------------------------------------------------------------ */

/* out[axis] = v[axis] of a row, 0 where that is prescribed. */
static void sbi_pcg_copy_free(const sb_matrix *matrix, int row, const sb_real *v, sb_real *out)
{
    for (int axis = 0; axis < 3; axis++)
        out[axis] = matrix->fixed[row] >> axis & 1 ? 0 : v[axis];
}

/* p = bend, but for what is prescribed. */
static void sbi_pcg_bend_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    int first, last;
    while (sbi_pcg_next_run(&slice, &first, &last)) {
        for (int i = first; i < last; i++)
            sbi_pcg_copy_free(s->matrix, i, s->bend + 3 * (size_t)i, s->p + 3 * (size_t)i);
        if (s->compact)
            sbi_multigrid_spread(s->compact, s->p, first, last);
    }
}

/* p.r, and x.q, where q = A p is 0 in what is prescribed */
static void sbi_pcg_line_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    double *sums = s->partial + 2 * (size_t)chunk;
    int first, last;
    sums[0] = sums[1] = 0;
    while (sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, count = 3 * (size_t)(last - first);
        sums[0] += sbi_pcg_dot(s->p + begin, s->r + begin, count);
        sums[1] += sbi_pcg_dot(s->x + begin, s->q + begin, count);
    }
}

/* p = x - along p, but for what is prescribed, and q = A p by A x = rhs - r; p.q */
static void sbi_pcg_start_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    sb_real along = (sb_real)slice.part->growth;
    double sum = 0;
    int first, last;
    while (sbi_pcg_next_run(&slice, &first, &last)) {
        size_t begin = 3 * (size_t)first, end = 3 * (size_t)last;
        for (size_t k = begin; k < end; k++) {
            s->p[k] = s->x[k] - along * s->p[k];
            s->q[k] = s->rhs[k] - s->r[k] - along * s->q[k];
        }
        for (int i = first; i < last; i++)
            if (s->matrix->fixed[i]) {
                sbi_pcg_copy_free(s->matrix, i, s->p + 3 * (size_t)i, s->p + 3 * (size_t)i);
                sbi_pcg_copy_free(s->matrix, i, s->q + 3 * (size_t)i, s->q + 3 * (size_t)i);
            }
        if (s->compact)
            sbi_multigrid_spread(s->compact, s->p, first, last);
        sum += sbi_pcg_dot(s->p + begin, s->q + begin, end - begin);
    }
    s->partial[2 * (size_t)chunk] = sum;
}

/* p = q = 0 in parts that do not go along it: they need be no numbers. */
static void sbi_pcg_clear_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    sbi_pcg_slice slice = sbi_pcg_slice_of(s, chunk);
    int first, last;
    while (slice.part->factor == 0 && sbi_pcg_next_run(&slice, &first, &last)) {
        memset(s->p + 3 * (size_t)first, 0, 3 * (size_t)(last - first) * sizeof(sb_real));
        memset(s->q + 3 * (size_t)first, 0, 3 * (size_t)(last - first) * sizeof(sb_real));
    }
}

/* Goes along p, whose curvature p.q the chunks have, to where each part's energy is least; no more than `most` p: what
 * rounding left of q counts as often. */
static void sbi_pcg_go_along(sbi_pcg_state *s, double extra_sum, double most)
{
    int all = 1;
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        part->alpha = sbi_pcg_sum(s, part, 0) + (part == s->parts ? extra_sum : 0);
    sbi_pcg_run(s, sbi_pcg_line_task);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double pr = sbi_pcg_sum(s, part, 0), xq = sbi_pcg_sum(s, part, 1);
        int useful = part->rhs_square != 0 && part->alpha > 0 && fabs(pr / part->alpha) <= most;
        part->factor = useful ? pr / part->alpha : 0;
        part->guessed |= part->factor != 0;
        part->growth = useful ? xq / part->alpha + part->factor : 0;
        if (!(fabs(part->growth) <= (double)SB_REAL_MAX))
            part->growth = 0;
        all &= part->factor != 0;
    }
    if (!all)
        sbi_pcg_run(s, sbi_pcg_clear_task);
    sbi_pcg_run_square(s, sbi_pcg_advance_task, 1);
}

/* 1: of what the residual of the first start was, and of the forces, rounding leaves more than a hundredth of what the
 * residual has to come down to. */
static int sbi_pcg_start_cancels(const sbi_pcg_state *s)
{
    const double rounding = 16 * (double)SB_EPSILON, share = 0.01;
    for (const sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        if (rounding * (sqrt(part->before) + sqrt(part->rhs_square)) > share * sqrt(part->target))
            return 1;
    return 0;
}

/* A motion that goes on as it did, and bends as it did, is nearly the solution of a step: the start becomes the best
 * sum of these two, in each part, which costs the product of one iteration and saves several (Fischer 1998). */
static void sbi_pcg_better_start(sbi_pcg_state *s, const sb_real *bend)
{
    const double most = 8; /* times as far as the start went: then it tells nothing */
    s->bend = bend;
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        part->done = 0;
        part->before = part->square;
    }
    sbi_pcg_run(s, sbi_pcg_bend_task);
    sbi_pcg_run_product(s);
    sbi_pcg_go_along(s, s->extra_sum, (double)SB_REAL_MAX);
    sbi_pcg_run(s, sbi_pcg_start_task);
    sbi_pcg_go_along(s, 0, most);
    if (sbi_pcg_start_cancels(s))
        sbi_pcg_first_residual(s);
}

static sb_result sbi_pcg_run_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                   sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                                   const sbi_pcg_demand *demand, sb_pcg_info *info)
{
    sb_pcg_options defaults = sb_default_pcg_options();
    sb_pcg_info report;
    sbi_pcg_state state;
    sb_result result;
    double rhs_square, x_square;
    options = options ? options : &defaults;
    if (!sbi_pcg_valid(matrix, preconditioner, rhs, x, options, workspace))
        return SB_ERROR_ARGUMENT;
    preconditioner = workspace->unassembled ? NULL : preconditioner;
    memset(&report, 0, sizeof report);
    report.residual_is_true = 1;
    state = sbi_pcg_make_state(matrix, preconditioner, rhs, x, options, workspace);
    state.current = demand->current;
    sbi_pcg_find_parts(&state, preconditioner && sbi_precond_couples_parts(preconditioner));
    sbi_pcg_begin_parts(&state, &rhs_square, &x_square);
    state.product = demand->product;
    sbi_pcg_begin_residual(&state, demand, rhs_square, x_square);
    state.product = NULL;
    workspace->record->is_left = 0;
    sbi_pcg_demand_all(&state, demand, options->tolerance, workspace->record, rhs_square, x_square > 0);
    if (demand->bend && rhs_square > 0 && !sbi_pcg_all_meet(&state))
        sbi_pcg_better_start(&state, demand->bend);
    if (!sbi_pcg_is_finite(rhs_square) || !sbi_pcg_is_finite(sbi_pcg_whole_square(&state)))
        result = SB_ERROR_DIVERGED;
    else
        result = sbi_pcg_refine(&state, preconditioner, options, &report);
    workspace->record->softest = state.softest;
    workspace->record->is_left = result == SB_OK && rhs_square > 0 && !state.compact;
    return sbi_pcg_finish(&state, result, &report, info);
}

SBI_API sbi_pcg_demand sbi_pcg_step_demand(void)
{
    const sbi_pcg_demand plain = {1, 0, 0, 0, 0, NULL, NULL, 0, NULL, NULL};
    return plain;
}

SB_API sb_result sb_pcg_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                              sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace, sb_pcg_info *info)
{
    const sbi_pcg_demand none = {0, 0, 0, 0, 0, NULL, NULL, 0, NULL, NULL};
    return sbi_pcg_run_solve(matrix, preconditioner, rhs, x, options, workspace, &none, info);
}

SBI_API sb_result sbi_pcg_solve_current(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                        sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                                        sb_pcg_info *info)
{
    sbi_pcg_demand plain = sbi_pcg_step_demand();
    return sbi_pcg_run_solve(matrix, preconditioner, rhs, x, options, workspace, &plain, info);
}

/* ---- guests -------------------------------------------------------------------------------------------- */

/* Behind sb_pcg_workspace.guests. A guest without nodes has a part of its own, behind those of the matrix. */
typedef struct sbi_pcg_guest_space {
    sbi_guest_space space;
    sbi_pcg_part *parts; /* [most parts + guests + 1] */
    int *part_start;     /* [most parts + guests + 1] */
} sbi_pcg_guest_space;

static sbi_pcg_guest_space *sbi_pcg_lay_out_guests(const sbi_guests *guests, const sb_matrix *matrix, sbi_arena *arena,
                                                   sbi_pcg_guest_space *fresh)
{
    int rows = matrix->row_count, *part_of;
    size_t parts = (size_t)sbi_matrix_most_parts(rows) + (size_t)guests->count + 1;
    sbi_pcg_guest_space *g = (sbi_pcg_guest_space *)sbi_arena_take(arena, 1, sizeof *g);
    g = arena->base ? g : fresh;
    memset(g, 0, sizeof *g);
    part_of = (int *)sbi_arena_take(arena, (size_t)rows, sizeof(int));
    g->parts = (sbi_pcg_part *)sbi_arena_take(arena, parts, sizeof *g->parts);
    g->part_start = (int *)sbi_arena_take(arena, parts, sizeof(int));
    sbi_guest_space_layout(&g->space, guests, matrix, arena);
    g->space.part_of = part_of;
    return g;
}

SBI_API sbi_guest_space *sbi_pcg_guests(const sb_pcg_workspace *workspace)
{
    return workspace->guests ? &((sbi_pcg_guest_space *)workspace->guests)->space : NULL;
}

SBI_API sb_result sbi_pcg_reserve_guests(sb_pcg_workspace *workspace, const sb_matrix *matrix, const sbi_guests *guests,
                                         sb_error *error)
{
    int rows = workspace->row_count;
    sbi_arena arena = {NULL, 0, 0};
    sbi_pcg_guest_space measured;
    unsigned char *memory = (unsigned char *)workspace->guests;
    size_t bytes;
    sb_result result;
    if (matrix->row_count != rows || !sbi_guests_have_sizes(guests, rows))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a guest of a solve has a size below 0 or more nodes than there are");
    sbi_pcg_lay_out_guests(guests, matrix, &arena, &measured);
    bytes = arena.used;
    if (arena.overflow || bytes > workspace->guest_bytes) {
        arena.overflow |= !sbi_size_add(&bytes, bytes / 2, 1); /* room for guests that grow by and by */
        memory = arena.overflow ? NULL : (unsigned char *)sbi_alloc(&workspace->allocator, bytes, 1);
    }
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d guests of a solve", guests->count);
    /* the marks lie in the same place whatever the guests are */
    result = sbi_guests_check(guests, rows, (int *)(void *)(memory + ((sizeof measured + 63) & ~(size_t)63)), error);
    if (result != SB_OK) {
        if (memory != workspace->guests)
            sbi_free(&workspace->allocator, memory);
        return result;
    }
    if (memory != workspace->guests) {
        sbi_free(&workspace->allocator, workspace->guests);
        workspace->guests = memory;
        workspace->guest_bytes = bytes;
    }
    arena.base = memory;
    arena.used = 0;
    sbi_pcg_lay_out_guests(guests, matrix, &arena, NULL);
    return SB_OK;
}

SBI_API sb_result sbi_pcg_reserve_guest_room(sb_pcg_workspace *workspace, const sb_matrix *matrix, int rows,
                                             int unknowns, int nodes, sb_error *error)
{
    enum {
        VECTORS = 4,
        ALIGNED = 64
    }; /* vectors of the rows that a guest solves; lists may begin later for alignment */
    const sbi_guest *list[1];
    sbi_pcg_guest_space measured;
    sbi_arena arena = {NULL, 0, 0};
    sb_matrix view = *matrix;
    sbi_guests guests;
    sbi_guest guest;
    size_t width = 2 * ((size_t)matrix->block_count / (size_t)sbi_max_int(1, matrix->row_count) + 1); /* of a row */
    unsigned char *memory;
    memset(&guest, 0, sizeof guest);
    guest.unknown_count = unknowns;
    guest.node_count = nodes;
    list[0] = &guest;
    guests.list = list;
    guests.count = 1;
    view.row_count = rows;
    sbi_pcg_lay_out_guests(&guests, &view, &arena, &measured); /* of a guest that takes none */
    sbi_arena_take(&arena, (size_t)nodes, 3 * VECTORS * sizeof(double) + width * 9 * sizeof(sb_real) + 1);
    sbi_arena_take(&arena, VECTORS + 2, ALIGNED);
    if (!arena.overflow && arena.used <= workspace->guest_bytes)
        return SB_OK;
    memory = arena.overflow ? NULL : (unsigned char *)sbi_alloc_zeroed(&workspace->allocator, arena.used, 1);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a guest of %d unknowns on %d nodes", unknowns, nodes);
    sbi_free(&workspace->allocator, workspace->guests);
    workspace->guests = memory;
    workspace->guest_bytes = arena.used;
    return SB_OK;
}

SBI_API sb_result sbi_pcg_keep_guest_room(sb_pcg_workspace *workspace, const sb_pcg_workspace *from, int rows,
                                          int from_rows, sb_error *error)
{
    size_t times = (size_t)(rows / sbi_max_int(1, from_rows)) + (rows % sbi_max_int(1, from_rows) != 0), bytes = 0;
    unsigned char *memory;
    if (!from->guest_bytes)
        return SB_OK;
    memory = sbi_size_add(&bytes, from->guest_bytes, times)
                 ? (unsigned char *)sbi_alloc_zeroed(&workspace->allocator, bytes, 1)
                 : NULL;
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the guests of a solve with %d nodes", rows);
    sbi_free(&workspace->allocator, workspace->guests);
    workspace->guests = memory;
    workspace->guest_bytes = bytes;
    return SB_OK;
}

/* 1 when space was reserved for these. */
static int sbi_pcg_has_room(const sb_pcg_workspace *workspace, const sbi_guests *guests)
{
    const sbi_pcg_guest_space *g = (const sbi_pcg_guest_space *)workspace->guests;
    if (!g || g->space.count != guests->count || !sbi_guests_have_sizes(guests, workspace->row_count))
        return 0;
    for (int k = 0; k < guests->count; k++) {
        const sbi_guest_work *work = g->space.work + k;
        if (work->guest != guests->list[k] ||
            work->size != (size_t)work->guest->unknown_count + 3 * (size_t)work->guest->taken_count ||
            work->width != (size_t)work->guest->unknown_count + 3 * (size_t)work->guest->node_count)
            return 0;
    }
    return 1;
}

SBI_API sb_result sbi_pcg_update_preconditioner(sb_preconditioner *preconditioner, sb_matrix *matrix,
                                                const sb_vec3 *positions, const sbi_guests *guests,
                                                sb_pcg_workspace *workspace, sb_error *error)
{
    sbi_pcg_guest_space *g = (sbi_pcg_guest_space *)workspace->guests;
    sb_result result;
    if (guests->count == 0)
        return sb_preconditioner_update(preconditioner, matrix, positions, error);
    if (!sbi_pcg_has_room(workspace, guests) || sbi_guests_taken_blocks(guests, matrix) > g->space.kept_room)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no space was reserved for the guests of a solve");
    sbi_guest_remove_taken(&g->space, matrix);
    result = sb_preconditioner_update(preconditioner, matrix, positions, error);
    sbi_guest_restore_taken(&g->space, matrix);
    return result;
}

/* Joins the parts with the heads a and b; the first of them is then the head of both. */
static int sbi_pcg_join(sbi_pcg_state *s, int a, int b)
{
    int head = sbi_min_int(a, b), other = sbi_max_int(a, b), last = head;
    if (a == b)
        return a;
    while (s->parts[last].next >= 0)
        last = s->parts[last].next;
    s->parts[last].next = other;
    for (int c = other; c >= 0; c = s->parts[c].next)
        s->parts[c].head = head;
    return head;
}

/* The part of each guest, and parts that it lies in joined. The order in which they are chained is a function of the
 * guests alone. */
static void sbi_pcg_place_guests(sbi_pcg_state *s, sbi_pcg_guest_space *g)
{
    for (int c = 0; c < s->part_count; c++)
        for (int k = s->part_start[c]; k < s->part_start[c + 1]; k++)
            g->space.part_of[s->part_rows ? s->part_rows[k] : k] = c;
    for (int k = 0; k < g->space.count; k++) {
        sbi_guest_work *work = g->space.work + k;
        int head = -1;
        for (int n = 0; n < work->guest->node_count; n++) {
            int part = s->parts[g->space.part_of[work->guest->nodes[n]]].head;
            head = head < 0 ? part : sbi_pcg_join(s, head, part);
        }
        work->part = head;
    }
    for (int k = 0; k < g->space.count; k++)
        if (g->space.work[k].part >= 0)
            g->space.work[k].part = s->parts[g->space.work[k].part].head;
}

/* Parts of the matrix as those of a solve with guests. */
static void sbi_pcg_find_guest_parts(sbi_pcg_state *s, sbi_pcg_guest_space *g, int joint)
{
    int chunks, rows = s->matrix->row_count;
    s->parts = g->parts;
    sbi_pcg_find_parts(s, joint);
    memcpy(g->part_start, s->part_start, ((size_t)s->part_count + 1) * sizeof(int));
    s->part_start = g->part_start;
    sbi_pcg_place_guests(s, g);
    chunks = s->parts[s->part_count].first_chunk;
    for (int k = 0; k < g->space.count; k++) {
        sbi_pcg_part *part = s->parts + s->part_count;
        if (g->space.work[k].part >= 0)
            continue;
        *part = s->parts[0];
        part->first_chunk = chunks;
        part->head = g->space.work[k].part = s->part_count++;
        part->next = -1;
        g->part_start[s->part_count] = rows;
        s->parts[s->part_count].first_chunk = chunks;
    }
}

/* The sizes that tolerances are relative to; 1: there is nothing to start from. Uses r and p. */
static int sbi_pcg_begin_guests(sbi_pcg_state *s)
{
    const double rounding = 16 * (double)SB_EPSILON;
    size_t count = 3 * (size_t)s->matrix->row_count;
    int idle = 1;
    memcpy(s->r, s->rhs, count * sizeof(sb_real));
    sbi_pcg_wake_guests(s);
    sbi_guest_residual(s->guests, NULL, s->x, s->r);
    sbi_guest_measure(s->guests);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        part->before = sbi_pcg_is_head(s, part) ? sbi_pcg_guest_sum(s, part, 0) : 0;
    sbi_pcg_run_square(s, sbi_pcg_norm_task, 1);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++)
        part->rhs_square = part->square;
    sbi_pcg_clear_idle(s);
    for (size_t k = 0; k < count && idle; k++)
        idle = s->x[k] == 0;
    for (int g = 0; g < s->guests->count; g++) {
        const sbi_guest_work *work = s->guests->work + g;
        for (int k = 0; k < work->guest->unknown_count; k++) {
            if (s->parts[work->part].rhs_square == 0)
                work->guest->unknown[k] = work->base[k];
            idle &= work->guest->unknown[k] == work->base[k];
        }
    }
    sbi_guest_guess(s->guests, idle ? s->x : NULL, s->r, s->p);
    sbi_guest_measure(s->guests);
    sbi_pcg_run_square(s, sbi_pcg_norm_task, 1);
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        double least = rounding * rounding * part->before;
        if (part->rhs_square != 0)
            part->rhs_square = part->square < least ? least : part->square; /* also a NaN */
    }
    return idle;
}

/* The residual at x and unknowns that the guests' own blocks have made better. */
static void sbi_pcg_guess_guests(sbi_pcg_state *s)
{
    sbi_pcg_guest_residual(s);
    sbi_guest_guess(s->guests, s->x, s->r, s->p);
    sbi_guest_measure(s->guests);
    sbi_pcg_run_square(s, sbi_pcg_norm_task, 1);
    if (s->extra) /* the guess knows nothing of it */
        sbi_pcg_guest_residual(s);
}

/* After guests have changed their rows. */
static void sbi_pcg_go_on(sbi_pcg_state *s, int trials)
{
    for (sbi_pcg_part *part = s->parts; part < s->parts + s->part_count; part++) {
        part->stuck = 0;
        part->fresh = 1;
        part->target *= trials == 3 ? 0.01 : 1;
    }
    sbi_pcg_guess_guests(s);
}

/* Solves, and again while guests change their rows. */
static sb_result sbi_pcg_settle(sbi_pcg_state *s, sb_preconditioner *preconditioner, const sb_pcg_options *options,
                                sb_pcg_info *info)
{
    for (int trials = 1;; trials++) {
        sb_result result = SB_ERROR_DIVERGED;
        if (sbi_pcg_is_finite(sbi_pcg_whole_square(s)))
            result = sbi_pcg_refine(s, preconditioner, options, info);
        if ((result != SB_OK && result != SB_ERROR_NOT_CONVERGED) || info->capped || !sbi_guest_settle(s->guests, s->x))
            return result;
        sbi_pcg_go_on(s, trials);
    }
}

SBI_API sb_result sbi_pcg_solve_guests(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                       sb_real *x, const sbi_guests *guests, const sb_pcg_options *options,
                                       sb_pcg_workspace *workspace, const sbi_pcg_demand *demand, sb_pcg_info *info)
{
    sb_pcg_options defaults = sb_default_pcg_options();
    sb_pcg_info report;
    sbi_pcg_state state;
    sbi_pcg_guest_space *g;
    sbi_pcg_demand plain;
    sb_result result;
    double rhs_square = 0;
    int idle;
    options = options ? options : &defaults;
    plain = sbi_pcg_step_demand();
    demand = demand ? demand : &plain;
    if (!guests || guests->count == 0)
        return sbi_pcg_run_solve(matrix, preconditioner, rhs, x, options, workspace, demand, info);
    if (!sbi_pcg_valid(matrix, preconditioner, rhs, x, options, workspace) || !sbi_pcg_has_room(workspace, guests))
        return SB_ERROR_ARGUMENT;
    memset(&report, 0, sizeof report);
    report.residual_is_true = 1;
    state = sbi_pcg_make_state(matrix, preconditioner, rhs, x, options, workspace);
    state.current = demand->current;
    workspace->record->is_left = 0;
    g = (sbi_pcg_guest_space *)workspace->guests;
    state.guests = &g->space;
    if (g->space.kept_room > 0)
        state.compact = NULL;
    g->space.matrix = matrix;
    g->space.scale = (double)sbi_matrix_diagonal_scale(matrix, matrix->fixed, options->jobs);
    for (int k = 0; k < g->space.count; k++)
        sbi_guest_keep_start(g->space.work + k);
    sbi_pcg_find_guest_parts(&state, g, preconditioner && sbi_precond_couples_parts(preconditioner));
    sbi_guest_hold(&g->space, rhs, x);
    idle = sbi_pcg_begin_guests(&state);
    for (int c = 0; c < state.part_count; c++)
        rhs_square += state.parts[c].rhs_square;
    state.product = demand->product;
    if (!idle)
        sbi_pcg_guess_guests(&state);
    else if (state.extra)
        sbi_pcg_guest_residual(&state);
    state.product = NULL;
    sbi_pcg_demand_all(&state, demand, options->tolerance, workspace->record, rhs_square, !idle);
    result =
        sbi_pcg_is_finite(rhs_square) ? sbi_pcg_settle(&state, preconditioner, options, &report) : SB_ERROR_DIVERGED;
    workspace->record->softest = state.softest;
    return sbi_pcg_finish(&state, result, &report, info);
}
