/* crack_plane: the energy of a crack by X-FEM with and without branch functions, for cut_study. Needs libc and libm
 * only.
 *
 *     crack_plane plate = {CRACK_BRANCH, 21, 0.5, 0.1, 0};
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
 *     embedded    triangles with branch functions stand apart: each has nodes and the four functions, less their
 *                 values at its nodes, of its own, where the crack parts it jumps, too. What is discontinuous over
 *                 their edges, [[u]], adds to the gradients of both triangles (a discontinuous Galerkin derivative,
 *                 8.3) and costs beta (lambda + 2 mu)/2h [[u]]^2; no other triangle has any branch function
 *
 * Triangles are integrated on both sides of the crack's line apart, those with branch functions over finer ones, the
 * finest at the tip. */
#ifndef CRACK_PLANE_H
#define CRACK_PLANE_H

#include "envelope.h"

typedef enum crack_kind { CRACK_BY_HAND = 0, CRACK_HEAVISIDE = 1, CRACK_BRANCH = 2, CRACK_EMBEDDED = 3 } crack_kind;

typedef struct crack_plane {
    crack_kind kind;
    int cells;     /* across */
    double length; /* of the crack, in (0, 1) */
    double reach;  /* of branch functions from the tip */
    double beta;   /* > 0: what jumps over edges of embedded triangles cost */
} crack_plane;

typedef struct crack_plane_result {
    double energy; /* elastic, that the crack adds to the whole plate's */
    int nodes, unknowns;
} crack_plane_result;

/* Of a triangle: functions of its own, of its neighbours besides; fields that gradients are lifted to. */
enum { CRACK_OWN = 3 * 5, CRACK_FUNCTIONS = 4 * CRACK_OWN, CRACK_FIELDS = 8 };
static const double crack_height = 2, crack_poisson = 0.3;

