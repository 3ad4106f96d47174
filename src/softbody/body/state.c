/* state: one walk over a body's state serves measuring, writing, hashing, checking and reading. */
#include "state.h"

#include <stdio.h>
#include <string.h>

#include "body_private.h"
#include "cable_law.h"
#include "cavity_law.h"
#include "constraint.h"
#include "live_private.h"
#include "load.h"
#include "membrane_law.h"
#include "rigid_private.h"
#include "state_part.h"
#include "../base/output.h"
#include "step_explicit.h"

/* ---- files of images ---- */

/* Reads on in growing steps, so that no memory is taken for a size that the file only claims. */
static sb_result sbi_image_read_rest(const sb_allocator *allocator, FILE *file, unsigned char **image, size_t *size,
                                     sb_error *error)
{
    uint64_t claimed = sbi_get_bytes(*image + 16, 8);
    size_t capacity = SBI_IMAGE_HEAD + SBI_IMAGE_TAIL, got = 1;
    while (got && (uint64_t)*size <= claimed) {
        if (*size == capacity) {
            unsigned char *grown = (unsigned char *)sbi_alloc(allocator, capacity, 2);
            if (!grown)
                return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a file of more than %lu bytes",
                                (unsigned long)capacity);
            memcpy(grown, *image, *size);
            sbi_free(allocator, *image);
            *image = grown;
            capacity *= 2;
        }
        got = fread(*image + *size, 1, capacity - *size, file);
        *size += got;
    }
    return SB_OK;
}

SBI_API sb_result sbi_image_read_file(const sb_allocator *allocator, const char *path, const char *magic,
                                      uint32_t version, const char *what, unsigned char **image, size_t *size,
                                      sb_error *error)
{
    FILE *file = fopen(path, "rb");
    unsigned char *bytes;
    sb_result result;
    if (!file)
        return sbi_fail_file(error, SB_ERROR_FILE, path, "the file cannot be opened");
    bytes = (unsigned char *)sbi_alloc(allocator, SBI_IMAGE_HEAD + SBI_IMAGE_TAIL, 1);
    if (!bytes) {
        fclose(file);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to read a file");
    }
    *size = fread(bytes, 1, SBI_IMAGE_HEAD + SBI_IMAGE_TAIL, file);
    result = ferror(file) ? SB_OK : sbi_image_check_head(bytes, *size, magic, version, what, error);
    if (result == SB_OK && !ferror(file))
        result = sbi_image_read_rest(allocator, file, &bytes, size, error);
    if (result == SB_OK && ferror(file))
        result = sbi_fail(error, SB_ERROR_FILE, "the file cannot be read");
    fclose(file);
    if (result != SB_OK) {
        sbi_free(allocator, bytes);
        if (error)
            sbi_error_set_file(error, path);
        return result;
    }
    *image = bytes;
    return SB_OK;
}

/* ---- the walk ---------------------------------------------------------------------------------------------
 * Every part of the state is one function that names its values in order, whatever the walk is for. Passes over a
 * body give its values away; passes over an image hand the image's values back. Those that come before READ change
 * nothing that a step could notice, and READ cannot fail. */

typedef enum sbi_state_pass {
    SBI_STATE_MEASURE, /* of a body: bytes */
    SBI_STATE_WRITE,
    SBI_STATE_HASH,
    SBI_STATE_CHECK,   /* of an image: may the body take these values? */
    SBI_STATE_RESERVE, /* memory for them; capacities may grow */
    SBI_STATE_READ     /* the body takes them */
} sbi_state_pass;

typedef struct sbi_state_walk {
    sbi_state_pass pass;
    unsigned char *out;      /* WRITE */
    const unsigned char *in; /* CHECK, RESERVE, READ */
    size_t used, size;       /* bytes: passed so far, of in */
    int overflow;            /* MEASURE: used does not fit size_t */
    int plain;               /* 1: for this body alone: what it is made of and what others keep are left out */
    uint64_t hash;
    sb_result result; /* the first failure; what comes after it is 0 */
    sb_error *error;
    int differs;                /* 1: what was passed is not what the body has */
    int store;                  /* RESERVE and READ: the places that sbi_state_put_... name take the image's values */
    int same_mesh;              /* 1: a snapshot is written over one of the same mesh */
    sbi_snapshot_held had, has; /* what `out` had of that one, and what it has now */

    /* of the image, once CHECK has been there */
    sb_body_def settings;
    int last_load_id, next_constraint; /* those of what is being passed */
    const unsigned char *others;       /* the parts that others keep */
    int terms;                         /* most Prony terms of a material; of the body in passes over one */
    int has_fibres;                    /* 1: some material has */
    const unsigned char *fixed;        /* [node_count] */

    /* what RESERVE makes and READ puts in place */
    sbi_body_pattern pattern;
    sb_vec3 *fibres, *second_fibres;
    int new_loads, load_count;
    sbi_load *loads;
    int new_equations;
    sbi_elimination *elimination;
    int new_rigids; /* 1: the image's are not those of the body */
    int rigid_count;
    sbi_rigids *rigids;
} sbi_state_walk;

static int sbi_state_is_image(const sbi_state_walk *walk) { return walk->pass >= SBI_STATE_CHECK; }

/* A refusal of what an image holds, in CHECK: keeps the first. */
static void sbi_state_refuse(sbi_state_walk *walk, sb_result result)
{
    if (walk->result == SB_OK)
        walk->result = result;
}

/* One number of some bytes: the body's goes in, the one that counts comes back. */
static SBI_NOINLINE uint64_t sbi_state_word(sbi_state_walk *walk, uint64_t value, int bytes)
{
    size_t at = walk->used;
    if (sbi_state_is_image(walk)) {
        if (walk->result != SB_OK)
            return 0;
        if (walk->size - at < (size_t)bytes) {
            sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "the saved state ends too early"));
            return 0;
        }
        value = sbi_get_bytes(walk->in + at, bytes);
    } else if (walk->pass == SBI_STATE_WRITE) {
        sbi_put_bytes(walk->out + at, value, bytes);
    } else if (walk->pass == SBI_STATE_HASH) {
        walk->hash = sbi_hash_word(walk->hash, value);
    }
    walk->overflow |= !sbi_size_add(&walk->used, (size_t)bytes, 1);
    return value;
}

/* An integer of the range; an image's that is not in it is refused, and reads as `low`. */
static SBI_NOINLINE int sbi_state_int(sbi_state_walk *walk, int value, int low, int high, const char *name)
{
    int got = sbi_int_of(sbi_state_word(walk, (uint64_t)(uint32_t)value, 4));
    if (!sbi_state_is_image(walk))
        return value;
    if (walk->result == SB_OK && (got < low || got > high))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "the saved state has %s %d, not in %d .. %d",
                                        name, got, low, high));
    return walk->result == SB_OK ? got : low;
}

/* A real, whose range is the caller's business. */
static sb_real sbi_state_real(sbi_state_walk *walk, sb_real value)
{
    return sbi_real_of(sbi_state_word(walk, sbi_real_bits(value), (int)sizeof(sb_real)));
}

static sb_vec3 sbi_state_vector(sbi_state_walk *walk, sb_vec3 value)
{
    value.x = sbi_state_real(walk, value.x);
    value.y = sbi_state_real(walk, value.y);
    value.z = sbi_state_real(walk, value.z);
    return value;
}

/* 1: numbers lie in memory as in an image. */
static int sbi_state_is_little_endian(void)
{
    const uint32_t one = 1;
    unsigned char first;
    memcpy(&first, &one, 1);
    return first == 1;
}

/* Whether what an image holds has to be looked at: not what a body has kept for itself. */
static int sbi_state_is_checked(const sbi_state_walk *walk) { return walk->pass == SBI_STATE_CHECK && !walk->plain; }

/* Passes an array of numbers at once: gives it away, takes it over, or steps past it. 0: it has to be passed number by
 * number, to be hashed or checked, or because the machine orders bytes in another way. */
static int sbi_state_bulk(sbi_state_walk *walk, void *array, size_t count, size_t size)
{
    if (walk->pass == SBI_STATE_HASH || sbi_state_is_checked(walk) || walk->result != SB_OK ||
        !sbi_state_is_little_endian())
        return 0;
    if (walk->pass == SBI_STATE_WRITE && count)
        memcpy(walk->out + walk->used, array, count * size);
    if (walk->pass == SBI_STATE_READ && count)
        memcpy(array, walk->in + walk->used, count * size);
    walk->overflow |= !sbi_size_add(&walk->used, count, size);
    return 1;
}

/* In passes over a body: steps past so many bytes at once and says where they are to be written, or *out NULL. 0: they
 * have to be passed number by number, as above. */
static int sbi_state_place(sbi_state_walk *walk, size_t count, size_t size, unsigned char **out)
{
    size_t at = walk->used;
    if (sbi_state_is_image(walk) || !sbi_state_bulk(walk, NULL, 0, 1))
        return 0;
    *out = walk->pass == SBI_STATE_WRITE ? walk->out + at : NULL;
    walk->overflow |= !sbi_size_add(&walk->used, count, size);
    return 1;
}

/* Steps past so much of an image that this pass makes no use of. 0: it has to be checked. */
static int sbi_state_skip(sbi_state_walk *walk, size_t count, size_t size)
{
    if (!sbi_state_is_image(walk) || sbi_state_is_checked(walk) || walk->result != SB_OK)
        return 0;
    walk->used += count * size; /* that it has so much was checked, or is known */
    return 1;
}

/* What the image and the body must agree on. */
static void sbi_state_same(sbi_state_walk *walk, uint64_t value, const char *name)
{
    uint64_t got = sbi_state_word(walk, value, 8);
    if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK && got != value)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_STATE,
                                        "the state was saved from another body: %s is %lu there, %lu here", name,
                                        (unsigned long)got, (unsigned long)value));
}

enum { SBI_STATE_ANY = 0, SBI_STATE_FINITE = 1 };

/* A vector per node. ANY: arithmetic may have overflowed there, and every solve looks out for it. */
static void sbi_state_vectors(sbi_state_walk *walk, sb_vec3 *vectors, int count, int kind, const char *name)
{
    if (sbi_state_bulk(walk, vectors, (size_t)count, sizeof *vectors))
        return;
    for (int i = 0; i < count && walk->result == SB_OK; i++) {
        sb_vec3 v = sbi_state_vector(walk, vectors[i]);
        if (walk->pass == SBI_STATE_CHECK && kind == SBI_STATE_FINITE && walk->result == SB_OK && !sb_v3_is_finite(v))
            sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_NOT_FINITE, i,
                                                 "the saved %s of node %d is not finite", name, i));
        if (walk->pass == SBI_STATE_READ)
            vectors[i] = v;
    }
}

static double sbi_state_double(sbi_state_walk *walk, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    bits = sbi_state_word(walk, bits, 8);
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The same with the place of a value, which may be NULL in passes over an image. */
static int sbi_state_put_int(sbi_state_walk *walk, int *place, int low, int high, const char *name)
{
    int value = sbi_state_int(walk, place ? *place : low, low, high, name);
    if (walk->store && place)
        *place = value;
    return value;
}

static sb_real sbi_state_put_real(sbi_state_walk *walk, sb_real *place)
{
    sb_real value = sbi_state_real(walk, place ? *place : 0);
    if (walk->store && place)
        *place = value;
    return value;
}

static void sbi_state_put_vector(sbi_state_walk *walk, sb_vec3 *place, int kind, const char *name)
{
    sb_vec3 value = sbi_state_vector(walk, place ? *place : sb_v3(0, 0, 0));
    if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK && kind == SBI_STATE_FINITE && !sb_v3_is_finite(value))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_NOT_FINITE, "the saved %s is not finite", name));
    if (walk->store && place)
        *place = value;
}

static int sbi_state_checks(const sbi_state_walk *walk)
{
    return walk->pass == SBI_STATE_CHECK && walk->result == SB_OK;
}

/* ---- the parts ---- */

/* Numbers of a custom element: equal tables, equal elements. */
static uint64_t sbi_state_reals_hash(uint64_t hash, const sb_real *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        hash = sbi_hash_word(hash, sbi_real_bits(values[i]));
    return hash;
}

static uint64_t sbi_state_rule_hash(uint64_t hash, const sb_element_table *table, int count, const sb_real (*points)[3],
                                    const sb_real *weights)
{
    sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3];
    for (int p = 0; p < count; p++) {
        table->shape(table->user, points[p], shape, gradient);
        hash = sbi_hash_word(hash, sbi_real_bits(weights[p]));
        hash = sbi_state_reals_hash(hash, points[p], 3);
        hash = sbi_state_reals_hash(hash, shape, (size_t)table->node_count);
        hash = sbi_state_reals_hash(hash, &gradient[0][0], 3 * (size_t)table->node_count);
    }
    return hash;
}

static uint64_t sbi_state_table_hash(const sb_element_table *table)
{
    uint64_t hash = 1;
    if (!table)
        return 0;
    hash = sbi_hash_word(hash, (uint64_t)table->node_count);
    hash = sbi_hash_word(hash, (uint64_t)table->corner_count);
    hash = sbi_state_rule_hash(hash, table, table->point_count, table->points, table->weights);
    hash = sbi_state_rule_hash(hash, table, table->mass_point_count, table->mass_points, table->mass_weights);
    for (int f = 0; f < table->face_count; f++) {
        hash = sbi_hash_word(hash, (uint64_t)table->faces[f].type);
        for (int k = 0; k < sb_element_node_count(table->faces[f].type); k++)
            hash = sbi_hash_word(hash, (uint64_t)table->faces[f].nodes[k]);
    }
    return hash;
}

