/* igtl.h: messages of OpenIGTLink, protocols 1 to 3: TRANSFORM, POSITION, POINT, STRING, STATUS, NDARRAY, POLYDATA,
 * COMMAND, CAPABILITY and what asks for them. Bytes only: no sockets, no allocation. Include it after softbody.h.
 *
 * To write, ask for the size, fill the content, close the message:
 *
 *     igtl_envelope e = igtl_default_envelope("Organ");
 *     size_t content = igtl_put_transform(NULL, &tool);             NULL: only counts
 *     if (igtl_size(&e, content) <= sizeof buffer) {
 *         igtl_put_transform(igtl_content(&e, buffer), &tool);
 *         size = igtl_close(&crc, "TRANSFORM", &e, content, buffer);
 *     }
 *
 * To read, 58 bytes tell how many follow, igtl_open checks them all, igtl_get_... takes a content apart:
 *
 *     igtl_read_header(buffer, &header, &error);
 *     igtl_open(&crc, buffer, IGTL_HEADER + header.body, &message, &error);
 *     igtl_get_transform(&message, &tool, &error);
 *
 * What comes from elsewhere is taken for hostile: no count is believed before it fits the bytes that are there, no
 * number that is not finite is handed on, texts end within their field. Errors are SB_ERROR_FORMAT, with what is wrong
 * in the message. Lengths on the wire are mm in the patient's axes, right-anterior-superior where 3D Slicer listens;
 * igtl_space turns the metres of a body into them and back. */
#ifndef IGTL_H
#define IGTL_H

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum {
    IGTL_HEADER = 58,         /* bytes */
    IGTL_EXTENDED = 12,       /* bytes of protocol 3's second header */
    IGTL_MAX_BODY = 64 << 20, /* bytes that igtl_read_header lets pass */
    IGTL_PORT = 18944
};

/* ---- errors ---------------------------------------------------------------------------------------------------- */

#if defined(__GNUC__)
#define IGTL_PRINTF __attribute__((format(printf, 2, 3)))
#else
#define IGTL_PRINTF
#endif

