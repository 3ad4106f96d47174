/* case_feb_write: writes a case in memory as an input file of FEBio, format 4.0, in SI units. Laws, supports and
 * pressures mean the same there, to the rounding of a bulk modulus, and so do tractions; forces become nodal ones, and
 * tractions beside them, too. feb_read makes the same body of it. What cannot be said is refused, with its line.
 * Include case_foreign.h first. */
#ifndef CASE_FEB_WRITE_H
#define CASE_FEB_WRITE_H

#include "case_foreign.h"

typedef struct feb_writer {
    case_file *c;
    FILE *file;
    int as_svk;      /* linear and corotated material is written as St.Venant-Kirchhoff's */
    int controllers; /* courses in time so far; a static solve has one, the rise of its loads */
    int in_section;  /* the section of supports, loads and so on has begun: an empty one is left out */
    sb_vec3 *forces; /* [nodes] dead loads (N); NULL: none */
    int has_forces;  /* 1: the case has some: then tractions are forces of nodes, too, in the order of the case */
} feb_writer;

/* ---- what can be said -------------------------------------------------------------------------------------- */

static inline int feb_is_written_as_svk(const feb_writer *w, const case_statement *s)
{
    return w->as_svk &&
           (s->form->code == SB_LINEAR || s->form->code == SB_COROTATED || s->form->code == SB_COROTATED_INVERTIBLE);
}

/* The law of FEBio that has the material's options; NULL: none. */
static inline const foreign_feb_law *feb_law_of(const feb_writer *w, const case_statement *s)
{
    const char *model = feb_is_written_as_svk(w, s) ? "svk" : s->form->variant;
    for (int i = 0; i < FOREIGN_FEB_LAW_COUNT; i++) {
        const foreign_feb_law *law = foreign_feb_laws + i;
        case_bits keys = CASE_BIT(CASE_DENSITY) | (law->is_uncoupled ? CASE_BIT(CASE_D1) : 0);
        for (int k = 0; k < law->constants; k++)
            keys |= CASE_BIT(law->constant[k].key);
        if (strcmp(law->model, model) == 0 && (s->given & ~CASE_IN_REGION) == keys)
            return law;
    }
    return NULL;
}

static inline int feb_can_say_material(feb_writer *w, const case_statement *s)
{
    int code = s->form->code, hooke = code == SB_LINEAR || code == SB_COROTATED || code == SB_COROTATED_INVERTIBLE;
    const foreign_feb_law *law = feb_law_of(w, s);
    if (s->prony_g)
        return case_fail(w->c, s->line, "relaxation (g1= tau1=) cannot be said: FEBio counts its moduli otherwise");
    if (!law)
        return case_fail(w->c, s->line, "material %s cannot be said: FEBio has no such law%s", s->form->variant,
                         hooke ? "; --as-svk writes St.Venant-Kirchhoff's in its place" : "");
    if (law->is_uncoupled && !(s->number[CASE_C10] > 0))
        return case_fail(w->c, s->line, "C10=%g cannot be said: FEBio's c1 must be > 0", s->number[CASE_C10]);
    if (law->is_uncoupled && !(2 / s->number[CASE_D1] <= 1e300))
        return case_fail(w->c, s->line, "D1=%g cannot be said: FEBio's k is 2/D1", s->number[CASE_D1]);
    if (s->number[CASE_REGION] < 0)
        return case_fail(w->c, s->line, "region %g cannot be said: it must be >= 0", s->number[CASE_REGION]);
    return 1;
}

static inline int feb_can_say_solve(feb_writer *w, const case_statement *s)
{
    double dt = s->number[CASE_DT], end = s->number[CASE_END];
    if (s->form->code != CASE_STATIC && s->form->code != SB_NEWMARK)
        return case_fail(w->c, s->line, "solve %s cannot be said, only static and newmark", s->form->variant);
    if (s->number[CASE_ALPHA] != 0 || s->number[CASE_BETA] != 0)
        return case_fail(w->c, s->line, "damping (alpha=, beta=) cannot be said");
    if (s->form->code == SB_NEWMARK && !(fabs(case_step_count(w->c, dt) * dt - end) <= 1e-9 * end))
        return case_fail(w->c, s->line, "end= is no whole number of steps of dt=, which FEBio needs");
    return 1;
}

