/* Bodies whose mesh changes: slots, transactions, what follows, what is kept, and what is refused. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

/* ---- a mesh is changed at random, and back ---- */

enum { MOST_OPS = 64, MOST_RING = 128 };

typedef enum op_kind { OP_SPLIT_EDGE, OP_SPLIT_FACE, OP_SPLIT_TET, OP_COPY_NODE, OP_REMOVE_CELL, OP_KINDS } op_kind;

/* A change and what is needed to undo it: the cells that it replaced, as they were. */
typedef struct op {
    op_kind kind;
    int corners[4], count;                           /* nodes of what was split, or the node copied */
    int node;                                        /* that was made, or -1 */
    int cells, cell[MOST_RING], nodes[MOST_RING][4]; /* replaced in their slots, and their nodes before */
    int more, more_cell[MOST_RING];                  /* made besides */
    int lost, lost_node[4];                          /* nodes that went with a removed cell, and what made them again */
    sb_vec3 lost_x[4];
} op;

static const int *nodes_of(const sb_body *body, int cell) { return sb_body_cell_nodes(body, cell); }

static int has_nodes(const int *cell, const int *nodes, int count)
{
    int found = 0;
    for (int k = 0; k < count; k++)
        for (int a = 0; a < 4; a++)
            found += cell[a] == nodes[k];
    return found == count;
}

/* A cell in use; -1 after many tries. */
static int pick_cell(const sb_body *body, unsigned long long *seed)
{
    for (int k = 0; k < 1000; k++) {
        int e = (int)(check_random(seed) * sb_body_element_count(body));
        if (sb_body_cell_in_use(body, e))
            return e;
    }
    return -1;
}

/* Splits an edge, face or tet at the weighted point of its corners: each cell about it becomes `count` cells. */
static sb_result split(sb_body *body, op *o, const sb_real *weights, sb_error *error)
{
    sb_body_change *change;
    sb_vec3 x = {0, 0, 0};
    sb_result result = sb_body_change_begin(body, &change, error);
    if (result != SB_OK)
        return result;
    o->cells = o->more = 0;
    for (int e = 0; e < sb_body_element_count(body); e++)
        if (sb_body_cell_in_use(body, e) && has_nodes(nodes_of(body, e), o->corners, o->count) &&
            o->cells < MOST_RING / 4) {
            o->cell[o->cells] = e;
            memcpy(o->nodes[o->cells++], nodes_of(body, e), 4 * sizeof(int));
        }
    for (int k = 0; k < o->count; k++)
        x = sb_v3_madd(x, weights[k], sb_body_rest_positions(body)[o->corners[k]]);
    result = sb_body_change_add_node(change, x, o->corners, weights, o->count, 0, &o->node, error);
    for (int i = 0; i < o->cells && result == SB_OK; i++)
        for (int k = 0; k < o->count && result == SB_OK; k++) { /* corner k gives way to the new node */
            sb_change_cell cell = sb_default_change_cell();
            int nodes[4];
            for (int a = 0; a < 4; a++)
                nodes[a] = o->nodes[i][a] == o->corners[k] ? o->node : o->nodes[i][a];
            cell.nodes = nodes;
            cell.parent = o->cell[i];
            result = k == 0 ? sb_body_change_replace_cell(change, o->cell[i], &cell, error)
                            : sb_body_change_add_cell(change, &cell, &o->more_cell[o->more], error);
            o->more += k > 0;
        }
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

/* A copy of a node takes half of its cells over, as a cut does. */
static sb_result copy_node(sb_body *body, op *o, sb_error *error)
{
    sb_body_change *change;
    sb_real one = 1;
    sb_result result = sb_body_change_begin(body, &change, error);
    int all = 0;
    if (result != SB_OK)
        return result;
    o->cells = o->more = 0;
    for (int e = 0; e < sb_body_element_count(body); e++)
        if (sb_body_cell_in_use(body, e) && has_nodes(nodes_of(body, e), o->corners, 1) && all++ % 2 == 0 &&
            o->cells < MOST_RING) {
            o->cell[o->cells] = e;
            memcpy(o->nodes[o->cells++], nodes_of(body, e), 4 * sizeof(int));
        }
    if (all < 2) {
        sb_body_change_cancel(change);
        o->cells = 0;
        return SB_OK;
    }
    result = sb_body_change_add_node(change, sb_body_rest_positions(body)[o->corners[0]], o->corners, &one, 1,
                                     SB_NODE_COPY, &o->node, error);
    for (int i = 0; i < o->cells && result == SB_OK; i++) {
        sb_change_cell cell = sb_default_change_cell();
        int nodes[4];
        for (int a = 0; a < 4; a++)
            nodes[a] = o->nodes[i][a] == o->corners[0] ? o->node : o->nodes[i][a];
        cell.nodes = nodes;
        cell.parent = o->cell[i];
        result = sb_body_change_replace_cell(change, o->cell[i], &cell, error);
    }
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

/* Takes a cell out that leaves no node without one; cells stays 0 where it would. */
static sb_result remove_cell(sb_body *body, op *o, int e, sb_error *error)
{
    sb_body_change *change;
    sb_result result;
    int counts[4] = {0, 0, 0, 0}, nodes[4];
    memcpy(nodes, nodes_of(body, e), sizeof nodes);
    o->cells = o->more = 0;
    for (int c = 0; c < sb_body_element_count(body); c++)
        for (int a = 0; a < 4 && sb_body_cell_in_use(body, c); a++)
            counts[a] += has_nodes(nodes_of(body, c), nodes + a, 1);
    for (int a = 0; a < 4; a++)
        if (counts[a] < 2)
            return SB_OK;
    result = sb_body_change_begin(body, &change, error);
    if (result != SB_OK)
        return result;
    result = sb_body_change_remove_cell(change, e, error);
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    else {
        o->cell[0] = e;
        memcpy(o->nodes[0], nodes, sizeof nodes);
        o->cells = 1;
    }
    return result;
}

static sb_result undo(sb_body *body, const op *o, sb_error *error)
{
    sb_body_change *change;
    sb_result result = sb_body_change_begin(body, &change, error);
    sb_real weights[4];
    if (result != SB_OK)
        return result;
    for (int k = 0; k < o->count; k++)
        weights[k] = 1 / REAL(o->count);
    for (int i = o->more - 1; i >= 0 && result == SB_OK; i--)
        result = sb_body_change_remove_cell(change, o->more_cell[i], error);
    for (int i = 0; i < o->cells && result == SB_OK; i++) {
        sb_change_cell cell = sb_default_change_cell();
        int made;
        cell.nodes = o->nodes[i];
        cell.parent = o->kind == OP_REMOVE_CELL ? -1 : o->cell[i];
        result = o->kind == OP_REMOVE_CELL ? sb_body_change_add_cell(change, &cell, &made, error)
                                           : sb_body_change_replace_cell(change, o->cell[i], &cell, error);
        if (o->kind == OP_REMOVE_CELL && result == SB_OK)
            CHECK_INT(made, o->cell[i]);
    }
    if (o->kind != OP_REMOVE_CELL && result == SB_OK)
        result = sb_body_change_remove_node(change, o->node, o->corners, weights, o->count, error);
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

/* A random change; cells 0: there was nothing to do. */
static sb_result change_at_random(sb_body *body, unsigned long long *seed, op_kind kind, op *o, sb_error *error)
{
    static const sb_real even[4] = {REAL(0.5), REAL(0.5), REAL(0.25), REAL(0.25)};
    const sb_real third = 1 / REAL(3);
    sb_real weights[4];
    int e = pick_cell(body, seed), first = (int)(check_random(seed) * 4), shift = (int)(check_random(seed) * 3) + 1;
    memset(o, 0, sizeof *o);
    o->kind = kind;
    o->node = -1;
    if (e < 0)
        return SB_OK;
    o->count = kind == OP_SPLIT_EDGE ? 2 : kind == OP_SPLIT_FACE ? 3 : kind == OP_SPLIT_TET ? 4 : 1;
    for (int k = 0; k < o->count; k++) {
        int corner = o->count == 2 ? (first + k * shift) % 4 : (first + k) % 4;
        o->corners[k] = nodes_of(body, e)[corner];
        weights[k] = o->count == 3 ? third : o->count == 4 ? REAL(0.25) : even[k];
    }
    if (kind == OP_COPY_NODE)
        return copy_node(body, o, error);
    if (kind == OP_REMOVE_CELL)
        return remove_cell(body, o, e, error);
    return split(body, o, weights, error);
}

/* ---- what is kept ---- */

typedef struct sums {
    double mass, linear[3], angular[3], linear_size, angular_size;
} sums;

/* Sums over nodes of mass, m v and x x m v; the masses are summed from the cells here. */
static sums sums_of(const sb_body *body, sb_real density)
{
    sums s;
    memset(&s, 0, sizeof s);
    for (int e = 0; e < sb_body_element_count(body); e++) {
        const int *cell = nodes_of(body, e);
        const sb_vec3 *X = sb_body_rest_positions(body);
        double m;
        if (!cell)
            continue;
        m = (double)density * (double)sb_body_cell_share(body, e) / 24 *
            (double)sb_v3_dot(sb_v3_sub(X[cell[1]], X[cell[0]]),
                              sb_v3_cross(sb_v3_sub(X[cell[2]], X[cell[0]]), sb_v3_sub(X[cell[3]], X[cell[0]])));
        for (int a = 0; a < 4; a++) {
            sb_vec3 x = sb_body_positions(body)[cell[a]], v = sb_body_velocities(body)[cell[a]];
            const double r[3] = {(double)x.x, (double)x.y, (double)x.z}, w[3] = {(double)v.x, (double)v.y, (double)v.z};
            double speed = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
            s.mass += m;
            s.linear_size += m * speed;
            s.angular_size += m * speed * sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
            for (int i = 0; i < 3; i++) {
                s.linear[i] += m * w[i];
                s.angular[i] += m * (r[(i + 1) % 3] * w[(i + 2) % 3] - r[(i + 2) % 3] * w[(i + 1) % 3]);
            }
        }
    }
    return s;
}

static double worst_of(const sums *a, const sums *b)
{
    double worst = fabs(a->mass - b->mass) / a->mass;
    for (int i = 0; i < 3; i++) {
        worst = fmax(worst, fabs(a->linear[i] - b->linear[i]) / (a->linear_size + 1e-300));
        worst = fmax(worst, fabs(a->angular[i] - b->angular[i]) / (a->angular_size + 1e-300));
    }
    return worst;
}

static int all_finite(const sb_body *body)
{
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (!sb_v3_is_finite(sb_body_positions(body)[i]) || !sb_v3_is_finite(sb_body_velocities(body)[i]))
            return 0;
    return 1;
}

static sb_body_def live_def(const sb_mesh *mesh, sb_material material, sb_integrator integrator)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integrator = integrator;
    def.slack = REAL(0.5);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    return def;
}

/* Turns and deforms a mesh in units of 1/scale m: velocities that are not affine, so that interpolation alone keeps
 * neither momentum. */
static void set_in_motion(sb_body *body, sb_real scale)
{
    int n = sb_body_node_count(body);
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)n, sizeof *v);
    for (int i = 0; i < n; i++) {
        sb_vec3 x = sb_v3_scale(1 / scale, sb_body_rest_positions(body)[i]);
        if (sb_body_node_in_use(body, i))
            v[i] = sb_v3_scale(scale, sb_v3(REAL(0.3) + 20 * x.y * x.z, -2 * x.x + 10 * x.y * x.y, x.z * x.x * 30));
    }
    CHECK_OK(sb_body_set_velocities(body, v));
    free(v);
}

