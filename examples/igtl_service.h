/* igtl_service.h: an organ of igtl_organ.h at the other end of links: who is connected, what each wants to be sent, and
 * what is answered. Include it after system.h, igtl_socket.h and igtl_organ.h.
 *
 *     igtl_service_begin(&service, &organ)
 *     igtl_listen(&service.listener, ...)
 *     igtl_service_round(&service, seconds);      waits so long at most, and does what peers ask for
 *     igtl_service_send(&service);                after each step
 *     igtl_service_end(&service)
 *
 * All are sent POLYDATA "Organ", TRANSFORM "Tool" and NDARRAY "Force" from the start. STP_POLYDATA, STP_TRANS and
 * STP_NDARRAY stop that, STT_... goes on, with NDARRAY of the device "Positions" for those of all nodes, which are off
 * at first; each is answered by RTS_... (0: done, 1: not known). GET_... sends one. GET_CAPABIL is answered by
 * CAPABILITY, COMMAND by RTS_COMMAND, all else that is wrong by STATUS.
 *
 * There are IGTL_LINKS places. A peer that comes when all are taken gets that of the one that has stalled longest, in
 * the middle of a message or of reading one, if that is longer than `patience`; else it is turned away. */
#ifndef IGTL_SERVICE_H
#define IGTL_SERVICE_H

#include <string.h>

#include "igtl_organ.h"
#include "igtl_socket.h"

/* What is sent. */
enum { IGTL_SKIN, IGTL_TOOL, IGTL_FORCE, IGTL_POSITIONS, IGTL_STREAMS };

/* What a peer may ask for in a round, before the others have their turn. */
enum { IGTL_ROUND_MESSAGES = 64, IGTL_ROUND_BYTES = 1 << 20 };

typedef struct igtl_service {
    igtl_organ *organ;
    igtl_link listener;
    igtl_link links[IGTL_LINKS];
    unsigned wanted[IGTL_LINKS]; /* streams as bits */
    double patience;             /* (s) that a peer may stall while another waits for its place */
    int quiet;                   /* 1: nothing is printed */
} igtl_service;

typedef struct igtl_stream {
    const char *type, *device; /* type behind GET_, STT_, ...; asked for without a device, or by this name */
    size_t (*write)(igtl_organ *o, uint64_t time);
} igtl_stream;

static const igtl_stream igtl_streams[IGTL_STREAMS] = {{"POLYDATA", "Organ", igtl_organ_write_skin},
                                                       {"TRANS", "Tool", igtl_organ_write_tool},
                                                       {"NDARRAY", "Force", igtl_organ_write_force},
                                                       {"NDARRAY", "Positions", igtl_organ_write_positions}};

static inline void igtl_service_begin(igtl_service *s, igtl_organ *o)
{
    memset(s, 0, sizeof *s);
    s->organ = o;
    s->patience = 5;
    igtl_link_none(&s->listener);
    for (int i = 0; i < IGTL_LINKS; i++)
        igtl_link_none(s->links + i);
}

static inline void igtl_service_end(igtl_service *s)
{
    for (int i = 0; i < IGTL_LINKS; i++)
        igtl_link_close(s->links + i);
    igtl_link_close(&s->listener);
}

static inline int igtl_service_peers(const igtl_service *s)
{
    int count = 0;
    for (int i = 0; i < IGTL_LINKS; i++)
        count += igtl_is_open(s->links + i);
    return count;
}

static inline uint64_t igtl_now(void) { return igtl_time(calendar_now()); }

/* ---- answers ----------------------------------------------------------------------------------------------------- */

/* Closes the content that `content` bytes long lies in buffer, and sends it. */
static inline void igtl_service_answer(igtl_service *s, igtl_link *link, const char *type, const igtl_envelope *e,
                                       size_t content, unsigned char *buffer)
{
    igtl_answer(link, buffer, igtl_close(&s->organ->crc, type, e, content, buffer));
}

static inline void igtl_service_status(igtl_service *s, igtl_link *link, const igtl_status *status)
{
    unsigned char buffer[IGTL_HEADER + 31 + sizeof status->message];
    igtl_envelope e = igtl_default_envelope("Organ");
    igtl_service_answer(s, link, "STATUS", &e, igtl_put_status(igtl_content(&e, buffer), status), buffer);
}

