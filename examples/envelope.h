/* envelope: symmetric positive definite systems by Cholesky's factors within the envelope of the lower triangle, for
 * small studies whose unknowns are numbered along a body. Needs libc only.
 *
 *     envelope e;
 *     if (!envelope_begin(&e, count)) ...           0: no memory
 *     envelope_reach(&e, row, column);              of all that will be added
 *     if (!envelope_reserve(&e)) ...
 *     envelope_add(&e, row, column, value);         what lies above the diagonal is left out
 *     e.u[row] += load;
 *     envelope_hold(&e, row, value);
 *     envelope_solve(&e);                           the solution is e.u; 0: not positive definite
 *     envelope_free(&e); */
#ifndef ENVELOPE_H
#define ENVELOPE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct envelope {
    int count;
    int *start;         /* [count] column of the first number of a row, */
    size_t *at;         /* [count + 1] which is there in */
    double *values, *u; /* lower triangle by rows; [count] loads, then the solution */
} envelope;

static inline int envelope_begin(envelope *e, int count)
{
    memset(e, 0, sizeof *e);
    e->count = count;
    e->start = (int *)malloc((size_t)count * sizeof *e->start);
    e->at = (size_t *)malloc(((size_t)count + 1) * sizeof *e->at);
    e->u = (double *)calloc((size_t)count, sizeof *e->u);
    for (int i = 0; i < count && e->start; i++)
        e->start[i] = i;
    return e->start && e->at && e->u;
}

static inline void envelope_reach(envelope *e, int row, int column)
{
    if (column < e->start[row])
        e->start[row] = column;
}

static inline int envelope_reserve(envelope *e)
{
    e->at[0] = 0;
    for (int i = 0; i < e->count; i++)
        e->at[i + 1] = e->at[i] + (size_t)(i - e->start[i] + 1);
    e->values = (double *)calloc(e->at[e->count], sizeof *e->values);
    return e->values != NULL;
}

static inline double *envelope_row(const envelope *e, int row) { return e->values + e->at[row] - e->start[row]; }

static inline void envelope_add(envelope *e, int row, int column, double value)
{
    if (column <= row)
        envelope_row(e, row)[column] += value;
}

/* An unknown that is known. */
static inline void envelope_hold(envelope *e, int unknown, double value)
{
    for (int row = unknown + 1; row < e->count; row++)
        if (e->start[row] <= unknown) {
            e->u[row] -= envelope_row(e, row)[unknown] * value;
            envelope_row(e, row)[unknown] = 0;
        }
    for (int k = e->start[unknown]; k < unknown; k++) {
        e->u[k] -= envelope_row(e, unknown)[k] * value;
        envelope_row(e, unknown)[k] = 0;
    }
    envelope_row(e, unknown)[unknown] = 1;
    e->u[unknown] = value;
}

/* Four sums at a time, which a compiler may keep in one register. */
static inline double envelope_product(const double *a, const double *b, int from, int end)
{
    double sums[4] = {0, 0, 0, 0};
    for (; from + 4 <= end; from += 4)
        for (int k = 0; k < 4; k++)
            sums[k] += a[from + k] * b[from + k];
    for (; from < end; from++)
        sums[0] += a[from] * b[from];
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

static inline int envelope_solve(envelope *e)
{
    for (int i = 0; i < e->count; i++) {
        double *row = envelope_row(e, i);
        for (int j = e->start[i]; j <= i; j++) {
            const double *other = envelope_row(e, j);
            double left =
                row[j] - envelope_product(row, other, e->start[i] > e->start[j] ? e->start[i] : e->start[j], j);
            if (j == i && !(left > 0))
                return 0;
            row[j] = j < i ? left / other[j] : sqrt(left);
        }
        e->u[i] = (e->u[i] - envelope_product(row, e->u, e->start[i], i)) / row[i];
    }
    for (int i = e->count - 1; i >= 0; i--) {
        const double *row = envelope_row(e, i);
        e->u[i] /= row[i];
        for (int k = e->start[i]; k < i; k++)
            e->u[k] -= row[k] * e->u[i];
    }
    return 1;
}

static inline void envelope_free(envelope *e)
{
    free(e->start);
    free(e->at);
    free(e->values);
    free(e->u);
    memset(e, 0, sizeof *e);
}

#endif