/* Supports that are somewhere else at once: FEBio moves them over its first step. */
static inline int feb_can_say_prescribe(feb_writer *w, const case_statement *s)
{
    if (!case_is_dynamic(w->c) || s->number[CASE_RAMP] > 0)
        return 1;
    for (int i = 0; i < s->count; i++)
        for (int axis = 0; axis < 3; axis++)
            if (s->axes >> axis & 1 && case_component(s->vectors[i], axis) != 0)
                return case_fail(w->c, s->line,
                                 "a displacement without ramp= cannot be said: it is there at once here, "
                                 "and within the first step in FEBio");
    return 1;
}

static inline int feb_can_say_equation(feb_writer *w, const case_statement *s)
{
    for (int i = 0; i < s->count; i++)
        if (s->values[i] != 0 && case_is_dynamic(w->c))
            return case_fail(w->c, s->line,
                             "an equation with the value %g cannot be said in a dynamic solve, only "
                             "with 0",
                             (double)s->values[i]);
    return 1;
}

static inline int feb_can_say(feb_writer *w, const case_statement *s)
{
    const char *what = s->form->variant ? s->form->variant : "";
    switch (s->form->kind) {
    case CASE_MATERIAL: return feb_can_say_material(w, s);
    case CASE_SOLVE: return feb_can_say_solve(w, s);
    case CASE_PRESCRIBE: return feb_can_say_prescribe(w, s);
    case CASE_EQUATION: return feb_can_say_equation(w, s);
    case CASE_ELEMENT:
        return (s->treatment->integration == SB_INTEGRATION_AUTO && !s->treatment->single_rotation) ||
               case_fail(w->c, s->line, "element %s cannot be said: FEBio has none that is the same",
                         s->treatment->name);
    case CASE_SPRING: return case_fail(w->c, s->line, "spring cannot be said: those of FEBio have a length at rest");
    case CASE_TIE:
    case CASE_CUT:
        return case_fail(w->c, s->line, "%s%s%s cannot be said in a file of FEBio", s->form->keyword, *what ? " " : "",
                         what);
    default: return 1;
    }
}

/* ---- words ------------------------------------------------------------------------------------------------- */

static inline void feb_number(feb_writer *w, const char *before, double value, const char *after)
{
    char text[32];
    fprintf(w->file, "%s%s%s", before, foreign_print_shortest(text, value), after);
}

static inline void feb_vector(feb_writer *w, sb_vec3 v)
{
    feb_number(w, "", (double)v.x, ",");
    feb_number(w, "", (double)v.y, ",");
    feb_number(w, "", (double)v.z, "");
}

/* Begins the section where it has not begun, and ends it where it has. */
static inline void feb_in_section(feb_writer *w, const char *name)
{
    if (!w->in_section)
        fprintf(w->file, "\t<%s>\n", name);
    w->in_section = 1;
}

static inline void feb_end_section(feb_writer *w, const char *name)
{
    if (w->in_section)
        fprintf(w->file, "\t</%s>\n", name);
    w->in_section = 0;
}

/* The number of a statement, from 1, which makes the names of its sets. */
static inline int feb_index(const feb_writer *w, const case_statement *s) { return (int)(s - w->c->statements) + 1; }

/* The attribute of a value that rises over the step: with loads of a static solve, or with a ramp. */
static inline void feb_course(feb_writer *w, int controller)
{
    if (controller > 0)
        fprintf(w->file, " lc=\"%d\"", controller);
}

static inline void feb_write_node_set(feb_writer *w, const char *name, int number, const int *nodes, int count)
{
    fprintf(w->file, "\t\t<NodeSet name=\"%s%d\">\n\t\t\t", name, number);
    for (int i = 0; i < count; i++)
        fprintf(w->file, "%d%s", nodes[i] + 1, i + 1 == count ? "" : i % 16 == 15 ? ",\n\t\t\t" : ",");
    fprintf(w->file, "\n\t\t</NodeSet>\n");
}

