/* Targets: mesh files in memory, each reader through its own door, and the mesh that comes out is used. */
#ifndef TARGET_MESH_H
#define TARGET_MESH_H

#include "fuzz.h"

static void fuzz_use_mesh(sb_mesh *mesh)
{
    sb_mesh_report report;
    sb_boundary boundary;
    sb_vec3 low, high;
    sb_real sum = 0;
    int nodes = sb_element_node_count(mesh->element_type), volume = sb_element_dimension(mesh->element_type) == 3;
    sb_result valid = sb_mesh_validate(mesh, NULL);
    FUZZ_REQUIRE(valid == SB_OK || (!volume && valid == SB_ERROR_MESH));
    for (int i = 0; i < mesh->element_count; i++) {
        sum += sb_mesh_element_quality(mesh, i);
        for (int k = 0; k < nodes; k++)
            sum += mesh->nodes[mesh->elements[(size_t)i * (size_t)nodes + (size_t)k]].x;
        sum += (sb_real)(mesh->regions ? mesh->regions[i] & 1 : 0);
    }
    sb_mesh_bounds(mesh, &low, &high);
    FUZZ_REQUIRE(sb_v3_is_finite(low) && sb_v3_is_finite(high) && (sum <= 0 || sum > 0 || sum - sum != 0));
    if (sb_mesh_check(mesh, NULL, &report, NULL) == SB_OK)
        sb_mesh_report_free(&report);
    if (volume && sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL) == SB_OK) {
        FUZZ_REQUIRE(sb_mesh_save_stl("/dev/null", &boundary.surface, NULL) != SB_ERROR_INDEX);
        sb_boundary_free(&boundary);
    }
    FUZZ_REQUIRE(sb_mesh_save_vtk("/dev/null", mesh, NULL, 0, NULL) == SB_OK);
}

/* What loading gave: an error that says something, or a mesh that can be used. */
static void fuzz_take_mesh(sb_result result, sb_mesh *mesh, const sb_error *error)
{
    if (result != SB_OK) {
        FUZZ_REQUIRE(mesh->nodes == NULL && mesh->elements == NULL);
        FUZZ_REQUIRE(error->result == result && error->message[0]);
        return;
    }
    fuzz_use_mesh(mesh);
    sb_mesh_free(mesh);
}

/* Sets name what is there, in order. */
static void fuzz_use_sets(const sb_mesh *mesh, sb_mesh_sets *sets)
{
    for (int i = 0; i < sets->count; i++) {
        const sb_mesh_set *set = &sets->sets[i];
        FUZZ_REQUIRE(memchr(set->name, 0, sizeof set->name) != NULL && set->dimension >= 0 && set->dimension <= 3);
        FUZZ_REQUIRE(sb_mesh_sets_find(sets, set->name, set->dimension) != NULL);
        for (int k = 0; k < set->node_count; k++)
            FUZZ_REQUIRE(set->nodes[k] < mesh->node_count && set->nodes[k] > (k ? set->nodes[k - 1] : -1));
        for (int k = 0; k < set->element_count; k++)
            FUZZ_REQUIRE(set->elements[k] < mesh->element_count && set->elements[k] > (k ? set->elements[k - 1] : -1));
        for (int k = 0; k < set->face_count * set->face_corners; k++)
            FUZZ_REQUIRE(set->faces[k] >= 0 && set->faces[k] < mesh->node_count);
    }
    sb_mesh_sets_free(sets);
}

static void fuzz_load(const uint8_t *data, size_t size, sb_file_format format)
{
    sb_mesh mesh;
    sb_error error;
    sb_load_report report;
    sb_load_options options = sb_default_load_options();
    sb_mesh_sets sets;
    sb_result result;
    options.fix_orientation = (int)(size & 1);
    options.report = &report;
    options.sets = size & 2 ? &sets : NULL;
    memset(&mesh, 0, sizeof mesh);
    result = sb_mesh_load_memory(&mesh, data, size, format, "fuzz", &options, &error);
    if (result == SB_OK) {
        FUZZ_REQUIRE(report.unreferenced_nodes >= 0 && report.unreferenced_nodes <= mesh.node_count);
        FUZZ_REQUIRE(report.note_count >= 0 && report.note_count <= SB_LOAD_NOTES);
        if (options.sets)
            fuzz_use_sets(&mesh, &sets);
    }
    fuzz_take_mesh(result, &mesh, &error);
}

