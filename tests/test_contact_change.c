/* test_contact_change: contact on meshes that change by more than faces that come and go: regions that no face had
 * before, changes that another listener refuses, bodies that grow many times over. Arrays are as long as they must be:
 * the sanitizers see to that. */
#include "contact_scene.h"

static sb_body_def soft_def(double slack)
{
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
    def.slack = REAL(slack);
    return def;
}

static sb_vec3 cell_middle(const sb_mesh *mesh, int cell)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < 4; a++)
        sum = sb_v3_madd(sum, REAL(0.25), mesh->nodes[mesh->elements[4 * cell + a]]);
    return sum;
}

/* ---- a region that lay inside ---- */

/* A block with another region within; the layer above it goes. */
static void uncover(press *p)
{
    sb_body_change *change;
    unsigned char *used = (unsigned char *)calloc((size_t)p->mesh.node_count, 1);
    CHECK_OK(sb_body_change_begin(p->body, &change, NULL));
    for (int e = 0; e < p->mesh.element_count; e++) {
        if (cell_middle(&p->mesh, e).z > REAL(0.075))
            CHECK_OK(sb_body_change_remove_cell(change, e, NULL));
        else
            for (int a = 0; a < 4; a++)
                used[p->mesh.elements[4 * e + a]] = 1;
    }
    for (int i = 0; i < p->mesh.node_count; i++)
        if (!used[i])
            CHECK_OK(sb_body_change_remove_node(change, i, NULL, NULL, 0, NULL));
    CHECK_OK(sb_body_change_commit(change, NULL));
    free(used);
}

/* Force on a sphere that presses where the layer was; the contact is made before it goes, or afterwards. */
static double pressed(int before)
{
    sb_body_def def = soft_def(1);
    sb_contact_def contact = press_exact();
    sb_tool_def tool = press_sphere(0.03, 0.3, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1051)));
    sb_region_material inner;
    double force;
    press p;
    memset(&p, 0, sizeof p);
    p.mesh = scene_box(SB_TET4, 6, 6, 4, sb_v3(REAL(0.2), REAL(0.2), REAL(0.1)), 0);
    p.mesh.regions = (int *)calloc((size_t)p.mesh.element_count, sizeof(int));
    for (int e = 0; e < p.mesh.element_count; e++) {
        sb_vec3 c = cell_middle(&p.mesh, e);
        p.mesh.regions[e] = c.z > REAL(0.03) && c.z < REAL(0.072) && c.x > REAL(0.04) && c.x < REAL(0.16) &&
                            c.y > REAL(0.04) && c.y < REAL(0.16);
    }
    inner.region = 1;
    inner.material = sb_material_corotated(REAL(2e4), REAL(0.4), 1000);
    def.mesh = &p.mesh;
    def.region_materials = &inner;
    def.region_material_count = 1;
    p.body = scene_body(&def);
    contact.body = p.body;
    contact.pairs = SB_CONTACT_SELF | SB_CONTACT_ORGANS;
    if (before)
        CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    uncover(&p);
    if (!before)
        CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    CHECK_INT(press_add(&p, &tool), 0);
    for (int i = 0; i < 6; i++) {
        press_move(&p, 0, sb_v3(REAL(0.1), REAL(0.1), REAL(0.104 - 0.001 * i)), sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
    }
    force = (double)press_wrench(&p, 0).force.z;
    press_free(&p);
    return force;
}

static void test_uncovered_region(void)
{
    double afterwards = pressed(0);
    CHECK(afterwards > 0.1);
    CHECK_NEAR(pressed(1), afterwards, scene_tolerance(1e-9, 1e5) * afterwards);
}

/* ---- changes that double the mesh ---- */

static int refuses;
static sb_result other_reserve(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    (void)user, (void)body, (void)change;
    if (refuses && error)
        memset(error, 0, sizeof *error);
    return refuses ? SB_ERROR_MEMORY : SB_OK;
}
static void other_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    (void)user, (void)body, (void)change;
}