IGTL_PRINTF static inline sb_result igtl_fail(sb_error *error, const char *format, ...)
{
    va_list arguments;
    if (error) {
        memset(error, 0, sizeof *error);
        error->result = SB_ERROR_FORMAT;
        error->element = error->node = -1;
        va_start(arguments, format);
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return SB_ERROR_FORMAT;
}

/* ---- bytes ----------------------------------------------------------------------------------------------------- */

static inline void igtl_put_u16(unsigned char *at, unsigned value)
{
    at[0] = (unsigned char)(value >> 8);
    at[1] = (unsigned char)value;
}

static inline void igtl_put_u32(unsigned char *at, uint32_t value)
{
    igtl_put_u16(at, (unsigned)(value >> 16));
    igtl_put_u16(at + 2, (unsigned)(value & 0xffff));
}

static inline void igtl_put_u64(unsigned char *at, uint64_t value)
{
    igtl_put_u32(at, (uint32_t)(value >> 32));
    igtl_put_u32(at + 4, (uint32_t)(value & 0xffffffffu));
}

static inline void igtl_put_float(unsigned char *at, double value)
{
    float narrow = (float)value;
    uint32_t bits;
    memcpy(&bits, &narrow, sizeof bits);
    igtl_put_u32(at, bits);
}

static inline unsigned igtl_get_u16(const unsigned char *at) { return (unsigned)at[0] << 8 | at[1]; }

static inline uint32_t igtl_get_u32(const unsigned char *at)
{
    return (uint32_t)igtl_get_u16(at) << 16 | igtl_get_u16(at + 2);
}

static inline uint64_t igtl_get_u64(const unsigned char *at)
{
    return (uint64_t)igtl_get_u32(at) << 32 | igtl_get_u32(at + 4);
}

static inline double igtl_get_float(const unsigned char *at)
{
    uint32_t bits = igtl_get_u32(at);
    float narrow;
    memcpy(&narrow, &bits, sizeof narrow);
    return (double)narrow;
}

/* A text into a field of `size` bytes, cut where it is longer, zeros behind it. */
static inline void igtl_put_text(unsigned char *at, size_t size, const char *text)
{
    size_t length = strlen(text);
    length = length < size ? length : size;
    memset(at, 0, size);
    memcpy(at, text, length);
}

/* A field of `size` bytes as a text[size + 1]. */
static inline void igtl_get_text(const unsigned char *at, size_t size, char *text)
{
    const void *end = memchr(at, 0, size);
    size_t length = end ? (size_t)((const unsigned char *)end - at) : size;
    memcpy(text, at, length);
    text[length] = 0;
}

/* `count` finite numbers; 0 where one is not. */
static inline int igtl_get_floats(const unsigned char *at, size_t count, double *values)
{
    for (size_t i = 0; i < count; i++) {
        values[i] = igtl_get_float(at + 4 * i);
        if (!(values[i] - values[i] == 0))
            return 0;
    }
    return 1;
}

/* ---- the checksum: CRC-64 of ECMA-182, most significant bit first, from 0 ---------------------------------------- */

typedef struct igtl_crc {
    uint64_t table[8][256]; /* [k][byte]: what a byte adds that k bytes follow */
} igtl_crc;

static inline void igtl_crc_make(igtl_crc *crc)
{
    for (unsigned byte = 0; byte < 256; byte++) {
        uint64_t rest = (uint64_t)byte << 56;
        for (int bit = 0; bit < 8; bit++)
            rest = rest << 1 ^ (rest >> 63 ? UINT64_C(0x42F0E1EBA9EA3693) : 0);
        crc->table[0][byte] = rest;
    }
    for (int k = 1; k < 8; k++)
        for (unsigned byte = 0; byte < 256; byte++) {
            uint64_t rest = crc->table[k - 1][byte];
            crc->table[k][byte] = rest << 8 ^ crc->table[0][rest >> 56];
        }
}

static inline uint64_t igtl_crc_of(const igtl_crc *crc, const unsigned char *bytes, size_t size)
{
    uint64_t rest = 0;
    for (; size >= 8; size -= 8, bytes += 8) {
        uint64_t word = rest ^ igtl_get_u64(bytes);
        rest = 0;
        for (int k = 0; k < 8; k++)
            rest ^= crc->table[7 - k][word >> (56 - 8 * k) & 255];
    }
    for (; size > 0; size--, bytes++)
        rest = rest << 8 ^ crc->table[0][(rest >> 56 ^ *bytes) & 255];
    return rest;
}

/* ---- metres and the patient's millimetres ------------------------------------------------------------------------ */

/* The wire's axes: those of the body, or turned half around z: a mesh in left-posterior-superior axes becomes
 * right-anterior-superior. */
typedef struct igtl_space {
    double scale; /* wire units per metre: 1000 */
    int flip;     /* 1: x and y change sign */
} igtl_space;

static inline sb_vec3 igtl_turned(const igtl_space *space, double factor, sb_vec3 v)
{
    double across = space->flip ? -factor : factor;
    return sb_v3((sb_real)(across * (double)v.x), (sb_real)(across * (double)v.y), (sb_real)(factor * (double)v.z));
}
static inline sb_vec3 igtl_to_wire(const igtl_space *space, sb_vec3 v) { return igtl_turned(space, space->scale, v); }
static inline sb_vec3 igtl_from_wire(const igtl_space *space, sb_vec3 v)
{
    return igtl_turned(space, 1 / space->scale, v);
}

/* ---- the envelope ------------------------------------------------------------------------------------------------ */

/* A pair of protocol 3's metadata. Read ones point into the message. */
typedef struct igtl_entry {
    const char *key, *value; /* not ended by 0 where they were read */
    size_t key_length, value_length;
    int encoding; /* of IANA's list: 3 ASCII, 106 UTF-8 */
} igtl_entry;

typedef struct igtl_envelope {
    int version;         /* 1, or 2 with protocol 3's second header */
    const char *device;  /* 20 bytes at most */
    uint64_t time;       /* s since 1970, 32 bits before and 32 behind the point */
    uint32_t message_id; /* version 2 */
    const igtl_entry *entries;
    int entry_count; /* version 2; at most 8,191, with keys of at most 65,535 bytes */
} igtl_envelope;

static inline igtl_envelope igtl_default_envelope(const char *device)
{
    igtl_envelope e;
    memset(&e, 0, sizeof e);
    e.version = 1;
    e.device = device;
    return e;
}

/* Of seconds since 1970; of those that are no time, the nearest that is. */
static inline uint64_t igtl_time(double seconds)
{
    uint64_t whole;
    if (!(seconds > 0))
        return 0;
    if (seconds >= 4294967296.0)
        return UINT64_MAX;
    whole = (uint64_t)seconds;
    return whole << 32 | (uint32_t)((seconds - (double)whole) * 4294967295.0);
}

static inline size_t igtl_metadata_size(const igtl_envelope *e)
{
    size_t size = 2;
    for (int i = 0; i < e->entry_count; i++)
        size += 8 + e->entries[i].key_length + e->entries[i].value_length;
    return size;
}

/* Bytes of a whole message. */
static inline size_t igtl_size(const igtl_envelope *e, size_t content)
{
    return IGTL_HEADER + content + (e->version > 1 ? IGTL_EXTENDED + igtl_metadata_size(e) : 0);
}

/* Where the content goes. */
static inline unsigned char *igtl_content(const igtl_envelope *e, unsigned char *message)
{
    return message + IGTL_HEADER + (e->version > 1 ? IGTL_EXTENDED : 0);
}

static inline void igtl_put_metadata(unsigned char *at, const igtl_envelope *e)
{
    unsigned char *text = at + 2 + 8 * (size_t)e->entry_count;
    igtl_put_u16(at, (unsigned)e->entry_count);
    for (int i = 0; i < e->entry_count; i++) {
        const igtl_entry *entry = e->entries + i;
        unsigned char *sizes = at + 2 + 8 * (size_t)i;
        igtl_put_u16(sizes, (unsigned)entry->key_length);
        igtl_put_u16(sizes + 2, (unsigned)entry->encoding);
        igtl_put_u32(sizes + 4, (uint32_t)entry->value_length);
        memcpy(text, entry->key, entry->key_length);
        text += entry->key_length;
        memcpy(text, entry->value, entry->value_length);
        text += entry->value_length;
    }
}

/* Puts the headers, metadata and checksum around the content; returns the bytes of all. type: 12 bytes at most. */
static inline size_t igtl_close(const igtl_crc *crc, const char *type, const igtl_envelope *e, size_t content,
                                unsigned char *message)
{
    size_t size = igtl_size(e, content), body = size - IGTL_HEADER;
    if (e->version > 1) {
        unsigned char *extended = message + IGTL_HEADER;
        igtl_put_u16(extended, IGTL_EXTENDED);
        igtl_put_u16(extended + 2, 2 + 8 * (unsigned)e->entry_count);
        igtl_put_u32(extended + 4, (uint32_t)(igtl_metadata_size(e) - 2 - 8 * (size_t)e->entry_count));
        igtl_put_u32(extended + 8, e->message_id);
        igtl_put_metadata(extended + IGTL_EXTENDED + content, e);
    }
    igtl_put_u16(message, (unsigned)e->version);
    igtl_put_text(message + 2, 12, type);
    igtl_put_text(message + 14, 20, e->device);
    igtl_put_u64(message + 34, e->time);
    igtl_put_u64(message + 42, body);
    igtl_put_u64(message + 50, igtl_crc_of(crc, message + IGTL_HEADER, body));
    return size;
}

typedef struct igtl_header {
    int version;
    char type[13], device[21];
    uint64_t time, crc;
    size_t body; /* bytes that follow */
} igtl_header;

/* Refuses bodies over IGTL_MAX_BODY, versions that are not known, and types that are no text: what follows them cannot
 * be told from anything, so the connection is at its end. */
static inline sb_result igtl_read_header(const unsigned char *bytes, igtl_header *header, sb_error *error)
{
    uint64_t body = igtl_get_u64(bytes + 42);
    header->version = (int)igtl_get_u16(bytes);
    igtl_get_text(bytes + 2, 12, header->type);
    igtl_get_text(bytes + 14, 20, header->device);
    header->time = igtl_get_u64(bytes + 34);
    header->crc = igtl_get_u64(bytes + 50);
    header->body = 0;
    if (header->version < 1 || header->version > 2)
        return igtl_fail(error, "header version %d is not known", header->version);
    for (const char *c = header->type; *c; c++)
        if (*c < ' ' || *c > '~')
            return igtl_fail(error, "the type of the message is no text");
    if (!header->type[0])
        return igtl_fail(error, "the message has no type");
    if (body > IGTL_MAX_BODY)
        return igtl_fail(error, "%s: a body of more than %d bytes", header->type, IGTL_MAX_BODY);
    header->body = (size_t)body;
    return SB_OK;
}

typedef struct igtl_message {
    igtl_header header;
    uint32_t message_id; /* version 2; else 0 */
    const unsigned char *content;
    size_t content_size;
    const unsigned char *metadata;
    int entry_count;
} igtl_message;

static inline sb_result igtl_check_metadata(const igtl_message *m, size_t sizes, size_t text, sb_error *error)
{
    uint64_t sum = 0;
    if (sizes < 2 || sizes != 2 + 8 * (size_t)m->entry_count)
        return igtl_fail(error, "%s: the sizes of its metadata do not fit", m->header.type);
    for (int i = 0; i < m->entry_count; i++) {
        const unsigned char *at = m->metadata + 2 + 8 * (size_t)i;
        sum += (uint64_t)igtl_get_u16(at) + igtl_get_u32(at + 4);
    }
    return sum == text ? SB_OK : igtl_fail(error, "%s: the sizes of its metadata do not fit", m->header.type);
}

static inline sb_result igtl_open_extended(igtl_message *m, const unsigned char *body, sb_error *error)
{
    uint64_t extended, sizes, text, size = m->header.body;
    if (size < IGTL_EXTENDED)
        return igtl_fail(error, "%s: the second header is cut off", m->header.type);
    extended = igtl_get_u16(body);
    sizes = igtl_get_u16(body + 2);
    text = igtl_get_u32(body + 4);
    m->message_id = igtl_get_u32(body + 8);
    if (extended < IGTL_EXTENDED || extended + sizes + text > size)
        return igtl_fail(error, "%s: the sizes in the second header do not fit", m->header.type);
    m->content = body + extended;
    m->content_size = (size_t)(size - extended - sizes - text);
    if (sizes + text == 0) /* some senders leave the count out, too */
        return SB_OK;
    m->metadata = m->content + m->content_size;
    m->entry_count = sizes < 2 ? 0 : (int)igtl_get_u16(m->metadata);
    return igtl_check_metadata(m, (size_t)sizes, (size_t)text, error);
}

/* 1 when the checksum of the body behind these bytes' header is right. */
static inline int igtl_is_intact(const igtl_crc *crc, const unsigned char *bytes, const igtl_header *header)
{
    return igtl_crc_of(crc, bytes + IGTL_HEADER, header->body) == header->crc;
}

/* Takes a whole message apart; `message` points into its bytes. A wrong checksum is an error. */
static inline sb_result igtl_open(const igtl_crc *crc, const unsigned char *bytes, size_t size, igtl_message *message,
                                  sb_error *error)
{
    igtl_message m;
    memset(&m, 0, sizeof m);
    memset(message, 0, sizeof *message);
    if (size < IGTL_HEADER)
        return igtl_fail(error, "the header is cut off");
    if (igtl_read_header(bytes, &m.header, error) != SB_OK)
        return SB_ERROR_FORMAT;
    if (m.header.body != size - IGTL_HEADER)
        return igtl_fail(error, "%s: %zu bytes in place of %zu", m.header.type, size - IGTL_HEADER, m.header.body);
    if (!igtl_is_intact(crc, bytes, &m.header))
        return igtl_fail(error, "%s: the checksum is wrong", m.header.type);
    m.content = bytes + IGTL_HEADER;
    m.content_size = m.header.body;
    if (m.header.version > 1 && igtl_open_extended(&m, bytes + IGTL_HEADER, error) != SB_OK)
        return SB_ERROR_FORMAT;
    *message = m;
    return SB_OK;
}

/* Entry `index` of the metadata, 0 <= index < entry_count. */
static inline igtl_entry igtl_get_entry(const igtl_message *m, int index)
{
    const unsigned char *text = m->metadata + 2 + 8 * (size_t)m->entry_count;
    igtl_entry entry;
    for (int i = 0;; i++) {
        const unsigned char *at = m->metadata + 2 + 8 * (size_t)i;
        entry.key_length = igtl_get_u16(at);
        entry.encoding = (int)igtl_get_u16(at + 2);
        entry.value_length = igtl_get_u32(at + 4);
        entry.key = (const char *)text;
        entry.value = entry.key + entry.key_length;
        if (i == index)
            return entry;
        text += entry.key_length + entry.value_length;
    }
}

static inline int igtl_is(const igtl_message *m, const char *type) { return strcmp(m->header.type, type) == 0; }

static inline sb_result igtl_check_size(const igtl_message *m, size_t size, sb_error *error)
{
    return m->content_size == size
               ? SB_OK
               : igtl_fail(error, "%s: %zu bytes in place of %zu", m->header.type, m->content_size, size);
}

static inline sb_result igtl_fail_number(const igtl_message *m, sb_error *error)
{
    return igtl_fail(error, "%s: a number is not finite", m->header.type);
}

/* ---- TRANSFORM and POSITION -------------------------------------------------------------------------------------- */

typedef struct igtl_transform {
    double rotation[3][3]; /* rows */
    double translation[3]; /* mm */
} igtl_transform;

/* All igtl_put_...: writes to content[], or writes nothing when it is NULL; returns the bytes. */
static inline size_t igtl_put_transform(unsigned char *content, const igtl_transform *t)
{
    if (content)
        for (int i = 0; i < 3; i++) {
            for (int k = 0; k < 3; k++)
                igtl_put_float(content + 4 * (3 * k + i), t->rotation[i][k]);
            igtl_put_float(content + 4 * (9 + i), t->translation[i]);
        }
    return 48;
}

static inline sb_result igtl_get_transform(const igtl_message *m, igtl_transform *t, sb_error *error)
{
    double values[12];
    memset(t, 0, sizeof *t);
    if (igtl_check_size(m, 48, error) != SB_OK)
        return SB_ERROR_FORMAT;
    if (!igtl_get_floats(m->content, 12, values))
        return igtl_fail_number(m, error);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            t->rotation[i][k] = values[3 * k + i];
        t->translation[i] = values[9 + i];
    }
    return SB_OK;
}

