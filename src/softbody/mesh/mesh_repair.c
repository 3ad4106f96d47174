/* mesh_repair: elements turned the right way, nodes merged, nodes and elements removed, coordinates scaled. */
#include "mesh_private.h"

/* ---- repairs: orientation ---- */

/* Mirrors an element's numbering; mid-edge nodes stay on their edges. */
static void sbi_mesh_mirror(sb_element_type type, int *nodes)
{
    switch (type) {
    case SB_TRI6:
        sbi_mesh_swap(nodes, 1, 2);
        sbi_mesh_swap(nodes, 3, 5); /* edges 01 and 20 */
        break;
    case SB_QUAD4: sbi_mesh_swap(nodes, 1, 3); break;
    case SB_QUAD8:
    case SB_QUAD9:
        sbi_mesh_swap(nodes, 1, 3);
        sbi_mesh_swap(nodes, 4, 7); /* edges 01 and 30 */
        sbi_mesh_swap(nodes, 5, 6);
        break;
    case SB_TET10:
        sbi_mesh_swap(nodes, 1, 2);
        sbi_mesh_swap(nodes, 4, 6); /* edges 01 and 02 */
        sbi_mesh_swap(nodes, 8, 9); /* edges 13 and 23 */
        break;
    case SB_TRI3:
    case SB_TET4: sbi_mesh_swap(nodes, 1, 2); break;
    case SB_HEX27:
        sbi_mesh_swap(nodes, 24, 25); /* faces z- and z+ */
    /* fall through */
    case SB_HEX20:
        for (int a = 8; a < 12; a++)
            sbi_mesh_swap(nodes, a, a + 4); /* edges of z- and z+ */
    /* fall through */
    case SB_HEX8:
        for (int a = 0; a < 4; a++)
            sbi_mesh_swap(nodes, a, a + 4);
        break;
    case SB_CUSTOM: /* its numbering is nobody's business */
    case SB_NO_ELEMENT: break;
    }
}

/* Sign of the straight-sided volume without over- or underflow; table: that of its straight element. */
static int sbi_mesh_is_inverted(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sbi_mesh_local local;
    sb_real volume = 0;
    sbi_mesh_local_make(mesh, element, &local);
    if (sb_element_straight(mesh->element_type) != SB_HEX8)
        return sbi_mesh_corner_det(local.x) < 0;
    for (int i = 0; i < table->count; i++)
        volume += sb_m3_det(sbi_mesh_jacobian(table, i, 8, local.x));
    return volume < 0;
}

/* Returns the number of elements that it mirrored. */
static int sbi_mesh_orient_solids(sb_mesh *mesh)
{
    sbi_mesh_table table;
    int count = 0;
    sbi_mesh_table_for_volume(&table, sbi_element_make(sb_element_straight(mesh->element_type), mesh->table));
    for (int e = 0; e < mesh->element_count && mesh->element_type != SB_CUSTOM; e++) {
        if (sbi_mesh_is_inverted(mesh, &table, e)) {
            sbi_mesh_mirror(mesh->element_type, sbi_mesh_element_to_edit(mesh, e));
            count++;
        }
    }
    return count;
}

SB_API sb_result sb_mesh_orient(sb_mesh *mesh, int *flipped, sb_error *error)
{
    int count;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) == 2)
        return sb_mesh_orient_surface(mesh, flipped, error);
    count = sbi_mesh_orient_solids(mesh);
    if (flipped)
        *flipped = count;
    return SB_OK;
}

/* Flooding of a surface: flip[e] is -1 before element e is reached. */
typedef struct sbi_mesh_flood {
    sbi_mesh_keys sides;
    int *mate;         /* [sides] */
    int *queue;        /* [elements] reached elements, part by part */
    signed char *flip; /* [elements] 1: to be mirrored */
} sbi_mesh_flood;

/* Reaches everything connected to element queue[begin] over edges of two elements. Returns the end of the
 * part in the queue, or -1 when the part is one-sided. */
