/* needle: making and releasing needles. */
#include "needle_private.h"

#include "../softbody/body/body_guest.h"
#include "../softbody/body/step_touch.h"

#include <limits.h>
#include <string.h>

/* ---- definition ---- */

enum { NDLI_NEEDLE_COOKIE = 0x6e646c65, NDLI_LEAST_NODES = 8 };

NDL_API ndl_needle_def ndl_default_needle_def(void)
{
    ndl_needle_def def;
    memset(&def, 0, sizeof def);
    def.follow = NDL_EMBED;
    def.length = (sb_real)0.05;
    def.capacity = 128;
    ndl_rod_section_preset(NDL_STYLET_18G, &def.section);
    def.damping_stretch = def.damping_bending = (sb_real)1e-4;
    def.bevel.law = NDL_BEVEL_CURVATURE;
    def.bevel.guide = (sb_real)0.005;
    def.bevel.lag = (sb_real)0.1;
    def.entry_slip = NDLI_ENTRY_SLIP;
    def.max_trials = 10;
    def.cookie = NDLI_NEEDLE_COOKIE;
    return def;
}

static sb_result ndli_needle_check_frictions(const ndl_needle_def *def, sb_error *error)
{
    if (def->friction_count < 0 || (def->friction_count > 0 && !def->frictions))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "frictions has no entries");
    for (int i = 0; i < def->friction_count; i++) {
        const ndl_friction *f = def->frictions + i;
        const sb_real values[5] = {f->friction, f->viscous, f->cutting, f->twist_stiffness, f->twist_friction};
        static const char *const names[5] = {"friction", "viscous", "cutting", "twist_stiffness", "twist_friction"};
        for (int k = 0; k < 5; k++)
            if (!sb_is_finite(values[k]) || values[k] < 0)
                return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of region %d is %g, not 0 or more", names[k], i,
                                (double)values[k]);
    }
    return SB_OK;
}

static sb_result ndli_needle_check_membranes(const ndl_needle_def *def, sb_error *error)
{
    if (def->membrane_count < 0 || (def->membrane_count > 0 && !def->membranes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "membranes has no entries");
    for (int i = 0; i < def->membrane_count; i++) {
        const ndl_membrane *m = def->membranes + i;
        if (!sb_is_finite(m->strength) || m->strength < 0 || !(m->thickness > 0) || !sb_is_finite(m->thickness))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "membrane %d has strength %g and thickness %g", i,
                            (double)m->strength, (double)m->thickness);
        if (m->regions[0] == m->regions[1])
            return sbi_fail(error, SB_ERROR_ARGUMENT, "membrane %d has region %d on both sides", i, m->regions[0]);
    }
    return SB_OK;
}

/* Ways of a bevel turn by two radians at most within an edge. */
static sb_result ndli_needle_check_bevel(const ndl_needle_def *def, double edge, sb_error *error)
{
    const ndl_bevel *bevel = &def->bevel;
    sb_real curvature;
    sb_result result =
        ndl_bevel_curvature(bevel, 0, bevel->law == NDL_BEVEL_ANGLE ? bevel->guide : (sb_real)edge, &curvature);
    if (result == SB_OK && (!(bevel->lag > 0) || !(fabs((double)curvature) * edge <= 2)))
        result = SB_ERROR_ARGUMENT;
    if (result != SB_OK)
        return sbi_fail(error, result, "bevel: law %d, angle %g, guide %g, curvature %g, lag %g with edges of %g m",
                        (int)bevel->law, (double)bevel->angle, (double)bevel->guide, (double)bevel->curvature,
                        (double)bevel->lag, edge);
    return SB_OK;
}