static void fuzz_vtk(const uint8_t *data, size_t size) { fuzz_load(data, size, SB_FILE_VTK); }
static void fuzz_gmsh(const uint8_t *data, size_t size) { fuzz_load(data, size, SB_FILE_GMSH); }
static void fuzz_vtu(const uint8_t *data, size_t size) { fuzz_load(data, size, SB_FILE_VTU); }
static void fuzz_medit(const uint8_t *data, size_t size) { fuzz_load(data, size, SB_FILE_MEDIT); }
/* The reader that the content tells. */
static void fuzz_mesh(const uint8_t *data, size_t size) { fuzz_load(data, size, SB_FILE_AUTO); }

/* OBJ, STL, PLY or OFF, as the first byte says. */
static void fuzz_surface(const uint8_t *data, size_t size)
{
    if (size > 0)
        fuzz_load(data + 1, size - 1, (sb_file_format)(SB_FILE_OBJ + data[0] % 4));
}

/* A .node and an .ele file with a form feed between them. */
static void fuzz_tetgen(const uint8_t *data, size_t size)
{
    const uint8_t *cut = size ? (const uint8_t *)memchr(data, '\f', size) : NULL;
    size_t first = cut ? (size_t)(cut - data) : size, second = cut ? size - first - 1 : 0;
    const char *nodes = first ? (const char *)data : "", *elements = second ? (const char *)cut + 1 : "";
    sb_load_options options = sb_default_load_options();
    sb_mesh mesh;
    sb_error error;
    sbi_loader loader;
    int64_t base = 0;
    sb_result result;
    memset(&mesh, 0, sizeof mesh);
    sbi_loader_init(&loader, &options, &error);
    sbi_loader_set_content(&loader, nodes, first, "fuzz.node");
    result = sbi_tetgen_read_nodes(&loader, &base);
    if (result == SB_OK) {
        sbi_loader_set_content(&loader, elements, second, "fuzz.ele");
        result = sbi_tetgen_read_elements(&loader, base);
    }
    if (result == SB_OK)
        result = sbi_meshio_finish(&loader, &options, SB_FILE_TETGEN, &mesh);
    fuzz_take_mesh(result, &mesh, &error);
    sbi_loader_free(&loader);
}

/* Label images of every format, and the surface and regions that come of them. */
static void fuzz_image(const uint8_t *data, size_t size)
{
    sb_image image;
    sb_error error;
    sb_label_def def = sb_default_label_def();
    sb_mesh mesh, tets;
    sb_surface_report found;
    size_t voxels;
    sb_result result;
    memset(&image, 0, sizeof image);
    result = sb_image_load_memory(&image, data, size, "fuzz", NULL, &error);
    if (result != SB_OK) {
        FUZZ_REQUIRE(image.labels == NULL && error.result == result && error.message[0]);
        return;
    }
    FUZZ_REQUIRE(sb_image_check(&image, NULL) == SB_OK);
    voxels = (size_t)image.counts[0] * (size_t)image.counts[1] * (size_t)image.counts[2];
    FUZZ_REQUIRE(voxels <= 8 * 1032 * size); /* what deflate packs best */
    def.image = &image;
    def.smoothing = (int)(size % 3);
    if (voxels <= 4096 && sb_image_surface(&def, &mesh, NULL, NULL) == SB_OK) {
        if (sb_surface_check(&mesh, NULL, &found, NULL) == SB_OK)
            FUZZ_REQUIRE((found.findings & (SB_SURFACE_OPEN_EDGES | SB_SURFACE_FLIPPED | SB_SURFACE_NONMANIFOLD_EDGES |
                                            SB_SURFACE_NONMANIFOLD_NODES)) == 0);
        sb_mesh_free(&mesh);
    }
    if (sb_mesh_organ(SB_TET4, 3, NULL, &tets, NULL) == SB_OK) {
        FUZZ_REQUIRE(sb_image_set_regions(&image, &tets, NULL) == SB_OK && tets.regions != NULL);
        sb_mesh_free(&tets);
    }
    sb_image_free(&image);
}

#endif /* TARGET_MESH_H */