/* Random changes with steps between; then all is checked. */
static void run_random(sb_body *body, sb_real density, int changes, unsigned long long seed)
{
    op ops[MOST_OPS];
    int depth = 0, refused = 0;
    for (int k = 0; k < changes; k++) {
        sb_error error;
        sums before = sums_of(body, density), after;
        op_kind kind = (op_kind)(int)(check_random(&seed) * (int)OP_KINDS);
        int back = depth && (depth == MOST_OPS || check_random(&seed) < 0.45);
        sb_result result =
            back ? undo(body, ops + depth - 1, &error) : change_at_random(body, &seed, kind, ops + depth, &error);
        const op *last = back ? ops + depth - 1 : ops + depth;
        if (result != SB_OK) { /* a sliver's split may be flat to rounding */
            CHECK(result == SB_ERROR_MESH);
            refused++;
            if (result != SB_ERROR_MESH)
                printf("%s\n", error.message);
            if (back)
                break;
            continue;
        }
        after = sums_of(body, density);
        if (last->kind != OP_REMOVE_CELL && last->kind != OP_COPY_NODE)
            CHECK(worst_of(&before, &after) < scene_tolerance(1e-12, 1e4));
        if (last->kind == OP_COPY_NODE && !back)
            CHECK(worst_of(&before, &after) < scene_tolerance(1e-12, 1e4));
        depth += back ? -1 : last->cells > 0;
        if (!CHECK_RESULT(sb_body_live_check(body, &error), SB_OK)) {
            printf("%s\n", error.message);
            return;
        }
        if (k % 3 == 0) {
            sb_step_info info;
            if (!CHECK_OK(sb_body_step(body, REAL(0.002), &info))) {
                printf("%s\n", info.error.message);
                return;
            }
        }
        if (!CHECK(all_finite(body)))
            return;
    }
    CHECK(refused < changes / 10 + 3);
}

static void test_random_changes(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    int changes = getenv("CHECK_SLOW") ? 100000 : 600;
    sb_body *body;
    def.damping_stiffness = REAL(0.01);
    body = scene_body(&def);
    set_in_motion(body, 1);
    run_random(body, 1000, changes, 11);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Three blocks that do not touch, their nodes numbered by turns. */
static void make_parts(sb_mesh *mesh)
{
    sb_mesh block = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.06), REAL(0.04), REAL(0.04)), 0.1);
    int own = block.node_count;
    memset(mesh, 0, sizeof *mesh);
    CHECK_OK(sb_mesh_copy(&block, NULL, mesh, NULL));
    for (int part = 1; part < 3; part++)
        CHECK_OK(sb_mesh_append(mesh, &block, NULL));
    for (int i = 0; i < mesh->node_count; i++) {
        mesh->nodes[i] = block.nodes[i / 3];
        mesh->nodes[i].z += REAL(0.05) * (sb_real)(i % 3);
    }
    for (int k = 0; k < 4 * mesh->element_count; k++)
        mesh->elements[k] = mesh->elements[k] % own * 3 + mesh->elements[k] / own;
    sb_mesh_free(&block);
}

/* Parts side by side, and organs flattened up to five times, in metres, millimetres and units of 100 m. */
static void test_random_meshes(void)
{
    const sb_real scales[3] = {1, 1000, REAL(0.01)};
    unsigned long long seed = 1234;
    for (int k = 0; k < 6; k++) {
        sb_mesh mesh;
        sb_body_def def;
        sb_body *body;
        sb_real flat = REAL(check_random_in(&seed, 0.2, 1)), scale = scales[k / 2];
        if (k % 2)
            make_parts(&mesh);
        else
            CHECK_OK(sb_mesh_organ(SB_TET4, 4, NULL, &mesh, NULL));
        for (int i = 0; i < mesh.node_count; i++) {
            mesh.nodes[i].z *= k % 2 ? 1 : flat;
            mesh.nodes[i] = sb_v3_scale(scale, mesh.nodes[i]);
        }
        /* E / length^2 and g / length stay: the same motion */
        def = live_def(&mesh, sb_material_corotated(5000 * scale * scale, REAL(0.4), 1000),
                       k < 2   ? SB_EULER
                       : k < 4 ? SB_NEWMARK
                               : SB_GENERALISED_ALPHA);
        def.gravity = sb_v3_scale(scale, def.gravity);
        def.damping_stiffness = REAL(0.01);
        body = scene_body(&def);
        set_in_motion(body, scale);
        run_random(body, 1000, getenv("CHECK_SLOW") ? 5000 : 150, 100 + (unsigned)k);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* The inverse order gives back all bits: numbers, shape, motion at rest, and what a step makes of them. */
static void test_inverse(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_NEWMARK);
    unsigned long long seed = 5;
    uint64_t hash;
    op ops[MOST_OPS];
    sb_error error;
    sb_body *body = scene_body(&def), *twin = scene_body(&def);
    sb_body *both[2];
    const sb_vec3 *positions = sb_body_positions(body);
    both[0] = body, both[1] = twin;
    for (int b = 0; b < 2; b++) { /* bent, at rest: forces and accelerations not known yet */
        sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *u);
        for (int i = 0; i < mesh.node_count; i++)
            u[i] = sb_v3(mesh.nodes[i].y * REAL(0.1), 0, mesh.nodes[i].x * mesh.nodes[i].x);
        scene_fix_plane(both[b], &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_step(both[b], REAL(0.01), NULL));
        CHECK_OK(sb_body_set_displacements(both[b], u));
        memset(u, 0, (size_t)mesh.node_count * sizeof *u);
        CHECK_OK(sb_body_set_velocities(both[b], u));
        free(u);
    }
    hash = sb_body_state_hash(body);
    CHECK(hash == sb_body_state_hash(twin));
    for (int round = 0; round < 4; round++) {
        int depth = 0;
        for (int k = 0; k < 12; k++) {
            op_kind kind = (op_kind)(int)(check_random(&seed) * (int)OP_REMOVE_CELL);
            if (!CHECK_OK(change_at_random(body, &seed, kind, ops + depth, &error)))
                printf("%s\n", error.message);
            depth += ops[depth].cells > 0;
        }
        CHECK(hash != sb_body_state_hash(body));
        while (depth-- > 0)
            if (!CHECK_OK(undo(body, ops + depth, &error)))
                printf("%s\n", error.message);
        CHECK(hash == sb_body_state_hash(body));
    }
    CHECK(sb_body_positions(body) == positions); /* slack sufficed */
    for (int s = 0; s < 3; s++) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(twin, REAL(0.01), NULL));
        CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
    }
    sb_body_destroy(body);
    sb_body_destroy(twin);
    sb_mesh_free(&mesh);
}

/* Largest difference of two fields over the largest entry. */
static double field_difference(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double worst = 0, largest = 0;
    for (int i = 0; i < count; i++) {
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(a[i], b[i])));
        largest = fmax(largest, (double)sb_v3_norm(a[i]));
    }
    return worst / largest;
}

/* In the same shape both have the same cells, masses, energies and stiffness. */
static void check_twins(sb_body *body, sb_body *twin)
{
    const double rounding = scene_tolerance(1e-12, 1e4);
    int n = sb_body_node_count(twin);
    sb_vec3 *x = (sb_vec3 *)calloc((size_t)n, 3 * sizeof *x);
    sb_energy energy[2];
    unsigned long long seed = 3;
    CHECK_INT(sb_body_node_count(body), n);
    CHECK_INT(sb_body_element_count(body), sb_body_element_count(twin));
    CHECK_INT(sb_body_matrix_blocks(body), sb_body_matrix_blocks(twin));
    CHECK(!memcmp(sb_body_rest_positions(body), sb_body_rest_positions(twin), (size_t)n * sizeof *x));
    for (int e = 0; e < sb_body_element_count(twin); e++)
        CHECK(!memcmp(nodes_of(body, e), nodes_of(twin, e), 4 * sizeof(int)));
    CHECK_NEAR(sb_body_mass(body) / sb_body_mass(twin), 1, rounding);
    CHECK_OK(sb_body_set_displacements(twin, sb_body_displacements(body)));
    CHECK_OK(sb_body_set_velocities(twin, sb_body_velocities(body)));
    CHECK_OK(sb_body_energy(body, &energy[0]));
    CHECK_OK(sb_body_energy(twin, &energy[1]));
    CHECK_NEAR(energy[0].elastic / energy[1].elastic, 1, rounding);
    CHECK_NEAR(energy[0].kinetic / energy[1].kinetic, 1, rounding);
    for (int i = 0; i < n; i++)
        x[i] = sb_v3(REAL(check_random(&seed)), REAL(check_random(&seed)), REAL(check_random(&seed)));
    CHECK_OK(sb_body_multiply_stiffness(body, x, x + n, NULL));
    CHECK_OK(sb_body_multiply_stiffness(twin, x, x + 2 * n, NULL));
    CHECK(field_difference(x + n, x + 2 * n, n) < scene_tolerance(1e-10, 1e4));
    free(x);
}

