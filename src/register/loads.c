/* loads: see loads.h. */
#include "loads.h"

#include <string.h>

#include "../softbody/solve/direct_front.h"
#include "match_private.h"
#include "pieces.h"

#define REGI_LOADS_COOKIE 0x6c6f6164u

enum {
    REGI_LOADS_SLAB = 96,  /* force components per product of the dense system */
    REGI_LOADS_SMOOTH = 2, /* times that tractions are averaged over facets */
    REGI_LOADS_POSE = 6,   /* moves along the axes and turns about them, */
    REGI_LOADS_FREE = 8,   /* and tilts of the drag: what is found beside the forces */
    REGI_LOADS_ALONE = 2,  /* rounds before a drag is looked for */
    REGI_LOADS_LOOKS = 2,  /* times that its region is decided */
    REGI_LOADS_AFTER = 2,  /* rounds that have to follow the second, as it may move much */
    REGI_LOADS_LEAST = 10  /* parts of one: fewer cannot be told from what is around them */
};

typedef struct regi_loads {
    const reg_loads_def *def;
    reg_match *match;
    sb_body *body;
    sb_boundary boundary;
    sb_direct *direct;
    int wide; /* of the fronts' arithmetic */
    void *memory;
    int node_count;
    int sample_count, sample_most; /* multiples of 3 */
    int part_count;  /* of the surface: possible samples; three of each landmark follow, and two of each part that
                      * is dragged */
    int drag_first;  /* the first of the latter */
    int *sample_of;  /* [sample_most] which of those a sample is; -1: none, it fills up the last group */
    int drag_sample; /* the first of a dragged part */
    int load_count;  /* surface nodes that may bear a force */
    int *load_nodes; /* [load_count] */
    sb_real *area;   /* [nodes] of the surface at a node (m^2), 0 inside */
    double total_area;
    int *part;                             /* [charges] that a charge belongs to */
    int *part_start;                       /* [part_count + 1] into part_charges */
    int *part_charges;                     /* [charges] by part */
    int *part_centre;                      /* [part_count] a charge */
    sb_real *part_load;                    /* [part_count] mean traction (Pa) */
    unsigned char *is_dragged, *votes;     /* [part_count] */
    int drag_looks, drag_count, drag_most; /* looks: how often its region is still to be decided */
    int *drag_parts;                       /* [drag_most] */
    sb_vec3 drag, across[2];               /* unit vectors: of the drag, and at right angles to it */
    sb_real drag_spread;                   /* of the motions about it, as share of them */
    double effort;                         /* of the last round without a drag */
    sb_real scatter;                       /* of a charge's gap about the mean of its part: variance (m^2) */
    sb_real *spread;                       /* [charges] squared distance from the centre of its part (m^2) */
    sb_real *rows;                         /* [SBI_FRONT_GROUP][nodes][3] samples, and their responses */
    sb_real *response;                     /* [load_count][3][sample_count]: of each sample's gap to a force (m/N) */
    sb_real *gap;                          /* [sample_most] that forces have to close (m) */
    sb_real *variance;   /* [sample_count] of a part misfit^2, over the share of it that acts; 0: the sample is off */
    sb_real *system;     /* [sample_count][sample_count] */
    sb_real *multiplier; /* [sample_count] y */
    sb_real *signs, *sizes; /* [sample_count] of the factor */
    sb_real *slab;          /* [SLAB][SLAB + sample_count] */
    sb_real *pack;
    sb_real *weight;            /* [load_count] w */
    sb_real *traction;          /* [nodes] */
    sb_real *average;           /* [nodes] */
    sb_real *touch;             /* [nodes] facets */
    sb_vec3 *force;             /* [nodes] found (N) */
    sb_vec3 *residual;          /* [nodes] internal less known forces (N) */
    sb_vec3 *increment;         /* [nodes] of a round (m) */
    const unsigned char *fixed; /* [nodes] axes of the body's supports */
    int *held_nodes;            /* [nodes] scratch: nodes held along the same axes, */
    sb_vec3 *held_goals;        /* [nodes] and where they are sent */
    sb_vec3 *before, *goals;    /* [nodes] displacement at the beginning, and where held nodes were to be then (m) */
    int posed;                  /* 1: the pose is sought, too */
    sb_vec3 centre;             /* m: of the held nodes at the beginning, or of all; turns are about it */
    sb_real likely[REGI_LOADS_FREE];                      /* sd of the pose (m, rad), and of tilts (rad) */
    sb_real pose[REGI_LOADS_POSE], next[REGI_LOADS_POSE]; /* reached, and found in this round: m, rad */
    sb_real *free_rows; /* [sample_count][FREE] a sample's motion with pose and tilt, in sd */
    double begun;       /* on the clock */
    reg_loads_info info;
} regi_loads;

REG_API reg_loads_def reg_default_loads_def(void)
{
    reg_loads_def def;
    memset(&def, 0, sizeof def);
    def.samples = 300;
    def.rounds = 10;
    def.reweights = 9;
    def.misfit = (sb_real)6e-5;
    def.power = (sb_real)0.5;
    def.floor = (sb_real)0.01;
    def.landmark = (sb_real)1e-3;
    def.drag = (sb_real)0.01;
    def.pose = 0;
    def.max_seconds = 1e9;
    def.cookie = REGI_LOADS_COOKIE;
    return def;
}

