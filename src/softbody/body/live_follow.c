/* live_follow: a change made on the body in place, at the cost of what changed.
 *
 * First everything that may fail: checks, memory, listeners. What looks wrong, or is not for here, is left to
 * live_build.c, which names it. Then all rooms follow. Both ways lead to the same bits, for masses, parts, boxes,
 * chunks and preconditioner depend on the mesh alone. */
#include "live_change.h"

#include <string.h>

#include "../fem/assembly_live.h"

typedef struct sbi_live_following {
    sb_body *body;
    sb_body_change *change;
    const sbi_change_lists *lists;
    const sb_mesh_change *out;
    int old_nodes, old_cells; /* ends before */
    sbi_live_balance before;
    int first;      /* see sbi_live_first_changed */
    int node_count; /* of lists->nodes */
    sbi_tet_rule rule;
} sbi_live_following;

/* ---- whether it can be done here ---- */

/* Calls with the nodes of all cells that go, come or change shape. */
typedef void sbi_live_each(sbi_live_following *work, int node, int by);
static void sbi_live_each_node(sbi_live_following *work, sbi_live_each *each)
{
    const sb_mesh_change *out = work->out;
    for (int k = 0; k < 4 * out->removed_cell_count; k++)
        each(work, out->removed_cell_nodes[k], -1);
    for (int k = 0; k < 4 * out->made_cell_count; k++)
        each(work, out->made_cell_nodes[k], 1);
    for (int k = 0; k < 4 * out->reshaped_cell_count; k++)
        each(work, work->body->domain.cells[4 * (size_t)out->reshaped_cells[k / 4] + (size_t)(k % 4)], 0);
}

static void sbi_live_mark_node(sbi_live_following *work, int node, int by)
{
    (void)by;
    work->body->live->node_marks[node] = 1;
}

static void sbi_live_unmark_node(sbi_live_following *work, int node, int by)
{
    (void)by;
    work->body->live->node_marks[node] = 0;
}

/* Marks of nodes while loads are looked at. */
enum { SBI_LIVE_CHANGED = 1, SBI_LIVE_GOES = 2, SBI_LIVE_GLUED = 4 };

/* 1 when a row of a load has a node that goes or moves, or nodes of changed cells only: it may be in one; or nodes that
 * glue may couple until now. */
static int sbi_live_row_is_touched(const sbi_live_following *work, const sbi_load *load, int row)
{
    const int *marks = work->body->live->node_marks;
    int all = 1, glued = 0;
    for (int k = load->row_start[row]; k < load->row_start[row + 1]; k++) {
        all &= (marks[load->nodes[k]] & SBI_LIVE_CHANGED) != 0;
        glued += (marks[load->nodes[k]] & SBI_LIVE_GLUED) != 0;
        if (marks[load->nodes[k]] & SBI_LIVE_GOES)
            return 1;
    }
    return (all && load->kind != SBI_LOAD_SPRINGS) || (glued > 1 && load->kind == SBI_LOAD_MAPPING) ||
           (glued > 0 && load->kind == SBI_LOAD_CABLE); /* its rows are coupled to each other */
}

/* Marks, or with 0 frees of their marks, nodes that the change or glue is about. */
static void sbi_live_mark_nodes(const sbi_live_following *work, int goes, int glued)
{
    const sbi_glue *glue = &work->body->live->glue;
    const sb_mesh_change *out = work->out;
    int *marks = work->body->live->node_marks;
    for (int i = 0; i < out->removed_node_count; i++)
        marks[out->removed_nodes[i]] = goes;
    for (int i = 0; i < out->moved_node_count; i++)
        marks[out->moved_nodes[i]] = goes;
    for (int k = 0; k < 2 * glue->nodes * glue->count; k++) {
        int *mark = marks + glue->ties[k / (2 * glue->nodes)].nodes[k & 1][k / 2 % glue->nodes];
        *mark = glued ? *mark | glued : 0;
    }
}

