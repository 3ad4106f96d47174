/* case_inp: reads an input file of Abaqus or CalculiX (.inp) as a case:
 *
 *     lines --inp_parse--> nodes, elements, sets, materials, entries --inp_build--> case_file
 *
 * Taken are: *NODE, *ELEMENT (C3D4, C3D8, C3D10, C3D20), *NSET, *ELSET, *SURFACE of element faces, *INCLUDE within the
 * folder; *MATERIAL with *ELASTIC, *HYPERELASTIC (what foreign_laws has) and *DENSITY; *SOLID SECTION, *EQUATION, *TIE,
 * *SPRING of SPRING1 and SPRING2 to points (see inp_add_springs), *AMPLITUDE that is a ramp; *BOUNDARY, *CLOAD, *DLOAD
 * and *DSLOAD (P, GRAV), each with OP=; *STEP with *STATIC, *DYNAMIC or *FREQUENCY. Requests for output say what is
 * written. All else is refused, by name and line; what is wrong is listed to the end of the file. Files have no units:
 * they are SI's, unless a first comment has those of foreign_units. Loads, as in CalculiX: those of one step on one
 * place add up, later ones replace them; supports replace each other; OP=NEW takes away what steps before had, and
 * supports before the first step.
 *
 * A model of parts is read as Abaqus/CAE writes it: each *INSTANCE is the text of its *PART read anew at its place,
 * with INSTANCE. before the names of its sets and surfaces, and its labels counted on from those that are there
 * already. The first instance keeps its labels. */
#ifndef CASE_INP_H
#define CASE_INP_H

#include "case_foreign.h"

/* ---- what is read ------------------------------------------------------------------------------------------ */

enum {
    INP_MAX_FIELDS = 64,
    INP_MAX_PARAMETERS = 16,
    INP_MAX_CARD = 1024,
    INP_MAX_DEPTH = 8,
    INP_MAX_FILES = 1000,
    INP_MAX_FAULTS = 50,
    INP_MAX_SET_LABELS = 50000000 /* of all sets: a set of sets, or a row, says many in few words */
};

/* Items of one type, as many as there are. */
typedef struct inp_list {
    void *items;
    int count, capacity;
} inp_list;

typedef struct inp_place {
    const char *path;
    int line;
} inp_place;

typedef struct inp_node {
    int label; /* first, for inp_make_map */
    sb_vec3 x;
    inp_place place;
} inp_node;

typedef struct inp_element {
    int label; /* first, likewise */
    inp_place place;
} inp_element;

/* A list of labels; after inp_resolve_sets of places in the mesh, each once. */
typedef struct inp_set {
    const char *name;
    int of_elements;
    inp_list items; /* int */
    int nodes_of;   /* set of elements whose nodes it has too; -1: none */
    inp_place place;
} inp_set;

typedef struct inp_material {
    const char *name;
    inp_place place, law_place;
    const foreign_law *law; /* NULL: *ELASTIC, or none when law_place.path is NULL */
    const char *model;      /* of two constants E and nu; NULL: what NLGEOM makes of *ELASTIC */
    double constants[12];   /* as the file has them, with its unit of force */
    int constant_count, wanted;
    double density; /* 0: none */
} inp_material;

typedef struct inp_section {
    const char *set, *material;
    inp_place place;
} inp_section;

typedef struct inp_amplitude {
    const char *name;
    double points[8]; /* time, value, ... */
    int count;        /* of numbers; beyond the room: counted only */
    inp_place place;
} inp_amplitude;

/* A face of a set or an element in a named surface; of a surface of nodes the face is -1. */
typedef struct inp_surface_item {
    const char *surface, *target;
    int face;
} inp_surface_item;

typedef enum inp_kind { INP_BOUNDARY, INP_CLOAD, INP_PRESSURE, INP_SURFACE_PRESSURE, INP_GRAVITY } inp_kind;

/* A pair of surfaces that are tied. */
typedef struct inp_tie {
    const char *slave, *master;
    double distance; /* (m); 0: not said */
    inp_place place;
} inp_tie;

/* A spring element between two nodes, or from one to the ground. */
typedef struct inp_spring {
    int label; /* first, for inp_make_map */
    const char *nodes[2];
    int count;   /* of nodes: 1 or 2 */
    int at[2];   /* places of the nodes; at[1] -1: the ground where the node is at rest */
    int section; /* -1: none yet */
    inp_place place;
} inp_spring;

/* *SPRING: what the springs of a set are. */
typedef struct inp_spring_section {
    const char *set;
    int axes[2]; /* from 0, of the first and second node; -1: not said */
    int axis_count;
    double stiffness;   /* (N/m); 0: not said */
    int is_table;       /* NONLINEAR: stiffness is the slope of its lines */
    double least, most; /* displacements (m) of the table */
    inp_place place;
} inp_spring_section;

/* Springs between one node and one point, along each axis. */
typedef struct inp_pull {
    int node, point; /* point: a node of no element; -1: where the node is at rest */
    int first;       /* of its springs */
    double stiffness[3];
    int is_drawn[3]; /* 1: a force of its own draws the node to where the point stands */
} inp_pull;

/* One data line of a support or load, in the order of the file. */
typedef struct inp_entry {
    inp_kind kind;
    int step;           /* from 1; 0: before the first */
    int fresh;          /* OP=NEW: what earlier steps had of this kind goes */
    const char *target; /* NULL: the node `label` */
    int label;
    int first, last; /* axes from 0; of pressures the face in both */
    double value;
    double direction[3]; /* of gravity */
    const char *amplitude;
    inp_place place;
} inp_entry;

/* What entries of a step go by. */
typedef struct inp_step {
    inp_place place;
    const struct inp_keyword *procedure; /* NULL: not there yet */
    double period;                       /* (s) its end; 1 when it is not said */
    int ramps;                           /* AMPLITUDE=RAMP: loads without an amplitude rise to its end */
} inp_step;

/* A term of an equation; `starts` at the first of each. */
typedef struct inp_term {
    const char *target; /* NULL: the node `label` */
    int label, axis, starts;
    double coefficient, value; /* value: right-hand side (m), at the first term */
    inp_place place;
} inp_term;

/* A pressure on a face of an element of the mesh. */
typedef struct inp_pressure {
    int element, face, step;
    double value;
} inp_pressure;

/* A file or the text of a part that is being read, or has been: names point into its text. */
typedef struct inp_source {
    char *text, *cursor, *path;
    char *pending; /* a line that was looked at and comes again */
    int line;
} inp_source;

/* The lines of a *PART, which each of its instances reads. */
typedef struct inp_part {
    const char *name, *text;
    inp_place before; /* the first line */
} inp_part;

/* A part at its place, or the *ASSEMBLY, whose name is "". */
typedef struct inp_instance {
    const char *name;
    int offset[2];       /* is added to labels of nodes and of elements */
    int has_own;         /* of the assembly: nodes or elements of its own */
    sb_vec3 move;        /* (m) is added to places of nodes, before they turn */
    sb_vec3 from, axis;  /* they turn about the axis, of length 1, through this point */
    double sine, cosine; /* of the angle; 0, 1: not at all */
} inp_instance;

typedef struct inp_parameter {
    const char *name, *value;
} inp_parameter;

/* Places of labels in a list. */
typedef struct inp_pair {
    int label, at;
} inp_pair;
typedef struct inp_map {
    inp_pair *pairs; /* [count] ascending by label */
    int count;
    int is_run; /* each label is one more than that before it */
} inp_map;

struct inp_keyword;

typedef struct inp_reader {
    case_file *c;
    inp_list sources; /* inp_source: all files; the first is the case's own */
    int stack[INP_MAX_DEPTH], depth;
    inp_place here;
    int shift;     /* decimal exponent of the file's unit of force, in N */
    int seen_card; /* comments before the first one may have units */
    int no_memory;

    char card[INP_MAX_CARD]; /* the present one, cut into name and parameters */
    const char *card_name;
    inp_parameter parameters[INP_MAX_PARAMETERS];
    int parameter_count;
    inp_place card_place;
    const struct inp_keyword *keyword; /* NULL: data lines are passed over */
    int included;                      /* 1: the last card was *INCLUDE, which data lines do not follow */
    int data_lines;                    /* of the card, so far */
    inp_place data_place;              /* of the last one */
    int wanted;                        /* numbers that the next data lines of an element or equation go on with */

    inp_list parts, instances; /* inp_part, inp_instance */
    int assembly;              /* that is being read; -1: none */
    int scope;                 /* instance that is being read; -1: none */
    int instance; /* that the present card is about: by its INSTANCE=, or the scope, or the assembly; or -1 */
    const inp_part *opening; /* its lines come next, when those of *INSTANCE are read */
    int most[2];             /* largest label of nodes and of elements so far */

    inp_list nodes, elements, element_nodes; /* inp_node, inp_element, int [width] labels of each */
    const foreign_element *element;          /* NULL: no element yet */
    inp_place element_place;
    int is_flat;                       /* of the present *ELEMENT: of fewer dimensions, known by label only */
    inp_list flat;                     /* int: their labels */
    int spring_nodes;                  /* of the present *ELEMENT: 1 or 2 of SPRING1 or SPRING2; 0: it is no spring */
    int has_other_springs;             /* that were refused: their *SPRING is passed over */
    inp_list springs, spring_sections; /* inp_spring, inp_spring_section */
    int points;                        /* the last nodes: of springs and no element, they are no part of the mesh */
    inp_list pulls;                    /* inp_pull */
    inp_list sets;                     /* inp_set */
    int set;                           /* that is being filled, or -1 */
    int set_labels;                    /* of all sets, so far */
    inp_list materials, sections, amplitudes, surface_items, entries, terms, ties;
    const char *surface;   /* that is being filled */
    int of_nodes;          /* its TYPE=NODE */
    int fresh;             /* OP=NEW of the present card */
    const char *amplitude; /* its AMPLITUDE=, or NULL */

    inp_list steps;               /* inp_step */
    int step, in_step, nonlinear; /* of the present or last *STEP, from 1 */
    inp_place step_place, procedure_place;
    const struct inp_keyword *procedure; /* of the last step that has one */
    double times[4];                     /* of its data line */
    int time_count, direct;
    int ends_only; /* 1: of courses only the value at times[1] counts: steps before the last are not solved */
    const char *alpha;
    double tolerance; /* of *CONTROLS; 0: none */
    int wants_reactions, wants_stresses;
    const char *printed; /* set of the present *NODE PRINT */
    inp_list probes;     /* const char *: sets whose displacements are printed */

    inp_map node_map, element_map, flat_map;
    double *support;    /* [nodes][3] prescribed displacement (m) */
    int *support_step;  /* [nodes][3] step of that, from 1; -1: free */
    double *ramp;       /* [nodes][3] time (s) until it is reached; 0: at once */
    double *force;      /* [nodes][3] (N) */
    int *force_step;    /* [nodes][3] */
    sb_vec3 *gravity;   /* [elements] (m/s^2) */
    int *gravity_step;  /* [elements] */
    inp_list pressures; /* inp_pressure */
} inp_reader;

/* Where a keyword may stand. */
enum { INP_IN_MODEL = 1, INP_IN_MATERIAL = 2, INP_IN_STEP = 4, INP_ANYWHERE = 7 };

typedef struct inp_keyword {
    const char *name;       /* without blanks */
    const char *parameters; /* that are understood, each between blanks */
    int where;
    void (*begin)(inp_reader *r);                          /* or NULL */
    void (*data)(inp_reader *r, char **fields, int count); /* or NULL: data lines are passed over */
    int least, most;                                       /* data lines; most 0: any number */
} inp_keyword;

/* ---- complaints and memory --------------------------------------------------------------------------------- */

CASE_PRINTF static inline void inp_complain(inp_reader *r, inp_place at, const char *format, ...)
{
    char words[800];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(words, sizeof words, format, arguments);
    va_end(arguments);
    if (r->c->faults.count == 0)
        case_fail(r->c, at.line, "%s", words);
    if (r->c->faults.count < INP_MAX_FAULTS)
        case_add_message(&r->c->faults, at.path, at.line, words);
}

CASE_PRINTF static inline void inp_note(inp_reader *r, inp_place at, const char *format, ...)
{
    char words[400];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(words, sizeof words, format, arguments);
    va_end(arguments);
    case_add_message(&r->c->notes, at.path, at.line, words);
}

/* A new zeroed item at the end of a list; NULL when memory is short, which is complained about once. */
static inline void *inp_add(inp_reader *r, inp_list *list, size_t size)
{
    if (!r->no_memory && case_reserve(&list->items, list->count, &list->capacity, size))
        return memset((char *)list->items + (size_t)list->count++ * size, 0, size);
    if (!r->no_memory)
        inp_complain(r, r->here, "out of memory");
    r->no_memory = 1;
    return NULL;
}

static inline void *inp_allocate(inp_reader *r, size_t count, size_t size)
{
    void *memory = r->no_memory ? NULL : calloc(count ? count : 1, size);
    if (!memory && !r->no_memory)
        inp_complain(r, r->here, "out of memory");
    r->no_memory |= !memory;
    return memory;
}

static inline void inp_add_int(inp_reader *r, inp_list *list, int value)
{
    int *item = (int *)inp_add(r, list, sizeof *item);
    if (item)
        *item = value;
}

/* A copy of a name for as long as the case lives; "" when memory is short. */
static inline const char *inp_keep(inp_reader *r, const char *name)
{
    const char *kept = r->no_memory ? NULL : case_keep(r->c, name);
    if (!kept && !r->no_memory)
        inp_complain(r, r->here, "out of memory");
    r->no_memory |= !kept;
    return kept ? kept : "";
}

static inline inp_source *inp_sources(const inp_reader *r) { return (inp_source *)r->sources.items; }
static inline inp_node *inp_nodes(const inp_reader *r) { return (inp_node *)r->nodes.items; }
static inline inp_element *inp_elements(const inp_reader *r) { return (inp_element *)r->elements.items; }
static inline inp_set *inp_sets(const inp_reader *r) { return (inp_set *)r->sets.items; }
static inline inp_material *inp_materials(const inp_reader *r) { return (inp_material *)r->materials.items; }
static inline inp_section *inp_sections(const inp_reader *r) { return (inp_section *)r->sections.items; }
static inline inp_amplitude *inp_amplitudes(const inp_reader *r) { return (inp_amplitude *)r->amplitudes.items; }
static inline inp_entry *inp_entries(const inp_reader *r) { return (inp_entry *)r->entries.items; }
static inline inp_step *inp_steps(const inp_reader *r) { return (inp_step *)r->steps.items; }
static inline inp_term *inp_terms(const inp_reader *r) { return (inp_term *)r->terms.items; }
static inline inp_part *inp_parts(const inp_reader *r) { return (inp_part *)r->parts.items; }
static inline inp_spring *inp_springs(const inp_reader *r) { return (inp_spring *)r->springs.items; }
static inline inp_spring_section *inp_spring_sections(const inp_reader *r)
{
    return (inp_spring_section *)r->spring_sections.items;
}
static inline inp_instance *inp_instances(const inp_reader *r) { return (inp_instance *)r->instances.items; }

/* ---- words ------------------------------------------------------------------------------------------------- */

static inline char inp_upper(char letter)
{
    return letter >= 'a' && letter <= 'z' ? (char)(letter - 'a' + 'A') : letter;
}

static inline char *inp_trim(char *text)
{
    size_t length;
    text += strspn(text, " \t");
    length = strlen(text);
    while (length > 0 && strchr(" \t\r", text[length - 1]))
        length--;
    text[length] = 0;
    return text;
}

/* A name as it is compared: upper case, without quotes. */
static inline char *inp_name(char *text)
{
    size_t length;
    for (char *at = text; *at; at++)
        *at = inp_upper(*at);
    length = strlen(text);
    if (length > 1 && text[0] == '"' && text[length - 1] == '"') {
        text[length - 1] = 0;
        text++;
    }
    return text;
}

/* Capital letters without blanks, for keywords and parameters. */
static inline char *inp_squeeze(char *text)
{
    char *to = text;
    for (const char *at = text; *at; at++)
        if (*at != ' ' && *at != '\t')
            *to++ = inp_upper(*at);
    *to = 0;
    return text;
}

/* Entries of a data line between commas; of one without commas, between blanks. An empty one at the end is none. */
static inline int inp_split(inp_reader *r, char *line, char **fields)
{
    int count = 0, by_comma = strchr(line, ',') != NULL;
    while (*line) {
        char *end = line + strcspn(line, by_comma ? "," : " \t"), last = *end;
        *end = 0;
        if (count == INP_MAX_FIELDS) {
            inp_complain(r, r->here, "more than %d entries in a line", (int)INP_MAX_FIELDS);
            return count;
        }
        fields[count++] = inp_trim(line);
        line = last ? end + 1 : end;
        if (!by_comma)
            line += strspn(line, " \t");
    }
    return count;
}