static sb_result regi_loads_check(const reg_loads_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_LOADS_COOKIE || !def->match)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "loads need a def made by reg_default_loads_def, and a match");
    if (def->samples < 30 || def->samples > 3000 || def->rounds < 1 || def->rounds > 100 || def->reweights < 1 ||
        def->reweights > 1000)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d samples, %d rounds, %d reweights: out of range", def->samples,
                        def->rounds, def->reweights);
    if (!(def->misfit > 0) || !sb_is_finite(def->misfit) || !(def->power > 0 && def->power <= 2) || !(def->floor > 0) ||
        !sb_is_finite(def->floor) || !(def->pose >= 0) || !sb_is_finite(def->pose) ||
        !(def->drag >= 0 && def->drag < 1) || !(def->landmark >= (sb_real)1e-6 && def->landmark <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "misfit %g, power %g, floor %g, landmark %g, drag %g, pose %g: out of "
                        "range",
                        (double)def->misfit, (double)def->power, (double)def->floor, (double)def->landmark,
                        (double)def->drag, (double)def->pose);
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    if (def->match->method != REG_PBSM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "loads need a match by distance");
    if (sbi_body_load_count(def->match->body) > 0 || sbi_body_has_constraints(def->match->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "loads need a body without pressures, springs and constraints");
    return sbi_body_check_version(def->match->body, def->match->mesh_version, error);
}

static double regi_loads_now(const regi_loads *l) { return l->def->clock ? l->def->clock() : 0.0; }

/* ---- what stays: nodes, parts of the surface ---- */

/* Shares the area of the body's facets out to their nodes. */
static void regi_loads_measure_nodes(regi_loads *l)
{
    const sb_mesh *skin = &l->boundary.surface;
    int width = sb_mesh_element_width(skin), corners = sb_element_corner_count(skin->element_type);
    memset(l->area, 0, (size_t)l->node_count * sizeof(sb_real));
    for (int f = 0; f < skin->element_count; f++) {
        const int *c = skin->elements + (size_t)f * (size_t)width;
        sb_vec3 d = sb_v3_sub(skin->nodes[c[corners - 1]], skin->nodes[c[0]]), area;
        area = sb_v3_cross(sb_v3_sub(skin->nodes[c[1]], skin->nodes[c[0]]), d);
        if (corners == 4) {
            d = sb_v3_sub(skin->nodes[c[3]], skin->nodes[c[1]]);
            area = sb_v3_cross(sb_v3_sub(skin->nodes[c[2]], skin->nodes[c[0]]), d);
        }
        for (int k = 0; k < width; k++)
            l->area[l->boundary.nodes[c[k]]] += sb_v3_norm(area) / (2 * (sb_real)width);
    }
    l->load_count = 0;
    l->total_area = 0;
    for (int i = 0; i < l->node_count; i++) {
        l->total_area += (double)l->area[i];
        if (l->area[i] > 0 && l->fixed[i] != SB_XYZ)
            l->load_nodes[l->load_count++] = i;
    }
}

static sb_vec3 regi_loads_rest_point(const regi_loads *l, int charge)
{
    int width = l->match->width;
    const int *nodes = regi_match_nodes(l->match, charge);
    sb_vec3 x = sb_v3(0, 0, 0);
    for (int a = 0; a < width; a++)
        x = sb_v3_madd(x, l->match->weights[(size_t)charge * (size_t)width + (size_t)a],
                       l->match->mesh.nodes[nodes[a]]);
    return x;
}

/* Parts around centres that are as far from each other as can be; each charge belongs to the closest. */
static void regi_loads_cut_parts(regi_loads *l)
{
    int charges = l->match->charge_count, centre = 0;
    for (int i = 0; i < charges; i++)
        l->spread[i] = SB_REAL_MAX;
    for (int s = 0; s < l->part_count; s++) {
        sb_vec3 at = regi_loads_rest_point(l, centre);
        sb_real farthest = -1;
        l->part_centre[s] = centre;
        for (int i = 0; i < charges; i++) {
            sb_vec3 way = sb_v3_sub(regi_loads_rest_point(l, i), at);
            sb_real square = sb_v3_dot(way, way);
            if (square < l->spread[i]) {
                l->spread[i] = square;
                l->part[i] = s;
            }
            if (l->spread[i] > farthest) {
                farthest = l->spread[i];
                centre = i;
            }
        }
    }
    memset(l->part_start, 0, (size_t)(l->part_count + 1) * sizeof(int));
    for (int i = 0; i < charges; i++)
        l->part_start[l->part[i] + 1]++;
    for (int s = 0; s < l->part_count; s++)
        l->part_start[s + 1] += l->part_start[s];
    for (int i = charges - 1; i >= 0; i--)
        l->part_charges[--l->part_start[l->part[i] + 1]] = i;
    /* each start has moved down to that of the part before it */
    memmove(l->part_start, l->part_start + 1, (size_t)l->part_count * sizeof(int));
    l->part_start[l->part_count] = charges;
}

/* ---- a round: samples and their responses ---- */

/* Adds weight times a charge's motion along `line` to a row. Held components do not move. */
static void regi_loads_add_point(const regi_loads *l, int charge, sb_vec3 line, sb_real weight, sb_real *row)
{
    int width = l->match->width;
    const int *nodes = regi_match_nodes(l->match, charge);
    const sb_real *weights = l->match->weights + (size_t)charge * (size_t)width;
    for (int a = 0; a < width; a++) {
        sb_real *to = row + 3 * (size_t)nodes[a], share = weight * weights[a];
        unsigned char held = l->fixed[nodes[a]];
        to[0] += held & SB_X ? 0 : share * line.x;
        to[1] += held & SB_Y ? 0 : share * line.y;
        to[2] += held & SB_Z ? 0 : share * line.z;
    }
}

/* Adds weight times a point's motion along `line` with the whole organ, and opens the gap by what that did so far. */
static void regi_loads_add_pose(regi_loads *l, int sample, sb_vec3 point, sb_vec3 line, sb_real weight)
{
    sb_vec3 turn = sb_v3_cross(sb_v3_sub(point, l->centre), line);
    const sb_real slope[REGI_LOADS_POSE] = {line.x, line.y, line.z, turn.x, turn.y, turn.z};
    sb_real *row = l->free_rows + (size_t)sample * REGI_LOADS_FREE;
    for (int k = 0; k < REGI_LOADS_POSE && l->posed; k++) {
        row[k] += weight * slope[k] * l->likely[k];
        l->gap[sample] += weight * slope[k] * l->pose[k];
    }
}

/* Signed distance of a charge from the target along the target's normal (m). */
static sb_real regi_loads_distance(const regi_match_charge *charge)
{
    return sb_v3_dot(charge->force, charge->line) / charge->stiffness;
}

/* Sums over the active charges of a part. */
typedef struct regi_loads_part {
    int count;
    sb_real area, mean, squares; /* m^2; of the distances (m), and about that (m^2) */
} regi_loads_part;

static regi_loads_part regi_loads_look_at(const regi_loads *l, int index)
{
    regi_loads_part part = {0, 0, 0, 0};
    for (int k = l->part_start[index]; k < l->part_start[index + 1]; k++) {
        const regi_match_charge *charge = l->match->charges + l->part_charges[k];
        sb_real step, distance = charge->active ? regi_loads_distance(charge) : 0;
        if (!charge->active)
            continue;
        part.count++;
        part.area += charge->area;
        step = distance - part.mean; /* weighted running mean and squares (West 1979) */
        part.mean += charge->area / part.area * step;
        part.squares += charge->area * step * (distance - part.mean);
    }
    part.squares = part.count ? part.squares / part.area * (sb_real)part.count : 0;
    return part;
}

/* What single charges scatter about the means of their parts: m^2, over all parts. */
static void regi_loads_pool(regi_loads *l)
{
    double squares = 0, freedom = 0;
    for (int s = 0; s < l->part_count; s++) {
        regi_loads_part part = regi_loads_look_at(l, s);
        squares += (double)part.squares;
        freedom += part.count > 1 ? part.count - 1 : 0;
    }
    l->scatter = (sb_real)(freedom > 0 ? squares / freedom : 0);
}

/* The mean gap along the target's normals of the charges of a part, and the row of its motion. What the gaps scatter
 * about their mean is noise that no force explains, also that of facets that cut corners: of this part and, since it
 * has few charges, of all parts. Charges share vertices with their neighbours, so that some four are worth one in the
 * mean's variance. */
static void regi_loads_sample_part(regi_loads *l, int sample, int index, sb_real *row)
{
    const int prior = 6; /* charges that the scatter of all parts counts for */
    sb_real misfit = l->def->misfit * l->match->size, scatter;
    regi_loads_part part = regi_loads_look_at(l, index);
    for (int k = l->part_start[index]; k < l->part_start[index + 1]; k++) {
        const regi_match_charge *charge = l->match->charges + l->part_charges[k];
        if (!charge->active)
            continue;
        regi_loads_add_point(l, l->part_charges[k], charge->line, charge->area / part.area, row);
        regi_loads_add_pose(l, sample, charge->point, charge->line, charge->area / part.area);
    }
    scatter = (part.squares + (sb_real)prior * l->scatter) / (sb_real)(part.count - 1 + prior);
    l->gap[sample] -= part.mean;
    l->variance[sample] = misfit * misfit * (sb_real)(l->total_area / (double)l->part_count) / part.area +
                          4 * scatter / (sb_real)part.count;
}

/* One component of a landmark's place: index counts components. */
static void regi_loads_sample_landmark(regi_loads *l, int sample, int index, sb_real *row)
{
    int axis = index % 3, charge = l->match->charge_count + index / 3;
    sb_real sd = l->def->landmark * l->match->size;
    sb_vec3 line = sb_v3(axis == 0, axis == 1, axis == 2), now = regi_match_point(l->match, charge);
    l->gap[sample] = sb_v3_dot(sb_v3_sub(l->match->targets[l->match->charges[charge].index], now), line);
    l->variance[sample] = sd * sd;
    regi_loads_add_pose(l, sample, now, line, 1);
    regi_loads_add_point(l, charge, line, 1, row);
}

/* Mean motion of a part's charges beyond that of the pose (m). */
static sb_vec3 regi_loads_part_motion(const regi_loads *l, int part)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real area = 0;
    for (int k = l->part_start[part]; k < l->part_start[part + 1]; k++) {
        int charge = l->part_charges[k];
        sb_vec3 now = regi_match_point(l->match, charge), motion = sb_v3_sub(now, regi_loads_rest_point(l, charge));
        sb_vec3 turn = sb_v3_cross(sb_v3(l->pose[3], l->pose[4], l->pose[5]), sb_v3_sub(now, l->centre));
        motion = sb_v3_sub(sb_v3_sub(motion, turn), sb_v3(l->pose[0], l->pose[1], l->pose[2]));
        sum = sb_v3_madd(sum, l->match->charges[charge].area, motion);
        area += l->match->charges[charge].area;
    }
    return sb_v3_scale(area > 0 ? 1 / area : 0, sum);
}

