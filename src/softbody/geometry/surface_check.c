/* surface_check: what is wrong with a surface, and what can be repaired. */
#include "surface_tree.h"

/* ---- the report ---------------------------------------------------------------------------------------------- */

enum { /* places of the findings: 1 << place */
       SBI_FOUND_OPEN = 0,
       SBI_FOUND_FLIPPED = 1,
       SBI_FOUND_EDGE = 2,
       SBI_FOUND_NODE = 3,
       SBI_FOUND_DEGENERATE = 4,
       SBI_FOUND_DUPLICATE = 5,
       SBI_FOUND_UNWELDED = 6,
       SBI_FOUND_INSIDE_OUT = 7,
       SBI_FOUND_CROSSING = 8,
       SBI_FOUND_UNREFERENCED = 9,
       SBI_FOUND_PARTS = 10,
       SBI_FOUND_CROWDED = 11
};

SB_API const char *sb_surface_check_string(int finding)
{
    switch (finding) {
    case SB_SURFACE_OPEN_EDGES: return "edges of one face only";
    case SB_SURFACE_FLIPPED: return "edges whose two faces are oriented against each other";
    case SB_SURFACE_NONMANIFOLD_EDGES: return "edges of more than two faces";
    case SB_SURFACE_NONMANIFOLD_NODES: return "nodes where parts touch in a point";
    case SB_SURFACE_DEGENERATE: return "faces without area";
    case SB_SURFACE_DUPLICATES: return "faces with the corners of one before them";
    case SB_SURFACE_UNWELDED: return "nodes that coincide with one before them";
    case SB_SURFACE_INSIDE_OUT: return "parts turned inside out";
    case SB_SURFACE_SELF_CROSSING: return "pairs of triangles that cross";
    case SB_SURFACE_UNREFERENCED: return "nodes of no face";
    case SB_SURFACE_SEVERAL_PARTS: return "further parts";
    case SB_SURFACE_CROWDED: return "triangles among too many others to look for all crossings";
    default: return "unknown finding";
    }
}

static void sbi_found_element(sb_surface_place *place, int element, int other)
{
    if (place->count++ > 0)
        return;
    place->element = element;
    place->other_element = other;
}

/* Counts an edge, a run of equal keys, and keeps the first. */
static void sbi_found_edge(const sbi_mesh_keys *edges, int begin, int end, sb_surface_place *place)
{
    const int *key = edges->keys + 2 * (size_t)edges->order[begin];
    int per = edges->per_element, first = edges->order[begin] / per;
    sbi_found_element(place, first, end > begin + 1 ? edges->order[begin + 1] / per : -1);
    if (place->count == 1) {
        place->node = key[0];
        place->other_node = key[1];
    }
}

/* 1 when the face of part p of the edges runs from the smaller node to the larger. */
static int sbi_found_ascends(const sb_mesh *mesh, int per, int p)
{
    const int *nodes = mesh->elements + (size_t)(p / per) * (size_t)sb_mesh_element_width(mesh);
    return nodes[p % per] < nodes[(p % per + 1) % per];
}

static void sbi_found_edges(const sb_mesh *mesh, const sbi_mesh_keys *edges, sb_surface_place *place)
{
    int per = edges->per_element;
    for (int begin = 0, end; begin < edges->sorted; begin = end) {
        const int *order = edges->order + begin;
        end = sbi_mesh_run_end(edges, begin);
        if (end == begin + 1)
            sbi_found_edge(edges, begin, end, place + SBI_FOUND_OPEN);
        else if (end > begin + 2)
            sbi_found_edge(edges, begin, end, place + SBI_FOUND_EDGE);
        else if (sbi_found_ascends(mesh, per, order[0]) == sbi_found_ascends(mesh, per, order[1]))
            sbi_found_edge(edges, begin, end, place + SBI_FOUND_FLIPPED);
    }
}