typedef struct crack_system {
    const crack_plane *plate;
    int rows, node_count;        /* of rectangles; nodes, (cells + 1) to a row, then the doubled ones */
    double size[2];              /* of a rectangle */
    unsigned char *jumps, *tips; /* [node_count] 1: has a jump, has branch functions */
    unsigned char *held;         /* [node_count] 1: is a node of a triangle that is not embedded */
    int *first;                  /* [node_count] unknown of a node, its displacement first */
    int *embedded;               /* [triangles] the first unknown of one that stands apart, else -1 */
    int unknowns;
    envelope k;
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

/* Does the crack part the triangle, does it end in it? 0: neither. */
typedef enum crack_passage { CRACK_PASSES_BY = 0, CRACK_ENDS = 1, CRACK_PARTS = 2 } crack_passage;

static inline crack_passage crack_passes(const crack_system *s, const int nodes[3])
{
    double between[2];
    if (!crack_crosses(s, nodes, between) || between[0] > s->plate->length + 1e-9)
        return CRACK_PASSES_BY;
    return between[1] < s->plate->length + 1e-9 ? CRACK_PARTS : CRACK_ENDS;
}

/* Is the tip in a triangle, or on its edge? */
static inline int crack_has_tip(const crack_system *s, const int nodes[3])
{
    double between[2], tip = s->plate->length;
    return crack_crosses(s, nodes, between) && between[0] < tip + 1e-9 && between[1] > tip - 1e-9;
}

static inline int crack_is_near(const crack_system *s, int node)
{
    double x[2];
    crack_place(s, node, x);
    return hypot(x[0] - s->plate->length, x[1] - crack_height / 2) < s->plate->reach;
}

/* Marks nodes of triangles that are cut through, but not those of the edge where the crack stops; then those with
 * branch functions, which have no jump besides. */
static inline void crack_enrich(crack_system *s)
{
    const int of_branch = s->plate->kind == CRACK_BRANCH;
    for (int round = 0; round < 2; round++)
        for (int t = 0; t < crack_triangle_count(s); t++) {
            int nodes[3], parts;
            double between[2];
            crack_triangle(s, t, nodes);
            if (!crack_crosses(s, nodes, between))
                continue;
            parts = crack_passes(s, nodes) == CRACK_PARTS;
            for (int a = 0; a < 3; a++) {
                if (parts == !round)
                    s->jumps[nodes[a]] = (unsigned char)parts;
                if (of_branch && crack_has_tip(s, nodes))
                    s->tips[nodes[a]] = 1;
            }
        }
    for (int i = 0; i < s->node_count && of_branch; i++) {
        s->tips[i] = (unsigned char)(s->tips[i] || crack_is_near(s, i));
        s->jumps[i] = (unsigned char)(s->jumps[i] && !s->tips[i]);
    }
}

/* Marks the triangles that stand apart, and the jumps of those that do not: over edges to the former nothing has to be
 * continuous, so that a jump may end there. */
static inline void crack_embed(crack_system *s)
{
    for (int t = 0; t < crack_triangle_count(s); t++) {
        int nodes[3], near = 1;
        crack_triangle(s, t, nodes);
        for (int a = 0; a < 3; a++)
            near = near && crack_is_near(s, nodes[a]);
        if (near || crack_has_tip(s, nodes)) {
            s->embedded[t] = 0;
            continue;
        }
        for (int a = 0; a < 3; a++) {
            s->held[nodes[a]] = 1;
            s->jumps[nodes[a]] |= crack_passes(s, nodes) == CRACK_PARTS;
        }
    }
}

/* The triangle over the edge from corner a to the next, or -1. */
static inline int crack_neighbour(const crack_system *s, int triangle, int a)
{
    static const int rows[2][3] = {{-1, 0, 0}, {0, 1, 0}}, columns[2][3] = {{0, 1, 0}, {0, 0, -1}};
    int cell = triangle / 2, upper = triangle % 2, row = cell / s->plate->cells + rows[upper][a];
    int column = cell % s->plate->cells + columns[upper][a];
    if (row < 0 || row >= s->rows || column < 0 || column >= s->plate->cells)
        return -1;
    return 2 * (row * s->plate->cells + column) + !upper;
}

/* ---- functions --------------------------------------------------------------------------------------------------- */

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

/* A triangle and its functions: its own, then those of the triangles over open edges. */
typedef struct crack_element {
    int triangle, nodes[3];
    double x[3][2], g[3][2], area; /* g: gradients of the linear functions */
    int apart, parted;             /* embedded; cut through by the crack */
    int own, count, unknowns[CRACK_FUNCTIONS];
    int fields;                                 /* that jumps over edges are lifted to; 0: no edge is open */
    double lift[CRACK_FIELDS][CRACK_FUNCTIONS]; /* how much of each a function has */
} crack_element;

/* The branch functions, and their slopes, at a place that is dx before the tip and dy above it. */
static inline void crack_branch(double dx, double dy, double f[4], double slope[4][2])
{
    double r = hypot(dx, dy), t = atan2(dy, dx);
    double root = sqrt(r), sine = sin(t / 2), cosine = cos(t / 2), c = cos(t), d = sin(t);
    double along[4] = {cosine / 2, -sine / 2, cosine * d / 2 + sine * c, -sine * d / 2 + cosine * c};
    f[0] = root * sine, f[1] = root * cosine, f[2] = root * sine * d, f[3] = root * cosine * d;
    for (int k = 0; k < 4; k++) {
        double out = f[k] / (2 * r), round = along[k] / root;
        slope[k][0] = out * c - round * d;
        slope[k][1] = out * d + round * c;
    }
}

static inline int crack_has_jump(const crack_system *s, const crack_element *e, int a)
{
    if (s->plate->kind == CRACK_EMBEDDED && !e->parted)
        return 0;
    return e->apart || s->jumps[e->nodes[a]];
}

/* The unknowns of the triangle's own functions. */
static inline void crack_list_own(const crack_system *s, crack_element *e)
{
    int of = s->embedded[e->triangle], count = 0;
    for (int a = 0; a < 3; a++) {
        int at = e->apart ? of : s->first[e->nodes[a]], jump = crack_has_jump(s, e, a);
        e->unknowns[count++] = at;
        if (jump)
            e->unknowns[count++] = at + 2;
        for (int k = 0; k < 4 && !e->apart && s->tips[e->nodes[a]]; k++)
            e->unknowns[count++] = at + 2 + 2 * k;
        of += 2 + 2 * jump;
    }
    for (int k = 0; k < 4 && e->apart; k++)
        e->unknowns[count++] = of + 2 * k;
    e->own = e->count = count;
}

static inline void crack_element_make(const crack_system *s, int triangle, crack_element *e)
{
    e->triangle = triangle;
    crack_triangle(s, triangle, e->nodes);
    for (int a = 0; a < 3; a++)
        crack_place(s, e->nodes[a], e->x[a]);
    e->area = crack_gradients(e->x, e->g);
    e->apart = s->embedded[triangle] >= 0;
    e->parted = s->plate->kind != CRACK_BY_HAND && crack_passes(s, e->nodes) == CRACK_PARTS;
    e->fields = 0;
    crack_list_own(s, e);
}

/* Values and slopes of the triangle's own functions at a place that is on the upper side of the crack's line, or not.
 */
static inline void crack_evaluate(const crack_system *s, const crack_element *e, const double x[2], int upper,
                                  double values[CRACK_OWN], double slopes[CRACK_OWN][2])
{
    double f[4], df[4][2], sum[4] = {0, 0, 0, 0}, slope[4][2] = {{0, 0}, {0, 0}, {0, 0}, {0, 0}};
    int count = 0, branched = e->apart;
    for (int a = 0; a < 3; a++)
        branched = branched || s->tips[e->nodes[a]];
    if (branched)
        crack_branch(x[0] - s->plate->length, x[1] - crack_height / 2, f, df);
    for (int a = 0; a < 3; a++) {
        const double *X = e->x[a];
        double n = 1 + e->g[a][0] * (x[0] - X[0]) + e->g[a][1] * (x[1] - X[1]), here[4], unused[4][2];
        values[count] = n;
        memcpy(slopes[count++], e->g[a], sizeof e->g[a]);
        if (crack_has_jump(s, e, a)) {
            double jump = upper - (X[1] > crack_height / 2);
            values[count] = jump * n;
            slopes[count][0] = jump * e->g[a][0];
            slopes[count++][1] = jump * e->g[a][1];
        }
        if (e->apart || s->tips[e->nodes[a]])
            crack_branch(X[0] - s->plate->length, X[1] - crack_height / 2, here, unused);
        for (int k = 0; k < 4 && e->apart; k++) {
            sum[k] += n * here[k];
            for (int axis = 0; axis < 2; axis++)
                slope[k][axis] += e->g[a][axis] * here[k];
        }
        for (int k = 0; k < 4 && !e->apart && s->tips[e->nodes[a]]; k++) {
            values[count] = n * (f[k] - here[k]);
            for (int axis = 0; axis < 2; axis++)
                slopes[count][axis] = e->g[a][axis] * (f[k] - here[k]) + n * df[k][axis];
            count++;
        }
    }
    for (int k = 0; k < 4 && e->apart; k++) {
        values[count] = f[k] - sum[k];
        for (int axis = 0; axis < 2; axis++)
            slopes[count][axis] = df[k][axis] - slope[k][axis];
        count++;
    }
}

/* ---- points ----------------------------------------------------------------------------------------------------- */

/* What a point of a triangle is used for. */
typedef void (*crack_at_point)(crack_system *s, crack_element *e, const double x[2], int upper, double area,
                               void *with);

/* A part of a triangle, whose corners have these weights, in n x n pieces by three points each. */
static inline void crack_for_part(crack_system *s, crack_element *e, double part[3][3], int n, crack_at_point use,
                                  void *with)
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
                    double at[2] = {0, 0};
                    for (int a = 0; a < 3; a++)
                        for (int axis = 0; axis < 2; axis++)
                            at[axis] += ((1 - u - v) * part[0][a] + u * part[1][a] + v * part[2][a]) * e->x[a][axis];
                    use(s, e, at, at[1] > crack_height / 2, e->area * share / (3.0 * n * n), with);
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

/* All points of a triangle. */
static inline void crack_for_points(crack_system *s, crack_element *e, crack_at_point use, void *with)
{
    enum { PLAIN = 1, BRANCHED = 6, AT_TIP = 16 };
    double between[2], parts[3][3][3] = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    int crossed = s->plate->kind != CRACK_BY_HAND && crack_crosses(s, e->nodes, between);
    int fine = e->apart ? BRANCHED : PLAIN;
    for (int a = 0; a < 3; a++)
        fine = s->tips[e->nodes[a]] ? BRANCHED : fine;
    if (fine == BRANCHED && crack_has_tip(s, e->nodes))
        fine = AT_TIP;
    if (crossed)
        crack_divide(e->x, parts);
    for (int k = 0; k < (crossed ? 3 : 1); k++)
        crack_for_part(s, e, parts[k], fine, use, with);
}

/* ---- edges over which nothing is continuous ------------------------------------------------------------------------
 */

/* Gradients are lifted to these: constants, on each side of the crack where it parts the triangle, and gradients of
 * the branch functions where they are, so that the derivative is consistent (Ten Eyck and Lew 2006). */
static inline int crack_fields(const crack_system *s, const crack_element *e, const double x[2], int upper,
                               double fields[CRACK_FIELDS][2])
{
    int count = 2;
    fields[0][0] = fields[1][1] = 1, fields[0][1] = fields[1][0] = 0;
    if (e->parted) {
        fields[2][0] = fields[3][1] = upper ? 1 : -1, fields[2][1] = fields[3][0] = 0;
        count = 4;
    }
    if (e->apart) {
        double unused[4];
        crack_branch(x[0] - s->plate->length, x[1] - crack_height / 2, unused, fields + count);
        count += 4;
    }
    return count;
}

/* Goes along an edge that a triangle shares with another, over both sides of the crack apart; what each point adds. */
typedef void (*crack_at_edge)(crack_system *s, crack_element *e, const crack_element *other, int from,
                              const double x[2], int upper, double length, void *with);

static inline void crack_for_edge(crack_system *s, crack_element *e, int a, const crack_element *other, int from,
                                  crack_at_edge use, void *with)
{
    enum { PIECES = 16, POINTS = 3 };
    static const double places[POINTS] = {0.112701665379258, 0.5, 0.887298334620742}, shares[POINTS] = {5, 8, 5};
    const double *p = e->x[a], *q = e->x[(a + 1) % 3];
    double below = p[1] - crack_height / 2, above = q[1] - crack_height / 2, length = hypot(q[0] - p[0], q[1] - p[1]);
    double ends[3] = {0, below * above < 0 ? below / (below - above) : 1, 1};
    for (int part = 0; part < 2 && ends[part] < 1; part++)
        for (int i = 0; i < PIECES; i++)
            for (int k = 0; k < POINTS; k++) {
                double t = ends[part] + (ends[part + 1] - ends[part]) * (i + places[k]) / (int)PIECES;
                double x[2] = {p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])};
                double share = (ends[part + 1] - ends[part]) * shares[k] / (18.0 * (int)PIECES);
                use(s, e, other, from, x, x[1] > crack_height / 2, share * length, with);
            }
}

