/* mesh_shape: what follows from the shape of an element: Jacobians, defects, volumes, areas, quality, angles. */
#include "mesh_private.h"

/* ---- Jacobians ---- */

static void sbi_mesh_table_add(sbi_mesh_table *table, sbi_element element, const sb_real xi[3], sb_real weight)
{
    sbi_element_shape(element, xi, table->shape[table->count], table->gradient[table->count]);
    table->weight[table->count++] = weight;
}

static void sbi_mesh_table_add_rule(sbi_mesh_table *table, sbi_element element, sb_quadrature_kind kind)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = sbi_element_quadrature(element, kind, points, weights);
    for (int i = 0; i < count; i++)
        sbi_mesh_table_add(table, element, points[i], weights[i]);
}

SBI_API void sbi_mesh_table_for_volume(sbi_mesh_table *table, sbi_element element)
{
    table->count = 0;
    sbi_mesh_table_add_rule(table, element, element.table ? SB_QUADRATURE_MASS : SB_QUADRATURE_STIFFNESS_CURVED);
}

SBI_API void sbi_mesh_table_for_checks(sbi_mesh_table *table, sbi_element element)
{
    sb_real xi[3] = {0, 0, 0}, points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_element_type type = element.type, sampled = type == SB_HEX20 ? SB_HEX27 : type;
    table->count = 0;
    if (sb_element_straight(type) == SB_QUAD4)
        element = sbi_element_make(SB_QUAD4, NULL), sampled = SB_QUAD4;
    for (int a = 0; sb_element_node_point(sampled, a, xi); a++)
        sbi_mesh_table_add(table, element, xi, 0);
    if (type == SB_TET10) {
        sb_element_quadrature(type, SB_QUADRATURE_STIFFNESS_CURVED, points, weights);
        for (int i = 4; i < 8; i++)
            sbi_mesh_table_add(table, element, points[i], 0);
    }
    if (type == SB_CUSTOM)
        sbi_mesh_table_add_rule(table, element, SB_QUADRATURE_STIFFNESS);
    if (sb_element_dimension(type) == 3 && type != SB_TET4)
        sbi_mesh_table_add_rule(table, element, SB_QUADRATURE_MASS);
}

SBI_API void sbi_mesh_local_make(const sb_mesh *mesh, int element, sbi_mesh_local *local)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    sb_vec3 origin = mesh->nodes[nodes[0]];
    sb_real magnitude = 0;
    local->size = 0;
    for (int a = 0; a < n; a++) {
        local->x[a] = sb_v3_sub(mesh->nodes[nodes[a]], origin);
        local->size = sb_max(local->size, sbi_mesh_max_abs(local->x[a]));
        magnitude = sb_max(magnitude, sbi_mesh_max_abs(mesh->nodes[nodes[a]]));
    }
    local->rounding = 8 * SB_EPSILON; /* coordinates carry an absolute error of eps * magnitude */
    if (local->size > 0) {
        local->rounding *= 1 + magnitude / local->size;
        for (int a = 0; a < n; a++)
            local->x[a] = sb_v3(local->x[a].x / local->size, local->x[a].y / local->size, local->x[a].z / local->size);
    }
}

SBI_API sb_mat3 sbi_mesh_jacobian(const sbi_mesh_table *table, int point, int node_count, const sb_vec3 *x)
{
    sb_vec3 column[3];
    for (int k = 0; k < 3; k++) {
        column[k] = sb_v3(0, 0, 0);
        for (int a = 0; a < node_count; a++)
            column[k] = sb_v3_madd(column[k], table->gradient[point][a][k], x[a]);
    }
    return sb_m3_columns(column[0], column[1], column[2]);
}

/* ---- defects of one element ---- */

