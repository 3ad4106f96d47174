/* case_scn_write: writes a case in memory as a scene of SOFA (.scn), in SI units: tet4, whose regions may differ in E
 * and density where they are linear or corotated, and hex8 of one such material; held nodes, nodes that move alike,
 * dead loads, pressures and gravity. Components and their attributes are those of SOFA 22.12 and later. What cannot be
 * said is refused, with its line; what means nearly the same is said in a note. Include case_foreign.h first. */
#ifndef CASE_SCN_WRITE_H
#define CASE_SCN_WRITE_H

#include "case_foreign.h"

typedef struct scn_writer {
    case_file *c;
    FILE *file;
    const case_statement *material; /* the first */
    int material_count;
} scn_writer;

/* Laws of SOFA: a method of TetrahedronFEMForceField, one of HexahedronFEMForceField, or a material of
 * TetrahedronHyperelasticityFEMForceField, whose constants are mu and lambda. */
typedef struct scn_law {
    int model;
    const char *method, *of_hexahedra, *hyperelastic;
} scn_law;

static const scn_law scn_laws[] = {{SB_LINEAR, "small", "small", NULL},
                                   {SB_COROTATED, "polar", "polar", NULL},
                                   {SB_COROTATED_INVERTIBLE, "svd", NULL, NULL},
                                   {SB_SVK, NULL, NULL, "StVenantKirchhoff"},
                                   {SB_NEO_HOOKEAN, NULL, NULL, "NeoHookean"}};
enum { SCN_LAW_COUNT = (int)(sizeof scn_laws / sizeof scn_laws[0]) };

static inline const scn_law *scn_law_of(const case_statement *s)
{
    for (int i = 0; i < SCN_LAW_COUNT; i++)
        if (scn_laws[i].model == s->form->code)
            return scn_laws + i;
    return NULL;
}

/* ---- what can be said -------------------------------------------------------------------------------------- */

static inline int scn_is_hex(const scn_writer *w) { return w->c->mesh.element_type == SB_HEX8; }

/* Whether another material can stand beside the first. */
static inline int scn_can_say_region(scn_writer *w, const case_statement *s)
{
    const case_statement *first = w->material;
    if (scn_is_hex(w))
        return case_fail(w->c, s->line, "a second material of hex8 cannot be said; the first is in line %d",
                         first->line);
    if (!scn_law_of(s)->method)
        return case_fail(w->c, s->line, "regions of material %s cannot be said: SOFA has one for all elements",
                         s->form->variant);
    if (s->form->code != first->form->code)
        return case_fail(w->c, s->line, "material %s beside %s of line %d cannot be said", s->form->variant,
                         first->form->variant, first->line);
    return s->number[CASE_NU] == first->number[CASE_NU] ||
           case_fail(w->c, s->line, "nu=%g beside %g of line %d cannot be said: SOFA has one for all elements",
                     s->number[CASE_NU], first->number[CASE_NU], first->line);
}

static inline int scn_can_say_material(scn_writer *w, const case_statement *s)
{
    const scn_law *law = scn_law_of(s);
    if (s->prony_g)
        return case_fail(w->c, s->line, "relaxation (g1= tau1=) cannot be said in a scene");
    if (!law)
        return case_fail(w->c, s->line, "material %s%s cannot be said: SOFA has no such law", s->form->variant,
                         s->given & CASE_BIT(CASE_D1) ? " with D1" : "");
    if (scn_is_hex(w) && !law->of_hexahedra)
        return case_fail(w->c, s->line, "material %s of hex8 cannot be said, only linear and corotated",
                         s->form->variant);
    if (w->material_count++ > 0)
        return scn_can_say_region(w, s);
    w->material = s;
    return 1;
}

