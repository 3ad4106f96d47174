/* amalgamate: joins the rooms of one library into its single header.
 *
 *     amalgamate MANIFEST [FILE...]        run from the root of the repository
 *
 * MANIFEST lies in the folder of the rooms; its lines are
 *
 *     # comment
 *     output NAME             the header to write, relative to the current folder
 *     title TEXT              what the header is, for its first line
 *     version FILE MACRO      the macro of FILE whose string is the version, for the first line
 *     names FILE REAL API     writes FILE: renames every function that a declaration marks with the macro API
 *                             when the macro REAL is float
 *     requires NAME           a header that the product includes before all else (needle.h requires softbody.h)
 *     licence FILE            its text ends the header, FILE relative to the current folder
 *     section top             the parts that follow stand before the guards
 *     section declarations GUARD              ... inside #ifndef GUARD
 *     section implementation SWITCH           ... inside #ifdef SWITCH, once
 *     section bottom          the parts that follow stand after the guards
 *     internal MACRO          lines of declarations between #if defined(SWITCH) || defined(MACRO) and its #endif are
 *                             for the library alone: they go to the head of the implementation, so that declarations
 *                             which came in before SWITCH was defined lack nothing
 *     folder NAME [LOWER...]  parts in the subfolder NAME may include parts of NAME and of the folders LOWER, which
 *     stand
 *                             above this line; parts beside the manifest may be included by all
 *     FILE                    a part, relative to the manifest's folder
 *     FILE unless MACRO...    a part that a user leaves out by defining one of these macros: it stands inside
 *                             #if !defined(MACRO), and a part that includes it must name the same macros
 *
 * Every part is copied as it is, with LF line ends and without its #include "..." lines; each of those must name
 * a part that stands higher up, in a folder that its own may include: so no room calls a higher floor. Of the required
 * header all rooms may be included but NAME_private.h, which hold what is inside its objects. FILE... are the files
 * found in the folder (the Makefile lists them, C99 cannot): one that no manifest line names is an error, so that no
 * room is forgotten. On any error the tool says what is wrong on stderr, returns 1 and leaves the output as it was. */
#include <ctype.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_PARTS = 512, MAX_NAME = 512, MAX_WORDS = 12, MAX_FOLDERS = 16, MAX_SWITCHES = 4 };

typedef struct text {
    char *data; /* ends with a zero */
    size_t size;
    size_t capacity;
} text;

enum section { TOP, DECLARATIONS, IMPLEMENTATION, BOTTOM, SECTION_COUNT };
static const char *const section_names[SECTION_COUNT] = {"top", "declarations", "implementation", "bottom"};

typedef struct part {
    char path[MAX_NAME]; /* manifest's folder and file name */
    int folder;          /* subfolder, or -1: beside the manifest */
    int section;
    char switches[MAX_SWITCHES][MAX_NAME]; /* macros that leave it out; the rest empty */
    text content;
} part;

/* A subfolder and what its parts may include. */
typedef struct subfolder {
    char name[MAX_NAME];
    int may_include[MAX_FOLDERS]; /* by number of folder */
} subfolder;

typedef struct manifest {
    const char *path;
    char folder[MAX_NAME]; /* with its closing slash */
    char output[MAX_NAME];
    char title[MAX_NAME];
    char version_file[MAX_NAME], version_macro[MAX_NAME];
    char names_file[MAX_NAME], names_real[MAX_NAME], names_api[MAX_NAME];
    char required[MAX_NAME];
    char licence[MAX_NAME];
    char guard[MAX_NAME];       /* macro of the declarations */
    char user_switch[MAX_NAME]; /* macro that asks for the implementation */
    char internal[MAX_NAME];    /* macro that opens what is internal to sources built one by one */
    subfolder folders[MAX_FOLDERS];
    int folder_count;
    part *parts;
    int part_count;
} manifest;

/* ---- errors and text ---- */

static void fail(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fprintf(stderr, "amalgamate: ");
    vfprintf(stderr, format, arguments);
    fprintf(stderr, "\n");
    va_end(arguments);
    exit(1);
}

static void text_append(text *to, const char *bytes, size_t count)
{
    if (to->capacity - to->size <= count) {
        to->capacity = 2 * (to->capacity + count) + 1;
        to->data = (char *)realloc(to->data, to->capacity);
        if (!to->data)
            fail("out of memory");
    }
    memcpy(to->data + to->size, bytes, count);
    to->size += count;
    to->data[to->size] = 0;
}

