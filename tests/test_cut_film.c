/* Films without volume, in what is drawn: blades that go exactly along nodes, faces and the boundary of a mesh part
 * pieces off whose nodes have no material. In bodies that fall, hang and shake, from millimetres to kilometres, they
 * are drawn at the tissue, never left behind, and where tissue under them has come apart they span the gap without
 * volume; surfaces stay closed about all volume, and all mass is there.
 *
 * CHECK_SLOW=n: n times as many. CUT_FILM=n runs scene n alone. */
#include "cut_drawing.h"
#include "random_case.h"

typedef struct film_scene {
    block b;
    sb_cut_surface *surface;
    double unit, size, volume, removed;
    int number, quadratic;
    char name[200];
} film_scene;

enum { CUTS = 3, STEPS = 6 };

static int film_make(film_scene *s, int number, unsigned long long *seed)
{
    static const double units[3] = {1e-3, 1, 1e3};
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut = sb_default_cut_def();
    sb_vec3 low, high;
    int cells[3], lattice, hung;
    memset(s, 0, sizeof *s);
    s->number = number;
    s->unit = units[number % 3];
    s->quadratic = random_below(seed, 4) == 0;
    for (int k = 0; k < 3; k++)
        cells[k] = 1 + (s->quadratic ? 0 : 1) + random_below(seed, 2);
    s->b.mesh =
        scene_box(s->quadratic ? SB_TET10 : SB_TET4, cells[0], cells[1], cells[2],
                  sb_v3_scale(REAL(s->unit), block_size), !s->quadratic && random_below(seed, 3) == 0 ? 0.2 : 0);
    sb_mesh_bounds(&s->b.mesh, &low, &high);
    s->size = (double)sb_v3_norm(sb_v3_sub(high, low));
    def.mesh = &s->b.mesh;
    def.material = sb_material_corotated(REAL(5000 * s->unit * s->unit), REAL(0.4), 1000);
    def.gravity = sb_v3(REAL(0.7 * s->unit), REAL(-0.5 * s->unit), REAL(-2 * s->unit));
    def.damping_stiffness = REAL(0.002);
    def.slack = 4;
    s->b.body = scene_body(&def);
    hung = random_below(seed, 2);
    for (int i = 0; i < s->b.mesh.node_count && hung; i++)
        if (s->b.mesh.nodes[i].x < low.x + REAL(1e-6 * s->size))
            CHECK_OK(sb_body_fix_nodes(s->b.body, &i, 1, SB_XYZ));
    lattice = intervals_of[random_below(seed, s->quadratic ? 2 : 3)];
    cut.body = s->b.body;
    cut.lattice = lattice;
    cut.front = random_below(seed, 2) ? SB_CUT_GLUE : SB_CUT_LAG;
    cut.least_piece = REAL(random_below(seed, 2));
    CHECK_OK(sb_cut_create(&cut, &s->b.cut, NULL));
    CHECK_OK(sb_cut_surface_create(s->b.cut, NULL, &s->surface, NULL));
    for (int e = 0; e < s->b.mesh.element_count; e++)
        s->volume += (double)sb_mesh_element_volume(&s->b.mesh, e);
    snprintf(s->name, sizeof s->name, "scene %d: %s, lattice %d, %s, least piece %g, %s, unit %g", number,
             s->quadratic ? "tet10" : "tet4", lattice, cut.front ? "glue" : "lag", (double)cut.least_piece,
             hung ? "hung" : "free", s->unit);
    return s->b.body && s->b.cut && s->surface;
}

static void film_free(film_scene *s)
{
    sb_cut_surface_destroy(s->surface);
    block_free(&s->b);
}

/* A square along a face of an element, through nodes across an axis, or along a side of the block, where they are
 * now. */
static void cut_flat(film_scene *s, unsigned long long *seed)
{
    int kind = random_below(seed, 4), axis = random_below(seed, 3);
    const sb_vec3 *x = sb_body_positions(s->b.body);
    const int *cell =
        s->b.mesh.elements + sb_mesh_element_width(&s->b.mesh) * random_below(seed, s->b.mesh.element_count);
    sb_vec3 middle = x[random_below(seed, s->b.mesh.node_count)], normal, triangles[6];
    double half = s->size * (random_below(seed, 3) ? 1 : check_random_in(seed, 0.05, 0.5));
    sb_cut_info info;
    sb_error error;
    if (kind == 0) {
        middle = x[cell[0]];
        normal = sb_v3_cross(sb_v3_sub(x[cell[1]], middle), sb_v3_sub(x[cell[2 + random_below(seed, 2)]], middle));
    } else {
        normal = sb_v3(REAL(axis == 0), REAL(axis == 1), REAL(axis == 2));
    }
    if (kind == 3)
        middle = sb_v3_madd(middle, REAL(1e-9 * s->size), normal);
    normal = sb_v3_scale((random_below(seed, 2) ? 1 : -1) / sb_v3_norm(normal), normal);
    square_make(middle, normal, half, triangles);
    if (!CHECK_OK(sb_cut_triangles(s->b.cut, triangles, 2, &info, &error)))
        printf("%s: %s\n", s->name, error.message);
    s->removed += (double)info.removed_volume;
}

