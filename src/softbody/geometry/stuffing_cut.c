/* stuffing_cut: 5. stencils: what is still cut falls into tets of one label each; the mesh of all. */
#include "stuffing_private.h"

/* ---- 5. stencils ---- */

/* Which of a tet's points are on the side that is cut out (+1), on the other (-1), on the surface (0). */
typedef struct sbi_stuffing_stencil {
    const sbi_stuffing_view *view;
    int p[4], n[4], z[4]; /* local indices of each kind */
    int p_count, n_count, z_count;
    int label;
} sbi_stuffing_stencil;

static int sbi_stuffing_is_long(const sbi_stuffing *s, int a, int b)
{
    return ((s->points[a].half[0] ^ s->points[b].half[0]) & 1) == 0;
}

/* Whether the diagonal of the quadrilateral p1, p2 and their cuts towards n starts at p1, that is, ends at the cut of
 * p2. The three are surface points. Long edges p1-p2 decide by parity, so that the faces round them take turns. */
static int sbi_stuffing_starts_at_first(const sbi_stuffing *s, int p1, int p2, int n)
{
    const int *a = s->points[p1].half, *b = s->points[p2].half, *c = s->points[n].half;
    int odd = a[0] & 1, sign = 1, from_lower, first_is_lower;
    if (sbi_stuffing_is_long(s, p1, n))
        return 0;
    if (sbi_stuffing_is_long(s, p2, n))
        return 1;
    first_is_lower = a[0] + a[1] + a[2] < b[0] + b[1] + b[2];
    for (int axis = 0; axis < 3; axis++)
        if (a[axis] == b[axis])
            sign *= c[axis] > a[axis] ? 1 : -1;
    from_lower = (sign > 0) != odd;
    return from_lower == first_is_lower;
}

static void sbi_stuffing_put_element(sbi_stuffing *s, int label, int a, int b, int c, int d)
{
    if (s->element_count < s->element_capacity) {
        int *nodes = s->elements + 4 * (size_t)s->element_count;
        nodes[0] = a;
        nodes[1] = b;
        nodes[2] = c;
        nodes[3] = d;
        s->element_labels[s->element_count] = (unsigned char)label;
    }
    s->element_count++;
}

/* Node of the cut between two surface points. */
static int sbi_stuffing_cut_between(sbi_stuffing *s, int i, int j)
{
    const int *a = s->points[i].half, *b = s->points[j].half;
    int edge = 0, owner = i, other = j;
    int *node;
    if (sbi_stuffing_is_long(s, i, j)) {
        while (a[edge] == b[edge])
            edge++;
        if (a[edge] > b[edge])
            owner = j;
    } else {
        if (a[2] > b[2])
            owner = j;
        other = owner == i ? j : i;
        edge = 3 + (s->points[other].half[0] > s->points[owner].half[0]) +
               2 * (s->points[other].half[1] > s->points[owner].half[1]);
    }
    other = owner == i ? j : i;
    node = s->cut_node + (size_t)owner * SBI_STUFF_EDGES + edge;
    if (*node < 0) {
        sb_vec3 from = sbi_stuffing_position(s, s->points[owner].half);
        sb_vec3 to = sbi_stuffing_position(s, s->points[other].half);
        sb_real alpha = edge < 3 ? SBI_STUFF_ALPHA_LONG : SBI_STUFF_ALPHA_SHORT;
        sb_real fraction = sb_min(sb_max(s->points[owner].cut[edge], alpha), 1 - alpha); /* beyond: freed points only */
        s->cut_positions[s->cut_count] = sb_v3_madd(from, fraction, sb_v3_sub(to, from));
        *node = s->active.count + s->cut_count++;
    }
    return *node;
}

/* A prism with bottom b and top t, cut so that the diagonal between columns i and j runs from b_i to t_j when before[i]
 * < before[j]. */
static void sbi_stuffing_put_prism(sbi_stuffing *s, int label, const int *b, const int *t, const int *order)
{
    int i = order[0], j = order[1], k = order[2];
    sbi_stuffing_put_element(s, label, b[i], b[j], b[k], t[k]);
    sbi_stuffing_put_element(s, label, b[i], b[j], t[j], t[k]);
    sbi_stuffing_put_element(s, label, b[i], t[i], t[j], t[k]);
}

/* Order of three columns from which of each pair comes first; acyclic for all patterns of the lattice. */
static void sbi_stuffing_order(int first01, int first02, int first12, int order[3])
{
    int rank[3];
    rank[0] = !first01 + !first02;
    rank[1] = first01 + !first12;
    rank[2] = first02 + first12;
    for (int i = 0; i < 3; i++)
        order[rank[i]] = i;
}