static void text_add(text *to, const char *string) { text_append(to, string, strlen(string)); }

/* Appends printf's lines; a few macros and names long at most. */
static void add_lines(text *to, const char *format, ...)
{
    char lines[4 * MAX_NAME];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(lines, sizeof lines, format, arguments);
    va_end(arguments);
    text_add(to, lines);
}

/* The file with LF line ends and a last line that is ended. */
static text read_file(const char *path)
{
    text content = {NULL, 0, 0};
    int c;
    FILE *file = fopen(path, "rb");
    if (!file)
        fail("%s: cannot be opened", path);
    text_add(&content, "");
    while ((c = getc(file)) != EOF) {
        char byte = (char)c;
        if (byte != '\r')
            text_append(&content, &byte, 1);
    }
    if (ferror(file))
        fail("%s: cannot be read", path);
    fclose(file);
    if (content.size && content.data[content.size - 1] != '\n')
        text_add(&content, "\n");
    return content;
}

/* Writes a file beside the old one, then puts it in its place: a failure leaves the old one whole. */
static void write_file(const char *path, const text *content)
{
    char temporary[MAX_NAME + 8];
    FILE *file;
    int good;
    snprintf(temporary, sizeof temporary, "%s.tmp", path);
    file = fopen(temporary, "wb");
    if (!file)
        fail("%s: cannot be written", temporary);
    good = fwrite(content->data, 1, content->size, file) == content->size;
    good = fclose(file) == 0 && good;
    if (good && rename(temporary, path) != 0) {
        remove(path); /* Windows renames onto no existing file */
        good = rename(temporary, path) == 0;
    }
    if (!good) {
        remove(temporary);
        fail("%s: cannot be written", path);
    }
}

/* ---- the manifest ---- */

static void copy_name(char *to, const char *from)
{
    if (strlen(from) >= MAX_NAME)
        fail("name too long: %s", from);
    strcpy(to, from);
}

static void join_path(char *to, const char *folder, const char *name)
{
    if (strlen(folder) + strlen(name) >= MAX_NAME)
        fail("path too long: %s%s", folder, name);
    strcpy(to, folder);
    strcat(to, name);
}

static int find_part(const manifest *m, const char *path)
{
    for (int i = 0; i < m->part_count; i++)
        if (strcmp(m->parts[i].path, path) == 0)
            return i;
    return -1;
}

/* Number of the subfolder, of which only the first `length` letters count, or -1. */
static int find_folder(const manifest *m, const char *name, size_t length)
{
    for (int i = 0; i < m->folder_count; i++)
        if (strlen(m->folders[i].name) == length && strncmp(m->folders[i].name, name, length) == 0)
            return i;
    return -1;
}

static void add_folder(manifest *m, char **words, int count, int line)
{
    subfolder *folder = &m->folders[m->folder_count];
    if (m->folder_count == MAX_FOLDERS)
        fail("%s:%d: more than %d folders", m->path, line, MAX_FOLDERS);
    if (find_folder(m, words[1], strlen(words[1])) >= 0)
        fail("%s:%d: %s is named twice", m->path, line, words[1]);
    copy_name(folder->name, words[1]);
    for (int i = 2; i < count; i++) {
        int lower = find_folder(m, words[i], strlen(words[i]));
        if (lower < 0)
            fail("%s:%d: the folder %s does not stand above this line", m->path, line, words[i]);
        folder->may_include[lower] = 1;
    }
    folder->may_include[m->folder_count++] = 1;
}

static int folder_of_part(const manifest *m, const char *name, int line)
{
    const char *slash = strncmp(name, "../", 3) == 0 ? NULL : strchr(name, '/');
    int folder = slash ? find_folder(m, name, (size_t)(slash - name)) : -1;
    if (slash && folder < 0)
        fail("%s:%d: %s is in a folder that has no line", m->path, line, name);
    return folder;
}

