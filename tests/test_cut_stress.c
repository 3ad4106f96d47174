/* Livers that are cut without mercy: strokes that cross, graze faces, go through nodes and edges, backwards, out and in
 * again, slices of a millionth of the organ, scissors, soups of triangles, and burns in between. After each: nothing is
 * lost, no hole in the surface nor in a fine skin that is cut along, no number that is none; and the same bits for any
 * number of threads, from recordings, from saved states, and taken back.
 *
 * Ten short sequences of small organs here, three of quadratic elements. CHECK_SLOW=200 runs so many long ones, from
 * CHECK_FIRST on, or as many as CHECK_SECONDS of the processor allow, and 50 times as many strokes; make soak-cuts
 * does. */
#include "fine_skin.h"
#include "random_case.h"

#include <time.h>

enum { FRAMES = 6 };

/* Long sequences, of larger organs: see above. */
static int is_long(void) { return getenv("CHECK_SLOW") != NULL; }

typedef struct stress {
    block b;
    sb_element_type element;
    int cells; /* of the organ */
    sb_cut_surface *surface;
    sb_mesh skin; /* fine */
    sb_cut_fine *fine;
    fine_rims rims;
    scene_memory memory;
    sb_allocator allocator;
    unsigned long long number;
    int workers, tool; /* tool: a blade that waits in the tissue between actions, or -1 */
    double size, volume, removed, mass;
    sb_vec3 last_middle, last_normal; /* of the last plane */
    int taken, parted;                /* calls that took something out, or parted cells */
    int looks;                        /* at the organ */
    int lines;                        /* edges of the surface where cuts end in one line */
} stress;

/* ---- an organ ---------------------------------------------------------------------------------------------------- */

/* Like a liver, or a shared one where there are any. */
static sb_mesh organ_mesh(const stress *s)
{
    char path[1024];
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    if (is_long() && s->number % 8 == 7 && check_shared_path(path, sizeof path, "data/volumes/liver_a_tet4_2k.vtk") &&
        CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL)))
        return mesh;
    CHECK_OK(sb_mesh_organ(SB_TET4, s->cells, NULL, &mesh, NULL));
    return mesh;
}

/* The same with straight edges and nodes in their middles. */
static sb_mesh quadratic_mesh(const stress *s)
{
    sb_mesh linear = organ_mesh(s), mesh;
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_to_tet10(&linear, NULL, &mesh, NULL));
    sb_mesh_free(&linear);
    return mesh;
}

/* A visual skin: of an organ with smaller elements, or the boundary in finer triangles, smooth or rough. */
static sb_mesh stress_skin(const stress *s)
{
    static const double noise[3] = {0, 0.04, 0.1};
    unsigned long long seed = 77 * s->number + 5;
    int kind = (int)(s->number % 4), times = 1 + (int)(s->number / 4 % 2);
    stress finer = *s;
    sb_mesh mesh, skin;
    finer.cells = kind == 3 ? 2 * s->cells + (int)(s->number / 4 % 3) : s->cells;
    mesh = organ_mesh(&finer);
    skin = fine_skin_of(&mesh, kind == 3 ? 0 : times, kind == 3 ? 0 : noise[kind], &seed);
    sb_mesh_free(&mesh);
    return skin;
}

