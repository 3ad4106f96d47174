/* record: recordings of calls, and their replay.
 *
 * A recording is one image, in memory as in the file:
 *     head | positions_every, incomplete, commands, steps, nodes (4 bytes each), 4 unused, bytes of the state (8)
 *          | state | commands | checksum
 * and a command is
 *     code, a, b, int count (4 bytes each), real count, byte count (8 each) | ints | reals | bytes
 * Bytes of a step or static solve: hash of the state, hashes of the displacements of 16 ranges of nodes, and maybe the
 * displacements: of as many nodes as the body has then. */
#include "record.h"

#include <string.h>

#include "body_private.h"
#include "cable.h"
#include "cavity.h"
#include "membrane.h"
#include "constraint.h"
#include "live_private.h"
#include "load.h"
#include "record_private.h"
#include "rigid.h"
#include "state_part.h"
#include "../base/output.h"

enum {
    SBI_RECORD_VERSION = 3,
    SBI_RECORD_HEAD = SBI_IMAGE_HEAD + 32,
    SBI_RECORD_COMMAND = 32,
    SBI_RECORD_RANGES = 16,
    SBI_RECORD_OUTCOME = 8 * (1 + SBI_RECORD_RANGES)
};

static const char sbi_record_magic[9] = "SBRECORD";

struct sb_recording {
    sb_allocator allocator;
    sb_body *body; /* that is listened to, or NULL */
    int positions_every, incomplete, commands, steps, node_count;
    size_t state_size;
    unsigned char *data; /* the image without its checksum; numbers of the head are put in when it is saved */
    size_t size, capacity;
};

/* ---- writing ---- */

/* Room for so many bytes more; 0 when memory is short. */
static int sbi_record_reserve(sb_recording *recording, size_t bytes)
{
    size_t needed = recording->size, capacity;
    unsigned char *grown;
    if (!sbi_size_add(&needed, bytes, 1))
        return 0;
    if (needed <= recording->capacity)
        return 1;
    capacity = needed;
    if (!sbi_size_add(&capacity, needed / 2, 1))
        return 0;
    grown = (unsigned char *)sbi_alloc(&recording->allocator, capacity, 1);
    if (!grown)
        return 0;
    if (recording->size)
        memcpy(grown, recording->data, recording->size);
    sbi_free(&recording->allocator, recording->data);
    recording->data = grown;
    recording->capacity = capacity;
    return 1;
}

static void sbi_record_put(sb_recording *recording, uint64_t value, int bytes)
{
    sbi_put_bytes(recording->data + recording->size, value, bytes);
    recording->size += (size_t)bytes;
}

static void sbi_record_put_real(sb_recording *recording, sb_real value)
{
    sbi_record_put(recording, sbi_real_bits(value), (int)sizeof value);
}

static void sbi_record_put_ints(sb_recording *recording, const int *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        sbi_record_put(recording, (uint64_t)(uint32_t)values[i], 4);
}

static void sbi_record_put_reals(sb_recording *recording, const sb_real *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        sbi_record_put_real(recording, values[i]);
}

/* First node of a range; that of range 16 is the node count. */
static int sbi_record_range_start(int node_count, int range)
{
    int length = node_count / SBI_RECORD_RANGES + (node_count % SBI_RECORD_RANGES != 0);
    return range >= node_count / length + (node_count % length != 0) ? node_count : range * length;
}

static uint64_t sbi_record_range_hash(const sb_vec3 *displacement, int node_count, int range)
{
    int end = sbi_record_range_start(node_count, range + 1);
    uint64_t hash = 1;
    for (int i = sbi_record_range_start(node_count, range); i < end; i++) {
        hash = sbi_hash_word(hash, sbi_real_bits(displacement[i].x));
        hash = sbi_hash_word(hash, sbi_real_bits(displacement[i].y));
        hash = sbi_hash_word(hash, sbi_real_bits(displacement[i].z));
    }
    return hash;
}

static int sbi_record_is_solve(sbi_command_code code)
{
    return code == SBI_COMMAND_STEP || code == SBI_COMMAND_STATIC || code == SBI_COMMAND_PART_STEP;
}

/* Where a solve led; sized by sbi_record_outcome_size. */
static void sbi_record_put_outcome(sb_recording *recording, size_t size)
{
    const sb_body *body = recording->body;
    sbi_record_put(recording, sb_body_state_hash(body), 8);
    for (int k = 0; k < SBI_RECORD_RANGES; k++)
        sbi_record_put(recording, sbi_record_range_hash(body->displacement, body->domain.node_count, k), 8);
    for (int i = 0; size > SBI_RECORD_OUTCOME && i < body->domain.node_count; i++) {
        sbi_record_put_real(recording, body->displacement[i].x);
        sbi_record_put_real(recording, body->displacement[i].y);
        sbi_record_put_real(recording, body->displacement[i].z);
    }
}

static size_t sbi_record_outcome_size(const sb_recording *recording)
{
    int full = recording->positions_every > 0 && recording->steps % recording->positions_every == 0;
    return SBI_RECORD_OUTCOME + (full ? (size_t)recording->body->domain.node_count * sizeof(sb_vec3) : 0);
}

static int sbi_record_append(sb_recording *recording, const sbi_command *command)
{
    int solve = sbi_record_is_solve(command->code);
    size_t bytes = solve ? sbi_record_outcome_size(recording) : command->byte_count, total = SBI_RECORD_COMMAND;
    size_t ints = command->int_count, reals = command->real_count; /* all of them are in memory: no overflow */
    ints += command->more_int_count;
    reals += command->more_real_counts[0] + command->more_real_counts[1];
    if (recording->commands == INT32_MAX || ints > INT32_MAX || !sbi_size_add(&total, ints, 4) ||
        !sbi_size_add(&total, reals, sizeof(sb_real)) || !sbi_size_add(&total, bytes, 1) ||
        !sbi_record_reserve(recording, total))
        return 0;
    sbi_record_put(recording, (uint64_t)command->code, 4);
    sbi_record_put(recording, (uint64_t)(uint32_t)command->a, 4);
    sbi_record_put(recording, (uint64_t)(uint32_t)command->b, 4);
    sbi_record_put(recording, (uint64_t)ints, 4);
    sbi_record_put(recording, (uint64_t)reals, 8);
    sbi_record_put(recording, (uint64_t)bytes, 8);
    sbi_record_put_ints(recording, command->ints, command->int_count);
    sbi_record_put_ints(recording, command->more_ints, command->more_int_count);
    sbi_record_put_reals(recording, command->reals, command->real_count);
    for (int k = 0; k < 2; k++)
        sbi_record_put_reals(recording, command->more_reals[k], command->more_real_counts[k]);
    if (solve) {
        sbi_record_put_outcome(recording, bytes);
        recording->steps++;
    } else if (bytes) {
        memcpy(recording->data + recording->size, command->bytes, bytes);
        recording->size += bytes;
    }
    recording->commands++;
    return 1;
}