/* Hundreds of changes of a moving organ, with steps between, and their inverse order: the mesh is what it was to the
 * bit, mass, energy and stiffness are those of a body made anew to rounding. */
static void test_long_inverse(void)
{
    int most = getenv("CHECK_SLOW") ? 5000 : check_quick() ? 60 : 300, depth = 0, grown;
    op *ops = (op *)calloc((size_t)most, sizeof *ops);
    unsigned long long seed = 77;
    sb_mesh mesh;
    sb_body_def def;
    sb_body *body, *twin;
    sb_error error;
    CHECK_OK(sb_mesh_organ(SB_TET4, 5, NULL, &mesh, NULL));
    def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    def.damping_stiffness = REAL(0.01);
    body = scene_body(&def);
    twin = scene_body(&def);
    set_in_motion(body, 1);
    for (int k = 0; depth < most && k < 2 * most; k++) {
        op_kind kind = (op_kind)(int)(check_random(&seed) * (int)OP_REMOVE_CELL);
        sb_result result = change_at_random(body, &seed, kind, ops + depth, &error);
        if (result == SB_OK)
            depth += ops[depth].cells > 0;
        else
            CHECK(result == SB_ERROR_MESH);
        if (k % 10 == 0)
            CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
    }
    CHECK_INT(depth, most);
    grown = sb_body_element_count(body);
    CHECK(grown > mesh.element_count + most);
    while (depth-- > 0) {
        if (!CHECK_OK(undo(body, ops + depth, &error)))
            printf("%s\n", error.message);
        if (depth % 10 == 0)
            CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
    }
    CHECK_OK(sb_body_live_check(body, &error));
    check_twins(body, twin);
    free(ops);
    sb_body_destroy(body);
    sb_body_destroy(twin);
    sb_mesh_free(&mesh);
}

/* ---- every material and integrator ---- */

static sb_material with_prony(sb_material m)
{
    m.prony_count = 2;
    m.prony_g[0] = REAL(0.3), m.prony_tau[0] = REAL(0.02);
    m.prony_g[1] = REAL(0.2), m.prony_tau[1] = REAL(0.5);
    return m;
}

static sb_material with_fibres(sb_material m)
{
    m.fibre_stiffness = 2000;
    m.fibre_exponent = 5;
    return m;
}

static void test_materials(void)
{
    const sb_material materials[] = {sb_material_linear(5000, REAL(0.4), 1000),
                                     sb_material_corotated(5000, REAL(0.4), 1000),
                                     sb_material_corotated_invertible(5000, REAL(0.4), 1000),
                                     sb_material_mooney_rivlin(600, 300, REAL(2e-4), 1000),
                                     sb_material_svk(5000, REAL(0.4), 1000),
                                     sb_material_neo_hookean(5000, REAL(0.4), 1000),
                                     sb_material_stable_neo_hookean(5000, REAL(0.4), 1000),
                                     with_prony(sb_material_neo_hookean(5000, REAL(0.4), 1000)),
                                     with_fibres(sb_material_neo_hookean(5000, REAL(0.4), 1000)),
                                     with_prony(with_fibres(sb_material_stable_neo_hookean(5000, REAL(0.4), 1000)))};
    const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_vec3 *fibres = (sb_vec3 *)calloc((size_t)mesh.element_count, sizeof *fibres);
    for (int e = 0; e < mesh.element_count; e++)
        fibres[e] = sb_v3(1, REAL(e % 3), 0);
    for (size_t m = 0; m < sizeof materials / sizeof materials[0]; m++)
        for (int k = 0; k < 4; k++) {
            sb_body_def def = live_def(&mesh, materials[m], integrators[k]);
            sb_body *body;
            def.fibres = fibres;
            def.damping_stiffness = integrators[k] == SB_CENTRAL_DIFFERENCE ? 0 : REAL(0.005);
            def.mass = m == 5 && k < 3 ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
            body = scene_body(&def);
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            for (int s = 0; s < 3; s++)
                CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
            {
                unsigned long long seed = 3 + 7 * m + (unsigned long long)k;
                sb_error error;
                op o;
                for (int s = 0; s < 12; s++) {
                    op_kind kind = (op_kind)(int)(check_random(&seed) * (int)OP_COPY_NODE);
                    sb_step_info info;
                    CHECK_OK(change_at_random(body, &seed, kind, &o, &error));
                    if (s % 3 == 2)
                        CHECK_OK(undo(body, &o, &error));
                    if (!CHECK_OK(sb_body_step(body, REAL(0.002), &info)))
                        printf("material %d, integrator %d: %s\n", (int)m, k, info.error.message);
                }
            }
            CHECK_OK(sb_body_live_check(body, NULL));
            CHECK(all_finite(body));
            if (integrators[k] != SB_CENTRAL_DIFFERENCE)
                CHECK_OK(sb_body_solve_static(body, NULL, NULL));
            sb_body_destroy(body);
        }
    free(fibres);
    sb_mesh_free(&mesh);
}

/* A changed body does what a body made anew with that mesh does. */
static void test_against_fresh(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1), now;
    sb_body_def def = live_def(&mesh, sb_material_neo_hookean(5000, REAL(0.4), 1000), SB_NEWMARK);
    unsigned long long seed = 17;
    sb_body *body, *fresh;
    sb_error error;
    int *nodes;
    double worst = 0;
    op o;
    def.newton_tolerance = REAL(1e-9);
    if (sizeof(sb_real) < 8)
        def.newton_tolerance = REAL(1e-4);
    body = scene_body(&def);
    for (int k = 0; k < 20; k++) {
        op_kind kind = (op_kind)(int)(check_random(&seed) * (int)OP_KINDS);
        CHECK_OK(change_at_random(body, &seed, kind, &o, &error));
        if (k == 10)
            CHECK_OK(undo(body, &o, &error));
    }
    nodes = (int *)malloc((size_t)sb_body_node_count(body) * sizeof *nodes);
    CHECK_OK(sb_body_get_mesh(body, NULL, &now, nodes, NULL, &error));
    def.mesh = &now;
    def.slack = 0;
    fresh = scene_body(&def);
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (nodes[i] >= 0 && sb_body_rest_positions(body)[i].x < REAL(1e-9)) {
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
            CHECK_OK(sb_body_fix_nodes(fresh, nodes + i, 1, SB_XYZ));
        }
    CHECK_NEAR(sb_body_mass(body), sb_body_mass(fresh), scene_tolerance(1e-12, 100) * (double)sb_body_mass(fresh));
    for (int s = 0; s < 10; s++) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(fresh, REAL(0.01), NULL));
    }
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (nodes[i] >= 0)
            worst = fmax(worst, (double)sb_v3_norm(
                                    sb_v3_sub(sb_body_displacements(body)[i], sb_body_displacements(fresh)[nodes[i]])));
    CHECK(worst < scene_tolerance(1e-9, 1e5) * 0.1);
    free(nodes);
    sb_body_destroy(body);
    sb_body_destroy(fresh);
    sb_mesh_free(&now);
    sb_mesh_free(&mesh);
}

/* ---- what follows ---- */

/* A body with one of each, clamped at x = 0. */
typedef struct scene {
    sb_mesh mesh;
    sb_body *body;
    int pressure, springs, mapping, constraint, faces[64][3], face_count;
} scene;