static inline int scn_can_say_prescribe(scn_writer *w, const case_statement *s)
{
    if (!(s->number[CASE_RAMP] > 0))
        return case_fail(w->c, s->line, "a displacement without ramp= cannot be said: SOFA moves nodes over time");
    for (int i = 1; i < s->count; i++)
        if (s->vectors[i].x != s->vectors[0].x || s->vectors[i].y != s->vectors[0].y ||
            s->vectors[i].z != s->vectors[0].z)
            return case_fail(w->c, s->line, "displacements that differ from node to node cannot be said");
    return 1;
}

static inline int scn_can_say_solve(scn_writer *w, const case_statement *s)
{
    return s->form->code == CASE_STATIC || s->form->code == SB_EULER || s->form->code == SB_NEWMARK ||
           case_fail(w->c, s->line, "solve %s cannot be said, only static, euler and newmark", s->form->variant);
}

static inline int scn_can_say(scn_writer *w, const case_statement *s)
{
    const char *what = s->form->variant ? s->form->variant : "";
    switch (s->form->kind) {
    case CASE_MATERIAL: return scn_can_say_material(w, s);
    case CASE_PRESCRIBE: return scn_can_say_prescribe(w, s);
    case CASE_SOLVE: return scn_can_say_solve(w, s);
    case CASE_ELEMENT:
        return s->treatment->integration == SB_INTEGRATION_AUTO ||
               case_fail(w->c, s->line, "element %s cannot be said: SOFA has none that is the same",
                         s->treatment->name);
    case CASE_SPRING:
    case CASE_EQUATION:
    case CASE_TIE:
    case CASE_CUT:
        return case_fail(w->c, s->line, "%s%s%s cannot be said in a scene", s->form->keyword, *what ? " " : "", what);
    default: return 1;
    }
}

/* Where the same words give other numbers. */
static inline void scn_note(const scn_writer *w)
{
    case_file *c = w->c;
    int line = c->solve->line;
    for (int i = 0; scn_is_hex(w) && i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_PRESSURE)
            case_add_message(&c->notes, c->path, c->statements[i].line,
                             "SOFA presses on a quad as on two triangles: the same where it is a parallelogram");
    if (scn_is_hex(w) && w->material->form->code == SB_COROTATED)
        case_add_message(&c->notes, c->path, w->material->line,
                         "SOFA turns a hex8 as a whole; here each of its points turns by itself");
    if (!case_is_dynamic(c))
        case_add_message(&c->notes, c->path, line,
                         "SOFA's StaticSolver has its own iterations: take steps until it rests");
    else
        case_add_message(
            &c->notes, c->path, line,
            "SOFA's masses are consistent ones (--mass consistent), and it takes one linearised step each");
}

/* ---- words ------------------------------------------------------------------------------------------------- */

static inline void scn_number(scn_writer *w, const char *before, double value, const char *after)
{
    char text[32];
    fprintf(w->file, "%s%s%s", before, foreign_print_shortest(text, value), after);
}

static inline void scn_vector(scn_writer *w, const char *before, sb_vec3 v)
{
    scn_number(w, before, (double)v.x, " ");
    scn_number(w, "", (double)v.y, " ");
    scn_number(w, "", (double)v.z, "");
}

static inline void scn_indices(scn_writer *w, const case_statement *s)
{
    fprintf(w->file, " indices=\"");
    for (int i = 0; i < s->count; i++)
        fprintf(w->file, "%s%d", i ? " " : "", s->nodes[i]);
    fprintf(w->file, "\"");
}

/* ---- the scene --------------------------------------------------------------------------------------------- */

static inline void scn_write_plugins(scn_writer *w)
{
    static const char *const plugins[] = {"Constraint.Projective",
                                          "LinearSolver.Direct",
                                          "Mapping.Linear",
                                          "Mass",
                                          "MechanicalLoad",
                                          "ODESolver.Backward",
                                          "SolidMechanics.FEM.Elastic",
                                          "SolidMechanics.FEM.HyperElastic",
                                          "StateContainer",
                                          "Topology.Container.Dynamic"};
    for (int i = 0; i < (int)(sizeof plugins / sizeof plugins[0]); i++)
        fprintf(w->file, "\t<RequiredPlugin name=\"Sofa.Component.%s\"/>\n", plugins[i]);
    fprintf(w->file, "\t<DefaultAnimationLoop/>\n");
}

