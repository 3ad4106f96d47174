/* case_feb: reads an input file of FEBio, format 4.0 or 3.0, as a case:
 *
 *     pieces of XML --feb_take...--> the model that case_inp.h has in memory --feb_build--> case_file
 *
 * Taken are: Module solid; Control STATIC, and DYNAMIC by Newmark's scheme; the materials of foreign_feb_laws; Nodes,
 * Elements (tet4, tet10, hex8, hex20, hex27), NodeSet, ElementSet, Surface; SolidDomain; NodeData; zero and prescribed
 * displacements, linear constraints; nodal forces, pressures, tractions, body forces; load curves that are a ramp or
 * constant; a Step, or several static ones, of which the state at the end is solved for: with what stands outside of
 * them and in the last, at the values that courses have there. What else would change the model is refused, by name and
 * line; what is wrong is listed to the end of the file.
 * Files have no units: they are SI's. */
#ifndef CASE_FEB_H
#define CASE_FEB_H

#include "case_inp.h"
#include "xml.h"

typedef struct feb_facet {
    const char *surface;
    int count, nodes[SB_MAX_FACE_NODES]; /* labels */
    inp_place place;
} feb_facet;

/* Numbers of the nodes of a set, by their places in it. */
typedef struct feb_data {
    const char *name, *set;
    int width;       /* 1, or 3 */
    inp_list values; /* double [places][width] */
    inp_place place;
} feb_data;

/* A number or three, which a load curve scales, or the name of a feb_data. */
typedef struct feb_value {
    double numbers[3];
    const char *map, *course;
    inp_place place;
    int is_given;
} feb_value;

/* A support or load whose values are a feb_data. */
typedef struct feb_use {
    inp_kind kind;
    const char *set;
    int axis; /* of a support */
    feb_value value;
} feb_use;

typedef struct feb_pressure {
    const char *surface;
    feb_value value;
} feb_pressure;

/* A dead stress on undeformed area: scale times traction, each of which may have a course. */
typedef struct feb_traction {
    const char *surface;
    feb_value scale, traction;
} feb_traction;

/* How much the lists hold that a step adds to. */
typedef struct feb_mark {
    int entries, terms, uses, pressures, tractions, offsets;
} feb_mark;

/* Elements of a name, and whether a domain gives them a material. */
typedef struct feb_part {
    const char *name;
    int has_domain;
    inp_place place;
} feb_part;

/* What an equation has on its right side. */
typedef struct feb_offset {
    int term; /* the first of the equation */
    feb_value value;
} feb_offset;

typedef struct feb_reader {
    inp_reader model;
    xml_reader xml;
    inp_list facets, data, uses, pressures, tractions, parts, offsets;
    inp_place smooth;           /* of a course that is not LINEAR; path NULL: there is none */
    int is_uncoupled, is_mixed; /* a law that FEBio takes mixed elements for; the domain says so, or says nothing */
    int has_control, steps, step_count;
    int is_dynamic, was_dynamic;              /* the last step; one before */
    feb_mark mark;                            /* where the present step began, */
    int steps_before;                         /* and what those before it took: */
    double time_before;                       /* s */
    double step_size, rtol, rhoi, newmark[3]; /* alpha, beta, gamma */
    inp_place control_place;
} feb_reader;

/* ---- pieces ------------------------------------------------------------------------------------------------ */

static inline inp_place feb_place(const feb_reader *f)
{
    inp_place place = {f->model.c->path, f->xml.line};
    return place;
}

#define feb_complain(f, ...) inp_complain(&(f)->model, feb_place(f), __VA_ARGS__)

/* The next piece; XML_DONE after what ends the reading. */
static inline xml_piece feb_next(feb_reader *f)
{
    xml_piece piece;
    if (f->model.no_memory || f->model.c->faults.count >= INP_MAX_FAULTS || f->xml.message[0])
        return XML_DONE;
    piece = xml_next(&f->xml);
    f->model.here = feb_place(f);
    if (piece == XML_ERROR)
        feb_complain(f, "%s", f->xml.message);
    return piece == XML_ERROR ? XML_DONE : piece;
}

/* Goes to the next element within the open one; 0: that is at its end. */
static inline int feb_child(feb_reader *f)
{
    for (;;) {
        xml_piece piece = feb_next(f);
        if (piece != XML_TEXT)
            return piece == XML_OPEN;
        feb_complain(f, "text where elements are expected");
    }
}

/* Passes over the rest of the open element. */
static inline void feb_skip(feb_reader *f)
{
    for (int depth = 1; depth > 0;) {
        xml_piece piece = feb_next(f);
        if (piece == XML_DONE)
            return;
        depth += piece == XML_OPEN ? 1 : piece == XML_CLOSE ? -1 : 0;
    }
}

static inline void feb_refuse(feb_reader *f, const char *within)
{
    feb_complain(f, "<%.60s> is not understood in <%.60s>", f->xml.name, within);
    feb_skip(f);
}

/* The text of the open element, to whose end it goes; "" when it has none. */
static inline char *feb_text(feb_reader *f)
{
    static char empty[1];
    char *text = NULL;
    for (;;) {
        xml_piece piece = feb_next(f);
        if (piece == XML_TEXT && !text)
            text = inp_trim(f->xml.text);
        else if (piece == XML_TEXT)
            feb_complain(f, "a comment within a text");
        else if (piece == XML_OPEN)
            feb_refuse(f, "a text");
        else
            return text ? text : empty;
    }
}

/* The next word of a list with commas or blanks between its words; NULL: there is none. */
static inline char *feb_word(char **cursor)
{
    char *word = *cursor + strspn(*cursor, ", \t\r\n"), *end = word + strcspn(word, ", \t\r\n");
    *cursor = *end ? end + 1 : end;
    *end = 0;
    return *word ? word : NULL;
}

/* Exactly `count` numbers. */
static inline int feb_numbers(feb_reader *f, char *text, double *numbers, int count)
{
    int found = 0;
    for (char *word = feb_word(&text); word; word = feb_word(&text), found++)
        if (found < count && !inp_take_number(&f->model, word, 0, numbers + found))
            return 0;
    if (found != count)
        feb_complain(f, "%d numbers where %d are expected", found, count);
    return found == count;
}

static inline double feb_number_text(feb_reader *f, double otherwise)
{
    double number = otherwise;
    return feb_numbers(f, feb_text(f), &number, 1) ? number : otherwise;
}

/* The value of an attribute that must be there; "" and a complaint when it is not. */
static inline const char *feb_need(feb_reader *f, const char *name)
{
    const char *value = xml_attribute_of(&f->xml, name);
    if (!value || !*value)
        feb_complain(f, "<%.60s> needs %s=", f->xml.name, name);
    return value ? value : "";
}

static inline int feb_id(feb_reader *f, const char *name, int *id)
{
    const char *text = feb_need(f, name);
    return *text && inp_take_label(&f->model, text, name, id);
}

/* What the open element <x lc= type=> has. */
static inline void feb_take_value(feb_reader *f, feb_value *v, int count)
{
    const char *type = xml_attribute_of(&f->xml, "type"), *course = xml_attribute_of(&f->xml, "lc");
    char *text;
    v->place = feb_place(f);
    v->course = course && strcmp(course, "0") != 0 ? course : NULL;
    v->is_given = 1;
    if (type && strcmp(type, "map") != 0 && strcmp(type, "const") != 0)
        feb_complain(f, "a value of type %.40s is not understood, only const and map", type);
    text = feb_text(f);
    if (type && strcmp(type, "map") == 0)
        v->map = text;
    else if (!type || strcmp(type, "const") == 0)
        feb_numbers(f, text, v->numbers, count);
}