static int sbi_live_loads_are_touched(sbi_live_following *work)
{
    const sb_body *body = work->body;
    int touched = 0;
    if (!body->load_count && !body->traction_count)
        return 0;
    sbi_live_each_node(work, sbi_live_mark_node);
    sbi_live_mark_nodes(work, SBI_LIVE_CHANGED | SBI_LIVE_GOES, SBI_LIVE_GLUED);
    for (int l = 0; l < body->load_count && !touched; l++)
        for (int j = 0; j < body->loads[l].row_count && !touched; j++)
            touched = sbi_live_row_is_touched(work, body->loads + l, j);
    for (int i = 0; i < body->traction_count && !touched; i++) {
        const int *nodes = body->tractions[i].nodes, *marks = body->live->node_marks;
        touched = (marks[nodes[0]] & marks[nodes[1]] & marks[nodes[2]] & SBI_LIVE_CHANGED) != 0;
    }
    sbi_live_each_node(work, sbi_live_unmark_node);
    sbi_live_mark_nodes(work, 0, 0);
    return touched;
}

/* What of the body decides. */
static int sbi_live_body_fits(const sb_body *body, const sb_body_change *change)
{
    return sbi_live_follows(body) && !body->elimination && !body->extra_count && !body->tie_count &&
           change->nodes.capacity == body->live->nodes.capacity &&
           change->cells.capacity == body->live->cells.capacity && change->nodes.end > 0 && change->cells.end > 0 &&
           change->cells.fresh > change->cells.count;
}

/* Lists a node once; marks hold 1 + its place. */
static void sbi_live_list_node(sbi_live_following *work, int node, int by)
{
    const sbi_change_lists *lists = work->lists;
    int *mark = work->body->live->node_marks + node;
    if (!*mark) {
        lists->nodes[work->node_count] = node;
        lists->gone[work->node_count] = lists->come[work->node_count] = 0;
        *mark = ++work->node_count;
    }
    lists->gone[*mark - 1] += by < 0;
    lists->come[*mark - 1] += by > 0;
}

/* The nodes of changed cells, and those that come, go or move. */
static void sbi_live_list_nodes(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    work->node_count = 0;
    sbi_live_each_node(work, sbi_live_list_node);
    for (int i = 0; i < out->removed_node_count; i++)
        sbi_live_list_node(work, out->removed_nodes[i], 0);
    for (int i = 0; i < out->made_node_count; i++)
        sbi_live_list_node(work, out->made_nodes[i], 0);
    for (int i = 0; i < out->moved_node_count; i++)
        sbi_live_list_node(work, out->moved_nodes[i], 0);
    for (int next = 0; next < 2; next++) { /* rows of their supports have other blocks */
        const sbi_glue *glue = next ? &work->body->live->next_glue : &work->body->live->glue;
        for (int k = 0; k < 2 * glue->nodes * glue->count; k++)
            sbi_live_list_node(work, glue->ties[k / (2 * glue->nodes)].nodes[k & 1][k / 2 % glue->nodes], 0);
    }
}

/* Asks for what following reads of a cell about a changed node, and of the node. */
static void sbi_live_fetch_cell(const sb_body *body, int corner)
{
    SBI_PREFETCH(body->assembly.live->pair_next + 6 * (corner / 4), 0);
    SBI_PREFETCH(body->live->masses + corner, 0);
}

static void sbi_live_fetch_node(const sb_body *body, int node)
{
    const sb_matrix *matrix = &body->matrix;
    int first = matrix->row_start[node];
    SBI_PREFETCH(matrix->columns + first, 0);
    SBI_PREFETCH(matrix->live->heads + first, 0);
    SBI_PREFETCH(matrix->live->uses + first, 0);
    SBI_PREFETCH(body->reference + node, 0);
    SBI_PREFETCH(body->position + node, 0);
    SBI_PREFETCH(body->velocity + node, 0);
}

enum { SBI_LIVE_ABREAST = 8 };

/* Walks the rings of the listed nodes, some side by side: after steps each next corner of a ring is a miss of the
 * caches, and what follows would wait for one after the other. */