static void sbi_record_observe(void *observer, const sbi_command *command)
{
    sb_recording *recording = (sb_recording *)observer;
    if (command->code == SBI_COMMAND_DESTROY)
        recording->body = NULL;
    else if (!recording->incomplete)
        recording->incomplete = !sbi_record_append(recording, command);
}

/* ---- the object ---- */

static sb_recording *sbi_record_make(const sb_allocator *allocator, sb_error *error)
{
    sb_recording *recording = (sb_recording *)sbi_alloc_zeroed(allocator, 1, sizeof *recording);
    if (!recording)
        sbi_fail(error, SB_ERROR_MEMORY, "no memory for a recording");
    else if (allocator)
        recording->allocator = *allocator;
    return recording;
}

SB_API sb_result sb_recording_start(sb_body *body, int positions_every, const sb_allocator *allocator,
                                    sb_recording **recording, sb_error *error)
{
    sb_recording *made;
    size_t size = sb_body_state_size(body), total = SBI_RECORD_HEAD;
    if (!body || !recording || positions_every < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "sb_recording_start needs a body, a place for the recording and positions_every >= 0");
    if (body->observe)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body is being recorded already");
    made = sbi_record_make(allocator, error);
    if (!made)
        return SB_ERROR_MEMORY;
    made->positions_every = positions_every;
    made->node_count = body->domain.node_count;
    made->state_size = size;
    if (size == 0 || !sbi_size_add(&total, size, 1) || !sbi_record_reserve(made, total)) {
        sb_recording_destroy(made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to record a state of %lu bytes", (unsigned long)size);
    }
    memset(made->data, 0, SBI_RECORD_HEAD);
    sb_body_state_save(body, made->data + SBI_RECORD_HEAD, size);
    made->size = total;
    made->body = body;
    body->observe = sbi_record_observe;
    body->observer = made;
    *recording = made;
    return SB_OK;
}

SB_API void sb_recording_stop(sb_recording *recording)
{
    if (!recording || !recording->body)
        return;
    recording->body->observe = NULL;
    recording->body->observer = NULL;
    recording->body = NULL;
}

SB_API void sb_recording_destroy(sb_recording *recording)
{
    sb_allocator allocator;
    if (!recording)
        return;
    sb_recording_stop(recording);
    allocator = recording->allocator;
    sbi_free(&allocator, recording->data);
    sbi_free(&allocator, recording);
}

SB_API sb_recording_info sb_recording_get_info(const sb_recording *recording)
{
    sb_recording_info none;
    sb_recording_info info;
    if (!recording) {
        memset(&none, 0, sizeof none);
        return none;
    }
    info.commands = recording->commands;
    info.steps = recording->steps;
    info.complete = !recording->incomplete;
    info.recording = recording->body != NULL;
    info.bytes = recording->size + SBI_IMAGE_TAIL;
    return info;
}

/* ---- saving ---- */

SB_API sb_result sb_recording_save(const sb_recording *recording, void *buffer, size_t size)
{
    unsigned char *out = (unsigned char *)buffer, *at = out + SBI_IMAGE_HEAD;
    if (!recording || !buffer || size < recording->size + SBI_IMAGE_TAIL)
        return SB_ERROR_ARGUMENT;
    memcpy(out, recording->data, recording->size);
    sbi_put_bytes(at, (uint64_t)recording->positions_every, 4);
    sbi_put_bytes(at + 4, (uint64_t)recording->incomplete, 4);
    sbi_put_bytes(at + 8, (uint64_t)recording->commands, 4);
    sbi_put_bytes(at + 12, (uint64_t)recording->steps, 4);
    sbi_put_bytes(at + 16, (uint64_t)recording->node_count, 4);
    sbi_put_bytes(at + 24, (uint64_t)recording->state_size, 8);
    sbi_image_seal(out, recording->size + SBI_IMAGE_TAIL, sbi_record_magic, SBI_RECORD_VERSION);
    return SB_OK;
}

SB_API sb_result sb_recording_save_file(const sb_recording *recording, const char *path, sb_error *error)
{
    unsigned char *image;
    size_t size;
    sb_result result;
    if (!recording || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_recording_save_file needs a recording and a path");
    size = recording->size + SBI_IMAGE_TAIL;
    image = (unsigned char *)sbi_alloc(&recording->allocator, size, 1);
    if (!image)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a recording of %lu bytes", (unsigned long)size);
    sb_recording_save(recording, image, size);
    result = sb_file_save(path, image, size, error);
    sbi_free(&recording->allocator, image);
    return result;
}

/* ---- the commands ---- */

/* How many reals a command has. */
enum { SBI_REALS_PER_INT = -1, SBI_REALS_PER_NODE = -2, SBI_REALS_ANY = -3, SBI_INTS_ANY = -1 };

/* What a command must look like, and what plays it. A room with mutators of its own adds rows here. */
typedef struct sbi_record_rule {
    sbi_command_code code;
    const char *name;
    int ints;  /* count, or SBI_INTS_ANY */
    int reals; /* count; SBI_REALS_PER_INT: a vector for each int, or one for all when b is 1; SBI_REALS_PER_NODE: of
                * the body when it is played; with ..._ANY the player looks */
    sb_result (*play)(sb_body *body, const sbi_command *command, sb_error *error);
} sbi_record_rule;

static sb_vec3 sbi_record_vector(const sbi_command *c) { return sb_v3(c->reals[0], c->reals[1], c->reals[2]); }

/* The vectors of a command. Reals were decoded into an array of them. */
static const sb_vec3 *sbi_record_vectors(const sbi_command *c) { return (const sb_vec3 *)(const void *)c->reals; }

static sb_result sbi_record_refuse_counts(const sbi_command *c, sb_error *error)
{
    return sbi_fail(error, SB_ERROR_FORMAT, "%lu whole and %lu real numbers are not what it takes",
                    (unsigned long)c->int_count, (unsigned long)c->real_count);
}

static sb_result sbi_play_material(sb_body *body, const sbi_command *c, sb_error *error)
{
    sb_material material;
    if (c->real_count != SBI_MATERIAL_REALS && c->real_count != (int)SBI_MATERIAL_REALS + (int)SBI_MATERIAL_PRESTRETCH)
        return sbi_record_refuse_counts(c, error);
    if (c->ints[1] < SB_LINEAR || c->ints[1] > SBI_LAST_MODEL || c->ints[2] < 0 || c->ints[2] > SB_MAX_PRONY_TERMS)
        return sbi_fail(error, SB_ERROR_FORMAT, "material model %d or Prony term count %d is out of range", c->ints[1],
                        c->ints[2]);
    material = sbi_body_unpack_material(body, c->ints[1], c->ints[2], c->reals);
    if (c->real_count > SBI_MATERIAL_REALS)
        memcpy(material.prestretch.m, c->reals + SBI_MATERIAL_REALS, sizeof material.prestretch.m);
    if (c->a == SBI_MATERIAL_TENSION)
        return sb_body_set_tension(body, c->ints[0], material.fibre_tension, error);
    return c->a ? sb_body_set_material(body, &material, error)
                : sb_body_set_region_material(body, c->ints[0], &material, error);
}

static sb_result sbi_play_gravity(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_gravity(body, sbi_record_vector(c));
}

static sb_result sbi_play_damping(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_damping(body, c->reals[0], c->reals[1]);
}

static sb_result sbi_play_solver(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_solver(body, c->reals[0], c->a);
}

static sb_result sbi_play_fix(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_fix_nodes(body, c->ints, (int)c->int_count, c->a);
}

static sb_result sbi_play_prescribe(sb_body *body, const sbi_command *c, sb_error *error)
{
    if (c->b & SBI_PRESCRIBE_POSITIONS)
        return sb_body_place(body, c->ints, (int)c->int_count, c->a, sbi_record_vectors(c), error);
    return sb_body_prescribe(body, c->ints, (int)c->int_count, c->a, sbi_record_vectors(c), c->b);
}

static sb_result sbi_play_release(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_release_nodes(body, c->ints, (int)c->int_count, c->a);
}

static sb_result sbi_play_forces(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_add_forces(body, c->ints, (int)c->int_count, sbi_record_vectors(c), c->b);
}

static sb_result sbi_play_traction(sb_body *body, const sbi_command *c, sb_error *error)
{
    if (c->a < 1 || c->int_count % (size_t)c->a != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "%lu nodes are no faces of %d corners", (unsigned long)c->int_count,
                        c->a);
    return sb_body_add_traction(body, c->ints, (int)(c->int_count / (size_t)c->a), c->a, sbi_record_vector(c), error);
}

static sb_result sbi_play_clear_loads(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)c;
    (void)error;
    sb_body_clear_loads(body);
    return SB_OK;
}

static sb_result sbi_play_displacements(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_displacements(body, sbi_record_vectors(c));
}

static sb_result sbi_play_velocities(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_velocities(body, sbi_record_vectors(c));
}

static sb_result sbi_play_reset(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)c;
    (void)error;
    sb_body_reset(body);
    return SB_OK;
}

