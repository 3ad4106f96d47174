/* element: tables of faces and edges, shape functions, quadrature; tables of custom elements. */
#include "element.h"

#include <string.h>

/* ---- names, faces, edges ---- */

SB_API const char *sb_element_name(sb_element_type type)
{
    switch (type) {
    case SB_TRI3: return "tri3";
    case SB_TRI6: return "tri6";
    case SB_QUAD4: return "quad4";
    case SB_QUAD8: return "quad8";
    case SB_QUAD9: return "quad9";
    case SB_TET4: return "tet4";
    case SB_TET10: return "tet10";
    case SB_HEX8: return "hex8";
    case SB_HEX20: return "hex20";
    case SB_HEX27: return "hex27";
    case SB_CUSTOM: return "custom";
    case SB_NO_ELEMENT: break;
    }
    return "unknown";
}

/* Outward faces; the first three columns are the faces of tet4. */
static const signed char sbi_element_tet_faces[4][6] = {
    {0, 1, 3, 4, 8, 7}, {1, 2, 3, 5, 9, 8}, {2, 0, 3, 6, 7, 9}, {0, 2, 1, 6, 5, 4}};
/* The same of hex27; the first eight columns are those of hex20, the first four those of hex8. */
static const signed char sbi_element_hex_faces[6][9] = {
    {0, 4, 7, 3, 16, 15, 19, 11, 20}, {1, 2, 6, 5, 9, 18, 13, 17, 21}, {0, 1, 5, 4, 8, 17, 12, 16, 22},
    {3, 7, 6, 2, 19, 14, 18, 10, 23}, {0, 3, 2, 1, 11, 10, 9, 8, 24},  {4, 5, 6, 7, 12, 13, 14, 15, 25}};

/* Ends of the edges; mid-edge nodes follow the corners in the order of the edges. */
static const signed char sbi_element_tri_edges[3][2] = {{0, 1}, {1, 2}, {2, 0}};
static const signed char sbi_element_quad_edges[4][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}};
static const signed char sbi_element_tet_edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
static const signed char sbi_element_hex_edges[12][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6},
                                                         {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};

static const signed char (*sbi_element_edges(sb_element_type type))[2]
{
    switch (sb_element_straight(type)) {
    case SB_TRI3: return sbi_element_tri_edges;
    case SB_QUAD4: return sbi_element_quad_edges;
    case SB_TET4: return sbi_element_tet_edges;
    default: return sbi_element_hex_edges;
    }
}

static sb_element_type sbi_element_face_type(sb_element_type type)
{
    switch (type) {
    case SB_TET4: return SB_TRI3;
    case SB_TET10: return SB_TRI6;
    case SB_HEX8: return SB_QUAD4;
    case SB_HEX20: return SB_QUAD8;
    default: return SB_QUAD9;
    }
}

SB_API int sb_element_face(sb_element_type type, int face, int nodes[SB_MAX_FACE_NODES], sb_element_type *face_type)
{
    if (!nodes)
        return 0;
    if (face < 0 || face >= sb_element_face_count(type))
        return 0;
    sb_element_type of_face = sbi_element_face_type(type);
    int count = sb_element_node_count(of_face), is_tet = sb_element_straight(type) == SB_TET4;
    for (int i = 0; i < count; i++)
        nodes[i] = is_tet ? sbi_element_tet_faces[face][i] : sbi_element_hex_faces[face][i];
    if (face_type)
        *face_type = of_face;
    return count;
}

SB_API int sb_element_edge(sb_element_type type, int edge, int nodes[3])
{
    if (!nodes)
        return 0;
    if (edge < 0 || edge >= sb_element_edge_count(type))
        return 0;
    int corners = sb_element_corner_count(type);
    int quadratic = sb_element_node_count(type) > corners;
    nodes[0] = sbi_element_edges(type)[edge][0];
    nodes[1] = sbi_element_edges(type)[edge][1];
    nodes[2] = quadratic ? corners + edge : -1;
    return quadratic ? 3 : 2;
}

/* ---- shape functions ---- */

/* 1 for quads and hexes, whose parameters lie in [-1, 1]. */
static int sbi_element_is_box(sb_element_type type)
{
    sb_element_type straight = sb_element_straight(type);
    return straight == SB_QUAD4 || straight == SB_HEX8;
}