static void sbi_live_fetch(const sbi_live_following *work)
{
    const sb_body *body = work->body;
    for (int first = 0; first < work->node_count; first += SBI_LIVE_ABREAST) {
        int at[SBI_LIVE_ABREAST], count = sbi_min_int(SBI_LIVE_ABREAST, work->node_count - first), left = 0;
        for (int k = 0; k < count; k++) {
            int node = work->lists->nodes[first + k];
            at[k] = node < work->old_nodes ? sbi_live_first_cell(body, node) : -1;
            left += at[k] >= 0;
            if (at[k] >= 0)
                sbi_live_fetch_node(body, node);
        }
        while (left > 0)
            for (int k = 0; k < count; k++) {
                if (at[k] < 0)
                    continue;
                sbi_live_fetch_cell(body, at[k]);
                at[k] = sbi_live_next_cell(body, work->lists->nodes[first + k], at[k]);
                left -= at[k] < 0;
            }
    }
}

/* 1 when a node has more cells than so many before the change. */
static int sbi_live_has_more_cells(const sb_body *body, int node, int most)
{
    int at;
    if (most < 0 || node >= body->domain.node_count)
        return most < 0;
    at = sbi_live_first_cell(body, node);
    for (; at >= 0 && most > 0; most--)
        at = sbi_live_next_cell(body, node, at);
    return at >= 0;
}

/* 1 when nodes that go lose all of their cells. */
static int sbi_live_leave_all(const sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    for (int i = 0; i < out->removed_node_count; i++) {
        int node = out->removed_nodes[i], gone = work->lists->gone[work->body->live->node_marks[node] - 1];
        if (sbi_live_has_more_cells(work->body, node, gone))
            return 0;
    }
    return 1;
}

/* 1 when all other nodes of cells that go, and all made ones, have a cell afterwards. */
static int sbi_live_keep_some(const sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    const sbi_change_lists *lists = work->lists;
    const sb_body *body = work->body;
    for (int k = 0; k < work->node_count; k++)
        if (lists->gone[k] > 0 && sbi_slots_is_used(&work->change->nodes, lists->nodes[k]) &&
            !sbi_live_has_more_cells(body, lists->nodes[k], lists->gone[k] - lists->come[k]))
            return 0;
    for (int i = 0; i < out->made_node_count; i++) {
        int k = body->live->node_marks[out->made_nodes[i]] - 1;
        if (!sbi_live_has_more_cells(body, out->made_nodes[i], lists->gone[k] - lists->come[k]))
            return 0;
    }
    return 1;
}

/* The rest shape to come: node_marks hold 1 + the index of made nodes, and -1 - that of moved ones. */
static void sbi_live_mark_places(const sbi_live_following *work, int on)
{
    const sb_mesh_change *out = work->out;
    int *marks = work->body->live->node_marks;
    for (int i = 0; i < out->made_node_count; i++)
        marks[out->made_nodes[i]] = on ? 1 + i : 0;
    for (int i = 0; i < out->moved_node_count; i++)
        marks[out->moved_nodes[i]] = on ? -1 - i : 0;
}

static sb_vec3 sbi_live_place(const sbi_live_following *work, int node)
{
    int mark = work->body->live->node_marks[node];
    const sb_body_change *change = work->change;
    if (mark > 0)
        return change->made_nodes.items[change->node_at[node] - 1].position;
    return mark < 0 ? change->moved_nodes.items[-1 - mark].position : work->body->reference[node];
}

static int sbi_live_cell_is_upright(const sbi_live_following *work, const int *nodes, sb_real share, int is_piece)
{
    sb_vec3 x[4];
    for (int a = 0; a < 4; a++)
        x[a] = sbi_live_place(work, nodes[a]);
    return sbi_domain_is_upright(&work->rule, x, share, is_piece);
}

static const sbi_changed_cell *sbi_live_made_cell(const sbi_live_following *work, int index)
{
    return work->change->made_cells.items + work->change->cell_at[work->out->made_cells[index]] - 1;
}

