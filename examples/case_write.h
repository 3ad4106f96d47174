/* case_write: writes a case in memory as a case file, with its mesh and lists beside it. Whatever file it was read
 * from, case_read makes the same body of it. Include case_reader.h first. */
#ifndef CASE_WRITE_H
#define CASE_WRITE_H

#include "case_reader.h"

/* 1 when `path` is a file that the case was read from. `same` tells whether two names are one file. */
static inline int case_reads(const case_file *c, const char *path, int (*same)(const char *, const char *))
{
    static const case_key lists[] = {CASE_NODES, CASE_FACES, CASE_FILE, CASE_NEAR};
    int found = same(path, c->path);
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        for (int k = 0; k < 5; k++) {
            const char *name = k == 4 ? (s->form->kind == CASE_MESH || s->form->kind == CASE_SURFACE ? s->path : NULL)
                                      : (s->given & CASE_BIT(lists[k]) ? s->text[lists[k]] : NULL);
            char *input = name ? case_input_path(c, name) : NULL;
            found |= input && same(path, input);
            free(input);
        }
    }
    return found;
}

/* A case file that is being written. */
typedef struct case_writer {
    case_file *c;
    FILE *file;
    char *stem; /* of all its files: the name without its ending */
    int (*same)(const char *, const char *);
    int lists; /* written so far */
} case_writer;

/* The option under which the list of a statement is written; CASE_KEY_COUNT: it has none. */
static inline case_key case_list_key(const case_statement *s)
{
    switch (s->form->kind) {
    case CASE_FIX: return CASE_NODES;
    case CASE_TRACTION:
    case CASE_PRESSURE:
    case CASE_TIE: return CASE_FACES;
    case CASE_PRESCRIBE:
    case CASE_FORCE:
    case CASE_SPRING:
    case CASE_EQUATION: return CASE_FILE;
    default: return CASE_KEY_COUNT;
    }
}

static inline void case_write_numbers(FILE *file, const double *numbers, int count)
{
    for (int i = 0; i < count; i++)
        fprintf(file, " %.17g", numbers[i]);
}

static inline void case_write_vector(FILE *file, sb_vec3 v)
{
    const double xyz[3] = {(double)v.x, (double)v.y, (double)v.z};
    case_write_numbers(file, xyz, 3);
}

static inline void case_write_equations(FILE *file, const case_statement *s)
{
    const sb_constraint_term *term = s->terms;
    for (int i = 0; i < s->count; i++) {
        fprintf(file, "%.17g", (double)s->values[i]);
        for (int k = 0; k < s->term_counts[i]; k++, term++)
            fprintf(file, " %d %c %.17g", term->node, "xyz"[term->axis], (double)term -> coefficient);
        fprintf(file, "\n");
    }
}

static inline void case_write_lines(const case_file *c, FILE *file, const case_statement *s)
{
    int corners = case_face_corners(c);
    case_key key = case_list_key(s);
    for (int i = 0; i < s->count && key == CASE_FACES; i++)
        for (int k = 0; k < corners; k++)
            fprintf(file, "%d%c", s->faces[(size_t)i * (size_t)corners + (size_t)k], k + 1 < corners ? ' ' : '\n');
    for (int i = 0; i < s->count && key != CASE_FACES; i++) {
        fprintf(file, "%d", s->nodes[i]);
        if (s->form->kind == CASE_SPRING)
            fprintf(file, " %.17g", (double)s->stiffness[i]);
        if (key == CASE_FILE)
            case_write_vector(file, s->vectors[i]);
        fprintf(file, "\n");
    }
}

/* The path of a file beside the case; NULL when memory is short, or the name is an input. The caller frees it. */
static inline char *case_beside(const case_writer *w, int line, const char *ending)
{
    size_t stem = strlen(w->stem), length = strlen(ending);
    char *path = (char *)malloc(stem + length + 1);
    if (!path) {
        case_fail_memory(w->c, line);
        return NULL;
    }
    memcpy(path, w->stem, stem);
    memcpy(path + stem, ending, length + 1);
    if (w->same && case_reads(w->c, path, w->same)) {
        case_fail(w->c, line, "%.500s is read by this case: it would be overwritten", path);
        free(path);
        return NULL;
    }
    return path;
}

/* The name of a path within its folder: what a case beside it calls it. */
static inline const char *case_base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* Writes the list of a statement into a file of its own, and the option that names it. */
static inline int case_write_list(case_writer *w, const case_statement *s)
{
    char ending[64];
    char *path;
    sb_output out;
    sb_error error;
    sb_result result;
    snprintf(ending, sizeof ending, "_%d_%s.txt", ++w->lists, s->form->keyword);
    path = case_beside(w, s->line, ending);
    if (!path)
        return 0;
    result = sb_output_open(&out, path, &error);
    if (result == SB_OK && s->form->kind == CASE_EQUATION)
        case_write_equations(out.file, s);
    else if (result == SB_OK)
        case_write_lines(w->c, out.file, s);
    if (result == SB_OK)
        result = sb_output_close(&out, &error);
    if (result != SB_OK) {
        free(path);
        return case_fail_library(w->c, s->line, &error);
    }
    fprintf(w->file, " %s=%s", case_keys[case_list_key(s)].name, case_base_name(path));
    free(path);
    return 1;
}

