/* body_mass: masses of nodes and of the matrix, and products with them. */
#include "body.h"
#include "body_private.h"
#include "live_private.h"

#include <string.h>

/* ---- the reference shape ---- */

SBI_API sb_mesh sbi_body_mesh_view(const sb_body *body)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = body->domain.node_count;
    mesh.nodes = body->reference;
    mesh.element_type = body->domain.element_type;
    mesh.table = body->domain.table;
    mesh.element_count = body->domain.cell_count;
    mesh.elements = body->domain.cells;
    return mesh;
}

SBI_API sb_real sbi_body_size(const sb_body *body)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    sb_vec3 low, high;
    if (body->live && body->component_count) { /* without free nodes */
        low = body->component_low[0], high = body->component_high[0];
        for (int c = 1; c < body->component_count; c++) {
            sb_vec3 a = body->component_low[c], b = body->component_high[c];
            low = sb_v3(sb_min(low.x, a.x), sb_min(low.y, a.y), sb_min(low.z, a.z));
            high = sb_v3(sb_max(high.x, b.x), sb_max(high.y, b.y), sb_max(high.z, b.z));
        }
        if (low.x <= high.x) /* else there is no material left */
            return sb_v3_norm(sb_v3_sub(high, low));
    }
    sb_mesh_bounds(&mesh, &low, &high);
    return sb_v3_norm(sb_v3_sub(high, low));
}

/* ---- mass ---- */

/* Lumped masses and loads (m^3) of a piece whose tet has this volume. Of bodies that step explicitly a part of the
 * masses is spread evenly, and loads are as the masses: steps are as long as the lightest node beside its stiffness
 * allows, and the corner of a tet10 far from its piece has stiffness where L_a^2 leaves it no mass. Measured on 360
 * blocks of random cuts the shortest step in uncut ones is 0.36 of tet4 and 0.40 of tet10, without 0.29 and 0.066.
 * Parts of their own fall as one, since loads have the masses' centre. */
static void sbi_body_piece_lumps(const sb_body *body, int cell, sb_real volume, sb_real *lumps, sb_real *loads)
{
    const sb_real of_tet4 = (sb_real)0.05, of_tet10 = (sb_real)0.2;
    int n = body->domain.nodes_per_cell;
    sbi_piece_lumps(body->live->pieces + cell, n, volume, lumps, loads);
    if (body->integrator != SB_CENTRAL_DIFFERENCE)
        return;
    sbi_piece_level(n, volume, n == 4 ? of_tet4 : of_tet10, lumps);
    if (loads)
        memcpy(loads, lumps, (size_t)n * sizeof *lumps);
}

SBI_API int sbi_body_cell_mass(const sb_body *body, int cell, sb_mass_kind kind, const sb_vec3 *x, sb_real *mass,
                               sb_real *volume_load)
{
    int n = body->domain.nodes_per_cell;
    sb_real lumps[10], volume;
    if (!sbi_live_is_piece(body, cell))
        return sbi_domain_element_mass(&body->domain, cell, kind, x, mass, volume_load);
    volume = sbi_domain_tet_volume(x);
    sbi_body_piece_lumps(body, cell, volume, lumps, volume_load);
    if (kind != SB_MASS_LUMPED) {
        sbi_piece_mass(body->live->pieces + cell, n, volume, mass);
        return 0;
    }
    memset(mass, 0, (size_t)(n * n) * sizeof *mass);
    for (int a = 0; a < n; a++)
        mass[a * (n + 1)] = lumps[a];
    return 0;
}

static void sbi_body_gather_reference(const sb_body *body, int element, sb_vec3 *x)
{
    int n = body->domain.nodes_per_cell;
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    for (int a = 0; a < n; a++)
        x[a] = body->reference[cell[a]];
}

/* Adds the mass of one element to the matrix blocks, both sides of the diagonal. */
static void sbi_body_add_mass_blocks(const sb_body *body, int element, const sb_real *mass, sb_real density,
                                     sb_real *blocks)
{
    int n = body->domain.nodes_per_cell;
    const int *at = body->assembly.scatter + (size_t)element * (size_t)(n * (n + 1) / 2);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, at++) {
            blocks[*at] += density * mass[a * n + b];
            if (a != b)
                blocks[body->matrix.transpose[*at]] += density * mass[a * n + b];
        }
}

