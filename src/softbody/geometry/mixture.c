/* mixture: shares of elements in shapes by clipped tets, and the body's cells made of them. */
#include "mixture.h"

#include <string.h>

#include "../base/sort.h"

#define SBI_MIXTURE_COOKIE 0x3177u

SB_API sb_mixture_def sb_default_mixture_def(void)
{
    sb_mixture_def def;
    memset(&def, 0, sizeof def);
    def.level = 4;
    def.least_share = (sb_real)1e-3;
    def.mean = SB_MIXTURE_VOIGT;
    def.cookie = SBI_MIXTURE_COOKIE;
    return def;
}

SB_API void sb_mixture_free(sb_mixture *mixture)
{
    sb_allocator allocator;
    if (!mixture)
        return;
    allocator = mixture->allocator;
    sb_mesh_free(&mixture->body_mesh);
    sb_domain_free(&mixture->domain);
    sbi_free(&allocator, mixture->elements);
    sbi_free(&allocator, mixture->shares);
    sbi_free(&allocator, mixture->regions);
    sbi_free(&allocator, mixture->region_volumes);
    memset(mixture, 0, sizeof *mixture);
}

/* ---- what is worked on ---- */

/* What a region has of an element; also of all: volumes. */
typedef struct sbi_mixture_part {
    int element, region;
    double share;
    double weight; /* share as the stiffness has it */
} sbi_mixture_part;

typedef struct sbi_mixture_parts {
    sbi_mixture_part *items; /* [room] */
    size_t count, room;
} sbi_mixture_parts;

/* The element in work: shapes by number, parts[0] of its own region, parts[i + 1] of shape i. */
typedef struct sbi_mixture_work {
    const sb_mixture_def *def;
    int nodes, is_tet, side;                     /* nodes of an element; points along a side of the lattice */
    sb_real *functions;                          /* [side^3][nodes] shape functions at the lattice's points */
    sb_vec3 *points;                             /* [side^3] of the element (m) */
    double *values;                              /* [SB_MIXTURE_MAX_SHAPES][side^3] distances of open shapes */
    int open[SB_MIXTURE_MAX_SHAPES], open_count; /* shapes whose surface may cross the element, ascending */
    int base;                                    /* part of what lies in none of them */
    double parts[SB_MIXTURE_MAX_SHAPES + 1];     /* m^3 */
    sbi_mixture_parts found;
} sbi_mixture_work;

static sb_real sbi_mixture_distance(const sb_shape *shape, sb_vec3 point)
{
    return shape->surface ? sb_surface_signed_distance_winding(shape->surface, point, NULL)
                          : shape->distance(shape->user, point);
}

/* ---- lattice of an element ----
 * Points (x, y, z) in [0, level]^3; each cube of it falls into the six tets whose corners are reached by one step along
 * each axis in some order. Of a tet those with x >= y >= z are there, and its own corners are (0 0 0), (n 0 0), (n n 0)
 * and (n n n). */

static const unsigned char sbi_mixture_orders[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2},
                                                       {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};

static size_t sbi_mixture_index(const sbi_mixture_work *w, const int at[3])
{
    return ((size_t)at[2] * (size_t)w->side + (size_t)at[1]) * (size_t)w->side + (size_t)at[0];
}

static int sbi_mixture_has_point(const sbi_mixture_work *w, const int at[3])
{
    return !w->is_tet || (at[0] >= at[1] && at[1] >= at[2]);
}

static void sbi_mixture_lay_lattice(sbi_mixture_work *w)
{
    const sb_real n = (sb_real)w->def->level;
    int at[3];
    for (at[2] = 0; at[2] < w->side; at[2]++)
        for (at[1] = 0; at[1] < w->side; at[1]++)
            for (at[0] = 0; at[0] < w->side; at[0]++) {
                sb_real xi[3];
                if (!sbi_mixture_has_point(w, at))
                    continue;
                for (int c = 0; c < 3; c++)
                    xi[c] = w->is_tet ? (sb_real)(at[c] - (c < 2 ? at[c + 1] : 0)) / n : 2 * (sb_real)at[c] / n - 1;
                sb_element_shape(w->def->mesh->element_type, xi,
                                 w->functions + sbi_mixture_index(w, at) * (size_t)w->nodes, NULL);
            }
}