/* Nodes that several fans of triangles share; an edge of more than two faces is its own finding. */
static void sbi_found_pinched(const sb_surface *s, int count, sb_surface_place *place)
{
    place->count = count;
    for (int v = 0; count > 0 && v < s->node_count; v++) {
        int nonmanifold = 0;
        for (int i = s->fan_start[v]; i < s->fan_start[v + 1]; i++) {
            const int *mate = s->mate[s->fan[i] / 3];
            nonmanifold = nonmanifold || mate[s->fan[i] % 3] == SBI_SURFACE_NONMANIFOLD ||
                          mate[(s->fan[i] % 3 + 2) % 3] == SBI_SURFACE_NONMANIFOLD;
        }
        if (s->pinched[v] && !nonmanifold) {
            place->node = v;
            place->element = s->element[s->fan[s->fan_start[v]] / 3];
            return;
        }
    }
}

/* Scratch of a check. */
typedef struct sbi_found_scratch {
    sb_surface *surface;
    sb_mesh_report mesh;
    sbi_mesh_keys edges;
    sb_index_table part; /* part of each element */
    unsigned char *skip; /* [elements] faces with a node twice */
    int *representative; /* [nodes] */
    double *volume;      /* [parts] */
    int *first, *order;  /* [parts + 1], [triangles] triangles by part */
    unsigned char *open; /* [parts] 1: not closed, or not consistent */
    int parts;
} sbi_found_scratch;

static void sbi_found_free(const sb_allocator *allocator, sbi_found_scratch *scratch)
{
    sb_surface_destroy(scratch->surface);
    sb_mesh_report_free(&scratch->mesh);
    sbi_mesh_keys_free(allocator, &scratch->edges);
    sb_index_table_free(&scratch->part);
    sbi_free(allocator, scratch->skip);
    sbi_free(allocator, scratch->representative);
    sbi_free(allocator, scratch->volume);
    sbi_free(allocator, scratch->first);
    sbi_free(allocator, scratch->order);
    sbi_free(allocator, scratch->open);
}

static sb_result sbi_found_prepare(const sb_mesh *mesh, const sb_allocator *allocator, sbi_found_scratch *scratch,
                                   sb_error *error)
{
    sb_result result = sb_surface_create(mesh, allocator, &scratch->surface, error);
    if (result == SB_OK)
        result = sb_mesh_check(mesh, allocator, &scratch->mesh, error);
    if (result == SB_OK)
        result = sb_mesh_components(mesh, allocator, &scratch->part, &scratch->parts, error);
    if (result != SB_OK)
        return result;
    scratch->skip = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)mesh->element_count, 1);
    scratch->representative = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    scratch->volume = (double *)sbi_alloc_zeroed(allocator, (size_t)scratch->parts, sizeof(double));
    scratch->open = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)scratch->parts, 1);
    scratch->first = (int *)sbi_alloc(allocator, (size_t)scratch->parts + 1, sizeof(int));
    scratch->order = (int *)sbi_alloc(allocator, (size_t)scratch->surface->triangle_count, sizeof(int));
    if (!scratch->skip || !scratch->representative || !scratch->volume || !scratch->open || !scratch->first ||
        !scratch->order)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the check of a surface");
    for (int i = 0; i < scratch->mesh.bad_count; i++)
        if (scratch->mesh.bad[i].defect == SB_MESH_REPEATED_NODE)
            scratch->skip[scratch->mesh.bad[i].element] = 1;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, scratch->skip, allocator, &scratch->edges) ||
        sbi_mesh_find_duplicates(mesh, -1, allocator, scratch->representative) < 0)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the check of a surface");
    return SB_OK;
}

/* Volume of each part around its own first corner, and whether it is closed. */
static void sbi_found_measure_parts(const sb_surface *s, sbi_found_scratch *scratch)
{
    const int *part = scratch->part.items;
    for (int t = 0; t < s->triangle_count; t++) {
        int p = part[s->element[t]];
        sb_vec3 x[3];
        if (s->shape[t] == SBI_SURFACE_FLAT)
            continue;
        for (int i = 0; i < 3; i++)
            scratch->open[p] |= s->mate[t][i] < 0;
        sbi_surface_corners(s, t, x);
        for (int i = 0; i < 3; i++)
            x[i] = sb_v3_sub(x[i], s->centre);
        scratch->volume[p] += (double)sb_v3_dot(x[0], sb_v3_cross(x[1], x[2]));
    }
}

