/* case_msml: reads a file of MSML, the Medical Simulation Markup Language (MODEL.msml.xml), as a case:
 *
 *     pieces of XML --msml_take--> elements --msml_build--> statements of the case file --as case_read--> case_file
 *
 * What may stand where is a table, msml_rules. Taken are: variables; one object with a linearTet or quadraticTet mesh,
 * from a file or by a mesher from a surface (which is stuffed here); groups of indices by boxes; regions with
 * linearElasticMaterial or corotatedElasticMaterial and mass; fixedConstraint, displacementConstraint, forceConstraint,
 * surfacePressure, springMeshToFixed; a solver and one step. What else would change the model is refused, by name and
 * line; what is wrong is listed to the end of the file. Operators that nothing of the model needs (they are for
 * results) are left out with a note. Files have no units: they are SI's. */
#ifndef CASE_MSML_H
#define CASE_MSML_H

#include "case_feb.h"

/* Cells along the longest side of a surface that a mesher fills. */
enum { MSML_CELLS = 20 };

/* Values that name values that name values ...; and letters of a statement and of a number. */
enum { MSML_MAX_NAMES = 8, MSML_MAX_STATEMENT = 1024, MSML_MAX_NUMBER = 64 };

/* More than organs have: lengths (m) that look like millimetres, densities (kg/m^3) that look like g/cm^3. */
static const double msml_long = 10, msml_light = 10;

typedef struct msml_element {
    const char *name;
    int parent; /* its place in the list, -1: of the file */
    inp_place place;
    int first_attribute, attribute_count;
    int selected;   /* of an operator: what was selected by its box, as bits of CASE_SELECT_... */
    int is_needed;  /* an operator that the model is made by */
    int is_refused; /* that is said once */
} msml_element;

/* Where springs of a statement hang. */
typedef struct msml_spring {
    int element, group; /* of the constraint; operator of its nodes */
    int statement;
    double stiffness;
} msml_spring;

typedef struct msml_reader {
    feb_reader file; /* the pieces of the file, complaints and memory; no model of FEBio */
    inp_list elements, attributes, springs;
    const char *mesh_path;          /* of the object's mesh; NULL: it is made, or there is none */
    const msml_element *mesh_maker; /* the operator that makes it, or NULL */
} msml_reader;

/* ---- what a file may hold ---------------------------------------------------------------------------------- */

/* An element, and its attributes that are understood, each between blanks; id and name may always be there. */
typedef struct msml_rule {
    const char *within, *name, *attributes;
} msml_rule;

static const msml_rule msml_rules[] = {
    {"msml", "variables", " "},
    {"msml", "scene", " "},
    {"msml", "workflow", " "},
    {"msml", "environment", " "},
    {"variables", "var", " value logical physical role "},
    {"scene", "object", " "},
    {"object", "mesh", " "},
    {"object", "sets", " "},
    {"object", "material", " "},
    {"object", "constraints", " "},
    {"object", "output", " "},
    {"mesh", "linearTet", " mesh "},
    {"mesh", "quadraticTet", " mesh "},
    {"sets", "nodes", " "},
    {"sets", "elements", " "},
    {"sets", "surfaces", " "},
    {"nodes", "indexgroup", " indices "},
    {"elements", "indexgroup", " indices "},
    {"surfaces", "indexgroup", " indices "},
    {"material", "region", " indices "},
    {"region", "linearElasticMaterial", " youngModulus poissonRatio "},
    {"region", "corotatedElasticMaterial", " youngModulus poissonRatio "},
    {"region", "mass", " massDensity "},
    {"constraints", "constraint", " forStep "},
    {"constraint", "fixedConstraint", " indices forStep time "},
    {"constraint", "displacementConstraint", " indices displacement forStep "},
    {"constraint", "forceConstraint", " indices force forStep "},
    {"constraint", "surfacePressure", " indices pressure forStep "},
    {"constraint", "springMeshToFixed", " movingPoints fixedPoints stiffness forStep "},
    {"output", "displacement", " timestep useAsterisk "},
    {"environment", "solver",
     " linearSolver preconditioner processingUnit numParallelProcessesOnCPU timeIntegration dampingRayleighRatioMass "
     "dampingRayleighRatioStiffness mass "},
    {"environment", "simulation", " "},
    {"simulation", "step", " dt iterations gravity "},
};
enum { MSML_RULE_COUNT = (int)(sizeof msml_rules / sizeof msml_rules[0]) };

