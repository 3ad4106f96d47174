/* heat_state: heat as part of its body's saved states and recordings. */
#include "../base/bytes.h"
#include "heat_private.h"

#include <string.h>

enum { SBI_HEAT_VERSION = 1, SBI_HEAT_FLOWS = 7 };

/* ---- numbers in double ---- */

static uint64_t sbi_heat_bits(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static void sbi_heat_put_word(sbi_state_out *out, uint64_t word)
{
    unsigned char bytes[8];
    sbi_put_bytes(bytes, word, 8);
    sbi_state_put(out, bytes, sizeof bytes);
}

static double sbi_heat_get_double(sbi_part_in *in)
{
    uint64_t bits = sbi_part_get(in, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    if (isfinite(value))
        return value;
    in->bad = 1;
    return 0;
}

static uint64_t sbi_heat_hash(uint64_t hash, const double *values, int count)
{
    for (int i = 0; i < count; i++)
        hash = sbi_hash_word(hash, sbi_heat_bits(values[i]));
    return hash;
}

/* What it is made of, so that a state of another one is refused. */
static uint64_t sbi_heat_make_hash(const sb_heat *heat)
{
    const sb_heat_def *def = &heat->def;
    const double law[] = {(double)def->latent_low, (double)def->latent_high,     (double)def->log_frequency,
                          (double)def->activation, (double)def->stiffening,      (double)def->tolerance,
                          (double)def->start,      (double)def->keeps_perfusion, (double)def->max_iterations,
                          (double)def->harmless};
    uint64_t hash = sbi_heat_hash(1, law, (int)(sizeof law / sizeof *law));
    hash = sbi_heat_hash(hash, heat->conduction, heat->entry_count);
    hash = sbi_heat_hash(hash, heat->capacity, heat->node_count);
    hash = sbi_heat_hash(hash, heat->latent, heat->node_count);
    hash = sbi_heat_hash(hash, heat->perfusion, heat->node_count);
    return sbi_heat_hash(hash, heat->metabolic, heat->node_count);
}

static double *sbi_heat_flow(sb_heat_flows *flows, int k)
{
    double *list[SBI_HEAT_FLOWS] = {&flows->source, &flows->metabolic, &flows->perfused, &flows->convected,
                                    &flows->held,   &flows->stored,    &flows->error};
    return list[k];
}

/* ---- saving ---- */

static void sbi_heat_put_source(const sbi_heat_source *source, sbi_state_out *out)
{
    sbi_part_put_int(out, source->id);
    sbi_part_put_int(out, (int)source->kind);
    sbi_part_put_int(out, source->count);
    sbi_part_put_reals(out, source->value, 1);
    sbi_part_put_reals(out, source->surroundings, 1);
    for (int k = 0; k < source->count; k++) {
        sbi_part_put_int(out, source->rows[k]);
        sbi_part_put_int(out, source->columns[k]);
        sbi_part_put_reals(out, source->shares + k, 1);
    }
}

static void sbi_heat_save(const void *user, sbi_state_out *out)
{
    const sb_heat *heat = (const sb_heat *)user;
    sb_heat_flows flows = heat->balance;
    sbi_heat_put_word(out, sbi_heat_make_hash(heat));
    sbi_part_put_reals(out, &heat->def.blood, 1);
    for (int k = 0; k < SBI_HEAT_FLOWS; k++)
        sbi_heat_put_word(out, sbi_heat_bits(*sbi_heat_flow(&flows, k)));
    for (int i = 0; i < heat->node_count; i++) {
        unsigned char held = heat->held[i];
        sbi_part_put_reals(out, heat->temperature + i, 1);
        sbi_part_put_reals(out, heat->damage + i, 1);
        sbi_part_put_reals(out, heat->target + i, 1);
        sbi_state_put(out, &held, 1);
    }
    sbi_part_put_int(out, heat->last_id);
    sbi_part_put_int(out, heat->source_count);
    for (int k = 0; k < heat->source_count; k++)
        sbi_heat_put_source(heat->sources + k, out);
}

/* ---- loading ---- */

enum { SBI_HEAT_ENTRY = 4 + 4 + 8, SBI_HEAT_SOURCE_BYTES = 3 * 4 + 2 * 8 };

static sb_result sbi_heat_damaged(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_FORMAT, "the saved heat is damaged");
}

/* Reads a source into memory of its own. */
static sb_result sbi_heat_get_source(const sb_heat *heat, sbi_part_in *in, sbi_heat_source *source, sb_error *error)
{
    int id = sbi_part_get_int(in), kind = sbi_part_get_int(in), count = sbi_part_get_int(in);
    memset(source, 0, sizeof *source);
    if (in->bad || id < 1 || kind < SBI_HEAT_SOURCE || kind > SBI_HEAT_CONVECTION || count < 1 ||
        (size_t)count > in->left / SBI_HEAT_ENTRY)
        return sbi_heat_damaged(error);
    if (!sbi_heat_make_source(heat, (sbi_heat_kind)kind, count, source))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a saved heat source of %d entries", count);
    source->id = id;
    sbi_part_get_reals(in, source->value, 1);
    sbi_part_get_reals(in, source->surroundings, 1);
    for (int k = 0; k < count; k++) {
        source->rows[k] = sbi_part_get_int(in);
        source->columns[k] = sbi_part_get_int(in);
        sbi_part_get_reals(in, source->shares + k, 1);
    }
    if (in->bad || sbi_heat_check_source(heat, source, NULL) != SB_OK)
        return sbi_heat_damaged(error);
    return SB_OK;
}

static void sbi_heat_give_up(void *user)
{
    sb_heat *heat = (sb_heat *)user;
    sbi_heat_free_sources(heat, heat->loaded, heat->loaded_count);
    heat->loaded = NULL;
    heat->loaded_count = 0;
}

/* Reads all sources into heat->loaded. */
static sb_result sbi_heat_get_sources(sb_heat *heat, sbi_part_in *in, sb_error *error)
{
    int last = sbi_part_get_int(in), count = sbi_part_get_int(in), before = 0;
    if (in->bad || last < 0 || count < 0 || (size_t)count > in->left / SBI_HEAT_SOURCE_BYTES)
        return sbi_heat_damaged(error);
    heat->loaded = (sbi_heat_source *)sbi_alloc(&heat->body->allocator, (size_t)count, sizeof *heat->loaded);
    if (!heat->loaded)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d saved heat sources", count);
    for (; heat->loaded_count < count; before = heat->loaded[heat->loaded_count - 1].id) {
        sb_result result = sbi_heat_get_source(heat, in, heat->loaded + heat->loaded_count, error);
        heat->loaded_count++;
        if (result != SB_OK)
            return result;
        if (heat->loaded[heat->loaded_count - 1].id <= before || heat->loaded[heat->loaded_count - 1].id > last)
            return sbi_heat_damaged(error);
    }
    return in->left == 0 ? SB_OK : sbi_heat_damaged(error);
}

static sb_result sbi_heat_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                sb_error *error)
{
    sb_heat *heat = (sb_heat *)user;
    sbi_part_in in = sbi_part_read(bytes, size);
    sb_real blood;
    sb_result result;
    int bad;
    (void)body;
    if (sbi_part_get(&in, 8) != sbi_heat_make_hash(heat))
        return sbi_fail(error, SB_ERROR_STATE, "the state is of heat in another tissue or with another law");
    sbi_part_get_reals(&in, &blood, 1);
    bad = !(blood > 0);
    for (int k = 0; k < SBI_HEAT_FLOWS; k++)
        (void)sbi_heat_get_double(&in);
    for (int i = 0; i < heat->node_count; i++) {
        sb_real node[3];
        uint64_t held;
        sbi_part_get_reals(&in, node, 3);
        held = sbi_part_get(&in, 1);
        bad |= !(node[0] > 0) || !(node[1] >= 0) || !(node[2] > 0) || held > 1 || (!held && !(heat->volume[i] > 0));
    }
    sbi_heat_give_up(heat);
    result = in.bad || bad ? sbi_heat_damaged(error) : sbi_heat_get_sources(heat, &in, error);
    if (result != SB_OK)
        sbi_heat_give_up(heat);
    return result;
}