/* words: the file, and maybe `unless` and macros. */
static void add_part(manifest *m, char **words, int count, int section, int line)
{
    const char *name = words[0];
    char path[MAX_NAME];
    join_path(path, m->folder, name);
    if (count - 2 > MAX_SWITCHES)
        fail("%s:%d: more than %d macros", m->path, line, MAX_SWITCHES);
    if (section < 0)
        fail("%s:%d: a part before the first section: %s", m->path, line, name);
    if (find_part(m, path) >= 0)
        fail("%s:%d: %s is named twice", m->path, line, name);
    if (m->part_count == MAX_PARTS)
        fail("%s:%d: more than %d parts", m->path, line, MAX_PARTS);
    strcpy(m->parts[m->part_count].path, path);
    m->parts[m->part_count].folder = folder_of_part(m, name, line);
    m->parts[m->part_count].section = section;
    for (int i = 2; i < count; i++)
        copy_name(m->parts[m->part_count].switches[i - 2], words[i]);
    m->part_count++;
}

/* Cuts a line at its blanks; returns the number of words, MAX_WORDS + 1 when there are more. */
static int split_words(char *line, char **words)
{
    int count = 0;
    for (char *word = strtok(line, " \t"); word; word = strtok(NULL, " \t")) {
        if (count == MAX_WORDS)
            return MAX_WORDS + 1;
        words[count++] = word;
    }
    return count;
}

static int open_section(manifest *m, char **words, int count, int line)
{
    int section = 0;
    while (section < SECTION_COUNT && (count < 2 || strcmp(words[1], section_names[section]) != 0))
        section++;
    if (section == SECTION_COUNT)
        fail("%s:%d: no such section", m->path, line);
    if (count != (section == DECLARATIONS || section == IMPLEMENTATION ? 3 : 2))
        fail("%s:%d: declarations and implementation take one macro, top and bottom none", m->path, line);
    if (section == DECLARATIONS)
        copy_name(m->guard, words[2]);
    if (section == IMPLEMENTATION)
        copy_name(m->user_switch, words[2]);
    return section;
}

/* Obeys one line; returns the section that holds for the next. */
static int read_line(manifest *m, char *content, int section, int line)
{
    char *words[MAX_WORDS];
    char title[MAX_NAME];
    int count;
    copy_name(title, content + strspn(content, " \t"));
    count = split_words(content, words);
    if (count == 0 || words[0][0] == '#')
        return section;
    if (strcmp(words[0], "title") == 0)
        copy_name(m->title, title + 5 + strspn(title + 5, " \t"));
    else if (strcmp(words[0], "section") == 0)
        return open_section(m, words, count, line);
    else if (strcmp(words[0], "folder") == 0 && count >= 2 && count <= MAX_WORDS)
        add_folder(m, words, count, line);
    else if (strcmp(words[0], "output") == 0 && count == 2)
        copy_name(m->output, words[1]);
    else if (strcmp(words[0], "requires") == 0 && count == 2)
        copy_name(m->required, words[1]);
    else if (strcmp(words[0], "internal") == 0 && count == 2)
        copy_name(m->internal, words[1]);
    else if (strcmp(words[0], "licence") == 0 && count == 2)
        copy_name(m->licence, words[1]);
    else if (strcmp(words[0], "version") == 0 && count == 3) {
        join_path(m->version_file, m->folder, words[1]);
        copy_name(m->version_macro, words[2]);
    } else if (strcmp(words[0], "names") == 0 && count == 4) {
        join_path(m->names_file, m->folder, words[1]);
        copy_name(m->names_real, words[2]);
        copy_name(m->names_api, words[3]);
    } else if (count == 1 || (count >= 3 && count <= MAX_WORDS && strcmp(words[1], "unless") == 0))
        add_part(m, words, count, section, line);
    else
        fail("%s:%d: cannot be understood", m->path, line);
    return section;
}

static void read_manifest(manifest *m, const char *path)
{
    text content = read_file(path);
    const char *slash = strrchr(path, '/');
    int section = -1, line = 0;
    m->path = path;
    copy_name(m->folder, path);
    m->folder[slash ? slash - path + 1 : 0] = 0;
    for (char *start = content.data, *end; *start; start = end + 1) {
        end = strchr(start, '\n');
        *end = 0;
        section = read_line(m, start, section, ++line);
    }
    free(content.data);
    if (!*m->output || !*m->guard || !*m->user_switch || !*m->version_macro || !*m->title || !*m->licence)
        fail("%s: output, title, version, licence, declarations and implementation must all be there", path);
    if (*m->names_file && find_part(m, m->names_file) < 0)
        fail("%s: %s is no part", path, m->names_file);
}