/* Operators, and what they have here. */
static const char *const msml_boxes[] = {"ComputeIndicesFromBoxROI", "boxROIToIndexOperator"};
static const char *const msml_meshers[] = {"mesherTetgen", "mesherCGALs2v", "CGALMeshVolumeFromSurface"};

static inline int msml_is_one_of(const char *name, const char *const *names, int count)
{
    for (int i = 0; i < count; i++)
        if (strcmp(names[i], name) == 0)
            return 1;
    return 0;
}

static inline int msml_is_box(const msml_element *e) { return msml_is_one_of(e->name, msml_boxes, 2); }
static inline int msml_is_mesher(const msml_element *e) { return msml_is_one_of(e->name, msml_meshers, 3); }

/* ---- elements ---------------------------------------------------------------------------------------------- */

static inline msml_element *msml_elements(const msml_reader *m) { return (msml_element *)m->elements.items; }

#define msml_complain(m, e, ...) inp_complain(&(m)->file.model, (e)->place, __VA_ARGS__)

/* The name without the namespace's prefix. */
static inline const char *msml_bare(const char *name) { return strchr(name, ':') ? strchr(name, ':') + 1 : name; }

static inline const xml_attribute *msml_own(const msml_reader *m, const msml_element *e, int i)
{
    return (const xml_attribute *)m->attributes.items + e->first_attribute + i;
}

static inline const char *msml_attribute(const msml_reader *m, const msml_element *e, const char *name)
{
    for (int i = 0; i < e->attribute_count; i++)
        if (strcmp(msml_own(m, e, i)->name, name) == 0)
            return msml_own(m, e, i)->value;
    return NULL;
}

/* The name of what the element is in. */
static inline const char *msml_within(const msml_reader *m, const msml_element *e)
{
    return e->parent < 0 ? "" : msml_elements(m)[e->parent].name;
}

/* The next element called so from place `at` on, within one called so; NULL: there is none. */
static inline msml_element *msml_next(const msml_reader *m, int at, const char *within, const char *name)
{
    for (; at < m->elements.count; at++) {
        msml_element *e = msml_elements(m) + at;
        if (strcmp(msml_within(m, e), within) == 0 && (!name || strcmp(e->name, name) == 0))
            return e;
    }
    return NULL;
}

static inline msml_element *msml_first(const msml_reader *m, const char *within, const char *name)
{
    return msml_next(m, 0, within, name);
}

static inline msml_element *msml_after(const msml_reader *m, const msml_element *e, const char *within,
                                       const char *name)
{
    return msml_next(m, (int)(e - msml_elements(m)) + 1, within, name);
}

/* Complains of all elements called so after the first, which is returned; NULL and a complaint: there is none. */
static inline msml_element *msml_only(msml_reader *m, const char *within, const char *name)
{
    msml_element *first = msml_first(m, within, name), *e = first;
    if (!first)
        inp_complain(&m->file.model, m->file.model.here, "there is no <%s> in a <%s>", name ? name : "...", within);
    while (e && (e = msml_after(m, e, within, name)) != NULL)
        msml_complain(m, e, "a second <%.60s>; the first is in line %d", e->name, first->place.line);
    return first;
}

/* Whether a name stands in a list of them, each between blanks. */
static inline int msml_lists(const char *list, const char *name)
{
    char word[MSML_MAX_NUMBER];
    return snprintf(word, sizeof word, " %s ", name) < (int)sizeof word && strstr(list, word) != NULL;
}

static inline void msml_check_attributes(msml_reader *m, const msml_element *e, const char *known)
{
    for (int i = 0; i < e->attribute_count; i++) {
        const char *name = msml_own(m, e, i)->name;
        if (!msml_lists(known, name) && !msml_lists(" id name ", name))
            msml_complain(m, e, "%.60s= is not understood in <%.60s>", name, e->name);
    }
}

/* Keeps the open element with its attributes, as a child of `parent`; its place in the list, or -1. */
static inline int msml_keep(msml_reader *m, int parent)
{
    const xml_reader *xml = &m->file.xml;
    msml_element *e = (msml_element *)inp_add(&m->file.model, &m->elements, sizeof *e);
    if (!e)
        return -1;
    e->name = msml_bare(xml->name);
    e->parent = parent;
    e->place = feb_place(&m->file);
    e->first_attribute = m->attributes.count;
    for (int i = 0; i < xml->attribute_count; i++) {
        xml_attribute *own = (xml_attribute *)inp_add(&m->file.model, &m->attributes, sizeof *own);
        if (!own)
            return -1;
        *own = xml->attributes[i];
        e->attribute_count++;
    }
    return m->elements.count - 1;
}

