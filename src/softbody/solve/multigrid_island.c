/* multigrid_island: small stiff parts of a soft body, solved by elimination on the finest level. Floor 1.
 *
 * Parts a thousand times as stiff as the softest, and only some nodes wide, bend at necks and edges in ways that no
 * lattice of theirs follows: with lattices alone those motions are the slowest of all (in a beam with twenty balls the
 * least eigenvalue of M^-1 A is then 0.040, in an even one 0.23), and more coarse nodes cost more than they save. But
 * the parts are small, so their own block A_II of the matrix is factored, and M is the elimination of the islands from
 * the matrix, with the cycle in place of what is left:
 *     u_I = A_II^-1 r_I,   z_L = [cycle (0, r_L - A_LI u_I)]_L,   z_I = A_II^-1 (r_I - A_IL z_L)
 * with the islands' rows I and the rows L of the sea around them. It is symmetric and positive definite as the cycle
 * is, however A_II and A_LI are rounded. */
#include <stdlib.h>
#include <string.h>

#include "multigrid_block.h"

/* How much stiffer than the body's softest region an island's is. For less, islands do not save what they cost: twenty
 * balls take 7 iterations with them and 8 without at 1:20, 7 and 11 at 1:100, 7 and 30 at 1:10,000. */
#define SBI_ISLAND_STIFF 50.0
/* The factor of an island of n nodes takes about 35 n^2 (tet4) to 70 n^2 (tet10) multiply-adds. That is worth it while
 * the sum of all n^2 is no more than this many times the level's rows: at 63, one block of 941 nodes in 14,161, update
 * and solve to 1e-2 take 60 ms for 57 without on two threads, and 99 for 115 on one; at 113, one of 2,001 in 35,443,
 * 153 for 102 and 195 for 158. */
#define SBI_ISLAND_SHARE 80.0

/* ---- which ones ---------------------------------------------------------------------------------------- */

/* Nodes of stiff regions that hang together: a run of the list. */
typedef struct sbi_island_run {
    int first, count;
} sbi_island_run;

typedef struct sbi_island_maker {
    int *list;            /* [rows] nodes, run after run */
    unsigned char *mark;  /* [rows] 1: to be listed; 0: no island, or listed */
    int *group;           /* [rows] or -1 */
    int *place;           /* [rows] in the group, or -1 */
    sbi_island_run *runs; /* [rows] */
    int run_count;
} sbi_island_maker;

static int sbi_island_compare(const void *a, const void *b)
{
    const sbi_island_run *p = (const sbi_island_run *)a, *q = (const sbi_island_run *)b;
    if (p->count != q->count)
        return p->count < q->count ? -1 : 1;
    return p->first < q->first ? -1 : p->first > q->first;
}

static double sbi_island_cost(int node_count) { return (double)node_count * (double)node_count; }

/* Marks the nodes of stiff regions that are small enough. */
static void sbi_island_mark(const sbi_mg_regions *regions, double most, unsigned char *mark)
{
    sb_real softest = regions->moduli[0];
    for (int r = 1; r < regions->count; r++)
        softest = sb_min(softest, regions->moduli[r]);
    for (int i = 0; i < regions->row_count; i++) {
        int r = regions->of[i], stiff = (double)regions->moduli[r] > SBI_ISLAND_STIFF * (double)softest;
        mark[i] = stiff && sbi_island_cost(regions->sizes[r]) <= most;
    }
}

/* Lists what hangs together with node i. */
static void sbi_island_walk(const sbi_mg_level *level, sbi_island_maker *maker, int i, sbi_island_run *run)
{
    maker->list[run->first] = i;
    maker->mark[i] = 0;
    run->count = 1;
    for (int head = run->first; head < run->first + run->count; head++) {
        int row = maker->list[head];
        for (int q = level->row_start[row]; q < level->row_start[row + 1]; q++) {
            int j = level->columns[q];
            if (!maker->mark[j])
                continue;
            maker->mark[j] = 0;
            maker->list[run->first + run->count++] = j;
        }
    }
}

/* Finds the runs, and keeps the smallest, as many as cost no more than `most` together; sorted by size. Regions that
 * touch are one run, which may cost too much though each of them does not. */
