/* Registration of organs that are cut: pieces of an element lie one upon the other at rest, and what blades have parted
 * or a cautery has taken is no skin to be drawn onto a target. */
#include "cut_block.h"

#include "register.h"

enum { UNCUT = 0, SLIT = 1, BURNT = 2, BOTH = 3, KINDS = 4 };

/* A bent organ, and a body of it at rest that is cut. */
typedef struct bent {
    sb_mesh mesh, target; /* the target: the skin of a finer one, bent */
    sb_mesh skin;         /* the same at rest */
    sb_body *body;
    sb_cut *cut;
    sb_vec3 low, high, centre;
    double size, radius; /* m; of what is burnt */
} bent;

/* Bends it upwards from where it is held. */
static sb_vec3 bend(const bent *b, sb_vec3 x)
{
    double share = ((double)x.x - (double)b->low.x) / ((double)b->high.x - (double)b->low.x) - 0.15;
    if (share > 0)
        x.z += REAL(0.15 * b->size * share * share);
    return x;
}

static void cut_organ(bent *b, int kind)
{
    sb_vec3 middle = sb_v3_scale(REAL(0.5), sb_v3_add(b->low, b->high)), triangles[6];
    double height = (double)b->high.z - (double)b->low.z;
    sb_cut_info info;
    b->radius = 0.12 * b->size;
    b->centre = sb_v3(middle.x + REAL(0.2) * (b->high.x - b->low.x), middle.y, middle.z + REAL(0.2 * height));
    if (kind == SLIT || kind == BOTH) {
        square_make(sb_v3(middle.x, middle.y, middle.z + REAL(0.3 * height)), sb_v3(1, REAL(0.1), REAL(0.05)),
                    0.3 * height, triangles);
        CHECK_OK(sb_cut_triangles(b->cut, triangles, 2, &info, NULL));
        CHECK(info.parts == 1 && info.cells > 0);
    }
    if (kind == BURNT || kind == BOTH) {
        CHECK_OK(sb_cut_ablate(b->cut, b->centre, REAL(b->radius), &info, NULL));
        CHECK(info.removed_volume > 0);
    }
}

static int make_bent(bent *b, sb_element_type type, int cells, int kind)
{
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut = sb_default_cut_def();
    sb_boundary boundary;
    sb_mesh fine;
    memset(b, 0, sizeof *b);
    if (!CHECK_OK(sb_mesh_organ(type, cells, NULL, &b->mesh, NULL)) ||
        !CHECK_OK(sb_mesh_organ(SB_TET4, 2 * cells, NULL, &fine, NULL)) ||
        !CHECK_OK(sb_mesh_boundary(&fine, 1, NULL, &boundary, NULL)))
        return 0;
    sb_mesh_bounds(&b->mesh, &b->low, &b->high);
    b->size = (double)sb_v3_norm(sb_v3_sub(b->high, b->low));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &b->target, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &b->skin, NULL));
    for (int i = 0; i < b->target.node_count; i++)
        b->target.nodes[i] = bend(b, b->target.nodes[i]);
    sb_boundary_free(&boundary);
    sb_mesh_free(&fine);
    def.mesh = &b->mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.slack = 4;
    b->body = scene_body(&def);
    for (int i = 0; i < b->mesh.node_count; i++)
        if (b->mesh.nodes[i].x < b->low.x + REAL(0.15) * (b->high.x - b->low.x))
            CHECK_OK(sb_body_hold(b->body, &i, 1, SB_XYZ, NULL));
    cut.body = b->body;
    CHECK_OK(sb_cut_create(&cut, &b->cut, NULL));
    cut_organ(b, kind);
    return b->body && b->cut;
}

static void free_bent(bent *b)
{
    sb_cut_destroy(b->cut);
    sb_body_destroy(b->body);
    sb_mesh_free(&b->mesh);
    sb_mesh_free(&b->target);
    sb_mesh_free(&b->skin);
}

/* Mean error (m) of the nodes of the uncut mesh that have material. */
static double error_of(const bent *b, int kind)
{
    double sum = 0;
    int count = 0;
    for (int i = 0; i < b->mesh.node_count; i++) {
        sb_vec3 X = b->mesh.nodes[i];
        if (kind >= BURNT && (double)sb_v3_norm(sb_v3_sub(X, b->centre)) < b->radius)
            continue;
        sum += (double)sb_v3_norm(sb_v3_sub(sb_body_positions(b->body)[i], bend(b, X)));
        count++;
    }
    return sum / count;
}