static void stress_make(stress *s, sb_element_type element, unsigned long long number, int cells, int workers)
{
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut = sb_default_cut_def();
    sb_vec3 low, high;
    sb_error error;
    memset(s, 0, sizeof *s);
    s->number = number;
    s->workers = workers;
    s->tool = -1;
    s->allocator = scene_allocator(&s->memory);
    s->element = element;
    s->cells = cells;
    s->b.mesh = element == SB_TET10 ? quadratic_mesh(s) : organ_mesh(s);
    sb_mesh_bounds(&s->b.mesh, &low, &high);
    s->size = (double)sb_v3_norm(sb_v3_sub(high, low));
    def.mesh = &s->b.mesh;
    def.material = number % 3 == 1 ? sb_material_stable_neo_hookean(4000, REAL(0.4), 1000)
                                   : sb_material_corotated_invertible(4000, REAL(0.4), 1000);
    def.gravity = sb_v3(0, 0, REAL(-2));
    def.damping_stiffness = REAL(0.01);
    def.slack = number % 2 ? REAL(0.05) : 2;
    def.jobs = scene_jobs(&s->workers);
    def.allocator = s->allocator;
    s->b.body = scene_body(&def);
    for (int i = 0; i < s->b.mesh.node_count && number % 5; i++)
        if (s->b.mesh.nodes[i].x < low.x + REAL(0.15) * (high.x - low.x))
            CHECK_OK(sb_body_fix_nodes(s->b.body, &i, 1, SB_XYZ));
    cut.body = s->b.body;
    cut.lattice = intervals_of[number % 3];
    cut.front = number % 4 < 2 ? SB_CUT_LAG : SB_CUT_GLUE;
    cut.least_piece = number % 6 == 5 ? 0 : 1;
    cut.toughness = number % 7 == 3 ? 100 : 0;
    cut.allocator = s->allocator;
    if (!CHECK_OK(sb_cut_create(&cut, &s->b.cut, &error)))
        printf("%s\n", error.message);
    CHECK_OK(sb_cut_surface_create(s->b.cut, &s->allocator, &s->surface, NULL));
    s->skin = stress_skin(s);
    CHECK_OK(sb_cut_fine_create(s->b.cut, &s->skin, &s->allocator, &s->fine, NULL));
    s->mass = (double)sb_body_mass(s->b.body);
    for (int e = 0; e < s->b.mesh.element_count; e++)
        s->volume += (double)sb_mesh_element_volume(&s->b.mesh, e);
}

static void stress_free(stress *s)
{
    sb_cut_fine_destroy(s->fine);
    sb_mesh_free(&s->skin);
    sb_cut_surface_destroy(s->surface);
    block_free(&s->b);
    CHECK_INT(s->memory.live, 0);
}

/* ---- what holds -------------------------------------------------------------------------------------------------- */

static void check_call(stress *s, sb_result result, const sb_cut_info *info, const sb_error *error)
{
    if (!CHECK_OK(result)) {
        printf("%s\n", error->message);
        return;
    }
    s->removed += (double)info->removed_volume;
    s->taken += info->removed_volume > 0;
    s->parted += info->cells > 0;
}

/* The fine skin is closed, whatever was cut, and rims join no two parts. */
static void check_fine(stress *s)
{
    sb_cut_fine_drawing d;
    double close = scene_tolerance(1e-12, 1e4);
    int more;
    sb_error error;
    if (!CHECK_OK(sb_cut_fine_update(s->fine, &error)))
        printf("%s\n", error.message);
    d = sb_cut_fine_get(s->fine);
    CHECK_INT(d.open_edges, 0);
    CHECK_INT(holes_of(&d.drawn, &more), 0);
    CHECK(scene_all_finite(d.drawn.positions, d.drawn.vertex_count));
    CHECK(scene_all_finite(d.drawn.normals, d.drawn.vertex_count));
    CHECK(memcmp(d.drawn.rest, s->skin.nodes, (size_t)s->skin.node_count * sizeof(sb_vec3)) == 0);
    fine_rims_add(&s->rims, s->b.cut, s->fine);
    CHECK(s->rims.between <= close * s->size * s->size);
}

/* Nothing is lost, and the surface is closed about what is there. */
static void check_organ(stress *s)
{
    double close = scene_tolerance(1e-11, 1e4), volume = 0;
    sb_cut_drawing d;
    sb_error error;
    int more = 0;
    for (int e = 0; e < sb_body_element_count(s->b.body); e++)
        if (sb_body_cell_in_use(s->b.body, e))
            volume += (double)sb_body_cell_share(s->b.body, e) *
                      (double)sb_mesh_element_volume(&s->b.mesh, sb_cut_cell_element(s->b.cut, e));
    CHECK_NEAR(volume + s->removed, s->volume, close * s->volume);
    CHECK_NEAR(sb_body_mass(s->b.body), volume * s->mass / s->volume, close * s->mass);
    CHECK(scene_all_finite(sb_body_positions(s->b.body), sb_body_node_count(s->b.body)));
    check_pieces(&s->b);
    if (!CHECK_OK(sb_cut_surface_update(s->surface, &error)))
        printf("%s\n", error.message);
    d = sb_cut_surface_get(s->surface);
    CHECK_INT(holes_of(&d, &more), 0);
    s->lines += more;
    CHECK_NEAR(volumes_error_in(&s->b, &d, s->element == SB_TET10 ? 1 : 2), 0, close); /* now tet10 are bent */
    CHECK(scene_all_finite(d.positions, d.vertex_count) && scene_all_finite(d.normals, d.vertex_count));
    if (is_long() || ++s->looks % 3 == 0)
        check_fine(s);
}

