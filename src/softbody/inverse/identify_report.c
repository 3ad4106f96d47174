/* identify_report: what readings tell of values: deviations, shares of their own, the direction that is hidden. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "../base/eigen.h"
#include "identify_private.h"

SBI_API int sbi_identify_decompose(sbi_identify *id)
{
    size_t n = (size_t)id->count;
    for (size_t a = 0; a < n; a++)
        for (size_t b = 0; b <= a; b++)
            id->gram[a * n + b] = a != b && (id->pinned[a] || id->pinned[b]) ? 0 : id->hessian[a * n + b];
    return sbi_symmetric_eigen(id->gram, id->count, id->eigenvalues, id->vectors, id->scratch);
}

SBI_API sb_result sbi_identify_analyse(sbi_identify *id)
{
    size_t n = (size_t)id->count;
    double *h = id->hessian;
    memset(h, 0, n * n * sizeof *h);
    memset(id->slope, 0, n * sizeof *id->slope);
    for (int i = 0; i < id->readings; i++) {
        const double *row = id->slopes + (size_t)i * n;
        for (size_t a = 0; a < n; a++) {
            id->slope[a] += row[a] * id->misfit[i];
            for (size_t b = 0; b <= a; b++)
                h[a * n + b] += row[a] * row[b];
        }
    }
    for (size_t a = 0; a < n; a++) {
        id->scale[a] = sqrt(h[a * n + a]);
        if (!(id->scale[a] > 0))
            return sbi_fail(id->error, SB_ERROR_INDEFINITE, "no reading changes with value %d", (int)a);
    }
    for (size_t a = 0; a < n; a++)
        for (size_t b = 0; b <= a; b++)
            h[a * n + b] /= id->scale[a] * id->scale[b];
    memset(id->pinned, 0, n);
    if (!sbi_identify_decompose(id))
        return sbi_fail(id->error, SB_ERROR_NOT_FINITE, "derivatives of the readings are not finite");
    return SB_OK;
}

/* What value k does along the least certain direction when chi2 changes by `size`^2, in words. */
static size_t sbi_identify_say(const sbi_identify *id, int k, double size, char *text, size_t room)
{
    double dq = size * id->vectors[k] / id->scale[k], p = (double)id->values[k];
    int way = sbi_identify_way(id, k), written;
    if (way == 1)
        written = snprintf(text, room, "%svalue %d x %.3g", k ? ", " : "", k, exp(fmax(fmin(dq, 100), -100)));
    else
        written = snprintf(text, room, "%svalue %d %+.3g", k ? ", " : "", k, dq * sbi_identify_rate(id, k, p));
    return written > 0 ? (size_t)written : 0;
}

/* All values along it, as far as they fit. The largest change is one in twice: a direction has no sign, the first value
 * goes up. */
static void sbi_identify_name(const sbi_identify *id, double size, char *text, size_t room)
{
    size_t at = 0;
    if (id->vectors[0] < 0)
        size = -size;
    text[0] = 0;
    for (int k = 0; k < id->count && at + 1 < room; k++)
        at += sbi_identify_say(id, k, size, text + at, room - at);
}

SBI_API sb_result sbi_identify_check_rank(sbi_identify *id)
{
    const double rounding = 1e3 * (double)SB_EPSILON;
    double largest = 0;
    char text[120];
    if (id->eigenvalues[0] > rounding * (SB_EPSILON > (sb_real)1e-10 ? 1 : 1e3) * id->eigenvalues[id->count - 1])
        return SB_OK;
    for (int k = 0; k < id->count; k++)
        largest = fmax(largest, fabs(id->vectors[k] / id->scale[k]));
    sbi_identify_name(id, 0.3 / largest, text, sizeof text);
    return sbi_fail(id->error, SB_ERROR_INDEFINITE, "together these change nothing that was read: %s", text);
}

