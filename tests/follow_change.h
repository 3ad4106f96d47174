/* follow_change.h: changes of a body's mesh at random, and back, for tests of what follows them. */
#ifndef FOLLOW_CHANGE_H
#define FOLLOW_CHANGE_H

#include "check.h"
#include "scene.h"

enum { FOLLOW_RING = 128 };

typedef struct follow_op {
    int kind; /* 0 edge split, 1 slide, 2 removal */
    int corners[2], node, cells, cell[FOLLOW_RING], nodes[FOLLOW_RING][SB_MAX_ELEMENT_NODES], more, made[FOLLOW_RING];
    sb_vec3 from;
} follow_op;

static inline int follow_pick(const sb_body *body, unsigned long long *seed)
{
    for (;;) {
        int e = (int)(check_random(seed) * sb_body_element_count(body));
        if (sb_body_cell_in_use(body, e))
            return e;
    }
}

static inline int follow_has(const int *cell, int width, int node)
{
    for (int a = 0; a < width; a++)
        if (cell[a] == node)
            return 1;
    return 0;
}

static inline sb_result follow_split(sb_body *body, follow_op *o, sb_body_change *change, unsigned long long *seed)
{
    sb_real weights[2];
    const sb_vec3 *x = sb_body_rest_positions(body);
    sb_result result;
    weights[0] = REAL(check_random_in(seed, 0.3, 0.7));
    weights[1] = 1 - weights[0];
    for (int e = 0; e < sb_body_element_count(body); e++) {
        const int *nodes = sb_body_cell_nodes(body, e);
        if (nodes && follow_has(nodes, 4, o->corners[0]) && follow_has(nodes, 4, o->corners[1]) &&
            o->cells < FOLLOW_RING) {
            o->cell[o->cells] = e;
            memcpy(o->nodes[o->cells++], nodes, 4 * sizeof(int));
        }
    }
    result = sb_body_change_add_node(
        change, sb_v3_add(sb_v3_scale(weights[0], x[o->corners[0]]), sb_v3_scale(weights[1], x[o->corners[1]])),
        o->corners, weights, 2, 0, &o->node, NULL);
    for (int i = 0; i < 2 * o->cells && result == SB_OK; i++) {
        sb_change_cell cell = sb_default_change_cell();
        int nodes[4];
        for (int a = 0; a < 4; a++)
            nodes[a] = o->nodes[i / 2][a] == o->corners[i % 2] ? o->node : o->nodes[i / 2][a];
        cell.nodes = nodes;
        cell.parent = o->cell[i / 2];
        result = i % 2 ? sb_body_change_add_cell(change, &cell, &o->made[o->more++], NULL)
                       : sb_body_change_replace_cell(change, o->cell[i / 2], &cell, NULL);
    }
    return result;
}

/* A change at random; a refused one changes nothing. */
static inline sb_result follow_change(sb_body *body, follow_op *o, int kind, int width, unsigned long long *seed)
{
    sb_body_change *change;
    int cell = follow_pick(body, seed), corner = (int)(check_random(seed) * 4), counts[SB_MAX_ELEMENT_NODES] = {0};
    const int *nodes = sb_body_cell_nodes(body, cell);
    sb_result result = sb_body_change_begin(body, &change, NULL);
    if (!CHECK_OK(result))
        return result;
    memset(o, 0, sizeof *o);
    o->kind = kind;
    o->corners[0] = o->node = nodes[corner];
    o->corners[1] = nodes[(corner + 1 + (int)(check_random(seed) * 3)) % 4];
    if (kind == 0) {
        result = follow_split(body, o, change, seed);
    } else if (kind == 1) {
        sb_real step = REAL(check_random_in(seed, 0.05, 0.3)), weights[2];
        o->from = sb_body_rest_positions(body)[o->node];
        weights[0] = 1 - step;
        weights[1] = step;
        result = sb_body_change_move_node(
            change, o->node,
            sb_v3_madd(sb_v3_scale(weights[0], o->from), step, sb_body_rest_positions(body)[o->corners[1]]), o->corners,
            weights, 2, NULL);
    } else {
        o->cell[0] = cell;
        o->cells = 1;
        memcpy(o->nodes[0], nodes, (size_t)width * sizeof(int));
        for (int e = 0; e < sb_body_element_count(body); e++)
            for (int a = 0; a < width && sb_body_cell_in_use(body, e); a++)
                counts[a] += follow_has(sb_body_cell_nodes(body, e), width, o->nodes[0][a]);
        for (int a = 0; a < width; a++)
            if (counts[a] == 1)
                result = SB_ERROR_MESH;
        if (result == SB_OK)
            result = sb_body_change_remove_cell(change, cell, NULL);
    }
    if (result == SB_OK)
        result = sb_body_change_commit(change, NULL);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

static inline sb_result follow_undo(sb_body *body, const follow_op *o)
{
    sb_body_change *change;
    sb_real halves[2] = {REAL(0.5), REAL(0.5)};
    sb_result result = sb_body_change_begin(body, &change, NULL);
    for (int i = o->more - 1; i >= 0 && result == SB_OK; i--)
        result = sb_body_change_remove_cell(change, o->made[i], NULL);
    for (int i = 0; i < o->cells && result == SB_OK; i++) {
        sb_change_cell cell = sb_default_change_cell();
        int number;
        cell.nodes = o->nodes[i];
        result = o->kind == 2 ? sb_body_change_add_cell(change, &cell, &number, NULL)
                              : sb_body_change_replace_cell(change, o->cell[i], &cell, NULL);
    }
    if (result == SB_OK && o->kind == 0)
        result = sb_body_change_remove_node(change, o->node, o->corners, halves, 2, NULL);
    if (result == SB_OK && o->kind == 1)
        result = sb_body_change_move_node(change, o->node, o->from, NULL, NULL, 0, NULL);
    if (result == SB_OK)
        result = sb_body_change_commit(change, NULL);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

#endif /* FOLLOW_CHANGE_H */