static inline void msml_take(msml_reader *m, int parent);

/* The open element, which has a rule or is an operator. */
static inline void msml_take_known(msml_reader *m, const char *attributes, int parent)
{
    int at = msml_keep(m, parent);
    if (at < 0)
        return;
    if (attributes)
        msml_check_attributes(m, msml_elements(m) + at, attributes);
    msml_take(m, at);
}

/* The children of an element, to its end. */
static inline void msml_take(msml_reader *m, int parent)
{
    while (feb_child(&m->file)) {
        const char *within = msml_elements(m)[parent].name, *name = m->file.xml.name;
        int rule = 0, of_workflow = strcmp(within, "workflow") == 0;
        while (rule < MSML_RULE_COUNT &&
               (strcmp(msml_rules[rule].within, within) != 0 || strcmp(msml_rules[rule].name, name) != 0))
            rule++;
        if (of_workflow || rule < MSML_RULE_COUNT)
            msml_take_known(m, of_workflow ? NULL : msml_rules[rule].attributes, parent);
        else
            feb_refuse(&m->file, within);
    }
}

static inline void msml_parse(msml_reader *m)
{
    if (feb_next(&m->file) != XML_OPEN)
        return;
    if (strcmp(msml_bare(m->file.xml.name), "msml") != 0) {
        feb_complain(&m->file, "<%.60s> is no <msml>", m->file.xml.name);
        return;
    }
    if (msml_keep(m, -1) < 0)
        return;
    msml_take(m, 0);
    feb_next(&m->file); /* what is behind it */
}

/* ---- values ------------------------------------------------------------------------------------------------ */

/* Whether a text is ${id}. */
static inline int msml_is_named(const char *text, const char *id)
{
    size_t length = id ? strlen(id) : 0;
    return length > 0 && strncmp(text, "${", 2) == 0 && strncmp(text + 2, id, length) == 0 &&
           strcmp(text + 2 + length, "}") == 0;
}

/* The element whose value ${id} is: a variable, a group, or an operator; NULL: there is none. */
static inline msml_element *msml_find(const msml_reader *m, const char *text)
{
    for (int i = 0; i < m->elements.count; i++) {
        msml_element *e = msml_elements(m) + i;
        int is_variable = strcmp(e->name, "var") == 0 && strcmp(msml_within(m, e), "variables") == 0;
        if ((is_variable || strcmp(e->name, "indexgroup") == 0 || strcmp(msml_within(m, e), "workflow") == 0) &&
            msml_is_named(text, msml_attribute(m, e, is_variable ? "name" : "id")))
            return e;
    }
    return NULL;
}

/* What an attribute has when names are followed: *source, an operator, or else the text that is returned. NULL and no
 * source: it is not there, or names nothing, which is complained about. */
static inline const char *msml_value(msml_reader *m, const msml_element *e, const char *attribute,
                                     msml_element **source)
{
    const char *text = msml_attribute(m, e, attribute), *first = text;
    *source = NULL;
    if (!text || !*text)
        msml_complain(m, e, "<%.60s> needs %s=", e->name, attribute);
    for (int i = 0; text && strchr(text, '$'); i++) {
        msml_element *named = i < MSML_MAX_NAMES ? msml_find(m, text) : NULL;
        if (!named) {
            msml_complain(m, e, "%s=\"%.60s\" of <%.60s> names nothing that is there", attribute, first, e->name);
            return NULL;
        }
        if (strcmp(msml_within(m, named), "workflow") == 0) {
            *source = named;
            return NULL;
        }
        text = msml_attribute(m, named, strcmp(named->name, "var") == 0 ? "value" : "indices");
        if (!text)
            msml_complain(m, named, "<%.60s> has no value", named->name);
    }
    return text && *text ? text : NULL;
}

/* The text of an attribute; NULL and a complaint when it has none. */
static inline const char *msml_text(msml_reader *m, const msml_element *e, const char *attribute)
{
    msml_element *source;
    const char *text = msml_value(m, e, attribute, &source);
    if (source)
        msml_complain(m, e, "%s= of <%.60s> is what an operator makes, <%.60s>, not a value", attribute, e->name,
                      source->name);
    return text;
}

/* The next word of a text, which stays as it is; 0: there is none. A word that is too long is no number. */
static inline int msml_word(const char **text, char word[MSML_MAX_NUMBER])
{
    static const char between[] = ", \t\r\n";
    size_t length;
    *text += strspn(*text, between);
    length = strcspn(*text, between);
    snprintf(word, MSML_MAX_NUMBER, "%.*s", (int)(length < MSML_MAX_NUMBER ? length : MSML_MAX_NUMBER - 1), *text);
    *text += length;
    return length > 0;
}