static inline int inp_take_integer(inp_reader *r, const char *field, const char *what, int *value)
{
    if (case_scan_integer(field, value))
        return 1;
    inp_complain(r, r->here, "'%.40s' is no %s", field, what);
    return 0;
}

/* The label of a node or element. */
static inline int inp_take_label(inp_reader *r, const char *field, const char *what, int *label)
{
    if (!inp_take_integer(r, field, what, label))
        return 0;
    if (*label > 0)
        return 1;
    inp_complain(r, r->here, "%s %d must be > 0", what, *label);
    return 0;
}

/* The label of a node or element of the instance that the card is about, as it is counted here. */
static inline int inp_take_own(inp_reader *r, const char *field, int of_elements, int *label)
{
    const char *what = of_elements ? "element" : "node";
    int offset = r->instance >= 0 ? inp_instances(r)[r->instance].offset[of_elements] : 0;
    if (!inp_take_label(r, field, what, label))
        return 0;
    if (*label <= INT_MAX - offset) {
        *label += offset;
        return 1;
    }
    inp_complain(r, r->here, "%s %d, counted on from the %d of instances before, is too large", what, *label, offset);
    return 0;
}

/* A name, or a label as text, of the instance that the card is about, as one that counts for all. */
static inline const char *inp_scoped(inp_reader *r, const char *name)
{
    char whole[2 * INP_MAX_CARD];
    const char *instance = r->instance >= 0 ? inp_instances(r)[r->instance].name : "";
    if (!*instance || !*name)
        return name;
    if (snprintf(whole, sizeof whole, "%s.%s", instance, name) >= (int)sizeof whole)
        inp_complain(r, r->here, "the name %.40s has more than %d characters", name, (int)INP_MAX_CARD);
    return inp_keep(r, whole);
}

/* A number times 10^shift. */
static inline int inp_take_number(inp_reader *r, const char *field, int shift, double *value)
{
    if (foreign_scan_number(field, shift, value))
        return 1;
    inp_complain(r, r->here, "'%.40s' is no finite number", field);
    return 0;
}

static inline const char *inp_parameter_of(const inp_reader *r, const char *name)
{
    for (int i = 0; i < r->parameter_count; i++)
        if (strcmp(r->parameters[i].name, name) == 0)
            return r->parameters[i].value;
    return NULL;
}

/* The value of a parameter that must be there; "" and a complaint when it is not. */
static inline const char *inp_need(inp_reader *r, const char *name)
{
    const char *value = inp_parameter_of(r, name);
    if (value && *value)
        return value;
    inp_complain(r, r->card_place, "*%s needs %s=", r->card_name, name);
    return "";
}

/* ---- sets -------------------------------------------------------------------------------------------------- */

static inline int inp_find_set(const inp_reader *r, const char *name, int of_elements)
{
    for (int i = 0; i < r->sets.count; i++)
        if (inp_sets(r)[i].of_elements == of_elements && strcmp(inp_sets(r)[i].name, name) == 0)
            return i;
    return -1;
}

/* Makes the set the one that is being filled; it goes on where it is there already. */
static inline void inp_open_set(inp_reader *r, const char *name, int of_elements)
{
    inp_set *set;
    r->set = *name ? inp_find_set(r, name, of_elements) : -1;
    if (r->set >= 0 || !*name || !(set = (inp_set *)inp_add(r, &r->sets, sizeof *set)))
        return;
    r->set = r->sets.count - 1;
    name = inp_keep(r, name);
    set->name = name;
    set->of_elements = of_elements;
    set->nodes_of = -1;
    set->place = r->card_place;
}

/* Whether so many more labels may be in sets. */
static inline int inp_has_room(inp_reader *r, int more)
{
    if (more <= INP_MAX_SET_LABELS - r->set_labels)
        return 1;
    if (r->set_labels < INP_MAX_SET_LABELS)
        inp_complain(r, r->here, "the sets have more than %d labels", (int)INP_MAX_SET_LABELS);
    r->set_labels = INP_MAX_SET_LABELS; /* said once */
    return 0;
}

static inline void inp_add_to_set(inp_reader *r, int label)
{
    if (r->set < 0 || !inp_has_room(r, 1))
        return;
    inp_add_int(r, &inp_sets(r)[r->set].items, label);
    r->set_labels++;
}

/* The name of a set that the card makes: INSTANCE= says whose its labels are, the set is the assembly's. */
static inline const char *inp_scoped_set(inp_reader *r, const char *name)
{
    return r->instance == r->scope ? inp_scoped(r, name) : name;
}

static inline void inp_begin_set(inp_reader *r)
{
    int of_elements = strcmp(r->keyword->name, "ELSET") == 0;
    const char *elements = of_elements ? NULL : inp_parameter_of(r, "ELSET");
    inp_open_set(r, inp_scoped_set(r, inp_need(r, of_elements ? "ELSET" : "NSET")), of_elements);
    if (!elements || r->set < 0)
        return;
    inp_sets(r)[r->set].nodes_of = inp_find_set(r, inp_scoped(r, elements), 1);
    if (inp_sets(r)[r->set].nodes_of < 0)
        inp_complain(r, r->card_place, "there is no set of elements %.80s", elements);
}

/* Whether the text is INSTANCE.LABEL, and then its label as it is counted here; 0: beyond what there can be. */
static inline int inp_label_of_instance(const inp_reader *r, const char *text, int of_elements, int *label)
{
    for (int i = 0; i < r->instances.count; i++) {
        const inp_instance *instance = inp_instances(r) + i;
        size_t length = strlen(instance->name);
        int own;
        if (length == 0 || strncmp(text, instance->name, length) != 0 || text[length] != '.' ||
            !case_scan_integer(text + length + 1, &own))
            continue;
        *label = own > 0 && own <= INT_MAX - instance->offset[of_elements] ? own + instance->offset[of_elements] : 0;
        return 1;
    }
    return 0;
}

/* FIRST, LAST[, STEP] */
static inline void inp_generate(inp_reader *r, char **fields, int count)
{
    int of_elements = inp_sets(r)[r->set].of_elements, first, last, step = 1;
    if (count < 2 || count > 3) {
        inp_complain(r, r->here, "GENERATE takes FIRST, LAST[, STEP]");
        return;
    }
    if (!inp_take_own(r, fields[0], of_elements, &first) || !inp_take_own(r, fields[1], of_elements, &last) ||
        (count == 3 && !inp_take_integer(r, fields[2], "step", &step)))
        return;
    if (step < 1 || last < first)
        inp_complain(r, r->here, "from %d to %d by %d is no ascending row", first, last, step);
    else if (inp_has_room(r, (last - first) / step + 1))
        for (long long label = first; label <= last && !r->no_memory; label += step)
            inp_add_to_set(r, (int)label);
}

/* Numbers, and names of sets that are there. */
static inline void inp_data_set(inp_reader *r, char **fields, int count)
{
    int of_elements = strcmp(r->keyword->name, "ELSET") == 0, label;
    if (r->set < 0)
        return;
    if (inp_parameter_of(r, "GENERATE")) {
        inp_generate(r, fields, count);
        return;
    }
    for (int i = 0; i < count; i++) {
        int other;
        if (!*fields[i])
            continue;
        if (case_scan_integer(fields[i], &label)) {
            if (inp_take_own(r, fields[i], of_elements, &label))
                inp_add_to_set(r, label);
            continue;
        }
        if (inp_label_of_instance(r, inp_name(fields[i]), of_elements, &label)) {
            inp_add_to_set(r, label);
            continue;
        }
        other = inp_find_set(r, inp_scoped(r, inp_name(fields[i])), of_elements);
        if (other < 0)
            inp_complain(r, r->here, "there is no set %.80s before this line", fields[i]);
        if (other < 0 || other == r->set || !inp_has_room(r, inp_sets(r)[other].items.count))
            continue;
        for (int k = 0; k < inp_sets(r)[other].items.count && !r->no_memory; k++)
            inp_add_to_set(r, ((const int *)inp_sets(r)[other].items.items)[k]);
    }
}

/* ---- nodes and elements ------------------------------------------------------------------------------------ */

/* Nodes and elements of the assembly itself are counted on from those that are there when they begin. */
static inline void inp_begin_own(inp_reader *r)
{
    inp_instance *own = r->assembly >= 0 && r->instance == r->assembly ? inp_instances(r) + r->assembly : NULL;
    if (!own || own->has_own)
        return;
    own->has_own = 1;
    for (int k = 0; k < 2; k++)
        own->offset[k] = r->most[k];
}

static inline void inp_count_label(inp_reader *r, int of_elements, int label)
{
    if (label > r->most[of_elements])
        r->most[of_elements] = label;
}

/* Where a node of an instance is: moved first, then turned (Rodrigues). */
static inline sb_vec3 inp_moved(const inp_instance *i, sb_vec3 x)
{
    sb_vec3 arm, turned;
    x = sb_v3_add(x, i->move);
    if (i->sine == 0 && i->cosine == 1)
        return x;
    arm = sb_v3_sub(x, i->from);
    turned = sb_v3_scale((sb_real)i->cosine, arm);
    turned = sb_v3_madd(turned, (sb_real)i->sine, sb_v3_cross(i->axis, arm));
    turned = sb_v3_madd(turned, (sb_real)(1 - i->cosine) * sb_v3_dot(i->axis, arm), i->axis);
    return sb_v3_add(i->from, turned);
}

static inline void inp_begin_node(inp_reader *r)
{
    const char *set = inp_parameter_of(r, "NSET");
    r->set = -1;
    if (set)
        inp_open_set(r, inp_scoped(r, set), 0);
    inp_begin_own(r);
}

static inline void inp_data_node(inp_reader *r, char **fields, int count)
{
    inp_node *node;
    double x[3] = {0, 0, 0};
    int label;
    if (count < 2 || count > 4) {
        inp_complain(r, r->here, "a node has a number and three coordinates");
        return;
    }
    if (!inp_take_own(r, fields[0], 0, &label))
        return;
    for (int i = 1; i < count; i++)
        if (*fields[i] && !inp_take_number(r, fields[i], 0, x + i - 1))
            return;
    node = (inp_node *)inp_add(r, &r->nodes, sizeof *node);
    if (!node)
        return;
    node->label = label;
    node->x = sb_v3((sb_real)x[0], (sb_real)x[1], (sb_real)x[2]);
    if (r->instance >= 0)
        node->x = inp_moved(inp_instances(r) + r->instance, node->x);
    node->place = r->here;
    inp_count_label(r, 0, label);
    inp_add_to_set(r, label);
}

/* A spring element's lines come next; one that cannot be read is refused. 0: the type is no spring. */
static inline int inp_begin_spring_element(inp_reader *r, const char *type)
{
    r->spring_nodes = strcmp(type, "SPRING1") == 0 ? 1 : strcmp(type, "SPRING2") == 0 ? 2 : 0;
    if (strcmp(type, "SPRINGA") == 0 || strcmp(type, "SPRINGB") == 0) {
        inp_complain(r, r->card_place,
                     "elements %s are not read, only SPRING1 and SPRING2: their length at rest cannot be said here",
                     type);
        r->has_other_springs = 1;
        r->keyword = NULL;
        return 1;
    }
    return r->spring_nodes > 0;
}

/* NUMBER, NODE[, NODE] */
static inline void inp_data_spring_element(inp_reader *r, char **fields, int count)
{
    inp_spring *spring;
    int label;
    if (!inp_take_own(r, fields[0], 1, &label))
        return;
    if (count != 1 + r->spring_nodes) {
        inp_complain(r, r->here, "a SPRING%d has a number and %d node%s", r->spring_nodes, r->spring_nodes,
                     r->spring_nodes > 1 ? "s" : "");
        return;
    }
    inp_count_label(r, 1, label);
    inp_add_to_set(r, label);
    inp_add_int(r, &r->flat, label); /* no element of the mesh */
    spring = (inp_spring *)inp_add(r, &r->springs, sizeof *spring);
    if (!spring)
        return;
    spring->label = label;
    spring->count = r->spring_nodes;
    spring->section = spring->at[0] = spring->at[1] = -1;
    spring->place = r->here;
    for (int k = 0; k < spring->count; k++)
        spring->nodes[k] = inp_scoped(r, inp_name(fields[1 + k]));
}

static inline void inp_begin_element(inp_reader *r)
{
    const char *type = inp_need(r, "TYPE"), *set = inp_parameter_of(r, "ELSET");
    const foreign_element *element = foreign_find_element(type);
    r->set = -1;
    r->is_flat = foreign_is_flat(type);
    if (set)
        inp_open_set(r, inp_scoped(r, set), 1);
    inp_begin_own(r);
    if (inp_begin_spring_element(r, type))
        return;
    if (!element && !r->is_flat) {
        if (*type)
            inp_complain(r, r->card_place, "elements %.40s are not read, only C3D4, C3D8, C3D10 and C3D20", type);
        r->keyword = NULL;
    } else if (element && r->element && element != r->element) {
        inp_complain(r, r->card_place, "elements %s beside %s in %s:%d: a body has one type", type, r->element->inp,
                     r->element_place.path, r->element_place.line);
        r->keyword = NULL;
    } else if (element && !r->element) {
        r->element = element;
        r->element_place = r->card_place;
    }
}

/* Labels of nodes, on as many lines as it takes. */
static inline void inp_data_element(inp_reader *r, char **fields, int count)
{
    int at = 0, label;
    if (r->spring_nodes > 0) {
        inp_data_spring_element(r, fields, count);
        return;
    }
    if (r->is_flat) {
        if (r->wanted == 0 && count > 0 && inp_take_own(r, fields[0], 1, &label)) {
            inp_count_label(r, 1, label);
            inp_add_int(r, &r->flat, label);
            inp_add_to_set(r, label);
        }
        return;
    }
    if (r->wanted == 0) {
        inp_element *element;
        if (!inp_take_own(r, fields[at++], 1, &label) ||
            !(element = (inp_element *)inp_add(r, &r->elements, sizeof *element)))
            return;
        element->label = label;
        element->place = r->here;
        inp_count_label(r, 1, label);
        inp_add_to_set(r, label);
        r->wanted = sb_element_node_count(r->element->type);
    }
    for (; at < count; at++) {
        if (!*fields[at] && at == count - 1)
            continue;
        label = 1;
        if (r->wanted == 0) {
            inp_complain(r, r->here, "the element has more nodes than a %s", r->element->inp);
            return;
        }
        inp_take_own(r, fields[at], 0, &label);
        inp_add_int(r, &r->element_nodes, label);
        r->wanted--;
    }
}

/* What an element or equation still lacks when its card ends. */
static inline void inp_end_lines(inp_reader *r)
{
    if (r->wanted != 0 && r->keyword)
        inp_complain(r, r->data_place, "*%s ends in the middle: %d more entries are wanted", r->card_name,
                     abs(r->wanted));
    if (r->keyword && r->data_lines < r->keyword->least)
        inp_complain(r, r->card_place, r->data_lines == 0 ? "*%s has no data line" : "*%s has too few data lines",
                     r->card_name);
    for (; r->wanted > 0 && r->keyword && strcmp(r->keyword->name, "ELEMENT") == 0 && !r->no_memory; r->wanted--)
        inp_add_int(r, &r->element_nodes, 1);
    r->wanted = 0;
}

/* ---- materials --------------------------------------------------------------------------------------------- */

static inline inp_material *inp_last_material(inp_reader *r)
{
    return r->materials.count > 0 ? inp_materials(r) + r->materials.count - 1 : NULL;
}

static inline void inp_begin_material(inp_reader *r)
{
    const char *name = inp_need(r, "NAME");
    inp_material *m;
    for (int i = 0; i < r->materials.count; i++)
        if (strcmp(inp_materials(r)[i].name, name) == 0)
            inp_complain(r, r->card_place, "material %.80s is there already, from %s:%d", name,
                         inp_materials(r)[i].place.path, inp_materials(r)[i].place.line);
    name = inp_keep(r, name);
    m = (inp_material *)inp_add(r, &r->materials, sizeof *m);
    if (!m)
        return;
    m->name = name;
    m->place = r->card_place;
}

/* Marks the law of the present material; 0 when it has one. */
static inline int inp_take_law(inp_reader *r, int wanted)
{
    inp_material *m = inp_last_material(r);
    if (!m)
        return 0;
    if (m->law_place.path) {
        inp_complain(r, r->card_place, "material %.80s has a law already, from %s:%d", m->name, m->law_place.path,
                     m->law_place.line);
        r->keyword = NULL;
        return 0;
    }
    m->law_place = r->card_place;
    m->wanted = wanted;
    return 1;
}

static inline void inp_begin_elastic(inp_reader *r)
{
    const char *type = inp_parameter_of(r, "TYPE");
    if (type && strcmp(type, "ISO") != 0 && strcmp(type, "ISOTROPIC") != 0)
        inp_complain(r, r->card_place, "*ELASTIC, TYPE=%.40s is not understood, only ISO", type);
    inp_take_law(r, 2);
}