static sb_result sbi_play_state(sb_body *body, const sbi_command *c, sb_error *error)
{
    return sb_body_state_load(body, c->bytes, c->byte_count, error);
}

static sb_result sbi_play_step(sb_body *body, const sbi_command *c, sb_error *error)
{
    sb_step_info info;
    sb_result result = sb_body_step(body, c->reals[0], &info);
    *error = info.error;
    return result;
}

static sb_result sbi_play_static(sb_body *body, const sbi_command *c, sb_error *error)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_result result;
    options.load_steps = c->ints[0];
    options.max_newton = c->ints[1];
    options.max_iterations = c->ints[2];
    options.keep_progress = c->ints[3];
    options.instantaneous = c->ints[4] & 1;
    options.quasi_newton = c->ints[4] >> 1 & 1;
    options.forces_only = c->ints[4] >> 2 & 1;
    options.newton = (sb_newton)(c->ints[4] >> 3 & 3);
    options.start = (c->ints[4] >> 5 & 3) == 0   ? SB_START_PRESENT
                    : (c->ints[4] >> 5 & 3) == 1 ? SB_START_AUTO
                                                 : SB_START_ROTATIONS;
    options.tolerance = c->reals[0];
    result = sb_body_solve_static(body, &options, &info);
    *error = info.error;
    return result;
}

/* ---- loads that follow, and constraints: counts that the rules do not know are checked here ---- */

static sb_result sbi_play_region_damping(sb_body *body, const sbi_command *c, sb_error *error)
{
    return sb_body_set_region_damping(body, c->a, c->reals[0], c->reals[1], error);
}

static sb_result sbi_play_keep_tangent(sb_body *body, const sbi_command *c, sb_error *error)
{
    return sb_body_keep_tangent(body, c->reals[0], error);
}

static sb_result sbi_play_fibres(sb_body *body, const sbi_command *c, sb_error *error)
{
    if (c->real_count != (c->a ? 3 * (size_t)body->domain.cell_count : 0))
        return sbi_record_refuse_counts(c, error);
    if (c->b == 2)
        return sb_body_set_second_fibres(body, c->a ? sbi_record_vectors(c) : NULL, error);
    return sb_body_set_fibres(body, c->a ? sbi_record_vectors(c) : NULL, error);
}

static sb_result sbi_play_add_pressure(sb_body *body, const sbi_command *c, sb_error *error)
{
    int id;
    if (c->a < 1 || c->int_count % (size_t)c->a != 0)
        return sbi_record_refuse_counts(c, error);
    return sb_body_add_pressure(body, c->ints, (int)(c->int_count / (size_t)c->a), c->a, c->reals[0], &id, error);
}

static sb_result sbi_play_pressure(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_pressure(body, c->a, c->reals[0]);
}

static sb_result sbi_play_add_springs(sb_body *body, const sbi_command *c, sb_error *error)
{
    size_t points = 3 * c->int_count;
    int id;
    if (c->real_count != points + (c->b ? 1 : c->int_count))
        return sbi_record_refuse_counts(c, error);
    return sb_body_add_springs(body, c->ints, (int)c->int_count, c->reals + points, c->b, sbi_record_vectors(c), &id,
                               error);
}

