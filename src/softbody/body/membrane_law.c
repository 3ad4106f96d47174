/* membrane_law: what one membrane does at a shape of the body: energy, forces, stiffness. */
#include "membrane_law.h"

#include <math.h>
#include <string.h>

#include "../fem/piece.h"

SBI_API sb_result sbi_membrane_check_law(const sbi_membrane_law *law, sb_error *error)
{
    if (!sb_is_finite(law->thickness) || !sb_is_finite(law->shear) || !sb_is_finite(law->prestretch))
        return sbi_fail(error, SB_ERROR_NOT_FINITE,
                        "thickness, shear modulus or prestretch of a membrane is not finite");
    if (!(law->thickness > 0) || law->shear < 0 || !(law->prestretch > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a membrane has thickness %g, shear modulus %g, prestretch %g",
                        (double)law->thickness, (double)law->shear, (double)law->prestretch);
    return SB_OK;
}

/* What it is made of on the way from the last static solve to now. */
static sbi_membrane_law sbi_membrane_law_at(const sbi_load *load, sb_real factor)
{
    const sbi_membrane_law *from = &load->balanced_membrane;
    sbi_membrane_law law = load->membrane;
    if (factor == 1)
        return law;
    law.thickness = from->thickness + factor * (law.thickness - from->thickness);
    law.shear = from->shear + factor * (law.shear - from->shear);
    law.prestretch = from->prestretch + factor * (law.prestretch - from->prestretch);
    return law;
}

/* ---- points ---- */

/* Shape functions' derivatives at the points of a face type, all that a sheet needs of them. */
typedef struct sbi_membrane_rule {
    sb_element_type type; /* SB_NO_ELEMENT: none yet */
    int count, nodes;
    sb_real weights[SB_MAX_QUADRATURE_POINTS];
    sb_real gradient[SB_MAX_QUADRATURE_POINTS][SB_MAX_FACE_NODES][3];
} sbi_membrane_rule;

/* Strains of tri3 are constant and those of tri6 linear: fewer points than pressures need. */
static void sbi_membrane_need_rule(sb_element_type type, sbi_membrane_rule *rule)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3] = {{(sb_real)1 / 3, (sb_real)1 / 3, 0}}, shape[SB_MAX_FACE_NODES];
    if (rule->type == type)
        return;
    rule->type = type;
    rule->nodes = sb_element_node_count(type);
    rule->count = 1;
    rule->weights[0] = (sb_real)0.5;
    if (type != SB_TRI3)
        rule->count =
            sb_element_quadrature(type == SB_TRI6 ? SB_TRI3 : type, SB_QUADRATURE_FACE, points, rule->weights);
    for (int p = 0; p < rule->count; p++)
        sb_element_shape(type, points[p], shape, rule->gradient[p]);
}

/* The rule of a face of a load: of the part of it that is material. */
static void sbi_membrane_need_face_rule(const sbi_load *load, int face, sbi_membrane_rule *rule)
{
    const sb_real *loads = load->weights + load->row_start[face];
    const int nodes = load->row_start[face + 1] - load->row_start[face];
    sb_real points[3][3], shape[SB_MAX_FACE_NODES];
    if (!load->has_parts || sbi_piece_is_whole_face(loads, nodes)) {
        sbi_membrane_need_rule(load->face_types[face], rule);
        return;
    }
    rule->type = SB_NO_ELEMENT; /* good for this part only */
    rule->nodes = nodes;
    rule->count = sbi_piece_face_points(loads, nodes, points, rule->weights);
    for (int p = 0; p < rule->count; p++)
        sb_element_shape(load->face_types[face], points[p], shape, rule->gradient[p]);
}

/* The middle of a face as the only point of what of it is material. */
static void sbi_membrane_make_middle(const sbi_load *load, int face, sbi_membrane_rule *rule)
{
    const sb_element_type type = load->face_types[face];
    const sb_real third = sb_element_corner_count(type) == 3 ? (sb_real)1 / 3 : 0, middle[3] = {third, third, 0};
    sb_real shape[SB_MAX_FACE_NODES];
    rule->type = SB_NO_ELEMENT;
    rule->nodes = sb_element_node_count(type);
    rule->count = 1;
    rule->weights[0] = load->has_parts ? sbi_piece_face_share(load->weights + load->row_start[face], rule->nodes) : 1;
    sb_element_shape(type, middle, shape, rule->gradient[0]);
}

