/* embed_search: the closest point of an element, curved ones too, and the closest element. */
#include "embed_search.h"

#include <string.h>

/* ---- closest point in one element: min |x(xi) - v|^2 with xi in the element ----
 * Levenberg-Marquardt: each trial solves the quadratic model within the element's faces exactly, by the primal
 * active-set method in the free directions (of a tet: from one free corner to the others; of a hex: free axes). For a
 * straight tet the model is exact and the first trial is the answer. */

/* xi and, for tets, all four barycentric coordinates, so that those on a face are exactly 0. active: tets bit a for
 * L_a = 0; hexes bits 2 k and 2 k + 1 for xi_k = -1 and 1. */
typedef struct sbi_embed_state {
    sb_real at[4]; /* tets L_0 .. L_3, hexes xi */
    unsigned active;
} sbi_embed_state;

static void sbi_embed_state_xi(const sbi_embed_state *state, int is_box, sb_real xi[3])
{
    for (int k = 0; k < 3; k++)
        xi[k] = state->at[is_box ? k : k + 1];
}

/* Solves the leading count x count system (count <= 3) of a positive definite matrix; 0 when it is singular. */
static int sbi_embed_solve(sb_real *a, int count, sb_real *b)
{
    if (sb_cholesky_factor(a, count))
        return 0;
    sb_cholesky_solve(a, count, b);
    return 1;
}

/* Free corners (tets) or axes (hexes). */
static int sbi_embed_free_directions(unsigned active, int is_box, int free[4])
{
    int count = 0;
    for (int a = 0; a < (is_box ? 3 : 4); a++)
        if (is_box ? !(active >> (2 * a) & 3u) : !(active >> a & 1u))
            free[count++] = a;
    return count;
}

/* Minimiser of 1/2 p.A p + h.p over the free directions; change[4] in the terms of state->at. */
static int sbi_embed_free_step(const sb_mat3 *a, const sb_real *h, unsigned active, int is_box, sb_real change[4])
{
    sb_real m[9], b[3];
    int free[4], count = sbi_embed_free_directions(active, is_box, free), n = is_box ? count : count - 1;
    change[0] = change[1] = change[2] = change[3] = 0;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            if (is_box) {
                m[i * n + j] = a->m[free[i]][free[j]];
            } else { /* corner 0 is the origin of xi: its row is zero */
                int p = free[i + 1] - 1, q = free[j + 1] - 1, o = free[0] - 1;
                m[i * n + j] = a->m[p][q] - (o < 0 ? (sb_real)0 : a->m[p][o] + a->m[o][q] - a->m[o][o]);
            }
        }
        b[i] = is_box ? -h[free[i]] : (free[0] > 0 ? h[free[0] - 1] : (sb_real)0) - h[free[i + 1] - 1];
    }
    if (n > 0 && !sbi_embed_solve(m, n, b))
        return 0;
    for (int i = 0; i < n; i++) {
        change[free[is_box ? i : i + 1]] += b[i];
        if (!is_box)
            change[free[0]] -= b[i];
    }
    return 1;
}

/* How far along change the element reaches, at most 1; *blocking: the constraint met, or -1. */
static sb_real sbi_embed_reach(const sbi_embed_state *state, const sb_real change[4], int is_box, int *blocking)
{
    sb_real t = 1;
    *blocking = -1;
    for (int a = 0; a < (is_box ? 3 : 4); a++) {
        sb_real room = is_box ? (change[a] > 0 ? 1 - state->at[a] : 1 + state->at[a]) : state->at[a];
        sb_real speed = is_box ? sb_abs(change[a]) : -change[a];
        if (speed > 0 && room < t * speed) {
            t = sb_max(room, 0) / speed;
            *blocking = is_box ? 2 * a + (change[a] > 0) : a;
        }
    }
    return t;
}

