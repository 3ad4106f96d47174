/* same_body.h: how far the bodies of two cases are apart. */
#ifndef SAME_BODY_H
#define SAME_BODY_H

#include "softbody.h"

#include "check.h"

#include "../examples/case_inp.h"

/* Largest differences, relative to the largest value; 0: the same numbers. */
typedef struct body_difference {
    double nodes, materials, supports, loads;
    int same_elements, same_axes, same_solve;
} body_difference;

static inline double vectors_differ(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double most = 0, size = 0;
    for (int i = 0; i < count; i++) {
        most = fmax(most, (double)sb_v3_norm(sb_v3_sub(a[i], b[i])));
        size = fmax(size, (double)sb_v3_norm(a[i]));
    }
    return most == 0 ? 0 : size > 0 ? most / size : most;
}

/* Differences of elastic constants, each relative to itself. */
static inline double materials_differ(const sb_material *a, const sb_material *b)
{
    const sb_real left[] = {a->lambda, a->mu, a->c10, a->c01, a->c20, a->c30, a->d1};
    const sb_real right[] = {b->lambda, b->mu, b->c10, b->c01, b->c20, b->c30, b->d1};
    double most = a->model == b->model ? 0 : 1;
    for (int i = 0; i < (int)(sizeof left / sizeof left[0]); i++)
        if (left[i] != right[i])
            most = fmax(most, fabs((double)(left[i] - right[i]) / (double)left[i]));
    return most;
}

/* Displacements that the statements of a case prescribe, [node_count]; 0 where there is none. */
static inline sb_vec3 *prescribed(const case_file *c)
{
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)c->mesh.node_count, sizeof *u);
    for (int i = 0; u && i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        for (int k = 0; k < s->count && s->form->kind == CASE_PRESCRIBE; k++) {
            if (s->axes & SB_X)
                u[s->nodes[k]].x = s->vectors[k].x;
            if (s->axes & SB_Y)
                u[s->nodes[k]].y = s->vectors[k].y;
            if (s->axes & SB_Z)
                u[s->nodes[k]].z = s->vectors[k].z;
        }
    }
    return u;
}

/* The same material for each element, whatever the regions are called. */
static inline double region_materials_differ(const case_file *a, const case_file *b)
{
    double most = 0;
    int last_a = -1, last_b = -1;
    for (int e = 0; e < a->mesh.element_count; e++) {
        int at_a = case_find_region(a, a->mesh.regions ? a->mesh.regions[e] : 0);
        int at_b = case_find_region(b, b->mesh.regions ? b->mesh.regions[e] : 0);
        if (e > 0 && at_a == last_a && at_b == last_b)
            continue;
        most = fmax(most, materials_differ(at_a < 0 ? &a->material : &a->region_materials[at_a].material,
                                           at_b < 0 ? &b->material : &b->region_materials[at_b].material));
        last_a = at_a;
        last_b = at_b;
    }
    return most;
}

/* `loads`: whether to compare the nodal forces, which takes making two bodies. */
static inline body_difference bodies_differ(case_file *a, case_file *b, int loads)
{
    const int nodes = a->mesh.node_count, width = sb_mesh_element_width(&a->mesh);
    body_difference d = {1, 1, 1, 0, 0, 0, 0};
    sb_vec3 *left = prescribed(a), *right = prescribed(b);
    if (nodes == b->mesh.node_count && a->mesh.element_count == b->mesh.element_count &&
        a->mesh.element_type == b->mesh.element_type && left && right) {
        d.nodes = vectors_differ(a->mesh.nodes, b->mesh.nodes, nodes);
        d.materials = region_materials_differ(a, b);
        d.supports = vectors_differ(left, right, nodes);
        d.same_elements = memcmp(a->mesh.elements, b->mesh.elements,
                                 (size_t)a->mesh.element_count * (size_t)width * sizeof(int)) == 0;
        d.same_axes = memcmp(a->supports, b->supports, (size_t)nodes) == 0;
        d.same_solve = a->solve->form == b->solve->form && case_dt(a) == case_dt(b) &&
                       a->solve->number[CASE_END] == b->solve->number[CASE_END] &&
                       a->solve->number[CASE_COUNT] == b->solve->number[CASE_COUNT];
        if (loads) {
            unsigned kinds = CASE_LOADS | CASE_KIND(CASE_GRAVITY);
            d.loads = case_nodal_loads(a, kinds, left) && case_nodal_loads(b, kinds, right)
                          ? vectors_differ(left, right, nodes)
                          : 1;
        }
    }
    free(left);
    free(right);
    return d;
}

#endif /* SAME_BODY_H */