static sb_result sbi_play_add_mapping(sb_body *body, const sbi_command *c, sb_error *error)
{
    size_t rows = c->a > 0 ? (size_t)c->a : 0, points = 3 * rows, stiffness = c->b ? 1 : rows;
    sb_mapping mapping;
    int id;
    if (rows < 1 || rows >= c->int_count || c->ints[rows] < 0 || (size_t)c->ints[rows] != c->int_count - rows - 1 ||
        c->real_count != points + stiffness + (size_t)c->ints[rows])
        return sbi_record_refuse_counts(c, error);
    mapping.row_count = c->a;
    mapping.row_start = c->ints;
    mapping.nodes = c->ints + rows + 1;
    mapping.weights = c->reals + points + stiffness;
    return sb_body_add_mapping(body, &mapping, c->reals + points, c->b, sbi_record_vectors(c), &id, error);
}

static sb_result sbi_play_pose(sb_body *body, const sbi_command *c, sb_error *error)
{
    const sb_vec3 *v = sbi_record_vectors(c);
    const sb_real *q = c->reals + 6;
    return sb_body_place_rigid(body, c->ints, (int)c->int_count, v[0], v[1], sb_quat_make(q[0], q[1], q[2], q[3]),
                               error);
}

static sb_result sbi_play_add_cable(sb_body *body, const sbi_command *c, sb_error *error)
{
    size_t rows = c->a > 1 ? (size_t)c->a : 0;
    sb_cable_def def = sb_default_cable_def();
    sb_mapping mapping;
    if (rows < 2 || rows >= c->int_count || c->ints[rows] < 0 || (size_t)c->ints[rows] != c->int_count - rows - 1 ||
        c->real_count != 3 * rows + 3 + (size_t)c->ints[rows])
        return sbi_record_refuse_counts(c, error);
    mapping.row_count = def.count = c->a;
    mapping.row_start = c->ints;
    mapping.nodes = c->ints + rows + 1;
    mapping.weights = c->reals + 3 * rows + 3;
    def.rows = &mapping;
    def.places = sbi_record_vectors(c);
    def.rest_length = c->reals[3 * rows];
    def.stiffness = c->reals[3 * rows + 1];
    def.toe_strain = c->reals[3 * rows + 2];
    def.pushes = c->b;
    return sb_body_add_cable(body, &def, NULL, error);
}

static sb_result sbi_play_cable(sb_body *body, const sbi_command *c, sb_error *error)
{
    sb_result result = sb_body_set_cable_rest_length(body, c->a, c->reals[0]);
    (void)error;
    return result == SB_OK ? sb_body_set_cable_stiffness(body, c->a, c->reals[1]) : result;
}

static sb_result sbi_play_add_membrane(sb_body *body, const sbi_command *c, sb_error *error)
{
    sb_membrane_def def = sb_default_membrane_def();
    if (c->a < 3 || c->int_count % (size_t)c->a != 0)
        return sbi_record_refuse_counts(c, error);
    def.faces = c->ints;
    def.corners = c->a;
    def.face_count = (int)(c->int_count / (size_t)c->a);
    def.thickness = c->reals[0];
    def.shear = c->reals[1];
    def.prestretch = c->reals[2];
    def.wrinkles = c->b;
    return sb_body_add_membrane(body, &def, NULL, error);
}

static sb_result sbi_play_add_cavity(sb_body *body, const sbi_command *c, sb_error *error)
{
    enum { HEAD = 4 };
    sb_cavity_def def = sb_default_cavity_def();
    size_t points = c->real_count < HEAD ? SB_MAX_CAVITY_POINTS + 1 : (c->real_count - HEAD) / 2;
    if (c->a < 3 || c->int_count % (size_t)c->a != 0 || points > SB_MAX_CAVITY_POINTS ||
        c->real_count != HEAD + 2 * points)
        return sbi_record_refuse_counts(c, error);
    def.faces = c->ints;
    def.corners = c->a;
    def.face_count = (int)(c->int_count / (size_t)c->a);
    def.kind = (sb_cavity_kind)c->b;
    def.pressure = c->reals[0];
    def.ambient = c->reals[1];
    def.exponent = c->reals[2];
    def.bulk = c->reals[3];
    def.point_count = (int)points;
    for (size_t k = 0; k < points; k++) {
        def.table_volume[k] = c->reals[HEAD + k];
        def.table_pressure[k] = c->reals[HEAD + points + k];
    }
    return sb_body_add_cavity(body, &def, NULL, error);
}

static sb_result sbi_play_cavity(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sbi_cavity_set(body, c->a, c->reals[0], c->reals[1]);
}

static sb_result sbi_play_membrane(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_membrane(body, c->a, c->reals[0], c->reals[1], c->reals[2]);
}

/* Rows of a load; 0 when there is none. */
static size_t sbi_record_load_rows(const sb_body *body, int id)
{
    for (int i = 0; i < body->load_count; i++)
        if (body->loads[i].id == id)
            return (size_t)body->loads[i].row_count;
    return 0;
}

static sb_result sbi_play_points(sb_body *body, const sbi_command *c, sb_error *error)
{
    size_t rows = sbi_record_load_rows(body, c->a);
    if (rows > 0 && c->real_count != 3 * rows)
        return sbi_record_refuse_counts(c, error);
    if (c->b == SBI_LOAD_CABLE)
        return sb_body_move_cable(body, c->a, sbi_record_vectors(c));
    return c->b == SBI_LOAD_SPRINGS ? sb_body_move_springs(body, c->a, sbi_record_vectors(c))
                                    : sb_body_set_mapping_targets(body, c->a, sbi_record_vectors(c));
}

static sb_result sbi_play_stiffness(sb_body *body, const sbi_command *c, sb_error *error)
{
    size_t rows = sbi_record_load_rows(body, c->a);
    if (rows > 0 && c->real_count != (c->b ? 1 : rows))
        return sbi_record_refuse_counts(c, error);
    return c->ints[0] == SBI_LOAD_SPRINGS ? sb_body_set_spring_stiffness(body, c->a, c->reals, c->b)
                                          : sb_body_set_mapping_stiffness(body, c->a, c->reals, c->b);
}

static sb_result sbi_play_lines(sb_body *body, const sbi_command *c, sb_error *error)
{
    if (c->real_count != 0 && c->real_count != 3 * sbi_record_load_rows(body, c->a))
        return sbi_record_refuse_counts(c, error);
    return sbi_body_set_mapping_lines(body, c->a, c->real_count ? sbi_record_vectors(c) : NULL);
}