/* Smallest Jacobian at a corner of the hex8 with these corners: an eighth of the triple product of its edges there. */
static sb_real sbi_mesh_hex_corner_det(const sb_vec3 *x)
{
    static const signed char beside[8][3] = {{1, 3, 4}, {2, 0, 5}, {3, 1, 6}, {0, 2, 7},
                                             {7, 5, 0}, {4, 6, 1}, {5, 7, 2}, {6, 4, 3}};
    sb_real least = SB_REAL_MAX;
    for (int a = 0; a < 8; a++) {
        sb_mat3 edges = sb_m3_columns(sb_v3_sub(x[beside[a][0]], x[a]), sb_v3_sub(x[beside[a][1]], x[a]),
                                      sb_v3_sub(x[beside[a][2]], x[a]));
        sb_real det = sb_m3_det(edges) / 8;
        if (!(det >= least))
            least = det;
    }
    return least;
}

static sb_mesh_defect sbi_mesh_defect_of_sign(sb_real det, sb_real rounding)
{
    if (det > rounding)
        return SB_MESH_SOUND;
    return det < -rounding ? SB_MESH_INVERTED : SB_MESH_FLAT; /* flat: also NaN from coordinates near the largest */
}

/* Worst sign of the Jacobian over the table's points, inverted before flat. */
static sb_mesh_defect sbi_mesh_sampled_defect(const sbi_mesh_table *table, int node_count, const sbi_mesh_local *local)
{
    sb_mesh_defect worst = SB_MESH_SOUND;
    for (int i = 0; i < table->count; i++) {
        sb_real det = sb_m3_det(sbi_mesh_jacobian(table, i, node_count, local->x));
        sb_mesh_defect defect = sbi_mesh_defect_of_sign(det, local->rounding);
        if (defect == SB_MESH_INVERTED)
            return defect;
        if (defect != SB_MESH_SOUND)
            worst = defect;
    }
    return worst;
}

static sb_mesh_defect sbi_mesh_shape_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    int n = sb_mesh_element_width(mesh);
    sb_mesh_defect defect;
    sbi_mesh_local local;
    sbi_mesh_local_make(mesh, element, &local);
    if (sb_element_dimension(mesh->element_type) == 2) {
        int is_quad = sb_element_straight(mesh->element_type) == SB_QUAD4;
        sb_vec3 across = is_quad ? sb_v3_sub(local.x[3], local.x[1]) : local.x[1];
        return sb_v3_norm(sb_v3_cross(local.x[2], across)) > local.rounding ? SB_MESH_SOUND : SB_MESH_FLAT;
    }
    if (mesh->element_type == SB_HEX8 || mesh->element_type == SB_CUSTOM)
        return sbi_mesh_sampled_defect(table, n, &local);
    defect =
        sbi_mesh_defect_of_sign(sb_element_straight(mesh->element_type) == SB_HEX8 ? sbi_mesh_hex_corner_det(local.x)
                                                                                   : sbi_mesh_corner_det(local.x),
                                local.rounding);
    if (defect != SB_MESH_SOUND || mesh->element_type == SB_TET4)
        return defect;
    return sbi_mesh_sampled_defect(table, n, &local) == SB_MESH_SOUND ? SB_MESH_SOUND : SB_MESH_BAD_MIDSIDE;
}

static int sbi_mesh_has_repeated_node(const int *nodes, int count)
{
    for (int a = 1; a < count; a++)
        for (int b = 0; b < a; b++)
            if (nodes[a] == nodes[b])
                return 1;
    return 0;
}

SBI_API sb_mesh_defect sbi_mesh_element_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh), index;
    if (sbi_mesh_index_out_of_range(mesh, element, &index))
        return SB_MESH_INDEX_RANGE;
    for (int a = 0; a < n; a++)
        if (!sb_v3_is_finite(mesh->nodes[nodes[a]]))
            return SB_MESH_NODE_NOT_FINITE;
    if (sbi_mesh_is_cloud(mesh))
        return SB_MESH_SOUND;
    if (sbi_mesh_has_repeated_node(nodes, n))
        return SB_MESH_REPEATED_NODE;
    return sbi_mesh_shape_defect(mesh, table, element);
}

