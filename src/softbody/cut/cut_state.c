/* cut_state: a cut as a part of its body's saved state, and in its recordings.
 *
 * Saved are the cut links, the cells of the pieces of each tet that has parted, and the strokes under way; what the
 * pieces are follows from the links, and what nodes are copies of from the cells. With toughness also what strokes owe,
 * and forces that wait for the next step. A recording has the calls. */
#include "cut_private.h"

#include <string.h>

#include "../base/bytes.h"

enum {
    SBI_CUT_STATE_VERSION = 4,
    SBI_CUT_LINK_BYTES = 5 * 4 + 8,
    SBI_CUT_LOST_BYTES = 3 * 4,
    SBI_CUT_SAMPLE_BYTES = 2 * 4 + 8 * 8,
    SBI_CUT_DEBT_BYTES = 3 * 4 + 9 * 8,
    SBI_CUT_PUSH_BYTES = 4 + 4 * 8
};

/* ---- numbers ---- */

static void sbi_cut_put_real(sbi_state_out *out, sb_real value) { sbi_part_put_reals(out, &value, 1); }

static sb_real sbi_cut_get_real(sbi_part_in *in)
{
    sb_real value;
    sbi_part_get_reals(in, &value, 1);
    return value;
}

/* ---- saving ---- */

/* What a cut has to be like to take the state of another. */
enum { SBI_CUT_MAKE = 8 };
static void sbi_cut_list_make(const sb_cut *cut, int make[SBI_CUT_MAKE])
{
    uint64_t hash = 0;
    for (int i = 0; i < 4 * cut->tet_count; i++)
        hash = sbi_hash_word(hash, (uint64_t)cut->tets[i]);
    make[0] = cut->lattice.intervals;
    make[1] = cut->tet_count;
    make[2] = cut->node_end;
    make[3] = cut->max_strokes;
    make[4] = sbi_int_of(hash & 0xFFFFFFFFu);
    make[5] = sbi_int_of(hash >> 32);
    make[6] = cut->glues;
    hash = sbi_hash_word(sbi_hash_word(0, sbi_real_bits(cut->beta)), sbi_real_bits(cut->least_piece));
    if (cut->toughness > 0)
        hash = sbi_hash_word(hash, sbi_real_bits(cut->toughness));
    make[7] = sbi_int_of(hash & 0xFFFFFFFFu);
}

static int sbi_cut_count_pieces(const sb_cut *cut, int tet)
{
    int count = 0;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
        count++;
    return count;
}

/* Which points of which tets were taken out. */
static void sbi_cut_save_lost(const sb_cut *cut, sbi_state_out *out)
{
    int count = 0;
    for (int tet = 0; tet < cut->tet_count; tet++)
        count += cut->links.lost[tet] != 0;
    sbi_part_put_int(out, count);
    for (int tet = 0; tet < cut->tet_count; tet++) {
        if (!cut->links.lost[tet])
            continue;
        sbi_part_put_int(out, tet);
        sbi_part_put_int(out, sbi_int_of(cut->links.lost[tet] & 0xFFFFFFFFu));
        sbi_part_put_int(out, sbi_int_of(cut->links.lost[tet] >> 32));
    }
}

static void sbi_cut_save_pieces(const sb_cut *cut, sbi_state_out *out)
{
    int parted = 0;
    for (int tet = 0; tet < cut->tet_count; tet++)
        parted += !sbi_cut_is_whole(cut, tet);
    sbi_part_put_int(out, parted);
    for (int tet = 0; tet < cut->tet_count; tet++) {
        if (sbi_cut_is_whole(cut, tet))
            continue;
        sbi_part_put_int(out, tet);
        sbi_part_put_int(out, sbi_cut_count_pieces(cut, tet));
        for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
            sbi_part_put_int(out, cut->pieces[piece].cell);
    }
}

static void sbi_cut_put_vector(sbi_state_out *out, sb_vec3 v)
{
    sbi_cut_put_real(out, v.x);
    sbi_cut_put_real(out, v.y);
    sbi_cut_put_real(out, v.z);
}