typedef struct igtl_position {
    double position[3];   /* mm */
    double quaternion[4]; /* x y z w */
} igtl_position;

static inline size_t igtl_put_position(unsigned char *content, const igtl_position *p)
{
    if (content) {
        for (int i = 0; i < 3; i++)
            igtl_put_float(content + 4 * i, p->position[i]);
        for (int i = 0; i < 4; i++)
            igtl_put_float(content + 12 + 4 * i, p->quaternion[i]);
    }
    return 28;
}

/* Also the short forms, of 12 bytes without a rotation and 24 with w left out, which then is >= 0. */
static inline sb_result igtl_get_position(const igtl_message *m, igtl_position *p, sb_error *error)
{
    double values[7] = {0, 0, 0, 0, 0, 0, 1}, rest = 1;
    memset(p, 0, sizeof *p);
    if (m->content_size != 12 && m->content_size != 24 && igtl_check_size(m, 28, error) != SB_OK)
        return SB_ERROR_FORMAT;
    if (!igtl_get_floats(m->content, m->content_size / 4, values))
        return igtl_fail_number(m, error);
    for (int i = 3; i < 6; i++)
        rest -= values[i] * values[i];
    if (m->content_size == 24)
        values[6] = rest > 0 ? sqrt(rest) : 0;
    memcpy(p->position, values, sizeof p->position);
    memcpy(p->quaternion, values + 3, sizeof p->quaternion);
    return SB_OK;
}