/* ---- what is done ------------------------------------------------------------------------------------------------ */

static void take_steps(stress *s, int count)
{
    sb_step_info info;
    for (int i = 0; i < count; i++)
        if (!CHECK_OK(sb_body_step(s->b.body, REAL(0.01), &info)))
            printf("%s\n", info.error.message);
}

static sb_vec3 a_place(stress *s, unsigned long long *seed)
{
    const sb_vec3 *x = sb_body_positions(s->b.body);
    sb_vec3 place = x[random_below(seed, s->b.mesh.node_count)];
    if (check_random(seed) < 0.6)
        place = sb_v3_madd(place, REAL(0.03 * s->size), random_direction(seed));
    return place;
}

static void cut_square(stress *s, sb_vec3 middle, sb_vec3 normal, double half)
{
    sb_vec3 triangles[6];
    sb_cut_info info;
    sb_error error;
    square_make(middle, normal, half, triangles);
    s->last_middle = middle, s->last_normal = normal;
    check_call(s, sb_cut_triangles(s->b.cut, triangles, 2, &info, &error), &info, &error);
}

/* Along a face of the mesh where it is now: through its nodes and edges, beyond them too. */
static void graze_face(stress *s, unsigned long long *seed)
{
    const int *nodes =
        s->b.mesh.elements + sb_element_node_count(s->element) * random_below(seed, s->b.mesh.element_count);
    const sb_vec3 *x = sb_body_positions(s->b.body);
    sb_vec3 triangle[3], middle;
    double wide = check_random(seed) < 0.5 ? 1 : check_random_in(seed, 1, 20);
    sb_cut_info info;
    sb_error error;
    middle = sb_v3_scale(REAL(1.0 / 3), sb_v3_add(x[nodes[0]], sb_v3_add(x[nodes[1]], x[nodes[2]])));
    for (int a = 0; a < 3; a++)
        triangle[a] = sb_v3_madd(middle, REAL(wide), sb_v3_sub(x[nodes[a]], middle));
    check_call(s, sb_cut_triangles(s->b.cut, triangle, 1, &info, &error), &info, &error);
}

/* A slice beside the last plane: from a tenth of the organ down to 1e-7 of its size. */
static void cut_slice(stress *s, unsigned long long *seed)
{
    double off = s->size * pow(10, check_random_in(seed, -7, -1));
    if ((double)sb_v3_norm(s->last_normal) == 0)
        s->last_normal = random_direction(seed), s->last_middle = a_place(s, seed);
    cut_square(s, sb_v3_madd(s->last_middle, REAL(off), s->last_normal), s->last_normal, s->size);
}

/* A stroke of some frames: there; there and back; or out of the organ and in again elsewhere. */
static void cut_stroke(stress *s, int kind, unsigned long long *seed)
{
    sb_vec3 middle = a_place(s, seed), along = random_direction(seed), ahead = random_direction(seed), corners[3];
    double half = s->size * check_random_in(seed, 0.05, 0.6), way = s->size * check_random_in(seed, 0.1, 0.8);
    int stroke = -1;
    sb_cut_info info;
    sb_error error;
    for (int i = 0; i <= FRAMES; i++) {
        double at = 2.0 * i / (int)FRAMES - 1;
        at = kind == 1 ? 1 - 2 * fabs(at) : at;
        if (kind == 2 && i == FRAMES / 2)
            middle = sb_v3_add(middle, sb_v3_scale(REAL(2 * s->size), random_direction(seed)));
        if (kind == 2 && i == FRAMES / 2 + 1)
            middle = a_place(s, seed);
        for (int k = 0; k < 3; k++)
            corners[k] = sb_v3_madd(sb_v3_madd(middle, REAL(at * way), ahead), REAL((k - 1) * half), along);
        corners[1] = sb_v3_madd(corners[1], REAL(0.1 * half), ahead);
        if (i == 0)
            CHECK_OK(sb_cut_begin(s->b.cut, corners, 3, &stroke, &error));
        else
            check_call(s, sb_cut_move(s->b.cut, stroke, corners, &info, &error), &info, &error);
        take_steps(s, i % 2);
    }
    if (s->tool >= 0)
        sb_cut_end(s->b.cut, s->tool);
    s->tool = check_random(seed) < 0.3 ? stroke : -1; /* it stays in the tissue until the next one */
    if (s->tool < 0)
        sb_cut_end(s->b.cut, stroke);
}