/* Corners of quad4 (first four, without z) and hex8. */
static const signed char sbi_element_hex_corners[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                                                          {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};

/* Parameters of node `node` of a quad or hex, each -1, 0 or 1: corners, middles of edges, of faces, the centre. */
static void sbi_element_box_point(sb_element_type type, int node, int at[3])
{
    int corners = sb_element_corner_count(type), edges = sb_element_edge_count(type);
    int face = node - corners - edges, ends[3] = {node, node, -1}; /* a corner is the middle of itself and itself */
    if (node >= corners && face < 0)
        sb_element_edge(type, node - corners, ends);
    for (int k = 0; k < 3; k++) {
        if (face >= 0)
            at[k] = corners == 8 && face < 6 && face / 2 == k ? 2 * (face % 2) - 1 : 0;
        else
            at[k] = k == 2 && corners == 4
                        ? 0
                        : (sbi_element_hex_corners[ends[0]][k] + sbi_element_hex_corners[ends[1]][k]) / 2;
    }
}

SB_API int sb_element_node_point(sb_element_type type, int node, sb_real xi[3])
{
    int corners = sb_element_corner_count(type), at[3];
    int ends[3] = {node, node, -1};
    if (!xi)
        return 0;
    if (node < 0 || node >= sb_element_node_count(type))
        return 0;
    if (sbi_element_is_box(type)) {
        sbi_element_box_point(type, node, at);
        for (int k = 0; k < 3; k++)
            xi[k] = (sb_real)at[k];
        return 1;
    }
    if (node >= corners)
        sb_element_edge(type, node - corners, ends);
    for (int k = 0; k < 3; k++)
        xi[k] = (sb_real)0.5 * (sb_real)((ends[0] == k + 1) + (ends[1] == k + 1));
    return 1;
}

/* Simplex of `dimension` in barycentric coordinates L: N_a = L_a, or with mid-edge nodes N_a = L_a (2 L_a -
 * 1) and N_pq = 4 L_p L_q. dL_0 = (-1, -1, -1), dL_k = unit vector k - 1. */
static void sbi_element_shape_simplex(sb_element_type type, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    int corners = sb_element_corner_count(type), nodes = sb_element_node_count(type);
    sb_real bary[4] = {1, 0, 0, 0}, slope[4][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    for (int k = 1; k < corners; k++) {
        bary[0] -= xi[k - 1];
        bary[k] = xi[k - 1];
        slope[0][k - 1] = -1;
        slope[k][k - 1] = 1;
    }
    for (int a = 0; a < corners; a++) {
        sb_real value = nodes > corners ? bary[a] * (2 * bary[a] - 1) : bary[a];
        sb_real factor = nodes > corners ? 4 * bary[a] - 1 : (sb_real)1;
        if (shape)
            shape[a] = value;
        for (int k = 0; gradient && k < 3; k++)
            gradient[a][k] = factor * slope[a][k];
    }
    for (int a = corners; a < nodes; a++) {
        int p = sbi_element_edges(type)[a - corners][0], q = sbi_element_edges(type)[a - corners][1];
        if (shape)
            shape[a] = 4 * bary[p] * bary[q];
        for (int k = 0; gradient && k < 3; k++)
            gradient[a][k] = 4 * (bary[p] * slope[q][k] + bary[q] * slope[p][k]);
    }
}

/* quad4 and hex8: N_c = prod_k (1 + c_k xi_k) / 2 with corners c. */
static void sbi_element_shape_box(int dimension, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    const sb_real half = (sb_real)0.5;
    for (int a = 0; a < (1 << dimension); a++) {
        sb_real factor[3] = {1, 1, 1}, slope[3] = {0, 0, 0};
        for (int k = 0; k < dimension; k++) {
            slope[k] = half * (sb_real)sbi_element_hex_corners[a][k];
            factor[k] = half + slope[k] * xi[k];
        }
        if (shape)
            shape[a] = factor[0] * factor[1] * factor[2];
        if (gradient) {
            gradient[a][0] = slope[0] * factor[1] * factor[2];
            gradient[a][1] = factor[0] * slope[1] * factor[2];
            gradient[a][2] = factor[0] * factor[1] * slope[2];
        }
    }
}

/* quad9 and hex27: products of Lagrange's l_-1 = x (x - 1) / 2, l_0 = 1 - x^2, l_1 = x (x + 1) / 2. */
static void sbi_element_shape_lagrange(sb_element_type type, const sb_real xi[3], sb_real *shape,
                                       sb_real (*gradient)[3])
{
    int nodes = sb_element_node_count(type), dimension = sb_element_dimension(type);
    sb_real value[3][3], slope[3][3]; /* [axis][l_-1, l_0, l_1] */
    const sb_real half = (sb_real)0.5;
    for (int k = 0; k < 3; k++) {
        sb_real x = k < dimension ? xi[k] : (sb_real)0;
        value[k][0] = half * x * (x - 1), slope[k][0] = x - half;
        value[k][1] = 1 - x * x, slope[k][1] = -2 * x;
        value[k][2] = half * x * (x + 1), slope[k][2] = x + half;
    }
    for (int a = 0; a < nodes; a++) {
        int at[3];
        sbi_element_box_point(type, a, at);
        sb_real x = value[0][at[0] + 1], y = value[1][at[1] + 1], z = value[2][at[2] + 1];
        if (shape)
            shape[a] = x * y * z;
        if (gradient) {
            gradient[a][0] = slope[0][at[0] + 1] * y * z;
            gradient[a][1] = x * slope[1][at[1] + 1] * z;
            gradient[a][2] = dimension == 3 ? x * y * slope[2][at[2] + 1] : (sb_real)0;
        }
    }
}

/* quad8 and hex20 in d = 2, 3 dimensions: the product of (1 + c_k xi_k) / 2 over the k with c_k != 0, times
 * c . xi - (d - 1) at corners and 1 - xi_k^2 on the edge with c_k = 0. */
static void sbi_element_shape_serendipity(sb_element_type type, const sb_real xi[3], sb_real *shape,
                                          sb_real (*gradient)[3])
{
    int nodes = sb_element_node_count(type), dimension = sb_element_dimension(type);
    const sb_real half = (sb_real)0.5;
    for (int a = 0; a < nodes; a++) {
        int at[3], corner = a < sb_element_corner_count(type);
        sb_real factor[3] = {1, 1, 1}, slope[3] = {0, 0, 0}, sum = (sb_real)(1 - dimension);
        sbi_element_box_point(type, a, at);
        for (int k = 0; k < dimension; k++) {
            sb_real c = (sb_real)at[k];
            factor[k] = at[k] ? half + half * c * xi[k] : 1 - xi[k] * xi[k];
            slope[k] = at[k] ? half * c : -2 * xi[k];
            sum += c * xi[k];
        }
        if (shape)
            shape[a] = factor[0] * factor[1] * factor[2] * (corner ? sum : (sb_real)1);
        for (int k = 0; gradient && k < 3; k++) {
            sb_real others = factor[(k + 1) % 3] * factor[(k + 2) % 3];
            gradient[a][k] = corner ? others * (slope[k] * sum + factor[k] * (sb_real)at[k]) : others * slope[k];
        }
    }
    for (int a = 0; gradient && dimension == 2 && a < nodes; a++)
        gradient[a][2] = 0;
}

SB_API void sb_element_shape(sb_element_type type, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    if (!xi)
        return;
    if (type == SB_HEX8 || type == SB_QUAD4)
        sbi_element_shape_box(sb_element_dimension(type), xi, shape, gradient);
    else if (type == SB_HEX20 || type == SB_QUAD8)
        sbi_element_shape_serendipity(type, xi, shape, gradient);
    else if (type == SB_HEX27 || type == SB_QUAD9)
        sbi_element_shape_lagrange(type, xi, shape, gradient);
    else
        sbi_element_shape_simplex(type, xi, shape, gradient);
}

/* ---- quadrature ---- */

/* A rule being collected point by point. */
typedef struct sbi_element_rule {
    sb_real (*points)[3];
    sb_real *weights;
    int count;
} sbi_element_rule;

static void sbi_element_rule_add(sbi_element_rule *rule, sb_real r, sb_real s, sb_real t, sb_real weight)
{
    rule->points[rule->count][0] = r;
    rule->points[rule->count][1] = s;
    rule->points[rule->count][2] = t;
    rule->weights[rule->count] = weight;
    rule->count++;
}

/* The four points with three barycentric coordinates a, nearest to (a < 1/4) or farthest from corner 0, 1, 2,
 * 3. */
static void sbi_element_rule_tet_corners(sbi_element_rule *rule, double a, double weight)
{
    for (int corner = 0; corner < 4; corner++) {
        sb_real bary[4];
        for (int k = 0; k < 4; k++)
            bary[k] = (sb_real)(k == corner ? 1 - 3 * a : a);
        sbi_element_rule_add(rule, bary[1], bary[2], bary[3], (sb_real)(weight / 6));
    }
}

/* The six points with two barycentric coordinates c and two 1/2 - c, by the edges they are nearest to. */
static void sbi_element_rule_tet_edges(sbi_element_rule *rule, double c, double weight)
{
    for (int edge = 0; edge < 6; edge++) {
        sb_real bary[4] = {(sb_real)c, (sb_real)c, (sb_real)c, (sb_real)c};
        bary[sbi_element_tet_edges[edge][0]] = bary[sbi_element_tet_edges[edge][1]] = (sb_real)(0.5 - c);
        sbi_element_rule_add(rule, bary[1], bary[2], bary[3], (sb_real)(weight / 6));
    }
}

/* The three points of a triangle with two barycentric coordinates a. */
static void sbi_element_rule_triangle(sbi_element_rule *rule, double a, double weight)
{
    for (int corner = 0; corner < 3; corner++)
        sbi_element_rule_add(rule, (sb_real)(corner == 1 ? 1 - 2 * a : a), (sb_real)(corner == 2 ? 1 - 2 * a : a), 0,
                             (sb_real)(weight / 2));
}

/* Tet rules of degree 1, 2, 3 and 5 with 1, 4, 8 and 14 points (the last is Walkington's). */
static void sbi_element_rule_tet(sbi_element_rule *rule, int count)
{
    switch (count) {
    case 1: sbi_element_rule_add(rule, (sb_real)0.25, (sb_real)0.25, (sb_real)0.25, (sb_real)(1.0 / 6)); break;
    case 4: /* a = (5 - sqrt(5)) / 20 */ sbi_element_rule_tet_corners(rule, 0.13819660112501051518, 0.25); break;
    case 8: /* corners and face centroids: all weights positive */
        sbi_element_rule_tet_corners(rule, 0, 1.0 / 40);
        sbi_element_rule_tet_corners(rule, 1.0 / 3, 9.0 / 40);
        break;
    default:
        sbi_element_rule_tet_corners(rule, 0.3108859192633005, 0.1126879257180162);
        sbi_element_rule_tet_corners(rule, 0.0927352503108912, 0.0734930431163619);
        sbi_element_rule_tet_edges(rule, 0.0455037041256497, 0.0425460207770812);
        break;
    }
}

/* Gauss points +-1/sqrt(3) per direction, xi fastest. */
static void sbi_element_rule_box(sbi_element_rule *rule, int dimension)
{
    const sb_real g = (sb_real)0.57735026918962576451;
    for (int i = 0; i < (1 << dimension); i++)
        sbi_element_rule_add(rule, i & 1 ? g : -g, i & 2 ? g : -g, dimension == 2 ? (sb_real)0 : (i & 4 ? g : -g), 1);
}

/* Gauss points -sqrt(3/5), 0, sqrt(3/5) per direction, xi fastest: degree 5. */
static void sbi_element_rule_box3(sbi_element_rule *rule, int dimension)
{
    static const double point[3] = {-0.77459666924148337704, 0, 0.77459666924148337704};
    static const double weight[3] = {5.0 / 9, 8.0 / 9, 5.0 / 9};
    for (int i = 0; i < (dimension == 2 ? 9 : 27); i++) {
        int x = i % 3, y = i / 3 % 3, z = i / 9;
        double third = dimension == 2 ? 1 : weight[z];
        sbi_element_rule_add(rule, (sb_real)point[x], (sb_real)point[y],
                             dimension == 2 ? (sb_real)0 : (sb_real)point[z], (sb_real)(weight[x] * weight[y] * third));
    }
}

/* Surfaces: tri3 degree 2, tri6 degree 4 (a follower pressure needs it), quad4 degree 3, quad8 and quad9 degree 5. */
static void sbi_element_rule_surface(sbi_element_rule *rule, sb_element_type type)
{
    if (type == SB_TRI3) {
        sbi_element_rule_triangle(rule, 1.0 / 6, 1.0 / 3);
    } else if (type == SB_TRI6) {
        sbi_element_rule_triangle(rule, 0.445948490915965, 0.223381589678011);
        sbi_element_rule_triangle(rule, 0.091576213509771, 0.109951743655322);
    } else if (type == SB_QUAD4) {
        sbi_element_rule_box(rule, 2);
    } else {
        sbi_element_rule_box3(rule, 2);
    }
}

/* Points of a tet rule for a purpose; 0: there is none. */
static int sbi_element_tet_points(sb_element_type type, sb_quadrature_kind kind)
{
    switch (kind) {
    case SB_QUADRATURE_STIFFNESS: return type == SB_TET4 ? 1 : 4;
    case SB_QUADRATURE_STIFFNESS_CURVED: return type == SB_TET4 ? 1 : 8;
    case SB_QUADRATURE_MASS: return type == SB_TET4 ? 4 : 14;
    case SB_QUADRATURE_FACE: break;
    }
    return 0;
}

SB_API int sb_element_quadrature(sb_element_type type, sb_quadrature_kind kind,
                                 sb_real points[SB_MAX_QUADRATURE_POINTS][3], sb_real weights[SB_MAX_QUADRATURE_POINTS])
{
    int dimension = sb_element_dimension(type), tet_points = sbi_element_tet_points(type, kind);
    sbi_element_rule rule;
    if (!points || !weights)
        return 0;
    rule.points = points;
    rule.weights = weights;
    rule.count = 0;
    if (kind < SB_QUADRATURE_STIFFNESS || kind > SB_QUADRATURE_FACE || type == SB_CUSTOM)
        return 0;
    if (dimension == 2)
        sbi_element_rule_surface(&rule, type);
    else if (dimension == 3 && tet_points > 0 && type == SB_HEX8)
        sbi_element_rule_box(&rule, 3);
    else if (dimension == 3 && tet_points > 0 && sbi_element_is_box(type))
        sbi_element_rule_box3(&rule, 3);
    else if (dimension == 3 && tet_points > 0)
        sbi_element_rule_tet(&rule, tet_points);
    return rule.count;
}

/* ---- any element ---- */

/* The edges of a custom element follow from its faces: every edge is a side of two of them, run through both ways, and
 * is listed where it ascends. Fills nodes with both ends and the middle or -1; 0 when there is no such edge. */
static int sbi_element_table_edge(const sb_element_table *table, int edge, int nodes[3])
{
    for (int f = 0, next = 0; f < table->face_count; f++) {
        const sb_element_table_face *face = &table->faces[f];
        for (int side = 0, local[3]; sb_element_edge(face->type, side, local); side++) {
            int a = face->nodes[local[0]], b = face->nodes[local[1]];
            if (a > b || next++ != edge)
                continue;
            nodes[0] = a;
            nodes[1] = b;
            nodes[2] = local[2] < 0 ? -1 : face->nodes[local[2]];
            return local[2] < 0 ? 2 : 3;
        }
    }
    return 0;
}

SBI_API int sbi_element_edge_count(sbi_element element)
{
    int sides = 0;
    if (!element.table)
        return sb_element_edge_count(element.type);
    for (int f = 0; f < element.table->face_count; f++)
        sides += sb_element_edge_count(element.table->faces[f].type);
    return sides / 2;
}

SBI_API const char *sbi_element_name(sbi_element element)
{
    return element.table ? element.table->name : sb_element_name(element.type);
}

SBI_API int sbi_element_face(sbi_element element, int face, int nodes[SB_MAX_FACE_NODES], sb_element_type *face_type)
{
    int count;
    if (!element.table)
        return sb_element_face(element.type, face, nodes, face_type);
    if (face < 0 || face >= element.table->face_count)
        return 0;
    count = sb_element_node_count(element.table->faces[face].type);
    memcpy(nodes, element.table->faces[face].nodes, (size_t)count * sizeof(int));
    if (face_type)
        *face_type = element.table->faces[face].type;
    return count;
}

SBI_API int sbi_element_edge(sbi_element element, int edge, int nodes[3])
{
    return element.table ? sbi_element_table_edge(element.table, edge, nodes)
                         : sb_element_edge(element.type, edge, nodes);
}

SBI_API int sbi_element_node_point(sbi_element element, int node, sb_real xi[3])
{
    if (!element.table)
        return sb_element_node_point(element.type, node, xi);
    if (node < 0 || node >= element.table->node_count || sbi_element_is_cloud(element))
        return 0;
    memcpy(xi, element.table->node_points[node], 3 * sizeof(sb_real));
    return 1;
}

SBI_API void sbi_element_shape(sbi_element element, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    size_t n = (size_t)sbi_element_node_count(element);
    if (!element.table) {
        sb_element_shape(element.type, xi, shape, gradient);
    } else if (!sbi_element_is_cloud(element)) {
        element.table->shape(element.table->user, xi, shape, gradient);
    } else {
        if (shape)
            memset(shape, 0, n * sizeof *shape);
        if (gradient)
            memset(gradient, 0, n * sizeof *gradient);
    }
}

SBI_API int sbi_element_quadrature(sbi_element element, sb_quadrature_kind kind,
                                   sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                   sb_real weights[SB_MAX_QUADRATURE_POINTS])
{
    const sb_element_table *table = element.table;
    int of_mass = kind == SB_QUADRATURE_MASS, count;
    if (!table)
        return sb_element_quadrature(element.type, kind, points, weights);
    if (kind < SB_QUADRATURE_STIFFNESS || kind > SB_QUADRATURE_MASS || (of_mass && sbi_element_is_cloud(element)))
        return 0;
    if (sbi_element_is_cloud(element)) { /* somewhere, with the weight that its domain says */
        memset(points[0], 0, sizeof points[0]);
        weights[0] = 1;
        return 1;
    }
    count = of_mass ? table->mass_point_count : table->point_count;
    memcpy(points, of_mass ? table->mass_points : table->points, (size_t)count * sizeof points[0]);
    memcpy(weights, of_mass ? table->mass_weights : table->weights, (size_t)count * sizeof weights[0]);
    return count;
}

/* ---- checking the table of a custom element ---- */

/* How far numbers of the table may be off: users round them to as few as seven digits. */
static sb_real sbi_element_table_tolerance(void) { return SB_REAL_IS_FLOAT ? (sb_real)1e-4 : (sb_real)1e-6; }

static sb_result sbi_element_table_check_counts(const sb_element_table *table, sb_error *error)
{
    if (!table)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of custom elements has no element table");
    if (!table->name || !table->node_points || !table->shape || !table->points || !table->weights ||
        !table->mass_points || !table->mass_weights || !table->faces)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %s is NULL", table->name ? table->name : "",
                        !table->name                        ? "name"
                        : !table->node_points               ? "node_points"
                        : !table->shape                     ? "shape"
                        : !table->points || !table->weights ? "points or weights"
                        : !table->faces                     ? "faces"
                                                            : "mass_points or mass_weights");
    if (table->node_count < 4 || table->node_count > SB_MAX_ELEMENT_NODES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %d nodes are not in [4, %d]", table->name,
                        table->node_count, SB_MAX_ELEMENT_NODES);
    if (table->corner_count < 4 || table->corner_count > table->node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %d corners are not in [4, %d]", table->name,
                        table->corner_count, table->node_count);
    if (table->point_count < 1 || table->point_count > SB_MAX_QUADRATURE_POINTS || table->mass_point_count < 1 ||
        table->mass_point_count > SB_MAX_QUADRATURE_POINTS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %d points and %d mass points are not in [1, %d]",
                        table->name, table->point_count, table->mass_point_count, SB_MAX_QUADRATURE_POINTS);
    if (table->face_count < 4 || table->face_count > SB_MAX_ELEMENT_FACES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %d faces are not in [4, %d]", table->name,
                        table->face_count, SB_MAX_ELEMENT_FACES);
    if (table->vtk_type < 0 || table->vtk_type > 255)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: vtk_type %d is none of VTK's", table->name,
                        table->vtk_type);
    return SB_OK;
}