/* ---- the model --------------------------------------------------------------------------------------------- */

static inline void feb_write_control(feb_writer *w, const case_statement *s)
{
    int is_static = s->form->code == CASE_STATIC;
    int steps = is_static ? (int)s->number[CASE_STEPS] : case_step_count(w->c, s->number[CASE_DT]);
    double step = is_static ? 1 / s->number[CASE_STEPS] : s->number[CASE_DT];
    fprintf(w->file, "\t<Control>\n\t\t<analysis>%s</analysis>\n", is_static ? "STATIC" : "DYNAMIC");
    fprintf(w->file, "\t\t<time_steps>%d</time_steps>\n", steps);
    feb_number(w, "\t\t<step_size>", step, "</step_size>\n");
    if (is_static) /* load steps shrink where they do not converge; steps in time stay what they are */
        feb_number(w, "\t\t<time_stepper type=\"default\">\n\t\t\t<max_retries>10</max_retries>\n\t\t\t<dtmax>", step,
                   "</dtmax>\n\t\t</time_stepper>\n");
    fprintf(w->file, "\t\t<solver type=\"solid\">\n");
    if (s->given & CASE_BIT(CASE_TOL)) /* FEBio compares squares of forces */
        feb_number(w, "\t\t\t<rtol>", s->number[CASE_TOL] * s->number[CASE_TOL], "</rtol>\n");
    if (!is_static)
        fprintf(w->file, "\t\t\t<rhoi>-2</rhoi>\n\t\t\t<alpha>1</alpha>\n\t\t\t<beta>0.25</beta>\n"
                         "\t\t\t<gamma>0.5</gamma>\n");
    fprintf(w->file, "\t\t</solver>\n\t</Control>\n");
}

/* The name of a material and of the part that has it. */
static inline void feb_name_part(const case_statement *s, const char *name, char text[32])
{
    if (s->given & CASE_IN_REGION)
        snprintf(text, 32, "%s%d", name, (int)s->number[CASE_REGION]);
    else
        snprintf(text, 32, "%s", name);
}

static inline void feb_write_material(feb_writer *w, const case_statement *s, int id)
{
    const foreign_feb_law *law = feb_law_of(w, s);
    char name[32];
    feb_name_part(s, "Material", name);
    fprintf(w->file, "\t\t<material id=\"%d\" name=\"%s\" type=\"%s\">\n", id, name, law->feb);
    feb_number(w, "\t\t\t<density>", s->number[CASE_DENSITY], "</density>\n");
    for (int k = 0; k < law->constants; k++) {
        fprintf(w->file, "\t\t\t<%s>", law->constant[k].name);
        feb_number(w, "", s->number[law->constant[k].key], "");
        fprintf(w->file, "</%s>\n", law->constant[k].name);
    }
    if (law->is_uncoupled)
        for (int k = law->constants; k < (*law->feb == 'Y' ? (int)FOREIGN_FEB_YEOH : 2); k++)
            fprintf(w->file, "\t\t\t<c%d>0</c%d>\n", k + 1, k + 1);
    if (law->is_uncoupled) {
        feb_number(w, "\t\t\t<k>", foreign_other_modulus(s->number[CASE_D1]), "</k>\n");
        fprintf(w->file, "\t\t\t<pressure_model>%s</pressure_model>\n", foreign_feb_pressure);
    }
    fprintf(w->file, "\t\t</material>\n");
}

static inline void feb_write_nodes(feb_writer *w)
{
    const sb_mesh *mesh = &w->c->mesh;
    fprintf(w->file, "\t\t<Nodes name=\"Nodes\">\n");
    for (int i = 0; i < mesh->node_count; i++) {
        fprintf(w->file, "\t\t\t<node id=\"%d\">", i + 1);
        feb_vector(w, mesh->nodes[i]);
        fprintf(w->file, "</node>\n");
    }
    fprintf(w->file, "\t\t</Nodes>\n");
}

