/* cut_options.h: the options that the programs share that cut an organ. Include it after options.h and cut_scene.h.
 *
 *     cut_settings s = cut_settings_default("program");
 *     s.front = "lag";                           where the program has --front and --quadratic
 *     count = cut_options_add(&s, options, count, "cut apart");
 *     ... options_parse ...
 *     if (!cut_settings_check("program", &s))
 *         return ORGAN_USAGE; */
#ifndef CUT_OPTIONS_H
#define CUT_OPTIONS_H

enum { CUT_OPTION_COUNT = 11 }; /* at most */

typedef struct cut_settings {
    const char *organ, *out; /* organ NULL: one like a liver is made */
    const char *front;       /* "lag" or "glue"; NULL: the program has no such option */
    double scale;            /* of the organ file's lengths */
    double young, poisson;   /* Pa, 1 */
    double rate;             /* frames a second */
    int lattice, cells, quadratic, every, help;
    char lattice_help[96];
} cut_settings;

static inline cut_settings cut_settings_default(const char *program)
{
    cut_settings s;
    memset(&s, 0, sizeof s);
    s.out = program;
    s.scale = 1;
    s.young = 10000;
    s.poisson = 0.4;
    s.rate = 60;
    s.lattice = 2;
    s.cells = 12;
    s.every = 10;
    return s;
}

/* Adds them behind `count` options, which there is room for; done: what is done to places of a lattice. Returns how
 * many options there are then. */
static inline int cut_options_add(cut_settings *s, option *options, int count, const char *done)
{
    const option shared[] = {
        {"--lattice", "M", OPTION_INTEGER, &s->lattice, NULL, NULL, 1, 4, s->lattice_help},
        {"--rate", "HZ", OPTION_NUMBER, NULL, &s->rate, NULL, 10, 10000, "frames a second"},
        {"--every", "K", OPTION_INTEGER, &s->every, NULL, NULL, 0, 1e6,
         "every K-th frame is written as NAME_0000.vtk and so on; 0: none"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies lengths of files of organs; 0.001 for millimetres"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 4, 60, "of the organ that is made, over its width"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, 0, 0.49, "Poisson's ratio"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    const option of_blades[] = {
        {"--front", "KIND", OPTION_TEXT, NULL, NULL, &s->front, 0, 0,
         "lag: elements hold until they are cut through; glue: the cut opens with the blade"},
        {"--quadratic", NULL, OPTION_FLAG, &s->quadratic, NULL, NULL, 0, 0, "tet10 in place of tet4"},
    };
    snprintf(s->lattice_help, sizeof s->lattice_help, "places along an element's edge that are %s: 1, 2 or 4", done);
    if (s->front) {
        memcpy(options + count, of_blades, sizeof of_blades);
        count += (int)(sizeof of_blades / sizeof of_blades[0]);
    }
    memcpy(options + count, shared, sizeof shared);
    return count + (int)(sizeof shared / sizeof shared[0]);
}

/* 0, with a message, where they cannot be. */
static inline int cut_settings_check(const char *program, const cut_settings *s)
{
    if (!organ_check_name(program, "-o", s->out))
        return 0;
    if (s->lattice == 3)
        return options_complain(program, "--lattice", "needs 1, 2 or 4");
    if (s->front && strcmp(s->front, "lag") != 0 && strcmp(s->front, "glue") != 0)
        return options_complain(program, "--front", "needs lag or glue");
    return 1;
}

static inline sb_cut_front cut_settings_front(const cut_settings *s)
{
    return s->front && strcmp(s->front, "glue") == 0 ? SB_CUT_GLUE : SB_CUT_LAG;
}

#endif /* CUT_OPTIONS_H */