/* What the body is made of, so that a state of another one is refused. */
static uint64_t sbi_state_mesh_hash(const sb_body *body)
{
    const sb_domain *domain = &body->domain;
    size_t cells = (size_t)domain->cell_count * (size_t)domain->nodes_per_cell;
    uint64_t hash = 1;
    for (size_t i = 0; i < cells; i++)
        hash = sbi_hash_word(hash, (uint64_t)(uint32_t)domain->cells[i]);
    for (int i = 0; i < domain->cell_count; i++)
        hash = sbi_hash_word(hash, (uint64_t)(uint32_t)body->cell_material[i]);
    for (int i = 0; i < body->material_count; i++)
        hash = sbi_hash_word(hash, (uint64_t)(uint32_t)body->material_regions[i]);
    for (int i = 0; i < domain->node_count; i++) {
        hash = sbi_hash_word(hash, sbi_real_bits(body->reference[i].x));
        hash = sbi_hash_word(hash, sbi_real_bits(body->reference[i].y));
        hash = sbi_hash_word(hash, sbi_real_bits(body->reference[i].z));
    }
    if (body->own_points) { /* nothing else tells them from the elements' */
        size_t points = (size_t)domain->cell_count * (size_t)domain->points_per_cell,
               n = (size_t)domain->nodes_per_cell;
        hash = sbi_state_reals_hash(hash, domain->weights, points);
        hash = sbi_state_reals_hash(hash, domain->gradients, points * n * 3);
        for (int e = 0; domain->cell_patch && e < domain->cell_count; e++)
            hash = sbi_hash_word(hash, (uint64_t)(uint32_t)domain->cell_patch[e]);
        hash = sbi_state_reals_hash(hash, domain->cell_mass,
                                    domain->cell_mass ? (size_t)domain->cell_count * (n * (n + 1) / 2) : 0);
    }
    return hash;
}

/* Pieces that the preconditioner was to have. How many it made follows from the matrix' pattern, which is another
 * before loads and constraints are read that couple nodes; states that earlier versions saved have that number. */
static void sbi_state_coarse(const sb_body *body, sbi_state_walk *walk)
{
    const int wanted = sbi_precond_wanted_pieces(body->precond);
    const int made = sb_preconditioner_get_info(body->precond).piece_count;
    uint64_t got = sbi_state_word(walk, (uint64_t)wanted, 8);
    if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK && got != (uint64_t)wanted && got != (uint64_t)made)
        sbi_state_refuse(walk,
                         sbi_fail(walk->error, SB_ERROR_STATE,
                                  "the state was saved from another body: the preconditioner is to have %lu pieces "
                                  "there, %d here",
                                  (unsigned long)got, wanted));
}

static void sbi_state_make(sb_body *body, sbi_state_walk *walk)
{
    int used = walk->pass == SBI_STATE_WRITE || walk->pass == SBI_STATE_CHECK;
    sb_preconditioner_info precond;
    (void)sbi_precond_settle(body->precond, &body->matrix);
    precond = sb_preconditioner_get_info(body->precond);
    sbi_state_same(walk, (uint64_t)body->domain.node_count, "the number of nodes");
    sbi_state_same(walk, (uint64_t)body->domain.cell_count, "the number of elements");
    sbi_state_same(walk, (uint64_t)body->domain.element_type, "the element type");
    sbi_state_same(walk, (uint64_t)body->domain.points_per_cell, "the number of integration points");
    sbi_state_same(walk, used ? sbi_state_table_hash(body->domain.table) : 0, "the hash of the custom element");
    sbi_state_same(walk, (uint64_t)body->domain.mean_points | (uint64_t)body->domain.patch_count << 8,
                   "the number of mean points, and of patches times 256");
    sbi_state_same(walk, (uint64_t)body->domain.single_rotation, "single_rotation");
    sbi_state_same(walk, (uint64_t)body->material_count, "the number of regions");
    sbi_state_same(walk, (uint64_t)body->mass_kind, "the kind of mass");
    sbi_state_same(walk, (uint64_t)precond.kind, "the preconditioner");
    sbi_state_coarse(body, walk);
    sbi_state_same(walk, used ? sbi_state_mesh_hash(body) : 0, "the mesh's hash");
}

static void sbi_state_settings(sb_body *body, sbi_state_walk *walk)
{
    sb_body_def def = sb_default_body_def();
    def.integrator =
        (sb_integrator)sbi_state_int(walk, (int)body->integrator, SB_EULER, SB_CENTRAL_DIFFERENCE, "integrator");
    def.gravity = sbi_state_vector(walk, body->gravity);
    def.damping_mass = sbi_state_real(walk, body->damping_mass);
    def.damping_stiffness = sbi_state_real(walk, body->damping_stiffness);
    def.tolerance = sbi_state_real(walk, body->tolerance);
    def.newton_tolerance = sbi_state_real(walk, body->newton_tolerance);
    def.max_iterations = sbi_state_int(walk, body->max_iterations, 1, INT32_MAX, "max_iterations");
    def.max_newton = sbi_state_int(walk, body->max_newton, SB_AUTO, INT32_MAX, "max_newton");
    def.spectral_radius = sbi_state_real(walk, body->spectral_radius);
    def.max_substeps = sbi_state_int(walk, body->max_substeps, 1, INT32_MAX, "max_substeps");
    def.mass = body->mass_kind;
    walk->settings = def;
    if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_body_check_settings(&def, walk->error));
    if (walk->pass != SBI_STATE_READ)
        return;
    body->integrator = def.integrator;
    body->gravity = def.gravity;
    body->damping_mass = def.damping_mass;
    body->damping_stiffness = def.damping_stiffness;
    body->tolerance = def.tolerance;
    body->newton_tolerance = def.newton_tolerance;
    body->max_iterations = def.max_iterations;
    body->max_newton = def.max_newton;
    body->spectral_radius = def.spectral_radius;
    body->max_substeps = def.max_substeps;
}

/* Room for the damping of iterated steps, should the image's settings and this material need it. */
static void sbi_state_reserve_damping(sb_body *body, sbi_state_walk *walk, const sb_material *material)
{
    sb_body planned = *body;
    planned.integrator = walk->settings.integrator;
    planned.max_newton = walk->settings.max_newton;
    sbi_state_refuse(walk, sbi_body_reserve_damping(&planned, material, 1, walk->error));
    body->damping_blocks = planned.damping_blocks;
}

static sb_material sbi_state_material(const sb_body *body, const sb_material *material, sbi_state_walk *walk)
{
    sb_real reals[SBI_MATERIAL_REALS];
    int model = sbi_state_int(walk, (int)material->model, SB_LINEAR, SBI_LAST_MODEL, "material model");
    int prony_count = sbi_state_int(walk, material->prony_count, 0, SB_MAX_PRONY_TERMS, "Prony term count");
    sbi_body_pack_material(material, reals);
    for (int i = 0; i < SBI_MATERIAL_REALS; i++)
        reals[i] = sbi_state_real(walk, reals[i]);
    return sbi_body_unpack_material(body, model, prony_count, reals);
}

static void sbi_state_materials(sb_body *body, sbi_state_walk *walk)
{
    int changed = 0;
    walk->terms = walk->has_fibres = 0;
    for (int i = 0; i < body->material_count && walk->result == SB_OK; i++) {
        sb_material material = sbi_state_material(body, body->materials + i, walk);
        walk->terms = sbi_max_int(walk->terms, material.prony_count);
        walk->has_fibres |= sbi_material_has_fibres(&material);
        if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK)
            sbi_state_refuse(walk, sbi_body_check_material(&material, body->domain.single_rotation, walk->error));
        if (walk->pass == SBI_STATE_RESERVE)
            sbi_state_reserve_damping(body, walk, &material);
        if (walk->pass != SBI_STATE_READ)
            continue;
        changed |= memcmp(&material, body->materials + i, sizeof material) != 0;
        body->materials[i] = material;
    }
    if (changed)
        sbi_body_materials_changed(body);
}

static int sbi_state_has_prestretch(const sb_body *body)
{
    for (int i = 0; i < body->material_count; i++)
        if (sbi_material_is_prestretched(body->materials + i))
            return 1;
    return 0;
}

/* Of bodies with a material that has one; without this part none has. */
static void sbi_state_prestretch(sb_body *body, sbi_state_walk *walk)
{
    for (int i = 0; i < body->material_count && walk->result == SB_OK; i++) {
        sb_material material = body->materials[i];
        for (int k = 0; k < SBI_MATERIAL_PRESTRETCH; k++)
            material.prestretch.m[k / 3][k % 3] = sbi_state_real(walk, material.prestretch.m[k / 3][k % 3]);
        if (sbi_state_checks(walk) && walk->result == SB_OK && sbi_material_is_prestretched(&material))
            sbi_state_refuse(walk, sbi_material_check_prestretch(&material, 1, walk->error));
        if (walk->pass == SBI_STATE_READ)
            body->materials[i] = material;
    }
    if (walk->pass == SBI_STATE_READ)
        sbi_body_materials_changed(body);
}

/* Unit directions of a family, or 0: *own is where the body has them, *spare the room for them where it has none. */
static void sbi_state_family(sb_body *body, sbi_state_walk *walk, sb_vec3 **own, sb_vec3 **spare, int given)
{
    int count = body->domain.cell_count;
    if (walk->pass == SBI_STATE_RESERVE && given && !*own) {
        *spare = (sb_vec3 *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_vec3));
        if (!*spare)
            sbi_state_refuse(walk,
                             sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for the fibres of %d elements", count));
    }
    if (walk->pass == SBI_STATE_READ && (given ? *spare != NULL : *own != NULL)) {
        sbi_free(&body->allocator, *own);
        *own = *spare;
        *spare = NULL;
    }
    for (int e = 0; given && e < count && walk->result == SB_OK; e++) {
        sb_vec3 a = sbi_state_vector(walk, *own ? (*own)[e] : sb_v3(0, 0, 0));
        sb_real square = sb_v3_dot(a, a);
        if (sbi_state_checks(walk) && square != 0 && !(square > (sb_real)0.99 && square < (sb_real)1.01))
            sbi_state_refuse(walk, sbi_fail_element(walk->error, SB_ERROR_FORMAT, e,
                                                    "the saved fibre of element %d is no direction", e));
        if (walk->pass == SBI_STATE_READ)
            (*own)[e] = a;
    }
}

/* Families: 0, 1 or 2. */
static void sbi_state_fibres(sb_body *body, sbi_state_walk *walk)
{
    int given = (body->fibres != NULL) + (body->second_fibres != NULL);
    given = sbi_state_int(walk, given, 0, body->live ? 1 : 2, "number of fibre families");
    if (sbi_state_checks(walk) && walk->has_fibres && !given)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MATERIAL,
                                        "a saved material has fibres, but no directions "
                                        "were saved"));
    sbi_state_family(body, walk, &body->fibres, &walk->fibres, given > 0);
    sbi_state_family(body, walk, &body->second_fibres, &walk->second_fibres, given > 1);
    if (walk->pass == SBI_STATE_READ) {
        body->assembly.fibres = body->fibres;
        body->assembly.second_fibres = body->second_fibres;
    }
}

/* Of a body whose regions have their own damping; both numbers of each region. */
static void sbi_state_region_damping(sb_body *body, sbi_state_walk *walk)
{
    if (walk->pass == SBI_STATE_RESERVE) {
        sb_body planned = *body;
        planned.integrator = walk->settings.integrator;
        planned.max_newton = walk->settings.max_newton;
        planned.regional_damping = 1;
        sbi_state_refuse(walk, sbi_body_reserve_damping(&planned, NULL, 0, walk->error));
        body->damping_blocks = planned.damping_blocks;
    }
    if (sbi_state_checks(walk) && walk->settings.integrator == SB_CENTRAL_DIFFERENCE)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "SB_CENTRAL_DIFFERENCE damps all regions alike"));
    for (int i = 0; i < 2 * body->material_count && walk->result == SB_OK; i++) {
        sb_real value = sbi_state_real(walk, body->region_alpha[i]);
        if (sbi_state_checks(walk) && (!(value >= 0) || !sb_is_finite(value)))
            sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "a saved damping is %g", (double)value));
        if (walk->pass == SBI_STATE_READ)
            body->region_alpha[i] = value;
    }
    if (walk->pass == SBI_STATE_READ)
        sbi_body_set_regions(body, 1);
}

/* ---- couplings beyond the elements ---- */

/* The rows of an image, as `rows` at their beginning lists them: counts, and compares with the body's, or stores in
 * pattern.extra_start and extra_nodes. */
static int sbi_state_pass_extra(const sb_body *body, sbi_state_walk *walk, int rows, size_t *entries)
{
    int *start = walk->pattern.extra_start, same = rows == body->extra_count, last = body->domain.node_count - 1;
    *entries = 0;
    for (int c = 0; c < rows && walk->result == SB_OK; c++) {
        int size = sbi_state_int(walk, 0, 1, INT32_MAX, "coupling row length");
        same = same && body->extra_start[c + 1] - body->extra_start[c] == size;
        for (int k = 0; k < size && walk->result == SB_OK; k++, ++*entries) {
            int node = sbi_state_int(walk, 0, 0, last, "node of a coupling row");
            same = same && body->extra_nodes[*entries] == node;
            if (start)
                walk->pattern.extra_nodes[*entries] = node;
        }
        if (start)
            start[c + 1] = (int)*entries;
    }
    return same;
}

/* The pattern of the image's rows, unless the body has it. */
static void sbi_state_reserve_extra(sb_body *body, sbi_state_walk *walk, int rows)
{
    size_t at = walk->used, entries, bytes = 0;
    sbi_body_pattern *pattern = &walk->pattern;
    int same = sbi_state_pass_extra(body, walk, rows, &entries);
    if (same || walk->result != SB_OK)
        return;
    if (entries <= INT32_MAX && sbi_size_add(&bytes, (size_t)rows + 1, sizeof(int)) &&
        sbi_size_add(&bytes, entries, sizeof(int)))
        pattern->extra_start = (int *)sbi_alloc(&body->allocator, bytes, 1);
    if (!pattern->extra_start) {
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for %d coupling rows", rows));
        return;
    }
    pattern->needed = 1;
    pattern->extra_count = rows;
    pattern->extra_nodes = pattern->extra_start + rows + 1;
    pattern->extra_start[0] = 0;
    walk->used = at;
    sbi_state_pass_extra(body, walk, rows, &entries);
    sbi_state_refuse(walk, sbi_body_finish_pattern(body, walk->fixed, pattern, walk->error));
}