/* ---- POINT ------------------------------------------------------------------------------------------------------- */

typedef struct igtl_point {
    char name[65], group[33], owner[21];
    unsigned char colour[4];      /* red, green, blue, opacity */
    double position[3], diameter; /* mm */
} igtl_point;

enum { IGTL_POINT = 136 };

static inline size_t igtl_put_points(unsigned char *content, const igtl_point *points, size_t count)
{
    for (size_t i = 0; content && i < count; i++, content += IGTL_POINT) {
        igtl_put_text(content, 64, points[i].name);
        igtl_put_text(content + 64, 32, points[i].group);
        memcpy(content + 96, points[i].colour, 4);
        for (int k = 0; k < 3; k++)
            igtl_put_float(content + 100 + 4 * k, points[i].position[k]);
        igtl_put_float(content + 112, points[i].diameter);
        igtl_put_text(content + 116, 20, points[i].owner);
    }
    return IGTL_POINT * count;
}

/* How many points the message holds. */
static inline sb_result igtl_count_points(const igtl_message *m, size_t *count, sb_error *error)
{
    *count = m->content_size / IGTL_POINT;
    return igtl_check_size(m, *count * IGTL_POINT, error);
}

static inline sb_result igtl_get_point(const igtl_message *m, size_t index, igtl_point *point, sb_error *error)
{
    const unsigned char *at = m->content + IGTL_POINT * index;
    double values[4];
    igtl_get_text(at, 64, point->name);
    igtl_get_text(at + 64, 32, point->group);
    memcpy(point->colour, at + 96, 4);
    igtl_get_text(at + 116, 20, point->owner);
    if (!igtl_get_floats(at + 100, 4, values))
        return igtl_fail_number(m, error);
    memcpy(point->position, values, sizeof point->position);
    point->diameter = values[3];
    return SB_OK;
}