/* What jumps at a place of an edge: functions of the triangle, then those of the other. */
static inline void crack_jumps(const crack_system *s, const crack_element *e, const crack_element *other,
                               const double x[2], int upper, double jumps[2 * CRACK_OWN])
{
    double unused[CRACK_OWN][2];
    crack_evaluate(s, e, x, upper, jumps, unused);
    crack_evaluate(s, other, x, upper, jumps + e->own, unused);
    for (int i = 0; i < other->own; i++)
        jumps[e->own + i] *= -1;
}

typedef struct crack_edge {
    double normal[2]; /* out of the triangle */
    double stiffness; /* of what jumps, for each length of the edge */
} crack_edge;

/* Half of what jumps, along the normal, against each field. */
static inline void crack_lift_point(crack_system *s, crack_element *e, const crack_element *other, int from,
                                    const double x[2], int upper, double length, void *with)
{
    const crack_edge *edge = (const crack_edge *)with;
    double fields[CRACK_FIELDS][2], jumps[2 * CRACK_OWN];
    int count = crack_fields(s, e, x, upper, fields);
    crack_jumps(s, e, other, x, upper, jumps);
    for (int k = 0; k < count; k++) {
        double along = fields[k][0] * edge->normal[0] + fields[k][1] * edge->normal[1];
        for (int i = 0; i < e->own + other->own; i++)
            e->lift[k][i < e->own ? i : from + i - e->own] -= 0.5 * length * along * jumps[i];
    }
}

