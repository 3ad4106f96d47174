/* body_read: sizes, motion and what can be read from it. */
#include "body.h"
#include "body_private.h"
#include "cable_law.h"
#include "cavity_law.h"
#include "membrane_law.h"
#include "live_private.h"
#include "live_mesh.h"
#include "rigid_private.h"

#include <string.h>

/* ---- sizes ---- */

SB_API int sb_body_node_count(const sb_body *body) { return body ? body->domain.node_count : 0; }
SB_API int sb_body_element_count(const sb_body *body) { return body ? body->domain.cell_count : 0; }
SB_API int sb_body_point_count(const sb_body *body) { return body ? sbi_body_points(body) : 0; }
SB_API sb_preconditioner_info sb_body_solver(const sb_body *body)
{
    sb_preconditioner_info none;
    if (!body) {
        memset(&none, 0, sizeof none);
        return none;
    }
    (void)sbi_precond_settle(body->precond, &body->matrix);
    return sb_preconditioner_get_info(body->elimination ? body->elimination->precond : body->precond);
}
SB_API int sb_body_matrix_blocks(const sb_body *body) { return body ? sbi_matrix_used_blocks(&body->matrix) : 0; }
SB_API int sb_body_patch_count(const sb_body *body) { return body ? body->domain.patch_count : 0; }
SB_API int sb_body_patch(const sb_body *body, int element)
{
    return body && body->domain.cell_patch && sb_body_cell_in_use(body, element) ? body->domain.cell_patch[element]
                                                                                 : -1;
}

SBI_API double sbi_body_now(const sb_body *body) { return body->clock ? body->clock() : 0.0; }

/* ---- the mesh ---- */

SB_API int sb_body_node_in_use(const sb_body *body, int node)
{
    if (!body || node < 0 || node >= body->domain.node_count)
        return 0;
    return !body->live || body->live->nodes.used[node];
}

SB_API int sb_body_cell_in_use(const sb_body *body, int cell)
{
    return body && cell >= 0 && cell < body->domain.cell_count && sbi_live_has_cell(body, cell);
}

SB_API const int *sb_body_cell_nodes(const sb_body *body, int cell)
{
    return sb_body_cell_in_use(body, cell) ? body->domain.cells + (size_t)cell * (size_t)body->domain.nodes_per_cell
                                           : NULL;
}

SB_API sb_real sb_body_cell_share(const sb_body *body, int cell)
{
    if (!sb_body_cell_in_use(body, cell))
        return 0;
    return body->live ? body->live->shares[cell] : 1;
}

SB_API int sb_body_find_cell(const sb_body *body, int cell, const sb_real xi[3])
{
    if (!xi || !sb_body_cell_in_use(body, cell))
        return -1;
    return body->live && body->live->find ? body->live->find(body->live->find_user, cell, xi) : cell;
}

/* 1: a cell, or NULL, has the corners of an element, at rest. */
static int sbi_body_has_places(const sb_body *body, const int *cell, const sb_mesh *mesh, int element)
{
    const int *nodes = mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
    int same = cell != NULL;
    for (int k = 0; k < 4 && same; k++)
        same = !(sb_v3_norm(sb_v3_sub(body->reference[cell[k]], mesh->nodes[nodes[k]])) > 0);
    return same;
}

SBI_API int sbi_body_find_holder(const sb_body *body, const sb_mesh *mesh, int element, int cell, const sb_real xi[3])
{
    if (!body->live || !body->live->holder)
        return sb_body_find_cell(body, cell, xi);
    if (!sbi_body_has_places(body, sb_body_cell_nodes(body, cell), mesh, element))
        return -1;
    return body->live->holder(body->live->find_user, cell, xi);
}

SB_API const sb_vec3 *sb_body_rest_positions(const sb_body *body) { return body ? body->reference : NULL; }
SB_API int sb_body_mesh_version(const sb_body *body) { return body && body->live ? body->live->version : 0; }

/* ---- motion ---- */

SB_API const sb_vec3 *sb_body_positions(const sb_body *body) { return body ? body->position : NULL; }
SB_API const sb_vec3 *sb_body_displacements(const sb_body *body) { return body ? body->displacement : NULL; }
SB_API const sb_vec3 *sb_body_velocities(const sb_body *body) { return body ? body->velocity : NULL; }
SB_API const sb_vec3 *sb_body_reactions(const sb_body *body) { return body ? body->reaction : NULL; }
SB_API const sb_vec3 *sb_body_external_forces(const sb_body *body) { return body ? body->external : NULL; }

