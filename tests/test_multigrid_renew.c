/* Tests of multigrids made like one before, of a mesh that has changed since: all that they consist of is what it is of
 * one made afresh, and what did not change is taken over. They look at what is internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/solve/multigrid_level.h"
#include "../src/softbody/solve/precond_private.h"

#include "check.h"
#include "scene.h"

/* ---- comparing ---- */

static int same_bytes(const void *a, const void *b, size_t count, size_t size)
{
    return (a == NULL) == (b == NULL) && (!a || memcmp(a, b, count * size) == 0);
}

static void check_plans(const sbi_mg_level *a, const sbi_mg_level *b)
{
    size_t n = (size_t)a->row_count, coarse = (size_t)a[1].row_count, entries, mixed, slots, blocks, sums;
    CHECK(same_bytes(a->parent_start, b->parent_start, n + 1, sizeof(int)));
    CHECK(same_bytes(a->child_start, b->child_start, coarse + 1, sizeof(int)));
    CHECK(same_bytes(a->mixed_start, b->mixed_start, n + 1, sizeof(int)));
    CHECK(same_bytes(a->slot_start, b->slot_start, n + 1, sizeof(int)));
    entries = (size_t)a->parent_start[n];
    mixed = (size_t)a->mixed_start[n];
    slots = (size_t)a->slot_start[n];
    CHECK(same_bytes(a->parents, b->parents, entries, sizeof(int)));
    CHECK(same_bytes(a->shares, b->shares, entries, sizeof(float)));
    CHECK(same_bytes(a->children, b->children, entries, sizeof(int)));
    CHECK(same_bytes(a->child_shares, b->child_shares, entries, sizeof(float)));
    CHECK(same_bytes(a->slots, b->slots, slots, sizeof(int)));
    CHECK(same_bytes(a->mixed_columns, b->mixed_columns, mixed, sizeof(int)));
    blocks = (size_t)a[1].block_count;
    CHECK_INT(b[1].block_count, a[1].block_count);
    CHECK(same_bytes(a->sum_start, b->sum_start, blocks + 1, sizeof(size_t)));
    sums = a->sum_start[blocks];
    CHECK(same_bytes(a->sum_blocks, b->sum_blocks, sums, sizeof(int)));
    CHECK(same_bytes(a->sum_shares, b->sum_shares, sums, sizeof(float)));
    for (size_t q = 0; q < blocks; q++) /* those below the diagonal have one */
        CHECK(a->sum_start[q] < a->sum_start[q + 1] || a->twins[q] == b->twins[q]);
}

static void check_level(const sbi_mg_level *a, const sbi_mg_level *b)
{
    size_t n = (size_t)a->row_count;
    CHECK_INT(b->row_count, a->row_count);
    CHECK_INT(b->block_count, a->block_count);
    CHECK(same_bytes(a->row_start, b->row_start, n + 1, sizeof(int)));
    CHECK(same_bytes(a->columns, b->columns, (size_t)a->block_count, sizeof(int)));
    CHECK(same_bytes(a->diagonal, b->diagonal, n, sizeof(int)));
    CHECK(same_bytes(a->places, b->places, n, sizeof(sb_vec3)));
    CHECK(same_bytes(a->spacings, b->spacings, n, sizeof(double)));
    CHECK(same_bytes(a->points, b->points, n, sizeof(int64_t)));
    CHECK(same_bytes(a->positions, b->positions, n, sizeof(sb_vec3)));
    CHECK((a->packed == NULL) == (b->packed == NULL) && (a->parents == NULL) == (b->parents == NULL));
    CHECK(a->degree == b->degree && a->twice == b->twice);
}

static void check_same(const sbi_multigrid *a, const sbi_multigrid *b)
{
    int alike = a->level_count == b->level_count;
    CHECK_INT(b->level_count, a->level_count);
    for (int l = 0; l < a->level_count && alike; l++) {
        CHECK_INT(b->levels[l].row_count, a->levels[l].row_count);
        alike = a->levels[l].row_count == b->levels[l].row_count;
    }
    if (!alike)
        return;
    for (int l = 0; l < a->level_count; l++)
        check_level(a->levels + l, b->levels + l);
    for (int l = 0; l + 1 < a->level_count; l++)
        check_plans(a->levels + l, b->levels + l);
    CHECK_INT(b->small, a->small);
    CHECK_INT(b->longest_row, a->longest_row);
    CHECK_INT(b->couples_parts, a->couples_parts);
    CHECK_INT(b->regions.count, a->regions.count);
}

/* ---- meshes that change ---- */

