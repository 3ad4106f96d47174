/* case_inp_write: writes a case in memory as an input file of CalculiX (and Abaqus), in units of 1e-4 N and 1e-4 kg
 * where it is not linear, see foreign_units. inp_read makes the same body of it: dead loads become nodal forces,
 * supports, pressures, ties and springs stay what they are. What cannot be said is refused, with its line. Include
 * case_inp.h first.
 */
#ifndef CASE_INP_WRITE_H
#define CASE_INP_WRITE_H

#include "case_inp.h"

typedef struct inp_writer {
    case_file *c;
    FILE *file;
    int shift;     /* decimal exponent of a newton in the file's unit of force */
    int nonlinear; /* NLGEOM */
    int springs;   /* written so far */
    int as_svk;    /* corotated material is written as St.Venant-Kirchhoff's */
} inp_writer;

/* ---- numbers ----------------------------------------------------------------------------------------------- */

static inline void inp_print(inp_writer *w, const char *before, double value, int shift, foreign_quantity quantity)
{
    char text[48];
    fprintf(w->file, "%s%s", before, foreign_print_number(text, value, shift, quantity));
}

/* A number > 0 with a decimal point: CalculiX takes a first line of *SPRING without one for axes. */
static inline void inp_print_stiffness(inp_writer *w, double value)
{
    char text[50];
    size_t length;
    foreign_print_number(text, value, w->shift, FOREIGN_CONSTANT);
    length = strcspn(text, "e+-");
    if (text[length] && strlen(text) > 19) { /* its exponent would be beyond 20 characters */
        snprintf(text, sizeof text, "%.14e", value);
        foreign_print_number(text, strtod(text, NULL), w->shift, FOREIGN_CONSTANT);
        length = strcspn(text, "e+-");
    }
    if (!strchr(text, '.')) {
        memmove(text + length + 1, text + length, strlen(text + length) + 1);
        text[length] = '.';
    }
    fprintf(w->file, "%s\n", text);
}

/* Numbers from 1, 16 a line. */
typedef struct inp_row {
    FILE *file;
    int count;
} inp_row;

static inline void inp_put(inp_row *row, int label)
{
    fprintf(row->file, "%s%d", row->count == 0 ? "" : row->count % 16 ? "," : "\n", label);
    row->count++;
}

/* ---- what can be said -------------------------------------------------------------------------------------- */

static inline int inp_is_written_as_svk(const inp_writer *w, const case_statement *s)
{
    return s->form->code == SB_SVK ||
           (w->as_svk && (s->form->code == SB_COROTATED || s->form->code == SB_COROTATED_INVERTIBLE));
}

/* The kind of *HYPERELASTIC that has the material's options; NULL: none. */
static inline const foreign_law *inp_law_of(const case_statement *s)
{
    for (int i = 0; i < FOREIGN_LAW_COUNT; i++) {
        const foreign_law *law = foreign_laws + i;
        case_bits keys = CASE_BIT(CASE_D1) | CASE_BIT(CASE_DENSITY);
        for (int k = 0; k < law->constants; k++)
            keys |= CASE_BIT(law->keys[k]);
        if (strcmp(law->model, s->form->variant) == 0 && (s->given & ~CASE_IN_REGION) == keys)
            return law;
    }
    return NULL;
}

static inline int inp_can_say_material(inp_writer *w, const case_statement *s)
{
    int is_linear = s->form->code == SB_LINEAR;
    if (s->prony_g)
        return case_fail(w->c, s->line, "relaxation (g1= tau1=) cannot be said: CalculiX has none for these materials");
    if (!is_linear && !inp_is_written_as_svk(w, s) && !inp_law_of(s))
        return case_fail(w->c, s->line, "material %s%s cannot be said in an input file%s", s->form->variant,
                         s->given & CASE_BIT(CASE_E) ? " with E and nu" : "",
                         s->form->code == SB_COROTATED || s->form->code == SB_COROTATED_INVERTIBLE
                             ? "; --as-svk writes St.Venant-Kirchhoff's in its place"
                             : "");
    if (is_linear == w->nonlinear)
        return case_fail(w->c, s->line, "linear and other materials in one case: the step has NLGEOM or not");
    if (s->number[CASE_REGION] < 0)
        return case_fail(w->c, s->line, "region %g cannot be said: it must be >= 0", s->number[CASE_REGION]);
    return 1;
}

