/* scene.h: what several tests of bodies share: beams, supports on a plane, clocks of memory and of threads. */
#ifndef SCENE_H
#define SCENE_H

#include "check.h"
#include "softbody.h"

#if defined(SB_USE_OPENMP)
#include <omp.h>
#endif
#if defined(CHECK_THREADS)
#include <pthread.h>
#endif

#define REAL(x) ((sb_real)(x))
/* A tolerance that float can meet too: `tolerance` in double, at least `eps_count` machine epsilons. */
static inline double scene_tolerance(double tolerance, double eps_count)
{
    double least = eps_count * (double)SB_EPSILON;
    return tolerance > least ? tolerance : least;
}

/* Box of cells at the origin, nodes in the interior shifted by up to `shake` of a cell when shake > 0. */
static inline sb_mesh scene_box(sb_element_type type, int nx, int ny, int nz, sb_vec3 size, double shake)
{
    sb_mesh mesh;
    unsigned long long seed = 7;
    memset(&mesh, 0, sizeof mesh);
    if (sb_mesh_beam(sb_element_straight(type), nx, ny, nz, size, NULL, &mesh, NULL) != SB_OK)
        return mesh;
    for (int i = 0; shake > 0 && i < mesh.node_count; i++) {
        sb_vec3 *x = mesh.nodes + i;
        sb_real edge = REAL(1e-6) * size.x;
        if (x->x < edge || x->y < edge || x->z < edge || x->x > size.x - edge || x->y > size.y - edge ||
            x->z > size.z - edge)
            continue;
        x->x += REAL(check_random_in(&seed, -shake, shake)) * size.x / REAL(nx);
        x->y += REAL(check_random_in(&seed, -shake, shake)) * size.y / REAL(ny);
        x->z += REAL(check_random_in(&seed, -shake, shake)) * size.z / REAL(nz);
    }
    if (type != mesh.element_type) {
        sb_mesh straight = mesh;
        memset(&mesh, 0, sizeof mesh);
        if (type == SB_TET10)
            sb_mesh_to_tet10(&straight, NULL, &mesh, NULL);
        else if (type == SB_HEX20)
            sb_mesh_to_hex20(&straight, NULL, &mesh, NULL);
        else
            sb_mesh_to_hex27(&straight, NULL, &mesh, NULL);
        sb_mesh_free(&straight);
    }
    return mesh;
}

static inline sb_real scene_component(sb_vec3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

/* Fixes `axes` of the nodes whose coordinate `axis` is within rounding of `value`; returns how many. */
static inline int scene_fix_plane(sb_body *body, const sb_mesh *mesh, int axis, double value, int axes)
{
    int count = 0;
    sb_vec3 low, high;
    double near_enough;
    sb_mesh_bounds(mesh, &low, &high);
    near_enough = 1e-5 * (double)sb_v3_norm(sb_v3_sub(high, low));
    for (int i = 0; i < mesh->node_count; i++)
        if (fabs((double)scene_component(mesh->nodes[i], axis) - value) < near_enough) {
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, axes));
            count++;
        }
    return count;
}

/* Fixes all nodes on the surface of the mesh. */
static inline void scene_fix_boundary(sb_body *body, const sb_mesh *mesh)
{
    sb_boundary boundary;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL)))
        return;
    CHECK_OK(sb_body_fix_nodes(body, boundary.nodes, boundary.surface.node_count, SB_XYZ));
    sb_boundary_free(&boundary);
}

static inline sb_body *scene_body(const sb_body_def *def)
{
    sb_body *body = NULL;
    sb_error error;
    if (sb_body_create(def, &body, &error) != SB_OK) {
        printf("%s: %s\n", sb_result_string(error.result), error.message);
        CHECK(body != NULL);
    }
    return body;
}

/* A body whose mesh may change. */
static inline sb_body *scene_changing_body(const sb_mesh *mesh, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.slack = REAL(0.1);
    return scene_body(&def);
}

/* Removes every ninth cell about the middle: their slots stay, free. */
static inline void scene_remove_cells(sb_body *body)
{
    int count = sb_body_element_count(body);
    sb_body_change *change;
    sb_error error;
    if (!CHECK_OK(sb_body_change_begin(body, &change, &error)))
        return;
    for (int e = count / 3; e < count / 2; e += 9)
        CHECK_OK(sb_body_change_remove_cell(change, e, &error));
    if (!CHECK_OK(sb_body_change_commit(change, &error))) {
        printf("%s\n", error.message);
        sb_body_change_cancel(change);
    }
}

/* Largest |a - b| over count vectors. */
static inline double scene_distance(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double largest = 0;
    for (int i = 0; i < count; i++) {
        double d = (double)sb_v3_norm(sb_v3_sub(a[i], b[i]));
        if (!(d <= largest))
            largest = d;
    }
    return largest;
}

