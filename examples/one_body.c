/* one_body: one organ from the scan to the needle and back: registered, held by a probe, pierced, cut across the
 * needle, a flap of it lifted and held up by a retractor, drawn, saved, recorded and played again.
 *
 *     one_body [OPTIONS]              one_body --help lists the options
 *
 * An organ (a volume mesh of tet4, or one made here) is registered to a scan of its skin (a point cloud in the organ's
 * frame, or one made here: the organ is pressed from below, and a camera above it sees a part of it with noise). Loads
 * on its skin are found that give it that shape, and stay. A round probe comes down beside the needle's way and presses
 * on the organ. A needle goes in to a target that has moved with the organ, and waits. From beside it a blade cuts
 * aslant into the organ, across the needle, which goes through the flap and what is under it from then on. A grasper
 * lifts the edge of the flap, a retractor comes under it and holds it up when the grasper lets go; then the needle is
 * drawn out of both. Half way in, the state is saved and loaded into a second scene, which must come to the same bits
 * with the flap on the retractor. All that is done to the body is recorded, and must come to the same bits when it is
 * played on a third. The organ's fine skin is cut along and drawn with the flap on the retractor, closed by the lips of
 * the cut. Writes PREFIX.png (a look into the organ), PREFIX.state, PREFIX.record and PREFIX.csv (what the hand, the
 * probe, the grasper and the retractor feel, tip and target after each step). The last line is
 *
 *     registered_mm=... truth_mm=... target_mm=... probe_N=... opened_mm2=... flap_N=... held_N=... gap_mm=...
 *     open_edges=... continued=same|differs replayed=same|differs needle=out|in seconds=...
 *
 * (one line; truth_mm, the mean error of all nodes, only of a scan made here). registered_mm: mean distance of the scan
 * from the organ's fine skin; target_mm: how far from its target the tip came to rest; probe_N: what the probe presses
 * with there; opened_mm2: area of the cut; flap_N: what the grasper carries before it lets go; held_N: what the
 * retractor bears when it has; gap_mm: how far the needle's way has come apart where the cut crosses it; open_edges: of
 * the fine skin that is cut, 0 of a closed one. Exit status: 0, 1 something differs or the needle is not out at the
 * end, 2 wrong usage or a file that cannot be read or written, 3 no memory, no registration, or a step failed, 4 all of
 * it was done, but a result is not to be trusted: the tip came to rest farther than --miss from its target, the probe
 * presses with less than half of --press or more than twice as much, or the flap does not lie on the retractor. What
 * this is said of, is said to stderr. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#endif
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "softbody.h"

#include "needle.h"
#include "register.h"

#include "options.h"
#include "picture.h"

#define REAL(x) ((sb_real)(x))

enum { EXIT_DIFFERS = 1, EXIT_USAGE = 2, EXIT_SOLVE = 3, EXIT_DOUBTFUL = 4, PATH_SIZE = 1024 };

static const double STEP = 0.02, SPEED = 0.02;        /* s, m/s of the tip */
static const double SLEEVE = 0.080, STANDOFF = 0.035; /* m before the skin at rest: the sleeve, and the tip */
static const double APPROACH = 1, REST = 0.5;         /* s: the sleeve goes to its place; the needle waits */
static const double PROBE = 0.008, ASIDE = 0.025;     /* m: the probe's radius; from the needle's way */
static const double DESCENT = 0.05, CREEP = 0.005;    /* m/s of the probe: through the air; while it presses */
/* The cut: in a mesh whose longest edge is longer than FINEST it is as much larger. */
static const double FINEST = 0.030;                /* m: longest edge */
static const double BESIDE = 0.030, WIDTH = 0.050; /* m: where the way begins, from the needle; its width */
static const double BEYOND = 0.010, BELOW = 0.016; /* m: its end, on the needle's other side; under the skin */
static const double OUTSIDE = 0.4;                 /* of the blade's way lies before that beginning */
static const double CUTTING = 0.6, LIFTING = 0.5;  /* s: the blade goes in; the flap goes up */
static const double GRIP = 0.008,
                    ROOM = 0.010; /* m from the cut's mouth to the grasper; it lifts the retractor's height and this */
static const double RETRACTOR = 0.005, BROAD = 0.020; /* m: the retractor's radius; its length */
static const double BEFORE = 0.72, UNDER = 0.75;      /* of the way: before the mouth; from there to the needle's */
static const double CLEAR = 0.002, RISE = 0.006;      /* m from the blade's way while it goes in; it rises then */
static const double SLIDING = 1.0, SETTLING = 0.6;    /* s: it goes in; the grasper has let go */

typedef struct settings {
    const char *mesh, *skin, *scan, *prefix;
    double scale, young, poisson, friction, cutting, noise, limit, miss, push, press, azimuth, elevation;
    int cells, steps, help;
} settings;

enum { LEAST_GRIPPED = 3, MOST_GRIPPED = 64 };

/* What is marked in the organ: the target, where the needle goes in, and its way on both sides of the cut. */
typedef enum place { TARGET = 0, ENTRY = 1, OVER_CUT = 2, UNDER_CUT = 3, PLACES = 4 } place;

/* A body with a needle before it, a probe above it, what cuts it and holds it open, and what is marked in it. */
typedef struct scene {
    sb_body *body;
    ndl_needle *needle;
    sb_contact *contact;
    int probe, retractor;    /* its tools */
    double round, thickness; /* m: their radii */
    sb_cut *cut;
    sb_cut_surface *surface;            /* skin and lips: what the tools touch */
    int stroke;                         /* of the blade; -1: none */
    double opened;                      /* m^2 */
    sb_embedding *marks;                /* places: they keep their material when it is cut */
    sb_vec3 skin;                       /* m: where the entry is when the blade begins */
    int grip[MOST_GRIPPED], grip_count; /* nodes that the grasper holds */
    sb_vec3 grip_at[MOST_GRIPPED];      /* m: where they were when it closed */
} scene;

typedef struct work {
    const settings *set;
    sb_mesh organ, skin;   /* of tets; its fine surface */
    int *held, held_count; /* nodes that do not move */
    reg_cloud scan;
    sb_vec3 *truth;                /* displacements of the nodes when the scan was made here (m), or NULL */
    sb_vec3 target, direction;     /* m in the organ at rest; unit vector of the needle */
    sb_vec3 entry;                 /* m, on the skin at rest */
    sb_vec3 outward, aside, along; /* unit: out of the skin there, to the cut's mouth, and along that */
    double longest, size;          /* m: edge of the organ; the cut's size, of the usual */
    double mouth;                  /* share of the blade's way at which it goes through the skin */
    scene main, second, third;
    sb_embedding *embedding; /* of the fine skin; follows the first scene */
    sb_recording *recording;
    sb_output csv;  /* csv.file is NULL: none is open */
    sb_vec3 offset; /* m from the sleeve's first place to that before the target */
    int approach_steps, insert_steps, rest_steps, retract_steps, save_step; /* of the needle */
    int cut_steps, lift_steps, slide_steps, settle_steps;                   /* between rest and retract */
    uint64_t reached; /* hash of the body with the flap on the retractor */
    sb_vec3 reached_tip;
    double registered, wrong, missed; /* m */
    double pressed;                   /* N, by the probe at the target */
    double opened, carried, borne;    /* m^2; N, by the grasper; by the retractor */
    double gap;                       /* m, in the needle's way */
    int open_edges;                   /* of the fine skin with the flap on the retractor */
    int continued, replayed, out;
} work;

/* ---- messages -------------------------------------------------------------------------------------------------- */

static int complain(int status, const char *about, const char *message)
{
    progress_end();
    fprintf(stderr, "one_body: %s%s%s\n", about ? about : "", about ? ": " : "", message);
    return status;
}

static int complain_of(int status, const char *about, const sb_error *error)
{
    char place[300];
    if (error->file[0] && error->line > 0)
        snprintf(place, sizeof place, "%s:%d", error->file, error->line);
    else
        snprintf(place, sizeof place, "%s", error->file);
    return complain(error->result == SB_ERROR_MEMORY ? (int)EXIT_SOLVE : status, place[0] ? place : about,
                    error->message);
}