static inline int inp_can_say_solve(inp_writer *w, const case_statement *s)
{
    int code = s->form->code;
    if (code != CASE_STATIC && code != CASE_MODES && code != SB_NEWMARK)
        return case_fail(w->c, s->line, "solve %s cannot be said, only static, newmark and modes", s->form->variant);
    if (s->number[CASE_ALPHA] != 0 || s->number[CASE_BETA] != 0)
        return case_fail(w->c, s->line, "damping (alpha=, beta=) cannot be said");
    return 1;
}

static inline int inp_can_say(inp_writer *w, const case_statement *s)
{
    const char *what = s->form->variant ? s->form->variant : "";
    switch (s->form->kind) {
    case CASE_MATERIAL: return inp_can_say_material(w, s);
    case CASE_SOLVE: return inp_can_say_solve(w, s);
    case CASE_ELEMENT:
        return (s->treatment->integration == SB_INTEGRATION_AUTO && !s->treatment->single_rotation) ||
               case_fail(w->c, s->line, "element %s cannot be said: CalculiX has none that is the same",
                         s->treatment->name);
    case CASE_PRESSURE:
        return w->nonlinear || case_fail(w->c, s->line,
                                         "a pressure that follows the faces of linear material cannot be "
                                         "said");
    case CASE_EQUATION:
        for (int i = 0; i < s->count; i++)
            if (s->values[i] != 0)
                return case_fail(w->c, s->line, "an equation with the value %g cannot be said, only with 0",
                                 (double)s->values[i]);
        return 1;
    case CASE_CUT:
        return case_fail(w->c, s->line, "%s%s%s cannot be said in an input file", s->form->keyword, *what ? " " : "",
                         what);
    default: return 1;
    }
}

/* ---- the model --------------------------------------------------------------------------------------------- */

static inline void inp_write_nodes(inp_writer *w)
{
    const sb_mesh *mesh = &w->c->mesh;
    fprintf(w->file, "*NODE,NSET=NALL\n");
    for (int i = 0; i < mesh->node_count; i++) {
        fprintf(w->file, "%d", i + 1);
        inp_print(w, ",", (double)mesh->nodes[i].x, 0, FOREIGN_PLACE);
        inp_print(w, ",", (double)mesh->nodes[i].y, 0, FOREIGN_PLACE);
        inp_print(w, ",", (double)mesh->nodes[i].z, 0, FOREIGN_PLACE);
        fprintf(w->file, "\n");
    }
}

static inline void inp_write_elements(inp_writer *w)
{
    const sb_mesh *mesh = &w->c->mesh;
    int width = sb_mesh_element_width(mesh);
    fprintf(w->file, "*ELEMENT,TYPE=%s,ELSET=EALL\n", foreign_element_of(mesh->element_type)->inp);
    for (int e = 0; e < mesh->element_count; e++) {
        fprintf(w->file, "%d", e + 1);
        for (int a = 0; a < width; a++) /* 16 entries a line, and a comma goes on */
            fprintf(w->file, a == 15 ? ",\n%d" : ",%d", mesh->elements[(size_t)e * (size_t)width + (size_t)a] + 1);
        fprintf(w->file, "\n");
    }
}