/* A point of a sheet at some shape. */
typedef struct sbi_membrane_point {
    int count;
    const int *nodes;
    sb_real volume;                         /* of the sheet at its own rest (m^3) */
    sb_real gradient[SB_MAX_FACE_NODES][2]; /* of shape functions in its plane, per length of the sheet at rest (1/m) */
    sb_vec3 f[2];                           /* F e_1, F e_2 */
    sb_real strain[3];                      /* C - 1: 11, 22, 12 */
} sbi_membrane_point;

/* Gradients and axes of the plane at rest; 0: it has no area. */
static int sbi_membrane_rest(const sb_body *body, const sb_real (*by)[3], sbi_membrane_point *point, sb_vec3 axes[2],
                             sb_real *area)
{
    sb_vec3 r = sb_v3(0, 0, 0), s = r, across;
    sb_real length, shear, height;
    for (int a = 0; a < point->count; a++) {
        sb_vec3 x = sb_v3_sub(body->reference[point->nodes[a]], body->reference[point->nodes[0]]);
        r = sb_v3_madd(r, by[a][0], x);
        s = sb_v3_madd(s, by[a][1], x);
    }
    length = sb_v3_norm(r);
    axes[0] = sb_v3_scale(length > 0 ? 1 / length : 0, r);
    shear = sb_v3_dot(s, axes[0]);
    across = sb_v3_madd(s, -shear, axes[0]);
    height = sb_v3_norm(across);
    axes[1] = sb_v3_scale(height > 0 ? 1 / height : 0, across);
    *area = length * height;
    if (!(*area > 0))
        return 0;
    for (int a = 0; a < point->count; a++) {
        point->gradient[a][0] = by[a][0] / length;
        point->gradient[a][1] = (by[a][1] - point->gradient[a][0] * shear) / height;
    }
    return 1;
}

/* sum v_a g_a,j over the nodes of the point */
static sb_vec3 sbi_membrane_slope(const sbi_membrane_point *point, const sb_vec3 *v, int j)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < point->count; a++)
        sum = sb_v3_madd(sum, point->gradient[a][j], v[point->nodes[a]]);
    return sum;
}

/* Point p of a face at u; 0: nothing of the sheet is there. */
static int sbi_membrane_lay(const sb_body *body, const sbi_load *load, int face, const sbi_membrane_rule *rule, int p,
                            const sbi_membrane_law *law, const sb_vec3 *u, sbi_membrane_point *point)
{
    const sb_real s = law->prestretch, more = (s - 1) * (s + 1);
    sb_real area;
    sb_vec3 axes[2], turn[2];
    point->count = rule->nodes;
    point->nodes = load->nodes + load->row_start[face];
    if (!(rule->weights[p] > 0) || !sbi_membrane_rest(body, rule->gradient[p], point, axes, &area))
        return 0;
    point->volume = law->thickness * area * rule->weights[p] / (s * s);
    for (int j = 0; j < 2; j++) {
        turn[j] = sbi_membrane_slope(point, u, j);
        point->f[j] = sb_v3_scale(s, sb_v3_add(axes[j], turn[j]));
    }
    for (int j = 0; j < 2; j++)
        point->strain[j] = s * s * (2 * sb_v3_dot(axes[j], turn[j]) + sb_v3_dot(turn[j], turn[j])) + more;
    point->strain[2] =
        s * s * (sb_v3_dot(axes[0], turn[1]) + sb_v3_dot(axes[1], turn[0]) + sb_v3_dot(turn[0], turn[1]));
    for (int a = 0; a < point->count; a++)
        for (int j = 0; j < 2; j++)
            point->gradient[a][j] *= s;
    return 1;
}

/* ---- the law of a point ---- */

/* What C - 1 has as principal values, x >= z, and where. */
typedef struct sbi_membrane_axes {
    sb_real x, z, n[2];
} sbi_membrane_axes;