static int sbi_mesh_flood_part(const sb_mesh *mesh, sbi_mesh_flood *flood, int begin)
{
    int end = begin + 1, per = flood->sides.per_element;
    flood->flip[flood->queue[begin]] = 0;
    for (int i = begin; i < end; i++) {
        int e = flood->queue[i];
        for (int side = 0; side < per; side++) {
            int mate = flood->mate[e * per + side], other = mate / per, clash, flip;
            if (mate < 0)
                continue;
            clash = sbi_mesh_edge_ascends(mesh, e, side) == sbi_mesh_edge_ascends(mesh, other, mate % per);
            flip = flood->flip[e] ^ clash;
            if (flood->flip[other] < 0) {
                flood->flip[other] = (signed char)flip;
                flood->queue[end++] = other;
            } else if (flood->flip[other] != flip) {
                return -1;
            }
        }
    }
    return end;
}

/* Decides whether the whole part queue[begin..end) must be mirrored on top, and returns its number of
 * flips. */
static int sbi_mesh_flood_turn(const sb_mesh *mesh, const sbi_mesh_table *table, sbi_mesh_flood *flood, int begin,
                               int end)
{
    int per = flood->sides.per_element, closed = 1, flips = 0, turn;
    double volume = 0, scale = 0, area, flux;
    sb_vec3 origin = mesh->nodes[sbi_mesh_element(mesh, flood->queue[begin])[0]];
    for (int i = begin; i < end; i++) {
        int e = flood->queue[i];
        flips += flood->flip[e];
        for (int side = 0; side < per; side++)
            closed = closed && flood->mate[e * per + side] >= 0;
        sbi_mesh_area_and_flux(mesh, table, e, origin, &area, &flux);
        volume += flood->flip[e] ? -flux : flux;
        scale += flux < 0 ? -flux : flux;
    }
    if (closed && (volume > 64 * (double)SB_EPSILON * scale || volume < -64 * (double)SB_EPSILON * scale))
        turn = volume < 0;
    else
        turn = flips > (end - begin) / 2;
    for (int i = begin; turn && i < end; i++)
        flood->flip[flood->queue[i]] ^= 1;
    return turn ? end - begin - flips : flips;
}

/* Returns the number of elements to mirror, or -1 for a one-sided surface. */
static int sbi_mesh_flood_all(const sb_mesh *mesh, sbi_mesh_flood *flood)
{
    sbi_mesh_table table;
    int count = 0, end = 0;
    sbi_mesh_table_for_volume(&table, sbi_mesh_element_kind(mesh));
    memset(flood->flip, -1, (size_t)mesh->element_count);
    for (int e = 0; e < mesh->element_count; e++) {
        int begin = end;
        if (flood->flip[e] >= 0)
            continue;
        flood->queue[begin] = e;
        end = sbi_mesh_flood_part(mesh, flood, begin);
        if (end < 0)
            return -1;
        count += sbi_mesh_flood_turn(mesh, &table, flood, begin, end);
    }
    return count;
}

SB_API sb_result sb_mesh_orient_surface(sb_mesh *mesh, int *flipped, sb_error *error)
{
    sbi_mesh_flood flood;
    int count = -1;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s is not a surface", sb_element_name(mesh->element_type));
    memset(&flood, 0, sizeof flood);
    flood.queue = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, sizeof(int));
    flood.flip = (signed char *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, 1);
    if (sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, &mesh->allocator, &flood.sides))
        flood.mate = sbi_mesh_mates(&flood.sides, &mesh->allocator);
    if (!flood.queue || !flood.flip || !flood.mate) {
        result = sbi_mesh_no_memory(error);
    } else {
        count = sbi_mesh_flood_all(mesh, &flood);
        if (count < 0)
            result = sbi_fail(error, SB_ERROR_MESH, "the surface is one-sided: it cannot be oriented");
    }
    for (int e = 0; result == SB_OK && e < mesh->element_count; e++)
        if (flood.flip[e])
            sbi_mesh_mirror(mesh->element_type, sbi_mesh_element_to_edit(mesh, e));
    if (result == SB_OK && flipped)
        *flipped = count;
    sbi_free(&mesh->allocator, flood.queue);
    sbi_free(&mesh->allocator, flood.flip);
    sbi_free(&mesh->allocator, flood.mate);
    sbi_mesh_keys_free(&mesh->allocator, &flood.sides);
    return result;
}

