/* Needles in tissue whose elements lie in several organs (sb_mixture): as in tissue of one material that has the
 * moduli, density and friction of the mixture in closed form, and as in a finer mesh. */
#include "needle_scene.h"

static const double dt = 0.04, speed = 0.01;

/* ---- bodies ---- */

/* Shapes of a scene's region 1, and how it is mixed with region 0. */
typedef struct blend {
    sb_shape shape;
    sb_mixture_mean mean;
    int labels; /* 1: not mixed, each element is of the region that has most of it */
    sb_mixture mixture;
} blend;

static int make_mixture(const needle_scene *s, blend *b)
{
    const sb_real stiffness[2] = {s->materials[0].young, s->materials[1].young};
    sb_mixture_def def = sb_default_mixture_def();
    def.mesh = &s->mesh;
    def.shapes = &b->shape;
    def.shape_count = 1;
    def.mean = b->mean;
    def.stiffness = stiffness;
    return CHECK_OK(sb_mixture_create(&def, &b->mixture, NULL));
}

/* One region for each element, the one with most of it. */
static void take_labels(needle_scene *s, const blend *b)
{
    const sb_mixture *m = &b->mixture;
    int kept = 0;
    if (!s->mesh.regions) /* freed as the others are */
        s->mesh.regions = (int *)malloc((size_t)s->mesh.element_count * sizeof(int));
    if (!CHECK(s->mesh.regions != NULL))
        return;
    for (int k = 0; k < m->body_mesh.element_count; k++)
        if (k == 0 || m->elements[k] != m->elements[k - 1])
            s->mesh.regions[kept++] = m->body_mesh.regions[k];
}

/* The scene's block and needle, its tissue mixed. Release with free_mixed. */
static int make_mixed(needle_scene *s, blend *b)
{
    sb_region_material inner;
    int *fixed, count;
    memset(&b->mixture, 0, sizeof b->mixture);
    s->mesh = scene_box(s->type, s->cells[0], s->cells[1], s->cells[2], s->size, s->shake);
    fixed = (int *)malloc((size_t)s->mesh.node_count * sizeof(int));
    if (!CHECK(fixed != NULL) || !make_mixture(s, b)) {
        free(fixed);
        return 0;
    }
    count = needle_scene_make_mesh(s, fixed);
    if (b->labels)
        take_labels(s, b);
    inner.region = 1;
    inner.material = needle_scene_material_of(s, 1);
    s->body_def.mesh = b->labels ? &s->mesh : &b->mixture.body_mesh;
    s->body_def.domain = b->labels ? NULL : &b->mixture.domain;
    s->body_def.material = needle_scene_material_of(s, 0);
    s->body_def.region_materials = &inner;
    s->body_def.region_material_count = 1;
    if (CHECK_OK(sb_body_create(&s->body_def, &s->body, &s->error)))
        CHECK_OK(sb_body_fix_nodes(s->body, fixed, count, SB_XYZ));
    free(fixed);
    s->body_def.region_materials = NULL;
    s->body_def.domain = NULL;
    s->needle_def.frictions = s->frictions;
    s->needle_def.friction_count = 2;
    return s->body && needle_scene_add(s, sb_v3(0, 0, 0)) != NULL;
}

static void free_mixed(needle_scene *s, blend *b)
{
    needle_scene_free(s);
    sb_mixture_free(&b->mixture);
}

/* A bevelled needle, and systems solved to where only rounding is left. */
static needle_scene make_scene(sb_element_type type)
{
    needle_scene s = needle_scene_default();
    s.type = type;
    s.shake = 0;
    s.needle_def.follow = NDL_EMBED;
    s.needle_def.bevel.curvature = 10;
    s.body_def.slack = 0;
    s.body_def.tolerance = REAL(1e-9);
    s.body_def.max_iterations = 2000;
    return s;
}

/* In, half a turn, a little out. */
static void insert(needle_scene *s)
{
    needle_scene_run(s, dt, 55, needle_command(speed, 0));
    needle_scene_run(s, dt, 5, needle_command(0, 10));
    needle_scene_run(s, dt, 5, needle_command(-speed, 0));
}