/* The active constraint whose release descends most steeply, or -1. h: gradient in xi. */
static int sbi_embed_release(const sb_real *h, unsigned active, int is_box, sb_real tolerance)
{
    int best = -1, base = 0;
    sb_real steepest = -tolerance;
    while (!is_box && base < 3 && active >> base & 1u)
        base++;
    for (int c = 0; c < (is_box ? 6 : 4); c++) {
        sb_real slope;
        if (!(active >> c & 1u))
            continue;
        if (is_box)
            slope = c & 1 ? -h[c / 2] : h[c / 2];
        else
            slope = (c > 0 ? h[c - 1] : (sb_real)0) - (base > 0 ? h[base - 1] : (sb_real)0);
        if (slope < steepest) {
            steepest = slope;
            best = c;
        }
    }
    return best;
}

/* The quadratic model 1/2 p.A p + g.p of half the squared distance around xi = start, p = xi - start. */
typedef struct sbi_embed_model {
    sb_mat3 a;
    sb_real g[3], start[3];
} sbi_embed_model;

static void sbi_embed_model_gradient(const sbi_embed_model *model, const sbi_embed_state *state, int is_box,
                                     sb_real h[3])
{
    sb_real p[3];
    sbi_embed_state_xi(state, is_box, p);
    for (int k = 0; k < 3; k++)
        p[k] -= model->start[k];
    for (int k = 0; k < 3; k++)
        h[k] = model->g[k] + model->a.m[k][0] * p[0] + model->a.m[k][1] * p[1] + model->a.m[k][2] * p[2];
}

/* To the minimum of the model on the active faces, or onto one more of them: 1 in the second case. */
static int sbi_embed_descend(const sbi_embed_model *model, const sb_real h[3], int is_box, sbi_embed_state *state)
{
    sb_real change[4], t;
    int blocking;
    if (!sbi_embed_free_step(&model->a, h, state->active, is_box, change))
        return 0;
    t = sbi_embed_reach(state, change, is_box, &blocking);
    for (int k = 0; k < 4; k++)
        state->at[k] += t * change[k];
    if (blocking < 0)
        return 0;
    state->active |= 1u << blocking;
    if (is_box)
        state->at[blocking / 2] = blocking & 1 ? (sb_real)1 : -(sb_real)1;
    else
        state->at[blocking] = 0;
    return 1;
}

/* Moves state to the minimum of the model within the element. The rounds are bounded only for the sake of rounding:
 * every release is followed by a descent. */
static void sbi_embed_minimise(const sbi_embed_model *model, int is_box, sbi_embed_state *state)
{
    sb_real h[3], tolerance = 64 * SB_EPSILON *
                              (sb_m3_trace(model->a) + sb_abs(model->g[0]) + sb_abs(model->g[1]) + sb_abs(model->g[2]));
    for (int round = 0; round < 24; round++) {
        int released;
        sbi_embed_model_gradient(model, state, is_box, h);
        if (sbi_embed_descend(model, h, is_box, state))
            continue;
        sbi_embed_model_gradient(model, state, is_box, h);
        released = sbi_embed_release(h, state->active, is_box, tolerance);
        if (released < 0)
            return;
        state->active &= ~(1u << released);
    }
}

/* The same bits as the sums over shape functions and slopes, which are -1, 0 and 1. */
static sb_vec3 sbi_embed_evaluate_tet(const sb_vec3 *x, const sb_real xi[3], sb_mat3 *jacobian)
{
    const sb_vec3 zero = sb_v3(0, 0, 0), minus = sb_v3_sub(zero, x[0]);
    sb_vec3 at = sb_v3_madd(zero, 1 - xi[0] - xi[1] - xi[2], x[0]);
    for (int a = 1; a < 4; a++)
        at = sb_v3_madd(at, xi[a - 1], x[a]);
    if (jacobian)
        *jacobian = sb_m3_columns(sb_v3_add(minus, x[1]), sb_v3_add(minus, x[2]), sb_v3_add(minus, x[3]));
    return at;
}