/* The law's constants; of the D after the first, which the law here has not, one that makes nothing of its term. */
static inline void inp_write_law(inp_writer *w, const case_statement *s)
{
    const foreign_law *law = inp_law_of(s);
    if (!law) {
        inp_print(w, "*ELASTIC\n", s->number[CASE_E], w->shift, FOREIGN_CONSTANT);
        inp_print(w, ",", s->number[CASE_NU], 0, FOREIGN_CONSTANT);
        fprintf(w->file, "\n");
        return;
    }
    fprintf(w->file, "*HYPERELASTIC,%s",
            strcmp(law->inp, "NEOHOOKE") == 0            ? "NEO HOOKE"
            : strcmp(law->inp, "REDUCEDPOLYNOMIAL") == 0 ? "REDUCED POLYNOMIAL"
                                                         : law->inp);
    fprintf(w->file, law->terms > 0 ? ",N=%d\n" : "\n", law->terms);
    for (int k = 0; k < law->constants; k++)
        inp_print(w, k ? "," : "", s->number[law->keys[k]], w->shift, FOREIGN_CONSTANT);
    inp_print(w, ",", s->number[CASE_D1], -w->shift, FOREIGN_CONSTANT);
    for (int k = 1; k < foreign_volume_terms(law); k++)
        fprintf(w->file, ",1e+30");
    fprintf(w->file, "\n");
}

static inline void inp_write_material(inp_writer *w, const case_statement *s)
{
    const sb_mesh *mesh = &w->c->mesh;
    int has_region = (s->given & CASE_IN_REGION) != 0, region = (int)s->number[CASE_REGION];
    inp_row row = {w->file, 0};
    if (has_region) {
        fprintf(w->file, "*ELSET,ELSET=REGION%d\n", region);
        for (int e = 0; e < mesh->element_count; e++)
            if ((mesh->regions ? mesh->regions[e] : 0) == region)
                inp_put(&row, e + 1);
        fprintf(w->file, "\n*MATERIAL,NAME=MATERIAL%d\n", region);
    } else {
        fprintf(w->file, "*MATERIAL,NAME=MATERIAL\n");
    }
    inp_write_law(w, s);
    inp_print(w, "*DENSITY\n", s->number[CASE_DENSITY], w->shift, FOREIGN_CONSTANT);
    if (has_region)
        fprintf(w->file, "\n*SOLID SECTION,ELSET=REGION%d,MATERIAL=MATERIAL%d\n", region, region);
    else
        fprintf(w->file, "\n*SOLID SECTION,ELSET=EALL,MATERIAL=MATERIAL\n");
}

static inline void inp_write_equations(inp_writer *w, const case_statement *s)
{
    const sb_constraint_term *term = s->terms;
    for (int i = 0; i < s->count; i++) {
        fprintf(w->file, "*EQUATION\n%d\n", s->term_counts[i]);
        for (int k = 0; k < s->term_counts[i]; k++, term++) { /* four terms a line */
            fprintf(w->file, "%s%d,%d", k == 0 ? "" : k % 4 ? "," : "\n", term->node + 1, term->axis + 1);
            inp_print(w, ",", (double)term->coefficient, 0, FOREIGN_CONSTANT);
        }
        fprintf(w->file, "\n");
    }
}

/* "ELEMENT,P1" of face i of a statement, with its letter. */
static inline int inp_put_face(inp_writer *w, const case_statement *s, int i, char letter)
{
    int corners = case_face_corners(w->c), element, face;
    sb_error error;
    if (!w->c->node_elements.offsets && sb_mesh_node_elements(&w->c->mesh, NULL, &w->c->node_elements, &error) != SB_OK)
        return case_fail_library(w->c, s->line, &error);
    if (!case_find_face(w->c, s->faces + (size_t)i * (size_t)corners, corners, &element, &face))
        return case_fail(w->c, s->line, "face %d is no face of an element", i);
    fprintf(w->file, "%d,%c%d", element + 1, letter, foreign_face_of(w->c->mesh.element_type, face) + 1);
    return 1;
}

/* A surface of nodes on one of faces. */
static inline int inp_write_tie(inp_writer *w, const case_statement *s)
{
    int ok = 1;
    fprintf(w->file, "*SURFACE,NAME=SLAVE%d,TYPE=NODE\n", s->line);
    for (int i = 0; i < s->tied_count; i++)
        fprintf(w->file, "%d\n", s->nodes[i] + 1);
    fprintf(w->file, "*SURFACE,NAME=MASTER%d\n", s->line);
    for (int i = 0; i < s->count && ok; i++) {
        ok = inp_put_face(w, s, i, 'S');
        fprintf(w->file, "\n");
    }
    fprintf(w->file, "*TIE,NAME=TIE%d,ADJUST=NO", s->line);
    if (s->given & CASE_BIT(CASE_DISTANCE))
        inp_print(w, ",POSITION TOLERANCE=", s->number[CASE_DISTANCE], 0, FOREIGN_CONSTANT);
    fprintf(w->file, "\nSLAVE%d,MASTER%d\n", s->line, s->line);
    return ok;
}

