/* case_reader: reads a case file and everything it names, and makes the body it describes. Shared by
 * case_solve.c and the tests. A case is checked whole before anything is solved:
 *
 *     text --case_parse--> statements --case_load--> mesh, node lists, loads --case_create_body--> sb_body
 *
 * What a statement may look like stands in two tables, case_keys (the options) and case_forms (the
 * statements). Include softbody.h first. */
#ifndef CASE_READER_H
#define CASE_READER_H

#include <errno.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- what a case file may hold ------------------------------------------------------------------------- */

/* Options as bits, see CASE_BIT. */
typedef unsigned long long case_bits;

/* What the value of an option, or a word, must be. */
typedef enum case_type {
    CASE_TYPE_PATH,         /* a file to read, relative to the case file */
    CASE_TYPE_VECTOR,       /* X,Y,Z */
    CASE_TYPE_SIX,          /* six numbers: two corners, or a point and a normal */
    CASE_TYPE_NUMBER,       /* any finite number */
    CASE_TYPE_POSITIVE,     /* a number > 0 */
    CASE_TYPE_STEP,         /* a number > 0, or `auto`, which is stored as 0 */
    CASE_TYPE_NOT_NEGATIVE, /* a number >= 0 */
    CASE_TYPE_FRACTION,     /* a number in (0, 1) */
    CASE_TYPE_POISSON,      /* a number in (-1, 0.5) */
    CASE_TYPE_COUNT,        /* an integer >= 1 */
    CASE_TYPE_LATTICE,      /* 1, 2 or 4 */
    CASE_TYPE_INTEGER       /* any integer */
} case_type;

/* Options, key=value. Keys of the same name are for different statements. */
typedef enum case_key {
    CASE_NODES,
    CASE_FACES,
    CASE_FILE,
    CASE_VALUE,
    CASE_RAMP,
    CASE_E,
    CASE_NU,
    CASE_C10,
    CASE_C01,
    CASE_C20,
    CASE_C30,
    CASE_D1,
    CASE_DENSITY,
    CASE_REGION,
    CASE_STEPS,
    CASE_TOL,
    CASE_ITERATIONS,
    CASE_DT,
    CASE_END,
    CASE_ALPHA,
    CASE_BETA,
    CASE_NEWTON,
    CASE_COUNT,
    CASE_PRESSURE_VALUE,
    CASE_CENTRAL_DT,
    CASE_LATTICE,
    CASE_BOX,
    CASE_PLANE,
    CASE_NEAR,
    CASE_DISTANCE,
    CASE_WITHIN,
    CASE_SCALE,
    CASE_CELLS,
    CASE_ELEMENTS,
    CASE_KEY_COUNT
} case_key;

typedef struct case_key_rule {
    const char *name;
    case_type type;
} case_key_rule;

static const case_key_rule case_keys[CASE_KEY_COUNT] = {
    {"nodes", CASE_TYPE_PATH},       {"faces", CASE_TYPE_PATH},         {"file", CASE_TYPE_PATH},
    {"value", CASE_TYPE_VECTOR},     {"ramp", CASE_TYPE_NOT_NEGATIVE},  {"E", CASE_TYPE_POSITIVE},
    {"nu", CASE_TYPE_POISSON},       {"C10", CASE_TYPE_NUMBER},         {"C01", CASE_TYPE_NUMBER},
    {"C20", CASE_TYPE_NUMBER},       {"C30", CASE_TYPE_NUMBER},         {"D1", CASE_TYPE_POSITIVE},
    {"density", CASE_TYPE_POSITIVE}, {"region", CASE_TYPE_INTEGER},     {"steps", CASE_TYPE_COUNT},
    {"tol", CASE_TYPE_FRACTION},     {"iterations", CASE_TYPE_COUNT},   {"dt", CASE_TYPE_POSITIVE},
    {"end", CASE_TYPE_POSITIVE},     {"alpha", CASE_TYPE_NOT_NEGATIVE}, {"beta", CASE_TYPE_NOT_NEGATIVE},
    {"newton", CASE_TYPE_COUNT},     {"count", CASE_TYPE_COUNT},        {"value", CASE_TYPE_NUMBER},
    {"dt", CASE_TYPE_STEP},          {"lattice", CASE_TYPE_LATTICE},    {"box", CASE_TYPE_SIX},
    {"plane", CASE_TYPE_SIX},        {"near", CASE_TYPE_PATH},          {"distance", CASE_TYPE_POSITIVE},
    {"tol", CASE_TYPE_POSITIVE},     {"scale", CASE_TYPE_POSITIVE},     {"cells", CASE_TYPE_COUNT},
    {"elements", CASE_TYPE_PATH},
};

typedef enum case_kind {
    CASE_MESH,
    CASE_SURFACE,
    CASE_STUFF,
    CASE_SELECT,
    CASE_ELEMENT,
    CASE_MATERIAL,
    CASE_GRAVITY,
    CASE_FIX,
    CASE_PRESCRIBE,
    CASE_FORCE,
    CASE_TRACTION,
    CASE_PRESSURE,
    CASE_SPRING,
    CASE_EQUATION,
    CASE_TIE,
    CASE_CUT,
    CASE_SOLVE,
    CASE_OUTPUT,
    CASE_EXPECT
} case_kind;

/* Codes of the solves that are no time integration; the others have that of an sb_integrator, which is > 0. */
enum { CASE_STATIC = 0, CASE_MODES = -1 };
enum { CASE_OUTPUT_DISPLACEMENT, CASE_OUTPUT_REACTION, CASE_OUTPUT_STRESS, CASE_OUTPUT_PROBE, CASE_OUTPUT_FREQUENCIES };

/* What `select` picks. */
enum { CASE_SELECT_NODES, CASE_SELECT_ELEMENTS, CASE_SELECT_FACES };

enum { CASE_CUT_PLANE, CASE_CUT_POLYGON, CASE_CUT_SURFACE, CASE_CUT_BALL };

/* One way to write a statement. Forms with the same keyword and variant differ in their options only. */
typedef struct case_form {
    const char *keyword;
    const char *variant; /* the second word, or NULL: there is none */
    const char *words;   /* further words: f FILE, s NAME of a selection, e NAME of an element, a AXES, n number,
                          * i NODE */
    case_bits required, optional; /* keys as bits */
    case_kind kind;
    int code; /* of a material, element, solve or output */
    int once; /* 1: at most one such keyword in a file */
} case_form;

#define CASE_BIT(key) (1ull << (key))
#define CASE_HOOKE (CASE_BIT(CASE_E) | CASE_BIT(CASE_NU) | CASE_BIT(CASE_DENSITY))
#define CASE_ISOCHORIC (CASE_BIT(CASE_C10) | CASE_BIT(CASE_D1) | CASE_BIT(CASE_DENSITY))
#define CASE_IN_REGION (CASE_BIT(CASE_REGION) | CASE_BIT(CASE_ELEMENTS))
#define CASE_MOONEY (CASE_ISOCHORIC | CASE_BIT(CASE_C01))
#define CASE_POLYNOMIAL (CASE_ISOCHORIC | CASE_BIT(CASE_C20))
#define CASE_NODES_VALUE (CASE_BIT(CASE_NODES) | CASE_BIT(CASE_VALUE))
#define CASE_NEAR_FILE (CASE_BIT(CASE_NEAR) | CASE_BIT(CASE_DISTANCE))
#define CASE_TIMES (CASE_BIT(CASE_DT) | CASE_BIT(CASE_END))
#define CASE_DAMPED (CASE_BIT(CASE_TOL) | CASE_BIT(CASE_ALPHA) | CASE_BIT(CASE_BETA))

static const case_form case_forms[] = {
    {"mesh", NULL, "f", 0, 0, CASE_MESH, 0, 1},
    {"surface", NULL, "f", 0, CASE_BIT(CASE_SCALE), CASE_SURFACE, 0, 1},
    {"stuff", NULL, "", CASE_BIT(CASE_CELLS), 0, CASE_STUFF, 0, 1},
    {"select", "nodes", "s", CASE_BIT(CASE_BOX), 0, CASE_SELECT, CASE_SELECT_NODES, 0},
    {"select", "nodes", "s", CASE_BIT(CASE_PLANE), CASE_BIT(CASE_DISTANCE), CASE_SELECT, CASE_SELECT_NODES, 0},
    {"select", "nodes", "s", CASE_NEAR_FILE, 0, CASE_SELECT, CASE_SELECT_NODES, 0},
    {"select", "elements", "s", CASE_BIT(CASE_BOX), 0, CASE_SELECT, CASE_SELECT_ELEMENTS, 0},
    {"select", "elements", "s", CASE_NEAR_FILE, 0, CASE_SELECT, CASE_SELECT_ELEMENTS, 0},
    {"select", "faces", "s", CASE_BIT(CASE_BOX), 0, CASE_SELECT, CASE_SELECT_FACES, 0},
    {"select", "faces", "s", CASE_BIT(CASE_PLANE), CASE_BIT(CASE_DISTANCE), CASE_SELECT, CASE_SELECT_FACES, 0},
    {"select", "faces", "s", CASE_NEAR_FILE, 0, CASE_SELECT, CASE_SELECT_FACES, 0},
    {"element", NULL, "e", 0, 0, CASE_ELEMENT, 0, 1},
    {"material", "linear", "", CASE_HOOKE, CASE_IN_REGION, CASE_MATERIAL, SB_LINEAR, 0},
    {"material", "corotated", "", CASE_HOOKE, CASE_IN_REGION, CASE_MATERIAL, SB_COROTATED, 0},
    {"material", "corotated_invertible", "", CASE_HOOKE, CASE_IN_REGION, CASE_MATERIAL, SB_COROTATED_INVERTIBLE, 0},
    {"material", "svk", "", CASE_HOOKE, CASE_IN_REGION, CASE_MATERIAL, SB_SVK, 0},
    {"material", "neo_hookean", "", CASE_HOOKE, CASE_IN_REGION, CASE_MATERIAL, SB_NEO_HOOKEAN, 0},
    {"material", "neo_hookean", "", CASE_ISOCHORIC, CASE_IN_REGION, CASE_MATERIAL, SB_NEO_HOOKEAN_ISOCHORIC, 0},
    {"material", "stable_neo_hookean", "", CASE_HOOKE, CASE_IN_REGION, CASE_MATERIAL, SB_STABLE_NEO_HOOKEAN, 0},
    {"material", "mooney_rivlin", "", CASE_MOONEY, CASE_IN_REGION, CASE_MATERIAL, SB_MOONEY_RIVLIN, 0},
    {"material", "reduced_polynomial", "", CASE_POLYNOMIAL, CASE_IN_REGION | CASE_BIT(CASE_C30), CASE_MATERIAL,
     SB_REDUCED_POLYNOMIAL, 0},
    {"gravity", NULL, "nnn", 0, 0, CASE_GRAVITY, 0, 1},
    {"fix", NULL, "a", CASE_BIT(CASE_NODES), 0, CASE_FIX, 0, 0},
    {"prescribe", NULL, "a", CASE_NODES_VALUE, CASE_BIT(CASE_RAMP), CASE_PRESCRIBE, 0, 0},
    {"prescribe", NULL, "a", CASE_BIT(CASE_FILE), CASE_BIT(CASE_RAMP), CASE_PRESCRIBE, 0, 0},
    {"force", NULL, "", CASE_NODES_VALUE, 0, CASE_FORCE, 0, 0},
    {"force", NULL, "", CASE_BIT(CASE_FILE), 0, CASE_FORCE, 0, 0},
    {"traction", NULL, "", CASE_BIT(CASE_FACES) | CASE_BIT(CASE_VALUE), 0, CASE_TRACTION, 0, 0},
    {"pressure", NULL, "", CASE_BIT(CASE_FACES) | CASE_BIT(CASE_PRESSURE_VALUE), 0, CASE_PRESSURE, 0, 0},
    {"spring", NULL, "", CASE_BIT(CASE_FILE), 0, CASE_SPRING, 0, 0},
    {"equation", NULL, "", CASE_BIT(CASE_FILE), 0, CASE_EQUATION, 0, 0},
    {"tie", NULL, "", CASE_BIT(CASE_NODES) | CASE_BIT(CASE_FACES), CASE_BIT(CASE_DISTANCE), CASE_TIE, 0, 0},
    {"cut", "plane", "nnnnnn", 0, CASE_BIT(CASE_LATTICE), CASE_CUT, CASE_CUT_PLANE, 0},
    {"cut", "polygon", "", CASE_BIT(CASE_FILE), CASE_BIT(CASE_LATTICE), CASE_CUT, CASE_CUT_POLYGON, 0},
    {"cut", "surface", "", CASE_BIT(CASE_FILE), CASE_BIT(CASE_LATTICE), CASE_CUT, CASE_CUT_SURFACE, 0},
    {"ablate", NULL, "nnnn", 0, CASE_BIT(CASE_LATTICE), CASE_CUT, CASE_CUT_BALL, 0},
    {"solve", "static", "", CASE_BIT(CASE_STEPS) | CASE_BIT(CASE_TOL), CASE_BIT(CASE_ITERATIONS), CASE_SOLVE,
     CASE_STATIC, 1},
    {"solve", "euler", "", CASE_TIMES, CASE_DAMPED, CASE_SOLVE, SB_EULER, 1},
    {"solve", "newmark", "", CASE_TIMES, CASE_DAMPED | CASE_BIT(CASE_NEWTON), CASE_SOLVE, SB_NEWMARK, 1},
    {"solve", "central", "", CASE_BIT(CASE_CENTRAL_DT) | CASE_BIT(CASE_END), CASE_BIT(CASE_ALPHA), CASE_SOLVE,
     SB_CENTRAL_DIFFERENCE, 1},
    {"solve", "modes", "", CASE_BIT(CASE_COUNT), 0, CASE_SOLVE, CASE_MODES, 1},
    {"output", "displacement", "f", 0, 0, CASE_OUTPUT, CASE_OUTPUT_DISPLACEMENT, 0},
    {"output", "reaction", "f", 0, 0, CASE_OUTPUT, CASE_OUTPUT_REACTION, 0},
    {"output", "stress", "f", 0, 0, CASE_OUTPUT, CASE_OUTPUT_STRESS, 0},
    {"output", "probe", "if", 0, 0, CASE_OUTPUT, CASE_OUTPUT_PROBE, 0},
    {"output", "frequencies", "f", 0, 0, CASE_OUTPUT, CASE_OUTPUT_FREQUENCIES, 0},
    {"expect", "probe", "i", CASE_BIT(CASE_VALUE) | CASE_BIT(CASE_WITHIN), 0, CASE_EXPECT, 0, 0},
};
enum { CASE_FORM_COUNT = (int)(sizeof case_forms / sizeof case_forms[0]) };