static sbi_membrane_axes sbi_membrane_principal(const sb_real e[3])
{
    sbi_membrane_axes at;
    sb_real mean = (e[0] + e[1]) / 2, half = (e[0] - e[1]) / 2, radius = sb_sqrt(half * half + e[2] * e[2]), size;
    at.x = mean + radius;
    at.z = mean - radius;
    at.n[0] = half >= 0 ? half + radius : sb_abs(e[2]); /* the longer of two columns of C - C2 */
    at.n[1] = half >= 0 ? e[2] : (e[2] < 0 ? half - radius : radius - half);
    size = sb_sqrt(at.n[0] * at.n[0] + at.n[1] * at.n[1]);
    if (!(size > 0)) {
        at.n[0] = size = 1;
        at.n[1] = 0;
    }
    at.n[0] /= size;
    at.n[1] /= size;
    return at;
}

static sb_membrane_form sbi_membrane_form_of(const sbi_membrane_law *law, const sbi_membrane_axes *at)
{
    sb_real x = at->x, z = at->z;
    if (!law->wrinkles || x + 2 * z + z * z + 2 * x * z + x * z * z > 0) /* C1 C2^2 > 1 */
        return SB_MEMBRANE_TAUT;
    return x > 0 ? SB_MEMBRANE_WRINKLED : SB_MEMBRANE_SLACK;
}

/* 1 - C1^-3/2 of C1 = 1 + x, and (C1 + 2 C1^-1/2 - 3) / 2. */
static sb_real sbi_membrane_pull(sb_real x, sb_real *energy)
{
    sb_real stretch = sb_sqrt(1 + x), y = x / (stretch + 1);
    *energy = y * y * (y + 3) / (2 * stretch);
    return y * (stretch * stretch + stretch + 1) / (stretch * stretch * stretch);
}

/* Energy per volume and S (11, 22, 12), both over mu. */
static sb_real sbi_membrane_stress(sb_membrane_form form, const sbi_membrane_axes *at, const sb_real e[3], sb_real s[3])
{
    sb_real trace = e[0] + e[1], det = e[0] * e[1] - e[2] * e[2], d = trace + det, square = (1 + d) * (1 + d),
            energy = 0;
    s[0] = s[1] = s[2] = 0;
    if (form == SB_MEMBRANE_TAUT) {
        sb_real even = trace + 2 * det + d * d; /* 2 d + d^2 - trace */
        s[0] = (even + e[0]) / square;
        s[1] = (even + e[1]) / square;
        s[2] = e[2] / square;
        return (trace * d - det) / (2 * (1 + d));
    }
    if (form == SB_MEMBRANE_WRINKLED) {
        sb_real pull = sbi_membrane_pull(at->x, &energy);
        s[0] = pull * at->n[0] * at->n[0];
        s[1] = pull * at->n[1] * at->n[1];
        s[2] = pull * at->n[0] * at->n[1];
    }
    return energy;
}

/* D of a taut sheet over mu, for strains 11, 22, 2 x 12. */
static void sbi_membrane_taut_moduli(const sb_real e[3], sb_real d[3][3])
{
    const sb_real det = (1 + e[0]) * (1 + e[1]) - e[2] * e[2];
    const sb_real i[3] = {(1 + e[1]) / det, (1 + e[0]) / det, -e[2] / det}, scale = 2 / det;
    d[0][0] = scale * 2 * i[0] * i[0];
    d[1][1] = scale * 2 * i[1] * i[1];
    d[0][1] = d[1][0] = scale * (i[2] * i[2] + i[0] * i[1]);
    d[0][2] = d[2][0] = scale * 2 * i[0] * i[2];
    d[1][2] = d[2][1] = scale * 2 * i[1] * i[2];
    d[2][2] = scale * ((i[0] * i[1] + i[2] * i[2]) / 2 + i[2] * i[2]);
}

static void sbi_membrane_wrinkled_moduli(const sbi_membrane_axes *at, sb_real d[3][3])
{
    const sb_real c = 1 + at->x, n0 = at->n[0], n1 = at->n[1];
    const sb_real back = 0 - n1; /* and not -n1: sums only, no - and + in turn, which gcc 12 fuses */
    const sb_real along[3] = {n0 * n0, n1 * n1, n0 * n1}, across[3] = {n0 * back, n0 * n1, (n0 * n0 - n1 * n1) / 2};
    sb_real energy, rate = 3 / (c * c * sb_sqrt(c)), turn = 4 * sbi_membrane_pull(at->x, &energy) / (at->x - at->z);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            d[i][j] = rate * along[i] * along[j] + turn * across[i] * across[j];
}

