/* Inference of organs that a pressure is known to press on somewhere: a sphere against Lame's solution, with and
 * without the hint; random organs with gas above them, by meshes and laws of their own; refusals. */
#include "check.h"
#include "organ_motion.h"
#include "scene.h"

#include "register.h"

/* ---- a sphere ---- */

/* The inference of a sphere that has shrunk by `share`, of which all is seen, with 0.3 mm of noise; 0: none. */
static int infer_sphere(reg_model *model, const sb_mesh *outline, double share, const sb_real *pressed,
                        reg_infer **infer, reg_quality *quality)
{
    reg_infer_def def = reg_default_infer_def();
    sb_vec3 *seen = (sb_vec3 *)calloc((size_t)outline->node_count, sizeof *seen);
    unsigned long long seed = 11;
    int good;
    for (int i = 0; i < outline->node_count; i++) {
        double size = 1 - share + 3e-4 * organ_gauss(&seed) / (double)sb_v3_norm(outline->nodes[i]);
        seen[i] = sb_v3_scale(REAL(size), outline->nodes[i]);
    }
    def.model = model;
    def.target.points = seen;
    def.target.count = outline->node_count;
    def.start_sd = REAL(1e-3);
    def.start_turn = REAL(1e-2);
    def.pressed = pressed;
    good = CHECK_OK(reg_infer_run(&def, infer, NULL)) && CHECK_OK(reg_infer_get_quality(*infer, quality));
    free(seen);
    return good;
}

/* Mean distance (m) of a sphere's nodes from where it says they are, u = -share x. */
static double off_lame(const sb_mesh *mesh, const reg_infer *infer, double share)
{
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh->node_count, sizeof *u);
    double sum = 0;
    CHECK_OK(reg_infer_displacements(infer, u));
    for (int i = 0; i < mesh->node_count; i++)
        sum += (double)sb_v3_norm(sb_v3_madd(u[i], REAL(share), mesh->nodes[i])) / mesh->node_count;
    free(u);
    return sum;
}

/* The pressure (Pa) under which a neo-Hookean sphere, W = mu/2 (I1 - 3) - mu ln J + lambda/2 ln^2 J, is so much
 * smaller: Lame's share E / (1 - 2 nu) where that is little. */
static double pressure_of(double share, double young, double poisson)
{
    double mu = young / (2 + 2 * poisson), lambda = 2 * mu * poisson / (1 - 2 * poisson), s = 1 - share;
    return (mu * (1 - s * s) - 3 * lambda * log(s)) / (s * s * s);
}

/* Lame's u = -p r (1 - 2 nu) / E. With the hint the pressure is found, evidence prefers it by more than 3 nats to
 * loads that nobody knows, and the motion within is nearer. */
static void test_sphere(void)
{
    const double radius = 0.1, share = 0.05, poisson = 0.4, pressure = pressure_of(share, 1000, poisson);
    unsigned long long seed = 3;
    organ ball = organ_make(&seed, 0, 1, 0);
    reg_model_def def = reg_default_model_def();
    const sb_mat3 upright = sb_m3_identity();
    sb_mesh outline, mesh;
    reg_model *model = NULL;
    reg_infer *infers[2] = {NULL, NULL};
    reg_quality qualities[2];
    sb_real *pressed;
    for (int i = 0; i < 3; i++)
        ball.axes[i] = radius;
    if (!organ_surface(&ball, 9, &upright, 0, &outline) || !motion_fill(&outline, 0.22 * radius, SB_TET4, &mesh))
        return;
    pressed = (sb_real *)malloc((size_t)mesh.node_count * sizeof *pressed);
    for (int i = 0; i < mesh.node_count; i++)
        pressed[i] = 1;
    def.mesh = &mesh;
    def.surface = &outline;
    def.poisson = REAL(poisson);
    if (CHECK_OK(reg_model_create(&def, &model, NULL)) &&
        infer_sphere(model, &outline, share, NULL, infers, qualities) &&
        infer_sphere(model, &outline, share, pressed, infers + 1, qualities + 1)) {
        CHECK(qualities[0].prior != REG_PRIOR_PRESSURE && qualities[0].pressure == 0);
        CHECK_INT(qualities[1].prior, REG_PRIOR_PRESSURE);
        CHECK(qualities[1].pressure_margin > 3);
        CHECK_NEAR((double)qualities[1].pressure / pressure, 1, 0.03);
        CHECK(off_lame(&mesh, infers[1], share) < 0.04 * share * radius);
        CHECK(off_lame(&mesh, infers[1], share) < off_lame(&mesh, infers[0], share));
        printf("   evidence %.1f nats, pressure %.4f of Lame's, off by %.4f and %.4f of the motion\n",
               (double)qualities[1].pressure_margin, (double)qualities[1].pressure / pressure,
               off_lame(&mesh, infers[0], share) / (share * radius),
               off_lame(&mesh, infers[1], share) / (share * radius));
    }
    reg_infer_destroy(infers[0]);
    reg_infer_destroy(infers[1]);
    reg_model_destroy(model);
    free(pressed);
    sb_mesh_free(&mesh);
    sb_mesh_free(&outline);
}

