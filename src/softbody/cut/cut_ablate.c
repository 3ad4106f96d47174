/* cut_ablate: takes out the material in a ball.
 *
 * Where a lattice point is goes by the cell that has its material, the same to the last digit from all elements around
 * it; so all of them lose it or none. Links from lost points to others are cut where they leave the ball, those that
 * were cut before too where the ball has come over their crossings: so the wall of a hole recedes smoothly before a tip
 * that goes on. */
#include <math.h>

#include "cut_private.h"

/* A ball in space. */
typedef struct sbi_cut_ball {
    sb_vec3 centre;
    sb_real radius;
} sbi_cut_ball;

/* A near tet at work. */
typedef struct sbi_cut_burn {
    const sbi_cut_ball *ball;
    int tet;
    sbi_corner_order order;
    uint64_t lost; /* in this call */
} sbi_cut_burn;

/* Where a point of the lattice is, as a piece has it, from the ball's centre. */
static sb_vec3 sbi_cut_burn_place(const sb_cut *cut, const sbi_cut_burn *burn, int piece, int point)
{
    sb_vec3 x[SBI_CUT_NODES];
    sb_real at[4];
    sbi_cut_get_nodes(cut, piece, x);
    sbi_lattice_point(&cut->lattice, point, at);
    return sb_v3_sub(sbi_cut_place(cut, &burn->order, at, x), burn->ball->centre);
}

static int sbi_cut_is_in(const sbi_cut_ball *ball, sb_vec3 from_centre)
{
    return sb_v3_norm(from_centre) <= ball->radius;
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

/* A tet loses points; 0: no memory. */
static int sbi_cut_lose(sb_cut *cut, int tet, uint64_t points)
{
    if (!(cut->tet_marks[tet] & SBI_CUT_LOSES)) {
        void *losses = cut->losses;
        int grown =
            sbi_cut_grow(&cut->allocator, &losses, &cut->loss_capacity, cut->loss_count, 1, sizeof *cut->losses);
        cut->losses = (sbi_cut_loss *)losses;
        if (!grown)
            return 0;
        cut->losses[cut->loss_count].tet = tet;
        cut->losses[cut->loss_count++].points = cut->links.lost[tet];
    }
    cut->links.lost[tet] |= points;
    sbi_cut_touch(cut, tet);
    cut->tet_marks[tet] |= SBI_CUT_LOSES;
    return 1;
}

/* A link from lost to other material that is cut on: the ball has come over its crossing, which recedes before it.
 * 0: no memory. */
static int sbi_cut_recede(sb_cut *cut, int item, sb_real t)
{
    void *receded = cut->receded;
    int grown =
        sbi_cut_grow(&cut->allocator, &receded, &cut->receded_capacity, cut->receded_count, 1, sizeof *cut->receded);
    sbi_cut_link *link = cut->links.items + item;
    cut->receded = (sbi_cut_receded *)receded;
    if (!grown)
        return 0;
    cut->receded[cut->receded_count].item = item;
    cut->receded[cut->receded_count].charred = link->charred;
    cut->receded[cut->receded_count++].t = link->t;
    link->t = t;
    link->charred = 1;
    sbi_cut_list_around(cut, &link->key);
    for (int i = 0; i < cut->around.count; i++) /* all of them have less now */
        sbi_cut_lose(cut, cut->around.items[i], 0);
    return 1;
}

/* Cuts a link from a lost point to another where it leaves the ball; 0: no memory. */
static int sbi_cut_burn_link(sb_cut *cut, const sbi_cut_burn *burn, int link, int lost, int kept)
{
    sbi_link_key key = sbi_lattice_key(&cut->lattice, &burn->order, burn->tet, link);
    int item = sbi_cut_links_find(&cut->links, &key), ends[2], piece = sbi_cut_piece_with(cut, burn->tet, kept);
    sb_vec3 from = sbi_cut_burn_place(cut, burn, piece, lost), to = sbi_cut_burn_place(cut, burn, piece, kept);
    sb_real t = 0, share;
    if (item >= 0 && cut->links.items[item].state != SBI_LINK_CUT && !sbi_cut_cross_link(cut, item, -1))
        return 0;
    sbi_lattice_ends(&cut->lattice, &burn->order, link, ends);
    if (item >= 0) { /* it goes on from where it is cut */
        t = ends[0] == lost ? cut->links.items[item].t : 1 - cut->links.items[item].t;
        from = sb_v3_madd(sb_v3_scale(1 - t, from), t, to);
        if (!sbi_cut_is_in(burn->ball, from))
            return 1;
    }
    share = t + (1 - t) * sbi_cut_leave_ball(burn->ball, from, to);
    if (item >= 0)
        return !(share > t) || sbi_cut_recede(cut, item, ends[0] == lost ? share : 1 - share);
    if (!sbi_cut_add_link(cut, &key, ends[0] == lost ? share : 1 - share, SBI_LINK_CUT, -1))
        return 0;
    cut->links.items[cut->links.count - 1].charred = 1;
    return 1;
}

/* Points of a near tet that are in the ball are lost; 0: no memory. */
static int sbi_cut_burn_points(sb_cut *cut, const sbi_cut_ball *ball, int tet)
{
    sbi_cut_burn burn;
    burn.ball = ball;
    burn.tet = tet;
    burn.order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    burn.lost = 0;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
        for (int p = 0; p < cut->lattice.point_count; p++)
            if ((cut->pieces[piece].points >> p & 1) && sbi_cut_is_in(ball, sbi_cut_burn_place(cut, &burn, piece, p)))
                burn.lost |= (uint64_t)1 << p;
    return !burn.lost || sbi_cut_lose(cut, tet, burn.lost);
}

/* Links of a near tet between what is lost and what is not end at the ball; 0: no memory. */
static int sbi_cut_burn_links(sb_cut *cut, const sbi_cut_ball *ball, int tet)
{
    uint64_t lost = cut->links.lost[tet], left = sbi_lattice_all(&cut->lattice) & ~lost;
    sbi_cut_burn burn;
    int done = 1;
    if (!lost || !left)
        return 1;
    burn.ball = ball;
    burn.tet = tet;
    burn.order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    burn.lost = 0;
    for (int l = 0; l < cut->lattice.link_count && done; l++) {
        int a = cut->lattice.links[l][0], b = cut->lattice.links[l][1];
        if ((lost >> a & 1) && (left >> b & 1))
            done = sbi_cut_burn_link(cut, &burn, l, a, b);
        else if ((lost >> b & 1) && (left >> a & 1))
            done = sbi_cut_burn_link(cut, &burn, l, b, a);
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
        done = sbi_cut_burn_points(cut, &ball, cut->near.items[i]);
    for (int i = 0; i < cut->near.count && done; i++)
        done = sbi_cut_burn_links(cut, &ball, cut->near.items[i]);
    result = sbi_cut_finish(cut, links, 0, done && sbi_cut_settle_seams(cut, NULL, 0), info, error);
    if (result == SB_OK) {
        told[0] = centre;
        told[1] = sb_v3(radius, 0, 0);
        sbi_cut_tell(cut, SBI_CUT_ABLATE, 0, told, 2);
    }
    return result;
}