typedef struct changing {
    sb_mesh mesh;
    int room; /* nodes there can be */
    double size;
    unsigned long long seed;
} changing;

static changing changing_make(int trial)
{
    changing c;
    const int n = 3 + trial % 4, wide = 2 * n + trial % 3;
    sb_vec3 *nodes;
    c.size = pow(10, trial % 3 * 3 - 3);
    c.seed = 77 + (unsigned long long)trial;
    c.mesh = scene_box(SB_TET4, wide, n, n, sb_v3(REAL(2 * c.size), REAL(c.size), REAL(c.size)), trial % 2 ? 0.2 : 0);
    c.room = 4 * c.mesh.node_count;
    nodes = (sb_vec3 *)malloc((size_t)c.room * sizeof *nodes);
    memcpy(nodes, c.mesh.nodes, (size_t)c.mesh.node_count * sizeof *nodes);
    free(c.mesh.nodes);
    c.mesh.nodes = nodes;
    return c;
}

static double random_below(changing *c, double high) { return check_random_in(&c->seed, 0, high); }

static sb_vec3 element_middle(const sb_mesh *mesh, int e)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int k = 0; k < 4; k++)
        sum = sb_v3_add(sum, sb_v3_scale(REAL(0.25), mesh->nodes[mesh->elements[4 * e + k]]));
    return sum;
}

static sb_vec3 random_point(changing *c)
{
    return sb_v3(REAL(random_below(c, 2 * c->size)), REAL(random_below(c, c->size)), REAL(random_below(c, c->size)));
}

/* Copies the nodes near a point for the elements on one side of a plane through it. */
static void change_cut(changing *c)
{
    sb_mesh *mesh = &c->mesh;
    const sb_vec3 at = random_point(c);
    const sb_vec3 normal =
        sb_v3(REAL(random_below(c, 2) - 1), REAL(random_below(c, 2) - 1), REAL(random_below(c, 2) - 1));
    const double radius = random_below(c, 0.6 * c->size);
    int whole = mesh->node_count, *copy = (int *)malloc((size_t)whole * sizeof *copy);
    for (int i = 0; i < whole; i++) {
        sb_vec3 way = sb_v3_sub(mesh->nodes[i], at);
        copy[i] = (double)sb_v3_norm(way) < radius ? -2 : -1;
    }
    for (int e = 0; e < mesh->element_count; e++)
        for (int k = 0; k < 4 && sb_v3_dot(sb_v3_sub(element_middle(mesh, e), at), normal) > 0; k++) {
            int *corner = mesh->elements + 4 * e + k;
            if (*corner >= whole || copy[*corner] == -1)
                continue;
            if (copy[*corner] == -2 && mesh->node_count < c->room) {
                copy[*corner] = mesh->node_count;
                mesh->nodes[mesh->node_count++] = mesh->nodes[*corner];
            }
            *corner = copy[*corner] >= 0 ? copy[*corner] : *corner;
        }
    free(copy);
}

/* Takes elements away; nodes that have none stay. */
static void change_remove(changing *c)
{
    sb_mesh *mesh = &c->mesh;
    const sb_vec3 at = random_point(c);
    const double radius = random_below(c, 0.25 * c->size);
    int kept = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        if ((double)sb_v3_norm(sb_v3_sub(element_middle(mesh, e), at)) < radius && mesh->element_count > 20)
            continue;
        memmove(mesh->elements + 4 * kept++, mesh->elements + 4 * e, 4 * sizeof(int));
    }
    mesh->element_count = kept;
}

/* Nodes go a little way, or anywhere: the lattice asks for places only. */
static void change_move(changing *c)
{
    const int far = random_below(c, 1) < 0.5;
    for (int k = 0; k <= 2; k++) {
        sb_vec3 *node = c->mesh.nodes + (int)random_below(c, c->mesh.node_count - 1);
        sb_vec3 to = random_point(c);
        *node = far ? to : sb_v3(node->x * REAL(0.99), node->y, node->z);
    }
}

/* Takes elements away all over, so that what is left hangs together by little; keeps a share of them. */
static void change_thin_out(changing *c, double share)
{
    sb_mesh *mesh = &c->mesh;
    int kept = 0;
    for (int e = 0; e < mesh->element_count; e++)
        if (random_below(c, 1) < share)
            memmove(mesh->elements + 4 * kept++, mesh->elements + 4 * e, 4 * sizeof(int));
    mesh->element_count = sbi_max_int(kept, 1);
}