/* x(xi), and its Jacobian's columns if wanted, of an element with nodes at x. */
static sb_vec3 sbi_embed_evaluate(sb_element_type type, const sb_vec3 *x, const sb_real xi[3], sb_mat3 *jacobian)
{
    sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3];
    int count = sb_element_node_count(type);
    sb_vec3 at = sb_v3(0, 0, 0);
    if (type == SB_TET4)
        return sbi_embed_evaluate_tet(x, xi, jacobian);
    sb_element_shape(type, xi, shape, jacobian ? gradient : NULL);
    for (int a = 0; a < count; a++)
        at = sb_v3_madd(at, shape[a], x[a]);
    if (jacobian) {
        sb_vec3 column[3];
        for (int k = 0; k < 3; k++) {
            column[k] = sb_v3(0, 0, 0);
            for (int a = 0; a < count; a++)
                column[k] = sb_v3_madd(column[k], gradient[a][k], x[a]);
        }
        *jacobian = sb_m3_columns(column[0], column[1], column[2]);
    }
    return at;
}

SBI_API sb_vec3 sbi_embed_map(const sb_mesh *mesh, int element, const sb_real xi[3], sb_mat3 *jacobian)
{
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int width = sb_element_node_count(mesh->element_type);
    sbi_embed_gather(mesh->nodes, mesh->elements + (size_t)element * (size_t)width, width, x);
    return sbi_embed_evaluate(mesh->element_type, x, xi, jacobian);
}

/* Where to start: the guess in state, or in a curved element a corner or the centre that is nearer. */
static void sbi_embed_start(sb_element_type type, const sb_vec3 *x, sb_vec3 point, int is_box, sbi_embed_state *state)
{
    sb_real nearest = SB_REAL_MAX, xi[3];
    int corners = sb_element_corner_count(type), best = -2;
    sbi_embed_state centre = *state;
    for (int k = 0; k < 4; k++)
        centre.at[k] = is_box ? (sb_real)0 : (sb_real)0.25;
    for (int c = -2; c < corners; c++) { /* guess, centre, corners */
        sb_vec3 offset;
        sb_real d;
        sbi_embed_state_xi(c == -2 ? state : &centre, is_box, xi);
        offset = sb_v3_sub(c >= 0 ? x[c] : sbi_embed_evaluate(type, x, xi, NULL), point);
        d = sb_v3_dot(offset, offset);
        if (d < nearest) {
            nearest = d;
            best = c;
        }
    }
    if (best >= -1)
        *state = centre;
    for (int k = 0; best >= 0 && k < 4; k++)
        state->at[k] = !is_box && k == best ? (sb_real)1 : (sb_real)0;
    if (best >= 0 && is_box)
        sb_element_node_point(type, best, state->at);
}

/* Largest change of parameters between two states. */
static sb_real sbi_embed_state_change(const sbi_embed_state *a, const sbi_embed_state *b)
{
    sb_real largest = 0;
    for (int k = 0; k < 4; k++)
        largest = sb_max(largest, sb_abs(a->at[k] - b->at[k]));
    return largest;
}

/* Levenberg-Marquardt from state; returns the squared distance. flat: the map is linear, one step is exact. */
static sb_real sbi_embed_descend_element(sb_element_type type, const sb_vec3 *x, sb_vec3 point, int flat, int is_box,
                                         sbi_embed_state *state)
{
    const sb_real still = SB_REAL_IS_FLOAT ? (sb_real)1e-4 : (sb_real)1e-7; /* the distance is off by its square */
    sb_real damping = 0, distance2;
    sb_mat3 jacobian;
    sbi_embed_model model;
    sb_vec3 r;
    sbi_embed_state_xi(state, is_box, model.start);
    r = sb_v3_sub(sbi_embed_evaluate(type, x, model.start, &jacobian), point);
    distance2 = sb_v3_dot(r, r);
    for (int step = 0; step < 60 && distance2 > 0; step++) {
        sb_vec3 g = sb_m3_tapply(jacobian, r), trial_r;
        sb_real trial2, trial_xi[3], ridge, change;
        sb_mat3 trial_jacobian;
        sbi_embed_state trial = *state;
        model.a = sb_m3_tmul(jacobian, jacobian);
        ridge = damping * sb_m3_trace(model.a);
        for (int k = 0; k < 3; k++)
            model.a.m[k][k] += ridge;
        model.g[0] = g.x, model.g[1] = g.y, model.g[2] = g.z;
        sbi_embed_state_xi(state, is_box, model.start);
        sbi_embed_minimise(&model, is_box, &trial);
        sbi_embed_state_xi(&trial, is_box, trial_xi);
        trial_r = sb_v3_sub(sbi_embed_evaluate(type, x, trial_xi, &trial_jacobian), point);
        trial2 = sb_v3_dot(trial_r, trial_r);
        change = sbi_embed_state_change(&trial, state);
        if (trial2 < distance2 || (trial2 <= distance2 && trial.active != state->active)) {
            *state = trial;
            distance2 = trial2;
            jacobian = trial_jacobian;
            r = trial_r;
            damping = damping > (sb_real)1e-4 ? damping / 10 : (sb_real)0;
        } else {
            damping = sb_max(10 * damping, (sb_real)1e-4);
        }
        if (flat || change < still)
            break;
    }
    return distance2;
}

