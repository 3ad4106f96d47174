/* live_momentum: a change of the mesh keeps linear and angular momentum. */
#include "live_private.h"

#include <math.h>
#include <string.h>

/* ---- sums ---- */

static void sbi_live_add_moment(sbi_live_moment *sum, double m, const double p[3], const double turn[3], double size,
                                double turning)
{
    sum->mass += m;
    sum->linear_size += size;
    sum->angular_size += turning;
    for (int i = 0; i < 3; i++) {
        sum->linear[i] += p[i];
        sum->angular[i] += turn[i];
    }
}

static double sbi_live_magnitude(const double v[3]) { return fabs(v[0]) + fabs(v[1]) + fabs(v[2]); }

/* What mass at a node has of each motion. also: other sums that get the same, or NULL. */
static void sbi_live_add_mass(const sb_body *body, int node, double m, sb_vec3 about, int motions,
                              sbi_live_moment *sums, sbi_live_moment *also)
{
    sb_vec3 x = body->position[node];
    const double r[3] = {(double)x.x - (double)about.x, (double)x.y - (double)about.y, (double)x.z - (double)about.z};
    double reach = sbi_live_magnitude(r);
    for (int k = 0; k < motions; k++) {
        sb_vec3 v = k == 0 ? body->velocity[node] : body->acceleration[node];
        const double p[3] = {m * (double)v.x, m * (double)v.y, m * (double)v.z};
        const double turn[3] = {r[1] * p[2] - r[2] * p[1], r[2] * p[0] - r[0] * p[2], r[0] * p[1] - r[1] * p[0]};
        double size = sbi_live_magnitude(p);
        sbi_live_add_moment(sums + k, m, p, turn, size, size * reach);
        if (also)
            sbi_live_add_moment(also + k, m, p, turn, size, size * reach);
    }
}

/* Lumped masses (kg) of a cell at its nodes. */
static void sbi_live_cell_masses(const sb_body *body, int e, sb_real masses[SB_MAX_ELEMENT_NODES])
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], density;
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell;
    const int *cell = body->domain.cells + (size_t)e * (size_t)n;
    if (body->live->follows) {
        for (int a = 0; a < 4; a++)
            masses[a] = body->live->masses[4 * (size_t)e + (size_t)a][0];
        return;
    }
    memset(x, 0, sizeof x); /* compilers cannot see that n > 0 */
    for (int a = 0; a < n; a++)
        x[a] = body->reference[cell[a]];
    sbi_body_cell_mass(body, e, SB_MASS_LUMPED, x, mass, NULL);
    density = sbi_live_density(body, e);
    for (int a = 0; a < n; a++)
        masses[a] = density * mass[a * n + a];
}