/* What jumps costs. */
static inline void crack_penalty_point(crack_system *s, crack_element *e, const crack_element *other, int from,
                                       const double x[2], int upper, double length, void *with)
{
    const crack_edge *edge = (const crack_edge *)with;
    double jumps[2 * CRACK_OWN];
    int count = e->own + other->own;
    crack_jumps(s, e, other, x, upper, jumps);
    for (int i = 0; i < count; i++)
        for (int j = 0; j < count; j++)
            for (int axis = 0; axis < 2; axis++)
                envelope_add(&s->k, e->unknowns[i < e->own ? i : from + i - e->own] + axis,
                             e->unknowns[j < e->own ? j : from + j - e->own] + axis,
                             edge->stiffness * length * jumps[i] * jumps[j]);
}

/* Products of the fields, in the first columns of a matrix. */
static inline void crack_mass_point(crack_system *s, crack_element *e, const double x[2], int upper, double area,
                                    void *with)
{
    double(*mass)[CRACK_FIELDS] = (double(*)[CRACK_FIELDS])with, fields[CRACK_FIELDS][2];
    int count = crack_fields(s, e, x, upper, fields);
    for (int k = 0; k < count; k++)
        for (int l = 0; l < count; l++)
            mass[k][l] += area * (fields[k][0] * fields[l][0] + fields[k][1] * fields[l][1]);
}