/* Lists the triangles of each part, one part after the other: part p has order[first[p] .. first[p + 1]). */
static void sbi_found_list_parts(const sb_surface *s, const sbi_found_scratch *scratch)
{
    int *first = scratch->first;
    memset(first, 0, sizeof(int) * ((size_t)scratch->parts + 1));
    for (int t = 0; t < s->triangle_count; t++)
        first[scratch->part.items[s->element[t]] + 1]++;
    for (int p = 0; p < scratch->parts; p++)
        first[p + 1] += first[p];
    for (int t = 0; t < s->triangle_count; t++)
        scratch->order[first[scratch->part.items[s->element[t]]]++] = t;
    memmove(first + 1, first, sizeof(int) * (size_t)scratch->parts); /* filling moved each to its end */
    first[0] = 0;
}

/* Winding number of all parts but one, just off the middle of a triangle of that one: all of them by the tree, less its
 * own triangles. */
static double sbi_found_winding_of_others(const sb_surface *s, const sbi_found_scratch *scratch, int part, int triangle)
{
    sbi_surface_angle own = sbi_surface_angle_zero();
    sb_vec3 x[3], normal = sbi_surface_unit_normal(s, triangle), eye;
    sb_real size;
    sbi_surface_corners(s, triangle, x);
    size = sb_sqrt(sb_v3_norm(sbi_surface_area_vector(x)));
    eye = sb_v3_scale((sb_real)(1.0 / 3), sb_v3_add(x[0], sb_v3_add(x[1], x[2])));
    eye = sb_v3_madd(eye, sb_sqrt(SB_EPSILON) * size, normal);
    for (int i = scratch->first[part]; i < scratch->first[part + 1]; i++) {
        int t = scratch->order[i];
        sbi_surface_corners(s, t, x);
        if (s->shape[t] != SBI_SURFACE_FLAT)
            sbi_surface_angle_of(x, eye, &own);
    }
    return sbi_surface_winding(s, eye) - sbi_surface_angle_turns(&own);
}

/* Closed parts with a negative volume, unless the others surround them: then they are walls of cavities. */
static void sbi_found_inside_out(const sb_surface *s, sbi_found_scratch *scratch, sb_surface_place *place)
{
    const int *part = scratch->part.items;
    sbi_found_measure_parts(s, scratch);
    sbi_found_list_parts(s, scratch);
    for (int t = 0; t < s->triangle_count; t++) {
        int p = part[s->element[t]];
        if (scratch->open[p] || !(scratch->volume[p] < 0) || s->shape[t] == SBI_SURFACE_FLAT)
            continue;
        scratch->open[p] = 1; /* once is enough */
        if (sbi_found_winding_of_others(s, scratch, p, t) < 0.5)
            sbi_found_element(place, s->element[t], -1);
    }
}

/* Faces that are bad by themselves, and copies. */
static void sbi_found_elements(const sb_mesh_report *found, sb_surface_place *place)
{
    for (int i = 0; i < found->bad_count; i++) {
        sb_mesh_defect defect = found->bad[i].defect;
        if (defect == SB_MESH_FLAT || defect == SB_MESH_REPEATED_NODE)
            sbi_found_element(place + SBI_FOUND_DEGENERATE, found->bad[i].element, -1);
        if (defect == SB_MESH_DUPLICATE)
            sbi_found_element(place + SBI_FOUND_DUPLICATE, found->bad[i].element, -1);
    }
}

static void sbi_found_nodes(const sb_mesh *mesh, const sbi_found_scratch *scratch, sb_surface_place *place)
{
    place[SBI_FOUND_UNREFERENCED].count = scratch->mesh.unreferenced_nodes;
    place[SBI_FOUND_UNREFERENCED].node = scratch->mesh.first_unreferenced_node;
    for (int v = mesh->node_count - 1; v >= 0; v--) {
        if (scratch->representative[v] == v)
            continue;
        place[SBI_FOUND_UNWELDED].count++;
        place[SBI_FOUND_UNWELDED].node = v;
        place[SBI_FOUND_UNWELDED].other_node = scratch->representative[v];
    }
}