SBI_API void sbi_body_mass_blocks(const sb_body *body, sb_mass_kind kind, sb_real *blocks)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    memset(blocks, 0, (size_t)body->matrix.block_count * sizeof *blocks);
    sbi_assembly_settle_maps(&body->assembly, &body->matrix);
    for (int e = 0; e < body->domain.cell_count; e++) {
        if (!sbi_live_has_cell(body, e))
            continue;
        sbi_body_gather_reference(body, e, x);
        sbi_body_cell_mass(body, e, kind, x, mass, NULL);
        sbi_body_add_mass_blocks(body, e, mass, sbi_live_density(body, e), blocks);
    }
}

/* What a part's lumped masses are to sum to and do. */
enum {
    SBI_SUM_MASS = 0,
    SBI_SUM_LEAST = 1,
    SBI_SUM_REST = 2,
    SBI_SUM_FIRST = 3,
    SBI_SUM_WANTED = 6,
    SBI_SUM_SECOND = 9
};

/* Adds to work[].x (kg) the least lumped mass that the nodes of a cell with a mass of its own should have: it may
 * resist more than it weighs, as cells do that an immersed grid's void stiffness holds. */
static void sbi_body_add_least_mass(sb_body *body, int element, const sb_vec3 *x, sb_real density)
{
    const sb_domain *domain = &body->domain;
    int n = domain->nodes_per_cell;
    const sb_real *weights = domain->weights + (size_t)element * (size_t)domain->points_per_cell;
    sb_real full[SB_MAX_ELEMENT_NODES], all = 0, volume = 0;
    sbi_domain_full_mass(domain, x, full);
    for (int a = 0; a < n; a++)
        all += full[a];
    for (int p = 0; p < sbi_body_points(body); p++)
        volume += weights[p];
    for (int a = 0; a < n; a++)
        body->work[domain->cells[(size_t)element * (size_t)n + (size_t)a]].x +=
            SBI_LEAST_MASS * density * volume * full[a] / all;
}

/* Brings nodes up to their least mass (work[].x) at the cost of the others of their part; returns 1 when there were
 * any. */
static int sbi_body_lift_masses(sb_body *body)
{
    int n = body->domain.node_count, lifted = 0;
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < n; i++)
        if (body->node_component[i] >= 0) {
            double *sum = body->support_grams[body->node_component[i]];
            int low = body->lumped_mass[i] < body->work[i].x;
            sum[SBI_SUM_MASS] += (double)body->lumped_mass[i];
            sum[low ? SBI_SUM_LEAST : SBI_SUM_REST] += (double)(low ? body->work[i].x : body->lumped_mass[i]);
        }
    for (int i = 0; i < n; i++)
        if (body->node_component[i] >= 0) {
            const double *sum = body->support_grams[body->node_component[i]];
            if (!(sum[SBI_SUM_LEAST] > 0) || !(sum[SBI_SUM_LEAST] < 0.5 * sum[SBI_SUM_MASS]))
                continue;
            lifted = 1;
            body->lumped_mass[i] = body->lumped_mass[i] < body->work[i].x
                                       ? body->work[i].x
                                       : (sb_real)((double)body->lumped_mass[i] *
                                                   (sum[SBI_SUM_MASS] - sum[SBI_SUM_LEAST]) / sum[SBI_SUM_REST]);
        }
    return lifted;
}

/* Sums of a part's lumped masses times 1, x and x x^T, and those of the exact first moment; x from the part's
 * corner. */
static void sbi_body_sum_moments(sb_body *body)
{
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] >= 0) {
            double *sum = body->support_grams[body->node_component[i]], m = (double)body->lumped_mass[i];
            sb_vec3 from = sb_v3_sub(body->reference[i], body->component_low[body->node_component[i]]);
            const double x[3] = {(double)from.x, (double)from.y, (double)from.z};
            sum[SBI_SUM_MASS] += m;
            for (int k = 0; k < 3; k++) {
                sum[SBI_SUM_FIRST + k] += m * x[k];
                sum[SBI_SUM_WANTED + k] += (double)body->load_mass[i] * x[k];
                for (int j = 0; j < 3; j++)
                    sum[SBI_SUM_SECOND + 3 * k + j] += m * x[k] * x[j];
            }
        }
}

/* Multiplies the lumped masses by 1 + tilt . (x - centre), which leaves their sum and puts their centre where the
 * material's is. Nothing where that would take a quarter of some node's mass, or the part is flat. */