static void check_folder(const manifest *m, char **files, int count)
{
    for (int i = 0; i < count; i++)
        if (strcmp(files[i], m->path) != 0 && find_part(m, files[i]) < 0)
            fail("%s is in the folder, but %s does not name it", files[i], m->path);
}

/* ---- public functions and their names in a float build ---- */

/* Blanks comments and preprocessor lines, so that only declarations are left. */
static void blank_comments(char *s)
{
    int line_start = 1;
    while (*s) {
        if (s[0] == '/' && s[1] == '*') {
            while (*s && !(s[0] == '*' && s[1] == '/'))
                *s++ = ' ';
            if (*s)
                s[0] = s[1] = ' ';
        } else if ((line_start && *s == '#') || (s[0] == '/' && s[1] == '/')) {
            while (*s && *s != '\n') {
                if (s[0] == '\\' && s[1] == '\n')
                    *s++ = ' ';
                *s++ = ' ';
            }
        } else {
            line_start = *s == '\n' || (line_start && isspace((unsigned char)*s));
            s++;
        }
    }
}

static int is_name(char c) { return isalnum((unsigned char)c) || c == '_'; }

/* Appends a #define for each function whose declaration starts with the word `api`. */
static void add_names(text *to, char *declarations, const char *api)
{
    size_t length = strlen(api);
    for (char *at = strstr(declarations, api); at; at = strstr(at + length, api)) {
        char *open, *end, *start;
        if (is_name(at[length]) || (at > declarations && is_name(at[-1])))
            continue;
        open = strchr(at, '(');
        if (!open)
            fail("%s without a function after it: %.40s", api, at);
        for (end = open; end > at && isspace((unsigned char)end[-1]); end--)
            ;
        for (start = end; start > at && is_name(start[-1]); start--)
            ;
        text_add(to, "#define ");
        text_append(to, start, (size_t)(end - start));
        text_add(to, " ");
        text_append(to, start, (size_t)(end - start));
        text_add(to, "_f32\n");
    }
}

/* The names file: it must work before the header that settles REAL, hence its own test of the macro. */
static text make_names(const manifest *m)
{
    text names = {NULL, 0, 0};
    char prefix[MAX_NAME];
    const char *p = prefix, *real = m->names_real;
    snprintf(prefix, sizeof prefix, "%.*sI_NAMES", (int)strcspn(m->names_api, "_"), m->names_api);
    add_lines(
        &names,
        "/* names: the exported names of a float build end in _f32, so that a float caller and a double object do\n"
        " * not link. Written by src/amalgamate.c from the declarations: do not edit. */\n"
        "#ifndef %s_H\n#define %s_H\n\n#if defined(%s)\n",
        p, p, real);
    add_lines(&names,
              "#define %s_PASTE_(a, b) a##b\n#define %s_PASTE(a, b) %s_PASTE_(a, b)\n"
              "#define %s_OF_double 0\n#define %s_OF_float 1\n#if %s_PASTE(%s_OF_, %s)\n",
              p, p, p, p, p, p, p, real);
    for (int i = 0; i < m->part_count; i++)
        if (m->parts[i].section == DECLARATIONS && strcmp(m->parts[i].path, m->names_file) != 0) {
            text copy = {NULL, 0, 0};
            text_append(&copy, m->parts[i].content.data, m->parts[i].content.size);
            blank_comments(copy.data);
            add_names(&names, copy.data, m->names_api);
            free(copy.data);
        }
    add_lines(&names, "#endif\n#endif\n\n#endif /* %s_H */\n", p);
    return names;
}

/* ---- the header ---- */

/* The string of `#define MACRO "..."`. */
static void find_version(const manifest *m, char *version)
{
    char pattern[MAX_NAME + 16];
    int part_index = find_part(m, m->version_file);
    const char *at, *end;
    snprintf(pattern, sizeof pattern, "#define %s \"", m->version_macro);
    at = part_index < 0 ? NULL : strstr(m->parts[part_index].content.data, pattern);
    end = at ? strchr(at + strlen(pattern), '"') : NULL;
    if (!end)
        fail("%s: no %s...\"", m->version_file, pattern);
    at += strlen(pattern);
    snprintf(version, MAX_NAME, "%.*s", (int)(end - at), at);
}