static sb_result sbi_play_place(sb_body *body, const sbi_command *c, sb_error *error)
{
    return sbi_body_replay_place(body, c->ints, sbi_record_vectors(c), error);
}

static sb_result sbi_play_part(sb_body *body, const sbi_command *c, sb_error *error)
{
    return sbi_state_parts_replay(body, c->ints, c->int_count, c->reals, c->real_count, error);
}

static sb_result sbi_play_add_rigid(sb_body *body, const sbi_command *c, sb_error *error)
{
    const sb_real *reals = c->reals;
    sb_rigid_def def = sb_default_rigid_def();
    def.nodes = c->ints;
    def.node_count = (int)c->int_count;
    def.mass = reals[0];
    memcpy(def.inertia.m, reals + 1, 9 * sizeof *reals);
    def.centre = sb_v3(reals[10], reals[11], reals[12]);
    def.turn = sb_quat_make(reals[13], reals[14], reals[15], reals[16]);
    def.velocity = sb_v3(reals[17], reals[18], reals[19]);
    def.spin = sb_v3(reals[20], reals[21], reals[22]);
    return sb_body_add_rigid(body, &def, NULL, error);
}

static sb_result sbi_play_rigid_load(sb_body *body, const sbi_command *c, sb_error *error)
{
    const sb_vec3 *v = sbi_record_vectors(c);
    (void)error;
    return sb_body_set_rigid_load(body, c->a, v[0], v[1]);
}

static sb_result sbi_play_remove_rigid(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_remove_rigid(body, c->a);
}

static sb_result sbi_play_remove_load(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_remove_load(body, c->a);
}

/* The equations as their adder takes them: counts[count] and terms. 0 when the starts run backwards. */
static int sbi_record_list_terms(const sbi_command *c, int *counts, sb_constraint_term *terms)
{
    int count = c->a;
    size_t all = c->int_count - (size_t)count - 1;
    for (int k = 0; k < count; k++) {
        if (c->ints[k + 1] <= c->ints[k] || c->ints[k] < 0)
            return 0;
        counts[k] = c->ints[k + 1] - c->ints[k];
    }
    if ((size_t)(c->ints[count] - c->ints[0]) != all)
        return 0;
    for (size_t k = 0; k < all; k++) {
        int dof = c->ints[(size_t)count + 1 + k];
        terms[k].node = dof < 0 ? -1 : dof / 3;
        terms[k].axis = dof < 0 ? 0 : dof % 3;
        terms[k].coefficient = c->reals[(size_t)count + k];
    }
    return 1;
}

static sb_result sbi_play_add_constraints(sb_body *body, const sbi_command *c, sb_error *error)
{
    size_t count = c->a > 0 ? (size_t)c->a : 0, all;
    sb_constraint_term *terms;
    int *counts;
    sb_result result;
    if (count < 1 || count >= c->int_count || c->real_count != c->int_count - 1)
        return sbi_record_refuse_counts(c, error);
    all = c->int_count - count - 1;
    terms = (sb_constraint_term *)sbi_alloc(&body->allocator, all + 1, sizeof *terms);
    counts = (int *)sbi_alloc(&body->allocator, count, sizeof *counts);
    if (!terms || !counts)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %lu constraints", (unsigned long)count);
    else if (!sbi_record_list_terms(c, counts, terms))
        result = sbi_record_refuse_counts(c, error);
    else
        result = sb_body_add_constraints(body, terms, counts, c->reals, c->a, NULL, error);
    sbi_free(&body->allocator, terms);
    sbi_free(&body->allocator, counts);
    return result;
}

static sb_result sbi_play_constraint_value(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)error;
    return sb_body_set_constraint_value(body, c->a, c->reals[0]);
}

static sb_result sbi_play_remove_constraints(sb_body *body, const sbi_command *c, sb_error *error)
{
    return sb_body_remove_constraints(body, c->a, c->b, error);
}

static sb_result sbi_play_clear_constraints(sb_body *body, const sbi_command *c, sb_error *error)
{
    (void)c;
    (void)error;
    sb_body_clear_constraints(body);
    return SB_OK;
}

/* ---- the table ---- */

