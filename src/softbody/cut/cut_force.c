/* cut_force: what a blade feels of the tissue that it cuts, and the tissue of the blade.
 *
 * Freeing an area A of lips takes the work J_c A. A stretch of the blade that goes d_n across itself and d_t along
 * itself, past tissue that may move, too, feels against that, with xi = d_t / d_n and w d_n = A,
 *
 *     J_c w / (1 + xi^2) across itself and J_c w xi / (1 + xi^2) along itself
 *
 * (Atkins, Xu and Jeronimidis 2004): together J_c A / |d| against its way d. Each triangle that is freed is paid for
 * so, at its centroid, by the way past its lips of the part of the blade that is nearest there.
 * Triangles come one at a time, however slowly the blade moves. Paid for at once, forces would rise as frames get
 * shorter, without end; so each is paid for evenly while the blade goes on by part of an element: by less, the force is
 * J_c A over that way, by more J_c A over its own way, and the work is J_c A in the end.
 * The tissue feels the opposite in the next step, on both lips by the mass of their pieces, so that no crumb is thrown
 * off, and less as it keeps up with the blade (live_push.c). */
#include "cut_private.h"

#include <string.h>

/* The way of a blade past a triangle that this is paid for over: half a mean element. What is soft beside its toughness
 * would be dragged by that until it springs back, which takes work that is nobody's; there it is four times J_c / (3
 * mu), the length that it is dragged by, but two elements at most. Measured at J_c = 150 J/m^2, edges of 6 mm, Young's
 * modulus 40, 80, 160, 400 kPa: a blade that goes on feels 1.22, 1.11, 1.06, 1.02 times J_c w, with half an element
 * alone 1.8 at 40 kPa. */
static const sb_real sbi_cut_pay_way = (sb_real)0.5, sbi_cut_pay_drags = 4, sbi_cut_most_pay_way = 2;

/* Ways of a blade shorter than this do not make forces fall faster, in mean elements: what a step is solved to is no
 * longer anything beside such a stiffness. */
static const sb_real sbi_cut_least_way = (sb_real)1e-3;

enum { SBI_CUT_FREED = 1536 }; /* triangles of a call, and of a stroke, that there is room for from the start */

/* ---- memory ---- */

static int sbi_cut_grow_debts(const sb_cut *cut, sbi_cut_debts *debts, int more)
{
    void *items = debts->items;
    int grown = sbi_cut_grow(&cut->allocator, &items, &debts->capacity, debts->count, more, sizeof *debts->items);
    debts->items = (sbi_cut_debt *)items;
    return grown;
}

/* Each debt pushes the nodes of the cells on both sides. */
static int sbi_cut_reserve_pushes(const sb_cut *cut, int debts)
{
    int pushes = 2 * cut->nodes_per_tet;
    return debts < INT32_MAX / pushes && sbi_live_reserve_pushes(cut->body, pushes * debts);
}

SBI_API int sbi_cut_take_force(sb_cut *cut)
{
    int taken = 1;
    if (!(cut->toughness > 0))
        return 1;
    for (int i = 0; i < cut->max_strokes && taken; i++)
        taken = sbi_cut_grow_debts(cut, &cut->strokes[i].debts, SBI_CUT_FREED);
    return taken && sbi_cut_reserve_freed(cut, SBI_CUT_FREED) && sbi_cut_reserve_pushes(cut, SBI_CUT_FREED);
}

SBI_API int sbi_cut_reserve_freed(sb_cut *cut, int more)
{
    return !(cut->toughness > 0) || sbi_cut_grow_debts(cut, &cut->freed, more);
}

SBI_API int sbi_cut_reserve_debts(const sb_cut *cut, sbi_cut_stroke *stroke, int count)
{
    return sbi_cut_grow_debts(cut, &stroke->debts, count - stroke->debts.count) && sbi_cut_reserve_pushes(cut, count);
}

/* ---- debts ---- */