/* Divides the right sides by the fields' products, by elimination. */
static inline void crack_divide_by_mass(crack_system *s, crack_element *e)
{
    double mass[CRACK_FIELDS][CRACK_FIELDS];
    memset(mass, 0, sizeof mass);
    crack_for_points(s, e, crack_mass_point, mass);
    for (int k = 0; k < e->fields; k++)
        for (int i = k + 1; i < e->fields; i++) {
            double factor = mass[i][k] / mass[k][k];
            for (int j = k; j < e->fields; j++)
                mass[i][j] -= factor * mass[k][j];
            for (int j = 0; j < e->count; j++)
                e->lift[i][j] -= factor * e->lift[k][j];
        }
    for (int k = e->fields - 1; k >= 0; k--)
        for (int j = 0; j < e->count; j++) {
            for (int l = k + 1; l < e->fields; l++)
                e->lift[k][j] -= mass[k][l] * e->lift[l][j];
            e->lift[k][j] /= mass[k][k];
        }
}

/* Is the edge from corner a open, and to which triangle? */
static inline int crack_is_open(const crack_system *s, int triangle, int a, int *over)
{
    *over = crack_neighbour(s, triangle, a);
    return *over >= 0 && (s->embedded[triangle] >= 0 || s->embedded[*over] >= 0);
}

/* Adds functions of triangles over open edges. */
static inline void crack_list_others(const crack_system *s, crack_element *e)
{
    int over;
    for (int a = 0; a < 3; a++)
        if (crack_is_open(s, e->triangle, a, &over)) {
            crack_element other;
            crack_element_make(s, over, &other);
            memcpy(e->unknowns + e->count, other.unknowns, (size_t)other.own * sizeof(int));
            e->count += other.own;
        }
}

