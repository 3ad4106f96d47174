/* state: one walk over a body's state serves measuring, writing, hashing, checking and reading. */
#include "state.h"

#include <stdio.h>
#include <string.h>

#include "body_state.h"
#include "meshio_reader.h"

/* ---- bits ---- */

SBI_API uint64_t sbi_real_bits(sb_real value)
{
#if SB_REAL_IS_FLOAT
    uint32_t bits;
#else
    uint64_t bits;
#endif
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

SBI_API sb_real sbi_real_of(uint64_t word)
{
#if SB_REAL_IS_FLOAT
    uint32_t bits = (uint32_t)word;
#else
    uint64_t bits = word;
#endif
    sb_real value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* ---- images ---- */

static uint64_t sbi_image_checksum(const unsigned char *bytes, size_t size)
{
    uint64_t hash = size;
    for (; size >= 8; bytes += 8, size -= 8)
        hash = sbi_hash_word(hash, sbi_get_bytes(bytes, 8));
    return sbi_hash_word(hash, sbi_get_bytes(bytes, (int)size));
}

SBI_API void sbi_image_seal(unsigned char *image, size_t size, const char *magic, uint32_t version)
{
    memcpy(image, magic, 8);
    sbi_put_bytes(image + 8, version, 4);
    sbi_put_bytes(image + 12, sizeof(sb_real), 4);
    sbi_put_bytes(image + 16, size, 8);
    sbi_put_bytes(image + size - SBI_IMAGE_TAIL, sbi_image_checksum(image, size - SBI_IMAGE_TAIL), 8);
}

static sb_result sbi_image_check_head(const unsigned char *image, size_t size, const char *magic, uint32_t version,
                                      const char *what, sb_error *error)
{
    uint64_t real;
    if (size < SBI_IMAGE_HEAD + SBI_IMAGE_TAIL)
        return sbi_fail(error, SB_ERROR_FORMAT, "%lu bytes are too few for a saved %s", (unsigned long)size, what);
    if (memcmp(image, magic, 8) != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "these are not the bytes of a saved %s", what);
    if (sbi_get_bytes(image + 8, 4) != version)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved %s has version %lu, this library reads %lu", what,
                        (unsigned long)sbi_get_bytes(image + 8, 4), (unsigned long)version);
    real = sbi_get_bytes(image + 12, 4);
    if (real != sizeof(sb_real))
        return sbi_fail(error, real == 4 || real == 8 ? SB_ERROR_UNSUPPORTED : SB_ERROR_FORMAT,
                        "the saved %s has reals of %lu bytes, this library has %lu", what, (unsigned long)real,
                        (unsigned long)sizeof(sb_real));
    return SB_OK;
}

SBI_API sb_result sbi_image_check(const unsigned char *image, size_t size, const char *magic, uint32_t version,
                                  const char *what, sb_error *error)
{
    sb_result result = sbi_image_check_head(image, size, magic, version, what, error);
    if (result != SB_OK)
        return result;
    if (sbi_get_bytes(image + 16, 8) != (uint64_t)size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved %s is %s than the size it tells", what,
                        sbi_get_bytes(image + 16, 8) > (uint64_t)size ? "shorter" : "longer");
    if (sbi_get_bytes(image + size - SBI_IMAGE_TAIL, 8) != sbi_image_checksum(image, size - SBI_IMAGE_TAIL))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved %s is damaged: its checksum differs", what);
    return SB_OK;
}

static sb_result sbi_image_fail_file(sb_error *error, const char *path, const char *why)
{
    sbi_fail(error, SB_ERROR_FILE, "%s", why);
    if (error)
        sbi_error_set_file(error, path);
    return SB_ERROR_FILE;
}

SBI_API sb_result sbi_image_write_file(const char *path, const unsigned char *image, size_t size, sb_error *error)
{
    FILE *before = fopen(path, "rb"), *file;
    int existed = before != NULL, failed;
    if (before)
        fclose(before);
    file = fopen(path, "wb");
    if (!file)
        return sbi_image_fail_file(error, path, "the file cannot be opened for writing");
    failed = fwrite(image, 1, size, file) != size;
    failed |= fclose(file) != 0;
    if (!failed)
        return SB_OK;
    if (!existed) /* what was there before may be a device */
        remove(path);
    return sbi_image_fail_file(error, path, "the file cannot be written: is the disk full?");
}

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
        return sbi_image_fail_file(error, path, "the file cannot be opened");
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
    uint64_t hash;
    sb_result result;        /* the first failure; what comes after it is 0 */
    sb_error *error;
    sb_body_def settings;    /* of the image, once its settings were passed */
} sbi_state_walk;

