/* cavity_law: volume of one cavity, its law, and the rank-one stiffness of all. */
#include "cavity_law.h"

#include <string.h>

/* ---- laws ---- */

static sb_result sbi_cavity_check_table(const sbi_cavity *cavity, sb_error *error)
{
    const sb_real *v = cavity->table_volume, *p = cavity->table_pressure;
    if (cavity->point_count < 2 || cavity->point_count > SB_MAX_CAVITY_POINTS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cavity's table has %d points", cavity->point_count);
    for (int k = 0; k < cavity->point_count; k++)
        if (!sb_is_finite(v[k]) || !sb_is_finite(p[k]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "point %d of a cavity's table is not finite", k);
    for (int k = 1; k < cavity->point_count; k++)
        if (!(v[k] > v[k - 1]) || p[k] > p[k - 1])
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "point %d of a cavity's table has no larger volume than the one before, or more pressure",
                            k);
    return SB_OK;
}

SBI_API sb_result sbi_cavity_check_law(const sbi_cavity *cavity, const sbi_cavity_law *law, sb_error *error)
{
    if ((int)law->kind < SB_CAVITY_PRESSURE || (int)law->kind > SB_CAVITY_TABLE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cavity has the unknown kind %d", (int)law->kind);
    if (!sb_is_finite(law->pressure) || !sb_is_finite(law->ambient) || !sb_is_finite(law->exponent) ||
        !sb_is_finite(law->bulk) || !sb_is_finite(law->filled) || !sb_is_finite(law->share))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "pressure, modulus or contents of a cavity are not finite");
    if (law->kind == SB_CAVITY_TABLE)
        return sbi_cavity_check_table(cavity, error);
    if (law->kind != SB_CAVITY_PRESSURE && !(law->filled > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cavity is filled with %g m^3", (double)law->filled);
    if (law->kind == SB_CAVITY_GAS && (law->ambient < 0 || law->exponent < 0 || !(law->ambient + law->pressure > 0)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "gas of %g Pa in %g Pa, exponent %g", (double)law->pressure,
                        (double)law->ambient, (double)law->exponent);
    if (law->kind == SB_CAVITY_LIQUID && !(law->bulk > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a liquid has the bulk modulus %g", (double)law->bulk);
    return SB_OK;
}

/* On the way from the last static solve to now. */
static sbi_cavity_law sbi_cavity_law_at(const sbi_cavity *cavity, sb_real factor)
{
    const sbi_cavity_law *from = &cavity->balanced;
    sbi_cavity_law law = cavity->law;
    if (factor == 1)
        return law;
    law.pressure = from->pressure + factor * (law.pressure - from->pressure);
    law.filled = from->filled + factor * (law.filled - from->filled);
    law.share = from->share + factor * (law.share - from->share);
    return law;
}

/* The part of the table for v. */
static int sbi_cavity_part(const sbi_cavity *cavity, double v)
{
    int k = 0;
    while (k + 2 < cavity->point_count && v > (double)cavity->table_volume[k + 1])
        k++;
    return k;
}

/* Pressure, and -dp/dV, of a table at v. */
static double sbi_cavity_look_up(const sbi_cavity *cavity, double v, double *stiff)
{
    int k = sbi_cavity_part(cavity, v);
    double from = (double)cavity->table_volume[k], way = (double)cavity->table_volume[k + 1] - from;
    double p = (double)cavity->table_pressure[k], fall = p - (double)cavity->table_pressure[k + 1];
    *stiff = fall / way;
    return p - *stiff * (v - from);
}

/* Integral of the table's pressure from its first volume to v. */
static double sbi_cavity_add_up(const sbi_cavity *cavity, double v)
{
    double sum = 0, stiff;
    int last = sbi_cavity_part(cavity, v);
    for (int k = 0; k <= last; k++) {
        double from = (double)cavity->table_volume[k], to = k < last ? (double)cavity->table_volume[k + 1] : v;
        sum += (to - from) * (sbi_cavity_look_up(cavity, (from + to) / 2, &stiff));
    }
    return sum;
}

/* V of the law at the held pressure. */
static double sbi_cavity_volume_of(const sbi_cavity_law *law, double pressure)
{
    double strain = law->kind == SB_CAVITY_LIQUID ? (pressure - (double)law->pressure) / (double)law->bulk : 0;
    return (double)law->filled * (1 - strain);
}

/* (filled / V)^power */
static double sbi_cavity_power(const sbi_cavity_law *law, double volume, double power)
{
    return volume > 0 ? sbi_dense_exp(power * sbi_dense_log((double)law->filled / volume)) : (double)SB_REAL_MAX;
}

static void sbi_cavity_ask(sbi_cavity *cavity, const sbi_cavity_law *law)
{
    double v = cavity->volume, absolute;
    cavity->stiff = 0;
    cavity->pressure = (double)law->pressure;
    if (law->kind == SB_CAVITY_GAS) {
        absolute = ((double)law->ambient + (double)law->pressure) * sbi_cavity_power(law, v, (double)law->exponent);
        cavity->pressure = absolute - (double)law->ambient;
        cavity->stiff = (double)law->exponent * absolute / v;
    } else if (law->kind == SB_CAVITY_TABLE) {
        cavity->pressure = (double)law->share * sbi_cavity_look_up(cavity, v - (double)law->filled, &cavity->stiff);
        cavity->stiff *= (double)law->share;
    } else if (law->kind != SB_CAVITY_PRESSURE) {
        cavity->stiff = (double)cavity->hold.stiff;
        cavity->pressure = (double)cavity->hold.pressure +
                           cavity->stiff * (sbi_cavity_volume_of(law, (double)cavity->hold.pressure) - v);
    }
}

SBI_API double sbi_cavity_energy(const sbi_load *load, sb_real factor)
{
    const sbi_cavity *cavity = &load->cavity;
    sbi_cavity_law law = sbi_cavity_law_at(cavity, factor);
    double v = cavity->volume, more = v - (double)law.filled, k = (double)law.exponent, absolute, off;
    switch (law.kind) {
    case SB_CAVITY_PRESSURE: return -(double)law.pressure * more;
    case SB_CAVITY_GAS:
        if (!(v > 0))
            return (double)SB_REAL_MAX;
        absolute = ((double)law.ambient + (double)law.pressure) * (double)law.filled;
        off = k == 1 ? -sbi_dense_log((double)law.filled / v) : (sbi_cavity_power(&law, v, k - 1) - 1) / (1 - k);
        return (double)law.ambient * more - absolute * off;
    case SB_CAVITY_TABLE: return -(double)law.share * sbi_cavity_add_up(cavity, v - (double)law.filled);
    default: break;
    }
    off = v - sbi_cavity_volume_of(&law, (double)cavity->hold.pressure);
    return off * ((double)cavity->hold.stiff * off / 2 - (double)cavity->hold.pressure);
}

SBI_API int sbi_cavity_is_stiff(const sbi_load *load)
{
    return load->kind == SBI_LOAD_CAVITY &&
           (load->cavity.law.kind == SB_CAVITY_LIQUID || load->cavity.law.kind == SB_CAVITY_VOLUME);
}

SBI_API double sbi_cavity_hold_pressure(sbi_load *load, sb_real factor)
{
    sbi_cavity *cavity = &load->cavity;
    sbi_cavity_law law = sbi_cavity_law_at(cavity, factor);
    double off = sbi_cavity_volume_of(&law, cavity->pressure) - cavity->volume;
    cavity->hold.pressure = (sb_real)cavity->pressure;
    return cavity->volume != 0 ? off / cavity->volume : 0;
}

SBI_API void sbi_cavity_relax(sbi_load *load)
{
    sbi_cavity *cavity = &load->cavity;
    cavity->balanced = cavity->law;
    cavity->balanced.pressure = cavity->balanced.share = 0;
    if (cavity->law.kind != SB_CAVITY_TABLE && cavity->volume > 0)
        cavity->balanced.filled = (sb_real)cavity->volume;
}

SBI_API void sbi_cavity_settle(sbi_load *load, sb_real factor)
{
    load->cavity.balanced = sbi_cavity_law_at(&load->cavity, factor);
}

/* ---- rims ---- */

/* Follows rims from edge to edge, so that each is a run of the list. */
static sb_result sbi_cavity_order_rims(sbi_load *load, sb_error *error)
{
    sbi_cavity_edge *rim = load->cavity.rim;
    int loop = 0, first = 0;
    for (int k = 0; k < load->cavity.rim_count; k++) {
        int next = -1;
        rim[k].loop = loop;
        for (int m = first; m < load->cavity.rim_count; m++)
            if (rim[m].nodes[0] == rim[k].nodes[2] && (m == first || m > k)) {
                if (next >= 0)
                    next = -2;
                next = next == -1 ? m : -2;
            }
        if (next < 0)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, rim[k].nodes[2],
                                 "rims of the cavity touch at node %d, or a face is there twice", rim[k].nodes[2]);
        if (next == first) {
            first = k + 1;
            loop++;
        } else {
            sbi_cavity_edge swapped = rim[k + 1];
            rim[k + 1] = rim[next];
            rim[next] = swapped;
        }
    }
    return SB_OK;
}

/* Edge k of a face, against the way that its face goes round: the lid's way. */
static void sbi_cavity_put_edge(const sbi_load *load, int face, int k, sbi_cavity_edge *edge)
{
    const int *nodes = load->nodes + load->row_start[face];
    int local[3];
    int count = sb_element_edge(load->face_types[face], k, local);
    edge->nodes[0] = nodes[local[1]];
    edge->nodes[1] = count == 3 ? nodes[local[2]] : -1;
    edge->nodes[2] = nodes[local[0]];
    edge->loop = 0;
}

SBI_API sb_result sbi_cavity_find_rims(const sb_body *body, sbi_load *load, sb_error *error)
{
    sb_index_table neighbours;
    sb_mesh faces;
    int width, count = 0;
    sb_result result;
    memset(&faces, 0, sizeof faces);
    if (load->row_count == 0)
        return SB_OK;
    faces.nodes = body->reference;
    faces.node_count = body->domain.node_count;
    faces.elements = load->nodes;
    faces.element_count = load->row_count;
    faces.element_type = load->face_types[0];
    result = sb_mesh_neighbours(&faces, &body->allocator, &neighbours, error);
    if (result != SB_OK)
        return result;
    width = sb_element_edge_count(faces.element_type);
    for (int k = 0; k < width * load->row_count; k++)
        count += neighbours.items[k] < 0;
    if (count > 0)
        load->cavity.rim =
            (sbi_cavity_edge *)sbi_alloc_zeroed(&body->allocator, (size_t)count, sizeof(sbi_cavity_edge));
    if (count > 0 && !load->cavity.rim)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rims of a cavity");
    for (int k = 0; result == SB_OK && k < width * load->row_count; k++)
        if (neighbours.items[k] < 0)
            sbi_cavity_put_edge(load, k / width, k % width, load->cavity.rim + load->cavity.rim_count++);
    sb_index_table_free(&neighbours);
    return result == SB_OK ? sbi_cavity_order_rims(load, error) : result;
}

/* ---- shares ---- */

static sb_vec3 sbi_cavity_at(const sb_body *body, int node, const sb_vec3 *u, sb_vec3 origin)
{
    return sb_v3_sub(sb_v3_add(body->reference[node], u[node]), origin);
}

static void sbi_cavity_gather_edge(const sb_body *body, const sbi_cavity_edge *edge, const sb_vec3 *u, sb_vec3 origin,
                                   sb_vec3 x[3])
{
    for (int i = 0; i < 3; i++)
        x[i] = edge->nodes[i] < 0 ? sb_v3(0, 0, 0) : sbi_cavity_at(body, edge->nodes[i], u, origin);
}

/* Shape functions of an edge at s in [0, 1], and their derivatives. */
static void sbi_cavity_edge_shape(int middle, sb_real s, sb_real shape[3], sb_real slope[3])
{
    shape[0] = middle ? (1 - s) * (1 - 2 * s) : 1 - s;
    shape[1] = middle ? 4 * s * (1 - s) : 0;
    shape[2] = middle ? s * (2 * s - 1) : s;
    slope[0] = middle ? 4 * s - 3 : -1;
    slope[1] = middle ? 4 - 8 * s : 0;
    slope[2] = middle ? 4 * s - 1 : 1;
}

/* What the fan from c over an edge gives its nodes, taken off, as the faces are seen from the body; returns what it
 * gives c. */
static sb_vec3 sbi_cavity_share_edge(sbi_cavity_edge *edge, const sb_vec3 x[3], sb_vec3 c)
{
    static const sb_real points[3] = {(sb_real)0.1127016653792583, (sb_real)0.5, (sb_real)0.8872983346207417};
    static const sb_real weights[3] = {(sb_real)5 / 18, (sb_real)8 / 18, (sb_real)5 / 18};
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int p = 0; p < 3; p++) {
        sb_real shape[3], slope[3];
        sb_vec3 at = sb_v3_scale(-1, c), way = sb_v3(0, 0, 0), swept;
        sbi_cavity_edge_shape(edge->nodes[1] >= 0, points[p], shape, slope);
        for (int i = 0; i < 3; i++) {
            at = sb_v3_madd(at, shape[i], x[i]);
            way = sb_v3_madd(way, slope[i], x[i]);
        }
        swept = sb_v3_scale(-weights[p], sb_v3_cross(at, way));
        for (int i = 0; i < 3; i++)
            edge->share[i] = sb_v3_madd(edge->share[i], shape[i] / 3, swept);
        sum = sb_v3_madd(sum, (sb_real)1 / 6, swept);
    }
    return sum;
}

/* The lid of one rim, edges first .. end - 1. */
static void sbi_cavity_close_rim(const sb_body *body, sbi_load *load, int first, int end, const sb_vec3 *u,
                                 sb_vec3 origin)
{
    sbi_cavity_edge *rim = load->cavity.rim;
    sb_vec3 x[3], middle = sb_v3(0, 0, 0), sum = middle;
    sb_real part = (sb_real)1 / (sb_real)(end - first);
    for (int k = first; k < end; k++)
        middle = sb_v3_madd(middle, part, sbi_cavity_at(body, rim[k].nodes[0], u, origin));
    for (int k = first; k < end; k++) {
        sbi_cavity_gather_edge(body, rim + k, u, origin, x);
        memset(rim[k].share, 0, sizeof rim[k].share);
        sum = sb_v3_add(sum, sbi_cavity_share_edge(rim + k, x, middle));
    }
    for (int k = first; k < end; k++)
        rim[k].share[0] = sb_v3_madd(rim[k].share[0], part, sum);
}

/* Entry k of g: those of faces, then three of each edge; 0: there is none. */
SBI_API int sbi_cavity_entry(const sbi_load *load, int k, int *node, sb_vec3 *share)
{
    int faces = load->row_start[load->row_count];
    const sbi_cavity_edge *edge = load->cavity.rim + (k < faces ? 0 : (k - faces) / 3);
    *node = k < faces ? load->nodes[k] : edge->nodes[(k - faces) % 3];
    if (*node < 0)
        return 0;
    *share = k < faces ? load->cavity.share[k] : edge->share[(k - faces) % 3];
    return 1;
}

SBI_API int sbi_cavity_entries(const sbi_load *load)
{
    return load->row_start[load->row_count] + 3 * load->cavity.rim_count;
}

/* Shares of the faces, which are of one type: int N_a x_r x x_s, taken off as they are seen from the body. */
static void sbi_cavity_share_faces(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_vec3 origin)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_element_type type = load->row_count > 0 ? load->face_types[0] : SB_TRI3;
    int count = sb_element_quadrature(type, SB_QUADRATURE_FACE, points, weights), size = sb_element_node_count(type);
    memset(load->cavity.share, 0, (size_t)load->row_start[load->row_count] * sizeof *load->cavity.share);
    for (int p = 0; p < count; p++) {
        sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3];
        sb_element_shape(type, points[p], shape, gradient);
        for (int j = 0; j < load->row_count; j++) {
            sb_vec3 r = sb_v3(0, 0, 0), s = r, push, *share = load->cavity.share + load->row_start[j];
            for (int a = 0; a < size; a++) {
                sb_vec3 x = sbi_cavity_at(body, load->nodes[load->row_start[j] + a], u, origin);
                r = sb_v3_madd(r, gradient[a][0], x);
                s = sb_v3_madd(s, gradient[a][1], x);
            }
            push = sb_v3_scale(-weights[p], sb_v3_cross(r, s));
            for (int a = 0; a < size; a++)
                share[a] = sb_v3_madd(share[a], shape[a], push);
        }
    }
}

SBI_API void sbi_cavity_lay(const sb_body *body, sbi_load *load, const sb_vec3 *u, sb_real factor)
{
    sbi_cavity *cavity = &load->cavity;
    sbi_cavity_law law = sbi_cavity_law_at(cavity, factor);
    sb_vec3 origin = sb_v3(0, 0, 0);
    if (load->row_count > 0)
        origin = sbi_cavity_at(body, load->nodes[0], u, origin);
    sbi_cavity_share_faces(body, load, u, origin);
    for (int first = 0, end; first < cavity->rim_count; first = end) {
        for (end = first; end < cavity->rim_count && cavity->rim[end].loop == cavity->rim[first].loop;)
            end++;
        sbi_cavity_close_rim(body, load, first, end, u, origin);
    }
    cavity->volume = 0;
    for (int k = 0; k < sbi_cavity_entries(load); k++) { /* V is cubic: 3 V = g.x */
        int node;
        sb_vec3 share;
        if (sbi_cavity_entry(load, k, &node, &share))
            cavity->volume += (double)sb_v3_dot(share, sbi_cavity_at(body, node, u, origin)) / 3;
    }
    sbi_cavity_ask(cavity, &law);
}

SBI_API void sbi_cavity_add_force(const sbi_load *load, sb_real pressure, sb_vec3 *out)
{
    for (int k = 0; k < sbi_cavity_entries(load); k++) {
        int node;
        sb_vec3 share;
        if (sbi_cavity_entry(load, k, &node, &share))
            out[node] = sb_v3_madd(out[node], pressure, share);
    }
}

SBI_API double sbi_cavity_square(const sbi_load *load)
{
    double sum = 0;
    for (int k = 0; k < sbi_cavity_entries(load); k++) {
        int node;
        sb_vec3 share;
        if (sbi_cavity_entry(load, k, &node, &share))
            sum += (double)sb_v3_dot(share, share);
    }
    return sum;
}

/* Where a node goes by x: by that of its masters where constraints condense it. */
static sb_vec3 sbi_cavity_motion(const sbi_elimination *e, int node, const sb_vec3 *x)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    if (!e || e->first[node] == e->first[node + 1])
        return x[node];
    for (int k = e->first[node]; k < e->first[node + 1]; k++) {
        const sb_real *w = e->weight[k];
        sb_vec3 v = x[e->master[k]];
        sum = sb_v3_add(sum, sb_v3(w[0] * v.x + w[1] * v.y + w[2] * v.z, w[3] * v.x + w[4] * v.y + w[5] * v.z,
                                   w[6] * v.x + w[7] * v.y + w[8] * v.z));
    }
    return sum;
}

static double sbi_cavity_condensed_growth(const sbi_elimination *e, const sbi_load *load, const sb_vec3 *x)
{
    double sum = 0;
    for (int k = 0; k < sbi_cavity_entries(load); k++) {
        int node;
        sb_vec3 share;
        if (sbi_cavity_entry(load, k, &node, &share))
            sum += (double)sb_v3_dot(share, sbi_cavity_motion(e, node, x));
    }
    return sum;
}

SBI_API double sbi_cavity_growth(const sb_body *body, const sbi_load *load, const sb_vec3 *x)
{
    (void)body;
    return sbi_cavity_condensed_growth(NULL, load, x);
}

/* y += f at a node, or at its masters, but for axes that are held. */
static void sbi_cavity_spread(const sb_body *body, int node, sb_vec3 f, sb_vec3 *y)
{
    const sbi_elimination *e = body->elimination;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    if (!e || e->first[node] == e->first[node + 1]) {
        y[node] = sb_v3_add(y[node], sbi_body_pick_axes(sbi_body_held(body, node), zero, f));
        return;
    }
    for (int k = e->first[node]; k < e->first[node + 1]; k++) {
        const sb_real *w = e->weight[k];
        int to = e->master[k];
        sb_vec3 part = sb_v3(w[0] * f.x + w[3] * f.y + w[6] * f.z, w[1] * f.x + w[4] * f.y + w[7] * f.z,
                             w[2] * f.x + w[5] * f.y + w[8] * f.z);
        y[to] = sb_v3_add(y[to], sbi_body_pick_axes(sbi_body_held(body, to), zero, part));
    }
}

SBI_API void sbi_cavity_add_bound(const sbi_load *load, sb_matrix *matrix)
{
    sb_real all = 0;
    if (!(load->cavity.stiff > 0))
        return;
    for (int pass = 0; pass < 2; pass++)
        for (int k = 0; k < sbi_cavity_entries(load); k++) {
            int node;
            sb_vec3 share;
            sb_real size[3], *block;
            if (!sbi_cavity_entry(load, k, &node, &share))
                continue;
            size[0] = sb_abs(share.x), size[1] = sb_abs(share.y), size[2] = sb_abs(share.z);
            all += pass ? 0 : size[0] + size[1] + size[2];
            block = matrix->blocks[matrix->diagonal[node]];
            for (int axis = 0; pass && axis < 3; axis++)
                block[4 * axis] += (sb_real)load->cavity.stiff * all * size[axis];
        }
}

SBI_API int sbi_cavity_corrects(const sb_body *body)
{
    return body->integrator == SB_EULER || body->integrator == SB_GENERALISED_ALPHA;
}

/* a.b over all nodes */
static double sbi_cavity_dot(const sb_body *body, const sb_vec3 *a, const sb_vec3 *b)
{
    double sum = 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += (double)sb_v3_dot(a[i], b[i]);
    return sum;
}

SBI_API void sbi_cavity_stiffen(sb_body *body, sbi_load *load, sb_real factor, sb_real mass)
{
    const double most = 100;
    sbi_cavity *cavity = &load->cavity;
    sbi_cavity_law law = sbi_cavity_law_at(cavity, factor);
    double wanted = law.kind == SB_CAVITY_LIQUID ? (double)law.bulk / (double)law.filled : (double)SB_REAL_MAX;
    double stiff, square, limit;
    memset(body->work, 0, (size_t)body->domain.node_count * sizeof *body->work);
    sbi_cavity_add_force(load, 1, body->work);
    for (int i = 0; i < body->domain.node_count; i++)
        body->work[i] = sbi_body_pick_axes(body->fixed[i], sb_v3(0, 0, 0), body->work[i]);
    square = sbi_cavity_dot(body, body->work, body->work);
    sb_matrix_multiply(&body->matrix, &body->work[0].x, &body->work2[0].x, &body->jobs);
    stiff = sbi_cavity_dot(body, body->work, body->work2);
    if (mass > 0 && !sbi_cavity_corrects(body)) {
        sbi_body_mass_multiply(body, body->work, body->work2);
        stiff -= (double)mass * sbi_cavity_dot(body, body->work, body->work2);
    }
    limit = square > 0 && stiff > 0 ? most * (stiff / square) / square : 0; /* nothing moves: none is felt */
    cavity->hold.stiff = (sb_real)(wanted < limit ? wanted : limit);
    sbi_cavity_ask(cavity, &law);
}

/* ---- all of a body ---- */

SBI_API int sbi_cavities_resist(const sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        if (body->loads[l].kind == SBI_LOAD_CAVITY && body->loads[l].cavity.stiff > 0)
            return 1;
    return 0;
}

SBI_API double sbi_cavities_multiply(const sb_body *body, const sb_vec3 *x, int condensed, sb_vec3 *y)
{
    double sum = 0;
    for (int l = 0; l < body->load_count; l++) {
        const sbi_load *load = body->loads + l;
        double growth, pressure;
        if (load->kind != SBI_LOAD_CAVITY || !(load->cavity.stiff > 0))
            continue;
        growth = sbi_cavity_condensed_growth(condensed ? body->elimination : NULL, load, x);
        pressure = load->cavity.stiff * growth;
        sum += pressure * growth;
        if (!condensed)
            sbi_cavity_add_force(load, (sb_real)pressure, y);
        for (int k = 0; condensed && k < sbi_cavity_entries(load); k++) {
            int node;
            sb_vec3 share;
            if (sbi_cavity_entry(load, k, &node, &share))
                sbi_cavity_spread(body, node, sb_v3_scale((sb_real)pressure, share), y);
        }
    }
    return sum;
}

SBI_API void sbi_cavities_save(sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        body->loads[l].cavity.saved = body->loads[l].cavity.hold;
}

SBI_API void sbi_cavities_restore(sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        body->loads[l].cavity.hold = body->loads[l].cavity.saved;
}

SBI_API void sbi_cavities_keep(sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        body->loads[l].cavity.kept = body->loads[l].cavity.hold;
}

SBI_API void sbi_cavities_go_back(sb_body *body)
{
    for (int l = 0; l < body->load_count; l++)
        body->loads[l].cavity.hold = body->loads[l].cavity.kept;
}