SBI_API int sbi_mesh_finite_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high)
{
    int found = 0;
    for (int v = 0; v < mesh->node_count; v++) {
        sb_vec3 x = mesh->nodes[v];
        if (!sb_v3_is_finite(x))
            continue;
        *low = found ? sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z)) : x;
        *high = found ? sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z)) : x;
        found = 1;
    }
    return found;
}

/* ---- geometry ---- */

static sb_real sbi_mesh_volume_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    sb_vec3 x[SBI_MESH_NODES];
    sb_real volume = 0;
    for (int a = 0; a < n; a++)
        x[a] = sb_v3_sub(mesh->nodes[nodes[a]], mesh->nodes[nodes[0]]);
    if (mesh->element_type == SB_TET4)
        return sb_v3_dot(x[1], sb_v3_cross(x[2], x[3])) / 6;
    for (int i = 0; i < table->count; i++)
        volume += table->weight[i] * sb_m3_det(sbi_mesh_jacobian(table, i, n, x));
    return volume;
}

SBI_API void sbi_mesh_area_and_flux(const sb_mesh *mesh, const sbi_mesh_table *table, int element, sb_vec3 origin,
                                    double *area, double *flux)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_mesh_element_width(mesh);
    sb_vec3 x[SBI_MESH_NODES], offset = sb_v3_sub(mesh->nodes[nodes[0]], origin);
    *area = *flux = 0;
    for (int a = 0; a < n; a++)
        x[a] = sb_v3_sub(mesh->nodes[nodes[a]], mesh->nodes[nodes[0]]);
    for (int i = 0; i < table->count; i++) {
        sb_mat3 jacobian = sbi_mesh_jacobian(table, i, n, x);
        sb_vec3 normal = sb_v3_cross(sb_m3_column(jacobian, 0), sb_m3_column(jacobian, 1)), point = offset;
        for (int a = 0; a < n; a++)
            point = sb_v3_madd(point, table->shape[i][a], x[a]);
        *area += (double)(table->weight[i] * sb_v3_norm(normal));
        *flux += (double)(table->weight[i] * sb_v3_dot(point, normal)) / 3;
    }
}

static int sbi_mesh_has_element(const sb_mesh *mesh, int element)
{
    return mesh && mesh->nodes && mesh->elements && element >= 0 && element < mesh->element_count &&
           sb_mesh_element_width(mesh) > 0;
}

SB_API sb_real sb_mesh_element_volume(const sb_mesh *mesh, int element)
{
    sbi_mesh_table table;
    if (!sbi_mesh_has_element(mesh, element) || sb_element_dimension(mesh->element_type) != 3)
        return 0;
    sbi_mesh_table_for_volume(&table, sbi_mesh_element_kind(mesh));
    return sbi_mesh_volume_of(mesh, &table, element);
}

SBI_API void sbi_mesh_measure(const sb_mesh *mesh, const unsigned char *bad, double *area, double *volume)
{
    sbi_mesh_table table;
    sb_vec3 origin = sb_v3(0, 0, 0);
    int has_origin = 0;
    *area = *volume = 0;
    sbi_mesh_table_for_volume(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        double element_area = 0, element_volume = 0;
        if (bad && bad[e])
            continue;
        if (!has_origin)
            origin = mesh->nodes[sbi_mesh_element(mesh, e)[0]], has_origin = 1;
        if (sb_element_dimension(mesh->element_type) == 3)
            element_volume = (double)sbi_mesh_volume_of(mesh, &table, e);
        else
            sbi_mesh_area_and_flux(mesh, &table, e, origin, &element_area, &element_volume);
        *area += element_area;
        *volume += element_volume;
    }
}

