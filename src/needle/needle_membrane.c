/* needle_membrane: faces between regions that take more force to puncture: where they are, what they add to what the
 * tip has to cut, and where on its way that changes. A step ends a substep there: a tip that runs through a membrane
 * within one step would never feel it. One that ends soon after needs none: what the tip feels of the membrane begins
 * or ends less than a step later, and is as much. */
#include "needle_private.h"

#include <string.h>

/* ---- the faces ---- */

/* The undeformed mesh that membranes lie in. */
typedef struct ndli_membrane_mesh {
    const struct ndli_site *site;
    sb_element_type type;
    int count, node_count;
    const int *elements, *neighbours;
    sb_vec3 *X; /* read only */
} ndli_membrane_mesh;

static ndli_membrane_mesh ndli_membrane_get_mesh(const struct ndli_site *site)
{
    const ndli_topology *topology = site->mesh;
    const sb_mesh *rest = &site->bed.mesh;
    ndli_membrane_mesh mesh;
    mesh.site = site;
    mesh.type = topology ? SB_TET4 : rest->element_type;
    mesh.count = topology ? topology->original_tets : rest->element_count;
    mesh.node_count = topology ? topology->original_nodes : rest->node_count;
    mesh.elements = topology ? topology->tets : rest->elements;
    mesh.neighbours = topology ? topology->neighbours : site->bed.volume.neighbours.items;
    mesh.X = topology ? topology->X0 : rest->nodes;
    return mesh;
}

static int ndli_membrane_region(const ndli_membrane_mesh *mesh, int element)
{
    const struct ndli_site *site = mesh->site;
    if (element < 0)
        return -1;
    return site->mesh ? site->mesh->regions[element] : sbi_body_cell_region(site->body, site->bed.cells[element]);
}

/* 1 when the membrane lies on a face; each inner face is looked at from its lower element. */
static int ndli_membrane_holds(const ndli_membrane_mesh *mesh, const ndl_membrane *membrane, int element, int face)
{
    int faces = sb_element_face_count(mesh->type);
    int other = mesh->neighbours[(size_t)faces * (size_t)element + (size_t)face];
    int a = ndli_membrane_region(mesh, element), b = ndli_membrane_region(mesh, other);
    if (other > element)
        return 0;
    return (a == membrane->regions[0] && b == membrane->regions[1]) ||
           (b == membrane->regions[0] && a == membrane->regions[1]);
}

/* Corners of a face, as who numbered the neighbours has them; returns how many. */
static int ndli_membrane_face(const ndli_membrane_mesh *mesh, int face, int local[SB_MAX_FACE_NODES])
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
static int ndli_membrane_gather(const ndli_membrane_mesh *mesh, const ndl_membrane *membrane, int *triangles)
{
    size_t width = (size_t)sb_element_node_count(mesh->type);
    int count = 0;
    for (int e = 0; e < mesh->count; e++)
        for (int face = 0; face < sb_element_face_count(mesh->type); face++) {
            int local[SB_MAX_FACE_NODES], parts;
            if (!ndli_membrane_holds(mesh, membrane, e, face))
                continue;
            parts = ndli_membrane_face(mesh, face, local) - 2;
            for (int part = 0; part < parts; part++, count++)
                for (int c = 0; c < 3 && triangles; c++)
                    triangles[3 * (size_t)count + (size_t)c] =
                        mesh->elements[width * (size_t)e + (size_t)local[c == 0 ? 0 : part + c]];
        }
    return count;
}

static sb_result ndli_membrane_make_surface(const ndl_needle *needle, const ndl_membrane *membrane,
                                            sb_surface **surface)
{
    ndli_membrane_mesh mesh = ndli_membrane_get_mesh(needle->site);
    sb_mesh faces;
    sb_result result;
    int count = ndli_membrane_gather(&mesh, membrane, NULL);
    if (count == 0)
        return SB_ERROR_ARGUMENT;
    memset(&faces, 0, sizeof faces);
    faces.element_type = SB_TRI3;
    faces.nodes = mesh.X;
    faces.node_count = mesh.node_count;
    faces.elements = (int *)sbi_alloc(&needle->allocator, (size_t)count, 3 * sizeof(int));
    if (!faces.elements)
        return SB_ERROR_MEMORY;
    faces.element_count = ndli_membrane_gather(&mesh, membrane, faces.elements);
    result = sb_surface_create(&faces, &needle->allocator, surface, NULL);
    sbi_free(&needle->allocator, faces.elements);
    return result;
}

NDLI_API int ndli_needle_make_capsules(ndl_needle *needle, const ndl_membrane *membranes, int count, int *bad)
{
    *bad = -1;
    for (int i = 0; i < count; i++) {
        sb_result result = ndli_membrane_make_surface(needle, membranes + i, &needle->capsules[i].surface);
        if (result != SB_OK) {
            *bad = result == SB_ERROR_MEMORY ? -1 : i;
            return 0;
        }
        needle->capsules[i].def = membranes[i];
        needle->capsule_count = i + 1;
    }
    return 1;
}

/* ---- what they ask for ---- */

/* How far X is outside of where the membrane is felt (m), negative within; `reach` where it is farther than that. */
static double ndli_membrane_clearance(const ndli_capsule *capsule, ndli_v3 X, double reach)
{
    double half = 0.5 * (double)capsule->def.thickness;
    sb_surface_hit hit;
    if (!sb_surface_closest(capsule->surface, ndli_to(X), (sb_real)(half + reach), &hit))
        return reach;
    return (double)hit.distance - half;
}