/* A part that is dragged does not move across the drag, but for what the drag's tilt makes of its way along it. Index
 * counts both directions across. */
static void regi_loads_sample_drag(regi_loads *l, int sample, int index, sb_real *row)
{
    int axis = index % 2, part = l->drag_parts[index / 2];
    sb_vec3 motion = regi_loads_part_motion(l, part);
    sb_real area = 0, sd;
    for (int k = l->part_start[part]; k < l->part_start[part + 1]; k++)
        area += l->match->charges[l->part_charges[k]].area;
    for (int k = l->part_start[part]; k < l->part_start[part + 1]; k++)
        regi_loads_add_point(l, l->part_charges[k], l->across[axis], l->match->charges[l->part_charges[k]].area / area,
                             row);
    sd = sb_max(l->def->drag, (sb_real)0.2 * l->drag_spread) * sb_v3_norm(motion) + l->def->misfit * l->match->size;
    l->gap[sample] = -sb_v3_dot(motion, l->across[axis]);
    l->variance[sample] = sd * sd;
    l->free_rows[(size_t)sample * REGI_LOADS_FREE + REGI_LOADS_POSE + (size_t)axis] =
        -l->likely[REGI_LOADS_POSE + axis] * sb_v3_dot(motion, l->drag);
}

/* Forces and stiffness of the present shape, factored. The mass holds what nothing holds; it acts on a round's motion
 * only, so that the end does not notice. */