/* The nodes of a face: corners of the element at its corners, other nodes elsewhere, none twice. */
static sb_result sbi_element_table_check_face(const sb_element_table *table, int face, sb_error *error)
{
    const sb_element_table_face *f = &table->faces[face];
    int count = sb_element_node_count(f->type), corners = sb_element_corner_count(f->type);
    if (sb_element_dimension(f->type) != 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: face %d is no tri3, tri6, quad4, quad8 or quad9",
                        table->name, face);
    for (int i = 0; i < count; i++) {
        int low = i < corners ? 0 : table->corner_count, high = i < corners ? table->corner_count : table->node_count;
        if (f->nodes[i] < low || f->nodes[i] >= high)
            return sbi_fail_node(error, SB_ERROR_INDEX, f->nodes[i],
                                 "element table %s: node %d of face %d is %d, not one of %d to %d", table->name, i,
                                 face, f->nodes[i], low, high - 1);
        for (int j = 0; j < i; j++)
            if (f->nodes[j] == f->nodes[i])
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, f->nodes[i],
                                     "element table %s: face %d has node %d twice", table->name, face, f->nodes[i]);
    }
    return SB_OK;
}

/* Every side of a face is a side of exactly one other, run through the other way, with the same middle. */
static sb_result sbi_element_table_check_closed(const sb_element_table *table, sb_error *error)
{
    signed char middle[SB_MAX_ELEMENT_NODES][SB_MAX_ELEMENT_NODES]; /* of directed sides: -2 none, -1 straight */
    sbi_element element = sbi_element_make(SB_CUSTOM, table);
    memset(middle, -2, sizeof middle);
    for (int f = 0; f < table->face_count; f++)
        for (int side = 0, local[3]; sb_element_edge(table->faces[f].type, side, local); side++) {
            const int *nodes = table->faces[f].nodes;
            int a = nodes[local[0]], b = nodes[local[1]];
            if (middle[a][b] != -2)
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, a,
                                     "element table %s: two faces run from node %d to %d: one of them looks inward",
                                     table->name, a, b);
            middle[a][b] = (signed char)(local[2] < 0 ? -1 : nodes[local[2]]);
        }
    for (int a = 0; a < table->corner_count; a++)
        for (int b = 0; b < table->corner_count; b++)
            if (middle[a][b] != middle[b][a])
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, a,
                                     "element table %s: the faces do not fit together between nodes %d and %d",
                                     table->name, a, b);
    if (sbi_element_edge_count(element) > SB_MAX_ELEMENT_EDGES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %d edges are more than %d", table->name,
                        sbi_element_edge_count(element), SB_MAX_ELEMENT_EDGES);
    return SB_OK;
}