/* What cutting the harder of a membrane's tissues takes (N). */
static double ndli_membrane_harder(const ndl_needle *needle, const ndl_membrane *membrane)
{
    double most = 0;
    for (int side = 0; side < 2; side++) {
        const ndl_friction *friction = ndli_needle_friction(needle, membrane->regions[side]);
        most = fmax(most, friction ? (double)friction->cutting : 0);
    }
    return most;
}

NDLI_API double ndli_needle_cut_membranes(const ndl_needle *needle, sb_vec3 X, double tissue)
{
    double sum = 0;
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndl_membrane *membrane = &needle->capsules[i].def;
        if (!sb_surface_closest(needle->capsules[i].surface, X, membrane->thickness / 2, NULL))
            continue;
        sum += (double)membrane->strength;
        tissue = fmax(tissue, ndli_membrane_harder(needle, membrane));
    }
    return sum + tissue;
}

/* Of a membrane's thickness, or of the way where that is much longer: how far past the edge of one a tip may be found.
 */
static const double ndli_membrane_slack = 0.02, ndli_membrane_least_stride = 1.0 / 64;

/* Of a membrane's thickness: how far past an edge of one a step may take a tip. Of a skin, which is felt over half of
 * its thickness, that leaves half. */
static const double ndli_membrane_most_past = 0.25;

/* The way at which the tip comes into, or out of, where this one is felt (m, a little past it); `length`: nowhere. The
 * distance to a surface changes by no more than one goes: by so much one may go on. */
static double ndli_membrane_edge(const ndli_capsule *capsule, ndli_v3 X, ndli_v3 way, double length)
{
    double thickness = (double)capsule->def.thickness, stride = ndli_membrane_least_stride * length;
    double slack = fmax(ndli_membrane_slack * thickness, stride),
           most = fmax(ndli_membrane_most_past * thickness, stride);
    double clear = ndli_membrane_clearance(capsule, X, length), gone = 0;
    int within = clear <= 0;
    while (gone < length && (clear <= 0) == within) {
        gone += fmax(fabs(clear), slack);
        clear = ndli_membrane_clearance(capsule, ndli_madd(X, gone / length, way), length);
    }
    return gone + most < length ? gone : length;
}

/* Share of the way between two points of the material at which what membranes ask for changes, or a little more; 1:
 * nowhere but at its very end. */
static double ndli_membrane_share(const ndl_needle *needle, ndli_v3 X, ndli_v3 way)
{
    double length = ndli_norm(way), least = length;
    for (int i = 0; i < needle->capsule_count && length > 0; i++)
        least = fmin(least, ndli_membrane_edge(needle->capsules + i, X, way, length));
    return least < length ? least / length : 1;
}

/* The way of a tip in the tissue (m in the material), which the mesh and the track do not follow yet; from *X. */
static ndli_v3 ndli_membrane_way(const ndl_needle *needle, ndli_v3 *X)
{
    const ndl_rod *rod = needle->rod;
    ndl_remesh *remesh = needle->site->remesh;
    int last = rod->node_count - 1, foremost = ndli_line_foremost(&needle->line);
    double slip = needle->line.slip[foremost];
    ndli_v3 before = ndli_madd(rod->x[last], -slip, rod->tangent[last - 1]);
    sb_vec3 from, to;
    ndl_needle_tip_material(needle, &from);
    *X = ndli_from(from);
    if (needle->site->embeds)
        return ndli_scale(slip / needle->stretch[foremost], needle->heading);
    ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &to);
    if (needle->shallow) { /* where it was is where it is now, less its slip */
        ndl_remesh_material_point(remesh, needle->index, ndli_to(before), &from);
        *X = ndli_from(from);
    }
    return ndli_sub(ndli_from(to), *X);
}

/* Thickness of the skin, where that is a membrane (m); -1: it is none. */
static double ndli_membrane_skin(const ndl_needle *needle)
{
    double thickness = -1;
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndl_membrane *membrane = &needle->capsules[i].def;
        if (membrane->regions[0] < 0 || membrane->regions[1] < 0)
            thickness = (double)membrane->thickness;
    }
    return thickness;
}

/* How far a tip has come through the skin that was outside (m). */
static double ndli_membrane_past_skin(const ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    sb_vec3 from = ndli_to(rod->x[last - 1]), to = ndli_to(rod->x[last]), at = to;
    ndl_surface_hit hit;
    ndli_place place;
    if (needle->site->embeds)
        return ndli_bed_hit(&needle->site->bed, from, to, &place, &at) ? (double)sb_v3_norm(sb_v3_sub(to, at)) : 0;
    if (!ndli_topology_hit(needle->site->mesh, from, to, &hit))
        return 0;
    return (1 - (double)hit.along) * (double)sb_v3_norm(sb_v3_sub(to, from));
}

/* The same of a tip that was outside, and went `way` (m). */
static double ndli_membrane_share_to_skin(const ndl_needle *needle, double way)
{
    double thickness = ndli_membrane_skin(needle), past;
    if (thickness < 0)
        return 1;
    past = ndli_membrane_past_skin(needle);
    return past > ndli_membrane_most_past * thickness && past < way ? 1 - (past - ndli_membrane_slack * thickness) / way
                                                                    : 1;
}

NDLI_API double ndli_needle_share_to_edge(const ndl_needle *needle, double dt)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 X, way;
    if (needle->capsule_count == 0 || needle->lost)
        return 1;
    if (needle->line.count == 0)
        return ndli_membrane_share_to_skin(needle, dt * ndli_norm(rod->v[rod->node_count - 1]));
    if (!(needle->line.slip[ndli_line_foremost(&needle->line)] > 0))
        return 1;
    way = ndli_membrane_way(needle, &X);
    return ndli_membrane_share(needle, X, way);
}
