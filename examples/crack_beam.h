/* crack_beam: a beam that is cut to half of its height by X-FEM with branch functions at the front, for cut_study
 * (Suwelack 2014, 8.2). Needs libc and libm only.
 *
 *     crack_beam beam = {nodes, node_count, tets, tet_count, 0.2, 0.1, 0.03, 0.015, 300e3, 0.35, 1000 * 9.81, 0};
 *     crack_beam_result found;
 *     if (crack_beam_solve(&beam, &found)) ...        0: no memory, or not positive definite
 *
 * Linear elasticity on linear tets, clamped at x = 0; the cut is the plane x = cut_at above z = cut_to, and its front
 * the line where it ends. Nodes of tets that the cut goes through have jumps, sum N_J (H(x) - H(x_J))/2 A_J; those of
 * tets that the front goes through, and all within `reach` of it, have the four branch functions of the plane across
 * the front in place of a jump, less their values at the node (8.2.1): a node's displacement is the material's. Tets
 * are divided along the cut's plane and again by halves of their edges, those at the front most (8.2.2).
 *
 * Numbers go along x, so that the factor stays within its envelope: a few thousand nodes. */
#ifndef CRACK_BEAM_H
#define CRACK_BEAM_H

#include "crack_plane.h"

typedef struct crack_beam {
    const double (*nodes)[3]; /* [node_count] m */
    int node_count;
    const int (*tets)[4]; /* [tet_count] of positive volume */
    int tet_count;
    double length, cut_at, cut_to, reach;   /* m; reach of the front; 0: no branch functions */
    double young, poisson, weight, stretch; /* Pa, -, N/m3 downwards, m by which the far end is drawn; 0: it is free */
} crack_beam;

typedef struct crack_beam_result {
    double sag, force; /* of the far end, on the mean (m); that holds the near one back (N) */
    double opening;    /* of the cut at the top, on the mean (m) */
    int unknowns;
} crack_beam_result;

enum { BEAM_OWN = 4 * 5 }; /* functions of a tet at most */

typedef struct beam_system {
    const crack_beam *beam;
    unsigned char *jumps, *tips; /* [node_count] */
    int *first;                  /* [node_count] */
    double *pulls;               /* [unknowns] along x by what is held, before it is */
    envelope k;
} beam_system;

typedef struct beam_tet {
    int nodes[4];
    double x[4][3], g[4][3], volume;
    int own, unknowns[BEAM_OWN];
    double stiffness[3 * BEAM_OWN][3 * BEAM_OWN], load[BEAM_OWN]; /* load: along z for a weight of 1 */
} beam_tet;

/* ---- what the cut goes through ---------------------------------------------------------------------------------- */

static inline double beam_beyond(const crack_beam *b, const double x[3]) { return x[0] - b->cut_at; }

/* Distance ahead of the front. */
static inline double beam_ahead(const crack_beam *b, const double x[3]) { return b->cut_to - x[2]; }

/* Of the polygon in which a tet meets the cut's plane: the least and largest distance ahead of the front. 0: none. */
static inline int beam_crosses(const crack_beam *b, const int nodes[4], double between[2])
{
    int found = 0;
    between[0] = HUGE_VAL, between[1] = -HUGE_VAL;
    for (int p = 0; p < 4; p++)
        for (int q = p + 1; q < 4; q++) {
            const double *a = b->nodes[nodes[p]], *c = b->nodes[nodes[q]];
            double da = beam_beyond(b, a), dc = beam_beyond(b, c);
            if (da * dc >= 0)
                continue;
            double t = da / (da - dc), ahead = (1 - t) * beam_ahead(b, a) + t * beam_ahead(b, c);
            between[0] = fmin(between[0], ahead);
            between[1] = fmax(between[1], ahead);
            found = 1;
        }
    return found;
}

static inline int beam_has_front(const crack_beam *b, const int nodes[4])
{
    double between[2], tiny = 1e-9 * b->length;
    return beam_crosses(b, nodes, between) && between[0] < tiny && between[1] > -tiny;
}