SBI_API void sbi_live_add_cell(const sb_body *body, int e, sb_vec3 about, int motions, sbi_live_moment *sums,
                               sbi_live_moment *also)
{
    sb_real masses[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell;
    const int *cell = body->domain.cells + (size_t)e * (size_t)n;
    sbi_live_cell_masses(body, e, masses);
    for (int a = 0; a < n; a++)
        sbi_live_add_mass(body, cell[a], (double)masses[a], about, motions, sums, also);
}

/* Masses of cells, gathered by node: a node has many of them, and its motion is read once. In the body's scratch: x of
 * all cells, y of those that another sum counts, too. */
typedef struct sbi_live_gathering {
    const sb_body *body;
    int last; /* 1 + the node listed last, or -1; its node_marks have the one before */
} sbi_live_gathering;

static sbi_live_gathering sbi_live_gather(const sb_body *body)
{
    sbi_live_gathering gathering;
    gathering.body = body;
    gathering.last = -1;
    return gathering;
}

static void sbi_live_gather_cell(sbi_live_gathering *gathering, int e, int also)
{
    const sb_body *body = gathering->body;
    sb_real masses[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell, *marks = body->live->node_marks;
    const int *cell = body->domain.cells + (size_t)e * (size_t)n;
    sbi_live_cell_masses(body, e, masses);
    for (int a = 0; a < n; a++) {
        sb_vec3 *mass = body->work + cell[a];
        if (!marks[cell[a]]) {
            marks[cell[a]] = gathering->last;
            gathering->last = cell[a] + 1;
            mass->x = mass->y = 0;
        }
        mass->x += masses[a];
        mass->y += also ? masses[a] : 0;
    }
}

/* Adds what was gathered; also: NULL, nothing counts there. */
static void sbi_live_add_gathered(sbi_live_gathering *gathering, sb_vec3 about, int motions, sbi_live_moment *sums,
                                  sbi_live_moment *also)
{
    const sb_body *body = gathering->body;
    while (gathering->last > 0) {
        int node = gathering->last - 1, same = also && body->work[node].x == body->work[node].y;
        sbi_live_add_mass(body, node, (double)body->work[node].x, about, motions, sums, same ? also : NULL);
        if (also && !same && body->work[node].y > 0)
            sbi_live_add_mass(body, node, (double)body->work[node].y, about, motions, also, NULL);
        gathering->last = body->live->node_marks[node];
        body->live->node_marks[node] = 0;
    }
}

SBI_API int sbi_live_first_changed(const sbi_mesh_change *change)
{
    for (int i = 0; i < change->made_cell_count; i++)
        if (change->made_parents[i] >= 0)
            return change->made_cells[i];
    return change->reshaped_cell_count ? change->reshaped_cells[0] : -1;
}

SBI_API sbi_live_balance sbi_live_weigh(const sb_body *body, const sbi_mesh_change *change, sb_vec3 about)
{
    unsigned char *has_child = body->live->cell_marks;
    sbi_live_gathering gathering = sbi_live_gather(body);
    sbi_live_balance b;
    memset(&b, 0, sizeof b);
    b.about = about;
    b.motions = body->acceleration_known ? 2 : 1;
    b.is_eaten = body->live->erodes;
    if (b.is_eaten)
        return b;
    for (int i = 0; i < change->made_cell_count; i++)
        if (change->made_parents[i] >= 0)
            has_child[change->made_parents[i]] = 1;
    for (int i = 0; i < change->reshaped_cell_count; i++)
        sbi_live_gather_cell(&gathering, change->reshaped_cells[i], 1);
    for (int i = 0; i < change->removed_cell_count; i++)
        sbi_live_gather_cell(&gathering, change->removed_cells[i], has_child[change->removed_cells[i]]);
    sbi_live_add_gathered(&gathering, about, b.motions, b.all, b.parents);
    for (int i = 0; i < change->made_cell_count; i++)
        if (change->made_parents[i] >= 0)
            has_child[change->made_parents[i]] = 0;
    return b;
}

/* What the cells have after the change that are to have what the balance says. */
static void sbi_live_weigh_next(const sb_body *next, const sbi_mesh_change *change, const sbi_live_balance *before,
                                sbi_live_moment *have)
{
    sbi_live_gathering gathering = sbi_live_gather(next);
    memset(have, 0, SBI_LIVE_MOTIONS * sizeof *have);
    for (int i = 0; i < change->made_cell_count; i++)
        if (change->made_parents[i] >= 0)
            sbi_live_gather_cell(&gathering, change->made_cells[i], 0);
    for (int i = 0; i < change->reshaped_cell_count; i++)
        sbi_live_gather_cell(&gathering, change->reshaped_cells[i], 0);
    sbi_live_add_gathered(&gathering, before->about, before->motions, have, NULL);
}

static void sbi_live_scale_moment(sbi_live_moment *sum, double factor)
{
    sum->linear_size *= factor;
    sum->angular_size *= factor;
    for (int i = 0; i < 3; i++) {
        sum->linear[i] *= factor;
        sum->angular[i] *= factor;
    }
}

/* What the cells made should have: what those they replace had, all that were removed if they weigh as much, else those
 * that have children, by mass. */
static sbi_live_moment sbi_live_wanted(const sbi_live_balance *before, int motion, double made)
{
    sbi_live_moment parents = before->parents[motion];
    double mass = before->all[motion].mass;
    if (fabs(made - mass) <= 1e5 * (double)SB_EPSILON * mass)
        return before->all[motion];
    if (parents.mass > 0)
        sbi_live_scale_moment(&parents, made / parents.mass);
    return parents;
}

/* ---- the rigid motion that makes up for what is missing ---- */

typedef struct sbi_live_missing {
    int is; /* 0: no more than rounding */
    double linear[3], angular[3];
    double velocity[3], spin[3];
} sbi_live_missing;

/* Mass, centre and inertia of the free nodes of cells that changed. */
typedef struct sbi_live_rigid {
    sb_vec3 about;
    double mass, first[3], second[3][3];
    int last; /* 1 + the node listed last, or -1; its node_marks have the one before */
} sbi_live_rigid;

/* Solves the symmetric 3x3 system a x = b by Cramer's rule; 0 when a is nearly singular. */
static int sbi_live_solve3(const double a[3][3], const double b[3], double x[3])
{
    double cofactor[3][3], trace = a[0][0] + a[1][1] + a[2][2], det;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            cofactor[i][j] = a[(i + 1) % 3][(j + 1) % 3] * a[(i + 2) % 3][(j + 2) % 3] -
                             a[(i + 1) % 3][(j + 2) % 3] * a[(i + 2) % 3][(j + 1) % 3];
    det = a[0][0] * cofactor[0][0] + a[0][1] * cofactor[0][1] + a[0][2] * cofactor[0][2];
    if (!(det > 1e-9 * trace * trace * trace))
        return 0;
    for (int i = 0; i < 3; i++)
        x[i] = (cofactor[0][i] * b[0] + cofactor[1][i] * b[1] + cofactor[2][i] * b[2]) / det;
    return 1;
}

/* Differences within rounding are left alone, so that where interpolation keeps the sums no bit changes. Consistent
 * masses keep the angular one by themselves, for their motion is linear in the cells. */
static sbi_live_missing sbi_live_find_missing(const sb_body *next, const sbi_live_moment *want,
                                              const sbi_live_moment *have)
{
    const double rounding = 64 * (double)SB_EPSILON;
    sbi_live_missing m;
    memset(&m, 0, sizeof m);
    for (int i = 0; i < 3; i++) {
        m.linear[i] = want->linear[i] - have->linear[i];
        m.angular[i] = want->angular[i] - have->angular[i];
        m.is |= fabs(m.linear[i]) > rounding * (want->linear_size + have->linear_size);
        m.is |= !next->mass_blocks && fabs(m.angular[i]) > rounding * (want->angular_size + have->angular_size);
    }
    return m;
}

static void sbi_live_sum_node(const sb_body *next, int node, sbi_live_rigid *rigid)
{
    double m = (double)next->lumped_mass[node];
    sb_vec3 x = sb_v3_sub(next->position[node], rigid->about);
    const double r[3] = {(double)x.x, (double)x.y, (double)x.z};
    rigid->mass += m;
    for (int i = 0; i < 3; i++) {
        rigid->first[i] += m * r[i];
        for (int j = 0; j < 3; j++)
            rigid->second[i][j] += m * r[i] * r[j];
    }
}

/* Sums and lists the nodes. */
static void sbi_live_sum_nodes(const sb_body *next, const sbi_mesh_change *change, sbi_live_rigid *rigid)
{
    int n = change->nodes_per_cell, made = change->made_cell_count, *marks = next->live->node_marks;
    rigid->last = -1;
    for (int i = 0; i < made + change->reshaped_cell_count; i++) {
        int e = i < made ? change->made_cells[i] : change->reshaped_cells[i - made];
        const int *cell = next->domain.cells + (size_t)e * (size_t)n;
        for (int a = 0; a < n && (i >= made || change->made_parents[i] >= 0); a++) {
            if (marks[cell[a]] || sbi_body_held(next, cell[a]))
                continue;
            marks[cell[a]] = rigid->last;
            rigid->last = cell[a] + 1;
            sbi_live_sum_node(next, cell[a], rigid);
        }
    }
}

/* Rigid velocity that gives the free nodes these momenta; without spin where they lie in a line or masses couple. */
static void sbi_live_solve_rigid(const sb_body *next, const sbi_live_rigid *rigid, sbi_live_missing *missing)
{
    double centre[3], inertia[3][3], left[3], m = rigid->mass, trace = 0, whole = 0, *spin = missing->spin;
    const double *linear = missing->linear;
    for (int i = 0; i < 3; i++) {
        centre[i] = rigid->first[i] / m;
        whole += rigid->second[i][i];
        trace += rigid->second[i][i] - m * centre[i] * centre[i];
    }
    for (int i = 0; i < 3; i++) {
        left[i] = missing->angular[i] -
                  (centre[(i + 1) % 3] * linear[(i + 2) % 3] - centre[(i + 2) % 3] * linear[(i + 1) % 3]);
        for (int j = 0; j < 3; j++)
            inertia[i][j] = (i == j ? trace : 0) - (rigid->second[i][j] - m * centre[i] * centre[j]);
    }
    if (next->mass_blocks || !(trace > 1e-10 * whole) || /* of one node it is rounding */
        !sbi_live_solve3((const double(*)[3])inertia, left, spin))
        memset(spin, 0, sizeof missing->spin);
    for (int i = 0; i < 3; i++)
        missing->velocity[i] =
            linear[i] / m - (spin[(i + 1) % 3] * centre[(i + 2) % 3] - spin[(i + 2) % 3] * centre[(i + 1) % 3]);
}

static void sbi_live_push_node(const sb_body *next, int node, const sbi_live_rigid *rigid,
                               const sbi_live_missing *missing, sb_vec3 *v)
{
    sb_vec3 x = sb_v3_sub(next->position[node], rigid->about);
    const double r[3] = {(double)x.x, (double)x.y, (double)x.z}, *w = missing->spin;
    v->x += (sb_real)(missing->velocity[0] + w[1] * r[2] - w[2] * r[1]);
    v->y += (sb_real)(missing->velocity[1] + w[2] * r[0] - w[0] * r[2]);
    v->z += (sb_real)(missing->velocity[2] + w[0] * r[1] - w[1] * r[0]);
}

SBI_API void sbi_live_keep_momentum(sb_body *next, const sbi_mesh_change *change, const sbi_live_balance *before)
{
    sbi_live_moment have[SBI_LIVE_MOTIONS];
    sbi_live_missing missing[SBI_LIVE_MOTIONS];
    sbi_live_rigid rigid;
    int some = 0;
    if (before->is_eaten)
        return;
    sbi_live_weigh_next(next, change, before, have);
    for (int k = 0; k < before->motions; k++) {
        sbi_live_moment want = sbi_live_wanted(before, k, have[k].mass);
        missing[k] = sbi_live_find_missing(next, &want, &have[k]);
        some |= missing[k].is;
    }
    if (!some)
        return;
    memset(&rigid, 0, sizeof rigid);
    rigid.about = before->about;
    sbi_live_sum_nodes(next, change, &rigid);
    for (int k = 0; k < before->motions; k++)
        if (missing[k].is && rigid.mass > 0)
            sbi_live_solve_rigid(next, &rigid, &missing[k]);
    while (rigid.last > 0) {
        int node = rigid.last - 1;
        for (int k = 0; k < before->motions; k++)
            if (missing[k].is && rigid.mass > 0)
                sbi_live_push_node(next, node, &rigid, &missing[k],
                                   k == 0 ? next->velocity + node : next->acceleration + node);
        rigid.last = next->live->node_marks[node];
        next->live->node_marks[node] = 0;
    }
}

SBI_API void sbi_live_carry_momentum(const sb_body *body, const sbi_mesh_change *change, sb_body *next)
{
    int first = sbi_live_first_changed(change);
    sbi_live_balance balance;
    if (first < 0)
        return;
    balance = sbi_live_weigh(body, change,
                             next->position[next->domain.cells[(size_t)first * (size_t)change->nodes_per_cell]]);
    sbi_live_keep_momentum(next, change, &balance);
}