/* The rows come before all that has one entry per block of the matrix. */
static void sbi_state_extra(sb_body *body, sbi_state_walk *walk)
{
    int rows = sbi_state_int(walk, body->extra_count, 0, INT32_MAX - 1, "number of coupling rows");
    size_t entries;
    if (walk->pass == SBI_STATE_RESERVE) {
        sbi_state_reserve_extra(body, walk, rows);
    } else if (sbi_state_is_image(walk)) {
        if (walk->pass == SBI_STATE_READ)
            sbi_body_take_pattern(body, &walk->pattern);
        sbi_state_pass_extra(body, walk, rows, &entries);
    } else {
        for (int c = 0; c < rows; c++) {
            int first = body->extra_start[c], end = body->extra_start[c + 1];
            sbi_state_int(walk, end - first, 0, 0, "");
            for (int k = first; k < end; k++)
                sbi_state_int(walk, body->extra_nodes[k], 0, 0, "");
        }
    }
}

/* The matrix that the body will have. */
static const sb_matrix *sbi_state_matrix(const sb_body *body, const sbi_state_walk *walk)
{
    return walk->pattern.needed ? &walk->pattern.matrix : &body->matrix;
}

/* ---- supports ---- */

/* Supported axes, of which nodes without an element keep all; the others take blocks of the matrix. */
static void sbi_state_supports(sb_body *body, sbi_state_walk *walk)
{
    const sb_matrix *matrix = sbi_state_matrix(body, walk);
    int needed = 0;
    int count = body->domain.node_count;
    if (walk->pass == SBI_STATE_CHECK)
        walk->fixed = walk->in + walk->used;
    if (!sbi_state_is_image(walk) && sbi_state_bulk(walk, body->fixed, (size_t)count, 1))
        count = 0;
    for (int i = 0; i < count && walk->result == SB_OK; i++) {
        int lonely = body->node_component[i] < 0;
        int fixed = (int)sbi_state_word(walk, body->fixed[i], 1);
        if (sbi_state_checks(walk) && (fixed > SB_XYZ || (lonely && fixed != SB_XYZ)))
            sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_FORMAT, i,
                                                 "node %d cannot have the saved supports %d", i, fixed));
        if (fixed && !lonely)
            needed += matrix->row_end[i] - matrix->row_start[i];
        if (walk->pass == SBI_STATE_READ)
            body->fixed[i] = (unsigned char)fixed;
    }
    if (walk->pass == SBI_STATE_RESERVE && !walk->pattern.needed &&
        sbi_body_reserve_support_blocks(body, needed) != SB_OK)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for supports of %d blocks", needed));
    if (walk->pass == SBI_STATE_READ)
        body->support_used = needed;
    sbi_state_vectors(walk, body->target, body->domain.node_count, SBI_STATE_FINITE, "target");
}

static void sbi_state_loads(sb_body *body, sbi_state_walk *walk)
{
    int n = body->domain.node_count;
    sbi_state_vectors(walk, body->dead_load, n, SBI_STATE_ANY, "load");
    sbi_state_vectors(walk, body->equilibrated, n, SBI_STATE_ANY, "equilibrated load");
    sbi_state_vectors(walk, body->external, n, SBI_STATE_ANY, "external force");
    sbi_state_vectors(walk, body->reaction, n, SBI_STATE_ANY, "reaction");
}

/* Tractions by face, where there are any. */
static void sbi_state_tractions(sb_body *body, sbi_state_walk *walk)
{
    int count = sbi_state_int(walk, body->traction_count, 1, INT32_MAX / (int)sizeof(sbi_traction), "tractions");
    if (walk->pass == SBI_STATE_RESERVE && count > body->traction_count)
        sbi_state_refuse(walk, sbi_body_reserve_tractions(body, count - body->traction_count, walk->error));
    walk->store = walk->pass == SBI_STATE_READ;
    for (int i = 0; i < count && walk->result == SB_OK; i++) {
        sbi_traction *traction = !sbi_state_is_image(walk) || walk->store ? body->tractions + i : NULL;
        if (walk->store)
            memset(traction->nodes, -1, sizeof traction->nodes);
        for (int k = 0; k < sbi_piece_face_nodes(body->domain.nodes_per_cell); k++)
            sbi_state_put_int(walk, traction ? traction->nodes + k : NULL, 0, body->domain.node_count - 1,
                              "node of a traction");
        sbi_state_put_vector(walk, traction ? &traction->stress : NULL, SBI_STATE_ANY, "");
    }
    if (walk->store)
        body->traction_count = count;
    walk->store = 0;
}

/* ---- loads that follow the body ---- */

/* What passing the rows of a load found out. */
typedef struct sbi_state_rows {
    size_t entries, pairs;
    int same; /* 1: rows, nodes and kind are those of the body's load */
} sbi_state_rows;

/* Whether a saved row of a pressure is a face of the surface; nodes in the order in which the body would have it. */
static void sbi_state_check_face(const sb_body *body, sbi_state_walk *walk, int type, int size, const int *nodes)
{
    int corners = sb_element_corner_count((sb_element_type)type);
    sbi_body_face face;
    if (sb_element_node_count((sb_element_type)type) == size && (corners == 3 || corners == 4) &&
        sbi_body_get_face(body, nodes, 0, size, &face, NULL) == SB_OK && !face.inner && face.count == size &&
        (int)face.type == type && memcmp(face.nodes, nodes, (size_t)size * sizeof *nodes) == 0)
        return;
    sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_FORMAT, nodes[0],
                                         "a saved load acts on what is no face, at node %d", nodes[0]));
}

/* Whether the matrix has a block for every pair of the nodes of the row that begins there. */
static void sbi_state_check_blocks(const sb_body *body, sbi_state_walk *walk, size_t at, int size)
{
    const sb_matrix *matrix = sbi_state_matrix(body, walk);
    for (int a = 0; a < size && walk->result == SB_OK; a++)
        for (int b = 0; b < size && walk->result == SB_OK; b++) {
            int i = sbi_int_of(sbi_get_bytes(walk->in + at + 4 * (size_t)a, 4));
            int j = sbi_int_of(sbi_get_bytes(walk->in + at + 4 * (size_t)b, 4));
            if (sb_matrix_find(matrix, i, j) < 0)
                sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_FORMAT, i,
                                                     "a saved row couples the nodes %d "
                                                     "and %d, which the saved matrix does not",
                                                     i, j));
        }
}

/* Stiffness, targets and force of a row of springs or a mapping. What no static solve has balanced yet has no balanced
 * values, though its arrays may hold some of a solve that failed. */
static void sbi_state_row_values(sbi_state_walk *walk, sbi_load *load, int j)
{
    int real = load->stiffness != NULL, balanced = real && load->balanced;
    for (int k = 0; k < 2; k++) {
        sb_real *from = k ? load->balanced_stiffness : load->stiffness;
        sb_real stiffness = sbi_state_put_real(walk, (k ? balanced : real) ? from + j : NULL);
        if (sbi_state_checks(walk) && (!(stiffness >= 0) || !sb_is_finite(stiffness)))
            sbi_state_refuse(walk, sbi_fail_element(walk->error, SB_ERROR_ARGUMENT, j,
                                                    "row %d of the saved load %d has stiffness %g", j, load->id,
                                                    (double)stiffness));
    }
    sbi_state_put_vector(walk, real ? load->target + j : NULL, SBI_STATE_FINITE, "target of a load");
    sbi_state_put_vector(walk, balanced ? load->balanced_target + j : NULL, SBI_STATE_ANY, "");
    sbi_state_put_vector(walk, real ? load->force + j : NULL, SBI_STATE_ANY, "");
}

/* One row; `from`: its first entry. Returns its length. */
static int sbi_state_row(const sb_body *body, sbi_state_walk *walk, sbi_load *load, int j, size_t from)
{
    int faces = sbi_load_has_faces(load), most = faces ? SB_MAX_FACE_NODES : INT32_MAX;
    int size = load->row_start ? load->row_start[j + 1] - load->row_start[j] : 1, corner[SB_MAX_FACE_NODES] = {0};
    int type = 0;
    size_t at;
    size = sbi_state_int(walk, size, 1, load->kind == SBI_LOAD_SPRINGS ? 1 : most, "row length of a load");
    if (faces)
        type = sbi_state_int(walk, load->face_types ? (int)load->face_types[j] : 0, SB_TRI3, SB_QUAD9, "face type");
    if (faces && walk->store)
        load->face_types[j] = (sb_element_type)type;
    at = walk->used;
    for (int k = 0; k < size && walk->result == SB_OK; k++) {
        int node = sbi_state_put_int(walk, load->nodes ? load->nodes + from + k : NULL, 0, body->domain.node_count - 1,
                                     "node of a load");
        if (faces && k < SB_MAX_FACE_NODES)
            corner[k] = node;
    }
    if (sbi_state_checks(walk) && faces)
        sbi_state_check_face(body, walk, type, size, corner);
    if (walk->pass == SBI_STATE_RESERVE && walk->result == SB_OK && !faces)
        sbi_state_check_blocks(body, walk, at, size);
    for (int k = 0; k < size && walk->result == SB_OK && !faces; k++) {
        sb_real weight = sbi_state_put_real(walk, load->weights ? load->weights + from + k : NULL);
        if (sbi_state_checks(walk) && (load->kind == SBI_LOAD_SPRINGS ? weight != 1 : !sb_is_finite(weight)))
            sbi_state_refuse(walk, sbi_fail_element(walk->error, SB_ERROR_NOT_FINITE, j,
                                                    "row %d of the saved load %d has weight %g", j, load->id,
                                                    (double)weight));
    }
    if (!faces)
        sbi_state_row_values(walk, load, j);
    return size;
}

/* 1 when the body's load has the same nodes in row j, whose length was just passed; at: where the nodes stand. */
static int sbi_state_same_row(const sbi_state_walk *walk, const sbi_load *like, int j, int size, size_t at)
{
    int same = like->row_start[j + 1] - like->row_start[j] == size;
    for (int k = 0; k < size && same; k++)
        same = like->nodes[like->row_start[j] + k] == sbi_int_of(sbi_get_bytes(walk->in + at + 4 * (size_t)k, 4));
    return same;
}

/* All rows of a load; like: the body's load to compare with, or NULL. */
static sbi_state_rows sbi_state_load_rows(const sb_body *body, sbi_state_walk *walk, sbi_load *load,
                                          const sbi_load *like)
{
    sbi_state_rows rows = {0, 0, 0};
    rows.same = like && like->kind == load->kind && like->row_count == load->row_count;
    for (int j = 0; j < load->row_count && walk->result == SB_OK; j++) {
        size_t at = walk->used + (sbi_load_has_faces(load) ? 8 : 4);
        int size = sbi_state_row(body, walk, load, j, rows.entries);
        if (walk->result != SB_OK)
            break;
        rows.same = rows.same && sbi_state_same_row(walk, like, j, size, at);
        rows.entries += (size_t)size; /* each took bytes of the image, so this cannot overflow */
        if (!sbi_size_add(&rows.pairs, (size_t)size, (size_t)size))
            sbi_state_refuse(
                walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "a row of the saved load %d is too long", load->id));
        if (walk->store)
            load->row_start[j + 1] = (int)rows.entries;
    }
    return rows;
}

/* What a cable is made of. */
static void sbi_state_cable_law(sbi_state_walk *walk, const sbi_load *load, sbi_cable_law *law)
{
    law->rest = sbi_state_real(walk, law->rest);
    law->stiffness = sbi_state_real(walk, law->stiffness);
    law->toe = sbi_state_real(walk, law->toe);
    law->pushes = sbi_state_int(walk, law->pushes, 0, 1, "mark of a cable that pushes");
    if (sbi_state_checks(walk) && walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_cable_check_law(law, load->id, walk->error));
}

/* What a cable has beyond its points. */
static void sbi_state_cable(sbi_state_walk *walk, sbi_load *load)
{
    if (!load->balanced)
        load->balanced_cable = load->cable;
    sbi_state_cable_law(walk, load, &load->cable);
    sbi_state_cable_law(walk, load, &load->balanced_cable);
    load->tension = sbi_state_real(walk, load->tension);
    load->curved_energy = sbi_state_double(walk, load->curved_energy);
}

/* What a membrane is made of. */
static void sbi_state_membrane_law(sbi_state_walk *walk, sbi_membrane_law *law)
{
    law->thickness = sbi_state_real(walk, law->thickness);
    law->shear = sbi_state_real(walk, law->shear);
    law->prestretch = sbi_state_real(walk, law->prestretch);
    law->wrinkles = sbi_state_int(walk, law->wrinkles, 0, 1, "mark of a membrane that wrinkles");
    if (sbi_state_checks(walk) && walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_membrane_check_law(law, walk->error));
}

/* What a membrane has beyond its faces. */
static void sbi_state_membrane(sbi_state_walk *walk, sbi_load *load)
{
    if (!load->balanced)
        load->balanced_membrane = load->membrane;
    sbi_state_membrane_law(walk, &load->membrane);
    sbi_state_membrane_law(walk, &load->balanced_membrane);
    load->curved_energy = sbi_state_double(walk, load->curved_energy);
}

/* What a cavity is filled with. */
static void sbi_state_cavity_law(sbi_state_walk *walk, const sbi_cavity *cavity, sbi_cavity_law *law)
{
    law->kind =
        (sb_cavity_kind)sbi_state_int(walk, (int)law->kind, SB_CAVITY_PRESSURE, SB_CAVITY_TABLE, "kind of a cavity");
    law->pressure = sbi_state_real(walk, law->pressure);
    law->ambient = sbi_state_real(walk, law->ambient);
    law->exponent = sbi_state_real(walk, law->exponent);
    law->bulk = sbi_state_real(walk, law->bulk);
    law->filled = sbi_state_real(walk, law->filled);
    law->share = sbi_state_real(walk, law->share);
    if (sbi_state_checks(walk) && walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_cavity_check_law(cavity, law, walk->error));
}