static void sbi_mixture_place_points(sbi_mixture_work *w, const int *nodes)
{
    int at[3];
    for (at[2] = 0; at[2] < w->side; at[2]++)
        for (at[1] = 0; at[1] < w->side; at[1]++)
            for (at[0] = 0; at[0] < w->side; at[0]++) {
                size_t point = sbi_mixture_index(w, at);
                sb_vec3 sum = sb_v3(0, 0, 0);
                if (!sbi_mixture_has_point(w, at))
                    continue;
                for (int a = 0; a < w->nodes; a++)
                    sum = sb_v3_madd(sum, w->functions[point * (size_t)w->nodes + (size_t)a],
                                     w->def->mesh->nodes[nodes[a]]);
                w->points[point] = sum;
            }
}

/* Distances of an open shape; 0 when one is not finite. */
static int sbi_mixture_sample(sbi_mixture_work *w, int number)
{
    const sb_shape *shape = w->def->shapes + w->open[number];
    size_t count = (size_t)w->side * (size_t)w->side * (size_t)w->side;
    int at[3];
    for (at[2] = 0; at[2] < w->side; at[2]++)
        for (at[1] = 0; at[1] < w->side; at[1]++)
            for (at[0] = 0; at[0] < w->side; at[0]++) {
                size_t point = sbi_mixture_index(w, at);
                sb_real value;
                if (!sbi_mixture_has_point(w, at))
                    continue;
                value = sbi_mixture_distance(shape, w->points[point]);
                if (!sb_is_finite(value))
                    return 0;
                w->values[(size_t)number * count + point] = (double)value;
            }
    return 1;
}

/* ---- clipping ---- */

/* A piece of a lattice's tet: its corners by their weights of that tet's corners. */
typedef struct sbi_mixture_tet {
    double at[4][4];
} sbi_mixture_tet;

/* The lattice's tet: its volume and the open shapes' values at its corners. */
typedef struct sbi_mixture_leaf {
    double volume;
    double values[SB_MIXTURE_MAX_SHAPES][4];
} sbi_mixture_leaf;

static double sbi_mixture_volume(const sbi_mixture_leaf *leaf, const sbi_mixture_tet *tet)
{
    double d[3][3];
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 3; c++)
            d[i][c] = tet->at[i + 1][c] - tet->at[0][c];
    return leaf->volume *
           fabs(d[0][0] * (d[1][1] * d[2][2] - d[1][2] * d[2][1]) - d[0][1] * (d[1][0] * d[2][2] - d[1][2] * d[2][0]) +
                d[0][2] * (d[1][0] * d[2][1] - d[1][1] * d[2][0]));
}

static void sbi_mixture_cut_edge(const double *inside, const double *outside, double f, double g, double *cut)
{
    double t = f / (f - g);
    for (int c = 0; c < 4; c++)
        cut[c] = inside[c] + t * (outside[c] - inside[c]);
}

/* Prism between the triangles p and q as three tets. */
static int sbi_mixture_prism(const double *const p[3], const double *const q[3], sbi_mixture_tet tets[3])
{
    const double *const corners[3][4] = {{p[0], p[1], p[2], q[2]}, {p[0], p[1], q[1], q[2]}, {p[0], q[0], q[1], q[2]}};
    for (int t = 0; t < 3; t++)
        for (int i = 0; i < 4; i++)
            memcpy(tets[t].at[i], corners[t][i], sizeof tets[t].at[i]);
    return 3;
}

