/* needle_held: needles that the body holds by rows of weights, its mesh left as it is (NDL_EMBED): where each rod node
 * is on the way that the tip has cut, what the tissue does to it there, and how the tip goes on.
 *
 * A rod node in the tissue is at an arc of the track, which grows by what the node slips; that is all there is to
 * remember: how far the rod is past the tissue follows from where both are. The node before the first in the tissue has
 * a hold on its edge, where that goes in, so that forces do not jump when it follows. */
#include "needle_private.h"

#include <string.h>

/* ---- what a mesh does not show of the tissue about a needle ---- */

/* Of an element's edge: radius over which a mesh spreads a line of point loads. Measured in tet4 (0.56 to 0.70), in
 * others by what makes a needle in them as stiff as in fine tet4; quadratic ones have nodes at half of their edges. */
static double ndli_held_spread(sb_element_type type)
{
    switch (type) {
    case SB_TET4: return 0.58;
    case SB_HEX8: return 0.42;
    default: return 0.2;
    }
}

/* Least ratio of that radius to the needle's: with finer meshes the needle is held as if it were thinner. */
static const double ndli_held_least_ratio = 1.5;
static const double ndli_held_pi = 3.14159265358979323846;

typedef struct ndli_held_tissue {
    double shear, poisson; /* Pa */
    double ratio;          /* logarithm of the mesh's radius over the needle's */
} ndli_held_tissue;

static ndli_held_tissue ndli_held_get_tissue(const ndl_needle *needle, int element, const ndli_bed_row *row)
{
    const ndli_bed *bed = &needle->site->bed;
    sbi_body_modulus modulus = sbi_body_cell_modulus(bed->body, row->cell);
    double radius = ndli_held_spread(bed->mesh.element_type) * ndli_bed_edge(bed, element);
    ndli_held_tissue tissue;
    tissue.poisson = modulus.poisson;
    tissue.shear = modulus.young / (2 * (1 + tissue.poisson));
    tissue.ratio = log(fmax(radius / needle->radius, ndli_held_least_ratio));
    return tissue;
}

/* N/m per m of shaft: Kelvin's line load across and along, between the two radii. */
static double ndli_held_across(const ndli_held_tissue *t)
{
    return 8 * ndli_held_pi * t->shear * (1 - t->poisson) / ((3 - 4 * t->poisson) * t->ratio);
}
static double ndli_held_along(const ndli_held_tissue *t) { return 2 * ndli_held_pi * t->shear / t->ratio; }

/* N/m of the tip: a rigid disc that moves along its axis (Selvadurai 1976). */
static double ndli_held_tip(const ndl_needle *needle, const ndli_held_tissue *t)
{
    return 32 * (1 - t->poisson) / (3 - 4 * t->poisson) * t->shear * needle->radius;
}

NDLI_API double ndli_held_wave(double bending, double radius, double young, double guess)
{
    double wave = guess;
    for (int round = 0; round < 4; round++) {
        ndli_held_tissue t;
        t.poisson = 0.45; /* of soft tissue; it matters little */
        t.shear = young / (2 * (1 + t.poisson));
        t.ratio = log(fmax(wave / radius, ndli_held_least_ratio));
        wave = sqrt(sqrt(4 * bending / ndli_held_across(&t)));
    }
    return wave;
}

/* ---- holds ---- */

/* Where hold i is on the track (m at rest). */
static double ndli_held_arc(const ndl_needle *needle, int i) { return i < needle->line.first ? 0 : needle->arc[i]; }

static double ndli_held_edge(const ndl_rod *rod, int j) { return ndli_norm(ndli_sub(rod->x[j + 1], rod->x[j])); }

/* The material at an arc of the track, and how long the tissue is there along it, per length at rest. 0: there is none:
 * it has been taken away, or the tip had come out through a hole in the far side. */
typedef struct ndli_held_spot {
    ndli_place place;
    ndli_bed_row row;
    double stretch;
} ndli_held_spot;

