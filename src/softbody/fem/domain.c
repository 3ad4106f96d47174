/* domain: integration points from elements. */
#include "domain.h"
#include "patch.h"

#include <limits.h>
#include <string.h>

SB_API void sb_domain_free(sb_domain *domain)
{
    sb_allocator allocator;
    if (!domain)
        return;
    allocator = domain->allocator;
    sbi_free(&allocator, domain->cells);
    sbi_free(&allocator, domain->gradients);
    sbi_free(&allocator, domain->weights);
    sbi_free(&allocator, domain->cell_mass);
    sbi_free(&allocator, domain->cell_patch);
    memset(domain, 0, sizeof *domain);
}

/* Je_ij = sum_a X_a,i dN_a/dxi_j */
static sb_mat3 sbi_domain_jacobian(int node_count, const sb_vec3 *x, const sb_real (*local_gradient)[3])
{
    sb_mat3 jacobian = sb_m3_zero();
    for (int a = 0; a < node_count; a++)
        for (int j = 0; j < 3; j++) {
            sb_real d = local_gradient[a][j];
            jacobian.m[0][j] += x[a].x * d;
            jacobian.m[1][j] += x[a].y * d;
            jacobian.m[2][j] += x[a].z * d;
        }
    return jacobian;
}

/* The same of a tet4 in fewer sums, to the last bit: slopes are 1, -1 and 0. (0 - a, not -a: no zero is negative.) */
static sb_mat3 sbi_domain_tet_jacobian(const sb_vec3 x[4])
{
    sb_vec3 from = sb_v3_sub(sb_v3(0, 0, 0), x[0]);
    sb_mat3 jacobian;
    for (int j = 0; j < 3; j++) {
        jacobian.m[0][j] = from.x + x[j + 1].x;
        jacobian.m[1][j] = from.y + x[j + 1].y;
        jacobian.m[2][j] = from.z + x[j + 1].z;
    }
    return jacobian;
}

/* det Je; 0 of an element that is so thin or so large that gradients would be no numbers. */
static sb_real sbi_domain_det(sb_mat3 jacobian)
{
    sb_mat3 cofactor = sb_m3_cofactor(jacobian);
    sb_real det = sb_m3_det(jacobian), largest = 1;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            largest = sb_max(largest, sb_abs(cofactor.m[i][j]));
    return det > 0 && !(det > 4 / SB_REAL_MAX * largest) ? 0 : det;
}

/* Gradients g_a = Je^-T dN_a/dxi at one point; det: of Je, > 0. */
SBI_FORCE_INLINE void sbi_domain_gradients(const int node_count, sb_mat3 jacobian, sb_real det,
                                           const sb_real (*local_gradient)[3], sb_real *gradient)
{
    sb_mat3 inverse_transpose = sb_m3_scale((sb_real)1 / det, sb_m3_cofactor(jacobian));
    for (int a = 0; a < node_count; a++) {
        const sb_real *d = local_gradient[a];
        sb_vec3 g = sb_m3_apply(inverse_transpose, sb_v3(d[0], d[1], d[2]));
        gradient[3 * a] = g.x;
        gradient[3 * a + 1] = g.y;
        gradient[3 * a + 2] = g.z;
    }
}

/* Gradients at one point where sbi_domain_det is > 0; returns it. */
static sb_real sbi_domain_point(int node_count, const sb_vec3 *x, const sb_real (*local_gradient)[3], sb_real *gradient)
{
    sb_mat3 jacobian = sbi_domain_jacobian(node_count, x, local_gradient);
    sb_real det = sbi_domain_det(jacobian);
    if (det > 0)
        sbi_domain_gradients(node_count, jacobian, det, local_gradient, gradient);
    return det;
}

/* 1 when a mid-edge node of a tet10 stands off the middle of its edge by more than rounding. */
static int sbi_domain_tet10_is_curved(const sb_vec3 *x)
{
    for (int e = 0; e < 6; e++) {
        int ends[3];
        sb_element_edge(SB_TET10, e, ends);
        sb_vec3 a = x[ends[0]], b = x[ends[1]], mid = x[ends[2]];
        sb_vec3 offset = sb_v3_sub(mid, sb_v3_scale((sb_real)0.5, sb_v3_add(a, b)));
        sb_real reach = sb_max(sb_v3_norm(sb_v3_sub(b, a)), SB_EPSILON * (sb_v3_norm(a) + sb_v3_norm(b)));
        if (sb_v3_norm(offset) > (sb_real)1e-5 * reach)
            return 1;
    }
    return 0;
}

static void sbi_domain_gather(const int *elements, const sb_vec3 *positions, int element, int node_count, sb_vec3 *x)
{
    const int *nodes = elements + (size_t)element * (size_t)node_count;
    for (int a = 0; a < node_count; a++)
        x[a] = positions[nodes[a]];
}

static int sbi_domain_has_curved_side(const sb_mesh *mesh)
{
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    if (mesh->element_type != SB_TET10)
        return 0;
    for (int e = 0; e < mesh->element_count; e++) {
        sbi_domain_gather(mesh->elements, mesh->nodes, e, 10, x);
        if (sbi_domain_tet10_is_curved(x))
            return 1;
    }
    return 0;
}