static inline void igtl_service_capability(igtl_service *s, igtl_link *link)
{
    static const char *const types[] = {"TRANSFORM",   "POSITION",     "POINT",        "STRING",       "COMMAND",
                                        "GET_CAPABIL", "GET_POLYDATA", "STT_POLYDATA", "STP_POLYDATA", "GET_TRANS",
                                        "STT_TRANS",   "STP_TRANS",    "GET_NDARRAY",  "STT_NDARRAY",  "STP_NDARRAY"};
    enum { COUNT = sizeof types / sizeof *types };
    unsigned char buffer[IGTL_HEADER + 12 * COUNT];
    igtl_envelope e = igtl_default_envelope("Organ");
    igtl_service_answer(s, link, "CAPABILITY", &e, igtl_put_capability(igtl_content(&e, buffer), types, COUNT), buffer);
}

/* In the version of the question, with its number; the name tells what was wrong. */
static inline void igtl_service_command(igtl_service *s, igtl_link *link, const igtl_message *m,
                                        const igtl_status *status)
{
    unsigned char buffer[IGTL_HEADER + IGTL_EXTENDED + 138 + sizeof status->message + 2];
    igtl_envelope e = igtl_default_envelope("Organ");
    igtl_command answer;
    memset(&answer, 0, sizeof answer);
    e.version = m->header.version;
    e.message_id = m->message_id;
    answer.id = m->content_size >= 4 ? igtl_get_u32(m->content) : 0;
    snprintf(answer.name, sizeof answer.name, "%s", status->name);
    answer.text = igtl_text_of(status->message);
    igtl_service_answer(s, link, "RTS_COMMAND", &e, igtl_put_command(igtl_content(&e, buffer), &answer), buffer);
}

static inline void igtl_service_done(igtl_service *s, igtl_link *link, const char *type, int failed)
{
    unsigned char buffer[IGTL_HEADER + 1];
    char name[24];
    igtl_envelope e = igtl_default_envelope("Organ");
    snprintf(name, sizeof name, "RTS_%s", type);
    buffer[IGTL_HEADER] = (unsigned char)failed;
    igtl_service_answer(s, link, name, &e, 1, buffer);
}

/* ---- questions --------------------------------------------------------------------------------------------------- */

/* The stream that TYPE and the device name, or -1. Without a device it is the first of the type. */
static inline int igtl_find_stream(const char *type, const char *device)
{
    for (int i = 0; i < IGTL_STREAMS; i++)
        if (strcmp(igtl_streams[i].type, type) == 0 && (!device[0] || strcmp(igtl_streams[i].device, device) == 0))
            return i;
    return -1;
}

static inline int igtl_begins_with(const igtl_message *m, const char *prefix)
{
    return strncmp(m->header.type, prefix, strlen(prefix)) == 0;
}

static inline void igtl_service_get(igtl_service *s, igtl_link *link, int stream)
{
    size_t size = igtl_streams[stream].write(s->organ, igtl_now());
    if (size)
        igtl_answer(link, s->organ->message, size);
}

/* GET_, STT_ and STP_ of a stream; 0 when the message is none. */
static inline int igtl_service_stream(igtl_service *s, int index, const igtl_message *m)
{
    igtl_link *link = s->links + index;
    const char *type = m->header.type + 4;
    int stream = strlen(m->header.type) > 4 ? igtl_find_stream(type, m->header.device) : -1;
    if (stream < 0)
        return 0;
    if (igtl_begins_with(m, "GET_")) {
        igtl_service_get(s, link, stream);
    } else if (igtl_begins_with(m, "STT_")) {
        s->wanted[index] |= 1u << stream;
        igtl_service_done(s, link, type, 0);
    } else if (igtl_begins_with(m, "STP_")) {
        s->wanted[index] &= ~(1u << stream);
        igtl_service_done(s, link, type, 0);
    } else {
        return 0;
    }
    return 1;
}

