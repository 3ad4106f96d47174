/* needle_site: what the needles of one body share. */
#include "needle_private.h"

#include "../softbody/body/body_guest.h"

#include <string.h>

/* Takes each edge once: at the tet about it whose slot is the lowest. */
NDLI_API double ndli_site_mean_edge(const ndli_topology *mesh)
{
    static const int pairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
    double sum = 0;
    int count = 0;
    for (int t = 0; t < mesh->tet_end; t++)
        for (int p = 0; p < 6 && mesh->tets[4 * (size_t)t] >= 0; p++) {
            int i = mesh->tets[4 * (size_t)t + (size_t)pairs[p][0]],
                j = mesh->tets[4 * (size_t)t + (size_t)pairs[p][1]];
            if (ndli_topology_first_tet(mesh, i, j) != t)
                continue;
            sum += (double)sb_v3_norm(sb_v3_sub(mesh->X[i], mesh->X[j]));
            count++;
        }
    return count ? sum / count : 0;
}

/* What there is to be done when the mesh changes the remesher does; a bed goes along with cuts alone. */
static void ndli_site_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    struct ndli_site *site = (struct ndli_site *)user;
    site->bed.is_lost |= change ? !change->find_cell : !sbi_body_has_finder(body); /* NULL: a state was loaded */
}

NDLI_API sb_result ndli_site_listen(struct ndli_site *site, sb_error *error)
{
    sb_body_listener listener;
    if (!sbi_body_is_live(site->body))
        return SB_OK;
    memset(&listener, 0, sizeof listener);
    listener.user = site;
    listener.follow = ndli_site_follow;
    return sb_body_listen(site->body, &listener, &site->listener, error);
}

NDLI_API void ndli_site_free(struct ndli_site *site)
{
    sb_allocator allocator = site->allocator;
    if (site->listener)
        sb_body_unlisten(site->body, site->listener);
    ndl_remesh_destroy(site->remesh);
    ndli_bed_free(&site->bed);
    ndli_bed_free(&site->next_bed);
    sbi_free(&allocator, site->node_place);
    sbi_free(&allocator, site->coupled);
    sbi_free(&allocator, site->unknown);
    for (int i = 0; i < NDLI_KEPT_COUNT; i++)
        sbi_free(&allocator, site->kept[i].bytes);
    sbi_free(&allocator, site);
}

NDLI_API int ndli_site_free_index(const struct ndli_site *site)
{
    int index = 0;
    while (site->needles[index])
        index++;
    return index;
}

NDLI_API int ndli_site_is_stale(const struct ndli_site *site)
{
    if (!site->embeds)
        return ndli_remesh_is_stale(site->remesh);
    return site->bed.version != sb_body_mesh_version(site->body) &&
           (site->bed.is_lost || !sbi_body_has_finder(site->body));
}

/* Of the mesh before any cut where that is known: it is the same whenever needles are made, and so for states. */
NDLI_API sb_result ndli_site_create_bed(const struct ndli_site *site, ndli_bed *bed, sb_error *error)
{
    return ndli_bed_create(site->body, site->body, sbi_body_has_uncut(site->body), &site->allocator, bed, error);
}

NDLI_API sb_result ndli_site_look(struct ndli_site *site, sb_error *error)
{
    ndli_bed fresh;
    sb_result result;
    if (!site->embeds)
        return ndli_remesh_look(site->remesh, error);
    if (!ndli_site_is_stale(site))
        return SB_OK;
    result = ndli_site_create_bed(site, &fresh, error);
    if (result != SB_OK)
        return result;
    ndli_bed_replace(&site->bed, &fresh);
    return SB_OK;
}

/* Nodes of the body that so many rod nodes may be at, or held by. */
static size_t ndli_site_row_nodes(const struct ndli_site *site, size_t rod_nodes)
{
    return site->embeds ? rod_nodes * (size_t)sb_mesh_element_width(&site->bed.mesh) : rod_nodes;
}

/* The numbers of the body's nodes, for all slots that there may be. */
NDLI_API int ndli_site_reserve_places(struct ndli_site *site)
{
    sbi_body_slots slots = sbi_body_node_slots(site->body);
    size_t room = (size_t)(sbi_body_is_live(site->body) ? slots.room : sb_body_node_count(site->body));
    int *grown;
    if (!site->embeds || room <= site->place_room)
        return 1;
    grown = (int *)sbi_alloc(&site->allocator, room, sizeof(int));
    if (!grown)
        return 0;
    for (size_t i = 0; i < room; i++)
        grown[i] = -1;
    ndli_held_forget(site);
    sbi_free(&site->allocator, site->node_place);
    site->node_place = grown;
    site->place_room = room;
    return 1;
}

NDLI_API int ndli_site_reserve(struct ndli_site *site, int more)
{
    size_t room = (size_t)more;
    int *coupled;
    double *unknown;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        room += site->needles[i] ? (size_t)site->needles[i]->rod->capacity : 0;
    if (!ndli_site_reserve_places(site))
        return 0;
    if (room <= site->node_room)
        return 1;
    ndli_held_forget(site);
    coupled = (int *)sbi_alloc(&site->allocator, ndli_site_row_nodes(site, room), sizeof(int));
    unknown = (double *)sbi_alloc(&site->allocator, room, NDLI_LINE_UNKNOWNS * sizeof(double));
    if (!coupled || !unknown) {
        sbi_free(&site->allocator, coupled);
        sbi_free(&site->allocator, unknown);
        return 0;
    }
    sbi_free(&site->allocator, site->coupled); /* they hold nothing between steps */
    sbi_free(&site->allocator, site->unknown);
    site->coupled = coupled;
    site->unknown = unknown;
    site->node_room = room;
    site->coupled_room = ndli_site_row_nodes(site, room);
    return 1;
}