SB_API sb_real sb_mesh_volume(const sb_mesh *mesh)
{
    double area = 0, volume = 0;
    if (sbi_mesh_has_element(mesh, 0))
        sbi_mesh_measure(mesh, NULL, &area, &volume);
    return (sb_real)volume;
}

SB_API sb_real sb_mesh_surface_area(const sb_mesh *mesh)
{
    double area = 0, volume = 0;
    if (sbi_mesh_has_element(mesh, 0) && sb_element_dimension(mesh->element_type) == 2)
        sbi_mesh_measure(mesh, NULL, &area, &volume);
    return (sb_real)area;
}

SB_API void sb_mesh_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high)
{
    if (!low || !high)
        return;
    *low = *high = sb_v3(0, 0, 0);
    if (mesh && mesh->nodes)
        sbi_mesh_finite_bounds(mesh, low, high);
}

static sb_real sbi_mesh_edge_squares(sb_element_type type, const sb_vec3 *x)
{
    sb_real sum = 0;
    int ends[3];
    for (int i = 0; i < sb_element_edge_count(type); i++) {
        sb_vec3 edge;
        sb_element_edge(type, i, ends);
        edge = sb_v3_sub(x[ends[1]], x[ends[0]]);
        sum += sb_v3_dot(edge, edge);
    }
    return sum;
}

/* 12 (3V)^(2/3) / sum of squared edges, with the sign of V. */
static sb_real sbi_mesh_tet_quality(const sb_vec3 *x)
{
    sb_real det = sbi_mesh_corner_det(x), root;
    if (det == 0)
        return 0;
    root = sb_cbrt(sb_abs(det) / 2); /* 3V = det / 2 */
    return (det < 0 ? -12 : 12) * root * root / sbi_mesh_edge_squares(SB_TET4, x);
}

/* Smallest triple product of the columns dx/dxi at `count` points of the table, scaled to length 1; the third column of
 * a quad is its mean normal. */
static sb_real sbi_mesh_scaled_jacobian(const sbi_mesh_table *table, int count, int nodes, int is_quad,
                                        const sb_vec3 *x)
{
    sb_vec3 mean = is_quad ? sb_v3_cross(sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[1])) : sb_v3(0, 0, 0);
    sb_real worst = 1;
    for (int i = 0; i < count; i++) {
        sb_mat3 jacobian = sbi_mesh_jacobian(table, i, nodes, x);
        sb_vec3 a = sb_m3_column(jacobian, 0), b = sb_m3_column(jacobian, 1),
                c = is_quad ? mean : sb_m3_column(jacobian, 2);
        sb_real lengths = sb_v3_norm(a) * sb_v3_norm(b) * sb_v3_norm(c);
        sb_real quality = lengths > 0 ? sb_v3_dot(c, sb_v3_cross(a, b)) / lengths : (sb_real)0;
        worst = sb_min(worst, quality);
    }
    return worst;
}

static sb_real sbi_mesh_triangle_quality(const sb_vec3 *x)
{
    sb_real doubled = sb_v3_norm(sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0])));
    return (sb_real)3.46410161513775458705 * doubled / sbi_mesh_edge_squares(SB_TRI3, x);
}

/* Smallest over largest Jacobian: 1 for straight edges. */
static sb_real sbi_mesh_jacobian_ratio(const sbi_mesh_table *table, const sb_vec3 *x)
{
    sb_real low = SB_REAL_MAX, high = 0;
    for (int i = 0; i < table->count; i++) {
        sb_real det = sb_m3_det(sbi_mesh_jacobian(table, i, 10, x));
        low = sb_min(low, det);
        high = sb_max(high, det);
    }
    return high > 0 ? low / high : (sb_real)0;
}