/* What `element NAME` may say. */
typedef struct case_treatment {
    const char *name;
    sb_element_type type; /* that the mesh must have */
    int single_rotation;
    sb_integration integration;
} case_treatment;

static const case_treatment case_treatments[] = {
    {"tet4", SB_TET4, 0, SB_INTEGRATION_AUTO},       {"tet10", SB_TET10, 0, SB_INTEGRATION_AUTO},
    {"tet10sr", SB_TET10, 1, SB_INTEGRATION_AUTO},   {"hex8", SB_HEX8, 0, SB_INTEGRATION_AUTO},
    {"hex20", SB_HEX20, 0, SB_INTEGRATION_AUTO},     {"hex27", SB_HEX27, 0, SB_INTEGRATION_AUTO},
    {"tet10bbar", SB_TET10, 0, SB_INTEGRATION_BBAR}, {"hex8bbar", SB_HEX8, 0, SB_INTEGRATION_BBAR},
    {"hex20bbar", SB_HEX20, 0, SB_INTEGRATION_BBAR}, {"hex27bbar", SB_HEX27, 0, SB_INTEGRATION_BBAR},
    {"tet4patch", SB_TET4, 0, SB_INTEGRATION_PATCH},
};
enum { CASE_TREATMENT_COUNT = (int)(sizeof case_treatments / sizeof case_treatments[0]) };

/* ---- a case in memory ---------------------------------------------------------------------------------- */

/* A statement with what its files hold. Text points into the case file. */
typedef struct case_statement {
    int line;
    const case_form *form;
    const case_treatment *treatment; /* element */
    const char *path;                /* word FILE */
    int axes;                        /* word AXES, as SB_X | SB_Y | SB_Z */
    int node;                        /* word NODE */
    int number_count;
    double numbers[6]; /* number words */
    case_bits given;   /* options, as bits */
    const char *text[CASE_KEY_COUNT];
    double number[CASE_KEY_COUNT];
    sb_vec3 vector;              /* option value */
    unsigned prony_g, prony_tau; /* given relaxation terms, as bits */
    sb_real g[SB_MAX_PRONY_TERMS], tau[SB_MAX_PRONY_TERMS];

    int count; /* nodes, faces or corners of triangles */
    int capacity;
    int *nodes;         /* [count] */
    sb_vec3 *vectors;   /* [count] displacement (m), force (N) or spring point (m) of each node; corners (m) of what
                         * cuts, three for each triangle */
    sb_real *stiffness; /* [count] of springs (N/m) */
    sb_vec3 *scaled;    /* [count] scratch: vectors times the ramp's share */
    int *faces;         /* [count][corners of a face] */
    sb_real *values;    /* [count] right-hand sides (m) of equations */
    int *term_counts;   /* [count] */
    sb_constraint_term *terms; /* [term_count] of all equations, one after the other; the first of each is the slave */
    int term_count, term_capacity;
    int tied_count; /* of `nodes` of a tie, whose `count` is of its faces */
} case_statement;

/* Messages, one a line, each with the file and line it is about. */
typedef struct case_messages {
    char *text; /* NULL: none */
    int count, size, capacity;
} case_messages;

/* A case. case_read fills it; `mass` may be changed before case_create_body. */
typedef struct case_file {
    char *path;
    char *text; /* the file, cut into words */
    int line_count;
    case_statement *statements;
    int statement_count, statement_capacity;
    const case_statement *mesh_statement, *solve;      /* always there */
    const case_statement *element, *gravity, *surface; /* or NULL */

    sb_mesh mesh;
    sb_load_report mesh_report;   /* what loading it did */
    sb_index_lists node_elements; /* of the mesh; made when faces are looked up */
    sb_region_material *region_materials;
    int region_material_count; /* 0: the one material has no region */
    sb_material material;
    unsigned char *supports; /* [node_count] axes that statements support */

    int lattice; /* of cuts; 0: there are none */
    sb_cut *cut; /* of the body made last; or NULL */
    int crumbs;  /* that its cuts left, and that are held */

    int mass; /* an sb_mass_kind, or -1 (unless changed): what suits the solve, see case_mass */

    char **kept; /* [kept_count] texts of the case's own that statements point to */
    int kept_count, kept_capacity;
    int *node_numbers;    /* [node_count] what outputs call the nodes; NULL: their places, from 0 */
    int *element_numbers; /* [element_count] likewise */

    case_messages faults; /* all of them, where a format has them listed; `message` is then the first */
    case_messages notes;  /* what was taken otherwise than it stands there, or left out */
    int error_line;       /* line of the case file that `message` is about */
    char message[1024];
} case_file;

/* ---- errors and memory --------------------------------------------------------------------------------- */

#if defined(__GNUC__)
#define CASE_PRINTF __attribute__((format(printf, 3, 4)))
#else
#define CASE_PRINTF
#endif

/* Says what is wrong in which line; returns 0. */
CASE_PRINTF static inline int case_fail(case_file *c, int line, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(c->message, sizeof c->message, format, arguments);
    va_end(arguments);
    c->error_line = line;
    return 0;
}

/* Says what the library found wrong, with the file and line it names, or the node by its number in the file; returns
 * 0. */
static inline int case_fail_library(case_file *c, int line, const sb_error *error)
{
    const char *later = error->result == SB_ERROR_UNSUPPORTED ? " (not supported by this version)" : "";
    if (c->node_numbers && error->node >= 0 && error->node < c->mesh.node_count)
        return case_fail(c, line, "node %d of the file: %s (counted from 0)", c->node_numbers[error->node],
                         error->message);
    if (error->line > 0)
        return case_fail(c, line, "%s:%d: %s%s", error->file, error->line, error->message, later);
    return case_fail(c, line, "%s%s%s%s", error->file, error->file[0] ? ": " : "", error->message, later);
}

static inline int case_fail_memory(case_file *c, int line) { return case_fail(c, line, "out of memory"); }

/* Makes room for one more item of `size` bytes; 0 when there is none. */
static inline int case_reserve(void **items, int count, int *capacity, size_t size)
{
    int larger = *capacity < 16 ? 16 : *capacity;
    void *grown;
    if (count < *capacity)
        return 1;
    if (*capacity >= 16)
        larger = *capacity > INT_MAX / 2 ? INT_MAX : 2 * *capacity;
    if (count >= larger || (size_t)larger > (size_t)-1 / size)
        return 0;
    grown = realloc(*items, (size_t)larger * size);
    if (!grown)
        return 0;
    *items = grown;
    *capacity = larger;
    return 1;
}

/* A copy of a text that lives as long as the case; NULL when memory is short. */
static inline const char *case_keep(case_file *c, const char *text)
{
    size_t size = strlen(text) + 1;
    void *items = c->kept;
    char *copy;
    if (!case_reserve(&items, c->kept_count, &c->kept_capacity, sizeof *c->kept))
        return NULL;
    c->kept = (char **)items;
    copy = (char *)malloc(size);
    if (!copy)
        return NULL;
    c->kept[c->kept_count++] = copy;
    return (const char *)memcpy(copy, text, size);
}

/* Adds a line `path:line: words`; forgotten where memory is short. */
static inline void case_add_message(case_messages *m, const char *path, int line, const char *words)
{
    int length = snprintf(NULL, 0, "%s:%d: %s\n", path, line, words);
    while (length > 0 && m->capacity - m->size <= length) {
        void *text = m->text;
        int capacity = m->capacity;
        if (!case_reserve(&text, capacity, &capacity, 1))
            return;
        m->text = (char *)text;
        m->capacity = capacity;
    }
    snprintf(m->text + m->size, (size_t)length + 1, "%s:%d: %s\n", path, line, words);
    m->size += length;
    m->count++;
}

static inline void case_free_statement(case_statement *s)
{
    free(s->nodes);
    free(s->vectors);
    free(s->stiffness);
    free(s->scaled);
    free(s->faces);
    free(s->values);
    free(s->term_counts);
    free(s->terms);
}

/* Releases a case; safe on one that case_read refused. */
static inline void case_free(case_file *c)
{
    for (int i = 0; i < c->statement_count; i++)
        case_free_statement(c->statements + i);
    sb_cut_destroy(c->cut);
    free(c->statements);
    free(c->region_materials);
    free(c->supports);
    for (int i = 0; i < c->kept_count; i++)
        free(c->kept[i]);
    free(c->kept);
    free(c->node_numbers);
    free(c->element_numbers);
    free(c->faults.text);
    free(c->notes.text);
    free(c->text);
    free(c->path);
    sb_index_lists_free(&c->node_elements);
    sb_mesh_free(&c->mesh);
    memset(c, 0, sizeof *c);
}

/* ---- text ---------------------------------------------------------------------------------------------- */

/* The whole file as a string of the caller, or NULL with why in *reason. */
static inline char *case_read_text(const char *path, const char **reason)
{
    FILE *file = fopen(path, "rb");
    char *text = NULL, *larger;
    size_t used = 0, size = 0, got = 1;
    *reason = strerror(errno);
    if (!file)
        return NULL;
    while (got > 0) {
        if (size - used < 4096) {
            size = 2 * size + 8192;
            larger = (char *)realloc(text, size);
            if (!larger)
                break;
            text = larger;
        }
        got = fread(text + used, 1, size - used - 1, file);
        used += got;
    }
    *reason = got > 0 ? "out of memory" : ferror(file) ? "it cannot be read" : NULL;
    fclose(file);
    if (!*reason) {
        text[used] = 0;
        if (memchr(text, 0, used))
            *reason = "it is not a text file";
    }
    if (*reason) {
        free(text);
        return NULL;
    }
    if (strncmp(text, "\xef\xbb\xbf", 3) == 0) /* the byte order mark that some editors put before UTF-8 */
        memset(text, ' ', 3);
    return text;
}

/* Cuts the next line off *cursor and its comment off the line; NULL at the end. */
static inline char *case_next_line(char **cursor)
{
    char *line = *cursor, *end;
    if (!*line)
        return NULL;
    end = line + strcspn(line, "\n");
    *cursor = *end ? end + 1 : end;
    *end = 0;
    line[strcspn(line, "#")] = 0;
    return line;
}

/* Cuts the next word off *cursor; NULL at the end of the line. */
static inline char *case_next_word(char **cursor)
{
    char *word = *cursor + strspn(*cursor, " \t\r"), *end;
    if (!*word)
        return NULL;
    end = word + strcspn(word, " \t\r");
    *cursor = *end ? end + 1 : end;
    *end = 0;
    return word;
}