/* Springs as inp_add_springs reads them: from each node to one of its own, which is held at the point. */
static inline void inp_write_springs(inp_writer *w, const case_statement *s)
{
    const sb_mesh *mesh = &w->c->mesh;
    int point = mesh->node_count + 1 + w->springs, element = mesh->element_count + 1 + 3 * w->springs, end;
    fprintf(w->file, "*NODE,NSET=POINTS%d\n", s->line);
    for (int i = 0; i < s->count; i++) {
        fprintf(w->file, "%d", point + i);
        for (int axis = 0; axis < 3; axis++)
            inp_print(w, ",", (double)case_component(s->vectors[i], axis), 0, FOREIGN_PLACE);
        fprintf(w->file, "\n");
    }
    for (int first = 0; first < s->count; first = end) { /* those in a row that are as stiff */
        for (end = first; end < s->count && s->stiffness[end] == s->stiffness[first]; end++)
            ;
        for (int axis = 0; axis < 3; axis++) {
            fprintf(w->file, "*ELEMENT,TYPE=SPRING2,ELSET=SPRING%d_%d%c\n", s->line, first + 1, "XYZ"[axis]);
            for (int i = first; i < end; i++)
                fprintf(w->file, "%d,%d,%d\n", element++, s->nodes[i] + 1, point + i);
            fprintf(w->file, "*SPRING,ELSET=SPRING%d_%d%c\n%d,%d\n", s->line, first + 1, "XYZ"[axis], axis + 1,
                    axis + 1);
            inp_print_stiffness(w, (double)s->stiffness[first]);
        }
    }
    w->springs += s->count;
    fprintf(w->file, "*BOUNDARY\nPOINTS%d,1,3\n", s->line);
}

/* What draws the nodes to the points: CalculiX does not draw by a displaced end, in linear steps never, in dynamic ones
 * from the end of the first increment only. */
static inline void inp_write_pulls(inp_writer *w, const case_statement *s)
{
    fprintf(w->file, "*CLOAD\n");
    for (int i = 0; i < s->count; i++)
        for (int axis = 0; axis < 3; axis++) {
            double from = (double)case_component(w->c->mesh.nodes[s->nodes[i]], axis);
            double force = (double)s->stiffness[i] * ((double)case_component(s->vectors[i], axis) - from);
            fprintf(w->file, "%d,%d", s->nodes[i] + 1, axis + 1);
            inp_print(w, ",", force, w->shift, FOREIGN_PLACE);
            fprintf(w->file, "\n");
        }
}

/* Axes of nodes, of `fix`, or of `prescribe` with their displacements. */
static inline void inp_write_supports(inp_writer *w, const case_statement *s)
{
    for (int i = 0; i < s->count; i++)
        for (int axis = 0; axis < 3; axis++) {
            if (!(s->axes >> axis & 1))
                continue;
            fprintf(w->file, "%d,%d,%d", s->nodes[i] + 1, axis + 1, axis + 1);
            if (s->form->kind == CASE_PRESCRIBE)
                inp_print(w, ",", (double)case_component(s->vectors[i], axis), 0, FOREIGN_PLACE);
            fprintf(w->file, "\n");
        }
}