/* 1 when cells made have four nodes in use, and they and those reshaped a volume. */
static int sbi_live_cells_are_good(const sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    int good = 1;
    for (int k = 0; k < out->made_cell_count && good; k++) {
        const int *n = out->made_cell_nodes + 4 * (size_t)k;
        for (int a = 0; a < 4; a++)
            good &= sbi_slots_is_used(&work->change->nodes, n[a]);
        good &= n[0] != n[1] && n[0] != n[2] && n[0] != n[3] && n[1] != n[2] && n[1] != n[3] && n[2] != n[3];
        good =
            good && sbi_live_cell_is_upright(work, n, out->made_shares[k], sbi_live_made_cell(work, k)->piece.is != 0);
    }
    for (int k = 0; k < out->reshaped_cell_count && good; k++)
        good = sbi_live_cell_is_upright(work, work->body->domain.cells + 4 * (size_t)out->reshaped_cells[k],
                                        out->reshaped_shares[k], sbi_live_is_piece(work->body, out->reshaped_cells[k]));
    return good;
}

static int sbi_live_change_fits(sbi_live_following *work)
{
    int good;
    sbi_domain_make_tet_rule(&work->body->domain, &work->rule);
    sbi_live_mark_places(work, 1);
    good = sbi_live_cells_are_good(work); /* corners are in range after it */
    sbi_live_mark_places(work, 0);
    if (!good)
        return 0;
    sbi_live_list_nodes(work);
    sbi_live_fetch(work);
    good = sbi_live_leave_all(work) && (work->body->live->erodes || sbi_live_keep_some(work));
    for (int k = 0; k < work->node_count; k++)
        work->body->live->node_marks[work->lists->nodes[k]] = 0;
    return good && sbi_live_check_removed(work->body, &work->change->nodes, work->out, NULL) == SB_OK &&
           !sbi_live_loads_are_touched(work);
}

/* ---- memory ---- */

/* Room for what the rooms will have. 0: some array is too small. */
static int sbi_live_reserve(sbi_live_following *work, sb_result *result, sb_error *error)
{
    sb_body *body = work->body;
    sbi_matrix_couplings couplings = sbi_live_glue_couplings(body, work->out);
    int blocks = sbi_matrix_capacity(&body->matrix), supports;
    *result = sbi_matrix_reserve(&body->matrix, work->out, &couplings, error);
    if (*result != SB_OK)
        return 1;
    if (sbi_matrix_capacity(&body->matrix) != blocks || !sbi_precond_reserve(body->precond, &body->matrix))
        return 0;
    *result = sbi_domain_reserve(&body->domain, work->out, error);
    if (*result == SB_OK)
        *result = sbi_assembly_reserve(&body->assembly, &body->matrix, work->out, error);
    supports = body->support_used + body->matrix.live->key_count + work->out->made_node_count;
    if (*result == SB_OK && body->support_used && sbi_body_reserve_support_blocks(body, supports) != SB_OK)
        *result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d blocks of supports", supports);
    if (*result == SB_OK && sbi_change_makes_pieces(work->change) && !sbi_live_take_pieces(body))
        *result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d pieces", body->live->cells.capacity);
    return 1;
}

/* ---- what is read before anything changes ---- */

static void sbi_live_read_motions(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    sbi_live_motion *motions = work->lists->motions;
    for (int i = 0; i < out->made_node_count; i++)
        motions[i] = sbi_live_made_motion(work->body, out, i);
    for (int i = 0; i < out->moved_node_count; i++)
        motions[out->made_node_count + i] = sbi_live_moved_motion(work->body, out, i);
    for (int i = 0; i < out->removed_node_count; i++)
        work->lists->forces[i] = work->body->dead_load[out->removed_nodes[i]];
}

/* Where a node will be in space. */
static sb_vec3 sbi_live_position(const sbi_live_following *work, int node)
{
    int mark = work->body->live->node_marks[node];
    const sbi_live_motion *motion =
        mark > 0 ? work->lists->motions + mark - 1 : work->lists->motions + work->out->made_node_count - 1 - mark;
    sb_vec3 u = mark == 0 || motion->node < 0 ? work->body->displacement[node] : motion->displacement;
    return sb_v3_add(sbi_live_place(work, node), u);
}

