/* igtl_socket.h: messages of igtl.h over TCP, without waiting: POSIX sockets or Winsock. Include it after system.h,
 * softbody.h and igtl.h.
 *
 *     igtl_listen(&listener, "127.0.0.1", IGTL_PORT, why)    or    igtl_connect(&link, "127.0.0.1", IGTL_PORT, why)
 *     igtl_wait(&listener, links, count, seconds);
 *     igtl_accept(&listener, &link);
 *     while ((got = igtl_receive(&link, &crc, &message, &error)) > 0)
 *         ...
 *     igtl_answer(&link, bytes, size);     arrives in any case, or the link is given up
 *     igtl_frame_begin(&link), igtl_frame_add(&link, bytes, size), igtl_frame_end(&link);
 *                                          only the newest frame waits for a peer that is slow
 *
 * A link that breaks is closed by itself: igtl_is_open. */
#ifndef IGTL_SOCKET_H
#define IGTL_SOCKET_H

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#include <winsock2.h>
#include <ws2tcpip.h>
typedef SOCKET igtl_handle;
typedef int igtl_length; /* of recv and send */
#define IGTL_NO_HANDLE INVALID_SOCKET
#define igtl_poll WSAPoll
typedef WSAPOLLFD igtl_pollfd;
#else
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
typedef int igtl_handle;
typedef size_t igtl_length; /* of recv and send */
#define IGTL_NO_HANDLE (-1)
#define igtl_poll poll
typedef struct pollfd igtl_pollfd;
#endif
#if !defined(MSG_NOSIGNAL)
#include <signal.h>
#define MSG_NOSIGNAL 0
#if !defined(_WIN32)
#define IGTL_IGNORES_SIGPIPE /* else a peer that goes ends the program */
#endif
#endif

enum {
    IGTL_LINKS = 16,
    IGTL_MAX_ANSWERS = 1 << 20, /* bytes that may wait for a peer that does not read */
    IGTL_READ = 1 << 16,        /* bytes that there is room for ahead of what came in */
    IGTL_MAX_READ = 1 << 20     /* bytes that igtl_receive reads before it lets others have their turn */
};

/* Bytes that grow. */
typedef struct igtl_bytes {
    unsigned char *data;
    size_t used, size, done; /* done: of those that are sent */
} igtl_bytes;

typedef struct igtl_link {
    igtl_handle handle;
    igtl_bytes in;      /* the message that is coming in */
    size_t handed;      /* bytes of the message that was handed out last */
    igtl_bytes answers; /* behind each other */
    igtl_bytes frame;   /* being sent, once any of it is */
    igtl_bytes newest;  /* takes its place */
    int skipped;        /* frames that a newer one replaced */
    double moved;       /* (s, of seconds_now) when bytes last went through it */
} igtl_link;

/* ---- what systems name differently ------------------------------------------------------------------------------- */

/* Once, before all else; 0 when there are no sockets. */
static inline int igtl_sockets_begin(void)
{
#if defined(_WIN32)
    WSADATA data;
    return WSAStartup(MAKEWORD(2, 2), &data) == 0;
#else
#if defined(IGTL_IGNORES_SIGPIPE)
    signal(SIGPIPE, SIG_IGN);
#endif
    return 1;
#endif
}

static inline void igtl_close_handle(igtl_handle handle)
{
#if defined(_WIN32)
    closesocket(handle);
#else
    close(handle);
#endif
}

/* The last call would have had to wait. */
static inline int igtl_would_wait(void)
{
#if defined(_WIN32)
    return WSAGetLastError() == WSAEWOULDBLOCK;
#else
    return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR;
#endif
}

static inline void igtl_never_wait(igtl_handle handle)
{
    int yes = 1;
#if defined(_WIN32)
    u_long on = 1;
    ioctlsocket(handle, FIONBIO, &on);
#else
    fcntl(handle, F_SETFL, fcntl(handle, F_GETFL, 0) | O_NONBLOCK);
#endif
    setsockopt(handle, IPPROTO_TCP, TCP_NODELAY, (const char *)&yes, sizeof yes);
}

/* A port may be listened on again at once, but not by two programs. */
static inline void igtl_share_port(igtl_handle handle)
{
    int yes = 1;
#if defined(_WIN32)
    setsockopt(handle, SOL_SOCKET, SO_EXCLUSIVEADDRUSE, (const char *)&yes, sizeof yes);
#else
    setsockopt(handle, SOL_SOCKET, SO_REUSEADDR, (const char *)&yes, sizeof yes);
#endif
}

static inline const char *igtl_why(void)
{
#if defined(_WIN32)
    static const char words[] = "Winsock refuses";
    return words;
#else
    return strerror(errno);
#endif
}

/* ---- links ------------------------------------------------------------------------------------------------------- */

static inline void igtl_link_none(igtl_link *link)
{
    memset(link, 0, sizeof *link);
    link->handle = IGTL_NO_HANDLE;
}

static inline int igtl_is_open(const igtl_link *link) { return link->handle != IGTL_NO_HANDLE; }