static int sbi_state_is_image(const sbi_state_walk *walk) { return walk->pass >= SBI_STATE_CHECK; }

/* A refusal of what an image holds, in CHECK: keeps the first. */
static void sbi_state_refuse(sbi_state_walk *walk, sb_result result)
{
    if (walk->result == SB_OK)
        walk->result = result;
}

/* One number of some bytes: the body's goes in, the one that counts comes back. */
static uint64_t sbi_state_word(sbi_state_walk *walk, uint64_t value, int bytes)
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
static int sbi_state_int(sbi_state_walk *walk, int value, int low, int high, const char *name)
{
    int got = sbi_int_of(sbi_state_word(walk, (uint64_t)(uint32_t)value, 4));
    if (!sbi_state_is_image(walk))
        return value;
    if (walk->result == SB_OK && (got < low || got > high))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "the saved state has %s %d, not in %d .. %d", name,
                                        got, low, high));
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
    for (int i = 0; i < count && walk->result == SB_OK; i++) {
        sb_vec3 v = sbi_state_vector(walk, vectors[i]);
        if (walk->pass == SBI_STATE_CHECK && kind == SBI_STATE_FINITE && walk->result == SB_OK && !sb_v3_is_finite(v))
            sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_NOT_FINITE, i,
                                                 "the saved %s of node %d is not finite", name, i));
        if (walk->pass == SBI_STATE_READ)
            vectors[i] = v;
    }
}

/* ---- the parts ---- */

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
    return hash;
}

static void sbi_state_make(sb_body *body, sbi_state_walk *walk)
{
    int used = walk->pass == SBI_STATE_WRITE || walk->pass == SBI_STATE_CHECK;
    sb_preconditioner_info precond = sb_preconditioner_get_info(body->precond);
    sbi_state_same(walk, (uint64_t)body->domain.node_count, "the number of nodes");
    sbi_state_same(walk, (uint64_t)body->domain.cell_count, "the number of elements");
    sbi_state_same(walk, (uint64_t)body->domain.element_type, "the element type");
    sbi_state_same(walk, (uint64_t)body->domain.points_per_cell, "the number of integration points");
    sbi_state_same(walk, (uint64_t)body->domain.single_rotation, "single_rotation");
    sbi_state_same(walk, (uint64_t)body->material_count, "the number of regions");
    sbi_state_same(walk, (uint64_t)body->mass_kind, "the kind of mass");
    sbi_state_same(walk, (uint64_t)precond.kind, "the preconditioner");
    sbi_state_same(walk, (uint64_t)precond.piece_count, "the preconditioner's number of pieces");
    sbi_state_same(walk, used ? sbi_state_mesh_hash(body) : 0, "the mesh's hash");
}