static void sbi_live_read_momentum(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    const sb_body *body = work->body;
    int node = -1;
    sb_vec3 about;
    work->first = sbi_live_first_changed(out);
    if (work->first < 0)
        return;
    for (int k = 0; k < out->made_cell_count && node < 0; k++)
        if (out->made_cells[k] == work->first)
            node = out->made_cell_nodes[4 * (size_t)k];
    node = node < 0 ? body->domain.cells[4 * (size_t)work->first] : node;
    sbi_live_mark_places(work, 1);
    about = sbi_live_position(work, node);
    sbi_live_mark_places(work, 0);
    work->before = sbi_live_weigh(body, out, about);
}

/* ---- following ---- */

/* A slot of a node without anything. */
static void sbi_live_blank_node(sb_body *body, int node)
{
    sb_vec3 *carried[SBI_LIVE_CARRIED];
    sbi_live_list_carried(body, carried);
    for (int k = 0; k < SBI_LIVE_CARRIED; k++)
        carried[k][node] = sb_v3(0, 0, 0);
    body->reference[node] = body->position[node] = sb_v3(0, 0, 0);
    body->lumped_mass[node] = body->load_mass[node] = body->node_damping[node] = 0;
    body->fixed[node] = SB_XYZ;
    body->node_component[node] = -1;
}

static void sbi_live_put_motion(sb_body *body, const sbi_live_motion *motion)
{
    body->displacement[motion->node] = motion->displacement;
    body->velocity[motion->node] = motion->velocity;
    body->acceleration[motion->node] = motion->acceleration;
    body->target[motion->node] = motion->target;
    body->fixed[motion->node] = motion->fixed;
}

/* Shape, motion, supports and dead loads by node. */
static void sbi_live_follow_nodes_of_body(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    const sb_body_change *change = work->change;
    const sbi_live_motion *motions = work->lists->motions;
    sb_body *body = work->body;
    for (int i = work->old_nodes; i < out->node_end; i++)
        sbi_live_blank_node(body, i);
    for (int i = 0; i < out->removed_node_count; i++)
        sbi_live_blank_node(body, out->removed_nodes[i]);
    for (int i = 0; i < out->made_node_count; i++) {
        int node = out->made_nodes[i];
        sbi_live_blank_node(body, node);
        sbi_live_put_motion(body, motions + i);
        body->reference[node] = change->made_nodes.items[change->node_at[node] - 1].position;
        body->position[node] = sb_v3_add(body->reference[node], body->displacement[node]);
    }
    for (int i = 0; i < out->moved_node_count; i++) {
        int node = out->moved_nodes[i];
        if (motions[out->made_node_count + i].node >= 0)
            sbi_live_put_motion(body, motions + out->made_node_count + i);
        body->reference[node] = change->moved_nodes.items[i].position;
        body->position[node] = sb_v3_add(body->reference[node], body->displacement[node]);
    }
    for (int i = 0; i < out->removed_node_count; i++)
        for (int k = out->heir_start[i]; k < out->heir_start[i + 1]; k++) {
            sb_vec3 force = work->lists->forces[i], *load = body->dead_load + out->heirs[k];
            if (force.x != 0 || force.y != 0 || force.z != 0)
                *load = sb_v3_madd(*load, out->heir_weights[k], force);
        }
}

static void sbi_live_put_piece(sbi_live *live, int cell, const sbi_piece *piece)
{
    if (!live->pieces)
        return;
    live->piece_count += (piece->is != 0) - (live->pieces[cell].is != 0);
    live->pieces[cell] = *piece;
}