/* What a cavity has beyond its faces. */
static void sbi_state_cavity(sbi_state_walk *walk, sbi_load *load)
{
    sbi_cavity *cavity = &load->cavity;
    if (!load->balanced)
        cavity->balanced = cavity->law;
    cavity->point_count =
        sbi_state_int(walk, cavity->point_count, 0, SB_MAX_CAVITY_POINTS, "points of a cavity's table");
    for (int k = 0; k < cavity->point_count && walk->result == SB_OK; k++) {
        cavity->table_volume[k] = sbi_state_real(walk, cavity->table_volume[k]);
        cavity->table_pressure[k] = sbi_state_real(walk, cavity->table_pressure[k]);
    }
    sbi_state_cavity_law(walk, cavity, &cavity->law);
    sbi_state_cavity_law(walk, cavity, &cavity->balanced);
    cavity->hold.pressure = sbi_state_real(walk, cavity->hold.pressure);
    cavity->hold.stiff = sbi_state_real(walk, cavity->hold.stiff);
    cavity->read = sbi_state_real(walk, cavity->read);
    load->curved_energy = sbi_state_double(walk, load->curved_energy);
    if (sbi_state_checks(walk) && (!sb_is_finite(cavity->hold.pressure) || !sb_is_finite(cavity->hold.stiff)))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_NOT_FINITE,
                                        "the saved pressure of cavity %d is not finite", load->id));
}

/* What a load has once. An image's values go into `load`, which is a copy. */
static void sbi_state_load_head(const sb_body *body, sbi_state_walk *walk, int after, sbi_load *load)
{
    int last = body->last_load_id;
    load->kind = (sbi_load_kind)sbi_state_int(walk, (int)load->kind, SBI_LOAD_PRESSURE, SBI_LOAD_CAVITY, "load kind");
    if (sbi_state_checks(walk) && load->kind == SBI_LOAD_POTENTIAL)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "a saved load is of no kind that is saved"));
    load->id =
        sbi_state_int(walk, load->id, after + 1, sbi_state_is_image(walk) ? walk->last_load_id : last, "load id");
    load->balanced = sbi_state_int(walk, load->balanced, 0, 1, "mark of a balanced load");
    load->row_count = sbi_state_int(walk, load->row_count, 1, INT32_MAX - 1, "number of rows of a load");
    load->pressure = sbi_state_real(walk, load->pressure);
    load->balanced_pressure = sbi_state_real(walk, load->balanced ? load->balanced_pressure : 0);
    if (!load->balanced) /* as in sbi_state_row_values */
        load->balanced_pressure = 0;
    for (int k = 0; k < 6; k++)
        load->net[k] = sbi_state_double(walk, load->net[k]);
    if (sbi_state_checks(walk) && !sb_is_finite(load->pressure))
        sbi_state_refuse(
            walk, sbi_fail(walk->error, SB_ERROR_NOT_FINITE, "the saved pressure of load %d is not finite", load->id));
    if (load->kind == SBI_LOAD_CABLE)
        sbi_state_cable(walk, load);
    if (load->kind == SBI_LOAD_MEMBRANE)
        sbi_state_membrane(walk, load);
    if (load->kind == SBI_LOAD_CAVITY)
        sbi_state_cavity(walk, load);
}

/* Room for what these rows tie. */
static void sbi_state_reserve_ties(sb_body *body, sbi_state_walk *walk, int count, const int *start, const int *nodes,
                                   const int *dofs, const sb_real *weights)
{
    sbi_body_rows rows;
    rows.count = count;
    rows.start = start;
    rows.nodes = nodes;
    rows.dofs = dofs;
    rows.weights = weights;
    sbi_state_refuse(walk, sbi_body_reserve_ties(body, &rows, walk->error));
}

/* Makes load i of the list to come, and fills it. */
static void sbi_state_make_load(sb_body *body, sbi_state_walk *walk, int after, sbi_load *load)
{
    size_t at = walk->used;
    sbi_state_rows rows;
    memset(load, 0, sizeof *load);
    sbi_state_load_head(body, walk, after, load);
    rows = sbi_state_load_rows(body, walk, load, NULL);
    if (walk->result == SB_OK && rows.entries > INT32_MAX)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "the saved load %d is too long", load->id));
    if (walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_load_make(&body->allocator, load->kind, load->row_count, (int)rows.entries,
                                             rows.pairs, load, walk->error));
    if (walk->result != SB_OK)
        return;
    walk->load_count++;
    walk->used = at;
    walk->store = 1;
    sbi_state_load_head(body, walk, after, load);
    sbi_state_load_rows(body, walk, load, NULL);
    walk->store = 0;
    if (load->kind == SBI_LOAD_CAVITY && walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_cavity_find_rims(body, load, walk->error));
    if (!sbi_load_has_faces(load))
        sbi_state_reserve_ties(body, walk, load->row_count, load->row_start, load->nodes, NULL, load->weights);
}

/* A new list of loads, unless the image's have the rows of the body's. */
static void sbi_state_reserve_follow(sb_body *body, sbi_state_walk *walk, int count)
{
    size_t at = walk->used;
    int same = count == body->load_count, after = 0;
    for (int i = 0; i < count && same && walk->result == SB_OK; i++) {
        sbi_load load;
        memset(&load, 0, sizeof load);
        sbi_state_load_head(body, walk, after, &load);
        same = load.id == body->loads[i].id && sbi_state_load_rows(body, walk, &load, body->loads + i).same;
        after = load.id;
    }
    if (same || walk->result != SB_OK)
        return;
    walk->used = at;
    walk->new_loads = 1;
    walk->loads = (sbi_load *)sbi_alloc_zeroed(&body->allocator, (size_t)count + 1, sizeof(sbi_load));
    if (!walk->loads)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for %d loads", count));
    for (int i = 0; i < count && walk->result == SB_OK; i++)
        sbi_state_make_load(body, walk, i > 0 ? walk->loads[i - 1].id : 0, walk->loads + i);
}

static void sbi_state_free_loads(const sb_body *body, sbi_load *loads, int count)
{
    for (int i = 0; i < count; i++)
        sbi_load_release(&body->allocator, loads + i);
    sbi_free(&body->allocator, loads);
}

static void sbi_state_take_loads(sb_body *body, sbi_state_walk *walk)
{
    if (!walk->new_loads)
        return;
    sbi_state_free_loads(body, body->loads, body->load_count);
    body->loads = walk->loads;
    body->load_count = walk->load_count;
    body->load_capacity = walk->load_count + 1;
    walk->loads = NULL;
    walk->load_count = 0;
}

static void sbi_state_follow(sb_body *body, sbi_state_walk *walk)
{
    int last = sbi_state_int(walk, body->last_load_id, 0, INT32_MAX, "last load id"), after = 0;
    int count = sbi_state_int(walk, body->load_count, 0, INT32_MAX - 1, "number of loads");
    walk->last_load_id = last;
    if (walk->pass == SBI_STATE_RESERVE) {
        sbi_state_reserve_follow(body, walk, count);
        return;
    }
    if (walk->pass == SBI_STATE_READ) {
        body->last_load_id = last;
        sbi_state_take_loads(body, walk);
    }
    walk->store = walk->pass == SBI_STATE_READ;
    for (int i = 0; i < count && walk->result == SB_OK; i++) {
        sbi_load load;
        memset(&load, 0, sizeof load);
        if (walk->pass != SBI_STATE_CHECK)
            load = body->loads[i];
        sbi_state_load_head(body, walk, after, &load);
        sbi_state_load_rows(body, walk, &load, NULL);
        after = load.id;
        if (walk->store) {
            load.pattern_version = -1;
            sbi_load_weigh_faces(body, &load);
            body->loads[i] = load;
        }
    }
    walk->store = 0;
}

/* ---- constraints ---- */

/* Whether a saved equation can be one: a finite quotient for every term, and a slave that is free. */
static void sbi_state_check_equation(sbi_state_walk *walk, int id, int slave, sb_real first, sb_real value)
{
    if (!sb_is_finite(value) || first == 0 || !sb_is_finite(first))
        sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_NOT_FINITE, slave / 3,
                                             "the saved constraint %d has value %g and coefficient %g", id,
                                             (double)value, (double)first));
    else if (walk->fixed[slave / 3] >> slave % 3 & 1)
        sbi_state_refuse(walk,
                         sbi_fail_node(walk->error, SB_ERROR_FORMAT, slave / 3,
                                       "the slave of the saved constraint %d, node %d, is supported", id, slave / 3));
}

/* Equation c: from q in passes over a body; into it when storing; otherwise compared with it where there is one.
 * Returns its number of terms. */
static int sbi_state_equation(const sb_body *body, sbi_state_walk *walk, sbi_equations *q, int c, size_t from,
                              int *after)
{
    int n = body->domain.node_count, last = n <= INT32_MAX / 3 ? 3 * n - 1 : -1; /* as when it was added */
    int id = sbi_state_put_int(walk, q ? q->id + c : NULL, *after + 1, walk->next_constraint - 1, "constraint");
    sb_real value = sbi_state_put_real(walk, q ? q->value + c : NULL), first = 0;
    int count = sbi_state_int(walk, q && !walk->store ? q->start[c + 1] - q->start[c] : 1, 1, INT32_MAX, "term count");
    *after = id;
    if (q && !walk->store)
        walk->differs |= id != q->id[c] || count != q->start[c + 1] - q->start[c];
    for (int k = 0; k < count && walk->result == SB_OK && !walk->differs; k++) {
        int dof = sbi_state_put_int(walk, q ? q->dof + from + k : NULL, 0, last, "unknown");
        sb_real coefficient = sbi_state_put_real(walk, q ? q->coefficient + from + k : NULL);
        first = k == 0 ? coefficient : first;
        if (q)
            walk->differs |= dof != q->dof[from + (size_t)k] || coefficient != q->coefficient[from + (size_t)k];
        if (k == 0 && sbi_state_checks(walk))
            sbi_state_check_equation(walk, id, dof, first, value);
        if (sbi_state_checks(walk) && !sb_is_finite(coefficient / first))
            sbi_state_refuse(walk,
                             sbi_fail_node(walk->error, SB_ERROR_NOT_FINITE, dof / 3,
                                           "the saved constraint %d has coefficient %g", id, (double)coefficient));
    }
    if (walk->store)
        q->start[c + 1] = (int)from + count;
    return count;
}

/* Passes `count` equations, as above, and their forces. Stops where they differ. */
static size_t sbi_state_equations(const sb_body *body, sbi_state_walk *walk, sbi_equations *q, sb_real *force,
                                  int count)
{
    size_t terms = 0;
    int after = -1;
    walk->differs = 0;
    for (int c = 0; c < count && walk->result == SB_OK && !walk->differs; c++) {
        terms += (size_t)sbi_state_equation(body, walk, q, c, terms, &after);
        sbi_state_put_real(walk, force ? force + c : NULL);
    }
    return terms;
}

/* The system condensed by the image's equations, unless the body has it. */
static void sbi_state_reserve_equations(sb_body *body, sbi_state_walk *walk, int count)
{
    sbi_elimination_setup setup = sbi_body_elimination_setup(body, sbi_state_matrix(body, walk));
    int own = sb_body_constraint_count(body);
    size_t at = walk->used, terms;
    sbi_equations q;
    if (own == count && (count == 0 || !walk->pattern.needed)) {
        sbi_state_equations(body, walk, count ? &body->elimination->equations : NULL, NULL, count);
        if (!walk->differs || walk->result != SB_OK)
            return;
        walk->used = at;
    }
    walk->new_equations = 1;
    terms = sbi_state_equations(body, walk, NULL, NULL, count);
    if (count == 0 || walk->result != SB_OK)
        return;
    if (!sbi_equations_allocate(&body->allocator, count, terms, &q)) {
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for %d constraints", count));
        return;
    }
    walk->used = at;
    walk->store = 1;
    sbi_state_equations(body, walk, &q, NULL, count);
    walk->store = 0;
    sbi_state_reserve_ties(body, walk, q.count, q.start, NULL, q.dof, q.coefficient);
    if (walk->result == SB_OK)
        sbi_state_refuse(walk, sbi_elimination_create(&setup, &q, &walk->elimination, walk->error));
    if (walk->result != SB_OK)
        sbi_equations_free(&q);
}

static void sbi_state_memory_of(sbi_state_walk *walk, sb_preconditioner *precond);

static void sbi_state_constraints(sb_body *body, sbi_state_walk *walk)
{
    int next = sbi_state_int(walk, body->next_constraint, 0, INT32_MAX, "next constraint");
    int count = sbi_state_int(walk, sb_body_constraint_count(body), 0, INT32_MAX, "number of constraints");
    int is_of_body = walk->pass != SBI_STATE_CHECK && walk->pass != SBI_STATE_RESERVE;
    sbi_elimination *e;
    walk->next_constraint = next;
    if (walk->pass == SBI_STATE_RESERVE) {
        sbi_state_reserve_equations(body, walk, count);
        if (count > 0 && walk->result == SB_OK)
            sbi_state_memory_of(walk, NULL);
        return;
    }
    if (walk->pass == SBI_STATE_READ && walk->new_equations) {
        sbi_elimination_free(body->elimination);
        body->elimination = walk->elimination;
        walk->elimination = NULL;
    }
    if (walk->pass == SBI_STATE_READ)
        body->next_constraint = next;
    e = is_of_body ? body->elimination : NULL;
    walk->store = walk->pass == SBI_STATE_READ;
    sbi_state_equations(body, walk, e ? &e->equations : NULL, e ? e->force : NULL, count);
    walk->store = 0;
    if (count > 0)
        sbi_state_memory_of(walk, e ? e->precond : NULL);
}

/* ---- motion ---- */

/* Internal forces, 0 where they are not current. */
static void sbi_state_forces(sb_body *body, sbi_state_walk *walk, int current)
{
    size_t count = (size_t)body->domain.node_count;
    unsigned char *out;
    if (!current && sbi_state_place(walk, count, sizeof(sb_vec3), &out)) {
        if (out)
            memset(out, 0, count * sizeof(sb_vec3)); /* the bits of 0 */
        return;
    }
    if (sbi_state_bulk(walk, body->internal, count, sizeof(sb_vec3)))
        return;
    for (size_t i = 0; i < count && walk->result == SB_OK; i++) {
        sb_vec3 force = sbi_state_vector(walk, current ? body->internal[i] : sb_v3(0, 0, 0));
        if (walk->pass == SBI_STATE_READ)
            body->internal[i] = force;
    }
}