/* Volume that the faces enclose in the parameter domain: the flux of xi / 3 through them. */
static sb_real sbi_element_table_volume(const sb_element_table *table)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS], volume = 0;
    for (int f = 0; f < table->face_count; f++) {
        const sb_element_table_face *face = &table->faces[f];
        int n = sb_element_node_count(face->type);
        int count = sb_element_quadrature(face->type, SB_QUADRATURE_FACE, points, weights);
        for (int q = 0; q < count; q++) {
            sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3];
            sb_vec3 x = {0, 0, 0}, r = {0, 0, 0}, s = {0, 0, 0};
            sb_element_shape(face->type, points[q], shape, gradient);
            for (int a = 0; a < n; a++) {
                const sb_real *xi = table->node_points[face->nodes[a]];
                sb_vec3 at = sb_v3(xi[0], xi[1], xi[2]);
                x = sb_v3_madd(x, shape[a], at);
                r = sb_v3_madd(r, gradient[a][0], at);
                s = sb_v3_madd(s, gradient[a][1], at);
            }
            volume += weights[q] * sb_v3_dot(x, sb_v3_cross(r, s)) / 3;
        }
    }
    return volume;
}

static sb_result sbi_element_table_check_rule(const sb_element_table *table, int count, const sb_real (*points)[3],
                                              const sb_real *weights, const char *what, sb_error *error)
{
    sb_real sum = 0, volume = sbi_element_table_volume(table);
    for (int q = 0; q < count; q++) {
        if (!sb_is_finite(points[q][0]) || !sb_is_finite(points[q][1]) || !sb_is_finite(points[q][2]) ||
            !sb_is_finite(weights[q]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "element table %s: %s point %d is not finite", table->name,
                            what, q);
        if (!(weights[q] > 0))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "element table %s: %s weight %d is %g, not positive", table->name,
                            what, q, (double)weights[q]);
        sum += weights[q];
    }
    if (!(volume > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "element table %s: the faces enclose the volume %g: they look inward, or node_points are wrong",
                        table->name, (double)volume);
    if (!(sb_abs(sum - volume) <= sbi_element_table_tolerance() * volume))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "element table %s: the %s weights sum to %.9g, but the faces enclose %.9g", table->name, what,
                        (double)sum, (double)volume);
    return SB_OK;
}