static int sbi_body_all_finite(const sb_vec3 *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(values[i]))
            return 0;
    return 1;
}

SBI_API void sbi_body_update_positions(sb_body *body)
{
    for (int i = 0; i < body->domain.node_count; i++)
        body->position[i] = sb_v3_add(body->reference[i], body->displacement[i]);
}

SB_API sb_result sb_body_set_displacements(sb_body *body, const sb_vec3 *displacements)
{
    if (!body || !displacements)
        return SB_ERROR_ARGUMENT;
    if (!sbi_body_all_finite(displacements, body->domain.node_count))
        return SB_ERROR_NOT_FINITE;
    memmove(body->displacement, displacements, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_DISPLACEMENTS, 0, 0, NULL, 0, &body->displacement[0].x,
                  3 * (size_t)body->domain.node_count);
    return SB_OK;
}

SB_API sb_result sb_body_set_velocities(sb_body *body, const sb_vec3 *velocities)
{
    if (!body || !velocities)
        return SB_ERROR_ARGUMENT;
    if (!sbi_body_all_finite(velocities, body->domain.node_count))
        return SB_ERROR_NOT_FINITE;
    memmove(body->velocity, velocities, (size_t)body->domain.node_count * sizeof(sb_vec3));
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_VELOCITIES, 0, 0, NULL, 0, &body->velocity[0].x,
                  3 * (size_t)body->domain.node_count);
    return SB_OK;
}

/* The load has taken part in no solve. */
static void sbi_body_reset_load(sbi_load *load)
{
    load->balanced = 0; /* the balanced values mean nothing now, nor does a saved state have them */
    load->balanced_pressure = 0;
    load->tension = 0;
    load->curved_energy = 0;
    load->cavity.hold.pressure = load->cavity.law.kind == SB_CAVITY_LIQUID ? load->cavity.law.pressure : 0;
    load->cavity.read = 0;
    memset(load->net, 0, sizeof load->net);
    if (load->force)
        memset(load->force, 0, (size_t)load->row_count * sizeof *load->force);
}

SB_API void sb_body_reset(sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    if (!body)
        return;
    memset(body->displacement, 0, bytes);
    memset(body->velocity, 0, bytes);
    memset(body->acceleration, 0, bytes);
    memset(body->reaction, 0, bytes);
    memset(body->external, 0, bytes);
    memset(body->equilibrated, 0, bytes);
    sbi_live_forget_pushes(body);
    for (int i = 0; i < body->load_count; i++)
        sbi_body_reset_load(body->loads + i);
    sbi_body_reset_rigids(body);
    if (body->elimination) {
        memset(body->elimination->force, 0, (size_t)body->elimination->equations.count * sizeof(sb_real));
        sbi_precond_forget(body->elimination->precond);
    }
    sbi_precond_forget(body->precond);
    sbi_kept_forget(body);
    memset(&body->guard, 0, sizeof body->guard);
    sbi_assembly_reset_rotations(&body->assembly);
    sbi_assembly_forget(&body->assembly, -1, body->displacement);
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_RESET, 0, 0, NULL, 0, NULL, 0);
}

/* ---- readings ---- */

/* sum over the rows of k |H^T u - target|^2 / 2, or what a cable or membrane has. */
static sb_real sbi_body_load_energy(const sb_body *body, sbi_load *load)
{
    sb_real sum = 0;
    if (load->kind == SBI_LOAD_CABLE) {
        sbi_cable_lay(body, load, body->displacement, 1);
        return (sb_real)load->lie.energy;
    }
    if (load->kind == SBI_LOAD_MEMBRANE)
        return (sb_real)sbi_membrane_energy(body, load, body->displacement, 1);
    if (load->kind == SBI_LOAD_CAVITY) {
        sbi_cavity_lay(body, load, body->displacement, 1);
        return (sb_real)sbi_cavity_energy(load, 1);
    }
    for (int j = 0; load->kind != SBI_LOAD_PRESSURE && j < load->row_count; j++) {
        sb_vec3 stretch = sb_v3_sub(sbi_body_row_value(load, j, body->displacement), load->target[j]);
        sum += (sb_real)0.5 * load->stiffness[j] * sb_v3_dot(stretch, stretch);
    }
    return sum;
}

