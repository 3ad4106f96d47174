/* mesh_check: validation, which names bad elements, and the report of everything suspicious. */
#include "mesh_private.h"

#include <stdio.h>

#define SBI_MESH_LISTED 8 /* elements that an error message names */

/* ---- validation ---- */

/* The elements with one kind of defect: how many, and the first few. */
typedef struct sbi_mesh_offenders {
    int count;
    int first[SBI_MESH_LISTED];
} sbi_mesh_offenders;

static const char *sbi_mesh_defect_text(sb_mesh_defect defect)
{
    switch (defect) {
    case SB_MESH_INDEX_RANGE: return "with a node index out of range";
    case SB_MESH_NODE_NOT_FINITE: return "with a node that is not finite";
    case SB_MESH_REPEATED_NODE: return "with a node used twice";
    case SB_MESH_INVERTED: return "inverted (negative volume)";
    case SB_MESH_FLAT: return "flat (zero volume)";
    case SB_MESH_BAD_MIDSIDE: return "folded by a misplaced mid-edge node";
    case SB_MESH_DUPLICATE: return "with the corners of an element before it";
    case SB_MESH_SOUND:
    case SB_MESH_DEFECT_COUNT: break;
    }
    return "sound";
}

/* "3 elements inverted (negative volume): 3, 17, 40" */
static sb_result sbi_mesh_fail_elements(const sb_mesh *mesh, const sbi_mesh_offenders *offenders, sb_mesh_defect defect,
                                        sb_error *error)
{
    char list[16 * SBI_MESH_LISTED], index_text[64];
    size_t used = 0;
    int listed = offenders->count < SBI_MESH_LISTED ? offenders->count : SBI_MESH_LISTED, index = 0;
    list[0] = index_text[0] = 0;
    for (int i = 0; i < listed; i++)
        used += (size_t)snprintf(list + used, sizeof list - used, "%s%d", i ? ", " : "", offenders->first[i]);
    if (defect == SB_MESH_INDEX_RANGE && sbi_mesh_index_out_of_range(mesh, offenders->first[0], &index))
        snprintf(index_text, sizeof index_text, " (the first: %d of %d nodes)", index, mesh->node_count);
    return sbi_fail_element(error, defect == SB_MESH_INDEX_RANGE ? SB_ERROR_INDEX : SB_ERROR_MESH, offenders->first[0],
                            "%d element%s %s%s: %s%s", offenders->count, offenders->count == 1 ? "" : "s",
                            sbi_mesh_defect_text(defect), index_text, list, offenders->count > listed ? ", ..." : "");
}

SB_API sb_result sb_mesh_validate(const sb_mesh *mesh, sb_error *error)
{
    static const sb_mesh_defect order[] = {SB_MESH_INDEX_RANGE, SB_MESH_REPEATED_NODE, SB_MESH_INVERTED, SB_MESH_FLAT,
                                           SB_MESH_BAD_MIDSIDE};
    sbi_mesh_offenders found[SB_MESH_DEFECT_COUNT];
    sbi_mesh_table table;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    if (result != SB_OK)
        return result;
    memset(found, 0, sizeof found);
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        sb_mesh_defect defect = sbi_mesh_element_defect(mesh, &table, e);
        if (found[defect].count < SBI_MESH_LISTED)
            found[defect].first[found[defect].count] = e;
        found[defect].count++;
    }
    if (sb_element_dimension(mesh->element_type) == 2)
        found[SB_MESH_FLAT].count = 0; /* a sliver triangle harms no target or visual surface */
    for (size_t i = 0; i < sizeof order / sizeof order[0]; i++)
        if (found[order[i]].count)
            return sbi_mesh_fail_elements(mesh, &found[order[i]], order[i], error);
    return SB_OK;
}

/* ---- the report ---- */

SB_API void sb_mesh_report_free(sb_mesh_report *report)
{
    if (!report)
        return;
    sbi_free(&report->allocator, report->bad);
    memset(report, 0, sizeof *report);
}

/* Scratch of a check, released in one place. */
typedef struct sbi_mesh_check_scratch {
    unsigned char *defect; /* [elements] sb_mesh_defect */
    unsigned char *skip;   /* [elements] 1: no part in the topology */
    int *per_node;         /* [nodes] */
    int *per_element;      /* [elements] */
    sbi_mesh_keys sides, whole;
} sbi_mesh_check_scratch;

static void sbi_mesh_check_release(const sb_allocator *allocator, sbi_mesh_check_scratch *scratch)
{
    sbi_free(allocator, scratch->defect);
    sbi_free(allocator, scratch->skip);
    sbi_free(allocator, scratch->per_node);
    sbi_free(allocator, scratch->per_element);
    sbi_mesh_keys_free(allocator, &scratch->sides);
    sbi_mesh_keys_free(allocator, &scratch->whole);
}

