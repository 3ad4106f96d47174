/* Tests of the Gaussian model behind an inference, and of its prior of loads: a bar whose posterior is known, balance,
 * facets of six nodes, data drawn from the prior, draws of the posterior. They are internal. */
#define SB_SPLIT_BUILD
#include "../src/register/gauss.h"
#include "../src/register/prior.h"
#include "../src/softbody/body/body_guest.h"

#include "check.h"
#include "scene.h"

static double normal(unsigned long long *seed)
{
    double u = 1 - check_random_in(seed, 0, 1), v = check_random_in(seed, 0, 1);
    return sqrt(-2 * log(u)) * cos(6.283185307179586 * v);
}

/* ---- a bar ---- */

/* Motion (m per Pa) of the end of a bar of no Poisson's ratio under a traction there, by its factored stiffness. */
static double bar_compliance(double length, double young)
{
    sb_mesh mesh = scene_box(SB_TET4, 6, 2, 2, sb_v3(REAL(length), REAL(0.2 * length), REAL(0.2 * length)), 0);
    sb_body_def def = sb_default_body_def();
    sb_direct *direct = NULL;
    sb_boundary boundary;
    double moved = 0, area = 0;
    sb_body *body;
    sb_vec3 *x = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *x);
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(young), 0, 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL));
    CHECK_OK(sbi_body_make_factor(body, NULL, &direct, NULL));
    CHECK_OK(sbi_body_factor(body, 0, x, direct, NULL));
    memset(x, 0, (size_t)mesh.node_count * sizeof *x);
    for (int pass = 0; pass < 2; pass++) { /* forces, then the mean motion by the same weights */
        for (int f = 0; f < boundary.surface.element_count; f++) {
            const int *c = boundary.surface.elements + 3 * f;
            sb_vec3 a = mesh.nodes[c[0]], b = mesh.nodes[c[1]], d = mesh.nodes[c[2]];
            double third = (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a))) / 6;
            if (sb_min(a.x, sb_min(b.x, d.x)) < REAL(0.999 * length))
                continue;
            for (int k = 0; k < 3 && pass == 0; k++, area += third)
                x[c[k]].x += REAL(third);
            for (int k = 0; k < 3 && pass == 1; k++)
                moved += third * (double)x[c[k]].x / area;
        }
        if (pass == 0)
            CHECK_OK(sb_direct_solve(direct, &x[0].x, &x[0].x, 1));
    }
    sb_direct_free(direct);
    sb_boundary_free(&boundary);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(x);
    return moved;
}

/* One end held, a traction at the other, which is seen: t = t_obs c^2 s^2 / (c^2 s^2 + sigma^2), variance
 * sigma^2 s^2 / (c^2 s^2 + sigma^2) with c = L/E. */
static void test_bar(void)
{
    const double young = 5000, length = 0.2, sigma = 1e-4, observed = 80, s = 100;
    double c = bar_compliance(length, young), found, square, seen[1];
    regi_gauss g;
    double e = c * c * s * s, y[1] = {0}, p[1];
    CHECK_NEAR(c * young / length, 1, sizeof(sb_real) == 8 ? 1e-10 : 1e-4);
    if (!CHECK_OK(regi_gauss_create(1, 1, NULL, &g, NULL)))
        return;
    g.count = g.loads = 1;
    g.columns[0] = c;
    g.gap[0] = c * observed;
    g.variance[0] = sigma * sigma;
    g.scale = s;
    regi_gauss_multiply(&g);
    CHECK(regi_gauss_solve(&g));
    regi_gauss_explain(&g, g.multiplier, y, p);
    CHECK_NEAR(y[0] / (observed * e / (e + sigma * sigma)), 1, 1e-10);
    seen[0] = s * s * c;
    regi_gauss_whiten(&g, seen);
    found = s * s - seen[0] * seen[0];
    square = sigma * sigma * s * s / (e + sigma * sigma);
    CHECK_NEAR(found / square, 1, 1e-10);
    regi_gauss_reduce(&g); /* the evidence of one datum is its normal density */
    CHECK(regi_gauss_spectrum(&g));
    for (int k = 0; k < 3; k++) {
        double scale = k * s, all = c * c * scale * scale + sigma * sigma;
        CHECK_NEAR(regi_gauss_evidence(&g, scale), -0.5 * (g.gap[0] * g.gap[0] / all + log(all)),
                   1e-9 * fabs(log(all)) + 1e-9 * g.gap[0] * g.gap[0] / all);
    }
    regi_gauss_free(&g);
}