static int complain_memory(void) { return complain(EXIT_SOLVE, NULL, "not enough memory"); }

/* PREFIX and what follows it. */
static void name_file(const work *w, const char *ending, char path[PATH_SIZE])
{
    snprintf(path, PATH_SIZE, "%s%s", w->set->prefix, ending);
}

/* ---- the organ ------------------------------------------------------------------------------------------------- */

static sb_result copy_boundary(const sb_mesh *volume, sb_mesh *surface, sb_error *error)
{
    sb_boundary boundary;
    sb_result result = sb_mesh_boundary(volume, 1, NULL, &boundary, error);
    if (result == SB_OK) {
        result = sb_mesh_copy(&boundary.surface, NULL, surface, error);
        sb_boundary_free(&boundary);
    }
    return result;
}

/* The organ of --mesh, or one made with --cells. */
static int make_organ(work *w)
{
    const settings *set = w->set;
    sb_error error;
    if (set->mesh) {
        sb_load_options options = sb_default_load_options();
        options.scale = REAL(set->scale);
        if (sb_mesh_load(&w->organ, set->mesh, &options, &error) != SB_OK)
            return complain_of(EXIT_USAGE, set->mesh, &error);
        if (w->organ.element_type != SB_TET4)
            return complain(EXIT_USAGE, set->mesh, "the organ must be a volume mesh of tets with 4 nodes");
    } else if (sb_mesh_organ(SB_TET4, set->cells, NULL, &w->organ, &error) != SB_OK) {
        return complain_of(EXIT_USAGE, NULL, &error);
    }
    return 0;
}

/* Its fine skin: --skin, or of an organ made here that of one three times as fine, or its own. */
static int make_skin(work *w)
{
    const settings *set = w->set;
    sb_mesh fine;
    sb_error error;
    sb_result result;
    if (set->skin) {
        sb_load_options options = sb_default_load_options();
        options.scale = REAL(set->scale);
        if (sb_mesh_load(&w->skin, set->skin, &options, &error) != SB_OK)
            return complain_of(EXIT_USAGE, set->skin, &error);
        if (w->skin.element_type != SB_TRI3)
            return complain(EXIT_USAGE, set->skin, "the skin must be a surface of triangles");
        return 0;
    }
    if (set->mesh)
        return copy_boundary(&w->organ, &w->skin, &error) == SB_OK ? 0 : complain_of(EXIT_USAGE, set->mesh, &error);
    result = sb_mesh_organ(SB_TET4, 3 * set->cells < 60 ? 3 * set->cells : 60, NULL, &fine, &error);
    if (result == SB_OK) {
        result = copy_boundary(&fine, &w->skin, &error);
        sb_mesh_free(&fine);
    }
    return result == SB_OK ? 0 : complain_of(EXIT_SOLVE, NULL, &error);
}

static sb_vec3 share_of_box(const work *w, double x, double y, double z)
{
    sb_vec3 low, high;
    sb_mesh_bounds(&w->organ, &low, &high);
    return sb_v3(low.x + REAL(x) * (high.x - low.x), low.y + REAL(y) * (high.y - low.y),
                 low.z + REAL(z) * (high.z - low.z));
}

/* Where the vessels are that hold it: behind, about the middle of its width; as far to the front as it takes for one
 * node in fifty to be held. */
static int hold_organ(work *w)
{
    int wanted = w->organ.node_count / 50 > 3 ? w->organ.node_count / 50 : 3;
    w->held = (int *)malloc((size_t)w->organ.node_count * sizeof *w->held);
    if (!w->held)
        return complain_memory();
    for (int twentieth = 15; twentieth >= 10 && w->held_count < wanted; twentieth--) {
        sb_vec3 low = share_of_box(w, 0.35, twentieth / 20.0, 0), high = share_of_box(w, 0.75, 1, 1);
        w->held_count = 0;
        for (int i = 0; i < w->organ.node_count; i++) {
            sb_vec3 x = w->organ.nodes[i];
            if (x.x >= low.x && x.x <= high.x && x.y >= low.y)
                w->held[w->held_count++] = i;
        }
    }
    return w->held_count >= 3 ? 0
                              : complain(EXIT_USAGE, w->set->mesh, "has no nodes in the middle behind to be held by");
}

/* A place in the thick part, where that is within the organ; else the middle of the tet that is deepest under the
 * skin. */
static sb_vec3 choose_target(const work *w, const sb_surface *skin, double size)
{
    sb_vec3 usual = share_of_box(w, 0.33, 0.47, 0.5), best = usual;
    sb_real deepest = sb_surface_signed_distance_winding(skin, usual, NULL);
    if (deepest < REAL(-0.02 * size))
        return usual;
    for (int e = 0; e < w->organ.element_count; e++) {
        const int *n = w->organ.elements + 4 * (size_t)e;
        const sb_vec3 *X = w->organ.nodes;
        sb_vec3 middle = sb_v3_scale(REAL(0.25), sb_v3_add(sb_v3_add(X[n[0]], X[n[1]]), sb_v3_add(X[n[2]], X[n[3]])));
        sb_real distance = sb_surface_signed_distance_winding(skin, middle, NULL);
        if (distance < deepest) {
            deepest = distance;
            best = middle;
        }
    }
    return best;
}

static double longest_edge(const sb_mesh *mesh)
{
    double longest = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int k = 0; k < 6; k++) {
            const int *n = mesh->elements + 4 * (size_t)e;
            int ends[3];
            sb_element_edge(SB_TET4, k, ends);
            longest = fmax(longest, (double)sb_v3_norm(sb_v3_sub(mesh->nodes[n[ends[0]]], mesh->nodes[n[ends[1]]])));
        }
    return longest;
}

/* Which way the skin looks about the entry, over as much of it as the flap has; the mouth of the cut lies to the side
 * of x of it. */
static void find_directions(work *w)
{
    sb_vec3 sum = {0, 0, 0}, side;
    for (int f = 0; f < w->skin.element_count; f++) {
        const int *n = w->skin.elements + 3 * (size_t)f;
        sb_vec3 a = w->skin.nodes[n[0]], b = w->skin.nodes[n[1]], c = w->skin.nodes[n[2]];
        if ((double)sb_v3_norm(sb_v3_sub(a, w->entry)) < w->size * BESIDE)
            sum = sb_v3_add(sum, sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a)));
    }
    w->outward = sb_v3_norm(sum) > 0 ? sb_v3_scale(1 / sb_v3_norm(sum), sum) : sb_v3(0, 0, 1);
    side = fabs((double)w->outward.x) < 0.9 ? sb_v3(1, 0, 0) : sb_v3(0, 0, -1);
    side = sb_v3_madd(side, -sb_v3_dot(side, w->outward), w->outward);
    w->aside = sb_v3_scale(1 / sb_v3_norm(side), side);
    w->along = sb_v3_cross(w->outward, w->aside);
}

/* A place on the blade's way beside an entry: it begins over the skin (share -OUTSIDE), goes in at the cut's mouth,
 * crosses the needle and ends on its other side (1). */
static sb_vec3 on_way(const work *w, sb_vec3 entry, double share)
{
    double aside = BESIDE - share * (BESIDE + BEYOND), down = share * BELOW;
    return sb_v3_madd(sb_v3_madd(entry, REAL(w->size * aside), w->aside), REAL(-w->size * down), w->outward);
}

/* Of the blade's way: where it crosses the needle's. */
static double share_of_needle(void) { return BESIDE / (BESIDE + BEYOND); }

/* 1: a place is of the flap over the blade's way beside an entry. */
static int is_of_flap(const work *w, sb_vec3 entry, sb_vec3 x)
{
    sb_vec3 from = sb_v3_sub(x, on_way(w, entry, 0));
    double aside = (double)sb_v3_dot(from, w->aside) / w->size, out = (double)sb_v3_dot(from, w->outward) / w->size;
    return out * (BESIDE + BEYOND) > aside * BELOW && aside > -BESIDE &&
           fabs((double)sb_v3_dot(from, w->along)) < 0.4 * w->size * WIDTH;
}