/* A decimal number that is finite as an sb_real, and nothing else; 1 or 0. */
static inline int case_scan_number(const char *word, double *value)
{
    char *end;
    double number;
    if (!*word || word[strspn(word, "0123456789+-.eE")])
        return 0;
    number = strtod(word, &end);
    if (*end || !sb_is_finite((sb_real)number))
        return 0;
    *value = number;
    return 1;
}

/* A decimal integer that fits int, and nothing else; 1 or 0. */
static inline int case_scan_integer(const char *word, int *value)
{
    char *end;
    long number;
    if (!*word || word[strspn(word, "0123456789+-")])
        return 0;
    errno = 0;
    number = strtol(word, &end, 10);
    if (*end || errno || number < INT_MIN || number > INT_MAX)
        return 0;
    *value = (int)number;
    return 1;
}

/* `count` numbers with commas between them. */
static inline int case_scan_numbers(char *word, double *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        char *comma = strchr(word, ',');
        if ((comma != NULL) != (i < count - 1))
            return 0;
        if (comma)
            *comma = 0;
        if (!case_scan_number(word, numbers + i))
            return 0;
        word = comma ? comma + 1 : word;
    }
    return 1;
}

/* X,Y,Z */
static inline int case_scan_vector(char *word, sb_vec3 *value)
{
    double parts[3];
    if (!case_scan_numbers(word, parts, 3))
        return 0;
    *value = sb_v3((sb_real)parts[0], (sb_real)parts[1], (sb_real)parts[2]);
    return 1;
}

/* Letters among x y z, each once, as bits; 0 when it is anything else. */
static inline int case_scan_axes(const char *word)
{
    static const char letters[] = "xyz";
    int axes = 0;
    for (; *word; word++) {
        const char *letter = strchr(letters, *word);
        int bit = letter ? 1 << (letter - letters) : 0;
        if (!bit || (axes & bit))
            return 0;
        axes |= bit;
    }
    return axes;
}

/* ---- parsing: words and options ------------------------------------------------------------------------ */

static inline const char *case_word_name(char word)
{
    switch (word) {
    case 'f': return "FILE";
    case 's':
    case 'e': return "NAME";
    case 'a': return "AXES";
    case 'i': return "NODE";
    default: return "NUMBER";
    }
}

/* How a statement is written, e.g. `fix AXES nodes=`, appended to c->message. */
static inline void case_append_usage(case_file *c, const case_form *form)
{
    char *at = c->message + strlen(c->message);
    size_t room = sizeof c->message - strlen(c->message);
    int used =
        snprintf(at, room, "%s%s%s", form->keyword, form->variant ? " " : "", form->variant ? form->variant : "");
    for (const char *word = form->words; *word && used >= 0 && (size_t)used < room; word++)
        used += snprintf(at + used, room - (size_t)used, " %s", case_word_name(*word));
    for (int k = 0; k < CASE_KEY_COUNT && used >= 0 && (size_t)used < room; k++)
        if ((form->required | form->optional) & CASE_BIT(k))
            used += snprintf(at + used, room - (size_t)used, form->required & CASE_BIT(k) ? " %s=" : " [%s=]",
                             case_keys[k].name);
}

static inline int case_same_text(const char *a, const char *b) { return a == b || (a && b && strcmp(a, b) == 0); }

/* 1 when the forms differ in their options only. */
static inline int case_are_alternatives(const case_form *a, const case_form *b)
{
    return case_same_text(a->keyword, b->keyword) && case_same_text(a->variant, b->variant);
}

/* Refuses a statement, naming every way to write it. */
static inline int case_fail_usage(case_file *c, const case_statement *s, const char *what, const char *name)
{
    const char *separator = "; expected: ";
    case_fail(c, s->line, "%s%s", what, name);
    for (int i = 0; i < CASE_FORM_COUNT; i++)
        if (case_are_alternatives(case_forms + i, s->form)) {
            size_t length = strlen(c->message);
            snprintf(c->message + length, sizeof c->message - length, "%s", separator);
            case_append_usage(c, case_forms + i);
            separator = "  or  ";
        }
    return 0;
}

/* Refuses a second word, naming those there are. */
static inline int case_fail_variant(case_file *c, int line, const char *keyword, const char *word)
{
    const char *last = NULL;
    if (word)
        case_fail(c, line, "unknown %s '%.80s'; known:", keyword, word);
    else
        case_fail(c, line, "%s what? known:", keyword);
    for (int i = 0; i < CASE_FORM_COUNT; i++) {
        const case_form *form = case_forms + i;
        size_t length = strlen(c->message);
        if (strcmp(form->keyword, keyword) != 0 || case_same_text(form->variant, last))
            continue;
        last = form->variant;
        snprintf(c->message + length, sizeof c->message - length, " %s", last);
    }
    return 0;
}

/* Finds the first form of a statement from its first words. */
static inline int case_parse_form(case_file *c, case_statement *s, const char *keyword, char **cursor)
{
    const char *variant = NULL;
    for (int i = 0; i < CASE_FORM_COUNT; i++) {
        const case_form *form = case_forms + i;
        if (strcmp(form->keyword, keyword) != 0)
            continue;
        if (form->variant && !variant) {
            variant = case_next_word(cursor);
            if (!variant)
                return case_fail_variant(c, s->line, keyword, NULL);
        }
        if (form->variant && strcmp(form->variant, variant) != 0)
            continue;
        s->form = form;
        return 1;
    }
    if (variant)
        return case_fail_variant(c, s->line, keyword, variant);
    return case_fail(c, s->line, "unknown statement '%.80s'", keyword);
}

static inline int case_parse_treatment(case_file *c, case_statement *s, const char *word)
{
    for (int i = 0; i < CASE_TREATMENT_COUNT; i++)
        if (strcmp(case_treatments[i].name, word) == 0)
            s->treatment = case_treatments + i;
    return s->treatment || case_fail(c, s->line, "unknown element '%.80s'", word);
}

static inline int case_parse_word(case_file *c, case_statement *s, int kind, const char *word)
{
    switch (kind) {
    case 's':
    case 'f': s->path = word; return 1;
    case 'e': return case_parse_treatment(c, s, word);
    case 'a':
        s->axes = case_scan_axes(word);
        return s->axes || case_fail(c, s->line, "'%.80s' is not axes: write x, y, z or some of them, like xyz", word);
    case 'i': return case_scan_integer(word, &s->node) || case_fail(c, s->line, "'%.80s' is no node index", word);
    default:
        return case_scan_number(word, s->numbers + s->number_count++) ||
               case_fail(c, s->line, "'%.80s' is no finite number", word);
    }
}

static inline int case_parse_words(case_file *c, case_statement *s, char **cursor)
{
    for (const char *kind = s->form->words; *kind; kind++) {
        char *word = case_next_word(cursor);
        if (!word)
            return case_fail_usage(c, s, "a word is missing", "");
        if (!case_parse_word(c, s, *kind, word))
            return 0;
    }
    return 1;
}

/* 1 when the number suits the type; else what it should be stands in *expected. */
static inline int case_is_in_range(case_type type, double x, const char **expected)
{
    switch (type) {
    case CASE_TYPE_POSITIVE: *expected = "a number > 0"; return (sb_real)x > 0;
    case CASE_TYPE_STEP: *expected = "a number > 0 or auto"; return (sb_real)x > 0;
    case CASE_TYPE_NOT_NEGATIVE: *expected = "a number >= 0"; return x >= 0;
    case CASE_TYPE_FRACTION: *expected = "a number between 0 and 1"; return (sb_real)x > 0 && (sb_real)x < 1;
    case CASE_TYPE_POISSON: *expected = "a number between -1 and 0.5"; return x > -1 && (sb_real)x < (sb_real)0.5;
    case CASE_TYPE_COUNT: *expected = "an integer >= 1"; return x >= 1;
    case CASE_TYPE_LATTICE: *expected = "1, 2 or 4"; return x == 1 || x == 2 || x == 4;
    default: return 1;
    }
}

/* Stores the value of one option. */
static inline int case_parse_value(case_file *c, case_statement *s, int key, char *value)
{
    const char *name = case_keys[key].name, *expected = "";
    case_type type = case_keys[key].type;
    int integer = 0;
    s->text[key] = value;
    if (type == CASE_TYPE_PATH)
        return 1;
    if (type == CASE_TYPE_VECTOR)
        return case_scan_vector(value, &s->vector) ||
               case_fail(c, s->line, "%s= must be three finite numbers X,Y,Z", name);
    if (type == CASE_TYPE_SIX)
        return case_scan_numbers(value, s->numbers, 6) ||
               case_fail(c, s->line, "%s= must be six finite numbers: %s", name,
                         key == CASE_BOX ? "X0,Y0,Z0,X1,Y1,Z1" : "a point and a normal");
    if (type == CASE_TYPE_STEP && strcmp(value, "auto") == 0)
        return 1;
    if (type == CASE_TYPE_COUNT || type == CASE_TYPE_INTEGER || type == CASE_TYPE_LATTICE) {
        if (!case_scan_integer(value, &integer))
            return case_fail(c, s->line, "%s=%.80s is no integer", name, value);
        s->number[key] = integer;
    } else if (!case_scan_number(value, s->number + key)) {
        return case_fail(c, s->line, "%s=%.80s is no finite number", name, value);
    }
    return case_is_in_range(type, s->number[key], &expected) ||
           case_fail(c, s->line, "%s=%.80s must be %s", name, value, expected);
}

/* Number of a relaxation term g1 tau1 g2 tau2 ..., from 0; -1 when the key is none. */
static inline int case_prony_term(const char *key)
{
    const char *digits = key + (strncmp(key, "tau", 3) == 0 ? 3 : key[0] == 'g' ? 1 : 0);
    int term;
    if (digits == key || !case_scan_integer(digits, &term) || digits[0] < '1' || digits[0] > '9')
        return -1;
    return term - 1;
}

/* Stores one of the relaxation terms. */
static inline int case_parse_prony(case_file *c, case_statement *s, const char *name, int term, const char *value)
{
    unsigned *given = name[0] == 'g' ? &s->prony_g : &s->prony_tau;
    double number;
    if (term >= SB_MAX_PRONY_TERMS)
        return case_fail(c, s->line, "option %s=: a material has at most %d relaxation terms", name,
                         (int)SB_MAX_PRONY_TERMS);
    if (*given >> term & 1)
        return case_fail(c, s->line, "option %s= is given twice", name);
    if (!case_scan_number(value, &number) || !((sb_real)number > 0))
        return case_fail(c, s->line, "%s=%.80s must be a number > 0", name, value);
    *given |= 1u << term;
    (name[0] == 'g' ? s->g : s->tau)[term] = (sb_real)number;
    return 1;
}

/* The key of a name: of those that share it, the one that a form of the statement has. */
static inline int case_find_key(const case_statement *s, const char *name)
{
    int key = CASE_KEY_COUNT;
    for (int k = CASE_KEY_COUNT - 1; k >= 0; k--) {
        case_bits known = 0;
        if (strcmp(case_keys[k].name, name) != 0)
            continue;
        for (int i = 0; i < CASE_FORM_COUNT; i++)
            if (case_are_alternatives(case_forms + i, s->form))
                known |= case_forms[i].required | case_forms[i].optional;
        if (key == CASE_KEY_COUNT || (known & CASE_BIT(k)))
            key = k;
    }
    return key;
}

static inline int case_parse_option(case_file *c, case_statement *s, char *word)
{
    char *value = strchr(word, '=');
    int key, term;
    if (!value)
        return case_fail_usage(c, s, "unexpected word ", word);
    *value++ = 0;
    key = case_find_key(s, word);
    term = s->form->kind == CASE_MATERIAL ? case_prony_term(word) : -1;
    if (term >= 0)
        return case_parse_prony(c, s, word, term, value);
    if (key == CASE_KEY_COUNT)
        return case_fail_usage(c, s, "unknown option ", word);
    if (s->given & CASE_BIT(key))
        return case_fail(c, s->line, "option %s= is given twice", word);
    if (!*value)
        return case_fail(c, s->line, "option %s= has no value", word);
    s->given |= CASE_BIT(key);
    return case_parse_value(c, s, key, value);
}