/* What stands before the step. */
static inline int inp_write_model(inp_writer *w)
{
    const case_file *c = w->c;
    int ok = 1;
    inp_write_nodes(w);
    inp_write_elements(w);
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind == CASE_MATERIAL)
            inp_write_material(w, s);
        if (s->form->kind == CASE_EQUATION)
            inp_write_equations(w, s);
        if (s->form->kind == CASE_TIE && ok)
            ok = inp_write_tie(w, s);
        if (s->form->kind == CASE_SPRING)
            inp_write_springs(w, s);
        if (s->form->kind == CASE_FIX)
            fprintf(w->file, "*BOUNDARY\n");
        if (s->form->kind == CASE_FIX)
            inp_write_supports(w, s);
        if (s->form->kind == CASE_PRESCRIBE && s->number[CASE_RAMP] > 0) {
            fprintf(w->file, "*AMPLITUDE,NAME=RAMP%d\n0,0", s->line);
            inp_print(w, ",", s->number[CASE_RAMP], 0, FOREIGN_CONSTANT);
            fprintf(w->file, ",1\n");
        }
        if (s->form->kind == CASE_OUTPUT && s->form->code == CASE_OUTPUT_PROBE)
            fprintf(w->file, "*NSET,NSET=PROBE%d\n%d\n", s->node, s->node + 1);
    }
    return ok;
}

/* ---- the step ---------------------------------------------------------------------------------------------- */

static inline void inp_write_solve(inp_writer *w, const case_statement *s)
{
    fprintf(w->file, "*STEP%s,INC=1000000\n", w->nonlinear ? ",NLGEOM" : "");
    if (s->given & CASE_BIT(CASE_TOL)) {
        inp_print(w, "*CONTROLS,PARAMETERS=FIELD\n", s->number[CASE_TOL], 0, FOREIGN_CONSTANT);
        inp_print(w, ",", s->number[CASE_TOL], 0, FOREIGN_CONSTANT);
        fprintf(w->file, "\n");
    }
    if (s->form->code == CASE_MODES) {
        fprintf(w->file, "*FREQUENCY\n%d\n", (int)s->number[CASE_COUNT]);
    } else if (s->form->code == CASE_STATIC) {
        inp_print(w, "*STATIC\n", 1 / s->number[CASE_STEPS], 0, FOREIGN_CONSTANT);
        fprintf(w->file, ",1\n");
    } else {
        inp_print(w, "*DYNAMIC,ALPHA=0.,DIRECT\n", s->number[CASE_DT], 0, FOREIGN_CONSTANT);
        inp_print(w, ",", s->number[CASE_END], 0, FOREIGN_CONSTANT);
        fprintf(w->file, "\n");
    }
}

/* Dead loads as nodal forces. */
static inline int inp_write_forces(inp_writer *w)
{
    int nodes = w->c->mesh.node_count, any = 0, ok;
    sb_vec3 *forces;
    for (int i = 0; i < w->c->statement_count; i++)
        any |= (CASE_DEAD_LOADS & CASE_KIND(w->c->statements[i].form->kind)) != 0;
    if (!any)
        return 1;
    forces = (sb_vec3 *)calloc((size_t)nodes, sizeof *forces);
    ok = forces ? case_nodal_loads(w->c, CASE_DEAD_LOADS, forces) : case_fail_memory(w->c, 0);
    if (ok)
        fprintf(w->file, "*CLOAD\n");
    for (int i = 0; i < nodes && ok; i++)
        for (int axis = 0; axis < 3; axis++) {
            double force = (double)case_component(forces[i], axis);
            if (force == 0)
                continue;
            fprintf(w->file, "%d,%d", i + 1, axis + 1);
            inp_print(w, ",", force, w->shift, FOREIGN_PLACE);
            fprintf(w->file, "\n");
        }
    free(forces);
    return ok;
}

static inline int inp_write_pressures(inp_writer *w, const case_statement *s)
{
    fprintf(w->file, "*DLOAD\n");
    for (int i = 0; i < s->count; i++) {
        if (!inp_put_face(w, s, i, 'P'))
            return 0;
        inp_print(w, ",", s->number[CASE_PRESSURE_VALUE], w->shift, FOREIGN_PLACE);
        fprintf(w->file, "\n");
    }
    return 1;
}