/* Where the blade will go through the skin; and whether the flap has nodes to be held at, and is one at all. */
static int find_mouth(work *w, const sb_surface *skin)
{
    sb_vec3 from = on_way(w, w->entry, -OUTSIDE), way = sb_v3_sub(on_way(w, w->entry, 1), from);
    double length = (double)sb_v3_norm(way);
    int nodes = 0, found;
    sb_surface_hit hit;
    char words[200];
    found = sb_surface_ray(skin, from, sb_v3_scale(REAL(1 / length), way), REAL(length), &hit);
    w->mouth = found ? (double)sb_v3_norm(sb_v3_sub(hit.point, from)) / length * (1 + OUTSIDE) - OUTSIDE : 1;
    for (int i = 0; i < w->organ.node_count; i++)
        nodes += is_of_flap(w, w->entry, w->organ.nodes[i]);
    if (w->mouth < 0.8 * share_of_needle() && nodes >= LEAST_GRIPPED)
        return 0;
    snprintf(words, sizeof words,
             "a flap beside the needle would have %d nodes of the mesh on %.0f mm of length; %d nodes and %.0f mm are "
             "needed (%s)",
             nodes, 1e3 * w->size * fmax(0, BESIDE - w->mouth * (BESIDE + BEYOND)), (int)LEAST_GRIPPED,
             1e3 * w->size * 0.2 * BESIDE, w->set->mesh ? "a finer or a larger organ" : "more --cells");
    return complain(EXIT_USAGE, w->set->mesh, words);
}

/* A target, and a way to it from above that no edges of the mesh run along. */
static int choose_way(work *w)
{
    sb_surface *skin = NULL;
    sb_surface_hit hit;
    sb_error error;
    sb_vec3 low, high, from;
    double size;
    int status;
    sb_mesh_bounds(&w->organ, &low, &high);
    size = (double)sb_v3_norm(sb_v3_sub(high, low));
    if (size < 0.05 || size > 1)
        return complain(EXIT_USAGE, w->set->mesh, "needles need an organ of 5 cm to 1 m; see --scale");
    w->direction = sb_v3(REAL(0.1), REAL(0.2), -1);
    w->direction = sb_v3_scale(1 / sb_v3_norm(w->direction), w->direction);
    if (sb_surface_create(&w->skin, NULL, &skin, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, w->set->skin, &error);
    w->longest = longest_edge(&w->organ);
    w->size = fmax(1, w->longest / FINEST);
    w->target = choose_target(w, skin, size);
    from = sb_v3_madd(w->target, REAL(-2 * size), w->direction);
    if (sb_surface_ray(skin, from, w->direction, SB_REAL_MAX, &hit)) {
        w->entry = hit.point;
        find_directions(w);
        status = find_mouth(w, skin);
    } else {
        status = complain(EXIT_USAGE, w->set->skin, "there is no skin above the target");
    }
    sb_surface_destroy(skin);
    return status;
}

/* ---- scenes ---------------------------------------------------------------------------------------------------- */

/* One linear system a step, in which what STEP cannot resolve is damped away; room for what a cut parts. */
static sb_body_def body_def(const work *w)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = &w->organ;
    def.material = sb_material_corotated(REAL(w->set->young), REAL(w->set->poisson), 1050);
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = REAL(0.01);
    def.tolerance = REAL(1e-4);
    def.slack = 1;
#if defined(SB_USE_OPENMP)
    def.jobs = sb_jobs_openmp();
#endif
    return def;
}

static sb_result make_body(const work *w, sb_body **body, sb_error *error)
{
    sb_body_def def = body_def(w);
    sb_result result = sb_body_create(&def, body, error);
    return result == SB_OK ? sb_body_hold(*body, w->held, w->held_count, SB_XYZ, error) : result;
}

/* Marks the places in the scene's body. */
static sb_result mark_places(const work *w, scene *s, sb_error *error)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_vec3 places[PLACES];
    sb_result result;
    places[TARGET] = w->target;
    places[ENTRY] = w->entry;
    places[OVER_CUT] = sb_v3_madd(w->entry, REAL(0.4 * w->size * BELOW), w->direction);
    places[UNDER_CUT] = sb_v3_madd(w->entry, REAL(1.2 * w->size * BELOW), w->direction);
    def.mesh = &w->organ;
    def.points = places;
    def.point_count = PLACES;
    result = sb_embedding_create(&def, &s->marks, error);
    return result == SB_OK ? sb_embedding_follow(s->marks, s->body, error) : result;
}

/* 1: the target is in the organ. */
static int target_is_inside(const scene *s)
{
    sb_embedded_point point;
    return sb_embedding_get_point(s->marks, TARGET, &point) == SB_OK && point.hold == SB_EMBEDDED_INSIDE;
}

/* The needle's sleeve stands off, clear of the organ wherever that goes. */
static sb_result make_needle(const work *w, scene *s, sb_error *error)
{
    ndl_friction friction = {REAL(w->set->friction), 5, REAL(w->set->cutting), 0, 0};
    ndl_needle_def def = ndl_default_needle_def();
    def.body = s->body;
    def.follow = NDL_EMBED; /* the mesh is the blade's to change */
    def.base = sb_v3_madd(w->entry, REAL(-SLEEVE), w->direction);
    def.direction = w->direction;
    def.length = REAL(SLEEVE - STANDOFF);
    def.frictions = &friction;
    def.friction_count = 1;
    return ndl_needle_create(&def, &s->needle, error);
}

/* A radius that the organ's faces feel. */
static double felt_radius(const work *w, double radius) { return fmax(radius, w->longest / 6); }

/* The probe waits above the organ, beside the needle's way. */
static sb_result make_probe(const work *w, scene *s, sb_error *error)
{
    sb_tool_def probe = sb_default_tool_def();
    sb_vec3 low, high;
    sb_mesh_bounds(&w->organ, &low, &high);
    s->round = felt_radius(w, PROBE);
    probe.radius = REAL(s->round);
    probe.friction = REAL(0.2);
    probe.pose.position = sb_v3(w->entry.x, w->entry.y - REAL(ASIDE), high.z + REAL(STANDOFF));
    return sb_contact_add_tool(s->contact, &probe, &s->probe, error);
}

/* The retractor, a round bar along the cut, waits above the organ on the cut's side of the needle. */
static sb_result make_retractor(const work *w, scene *s, sb_error *error)
{
    sb_tool_def bar = sb_default_tool_def();
    sb_vec3 low, high, ends[2];
    sb_mesh_bounds(&w->organ, &low, &high);
    for (int k = 0; k < 2; k++)
        ends[k] = sb_v3_scale(REAL((k - 0.5) * w->size * BROAD), w->along);
    bar.shape = SB_TOOL_CAPSULES;
    bar.points = ends;
    bar.point_count = 2;
    s->thickness = felt_radius(w, RETRACTOR);
    bar.radius = REAL(s->thickness);
    bar.friction = REAL(0.4);
    bar.pose.position = sb_v3(w->entry.x + REAL(2 * w->size * BESIDE), w->entry.y, high.z + REAL(STANDOFF));
    return sb_contact_add_tool(s->contact, &bar, &s->retractor, error);
}

/* What cuts, and the tools that touch the skin and the lips of cuts. */
static sb_result make_cut(scene *s, sb_error *error)
{
    sb_cut_def def = sb_default_cut_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_result result;
    def.body = s->body;
    def.front = SB_CUT_GLUE; /* the cut opens with the blade, however coarse the mesh */
    s->stroke = -1;
    result = sb_cut_create(&def, &s->cut, error);
    if (result == SB_OK)
        result = sb_cut_surface_create(s->cut, NULL, &s->surface, error);
    contact.body = s->body;
    contact.skin = sb_cut_surface_skin(s->surface);
    return result == SB_OK ? sb_contact_create(&contact, &s->contact, error) : result;
}

/* The same organ, needle, blade, tools and places each time. */
static int make_scene(const work *w, scene *s)
{
    sb_error error;
    sb_result result = make_body(w, &s->body, &error);
    if (result == SB_OK)
        result = mark_places(w, s, &error);
    if (result == SB_OK && !target_is_inside(s))
        return complain(EXIT_USAGE, w->set->mesh, "there is no organ where the target should be");
    if (result == SB_OK)
        result = make_needle(w, s, &error);
    if (result == SB_OK)
        result = make_cut(s, &error);
    if (result == SB_OK)
        result = make_probe(w, s, &error);
    if (result == SB_OK)
        result = make_retractor(w, s, &error);
    return result == SB_OK ? 0 : complain_of(EXIT_SOLVE, "the organ with needle, blade and tools", &error);
}