/* The elements of a material, with their numbers in the mesh. */
static inline void feb_write_elements(feb_writer *w, const case_statement *s)
{
    const sb_mesh *mesh = &w->c->mesh;
    int width = sb_mesh_element_width(mesh), has_region = (s->given & CASE_IN_REGION) != 0;
    char name[32];
    feb_name_part(s, "Part", name);
    fprintf(w->file, "\t\t<Elements type=\"%s\" name=\"%s\">\n", foreign_element_of(mesh->element_type)->feb, name);
    for (int e = 0; e < mesh->element_count; e++) {
        if (has_region && (mesh->regions ? mesh->regions[e] : 0) != (int)s->number[CASE_REGION])
            continue;
        fprintf(w->file, "\t\t\t<elem id=\"%d\">", e + 1);
        for (int a = 0; a < width; a++)
            fprintf(w->file, "%s%d", a ? "," : "",
                    mesh->elements[(size_t)e * (size_t)width + (size_t)foreign_feb_place(mesh->element_type, a)] + 1);
        fprintf(w->file, "</elem>\n");
    }
    fprintf(w->file, "\t\t</Elements>\n");
}

/* Faces with all their nodes, counter-clockwise from outside, so that a pressure > 0 pushes inwards. */
static inline int feb_write_surface(feb_writer *w, const case_statement *s, const char *what)
{
    const sb_mesh *mesh = &w->c->mesh;
    int corners = case_face_corners(w->c), element, face;
    const char *name = foreign_element_of(mesh->element_type)->feb_face;
    sb_error error;
    if (!w->c->node_elements.offsets && sb_mesh_node_elements(mesh, NULL, &w->c->node_elements, &error) != SB_OK)
        return case_fail_library(w->c, s->line, &error);
    fprintf(w->file, "\t\t<Surface name=\"%s%d\">\n", what, feb_index(w, s));
    for (int i = 0; i < s->count; i++) {
        const int *cell;
        int local[SB_MAX_FACE_NODES], count;
        if (!case_find_face(w->c, s->faces + (size_t)i * (size_t)corners, corners, &element, &face))
            return case_fail(w->c, s->line, "face %d is no face of an element", i);
        cell = mesh->elements + (size_t)element * (size_t)sb_mesh_element_width(mesh);
        count = sb_element_face(mesh->element_type, face, local, NULL);
        fprintf(w->file, "\t\t\t<%s id=\"%d\">", name, i + 1);
        for (int k = 0; k < count; k++)
            fprintf(w->file, "%s%d", k ? "," : "", cell[local[k]] + 1);
        fprintf(w->file, "</%s>\n", name);
    }
    fprintf(w->file, "\t\t</Surface>\n");
    return 1;
}

/* Nodes with a dead load, as a set. */
static inline int feb_write_force_set(feb_writer *w)
{
    int *nodes = (int *)calloc((size_t)w->c->mesh.node_count, sizeof *nodes), count = 0;
    if (!nodes)
        return case_fail_memory(w->c, 0);
    for (int i = 0; i < w->c->mesh.node_count; i++)
        if (w->forces[i].x != 0 || w->forces[i].y != 0 || w->forces[i].z != 0)
            nodes[count++] = i;
    if (count > 0) {
        feb_write_node_set(w, "Force", 0, nodes, count);
    } else {
        free(w->forces);
        w->forces = NULL;
    }
    free(nodes);
    return 1;
}