static void sbi_body_tilt_masses(sb_body *body)
{
    sbi_body_sum_moments(body);
    for (int c = 0; c < body->component_count; c++) {
        double *sum = body->support_grams[c], m = sum[SBI_SUM_MASS];
        sb_vec3 size = sb_v3_sub(body->component_high[c], body->component_low[c]), shift, tilt, centre;
        sb_mat3 second;
        for (int k = 0; k < 9 && m > 0; k++)
            second.m[k / 3][k % 3] =
                (sb_real)((sum[SBI_SUM_SECOND + k] - sum[SBI_SUM_FIRST + k / 3] * sum[SBI_SUM_FIRST + k % 3] / m) / m);
        if (!(m > 0))
            continue;
        centre = sb_v3((sb_real)(sum[SBI_SUM_FIRST] / m), (sb_real)(sum[SBI_SUM_FIRST + 1] / m),
                       (sb_real)(sum[SBI_SUM_FIRST + 2] / m));
        shift = sb_v3((sb_real)((sum[SBI_SUM_WANTED] - sum[SBI_SUM_FIRST]) / m),
                      (sb_real)((sum[SBI_SUM_WANTED + 1] - sum[SBI_SUM_FIRST + 1]) / m),
                      (sb_real)((sum[SBI_SUM_WANTED + 2] - sum[SBI_SUM_FIRST + 2]) / m));
        tilt = sb_m3_apply(sb_m3_inverse(second), shift);
        memset(sum, 0, sizeof body->support_grams[0]);
        if (!(sb_abs(tilt.x) * size.x + sb_abs(tilt.y) * size.y + sb_abs(tilt.z) * size.z < (sb_real)0.25) ||
            sb_v3_norm(shift) < 64 * SB_EPSILON * sb_v3_norm(size))
            continue;
        sum[0] = (double)tilt.x, sum[1] = (double)tilt.y, sum[2] = (double)tilt.z;
        sum[3] = (double)sb_v3_dot(tilt, centre);
    }
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] >= 0) {
            const double *tilt = body->support_grams[body->node_component[i]];
            sb_vec3 x = sb_v3_sub(body->reference[i], body->component_low[body->node_component[i]]);
            body->lumped_mass[i] *=
                (sb_real)(1 + tilt[0] * (double)x.x + tilt[1] * (double)x.y + tilt[2] * (double)x.z - tilt[3]);
        }
}

SBI_API void sbi_body_weigh_cell(sb_body *body, int cell, const sbi_tet_rule *rule)
{
    sb_real density = sbi_live_density(body, cell), (*out)[2] = body->live->masses + 4 * (size_t)cell;
    sb_real lumps[4], loads[4];
    sb_vec3 x[4];
    for (int a = 0; a < 4; a++)
        x[a] = body->reference[body->domain.cells[4 * (size_t)cell + (size_t)a]];
    if (sbi_live_is_piece(body, cell))
        sbi_body_piece_lumps(body, cell, sbi_domain_tet_volume(x), lumps, loads);
    else
        sbi_domain_tet_masses(rule, x, lumps, loads);
    for (int a = 0; a < 4; a++) {
        out[a][0] = density * lumps[a];
        out[a][1] = density * loads[a];
    }
}

/* Adds what a cell of a body that follows weighs to its nodes. */
static void sbi_body_add_cell_mass(sb_body *body, int cell)
{
    const sb_real(*masses)[2] = (const sb_real(*)[2])body->live->masses + 4 * (size_t)cell;
    for (int a = 0; a < 4; a++) {
        int node = body->domain.cells[4 * (size_t)cell + (size_t)a];
        body->lumped_mass[node] += masses[a][0];
        body->load_mass[node] += masses[a][1];
    }
}

SBI_API void sbi_body_sum_node_mass(sb_body *body, int node)
{
    sb_real mass = 0, load = 0, damping = 0;
    for (int at = sbi_live_first_cell(body, node); at >= 0; at = sbi_live_next_cell(body, node, at)) {
        mass += body->live->masses[at][0];
        load += body->live->masses[at][1];
        if (body->regional_damping)
            damping += body->region_alpha[body->cell_material[at / 4]] * body->live->masses[at][0];
    }
    body->lumped_mass[node] = mass;
    body->node_damping[node] = damping;
    body->load_mass[node] = load;
}

/* The same of a body that does not follow: each cell's masses, no smaller than 0, and what is in body->work[].y of them
 * all. */