static const sbi_record_rule sbi_record_rules[] = {
    {SBI_COMMAND_MATERIAL, "material", 3, SBI_REALS_ANY, sbi_play_material},
    {SBI_COMMAND_GRAVITY, "gravity", 0, 3, sbi_play_gravity},
    {SBI_COMMAND_DAMPING, "damping", 0, 2, sbi_play_damping},
    {SBI_COMMAND_SOLVER, "solver", 0, 1, sbi_play_solver},
    {SBI_COMMAND_FIX, "fix", SBI_INTS_ANY, 0, sbi_play_fix},
    {SBI_COMMAND_PRESCRIBE, "prescribe", SBI_INTS_ANY, SBI_REALS_PER_INT, sbi_play_prescribe},
    {SBI_COMMAND_RELEASE, "release", SBI_INTS_ANY, 0, sbi_play_release},
    {SBI_COMMAND_FORCES, "forces", SBI_INTS_ANY, SBI_REALS_PER_INT, sbi_play_forces},
    {SBI_COMMAND_TRACTION, "traction", SBI_INTS_ANY, 3, sbi_play_traction},
    {SBI_COMMAND_CLEAR_LOADS, "clear loads", 0, 0, sbi_play_clear_loads},
    {SBI_COMMAND_DISPLACEMENTS, "displacements", 0, SBI_REALS_PER_NODE, sbi_play_displacements},
    {SBI_COMMAND_VELOCITIES, "velocities", 0, SBI_REALS_PER_NODE, sbi_play_velocities},
    {SBI_COMMAND_RESET, "reset", 0, 0, sbi_play_reset},
    {SBI_COMMAND_STATE, "state", 0, 0, sbi_play_state},
    {SBI_COMMAND_STEP, "step", 0, 1, sbi_play_step},
    {SBI_COMMAND_STATIC, "static solve", 5, 1, sbi_play_static},
    {SBI_COMMAND_FIBRES, "fibres", 0, SBI_REALS_ANY, sbi_play_fibres},
    {SBI_COMMAND_ADD_PRESSURE, "new pressure", SBI_INTS_ANY, 1, sbi_play_add_pressure},
    {SBI_COMMAND_PRESSURE, "pressure", 0, 1, sbi_play_pressure},
    {SBI_COMMAND_ADD_SPRINGS, "new springs", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_add_springs},
    {SBI_COMMAND_ADD_MAPPING, "new mapping", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_add_mapping},
    {SBI_COMMAND_POINTS, "points", 0, SBI_REALS_ANY, sbi_play_points},
    {SBI_COMMAND_STIFFNESS, "stiffness", 1, SBI_REALS_ANY, sbi_play_stiffness},
    {SBI_COMMAND_REMOVE_LOAD, "remove load", 0, 0, sbi_play_remove_load},
    {SBI_COMMAND_ADD_CONSTRAINTS, "new constraints", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_add_constraints},
    {SBI_COMMAND_CONSTRAINT_VALUE, "constraint value", 0, 1, sbi_play_constraint_value},
    {SBI_COMMAND_REMOVE_CONSTRAINTS, "remove constraints", 0, 0, sbi_play_remove_constraints},
    {SBI_COMMAND_CLEAR_CONSTRAINTS, "clear constraints", 0, 0, sbi_play_clear_constraints},
    {SBI_COMMAND_CHANGE, "change of the mesh", SBI_INTS_ANY, SBI_REALS_ANY, sbi_change_replay},
    {SBI_COMMAND_PLACE, "place", SBI_PLACE_INTS, SBI_REALS_PER_NODE, sbi_play_place},
    {SBI_COMMAND_LINES, "lines", 0, SBI_REALS_ANY, sbi_play_lines},
    {SBI_COMMAND_PART, "command of a part", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_part},
    {SBI_COMMAND_REGION_DAMPING, "damping of a region", 0, 2, sbi_play_region_damping},
    {SBI_COMMAND_ADD_CABLE, "new cable", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_add_cable},
    {SBI_COMMAND_CABLE, "cable", 0, 2, sbi_play_cable},
    {SBI_COMMAND_POSE, "pose", SBI_INTS_ANY, 10, sbi_play_pose},
    {SBI_COMMAND_KEEP_TANGENT, "kept tangent", 0, 1, sbi_play_keep_tangent},
    {SBI_COMMAND_ADD_MEMBRANE, "new membrane", SBI_INTS_ANY, 3, sbi_play_add_membrane},
    {SBI_COMMAND_MEMBRANE, "membrane", 0, 3, sbi_play_membrane},
    {SBI_COMMAND_ADD_CAVITY, "new cavity", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_add_cavity},
    {SBI_COMMAND_CAVITY, "cavity", 0, 2, sbi_play_cavity},
    {SBI_COMMAND_ADD_RIGID, "new rigid body", SBI_INTS_ANY, 23, sbi_play_add_rigid},
    {SBI_COMMAND_RIGID_LOAD, "load of a rigid body", 0, 6, sbi_play_rigid_load},
    {SBI_COMMAND_REMOVE_RIGID, "remove rigid body", 0, 0, sbi_play_remove_rigid},
    {SBI_COMMAND_PART_STEP, "step of a part", SBI_INTS_ANY, SBI_REALS_ANY, sbi_play_part},
};

static const sbi_record_rule *sbi_record_find_rule(int code)
{
    for (size_t i = 0; i < sizeof sbi_record_rules / sizeof sbi_record_rules[0]; i++)
        if ((int)sbi_record_rules[i].code == code)
            return sbi_record_rules + i;
    return NULL;
}

/* 1 when the counts are those of the rule. */
static int sbi_record_fits(const sbi_record_rule *rule, const sbi_command *c)
{
    size_t reals = (size_t)rule->reals;
    if (rule->ints != SBI_INTS_ANY && c->int_count != (size_t)rule->ints)
        return 0;
    if (rule->reals == SBI_REALS_PER_INT)
        reals = c->b == 1 ? 3 : 3 * c->int_count;
    if (rule->reals == SBI_REALS_PER_NODE)
        reals = c->real_count / 3 * 3;
    if (rule->reals == SBI_REALS_ANY)
        reals = c->real_count;
    if (c->real_count != reals)
        return 0;
    if (sbi_record_is_solve(rule->code)) /* a: a result, 0 or negative */
        return c->a <= 0 && c->a > -64 && c->byte_count >= SBI_RECORD_OUTCOME &&
               (c->byte_count - SBI_RECORD_OUTCOME) % sizeof(sb_vec3) == 0;
    return c->byte_count == 0 || rule->code == SBI_COMMAND_STATE;
}

/* ---- reading ---- */

/* Steps on to the next command; 0 when what stands there is none. */
static int sbi_record_next(sbi_record_cursor *cursor)
{
    const sb_recording *recording = cursor->recording;
    const unsigned char *head = recording->data + cursor->at;
    size_t left = recording->size - cursor->at, used = SBI_RECORD_COMMAND;
    uint64_t ints, reals, bytes;
    if (left < used)
        return 0;
    ints = sbi_get_bytes(head + 12, 4);
    reals = sbi_get_bytes(head + 16, 8);
    bytes = sbi_get_bytes(head + 24, 8);
    if (ints > INT32_MAX || ints > left / 4 || reals > left / sizeof(sb_real) || bytes > left ||
        !sbi_size_add(&used, (size_t)ints, 4) || !sbi_size_add(&used, (size_t)reals, sizeof(sb_real)) ||
        !sbi_size_add(&used, (size_t)bytes, 1) || used > left)
        return 0;
    memset(&cursor->command, 0, sizeof cursor->command);
    cursor->rule = sbi_record_find_rule(sbi_int_of(sbi_get_bytes(head, 4)));
    cursor->command.a = sbi_int_of(sbi_get_bytes(head + 4, 4));
    cursor->command.b = sbi_int_of(sbi_get_bytes(head + 8, 4));
    cursor->command.int_count = (size_t)ints;
    cursor->command.real_count = (size_t)reals;
    cursor->command.byte_count = (size_t)bytes;
    cursor->ints = head + SBI_RECORD_COMMAND;
    cursor->reals = cursor->ints + 4 * (size_t)ints;
    cursor->command.bytes = cursor->reals + (size_t)reals * sizeof(sb_real);
    cursor->at += used;
    return cursor->rule && sbi_record_fits(cursor->rule, &cursor->command);
}

static sbi_record_cursor sbi_record_begin(const sb_recording *recording)
{
    sbi_record_cursor cursor;
    memset(&cursor, 0, sizeof cursor);
    cursor.recording = recording;
    cursor.at = SBI_RECORD_HEAD + recording->state_size;
    return cursor;
}