/* Motion, and the internal forces that go with it; zeros stand for forces that are not current. */
static void sbi_state_motion(sb_body *body, sbi_state_walk *walk)
{
    int n = body->domain.node_count;
    int fold_fallback = sbi_state_int(walk, body->assembly.fold_fallback, 0, 1, "fold-over fallback");
    int known = sbi_state_int(walk, body->acceleration_known, 0, 1, "acceleration mark");
    int current = sbi_state_int(walk, body->force_current, 0, 1, "force mark");
    sbi_state_vectors(walk, body->displacement, n, SBI_STATE_FINITE, "displacement");
    sbi_state_vectors(walk, body->velocity, n, SBI_STATE_FINITE, "velocity");
    sbi_state_vectors(walk, body->acceleration, n, SBI_STATE_FINITE, "acceleration");
    sbi_state_forces(body, walk, current);
    if (walk->pass != SBI_STATE_READ)
        return;
    body->assembly.fold_fallback = fold_fallback;
    body->acceleration_known = known;
    body->force_current = current;
    sbi_body_update_positions(body);
}

/* Of a body whose integrator goes on from accelerations; earlier versions have it of none. */
static int sbi_state_has_last_step(const sb_body *body)
{
    return body->integrator == SB_NEWMARK || body->integrator == SB_GENERALISED_ALPHA;
}

/* The length of the step that left the acceleration, 0 where that is not known. */
static void sbi_state_last_step(sb_body *body, sbi_state_walk *walk)
{
    sb_real step = sbi_state_real(walk, body->acceleration_known ? body->acceleration_step : 0);
    if (sbi_state_checks(walk) && (!(step >= 0) || !sb_is_finite(step)))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "the saved step is %g s long", (double)step));
    if (walk->pass == SBI_STATE_READ)
        body->acceleration_step = step;
}

/* A unit quaternion, as the solvers for rotations leave it. */
static sb_quat sbi_state_rotation(sbi_state_walk *walk, sb_quat q, int cell)
{
    sb_real n;
    q.w = sbi_state_real(walk, q.w);
    q.x = sbi_state_real(walk, q.x);
    q.y = sbi_state_real(walk, q.y);
    q.z = sbi_state_real(walk, q.z);
    n = sb_quat_dot(q, q);
    if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK && !(n > (sb_real)0.99 && n < (sb_real)1.01))
        sbi_state_refuse(walk, sbi_fail_element(walk->error, SB_ERROR_FORMAT, cell,
                                                "the saved rotation of element %d is none", cell));
    return q;
}

/* Where the batched loops keep the four numbers of a cell's rotation, SB_POLAR_LANES apart. */
static sb_real *sbi_state_batch_quat(sb_real *quats, int cell)
{
    return quats + (size_t)(cell / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + cell % SB_POLAR_LANES;
}

/* All of them in passes over a body; 0: one by one. */
static int sbi_state_give_quats(sbi_state_walk *walk, sb_real *quats, int cells)
{
    unsigned char *out;
    if (!sbi_state_place(walk, (size_t)cells, sizeof(sb_quat), &out))
        return 0;
    for (int e = 0; out && e < cells; e++, out += sizeof(sb_quat)) {
        const sb_real *at = sbi_state_batch_quat(quats, e);
        sb_quat q = sb_quat_make(at[0], at[SB_POLAR_LANES], at[2 * SB_POLAR_LANES], at[3 * SB_POLAR_LANES]);
        memcpy(out, &q, sizeof q);
    }
    return 1;
}

/* All lanes as they lie, where that is nobody else's business. 0: cell by cell. */
static int sbi_state_keep_quats(sbi_state_walk *walk, sb_real *quats, int cells)
{
    size_t batches = ((size_t)cells + SB_POLAR_LANES - 1) / SB_POLAR_LANES;
    return walk->plain && sbi_state_bulk(walk, quats, batches * 4 * SB_POLAR_LANES, sizeof(sb_real));
}

/* Rotations of the batched loops; an image's go to `to`. */
static void sbi_state_batch_quats(sbi_state_walk *walk, sb_real *quats, sb_real *to, int cells)
{
    if (sbi_state_keep_quats(walk, quats, cells) || sbi_state_give_quats(walk, quats, cells) ||
        (walk->pass != SBI_STATE_READ && sbi_state_skip(walk, (size_t)cells, sizeof(sb_quat))))
        return;
    for (int e = 0; e < cells && walk->result == SB_OK; e++) {
        const sb_real *from = sbi_state_batch_quat(quats, e);
        sb_quat q = sb_quat_make(from[0], from[SB_POLAR_LANES], from[2 * SB_POLAR_LANES], from[3 * SB_POLAR_LANES]);
        sb_real *at = sbi_state_batch_quat(to, e);
        if (!sbi_state_bulk(walk, &q, 1, sizeof q))
            q = sbi_state_rotation(walk, q, e);
        if (walk->pass != SBI_STATE_READ)
            continue;
        at[0] = q.w;
        at[SB_POLAR_LANES] = q.x;
        at[2 * SB_POLAR_LANES] = q.y;
        at[3 * SB_POLAR_LANES] = q.z;
    }
}

/* Warm starts. Both kinds where there are both: a change of material makes the body go over to the other one. What
 * the batched loops keep beside them (assembly.rotated) is made anew by each step before it is read. */
static void sbi_state_rotations(sb_body *body, sbi_state_walk *walk)
{
    const sbi_assembly *assembly = &body->assembly;
    int cells = body->domain.cell_count, points = body->domain.points_per_cell;
    int one_by_one = !sbi_state_bulk(walk, assembly->rotations, (size_t)cells * (size_t)points, sizeof(sb_quat));
    for (int e = 0; one_by_one && e < cells && walk->result == SB_OK; e++)
        for (int p = 0; p < points; p++) {
            sb_quat *at = assembly->rotations + (size_t)e * (size_t)points + (size_t)p;
            sb_quat q = sbi_state_rotation(walk, *at, e);
            if (walk->pass == SBI_STATE_READ)
                *at = q;
        }
    if (assembly->batch_quats)
        sbi_state_batch_quats(walk, assembly->batch_quats, assembly->batch_quats, cells);
}

/* What Prony terms remember: as many terms at every point, 0 for those that its material does not have. */
static void sbi_state_prony(sb_body *body, sbi_state_walk *walk)
{
    sbi_assembly *assembly = &body->assembly;
    int points = body->domain.points_per_cell;
    if (walk->pass == SBI_STATE_RESERVE)
        sbi_state_refuse(walk, sbi_assembly_reserve_memory(assembly, walk->terms, &body->allocator, walk->error));
    for (int e = 0; walk->terms && e < body->domain.cell_count && walk->result == SB_OK; e++) {
        int terms = body->materials[body->cell_material[e]].prony_count;
        size_t stride = 6 * (1 + (size_t)assembly->terms);
        for (int p = 0; p < points; p++)
            for (int k = 0; k < 6 * (1 + walk->terms); k++) {
                size_t at = ((size_t)e * (size_t)points + (size_t)p) * stride + (size_t)k;
                int is_used = walk->pass < SBI_STATE_CHECK && terms > 0 && k < 6 * (1 + terms);
                sb_real value = sbi_state_real(walk, is_used ? assembly->history[at] : 0);
                if (walk->pass == SBI_STATE_READ)
                    assembly->history[at] = value;
            }
    }
    if (walk->pass == SBI_STATE_READ)
        sbi_assembly_begin_step(assembly, 0);
}

/* What an explicit body knows of its stability. */
static void sbi_state_guard(sb_body *body, sbi_state_walk *walk)
{
    sbi_step_guard guard;
    guard.stable_step = sbi_state_real(walk, body->guard.stable_step);
    guard.age = sbi_state_int(walk, body->guard.age, 0, INT32_MAX, "age of the stable step");
    guard.monitor_open = sbi_state_int(walk, body->guard.monitor_open, 0, 1, "mark of the energy monitor");
    guard.caution = sbi_state_int(walk, body->guard.caution, 0, SBI_EXPLICIT_CAUTION, "caution");
    guard.calm = sbi_state_int(walk, body->guard.calm, 0, INT32_MAX - 1, "calm");
    guard.energy = sbi_state_double(walk, body->guard.energy);
    if (sbi_state_checks(walk) && (!(guard.stable_step >= 0) || !sb_is_finite(guard.stable_step)))
        sbi_state_refuse(
            walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "the saved stable step is %g s", (double)guard.stable_step));
    if (walk->pass == SBI_STATE_READ)
        body->guard = guard;
}

static sbi_precond_memory sbi_state_memory(sbi_state_walk *walk, sbi_precond_memory memory)
{
    memory.shift = sbi_state_double(walk, memory.shift);
    memory.successes = sbi_state_int(walk, memory.successes, 0, INT32_MAX, "preconditioner successes");
    memory.wait = sbi_state_int(walk, memory.wait, 0, INT32_MAX, "preconditioner wait");
    if (sbi_state_checks(walk) && !sbi_precond_is_memory(memory))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT,
                                        "the saved preconditioner's shift %g or wait %d "
                                        "is out of range",
                                        memory.shift, memory.wait));
    return memory;
}

/* What a preconditioner learnt; NULL in passes over an image that have none yet. */
static void sbi_state_memory_of(sbi_state_walk *walk, sb_preconditioner *precond)
{
    sbi_precond_memory memory = {0, 0, 0};
    if (precond)
        memory = sbi_precond_get_memory(precond);
    memory = sbi_state_memory(walk, memory);
    if (walk->pass == SBI_STATE_READ)
        sbi_precond_set_memory(precond, memory);
}

static void sbi_state_precond(sb_body *body, sbi_state_walk *walk) { sbi_state_memory_of(walk, body->precond); }

/* ---- a tangent that steps keep ---- */

static int sbi_state_keeps(const sb_body *body) { return body->kept && body->kept->angle > 0; }

static void sbi_state_check_kept(sbi_state_walk *walk, sb_real angle, const sbi_kept_made *made)
{
    if (sbi_state_checks(walk) && (!(angle > 0) || !(angle <= 1) || !(made->mass >= 0) || !sb_is_finite(made->mass) ||
                                   !(made->stiffness > 0) || !sb_is_finite(made->stiffness)))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT,
                                        "the saved tangent has an angle of %g, and factors of %g and %g", (double)angle,
                                        (double)made->mass, (double)made->stiffness));
}

/* 1: the snapshot that is written has what is kept from before. */
static int sbi_state_holds_tangent(const sb_body *body, sbi_state_walk *walk)
{
    if (!sbi_kept_is_valid(body))
        return 0;
    walk->has.tangent_at = walk->used;
    walk->has.tangent_stamp = body->kept->stamps[body->kept->made.slot];
    return walk->same_mesh && walk->had.tangent_at == walk->used && walk->had.tangent_stamp == walk->has.tangent_stamp;
}

/* Of a body that keeps nothing yet: what it would keep now, so that the size is the same. */
static void sbi_state_kept(sb_body *body, sbi_state_walk *walk)
{
    sbi_kept *kept = body->kept;
    int valid = sbi_kept_is_valid(body), reads = walk->pass == SBI_STATE_READ, slot = kept ? kept->made.slot : 0;
    sbi_state_pass pass = walk->pass;
    sbi_kept_made made;
    sb_real angle = sbi_state_real(walk, kept ? kept->angle : 0);
    sb_vec3 *positions = valid || reads ? kept->positions[slot] : body->position;
    sb_real *rotations = valid || reads ? kept->rotations[slot] : body->assembly.batch_quats;
    if (walk->pass == SBI_STATE_CHECK && !sbi_kept_fits(body))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "only bodies of tet4 keep their tangent"));
    if (walk->pass == SBI_STATE_RESERVE && !kept && !sbi_kept_take(body))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory to keep a tangent"));
    if (walk->result != SB_OK)
        return;
    memset(&made, 0, sizeof made);
    made.stiffness = 1;
    made.before = sbi_precond_get_memory(body->precond);
    made = valid ? kept->made : made;
    made.valid = sbi_state_int(walk, made.valid, 0, 1, "mark of a tangent");
    made.mass = sbi_state_real(walk, made.mass);
    made.stiffness = sbi_state_real(walk, made.stiffness);
    sbi_state_check_kept(walk, angle, &made);
    made.before = sbi_state_memory(walk, made.before);
    walk->pass = sbi_state_holds_tangent(body, walk) ? SBI_STATE_MEASURE : pass;
    sbi_state_vectors(walk, positions, body->domain.node_count, SBI_STATE_FINITE, "position under a tangent");
    sbi_state_batch_quats(walk, rotations, rotations, body->domain.cell_count);
    walk->pass = pass;
    if (!reads)
        return;
    made.slot = slot;
    kept->stamps[slot] = ++kept->count;
    kept->angle = angle;
    kept->current = 0;
    kept->made = kept->saved = made;
}

/* ---- free rigid bodies ---- */

/* Doubles; place is NULL where the image's are not kept. */
static void sbi_state_doubles(sbi_state_walk *walk, double *place, int count)
{
    for (int k = 0; k < count; k++) {
        double value = sbi_state_double(walk, place[k]);
        if (sbi_state_checks(walk) && value - value != 0)
            sbi_state_refuse(
                walk, sbi_fail(walk->error, SB_ERROR_NOT_FINITE, "a saved number of a rigid body is not finite"));
        if (sbi_state_is_image(walk))
            place[k] = value;
    }
}