SBI_API sb_real sbi_mesh_quality_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sb_real quality;
    sbi_mesh_local local;
    sbi_mesh_local_make(mesh, element, &local);
    if (!(local.size > 0))
        return 0;
    switch (mesh->element_type) {
    case SB_TET4: return sbi_mesh_tet_quality(local.x);
    case SB_TET10:
        quality = sbi_mesh_tet_quality(local.x);
        return quality > 0 ? quality * sbi_mesh_jacobian_ratio(table, local.x) : quality;
    case SB_HEX8: return sbi_mesh_scaled_jacobian(table, 8, 8, 0, local.x);
    case SB_HEX20:
    case SB_HEX27:
    case SB_CUSTOM: return sbi_mesh_scaled_jacobian(table, table->count, sb_mesh_element_width(mesh), 0, local.x);
    case SB_QUAD4:
    case SB_QUAD8:
    case SB_QUAD9: return sbi_mesh_scaled_jacobian(table, 4, 4, 1, local.x);
    case SB_TRI3:
    case SB_TRI6: return sbi_mesh_triangle_quality(local.x);
    case SB_NO_ELEMENT: break;
    }
    return 0;
}

SB_API sb_real sb_mesh_element_quality(const sb_mesh *mesh, int element)
{
    sbi_mesh_table table;
    if (!sbi_mesh_has_element(mesh, element))
        return 0;
    if (sbi_mesh_is_cloud(mesh))
        return 1;
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    return sbi_mesh_quality_of(mesh, &table, element);
}

SBI_API void sbi_mesh_tet_cosines(const sb_vec3 corners[4], sb_real *of_smallest, sb_real *of_largest)
{
    sb_vec3 a = sb_v3_sub(corners[1], corners[0]), b = sb_v3_sub(corners[2], corners[0]);
    sb_vec3 c = sb_v3_sub(corners[3], corners[0]), normals[4];
    sb_real size[4];
    normals[1] = sb_v3_cross(b, c);
    normals[2] = sb_v3_cross(c, a);
    normals[3] = sb_v3_cross(a, b);
    normals[0] = sb_v3_scale(-1, sb_v3_add(normals[1], sb_v3_add(normals[2], normals[3])));
    *of_smallest = -1;
    *of_largest = 1;
    for (int i = 0; i < 4; i++)
        size[i] = sb_v3_norm(normals[i]);
    for (int i = 0; i < 4; i++)
        for (int j = i + 1; j < 4; j++) {
            sb_real product = size[i] * size[j], cosine;
            if (!(product > 0)) { /* a face without an area: as bad as can be */
                *of_smallest = 1;
                *of_largest = -1;
                return;
            }
            cosine = -sb_v3_dot(normals[i], normals[j]) / product;
            *of_smallest = cosine <= *of_smallest ? *of_smallest : cosine;
            *of_largest = cosine >= *of_largest ? *of_largest : cosine;
        }
}

SB_API void sb_mesh_dihedral_range(const sb_mesh *mesh, sb_real *smallest, sb_real *largest)
{
    const sb_real degrees = (sb_real)57.295779513082321;
    sb_real sharp = -1, blunt = 1;
    int is_tet =
        mesh && mesh->nodes && mesh->elements && (mesh->element_type == SB_TET4 || mesh->element_type == SB_TET10);
    for (int e = 0; is_tet && e < mesh->element_count; e++) {
        const int *nodes = mesh->elements + (size_t)e * (size_t)sb_mesh_element_width(mesh);
        sb_vec3 corners[4];
        sb_real of_smallest, of_largest;
        for (int a = 0; a < 4; a++)
            corners[a] = mesh->nodes[nodes[a]];
        sbi_mesh_tet_cosines(corners, &of_smallest, &of_largest);
        sharp = of_smallest <= sharp ? sharp : of_smallest;
        blunt = of_largest >= blunt ? blunt : of_largest;
    }
    if (smallest)
        *smallest = is_tet ? degrees * sb_acos(sb_min(sharp, 1)) : 0;
    if (largest)
        *largest = is_tet ? degrees * sb_acos(sb_max(blunt, -1)) : 0;
}