static inline void case_write_words(case_writer *w, const case_statement *s)
{
    const double *number = s->numbers;
    for (const char *word = s->form->words; *word; word++)
        switch (*word) {
        case 'f': fprintf(w->file, " %s", s->path); break;
        case 'e': fprintf(w->file, " %s", s->treatment->name); break;
        case 'i': fprintf(w->file, " %d", s->node); break;
        case 'a':
            fprintf(w->file, " %s%s%s", s->axes & SB_X ? "x" : "", s->axes & SB_Y ? "y" : "",
                    s->axes & SB_Z ? "z" : "");
            break;
        default: case_write_numbers(w->file, number++, 1);
        }
}

static inline void case_write_options(case_writer *w, const case_statement *s)
{
    case_key list = case_list_key(s);
    for (int k = 0; k < CASE_KEY_COUNT; k++) {
        case_type type = case_keys[k].type;
        if (!(s->given & CASE_BIT(k)) || type == CASE_TYPE_PATH)
            continue;
        if (type != CASE_TYPE_VECTOR)
            fprintf(w->file, type == CASE_TYPE_STEP && s->number[k] == 0 ? " %s=auto" : " %s=%.17g", case_keys[k].name,
                    s->number[k]);
        else if (list != CASE_FILE) /* vectors of lists stand in their files */
            fprintf(w->file, " %s=%.17g,%.17g,%.17g", case_keys[k].name, (double)s->vector.x, (double)s->vector.y,
                    (double)s->vector.z);
    }
    for (int k = 0; s->prony_g >> k & 1; k++)
        fprintf(w->file, " g%d=%.17g tau%d=%.17g", k + 1, (double)s->g[k], k + 1, (double)s->tau[k]);
}

static inline int case_write_mesh(case_writer *w, const case_statement *s)
{
    char *path = case_beside(w, s->line, "_mesh.vtk");
    sb_error error;
    int ok = path != NULL;
    if (ok && sb_mesh_save_vtk(path, &w->c->mesh, NULL, 0, &error) != SB_OK)
        ok = case_fail_library(w->c, s->line, &error);
    if (ok)
        fprintf(w->file, "mesh %s\n", case_base_name(path));
    free(path);
    return ok;
}

/* A tie has two lists: that of its nodes is written as that of a support. */
static inline int case_write_tied(case_writer *w, const case_statement *s)
{
    case_statement nodes;
    memset(&nodes, 0, sizeof nodes);
    nodes.line = s->line;
    nodes.form = case_form_of(CASE_FIX);
    nodes.nodes = s->nodes;
    nodes.count = s->tied_count;
    return case_write_list(w, &nodes);
}

static inline int case_write_statement(case_writer *w, const case_statement *s)
{
    if (s == w->c->mesh_statement)
        return case_write_mesh(w, s);
    if (s->form->kind == CASE_SURFACE || s->form->kind == CASE_SELECT) /* what they gave is written */
        return 1;
    if (s->form->kind == CASE_CUT && (s->given & CASE_BIT(CASE_FILE)))
        return case_fail(w->c, s->line, "the file of a cut is not written anew: cut plane is");
    fprintf(w->file, "%s%s%s", s->form->keyword, s->form->variant ? " " : "", s->form->variant ? s->form->variant : "");
    case_write_words(w, s);
    if (s->form->kind == CASE_TIE && !case_write_tied(w, s))
        return 0;
    if (case_list_key(s) != CASE_KEY_COUNT && !case_write_list(w, s))
        return 0;
    case_write_options(w, s);
    fprintf(w->file, "\n");
    return 1;
}

/* Writes STEM.case at `path`, STEM_mesh.vtk and STEM_1_fix.txt, ... Returns 1, or 0 with error_line and message.
 * Nothing that the case was read from is overwritten when `same` tells whether two names are one file (NULL: not
 * looked). */
static inline int case_write(case_file *c, const char *path, int (*same)(const char *, const char *))
{
    case_writer w = {c, NULL, NULL, same, 0};
    size_t length = strlen(path);
    sb_output out;
    sb_error error;
    int ok = 1;
    if (same && case_reads(c, path, same))
        return case_fail(c, 0, "%.500s is read by this case: it would be overwritten", path);
    if (sb_output_open(&out, path, &error) != SB_OK)
        return case_fail_library(c, 0, &error);
    w.stem = (char *)malloc(length + 1);
    w.file = out.file;
    if (w.stem) {
        memcpy(w.stem, path, length + 1);
        if (length > 5 && strcmp(path + length - 5, ".case") == 0)
            w.stem[length - 5] = 0;
    }
    for (int i = 0; i < c->statement_count && w.stem && ok; i++)
        ok = case_write_statement(&w, c->statements + i);
    ok = w.stem ? ok : case_fail_memory(c, 0);
    free(w.stem);
    if (!ok)
        sb_output_discard(&out);
    else if (sb_output_close(&out, &error) != SB_OK)
        ok = case_fail_library(c, 0, &error);
    return ok;
}

#endif /* CASE_WRITE_H */