/* An axis by its letter; -1 and a complaint: it is none. */
static inline int feb_axis(feb_reader *f, const char *text)
{
    int axes = *text && !text[1] ? case_scan_axes(text) : 0;
    if (axes == 0)
        feb_complain(f, "'%.40s' is no axis x, y or z", text);
    return axes == 0 ? -1 : axes == SB_X ? 0 : axes == SB_Y ? 1 : 2;
}

/* 1 for an element whose text is a true value. */
static inline int feb_flag(feb_reader *f) { return feb_number_text(f, 0) != 0; }

/* ---- control ----------------------------------------------------------------------------------------------- */

static inline void feb_take_module(feb_reader *f)
{
    const char *type = feb_need(f, "type");
    if (*type && strcmp(type, "solid") != 0)
        feb_complain(f, "Module %.40s is not read, only solid", type);
    feb_skip(f);
}

static inline void feb_take_solver(feb_reader *f)
{
    static const char *const names[] = {"alpha", "beta", "gamma"};
    const char *type = xml_attribute_of(&f->xml, "type");
    if (type && strcmp(type, "solid") != 0)
        feb_complain(f, "solver %.40s is not read, only solid", type);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        double *number = strcmp(name, "rtol") == 0 ? &f->rtol : strcmp(name, "rhoi") == 0 ? &f->rhoi : NULL;
        for (int i = 0; i < 3 && !number; i++)
            number = strcmp(name, names[i]) == 0 ? f->newmark + i : NULL;
        if (number)
            *number = feb_number_text(f, *number);
        else if (strcmp(name, "arc_length") == 0 && feb_flag(f))
            feb_complain(f, "arc_length is not read");
        else if (strcmp(name, "arc_length") != 0) /* how FEBio solves is its own */
            feb_skip(f);
    }
}

static inline void feb_take_analysis(feb_reader *f)
{
    char word[16];
    snprintf(word, sizeof word, "%s", feb_text(f));
    inp_squeeze(word);
    f->is_dynamic = strcmp(word, "DYNAMIC") == 0;
    if (!f->is_dynamic && strcmp(word, "STATIC") != 0)
        feb_complain(f, "analysis %.20s is not read, only STATIC and DYNAMIC", word);
}

static inline void feb_take_control(feb_reader *f)
{
    if (f->has_control)
        feb_complain(f, "a second Control; the first is in line %d", f->control_place.line);
    f->has_control = 1;
    f->control_place = feb_place(f);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        double steps;
        if (strcmp(name, "analysis") == 0) {
            feb_take_analysis(f);
        } else if (strcmp(name, "time_steps") == 0) {
            steps = feb_number_text(f, 1);
            f->steps = steps >= 1 && steps <= 1e8 ? (int)steps : 0;
            if (f->steps != steps)
                feb_complain(f, "time_steps must be an integer from 1 to 1e8");
        } else if (strcmp(name, "step_size") == 0) {
            f->step_size = feb_number_text(f, 1);
            if (!(f->step_size > 0))
                feb_complain(f, "step_size must be > 0");
        } else if (strcmp(name, "solver") == 0) {
            feb_take_solver(f);
        } else {
            feb_skip(f);
        }
    }
}

/* ---- materials --------------------------------------------------------------------------------------------- */

/* The constants of a material of FEBio. */
typedef struct feb_constants {
    double e, v, g, k, density;
    double c[FOREIGN_FEB_YEOH];
    int is_other_pressure;
} feb_constants;

static inline double *feb_constant(feb_constants *m, const char *name)
{
    if (*name == 'c' && name[1] >= '1' && name[1] <= '6' && !name[2])
        return m->c + (name[1] - '1');
    return strcmp(name, "E") == 0         ? &m->e
           : strcmp(name, "v") == 0       ? &m->v
           : strcmp(name, "G") == 0       ? &m->g
           : strcmp(name, "k") == 0       ? &m->k
           : strcmp(name, "density") == 0 ? &m->density
                                          : NULL;
}

static inline void feb_take_constants(feb_reader *f, feb_constants *m)
{
    memset(m, 0, sizeof *m);
    m->is_other_pressure = 1;
    while (feb_child(f)) {
        double *constant = feb_constant(m, f->xml.name);
        feb_value value;
        memset(&value, 0, sizeof value);
        if (constant) {
            feb_take_value(f, &value, 1);
            *constant = value.numbers[0];
            if (value.map || value.course)
                feb_complain(f, "a constant that depends on place or time is not read");
        } else if (strcmp(f->xml.name, "pressure_model") == 0) {
            const char *text = feb_text(f);
            m->is_other_pressure = strcmp(text, foreign_feb_pressure) != 0 && strcmp(text, "2") != 0;
        } else {
            feb_refuse(f, "material");
        }
    }
}

/* An uncoupled law: as one of *HYPERELASTIC. */
static inline void feb_set_uncoupled(feb_reader *f, inp_material *m, const feb_constants *read, const char *type)
{
    int is_neo = *type == 'i', is_yeoh = *type == 'Y';
    double c1 = is_neo ? read->g / 2 : read->c[0];
    f->is_uncoupled = 1;
    m->law = is_yeoh                     ? foreign_find_law("REDUCEDPOLYNOMIAL", read->c[2] != 0 ? 3 : 2)
             : is_neo || read->c[1] == 0 ? foreign_find_law("NEOHOOKE", 0)
                                         : foreign_find_law("MOONEY-RIVLIN", 0);
    for (int k = 0; k < m->law->constants; k++)
        m->constants[k] = read->c[k];
    m->constants[0] = c1;
    m->constants[m->law->constants] = read->k > 0 ? foreign_other_modulus(read->k) : 0;
    for (int k = 1; k < foreign_volume_terms(m->law); k++)
        m->constants[m->law->constants + k] = 0;
    m->wanted = m->constant_count = m->law->constants + foreign_volume_terms(m->law);
    for (int k = is_neo ? 0 : is_yeoh ? 3 : 2; k < (int)FOREIGN_FEB_YEOH; k++)
        if (read->c[k] != 0)
            inp_complain(&f->model, m->place, "material %.60s has a c%d: a %.60s is read without", m->name, k + 1,
                         type);
    if (!(read->k > 0) || !(c1 > 0))
        inp_complain(&f->model, m->place, "material %.60s needs %s > 0 and k > 0", m->name, is_neo ? "G" : "c1");
    if (read->is_other_pressure)
        inp_note(
            &f->model, m->place,
            "material %.60s: the term of volume is k/2 (J - 1)^2 here (pressure_model Abaqus), equal to FEBio's other "
            "ones to second order only",
            m->name);
}

static inline void feb_take_material(feb_reader *f)
{
    const char *type = feb_need(f, "type"), *name = xml_attribute_of(&f->xml, "name");
    inp_material *m = (inp_material *)inp_add(&f->model, &f->model.materials, sizeof *m);
    inp_place place = feb_place(f);
    feb_constants read;
    if (!name)
        name = feb_need(f, "id");
    feb_take_constants(f, &read);
    if (!m)
        return;
    m->name = name;
    m->place = m->law_place = place;
    m->density = read.density;
    for (const inp_material *other = inp_materials(&f->model); other < m; other++)
        if (strcmp(other->name, name) == 0)
            inp_complain(&f->model, place, "material %.60s is there already, from line %d", name, other->place.line);
    if (read.density == 0) {
        m->density = 1;
        inp_note(&f->model, place, "material %.60s has no density: 1 kg/m^3, as in FEBio", name);
    } else if (!(read.density > 0)) {
        inp_complain(&f->model, place, "the density must be > 0");
    }
    if (strcmp(type, "Mooney-Rivlin") == 0 || strcmp(type, "incomp neo-Hookean") == 0 || strcmp(type, "Yeoh") == 0) {
        feb_set_uncoupled(f, m, &read, type);
    } else if (strcmp(type, "isotropic elastic") == 0 || strcmp(type, "neo-Hookean") == 0) {
        m->model = *type == 'i' ? "svk" : "neo_hookean";
        m->constants[0] = read.e;
        m->constants[1] = read.v;
        m->wanted = m->constant_count = 2;
    } else if (*type) {
        inp_complain(&f->model, place,
                     "material type %.60s is not read, only isotropic elastic, neo-Hookean, Mooney-Rivlin, incomp "
                     "neo-Hookean and Yeoh",
                     type);
    }
}

