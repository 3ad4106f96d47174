/* igtl_server: an organ that programs of image-guided surgery see and move over OpenIGTLink, 3D Slicer for one.
 *
 *     igtl_server [ORGAN] [OPTIONS]      igtl_server --help lists the options
 *
 * It listens on 127.0.0.1:18944, steps the organ in real time, sends each peer the deformed skin, and takes a tool,
 * targets to pull at and statements from them: the tables in igtl_organ.h and igtl_service.h. In 3D Slicer add a
 * connector of the module OpenIGTLinkIF as client; the organ appears as the model Organ. Slicer's axes are right,
 * anterior, superior, in mm; for a mesh in left, posterior, superior axes give --lps. Under Windows link with ws2_32.
 * Exit status: 0, 2 wrong usage, a file that cannot be read or a port that is taken, 3 memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "igtl.h"
#include "igtl_socket.h"
#include "options.h"
#include "organ_scene.h"

#include "igtl_organ.h"
#include "igtl_service.h"

static const char *const program_name = "igtl_server";
static const int substeps = 2;

typedef struct settings {
    const char *organ, *address;
    double scale, young, spring, radius, rate, seconds;
    int port, cells, lps, help;
} settings;

enum { OPTION_COUNT = 12 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"--port", "N", OPTION_INTEGER, &s->port, NULL, NULL, 0, 65535, "port; 0: any that is free, which is printed"},
        {"--address", "A", OPTION_TEXT, NULL, NULL, &s->address, 0, 0, "of this machine to listen on; 0.0.0.0: all"},
        {"--rate", "HZ", OPTION_NUMBER, NULL, &s->rate, NULL, 1, 1000, "frames in a second"},
        {"--seconds", "S", OPTION_NUMBER, NULL, &s->seconds, NULL, 0, 1e9, "ends by itself after so long; 0: never"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus (Pa)"},
        {"--spring", "K", OPTION_NUMBER, NULL, &s->spring, NULL, 0, 1e9, "stiffness that targets pull with (N/m)"},
        {"--radius", "M", OPTION_NUMBER, NULL, &s->radius, NULL, 0, 1e3,
         "of the ball (m); 0: a sixteenth of the organ's diagonal"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 2, 60, "of the organ that is made, along its length"},
        {"--lps", NULL, OPTION_FLAG, &s->lps, NULL, NULL, 0, 0, "the mesh has left-posterior-superior axes"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.address = "127.0.0.1";
    s.port = IGTL_PORT;
    s.scale = 1;
    s.young = 8000;
    s.spring = 50;
    s.rate = 30;
    s.cells = 10;
    return s;
}

static void print_help(void)
{
    settings s = default_settings();
    option options[OPTION_COUNT];
    list_options(&s, options);
    printf(
        "usage: igtl_server [ORGAN] [OPTIONS]\n\n"
        "Serves an organ over OpenIGTLink: POLYDATA Organ, TRANSFORM Tool and NDARRAY Force (N, N m) go out; "
        "TRANSFORM\n"
        "or POSITION Tool moves a ball that indents it, POINT Targets pulls at it, STRING or COMMAND take \"reset\",\n"
        "\"young 5000\", \"gravity 0 0 -9.81\", \"spring 20\", \"friction 0.3\". ORGAN: a volume mesh in metres; "
        "without it\n"
        "a liver-like one is made.\n\n");
    options_print(options, OPTION_COUNT);
    printf("\nexit status: 0 done, 2 wrong usage, a file that cannot be read or a port that is taken, 3 memory is "
           "short\n");
}

static int make_organ(const settings *set, igtl_organ *o)
{
    sb_error error;
    int status = 0;
    o->young = set->young;
    o->spring = set->spring;
    o->radius = set->radius;
    o->space.flip = set->lps;
    if (set->organ)
        status = organ_load(&o->scene, set->organ, set->scale);
    else if (sb_mesh_organ(SB_TET4, set->cells, NULL, &o->scene.mesh, &error) != SB_OK)
        status = organ_complain_of(&o->scene, "the organ", &error, ORGAN_FAILED);
    return status ? status : igtl_organ_make(o);
}

/* A frame: what peers ask for until its time comes, the step, what they are sent. Steps that fail are undone; peers are
 * told and go on. */
static void run_frame(igtl_service *s, double frame, double *next)
{
    double left = *next - seconds_now();
    while (left > 0) {
        igtl_service_round(s, left);
        left = *next - seconds_now();
    }
    igtl_service_round(s, 0);
    for (int i = 0; i < substeps; i++)
        if (organ_step(&s->organ->scene, frame / substeps)) {
            igtl_status status = igtl_status_of(IGTL_STATUS_UNKNOWN, "step", "a step failed and was undone");
            for (int k = 0; k < IGTL_LINKS; k++)
                igtl_service_status(s, s->links + k, &status);
        }
    igtl_service_send(s);
    *next += frame;
    if (*next < seconds_now()) /* it cannot keep up: time runs slower then */
        *next = seconds_now();
}

static int serve(const settings *set, igtl_service *s)
{
    const char *why = "";
    double begin, next, frame = 1 / set->rate;
    char words[300];
    if (!igtl_sockets_begin() || !igtl_listen(&s->listener, set->address, set->port, &why)) {
        snprintf(words, sizeof words, "%.200s:%d cannot be listened on", set->address, set->port);
        return organ_complain(&s->organ->scene, words, why, ORGAN_USAGE);
    }
    printf("organ        %d nodes, %d elements, %d triangles of skin\n", s->organ->scene.mesh.node_count,
           s->organ->scene.mesh.element_count, s->organ->skin.element_count);
    printf("listening    %s:%d, %g frames a second\n", set->address, igtl_port(&s->listener), set->rate);
    fflush(stdout);
    begin = next = seconds_now();
    while (set->seconds <= 0 || seconds_now() - begin < set->seconds)
        run_frame(s, frame, &next);
    return 0;
}

static int program(int argc, char **argv)
{
    settings set = default_settings();
    option options[OPTION_COUNT];
    igtl_organ liver = igtl_organ_default(program_name);
    igtl_service *service;
    int status;
    list_options(&set, options);
    if (!options_parse(program_name, options, OPTION_COUNT, &set.organ, 1, argc, argv))
        return ORGAN_USAGE;
    if (set.help) {
        print_help();
        return 0;
    }
    service = (igtl_service *)malloc(sizeof *service);
    status = service ? make_organ(&set, &liver) : organ_complain_memory(&liver.scene);
    if (!status) {
        igtl_service_begin(service, &liver);
        status = serve(&set, service);
        igtl_service_end(service);
    }
    igtl_organ_free(&liver);
    free(service);
    return status;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
