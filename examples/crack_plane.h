/* crack_plane: the energy of a crack by X-FEM with and without branch functions, for cut_study. Needs libc and libm
 * only.
 *
 *     crack_plane plate = {CRACK_BRANCH, 21, 0.5, 0.1};
 *     crack_plane_result found;
 *     if (crack_plane_solve(&plate, &found))     0: no memory
 *         ... found.energy
 *
 * A plate, 1 wide and 2 high, E 1, nu 0.3, in plane strain, is pulled at both ends by 1; a crack goes in from its left
 * side at half of its height. Linear triangles, one diagonal in each rectangle. How they take the crack:
 *
 *     by hand     the mesh has an edge along the crack, whose nodes are doubled. Cells across: even
 *     Heaviside   the crack goes through triangles; nodes whose triangles it parts have a jump: u = sum N_J u_J +
 *                 sum N_J (H(x) - H(x_J))/2 A_J. In the triangle where it ends, none: it lags. Cells across: odd
 *     branch      nodes of the triangle where the crack ends, and all within `reach` of the tip, have the four branch
 *                 functions sqrt(r) {sin t/2, cos t/2, sin t/2 sin t, cos t/2 sin t} in place of a jump, less their
 *                 values at the node (Suwelack 2014, 8.2.1)
 *
 * Triangles are integrated on both sides of the crack's line apart, those with branch functions over finer ones, the
 * finest at the tip. */
#ifndef CRACK_PLANE_H
#define CRACK_PLANE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef enum crack_kind { CRACK_BY_HAND = 0, CRACK_HEAVISIDE = 1, CRACK_BRANCH = 2 } crack_kind;

typedef struct crack_plane {
    crack_kind kind;
    int cells;     /* across */
    double length; /* of the crack, in (0, 1) */
    double reach;  /* of branch functions from the tip */
} crack_plane;

typedef struct crack_plane_result {
    double energy; /* elastic, that the crack adds to the whole plate's */
    int nodes, unknowns;
} crack_plane_result;

enum { CRACK_FUNCTIONS = 3 * 5, CRACK_MOST = 2 * CRACK_FUNCTIONS };
static const double crack_height = 2, crack_poisson = 0.3;

typedef struct crack_system {
    const crack_plane *plate;
    int rows, node_count;        /* of rectangles; nodes, (cells + 1) to a row, then the doubled ones */
    double size[2];              /* of a rectangle */
    unsigned char *jumps, *tips; /* [node_count] 1: has a jump, has branch functions */
    int *first;                  /* [node_count + 1] unknown of a node, its displacement first */
    int *start;                  /* [unknowns] column of the first number of a row, */
    size_t *at;                  /* [unknowns + 1] which is there in */
    double *values, *u;          /* lower triangle by rows; [unknowns] loads, then the solution */
} crack_system;

/* ---- the mesh --------------------------------------------------------------------------------------------------- */

static inline void crack_place(const crack_system *s, int node, double x[2])
{
    int in_row = s->plate->cells + 1, of_mesh = in_row * (s->rows + 1);
    int i = node < of_mesh ? node % in_row : node - of_mesh, j = node < of_mesh ? node / in_row : s->rows / 2;
    x[0] = i * s->size[0];
    x[1] = j * s->size[1];
}

/* The nodes of a triangle, of which each rectangle has two; over a crack by hand they are the doubled ones. */
static inline void crack_triangle(const crack_system *s, int triangle, int nodes[3])
{
    int in_row = s->plate->cells + 1, cell = triangle / 2, row = cell / s->plate->cells,
        column = cell % s->plate->cells;
    int corner = row * in_row + column, upper = triangle % 2;
    nodes[0] = corner;
    nodes[1] = upper ? corner + in_row + 1 : corner + 1;
    nodes[2] = upper ? corner + in_row : corner + in_row + 1;
    for (int a = 0; a < 3 && s->plate->kind == CRACK_BY_HAND && row == s->rows / 2; a++)
        if (nodes[a] / in_row == row && nodes[a] % in_row * s->size[0] < s->plate->length - 1e-9)
            nodes[a] = in_row * (s->rows + 1) + nodes[a] % in_row;
}

