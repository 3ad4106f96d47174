/* bench_igtl: OpenIGTLink: packing of positions, the checksum, and round trips over the loopback, both ends in one
 * thread: a peer asks for the positions of all nodes and has checked them. For the sizes of the third thesis'
 * tables 5.3 and 5.4 (136,254 and 5,430 degrees of freedom). Prints medians and least of RUNS; asserts nothing. */
#include "../../examples/system.h"

#define SB_STATIC
#define SB_IMPLEMENTATION
#include "../../softbody.h"

#include "measure.h"

#include "../../examples/igtl.h"
#include "../../examples/igtl_socket.h"
#include "../../examples/organ_scene.h"

#include "../../examples/igtl_organ.h"
#include "../../examples/igtl_service.h"

enum { RUNS = 101 };

static igtl_service service;

static void show(const char *what, double *times)
{
    double middle = median(times, RUNS); /* sorts */
    printf("%-28s median %8.3f ms, least %8.3f ms\n", what, 1e3 * middle, 1e3 * times[0]);
}

/* Asks, and waits until the answer has come whole. */
static double trip(igtl_link *link, const igtl_crc *crc)
{
    unsigned char question[IGTL_HEADER];
    igtl_envelope e = igtl_default_envelope("Positions");
    igtl_message m;
    sb_error error;
    double begin = now();
    int got = 0;
    igtl_answer(link, question, igtl_close(crc, "GET_NDARRAY", &e, 0, question));
    while (got == 0 || (got == 1 && !igtl_is(&m, "NDARRAY"))) {
        igtl_service_round(&service, 0);
        got = igtl_receive(link, crc, &m, &error);
    }
    return got == 1 ? now() - begin : -1;
}

static int run(igtl_organ *o)
{
    static double packing[RUNS], checking[RUNS], trips[RUNS];
    const char *why = "";
    igtl_link link;
    size_t size = 0;
    uint64_t sum = 0;
    for (int i = 0; i < RUNS; i++) {
        double begin = now();
        size = igtl_organ_write_positions(o, 0);
        packing[i] = now() - begin;
        begin = now();
        sum ^= igtl_crc_of(&o->crc, o->message + IGTL_HEADER, size - IGTL_HEADER);
        checking[i] = now() - begin;
    }
    igtl_service_begin(&service, o);
    service.quiet = 1;
    if (!igtl_sockets_begin() || !igtl_listen(&service.listener, "127.0.0.1", 0, &why) ||
        !igtl_connect(&link, "127.0.0.1", igtl_port(&service.listener), &why)) {
        fprintf(stderr, "bench_igtl: no loopback: %s\n", why);
        return 1;
    }
    for (int i = 0; i < RUNS; i++)
        trips[i] = trip(&link, &o->crc);
    printf("%d degrees of freedom, %.0f kB (%016llx)\n", 3 * o->scene.mesh.node_count, 1e-3 * (double)size,
           (unsigned long long)sum);
    show("  packed, with checksum", packing);
    show("  checksum alone", checking);
    show("  there and back", trips);
    igtl_link_close(&link);
    igtl_service_end(&service);
    return 0;
}

int main(void)
{
    static const int sides[2][3] = {{33, 33, 38}, {11, 11, 12}}; /* 45,084 and 1,872 nodes */
    int status = 0;
    for (int i = 0; i < 2 && !status; i++) {
        igtl_organ o = igtl_organ_default("bench_igtl");
        const int *n = sides[i];
        status = sb_mesh_beam(SB_TET4, n[0], n[1], n[2], sb_v3(1, 1, 1), NULL, &o.scene.mesh, NULL) != SB_OK ||
                 igtl_organ_make(&o) || run(&o);
        igtl_organ_free(&o);
    }
    return status;
}
