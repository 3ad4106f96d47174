/* bench_cut: a blade of 15 segments goes half through a beam of 13,440 tet4 in 45 frames, which is clamped at both
 * ends. For lattices of 1, 2 and 4 intervals: median and largest milliseconds of processor time of a move of the blade
 * that parts cells and of one that does not, of the surface after each, of the steps and of whole frames; iterations
 * before and at the end, of the same motions: at rest, and while gravity turns it aside. Asserts nothing. */
#define SB_STATIC
#define SB_IMPLEMENTATION
#include "../../softbody.h"

#include "measure.h"

#include <stdio.h>
#include <string.h>

enum { FRAMES = 45, SEGMENTS = 15 };
static const double length = 0.2, width = 0.03, height = 0.06; /* m */

typedef struct times {
    double values[FRAMES];
    int count;
} times;

static void times_add(times *t, clock_t ticks) { t->values[t->count++] = 1e3 * (double)ticks / CLOCKS_PER_SEC; }

static void times_print(const char *name, times *t)
{
    double middle = t->count ? median(t->values, t->count) : 0;
    printf("  %s %.2f / %.2f (%d)", name, middle, t->count ? t->values[t->count - 1] : 0, t->count);
}

static void fail(const char *what, const sb_error *error)
{
    printf("%s: %s\n", what, error->message);
    exit(1);
}

static sb_body *beam_make(const sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    def.mesh = mesh;
    def.material = sb_material_corotated(300000, (sb_real)0.45, 1000);
    def.slack = (sb_real)0.5;
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.jobs = jobs_asked_for();
    if (sb_body_create(&def, &body, &error) != SB_OK)
        fail("body", &error);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x < (sb_real)1e-9 || mesh->nodes[i].x > (sb_real)(length - 1e-6))
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    return body;
}

/* The blade's edge, across the beam, at a depth below its top. */
static void blade_at(double depth, sb_vec3 edge[SEGMENTS + 1])
{
    for (int k = 0; k <= SEGMENTS; k++) {
        double y = -0.1 * width + 1.2 * width * k / (double)SEGMENTS;
        edge[k] = sb_v3((sb_real)(0.503 * length + 0.002 * y / width), (sb_real)y, (sb_real)(height - depth));
    }
}

/* Mean iterations of some steps. */
static double steps_run(sb_body *body, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++) {
        sb_step_info info;
        if (sb_body_step(body, (sb_real)0.01, &info) != SB_OK)
            exit(1);
        sum += info.pcg_iterations;
    }
    return sum / count;
}

/* Mean iterations of steps at rest, and of those after gravity has turned aside. */
typedef struct effort {
    double resting, moving;
} effort;

static effort effort_of(sb_body *body)
{
    effort e;
    steps_run(body, 300);
    e.resting = steps_run(body, 20);
    sb_body_set_gravity(body, sb_v3(0, (sb_real)9.81, 0));
    e.moving = steps_run(body, 20);
    sb_body_set_gravity(body, sb_v3(0, 0, (sb_real)-9.81));
    return e;
}

static void run(const sb_mesh *mesh, int lattice)
{
    static times cut, uncut, drawn, moved, steps, frames;
    sb_cut_def def = sb_default_cut_def();
    sb_cut_surface *surface = NULL;
    sb_cut *knife = NULL;
    sb_cut_drawing drawing;
    sb_vec3 edge[SEGMENTS + 1];
    sb_body *body = beam_make(mesh);
    sb_error error;
    int stroke, lips = 0;
    effort before = effort_of(body), after;
    cut.count = uncut.count = drawn.count = moved.count = steps.count = frames.count = 0;
    def.body = body;
    def.lattice = lattice;
    if (sb_cut_create(&def, &knife, &error) != SB_OK)
        fail("cut", &error);
    if (sb_cut_surface_create(knife, NULL, &surface, &error) != SB_OK)
        fail("surface", &error);
    blade_at(-0.002, edge);
    if (sb_cut_begin(knife, edge, SEGMENTS + 1, &stroke, &error) != SB_OK)
        fail("stroke", &error);
    for (int frame = 1; frame <= FRAMES; frame++) {
        sb_cut_info info;
        clock_t start = clock(), middle, end, done;
        blade_at(0.5 * height * frame / (double)FRAMES, edge);
        if (sb_cut_move(knife, stroke, edge, &info, &error) != SB_OK)
            fail("move", &error);
        middle = clock();
        if (sb_cut_surface_update(surface, &error) != SB_OK)
            fail("surface", &error);
        end = clock();
        times_add(info.cells > 0 ? &cut : &uncut, middle - start);
        times_add(info.cells > 0 ? &drawn : &moved, end - middle);
        steps_run(body, 1);
        done = clock();
        times_add(&steps, done - end);
        times_add(&frames, done - start);
    }
    after = effort_of(body);
    drawing = sb_cut_surface_get(surface);
    for (int f = 0; f < drawing.triangle_count; f++)
        lips += drawing.tags[f] == SB_CUT_LIP;
    printf("lattice %d, median / largest ms (frames):", lattice);
    times_print("move that parts", &cut);
    times_print("that does not", &uncut);
    times_print("surface made", &drawn);
    times_print("moved", &moved);
    times_print("step", &steps);
    times_print("frame", &frames);
    printf("; %d triangles, %d of lips; iterations at rest %.1f before, %.1f after, moving %.1f, %.1f\n",
           drawing.triangle_count, lips, before.resting, after.resting, before.moving, after.moving);
    sb_cut_surface_destroy(surface);
    sb_cut_destroy(knife);
    sb_body_destroy(body);
}

int main(void)
{
    sb_mesh mesh;
    sb_error error;
    if (sb_mesh_beam(SB_TET4, 35, 8, 8, sb_v3((sb_real)length, (sb_real)width, (sb_real)height), NULL, &mesh, &error) !=
        SB_OK)
        fail("mesh", &error);
    printf("%d tets, %d nodes\n", mesh.element_count, mesh.node_count);
    for (int lattice = 1; lattice <= 4; lattice *= 2)
        run(&mesh, lattice);
    sb_mesh_free(&mesh);
    return 0;
}