/* ---- random models ---- */

/* Data of random loads with resultants and a pose. */
static void fill(regi_gauss *g, unsigned long long seed, int count, int loads, int exact, int poses)
{
    g->count = count;
    g->loads = loads;
    g->exact = exact;
    g->poses = poses;
    for (int b = 0; b < loads; b++) {
        for (int i = 0; i < count; i++)
            g->columns[(size_t)b * (size_t)g->most + (size_t)i] = normal(&seed);
        for (int e = 0; e < exact; e++)
            g->resultants[(size_t)e * (size_t)g->most_loads + (size_t)b] = normal(&seed);
    }
    for (int k = 0; k < poses; k++)
        for (int i = 0; i < count; i++)
            g->pose[(size_t)k * (size_t)g->most + (size_t)i] = normal(&seed);
    for (int i = 0; i < count; i++) {
        g->gap[i] = normal(&seed);
        g->variance[i] = check_random_in(&seed, 0.01, 0.1);
    }
    g->scale = 0.7;
}

/* Loads have no resultants, data of no variance are met, and the evidence of the spectrum is that of the factor. */
static void test_balance(void)
{
    enum { DATA = 23, LOADS = 60 };
    for (int trial = 0; trial < 6; trial++) {
        double before[REGI_GAUSS_EXACT][LOADS], c[LOADS], p[REGI_GAUSS_POSES], out[DATA], most = 0, log_det = 0,
                                                                                          misfit = 0;
        int exact = trial % 2 ? 6 : 0, count = DATA - trial;
        regi_gauss g;
        if (!CHECK_OK(regi_gauss_create(DATA, LOADS, NULL, &g, NULL)))
            return;
        fill(&g, 5 + (unsigned long long)trial, count, LOADS, exact, 6);
        for (int e = 0; e < exact; e++) {
            if (e == 5) /* a resultant that the others have: no further condition */
                for (int b = 0; b < LOADS; b++)
                    g.resultants[e * LOADS + b] = g.resultants[b] - 2 * g.resultants[LOADS + b];
            memcpy(before[e], g.resultants + e * LOADS, sizeof before[e]);
        }
        regi_gauss_bind(&g);
        regi_gauss_multiply(&g);
        CHECK(regi_gauss_solve(&g));
        for (int i = 0; i < count; i++) {
            log_det += 2 * log(g.system[(size_t)i * (size_t)g.most + (size_t)i]);
            misfit += g.gap[i] * g.multiplier[i];
        }
        regi_gauss_reduce(&g);
        CHECK_INT(g.rank, count);
        CHECK(regi_gauss_spectrum(&g));
        CHECK_NEAR(regi_gauss_evidence(&g, g.scale), -0.5 * (misfit + log_det), 1e-9 * (misfit + fabs(log_det)));
        g.variance[1] = g.variance[7] = 0;
        CHECK(regi_gauss_solve(&g));
        regi_gauss_explain(&g, g.multiplier, c, p);
        regi_gauss_predict(&g, c, p, out);
        CHECK_NEAR(out[1], g.gap[1], 1e-9);
        CHECK_NEAR(out[7], g.gap[7], 1e-9);
        for (int e = 0; e < exact; e++) {
            double sum = 0, size = 0;
            for (int b = 0; b < LOADS; b++) {
                sum += before[e][b] * c[b];
                size += fabs(before[e][b] * c[b]);
            }
            most = fmax(most, fabs(sum) / size);
        }
        CHECK(most < 1e-10);
        regi_gauss_free(&g);
    }
}