/* Exactly `count` numbers of an attribute. */
static inline int msml_numbers(msml_reader *m, const msml_element *e, const char *attribute, double *numbers, int count)
{
    const char *text = msml_text(m, e, attribute);
    char word[MSML_MAX_NUMBER];
    int found = 0;
    if (!text)
        return 0;
    for (; msml_word(&text, word); found++) {
        double number;
        if (!case_scan_number(word, &number)) {
            msml_complain(m, e, "%s= of <%.60s>: '%s' is no finite number", attribute, e->name, word);
            return 0;
        }
        if (found < count)
            numbers[found] = number;
    }
    if (found != count)
        msml_complain(m, e, "%s= of <%.60s> has %d numbers where %d are expected", attribute, e->name, found, count);
    return found == count;
}

/* A number of an attribute that need not be there. */
static inline double msml_number_or(msml_reader *m, const msml_element *e, const char *attribute, double otherwise)
{
    double number = otherwise;
    return msml_attribute(m, e, attribute) && msml_numbers(m, e, attribute, &number, 1) ? number : otherwise;
}

/* ---- statements -------------------------------------------------------------------------------------------- */

#if defined(__GNUC__)
#define MSML_PRINTF __attribute__((format(printf, 3, 4)))
#else
#define MSML_PRINTF
#endif

/* Adds a statement of the case file, which has the element's line; NULL: it is wrong, and that is complained about. */
MSML_PRINTF static inline case_statement *msml_say(msml_reader *m, const msml_element *e, const char *format, ...)
{
    case_file *c = m->file.model.c;
    case_file first = *c; /* what was complained about first */
    char words[MSML_MAX_STATEMENT], *rest, *keyword;
    void *items = c->statements;
    case_statement *s;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(words, sizeof words, format, arguments);
    va_end(arguments);
    if (!*inp_keep(&m->file.model, words) ||
        !case_reserve(&items, c->statement_count, &c->statement_capacity, sizeof *c->statements)) {
        m->file.model.no_memory = 1;
        return NULL;
    }
    c->statements = (case_statement *)items;
    s = (case_statement *)memset(c->statements + c->statement_count, 0, sizeof *s);
    s->line = e->place.line;
    rest = c->kept[c->kept_count - 1];
    keyword = case_next_word(&rest);
    c->statement_count++;
    if (case_parse_statement(c, s, keyword, rest))
        return s;
    c->statement_count--;
    msml_complain(m, e, "<%.60s>: %s", e->name, c->message);
    if (first.faults.count > 0) {
        memcpy(c->message, first.message, sizeof c->message);
        c->error_line = first.error_line;
    }
    return NULL;
}

/* An id that a selection can be called by. */
static inline const char *msml_id(msml_reader *m, msml_element *e)
{
    const char *id = msml_attribute(m, e, "id"), *at = id ? id : "";
    while (xml_goes_on(*at))
        at++;
    if (id && *id && !*at)
        return id;
    if (!e->is_refused)
        msml_complain(m, e, "<%.60s> needs an id= of letters and digits", e->name);
    e->is_refused = 1;
    return "";
}

/* ---- mesh -------------------------------------------------------------------------------------------------- */

/* The path of a mesh, which is within the folder of the file; NULL and a complaint: it is none. */
static inline const char *msml_path(msml_reader *m, const msml_element *e, const char *attribute)
{
    const char *path = msml_text(m, e, attribute);
    if (!path || inp_is_within(path))
        return path;
    msml_complain(m, e, "%.200s is outside the folder of the model: not read", path);
    return NULL;
}

/* `mesh FILE`, or `surface FILE`: a file's name may have blanks. */
static inline void msml_say_file(msml_reader *m, const msml_element *e, const char *keyword, const char *path)
{
    case_statement *s = path ? msml_say(m, e, "%s FILE", keyword) : NULL;
    if (s)
        s->path = path;
}

