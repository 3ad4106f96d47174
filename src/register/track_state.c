/* track_state: saves what a tracker is at, and brings it back. Numbers are little-endian, 4 or 8 bytes. */
#include <string.h>

#include "../softbody/base/bytes.h"
#include "track_private.h"

static const char regi_track_magic[9] = "REGTRACK";
enum { REGI_TRACK_VERSION = 2 };

/* One walk over what is saved: counts it, writes it, looks whether it may be read, or reads it. */
typedef struct regi_track_image {
    unsigned char *out;      /* NULL: nothing is written */
    const unsigned char *in; /* NULL: nothing is read */
    int keeps;               /* of what is read; 0: it is looked at only */
    size_t used;
    int bad; /* a number that is not finite was read */
} regi_track_image;

static uint64_t regi_track_word(regi_track_image *image, uint64_t word, int bytes)
{
    if (image->out)
        sbi_put_bytes(image->out + image->used, word, bytes);
    if (image->in)
        word = sbi_get_bytes(image->in + image->used, bytes);
    image->used += (size_t)bytes;
    return word;
}

/* Returns what is there after the walk has come by, kept or not. */
static int regi_track_int(regi_track_image *image, int *value)
{
    int found = sbi_int_of(regi_track_word(image, (uint64_t)(uint32_t)*value, 4));
    *value = image->keeps ? found : *value;
    return found;
}

static double regi_track_double(regi_track_image *image, double *value)
{
    double found;
    uint64_t word;
    memcpy(&word, value, sizeof word);
    word = regi_track_word(image, word, 8);
    memcpy(&found, &word, sizeof found);
    image->bad |= image->in && !isfinite(found);
    *value = image->keeps ? found : *value;
    return found;
}

static void regi_track_doubles(regi_track_image *image, double *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        (void)regi_track_double(image, values + i);
}

static sb_real regi_track_real(regi_track_image *image, sb_real *value)
{
    sb_real found = sbi_real_of(regi_track_word(image, sbi_real_bits(*value), (int)sizeof(sb_real)));
    image->bad |= image->in && !sb_is_finite(found);
    *value = image->keeps ? found : *value;
    return found;
}

static void regi_track_vectors(regi_track_image *image, sb_vec3 *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        (void)regi_track_real(image, &values[i].x);
        (void)regi_track_real(image, &values[i].y);
        (void)regi_track_real(image, &values[i].z);
    }
}

/* ---- what is saved ---- */

/* 64 bits that differ for other rest shapes and surfaces. */
static uint64_t regi_track_hash_model(const reg_model *model)
{
    uint64_t hash = (uint64_t)model->mesh.node_count;
    for (int i = 0; i < model->mesh.node_count; i++) {
        hash = sbi_hash_word(hash, sbi_real_bits(model->mesh.nodes[i].x));
        hash = sbi_hash_word(hash, sbi_real_bits(model->mesh.nodes[i].y));
        hash = sbi_hash_word(hash, sbi_real_bits(model->mesh.nodes[i].z));
    }
    for (int i = 0; i < 3 * model->skin.element_count; i++)
        hash = sbi_hash_word(hash, (uint64_t)(uint32_t)model->skin.elements[i]);
    return hash;
}

/* What two trackers must have in common. 1: the image's is this one's. */
static int regi_track_walk_make(const reg_track *t, regi_track_image *image)
{
    reg_track_def def = t->def;
    sb_real *reals[] = {&def.pose_sd, &def.pose_turn, &def.motion, &def.memory, &def.wander, &def.turn, &def.misfit};
    uint64_t hash = sbi_hash_word(regi_track_hash_model(t->model), t->marks_hash);
    int skin = t->skin_count, same = regi_track_word(image, hash, 8) == hash;
    same &= regi_track_int(image, &skin) == t->skin_count;
    same &= regi_track_int(image, &def.modes) == t->def.modes;
    same &= regi_track_int(image, &def.patches) == t->def.patches;
    same &= regi_track_double(image, &def.lost_after) == t->def.lost_after;
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++) {
        sb_real own = *reals[i];
        same &= regi_track_real(image, reals[i]) == own;
    }
    return same;
}