/* ---- closest element ---- */

/* A search under way. */
typedef struct sbi_embed_query {
    const sbi_embed_volume *volume;
    sb_vec3 point;
    sb_real enough; /* squared distance that counts as inside */
    sbi_embed_hit best;
} sbi_embed_query;

/* The face of a tet opposite each corner. */
static const unsigned char sbi_embed_opposite[4] = {1, 2, 0, 3};

/* 1 for a tet that is straight but for the rounding of its nodes, as of those read from a file. */
static int sbi_embed_is_flat(const sbi_embed_volume *volume, int element)
{
    const int *nodes = volume->mesh->elements + (size_t)element * (size_t)volume->width;
    sb_vec3 edge = sb_v3_sub(volume->mesh->nodes[nodes[1]], volume->mesh->nodes[nodes[0]]);
    return !volume->is_box && volume->bulge[element] <= (sb_real)1e-5 * sb_v3_norm(edge);
}

/* Faces of active constraints: tet face of L_a = 0, hex faces in the order of the bits. */
static unsigned sbi_embed_active_faces(unsigned active, int is_box)
{
    unsigned faces = 0;
    if (is_box)
        return active;
    for (int a = 0; a < 4; a++)
        if (active >> a & 1u)
            faces |= 1u << sbi_embed_opposite[a];
    return faces;
}

/* Barycentric coordinates in the straight tet. */
static void sbi_embed_barycentric(const sbi_embed_volume *volume, int element, sb_vec3 point, sb_real bary[4])
{
    for (int a = 0; a < 4; a++) {
        const sb_real *p = volume->planes[element][a];
        bary[a] = p[0] * point.x + p[1] * point.y + p[2] * point.z + p[3];
    }
}

/* The same; returns a lower bound of the distance to the element (m). */
static sb_real sbi_embed_planes(const sbi_embed_volume *volume, int element, sb_vec3 point, sb_real bary[4])
{
    sb_real bound = 0;
    sbi_embed_barycentric(volume, element, point, bary);
    for (int a = 0; a < 4; a++) {
        const sb_real *p = volume->planes[element][a];
        if (bary[a] < 0)
            bound = sb_max(bound, -bary[a] / sb_sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]));
    }
    return bound - volume->bulge[element];
}

/* Takes the element's closest point when it beats the best so far. */
static void sbi_embed_try(sbi_embed_query *query, int element)
{
    const sbi_embed_volume *volume = query->volume;
    const sb_mesh *mesh = volume->mesh;
    sb_element_type type = mesh->element_type;
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    sbi_embed_state state;
    sb_real distance2;
    int flat = sbi_embed_is_flat(volume, element);
    memset(&state, 0, sizeof state);
    if (!volume->is_box) {
        sb_real bound = sbi_embed_planes(volume, element, query->point, state.at), sum = 0;
        if (bound > 0 && bound * bound >= query->best.distance2)
            return;
        for (int a = 0; a < 4; a++) {
            state.at[a] = sb_max(state.at[a], 0);
            sum += state.at[a];
        }
        for (int a = 0; a < 4; a++)
            state.at[a] /= sum;
    }
    sbi_embed_gather(mesh->nodes, mesh->elements + (size_t)element * (size_t)volume->width, volume->width, x);
    if (flat)
        type = SB_TET4;
    else
        sbi_embed_start(type, x, query->point, volume->is_box, &state);
    distance2 = sbi_embed_descend_element(type, x, query->point, flat, volume->is_box, &state);
    if (distance2 < query->best.distance2) {
        query->best.element = element;
        query->best.distance2 = distance2;
        query->best.active = sbi_embed_active_faces(state.active, volume->is_box);
        sbi_embed_state_xi(&state, volume->is_box, query->best.xi);
    }
}

