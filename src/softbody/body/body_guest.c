/* body_guest: readings for guests, a static iteration with a load from outside, and what it did as a command. */
#include "body_guest.h"

#include <string.h>

#include "../base/bytes.h"
#include "live_private.h"
#include "load.h"
#include "rigid_private.h"
#include "step_private.h"

/* ---- readings ---- */

SBI_API sb_mesh sbi_body_mesh(const sb_body *body)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = body->domain.node_count;
    mesh.nodes = body->reference;
    mesh.element_type = body->domain.element_type;
    mesh.element_count = body->domain.cell_count;
    mesh.elements = body->domain.cells;
    return mesh;
}

SBI_API sb_mesh sbi_body_shape(const sb_body *body)
{
    sb_mesh mesh = sbi_body_mesh(body);
    mesh.nodes = body->position;
    return mesh;
}

/* 1: the two cells have the same nodes in the same order. Where the mesh can change they are no parts of a mixture. */
static int sbi_body_shares_element(const sb_body *body, int a, int b)
{
    size_t width = (size_t)body->domain.nodes_per_cell;
    const int *cells = body->domain.cells;
    return !body->live && body->domain.element_type != SB_CUSTOM &&
           memcmp(cells + (size_t)a * width, cells + (size_t)b * width, width * sizeof(int)) == 0;
}

SBI_API int sbi_body_is_later_part(const sb_body *body, int cell)
{
    return cell > 0 && sbi_body_shares_element(body, cell - 1, cell);
}

SBI_API int sbi_body_part_count(const sb_body *body, int cell)
{
    int count = 1;
    while (cell + count < body->domain.cell_count && sbi_body_shares_element(body, cell, cell + count))
        count++;
    return count;
}

/* Volume that a cell's material stands for (m^3); mean points stand for the same once more. */
static double sbi_body_cell_weight(const sb_body *body, int cell)
{
    const sb_domain *domain = &body->domain;
    const sb_real *weights = domain->weights + (size_t)cell * (size_t)domain->points_per_cell;
    double sum = 0;
    for (int p = 0; p < domain->points_per_cell - domain->mean_points; p++)
        sum += (double)weights[p];
    return sum;
}

SBI_API double sbi_body_part_share(const sb_body *body, int cell, int part)
{
    int count = sbi_body_part_count(body, cell);
    double sum = 0;
    for (int k = 0; k < count; k++)
        sum += sbi_body_cell_weight(body, cell + k);
    return count > 1 && sum > 0 ? sbi_body_cell_weight(body, cell + part) / sum : part == 0;
}

/* Lame's moduli of parts by their weights. Together these are the element's volume, or less by the mean that was
 * wanted. */
static sbi_body_modulus sbi_body_mix_moduli(const sb_body *body, int cell, int count)
{
    sb_mesh mesh = sbi_body_mesh(body);
    double volume = fabs((double)sb_mesh_element_volume(&mesh, cell)), shear = 0, lambda = 0;
    sbi_body_modulus mixed;
    for (int k = 0; k < count; k++) {
        const sb_material *material = sbi_body_cell_material(body, cell + k);
        double share = sbi_body_cell_weight(body, cell + k) / volume, nu = (double)sb_material_poisson(material);
        double g = (double)sb_material_young(material) / (2 * (1 + nu));
        shear += share * g;
        lambda += share * 2 * g * nu / (1 - 2 * nu);
    }
    mixed.poisson = lambda / (2 * (lambda + shear));
    mixed.young = 2 * (1 + mixed.poisson) * shear;
    return mixed;
}

SBI_API sbi_body_modulus sbi_body_cell_modulus(const sb_body *body, int cell)
{
    const sb_material *material = sbi_body_cell_material(body, cell);
    int count = sbi_body_part_count(body, cell);
    sbi_body_modulus modulus;
    if (count > 1)
        return sbi_body_mix_moduli(body, cell, count);
    modulus.young = (double)sb_material_young(material);
    modulus.poisson = (double)sb_material_poisson(material);
    return modulus;
}