static sb_result sbi_domain_refuse_curved(int cell, sb_error *error)
{
    return sbi_fail_element(error, SB_ERROR_UNSUPPORTED, cell,
                            "cell %d has curved sides: it cannot be a piece of an element", cell);
}

SBI_API sb_result sbi_domain_check_straight(const sb_domain *domain, const sb_vec3 *positions, sb_error *error)
{
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    for (int e = 0; e < domain->cell_count && domain->element_type == SB_TET10; e++) {
        if (sbi_domain_is_free(domain, e))
            continue;
        sbi_domain_gather(domain->cells, positions, e, 10, x);
        if (sbi_domain_tet10_is_curved(x))
            return sbi_domain_refuse_curved(e, error);
    }
    return SB_OK;
}

/* ---- mean points ----
 * The volume's share of a cell's energy is sum_k W_k U(F_k) over its mean points with F_k = I + sum_a u_a (x) G_a,k,
 *     G_a(x) = sum_ij phi_i(x) M^-1_ij sum_p w_p phi_j(x_p) g_a,p,   M_ij = sum_p w_p phi_i(x_p) phi_j(x_p),
 * g projected onto phi = 1 or (1, xi, eta, zeta). The four mean points are corners of a regular tetrahedron in the cube
 * on which products of phi are integrated exactly, and W_k those weights that give every phi its integral over the
 * cell: then a constant stress has the nodal forces that it has at the ordinary points, whatever the cell's shape. */

static const sb_real sbi_mean_corner[SB_MAX_MEAN_POINTS][3] = {{1, 1, 1}, {1, -1, -1}, {-1, 1, -1}, {-1, -1, 1}};

/* 1/sqrt(3): where the corners lie, times their signs. */
#define SBI_MEAN_AT ((sb_real)0.57735026918962576451)

/* Mean points that SB_INTEGRATION_BBAR gives an element; 0: none. */
static int sbi_domain_mean_points(sb_element_type type)
{
    switch (type) {
    case SB_TET10:
    case SB_HEX8: return 1;
    case SB_HEX20:
    case SB_HEX27: return 4;
    default: return 0;
    }
}

SBI_API void sbi_domain_mean_shares(int mean_points, const sb_real xi[3], sb_real shares[SB_MAX_MEAN_POINTS])
{
    for (int k = 0; k < mean_points; k++) {
        const sb_real *corner = sbi_mean_corner[k];
        shares[k] =
            mean_points == 1
                ? (sb_real)1
                : (sb_real)0.25 * (1 + (corner[0] * xi[0] + corner[1] * xi[1] + corner[2] * xi[2]) / SBI_MEAN_AT);
    }
}

/* The gradients g_a = sum_p w_p g_a,p / V of a cell with V = sum_p w_p, which it returns; 0 in a cell without any. */
static sb_real sbi_domain_mean_gradients(const sb_real *weights, const sb_real *gradients, int ordinary, size_t values,
                                         sb_real *mean)
{
    sb_real volume = 0;
    for (int p = 0; p < ordinary; p++)
        volume += weights[p];
    for (size_t k = 0; k < values; k++) {
        sb_real sum = 0;
        for (int p = 0; p < ordinary; p++)
            sum += weights[p] * gradients[(size_t)p * values + k];
        mean[k] = volume > 0 ? sum / volume : 0;
    }
    return volume;
}

/* L of M = L L^T with M as above, points [ordinary][3]; its first column has the integrals of phi over L[0][0]. */
static void sbi_domain_moments(const sb_real *weights, const sb_real (*points)[3], int ordinary, sb_real l[4][4])
{
    memset(l, 0, 16 * sizeof(sb_real));
    for (int p = 0; p < ordinary; p++) {
        const sb_real phi[4] = {1, points[p][0], points[p][1], points[p][2]};
        for (int i = 0; i < 4; i++)
            for (int j = 0; j <= i; j++)
                l[i][j] += weights[p] * phi[i] * phi[j];
    }
    for (int j = 0; j < 4; j++) {
        for (int k = 0; k < j; k++)
            l[j][j] -= l[j][k] * l[j][k];
        l[j][j] = sb_sqrt(l[j][j]);
        for (int i = j + 1; i < 4; i++) {
            for (int k = 0; k < j; k++)
                l[i][j] -= l[i][k] * l[j][k];
            l[i][j] /= l[j][j];
        }
    }
}

/* x <- (L L^T)^-1 x */
static void sbi_domain_solve_moments(const sb_real l[4][4], sb_real x[4])
{
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < i; k++)
            x[i] -= l[i][k] * x[k];
        x[i] /= l[i][i];
    }
    for (int i = 3; i >= 0; i--) {
        for (int k = i + 1; k < 4; k++)
            x[i] -= l[k][i] * x[k];
        x[i] /= l[i][i];
    }
}

/* Weights of the four mean points; 0 where the cell is so distorted that one would not be positive. */
static int sbi_domain_mean_weights(const sb_real l[4][4], sb_real weights[4])
{
    int good = 1;
    for (int k = 0; k < 4; k++) {
        sb_real sum = l[0][0];
        for (int i = 0; i < 3; i++)
            sum += sbi_mean_corner[k][i] * l[i + 1][0] / SBI_MEAN_AT;
        weights[k] = (sb_real)0.25 * l[0][0] * sum;
        good &= weights[k] > 0;
    }
    return good;
}