static void cut_soup(stress *s, unsigned long long *seed)
{
    enum { MOST = 40 };
    sb_vec3 triangles[3 * MOST], middle = a_place(s, seed);
    int count = 1 + random_below(seed, MOST);
    double half = s->size * check_random_in(seed, 0.02, 0.5);
    sb_cut_info info;
    sb_error error;
    for (int k = 0; k < 3 * count; k++)
        triangles[k] = sb_v3_madd(middle, REAL(half * check_random(seed)), random_direction(seed));
    check_call(s, sb_cut_triangles(s->b.cut, triangles, count, &info, &error), &info, &error);
}

static void burn(stress *s, unsigned long long *seed)
{
    sb_vec3 at = a_place(s, seed);
    int frames = 1 + random_below(seed, 3);
    double radius = s->size * (check_random(seed) < 0.2 ? 0 : check_random_in(seed, 0.01, 0.12));
    sb_cut_info info;
    sb_error error;
    for (int i = 0; i < frames; i++) {
        check_call(s, sb_cut_ablate(s->b.cut, at, REAL(radius), &info, &error), &info, &error);
        at = sb_v3_madd(at, REAL(0.02 * s->size), random_direction(seed));
        take_steps(s, i % 2);
    }
}

static void act(stress *s, int action)
{
    unsigned long long seed = 1000 * s->number + (unsigned)action + 17;
    int kind = random_below(&seed, 12);
    if (kind < 3)
        cut_stroke(s, kind, &seed);
    else if (kind == 3)
        graze_face(s, &seed);
    else if (kind < 6)
        cut_slice(s, &seed);
    else if (kind == 6)
        cut_soup(s, &seed);
    else if (kind < 10)
        burn(s, &seed);
    else
        cut_square(s, a_place(s, &seed), random_direction(&seed), s->size * check_random_in(&seed, 0.1, 1));
    take_steps(s, 1);
}

/* ---- the same again ---------------------------------------------------------------------------------------------- */

typedef struct saved {
    void *bytes;
    size_t size;
    uint64_t hash;
    double removed;
    int tool;
} saved;

static saved save(const stress *s)
{
    saved state;
    state.size = sb_body_state_size(s->b.body);
    state.bytes = malloc(state.size);
    state.hash = sb_body_state_hash(s->b.body);
    state.removed = s->removed;
    state.tool = s->tool;
    CHECK_OK(sb_body_state_save(s->b.body, state.bytes, state.size));
    return state;
}

static void load(stress *s, const saved *state)
{
    sb_error error;
    if (!CHECK_OK(sb_body_state_load(s->b.body, state->bytes, state->size, &error)))
        printf("%s\n", error.message);
    CHECK(sb_body_state_hash(s->b.body) == state->hash);
    s->removed = state->removed;
    s->tool = state->tool;
}