static int sbi_mixture_corner(const double *tip, const double *const base[3], sbi_mixture_tet *tet)
{
    memcpy(tet->at[0], tip, sizeof tet->at[0]);
    for (int i = 0; i < 3; i++)
        memcpy(tet->at[i + 1], base[i], sizeof tet->at[i + 1]);
    return 1;
}

/* A tet with corners on both sides of a linear function: what is inside (f < 0) and outside as tets. */
static void sbi_mixture_clip(const sbi_mixture_tet *tet, const double f[4], sbi_mixture_tet in[3], int *in_count,
                             sbi_mixture_tet out[3], int *out_count)
{
    double cuts[4][4];
    const double *x[4];
    double g[4];
    int inside = 0;
    for (int side = 0, at = 0; side < 2; side++) /* those inside first */
        for (int i = 0; i < 4; i++)
            if ((f[i] < 0) == (side == 0)) {
                x[at] = tet->at[i];
                g[at++] = f[i];
                inside += side == 0;
            }
    if (inside == 2) {
        for (int k = 0; k < 4; k++) /* 0-2, 0-3, 1-2, 1-3 */
            sbi_mixture_cut_edge(x[k / 2], x[2 + k % 2], g[k / 2], g[2 + k % 2], cuts[k]);
        const double *const a[3] = {x[0], cuts[0], cuts[1]}, *const b[3] = {x[1], cuts[2], cuts[3]};
        const double *const c[3] = {x[2], cuts[0], cuts[2]}, *const d[3] = {x[3], cuts[1], cuts[3]};
        *in_count = sbi_mixture_prism(a, b, in);
        *out_count = sbi_mixture_prism(c, d, out);
        return;
    }
    const int tip = inside == 1 ? 0 : 3, first = inside == 1 ? 1 : 0;
    for (int k = 0; k < 3; k++) {
        int i = tip == 0 ? 0 : k, o = tip == 0 ? k + 1 : 3;
        sbi_mixture_cut_edge(x[i], x[o], g[i], g[o], cuts[k]);
    }
    const double *const base[3] = {x[first], x[first + 1], x[first + 2]};
    const double *const cut[3] = {cuts[0], cuts[1], cuts[2]};
    if (tip == 0) {
        *in_count = sbi_mixture_corner(x[0], cut, in);
        *out_count = sbi_mixture_prism(base, cut, out);
    } else {
        *out_count = sbi_mixture_corner(x[3], cut, out);
        *in_count = sbi_mixture_prism(base, cut, in);
    }
}

/* Gives each open shape from `number` down what no later one has of a piece. As deep as there are open shapes. */
static void sbi_mixture_divide(sbi_mixture_work *w, const sbi_mixture_leaf *leaf, const sbi_mixture_tet *tet,
                               int number)
{
    sbi_mixture_tet in[3], out[3];
    double f[4];
    int inside = 0, in_count, out_count;
    for (; number >= 0; number--) {
        inside = 0;
        for (int i = 0; i < 4; i++) {
            f[i] = 0;
            for (int c = 0; c < 4; c++)
                f[i] += tet->at[i][c] * leaf->values[number][c];
            inside += f[i] < 0;
        }
        if (inside > 0)
            break;
    }
    if (number < 0) {
        w->parts[w->base] += sbi_mixture_volume(leaf, tet);
        return;
    }
    if (inside == 4) {
        w->parts[w->open[number] + 1] += sbi_mixture_volume(leaf, tet);
        return;
    }
    sbi_mixture_clip(tet, f, in, &in_count, out, &out_count);
    for (int i = 0; i < in_count; i++)
        w->parts[w->open[number] + 1] += sbi_mixture_volume(leaf, in + i);
    for (int i = 0; i < out_count; i++)
        sbi_mixture_divide(w, leaf, out + i, number - 1);
}