static inline int feb_write_mesh(feb_writer *w)
{
    const case_file *c = w->c;
    int ok = 1;
    fprintf(w->file, "\t<Mesh>\n");
    feb_write_nodes(w);
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_MATERIAL)
            feb_write_elements(w, c->statements + i);
    for (int i = 0; i < c->statement_count && ok; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind == CASE_FIX)
            feb_write_node_set(w, "Fix", i + 1, s->nodes, s->count);
        if (s->form->kind == CASE_PRESCRIBE)
            feb_write_node_set(w, "Prescribe", i + 1, s->nodes, s->count);
        if (s->form->kind == CASE_PRESSURE)
            ok = feb_write_surface(w, s, "Pressure");
        if (s->form->kind == CASE_TRACTION && !w->has_forces)
            ok = feb_write_surface(w, s, "Traction");
        if (s->form->kind == CASE_OUTPUT && s->form->code == CASE_OUTPUT_PROBE)
            feb_write_node_set(w, "Probe", i + 1, &s->node, 1);
    }
    ok = ok && (!w->forces || feb_write_force_set(w));
    fprintf(w->file, "\t</Mesh>\n");
    return ok;
}

/* Whether a node between the corners of a tet10 is off the middle of its edge: then the integration here has 8 points.
 */
static inline int feb_is_curved(const sb_mesh *mesh)
{
    for (int e = 0; e < mesh->element_count; e++)
        for (int edge = 0; edge < 6; edge++) {
            const int *cell = mesh->elements + (size_t)e * 10;
            int ends[3];
            sb_vec3 a, b, middle;
            sb_element_edge(SB_TET10, edge, ends);
            a = mesh->nodes[cell[ends[0]]], b = mesh->nodes[cell[ends[1]]];
            middle = sb_v3_scale((sb_real)0.5, sb_v3_add(a, b));
            if (sb_v3_norm(sb_v3_sub(mesh->nodes[cell[ends[2]]], middle)) > (sb_real)1e-5 * sb_v3_norm(sb_v3_sub(b, a)))
                return 1;
        }
    return 0;
}

/* Plain elements with the points that they have here: FEBio's own choice for an uncoupled law is a mixed one. */
static inline void feb_write_domains(feb_writer *w)
{
    const sb_mesh *mesh = &w->c->mesh;
    fprintf(w->file, "\t<MeshDomains>\n");
    for (int i = 0; i < w->c->statement_count; i++) {
        const case_statement *s = w->c->statements + i;
        char part[32], material[32];
        if (s->form->kind != CASE_MATERIAL)
            continue;
        feb_name_part(s, "Part", part);
        feb_name_part(s, "Material", material);
        fprintf(w->file, "\t\t<SolidDomain name=\"%s\" mat=\"%s\" type=\"elastic-solid\"%s/>\n", part, material,
                mesh->element_type != SB_TET10 ? ""
                : feb_is_curved(mesh)          ? " elem_type=\"TET10G8\""
                                               : " elem_type=\"TET10G4\"");
    }
    fprintf(w->file, "\t</MeshDomains>\n");
}

/* ---- supports and loads ------------------------------------------------------------------------------------ */

/* Whether all nodes of a statement have the same displacement. */
static inline int feb_is_uniform(const case_statement *s)
{
    for (int i = 1; i < s->count; i++)
        if (s->vectors[i].x != s->vectors[0].x || s->vectors[i].y != s->vectors[0].y ||
            s->vectors[i].z != s->vectors[0].z)
            return 0;
    return 1;
}

/* Displacements and forces that differ from node to node. */
static inline void feb_write_data(feb_writer *w)
{
    const case_file *c = w->c;
    int local = 0;
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind != CASE_PRESCRIBE || feb_is_uniform(s))
            continue;
        for (int axis = 0; axis < 3; axis++) {
            if (!(s->axes >> axis & 1))
                continue;
            feb_in_section(w, "MeshData");
            fprintf(w->file, "\t\t<NodeData name=\"Prescribe%d%c\" node_set=\"Prescribe%d\" data_type=\"scalar\">\n",
                    i + 1, 'x' + axis, i + 1);
            for (int k = 0; k < s->count; k++) {
                fprintf(w->file, "\t\t\t<node lid=\"%d\">", k + 1);
                feb_number(w, "", (double)case_component(s->vectors[k], axis), "</node>\n");
            }
            fprintf(w->file, "\t\t</NodeData>\n");
        }
    }
    if (w->forces)
        feb_in_section(w, "MeshData");
    if (w->forces)
        fprintf(w->file, "\t\t<NodeData name=\"Force0\" node_set=\"Force0\" data_type=\"vec3\">\n");
    for (int i = 0; i < c->mesh.node_count && w->forces; i++)
        if (w->forces[i].x != 0 || w->forces[i].y != 0 || w->forces[i].z != 0) {
            fprintf(w->file, "\t\t\t<node lid=\"%d\">", ++local);
            feb_vector(w, w->forces[i]);
            fprintf(w->file, "</node>\n");
        }
    if (w->forces)
        fprintf(w->file, "\t\t</NodeData>\n");
    feb_end_section(w, "MeshData");
}