/* Picks the form that the given options fit. */
static inline int case_choose_form(case_file *c, case_statement *s)
{
    case_bits known = 0, missing = 0;
    int fitting = 0;
    for (int i = 0; i < CASE_FORM_COUNT; i++) {
        const case_form *form = case_forms + i;
        if (!case_are_alternatives(form, s->form))
            continue;
        known |= form->required | form->optional;
        if (s->given & ~(form->required | form->optional))
            continue;
        if ((form->required & ~s->given) == 0) {
            s->form = form;
            return 1;
        }
        missing = fitting++ ? 0 : form->required & ~s->given;
    }
    for (int k = 0; k < CASE_KEY_COUNT; k++) {
        if (s->given & ~known & CASE_BIT(k))
            return case_fail_usage(c, s, "no place here for option ", case_keys[k].name);
        if (fitting == 1 && (missing & CASE_BIT(k)))
            return case_fail_usage(c, s, "missing option ", case_keys[k].name);
    }
    return case_fail_usage(c, s, fitting ? "missing options" : "options that do not go together", "");
}

/* ---- parsing: statements ------------------------------------------------------------------------------- */

static inline int case_parse_statement(case_file *c, case_statement *s, const char *keyword, char *rest)
{
    char *word;
    if (!case_parse_form(c, s, keyword, &rest))
        return 0;
    for (int i = 0; i + 1 < c->statement_count && s->form->once; i++)
        if (strcmp(c->statements[i].form->keyword, keyword) == 0)
            return case_fail(c, s->line, "a second %s statement; the first is in line %d", keyword,
                             c->statements[i].line);
    if (!case_parse_words(c, s, &rest))
        return 0;
    while ((word = case_next_word(&rest)) != NULL)
        if (!case_parse_option(c, s, word))
            return 0;
    if (s->prony_g != s->prony_tau || (s->prony_g & (s->prony_g + 1)))
        return case_fail(c, s->line, "relaxation terms must be g1= tau1= g2= tau2= ... without a gap");
    return case_choose_form(c, s);
}

/* Notes where the statements are that there is one of at most. */
static inline int case_find_singles(case_file *c)
{
    int has_material = 0;
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        switch (s->form->kind) {
        case CASE_MESH:
        case CASE_STUFF:
            if (c->mesh_statement)
                return case_fail(c, s->line, "a second mesh; the first is in line %d", c->mesh_statement->line);
            c->mesh_statement = s;
            break;
        case CASE_SURFACE: c->surface = s; break;
        case CASE_ELEMENT: c->element = s; break;
        case CASE_GRAVITY: c->gravity = s; break;
        case CASE_SOLVE: c->solve = s; break;
        case CASE_MATERIAL: has_material = 1; break;
        default: break;
        }
    }
    if (!c->mesh_statement)
        return case_fail(c, c->line_count, "there is no mesh statement");
    if ((c->surface != NULL) != (c->mesh_statement->form->kind == CASE_STUFF))
        return case_fail(c, c->surface ? c->surface->line : c->mesh_statement->line,
                         "surface and stuff go together: stuff cells=N fills the surface with tets");
    if (!has_material)
        return case_fail(c, c->line_count, "there is no material statement");
    if (!c->solve)
        return case_fail(c, c->line_count, "there is no solve statement");
    return 1;
}

/* Statements from c->text. */
static inline int case_parse(case_file *c)
{
    char *cursor = c->text, *line;
    while ((line = case_next_line(&cursor)) != NULL) {
        void *items = c->statements;
        char *keyword = case_next_word(&line);
        c->line_count++;
        if (!keyword)
            continue;
        if (!case_reserve(&items, c->statement_count, &c->statement_capacity, sizeof *c->statements))
            return case_fail_memory(c, c->line_count);
        c->statements = (case_statement *)items;
        memset(c->statements + c->statement_count, 0, sizeof *c->statements);
        c->statements[c->statement_count].line = c->line_count;
        c->statement_count++;
        if (!case_parse_statement(c, c->statements + c->statement_count - 1, keyword, line))
            return 0;
    }
    return case_find_singles(c);
}

/* ---- loading: lists of nodes and faces ----------------------------------------------------------------- */

/* The path of an input file, which is relative to the case file; NULL when memory is short. The caller frees
 * it. */
static inline char *case_input_path(const case_file *c, const char *name)
{
    const char *slash = strrchr(c->path, '/');
    size_t folder = slash ? (size_t)(slash - c->path) + 1 : 0, length = strlen(name);
    char *path = (char *)malloc(folder + length + 1);
    if (!path)
        return NULL;
    if (name[0] == '/')
        folder = 0;
    memcpy(path, c->path, folder);
    memcpy(path + folder, name, length + 1);
    return path;
}

/* A node index of the mesh from a word, which may be NULL. */
static inline int case_take_node(case_file *c, const char *word, int *node)
{
    if (!word || !case_scan_integer(word, node))
        return case_fail(c, 0, "'%.80s' is no node index", word ? word : "");
    if (*node < 0 || *node >= c->mesh.node_count)
        return case_fail(c, 0, "node %d is not in the mesh, which has nodes 0 to %d", *node, c->mesh.node_count - 1);
    return 1;
}

static inline int case_reserve_nodes(case_statement *s)
{
    void *nodes = s->nodes, *vectors = s->vectors, *stiffness = s->stiffness;
    int capacity = s->capacity, ok = case_reserve(&nodes, s->count, &capacity, sizeof *s->nodes);
    s->nodes = (int *)nodes;
    capacity = s->capacity;
    ok = ok && case_reserve(&vectors, s->count, &capacity, sizeof *s->vectors);
    s->vectors = (sb_vec3 *)vectors;
    if (s->form->kind == CASE_SPRING) {
        capacity = s->capacity;
        ok = ok && case_reserve(&stiffness, s->count, &capacity, sizeof *s->stiffness);
        s->stiffness = (sb_real *)stiffness;
    }
    if (ok)
        s->capacity = capacity;
    return ok;
}

/* One line of a node list: NODE, NODE X Y Z for file=, or NODE K X Y Z for springs. `seen` has a byte per node;
 * only springs may share one. */
static inline int case_take_node_line(case_file *c, case_statement *s, char *line, unsigned char *seen)
{
    int spring = s->form->kind == CASE_SPRING, count = s->given & CASE_BIT(CASE_FILE) ? 3 + spring : 0, node = -1;
    double numbers[4] = {0, 0, 0, 0}, *xyz = numbers + spring;
    if (!case_take_node(c, case_next_word(&line), &node))
        return 0;
    for (int i = 0; i < count; i++) {
        const char *word = case_next_word(&line);
        if (!word || !case_scan_number(word, numbers + i))
            return case_fail(c, 0, "the line must hold a node and %s finite numbers", spring ? "four" : "three");
    }
    if (case_next_word(&line))
        return case_fail(c, 0, "the line holds more than it should");
    if (spring && !((sb_real)numbers[0] > 0))
        return case_fail(c, 0, "the stiffness %g of the spring must be > 0", numbers[0]);
    if (seen[node] && !spring)
        return case_fail(c, 0, "node %d is listed twice", node);
    seen[node] = 1;
    if (!case_reserve_nodes(s))
        return case_fail_memory(c, 0);
    s->nodes[s->count] = node;
    s->vectors[s->count] = count ? sb_v3((sb_real)xyz[0], (sb_real)xyz[1], (sb_real)xyz[2]) : s->vector;
    if (spring)
        s->stiffness[s->count] = (sb_real)numbers[0];
    s->count++;
    return 1;
}

/* How many of the listed nodes are among the first `local_count` of a face. */
static inline int case_count_common(const int *nodes, int count, const int *cell, const int *local, int local_count)
{
    int common = 0;
    for (int i = 0; i < local_count; i++)
        for (int k = 0; k < count; k++)
            if (nodes[k] == cell[local[i]]) {
                common++;
                break;
            }
    return common;
}

/* Finds the element face that has exactly these nodes, or these corners: its element and local number. */
static inline int case_find_face(const case_file *c, const int *nodes, int count, int *element, int *face)
{
    sb_element_type type = c->mesh.element_type, face_type;
    int first = c->node_elements.offsets[nodes[0]], end = c->node_elements.offsets[nodes[0] + 1];
    for (int k = first; k < end; k++) {
        *element = c->node_elements.items[k];
        const int *cell = c->mesh.elements + (size_t)*element * (size_t)sb_element_node_count(type);
        for (*face = 0; *face < sb_element_face_count(type); ++*face) {
            int local[SB_MAX_FACE_NODES], all = sb_element_face(type, *face, local, &face_type);
            int corners = sb_element_corner_count(face_type);
            if ((count == corners || count == all) && case_count_common(nodes, count, cell, local, count) == count)
                return 1;
        }
    }
    return 0;
}

/* Corners of a face of the mesh's elements. */
static inline int case_face_corners(const case_file *c)
{
    return sb_element_corner_count(c->mesh.element_type) == 8 ? 4 : 3;
}

static inline int case_has_faces(const case_statement *s)
{
    return s->form->kind == CASE_TRACTION || s->form->kind == CASE_PRESSURE || s->form->kind == CASE_TIE;
}

static inline int case_add_face(case_file *c, case_statement *s, int element, int face)
{
    sb_element_type type = c->mesh.element_type;
    const int *cell = c->mesh.elements + (size_t)element * (size_t)sb_element_node_count(type);
    int local[SB_MAX_FACE_NODES], corners = case_face_corners(c);
    void *faces = s->faces;
    if (!case_reserve(&faces, s->count, &s->capacity, (size_t)corners * sizeof(int)))
        return case_fail_memory(c, 0);
    s->faces = (int *)faces;
    sb_element_face(type, face, local, NULL);
    for (int i = 0; i < corners; i++)
        s->faces[(size_t)s->count * (size_t)corners + (size_t)i] = cell[local[i]];
    s->count++;
    return 1;
}

/* One line of a face list: the corners of a face or all its nodes, any order; `seen` has a bit per face. */
static inline int case_take_face_line(case_file *c, case_statement *s, char *line, unsigned char *seen)
{
    int nodes[SB_MAX_FACE_NODES], count = 0, element, face;
    char *word;
    while ((word = case_next_word(&line)) != NULL) {
        if (count == SB_MAX_FACE_NODES)
            return case_fail(c, 0, "the line holds more nodes than a face has");
        if (!case_take_node(c, word, nodes + count))
            return 0;
        count++;
    }
    if (!case_find_face(c, nodes, count, &element, &face))
        return case_fail(c, 0, "these %d nodes are no face of an element", count);
    if (seen[element] >> face & 1)
        return case_fail(c, 0, "the face is listed twice");
    seen[element] |= (unsigned char)(1 << face);
    return case_add_face(c, s, element, face);
}

/* Starts another equation of a statement. */
static inline int case_add_equation(case_file *c, case_statement *s, sb_real value)
{
    void *values = s->values, *counts = s->term_counts;
    int capacity = s->capacity, ok = case_reserve(&values, s->count, &capacity, sizeof *s->values);
    s->values = (sb_real *)values;
    ok = ok && case_reserve(&counts, s->count, &s->capacity, sizeof *s->term_counts);
    s->term_counts = (int *)counts;
    if (!ok)
        return case_fail_memory(c, s->line);
    s->values[s->count] = value;
    s->term_counts[s->count++] = 0;
    return 1;
}

/* Adds a term to the last equation. */
static inline int case_add_term(case_file *c, case_statement *s, int node, int axis, sb_real coefficient)
{
    void *terms = s->terms;
    if (!case_reserve(&terms, s->term_count, &s->term_capacity, sizeof *s->terms))
        return case_fail_memory(c, s->line);
    s->terms = (sb_constraint_term *)terms;
    s->terms[s->term_count].node = node;
    s->terms[s->term_count].axis = axis;
    s->terms[s->term_count++].coefficient = coefficient;
    s->term_counts[s->count - 1]++;
    return 1;
}

/* One line of equations: VALUE NODE AXIS COEFFICIENT [NODE AXIS COEFFICIENT] ... */
static inline int case_take_equation_line(case_file *c, case_statement *s, char *line)
{
    const char *word = case_next_word(&line);
    double number;
    if (!word || !case_scan_number(word, &number))
        return case_fail(c, 0, "'%.80s' is no finite number", word ? word : "");
    if (!case_add_equation(c, s, (sb_real)number))
        return 0;
    for (word = case_next_word(&line); word || s->term_counts[s->count - 1] == 0; word = case_next_word(&line)) {
        int node = -1, axes;
        if (!case_take_node(c, word, &node))
            return 0;
        word = case_next_word(&line);
        axes = word ? case_scan_axes(word) : 0;
        if (axes != SB_X && axes != SB_Y && axes != SB_Z)
            return case_fail(c, 0, "'%.80s' is not an axis: write x, y or z", word ? word : "");
        word = case_next_word(&line);
        if (!word || !case_scan_number(word, &number))
            return case_fail(c, 0, "'%.80s' is no finite number", word ? word : "");
        if (!case_add_term(c, s, node, axes == SB_X ? 0 : axes == SB_Y ? 1 : 2, (sb_real)number))
            return 0;
    }
    return 1;
}