/* Projected gradients, by columns of a cell's 3 n values: [4][values]. */
static void sbi_domain_project(const sb_real *weights, const sb_real *gradients, const sb_real (*points)[3],
                               int ordinary, size_t values, const sb_real l[4][4], sb_real *means)
{
    for (size_t k = 0; k < values; k++) {
        sb_real c[4] = {0, 0, 0, 0};
        for (int p = 0; p < ordinary; p++) {
            sb_real g = weights[p] * gradients[(size_t)p * values + k];
            c[0] += g;
            for (int i = 0; i < 3; i++)
                c[i + 1] += points[p][i] * g;
        }
        sbi_domain_solve_moments(l, c);
        for (int m = 0; m < 4; m++) {
            sb_real sum = c[0];
            for (int i = 0; i < 3; i++)
                sum += SBI_MEAN_AT * sbi_mean_corner[m][i] * c[i + 1];
            means[(size_t)m * values + k] = sum;
        }
    }
}

/* The mean points of a cell, after its `ordinary` others at local coordinates points[ordinary]. A cell too distorted
 * for four of its own has its one mean four times. */
static void sbi_domain_fill_means(sb_domain *domain, int cell, int ordinary, const sb_real (*points)[3])
{
    size_t first = (size_t)cell * (size_t)domain->points_per_cell, values = 3 * (size_t)domain->nodes_per_cell;
    sb_real *weights = domain->weights + first, *gradients = domain->gradients + first * values;
    sb_real *mean = gradients + (size_t)ordinary * values, l[4][4];
    int count = domain->mean_points;
    sb_real volume = sbi_domain_mean_gradients(weights, gradients, ordinary, values, mean);
    for (int m = 0; m < count; m++)
        weights[ordinary + m] = volume / (sb_real)count;
    for (int m = 1; m < count; m++)
        memcpy(mean + (size_t)m * values, mean, values * sizeof(sb_real));
    if (count == 1 || !(volume > 0))
        return;
    sbi_domain_moments(weights, points, ordinary, l);
    if (sbi_domain_mean_weights((const sb_real(*)[4])l, weights + ordinary))
        sbi_domain_project(weights, gradients, points, ordinary, values, (const sb_real(*)[4])l, mean);
    else
        for (int m = 0; m < count; m++)
            weights[ordinary + m] = volume / (sb_real)count;
}

static sb_result sbi_domain_refuse(int e, int point, sb_real det, sb_error *error)
{
    if (!(det > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, e,
                                "element %d is inverted or flat at integration point %d (Jacobian %g)", e, point,
                                (double)det);
    return sbi_fail_element(error, SB_ERROR_MESH, e, /* the product of small numbers */
                            "element %d is too small: nothing is left of its volume at integration point %d", e, point);
}

SBI_API sb_real sbi_domain_tet_volume(const sb_vec3 x[4])
{
    sb_vec3 a = sb_v3_sub(x[1], x[0]), b = sb_v3_sub(x[2], x[0]), c = sb_v3_sub(x[3], x[0]);
    return sb_v3_dot(a, sb_v3_cross(b, c)) / 6;
}

/* Gradients of the shape functions at the points of a piece, in the cell's coordinates. */
static void sbi_domain_piece_slopes(sbi_element element, const sbi_piece *piece, int q,
                                    sb_real (*local)[SB_MAX_ELEMENT_NODES][3])
{
    sb_real points[4][3];
    sbi_piece_points(piece, points);
    for (int p = 0; p < q; p++)
        sbi_element_shape(element, points[p], NULL, local[p]);
}

/* Gradients and weights of one cell. */
static sb_result sbi_domain_fill_cell(sb_domain *domain, int e, int q, const sb_vec3 *x,
                                      const sb_real (*local)[SB_MAX_ELEMENT_NODES][3], const sb_real (*points)[3],
                                      const sb_real *weights, sb_real share, int is_piece, sb_error *error)
{
    size_t first = (size_t)e * (size_t)domain->points_per_cell, values = 3 * (size_t)domain->nodes_per_cell;
    for (int p = 0; p < q; p++) {
        size_t at = first + (size_t)p;
        sb_real det = sbi_domain_point(domain->nodes_per_cell, x, local[p], domain->gradients + at * values);
        domain->weights[at] = det * weights[p];
        domain->weights[at] *= share;
        if (!(det > 0) || (!is_piece && !(domain->weights[at] > 0)))
            return sbi_domain_refuse(e, p, det, error);
    }
    if (domain->mean_points)
        sbi_domain_fill_means(domain, e, q, points);
    return SB_OK;
}

SBI_API sb_result sbi_domain_fill(sb_domain *domain, sb_quadrature_kind kind, const sb_vec3 *positions,
                                  const sb_real *shares, const sbi_piece *pieces, sb_error *error)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real local[SB_MAX_QUADRATURE_POINTS][SB_MAX_ELEMENT_NODES][3], own[4][SB_MAX_ELEMENT_NODES][3];
    sbi_element element = sbi_domain_element(domain);
    int n = domain->nodes_per_cell, q = sbi_element_quadrature(element, kind, points, weights);
    for (int p = 0; p < q; p++)
        sbi_element_shape(element, points[p], NULL, local[p]);
    for (int e = 0; e < domain->cell_count; e++) {
        size_t first = (size_t)e * (size_t)domain->points_per_cell, values = 3 * (size_t)n;
        int is_piece = pieces && pieces[e].is != 0;
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        sb_result result;
        if (shares && sbi_domain_is_free(domain, e)) {
            memset(domain->gradients + first * values, 0, (size_t)domain->points_per_cell * values * sizeof(sb_real));
            memset(domain->weights + first, 0, (size_t)domain->points_per_cell * sizeof(sb_real));
            continue;
        }
        sbi_domain_gather(domain->cells, positions, e, n, x);
        if (is_piece && domain->element_type == SB_TET10 && sbi_domain_tet10_is_curved(x))
            return sbi_domain_refuse_curved(e, error);
        if (is_piece && q > 1)
            sbi_domain_piece_slopes(element, pieces + e, q, own);
        result = sbi_domain_fill_cell(
            domain, e, q, x, (const sb_real(*)[SB_MAX_ELEMENT_NODES][3])(is_piece && q > 1 ? own : local),
            (const sb_real(*)[3])points, weights, shares ? shares[e] : (sb_real)1, is_piece, error);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

static sb_result sbi_domain_allocate(const sb_mesh *mesh, const sb_allocator *allocator, sb_domain *domain,
                                     sb_error *error)
{
    size_t n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell;
    size_t cells = (size_t)mesh->element_count;
    if (allocator)
        domain->allocator = *allocator;
    domain->cells = (int *)sbi_alloc(allocator, cells, n * sizeof(int));
    domain->gradients = (sb_real *)sbi_alloc(allocator, cells, q * n * 3 * sizeof(sb_real));
    domain->weights = (sb_real *)sbi_alloc(allocator, cells, q * sizeof(sb_real));
    if (!domain->cells || !domain->gradients || !domain->weights)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the integration points of %d elements",
                        mesh->element_count);
    memcpy(domain->cells, mesh->elements, cells * n * sizeof(int));
    return SB_OK;
}

/* What every domain asks of its mesh. */
static sb_result sbi_domain_check_mesh(const sb_mesh *mesh, sb_error *error)
{
    sb_result result = sb_mesh_validate(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a body needs volume elements, the mesh has %s",
                        sb_element_name(mesh->element_type));
    if (!sbi_element_is_enabled(mesh->element_type))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "this build simulates one element type only (SB_ELEMENT), not %s",
                        sb_element_name(mesh->element_type));
    return SB_OK;
}

