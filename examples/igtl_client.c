/* igtl_client: drives igtl_server over OpenIGTLink, and tells how long an answer takes.
 *
 *     igtl_client [OPTIONS]      igtl_client --help lists the options
 *
 * It presses the server's ball into the top of the organ and draws it out again, pulls at a target, asks for the
 * positions of all nodes again and again, and prints the way that the organ moved, the largest force, and the times of
 * round trips. Exit status: 0, 1 the server did not do what it was asked for, 2 wrong usage, 3 no server. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "igtl.h"
#include "igtl_socket.h"
#include "options.h"

static const char *const program_name = "igtl_client";
enum { EXIT_REFUSED = 1, EXIT_USAGE = 2, EXIT_GONE = 3, ROOM = 512 };
static const double patience = 10; /* s without what is waited for: the server is gone */

typedef struct settings {
    const char *address;
    double depth;
    int port, frames, trips, help;
} settings;

/* What the server told last. */
typedef struct client {
    igtl_link link;
    igtl_crc crc;
    int frames;
    int have_tool;
    double tool[3], low[3], high[3]; /* mm: the ball, the box of the organ's skin */
    sb_vec3 *before;                 /* [points] mm, of the first frame */
    double largest_move;             /* mm, from there */
    double largest_force;            /* N */
    size_t points;
    int short_of_memory;
    char refused[280]; /* by the last STATUS that was not good */
} client;

static int complain(const char *what, const char *why, int status)
{
    fprintf(stderr, "%s: %s%s%s\n", program_name, what, why[0] ? ": " : "", why);
    return status;
}

/* ---- what comes in ----------------------------------------------------------------------------------------------- */

/* Keeps the first frame; those after it are compared with it while they have as many points. */
static void take_organ(client *c, const igtl_polydata *p)
{
    const igtl_space wire = {1, 0};
    int first = !c->before;
    if (first) {
        c->before = (sb_vec3 *)malloc((p->point_count + 1) * sizeof *c->before);
        c->points = p->point_count;
        c->short_of_memory = !c->before;
    }
    for (size_t i = 0; i < p->point_count && c->before && p->point_count == c->points; i++) {
        sb_vec3 x = igtl_get_vector(p->points, i, &wire);
        const double place[3] = {(double)x.x, (double)x.y, (double)x.z};
        for (int k = 0; k < 3; k++) {
            c->low[k] = i == 0 || place[k] < c->low[k] ? place[k] : c->low[k];
            c->high[k] = i == 0 || place[k] > c->high[k] ? place[k] : c->high[k];
        }
        c->before[i] = first ? x : c->before[i];
        c->largest_move = fmax(c->largest_move, (double)sb_v3_norm(sb_v3_sub(x, c->before[i])));
    }
    c->frames++;
}

static void take_force(client *c, const igtl_array *a)
{
    double sum = 0;
    for (size_t i = 0; i < 3 && i < a->count; i++) {
        double part = igtl_array_number(a, i);
        sum += part * part;
    }
    c->largest_force = fmax(c->largest_force, sqrt(sum));
}

static void take(client *c, const igtl_message *m)
{
    igtl_polydata polydata;
    igtl_transform transform;
    igtl_status status;
    igtl_array array;
    sb_error error;
    if (igtl_is(m, "POLYDATA") && igtl_get_polydata(m, &polydata, &error) == SB_OK)
        take_organ(c, &polydata);
    if (igtl_is(m, "TRANSFORM") && igtl_get_transform(m, &transform, &error) == SB_OK) {
        memcpy(c->tool, transform.translation, sizeof c->tool);
        c->have_tool = 1;
    }
    if (igtl_is(m, "NDARRAY") && strcmp(m->header.device, "Force") == 0 && igtl_get_array(m, &array, &error) == SB_OK)
        take_force(c, &array);
    if (igtl_is(m, "STATUS") && igtl_get_status(m, &status, &error) == SB_OK && status.code != IGTL_STATUS_OK)
        snprintf(c->refused, sizeof c->refused, "%s: %s", status.name, status.message);
}

/* Waits for the next message, but not beyond a time; 1, or 0 when the server is gone. */
static int next_message(client *c, double end, igtl_message *message)
{
    sb_error error;
    while (seconds_now() < end) {
        int got = igtl_receive(&c->link, &c->crc, message, &error);
        if (got == 1) {
            take(c, message);
            return 1;
        }
        if (got == -2)
            return 0;
        igtl_flush(&c->link);
        igtl_wait(NULL, &c->link, 1, 0.05);
    }
    return 0;
}

/* Reads on until there are `frames` more of the organ. */
static int wait_frames(client *c, int frames)
{
    igtl_message message;
    double end = seconds_now() + patience;
    for (int last = c->frames; frames > 0;) {
        if (!next_message(c, end, &message))
            return 0;
        if (c->frames > last) {
            last = c->frames;
            frames--;
            end = seconds_now() + patience;
        }
    }
    return 1;
}

/* ---- what goes out ----------------------------------------------------------------------------------------------- */

static void send_content(client *c, const char *type, const char *device, const unsigned char *content, size_t size)
{
    unsigned char message[ROOM];
    igtl_envelope e = igtl_default_envelope(device);
    if (size)
        memcpy(igtl_content(&e, message), content, size);
    igtl_answer(&c->link, message, igtl_close(&c->crc, type, &e, size, message));
}

static void send_tool(client *c, const double place[3])
{
    unsigned char content[48];
    igtl_transform t;
    memset(&t, 0, sizeof t);
    for (int i = 0; i < 3; i++)
        t.rotation[i][i] = 1;
    memcpy(t.translation, place, sizeof t.translation);
    send_content(c, "TRANSFORM", "Tool", content, igtl_put_transform(content, &t));
}