static inline void feb_take_materials(feb_reader *f)
{
    while (feb_child(f))
        if (strcmp(f->xml.name, "material") == 0)
            feb_take_material(f);
        else
            feb_refuse(f, "Material");
}

/* ---- mesh -------------------------------------------------------------------------------------------------- */

/* Makes a set that is filled now; a name twice is a fault. */
static inline void feb_open_set(feb_reader *f, const char *name, int of_elements)
{
    if (*name && inp_find_set(&f->model, name, of_elements) >= 0)
        feb_complain(f, "a set %.60s is there already", name);
    f->model.card_place = feb_place(f);
    inp_open_set(&f->model, name, of_elements);
}

static inline void feb_take_node(feb_reader *f)
{
    double x[3] = {0, 0, 0};
    int label = 1, ok = feb_id(f, "id", &label);
    inp_node *node = (inp_node *)inp_add(&f->model, &f->model.nodes, sizeof *node);
    inp_place place = feb_place(f);
    ok = feb_numbers(f, feb_text(f), x, 3) && ok;
    if (!node || !ok)
        return;
    node->label = label;
    node->x = sb_v3((sb_real)x[0], (sb_real)x[1], (sb_real)x[2]);
    node->place = place;
    inp_add_to_set(&f->model, label);
}

/* Labels of nodes; more than `most` are a fault. Returns how many. */
static inline int feb_take_labels(feb_reader *f, int *labels, int most)
{
    int count = 0, label;
    char *text = feb_text(f);
    for (char *word = feb_word(&text); word; word = feb_word(&text)) {
        if (!inp_take_label(&f->model, word, "node", &label))
            return -1;
        if (count < most)
            labels[count] = label;
        count++;
    }
    return count;
}

static inline void feb_take_element(feb_reader *f)
{
    int labels[SB_MAX_ELEMENT_NODES], own[SB_MAX_ELEMENT_NODES],
        label = 1, width = sb_element_node_count(f->model.element->type), count;
    int ok = feb_id(f, "id", &label);
    inp_place place = feb_place(f);
    inp_element *element;
    count = feb_take_labels(f, labels, width);
    if (count >= 0 && count != width)
        inp_complain(&f->model, place, "the element has %d nodes, but a %s %d", count, f->model.element->feb, width);
    if (!ok || count != width || !(element = (inp_element *)inp_add(&f->model, &f->model.elements, sizeof *element)))
        return;
    element->label = label;
    element->place = place;
    inp_add_to_set(&f->model, label);
    for (int a = 0; a < width; a++)
        own[foreign_feb_place(f->model.element->type, a)] = labels[a];
    for (int a = 0; a < width; a++)
        inp_add_int(&f->model, &f->model.element_nodes, own[a]);
}

/* Whether the elements are of the body's one type. */
static inline int feb_take_type(feb_reader *f, const char *type)
{
    const foreign_element *element = NULL;
    for (int i = 0; i < FOREIGN_ELEMENT_COUNT; i++)
        if (strcmp(foreign_elements[i].feb, type) == 0)
            element = foreign_elements + i;
    if (!element && *type)
        feb_complain(f, "elements %.40s are not read, only tet4, tet10, hex8, hex20 and hex27", type);
    else if (element && f->model.element && element != f->model.element)
        feb_complain(f, "elements %s beside %s in line %d: a body has one type", type, f->model.element->feb,
                     f->model.element_place.line);
    else if (element && !f->model.element) {
        f->model.element = element;
        f->model.element_place = feb_place(f);
    }
    return element && element == f->model.element;
}

static inline void feb_take_elements(feb_reader *f)
{
    const char *name = feb_need(f, "name");
    feb_part *part = (feb_part *)inp_add(&f->model, &f->parts, sizeof *part);
    if (part) {
        part->name = name;
        part->place = feb_place(f);
    }
    if (!feb_take_type(f, feb_need(f, "type"))) {
        feb_skip(f);
        return;
    }
    feb_open_set(f, name, 1);
    while (feb_child(f))
        if (strcmp(f->xml.name, "elem") == 0)
            feb_take_element(f);
        else
            feb_refuse(f, "Elements");
}

/* One entry of a set: N, or a row A:B or A:B:STEP. */
static inline void feb_take_item(feb_reader *f, char *word, const char *what)
{
    char *second = strchr(word, ':'), *third = second ? strchr(second + 1, ':') : NULL;
    int first, last, step = 1;
    if (second)
        *second++ = 0;
    if (third)
        *third++ = 0;
    if (!inp_take_label(&f->model, word, what, &first))
        return;
    last = first;
    if ((second && !inp_take_label(&f->model, second, what, &last)) ||
        (third && !inp_take_label(&f->model, third, "step", &step)))
        return;
    if (last < first)
        feb_complain(f, "from %d to %d is no ascending row", first, last);
    else if (inp_has_room(&f->model, (last - first) / step + 1))
        for (long long label = first; label <= last && !f->model.no_memory; label += step)
            inp_add_to_set(&f->model, (int)label);
}

/* A set as a text, or as elements <n id=""/>. */
static inline void feb_take_set(feb_reader *f, int of_elements)
{
    const char *what = of_elements ? "element" : "node";
    feb_open_set(f, feb_need(f, "name"), of_elements);
    for (xml_piece piece = feb_next(f); piece == XML_TEXT || piece == XML_OPEN; piece = feb_next(f)) {
        char *text = piece == XML_TEXT ? f->xml.text : NULL;
        int label;
        if (!text && feb_id(f, "id", &label))
            inp_add_to_set(&f->model, label);
        if (!text)
            feb_skip(f);
        for (char *word = text ? feb_word(&text) : NULL; word; word = feb_word(&text))
            feb_take_item(f, word, what);
    }
}

static inline void feb_take_surface(feb_reader *f)
{
    const char *name = feb_need(f, "name");
    for (int i = 0; i < f->facets.count; i++)
        if (strcmp(((const feb_facet *)f->facets.items)[i].surface, name) == 0) {
            feb_complain(f, "surface %.60s is there already", name);
            break;
        }
    while (feb_child(f)) {
        feb_facet *facet = (feb_facet *)inp_add(&f->model, &f->facets, sizeof *facet);
        inp_place place = feb_place(f);
        int nodes[SB_MAX_FACE_NODES], count = feb_take_labels(f, nodes, SB_MAX_FACE_NODES);
        if (!facet)
            return;
        if (count >= 0 && (count < 3 || count > SB_MAX_FACE_NODES))
            inp_complain(&f->model, place, "a face with %d nodes", count);
        facet->surface = name;
        facet->place = place;
        facet->count = count < 3 || count > SB_MAX_FACE_NODES ? 0 : count;
        memcpy(facet->nodes, nodes, (size_t)facet->count * sizeof *nodes);
    }
}