static inline void msml_build_mesh(msml_reader *m)
{
    msml_element *e = msml_only(m, "mesh", NULL), *source;
    if (!e)
        return;
    m->mesh_path = msml_value(m, e, "mesh", &source);
    m->mesh_maker = source;
    if (m->mesh_path) {
        msml_say_file(m, e, "mesh", msml_path(m, e, "mesh"));
    } else if (source && msml_is_mesher(source)) {
        source->is_needed = 1;
        msml_say_file(m, source, "surface", msml_path(m, source, "surfaceMesh"));
        msml_say(m, source, "stuff cells=%d", (int)MSML_CELLS);
        inp_note(&m->file.model, source->place,
                 "%.60s: the surface is stuffed here, with %d tets along its longest side; settings of the mesher are "
                 "left out",
                 source->name, (int)MSML_CELLS);
    } else if (source) {
        msml_complain(m, source,
                      "operator <%.60s> is not read, of meshers only mesherTetgen, mesherCGALs2v and "
                      "CGALMeshVolumeFromSurface",
                      source->name);
        source->is_refused = 1;
    }
    msml_say(m, e, "element %s", strcmp(e->name, "linearTet") == 0 ? "tet4" : "tet10");
}

/* ---- groups ------------------------------------------------------------------------------------------------ */

/* Whether an operator is about the object's mesh, or its surface (then *of_surface). */
static inline int msml_is_of_mesh(msml_reader *m, const msml_element *e, int *of_surface)
{
    msml_element *source;
    const char *text = msml_value(m, e, "mesh", &source);
    *of_surface = 0;
    if (source && strcmp(source->name, "ExtractSurfaceMesh") == 0) {
        *of_surface = source->is_needed = 1;
        text = msml_value(m, source, "mesh", &source);
    }
    if ((!text && !source) || (!m->mesh_path && !m->mesh_maker))
        return 1; /* said already */
    if (text && m->mesh_path ? strcmp(text, m->mesh_path) == 0 : source && source == m->mesh_maker)
        return 1;
    msml_complain(m, e, "<%.60s> is about another mesh than the object's", e->name);
    return 0;
}

/* What a box selects; -1 and a complaint: nothing that is read. */
static inline int msml_selects(msml_reader *m, const msml_element *box)
{
    int of_surface;
    const char *select = msml_text(m, box, "select");
    if (!msml_is_of_mesh(m, box, &of_surface) || !select)
        return -1;
    if (strcmp(select, "points") == 0 && !of_surface)
        return CASE_SELECT_NODES;
    if (strcmp(select, "elements") == 0)
        return of_surface ? CASE_SELECT_FACES : CASE_SELECT_ELEMENTS;
    if (strcmp(select, "surfaceElements") == 0)
        return CASE_SELECT_FACES;
    msml_complain(m, box, "select=\"%.60s\" is not read, only points, elements and surfaceElements%s", select,
                  of_surface ? " (no points of a surface)" : "");
    return -1;
}

/* `select`, once for each kind. */
static inline void msml_say_selection(msml_reader *m, msml_element *box, int code)
{
    static const char *const kinds[] = {"nodes", "elements", "faces"};
    double b[6];
    int was_selected = box->selected >> code & 1;
    box->selected |= 1 << code;
    if (was_selected || !msml_numbers(m, box, "box", b, 6))
        return;
    for (int k = 0; k < 3; k++)
        if (b[k] > b[k + 3]) {
            msml_complain(m, box, "the box is from %g to %g: nothing is in it", b[k], b[k + 3]);
            return;
        }
    msml_say(m, box, "select %s %.200s box=%.17g,%.17g,%.17g,%.17g,%.17g,%.17g", kinds[code], msml_id(m, box), b[0],
             b[1], b[2], b[3], b[4], b[5]);
}

/* The box whose group an element is about, as nodes, elements or faces; NULL and a complaint: there is none. */
static inline msml_element *msml_group(msml_reader *m, const msml_element *e, const char *attribute, int code)
{
    static const char *const kinds[] = {"points", "elements", "faces"};
    msml_element *box;
    int selects;
    if (msml_value(m, e, attribute, &box))
        msml_complain(m, e, "%s= of <%.60s> has numbers: only groups by a box are read", attribute, e->name);
    if (!box || box->is_refused)
        return NULL;
    box->is_needed = 1;
    if (!msml_is_box(box)) {
        box->is_refused = 1;
        msml_complain(m, box, "operator <%.60s> is not read, of groups only ComputeIndicesFromBoxROI", box->name);
        return NULL;
    }
    selects = msml_selects(m, box);
    box->is_refused = selects < 0 || !*msml_id(m, box);
    if (box->is_refused)
        return NULL;
    if (code == CASE_SELECT_ELEMENTS && selects == CASE_SELECT_NODES) {
        if (!(box->selected >> code & 1))
            inp_note(&m->file.model, box->place, "the region has the elements whose middle is in the box");
    } else if (selects != code) {
        msml_complain(m, e, "<%.60s> is about %s, but the box in line %d selects %s", e->name, kinds[code],
                      box->place.line, kinds[selects]);
        return NULL;
    }
    msml_say_selection(m, box, code);
    return box;
}