static void sbi_cut_save_debts(const sbi_cut_debts *debts, sbi_state_out *out)
{
    sbi_part_put_int(out, debts->count);
    for (int i = 0; i < debts->count; i++) {
        const sbi_cut_debt *debt = debts->items + i;
        sbi_part_put_int(out, debt->tet);
        sbi_part_put_int(out, debt->sides[0]);
        sbi_part_put_int(out, debt->sides[1]);
        sbi_part_put_reals(out, debt->at, 4);
        sbi_cut_put_real(out, debt->area);
        sbi_cut_put_real(out, debt->way);
        sbi_cut_put_vector(out, debt->place);
    }
}

/* What a cut with toughness has besides. */
static void sbi_cut_save_force(const sb_cut *cut, sbi_state_out *out)
{
    const sbi_live *live = cut->body->live;
    for (int i = 0; i < cut->max_strokes; i++)
        sbi_cut_save_debts(&cut->strokes[i].debts, out);
    sbi_part_put_int(out, live->push_count);
    for (int i = 0; i < live->push_count; i++) {
        sbi_part_put_int(out, live->pushes[i].node);
        sbi_cut_put_vector(out, live->pushes[i].force);
        sbi_cut_put_real(out, live->pushes[i].stiffness);
    }
}

static void sbi_cut_save_stroke(const sbi_cut_stroke *stroke, sbi_state_out *out)
{
    sbi_part_put_int(out, stroke->edge_count);
    sbi_part_put_int(out, stroke->sample_count);
    for (int i = 0; i < stroke->sample_count; i++) {
        const sbi_cut_sample *sample = stroke->samples + i;
        sbi_part_put_int(out, sample->side);
        sbi_cut_put_real(out, sample->along);
        sbi_part_put_int(out, sample->tet);
        sbi_part_put_reals(out, sample->at, 4);
        sbi_cut_put_vector(out, sample->place);
    }
}

static void sbi_cut_save(const void *user, sbi_state_out *out)
{
    const sb_cut *cut = (const sb_cut *)user;
    int make[SBI_CUT_MAKE];
    sbi_cut_list_make(cut, make);
    for (int i = 0; i < SBI_CUT_MAKE; i++)
        sbi_part_put_int(out, make[i]);
    sbi_part_put_int(out, cut->stale);
    if (cut->stale)
        return;
    sbi_part_put_int(out, cut->links.count);
    for (int i = 0; i < cut->links.count; i++) {
        const sbi_cut_link *link = cut->links.items + i;
        for (int k = 0; k < 4; k++)
            sbi_part_put_int(out, link->key.at[k]);
        sbi_part_put_int(out, link->state | link->charred << 8);
        sbi_cut_put_real(out, link->t);
    }
    sbi_cut_save_lost(cut, out);
    sbi_cut_save_pieces(cut, out);
    sbi_part_put_int(out, cut->glue_count);
    for (int i = 0; i < cut->glue_count; i++) {
        sbi_part_put_int(out, cut->glue[i].tet);
        sbi_part_put_int(out, cut->glue[i].place);
    }
    for (int i = 0; i < cut->max_strokes; i++)
        sbi_cut_save_stroke(cut->strokes + i, out);
    if (cut->toughness > 0)
        sbi_cut_save_force(cut, out);
}

/* ---- checking: links and cells are read into cut->loaded ---- */

static sb_result sbi_cut_damaged(const char *what, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_FORMAT, "the saved cut is damaged in its %s", what);
}

static sb_result sbi_cut_check_make(const sb_cut *cut, sbi_part_in *in, sb_error *error)
{
    int make[SBI_CUT_MAKE], same = 1;
    sbi_cut_list_make(cut, make);
    for (int i = 0; i < SBI_CUT_MAKE; i++)
        same &= sbi_part_get_int(in) == make[i];
    if (!same || in->bad)
        return sbi_fail(error, SB_ERROR_STATE,
                        "the state was saved with a cut of another mesh, lattice, front or number of strokes");
    return SB_OK;
}

/* Room for the links of the image besides those that there are. */
static int sbi_cut_reserve_loaded(sb_cut *cut, int count)
{
    sbi_cut_links *links = &cut->loaded_links, old = *links;
    int capacity = sbi_max_int(count, cut->links.capacity);
    sbi_cut_link *items;
    int *table;
    links->count = 0;
    if (!links->lost)
        links->lost = (uint64_t *)sbi_alloc(&cut->allocator, (size_t)cut->tet_count, sizeof *links->lost);
    if (!links->lost)
        return 0;
    if (capacity > links->capacity) {
        items = (sbi_cut_link *)sbi_alloc(&cut->allocator, (size_t)capacity, sizeof *items);
        table = (int *)sbi_alloc(&cut->allocator, (size_t)sbi_cut_links_table(capacity), sizeof *table);
        if (!items || !table) {
            sbi_free(&cut->allocator, items);
            sbi_free(&cut->allocator, table);
            return 0;
        }
        sbi_cut_links_move(links, items, table, capacity);
        sbi_free(&cut->allocator, old.items);
        sbi_free(&cut->allocator, old.table);
    }
    sbi_cut_links_move(links, links->items, links->table, links->capacity); /* clears the table */
    return 1;
}