/* The law of a point at its strain. */
typedef struct sbi_membrane_answer {
    sb_membrane_form form;
    sb_real energy;  /* per volume */
    sb_real s[3];    /* S */
    sb_real pull[3]; /* what of S is in the stiffness */
    sb_real d[3][3];
} sbi_membrane_answer;

/* The positive part of a symmetric 2 x 2 matrix (11, 22, 12). */
static void sbi_membrane_positive(const sb_real s[3], sb_real out[3])
{
    sbi_membrane_axes at = sbi_membrane_principal(s);
    sb_real high = sb_max(at.x, 0), low = sb_max(at.z, 0), n0 = at.n[0], n1 = at.n[1];
    out[0] = high * n0 * n0 + low * n1 * n1;
    out[1] = high * n1 * n1 + low * n0 * n0;
    out[2] = (high - low) * n0 * n1;
}

static sbi_membrane_answer sbi_membrane_ask(const sbi_membrane_law *law, const sbi_membrane_point *point, int exact)
{
    const sb_real rank = (sb_real)1e-4; /* of what is slack across */
    sbi_membrane_axes at = sbi_membrane_principal(point->strain);
    sbi_membrane_answer answer;
    memset(&answer, 0, sizeof answer);
    answer.form = sbi_membrane_form_of(law, &at);
    answer.energy = law->shear * sbi_membrane_stress(answer.form, &at, point->strain, answer.s);
    if (answer.form == SB_MEMBRANE_TAUT)
        sbi_membrane_taut_moduli(point->strain, answer.d);
    else if (answer.form == SB_MEMBRANE_WRINKLED)
        sbi_membrane_wrinkled_moduli(&at, answer.d);
    memcpy(answer.pull, answer.s, sizeof answer.s);
    if (!exact && answer.form == SB_MEMBRANE_TAUT)
        sbi_membrane_positive(answer.s, answer.pull);
    for (int i = 0; i < 2 && !exact && answer.form != SB_MEMBRANE_TAUT; i++)
        answer.pull[i] += rank;
    for (int i = 0; i < 3; i++) {
        answer.s[i] *= law->shear;
        answer.pull[i] *= law->shear;
        for (int j = 0; j < 3; j++)
            answer.d[i][j] *= law->shear;
    }
    return answer;
}

/* B_a: what a move of node a does to the strains 11, 22, 2 x 12. */
static void sbi_membrane_strains_by(const sbi_membrane_point *point, int a, sb_vec3 b[3])
{
    const sb_real *g = point->gradient[a];
    b[0] = sb_v3_scale(g[0], point->f[0]);
    b[1] = sb_v3_scale(g[1], point->f[1]);
    b[2] = sb_v3_madd(sb_v3_scale(g[1], point->f[0]), g[0], point->f[1]);
}

/* V F S g_a */
static sb_vec3 sbi_membrane_node_force(const sbi_membrane_point *point, const sb_real s[3], int a)
{
    const sb_real *g = point->gradient[a];
    sb_vec3 sum = sb_v3_scale(point->volume * (s[0] * g[0] + s[2] * g[1]), point->f[0]);
    return sb_v3_madd(sum, point->volume * (s[2] * g[0] + s[1] * g[1]), point->f[1]);
}

/* ---- faces ---- */

/* A way through the points of all faces: for (walk = begin; next(&walk);) use(walk.point). */
typedef struct sbi_membrane_walk {
    const sb_body *body;
    const sbi_load *load;
    const sb_vec3 *u;
    sbi_membrane_law law;
    sbi_membrane_rule rule;
    int face, end, p; /* of the point to come */
    int at;           /* face of the present one */
    sbi_membrane_point point;
} sbi_membrane_walk;

static void sbi_membrane_begin(sbi_membrane_walk *walk, const sb_body *body, const sbi_load *load, const sb_vec3 *u,
                               sb_real factor)
{
    walk->body = body;
    walk->load = load;
    walk->u = u;
    walk->law = sbi_membrane_law_at(load, factor);
    walk->rule.type = SB_NO_ELEMENT;
    walk->face = walk->p = 0;
    walk->end = load->row_count;
}

static int sbi_membrane_next(sbi_membrane_walk *walk)
{
    while (walk->face < walk->end) {
        int p = walk->p++;
        sbi_membrane_need_face_rule(walk->load, walk->face, &walk->rule);
        walk->at = walk->face;
        if (walk->p >= walk->rule.count) {
            walk->p = 0;
            walk->face++;
        }
        if (p < walk->rule.count &&
            sbi_membrane_lay(walk->body, walk->load, walk->at, &walk->rule, p, &walk->law, walk->u, &walk->point))
            return 1;
    }
    return 0;
}

