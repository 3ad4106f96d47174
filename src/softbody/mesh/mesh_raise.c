/* mesh_raise: quadratic meshes from linear ones: tet4 to tet10, hex8 to hex20 and hex27. */
#include "mesh_private.h"

/* ---- tet4 to tet10, hex8 to hex20 and hex27 ---- */

/* number[part]: node of each edge or face, numbered from `first` in the order they appear. Returns the end. A
 * run of equal keys starts with its smallest part, so that one is met first. */
static int sbi_mesh_number_parts(const sbi_mesh_keys *parts, int first, int *number)
{
    int next = first;
    for (int begin = 0, end; begin < parts->sorted; begin = end) {
        end = sbi_mesh_run_end(parts, begin);
        for (int i = begin; i < end; i++)
            number[parts->order[i]] = parts->order[begin];
    }
    for (int p = 0; p < parts->count; p++)
        number[p] = number[p] == p ? next++ : number[number[p]];
    return next;
}

/* The nodes a conversion adds. */
typedef struct sbi_mesh_raising {
    sbi_mesh_keys edges, faces;
    int *edge_number, *face_number; /* [parts]; face_number NULL: no nodes on faces and in centres */
    int nodes;                      /* together with the old ones, without centres */
} sbi_mesh_raising;

static void sbi_mesh_raising_free(const sb_allocator *allocator, sbi_mesh_raising *raising)
{
    sbi_free(allocator, raising->edge_number);
    sbi_free(allocator, raising->face_number);
    sbi_mesh_keys_free(allocator, &raising->edges);
    sbi_mesh_keys_free(allocator, &raising->faces);
}

/* Numbers the nodes on edges, and with_faces those on faces; 0 when memory is short or they do not fit an int. */
static int sbi_mesh_raising_make(const sb_mesh *mesh, int with_faces, const sb_allocator *allocator,
                                 sbi_mesh_raising *raising)
{
    memset(raising, 0, sizeof *raising);
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_EDGES, NULL, allocator, &raising->edges) ||
        sbi_mesh_count_runs(&raising->edges) > INT_MAX - mesh->node_count)
        return 0;
    raising->edge_number = (int *)sbi_alloc(allocator, (size_t)raising->edges.count, sizeof(int));
    if (!raising->edge_number)
        return 0;
    raising->nodes = sbi_mesh_number_parts(&raising->edges, mesh->node_count, raising->edge_number);
    if (!with_faces)
        return 1;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, allocator, &raising->faces) ||
        sbi_mesh_count_runs(&raising->faces) > INT_MAX - raising->nodes)
        return 0;
    raising->face_number = (int *)sbi_alloc(allocator, (size_t)raising->faces.count, sizeof(int));
    if (!raising->face_number)
        return 0;
    raising->nodes = sbi_mesh_number_parts(&raising->faces, raising->nodes, raising->face_number);
    return raising->nodes <= INT_MAX - mesh->element_count;
}

/* Mean of some of an element's nodes; each takes its share first, so that no sum overflows. */
static sb_vec3 sbi_mesh_middle(const sb_mesh *mesh, const int *element, const int *local, int count)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real share = 1 / (sb_real)count;
    for (int i = 0; i < count; i++) {
        sb_vec3 x = mesh->nodes[element[local[i]]];
        sum = sb_v3(sum.x + share * x.x, sum.y + share * x.y, sum.z + share * x.z);
    }
    return sum;
}

/* Element e of the raised mesh: corners, nodes on edges, on faces, and the centre. */
static void sbi_mesh_raise_element(const sb_mesh *mesh, const sbi_mesh_raising *raising, int e, sb_mesh *raised)
{
    static const int all[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_element_type type = mesh->element_type;
    int corners = sb_element_corner_count(type), edges = sb_element_edge_count(type), local[SB_MAX_FACE_NODES];
    const int *from = sbi_mesh_element(mesh, e);
    int *to = sbi_mesh_element_to_edit(raised, e), next = corners;
    memcpy(to, from, (size_t)corners * sizeof(int));
    for (int i = 0; sb_element_edge(type, i, local); i++) {
        to[next] = raising->edge_number[e * edges + i];
        raised->nodes[to[next++]] = sbi_mesh_middle(mesh, from, local, 2);
    }
    if (!raising->face_number)
        return;
    for (int i = 0, count; (count = sb_element_face(type, i, local, NULL)) > 0; i++) {
        to[next] = raising->face_number[e * raising->faces.per_element + i];
        raised->nodes[to[next++]] = sbi_mesh_middle(mesh, from, local, count);
    }
    to[next] = raising->nodes + e;
    raised->nodes[to[next]] = sbi_mesh_middle(mesh, from, all, corners);
}

/* The mesh of the straight type `from` with the nodes that `type` has besides. */
static sb_result sbi_mesh_raise(const sb_mesh *mesh, sb_element_type from, sb_element_type type,
                                const sb_allocator *allocator, sb_mesh *raised, sb_error *error)
{
    sb_mesh made;
    sbi_mesh_raising raising;
    int with_faces = type == SB_HEX27;
    sb_result result = sbi_mesh_check_output(mesh, raised, error);
    if (result != SB_OK)
        return result;
    if (mesh->element_type != from)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s cannot become %s: %s is needed",
                        sbi_element_name(sbi_mesh_element_kind(mesh)), sb_element_name(type), sb_element_name(from));
    if (sbi_mesh_raising_make(mesh, with_faces, allocator, &raising) &&
        sbi_mesh_allocate(&made, type, raising.nodes + (with_faces ? mesh->element_count : 0), mesh->element_count,
                          mesh->regions != NULL, allocator)) {
        memcpy(made.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
        if (mesh->regions)
            memcpy(made.regions, mesh->regions, sizeof(int) * (size_t)mesh->element_count);
        for (int e = 0; e < mesh->element_count; e++)
            sbi_mesh_raise_element(mesh, &raising, e, &made);
        *raised = made;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_raising_free(allocator, &raising);
    return result;
}

SB_API sb_result sb_mesh_to_tet10(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *tet10, sb_error *error)
{
    return sbi_mesh_raise(mesh, SB_TET4, SB_TET10, allocator, tet10, error);
}

SB_API sb_result sb_mesh_to_hex20(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *hex20, sb_error *error)
{
    return sbi_mesh_raise(mesh, SB_HEX8, SB_HEX20, allocator, hex20, error);
}

SB_API sb_result sb_mesh_to_hex27(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *hex27, sb_error *error)
{
    return sbi_mesh_raise(mesh, SB_HEX8, SB_HEX27, allocator, hex27, error);
}