SBI_API void sbi_cut_add_freed(sb_cut *cut, const sbi_cut_seam *seam)
{
    const unsigned char *ends = cut->lattice.links[seam->link];
    sbi_cut_debt *debt;
    if (!(cut->toughness > 0) || !(seam->area > 0))
        return;
    debt = cut->freed.items + cut->freed.count++;
    debt->tet = seam->tet;
    debt->sides[0] = ends[0];
    debt->sides[1] = ends[1];
    for (int a = 0; a < 4; a++)
        debt->at[a] = seam->at[a];
    debt->area = seam->area;
    debt->way = 0; /* it and the place are found when its cells are made */
    debt->place = sb_v3(0, 0, 0);
    debt->place = sb_v3(0, 0, 0);
}

/* A triangle's two lips as cells hold them now. */
typedef struct sbi_cut_lips {
    const int *nodes[2]; /* of the cell on each side; NULL: it was taken out */
    int cell;            /* one of them */
    sb_real share[2];    /* of the force, by the material there; both 0: both were */
    sb_vec3 place;       /* where the force acts (m) */
} sbi_cut_lips;

static sbi_cut_lips sbi_cut_lips_of(const sb_cut *cut, const sbi_cut_debt *debt)
{
    const sb_body *body = cut->body;
    sbi_cut_lips lips;
    sb_real both, shape[SBI_CUT_NODES];
    sbi_cut_get_shape(cut, debt->at, shape);
    lips.place = sb_v3(0, 0, 0);
    lips.cell = -1;
    for (int side = 0; side < 2; side++) {
        int lost = (int)(cut->links.lost[debt->tet] >> debt->sides[side] & 1);
        int cell = lost ? -1 : cut->pieces[sbi_cut_piece_with(cut, debt->tet, debt->sides[side])].cell;
        lips.nodes[side] = sb_body_cell_nodes(body, cell);
        lips.cell = lips.nodes[side] ? cell : lips.cell;
        lips.share[side] = cell < 0 ? 0 : sb_body_cell_share(body, cell);
    }
    both = lips.share[0] + lips.share[1];
    for (int side = 0; side < 2; side++) {
        sb_real even = lips.nodes[1 - side] ? (sb_real)0.5 : 1; /* of pieces without volume */
        lips.share[side] = both > 0 ? lips.share[side] / both : lips.nodes[side] ? even : 0;
        for (int a = 0; a < cut->nodes_per_tet && lips.nodes[side]; a++)
            lips.place = sb_v3_madd(lips.place, lips.share[side] * shape[a], body->position[lips.nodes[side][a]]);
    }
    return lips;
}

/* ---- the blade's way ---- */

/* A sample's way in a move: see sbi_cut_make_strip. */
typedef struct sbi_cut_way {
    sb_vec3 from; /* where the material that it was in is now (m) */
    sb_vec3 past; /* its way from there: past the tissue (m) */
    sb_vec3 own;  /* its way in space (m) */
} sbi_cut_way;

static sbi_cut_way sbi_cut_sample_way(const sbi_cut_stroke *stroke, const sb_vec3 *strip, int sample)
{
    const sb_vec3 *quad = strip + 6 * (size_t)(sample > 0 ? sample - 1 : 0);
    sb_vec3 to = quad[sample > 0 ? 2 : 5];
    sbi_cut_way way;
    way.from = quad[sample > 0 ? 1 : 0];
    way.past = sb_v3_sub(to, way.from);
    way.own = sb_v3_sub(to, stroke->samples[sample].place);
    return way;
}

/* That of the sample that passes nearest to a place. */
static sbi_cut_way sbi_cut_way_near(const sbi_cut_stroke *stroke, const sb_vec3 *strip, sb_vec3 place)
{
    sbi_cut_way nearest;
    sb_real least = SB_REAL_MAX;
    memset(&nearest, 0, sizeof nearest);
    for (int i = 0; i < stroke->sample_count; i++) {
        sbi_cut_way way = sbi_cut_sample_way(stroke, strip, i);
        sb_vec3 to = sb_v3_sub(place, way.from);
        sb_real square = sb_v3_dot(way.past, way.past), distance;
        sb_real along = square > 0 ? sb_max(0, sb_min(1, sb_v3_dot(to, way.past) / square)) : 0;
        to = sb_v3_madd(to, -along, way.past);
        distance = sb_v3_dot(to, to);
        if (distance < least) {
            least = distance;
            nearest = way;
        }
    }
    return nearest;
}

/* ---- paying ---- */