SBI_API sb_result sbi_membrane_check_faces(const sb_body *body, const sbi_load *load, sb_error *error)
{
    sbi_membrane_rule rule;
    rule.type = SB_NO_ELEMENT;
    for (int j = 0; j < load->row_count; j++) {
        sbi_membrane_point point;
        sb_vec3 axes[2];
        sb_real area;
        sbi_membrane_need_rule(load->face_types[j], &rule);
        point.count = rule.nodes;
        point.nodes = load->nodes + load->row_start[j];
        for (int p = 0; p < rule.count; p++)
            if (!sbi_membrane_rest(body, (const sb_real(*)[3])rule.gradient[p], &point, axes, &area))
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, point.nodes[0],
                                     "face %d of the membrane (nodes %d %d %d ...) has no area", j, point.nodes[0],
                                     point.nodes[1], point.nodes[2]);
    }
    return SB_OK;
}

SBI_API double sbi_membrane_energy(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor)
{
    double sum = 0;
    sbi_membrane_walk walk;
    for (sbi_membrane_begin(&walk, body, load, u, factor); sbi_membrane_next(&walk);) {
        sbi_membrane_axes at = sbi_membrane_principal(walk.point.strain);
        sb_real s[3];
        sb_membrane_form form = sbi_membrane_form_of(&walk.law, &at);
        sum += (double)walk.law.shear * (double)sbi_membrane_stress(form, &at, walk.point.strain, s) *
               (double)walk.point.volume;
    }
    return sum;
}

/* Stress of a point alone. */
static void sbi_membrane_ask_stress(const sbi_membrane_walk *walk, sb_real s[3])
{
    sbi_membrane_axes at = sbi_membrane_principal(walk->point.strain);
    (void)sbi_membrane_stress(sbi_membrane_form_of(&walk->law, &at), &at, walk->point.strain, s);
    for (int i = 0; i < 3; i++)
        s[i] *= walk->law.shear;
}

SBI_API double sbi_membrane_add_force(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor,
                                      sb_vec3 *out)
{
    double size = 0;
    sbi_membrane_walk walk;
    for (sbi_membrane_begin(&walk, body, load, u, factor); sbi_membrane_next(&walk);) {
        const sbi_membrane_point *point = &walk.point;
        double stiff = 4 * (double)walk.law.shear * (double)point->volume;
        sb_real s[3];
        sbi_membrane_ask_stress(&walk, s);
        for (int a = 0; a < point->count; a++) {
            int node = point->nodes[a];
            double g = (double)point->gradient[a][0], h = (double)point->gradient[a][1], square = g * g + h * h;
            out[node] = sb_v3_sub(out[node], sbi_membrane_node_force(point, s, a));
            size += stiff * stiff * square * (1 + square * (double)sb_v3_dot(u[node], u[node]));
        }
    }
    return size;
}

/* block += V ((g_a . S g_b) 1 + B_a^T t), t = D B_b */
static void sbi_membrane_add_pair(const sbi_membrane_point *point, const sb_real pull[3], const sb_vec3 t[3], int a,
                                  int b, sb_real *block)
{
    const sb_real *g = point->gradient[a], *h = point->gradient[b];
    sb_real even =
        point->volume * (g[0] * (pull[0] * h[0] + pull[2] * h[1]) + g[1] * (pull[2] * h[0] + pull[1] * h[1]));
    sb_vec3 by[3];
    sbi_membrane_strains_by(point, a, by);
    for (int i = 0; i < 3; i++) {
        const sb_real left[3] = {by[i].x, by[i].y, by[i].z}, right[3] = {t[i].x, t[i].y, t[i].z};
        for (int c = 0; c < 9; c++)
            block[c] += point->volume * left[c / 3] * right[c % 3];
    }
    block[0] += even;
    block[4] += even;
    block[8] += even;
}