static void free_scene(scene *s)
{
    sb_embedding_destroy(s->marks);
    sb_contact_destroy(s->contact);
    sb_cut_surface_destroy(s->surface);
    sb_cut_destroy(s->cut);
    ndl_needle_destroy(s->needle);
    sb_body_destroy(s->body);
}

/* Where what is marked is now (m). */
static int find_places(const scene *s, sb_vec3 places[PLACES])
{
    sb_result result = sb_embedding_update(s->marks, sb_body_positions(s->body), places, NULL, NULL);
    return result == SB_OK ? 0 : complain(EXIT_SOLVE, "the target", sb_result_string(result));
}

static int find_target(const scene *s, sb_vec3 *target)
{
    sb_vec3 places[PLACES];
    int status = find_places(s, places);
    *target = places[TARGET];
    return status;
}

/* From the mark over the cut to that under it (m). */
static double distance_across(const scene *s)
{
    sb_vec3 places[PLACES];
    return find_places(s, places) ? 0 : (double)sb_v3_norm(sb_v3_sub(places[OVER_CUT], places[UNDER_CUT]));
}

/* ---- the scan -------------------------------------------------------------------------------------------------- */

/* Evenly spread in [0, 1), the same on every machine. */
static double draw(uint64_t *seed)
{
    uint64_t z = *seed += 0x9e3779b97f4a7c15u; /* splitmix64 */
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return (double)((z ^ z >> 31) >> 11) / 9007199254740992.0;
}

/* The nodes of the skin that are pressed: within a tenth of the organ's size of the place below the thick part. */
static int find_pressed(const work *w, const sb_boundary *boundary, int *nodes)
{
    sb_vec3 low, high, place = share_of_box(w, 0.3, 0.35, 0);
    int count = 0;
    sb_real reach;
    sb_mesh_bounds(&w->organ, &low, &high);
    reach = REAL(0.1) * sb_v3_norm(sb_v3_sub(high, low));
    for (int i = 0; i < boundary->surface.node_count; i++) {
        sb_vec3 x = boundary->surface.nodes[i];
        double aside = hypot((double)(x.x - place.x), (double)(x.y - place.y));
        if (aside < (double)reach && x.z < REAL(0.5) * (low.z + high.z))
            nodes[count++] = boundary->nodes[i];
    }
    return count;
}

/* Presses the organ from below; keeps where that takes its nodes. */
static sb_result press_organ(work *w, sb_body *body, sb_error *error)
{
    sb_boundary boundary;
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    int *nodes, count;
    sb_vec3 force;
    sb_result result = sb_mesh_boundary(&w->organ, 1, NULL, &boundary, error);
    if (result != SB_OK)
        return result;
    nodes = (int *)malloc((size_t)boundary.surface.node_count * sizeof *nodes);
    w->truth = (sb_vec3 *)malloc((size_t)w->organ.node_count * sizeof *w->truth);
    count = nodes ? find_pressed(w, &boundary, nodes) : 0;
    force = sb_v3(0, 0, count ? REAL(w->set->push / count) : 0);
    result = !nodes || !w->truth ? SB_ERROR_MEMORY : sb_body_apply_forces(body, nodes, count, &force, 1, error);
    options.load_steps = 4;
    if (result == SB_OK) {
        result = sb_body_solve_static(body, &options, &info);
        *error = info.error;
    }
    if (result == SB_OK)
        memcpy(w->truth, sb_body_displacements(body), (size_t)w->organ.node_count * sizeof *w->truth);
    free(nodes);
    sb_boundary_free(&boundary);
    return result;
}

/* What a camera above sees of the skin: the middles of triangles that face it, with noise along their normals. */
static sb_result look_at(work *w, const sb_vec3 *points, sb_error *error)
{
    int count = 0;
    uint64_t seed = 1;
    sb_vec3 *seen = (sb_vec3 *)malloc((size_t)w->skin.element_count * sizeof *seen);
    sb_vec3 *normals = (sb_vec3 *)malloc((size_t)w->skin.element_count * sizeof *normals);
    sb_result result = SB_ERROR_MEMORY;
    for (int e = 0; seen && normals && e < w->skin.element_count; e++) {
        const int *n = w->skin.elements + 3 * (size_t)e;
        sb_vec3 a = points[n[0]], b = points[n[1]], c = points[n[2]];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a));
        double noise = w->set->noise * 1e-3 * 1.732 * (draw(&seed) + draw(&seed) - 1) * 1.414; /* of that deviation */
        if (!(normal.z > REAL(0.35) * sb_v3_norm(normal)))
            continue;
        normals[count] = sb_v3_scale(1 / sb_v3_norm(normal), normal);
        seen[count] = sb_v3_scale(REAL(1.0 / 3), sb_v3_add(a, sb_v3_add(b, c)));
        seen[count] = sb_v3_madd(seen[count], REAL(noise), normals[count]);
        count++;
    }
    if (seen && normals)
        result = reg_cloud_from_points(&w->scan, seen, normals, count, NULL, error);
    free(seen);
    free(normals);
    return result;
}

static sb_result embed_skin(work *w, sb_error *error)
{
    sb_embedding_def def = sb_default_embedding_def();
    def.mesh = &w->organ;
    def.surface = &w->skin;
    return sb_embedding_create(&def, &w->embedding, error);
}

static int make_scan(work *w)
{
    sb_body *body = NULL;
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)w->skin.node_count * sizeof *points);
    sb_error error;
    sb_result result;
    memset(&error, 0, sizeof error);
    progress_show(0.02, "a scan is made");
    result = points ? make_body(w, &body, &error) : SB_ERROR_MEMORY;
    if (result == SB_OK)
        result = press_organ(w, body, &error);
    if (result == SB_OK) {
        result = sb_embedding_update(w->embedding, sb_body_positions(body), points, NULL, NULL);
        snprintf(error.message, sizeof error.message, "%s", sb_result_string(result));
    }
    if (result == SB_OK)
        result = look_at(w, points, &error);
    sb_body_destroy(body);
    free(points);
    if (result == SB_ERROR_MEMORY)
        return complain_memory();
    return result == SB_OK
               ? 0
               : complain_of(EXIT_SOLVE, "a scan of the organ pressed so hard (try a smaller --push)", &error);
}

static int get_scan(work *w)
{
    sb_error error;
    if (embed_skin(w, &error) != SB_OK)
        return complain_of(EXIT_USAGE, w->set->skin, &error);
    if (!w->set->scan)
        return make_scan(w);
    if (reg_cloud_load(&w->scan, w->set->scan, REAL(w->set->scale), NULL, &error) != SB_OK)
        return complain_of(EXIT_USAGE, w->set->scan, &error);
    return 0;
}

/* ---- registration ---------------------------------------------------------------------------------------------- */

static int run_match(work *w, reg_match *match)
{
    reg_match_info info = reg_match_get_info(match);
    char words[64];
    for (int i = 0; i < w->set->steps; i++) {
        if (reg_match_run(match, 1, &info) != SB_OK)
            return complain_of(EXIT_SOLVE, "registration", &info.error);
        snprintf(words, sizeof words, "registration, %.2f mm off", 1e3 * (double)info.mean_distance);
        progress_show(0.05 + 0.1 * i / w->set->steps, words);
        if (info.stop != REG_MATCH_STEP_CAP)
            break;
    }
    return 0;
}

/* Loads on the skin that give the organ the shape it was matched to, and that hold it from now on. */
static int hold_shape(work *w, reg_match *match)
{
    reg_loads_def def = reg_default_loads_def();
    reg_loads_info info;
    int count = w->organ.node_count, *nodes = (int *)malloc((size_t)count * sizeof *nodes);
    sb_vec3 *forces = (sb_vec3 *)malloc((size_t)count * sizeof *forces);
    int status = nodes && forces ? 0 : complain_memory();
    sb_error error;
    def.match = match;
    progress_show(0.15, "loads on the skin");
    if (!status && reg_loads_run(&def, forces, &info) != SB_OK)
        status = complain_of(EXIT_SOLVE, "loads", &info.error);
    for (int i = 0; !status && i < count; i++)
        nodes[i] = i;
    if (!status && sb_body_apply_forces(w->main.body, nodes, count, forces, 0, &error) != SB_OK)
        status = complain_of(EXIT_SOLVE, "loads", &error);
    free(nodes);
    free(forces);
    return status;
}