/* ---- STRING, STATUS, COMMAND ------------------------------------------------------------------------------------- */

/* Text within a message: it is not ended by 0. */
typedef struct igtl_text {
    const char *text;
    size_t length;
    int encoding; /* 3 ASCII, 106 UTF-8 */
} igtl_text;

static inline igtl_text igtl_text_of(const char *text)
{
    igtl_text t;
    t.text = text;
    t.length = strlen(text);
    t.encoding = 3;
    return t;
}

/* A text of at most 65,535 bytes; more is cut off. */
static inline size_t igtl_put_string(unsigned char *content, const igtl_text *t)
{
    size_t length = t->length < 65535 ? t->length : 65535;
    if (content) {
        igtl_put_u16(content, (unsigned)t->encoding);
        igtl_put_u16(content + 2, (unsigned)length);
        memcpy(content + 4, t->text, length);
    }
    return 4 + length;
}

static inline sb_result igtl_get_string(const igtl_message *m, igtl_text *t, sb_error *error)
{
    memset(t, 0, sizeof *t);
    if (m->content_size < 4)
        return igtl_fail(error, "%s: the content is cut off", m->header.type);
    t->encoding = (int)igtl_get_u16(m->content);
    t->length = igtl_get_u16(m->content + 2);
    t->text = (const char *)m->content + 4;
    return igtl_check_size(m, 4 + t->length, error);
}

enum { IGTL_STATUS_OK = 1, IGTL_STATUS_UNKNOWN = 2, IGTL_STATUS_CHECKSUM = 9, IGTL_STATUS_NOT_FOUND = 13 };

typedef struct igtl_status {
    int code; /* IGTL_STATUS_... */
    int64_t subcode;
    char name[21]; /* of the error */
    char message[256];
} igtl_status;

static inline size_t igtl_put_status(unsigned char *content, const igtl_status *s)
{
    size_t length = strlen(s->message);
    if (content) {
        igtl_put_u16(content, (unsigned)s->code);
        igtl_put_u64(content + 2, (uint64_t)s->subcode);
        igtl_put_text(content + 10, 20, s->name);
        memcpy(content + 30, s->message, length + 1);
    }
    return 30 + length + 1;
}

/* A message that is longer is cut off. */
static inline sb_result igtl_get_status(const igtl_message *m, igtl_status *s, sb_error *error)
{
    uint64_t subcode;
    size_t length;
    memset(s, 0, sizeof *s);
    if (m->content_size < 30)
        return igtl_fail(error, "%s: the content is cut off", m->header.type);
    length = m->content_size - 30;
    s->code = (int)igtl_get_u16(m->content);
    subcode = igtl_get_u64(m->content + 2);
    memcpy(&s->subcode, &subcode, sizeof subcode);
    igtl_get_text(m->content + 10, 20, s->name);
    igtl_get_text(m->content + 30, length < sizeof s->message ? length : sizeof s->message - 1, s->message);
    return SB_OK;
}

/* COMMAND and its answer RTS_COMMAND, in which the name tells the error, if there is one. */
typedef struct igtl_command {
    uint32_t id; /* the answer has the same */
    char name[129];
    igtl_text text;
} igtl_command;

static inline size_t igtl_put_command(unsigned char *content, const igtl_command *c)
{
    if (content) {
        igtl_put_u32(content, c->id);
        igtl_put_text(content + 4, 128, c->name);
        igtl_put_u16(content + 132, (unsigned)c->text.encoding);
        igtl_put_u32(content + 134, (uint32_t)c->text.length);
        memcpy(content + 138, c->text.text, c->text.length);
    }
    return 138 + c->text.length;
}