static inline int crack_triangle_count(const crack_system *s) { return 2 * s->rows * s->plate->cells; }

/* Where the crack's line goes through a triangle, between two places; 0: it does not. */
static inline int crack_crosses(const crack_system *s, const int nodes[3], double between[2])
{
    double x[3][2];
    int found = 0;
    for (int a = 0; a < 3; a++)
        crack_place(s, nodes[a], x[a]);
    for (int a = 0; a < 3; a++) {
        const double *p = x[a], *q = x[(a + 1) % 3];
        double below = p[1] - crack_height / 2, above = q[1] - crack_height / 2;
        if (below * above < 0)
            between[found++] = p[0] + (q[0] - p[0]) * below / (below - above);
    }
    if (found == 2 && between[0] > between[1]) {
        double swap = between[0];
        between[0] = between[1];
        between[1] = swap;
    }
    return found == 2;
}

/* Marks nodes of triangles that are cut through, but not those of the edge where the crack stops; then those with
 * branch functions, which have no jump besides. */
static inline void crack_enrich(crack_system *s)
{
    const double tip = s->plate->length;
    for (int round = 0; round < 2; round++)
        for (int t = 0; t < crack_triangle_count(s); t++) {
            int nodes[3], through;
            double between[2];
            crack_triangle(s, t, nodes);
            if (!crack_crosses(s, nodes, between))
                continue;
            through = between[1] < tip + 1e-9;
            for (int a = 0; a < 3; a++) {
                if (through == !round)
                    s->jumps[nodes[a]] = (unsigned char)through;
                if (s->plate->kind == CRACK_BRANCH && between[0] < tip + 1e-9 && between[1] > tip - 1e-9)
                    s->tips[nodes[a]] = 1;
            }
        }
    for (int i = 0; i < s->node_count && s->plate->kind == CRACK_BRANCH; i++) {
        double x[2];
        crack_place(s, i, x);
        s->tips[i] |= hypot(x[0] - tip, x[1] - crack_height / 2) < s->plate->reach;
        s->jumps[i] = (unsigned char)(s->jumps[i] && !s->tips[i]);
    }
}

/* ---- functions --------------------------------------------------------------------------------------------------- */

/* The branch functions at a place, and their slopes. */
static inline void crack_branch(const crack_system *s, const double x[2], double f[4], double slope[4][2])
{
    double dx = x[0] - s->plate->length, dy = x[1] - crack_height / 2, r = hypot(dx, dy), t = atan2(dy, dx);
    double root = sqrt(r), sine = sin(t / 2), cosine = cos(t / 2), c = cos(t), d = sin(t);
    double along[4] = {cosine / 2, -sine / 2, cosine * d / 2 + sine * c, -sine * d / 2 + cosine * c};
    f[0] = root * sine, f[1] = root * cosine, f[2] = root * sine * d, f[3] = root * cosine * d;
    for (int k = 0; k < 4; k++) {
        double out = f[k] / (2 * r), round = along[k] / root;
        slope[k][0] = out * c - round * d;
        slope[k][1] = out * d + round * c;
    }
}

/* The slopes of all functions of a triangle at a place with these weights, and the unknown that each has; how many. */
static inline int crack_slopes(const crack_system *s, const int nodes[3], double g[3][2], const double weights[3],
                               const double x[2], double slopes[CRACK_FUNCTIONS][2], int unknowns[CRACK_FUNCTIONS])
{
    int count = 0;
    for (int a = 0; a < 3; a++) {
        double X[2], f[4], df[4][2], here[4], unused[4][2];
        int of = s->first[nodes[a]];
        crack_place(s, nodes[a], X);
        slopes[count][0] = g[a][0], slopes[count][1] = g[a][1];
        unknowns[count++] = of;
        if (s->jumps[nodes[a]]) {
            double jump = ((x[1] > crack_height / 2) - (X[1] > crack_height / 2));
            slopes[count][0] = jump * g[a][0], slopes[count][1] = jump * g[a][1];
            unknowns[count++] = of + 2;
        }
        if (!s->tips[nodes[a]])
            continue;
        crack_branch(s, x, f, df);
        crack_branch(s, X, here, unused);
        for (int k = 0; k < 4; k++) {
            for (int axis = 0; axis < 2; axis++)
                slopes[count][axis] = g[a][axis] * (f[k] - here[k]) + weights[a] * df[k][axis];
            unknowns[count++] = of + 2 + 2 * k;
        }
    }
    return count;
}