/* Takes the numbers of the head out of the image and sees that the commands are whole. */
static sb_result sbi_record_check(sb_recording *recording, sb_error *error)
{
    const unsigned char *at = recording->data + SBI_IMAGE_HEAD;
    uint64_t state_size = sbi_get_bytes(at + 24, 8);
    sbi_record_cursor cursor;
    int commands, steps = 0;
    recording->positions_every = sbi_int_of(sbi_get_bytes(at, 4));
    recording->incomplete = sbi_int_of(sbi_get_bytes(at + 4, 4));
    commands = recording->commands = sbi_int_of(sbi_get_bytes(at + 8, 4));
    recording->steps = sbi_int_of(sbi_get_bytes(at + 12, 4));
    recording->node_count = sbi_int_of(sbi_get_bytes(at + 16, 4));
    if (recording->positions_every < 0 || (recording->incomplete & ~1) || recording->node_count < 1 ||
        state_size > (uint64_t)(recording->size - SBI_RECORD_HEAD))
        return sbi_fail(error, SB_ERROR_FORMAT, "the head of the saved recording is wrong");
    recording->state_size = (size_t)state_size;
    cursor = sbi_record_begin(recording);
    for (int i = 0; i < commands; i++) {
        if (!sbi_record_next(&cursor))
            return sbi_fail(error, SB_ERROR_FORMAT, "command %d of the saved recording is wrong", i);
        steps += sbi_record_is_solve(cursor.rule->code);
    }
    if (commands < 0 || cursor.at != recording->size || steps != recording->steps)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved recording does not hold its %d commands and %d steps",
                        commands, recording->steps);
    return SB_OK;
}