SB_API sb_result sb_domain_create(const sb_mesh *mesh, sb_integration integration, int single_rotation,
                                  const sb_allocator *allocator, sb_domain *domain, sb_error *error)
{
    sb_domain made;
    sb_quadrature_kind kind = SB_QUADRATURE_STIFFNESS;
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_result result;
    memset(&made, 0, sizeof made);
    if (!mesh || !domain)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_domain_create needs a mesh and a domain");
    result = sbi_domain_check_mesh(mesh, error);
    if (result != SB_OK)
        return result;
    if (sbi_mesh_is_cloud(mesh))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "elements of the cloud %s have no shape: they need a domain",
                        mesh->table->name);
    if (single_rotation && mesh->element_type != SB_TET10)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "one rotation per element is for tet10, the mesh has %s",
                        sb_element_name(mesh->element_type));
    if ((int)integration < SB_INTEGRATION_AUTO || (int)integration > SB_INTEGRATION_PATCH)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "integration is %d, which is none", (int)integration);
    if (integration == SB_INTEGRATION_BBAR && (sbi_domain_mean_points(mesh->element_type) == 0 || single_rotation))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "SB_INTEGRATION_BBAR is for tet10 without single_rotation, hex8, hex20 and hex27, the mesh has "
                        "%s",
                        sb_element_name(mesh->element_type));
    if (integration == SB_INTEGRATION_PATCH && mesh->element_type != SB_TET4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "SB_INTEGRATION_PATCH is for tet4, the mesh has %s",
                        sb_element_name(mesh->element_type));
    if (integration == SB_INTEGRATION_CURVED ||
        (integration != SB_INTEGRATION_STANDARD && sbi_domain_has_curved_side(mesh)))
        kind = SB_QUADRATURE_STIFFNESS_CURVED;
    made.element_type = mesh->element_type;
    made.single_rotation = single_rotation != 0;
    made.node_count = mesh->node_count;
    made.cell_count = mesh->element_count;
    made.table = sbi_mesh_element_kind(mesh).table;
    made.mean_points = integration == SB_INTEGRATION_BBAR ? sbi_domain_mean_points(mesh->element_type) : 0;
    made.nodes_per_cell = sb_mesh_element_width(mesh);
    made.points_per_cell =
        sbi_element_quadrature(sbi_mesh_element_kind(mesh), kind, points, weights) + made.mean_points;
    result = sbi_domain_allocate(mesh, allocator, &made, error);
    if (result == SB_OK)
        result = sbi_domain_fill(&made, kind, mesh->nodes, NULL, NULL, error);
    if (result == SB_OK && integration == SB_INTEGRATION_PATCH)
        result = sbi_patch_make(mesh, allocator, &made.cell_patch, &made.patch_count, error);
    if (result != SB_OK) {
        sb_domain_free(&made);
        return result;
    }
    *domain = made;
    return SB_OK;
}

/* ---- domains from elsewhere ---- */