static double ndli_held_stretch(const ndli_bed *bed, const ndli_held_spot *spot, ndli_v3 tangent)
{
    sb_mat3 f = ndli_bed_gradient(bed, &spot->place, &spot->row);
    double stretch = ndli_norm(ndli_from(sb_m3_apply(f, ndli_to(tangent))));
    return stretch > 0 && sb_m3_det(f) > 0 ? stretch : 1;
}

static int ndli_held_find(const ndl_needle *needle, double arc, ndli_held_spot *spot)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_track_point point = ndli_track_at(&needle->track, arc);
    spot->stretch = 1;
    if (!ndli_bed_find(bed, ndli_to(point.X), point.element, &spot->place, &spot->row))
        return 0;
    if (ndli_norm(point.tangent) > 0)
        spot->stretch = ndli_held_stretch(bed, spot, point.tangent);
    return 1;
}

static ndli_v3 ndli_held_tangent(const ndl_rod *rod, int i)
{
    ndli_v3 sum = ndli_add(rod->tangent[sbi_min_int(i, rod->node_count - 2)], rod->tangent[sbi_max_int(i - 1, 0)]);
    return ndli_scale(1 / ndli_norm(sum), sum);
}

static void ndli_held_add_friction(const ndl_friction *friction, double share, ndl_friction *sum)
{
    sum->friction += (sb_real)(share * (double)friction->friction);
    sum->viscous += (sb_real)(share * (double)friction->viscous);
    sum->cutting += (sb_real)(share * (double)friction->cutting);
    sum->twist_stiffness += (sb_real)(share * (double)friction->twist_stiffness);
    sum->twist_friction += (sb_real)(share * (double)friction->twist_friction);
}

/* What the tissue at a row has, of an element in several regions by their shares of its volume; zeros where it has
 * none. */
static ndl_friction ndli_held_friction(const ndl_needle *needle, const ndli_bed_row *row)
{
    const sb_body *body = needle->site->body;
    int parts = row->count ? sbi_body_part_count(body, row->cell) : 0;
    ndl_friction sum;
    memset(&sum, 0, sizeof sum);
    for (int k = 0; k < parts; k++) {
        const ndl_friction *friction = ndli_needle_friction(needle, sbi_body_cell_region(body, row->cell + k));
        if (friction)
            ndli_held_add_friction(friction, sbi_body_part_share(body, row->cell, k), &sum);
    }
    return sum;
}

/* How far the shaft may be ahead of the tissue before it slips (m). */
static double ndli_held_slack(const ndl_needle *needle, const ndli_held_spot *spot)
{
    ndl_friction friction = ndli_held_friction(needle, &spot->row);
    ndli_held_tissue tissue = ndli_held_get_tissue(needle, spot->place.element, &spot->row);
    return (double)friction.friction / ndli_held_along(&tissue);
}

/* How far before the first node the rod goes in (m): as far as that is on the track, and by what a tip is ahead of the
 * tissue that the shaft is not. */
static double ndli_held_reach(const ndl_needle *needle, double *stretch)
{
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first;
    ndli_held_spot spot;
    ndli_v3 ahead;
    double wound, slack;
    *stretch = 1;
    if (!ndli_held_find(needle, needle->arc[first], &spot))
        return needle->arc[first];
    ahead = ndli_sub(rod->x[first], ndli_bed_at(&needle->site->bed, &spot.row));
    wound = ndli_dot(ndli_held_tangent(rod, first), ahead);
    slack = ndli_held_slack(needle, &spot);
    *stretch = spot.stretch;
    return spot.stretch * needle->arc[first] + wound - fmin(fmax(wound, -slack), slack);
}

static void ndli_held_measure_entering(ndl_needle *needle)
{
    double stretch, reach = needle->line.count > 0 ? ndli_held_reach(needle, &stretch) : 0;
    needle->entering =
        needle->line.count > 0 ? fmin(fmax(reach, 0), ndli_held_edge(needle->rod, needle->line.first - 1)) : 0;
}

/* How far on the track a node may be that the next one is not to be passed by (m). */
static double ndli_held_most_arc(const ndl_needle *needle, int i)
{
    return needle->arc[i + 1] - 0.05 * needle->rod->rest_length[i];
}