static void sbi_mixture_divide_leaf(sbi_mixture_work *w, const size_t corners[4])
{
    const sbi_mixture_tet whole = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}};
    const size_t count = (size_t)w->side * (size_t)w->side * (size_t)w->side;
    sbi_mixture_leaf leaf;
    sb_vec3 x[4];
    for (int i = 0; i < 4; i++)
        x[i] = w->points[corners[i]];
    leaf.volume = fabs((double)sbi_domain_tet_volume(x));
    for (int k = 0; k < w->open_count; k++)
        for (int i = 0; i < 4; i++)
            leaf.values[k][i] = w->values[(size_t)k * count + corners[i]];
    sbi_mixture_divide(w, &leaf, &whole, w->open_count - 1);
}

static void sbi_mixture_divide_element(sbi_mixture_work *w)
{
    int cube[3];
    for (cube[2] = 0; cube[2] < w->def->level; cube[2]++)
        for (cube[1] = 0; cube[1] < w->def->level; cube[1]++)
            for (cube[0] = 0; cube[0] < w->def->level; cube[0]++)
                for (int order = 0; order < 6; order++) {
                    size_t corners[4];
                    int at[3] = {cube[0], cube[1], cube[2]}, whole = sbi_mixture_has_point(w, at);
                    corners[0] = sbi_mixture_index(w, at);
                    for (int i = 0; i < 3; i++) {
                        at[sbi_mixture_orders[order][i]]++;
                        whole = whole && sbi_mixture_has_point(w, at);
                        corners[i + 1] = sbi_mixture_index(w, at);
                    }
                    if (whole)
                        sbi_mixture_divide_leaf(w, corners);
                }
}

/* ---- elements ---- */

/* Nodes within this of the middle hold all points of an element within so many times it: shape functions of quadratic
 * elements are up to 5 in sum of magnitudes. */
static sb_real sbi_mixture_reach(const sbi_mixture_work *w, const int *nodes, sb_vec3 *middle)
{
    sb_real reach = 0;
    *middle = sb_v3(0, 0, 0);
    for (int a = 0; a < w->nodes; a++)
        *middle = sb_v3_madd(*middle, (sb_real)1 / (sb_real)w->nodes, w->def->mesh->nodes[nodes[a]]);
    for (int a = 0; a < w->nodes; a++)
        reach = sb_max(reach, sb_v3_norm(sb_v3_sub(w->def->mesh->nodes[nodes[a]], *middle)));
    return (w->nodes > 8 ? 5 : (sb_real)1.0001) * reach;
}

/* 1: all within `reach` of a point is inside, 0: outside, -1: open, -2: the distance is not finite. */
static int sbi_mixture_decide(const sb_shape *shape, sb_vec3 point, sb_real reach)
{
    sb_real value;
    if (shape->surface)
        return sb_surface_closest(shape->surface, point, reach, NULL) ? -1 : sb_surface_inside(shape->surface, point);
    value = shape->distance(shape->user, point);
    if (!sb_is_finite(value))
        return -2;
    return shape->max_slope > 0 && sb_abs(value) > shape->max_slope * reach ? value < 0 : -1;
}

static sb_result sbi_mixture_refuse_distance(int shape, int element, sb_error *error)
{
    return sbi_fail_element(error, SB_ERROR_NOT_FINITE, element,
                            "a distance of def.shapes[%d] in element %d is not finite", shape, element);
}

/* Which shapes are open in an element, and what lies in none of them. */
static sb_result sbi_mixture_classify(sbi_mixture_work *w, int element, const int *nodes, sb_error *error)
{
    int open[SB_MIXTURE_MAX_SHAPES], count = 0;
    sb_vec3 middle;
    sb_real reach = sbi_mixture_reach(w, nodes, &middle);
    w->base = 0;
    for (int s = w->def->shape_count - 1; s >= 0 && w->base == 0; s--) {
        int inside = sbi_mixture_decide(w->def->shapes + s, middle, reach);
        if (inside == -2)
            return sbi_mixture_refuse_distance(s, element, error);
        if (inside == 1)
            w->base = s + 1;
        if (inside == -1)
            open[count++] = s;
    }
    for (int k = 0; k < count; k++)
        w->open[k] = open[count - 1 - k];
    w->open_count = count;
    return SB_OK;
}