/* 1 when bodies have loops for so many points of these cells. */
static int sbi_domain_has_loops(const sb_domain *domain, const sb_mesh *mesh)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sbi_element element = sbi_mesh_element_kind(mesh);
    int plain = sbi_element_quadrature(element, SB_QUADRATURE_STIFFNESS, points, weights);
    int curved = sbi_element_quadrature(element, SB_QUADRATURE_STIFFNESS_CURVED, points, weights);
    int ordinary = domain->points_per_cell - domain->mean_points;
    return ordinary == plain || (ordinary == curved && !domain->single_rotation);
}

/* Patches are of tet4 and each of one region. */
static sb_result sbi_domain_check_patches(const sb_domain *domain, const sb_mesh *mesh, sb_error *error)
{
    int *first, cells = mesh->element_count, bad = -1;
    if (!domain->cell_patch && domain->patch_count == 0)
        return SB_OK;
    if (!domain->cell_patch || mesh->element_type != SB_TET4 || domain->patch_count < 1 || domain->patch_count > cells)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the domain's %d patches do not go with %d cells of %s%s",
                        domain->patch_count, cells, sb_element_name(mesh->element_type),
                        domain->cell_patch ? "" : ": cell_patch is NULL");
    for (int e = 0; e < cells; e++)
        if (domain->cell_patch[e] < 0 || domain->cell_patch[e] >= domain->patch_count)
            return sbi_fail_element(error, SB_ERROR_INDEX, e, "cell %d of the domain is in patch %d of %d", e,
                                    domain->cell_patch[e], domain->patch_count);
    first = (int *)sbi_alloc(&domain->allocator, (size_t)domain->patch_count, sizeof(int));
    if (!first)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d patches", domain->patch_count);
    for (int k = 0; k < domain->patch_count; k++)
        first[k] = -1;
    for (int e = 0; e < cells && bad < 0; e++) {
        int *of = first + domain->cell_patch[e];
        if (*of < 0)
            *of = e;
        if (mesh->regions && mesh->regions[*of] != mesh->regions[e])
            bad = e;
    }
    sbi_free(&domain->allocator, first);
    return bad < 0 ? SB_OK
                   : sbi_fail_element(error, SB_ERROR_ARGUMENT, bad,
                                      "cell %d of the domain is in patch %d with cells "
                                      "of another region",
                                      bad, domain->cell_patch[bad]);
}

/* Counts, flags and arrays against the mesh. */
static sb_result sbi_domain_check_fit(const sb_domain *domain, const sb_mesh *mesh, sb_error *error)
{
    size_t entries = (size_t)mesh->element_count * (size_t)sb_mesh_element_width(mesh);
    if (domain->element_type != mesh->element_type || domain->node_count != mesh->node_count ||
        domain->cell_count != mesh->element_count || domain->nodes_per_cell != sb_mesh_element_width(mesh) ||
        (mesh->element_type == SB_CUSTOM && domain->table != mesh->table))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "the domain has %d nodes and %d cells of %s, the mesh %d nodes and %d elements of %s",
                        domain->node_count, domain->cell_count, sb_element_name(domain->element_type), mesh->node_count,
                        mesh->element_count, sb_element_name(mesh->element_type));
    if ((domain->mean_points && domain->mean_points != sbi_domain_mean_points(mesh->element_type)) ||
        domain->single_rotation != (domain->single_rotation && !domain->mean_points && mesh->element_type == SB_TET10))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "the domain's mean_points %d are 0, 1 for tet10 and hex8, 4 for hex20 and hex27; its "
                        "single_rotation %d is 0, or 1 for tet10 without mean points",
                        domain->mean_points, domain->single_rotation);
    if (!sbi_domain_has_loops(domain, mesh))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the domain has %d points per cell, which no rule of %s has",
                        domain->points_per_cell, sb_element_name(mesh->element_type));
    if (sbi_mesh_is_cloud(mesh) && !domain->cell_mass)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the domain of the cloud %s needs cell_mass", mesh->table->name);
    if (!domain->cells || !domain->gradients || !domain->weights)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "an array of the domain is NULL");
    for (size_t i = 0; i < entries; i++)
        if (domain->cells[i] != mesh->elements[i])
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, (int)(i / (size_t)domain->nodes_per_cell),
                                    "cell %d of the domain has other nodes than the mesh's element",
                                    (int)(i / (size_t)domain->nodes_per_cell));
    return SB_OK;
}

static int sbi_domain_all_finite(const sb_real *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!sb_is_finite(values[i]))
            return 0;
    return 1;
}

/* 1 when gradients[n][3] sum to 0 up to rounding: then a translation is no deformation. */
static int sbi_domain_is_balanced(const sb_real *gradients, int n)
{
    sb_real size = 0, sum[3] = {0, 0, 0};
    for (int a = 0; a < 3 * n; a++) {
        sum[a % 3] += gradients[a];
        size += sb_abs(gradients[a]);
    }
    return sb_abs(sum[0]) + sb_abs(sum[1]) + sb_abs(sum[2]) <= 1000 * SB_EPSILON * size;
}

