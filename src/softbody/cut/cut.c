/* cut: making what cuts a body. */
#include "cut.h"

#include <string.h>

#include "cut_private.h"

#define SBI_CUT_COOKIE 0xc07b1adeu

SB_API sb_cut_def sb_default_cut_def(void)
{
    sb_cut_def def;
    memset(&def, 0, sizeof def);
    def.lattice = 2;
    def.front = SB_CUT_LAG;
    def.glue = 10;
    def.least_piece = 1;
    def.max_strokes = 4;
    def.cookie = SBI_CUT_COOKIE;
    return def;
}

/* ---- the mesh before any cut ---- */

enum { SBI_CUT_MOST_STROKES = 1024 };

static sb_result sbi_cut_check_def(const sb_cut_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != SBI_CUT_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_cut_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.body is NULL: a cut needs a body");
    if (def->lattice != 1 && def->lattice != 2 && def->lattice != 4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.lattice is %d, it must be 1, 2 or 4", def->lattice);
    if (def->front != SB_CUT_LAG && def->front != SB_CUT_GLUE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.front is %d, which is none", (int)def->front);
    if (!sb_is_finite(def->glue) || !(def->glue > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.glue is %g, it must be > 0", (double)def->glue);
    if (!sb_is_finite(def->least_piece) || !(def->least_piece >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.least_piece is %g, it must be >= 0", (double)def->least_piece);
    if (!sb_is_finite(def->toughness) || !(def->toughness >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.toughness is %g, it must be >= 0", (double)def->toughness);
    if (def->max_strokes < 0 || def->max_strokes > SBI_CUT_MOST_STROKES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_strokes is %d, it must be in [0, %d]", def->max_strokes,
                        SBI_CUT_MOST_STROKES);
    if (!def->body->live)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the mesh of this body cannot change: its def.slack was 0");
    if (def->body->domain.element_type != SB_TET4 && def->body->domain.element_type != SB_TET10)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "elements of type %s cannot be cut, only tet4 and tet10",
                        sb_element_name(def->body->domain.element_type));
    for (int e = 0; e < sb_body_element_count(def->body); e++)
        if (sb_body_cell_in_use(def->body, e) && sb_body_cell_share(def->body, e) < 1)
            return sbi_fail_element(error, SB_ERROR_STATE, e, "cell %d is a piece of an element: the body is cut", e);
    result = sbi_domain_check_straight(&def->body->domain, def->body->reference, error);
    return result == SB_OK ? sbi_live_check_pieces(def->body, error) : result;
}

static void sbi_cut_measure_rest(sb_cut *cut)
{
    const sb_vec3 *x = sb_body_rest_positions(cut->body);
    sbi_cut_box box = sbi_cut_box_of(cut, x, SBI_CUT_ALL_PARTS);
    double sum = 0, volumes = 0;
    for (int tet = 0; tet < cut->tet_count; tet++) {
        double volume = (double)sbi_cut_tet_volume(cut, tet);
        volume = volume > 0 ? volume : -volume;
        volumes += volume;
        sum += sbi_dense_cbrt(6 * volume);
    }
    cut->rest_size = sbi_cut_size_of(&box);
    cut->element_size = (sb_real)(sum / (double)cut->tet_count);
    cut->least_volume = cut->least_piece * (sb_real)(volumes / (double)cut->tet_count);
}

/* Tets, their neighbours, and those around each node. */
static sb_result sbi_cut_take_mesh(sb_cut *cut, sb_error *error)
{
    const sb_body *body = cut->body;
    size_t cells = (size_t)sb_body_element_count(body), n = (size_t)body->domain.nodes_per_cell;
    sb_mesh mesh;
    sb_result result;
    memset(&mesh, 0, sizeof mesh);
    cut->node_end = sb_body_node_count(body);
    cut->nodes_per_tet = (int)n;
    cut->tets = (int *)sbi_alloc(&cut->allocator, cells, 4 * sizeof(int));
    cut->nodes = n == 4 ? cut->tets : (int *)sbi_alloc(&cut->allocator, cells, n * sizeof(int));
    cut->cells_at_first = (int *)sbi_alloc(&cut->allocator, cells, sizeof(int));
    if (!cut->tets || !cut->nodes || !cut->cells_at_first)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for cutting %d cells", sb_body_element_count(body));
    cut->uncut.nodes = cut->nodes;
    cut->uncut.cells = cut->cells_at_first;
    cut->uncut.node_end = cut->node_end;
    for (int e = 0; e < sb_body_element_count(body); e++)
        if (sb_body_cell_in_use(body, e)) {
            const int *nodes = sb_body_cell_nodes(body, e);
            memcpy(cut->nodes + n * (size_t)cut->tet_count, nodes, n * sizeof(int));
            memcpy(cut->tets + 4 * (size_t)cut->tet_count, nodes, 4 * sizeof(int));
            cut->cells_at_first[cut->tet_count++] = e;
        }
    cut->uncut.cell_count = cut->tet_count;
    mesh.element_type = body->domain.element_type;
    mesh.node_count = cut->node_end;
    mesh.nodes = body->reference;
    mesh.element_count = cut->tet_count;
    mesh.elements = cut->nodes;
    result = sb_mesh_neighbours(&mesh, &cut->allocator, &cut->neighbours, error);
    return result == SB_OK ? sb_mesh_node_elements(&mesh, &cut->allocator, &cut->node_tets, error) : result;
}

/* Tets around the node that has most. */
static int sbi_cut_most_around(const sb_cut *cut)
{
    int most = 0;
    for (int node = 0; node < cut->node_end; node++)
        most = sbi_max_int(most, cut->node_tets.offsets[node + 1] - cut->node_tets.offsets[node]);
    return most;
}

/* Links that a plane cuts for each cell that it adds (0.8, 3.1 and 12.5 of tet4, 1.0, 3.8 and 14.7 of a coarse tet10
 * beam, bench_cut's blade). */
static int sbi_cut_links_per_cell(const sb_cut *cut)
{
    static const int links[5] = {0, 1, 4, 0, 14};
    return links[cut->lattice.intervals];
}

/* Each tet is one piece. There is room for the pieces that the body has room for, their links, and what a frame of a
 * stroke parts. */
static int sbi_cut_take_pieces(sb_cut *cut)
{
    enum { FEW = 256 };
    const sb_body *body = cut->body;
    int cells = body->live->cells.capacity, more = cells - cut->tet_count;
    void *pieces = NULL, *records = NULL, *classes = NULL, *beyond = NULL;
    int taken = sbi_cut_grow(&cut->allocator, &pieces, &cut->piece_capacity, 0, cells, sizeof *cut->pieces) &&
                sbi_cut_reserve_blades(cut, FEW);
    taken = taken && sbi_cut_grow(&cut->allocator, &records, &cut->cell_capacity, 0, 4 * FEW, sizeof *cut->cells);
    taken = taken && sbi_cut_grow(&cut->allocator, &classes, &cut->class_capacity, 0, FEW, sizeof *cut->classes);
    taken = taken && sbi_cut_grow(&cut->allocator, &beyond, &cut->beyond_capacity, 0, body->node_capacity, 1);
    cut->beyond = (unsigned char *)beyond;
    cut->pieces = (sbi_cut_piece *)pieces;
    cut->cells = (sbi_cut_cell *)records;
    cut->classes = (sbi_cut_class *)classes;
    cut->tet_marks = (unsigned char *)sbi_alloc_zeroed(&cut->allocator, (size_t)cut->tet_count, 1);
    cut->node_marks = (unsigned char *)sbi_alloc_zeroed(&cut->allocator, (size_t)cut->node_end, 1);
    cut->cell_of = (int *)sbi_alloc_zeroed(&cut->allocator, (size_t)cut->tet_count, sizeof(int));
    cut->links.lost = (uint64_t *)sbi_alloc_zeroed(&cut->allocator, (size_t)cut->tet_count, sizeof(uint64_t));
    cut->is_near = (unsigned char *)sbi_alloc_zeroed(&cut->allocator, (size_t)cut->tet_count, 1);
    if (!taken || !cut->links.lost || !cut->is_near || !cut->tet_marks || !cut->node_marks || !cut->cell_of ||
        !sbi_cut_list_grow(cut, &cut->elements, cells) || !sbi_cut_list_grow(cut, &cut->origins, body->node_capacity) ||
        !sbi_cut_list_grow(cut, &cut->touched, cut->tet_count) || !sbi_cut_list_grow(cut, &cut->near, cut->tet_count) ||
        !sbi_cut_list_grow(cut, &cut->listed, cut->tet_count + 1) ||
        !sbi_cut_list_grow(cut, &cut->blade_hits, 4 * FEW) || !sbi_cut_list_grow(cut, &cut->struck, 8 * FEW) ||
        !sbi_cut_list_grow(cut, &cut->crossed, FEW) || !sbi_cut_list_grow(cut, &cut->flooded, 4 * FEW + more) ||
        !sbi_cut_list_grow(cut, &cut->around, sbi_cut_most_around(cut)) || !sbi_cut_reserve_hits(cut, 16 * FEW) ||
        !sbi_cut_list_grow(cut, &cut->roots, cut->nodes_per_tet * 4 * FEW))
        return 0;
    for (int e = 0; e < sb_body_element_count(body); e++)
        if (sb_body_cell_in_use(body, e)) {
            sbi_cut_piece *piece = cut->pieces + cut->piece_count;
            piece->points = sbi_lattice_all(&cut->lattice);
            piece->cell = e;
            piece->next = -1;
            piece->crumb = 0;
            sbi_cut_list_set(&cut->elements, e, cut->piece_count++);
        }
    for (int i = 0; i < cut->node_end; i++)
        sbi_cut_list_set(&cut->origins, i, i);
    return sbi_cut_reserve_links(cut, FEW + sbi_cut_links_per_cell(cut) * more);
}

/* ---- following the body ---- */

static void sbi_cut_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    sb_cut *cut = (sb_cut *)user;
    (void)body;
    (void)change;
    if (cut->changing)
        return;
    cut->stale = 1;
    sbi_cut_lend_finder(cut);
}

static void sbi_cut_body_ends(void *user) { ((sb_cut *)user)->body = NULL; }

static sb_result sbi_cut_listen(sb_cut *cut, sb_error *error)
{
    sb_body_listener listener;
    memset(&listener, 0, sizeof listener);
    listener.user = cut;
    listener.follow = sbi_cut_follow;
    listener.end = sbi_cut_body_ends;
    return sb_body_listen(cut->body, &listener, &cut->listener, error);
}

/* ---- creation ---- */

SB_API sb_result sb_cut_create(const sb_cut_def *def, sb_cut **cut, sb_error *error)
{
    sb_cut *made;
    sb_result result = sbi_cut_check_def(def, error);
    if (result != SB_OK)
        return result;
    if (!cut)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_create needs a place for the cut");
    made = (sb_cut *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a cut");
    made->allocator = def->allocator;
    made->body = def->body;
    made->listener = -1;
    made->glues = def->front == SB_CUT_GLUE;
    made->beta = def->glue;
    made->least_piece = def->least_piece;
    made->free_piece = -1;
    made->toughness = def->toughness;
    sbi_lattice_make(def->lattice, &made->lattice);
    result = sbi_cut_take_mesh(made, error);
    if (result == SB_OK)
        sbi_cut_measure_rest(made);
    if (result == SB_OK && !(sbi_cut_take_pieces(made) && sbi_cut_take_strokes(made, def->max_strokes) &&
                             sbi_cut_take_glue(made) && sbi_cut_take_force(made) && sbi_live_take_pieces(made->body)))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for cutting %d cells", made->tet_count);
    if (result == SB_OK)
        result = sbi_body_rehearse_preconditioner(made->body, error);
    if (result == SB_OK)
        result = sbi_cut_listen(made, error);
    if (result == SB_OK)
        result = sbi_cut_join_state(made, error);
    if (result != SB_OK) {
        sb_cut_destroy(made);
        return result;
    }
    sbi_cut_drop_finder(made->body);
    sbi_cut_lend_finder(made);
    *cut = made;
    return SB_OK;
}

SB_API void sb_cut_destroy(sb_cut *cut)
{
    sb_allocator allocator;
    if (!cut)
        return;
    allocator = cut->allocator;
    sbi_cut_leave_state(cut);
    if (cut->body && cut->listener >= 0)
        sb_body_unlisten(cut->body, cut->listener);
    if (cut->body && cut->body->live && cut->body->live->find_user == cut)
        sbi_cut_leave_finder(cut);
    sbi_cut_free_force(cut);
    sbi_cut_free_tears(cut);
    sbi_cut_free_strokes(cut);
    sb_index_table_free(&cut->neighbours);
    sb_index_lists_free(&cut->node_tets);
    if (cut->nodes != cut->tets)
        sbi_free(&allocator, cut->nodes);
    sbi_free(&allocator, cut->tets);
    sbi_free(&allocator, cut->cells_at_first);
    sbi_free(&allocator, cut->links.lost);
    sbi_free(&allocator, cut->loaded_links.lost);
    sbi_free(&allocator, cut->losses);
    sbi_free(&allocator, cut->receded);
    sbi_free(&allocator, cut->flooded.items);
    sbi_free(&allocator, cut->pieces);
    sbi_free(&allocator, cut->links.items);
    sbi_free(&allocator, cut->links.table);
    sbi_free(&allocator, cut->loaded_links.items);
    sbi_free(&allocator, cut->loaded_links.table);
    sbi_cut_free_glue(cut);
    sbi_free(&allocator, cut->struck.items);
    sbi_free(&allocator, cut->crossed.items);
    sbi_free(&allocator, cut->loaded_cells.items);
    sbi_free(&allocator, cut->loaded_elements.items);
    sbi_free(&allocator, cut->origins.items);
    sbi_free(&allocator, cut->elements.items);
    sbi_free(&allocator, cut->blades);
    sbi_free(&allocator, cut->tree.order);
    sbi_free(&allocator, cut->tree.boxes);
    sbi_free(&allocator, cut->blade_scratch);
    sbi_free(&allocator, cut->blade_codes);
    sbi_free(&allocator, cut->is_near);
    sbi_free(&allocator, cut->beyond);
    sbi_free(&allocator, cut->near.items);
    sbi_free(&allocator, cut->listed.items);
    sbi_free(&allocator, cut->blade_hits.items);
    sbi_free(&allocator, cut->hits);
    sbi_free(&allocator, cut->sorted_hits);
    sbi_free(&allocator, cut->around.items);
    sbi_free(&allocator, cut->tet_marks);
    sbi_free(&allocator, cut->node_marks);
    sbi_free(&allocator, cut->cell_of);
    sbi_free(&allocator, cut->touched.items);
    sbi_free(&allocator, cut->cells);
    sbi_free(&allocator, cut->roots.items);
    sbi_free(&allocator, cut->classes);
    sbi_free(&allocator, cut);
}

/* ---- readings ---- */

SB_API int sb_cut_node_origin(const sb_cut *cut, int node)
{
    if (!cut || !cut->body || cut->stale || !sb_body_node_in_use(cut->body, node))
        return -1;
    return cut->origins.items[node];
}

SB_API int sb_cut_cell_element(const sb_cut *cut, int cell)
{
    if (!cut || !cut->body || cut->stale || !sb_body_cell_in_use(cut->body, cell))
        return -1;
    return cut->elements.items[cell];
}