/* Walks through straight tets across the face that the point lies farthest beyond, towards a good start. */
static int sbi_embed_walk(const sbi_embed_query *query, int element)
{
    const sbi_embed_volume *volume = query->volume;
    int before = -1;
    for (int step = 0; step < 1000 && !volume->is_box; step++) {
        sb_real bary[4], lowest = 0;
        int next = -1;
        sbi_embed_planes(volume, element, query->point, bary);
        for (int a = 0; a < 4; a++) {
            int other = volume->neighbours.items[4 * (size_t)element + sbi_embed_opposite[a]];
            if (bary[a] < lowest && other >= 0 && other != before) {
                lowest = bary[a];
                next = other;
            }
        }
        if (next < 0)
            break;
        before = element;
        element = next;
    }
    return element;
}

static sb_real sbi_embed_box_distance2(const sbi_embed_box *box, sb_vec3 p)
{
    sb_real x = sb_max(sb_max(box->low.x - p.x, p.x - box->high.x), 0);
    sb_real y = sb_max(sb_max(box->low.y - p.y, p.y - box->high.y), 0);
    sb_real z = sb_max(sb_max(box->low.z - p.z, p.z - box->high.z), 0);
    return x * x + y * y + z * z;
}

/* 1 when the straight tet has the point. */
static int sbi_embed_has(const sbi_embed_query *query, int element)
{
    sb_real bary[4];
    sbi_embed_barycentric(query->volume, element, query->point, bary);
    return bary[0] >= 0 && bary[1] >= 0 && bary[2] >= 0 && bary[3] >= 0;
}

/* A straight tet that has the point, or `element` where the boxes show none: a start without walks. */
static int sbi_embed_find_start(const sbi_embed_query *query, int element)
{
    const sbi_embed_volume *volume = query->volume;
    int stack[SBI_EMBED_DEPTH], depth = 0;
    if (volume->is_box || sbi_embed_has(query, element))
        return element;
    stack[depth++] = 0;
    while (depth > 0) {
        int box = stack[--depth];
        if (sbi_embed_box_distance2(&volume->boxes[box], query->point) > 0)
            continue;
        if (box < volume->leaf_first) {
            stack[depth++] = 2 * box + 2;
            stack[depth++] = 2 * box + 1;
        }
        for (int k = 0; k < SBI_EMBED_LEAF && box >= volume->leaf_first; k++) {
            long long at = (long long)(box - volume->leaf_first) * SBI_EMBED_LEAF + k;
            if (at < volume->mesh->element_count && sbi_embed_has(query, volume->order[at]))
                return volume->order[at];
        }
    }
    return element;
}

/* Branch and bound: every element whose box is nearer than the best so far, nearer boxes first. */
static void sbi_embed_search_tree(sbi_embed_query *query)
{
    const sbi_embed_volume *volume = query->volume;
    int stack[SBI_EMBED_DEPTH], depth = 0;
    stack[depth++] = 0;
    while (depth > 0 && query->best.distance2 > query->enough) {
        int box = stack[--depth];
        if (sbi_embed_box_distance2(&volume->boxes[box], query->point) >= query->best.distance2)
            continue;
        if (box < volume->leaf_first) {
            int left = 2 * box + 1, right = left + 1;
            int left_first = sbi_embed_box_distance2(&volume->boxes[left], query->point) <=
                             sbi_embed_box_distance2(&volume->boxes[right], query->point);
            stack[depth++] = left_first ? right : left;
            stack[depth++] = left_first ? left : right;
        } else {
            for (int k = 0; k < SBI_EMBED_LEAF; k++) {
                long long at = (long long)(box - volume->leaf_first) * SBI_EMBED_LEAF + k;
                if (at < volume->mesh->element_count)
                    sbi_embed_try(query, volume->order[at]);
            }
        }
    }
}