/* The numbers of one cell; *volume += its weights. */
static sb_result sbi_domain_check_cell(const sb_domain *domain, int e, sb_real *volume, sb_error *error)
{
    size_t n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell, pairs = n * (n + 1) / 2;
    const sb_real *weights = domain->weights + (size_t)e * q, *gradients = domain->gradients + (size_t)e * q * 3 * n;
    const sb_real *mass = domain->cell_mass ? domain->cell_mass + (size_t)e * pairs : NULL;
    if (!sbi_domain_all_finite(weights, q) || !sbi_domain_all_finite(gradients, q * 3 * n) ||
        (mass && !sbi_domain_all_finite(mass, pairs)))
        return sbi_fail_element(error, SB_ERROR_NOT_FINITE, e, "cell %d of the domain has a number that is not finite",
                                e);
    for (size_t p = 0; p < q; p++) {
        if (!(weights[p] >= 0))
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, e, "point %d of cell %d of the domain has the weight %g",
                                    (int)p, e, (double)weights[p]);
        if (!sbi_domain_is_balanced(gradients + p * 3 * n, (int)n))
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, e,
                                    "the gradients at point %d of cell %d of the domain do not sum to 0", (int)p, e);
        *volume += weights[p];
    }
    for (size_t a = 0, at = 0; mass && a < n; at += n - a, a++)
        if (!(mass[at] >= 0))
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, e, "cell %d of the domain has a negative mass %g", e,
                                    (double)mass[at]);
    return SB_OK;
}

/* A copy of `count` numbers, or NULL: of none, or (then *failed is 1) for lack of memory. */
static sb_real *sbi_domain_copy_reals(const sb_allocator *allocator, const sb_real *from, size_t rows, size_t columns,
                                      int *failed)
{
    sb_real *to = from ? (sb_real *)sbi_alloc(allocator, rows, columns * sizeof(sb_real)) : NULL;
    if (to)
        memcpy(to, from, rows * columns * sizeof(sb_real));
    *failed |= from && !to;
    return to;
}

static int *sbi_domain_copy_ints(const sb_allocator *allocator, const int *from, size_t rows, size_t columns,
                                 int *failed)
{
    int *to = from ? (int *)sbi_alloc(allocator, rows, columns * sizeof(int)) : NULL;
    if (to)
        memcpy(to, from, rows * columns * sizeof(int));
    *failed |= from && !to;
    return to;
}

SBI_API sb_result sbi_domain_copy(const sb_domain *domain, const sb_mesh *mesh, const sb_allocator *allocator,
                                  sb_domain *copy, sb_error *error)
{
    sb_domain made = *domain;
    size_t cells = (size_t)domain->cell_count, n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell;
    sb_real volume = 0;
    int failed = 0;
    sb_result result = sbi_domain_check_mesh(mesh, error);
    if (result == SB_OK)
        result = sbi_domain_check_fit(domain, mesh, error);
    if (result == SB_OK)
        result = sbi_domain_check_patches(domain, mesh, error);
    for (int e = 0; e < domain->cell_count && result == SB_OK; e++)
        result = sbi_domain_check_cell(domain, e, &volume, error);
    if (result == SB_OK && !(volume > 0))
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "all weights of the domain are 0");
    if (result != SB_OK)
        return result;
    memset(&made.allocator, 0, sizeof made.allocator);
    if (allocator)
        made.allocator = *allocator;
    made.cells = sbi_domain_copy_ints(allocator, domain->cells, cells, n, &failed);
    made.cell_patch = sbi_domain_copy_ints(allocator, domain->cell_patch, cells, 1, &failed);
    made.gradients = sbi_domain_copy_reals(allocator, domain->gradients, cells, q * n * 3, &failed);
    made.weights = sbi_domain_copy_reals(allocator, domain->weights, cells, q, &failed);
    made.cell_mass = sbi_domain_copy_reals(allocator, domain->cell_mass, cells, n * (n + 1) / 2, &failed);
    if (failed) {
        sb_domain_free(&made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the integration points of %d cells", domain->cell_count);
    }
    *copy = made;
    return SB_OK;
}

/* ---- a mesh that changes ---- */

/* The arrays with room for so many cells; what the new slots hold is up to the caller. */
static sb_result sbi_domain_grow(sb_domain *domain, int capacity, sb_error *error)
{
    const sb_allocator *allocator = &domain->allocator;
    size_t cells = (size_t)capacity, n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell;
    size_t used = (size_t)domain->cell_count;
    int *nodes = (int *)sbi_alloc(allocator, cells, n * sizeof(int));
    sb_real *gradients = (sb_real *)sbi_alloc(allocator, cells, q * n * 3 * sizeof(sb_real));
    sb_real *weights = (sb_real *)sbi_alloc(allocator, cells, q * sizeof(sb_real));
    if (!nodes || !gradients || !weights) {
        sbi_free(allocator, nodes);
        sbi_free(allocator, gradients);
        sbi_free(allocator, weights);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the integration points of %d cells", capacity);
    }
    memcpy(nodes, domain->cells, used * n * sizeof(int));
    memcpy(gradients, domain->gradients, used * q * n * 3 * sizeof(sb_real));
    memcpy(weights, domain->weights, used * q * sizeof(sb_real));
    sbi_free(allocator, domain->cells);
    sbi_free(allocator, domain->gradients);
    sbi_free(allocator, domain->weights);
    domain->cells = nodes;
    domain->gradients = gradients;
    domain->weights = weights;
    domain->cell_capacity = capacity;
    return SB_OK;
}