/* As for the plate: jumps of what is cut through, not where the cut ends; branch functions at the front and near it. */
static inline void beam_enrich(beam_system *s)
{
    const crack_beam *b = s->beam;
    for (int round = 0; round < 2; round++)
        for (int t = 0; t < b->tet_count; t++) {
            double between[2];
            int parts;
            if (!beam_crosses(b, b->tets[t], between))
                continue;
            parts = between[1] < 1e-9 * b->length;
            for (int a = 0; a < 4; a++) {
                if (parts == !round)
                    s->jumps[b->tets[t][a]] = (unsigned char)parts;
                if (b->reach > 0 && beam_has_front(b, b->tets[t]))
                    s->tips[b->tets[t][a]] = 1;
            }
        }
    for (int i = 0; i < b->node_count; i++) {
        double distance = hypot(beam_beyond(b, b->nodes[i]), beam_ahead(b, b->nodes[i]));
        s->tips[i] = (unsigned char)(s->tips[i] || distance < b->reach);
        s->jumps[i] = (unsigned char)(s->jumps[i] && !s->tips[i]);
    }
}

/* ---- functions -------------------------------------------------------------------------------------------------- */

/* Gradients of the linear functions; the volume. */
static inline double beam_gradients(double x[4][3], double g[4][3])
{
    double e[3][3], six;
    for (int k = 0; k < 3; k++)
        for (int axis = 0; axis < 3; axis++)
            e[k][axis] = x[k + 1][axis] - x[0][axis];
    for (int k = 0; k < 3; k++) {
        const double *p = e[(k + 1) % 3], *q = e[(k + 2) % 3];
        for (int axis = 0; axis < 3; axis++)
            g[k + 1][axis] = p[(axis + 1) % 3] * q[(axis + 2) % 3] - p[(axis + 2) % 3] * q[(axis + 1) % 3];
    }
    six = e[0][0] * g[1][0] + e[0][1] * g[1][1] + e[0][2] * g[1][2];
    for (int axis = 0; axis < 3; axis++) {
        for (int k = 1; k < 4; k++)
            g[k][axis] /= six;
        g[0][axis] = -(g[1][axis] + g[2][axis] + g[3][axis]);
    }
    return six / 6;
}

static inline void beam_tet_make(const beam_system *s, int tet, beam_tet *t)
{
    t->own = 0;
    for (int a = 0; a < 4; a++) {
        int node = s->beam->tets[tet][a], functions = 1 + s->jumps[node] + 4 * s->tips[node];
        t->nodes[a] = node;
        memcpy(t->x[a], s->beam->nodes[node], sizeof t->x[a]);
        for (int k = 0; k < functions; k++)
            t->unknowns[t->own++] = s->first[node] + 3 * k;
    }
    t->volume = beam_gradients(t->x, t->g);
    memset(t->stiffness, 0, sizeof t->stiffness);
    memset(t->load, 0, sizeof t->load);
}

/* Values and slopes of a tet's functions at a place beyond the cut's plane, or before it. */
static inline void beam_evaluate(const beam_system *s, const beam_tet *t, const double x[3], int beyond,
                                 double values[BEAM_OWN], double slopes[BEAM_OWN][3])
{
    const crack_beam *b = s->beam;
    double f[4], df[4][2], here[4], unused[4][2];
    int count = 0;
    crack_branch(beam_ahead(b, x), beam_beyond(b, x), f, df);
    for (int a = 0; a < 4; a++) {
        const double *X = t->x[a], *g = t->g[a];
        double n = 1 + g[0] * (x[0] - X[0]) + g[1] * (x[1] - X[1]) + g[2] * (x[2] - X[2]);
        values[count] = n;
        memcpy(slopes[count++], g, 3 * sizeof *g);
        if (s->jumps[t->nodes[a]]) {
            double jump = beyond - (beam_beyond(b, X) > 0);
            values[count] = jump * n;
            for (int axis = 0; axis < 3; axis++)
                slopes[count][axis] = jump * g[axis];
            count++;
        }
        if (!s->tips[t->nodes[a]])
            continue;
        crack_branch(beam_ahead(b, X), beam_beyond(b, X), here, unused);
        for (int k = 0; k < 4; k++) {
            const double slope[3] = {df[k][1], 0, -df[k][0]}; /* ahead is down, above is along x */
            values[count] = n * (f[k] - here[k]);
            for (int axis = 0; axis < 3; axis++)
                slopes[count][axis] = g[axis] * (f[k] - here[k]) + n * slope[axis];
            count++;
        }
    }
}

