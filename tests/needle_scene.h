/* needle_scene.h: what tests of needles in tissue share: a block of gel, a needle above it, runs of steps. */
#ifndef NEEDLE_SCENE_H
#define NEEDLE_SCENE_H

#include "needle.h"
#include "scene.h"

/* What tissue in these scenes is made of: corotated. */
typedef struct needle_scene_material {
    sb_real young, poisson, density;
} needle_scene_material;

/* A block from the origin to `size`, held at its four sides; the needle comes from above (z), along -z. */
typedef struct needle_scene {
    int cells[3];
    sb_vec3 size;         /* m */
    double shake;         /* of the inner nodes, in cells */
    int layered;          /* 1: region 1 below half of the height */
    int turned;           /* 1: all of it turned and shifted */
    sb_element_type type; /* of its elements */
    needle_scene_material materials[2];
    const sb_material *other; /* of all of it in place of `materials`, or NULL */
    const sb_mesh *beside;    /* another organ, of such elements, placed as the block is; NULL: none */
    sb_body_def body_def;
    ndl_friction frictions[2];
    ndl_needle_def needle_def; /* base above the middle of the top */
    sb_mesh mesh;
    sb_body *body;
    ndl_needle *needles[NDL_MAX_NEEDLES];
    int count;
    ndl_step_info info;
    sb_error error;
} needle_scene;

/* How bodies with needles are stepped here: one linear system a step. */
static inline sb_body_def needle_scene_body_def(void)
{
    sb_body_def def = sb_default_body_def();
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = REAL(0.005);
    def.slack = REAL(0.2);
    def.tolerance = REAL(1e-4);
    def.max_iterations = 200;
    return def;
}

/* 4 x 4 x 4 cm of 50 kPa in 4 cells each way, and a needle with its tip 1 mm above. */
static inline needle_scene needle_scene_default(void)
{
    needle_scene s;
    memset(&s, 0, sizeof s);
    s.cells[0] = s.cells[1] = s.cells[2] = 4;
    s.type = SB_TET4;
    s.size = sb_v3(REAL(0.04), REAL(0.04), REAL(0.04));
    s.shake = 0.1;
    for (int i = 0; i < 2; i++) {
        s.materials[i].young = 50000;
        s.materials[i].poisson = REAL(0.4);
        s.materials[i].density = 1000;
        s.frictions[i].friction = 20;
        s.frictions[i].cutting = REAL(0.5);
    }
    s.body_def = needle_scene_body_def();
    s.needle_def = ndl_default_needle_def();
    s.needle_def.follow = NDL_REMESH; /* tests of NDL_EMBED say so */
    s.needle_def.base = sb_v3(REAL(0.0213), REAL(0.0191), REAL(0.091));
    s.needle_def.direction = sb_v3(0, 0, -1);
    s.needle_def.director = sb_v3(1, 0, 0);
    s.needle_def.length = REAL(0.05);
    return s;
}

/* The rigid motion of `turned` scenes. */
static inline sb_mat3 needle_scene_rotation(void)
{
    sb_real s, c;
    sb_mat3 a = sb_m3_identity(), b = sb_m3_identity();
    sb_sin_cos(REAL(0.9), &s, &c);
    a.m[0][0] = a.m[1][1] = c, a.m[0][1] = -s, a.m[1][0] = s;
    sb_sin_cos(REAL(-2.1), &s, &c);
    b.m[1][1] = b.m[2][2] = c, b.m[1][2] = -s, b.m[2][1] = s;
    return sb_m3_mul(a, b);
}
static inline sb_vec3 needle_scene_turned(sb_vec3 x) { return sb_m3_apply(needle_scene_rotation(), x); }
static inline sb_vec3 needle_scene_placed(sb_vec3 x)
{
    return sb_v3_add(needle_scene_turned(x), sb_v3(REAL(0.07), REAL(-0.03), REAL(0.11)));
}

static inline int needle_scene_is_side(const needle_scene *s, sb_vec3 x)
{
    sb_real margin = REAL(1e-5) * s->size.x;
    return x.x < margin || x.y < margin || x.x > s->size.x - margin || x.y > s->size.y - margin;
}

static inline int needle_scene_make_mesh(needle_scene *s, int *fixed)
{
    int count = 0;
    for (int i = 0; i < s->mesh.node_count; i++)
        if (needle_scene_is_side(s, s->mesh.nodes[i]))
            fixed[count++] = i;
    if (s->layered)
        for (int e = 0; e < s->mesh.element_count; e++) {
            sb_real z = 0;
            int width = sb_mesh_element_width(&s->mesh);
            for (int c = 0; c < width; c++)
                z += s->mesh.nodes[s->mesh.elements[width * e + c]].z;
            s->mesh.regions[e] = z < REAL(0.5 * width) * s->size.z;
        }
    for (int i = 0; i < s->mesh.node_count && s->turned; i++)
        s->mesh.nodes[i] = needle_scene_placed(s->mesh.nodes[i]);
    return count;
}