/* Mean distance (m) of nodes from where they were when the scan was made. */
static double error_of(const work *w)
{
    const sb_vec3 *u = sb_body_displacements(w->main.body);
    double sum = 0;
    for (int i = 0; i < w->organ.node_count; i++)
        sum += (double)sb_v3_norm(sb_v3_sub(u[i], w->truth[i]));
    return sum / w->organ.node_count;
}

/* Mean distance (m) of the scan's points from the fine skin where the organ is now. */
static sb_result measure_fit(work *w, sb_error *error)
{
    sb_mesh skin = w->skin;
    sb_surface *surface = NULL;
    sb_result result = SB_ERROR_MEMORY;
    double sum = 0;
    skin.nodes = (sb_vec3 *)malloc((size_t)skin.node_count * sizeof *skin.nodes);
    if (skin.nodes)
        result = sb_embedding_update(w->embedding, sb_body_positions(w->main.body), skin.nodes, NULL, NULL);
    if (result == SB_OK)
        result = sb_surface_create(&skin, NULL, &surface, error);
    for (int i = 0; result == SB_OK && i < w->scan.count; i++) {
        sb_surface_hit hit;
        if (sb_surface_closest(surface, w->scan.points[i], SB_REAL_MAX, &hit))
            sum += (double)hit.distance;
    }
    w->registered = sum / w->scan.count;
    sb_surface_destroy(surface);
    free(skin.nodes);
    return result;
}

/* A needle that is planned on an organ which does not lie where it was seen goes beside its target. */
static int check_fit(const work *w)
{
    char words[160];
    if (1e3 * w->registered <= w->set->limit)
        return 0;
    snprintf(words, sizeof words,
             "the organ lies %.1f mm from its scan, over --limit %g: check --young, --scale and the frame of the scan",
             1e3 * w->registered, w->set->limit);
    return complain(EXIT_SOLVE, "registration", words);
}

static int register_organ(work *w)
{
    reg_match_def def = reg_default_match_def();
    reg_match *match = NULL;
    sb_vec3 target;
    sb_error error;
    int status;
    def.body = w->main.body;
    def.surface = &w->skin;
    def.target_points = w->scan.points;
    def.target_normals = w->scan.normals;
    def.target_count = w->scan.count;
    if (reg_match_create(&def, &match, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, "registration", &error);
    status = run_match(w, match);
    if (!status)
        status = hold_shape(w, match);
    reg_match_destroy(match);
    if (status)
        return status;
    if (measure_fit(w, &error) != SB_OK)
        return complain_memory();
    if ((status = check_fit(w)) != 0)
        return status;
    if (find_target(&w->main, &target))
        return EXIT_SOLVE;
    w->offset = sb_v3_sub(target, w->target);
    w->wrong = w->truth ? error_of(w) : 0;
    progress_end();
    printf("registered     %.2f mm from the scan\n", 1e3 * w->registered);
    fflush(stdout);
    return 0;
}

/* ---- the needle ------------------------------------------------------------------------------------------------ */

/* Steps of the needle: the sleeve goes to its place, the needle goes in (the organ gives way, and it takes longer than
 * at rest), waits, and is drawn out. */
static void plan_way(work *w)
{
    double way = STANDOFF + (double)sb_v3_norm(sb_v3_sub(w->target, w->entry));
    w->approach_steps = (int)(APPROACH / STEP);
    w->insert_steps = (int)ceil(1.25 * way / (SPEED * STEP));
    w->rest_steps = (int)(REST / STEP);
    w->retract_steps = (int)ceil((1.25 * way + 0.005) / (2 * SPEED * STEP));
    w->save_step = w->approach_steps + (int)((STANDOFF + 0.5 * (way - STANDOFF)) / (SPEED * STEP));
    w->cut_steps = (int)(CUTTING / STEP);
    w->lift_steps = (int)(LIFTING / STEP);
    w->slide_steps = (int)(SLIDING / STEP);
    w->settle_steps = (int)(SETTLING / STEP);
}

/* Steps until the needle is at its deepest, until the retractor is under the lifted flap, and until that lies on it. */
static int steps_to_rest(const work *w) { return w->approach_steps + w->insert_steps + w->rest_steps; }
static int steps_to_under(const work *w) { return steps_to_rest(w) + w->cut_steps + w->lift_steps + w->slide_steps; }
static int steps_to_held(const work *w) { return steps_to_under(w) + w->settle_steps; }

/* The needle is fed until its tip is beside the target, wherever the organ has carried that. */
static ndl_command command_at(const work *w, const scene *s, sb_vec3 target, int step)
{
    double left = (double)sb_v3_dot(sb_v3_sub(target, ndl_needle_tip(s->needle).position), w->direction);
    double fed = (double)ndl_needle_fed(s->needle);
    ndl_command command;
    memset(&command, 0, sizeof command);
    if (step < w->approach_steps)
        command.velocity = sb_v3_scale(REAL(1 / (w->approach_steps * STEP)), w->offset);
    else if (step < w->approach_steps + w->insert_steps)
        command.insertion = REAL(fmax(0, fmin(SPEED, left / STEP)));
    else if (step >= steps_to_held(w))
        command.insertion = REAL(-fmax(0, fmin(2 * SPEED, (fed + 0.005) / STEP)));
    return command;
}

/* What a tool is pushed with along a direction (N). */
static double feel_tool(const scene *s, int tool, sb_vec3 direction)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    (void)sb_contact_wrench(s->contact, tool, &wrench);
    return (double)sb_v3_dot(wrench.force, direction) + 0.0; /* not -0 */
}

/* What the probe is pushed up with, and the retractor down into the organ (N). */
static double feel_probe(const scene *s) { return feel_tool(s, s->probe, sb_v3(0, 0, 1)); }
static double feel_retractor(const work *w, const scene *s)
{
    return feel_tool(s, s->retractor, sb_v3_scale(-1, w->outward));
}

/* The probe comes down until it presses as hard as it is to, stays there, and rises when the needle is drawn out. */
static void move_probe(const work *w, const scene *s, int step)
{
    int rises = step >= steps_to_held(w);
    double felt = feel_probe(s), speed = felt > 0 ? CREEP : DESCENT;
    sb_pose pose;
    (void)sb_contact_reached(s->contact, s->probe, &pose, NULL);
    if (!rises && felt >= w->set->press)
        speed = 0;
    pose.position.z += REAL((rises ? DESCENT : -speed) * STEP);
    (void)sb_contact_move_tool(s->contact, s->probe, &pose);
}

/* ---- the blade, the grasper and the retractor ------------------------------------------------------------------- */

/* The blade's edge at a share of its whole way. */
static void blade_at(const work *w, const scene *s, double share, sb_vec3 edge[2])
{
    for (int k = 0; k < 2; k++)
        edge[k] = sb_v3_madd(on_way(w, s->skin, -OUTSIDE + share * (1 + OUTSIDE)), REAL((k - 0.5) * w->size * WIDTH),
                             w->along);
}

static int begin_cut(const work *w, scene *s)
{
    sb_vec3 places[PLACES], edge[2];
    sb_error error;
    int status = find_places(s, places);
    if (status)
        return status;
    s->skin = places[ENTRY];
    blade_at(w, s, 0, edge);
    return sb_cut_begin(s->cut, edge, 2, &s->stroke, &error) == SB_OK ? 0
                                                                      : complain_of(EXIT_SOLVE, "the blade", &error);
}