static sb_result regi_loads_stiffness(regi_loads *l, sb_error *error)
{
    return sbi_body_factor(l->body, (sb_real)0.1 * l->match->young * l->match->size, l->residual, l->direct, error);
}

/* Numbers the samples of a round: parts of which something is near the target, landmarks, what is dragged. */
static void regi_loads_list_samples(regi_loads *l)
{
    int count = 0;
    for (int s = 0; s < l->part_count; s++)
        if (regi_loads_look_at(l, s).count > 0)
            l->sample_of[count++] = s;
    for (int s = l->part_count; s < l->drag_first; s++)
        l->sample_of[count++] = s;
    l->drag_sample = count;
    for (int s = 0; s < 2 * l->drag_count; s++)
        l->sample_of[count++] = l->drag_first + s;
    while (count % 3 != 0)
        l->sample_of[count++] = -1;
    l->sample_count = count;
}

static void regi_loads_sample(regi_loads *l, int sample, sb_real *row)
{
    int index = l->sample_of[sample];
    l->gap[sample] = l->variance[sample] = 0;
    if (index >= l->drag_first)
        regi_loads_sample_drag(l, sample, index - l->drag_first, row);
    else if (index >= l->part_count)
        regi_loads_sample_landmark(l, sample, index - l->part_count, row);
    else if (index >= 0)
        regi_loads_sample_part(l, sample, index, row);
}

/* Responses of the samples, a group of right-hand sides at a time, and the gaps that all the forces have to close:
 * those seen and those that would open if the present ones went. */
static void regi_loads_respond(regi_loads *l)
{
    size_t row_size = 3 * (size_t)l->node_count, samples = (size_t)l->sample_count;
    for (int first = 0; first < l->sample_count; first += SBI_FRONT_GROUP) {
        int count = sbi_min_int(SBI_FRONT_GROUP, l->sample_count - first);
        memset(l->rows, 0, (size_t)count * row_size * sizeof(sb_real));
        memset(l->free_rows + (size_t)first * REGI_LOADS_FREE, 0, (size_t)count * REGI_LOADS_FREE * sizeof(sb_real));
        for (int s = 0; s < count; s++)
            regi_loads_sample(l, first + s, l->rows + (size_t)s * row_size);
        (void)sb_direct_solve(l->direct, l->rows, l->rows, count);
        for (int s = 0; s < count; s++) {
            const sb_real *row = l->rows + (size_t)s * row_size;
            for (int i = 0; i < l->node_count; i++)
                l->gap[first + s] += sb_v3_dot(sb_v3(row[3 * i], row[3 * i + 1], row[3 * i + 2]), l->residual[i]);
            for (int k = 0; k < 3 * l->load_count; k++)
                l->response[(size_t)k * samples + (size_t)(first + s)] = row[3 * l->load_nodes[k / 3] + k % 3];
        }
    }
}

/* ---- a round: forces ---- */

/* Averages the tractions over facets and back to the nodes. */
static void regi_loads_smooth(regi_loads *l)
{
    const sb_mesh *skin = &l->boundary.surface;
    int width = sb_mesh_element_width(skin);
    memset(l->average, 0, (size_t)l->node_count * sizeof(sb_real));
    memset(l->touch, 0, (size_t)l->node_count * sizeof(sb_real));
    for (int f = 0; f < skin->element_count; f++) {
        const int *c = skin->elements + (size_t)f * (size_t)width;
        sb_real mean = 0;
        for (int k = 0; k < width; k++)
            mean += l->traction[l->boundary.nodes[c[k]]] / (sb_real)width;
        for (int k = 0; k < width; k++) {
            l->average[l->boundary.nodes[c[k]]] += mean;
            l->touch[l->boundary.nodes[c[k]]] += 1;
        }
    }
    for (int i = 0; i < l->node_count; i++)
        l->traction[i] = l->touch[i] > 0 ? l->average[i] / l->touch[i] : 0;
}

/* Largest traction (Pa). */
static sb_real regi_loads_tractions(regi_loads *l)
{
    sb_real most = 0;
    memset(l->traction, 0, (size_t)l->node_count * sizeof(sb_real));
    for (int k = 0; k < l->load_count; k++) {
        int i = l->load_nodes[k];
        l->traction[i] = sb_v3_norm(l->force[i]) / l->area[i];
        most = sb_max(most, l->traction[i]);
    }
    return most;
}

/* ---- a round: what was dragged ---- */

/* part_load; returns the largest. */
static sb_real regi_loads_load_parts(regi_loads *l)
{
    sb_real most = 0;
    int width = l->match->width;
    (void)regi_loads_tractions(l);
    for (int s = 0; s < l->part_count; s++) {
        sb_real load = 0, area = 0;
        for (int k = l->part_start[s]; k < l->part_start[s + 1]; k++) {
            const regi_match_charge *charge = l->match->charges + l->part_charges[k];
            const int *nodes = regi_match_nodes(l->match, l->part_charges[k]);
            const sb_real *weights = l->match->weights + (size_t)l->part_charges[k] * (size_t)width;
            sb_real traction = 0;
            for (int a = 0; a < width; a++)
                traction += weights[a] * l->traction[nodes[a]];
            load += charge->area * sb_max(traction, 0);
            area += charge->area;
        }
        l->part_load[s] = area > 0 ? load / area : 0;
        most = sb_max(most, l->part_load[s]);
    }
    return most;
}