static inline void feb_take_mesh(feb_reader *f)
{
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "Nodes") == 0) {
            const char *set = xml_attribute_of(&f->xml, "name");
            feb_open_set(f, set ? set : "", 0);
            while (feb_child(f))
                if (strcmp(f->xml.name, "node") == 0)
                    feb_take_node(f);
                else
                    feb_refuse(f, "Nodes");
        } else if (strcmp(name, "Elements") == 0) {
            feb_take_elements(f);
        } else if (strcmp(name, "NodeSet") == 0 || strcmp(name, "ElementSet") == 0) {
            feb_take_set(f, *name == 'E');
        } else if (strcmp(name, "Surface") == 0) {
            feb_take_surface(f);
        } else if (strcmp(name, "Edge") == 0 || strcmp(name, "SurfacePair") == 0 || strcmp(name, "DiscreteSet") == 0) {
            feb_skip(f); /* what would use them is refused */
        } else {
            feb_refuse(f, "Mesh");
        }
    }
}

/* A part of the mesh and its material. */
static inline void feb_take_domains(feb_reader *f)
{
    while (feb_child(f)) {
        const char *name, *material, *type = xml_attribute_of(&f->xml, "type");
        inp_section *section;
        int found = 0;
        if (strcmp(f->xml.name, "SolidDomain") != 0) {
            feb_refuse(f, "MeshDomains");
            continue;
        }
        name = feb_need(f, "name");
        material = feb_need(f, "mat");
        for (int i = 0; i < f->parts.count; i++)
            if (strcmp(((feb_part *)f->parts.items)[i].name, name) == 0)
                found = ((feb_part *)f->parts.items)[i].has_domain = 1;
        if (!found && *name)
            feb_complain(f, "there are no Elements %.60s", name);
        if (type && strcmp(type, "elastic-solid") != 0 && strcmp(type, "three-field-solid") != 0)
            feb_complain(f, "domain type %.40s is not read, only elastic-solid and three-field-solid", type);
        f->is_mixed |= !type || strcmp(type, "elastic-solid") != 0;
        section = (inp_section *)inp_add(&f->model, &f->model.sections, sizeof *section);
        if (section) {
            section->set = name;
            section->material = material;
            section->place = feb_place(f);
        }
        feb_skip(f);
    }
}

/* Numbers of nodes by their places in a set, which count from 1. */
static inline void feb_take_node_data(feb_reader *f, feb_data *data)
{
    while (feb_child(f)) {
        int place = 0;
        double numbers[3] = {0, 0, 0};
        int ok = feb_id(f, "lid", &place) && feb_numbers(f, feb_text(f), numbers, data->width);
        if (ok && place != data->values.count / data->width + 1) {
            feb_complain(f, "lid %d where %d is expected: they are read in order", place,
                         data->values.count / data->width + 1);
            ok = 0;
        }
        for (int k = 0; k < data->width && ok; k++) {
            double *value = (double *)inp_add(&f->model, &data->values, sizeof *value);
            if (value)
                *value = numbers[k];
        }
    }
}

static inline void feb_take_data(feb_reader *f)
{
    while (feb_child(f)) {
        const char *type = xml_attribute_of(&f->xml, "data_type"), *name, *set;
        feb_data *data;
        if (strcmp(f->xml.name, "NodeData") != 0 || xml_attribute_of(&f->xml, "type")) {
            feb_refuse(f, "MeshData");
            continue;
        }
        if (type && strcmp(type, "scalar") != 0 && strcmp(type, "vec3") != 0)
            feb_complain(f, "data_type %.40s is not read, only scalar and vec3", type);
        name = feb_need(f, "name");
        set = feb_need(f, "node_set");
        data = (feb_data *)inp_add(&f->model, &f->data, sizeof *data);
        if (!data)
            return;
        data->name = name;
        data->set = set;
        data->width = type && strcmp(type, "vec3") == 0 ? 3 : 1;
        data->place = feb_place(f);
        feb_take_node_data(f, data);
    }
}

/* ---- supports ---------------------------------------------------------------------------------------------- */

static inline inp_entry *feb_add_entry(feb_reader *f, inp_kind kind, const char *target, const feb_value *v)
{
    inp_entry *e = (inp_entry *)inp_add(&f->model, &f->model.entries, sizeof *e);
    if (!e)
        return NULL;
    e->kind = kind;
    e->step = 1;
    e->target = target;
    e->amplitude = v->course;
    e->place = v->place;
    return e;
}

/* The set of nodes that an element names, which may be that of a surface: then it is made. */
static inline const char *feb_node_set(feb_reader *f)
{
    static const char of_surface[] = "@surface:";
    const char *name = feb_need(f, "node_set"), *surface = name + sizeof of_surface - 1;
    int found = 0;
    if (!*name || inp_find_set(&f->model, name, 0) >= 0)
        return name;
    if (*name != '@') {
        feb_complain(f, "there is no node set %.60s before this line", name);
        return name;
    }
    if (strncmp(name, of_surface, sizeof of_surface - 1) != 0) {
        feb_complain(f, "node_set %.60s is not understood, only sets and @surface:NAME", name);
        return name;
    }
    feb_open_set(f, name, 0);
    for (int i = 0; i < f->facets.count; i++) {
        const feb_facet *facet = (const feb_facet *)f->facets.items + i;
        if (strcmp(facet->surface, surface) != 0)
            continue;
        found = 1;
        for (int k = 0; k < facet->count; k++)
            inp_add_to_set(&f->model, facet->nodes[k]);
    }
    if (!found)
        feb_complain(f, "there is no surface %.60s before this line", surface);
    return name;
}

/* <x_dof>1</x_dof>, or <dofs>x,y</dofs> of format 3.0. */
static inline void feb_take_fix(feb_reader *f, const char *set)
{
    int axes = 0;
    feb_value nothing;
    memset(&nothing, 0, sizeof nothing);
    nothing.place = feb_place(f);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (*name && strcmp(name + 1, "_dof") == 0 && *name >= 'x' && *name <= 'z') {
            int bit = 1 << (*name - 'x');
            axes |= feb_flag(f) ? bit : 0;
        } else if (strcmp(name, "dofs") == 0) {
            char *text = feb_text(f);
            for (char *word = feb_word(&text); word; word = feb_word(&text)) {
                int axis = feb_axis(f, word);
                axes |= axis < 0 ? 0 : 1 << axis;
            }
        } else {
            feb_refuse(f, "bc");
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        inp_entry *e = axes >> axis & 1 ? feb_add_entry(f, INP_BOUNDARY, set, &nothing) : NULL;
        if (e)
            e->first = e->last = axis;
    }
}

static inline void feb_add_use(feb_reader *f, inp_kind kind, const char *set, int axis, const feb_value *v)
{
    feb_use *use = (feb_use *)inp_add(&f->model, &f->uses, sizeof *use);
    if (!use)
        return;
    use->kind = kind;
    use->set = set;
    use->axis = axis;
    use->value = *v;
}

static inline void feb_take_prescribe(feb_reader *f, const char *set)
{
    inp_place place = feb_place(f);
    feb_value v;
    int axis = -2;
    inp_entry *e;
    memset(&v, 0, sizeof v);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "dof") == 0)
            axis = feb_axis(f, feb_text(f));
        else if (strcmp(name, "value") == 0 || strcmp(name, "scale") == 0)
            feb_take_value(f, &v, 1);
        else if (strcmp(name, "relative") != 0)
            feb_refuse(f, "bc");
        else if (feb_flag(f))
            feb_complain(f, "a relative displacement is not read");
    }
    if (axis == -2 || !v.is_given)
        inp_complain(&f->model, place, "a prescribed displacement needs <dof> and <value>");
    if (axis < 0 || !v.is_given)
        return;
    if (v.map) {
        feb_add_use(f, INP_BOUNDARY, set, axis, &v);
    } else if ((e = feb_add_entry(f, INP_BOUNDARY, set, &v)) != NULL) {
        e->first = e->last = axis;
        e->value = v.numbers[0];
    }
}