SBI_API sb_result sbi_domain_make_live(sb_domain *domain, int cell_capacity, sb_error *error)
{
    if (domain->element_type != SB_TET4 || domain->points_per_cell != 1 || domain->cell_mass || domain->cell_patch)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "a mesh that changes is of tet4 without patches and masses of their own, not %s",
                        sb_element_name(domain->element_type));
    return sbi_domain_grow(domain, sbi_max_int(cell_capacity, domain->cell_count), error);
}

SBI_API sb_result sbi_domain_reserve(sb_domain *domain, const sbi_mesh_change *change, sb_error *error)
{
    int least = change->cell_end;
    if (least <= domain->cell_capacity)
        return SB_OK;
    return sbi_domain_grow(domain, least > INT_MAX / 3 * 2 ? INT_MAX : least + least / 2, error);
}

static void sbi_domain_blank(sb_domain *domain, int e)
{
    memset(domain->cells + 4 * (size_t)e, 0, 4 * sizeof(int));
    memset(domain->gradients + 12 * (size_t)e, 0, 12 * sizeof(sb_real));
    domain->weights[e] = 0;
}

/* Gradients and weight of a tet; share: of its volume. */
static void sbi_domain_shape(sb_domain *domain, const sbi_tet_rule *rule, int e, const sb_vec3 *positions,
                             sb_real share)
{
    sb_mat3 jacobian;
    sb_vec3 x[4];
    sb_real det;
    for (int a = 0; a < 4; a++)
        x[a] = positions[domain->cells[4 * (size_t)e + (size_t)a]];
    jacobian = sbi_domain_tet_jacobian(x);
    det = sb_m3_det(jacobian);
    sbi_domain_gradients(4, jacobian, det, (const sb_real(*)[3])rule->slopes, domain->gradients + 12 * (size_t)e);
    domain->weights[e] = share * (det * rule->volume);
}

SBI_API int sbi_domain_is_upright(const sbi_tet_rule *rule, const sb_vec3 x[4], sb_real share, int is_piece)
{
    sb_real volume = sbi_domain_det(sbi_domain_tet_jacobian(x)) * rule->volume;
    return (is_piece ? volume : share * volume) > 0;
}

SBI_API sb_result sbi_domain_check_tet(const sbi_tet_rule *rule, int e, const sb_vec3 x[4], sb_real share, int is_piece,
                                       sb_error *error)
{
    if (sbi_domain_is_upright(rule, x, share, is_piece))
        return SB_OK;
    return sbi_domain_refuse(e, 0, sbi_domain_det(sbi_domain_tet_jacobian(x)), error);
}

SBI_API void sbi_domain_follow(sb_domain *domain, const sbi_mesh_change *change, const sb_vec3 *positions)
{
    sbi_tet_rule rule;
    sbi_domain_make_tet_rule(domain, &rule);
    for (int e = domain->cell_count; e < change->cell_end; e++)
        sbi_domain_blank(domain, e);
    domain->node_count = change->node_end;
    domain->cell_count = change->cell_end;
    for (int k = 0; k < change->removed_cell_count; k++)
        if (change->removed_cells[k] < change->cell_end)
            sbi_domain_blank(domain, change->removed_cells[k]);
    for (int k = 0; k < change->made_cell_count; k++) {
        int e = change->made_cells[k];
        memcpy(domain->cells + 4 * (size_t)e, change->made_cell_nodes + 4 * (size_t)k, 4 * sizeof(int));
        sbi_domain_shape(domain, &rule, e, positions, change->made_shares ? change->made_shares[k] : (sb_real)1);
    }
    for (int k = 0; k < change->reshaped_cell_count; k++) {
        int e = change->reshaped_cells[k];
        sb_real share = change->reshaped_shares ? change->reshaped_shares[k] : (sb_real)1;
        sbi_domain_shape(domain, &rule, e, positions, share);
    }
}

/* ---- mass ---- */

/* mass_ab = sum_q w det N_a N_b and load_a = sum_q w det N_a; returns the volume. */
static sb_real sbi_domain_integrate_mass(sbi_element element, sb_quadrature_kind kind, const sb_vec3 *x, sb_real *mass,
                                         sb_real *load)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real shape[SB_MAX_ELEMENT_NODES], local[SB_MAX_ELEMENT_NODES][3];
    int n = sbi_element_node_count(element), q = sbi_element_quadrature(element, kind, points, weights);
    sb_real volume = 0;
    memset(mass, 0, (size_t)(n * n) * sizeof *mass);
    memset(load, 0, (size_t)n * sizeof *load);
    for (int p = 0; p < q; p++) {
        sbi_element_shape(element, points[p], shape, local);
        sb_real w = weights[p] * sb_m3_det(sbi_domain_jacobian(n, x, (const sb_real(*)[3])local));
        volume += w;
        for (int a = 0; a < n; a++) {
            load[a] += w * shape[a];
            for (int b = 0; b < n; b++)
                mass[a * n + b] += w * shape[a] * shape[b];
        }
    }
    return volume;
}