static inline void inp_begin_hyperelastic(inp_reader *r)
{
    const char *n = inp_parameter_of(r, "N"), *kind = NULL;
    const foreign_law *law = NULL;
    int terms = 0;
    for (int i = 0; i < r->parameter_count; i++)
        if (strcmp(r->parameters[i].name, "N") != 0)
            kind = kind ? "" : r->parameters[i].name; /* two kinds are none */
    if (n && !inp_take_integer(r, n, "number of terms", &terms))
        return;
    if (kind)
        law = foreign_find_law(kind, !n && strstr(kind, "POLYNOMIAL") ? 1 : terms);
    if (!law) {
        inp_complain(r, r->card_place,
                     "*HYPERELASTIC, %s%s%.4s is not understood, only NEO HOOKE, MOONEY-RIVLIN, POLYNOMIAL with N=1, "
                     "REDUCED POLYNOMIAL with N=1 to 3 and YEOH",
                     kind ? kind : "?", n ? ", N=" : "", n ? n : "");
        r->keyword = NULL;
        return;
    }
    if (inp_take_law(r, law->constants + foreign_volume_terms(law)))
        inp_last_material(r)->law = law;
}

static inline void inp_data_law(inp_reader *r, char **fields, int count)
{
    inp_material *m = inp_last_material(r);
    for (int i = 0; m && i < count; i++) {
        if (!*fields[i] && i == count - 1)
            continue;
        if (m->constant_count >= m->wanted) {
            inp_complain(r, r->here, "the law has %d constants; those that depend on temperature are not read",
                         m->wanted);
            return;
        }
        if (!inp_take_number(r, fields[i], 0, m->constants + m->constant_count))
            return;
        if (m->law && m->constant_count >= m->law->constants)
            inp_take_number(r, fields[i], r->shift, m->constants + m->constant_count); /* D: 1/Pa */
        else if (m->law || m->constant_count == 0)
            inp_take_number(r, fields[i], -r->shift, m->constants + m->constant_count);
        m->constant_count++;
    }
}

static inline void inp_data_density(inp_reader *r, char **fields, int count)
{
    inp_material *m = inp_last_material(r);
    if (!m || !inp_take_number(r, count > 0 ? fields[0] : "", -r->shift, &m->density))
        return;
    if (count > 1 && *fields[1])
        inp_complain(r, r->here, "a density that depends on temperature is not read");
    if (!(m->density > 0))
        inp_complain(r, r->here, "the density must be > 0");
}

static inline void inp_begin_section(inp_reader *r)
{
    const char *set = inp_keep(r, inp_scoped(r, inp_need(r, "ELSET")));
    const char *material = inp_keep(r, inp_need(r, "MATERIAL"));
    inp_section *section = (inp_section *)inp_add(r, &r->sections, sizeof *section);
    if (!section)
        return;
    section->set = set;
    section->material = material;
    section->place = r->card_place;
}

/* ---- equations, amplitudes, surfaces ----------------------------------------------------------------------- */

/* The number of terms, then NODE, AXIS, COEFFICIENT of each. */
static inline void inp_data_equation(inp_reader *r, char **fields, int count)
{
    static const int most = 100000;
    int terms, axis, at = 0;
    if (r->wanted == 0) {
        if (!inp_take_integer(r, count > 0 ? fields[0] : "", "number of terms", &terms))
            return;
        if (terms < 1 || terms > most || (count > 1 && *fields[1])) {
            inp_complain(r, r->here, "an equation begins with a line that has its number of terms, 1 to %d", most);
            return;
        }
        r->wanted = -terms; /* negative: the first term is still to come */
        return;
    }
    for (; at < count && r->wanted != 0; at += 3) {
        inp_term *term;
        if (!*fields[at] && at == count - 1)
            break;
        term = (inp_term *)inp_add(r, &r->terms, sizeof *term);
        if (!term)
            return;
        term->place = r->here;
        term->starts = r->wanted < 0;
        r->wanted = (r->wanted < 0 ? -r->wanted : r->wanted) - 1;
        term->target = inp_scoped(r, inp_name(fields[at]));
        if (at + 2 >= count) {
            inp_complain(r, r->here, "a term is NODE, AXIS, COEFFICIENT");
            return;
        }
        if (!inp_take_integer(r, fields[at + 1], "axis", &axis) ||
            !inp_take_number(r, fields[at + 2], 0, &term->coefficient))
            return;
        term->axis = axis - 1;
        if (axis < 1 || axis > 3)
            inp_complain(r, r->here, "axis %d must be 1, 2 or 3", axis);
    }
    if (at < count && *fields[at])
        inp_complain(r, r->here, "the line has more than the terms of its equation");
}

static inline const inp_amplitude *inp_find_amplitude(const inp_reader *r, const char *name)
{
    for (int i = 0; i < r->amplitudes.count; i++)
        if (strcmp(inp_amplitudes(r)[i].name, name) == 0)
            return inp_amplitudes(r) + i;
    return NULL;
}

static inline void inp_begin_amplitude(inp_reader *r)
{
    const char *name = inp_keep(r, inp_need(r, "NAME"));
    const inp_amplitude *before = inp_find_amplitude(r, name);
    inp_amplitude *amplitude;
    if (before)
        inp_complain(r, r->card_place, "amplitude %.80s is there already, from %s:%d", name, before->place.path,
                     before->place.line);
    amplitude = (inp_amplitude *)inp_add(r, &r->amplitudes, sizeof *amplitude);
    if (!amplitude)
        return;
    amplitude->name = name;
    amplitude->place = r->card_place;
}

static inline void inp_data_amplitude(inp_reader *r, char **fields, int count)
{
    inp_amplitude *amplitude = inp_amplitudes(r) + r->amplitudes.count - 1;
    for (int i = 0; i < count; i++) {
        double number;
        if ((!*fields[i] && i == count - 1) || !inp_take_number(r, fields[i], 0, &number))
            continue;
        if (amplitude->count < 8)
            amplitude->points[amplitude->count] = number;
        amplitude->count++;
    }
}

static inline void inp_begin_surface(inp_reader *r)
{
    const char *type = inp_parameter_of(r, "TYPE");
    r->of_nodes = type && strcmp(type, "NODE") == 0;
    if (type && !r->of_nodes && strcmp(type, "ELEMENT") != 0)
        inp_complain(r, r->card_place, "*SURFACE, TYPE=%.40s is not understood, only ELEMENT and NODE", type);
    r->surface = inp_keep(r, inp_scoped_set(r, inp_need(r, "NAME")));
    for (int i = 0; i < r->surface_items.count; i++)
        if (strcmp(((const inp_surface_item *)r->surface_items.items)[i].surface, r->surface) == 0) {
            inp_complain(r, r->card_place, "surface %.80s is there already", r->surface);
            break;
        }
}

/* The number of a face in text like P3 or S3, from 0; -1: it is none. */
static inline int inp_face(const char *text, char letter)
{
    return text[0] == letter && text[1] >= '1' && text[1] <= '6' && !text[2] ? text[1] - '1' : -1;
}

static inline void inp_data_surface(inp_reader *r, char **fields, int count)
{
    inp_surface_item *item;
    int face = count > 1 && !r->of_nodes ? inp_face(inp_name(fields[1]), 'S') : -1;
    if (face < 0 && !r->of_nodes) {
        inp_complain(r, r->here, "a line of a surface is ELEMENTS, S1 to S6");
        return;
    }
    item = (inp_surface_item *)inp_add(r, &r->surface_items, sizeof *item);
    if (!item)
        return;
    item->surface = r->surface;
    item->target = inp_scoped(r, inp_name(fields[0]));
    item->face = face;
}

static inline void inp_begin_tie(inp_reader *r)
{
    const char *adjust = inp_parameter_of(r, "ADJUST");
    if (!adjust || strcmp(adjust, "NO") != 0)
        inp_note(r, r->card_place, "slave nodes of *TIE stay where they are, as with ADJUST=NO");
}

/* SLAVE, MASTER */
static inline void inp_data_tie(inp_reader *r, char **fields, int count)
{
    const char *distance = inp_parameter_of(r, "POSITIONTOLERANCE");
    inp_tie *tie = (inp_tie *)inp_add(r, &r->ties, sizeof *tie);
    if (!tie)
        return;
    tie->place = r->here;
    tie->slave = inp_name(fields[0]);
    tie->master = count > 1 ? inp_name(fields[1]) : "";
    if (count != 2)
        inp_complain(r, r->here, "a line of *TIE is SLAVE SURFACE, MASTER SURFACE");
    if (distance && inp_take_number(r, distance, 0, &tie->distance) && !(tie->distance > 0))
        inp_complain(r, r->card_place, "POSITION TOLERANCE must be > 0");
}

/* ---- springs ----------------------------------------------------------------------------------------------- */

static inline void inp_begin_spring(inp_reader *r)
{
    const char *set = inp_keep(r, inp_scoped(r, inp_need(r, "ELSET")));
    inp_spring_section *section;
    if (r->has_other_springs) {
        r->keyword = NULL;
        return;
    }
    section = (inp_spring_section *)inp_add(r, &r->spring_sections, sizeof *section);
    if (!section)
        return;
    section->set = set;
    section->axes[0] = section->axes[1] = -1;
    section->is_table = inp_parameter_of(r, "NONLINEAR") != NULL;
    section->place = r->card_place;
}

/* AXIS[, AXIS] */
static inline void inp_take_spring_axes(inp_reader *r, inp_spring_section *s, char **fields, int count)
{
    if (count > 2) {
        inp_complain(r, r->here, "the first line of *SPRING is AXIS, or AXIS, AXIS of the two nodes");
        return;
    }
    for (int k = 0; k < count; k++) {
        int axis;
        if (!inp_take_integer(r, fields[k], "axis", &axis))
            return;
        if (axis < 1 || axis > 3) {
            inp_complain(r, r->here, "axis %d of a spring must be 1, 2 or 3", axis);
            return;
        }
        s->axes[s->axis_count++] = axis - 1;
    }
}

/* FORCE, DISPLACEMENT: a point of a straight line through 0. */
static inline void inp_take_spring_point(inp_reader *r, inp_spring_section *s, char **fields, int count)
{
    double force, u, slope;
    if (count != 2) {
        inp_complain(r, r->here, "a line of *SPRING, NONLINEAR is FORCE, DISPLACEMENT");
        return;
    }
    if (!inp_take_number(r, fields[0], -r->shift, &force) || !inp_take_number(r, fields[1], 0, &u))
        return;
    s->least = fmin(s->least, u);
    s->most = fmax(s->most, u);
    slope = u != 0 ? force / u : 0;
    if (s->stiffness == 0)
        s->stiffness = slope;
    /* as far as printed digits go */
    if (u != 0 ? fabs(slope - s->stiffness) > 1e-6 * fabs(s->stiffness) : force != 0)
        inp_complain(r, r->here, "the table of *SPRING is no straight line through 0: only those are read");
}

/* The axes, then the stiffness, or with NONLINEAR a table of it. */
static inline void inp_data_spring(inp_reader *r, char **fields, int count)
{
    inp_spring_section *s = r->spring_sections.count > 0 ? inp_spring_sections(r) + r->spring_sections.count - 1 : NULL;
    if (!s)
        return;
    if (r->data_lines == 1)
        inp_take_spring_axes(r, s, fields, count);
    else if (s->is_table)
        inp_take_spring_point(r, s, fields, count);
    else if (r->data_lines > 2 || count != 1)
        inp_complain(r, r->here, "a stiffness that depends on frequency or temperature is not read");
    else if (inp_take_number(r, fields[0], -r->shift, &s->stiffness) && !(s->stiffness > 0))
        inp_complain(r, r->here, "the stiffness of a spring must be > 0");
}

/* ---- supports and loads ------------------------------------------------------------------------------------ */

/* OP= and AMPLITUDE= of a card. */
static inline void inp_begin_entries(inp_reader *r)
{
    const char *op = inp_parameter_of(r, "OP"), *amplitude = inp_parameter_of(r, "AMPLITUDE");
    inp_entry *entry;
    r->fresh = op && strcmp(op, "NEW") == 0;
    r->amplitude = amplitude ? inp_keep(r, amplitude) : NULL;
    if (op && !r->fresh && strcmp(op, "MOD") != 0)
        inp_complain(r, r->card_place, "OP=%.40s is not understood, only NEW and MOD", op);
    if (r->fresh && !r->in_step)
        inp_complain(r, r->card_place, "OP=NEW before the first step");
    if (!r->fresh || !(entry = (inp_entry *)inp_add(r, &r->entries, sizeof *entry)))
        return;
    entry->kind = strcmp(r->keyword->name, "BOUNDARY") == 0 ? INP_BOUNDARY
                  : strcmp(r->keyword->name, "CLOAD") == 0  ? INP_CLOAD
                                                            : INP_PRESSURE;
    entry->step = r->step;
    entry->fresh = 1;
    entry->place = r->card_place;
}

static inline inp_entry *inp_add_entry(inp_reader *r, inp_kind kind, const char *target)
{
    inp_entry *entry = (inp_entry *)inp_add(r, &r->entries, sizeof *entry);
    if (!entry)
        return NULL;
    entry->kind = kind;
    entry->step = r->in_step ? r->step : 0;
    entry->target = target;
    entry->amplitude = r->amplitude;
    entry->place = r->here;
    return entry;
}

/* Axes that a word like ENCASTRE holds, as bits; 0: there is no such word. Rotations are none of a solid. */
static inline int inp_named_axes(const char *word)
{
    static const struct {
        const char *name;
        int axes;
    } names[] = {{"ENCASTRE", 7}, {"PINNED", 7}, {"XSYMM", 1},  {"YSYMM", 2},
                 {"ZSYMM", 4},    {"XASYMM", 6}, {"YASYMM", 5}, {"ZASYMM", 3}};
    for (int i = 0; i < (int)(sizeof names / sizeof names[0]); i++)
        if (strcmp(names[i].name, word) == 0)
            return names[i].axes;
    return 0;
}

/* NODES, FIRST AXIS[, LAST AXIS[, VALUE]], or NODES, NAME. */
static inline void inp_data_boundary(inp_reader *r, char **fields, int count)
{
    int first, last, axes = count == 2 ? inp_named_axes(inp_name(fields[1])) : 0;
    double value = 0;
    inp_entry *entry;
    const char *target = inp_scoped(r, inp_name(fields[0]));
    for (int axis = 0; axis < 3 && axes; axis++)
        if (axes >> axis & 1 && (entry = inp_add_entry(r, INP_BOUNDARY, target)) != NULL)
            entry->first = entry->last = axis;
    if (axes)
        return;
    if (count < 2 || count > 4) {
        inp_complain(r, r->here, "a line of *BOUNDARY is NODES, FIRST AXIS[, LAST AXIS[, VALUE]]");
        return;
    }
    if (!inp_take_integer(r, fields[1], "axis", &first))
        return;
    last = first;
    if (count > 2 && *fields[2] && !inp_take_integer(r, fields[2], "axis", &last))
        return;
    if (count > 3 && *fields[3] && !inp_take_number(r, fields[3], 0, &value))
        return;
    if (first < 1 || last < first || last > 6) {
        inp_complain(r, r->here, "axes %d to %d: a solid has axes 1 to 3 (and 4 to 6, which do nothing)", first, last);
        return;
    }
    if (value != 0 && !r->in_step)
        inp_complain(r, r->here, "a displacement other than 0 must be within a *STEP");
    if (first > 3)
        return;
    entry = inp_add_entry(r, INP_BOUNDARY, target);
    if (!entry)
        return;
    entry->first = first - 1;
    entry->last = (last < 3 ? last : 3) - 1;
    entry->value = value;
}

/* NODES, AXIS, FORCE */
static inline void inp_data_cload(inp_reader *r, char **fields, int count)
{
    inp_entry *entry;
    int axis;
    double value;
    if (count != 3) {
        inp_complain(r, r->here, "a line of *CLOAD is NODES, AXIS, FORCE");
        return;
    }
    if (!inp_take_integer(r, fields[1], "axis", &axis) || !inp_take_number(r, fields[2], -r->shift, &value))
        return;
    if (axis < 1 || axis > 3) {
        inp_complain(r, r->here, "axis %d of a force must be 1, 2 or 3", axis);
        return;
    }
    entry = inp_add_entry(r, INP_CLOAD, inp_name(fields[0]));
    if (!entry)
        return;
    entry->first = entry->last = axis - 1;
    entry->value = value;
}