/* One line of the list of a statement. */
static inline int case_take_line(case_file *c, case_statement *s, char *line, unsigned char *seen)
{
    if (s->form->kind == CASE_EQUATION)
        return case_take_equation_line(c, s, line);
    return case_has_faces(s) ? case_take_face_line(c, s, line, seen) : case_take_node_line(c, s, line, seen);
}

/* Reads a list line by line; a complaint about a line gets the list's name and line number. */
static inline int case_take_lines(case_file *c, case_statement *s, const char *path, char *text, unsigned char *seen)
{
    char *line, message[sizeof c->message];
    for (int number = 1; (line = case_next_line(&text)) != NULL; number++) {
        int ok;
        if (!line[strspn(line, " \t\r")])
            continue;
        ok = case_take_line(c, s, line, seen);
        if (!ok) {
            memcpy(message, c->message, sizeof message);
            return case_fail(c, s->line, "%.500s:%d: %.400s", path, number, message);
        }
    }
    return s->count > 0 || case_fail(c, s->line, "%.500s: the list is empty", path);
}

/* ---- loading: the mesh --------------------------------------------------------------------------------- */

/* A volume mesh without elements twice, of the element that the case names. */
static inline int case_check_mesh(case_file *c)
{
    const case_statement *s = c->mesh_statement, *element = c->element;
    sb_error error;
    int duplicates;
    if (sb_mesh_remove_duplicate_elements(&c->mesh, &duplicates, &error) != SB_OK)
        return case_fail_library(c, s->line, &error);
    if (duplicates > 0)
        return case_fail(c, s->line, "the mesh has %d elements twice", duplicates);
    if (sb_element_dimension(c->mesh.element_type) != 3)
        return case_fail(c, s->line, "the mesh is a surface of %s; a volume mesh is needed",
                         sb_element_name(c->mesh.element_type));
    if (element && element->treatment->type != c->mesh.element_type)
        return case_fail(c, element->line, "element %s does not fit the mesh, which has %s", element->treatment->name,
                         sb_element_name(c->mesh.element_type));
    return 1;
}

static inline int case_load_mesh_file(case_file *c)
{
    const case_statement *s = c->mesh_statement;
    char *path = case_input_path(c, s->path);
    sb_load_options options = sb_default_load_options();
    sb_error error;
    sb_result result;
    if (!path)
        return case_fail_memory(c, s->line);
    options.report = &c->mesh_report;
    result = sb_mesh_load(&c->mesh, path, &options, &error);
    free(path);
    if (result != SB_OK)
        return case_fail_library(c, s->line, &error);
    return case_check_mesh(c);
}

/* Loads the closed surface of an organ (m). */
static inline int case_load_outer(case_file *c, sb_mesh *mesh)
{
    const case_statement *s = c->surface;
    char *path = case_input_path(c, s->path);
    sb_load_options options = sb_default_load_options();
    sb_error error;
    sb_result result;
    if (!path)
        return case_fail_memory(c, s->line);
    if (s->given & CASE_BIT(CASE_SCALE))
        options.scale = (sb_real)s->number[CASE_SCALE];
    result = sb_mesh_load(mesh, path, &options, &error);
    free(path);
    if (result == SB_OK)
        result = sb_surface_require(mesh, SB_SURFACE_OPEN_EDGES, NULL, NULL, &error);
    return result == SB_OK || case_fail_library(c, s->line, &error);
}

/* Fills the surface with tets, as many along its longest side as asked for. */
static inline int case_stuff(case_file *c)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_shape shape;
    sb_surface *surface = NULL;
    sb_mesh outer;
    sb_vec3 low, high;
    sb_error error;
    int ok;
    memset(&shape, 0, sizeof shape);
    memset(&outer, 0, sizeof outer);
    if (c->mesh_statement->number[CASE_CELLS] > 1000)
        return case_fail(c, c->mesh_statement->line, "cells=%g must be at most 1000",
                         c->mesh_statement->number[CASE_CELLS]);
    if (!case_load_outer(c, &outer)) {
        sb_mesh_free(&outer);
        return 0;
    }
    sb_mesh_bounds(&outer, &low, &high);
    high = sb_v3_sub(high, low);
    def.cell = sb_max(sb_max(high.x, high.y), high.z) / (sb_real)c->mesh_statement->number[CASE_CELLS];
    def.shapes = &shape;
    def.shape_count = 1;
    ok = sb_surface_create(&outer, NULL, &surface, &error) == SB_OK || case_fail_library(c, c->surface->line, &error);
    shape.surface = surface;
    ok = ok && (sb_mesh_stuff(&def, &c->mesh, NULL, &error) == SB_OK ||
                case_fail_library(c, c->mesh_statement->line, &error));
    sb_surface_destroy(surface);
    sb_mesh_free(&outer);
    return ok && case_check_mesh(c);
}

static inline int case_load_mesh(case_file *c)
{
    const case_statement *s = c->mesh_statement;
    if (s->form->kind == CASE_STUFF)
        return case_stuff(c);
    return case_load_mesh_file(c);
}

/* ---- loading: selections ------------------------------------------------------------------------------- */

/* What a selection goes by: the surface that it is near, or NULL, and how far off what is on it may be (m). */
typedef struct case_filter {
    const case_statement *s;
    sb_surface *surface;
    sb_real slack;
    sb_vec3 normal; /* of a plane, of length 1 */
} case_filter;

/* Finds the normal of a plane, however long or short the case has it; 0 when it has no length. */
static inline int case_take_normal(case_filter *filter)
{
    const double *n = filter->s->numbers + 3;
    double most = fmax(fmax(fabs(n[0]), fabs(n[1])), fabs(n[2]));
    if (!(most > 0))
        return 0;
    filter->normal = sb_v3((sb_real)(n[0] / most), (sb_real)(n[1] / most), (sb_real)(n[2] / most));
    filter->normal = sb_v3_scale(1 / sb_v3_norm(filter->normal), filter->normal);
    return 1;
}

static inline int case_is_in(const case_filter *filter, sb_vec3 x)
{
    const double *n = filter->s->numbers;
    sb_vec3 a = sb_v3((sb_real)n[0], (sb_real)n[1], (sb_real)n[2]),
            b = sb_v3((sb_real)n[3], (sb_real)n[4], (sb_real)n[5]);
    sb_real slack = filter->slack;
    if (filter->surface)
        return sb_surface_closest(filter->surface, x, slack, NULL);
    if (filter->s->given & CASE_BIT(CASE_PLANE))
        return sb_abs(sb_v3_dot(sb_v3_sub(x, a), filter->normal)) <= slack;
    return x.x >= a.x - slack && x.y >= a.y - slack && x.z >= a.z - slack && x.x <= b.x + slack && x.y <= b.y + slack &&
           x.z <= b.z + slack;
}

/* 1 when the face belongs to one element only. */
static inline int case_is_outside(const case_file *c, const int *cell, const int *local, int corners)
{
    const sb_index_lists *lists = &c->node_elements;
    int width = sb_mesh_element_width(&c->mesh), owners = 0;
    for (int k = lists->offsets[cell[local[0]]]; k < lists->offsets[cell[local[0]] + 1]; k++) {
        const int *other = c->mesh.elements + (size_t)lists->items[k] * (size_t)width;
        int common = 0;
        for (int a = 0; a < corners; a++)
            for (int b = 0; b < width; b++)
                common += other[b] == cell[local[a]];
        owners += common == corners;
    }
    return owners == 1;
}

static inline int case_select_place(case_file *c, case_statement *s, int place)
{
    if (!case_reserve_nodes(s))
        return case_fail_memory(c, s->line);
    s->vectors[s->count] = sb_v3(0, 0, 0);
    s->nodes[s->count++] = place;
    return 1;
}

/* Outer faces of an element whose corners are all in. */
static inline int case_select_faces(case_file *c, case_statement *s, const case_filter *filter, int element)
{
    const int *cell = c->mesh.elements + (size_t)element * (size_t)sb_mesh_element_width(&c->mesh);
    int corners = case_face_corners(c);
    for (int face = 0; face < sb_element_face_count(c->mesh.element_type); face++) {
        int local[SB_MAX_FACE_NODES], in = 1;
        sb_element_face(c->mesh.element_type, face, local, NULL);
        for (int a = 0; a < corners && in; a++)
            in = case_is_in(filter, c->mesh.nodes[cell[local[a]]]);
        if (in && case_is_outside(c, cell, local, corners) && !case_add_face(c, s, element, face))
            return 0;
    }
    return 1;
}

/* Fills the list of a selection: elements by the mean of their corners. */
static inline int case_select_all(case_file *c, case_statement *s, const case_filter *filter)
{
    const sb_mesh *mesh = &c->mesh;
    int width = sb_mesh_element_width(mesh), corners = sb_element_corner_count(mesh->element_type), ok = 1;
    int count = s->form->code == CASE_SELECT_NODES ? mesh->node_count : mesh->element_count;
    for (int i = 0; i < count && ok; i++) {
        sb_vec3 x = sb_v3(0, 0, 0);
        if (s->form->code == CASE_SELECT_FACES) {
            ok = case_select_faces(c, s, filter, i);
            continue;
        }
        for (int a = 0; a < corners && s->form->code == CASE_SELECT_ELEMENTS; a++)
            x = sb_v3_madd(x, 1 / (sb_real)corners, mesh->nodes[mesh->elements[(size_t)i * (size_t)width + (size_t)a]]);
        if (case_is_in(filter, s->form->code == CASE_SELECT_NODES ? mesh->nodes[i] : x))
            ok = case_select_place(c, s, i);
    }
    return ok && (s->count > 0 || case_fail(c, s->line, "no %s are there: the selection is empty", s->form->variant));
}

/* The surface that a selection is near. */
static inline int case_load_near(case_file *c, const case_statement *s, sb_surface **surface)
{
    char *path = case_input_path(c, s->text[CASE_NEAR]);
    sb_mesh mesh;
    sb_error error;
    sb_result result;
    if (!path)
        return case_fail_memory(c, s->line);
    memset(&mesh, 0, sizeof mesh);
    result = sb_mesh_load(&mesh, path, NULL, &error);
    if (result == SB_OK)
        result = sb_surface_create(&mesh, NULL, surface, &error);
    sb_mesh_free(&mesh);
    free(path);
    return result == SB_OK || case_fail_library(c, s->line, &error);
}

static inline int case_load_selection(case_file *c, case_statement *s)
{
    case_filter filter = {s, NULL, 0, {0, 0, 0}};
    sb_vec3 low, high;
    sb_error error;
    int ok = 1;
    for (const case_statement *other = c->statements; other < s; other++)
        if (other->form->kind == CASE_SELECT && other->form->code == s->form->code && strcmp(other->path, s->path) == 0)
            return case_fail(c, s->line, "line %d selects %s %.80s already", other->line, s->form->variant, s->path);
    sb_mesh_bounds(&c->mesh, &low, &high);
    filter.slack = s->given & CASE_BIT(CASE_DISTANCE) ? (sb_real)s->number[CASE_DISTANCE]
                                                      : (sb_real)1e-6 * sb_v3_norm(sb_v3_sub(high, low));
    if (s->given & CASE_BIT(CASE_PLANE) && !case_take_normal(&filter))
        return case_fail(c, s->line, "the normal of the plane has no length");
    if (s->form->code == CASE_SELECT_FACES && !c->node_elements.offsets &&
        sb_mesh_node_elements(&c->mesh, NULL, &c->node_elements, &error) != SB_OK)
        return case_fail_library(c, s->line, &error);
    if (s->given & CASE_BIT(CASE_NEAR))
        ok = case_load_near(c, s, &filter.surface);
    ok = ok && case_select_all(c, s, &filter);
    sb_surface_destroy(filter.surface);
    return ok;
}

static inline int case_load_selections(case_file *c)
{
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_SELECT && !case_load_selection(c, c->statements + i))
            return 0;
    return 1;
}

/* The selection that `@NAME` names; NULL and a complaint when there is none. */
static inline const case_statement *case_find_selection(case_file *c, const case_statement *s, const char *name,
                                                        int code)
{
    static const char *const kinds[] = {"nodes", "elements", "faces"};
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *other = c->statements + i;
        if (other->form->kind == CASE_SELECT && other->form->code == code && *name == '@' &&
            strcmp(other->path, name + 1) == 0)
            return other;
    }
    case_fail(c, s->line, "there is no `select %s %.80s`", kinds[code], *name == '@' ? name + 1 : name);
    return NULL;
}

