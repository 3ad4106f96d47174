/* Faces that contact acts on follow the changes of a body's mesh: against faces made anew, to the bit. They are
 * internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/live_mesh.h"
#include "../src/softbody/contact/contact_faces.h"

#include "check.h"
#include "follow_change.h"
#include "scene.h"

/* ---- a body and faces that follow it ----------------------------------------------------------------------------- */

typedef struct pair {
    sb_mesh mesh;
    sb_body *body;
    sbi_contact_faces *faces;
    scene_memory memory; /* of the faces */
    int follows, gave_up, refuse;
} pair;

static sb_result pair_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    return sbi_contact_faces_reserve(((pair *)user)->faces, body, change, error);
}

static void pair_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    ((pair *)user)->follows++;
    sbi_contact_faces_follow(((pair *)user)->faces, body, change);
}

static void pair_give_up(void *user) { ((pair *)user)->gave_up++; }

/* One that comes after the faces and now and then refuses. */
static sb_result pair_refuse(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    (void)body;
    (void)change;
    return ((pair *)user)->refuse ? sbi_fail(error, SB_ERROR_MEMORY, "refused by the test") : SB_OK;
}

static void pair_ignore(void *user, const sb_body *body, const sb_mesh_change *change)
{
    (void)user;
    (void)body;
    (void)change;
}

/* Body and faces of the mesh. */
static void pair_listen(pair *p, double slack)
{
    sb_body_def def = sb_default_body_def();
    sb_body_listener listener;
    sb_allocator allocator = scene_allocator(&p->memory);
    def.mesh = &p->mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.slack = REAL(slack);
    p->body = scene_body(&def);
    CHECK_OK(sbi_contact_faces_create(p->body, &allocator, &p->faces, NULL));
    memset(&listener, 0, sizeof listener);
    listener.user = p;
    listener.reserve = pair_reserve;
    listener.follow = pair_follow;
    listener.give_up = pair_give_up;
    CHECK_OK(sb_body_listen(p->body, &listener, NULL, NULL));
    listener.reserve = pair_refuse;
    listener.follow = pair_ignore;
    listener.give_up = NULL;
    CHECK_OK(sb_body_listen(p->body, &listener, NULL, NULL));
}

static void pair_make(pair *p, sb_element_type type, double slack)
{
    memset(p, 0, sizeof *p);
    p->mesh = scene_box(type, 4, 3, 3, sb_v3(REAL(0.2), REAL(0.15), REAL(0.1)), 0.1);
    pair_listen(p, slack);
}