/* Volumes of an element's parts, or 1 where there is one only. */
static sb_result sbi_mixture_measure(sbi_mixture_work *w, int element, sb_error *error)
{
    const int *nodes = w->def->mesh->elements + (size_t)element * (size_t)w->nodes;
    sb_result result = sbi_mixture_classify(w, element, nodes, error);
    memset(w->parts, 0, sizeof w->parts);
    if (result != SB_OK)
        return result;
    if (w->open_count == 0) {
        w->parts[w->base] = 1;
        return SB_OK;
    }
    sbi_mixture_place_points(w, nodes);
    for (int k = 0; k < w->open_count; k++)
        if (!sbi_mixture_sample(w, k))
            return sbi_mixture_refuse_distance(w->open[k], element, error);
    sbi_mixture_divide_element(w);
    return SB_OK;
}

static int sbi_mixture_region(const sbi_mixture_work *w, int element, int part)
{
    if (part > 0)
        return w->def->shapes[part - 1].region;
    return w->def->mesh->regions ? w->def->mesh->regions[element] : 0;
}

static int sbi_mixture_push(sbi_mixture_parts *parts, const sb_allocator *allocator, const sbi_mixture_part *part)
{
    if (parts->count == parts->room) {
        size_t room = 2 * parts->room;
        sbi_mixture_part *items =
            room > parts->room ? (sbi_mixture_part *)sbi_alloc(allocator, room, sizeof *items) : NULL;
        if (!items)
            return 0;
        memcpy(items, parts->items, parts->count * sizeof *items);
        sbi_free(allocator, parts->items);
        parts->items = items;
        parts->room = room;
    }
    parts->items[parts->count++] = *part;
    return 1;
}

/* Stiffness of the wanted mean over that of Voigt's, of parts by region. */
static double sbi_mixture_softening(const sbi_mixture_work *w, const double *shares, const double *stiffness, int count)
{
    double voigt = 0, mean = 0;
    if (w->def->mean == SB_MIXTURE_VOIGT || count < 2)
        return 1;
    for (int k = 0; k < count; k++) {
        double relative = stiffness[k] / stiffness[0];
        voigt += shares[k] * relative;
        mean += shares[k] * (w->def->mean == SB_MIXTURE_REUSS ? 1 / relative : log(relative));
    }
    return (w->def->mean == SB_MIXTURE_REUSS ? 1 / mean : exp(mean)) / voigt;
}

/* Collects the volumes of the element's parts by region; returns how many regions there are. */
static int sbi_mixture_collect(const sbi_mixture_work *w, int element, int *regions, double *volumes, double *stiffness)
{
    int count = 0;
    for (int part = 0; part <= w->def->shape_count; part++) {
        int region = sbi_mixture_region(w, element, part), k = 0;
        if (!(w->parts[part] > 0))
            continue;
        while (k < count && regions[k] != region)
            k++;
        if (k == count) {
            regions[k] = region;
            volumes[k] = 0;
            stiffness[k] = w->def->stiffness ? (double)w->def->stiffness[part] : 1;
            count++;
        }
        volumes[k] += w->parts[part];
    }
    return count;
}

/* Volumes to shares: small ones go to the largest, which comes first; returns how many stay. */
static int sbi_mixture_make_shares(double least, int count, int *regions, double *volumes, double *stiffness)
{
    double sum = 0, rest = 1;
    int largest = 0, kept = 1;
    if (count == 0)
        return 0;
    for (int k = 0; k < count; k++) {
        sum += volumes[k];
        largest = volumes[k] > volumes[largest] ? k : largest;
    }
    { /* the largest and the first change places */
        int region = regions[0];
        double volume = volumes[0], stiff = stiffness[0];
        regions[0] = regions[largest], regions[largest] = region;
        volumes[0] = volumes[largest], volumes[largest] = volume;
        stiffness[0] = stiffness[largest], stiffness[largest] = stiff;
    }
    for (int k = 1; k < count; k++)
        if (volumes[k] / sum >= least && volumes[k] > 0) {
            regions[kept] = regions[k];
            stiffness[kept] = stiffness[k];
            volumes[kept] = volumes[k] / sum;
            rest -= volumes[kept++];
        }
    volumes[0] = rest;
    return kept;
}