/* path = folder of `from` + name, with each "FOLDER/../" taken out. */
static void resolve_include(char *path, const char *from, const char *name, size_t length)
{
    const char *slash = strrchr(from, '/');
    char *up;
    if (snprintf(path, MAX_NAME, "%.*s%.*s", slash ? (int)(slash - from) + 1 : 0, from, (int)length, name) >= MAX_NAME)
        fail("name too long: %s", name);
    while ((up = strstr(path, "/../")) != NULL) {
        char *start = up;
        while (start > path && start[-1] != '/')
            start--;
        memmove(start, up + 4, strlen(up + 4) + 1);
    }
}

static int has_switch(const part *p, const char *name)
{
    for (int i = 0; i < MAX_SWITCHES; i++)
        if (strcmp(p->switches[i], name) == 0)
            return 1;
    return 0;
}

/* A local #include must name a part above this one, in a folder that this one's may include, or a part of the required
 * header that is not private to it; then it may go. */
static void check_include(const manifest *m, int part_index, const char *name, size_t length, int line)
{
    static const char private_end[] = "_private.h";
    const part *p = &m->parts[part_index];
    char path[MAX_NAME];
    int found;
    resolve_include(path, p->path, name, length);
    if (*m->required && strncmp(path, m->folder, strlen(m->folder)) != 0) { /* a room of the required header */
        if (strlen(path) >= strlen(private_end) && strcmp(path + strlen(path) - strlen(private_end), private_end) == 0)
            fail("%s:%d: includes %.*s, which is private to %s", p->path, line, (int)length, name, m->required);
        return;
    }
    found = find_part(m, path);
    if (found < 0)
        fail("%s:%d: includes %.*s, which is no part", p->path, line, (int)length, name);
    if (found >= part_index)
        fail("%s:%d: includes %.*s, which stands lower in %s", p->path, line, (int)length, name, m->path);
    if (p->folder >= 0 && m->parts[found].folder >= 0 && !m->folders[p->folder].may_include[m->parts[found].folder])
        fail("%s:%d: includes %.*s, but %s may not call %s", p->path, line, (int)length, name,
             m->folders[p->folder].name, m->folders[m->parts[found].folder].name);
    for (int i = 0; i < MAX_SWITCHES && *m->parts[found].switches[i]; i++)
        if (!has_switch(p, m->parts[found].switches[i]))
            fail("%s:%d: includes %.*s, which %s leaves out", p->path, line, (int)length, name,
                 m->parts[found].switches[i]);
}

/* The name inside #include "name", or NULL when the line is no such line. */
static const char *local_include(const char *line)
{
    line += strspn(line, " \t");
    if (*line++ != '#')
        return NULL;
    line += strspn(line, " \t");
    if (strncmp(line, "include", 7) != 0)
        return NULL;
    line += 7 + strspn(line + 7, " \t");
    return *line == '"' ? line + 1 : NULL;
}

/* Whether the line after this one starts inside a comment, given that for this line. */
static int comment_goes_on(const char *line, int inside)
{
    for (const char *c = line; *c != '\n'; c++) {
        if (inside) {
            if (c[0] == '*' && c[1] == '/') {
                inside = 0;
                c++;
            }
        } else if (c[0] == '/' && c[1] == '*') {
            inside = 1;
            c++;
        } else if (c[0] == '/' && c[1] == '/') {
            return 0;
        } else if (*c == '"' || *c == '\'') {
            char quote = *c;
            for (c++; *c != quote && *c != '\n'; c++)
                if (*c == '\\' && c[1] != '\n')
                    c++;
            if (*c == '\n')
                return 0;
        }
    }
    return inside;
}

/* Whether the line opens what is for the library alone. */
static int opens_internal(const manifest *m, const char *line, size_t length)
{
    char wanted[3 * MAX_NAME];
    int size = snprintf(wanted, sizeof wanted, "#if defined(%s) || defined(%s)", m->user_switch, m->internal);
    return *m->internal && (size_t)size == length && strncmp(line, wanted, length) == 0;
}

/* How many conditions more (1) or less (-1) are open after the line. */
static int condition_change(const char *line)
{
    line += strspn(line, " \t");
    if (*line++ != '#')
        return 0;
    line += strspn(line, " \t");
    return strncmp(line, "if", 2) == 0 ? 1 : strncmp(line, "endif", 5) == 0 ? -1 : 0;
}

/* Opens (or closes) the condition that a part stands in, if it has one. */
static void add_condition(text *to, const part *p, int opens)
{
    for (int i = 0; i < MAX_SWITCHES && *p->switches[i]; i++)
        add_lines(to, "%s!defined(%s)", i > 0 ? " && " : opens ? "#if " : "#endif /* ", p->switches[i]);
    if (*p->switches[0])
        text_add(to, opens ? "\n" : " */\n");
}