static scene make_scene(const sb_allocator *allocator, const sb_jobs *jobs)
{
    const sb_vec3 size = {REAL(0.15), REAL(0.1), REAL(0.1)};
    scene s;
    sb_boundary boundary;
    sb_body_def def;
    sb_real k = 50, weights[4] = {REAL(0.4), REAL(0.3), REAL(0.2), REAL(0.1)};
    int starts[2] = {0, 4}, tip = -1, first = -1, last = -1;
    sb_vec3 point;
    sb_mapping mapping;
    sb_constraint_term terms[3];
    memset(&s, 0, sizeof s);
    s.mesh = scene_box(SB_TET4, 3, 2, 2, size, 0.1);
    def = live_def(&s.mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    if (allocator)
        def.allocator = *allocator;
    if (jobs)
        def.jobs = *jobs;
    s.body = scene_body(&def);
    if (!s.body)
        return s;
    scene_fix_plane(s.body, &s.mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_mesh_boundary(&s.mesh, 0, NULL, &boundary, NULL));
    for (int f = 0; f < boundary.surface.element_count && s.face_count < 64; f++) {
        const int *face = boundary.surface.elements + 3 * f;
        int on = 1;
        for (int a = 0; a < 3; a++)
            on &= s.mesh.nodes[face[a]].z > REAL(0.0999);
        if (on)
            memcpy(s.faces[s.face_count++], face, 3 * sizeof(int));
    }
    sb_boundary_free(&boundary);
    for (int i = 0; i < s.mesh.node_count; i++) {
        if (s.mesh.nodes[i].x > REAL(0.149) && tip < 0)
            tip = i;
        if (s.mesh.nodes[i].x > REAL(0.149))
            first = last < 0 ? i : first, last = i;
    }
    CHECK_OK(sb_body_add_pressure(s.body, s.faces[0], s.face_count, 3, 100, &s.pressure, NULL));
    point = s.mesh.nodes[tip];
    CHECK_OK(sb_body_add_springs(s.body, &tip, 1, &k, 1, &point, &s.springs, NULL));
    mapping.row_count = 1;
    mapping.row_start = starts;
    mapping.nodes = s.mesh.elements + 4 * 20;
    mapping.weights = weights;
    point = sb_v3(0, 0, 0);
    for (int a = 0; a < 4; a++)
        point = sb_v3_madd(point, weights[a], s.mesh.nodes[mapping.nodes[a]]);
    CHECK_OK(sb_body_add_mapping(s.body, &mapping, &k, 1, &point, &s.mapping, NULL));
    terms[0].node = last, terms[0].axis = 1, terms[0].coefficient = 1;
    terms[1].node = first, terms[1].axis = 1, terms[1].coefficient = REAL(-0.5);
    terms[2].node = first + 1, terms[2].axis = 1, terms[2].coefficient = REAL(-0.5);
    CHECK_OK(sb_body_add_constraint(s.body, terms, 3, 0, &s.constraint, NULL));
    for (int k2 = 0; k2 < 3; k2++)
        CHECK_OK(sb_body_step(s.body, REAL(0.01), NULL));
    return s;
}

static void free_scene(scene *s)
{
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
}

static sb_result split_edge(sb_body *body, int a, int b, op *o, sb_error *error)
{
    static const sb_real half[2] = {REAL(0.5), REAL(0.5)};
    memset(o, 0, sizeof *o);
    o->kind = OP_SPLIT_EDGE;
    o->count = 2;
    o->corners[0] = a, o->corners[1] = b;
    return split(body, o, half, error);
}

/* A split face passes its pressure on: net force and torque stay, and the way back restores the faces. */
static void test_pressure_follows(void)
{
    scene s = make_scene(NULL, NULL);
    sb_vec3 force[4], torque[4];
    sb_error error;
    op o;
    CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    CHECK_OK(sb_body_load_force(s.body, s.pressure, sb_v3(0, 0, 0), force, torque));
    CHECK_OK(split_edge(s.body, s.faces[1][0], s.faces[1][1], &o, &error));
    CHECK_OK(sb_body_load_force(s.body, s.pressure, sb_v3(0, 0, 0), force + 1, torque + 1));
    CHECK(memcmp(force, force + 1, sizeof *force) == 0); /* a reading of the last solve */
    CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    CHECK_OK(sb_body_load_force(s.body, s.pressure, sb_v3(0, 0, 0), force + 2, torque + 2));
    /* the finer mesh is softer: positions differ a little, areas a little */
    CHECK(sb_v3_norm(sb_v3_sub(force[2], force[0])) < REAL(0.02) * sb_v3_norm(force[0]));
    CHECK_OK(undo(s.body, &o, &error));
    CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    CHECK_OK(sb_body_load_force(s.body, s.pressure, sb_v3(0, 0, 0), force + 3, torque + 3));
    CHECK(sb_v3_norm(sb_v3_sub(force[3], force[0])) < REAL(1e-3) * sb_v3_norm(force[0]));
    free_scene(&s);
}

/* Forces of loads at a shape that a split does not change are what they were. */
static void test_forces_stay(void)
{
    scene s = make_scene(NULL, NULL);
    sb_vec3 before = {0, 0, 0}, after = {0, 0, 0}, point[2];
    sb_step_info info;
    sb_error error;
    op o;
    /* a step too short to move anything: external forces are those of the present shape */
    CHECK_OK(sb_body_step(s.body, REAL(1e-7), &info));
    for (int i = 0; i < sb_body_node_count(s.body); i++)
        before = sb_v3_add(before, sb_body_external_forces(s.body)[i]);
    CHECK_OK(sb_body_mapping_points(s.body, s.mapping, point));
    for (int f = 0; f < 4; f++) {
        int a = s.faces[2 * f][0], b = s.faces[2 * f][1];
        sb_result result = split_edge(s.body, a, b, &o, &error);
        CHECK(result == SB_OK);
    }
    CHECK_OK(split_edge(s.body, s.mesh.elements[80], s.mesh.elements[81], &o, &error)); /* the mapping's own cell */
    CHECK_OK(sb_body_mapping_points(s.body, s.mapping, point + 1));
    CHECK(sb_v3_norm(sb_v3_sub(point[1], point[0])) < REAL(scene_tolerance(1e-13, 8)));
    CHECK_OK(sb_body_step(s.body, REAL(1e-7), &info));
    for (int i = 0; i < sb_body_node_count(s.body); i++)
        after = sb_v3_add(after, sb_body_external_forces(s.body)[i]);
    CHECK(sb_v3_norm(sb_v3_sub(after, before)) < REAL(1e-4) * sb_v3_norm(before));
    CHECK_OK(sb_body_live_check(s.body, NULL));
    free_scene(&s);
}

/* A row in a cell that was split is the same material point of a part: deform the parts and see. */
static void test_mapping_follows(void)
{
    scene s = make_scene(NULL, NULL);
    const int *cell = s.mesh.elements + 80;
    int nodes[4];
    sb_vec3 X = {0, 0, 0}, point, *u;
    sb_error error;
    double found = 0;
    op o;
    memcpy(nodes, cell, sizeof nodes);
    X = sb_v3_madd(
        sb_v3_madd(sb_v3_madd(sb_v3_madd(X, REAL(0.4), s.mesh.nodes[nodes[0]]), REAL(0.3), s.mesh.nodes[nodes[1]]),
                   REAL(0.2), s.mesh.nodes[nodes[2]]),
        REAL(0.1), s.mesh.nodes[nodes[3]]);
    CHECK_OK(split_edge(s.body, nodes[0], nodes[1], &o, &error));
    u = (sb_vec3 *)calloc((size_t)sb_body_node_count(s.body), sizeof *u);
    u[o.node] = sb_v3(REAL(0.001), 0, 0); /* 0.4 - 0.3 of corner 0 is left, 0.6 of the node in the middle */
    CHECK_OK(sb_body_set_displacements(s.body, u));
    CHECK_OK(sb_body_mapping_points(s.body, s.mapping, &point));
    found = (double)(point.x - X.x);
    CHECK_NEAR(found, 0.6e-3, scene_tolerance(1e-12, 2));
    CHECK_OK(undo(s.body, &o, &error));
    CHECK_OK(sb_body_mapping_points(s.body, s.mapping, &point));
    CHECK_NEAR(point.x, X.x, scene_tolerance(1e-12, 2)); /* the corners did not move */
    free(u);
    free_scene(&s);
}

/* A split between supported nodes is supported, a copy is not; a dead load goes to the heirs. */
static void test_supports_follow(void)
{
    scene s = make_scene(NULL, NULL);
    int a = -1, b = -1, held = 0;
    sb_vec3 force = {0, 0, 7};
    sb_error error;
    sb_real one = 1;
    op o;
    for (int e = 0; e < s.mesh.element_count && b < 0; e++) {
        a = -1;
        for (int k = 0; k < 4 && b < 0; k++) {
            int node = s.mesh.elements[4 * e + k];
            if (s.mesh.nodes[node].x < REAL(1e-9))
                b = a >= 0 ? node : b, a = a >= 0 ? a : node;
        }
    }
    CHECK_OK(split_edge(s.body, a, b, &o, &error));
    CHECK_INT(sb_body_supports(s.body)[o.node], SB_XYZ);
    CHECK_OK(sb_body_add_forces(s.body, &o.node, 1, &force, 1));
    CHECK_OK(undo(s.body, &o, &error));
    CHECK_OK(sb_body_step(s.body, REAL(1e-6), NULL));
    memset(&o, 0, sizeof o);
    o.kind = OP_COPY_NODE;
    o.count = 1;
    o.corners[0] = a;
    CHECK_OK(copy_node(s.body, &o, &error));
    if (CHECK(o.cells > 0)) {
        CHECK_INT(sb_body_supports(s.body)[o.node], 0);
        CHECK_INT(sb_body_supports(s.body)[a], SB_XYZ);
        CHECK_OK(undo(s.body, &o, &error));
    }
    { /* a supported node without heirs stays */
        sb_body_change *change;
        CHECK_OK(sb_body_change_begin(s.body, &change, &error));
        for (int e = 0; e < sb_body_element_count(s.body); e++)
            if (sb_body_cell_in_use(s.body, e) && has_nodes(nodes_of(s.body, e), &a, 1)) {
                CHECK_OK(sb_body_change_remove_cell(change, e, &error));
                held++;
            }
        CHECK_OK(sb_body_change_remove_node(change, a, NULL, &one, 0, &error));
        CHECK_RESULT(sb_body_change_commit(change, &error), held ? SB_ERROR_ARGUMENT : SB_OK);
        CHECK_INT(error.node, a);
        sb_body_change_cancel(change);
    }
    free_scene(&s);
}

typedef struct follower {
    int asked, followed, gave_up, refuse;
} follower;

static sb_result follower_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    follower *f = (follower *)user;
    (void)body, (void)change, (void)error;
    f->asked++;
    return f->refuse ? SB_ERROR_UNSUPPORTED : SB_OK;
}

static void follower_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    follower *f = (follower *)user;
    f->followed += change && change->made_node_count == 1 && change->node_end == sb_body_node_count(body);
}

static void follower_give_up(void *user) { ((follower *)user)->gave_up++; }

static void test_listeners(void)
{
    scene s = make_scene(NULL, NULL);
    follower first = {0, 0, 0, 0}, second = {0, 0, 0, 0};
    sb_body_listener calls = {NULL, follower_reserve, follower_follow, follower_give_up, NULL};
    int ids[2];
    uint64_t hash = sb_body_state_hash(s.body);
    sb_error error;
    op o;
    calls.user = &first;
    CHECK_OK(sb_body_listen(s.body, &calls, ids, &error));
    calls.user = &second;
    CHECK_OK(sb_body_listen(s.body, &calls, ids + 1, &error));
    second.refuse = 1;
    CHECK_RESULT(split_edge(s.body, s.mesh.elements[0], s.mesh.elements[1], &o, &error), SB_ERROR_UNSUPPORTED);
    CHECK(first.asked == 1 && first.gave_up == 1 && first.followed == 0 && second.asked == 1 && second.gave_up == 0);
    CHECK(sb_body_state_hash(s.body) == hash);
    CHECK_OK(sb_body_unlisten(s.body, ids[1]));
    CHECK_RESULT(sb_body_unlisten(s.body, ids[1]), SB_ERROR_INDEX);
    CHECK_OK(split_edge(s.body, s.mesh.elements[0], s.mesh.elements[1], &o, &error));
    CHECK(first.followed == 1 && second.followed == 0);
    free_scene(&s);
}