static inline void feb_write_prescribe(feb_writer *w, const case_statement *s)
{
    int index = feb_index(w, s), is_uniform = feb_is_uniform(s);
    int controller = !case_is_dynamic(w->c) ? 1 : s->number[CASE_RAMP] > 0 ? ++w->controllers : 0;
    for (int axis = 0; axis < 3; axis++) {
        if (!(s->axes >> axis & 1))
            continue;
        fprintf(w->file, "\t\t<bc type=\"prescribed displacement\" node_set=\"Prescribe%d\">\n\t\t\t<dof>%c</dof>\n",
                index, 'x' + axis);
        fprintf(w->file, "\t\t\t<value");
        feb_course(w, controller);
        if (is_uniform)
            feb_number(w, ">", (double)case_component(s->vectors[0], axis), "");
        else
            fprintf(w->file, " type=\"map\">Prescribe%d%c", index, 'x' + axis);
        fprintf(w->file, "</value>\n\t\t\t<relative>0</relative>\n\t\t</bc>\n");
    }
}

/* The first displacement from the others, as FEBio has it. */
static inline void feb_write_equations(feb_writer *w, const case_statement *s)
{
    const sb_constraint_term *term = s->terms;
    for (int i = 0; i < s->count; i++) {
        double slave = (double)term->coefficient;
        fprintf(w->file, "\t\t<bc type=\"linear constraint\">\n\t\t\t<node>%d</node>\n\t\t\t<dof>%c</dof>\n",
                term->node + 1, 'x' + term->axis);
        if (s->values[i] != 0)
            feb_number(w, "\t\t\t<offset lc=\"1\">", (double)s->values[i] / slave, "</offset>\n");
        for (int k = 1; k < s->term_counts[i]; k++) {
            fprintf(w->file, "\t\t\t<child_dof>\n\t\t\t\t<node>%d</node>\n\t\t\t\t<dof>%c</dof>\n", term[k].node + 1,
                    'x' + term[k].axis);
            feb_number(w, "\t\t\t\t<value>", -(double)term[k].coefficient / slave, "</value>\n\t\t\t</child_dof>\n");
        }
        fprintf(w->file, "\t\t</bc>\n");
        term += s->term_counts[i];
    }
}

static inline void feb_write_boundary(feb_writer *w)
{
    for (int i = 0; i < w->c->statement_count; i++) {
        const case_statement *s = w->c->statements + i;
        if (s->form->kind == CASE_FIX || s->form->kind == CASE_PRESCRIBE || s->form->kind == CASE_EQUATION)
            feb_in_section(w, "Boundary");
        if (s->form->kind == CASE_FIX)
            fprintf(w->file,
                    "\t\t<bc type=\"zero displacement\" node_set=\"Fix%d\">\n\t\t\t<x_dof>%d</x_dof>\n"
                    "\t\t\t<y_dof>%d</y_dof>\n\t\t\t<z_dof>%d</z_dof>\n\t\t</bc>\n",
                    i + 1, s->axes & 1, s->axes >> 1 & 1, s->axes >> 2 & 1);
        if (s->form->kind == CASE_PRESCRIBE)
            feb_write_prescribe(w, s);
        if (s->form->kind == CASE_EQUATION)
            feb_write_equations(w, s);
    }
    feb_end_section(w, "Boundary");
}