/* Lifts what jumps over open edges, and adds what it costs. */
static inline void crack_open_edges(crack_system *s, crack_element *e)
{
    const double mu = 1 / (2 * (1 + crack_poisson));
    const double lambda = crack_poisson / ((1 + crack_poisson) * (1 - 2 * crack_poisson));
    int from = e->own, over;
    double fields[CRACK_FIELDS][2];
    memset(e->lift, 0, sizeof e->lift);
    for (int a = 0; a < 3; a++)
        if (crack_is_open(s, e->triangle, a, &over)) {
            const double *p = e->x[a], *q = e->x[(a + 1) % 3];
            double length = hypot(q[0] - p[0], q[1] - p[1]);
            crack_element other;
            crack_edge edge;
            crack_element_make(s, over, &other);
            edge.normal[0] = (q[1] - p[1]) / length;
            edge.normal[1] = (p[0] - q[0]) / length;
            edge.stiffness = s->plate->beta * (lambda + 2 * mu) * length / (0.5 * (e->area + other.area));
            e->fields = crack_fields(s, e, p, 0, fields);
            crack_for_edge(s, e, a, &other, from, crack_lift_point, &edge);
            if (e->triangle < over)
                crack_for_edge(s, e, a, &other, from, crack_penalty_point, &edge);
            from += other.own;
        }
    if (e->fields > 0)
        crack_divide_by_mass(s, e);
}

/* ---- the stiffness ---------------------------------------------------------------------------------------------- */

/* Adds what `area` about a place contributes. */
static inline void crack_add_point(crack_system *s, crack_element *e, const double x[2], int upper, double area,
                                   void *with)
{
    const double mu = 1 / (2 * (1 + crack_poisson));
    const double lambda = crack_poisson / ((1 + crack_poisson) * (1 - 2 * crack_poisson));
    double values[CRACK_OWN], slopes[CRACK_FUNCTIONS][2], fields[CRACK_FIELDS][2];
    (void)with;
    memset(slopes, 0, sizeof slopes);
    crack_evaluate(s, e, x, upper, values, slopes);
    if (e->fields > 0)
        crack_fields(s, e, x, upper, fields);
    for (int k = 0; k < e->fields; k++)
        for (int i = 0; i < e->count; i++)
            for (int axis = 0; axis < 2; axis++)
                slopes[i][axis] += e->lift[k][i] * fields[k][axis];
    for (int p = 0; p < e->count; p++)
        for (int q = 0; q < e->count; q++) {
            const double *a = slopes[p], *b = slopes[q];
            double both = a[0] * b[0] + a[1] * b[1];
            for (int i = 0; i < 2; i++)
                for (int j = 0; j < 2; j++)
                    envelope_add(&s->k, e->unknowns[p] + i, e->unknowns[q] + j,
                                 area * (lambda * a[i] * b[j] + mu * a[j] * b[i] + (i == j ? mu * both : 0)));
        }
}

static inline void crack_add_triangle(crack_system *s, int triangle)
{
    crack_element e;
    crack_element_make(s, triangle, &e);
    crack_list_others(s, &e);
    crack_open_edges(s, &e);
    crack_for_points(s, &e, crack_add_point, NULL);
}

/* ---- the system ------------------------------------------------------------------------------------------------- */