static void sbi_island_find(const sbi_mg_level *level, double most, sbi_island_maker *maker)
{
    double cost = 0;
    int listed = 0, kept = 0;
    maker->run_count = 0;
    for (int i = 0; i < level->row_count; i++) {
        sbi_island_run *run = maker->runs + maker->run_count;
        if (!maker->mark[i])
            continue;
        run->first = listed;
        sbi_island_walk(level, maker, i, run);
        listed += run->count;
        maker->run_count++;
    }
    qsort(maker->runs, (size_t)maker->run_count, sizeof *maker->runs, sbi_island_compare);
    while (kept < maker->run_count && cost + sbi_island_cost(maker->runs[kept].count) <= most)
        cost += sbi_island_cost(maker->runs[kept++].count);
    maker->run_count = kept;
}

/* ---- groups -------------------------------------------------------------------------------------------- */

/* Deals the runs out to groups of like cost, the largest first. */
static void sbi_island_deal(const sbi_island_maker *maker, sbi_mg_islands *islands, int row_count)
{
    double loads[SBI_MG_ISLANDS];
    islands->count = sbi_min_int(maker->run_count, SBI_MG_ISLANDS);
    for (int i = 0; i < row_count; i++)
        maker->group[i] = -1;
    for (int g = 0; g < islands->count; g++) {
        loads[g] = 0;
        islands->groups[g].count = 0;
    }
    for (int k = maker->run_count - 1; k >= 0; k--) {
        const sbi_island_run *run = maker->runs + k;
        int least = 0;
        for (int g = 1; g < islands->count; g++)
            least = loads[g] < loads[least] ? g : least;
        loads[least] += sbi_island_cost(run->count);
        islands->groups[least].count += run->count;
        for (int e = run->first; e < run->first + run->count; e++)
            maker->group[maker->list[e]] = least;
    }
}

/* Lists the nodes group by group, ascending in each, and marks the shores. Runs do not touch, so an island's
 * neighbours are of its own group or of none. */
static void sbi_island_list(const sbi_mg_level *level, const sbi_island_maker *maker, sbi_mg_islands *islands)
{
    int next[SBI_MG_ISLANDS], first = 0;
    for (int g = 0; g < islands->count; g++) {
        islands->groups[g].rows = islands->rows + first;
        islands->groups[g].exact = islands->exact + 3 * (size_t)first;
        first += islands->groups[g].count;
        next[g] = 0;
    }
    memset(islands->side, SBI_MG_SEA, (size_t)level->row_count);
    for (int i = 0; i < level->row_count; i++) {
        int g = maker->group[i];
        maker->place[i] = -1;
        if (g < 0)
            continue;
        maker->place[i] = next[g];
        islands->groups[g].rows[next[g]++] = i;
        islands->side[i] = SBI_MG_ISLAND;
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++)
            if (maker->group[level->columns[q]] < 0)
                islands->side[level->columns[q]] = SBI_MG_SHORE;
    }
}

static int sbi_island_take(sbi_multigrid *m, const sbi_island_maker *maker)
{
    sbi_mg_islands *islands = &m->islands;
    const sbi_mg_level *level = m->levels;
    size_t rows = (size_t)level->row_count, total = 0;
    for (int k = 0; k < maker->run_count; k++)
        total += (size_t)maker->runs[k].count;
    islands->rows = (int *)sbi_owned_take(&m->owned, total, sizeof(int));
    islands->exact = (sb_real *)sbi_owned_take(&m->owned, total, 3 * sizeof(sb_real));
    islands->side = (unsigned char *)sbi_owned_take(&m->owned, rows, 1);
    islands->motion = sbi_owned_take_floats(&m->owned, rows, 4);
    if (!islands->rows || !islands->exact || !islands->side || !islands->motion)
        return 0;
    sbi_island_deal(maker, islands, level->row_count);
    sbi_island_list(level, maker, islands);
    for (int g = 0; g < islands->count; g++) {
        sbi_mg_island_group *group = islands->groups + g;
        if (!sbi_mg_take_direct(m, level, group->rows, group->count, maker->place, &group->matrix, &group->direct))
            return 0;
    }
    return 1;
}