/* +++-: the prism between the three points and their cuts. */
static void sbi_stuffing_cut_corner(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int bottom[3], top[3], order[3], p[3], n = c->view->point[c->n[0]];
    for (int i = 0; i < 3; i++) {
        p[i] = c->view->point[c->p[i]];
        bottom[i] = c->view->nodes[c->p[i]];
        top[i] = sbi_stuffing_cut_between(s, p[i], n);
    }
    sbi_stuffing_order(sbi_stuffing_starts_at_first(s, p[0], p[1], n), sbi_stuffing_starts_at_first(s, p[0], p[2], n),
                       sbi_stuffing_starts_at_first(s, p[1], p[2], n), order);
    sbi_stuffing_put_prism(s, c->label, bottom, top, order);
}

/* ++--: the prism along the edge of the two points, with a triangle of cuts at each end. The two faces at that edge
 * decide in opposite ways, so the free quadrilateral of four cuts has no choice left. */
static void sbi_stuffing_cut_half(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int bottom[3], top[3], order[3], p[2], n[2], first01, first02;
    for (int i = 0; i < 2; i++) {
        p[i] = c->view->point[c->p[i]];
        n[i] = c->view->point[c->n[i]];
    }
    bottom[0] = c->view->nodes[c->p[0]];
    top[0] = c->view->nodes[c->p[1]];
    for (int i = 0; i < 2; i++) {
        bottom[1 + i] = sbi_stuffing_cut_between(s, p[0], n[i]);
        top[1 + i] = sbi_stuffing_cut_between(s, p[1], n[i]);
    }
    first01 = sbi_stuffing_starts_at_first(s, p[0], p[1], n[0]);
    first02 = sbi_stuffing_starts_at_first(s, p[0], p[1], n[1]);
    sbi_stuffing_order(first01, first02, first02, order);
    sbi_stuffing_put_prism(s, c->label, bottom, top, order);
}

/* ++-0: the pyramid over the two points and their cuts. */
static void sbi_stuffing_cut_pyramid(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int p1 = c->view->point[c->p[0]], p2 = c->view->point[c->p[1]], n = c->view->point[c->n[0]];
    int a = c->view->nodes[c->p[0]], b = c->view->nodes[c->p[1]], apex = c->view->nodes[c->z[0]];
    int ca = sbi_stuffing_cut_between(s, p1, n), cb = sbi_stuffing_cut_between(s, p2, n);
    if (sbi_stuffing_starts_at_first(s, p1, p2, n)) {
        sbi_stuffing_put_element(s, c->label, a, b, cb, apex);
        sbi_stuffing_put_element(s, c->label, a, cb, ca, apex);
    } else {
        sbi_stuffing_put_element(s, c->label, b, a, ca, apex);
        sbi_stuffing_put_element(s, c->label, b, ca, cb, apex);
    }
}

/* One point: the tet to its cuts and the zeros. */
static void sbi_stuffing_cut_tip(sbi_stuffing *s, const sbi_stuffing_stencil *c)
{
    int nodes[4];
    memcpy(nodes, c->view->nodes, sizeof nodes);
    for (int i = 0; i < c->n_count; i++)
        nodes[c->n[i]] = sbi_stuffing_cut_between(s, c->view->point[c->p[0]], c->view->point[c->n[i]]);
    sbi_stuffing_put_element(s, c->label, nodes[0], nodes[1], nodes[2], nodes[3]);
}

static void sbi_stuffing_apply(sbi_stuffing *s, const sbi_stuffing_view *view, const int sides[4], int sign, int label)
{
    sbi_stuffing_stencil c;
    memset(&c, 0, sizeof c);
    c.view = view;
    c.label = label;
    for (int i = 0; i < 4; i++) {
        if (sides[i] == 0)
            c.z[c.z_count++] = i;
        else if (sides[i] == sign)
            c.p[c.p_count++] = i;
        else
            c.n[c.n_count++] = i;
    }
    if (c.p_count == 0)
        return;
    if (c.n_count == 0)
        sbi_stuffing_put_element(s, label, view->nodes[0], view->nodes[1], view->nodes[2], view->nodes[3]);
    else if (c.p_count == 1)
        sbi_stuffing_cut_tip(s, &c);
    else if (c.p_count == 3)
        sbi_stuffing_cut_corner(s, &c);
    else if (c.n_count == 2)
        sbi_stuffing_cut_half(s, &c);
    else
        sbi_stuffing_cut_pyramid(s, &c);
}

/* Region of the inner part of a tet at the outside whose inner points are all zeros between regions. */
static int sbi_stuffing_label_of_zeros(const sbi_stuffing *s, const int *nodes)
{
    sb_vec3 corners[4];
    int label;
    for (int i = 0; i < 4; i++)
        corners[i] = s->positions[nodes[i]];
    label = sbi_stuffing_label_at(s, sbi_stuffing_centroid(corners));
    for (int i = 0; i < 4 && label == 0; i++)
        label = s->active_label[nodes[i]];
    return label;
}