/* Shares of a pressure are 0 to 1: the node that has another is named, and nothing is made. */
static void test_refusals(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0);
    reg_model_def def = reg_default_model_def();
    reg_infer_def infer = reg_default_infer_def();
    reg_infer *made = NULL;
    sb_real *pressed = (sb_real *)calloc((size_t)mesh.node_count, sizeof *pressed);
    const sb_real wrong[3] = {REAL(-0.1), REAL(1.5), REAL(NAN)};
    sb_error error;
    def.mesh = &mesh;
    infer.target.points = mesh.nodes;
    infer.target.count = mesh.node_count;
    infer.pressed = pressed;
    if (CHECK_OK(reg_model_create(&def, &infer.model, NULL)))
        for (int k = 0; k < 3; k++) {
            pressed[5] = wrong[k];
            CHECK_RESULT(reg_infer_run(&infer, &made, &error), SB_ERROR_ARGUMENT);
            CHECK(error.node == 5 && !made);
        }
    reg_model_destroy(infer.model);
    free(pressed);
    sb_mesh_free(&mesh);
}

/* ---- organs under gas ---- */

/* A random organ that lies on its lowest part while gas presses on what faces up. */
typedef struct gassed {
    double size;                   /* m */
    sb_mesh outline, coarse, fine; /* the model's, and of what is really pressed */
    sb_mesh seen;                  /* its surface after, of triangles of its own */
    sb_vec3 *truth;                /* [fine nodes] displacements (m) */
    sb_real *pressed;              /* [coarse nodes] */
    reg_model *model;
} gassed;

static int is_above(const gassed *g, sb_vec3 x) { return (double)x.z > 0.02 * g->size; }

/* The fine organ under gas: a stable neo-Hookean body of tet10. */
static int press(gassed *g, double pressure)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_boundary skin;
    sb_body *body;
    int *faces, count = 0, load, good;
    def.mesh = &g->fine;
    def.material = sb_material_stable_neo_hookean(1000, REAL(0.46), 1000);
    body = scene_body(&def);
    if (!body || !CHECK_OK(sb_mesh_boundary(&g->fine, 1, NULL, &skin, NULL)))
        return 0;
    faces = (int *)calloc((size_t)skin.surface.element_count, 3 * sizeof *faces);
    for (int f = 0; f < skin.surface.element_count; f++) {
        const int *of = skin.surface.elements + 6 * (size_t)f;
        int above = 1;
        for (int k = 0; k < 3; k++)
            above &= is_above(g, skin.surface.nodes[of[k]]);
        for (int k = 0; k < 3 && above; k++)
            faces[3 * count + k] = skin.nodes[of[k]];
        count += above;
    }
    for (int i = 0; i < g->fine.node_count; i++)
        if ((double)g->fine.nodes[i].z < -0.12 * g->size)
            CHECK_OK(sb_body_hold(body, &i, 1, SB_XYZ, NULL));
    options.load_steps = 3;
    good = CHECK_OK(sb_body_add_pressure(body, faces, count, 3, REAL(pressure), &load, NULL)) &&
           CHECK_OK(sb_body_solve_static(body, &options, NULL));
    g->truth = (sb_vec3 *)calloc((size_t)g->fine.node_count, sizeof *g->truth);
    memcpy(g->truth, sb_body_displacements(body), (size_t)g->fine.node_count * sizeof *g->truth);
    free(faces);
    sb_boundary_free(&skin);
    sb_body_destroy(body);
    return good;
}

/* Moves the surface that is seen along. */
static int move_seen(gassed *g)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_vec3 *there = (sb_vec3 *)calloc((size_t)g->fine.node_count, sizeof *there);
    int good;
    for (int i = 0; i < g->fine.node_count; i++)
        there[i] = sb_v3_add(g->fine.nodes[i], g->truth[i]);
    def.mesh = &g->fine;
    def.points = g->seen.nodes;
    def.point_count = g->seen.node_count;
    def.kind = SB_EMBED_PLAIN;
    def.max_distance = REAL(0.25 * g->size);
    good = CHECK_OK(sb_embedding_create(&def, &embedding, NULL)) &&
           CHECK_OK(sb_embedding_update(embedding, there, g->seen.nodes, NULL, NULL));
    sb_embedding_destroy(embedding);
    free(there);
    return good;
}