/* N_a(xi_b) = 1 for a = b, else 0. */
static sb_result sbi_element_table_check_nodes(const sb_element_table *table, sb_error *error)
{
    sb_real shape[SB_MAX_ELEMENT_NODES];
    for (int b = 0; b < table->node_count; b++) {
        const sb_real *xi = table->node_points[b];
        if (!sb_is_finite(xi[0]) || !sb_is_finite(xi[1]) || !sb_is_finite(xi[2]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, b, "element table %s: node_points[%d] is not finite",
                                 table->name, b);
        table->shape(table->user, xi, shape, NULL);
        for (int a = 0; a < table->node_count; a++)
            if (!(sb_abs(shape[a] - (sb_real)(a == b)) <= sbi_element_table_tolerance()))
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, a,
                                     "element table %s: shape function %d is %g at node %d, not %d", table->name, a,
                                     (double)shape[a], b, a == b);
    }
    return SB_OK;
}

/* Largest extent of the parameter domain. */
static sb_real sbi_element_table_extent(const sb_element_table *table)
{
    sb_real extent = 0;
    for (int a = 1; a < table->node_count; a++)
        for (int k = 0; k < 3; k++)
            extent = sb_max(extent, sb_abs(table->node_points[a][k] - table->node_points[0][k]));
    return extent;
}