/* Draws have the posterior's covariance: 400 of them within 15 %. */
static void test_draws(void)
{
    enum { DATA = 20, LOADS = 40, DRAWS = 400 };
    regi_gauss g;
    double *squares;
    unsigned long long seed = 77;
    if (!CHECK_OK(regi_gauss_create(DATA, LOADS, NULL, &g, NULL)))
        return;
    squares = (double *)calloc(LOADS, sizeof *squares);
    fill(&g, 3, DATA, LOADS, 3, 2);
    regi_gauss_bind(&g);
    regi_gauss_multiply(&g);
    CHECK(regi_gauss_solve(&g));
    for (int draw = 0; draw < DRAWS; draw++) {
        double c[LOADS], p[REGI_GAUSS_POSES] = {0}, e[DATA];
        for (int b = 0; b < LOADS; b++)
            c[b] = g.scale * normal(&seed);
        regi_gauss_balance(&g, c);
        p[0] = normal(&seed);
        p[1] = normal(&seed);
        for (int i = 0; i < DATA; i++)
            e[i] = sqrt(g.variance[i]) * normal(&seed);
        regi_gauss_condition(&g, c, p, e);
        for (int b = 0; b < LOADS; b++)
            squares[b] += c[b] * c[b] / (double)DRAWS;
    }
    for (int b = 0; b < LOADS; b++) {
        double exact = g.scale * g.scale, seen[DATA];
        for (int e = 0; e < g.exact; e++)
            exact -= g.scale * g.scale * g.resultants[e * LOADS + b] * g.resultants[e * LOADS + b];
        for (int i = 0; i < DATA; i++)
            seen[i] = g.scale * g.scale * g.columns[(size_t)b * (size_t)g.most + (size_t)i];
        regi_gauss_whiten(&g, seen);
        for (int i = 0; i < DATA; i++)
            exact -= seen[i] * seen[i];
        CHECK(fabs(sqrt(squares[b] / exact) - 1) < 0.15);
    }
    free(squares);
    regi_gauss_free(&g);
}

/* ---- loads ---- */

/* Constant tractions of a box make forces whose sum is theirs; where sides are of six nodes corners bear none, and a
 * weight is what a volume has. */
static void test_facets(void)
{
    const sb_element_type types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    for (int t = 0; t < 5; t++) {
        sb_mesh mesh = scene_box(types[t], 3, 2, 2, sb_v3(REAL(0.3), REAL(0.2), REAL(0.1)), 0);
        sb_boundary boundary;
        regi_prior prior;
        sb_vec3 sum = sb_v3(0, 0, 0), weight = sb_v3(1, 2, 3), traction = sb_v3(3, -2, 5);
        double corners = 0, size = (double)sb_v3_norm(traction), tolerance = sizeof(sb_real) == 8 ? 1e-13 : 1e-5;
        CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL));
        if (CHECK_OK(regi_prior_create(&mesh, &boundary, NULL, &prior, NULL))) {
            sb_vec3 *tractions = (sb_vec3 *)calloc((size_t)prior.control_count, sizeof *tractions);
            sb_vec3 *forces = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *forces), *out;
            out = (sb_vec3 *)calloc((size_t)prior.control_count, sizeof *out);
            for (int j = 0; j < prior.control_count; j++)
                tractions[j] = traction;
            regi_prior_forces(&prior, tractions, sb_v3(0, 0, 0), forces);
            for (int i = 0; i < mesh.node_count; i++) {
                sum = sb_v3_add(sum, forces[i]);
                corners = fmax(corners, i < boundary.surface.node_count ? 0 : (double)sb_v3_norm(forces[i]));
            }
            CHECK_NEAR(prior.area, 0.22, 0.22 * tolerance);
            CHECK(sb_v3_norm(sb_v3_sub(sum, sb_v3_scale(REAL(0.22), traction))) < REAL(size * 0.22 * tolerance));
            for (int e = 0, width = sb_mesh_element_width(&mesh); e < mesh.element_count && types[t] == SB_TET10; e++)
                for (int k = 0; k < 4; k++)
                    CHECK(sb_v3_norm(forces[mesh.elements[e * width + k]]) < REAL(1e-2 * tolerance * size));
            /* what a traction does along a row is what the row does along its forces */
            regi_prior_collect(&prior, mesh.nodes, out, &weight);
            size = (double)out[1].x;
            memset(tractions, 0, (size_t)prior.control_count * sizeof *tractions);
            tractions[1].x = 1;
            regi_prior_forces(&prior, tractions, sb_v3(0, 0, 0), forces);
            for (int i = 0; i < mesh.node_count; i++)
                size -= (double)(forces[i].x * mesh.nodes[i].x);
            CHECK_NEAR(size, 0, 0.01 * tolerance);
            CHECK_NEAR(weight.x, 0.15, tolerance); /* the box's middle */
            CHECK_NEAR(weight.z, 0.05, tolerance);
            free(out);
            free(forces);
            free(tractions);
            regi_prior_free(&prior);
        }
        sb_boundary_free(&boundary);
        sb_mesh_free(&mesh);
    }
}