static inline sb_vec3 scene_sum(const sb_vec3 *a, int count)
{
    double x = 0, y = 0, z = 0;
    for (int i = 0; i < count; i++) {
        x += (double)a[i].x;
        y += (double)a[i].y;
        z += (double)a[i].z;
    }
    return sb_v3((sb_real)x, (sb_real)y, (sb_real)z);
}

static inline int scene_all_finite(const sb_vec3 *a, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(a[i]))
            return 0;
    return 1;
}

/* FNV-1a over the bits of an array. */
static inline unsigned long long scene_hash(const void *data, size_t bytes)
{
    const unsigned char *p = (const unsigned char *)data;
    unsigned long long hash = 14695981039346656037ULL;
    for (size_t i = 0; i < bytes; i++)
        hash = (hash ^ p[i]) * 1099511628211ULL;
    return hash;
}

/* An allocator that counts, and fails at call number fail_at, and at each from number fail_from on (from 1; 0: never).
 */
typedef struct scene_memory {
    int calls, live, fail_at, fail_from;
} scene_memory;

/* What it gives is full of what no number should be made of: used memory, as a host's allocator gives it. */
static inline void *scene_alloc(void *user, size_t bytes)
{
    scene_memory *memory = (scene_memory *)user;
    void *pointer;
    if (++memory->calls == memory->fail_at || (memory->fail_from && memory->calls >= memory->fail_from))
        return NULL;
    pointer = malloc(bytes);
    if (pointer)
        memset(pointer, 0xFE, bytes);
    memory->live += pointer != NULL;
    return pointer;
}

static inline void scene_release(void *user, void *pointer)
{
    if (pointer)
        ((scene_memory *)user)->live--;
    free(pointer);
}

static inline sb_allocator scene_allocator(scene_memory *memory)
{
    sb_allocator allocator;
    allocator.alloc = scene_alloc;
    allocator.release = scene_release;
    allocator.user = memory;
    return allocator;
}

#if defined(CHECK_THREADS)
typedef struct scene_worker {
    sb_task task;
    void *task_user;
    int first, stride, count;
    pthread_t thread;
} scene_worker;

static inline void *scene_work(void *user)
{
    const scene_worker *worker = (const scene_worker *)user;
    for (int i = worker->first; i < worker->count; i += worker->stride)
        worker->task(worker->task_user, i);
    return NULL;
}

/* Each worker is a thread made for this loop: what the thread sanitizer understands, which OpenMP's runtime is not. A
 * race shows between any two of them. */
static inline void scene_run_threads(int count, sb_task task, void *task_user, int workers)
{
    enum { MOST = 3 };
    scene_worker all[MOST];
    workers = workers > MOST ? MOST : workers;
    for (int w = 0; w < workers; w++) {
        all[w].task = task, all[w].task_user = task_user;
        all[w].first = w, all[w].stride = workers, all[w].count = count;
        if (w > 0)
            CHECK_INT(pthread_create(&all[w].thread, NULL, scene_work, &all[w]), 0);
    }
    scene_work(&all[0]);
    for (int w = 1; w < workers; w++)
        CHECK_INT(pthread_join(all[w].thread, NULL), 0);
}
#endif

/* Jobs that run the tasks as `workers` threads might: dealt out in turn, the last worker first; with OpenMP or
 * CHECK_THREADS (make test-tsan) on threads. */
static inline void scene_run(void *user, sb_task task, void *task_user, int count)
{
    int workers = *(const int *)user;
#if defined(CHECK_THREADS)
    scene_run_threads(count, task, task_user, workers);
#elif defined(SB_USE_OPENMP)
    sb_jobs jobs = sb_jobs_openmp();
    omp_set_num_threads(workers);
    jobs.run(jobs.user, task, task_user, count);
#else
    for (int w = workers - 1; w >= 0; w--)
        for (int i = w; i < count; i += workers)
            task(task_user, i);
#endif
}

static inline sb_jobs scene_jobs(int *workers)
{
    sb_jobs jobs;
    jobs.run = scene_run;
    jobs.user = workers;
    return jobs;
}

/* Displacement and velocity hash after a scene of every kind of load: gravity, traction, a moving tool. */
static inline unsigned long long scene_play(sb_element_type type, sb_material material, sb_integrator integrator,
                                            int steps, sb_jobs jobs)
{
    sb_mesh mesh = scene_box(type, 8, 3, 3, sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)), 0.1);
    sb_body_def def = sb_default_body_def();
    unsigned long long hash = 0;
    sb_body *body;
    int tool = 0;
    def.mesh = &mesh;
    def.material = material;
    def.integrator = integrator;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.jobs = jobs;
    body = scene_body(&def);
    if (!body)
        return 0;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x + mesh.nodes[i].z > mesh.nodes[tool].x + mesh.nodes[tool].z)
            tool = i;
    for (int s = 0; s < steps; s++) {
        sb_vec3 target = sb_v3(0, 0, REAL(-0.0005) * REAL(s));
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Z, &target, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    hash = scene_hash(sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_velocities(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_reactions(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

#endif /* SCENE_H */