/* Shares, pieces, regions and fibres by cell; slots. */
static void sbi_live_follow_cells_of_body(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    sb_body_change *change = work->change;
    sb_body *body = work->body;
    sbi_live *live = body->live;
    sbi_piece none;
    sbi_slots slots;
    memset(&none, 0, sizeof none);
    for (int e = work->old_cells; e < out->cell_end; e++) {
        live->shares[e] = 0;
        body->cell_material[e] = 0;
        if (body->fibres)
            body->fibres[e] = sb_v3(0, 0, 0);
    }
    for (int i = 0; i < out->removed_cell_count; i++) {
        live->shares[out->removed_cells[i]] = 0;
        sbi_live_put_piece(live, out->removed_cells[i], &none);
        body->cell_material[out->removed_cells[i]] = 0;
    }
    for (int i = 0; i < change->made_cells.count; i++) {
        const sbi_changed_cell *cell = change->made_cells.items + i;
        if (cell->dropped)
            continue;
        live->shares[cell->cell] = cell->share;
        sbi_live_put_piece(live, cell->cell, &cell->piece);
        body->cell_material[cell->cell] = cell->material;
        if (body->fibres)
            body->fibres[cell->cell] = cell->fibre;
    }
    slots = live->nodes, live->nodes = change->nodes, change->nodes = slots;
    slots = live->cells, live->cells = change->cells, change->cells = slots;
}

/* Nodes that were in no cell and are now are free to move. */
static void sbi_live_wake_nodes(sbi_live_following *work)
{
    sb_body *body = work->body;
    for (int k = 0; k < work->node_count; k++) {
        int node = work->lists->nodes[k];
        if (work->lists->come[k] > 0 && body->node_component[node] < 0 && node < work->old_nodes &&
            !work->change->node_at[node])
            body->fixed[node] = 0;
    }
}

static void sbi_live_follow_masses(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    sb_body *body = work->body;
    if (body->mass_blocks) { /* they are in other places */
        sbi_body_update_mass(body);
        return;
    }
    for (int i = 0; i < out->made_cell_count; i++)
        sbi_body_weigh_cell(body, out->made_cells[i], &work->rule);
    for (int i = 0; i < out->reshaped_cell_count; i++)
        sbi_body_weigh_cell(body, out->reshaped_cells[i], &work->rule);
    for (int k = 0; k < work->node_count; k++)
        if (work->lists->nodes[k] < body->domain.node_count)
            sbi_body_sum_node_mass(body, work->lists->nodes[k]);
}

/* Blocks in the rows of those supports that the change may touch. */
static int sbi_live_count_supports(const sbi_live_following *work)
{
    const sb_body *body = work->body;
    int count = 0;
    for (int k = 0; k < work->node_count; k++) {
        int i = work->lists->nodes[k];
        if (i < body->domain.node_count && body->fixed[i] && body->node_component[i] >= 0)
            count += body->matrix.row_end[i] - body->matrix.row_start[i];
    }
    return count;
}

/* ---- parts and their boxes ---- */

/* Nodes that go or move leave their box, while they are where they were. */
static void sbi_live_leave_boxes(const sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    sb_body *body = work->body;
    for (int i = 0; i < out->removed_node_count + out->moved_node_count; i++) {
        int gone = out->removed_node_count, node = i < gone ? out->removed_nodes[i] : out->moved_nodes[i - gone];
        if (node < work->old_nodes && body->node_component[node] >= 0)
            sbi_body_leave_box(body, body->node_component[node], body->reference[node]);
    }
}

/* Number of the part of a node that the matrix has, or -1: it is in no cell. */
static int sbi_live_component(const sb_body *body, int node)
{
    const sbi_matrix_live *live = body->matrix.live;
    int part = live->part_of[node];
    if (part == live->alone_part || !sbi_live_has_material(body, node))
        return -1;
    return part - (live->alone_part >= 0 && part > live->alone_part);
}

/* Parts and boxes as sbi_body_label_nodes gives them, from the nodes that the change is about alone, unless parts got
 * other numbers or a box has lost all nodes of a side. */