/* Both needles and bodies in the same state. */
static void check_same(const needle_scene *a, const needle_scene *b, double tolerance)
{
    double off = 0, most = 0;
    int moved = 0;
    for (int i = 0; i < sb_body_node_count(a->body); i++) {
        sb_vec3 gap = sb_v3_sub(sb_body_positions(a->body)[i], sb_body_positions(b->body)[i]);
        off = fmax(off, (double)sb_v3_norm(gap));
        most = fmax(most, (double)sb_v3_norm(sb_body_displacements(a->body)[i]));
        moved += sb_v3_norm(sb_body_displacements(a->body)[i]) > 0;
    }
    printf("  nodes off by %.2g of %.2g m, tips by %.2g m, push %.6f and %.6f N\n", off, most,
           (double)sb_v3_norm(sb_v3_sub(needle_tip(a->needles[0]), needle_tip(b->needles[0]))), needle_push(a),
           needle_push(b));
    CHECK(moved > 0 && off < tolerance * most);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(needle_tip(a->needles[0]), needle_tip(b->needles[0]))), 0, tolerance * most);
    CHECK_NEAR(needle_push(a), needle_push(b), tolerance * fabs(needle_push(b)));
    CHECK(fabs(needle_push(b)) > 0.05 && ndl_needle_depth(b->needles[0]) > REAL(0.015));
}

/* ---- closed form ---- */

/* Layers across y, one in the middle of each cell, of `share` of it: every element has that share of both regions. */
typedef struct layers {
    double cell, share;
} layers;

static sb_real layer_distance(void *user, sb_vec3 x)
{
    const layers *l = (const layers *)user;
    double at = (double)x.y / l->cell;
    return REAL(l->cell * (fabs(at - floor(at) - 0.5) - 0.5 * l->share));
}

/* What both materials and frictions are together. */
static void mix_by_hand(const needle_scene *parts, double share, sb_mixture_mean mean, needle_scene *whole)
{
    const needle_scene_material *a = parts->materials, *b = parts->materials + 1;
    const ndl_friction *f = parts->frictions, *g = parts->frictions + 1;
    double shear = 0, lambda = 0, shares[2] = {1 - share, share};
    needle_scene_material *m = whole->materials;
    for (int k = 0; k < 2; k++) {
        double e = (double)parts->materials[k].young, nu = (double)parts->materials[k].poisson;
        shear += shares[k] * e / (2 * (1 + nu));
        lambda += shares[k] * e * nu / ((1 + nu) * (1 - 2 * nu));
    }
    m->poisson = REAL(lambda / (2 * (lambda + shear)));
    m->young = REAL(2 * (1 + (double)m->poisson) * shear);
    if (mean == SB_MIXTURE_REUSS)
        m->young = REAL(1 / (shares[0] / (double)a->young + share / (double)b->young));
    if (mean == SB_MIXTURE_GEOMETRIC)
        m->young = REAL(pow((double)a->young, shares[0]) * pow((double)b->young, share));
    m->density = REAL(shares[0] * (double)a->density + share * (double)b->density);
    whole->frictions[0].friction = REAL(shares[0] * (double)f->friction + share * (double)g->friction);
    whole->frictions[0].viscous = REAL(shares[0] * (double)f->viscous + share * (double)g->viscous);
    whole->frictions[0].cutting = REAL(shares[0] * (double)f->cutting + share * (double)g->cutting);
    whole->frictions[0].twist_stiffness =
        REAL(shares[0] * (double)f->twist_stiffness + share * (double)g->twist_stiffness);
    whole->frictions[0].twist_friction =
        REAL(shares[0] * (double)f->twist_friction + share * (double)g->twist_friction);
}