static void sbi_state_rigid_motion(sbi_state_walk *walk, sbi_rigid_state *state)
{
    double square = 0;
    sbi_state_doubles(walk, state->centre, 3);
    sbi_state_doubles(walk, state->turn, 4);
    sbi_state_doubles(walk, state->velocity, 3);
    sbi_state_doubles(walk, state->acceleration, 3);
    sbi_state_doubles(walk, state->spin, 3);
    sbi_state_doubles(walk, state->spin_rate, 3);
    sbi_state_doubles(walk, state->wrench, 6);
    for (int k = 0; k < 4; k++)
        square += state->turn[k] * state->turn[k];
    if (sbi_state_checks(walk) && !(square > 0.99 && square < 1.01))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "a saved rigid body has no turn"));
}

/* The nodes that hang on one; own: where they are, and the image's go, or NULL: nowhere. */
static void sbi_state_rigid_nodes(const sb_body *body, sbi_state_walk *walk, sbi_rigid *own, int count)
{
    int last = -1;
    for (int i = 0; i < count && walk->result == SB_OK; i++) {
        double nowhere[3] = {0, 0, 0};
        int node =
            sbi_state_int(walk, own ? own->hung[i] : 0, last + 1, body->domain.node_count - 1, "node of a rigid body");
        sbi_state_doubles(walk, own ? own->arm[i] : nowhere, 3);
        if (own && sbi_state_is_image(walk))
            own->hung[i] = node;
        last = node;
    }
}

/* Where the image's number `at` goes: in RESERVE one that is made, NULL where the body's serve or there is no memory;
 * in READ what was made, or the body's. In passes over a body its own; in CHECK NULL. */
static sbi_rigid *sbi_state_rigid_place(const sb_body *body, sbi_state_walk *walk, int at, int count)
{
    sbi_rigid *made;
    if (walk->pass == SBI_STATE_CHECK || (walk->pass == SBI_STATE_RESERVE && !walk->rigids))
        return NULL;
    if (walk->pass != SBI_STATE_RESERVE)
        return walk->pass == SBI_STATE_READ && walk->new_rigids ? walk->rigids->list[at] : body->rigids->list[at];
    made = sbi_rigid_make(&body->allocator, count);
    if (made)
        walk->rigids->list[walk->rigids->count++] = made;
    else
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for a rigid body"));
    return made;
}

static void sbi_state_rigid(const sb_body *body, sbi_state_walk *walk, int at, int *after)
{
    const sbi_rigids *own = body->rigids;
    const sbi_rigid *had = own && at < own->count ? own->list[at] : NULL;
    int id = sbi_state_int(walk, had ? had->id : 0, *after + 1, INT32_MAX, "id of a rigid body");
    int count =
        sbi_state_int(walk, had ? had->count : 0, 0, body->domain.node_count, "number of nodes of a rigid body");
    sbi_rigid any, *to;
    if (walk->pass == SBI_STATE_CHECK && (!had || had->id != id || had->capacity < count))
        walk->new_rigids = 1;
    to = sbi_state_rigid_place(body, walk, at, count);
    if (walk->result != SB_OK)
        return;
    memset(&any, 0, sizeof any);
    *after = id;
    if (to && sbi_state_is_image(walk)) {
        to->id = id;
        to->count = count;
    }
    sbi_state_doubles(walk, to ? &to->mass : &any.mass, 1);
    sbi_state_doubles(walk, to ? to->inertia : any.inertia, 9);
    sbi_state_doubles(walk, to ? to->load : any.load, 6);
    if (sbi_state_checks(walk) && !sbi_rigid_has_inertia(any.mass, any.inertia))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "a saved rigid body has no mass or no inertia"));
    sbi_state_rigid_motion(walk, to ? &to->now : &any.now);
    sbi_state_rigid_motion(walk, to ? &to->home : &any.home);
    sbi_state_rigid_nodes(body, walk, to, count);
}

/* Room for steps with those that were made, beside the matrix that the body will have. */
static void sbi_state_reserve_rigids(sb_body *body, sbi_state_walk *walk)
{
    const sb_matrix *matrix = walk->pattern.needed ? &walk->pattern.matrix : &body->matrix;
    const sbi_elimination *e = walk->new_equations                                 ? walk->elimination
                               : walk->pattern.needed && walk->pattern.elimination ? walk->pattern.elimination
                                                                                   : body->elimination;
    sbi_state_refuse(walk, sbi_body_reserve_rigids(body, walk->rigids, e ? &e->matrix : matrix, walk->error));
}

/* Those that move freely, of a body that has had one. */
static void sbi_state_rigids(sb_body *body, sbi_state_walk *walk)
{
    sbi_rigids *own = body->rigids;
    int last = sbi_state_int(walk, own ? own->last_id : 0, 1, INT32_MAX, "last id of a rigid body"), after = 0;
    int count = sbi_state_int(walk, own ? own->count : 0, 0, SB_MAX_RIGID, "number of rigid bodies");
    walk->rigid_count = count;
    if (walk->pass == SBI_STATE_CHECK)
        walk->new_rigids = !own || own->count != count;
    if (walk->pass == SBI_STATE_RESERVE && walk->new_rigids) {
        walk->rigids = (sbi_rigids *)sbi_alloc_zeroed(&body->allocator, 1, sizeof *walk->rigids);
        if (!walk->rigids)
            sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_MEMORY, "no memory for %d rigid bodies", count));
    }
    for (int k = 0; k < count && walk->result == SB_OK; k++)
        sbi_state_rigid(body, walk, k, &after);
    if (sbi_state_checks(walk) && after > last)
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "a saved rigid body has an id beyond the last"));
    if (walk->pass == SBI_STATE_RESERVE && walk->rigids && walk->result == SB_OK)
        sbi_state_reserve_rigids(body, walk);
    if (walk->pass != SBI_STATE_READ)
        return;
    if (walk->new_rigids) {
        sbi_rigids_free(&body->allocator, own);
        body->rigids = walk->rigids;
        walk->rigids = NULL;
    }
    body->rigids->last_id = last;
}

static int sbi_state_has_rigid_loads(const sb_body *body)
{
    for (int k = 0; body->rigids && k < body->rigids->count; k++)
        for (int i = 0; i < 6; i++)
            if (body->rigids->list[k]->equilibrated[i] != 0)
                return 1;
    return 0;
}

/* What a static solve ended with, where there was one. */
static void sbi_state_rigid_loads(sb_body *body, sbi_state_walk *walk)
{
    for (int k = 0; k < walk->rigid_count && walk->result == SB_OK; k++) {
        double none[6] = {0, 0, 0, 0, 0, 0};
        int has = !sbi_state_is_image(walk) || walk->pass == SBI_STATE_READ;
        sbi_state_doubles(walk, has ? body->rigids->list[k]->equilibrated : none, 6);
    }
}

/* ---- a mesh that may change ---- */

/* Numbers of its part, which comes first; the second of a mesh with pieces of tet4, the third of one with glue besides,
 * then both of tet10, the last as earlier versions had pieces; they had those of tet10 under the numbers of tet4. */
enum {
    SBI_STATE_LIVE = 15,
    SBI_STATE_PIECES = 17,
    SBI_STATE_GLUED = 19,
    SBI_STATE_PIECES_10 = 24,
    SBI_STATE_GLUED_10 = 25,
    SBI_STATE_PIECES_BEFORE = 16
};

static int sbi_state_number_has_glue(uint64_t number)
{
    return number == SBI_STATE_GLUED || number == SBI_STATE_GLUED_10;
}

static int sbi_state_number_has_pieces(uint64_t number)
{
    return sbi_state_number_has_glue(number) || number == SBI_STATE_PIECES || number == SBI_STATE_PIECES_10;
}

/* The body's mesh as the walk passes it; borrowed arrays. */
static sbi_live_mesh sbi_state_live_view(const sb_body *body)
{
    sbi_live_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.nodes = body->live->nodes;
    mesh.cells = body->live->cells;
    mesh.positions = body->reference;
    mesh.corners = body->domain.cells;
    mesh.material = body->cell_material;
    mesh.shares = body->live->shares;
    mesh.patches = body->domain.cell_patch;
    mesh.has_pieces = body->live->piece_count > 0;
    mesh.pieces = mesh.has_pieces ? body->live->pieces : NULL;
    mesh.glue_count = mesh.has_pieces ? body->live->glue.count : 0;
    mesh.glue = body->live->glue.ties;
    return mesh;
}

/* The number of the body's part of the mesh. */
static int sbi_state_live_number(const sb_body *body)
{
    const int is_glued = body->live->glue.count > 0;
    if (!body->live->piece_count)
        return SBI_STATE_LIVE;
    if (body->domain.element_type == SB_TET10)
        return is_glued ? SBI_STATE_GLUED_10 : SBI_STATE_PIECES_10;
    return is_glued ? SBI_STATE_GLUED : SBI_STATE_PIECES;
}

/* How many pieces of cells with n nodes there are, and each with its cell. */
static void sbi_state_pieces(sbi_state_walk *walk, sbi_live_mesh *mesh, int n)
{
    const int face_nodes = sbi_piece_face_nodes(n);
    int count = 0, cell = 0;
    for (int e = 0; e < mesh->cells.end; e++)
        count += mesh->pieces[e].is != 0;
    count = sbi_state_int(walk, count, 1, mesh->cells.end, "number of pieces");
    for (int k = 0; k < count && walk->result == SB_OK; k++, cell++) {
        sbi_piece *piece;
        while (!walk->store && cell < mesh->cells.end - 1 && mesh->pieces[cell].is == 0)
            cell++;
        cell = sbi_state_int(walk, cell, cell, mesh->cells.end - 1, "cell of a piece");
        if (walk->result != SB_OK)
            return;
        piece = mesh->pieces + cell;
        if (walk->store)
            piece->is = 1;
        for (int i = 0; i < 3; i++)
            sbi_state_put_real(walk, piece->centroid + i);
        for (int i = 0; i < 6; i++)
            sbi_state_put_real(walk, piece->covariance + i);
        for (int i = 0; i < 4 * face_nodes; i++)
            sbi_state_put_real(walk, &piece->faces[i / face_nodes][i % face_nodes]);
    }
}

/* Ties between pieces of cells with n nodes. */
static void sbi_state_glue(sbi_state_walk *walk, sbi_live_mesh *mesh, int n)
{
    for (int k = 0; k < mesh->glue_count && walk->result == SB_OK; k++) {
        for (int side = 0; side < 2; side++)
            sbi_state_put_int(walk, mesh->glue[k].cells + side, 0, mesh->cells.end - 1, "cell of a tie");
        for (int i = 0; i < sbi_glue_gram(n); i++)
            sbi_state_put_real(walk, mesh->glue[k].gram + i);
    }
}

/* How many there are. */
static int sbi_state_glue_count(sbi_state_walk *walk, int count)
{
    return sbi_state_int(walk, count, 1, INT32_MAX / 64, "number of ties");
}

/* Counts of one kind of slots, and the free ones in the order in which they will be used. */
static void sbi_state_slot_counts(sbi_state_walk *walk, sbi_slots *slots)
{
    slots->end = sbi_state_int(walk, slots->end, 1, INT32_MAX / 16, "end of the slots");
    slots->count = sbi_state_int(walk, slots->count, 0, INT32_MAX / 16, "number of free slots");
    slots->fresh = sbi_state_int(walk, slots->fresh, 1, INT32_MAX / 8, "first slot that was never used");
}

static void sbi_state_slot_stack(sbi_state_walk *walk, sbi_slots *slots)
{
    for (int k = 0; k < slots->count && walk->result == SB_OK; k++)
        sbi_state_put_int(walk, slots->stack ? slots->stack + k : NULL, 0, slots->fresh - 1, "free slot");
}

/* Places and cells at once: the body's own are given away, an image's that the body has already are passed by. 0: not
 * in this pass. */
static int sbi_state_pass_mesh(sbi_state_walk *walk, const sbi_live_mesh *mesh, int n)
{
    size_t corners = (size_t)n * sizeof(int), size = sizeof(sb_real) + sizeof(int) + corners;
    size_t nodes = (size_t)mesh->nodes.end, cells = (size_t)mesh->cells.end;
    unsigned char *out;
    if (!walk->store && sbi_state_skip(walk, nodes, sizeof(sb_vec3)))
        return sbi_state_skip(walk, cells, size);
    if (sbi_state_is_image(walk) || !sbi_state_bulk(walk, mesh->positions, nodes, sizeof(sb_vec3)) ||
        !sbi_state_place(walk, cells, size, &out))
        return 0;
    for (size_t e = 0; out && e < cells; e++, out += size) {
        const int *cell = mesh->corners + e * (size_t)n;
        memcpy(out, mesh->shares + e, sizeof(sb_real));
        memcpy(out + sizeof(sb_real), mesh->material + e, sizeof(int));
        if (n == 4) /* compilers make one move of it */
            memcpy(out + sizeof(sb_real) + sizeof(int), cell, 4 * sizeof(int));
        else
            memcpy(out + sizeof(sb_real) + sizeof(int), cell, corners);
    }
    return 1;
}

/* Places and cells one by one. */
static void sbi_state_walk_mesh(sbi_state_walk *walk, sbi_live_mesh *mesh, int n, int materials)
{
    for (int i = 0; i < mesh->nodes.end && walk->result == SB_OK; i++)
        sbi_state_put_vector(walk, mesh->positions + i, SBI_STATE_FINITE, "rest position");
    for (int e = 0; e < mesh->cells.end && walk->result == SB_OK; e++) {
        sbi_state_put_real(walk, mesh->shares + e);
        sbi_state_put_int(walk, mesh->material + e, 0, materials - 1, "region of a cell");
        for (int a = 0; a < n && walk->result == SB_OK; a++)
            sbi_state_put_int(walk, mesh->corners + (size_t)e * (size_t)n + a, 0, mesh->nodes.end - 1,
                              "node of a cell");
    }
}

/* Places and cells, and their patches. */
static void sbi_state_mesh(sbi_state_walk *walk, sbi_live_mesh *mesh, int n, int materials)
{
    if (!sbi_state_pass_mesh(walk, mesh, n))
        sbi_state_walk_mesh(walk, mesh, n, materials);
    for (int e = 0; mesh->patches && e < mesh->cells.end && walk->result == SB_OK; e++)
        sbi_state_put_int(walk, mesh->patches + e, -1, mesh->cells.end - 1, "patch of a cell");
}

