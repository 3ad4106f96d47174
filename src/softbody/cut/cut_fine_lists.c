/* cut_fine_lists: vertices and triangles of a fine skin, one behind the other, and what hangs together of them. */
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

SBI_API void sbi_fine_free_triangles(const sb_allocator *allocator, sbi_fine_arrays *arrays)
{
    sbi_free(allocator, arrays->triangles);
    sbi_free(allocator, arrays->tags);
    sbi_free(allocator, arrays->cells);
}

SBI_API int sbi_fine_take_triangles(const sb_allocator *allocator, sbi_fine_arrays *arrays, size_t count)
{
    arrays->triangles = (int(*)[3])sbi_alloc(allocator, count, sizeof *arrays->triangles);
    arrays->tags = (unsigned char *)sbi_alloc(allocator, count, 1);
    arrays->cells = (int *)sbi_alloc(allocator, count, sizeof(int));
    return arrays->triangles && arrays->tags && arrays->cells;
}

SBI_API int sbi_fine_reserve_triangles(sb_cut_fine *fine, int more)
{
    sbi_fine_arrays *next = &fine->next, grown;
    int64_t room = (int64_t)next->triangle_count + more;
    size_t count = (size_t)next->triangle_count;
    if (room <= next->triangle_room)
        return 1;
    room += room / 4;
    memset(&grown, 0, sizeof grown);
    if (room > INT32_MAX || !sbi_fine_take_triangles(&fine->allocator, &grown, (size_t)room)) {
        sbi_fine_free_triangles(&fine->allocator, &grown);
        return 0;
    }
    memcpy(grown.triangles, next->triangles, count * sizeof *grown.triangles);
    memcpy(grown.tags, next->tags, count);
    memcpy(grown.cells, next->cells, count * sizeof(int));
    sbi_fine_free_triangles(&fine->allocator, next);
    next->triangles = grown.triangles;
    next->tags = grown.tags;
    next->cells = grown.cells;
    next->triangle_room = (int)room;
    return 1;
}

SBI_API int sbi_fine_are_apart(const sb_cut *cut, const sbi_fine_place *p, const sbi_fine_place *q)
{
    const int *first = cut->tets + 4 * (size_t)p->tet, *last = cut->tets + 4 * (size_t)q->tet;
    const int *of_first, *of_last, *parts = cut->body->node_component;
    int meet = 0;
    if (p->cell < 0 || q->cell < 0 || p->tet == q->tet)
        return p->cell != q->cell;
    of_first = sb_body_cell_nodes(cut->body, p->cell);
    of_last = sb_body_cell_nodes(cut->body, q->cell);
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 4; b++) {
            if (first[a] != last[b])
                continue;
            if (of_first[a] != of_last[b])
                return 1;
            meet = 1;
        }
    return !meet && parts[of_first[0]] != parts[of_last[0]];
}