SBI_API int sbi_mg_take_islands(sbi_multigrid *m)
{
    size_t rows = (size_t)m->levels[0].row_count;
    double most = SBI_ISLAND_SHARE * (double)rows;
    sbi_island_maker maker;
    int made = 0;
    if (m->regions.count == 0)
        return 1;
    maker.list = (int *)sbi_alloc(&m->owned.allocator, rows, 3 * sizeof(int));
    maker.runs = (sbi_island_run *)sbi_alloc(&m->owned.allocator, rows, sizeof *maker.runs);
    maker.mark = (unsigned char *)sbi_alloc(&m->owned.allocator, rows, 1);
    if (maker.list && maker.runs && maker.mark) {
        maker.place = maker.list + rows;
        maker.group = maker.place + rows;
        sbi_island_mark(&m->regions, most, maker.mark);
        sbi_island_find(m->levels, most, &maker);
        made = maker.run_count == 0 || sbi_island_take(m, &maker);
    }
    sbi_free(&m->owned.allocator, maker.list);
    sbi_free(&m->owned.allocator, maker.runs);
    sbi_free(&m->owned.allocator, maker.mark);
    return made;
}

SBI_API void sbi_mg_free_islands(sbi_mg_islands *islands)
{
    for (int g = 0; g < islands->count; g++) {
        sb_direct_free(islands->groups[g].direct);
        sb_matrix_free(&islands->groups[g].matrix);
    }
}

/* ---- update -------------------------------------------------------------------------------------------- */

/* What the tasks of the groups see. */
typedef struct sbi_island_work {
    sbi_mg_islands *islands;
    const sbi_mg_level *level;
    const sb_matrix *matrix;
    double scale;
    const sb_real *in;
    sb_real factor;
} sbi_island_work;

/* What rounding takes from the coupling of row i with the sea comes to its diagonal block, so that the island still
 * follows a translation of the sea: jumps of 1e6 take two thirds to a half of the iterations by that, those of 1,000
 * one less. */
static void sbi_island_mend_row(const sbi_island_work *work, int i, sb_real *diagonal)
{
    const sbi_mg_level *level = work->level;
    const double own = 1 / ((double)level->scale[4 * (size_t)i + 3] * (double)SBI_MG_ONE);
    double lost[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (int q = level->row_start[i], at = work->matrix->row_start[i]; q < level->row_start[i + 1]; q++, at++) {
        const int16_t *packed = level->packed + 9 * (size_t)q;
        double unit = own / (double)level->scale[4 * (size_t)level->columns[q] + 3];
        if (work->islands->side[level->columns[q]] == SBI_MG_ISLAND)
            continue;
        for (int e = 0; e < 9; e++)
            lost[e] += (double)work->matrix->blocks[at][e] * work->scale - packed[e] * unit;
    }
    for (int e = 0; e < 9; e++)
        diagonal[e] += (sb_real)((lost[e] + lost[3 * (e % 3) + e / 3]) / 2);
}

/* The group's block of the matrix. */
static void sbi_island_fill(const sbi_island_work *work, sbi_mg_island_group *group)
{
    const sbi_mg_level *level = work->level;
    const sb_real scale = (sb_real)work->scale;
    int own = 0;
    for (int k = 0; k < group->count; k++) {
        int i = group->rows[k], at = work->matrix->row_start[i];
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++, at++) {
            if (work->islands->side[level->columns[q]] != SBI_MG_ISLAND)
                continue;
            for (int e = 0; e < 9; e++)
                group->matrix.blocks[own][e] = work->matrix->blocks[at][e] * scale;
            own++;
        }
        sbi_island_mend_row(work, i, group->matrix.blocks[group->matrix.diagonal[k]]);
    }
    SB_ASSERT(own == group->matrix.block_count);
}

static void sbi_island_stiffen(sbi_mg_island_group *group, double shift)
{
    for (int k = 0; k < group->count; k++)
        for (int e = 0; e < 9; e += 4)
            group->matrix.blocks[group->matrix.diagonal[k]][e] *= (sb_real)(1 + shift);
}

/* Single precision may take a stiff part that hangs on next to nothing for one with a negative stiffness; shifts beyond
 * what pivots are refused for (32 units in the last place) make up for that. */
