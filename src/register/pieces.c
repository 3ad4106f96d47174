/* pieces: see pieces.h. */
#include "pieces.h"

#include <string.h>

REGI_API sb_result regi_pieces_make(const sb_body *body, const sb_mesh *mesh, const sb_allocator *allocator,
                                    regi_pieces *pieces, sb_error *error)
{
    memset(pieces, 0, sizeof *pieces);
    pieces->body = body;
    pieces->mesh = mesh;
    pieces->allocator = *allocator;
    if (!sbi_body_has_pieces(body))
        return SB_OK;
    pieces->cells = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, sizeof(int));
    if (!pieces->cells)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a body");
    sbi_body_list_cells(body, pieces->cells);
    return SB_OK;
}

REGI_API void regi_pieces_free(regi_pieces *pieces)
{
    if (pieces->cells)
        sbi_free(&pieces->allocator, pieces->cells);
    memset(pieces, 0, sizeof *pieces);
}

REGI_API int regi_pieces_find(const regi_pieces *pieces, int element, const sb_real xi[3])
{
    int low = 0, high = pieces->mesh->element_count - 1, cell;
    if (!pieces->cells)
        return element;
    cell = sb_body_find_cell(pieces->body, pieces->cells[element], xi);
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (pieces->cells[middle] < cell)
            low = middle + 1;
        else
            high = middle;
    }
    return pieces->cells[low] == cell ? low : element;
}

/* ---- the skin ---- */

/* Keeps the faces that have no node in lost[nodes]. */
static void regi_pieces_drop_faces(const unsigned char *lost, sb_boundary *skin)
{
    sb_mesh *surface = &skin->surface;
    size_t width = (size_t)sb_mesh_element_width(surface);
    int kept = 0;
    for (int f = 0; f < surface->element_count; f++) {
        const int *nodes = surface->elements + width * (size_t)f;
        int whole = 1;
        for (size_t a = 0; a < width; a++)
            whole &= !lost[nodes[a]];
        if (!whole)
            continue;
        memmove(surface->elements + width * (size_t)kept, nodes, width * sizeof(int));
        if (skin->elements) {
            skin->elements[kept] = skin->elements[f];
            skin->faces[kept] = skin->faces[f];
        }
        kept++;
    }
    surface->element_count = kept;
}

/* Marks what an embedding says of the nodes: taken out of the mesh that it is of. */
static sb_result regi_pieces_mark(const regi_pieces *pieces, const sb_mesh *mesh, const int *cells,
                                  const sb_mesh *surface, unsigned char *lost, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    embed.mesh = mesh;
    embed.points = surface->nodes;
    embed.point_count = surface->node_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.allocator = pieces->allocator;
    embed.jobs = *sbi_body_jobs(pieces->body);
    result = sb_embedding_create(&embed, &embedding, error);
    for (int i = 0; i < surface->node_count && result == SB_OK; i++) {
        sb_embedded_point point;
        (void)sb_embedding_get_point(embedding, i, &point);
        lost[i] =
            sbi_body_find_holder(pieces->body, mesh, point.element, cells ? cells[point.element] : 0, point.xi) < 0;
    }
    sb_embedding_destroy(embedding);
    return result;
}

static sb_result regi_pieces_drop_lost(const regi_pieces *pieces, const sb_mesh *mesh, const int *cells,
                                       sb_boundary *skin, sb_error *error)
{
    unsigned char *lost =
        (unsigned char *)sbi_alloc_zeroed(&pieces->allocator, (size_t)skin->surface.node_count, sizeof *lost);
    sb_result result = lost ? regi_pieces_mark(pieces, mesh, cells, &skin->surface, lost, error)
                            : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the skin of a body");
    if (result == SB_OK)
        regi_pieces_drop_faces(lost, skin);
    sbi_free(&pieces->allocator, lost);
    return result;
}

/* The boundary of the mesh before it was cut; its nodes are the body's. */
static sb_result regi_pieces_first_skin(const regi_pieces *pieces, sb_boundary *skin, sb_error *error)
{
    sb_mesh first;
    int *cells = NULL;
    sb_result result = sbi_body_copy_uncut(pieces->body, pieces->body, &pieces->allocator, &first, &cells, error);
    if (result != SB_OK)
        return result;
    result = sb_mesh_boundary(&first, 1, &pieces->allocator, skin, error);
    if (result == SB_OK && (result = regi_pieces_drop_lost(pieces, &first, cells, skin, error)) != SB_OK)
        sb_boundary_free(skin);
    sbi_free(&pieces->allocator, cells);
    sb_mesh_free(&first);
    return result;
}

REGI_API sb_result regi_pieces_skin(const regi_pieces *pieces, const sb_mesh *surface, sb_boundary *skin,
                                    sb_error *error)
{
    sb_result result;
    memset(skin, 0, sizeof *skin);
    if (!surface)
        return pieces->cells && sbi_body_has_uncut(pieces->body)
                   ? regi_pieces_first_skin(pieces, skin, error)
                   : sb_mesh_boundary(pieces->mesh, 1, &pieces->allocator, skin, error);
    result = sb_mesh_copy(surface, &pieces->allocator, &skin->surface, error);
    if (result == SB_OK && pieces->cells &&
        (result = regi_pieces_drop_lost(pieces, pieces->mesh, pieces->cells, skin, error)) != SB_OK)
        sb_boundary_free(skin);
    return result;
}