/* Sum over eigenvectors of z_a z_b / d: an entry of the inverse of H of unit diagonal. */
static double sbi_identify_inverse(const sbi_identify *id, int a, int b)
{
    double sum = 0;
    for (int i = 0; i < id->count; i++) {
        const double *z = id->vectors + (size_t)i * (size_t)id->count;
        sum += z[a] * z[b] / id->eigenvalues[i];
    }
    return sum;
}

static void sbi_identify_correlate(const sbi_identify *id, sb_real *correlations)
{
    for (int a = 0; a < id->count; a++)
        for (int b = 0; b < id->count; b++) {
            double sizes = sqrt(sbi_identify_inverse(id, a, a) * sbi_identify_inverse(id, b, b));
            double both = a == b ? 1 : sbi_identify_inverse(id, a, b) / sizes;
            correlations[(size_t)a * (size_t)id->count + (size_t)b] = (sb_real)fmax(-1, fmin(1, both));
        }
}

/* What sbi_identify_name says, in numbers. */
static void sbi_identify_direct(const sbi_identify *id, double size, sb_real *direction)
{
    if (id->vectors[0] < 0)
        size = -size;
    for (int k = 0; k < id->count; k++) {
        double rate = sbi_identify_rate(id, k, (double)id->values[k]);
        direction[k] = (sb_real)(size * rate * id->vectors[k] / id->scale[k]);
    }
}

static int sbi_identify_locks(const sbi_identify *id)
{
    const sb_real near_half = (sb_real)0.45;
    sb_element_type type = id->body->domain.element_type;
    for (int k = 0; k < id->def->count; k++)
        if (id->def->parameters[k].kind == SB_PARAMETER_POISSON && id->values[k] > near_half &&
            (type == SB_TET4 || type == SB_HEX8) && !sbi_assembly_is_split(&id->body->assembly))
            return 1;
    return 0;
}

static int sbi_identify_at_bound(const sbi_identify *id)
{
    for (int k = 0; k < id->count; k++)
        if ((id->def->low && id->values[k] <= id->def->low[k]) || (id->def->high && id->values[k] >= id->def->high[k]))
            return 1;
    return 0;
}

static int sbi_identify_warnings(const sbi_identify *id)
{
    const sb_real hidden = (sb_real)0.01;
    double freedom = (double)(id->readings - id->count), ratio = freedom > 0 ? id->info.chi2 / freedom : 1;
    return (id->info.weakest < hidden ? SB_IDENTIFY_HIDDEN : 0) + (ratio > 4 || ratio < 0.25 ? SB_IDENTIFY_MISFIT : 0) +
           (sbi_identify_at_bound(id) ? SB_IDENTIFY_BOUND : 0) + (sbi_identify_locks(id) ? SB_IDENTIFY_LOCKS : 0);
}

SBI_API void sbi_identify_report(sbi_identify *id, sb_real *deviations, sb_real *own_shares)
{
    id->info.weakest = 2;
    for (int k = 0; k < id->count; k++) {
        double inverse = sbi_identify_inverse(id, k, k);
        double rate = sbi_identify_rate(id, k, (double)id->values[k]);
        sb_real share = (sb_real)(1 / inverse);
        if (deviations)
            deviations[k] = (sb_real)(fabs(rate) * sqrt(inverse) / id->scale[k]);
        if (own_shares)
            own_shares[k] = share;
        if (share < id->info.weakest) {
            id->info.weakest = share;
            id->info.weakest_parameter = k;
        }
    }
    sbi_identify_name(id, 1 / sqrt(id->eigenvalues[0]), id->info.hidden, sizeof id->info.hidden);
    if (id->def->direction)
        sbi_identify_direct(id, 1 / sqrt(id->eigenvalues[0]), id->def->direction);
    if (id->def->correlations)
        sbi_identify_correlate(id, id->def->correlations);
    id->info.warnings = sbi_identify_warnings(id);
}