static void sbi_found_parts(const sb_mesh *mesh, const sbi_found_scratch *scratch, sb_surface_place *place)
{
    place->count = scratch->parts - 1;
    for (int e = 0; e < mesh->element_count && place->element < 0; e++)
        if (scratch->part.items[e] == 1)
            place->element = e;
}

/* 0: no memory. */
static int sbi_found_all(const sb_mesh *mesh, const sb_allocator *allocator, sbi_found_scratch *scratch, int crossings,
                         sb_surface_report *report)
{
    sb_surface_place *place = report->place;
    int partial = 0;
    memset(report, 0, sizeof *report);
    for (int i = 0; i < SB_SURFACE_FINDING_COUNT; i++)
        place[i].element = place[i].other_element = place[i].node = place[i].other_node = -1;
    sbi_found_edges(mesh, &scratch->edges, place);
    sbi_found_pinched(scratch->surface, scratch->mesh.nonmanifold_vertices, place + SBI_FOUND_NODE);
    sbi_found_elements(&scratch->mesh, place);
    sbi_found_nodes(mesh, scratch, place);
    sbi_found_inside_out(scratch->surface, scratch, place + SBI_FOUND_INSIDE_OUT);
    if (crossings)
        partial = sbi_surface_find_crossings(scratch->surface, allocator, place + SBI_FOUND_CROSSING,
                                             place + SBI_FOUND_CROWDED, NULL);
    sbi_found_parts(mesh, scratch, place + SBI_FOUND_PARTS);
    report->crossings_partial = partial != 0;
    report->parts = scratch->parts;
    report->volume = scratch->mesh.volume;
    report->area = scratch->mesh.area;
    for (int i = 0; i < SB_SURFACE_FINDING_COUNT; i++)
        report->findings |= place[i].count > 0 ? 1 << i : 0;
    return partial >= 0;
}

/* The check with or without the search for crossings. */
static sb_result sbi_found_check(const sb_mesh *mesh, int crossings, const sb_allocator *allocator,
                                 sb_surface_report *report, sb_error *error)
{
    sbi_found_scratch scratch;
    sb_surface_report found;
    sb_result result;
    memset(&scratch, 0, sizeof scratch);
    result = sbi_found_prepare(mesh, allocator, &scratch, error);
    if (result == SB_OK && !sbi_found_all(mesh, allocator, &scratch, crossings, &found))
        result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the check of a surface");
    if (result == SB_OK)
        *report = found;
    sbi_found_free(allocator, &scratch);
    return result;
}

SB_API sb_result sb_surface_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_surface_report *report,
                                  sb_error *error)
{
    if (!report)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the report is NULL");
    return sbi_found_check(mesh, 1, allocator, report, error);
}

/* Names a finding and its first place. */
static sb_result sbi_found_fail(int finding, const sb_surface_place *place, sb_error *error)
{
    const char *what = sb_surface_check_string(finding);
    if (place->node >= 0 && place->other_node >= 0 && place->element >= 0)
        return sbi_fail_element(error, SB_ERROR_MESH, place->element,
                                "the surface has %d %s; the first joins nodes %d and %d of element %d", place->count,
                                what, place->node, place->other_node, place->element);
    if (place->element >= 0 && place->other_element >= 0)
        return sbi_fail_element(error, SB_ERROR_MESH, place->element,
                                "the surface has %d %s; the first are of elements %d and %d", place->count, what,
                                place->element, place->other_element);
    if (place->node >= 0)
        return sbi_fail_node(error, SB_ERROR_MESH, place->node, "the surface has %d %s; the first is node %d",
                             place->count, what, place->node);
    return sbi_fail_element(error, SB_ERROR_MESH, place->element, "the surface has %d %s; the first has element %d",
                            place->count, what, place->element);
}

SB_API sb_result sb_surface_require(const sb_mesh *mesh, int findings, const sb_allocator *allocator,
                                    sb_surface_report *report, sb_error *error)
{
    sb_surface_report found;
    sb_result result =
        sbi_found_check(mesh, (findings & SB_SURFACE_SELF_CROSSING) != 0 || report, allocator, &found, error);
    if (result != SB_OK)
        return result;
    if (report)
        *report = found;
    for (int i = 0; i < SB_SURFACE_FINDING_COUNT; i++)
        if (found.findings & findings & (1 << i))
            return sbi_found_fail(1 << i, found.place + i, error);
    return SB_OK;
}