/* A region is compact: parts amid dragged ones are dragged, too, and those on their own are not. */
static void regi_loads_vote(regi_loads *l)
{
    sb_real reach = (sb_real)1.6 * sb_sqrt((sb_real)(l->total_area / l->part_count));
    for (int s = 0; s < l->part_count; s++) {
        sb_vec3 at = regi_loads_rest_point(l, l->part_centre[s]), normal = l->match->charges[l->part_centre[s]].normal;
        int yes = 0, all = 0;
        for (int t = 0; t < l->part_count; t++) {
            sb_vec3 way = sb_v3_sub(regi_loads_rest_point(l, l->part_centre[t]), at);
            if (t == s || sb_v3_dot(way, way) > reach * reach ||
                sb_v3_dot(l->match->charges[l->part_centre[t]].normal, normal) < 0)
                continue;
            yes += l->is_dragged[t];
            all++;
        }
        l->votes[s] = (unsigned char)(l->is_dragged[s] ? 10 * yes >= 5 * all : all > 0 && 10 * yes >= 6 * all);
    }
    memcpy(l->is_dragged, l->votes, (size_t)l->part_count);
}

/* Parts that bear loads, and those amid them. */
static void regi_loads_choose_dragged(regi_loads *l)
{
    sb_real most = regi_loads_load_parts(l);
    for (int s = 0; s < l->part_count; s++)
        l->is_dragged[s] = l->part_load[s] > (sb_real)0.06 * most;
    for (int k = 0; k < 2; k++)
        regi_loads_vote(l);
    l->drag_count = 0;
    for (int s = 0; s < l->part_count; s++)
        if (l->is_dragged[s] && l->drag_count < l->drag_most)
            l->drag_parts[l->drag_count++] = s;
}

/* The direction that the motions of the dragged parts have most in common. */
static void regi_loads_point_drag(regi_loads *l)
{
    sb_mat3 sum = sb_m3_zero(), vectors;
    sb_vec3 values, all = sb_v3(0, 0, 0);
    for (int k = 0; k < l->drag_count; k++) {
        sb_vec3 motion = regi_loads_part_motion(l, l->drag_parts[k]);
        all = sb_v3_add(all, motion);
        sum = sb_m3_add(sum, sb_m3_outer(motion, motion));
    }
    sb_m3_eigen(sum, &values, &vectors);
    l->drag = sb_m3_column(vectors, 0);
    l->drag = sb_v3_dot(all, l->drag) < 0 ? sb_v3_scale(-1, l->drag) : l->drag;
    l->across[0] = sb_m3_column(vectors, 1);
    l->across[1] = sb_v3_cross(l->drag, l->across[0]);
    l->drag_spread = values.x > 0 ? sb_sqrt(sb_max(values.y, 0) / values.x) : 1;
}

/* 1 when the last round moved nothing by more than that share of the organ's size. */
static int regi_loads_is_at_rest(const regi_loads *l, sb_real share)
{
    return l->info.change <= share * l->match->size;
}

/* The region is decided from loads that were found without a drag, since those found with it follow what it asks for;
 * and, where all of the surface is there to contradict, once more when these come to rest. Motions that have no
 * direction in common are no drag, nor are those of a few parts. */
static void regi_loads_find_drag(regi_loads *l, int round)
{
    const sb_real most_spread = (sb_real)(1.0 / 3), rest = (sb_real)3e-3;
    int first = l->drag_looks == REGI_LOADS_LOOKS;
    if (!first && round + REGI_LOADS_AFTER >= l->def->rounds)
        l->drag_looks = 0;
    if (l->drag_looks > 0 && ((first && round >= REGI_LOADS_ALONE) || regi_loads_is_at_rest(l, rest))) {
        l->drag_looks = l->match->partial ? 0 : l->drag_looks - 1;
        regi_loads_choose_dragged(l);
    }
    if (l->drag_count > 0)
        regi_loads_point_drag(l);
    if (l->drag_spread > most_spread || (l->drag_count > 0 && l->drag_count < REGI_LOADS_LEAST))
        l->drag_count = l->drag_looks = 0;
}

/* What is least for the true loads: sum of area traction^power. */
static double regi_loads_effort(regi_loads *l)
{
    double sum = 0;
    (void)regi_loads_tractions(l);
    for (int k = 0; k < l->load_count; k++) {
        int i = l->load_nodes[k];
        if (l->traction[i] > 0)
            sum += (double)(l->area[i] * sb_exp(l->def->power * sb_log(l->traction[i])));
    }
    return sum;
}

/* 1 for a drag that asks for loads which would not be there without it: it was none, and is not looked for again. */
static int regi_loads_refuse_drag(regi_loads *l)
{
    double effort = regi_loads_effort(l);
    if (l->drag_count == 0) {
        l->effort = effort;
        return 0;
    }
    if (!(effort > 1.25 * l->effort))
        return 0;
    l->drag_count = l->drag_looks = 0;
    for (int s = l->drag_sample; s < l->sample_count; s++)
        l->variance[s] = 0;
    return 1;
}

/* w from the forces; the same everywhere when there are none yet. */
static void regi_loads_weigh(regi_loads *l)
{
    double sum = 0;
    sb_real exponent = 2 - l->def->power, mean;
    (void)regi_loads_tractions(l);
    for (int i = 0; i < l->node_count; i++)
        sum += (double)(l->area[i] * l->traction[i]);
    mean = (sb_real)(sum / l->total_area);
    for (int k = 0; k < REGI_LOADS_SMOOTH; k++)
        regi_loads_smooth(l);
    for (int k = 0; k < l->load_count; k++) {
        int i = l->load_nodes[k];
        sb_real share = mean > 0 ? l->traction[i] / mean + l->def->floor : 1;
        l->weight[k] = l->area[i] * sb_exp(exponent * sb_log(share));
    }
}