/* The way of the blade past a triangle until this is paid for. */
static sb_real sbi_cut_way_to_pay(const sb_cut *cut, const sbi_cut_lips *lips)
{
    const sb_body *body = cut->body;
    sb_real drag = cut->toughness / (3 * body->materials[body->cell_material[lips->cell]].mu), h = cut->element_size;
    return sb_max(sbi_cut_pay_way * h, sb_min(sbi_cut_most_pay_way * h, sbi_cut_pay_drags * drag));
}

/* What the blade does for a triangle in this move: force (N) on the tissue at its lips. Returns the work (J). */
static sb_real sbi_cut_pay_debt(const sb_cut *cut, sbi_cut_debt *debt, sb_vec3 way, sb_vec3 *force)
{
    sb_real length = sb_v3_norm(way), paid;
    *force = sb_v3(0, 0, 0);
    if (!(length > 0))
        return 0;
    paid = length < debt->way ? debt->area * (length / debt->way) : debt->area;
    debt->area -= paid;
    debt->way -= length;
    *force = sb_v3_scale(cut->toughness * (paid / length) / length, way);
    return cut->toughness * paid;
}

/* The force on both lips, which falls as they keep up with the blade. */
static void sbi_cut_push(const sb_cut *cut, const sbi_cut_debt *debt, const sbi_cut_lips *lips, sb_vec3 force,
                         sb_vec3 way)
{
    sb_real least = sbi_cut_least_way * cut->element_size;
    sb_real stiffness = sb_v3_norm(force) / sb_max(sb_v3_norm(way), least), shape[SBI_CUT_NODES];
    sbi_cut_get_shape(cut, debt->at, shape);
    for (int side = 0; side < 2; side++)
        for (int a = 0; a < cut->nodes_per_tet && lips->share[side] > 0; a++) {
            sb_real share = lips->share[side] * shape[a];
            sbi_live_push(cut->body, lips->nodes[side][a], sb_v3_scale(share, force), sb_abs(share) * stiffness);
        }
}

/* Pays for a triangle what this move does of it. */
static void sbi_cut_pay_one(const sb_cut *cut, const sbi_cut_stroke *stroke, const sbi_cut_lips *lips, sb_vec3 way,
                            sbi_cut_debt *debt, sb_cut_info *info)
{
    sb_vec3 force;
    sb_real work = sbi_cut_pay_debt(cut, debt, way, &force);
    if (work > 0)
        sbi_cut_push(cut, debt, lips, force, way);
    info->work += work;
    info->force = sb_v3_sub(info->force, force);
    info->torque = sb_v3_sub(info->torque, sb_v3_cross(sb_v3_sub(lips->place, stroke->about), force));
}

SBI_API void sbi_cut_pay(const sb_cut *cut, sbi_cut_stroke *stroke, const sb_vec3 *strip, sb_cut_info *info)
{
    sbi_cut_debts *debts = &stroke->debts;
    int known = debts->count, kept = 0;
    for (int i = 0; i < cut->freed.count; i++)
        debts->items[debts->count++] = cut->freed.items[i];
    for (int i = 0; i < debts->count; i++) {
        sbi_cut_debt *debt = debts->items + i;
        sbi_cut_lips lips = sbi_cut_lips_of(cut, debt);
        sbi_cut_way nearest;
        if (lips.cell < 0)
            continue;
        nearest = sbi_cut_way_near(stroke, strip, lips.place);
        if (i >= known) { /* nobody knows where its lips were */
            debt->way = sbi_cut_way_to_pay(cut, &lips);
            debt->place = sb_v3_sub(lips.place, sb_v3_sub(nearest.own, nearest.past));
        }
        sbi_cut_pay_one(cut, stroke, &lips, sb_v3_sub(nearest.own, sb_v3_sub(lips.place, debt->place)), debt, info);
        debt->place = lips.place;
        if (!(debt->way > 0))
            continue;
        info->owed += cut->toughness * debt->area;
        debts->items[kept++] = *debt;
    }
    debts->count = kept;
}

SBI_API void sbi_cut_free_force(sb_cut *cut)
{
    for (int i = 0; i < cut->max_strokes; i++)
        sbi_free(&cut->allocator, cut->strokes[i].debts.items);
    sbi_free(&cut->allocator, cut->freed.items);
}