/* ---- repairs ------------------------------------------------------------------------------------------------- */

SB_API sb_result sb_surface_triangulate(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *triangles,
                                        sb_error *error)
{
    sbi_surface_cut cut;
    sb_mesh made;
    sb_result result;
    if (!triangles)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the output is NULL");
    result = sbi_surface_cut_make(mesh, allocator, &cut, error);
    if (result != SB_OK)
        return result;
    if (sbi_mesh_allocate(&made, SB_TRI3, mesh->node_count, cut.triangles.element_count, mesh->regions != NULL,
                          allocator)) {
        memcpy(made.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
        memcpy(made.elements, cut.corners, 3 * sizeof(int) * (size_t)made.element_count);
        for (int t = 0; mesh->regions && t < made.element_count; t++)
            made.regions[t] = mesh->regions[cut.element[t]];
        *triangles = made;
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for %d triangles", cut.triangles.element_count);
    }
    sbi_surface_cut_free(allocator, &cut);
    return result;
}

SB_API sb_surface_repair_def sb_default_surface_repair(void)
{
    sb_surface_repair_def def;
    memset(&def, 0, sizeof def);
    def.weld = def.clean = def.orient = 1;
    def.weld_tolerance = -1;
    return def;
}

/* Drops faces with a node twice; returns how many. */
static int sbi_repair_drop_repeated(sb_mesh *mesh)
{
    int kept = 0, removed;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = mesh->elements + 3 * (size_t)e;
        if (sbi_surface_repeats(nodes))
            continue;
        memmove(mesh->elements + 3 * (size_t)kept, nodes, 3 * sizeof(int));
        if (mesh->regions)
            mesh->regions[kept] = mesh->regions[e];
        kept++;
    }
    removed = mesh->element_count - kept;
    mesh->element_count = kept;
    return removed;
}

static int sbi_repair_same_way(const int *nodes, int a, int b)
{
    return (nodes[0] == a && nodes[1] == b) || (nodes[1] == a && nodes[2] == b) || (nodes[2] == a && nodes[0] == b);
}

/* Turns the longest edge of a flat triangle and its neighbour's into the other diagonal: two triangles with area come
 * of it, and no gap. 1 when that is possible. `touched`: triangles changed since the neighbours were looked up. */
static int sbi_repair_flip(sb_mesh *mesh, const sb_surface *s, int flat, unsigned char *touched)
{
    sb_vec3 x[3];
    int *nodes = mesh->elements + 3 * (size_t)flat, *other, first, mate, a, b, c, d;
    sbi_surface_corners(s, flat, x);
    first = sbi_surface_longest_edge(x);
    mate = s->mate[flat][first];
    if (mate < 0 || touched[flat] || touched[mate])
        return 0;
    other = mesh->elements + 3 * (size_t)mate;
    a = nodes[first], b = nodes[(first + 1) % 3], c = nodes[(first + 2) % 3];
    d = other[0] + other[1] + other[2] - a - b;
    if (c == d || s->shape[mate] == SBI_SURFACE_FLAT || !sbi_repair_same_way(other, b, a))
        return 0;
    /* the edge c-d must be new */
    for (int i = s->fan_start[c]; i < s->fan_start[c + 1]; i++) {
        const int *round = s->corners[s->fan[i] / 3];
        if (round[0] == d || round[1] == d || round[2] == d)
            return 0;
    }
    nodes[0] = a, nodes[1] = d, nodes[2] = c;
    other[0] = d, other[1] = b, other[2] = c;
    /* no second edge c-d, or flip of what these have become, in this pass */
    for (int i = s->fan_start[c]; i < s->fan_start[c + 1]; i++)
        touched[s->fan[i] / 3] = 1;
    for (int i = s->fan_start[d]; i < s->fan_start[d + 1]; i++)
        touched[s->fan[i] / 3] = 1;
    return 1;
}