/* matrix += stiffness of a point */
static void sbi_membrane_add_point(const sbi_membrane_point *point, const sb_real pull[3], const sb_real d[3][3],
                                   const int *blocks, sb_matrix *matrix)
{
    for (int b = 0; b < point->count; b++) {
        sb_vec3 by[3], t[3];
        sbi_membrane_strains_by(point, b, by);
        for (int i = 0; i < 3; i++)
            t[i] = sb_v3_madd(sb_v3_madd(sb_v3_scale(d[i][0], by[0]), d[i][1], by[1]), d[i][2], by[2]);
        for (int a = 0; a < point->count; a++)
            sbi_membrane_add_pair(point, pull, t, a, b, matrix->blocks[blocks[a * point->count + b]]);
    }
}

/* Blocks of the pairs of a face, after those of face *at, whose blocks are at *offset. */
static const int *sbi_membrane_blocks(const sbi_load *load, int face, int *at, size_t *offset)
{
    for (; *at < face; ++*at) {
        size_t count = (size_t)(load->row_start[*at + 1] - load->row_start[*at]);
        *offset += count * count;
    }
    return load->blocks + *offset;
}

SBI_API void sbi_membrane_add_tangent(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_tangent_kind kind,
                                      sb_real factor, sb_matrix *matrix)
{
    size_t offset = 0;
    int at = 0;
    sbi_membrane_walk walk;
    for (sbi_membrane_begin(&walk, body, load, u, factor); sbi_membrane_next(&walk);) {
        sbi_membrane_answer answer = sbi_membrane_ask(&walk.law, &walk.point, kind == SB_TANGENT_EXACT);
        sbi_membrane_add_point(&walk.point, answer.pull, (const sb_real(*)[3])answer.d,
                               sbi_membrane_blocks(load, walk.at, &at, &offset), matrix);
    }
}

SBI_API void sbi_membrane_add_slack(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_matrix *matrix)
{
    const sb_real none[3] = {0, 0, 0}, rest[3] = {0, 0, 0};
    size_t offset = 0;
    int at = 0;
    sbi_membrane_walk walk;
    for (sbi_membrane_begin(&walk, body, load, u, 1); sbi_membrane_next(&walk);) {
        sbi_membrane_answer answer = sbi_membrane_ask(&walk.law, &walk.point, 1);
        if (answer.form == SB_MEMBRANE_TAUT)
            continue;
        sbi_membrane_taut_moduli(rest, answer.d);
        for (int i = 0; i < 9; i++)
            answer.d[i / 3][i % 3] *= walk.law.shear;
        sbi_membrane_add_point(&walk.point, none, (const sb_real(*)[3])answer.d,
                               sbi_membrane_blocks(load, walk.at, &at, &offset), matrix);
    }
}

/* dS and dF of a move x of the nodes; what K x has at the nodes comes from both. */
static sb_vec3 sbi_membrane_point_product(const sbi_membrane_point *point, const sbi_membrane_answer *answer,
                                          const sb_vec3 turn[2], int a)
{
    const sb_real *g = point->gradient[a];
    const sb_real strain[3] = {sb_v3_dot(point->f[0], turn[0]), sb_v3_dot(point->f[1], turn[1]),
                               sb_v3_dot(point->f[0], turn[1]) + sb_v3_dot(point->f[1], turn[0])};
    sb_real more[3];
    sb_vec3 sum;
    for (int i = 0; i < 3; i++)
        more[i] = answer->d[i][0] * strain[0] + answer->d[i][1] * strain[1] + answer->d[i][2] * strain[2];
    sum = sbi_membrane_node_force(point, more, a);
    sum = sb_v3_madd(sum, point->volume * (answer->pull[0] * g[0] + answer->pull[2] * g[1]), turn[0]);
    return sb_v3_madd(sum, point->volume * (answer->pull[2] * g[0] + answer->pull[1] * g[1]), turn[1]);
}

SBI_API void sbi_membrane_add_product(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor,
                                      const sb_vec3 *x, sb_real share, sb_vec3 *out)
{
    sbi_membrane_walk walk;
    for (sbi_membrane_begin(&walk, body, load, u, factor); sbi_membrane_next(&walk);) {
        sbi_membrane_answer answer = sbi_membrane_ask(&walk.law, &walk.point, 0);
        const sb_vec3 turn[2] = {sbi_membrane_slope(&walk.point, x, 0), sbi_membrane_slope(&walk.point, x, 1)};
        for (int a = 0; a < walk.point.count; a++) {
            sb_vec3 *node = out + walk.point.nodes[a];
            *node = sb_v3_madd(*node, share, sbi_membrane_point_product(&walk.point, &answer, turn, a));
        }
    }
}