/* Length of shaft in the tissue that counts with hold i: half of what is to either side. */
static double ndli_held_length(const ndl_needle *needle, int i)
{
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first;
    double sum = 0;
    if (i < first)
        return 0.5 * needle->entering;
    sum += i == first ? needle->entering : ndli_held_edge(rod, i - 1);
    sum += i + 1 < rod->node_count ? ndli_held_edge(rod, i) : 0;
    return 0.5 * sum;
}

static ndli_v3 ndli_held_place(const ndl_needle *needle, int i)
{
    const ndl_rod *rod = needle->rod;
    double share = needle->line.holds[i].share;
    return share > 0 ? ndli_madd(rod->x[i], share, ndli_sub(rod->x[i + 1], rod->x[i])) : rod->x[i];
}

/* Number of a body's node in the guest's list. */
static int ndli_held_number(struct ndli_site *site, int node)
{
    if (site->node_place[node] < 0) {
        site->node_place[node] = site->coupled_count;
        site->coupled[site->coupled_count++] = node;
    }
    return site->node_place[node];
}

static void ndli_held_tie(struct ndli_site *site, const ndli_bed_row *row, struct ndli_hold *hold)
{
    hold->count = row->count;
    for (int a = 0; a < row->count; a++) {
        hold->places[a] = ndli_held_number(site, row->nodes[a]);
        hold->weights[a] = row->weights[a];
    }
}

/* What a way is beyond what friction winds up (m). */
static double ndli_held_beyond(double way, double slack) { return way - fmin(fmax(way, -slack), slack); }

/* How far hold i is ahead of the material at an arc, beyond what friction winds up there (m). */
static double ndli_held_ahead(const ndl_needle *needle, int i, double arc)
{
    ndli_held_spot spot;
    ndli_v3 way;
    if (!ndli_held_find(needle, arc, &spot))
        return 0;
    way = ndli_sub(ndli_held_place(needle, i), ndli_bed_at(&needle->site->bed, &spot.row));
    return ndli_held_beyond(ndli_dot(ndli_held_tangent(needle->rod, i), way), ndli_held_slack(needle, &spot));
}

/* A slip of an inner hold by `slip` (m at rest) goes past where the shaft is: a cut is within it, which stands open,
 * and the shaft is between the lips. It stays at the one where it is held until it has come to the other. Held at each
 * in turn it would be pushed to and fro for ever. */
static int ndli_held_is_between_lips(const ndl_needle *needle, int i, double slip)
{
    double arc = fmin(fmax(needle->arc[i] + slip, 0), ndli_held_most_arc(needle, i));
    return slip != 0 && sbi_body_has_pieces(needle->site->body) && ndli_held_ahead(needle, i, arc) * slip < 0;
}

/* Slip that a hold cannot make: where the shaft goes in it stays at the skin, and where soft tissue is so much pressed
 * before the tip that more of the shaft would be past it than there is on the track, it stays behind the next. What it
 * is ahead of the tissue beyond what friction can wind up is then of steps before: taken for a slip of this one, and
 * again in each, viscosity made a force of it (0.2 N beyond friction and cutting were seen). */
static double ndli_held_overrun(const ndl_needle *needle, int i, const ndli_held_spot *spot, ndli_v3 tangent,
                                ndli_v3 offset)
{
    double wound = ndli_dot(tangent, offset), slack, room, ahead;
    if (i == ndli_line_foremost(&needle->line))
        return 0;
    slack = ndli_held_slack(needle, spot);
    ahead = ndli_held_beyond(wound, slack);
    if (i < needle->line.first || ndli_held_is_between_lips(needle, i, ahead / spot->stretch))
        return ahead;
    room = spot->stretch * fmax(0, ndli_held_most_arc(needle, i) - needle->arc[i]);
    return fmax(0, wound - slack - room);
}

/* N/m along hold i, `length` of shaft. */
static double ndli_held_stiffness(const ndl_needle *needle, int i, double length, const ndli_held_tissue *tissue)
{
    int is_tip = i == ndli_line_foremost(&needle->line);
    return length * ndli_held_along(tissue) + (is_tip ? ndli_held_tip(needle, tissue) : 0);
}

