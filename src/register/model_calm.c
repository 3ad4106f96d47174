/* model_calm: where an organ gives way so much that loads as elsewhere would move it beyond reason. */
#include <math.h>
#include <string.h>

#include "chance.h"
#include "cloud.h"
#include "response.h"

enum { REGI_CALM_DRAWS = 16 };

/* So many times as far as half of the surface under the same loads a place may move before it bears less of them.
 * Livers come to 3.7 to 4.5 at their tips, ears of a bunny to 54. */
#define REGI_CALM_MOST 3

typedef struct regi_calm {
    regi_response response;
    sb_vec3 *moved;     /* [DRAWS][nodes] */
    sb_vec3 *tractions; /* [c] */
    double *squares;    /* [c] m^2 */
    sb_real *sort;      /* [c] */
} regi_calm;

static void regi_calm_layout(regi_calm *calm, const reg_model *model, sbi_arena *arena)
{
    size_t n = (size_t)model->mesh.node_count, c = (size_t)model->prior.control_count;
    regi_response_layout(&calm->response, model->mesh.node_count, arena);
    calm->moved = (sb_vec3 *)sbi_arena_take(arena, n, (size_t)REGI_CALM_DRAWS * sizeof(sb_vec3));
    calm->tractions = (sb_vec3 *)sbi_arena_take(arena, c, sizeof(sb_vec3));
    calm->squares = (double *)sbi_arena_take(arena, c, sizeof(double));
    calm->sort = (sb_real *)sbi_arena_take(arena, c, sizeof(sb_real));
}

/* moved: what tractions of one deviation everywhere do. */
static void regi_calm_draw(regi_calm *calm, const reg_model *model)
{
    regi_chance chance = {(uint64_t)0x9e3779b97f4a7c15u, 0, 0};
    for (int k = 0; k < REGI_CALM_DRAWS; k++) {
        for (int j = 0; j < model->prior.control_count; j++) {
            calm->tractions[j].x = (sb_real)regi_chance_normal(&chance);
            calm->tractions[j].y = (sb_real)regi_chance_normal(&chance);
            calm->tractions[j].z = (sb_real)regi_chance_normal(&chance);
        }
        regi_prior_forces(&model->prior, calm->tractions, sb_v3(0, 0, 0),
                          calm->moved + (size_t)k * (size_t)model->mesh.node_count);
    }
    regi_response_solve(&calm->response, calm->moved, REGI_CALM_DRAWS);
}

/* squares: of how far the control points' parts of the surface move. Returns their median. */
static double regi_calm_measure(regi_calm *calm, const reg_model *model)
{
    int c = model->prior.control_count;
    memset(calm->squares, 0, (size_t)c * sizeof *calm->squares);
    for (int k = 0; k < REGI_CALM_DRAWS; k++) {
        sb_vec3 weight;
        regi_prior_collect(&model->prior, calm->moved + (size_t)k * (size_t)model->mesh.node_count, calm->tractions,
                           &weight);
        for (int j = 0; j < c; j++) {
            double area = model->prior.areas[j], way = (double)sb_v3_norm(calm->tractions[j]);
            calm->squares[j] += area > 0 ? way * way / (area * area) : 0;
        }
    }
    for (int j = 0; j < c; j++)
        calm->sort[j] = (sb_real)sqrt(calm->squares[j]);
    return (double)regi_cloud_select(calm->sort, c, c / 2);
}

static sb_result regi_calm_find(regi_calm *calm, reg_model *model, sb_error *error)
{
    double usual;
    sb_result result;
    for (int i = 0; i < model->mesh.node_count; i++)
        calm->response.centre = sb_v3_madd(calm->response.centre, 1 / (sb_real)(i + 1),
                                           sb_v3_sub(model->mesh.nodes[i], calm->response.centre));
    result = regi_response_factor(&calm->response, error);
    if (result != SB_OK)
        return result;
    regi_calm_draw(calm, model);
    usual = REGI_CALM_MOST * regi_calm_measure(calm, model);
    for (int j = 0; j < model->prior.control_count && usual > 0; j++) {
        double way = sqrt(calm->squares[j]);
        model->prior.calm[j] = way > usual ? usual / way : 1;
    }
    return SB_OK;
}

REGI_API sb_result regi_model_find_calm(reg_model *model, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_calm calm;
    void *memory;
    sb_result result;
    memset(&calm, 0, sizeof calm);
    regi_calm_layout(&calm, model, &arena);
    memory = arena.overflow ? NULL : sbi_alloc_zeroed(&model->allocator, 1, arena.used);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the motions of %d nodes", model->mesh.node_count);
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    regi_calm_layout(&calm, model, &arena);
    calm.response.model = model;
    result = sbi_body_make_factor(model->body, &model->allocator, &model->direct, error);
    calm.response.direct = model->direct;
    if (result == SB_OK)
        result = regi_calm_find(&calm, model, error);
    model->direct_at_rest = result == SB_OK;
    sbi_free(&model->allocator, memory);
    return result;
}