/* ---- failures ---- */

static void test_refused(void)
{
    scene s = make_scene(NULL, NULL);
    uint64_t hash = sb_body_state_hash(s.body);
    sb_body_change *change, *other;
    sb_change_cell cell = sb_default_change_cell();
    sb_real half[2] = {REAL(0.5), REAL(0.5)};
    int nodes[4], bad[4], node, free_cell;
    sb_error error;
    sb_body_def def = sb_default_body_def();
    sb_multigrid_level level;
    sb_body *stiff;
    memcpy(nodes, s.mesh.elements, sizeof nodes);
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    CHECK_RESULT(sb_body_change_begin(s.body, &other, &error), SB_ERROR_STATE);
    CHECK_RESULT(sb_body_change_add_node(change, sb_v3(0, 0, 0), nodes, half, 1, 0, &node, &error), SB_ERROR_ARGUMENT);
    half[0] = -1;
    CHECK_RESULT(sb_body_change_add_node(change, sb_v3(0, 0, 0), nodes, half, 2, 0, &node, &error), SB_ERROR_ARGUMENT);
    half[0] = REAL(0.5);
    bad[0] = nodes[0], bad[1] = 100000;
    CHECK_RESULT(sb_body_change_add_node(change, sb_v3(0, 0, 0), bad, half, 2, 0, &node, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, 100000);
    CHECK_RESULT(sb_body_change_remove_cell(change, 100000, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, 100000);
    CHECK_RESULT(sb_body_change_move_node(change, nodes[0], sb_v3(0, 0, REAL(NAN)), NULL, NULL, 0, &error),
                 SB_ERROR_NOT_FINITE);
    /* inside out */
    memcpy(bad, nodes, sizeof bad);
    bad[0] = nodes[1], bad[1] = nodes[0];
    cell.nodes = bad;
    cell.parent = 0;
    CHECK_OK(sb_body_change_replace_cell(change, 0, &cell, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 0);
    CHECK(sb_body_state_hash(s.body) == hash);
    sb_body_change_cancel(change);
    /* a share of which rounding leaves nothing */
    cell.nodes = nodes;
    cell.share = REAL(ldexp(1, SB_REAL_IS_FLOAT ? -149 : -1074)); /* the least above 0 */
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    CHECK_OK(sb_body_change_replace_cell(change, 0, &cell, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 0);
    CHECK(strstr(error.message, "element 0 is too small") != NULL);
    CHECK(sb_body_state_hash(s.body) == hash);
    sb_body_change_cancel(change);
    cell.nodes = bad;
    cell.share = 1;
    /* a node twice */
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    bad[1] = bad[0];
    CHECK_OK(sb_body_change_add_cell(change, &cell, &free_cell, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, free_cell);
    sb_body_change_cancel(change);
    /* a new node in no cell; a removed node in cells */
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    CHECK_OK(sb_body_change_add_node(change, sb_v3(0, 0, 0), nodes, half, 2, 0, &node, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    CHECK_INT(error.node, node);
    sb_body_change_cancel(change);
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    CHECK_OK(sb_body_change_remove_node(change, nodes[0], nodes + 1, half + 1, 0, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, nodes[0]);
    sb_body_change_cancel(change);
    /* nothing left */
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    for (int e = 0; e < s.mesh.element_count; e++)
        CHECK_OK(sb_body_change_remove_cell(change, e, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    sb_body_change_cancel(change);
    /* a node moved through its opposite face */
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    CHECK_OK(sb_body_change_move_node(change, nodes[0], sb_v3(1, 1, 1), NULL, NULL, 0, &error));
    CHECK_RESULT(sb_body_change_commit(change, &error), SB_ERROR_MESH);
    sb_body_change_cancel(change);
    CHECK(sb_body_state_hash(s.body) == hash);
    CHECK_OK(sb_body_live_check(s.body, &error));
    def.mesh = &s.mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    stiff = scene_body(&def);
    CHECK_RESULT(sb_body_change_begin(stiff, &change, &error), SB_ERROR_UNSUPPORTED);
    sb_body_destroy(stiff);
    /* levels of one's own are of one mesh */
    memset(&level, 0, sizeof level);
    def.slack = 1;
    def.levels = &level;
    def.level_count = 1;
    CHECK_RESULT(sb_body_create(&def, &stiff, &error), SB_ERROR_UNSUPPORTED);
    free_scene(&s);
}

/* Every allocation of a change fails in turn: the body is as it was, and goes on like one that never tried. */
static void test_memory_failures(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    scene s = make_scene(&allocator, NULL), twin = make_scene(NULL, NULL);
    uint64_t hash = sb_body_state_hash(s.body);
    sb_result result = SB_ERROR_MEMORY;
    int failures = 0, live;
    sb_error error;
    op o;
    CHECK(hash == sb_body_state_hash(twin.body));
    live = memory.live;
    for (int n = 1; result != SB_OK && n < 1000; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        result = split_edge(s.body, s.mesh.elements[80], s.mesh.elements[81], &o, &error);
        memory.fail_at = 0;
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK_INT(memory.live, live);
        CHECK(sb_body_state_hash(s.body) == hash);
        failures++;
    }
    CHECK_OK(result);
    CHECK(failures > 30);
    CHECK_OK(split_edge(twin.body, s.mesh.elements[80], s.mesh.elements[81], &o, &error));
    memory.calls = 0;
    for (int k = 0; k < 3; k++) {
        CHECK_OK(sb_body_step(s.body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(twin.body, REAL(0.01), NULL));
        CHECK(sb_body_state_hash(s.body) == sb_body_state_hash(twin.body));
    }
    CHECK_INT(memory.calls, 0);
    free_scene(&s);
    free_scene(&twin);
    CHECK_INT(memory.live, 0);
}

/* ---- bits ---- */

static void test_threads(void)
{
    uint64_t expected = 0;
    for (int k = 0; k < 5; k++) {
        static const int counts[5] = {1, 2, 3, 7, 16};
        int workers = counts[k];
        sb_jobs jobs;
        scene s;
        unsigned long long seed = 23;
        sb_error error;
        op o;
        memset(&jobs, 0, sizeof jobs);
        jobs.run = scene_run;
        jobs.user = &workers;
        s = make_scene(NULL, &jobs);
        for (int i = 0; i < 15; i++) {
            CHECK_OK(change_at_random(s.body, &seed, (op_kind)(i % OP_COPY_NODE), &o, &error));
            CHECK_OK(sb_body_step(s.body, REAL(0.005), NULL));
        }
        if (k == 0)
            expected = sb_body_state_hash(s.body);
        CHECK(sb_body_state_hash(s.body) == expected);
        free_scene(&s);
    }
}

/* Saved in the middle, loaded into a body with another mesh, and on: the same bits. */
static void test_state(void)
{
    scene s = make_scene(NULL, NULL), twin = make_scene(NULL, NULL);
    unsigned long long seed = 29, seed2;
    sb_error error;
    size_t size;
    void *image;
    op o, o2;
    for (int i = 0; i < 12; i++) {
        CHECK_OK(change_at_random(s.body, &seed, (op_kind)(i % OP_COPY_NODE), &o, &error));
        if (i % 4 == 1)
            CHECK_OK(undo(s.body, &o, &error));
        CHECK_OK(sb_body_step(s.body, REAL(0.005), NULL));
    }
    size = sb_body_state_size(s.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(s.body, image, size));
    CHECK_OK(split_edge(twin.body, twin.mesh.elements[40], twin.mesh.elements[41], &o2, &error));
    if (!CHECK_OK(sb_body_state_load(twin.body, image, size, &error)))
        printf("%s\n", error.message);
    CHECK(sb_body_state_hash(twin.body) == sb_body_state_hash(s.body));
    CHECK_OK(sb_body_live_check(twin.body, &error));
    seed2 = seed;
    for (int i = 0; i < 8; i++) {
        CHECK_OK(change_at_random(s.body, &seed, (op_kind)(i % OP_COPY_NODE), &o, &error));
        CHECK_OK(change_at_random(twin.body, &seed2, (op_kind)(i % OP_COPY_NODE), &o2, &error));
        CHECK_INT(o.node, o2.node);
        CHECK_OK(sb_body_step(s.body, REAL(0.005), NULL));
        CHECK_OK(sb_body_step(twin.body, REAL(0.005), NULL));
        CHECK(sb_body_state_hash(twin.body) == sb_body_state_hash(s.body));
    }
    free(image);
    free_scene(&s);
    free_scene(&twin);
}

/* A box of two materials, one above or behind the other. */
static sb_mesh layered_box(unsigned long long *seed)
{
    int nx = 4 + (int)(check_random(seed) * 4), ny = 3 + (int)(check_random(seed) * 3),
        turned = check_random(seed) < 0.5;
    double height = check_random_in(seed, 0.03, 0.07);
    sb_mesh mesh = scene_box(SB_TET4, nx, ny, 4, sb_v3(REAL(0.14), REAL(0.1), REAL(0.1)), 0.15);
    mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int));
    for (int e = 0; e < mesh.element_count; e++) {
        sb_vec3 x = mesh.nodes[mesh.elements[4 * e]];
        mesh.regions[e] = (double)(turned ? x.x : x.z) > height ? 7 : 2;
    }
    return mesh;
}

static void step_alike(sb_body *a, sb_body *b, const char *what)
{
    for (int s = 0; s < 3; s++) {
        sb_step_info info, other;
        CHECK_OK(sb_body_step(a, REAL(0.01), &info));
        CHECK_OK(sb_body_step(b, REAL(0.01), &other));
        CHECK_INT(info.pcg_iterations, other.pcg_iterations);
    }
    if (!CHECK_INT(sb_body_node_count(a), sb_body_node_count(b)) ||
        !CHECK(memcmp(sb_body_displacements(a), sb_body_displacements(b),
                      (size_t)sb_body_node_count(a) * sizeof(sb_vec3)) == 0))
        printf("%s\n", what);
}

/* Multigrid's levels go by the jumps between materials. They are those of the mesh at hand whatever came before it:
 * another mesh, changes taken back, a state, other materials. */
static void test_levels_of_materials(void)
{
    const sb_region_material stiff = {7, sb_material_corotated(1000000, REAL(0.3), 1000)};
    const sb_material medium = sb_material_corotated(20000, REAL(0.3), 1000);
    unsigned long long seed = 37;
    for (int k = 0; k < 6; k++) {
        sb_mesh mesh = layered_box(&seed);
        sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
        sb_body *bodies[3]; /* one that never changes, one that does, and one that is sent states */
        void *first, *changed;
        size_t sizes[2];
        sb_error error;
        op o, undone;
        def.preconditioner = SB_PRECOND_MULTIGRID;
        def.slack = k % 3 ? REAL(0.2) : REAL(0.001);
        def.region_materials = &stiff;
        def.region_material_count = 1;
        for (int b = 0; b < 3; b++) {
            bodies[b] = scene_body(&def);
            scene_fix_plane(bodies[b], &mesh, 0, 0, SB_XYZ);
            if (k % 2)
                CHECK_OK(sb_body_set_region_material(bodies[b], 7, &medium, &error));
        }
        sizes[0] = sb_body_state_size(bodies[0]);
        first = malloc(sizes[0]);
        CHECK_OK(sb_body_state_save(bodies[0], first, sizes[0]));
        CHECK_OK(change_at_random(bodies[1], &seed, OP_SPLIT_EDGE, &undone, &error));
        CHECK_OK(undo(bodies[1], &undone, &error));
        step_alike(bodies[0], bodies[1], "taken back");
        for (int i = 0; i < 5; i++)
            CHECK_OK(change_at_random(bodies[1], &seed, (op_kind)(i % OP_COPY_NODE), &o, &error));
        sizes[1] = sb_body_state_size(bodies[1]);
        changed = malloc(sizes[1]);
        CHECK_OK(sb_body_state_save(bodies[1], changed, sizes[1]));
        CHECK_OK(sb_body_state_load(bodies[2], changed, sizes[1], &error));
        CHECK(sb_body_state_hash(bodies[1]) == sb_body_state_hash(bodies[2]));
        step_alike(bodies[1], bodies[2], "a state of another mesh");
        CHECK_OK(sb_body_state_load(bodies[0], first, sizes[0], &error));
        CHECK_OK(sb_body_state_load(bodies[2], first, sizes[0], &error));
        step_alike(bodies[0], bodies[2], "a state after another mesh");
        CHECK(sb_body_state_hash(bodies[0]) == sb_body_state_hash(bodies[2]));
        for (int b = 0; b < 3; b++)
            sb_body_destroy(bodies[b]);
        free(first);
        free(changed);
        sb_mesh_free(&mesh);
    }
}

/* A recording with changes plays again to the last bit. */
static void test_record(void)
{
    scene s = make_scene(NULL, NULL), twin = make_scene(NULL, NULL);
    unsigned long long seed = 31;
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_error error;
    op o;
    CHECK_OK(sb_recording_start(s.body, 3, NULL, &recording, &error));
    for (int i = 0; i < 12; i++) {
        CHECK_OK(change_at_random(s.body, &seed, (op_kind)(i % OP_KINDS), &o, &error));
        if (i % 4 == 1 && o.cells)
            CHECK_OK(undo(s.body, &o, &error));
        CHECK_OK(sb_body_step(s.body, REAL(0.005), NULL));
    }
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, twin.body, &report)))
        printf("%s\n", report.error.message);
    CHECK_INT(report.step, -1);
    CHECK_INT(report.steps, 12);
    CHECK(sb_body_state_hash(twin.body) == sb_body_state_hash(s.body));
    sb_recording_destroy(recording);
    free_scene(&s);
    free_scene(&twin);
}

/* Beyond the slack the body grows, and says the same as one that had room. */
static void test_growth(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    unsigned long long seeds[2] = {37, 37};
    sb_body *bodies[2];
    sb_error error;
    op o[2];
    def.slack = REAL(0.05);
    bodies[0] = scene_body(&def);
    def.slack = 20;
    bodies[1] = scene_body(&def);
    for (int i = 0; i < 40; i++) {
        for (int b = 0; b < 2; b++) {
            CHECK_OK(change_at_random(bodies[b], seeds + b, (op_kind)(i % OP_COPY_NODE), o + b, &error));
            CHECK_OK(sb_body_step(bodies[b], REAL(0.002), NULL));
        }
        CHECK_INT(o[0].node, o[1].node);
    }
    CHECK(sb_body_node_count(bodies[0]) > 2 * mesh.node_count);
    CHECK(sb_body_state_hash(bodies[0]) == sb_body_state_hash(bodies[1]));
    sb_body_destroy(bodies[0]);
    sb_body_destroy(bodies[1]);
    sb_mesh_free(&mesh);
}

/* ---- a node slides through the material ---- */

/* Slides a free node towards a random point of one of its cells, with the place's weights in that cell as sources. */
static sb_result slide(sb_body *body, unsigned long long *seed, int *node, sb_error *error)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    sb_body_change *change;
    sb_real weights[4], sum = 0;
    sb_vec3 x = {0, 0, 0};
    sb_result result = sb_body_change_begin(body, &change, error);
    int cell, nodes[4], corner;
    if (result != SB_OK)
        return result;
    do {
        cell = pick_cell(body, seed);
        corner = (int)(check_random(seed) * 4);
    } while (sb_body_supports(body)[nodes_of(body, cell)[corner]]);
    memcpy(nodes, nodes_of(body, cell), sizeof nodes);
    for (int a = 0; a < 4; a++)
        sum += weights[a] = a == corner ? 4 : REAL(check_random(seed));
    for (int a = 0; a < 4; a++)
        x = sb_v3_madd(x, weights[a] /= sum, X[nodes[a]]);
    *node = nodes[corner];
    result = sb_body_change_move_node(change, *node, x, nodes, weights, 4, error);
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

static sb_vec3 affine(sb_vec3 x, sb_real k)
{
    return sb_v3(k + REAL(0.1) * x.y, REAL(0.05) * k * x.x - REAL(0.02) * x.z, REAL(0.03) * x.x + k * REAL(0.2) * x.z);
}

/* A field that is affine in the material stays what it is, wherever nodes slide. */
static void test_slide(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_NEWMARK);
    sb_body *body = scene_body(&def);
    int n = mesh.node_count, node, slid = 0;
    unsigned long long seed = 41;
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)n, sizeof *u), *v = (sb_vec3 *)calloc((size_t)n, sizeof *v);
    for (int i = 0; i < n; i++)
        u[i] = affine(mesh.nodes[i], REAL(0.01)), v[i] = affine(mesh.nodes[i], 1);
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_set_velocities(body, v));
    for (int k = 0; k < 60; k++) {
        sb_error error;
        sums before = sums_of(body, 1000), after;
        sb_result result = slide(body, &seed, &node, &error);
        CHECK(result == SB_OK || result == SB_ERROR_MESH); /* a corner node may press a neighbour flat */
        after = sums_of(body, 1000);
        slid += result == SB_OK;
        CHECK_OK(sb_body_live_check(body, &error));
        if (fabs(after.mass - before.mass) <= scene_tolerance(1e-13, 1e4) * before.mass)
            CHECK(worst_of(&before, &after) < scene_tolerance(1e-12, 1e4));
    }
    CHECK(slid > 30);
    for (int i = 0; i < n; i++) {
        sb_vec3 x = sb_body_rest_positions(body)[i],
                off = sb_v3_sub(sb_body_displacements(body)[i], affine(x, REAL(0.01)));
        CHECK(sb_v3_norm(off) < REAL(scene_tolerance(1e-14, 1)));
    }
    free(u);
    free(v);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Motion that no mesh carries exactly: momentum is kept while the shape is, and a moved node has its sources'
 * motion. */
static void test_slide_momentum(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.15)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_neo_hookean(5000, REAL(0.4), 1000), SB_NEWMARK);
    sb_body *body = scene_body(&def);
    unsigned long long seed = 43;
    int inside = 0, node;
    sb_error error;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    set_in_motion(body, 1);
    for (int k = 0; k < 80; k++) {
        sums before = sums_of(body, 1000), after;
        sb_result result = slide(body, &seed, &node, &error);
        after = sums_of(body, 1000);
        CHECK(result == SB_OK || result == SB_ERROR_MESH);
        if (fabs(after.mass - before.mass) <= scene_tolerance(1e-13, 1e4) * before.mass) {
            CHECK(worst_of(&before, &after) < scene_tolerance(1e-12, 1e4));
            inside += result == SB_OK;
        }
        if (k % 8 == 0)
            CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
    }
    CHECK(inside > 3);
    CHECK(all_finite(body));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* One free node among held ones takes the momentum of its cells: it has no axis to spin about. */
static void test_slide_alone(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.15)), 0.1);
    unsigned long long seed = 47;
    int slid = 0;
    for (int free_node = 0; free_node < mesh.node_count; free_node++) {
        sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_NEWMARK);
        sb_body *body = scene_body(&def);
        int *all = (int *)malloc((size_t)mesh.node_count * sizeof *all), node;
        sb_error error;
        set_in_motion(body, 1);
        for (int i = 0; i < mesh.node_count; i++)
            all[i] = i;
        CHECK_OK(sb_body_fix_nodes(body, all, mesh.node_count, SB_XYZ));
        CHECK_OK(sb_body_release_nodes(body, &free_node, 1, SB_XYZ));
        for (int k = 0; k < 3; k++) {
            double speed = (double)sb_v3_norm(sb_body_velocities(body)[free_node]), most = 0;
            slid += slide(body, &seed, &node, &error) == SB_OK;
            for (int i = 0; i < mesh.node_count; i++)
                most = fmax(most, (double)sb_v3_norm(sb_body_velocities(body)[i]));
            CHECK(all_finite(body));
            CHECK(most < 100 * (speed + 1));
        }
        free(all);
        sb_body_destroy(body);
    }
    CHECK(slid > mesh.node_count);
    sb_mesh_free(&mesh);
}