/* The last nodes go, with their elements. */
static void change_shrink(changing *c)
{
    sb_mesh *mesh = &c->mesh;
    int end = mesh->node_count - 1 - (int)random_below(c, 5), kept = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        int inside = 1;
        for (int k = 0; k < 4; k++)
            inside &= mesh->elements[4 * e + k] < end;
        if (inside)
            memmove(mesh->elements + 4 * kept++, mesh->elements + 4 * e, 4 * sizeof(int));
    }
    mesh->element_count = kept;
    mesh->node_count = end;
}

static void change_scale(changing *c)
{
    for (int i = 0; i < c->mesh.node_count; i++)
        c->mesh.nodes[i].y *= REAL(1.05);
}

/* One node goes beyond the others: the box grows, and all else stays where it is. */
static void change_box(changing *c)
{
    c->mesh.nodes[(int)random_below(c, c->mesh.node_count - 1)] =
        sb_v3(REAL(2.02 * c->size), REAL(c->size), REAL(-0.02 * c->size));
}

static void change_any(changing *c)
{
    const double kind = random_below(c, 1);
    if (kind < 0.5)
        change_cut(c);
    else if (kind < 0.6)
        change_thin_out(c, 0.9);
    else if (kind < 0.75)
        change_remove(c);
    else if (kind < 0.9)
        change_move(c);
    else if (kind < 0.94)
        change_shrink(c);
    else if (kind < 0.97)
        change_box(c);
    else
        change_scale(c);
}

/* Moduli that jump for elements beyond the middle, or NULL. */
static sb_real *moduli_of(const changing *c, const sb_matrix *pattern, int jumps)
{
    size_t elements = (size_t)c->mesh.element_count;
    sb_real *young, *moduli;
    if (!jumps)
        return NULL;
    young = (sb_real *)malloc((elements + 1) * sizeof *young);
    moduli = (sb_real *)malloc((size_t)pattern->block_count * sizeof *moduli);
    for (int e = 0; e < c->mesh.element_count; e++)
        young[e] = (double)element_middle(&c->mesh, e).x > c->size ? REAL(3e6) : REAL(1000);
    CHECK_OK(sb_preconditioner_moduli(pattern, c->mesh.element_count, 4, c->mesh.elements, young, moduli, NULL));
    free(young);
    return moduli;
}

static sbi_multigrid *multigrid_from(const changing *c, const sbi_multigrid *like, int jumps,
                                     const sb_multigrid_level *own)
{
    sbi_multigrid_setup setup;
    sbi_multigrid *made = NULL;
    sb_matrix pattern;
    sb_real *moduli;
    memset(&setup, 0, sizeof setup);
    setup.levels = own;
    setup.level_count = own != NULL;
    CHECK_OK(
        sb_matrix_create(c->mesh.node_count, c->mesh.element_count, 4, NULL, c->mesh.elements, NULL, &pattern, NULL));
    moduli = moduli_of(c, &pattern, jumps);
    setup.positions = c->mesh.nodes;
    setup.moduli = moduli;
    setup.like = like;
    CHECK_OK(sbi_multigrid_create(&setup, &pattern, NULL, &made, NULL));
    free(moduli);
    sb_matrix_free(&pattern);
    return made;
}

static sbi_multigrid *multigrid_like(const changing *c, const sbi_multigrid *like, int jumps)
{
    return multigrid_from(c, like, jumps, NULL);
}

static void changing_free(changing *c)
{
    free(c->mesh.nodes);
    c->mesh.nodes = NULL;
    sb_mesh_free(&c->mesh);
}

/* Chains of random changes, each made like the one before. */
static void test_afresh(void)
{
    for (int trial = 0; trial < (check_quick() ? 12 : 60); trial++) {
        const int jumps = trial % 5 == 4;
        changing c = changing_make(trial);
        sbi_multigrid *like;
        if (trial % 2 == 1)
            change_thin_out(&c, 0.1 + 0.4 * random_below(&c, 1));
        like = multigrid_like(&c, NULL, jumps);
        for (int change = 0; change < 8; change++) {
            sbi_multigrid *next, *fresh;
            change_any(&c);
            next = multigrid_like(&c, like, jumps);
            fresh = multigrid_like(&c, NULL, jumps);
            check_same(fresh, next);
            sbi_multigrid_free(fresh);
            sbi_multigrid_free(like);
            like = next;
        }
        sbi_multigrid_free(like);
        changing_free(&c);
    }
}

