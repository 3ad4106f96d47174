/* model: see model.h. */
#include "model.h"

#include <math.h>
#include <string.h>

#include "model_private.h"

#define REGI_MODEL_COOKIE 0x6d6f646cu

REG_API reg_model_def reg_default_model_def(void)
{
    reg_model_def def;
    memset(&def, 0, sizeof def);
    def.poisson = (sb_real)0.45;
    def.cookie = REGI_MODEL_COOKIE;
    return def;
}

static sb_result regi_model_check(const reg_model_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_MODEL_COOKIE || !def->mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a model needs a def made by reg_default_model_def, and a mesh");
    if (!(def->poisson > -1 && def->poisson < (sb_real)0.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "Poisson's ratio is %g, not in (-1, 0.5)", (double)def->poisson);
    if (def->fixed_count < 0 || (def->fixed_count > 0 && !def->fixed))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d fixed nodes, but no array of them", def->fixed_count);
    if (def->mesh->element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a model of custom elements cannot be registered");
    return SB_OK;
}

static sb_result regi_model_make_body(reg_model *model, const reg_model_def *def, sb_error *error)
{
    sb_body_def body = sb_default_body_def();
    sb_result result;
    body.mesh = def->mesh;
    body.material = sb_material_neo_hookean(REGI_MODEL_YOUNG, def->poisson, 1000);
    body.allocator = def->allocator;
    body.jobs = def->jobs;
    result = sb_body_create(&body, &model->body, error);
    if (result == SB_OK && def->fixed_count > 0)
        result = sb_body_hold(model->body, def->fixed, def->fixed_count, SB_XYZ, error);
    if (result == SB_OK)
        result = sb_mesh_copy(def->mesh, &def->allocator, &model->mesh, error);
    if (result == SB_OK)
        result = sb_domain_create(&model->mesh, SB_INTEGRATION_AUTO, 0, &def->allocator, &model->domain, error);
    if (result == SB_OK)
        result = sb_mesh_boundary(&model->mesh, 1, &def->allocator, &model->boundary, error);
    return result;
}

/* The surface's nodes as rows of the mesh's. */
static sb_result regi_model_hold_skin(reg_model *model, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    embed.mesh = &model->mesh;
    embed.points = model->skin.nodes;
    embed.point_count = model->skin.node_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * model->size; /* beyond, surface and mesh are not of one organ */
    embed.allocator = model->allocator;
    embed.jobs = model->jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &model->allocator, &model->rows, error);
    sb_embedding_destroy(embedding);
    return result;
}

static sb_result regi_model_measure_skin(reg_model *model, sb_error *error)
{
    const sb_mesh *skin = &model->skin;
    model->vertex_area = (sb_real *)sbi_alloc_zeroed(&model->allocator, (size_t)skin->node_count, sizeof(sb_real));
    if (!model->vertex_area)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d vertices", skin->node_count);
    for (int t = 0; t < skin->element_count; t++) {
        const int *c = skin->elements + 3 * (size_t)t;
        sb_vec3 a = sb_v3_sub(skin->nodes[c[1]], skin->nodes[c[0]]),
                b = sb_v3_sub(skin->nodes[c[2]], skin->nodes[c[0]]);
        sb_real area = (sb_real)0.5 * sb_v3_norm(sb_v3_cross(a, b));
        model->area += (double)area;
        for (int k = 0; k < 3; k++)
            model->vertex_area[c[k]] += area / 3;
    }
    return model->area > 0 ? SB_OK : sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
}

static sb_result regi_model_make_skin(reg_model *model, const reg_model_def *def, sb_error *error)
{
    const sb_mesh *surface = def->surface ? def->surface : &model->boundary.surface;
    sb_result result = sb_surface_triangulate(surface, &model->allocator, &model->skin, error);
    if (result == SB_OK)
        result = sb_surface_create(&model->skin, &model->allocator, &model->tree, error);
    if (result == SB_OK)
        result = regi_model_hold_skin(model, error);
    return result == SB_OK ? regi_model_measure_skin(model, error) : result;
}

REG_API sb_result reg_model_create(const reg_model_def *def, reg_model **model, sb_error *error)
{
    reg_model *made;
    sb_vec3 low, high;
    sb_result result = regi_model_check(def, error);
    if (result == SB_OK && !model)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no place for a model");
    if (result != SB_OK)
        return result;
    made = (reg_model *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a model");
    made->allocator = def->allocator;
    made->jobs = def->jobs;
    made->poisson = def->poisson;
    made->held = def->fixed_count > 0;
    result = regi_model_make_body(made, def, error);
    if (result == SB_OK) {
        sb_mesh_bounds(&made->mesh, &low, &high);
        made->size = sb_v3_norm(sb_v3_sub(high, low));
        made->spacing = cbrt(fabs((double)sb_mesh_volume(&made->mesh)) / made->mesh.node_count);
        result = regi_prior_create(&made->mesh, &made->boundary, &def->allocator, &made->prior, error);
    }
    if (result == SB_OK)
        result = regi_model_make_skin(made, def, error);
    if (result == SB_OK)
        result = regi_model_find_calm(made, error);
    if (result == SB_OK)
        *model = made;
    else
        reg_model_destroy(made);
    return result;
}

REG_API void reg_model_destroy(reg_model *model)
{
    sb_allocator allocator;
    if (!model)
        return;
    allocator = model->allocator;
    sbi_free(&allocator, model->vertex_area);
    sb_embedding_rows_free(&model->rows);
    sb_surface_destroy(model->tree);
    sb_mesh_free(&model->skin);
    regi_prior_free(&model->prior);
    sb_boundary_free(&model->boundary);
    sb_domain_free(&model->domain);
    sb_mesh_free(&model->mesh);
    sb_direct_free(model->direct);
    sb_body_destroy(model->body);
    sbi_free(&allocator, model);
}

REG_API int reg_model_node_count(const reg_model *model) { return model ? model->mesh.node_count : 0; }