SB_API sb_result sb_body_energy(sb_body *body, sb_energy *energy)
{
    sb_energy sum = {0, 0, 0};
    int bad;
    if (!body || !energy)
        return SB_ERROR_ARGUMENT;
    sbi_assembly_begin_step(&body->assembly, (sb_real)INFINITY);
    bad = sbi_assembly_energy(&body->assembly, body->displacement, &sum.elastic);
    sbi_assembly_begin_step(&body->assembly, 0);
    if (bad >= 0)
        return SB_ERROR_INVERTED;
    sbi_body_mass_multiply(body, body->velocity, body->work);
    for (int i = 0; i < body->domain.node_count; i++)
        sum.kinetic += (sb_real)0.5 * sb_v3_dot(body->velocity[i], body->work[i]);
    for (int i = 0; i < body->load_count; i++)
        sum.springs += sbi_body_load_energy(body, body->loads + i);
    if (!sb_is_finite(sum.elastic) || !sb_is_finite(sum.kinetic) || !sb_is_finite(sum.springs))
        return SB_ERROR_NOT_FINITE;
    *energy = sum;
    return SB_OK;
}

/* Without x the body's matrix = K, otherwise y = K x; -1, or the first cell without a tangent. */
static int sbi_body_tangent_product(sb_body *body, sb_tangent_kind kind, const sb_vec3 *x, sb_vec3 *y)
{
    int bad;
    if (x && kind == SB_TANGENT_QUASI && sbi_assembly_multiply(&body->assembly, x, y))
        return -1;
    sbi_kept_spoil(body);
    bad = sbi_assembly_tangent(&body->assembly, body->displacement, kind, 1, &body->matrix);
    if (x && bad < 0)
        sb_matrix_multiply(&body->matrix, &x[0].x, &y[0].x, &body->jobs);
    return bad;
}

/* The same at the rotations of now, which stay as they are. */
static sb_result sbi_body_apply_tangent(sb_body *body, sb_tangent_kind kind, const sb_vec3 *x, sb_vec3 *y,
                                        sb_error *error)
{
    int bad = -1, has_rotations = body->force_current;
    if (kind != SB_TANGENT_EXACT && kind != SB_TANGENT_SPD && kind != SB_TANGENT_QUASI)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the kind of tangent %d is unknown", (int)kind);
    if (!has_rotations) { /* forces leave traces in the warm starts */
        sbi_assembly_save_rotations(&body->assembly);
        bad = sbi_assembly_force(&body->assembly, body->displacement, body->work);
    }
    if (bad < 0)
        bad = sbi_body_tangent_product(body, kind, x, y);
    if (!has_rotations)
        sbi_assembly_restore_rotations(&body->assembly);
    if (bad >= 0)
        return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    return SB_OK;
}