static inline sb_result igtl_get_command(const igtl_message *m, igtl_command *c, sb_error *error)
{
    memset(c, 0, sizeof *c);
    if (m->content_size < 138)
        return igtl_fail(error, "%s: the content is cut off", m->header.type);
    c->id = igtl_get_u32(m->content);
    igtl_get_text(m->content + 4, 128, c->name);
    c->text.encoding = (int)igtl_get_u16(m->content + 132);
    c->text.length = igtl_get_u32(m->content + 134);
    c->text.text = (const char *)m->content + 138;
    return c->text.length == m->content_size - 138
               ? SB_OK
               : igtl_fail(error, "%s: the length of the text does not fit", m->header.type);
}

/* CAPABILITY: the types that a program takes. */
static inline size_t igtl_put_capability(unsigned char *content, const char *const *types, size_t count)
{
    for (size_t i = 0; content && i < count; i++)
        igtl_put_text(content + 12 * i, 12, types[i]);
    return 12 * count;
}

/* ---- NDARRAY ----------------------------------------------------------------------------------------------------- */

enum { IGTL_INT32 = 6, IGTL_FLOAT32 = 10, IGTL_FLOAT64 = 11, IGTL_MAX_DIMENSIONS = 16 };

/* Numbers of one kind, the last index fastest. A side is at most 65,535 long. */
typedef struct igtl_array {
    int type; /* IGTL_INT32, IGTL_FLOAT32, IGTL_FLOAT64 */
    int dimensions;
    unsigned sizes[IGTL_MAX_DIMENSIONS];
    size_t count;               /* of all numbers; igtl_get_array counts them, igtl_put_array does not look at it */
    const unsigned char *bytes; /* of a read one: use igtl_array_number */
} igtl_array;

/* Bytes of a number, or 0 when the type is not known. */
static inline size_t igtl_array_width(int type)
{
    return type == IGTL_INT32 || type == IGTL_FLOAT32 ? 4 : type == IGTL_FLOAT64 ? 8 : 0;
}

/* The nearest int32 towards 0; the lowest of what is no number. */
static inline int32_t igtl_to_int32(double value)
{
    return value >= 2147483647.0 ? INT32_MAX : value > -2147483648.0 ? (int32_t)value : INT32_MIN;
}

static inline void igtl_put_number(unsigned char *at, int type, double value)
{
    uint64_t bits;
    if (type == IGTL_FLOAT32) {
        igtl_put_float(at, value);
    } else if (type == IGTL_INT32) {
        igtl_put_u32(at, (uint32_t)igtl_to_int32(value));
    } else {
        memcpy(&bits, &value, sizeof bits);
        igtl_put_u64(at, bits);
    }
}

/* values: as many as the sizes say. */
static inline size_t igtl_put_array(unsigned char *content, const igtl_array *a, const double *values)
{
    size_t width = igtl_array_width(a->type), head = 2 + 2 * (size_t)a->dimensions, count = 1;
    for (int i = 0; i < a->dimensions; i++)
        count *= a->sizes[i];
    if (content) {
        content[0] = (unsigned char)a->type;
        content[1] = (unsigned char)a->dimensions;
        for (int i = 0; i < a->dimensions; i++)
            igtl_put_u16(content + 2 + 2 * i, a->sizes[i]);
        for (size_t i = 0; i < count; i++)
            igtl_put_number(content + head + width * i, a->type, values[i]);
    }
    return head + width * count;
}

static inline sb_result igtl_get_array(const igtl_message *m, igtl_array *a, sb_error *error)
{
    size_t head, width;
    uint64_t count = 1;
    memset(a, 0, sizeof *a);
    if (m->content_size < 2)
        return igtl_fail(error, "%s: the content is cut off", m->header.type);
    a->type = m->content[0];
    a->dimensions = m->content[1];
    width = igtl_array_width(a->type);
    head = 2 + 2 * (size_t)a->dimensions;
    if (!width)
        return igtl_fail(error, "%s: numbers of type %d are not read", m->header.type, a->type);
    if (a->dimensions > IGTL_MAX_DIMENSIONS || a->dimensions < 1 || m->content_size < head)
        return igtl_fail(error, "%s: %d dimensions", m->header.type, a->dimensions);
    for (int i = 0; i < a->dimensions; i++) {
        a->sizes[i] = igtl_get_u16(m->content + 2 + 2 * i);
        count = a->sizes[i] && count > UINT64_MAX / 65536 ? UINT64_MAX / 65536 : count * a->sizes[i];
    }
    if (count != (m->content_size - head) / width || (m->content_size - head) % width)
        return igtl_fail(error, "%s: the sizes do not fit its bytes", m->header.type);
    a->count = (size_t)count;
    a->bytes = m->content + head;
    return SB_OK;
}