/* Each cell again, with nodes of its own, 2 m aside. */
static sb_result grow(const press *p)
{
    sb_body_change *change;
    sb_result result;
    int cells = sb_body_element_count(p->body);
    CHECK_OK(sb_body_change_begin(p->body, &change, NULL));
    for (int e = 0; e < cells; e++) {
        const int *nodes = sb_body_cell_nodes(p->body, e);
        sb_change_cell cell = sb_default_change_cell();
        const sb_real one = 1;
        int own[4];
        for (int a = 0; a < 4; a++) {
            int from = nodes[a];
            sb_vec3 at = sb_v3_add(sb_body_rest_positions(p->body)[from], sb_v3(2, 0, 0));
            CHECK_OK(sb_body_change_add_node(change, at, &from, &one, 1, SB_NODE_COPY, &own[a], NULL));
        }
        cell.nodes = own;
        cell.parent = e;
        CHECK_OK(sb_body_change_add_cell(change, &cell, NULL, NULL));
    }
    result = sb_body_change_commit(change, NULL);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

static void step_on(press *p, sb_haptic *haptic, int from, int to)
{
    for (int i = from; i < to; i++) {
        press_move(p, 0, sb_v3(REAL(0.15), REAL(0.15), REAL(0.129 - 0.001 * i)), sb_quat_identity());
        CHECK_OK(sb_body_step(p->body, REAL(0.01), NULL));
        CHECK_OK(sb_haptic_publish(haptic));
    }
    CHECK(press_wrench(p, 0).force.z > 0);
}

/* Refused or not, steps and frames for the hand go on. */
static void test_grown(void)
{
    for (refuses = 0; refuses < 2; refuses++) {
        sb_contact_def contact = press_exact();
        sb_tool_def tool = press_sphere(0.03, 0, sb_v3(REAL(0.15), REAL(0.15), REAL(0.1301)));
        sb_haptic_def hand = sb_default_haptic_def();
        sb_body_listener listener;
        sb_haptic *haptic = NULL;
        sb_real k[6][6];
        press p;
        contact.max_contacts = 256;
        p = press_make(scene_box(SB_TET4, 4, 4, 2, sb_v3(REAL(0.2), REAL(0.2), REAL(0.1)), 0.1), soft_def(0.02),
                       contact);
        scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
        CHECK_INT(press_add(&p, &tool), 0);
        memset(&listener, 0, sizeof listener);
        listener.reserve = other_reserve;
        listener.follow = other_follow;
        CHECK_OK(sb_body_listen(p.body, &listener, NULL, NULL));
        hand.contact = p.contact;
        hand.max_force = 3;
        hand.max_stiffness = 500;
        if (CHECK_OK(sb_haptic_create(&hand, &haptic, NULL))) {
            step_on(&p, haptic, 0, 3);
            CHECK_OK(sb_contact_stiffness(p.contact, 0, k));
            CHECK_RESULT(grow(&p), refuses ? SB_ERROR_MEMORY : SB_OK);
            if (!refuses)
                CHECK_RESULT(sb_contact_stiffness(p.contact, 0, k), SB_ERROR_STATE);
            CHECK_OK(sb_haptic_publish(haptic));
            step_on(&p, haptic, 3, 6);
        }
        sb_haptic_destroy(haptic);
        press_free(&p);
    }
}

/* ---- tools too thin for faces that have gone ---- */

/* Takes away all cells and nodes that lie beyond x. */
static void remove_beyond(press *p, double x)
{
    sb_body_change *change;
    CHECK_OK(sb_body_change_begin(p->body, &change, NULL));
    for (int e = 0; e < p->mesh.element_count; e++)
        if ((double)cell_middle(&p->mesh, e).x > x)
            CHECK_OK(sb_body_change_remove_cell(change, e, NULL));
    for (int i = 0; i < p->mesh.node_count; i++)
        if ((double)p->mesh.nodes[i].x > x)
            CHECK_OK(sb_body_change_remove_node(change, i, NULL, NULL, 0, NULL));
    CHECK_OK(sb_body_change_commit(change, NULL));
}

/* A fine block, and far from it a coarse one. */
static press two_blocks(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 5, 5, 3, sb_v3(REAL(0.1), REAL(0.1), REAL(0.06)), 0.1);
    sb_mesh coarse = scene_box(SB_TET4, 2, 2, 1, sb_v3(REAL(0.8), REAL(0.8), REAL(0.4)), 0.1);
    for (int i = 0; i < coarse.node_count; i++)
        coarse.nodes[i].x += 1;
    CHECK_OK(sb_mesh_append(&mesh, &coarse, NULL));
    sb_mesh_free(&coarse);
    return press_make(mesh, soft_def(1), press_exact());
}

/* Faces count as they are when a tool is added, not as they were at the last step: after a change, and after a state
 * with another mesh was loaded. */
static void test_thin_tool(void)
{
    sb_tool_def thin = press_sphere(0.006, 0, sb_v3(REAL(0.05), REAL(0.05), REAL(0.0671)));
    press p = two_blocks(), loaded = two_blocks();
    size_t sizes[2];
    void *state[2];
    int tool;
    for (int k = 0; k < 2; k++) {
        CHECK_RESULT(sb_contact_add_tool(p.contact, &thin, &tool, NULL), k == 0 ? SB_ERROR_UNSUPPORTED : SB_OK);
        if (k == 1)
            CHECK_OK(sb_contact_remove_tool(p.contact, tool));
        sizes[k] = sb_body_state_size(p.body);
        state[k] = malloc(sizes[k]);
        CHECK_OK(sb_body_state_save(p.body, state[k], sizes[k]));
        CHECK_OK(sb_body_state_load(loaded.body, state[k], sizes[k], NULL));
        CHECK_RESULT(sb_contact_add_tool(loaded.contact, &thin, &tool, NULL), k == 0 ? SB_ERROR_UNSUPPORTED : SB_OK);
        if (k == 0)
            remove_beyond(&p, 0.5);
    }
    CHECK_OK(sb_contact_remove_tool(loaded.contact, tool));
    CHECK_OK(sb_body_state_load(loaded.body, state[0], sizes[0], NULL));
    CHECK_RESULT(sb_contact_add_tool(loaded.contact, &thin, &tool, NULL), SB_ERROR_UNSUPPORTED);
    free(state[0]);
    free(state[1]);
    press_free(&p);
    press_free(&loaded);
}

CHECK_SUITE(contact_change, {"uncovered region", test_uncovered_region}, {"grown", test_grown},
            {"thin tool", test_thin_tool});