/* ---- points ----------------------------------------------------------------------------------------------------- */

static inline void beam_add_point(const beam_system *s, beam_tet *t, const double x[3], double volume)
{
    const crack_beam *b = s->beam;
    const double mu = b->young / (2 * (1 + b->poisson));
    const double lambda = b->young * b->poisson / ((1 + b->poisson) * (1 - 2 * b->poisson));
    double values[BEAM_OWN], slopes[BEAM_OWN][3];
    beam_evaluate(s, t, x, beam_beyond(b, x) > 0, values, slopes);
    for (int p = 0; p < t->own; p++) {
        const double *g = slopes[p];
        t->load[p] += volume * values[p];
        for (int q = 0; q <= p; q++) {
            const double *h = slopes[q];
            double both = mu * (g[0] * h[0] + g[1] * h[1] + g[2] * h[2]);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    t->stiffness[3 * p + i][3 * q + j] +=
                        volume * (lambda * g[i] * h[j] + mu * g[j] * h[i] + (i == j ? both : 0));
        }
    }
}

static inline double beam_volume(double x[4][3])
{
    double unused[4][3];
    return fabs(beam_gradients(x, unused));
}

/* Divides a part of a tet at a place of its edge from corner p to q, and goes on with both. */
typedef void (*beam_use)(const beam_system *s, beam_tet *t, double x[4][3], int depth);
static inline void beam_bisect(const beam_system *s, beam_tet *t, double x[4][3], int p, int q, double at, int depth,
                               beam_use use)
{
    double half[4][3];
    for (int side = 0; side < 2; side++) {
        memcpy(half, x, sizeof half);
        for (int axis = 0; axis < 3; axis++)
            half[side ? p : q][axis] = (1 - at) * x[p][axis] + at * x[q][axis];
        use(s, t, half, depth);
    }
}

/* A part on one side of the cut: the longest edge is halved, `depth` times. */
static inline void beam_add_part(const beam_system *s, beam_tet *t, double x[4][3], int depth)
{
    double longest = 0, middle[3] = {0, 0, 0};
    int p = 0, q = 1;
    if (depth == 0) {
        for (int a = 0; a < 4; a++)
            for (int axis = 0; axis < 3; axis++)
                middle[axis] += x[a][axis] / 4;
        beam_add_point(s, t, middle, beam_volume(x));
        return;
    }
    for (int a = 0; a < 4; a++)
        for (int c = a + 1; c < 4; c++) {
            double d[3] = {x[c][0] - x[a][0], x[c][1] - x[a][1], x[c][2] - x[a][2]};
            double length = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            if (length > longest) {
                longest = length;
                p = a, q = c;
            }
        }
    beam_bisect(s, t, x, p, q, 0.5, depth - 1, beam_add_part);
}

/* Parts that lie on both sides are divided until none does. */
static inline void beam_add_sides(const beam_system *s, beam_tet *t, double x[4][3], int depth)
{
    const double tiny = 1e-12 * s->beam->length;
    for (int p = 0; p < 4; p++)
        for (int q = p + 1; q < 4; q++) {
            double a = beam_beyond(s->beam, x[p]), c = beam_beyond(s->beam, x[q]);
            if ((a < -tiny && c > tiny) || (a > tiny && c < -tiny)) {
                beam_bisect(s, t, x, p, q, a / (a - c), depth, beam_add_sides);
                return;
            }
        }
    beam_add_part(s, t, x, depth);
}