/* Elements in use, in the order of their slots; of parts of one the first. */
static void sbi_body_copy_cells(const sb_body *body, sb_mesh *mesh)
{
    size_t width = (size_t)body->domain.nodes_per_cell;
    for (int e = 0; e < body->domain.cell_count; e++)
        if (sb_body_cell_in_use(body, e) && !sbi_body_is_later_part(body, e))
            memcpy(mesh->elements + (size_t)mesh->element_count++ * width, body->domain.cells + (size_t)e * width,
                   width * sizeof(int));
}

SBI_API sb_result sbi_body_copy_mesh(const sb_body *body, const sb_allocator *allocator, sb_mesh *mesh, sb_error *error)
{
    sb_mesh made = sbi_body_mesh(body);
    made.allocator = *allocator;
    made.element_count = 0;
    made.nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)body->domain.node_count, sizeof(sb_vec3));
    made.elements =
        (int *)sbi_alloc(allocator, (size_t)body->domain.cell_count, (size_t)body->domain.nodes_per_cell * sizeof(int));
    if (!made.nodes || !made.elements) {
        sb_mesh_free(&made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a mesh of %d nodes", body->domain.node_count);
    }
    sbi_body_copy_cells(body, &made);
    for (int i = 0; i < made.node_count; i++)
        made.nodes[i] = body->reference[sb_body_node_in_use(body, i) ? i : made.elements[0]];
    *mesh = made;
    return SB_OK;
}

SBI_API void sbi_body_list_cells(const sb_body *body, int *cells)
{
    int count = 0;
    for (int e = 0; e < body->domain.cell_count; e++)
        if (sb_body_cell_in_use(body, e) && !sbi_body_is_later_part(body, e))
            cells[count++] = e;
}

SBI_API int sbi_body_has_uncut(const sb_body *owner) { return owner->live && owner->live->uncut; }