/* Numbers the unknowns, row of nodes by row of nodes, each with the triangles above it that stand apart. */
static inline void crack_number(crack_system *s)
{
    int in_row = s->plate->cells + 1, in_cells = 2 * s->plate->cells, count = 0;
    for (int j = 0; j <= s->rows; j++) {
        for (int copy = 0; copy < (j == s->rows / 2 ? 2 : 1); copy++)
            for (int i = 0; i < in_row; i++) {
                int node = copy ? in_row * (s->rows + 1) + i : j * in_row + i;
                if (node >= s->node_count)
                    break;
                s->first[node] = count;
                count += s->held[node] ? 2 + 2 * s->jumps[node] + 8 * s->tips[node] : 0;
            }
        for (int t = j * in_cells; t < (j + 1) * in_cells && j < s->rows; t++)
            if (s->embedded[t] >= 0) {
                int nodes[3];
                crack_triangle(s, t, nodes);
                s->embedded[t] = count;
                count += 6 + 6 * (crack_passes(s, nodes) == CRACK_PARTS) + 8;
            }
    }
    s->unknowns = count;
}

/* Makes room for the matrix. 0: no memory. */
static inline int crack_reserve(crack_system *s)
{
    if (!envelope_begin(&s->k, s->unknowns))
        return 0;
    for (int t = 0; t < crack_triangle_count(s); t++) {
        crack_element e;
        int least = s->unknowns;
        crack_element_make(s, t, &e);
        crack_list_others(s, &e);
        for (int i = 0; i < e.count; i++)
            least = e.unknowns[i] < least ? e.unknowns[i] : least;
        for (int i = 0; i < 2 * e.count; i++)
            envelope_reach(&s->k, e.unknowns[i / 2] + i % 2, least);
    }
    return envelope_reserve(&s->k);
}

/* The pull at both ends: of each node of a row, which has another at the other end. */
static inline double crack_pull(const crack_system *s, int i)
{
    return s->size[0] * (i == 0 || i == s->plate->cells ? 0.5 : 1);
}

/* Pulls both ends, and holds what only the whole could do. */
static inline void crack_load(crack_system *s)
{
    int cells = s->plate->cells, top = s->rows * (cells + 1);
    for (int i = 0; i <= cells; i++) {
        s->k.u[s->first[i] + 1] -= crack_pull(s, i);
        s->k.u[s->first[top + i] + 1] += crack_pull(s, i);
    }
    envelope_hold(&s->k, s->first[cells], 0);
    envelope_hold(&s->k, s->first[cells] + 1, 0);
    envelope_hold(&s->k, s->first[top + cells], 0);
}

/* The work that the loads would do. */
static inline double crack_work(const crack_system *s)
{
    int cells = s->plate->cells, top = s->rows * (cells + 1);
    double work = 0;
    for (int i = 0; i <= cells; i++)
        work += crack_pull(s, i) * (s->k.u[s->first[top + i] + 1] - s->k.u[s->first[i] + 1]);
    return work;
}

static inline void crack_free(crack_system *s)
{
    free(s->jumps);
    free(s->tips);
    free(s->held);
    free(s->first);
    free(s->embedded);
    envelope_free(&s->k);
}

/* The energy that the crack adds; 0: no memory, or not positive definite. */
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
    s.held = (unsigned char *)calloc((size_t)s.node_count, 1);
    s.first = (int *)malloc((size_t)s.node_count * sizeof *s.first);
    s.embedded = (int *)malloc((size_t)crack_triangle_count(&s) * sizeof *s.embedded);
    done = s.jumps && s.tips && s.held && s.first && s.embedded;
    if (done) {
        memset(s.held, plate->kind != CRACK_EMBEDDED, (size_t)s.node_count);
        memset(s.embedded, -1, (size_t)crack_triangle_count(&s) * sizeof *s.embedded);
        if (plate->kind == CRACK_EMBEDDED)
            crack_embed(&s);
        else if (!by_hand)
            crack_enrich(&s);
        crack_number(&s);
        done = crack_reserve(&s);
    }
    for (int t = 0; done && t < crack_triangle_count(&s); t++)
        crack_add_triangle(&s, t);
    if (done) {
        crack_load(&s);
        done = envelope_solve(&s.k);
    }
    if (done) {
        found->nodes = s.node_count;
        found->unknowns = s.unknowns;
        found->energy = crack_work(&s) / 2 - (1 - crack_poisson * crack_poisson) * crack_height / 2;
    }
    crack_free(&s);
    return done;
}

#endif