/* Moduli that any mean of stiffnesses is true for have one Poisson's ratio; Voigt's mixes Lame's moduli of any. */
static void set_parts(needle_scene *s, sb_mixture_mean mean)
{
    const needle_scene_material parts[2] = {{30000, REAL(0.4), 1000}, {90000, REAL(0.25), 1300}};
    const ndl_friction frictions[2] = {{20, 30, REAL(0.3), REAL(1e-3), REAL(1e-3)},
                                       {45, 80, REAL(0.9), REAL(4e-3), REAL(2e-3)}};
    memcpy(s->materials, parts, sizeof parts);
    memcpy(s->frictions, frictions, sizeof frictions);
    if (mean != SB_MIXTURE_VOIGT)
        s->materials[1].poisson = s->materials[0].poisson;
}

static void test_closed_form(void)
{
    for (int k = 0; k < (check_quick() ? 3 : 4); k++) {
        const sb_mixture_mean mean = (sb_mixture_mean)(SB_MIXTURE_VOIGT + k % 3);
        needle_scene mixed = make_scene(k < 3 ? SB_HEX8 : SB_HEX20), plain = make_scene(mixed.type);
        layers l = {0.01, 0.25 + 0.15 * k};
        blend b;
        memset(&b, 0, sizeof b);
        b.mean = mean;
        b.shape.distance = layer_distance;
        b.shape.user = &l;
        b.shape.region = 1;
        set_parts(&mixed, mean);
        mix_by_hand(&mixed, l.share, mean, &plain);
        if (mixed.type == SB_HEX20)
            for (int c = 0; c < 3; c++)
                mixed.cells[c] = plain.cells[c] = 2, l.cell = 0.02;
        if (make_mixed(&mixed, &b) && needle_scene_make(&plain)) {
            CHECK_INT(b.mixture.mixed_count, plain.mesh.element_count);
            insert(&mixed);
            insert(&plain);
            check_same(&mixed, &plain, scene_tolerance(1e-6, 3e5));
        }
        needle_scene_free(&plain);
        free_mixed(&mixed, &b);
    }
}

/* ---- one material ---- */

/* A half space whose face is nowhere along the mesh. */
static sb_real oblique_distance(void *user, sb_vec3 x)
{
    (void)user;
    return REAL(0.6) * x.x + REAL(0.48) * x.y + REAL(0.64) * x.z - REAL(0.031);
}

/* Parts that are alike are the element. */
static void test_one_material(void)
{
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX27};
    for (int k = 0; k < (check_quick() ? 1 : 3); k++) {
        needle_scene mixed = make_scene(types[k]), plain = make_scene(types[k]);
        blend b;
        memset(&b, 0, sizeof b);
        b.mean = SB_MIXTURE_VOIGT;
        b.shape.distance = oblique_distance;
        b.shape.max_slope = 1;
        b.shape.region = 1;
        for (int c = 0; c < 3 && k > 0; c++)
            mixed.cells[c] = plain.cells[c] = k == 1 ? 3 : 2;
        mixed.shake = plain.shake = 0.1;
        if (make_mixed(&mixed, &b) && needle_scene_make(&plain)) {
            CHECK(b.mixture.mixed_count > 0);
            insert(&mixed);
            insert(&plain);
            check_same(&mixed, &plain, scene_tolerance(1e-6, 3e5));
        }
        needle_scene_free(&plain);
        free_mixed(&mixed, &b);
    }
}

/* ---- a nodule that no mesh follows ---- */

typedef struct nodule {
    sb_vec3 centre;
    double radius;
} nodule;

static sb_real nodule_distance(void *user, sb_vec3 x)
{
    const nodule *n = (const nodule *)user;
    return REAL((double)sb_v3_norm(sb_v3_sub(x, n->centre)) - n->radius);
}

/* Force over way of a base that is pushed aside, a needle 25 mm deep in a block of `young` with a nodule (N/m); mean
 * 0: by labels. */