/* Hold i where it is now, `length` of shaft; *spot: where its material is. */
static void ndli_held_make(ndl_needle *needle, int i, double length, ndli_held_spot *spot)
{
    struct ndli_hold *hold = needle->line.holds + i;
    const ndl_rod *rod = needle->rod;
    ndli_held_tissue tissue;
    int is_tip = i == ndli_line_foremost(&needle->line), there = ndli_held_find(needle, ndli_held_arc(needle, i), spot);
    memset(hold, 0, sizeof *hold);
    if (i < needle->line.first)
        hold->share = 1 - needle->entering / ndli_held_edge(rod, i);
    hold->tangent = hold->share > 0 ? rod->tangent[i] : ndli_held_tangent(rod, i);
    needle->stretch[i] = spot->stretch;
    if (!there || !(length > 0 || is_tip))
        return;
    ndli_held_tie(needle->site, &spot->row, hold);
    hold->offset = ndli_sub(ndli_held_place(needle, i), ndli_bed_at(&needle->site->bed, &spot->row));
    tissue = ndli_held_get_tissue(needle, spot->place.element, &spot->row);
    hold->offset =
        ndli_madd(hold->offset, -ndli_held_overrun(needle, i, spot, hold->tangent, hold->offset), hold->tangent);
    hold->length = length;
    hold->across = length * ndli_held_across(&tissue);
    hold->along = ndli_held_stiffness(needle, i, length, &tissue);
}

NDLI_API void ndli_held_forget(struct ndli_site *site)
{
    for (int k = 0; k < site->coupled_count; k++)
        site->node_place[site->coupled[k]] = -1;
    site->coupled_count = 0;
}

/* ---- what the tissue does to a needle ---- */

static void ndli_held_resist_tip(ndl_needle *needle, const ndli_bed_row *row, double table)
{
    ndli_line *line = &needle->line;
    const ndli_bed *bed = &needle->site->bed;
    const ndli_track *track = &needle->track;
    ndli_track_point end = ndli_track_at(track, ndli_track_length(track));
    ndli_v3 ahead = ndli_madd(end.X, 0.2 * needle->site->mean_edge, needle->heading);
    ndli_place place;
    int last = ndli_line_foremost(line);
    if (!row->count) /* there is nothing in a hole */
        return;
    line->cutting = ndli_needle_cutting_at(needle, ndli_to(end.X), ndli_bed_region(bed, row), table);
    if (needle->hold_steps == 0 && ndli_bed_locate(bed, ndli_to(ahead), end.element, &place))
        return;
    needle->blocked = 1;
    line->cutting = (double)SB_REAL_MAX;
    if (line->state[last] == NDL_DYNAMIC_FORWARD)
        line->state[last] = NDL_STATIC;
}

NDLI_API void ndli_held_resist(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line), first = ndli_line_rearmost(line);
    line->cutting = 0;
    ndli_held_measure_entering(needle);
    for (int j = 0; j < sbi_min_int(first, rod->node_count - 1); j++)
        ndl_rod_set_grip(rod, j, 0, 0);
    for (int i = first; i <= last; i++) {
        double length = ndli_held_length(needle, i), edge;
        ndl_friction friction;
        ndli_held_spot spot;
        ndli_held_make(needle, i, length, &spot);
        friction = ndli_held_friction(needle, &spot.row);
        line->friction[i] = length * (double)friction.friction;
        line->viscous[i] = length * (double)friction.viscous;
        if (i == last) {
            ndli_held_resist_tip(needle, &spot.row, (double)friction.cutting);
            continue;
        }
        edge = i < line->first ? needle->entering : ndli_held_edge(rod, i);
        ndl_rod_set_grip(rod, i, (sb_real)(edge * (double)friction.twist_stiffness),
                         (sb_real)(edge * (double)friction.twist_friction));
    }
}

/* ---- the tip goes on ---- */

enum { NDLI_HELD_HOLD_STEPS = 8 };