/* 0: a number is out of its range. */
static int regi_track_walk_known(reg_track *t, regi_track_image *image)
{
    regi_track_known *k = &t->known;
    size_t n = (size_t)t->unknowns;
    sb_quat turned;
    int surprises, wide, good;
    regi_track_doubles(image, k->mean, (size_t)t->def.modes);
    regi_track_doubles(image, k->covariance, n * n);
    regi_track_vectors(image, &k->place, 1);
    turned.x = regi_track_real(image, &k->turned.x);
    turned.y = regi_track_real(image, &k->turned.y);
    turned.z = regi_track_real(image, &k->turned.z);
    turned.w = regi_track_real(image, &k->turned.w);
    good = sb_abs(turned.x * turned.x + turned.y * turned.y + turned.z * turned.z + turned.w * turned.w - 1) <
           (sb_real)1e-3;
    good &= regi_track_double(image, &k->time) >= 0;
    good &= regi_track_double(image, &k->blind) >= 0;
    good &= regi_track_real(image, &k->noise) >= 0;
    good &= regi_track_double(image, &k->scale) >= 0;
    good &= regi_track_double(image, &k->change) >= 0;
    regi_track_doubles(image, k->evidence, REGI_TRACK_SCALES);
    regi_track_doubles(image, k->change_evidence, REGI_TRACK_SCALES);
    good &= regi_track_real(image, &k->usual_used) >= 0;
    (void)regi_track_real(image, &k->usual_innovation);
    surprises = regi_track_int(image, &k->surprises);
    wide = regi_track_int(image, &k->wide);
    return good && surprises >= 0 && surprises < REGI_TRACK_SURPRISES && wide >= 0 && wide <= REGI_TRACK_WIDE;
}

/* One point that waits. A target is fresh, so its points have no places yet. */
static int regi_track_walk_point(regi_track_image *image, regi_look_point *point)
{
    sb_real weight, sd;
    if (image->keeps)
        regi_look_take(point, sb_v3(0, 0, 0), sb_v3(0, 0, 0), 0, 0);
    regi_track_vectors(image, &point->at, 1);
    regi_track_vectors(image, &point->normal, 1);
    weight = regi_track_real(image, &point->weight);
    sd = regi_track_real(image, &point->sd);
    return weight >= 0 && sd >= 0;
}

/* Which features wait: landmarks that are seen, and samples of curves, are counted. 0: out of range. */
static int regi_track_walk_seen(reg_track *t, regi_track_image *image, int *landmarks, int *samples)
{
    int good = 1;
    *landmarks = *samples = 0;
    for (int i = 0; i < t->marks.landmark_count + t->marks.curve_count; i++) {
        int found = regi_track_int(image, t->marks.seen + i),
            most = i < t->marks.landmark_count ? 1 : REGI_MARKS_SAMPLES;
        good &= found >= 0 && found <= most;
        *(i < t->marks.landmark_count ? landmarks : samples) += good ? found : 0;
    }
    return good;
}

/* Bytes of where they are seen. */
static size_t regi_track_feature_bytes(int landmarks, int samples)
{
    const size_t place = 3 * sizeof(sb_real);
    return (size_t)landmarks * (place + 8) + (size_t)samples * (2 * place + 8);
}

/* Where they are seen. 0: out of range, or not so many bytes. */
static int regi_track_walk_features(reg_track *t, regi_track_image *image, int landmarks, int samples, size_t room)
{
    int good = 1;
    if (image->in && room - image->used < regi_track_feature_bytes(landmarks, samples))
        return 0;
    for (int i = 0; i < landmarks; i++) {
        regi_track_vectors(image, &t->marks.lines[3 * i].seen, 1);
        good &= regi_track_double(image, &t->marks.lines[3 * i].variance) >= 0;
    }
    for (int i = 0; i < samples; i++) {
        regi_track_vectors(image, &t->marks.samples[i].seen, 1);
        regi_track_vectors(image, &t->marks.samples[i].tangent, 1);
        good &= regi_track_double(image, &t->marks.samples[i].variance) >= 0;
    }
    if (good && image->keeps)
        regi_marks_index(&t->marks);
    return good;
}

/* The target that waits, if one does, of which `waiting` is known. `room`: bytes that the image has for it. 0: out of
 * range. */