static inline void needle_scene_free(needle_scene *s)
{
    for (int i = 0; i < s->count; i++)
        ndl_needle_destroy(s->needles[i]);
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
    s->body = NULL;
    s->count = 0;
}

static inline sb_material needle_scene_material_of(const needle_scene *s, int region)
{
    const needle_scene_material *m = s->materials + region;
    return s->other ? *s->other : sb_material_corotated(m->young, m->poisson, m->density);
}

/* The body alone; 0 (with a failed check) when it cannot be made. */
static inline int needle_scene_make_body(needle_scene *s)
{
    sb_region_material lower;
    int *fixed, count;
    s->mesh = scene_box(s->type, s->cells[0], s->cells[1], s->cells[2], s->size, s->shake);
    if (s->beside)
        CHECK_OK(sb_mesh_append(&s->mesh, s->beside, NULL));
    if (s->layered && !s->mesh.regions)
        s->mesh.regions = (int *)malloc((size_t)s->mesh.element_count * sizeof(int)); /* freed as the others are */
    fixed = (int *)malloc((size_t)s->mesh.node_count * sizeof(int));
    if (!CHECK(fixed && s->mesh.node_count > 0 && (!s->layered || s->mesh.regions))) {
        free(fixed);
        return 0;
    }
    count = needle_scene_make_mesh(s, fixed);
    lower.region = 1;
    lower.material = needle_scene_material_of(s, 1);
    s->body_def.mesh = &s->mesh;
    s->body_def.material = needle_scene_material_of(s, 0);
    s->body_def.region_materials = s->layered ? &lower : NULL;
    s->body_def.region_material_count = s->layered;
    if (sb_body_create(&s->body_def, &s->body, &s->error) != SB_OK)
        printf("%s\n", s->error.message);
    else
        CHECK_OK(sb_body_fix_nodes(s->body, fixed, count, SB_XYZ));
    free(fixed);
    s->body_def.region_materials = NULL;
    return CHECK(s->body != NULL);
}

/* A needle by needle_def, moved aside by `shift`; NULL (with a failed check) when it cannot be made. */
static inline ndl_needle *needle_scene_add(needle_scene *s, sb_vec3 shift)
{
    ndl_needle_def def = s->needle_def;
    ndl_needle *needle = NULL;
    def.body = s->body;
    def.base = sb_v3_add(def.base, shift);
    if (s->turned) {
        def.base = needle_scene_placed(def.base);
        def.direction = needle_scene_turned(def.direction);
        def.director = needle_scene_turned(def.director);
    }
    if (!def.frictions) {
        def.frictions = s->frictions;
        def.friction_count = s->layered ? 2 : 1;
    }
    if (ndl_needle_create(&def, &needle, &s->error) != SB_OK)
        printf("%s\n", s->error.message);
    else
        s->needles[s->count++] = needle;
    CHECK(needle != NULL);
    return needle;
}

/* Body and one needle. */
static inline int needle_scene_make(needle_scene *s)
{
    return needle_scene_make_body(s) && needle_scene_add(s, sb_v3(0, 0, 0)) != NULL;
}

static inline ndl_command needle_command(double insertion, double twist)
{
    ndl_command command;
    memset(&command, 0, sizeof command);
    command.insertion = REAL(insertion);
    command.twist = REAL(twist);
    return command;
}

/* `steps` steps with one command for all needles; 1 when all went well. */
static inline int needle_scene_run(needle_scene *s, double dt, int steps, ndl_command command)
{
    ndl_command commands[NDL_MAX_NEEDLES];
    for (int k = 0; k < NDL_MAX_NEEDLES; k++)
        commands[k] = command;
    for (int i = 0; i < steps; i++)
        if (!CHECK_OK(ndl_step(s->body, s->needles, s->count, REAL(dt), commands, &s->info, &s->error))) {
            printf("step %d of %d: %s\n", i, steps, s->error.message);
            return 0;
        }
    return 1;
}

/* Of the first needle: what the sleeve pushes with along the needle (N). */
static inline double needle_push(const needle_scene *s)
{
    sb_vec3 force;
    sb_vec3 along = s->turned ? needle_scene_turned(s->needle_def.direction) : s->needle_def.direction;
    ndl_needle_base_wrench(s->needles[0], &force, NULL);
    return (double)sb_v3_dot(force, along);
}

static inline sb_vec3 needle_tip(const ndl_needle *needle) { return ndl_needle_tip(needle).position; }