/* Gets rid of flat triangles with three nodes: by flips, or by leaving out those at an open border. */
static sb_result sbi_repair_flat(sb_mesh *mesh, sb_surface_repair_report *report, sb_error *error)
{
    for (int pass = 0, changed = 1; changed && pass < 8 && mesh->element_count > 0; pass++) {
        sb_surface *s = NULL;
        unsigned char *touched = (unsigned char *)sbi_alloc_zeroed(&mesh->allocator, (size_t)mesh->element_count, 1);
        sb_result result = sb_surface_create(mesh, &mesh->allocator, &s, error);
        if (!touched && result == SB_OK)
            result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the repair of a surface");
        changed = 0;
        for (int t = 0; result == SB_OK && t < s->triangle_count; t++) {
            sb_vec3 x[3];
            if (s->shape[t] != SBI_SURFACE_FLAT)
                continue;
            sbi_surface_corners(s, t, x);
            if (s->mate[t][sbi_surface_longest_edge(x)] == SBI_SURFACE_OPEN && !touched[t]) {
                mesh->elements[3 * (size_t)t + 1] = mesh->elements[3 * (size_t)t]; /* dropped below */
                touched[t] = 1;
                changed++;
            } else if (sbi_repair_flip(mesh, s, t, touched)) {
                report->flipped_edges++;
                changed++;
            }
        }
        sb_surface_destroy(s);
        sbi_free(&mesh->allocator, touched);
        if (result != SB_OK)
            return result;
        report->removed_degenerate += sbi_repair_drop_repeated(mesh);
    }
    return SB_OK;
}

static sb_result sbi_repair_clean(sb_mesh *mesh, sb_surface_repair_report *report, sb_error *error)
{
    sb_result result;
    report->removed_degenerate += sbi_repair_drop_repeated(mesh);
    if (mesh->element_count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "nothing is left of the surface: no face has three different nodes");
    result = sb_mesh_remove_duplicate_elements(mesh, &report->removed_duplicates, error);
    if (result == SB_OK)
        result = sbi_repair_flat(mesh, report, error);
    if (result == SB_OK && mesh->element_count == 0)
        result = sbi_fail(error, SB_ERROR_MESH, "nothing is left of the surface: no face has an area");
    if (result == SB_OK)
        result = sb_mesh_remove_unreferenced(mesh, &report->removed_nodes, error);
    return result;
}

static sb_result sbi_repair_orient(sb_mesh *mesh, sb_surface_repair_report *report, sb_error *error)
{
    sb_surface_report found;
    sb_result result = sbi_found_check(mesh, 0, &mesh->allocator, &found, error);
    if (result == SB_OK && (found.findings & (SB_SURFACE_FLIPPED | SB_SURFACE_INSIDE_OUT)))
        result = sb_mesh_orient_surface(mesh, &report->turned_faces, error);
    return result;
}

/* ---- holes ---- */

enum { SBI_HOLE_LONGEST = 256 };

/* A hole's border and the table of its least-area triangulations (Barequet, Sharir 1995). */
typedef struct sbi_hole {
    const sb_surface *s;
    int count;
    int node[SBI_HOLE_LONGEST];                             /* along the border, as the new triangles go */
    sb_real area[SBI_HOLE_LONGEST][SBI_HOLE_LONGEST];       /* least area between nodes i and j */
    unsigned char apex[SBI_HOLE_LONGEST][SBI_HOLE_LONGEST]; /* third corner of the triangle on i, j */
} sbi_hole;

/* Area of a new triangle; infinite where it would have none. */
static sb_real sbi_hole_area(const sbi_hole *hole, int i, int k, int j)
{
    sb_vec3 x[3];
    x[0] = hole->s->nodes[hole->node[i]];
    x[1] = hole->s->nodes[hole->node[k]];
    x[2] = hole->s->nodes[hole->node[j]];
    if (sbi_surface_shape_of(sbi_surface_slimness(x)) == SBI_SURFACE_FLAT)
        return (sb_real)INFINITY;
    return sb_v3_norm(sbi_surface_area_vector(x));
}

/* 1 when nodes i and j of the border already have an edge: a second one would make it non-manifold. */
static int sbi_hole_edge_exists(const sbi_hole *hole, int i, int j)
{
    const sb_surface *s = hole->s;
    int v = hole->node[i], w = hole->node[j];
    for (int f = s->fan_start[v]; f < s->fan_start[v + 1]; f++) {
        const int *round = s->corners[s->fan[f] / 3];
        if (round[0] == w || round[1] == w || round[2] == w)
            return 1;
    }
    return 0;
}