static void sbi_heat_load(void *user, const unsigned char *bytes, size_t size)
{
    sb_heat *heat = (sb_heat *)user;
    sbi_part_in in = sbi_part_read(bytes, size);
    (void)sbi_part_get(&in, 8);
    sbi_part_get_reals(&in, &heat->def.blood, 1);
    for (int k = 0; k < SBI_HEAT_FLOWS; k++)
        *sbi_heat_flow(&heat->balance, k) = sbi_heat_get_double(&in);
    for (int i = 0; i < heat->node_count; i++) {
        sbi_part_get_reals(&in, heat->temperature + i, 1);
        sbi_part_get_reals(&in, heat->damage + i, 1);
        sbi_part_get_reals(&in, heat->target + i, 1);
        heat->held[i] = (unsigned char)sbi_part_get(&in, 1);
    }
    heat->last_id = sbi_part_get_int(&in);
    sbi_heat_free_sources(heat, heat->sources, heat->source_count);
    heat->sources = heat->loaded;
    heat->source_count = heat->source_capacity = heat->loaded_count;
    heat->loaded = NULL;
    heat->loaded_count = 0;
    if (sbi_heat_stiffen(heat))
        sbi_body_read_cell_stiffness(heat->body);
}

/* ---- recording ---- */

static sb_result sbi_heat_replay_add(sb_heat *heat, const int *ints, size_t int_count, const sb_real *reals,
                                     size_t real_count, sb_error *error)
{
    sbi_heat_source source;
    int count = ints[2];
    if (ints[1] < SBI_HEAT_SOURCE || ints[1] > SBI_HEAT_CONVECTION || count < 1 ||
        int_count != SBI_HEAT_HEAD + 2 * (size_t)count || real_count != 2 + (size_t)count)
        return sbi_fail(error, SB_ERROR_FORMAT, "a recorded heat source is none");
    if (!sbi_heat_make_source(heat, (sbi_heat_kind)ints[1], count, &source))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a recorded heat source of %d entries", count);
    memcpy(source.head, ints, int_count * sizeof *ints);
    memcpy(source.value, reals, real_count * sizeof *reals);
    return sbi_heat_take_source(heat, &source, NULL, error);
}