/* ELEMENTS, GRAV, G, X, Y, Z */
static inline void inp_take_gravity(inp_reader *r, char **fields, int count)
{
    inp_entry *entry = inp_add_entry(r, INP_GRAVITY, inp_name(fields[0]));
    double length;
    if (!entry)
        return;
    if (count != 6) {
        inp_complain(r, r->here, "gravity is ELEMENTS, GRAV, ACCELERATION, X, Y, Z");
        return;
    }
    if (!inp_take_number(r, fields[2], 0, &entry->value))
        return;
    for (int i = 0; i < 3; i++)
        if (!inp_take_number(r, fields[3 + i], 0, entry->direction + i))
            return;
    length = sqrt(entry->direction[0] * entry->direction[0] + entry->direction[1] * entry->direction[1] +
                  entry->direction[2] * entry->direction[2]);
    if (!(length > 0) || length > 1e300)
        inp_complain(r, r->here, "the direction of gravity has no length");
    for (int i = 0; i < 3 && length > 0; i++)
        entry->direction[i] /= length;
}

static inline void inp_data_dload(inp_reader *r, char **fields, int count)
{
    int of_surface = strcmp(r->keyword->name, "DSLOAD") == 0, face;
    double value;
    char *label = count > 1 ? inp_name(fields[1]) : NULL;
    inp_entry *entry;
    if (label && !of_surface && strcmp(label, "GRAV") == 0) {
        inp_take_gravity(r, fields, count);
        return;
    }
    face = !label ? -1 : of_surface ? (strcmp(label, "P") == 0 ? 0 : -1) : inp_face(label, 'P');
    if (face < 0) {
        inp_complain(r, r->here, "load %.20s is not understood, only %s", label ? label : "?",
                     of_surface ? "P" : "P1 to P6 and GRAV");
        return;
    }
    if (count != 3) {
        inp_complain(r, r->here, "a pressure is %s, %s, VALUE", of_surface ? "SURFACE" : "ELEMENTS", label);
        return;
    }
    if (!inp_take_number(r, fields[2], -r->shift, &value))
        return;
    entry = inp_add_entry(r, of_surface ? INP_SURFACE_PRESSURE : INP_PRESSURE, inp_name(fields[0]));
    if (!entry)
        return;
    entry->first = entry->last = face;
    entry->value = value;
}

/* ---- steps ------------------------------------------------------------------------------------------------- */

static inline void inp_begin_step(inp_reader *r)
{
    const char *nonlinear = inp_parameter_of(r, "NLGEOM"), *amplitude = inp_parameter_of(r, "AMPLITUDE");
    int is_on = nonlinear && strcmp(nonlinear, "NO") != 0;
    inp_step *step = (inp_step *)inp_add(r, &r->steps, sizeof *step);
    if (!step)
        return;
    if (nonlinear && *nonlinear && strcmp(nonlinear, "YES") != 0 && strcmp(nonlinear, "NO") != 0)
        inp_complain(r, r->card_place, "NLGEOM=%.20s is not understood, only YES and NO", nonlinear);
    if (amplitude && strcmp(amplitude, "RAMP") != 0 && strcmp(amplitude, "STEP") != 0)
        inp_complain(r, r->card_place, "AMPLITUDE=%.20s is not understood, only RAMP and STEP", amplitude);
    if (r->step > 0 && is_on != r->nonlinear)
        inp_complain(r, r->card_place, "NLGEOM must be the same in all steps");
    step->place = r->card_place;
    step->period = 1;
    step->ramps = amplitude && strcmp(amplitude, "RAMP") == 0;
    r->step = r->steps.count;
    r->in_step = 1;
    r->nonlinear = is_on;
    r->step_place = r->card_place;
}

static inline void inp_end_step(inp_reader *r)
{
    r->in_step = 0;
    if (!inp_steps(r)[r->step - 1].procedure)
        inp_complain(r, r->card_place, "the step has no *STATIC, *DYNAMIC or *FREQUENCY");
}

/* Several steps are one: static ones whose last state is wanted. */
static inline void inp_begin_procedure(inp_reader *r)
{
    if (r->procedure && (r->procedure != r->keyword || strcmp(r->keyword->name, "STATIC") != 0))
        inp_complain(r, r->card_place, "*%s after *%s in %s:%d: a case has one solve", r->keyword->name,
                     r->procedure->name, r->procedure_place.path, r->procedure_place.line);
    inp_steps(r)[r->step - 1].procedure = r->procedure = r->keyword;
    r->procedure_place = r->card_place;
    r->time_count = 0;
    r->direct = inp_parameter_of(r, "DIRECT") != NULL;
    r->alpha = inp_parameter_of(r, "ALPHA");
    if (r->alpha)
        r->alpha = inp_keep(r, r->alpha);
}

static inline void inp_data_procedure(inp_reader *r, char **fields, int count)
{
    if (count > 4)
        inp_complain(r, r->here, "the line of *%s has more than four numbers", r->card_name);
    for (int i = 0; i < count && i < 4; i++) {
        r->times[i] = 0;
        if (*fields[i] && !inp_take_number(r, fields[i], 0, r->times + i))
            return;
        if (r->times[i] < 0)
            inp_complain(r, r->here, "*%s with the number %g, which must be >= 0", r->card_name, r->times[i]);
        r->time_count = i + 1;
    }
    if (r->time_count > 1 && r->times[1] > 0)
        inp_steps(r)[r->step - 1].period = r->times[1];
}

/* The first number is how far forces may be out of balance. */
static inline void inp_data_controls(inp_reader *r, char **fields, int count)
{
    if (r->data_lines > 1 || count < 1)
        return;
    if (inp_take_number(r, fields[0], 0, &r->tolerance) && !(r->tolerance > 0 && r->tolerance < 1))
        inp_complain(r, r->here, "the tolerance %g must be between 0 and 1", r->tolerance);
}

static inline void inp_begin_controls(inp_reader *r)
{
    const char *parameters = inp_parameter_of(r, "PARAMETERS");
    if (!parameters || strcmp(parameters, "FIELD") == 0)
        return;
    inp_note(r, r->card_place, "*CONTROLS, PARAMETERS=%s is left out: the solver has its own", parameters);
    r->keyword = NULL;
}

static inline void inp_begin_print(inp_reader *r)
{
    const char *set = inp_parameter_of(r, "NSET");
    r->printed = set ? inp_keep(r, set) : NULL;
}

static inline void inp_data_print(inp_reader *r, char **fields, int count)
{
    for (int i = 0; i < count; i++) {
        const char *what = inp_name(fields[i]), **probe;
        r->wants_reactions |= strcmp(what, "RF") == 0;
        r->wants_stresses |= strcmp(what, "S") == 0;
        if (strcmp(what, "U") == 0 && r->printed && (probe = (const char **)inp_add(r, &r->probes, sizeof *probe)))
            *probe = r->printed;
    }
}

/* ---- parts and instances ------------------------------------------------------------------------------------ */

static inline const inp_part *inp_find_part(const inp_reader *r, const char *name)
{
    for (int i = 0; i < r->parts.count; i++)
        if (strcmp(inp_parts(r)[i].name, name) == 0)
            return inp_parts(r) + i;
    return NULL;
}

static inline int inp_find_instance(const inp_reader *r, const char *name)
{
    for (int i = 0; i < r->instances.count; i++)
        if (*name && strcmp(inp_instances(r)[i].name, name) == 0)
            return i;
    return -1;
}

/* Whether the line, up to its end or a comma, is this keyword. */
static inline int inp_is_keyword(const char *line, const char *name)
{
    line += strspn(line, " \t");
    if (*line++ != '*')
        return 0;
    for (; *line && !strchr(",\r\n", *line); line++)
        if (*line != ' ' && *line != '\t' && inp_upper(*line) != *name++)
            return 0;
    return *name == 0;
}

/* Passes over the lines up to *END PART and returns where that begins; NULL: it is not there. */
static inline char *inp_pass_part(inp_source *source)
{
    char *at = source->cursor, *end;
    for (; *at && !inp_is_keyword(at, "ENDPART"); source->line++) {
        at += strcspn(at, "\n");
        at += *at == '\n';
    }
    end = at + strcspn(at, "\n");
    source->cursor = *end ? end + 1 : end;
    source->line += *at != 0;
    return *at ? at : NULL;
}

/* Keeps the lines up to *END PART. */
static inline void inp_begin_part(inp_reader *r)
{
    inp_source *source = r->depth > 0 ? inp_sources(r) + r->stack[r->depth - 1] : NULL;
    const char *name = inp_keep(r, inp_need(r, "NAME"));
    char *first = source ? source->cursor : NULL, *end;
    inp_place before = r->here;
    inp_part *part;
    if (!source || source->pending) {
        inp_complain(r, r->card_place, "the *PART's keyword line ends in a comma");
        return;
    }
    if (inp_find_part(r, name))
        inp_complain(r, r->card_place, "part %.80s is there already", name);
    if (r->scope >= 0 || r->assembly >= 0)
        inp_complain(r, r->card_place, "*PART within an *ASSEMBLY");
    end = inp_pass_part(source);
    if (!end)
        inp_complain(r, r->card_place, "the *PART has no *END PART: the file may be cut off");
    else
        *end = 0;
    part = (inp_part *)inp_add(r, &r->parts, sizeof *part);
    if (!part)
        return;
    part->name = name;
    part->before = before;
    part->text = inp_keep(r, first);
}

static inline inp_instance *inp_add_instance(inp_reader *r, const char *name)
{
    inp_instance *instance = (inp_instance *)inp_add(r, &r->instances, sizeof *instance);
    if (!instance)
        return NULL;
    instance->name = name;
    instance->cosine = 1;
    for (int k = 0; k < 2; k++)
        instance->offset[k] = r->most[k];
    return instance;
}

static inline void inp_begin_assembly(inp_reader *r)
{
    if (r->instances.count > 0)
        inp_complain(r, r->card_place, "there is an *ASSEMBLY already");
    else if (inp_add_instance(r, ""))
        r->assembly = 0;
}

static inline void inp_end_assembly(inp_reader *r)
{
    if (r->assembly < 0 || r->scope >= 0)
        inp_complain(r, r->card_place, "*END ASSEMBLY without its *ASSEMBLY");
    r->assembly = -1;
}

/* The part's lines come when those that say where it is have been read. */
static inline void inp_begin_instance(inp_reader *r)
{
    const char *name = inp_keep(r, inp_need(r, "NAME"));
    const inp_part *part = inp_find_part(r, inp_need(r, "PART"));
    if (r->assembly < 0 || r->scope >= 0)
        inp_complain(r, r->card_place, "*INSTANCE outside an *ASSEMBLY, or within another");
    else if (inp_find_instance(r, name) >= 0)
        inp_complain(r, r->card_place, "instance %.80s is there already", name);
    else if (!part)
        inp_complain(r, r->card_place, "there is no part %.80s", inp_parameter_of(r, "PART"));
    else if (inp_add_instance(r, name)) {
        r->scope = r->instances.count - 1;
        r->opening = part;
    }
}

/* DX, DY, DZ, then AX, AY, AZ, BX, BY, BZ, ANGLE: from A to B goes the axis, degrees. */
static inline void inp_data_instance(inp_reader *r, char **fields, int count)
{
    double x[7] = {0, 0, 0, 0, 0, 0, 0}, length, angle;
    int turns = r->data_lines == 2;
    inp_instance *i;
    sb_vec3 axis;
    if (!r->opening)
        return;
    i = inp_instances(r) + r->scope;
    if (count > (turns ? 7 : 3))
        inp_complain(r, r->here, "an instance is placed by DX, DY, DZ and a line AX, AY, AZ, BX, BY, BZ, ANGLE");
    for (int k = 0; k < count && k < (turns ? 7 : 3); k++)
        if (*fields[k] && !inp_take_number(r, fields[k], 0, x + k))
            return;
    if (!turns) {
        i->move = sb_v3((sb_real)x[0], (sb_real)x[1], (sb_real)x[2]);
        return;
    }
    axis = sb_v3((sb_real)(x[3] - x[0]), (sb_real)(x[4] - x[1]), (sb_real)(x[5] - x[2]));
    length = (double)sb_v3_norm(axis);
    if (!(length > 0) || length > 1e30)
        inp_complain(r, r->here, "the axis of an instance has no length");
    else
        i->axis = sb_v3_scale((sb_real)(1 / length), axis);
    i->from = sb_v3((sb_real)x[0], (sb_real)x[1], (sb_real)x[2]);
    angle = fmod(x[6], 360) * (3.14159265358979323846 / 180);
    i->sine = sin(angle);
    i->cosine = cos(angle);
}

static inline void inp_end_instance(inp_reader *r)
{
    if (r->scope < 0)
        inp_complain(r, r->card_place, "*END INSTANCE without its *INSTANCE");
    r->scope = -1;
}

/* What the card is about: what INSTANCE= names, or where it stands. */
static inline void inp_find_scope(inp_reader *r)
{
    const char *name = inp_parameter_of(r, "INSTANCE");
    r->instance = r->scope >= 0 ? r->scope : r->assembly;
    if (!name)
        return;
    r->instance = inp_find_instance(r, name);
    if (r->instance < 0)
        inp_complain(r, r->card_place, "there is no instance %.80s", name);
}

/* ---- the table of keywords --------------------------------------------------------------------------------- */

static const inp_keyword inp_keywords[] = {
    {"NODE", " NSET ", INP_IN_MODEL, inp_begin_node, inp_data_node, 0, 0},
    {"ELEMENT", " TYPE ELSET ", INP_IN_MODEL, inp_begin_element, inp_data_element, 0, 0},
    {"NSET", " NSET GENERATE ELSET UNSORTED INTERNAL INSTANCE ", INP_ANYWHERE, inp_begin_set, inp_data_set, 0, 0},
    {"ELSET", " ELSET GENERATE UNSORTED INTERNAL INSTANCE ", INP_ANYWHERE, inp_begin_set, inp_data_set, 0, 0},
    {"PART", " NAME ", INP_IN_MODEL, inp_begin_part, NULL, 0, 0},
    {"ASSEMBLY", " NAME ", INP_IN_MODEL, inp_begin_assembly, NULL, 0, 0},
    {"ENDASSEMBLY", " ", INP_IN_MODEL, inp_end_assembly, NULL, 0, 0},
    {"INSTANCE", " NAME PART ", INP_IN_MODEL, inp_begin_instance, inp_data_instance, 0, 2},
    {"ENDINSTANCE", " ", INP_IN_MODEL, inp_end_instance, NULL, 0, 0},
    {"SURFACE", " NAME TYPE INTERNAL ", INP_IN_MODEL, inp_begin_surface, inp_data_surface, 1, 0},
    {"TIE", " NAME ADJUST POSITIONTOLERANCE ", INP_IN_MODEL, inp_begin_tie, inp_data_tie, 1, 0},
    {"SPRING", " ELSET NONLINEAR ", INP_IN_MODEL, inp_begin_spring, inp_data_spring, 2, 0},
    {"MATERIAL", " NAME ", INP_IN_MODEL, inp_begin_material, NULL, 0, 0},
    {"ELASTIC", " TYPE ", INP_IN_MATERIAL, inp_begin_elastic, inp_data_law, 1, 0},
    {"HYPERELASTIC", NULL, INP_IN_MATERIAL, inp_begin_hyperelastic, inp_data_law, 1, 0},
    {"DENSITY", " ", INP_IN_MATERIAL, NULL, inp_data_density, 1, 1},
    {"SOLIDSECTION", " ELSET MATERIAL ", INP_IN_MODEL, inp_begin_section, NULL, 0, 1},
    {"EQUATION", " ", INP_IN_MODEL, NULL, inp_data_equation, 1, 0},
    {"AMPLITUDE", " NAME ", INP_IN_MODEL, inp_begin_amplitude, inp_data_amplitude, 1, 0},
    {"BOUNDARY", " OP AMPLITUDE ", INP_IN_MODEL | INP_IN_STEP, inp_begin_entries, inp_data_boundary, 0, 0},
    {"CLOAD", " OP AMPLITUDE ", INP_IN_STEP, inp_begin_entries, inp_data_cload, 0, 0},
    {"DLOAD", " OP AMPLITUDE ", INP_IN_STEP, inp_begin_entries, inp_data_dload, 0, 0},
    {"DSLOAD", " OP AMPLITUDE ", INP_IN_STEP, inp_begin_entries, inp_data_dload, 0, 0},
    {"STEP", " NLGEOM INC AMPLITUDE NAME ", INP_IN_MODEL, inp_begin_step, NULL, 0, 0},
    {"STATIC", " DIRECT SOLVER ", INP_IN_STEP, inp_begin_procedure, inp_data_procedure, 0, 1},
    {"DYNAMIC", " DIRECT ALPHA SOLVER ", INP_IN_STEP, inp_begin_procedure, inp_data_procedure, 1, 1},
    {"FREQUENCY", " SOLVER EIGENSOLVER ", INP_IN_STEP, inp_begin_procedure, inp_data_procedure, 1, 1},
    {"CONTROLS", " PARAMETERS ", INP_IN_STEP, inp_begin_controls, inp_data_controls, 0, 0},
    {"ENDSTEP", " ", INP_IN_STEP, inp_end_step, NULL, 0, 0},
    {"NODEPRINT", NULL, INP_IN_STEP, inp_begin_print, inp_data_print, 0, 0},
    {"ELPRINT", NULL, INP_IN_STEP, NULL, inp_data_print, 0, 0},
    {"NODEFILE", NULL, INP_IN_STEP, NULL, inp_data_print, 0, 0},
    {"ELFILE", NULL, INP_IN_STEP, NULL, inp_data_print, 0, 0},
    {"NODEOUTPUT", NULL, INP_IN_STEP, NULL, inp_data_print, 0, 0},
    {"ELEMENTOUTPUT", NULL, INP_IN_STEP, NULL, inp_data_print, 0, 0},
    {"OUTPUT", NULL, INP_IN_STEP, NULL, NULL, 0, 0},
    {"ENERGYOUTPUT", NULL, INP_IN_STEP, NULL, NULL, 0, 0},
    {"MONITOR", NULL, INP_IN_STEP, NULL, NULL, 0, 0},
    {"HEADING", NULL, INP_IN_MODEL, NULL, NULL, 0, 0},
    {"PREPRINT", NULL, INP_IN_MODEL, NULL, NULL, 0, 0},
    {"RESTART", NULL, INP_IN_MODEL | INP_IN_STEP, NULL, NULL, 0, 0},
};
enum { INP_KEYWORD_COUNT = (int)(sizeof inp_keywords / sizeof inp_keywords[0]) };