static void sbi_island_factor_task(void *user, int task)
{
    static const double units[3] = {0, 64, 512};
    const sbi_island_work *work = (const sbi_island_work *)user;
    sbi_mg_island_group *group = work->islands->groups + task;
    sb_result result = SB_ERROR_INDEFINITE;
    sbi_island_fill(work, group);
    for (int attempt = 0; attempt < 3 && result == SB_ERROR_INDEFINITE; attempt++) {
        sbi_island_stiffen(group, units[attempt] * (double)SB_EPSILON);
        result = sb_direct_update(group->direct, &group->matrix, NULL);
    }
    group->ready = result == SB_OK;
}

static sbi_island_work sbi_island_begin_work(sbi_multigrid *m)
{
    sbi_island_work work;
    memset(&work, 0, sizeof work);
    work.islands = &m->islands;
    work.level = m->levels;
    return work;
}

SBI_API void sbi_mg_factor_islands(sbi_multigrid *m, const sb_matrix *matrix, double scale)
{
    sbi_island_work work = sbi_island_begin_work(m);
    work.matrix = matrix;
    work.scale = scale;
    sbi_run(&m->jobs, sbi_island_factor_task, &work, m->islands.count);
    m->islands.ready = m->islands.count > 0;
    for (int g = 0; g < m->islands.count; g++)
        m->islands.ready &= m->islands.groups[g].ready;
}

/* ---- solving ------------------------------------------------------------------------------------------- */

/* What was solved for, as the level's vectors are scaled. */
static void sbi_island_write(const sbi_mg_level *level, const sbi_mg_island_group *group, float *vector)
{
    for (int k = 0; k < group->count; k++) {
        size_t i = 4 * (size_t)group->rows[k];
        for (size_t c = 0; c < 3; c++)
            vector[i + c] = (float)(group->exact[3 * (size_t)k + c] / (sb_real)level->scale[i + 3]);
    }
}

/* u_I, see above. */
static void sbi_island_leave_task(void *user, int task)
{
    const sbi_island_work *work = (const sbi_island_work *)user;
    const sbi_mg_island_group *group = work->islands->groups + task;
    for (int k = 0; k < group->count; k++)
        for (size_t c = 0; c < 3; c++)
            group->exact[3 * (size_t)k + c] = work->in[3 * (size_t)group->rows[k] + c] * work->factor;
    sb_direct_solve(group->direct, group->exact, group->exact, 1);
    sbi_island_write(work->level, group, work->islands->motion);
}

/* z_I, see above, where x is 0 on all islands. */
static void sbi_island_reach_task(void *user, int task)
{
    const sbi_island_work *work = (const sbi_island_work *)user;
    const sbi_mg_level *level = work->level;
    const sbi_mg_island_group *group = work->islands->groups + task;
    for (int k = 0; k < group->count; k++) {
        size_t i = (size_t)group->rows[k];
        sbi_float4 row = sbi_mg_multiply_row(level, (int)i, level->x);
        const sb_real back = 1 / (sb_real)level->scale[4 * i + 3];
        for (int c = 0; c < 3; c++)
            group->exact[3 * (size_t)k + (size_t)c] =
                work->in[3 * i + (size_t)c] * work->factor - (sb_real)SBI_F4(row, c) * back;
    }
    sb_direct_solve(group->direct, group->exact, group->exact, 1);
}

static void sbi_island_run_tasks(sbi_multigrid *m, sb_task task, const sb_real *in, sb_real factor)
{
    sbi_island_work work = sbi_island_begin_work(m);
    work.in = in;
    work.factor = factor;
    sbi_run(&m->jobs, task, &work, m->islands.count);
}

SBI_API void sbi_mg_leave_islands(sbi_multigrid *m, const sb_real *in, sb_real factor)
{
    sbi_island_run_tasks(m, sbi_island_leave_task, in, factor);
}

/* Tasks read x beside their own rows (vectors of eight floats, two nodes): it is not theirs to write. */
SBI_API void sbi_mg_reach_islands(sbi_multigrid *m, const sb_real *in, sb_real factor)
{
    const sbi_mg_islands *islands = &m->islands;
    float *x = m->levels[0].x;
    for (int g = 0; g < islands->count; g++)
        for (int k = 0; k < islands->groups[g].count; k++)
            sbi_f4_store(x + 4 * (size_t)islands->groups[g].rows[k], sbi_f4_make(0, 0, 0));
    sbi_island_run_tasks(m, sbi_island_reach_task, in, factor);
    for (int g = 0; g < islands->count; g++)
        sbi_island_write(m->levels, islands->groups + g, x);
}