/* Tractions of a length, seen through a mean over their neighbourhood: the posterior's deviations are those of the
 * errors, 95 of 100 lie within, and the evidence finds the length. */
static void test_drawn(void)
{
    static const double lengths[3] = {0.25, 0.12, 0.06};
    enum { DRAWS = 60, SEEN = 70 };
    sb_mesh mesh = scene_box(SB_TET4, 8, 6, 3, sb_v3(REAL(0.24), REAL(0.18), REAL(0.09)), 0.1);
    sb_boundary boundary;
    regi_prior prior;
    regi_gauss g;
    unsigned long long seed = 11;
    double inside = 0, all = 0, errors = 0, predicted = 0;
    int right = 0, draws = check_quick() ? DRAWS / 3 : DRAWS;
    CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL));
    if (CHECK_OK(regi_prior_create(&mesh, &boundary, NULL, &prior, NULL)) &&
        CHECK_OK(regi_gauss_create(SEEN, prior.control_count, NULL, &g, NULL))) {
        int c = prior.control_count;
        size_t n = (size_t)c;
        double *root = (double *)calloc(n * n, sizeof *root), *tau = (double *)calloc(n, sizeof *tau);
        double *raw = (double *)calloc(n * SEEN, sizeof *raw), *z = (double *)calloc(n, sizeof *z);
        for (int i = 0; i < SEEN; i++) /* half of the surface is not seen */
            for (int j = 0; j < c; j++) {
                double r = (double)sb_v3_norm(sb_v3_sub(prior.places[i], prior.places[j])) / (0.04 * prior.size);
                raw[(size_t)j * SEEN + (size_t)i] = exp(-0.5 * r * r);
            }
        g.count = SEEN;
        g.loads = c;
        for (int draw = 0; draw < draws; draw++) {
            int truth = draw % 3, best = 0;
            double most = 0, scale = 3;
            CHECK(regi_prior_root(&prior, lengths[truth], NULL, root));
            memset(tau, 0, n * sizeof *tau);
            for (int k = 0; k < c; k++) {
                double drawn = scale * normal(&seed);
                for (int j = k; j < c; j++)
                    tau[j] += root[(size_t)j * n + (size_t)k] * drawn;
            }
            for (int i = 0; i < SEEN; i++) {
                g.variance[i] = 0.01;
                g.gap[i] = 0.1 * normal(&seed);
                for (int j = 0; j < c; j++)
                    g.gap[i] += raw[(size_t)j * SEEN + (size_t)i] * tau[j];
            }
            for (int pass = 0; pass < 4; pass++) { /* the three lengths, then the true one */
                double evidence;
                CHECK(regi_prior_root(&prior, lengths[pass < 3 ? pass : truth], NULL, root));
                for (int k = 0; k < c; k++)
                    for (int i = 0; i < SEEN; i++) {
                        double sum = 0;
                        for (int j = k; j < c; j++)
                            sum += root[(size_t)j * n + (size_t)k] * raw[(size_t)j * SEEN + (size_t)i];
                        g.columns[(size_t)k * (size_t)g.most + (size_t)i] = sum;
                    }
                regi_gauss_multiply(&g);
                regi_gauss_reduce(&g);
                CHECK(regi_gauss_spectrum(&g));
                (void)regi_gauss_best_scale(&g, &evidence);
                if (pass == 0 || (pass < 3 && evidence > most)) {
                    best = pass;
                    most = evidence;
                }
            }
            right += best == truth;
            g.scale = scale;
            CHECK(regi_gauss_solve(&g));
            regi_gauss_explain(&g, g.multiplier, z, NULL);
            for (int j = 0; j < c; j += 7) { /* tractions, seen and not */
                double mean = 0, square = 0, seen[SEEN];
                memset(seen, 0, sizeof seen);
                for (int k = 0; k <= j; k++) {
                    double w = root[(size_t)j * n + (size_t)k];
                    mean += w * z[k];
                    square += w * w * g.scale * g.scale;
                    for (int i = 0; i < SEEN; i++)
                        seen[i] += g.scale * g.scale * w * g.columns[(size_t)k * (size_t)g.most + (size_t)i];
                }
                regi_gauss_whiten(&g, seen);
                for (int i = 0; i < SEEN; i++)
                    square -= seen[i] * seen[i];
                inside += fabs(mean - tau[j]) < 1.96 * sqrt(square);
                errors += (mean - tau[j]) * (mean - tau[j]);
                predicted += square;
                all++;
            }
        }
        CHECK(right > 0.75 * draws);
        CHECK(inside / all > 0.93 && inside / all < 0.97);
        CHECK(sqrt(errors / predicted) > 0.95 && sqrt(errors / predicted) < 1.05);
        free(z);
        free(raw);
        free(tau);
        free(root);
        regi_gauss_free(&g);
    }
    regi_prior_free(&prior);
    sb_boundary_free(&boundary);
    sb_mesh_free(&mesh);
}