static inline void beam_add_tet(beam_system *s, beam_tet *t)
{
    enum { PLAIN = 0, BRANCHED = 6, AT_FRONT = 9 }; /* halvings: three are one of all edges */
    int depth = PLAIN;
    for (int a = 0; a < 4; a++)
        depth = s->tips[t->nodes[a]] ? BRANCHED : depth;
    if (depth == BRANCHED && beam_has_front(s->beam, t->nodes))
        depth = AT_FRONT;
    beam_add_sides(s, t, t->x, depth);
    for (int p = 0; p < 3 * t->own; p++) {
        int row = t->unknowns[p / 3] + p % 3;
        for (int q = 0; q < 3 * t->own; q++)
            envelope_add(&s->k, row, t->unknowns[q / 3] + q % 3,
                         p / 3 >= q / 3 ? t->stiffness[p][q] : t->stiffness[q][p]);
        if (p % 3 == 2)
            s->k.u[row] -= s->beam->weight * t->load[p / 3];
    }
}

/* ---- the system ------------------------------------------------------------------------------------------------- */

typedef struct beam_order {
    double x;
    int node;
} beam_order;

static inline int beam_compare(const void *a, const void *b)
{
    const beam_order *p = (const beam_order *)a, *q = (const beam_order *)b;
    return p->x < q->x ? -1 : p->x > q->x ? 1 : p->node - q->node;
}

/* Numbers unknowns along the beam; how many, or 0: no memory. */
static inline int beam_number(beam_system *s)
{
    const crack_beam *b = s->beam;
    beam_order *order = (beam_order *)malloc((size_t)b->node_count * sizeof *order);
    int count = 0;
    for (int i = 0; i < b->node_count && order; i++) {
        order[i].x = b->nodes[i][0];
        order[i].node = i;
    }
    if (order)
        qsort(order, (size_t)b->node_count, sizeof *order, beam_compare);
    for (int i = 0; i < b->node_count && order; i++) {
        int node = order[i].node;
        s->first[node] = count;
        count += 3 * (1 + s->jumps[node] + 4 * s->tips[node]);
    }
    free(order);
    return count;
}

static inline int beam_reserve(beam_system *s, beam_tet *t)
{
    int count = beam_number(s);
    if (!count || !envelope_begin(&s->k, count))
        return 0;
    for (int e = 0; e < s->beam->tet_count; e++) {
        int least = count;
        beam_tet_make(s, e, t);
        for (int i = 0; i < t->own; i++)
            least = t->unknowns[i] < least ? t->unknowns[i] : least;
        for (int i = 0; i < 3 * t->own; i++)
            envelope_reach(&s->k, t->unknowns[i / 3] + i % 3, least);
    }
    s->pulls = (double *)calloc((size_t)count, sizeof *s->pulls);
    return s->pulls && envelope_reserve(&s->k);
}

/* Holds all unknowns of nodes at x = 0, and along x those of the far end where it is drawn. What is held pulls by the
 * sum of its rows along x, which is kept first. */
static inline void beam_hold(beam_system *s)
{
    const crack_beam *b = s->beam;
    const double tiny = 1e-9 * b->length;
    for (int i = 0; i < b->node_count; i++) {
        int functions = 1 + s->jumps[i] + 4 * s->tips[i], of = s->first[i];
        if (b->nodes[i][0] < tiny)
            for (int row = of; row < of + 3 * functions; row++)
                envelope_hold(&s->k, row, 0);
        if (b->stretch != 0 && b->nodes[i][0] > b->length - tiny)
            for (int row = of; row < of + 3 * functions; row++)
                envelope_hold(&s->k, row, row == of ? b->stretch : 0);
    }
}

/* Force along x on what is clamped, by the rows that envelope_hold takes away. */
static inline void beam_keep_pulls(beam_system *s)
{
    const crack_beam *b = s->beam;
    for (int i = 0; i < b->node_count; i++) {
        int row = s->first[i];
        if (b->nodes[i][0] > 1e-9 * b->length)
            continue;
        for (int k = s->k.start[row]; k <= row; k++)
            s->pulls[k] += envelope_row(&s->k, row)[k];
        for (int other = row + 1; other < s->k.count; other++)
            if (s->k.start[other] <= row)
                s->pulls[other] += envelope_row(&s->k, other)[row];
    }
}