static void sbi_body_sum_cell_damping(sb_body *body)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell;
    for (int e = 0; e < body->domain.cell_count; e++) {
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        sb_real alpha = body->region_alpha[body->cell_material[e]];
        if (!sbi_live_has_cell(body, e))
            continue;
        sbi_body_gather_reference(body, e, x);
        sbi_body_cell_mass(body, e, SB_MASS_LUMPED, x, mass, NULL);
        for (int a = 0; a < n; a++) {
            sb_real m = sbi_live_density(body, e) * sb_max(mass[a * n + a], 0);
            body->node_damping[cell[a]] += alpha * m;
            body->work[cell[a]].y += m;
        }
    }
}

SBI_API void sbi_body_sum_damping(sb_body *body)
{
    int n = body->domain.node_count;
    memset(body->node_damping, 0, (size_t)n * sizeof(sb_real));
    if (!body->regional_damping)
        return;
    if (sbi_live_follows(body)) {
        for (int at = 0; at < 4 * body->domain.cell_count; at++)
            if (sbi_live_has_cell(body, at / 4))
                body->node_damping[body->domain.cells[at]] +=
                    body->region_alpha[body->cell_material[at / 4]] * body->live->masses[at][0];
        return;
    }
    memset(body->work, 0, (size_t)n * sizeof(sb_vec3));
    sbi_body_sum_cell_damping(body);
    for (int i = 0; i < n; i++) /* masses that were lifted: the mean alpha of the node */
        if (body->work[i].y > 0)
            body->node_damping[i] *= body->lumped_mass[i] / body->work[i].y;
}

SBI_API void sbi_body_update_mass(sb_body *body)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    sbi_tet_rule rule;
    int n = body->domain.nodes_per_cell, lifted = 0;
    if (sbi_live_follows(body))
        sbi_domain_make_tet_rule(&body->domain, &rule);
    memset(body->lumped_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    memset(body->load_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    memset(body->work, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
    if (body->mass_blocks) {
        memset(body->mass_blocks, 0, (size_t)body->matrix.block_count * sizeof(sb_real));
        sbi_assembly_settle_maps(&body->assembly, &body->matrix);
    }
    for (int e = 0; e < body->domain.cell_count; e++) {
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        sb_real density = sbi_live_density(body, e);
        if (!sbi_live_has_cell(body, e))
            continue;
        sbi_body_gather_reference(body, e, x);
        if (body->mass_blocks) {
            sbi_body_cell_mass(body, e, body->mass_kind, x, mass, load);
            sbi_body_add_mass_blocks(body, e, mass, density, body->mass_blocks);
        }
        if (sbi_live_follows(body)) {
            sbi_body_weigh_cell(body, e, &rule);
            sbi_body_add_cell_mass(body, e);
            continue;
        }
        lifted |= sbi_body_cell_mass(body, e, SB_MASS_LUMPED, x, mass, load);
        for (int a = 0; a < n; a++) {
            body->lumped_mass[cell[a]] += density * mass[a * n + a];
            body->load_mass[cell[a]] += density * load[a];
        }
        if (body->domain.cell_mass && !sbi_domain_is_cloud(&body->domain))
            sbi_body_add_least_mass(body, e, x, density);
    }
    if (body->domain.cell_mass && !sbi_domain_is_cloud(&body->domain) && (sbi_body_lift_masses(body) || lifted))
        sbi_body_tilt_masses(body);
    if (body->regional_damping)
        sbi_body_sum_damping(body);
}

SBI_API void sbi_body_mass_multiply(const sb_body *body, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (!body->mass_blocks) {
            out[i] = sb_v3_scale(body->lumped_mass[i], x[i]);
            continue;
        }
        for (int k = matrix->row_start[i]; k < matrix->row_end[i]; k++)
            sum = sb_v3_madd(sum, body->mass_blocks[k], x[matrix->columns[k]]);
        out[i] = sum;
    }
}

SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor)
{
    sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        int first = body->mass_blocks ? matrix->row_start[i] : matrix->diagonal[i];
        int end = body->mass_blocks ? matrix->row_end[i] : first + 1;
        for (int k = first; k < end; k++) {
            sb_real m = factor * (body->mass_blocks ? body->mass_blocks[k] : body->lumped_mass[i]);
            matrix->blocks[k][0] += m;
            matrix->blocks[k][4] += m;
            matrix->blocks[k][8] += m;
        }
    }
}