/* How many of a coarse node's children but `without` are reached from the first of them. */
static int children_reached(const sbi_mg_level *level, int coarse, int without, int *queue, int *mark)
{
    const int first = level->child_start[coarse], last = level->child_start[coarse + 1];
    int count = 0;
    for (int c = first; c < last; c++)
        mark[level->children[c]] = level->children[c] != without;
    for (int c = first; c < last && count == 0; c++)
        if (level->children[c] != without) {
            queue[count++] = level->children[c];
            mark[level->children[c]] = 0;
        }
    for (int head = 0; head < count; head++)
        for (int q = level->row_start[queue[head]]; q < level->row_start[queue[head] + 1]; q++)
            if (mark[level->columns[q]]) {
                mark[level->columns[q]] = 0;
                queue[count++] = level->columns[q];
            }
    for (int c = first; c < last; c++)
        mark[level->children[c]] = 0;
    return count;
}

/* Compares a multigrid like `like` with one made afresh of what the mesh is now. */
static void check_next(const changing *c, const sbi_multigrid *like)
{
    sbi_multigrid *next = multigrid_like(c, like, 0), *fresh = multigrid_like(c, NULL, 0);
    check_same(fresh, next);
    sbi_multigrid_free(next);
    sbi_multigrid_free(fresh);
}

/* Takes away the elements of a node that have one of the others as well; the list of all of them stays. */
static void part_node(sb_mesh *mesh, int node, const int *others, int count)
{
    int kept = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *corners = mesh->elements + 4 * e;
        int has_node = 0, has_other = 0, element[4];
        for (int k = 0; k < 4; k++) {
            has_node |= corners[k] == node;
            for (int o = 0; o < count; o++)
                has_other |= corners[k] == others[o];
        }
        if (has_node && has_other)
            continue;
        memcpy(element, corners, sizeof element);
        memcpy(mesh->elements + 4 * kept++, element, sizeof element);
    }
    mesh->element_count = kept;
}

/* Nodes that alone hold the children of a coarse node together move away, though nobody's columns change, or lose the
 * elements on one side, though all nodes stay: what was one is two. */
static void test_bridges(void)
{
    int met = 0;
    for (int trial = 0; trial < 40; trial++) {
        changing c = changing_make(trial);
        int *queue = (int *)calloc(2 * (size_t)c.mesh.node_count, sizeof *queue), *mark = queue + c.mesh.node_count;
        size_t elements;
        int *before, count;
        sbi_multigrid *like;
        const sbi_mg_level *level;
        change_thin_out(&c, 0.15 + 0.3 * random_below(&c, 1));
        count = c.mesh.element_count;
        elements = 4 * (size_t)count;
        before = (int *)malloc(elements * sizeof *before);
        memcpy(before, c.mesh.elements, elements * sizeof *before);
        like = multigrid_like(&c, NULL, 0);
        level = like->levels;
        for (int b = 0, tries = 0; like->level_count > 1 && b < level[1].row_count && tries < 3; b++)
            for (int k = level->child_start[b]; k < level->child_start[b + 1] && tries < 3; k++) {
                const int bridge = level->children[k], others = level->child_start[b + 1] - level->child_start[b] - 1;
                const sb_vec3 place = c.mesh.nodes[bridge];
                const int reached = children_reached(level, b, bridge, queue, mark);
                if (reached == others)
                    continue;
                c.mesh.nodes[bridge] = random_point(&c);
                check_next(&c, like);
                c.mesh.nodes[bridge] = place;
                part_node(&c.mesh, bridge, queue, reached);
                check_next(&c, like);
                memcpy(c.mesh.elements, before, elements * sizeof *before);
                c.mesh.element_count = count;
                tries++;
                met++;
            }
        sbi_multigrid_free(like);
        changing_free(&c);
        free(queue);
        free(before);
    }
    CHECK(met > 20);
}

/* The same with a level of the user's, whose mapping names the nodes that there are: elements go only. */
static void test_own_level(void)
{
    for (int trial = 0; trial < 6; trial++) {
        changing c = changing_make(trial);
        sbi_multigrid *first = multigrid_like(&c, NULL, 0), *like;
        const sbi_mg_level *level = first->levels;
        size_t entries = (size_t)level->parent_start[level->row_count];
        sb_real *weights = (sb_real *)malloc(entries * sizeof *weights);
        sb_multigrid_level own;
        for (size_t e = 0; e < entries; e++)
            weights[e] = (sb_real)level->shares[e];
        own.mapping.row_count = level->row_count;
        own.mapping.row_start = level->parent_start;
        own.mapping.nodes = level->parents;
        own.mapping.weights = weights;
        own.node_count = level[1].row_count;
        own.positions = c.mesh.nodes; /* as many, anywhere */
        like = multigrid_from(&c, NULL, 0, &own);
        for (int change = 0; change < 4; change++) {
            sbi_multigrid *next, *fresh;
            change_remove(&c);
            next = multigrid_like(&c, like, 0);
            fresh = multigrid_from(&c, NULL, 0, &own);
            CHECK(next->levels[1].positions != NULL);
            check_same(fresh, next);
            sbi_multigrid_free(fresh);
            sbi_multigrid_free(like);
            like = next;
        }
        sbi_multigrid_free(like);
        sbi_multigrid_free(first);
        free(weights);
        changing_free(&c);
    }
}