static ndli_v3 ndli_held_unit(ndli_v3 v) { return ndli_scale(1 / ndli_norm(v), v); }

/* In space, of what is cut along the shaft's last edge to the material at `end`; heading where there is no such edge.
 */
static ndli_v3 ndli_held_chord(const ndl_needle *needle, ndli_v3 end, ndli_v3 heading)
{
    ndli_held_spot spot;
    ndli_v3 chord;
    int before = needle->rod->node_count - 2;
    if (before < needle->line.first || !ndli_held_find(needle, needle->arc[before], &spot))
        return heading;
    chord = ndli_sub(end, ndli_bed_at(&needle->site->bed, &spot.row));
    return ndli_dot(chord, heading) > 0 ? ndli_held_unit(chord) : heading;
}

/* The tip has nowhere to go: it is held for a while. */
static void ndli_held_block(ndl_needle *needle)
{
    needle->blocked = 1;
    needle->hold_steps = NDLI_HELD_HOLD_STEPS;
}

/* A point on the way, `ahead` (m at rest) of its end, or behind it. 0: before the skin. */
static int ndli_held_beside(const ndl_needle *needle, double ahead, ndli_track_point *point)
{
    const ndli_track *track = &needle->track;
    double length = ndli_track_length(track);
    *point = ndli_track_at(track, length + fmin(ahead, 0));
    if (ahead > 0)
        point->X = ndli_madd(point->X, ahead, needle->heading);
    return length + ahead >= 0;
}

/* Deformation gradient about the tip, at place: the mean along its way, over the length of the shaft's bends. In one
 * element at the end of a load it has no limit as meshes get finer. */
static sb_mat3 ndli_held_gradient(const ndl_needle *needle, const ndli_place *place, const ndli_bed_row *row)
{
    const ndli_bed *bed = &needle->site->bed;
    sb_mat3 sum = ndli_bed_gradient(bed, place, row);
    int count = 1;
    for (int k = -2; k <= 2; k++) {
        ndli_track_point point;
        ndli_place there;
        ndli_bed_row other;
        if (k == 0 || !ndli_held_beside(needle, 0.25 * k * needle->wave, &point) ||
            !ndli_bed_locate(bed, ndli_to(point.X), point.element, &there) || !ndli_bed_row_at(bed, &there, &other))
            continue;
        sum = sb_m3_add(sum, ndli_bed_gradient(bed, &there, &other));
        count++;
    }
    return sb_m3_scale(1 / (sb_real)count, sum);
}

/* The material that is at x in space, by Newton's method from *X on. 0: none is near; where *X and *place have come to
 * was taken away, or is outside. */
static int ndli_held_material(const ndli_bed *bed, ndli_v3 x, ndli_v3 *X, ndli_place *place)
{
    const double enough = 1e-6 * bed->mean_edge;
    for (int round = 0; round < 20; round++) {
        ndli_bed_row row;
        ndli_v3 off;
        sb_mat3 f;
        if (!ndli_bed_locate(bed, ndli_to(*X), place->element, place) || !ndli_bed_row_at(bed, place, &row))
            return 0;
        off = ndli_sub(x, ndli_bed_at(bed, &row));
        if (ndli_norm(off) < enough)
            return 1;
        f = ndli_bed_gradient(bed, place, &row);
        if (!(sb_m3_det(f) > 0))
            return 0;
        *X = ndli_add(*X, ndli_from(sb_m3_apply(sb_m3_inverse(f), ndli_to(off))));
    }
    return 0;
}

/* How many places before a tip in a hole are looked at, and how far they are apart in edges of the tissue: tissue is
 * drawn along by less than their way. */
enum { NDLI_HELD_LOOKS = 40 };
static const double ndli_held_look = 0.1;

/* The wall that a tip in a hole, or out of one on the far side, has come to, as it is in space: *X, *place. 0: to none.
 */