/* The node, axis and number of a term. */
static inline void feb_take_term(feb_reader *f, inp_term *t, int is_child)
{
    t->axis = -1;
    t->place = feb_place(f);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "node") == 0)
            inp_take_label(&f->model, feb_text(f), "node", &t->label);
        else if (strcmp(name, "dof") == 0)
            t->axis = feb_axis(f, feb_text(f));
        else if (is_child && strcmp(name, "value") == 0 && !xml_attribute_of(&f->xml, "lc"))
            t->coefficient = -feb_number_text(f, 0);
        else
            feb_refuse(f, "child_dof");
    }
    if (t->label == 0 || t->axis < 0)
        inp_complain(&f->model, t->place, "a linear constraint needs <node> and <dof>");
}

/* u = offset + sum of value u: the first term is u, then come the others. */
static inline void feb_take_constraint(feb_reader *f)
{
    int first = f->model.terms.count;
    feb_value offset;
    feb_offset *o;
    inp_term slave, *t = (inp_term *)inp_add(&f->model, &f->model.terms, sizeof *t);
    memset(&slave, 0, sizeof slave);
    memset(&offset, 0, sizeof offset);
    slave.place = feb_place(f);
    slave.axis = -1;
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "node") == 0)
            inp_take_label(&f->model, feb_text(f), "node", &slave.label);
        else if (strcmp(name, "dof") == 0)
            slave.axis = feb_axis(f, feb_text(f));
        else if (strcmp(name, "offset") == 0)
            feb_take_value(f, &offset, 1);
        else if (strcmp(name, "child_dof") != 0)
            feb_refuse(f, "bc");
        else {
            inp_term child;
            memset(&child, 0, sizeof child);
            feb_take_term(f, &child, 1);
            if ((t = (inp_term *)inp_add(&f->model, &f->model.terms, sizeof *t)) != NULL)
                *t = child;
        }
    }
    if (slave.label == 0 || slave.axis < 0)
        inp_complain(&f->model, slave.place, "a linear constraint needs <node> and <dof>");
    if (offset.map)
        inp_complain(&f->model, slave.place, "an offset is one number");
    slave.starts = 1;
    slave.coefficient = 1;
    if (first < f->model.terms.count)
        inp_terms(&f->model)[first] = slave;
    if (offset.numbers[0] != 0 && (o = (feb_offset *)inp_add(&f->model, &f->offsets, sizeof *o)) != NULL) {
        o->term = first;
        o->value = offset;
    }
}

static inline void feb_take_boundary(feb_reader *f)
{
    while (feb_child(f)) {
        const char *type, *set;
        if (strcmp(f->xml.name, "bc") != 0) {
            feb_refuse(f, "Boundary");
            continue;
        }
        type = feb_need(f, "type");
        if (strcmp(type, "linear constraint") == 0) {
            feb_take_constraint(f);
            continue;
        }
        if (strcmp(type, "zero displacement") != 0 && strcmp(type, "fix") != 0 &&
            strcmp(type, "prescribed displacement") != 0 && strcmp(type, "prescribe") != 0) {
            if (*type)
                feb_complain(f, "bc %.60s is not read", type);
            feb_skip(f);
            continue;
        }
        set = feb_node_set(f);
        if (*type == 'z' || *type == 'f')
            feb_take_fix(f, set);
        else
            feb_take_prescribe(f, set);
    }
}

/* ---- loads ------------------------------------------------------------------------------------------------- */

static inline void feb_add_force(feb_reader *f, const char *set, int axis, double force, const feb_value *v)
{
    inp_entry *e = feb_add_entry(f, INP_CLOAD, set, v);
    if (!e)
        return;
    e->first = e->last = axis;
    e->value = force;
}

/* <value> of three numbers, or of format 3.0 <dof> and <scale>. */
static inline void feb_take_nodal_load(feb_reader *f)
{
    const char *type = feb_need(f, "type"), *set = feb_node_set(f);
    int axis = -1, of_axis = strcmp(type, "nodal_load") == 0;
    inp_place place = feb_place(f);
    feb_value v;
    memset(&v, 0, sizeof v);
    if (!of_axis && strcmp(type, "nodal_force") != 0)
        feb_complain(f, "nodal_load %.40s is not read, only nodal_force", type);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, of_axis ? "scale" : "value") == 0)
            feb_take_value(f, &v, of_axis ? 1 : 3);
        else if (of_axis && strcmp(name, "dof") == 0)
            axis = feb_axis(f, feb_text(f));
        else if ((strcmp(name, "relative") != 0 && strcmp(name, "shell_bottom") != 0) || feb_flag(f))
            feb_complain(f, "<%.60s> is not understood in <nodal_load>", name);
    }
    if (!v.is_given || (of_axis && (axis < 0 || v.map))) {
        inp_complain(&f->model, place, "a nodal load needs %s", of_axis ? "<dof> and <scale>" : "<value>");
    } else if (v.map) {
        feb_add_use(f, INP_CLOAD, set, 0, &v);
    } else if (of_axis) {
        feb_add_force(f, set, axis, v.numbers[0], &v);
    } else {
        for (axis = 0; axis < 3; axis++)
            feb_add_force(f, set, axis, v.numbers[axis], &v);
    }
}

static inline void feb_take_pressure(feb_reader *f, const char *surface)
{
    feb_pressure *p;
    feb_value v;
    memset(&v, 0, sizeof v);
    v.place = feb_place(f);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "pressure") == 0)
            feb_take_value(f, &v, 1);
        else if (strcmp(name, "symmetric_stiffness") == 0)
            feb_skip(f);
        else if ((strcmp(name, "linear") != 0 && strcmp(name, "shell_bottom") != 0) || feb_flag(f))
            feb_complain(f, "<%.60s> is not understood in <surface_load>: pressures follow the faces", name);
    }
    if (!v.is_given || v.map)
        inp_complain(&f->model, v.place, "a pressure needs <pressure> with one number");
    p = (feb_pressure *)inp_add(&f->model, &f->pressures, sizeof *p);
    if (!p)
        return;
    p->surface = surface;
    p->value = v;
}

static inline void feb_take_traction(feb_reader *f, const char *surface)
{
    inp_place place = feb_place(f);
    feb_traction read, *t;
    memset(&read, 0, sizeof read);
    read.surface = surface;
    read.scale.numbers[0] = 1;
    read.scale.place = read.traction.place = place;
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "scale") == 0)
            feb_take_value(f, &read.scale, 1);
        else if (strcmp(name, "traction") == 0)
            feb_take_value(f, &read.traction, 3);
        else if ((strcmp(name, "linear") != 0 && strcmp(name, "shell_bottom") != 0) ||
                 (feb_flag(f) && strcmp(name, "linear") != 0)) /* tractions are of undeformed area anyway */
            feb_complain(f, "<%.60s> is not understood in <surface_load>", name);
    }
    if (!read.traction.is_given || read.traction.map || read.scale.map)
        inp_complain(&f->model, place,
                     "a traction needs <traction> with three numbers, and at most a <scale> with one");
    t = (feb_traction *)inp_add(&f->model, &f->tractions, sizeof *t);
    if (t)
        *t = read;
}

static inline void feb_take_surface_load(feb_reader *f)
{
    const char *type = feb_need(f, "type"), *surface = feb_need(f, "surface");
    if (strcmp(type, "pressure") == 0) {
        feb_take_pressure(f, surface);
    } else if (strcmp(type, "traction") == 0) {
        feb_take_traction(f, surface);
    } else {
        feb_complain(f, "surface_load %.40s is not read, only pressure and traction", type);
        feb_skip(f);
    }
}