/* ---- what is taken over ---- */

/* Far from a cut, what was falsified before is taken over as it is; at the cut it is made. */
static void test_taken_over(void)
{
    changing c = changing_make(7);
    sbi_multigrid *like = multigrid_like(&c, NULL, 0), *next;
    sbi_mg_level *old = like->levels;
    const int last = c.mesh.node_count - 1; /* a corner, opposite to the first node */
    const int coarse = old->parents[old->parent_start[last]], block = old[1].diagonal[coarse];
    const size_t sum = old->sum_start[block];
    int copied = 0;
    CHECK(like->level_count > 1 && old->sum_start[block + 1] > sum);
    old->spacings[last] *= 1.0001;
    old->slots[old->slot_start[last]] += 1000;
    old->sum_shares[sum] += 1000;
    for (int e = 0; e < c.mesh.element_count && !copied; e++) /* parts the first node of one element */
        for (int k = 0; k < 4 && !copied; k++)
            if (c.mesh.elements[4 * e + k] == 0) {
                c.mesh.nodes[c.mesh.node_count] = c.mesh.nodes[0];
                c.mesh.elements[4 * e + k] = c.mesh.node_count++;
                copied = 1;
            }
    CHECK(copied);
    next = multigrid_like(&c, like, 0);
    CHECK_NEAR(next->levels[0].spacings[last], old->spacings[last], 0);
    CHECK_INT(next->levels[0].slots[next->levels[0].slot_start[last]], old->slots[old->slot_start[last]]);
    {
        const sbi_mg_level *now = next->levels;
        int at = now[1].diagonal[now->parents[now->parent_start[last]]];
        CHECK_NEAR((double)now->sum_shares[now->sum_start[at]], (double)old->sum_shares[sum], 0);
    }
    sbi_multigrid_free(next);
    sbi_multigrid_free(like);
    changing_free(&c);
}

/* ---- bodies that are cut ---- */

static void check_body(const sb_body *body)
{
    sbi_multigrid_setup setup;
    sbi_multigrid *fresh = NULL;
    memset(&setup, 0, sizeof setup);
    setup.positions = body->reference;
    CHECK_OK(sbi_multigrid_create(&setup, &body->matrix, NULL, &fresh, NULL));
    if (fresh)
        check_same(fresh, body->precond->multigrid);
    sbi_multigrid_free(fresh);
}

static void test_bodies(void)
{
    unsigned long long seed = 4;
    for (int trial = 0; trial < (check_quick() ? 3 : 12); trial++) {
        const double size = pow(10, trial % 3 * 3 - 3);
        sb_mesh mesh = scene_box(trial % 4 == 3 ? SB_TET10 : SB_TET4, 6, 4, 4,
                                 sb_v3(REAL(1.5 * size), REAL(size), REAL(size)), trial % 2 ? 0.15 : 0);
        sb_body_def def = sb_default_body_def();
        sb_cut_def cutting = sb_default_cut_def();
        sb_body *body;
        sb_cut *knife = NULL;
        def.mesh = &mesh;
        def.material = sb_material_corotated(10000, REAL(0.4), 1000);
        def.preconditioner = SB_PRECOND_MULTIGRID;
        def.slack = REAL(0.5);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        cutting.body = body;
        cutting.lattice = trial % 3 == 2 ? 1 : 2;
        CHECK_OK(sb_cut_create(&cutting, &knife, NULL));
        for (int stroke = 0; stroke < 6; stroke++) {
            sb_vec3 blade[3];
            for (int k = 0; k < 3; k++)
                blade[k] =
                    sb_v3(REAL(check_random_in(&seed, -0.5, 2) * size), REAL(check_random_in(&seed, -0.5, 1.5) * size),
                          REAL(check_random_in(&seed, -0.5, 1.5) * size));
            CHECK_OK(sb_cut_triangles(knife, blade, 1, NULL, NULL));
            check_body(body);
        }
        sb_cut_destroy(knife);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

CHECK_SUITE(multigrid_renew, {"as made afresh", test_afresh}, {"bridges", test_bridges}, {"own level", test_own_level},
            {"taken over", test_taken_over}, {"bodies that are cut", test_bodies});