/* ---- the stiffness ---------------------------------------------------------------------------------------------- */

/* Gradients of a triangle's shape functions; its area. */
static inline double crack_gradients(double x[3][2], double g[3][2])
{
    double twice = (x[1][0] - x[0][0]) * (x[2][1] - x[0][1]) - (x[2][0] - x[0][0]) * (x[1][1] - x[0][1]);
    for (int a = 0; a < 3; a++) {
        const double *p = x[(a + 1) % 3], *q = x[(a + 2) % 3];
        g[a][0] = (p[1] - q[1]) / twice;
        g[a][1] = (q[0] - p[0]) / twice;
    }
    return twice / 2;
}

/* Adds what `area` about a place contributes. */
static inline void crack_add_point(crack_system *s, const int nodes[3], double x[3][2], double g[3][2],
                                   const double weights[3], double area)
{
    const double mu = 1 / (2 * (1 + crack_poisson));
    const double lambda = crack_poisson / ((1 + crack_poisson) * (1 - 2 * crack_poisson));
    double slopes[CRACK_FUNCTIONS][2], at[2] = {0, 0};
    int unknowns[CRACK_FUNCTIONS], count;
    for (int a = 0; a < 3; a++)
        for (int axis = 0; axis < 2; axis++)
            at[axis] += weights[a] * x[a][axis];
    count = crack_slopes(s, nodes, g, weights, at, slopes, unknowns);
    for (int p = 0; p < count; p++)
        for (int q = 0; q < count; q++) {
            const double *a = slopes[p], *b = slopes[q];
            double both = a[0] * b[0] + a[1] * b[1];
            for (int i = 0; i < 2; i++)
                for (int j = 0; j < 2; j++) {
                    int row = unknowns[p] + i, column = unknowns[q] + j;
                    double k = lambda * a[i] * b[j] + mu * a[j] * b[i] + (i == j ? mu * both : 0);
                    if (column <= row)
                        s->values[s->at[row] + (size_t)(column - s->start[row])] += area * k;
                }
        }
}

/* Adds a part of a triangle, whose corners have these weights, in n x n pieces by three points each. */
static inline void crack_add_part(crack_system *s, const int nodes[3], double x[3][2], double g[3][2], double area,
                                  double part[3][3], int n)
{
    double share = fabs(part[0][0] * (part[1][1] * part[2][2] - part[1][2] * part[2][1]) -
                        part[0][1] * (part[1][0] * part[2][2] - part[1][2] * part[2][0]) +
                        part[0][2] * (part[1][0] * part[2][1] - part[1][1] * part[2][0]));
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n - i; j++)
            for (int down = 0; down < (i + j < n - 1 ? 2 : 1); down++)
                for (int point = 0; point < 3; point++) {
                    double u =
                        (i + (down ? 2.0 / 3 : 1.0 / 3) + (point == 1 ? 1.0 / 3 : -1.0 / 6) * (down ? -1 : 1)) / n;
                    double v =
                        (j + (down ? 2.0 / 3 : 1.0 / 3) + (point == 2 ? 1.0 / 3 : -1.0 / 6) * (down ? -1 : 1)) / n;
                    double weights[3];
                    for (int a = 0; a < 3; a++)
                        weights[a] = (1 - u - v) * part[0][a] + u * part[1][a] + v * part[2][a];
                    crack_add_point(s, nodes, x, g, weights, area * share / (3.0 * n * n));
                }
}

