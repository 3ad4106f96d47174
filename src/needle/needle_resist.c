/* needle_resist: what the tissue does to a needle: friction along it, forces that its tip must cut with. */
#include "needle_private.h"

#include <string.h>

/* ---- membranes ---- */

/* The undeformed mesh that membranes lie in. */
typedef struct ndli_resist_mesh {
    const struct ndli_site *site;
    sb_element_type type;
    int count, node_count;
    const int *elements, *neighbours;
    sb_vec3 *X; /* read only */
} ndli_resist_mesh;

static ndli_resist_mesh ndli_resist_get_mesh(const struct ndli_site *site)
{
    const ndli_topology *topology = site->mesh;
    const sb_mesh *rest = &site->bed.mesh;
    ndli_resist_mesh mesh;
    mesh.site = site;
    mesh.type = topology ? SB_TET4 : rest->element_type;
    mesh.count = topology ? topology->original_tets : rest->element_count;
    mesh.node_count = topology ? topology->original_nodes : rest->node_count;
    mesh.elements = topology ? topology->tets : rest->elements;
    mesh.neighbours = topology ? topology->neighbours : site->bed.volume.neighbours.items;
    mesh.X = topology ? topology->X0 : rest->nodes;
    return mesh;
}

static int ndli_resist_region(const ndli_resist_mesh *mesh, int element)
{
    const struct ndli_site *site = mesh->site;
    if (element < 0)
        return -1;
    return site->mesh ? site->mesh->regions[element] : sbi_body_cell_region(site->body, site->bed.cells[element]);
}

/* 1 when the membrane lies on a face; each inner face is looked at from its lower element. */
static int ndli_resist_holds(const ndli_resist_mesh *mesh, const ndl_membrane *membrane, int element, int face)
{
    int faces = sb_element_face_count(mesh->type);
    int other = mesh->neighbours[(size_t)faces * (size_t)element + (size_t)face];
    int a = ndli_resist_region(mesh, element), b = ndli_resist_region(mesh, other);
    if (other > element)
        return 0;
    return (a == membrane->regions[0] && b == membrane->regions[1]) ||
           (b == membrane->regions[0] && a == membrane->regions[1]);
}

/* Corners of a face, as who numbered the neighbours has them; returns how many. */
static int ndli_resist_face(const ndli_resist_mesh *mesh, int face, int local[SB_MAX_FACE_NODES])
{
    static const int opposite[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}; /* of the topology */
    sb_element_type type;
    if (mesh->site->mesh) {
        memcpy(local, opposite[face], sizeof opposite[face]);
        return 3;
    }
    sb_element_face(mesh->type, face, local, &type);
    return sb_element_corner_count(type);
}

/* Faces of the membrane, as triangles between their corners: written to `triangles` when that is not NULL. */
static int ndli_resist_gather(const ndli_resist_mesh *mesh, const ndl_membrane *membrane, int *triangles)
{
    size_t width = (size_t)sb_element_node_count(mesh->type);
    int count = 0;
    for (int e = 0; e < mesh->count; e++)
        for (int face = 0; face < sb_element_face_count(mesh->type); face++) {
            int local[SB_MAX_FACE_NODES], parts;
            if (!ndli_resist_holds(mesh, membrane, e, face))
                continue;
            parts = ndli_resist_face(mesh, face, local) - 2;
            for (int part = 0; part < parts; part++, count++)
                for (int c = 0; c < 3 && triangles; c++)
                    triangles[3 * (size_t)count + (size_t)c] =
                        mesh->elements[width * (size_t)e + (size_t)local[c == 0 ? 0 : part + c]];
        }
    return count;
}

static sb_result ndli_resist_make_surface(const ndl_needle *needle, const ndl_membrane *membrane, sb_surface **surface)
{
    ndli_resist_mesh mesh = ndli_resist_get_mesh(needle->site);
    sb_mesh faces;
    sb_result result;
    int count = ndli_resist_gather(&mesh, membrane, NULL);
    if (count == 0)
        return SB_ERROR_ARGUMENT;
    memset(&faces, 0, sizeof faces);
    faces.element_type = SB_TRI3;
    faces.nodes = mesh.X;
    faces.node_count = mesh.node_count;
    faces.elements = (int *)sbi_alloc(&needle->allocator, (size_t)count, 3 * sizeof(int));
    if (!faces.elements)
        return SB_ERROR_MEMORY;
    faces.element_count = ndli_resist_gather(&mesh, membrane, faces.elements);
    result = sb_surface_create(&faces, &needle->allocator, surface, NULL);
    sbi_free(&needle->allocator, faces.elements);
    return result;
}

NDLI_API int ndli_needle_make_capsules(ndl_needle *needle, const ndl_membrane *membranes, int count, int *bad)
{
    *bad = -1;
    for (int i = 0; i < count; i++) {
        sb_result result = ndli_resist_make_surface(needle, membranes + i, &needle->capsules[i].surface);
        if (result != SB_OK) {
            *bad = result == SB_ERROR_MEMORY ? -1 : i;
            return 0;
        }
        needle->capsules[i].def = membranes[i];
        needle->capsule_count = i + 1;
    }
    return 1;
}

/* ---- friction ---- */

NDLI_API const ndl_friction *ndli_needle_friction(const ndl_needle *needle, int region)
{
    int i = needle->friction_count == 1 ? 0 : region;
    return i >= 0 && i < needle->friction_count ? needle->frictions + i : NULL;
}