/* FEBio takes density times a body force from the residual: gravity stands there with the other sign. */
static inline void feb_write_gravity(feb_writer *w, const case_statement *s, int controller)
{
    fprintf(w->file, "\t\t<body_load type=\"body force\">\n\t\t\t<force");
    feb_course(w, controller);
    fprintf(w->file, ">");
    for (int axis = 0; axis < 3; axis++)
        feb_number(w, axis ? "," : "", s->numbers[axis] != 0 ? -s->numbers[axis] : 0, "");
    fprintf(w->file, "</force>\n\t\t</body_load>\n");
}

static inline void feb_write_traction(feb_writer *w, const case_statement *s, int controller)
{
    fprintf(w->file, "\t\t<surface_load type=\"traction\" surface=\"Traction%d\">\n\t\t\t<scale", feb_index(w, s));
    feb_course(w, controller);
    fprintf(w->file, ">1</scale>\n\t\t\t<traction>");
    feb_vector(w, s->vector);
    fprintf(w->file, "</traction>\n\t\t</surface_load>\n");
}

static inline void feb_write_loads(feb_writer *w)
{
    int controller = case_is_dynamic(w->c) ? 0 : 1;
    for (int i = 0; i < w->c->statement_count; i++) {
        const case_statement *s = w->c->statements + i;
        int is_traction = s->form->kind == CASE_TRACTION && !w->has_forces;
        if (s->form->kind == CASE_GRAVITY || s->form->kind == CASE_PRESSURE || is_traction)
            feb_in_section(w, "Loads");
        if (s->form->kind == CASE_GRAVITY)
            feb_write_gravity(w, s, controller);
        if (is_traction)
            feb_write_traction(w, s, controller);
        if (s->form->kind != CASE_PRESSURE)
            continue;
        fprintf(w->file, "\t\t<surface_load type=\"pressure\" surface=\"Pressure%d\">\n\t\t\t<pressure", i + 1);
        feb_course(w, controller);
        feb_number(w, ">", s->number[CASE_PRESSURE_VALUE], "</pressure>\n\t\t\t<linear>0</linear>\n");
        fprintf(w->file, "\t\t\t<symmetric_stiffness>1</symmetric_stiffness>\n\t\t</surface_load>\n");
    }
    if (w->forces) {
        feb_in_section(w, "Loads");
        fprintf(w->file, "\t\t<nodal_load type=\"nodal_force\" node_set=\"Force0\">\n\t\t\t<value");
        feb_course(w, controller);
        fprintf(w->file, " type=\"map\">Force0</value>\n\t\t</nodal_load>\n");
    }
    feb_end_section(w, "Loads");
}

/* A rise from 0 to 1, which then stays. */
static inline void feb_write_rise(feb_writer *w, int id, double time)
{
    feb_in_section(w, "LoadData");
    fprintf(w->file,
            "\t\t<load_controller id=\"%d\" type=\"loadcurve\">\n\t\t\t<interpolate>LINEAR</interpolate>\n"
            "\t\t\t<extend>CONSTANT</extend>\n\t\t\t<points>\n\t\t\t\t<pt>0,0</pt>\n",
            id);
    feb_number(w, "\t\t\t\t<pt>", time, ",1</pt>\n\t\t\t</points>\n\t\t</load_controller>\n");
}

static inline void feb_write_courses(feb_writer *w)
{
    int id = 0;
    if (!case_is_dynamic(w->c))
        feb_write_rise(w, 1, 1);
    for (int i = 0; i < w->c->statement_count && case_is_dynamic(w->c); i++)
        if (w->c->statements[i].form->kind == CASE_PRESCRIBE && w->c->statements[i].number[CASE_RAMP] > 0)
            feb_write_rise(w, ++id, w->c->statements[i].number[CASE_RAMP]);
    feb_end_section(w, "LoadData");
}