/* ---- repairs: removing nodes and elements ---- */

SB_API sb_result sb_mesh_merge_nodes(sb_mesh *mesh, sb_real tolerance, int *merged, sb_error *error)
{
    int *keep, count;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (!sb_is_finite(tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the merge tolerance is not finite");
    keep = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->node_count, sizeof(int));
    count = keep ? sbi_mesh_find_duplicates(mesh, tolerance, &mesh->allocator, keep) : -1;
    if (count < 0)
        result = sbi_mesh_no_memory(error);
    else if (count > 0)
        sbi_mesh_compact_nodes(mesh, keep);
    if (result == SB_OK && merged)
        *merged = count;
    sbi_free(&mesh->allocator, keep);
    return result;
}

SB_API sb_result sb_mesh_remove_unreferenced(sb_mesh *mesh, int *removed, sb_error *error)
{
    int *keep, count;
    size_t indices;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    keep = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->node_count, sizeof(int));
    if (!keep)
        return sbi_mesh_no_memory(error);
    indices = (size_t)mesh->element_count * (size_t)sb_mesh_element_width(mesh);
    for (int v = 0; v < mesh->node_count; v++)
        keep[v] = -1;
    for (size_t i = 0; i < indices; i++)
        keep[mesh->elements[i]] = mesh->elements[i];
    count = sbi_mesh_compact_nodes(mesh, keep);
    if (removed)
        *removed = count;
    sbi_free(&mesh->allocator, keep);
    return SB_OK;
}

/* Keeps the elements that `drop` does not mark, with their regions. */
static void sbi_mesh_compact_elements(sb_mesh *mesh, const unsigned char *drop)
{
    size_t n = (size_t)sb_mesh_element_width(mesh);
    int kept = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        if (drop[e])
            continue;
        memmove(mesh->elements + (size_t)kept * n, mesh->elements + (size_t)e * n, sizeof(int) * n);
        if (mesh->regions)
            mesh->regions[kept] = mesh->regions[e];
        kept++;
    }
    mesh->element_count = kept;
}

SB_API sb_result sb_mesh_remove_duplicate_elements(sb_mesh *mesh, int *removed, sb_error *error)
{
    sbi_mesh_keys whole;
    unsigned char *drop;
    int count = 0;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    drop = (unsigned char *)sbi_alloc_zeroed(&mesh->allocator, (size_t)mesh->element_count, 1);
    if (!drop || !sbi_mesh_keys_make(mesh, SBI_MESH_WHOLE, NULL, &mesh->allocator, &whole)) {
        sbi_free(&mesh->allocator, drop);
        return sbi_mesh_no_memory(error);
    }
    for (int begin = 0, end; begin < whole.sorted; begin = end) {
        end = sbi_mesh_run_end(&whole, begin);
        for (int i = begin + 1; i < end; i++)
            drop[whole.order[i]] = 1;
        count += end - begin - 1;
    }
    sbi_mesh_compact_elements(mesh, drop);
    if (removed)
        *removed = count;
    sbi_mesh_keys_free(&mesh->allocator, &whole);
    sbi_free(&mesh->allocator, drop);
    return SB_OK;
}

SB_API sb_result sb_mesh_scale(sb_mesh *mesh, sb_real factor, sb_error *error)
{
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    if (result != SB_OK)
        return result;
    if (!(factor > 0) || !sb_is_finite(factor))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale factor must be positive and finite");
    for (int v = 0; v < mesh->node_count; v++)
        if (!sb_is_finite(factor * sbi_mesh_max_abs(mesh->nodes[v])))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, v, "node %d would not be finite after scaling", v);
    for (int v = 0; v < mesh->node_count; v++)
        mesh->nodes[v] = sb_v3_scale(factor, mesh->nodes[v]);
    return SB_OK;
}