/* One line for each axis: no direction has to be made and normalised. */
static inline void inp_write_gravity(inp_writer *w, const case_statement *s)
{
    fprintf(w->file, "*DLOAD\n");
    for (int axis = 0; axis < 3; axis++) {
        const char *minus = s->numbers[axis] < 0 ? "-" : "";
        if (s->numbers[axis] == 0)
            continue;
        inp_print(w, "EALL,GRAV,", fabs(s->numbers[axis]), 0, FOREIGN_CONSTANT);
        fprintf(w->file, ",%s%d,%s%d,%s%d\n", axis == 0 ? minus : "", axis == 0, axis == 1 ? minus : "", axis == 1,
                axis == 2 ? minus : "", axis == 2);
    }
}

static inline void inp_write_output(inp_writer *w, const case_statement *s)
{
    switch (s->form->code) {
    case CASE_OUTPUT_REACTION: fprintf(w->file, "*NODE PRINT,NSET=NALL,FREQUENCY=1000000\nRF\n"); break;
    case CASE_OUTPUT_STRESS: fprintf(w->file, "*EL PRINT,ELSET=EALL,FREQUENCY=1000000\nS\n"); break;
    case CASE_OUTPUT_PROBE: fprintf(w->file, "*NODE PRINT,NSET=PROBE%d\nU\n", s->node); break;
    default: break; /* displacements and frequencies are written in any case */
    }
}

static inline int inp_write_step(inp_writer *w)
{
    const case_file *c = w->c;
    int ok = 1;
    inp_write_solve(w, c->solve);
    for (int i = 0; i < c->statement_count && ok; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind == CASE_PRESCRIBE) {
            fprintf(w->file, s->number[CASE_RAMP] > 0 ? "*BOUNDARY,AMPLITUDE=RAMP%d\n" : "*BOUNDARY\n", s->line);
            inp_write_supports(w, s);
        }
        if (s->form->kind == CASE_SPRING)
            inp_write_pulls(w, s);
        if (s->form->kind == CASE_PRESSURE)
            ok = inp_write_pressures(w, s);
        if (s->form->kind == CASE_GRAVITY)
            inp_write_gravity(w, s);
    }
    ok = ok && inp_write_forces(w);
    if (c->solve->form->code != CASE_MODES)
        fprintf(w->file, "*NODE PRINT,NSET=NALL,FREQUENCY=1000000\nU\n");
    for (int i = 0; i < c->statement_count && ok; i++)
        if (c->statements[i].form->kind == CASE_OUTPUT)
            inp_write_output(w, c->statements + i);
    fprintf(w->file, "*END STEP\n");
    return ok;
}

/* Writes the case at `path`. as_svk: 1 writes corotated material as St.Venant-Kirchhoff's, another law with the same
 * constants. Returns 1, or 0 with error_line and message: then the file is what it was before. */
static inline int inp_write(case_file *c, const char *path, int as_svk)
{
    inp_writer w = {c, NULL, 0, 0, 0, as_svk};
    sb_output out;
    sb_error error;
    int ok = 1;
    if (!foreign_element_of(c->mesh.element_type) || !foreign_element_of(c->mesh.element_type)->inp)
        return case_fail(c, c->mesh_statement->line, "elements of type %s cannot be said in an input file",
                         sb_element_name(c->mesh.element_type));
    for (int i = 0; i < c->statement_count; i++)
        w.nonlinear |= c->statements[i].form->kind == CASE_MATERIAL && c->statements[i].form->code != SB_LINEAR;
    w.shift = w.nonlinear ? FOREIGN_UNIT : 0;
    for (int i = 0; i < c->statement_count && ok; i++)
        ok = inp_can_say(&w, c->statements + i);
    if (!ok)
        return 0;
    foreign_note_left_out(c);
    if (sb_output_open(&out, path, &error) != SB_OK)
        return case_fail_library(c, 0, &error);
    w.file = out.file;
    if (w.nonlinear)
        fprintf(w.file, "** %s, stress 1e-4 Pa (CalculiX drops residual forces below 1e-6 units)\n", foreign_units);
    if (!inp_write_model(&w) || !inp_write_step(&w)) {
        sb_output_discard(&out);
        return 0;
    }
    return sb_output_close(&out, &error) == SB_OK || case_fail_library(c, 0, &error);
}

#endif /* CASE_INP_WRITE_H */