SBI_API sb_result sbi_body_copy_uncut(const sb_body *body, const sb_body *owner, const sb_allocator *allocator,
                                      sb_mesh *mesh, int **cells, sb_error *error)
{
    const sbi_uncut *uncut = owner->live->uncut;
    size_t nodes = (size_t)uncut->node_end, count = (size_t)uncut->cell_count;
    size_t width = (size_t)body->domain.nodes_per_cell;
    sb_mesh made = sbi_body_mesh(body);
    if (uncut->node_end > body->domain.node_count)
        return sbi_fail(error, SB_ERROR_STATE, "the body has not the nodes of the mesh before its cuts");
    made.allocator = *allocator;
    made.node_count = uncut->node_end;
    made.element_count = uncut->cell_count;
    made.nodes = (sb_vec3 *)sbi_alloc(allocator, nodes, sizeof(sb_vec3));
    made.elements = (int *)sbi_alloc(allocator, count, width * sizeof(int));
    *cells = (int *)sbi_alloc(allocator, count, sizeof(int));
    if (!made.nodes || !made.elements || !*cells) {
        sbi_free(allocator, *cells);
        sb_mesh_free(&made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a mesh of %d nodes", uncut->node_end);
    }
    memcpy(made.nodes, body->reference, nodes * sizeof(sb_vec3));
    memcpy(made.elements, uncut->nodes, count * width * sizeof(int));
    memcpy(*cells, uncut->cells, count * sizeof(int));
    *mesh = made;
    return SB_OK;
}

SBI_API sb_result sbi_body_check_version(const sb_body *body, int version, sb_error *error)
{
    if (sb_body_mesh_version(body) == version)
        return SB_OK;
    return sbi_fail(error, SB_ERROR_STATE, "the body's mesh has changed since: make this anew");
}

SBI_API const sb_jobs *sbi_body_jobs(const sb_body *body) { return &body->jobs; }
SBI_API const sb_allocator *sbi_body_allocator(const sb_body *body) { return &body->allocator; }
SBI_API int sbi_body_is_implicit(const sb_body *body) { return body->integrator != SB_CENTRAL_DIFFERENCE; }
SBI_API sb_result sbi_body_reserve_guest(sb_body *body, int unknowns, int nodes, sb_error *error)
{
    int rows = body->live ? sbi_body_node_slots(body).room : body->matrix.row_count;
    sbi_rigids_count(body, &unknowns, &nodes);
    return sbi_pcg_reserve_guest_room(&body->pcg, &body->matrix, rows, unknowns, nodes, error);
}

SBI_API int sbi_body_has_pieces(const sb_body *body) { return body->live && body->live->piece_count > 0; }
SBI_API int sbi_body_is_live(const sb_body *body) { return body->live != NULL; }
SBI_API int sbi_body_has_finder(const sb_body *body) { return body->live && body->live->find; }
SBI_API int sbi_body_has_constraints(const sb_body *body) { return body->elimination != NULL; }
SBI_API int sbi_body_load_count(const sb_body *body) { return body->load_count; }
SBI_API int sbi_body_max_iterations(const sb_body *body) { return body->max_iterations; }
SBI_API const sb_vec3 *sbi_body_targets(const sb_body *body) { return body->target; }

SBI_API sb_real sbi_body_young(const sb_body *body)
{
    double sum = 0;
    int count = 0;
    for (int e = 0; e < body->domain.cell_count; e++)
        if (sb_body_cell_in_use(body, e) && !sbi_body_is_later_part(body, e)) {
            sum += sbi_body_cell_modulus(body, e).young;
            count++;
        }
    return (sb_real)(sum / (double)count);
}

/* ---- slots ---- */

static sbi_body_slots sbi_body_view_slots(const sbi_slots *slots)
{
    sbi_body_slots view;
    view.end = slots->fresh;
    view.room = slots->capacity;
    view.free = slots->stack;
    view.free_count = slots->count;
    return view;
}

SBI_API sbi_body_slots sbi_body_node_slots(const sb_body *body)
{
    sbi_body_slots none = {0, 0, NULL, 0};
    return body->live ? sbi_body_view_slots(&body->live->nodes) : none;
}

SBI_API sbi_body_slots sbi_body_cell_slots(const sb_body *body)
{
    sbi_body_slots none = {0, 0, NULL, 0};
    return body->live ? sbi_body_view_slots(&body->live->cells) : none;
}

SBI_API int sbi_body_cell_region(const sb_body *body, int cell)
{
    return sb_body_cell_in_use(body, cell) ? body->material_regions[body->cell_material[cell]] : 0;
}

SBI_API const sb_material *sbi_body_cell_material(const sb_body *body, int cell)
{
    return body->materials + body->cell_material[cell];
}

/* ---- shapes ---- */

SBI_API int sbi_body_try_shape(sb_body *body, const sb_vec3 *u, sb_real *energy)
{
    return sbi_assembly_energy(&body->assembly, u, energy);
}

/* Internal forces at the present shape. On failure the rotations' warm starts are what they were. */
static sb_result sbi_body_current_force(sb_body *b, sb_error *error)
{
    int bad;
    if (b->force_current)
        return SB_OK;
    sbi_assembly_save_rotations(&b->assembly);
    bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
    b->force_current = bad < 0;
    if (bad < 0)
        return SB_OK;
    sbi_assembly_restore_rotations(&b->assembly);
    return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                            "element %d is inside out, which its material does not allow", bad);
}

/* What was learnt on the way is part of the state: the rotations' warm starts follow from the forces at the shape
 * before, the preconditioner's memory is told. */
SBI_API void sbi_body_place(sb_body *body, const sb_vec3 *u)
{
    sbi_precond_memory memory = sbi_precond_get_memory(body->precond);
    int ints[SBI_PLACE_INTS];
    uint64_t shift;
    sbi_command command;
    (void)sbi_body_current_force(body, NULL);
    memcpy(body->displacement, u, (size_t)body->domain.node_count * sizeof *u);
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    memset(&command, 0, sizeof command);
    memcpy(&shift, &memory.shift, sizeof shift);
    ints[0] = sbi_int_of(shift & 0xffffffffu);
    ints[1] = sbi_int_of(shift >> 32);
    ints[2] = memory.successes;
    ints[3] = memory.wait;
    command.code = SBI_COMMAND_PLACE;
    command.ints = ints;
    command.int_count = SBI_PLACE_INTS;
    command.reals = &body->displacement[0].x;
    command.real_count = 3 * (size_t)body->domain.node_count;
    sbi_body_tell_command(body, &command);
}

