/* cut_fine_lists: vertices and triangles of a fine skin, one behind the other. */
#include <string.h>

#include "cut_fine_private.h"

SBI_API int sbi_fine_add_vertex(sb_cut_fine *fine, const sbi_fine_place *place, const sb_cut_fine_source *source,
                                sb_vec3 rest)
{
    sbi_fine_arrays *next = &fine->next;
    const int *nodes = fine->cut->tets + 4 * (size_t)place->tet;
    int vertex = next->vertex_count++;
    sb_cut_origin *origin = next->origins + vertex;
    SB_ASSERT(vertex < next->vertex_room);
    next->places[vertex] = *place;
    next->sources[vertex] = *source;
    next->rest[vertex] = rest;
    next->points[vertex] = vertex;
    next->texture[vertex][0] = next->texture[vertex][1] = 0;
    origin->element = place->cell < 0 ? -1 : place->tet;
    memcpy(origin->nodes, nodes, sizeof origin->nodes);
    memcpy(origin->weights, place->at, sizeof origin->weights);
    return vertex;
}

SBI_API void sbi_fine_add_triangle(sb_cut_fine *fine, int a, int b, int c, int tag, int cell)
{
    sbi_fine_arrays *next = &fine->next;
    int *triangle = next->triangles[next->triangle_count];
    SB_ASSERT(next->triangle_count < next->triangle_room);
    triangle[0] = a, triangle[1] = b, triangle[2] = c;
    next->tags[next->triangle_count] = (unsigned char)tag;
    next->cells[next->triangle_count++] = cell;
}