/* Sums at a point: of N to 1, of dN to 0, of N_a xi_a to xi. */
static sb_result sbi_element_table_check_sums(const sb_element_table *table, const sb_real xi[3], sb_error *error)
{
    sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3], sum = 0;
    sb_real slope[3] = {0, 0, 0}, at[3] = {0, 0, 0};
    sb_real tolerance = sbi_element_table_tolerance(), extent = sbi_element_table_extent(table);
    table->shape(table->user, xi, shape, gradient);
    for (int a = 0; a < table->node_count; a++) {
        sum += shape[a];
        for (int k = 0; k < 3; k++) {
            slope[k] += gradient[a][k];
            at[k] += shape[a] * table->node_points[a][k];
        }
    }
    if (!(sb_abs(sum - 1) <= tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "element table %s: the shape functions sum to %g at (%g, %g, %g), not 1", table->name,
                        (double)sum, (double)xi[0], (double)xi[1], (double)xi[2]);
    for (int k = 0; k < 3; k++) {
        if (!(sb_abs(slope[k]) * extent <= tolerance))
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "element table %s: the gradients sum to %g along axis %d at (%g, %g, %g), not 0",
                            table->name, (double)slope[k], k, (double)xi[0], (double)xi[1], (double)xi[2]);
        if (!(sb_abs(at[k] - xi[k]) <= tolerance * extent))
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "element table %s: linear fields are not reproduced: sum N_a xi_a is %g along axis %d, "
                            "not %g",
                            table->name, (double)at[k], k, (double)xi[k]);
    }
    return SB_OK;
}