/* One sequence, and all that has to lead to the same bits. */
static void run_sequence(sb_element_type element, unsigned long long number, int *taken, int *parted)
{
    static const int workers_of[4] = {1, 2, 3, 7};
    stress s, other;
    saved start, middle, end;
    sb_recording *recording = NULL;
    sb_recording_report report;
    int failures = check.failures, actions = is_long() ? 12 : 6;
    int cells = is_long() && element == SB_TET4 ? 4 + (int)(number % 3) : 4;
    stress_make(&s, element, number, cells, workers_of[number % 4]);
    start = save(&s);
    CHECK_OK(sb_recording_start(s.b.body, 0, &s.allocator, &recording, NULL));
    for (int i = 0; i < actions / 2; i++) {
        act(&s, i);
        check_organ(&s);
    }
    middle = save(&s);
    for (int i = actions / 2; i < actions; i++) {
        act(&s, i);
        check_organ(&s);
    }
    end = save(&s);
    sb_recording_stop(recording);
    stress_make(&other, element, number, cells, workers_of[(number + 1) % 4]);
    if (!CHECK_OK(sb_recording_replay(recording, other.b.body, &report)))
        printf("%s, step %d\n", report.error.message, report.step);
    CHECK(sb_body_state_hash(other.b.body) == end.hash);
    load(&s, &start); /* taken back */
    s.removed = 0;
    check_organ(&s);
    load(&other, &middle); /* elsewhere, and on from there */
    check_organ(&other);
    other.last_middle = s.last_middle, other.last_normal = s.last_normal;
    load(&s, &end);
    check_organ(&s);
    sb_recording_destroy(recording);
    *taken += s.taken;
    *parted += s.parted;
    stress_free(&s);
    stress_free(&other);
    if (check.failures > failures)
        printf("in %s sequence %llu of %s\n", is_long() ? "long" : "short", number, sb_element_name(element));
    free(start.bytes);
    free(middle.bytes);
    free(end.bytes);
}

/* A number from the environment, or another where there is none. */
static double number_in(const char *name, double other)
{
    const char *text = getenv(name);
    return text && *text ? strtod(text, NULL) : other;
}

static void run_sequences(sb_element_type element, int some)
{
    int count = (int)number_in("CHECK_SLOW", some), taken = 0, parted = 0, done = 0;
    double first = number_in("CHECK_FIRST", 0), seconds = number_in("CHECK_SECONDS", 0);
    clock_t begun = clock();
    while (done < count && !(seconds > 0 && (double)(clock() - begun) > seconds * (double)CLOCKS_PER_SEC))
        run_sequence(element, (unsigned long long)first + (unsigned)done++, &taken, &parted);
    printf("   %d sequences: %d calls parted cells, %d took something out\n", done, parted, taken);
    CHECK(parted > done && (taken > 0 || done < 3));
}

static void test_livers(void) { run_sequences(SB_TET4, check_quick() ? 3 : check_rounds(10)); }

static void test_quadratic(void) { run_sequences(SB_TET10, check_quick() ? 1 : check_rounds(3)); }

/* Strokes of a blade alone, ten to an organ, every fourth of quadratic elements. */
static void test_strokes(void)
{
    enum { OF_ORGAN = 10, OF_SEQUENCE = 50 };
    int count = (int)((double)OF_SEQUENCE * number_in("CHECK_SLOW", check_quick() ? 0.2 : 0.8)), done = 0, parted = 0;
    double first = number_in("CHECK_FIRST", 0), seconds = number_in("CHECK_SECONDS", 0);
    unsigned long long number = (unsigned long long)first;
    clock_t begun = clock();
    for (; done < count && !(seconds > 0 && (double)(clock() - begun) > seconds * (double)CLOCKS_PER_SEC); number++) {
        stress s;
        int failures = check.failures;
        stress_make(&s, number % 4 == 3 ? SB_TET10 : SB_TET4, number, 4, 1);
        for (int i = 0; i < OF_ORGAN && done < count; i++, done++) {
            unsigned long long seed = 7919 * number + (unsigned)i + 5;
            cut_stroke(&s, random_below(&seed, 3), &seed);
            take_steps(&s, 1);
            check_organ(&s);
        }
        parted += s.parted;
        stress_free(&s);
        if (check.failures > failures)
            printf("in strokes of organ %llu\n", number);
    }
    printf("   %d strokes, organs %.0f to %llu: %d moves parted cells\n", done, first, number - 1, parted);
    CHECK(parted > done / 2);
}

/* Crumbs that are all kept, down to nothing: long sequences after which a preconditioner in single precision was
 * indefinite on a crumb, and steps failed. */
static void test_crumbs(void)
{
    static const unsigned long long numbers[2] = {17, 29};
    for (int k = check_quick(); k < 2; k++) {
        stress s;
        stress_make(&s, SB_TET4, numbers[k], 6, 1);
        for (int i = 0; i < 12; i++)
            act(&s, i);
        check_organ(&s);
        stress_free(&s);
    }
}

CHECK_SUITE(cut_stress, {"livers without mercy", test_livers}, {"quadratic livers", test_quadratic},
            {"strokes", test_strokes}, {"crumbs are kept", test_crumbs});