/* Makes the selection the list of a statement. */
static inline int case_take_selection(case_file *c, case_statement *s, const char *name)
{
    int of_faces = case_has_faces(s), corners = case_face_corners(c);
    const case_statement *from = case_find_selection(c, s, name, of_faces ? CASE_SELECT_FACES : CASE_SELECT_NODES);
    size_t size = of_faces ? (size_t)corners * sizeof(int) : sizeof(int);
    if (!from)
        return 0;
    for (int i = 0; i < from->count && !of_faces; i++) {
        if (!case_reserve_nodes(s))
            return case_fail_memory(c, s->line);
        s->nodes[s->count] = from->nodes[i];
        s->vectors[s->count++] = s->vector;
    }
    if (!of_faces)
        return 1;
    s->faces = (int *)malloc((size_t)from->count * size);
    if (!s->faces)
        return case_fail_memory(c, s->line);
    memcpy(s->faces, from->faces, (size_t)from->count * size);
    s->count = s->capacity = from->count;
    return 1;
}

/* Elements that a material selects become a region of their own, numbered after those of the mesh. */
static inline int case_make_region(case_file *c, case_statement *s, int first)
{
    const case_statement *from = case_find_selection(c, s, s->text[CASE_ELEMENTS], CASE_SELECT_ELEMENTS);
    int region = first, last = first - 1;
    if (!from)
        return 0;
    if (s->given & CASE_BIT(CASE_REGION))
        return case_fail(c, s->line, "a material has region= or elements=");
    if (!c->mesh.regions)
        c->mesh.regions = (int *)calloc((size_t)c->mesh.element_count, sizeof(int));
    if (!c->mesh.regions)
        return case_fail_memory(c, s->line);
    for (int e = 0; e < c->mesh.element_count; e++)
        last = c->mesh.regions[e] > last ? c->mesh.regions[e] : last;
    region = last < INT_MAX ? last + 1 : last;
    for (int i = 0; i < from->count; i++) {
        if (c->mesh.regions[from->nodes[i]] >= first)
            return case_fail(c, s->line, "element %d has a material by elements= already", from->nodes[i]);
        c->mesh.regions[from->nodes[i]] = region;
    }
    s->given |= CASE_BIT(CASE_REGION);
    s->number[CASE_REGION] = region;
    return 1;
}

static inline int case_make_regions(case_file *c)
{
    int first = 1;
    for (int e = 0; e < c->mesh.element_count && c->mesh.regions; e++)
        first = c->mesh.regions[e] >= first && c->mesh.regions[e] < INT_MAX ? c->mesh.regions[e] + 1 : first;
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].given & CASE_BIT(CASE_ELEMENTS) && !case_make_region(c, c->statements + i, first))
            return 0;
    return 1;
}

/* ---- loading: lists ------------------------------------------------------------------------------------ */

static inline int case_load_list(case_file *c, case_statement *s, const char *name)
{
    int faces = case_has_faces(s), ok;
    int marks = faces ? c->mesh.element_count : c->mesh.node_count;
    unsigned char *seen = (unsigned char *)calloc((size_t)marks, 1);
    const char *reason = "out of memory";
    char *path = case_input_path(c, name), *text = path && seen ? case_read_text(path, &reason) : NULL;
    sb_error error;
    if (!text)
        ok = case_fail(c, s->line, "%.500s: %s", path ? path : name, reason);
    else if (faces && !c->node_elements.offsets &&
             sb_mesh_node_elements(&c->mesh, NULL, &c->node_elements, &error) != SB_OK)
        ok = case_fail_library(c, s->line, &error);
    else
        ok = case_take_lines(c, s, path, text, seen);
    free(text);
    free(path);
    free(seen);
    return ok;
}

/* The list of a statement under one of its options: of a file, or of a selection. */
static inline int case_take_list(case_file *c, case_statement *s, case_key key)
{
    const char *name = s->text[key];
    return name[0] == '@' && key != CASE_FILE ? case_take_selection(c, s, name) : case_load_list(c, s, name);
}

/* The first form of a kind. */
static inline const case_form *case_form_of(case_kind kind)
{
    const case_form *form = case_forms;
    while (form->kind != kind)
        form++;
    return form;
}

/* The nodes of a tie, which has a list of faces besides: they are read as those of supports are. */
static inline int case_take_tied(case_file *c, case_statement *s)
{
    case_statement nodes;
    int ok;
    memset(&nodes, 0, sizeof nodes);
    nodes.line = s->line;
    nodes.form = case_form_of(CASE_FIX);
    nodes.text[CASE_NODES] = s->text[CASE_NODES];
    ok = case_take_list(c, &nodes, CASE_NODES);
    s->nodes = nodes.nodes;
    s->tied_count = nodes.count;
    nodes.nodes = NULL;
    case_free_statement(&nodes);
    return ok;
}

static inline int case_load_lists(case_file *c)
{
    static const case_key lists[] = {CASE_NODES, CASE_FACES, CASE_FILE};
    for (int i = 0; i < c->statement_count; i++)
        for (int k = 0; k < 3; k++) {
            case_statement *s = c->statements + i;
            if (s->form->kind == CASE_CUT || !(s->given & CASE_BIT(lists[k])) || !s->text[lists[k]])
                continue;
            if (s->form->kind == CASE_TIE && lists[k] == CASE_NODES ? !case_take_tied(c, s)
                                                                    : !case_take_list(c, s, lists[k]))
                return 0;
        }
    return 1;
}

/* ---- loading: materials -------------------------------------------------------------------------------- */

/* The elastic part of a material. */
static inline sb_material case_elastic_material(const case_statement *s)
{
    sb_real young = (sb_real)s->number[CASE_E], poisson = (sb_real)s->number[CASE_NU];
    sb_real c10 = (sb_real)s->number[CASE_C10], d1 = (sb_real)s->number[CASE_D1];
    sb_real density = (sb_real)s->number[CASE_DENSITY];
    switch (s->form->code) {
    case SB_LINEAR: return sb_material_linear(young, poisson, density);
    case SB_COROTATED: return sb_material_corotated(young, poisson, density);
    case SB_COROTATED_INVERTIBLE: return sb_material_corotated_invertible(young, poisson, density);
    case SB_SVK: return sb_material_svk(young, poisson, density);
    case SB_NEO_HOOKEAN: return sb_material_neo_hookean(young, poisson, density);
    case SB_STABLE_NEO_HOOKEAN: return sb_material_stable_neo_hookean(young, poisson, density);
    case SB_MOONEY_RIVLIN: return sb_material_mooney_rivlin(c10, (sb_real)s->number[CASE_C01], d1, density);
    case SB_REDUCED_POLYNOMIAL:
        return sb_material_reduced_polynomial(c10, (sb_real)s->number[CASE_C20], (sb_real)s->number[CASE_C30], d1,
                                              density);
    default: return sb_material_neo_hookean_isochoric(c10, d1, density);
    }
}

static inline sb_material case_material(const case_statement *s)
{
    sb_material material = case_elastic_material(s);
    int terms = 0;
    while (s->prony_g >> terms & 1)
        terms++;
    return terms > 0 ? sb_material_with_prony(material, s->g, s->tau, terms) : material;
}

/* Index of a region's material, or -1. */
static inline int case_find_region(const case_file *c, int region)
{
    for (int i = 0; i < c->region_material_count; i++)
        if (c->region_materials[i].region == region)
            return i;
    return -1;
}

/* Takes one material statement; `others` material statements came before it. */
static inline int case_add_material(case_file *c, const case_statement *s, int others)
{
    sb_material material = case_material(s);
    int has_region = (s->given & CASE_BIT(CASE_REGION)) != 0, region = (int)s->number[CASE_REGION];
    sb_error error;
    if (sb_material_check(&material, &error) != SB_OK)
        return case_fail_library(c, s->line, &error);
    if (c->element && c->element->treatment->single_rotation && material.model != SB_COROTATED)
        return case_fail(c, s->line, "element %s needs the material corotated", c->element->treatment->name);
    if (others > 0 && (!has_region || c->region_material_count == 0))
        return case_fail(c, s->line, "several materials need region= each");
    if (has_region && case_find_region(c, region) >= 0)
        return case_fail(c, s->line, "region %d has a material already", region);
    c->material = material;
    if (has_region) {
        c->region_materials[c->region_material_count].region = region;
        c->region_materials[c->region_material_count].material = material;
        c->region_material_count++;
    }
    return 1;
}

/* Every region of the mesh must have a material and every region= must be in the mesh. */
static inline int case_check_regions(case_file *c)
{
    int at = -1, region = 0;
    unsigned char *used = (unsigned char *)calloc((size_t)c->region_material_count + 1, 1);
    if (!used)
        return case_fail_memory(c, c->mesh_statement->line);
    for (int e = 0; e < c->mesh.element_count && c->region_material_count > 0; e++) {
        int own = c->mesh.regions ? c->mesh.regions[e] : 0;
        if (e == 0 || own != region)
            at = case_find_region(c, own);
        region = own;
        if (at < 0) {
            free(used);
            if (!c->mesh.regions)
                return case_fail(c, c->mesh_statement->line,
                                 "the mesh has no regions (all is region 0), but every material names another");
            return case_fail(c, c->mesh_statement->line, "region %d of the mesh (element %d) has no material", own, e);
        }
        used[at] = 1;
    }
    for (int i = 0, k = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind != CASE_MATERIAL || !(s->given & CASE_BIT(CASE_REGION)) || used[k++])
            continue;
        free(used);
        return case_fail(c, s->line, "the mesh has no region %d", (int)s->number[CASE_REGION]);
    }
    free(used);
    return 1;
}

static inline int case_load_materials(case_file *c)
{
    int others = 0;
    c->region_materials = (sb_region_material *)calloc((size_t)c->statement_count, sizeof *c->region_materials);
    if (!c->region_materials)
        return case_fail_memory(c, c->mesh_statement->line);
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_MATERIAL && !case_add_material(c, c->statements + i, others++))
            return 0;
    return case_check_regions(c);
}

/* ---- loading: cuts ------------------------------------------------------------------------------------- */

static inline int case_add_corner(case_file *c, case_statement *s, sb_vec3 x)
{
    void *vectors = s->vectors;
    if (!case_reserve(&vectors, s->count, &s->capacity, sizeof *s->vectors))
        return case_fail_memory(c, s->line);
    s->vectors = (sb_vec3 *)vectors;
    s->vectors[s->count++] = x;
    return 1;
}

/* A square of two triangles that is larger than the mesh. */
static inline int case_load_plane(case_file *c, case_statement *s)
{
    static const signed char corners[6][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, -1}, {1, 1}, {-1, 1}};
    sb_vec3 point = sb_v3((sb_real)s->numbers[0], (sb_real)s->numbers[1], (sb_real)s->numbers[2]), low, high, middle;
    sb_vec3 normal = sb_v3((sb_real)s->numbers[3], (sb_real)s->numbers[4], (sb_real)s->numbers[5]), u, v;
    sb_real size;
    sb_mesh_bounds(&c->mesh, &low, &high);
    middle = sb_v3_scale((sb_real)0.5, sb_v3_add(low, high));
    size = sb_v3_norm(sb_v3_sub(high, low));
    normal = sb_v3_scale(1 / sb_max(sb_max(sb_abs(normal.x), sb_abs(normal.y)), sb_abs(normal.z)), normal);
    normal = sb_v3_scale(1 / sb_v3_norm(normal), normal);
    if (!sb_v3_is_finite(normal))
        return case_fail(c, s->line, "the normal of the plane has no length");
    u = sb_v3_perpendicular(normal);
    u = sb_v3_scale(size / sb_v3_norm(u), u);
    v = sb_v3_cross(normal, u);
    middle = sb_v3_madd(middle, sb_v3_dot(normal, sb_v3_sub(point, middle)), normal);
    for (int k = 0; k < 6; k++)
        if (!case_add_corner(c, s, sb_v3_madd(sb_v3_madd(middle, corners[k][0], u), corners[k][1], v)))
            return 0;
    return 1;
}

/* One corner `X Y Z`: from the third on it makes a triangle with the first and the one before. */
static inline int case_take_corner(case_file *c, case_statement *s, char *line)
{
    double x[3];
    sb_vec3 at;
    for (int i = 0; i < 3; i++) {
        const char *word = case_next_word(&line);
        if (!word || !case_scan_number(word, x + i))
            return case_fail(c, 0, "the line must hold three finite numbers");
    }
    if (case_next_word(&line))
        return case_fail(c, 0, "the line holds more than it should");
    at = sb_v3((sb_real)x[0], (sb_real)x[1], (sb_real)x[2]);
    if (s->count < 3)
        return case_add_corner(c, s, at);
    return case_add_corner(c, s, s->vectors[0]) && case_add_corner(c, s, s->vectors[s->count - 2]) &&
           case_add_corner(c, s, at);
}