/* Gradients against central differences, whose own error is of order h^2, and of rounding over h. */
static sb_result sbi_element_table_check_slopes(const sb_element_table *table, const sb_real xi[3], sb_error *error)
{
    sb_real gradient[SB_MAX_ELEMENT_NODES][3], up[SB_MAX_ELEMENT_NODES], down[SB_MAX_ELEMENT_NODES];
    sb_real step = SB_REAL_IS_FLOAT ? (sb_real)(1.0 / 128) : (sb_real)(1.0 / 8192);
    sb_real tolerance = SB_REAL_IS_FLOAT ? (sb_real)2e-2 : (sb_real)1e-5;
    sb_real extent = sbi_element_table_extent(table), h = step * extent;
    table->shape(table->user, xi, NULL, gradient);
    for (int k = 0; k < 3; k++) {
        sb_real beside[3] = {xi[0], xi[1], xi[2]};
        beside[k] = xi[k] + h;
        table->shape(table->user, beside, up, NULL);
        beside[k] = xi[k] - h;
        table->shape(table->user, beside, down, NULL);
        for (int a = 0; a < table->node_count; a++) {
            sb_real difference = (up[a] - down[a]) / (2 * h);
            if (!(sb_abs(gradient[a][k] - difference) * extent <= tolerance * (1 + sb_abs(difference) * extent)))
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, a,
                                     "element table %s: gradient %d of node %d is %g, but the slope of its shape "
                                     "function is %g",
                                     table->name, k, a, (double)gradient[a][k], (double)difference);
        }
    }
    return SB_OK;
}