/* FEBio takes density times the force from the residual: gravity has the other sign. */
static inline void feb_add_gravity(feb_reader *f, const char *set, int axis, double force, const feb_value *v)
{
    inp_entry *e = force != 0 ? feb_add_entry(f, INP_GRAVITY, set, v) : NULL;
    if (!e)
        return;
    e->value = 1;
    e->direction[axis] = -force;
}

static inline void feb_take_body_load(feb_reader *f)
{
    const char *type = feb_need(f, "type"), *set = xml_attribute_of(&f->xml, "elem_set");
    if (strcmp(type, "body force") != 0 && strcmp(type, "const") != 0) {
        feb_complain(f, "body_load %.40s is not read, only body force and const", type);
        feb_skip(f);
        return;
    }
    if (set && inp_find_set(&f->model, set, 1) < 0)
        feb_complain(f, "there is no element set %.60s before this line", set);
    while (feb_child(f)) {
        const char *name = f->xml.name;
        feb_value v;
        int axis = strlen(name) == 1 && *type == 'c' ? *name - 'x' : -1;
        memset(&v, 0, sizeof v);
        if ((*type == 'b' && strcmp(name, "force") == 0) || (axis >= 0 && axis < 3)) {
            feb_take_value(f, &v, *type == 'b' ? 3 : 1);
            if (v.map)
                inp_complain(&f->model, v.place, "a body force that differs from place to place is not read");
            for (int k = 0; k < 3; k++)
                if (*type == 'b' || k == axis)
                    feb_add_gravity(f, set ? set : "", k, v.numbers[*type == 'b' ? k : 0], &v);
        } else {
            feb_refuse(f, "body_load");
        }
    }
}

static inline void feb_take_loads(feb_reader *f)
{
    while (feb_child(f)) {
        const char *name = f->xml.name;
        if (strcmp(name, "nodal_load") == 0)
            feb_take_nodal_load(f);
        else if (strcmp(name, "surface_load") == 0)
            feb_take_surface_load(f);
        else if (strcmp(name, "body_load") == 0)
            feb_take_body_load(f);
        else
            feb_refuse(f, "Loads");
    }
}

/* ---- courses, output --------------------------------------------------------------------------------------- */

static inline void feb_take_points(feb_reader *f, inp_amplitude *a)
{
    while (feb_child(f)) {
        double point[2];
        if (strcmp(f->xml.name, "pt") != 0 && strcmp(f->xml.name, "point") != 0) {
            feb_refuse(f, "points");
        } else if (feb_numbers(f, feb_text(f), point, 2)) {
            for (int k = 0; k < 2; k++, a->count++)
                if (a->count < 8)
                    a->points[a->count] = point[k];
        }
    }
}

static inline void feb_take_controller(feb_reader *f)
{
    const char *type = xml_attribute_of(&f->xml, "type");
    inp_amplitude read, *a;
    memset(&read, 0, sizeof read);
    read.name = feb_need(f, "id");
    read.place = feb_place(f);
    if (type && strcmp(type, "loadcurve") != 0) {
        feb_complain(f, "load_controller %.40s is not read, only loadcurve", type);
        feb_skip(f);
        return;
    }
    if (inp_find_amplitude(&f->model, read.name))
        feb_complain(f, "load_controller %.40s is there already", read.name);
    while (feb_child(f)) {
        const char *name = f->xml.name, *text;
        if (strcmp(name, "points") == 0) {
            feb_take_points(f, &read);
        } else if (strcmp(name, "interpolate") == 0) {
            if (strcmp(feb_text(f), "LINEAR") != 0)
                f->smooth = read.place;
        } else if (strcmp(name, "extend") == 0) {
            text = feb_text(f);
            if (strcmp(text, "CONSTANT") != 0)
                feb_complain(f, "extend %.40s is not read, only CONSTANT", text);
        } else {
            feb_refuse(f, "load_controller");
        }
    }
    a = (inp_amplitude *)inp_add(&f->model, &f->model.amplitudes, sizeof *a);
    if (a)
        *a = read;
}

static inline void feb_take_courses(feb_reader *f)
{
    while (feb_child(f))
        if (strcmp(f->xml.name, "load_controller") == 0)
            feb_take_controller(f);
        else
            feb_refuse(f, "LoadData");
}

/* Which files are written: by what FEBio's log has. */
static inline void feb_take_log(feb_reader *f)
{
    while (feb_child(f)) {
        const char *data = xml_attribute_of(&f->xml, "data"), *set = xml_attribute_of(&f->xml, "node_set"), **probe;
        int of_nodes = strcmp(f->xml.name, "node_data") == 0;
        if (data && of_nodes && strstr(data, "Rx"))
            f->model.wants_reactions = 1;
        if (data && strcmp(f->xml.name, "element_data") == 0 && strstr(data, "sx"))
            f->model.wants_stresses = 1;
        if (data && of_nodes && set && strstr(data, "ux") &&
            (probe = (const char **)inp_add(&f->model, &f->model.probes, sizeof *probe)) != NULL)
            *probe = set;
        feb_skip(f);
    }
}

static inline void feb_take_output(feb_reader *f)
{
    while (feb_child(f))
        if (strcmp(f->xml.name, "logfile") == 0)
            feb_take_log(f);
        else
            feb_skip(f);
}

/* ---- sections ---------------------------------------------------------------------------------------------- */

static inline void feb_take_section(feb_reader *f, int in_step);

/* A further step: what the one before had is gone, and its time has passed. */
static inline void feb_begin_step(feb_reader *f)
{
    inp_reader *r = &f->model;
    if (f->step_count++ > 0) {
        r->entries.count = f->mark.entries;
        r->terms.count = f->mark.terms;
        f->uses.count = f->mark.uses;
        f->pressures.count = f->mark.pressures;
        f->tractions.count = f->mark.tractions;
        f->offsets.count = f->mark.offsets;
        f->steps_before += f->steps;
        f->time_before += f->steps * f->step_size;
        f->was_dynamic |= f->is_dynamic;
        if (!f->has_control)
            feb_complain(f, "the step before has no Control");
        if (f->steps_before > 100000000) {
            feb_complain(f, "more than 1e8 time_steps");
            f->steps_before = 0;
        }
        f->has_control = f->is_dynamic = 0;
        f->steps = 1;
        f->step_size = 1;
    }
    f->mark.entries = r->entries.count;
    f->mark.terms = r->terms.count;
    f->mark.uses = f->uses.count;
    f->mark.pressures = f->pressures.count;
    f->mark.tractions = f->tractions.count;
    f->mark.offsets = f->offsets.count;
}

/* Steps, whose sections are as those outside. */
static inline void feb_take_step(feb_reader *f)
{
    int before = f->step_count;
    if (before > 0)
        feb_complain(f, "a second Step: all steps stand in one");
    while (feb_child(f)) {
        if (strcmp(f->xml.name, "step") != 0) {
            feb_refuse(f, "Step");
            continue;
        }
        feb_begin_step(f);
        while (feb_child(f))
            feb_take_section(f, 1);
    }
}