static int ndli_held_meet_wall(const ndl_needle *needle, const ndli_track_point *end, ndli_v3 *X, ndli_place *place)
{
    const ndli_bed *bed = &needle->site->bed;
    const ndl_rod *rod = needle->rod;
    ndli_bed_row row;
    int element = end->element;
    for (int k = 1; k <= NDLI_HELD_LOOKS; k++, element = place->element) {
        *X = ndli_madd(end->X, k * ndli_held_look * bed->mean_edge, needle->heading);
        if (ndli_bed_find(bed, ndli_to(*X), element, place, &row))
            return ndli_held_material(bed, rod->x[rod->node_count - 1], X, place);
    }
    return 0;
}

/* Where the tip looks, at rest, in the material at a place; as it is where there is none. 0: that is turned inside out.
 */
static int ndli_held_look_ahead(ndl_needle *needle, const ndli_place *place)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_v3 tangent = needle->rod->tangent[needle->rod->node_count - 2];
    ndli_bed_row row;
    sb_mat3 f = ndli_bed_row_at(bed, place, &row) ? ndli_bed_gradient(bed, place, &row) : sb_m3_identity();
    if (!(sb_m3_det(f) > 0))
        return 0;
    needle->heading = ndli_held_unit(ndli_from(sb_m3_apply(sb_m3_inverse(f), ndli_to(tangent))));
    return 1;
}

/* Where material was taken away a tip goes straight on, out of the far side too, until it comes to a wall. */
static void ndli_held_go_through_hole(ndl_needle *needle, double advance, const ndli_track_point *end)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_v3 X, tip = needle->rod->x[needle->rod->node_count - 1];
    ndli_place place;
    ndli_bed_row row;
    int meets = ndli_held_meet_wall(needle, end, &X, &place);
    if (!meets) {
        X = ndli_madd(end->X, advance, needle->heading);
        if (ndli_bed_find(bed, ndli_to(X), end->element, &place,
                          &row)) /* where the wall was before it was drawn along */
            (void)ndli_held_material(bed, tip, &X, &place);
        (void)ndli_bed_locate(bed, ndli_to(X), place.element, &place);
    }
    if ((meets && !ndli_held_look_ahead(needle, &place)) || !ndli_track_extend(&needle->track, X, place.element))
        ndli_held_block(needle);
}

/* The track goes on by `advance` (m, in space) from where the tip is. */
static void ndli_held_cut(ndl_needle *needle, double advance)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_track *track = &needle->track;
    ndli_track_point end = ndli_track_at(track, ndli_track_length(track));
    ndli_v3 heading, shaft, way, X, gap;
    ndli_bed_row row, next;
    ndli_place place;
    sb_mat3 f, inverse;
    int there;
    if (!ndli_bed_find(bed, ndli_to(end.X), end.element, &place, &row)) {
        ndli_held_go_through_hole(needle, advance, &end);
        return;
    }
    f = ndli_held_gradient(needle, &place, &row);
    if (!(sb_m3_det(f) > 0)) {
        ndli_held_block(needle);
        return;
    }
    inverse = sb_m3_inverse(f);
    heading = ndli_held_unit(ndli_from(sb_m3_apply(f, ndli_to(needle->heading))));
    shaft = ndli_bevel_shaft(needle, heading, ndli_held_chord(needle, ndli_bed_at(bed, &row), heading));
    way = ndli_bevel_go(needle, advance, shaft, ndli_bevel_lag(&needle->bevel), &heading);
    X = ndli_add(end.X, ndli_from(sb_m3_apply(inverse, ndli_to(way))));
    if (!ndli_bed_locate(bed, ndli_to(X), place.element, &place)) {
        ndli_held_block(needle);
        return;
    }
    there = ndli_bed_row_at(bed, &place, &next); /* else it comes into a hole */
    gap = there ? ndli_sub(ndli_sub(ndli_bed_at(bed, &next), ndli_bed_at(bed, &row)), way) : ndli_v(0, 0, 0);
    if (there && ndli_norm(gap) > advance + 0.1 * needle->site->mean_edge) { /* a cut lies between, and stands open */
        ndli_held_block(needle);
        return;
    }
    if (!ndli_track_extend(track, X, place.element)) {
        needle->limited = 1;
        ndli_held_block(needle);
        return;
    }
    needle->heading = ndli_held_unit(ndli_from(sb_m3_apply(inverse, ndli_to(heading))));
}