/* Along axes that a moved node alone is supported along it keeps its motion; where its sources are, too, targets
 * mix. */
static void test_slide_supports(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    sb_body *body = scene_body(&def);
    const sb_real half[2] = {REAL(0.25), REAL(0.75)};
    sb_vec3 targets[2] = {{REAL(0.001), 0, 0}, {REAL(0.002), 0, 0}}, x;
    sb_body_change *change;
    sb_error error;
    int pair[2];
    memcpy(pair, mesh.elements, sizeof pair);
    CHECK_OK(sb_body_prescribe(body, pair, 2, SB_X, targets, 0));
    CHECK_OK(sb_body_fix_nodes(body, pair, 1, SB_Y));
    for (int i = 0; i < 3; i++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    {
        sb_vec3 u[2];
        u[0] = sb_body_displacements(body)[pair[0]], u[1] = sb_body_displacements(body)[pair[1]];
        CHECK_OK(sb_body_change_begin(body, &change, &error));
        x = sb_v3_add(sb_v3_scale(half[0], mesh.nodes[pair[1]]), sb_v3_scale(half[1], mesh.nodes[pair[0]]));
        CHECK_OK(sb_body_change_move_node(change, pair[0], x, pair, half, 2, &error)); /* replaced by the next line */
        x = sb_v3_add(sb_v3_scale(half[0], mesh.nodes[pair[0]]), sb_v3_scale(half[1], mesh.nodes[pair[1]]));
        x = sb_v3_add(sb_v3_scale(REAL(0.9), mesh.nodes[pair[0]]), sb_v3_scale(REAL(0.1), x));
        CHECK_OK(sb_body_change_move_node(change, pair[0], x, pair, half, 2, &error));
        CHECK_OK(sb_body_change_commit(change, &error));
        CHECK_NEAR(sb_body_displacements(body)[pair[0]].x, 0.00175, 1e-9);
        CHECK(sb_body_displacements(body)[pair[0]].y == u[0].y && u[0].y == 0);
        CHECK_NEAR(sb_body_displacements(body)[pair[0]].z, (double)(half[0] * u[0].z + half[1] * u[1].z), 1e-9);
        CHECK_INT(sb_body_supports(body)[pair[0]], SB_X | SB_Y);
    }
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_NEAR(sb_body_displacements(body)[pair[0]].x, 0.00175, 1e-9); /* the target, too */
    CHECK(sb_body_displacements(body)[pair[0]].y == 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* What cannot be, sources that the change makes, and a recording of slides. */
static void test_slide_calls(void)
{
    scene s = make_scene(NULL, NULL), twin = make_scene(NULL, NULL);
    const sb_vec3 *X = sb_body_rest_positions(s.body);
    sb_real half[2] = {REAL(0.5), REAL(0.5)}, bad[2] = {REAL(0.5), REAL(0.4)};
    unsigned long long seed = 47;
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_body_change *change;
    int nodes[4], wrong[2], node, done = 0;
    sb_error error;
    memcpy(nodes, s.mesh.elements + 80, sizeof nodes);
    CHECK_OK(sb_body_change_begin(s.body, &change, &error));
    CHECK_RESULT(sb_body_change_move_node(change, nodes[0], X[nodes[0]], nodes, bad, 2, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_change_move_node(change, nodes[0], X[nodes[0]], nodes, bad, -1, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_change_move_node(change, nodes[0], X[nodes[0]], NULL, half, 2, &error), SB_ERROR_ARGUMENT);
    wrong[0] = nodes[0], wrong[1] = 100000;
    CHECK_RESULT(sb_body_change_move_node(change, nodes[0], X[nodes[0]], wrong, half, 2, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, 100000);
    bad[1] = REAL(NAN);
    CHECK_RESULT(sb_body_change_move_node(change, nodes[0], X[nodes[0]], nodes, bad, 2, &error), SB_ERROR_NOT_FINITE);
    sb_body_change_cancel(change);
    CHECK(sb_body_state_hash(s.body) == sb_body_state_hash(twin.body));
    CHECK_OK(sb_recording_start(s.body, 3, NULL, &recording, &error));
    { /* a made node slides, and is a source */
        sb_vec3 ends[2], x;
        op o;
        CHECK_OK(split_edge(s.body, nodes[0], nodes[1], &o, &error));
        X = sb_body_rest_positions(s.body);
        ends[0] = sb_body_displacements(s.body)[nodes[0]], ends[1] = sb_body_displacements(s.body)[nodes[1]];
        CHECK_OK(undo(s.body, &o, &error));
        CHECK_OK(sb_body_change_begin(s.body, &change, &error));
        x = sb_v3_scale(REAL(0.5), sb_v3_add(X[nodes[0]], X[nodes[1]]));
        CHECK_OK(sb_body_change_add_node(change, x, nodes, half, 2, 0, &node, &error));
        half[0] = REAL(0.4), half[1] = REAL(0.6);
        x = sb_v3_add(sb_v3_scale(half[0], X[nodes[0]]), sb_v3_scale(half[1], X[nodes[1]]));
        CHECK_OK(sb_body_change_move_node(change, node, x, nodes, half, 2, &error));
        for (int i = 0; i < o.cells; i++)
            for (int k = 0; k < 2; k++) {
                sb_change_cell cell = sb_default_change_cell();
                int corners[4];
                for (int a = 0; a < 4; a++)
                    corners[a] = o.nodes[i][a] == nodes[k] ? node : o.nodes[i][a];
                cell.nodes = corners;
                cell.parent = o.cell[i];
                CHECK_OK(k == 0 ? sb_body_change_replace_cell(change, o.cell[i], &cell, &error)
                                : sb_body_change_add_cell(change, &cell, NULL, &error));
            }
        CHECK_OK(sb_body_change_commit(change, &error));
        CHECK(sb_v3_norm(sb_v3_sub(sb_body_displacements(s.body)[node],
                                   sb_v3_add(sb_v3_scale(half[0], ends[0]), sb_v3_scale(half[1], ends[1])))) <
              REAL(scene_tolerance(1e-15, 1)));
    }
    for (int i = 0; i < 12; i++) {
        done += slide(s.body, &seed, &node, &error) == SB_OK;
        CHECK_OK(sb_body_step(s.body, REAL(0.005), NULL));
    }
    CHECK(done > 4);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, twin.body, &report)))
        printf("%s\n", report.error.message);
    CHECK_INT(report.steps, 12);
    CHECK(sb_body_state_hash(twin.body) == sb_body_state_hash(s.body));
    sb_recording_destroy(recording);
    free_scene(&s);
    free_scene(&twin);
}

/* ---- in place ---- */

/* A plain body changes without a single allocation while its slack lasts, and so do the steps between. */
static void test_no_allocations(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.15)), 0.1);
    const sb_precond_kind kinds[] = {SB_PRECOND_IC0, SB_PRECOND_SSOR, SB_PRECOND_BLOCK_JACOBI};
    for (int k = 0; k < 3; k++) {
        sb_body_def def = live_def(&mesh, with_prony(sb_material_neo_hookean(5000, REAL(0.4), 1000)), SB_NEWMARK);
        unsigned long long seed = 61 + (unsigned long long)k;
        op *ops = (op *)malloc(MOST_OPS * sizeof *ops);
        sb_error error;
        sb_body *body;
        int depth = 0;
        def.slack = 2;
        def.allocator = allocator;
        def.preconditioner = kinds[k];
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        memory.calls = 0;
        for (int i = 0; i < 60; i++) {
            op_kind kind = (op_kind)(int)(check_random(&seed) * (int)OP_KINDS);
            int back = depth && check_random(&seed) < 0.4;
            sb_result result =
                back ? undo(body, ops + depth - 1, &error) : change_at_random(body, &seed, kind, ops + depth, &error);
            CHECK(result == SB_OK || result == SB_ERROR_MESH);
            if (result == SB_OK)
                depth += back ? -1 : ops[depth].cells > 0;
            CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        }
        CHECK_INT(memory.calls, 0);
        CHECK_OK(sb_body_live_check(body, &error));
        free(ops);
        sb_body_destroy(body);
    }
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

/* In place and by a body made anew, which lack of room, a constraint or a load on the spot ask for, the bits are the
 * same. */
static void test_both_ways(void)
{
    const sb_material materials[] = {sb_material_corotated(5000, REAL(0.4), 1000),
                                     with_prony(sb_material_neo_hookean(5000, REAL(0.4), 1000)),
                                     with_prony(with_fibres(sb_material_stable_neo_hookean(5000, REAL(0.4), 1000)))};
    const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_CENTRAL_DIFFERENCE, SB_EULER};
    const sb_precond_kind remade[] = {SB_PRECOND_MULTIGRID, SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY};
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.15)), 0.1);
    sb_vec3 *fibres = (sb_vec3 *)calloc((size_t)mesh.element_count, sizeof *fibres);
    for (int e = 0; e < mesh.element_count; e++)
        fibres[e] = sb_v3(1, REAL(e % 3), 0);
    for (int k = 0; k < 12; k++) {
        sb_body_def def = live_def(&mesh, materials[k % 3], integrators[k / 3]);
        unsigned long long seeds[2] = {71, 71};
        sb_body *bodies[2];
        sb_error error;
        op o[2];
        int node, same = 1;
        def.fibres = k % 3 == 2 ? fibres : NULL;
        def.mass = k == 4 ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
        def.preconditioner = k < 9 ? SB_PRECOND_AUTO : remade[k - 9];
        for (int b = 0; b < 2; b++) {
            def.slack = b ? 4 : REAL(0.001); /* the second has room for all, the first grows again and again */
            bodies[b] = scene_body(&def);
            scene_fix_plane(bodies[b], &mesh, 0, 0, SB_XYZ);
            set_in_motion(bodies[b], 1);
        }
        for (int i = 0; i < 40 && same; i++) {
            for (int b = 0; b < 2; b++) {
                sb_result result = i % 7 == 6
                                       ? slide(bodies[b], seeds + b, &node, &error)
                                       : change_at_random(bodies[b], seeds + b, (op_kind)(i % OP_KINDS), o + b, &error);
                CHECK(result == SB_OK || result == SB_ERROR_MESH);
                if (i % 5 == 1 && result == SB_OK && o[b].cells)
                    CHECK_OK(undo(bodies[b], o + b, &error));
                CHECK_OK(sb_body_step(bodies[b], REAL(0.001), NULL));
            }
            same = sb_body_state_hash(bodies[0]) == sb_body_state_hash(bodies[1]);
        }
        if (!CHECK(same))
            printf("material %d, integrator %d\n", k % 3, k / 3);
        for (int b = 0; b < 2; b++) {
            CHECK_OK(sb_body_live_check(bodies[b], &error));
            sb_body_destroy(bodies[b]);
        }
    }
    free(fibres);
    sb_mesh_free(&mesh);
}