/* 1: the snapshot that is written has the mesh from before. */
static int sbi_state_holds_mesh(sbi_state_walk *walk)
{
    walk->has.mesh_at = walk->used;
    return walk->same_mesh && walk->had.mesh_at == walk->used;
}

/* What follows the counts; `store` has the image's values go into the mesh. */
static void sbi_state_live_arrays(sbi_state_walk *walk, sbi_live_mesh *mesh, int n, int materials)
{
    sbi_state_pass pass = walk->pass;
    sbi_state_slot_stack(walk, &mesh->nodes);
    sbi_state_slot_stack(walk, &mesh->cells);
    if (mesh->pieces && walk->result == SB_OK)
        sbi_state_pieces(walk, mesh, n);
    sbi_state_glue(walk, mesh, n);
    walk->pass = sbi_state_holds_mesh(walk) ? SBI_STATE_MEASURE : pass;
    sbi_state_mesh(walk, mesh, n, materials);
    walk->pass = pass;
}

/* The part of bodies with slack. Passes over an image find the body with that mesh already: they only go past it. */
static void sbi_state_live(sb_body *body, sbi_state_walk *walk)
{
    sbi_live_mesh mesh = sbi_state_live_view(body);
    int store = walk->store;
    walk->store = 0;
    sbi_state_slot_counts(walk, &mesh.nodes);
    sbi_state_slot_counts(walk, &mesh.cells);
    if (mesh.glue_count)
        sbi_state_glue_count(walk, mesh.glue_count);
    sbi_state_live_arrays(walk, &mesh, body->domain.nodes_per_cell, body->material_count);
    walk->store = store;
}

/* Which slots are in use, from those that are not; 0: they do not fit together. */
static int sbi_state_use_slots(sbi_slots *slots)
{
    memset(slots->used, 0, (size_t)slots->capacity);
    memset(slots->used, 1, (size_t)slots->fresh);
    for (int k = 0; k < slots->count; k++) {
        if (!slots->used[slots->stack[k]])
            return 0;
        slots->used[slots->stack[k]] = 0;
    }
    for (int i = slots->end; i < slots->fresh; i++)
        if (slots->used[i])
            return 0;
    return slots->used[slots->end - 1];
}

/* Whether cells in use have used nodes, each once, and a share, and free ones have nothing. */
static sb_result sbi_state_check_cells(const sbi_live_mesh *mesh, int n, sb_error *error)
{
    for (int e = 0; e < mesh->cells.end; e++) {
        const int *cell = mesh->corners + (size_t)e * (size_t)n;
        sb_real share = mesh->shares[e];
        int used = mesh->cells.used[e], is_piece = mesh->pieces && mesh->pieces[e].is != 0;
        int bad = used ? !(is_piece ? share >= 0 : share > 0) || !(share <= 1) : share != 0 || is_piece;
        bad |= is_piece && !sbi_piece_is_sound(mesh->pieces + e, n);
        for (int a = 0; a < n; a++) {
            bad |= used ? !mesh->nodes.used[cell[a]] : cell[a] != 0;
            for (int b = 0; b < a && used; b++)
                bad |= cell[b] == cell[a];
        }
        if (bad)
            return sbi_fail_element(error, SB_ERROR_FORMAT, e, "the saved cell %d is damaged", e);
    }
    return SB_OK;
}

/* Takes the k-th of g's rows and columns out of the others. */
static void sbi_state_eliminate(double g[SBI_GLUE_NODES][SBI_GLUE_NODES], int n, int k)
{
    for (int i = 0; i < n; i++) {
        double factor = g[i][k] / g[k][k];
        for (int j = 0; j < n && i != k; j++)
            g[i][j] = j == k ? 0 : g[i][j] - factor * g[k][j];
    }
    for (int j = 0; j < n; j++)
        g[k][j] = 0;
}

/* Whether G is a sum of w N N^T with w >= 0 and 0 <= trace <= most, within rounding: eliminated by its largest pivots
 * nothing may be left of it. */
static int sbi_state_is_gram(const sb_real *gram, int n, double most)
{
    double g[SBI_GLUE_NODES][SBI_GLUE_NODES], trace = 0, rounding;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            g[i][j] = (double)gram[sbi_glue_at(n, i, j)];
    for (int i = 0; i < n; i++)
        trace += g[i][i];
    if (!(trace >= 0) || !(trace <= most))
        return 0;
    rounding = 256 * (double)SB_EPSILON * trace;
    for (int step = 0; step < n; step++) {
        int k = 0;
        for (int i = 1; i < n; i++)
            k = g[i][i] > g[k][k] ? i : k;
        if (!(g[k][k] > rounding))
            break;
        sbi_state_eliminate(g, n, k);
    }
    for (int i = 0; i < n * n; i++)
        if (!(fabs(g[i / n][i % n]) <= rounding))
            return 0;
    return 1;
}

/* Glue of a cut is far below that many lengths of a cell's edge: beyond, steps would but hold the two together. */
static const double sbi_state_most_glue = 1e9;

/* Whether a tie is between two pieces of one element, which stand on copies of its nodes, with a matrix that is one. */
static int sbi_state_is_tie(const sbi_live_mesh *mesh, const sbi_glue_tie *tie, int n)
{
    const int *corners[2];
    double longest = 0;
    for (int side = 0; side < 2; side++) {
        corners[side] = mesh->corners + (size_t)n * (size_t)tie->cells[side];
        if (!mesh->cells.used[tie->cells[side]] || mesh->pieces[tie->cells[side]].is == 0)
            return 0;
    }
    for (int i = 0; i < n; i++) {
        sb_vec3 a = mesh->positions[corners[0][i]], b = mesh->positions[corners[1][i]];
        if (a.x != b.x || a.y != b.y || a.z != b.z)
            return 0;
        for (int j = 0; j < i; j++)
            longest = fmax(longest, (double)sb_v3_norm(sb_v3_sub(a, mesh->positions[corners[0][j]])));
    }
    for (int i = 0; i < SBI_GLUE_GRAM; i++)
        if (!sb_is_finite(tie->gram[i]))
            return 0;
    return tie->cells[0] != tie->cells[1] && sbi_state_is_gram(tie->gram, n, sbi_state_most_glue * longest);
}

static sb_result sbi_state_check_glue(const sbi_live_mesh *mesh, int n, sb_error *error)
{
    for (int k = 0; k < mesh->glue_count; k++)
        if (!sbi_state_is_tie(mesh, mesh->glue + k, n))
            return sbi_fail_element(error, SB_ERROR_FORMAT, mesh->glue[k].cells[0],
                                    "the saved tie %d between the cells %d and %d is damaged", k,
                                    mesh->glue[k].cells[0], mesh->glue[k].cells[1]);
    return SB_OK;
}

/* Whether cells in use, and no others, are in patches, which are numbered by their first cells. */
static sb_result sbi_state_check_patches(const sbi_live_mesh *mesh, sb_error *error)
{
    int next = 0;
    for (int e = 0; mesh->patches && e < mesh->cells.end; e++) {
        int patch = mesh->patches[e];
        if ((patch >= 0) != (mesh->cells.used[e] != 0) || patch > next)
            return sbi_fail_element(error, SB_ERROR_FORMAT, e, "the saved cell %d is in patch %d, which is damaged", e,
                                    patch);
        next += patch == next;
    }
    return SB_OK;
}

/* Reads the mesh of an image. */
static sb_result sbi_state_read_mesh(const sb_body *body, const sbi_state_walk *from, sbi_live_mesh *mesh,
                                     sb_error *error)
{
    sbi_state_walk walk = *from;
    sbi_slots nodes, cells;
    int n = body->domain.nodes_per_cell;
    int number = sbi_int_of(sbi_get_bytes(from->in + SBI_IMAGE_HEAD, 4)), glue_count = 0;
    int has_pieces = sbi_state_number_has_pieces((uint64_t)number);
    uint64_t needed;
    sb_result result = has_pieces ? sbi_live_check_pieces(body, error) : SB_OK;
    if (result != SB_OK)
        return result;
    memset(&nodes, 0, sizeof nodes);
    memset(&cells, 0, sizeof cells);
    walk.pass = SBI_STATE_CHECK;
    walk.used = SBI_IMAGE_HEAD + 4; /* behind the number of the part */
    sbi_state_slot_counts(&walk, &nodes);
    sbi_state_slot_counts(&walk, &cells);
    if (sbi_state_number_has_glue((uint64_t)number))
        glue_count = sbi_state_glue_count(&walk, 1);
    if (walk.result != SB_OK)
        return walk.result;
    needed = 4 * ((uint64_t)nodes.count + (uint64_t)cells.count) + 3 * sizeof(sb_real) * (uint64_t)nodes.end +
             (uint64_t)cells.end * (sizeof(sb_real) + 4 + 4 * (uint64_t)n + (body->domain.cell_patch ? 4 : 0)) +
             (uint64_t)glue_count * (2 * 4 + (uint64_t)sbi_glue_gram(n) * sizeof(sb_real));
    if (needed > walk.size - walk.used || nodes.fresh > nodes.end + nodes.count ||
        cells.fresh > cells.end + cells.count || nodes.count > nodes.fresh || cells.count > cells.fresh ||
        nodes.end > nodes.fresh || cells.end > cells.fresh)
        return sbi_fail(error, SB_ERROR_FORMAT, "the slots of the saved mesh do not fit together");
    result = sbi_live_mesh_room(body, &nodes, &cells, has_pieces, glue_count, mesh, error);
    if (result != SB_OK)
        return result;
    walk.store = 1;
    sbi_state_live_arrays(&walk, mesh, n, body->material_count);
    if (walk.result == SB_OK && (!sbi_state_use_slots(&mesh->nodes) || !sbi_state_use_slots(&mesh->cells)))
        walk.result = sbi_fail(error, SB_ERROR_FORMAT, "the free slots of the saved mesh do not fit together");
    if (walk.result == SB_OK)
        walk.result = sbi_state_check_cells(mesh, n, error);
    if (walk.result == SB_OK)
        walk.result = sbi_state_check_glue(mesh, n, error);
    if (walk.result == SB_OK)
        walk.result = sbi_state_check_patches(mesh, error);
    return walk.result;
}

/* 1 when the body has this mesh, and its free slots in this order. */
static int sbi_state_same_slots(const sbi_slots *a, const sbi_slots *b)
{
    return a->end == b->end && a->fresh == b->fresh && a->count == b->count &&
           (a->count == 0 || memcmp(a->stack, b->stack, (size_t)a->count * sizeof(int)) == 0) &&
           memcmp(a->used, b->used, (size_t)a->end) == 0;
}

static int sbi_state_same_glue(const sbi_glue *glue, const sbi_live_mesh *mesh)
{
    int same = glue->count == mesh->glue_count;
    for (int k = 0; k < mesh->glue_count && same; k++)
        same = memcmp(glue->ties[k].cells, mesh->glue[k].cells, sizeof glue->ties[k].cells) == 0 &&
               memcmp(glue->ties[k].gram, mesh->glue[k].gram, sizeof glue->ties[k].gram) == 0;
    return same;
}

static int sbi_state_same_mesh(const sb_body *body, const sbi_live_mesh *mesh)
{
    size_t nodes = (size_t)mesh->nodes.end, cells = (size_t)mesh->cells.end, n = (size_t)body->domain.nodes_per_cell;
    int pieces = 0;
    for (size_t e = 0; mesh->pieces && e < cells; e++)
        pieces += mesh->pieces[e].is != 0;
    return pieces == body->live->piece_count && sbi_state_same_glue(&body->live->glue, mesh) &&
           (!pieces || memcmp(body->live->pieces, mesh->pieces, cells * sizeof(sbi_piece)) == 0) &&
           sbi_state_same_slots(&body->live->nodes, &mesh->nodes) &&
           sbi_state_same_slots(&body->live->cells, &mesh->cells) &&
           memcmp(body->reference, mesh->positions, nodes * sizeof(sb_vec3)) == 0 &&
           memcmp(body->domain.cells, mesh->corners, cells * n * sizeof(int)) == 0 &&
           memcmp(body->cell_material, mesh->material, cells * sizeof(int)) == 0 &&
           memcmp(body->live->shares, mesh->shares, cells * sizeof(sb_real)) == 0 &&
           (!mesh->patches || memcmp(body->domain.cell_patch, mesh->patches, cells * sizeof(int)) == 0);
}

/* A room that gives bodies something to remember adds its part here: a function and a number of its own. The order is
 * that of the image; materials come before what depends on them. */
typedef struct sbi_state_own {
    int number;
    void (*walk)(sb_body *body, sbi_state_walk *walk);
} sbi_state_own;

static const sbi_state_own sbi_state_owns[] = {
    {SBI_STATE_LIVE, sbi_state_live},
    {1, sbi_state_make},
    {2, sbi_state_settings},
    {3, sbi_state_materials},
    {22, sbi_state_prestretch},
    {9, sbi_state_fibres},
    {21, sbi_state_region_damping},
    {10, sbi_state_extra},
    {4, sbi_state_supports},
    {5, sbi_state_loads},
    {18, sbi_state_tractions},
    {11, sbi_state_follow},
    {12, sbi_state_constraints},
    {26, sbi_state_rigids},
    {27, sbi_state_rigid_loads},
    {6, sbi_state_rotations},
    {13, sbi_state_prony},
    {7, sbi_state_motion},
    {20, sbi_state_last_step},
    {14, sbi_state_guard},
    {8, sbi_state_precond},
    {23, sbi_state_kept},
};
enum { SBI_STATE_OWNS = sizeof sbi_state_owns / sizeof sbi_state_owns[0], SBI_STATE_VERSION = 3 };

static const char sbi_state_magic[9] = "SBSTATE\x1A";

/* 1: the body has a part that most have not, or the image, whose next one it is then. */
static int sbi_state_has_part(const sbi_state_walk *walk, const sbi_state_own *part, int is_in_body)
{
    if (!sbi_state_is_image(walk))
        return is_in_body;
    return walk->size - walk->used >= 4 && sbi_get_bytes(walk->in + walk->used, 4) == (uint64_t)part->number;
}