static inline void scn_write_solver(scn_writer *w, const case_statement *s)
{
    if (s->form->code == CASE_STATIC) {
        fprintf(w->file, "\t\t<StaticSolver/>\n");
    } else {
        fprintf(w->file, s->form->code == SB_EULER ? "\t\t<EulerImplicitSolver" : "\t\t<NewmarkImplicitSolver");
        if (s->form->code == SB_NEWMARK)
            fprintf(w->file, " gamma=\"0.5\" beta=\"0.25\"");
        scn_number(w, " rayleighMass=\"", s->number[CASE_ALPHA], "\"");
        scn_number(w, " rayleighStiffness=\"", s->number[CASE_BETA], "\"/>\n");
    }
    fprintf(w->file, "\t\t<SparseLDLSolver template=\"CompressedRowSparseMatrixMat3x3d\"/>\n");
}

/* Indices of so many to an element. */
static inline void scn_elements(scn_writer *w, const char *name, const int *indices, int count, int width)
{
    fprintf(w->file, " %s=\"", name);
    for (int k = 0; k < width * count; k++)
        fprintf(w->file, "%s%d", k == 0 ? "" : k % width ? " " : "\n", indices[k]);
    fprintf(w->file, "\"");
}

static inline void scn_write_mesh(scn_writer *w)
{
    const sb_mesh *mesh = &w->c->mesh;
    const char *kind = scn_is_hex(w) ? "Hexahedron" : "Tetrahedron";
    fprintf(w->file, "\t\t<%sSetTopologyContainer name=\"topology\" position=\"", kind);
    for (int i = 0; i < mesh->node_count; i++)
        scn_vector(w, i ? "\n" : "", mesh->nodes[i]);
    fprintf(w->file, "\"");
    scn_elements(w, scn_is_hex(w) ? "hexahedra" : "tetrahedra", mesh->elements, mesh->element_count,
                 sb_mesh_element_width(mesh));
    fprintf(w->file,
            "/>\n\t\t<%sSetGeometryAlgorithms template=\"Vec3\"/>\n"
            "\t\t<MechanicalObject name=\"nodes\" template=\"Vec3\" src=\"@topology\"/>\n",
            kind);
}

/* The material of an element. */
static inline const case_statement *scn_material_of(const scn_writer *w, int element)
{
    const sb_mesh *mesh = &w->c->mesh;
    int region = mesh->regions ? mesh->regions[element] : 0;
    for (int i = 0; i < w->c->statement_count; i++) {
        const case_statement *s = w->c->statements + i;
        if (s->form->kind == CASE_MATERIAL && (int)s->number[CASE_REGION] == region)
            return s;
    }
    return w->material;
}

/* A number of the one material, or one for each element. */
static inline void scn_option(scn_writer *w, const char *name, case_key key)
{
    int count = w->material_count > 1 ? w->c->mesh.element_count : 1;
    fprintf(w->file, " %s=\"", name);
    for (int e = 0; e < count; e++)
        scn_number(w, e ? " " : "", (count > 1 ? scn_material_of(w, e) : w->material)->number[key], "");
    fprintf(w->file, "\"");
}

static inline void scn_write_material(scn_writer *w, const case_statement *s)
{
    const scn_law *law = scn_law_of(s);
    double e = s->number[CASE_E], nu = s->number[CASE_NU];
    fprintf(w->file, "\t\t<MeshMatrixMass");
    scn_option(w, "massDensity", CASE_DENSITY);
    fprintf(w->file, " topology=\"@topology\"/>\n");
    if (law->method) {
        fprintf(w->file, "\t\t<%sFEMForceField method=\"%s\"", scn_is_hex(w) ? "Hexahedron" : "Tetrahedron",
                scn_is_hex(w) ? law->of_hexahedra : law->method);
        scn_option(w, "youngModulus", CASE_E);
        scn_number(w, " poissonRatio=\"", nu, "\" topology=\"@topology\"/>\n");
    } else {
        fprintf(w->file, "\t\t<TetrahedronHyperelasticityFEMForceField materialName=\"%s\"", law->hyperelastic);
        scn_number(w, " ParameterSet=\"", e / (2 * (1 + nu)), " ");
        scn_number(w, "", e * nu / ((1 + nu) * (1 - 2 * nu)), "\" topology=\"@topology\"/>\n");
    }
}