/* Mean over the tets of a tissue node, by volume. */
static void ndli_resist_at(const ndl_needle *needle, int node, double mean[5])
{
    const ndli_topology *mesh = needle->site->mesh;
    double total = 0;
    memset(mean, 0, 5 * sizeof *mean);
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        const ndl_friction *f = ndli_needle_friction(needle, mesh->regions[k / 4]);
        double volume = (double)mesh->volumes[k / 4];
        total += volume;
        if (!f)
            continue;
        mean[0] += volume * (double)f->friction;
        mean[1] += volume * (double)f->viscous;
        mean[2] += volume * (double)f->cutting;
        mean[3] += volume * (double)f->twist_stiffness;
        mean[4] += volume * (double)f->twist_friction;
    }
    for (int i = 0; i < 5 && total > 0; i++)
        mean[i] /= total;
}

/* ---- cutting ---- */

/* The region that the tip looks into. */
static int ndli_resist_region_ahead(const ndl_needle *needle, int tip)
{
    const ndli_topology *mesh = needle->site->mesh;
    sb_vec3 t = ndli_to(needle->rod->tangent[needle->rod->node_count - 2]);
    sb_real best = -SB_REAL_MAX;
    int region = -1;
    for (int k = mesh->node_star[tip]; k >= 0; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_vec3 sum = sb_v3_add(sb_v3_add(mesh->x[n[0]], mesh->x[n[1]]), sb_v3_add(mesh->x[n[2]], mesh->x[n[3]]));
        sb_vec3 way = sb_v3_sub(sb_v3_scale((sb_real)0.25, sum), mesh->x[tip]);
        sb_real ahead = sb_v3_dot(way, t) / sb_v3_norm(way);
        if (ahead > best) {
            best = ahead;
            region = mesh->regions[k / 4];
        }
    }
    return region;
}

static double ndli_resist_membranes(const ndl_needle *needle, sb_vec3 X)
{
    double sum = 0;
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndli_capsule *capsule = needle->capsules + i;
        sb_surface_hit hit;
        if (sb_surface_closest(capsule->surface, X, capsule->def.thickness / 2, &hit))
            sum += (double)capsule->def.strength;
    }
    return sum;
}

NDLI_API double ndli_needle_cutting_at(const ndl_needle *needle, sb_vec3 X, int region, double table)
{
    if (needle->cutting_at) {
        sb_real force = needle->cutting_at(needle->cutting_user, X, region);
        return force > 0 && sb_is_finite(force) ? (double)force : 0;
    }
    return table + ndli_resist_membranes(needle, X);
}

static double ndli_resist_cutting(const ndl_needle *needle, int tip, double table)
{
    sb_vec3 X;
    ndl_needle_tip_material(needle, &X);
    return ndli_needle_cutting_at(needle, X, needle->cutting_at ? ndli_resist_region_ahead(needle, tip) : 0, table);
}

/* A tip that comes near the skin from inside is stopped: nothing can follow it out, and tets ahead of it get flat. */
static int ndli_resist_is_at_skin(const ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    int tip;
    sb_real ahead = (sb_real)(0.2 * needle->site->mean_edge);
    sb_vec3 way;
    if (needle->shallow || needle->line.count < 2)
        return 0;
    tip = needle->path[needle->line.count - 1];
    way = sb_v3_sub(mesh->X[tip], mesh->X[needle->path[needle->line.count - 2]]);
    return ndli_topology_find(mesh, mesh->X, sb_v3_madd(mesh->X[tip], ahead / sb_v3_norm(way), way),
                              mesh->node_star[tip] / 4, NULL) < 0;
}

/* What the tip has to cut, or what nothing can overcome. */
static void ndli_resist_tip(ndl_needle *needle, int tip, double table)
{
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    line->cutting = ndli_resist_cutting(needle, tip, table);
    if (needle->hold_steps == 0 && !ndli_resist_is_at_skin(needle))
        return;
    needle->blocked = 1;
    line->cutting = (double)SB_REAL_MAX;
    if (line->state[last] == NDL_DYNAMIC_FORWARD)
        line->state[last] = NDL_STATIC;
}

/* ---- all of it ---- */

NDLI_API void ndli_needle_resist(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line), ends = rod->node_count - 1;
    double before[5] = {0, 0, 0, 0, 0}, here[5];
    line->cutting = 0;
    for (int i = line->first; i <= last; i++) {
        int tip = needle->path[i - line->first];
        double behind = i > line->first ? ndli_norm(ndli_sub(rod->x[i], rod->x[i - 1])) : 0;
        double ahead = i < ends ? ndli_norm(ndli_sub(rod->x[i + 1], rod->x[i])) : 0;
        double length = 0.5 * (behind + ahead) + (i == last ? 0.5 * ahead : 0); /* a shallow tip has no node */
        ndli_resist_at(needle, tip, here);
        line->friction[i] = length * here[0];
        line->viscous[i] = length * here[1];
        if (i == last && i < ends)
            ndl_rod_set_grip(rod, i, (sb_real)(ahead * here[3]), (sb_real)(ahead * here[4]));
        if (i == last)
            ndli_resist_tip(needle, tip, here[2]);
        if (i > line->first)
            ndl_rod_set_grip(rod, i - 1, (sb_real)(0.5 * behind * (before[3] + here[3])),
                             (sb_real)(0.5 * behind * (before[4] + here[4])));
        memcpy(before, here, sizeof before);
    }
    for (int j = 0; j < sbi_min_int(line->first, ends); j++)
        ndl_rod_set_grip(rod, j, 0, 0);
}
