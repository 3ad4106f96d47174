/* cut_ablate: takes out the material in a ball.
 *
 * Where a lattice point is goes by the cell that has its material, the same to the last digit from all elements around
 * it; so all of them lose it or none. Links from lost points to others are cut where they leave the ball. */
#include <math.h>

#include "cut_private.h"

/* A ball in space. */
typedef struct sbi_cut_ball {
    sb_vec3 centre;
    sb_real radius;
} sbi_cut_ball;

/* A near tet at work. */
typedef struct sbi_cut_burn {
    int tet;
    sbi_corner_order order;
    uint64_t lost;                      /* in this call */
    sb_vec3 places[SBI_LATTICE_POINTS]; /* from the ball's centre, of points of its pieces */
} sbi_cut_burn;

static int sbi_cut_is_in(const sbi_cut_ball *ball, sb_vec3 from_centre)
{
    return sb_v3_norm(from_centre) <= ball->radius;
}

/* Where a piece of a tet has its points, and which of them are in the ball. */
static void sbi_cut_burn_piece(const sb_cut *cut, const sbi_cut_ball *ball, int piece, sbi_cut_burn *burn)
{
    sb_vec3 x[SBI_CUT_NODES];
    sbi_cut_get_nodes(cut, piece, x);
    for (int p = 0; p < cut->lattice.point_count; p++) {
        sb_real at[4];
        if (!(cut->pieces[piece].points >> p & 1))
            continue;
        sbi_lattice_point(&cut->lattice, p, at);
        burn->places[p] = sb_v3_sub(sbi_cut_place(cut, &burn->order, at, x), ball->centre);
        if (sbi_cut_is_in(ball, burn->places[p]))
            burn->lost |= (uint64_t)1 << p;
    }
}

/* Where the way from a point in the ball to one outside leaves it: |p + t (q - p)| = r. */
static sb_real sbi_cut_leave_ball(const sbi_cut_ball *ball, sb_vec3 in, sb_vec3 out)
{
    double p[3], e[3], a = 0, b = 0, c = -(double)ball->radius * (double)ball->radius, root, t;
    p[0] = (double)in.x, p[1] = (double)in.y, p[2] = (double)in.z;
    e[0] = (double)out.x - p[0], e[1] = (double)out.y - p[1], e[2] = (double)out.z - p[2];
    for (int k = 0; k < 3; k++) {
        a += e[k] * e[k];
        b += p[k] * e[k];
        c += p[k] * p[k];
    }
    root = b * b - a * c;
    root = root > 0 ? sqrt(root) : 0;
    t = b > 0 ? -c / (b + root) : (root - b) / a; /* without cancellation; c <= 0 */
    return t > 0 ? (sb_real)(t < 1 ? t : 1) : 0;  /* also of what is no number */
}

/* Cuts a link with one lost end where it was whole or predicted; 0: no memory. */
static int sbi_cut_burn_link(sb_cut *cut, const sbi_cut_ball *ball, const sbi_cut_burn *burn, int link)
{
    sbi_link_key key = sbi_lattice_key(&cut->lattice, &burn->order, burn->tet, link);
    int item = sbi_cut_links_find(&cut->links, &key), ends[2], from;
    sb_real t;
    if (item >= 0)
        return cut->links.items[item].state == SBI_LINK_CUT || sbi_cut_cross_link(cut, item, -1);
    sbi_lattice_ends(&cut->lattice, &burn->order, link, ends);
    from = (int)(burn->lost >> ends[0] & 1) ? 0 : 1;
    t = sbi_cut_leave_ball(ball, burn->places[ends[from]], burn->places[ends[1 - from]]);
    if (!sbi_cut_add_link(cut, &key, from ? 1 - t : t, SBI_LINK_CUT, -1))
        return 0;
    cut->links.items[cut->links.count - 1].charred = 1;
    return 1;
}

/* Takes the points of a near tet that are in the ball; 0: no memory. */
static int sbi_cut_burn_tet(sb_cut *cut, const sbi_cut_ball *ball, int tet)
{
    sbi_cut_burn burn;
    uint64_t left;
    int done = 1;
    burn.tet = tet;
    burn.order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    burn.lost = 0;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
        sbi_cut_burn_piece(cut, ball, piece, &burn);
    if (!burn.lost)
        return 1;
    cut->was_lost[tet] = cut->links.lost[tet];
    cut->links.lost[tet] |= burn.lost;
    sbi_cut_touch(cut, tet);
    cut->tet_marks[tet] |= SBI_CUT_LOSES;
    left = sbi_lattice_all(&cut->lattice) & ~cut->links.lost[tet];
    for (int l = 0; l < cut->lattice.link_count && done; l++) {
        const unsigned char *ends = cut->lattice.links[l];
        if (((burn.lost >> ends[0] & 1) && (left >> ends[1] & 1)) ||
            ((burn.lost >> ends[1] & 1) && (left >> ends[0] & 1)))
            done = sbi_cut_burn_link(cut, ball, &burn, l);
    }
    return done;
}

static sb_result sbi_cut_check_ball(const sb_cut *cut, const sbi_cut_ball *ball, sb_error *error)
{
    sb_result result;
    if (!cut)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_ablate needs a cut");
    result = sbi_cut_check_use(cut, error);
    if (result == SB_OK && (!sb_v3_is_finite(ball->centre) || !sb_is_finite(ball->radius)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the ball's centre or radius is not finite");
    if (result == SB_OK && ball->radius < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the ball's radius is %g", (double)ball->radius);
    return result;
}

SB_API sb_result sb_cut_ablate(sb_cut *cut, sb_vec3 centre, sb_real radius, sb_cut_info *info, sb_error *error)
{
    sbi_cut_ball ball = {centre, radius};
    sb_result result = sbi_cut_check_ball(cut, &ball, error);
    sb_vec3 told[2];
    int links, done = 1;
    if (result != SB_OK)
        return result;
    links = cut->links.count;
    sbi_cut_list_reached(cut, &centre, 1, radius + cut->element_size / 1024); /* more than places are rounded by */
    for (int i = 0; i < cut->near.count && done; i++)
        done = sbi_cut_burn_tet(cut, &ball, cut->near.items[i]);
    result = sbi_cut_finish(cut, links, 0, done && sbi_cut_settle_seams(cut, NULL, 0), info, error);
    if (result == SB_OK) {
        told[0] = centre;
        told[1] = sb_v3(radius, 0, 0);
        sbi_cut_tell(cut, SBI_CUT_ABLATE, 0, told, 2);
    }
    return result;
}