/* Faces in a node of their own, which moves as the body does. SOFA's pressure pulls the side that sees corners
 * counter-clockwise. */
static inline int scn_write_pressure(scn_writer *w, const case_statement *s)
{
    const sb_mesh *mesh = &w->c->mesh;
    int corners = case_face_corners(w->c), *list = (int *)calloc((size_t)s->count * (size_t)corners + 1, sizeof *list);
    int ok = list != NULL || case_fail_memory(w->c, s->line);
    sb_error error;
    if (ok && !w->c->node_elements.offsets && sb_mesh_node_elements(mesh, NULL, &w->c->node_elements, &error) != SB_OK)
        ok = case_fail_library(w->c, s->line, &error);
    for (int i = 0; i < s->count && ok; i++) {
        int element, face, local[SB_MAX_FACE_NODES];
        if (!case_find_face(w->c, s->faces + (size_t)i * (size_t)corners, corners, &element, &face)) {
            ok = case_fail(w->c, s->line, "face %d is no face of an element", i);
            break;
        }
        sb_element_face(mesh->element_type, face, local, NULL);
        for (int k = 0; k < corners; k++)
            list[(size_t)i * (size_t)corners + (size_t)k] =
                mesh->elements[(size_t)element * (size_t)sb_mesh_element_width(mesh) + (size_t)local[k]];
    }
    if (ok) {
        fprintf(w->file, "\t\t<Node name=\"pressure%d\">\n\t\t\t<%sSetTopologyContainer name=\"faces\"",
                (int)(s - w->c->statements) + 1, corners == 4 ? "Quad" : "Triangle");
        scn_elements(w, corners == 4 ? "quads" : "triangles", list, s->count, corners);
        fprintf(w->file,
                "/>\n\t\t\t<MechanicalObject name=\"copy\" template=\"Vec3\" position=\"@../nodes.position\"/>\n"
                "\t\t\t<SurfacePressureForceField");
        scn_number(w, " pressure=\"", s->number[CASE_PRESSURE_VALUE] != 0 ? -s->number[CASE_PRESSURE_VALUE] : 0, "\"");
        fprintf(w->file, " topology=\"@faces\"/>\n\t\t\t<IdentityMapping input=\"@../nodes\" output=\"@copy\"/>\n"
                         "\t\t</Node>\n");
    }
    free(list);
    return ok;
}

static inline void scn_write_support(scn_writer *w, const case_statement *s)
{
    int is_whole = s->axes == SB_XYZ, moves = s->form->kind == CASE_PRESCRIBE;
    fprintf(w->file, "\t\t<%s%sProjectiveConstraint", is_whole ? "" : "Partial", moves ? "LinearMovement" : "Fixed");
    scn_indices(w, s);
    if (!is_whole)
        fprintf(w->file, " %s=\"%d %d %d\"", moves ? "movedDirections" : "fixedDirections", s->axes & 1,
                s->axes >> 1 & 1, s->axes >> 2 & 1);
    if (moves) { /* what lies behind the last key stays where it is: the end of the case is behind it */
        scn_number(w, " keyTimes=\"0 ", s->number[CASE_RAMP], " ");
        scn_number(w, "", fmax(w->c->solve->number[CASE_END], s->number[CASE_RAMP]) + 1, "\"");
        scn_vector(w, " movements=\"0 0 0 ", s->vectors[0]);
        scn_vector(w, " ", s->vectors[0]);
        fprintf(w->file, "\"");
    }
    fprintf(w->file, "/>\n");
}