/* ---- lines ------------------------------------------------------------------------------------------------- */

/* Opens a file below the one that is being read, or lines of one behind its first `line`; text and path live as long as
 * the reader. */
static inline void inp_open(inp_reader *r, char *path, char *text, int line)
{
    int is_more = r->depth == INP_MAX_DEPTH || r->sources.count == INP_MAX_FILES;
    inp_source *source = is_more ? NULL : (inp_source *)inp_add(r, &r->sources, sizeof *source);
    if (!source) {
        if (is_more)
            inp_complain(r, r->card_place, "files and instances are more than %d deep, or more than %d of them",
                         (int)INP_MAX_DEPTH - 1, (int)INP_MAX_FILES - 1);
        free(path);
        free(text);
        return;
    }
    source->text = source->cursor = text;
    source->path = path;
    source->line = line;
    r->stack[r->depth++] = r->sources.count - 1;
}

/* Reads the part of an instance before `line`, which then comes again. */
static inline void inp_open_part(inp_reader *r, char *line)
{
    const inp_part *part = r->opening;
    size_t size = strlen(part->text) + 1, path_size = strlen(part->before.path) + 1;
    char *text = (char *)inp_allocate(r, size, 1), *path = (char *)inp_allocate(r, path_size, 1);
    r->opening = NULL;
    inp_sources(r)[r->stack[r->depth - 1]].pending = line;
    if (text && path) {
        memcpy(text, part->text, size);
        memcpy(path, part->before.path, path_size);
        inp_open(r, path, text, part->before.line);
    } else {
        free(text);
        free(path);
    }
}

/* 1 for a path that stays within the folder of the case. */
static inline int inp_is_within(const char *name)
{
    if (!*name || *name == '/' || strchr(name, '\\') || strchr(name, ':'))
        return 0;
    for (const char *at = name; at; at = strchr(at, '/') ? strchr(at, '/') + 1 : NULL)
        if (strncmp(at, "..", 2) == 0 && (!at[2] || at[2] == '/'))
            return 0;
    return 1;
}

static inline void inp_include(inp_reader *r)
{
    const char *name = inp_need(r, "INPUT"), *reason = "out of memory";
    char *path, *text;
    if (!*name)
        return;
    if (!inp_is_within(name)) {
        inp_complain(r, r->card_place, "%.200s is outside the folder of the model: not included", name);
        return;
    }
    path = case_input_path(r->c, name);
    for (int i = 0; path && i < r->depth; i++)
        if (strcmp(inp_sources(r)[r->stack[i]].path, path) == 0) {
            inp_complain(r, r->card_place, "%.200s includes itself", name);
            free(path);
            return;
        }
    text = path ? case_read_text(path, &reason) : NULL;
    if (text) {
        inp_open(r, path, text, 0);
    } else {
        inp_complain(r, r->card_place, "%.200s: %s", name, reason);
        free(path);
    }
}

/* The next line that is no comment and not empty, without blanks around it; NULL at the end. */
static inline char *inp_next_line(inp_reader *r)
{
    while (r->depth > 0) {
        inp_source *source = inp_sources(r) + r->stack[r->depth - 1];
        char *line = source->pending ? source->pending : source->cursor, *end;
        r->here.path = source->path;
        r->here.line = source->line;
        if (source->pending) {
            source->pending = NULL;
            return line;
        }
        end = line + strcspn(line, "\n");
        if (!*line) {
            r->depth--;
            continue;
        }
        source->cursor = *end ? end + 1 : end;
        *end = 0;
        r->here.line = ++source->line;
        line = inp_trim(line);
        if (strncmp(line, "**", 2) == 0) {
            if (!r->seen_card && strstr(line, foreign_units))
                r->shift = FOREIGN_UNIT;
            continue;
        }
        if (*line)
            return line;
    }
    return NULL;
}

/* Cuts r->card into name and parameters. */
static inline void inp_cut_card(inp_reader *r)
{
    char *at = r->card + 1, *end;
    r->parameter_count = 0;
    for (int first = 1; at; first = 0) {
        int quoted = 0;
        char *value, *next = NULL;
        for (end = at; *end && (quoted || *end != ','); end++)
            quoted ^= *end == '"';
        if (*end)
            next = end + 1;
        *end = 0;
        at = inp_trim(at);
        value = strchr(at, '=');
        if (value)
            *value++ = 0;
        if (first) {
            r->card_name = inp_squeeze(at);
        } else if (*at && r->parameter_count == INP_MAX_PARAMETERS) {
            inp_complain(r, r->card_place, "more than %d parameters", (int)INP_MAX_PARAMETERS);
        } else if (*at) {
            inp_parameter *p = r->parameters + r->parameter_count++;
            p->name = inp_squeeze(at);
            value = value ? inp_trim(value) : NULL;
            p->value = !value ? "" : strcmp(p->name, "INPUT") == 0 ? value : inp_name(value);
        }
        at = next;
    }
}

/* Takes a keyword line and those that go on with it. */
static inline void inp_take_card(inp_reader *r, char *line)
{
    size_t used = 0;
    inp_end_lines(r);
    r->card_place = r->here;
    while (line) {
        size_t length = strlen(line);
        if (length >= sizeof r->card - used) {
            inp_complain(r, r->card_place, "the keyword line has more than %d characters", (int)INP_MAX_CARD - 1);
            line[length = sizeof r->card - used - 1] = 0;
        }
        memcpy(r->card + used, line, length + 1);
        used += length;
        if (used == 0 || r->card[used - 1] != ',')
            break;
        line = inp_next_line(r);
        if (line && line[0] == '*') {
            inp_sources(r)[r->stack[r->depth - 1]].pending = line;
            break;
        }
    }
    r->seen_card = 1;
    inp_cut_card(r);
}

/* Whether the keyword may stand here. */
static inline int inp_is_placed(inp_reader *r, const inp_keyword *keyword)
{
    if (keyword->where & INP_IN_STEP && r->in_step)
        return 1;
    if (keyword->where & INP_IN_MATERIAL && !r->in_step && r->materials.count > 0)
        return 1;
    if (keyword->where & INP_IN_MODEL && !r->in_step)
        return 1;
    inp_complain(r, r->card_place, "*%s has no place %s", r->card_name,
                 r->in_step                         ? "within a *STEP"
                 : keyword->where & INP_IN_MATERIAL ? "before a *MATERIAL"
                                                    : "outside a *STEP");
    return 0;
}

static inline void inp_check_parameters(inp_reader *r, const inp_keyword *keyword)
{
    for (int i = 0; i < r->parameter_count && keyword->parameters; i++) {
        char name[64];
        snprintf(name, sizeof name, " %.60s ", r->parameters[i].name);
        if (!strstr(keyword->parameters, name))
            inp_complain(r, r->card_place, "parameter %.60s of *%s is not understood", r->parameters[i].name,
                         r->card_name);
    }
}

static inline void inp_begin_card(inp_reader *r, char *line)
{
    inp_take_card(r, line);
    r->keyword = NULL;
    r->data_lines = 0;
    r->included = strcmp(r->card_name, "INCLUDE") == 0;
    if (r->included) {
        inp_include(r);
        return;
    }
    for (int i = 0; i < INP_KEYWORD_COUNT && !r->keyword; i++)
        if (strcmp(inp_keywords[i].name, r->card_name) == 0)
            r->keyword = inp_keywords + i;
    if (!r->keyword) {
        inp_complain(r, r->card_place, "*%.60s is not understood", r->card_name);
    } else if (!inp_is_placed(r, r->keyword)) {
        r->keyword = NULL;
    } else {
        inp_check_parameters(r, r->keyword);
        inp_find_scope(r);
        if (r->keyword->begin)
            r->keyword->begin(r);
    }
}

static inline void inp_parse(inp_reader *r)
{
    char *line, *fields[INP_MAX_FIELDS];
    while (!r->no_memory && r->c->faults.count < INP_MAX_FAULTS && (line = inp_next_line(r)) != NULL) {
        if (line[0] == '*') {
            if (r->opening)
                inp_open_part(r, line);
            else
                inp_begin_card(r, line);
            continue;
        }
        if (!r->seen_card || r->included)
            inp_complain(r, r->here, "a data line without a keyword before it in %s",
                         r->included ? "the included file, or after it" : "the file");
        r->seen_card = 1;
        r->included = 0;
        if (!r->keyword || !r->keyword->data)
            continue;
        r->data_lines++;
        r->data_place = r->here;
        if (r->keyword->most > 0 && r->data_lines > r->keyword->most)
            inp_complain(r, r->here, "*%s has one data line", r->card_name);
        else
            r->keyword->data(r, fields, inp_split(r, line, fields));
    }
    inp_end_lines(r);
    if ((r->scope >= 0 || r->assembly >= 0) && r->c->faults.count == 0)
        inp_complain(r, r->here, "the *ASSEMBLY or an *INSTANCE has no end: the file may be cut off");
}

/* ---- building: labels to places ---------------------------------------------------------------------------- */

static inline int inp_compare_pairs(const void *a, const void *b)
{
    const inp_pair *left = (const inp_pair *)a, *right = (const inp_pair *)b;
    if (left->label != right->label)
        return left->label < right->label ? -1 : 1;
    return left->at < right->at ? -1 : left->at > right->at;
}

/* A map of labels that lie `stride` bytes apart. */
static inline void inp_make_map(inp_reader *r, inp_map *map, const inp_list *list, size_t stride)
{
    int ascending = 1;
    map->pairs = (inp_pair *)inp_allocate(r, (size_t)list->count, sizeof *map->pairs);
    if (!map->pairs)
        return;
    map->count = list->count;
    map->is_run = 1;
    for (int i = 0; i < map->count; i++) {
        memcpy(&map->pairs[i].label, (const char *)list->items + (size_t)i * stride, sizeof(int));
        map->pairs[i].at = i;
        ascending &= i == 0 || map->pairs[i].label > map->pairs[i - 1].label;
        map->is_run &= i == 0 || map->pairs[i].label - 1 == map->pairs[i - 1].label;
    }
    if (!ascending)
        qsort(map->pairs, (size_t)map->count, sizeof *map->pairs, inp_compare_pairs);
}

/* The place of a label; -1: there is none. */
static inline int inp_find(const inp_map *map, int label)
{
    int low = 0, high = map->count - 1;
    if (map->is_run && map->count > 0)
        return label < map->pairs[0].label || label - map->pairs[0].label >= map->count ? -1
                                                                                        : label - map->pairs[0].label;
    while (low <= high) {
        int middle = low + (high - low) / 2;
        if (map->pairs[middle].label == label)
            return map->pairs[middle].at;
        if (map->pairs[middle].label < label)
            low = middle + 1;
        else
            high = middle - 1;
    }
    return -1;
}

/* A label twice is a fault at the place of the later one. */
static inline void inp_check_labels(inp_reader *r, const inp_map *map, int of_elements)
{
    for (int i = 1; i < map->count; i++) {
        int first = map->pairs[i - 1].at, second = map->pairs[i].at;
        inp_place before, again;
        if (map->pairs[i].label != map->pairs[i - 1].label)
            continue;
        before = of_elements ? inp_elements(r)[first].place : inp_nodes(r)[first].place;
        again = of_elements ? inp_elements(r)[second].place : inp_nodes(r)[second].place;
        inp_complain(r, again, "%s %d is there already, from %s:%d", of_elements ? "element" : "node",
                     map->pairs[i].label, before.path, before.line);
    }
}

static inline int inp_make_maps(inp_reader *r)
{
    inp_make_map(r, &r->node_map, &r->nodes, sizeof(inp_node));
    inp_make_map(r, &r->element_map, &r->elements, sizeof(inp_element));
    inp_make_map(r, &r->flat_map, &r->flat, sizeof(int));
    if (r->no_memory)
        return 0;
    inp_check_labels(r, &r->node_map, 0);
    inp_check_labels(r, &r->element_map, 1);
    return 1;
}

/* Arrays of the mesh; numbers of nodes and elements go along where they are not 1, 2, 3 ... */
static inline int inp_make_mesh(inp_reader *r)
{
    case_file *c = r->c;
    int width = r->element ? sb_element_node_count(r->element->type) : 0;
    size_t nodes = (size_t)r->nodes.count, elements = (size_t)r->elements.count;
    if (elements == 0) {
        inp_complain(r, r->here, "there are no elements of a solid");
        return 0;
    }
    c->mesh.nodes = (sb_vec3 *)inp_allocate(r, nodes, sizeof(sb_vec3));
    c->mesh.elements = (int *)inp_allocate(r, elements * (size_t)width, sizeof(int));
    c->node_numbers = (int *)inp_allocate(r, nodes, sizeof(int));
    c->element_numbers = (int *)inp_allocate(r, elements, sizeof(int));
    if (r->no_memory)
        return 0;
    c->mesh.node_count = (int)nodes - r->points;
    c->mesh.element_count = (int)elements;
    c->mesh.element_type = r->element->type;
    for (size_t i = 0; i < nodes; i++) {
        c->mesh.nodes[i] = inp_nodes(r)[i].x;
        c->node_numbers[i] = inp_nodes(r)[i].label;
    }
    for (size_t e = 0; e < elements; e++) {
        c->element_numbers[e] = inp_elements(r)[e].label;
        for (size_t a = e * (size_t)width; a < (e + 1) * (size_t)width; a++) {
            int label = ((const int *)r->element_nodes.items)[a];
            c->mesh.elements[a] = inp_find(&r->node_map, label);
            if (c->mesh.elements[a] < 0)
                inp_complain(r, inp_elements(r)[e].place, "node %d of the element is not there", label);
        }
    }
    return 1;
}

/* The items of a set as places in the mesh, each once, in the order of the set. Labels of surface elements are none. */
static inline void inp_resolve_set(inp_reader *r, inp_set *set, unsigned char *seen)
{
    int *items = (int *)set->items.items, count = 0, missing = 0;
    for (int i = 0; i < set->items.count; i++) {
        int at = inp_find(set->of_elements ? &r->element_map : &r->node_map, items[i]);
        if (at < 0 && set->of_elements && inp_find(&r->flat_map, items[i]) >= 0)
            continue;
        if (at < 0 && missing++ == 0)
            inp_complain(r, set->place, "%s %d of the set %.80s is not there", set->of_elements ? "element" : "node",
                         items[i], set->name);
        if (at < 0 || seen[at])
            continue;
        seen[at] = 1;
        items[count++] = at;
    }
    for (int i = 0; i < count; i++)
        seen[items[i]] = 0;
    set->items.count = count;
}

/* Adds the nodes of a set's elements, after both were resolved. */
static inline void inp_add_nodes_of(inp_reader *r, inp_set *set, unsigned char *seen)
{
    const sb_mesh *mesh = &r->c->mesh;
    const inp_set *elements = inp_sets(r) + set->nodes_of;
    int width = sb_mesh_element_width(mesh);
    for (int i = 0; i < set->items.count; i++)
        seen[((const int *)set->items.items)[i]] = 1;
    for (int i = 0; i < elements->items.count; i++)
        for (int a = 0; a < width; a++) {
            int element = ((const int *)elements->items.items)[i];
            int node = mesh->elements[(size_t)element * (size_t)width + (size_t)a];
            if (!seen[node])
                inp_add_int(r, &set->items, node);
            seen[node] = 1;
        }
    for (int i = 0; i < set->items.count; i++)
        seen[((const int *)set->items.items)[i]] = 0;
}