static int sbi_mesh_check_allocate(const sb_mesh *mesh, const sb_allocator *allocator, sbi_mesh_check_scratch *scratch)
{
    memset(scratch, 0, sizeof *scratch);
    scratch->defect = (unsigned char *)sbi_alloc(allocator, (size_t)mesh->element_count, 1);
    scratch->skip = (unsigned char *)sbi_alloc(allocator, (size_t)mesh->element_count, 1);
    scratch->per_node = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    scratch->per_element = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, sizeof(int));
    return scratch->defect && scratch->skip && scratch->per_node && scratch->per_element;
}

/* Sorts out the elements: what each has by itself, then the repetitions of earlier ones. */
static int sbi_mesh_check_elements(const sb_mesh *mesh, const sb_allocator *allocator, sbi_mesh_check_scratch *scratch)
{
    sbi_mesh_table table;
    sbi_mesh_keys *whole = &scratch->whole;
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        sb_mesh_defect defect = sbi_mesh_element_defect(mesh, &table, e);
        scratch->defect[e] = (unsigned char)defect;
        scratch->skip[e] = defect == SB_MESH_INDEX_RANGE || defect == SB_MESH_REPEATED_NODE;
    }
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_WHOLE, scratch->skip, allocator, whole))
        return 0;
    for (int begin = 0, end; begin < whole->sorted; begin = end) {
        end = sbi_mesh_run_end(whole, begin);
        for (int i = begin + 1; i < end; i++)
            if (scratch->defect[whole->order[i]] == SB_MESH_SOUND)
                scratch->defect[whole->order[i]] = SB_MESH_DUPLICATE;
    }
    return 1;
}

static int sbi_mesh_check_list_bad(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    for (int e = 0; e < mesh->element_count; e++)
        report->defect_count[defect[e]]++;
    report->bad_count = mesh->element_count - report->defect_count[SB_MESH_SOUND];
    report->bad =
        (sb_mesh_bad_element *)sbi_alloc(&report->allocator, (size_t)report->bad_count, sizeof(sb_mesh_bad_element));
    if (!report->bad)
        return 0;
    for (int e = 0, i = 0; e < mesh->element_count; e++) {
        if (defect[e] != SB_MESH_SOUND) {
            report->bad[i].element = e;
            report->bad[i++].defect = (sb_mesh_defect)defect[e];
        }
    }
    return 1;
}

static int sbi_mesh_check_nodes_of_report(const sb_mesh *mesh, const sb_allocator *allocator,
                                          sbi_mesh_check_scratch *scratch, sb_mesh_report *report)
{
    int n = sb_mesh_element_width(mesh), *used = scratch->per_node;
    report->first_not_finite_node = report->first_unreferenced_node = -1;
    memset(used, 0, sizeof(int) * (size_t)mesh->node_count);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int a = 0; a < n; a++)
            if (nodes[a] >= 0 && nodes[a] < mesh->node_count)
                used[nodes[a]] = 1;
    }
    for (int v = mesh->node_count - 1; v >= 0; v--) {
        if (!used[v])
            report->unreferenced_nodes++, report->first_unreferenced_node = v;
        if (!sb_v3_is_finite(mesh->nodes[v]))
            report->not_finite_nodes++, report->first_not_finite_node = v;
    }
    report->duplicate_nodes = sbi_mesh_find_duplicates(mesh, -1, allocator, scratch->per_node);
    return report->duplicate_nodes >= 0;
}

static void sbi_mesh_check_sides(const sb_mesh *mesh, const sbi_mesh_keys *sides, sb_mesh_report *report)
{
    int surface = sb_element_dimension(mesh->element_type) == 2;
    for (int begin = 0, end; begin < sides->sorted; begin = end) {
        end = sbi_mesh_run_end(sides, begin);
        if (end == begin + 1)
            (*(surface ? &report->open_edges : &report->boundary_faces))++;
        if (end > begin + 2)
            (*(surface ? &report->nonmanifold_edges : &report->nonmanifold_faces))++;
        if (surface && end == begin + 2) {
            int p = sides->order[begin], q = sides->order[begin + 1], per = sides->per_element;
            report->inconsistent_edges +=
                sbi_mesh_edge_ascends(mesh, p / per, p % per) == sbi_mesh_edge_ascends(mesh, q / per, q % per);
        }
    }
}

/* Corners of surface elements that share an edge form fans around its ends; a node with two fans is where
 * parts touch in a point only. Corner c of element e is number e * corners + c; edge i joins corners i and i
 * + 1. */