/* Without a value at any mass point a node would have no mass. */
static sb_result sbi_element_table_check_mass(const sb_element_table *table, sb_error *error)
{
    sb_real shape[SB_MAX_ELEMENT_NODES], largest[SB_MAX_ELEMENT_NODES];
    memset(largest, 0, sizeof largest);
    for (int q = 0; q < table->mass_point_count; q++) {
        table->shape(table->user, table->mass_points[q], shape, NULL);
        for (int a = 0; a < table->node_count; a++)
            largest[a] = sb_max(largest[a], sb_abs(shape[a]));
    }
    for (int a = 0; a < table->node_count; a++)
        if (!(largest[a] > sbi_element_table_tolerance()))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, a,
                                 "element table %s: shape function %d is 0 at all mass points: the node has no mass",
                                 table->name, a);
    return SB_OK;
}

static sb_result sbi_element_table_check_cloud(const sb_element_table *table, sb_error *error)
{
    if (table->node_count < 4 || table->node_count > SB_MAX_ELEMENT_NODES || table->corner_count != table->node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cloud %s: its %d nodes are not in [4, %d], or not all its corners",
                        table->name, table->node_count, SB_MAX_ELEMENT_NODES);
    if (table->vtk_type != 0 && table->vtk_type != 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cloud %s: vtk_type %d is neither 2 (points) nor 0", table->name,
                        table->vtk_type);
    return SB_OK;
}

SB_API sb_result sb_element_table_check(const sb_element_table *table, sb_error *error)
{
    sb_result result;
    if (sbi_element_table_is_cloud(table) && table->name)
        return sbi_element_table_check_cloud(table, error);
    result = sbi_element_table_check_counts(table, error);
    for (int f = 0; result == SB_OK && f < table->face_count; f++)
        result = sbi_element_table_check_face(table, f, error);
    if (result == SB_OK)
        result = sbi_element_table_check_closed(table, error);
    if (result == SB_OK)
        result = sbi_element_table_check_nodes(table, error);
    if (result == SB_OK)
        result =
            sbi_element_table_check_rule(table, table->point_count, table->points, table->weights, "stiffness", error);
    if (result == SB_OK)
        result = sbi_element_table_check_rule(table, table->mass_point_count, table->mass_points, table->mass_weights,
                                              "mass", error);
    for (int q = 0; result == SB_OK && q < table->point_count; q++) {
        result = sbi_element_table_check_sums(table, table->points[q], error);
        if (result == SB_OK)
            result = sbi_element_table_check_slopes(table, table->points[q], error);
    }
    for (int q = 0; result == SB_OK && q < table->mass_point_count; q++)
        result = sbi_element_table_check_sums(table, table->mass_points[q], error);
    return result == SB_OK ? sbi_element_table_check_mass(table, error) : result;
}