static sb_result sbi_heat_replay_set(sb_heat *heat, int id, const sb_real *reals)
{
    const sbi_heat_source *source = sbi_heat_find_source(heat, id);
    return source && source->kind == SBI_HEAT_CONVECTION ? sb_heat_set_convection(heat, id, reals[0], reals[1])
                                                         : sb_heat_set_source(heat, id, reals[0]);
}

static sb_result sbi_heat_replay(void *user, const int *ints, size_t int_count, const sb_real *reals, size_t real_count,
                                 sb_error *error)
{
    sb_heat *heat = (sb_heat *)user;
    int command = int_count > 0 ? ints[0] : 0, a = int_count > 1 ? ints[1] : 0;
    if (command == SBI_HEAT_ADD && int_count >= SBI_HEAT_HEAD)
        return sbi_heat_replay_add(heat, ints, int_count, reals, real_count, error);
    if (command == SBI_HEAT_STEP && real_count == 1)
        return sb_heat_step(heat, reals[0], NULL, error);
    if (command == SBI_HEAT_STEADY && real_count == 1)
        return sb_heat_solve_steady(heat, NULL, error);
    if (command == SBI_HEAT_HOLD && real_count == 1)
        return sb_heat_hold(heat, &a, 1, reals, 1, error);
    if (command == SBI_HEAT_RELEASE && real_count == 0)
        return sb_heat_release(heat, &a, 1, error);
    if (command == SBI_HEAT_SET && real_count == 2)
        return sbi_heat_replay_set(heat, a, reals);
    if (command == SBI_HEAT_REMOVE && real_count == 0)
        return sb_heat_remove(heat, a);
    if (command == SBI_HEAT_BLOOD && real_count == 1)
        return sb_heat_set_blood(heat, reals[0]);
    if (command == SBI_HEAT_TEMPERATURES && real_count == (size_t)heat->node_count)
        return sb_heat_set_temperatures(heat, reals, error);
    if (command != SBI_HEAT_RESET || real_count != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "a recorded command to heat is none");
    sb_heat_reset(heat);
    return SB_OK;
}

/* ---- joining ---- */

SBI_API sb_result sbi_heat_join(sb_heat *heat, sb_error *error)
{
    sbi_state_part part;
    if (sbi_body_find_part(heat->body, SBI_HEAT_PART))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body has heat already");
    memset(&part, 0, sizeof part);
    memcpy(part.name, SBI_HEAT_PART, sizeof SBI_HEAT_PART);
    part.version = SBI_HEAT_VERSION;
    part.user = heat;
    part.save = sbi_heat_save;
    part.check = sbi_heat_check;
    part.load = sbi_heat_load;
    part.give_up = sbi_heat_give_up;
    part.replay = sbi_heat_replay;
    return sbi_body_join(heat->body, &part, error);
}

SBI_API void sbi_heat_leave(sb_heat *heat) { sbi_body_leave(heat->body, SBI_HEAT_PART); }