/* ---- materials --------------------------------------------------------------------------------------------- */

static inline void msml_build_region(msml_reader *m, int region)
{
    const msml_element *e = msml_elements(m) + region, *law = NULL, *mass = NULL, *box;
    double young, poisson, density;
    for (int i = region + 1; i < m->elements.count; i++) {
        const msml_element *child = msml_elements(m) + i, **place = strcmp(child->name, "mass") == 0 ? &mass : &law;
        if (child->parent != region)
            continue;
        if (*place)
            msml_complain(m, child, "a second <%.60s> in a region; the first is in line %d", child->name,
                          (*place)->place.line);
        *place = child;
    }
    box = msml_group(m, e, "indices", CASE_SELECT_ELEMENTS);
    if (!law || !mass)
        msml_complain(m, e, "a region needs a material and a <mass>");
    if (!law || !mass ||
        !(msml_numbers(m, law, "youngModulus", &young, 1) & msml_numbers(m, law, "poissonRatio", &poisson, 1) &
          msml_numbers(m, mass, "massDensity", &density, 1)) ||
        !box)
        return;
    if (density > 0 && density < msml_light)
        inp_note(&m->file.model, mass->place, "a density of %g kg/m^3: are the file's units SI's?", density);
    msml_say(m, law, "material %s E=%.17g nu=%.17g density=%.17g elements=@%.200s",
             *law->name == 'l' ? "linear" : "corotated", young, poisson, density, msml_attribute(m, box, "id"));
}

static inline void msml_build_materials(msml_reader *m)
{
    const msml_element *e = msml_first(m, "material", "region");
    if (!e)
        inp_complain(&m->file.model, m->file.model.here, "there is no <region> in a <material>");
    for (; e; e = msml_after(m, e, "material", "region"))
        msml_build_region(m, (int)(e - msml_elements(m)));
}

/* ---- constraints ------------------------------------------------------------------------------------------- */

/* The step that something is for must be the one that is there. */
static inline void msml_check_step(msml_reader *m, const msml_element *e)
{
    const char *text = msml_attribute(m, e, "forStep");
    const msml_element *step = msml_first(m, "simulation", "step");
    const char *name = step ? msml_attribute(m, step, "name") : NULL;
    if (text && name && !msml_is_named(text, name) && strcmp(text, name) != 0)
        msml_complain(m, e, "forStep=\"%.60s\" of <%.60s> is not the file's step, %.60s", text, e->name, name);
}

/* Springs from nodes, whose positions an operator extracts, to points. */
static inline void msml_build_spring(msml_reader *m, const msml_element *e)
{
    msml_element *points, *box;
    msml_spring *spring;
    double stiffness = 0;
    int of_surface, ok = msml_numbers(m, e, "stiffness", &stiffness, 1);
    if (msml_value(m, e, "movingPoints", &points) || (points && strcmp(points->name, "ExtractPointPositions") != 0))
        msml_complain(m, e, "movingPoints= of <%.60s> is read of ExtractPointPositions only: nodes of the mesh",
                      e->name);
    if (!points || strcmp(points->name, "ExtractPointPositions") != 0)
        return;
    points->is_needed = 1;
    box = msml_is_of_mesh(m, points, &of_surface) ? msml_group(m, points, "indices", CASE_SELECT_NODES) : NULL;
    if (ok && !(stiffness > 0))
        msml_complain(m, e, "the stiffness %g of the springs must be > 0", stiffness);
    if (!msml_text(m, e, "fixedPoints") || !ok || !box || !msml_say(m, e, "spring file=FILE") ||
        !(spring = (msml_spring *)inp_add(&m->file.model, &m->springs, sizeof *spring)))
        return;
    spring->element = (int)(e - msml_elements(m));
    spring->group = (int)(box - msml_elements(m));
    spring->statement = m->file.model.c->statement_count - 1;
    spring->stiffness = stiffness;
    m->file.model.c->statements[spring->statement].text[CASE_FILE] = NULL; /* its list is made, not read */
}