static inline void igtl_service_take(igtl_service *s, int index, const igtl_message *m)
{
    igtl_link *link = s->links + index;
    igtl_status status;
    int known;
    if (igtl_is(m, "GET_CAPABIL")) {
        igtl_service_capability(s, link);
        return;
    }
    if (igtl_service_stream(s, index, m))
        return;
    status = igtl_organ_take(s->organ, m, &known);
    if (igtl_is(m, "COMMAND"))
        igtl_service_command(s, link, m, &status);
    else if (known && (status.code != IGTL_STATUS_OK || igtl_is(m, "STRING")))
        igtl_service_status(s, link, &status);
    else if (igtl_begins_with(m, "GET_") || igtl_begins_with(m, "STT_") || igtl_begins_with(m, "STP_"))
        igtl_service_done(s, link, m->header.type + 4, 1);
}

/* Tells a peer what was wrong with its last message. */
static inline void igtl_service_refuse(igtl_service *s, igtl_link *link, const sb_error *why)
{
    igtl_status status = igtl_status_bad("message", why->message);
    igtl_header header;
    sb_error error;
    if (igtl_read_header(link->in.data, &header, &error) == SB_OK &&
        !igtl_is_intact(&s->organ->crc, link->in.data, &header))
        status.code = IGTL_STATUS_CHECKSUM;
    igtl_service_status(s, link, &status);
}

static inline void igtl_service_serve(igtl_service *s, int index)
{
    igtl_link *link = s->links + index;
    igtl_message message;
    sb_error error;
    size_t bytes = 0;
    int got = 0;
    igtl_flush(link);
    for (int count = 0; count < IGTL_ROUND_MESSAGES && bytes < IGTL_ROUND_BYTES; count++, bytes += link->handed) {
        got = igtl_receive(link, &s->organ->crc, &message, &error);
        if (got == 1) {
            igtl_service_take(s, index, &message);
        } else if (got == -1) {
            igtl_service_refuse(s, link, &error);
        } else {
            break;
        }
    }
    if (got == -2 && !s->quiet)
        fprintf(stderr, "%s: peer %d is gone%s%s\n", s->organ->scene.program, index + 1, error.message[0] ? ": " : "",
                error.message);
}

/* A place for a peer that came; -1: there is none. */
static inline int igtl_service_place(igtl_service *s)
{
    int slowest = 0;
    for (int i = 0; i < IGTL_LINKS; i++) {
        if (!igtl_is_open(s->links + i))
            return i;
        if (igtl_stalled(s->links + i) > igtl_stalled(s->links + slowest))
            slowest = i;
    }
    if (!(igtl_stalled(s->links + slowest) > s->patience))
        return -1;
    igtl_link_close(s->links + slowest);
    if (!s->quiet)
        fprintf(stderr, "%s: peer %d stalled\n", s->organ->scene.program, slowest + 1);
    return slowest;
}

/* Waits for `seconds` at most, then lets peers in and does what they ask for. */
static inline void igtl_service_round(igtl_service *s, double seconds)
{
    igtl_link link;
    igtl_wait(&s->listener, s->links, IGTL_LINKS, seconds);
    while (igtl_accept(&s->listener, &link)) {
        int place = igtl_service_place(s);
        if (place < 0) {
            igtl_link_close(&link);
            continue;
        }
        s->links[place] = link;
        s->wanted[place] = 1u << IGTL_SKIN | 1u << IGTL_TOOL | 1u << IGTL_FORCE;
        if (!s->quiet)
            fprintf(stderr, "%s: peer %d\n", s->organ->scene.program, place + 1);
    }
    for (int i = 0; i < IGTL_LINKS; i++)
        if (igtl_is_open(s->links + i))
            igtl_service_serve(s, i);
}

/* Sends to each what it wants: written once for all. */
static inline void igtl_service_send(igtl_service *s)
{
    uint64_t now = igtl_now();
    unsigned wanted = 0;
    for (int i = 0; i < IGTL_LINKS; i++)
        if (igtl_is_open(s->links + i)) {
            igtl_frame_begin(s->links + i);
            wanted |= s->wanted[i];
        }
    for (int stream = 0; stream < IGTL_STREAMS; stream++) {
        size_t size = wanted >> stream & 1 ? igtl_streams[stream].write(s->organ, now) : 0;
        for (int i = 0; size && i < IGTL_LINKS; i++)
            if (igtl_is_open(s->links + i) && s->wanted[i] >> stream & 1)
                igtl_frame_add(s->links + i, s->organ->message, size);
    }
    for (int i = 0; i < IGTL_LINKS; i++)
        igtl_frame_end(s->links + i);
}

#endif /* IGTL_SERVICE_H */