static int move_blade(const work *w, scene *s, double share)
{
    sb_vec3 edge[2];
    sb_cut_info info;
    sb_error error;
    blade_at(w, s, share, edge);
    if (sb_cut_move(s->cut, s->stroke, edge, &info, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, "the blade", &error);
    s->opened += (double)info.released_area;
    return 0;
}

/* Nodes of the flap within a distance of a place, for the grasper to hold. A number that the mesh has means the
 * material that was there; copies that the cut made belong to the other side. */
static void grip_within(const work *w, scene *s, sb_vec3 at, double radius)
{
    const sb_vec3 *x = sb_body_positions(s->body);
    s->grip_count = 0;
    for (int i = 0; i < w->organ.node_count && s->grip_count < MOST_GRIPPED; i++)
        if (sb_body_node_in_use(s->body, i) && is_of_flap(w, s->skin, x[i]) &&
            (double)sb_v3_norm(sb_v3_sub(x[i], at)) < radius) {
            s->grip[s->grip_count] = i;
            s->grip_at[s->grip_count++] = x[i];
        }
}

/* The grasper closes at the flap's edge on three nodes at least, and those that are not much farther. */
static int close_grasper(const work *w, scene *s)
{
    sb_vec3 at = sb_v3_madd(on_way(w, s->skin, w->mouth), REAL(-w->size * GRIP), w->aside);
    double reach = w->size * (BESIDE + WIDTH);
    sb_cut_end(s->cut, s->stroke);
    s->stroke = -1;
    for (double radius = 0.004 * w->size; s->grip_count < LEAST_GRIPPED && radius < 2 * reach; radius *= 1.3)
        grip_within(w, s, at, radius);
    return s->grip_count >= LEAST_GRIPPED ? 0
                                          : complain(EXIT_SOLVE, "the grasper", "finds no flap: it was pressed away");
}

static int lift_flap(const work *w, scene *s, double share)
{
    sb_error error;
    for (int k = 0; k < s->grip_count; k++) {
        sb_vec3 to = sb_v3_madd(s->grip_at[k], REAL(share * (2 * s->thickness + ROOM)), w->outward);
        if (sb_body_place(s->body, s->grip + k, 1, SB_XYZ, &to, &error) != SB_OK)
            return complain_of(EXIT_SOLVE, "the grasper", &error);
    }
    return 0;
}

static int open_grasper(scene *s)
{
    sb_error error;
    if (sb_body_release(s->body, s->grip, s->grip_count, SB_XYZ, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, "the grasper", &error);
    s->grip_count = 0;
    return 0;
}

/* Where the retractor is sent to: before the cut's mouth, `in` of the way in to its place under the flap, `up` of the
 * height that it rises by there. */
static sb_vec3 retractor_at(const work *w, const scene *s, double in, double up)
{
    double before = w->mouth - BEFORE, under = w->mouth + UNDER * (share_of_needle() - w->mouth);
    return sb_v3_madd(on_way(w, s->skin, before + in * (under - before)), REAL(s->thickness + CLEAR + up * RISE),
                      w->outward);
}

/* While the flap is lifted the retractor comes down before the cut's mouth; then it goes in, and rises where the
 * grasper lets go. */
static void move_retractor(const work *w, const scene *s, int step)
{
    int lift = step - steps_to_rest(w) - w->cut_steps, slide = lift - w->lift_steps, settle = slide - w->slide_steps;
    sb_pose pose;
    if (lift < 0)
        return;
    (void)sb_contact_reached(s->contact, s->retractor, &pose, NULL);
    if (slide < 0)
        pose.position = sb_v3_madd(pose.position, REAL(1.0 / (w->lift_steps - lift)),
                                   sb_v3_sub(retractor_at(w, s, 0, 0), pose.position));
    else
        pose.position = retractor_at(w, s, fmin(1, (slide + 1.0) / w->slide_steps),
                                     fmax(0, fmin(1, (settle + 1.0) / (0.5 * w->settle_steps))));
    (void)sb_contact_move_tool(s->contact, s->retractor, &pose);
}

/* What the grasper carries (N). */
static double feel_grasper(const work *w, const scene *s)
{
    double sum = 0;
    for (int k = 0; k < s->grip_count; k++)
        sum += (double)sb_v3_dot(sb_body_reactions(s->body)[s->grip[k]], w->outward);
    return sum;
}

static int open_organ(const work *w, scene *s, int step)
{
    int cut = step - steps_to_rest(w), lift = cut - w->cut_steps, status = 0;
    if (cut == 0)
        status = begin_cut(w, s);
    if (!status && cut >= 0 && lift < 0)
        status = move_blade(w, s, (cut + 1.0) / w->cut_steps);
    if (!status && lift == 0)
        status = close_grasper(w, s);
    if (!status && lift >= 0 && lift < w->lift_steps)
        status = lift_flap(w, s, (lift + 1.0) / w->lift_steps);
    if (!status && step == steps_to_under(w))
        status = open_grasper(s);
    move_retractor(w, s, step);
    return status;
}

/* ---- steps ----------------------------------------------------------------------------------------------------- */

static int note_step(work *w, int step)
{
    sb_vec3 force, tip = ndl_needle_tip(w->main.needle).position, target;
    if (find_target(&w->main, &target))
        return EXIT_SOLVE;
    ndl_needle_base_wrench(w->main.needle, &force, NULL);
    fprintf(w->csv.file, "%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n", (step + 1) * STEP,
            -(double)sb_v3_dot(force, w->direction), feel_probe(&w->main), 1e6 * w->main.opened,
            feel_grasper(w, &w->main), feel_retractor(w, &w->main), 1e3 * (double)ndl_needle_depth(w->main.needle),
            1e3 * (double)tip.x, 1e3 * (double)tip.y, 1e3 * (double)tip.z, 1e3 * (double)target.x,
            1e3 * (double)target.y, 1e3 * (double)target.z);
    return 0;
}

static int make_step(const work *w, scene *s, int step)
{
    ndl_command command;
    sb_error error;
    sb_vec3 target;
    char place[64];
    if (find_target(s, &target))
        return EXIT_SOLVE;
    command = command_at(w, s, target, step);
    move_probe(w, s, step);
    if (open_organ(w, s, step))
        return EXIT_SOLVE;
    if (ndl_step(s->body, &s->needle, 1, REAL(STEP), &command, NULL, &error) == SB_OK)
        return 0;
    snprintf(place, sizeof place, "step %d of the needle", step + 1);
    return complain_of(EXIT_SOLVE, place, &error);
}

/* Makes the steps [from, to) of the first scene, and writes what happens. */
static int make_steps(work *w, int from, int to, const char *words)
{
    int all = steps_to_held(w) + w->retract_steps, status = 0;
    char bar[80];
    for (int i = from; i < to && !status; i++) {
        status = make_step(w, &w->main, i);
        if (!status)
            status = note_step(w, i);
        snprintf(bar, sizeof bar, "%s, %.1f mm deep", words, 1e3 * (double)ndl_needle_depth(w->main.needle));
        progress_show(0.2 + 0.5 * i / all, bar);
    }
    return status;
}

/* ---- picture --------------------------------------------------------------------------------------------------- */

/* Of a fine skin that is cut the triangles that look away from the viewer, so that one sees into the organ. 0: no
 * memory. */
static int keep_far_side(const work *w, const sb_cut_drawing *d, const picture *p, sb_mesh *skin)
{
    picture_vec toward = picture_make_view(w->set->azimuth, w->set->elevation, p->width, p->height).toward;
    memset(skin, 0, sizeof *skin);
    skin->element_type = SB_TRI3;
    skin->node_count = d->vertex_count;
    skin->nodes = (sb_vec3 *)malloc((size_t)d->vertex_count * sizeof *skin->nodes);
    skin->elements = (int *)malloc((size_t)d->triangle_count * 3 * sizeof *skin->elements);
    if (!skin->nodes || !skin->elements)
        return 0;
    memcpy(skin->nodes, d->positions, (size_t)d->vertex_count * sizeof *skin->nodes);
    for (int f = 0; f < d->triangle_count; f++) {
        picture_vec corners[3];
        for (int k = 0; k < 3; k++)
            corners[k] = picture_from(d->positions[d->triangles[f][k]]);
        if (d->tags[f] == SB_CUT_SKIN && picture_dot(picture_face_normal(corners), toward) < 0)
            memcpy(skin->elements + 3 * (size_t)skin->element_count++, d->triangles[f], sizeof d->triangles[f]);
    }
    return 1;
}

/* The fine skin where the organ is now; coloured by how far (mm) it has moved. 0: no memory. */
static int draw_skin(const work *w, const sb_cut_drawing *d, picture *p, double *most)
{
    sb_mesh skin;
    sb_real *moved = (sb_real *)malloc((size_t)d->vertex_count * sizeof *moved);
    int good = keep_far_side(w, d, p, &skin) && moved;
    *most = 0;
    for (int i = 0; good && i < d->vertex_count; i++) {
        moved[i] = 1000 * sb_v3_norm(sb_v3_sub(d->positions[i], d->rest[i]));
        *most = fmax(*most, (double)moved[i]);
    }
    if (good)
        picture_add_surface(p, &skin, moved, 0, *most > 0 ? *most : 1);
    free(skin.nodes);
    free(skin.elements);
    free(moved);
    return good;
}

/* What the cut has laid open, up to the edges of the skin. */
static void draw_lips(const sb_cut_drawing *d, picture *p)
{
    for (int i = 0; i < d->triangle_count; i++) {
        const int *n = d->triangles[i];
        picture_triangle *t = d->tags[i] != SB_CUT_SKIN ? picture_new_triangle(p) : NULL;
        if (!t)
            continue;
        memset(t, 0, sizeof *t);
        t->is_plain = 1;
        t->colour = picture_web(0xb5403a);
        for (int k = 0; k < 3; k++) {
            t->corner[k] = picture_from(d->positions[n[k]]);
            t->normal[k] = picture_from(d->normals[n[k]]);
        }
    }
}

/* The organ's fine skin as it is cut, and its lips. 0: no memory. */
static int draw_organ(work *w, picture *p, double *most)
{
    sb_cut_fine *fine = NULL;
    sb_cut_fine_drawing d;
    int drawn;
    if (sb_cut_fine_create(w->main.cut, &w->skin, NULL, &fine, NULL) != SB_OK)
        return 0;
    d = sb_cut_fine_get(fine);
    w->open_edges = d.open_edges;
    drawn = draw_skin(w, &d.drawn, p, most);
    draw_lips(&d.drawn, p);
    sb_cut_fine_destroy(fine);
    return drawn;
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    const ndl_rod *rod = ndl_needle_rod(w->main.needle);
    const sb_vec3 *x = ndl_rod_positions(rod);
    char path[PATH_SIZE], text[160];
    double most;
    sb_vec3 target;
    sb_pose probe, bar;
    picture p;
    int result = PICTURE_NO_MEMORY;
    (void)sb_contact_reached(w->main.contact, w->main.probe, &probe, NULL);
    (void)sb_contact_reached(w->main.contact, w->main.retractor, &bar, NULL);
    picture_begin(&p, width, height);
    if (draw_organ(w, &p, &most) && !find_target(&w->main, &target)) {
        for (int i = 0; i < w->scan.count; i += 7)
            picture_add_capsule(&p, w->scan.points[i], w->scan.points[i], 0.0007, picture_web(0x0072b2));
        for (int i = 0; i + 1 < ndl_rod_node_count(rod); i++)
            picture_add_capsule(&p, x[i], x[i + 1], 0.0012, picture_web(i == 0 ? 0x3d4854 : 0x9aa5b1));
        picture_add_capsule(&p, target, target, 0.003, picture_web(0xd62728));
        picture_add_capsule(&p, probe.position, probe.position, w->main.round, picture_web(0x9aa5b1));
        picture_add_capsule(&p, sb_v3_madd(bar.position, REAL(-0.5 * w->size * BROAD), w->along),
                            sb_v3_madd(bar.position, REAL(0.5 * w->size * BROAD), w->along), w->main.thickness,
                            picture_web(0x3d4854));
        picture_render(&p, w->set->azimuth, w->set->elevation);
        picture_colour_bar(&p, "displacement", "mm", 0, most, most);
        picture_length_bar(&p);
        picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(),
                     "One body: registered, pressed, pierced, cut, held open");
        snprintf(text, sizeof text, "%.1f mm deep, %.2f mm from the target; %.0f mm^2 cut open",
                 1e3 * (double)ndl_needle_depth(w->main.needle), 1e3 * w->missed, 1e6 * w->main.opened);
        picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), text);
        picture_text(&p, 0.06 * width, 0.145 * height, 14, PICTURE_LEFT, picture_ink(),
                     "blue: the scan; light: the probe; dark: the retractor; red: lips of the cut");
        name_file(w, ".png", path);
        result = picture_save_png(&p, path);
    }
    picture_end(&p);
    if (result == PICTURE_NO_FILE)
        return complain(EXIT_USAGE, path, "cannot be written");
    return result == PICTURE_OK ? 0 : complain_memory();
}