/* system = G W G^T, lower triangle, by slabs of columns for the fronts' product, which subtracts. */
static void regi_loads_gram(regi_loads *l)
{
    size_t samples = (size_t)l->sample_count, columns = 3 * (size_t)l->load_count;
    memset(l->system, 0, samples * samples * sizeof(sb_real));
    for (size_t first = 0; first < columns; first += REGI_LOADS_SLAB) {
        size_t count = columns - first < REGI_LOADS_SLAB ? columns - first : (size_t)REGI_LOADS_SLAB;
        for (size_t k = 0; k < count; k++) {
            const sb_real *from = l->response + (first + k) * samples;
            sb_real root = sb_sqrt(l->weight[(first + k) / 3]), *to = l->slab + k * (count + samples) + count;
            for (size_t s = 0; s < samples; s++)
                to[s] = root * from[s];
        }
        sbi_front_square(l->slab, count + samples, count, 0, NULL, l->system, l->pack, l->wide);
    }
}

/* Scales w so that the forces expected close gaps of the size seen, adds the variances, and turns the sign back. */
static void regi_loads_balance(regi_loads *l)
{
    size_t samples = (size_t)l->sample_count;
    double gaps = 0, trace = 0;
    sb_real scale, least;
    int count = 0;
    for (size_t s = 0; s < samples; s++)
        if (l->variance[s] > 0) {
            gaps += (double)l->gap[s] * (double)l->gap[s];
            trace -= (double)l->system[s * samples + s];
            count++;
        }
    scale = (sb_real)(trace > 0 ? gaps / trace : 0);
    least = count > 0 ? 16 * SB_EPSILON * scale * (sb_real)(trace / count) : 0; /* what its rounding takes */
    for (int k = 0; k < l->load_count; k++)
        l->weight[k] *= scale;
    for (size_t j = 0; j < samples; j++)
        for (size_t s = j; s < samples; s++) {
            sb_real *entry = l->system + j * samples + s;
            int off = !(l->variance[s] > 0 && l->variance[j] > 0);
            *entry = off ? (sb_real)(s == j) : -scale * *entry + (s == j ? l->variance[s] + least : 0);
            for (int k = 0; k < REGI_LOADS_FREE && !off; k++)
                *entry += l->free_rows[s * REGI_LOADS_FREE + (size_t)k] * l->free_rows[j * REGI_LOADS_FREE + (size_t)k];
        }
}

/* One weighted least squares problem: w, y, f. */
static sb_result regi_loads_solve(regi_loads *l, sb_error *error)
{
    size_t samples = (size_t)l->sample_count;
    sb_direct_info info;
    regi_loads_weigh(l);
    regi_loads_gram(l);
    regi_loads_balance(l);
    memset(&info, 0, sizeof info);
    for (size_t s = 0; s < samples; s++) {
        l->sizes[s] = l->system[s * samples + s];
        l->multiplier[s] = l->variance[s] > 0 ? l->gap[s] : 0;
    }
    if (sbi_front_factor(l->system, samples, samples, 0, l->signs, l->sizes, l->pack, l->wide, &info) >= 0)
        return sbi_fail(error, SB_ERROR_INDEFINITE, "the samples of the surface cannot be told apart");
    sbi_front_forward(l->system, samples, samples, l->multiplier, 1, l->wide);
    sbi_front_backward(l->system, samples, samples, l->multiplier, 1, l->wide);
    for (int k = 0; k < l->load_count; k++) {
        sb_real sum[3] = {0, 0, 0};
        for (int axis = 0; axis < 3; axis++) {
            const sb_real *row = l->response + (3 * (size_t)k + (size_t)axis) * samples;
            for (size_t s = 0; s < samples; s++)
                sum[axis] += row[s] * l->multiplier[s];
        }
        l->force[l->load_nodes[k]] = sb_v3_scale(l->weight[k], sb_v3(sum[0], sum[1], sum[2]));
    }
    for (int k = 0; k < REGI_LOADS_POSE; k++) {
        l->next[k] = 0;
        for (size_t s = 0; s < samples && l->posed; s++)
            l->next[k] += l->likely[k] * l->free_rows[s * REGI_LOADS_FREE + (size_t)k] * l->multiplier[s];
    }
    return SB_OK;
}

static sb_result regi_loads_reweight(regi_loads *l, int times, sb_error *error)
{
    sb_result result = SB_OK;
    for (int k = 0; result == SB_OK && k < times; k++)
        result = regi_loads_solve(l, error);
    return result;
}

/* What the solution leaves of the gaps of the surface: variance times y. */
static sb_real regi_loads_misfit(const regi_loads *l)
{
    double sum = 0;
    int count = 0;
    for (int s = 0; s < l->drag_sample; s++)
        if (l->sample_of[s] < l->part_count && l->variance[s] > 0) {
            double left = (double)(l->variance[s] * l->multiplier[s]);
            sum += left * left;
            count++;
        }
    return (sb_real)(count > 0 ? sb_sqrt((sb_real)(sum / count)) : 0);
}

/* Adds what is new of the pose to the increment. */
static void regi_loads_turn(regi_loads *l)
{
    sb_real d[REGI_LOADS_POSE];
    sb_vec3 way;
    sb_mat3 rotation;
    for (int k = 0; k < REGI_LOADS_POSE; k++)
        d[k] = l->next[k] - l->pose[k];
    way = sb_v3_add(l->centre, sb_v3(d[0], d[1], d[2]));
    rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(d[3], d[4], d[5])));
    for (int i = 0; i < l->node_count; i++) {
        sb_vec3 x = sb_body_positions(l->body)[i], turned = sb_m3_apply(rotation, sb_v3_sub(x, l->centre));
        sb_vec3 step = sb_m3_apply(rotation, l->increment[i]);
        l->increment[i] = sb_v3_add(step, sb_v3_sub(sb_v3_add(turned, way), x));
    }
}