static void sbi_stuffing_cut_tet(sbi_stuffing *s, const int *nodes)
{
    sbi_stuffing_view v;
    int sides[4];
    sbi_stuffing_look(s, nodes, &v);
    if (v.zeros == 4) {
        int label = sbi_stuffing_label_of_four(s, v.point);
        if (label > 0)
            sbi_stuffing_put_element(s, label, nodes[0], nodes[1], nodes[2], nodes[3]);
        return;
    }
    for (int i = 0; i < 4; i++) {
        int state = v.point[i] < 0 ? 0 : s->points[v.point[i]].state;
        if (v.outside)
            sides[i] = state == SBI_STUFF_OUTER ? 0 : state == SBI_STUFF_STRICT && v.label[i] == 0 ? -1 : 1;
        else
            sides[i] = state ? 0 : v.label[i] == v.a ? 1 : -1;
    }
    if (v.outside) {
        int label = v.a > 0 ? v.a : sbi_stuffing_label_of_zeros(s, nodes);
        sbi_stuffing_apply(s, &v, sides, 1, label);
        return;
    }
    sbi_stuffing_apply(s, &v, sides, 1, v.a);
    if (v.b > 0)
        sbi_stuffing_apply(s, &v, sides, -1, v.b);
}

SBI_API sb_result sbi_stuffing_cut(sbi_stuffing *s)
{
    const sb_allocator *allocator = &s->def->allocator;
    size_t edges = (size_t)s->surface.count * SBI_STUFF_EDGES, cuts = 0;
    for (int i = 0; i < s->surface.count; i++)
        for (int edge = 0; edge < SBI_STUFF_EDGES; edge++)
            cuts += s->points[i].cut[edge] >= 0;
    s->cut_node = (int *)sbi_alloc(allocator, edges, sizeof(int));
    s->cut_positions = (sb_vec3 *)sbi_alloc(allocator, cuts, sizeof(sb_vec3));
    if (!s->cut_node || !s->cut_positions || cuts > (size_t)(INT_MAX - s->active.count))
        return sbi_stuffing_no_memory(s);
    memset(s->cut_node, 0xff, edges * sizeof(int)); /* all -1 */
    for (int pass = 0; pass < 2; pass++) {          /* count, then fill */
        s->element_count = 0;
        for (int t = 0; t < s->tet_count && s->element_count < INT_MAX - 8; t++)
            sbi_stuffing_cut_tet(s, s->tets + 4 * (size_t)t);
        if (pass == 1)
            break;
        if (s->element_count == 0)
            return sbi_fail(s->error, SB_ERROR_MESH,
                            "nothing to mesh: the first shape is much thinner than cells of %g m everywhere",
                            (double)s->def->cell);
        if (s->element_count > s->def->max_elements)
            return sbi_stuffing_too_many(s);
        s->element_capacity = s->element_count;
        s->elements = (int *)sbi_alloc(allocator, (size_t)s->element_count, 4 * sizeof(int));
        s->element_labels = (unsigned char *)sbi_alloc(allocator, (size_t)s->element_count, 1);
        if (!s->elements || !s->element_labels)
            return sbi_stuffing_no_memory(s);
    }
    return SB_OK;
}

/* ---- the mesh ---- */

static sb_vec3 sbi_stuffing_node(const sbi_stuffing *s, int node)
{
    return node < s->active.count ? s->positions[node] : s->cut_positions[node - s->active.count];
}

SBI_API sb_result sbi_stuffing_collect(sbi_stuffing *s, sb_mesh *mesh)
{
    int total = s->active.count + s->cut_count, used = 0;
    int *map = (int *)sbi_alloc_zeroed(&s->def->allocator, (size_t)total, sizeof(int));
    if (!map)
        return sbi_stuffing_no_memory(s);
    for (size_t i = 0; i < 4 * (size_t)s->element_count; i++)
        map[s->elements[i]] = 1;
    for (int node = 0; node < total; node++)
        used += map[node];
    if (!sbi_mesh_allocate(mesh, SB_TET4, used, s->element_count, 1, &s->def->allocator)) {
        sbi_free(&s->def->allocator, map);
        return sbi_stuffing_no_memory(s);
    }
    used = 0;
    for (int node = 0; node < total; node++)
        if (map[node]) {
            mesh->nodes[used] = sbi_stuffing_node(s, node);
            map[node] = used++;
        }
    for (int e = 0; e < s->element_count; e++) {
        int *nodes = mesh->elements + 4 * (size_t)e, *x = s->elements + 4 * (size_t)e;
        for (int i = 0; i < 4; i++)
            nodes[i] = map[x[i]];
        if (sb_mesh_element_volume(mesh, e) < 0) {
            int swap = nodes[2];
            nodes[2] = nodes[3];
            nodes[3] = swap;
        }
        mesh->regions[e] = s->def->shapes[s->element_labels[e] - 1].region;
    }
    sbi_free(&s->def->allocator, map);
    return SB_OK;
}