/* Divides a triangle that the crack's line crosses into three, none of which is on both sides. */
static inline void crack_divide(double x[3][2], double parts[3][3][3])
{
    int lone = 0;
    double corner[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, cut[2][3] = {{0, 0, 0}, {0, 0, 0}};
    for (int a = 1; a < 3; a++)
        if ((x[a][1] > crack_height / 2) != (x[(a + 1) % 3][1] > crack_height / 2) &&
            (x[a][1] > crack_height / 2) != (x[(a + 2) % 3][1] > crack_height / 2))
            lone = a;
    for (int k = 0; k < 2; k++) {
        int other = (lone + 1 + k) % 3;
        double t = (crack_height / 2 - x[lone][1]) / (x[other][1] - x[lone][1]);
        cut[k][lone] = 1 - t;
        cut[k][other] = t;
    }
    memcpy(parts[0][0], corner[lone], sizeof corner[0]);
    memcpy(parts[0][1], cut[0], sizeof cut[0]);
    memcpy(parts[0][2], cut[1], sizeof cut[1]);
    memcpy(parts[1][0], cut[0], sizeof cut[0]);
    memcpy(parts[1][1], corner[(lone + 1) % 3], sizeof corner[0]);
    memcpy(parts[1][2], corner[(lone + 2) % 3], sizeof corner[0]);
    memcpy(parts[2][0], cut[0], sizeof cut[0]);
    memcpy(parts[2][1], corner[(lone + 2) % 3], sizeof corner[0]);
    memcpy(parts[2][2], cut[1], sizeof cut[1]);
}

static inline void crack_add_triangle(crack_system *s, int triangle)
{
    enum { PLAIN = 1, BRANCHED = 6, AT_TIP = 16 };
    double x[3][2], g[3][2], between[2], parts[3][3][3] = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, area;
    int nodes[3], crossed, fine = PLAIN;
    crack_triangle(s, triangle, nodes);
    crossed = s->plate->kind != CRACK_BY_HAND && crack_crosses(s, nodes, between);
    for (int a = 0; a < 3; a++) {
        crack_place(s, nodes[a], x[a]);
        if (s->tips[nodes[a]] && fine == PLAIN)
            fine = BRANCHED;
    }
    if (crossed && fine == BRANCHED && between[0] < s->plate->length + 1e-9 && between[1] > s->plate->length - 1e-9)
        fine = AT_TIP;
    area = crack_gradients(x, g);
    if (crossed)
        crack_divide(x, parts);
    for (int k = 0; k < (crossed ? 3 : 1); k++)
        crack_add_part(s, nodes, x, g, area, parts[k], fine);
}

/* ---- the system ------------------------------------------------------------------------------------------------- */

/* Numbers the unknowns, row of nodes by row of nodes, and makes room for the lower triangle's envelope. 0: no memory.
 */
static inline int crack_number(crack_system *s)
{
    int in_row = s->plate->cells + 1, count = 0, reached;
    for (int j = 0; j <= s->rows; j++)
        for (int copy = 0; copy < (j == s->rows / 2 ? 2 : 1); copy++)
            for (int i = 0; i < in_row; i++) {
                int node = copy ? in_row * (s->rows + 1) + i : j * in_row + i;
                if (node >= s->node_count)
                    break;
                s->first[node] = count;
                count += 2 + 2 * s->jumps[node] + 8 * s->tips[node];
            }
    s->first[s->node_count] = count;
    s->start = (int *)malloc((size_t)count * sizeof *s->start);
    s->at = (size_t *)malloc((size_t)(count + 1) * sizeof *s->at);
    s->u = (double *)calloc((size_t)count, sizeof *s->u);
    if (!s->start || !s->at || !s->u)
        return 0;
    for (int i = 0; i < count; i++)
        s->start[i] = i;
    for (int t = 0; t < crack_triangle_count(s); t++) {
        int nodes[3], least;
        crack_triangle(s, t, nodes);
        least = s->first[nodes[0]];
        for (int a = 1; a < 3; a++)
            least = s->first[nodes[a]] < least ? s->first[nodes[a]] : least;
        for (int a = 0; a < 3; a++) {
            int own = 2 + 2 * s->jumps[nodes[a]] + 8 * s->tips[nodes[a]];
            for (int k = s->first[nodes[a]]; k < s->first[nodes[a]] + own; k++)
                s->start[k] = least < s->start[k] ? least : s->start[k];
        }
    }
    s->at[0] = 0;
    for (reached = 0; reached < count; reached++)
        s->at[reached + 1] = s->at[reached] + (size_t)(reached - s->start[reached] + 1);
    s->values = (double *)calloc(s->at[count], sizeof *s->values);
    return s->values != NULL;
}

/* An unknown that is 0. */
static inline void crack_hold(crack_system *s, int unknown)
{
    int count = s->first[s->node_count];
    for (int row = unknown; row < count; row++)
        if (s->start[row] <= unknown)
            s->values[s->at[row] + (size_t)(unknown - s->start[row])] = 0;
    for (size_t k = s->at[unknown]; k < s->at[unknown + 1]; k++)
        s->values[k] = 0;
    s->values[s->at[unknown + 1] - 1] = 1;
    s->u[unknown] = 0;
}

/* Pulls both ends, and holds what only the whole could do. */
static inline void crack_load(crack_system *s)
{
    int cells = s->plate->cells, top = s->rows * (cells + 1);
    for (int i = 0; i <= cells; i++) {
        double pull = s->size[0] * (i == 0 || i == cells ? 0.5 : 1);
        s->u[s->first[i] + 1] -= pull;
        s->u[s->first[top + i] + 1] += pull;
    }
    crack_hold(s, s->first[cells]);
    crack_hold(s, s->first[cells] + 1);
    crack_hold(s, s->first[top + cells]);
}

/* Solves by Cholesky within the envelope; returns the loads' work. 0 < it. */
static inline double crack_work(crack_system *s)
{
    int count = s->first[s->node_count];
    double work = 0;
    for (int i = 0; i < count; i++) {
        double *row = s->values + s->at[i] - s->start[i];
        for (int j = s->start[i]; j <= i; j++) {
            const double *other = s->values + s->at[j] - s->start[j];
            double sum = row[j];
            for (int k = s->start[i] > s->start[j] ? s->start[i] : s->start[j]; k < j; k++)
                sum -= row[k] * other[k];
            row[j] = j < i ? sum / other[j] : sqrt(sum);
        }
        for (int k = s->start[i]; k < i; k++)
            s->u[i] -= row[k] * s->u[k];
        s->u[i] /= row[i];
        work += s->u[i] * s->u[i]; /* f.u = y.y of L y = f */
    }
    return work;
}

static inline void crack_free(crack_system *s)
{
    free(s->jumps);
    free(s->tips);
    free(s->first);
    free(s->start);
    free(s->at);
    free(s->values);
    free(s->u);
}

/* The energy that the crack adds; 0: no memory. */
static inline int crack_plane_solve(const crack_plane *plate, crack_plane_result *found)
{
    crack_system s;
    int done, by_hand = plate->kind == CRACK_BY_HAND;
    memset(&s, 0, sizeof s);
    s.plate = plate;
    s.rows = by_hand ? 2 * plate->cells : 2 * plate->cells + 1;
    s.size[0] = 1.0 / plate->cells;
    s.size[1] = crack_height / s.rows;
    s.node_count = (plate->cells + 1) * (s.rows + 1);
    while (by_hand && (s.node_count - (plate->cells + 1) * (s.rows + 1)) * s.size[0] < plate->length - 1e-9)
        s.node_count++;
    s.jumps = (unsigned char *)calloc((size_t)s.node_count, 1);
    s.tips = (unsigned char *)calloc((size_t)s.node_count, 1);
    s.first = (int *)malloc((size_t)(s.node_count + 1) * sizeof *s.first);
    done = s.jumps && s.tips && s.first;
    if (done && !by_hand)
        crack_enrich(&s);
    done = done && crack_number(&s);
    for (int t = 0; done && t < crack_triangle_count(&s); t++)
        crack_add_triangle(&s, t);
    if (done) {
        crack_load(&s);
        found->nodes = s.node_count;
        found->unknowns = s.first[s.node_count];
        found->energy = crack_work(&s) / 2 - (1 - crack_poisson * crack_poisson) * crack_height / 2;
    }
    crack_free(&s);
    return done;
}

#endif