/* Every allocation of plain bodies that grow fails in turn, too. */
static void test_memory_in_place(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    unsigned long long seed = 83, seed2 = 83;
    int failures = 0;
    sb_body *body, *twin;
    sb_error error;
    op o;
    def.slack = REAL(0.1);
    twin = scene_body(&def);
    def.allocator = allocator;
    body = scene_body(&def);
    for (int i = 0; i < 30; i++) {
        op_kind kind = (op_kind)(i % OP_COPY_NODE);
        uint64_t hash = sb_body_state_hash(body);
        sb_result result = SB_ERROR_MEMORY;
        int live = memory.live;
        CHECK_OK(change_at_random(twin, &seed2, kind, &o, &error));
        for (int n = 1; result != SB_OK && n < 400; n++) {
            unsigned long long trial = seed;
            memory.calls = 0;
            memory.fail_at = n;
            result = change_at_random(body, &trial, kind, &o, &error);
            memory.fail_at = 0;
            if (result == SB_OK) {
                seed = trial;
                break;
            }
            failures++;
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_INT(memory.live, live);
            CHECK(sb_body_state_hash(body) == hash);
        }
        CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        CHECK_OK(sb_body_step(twin, REAL(0.002), NULL));
        CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
    }
    CHECK(failures > 100);
    sb_body_destroy(body);
    sb_body_destroy(twin);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

/* Where there is no memory for multigrid's levels after a change, the change holds; steps ask for them again, and until
 * they get them leave everything as it is. */
static void test_memory_of_levels(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.15)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
    unsigned long long seeds[2] = {67, 67};
    sb_body *body, *twin;
    sb_error error;
    int failures = 0;
    op o;
    def.slack = 4;
    def.preconditioner = SB_PRECOND_MULTIGRID;
    twin = scene_body(&def);
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    for (int n = 1; n < 40; n++) {
        sb_step_info info;
        CHECK_OK(change_at_random(twin, seeds + 1, (op_kind)(n % OP_COPY_NODE), &o, &error));
        memory.calls = 0;
        memory.fail_at = n;
        CHECK_OK(change_at_random(body, seeds, (op_kind)(n % OP_COPY_NODE), &o, &error));
        if (memory.calls >= n) {
            uint64_t hash = sb_body_state_hash(body);
            failures++;
            memory.calls = 0;
            memory.fail_at = 1;
            CHECK_RESULT(sb_body_step(body, REAL(0.002), &info), SB_ERROR_MEMORY);
            CHECK_RESULT(info.error.result, SB_ERROR_MEMORY);
            CHECK(sb_body_state_hash(body) == hash);
        }
        memory.fail_at = 0;
        CHECK_OK(sb_body_live_check(body, &error));
        CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        CHECK_OK(sb_body_step(twin, REAL(0.002), NULL));
        CHECK(sb_body_state_hash(body) == sb_body_state_hash(twin));
    }
    CHECK(failures > 10);
    sb_body_destroy(body);
    sb_body_destroy(twin);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

/* After changes each preconditioner needs at most 1.2 times the iterations of one made anew with that mesh. */
static void test_iterations(void)
{
    static const double shares[] = {0.01, 0.05, 0.2};
    const sb_precond_kind kinds[] = {SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_SSOR,      SB_PRECOND_IC0,
                                     SB_PRECOND_FSAI,         SB_PRECOND_MULTIGRID, SB_PRECOND_CHOLESKY};
    sb_mesh mesh = scene_box(SB_TET4, 9, 6, 6, sb_v3(REAL(0.18), REAL(0.12), REAL(0.12)), 0.1);
    for (size_t k = 0; k < sizeof kinds / sizeof kinds[0]; k++)
        for (int s = 0; s < 3; s++) {
            sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_EULER);
            unsigned long long seed = 91 + (unsigned long long)s;
            sb_step_info info, other;
            sb_body *body, *fresh;
            sb_mesh now;
            sb_error error;
            int *nodes, changed = 0;
            op o;
            def.preconditioner = kinds[k];
            def.slack = 1;
            def.tolerance = REAL(1e-5);
            body = scene_body(&def);
            while (changed < shares[s] * mesh.element_count) {
                if (change_at_random(body, &seed, (op_kind)(changed % OP_REMOVE_CELL), &o, &error) == SB_OK)
                    changed += o.cells;
                CHECK_OK(sb_body_step(body, REAL(1e-4), NULL)); /* through each state on the way */
            }
            sb_body_reset(body);
            nodes = (int *)malloc((size_t)sb_body_node_count(body) * sizeof *nodes);
            CHECK_OK(sb_body_get_mesh(body, NULL, &now, nodes, NULL, &error));
            def.mesh = &now;
            def.slack = 0;
            fresh = scene_body(&def);
            for (int i = 0; i < sb_body_node_count(body); i++)
                if (nodes[i] >= 0 && sb_body_rest_positions(body)[i].x < REAL(1e-9)) {
                    CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
                    CHECK_OK(sb_body_fix_nodes(fresh, nodes + i, 1, SB_XYZ));
                }
            CHECK_OK(sb_body_step(body, REAL(0.02), &info));
            CHECK_OK(sb_body_step(fresh, REAL(0.02), &other));
            if (getenv("CHECK_SLOW"))
                printf("  %s, %g of the cells: %d iterations, made anew %d\n", sb_precond_string(kinds[k]), shares[s],
                       info.pcg_iterations, other.pcg_iterations);
            CHECK(info.pcg_iterations <= 1.2 * other.pcg_iterations + 1);
            free(nodes);
            sb_body_destroy(body);
            sb_body_destroy(fresh);
            sb_mesh_free(&now);
        }
    sb_mesh_free(&mesh);
}