static int regi_track_walk_target(reg_track *t, regi_track_image *image, int waiting, size_t room)
{
    const size_t head = 4 + 3 * sizeof(sb_real) + 4, bytes = 8 * sizeof(sb_real);
    int camera, count, good;
    if (waiting == 0)
        return 1;
    if (image->in && (waiting != 1 || room < image->used + head))
        return 0;
    camera = regi_track_int(image, &t->incoming_has_camera);
    regi_track_vectors(image, &t->incoming_camera, 1);
    count = regi_track_int(image, &t->incoming_count);
    good = (camera == 0 || camera == 1) && count >= 0 && count <= t->def.most_points &&
           (image->in == NULL || room - image->used == (size_t)count * bytes);
    for (int i = 0; good && i < count; i++)
        good &= regi_track_walk_point(image, t->incoming + i);
    return good;
}

/* All but the make; 0: out of range. */
static int regi_track_walk(reg_track *t, regi_track_image *image, size_t room)
{
    size_t nodes = (size_t)t->node_count;
    int good = regi_track_walk_known(t, image), landmarks, samples, waiting;
    regi_track_vectors(image, t->arms, nodes);
    regi_track_vectors(image, t->modes, nodes * (size_t)t->def.modes);
    good &= regi_track_walk_seen(t, image, &landmarks, &samples);
    waiting = regi_track_int(image, &t->waiting);
    return good && regi_track_walk_features(t, image, landmarks, samples, room) &&
           regi_track_walk_target(t, image, waiting, room);
}

/* ---- the calls ---- */

/* A walk that counts or writes changes nothing. */
static size_t regi_track_put(const reg_track *track, unsigned char *out)
{
    reg_track view = *track;
    regi_track_image image;
    memset(&image, 0, sizeof image);
    image.out = out;
    (void)regi_track_walk_make(&view, &image);
    (void)regi_track_walk(&view, &image, 0);
    return image.used;
}

REG_API size_t reg_track_save_size(const reg_track *track)
{
    return track ? regi_track_put(track, NULL) + SBI_IMAGE_HEAD + SBI_IMAGE_TAIL : 0;
}

REG_API sb_result reg_track_save(const reg_track *track, void *buffer, size_t size)
{
    size_t needed = reg_track_save_size(track);
    if (!track || !buffer || size < needed)
        return SB_ERROR_ARGUMENT;
    (void)regi_track_put(track, (unsigned char *)buffer + SBI_IMAGE_HEAD);
    sbi_image_seal((unsigned char *)buffer, needed, regi_track_magic, REGI_TRACK_VERSION);
    return SB_OK;
}

/* Bytes of a state where nothing waits: all that a walk reads before it can know how much does. */
static size_t regi_track_least(const reg_track *track)
{
    reg_track view = *track;
    view.waiting = 0;
    return regi_track_put(&view, NULL) - regi_track_feature_bytes(view.marks.fixed_count / 3, view.marks.sample_count);
}

static sb_result regi_track_check_content(const reg_track *track, const unsigned char *in, size_t size, sb_error *error)
{
    reg_track view = *track;
    regi_track_image image;
    int good;
    memset(&image, 0, sizeof image);
    image.in = in;
    if (size < regi_track_least(track) || !regi_track_walk_make(&view, &image))
        return sbi_fail(error, SB_ERROR_STATE, "the saved tracker is of another model or def");
    good = regi_track_walk(&view, &image, size) && image.used == size;
    if (image.bad)
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the saved tracker holds a number that is not finite");
    return good ? SB_OK : sbi_fail(error, SB_ERROR_FORMAT, "the saved tracker has a number out of its range");
}

REG_API sb_result reg_track_load(reg_track *track, const void *buffer, size_t size, sb_error *error)
{
    const unsigned char *bytes = (const unsigned char *)buffer;
    regi_track_image image;
    sb_result result;
    if (!track || !buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a load needs a tracker and a state");
    result = sbi_image_check(bytes, size, regi_track_magic, REGI_TRACK_VERSION, "tracker", error);
    if (result == SB_OK) {
        size -= SBI_IMAGE_HEAD + SBI_IMAGE_TAIL;
        result = regi_track_check_content(track, bytes + SBI_IMAGE_HEAD, size, error);
    }
    if (result != SB_OK)
        return result;
    memset(&image, 0, sizeof image);
    image.in = bytes + SBI_IMAGE_HEAD;
    image.keeps = 1;
    (void)regi_track_walk_make(track, &image);
    (void)regi_track_walk(track, &image, size);
    regi_track_derive(track);
    return SB_OK;
}