/* Number `index` of a read array; it may be not finite. */
static inline double igtl_array_number(const igtl_array *a, size_t index)
{
    const unsigned char *at = a->bytes + igtl_array_width(a->type) * index;
    uint64_t bits;
    double value;
    if (a->type == IGTL_FLOAT32)
        return igtl_get_float(at);
    if (a->type == IGTL_INT32)
        return (double)(int32_t)igtl_get_u32(at);
    bits = igtl_get_u64(at);
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* ---- POLYDATA ---------------------------------------------------------------------------------------------------- */

enum { IGTL_SCALARS = 0x00, IGTL_VECTORS = 0x01, IGTL_NORMALS = 0x02, IGTL_OF_CELLS = 0x10, IGTL_MAX_ATTRIBUTES = 32 };

/* Numbers of each point (or cell: type | IGTL_OF_CELLS). Vectors are lengths: they are turned and scaled by the space
 * that they are written in. */
typedef struct igtl_attribute {
    int type, components; /* 1 to 127; 3 of vectors and normals */
    const char *name;
    size_t count;
    const sb_real *values; /* [count][components] */
} igtl_attribute;

/* A surface of triangles as it is written. */
typedef struct igtl_surface {
    const sb_vec3 *points; /* [point_count] */
    size_t point_count;
    const int *triangles; /* [triangle_count][3] */
    size_t triangle_count;
    const igtl_attribute *attributes;
    int attribute_count;
} igtl_surface;

enum { IGTL_POLYDATA_HEADER = 40 };

static inline size_t igtl_names_size(const igtl_surface *s)
{
    size_t size = 0;
    for (int i = 0; i < s->attribute_count; i++)
        size += strlen(s->attributes[i].name) + 1;
    return size + size % 2;
}

static inline unsigned char *igtl_put_vector(unsigned char *at, sb_vec3 v)
{
    igtl_put_float(at, (double)v.x);
    igtl_put_float(at + 4, (double)v.y);
    igtl_put_float(at + 8, (double)v.z);
    return at + 12;
}

static inline unsigned char *igtl_put_values(unsigned char *at, const igtl_attribute *a, const igtl_space *space)
{
    int kind = a->type & 15;
    double factor = kind == IGTL_VECTORS ? space->scale : 1;
    if (kind == IGTL_VECTORS || kind == IGTL_NORMALS) {
        for (size_t i = 0; i < a->count; i++) {
            const sb_real *v = a->values + 3 * i;
            at = igtl_put_vector(at, igtl_turned(space, factor, sb_v3(v[0], v[1], v[2])));
        }
        return at;
    }
    for (size_t i = 0; i < a->count * (size_t)a->components; i++, at += 4)
        igtl_put_float(at, (double)a->values[i]);
    return at;
}

static inline unsigned char *igtl_put_attributes(unsigned char *at, const igtl_surface *s, const igtl_space *space)
{
    unsigned char *name = at + 6 * (size_t)s->attribute_count, *values = name + igtl_names_size(s);
    memset(name, 0, igtl_names_size(s));
    for (int i = 0; i < s->attribute_count; i++, at += 6) {
        const igtl_attribute *a = s->attributes + i;
        at[0] = (unsigned char)a->type;
        at[1] = (unsigned char)a->components;
        igtl_put_u32(at + 2, (uint32_t)a->count);
        memcpy(name, a->name, strlen(a->name) + 1);
        name += strlen(a->name) + 1;
        values = igtl_put_values(values, a, space);
    }
    return values;
}

/* points and vectors in m become those of the wire. */
static inline size_t igtl_put_surface(unsigned char *content, const igtl_surface *s, const igtl_space *space)
{
    size_t size = IGTL_POLYDATA_HEADER + 12 * s->point_count + 16 * s->triangle_count;
    unsigned char *at = content ? content + IGTL_POLYDATA_HEADER : NULL;
    size += 6 * (size_t)s->attribute_count + igtl_names_size(s);
    for (int i = 0; i < s->attribute_count; i++)
        size += 4 * s->attributes[i].count * (size_t)s->attributes[i].components;
    if (!content)
        return size;
    memset(content, 0, IGTL_POLYDATA_HEADER);
    igtl_put_u32(content, (uint32_t)s->point_count);
    igtl_put_u32(content + 20, (uint32_t)s->triangle_count);
    igtl_put_u32(content + 24, (uint32_t)(16 * s->triangle_count));
    igtl_put_u32(content + 36, (uint32_t)s->attribute_count);
    for (size_t i = 0; i < s->point_count; i++)
        at = igtl_put_vector(at, igtl_to_wire(space, s->points[i]));
    for (size_t i = 0; i < s->triangle_count; i++, at += 16) {
        igtl_put_u32(at, 3);
        for (int k = 0; k < 3; k++)
            igtl_put_u32(at + 4 + 4 * k, (uint32_t)s->triangles[3 * i + (size_t)k]);
    }
    igtl_put_attributes(at, s, space);
    return size;
}

/* Cells of one kind within a message: each a count and so many indices, u32. */
typedef struct igtl_cells {
    size_t count, bytes;
    const unsigned char *at;
} igtl_cells;

/* An attribute within a message. */
typedef struct igtl_attribute_view {
    int type, components;
    size_t count;
    const char *name;           /* ended by 0 */
    const unsigned char *bytes; /* float32 [count][components] */
} igtl_attribute_view;

/* A POLYDATA within a message. */
typedef struct igtl_polydata {
    size_t point_count;
    const unsigned char *points; /* float32 [point_count][3], all finite */
    igtl_cells vertices, lines, polygons, strips;
    igtl_attribute_view attributes[IGTL_MAX_ATTRIBUTES];
    int attribute_count;
} igtl_polydata;

/* 1 when cells fill their bytes and name only points that there are. */
static inline int igtl_are_cells_good(const igtl_cells *cells, size_t points)
{
    size_t used = 0;
    for (size_t i = 0; i < cells->count; i++) {
        size_t corners;
        if (cells->bytes - used < 4)
            return 0;
        corners = igtl_get_u32(cells->at + used);
        used += 4;
        if (corners > (cells->bytes - used) / 4)
            return 0;
        for (size_t k = 0; k < corners; k++, used += 4)
            if (igtl_get_u32(cells->at + used) >= points)
                return 0;
    }
    return used == cells->bytes;
}

/* Takes `bytes` of what is left; NULL when that is less. */
static inline const unsigned char *igtl_take(const unsigned char **at, size_t *left, uint64_t bytes)
{
    const unsigned char *taken = *at;
    if (bytes > *left)
        return NULL;
    *at += bytes;
    *left -= (size_t)bytes;
    return taken;
}

static inline sb_result igtl_get_attributes(const igtl_message *m, const unsigned char *at, size_t left,
                                            igtl_polydata *p, sb_error *error)
{
    const unsigned char *heads = igtl_take(&at, &left, 6 * (uint64_t)p->attribute_count), *name = at;
    for (int i = 0; heads && i < p->attribute_count; i++) {
        const void *end = memchr(at, 0, left);
        p->attributes[i].name = (const char *)at;
        if (!end || !igtl_take(&at, &left, (uint64_t)((const unsigned char *)end - at) + 1))
            return igtl_fail(error, "%s: the names of its attributes are cut off", m->header.type);
    }
    if (!heads || !igtl_take(&at, &left, (uint64_t)(at - name) % 2))
        return igtl_fail(error, "%s: its attributes are cut off", m->header.type);
    for (int i = 0; i < p->attribute_count; i++) {
        igtl_attribute_view *a = p->attributes + i;
        a->type = heads[6 * i];
        a->components = heads[6 * i + 1];
        a->count = igtl_get_u32(heads + 6 * i + 2);
        a->bytes = igtl_take(&at, &left, 4 * (uint64_t)a->count * (uint64_t)a->components);
        if (!a->bytes)
            return igtl_fail(error, "%s: attribute %d is cut off", m->header.type, i);
    }
    return left ? igtl_fail(error, "%s: %zu bytes too many", m->header.type, left) : SB_OK;
}

/* Cells, points and attributes are checked against the bytes and each other. p->attributes hold what they hold: look at
 * their counts, components and numbers. */
static inline sb_result igtl_get_polydata(const igtl_message *m, igtl_polydata *p, sb_error *error)
{
    igtl_cells *kinds[4];
    const unsigned char *at = m->content;
    size_t left = m->content_size;
    const unsigned char *head = igtl_take(&at, &left, IGTL_POLYDATA_HEADER);
    double point[3];
    memset(p, 0, sizeof *p);
    if (!head)
        return igtl_fail(error, "%s: the content is cut off", m->header.type);
    kinds[0] = &p->vertices, kinds[1] = &p->lines, kinds[2] = &p->polygons, kinds[3] = &p->strips;
    if (igtl_get_u32(head + 36) > IGTL_MAX_ATTRIBUTES)
        return igtl_fail(error, "%s: more than %d attributes", m->header.type, IGTL_MAX_ATTRIBUTES);
    p->point_count = igtl_get_u32(head);
    p->attribute_count = (int)igtl_get_u32(head + 36);
    p->points = igtl_take(&at, &left, 12 * (uint64_t)p->point_count);
    if (!p->points)
        return igtl_fail(error, "%s: the points are cut off", m->header.type);
    for (size_t i = 0; i < p->point_count; i++)
        if (!igtl_get_floats(p->points + 12 * i, 3, point))
            return igtl_fail(error, "%s: point %zu is not finite", m->header.type, i);
    for (int k = 0; k < 4; k++) {
        kinds[k]->count = igtl_get_u32(head + 4 + 8 * k);
        kinds[k]->bytes = igtl_get_u32(head + 8 + 8 * k);
        kinds[k]->at = igtl_take(&at, &left, kinds[k]->bytes);
        if (!kinds[k]->at || !igtl_are_cells_good(kinds[k], p->point_count))
            return igtl_fail(error, "%s: its cells do not fit", m->header.type);
    }
    return igtl_get_attributes(m, at, left, p, error);
}

/* A point of the wire, or a vector [3] of an attribute, in m. */
static inline sb_vec3 igtl_get_vector(const unsigned char *bytes, size_t index, const igtl_space *space)
{
    const unsigned char *at = bytes + 12 * index;
    return igtl_from_wire(
        space, sb_v3((sb_real)igtl_get_float(at), (sb_real)igtl_get_float(at + 4), (sb_real)igtl_get_float(at + 8)));
}

#endif /* IGTL_H */