/* An element of <febio_spec>, or of a step. One that is not understood may be there when it is empty. */
static inline void feb_take_section(feb_reader *f, int in_step)
{
    static const struct {
        const char *name;
        void (*take)(feb_reader *f);
        int in_step;
    } sections[] = {
        {"Module", feb_take_module, 0},      {"Control", feb_take_control, 1},   {"Globals", feb_skip, 0},
        {"Material", feb_take_materials, 0}, {"Mesh", feb_take_mesh, 0},         {"MeshDomains", feb_take_domains, 0},
        {"MeshData", feb_take_data, 0},      {"Boundary", feb_take_boundary, 1}, {"Loads", feb_take_loads, 1},
        {"LoadData", feb_take_courses, 0},   {"Output", feb_take_output, 0},     {"Step", feb_take_step, 0}};
    const char *name = f->xml.name;
    for (int i = 0; i < (int)(sizeof sections / sizeof sections[0]); i++)
        if (strcmp(sections[i].name, name) == 0 && sections[i].in_step >= in_step) {
            sections[i].take(f);
            return;
        }
    while (feb_child(f))
        feb_refuse(f, name);
}

static inline void feb_parse(feb_reader *f)
{
    const char *version;
    if (feb_next(f) != XML_OPEN)
        return;
    version = xml_attribute_of(&f->xml, "version");
    if (strcmp(f->xml.name, "febio_spec") != 0) {
        feb_complain(f, "<%.60s> is no <febio_spec>", f->xml.name);
    } else if (!version || (strcmp(version, "4.0") != 0 && strcmp(version, "3.0") != 0)) {
        feb_complain(f, "format %.20s is not read, only 4.0 and 3.0", version ? version : "?");
    } else {
        while (feb_child(f))
            feb_take_section(f, 0);
        feb_next(f); /* what is behind it */
    }
}

/* ---- building ---------------------------------------------------------------------------------------------- */

/* Elements by their numbers: parts have them in their own order. */
static inline void feb_sort_elements(feb_reader *f)
{
    inp_reader *r = &f->model;
    size_t count = (size_t)r->elements.count, width = r->element ? (size_t)sb_element_node_count(r->element->type) : 0;
    inp_pair *order = (inp_pair *)inp_allocate(r, count, sizeof *order);
    inp_element *elements = (inp_element *)inp_allocate(r, count, sizeof *elements);
    int *nodes = (int *)inp_allocate(r, count * width, sizeof *nodes);
    if (count > 0 && order && elements && nodes) {
        for (size_t i = 0; i < count; i++) {
            order[i].label = inp_elements(r)[i].label;
            order[i].at = (int)i;
        }
        qsort(order, count, sizeof *order, inp_compare_pairs);
        for (size_t i = 0; i < count; i++) {
            elements[i] = inp_elements(r)[order[i].at];
            memcpy(nodes + i * width, (const int *)r->element_nodes.items + (size_t)order[i].at * width,
                   width * sizeof *nodes);
        }
        memcpy(r->elements.items, elements, count * sizeof *elements);
        memcpy(r->element_nodes.items, nodes, count * width * sizeof *nodes);
    }
    free(order);
    free(elements);
    free(nodes);
}

/* A support or force for each node of a set that has values of its own. */
static inline void feb_use_data(feb_reader *f, const feb_use *use)
{
    const feb_data *data = NULL;
    int set, count, width = use->kind == INP_CLOAD ? 3 : 1;
    for (int i = 0; i < f->data.count; i++)
        if (strcmp(((const feb_data *)f->data.items)[i].name, use->value.map) == 0)
            data = (const feb_data *)f->data.items + i;
    set = data && *data->set != '@' ? inp_find_set(&f->model, data->set, 0) : -1; /* in which order are a surface's? */
    if (!data || set < 0 || data->width != width || strcmp(data->set, use->set) != 0) {
        inp_complain(&f->model, use->value.place, "there is no NodeData %.60s of %s for the node set %.60s",
                     use->value.map, width == 3 ? "vec3" : "scalar", use->set);
        return;
    }
    count = inp_sets(&f->model)[set].items.count;
    if (data->values.count != count * width) {
        inp_complain(&f->model, data->place, "NodeData %.60s has %d values for %d nodes", data->name,
                     data->values.count / width, count);
        return;
    }
    for (int i = 0; i < count * width; i++) {
        inp_entry *e = feb_add_entry(f, use->kind, NULL, &use->value);
        if (!e)
            return;
        e->label = ((const int *)inp_sets(&f->model)[set].items.items)[i / width];
        e->first = e->last = width == 3 ? i % 3 : use->axis;
        e->value = ((const double *)data->values.items)[i];
    }
}

/* 1 when the corners of a facet go around as those of the face do, counter-clockwise from outside; -1: the other way.
 */
static inline int feb_turn(const case_file *c, const int *corners, int element, int face)
{
    const int *cell = c->mesh.elements + (size_t)element * (size_t)sb_mesh_element_width(&c->mesh);
    int local[SB_MAX_FACE_NODES], count = case_face_corners(c), at = 0;
    sb_element_face(c->mesh.element_type, face, local, NULL);
    for (int k = 0; k < count; k++)
        if (cell[local[k]] == corners[0])
            at = k;
    return cell[local[(at + 1) % count]] == corners[1] ? 1 : -1;
}

/* The number of a value at the end, which its course scales; *rise: the time (s) until then in a dynamic analysis. */
static inline double feb_value_at_end(feb_reader *f, const feb_value *v, double *rise)
{
    inp_entry e;
    memset(&e, 0, sizeof e);
    e.step = 1;
    e.value = v->numbers[0];
    e.amplitude = v->course;
    e.place = v->place;
    return inp_entry_value(&f->model, &e, rise);
}

static inline void feb_set_offsets(feb_reader *f)
{
    double rise;
    for (int i = 0; i < f->offsets.count; i++) {
        const feb_offset *o = (const feb_offset *)f->offsets.items + i;
        inp_terms(&f->model)[o->term].value = feb_value_at_end(f, &o->value, &rise);
        if (f->is_dynamic)
            inp_complain(&f->model, o->value.place, "an offset in a dynamic analysis is not read");
    }
}

/* The face of an element that a facet is; 0 and a complaint: it is none. */
static inline int feb_find_face(feb_reader *f, const feb_facet *facet, int *nodes, int *element, int *face)
{
    for (int k = 0; k < facet->count; k++) {
        nodes[k] = inp_find(&f->model.node_map, facet->nodes[k]);
        if (nodes[k] < 0) {
            inp_complain(&f->model, facet->place, "node %d is not there", facet->nodes[k]);
            return 0;
        }
    }
    if (facet->count > 0 && case_find_face(f->model.c, nodes, facet->count, element, face))
        return 1;
    inp_complain(&f->model, facet->place, "these %d nodes are no face of an element", facet->count);
    return 0;
}

/* A pressure on one facet: FEBio's pushes against the side that sees its nodes counter-clockwise. */
static inline void feb_press_facet(feb_reader *f, const feb_facet *facet, double value)
{
    int nodes[SB_MAX_FACE_NODES], element, face;
    inp_pressure *p;
    if (!feb_find_face(f, facet, nodes, &element, &face))
        return;
    p = (inp_pressure *)inp_add(&f->model, &f->model.pressures, sizeof *p);
    if (!p)
        return;
    p->element = element;
    p->face = face;
    p->step = 1;
    p->value = value * feb_turn(f->model.c, nodes, element, face);
}

/* Loads of faces: both kinds need the elements of nodes. */
static inline void feb_find_elements(feb_reader *f)
{
    sb_error error;
    if (f->pressures.count + f->tractions.count > 0 &&
        sb_mesh_node_elements(&f->model.c->mesh, NULL, &f->model.c->node_elements, &error) != SB_OK)
        f->model.no_memory = 1;
}

/* What a load has at the end; in dynamic analyses that is at once. */
static inline double feb_load_at_end(feb_reader *f, const feb_value *v)
{
    double rise, value = feb_value_at_end(f, v, &rise);
    if (rise > 0)
        inp_complain(&f->model, v->place, "a load of a dynamic step is sudden: a ramp is for supports only");
    return value;
}