/* The tip goes back along the track, and looks along it again. */
static void ndli_held_draw_back(ndl_needle *needle, double arc)
{
    ndli_track_shorten(&needle->track, fmax(arc, 0));
    needle->hold_steps = 0;
    if (needle->track.count > 1)
        needle->heading = ndli_track_at(&needle->track, ndli_track_length(&needle->track)).tangent;
}

NDLI_API void ndli_held_leave(ndl_needle *needle)
{
    needle->line.first = needle->rod->node_count;
    needle->line.count = 0;
    needle->track.count = 0;
    needle->entering = 0;
}

/* Nodes that have come in, or gone out again. */
static void ndli_held_count(ndl_needle *needle)
{
    ndli_line *line = &needle->line;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    double stretch, more;
    while (line->first < last && needle->arc[line->first] <= 0) {
        line->state[line->first - 1] = NDL_FREE;
        line->first++;
    }
    while (line->first > 2 && (more = ndli_held_reach(needle, &stretch) - ndli_held_edge(rod, line->first - 1)) > 0) {
        int next = line->first - 1;
        double arc = fmin(more / stretch, ndli_held_most_arc(needle, next));
        if (!(arc > 0)) /* the rod is ahead of its material by more than it is in */
            break;
        line->first = next;
        needle->arc[next] = arc;
        line->state[next - 1] = line->state[next];
        line->contact[next - 1] = ndli_v(0, 0, 0);
    }
    line->count = rod->node_count - line->first;
    ndli_held_measure_entering(needle);
}

/* How far hold i is ahead of its material (m), or behind, only because it has slipped into stiffer tissue, to an arc:
 * there the force that holds it takes less of a way, and by the rest it has gone on, too. Taken for a slip of the next
 * step that would be as fast as the step is short, and viscosity made a force of it (0.8 N at a prostate's capsule). */
static double ndli_held_excess(const ndl_needle *needle, int i, double arc)
{
    const struct ndli_hold *hold = needle->line.holds + i;
    ndli_held_spot spot;
    ndli_held_tissue tissue;
    double ahead, along;
    if (hold->count == 0 || needle->line.state[i] == NDL_STATIC || !ndli_held_find(needle, arc, &spot))
        return 0;
    tissue = ndli_held_get_tissue(needle, spot.place.element, &spot.row);
    along = ndli_held_stiffness(needle, i, hold->length, &tissue);
    ahead = ndli_dot(hold->tangent, ndli_sub(ndli_held_place(needle, i), ndli_bed_at(&needle->site->bed, &spot.row)));
    return ahead * needle->line.slip[i] > 0 ? ahead * fmax(0, 1 - hold->along / along) : 0;
}

/* The tip goes on by `advance` (m, > 0). */
static void ndli_held_go_on(ndl_needle *needle, double advance)
{
    double excess;
    ndli_held_cut(needle, advance);
    excess = ndli_held_excess(needle, ndli_line_foremost(&needle->line), ndli_track_length(&needle->track));
    if (excess > 0)
        ndli_held_cut(needle, excess);
}

/* Nodes come to where they have slipped to; none passes the next. */
static void ndli_held_slip(ndl_needle *needle)
{
    const ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    needle->arc[last] = ndli_track_length(&needle->track);
    for (int i = last - 1; i >= line->first; i--) {
        double slip = line->slip[i] / needle->stretch[i];
        if (!ndli_held_is_between_lips(needle, i, slip))
            needle->arc[i] += slip + ndli_held_excess(needle, i, needle->arc[i] + slip) / needle->stretch[i];
        needle->arc[i] = fmin(needle->arc[i], ndli_held_most_arc(needle, i));
    }
}

/* ---- a needle that has torn out is held again ---- */

/* Where the shaft comes in through the skin that goes on to the tip: on edge *j, at *at; *place: of the skin there.
 * Returns what is behind it up to the tip (m); negative: it comes in nowhere. */
