/* live_sliver: rows that hold the mid nodes of small pieces of tet10.
 *
 * A quadratic on a small piece is nearly linear: what its mid nodes do beside the middle of their edges costs next to
 * nothing, and solvers need many iterations to find it. A mid node m of the edge p q whose cells have a share phi < 0.3
 * of material gets the energy k/2 |u_m - (u_p + u_q)/2|^2, k = 0.4 (1 - phi/0.3) (lambda + 2 mu) h phi with the edge
 * length h = (6 V)^(1/3) of its cells' mean volume V: nothing where the motion is affine. The factor phi matters: with
 * the others alone smaller pieces are held more firmly than they resist. Measured on a beam of 20 x 4 x 6 cubes, cut
 * half or all through at 0.03 to 0.7 of a cube: at most 3.0 times the uncut beam's iterations without the rows, 1.5
 * with 0.15 and 0.1 in place of 0.3 and 0.4, 1.25 with these; its tip moves by 0.14 % at most. Bodies that step
 * explicitly have none: they have nothing to solve, and rows would make their steps shorter. */
#include "live_private.h"

#include <string.h>

static const sb_real sbi_sliver_share = (sb_real)0.3; /* of material below which a node is held */
static const sb_real sbi_sliver_firmness = (sb_real)0.4;

/* What the cells of a node are, summed. */
typedef struct sbi_sliver_sums {
    int cells, pieces;
    sb_real volume, material, modulus; /* m^3, m^3, and int (lambda + 2 mu) over the whole cells (J) */
} sbi_sliver_sums;

static sbi_sliver_sums sbi_sliver_sum(const sb_body *body, int node)
{
    const sb_domain *domain = &body->domain;
    sbi_sliver_sums sums = {0, 0, 0, 0, 0};
    for (int at = sbi_live_first_cell(body, node); at >= 0; at = sbi_live_next_cell(body, node, at)) {
        int e = sbi_live_cell_of(body, at);
        const int *cell = domain->cells + (size_t)e * (size_t)domain->nodes_per_cell;
        const sb_material *material = body->materials + body->cell_material[e];
        sb_vec3 x[4];
        sb_real volume;
        for (int a = 0; a < 4; a++)
            x[a] = body->reference[cell[a]];
        volume = sbi_domain_tet_volume(x);
        sums.cells++;
        sums.pieces += sbi_live_is_piece(body, e);
        sums.volume += volume;
        sums.material += body->live->shares[e] * volume;
        sums.modulus += volume * (material->lambda + 2 * material->mu);
    }
    return sums;
}

/* Ends of the edge that a node is the middle of; 0: of none. */
static int sbi_sliver_ends(const sb_body *body, int node, int ends[2])
{
    int at = sbi_live_first_cell(body, node);
    const int *cell = body->domain.cells + 10 * (size_t)(at < 0 ? 0 : sbi_live_cell_of(body, at));
    for (int e = 0; e < 6 && at >= 0; e++) {
        int edge[3];
        sb_element_edge(SB_TET10, e, edge);
        if (cell[edge[2]] != node)
            continue;
        ends[0] = cell[edge[0]];
        ends[1] = cell[edge[1]];
        return 1;
    }
    return 0;
}

static int sbi_sliver_is_held(const sb_body *body, int node)
{
    int ends[2];
    sbi_sliver_sums sums = sbi_sliver_sum(body, node);
    return sums.pieces > 0 && sums.material > 0 && sums.material < sbi_sliver_share * sums.volume &&
           sbi_sliver_ends(body, node, ends);
}

static void sbi_sliver_layout(sbi_inner_rows *rows, sbi_arena *arena)
{
    size_t count = (size_t)rows->count;
    rows->weights = (sb_real *)sbi_arena_take(arena, 3 * count, sizeof(sb_real));
    rows->stiffness = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
    rows->start = (int *)sbi_arena_take(arena, count + 1, sizeof(int));
    rows->nodes = (int *)sbi_arena_take(arena, 3 * count, sizeof(int));
}

static void sbi_sliver_put(sbi_inner_rows *rows, int row, int node, const int ends[2])
{
    rows->start[row] = 3 * row;
    rows->nodes[3 * row] = node;
    rows->nodes[3 * row + 1] = ends[0];
    rows->nodes[3 * row + 2] = ends[1];
    rows->weights[3 * row] = 1;
    rows->weights[3 * row + 1] = rows->weights[3 * row + 2] = (sb_real)-0.5;
    rows->stiffness[row] = 0;
}

SBI_API sb_result sbi_live_make_slivers(sb_body *body, sb_error *error)
{
    sbi_inner_rows *rows = &body->live->slivers;
    sbi_arena arena = {NULL, 0, 0};
    int ends[2];
    if (!body->live->piece_count || body->domain.element_type != SB_TET10 || body->integrator == SB_CENTRAL_DIFFERENCE)
        return SB_OK;
    for (int i = 0; i < body->domain.node_count; i++)
        rows->count += sbi_sliver_is_held(body, i);
    if (!rows->count)
        return SB_OK;
    sbi_sliver_layout(rows, &arena);
    rows->memory = arena.overflow ? NULL : sbi_alloc(&body->allocator, arena.used, 1);
    if (!rows->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows that hold small pieces", rows->count);
    arena.base = (unsigned char *)rows->memory;
    arena.used = 0;
    sbi_sliver_layout(rows, &arena);
    for (int i = 0, row = 0; i < body->domain.node_count; i++)
        if (sbi_sliver_is_held(body, i) && sbi_sliver_ends(body, i, ends))
            sbi_sliver_put(rows, row++, i, ends);
    rows->start[rows->count] = 3 * rows->count;
    body->assembly.rows = rows;
    return SB_OK;
}

SBI_API void sbi_live_stiffen_slivers(sb_body *body)
{
    sbi_inner_rows *rows = &body->live->slivers;
    for (int row = 0; row < rows->count; row++) {
        sbi_sliver_sums sums = sbi_sliver_sum(body, rows->nodes[3 * row]);
        sb_real phi = sums.material / sums.volume, h = sb_cbrt(6 * sums.volume / (sb_real)sums.cells);
        rows->stiffness[row] =
            sbi_sliver_firmness * (1 - phi / sbi_sliver_share) * (sums.modulus / sums.volume) * h * phi;
    }
}