SBI_API void sbi_domain_make_tet_rule(const sb_domain *domain, sbi_tet_rule *rule)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real shape[SB_MAX_ELEMENT_NODES], local[SB_MAX_ELEMENT_NODES][3];
    sbi_element element = sbi_domain_element(domain);
    rule->count = sbi_element_quadrature(element, SB_QUADRATURE_MASS, points, rule->weights);
    for (int p = 0; p < rule->count; p++) {
        sbi_element_shape(element, points[p], shape, local);
        memcpy(rule->shapes[p], shape, sizeof rule->shapes[p]);
    }
    memcpy(rule->slopes, local, sizeof rule->slopes);
    sbi_element_quadrature(element, SB_QUADRATURE_STIFFNESS, points, weights);
    rule->volume = weights[0];
}

SBI_API void sbi_domain_tet_masses(const sbi_tet_rule *rule, const sb_vec3 x[4], sb_real masses[4], sb_real load[4])
{
    sb_real det = sb_m3_det(sbi_domain_tet_jacobian(x)), volume = 0, trace = 0;
    for (int a = 0; a < 4; a++)
        masses[a] = load[a] = 0;
    for (int p = 0; p < rule->count; p++) {
        sb_real w = rule->weights[p] * det;
        volume += w;
        for (int a = 0; a < 4; a++) {
            load[a] += w * rule->shapes[p][a];
            masses[a] += w * rule->shapes[p][a] * rule->shapes[p][a];
        }
    }
    for (int a = 0; a < 4; a++)
        trace += masses[a];
    for (int a = 0; a < 4; a++)
        masses[a] = trace > 0 ? masses[a] * volume / trace : 0;
}

/* Leaves of a consistent mass its diagonal, scaled to the volume (HRZ). */
static void sbi_domain_lump(int n, sb_real volume, sb_real *mass)
{
    sb_real trace = 0;
    for (int a = 0; a < n; a++)
        trace += mass[a * n + a];
    for (int a = 0; a < n; a++)
        for (int b = 0; b < n; b++)
            mass[a * n + b] = a == b && trace > 0 ? mass[a * n + a] * volume / trace : 0;
}

/* Lumped masses of a cell with a mass of its own: HRZ, lifted where it needs to be; returns 1 then. Of a brick of which
 * a corner is full, the squares of the other nodes' shape functions sum to next to nothing, while their slopes resist
 * like those of any other material; the step that central differences may take falls with the root of the quotient. So
 * every node gets at least a share of what it would have of these masses in the full cell; the cell's mass stays what
 * it is. */
static int sbi_domain_lump_part(int n, sb_real volume, const sb_real *full, sb_real *mass)
{
    sb_real all = 0, sum = 0;
    int lifted = 0;
    sbi_domain_lump(n, volume, mass);
    for (int a = 0; a < n; a++)
        all += full[a];
    for (int a = 0; a < n; a++) {
        sb_real *m = mass + a * (n + 1), least = SBI_LEAST_MASS * volume * full[a] / all;
        lifted |= *m < least;
        *m = sb_max(*m, least);
        sum += *m;
    }
    for (int a = 0; a < n && lifted; a++)
        mass[a * (n + 1)] *= volume / sum;
    return lifted;
}

SBI_API void sbi_domain_full_mass(const sb_domain *domain, const sb_vec3 *x, sb_real *full)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    int n = domain->nodes_per_cell;
    sbi_element_mass(sbi_domain_element(domain), SB_MASS_LUMPED, x, mass, NULL);
    for (int a = 0; a < n; a++)
        full[a] = mass[a * (n + 1)];
}

SBI_API void sbi_element_mass(sbi_element element, sb_mass_kind kind, const sb_vec3 *x, sb_real *mass,
                              sb_real *volume_load)
{
    sb_real load[SB_MAX_ELEMENT_NODES];
    int n = sbi_element_node_count(element);
    sb_real volume = sbi_domain_integrate_mass(element, SB_QUADRATURE_MASS, x, mass, volume_load ? volume_load : load);
    if (kind == SB_MASS_REDUCED)
        sbi_domain_integrate_mass(element, SB_QUADRATURE_STIFFNESS, x, mass, load);
    if (kind == SB_MASS_LUMPED)
        sbi_domain_lump(n, volume, mass);
}

SBI_API int sbi_domain_element_mass(const sb_domain *domain, int cell, sb_mass_kind kind, const sb_vec3 *x,
                                    sb_real *mass, sb_real *volume_load)
{
    int n = domain->nodes_per_cell;
    const sb_real *own = domain->cell_mass;
    sb_real volume = 0, full[SB_MAX_ELEMENT_NODES];
    if (!own) {
        sbi_element_mass(sbi_domain_element(domain), kind, x, mass, volume_load);
        return 0;
    }
    own += (size_t)cell * (size_t)(n * (n + 1) / 2);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, own++)
            mass[a * n + b] = mass[b * n + a] = *own;
    for (int a = 0; a < n; a++) { /* shape functions sum to 1, so rows sum to int N_a dV */
        sb_real load = 0;
        for (int b = 0; b < n; b++)
            load += mass[a * n + b];
        if (volume_load)
            volume_load[a] = load;
        volume += load;
    }
    if (kind != SB_MASS_LUMPED)
        return 0;
    if (sbi_domain_is_cloud(domain)) {
        sbi_domain_lump(n, volume, mass);
        return 0;
    }
    sbi_domain_full_mass(domain, x, full);
    return sbi_domain_lump_part(n, volume, full, mass);
}