static double ndli_held_behind(const ndl_needle *needle, int *j, ndli_place *place, sb_vec3 *at)
{
    const ndl_rod *rod = needle->rod;
    double behind = 0;
    for (*j = rod->node_count - 2; *j > 0; (*j)--) {
        if (ndli_bed_hit(&needle->site->bed, ndli_to(rod->x[*j]), ndli_to(rod->x[*j + 1]), place, at))
            return behind + ndli_norm(ndli_sub(rod->x[*j + 1], ndli_from(*at)));
        behind += ndli_held_edge(rod, *j);
    }
    return -1;
}

/* The track is where the shaft is from the skin at edge j, so that the tissue is held without any force. 0: it cannot
 * be followed. */
static int ndli_held_lay_track(ndl_needle *needle, int j, ndli_place place)
{
    const ndl_rod *rod = needle->rod;
    const ndli_bed *bed = &needle->site->bed;
    ndli_track *track = &needle->track;
    ndli_v3 X = ndli_from(sbi_embed_map(&bed->mesh, place.element, place.xi, NULL));
    ndli_track_begin(track, X, place.element);
    for (int i = j + 1; i < rod->node_count; i++) {
        if (!ndli_held_material(bed, rod->x[i], &X, &place) || !ndli_track_extend(track, X, place.element))
            return 0;
        needle->arc[i] = ndli_track_length(track);
    }
    return track->count > 1;
}

/* Once it is half an edge deep, which is how deep no needle tears out again at once. */
static void ndli_held_thread(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    ndli_place place;
    sb_vec3 at;
    int j;
    if (ndli_held_behind(needle, &j, &place, &at) < 0.5 * needle->site->mean_edge)
        return;
    if (!ndli_held_lay_track(needle, j, place)) {
        ndli_held_leave(needle);
        return;
    }
    needle->heading = ndli_track_at(&needle->track, ndli_track_length(&needle->track)).tangent;
    needle->lost = NDLI_LOST_NOT;
    line->first = j + 1;
    line->count = rod->node_count - line->first;
    for (int i = j; i < rod->node_count; i++) {
        line->state[i] = NDL_STATIC;
        line->contact[i] = ndli_v(0, 0, 0);
        line->slip[i] = 0;
    }
    ndli_held_measure_entering(needle);
}

/* ---- the tip comes in ---- */

static void ndli_held_enter(ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    const ndli_bed *bed = &needle->site->bed;
    int last = rod->node_count - 1;
    ndli_line *line = &needle->line;
    ndli_place place;
    sb_vec3 at, X;
    int hits = ndli_bed_hit(bed, ndli_to(rod->x[last - 1]), ndli_to(rod->x[last]), &place, &at);
    if (needle->lost) { /* it is in the tissue, which does not hold it */
        if (!hits && !ndli_bed_holds_in_space(bed, ndli_to(rod->x[last])))
            needle->lost = NDLI_LOST_NOT;
        else if (needle->lost == NDLI_LOST_TORN)
            ndli_held_thread(needle);
        return;
    }
    if (!hits || !ndli_held_look_ahead(needle, &place))
        return;
    X = sbi_embed_map(&bed->mesh, place.element, place.xi, NULL);
    ndli_track_begin(&needle->track, ndli_from(X), place.element);
    line->first = last;
    line->count = 1;
    needle->arc[last] = 0;
    line->state[last] = line->state[last - 1] = NDL_STATIC;
    line->contact[last] = line->contact[last - 1] = ndli_v(0, 0, 0);
}

NDLI_API void ndli_held_follow_tip(ndl_needle *needle)
{
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    double back;
    needle->advance = 0;
    if (line->count == 0) {
        ndli_held_enter(needle);
        return;
    }
    needle->advance = line->slip[last];
    back = needle->arc[last] + needle->advance / needle->stretch[last];
    if (needle->advance > 0)
        ndli_held_go_on(needle, needle->advance);
    else if (needle->advance < 0)
        ndli_held_draw_back(needle, back);
    if (!(back > 0) && needle->advance < 0) {
        ndli_held_leave(needle);
        return;
    }
    ndli_held_slip(needle);
    ndli_held_count(needle);
}