SB_API sb_result sb_recording_load(const void *buffer, size_t size, const sb_allocator *allocator,
                                   sb_recording **recording, sb_error *error)
{
    sb_recording *made;
    sb_result result;
    if (!recording || (size > 0 && !buffer))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_recording_load needs bytes and a place for the recording");
    result =
        sbi_image_check((const unsigned char *)buffer, size, sbi_record_magic, SBI_RECORD_VERSION, "recording", error);
    if (result != SB_OK)
        return result;
    if (size < (size_t)SBI_RECORD_HEAD + (size_t)SBI_IMAGE_TAIL)
        return sbi_fail(error, SB_ERROR_FORMAT, "%lu bytes are too few for a saved recording", (unsigned long)size);
    made = sbi_record_make(allocator, error);
    if (!made)
        return SB_ERROR_MEMORY;
    if (sbi_record_reserve(made, size)) {
        memcpy(made->data, buffer, size);
        made->size = size - SBI_IMAGE_TAIL;
        result = sbi_record_check(made, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for a recording of %lu bytes", (unsigned long)size);
    }
    if (result == SB_OK)
        *recording = made;
    else
        sb_recording_destroy(made);
    return result;
}

SB_API sb_result sb_recording_load_file(const char *path, const sb_allocator *allocator, sb_recording **recording,
                                        sb_error *error)
{
    unsigned char *image = NULL;
    size_t size = 0;
    sb_result result;
    if (!path || !recording)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_recording_load_file needs a path and a place for the recording");
    result =
        sbi_image_read_file(allocator, path, sbi_record_magic, SBI_RECORD_VERSION, "recording", &image, &size, error);
    if (result != SB_OK)
        return result;
    result = sb_recording_load(image, size, allocator, recording, error);
    if (result != SB_OK && error)
        sbi_error_set_file(error, path);
    sbi_free(allocator, image);
    return result;
}

/* ---- replay ---- */

static sb_result sbi_record_take_scratch(const sb_recording *recording, sbi_record_scratch *scratch, sb_error *error)
{
    sbi_record_cursor cursor = sbi_record_begin(recording);
    size_t ints = 1, reals = 1;
    for (int i = 0; i < recording->commands && sbi_record_next(&cursor); i++) {
        ints = cursor.command.int_count > ints ? cursor.command.int_count : ints;
        reals = cursor.command.real_count > reals ? cursor.command.real_count : reals;
    }
    scratch->ints = (int *)sbi_alloc(&recording->allocator, ints, sizeof(int));
    scratch->vectors = (sb_vec3 *)sbi_alloc(&recording->allocator, reals / 3 + 1, sizeof(sb_vec3));
    if (!scratch->ints || !scratch->vectors)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for commands of %lu numbers", (unsigned long)(ints + reals));
    return SB_OK;
}

static void sbi_record_decode(sbi_record_cursor *cursor, const sbi_record_scratch *scratch)
{
    sb_real *reals = &scratch->vectors[0].x;
    for (size_t i = 0; i < cursor->command.int_count; i++)
        scratch->ints[i] = sbi_int_of(sbi_get_bytes(cursor->ints + 4 * i, 4));
    for (size_t i = 0; i < cursor->command.real_count; i++)
        reals[i] = sbi_real_of(sbi_get_bytes(cursor->reals + i * sizeof(sb_real), (int)sizeof(sb_real)));
    cursor->command.code = cursor->rule->code;
    cursor->command.ints = scratch->ints;
    cursor->command.reals = reals;
}

static sb_vec3 sbi_record_position(const unsigned char *bytes, int node)
{
    sb_real v[3];
    for (int k = 0; k < 3; k++)
        v[k] =
            sbi_real_of(sbi_get_bytes(bytes + ((size_t)node * 3 + (size_t)k) * sizeof(sb_real), (int)sizeof(sb_real)));
    return sb_v3(v[0], v[1], v[2]);
}

/* Finds where the displacements leave those of the recording. */
static void sbi_record_locate(const sb_body *body, const unsigned char *outcome, size_t size,
                              sb_recording_report *report)
{
    int n = body->domain.node_count;
    int has_positions = size == SBI_RECORD_OUTCOME + (size_t)n * sizeof(sb_vec3);
    for (int k = 0; k < SBI_RECORD_RANGES && report->first_node < 0; k++)
        if (sbi_get_bytes(outcome + 8 * (k + 1), 8) != sbi_record_range_hash(body->displacement, n, k)) {
            report->first_node = sbi_record_range_start(n, k);
            report->last_node = sbi_record_range_start(n, k + 1) - 1;
        }
    for (int i = report->first_node; has_positions && i >= 0 && i <= report->last_node; i++) {
        sb_vec3 then = sbi_record_position(outcome + SBI_RECORD_OUTCOME, i), now = body->displacement[i];
        if (sbi_real_bits(then.x) != sbi_real_bits(now.x) || sbi_real_bits(then.y) != sbi_real_bits(now.y) ||
            sbi_real_bits(then.z) != sbi_real_bits(now.z)) {
            report->first_node = report->last_node = i;
            report->distance = sb_v3_norm(sb_v3_sub(now, then));
        }
    }
}

/* Compares a step with what the recording says of it. */
static sb_result sbi_record_compare(const sbi_record_cursor *cursor, const sb_body *body, sb_result actual,
                                    sb_recording_report *report)
{
    const sbi_command *c = &cursor->command;
    uint64_t expected = sbi_get_bytes(c->bytes, 8), hash = sb_body_state_hash(body);
    char reason[256];
    if ((int)actual == c->a && hash == expected)
        return SB_OK;
    report->step = report->steps;
    report->expected = (sb_result)c->a;
    report->actual = actual;
    report->expected_hash = expected;
    report->actual_hash = hash;
    sbi_record_locate(body, c->bytes, c->byte_count, report);
    memcpy(reason, report->error.message, sizeof reason);
    if ((int)actual != c->a)
        return sbi_fail_node(&report->error, SB_ERROR_STATE, report->first_node, "step %d gave %s, not %s: %.120s",
                             report->step, sb_result_string(actual), sb_result_string(report->expected),
                             actual != SB_OK ? reason : "it had failed when it was recorded");
    if (report->first_node < 0)
        return sbi_fail(&report->error, SB_ERROR_STATE, "step %d led to another state, with the same displacements",
                        report->step);
    return sbi_fail_node(&report->error, SB_ERROR_STATE, report->first_node,
                         "step %d led to other displacements, first among nodes %d to %d", report->step,
                         report->first_node, report->last_node);
}

SBI_API sb_result sbi_record_play_next(sbi_record_player *player)
{
    const sbi_command *command = &player->cursor.command;
    sb_recording_report *report = player->report;
    const sbi_record_rule *rule;
    char reason[256];
    sb_result result;
    if (!sbi_record_next(&player->cursor)) /* the image was checked when it was loaded */
        return sbi_fail(&report->error, SB_ERROR_FORMAT, "command %d is wrong", report->commands);
    rule = player->cursor.rule;
    sbi_record_decode(&player->cursor, &player->scratch);
    memset(&report->error, 0, sizeof report->error);
    if (rule->reals == SBI_REALS_PER_NODE && command->real_count != 3 * (size_t)player->body->domain.node_count)
        result = sbi_record_refuse_counts(command, &report->error);
    else
        result = rule->play(player->body, command, &report->error);
    if (sbi_record_is_solve(rule->code)) {
        result = sbi_record_compare(&player->cursor, player->body, result, report);
    } else if (result != SB_OK) {
        memcpy(reason, report->error.message, sizeof reason);
        return sbi_fail(&report->error, result, "command %d (%s) was refused: %.150s", report->commands, rule->name,
                        reason[0] ? reason : sb_result_string(result));
    }
    if (result != SB_OK)
        return result;
    report->commands++;
    report->steps += sbi_record_is_solve(rule->code);
    return SB_OK;
}

SBI_API int sbi_record_peek(const sbi_record_player *player, sbi_record_glance *glance)
{
    sbi_record_cursor cursor = player->cursor;
    memset(glance, 0, sizeof *glance);
    if (player->report->commands >= cursor.recording->commands || !sbi_record_next(&cursor))
        return 0;
    glance->code = cursor.rule->code;
    glance->went_well = cursor.command.a == (int)SB_OK;
    if (glance->code == SBI_COMMAND_STEP)
        glance->dt = sbi_real_of(sbi_get_bytes(cursor.reals, (int)sizeof(sb_real)));
    return 1;
}

SBI_API void sbi_record_skip(sbi_record_player *player)
{
    if (!sbi_record_next(&player->cursor))
        return;
    player->report->commands++;
    player->report->steps += sbi_record_is_solve(player->cursor.rule->code);
}

static sb_result sbi_record_load_start(const sbi_record_player *player)
{
    const sb_recording *recording = player->cursor.recording;
    sb_error *error = &player->report->error;
    sb_result result =
        sb_body_state_load(player->body, recording->data + SBI_RECORD_HEAD, recording->state_size, error);
    if (result == SB_OK && recording->node_count != player->body->domain.node_count)
        return sbi_fail(error, SB_ERROR_STATE, "the recording is of %d nodes, the body has %d", recording->node_count,
                        player->body->domain.node_count);
    return result;
}

static void sbi_record_clear_error(sb_error *error)
{
    memset(error, 0, sizeof *error);
    error->element = error->node = -1;
}

SBI_API sb_result sbi_record_open(const sb_recording *recording, sb_body *body, sb_recording_report *report,
                                  sbi_record_player *player)
{
    sb_result result;
    memset(player, 0, sizeof *player);
    memset(report, 0, sizeof *report);
    report->step = report->first_node = report->last_node = -1;
    report->distance = -1;
    sbi_record_clear_error(&report->error);
    if (!recording || !body || recording->body == body)
        return sbi_fail(&report->error, SB_ERROR_ARGUMENT,
                        "a replay needs a recording and a body that is not the one being recorded");
    player->body = body;
    player->report = report;
    player->cursor = sbi_record_begin(recording);
    result = sbi_record_take_scratch(recording, &player->scratch, &report->error);
    if (result == SB_OK)
        result = sbi_record_load_start(player);
    if (result != SB_OK)
        sbi_record_close(player);
    return result;
}

SBI_API void sbi_record_close(sbi_record_player *player)
{
    const sb_allocator *allocator = &player->cursor.recording->allocator;
    sbi_free(allocator, player->scratch.ints);
    sbi_free(allocator, player->scratch.vectors);
    memset(&player->scratch, 0, sizeof player->scratch);
}

SB_API sb_result sb_recording_replay(const sb_recording *recording, sb_body *body, sb_recording_report *report)
{
    sb_recording_report own;
    sbi_record_player player;
    sbi_record_glance next;
    sb_result result;
    report = report ? report : &own;
    result = sbi_record_open(recording, body, report, &player);
    if (result != SB_OK)
        return result;
    while (result == SB_OK && sbi_record_peek(&player, &next))
        result = sbi_record_play_next(&player);
    if (result == SB_OK)
        sbi_record_clear_error(&report->error);
    sbi_record_close(&player);
    return result;
}
