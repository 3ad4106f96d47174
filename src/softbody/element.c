/* element: tables of faces and edges, shape functions, quadrature. */
#include "element.h"

/* ---- names, faces, edges ---- */

SB_API const char *sb_element_name(sb_element_type type)
{
    switch (type) {
    case SB_TRI3: return "tri3";
    case SB_TRI6: return "tri6";
    case SB_QUAD4: return "quad4";
    case SB_TET4: return "tet4";
    case SB_TET10: return "tet10";
    case SB_HEX8: return "hex8";
    case SB_NO_ELEMENT: break;
    }
    return "unknown";
}

/* Outward faces; the first three columns are the faces of tet4. */
static const signed char sbi_element_tet_faces[4][6] = {
    {0, 1, 3, 4, 8, 7}, {1, 2, 3, 5, 9, 8}, {2, 0, 3, 6, 7, 9}, {0, 2, 1, 6, 5, 4}};
static const signed char sbi_element_hex_faces[6][4] = {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4},
                                                        {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}};

/* Ends of the edges; mid-edge nodes follow the corners in the order of the edges. */
static const signed char sbi_element_tri_edges[3][2] = {{0, 1}, {1, 2}, {2, 0}};
static const signed char sbi_element_quad_edges[4][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}};
static const signed char sbi_element_tet_edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
static const signed char sbi_element_hex_edges[12][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6},
                                                         {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};

static const signed char (*sbi_element_edges(sb_element_type type))[2]
{
    switch (type) {
    case SB_TRI3:
    case SB_TRI6: return sbi_element_tri_edges;
    case SB_QUAD4: return sbi_element_quad_edges;
    case SB_TET4:
    case SB_TET10: return sbi_element_tet_edges;
    case SB_HEX8: return sbi_element_hex_edges;
    case SB_NO_ELEMENT: break;
    }
    return NULL;
}

SB_API int sb_element_face(sb_element_type type, int face, int nodes[SB_MAX_FACE_NODES],
                           sb_element_type *face_type)
{
    if (face < 0 || face >= sb_element_face_count(type))
        return 0;
    sb_element_type of_face = type == SB_HEX8 ? SB_QUAD4 : (type == SB_TET10 ? SB_TRI6 : SB_TRI3);
    int count = sb_element_node_count(of_face);
    for (int i = 0; i < count; i++)
        nodes[i] = type == SB_HEX8 ? sbi_element_hex_faces[face][i] : sbi_element_tet_faces[face][i];
    if (face_type)
        *face_type = of_face;
    return count;
}

SB_API int sb_element_edge(sb_element_type type, int edge, int nodes[3])
{
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

/* Corners of quad4 (first four, without z) and hex8. */
static const signed char sbi_element_hex_corners[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                                                          {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};

SB_API int sb_element_node_point(sb_element_type type, int node, sb_real xi[3])
{
    int corners = sb_element_corner_count(type), dimension = sb_element_dimension(type);
    int ends[3] = {node, node, -1}; /* a corner is the middle of itself and itself */
    if (node < 0 || node >= sb_element_node_count(type))
        return 0;
    if (node >= corners)
        sb_element_edge(type, node - corners, ends);
    for (int k = 0; k < 3; k++) {
        if (type == SB_HEX8 || type == SB_QUAD4)
            xi[k] = k < dimension ? (sb_real)sbi_element_hex_corners[node][k] : (sb_real)0;
        else
            xi[k] = (sb_real)0.5 * (sb_real)((ends[0] == k + 1) + (ends[1] == k + 1));
    }
    return 1;
}

/* Simplex of `dimension` in barycentric coordinates L: N_a = L_a, or with mid-edge nodes N_a = L_a (2 L_a -
 * 1) and N_pq = 4 L_p L_q. dL_0 = (-1, -1, -1), dL_k = unit vector k - 1. */
static void sbi_element_shape_simplex(sb_element_type type, const sb_real xi[3], sb_real *shape,
                                      sb_real (*gradient)[3])
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

SB_API void sb_element_shape(sb_element_type type, const sb_real xi[3], sb_real *shape,
                             sb_real (*gradient)[3])
{
    if (type == SB_HEX8 || type == SB_QUAD4)
        sbi_element_shape_box(sb_element_dimension(type), xi, shape, gradient);
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
        sbi_element_rule_add(rule, (sb_real)(corner == 1 ? 1 - 2 * a : a),
                             (sb_real)(corner == 2 ? 1 - 2 * a : a), 0, (sb_real)(weight / 2));
}

/* Tet rules of degree 1, 2, 3 and 5 with 1, 4, 8 and 14 points (the last is Walkington's). */
static void sbi_element_rule_tet(sbi_element_rule *rule, int count)
{
    switch (count) {
    case 1:
        sbi_element_rule_add(rule, (sb_real)0.25, (sb_real)0.25, (sb_real)0.25, (sb_real)(1.0 / 6));
        break;
    case 4: /* a = (5 - sqrt(5)) / 20 */
        sbi_element_rule_tet_corners(rule, 0.13819660112501051518, 0.25);
        break;
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
        sbi_element_rule_add(rule, i & 1 ? g : -g, i & 2 ? g : -g,
                             dimension == 2 ? (sb_real)0 : (i & 4 ? g : -g), 1);
}

/* Surfaces: tri3 degree 2, tri6 degree 4 (a follower pressure needs it), quad4 degree 3. */
static void sbi_element_rule_surface(sbi_element_rule *rule, sb_element_type type)
{
    if (type == SB_TRI3) {
        sbi_element_rule_triangle(rule, 1.0 / 6, 1.0 / 3);
    } else if (type == SB_TRI6) {
        sbi_element_rule_triangle(rule, 0.445948490915965, 0.223381589678011);
        sbi_element_rule_triangle(rule, 0.091576213509771, 0.109951743655322);
    } else {
        sbi_element_rule_box(rule, 2);
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
                                 sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                 sb_real weights[SB_MAX_QUADRATURE_POINTS])
{
    int dimension = sb_element_dimension(type), tet_points = sbi_element_tet_points(type, kind);
    sbi_element_rule rule;
    rule.points = points;
    rule.weights = weights;
    rule.count = 0;
    if (kind < SB_QUADRATURE_STIFFNESS || kind > SB_QUADRATURE_FACE)
        return 0;
    if (dimension == 2)
        sbi_element_rule_surface(&rule, type);
    else if (dimension == 3 && tet_points > 0 && type == SB_HEX8)
        sbi_element_rule_box(&rule, 3);
    else if (dimension == 3 && tet_points > 0)
        sbi_element_rule_tet(&rule, tet_points);
    return rule.count;
}