/* Fills the table; 0 when the hole has no triangulation without degenerate triangles and doubled edges. */
static int sbi_hole_solve(sbi_hole *hole)
{
    int n = hole->count;
    for (int span = 1; span < n; span++) {
        for (int i = 0; i + span < n; i++) {
            int j = i + span;
            sb_real best = span == 1 ? 0 : (sb_real)INFINITY;
            if (span > 1 && span < n - 1 && sbi_hole_edge_exists(hole, i, j)) {
                hole->area[i][j] = best;
                continue;
            }
            for (int k = i + 1; k < j; k++) {
                sb_real area = hole->area[i][k] + hole->area[k][j];
                if (!(area < best))
                    continue;
                area += sbi_hole_area(hole, i, k, j);
                if (area < best)
                    best = area, hole->apex[i][j] = (unsigned char)k;
            }
            hole->area[i][j] = best;
        }
    }
    return sb_is_finite(hole->area[0][n - 1]);
}

/* Writes the triangles of a solved hole; returns how many. */
static int sbi_hole_write(const sbi_hole *hole, int *elements)
{
    int stack[SBI_HOLE_LONGEST][2], top = 1, count = 0;
    stack[0][0] = 0, stack[0][1] = hole->count - 1;
    while (top > 0) {
        int i = stack[--top][0], j = stack[top][1], k;
        if (j < i + 2)
            continue;
        k = hole->apex[i][j];
        elements[3 * count] = hole->node[i];
        elements[3 * count + 1] = hole->node[k];
        elements[3 * count + 2] = hole->node[j];
        count++;
        stack[top][0] = i, stack[top++][1] = k;
        stack[top][0] = k, stack[top++][1] = j;
    }
    return count;
}

/* next[v]: the node after v along the border of a hole, -1: none, -2: several. Holes run against their faces. */
static void sbi_hole_borders(const sb_surface *s, int *next)
{
    for (int v = 0; v < s->node_count; v++)
        next[v] = -1;
    for (int t = 0; t < s->triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            int from = s->corners[t][(i + 1) % 3];
            if (s->mate[t][i] == SBI_SURFACE_OPEN)
                next[from] = next[from] == -1 ? s->corners[t][i] : -2;
        }
    }
}

/* Follows the border from v into the hole and takes it off the list. Returns 1 for a closed border of up to `limit`
 * nodes that touches nothing, 0 for another. */
static int sbi_hole_follow(sbi_hole *hole, int *next, int v, int limit)
{
    int start = v, length = 0, sound;
    while (next[v] >= 0) {
        int follow = next[v];
        if (length < SBI_HOLE_LONGEST)
            hole->node[length] = v;
        length++;
        next[v] = -1;
        v = follow;
    }
    sound = v == start && length >= 3 && length <= limit;
    hole->count = sound ? length : 0;
    return sound;
}

/* The faces over all holes that can be closed, in a new array. */
typedef struct sbi_hole_faces {
    int *elements;
    int count;
} sbi_hole_faces;

static sb_result sbi_hole_find(const sb_mesh *mesh, const sb_surface *s, int limit, sbi_hole_faces *faces,
                               sb_surface_repair_report *report, sb_error *error)
{
    int *next = (int *)sbi_alloc(&mesh->allocator, (size_t)s->node_count, sizeof(int));
    sbi_hole *hole = (sbi_hole *)sbi_alloc(&mesh->allocator, 1, sizeof *hole);
    /* a border of n nodes takes n - 2 triangles, and every node has at most one */
    faces->elements = (int *)sbi_alloc(&mesh->allocator, (size_t)s->node_count, 3 * sizeof(int));
    if (next && hole && faces->elements) {
        hole->s = s;
        sbi_hole_borders(s, next);
        for (int v = 0; v < s->node_count; v++) {
            if (next[v] < 0)
                continue;
            if (sbi_hole_follow(hole, next, v, limit) && sbi_hole_solve(hole)) {
                faces->count += sbi_hole_write(hole, faces->elements + 3 * (size_t)faces->count);
                report->filled_holes++;
            } else {
                report->left_holes++;
            }
        }
    }
    sbi_free(&mesh->allocator, next);
    if (!hole || !faces->elements || !next) {
        sbi_free(&mesh->allocator, hole);
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for closing holes");
    }
    sbi_free(&mesh->allocator, hole);
    return SB_OK;
}

