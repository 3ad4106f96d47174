/* rows.h: text files of numbers, a row on each line; what follows # is left out. For programs that include options.h,
 * and complain in words that name file and line. */
#ifndef ROWS_H
#define ROWS_H

#include <errno.h>

enum { ROWS_COLUMNS = 6 };

typedef struct row {
    int line, count;
    double values[ROWS_COLUMNS];
} row;

typedef struct rows {
    row *items; /* [count], to be freed */
    int count, room;
} rows;

/* 1: a row, 0: an empty line, -1: not numbers, or too many. */
static inline int rows_parse(const char *text, row *out)
{
    out->count = 0;
    for (;;) {
        char *end;
        double value;
        while (*text == ' ' || *text == '\t' || *text == ',' || *text == '\r' || *text == '\n')
            text++;
        if (!*text || *text == '#')
            return out->count > 0;
        value = strtod(text, &end);
        if (end == text || out->count == ROWS_COLUMNS || !(value - value == 0))
            return -1;
        out->values[out->count++] = value;
        text = end;
    }
}

static inline int rows_add(rows *table, const row *item)
{
    if (table->count == table->room) {
        int room = table->room ? 2 * table->room : 64;
        row *grown = (row *)realloc(table->items, (size_t)room * sizeof *grown);
        if (!grown)
            return 0;
        table->items = grown;
        table->room = room;
    }
    table->items[table->count++] = *item;
    return 1;
}

/* 2, after saying what is wrong with a file, or with a line of it (> 0). */
static inline int rows_complain(const char *program, const char *path, int line, const char *message)
{
    progress_end();
    if (line > 0)
        fprintf(stderr, "%s: %s:%d: %s\n", program, path, line, message);
    else
        fprintf(stderr, "%s: %s: %s\n", program, path, message);
    return 2;
}

/* Rows of as many numbers as `columns` has bits for: bit k for k numbers. `form` says it in words. 0, 2: not such a
 * file, 3: no memory, both said. */
static inline int rows_read(const char *program, const char *path, unsigned columns, const char *form, rows *table)
{
    char text[512];
    FILE *file = fopen(path, "r");
    int status = 0;
    row item;
    memset(table, 0, sizeof *table);
    if (!file)
        return rows_complain(program, path, 0, strerror(errno));
    for (int line = 1; !status && fgets(text, sizeof text, file); line++) {
        const char *start = line == 1 && strncmp(text, "\xEF\xBB\xBF", 3) == 0 ? text + 3 : text; /* UTF-8's mark */
        int kind = strchr(text, '\n') || feof(file) ? rows_parse(start, &item) : -1; /* cut: too long, or a NUL byte */
        item.line = line;
        if (kind < 0 || (kind > 0 && !(columns >> item.count & 1u)))
            status = rows_complain(program, path, line, form);
        else if (kind > 0 && !rows_add(table, &item)) {
            progress_end();
            fprintf(stderr, "%s: not enough memory\n", program);
            status = 3;
        }
    }
    fclose(file);
    if (!status && table->count == 0)
        status = rows_complain(program, path, 0, "has no lines");
    return status;
}

#endif /* ROWS_H */