static inline void feb_write_output(feb_writer *w)
{
    fprintf(w->file, "\t<Output>\n\t\t<plotfile type=\"febio\">\n\t\t\t<var type=\"displacement\"/>\n"
                     "\t\t\t<var type=\"stress\"/>\n\t\t</plotfile>\n\t\t<logfile>\n"
                     "\t\t\t<node_data data=\"ux;uy;uz\" delim=\" \" file=\"displacement.txt\"/>\n");
    for (int i = 0; i < w->c->statement_count; i++) {
        const case_statement *s = w->c->statements + i;
        if (s->form->kind != CASE_OUTPUT)
            continue;
        if (s->form->code == CASE_OUTPUT_REACTION)
            fprintf(w->file, "\t\t\t<node_data data=\"Rx;Ry;Rz\" delim=\" \" file=\"reaction.txt\"/>\n");
        if (s->form->code == CASE_OUTPUT_STRESS)
            fprintf(w->file, "\t\t\t<element_data data=\"sx;sy;sz;sxy;syz;sxz\" delim=\" \" file=\"stress.txt\"/>\n");
        if (s->form->code == CASE_OUTPUT_PROBE)
            fprintf(w->file,
                    "\t\t\t<node_data data=\"ux;uy;uz\" delim=\" \" node_set=\"Probe%d\" file=\"probe_%d.txt\"/>\n",
                    i + 1, s->node + 1);
    }
    fprintf(w->file, "\t\t</logfile>\n\t</Output>\n");
}

/* ---- the file ---------------------------------------------------------------------------------------------- */

/* Finds the dead loads, if there are forces among them. */
static inline int feb_find_forces(feb_writer *w)
{
    for (int i = 0; i < w->c->statement_count; i++)
        w->has_forces |= w->c->statements[i].form->kind == CASE_FORCE;
    if (!w->has_forces)
        return 1;
    w->forces = (sb_vec3 *)calloc((size_t)w->c->mesh.node_count, sizeof *w->forces);
    return w->forces ? case_nodal_loads(w->c, CASE_DEAD_LOADS, w->forces) : case_fail_memory(w->c, 0);
}

static inline int feb_write_all(feb_writer *w)
{
    int id = 0;
    fprintf(w->file, "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<!-- units: m, s, N, kg -->\n"
                     "<febio_spec version=\"4.0\">\n\t<Module type=\"solid\"/>\n");
    feb_write_control(w, w->c->solve);
    fprintf(w->file, "\t<Material>\n");
    for (int i = 0; i < w->c->statement_count; i++)
        if (w->c->statements[i].form->kind == CASE_MATERIAL)
            feb_write_material(w, w->c->statements + i, ++id);
    fprintf(w->file, "\t</Material>\n");
    if (!feb_write_mesh(w))
        return 0;
    feb_write_domains(w);
    feb_write_data(w);
    feb_write_boundary(w);
    feb_write_loads(w);
    feb_write_courses(w);
    feb_write_output(w);
    fprintf(w->file, "</febio_spec>\n");
    return 1;
}

/* Writes the case at `path`. as_svk: 1 writes linear and corotated material as St.Venant-Kirchhoff's, another law with
 * the same constants. Returns 1, or 0 with error_line and message: then the file is what it was before. */
static inline int feb_write(case_file *c, const char *path, int as_svk)
{
    feb_writer w = {c, NULL, as_svk, 0, 0, NULL, 0};
    sb_output out;
    sb_error error;
    int ok = 1;
    if (!foreign_element_of(c->mesh.element_type))
        return case_fail(c, c->mesh_statement->line, "elements of type %s cannot be said in a file of FEBio",
                         sb_element_name(c->mesh.element_type));
    for (int i = 0; i < c->statement_count && ok; i++)
        ok = feb_can_say(&w, c->statements + i);
    ok = ok && feb_find_forces(&w);
    if (ok && sb_output_open(&out, path, &error) != SB_OK)
        ok = case_fail_library(c, 0, &error);
    if (!ok) {
        free(w.forces);
        return 0;
    }
    foreign_note_left_out(c);
    w.file = out.file;
    ok = feb_write_all(&w);
    free(w.forces);
    if (!ok) {
        sb_output_discard(&out);
        return 0;
    }
    return sb_output_close(&out, &error) == SB_OK || case_fail_library(c, 0, &error);
}

#endif /* CASE_FEB_WRITE_H */