static int sbi_mesh_count_pinched(const sb_mesh *mesh, const sbi_mesh_keys *sides, const unsigned char *skip,
                                  const sb_allocator *allocator, int *fans)
{
    int corners = sides->per_element, pinched = 0;
    int *parent = (int *)sbi_alloc(allocator, (size_t)sides->count, sizeof(int));
    if (!parent)
        return -1;
    for (int i = 0; i < sides->count; i++)
        parent[i] = i;
    for (int begin = 0, end; begin < sides->sorted; begin = end) {
        int p = sides->order[begin], p_up = sbi_mesh_edge_ascends(mesh, p / corners, p % corners);
        end = sbi_mesh_run_end(sides, begin);
        for (int i = begin + 1; i < end; i++) {
            int q = sides->order[i], q_up = sbi_mesh_edge_ascends(mesh, q / corners, q % corners);
            int p_next = p - p % corners + (p % corners + 1) % corners;
            int q_next = q - q % corners + (q % corners + 1) % corners;
            sbi_mesh_unite(parent, p, p_up == q_up ? q : q_next);
            sbi_mesh_unite(parent, p_next, p_up == q_up ? q_next : q);
        }
    }
    memset(fans, 0, sizeof(int) * (size_t)mesh->node_count);
    for (int i = 0; i < sides->count; i++)
        if (!skip[i / corners] && parent[i] == i)
            pinched += ++fans[sbi_mesh_element(mesh, i / corners)[i % corners]] == 2;
    sbi_free(allocator, parent);
    return pinched;
}

static void sbi_mesh_check_edge_lengths(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    int ends[3] = {0, 0, 0}, found = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        if (defect[e] >= SB_MESH_INDEX_RANGE && defect[e] <= SB_MESH_REPEATED_NODE)
            continue;
        for (int i = 0; sbi_element_edge(sbi_mesh_element_kind(mesh), i, ends); i++) {
            sb_real length = sb_v3_norm(sb_v3_sub(mesh->nodes[nodes[ends[1]]], mesh->nodes[nodes[ends[0]]]));
            report->min_edge = found ? sb_min(report->min_edge, length) : length;
            report->max_edge = found ? sb_max(report->max_edge, length) : length;
            found = 1;
        }
    }
}

static void sbi_mesh_check_quality(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    sbi_mesh_table table;
    report->worst_element = -1;
    sbi_mesh_table_for_checks(&table, sbi_mesh_element_kind(mesh));
    for (int e = 0; e < mesh->element_count; e++) {
        sb_real quality = defect[e] == SB_MESH_SOUND ? sbi_mesh_quality_of(mesh, &table, e) : (sb_real)0;
        if (defect[e] == SB_MESH_SOUND && (report->worst_element < 0 || quality < report->worst_quality)) {
            report->worst_element = e;
            report->worst_quality = quality;
        }
    }
}

/* One after the other: the tables of both at once would take most of the stack that the header promises to do with. */
static void sbi_mesh_check_geometry(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    double area, volume;
    sbi_mesh_check_quality(mesh, defect, report);
    sbi_mesh_measure(mesh, defect, &area, &volume);
    report->area = (sb_real)area;
    report->volume = (sb_real)volume;
    sbi_mesh_check_edge_lengths(mesh, defect, report);
}

/* Fills the report; 0 when memory is short. */
static int sbi_mesh_check_all(const sb_mesh *mesh, const sb_allocator *allocator, sbi_mesh_check_scratch *scratch,
                              sb_mesh_report *report)
{
    if (!sbi_mesh_check_allocate(mesh, allocator, scratch) || !sbi_mesh_check_elements(mesh, allocator, scratch) ||
        !sbi_mesh_check_nodes_of_report(mesh, allocator, scratch, report) ||
        !sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, scratch->skip, allocator, &scratch->sides))
        return 0;
    sbi_mesh_check_geometry(mesh, scratch->defect, report);
    sbi_mesh_check_sides(mesh, &scratch->sides, report);
    report->components = sbi_mesh_label_components(mesh, scratch->skip, scratch->per_element, scratch->per_node);
    if (sb_element_dimension(mesh->element_type) == 2)
        report->nonmanifold_vertices =
            sbi_mesh_count_pinched(mesh, &scratch->sides, scratch->skip, allocator, scratch->per_node);
    return report->nonmanifold_vertices >= 0 && sbi_mesh_check_list_bad(mesh, scratch->defect, report);
}

SB_API sb_result sb_mesh_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh_report *report,
                               sb_error *error)
{
    sb_mesh_report made;
    sbi_mesh_check_scratch scratch;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_ERROR_MESH)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "nothing to check: the mesh is empty");
    if (result == SB_OK && !report)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "report is NULL");
    if (result == SB_OK)
        result = sbi_mesh_check_has_shape(mesh, error);
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    sbi_mesh_set_allocator(&made.allocator, allocator);
    if (sbi_mesh_check_all(mesh, allocator, &scratch, &made))
        *report = made;
    else
        result = sbi_mesh_no_memory(error);
    sbi_mesh_check_release(allocator, &scratch);
    return result;
}