static inline void inp_resolve_sets(inp_reader *r)
{
    int most = r->nodes.count > r->elements.count ? r->nodes.count : r->elements.count;
    unsigned char *seen = (unsigned char *)inp_allocate(r, (size_t)most, 1);
    for (int i = 0; i < r->sets.count && seen; i++)
        inp_resolve_set(r, inp_sets(r) + i, seen);
    for (int i = 0; i < r->sets.count && seen && r->c->faults.count == 0; i++)
        if (inp_sets(r)[i].nodes_of >= 0)
            inp_add_nodes_of(r, inp_sets(r) + i, seen);
    free(seen);
}

/* One node or element, whose place goes to *single. */
static inline const int *inp_target(inp_reader *r, int label, int of_elements, inp_place place, int *single, int *count)
{
    *single = inp_find(of_elements ? &r->element_map : &r->node_map, label);
    *count = *single >= 0;
    if (*single < 0)
        inp_complain(r, place, "%s %d is not there", of_elements ? "element" : "node", label);
    return single;
}

/* A label without an instance is the assembly's, where there is one; 0: it has none. */
static inline int inp_assembly_label(const inp_reader *r, int of_elements, int *label)
{
    for (int i = 0; i < r->instances.count; i++) {
        const inp_instance *own = inp_instances(r) + i;
        if (*own->name)
            continue;
        if (!own->has_own)
            return 0;
        *label = *label > 0 && *label <= INT_MAX - own->offset[of_elements] ? *label + own->offset[of_elements] : 0;
    }
    return 1;
}

/* What a data line names by its label, whose place goes to *single. */
static inline const int *inp_labelled(inp_reader *r, const char *target, int of_elements, inp_place place, int *single,
                                      int *count)
{
    const char *what = of_elements ? "element" : "node";
    int label, in_instance;
    *count = 0;
    in_instance = inp_label_of_instance(r, target, of_elements, &label);
    if (!in_instance && !case_scan_integer(target, &label)) {
        inp_complain(r, place, "there is no set of %ss %.80s", what, target);
        return NULL;
    }
    if (!in_instance && !inp_assembly_label(r, of_elements, &label)) {
        inp_complain(r, place, "the assembly has no %ss of its own: INSTANCE.%s is one of an instance", what, target);
        return NULL;
    }
    return inp_target(r, label, of_elements, place, single, count);
}

/* What a data line names: a set, or one label. */
static inline const int *inp_targets(inp_reader *r, const char *target, int of_elements, inp_place place, int *single,
                                     int *count)
{
    int set = inp_find_set(r, target, of_elements);
    if (set < 0)
        return inp_labelled(r, target, of_elements, place, single, count);
    *count = inp_sets(r)[set].items.count;
    return (const int *)inp_sets(r)[set].items.items;
}

/* ---- building: the ends of springs -------------------------------------------------------------------------- */

/* Puts nodes that springs hang on, and that no element has, behind all others: they are points in space. */
static inline void inp_part_points(inp_reader *r)
{
    size_t nodes = (size_t)r->nodes.count;
    unsigned char *kind = (unsigned char *)inp_allocate(r, nodes, 1); /* 1: of an element, 2: of springs only */
    inp_node *parted = (inp_node *)inp_allocate(r, nodes, sizeof *parted);
    int count = 0;
    for (int i = 0; i < r->element_nodes.count && kind && parted; i++) {
        int at = inp_find(&r->node_map, ((const int *)r->element_nodes.items)[i]);
        if (at >= 0)
            kind[at] = 1;
    }
    for (int i = 0; i < r->springs.count && kind && parted; i++)
        for (int k = 0; k < inp_springs(r)[i].count; k++) {
            int single = -1, found;
            inp_labelled(r, inp_springs(r)[i].nodes[k], 0, inp_springs(r)[i].place, &single, &found);
            if (single >= 0 && kind[single] != 1)
                kind[single] = 2;
        }
    for (int pass = 0; pass < 2 && kind && parted; pass++)
        for (size_t i = 0; i < nodes; i++)
            if ((kind[i] == 2) == pass)
                parted[count++] = inp_nodes(r)[i];
    for (size_t i = 0; i < nodes && kind && parted; i++)
        r->points += kind[i] == 2;
    if (r->points > 0 && parted) {
        memcpy(r->nodes.items, parted, nodes * sizeof *parted);
        free(r->node_map.pairs);
        inp_make_map(r, &r->node_map, &r->nodes, sizeof(inp_node));
    }
    free(kind);
    free(parted);
}

/* Gives each spring its *SPRING; sets have labels still. */
static inline void inp_take_spring_sections(inp_reader *r)
{
    inp_map map;
    memset(&map, 0, sizeof map);
    inp_make_map(r, &map, &r->springs, sizeof(inp_spring));
    for (int i = 0; i < map.count && map.pairs; i++) {
        const inp_spring *spring = inp_springs(r) + map.pairs[i].at;
        if (inp_find(&r->element_map, spring->label) >= 0 || (i > 0 && map.pairs[i].label == map.pairs[i - 1].label))
            inp_complain(r, spring->place, "element %d is there already", spring->label);
    }
    for (int k = 0; k < r->spring_sections.count && map.pairs; k++) {
        const inp_spring_section *s = inp_spring_sections(r) + k;
        int set = inp_find_set(r, s->set, 1), count = 0;
        for (int i = 0; set >= 0 && i < inp_sets(r)[set].items.count; i++) {
            int at = inp_find(&map, ((const int *)inp_sets(r)[set].items.items)[i]);
            if (at >= 0) {
                inp_springs(r)[at].section = k;
                count++;
            }
        }
        if (count == 0 && *s->set)
            inp_complain(r, s->place, "there is no set of springs %.80s", s->set);
        if (s->is_table && !(s->least < 0 && s->most > 0))
            inp_complain(r, s->place,
                         "the table of *SPRING must pull and push: springs that do one only cannot be said");
        else if (s->is_table && !(s->stiffness > 0))
            inp_complain(r, s->place, "the stiffness of a spring must be > 0");
    }
    free(map.pairs);
}

/* Finds the body's node of a spring and the point that draws it. */
static inline void inp_find_ends(inp_reader *r, inp_spring *spring)
{
    const inp_spring_section *s = spring->section >= 0 ? inp_spring_sections(r) + spring->section : NULL;
    int first_point = r->nodes.count - r->points, single, count;
    if (!s) {
        inp_complain(r, spring->place, "spring %d is in no *SPRING", spring->label);
        return;
    }
    if (s->axis_count != spring->count || (spring->count == 2 && s->axes[0] != s->axes[1])) {
        inp_complain(r, s->place,
                     spring->count == 1 ? "a SPRING1 has one axis"
                                        : "a SPRING2 has two axes, and here they must be the same");
        return;
    }
    for (int k = 0; k < spring->count; k++) {
        inp_labelled(r, spring->nodes[k], 0, spring->place, &single, &count);
        spring->at[k] = single;
    }
    if (spring->count == 2 && spring->at[0] >= first_point) {
        single = spring->at[0];
        spring->at[0] = spring->at[1];
        spring->at[1] = single;
    }
    if (spring->at[0] >= first_point)
        inp_complain(r, spring->place, "spring %d hangs on no node of the body", spring->label);
    else if (spring->count == 2 && spring->at[1] < first_point)
        inp_complain(r, spring->place,
                     "spring %d is between two nodes of the body: only springs to a node of no element are read",
                     spring->label);
}

/* ---- building: supports and loads -------------------------------------------------------------------------- */

static inline int inp_is_dynamic(const inp_reader *r)
{
    return r->procedure && strcmp(r->procedure->name, "DYNAMIC") == 0;
}
static inline int inp_is_modes(const inp_reader *r)
{
    return r->procedure && strcmp(r->procedure->name, "FREQUENCY") == 0;
}
/* Takes a course of 0 to v, which then stays, or of v throughout, apart: v, and the time (s) of the rise. */
static inline int inp_read_ramp(const inp_amplitude *a, double *factor, double *rise)
{
    double value = a->count >= 4 ? a->points[3] : 0;
    if (a->count < 4 || a->count > 8 || a->count % 2 || a->points[0] != 0)
        return 0;
    for (int i = 2; i < a->count; i += 2)
        if (!(a->points[i] > a->points[i - 2]) || a->points[i + 1] != value)
            return 0;
    *factor = value;
    *rise = a->points[1] == value ? 0 : a->points[2];
    return a->points[1] == value || a->points[1] == 0;
}

/* What a course of straight lines through up to four points has at a time; before the first and after the last it stays
 * what it is. 0: it is no such course. */
static inline int inp_read_course(const inp_amplitude *a, double time, double *factor)
{
    if (a->count < 2 || a->count > 8 || a->count % 2)
        return 0;
    for (int i = 2; i < a->count; i += 2)
        if (!(a->points[i] > a->points[i - 2]))
            return 0;
    *factor = time <= a->points[0] ? a->points[1] : a->points[a->count - 1];
    for (int i = 2; i < a->count; i += 2)
        if (time > a->points[i - 2] && time < a->points[i])
            *factor = a->points[i - 1] + (time - a->points[i - 2]) / (a->points[i] - a->points[i - 2]) *
                                             (a->points[i + 1] - a->points[i - 1]);
    return 1;
}

/* The value of an entry at the end of the rise, and the time (s) of the rise; 0: at once. A static solve rises to the
 * end of its step in any case. */
static inline double inp_entry_value(inp_reader *r, const inp_entry *e, double *rise)
{
    const inp_amplitude *a = e->amplitude ? inp_find_amplitude(r, e->amplitude) : NULL;
    const inp_step *step = e->step > 0 ? inp_steps(r) + e->step - 1 : NULL; /* NULL: a support at rest */
    double factor = 1, period = step ? step->period : 1;
    *rise = step && step->ramps && inp_is_dynamic(r) ? period : 0;
    if (!e->amplitude)
        return e->value;
    if (!a) {
        inp_complain(r, e->place, "there is no amplitude %.80s", e->amplitude);
        return e->value;
    }
    if (r->ends_only) {
        if (!inp_read_course(a, r->times[1], &factor))
            inp_complain(r, e->place, "amplitude %.80s has no ascending times, or more than 4 points", a->name);
    } else if (!inp_read_ramp(a, &factor, rise))
        inp_complain(r, e->place, "amplitude %.80s is no ramp from (0, 0) to (T, V) nor constant: only those are read",
                     a->name);
    else if (*rise > period && !inp_is_dynamic(r))
        inp_complain(r, e->place, "amplitude %.80s rises to %g s, beyond the step's end at %g s", a->name, *rise,
                     period);
    if (!inp_is_dynamic(r))
        *rise = 0;
    return e->value * factor;
}

/* Takes away what steps before `step` put there. */
static inline void inp_clear(inp_reader *r, const inp_entry *fresh)
{
    inp_pressure *pressures = (inp_pressure *)r->pressures.items;
    int count = 0;
    for (size_t i = 0; i < 3 * (size_t)r->nodes.count; i++) {
        if (fresh->kind == INP_BOUNDARY && r->support_step[i] < fresh->step)
            r->support_step[i] = -1;
        if (fresh->kind == INP_CLOAD && r->force_step[i] < fresh->step)
            r->force[i] = 0;
    }
    if (fresh->kind != INP_PRESSURE)
        return;
    for (int i = 0; i < r->elements.count; i++)
        if (r->gravity_step[i] < fresh->step)
            r->gravity[i] = sb_v3(0, 0, 0);
    for (int i = 0; i < r->pressures.count; i++)
        if (pressures[i].step >= fresh->step)
            pressures[count++] = pressures[i];
    r->pressures.count = count;
}

static inline void inp_apply_to_nodes(inp_reader *r, const inp_entry *e, double value, double rise)
{
    int single = -1, count;
    const int *nodes = e->target ? inp_targets(r, e->target, 0, e->place, &single, &count)
                                 : inp_target(r, e->label, 0, e->place, &single, &count);
    for (int i = 0; i < count; i++)
        for (int axis = e->first; axis <= e->last; axis++) {
            size_t at = 3 * (size_t)nodes[i] + (size_t)axis;
            if (e->kind == INP_BOUNDARY) {
                r->support[at] = value;
                r->support_step[at] = e->step;
                r->ramp[at] = rise;
            } else {
                r->force[at] = r->force_step[at] == e->step ? r->force[at] + value : value;
                r->force_step[at] = e->step;
            }
        }
}

static inline void inp_press(inp_reader *r, const inp_entry *e, const char *target, int face, double value)
{
    int single = -1, count;
    const int *elements = inp_targets(r, target, 1, e->place, &single, &count);
    if (face >= foreign_face_count(r->element->type)) {
        inp_complain(r, e->place, "a %s has no face %d", r->element->inp, face + 1);
        return;
    }
    for (int i = 0; i < count; i++) {
        inp_pressure *p = (inp_pressure *)inp_add(r, &r->pressures, sizeof *p);
        if (!p)
            return;
        p->element = elements[i];
        p->face = foreign_face(r->element->type, face);
        p->step = e->step;
        p->value = value;
    }
}

static inline void inp_press_surface(inp_reader *r, const inp_entry *e, double value)
{
    const inp_surface_item *items = (const inp_surface_item *)r->surface_items.items;
    int found = 0;
    for (int i = 0; i < r->surface_items.count; i++)
        if (strcmp(items[i].surface, e->target) == 0 && items[i].face >= 0) {
            inp_press(r, e, items[i].target, items[i].face, value);
            found = 1;
        }
    if (!found)
        inp_complain(r, e->place, "there is no surface %.80s of elements", e->target);
}

static inline void inp_attract(inp_reader *r, const inp_entry *e, double value)
{
    int single = -1, count = r->elements.count;
    const int *elements = *e->target ? inp_targets(r, e->target, 1, e->place, &single, &count) : NULL;
    sb_vec3 g = sb_v3((sb_real)(value * e->direction[0]), (sb_real)(value * e->direction[1]),
                      (sb_real)(value * e->direction[2]));
    for (int i = 0; i < count; i++) {
        int at = elements ? elements[i] : i, again = r->gravity_step[at] > 0 && r->gravity_step[at] < e->step;
        sb_vec3 turn = sb_v3_cross(r->gravity[at], g);
        if (again && sb_v3_norm(turn) > (sb_real)1e-9 * sb_v3_norm(g) * sb_v3_norm(r->gravity[at])) {
            inp_complain(r, e->place,
                         "gravity of another direction than in the step before: OP=NEW says what is meant");
            return;
        }
        r->gravity[at] = r->gravity_step[at] == e->step ? sb_v3_add(r->gravity[at], g) : g;
        r->gravity_step[at] = e->step;
    }
}

static inline int inp_compare_pulls(const void *a, const void *b)
{
    const inp_pull *left = (const inp_pull *)a, *right = (const inp_pull *)b;
    if (left->node != right->node)
        return left->node < right->node ? -1 : 1;
    if (left->point != right->point)
        return left->point < right->point ? -1 : 1;
    return left->first < right->first ? -1 : left->first > right->first;
}

static inline int inp_compare_firsts(const void *a, const void *b)
{
    const inp_pull *left = (const inp_pull *)a, *right = (const inp_pull *)b;
    return left->first < right->first ? -1 : left->first > right->first;
}

/* One for each node and point, by the nodes: parallel springs add up. Returns how many. */
static inline int inp_merge_pulls(inp_pull *p, int count)
{
    int merged = 0;
    qsort(p, (size_t)count, sizeof *p, inp_compare_pulls);
    for (int i = 0; i < count; i++) {
        inp_pull *last = merged > 0 ? p + merged - 1 : NULL;
        if (!last || last->node != p[i].node || last->point != p[i].point)
            p[merged++] = p[i];
        else
            for (int axis = 0; axis < 3; axis++)
                last->stiffness[axis] += p[i].stiffness[axis];
    }
    return merged;
}

static inline void inp_make_pulls(inp_reader *r)
{
    for (int i = 0; i < r->springs.count; i++) {
        const inp_spring *spring = inp_springs(r) + i;
        const inp_spring_section *s = inp_spring_sections(r) + spring->section;
        inp_pull *p = (inp_pull *)inp_add(r, &r->pulls, sizeof *p);
        if (!p)
            return;
        p->node = spring->at[0];
        p->point = spring->at[1];
        p->first = i;
        p->stiffness[s->axes[0]] = s->stiffness;
    }
    if (r->pulls.count > 0)
        r->pulls.count = inp_merge_pulls((inp_pull *)r->pulls.items, r->pulls.count);
}

/* Whether a force is what draws a node to where the point of one of its springs stands, stiffness times the way there
 * (as far as coordinates are rounded): inp_write says springs so. Each spring takes one such force for each axis, which
 * then is no force of the case. */