static double match_error(bent *b, int kind, const sb_mesh *surface)
{
    reg_match_def def = reg_default_match_def();
    reg_match *match = NULL;
    reg_match_info info;
    reg_loads_def loads = reg_default_loads_def();
    double error;
    def.body = b->body;
    def.target = &b->target;
    def.surface = surface;
    if (!CHECK_OK(reg_match_create(&def, &match, NULL)))
        return 1;
    CHECK_OK(reg_match_run(match, 60, &info));
    error = error_of(b, kind);
    loads.match = match;
    if (!surface)
        CHECK_OK(reg_loads_run(&loads, NULL, NULL));
    reg_match_destroy(match);
    return error;
}

static double nicp_error(bent *b, int kind, const sb_mesh *surface)
{
    reg_nicp_def def = reg_default_nicp_def();
    reg_nicp *nicp = NULL;
    double error;
    def.body = b->body;
    def.target = &b->target;
    def.surface = surface;
    if (!CHECK_OK(reg_nicp_create(&def, &nicp, NULL)))
        return 1;
    CHECK_OK(reg_nicp_run(nicp, 1000, NULL));
    error = error_of(b, kind);
    reg_nicp_destroy(nicp);
    return error;
}

/* Their own skins, and a fine one: as near to the truth as uncut. */
static void test_errors(void)
{
    for (int tet10 = 0; tet10 < (check_quick() ? 1 : 2); tet10++)
        for (int fine = 0; fine < 2; fine++) {
            double whole[2] = {0, 0};
            for (int kind = UNCUT; kind < KINDS; kind++) {
                double errors[2];
                bent b;
                if (!make_bent(&b, tet10 ? SB_TET10 : SB_TET4, tet10 ? 7 : 10, kind))
                    return;
                errors[0] = match_error(&b, kind, fine ? &b.skin : NULL);
                sb_body_reset(b.body);
                errors[1] = nicp_error(&b, kind, fine ? &b.skin : NULL);
                printf("  %s, %s skin, cut %d: %.2f and %.2f mm of %.0f\n", tet10 ? "tet10" : "tet4",
                       fine ? "fine" : "own", kind, 1e3 * errors[0], 1e3 * errors[1], 1e3 * b.size);
                for (int k = 0; k < 2; k++) {
                    whole[k] = kind == UNCUT ? errors[k] : whole[k];
                    CHECK(errors[k] <= 1.2 * whole[k]);
                }
                free_bent(&b);
            }
        }
}

/* The same bits once the sb_cut is gone, which leaves what knows the pieces. */
static void test_destroyed_cut(void)
{
    sb_vec3 *moved = NULL;
    for (int gone = 0; gone < 2; gone++) {
        bent b;
        if (!make_bent(&b, SB_TET4, 6, BOTH))
            return;
        if (gone) {
            sb_cut_destroy(b.cut);
            b.cut = NULL;
        }
        (void)match_error(&b, BOTH, NULL);
        if (!gone) {
            moved = (sb_vec3 *)malloc((size_t)sb_body_node_count(b.body) * sizeof *moved);
            memcpy(moved, sb_body_positions(b.body), (size_t)sb_body_node_count(b.body) * sizeof *moved);
        } else {
            CHECK(memcmp(moved, sb_body_positions(b.body), (size_t)sb_body_node_count(b.body) * sizeof *moved) == 0);
        }
        free_bent(&b);
    }
    free(moved);
}

/* Each allocation of a creation fails in turn. */
static void test_memory(void)
{
    bent b;
    if (!make_bent(&b, SB_TET4, 5, BOTH))
        return;
    for (int kind = 0; kind < 3; kind++)
        for (int fail = 1, done = 0; !done; fail++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_result result;
            memory.fail_at = fail;
            if (kind < 2) {
                reg_match_def def = reg_default_match_def();
                reg_match *match = NULL;
                def.body = b.body;
                def.target = &b.target;
                def.surface = kind ? &b.skin : NULL;
                def.allocator = scene_allocator(&memory);
                result = reg_match_create(&def, &match, NULL);
                memory.fail_at = 0;
                reg_match_destroy(match);
            } else {
                reg_nicp_def def = reg_default_nicp_def();
                reg_nicp *nicp = NULL;
                def.body = b.body;
                def.target = &b.target;
                def.allocator = scene_allocator(&memory);
                result = reg_nicp_create(&def, &nicp, NULL);
                memory.fail_at = 0;
                reg_nicp_destroy(nicp);
            }
            done = result == SB_OK;
            CHECK(done || result == SB_ERROR_MEMORY);
            CHECK_INT(memory.live, 0);
        }
    free_bent(&b);
}

CHECK_SUITE(register_cut, {"errors", test_errors}, {"a destroyed cut", test_destroyed_cut},
            {"failing allocations", test_memory});