/* A constraint on a group; `end` (s): when displacements have got where they go. */
static inline void msml_build_constraint(msml_reader *m, const msml_element *e, double end)
{
    int of_faces = strcmp(e->name, "surfacePressure") == 0;
    const msml_element *box;
    const char *id;
    double v[3];
    msml_check_step(m, e);
    if (strcmp(e->name, "springMeshToFixed") == 0) {
        msml_build_spring(m, e);
        return;
    }
    box = msml_group(m, e, "indices", of_faces ? CASE_SELECT_FACES : CASE_SELECT_NODES);
    id = box ? msml_attribute(m, box, "id") : "";
    if (strcmp(e->name, "fixedConstraint") == 0) {
        if (msml_number_or(m, e, "time", 0) != 0)
            msml_complain(m, e, "time= of <%.60s> is not read, only 0", e->name);
        if (box)
            msml_say(m, e, "fix xyz nodes=@%.200s", id);
    } else if (of_faces) {
        if (msml_numbers(m, e, "pressure", v, 1) && box)
            msml_say(m, e, "pressure faces=@%.200s value=%.17g", id, v[0]);
    } else if (strcmp(e->name, "forceConstraint") == 0) {
        if (msml_numbers(m, e, "force", v, 3) && box)
            msml_say(m, e, "force nodes=@%.200s value=%.17g,%.17g,%.17g", id, v[0], v[1], v[2]);
    } else if (msml_numbers(m, e, "displacement", v, 3) && box) {
        msml_say(m, e, "prescribe xyz nodes=@%.200s value=%.17g,%.17g,%.17g ramp=%.17g", id, v[0], v[1], v[2], end);
    }
}

static inline void msml_build_constraints(msml_reader *m, double end)
{
    for (const msml_element *e = msml_first(m, "constraints", NULL); e; e = msml_after(m, e, "constraints", NULL))
        msml_check_step(m, e);
    for (const msml_element *e = msml_first(m, "constraint", NULL); e; e = msml_after(m, e, "constraint", NULL))
        msml_build_constraint(m, e, end);
}

/* The springs' lists, when the nodes of groups are known. */
static inline int msml_hang_springs(msml_reader *m)
{
    case_file *c = m->file.model.c;
    for (int i = 0; i < m->springs.count; i++) {
        const msml_spring *spring = (const msml_spring *)m->springs.items + i;
        const msml_element *e = msml_elements(m) + spring->element;
        case_statement *s = c->statements + spring->statement;
        char name[MSML_MAX_STATEMENT];
        const case_statement *nodes;
        double *x;
        int ok;
        snprintf(name, sizeof name, "@%.200s", msml_attribute(m, msml_elements(m) + spring->group, "id"));
        nodes = case_find_selection(c, s, name, CASE_SELECT_NODES);
        x = nodes ? (double *)calloc((size_t)nodes->count + 1, 3 * sizeof *x) : NULL;
        ok = x && msml_numbers(m, e, "fixedPoints", x, 3 * nodes->count);
        for (int k = 0; ok && k < nodes->count; k++) {
            ok = case_reserve_nodes(s) || case_fail_memory(c, s->line);
            if (!ok)
                break;
            s->nodes[s->count] = nodes->nodes[k];
            s->stiffness[s->count] = (sb_real)spring->stiffness;
            s->vectors[s->count++] = sb_v3((sb_real)x[3 * k], (sb_real)x[3 * k + 1], (sb_real)x[3 * k + 2]);
        }
        free(x);
        if (!ok)
            return c->message[0] ? 0 : case_fail_memory(c, s->line);
    }
    return 1;
}

/* ---- environment ------------------------------------------------------------------------------------------- */

/* The solve; returns its duration (s). */
static inline double msml_build_solve(msml_reader *m)
{
    msml_element *solver = msml_only(m, "environment", "solver"), *step = msml_only(m, "simulation", "step");
    const char *scheme = solver ? msml_text(m, solver, "timeIntegration") : NULL;
    double dt = 0, count = 0, g[3], alpha, beta;
    int is_euler = scheme && strcmp(scheme, "dynamicImplicitEuler") == 0, ok;
    if (scheme && !is_euler && strcmp(scheme, "Newmark") != 0) {
        msml_complain(m, solver, "timeIntegration %.60s is not read, only dynamicImplicitEuler and Newmark", scheme);
        scheme = NULL;
    }
    if (!solver || !step)
        return 0;
    ok = msml_numbers(m, step, "dt", &dt, 1) & msml_numbers(m, step, "iterations", &count, 1);
    if (ok && !(count >= 1 && count <= 1e8 && count == (int)count)) {
        msml_complain(m, step, "iterations must be an integer from 1 to 1e8");
        ok = 0;
    }
    if (msml_attribute(m, step, "gravity") && msml_numbers(m, step, "gravity", g, 3))
        msml_say(m, step, "gravity %.17g %.17g %.17g", g[0], g[1], g[2]);
    alpha = msml_number_or(m, solver, "dampingRayleighRatioMass", 0);
    beta = msml_number_or(m, solver, "dampingRayleighRatioStiffness", 0);
    if (ok && scheme)
        msml_say(m, step, "solve %s dt=%.17g end=%.17g alpha=%.17g beta=%.17g", is_euler ? "euler" : "newmark", dt,
                 dt * count, alpha, beta);
    return dt * count;
}