static int sbi_mixture_keep_parts(sbi_mixture_work *w, int element)
{
    int regions[SB_MIXTURE_MAX_SHAPES + 1];
    double shares[SB_MIXTURE_MAX_SHAPES + 1], stiffness[SB_MIXTURE_MAX_SHAPES + 1], softening;
    int count = sbi_mixture_collect(w, element, regions, shares, stiffness);
    count = sbi_mixture_make_shares((double)w->def->least_share, count, regions, shares, stiffness);
    softening = sbi_mixture_softening(w, shares, stiffness, count);
    for (int k = 0; k < count; k++) {
        sbi_mixture_part part;
        part.element = element;
        part.region = regions[k];
        part.share = shares[k];
        part.weight = softening * shares[k];
        if (!sbi_mixture_push(&w->found, &w->def->allocator, &part))
            return 0;
    }
    return 1;
}

static sb_result sbi_mixture_find_parts(sbi_mixture_work *w, sb_error *error)
{
    const sb_allocator *allocator = &w->def->allocator;
    size_t points = (size_t)w->side * (size_t)w->side * (size_t)w->side;
    w->functions = (sb_real *)sbi_alloc(allocator, points, (size_t)w->nodes * sizeof(sb_real));
    w->points = (sb_vec3 *)sbi_alloc(allocator, points, sizeof(sb_vec3));
    w->values = (double *)sbi_alloc(allocator, points, (size_t)w->def->shape_count * sizeof(double));
    w->found.room = (size_t)w->def->mesh->element_count + 16;
    w->found.items = (sbi_mixture_part *)sbi_alloc(allocator, w->found.room, sizeof(sbi_mixture_part));
    if (!w->functions || !w->points || !w->values || !w->found.items)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the shares of %d elements", w->def->mesh->element_count);
    sbi_mixture_lay_lattice(w);
    for (int e = 0; e < w->def->mesh->element_count; e++) {
        sb_result result = sbi_mixture_measure(w, e, error);
        if (result != SB_OK)
            return result;
        if (!sbi_mixture_keep_parts(w, e))
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the shares of %d elements",
                            w->def->mesh->element_count);
    }
    return SB_OK;
}

/* ---- cells ---- */