/* Sends held nodes to displacements[nodes]. */
static void regi_loads_hold(regi_loads *l, const sb_vec3 *displacements)
{
    for (int axes = 1; axes <= SB_XYZ; axes++) {
        int count = 0;
        for (int i = 0; i < l->node_count; i++)
            if (l->fixed[i] == axes) {
                l->held_nodes[count] = i;
                l->held_goals[count++] = displacements[i];
            }
        if (count > 0)
            (void)sb_body_prescribe(l->body, l->held_nodes, count, axes, l->held_goals, 0);
    }
}

/* The increment is taken, and the body's supports go along with the pose. */
static sb_result regi_loads_move(regi_loads *l, sb_error *error)
{
    sb_real planned = 0, share;
    sb_result result;
    if (l->posed)
        regi_loads_turn(l);
    for (int i = 0; i < l->node_count; i++)
        planned = sb_max(planned, sb_v3_norm(l->increment[i]));
    result = regi_match_shorten(l->match, l->increment);
    if (result != SB_OK) {
        if (error)
            *error = l->match->info.error;
        return result;
    }
    sbi_body_place(l->body, l->match->trial);
    l->info.change = l->match->info.change;
    share = planned > 0 ? l->info.change / planned : 1;
    for (int k = 0; k < REGI_LOADS_POSE; k++)
        l->pose[k] += share * (l->next[k] - l->pose[k]);
    if (l->posed)
        regi_loads_hold(l, sb_body_displacements(l->body));
    return SB_OK;
}

static sb_result regi_loads_round(regi_loads *l, int round, sb_error *error)
{
    double begin = regi_loads_now(l), responded;
    int reweights = round == 0 ? l->def->reweights : (l->def->reweights + 2) / 3;
    sb_result result;
    (void)regi_match_look(l->match);
    l->info.mean_distance = l->match->info.mean_distance;
    if (!(l->match->info.active > 0))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "nothing of the organ's surface is near the target");
    result = regi_loads_stiffness(l, error);
    if (result != SB_OK)
        return result;
    regi_loads_pool(l);
    regi_loads_find_drag(l, round);
    regi_loads_list_samples(l);
    regi_loads_respond(l);
    responded = regi_loads_now(l);
    l->info.seconds_response += responded - begin;
    result = regi_loads_reweight(l, reweights, error);
    if (result == SB_OK && regi_loads_refuse_drag(l))
        result = regi_loads_reweight(l, reweights, error);
    l->info.seconds_dense += regi_loads_now(l) - responded;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < l->node_count; i++)
        l->increment[i] = sbi_body_pick_axes(l->fixed[i], sb_v3(0, 0, 0), sb_v3_sub(l->force[i], l->residual[i]));
    (void)sb_direct_solve(l->direct, &l->increment[0].x, &l->increment[0].x, 1);
    l->info.sample_misfit = regi_loads_misfit(l);
    result = regi_loads_move(l, error);
    l->info.rounds += result == SB_OK;
    return result;
}

/* ---- life ---- */

static void regi_loads_layout(regi_loads *l, sbi_arena *arena)
{
    size_t n = (size_t)l->node_count, charges = (size_t)l->match->charge_count, samples = (size_t)l->sample_most;
    size_t skin = (size_t)l->boundary.surface.node_count, real = sizeof(sb_real);
    l->load_nodes = (int *)sbi_arena_take(arena, skin, sizeof(int));
    l->sample_of = (int *)sbi_arena_take(arena, samples, sizeof(int));
    l->area = (sb_real *)sbi_arena_take(arena, n, real);
    l->part = (int *)sbi_arena_take(arena, charges, sizeof(int));
    l->part_start = (int *)sbi_arena_take(arena, (size_t)l->part_count + 1, sizeof(int));
    l->part_charges = (int *)sbi_arena_take(arena, charges, sizeof(int));
    l->part_centre = (int *)sbi_arena_take(arena, (size_t)l->part_count, sizeof(int));
    l->part_load = (sb_real *)sbi_arena_take(arena, (size_t)l->part_count, real);
    l->is_dragged = (unsigned char *)sbi_arena_take(arena, (size_t)l->part_count, 1);
    l->votes = (unsigned char *)sbi_arena_take(arena, (size_t)l->part_count, 1);
    l->drag_parts = (int *)sbi_arena_take(arena, (size_t)l->part_count, sizeof(int));
    l->spread = (sb_real *)sbi_arena_take(arena, charges, real);
    l->rows = (sb_real *)sbi_arena_take(arena, n, 3 * SBI_FRONT_GROUP * real);
    l->response = (sb_real *)sbi_arena_take(arena, skin, 3 * samples * real);
    l->gap = (sb_real *)sbi_arena_take(arena, samples, real);
    l->variance = (sb_real *)sbi_arena_take(arena, samples, real);
    l->system = (sb_real *)sbi_arena_take(arena, samples, samples * real);
    l->multiplier = (sb_real *)sbi_arena_take(arena, samples, real);
    l->signs = (sb_real *)sbi_arena_take(arena, samples, real);
    l->sizes = (sb_real *)sbi_arena_take(arena, samples, real);
    l->slab = (sb_real *)sbi_arena_take(arena, REGI_LOADS_SLAB + samples, REGI_LOADS_SLAB * real);
    l->pack = (sb_real *)sbi_arena_take(arena, SBI_FRONT_PACK, real);
    l->weight = (sb_real *)sbi_arena_take(arena, skin, real);
    l->traction = (sb_real *)sbi_arena_take(arena, n, real);
    l->average = (sb_real *)sbi_arena_take(arena, n, real);
    l->touch = (sb_real *)sbi_arena_take(arena, n, real);
    l->force = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->residual = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->increment = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->held_nodes = (int *)sbi_arena_take(arena, n, sizeof(int));
    l->held_goals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->before = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->goals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->free_rows = (sb_real *)sbi_arena_take(arena, samples, REGI_LOADS_FREE * real);
}