/* Copies a part; of declarations that have an inside, the lines outside it to `to` and the others to `internal`. */
static void add_part_text(text *to, text *internal, const manifest *m, int part_index)
{
    const part *p = &m->parts[part_index];
    int line = 0, in_comment = 0, depth = 0; /* conditions open since an internal one */
    add_lines(to, "\n/* ==== %s ==== */\n", p->path);
    add_condition(to, p, 1);
    for (const char *start = p->content.data, *end; *start; start = end + 1) {
        const char *name = in_comment ? NULL : local_include(start);
        int change = in_comment ? 0 : condition_change(start);
        in_comment = comment_goes_on(start, in_comment);
        end = strchr(start, '\n');
        line++;
        if (name)
            check_include(m, part_index, name, strcspn(name, "\"\n"), line);
        else if (depth > 0) {
            depth += change;
            if (depth > 0)
                text_append(internal, start, (size_t)(end - start) + 1);
            else
                add_condition(internal, p, 0);
        } else if (p->section == DECLARATIONS && opens_internal(m, start, (size_t)(end - start))) {
            depth = 1;
            add_lines(internal, "\n/* ==== %s, internal ==== */\n", p->path);
            add_condition(internal, p, 1);
        } else
            text_append(to, start, (size_t)(end - start) + 1);
    }
    add_condition(to, p, 0);
}

static void add_section(text *to, text *internal, const manifest *m, int section)
{
    for (int i = 0; i < m->part_count; i++)
        if (m->parts[i].section == section)
            add_part_text(to, internal, m, i);
}

static void add_licence(text *to, const manifest *m)
{
    text licence = read_file(m->licence);
    if (strstr(licence.data, "*/"))
        fail("%s: holds the end of a comment", m->licence);
    add_lines(to, "\n/*\n");
    text_append(to, licence.data, licence.size);
    add_lines(to, "*/\n");
    free(licence.data);
}

static text make_header(const manifest *m)
{
    text header = {NULL, 0, 0}, internal = {NULL, 0, 0};
    char version[MAX_NAME];
    text_add(&internal, "");
    find_version(m, version);
    add_lines(&header,
              "/* %s %s: %s\n * MIT or public domain, as you like; the texts are at the end of this file.\n"
              " * Generated from %s: edit there, then run `make headers`. */\n",
              m->output, version, m->title, m->folder);
    if (*m->required) /* outside the guards: its implementation may be asked for later than its declarations */
        add_lines(&header, "#include \"%s\"\n", m->required);
    add_section(&header, &internal, m, TOP);
    add_lines(&header, "\n#ifndef %s\n#define %s\n", m->guard, m->guard);
    add_section(&header, &internal, m, DECLARATIONS);
    add_lines(&header, "\n#endif /* %s */\n\n#if defined(%s) && !defined(%s_DONE)\n#define %s_DONE\n", m->guard,
              m->user_switch, m->user_switch, m->user_switch);
    text_append(&header, internal.data, internal.size);
    add_section(&header, &internal, m, IMPLEMENTATION);
    add_lines(&header, "\n#endif /* %s */\n", m->user_switch);
    add_section(&header, &internal, m, BOTTOM);
    add_licence(&header, m);
    free(internal.data);
    return header;
}

int main(int argc, char **argv)
{
    static part parts[MAX_PARTS];
    static manifest m;
    text names = {NULL, 0, 0}, header;
    int names_part;
    if (argc < 2)
        fail("usage: amalgamate MANIFEST [FILE...]");
    m.parts = parts;
    read_manifest(&m, argv[1]);
    check_folder(&m, argv + 2, argc - 2);
    names_part = *m.names_file ? find_part(&m, m.names_file) : -1;
    for (int i = 0; i < m.part_count; i++)
        if (i != names_part)
            m.parts[i].content = read_file(m.parts[i].path);
    if (names_part >= 0) {
        names = make_names(&m);
        m.parts[names_part].content = names;
    }
    header = make_header(&m);
    if (names_part >= 0)
        write_file(m.names_file, &names);
    write_file(m.output, &header);
    for (int i = 0; i < m.part_count; i++)
        free(m.parts[i].content.data);
    free(header.data);
    return 0;
}