static void pair_free(pair *p)
{
    sbi_contact_faces_destroy(p->faces);
    CHECK_INT(p->memory.live, 0);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

/* ---- the same as made anew --------------------------------------------------------------------------------------- */

static int pair_differs(const void *a, const void *b, size_t count, size_t size)
{
    return memcmp(a, b, count * size) != 0;
}

/* What a query finds, as a number. */
static unsigned long long pair_found(sbi_contact_faces *faces, sb_vec3 low, sb_vec3 high)
{
    int *found = (int *)calloc((size_t)faces->face_end + 1, sizeof(int));
    int count = sbi_contact_faces_query(faces, low, high, found, faces->face_end);
    unsigned long long hash = scene_hash(found, (size_t)count * sizeof(int)) + (unsigned long long)count;
    free(found);
    return hash;
}

/* Places where the two differ. */
static int pair_wrong(sbi_contact_faces *a, sbi_contact_faces *b, const sb_body *body, unsigned long long *seed)
{
    size_t count = (size_t)a->face_end;
    int wrong = a->face_end != b->face_end || a->flat_count != b->flat_count || a->width != b->width;
    if (wrong)
        return 1;
    wrong += pair_differs(a->keys, b->keys, count, sizeof(int));
    wrong += pair_differs(a->elements, b->elements, count, sizeof(int));
    wrong += pair_differs(a->regions, b->regions, count, sizeof(int));
    wrong += pair_differs(a->sizes, b->sizes, count, 1) + pair_differs(a->sides, b->sides, count, 1);
    wrong += pair_differs(a->nodes, b->nodes, count, (size_t)a->width * sizeof(int));
    wrong += pair_differs(a->areas, b->areas, count, sizeof(sb_real));
    wrong += pair_differs(a->lengths, b->lengths, count, sizeof(sb_real));
    wrong += pair_differs(a->node_areas, b->node_areas, (size_t)sb_body_node_count(body), sizeof(sb_real));
    sbi_contact_faces_refit(a, sb_body_positions(body), sb_body_velocities(body), REAL(0.01));
    sbi_contact_faces_refit(b, sb_body_positions(body), sb_body_velocities(body), REAL(0.01));
    for (int q = 0; q < 5; q++) {
        double x = check_random_in(seed, 0, 0.2), y = check_random_in(seed, 0, 0.15), r = check_random_in(seed, 0, 0.1);
        sb_vec3 at = sb_v3(REAL(x), REAL(y), REAL(check_random_in(seed, 0, 0.1))),
                half = sb_v3(REAL(r), REAL(r), REAL(r));
        wrong += pair_found(a, sb_v3_sub(at, half), sb_v3_add(at, half)) !=
                 pair_found(b, sb_v3_sub(at, half), sb_v3_add(at, half));
    }
    for (int f = 0; f < a->face_end; f++)
        wrong += pair_differs(sbi_contact_face_blocks(a, body, f), sbi_contact_face_blocks(b, body, f),
                              (size_t)(a->sizes[f] * a->sizes[f]), sizeof(int));
    return wrong;
}

/* Updates, compares with faces made anew, and checks where faces went: cells are marked that went meanwhile. */
static void pair_check(pair *p, const unsigned char *gone, unsigned long long *seed)
{
    sbi_contact_faces *anew;
    int before = p->faces->live.seen_count, changed = -1, wrong = 0, last = -1;
    int *keys = (int *)calloc((size_t)before + 1, sizeof(int));
    memcpy(keys, p->faces->live.seen, (size_t)before * sizeof(int));
    if (!CHECK_OK(sbi_contact_faces_update(p->faces, p->body, &changed, NULL)) ||
        !CHECK_OK(sbi_contact_faces_create(p->body, NULL, &anew, NULL)))
        return;
    CHECK_INT(changed, p->follows > 0);
    CHECK_INT(pair_wrong(p->faces, anew, p->body, seed), 0);
    for (int f = 0; f < before && changed; f++) {
        int now = p->faces->live.moved[f];
        wrong += now >= p->faces->face_end || (now >= 0 && (now <= last || p->faces->keys[now] != keys[f]));
        wrong += now >= 0 && gone && gone[keys[f] / p->faces->side_count];
        last = now >= 0 ? now : last;
        for (int k = 0; k < p->faces->face_end && now < 0; k++) /* one that went is not there, or anew */
            wrong += p->faces->keys[k] == keys[f] && gone && !gone[keys[f] / p->faces->side_count];
    }
    CHECK_INT(wrong, 0);
    p->follows = 0;
    sbi_contact_faces_destroy(anew);
    free(keys);
}

/* ---- changes at random ------------------------------------------------------------------------------------------- */

static void pair_mark_gone(const follow_op *o, unsigned char *gone)
{
    for (int i = 0; i < o->cells && o->kind != 1; i++)
        gone[o->cell[i]] = 1;
}

/* Material comes apart at a node: some of its cells get a copy of it. */
static sb_result pair_part(sb_body *body, unsigned char *gone, unsigned long long *seed)
{
    sb_body_change *change;
    sb_real one = 1;
    int node = sb_body_cell_nodes(body, follow_pick(body, seed))[0], copy, stays = 0, goes = 0;
    sb_result result = sb_body_change_begin(body, &change, NULL);
    if (!CHECK_OK(result))
        return result;
    result =
        sb_body_change_add_node(change, sb_body_rest_positions(body)[node], &node, &one, 1, SB_NODE_COPY, &copy, NULL);
    for (int e = 0; e < sb_body_element_count(body) && result == SB_OK; e++) {
        const int *nodes = sb_body_cell_nodes(body, e);
        sb_change_cell cell = sb_default_change_cell();
        int other[4];
        if (!nodes || !follow_has(nodes, 4, node) || (stays && check_random(seed) < 0.5) || !stays++)
            continue;
        for (int a = 0; a < 4; a++)
            other[a] = nodes[a] == node ? copy : nodes[a];
        cell.nodes = other;
        cell.parent = e;
        result = sb_body_change_replace_cell(change, e, &cell, NULL);
        gone[e] = 1;
        goes++;
    }
    if (result == SB_OK && goes)
        result = sb_body_change_commit(change, NULL);
    if (result != SB_OK || !goes)
        sb_body_change_cancel(change);
    return goes ? result : SB_ERROR_MESH;
}

static void test_follow_changes(void)
{
    enum { CELLS = 40000 };
    unsigned char *gone = (unsigned char *)calloc(CELLS, 1);
    unsigned long long seed = 21;
    for (int round = 0; round < (check_quick() ? 2 : 8); round++) {
        pair p;
        int made = 0, parts = 0;
        pair_make(&p, SB_TET4, round % 2 ? 0.02 : 1);
        for (int i = 0; i < 60; i++) {
            follow_op o;
            double kind = check_random(&seed);
            p.refuse = check_random(&seed) < 0.1;
            if (kind < 0.3) {
                unsigned char *marks = (unsigned char *)calloc(CELLS, 1);
                if (pair_part(p.body, marks, &seed) == SB_OK) {
                    parts++;
                    for (int e = 0; e < CELLS; e++)
                        gone[e] |= marks[e];
                }
                free(marks);
            } else if (follow_change(p.body, &o, kind < 0.6 ? 0 : kind < 0.75 ? 1 : 2, 4, &seed) == SB_OK) {
                pair_mark_gone(&o, gone);
                made++;
            }
            if (check_random(&seed) < 0.4) { /* several changes before an update */
                pair_check(&p, gone, &seed);
                memset(gone, 0, CELLS);
            }
        }
        pair_check(&p, gone, &seed);
        memset(gone, 0, CELLS);
        CHECK(made > 20 && parts > 5 && p.gave_up > 0);
        pair_free(&p);
    }
    free(gone);
}

/* A change taken back leaves the faces as they were, to the bit. */
static void test_follow_changes_taken_back(void)
{
    unsigned long long seed = 22;
    for (int round = 0; round < 10; round++) {
        pair p;
        static follow_op ops[12]; /* too large for small stacks */
        int count = 0;
        sbi_contact_faces *before;
        pair_make(&p, SB_TET4, 0.3);
        CHECK_OK(sbi_contact_faces_create(p.body, NULL, &before, NULL));
        for (int i = 0; i < 12; i++)
            count += follow_change(p.body, &ops[count], i % 3, 4, &seed) == SB_OK;
        pair_check(&p, NULL, &seed);
        while (count > 0)
            CHECK_OK(follow_undo(p.body, &ops[--count]));
        pair_check(&p, NULL, &seed);
        for (int f = 0; f < before->face_end; f++)
            before->versions[f] = -1;
        CHECK_INT(pair_wrong(p.faces, before, p.body, &seed), 0);
        sbi_contact_faces_destroy(before);
        pair_free(&p);
    }
}

/* Other elements lose cells, and their nodes slide. */
static void test_follow_other_elements(void)
{
    static const sb_element_type types[] = {SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    unsigned long long seed = 23;
    for (int t = 0; t < 4; t++) {
        pair p;
        int made = 0;
        pair_make(&p, types[t], 0.1);
        for (int i = 0; i < (check_quick() ? 6 : 16); i++) {
            follow_op o;
            unsigned char gone[2000] = {0};
            if (follow_change(p.body, &o, 1 + (i % 4 != 0), sb_mesh_element_width(&p.mesh), &seed) == SB_OK) {
                pair_mark_gone(&o, gone);
                made++;
            }
            pair_check(&p, gone, &seed);
        }
        CHECK(made > (check_quick() ? 0 : 2));
        pair_free(&p);
    }
}

/* Two cells in one place: when the first goes, the faces are the other's. */
static void test_follow_cells_in_one_place(void)
{
    sb_vec3 nodes[5] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};
    int cells[12] = {0, 1, 2, 3, 1, 2, 0, 3, 1, 2, 3, 4};
    unsigned long long seed = 26;
    sb_body_change *change;
    pair p;
    memset(&p, 0, sizeof p);
    p.mesh.node_count = 5, p.mesh.nodes = nodes;
    p.mesh.element_type = SB_TET4, p.mesh.element_count = 3, p.mesh.elements = cells;
    pair_listen(&p, 1);
    for (int i = 0; i < 2; i++) {
        CHECK_INT(p.faces->face_end, 6);
        if (!CHECK_OK(sb_body_change_begin(p.body, &change, NULL)))
            return;
        if (i == 0) {
            CHECK_OK(sb_body_change_remove_cell(change, 0, NULL));
        } else {
            sb_change_cell cell = sb_default_change_cell();
            cell.nodes = cells;
            CHECK_OK(sb_body_change_add_cell(change, &cell, NULL, NULL));
        }
        CHECK_OK(sb_body_change_commit(change, NULL));
        pair_check(&p, NULL, &seed);
        for (int f = 0; f < p.faces->face_end; f++)
            CHECK(p.faces->elements[f] == 2 || p.faces->elements[f] == 1 - i);
    }
    CHECK_INT(p.faces->face_end, 6);
    sbi_contact_faces_destroy(p.faces);
    sb_body_destroy(p.body);
}

/* ---- other meshes, memory ---------------------------------------------------------------------------------------- */

/* A state with another mesh is loaded: all faces are new ones. */
static void test_follow_states(void)
{
    unsigned long long seed = 24;
    for (int round = 0; round < 6; round++) {
        pair p;
        follow_op o;
        size_t bytes;
        void *state;
        int changed;
        pair_make(&p, SB_TET4, 0.1);
        for (int i = 0; i < 30 && round % 2; i++)
            follow_change(p.body, &o, i % 2 ? 0 : 2, 4, &seed);
        pair_check(&p, NULL, &seed);
        bytes = sb_body_state_size(p.body);
        state = malloc(bytes);
        CHECK_OK(sb_body_state_save(p.body, state, bytes));
        for (int i = 0; i < 30; i++)
            follow_change(p.body, &o, round < 3 ? 2 : 0, 4, &seed);
        if (round % 3 == 0)
            pair_check(&p, NULL, &seed);
        CHECK_OK(sb_body_state_load(p.body, state, bytes, NULL));
        follow_change(p.body, &o, 0, 4, &seed); /* one more before the update */
        p.memory.fail_from = p.memory.calls + 1;
        CHECK_RESULT(sbi_contact_faces_update(p.faces, p.body, &changed, NULL), SB_ERROR_MEMORY);
        p.memory.fail_from = 0;
        for (int fail = 1; fail < 50; fail++) {
            sb_result result;
            p.memory.fail_at = p.memory.calls + fail;
            result = sbi_contact_faces_update(p.faces, p.body, &changed, NULL);
            if (result == SB_OK)
                break;
            CHECK_RESULT(result, SB_ERROR_MEMORY);
        }
        p.memory.fail_at = 0;
        CHECK(changed);
        p.follows = 0;
        pair_check(&p, NULL, &seed);
        free(state);
        pair_free(&p);
    }
}

/* Without memory a change fails, and faces are what they were; a step takes none. */
static void test_follow_memory(void)
{
    unsigned long long seed = 25;
    pair p;
    int failed = 0, calls;
    pair_make(&p, SB_TET4, 0.02);
    for (int i = 0; i < 150; i++) {
        follow_op o;
        p.memory.fail_at = p.memory.calls + 1 + i % 2;
        failed += follow_change(p.body, &o, 0, 4, &seed) == SB_ERROR_MEMORY;
        p.memory.fail_at = 0;
        if (i % 3)
            follow_change(p.body, &o, 0, 4, &seed);
        calls = p.memory.calls;
        pair_check(&p, NULL, &seed);
        CHECK_INT(p.memory.calls, calls);
    }
    CHECK(failed > 0);
    pair_free(&p);
}

CHECK_SUITE(contact_follow, {"random changes", test_follow_changes},
            {"changes taken back", test_follow_changes_taken_back}, {"other elements", test_follow_other_elements},
            {"cells in one place", test_follow_cells_in_one_place}, {"states with other meshes", test_follow_states},
            {"memory", test_follow_memory});