static inline void scn_write_forces(scn_writer *w, const sb_vec3 *forces)
{
    int count = 0;
    fprintf(w->file, "\t\t<ConstantForceField indices=\"");
    for (int i = 0; i < w->c->mesh.node_count; i++)
        if (forces[i].x != 0 || forces[i].y != 0 || forces[i].z != 0)
            fprintf(w->file, "%s%d", count++ ? " " : "", i);
    fprintf(w->file, "\" forces=\"");
    count = 0;
    for (int i = 0; i < w->c->mesh.node_count; i++)
        if (forces[i].x != 0 || forces[i].y != 0 || forces[i].z != 0)
            scn_vector(w, count++ ? "\n" : "", forces[i]);
    fprintf(w->file, "\"/>\n");
}

/* `forces`: [nodes] dead loads (N); NULL: none. */
static inline int scn_write_all(scn_writer *w, const sb_vec3 *forces)
{
    const case_file *c = w->c;
    int ok = 1;
    const double still[3] = {0, 0, 0}, *g = c->gravity ? c->gravity->numbers : still;
    fprintf(w->file, "<?xml version=\"1.0\"?>\n<!-- units: m, s, N, kg -->\n<Node name=\"root\"");
    scn_number(w, " dt=\"", case_is_dynamic(c) ? case_dt(c) : 1, "\"");
    scn_number(w, " gravity=\"", g[0], " ");
    scn_number(w, "", g[1], " ");
    scn_number(w, "", g[2], "\">\n");
    scn_write_plugins(w);
    fprintf(w->file, "\t<Node name=\"body\">\n");
    scn_write_solver(w, c->solve);
    scn_write_mesh(w);
    scn_write_material(w, w->material);
    for (int i = 0; i < c->statement_count; i++)
        if (c->statements[i].form->kind == CASE_FIX || c->statements[i].form->kind == CASE_PRESCRIBE)
            scn_write_support(w, c->statements + i);
    if (forces)
        scn_write_forces(w, forces);
    for (int i = 0; i < c->statement_count && ok; i++)
        if (c->statements[i].form->kind == CASE_PRESSURE)
            ok = scn_write_pressure(w, c->statements + i);
    fprintf(w->file, "\t</Node>\n</Node>\n");
    return ok;
}

/* Writes the case at `path`. Returns 1, or 0 with error_line and message: then the file is what it was before. */
static inline int scn_write(case_file *c, const char *path)
{
    scn_writer w = {c, NULL, NULL, 0};
    sb_vec3 *forces = NULL;
    sb_output out;
    sb_error error;
    int ok = 1, any = 0;
    if (c->mesh.element_type != SB_TET4 && c->mesh.element_type != SB_HEX8)
        return case_fail(c, c->mesh_statement->line,
                         "elements of type %s cannot be said in a scene, only tet4 and hex8",
                         sb_element_name(c->mesh.element_type));
    for (int i = 0; i < c->statement_count && ok; i++) {
        ok = scn_can_say(&w, c->statements + i);
        any |= (CASE_DEAD_LOADS & CASE_KIND(c->statements[i].form->kind)) != 0;
    }
    if (ok && any) {
        forces = (sb_vec3 *)calloc((size_t)c->mesh.node_count, sizeof *forces);
        ok = forces ? case_nodal_loads(c, CASE_DEAD_LOADS, forces) : case_fail_memory(c, 0);
    }
    if (ok && sb_output_open(&out, path, &error) != SB_OK)
        ok = case_fail_library(c, 0, &error);
    if (ok) {
        foreign_note_left_out(c);
        scn_note(&w);
        w.file = out.file;
        ok = scn_write_all(&w, forces);
        if (!ok)
            sb_output_discard(&out);
        else
            ok = sb_output_close(&out, &error) == SB_OK || case_fail_library(c, 0, &error);
    }
    free(forces);
    return ok;
}

#endif /* CASE_SCN_WRITE_H */
