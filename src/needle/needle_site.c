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

/* By this call a body knows its needles: what there is to be done when the mesh changes the remesher does. */
static void ndli_site_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    (void)user;
    (void)body;
    (void)change;
}

NDLI_API struct ndli_site *ndli_needle_site(const sb_body *body)
{
    return (struct ndli_site *)sbi_body_find_listener(body, ndli_site_follow);
}

NDLI_API sb_result ndli_site_listen(struct ndli_site *site, sb_error *error)
{
    sb_body_listener listener;
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
    sbi_free(&allocator, site->coupled);
    sbi_free(&allocator, site->unknown);
    sbi_free(&allocator, site->undo);
    sbi_free(&allocator, site);
}

NDLI_API int ndli_site_free_index(const struct ndli_site *site)
{
    int index = 0;
    while (site->needles[index])
        index++;
    return index;
}

NDLI_API int ndli_site_reserve(struct ndli_site *site, int more)
{
    size_t room = (size_t)more;
    int *coupled;
    double *unknown;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        room += site->needles[i] ? (size_t)site->needles[i]->rod->capacity : 0;
    if (room <= site->node_room)
        return 1;
    coupled = (int *)sbi_alloc(&site->allocator, room, sizeof(int));
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
    return 1;
}
