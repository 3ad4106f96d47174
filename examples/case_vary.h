/* case_vary.h: a case with values of a table in the place of names, for studies of parameters.
 *
 *     young, nu                      a table: names, then a case in each line, commas between
 *     5000, 0.45                     material corotated E=$young nu=${nu} density=1000
 *     8000, 0.49
 *
 *     case_vary v;
 *     if (!case_vary_read(&v, "table.csv"))
 *         fprintf(stderr, "%s\n", v.message);
 *     ok = case_vary_open(&file, "organ.case", &v, row);      as case_read, with the values of this row
 *     case_vary_free(&v);
 *
 * Names are of letters, digits and _, not beginning with a digit. Values are any words without commas. */
#ifndef CASE_VARY_H
#define CASE_VARY_H

#include "case_reader.h"

typedef struct case_vary {
    char *text; /* of the table, cut into words */
    char **words;
    int word_count, word_capacity;
    int column_count;        /* words: [1 + row_count][column_count], names first */
    int row_count;           /* cases */
    unsigned long long hash; /* of the table */
    char message[512];       /* what is wrong, with file and line */
} case_vary;

static inline void case_vary_free(case_vary *v)
{
    free(v->text);
    free(v->words);
    memset(v, 0, sizeof *v);
}

/* FNV-1a of 64 bits. */
static inline unsigned long long case_vary_hash(const char *text)
{
    unsigned long long hash = 0xcbf29ce484222325ull;
    for (; *text; text++)
        hash = (hash ^ (unsigned char)*text) * 0x100000001b3ull;
    return hash;
}

static inline int case_vary_fail(case_vary *v, const char *path, int line, const char *what, const char *word)
{
    snprintf(v->message, sizeof v->message, "%.200s:%d: %s%s%.100s", path, line, what, word ? " " : "",
             word ? word : "");
    return 0;
}

static inline const char *case_vary_word(const case_vary *v, int row, int column)
{
    return v->words[(size_t)row * (size_t)v->column_count + (size_t)column];
}

/* How long the name is that a text begins with; 0: none. */
static inline size_t case_vary_name_length(const char *text)
{
    static const char letters[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789";
    return *text >= '0' && *text <= '9' ? 0 : strspn(text, letters);
}

/* The words between the commas of a line, without the blanks about them; how many, or -1 with a message. */
static inline int case_vary_split(case_vary *v, const char *path, int number, char *line)
{
    int count = 0;
    for (char *next = line; next; count++) {
        void *words = v->words;
        char *word = next + strspn(next, " \t\r");
        size_t length;
        next = strchr(word, ',');
        if (next)
            *next++ = 0;
        for (length = strlen(word); length > 0 && strchr(" \t\r", word[length - 1]); length--)
            ;
        word[length] = 0;
        if (!length || strpbrk(word, " \t")) {
            case_vary_fail(v, path, number, length ? "needs a comma between the words of" : "has an empty place",
                           length ? word : NULL);
            return -1;
        }
        if (!case_reserve(&words, v->word_count, &v->word_capacity, sizeof *v->words)) {
            case_vary_fail(v, path, number, "out of memory", NULL);
            return -1;
        }
        v->words = (char **)words;
        v->words[v->word_count++] = word;
    }
    return count;
}

static inline int case_vary_check_names(case_vary *v, const char *path, int line)
{
    for (int i = 0; i < v->column_count; i++) {
        if (case_vary_name_length(v->words[i]) != strlen(v->words[i]))
            return case_vary_fail(v, path, line, "is no name (letters, digits, _):", v->words[i]);
        for (int k = 0; k < i; k++)
            if (strcmp(v->words[i], v->words[k]) == 0)
                return case_vary_fail(v, path, line, "is named twice:", v->words[i]);
    }
    return 1;
}

/* Reads a table. Returns 1, or 0 with v->message; release it in either case. */
static inline int case_vary_read(case_vary *v, const char *path)
{
    const char *reason;
    char *cursor, *line;
    int number = 0, count;
    memset(v, 0, sizeof *v);
    v->text = case_read_text(path, &reason);
    if (!v->text)
        return case_vary_fail(v, path, 1, reason, NULL);
    v->hash = case_vary_hash(v->text);
    cursor = v->text;
    while ((line = case_next_line(&cursor)) != NULL) {
        number++;
        if (line[strspn(line, " \t\r")] == 0)
            continue;
        count = case_vary_split(v, path, number, line);
        if (count < 0)
            return 0;
        if (!v->column_count) {
            v->column_count = count;
            if (!case_vary_check_names(v, path, number))
                return 0;
        } else if (count != v->column_count) {
            return case_vary_fail(v, path, number, "has another number of words than there are names", NULL);
        } else {
            v->row_count++;
        }
    }
    return v->row_count > 0 ||
           case_vary_fail(v, path, number, "has no case: names, then a line of values for each", NULL);
}

/* ---- the case ---------------------------------------------------------------------------------------------------- */

/* The value that `name` has in this row; NULL: the table does not name it. */
static inline const char *case_vary_value(const case_vary *v, int row, const char *name, size_t length)
{
    for (int i = 0; i < v->column_count; i++)
        if (strlen(v->words[i]) == length && strncmp(v->words[i], name, length) == 0)
            return case_vary_word(v, row + 1, i);
    return NULL;
}

/* The name at a $, with or without braces. Returns where it ends; *length 0: there is none. */
static inline const char *case_vary_next_name(const char *at, const char **name, size_t *length)
{
    const int braces = at[1] == '{';
    *name = at + 1 + braces;
    *length = case_vary_name_length(*name);
    if (braces && (*name)[*length] != '}')
        *length = 0;
    return *name + *length + braces;
}

/* Puts the values into c->text. Comments stay as they are. */
static inline int case_vary_fill(case_file *c, const case_vary *v, int row)
{
    size_t used = 0, longest = 0, size;
    int line = 1, is_comment = 0, names = 0;
    char *filled;
    for (const char *at = c->text; *at; at++)
        names += *at == '$';
    for (int i = 0; i < v->column_count; i++)
        longest = strlen(case_vary_word(v, row + 1, i)) > longest ? strlen(case_vary_word(v, row + 1, i)) : longest;
    size = strlen(c->text) + (size_t)names * longest + 1;
    filled = (char *)malloc(size);
    if (!filled)
        return case_fail_memory(c, 0);
    for (const char *at = c->text; *at;) {
        const char *name, *value, *end;
        size_t length;
        is_comment = *at == '#' || (is_comment && *at != '\n');
        line += *at == '\n';
        if (*at != '$' || is_comment) {
            filled[used++] = *at++;
            continue;
        }
        end = case_vary_next_name(at, &name, &length);
        value = length ? case_vary_value(v, row, name, length) : NULL;
        if (!value) {
            free(filled);
            return length ? case_fail(c, line, "the table does not name $%.*s", (int)length, name)
                          : case_fail(c, line, "$ needs a name: $NAME or ${NAME}");
        }
        memcpy(filled + used, value, strlen(value));
        used += strlen(value);
        at = end;
    }
    filled[used] = 0;
    free(c->text);
    c->text = filled;
    return 1;
}

/* case_read with the values of a row, counted from 0. */
static inline int case_vary_open(case_file *c, const char *path, const case_vary *v, int row)
{
    return case_start(c, path) && case_vary_fill(c, v, row) && case_read_started(c);
}

#endif /* CASE_VARY_H */