static sb_result sbi_cut_check_links(sb_cut *cut, sbi_part_in *in, sb_error *error)
{
    int count = sbi_part_get_count(in, SBI_CUT_LINK_BYTES);
    if (!sbi_cut_reserve_loaded(cut, count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d links of a saved cut", count);
    for (int i = 0; i < count; i++) {
        sbi_link_key key;
        int state, charred, ends;
        sb_real t;
        for (int k = 0; k < 4; k++)
            key.at[k] = sbi_part_get_int(in);
        state = sbi_part_get_int(in);
        charred = state == (SBI_LINK_CUT | 1 << 8);
        state = charred ? SBI_LINK_CUT : state;
        t = sbi_cut_get_real(in);
        ends = key.at[1] < 0 ? cut->tet_count : cut->node_end;
        if (in->bad || (state != SBI_LINK_CUT && state != SBI_LINK_PREDICTED) || !(t >= 0) || !(t <= 1) ||
            key.at[0] < 0 || key.at[0] >= ends || key.at[1] < -1 || key.at[1] >= cut->node_end || key.at[2] < -1 ||
            key.at[2] >= cut->node_end || sbi_cut_links_find(&cut->loaded_links, &key) >= 0)
            return sbi_cut_damaged("links", error);
        sbi_cut_links_add(&cut->loaded_links, &key, t, state);
        cut->loaded_links.items[i].charred = (short)charred;
    }
    return in->bad ? sbi_cut_damaged("links", error) : SB_OK;
}

/* loaded_links.lost: what was taken out. */
static sb_result sbi_cut_check_lost(sb_cut *cut, sbi_part_in *in, sb_error *error)
{
    int count = sbi_part_get_count(in, SBI_CUT_LOST_BYTES), last = -1;
    uint64_t all = sbi_lattice_all(&cut->lattice);
    memset(cut->loaded_links.lost, 0, (size_t)cut->tet_count * sizeof(uint64_t));
    for (int i = 0; i < count; i++) {
        int tet = sbi_part_get_int(in);
        uint64_t lost = (uint64_t)sbi_part_get(in, 4);
        lost |= sbi_part_get(in, 4) << 32;
        if (in->bad || tet <= last || tet >= cut->tet_count || !lost || (lost & ~all))
            return sbi_cut_damaged("holes", error);
        cut->loaded_links.lost[tet] = lost;
        last = tet;
    }
    return in->bad ? sbi_cut_damaged("holes", error) : SB_OK;
}

/* 1 when no whole link goes from what was taken out to something else. */
static int sbi_cut_holes_end(const sbi_parted *parted)
{
    int end = 1;
    for (int l = 0; l < parted->lattice->link_count && end && parted->lost; l++) {
        const unsigned char *ends = parted->lattice->links[l];
        end = parted->cut[l] != SBI_LINK_WHOLE || (parted->lost >> ends[0] & 1) == (parted->lost >> ends[1] & 1);
    }
    return end;
}

/* Whether a cell of the body can be a piece of a tet with these points: it has the tet's own nodes where it has the
 * material at them, and no other nodes of the uncut mesh. */
static int sbi_cut_cell_fits(const sb_cut *cut, const sb_body *body, int tet, int cell, uint64_t points)
{
    const int *nodes, *own = sbi_cut_tet_nodes(cut, tet);
    if (!sb_body_cell_in_use(body, cell) || cut->loaded_elements.items[cell] >= 0)
        return 0;
    nodes = sb_body_cell_nodes(body, cell);
    for (int a = 0; a < cut->nodes_per_tet; a++)
        if (nodes[a] != own[a] && ((points >> a & 1) || nodes[a] < cut->node_end))
            return 0;
    cut->loaded_elements.items[cell] = tet;
    return 1;
}

/* The cells of a tet's pieces; those of one that is whole are not in the image. is_last: it may have the empty cell
 * that a body without material has. */
static sb_result sbi_cut_check_tet(sb_cut *cut, const sb_body *body, int tet, int is_parted, int is_last,
                                   sbi_part_in *in, sb_error *error)
{
    sbi_parted parted;
    int count = is_parted ? sbi_part_get_int(in) : 1;
    sbi_parted_make(&cut->lattice, &cut->loaded_links, cut->tets + 4 * (size_t)tet, tet, &parted);
    if ((count != parted.piece_count && !(is_last && count == 1 && parted.piece_count == 0)) ||
        is_parted != (parted.piece_count > 1 || parted.lost) || !sbi_cut_holes_end(&parted))
        return sbi_cut_damaged("pieces", error);
    if (!sbi_cut_list_grow(cut, &cut->loaded_cells, count + 2))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a saved cut");
    for (int k = 0; k < count; k++) {
        int cell = is_parted ? sbi_part_get_int(in) : cut->cells_at_first[tet];
        if (!sbi_cut_cell_fits(cut, body, tet, cell, parted.piece_count ? parted.pieces[k] : 0))
            return sbi_cut_damaged("pieces", error);
        cut->loaded_cells.items[cut->loaded_cells.count++] = cell;
    }
    return SB_OK;
}

/* loaded_cells: the cells of all tets, in their order. */
static sb_result sbi_cut_check_pieces(sb_cut *cut, const sb_body *body, sbi_part_in *in, sb_error *error)
{
    int parted = sbi_part_get_count(in, 2 * 4), next = parted > 0 ? sbi_part_get_int(in) : -1, cells = 0;
    int end = sb_body_element_count(body), slots = cut->tet_count;
    sb_result result = SB_OK;
    cut->loaded_cells.count = cut->loaded_elements.count = 0;
    if (!sbi_cut_list_grow(cut, &cut->loaded_elements, end) ||
        !sbi_cut_list_grow(cut, &cut->origins, sb_body_node_count(body) - cut->origins.count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the cells of a saved cut");
    for (int e = 0; e < end; e++) {
        cut->loaded_elements.items[e] = -1;
        cells += sb_body_cell_in_use(body, e);
    }
    cut->loaded_elements.count = end;
    for (int tet = 0; tet < cut->tet_count && result == SB_OK; tet++) {
        int before = cut->loaded_cells.count;
        result = sbi_cut_check_tet(cut, body, tet, tet == next, cells == 1, in, error);
        slots += sbi_max_int(cut->loaded_cells.count - before - 1, 0);
        if (tet == next)
            next = --parted > 0 ? sbi_part_get_int(in) : -1;
    }
    if (result == SB_OK && (in->bad || parted > 0 || cut->loaded_cells.count != cells))
        result = sbi_cut_damaged("pieces", error);
    if (result == SB_OK) {
        void *pieces = cut->pieces;
        int grown = sbi_cut_grow(&cut->allocator, &pieces, &cut->piece_capacity, cut->piece_count,
                                 slots - cut->piece_count, sizeof *cut->pieces);
        cut->pieces = (sbi_cut_piece *)pieces;
        if (!grown)
            result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a saved cut");
    }
    return result;
}

/* next_glue: what is glued, by tet and place. */
static sb_result sbi_cut_check_glue(sb_cut *cut, sbi_part_in *in, sb_error *error)
{
    int count = sbi_part_get_count(in, 2 * 4), most = SBI_LIPS * cut->lattice.micro_count;
    if (!sbi_cut_reserve_glue(cut, count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the glue of a saved cut");
    cut->loaded_glue_count = count;
    for (int i = 0; i < count; i++) {
        sbi_cut_glued *item = cut->next_glue + i;
        item->tet = sbi_part_get_int(in);
        item->place = sbi_part_get_int(in);
        if (in->bad || item->tet < 0 || item->tet >= cut->tet_count || item->place < 0 || item->place >= most ||
            (i > 0 && (item[-1].tet > item->tet || (item[-1].tet == item->tet && item[-1].place >= item->place))))
            return sbi_cut_damaged("glue", error);
    }
    return in->bad ? sbi_cut_damaged("glue", error) : SB_OK;
}

static sb_vec3 sbi_cut_get_vector(sbi_part_in *in)
{
    sb_real x = sbi_cut_get_real(in), y = sbi_cut_get_real(in);
    return sb_v3(x, y, sbi_cut_get_real(in));
}

static sbi_cut_sample sbi_cut_get_sample(sbi_part_in *in)
{
    sbi_cut_sample sample;
    sample.side = sbi_part_get_int(in);
    sample.along = sbi_cut_get_real(in);
    sample.tet = sbi_part_get_int(in);
    sbi_part_get_reals(in, sample.at, 4);
    sample.place = sbi_cut_get_vector(in);
    return sample;
}

/* Room for a stroke of the image; what there is stays. */
static sb_result sbi_cut_check_stroke(sb_cut *cut, sbi_cut_stroke *stroke, sbi_part_in *in, sb_error *error)
{
    int corners = sbi_part_get_int(in), count = sbi_part_get_count(in, SBI_CUT_SAMPLE_BYTES), side = 0;
    if (in->bad || corners < 0 || corners == 1 || corners > count || (count > 0 && !corners))
        return sbi_cut_damaged("strokes", error);
    if (!sbi_cut_stroke_reserve(cut, stroke, count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a stroke of a saved cut");
    for (int i = 0; i < count; i++) {
        sbi_cut_sample sample = sbi_cut_get_sample(in);
        in->bad |= sample.side < side || sample.side > corners - 2 || !(sample.along >= 0) || !(sample.along <= 1) ||
                   sample.tet < -1 || sample.tet >= cut->tet_count;
        side = sample.side;
    }
    return in->bad ? sbi_cut_damaged("strokes", error) : SB_OK;
}

static sbi_cut_debt sbi_cut_get_debt(sbi_part_in *in)
{
    sbi_cut_debt debt;
    debt.tet = sbi_part_get_int(in);
    debt.sides[0] = sbi_part_get_int(in);
    debt.sides[1] = sbi_part_get_int(in);
    sbi_part_get_reals(in, debt.at, 4);
    debt.area = sbi_cut_get_real(in);
    debt.way = sbi_cut_get_real(in);
    debt.place = sbi_cut_get_vector(in);
    return debt;
}

/* Room for what a stroke of the image owes; what there is stays. */
static sb_result sbi_cut_check_debts(const sb_cut *cut, sbi_cut_stroke *stroke, sbi_part_in *in, sb_error *error)
{
    int count = sbi_part_get_count(in, SBI_CUT_DEBT_BYTES), points = cut->lattice.point_count;
    if (!sbi_cut_reserve_debts(cut, stroke, count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the forces of a saved cut");
    for (int i = 0; i < count; i++) {
        sbi_cut_debt debt = sbi_cut_get_debt(in);
        in->bad |= debt.tet < 0 || debt.tet >= cut->tet_count || debt.sides[0] < 0 || debt.sides[0] >= points ||
                   debt.sides[1] < 0 || debt.sides[1] >= points || !(debt.area >= 0) || !(debt.way > 0);
    }
    return in->bad ? sbi_cut_damaged("forces", error) : SB_OK;
}

static sb_result sbi_cut_check_force(const sb_cut *cut, const sb_body *body, sbi_part_in *in, sb_error *error)
{
    sb_result result = SB_OK;
    int count;
    for (int i = 0; i < cut->max_strokes && result == SB_OK; i++)
        result = sbi_cut_check_debts(cut, cut->strokes + i, in, error);
    if (result != SB_OK)
        return result;
    count = sbi_part_get_count(in, SBI_CUT_PUSH_BYTES);
    if (!sbi_live_reserve_pushes(cut->body, count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the forces of a saved cut");
    for (int i = 0; i < count; i++) {
        int node = sbi_part_get_int(in);
        (void)sbi_cut_get_vector(in);
        in->bad |= node < 0 || node >= sb_body_node_count(body) || !(sbi_cut_get_real(in) >= 0);
    }
    return in->bad ? sbi_cut_damaged("forces", error) : SB_OK;
}

static sb_result sbi_cut_check_state(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                     sb_error *error)
{
    sb_cut *cut = (sb_cut *)user;
    sbi_part_in in = sbi_part_read(bytes, size);
    sb_result result;
    int stale;
    result = sbi_cut_check_make(cut, &in, error);
    stale = sbi_part_get_int(&in);
    if (result == SB_OK && !stale) {
        result = sbi_cut_check_links(cut, &in, error);
        if (result == SB_OK)
            result = sbi_cut_check_lost(cut, &in, error);
        if (result == SB_OK)
            result = sbi_cut_check_pieces(cut, body, &in, error);
        if (result == SB_OK)
            result = sbi_cut_check_glue(cut, &in, error);
        for (int i = 0; i < cut->max_strokes && result == SB_OK; i++)
            result = sbi_cut_check_stroke(cut, cut->strokes + i, &in, error);
        if (result == SB_OK && cut->toughness > 0)
            result = sbi_cut_check_force(cut, body, &in, error);
    }
    if (result == SB_OK && (in.bad || in.left > 0))
        result = sbi_cut_damaged("length", error);
    return result;
}

/* ---- loading what was checked ---- */

static void sbi_cut_load_pieces(sb_cut *cut)
{
    const int *cell = cut->loaded_cells.items;
    const int *end = cell + cut->loaded_cells.count;
    cut->piece_count = cut->tet_count;
    cut->free_piece = -1;
    for (int tet = 0; tet < cut->tet_count; tet++) {
        sbi_parted parted;
        int piece = tet;
        sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
        cut->pieces[tet].cell = cut->pieces[tet].next = -1;
        for (int k = 0; k < parted.piece_count; k++) {
            cut->pieces[piece].points = parted.pieces[k];
            cut->pieces[piece].cell = *cell++;
            cut->pieces[piece].crumb = 0;
            cut->pieces[piece].next = k + 1 < parted.piece_count ? cut->piece_count++ : -1;
            piece = cut->pieces[piece].next;
        }
    }
    if (cell < end) { /* the empty one */
        int tet = cut->elements.items[*cell];
        cut->pieces[tet].points = 0;
        cut->pieces[tet].cell = *cell;
        cut->pieces[tet].crumb = 0;
    }
}

/* Nodes are copies of what their cells' corners were. */
static void sbi_cut_load_origins(sb_cut *cut)
{
    cut->origins.count = 0;
    sbi_cut_list_set(&cut->origins, sb_body_node_count(cut->body) - 1, -1);
    for (int i = 0; i < cut->node_end; i++)
        cut->origins.items[i] = i;
    for (int tet = 0; tet < cut->tet_count; tet++)
        for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next) {
            const int *nodes = sbi_cut_piece_nodes(cut, piece), *own = sbi_cut_tet_nodes(cut, tet);
            for (int a = 0; a < cut->nodes_per_tet; a++)
                cut->origins.items[nodes[a]] = own[a];
        }
}

static void sbi_cut_load_stroke(sbi_cut_stroke *stroke, sbi_part_in *in)
{
    stroke->edge_count = sbi_part_get_int(in);
    stroke->sample_count = sbi_part_get_int(in);
    for (int i = 0; i < stroke->sample_count; i++)
        stroke->samples[i] = sbi_cut_get_sample(in);
}

static void sbi_cut_load_force(const sb_cut *cut, sbi_part_in *in)
{
    for (int i = 0; i < cut->max_strokes; i++) {
        sbi_cut_debts *debts = &cut->strokes[i].debts;
        debts->count = sbi_part_get_int(in);
        for (int k = 0; k < debts->count; k++)
            debts->items[k] = sbi_cut_get_debt(in);
    }
    for (int count = sbi_part_get_int(in); count > 0; count--) {
        int node = sbi_part_get_int(in);
        sb_vec3 force = sbi_cut_get_vector(in);
        sbi_live_push(cut->body, node, force, sbi_cut_get_real(in));
    }
}

/* Steps over links, holes, pieces and glue, which are in cut->loaded and next_glue. */
static void sbi_cut_skip_to_strokes(sbi_part_in *in)
{
    int count = sbi_part_get_int(in);
    in->bytes += (size_t)count * SBI_CUT_LINK_BYTES;
    in->left -= (size_t)count * SBI_CUT_LINK_BYTES;
    count = sbi_part_get_int(in);
    in->bytes += (size_t)count * SBI_CUT_LOST_BYTES;
    in->left -= (size_t)count * SBI_CUT_LOST_BYTES;
    for (count = sbi_part_get_int(in); count > 0; count--) {
        (void)sbi_part_get_int(in);
        for (int k = sbi_part_get_int(in); k > 0; k--)
            (void)sbi_part_get_int(in);
    }
    for (count = 2 * sbi_part_get_int(in); count > 0; count--)
        (void)sbi_part_get_int(in);
}

static void sbi_cut_load(void *user, const unsigned char *bytes, size_t size)
{
    sb_cut *cut = (sb_cut *)user;
    sbi_cut_links links = cut->links;
    sbi_cut_list elements = cut->elements;
    sbi_part_in in = sbi_part_read(bytes, size);
    for (int i = 0; i < SBI_CUT_MAKE; i++)
        (void)sbi_part_get_int(&in);
    cut->stale = sbi_part_get_int(&in) != 0;
    sbi_cut_lend_finder(cut);
    if (cut->stale)
        return;
    cut->links = cut->loaded_links, cut->loaded_links = links;
    cut->elements = cut->loaded_elements, cut->loaded_elements = elements;
    sbi_cut_load_pieces(cut);
    sbi_cut_load_origins(cut);
    cut->next_glue_count = cut->loaded_glue_count;
    sbi_cut_take_next_glue(cut);
    sbi_cut_skip_to_strokes(&in);
    for (int i = 0; i < cut->max_strokes; i++)
        sbi_cut_load_stroke(cut->strokes + i, &in);
    if (cut->toughness > 0)
        sbi_cut_load_force(cut, &in);
}

/* ---- recording ---- */

static sb_result sbi_cut_replay_tear(sb_cut *cut, const int *ints, sb_error *error)
{
    sb_tear_options options = sb_default_tear_options();
    options.nucleate = ints[1];
    options.max_tears = ints[2];
    return sb_cut_tear(cut, &options, NULL, error);
}

static sb_result sbi_cut_replay(void *user, const int *ints, size_t int_count, const sb_real *reals, size_t real_count,
                                sb_error *error)
{
    sb_cut *cut = (sb_cut *)user;
    const sb_vec3 *points = (const sb_vec3 *)(const void *)reals;
    int stroke, is_known = int_count == 2 && real_count % 3 == 0 && real_count < INT32_MAX;
    int count = is_known ? (int)(real_count / 3) : 0, command = is_known ? ints[0] : 0;
    if (int_count == 3 && ints[0] == SBI_CUT_TEAR)
        return sbi_cut_replay_tear(cut, ints, error);
    if (command == SBI_CUT_TRIANGLES && count % 3 == 0)
        return sb_cut_triangles(cut, points, count / 3, NULL, error);
    if (command == SBI_CUT_BEGIN) {
        sb_result result = sb_cut_begin(cut, points, count, &stroke, error);
        if (result == SB_OK && stroke != ints[1])
            result =
                sbi_fail(error, SB_ERROR_STATE, "stroke %d begins where the recording has number %d", stroke, ints[1]);
        return result;
    }
    if (command == SBI_CUT_MOVE && ints[1] >= 0 && ints[1] < cut->max_strokes && count > 0 &&
        cut->strokes[ints[1]].edge_count == count)
        return sb_cut_move(cut, ints[1], points, NULL, error);
    if (command == SBI_CUT_ABLATE && count == 2)
        return sb_cut_ablate(cut, points[0], points[1].x, NULL, error);
    if (command == SBI_CUT_SCISSORS && count == 3) {
        sb_vec3 tips[2];
        tips[0] = points[0];
        tips[1] = points[2];
        return sb_cut_scissors(cut, ints[1], points[1], tips, NULL, error);
    }
    if (command == SBI_CUT_END && count == 0) {
        sb_cut_end(cut, ints[1]);
        return SB_OK;
    }
    return sbi_fail(error, SB_ERROR_FORMAT, "a recorded cut is none");
}

/* ---- joining ---- */

SBI_API sb_result sbi_cut_join_state(sb_cut *cut, sb_error *error)
{
    sbi_state_part part;
    sb_result result;
    memset(&part, 0, sizeof part);
    memcpy(part.name, SBI_CUT_PART, sizeof SBI_CUT_PART);
    part.version = SBI_CUT_STATE_VERSION;
    part.user = cut;
    part.save = sbi_cut_save;
    part.check = sbi_cut_check_state;
    part.load = sbi_cut_load;
    part.replay = sbi_cut_replay;
    result = sbi_body_join(cut->body, &part, error);
    cut->joined = result == SB_OK;
    return result;
}

SBI_API void sbi_cut_leave_state(const sb_cut *cut)
{
    if (cut->joined && cut->body)
        sbi_body_leave(cut->body, SBI_CUT_PART);
}