/* Displacement along x where the cut meets the top, on either side. */
static inline double beam_x_at(const beam_system *s, beam_tet *t, const double x[3], int beyond)
{
    const crack_beam *b = s->beam;
    double values[BEAM_OWN], slopes[BEAM_OWN][3], sum = 0, deepest = -HUGE_VAL;
    int best = 0;
    for (int e = 0; e < b->tet_count; e++) {
        double least = HUGE_VAL;
        for (int a = 0; a < 4; a++)
            memcpy(t->x[a], b->nodes[b->tets[e][a]], sizeof t->x[a]);
        beam_gradients(t->x, t->g);
        for (int a = 0; a < 4; a++)
            least = fmin(least, 1 + t->g[a][0] * (x[0] - t->x[a][0]) + t->g[a][1] * (x[1] - t->x[a][1]) +
                                    t->g[a][2] * (x[2] - t->x[a][2]));
        if (least > deepest) {
            deepest = least;
            best = e;
        }
    }
    beam_tet_make(s, best, t);
    beam_evaluate(s, t, x, beyond, values, slopes);
    for (int i = 0; i < t->own; i++)
        sum += values[i] * s->k.u[t->unknowns[i]];
    return sum;
}

static inline void beam_read(const beam_system *s, beam_tet *t, crack_beam_result *found)
{
    enum { PLACES = 9 };
    const crack_beam *b = s->beam;
    double low[3] = {0, HUGE_VAL, HUGE_VAL}, high[3] = {0, -HUGE_VAL, -HUGE_VAL};
    int ends = 0;
    memset(found, 0, sizeof *found);
    for (int i = 0; i < b->node_count; i++) {
        for (int axis = 1; axis < 3; axis++) {
            low[axis] = fmin(low[axis], b->nodes[i][axis]);
            high[axis] = fmax(high[axis], b->nodes[i][axis]);
        }
        if (b->nodes[i][0] > b->length * (1 - 1e-9)) {
            found->sag -= s->k.u[s->first[i] + 2];
            ends++;
        }
    }
    found->sag /= ends;
    for (int i = 0; i < s->k.count; i++)
        found->force -= s->pulls[i] * s->k.u[i];
    for (int i = 0; i < PLACES; i++) {
        double x[3] = {b->cut_at, low[1] + (high[1] - low[1]) * (i + 0.5) / (int)PLACES, high[2] - 1e-6 * b->length};
        found->opening += (beam_x_at(s, t, x, 1) - beam_x_at(s, t, x, 0)) / (int)PLACES;
    }
    found->unknowns = s->k.count;
}

static inline int crack_beam_solve(const crack_beam *beam, crack_beam_result *found)
{
    beam_system s;
    beam_tet *t = (beam_tet *)malloc(sizeof *t);
    int done;
    memset(&s, 0, sizeof s);
    s.beam = beam;
    s.jumps = (unsigned char *)calloc((size_t)beam->node_count, 1);
    s.tips = (unsigned char *)calloc((size_t)beam->node_count, 1);
    s.first = (int *)malloc((size_t)beam->node_count * sizeof *s.first);
    done = t && s.jumps && s.tips && s.first;
    if (done) {
        beam_enrich(&s);
        done = beam_reserve(&s, t);
    }
    for (int e = 0; done && e < beam->tet_count; e++) {
        beam_tet_make(&s, e, t);
        beam_add_tet(&s, t);
    }
    if (done) {
        beam_keep_pulls(&s);
        beam_hold(&s);
        done = envelope_solve(&s.k);
    }
    if (done)
        beam_read(&s, t, found);
    free(t);
    free(s.jumps);
    free(s.tips);
    free(s.first);
    free(s.pulls);
    envelope_free(&s.k);
    return done;
}

#endif