static inline void igtl_link_close(igtl_link *link)
{
    if (igtl_is_open(link))
        igtl_close_handle(link->handle);
    free(link->in.data);
    free(link->answers.data);
    free(link->frame.data);
    free(link->newest.data);
    igtl_link_none(link);
}

/* Room for `size` bytes in all; 0 when memory is short. */
static inline int igtl_grow(igtl_bytes *bytes, size_t size)
{
    unsigned char *grown;
    if (size <= bytes->size)
        return 1;
    size = size > 2 * bytes->size ? size : 2 * bytes->size;
    grown = (unsigned char *)realloc(bytes->data, size);
    if (!grown)
        return 0;
    bytes->data = grown;
    bytes->size = size;
    return 1;
}

/* A handle that listens (1) or is connected (0); IGTL_NO_HANDLE with the reason in *why. */
static inline igtl_handle igtl_make_handle(const char *address, int port, int listens, const char **why)
{
    struct addrinfo hints, *found = NULL;
    igtl_handle handle = IGTL_NO_HANDLE;
    char service[16];
    int bad;
    memset(&hints, 0, sizeof hints);
    hints.ai_family = AF_UNSPEC;
    hints.ai_socktype = SOCK_STREAM;
    hints.ai_flags = listens ? AI_PASSIVE : 0;
    snprintf(service, sizeof service, "%d", port);
    *why = "the address is not known";
    if (getaddrinfo(address, service, &hints, &found) != 0)
        return IGTL_NO_HANDLE;
    for (const struct addrinfo *a = found; a && handle == IGTL_NO_HANDLE; a = a->ai_next) {
        handle = socket(a->ai_family, a->ai_socktype, a->ai_protocol);
        *why = igtl_why();
        if (handle == IGTL_NO_HANDLE)
            continue;
        if (listens) {
            igtl_share_port(handle);
            bad = bind(handle, a->ai_addr, (socklen_t)a->ai_addrlen) != 0 || listen(handle, IGTL_LINKS) != 0;
        } else {
            bad = connect(handle, a->ai_addr, (socklen_t)a->ai_addrlen) != 0;
        }
        *why = igtl_why();
        if (bad) {
            igtl_close_handle(handle);
            handle = IGTL_NO_HANDLE;
        }
    }
    freeaddrinfo(found);
    if (handle != IGTL_NO_HANDLE)
        igtl_never_wait(handle);
    return handle;
}

/* Port 0: any free one, see igtl_port. Both return 1, or 0 with the reason in *why. */
static inline int igtl_listen(igtl_link *listener, const char *address, int port, const char **why)
{
    igtl_link_none(listener);
    listener->handle = igtl_make_handle(address, port, 1, why);
    return igtl_is_open(listener);
}

static inline int igtl_connect(igtl_link *link, const char *address, int port, const char **why)
{
    igtl_link_none(link);
    link->handle = igtl_make_handle(address, port, 0, why);
    return igtl_is_open(link);
}

/* The port that a listener has, or 0. */
static inline int igtl_port(const igtl_link *listener)
{
    struct sockaddr_storage name;
    struct sockaddr_in v4;
    struct sockaddr_in6 v6;
    socklen_t size = sizeof name;
    memset(&name, 0, sizeof name);
    if (getsockname(listener->handle, (struct sockaddr *)&name, &size) != 0)
        return 0;
    memcpy(&v4, &name, sizeof v4);
    memcpy(&v6, &name, sizeof v6);
    return ntohs(name.ss_family == AF_INET6 ? v6.sin6_port : v4.sin_port);
}

/* 1: a peer came, and is `link` now. */
static inline int igtl_accept(const igtl_link *listener, igtl_link *link)
{
    igtl_link_none(link);
    link->handle = accept(listener->handle, NULL, NULL);
    if (igtl_is_open(link))
        igtl_never_wait(link->handle);
    link->moved = seconds_now();
    return igtl_is_open(link);
}

/* Returns when there is something to do, or after `seconds` (a day at most). listener may be NULL. */
static inline void igtl_wait(const igtl_link *listener, const igtl_link *links, int count, double seconds)
{
    igtl_pollfd polled[IGTL_LINKS + 1];
    int used = 0;
    memset(polled, 0, sizeof polled);
    if (listener) {
        polled[used].fd = listener->handle;
        polled[used++].events = POLLIN;
    }
    for (int i = 0; i < count && used <= IGTL_LINKS; i++)
        if (igtl_is_open(links + i)) {
            int sends = links[i].answers.used > 0 || links[i].frame.used > 0;
            polled[used].fd = links[i].handle;
            polled[used++].events = (short)(sends ? POLLIN | POLLOUT : POLLIN);
        }
    seconds = seconds < 86400 ? seconds : 86400;
    igtl_poll(polled, (unsigned)used, seconds > 0 ? (int)(1e3 * seconds + 0.999) : 0);
}

/* How long (s) nothing of what is on its way to or from a peer has moved; 0: nothing is on its way. */
static inline double igtl_stalled(const igtl_link *link)
{
    int under_way = link->in.used > link->handed || link->answers.used > 0 || link->frame.used > 0;
    return igtl_is_open(link) && under_way ? seconds_now() - link->moved : 0;
}