/* Appends the faces; their region is 0 like that of any new element. */
static sb_result sbi_hole_append(sb_mesh *mesh, const sbi_hole_faces *faces, sb_error *error)
{
    sb_mesh more;
    sb_allocator allocator = mesh->allocator;
    size_t old = (size_t)mesh->element_count, added = (size_t)faces->count;
    if (faces->count > INT_MAX - mesh->element_count)
        return sbi_fail(error, SB_ERROR_MESH, "the surface has too many faces");
    if (!sbi_mesh_allocate(&more, SB_TRI3, mesh->node_count, mesh->element_count + faces->count, mesh->regions != NULL,
                           &allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for closing holes");
    memcpy(more.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    memcpy(more.elements, mesh->elements, 3 * sizeof(int) * old);
    memcpy(more.elements + 3 * old, faces->elements, 3 * sizeof(int) * added);
    if (mesh->regions) {
        memcpy(more.regions, mesh->regions, sizeof(int) * old);
        memset(more.regions + old, 0, sizeof(int) * added);
    }
    sb_mesh_free(mesh);
    *mesh = more;
    return SB_OK;
}

static sb_result sbi_repair_holes(sb_mesh *mesh, int limit, sb_surface_repair_report *report, sb_error *error)
{
    sb_surface *s = NULL;
    sbi_hole_faces faces;
    sb_result result = sb_surface_create(mesh, &mesh->allocator, &s, error);
    faces.elements = NULL;
    faces.count = 0;
    report->left_holes = 0;
    if (result == SB_OK)
        result = sbi_hole_find(mesh, s, limit, &faces, report, error);
    if (result == SB_OK && faces.count > 0)
        result = sbi_hole_append(mesh, &faces, error);
    report->added_faces = faces.count;
    sbi_free(&mesh->allocator, faces.elements);
    sb_surface_destroy(s);
    return result;
}

static sb_result sbi_repair_check(const sb_mesh *mesh, const sb_surface_repair_def *def, sb_error *error)
{
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (mesh->element_type != SB_TRI3)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "only meshes of tri3 are repaired, not of %s: triangulate first",
                        sb_element_name(mesh->element_type));
    if (!sb_is_finite(def->weld_tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the weld tolerance is not finite");
    if (def->max_hole_edges < 0 || def->max_hole_edges > SBI_HOLE_LONGEST)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_hole_edges is %d, must be in [0, %d]", def->max_hole_edges,
                        (int)SBI_HOLE_LONGEST);
    return SB_OK;
}

SB_API sb_result sb_surface_repair(sb_mesh *mesh, const sb_surface_repair_def *def, sb_surface_repair_report *report,
                                   sb_error *error)
{
    sb_surface_repair_def standard = sb_default_surface_repair();
    sb_surface_repair_report done;
    sb_mesh work;
    sb_result result;
    if (!def)
        def = &standard;
    result = sbi_repair_check(mesh, def, error);
    if (result == SB_OK)
        result = sb_mesh_copy(mesh, &mesh->allocator, &work, error);
    if (result != SB_OK)
        return result;
    memset(&done, 0, sizeof done);
    done.left_holes = -1;
    if (def->weld)
        result = sb_mesh_merge_nodes(&work, def->weld_tolerance, &done.merged_nodes, error);
    if (result == SB_OK && def->clean)
        result = sbi_repair_clean(&work, &done, error);
    if (result == SB_OK && def->orient)
        result = sbi_repair_orient(&work, &done, error);
    if (result == SB_OK && def->max_hole_edges > 0)
        result = sbi_repair_holes(&work, def->max_hole_edges, &done, error);
    if (result != SB_OK) {
        sb_mesh_free(&work);
        return result;
    }
    sb_mesh_free(mesh);
    *mesh = work;
    if (report)
        *report = done;
    return SB_OK;
}