static inline int inp_is_pull(inp_reader *r, const inp_entry *e, double value)
{
    inp_pull *pulls = (inp_pull *)r->pulls.items;
    int single = -1, count, low = 0, high = r->pulls.count;
    if (high == 0 || e->kind != INP_CLOAD || e->amplitude || r->steps.count != 1 || inp_find_set(r, e->target, 0) >= 0)
        return 0;
    inp_labelled(r, e->target, 0, e->place, &single, &count);
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (pulls[middle].node < single)
            low = middle + 1;
        else
            high = middle;
    }
    for (; low < r->pulls.count && pulls[low].node == single; low++) {
        inp_pull *p = pulls + low;
        double to, from, force, rounding = (double)SB_EPSILON;
        if (p->point < 0 || p->is_drawn[e->first])
            continue;
        to = (double)case_component(r->c->mesh.nodes[p->point], e->first);
        from = (double)case_component(r->c->mesh.nodes[single], e->first);
        force = p->stiffness[e->first] * (to - from);
        if (force == 0 || fabs(value - force) > rounding * p->stiffness[e->first] * (fabs(to) + fabs(from)))
            continue;
        p->is_drawn[e->first] = 1;
        return 1;
    }
    return 0;
}

static inline void inp_apply_entries(inp_reader *r)
{
    for (int i = 0; i < r->entries.count && !r->no_memory; i++) {
        const inp_entry *e = inp_entries(r) + i;
        double rise = 0, value = e->fresh ? 0 : inp_entry_value(r, e, &rise);
        if (e->fresh) {
            inp_clear(r, e);
            continue;
        }
        if (rise > 0 && e->kind != INP_BOUNDARY)
            inp_complain(r, e->place, "a load of a dynamic step is sudden: a ramp is for supports only");
        if (inp_is_pull(r, e, value))
            continue;
        switch (e->kind) {
        case INP_BOUNDARY:
        case INP_CLOAD: inp_apply_to_nodes(r, e, value, rise); break;
        case INP_PRESSURE: inp_press(r, e, e->target, e->first, value); break;
        case INP_SURFACE_PRESSURE: inp_press_surface(r, e, value); break;
        default: inp_attract(r, e, value);
        }
    }
}

/* ---- building: statements ---------------------------------------------------------------------------------- */

/* A new statement of the form that has these options; its list is empty. NULL when memory is short. */
static inline case_statement *inp_statement(inp_reader *r, case_kind kind, const char *variant, case_bits given,
                                            inp_place place)
{
    case_file *c = r->c;
    void *items = c->statements;
    case_statement *s;
    if (r->no_memory || !case_reserve(&items, c->statement_count, &c->statement_capacity, sizeof *c->statements)) {
        r->no_memory = 1;
        return NULL;
    }
    c->statements = (case_statement *)items;
    s = c->statements + c->statement_count++;
    memset(s, 0, sizeof *s);
    s->line = place.line;
    s->given = given;
    for (int i = 0; i < CASE_FORM_COUNT && !s->form; i++)
        if (case_forms[i].kind == kind && case_same_text(case_forms[i].variant, variant) &&
            (case_forms[i].required & ~given) == 0)
            s->form = case_forms + i;
    return s;
}

static inline void inp_add_node(inp_reader *r, case_statement *s, int node, sb_vec3 vector)
{
    if (!s || !case_reserve_nodes(s)) {
        r->no_memory = 1;
        return;
    }
    s->nodes[s->count] = node;
    s->vectors[s->count++] = vector;
}

/* A node's supported axes as bits: those with displacement 0, or those with another that is reached after `rise`. */
static inline int inp_support_axes(const inp_reader *r, int node, int moved, double rise)
{
    int axes = 0;
    for (int axis = 0; axis < 3; axis++) {
        size_t at = 3 * (size_t)node + (size_t)axis;
        if (r->support_step[at] >= 0 && (r->support[at] != 0) == moved && (!moved || r->ramp[at] == rise))
            axes |= 1 << axis;
    }
    return axes;
}

/* Statements of the supports of one kind, one for each combination of axes. */
static inline void inp_add_supports(inp_reader *r, int moved, double rise)
{
    case_bits given = moved ? CASE_BIT(CASE_FILE) | (rise > 0 ? CASE_BIT(CASE_RAMP) : 0) : CASE_BIT(CASE_NODES);
    for (int axes = 1; axes < 8 && !r->no_memory; axes++) {
        case_statement *s = NULL;
        for (int i = 0; i < r->c->mesh.node_count && !r->no_memory; i++) {
            const double *u = r->support + 3 * (size_t)i;
            if (inp_support_axes(r, i, moved, rise) != axes)
                continue;
            if (!s)
                s = inp_statement(r, moved ? CASE_PRESCRIBE : CASE_FIX, NULL, given, r->step_place);
            if (!s)
                return;
            s->axes = axes;
            s->number[CASE_RAMP] = rise;
            inp_add_node(
                r, s, i,
                sb_v3((sb_real)(axes & 1 ? u[0] : 0), (sb_real)(axes & 2 ? u[1] : 0), (sb_real)(axes & 4 ? u[2] : 0)));
        }
    }
}

/* Supports at rest, then those that move, by the time they take. */
static inline void inp_add_all_supports(inp_reader *r)
{
    double last = -1;
    inp_add_supports(r, 0, 0);
    while (!r->no_memory) {
        double next = -1;
        for (size_t i = 0; i < 3 * (size_t)r->c->mesh.node_count; i++)
            if (r->support_step[i] >= 0 && r->support[i] != 0 && r->ramp[i] > last && (next < 0 || r->ramp[i] < next))
                next = r->ramp[i];
        if (next < 0)
            return;
        inp_add_supports(r, 1, next);
        last = next;
    }
}

/* Whether the node is a point in space that springs hang on, which is complained about. */
static inline int inp_is_point(inp_reader *r, int node, inp_place place)
{
    if (node < r->c->mesh.node_count)
        return 0;
    inp_complain(r, place, "node %d is of no element, only springs can hang on it", r->c->node_numbers[node]);
    return 1;
}

static inline void inp_add_forces(inp_reader *r)
{
    case_statement *s = NULL;
    for (int i = 0; i < r->nodes.count && !r->no_memory; i++) {
        const double *f = r->force + 3 * (size_t)i;
        if (f[0] == 0 && f[1] == 0 && f[2] == 0)
            continue;
        if (inp_is_point(r, i, r->step_place))
            return;
        if (!s)
            s = inp_statement(r, CASE_FORCE, NULL, CASE_BIT(CASE_FILE), r->step_place);
        inp_add_node(r, s, i, sb_v3((sb_real)f[0], (sb_real)f[1], (sb_real)f[2]));
    }
}

static inline int inp_compare_faces(const void *a, const void *b)
{
    const inp_pressure *left = (const inp_pressure *)a, *right = (const inp_pressure *)b;
    if (left->element != right->element)
        return left->element < right->element ? -1 : 1;
    if (left->face != right->face)
        return left->face < right->face ? -1 : 1;
    return left->step < right->step ? -1 : left->step > right->step;
}

static inline int inp_compare_pressures(const void *a, const void *b)
{
    const inp_pressure *left = (const inp_pressure *)a, *right = (const inp_pressure *)b;
    if (left->value != right->value)
        return left->value < right->value ? -1 : 1;
    return inp_compare_faces(a, b);
}

/* One pressure for each face: the sum of its last step. */
static inline void inp_merge_pressures(inp_reader *r)
{
    inp_pressure *p = (inp_pressure *)r->pressures.items;
    int count = 0;
    if (r->pressures.count > 1)
        qsort(p, (size_t)r->pressures.count, sizeof *p, inp_compare_faces);
    for (int i = 0; i < r->pressures.count; i++) {
        inp_pressure *last = count > 0 ? p + count - 1 : NULL;
        if (!last || last->element != p[i].element || last->face != p[i].face)
            p[count++] = p[i];
        else if (last->step == p[i].step)
            last->value += p[i].value;
        else
            *last = p[i];
    }
    r->pressures.count = count;
    if (count > 1)
        qsort(p, (size_t)count, sizeof *p, inp_compare_pressures);
}

/* A statement for each pressure there is. */
static inline void inp_add_pressures(inp_reader *r)
{
    const inp_pressure *p;
    case_statement *s = NULL;
    inp_merge_pressures(r);
    p = (const inp_pressure *)r->pressures.items;
    for (int i = 0; i < r->pressures.count && !r->no_memory; i++) {
        if (p[i].value == 0)
            continue;
        if (!s || s->number[CASE_PRESSURE_VALUE] != p[i].value)
            s = inp_statement(r, CASE_PRESSURE, NULL, CASE_BIT(CASE_FACES) | CASE_BIT(CASE_PRESSURE_VALUE),
                              r->step_place);
        if (!s)
            return;
        s->number[CASE_PRESSURE_VALUE] = p[i].value;
        r->no_memory |= !case_add_face(r->c, s, p[i].element, p[i].face);
    }
    if (r->pressures.count > 0 && r->procedure && !inp_is_modes(r) && !r->nonlinear)
        inp_complain(r, r->step_place, "pressures follow the faces here: the step needs NLGEOM");
}

static inline void inp_add_gravity(inp_reader *r)
{
    sb_vec3 g = r->gravity[0];
    case_statement *s;
    for (int i = 1; i < r->elements.count; i++)
        if (r->gravity[i].x != g.x || r->gravity[i].y != g.y || r->gravity[i].z != g.z) {
            inp_complain(r, r->step_place, "gravity must be the same on all elements; element %d has another than %d",
                         r->c->element_numbers[i], r->c->element_numbers[0]);
            return;
        }
    if (g.x == 0 && g.y == 0 && g.z == 0)
        return;
    s = inp_statement(r, CASE_GRAVITY, NULL, 0, r->step_place);
    if (!s)
        return;
    s->numbers[0] = (double)g.x;
    s->numbers[1] = (double)g.y;
    s->numbers[2] = (double)g.z;
}

/* Where a node is drawn to along an axis: as far from where it is at rest, or from where the point stands when a force
 * draws it there, as the point is displaced. */
static inline double inp_pull_target(const inp_reader *r, const inp_pull *p, int axis)
{
    const sb_vec3 *x = r->c->mesh.nodes;
    double from = (double)case_component(x[p->is_drawn[axis] ? p->point : p->node], axis);
    return p->point < 0 ? from : from + r->support[3 * (size_t)p->point + (size_t)axis];
}

/* Whether the springs are one of a case: as stiff along each axis, to a point that is held. */
static inline int inp_can_pull(inp_reader *r, const inp_pull *p)
{
    const inp_place place = inp_springs(r)[p->first].place;
    const double *k = p->stiffness;
    if (k[0] != k[1] || k[0] != k[2]) {
        inp_complain(r, place, "node %d has springs of %g, %g and %g N/m along x, y and z: here they are all the same",
                     r->c->node_numbers[p->node], k[0], k[1], k[2]);
        return 0;
    }
    for (int axis = 0; axis < 3 && p->point >= 0; axis++) {
        size_t at = 3 * (size_t)p->point + (size_t)axis;
        if (r->support_step[at] >= 0 && !(r->ramp[at] > 0))
            continue;
        inp_complain(r, place,
                     r->support_step[at] < 0 ? "node %d, which springs hang on, must be held along x, y and z"
                                             : "node %d, which springs hang on, moves by a ramp: it must be sudden",
                     r->c->node_numbers[p->point]);
        return 0;
    }
    return 1;
}

/* Springs of a case draw a node to a point in space, alike in all directions and without a length at rest: three
 * SPRING2 from it to a node of no element, one along each axis; or SPRING1, to where it is at rest. */
static inline void inp_add_springs(inp_reader *r)
{
    case_statement *s = NULL;
    inp_pull *pulls = (inp_pull *)r->pulls.items;
    if (r->pulls.count > 0)
        qsort(pulls, (size_t)r->pulls.count, sizeof *pulls, inp_compare_firsts);
    for (int i = 0; i < r->pulls.count && inp_can_pull(r, pulls + i); i++) {
        const inp_pull *p = pulls + i;
        if (!s)
            s = inp_statement(r, CASE_SPRING, NULL, CASE_BIT(CASE_FILE), inp_springs(r)[p->first].place);
        inp_add_node(r, s, p->node,
                     sb_v3((sb_real)inp_pull_target(r, p, 0), (sb_real)inp_pull_target(r, p, 1),
                           (sb_real)inp_pull_target(r, p, 2)));
        if (r->no_memory)
            break;
        s->stiffness[s->count - 1] = (sb_real)p->stiffness[0];
    }
}

static inline void inp_add_equations(inp_reader *r)
{
    case_statement *s = NULL;
    for (int i = 0; i < r->terms.count && !r->no_memory; i++) {
        const inp_term *t = inp_terms(r) + i;
        int single = -1, count;
        const int *nodes = t->target ? inp_targets(r, t->target, 0, t->place, &single, &count)
                                     : inp_target(r, t->label, 0, t->place, &single, &count);
        if (!s)
            s = inp_statement(r, CASE_EQUATION, NULL, CASE_BIT(CASE_FILE), t->place);
        if (count > 1)
            inp_complain(r, t->place, "set %.80s has %d nodes: equations are read for one node a term", t->target,
                         count);
        if (count != 1 || !s || inp_is_point(r, nodes[0], t->place))
            return;
        if ((t->starts && !case_add_equation(r->c, s, (sb_real)t->value)) ||
            !case_add_term(r->c, s, nodes[0], t->axis, (sb_real)t->coefficient))
            r->no_memory = 1;
    }
}

static inline void inp_set_option(case_statement *s, case_key key, double value)
{
    s->given |= CASE_BIT(key);
    s->number[key] = value;
}

/* Nodes of a face of an element, those between its corners too, each once in a list. */
static inline void inp_add_face_nodes(inp_reader *r, case_statement *nodes, unsigned char *seen, int element, int face)
{
    const sb_mesh *mesh = &r->c->mesh;
    const int *cell = mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
    int local[SB_MAX_FACE_NODES], count = sb_element_face(mesh->element_type, face, local, NULL);
    for (int i = 0; i < count && !r->no_memory; i++)
        if (!seen[cell[local[i]]]) {
            seen[cell[local[i]]] = 1;
            inp_add_node(r, nodes, cell[local[i]], sb_v3(0, 0, 0));
        }
}

/* One line of a surface, as nodes where `seen` is there, else as faces of s. */
static inline void inp_add_surface_item(inp_reader *r, const inp_tie *t, const inp_surface_item *item,
                                        case_statement *s, unsigned char *seen)
{
    int single = -1, count, of_nodes = item->face < 0;
    const int *targets = inp_targets(r, item->target, !of_nodes, t->place, &single, &count);
    if (of_nodes && !seen) {
        inp_complain(r, t->place, "the master %.80s must be a surface of elements", t->master);
        return;
    }
    if (item->face >= foreign_face_count(r->element->type)) {
        inp_complain(r, t->place, "a %s has no face %d", r->element->inp, item->face + 1);
        return;
    }
    for (int i = 0; i < count && !r->no_memory; i++) {
        int face = of_nodes ? -1 : foreign_face(r->element->type, item->face);
        if (!seen)
            r->no_memory |= !case_add_face(r->c, s, targets[i], face);
        else if (!of_nodes)
            inp_add_face_nodes(r, s, seen, targets[i], face);
        else if (!inp_is_point(r, targets[i], t->place) && !seen[targets[i]]) {
            seen[targets[i]] = 1;
            inp_add_node(r, s, targets[i], sb_v3(0, 0, 0));
        }
    }
}

/* The nodes or faces of a named surface. */
static inline void inp_add_surface(inp_reader *r, const inp_tie *t, const char *name, case_statement *s,
                                   unsigned char *seen)
{
    const inp_surface_item *items = (const inp_surface_item *)r->surface_items.items;
    int found = 0;
    for (int i = 0; i < r->surface_items.count; i++)
        if (strcmp(items[i].surface, name) == 0) {
            inp_add_surface_item(r, t, items + i, s, seen);
            found = 1;
        }
    if (!found)
        inp_complain(r, t->place, "there is no surface %.80s", name);
    else if (s->count == 0 && r->c->faults.count == 0)
        inp_complain(r, t->place, "the surface %.80s is empty", name);
}

static inline void inp_add_ties(inp_reader *r)
{
    for (int i = 0; i < r->ties.count && !r->no_memory; i++) {
        const inp_tie *t = (const inp_tie *)r->ties.items + i;
        unsigned char *seen = (unsigned char *)inp_allocate(r, (size_t)r->nodes.count, 1);
        case_statement nodes,
            *s = inp_statement(r, CASE_TIE, NULL, CASE_BIT(CASE_NODES) | CASE_BIT(CASE_FACES), t->place);
        memset(&nodes, 0, sizeof nodes);
        nodes.form = case_form_of(CASE_FIX);
        if (s && seen) {
            inp_add_surface(r, t, t->slave, &nodes, seen);
            inp_add_surface(r, t, t->master, s, NULL);
            s->nodes = nodes.nodes;
            s->tied_count = nodes.count;
            nodes.nodes = NULL;
            if (t->distance > 0)
                inp_set_option(s, CASE_DISTANCE, t->distance);
        }
        case_free_statement(&nodes);
        free(seen);
    }
}