static void sbi_state_settings(sb_body *body, sbi_state_walk *walk)
{
    sb_body_def def = sb_default_body_def();
    def.integrator = (sb_integrator)sbi_state_int(walk, (int)body->integrator, SB_EULER, SB_NEWMARK, "integrator");
    def.gravity = sbi_state_vector(walk, body->gravity);
    def.damping_mass = sbi_state_real(walk, body->damping_mass);
    def.damping_stiffness = sbi_state_real(walk, body->damping_stiffness);
    def.tolerance = sbi_state_real(walk, body->tolerance);
    def.newton_tolerance = sbi_state_real(walk, body->newton_tolerance);
    def.max_iterations = sbi_state_int(walk, body->max_iterations, 1, INT32_MAX, "max_iterations");
    def.max_newton = sbi_state_int(walk, body->max_newton, SB_AUTO, INT32_MAX, "max_newton");
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

static sb_material sbi_state_material(const sb_material *material, sbi_state_walk *walk)
{
    sb_real reals[SBI_MATERIAL_REALS];
    int model = sbi_state_int(walk, (int)material->model, SB_LINEAR, SB_REDUCED_POLYNOMIAL, "material model");
    int prony_count = sbi_state_int(walk, material->prony_count, 0, SB_MAX_PRONY_TERMS, "Prony term count");
    sbi_body_pack_material(material, reals);
    for (int i = 0; i < SBI_MATERIAL_REALS; i++)
        reals[i] = sbi_state_real(walk, reals[i]);
    return sbi_body_unpack_material(model, prony_count, reals);
}

static void sbi_state_materials(sb_body *body, sbi_state_walk *walk)
{
    int changed = 0;
    for (int i = 0; i < body->material_count && walk->result == SB_OK; i++) {
        sb_material material = sbi_state_material(body->materials + i, walk);
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

/* Supported axes, of which nodes without an element keep all; the others take blocks of the matrix. */
static void sbi_state_supports(sb_body *body, sbi_state_walk *walk)
{
    const sb_matrix *matrix = &body->matrix;
    int needed = 0;
    for (int i = 0; i < body->domain.node_count && walk->result == SB_OK; i++) {
        int lonely = body->node_component[i] < 0;
        int fixed = (int)sbi_state_word(walk, body->fixed[i], 1);
        if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK && (fixed > SB_XYZ || (lonely && fixed != SB_XYZ)))
            sbi_state_refuse(walk, sbi_fail_node(walk->error, SB_ERROR_FORMAT, i,
                                                 "node %d cannot have the saved supports %d", i, fixed));
        if (fixed && !lonely)
            needed += matrix->row_start[i + 1] - matrix->row_start[i];
        if (walk->pass == SBI_STATE_READ)
            body->fixed[i] = (unsigned char)fixed;
    }
    if (walk->pass == SBI_STATE_RESERVE && sbi_body_reserve_support_blocks(body, needed) != SB_OK)
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

/* Motion, and the internal forces that go with it; zeros stand for forces that are not current. */
static void sbi_state_motion(sb_body *body, sbi_state_walk *walk)
{
    int n = body->domain.node_count;
    int unknots = sbi_state_int(walk, body->assembly.unknots, 0, 1, "unknotting");
    int known = sbi_state_int(walk, body->acceleration_known, 0, 1, "acceleration mark");
    int current = sbi_state_int(walk, body->force_current, 0, 1, "force mark");
    sbi_state_vectors(walk, body->displacement, n, SBI_STATE_FINITE, "displacement");
    sbi_state_vectors(walk, body->velocity, n, SBI_STATE_FINITE, "velocity");
    sbi_state_vectors(walk, body->acceleration, n, SBI_STATE_FINITE, "acceleration");
    for (int i = 0; i < n && walk->result == SB_OK; i++) {
        sb_vec3 force = sbi_state_vector(walk, current ? body->internal[i] : sb_v3(0, 0, 0));
        if (walk->pass == SBI_STATE_READ)
            body->internal[i] = force;
    }
    if (walk->pass != SBI_STATE_READ)
        return;
    body->assembly.unknots = unknots;
    body->acceleration_known = known;
    body->force_current = current;
    sbi_body_update_positions(body);
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
static sb_real *sbi_state_batch_quat(const sbi_assembly *assembly, int cell)
{
    return assembly->batch_quats + (size_t)(cell / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + cell % SB_POLAR_LANES;
}

/* Warm starts. Both kinds where there are both: a change of material makes the body go over to the other one. What
 * the batched loops keep beside them (assembly.rotated) is made anew by each step before it is read. */
static void sbi_state_rotations(sb_body *body, sbi_state_walk *walk)
{
    const sbi_assembly *assembly = &body->assembly;
    int cells = body->domain.cell_count, points = body->domain.points_per_cell;
    for (int e = 0; e < cells && walk->result == SB_OK; e++)
        for (int p = 0; p < points; p++) {
            sb_quat *at = assembly->rotations + (size_t)e * (size_t)points + (size_t)p;
            sb_quat q = sbi_state_rotation(walk, *at, e);
            if (walk->pass == SBI_STATE_READ)
                *at = q;
        }
    for (int e = 0; assembly->batch_quats && e < cells && walk->result == SB_OK; e++) {
        sb_real *at = sbi_state_batch_quat(assembly, e);
        sb_quat q = sbi_state_rotation(
            walk, sb_quat_make(at[0], at[SB_POLAR_LANES], at[2 * SB_POLAR_LANES], at[3 * SB_POLAR_LANES]), e);
        if (walk->pass != SBI_STATE_READ)
            continue;
        at[0] = q.w;
        at[SB_POLAR_LANES] = q.x;
        at[2 * SB_POLAR_LANES] = q.y;
        at[3 * SB_POLAR_LANES] = q.z;
    }
}

static void sbi_state_precond(sb_body *body, sbi_state_walk *walk)
{
    sbi_precond_memory memory = sbi_precond_get_memory(body->precond);
    uint64_t bits;
    memcpy(&bits, &memory.shift, sizeof bits);
    bits = sbi_state_word(walk, bits, 8);
    memcpy(&memory.shift, &bits, sizeof bits);
    memory.successes = sbi_state_int(walk, memory.successes, 0, INT32_MAX, "preconditioner successes");
    memory.wait = sbi_state_int(walk, memory.wait, 0, INT32_MAX, "preconditioner wait");
    if (walk->pass == SBI_STATE_CHECK && walk->result == SB_OK && !sbi_precond_is_memory(memory))
        sbi_state_refuse(walk, sbi_fail(walk->error, SB_ERROR_FORMAT, "the saved preconditioner's shift %g or wait %d "
                                                                      "is out of range", memory.shift, memory.wait));
    if (walk->pass == SBI_STATE_READ)
        sbi_precond_set_memory(body->precond, memory);
}

/* A room that gives bodies something to remember adds its part here: a function and a number of its own. The order is
 * that of the image; materials come before what depends on them. */
typedef struct sbi_state_part {
    int number;
    void (*walk)(sb_body *body, sbi_state_walk *walk);
} sbi_state_part;

static const sbi_state_part sbi_state_parts[] = {
    {1, sbi_state_make},  {2, sbi_state_settings},  {3, sbi_state_materials}, {4, sbi_state_supports},
    {5, sbi_state_loads}, {6, sbi_state_rotations}, {7, sbi_state_motion},    {8, sbi_state_precond},
};
enum { SBI_STATE_PARTS = sizeof sbi_state_parts / sizeof sbi_state_parts[0], SBI_STATE_VERSION = 1 };

static const char sbi_state_magic[9] = "SBSTATE\x1A";

static void sbi_state_run(sb_body *body, sbi_state_walk *walk, sbi_state_pass pass)
{
    walk->pass = pass;
    walk->used = pass == SBI_STATE_HASH ? 0 : SBI_IMAGE_HEAD;
    for (int i = 0; i < SBI_STATE_PARTS && walk->result == SB_OK; i++) {
        const sbi_state_part *part = sbi_state_parts + i;
        sbi_state_int(walk, part->number, part->number, part->number, "part");
        if (walk->result == SB_OK)
            part->walk(body, walk);
    }
}

/* A walk that only reads the body. Parts take bodies that they may change, so they get a copy of the struct; its
 * arrays are the body's own, which these passes leave alone. */
static void sbi_state_run_const(const sb_body *body, sbi_state_walk *walk, sbi_state_pass pass)
{
    sb_body view = *body;
    sbi_state_run(&view, walk, pass);
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
    sbi_image_seal(walk.out, needed, sbi_state_magic, SBI_STATE_VERSION);
    return SB_OK;
}

SB_API uint64_t sb_body_state_hash(const sb_body *body)
{
    sbi_state_walk walk = sbi_state_begin();
    if (body)
        sbi_state_run_const(body, &walk, SBI_STATE_HASH);
    return walk.hash;
}

/* Tells a recording what was loaded. */
static void sbi_state_tell(sb_body *body, const unsigned char *bytes, size_t size)
{
    sbi_command command;
    if (!body->observe)
        return;
    memset(&command, 0, sizeof command);
    command.code = SBI_COMMAND_STATE;
    command.bytes = bytes;
    command.byte_count = size;
    body->observe(body->observer, &command);
}

SB_API sb_result sb_body_state_load(sb_body *body, const void *buffer, size_t size, sb_error *error)
{
    sbi_state_walk walk = sbi_state_begin();
    if (!body || (size > 0 && !buffer))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_state_load needs a body and a buffer");
    walk.in = (const unsigned char *)buffer;
    walk.error = error;
    walk.result = sbi_image_check(walk.in, size, sbi_state_magic, SBI_STATE_VERSION, "state", error);
    if (walk.result != SB_OK)
        return walk.result;
    walk.size = size - SBI_IMAGE_TAIL;
    sbi_state_run_const(body, &walk, SBI_STATE_CHECK);
    if (walk.result == SB_OK && walk.used != walk.size)
        walk.result = sbi_fail(error, SB_ERROR_FORMAT, "the saved state holds %lu bytes too many",
                               (unsigned long)(walk.size - walk.used));
    if (walk.result == SB_OK)
        sbi_state_run(body, &walk, SBI_STATE_RESERVE);
    if (walk.result != SB_OK)
        return walk.result;
    sbi_state_run(body, &walk, SBI_STATE_READ);
    sbi_state_tell(body, walk.in, size);
    return SB_OK;
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
    result = sbi_image_write_file(path, image, size, error);
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
    result = sbi_image_read_file(&body->allocator, path, sbi_state_magic, SBI_STATE_VERSION, "state", &image, &size,
                                 error);
    if (result != SB_OK)
        return result;
    result = sb_body_state_load(body, image, size, error);
    if (result != SB_OK && error)
        sbi_error_set_file(error, path);
    sbi_free(&body->allocator, image);
    return result;
}