/* Splits that are undone in the order in which they were made leave the highest slot to be used first: a free node lies
 * below it, in a row of the matrix that has just come back. */
static void test_slots_between(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.15)), 0.1);
    sb_body_def def = live_def(&mesh, sb_material_corotated(5000, REAL(0.4), 1000), SB_NEWMARK);
    const sb_real quarters[4] = {REAL(0.25), REAL(0.25), REAL(0.25), REAL(0.25)};
    for (int kind = SB_PRECOND_NONE; kind <= SB_PRECOND_MULTIGRID; kind++) {
        sb_body *body;
        sb_error error;
        op ops[4];
        def.preconditioner = (sb_precond_kind)kind;
        def.slack = 1;
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        memset(ops, 0, sizeof ops);
        for (int i = 0; i < 4; i++) { /* tets far from each other */
            ops[i].kind = OP_SPLIT_TET;
            ops[i].count = 4;
            memcpy(ops[i].corners, nodes_of(body, i * (mesh.element_count / 4)), sizeof ops[i].corners);
            if (i < 3)
                CHECK_OK(split(body, ops + i, quarters, &error));
        }
        CHECK_INT(ops[2].node, mesh.node_count + 2);
        for (int i = 0; i < 3; i++)
            CHECK_OK(undo(body, ops + i, &error));
        CHECK_INT(sb_body_node_count(body), mesh.node_count);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(split(body, ops + 3, quarters, &error));
        CHECK_INT(ops[3].node, mesh.node_count + 2);
        if (!CHECK_OK(sb_body_live_check(body, &error)))
            printf("%s: %s\n", sb_precond_string((sb_precond_kind)kind), error.message);
        set_in_motion(body, 1);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK(all_finite(body));
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

CHECK_SUITE(live_mesh, {"random changes", test_random_changes}, {"random meshes", test_random_meshes},
            {"the inverse order gives back all bits", test_inverse}, {"a long way and back", test_long_inverse},
            {"materials and integrators", test_materials}, {"against a body made anew", test_against_fresh},
            {"pressure follows", test_pressure_follows}, {"forces of loads stay", test_forces_stay},
            {"mappings follow", test_mapping_follows}, {"supports follow", test_supports_follow},
            {"listeners", test_listeners}, {"bad changes are refused by name", test_refused},
            {"every allocation fails", test_memory_failures}, {"threads", test_threads},
            {"saved and loaded between changes", test_state}, {"levels of materials", test_levels_of_materials},
            {"recorded and replayed", test_record}, {"beyond the slack", test_growth},
            {"no allocations while slack lasts", test_no_allocations}, {"in place and anew", test_both_ways},
            {"free slots below one in use", test_slots_between},
            {"every allocation of a plain body fails", test_memory_in_place},
            {"no memory for levels", test_memory_of_levels}, {"iterations after changes", test_iterations},
            {"slides", test_slide}, {"momentum of slides", test_slide_momentum},
            {"a slide of one free node", test_slide_alone}, {"supports of slides", test_slide_supports},
            {"calls and recordings of slides", test_slide_calls});