/* ---- the reader -------------------------------------------------------------------------------------------- */

/* An id twice names nothing certain. */
static inline void msml_check_ids(msml_reader *m)
{
    for (int i = 0; i < m->elements.count; i++) {
        const msml_element *e = msml_elements(m) + i, *other;
        const char *id = msml_attribute(m, e, strcmp(e->name, "var") == 0 ? "name" : "id");
        char text[MSML_MAX_STATEMENT];
        int is_source = strcmp(msml_within(m, e), "workflow") == 0 || strcmp(msml_within(m, e), "variables") == 0;
        if (!id || !is_source || snprintf(text, sizeof text, "${%s}", id) >= (int)sizeof text)
            continue;
        other = msml_find(m, text);
        if (other && other < e)
            msml_complain(m, e, "%.60s is there already, from line %d", id, other->place.line);
    }
}

static inline void msml_build(msml_reader *m)
{
    const msml_element *e;
    double end;
    msml_only(m, "scene", "object");
    msml_check_ids(m);
    msml_build_mesh(m);
    end = msml_build_solve(m);
    msml_build_materials(m);
    msml_build_constraints(m, end);
    if ((e = msml_first(m, "output", "displacement")) != NULL)
        msml_say(m, e, "output displacement displacement.txt");
    for (e = msml_first(m, "workflow", NULL); e; e = msml_after(m, e, "workflow", NULL))
        if (!e->is_needed && !e->is_refused)
            inp_note(&m->file.model, e->place, "operator <%.60s> is left out: the model is made without it", e->name);
}

/* Says when the mesh is larger than an organ. */
static inline int msml_check_size(msml_reader *m)
{
    case_file *c = m->file.model.c;
    inp_place place = {c->path, c->mesh_statement->line};
    sb_vec3 low, high;
    double size;
    sb_mesh_bounds(&c->mesh, &low, &high);
    high = sb_v3_sub(high, low);
    size = fmax(fmax((double)high.x, (double)high.y), (double)high.z);
    if (size > msml_long)
        inp_note(&m->file.model, place, "the mesh is %g m long: are its lengths millimetres? They are read as metres",
                 size);
    return 1;
}

static inline int msml_finish(msml_reader *m)
{
    inp_reader *r = &m->file.model;
    case_file *c = r->c;
    int ok;
    if (r->no_memory && c->faults.count == 0)
        inp_complain(r, r->here, "out of memory");
    /* a fault whose line there was no memory for is in the message */
    ok = !c->message[0] && c->faults.count == 0 && case_find_singles(c) && case_load_mesh(c) && msml_check_size(m) &&
         case_load_selections(c) && msml_hang_springs(m) && case_make_regions(c) && case_load_materials(c) &&
         case_load_lists(c) && case_load_rest(c);
    free(m->elements.items);
    free(m->attributes.items);
    free(m->springs.items);
    inp_free(r);
    return ok;
}

/* Reads a file of MSML, as case_read does a case. What is wrong is listed in c->faults. */
static inline int msml_read(case_file *c, const char *path)
{
    msml_reader m;
    if (!case_start(c, path))
        return 0;
    memset(&m, 0, sizeof m);
    inp_start(&m.file.model, c);
    m.file.xml = xml_open(c->text);
    msml_parse(&m);
    c->line_count = m.file.xml.line;
    if (!m.file.xml.message[0] && m.elements.count > 0 && !m.file.model.no_memory)
        msml_build(&m);
    return msml_finish(&m);
}

/* Reads a model of any kind that there is a reader for, by the ending of its name. */
static inline int case_open(case_file *c, const char *path)
{
    return foreign_ends_in(path, "inp")        ? inp_read(c, path)
           : foreign_ends_in(path, "feb")      ? feb_read(c, path)
           : foreign_ends_in(path, "msml.xml") ? msml_read(c, path)
                                               : case_read(c, path);
}

#endif /* CASE_MSML_H */