/* Vectors of any width: odd sums of products and substitutions to the same bits. */
static void test_widths(void)
{
    enum { SIZE = 61, STRIDE = 64 };
    double a[2][SIZE * STRIDE], x[2][SIZE * REGI_BLOCK_WIDTH], rows[5 * STRIDE];
    for (int wide = 0; wide < 2; wide++) {
        unsigned long long seed = 9;
        for (int k = 0; k < SIZE * STRIDE; k++)
            a[wide][k] = check_random_in(&seed, -0.5, 0.5);
        for (int k = 0; k < SIZE * REGI_BLOCK_WIDTH; k++)
            x[wide][k] = check_random_in(&seed, -0.5, 0.5);
        for (int k = 0; k < SIZE; k++)
            a[wide][k * STRIDE + k] += 2 * SIZE;
        for (int k = 0; k < 5 * STRIDE; k++)
            rows[k] = check_random_in(&seed, -0.5, 0.5);
        regi_gauss_add_squares(wide && sbi_lanes_are_wide(), a[wide], SIZE - 3, rows, 5, STRIDE);
        CHECK(regi_gauss_cholesky(wide && sbi_lanes_are_wide(), a[wide], SIZE, STRIDE));
        regi_block_forward(wide && sbi_lanes_are_wide(), a[wide], SIZE, STRIDE, x[wide]);
        regi_block_backward(wide && sbi_lanes_are_wide(), a[wide], SIZE, STRIDE, x[wide]);
    }
    CHECK(memcmp(a[0], a[1], sizeof a[0]) == 0 && memcmp(x[0], x[1], sizeof x[0]) == 0);
}

CHECK_SUITE(gauss, {"a bar", test_bar}, {"balance and exact data", test_balance}, {"draws", test_draws},
            {"facets", test_facets}, {"data drawn from the prior", test_drawn}, {"vectors of any width", test_widths});