static inline int case_take_corners(case_file *c, case_statement *s, const char *path, char *text)
{
    char *line, message[sizeof c->message];
    for (int number = 1; (line = case_next_line(&text)) != NULL; number++)
        if (line[strspn(line, " \t\r")] && !case_take_corner(c, s, line)) {
            memcpy(message, c->message, sizeof message);
            return case_fail(c, s->line, "%.500s:%d: %.400s", path, number, message);
        }
    return s->count >= 3 || case_fail(c, s->line, "%.500s: a polygon needs three corners", path);
}

static inline int case_load_polygon(case_file *c, case_statement *s, const char *path)
{
    const char *reason;
    char *text = case_read_text(path, &reason);
    int ok = text ? case_take_corners(c, s, path, text) : case_fail(c, s->line, "%.500s: %s", path, reason);
    free(text);
    return ok;
}

static inline int case_take_triangles(case_file *c, case_statement *s, const sb_mesh *triangles)
{
    for (int k = 0; k < 3 * triangles->element_count; k++)
        if (!case_add_corner(c, s, triangles->nodes[triangles->elements[k]]))
            return 0;
    return 1;
}

static inline int case_load_surface(case_file *c, case_statement *s, const char *path)
{
    sb_mesh surface, triangles;
    sb_error error;
    int ok = 0;
    memset(&triangles, 0, sizeof triangles);
    if (sb_mesh_load(&surface, path, NULL, &error) != SB_OK)
        return case_fail_library(c, s->line, &error);
    if (sb_element_dimension(surface.element_type) != 2)
        case_fail(c, s->line, "%.500s has %s; a surface is needed", path, sb_element_name(surface.element_type));
    else if (sb_surface_triangulate(&surface, NULL, &triangles, &error) != SB_OK)
        case_fail_library(c, s->line, &error);
    else
        ok = case_take_triangles(c, s, &triangles);
    sb_mesh_free(&triangles);
    sb_mesh_free(&surface);
    return ok;
}

static inline int case_load_cut(case_file *c, case_statement *s)
{
    int lattice = s->given & CASE_BIT(CASE_LATTICE) ? (int)s->number[CASE_LATTICE] : 0, ok;
    char *path;
    if (c->mesh.element_type != SB_TET4 && c->mesh.element_type != SB_TET10)
        return case_fail(c, s->line, "elements of type %s cannot be cut, only tet4 and tet10",
                         sb_element_name(c->mesh.element_type));
    if (lattice && c->lattice && lattice != c->lattice)
        return case_fail(c, s->line, "lattice=%d differs from that of a cut before, %d", lattice, c->lattice);
    c->lattice = lattice ? lattice : c->lattice;
    if (s->form->code == CASE_CUT_PLANE)
        return case_load_plane(c, s);
    if (s->form->code == CASE_CUT_BALL)
        return s->numbers[3] > 0 ||
               case_fail(c, s->line, "the radius of the ball is %g, it must be > 0", s->numbers[3]);
    path = case_input_path(c, s->text[CASE_FILE]);
    ok = !path                               ? case_fail_memory(c, s->line)
         : s->form->code == CASE_CUT_POLYGON ? case_load_polygon(c, s, path)
                                             : case_load_surface(c, s, path);
    free(path);
    return ok;
}

static inline int case_load_cuts(case_file *c)
{
    int any = 0;
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_CUT) {
            any = 1;
            if (!case_load_cut(c, c->statements + i))
                return 0;
        }
    if (any && !c->lattice)
        c->lattice = sb_default_cut_def().lattice;
    return 1;
}

/* ---- loading: supports and the rest -------------------------------------------------------------------- */

static inline sb_real case_component(sb_vec3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

/* Takes the supports of one statement into the table. An axis of a node that two statements support must be
 * told the same by both; `owner` holds the statement of each axis, [node_count][3], `entry` the place in its
 * list. */
static inline int case_add_supports(case_file *c, int index, int *owner, int *entry)
{
    const case_statement *s = c->statements + index;
    for (int k = 0; k < s->count; k++)
        for (int axis = 0; axis < 3; axis++) {
            size_t at = 3 * (size_t)s->nodes[k] + (size_t)axis;
            const case_statement *other = c->statements + owner[at];
            if (!(s->axes >> axis & 1))
                continue;
            if ((c->supports[s->nodes[k]] >> axis & 1) &&
                (case_component(other->vectors[entry[at]], axis) != case_component(s->vectors[k], axis) ||
                 other->number[CASE_RAMP] != s->number[CASE_RAMP]))
                return case_fail(c, s->line, "axis %c of node %d is already held otherwise by line %d", 'x' + axis,
                                 s->nodes[k], other->line);
            c->supports[s->nodes[k]] |= (unsigned char)(1 << axis);
            owner[at] = index;
            entry[at] = k;
        }
    return 1;
}

static inline int case_load_supports(case_file *c)
{
    size_t n = (size_t)c->mesh.node_count;
    int *owner = (int *)calloc(n, 3 * sizeof *owner), *entry = (int *)calloc(n, 3 * sizeof *entry), ok = 1;
    c->supports = (unsigned char *)calloc(n, 1);
    if (!owner || !entry || !c->supports)
        ok = case_fail_memory(c, c->mesh_statement->line);
    for (int i = 0; i < c->statement_count && ok; i++) {
        case_kind kind = c->statements[i].form->kind;
        if (kind == CASE_FIX || kind == CASE_PRESCRIBE)
            ok = case_add_supports(c, i, owner, entry);
    }
    free(owner);
    free(entry);
    return ok;
}

/* 1 for a solve that steps through time. */
static inline int case_is_dynamic(const case_file *c) { return c->solve->form->code > CASE_STATIC; }

/* Time step (s) of a dynamic solve; 0: auto. */
static inline double case_dt(const case_file *c)
{
    return c->solve->number[c->solve->form->code == SB_CENTRAL_DIFFERENCE ? CASE_CENTRAL_DT : CASE_DT];
}

/* What is there to write must be what the solve gives. */
static inline int case_check_output(case_file *c, const case_statement *s)
{
    int frequencies = s->form->code == CASE_OUTPUT_FREQUENCIES, modes = c->solve->form->code == CASE_MODES;
    if (frequencies != modes)
        return case_fail(c, s->line, "output %s does not go with solve %s", s->form->variant, c->solve->form->variant);
    if (s->form->code == CASE_OUTPUT_PROBE && (s->node < 0 || s->node >= c->mesh.node_count))
        return case_fail(c, s->line, "node %d is not in the mesh, which has nodes 0 to %d", s->node,
                         c->mesh.node_count - 1);
    for (const case_statement *other = c->statements; other < s; other++)
        if (other->form->kind == CASE_OUTPUT && strcmp(other->path, s->path) == 0)
            return case_fail(c, s->line, "line %d already writes %s", other->line, s->path);
    return 1;
}

static inline int case_check_expectation(case_file *c, const case_statement *s)
{
    if (c->solve->form->code == CASE_MODES)
        return case_fail(c, s->line, "expect probe does not go with solve modes");
    if (s->node < 0 || s->node >= c->mesh.node_count)
        return case_fail(c, s->line, "node %d is not in the mesh, which has nodes 0 to %d", s->node,
                         c->mesh.node_count - 1);
    return 1;
}

static inline int case_check_statement(case_file *c, case_statement *s)
{
    if (s->form->kind == CASE_OUTPUT)
        return case_check_output(c, s);
    if (s->form->kind == CASE_EXPECT)
        return case_check_expectation(c, s);
    if (s->form->kind != CASE_PRESCRIBE)
        return 1;
    if (!case_is_dynamic(c) && (s->given & CASE_BIT(CASE_RAMP)))
        return case_fail(c, s->line, "ramp= is for dynamic solves; a static solve ramps over its load steps");
    s->scaled = (sb_vec3 *)calloc((size_t)s->count, sizeof *s->scaled);
    return s->scaled || case_fail_memory(c, s->line);
}

/* Degrees of freedom that no support holds (as far as an int counts). */
static inline int case_free_axes(const case_file *c)
{
    int count = 0;
    for (int i = 0; i < c->mesh.node_count; i++)
        for (int axis = 0; axis < 3 && count < INT_MAX; axis++)
            count += !(c->supports[i] >> axis & 1);
    return count;
}

/* What is checked when statements have their lists. */
static inline int case_load_rest(case_file *c)
{
    int ok = case_load_supports(c) && case_load_cuts(c);
    for (int i = 0; i < c->statement_count && ok; i++)
        ok = case_check_statement(c, c->statements + i);
    if (ok && case_is_dynamic(c) && case_dt(c) > 0 && !(c->solve->number[CASE_END] / case_dt(c) < 1e9))
        ok = case_fail(c, c->solve->line, "end= is more than 1e9 steps of dt= away");
    if (ok && c->solve->form->code == CASE_MODES && (int)c->solve->number[CASE_COUNT] > case_free_axes(c))
        ok = case_fail(c, c->solve->line, "count= is more than the %d degrees of freedom that no support holds",
                       case_free_axes(c));
    return ok;
}

/* An empty case with the text of its file. */
static inline int case_start(case_file *c, const char *path)
{
    const char *reason = "out of memory";
    size_t size = strlen(path) + 1;
    memset(c, 0, sizeof *c);
    c->mass = -1;
    c->path = (char *)malloc(size);
    if (!c->path)
        return case_fail_memory(c, 0);
    memcpy(c->path, path, size);
    c->text = case_read_text(path, &reason);
    return c->text || case_fail(c, 1, "%s", reason);
}

/* The rest of case_read, from c->text on. */
static inline int case_read_started(case_file *c)
{
    return case_parse(c) && case_load_mesh(c) && case_load_selections(c) && case_make_regions(c) &&
           case_load_materials(c) && case_load_lists(c) && case_load_rest(c);
}

/* Reads the case file at `path` and the files it names. Returns 1, or 0 with c->error_line and c->message
 * telling what is wrong. *c is overwritten; release it with case_free in either case. */
static inline int case_read(case_file *c, const char *path) { return case_start(c, path) && case_read_started(c); }

/* ---- the body ------------------------------------------------------------------------------------------ */

/* The mass matrix of a solve. Explicit steps need a diagonal one; modes are those of the exact one; other dynamics
 * take what industrial solvers integrate, since cases compare with theirs. */
static inline sb_mass_kind case_mass(const case_file *c)
{
    if (c->mass >= 0)
        return (sb_mass_kind)c->mass;
    return c->solve->form->code == SB_CENTRAL_DIFFERENCE ? SB_MASS_LUMPED
           : c->solve->form->code == CASE_MODES          ? SB_MASS_CONSISTENT
                                                         : SB_MASS_REDUCED;
}

/* Settings of a dynamic solve; tol= and newton= have defaults. */
static inline void case_set_dynamics(const case_file *c, sb_body_def *def)
{
    const case_statement *s = c->solve;
    def->integrator = (sb_integrator)s->form->code;
    def->damping_mass = (sb_real)s->number[CASE_ALPHA];
    def->damping_stiffness = (sb_real)s->number[CASE_BETA];
    def->max_newton = s->given & CASE_BIT(CASE_NEWTON) ? (int)s->number[CASE_NEWTON] : 20;
    def->max_iterations = 20000;
    if (s->given & CASE_BIT(CASE_TOL)) {
        def->newton_tolerance = (sb_real)s->number[CASE_TOL];
        def->tolerance = (sb_real)s->number[CASE_TOL]; /* what a linearised step (newton=1) goes by */
    }
}

/* Statements of several kinds, as bits. */
#define CASE_KIND(kind) (1u << (kind))
#define CASE_DEAD_LOADS (CASE_KIND(CASE_FORCE) | CASE_KIND(CASE_TRACTION))
#define CASE_LOADS (CASE_DEAD_LOADS | CASE_KIND(CASE_PRESSURE) | CASE_KIND(CASE_SPRING))

/* Adds the loads of these kinds. */
static inline sb_result case_add_loads(const case_file *c, sb_body *body, unsigned kinds, sb_error *error)
{
    sb_result result = SB_OK;
    for (int i = 0; i < c->statement_count && result == SB_OK; i++) {
        const case_statement *s = c->statements + i;
        error->message[0] = 0;
        if (!(kinds & CASE_KIND(s->form->kind)))
            continue;
        if (s->form->kind == CASE_FORCE)
            result = sb_body_add_forces(body, s->nodes, s->count, s->vectors, 0);
        else if (s->form->kind == CASE_TRACTION)
            result = sb_body_add_traction(body, s->faces, s->count, case_face_corners(c), s->vector, error);
        else if (s->form->kind == CASE_PRESSURE)
            result = sb_body_add_pressure(body, s->faces, s->count, case_face_corners(c),
                                          (sb_real)s->number[CASE_PRESSURE_VALUE], NULL, error);
        else if (s->form->kind == CASE_SPRING)
            result = sb_body_add_springs(body, s->nodes, s->count, s->stiffness, 0, s->vectors, NULL, error);
    }
    return result;
}

/* Ties nodes to faces as they lie; one that is too far off is an error. */
static inline int case_tie(case_file *c, sb_body *body, const case_statement *s)
{
    sb_real distance = s->given & CASE_BIT(CASE_DISTANCE) ? (sb_real)s->number[CASE_DISTANCE] : -1;
    sb_error error;
    return sb_body_tie_faces(body, s->faces, s->count, case_face_corners(c), s->nodes, s->tied_count, distance,
                             SB_TIE_ALL, NULL, &error) == SB_OK ||
           case_fail_library(c, s->line, &error);
}

/* Equations are among nodes that supports leave free, or hang on those. */
static inline int case_add_equations(case_file *c, sb_body *body)
{
    sb_error error;
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind == CASE_EQUATION &&
            sb_body_add_constraints(body, s->terms, s->term_counts, s->values, s->count, NULL, &error) != SB_OK)
            return case_fail_library(c, s->line, &error);
        if (s->form->kind == CASE_TIE && !case_tie(c, body, s))
            return 0;
    }
    return 1;
}