static void send_target(client *c, const double place[3])
{
    unsigned char content[IGTL_POINT];
    igtl_point p;
    memset(&p, 0, sizeof p);
    snprintf(p.name, sizeof p.name, "tip");
    memcpy(p.position, place, sizeof p.position);
    send_content(c, "POINT", "Targets", content, igtl_put_points(content, &p, 1));
}

static void send_statement(client *c, const char *words)
{
    unsigned char content[128];
    igtl_text text = igtl_text_of(words);
    send_content(c, "STRING", "Organ", content, igtl_put_string(content, &text));
}

/* ---- the story --------------------------------------------------------------------------------------------------- */

/* Over the middle of the organ down by `depth` mm from where the ball waits, and back. */
static int press(client *c, const settings *set)
{
    double start[3], place[3];
    memcpy(start, c->tool, sizeof start);
    memcpy(place, start, sizeof place);
    for (int i = 0; i <= set->frames; i++) {
        double way = 1 - fabs(2.0 * i / set->frames - 1);
        place[2] = start[2] - way * set->depth;
        send_tool(c, place);
        if (!wait_frames(c, 1))
            return 0;
    }
    return 1;
}

/* Pulls the organ's top up beside the ball; then lets it go. */
static int pull(client *c, const settings *set)
{
    double place[3] = {(c->low[0] + 3 * c->high[0]) / 4, (c->low[1] + c->high[1]) / 2, c->high[2]};
    send_target(c, place);
    if (!wait_frames(c, 2))
        return 0;
    place[2] += set->depth;
    send_target(c, place);
    if (!wait_frames(c, set->frames / 2))
        return 0;
    send_content(c, "POINT", "Targets", NULL, 0);
    return wait_frames(c, 2);
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Times of GET_NDARRAY "Positions" until its answer; 0 when the server is gone. */
static int ask(client *c, const settings *set)
{
    double *times = (double *)malloc((size_t)set->trips * sizeof *times);
    igtl_message message;
    size_t bytes = 0;
    int good = times != NULL;
    for (int i = 0; good && i < set->trips; i++) {
        double begin = seconds_now();
        send_content(c, "GET_NDARRAY", "Positions", NULL, 0);
        do
            good = next_message(c, begin + patience, &message);
        while (good && !(igtl_is(&message, "NDARRAY") && strcmp(message.header.device, "Positions") == 0));
        times[i] = seconds_now() - begin;
        bytes = good ? message.content_size : 0;
    }
    if (good) {
        qsort(times, (size_t)set->trips, sizeof *times, compare_doubles);
        printf("round trips  %d of %.1f kB: median %.2f ms, worst %.2f ms\n", set->trips, 1e-3 * (double)bytes,
               1e3 * times[set->trips / 2], 1e3 * times[set->trips - 1]);
    }
    free(times);
    return good;
}

static int run(client *c, const settings *set)
{
    double pressed;
    if (!wait_frames(c, 2) || !c->have_tool)
        return complain("the server sends no organ", c->short_of_memory ? "out of memory" : "", EXIT_GONE);
    printf("organ        %zu points, %.0f x %.0f x %.0f mm\n", c->points, c->high[0] - c->low[0],
           c->high[1] - c->low[1], c->high[2] - c->low[2]);
    if (!press(c, set))
        return complain("the server is gone", "", EXIT_GONE);
    printf("pressed      %.0f mm down: up to %.2f N\n", set->depth, c->largest_force);
    pressed = c->largest_move;
    c->largest_move = 0;
    if (!pull(c, set))
        return complain("the server is gone", "", EXIT_GONE);
    printf("moved        %.1f mm pressed, %.1f mm pulled\n", pressed, c->largest_move);
    send_statement(c, "reset");
    if (!wait_frames(c, 2) || !ask(c, set))
        return complain("the server is gone", "", EXIT_GONE);
    return c->refused[0] ? complain("the server refused", c->refused, EXIT_REFUSED) : 0;
}

enum { OPTION_COUNT = 7 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"--port", "N", OPTION_INTEGER, &s->port, NULL, NULL, 1, 65535, "of the server"},
        {"--address", "A", OPTION_TEXT, NULL, NULL, &s->address, 0, 0, "of the server"},
        {"--frames", "N", OPTION_INTEGER, &s->frames, NULL, NULL, 2, 1e6, "of pressing, and half as many of pulling"},
        {"--depth", "MM", OPTION_NUMBER, NULL, &s->depth, NULL, 0, 1e3, "how far the ball and the target go (mm)"},
        {"--trips", "N", OPTION_INTEGER, &s->trips, NULL, NULL, 1, 1e6, "questions that are timed"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int program(int argc, char **argv)
{
    settings set = {"127.0.0.1", 60, IGTL_PORT, 60, 30, 0};
    option options[OPTION_COUNT];
    const char *why = "", *none = NULL;
    static client c; /* large */
    int status;
    list_options(&set, options);
    if (!options_parse(program_name, options, OPTION_COUNT, &none, 0, argc, argv))
        return EXIT_USAGE;
    if (set.help) {
        printf("usage: igtl_client [OPTIONS]\n\nDrives igtl_server: presses its ball into the organ, pulls at it, and "
               "times "
               "answers.\n\n");
        options_print(options, OPTION_COUNT);
        printf("\nexit status: 0 done, 1 the server refused something, 2 wrong usage, 3 no server\n");
        return 0;
    }
    if (!igtl_sockets_begin() || !igtl_connect(&c.link, set.address, set.port, &why))
        return complain("no server; is igtl_server running?", why, EXIT_GONE);
    igtl_crc_make(&c.crc);
    status = run(&c, &set);
    igtl_link_close(&c.link);
    free(c.before);
    return status;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), EXIT_USAGE); }