/* 0: the part is left out; what the body has of it is then as without. */
static int sbi_state_enters_part(sb_body *body, const sbi_state_walk *walk, const sbi_state_own *part)
{
    int reads = walk->pass == SBI_STATE_READ;
    if (part->walk == sbi_state_live)
        return body->live != NULL;
    if (part->walk == sbi_state_make)
        return !walk->plain;
    if (part->walk == sbi_state_tractions && !sbi_state_has_part(walk, part, body->traction_count > 0)) {
        body->traction_count = reads ? 0 : body->traction_count;
        return 0;
    }
    if (part->walk == sbi_state_rigids && !sbi_state_has_part(walk, part, body->rigids && body->rigids->last_id > 0)) {
        if (reads) {
            sbi_rigids_free(&body->allocator, body->rigids);
            body->rigids = NULL;
        }
        return 0;
    }
    if (part->walk == sbi_state_rigid_loads && !sbi_state_has_part(walk, part, sbi_state_has_rigid_loads(body))) {
        for (int k = 0; reads && body->rigids && k < body->rigids->count; k++)
            memset(body->rigids->list[k]->equilibrated, 0, sizeof body->rigids->list[k]->equilibrated);
        return 0;
    }
    if (part->walk == sbi_state_prestretch)
        return sbi_state_has_part(walk, part, sbi_state_has_prestretch(body));
    if (part->walk == sbi_state_region_damping && !sbi_state_has_part(walk, part, body->regional_damping)) {
        body->regional_damping = reads ? 0 : body->regional_damping;
        return 0;
    }
    if (part->walk == sbi_state_kept && !sbi_state_has_part(walk, part, sbi_state_keeps(body))) {
        if (reads && body->kept)
            body->kept->angle = 0;
        return 0;
    }
    if (part->walk == sbi_state_last_step && !sbi_state_has_part(walk, part, sbi_state_has_last_step(body))) {
        body->acceleration_step = reads ? 0 : body->acceleration_step;
        return 0;
    }
    return 1;
}

static void sbi_state_run(sb_body *body, sbi_state_walk *walk, sbi_state_pass pass)
{
    walk->pass = pass;
    walk->used = pass == SBI_STATE_HASH ? 0 : SBI_IMAGE_HEAD;
    for (int i = 0; i < SBI_STATE_OWNS && walk->result == SB_OK; i++) {
        const sbi_state_own *part = sbi_state_owns + i;
        int number = part->number;
        if (!sbi_state_enters_part(body, walk, part))
            continue;
        if (part->walk == sbi_state_live)
            number = sbi_state_live_number(body);
        sbi_state_int(walk, number, number, number, "part");
        if (walk->result == SB_OK)
            part->walk(body, walk);
    }
}

/* What others keep about the body, behind its own parts. */
static void sbi_state_put_parts(const sb_body *body, sbi_state_walk *walk)
{
    sbi_state_out out;
    if (walk->plain)
        return;
    memset(&out, 0, sizeof out);
    out.bytes = walk->pass == SBI_STATE_WRITE ? walk->out : NULL;
    out.used = walk->used;
    out.hashes = walk->pass == SBI_STATE_HASH;
    out.hash = walk->hash;
    sbi_state_parts_put(body, &out);
    walk->used = out.used;
    walk->overflow |= out.overflow;
    walk->hash = out.hash;
}

/* A walk that only reads the body. Parts take bodies that they may change, so they get a copy of the struct; its
 * arrays are the body's own, which these passes leave alone. */
static void sbi_state_run_const(const sb_body *body, sbi_state_walk *walk, sbi_state_pass pass)
{
    sb_body view = *body;
    sbi_state_run(&view, walk, pass);
}

/* Gives up what RESERVE made and READ did not take. */
static void sbi_state_drop(const sb_body *body, sbi_state_walk *walk)
{
    sbi_body_free_pattern(body, &walk->pattern);
    sbi_free(&body->allocator, walk->fibres);
    sbi_free(&body->allocator, walk->second_fibres);
    if (walk->loads)
        sbi_state_free_loads(body, walk->loads, walk->load_count);
    sbi_elimination_free(walk->elimination);
    sbi_rigids_free(&body->allocator, walk->rigids);
}

static sbi_state_walk sbi_state_begin(void)
{
    sbi_state_walk walk;
    memset(&walk, 0, sizeof walk);
    return walk;
}

/* ---- entry points ---- */

SB_API size_t sb_body_state_size(const sb_body *body)
{
    sbi_state_walk walk = sbi_state_begin();
    if (!body)
        return 0;
    sbi_state_run_const(body, &walk, SBI_STATE_MEASURE);
    sbi_state_put_parts(body, &walk);
    walk.overflow |= !sbi_size_add(&walk.used, SBI_IMAGE_TAIL, 1);
    return walk.overflow ? 0 : walk.used;
}

SB_API sb_result sb_body_state_save(const sb_body *body, void *buffer, size_t size)
{
    sbi_state_walk walk = sbi_state_begin();
    size_t needed = sb_body_state_size(body);
    if (!body || !buffer || needed == 0 || size < needed)
        return SB_ERROR_ARGUMENT;
    walk.out = (unsigned char *)buffer;
    sbi_state_run_const(body, &walk, SBI_STATE_WRITE);
    sbi_state_put_parts(body, &walk);
    sbi_image_seal(walk.out, needed, sbi_state_magic, SBI_STATE_VERSION);
    return SB_OK;
}

SB_API uint64_t sb_body_state_hash(const sb_body *body)
{
    sbi_state_walk walk = sbi_state_begin();
    if (body) {
        sbi_state_run_const(body, &walk, SBI_STATE_HASH);
        sbi_state_put_parts(body, &walk);
    }
    return walk.hash;
}

/* Behind a snapshot stand the mesh's version, which tells without memory that the mesh is still the same, and how many
 * pushes wait: a step forgets that, but leaves them where they are. */
enum { SBI_SNAPSHOT_VERSION = 4, SBI_SNAPSHOT_TAIL = SBI_SNAPSHOT_VERSION + 4 };

SBI_API size_t sbi_body_snapshot_size(const sb_body *body)
{
    sbi_state_walk walk = sbi_state_begin();
    walk.plain = 1;
    sbi_state_run_const(body, &walk, SBI_STATE_MEASURE);
    walk.overflow |= !sbi_size_add(&walk.used, SBI_SNAPSHOT_TAIL, 1);
    return walk.overflow ? 0 : walk.used;
}

SBI_API void sbi_body_snapshot(const sb_body *body, void *buffer, sbi_snapshot_held *held)
{
    sbi_state_walk walk = sbi_state_begin();
    walk.plain = 1;
    walk.out = (unsigned char *)buffer;
    walk.has.mesh_version = sb_body_mesh_version(body);
    walk.same_mesh = held && held->mesh_version == walk.has.mesh_version;
    if (held)
        walk.had = *held;
    sbi_state_run_const(body, &walk, SBI_STATE_WRITE);
    if (held)
        *held = walk.has;
    sbi_put_bytes(walk.out + walk.used, (uint64_t)sb_body_mesh_version(body), SBI_SNAPSHOT_VERSION);
    sbi_put_bytes(walk.out + walk.used + SBI_SNAPSHOT_VERSION, (uint64_t)(body->live ? body->live->push_count : 0), 4);
}

/* Tells a recording what was loaded. */
static void sbi_state_tell(sb_body *body, const unsigned char *bytes, size_t size)
{
    sbi_command command;
    memset(&command, 0, sizeof command);
    command.code = SBI_COMMAND_STATE;
    command.bytes = bytes;
    command.byte_count = size;
    sbi_body_tell_command(body, &command);
}

/* All passes of an image over a body that has its mesh. owner: the body that others have joined, this one or the one
 * whose place it will take; they are ready to load then. */
static sb_result sbi_state_pass_image(sb_body *body, const sb_body *owner, sbi_state_walk *walk, sb_error *error)
{
    int joined = 0;
    sbi_state_run_const(body, walk, SBI_STATE_CHECK);
    if (walk->result == SB_OK && !walk->plain) {
        walk->others = walk->in + walk->used;
        walk->result = sbi_state_parts_check(owner, body, walk->others, walk->size - walk->used, error);
        joined = walk->result == SB_OK;
    }
    if (walk->result == SB_OK)
        sbi_state_run(body, walk, SBI_STATE_RESERVE);
    if (walk->result != SB_OK) {
        if (joined)
            sbi_state_parts_give_up(owner);
        sbi_state_drop(body, walk);
    } else {
        sbi_state_run(body, walk, SBI_STATE_READ);
    }
    return walk->result;
}

/* The same for a body with slack, which may have another mesh now: then the image goes to a body of that mesh, whose
 * place this one takes at the end. */
static sb_result sbi_state_pass_live(sb_body *body, sbi_state_walk *walk, sb_error *error)
{
    sbi_live_mesh mesh;
    sb_body *next = NULL;
    sbi_rigids *rigids;
    sb_result result;
    memset(&mesh, 0, sizeof mesh);
    result = sbi_state_read_mesh(body, walk, &mesh, error);
    if (result == SB_OK && sbi_state_same_mesh(body, &mesh)) {
        sbi_live_mesh_free(body, &mesh);
        return sbi_state_pass_image(body, body, walk, error);
    }
    if (result == SB_OK)
        result = sbi_live_build(body, &mesh, &next, error);
    sbi_live_mesh_free(body, &mesh);
    if (result == SB_OK)
        result = sbi_state_pass_image(next, body, walk, error);
    if (result != SB_OK) {
        sb_body_destroy(next);
        return result;
    }
    rigids = body->rigids;
    body->rigids = next->rigids;
    next->rigids = rigids;
    sbi_live_replace(body, next);
    for (int i = 0; i < body->live->listener_count; i++)
        body->live->listeners[i].calls.follow(body->live->listeners[i].calls.user, body, NULL);
    return SB_OK;
}

SB_API sb_result sb_body_state_load(sb_body *body, const void *buffer, size_t size, sb_error *error)
{
    sbi_state_walk walk = sbi_state_begin();
    uint64_t first;
    int is_live, is_of_ten;
    if (!body || (size > 0 && !buffer))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_state_load needs a body and a buffer");
    walk.in = (const unsigned char *)buffer;
    walk.error = error;
    walk.result = sbi_image_check(walk.in, size, sbi_state_magic, SBI_STATE_VERSION, "state", error);
    if (walk.result != SB_OK)
        return walk.result;
    walk.size = size - SBI_IMAGE_TAIL;
    is_of_ten = body->domain.element_type == SB_TET10;
    first = walk.size >= SBI_IMAGE_HEAD + 4 ? sbi_get_bytes(walk.in + SBI_IMAGE_HEAD, 4) : 0;
    is_live = first == SBI_STATE_LIVE || sbi_state_number_has_pieces(first);
    if (first == SBI_STATE_PIECES_BEFORE || (is_of_ten && (first == SBI_STATE_PIECES || first == SBI_STATE_GLUED)))
        return sbi_fail(
            error, SB_ERROR_UNSUPPORTED,
            "the state has pieces of elements without what they have of faces, as earlier versions saved it");
    if (!is_of_ten && (first == SBI_STATE_PIECES_10 || first == SBI_STATE_GLUED_10))
        return sbi_fail(error, SB_ERROR_STATE, "the state has pieces of tet10, which the body has not");
    if (is_live != (body->live != NULL))
        return sbi_fail(error, SB_ERROR_STATE,
                        is_live ? "the state is of a body whose mesh may change: def.slack is 0 here"
                                : "the state is of a body whose mesh does not change: def.slack "
                                  "is not 0 here");
    walk.result = is_live ? sbi_state_pass_live(body, &walk, error) : sbi_state_pass_image(body, body, &walk, error);
    if (walk.result != SB_OK)
        return walk.result;
    if (body->live)
        body->live->push_count = 0; /* what has joined brings its own */
    sbi_state_parts_load(body, walk.others);
    sbi_state_tell(body, walk.in, size);
    return SB_OK;
}

SBI_API sb_result sbi_body_rewind(sb_body *body, const void *snapshot, size_t size, sb_error *error)
{
    sbi_state_walk walk = sbi_state_begin();
    const unsigned char *tail;
    sb_result result;
    int same;
    walk.plain = 1;
    walk.in = (const unsigned char *)snapshot;
    walk.size = size - SBI_SNAPSHOT_TAIL;
    walk.error = error;
    tail = walk.in + walk.size;
    same = sbi_get_bytes(tail, SBI_SNAPSHOT_VERSION) == (uint32_t)sb_body_mesh_version(body);
    result = same ? sbi_state_pass_image(body, body, &walk, error) : sbi_state_pass_live(body, &walk, error);
    if (result == SB_OK && body->live)
        body->live->push_count = sbi_int_of(sbi_get_bytes(tail + SBI_SNAPSHOT_VERSION, 4));
    return result;
}

SB_API sb_result sb_body_state_save_file(const sb_body *body, const char *path, sb_error *error)
{
    size_t size = sb_body_state_size(body);
    unsigned char *image;
    sb_result result;
    if (!body || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_state_save_file needs a body and a path");
    image = size ? (unsigned char *)sbi_alloc(&body->allocator, size, 1) : NULL;
    if (!image)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a state of %lu bytes", (unsigned long)size);
    sb_body_state_save(body, image, size);
    result = sb_file_save(path, image, size, error);
    sbi_free(&body->allocator, image);
    return result;
}

SB_API sb_result sb_body_state_load_file(sb_body *body, const char *path, sb_error *error)
{
    unsigned char *image = NULL;
    size_t size = 0;
    sb_result result;
    if (!body || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_state_load_file needs a body and a path");
    result =
        sbi_image_read_file(&body->allocator, path, sbi_state_magic, SBI_STATE_VERSION, "state", &image, &size, error);
    if (result != SB_OK)
        return result;
    result = sb_body_state_load(body, image, size, error);
    if (result != SB_OK && error)
        sbi_error_set_file(error, path);
    sbi_free(&body->allocator, image);
    return result;
}