static sb_result sbi_mixture_fill_mesh(const sbi_mixture_work *w, sb_mixture *made, sb_error *error)
{
    const sb_mesh *mesh = w->def->mesh;
    const sb_allocator *allocator = &w->def->allocator;
    size_t count = w->found.count, width = (size_t)w->nodes;
    if (count > (size_t)(INT32_MAX / SB_MAX_ELEMENT_NODES))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%g elements are more than a body counts", (double)count);
    made->elements = (int *)sbi_alloc(allocator, count, sizeof(int));
    made->shares = (sb_real *)sbi_alloc(allocator, count, sizeof(sb_real));
    if (!made->elements || !made->shares ||
        !sbi_mesh_allocate(&made->body_mesh, mesh->element_type, mesh->node_count, (int)count, 1, allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d elements of a mixture", (int)count);
    memcpy(made->body_mesh.nodes, mesh->nodes, (size_t)mesh->node_count * sizeof(sb_vec3));
    for (size_t k = 0; k < count; k++) {
        const sbi_mixture_part *part = w->found.items + k;
        memcpy(made->body_mesh.elements + k * width, mesh->elements + (size_t)part->element * width,
               width * sizeof(int));
        made->body_mesh.regions[k] = part->region;
        made->elements[k] = part->element;
        made->shares[k] = (sb_real)part->share;
        made->mixed_count += (k == 0 || made->elements[k - 1] != part->element) && k + 1 < count &&
                             w->found.items[k + 1].element == part->element;
    }
    return SB_OK;
}

/* Weights by share, and masses by share: those of the element, which no part is to be lifted above. */
static sb_result sbi_mixture_fill_domain(const sbi_mixture_work *w, sb_mixture *made, sb_error *error)
{
    const sb_mixture_def *def = w->def;
    sb_domain *domain = &made->domain;
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    int n = w->nodes;
    size_t pairs = (size_t)(n * (n + 1) / 2);
    sb_result result =
        sb_domain_create(&made->body_mesh, def->integration, def->single_rotation, &def->allocator, domain, error);
    if (result != SB_OK)
        return result;
    domain->cell_mass = (sb_real *)sbi_alloc(&def->allocator, (size_t)domain->cell_count, pairs * sizeof(sb_real));
    if (!domain->cell_mass)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the masses of %d elements", domain->cell_count);
    for (int e = 0; e < domain->cell_count; e++) {
        sb_real *own = domain->cell_mass + (size_t)e * pairs, *weights;
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        for (int a = 0; a < n; a++)
            x[a] = made->body_mesh.nodes[domain->cells[(size_t)e * (size_t)n + (size_t)a]];
        sbi_element_mass(sbi_domain_element(domain), SB_MASS_CONSISTENT, x, mass, NULL);
        for (int a = 0; a < n; a++)
            for (int b = a; b < n; b++)
                *own++ = made->shares[e] * mass[a * n + b];
        weights = domain->weights + (size_t)e * (size_t)domain->points_per_cell;
        for (int p = 0; p < domain->points_per_cell; p++)
            weights[p] *= (sb_real)w->found.items[e].weight;
    }
    return SB_OK;
}

static int sbi_mixture_before(const void *context, int a, int b)
{
    const sbi_mixture_part *parts = (const sbi_mixture_part *)context;
    return parts[a].region < parts[b].region;
}

/* order: [2 found.count], room. */
static void sbi_mixture_sum_sorted(sbi_mixture_work *w, sb_mixture *made, int *order)
{
    const sbi_mixture_part *parts = w->found.items;
    double sum = 0, volume = 0;
    int count = (int)w->found.count;
    for (int k = 0; k < count; k++)
        order[k] = k;
    sbi_merge_sort(order, order + count, count, sbi_mixture_before, parts);
    for (int k = 0; k < count; k++) {
        const sbi_mixture_part *part = parts + order[k];
        sum += part->share * (double)sb_mesh_element_volume(w->def->mesh, part->element);
        if (k + 1 < count && parts[order[k + 1]].region == part->region)
            continue;
        made->regions[made->region_count] = part->region;
        made->region_volumes[made->region_count++] = (sb_real)sum;
        volume += sum;
        sum = 0;
    }
    made->volume = (sb_real)volume;
}

static sb_result sbi_mixture_sum_volumes(sbi_mixture_work *w, sb_mixture *made, sb_error *error)
{
    const sb_allocator *allocator = &w->def->allocator;
    int *order = (int *)sbi_alloc(allocator, w->found.count, 2 * sizeof(int));
    made->regions = (int *)sbi_alloc(allocator, w->found.count, sizeof(int));
    made->region_volumes = (sb_real *)sbi_alloc(allocator, w->found.count, sizeof(sb_real));
    if (order && made->regions && made->region_volumes)
        sbi_mixture_sum_sorted(w, made, order);
    sbi_free(allocator, order);
    return made->region_count > 0
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the volumes of a mixture's regions");
}

/* ---- creation ---- */

static sb_result sbi_mixture_check_shape(const sb_mixture_def *def, int number, sb_error *error)
{
    const sb_shape *shape = def->shapes + number;
    int turned = -1;
    if (!shape->surface == !shape->distance)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.shapes[%d] needs a surface or a distance, and not both", number);
    if (!(shape->max_slope >= 0) || !sb_is_finite(shape->max_slope))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.shapes[%d].max_slope %g must be >= 0", number,
                        (double)shape->max_slope);
    if (shape->surface && !sbi_surface_find_inside_out(shape->surface, &def->allocator, &turned))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for marks on the triangles of def.shapes[%d]", number);
    if (turned >= 0)
        return sbi_fail_element(
            error, SB_ERROR_MESH, sb_surface_triangle(shape->surface, turned, NULL),
            "the surface of def.shapes[%d] is inside out, or a part of it is (element %d belongs to "
            "it): sb_surface_repair turns it",
            number, sb_surface_triangle(shape->surface, turned, NULL));
    return SB_OK;
}

static sb_result sbi_mixture_check_mesh(const sb_mesh *mesh, sb_error *error)
{
    sb_result result;
    if (!mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh is NULL");
    result = sb_mesh_validate(mesh, error);
    if (result != SB_OK)
        return result;
    if (mesh->element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "elements of your own (SB_CUSTOM) are not mixed");
    if (sb_element_dimension(mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "volume elements are mixed, def.mesh has %s",
                        sb_element_name(mesh->element_type));
    return SB_OK;
}

static sb_result sbi_mixture_check_def(const sb_mixture_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_MIXTURE_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_mixture_def");
    if (!def->shapes || def->shape_count < 1 || def->shape_count > SB_MIXTURE_MAX_SHAPES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.shapes is NULL, or def.shape_count %d not in [1, %d]",
                        def->shape_count, (int)SB_MIXTURE_MAX_SHAPES);
    if (def->level < 1 || def->level > SB_MIXTURE_MAX_LEVEL)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.level %d must be in [1, %d]", def->level,
                        (int)SB_MIXTURE_MAX_LEVEL);
    if (!(def->least_share >= 0) || !(def->least_share < (sb_real)0.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.least_share %g must be in [0, 0.5)", (double)def->least_share);
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
    if (def->mean < SB_MIXTURE_VOIGT || def->mean > SB_MIXTURE_REUSS ||
        (def->mean != SB_MIXTURE_VOIGT && !def->stiffness))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mean %d is unknown, or has no def.stiffness", (int)def->mean);
    for (int k = 0; def->mean != SB_MIXTURE_VOIGT && k <= def->shape_count; k++)
        if (!(def->stiffness[k] > 0) || !sb_is_finite(def->stiffness[k]))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "def.stiffness[%d] is %g, not more than 0", k,
                            (double)def->stiffness[k]);
    result = sbi_mixture_check_mesh(def->mesh, error);
    for (int s = 0; s < def->shape_count && result == SB_OK; s++)
        result = sbi_mixture_check_shape(def, s, error);
    return result;
}

SB_API sb_result sb_mixture_create(const sb_mixture_def *def, sb_mixture *mixture, sb_error *error)
{
    sbi_mixture_work work;
    sb_mixture made;
    sb_result result;
    if (!def || !mixture)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_mixture_create needs a def and a mixture");
    result = sbi_mixture_check_def(def, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    memset(&work, 0, sizeof work);
    made.allocator = def->allocator;
    work.def = def;
    work.nodes = sb_element_node_count(def->mesh->element_type);
    work.is_tet = sb_element_straight(def->mesh->element_type) == SB_TET4;
    work.side = def->level + 1;
    result = sbi_mixture_find_parts(&work, error);
    if (result == SB_OK)
        result = sbi_mixture_fill_mesh(&work, &made, error);
    if (result == SB_OK)
        result = sbi_mixture_fill_domain(&work, &made, error);
    if (result == SB_OK)
        result = sbi_mixture_sum_volumes(&work, &made, error);
    sbi_free(&def->allocator, work.functions);
    sbi_free(&def->allocator, work.points);
    sbi_free(&def->allocator, work.values);
    sbi_free(&def->allocator, work.found.items);
    if (result == SB_OK)
        *mixture = made;
    else
        sb_mixture_free(&made);
    return result;
}