/* ---- receiving --------------------------------------------------------------------------------------------------- */

/* Reads until `size` bytes are there: 1; 0 when no more came yet, or IGTL_MAX_READ did, -1 when the peer is gone or
 * memory is short. Room grows with what came, not with what is said to come. */
static inline int igtl_fill(igtl_link *link, size_t size)
{
    size_t most = link->in.used + IGTL_MAX_READ;
    while (link->in.used < size) {
        size_t room = link->in.used + IGTL_READ;
        long got;
        if (link->in.used >= most)
            return 0;
        if (!igtl_grow(&link->in, room < size ? room : size))
            return -1;
        room = link->in.size < size ? link->in.size : size;
        got = (long)recv(link->handle, (char *)link->in.data + link->in.used, (igtl_length)(room - link->in.used), 0);
        if (got < 0 && igtl_would_wait())
            return 0;
        if (got <= 0)
            return -1;
        link->in.used += (size_t)got;
        link->moved = seconds_now();
    }
    return 1;
}

/* The next message: 1, valid until the next call. 0: none yet. -1: one that is bad was skipped, *error says why. -2:
 * the peer is gone, or sent what cannot be skipped (error->result is SB_OK, or not), and the link is closed. */
static inline int igtl_receive(igtl_link *link, const igtl_crc *crc, igtl_message *message, sb_error *error)
{
    igtl_header header;
    int filled;
    memset(error, 0, sizeof *error);
    if (!igtl_is_open(link))
        return -2;
    if (link->handed)
        link->in.used = link->handed = 0;
    filled = igtl_fill(link, IGTL_HEADER);
    if (filled > 0 && igtl_read_header(link->in.data, &header, error) != SB_OK)
        filled = -1;
    if (filled > 0)
        filled = igtl_fill(link, IGTL_HEADER + header.body);
    if (filled < 0) {
        igtl_link_close(link);
        return -2;
    }
    if (filled == 0)
        return 0;
    link->handed = link->in.used;
    return igtl_open(crc, link->in.data, link->in.used, message, error) == SB_OK ? 1 : -1;
}

/* ---- sending ----------------------------------------------------------------------------------------------------- */

/* Sends what the system takes of it now; 0 when the link broke. */
static inline int igtl_send_some(igtl_link *link, igtl_bytes *bytes)
{
    while (bytes->done < bytes->used) {
        long sent = (long)send(link->handle, (const char *)bytes->data + bytes->done,
                               (igtl_length)(bytes->used - bytes->done), MSG_NOSIGNAL);
        if (sent < 0 && igtl_would_wait())
            return 1;
        if (sent <= 0)
            return 0;
        bytes->done += (size_t)sent;
        link->moved = seconds_now();
    }
    bytes->done = bytes->used = 0;
    return 1;
}

/* Goes on with what waits: a frame that is half sent, answers, the newest frame. Closes a link that is broken. */
static inline void igtl_flush(igtl_link *link)
{
    int good = igtl_is_open(link);
    if (good && link->frame.done > 0)
        good = igtl_send_some(link, &link->frame);
    if (good && link->frame.done == 0)
        good = igtl_send_some(link, &link->answers);
    if (good && link->frame.done == 0 && link->answers.used == 0) {
        if (link->newest.used > 0) {
            igtl_bytes old = link->frame;
            link->skipped += old.used > 0;
            old.used = 0;
            link->frame = link->newest;
            link->newest = old;
        }
        good = igtl_send_some(link, &link->frame);
    }
    if (!good)
        igtl_link_close(link);
}

/* Sends a message behind all others. A peer that leaves too many unread is given up. */
static inline void igtl_answer(igtl_link *link, const unsigned char *message, size_t size)
{
    igtl_bytes *answers = &link->answers;
    if (!igtl_is_open(link))
        return;
    if (answers->done > 0) { /* what is sent makes room */
        answers->used -= answers->done;
        memmove(answers->data, answers->data + answers->done, answers->used);
        answers->done = 0;
    }
    if (answers->used > IGTL_MAX_ANSWERS || !igtl_grow(answers, answers->used + size)) {
        igtl_link_close(link);
        return;
    }
    memcpy(answers->data + answers->used, message, size);
    answers->used += size;
    igtl_flush(link);
}

/* A frame of several messages: begin, add each, end. It is sent as soon as the last is through, unless a newer one
 * comes before. Memory that is short closes the link. */
static inline void igtl_frame_begin(igtl_link *link)
{
    link->skipped += link->newest.used > 0;
    link->newest.used = 0;
}

static inline void igtl_frame_add(igtl_link *link, const unsigned char *message, size_t size)
{
    igtl_bytes *newest = &link->newest;
    if (!igtl_is_open(link))
        return;
    if (!igtl_grow(newest, newest->used + size)) {
        igtl_link_close(link);
        return;
    }
    memcpy(newest->data + newest->used, message, size);
    newest->used += size;
}

static inline void igtl_frame_end(igtl_link *link)
{
    if (igtl_is_open(link))
        igtl_flush(link);
}

#endif /* IGTL_SOCKET_H */