/* Newton for x(xi) = point without bounds: a point inside solves it to rounding. */
static void sbi_embed_polish(const sbi_embed_volume *volume, sb_vec3 point, sbi_embed_hit *hit)
{
    for (int step = 0; step < 3; step++) {
        sb_mat3 jacobian;
        sb_vec3 r = sb_v3_sub(point, sbi_embed_map(volume->mesh, hit->element, hit->xi, &jacobian));
        sb_vec3 change;
        if (!(sb_m3_det(jacobian) > 0))
            return;
        change = sb_m3_apply(sb_m3_inverse(jacobian), r);
        hit->xi[0] += change.x;
        hit->xi[1] += change.y;
        hit->xi[2] += change.z;
        if (sb_abs(change.x) + sb_abs(change.y) + sb_abs(change.z) < 4 * SB_EPSILON)
            return;
    }
}

/* 1 when the hit lies on a face of its element that is a boundary face. */
static int sbi_embed_hit_is_outer(const sbi_embed_volume *volume, const sbi_embed_hit *hit)
{
    const int *outer = volume->boundary_face + (size_t)hit->element * (size_t)volume->faces;
    for (int f = 0; f < volume->faces; f++)
        if (hit->active >> f & 1u && outer[f] >= 0)
            return 1;
    return 0;
}

/* A closest point on an edge or corner may have been found in an element without a boundary face there: goes on through
 * the faces that it lies on to one that has. Leaves the hit as it is when there is none among the nearest. */
static void sbi_embed_reach_boundary(const sbi_embed_query *query, sbi_embed_hit *hit)
{
    enum { MOST = 64 };
    const sbi_embed_volume *volume = query->volume;
    sbi_embed_hit queue[MOST];
    int count = 1;
    queue[0] = *hit;
    for (int i = 0; i < count; i++) {
        if (sbi_embed_hit_is_outer(volume, &queue[i])) {
            *hit = queue[i];
            return;
        }
        for (int f = 0; f < volume->faces; f++) {
            int next = volume->neighbours.items[(size_t)queue[i].element * (size_t)volume->faces + (size_t)f];
            int known = next < 0 || count == MOST || !(queue[i].active >> f & 1u);
            sbi_embed_query there = *query;
            for (int k = 0; k < count && !known; k++)
                known = queue[k].element == next;
            if (known)
                continue;
            there.best.distance2 = hit->distance2 * ((sb_real)1 + 100 * sb_sqrt(SB_EPSILON));
            there.best.element = -1;
            sbi_embed_try(&there, next);
            if (there.best.element >= 0)
                queue[count++] = there.best;
        }
    }
}

SBI_API void sbi_embed_closest(const sbi_embed_volume *volume, sb_vec3 point, int hint, sbi_embed_hit *hit)
{
    sbi_embed_query query;
    sb_real slack = 64 * SB_EPSILON * volume->scale;
    query.volume = volume;
    query.point = point;
    query.best.element = hint;
    query.best.xi[0] = query.best.xi[1] = query.best.xi[2] = 0;
    query.best.active = 0;
    query.best.distance2 = SB_REAL_MAX;
    query.enough = slack * slack;
    sbi_embed_try(&query, volume->neighbours.items ? sbi_embed_walk(&query, hint) : sbi_embed_find_start(&query, hint));
    sbi_embed_search_tree(&query);
    if (sbi_embed_is_flat(volume, query.best.element)) /* the straight tet that stood in for it is off by as much */
        slack += volume->bulge[query.best.element];
    if (query.best.distance2 <= slack * slack) {
        query.best.distance2 = 0;
        sbi_embed_polish(volume, point, &query.best);
    } else if (volume->neighbours.items) {
        sbi_embed_reach_boundary(&query, &query.best);
    }
    *hit = query.best;
}