/* A turn moves points at a quarter of the organ's size as far as a move does. */
static void regi_loads_begin_pose(regi_loads *l)
{
    int held = 0, count = 0;
    for (int i = 0; i < l->node_count; i++)
        held += l->fixed[i] == SB_XYZ;
    l->posed = l->def->pose > 0;
    for (int i = 0; i < l->node_count; i++)
        if (held == 0 || l->fixed[i] == SB_XYZ)
            l->centre =
                sb_v3_madd(l->centre, 1 / (sb_real)++count, sb_v3_sub(sb_body_positions(l->body)[i], l->centre));
    for (int k = 0; k < REGI_LOADS_POSE; k++)
        l->likely[k] = l->def->pose * (k < 3 ? l->match->size : 4);
    for (int k = REGI_LOADS_POSE; k < REGI_LOADS_FREE; k++)
        l->likely[k] = (sb_real)0.3;
}

/* As many parts as make the samples asked for where the target shows a part of the organ, but at most twice as many. */
static int regi_loads_part_count(const regi_loads *l)
{
    double all = 0, seen = 0, times = 1;
    for (int i = 0; i < l->match->charge_count; i++) {
        all += (double)l->match->charges[i].area;
        seen += l->match->charges[i].active ? (double)l->match->charges[i].area : 0;
    }
    if (l->match->partial)
        times = all < 2 * seen ? all / seen : 2;
    return sbi_min_int((int)(times * l->def->samples), l->match->charge_count);
}

static sb_result regi_loads_prepare(regi_loads *l, sb_error *error)
{
    const sb_allocator *allocator = &l->def->allocator;
    sb_mesh mesh = l->match->mesh;
    sbi_arena arena;
    regi_pieces pieces;
    sb_result result = regi_pieces_make(l->body, &mesh, allocator, &pieces, error);
    if (result == SB_OK)
        result = regi_pieces_skin(&pieces, NULL, &l->boundary, error);
    regi_pieces_free(&pieces);
    if (result == SB_OK)
        result = sbi_body_make_factor(l->body, allocator, &l->direct, error);
    if (result != SB_OK)
        return result;
    l->node_count = mesh.node_count;
    l->wide = sbi_lanes_are_wide();
    l->part_count = regi_loads_part_count(l);
    l->drag_first = l->part_count + 3 * l->match->landmark_count;
    l->drag_most = l->def->drag > 0 ? l->part_count / 3 : 0;
    l->drag_looks = l->drag_most > 0 ? REGI_LOADS_LOOKS : 0;
    l->sample_most = (l->drag_first + 2 * l->drag_most + 2) / 3 * 3;
    memset(&arena, 0, sizeof arena);
    regi_loads_layout(l, &arena);
    l->memory = arena.overflow ? NULL : sbi_alloc_zeroed(allocator, 1, arena.used);
    if (!l->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d samples of the surface", l->sample_most);
    arena.base = (unsigned char *)l->memory;
    arena.used = 0;
    regi_loads_layout(l, &arena);
    memcpy(l->before, sb_body_displacements(l->body), (size_t)l->node_count * sizeof(sb_vec3));
    memcpy(l->goals, sbi_body_targets(l->body), (size_t)l->node_count * sizeof(sb_vec3));
    regi_loads_begin_pose(l);
    regi_loads_measure_nodes(l);
    regi_loads_cut_parts(l);
    return l->load_count > 0 ? SB_OK : sbi_fail(error, SB_ERROR_ARGUMENT, "all of the surface is held");
}

/* 1 when there is no time for a round that takes as long as those before, or a first one. */
static int regi_loads_is_late(const regi_loads *l)
{
    double spent = l->def->clock ? l->def->clock() - l->begun : 0;
    double round = l->info.rounds ? (l->info.seconds_response + l->info.seconds_dense) / l->info.rounds : 0;
    return l->def->clock && spent + round >= l->def->max_seconds;
}

/* Rounds, and what they found; a failure puts the body back. */
static sb_result regi_loads_find(regi_loads *l, sb_vec3 *forces, sb_error *error)
{
    sb_result result = regi_loads_prepare(l, error);
    double loaded = 0;
    sb_real most;
    if (result != SB_OK)
        return result;
    l->info.change = l->match->size;
    for (int round = 0; result == SB_OK && round < l->def->rounds; round++)
        if ((l->drag_looks > 0 || !regi_loads_is_at_rest(l, (sb_real)1e-3)) && !regi_loads_is_late(l))
            result = regi_loads_round(l, round, error);
    if (result != SB_OK) {
        sbi_body_place(l->body, l->before);
        if (l->posed)
            regi_loads_hold(l, l->goals);
        return result;
    }
    most = regi_loads_tractions(l);
    for (int i = 0; i < l->node_count; i++)
        loaded += l->traction[i] > (sb_real)0.05 * most ? (double)l->area[i] : 0;
    l->info.loaded = (sb_real)(loaded / l->total_area);
    l->info.drag = l->drag_count > 0 ? l->drag : sb_v3(0, 0, 0);
    if (forces)
        memcpy(forces, l->force, (size_t)l->node_count * sizeof(sb_vec3));
    return SB_OK;
}

REG_API sb_result reg_loads_run(const reg_loads_def *def, sb_vec3 *forces, reg_loads_info *info)
{
    regi_loads loads;
    sb_result result;
    memset(&loads, 0, sizeof loads);
    loads.info.error.element = loads.info.error.node = -1;
    result = regi_loads_check(def, &loads.info.error);
    if (result == SB_OK) {
        loads.def = def;
        loads.match = def->match;
        loads.body = def->match->body;
        loads.fixed = sb_body_supports(loads.body);
        loads.begun = regi_loads_now(&loads);
        result = regi_loads_find(&loads, forces, &loads.info.error);
        loads.info.seconds = regi_loads_now(&loads) - loads.begun;
        sb_boundary_free(&loads.boundary);
        sb_direct_free(loads.direct);
        sbi_free(&def->allocator, loads.memory);
    }
    if (info)
        *info = loads.info;
    return result;
}