/* ---- building: materials ----------------------------------------------------------------------------------- */

/* The region of a section: the number at the end of its set's name, where all sections have one and no two the same;
 * else 1, 2, ... in order. */
static inline int inp_region(const inp_reader *r, int section)
{
    int own = section + 1, ok = 1;
    for (int i = 0; i < r->sections.count; i++) {
        int number, other = 0;
        const char *name = inp_sections(r)[i].set, *digits = name + strlen(name);
        while (digits > name && digits[-1] >= '0' && digits[-1] <= '9')
            digits--;
        if (!case_scan_integer(digits, &number))
            return section + 1;
        for (int k = 0; k < i && ok; k++) {
            const char *before = inp_sections(r)[k].set, *end = before + strlen(before);
            while (end > before && end[-1] >= '0' && end[-1] <= '9')
                end--;
            ok = !case_scan_integer(end, &other) || other != number;
        }
        if (i == section)
            own = number;
    }
    return ok ? own : section + 1;
}

/* Higher D are those of terms that are not there: 0 or beyond measure. */
static inline int inp_check_volume_terms(inp_reader *r, const inp_material *m)
{
    double d1 = m->constants[m->law->constants];
    for (int k = 1; k < foreign_volume_terms(m->law); k++) {
        double d = m->constants[m->law->constants + k];
        if (d == 0 || d > 1e15 * d1)
            continue;
        inp_complain(r, m->law_place, "D%d of %.80s must be 0 or beyond 1e15 D1: the law here has (J-1)^2/D1 only",
                     k + 1, m->name);
        return 0;
    }
    if (d1 > 0)
        return 1;
    inp_complain(r, m->law_place, "D1 of %.80s must be > 0: material that cannot change its volume is not known here",
                 m->name);
    return 0;
}

/* The options of a material statement. */
static inline void inp_set_law(case_statement *s, const inp_material *m)
{
    if (m->law)
        for (int k = 0; k < m->law->constants; k++)
            inp_set_option(s, m->law->keys[k], m->constants[k]);
    if (m->law)
        inp_set_option(s, CASE_D1, m->constants[m->law->constants]);
    if (!m->law)
        inp_set_option(s, CASE_E, m->constants[0]);
    if (!m->law)
        inp_set_option(s, CASE_NU, m->constants[1]);
}

static inline void inp_add_material(inp_reader *r, const inp_material *m, int has_region, int region)
{
    case_bits given = CASE_BIT(CASE_DENSITY) | (has_region ? CASE_BIT(CASE_REGION) : 0);
    const char *model = m->law ? m->law->model : m->model ? m->model : r->nonlinear ? "svk" : "linear";
    const char *expected = "";
    case_statement *s;
    case_bits law = m->law ? CASE_BIT(CASE_D1) | CASE_BIT(CASE_C10) | CASE_BIT(m->law->keys[1]) : CASE_HOOKE;
    if (!m->law_place.path) {
        inp_complain(r, m->place, "material %.80s has no *ELASTIC or *HYPERELASTIC", m->name);
        return;
    }
    if (m->constant_count < m->wanted) {
        inp_complain(r, m->law_place, "the law of %.80s needs %d constants, not %d", m->name, m->wanted,
                     m->constant_count);
        return;
    }
    if (m->law && !inp_check_volume_terms(r, m))
        return;
    if (!m->law && (!(m->constants[0] > 0) || !case_is_in_range(CASE_TYPE_POISSON, m->constants[1], &expected))) {
        inp_complain(r, m->law_place, "E must be > 0 and nu between -1 and 0.5");
        return;
    }
    if (m->law && !r->nonlinear && !inp_is_modes(r))
        inp_complain(r, r->step_place, "*HYPERELASTIC needs *STEP, NLGEOM");
    s = inp_statement(r, CASE_MATERIAL, model, given | law, m->law_place);
    if (!s)
        return;
    s->given = given;
    inp_set_law(s, m);
    s->number[CASE_DENSITY] = m->density > 0 ? m->density : 1000;
    s->number[CASE_REGION] = region;
}

/* Whether the solve needs masses. */
static inline int inp_needs_density(const inp_reader *r)
{
    const sb_vec3 g = r->gravity[0];
    return inp_is_dynamic(r) || inp_is_modes(r) || g.x != 0 || g.y != 0 || g.z != 0;
}

static inline void inp_check_density(inp_reader *r, const inp_material *m)
{
    if (m->density > 0)
        return;
    if (inp_needs_density(r))
        inp_complain(r, m->place, "material %.80s has no *DENSITY, which this step needs", m->name);
    else
        inp_note(r, m->place, "material %.80s has no *DENSITY, which this step does not need: 1000 kg/m^3", m->name);
}

/* Gives the elements of a section their region; `owner` [elements] has the section of each, from 1. */
static inline void inp_take_section(inp_reader *r, int section, int *owner)
{
    const inp_section *s = inp_sections(r) + section;
    int set = inp_find_set(r, s->set, 1), material = -1;
    for (int i = 0; i < r->materials.count; i++)
        if (strcmp(inp_materials(r)[i].name, s->material) == 0)
            material = i;
    if (set < 0 && *s->set)
        inp_complain(r, s->place, "there is no set of elements %.80s", s->set);
    if (material < 0 && *s->material)
        inp_complain(r, s->place, "there is no material %.80s", s->material);
    if (set >= 0 && inp_sets(r)[set].items.count == 0)
        inp_complain(r, s->place, "the set %.80s has no element of a solid", s->set);
    if (set < 0 || material < 0)
        return;
    for (int i = 0; i < inp_sets(r)[set].items.count; i++) {
        int element = ((const int *)inp_sets(r)[set].items.items)[i];
        if (owner[element]) {
            inp_complain(r, s->place, "element %d is in the section of set %.80s already",
                         r->c->element_numbers[element], inp_sections(r)[owner[element] - 1].set);
            return;
        }
        owner[element] = section + 1;
        r->c->mesh.regions[element] = inp_region(r, section);
    }
    inp_check_density(r, inp_materials(r) + material);
    inp_add_material(r, inp_materials(r) + material, r->sections.count > 1, inp_region(r, section));
}

static inline void inp_take_sections(inp_reader *r)
{
    sb_mesh *mesh = &r->c->mesh;
    int *owner = (int *)inp_allocate(r, (size_t)mesh->element_count, sizeof(int));
    mesh->regions = (int *)inp_allocate(r, (size_t)mesh->element_count, sizeof(int));
    if (r->sections.count == 0)
        inp_complain(r, r->here, "there is no *SOLID SECTION, which gives the elements their material");
    for (int i = 0; i < r->sections.count && owner && mesh->regions; i++)
        inp_take_section(r, i, owner);
    for (int e = 0; e < mesh->element_count && owner && r->c->faults.count == 0; e++)
        if (!owner[e])
            inp_complain(r, inp_elements(r)[e].place, "element %d is in no *SOLID SECTION", r->c->element_numbers[e]);
    free(owner);
    if (r->sections.count < 2) {
        free(mesh->regions);
        mesh->regions = NULL;
    }
}

/* ---- building: the solve and what is written --------------------------------------------------------------- */

static inline void inp_add_static(inp_reader *r)
{
    double steps = r->time_count > 0 && r->times[0] > 0 ? inp_steps(r)[r->step - 1].period / r->times[0] : 1;
    case_statement *s =
        inp_statement(r, CASE_SOLVE, "static", CASE_BIT(CASE_STEPS) | CASE_BIT(CASE_TOL), r->procedure_place);
    if (!s)
        return;
    s->number[CASE_STEPS] = steps < 1 ? 1 : steps > 1e6 ? 1e6 : (double)(int)(steps + 0.5);
    s->number[CASE_TOL] = r->tolerance > 0 ? r->tolerance : r->nonlinear ? 1e-9 : 1e-10;
    if (r->step > 1)
        inp_note(r, r->step_place, "the %d static steps are solved as one, to the loads and supports at the end",
                 r->step);
}

static inline void inp_add_dynamic(inp_reader *r)
{
    double alpha = -1;
    case_statement *s;
    case_bits given = CASE_TIMES | (r->tolerance > 0 ? CASE_BIT(CASE_TOL) : 0);
    if (!r->alpha || !foreign_scan_number(r->alpha, 0, &alpha) || alpha != 0) {
        inp_complain(r, r->procedure_place,
                     "*DYNAMIC is read with ALPHA=0 (Newmark's scheme): other solvers' default of -0.05 damps");
        return;
    }
    if (r->time_count < 2 || !(r->times[0] > 0) || !(r->times[1] > 0)) {
        inp_complain(r, r->procedure_place, "*DYNAMIC needs a time step and an end, both > 0");
        return;
    }
    if (!r->direct)
        inp_note(r, r->procedure_place, "without DIRECT: all steps have %g s here", r->times[0]);
    s = inp_statement(r, CASE_SOLVE, "newmark", given, r->procedure_place);
    if (!s)
        return;
    s->number[CASE_DT] = r->times[0];
    s->number[CASE_END] = r->times[1];
    s->number[CASE_TOL] = r->tolerance;
}

static inline void inp_add_modes(inp_reader *r)
{
    case_statement *s;
    double count = r->time_count > 0 ? r->times[0] : 0;
    if (!(count >= 1) || count > 1e6 || count != (double)(int)count) {
        inp_complain(r, r->procedure_place, "*FREQUENCY needs the number of modes, >= 1");
        return;
    }
    if (r->time_count > 1)
        inp_note(r, r->procedure_place, "the range of frequencies is left out: the lowest %d are found", (int)count);
    s = inp_statement(r, CASE_SOLVE, "modes", CASE_BIT(CASE_COUNT), r->procedure_place);
    if (s)
        s->number[CASE_COUNT] = count;
}

static inline void inp_add_output(inp_reader *r, const char *variant, const char *path, int node)
{
    case_statement *s = inp_statement(r, CASE_OUTPUT, variant, 0, r->procedure_place);
    if (!s)
        return;
    s->path = inp_keep(r, path);
    s->node = node;
}

/* Displacements always, or frequencies; what else the file prints; the course of nodes that are printed alone. */
static inline void inp_add_outputs(inp_reader *r)
{
    char path[64];
    inp_add_output(r, inp_is_modes(r) ? "frequencies" : "displacement",
                   inp_is_modes(r) ? "frequencies.txt" : "displacement.txt", 0);
    if (inp_is_modes(r))
        return;
    if (r->wants_reactions)
        inp_add_output(r, "reaction", "reaction.txt", 0);
    if (r->wants_stresses)
        inp_add_output(r, "stress", "stress.txt", 0);
    for (int i = 0; i < r->probes.count; i++) {
        int set = inp_find_set(r, ((const char **)r->probes.items)[i], 0), node, seen = 0;
        if (set < 0 || inp_sets(r)[set].items.count != 1)
            continue;
        node = ((const int *)inp_sets(r)[set].items.items)[0];
        if (node >= r->c->mesh.node_count)
            continue;
        for (int k = 0; k < r->c->statement_count; k++)
            seen |= r->c->statements[k].path && r->c->statements[k].form->code == CASE_OUTPUT_PROBE &&
                    r->c->statements[k].form->kind == CASE_OUTPUT && r->c->statements[k].node == node;
        snprintf(path, sizeof path, "probe_%d.txt", r->c->node_numbers[node]);
        if (!seen)
            inp_add_output(r, "probe", path, node);
    }
}

static inline void inp_add_statements(inp_reader *r)
{
    inp_statement(r, CASE_MESH, NULL, 0, r->element_place);
    inp_take_sections(r);
    inp_add_gravity(r);
    inp_add_all_supports(r);
    inp_add_forces(r);
    inp_add_pressures(r);
    inp_add_springs(r);
    inp_add_equations(r);
    inp_add_ties(r);
    if (!r->procedure)
        inp_complain(r, r->here, "there is no *STEP with *STATIC, *DYNAMIC or *FREQUENCY");
    else if (inp_is_dynamic(r))
        inp_add_dynamic(r);
    else if (inp_is_modes(r))
        inp_add_modes(r);
    else
        inp_add_static(r);
    if (r->procedure)
        inp_add_outputs(r);
    if (r->in_step && r->c->faults.count == 0)
        inp_complain(r, r->step_place, "the *STEP has no *END STEP: the file may be cut off");
}

static inline int inp_make_tables(inp_reader *r)
{
    size_t nodes = (size_t)r->nodes.count, elements = (size_t)r->elements.count;
    r->support = (double *)inp_allocate(r, nodes, 3 * sizeof(double));
    r->support_step = (int *)inp_allocate(r, nodes, 3 * sizeof(int));
    r->ramp = (double *)inp_allocate(r, nodes, 3 * sizeof(double));
    r->force = (double *)inp_allocate(r, nodes, 3 * sizeof(double));
    r->force_step = (int *)inp_allocate(r, nodes, 3 * sizeof(int));
    r->gravity = (sb_vec3 *)inp_allocate(r, elements, sizeof(sb_vec3));
    r->gravity_step = (int *)inp_allocate(r, elements, sizeof(int));
    for (size_t i = 0; i < 3 * nodes && !r->no_memory; i++)
        r->support_step[i] = -1;
    return !r->no_memory;
}

static inline void inp_build(inp_reader *r)
{
    if (!inp_make_maps(r))
        return;
    if (r->springs.count > 0)
        inp_part_points(r);
    if (r->spring_sections.count > 0)
        inp_take_spring_sections(r);
    for (int i = 0; i < r->springs.count && r->c->faults.count == 0; i++)
        inp_find_ends(r, inp_springs(r) + i);
    if (r->no_memory || !inp_make_mesh(r) || r->c->faults.count > 0)
        return;
    inp_resolve_sets(r);
    inp_make_pulls(r);
    if (!inp_make_tables(r))
        return;
    inp_apply_entries(r);
    inp_add_statements(r);
}

/* ---- the reader -------------------------------------------------------------------------------------------- */

static inline void inp_free(inp_reader *r)
{
    inp_list *lists[] = {&r->sources, &r->nodes,     &r->elements,  &r->element_nodes, &r->flat,
                         &r->sets,    &r->materials, &r->sections,  &r->amplitudes,    &r->surface_items,
                         &r->ties,    &r->entries,   &r->terms,     &r->probes,        &r->pressures,
                         &r->steps,   &r->parts,     &r->instances, &r->springs,       &r->spring_sections,
                         &r->pulls};
    for (int i = 1; i < r->sources.count; i++) { /* the first is the case's */
        free(inp_sources(r)[i].text);
        free(inp_sources(r)[i].path);
    }
    for (int i = 0; i < r->sets.count; i++)
        free(inp_sets(r)[i].items.items);
    for (int i = 0; i < (int)(sizeof lists / sizeof lists[0]); i++)
        free(lists[i]->items);
    free(r->node_map.pairs);
    free(r->element_map.pairs);
    free(r->flat_map.pairs);
    free(r->support);
    free(r->support_step);
    free(r->ramp);
    free(r->force);
    free(r->force_step);
    free(r->gravity);
    free(r->gravity_step);
}

/* A mesh that can be computed with; a bad element is named by its number in the file. */
static inline int inp_check_mesh(case_file *c)
{
    sb_error error;
    if (sb_mesh_validate(&c->mesh, &error) == SB_OK)
        return case_check_mesh(c);
    if (error.element >= 0 && error.element < c->mesh.element_count)
        return case_fail(c, c->mesh_statement->line, "element %d of the file: %s (counted from 0)",
                         c->element_numbers[error.element], error.message);
    return case_fail_library(c, c->mesh_statement->line, &error);
}

/* Empty, for the case. */
static inline void inp_start(inp_reader *r, case_file *c)
{
    memset(r, 0, sizeof *r);
    r->c = c;
    r->set = r->assembly = r->scope = r->instance = -1;
    r->here.path = c->path;
    r->card_name = "";
}

/* Releases what was read, and looks at the case that it became. */
static inline int inp_finish(inp_reader *r)
{
    case_file *c = r->c;
    int is_whole;
    if (r->no_memory && c->faults.count == 0)
        inp_complain(r, r->here, "out of memory");
    is_whole = !r->no_memory && !c->message[0] && c->faults.count == 0; /* a fault's line may have found no memory */
    inp_free(r);
    return is_whole && case_find_singles(c) && inp_check_mesh(c) && case_load_materials(c) && case_load_rest(c);
}

/* Reads an input file, as case_read does a case. What is wrong is listed in c->faults. */
static inline int inp_read(case_file *c, const char *path)
{
    inp_reader r;
    if (!case_start(c, path))
        return 0;
    inp_start(&r, c);
    inp_open(&r, c->path, c->text, 0);
    inp_parse(&r);
    if (c->faults.count == 0 && !r.no_memory)
        inp_build(&r);
    return inp_finish(&r);
}

static inline int case_is_inp(const char *path) { return foreign_ends_in(path, "inp"); }

#endif /* CASE_INP_H */