/* ---- the run --------------------------------------------------------------------------------------------------- */

static int begin_all(work *w)
{
    char path[PATH_SIZE];
    sb_error error;
    int status = make_scene(w, &w->main);
    if (status)
        return status;
    if (sb_embedding_follow(w->embedding, w->main.body, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, "the embedded skin", &error);
    if (sb_recording_start(w->main.body, 0, NULL, &w->recording, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, "the recording", &error);
    name_file(w, ".csv", path);
    if (sb_output_open(&w->csv, path, &error) != SB_OK)
        return complain(EXIT_USAGE, path, "cannot be written");
    fprintf(w->csv.file, "t,push_N,probe_N,opened_mm2,flap_N,held_N,depth_mm,tip_x_mm,tip_y_mm,tip_z_mm,target_x_mm,"
                         "target_y_mm,target_z_mm\n");
    printf("organ          %d nodes, %d tets; skin of %d triangles; scan of %d points; held at %d nodes\n",
           w->organ.node_count, w->organ.element_count, w->skin.element_count, w->scan.count, w->held_count);
    fflush(stdout); /* before what may go wrong is said */
    return 0;
}

/* To half of its way, where the state is saved. */
static int insert_half(work *w)
{
    char path[PATH_SIZE];
    sb_error error;
    int status;
    plan_way(w);
    status = make_steps(w, 0, w->save_step, "goes in");
    if (status)
        return status;
    name_file(w, ".state", path);
    if (sb_body_state_save_file(w->main.body, path, &error) != SB_OK)
        return complain_of(EXIT_USAGE, path, &error);
    return 0;
}

static int insert_all(work *w)
{
    sb_vec3 target;
    int status = make_steps(w, w->save_step, steps_to_rest(w), "goes in");
    if (status)
        return status;
    if (find_target(&w->main, &target))
        return EXIT_SOLVE;
    w->missed = (double)sb_v3_norm(sb_v3_sub(target, ndl_needle_tip(w->main.needle).position));
    w->pressed = feel_probe(&w->main);
    progress_end();
    printf("at rest        %.2f mm from the target, the probe presses with %.2f N\n", 1e3 * w->missed, w->pressed);
    fflush(stdout);
    return 0;
}

static int cut_flap(work *w)
{
    double before = distance_across(&w->main);
    int status = make_steps(w, steps_to_rest(w), steps_to_under(w), "rests, the organ is cut across it");
    w->carried = feel_grasper(w, &w->main);
    if (!status)
        status = make_steps(w, steps_to_under(w), steps_to_held(w), "rests, the flap lies on the retractor");
    if (status)
        return status;
    w->reached = sb_body_state_hash(w->main.body);
    w->reached_tip = ndl_needle_tip(w->main.needle).position;
    w->opened = w->main.opened;
    w->borne = feel_retractor(w, &w->main);
    w->gap = distance_across(&w->main) - before;
    return draw_picture(w);
}

static int draw_out(work *w)
{
    int status = make_steps(w, steps_to_held(w), steps_to_held(w) + w->retract_steps, "goes out");
    w->out = !status && !(ndl_needle_depth(w->main.needle) > 0);
    return status;
}

/* A second scene goes on from the saved state to where the first one had lifted its flap. */
static int go_on_elsewhere(work *w)
{
    int end = steps_to_held(w), status = make_scene(w, &w->second);
    char path[PATH_SIZE];
    sb_error error;
    sb_vec3 tip;
    if (status)
        return status;
    name_file(w, ".state", path);
    if (sb_body_state_load_file(w->second.body, path, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, path, &error);
    for (int i = w->save_step; i < end && !status; i++) {
        status = make_step(w, &w->second, i);
        progress_show(0.7 + 0.15 * (i - w->save_step) / (end - w->save_step), "a second scene goes on");
    }
    if (status)
        return 0; /* it has not come as far: it differs */
    tip = ndl_needle_tip(w->second.needle).position;
    w->continued = sb_body_state_hash(w->second.body) == w->reached && memcmp(&tip, &w->reached_tip, sizeof tip) == 0;
    return 0;
}

/* The recording, from its file, on a third. */
static int play_again(work *w)
{
    sb_recording *loaded = NULL;
    sb_recording_report report;
    char path[PATH_SIZE];
    sb_error error;
    sb_result result;
    int status = make_scene(w, &w->third);
    if (status)
        return status;
    sb_recording_stop(w->recording);
    name_file(w, ".record", path);
    if (sb_recording_save_file(w->recording, path, &error) != SB_OK)
        return complain_of(EXIT_USAGE, path, &error);
    if (sb_recording_load_file(path, NULL, &loaded, &error) != SB_OK)
        return complain_of(EXIT_SOLVE, path, &error);
    progress_show(0.85, "the recording is played");
    result = sb_recording_replay(loaded, w->third.body, &report);
    w->replayed = result == SB_OK && sb_body_state_hash(w->third.body) == sb_body_state_hash(w->main.body);
    sb_recording_destroy(loaded);
    if (result != SB_OK)
        complain(0, path, report.error.message[0] ? report.error.message : "plays otherwise than it was recorded");
    return 0;
}

static int close_csv(work *w)
{
    char path[PATH_SIZE];
    name_file(w, ".csv", path);
    return !w->csv.file || sb_output_close(&w->csv, NULL) == SB_OK ? 0
                                                                   : complain(EXIT_USAGE, path, "cannot be written");
}

/* Results that came about, but not as they were asked for: 1 when there are some, and each is said. */
static int warn_of_results(const work *w)
{
    const settings *set = w->set;
    int far = 1e3 * w->missed > set->miss, fallen = !(w->borne > 0),
        weak = w->pressed<0.5 * set->press, strong = w->pressed> 2 * set->press;
    char words[200];
    if (far) {
        snprintf(words, sizeof words,
                 "the tip rests %.1f mm from it, over --miss %g: the needle pushes the organ before it (--friction, "
                 "--cutting, --young)",
                 1e3 * w->missed, set->miss);
        complain(0, "target", words);
    }
    if (weak || strong) {
        snprintf(words, sizeof words, "it presses with %.2f N, not --press %g: %s", w->pressed, set->press,
                 weak ? "the organ gives way" : "the organ is too stiff for its steps");
        complain(0, "probe", words);
    }
    if (fallen)
        complain(0, "retractor", "the flap does not lie on it");
    return far || weak || strong || fallen;
}

static int print_results(const work *w, double seconds)
{
    int doubtful = warn_of_results(w);
    progress_end();
    printf("written        %s.png, %s.csv, %s.state, %s.record\n", w->set->prefix, w->set->prefix, w->set->prefix,
           w->set->prefix);
    printf("registered_mm=%.3f ", 1e3 * w->registered);
    if (w->truth)
        printf("truth_mm=%.3f ", 1e3 * w->wrong);
    printf("target_mm=%.3f probe_N=%.3f opened_mm2=%.1f flap_N=%.3f held_N=%.3f gap_mm=%.2f open_edges=%d continued=%s "
           "replayed=%s "
           "needle=%s seconds=%.1f\n",
           1e3 * w->missed, w->pressed, 1e6 * w->opened, w->carried, w->borne, 1e3 * w->gap, w->open_edges,
           w->continued ? "same" : "differs", w->replayed ? "same" : "differs", w->out ? "out" : "in", seconds);
    if (!w->continued || !w->replayed || !w->out)
        return EXIT_DIFFERS;
    return doubtful ? (int)EXIT_DOUBTFUL : 0;
}

static void release(work *w)
{
    close_csv(w);
    sb_recording_destroy(w->recording);
    sb_embedding_destroy(w->embedding);
    free_scene(&w->main);
    free_scene(&w->second);
    free_scene(&w->third);
    reg_cloud_free(&w->scan);
    sb_mesh_free(&w->organ);
    sb_mesh_free(&w->skin);
    free(w->held);
    free(w->truth);
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_organ, make_skin,       hold_organ,  choose_way, get_scan,
                                            begin_all,  register_organ,  insert_half, insert_all, cut_flap,
                                            draw_out,   go_on_elsewhere, play_again,  close_csv};
    work w;
    int status = 0;
    double begin = seconds_now();
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    if (!status)
        status = print_results(&w, seconds_now() - begin);
    release(&w);
    return status;
}

static int check_settings(const settings *s)
{
    if (strlen(s->prefix) > PATH_SIZE - 64)
        return options_complain("one_body", "-o", "needs a shorter prefix");
    return 1;
}

static int program(int argc, char **argv)
{
    static settings s = {NULL, NULL, NULL, "one_body", 1, 5e3, 0.45, 10, 0.1, 0.2, 5, 3, 1, 0.3, -60, 20, 14, 120, 0};
    const option options[] = {
        {"--mesh", "FILE", OPTION_TEXT, NULL, NULL, &s.mesh, 0, 0,
         "organ of tet4; default one made here, like a liver"},
        {"--cells", "N", OPTION_INTEGER, &s.cells, NULL, NULL, 6, 60, "of the width of an organ made here"},
        {"--skin", "FILE", OPTION_TEXT, NULL, NULL, &s.skin, 0, 0,
         "fine surface of the organ; default the mesh's, or made"},
        {"--scan", "FILE", OPTION_TEXT, NULL, NULL, &s.scan, 0, 0,
         "points that were seen, in the organ's frame; default made here"},
        {"--scale", "S", OPTION_NUMBER, NULL, &s.scale, NULL, 1e-9, 1e9, "of the files' lengths, to metres"},
        {"--noise", "MM", OPTION_NUMBER, NULL, &s.noise, NULL, 0, 10, "of a scan made here"},
        {"--limit", "MM", OPTION_NUMBER, NULL, &s.limit, NULL, 0, 1000,
         "mean distance of the scan from a registered organ"},
        {"--miss", "MM", OPTION_NUMBER, NULL, &s.miss, NULL, 0, 1000, "from the target to where the tip rests at most"},
        {"--push", "N", OPTION_NUMBER, NULL, &s.push, NULL, 0, 100, "force that deforms the organ of a scan made here"},
        {"--press", "N", OPTION_NUMBER, NULL, &s.press, NULL, 0, 100, "force that the probe comes down to"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s.young, NULL, 100, 1e9, "of the organ"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s.poisson, NULL, 0, 0.49, "of the organ"},
        {"--friction", "N/M", OPTION_NUMBER, NULL, &s.friction, NULL, 0, 1000, "along the needle's shaft"},
        {"--cutting", "N", OPTION_NUMBER, NULL, &s.cutting, NULL, 0, 100, "force at the needle's tip"},
        {"--steps", "N", OPTION_INTEGER, &s.steps, NULL, NULL, 1, 1e6, "of the registration at most"},
        {"--azimuth", "DEG", OPTION_NUMBER, NULL, &s.azimuth, NULL, -360, 360, "of the picture"},
        {"--elevation", "DEG", OPTION_NUMBER, NULL, &s.elevation, NULL, -90, 90, "of the picture"},
        {"-o", "PREFIX", OPTION_TEXT, NULL, NULL, &s.prefix, 0, 0, "of the files' names"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("one_body", options, count, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: one_body [OPTIONS]\n\n"
               "Registers an organ to a scan, presses a probe on it, takes a needle in, cuts it across that, lifts\n"
               "the flap onto a retractor and draws the needle out: one body, saved on the way, recorded and played "
               "again.\n\n");
        options_print(options, count);
        return 0;
    }
    return check_settings(&s) ? run(&s) : (int)EXIT_USAGE;
}

int main(int argc, char **argv) { return finish("one_body", program(argc, argv), EXIT_USAGE); }