static double stiffness(sb_element_type type, int cells, nodule *n, const double young[2], int mean)
{
    needle_scene s = make_scene(type);
    const double way = 0.0005;
    double result = 0;
    ndl_command aside = needle_command(0, 0);
    blend b;
    memset(&b, 0, sizeof b);
    b.mean = mean ? (sb_mixture_mean)mean : SB_MIXTURE_VOIGT;
    b.labels = mean == 0;
    b.shape.distance = nodule_distance;
    b.shape.user = n;
    b.shape.max_slope = 1;
    b.shape.region = 1;
    s.needle_def.bevel.curvature = 0;
    s.body_def.tolerance = REAL(1e-5);
    for (int k = 0; k < 2; k++) {
        s.materials[k].young = REAL(young[k]), s.materials[k].poisson = REAL(0.45);
        s.frictions[k].friction = s.frictions[k].cutting = 0;
    }
    for (int c = 0; c < 3; c++)
        s.cells[c] = cells;
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    s.needle_def.base.z = REAL(0.052);
    s.needle_def.length = REAL(0.011);
    aside.velocity.x = REAL(way / 0.2);
    if (make_mixed(&s, &b) && needle_scene_run(&s, 0.05, 26, needle_command(0.02, 0))) {
        sb_vec3 before, after;
        ndl_needle_base_wrench(s.needles[0], &before, NULL);
        needle_scene_run(&s, 0.05, 4, aside);
        needle_scene_run(&s, 0.1, 5, needle_command(0, 0));
        ndl_needle_base_wrench(s.needles[0], &after, NULL);
        result = (double)(after.x - before.x) / way;
    }
    free_mixed(&s, &b);
    return result;
}

/* Nodules of random size and place, stiffer and softer, about as large as the elements: what they add to the stiffness
 * across, without the mesh's own error, against a finer mesh. The geometric mean does best (CHECK_SLOW, 24 nodules,
 * edges 2.8 times as fine: 24 and 8 N/m off, where labels are 57 and 18, Voigt's mean 72 and 9, Reuss's 52 and 19). */
static void test_nodule(void)
{
    enum { COARSE = 5, MEANS = 4 };
    static const char *const names[MEANS] = {"labels", "Voigt", "geometric", "Reuss"};
    const double plain[2] = {30000, 30000};
    const int rounds = getenv("CHECK_SLOW") ? 24 : 4, fine = rounds > 4 ? 14 : 10;
    unsigned long long seed = 5;
    double off[2][MEANS] = {{0}}, base[2], last = 0;
    nodule n = {{0, 0, 0}, 1};
    base[0] = stiffness(SB_TET4, COARSE, &n, plain, SB_MIXTURE_VOIGT);
    base[1] = stiffness(SB_TET4, fine, &n, plain, SB_MIXTURE_VOIGT);
    for (int k = 0; k < rounds; k++) {
        const double young[2] = {30000, k % 2 ? 6e3 : 3e5};
        double right;
        n.centre.x = REAL(0.0213 + check_random_in(&seed, -0.006, 0.006));
        n.centre.y = REAL(0.0191 + check_random_in(&seed, -0.006, 0.006));
        n.centre.z = REAL(check_random_in(&seed, 0.02, 0.033));
        n.radius = check_random_in(&seed, 0.005, 0.008);
        right = stiffness(SB_TET4, fine, &n, young, SB_MIXTURE_GEOMETRIC) - base[1];
        for (int mean = 0; mean < MEANS; mean++) {
            double found = stiffness(SB_TET4, COARSE, &n, young, mean) - base[0];
            CHECK(mean < 2 || found < last); /* Voigt, geometric, Reuss: ever softer */
            last = found;
            off[k % 2][mean] += (found - right) * (found - right) / (0.5 * rounds);
        }
    }
    for (int soft = 0; soft < 2; soft++)
        for (int mean = 0; mean < MEANS; mean++)
            printf("  %s nodule, %s: off by %.2f N/m\n", soft ? "soft" : "stiff", names[mean], sqrt(off[soft][mean]));
    for (int mean = 0; mean < MEANS; mean++)
        CHECK(mean == SB_MIXTURE_GEOMETRIC ||
              off[0][SB_MIXTURE_GEOMETRIC] + off[1][SB_MIXTURE_GEOMETRIC] < 0.4 * (off[0][mean] + off[1][mean]));
}

CHECK_SUITE(needle_mixture, {"mixtures in closed form", test_closed_form}, {"one material", test_one_material},
            {"nodule", test_nodule});