static int gassed_make(gassed *g, unsigned long long seed, double pressure)
{
    organ shape = organ_make(&seed, 0.12, 1, 0);
    reg_model_def def = reg_default_model_def();
    const sb_mat3 upright = sb_m3_identity();
    sb_mat3 turned = sb_quat_to_mat3(sb_quat_normalise(sb_quat_make(1, REAL(0.3), REAL(-0.2), REAL(0.5))));
    sb_vec3 low, high;
    memset(g, 0, sizeof *g);
    if (!organ_surface(&shape, 9, &upright, 0, &g->outline) || !organ_surface(&shape, 12, &turned, 0, &g->seen))
        return 0;
    sb_mesh_bounds(&g->outline, &low, &high);
    g->size = (double)sb_v3_norm(sb_v3_sub(high, low));
    if (!motion_fill(&g->outline, 0.08 * g->size, SB_TET10, &g->fine) ||
        !motion_fill(&g->outline, 0.065 * g->size, SB_TET4, &g->coarse) || !press(g, pressure) || !move_seen(g))
        return 0;
    g->pressed = (sb_real *)calloc((size_t)g->coarse.node_count, sizeof *g->pressed);
    for (int i = 0; i < g->coarse.node_count; i++)
        g->pressed[i] = (sb_real)is_above(g, g->coarse.nodes[i]);
    def.mesh = &g->coarse;
    def.surface = &g->outline;
    return CHECK_OK(reg_model_create(&def, &g->model, NULL));
}

static void gassed_free(gassed *g)
{
    reg_model_destroy(g->model);
    sb_mesh_free(&g->outline);
    sb_mesh_free(&g->coarse);
    sb_mesh_free(&g->fine);
    sb_mesh_free(&g->seen);
    free(g->truth);
    free(g->pressed);
}

/* Mean error (m) over the fine nodes of what is inferred from what is seen from above. */
static double gassed_error(const gassed *g, const sb_real *pressed, reg_quality *quality)
{
    reg_infer_def def = reg_default_infer_def();
    reg_infer *infer = NULL;
    sb_mesh part;
    sb_vec3 *moved = (sb_vec3 *)calloc((size_t)g->fine.node_count, sizeof *moved);
    double sum = 0;
    CHECK_OK(sb_mesh_copy(&g->seen, NULL, &part, NULL));
    organ_view_cut(&part, sb_v3(0, 0, 1), sb_v3(0, 0, REAL(0.05)), 0.35);
    def.model = g->model;
    def.target.surface = &part;
    def.samples = 150;
    def.pressed = pressed;
    if (CHECK_OK(reg_infer_run(&def, &infer, NULL)) && CHECK_OK(reg_infer_get_quality(infer, quality)) &&
        CHECK_OK(reg_infer_covariance(infer, g->fine.nodes, g->fine.node_count, moved, NULL, NULL)))
        for (int i = 0; i < g->fine.node_count; i++)
            sum += (double)sb_v3_norm(sb_v3_sub(moved[i], sb_v3_add(g->fine.nodes[i], g->truth[i])));
    reg_infer_destroy(infer);
    sb_mesh_free(&part);
    free(moved);
    return sum / g->fine.node_count;
}

/* Half of the skin, which nothing presses on alike. */
static void press_elsewhere(gassed *g)
{
    for (int i = 0; i < g->coarse.node_count; i++)
        g->pressed[i] = g->coarse.nodes[i].x > 0 ? 1 : 0;
}

/* The camera is above, and sees a third of the organ. With the hint errors are smaller on the mean, and no organ's is
 * larger by more than a tenth. A wrong hint does no harm, and is not taken for what acts. */
static void test_gas(void)
{
    double sums[2] = {0, 0};
    int organs = check_quick() ? 1 : check_rounds(4);
    for (int k = 0; k < organs; k++) {
        gassed g;
        if (gassed_make(&g, 60 + 7 * (unsigned long long)k, 80 + 30.0 * k)) {
            reg_quality without, with;
            double plain = gassed_error(&g, NULL, &without), hinted = gassed_error(&g, g.pressed, &with);
            printf("   %.2f mm without the hint, %.2f with it; %s, %s; %.0f of %.0f Pa\n", 1e3 * plain, 1e3 * hinted,
                   reg_prior_string(without.prior), reg_prior_string(with.prior), (double)with.pressure, 80 + 30.0 * k);
            CHECK(hinted < 1.1 * plain);
            if (k < 2) {
                press_elsewhere(&g);
                CHECK(gassed_error(&g, g.pressed, &with) < 1.1 * plain && with.prior != REG_PRIOR_PRESSURE);
            }
            sums[0] += plain;
            sums[1] += hinted;
        }
        gassed_free(&g);
    }
    CHECK(sums[1] < sums[0]);
}

CHECK_SUITE(infer_pressure, {"a sphere", test_sphere}, {"refusals", test_refusals}, {"organs under gas", test_gas});