/* Copies that a cut made of prescribed nodes go with them, along the axes that they are supported along. */
static inline sb_result case_move_copies(const case_file *c, sb_body *body, const case_statement *s)
{
    sb_result result = SB_OK;
    for (int i = c->mesh.node_count; c->cut && i < sb_body_node_count(body) && result == SB_OK; i++) {
        int origin = sb_cut_node_origin(c->cut, i), axes = origin < 0 ? 0 : sb_body_supports(body)[i] & s->axes;
        for (int k = 0; axes && k < s->count; k++)
            if (s->nodes[k] == origin) {
                result = sb_body_prescribe(body, &i, 1, axes, s->scaled + k, 1);
                break;
            }
    }
    return result;
}

/* Puts the supports where the case wants them at time t (s); a static solve or a ramp of 0 wants the whole
 * way. */
static inline sb_result case_move_supports(const case_file *c, sb_body *body, double t)
{
    sb_result result = SB_OK;
    for (int i = 0; i < c->statement_count && result == SB_OK; i++) {
        const case_statement *s = c->statements + i;
        double ramp = s->number[CASE_RAMP], share = ramp > 0 && t < ramp ? t / ramp : 1;
        if (s->form->kind == CASE_FIX)
            result = sb_body_fix_nodes(body, s->nodes, s->count, s->axes);
        if (s->form->kind != CASE_PRESCRIBE)
            continue;
        for (int k = 0; k < s->count; k++)
            s->scaled[k] = sb_v3_scale((sb_real)share, s->vectors[k]);
        result = sb_body_prescribe(body, s->nodes, s->count, s->axes, s->scaled, 0);
        if (result == SB_OK)
            result = case_move_copies(c, body, s);
    }
    return result;
}

static inline int case_cut(case_file *c, const case_statement *s)
{
    sb_cut_info info;
    sb_error error;
    if (sb_cut_triangles(c->cut, s->vectors, s->count / 3, &info, &error) != SB_OK)
        return case_fail_library(c, s->line, &error);
    if (info.links == 0)
        return case_fail(c, s->line, "the cut meets nothing of the mesh that was whole before it");
    return 1;
}

/* 1: the body has material. */
static inline int case_is_left(const sb_body *body)
{
    int left = 0;
    for (int e = 0; e < sb_body_element_count(body) && !left; e++)
        left = sb_body_cell_share(body, e) > 0;
    return left;
}

static inline int case_ablate(case_file *c, const sb_body *body, const case_statement *s)
{
    sb_vec3 centre = sb_v3((sb_real)s->numbers[0], (sb_real)s->numbers[1], (sb_real)s->numbers[2]);
    sb_cut_info info;
    sb_error error;
    if (sb_cut_ablate(c->cut, centre, (sb_real)s->numbers[3], &info, &error) != SB_OK)
        return case_fail_library(c, s->line, &error);
    if (!(info.removed_volume > 0))
        return case_fail(c, s->line, "the ball has nothing of the mesh in it: no point of the lattice");
    if (!case_is_left(body))
        return case_fail(c, s->line, "the ball takes all of the mesh");
    return 1;
}

/* Cuts the body, which has its loads and supports: they follow. */
static inline int case_cut_body(case_file *c, sb_body *body)
{
    sb_cut_def def = sb_default_cut_def();
    sb_error error;
    def.body = body;
    def.lattice = c->lattice;
    def.max_strokes = 0;
    def.least_piece = 0; /* crumbs are held, and said */
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind != CASE_CUT)
            continue;
        if (!c->cut && sb_cut_create(&def, &c->cut, &error) != SB_OK)
            return case_fail_library(c, s->line, &error);
        if (s->form->code == CASE_CUT_BALL ? !case_ablate(c, body, s) : !case_cut(c, s))
            return 0;
    }
    return 1;
}

/* The parts of a body; NULL: no memory. The caller frees them; numbers [nodes] or NULL. */
static inline sb_part *case_list_parts(sb_body *body, int *count, int *numbers)
{
    sb_part *parts;
    sb_body_parts(body, NULL, 0, count, NULL);
    parts = (sb_part *)calloc((size_t)*count + 1, sizeof *parts);
    if (parts)
        sb_body_parts(body, parts, *count, count, numbers);
    return parts;
}

/* Holds what cuts that meet leave of elements: free parts smaller than one (in the mean). */
static inline int case_hold_crumbs(case_file *c, sb_body *body)
{
    int nodes = sb_body_node_count(body), count = 0, ok;
    int *numbers = (int *)malloc((size_t)nodes * sizeof *numbers);
    sb_part *parts = numbers ? case_list_parts(body, &count, numbers) : NULL;
    double least = 0;
    for (int e = 0; e < c->mesh.element_count; e++)
        least += (double)sb_mesh_element_volume(&c->mesh, e) / c->mesh.element_count;
    c->crumbs = 0;
    for (int k = 0; parts && k < count; k++) {
        parts[k].node_count = (double)parts[k].volume < least; /* 1: a crumb, from here on */
        c->crumbs += parts[k].node_count;
    }
    ok = parts != NULL;
    for (int i = 0; ok && c->crumbs && i < nodes; i++)
        if (numbers[i] >= 0 && parts[numbers[i]].node_count)
            ok = sb_body_hold(body, &i, 1, SB_XYZ, NULL) == SB_OK;
    free(parts);
    free(numbers);
    return ok || case_fail_memory(c, c->solve->line);
}

/* Says which part a static solve would find free; returns 0. */
static inline int case_fail_part(case_file *c, sb_body *body, int node)
{
    int count = 0, at = 0, nodes = sb_body_node_count(body);
    int *numbers = (int *)malloc((size_t)nodes * sizeof *numbers);
    sb_part *parts = numbers && c->cut ? case_list_parts(body, &count, numbers) : NULL;
    if (parts && numbers[node] >= 0) {
        sb_part *p = parts + (at = numbers[node]);
        case_fail(c, c->solve->line,
                  "part %d of the %d that the cuts leave can move freely: support it. It has %.4g m^3 about (%.4g, "
                  "%.4g, %.4g) and node %d",
                  at + 1, count, (double)p->volume, (double)p->centre.x, (double)p->centre.y, (double)p->centre.z,
                  p->node);
    } else {
        case_fail(c, c->solve->line, "the part of the mesh with node %d can move freely: support it",
                  c->node_numbers ? c->node_numbers[node] : node);
    }
    free(parts);
    free(numbers);
    return 0;
}

/* Loads, supports at time 0, cuts, and whether the supports are enough for a static solve. */
static inline int case_prepare_body(case_file *c, sb_body *body)
{
    sb_check_report report;
    sb_error error;
    sb_result result;
    memset(&error, 0, sizeof error);
    result = case_add_loads(c, body, CASE_LOADS, &error);
    if (result == SB_OK)
        result = case_move_supports(c, body, 0);
    if (result == SB_OK && !case_add_equations(c, body))
        return 0;
    if (result == SB_OK && c->lattice && (!case_cut_body(c, body) || !case_hold_crumbs(c, body)))
        return 0;
    if (result == SB_OK)
        result = sb_body_check(body, &report);
    if (result != SB_OK)
        return case_fail(c, c->solve->line, "%s", error.message[0] ? error.message : sb_result_string(result));
    if (c->solve->form->code == CASE_STATIC && report.unsupported_component_node >= 0)
        return case_fail_part(c, body, report.unsupported_component_node);
    return 1;
}

/* What a case says about its body, loads and supports left out. */
static inline sb_body_def case_body_def(const case_file *c)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = &c->mesh;
    def.material = c->material;
    def.region_materials = c->region_materials;
    def.region_material_count = c->region_material_count;
    if (c->element) {
        def.single_rotation = c->element->treatment->single_rotation;
        def.integration = c->element->treatment->integration;
    }
    def.mass = case_mass(c);
    if (c->gravity)
        def.gravity =
            sb_v3((sb_real)c->gravity->numbers[0], (sb_real)c->gravity->numbers[1], (sb_real)c->gravity->numbers[2]);
    if (case_is_dynamic(c))
        case_set_dynamics(c, &def);
    if (c->lattice)
        def.slack = (sb_real)0.5;
    return def;
}

/* Makes the body of a case with all its loads and its supports at time 0. Returns 1, or 0 with error_line and
 * message. A case without the supports that its static solve needs is refused here. */
static inline int case_create_body(case_file *c, sb_body **out)
{
    sb_body_def def = case_body_def(c);
    sb_body *body = NULL;
    sb_error error;
    sb_cut_destroy(c->cut);
    c->cut = NULL;
    if (sb_body_create(&def, &body, &error) != SB_OK)
        return case_fail_library(c, c->mesh_statement->line, &error);
    if (!case_prepare_body(c, body)) {
        sb_body_destroy(body);
        return 0;
    }
    *out = body;
    return 1;
}

/* The loads of some kinds (CASE_KIND of gravity, too) on the undeformed body as nodal forces (N), [node_count]. */
static inline int case_nodal_loads(case_file *c, unsigned kinds, sb_vec3 *forces)
{
    sb_body_def def = case_body_def(c);
    sb_static_options options = sb_default_static_options();
    sb_body *body = NULL;
    sb_error error;
    int ok;
    memset(&error, 0, sizeof error);
    if (!(kinds & CASE_KIND(CASE_GRAVITY)))
        def.gravity = sb_v3(0, 0, 0);
    ok = sb_body_create(&def, &body, &error) == SB_OK && case_add_loads(c, body, kinds, &error) == SB_OK;
    for (int i = 0; i < c->mesh.node_count && ok; i++)
        ok = sb_body_fix_nodes(body, &i, 1, SB_XYZ) == SB_OK;
    options.load_steps = 1;
    if (ok && sb_body_solve_static(body, &options, NULL) == SB_OK)
        memcpy(forces, sb_body_external_forces(body), (size_t)c->mesh.node_count * sizeof *forces);
    else
        ok = case_fail(c, c->mesh_statement->line, "%s", error.message[0] ? error.message : "the loads have no nodes");
    sb_body_destroy(body);
    return ok;
}

/* Options of the static solve. */
static inline sb_static_options case_static_options(const case_file *c)
{
    sb_static_options options = sb_default_static_options();
    options.load_steps = (int)c->solve->number[CASE_STEPS];
    options.tolerance = (sb_real)c->solve->number[CASE_TOL];
    if (c->solve->given & CASE_BIT(CASE_ITERATIONS))
        options.max_newton = (int)c->solve->number[CASE_ITERATIONS];
    options.keep_progress = 1;
    return options;
}

/* Number of time steps of dt (s) in a dynamic solve; the last one is shorter when dt does not divide the time. */
static inline int case_step_count(const case_file *c, double dt)
{
    double steps = c->solve->number[CASE_END] / dt;
    int count = (int)steps;
    return count + (count < 1 || steps - count > 1e-6 * steps);
}

/* Time (s) at the end of step `step` of `count`, from 1. */
static inline double case_step_time(const case_file *c, double dt, int step, int count)
{
    return step == count ? c->solve->number[CASE_END] : step * dt;
}

#endif /* CASE_READER_H */
