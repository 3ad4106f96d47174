/* contact_rules: the samples of each face type, and what of a quadratic face is each node's. */
#include "contact_faces.h"

#include <string.h>

/* Points of a part: of a triangle in the parts' triangle (0, 0), (1, 0), (0, 1), and of the one that fills its cell. */
static const sb_real sbi_contact_centroids[2][1][2] = {{{(sb_real)1 / 3, (sb_real)1 / 3}},
                                                       {{(sb_real)2 / 3, (sb_real)2 / 3}}};
static const sb_real sbi_contact_threes[2][3][2] = {
    {{(sb_real)1 / 6, (sb_real)1 / 6}, {(sb_real)2 / 3, (sb_real)1 / 6}, {(sb_real)1 / 6, (sb_real)2 / 3}},
    {{(sb_real)5 / 6, (sb_real)5 / 6}, {(sb_real)1 / 3, (sb_real)5 / 6}, {(sb_real)5 / 6, (sb_real)1 / 3}}};
/* (1 -+ 1 / sqrt(3)) / 2 */
static const sb_real sbi_contact_gauss[2] = {(sb_real)0.21132486540518711775, (sb_real)0.78867513459481288225};

static int sbi_contact_is_triangle(const sbi_contact_kind *kind) { return kind->corners == 3; }

/* Samples in a part. */
static int sbi_contact_points(const sbi_contact_kind *kind)
{
    return !sbi_contact_is_triangle(kind) ? 4 : kind->nodes == 3 ? 1 : 3;
}

/* Parameters of sample `sample` of n parts a side. Parts of a triangle are numbered along its rows, of which row j has
 * n - j upright ones and between them n - j - 1 others. */
static void sbi_contact_sample_point(const sbi_contact_kind *kind, int n, int sample, sb_real xi[3])
{
    int points = sbi_contact_points(kind), part = sample / points, point = sample % points, row = 0;
    const sb_real side = (sb_real)1 / (sb_real)n;
    const sb_real *at;
    xi[2] = 0;
    if (!sbi_contact_is_triangle(kind)) {
        xi[0] = 2 * side * ((sb_real)(part % n) + sbi_contact_gauss[point % 2]) - 1;
        xi[1] = 2 * side * ((sb_real)(part / n) + sbi_contact_gauss[point / 2]) - 1;
        return;
    }
    while (part >= 2 * (n - row) - 1)
        part -= 2 * (n - row++) - 1;
    at = points == 1 ? sbi_contact_centroids[part % 2][point] : sbi_contact_threes[part % 2][point];
    xi[0] = side * ((sb_real)(part / 2) + at[0]);
    xi[1] = side * ((sb_real)row + at[1]);
}

static sbi_contact_kind sbi_contact_make_kind(sb_element_type type)
{
    sbi_contact_kind kind;
    memset(&kind, 0, sizeof kind);
    kind.type = type;
    kind.nodes = sb_element_node_count(type);
    kind.corners = sb_element_corner_count(type);
    kind.least = type == SB_TRI3 ? 2 : 1;
    kind.most = type == SB_TRI3 ? SBI_CONTACT_MOST_PARTS : SBI_CONTACT_MOST_PARTS / 2;
    kind.part = type == SB_TRI3 ? (sb_real)0.5 : type == SB_TRI6 ? (sb_real)1 : (sb_real)0.85;
    return kind;
}

/* Takes the tables of a kind (measuring or for real). */
static void sbi_contact_layout_rules(sbi_contact_kind *kind, sbi_arena *arena)
{
    for (int n = 1; n <= kind->most; n++) {
        sbi_contact_rule *rule = &kind->rules[n];
        size_t values;
        rule->count = sbi_contact_points(kind) * n * n;
        rule->measure = (sb_real)(sbi_contact_is_triangle(kind) ? 0.5 : 4.0) / (sb_real)rule->count;
        values = (size_t)rule->count * (size_t)kind->nodes;
        rule->weights = (sb_real *)sbi_arena_take(arena, values, sizeof(sb_real));
        rule->slopes = (sb_real *)sbi_arena_take(arena, 2 * values, sizeof(sb_real));
    }
}

static void sbi_contact_fill_rule(sbi_contact_kind *kind, int n)
{
    sbi_contact_rule *rule = &kind->rules[n];
    sb_real *weights = rule->weights, *slopes = rule->slopes;
    rule->spread = 1;
    for (int i = 0; i < rule->count; i++, weights += kind->nodes, slopes += 2 * kind->nodes) {
        sb_real xi[3], gradient[SB_MAX_FACE_NODES][3], sum = 0;
        sbi_contact_sample_point(kind, n, i, xi);
        sb_element_shape(kind->type, xi, weights, gradient);
        for (int a = 0; a < kind->nodes; a++) {
            slopes[a] = gradient[a][0];
            slopes[kind->nodes + a] = gradient[a][1];
            sum += sb_abs(weights[a]);
        }
        rule->spread = sb_max(rule->spread, sum);
    }
}

/* Shares of a face's area, in its parameters, by the integrals of |N|. */
static void sbi_contact_fill_shares(sbi_contact_kind *kind)
{
    const sbi_contact_rule *rule = &kind->rules[kind->most];
    sb_real sum = 0;
    for (int i = 0; i < rule->count * kind->nodes; i++) {
        kind->shares[i % kind->nodes] += sb_abs(rule->weights[i]);
        sum += sb_abs(rule->weights[i]);
    }
    for (int a = 0; a < kind->nodes; a++)
        kind->shares[a] /= sum;
}

SBI_API int sbi_contact_make_rules(sbi_contact_faces *faces, sbi_element element)
{
    sbi_arena arena = {NULL, 0, 0};
    faces->side_count = sbi_element_face_count(element);
    for (int s = 0; s < faces->side_count; s++) {
        sbi_contact_side *side = &faces->element_sides[s];
        sb_element_type type = SB_NO_ELEMENT;
        side->nodes = sbi_element_face(element, s, side->local, &type);
        side->corners = sb_element_corner_count(type);
        if (!faces->kinds[side->nodes].nodes)
            faces->kinds[side->nodes] = sbi_contact_make_kind(type);
        faces->width = sbi_max_int(faces->width, side->nodes);
    }
    for (int pass = 0; pass < 2; pass++) {
        for (int size = 1; size <= SB_MAX_FACE_NODES; size++)
            if (faces->kinds[size].nodes)
                sbi_contact_layout_rules(&faces->kinds[size], &arena);
        if (pass == 1)
            break;
        faces->rule_memory = arena.overflow ? NULL : sbi_alloc(&faces->allocator, arena.used, 1);
        if (!faces->rule_memory)
            return 0;
        arena.base = (unsigned char *)faces->rule_memory;
        arena.used = 0;
    }
    for (int size = 1; size <= SB_MAX_FACE_NODES; size++) {
        sbi_contact_kind *kind = &faces->kinds[size];
        for (int n = 1; n <= kind->most && kind->nodes; n++)
            sbi_contact_fill_rule(kind, n);
        if (kind->nodes > 4)
            sbi_contact_fill_shares(kind);
    }
    return 1;
}