SB_API sb_result sb_body_multiply_tangent(sb_body *body, sb_tangent_kind kind, const sb_vec3 *x, sb_vec3 *y,
                                          sb_error *error)
{
    sb_result result;
    if (!body || !x || !y)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a product with the stiffness needs a body, x and y");
    for (int i = 0; i < body->domain.node_count; i++)
        if (!sb_v3_is_finite(x[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the displacement of node %d is not finite", i);
    result = sbi_body_apply_tangent(body, kind, x, body->work2, error);
    if (result == SB_OK)
        memcpy(y, body->work2, (size_t)body->domain.node_count * sizeof *y);
    return result;
}

SB_API sb_result sb_body_stiffness_matrix(sb_body *body, sb_tangent_kind kind, const sb_matrix **matrix,
                                          sb_error *error)
{
    sb_result result;
    if (!body || !matrix)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the stiffness needs a body and where its matrix goes");
    result = sbi_body_apply_tangent(body, kind, NULL, NULL, error);
    if (result == SB_OK)
        *matrix = &body->matrix;
    return result;
}

SB_API sb_result sb_body_multiply_stiffness(sb_body *body, const sb_vec3 *x, sb_vec3 *y, sb_error *error)
{
    return sb_body_multiply_tangent(body, SB_TANGENT_EXACT, x, y, error);
}

SB_API sb_real sb_body_mass(const sb_body *body)
{
    sb_real sum = 0;
    if (!body)
        return 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += body->lumped_mass[i];
    return sum;
}

SB_API sb_vec3 sb_body_momentum(const sb_body *body)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    if (!body)
        return sb_v3(0, 0, 0);
    for (int i = 0; i < body->domain.node_count; i++)
        sum = sb_v3_madd(sum, body->mass_blocks ? body->load_mass[i] : body->lumped_mass[i], body->velocity[i]);
    return sum;
}

/* Adds to the stress of an ordinary point what mean points have there of their share, which belongs to every point. */
static void sbi_body_add_mean_stress(const sb_body *body, const sb_real xi[3], const sb_mat3 *means,
                                     const int *means_admissible, sb_mat3 *stress, int *admissible)
{
    int count = body->domain.mean_points;
    sb_real shares[SB_MAX_MEAN_POINTS];
    sbi_domain_mean_shares(count, xi, shares);
    for (int k = 0; k < count; k++) {
        *admissible &= means_admissible[k];
        *stress = sb_m3_add(*stress, sb_m3_scale(shares[k], means[k]));
    }
}

SBI_API void sbi_body_element_stresses(const sb_body *body, int element, sb_mat3 *f, sb_mat3 *stress, int *admissible)
{
    const sb_material *material = body->materials + body->cell_material[element];
    sb_mat3 p[SBI_CELL_POINTS];
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int ordinary = sbi_body_points(body);
    if (body->domain.mean_points > 1) /* one has the same share everywhere */
        sbi_element_quadrature(sbi_domain_element(&body->domain), SB_QUADRATURE_STIFFNESS, points, weights);
    else
        memset(points, 0, sizeof points);
    sbi_assembly_points(&body->assembly, body->displacement, element, f, p, admissible);
    for (int i = body->domain.points_per_cell - 1; i >= 0; i--) {
        if (material->model != SB_LINEAR && sb_m3_det(f[i]) == 0)
            admissible[i] = 0;
        if (admissible[i])
            stress[i] = sb_material_cauchy_stress(material, f[i], p[i]);
        if (body->domain.mean_points && i < ordinary)
            sbi_body_add_mean_stress(body, points[i], stress + ordinary, admissible + ordinary, stress + i,
                                     admissible + i);
        if (!admissible[i] || !sb_is_finite(sb_von_mises(stress[i]))) { /* beyond what sb_real holds, too */
            stress[i] = sb_m3_zero();
            admissible[i] = 0;
        }
    }
}

SB_API sb_result sb_body_stress(const sb_body *body, int element, int point, sb_mat3 *stress)
{
    sb_mat3 f[SBI_CELL_POINTS], all[SBI_CELL_POINTS];
    int admissible[SBI_CELL_POINTS];
    if (!body || !stress)
        return SB_ERROR_ARGUMENT;
    if (!sb_body_cell_in_use(body, element) || point < 0 || point >= sbi_body_points(body))
        return SB_ERROR_INDEX;
    sbi_body_element_stresses(body, element, f, all, admissible);
    if (!admissible[point])
        return SB_ERROR_INVERTED;
    *stress = all[point];
    return SB_OK;
}

SBI_API sb_real sbi_body_element_volume(const sb_body *body, int element)
{
    sb_real sum = 0;
    int q = body->domain.points_per_cell;
    for (int p = 0; p < sbi_body_points(body); p++)
        sum += body->domain.weights[(size_t)element * (size_t)q + (size_t)p];
    return sum;
}

static sb_real sbi_body_element_von_mises(const sb_body *body, int element)
{
    sb_mat3 f[SBI_CELL_POINTS], stress[SBI_CELL_POINTS];
    int admissible[SBI_CELL_POINTS];
    const sb_real *weights = body->domain.weights + (size_t)element * (size_t)body->domain.points_per_cell;
    sb_real sum = 0;
    sbi_body_element_stresses(body, element, f, stress, admissible);
    for (int p = 0; body->own_points && p < sbi_body_points(body); p++)
        sum += weights[p] * sb_von_mises(stress[p]);
    if (body->own_points) {
        sb_real volume = sbi_body_element_volume(body, element);
        return volume > 0 ? sum / volume : 0;
    }
    for (int p = 0; p < sbi_body_points(body); p++)
        sum += sb_von_mises(stress[p]);
    return sum / (sb_real)sbi_body_points(body);
}

SB_API void sb_body_von_mises(const sb_body *body, sb_real *values)
{
    if (!body || !values)
        return;
    for (int e = 0; e < body->domain.cell_count; e++)
        values[e] = sbi_body_element_von_mises(body, e);
}

SB_API void sb_body_nodal_von_mises(const sb_body *body, sb_real *values)
{
    const sb_domain *domain;
    if (!body || !values)
        return;
    domain = &body->domain;
    for (int i = 0; i < domain->node_count; i++)
        values[i] = 0;
    for (int e = 0; e < domain->cell_count; e++) {
        sb_real value = sbi_body_element_von_mises(body, e) * sbi_body_element_volume(body, e);
        for (int a = 0; a < domain->nodes_per_cell; a++)
            values[domain->cells[(size_t)e * (size_t)domain->nodes_per_cell + (size_t)a]] += value;
    }
    for (int i = 0; i < domain->node_count; i++) {
        sb_real volume = 0;
        for (int at = sbi_live_first_cell(body, i); at >= 0; at = sbi_live_next_cell(body, i, at))
            volume += sbi_body_element_volume(body, sbi_live_cell_of(body, at));
        values[i] = volume > 0 ? values[i] / volume : 0;
    }
}

/* ---- how nodes turned ---- */

/* Rows of the sum of w F over the points around each node, which has the rotation of their mean. */
static void sbi_body_sum_gradients(const sb_body *body, sb_vec3 *rows[3])
{
    const sb_domain *domain = &body->domain;
    int width = domain->nodes_per_cell;
    for (int r = 0; r < 3; r++)
        memset(rows[r], 0, (size_t)domain->node_count * sizeof(sb_vec3));
    for (int e = 0; e < domain->cell_count; e++) {
        const int *nodes = domain->cells + (size_t)e * (size_t)width;
        sb_vec3 f[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        for (int p = 0; p < sbi_body_points(body); p++) {
            size_t point = (size_t)e * (size_t)domain->points_per_cell + (size_t)p;
            const sb_real *g = domain->gradients + 3 * (size_t)width * point;
            for (int a = 0; a < width; a++, g += 3) {
                sb_vec3 x = sb_v3_scale(domain->weights[point], body->position[nodes[a]]),
                        slope = sb_v3(g[0], g[1], g[2]);
                f[0] = sb_v3_madd(f[0], x.x, slope);
                f[1] = sb_v3_madd(f[1], x.y, slope);
                f[2] = sb_v3_madd(f[2], x.z, slope);
            }
        }
        for (int a = 0; a < width; a++)
            for (int r = 0; r < 3; r++)
                rows[r][nodes[a]] = sb_v3_add(rows[r][nodes[a]], f[r]);
    }
}

typedef struct sbi_body_turning {
    sb_vec3 *rows[3];
    sb_quat *rotations;
    int count;
} sbi_body_turning;

/* Rotations of SB_POLAR_LANES nodes; unused lanes repeat the last node, and a node without material does not turn. */
static void sbi_body_turn_batch(const sbi_body_turning *t, int first)
{
    sb_real f[9][SB_POLAR_LANES], q[4][SB_POLAR_LANES], r[9][SB_POLAR_LANES];
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        int i = sbi_min_int(first + l, t->count - 1);
        sb_real sum = 0;
        for (int k = 0; k < 3; k++) {
            f[3 * k][l] = t->rows[k][i].x;
            f[3 * k + 1][l] = t->rows[k][i].y;
            f[3 * k + 2][l] = t->rows[k][i].z;
        }
        for (int k = 0; k < 9; k++)
            sum = sb_max(sum, sb_abs(f[k][l]));
        for (int k = 0; k < 9; k++) /* in units of its largest entry, however small the elements */
            f[k][l] = sum > 0 ? f[k][l] / sum : (sb_real)(k % 4 == 0);
        for (int k = 0; k < 4; k++)
            q[k][l] = (sb_real)(k == 0);
    }
    sb_polar_batch(f, q, r);
    for (int l = 0; l < SB_POLAR_LANES && first + l < t->count; l++)
        t->rotations[first + l] = sb_quat_make(q[0][l], q[1][l], q[2][l], q[3][l]);
}

static void sbi_body_turn_task(void *user, int chunk)
{
    const sbi_body_turning *t = (const sbi_body_turning *)user;
    int last = sbi_min_int(t->count, (chunk + 1) * SBI_ROW_CHUNK);
    for (int first = chunk * SBI_ROW_CHUNK; first < last; first += SB_POLAR_LANES)
        sbi_body_turn_batch(t, first);
}

SB_API void sb_body_nodal_rotations(sb_body *body, sb_quat *rotations)
{
    sbi_body_turning turning;
    if (!body || !rotations)
        return;
    turning.rows[0] = body->work;
    turning.rows[1] = body->work2;
    turning.rows[2] = body->rhs;
    turning.rotations = rotations;
    turning.count = body->domain.node_count;
    sbi_body_sum_gradients(body, turning.rows);
    sbi_run(&body->jobs, sbi_body_turn_task, &turning, sbi_row_chunks(turning.count));
}