SBI_API sb_result sbi_body_replay_place(sb_body *body, const int *ints, const sb_vec3 *u, sb_error *error)
{
    sbi_precond_memory memory;
    uint64_t shift = (uint64_t)(uint32_t)ints[1] << 32 | (uint32_t)ints[0];
    sb_result result;
    memcpy(&memory.shift, &shift, sizeof shift);
    memory.successes = ints[2];
    memory.wait = ints[3];
    for (int i = 0; i < body->domain.node_count; i++)
        if (!sb_v3_is_finite(u[i]))
            return sbi_fail_node(error, SB_ERROR_FORMAT, i, "the displacement of node %d is not finite", i);
    if (!sbi_precond_is_memory(memory))
        return sbi_fail(error, SB_ERROR_FORMAT, "the memory of the preconditioner is none");
    result = sbi_body_current_force(body, error);
    if (result != SB_OK)
        return result;
    sbi_precond_set_memory(body->precond, memory);
    sbi_body_place(body, u);
    return SB_OK;
}

/* ---- forces and stiffness ---- */

SBI_API sb_result sbi_body_make_factor(const sb_body *body, const sb_allocator *allocator, sb_direct **factor,
                                       sb_error *error)
{
    sb_direct_def def = sb_default_direct_def();
    def.positions = body->reference;
    return sb_direct_create(&def, &body->matrix, allocator, factor, error);
}

/* Factor of the mass matrix that makes `hold` of it. */
static sb_real sbi_body_hold_factor(const sb_body *body, sb_real hold)
{
    sb_real mass = sb_body_mass(body);
    return mass > 0 ? hold / mass : 0;
}

SBI_API sb_result sbi_body_factor(sb_body *b, sb_real hold, sb_vec3 *residual, sb_direct *factor, sb_error *error)
{
    sb_result result = sbi_body_refuse_rigids(b, "registrations", error);
    if (result == SB_OK)
        result = sbi_body_current_force(b, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < b->domain.node_count; i++)
        residual[i] = sb_v3_sub(b->internal[i], sb_v3_madd(b->dead_load[i], b->load_mass[i], b->gravity));
    sbi_kept_spoil(b);
    sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_QUASI, 1, &b->matrix);
    sbi_body_add_mass(b, sbi_body_hold_factor(b, hold));
    sb_matrix_constrain(&b->matrix, b->fixed, NULL, NULL);
    return sb_direct_update(factor, &b->matrix, error);
}

/* ---- one iteration with a load from outside ---- */

SBI_API sb_result sbi_relax_begin(sb_body *body, sbi_potential *potential, sb_real hold, sb_real tolerance,
                                  sb_step_info *info, sbi_step *step)
{
    sb_result result;
    memset(step, 0, sizeof *step);
    sbi_step_begin_info(info);
    step->body = body;
    step->info = info;
    step->part = step->load_factor = step->loads_factor = step->level = step->inertia_level = 1;
    step->hold = sbi_body_hold_factor(body, hold);
    step->linear_tolerance = tolerance;
    step->linearised = 1;
    step->max_iterations = body->max_iterations;
    sbi_step_save(body);
    result = sbi_body_refuse_rigids(body, "registrations", &info->error);
    if (result == SB_OK)
        result = sbi_potential_lend(body, potential, &info->error);
    if (result != SB_OK) {
        step->done = 1; /* it was not lent */
        return result;
    }
    for (int i = 0; i < body->domain.node_count; i++)
        body->external[i] = sb_v3_madd(body->dead_load[i], body->load_mass[i], body->gravity);
    return sbi_step_linearise(step);
}

SBI_API sb_vec3 *sbi_relax_increment(const sbi_step *step) { return step->body->increment; }

SBI_API void sbi_relax_end(sbi_step *step, sbi_potential *potential, const sb_vec3 *u)
{
    sb_body *b = step->body;
    if (!step->done)
        sbi_potential_return(b, potential);
    memcpy(b->external, b->saved_external, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (u)
        sbi_body_place(b, u);
    else
        sbi_step_restore(b);
}