static sb_result ndli_needle_check(const ndl_needle_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != NDLI_NEEDLE_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def was not made by ndl_default_needle_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "body is NULL");
    if (!sbi_body_is_implicit(def->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "needles need implicit steps: the body's integrator is explicit");
    if (!sb_v3_is_finite(def->base) || !sb_v3_is_finite(def->direction) || !sb_v3_is_finite(def->director) ||
        !sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "base, direction, director or gravity is not finite");
    if (!(sb_v3_norm(def->direction) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "direction has no length");
    if (!(def->length > 0) || !sb_is_finite(def->length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "length is %g, not above 0", (double)def->length);
    if (!(def->edge_length >= 0) || !sb_is_finite(def->edge_length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "edge_length is %g, not 0 or more", (double)def->edge_length);
    if (def->capacity < NDLI_LEAST_NODES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "capacity is %d, below %d", def->capacity, (int)NDLI_LEAST_NODES);
    if (!(def->bend_length >= 0) || !(def->bend_length < def->length) || !sb_is_finite(def->bend_curvature) ||
        sb_abs(def->bend_curvature) * def->bend_length > 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "bend_length is %g and bend_curvature %g", (double)def->bend_length,
                        (double)def->bend_curvature);
    if (!(def->entry_slip >= 0) || !(def->entry_slip <= NDLI_ENTRY_SLIP))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "entry_slip is %g, not in [0, %g]", (double)def->entry_slip,
                        (double)NDLI_ENTRY_SLIP);
    if (def->max_trials < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_trials is %d", def->max_trials);
    if (def->follow != NDL_REMESH && def->follow != NDL_EMBED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "follow is %d", (int)def->follow);
    result = ndli_needle_check_frictions(def, error);
    return result == SB_OK ? ndli_needle_check_membranes(def, error) : result;
}

/* ---- the site ---- */

/* The remesher's part of the state comes first: its name does, too. */
static sb_result ndli_site_make_remesh(struct ndli_site *site, sb_error *error)
{
    ndl_remesh_def def = ndl_default_remesh_def();
    sb_result result;
    def.allocator = site->allocator;
    def.body = site->body;
    def.max_needles = NDL_MAX_NEEDLES;
    result = ndl_remesh_create(&def, &site->remesh, error);
    if (result != SB_OK)
        return result;
    site->mesh = ndli_remesh_topology(site->remesh);
    site->mean_edge = ndli_site_mean_edge(site->mesh);
    return SB_OK;
}

static sb_result ndli_site_make_bed(struct ndli_site *site, sb_error *error)
{
    sb_result result = ndli_site_create_bed(site, &site->bed, error);
    if (result == SB_OK)
        site->mean_edge = site->bed.mean_edge;
    return result;
}

/* Something touches the body that did not when its needles were made. */
static int ndli_site_reserve_kept(void *user) { return ndli_needle_reserve_undo((struct ndli_site *)user, NULL); }

static sb_result ndli_site_fill(struct ndli_site *site, sb_error *error)
{
    sbi_state_part part = ndli_site_part(site);
    sbi_touch_keeper keeper;
    sb_result result = site->embeds ? ndli_site_make_bed(site, error) : ndli_site_make_remesh(site, error);
    part.replay = ndli_needle_replay;
    if (result != SB_OK)
        return result;
    result = ndli_site_listen(site, error);
    if (result == SB_OK)
        result = sbi_body_join(site->body, &part, error);
    keeper.user = site;
    keeper.reserve = ndli_site_reserve_kept;
    if (result == SB_OK)
        sbi_body_set_touch_keeper(site->body, &keeper);
    return result;
}

static void ndli_site_end(struct ndli_site *site)
{
    sbi_body_set_touch_keeper(site->body, NULL);
    ndli_site_leave(site);
    ndli_site_free(site);
}

/* The site of a body, made if there is none yet. */
static sb_result ndli_site_make(const ndl_needle_def *def, struct ndli_site **site, sb_error *error)
{
    sb_body *body = def->body;
    const sb_allocator *allocator = sbi_body_allocator(body);
    struct ndli_site *made = ndli_needle_site(body);
    sb_result result;
    if (made && made->embeds != (def->follow == NDL_EMBED))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the body's other needles are held the other way: see def.follow");
    if (made) {
        *site = made;
        return ndli_needle_look(made, error);
    }
    made = (struct ndli_site *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the needles of a body");
    made->body = body;
    made->embeds = def->follow == NDL_EMBED;
    made->allocator = *allocator;
    result = ndli_site_fill(made, error);
    if (result != SB_OK)
        ndli_site_end(made);
    else
        *site = made;
    return result;
}

/* ---- creation ---- */

/* Length of the bends that the body's tissue makes of a needle (m). */
static double ndli_needle_wave(const struct ndli_site *site, const ndl_needle_def *def)
{
    ndl_rod_stiffness stiffness = def->stiffness ? *def->stiffness : ndl_rod_stiffness_of(&def->section);
    double bending = 0.5 * ((double)stiffness.bending[0] + (double)stiffness.bending[1]);
    return ndli_held_wave(bending, (double)def->section.radius, (double)sbi_body_young(site->body), site->mean_edge);
}

/* Edges of a rod that springs hold are short beside the bends that these make. */
static double ndli_needle_usual_edge(const struct ndli_site *site, const ndl_needle_def *def)
{
    double most = site->mean_edge, least = most / 8;
    return site->embeds ? fmin(fmax(0.125 * ndli_needle_wave(site, def), least), most) : most;
}

/* The shape at rest: straight, then a circle towards m2. */
static void ndli_needle_rest_nodes(const ndl_needle_def *def, int edges, double sleeve, sb_vec3 *nodes)
{
    ndl_tip_pose pose;
    sb_real straight = def->length - def->bend_length;
    ndli_v3 t = ndli_from(def->direction);
    t = ndli_scale(1 / ndli_norm(t), t);
    pose.frame.t = ndli_to(t);
    pose.frame.m1 = ndli_to(ndli_rod_across(ndli_from(def->director), t));
    pose.frame.m2 = sb_v3_cross(pose.frame.t, pose.frame.m1);
    nodes[0] = sb_v3_madd(def->base, (sb_real)-sleeve, pose.frame.t);
    pose.position = sb_v3_madd(def->base, straight, pose.frame.t);
    for (int i = 0; i <= edges; i++) {
        sb_real s = def->length * (sb_real)i / (sb_real)edges;
        nodes[i + 1] = sb_v3_madd(def->base, s, pose.frame.t);
        if (s > straight)
            nodes[i + 1] = ndl_helix_pose(&pose, def->bend_curvature, 0, s - straight).position;
    }
}

static sb_result ndli_needle_make_rod(ndl_needle *needle, const ndl_needle_def *def, sb_error *error)
{
    ndl_rod_def rod = ndl_default_rod_def();
    double wanted = (double)def->length / needle->edge_length;
    sb_vec3 *nodes;
    sb_result result;
    int edges;
    if (!(wanted < def->capacity - 3))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "capacity is %d, too little for %g m by edges of %g m", def->capacity,
                        (double)def->length, needle->edge_length);
    edges = sbi_max_int(2, (int)(wanted + 0.999));
    nodes = (sb_vec3 *)sbi_alloc(&def->allocator, (size_t)edges + 2, sizeof(sb_vec3));
    if (!nodes)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle");
    ndli_needle_rest_nodes(def, edges, needle->edge_length, nodes);
    rod.nodes = nodes;
    rod.node_count = edges + 2;
    rod.capacity = def->capacity;
    rod.section = def->section;
    rod.stiffness = def->stiffness;
    rod.rest = def->bend_length > 0 && def->bend_curvature != 0 ? NDL_REST_SHAPE : NDL_REST_STRAIGHT;
    rod.director = def->director;
    rod.gravity = def->gravity;
    rod.damping_stretch = def->damping_stretch;
    rod.damping_bending = def->damping_bending;
    rod.allocator = def->allocator;
    result = ndl_rod_create(&rod, &needle->rod, error);
    sbi_free(&def->allocator, nodes);
    return result;
}

static void ndli_needle_layout(ndl_needle *needle, const ndl_needle_def *def, sbi_arena *arena)
{
    size_t n = (size_t)def->capacity;
    needle->places = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->place_tangents = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->frictions = (ndl_friction *)sbi_arena_take(arena, (size_t)def->friction_count, sizeof(ndl_friction));
    needle->capsules = (ndli_capsule *)sbi_arena_take(arena, (size_t)def->membrane_count, sizeof(ndli_capsule));
    if (def->follow == NDL_EMBED) {
        needle->arc = (double *)sbi_arena_take(arena, n, sizeof(double));
        needle->stretch = (double *)sbi_arena_take(arena, n, sizeof(double));
        needle->holds = (struct ndli_hold *)sbi_arena_take(arena, n, sizeof(struct ndli_hold));
        needle->track.capacity = (int)(NDLI_TRACK_POINTS * n);
        needle->track.X = (ndli_v3 *)sbi_arena_take(arena, NDLI_TRACK_POINTS * n, sizeof(ndli_v3));
        needle->track.arc = (double *)sbi_arena_take(arena, NDLI_TRACK_POINTS * n, sizeof(double));
        needle->track.elements = (int *)sbi_arena_take(arena, NDLI_TRACK_POINTS * n, sizeof(int));
    }
    needle->gap = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->old_gap = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->old_X = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    needle->path = (int *)sbi_arena_take(arena, n, sizeof(int));
    needle->old_contact = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->old_path = (int *)sbi_arena_take(arena, n, sizeof(int));
    needle->old_state = (unsigned char *)sbi_arena_take(arena, n, 1);
}

static sb_result ndli_needle_make_memory(ndl_needle *needle, const ndl_needle_def *def, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    ndli_needle_layout(needle, def, &arena);
    needle->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&def->allocator, 1, arena.used);
    if (!needle->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", def->capacity);
    arena.base = (unsigned char *)needle->memory;
    arena.used = 0;
    ndli_needle_layout(needle, def, &arena);
    if (!ndli_line_create(&needle->line, needle->rod, &def->allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", def->capacity);
    needle->line.path = needle->path;
    needle->line.holds = needle->holds;
    return SB_OK;
}

/* A needle begins outside: neither its tip nor a crossing of the skin is in the tissue. */
static sb_result ndli_needle_check_outside_bed(const ndl_needle *needle, sb_error *error)
{
    const ndli_bed *bed = &needle->site->bed;
    const ndl_rod *rod = needle->rod;
    ndli_place place;
    sb_vec3 at;
    for (int i = 1; i < rod->node_count; i++)
        if (ndli_bed_hit(bed, ndli_to(rod->x[i - 1]), ndli_to(rod->x[i]), &place, &at) ||
            ndli_bed_hit(bed, ndli_to(rod->x[i]), ndli_to(rod->x[i - 1]), &place, &at))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's edge %d crosses the tissue's skin already", i - 1);
    return ndli_bed_holds_in_space(bed, ndli_to(rod->x[rod->node_count - 1]))
               ? sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's tip is in the tissue already")
               : SB_OK;
}

static sb_result ndli_needle_check_outside(const ndl_needle *needle, sb_error *error)
{
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    sb_vec3 tip = ndli_to(rod->x[rod->node_count - 1]);
    ndl_surface_hit hit;
    for (int i = 1; i < rod->node_count; i++) /* inwards, or outwards from a sleeve within */
        if (ndli_topology_hit(mesh, ndli_to(rod->x[i - 1]), ndli_to(rod->x[i]), &hit) ||
            ndli_topology_hit(mesh, ndli_to(rod->x[i]), ndli_to(rod->x[i - 1]), &hit))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's edge %d crosses the tissue's skin already", i - 1);
    for (int t = 0; t < mesh->tet_end; t++)
        if (mesh->tets[4 * (size_t)t] >= 0)
            return ndli_topology_find(mesh, mesh->x, tip, t, NULL) < 0
                       ? SB_OK
                       : sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's tip is in the tissue already");
    return SB_OK;
}

static void ndli_needle_fill(ndl_needle *needle, const ndl_needle_def *def)
{
    const ndl_rod *rod = needle->rod;
    needle->bevel = def->bevel;
    if (def->friction_count)
        memcpy(needle->frictions, def->frictions, (size_t)def->friction_count * sizeof(ndl_friction));
    needle->friction_count = def->friction_count;
    needle->cutting_at = def->cutting;
    needle->cutting_user = def->cutting_user;
    needle->max_trials = def->max_trials;
    needle->entry_slip = def->entry_slip;
    needle->wave = ndli_needle_wave(needle->site, def);
    needle->outlet = rod->x[1];
    needle->axis = rod->tangent[0];
    needle->line.first = rod->node_count;
}

static sb_result ndli_needle_build(ndl_needle *needle, struct ndli_site *site, const ndl_needle_def *def,
                                   sb_error *error)
{
    sb_result result;
    int bad;
    needle->allocator = def->allocator;
    needle->site = site;
    needle->radius = (double)def->section.radius;
    needle->edge_length = def->edge_length > 0 ? (double)def->edge_length : ndli_needle_usual_edge(site, def);
    needle->track.spacing = needle->edge_length / (int)NDLI_TRACK_POINTS;
    result = ndli_needle_check_bevel(def, needle->edge_length, error);
    if (result == SB_OK)
        result = ndli_needle_make_rod(needle, def, error);
    if (result == SB_OK)
        result = ndli_needle_make_memory(needle, def, error);
    if (result == SB_OK)
        result = site->embeds ? ndli_needle_check_outside_bed(needle, error) : ndli_needle_check_outside(needle, error);
    if (result != SB_OK)
        return result;
    if (!ndli_needle_make_capsules(needle, def->membranes, def->membrane_count, &bad))
        return bad < 0 ? sbi_fail(error, SB_ERROR_MEMORY, "no memory for a membrane")
                       : sbi_fail(error, SB_ERROR_ARGUMENT, "membrane %d: no face lies between regions %d and %d", bad,
                                  def->membranes[bad].regions[0], def->membranes[bad].regions[1]);
    ndli_needle_fill(needle, def);
    needle->index = ndli_site_free_index(site);
    result = site->embeds ? SB_OK : ndl_remesh_reserve(site->remesh, needle->index, def->capacity, error);
    if (result == SB_OK && !(ndli_site_reserve(site, def->capacity) && ndli_needle_reserve_undo(site, needle)))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", def->capacity);
    if (result == SB_OK && site->node_room > (size_t)(INT_MAX / NDLI_LINE_UNKNOWNS))
        return sbi_fail(error, SB_ERROR_MEMORY, "capacities of all needles are over %d nodes",
                        INT_MAX / NDLI_LINE_UNKNOWNS);
    return result == SB_OK ? sbi_body_reserve_guest(site->body, NDLI_LINE_UNKNOWNS * (int)site->node_room,
                                                    (int)site->coupled_room, error)
                           : result;
}

static void ndli_needle_release(ndl_needle *needle)
{
    sb_allocator allocator = needle->allocator;
    for (int i = 0; i < needle->capsule_count; i++)
        sb_surface_destroy(needle->capsules[i].surface);
    ndli_line_free(&needle->line);
    ndl_rod_destroy(needle->rod);
    sbi_free(&allocator, needle->memory);
    sbi_free(&allocator, needle);
}

static void ndli_needle_join(ndl_needle *needle)
{
    needle->site->needles[needle->index] = needle;
    needle->site->count++;
}

NDL_API sb_result ndl_needle_create(const ndl_needle_def *def, ndl_needle **needle, sb_error *error)
{
    struct ndli_site *site = NULL;
    ndl_needle *made;
    sb_result result;
    if (!def || !needle)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or needle is NULL");
    result = ndli_needle_check(def, error);
    if (result == SB_OK)
        result = ndli_site_make(def, &site, error);
    if (result == SB_OK)
        result = ndli_needle_finish_undo(site, error);
    if (result != SB_OK)
        return result;
    if (site->count == NDL_MAX_NEEDLES)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the body has %d needles already", (int)NDL_MAX_NEEDLES);
    made = (ndl_needle *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    result =
        made ? ndli_needle_build(made, site, def, error) : sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle");
    if (result == SB_OK) {
        ndli_needle_join(made);
        ndli_needle_tell_life(made, NDLI_COMMAND_NEEDLE_MADE);
        *needle = made;
        return SB_OK;
    }
    if (made)
        ndli_needle_release(made);
    if (site->count == 0)
        ndli_site_end(site);
    return result;
}

NDL_API void ndl_needle_destroy(ndl_needle *needle)
{
    struct ndli_site *site;
    if (!needle)
        return;
    site = needle->site;
    (void)ndli_needle_finish_undo(site, NULL);
    site->undo_waits = 0; /* what is kept is of all needles: from here on it fits no more */
    ndli_needle_tell_life(needle, NDLI_COMMAND_NEEDLE_GONE);
    sbi_body_mute(site->body);
    if (!site->embeds)
        ndli_remesh_let_go(site->remesh, needle->index);
    sbi_body_unmute(site->body);
    site->needles[needle->index] = NULL;
    if (--site->count == 0)
        ndli_site_end(site);
    ndli_needle_release(needle);
}