static inline void feb_press(feb_reader *f)
{
    for (int i = 0; i < f->pressures.count && !f->model.no_memory; i++) {
        const feb_pressure *p = (const feb_pressure *)f->pressures.items + i;
        double value = feb_load_at_end(f, &p->value);
        int found = 0;
        for (int k = 0; k < f->facets.count; k++)
            if (strcmp(((const feb_facet *)f->facets.items)[k].surface, p->surface) == 0) {
                feb_press_facet(f, (const feb_facet *)f->facets.items + k, value);
                found = 1;
            }
        if (!found)
            inp_complain(&f->model, p->value.place, "there is no surface %.60s", p->surface);
    }
}

/* A statement for each traction, in place of the list of faces that a case has. */
static inline void feb_add_traction(feb_reader *f, const feb_traction *t)
{
    inp_reader *r = &f->model;
    feb_value share = t->traction;
    double scale = feb_load_at_end(f, &t->scale), course;
    case_statement *s;
    int found = 0;
    share.numbers[0] = 1;
    course = scale * feb_load_at_end(f, &share);
    s = inp_statement(r, CASE_TRACTION, NULL, CASE_BIT(CASE_FACES) | CASE_BIT(CASE_VALUE), t->traction.place);
    if (!s)
        return;
    s->vector = sb_v3((sb_real)(course * t->traction.numbers[0]), (sb_real)(course * t->traction.numbers[1]),
                      (sb_real)(course * t->traction.numbers[2]));
    for (int k = 0; k < f->facets.count && !r->no_memory; k++) {
        const feb_facet *facet = (const feb_facet *)f->facets.items + k;
        int nodes[SB_MAX_FACE_NODES], element, face;
        if (strcmp(facet->surface, t->surface) != 0)
            continue;
        found = 1;
        if (feb_find_face(f, facet, nodes, &element, &face))
            r->no_memory |= !case_add_face(r->c, s, element, face);
    }
    if (!found)
        inp_complain(r, t->traction.place, "there is no surface %.60s", t->surface);
}

/* The step of the model: its times, and the tolerance, whose square FEBio has. */
static inline void feb_set_step(feb_reader *f)
{
    inp_reader *r = &f->model;
    const char *name = f->is_dynamic ? "DYNAMIC" : "STATIC";
    inp_step *step = (inp_step *)inp_add(r, &r->steps, sizeof *step);
    double time = f->time_before + f->steps * f->step_size;
    if (!step)
        return;
    r->ends_only = f->step_count > 1;
    for (int i = 0; i < INP_KEYWORD_COUNT; i++)
        if (strcmp(inp_keywords[i].name, name) == 0)
            r->procedure = inp_keywords + i;
    step->place = r->step_place = r->procedure_place = f->control_place;
    step->procedure = r->procedure;
    step->period = f->is_dynamic ? time : time * (1 + 1e-9); /* steps of 0.1 are not quite 1 together */
    r->step = 1;
    r->nonlinear = 1;
    r->times[0] = f->is_dynamic ? f->step_size : step->period / (f->steps_before + f->steps);
    r->times[1] = time;
    r->time_count = 2;
    r->direct = 1;
    r->alpha = "0";
    r->tolerance = f->rtol > 0 && f->rtol < 1 ? sqrt(f->rtol) : 0;
    if (f->is_dynamic && (f->rhoi >= -1 || f->newmark[0] != 1 || f->newmark[1] != 0.25 || f->newmark[2] != 0.5))
        inp_complain(r, f->control_place,
                     "a dynamic analysis is read with rhoi -2, alpha 1, beta 0.25 and gamma 0.5 "
                     "(Newmark's scheme)");
}

/* What must be there before there is a body. */
static inline void feb_check(feb_reader *f)
{
    inp_reader *r = &f->model;
    if (!f->has_control)
        inp_complain(r, r->here, "there is no Control");
    if (r->elements.count == 0)
        inp_complain(r, r->here, "there are no Elements");
    for (int i = 0; i < f->parts.count; i++) {
        const feb_part *part = (const feb_part *)f->parts.items + i;
        if (!part->has_domain)
            inp_complain(r, part->place, "Elements %.60s have no SolidDomain, which gives them their material",
                         part->name);
    }
    for (int i = 0; i < r->terms.count; i++)
        if (inp_terms(r)[i].starts && (i + 1 == r->terms.count || inp_terms(r)[i + 1].starts))
            inp_complain(r, inp_terms(r)[i].place, "a linear constraint without <child_dof>");
    if (f->step_count > 1 && (f->is_dynamic || f->was_dynamic))
        inp_complain(r, f->control_place, "several steps are read when all of them are STATIC");
    else if (f->step_count > 1)
        inp_note(r, f->control_place, "the %d static steps are solved as one, to the loads and supports at the end",
                 f->step_count);
    if (f->step_count > 1 && f->smooth.path)
        inp_complain(r, f->smooth,
                     "a load_controller is read with interpolate LINEAR only where there are several steps");
    else if (f->is_dynamic && f->smooth.path)
        inp_complain(r, f->smooth, "a load_controller in a dynamic analysis is read with interpolate LINEAR only");
    if (f->is_uncoupled && f->is_mixed && r->element && r->element->type == SB_HEX8)
        inp_note(
            r, r->element_place,
            "hex8 of uncoupled material are plain ones here: FEBio's default is a mixed element (three-field-solid)");
}

static inline void feb_build(feb_reader *f)
{
    inp_reader *r = &f->model;
    feb_check(f);
    feb_set_step(f);
    for (int i = 0; i < f->uses.count; i++)
        feb_use_data(f, (const feb_use *)f->uses.items + i);
    feb_sort_elements(f);
    if (r->no_memory || r->c->faults.count > 0 || !inp_make_maps(r) || !inp_make_mesh(r) || r->c->faults.count > 0)
        return;
    inp_resolve_sets(r);
    if (!inp_make_tables(r))
        return;
    inp_apply_entries(r);
    feb_set_offsets(f);
    feb_find_elements(f);
    feb_press(f);
    if (!r->no_memory && r->c->faults.count == 0)
        inp_add_statements(r);
    for (int i = 0; i < f->tractions.count && !r->no_memory && r->c->faults.count < INP_MAX_FAULTS; i++)
        feb_add_traction(f, (const feb_traction *)f->tractions.items + i);
}

/* ---- the reader -------------------------------------------------------------------------------------------- */

static inline void feb_free(feb_reader *f)
{
    for (int i = 0; i < f->data.count; i++)
        free(((feb_data *)f->data.items)[i].values.items);
    free(f->data.items);
    free(f->facets.items);
    free(f->uses.items);
    free(f->pressures.items);
    free(f->tractions.items);
    free(f->parts.items);
    free(f->offsets.items);
}

/* Reads a file of FEBio, as case_read does a case. What is wrong is listed in c->faults. */
static inline int feb_read(case_file *c, const char *path)
{
    feb_reader f;
    if (!case_start(c, path))
        return 0;
    memset(&f, 0, sizeof f);
    inp_start(&f.model, c);
    f.xml = xml_open(c->text);
    f.steps = 1;
    f.step_size = 1;
    f.rhoi = -2;
    f.newmark[0] = 1;
    f.newmark[1] = 0.25;
    f.newmark[2] = 0.5;
    feb_parse(&f);
    if (c->faults.count == 0 && !f.model.no_memory)
        feb_build(&f);
    feb_free(&f);
    return inp_finish(&f.model);
}

#endif /* CASE_FEB_H */