/* Bits of mesh, positions and velocities of the body and of all needles. */
static inline unsigned long long needle_scene_bits(const needle_scene *s)
{
    const sb_vec3 *x = sb_body_positions(s->body), *v = sb_body_velocities(s->body);
    const sb_vec3 *X = sb_body_rest_positions(s->body);
    unsigned long long hash = 0;
    for (int i = 0; i < sb_body_node_count(s->body); i++)
        if (sb_body_node_in_use(s->body, i))
            hash = hash * 31 + (scene_hash(x + i, sizeof(sb_vec3)) ^ 3 * scene_hash(v + i, sizeof(sb_vec3)) ^
                                5 * scene_hash(X + i, sizeof(sb_vec3)));
    for (int t = 0; t < sb_body_element_count(s->body); t++)
        if (sb_body_cell_in_use(s->body, t))
            hash = hash * 31 + scene_hash(sb_body_cell_nodes(s->body, t), 4 * sizeof(int));
    for (int k = 0; k < s->count; k++) {
        const ndl_rod *rod = ndl_needle_rod(s->needles[k]);
        size_t bytes = (size_t)ndl_rod_node_count(rod) * sizeof(sb_vec3);
        sb_vec3 wrench[2];
        ndl_needle_base_wrench(s->needles[k], wrench, wrench + 1);
        hash = hash * 31 + (scene_hash(ndl_rod_positions(rod), bytes) ^ 7 * scene_hash(ndl_rod_velocities(rod), bytes) ^
                            11 * scene_hash(wrench, sizeof wrench));
    }
    return hash;
}

/* Sum of the forces of the tissue on a needle (N). */
static inline sb_vec3 needle_contact_sum(const ndl_needle *needle)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < ndl_rod_node_count(ndl_needle_rod(needle)); i++)
        sum = sb_v3_add(sum, ndl_needle_contact_force(needle, i));
    return sum;
}

/* Mesh and body have the same nodes and cells at the same places, number by number. */
static inline int needle_scene_is_mesh_of(const sb_body *body, const sb_mesh *mesh)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    int width = sb_mesh_element_width(mesh);
    if (sb_body_node_count(body) != mesh->node_count || sb_body_element_count(body) != mesh->element_count)
        return 0;
    for (int t = 0; t < mesh->element_count; t++)
        if (!sb_body_cell_in_use(body, t) ||
            memcmp(sb_body_cell_nodes(body, t), mesh->elements + width * t, (size_t)width * sizeof(int)) != 0)
            return 0;
    return memcmp(X, mesh->nodes, (size_t)mesh->node_count * sizeof *X) == 0;
}
static inline int needle_scene_is_original(const needle_scene *s)
{
    const ndl_remesh *remesh = s->count ? ndl_needle_remesh(s->needles[0]) : NULL;
    return needle_scene_is_mesh_of(s->body, &s->mesh) && (!remesh || ndl_remesh_is_original(remesh));
}

/* All of body and needles finite, and the mesh sound. */
static inline int needle_scene_is_sound(const needle_scene *s)
{
    sb_error error;
    const ndl_remesh *remesh = s->count ? ndl_needle_remesh(s->needles[0]) : NULL;
    int ok = sb_body_live_check(s->body, &error) == SB_OK && s->count > 0 &&
             (!remesh || ndl_remesh_check(remesh, &error) == SB_OK);
    if (!ok)
        printf("%s\n", error.message);
    ok = ok && scene_all_finite(sb_body_positions(s->body), sb_body_node_count(s->body)) &&
         scene_all_finite(sb_body_velocities(s->body), sb_body_node_count(s->body));
    for (int k = 0; k < s->count; k++) {
        const ndl_rod *rod = ndl_needle_rod(s->needles[k]);
        sb_vec3 force, torque;
        ndl_needle_base_wrench(s->needles[k], &force, &torque);
        ok = ok && scene_all_finite(ndl_rod_positions(rod), ndl_rod_node_count(rod)) &&
             scene_all_finite(ndl_rod_velocities(rod), ndl_rod_node_count(rod)) && sb_v3_is_finite(force) &&
             sb_v3_is_finite(torque);
    }
    return ok;
}

/* Largest distance of a coupled rod node from its tissue node over the mean edge in the tissue; -1: nodes differ in
 * kind (coupled without tissue node, or the other way round). */
static inline double needle_drift(const needle_scene *s, const ndl_needle *needle)
{
    const ndl_rod *rod = ndl_needle_rod(needle);
    const sb_vec3 *x = ndl_rod_positions(rod), *tissue = sb_body_positions(s->body);
    int n = ndl_rod_node_count(rod), first = ndl_needle_entry(needle);
    double drift = 0, spacing = n - first > 1 ? (double)ndl_needle_depth(needle) / (n - first - 1) : 1;
    for (int i = 0; i < n; i++) {
        int node = ndl_needle_body_node(needle, i);
        int shallow_tip = i == n - 1 && i == first + 1; /* may have no node of its own */
        int is_in = i >= first && !(shallow_tip && node < 0);
        if ((node >= 0) != is_in || (ndl_needle_contact(needle, i) != NDL_FREE) != is_in)
            return -1;
        if (node >= 0)
            drift = fmax(drift, (double)sb_v3_norm(sb_v3_sub(x[i], tissue[node])) / spacing);
    }
    return drift;
}

#endif /* NEEDLE_SCENE_H */