SBI_API sb_real sbi_membrane_work(const sb_body *body, const sbi_load *load, const sb_vec3 *u, sb_real factor,
                                  const sb_vec3 *du)
{
    sb_real sum = 0;
    sbi_membrane_walk walk;
    for (sbi_membrane_begin(&walk, body, load, u, factor); sbi_membrane_next(&walk);) {
        sb_real s[3];
        sbi_membrane_ask_stress(&walk, s);
        for (int a = 0; a < walk.point.count; a++)
            sum -= sb_v3_dot(du[walk.point.nodes[a]], sbi_membrane_node_force(&walk.point, s, a));
    }
    return sum;
}

SBI_API void sbi_membrane_face_force(const sb_body *body, const sbi_load *load, int face, const sb_vec3 *u,
                                     const sb_vec3 *linear, sb_real factor, sb_vec3 *force)
{
    sbi_membrane_walk walk;
    memset(force, 0, SB_MAX_FACE_NODES * sizeof *force);
    sbi_membrane_begin(&walk, body, load, linear, factor);
    walk.face = face;
    walk.end = face + 1;
    while (sbi_membrane_next(&walk)) {
        sbi_membrane_answer answer = sbi_membrane_ask(&walk.law, &walk.point, 0);
        sb_vec3 turn[2];
        for (int j = 0; j < 2; j++)
            turn[j] = sb_v3_sub(sbi_membrane_slope(&walk.point, u, j), sbi_membrane_slope(&walk.point, linear, j));
        for (int a = 0; a < walk.point.count; a++) {
            force[a] = sb_v3_sub(force[a], sbi_membrane_node_force(&walk.point, answer.s, a));
            if (u != linear)
                force[a] = sb_v3_sub(force[a], sbi_membrane_point_product(&walk.point, &answer, turn, a));
        }
    }
}

/* ---- solves and readings ---- */

SBI_API void sbi_membrane_relax(sbi_load *load)
{
    load->balanced_membrane = load->membrane;
    load->balanced_membrane.prestretch = 1;
}

SBI_API void sbi_membrane_settle(sbi_load *load, sb_real factor)
{
    load->balanced_membrane = sbi_membrane_law_at(load, factor);
}

SBI_API sb_membrane_state sbi_membrane_state_of(const sb_body *body, const sbi_load *load, int face)
{
    sb_membrane_state state;
    sbi_membrane_rule rule;
    sbi_membrane_point point;
    sbi_membrane_axes at;
    sb_real stress[3], pull, other, width;
    memset(&state, 0, sizeof state);
    sbi_membrane_make_middle(load, face, &rule);
    if (!sbi_membrane_lay(body, load, face, &rule, 0, &load->membrane, body->displacement, &point))
        return state;
    at = sbi_membrane_principal(point.strain);
    state.form = sbi_membrane_form_of(&load->membrane, &at);
    (void)sbi_membrane_stress(state.form, &at, point.strain, stress);
    pull = stress[0] * at.n[0] * at.n[0] + stress[1] * at.n[1] * at.n[1] + 2 * stress[2] * at.n[0] * at.n[1];
    other = stress[0] * at.n[1] * at.n[1] + stress[1] * at.n[0] * at.n[0] - 2 * stress[2] * at.n[0] * at.n[1];
    state.stretch[0] = sb_sqrt(sb_max(1 + at.x, 0));
    state.stretch[1] = sb_sqrt(sb_max(1 + at.z, 0));
    width = state.form == SB_MEMBRANE_TAUT ? state.stretch[1] : 1 / sb_sqrt(state.stretch[0]);
    state.direction = sb_v3_add(sb_v3_scale(at.n[0], point.f[0]), sb_v3_scale(at.n[1], point.f[1]));
    if (state.stretch[0] > 0)
        state.direction = sb_v3_scale(1 / sb_v3_norm(state.direction), state.direction);
    if (state.form != SB_MEMBRANE_SLACK) { /* Cauchy's stress lam^2 S times the present thickness */
        sb_real scale = load->membrane.thickness * load->membrane.shear;
        state.tension[0] = scale * pull * state.stretch[0] / width;
        state.tension[1] = scale * other * width / state.stretch[0];
    }
    return state;
}