static void sbi_live_label_changed(const sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    sb_body *body = work->body;
    int right = 1;
    if (body->matrix.live->renumbered) {
        sbi_body_label_nodes(body);
        return;
    }
    body->component_count = body->matrix.part_count - (body->matrix.live->alone_part >= 0);
    for (int i = 0; i < out->moved_node_count; i++)
        if (body->node_component[out->moved_nodes[i]] >= 0)
            sbi_body_enter_box(body, body->node_component[out->moved_nodes[i]], body->reference[out->moved_nodes[i]]);
    for (int k = 0; k < work->node_count; k++) {
        int i = work->lists->nodes[k], old;
        if (i >= body->domain.node_count)
            continue;
        old = body->node_component[i];
        body->node_component[i] = sbi_live_component(body, i);
        if (body->node_component[i] < 0)
            body->fixed[i] = SB_XYZ;
        if (body->node_component[i] < 0 && old >= 0)
            sbi_body_leave_box(body, old, body->reference[i]);
        if (body->node_component[i] >= 0 && old < 0)
            sbi_body_enter_box(body, body->node_component[i], body->reference[i]);
    }
    for (int c = 0; c < body->component_count; c++)
        right &= sbi_body_box_is_right(body, c);
    if (!right)
        sbi_body_make_boxes(body);
}

/* Rotations and memory of cells made without a parent. */
static void sbi_live_forget(sb_body *body, const sb_mesh_change *out)
{
    int forgot = 0;
    for (int i = 0; i < out->made_cell_count; i++)
        if (out->made_parents[i] < 0) {
            sbi_assembly_forget_cell(&body->assembly, out->made_cells[i], body->displacement);
            forgot = 1;
        }
    if (forgot)
        sbi_assembly_begin_step(&body->assembly, 0);
}

static void sbi_live_follow_all(sbi_live_following *work)
{
    const sb_mesh_change *out = work->out;
    sb_body *body = work->body;
    int supports = sbi_live_count_supports(work);
    sbi_live_leave_boxes(work);
    sbi_live_follow_nodes_of_body(work);
    sbi_live_follow_cells_of_body(work);
    sbi_domain_follow(&body->domain, out, body->reference);
    sbi_matrix_follow(&body->matrix, out);
    sbi_live_take_glue(body);
    sbi_assembly_follow(&body->assembly, &body->matrix, out);
    sbi_live_wake_nodes(work);
    sbi_live_label_changed(work);
    sbi_live_stiffen_glue(body);
    for (int k = 0; k < work->node_count; k++)
        if (work->lists->nodes[k] < body->domain.node_count)
            sbi_live_park_node(body, work->lists->nodes[k], work->lists->gone[k] > 0);
    body->support_used += sbi_live_count_supports(work) - supports;
    sbi_live_follow_masses(work);
    sbi_precond_follow(body->precond, &body->matrix, body->reference);
    body->pcg.row_count = body->domain.node_count;
    body->force_unit = body->assembly.energy_unit / sbi_body_size(body);
    body->force_current = 0;
    memset(&body->guard, 0, sizeof body->guard);
    body->pattern_version++;
    body->live->version++;
    sbi_kept_forget(body);
    sbi_live_forget(body, out);
    if (work->first >= 0)
        sbi_live_keep_momentum(body, out, &work->before);
}

SBI_API int sbi_live_follow(sb_body_change *change, const sbi_change_lists *lists, const sb_mesh_change *out,
                            sb_result *result, sb_error *error)
{
    sbi_live_following work;
    memset(&work, 0, sizeof work);
    work.body = change->body;
    work.change = change;
    work.lists = lists;
    work.out = out;
    work.old_nodes = work.body->domain.node_count;
    work.old_cells = work.body->domain.cell_count;
    if (!sbi_live_body_fits(work.body, change) || !sbi_live_change_fits(&work) ||
        !sbi_live_reserve(&work, result, error))
        return 0;
    if (*result == SB_OK)
        *result = sbi_live_ask_listeners(work.body, out, error);
    if (*result != SB_OK) {
        sbi_live_drop_pieces(work.body);
        return 1;
    }
    sbi_live_read_motions(&work);
    sbi_live_read_momentum(&work);
    sbi_live_follow_all(&work);
    if (!sbi_precond_follows(
            work.body->precond)) /* steps allocate nothing; without memory now the next one tries again */
        (void)sbi_body_settle_preconditioner(work.body, NULL);
    return 1;
}