/* How far vertices are outside of the box about all nodes with material, of the size. */
static double distance_from_tissue(const film_scene *s, const sb_cut_drawing *d)
{
    const sb_body *body = s->b.body;
    sb_vec3 low = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX), high = sb_v3_scale(-1, low);
    double worst = 0;
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (body->node_component[i] >= 0) {
            low = sb_v3(sb_min(low.x, body->position[i].x), sb_min(low.y, body->position[i].y),
                        sb_min(low.z, body->position[i].z));
            high = sb_v3(sb_max(high.x, body->position[i].x), sb_max(high.y, body->position[i].y),
                         sb_max(high.z, body->position[i].z));
        }
    for (int f = 0; f < d->triangle_count; f++)
        for (int k = 0; k < 3 && is_drawn(d, f); k++) {
            sb_vec3 x = d->positions[d->triangles[f][k]], under = sb_v3_sub(low, x), over = sb_v3_sub(x, high);
            worst = fmax(worst, fmax((double)under.x, fmax((double)under.y, (double)under.z)));
            worst = fmax(worst, fmax((double)over.x, fmax((double)over.y, (double)over.z)));
        }
    return worst / s->size;
}

/* Of all of the element of a cell, where its corners are now. */
static double cell_volume(const sb_body *body, int cell)
{
    const sb_vec3 *x = sb_body_positions(body);
    const int *n = sb_body_cell_nodes(body, cell);
    sb_vec3 a = sb_v3_sub(x[n[1]], x[n[0]]), b = sb_v3_sub(x[n[2]], x[n[0]]), c = sb_v3_sub(x[n[3]], x[n[0]]);
    return (double)sb_v3_dot(a, sb_v3_cross(b, c)) / 6;
}

/* Within all triangles. */
static double drawn_volume(const sb_cut_drawing *d, const sb_vec3 *x)
{
    double volume = 0;
    for (int f = 0; f < d->triangle_count; f++)
        volume += is_drawn(d, f) ? below(x, d->triangles[f]) / 6 : 0;
    return volume;
}

static void check_drawn(film_scene *s)
{
    double close = scene_tolerance(1e-11, 1e4), volume = 0, now = 0, far;
    int more, failures = check.failures;
    sb_cut_drawing d;
    sb_error error;
    for (int e = 0; e < sb_body_element_count(s->b.body); e++)
        if (sb_body_cell_in_use(s->b.body, e)) {
            double share = (double)sb_body_cell_share(s->b.body, e);
            volume += share * (double)sb_mesh_element_volume(&s->b.mesh, sb_cut_cell_element(s->b.cut, e));
            now += share > 0 ? share * cell_volume(s->b.body, e) : 0;
        }
    CHECK_NEAR(volume + s->removed, s->volume, close * s->volume);
    CHECK_NEAR(sb_body_mass(s->b.body), 1000 * volume, close * 1000 * s->volume);
    CHECK(scene_all_finite(sb_body_positions(s->b.body), sb_body_node_count(s->b.body)));
    check_pieces(&s->b);
    if (!CHECK_OK(sb_cut_surface_update(s->surface, &error)))
        printf("%s\n", error.message);
    d = sb_cut_surface_get(s->surface);
    CHECK_INT(holes_of(&d, &more), 0);
    CHECK_NEAR(drawn_volume(&d, d.rest), volume, close * s->volume);
    if (!s->quadratic) /* tet10 are bent now */
        CHECK_NEAR(drawn_volume(&d, d.positions), now, close * s->volume);
    CHECK(scene_all_finite(d.positions, d.vertex_count) && scene_all_finite(d.normals, d.vertex_count));
    far = distance_from_tissue(s, &d);
    CHECK(far < (s->quadratic ? 0.1 : 1e-6)); /* tet10 bulge beyond their nodes */
    if (check.failures > failures)
        printf("%s\n", s->name);
}

static void check_film(int number)
{
    unsigned long long seed = 0x9E3779B97F4A7C15ULL * (unsigned long long)(number + 1);
    film_scene s;
    sb_step_info info;
    for (int i = 0; i < 8; i++)
        check_random(&seed);
    if (CHECK(film_make(&s, number, &seed)))
        for (int k = 0; k < CUTS; k++) {
            cut_flat(&s, &seed);
            for (int i = 0; i < STEPS; i++)
                if (!CHECK_OK(sb_body_step(s.b.body, REAL(0.02), &info)))
                    printf("%s: %s\n", s.name, info.error.message);
            check_drawn(&s);
        }
    film_free(&s);
}

static void test_flat(void)
{
    const char *one = getenv("CUT_FILM"), *more = getenv("CHECK_SLOW");
    int count = check_quick() ? 6 : check_rounds(24) * (more && atoi(more) > 0 ? atoi(more) : 1);
    int first = one ? atoi(one) : 0;
    for (int i = first; i < (one ? first + 1 : count); i++)
        check_film(i);
}

/* Tissue under films has come apart: glued and not, with crumbs and without. */
static void test_gaps(void)
{
    static const int scenes[4] = {93, 183, 242, 392};
    for (int i = 0; i < 4; i++)
        check_film(scenes[i]);
}

/* Pieces all of whose extents are rounding of an edge: in float they had mass and stiffness 0. */
static void test_rounding(void)
{
    static const int scenes[3] = {177, 300, 420};
    for (int i = 0; i < 3; i++)
        check_film(scenes[i]);
}

CHECK_SUITE(cut_film, {"flat cuts", test_flat}, {"across gaps", test_gaps}, {"rounding", test_rounding});
