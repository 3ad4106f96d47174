/* options.h: command lines of the examples: a table of options gives parsing, checking and the help text.
 *
 *     option options[] = {
 *         {"-o", "FILE", OPTION_TEXT, NULL, NULL, &out, 0, 0, "where the picture goes"},
 *         {"--steps", "N", OPTION_INTEGER, &steps, NULL, NULL, 1, 1e6, "number of steps"},
 *         {"--help", NULL, OPTION_FLAG, &help, NULL, NULL, 0, 0, "this text"},
 *     };
 *     if (!options_parse("program", options, 3, &file, 1, argc, argv))
 *         return 2;
 *
 * The values that the variables have before are the defaults. */
#ifndef OPTIONS_H
#define OPTIONS_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum option_kind { OPTION_FLAG = 0, OPTION_INTEGER = 1, OPTION_NUMBER = 2, OPTION_TEXT = 3 } option_kind;

typedef struct option {
    const char *name, *value_name;
    option_kind kind;
    int *flag_or_integer;
    double *number;
    const char **text;
    double low, high; /* range of an integer or number */
    const char *help; /* NULL: not listed */
} option;

/* Lists the options with their defaults. */
static inline void options_print(const option *options, int count)
{
    for (int i = 0; i < count; i++) {
        const option *o = options + i;
        if (!o->help)
            continue;
        printf("  %-10s %-5s %s", o->name, o->value_name ? o->value_name : "", o->help);
        if (o->kind == OPTION_INTEGER && *o->flag_or_integer > 0)
            printf("; default %d", *o->flag_or_integer);
        if (o->kind == OPTION_NUMBER)
            printf("; default %.4g", *o->number);
        if (o->kind == OPTION_TEXT && *o->text)
            printf("; default %s", *o->text);
        printf("\n");
    }
}

/* Says what is wrong with the command line; returns 0. */
static inline int options_complain(const char *program, const char *about, const char *what)
{
    fprintf(stderr, "%s: %s %s; %s --help lists the options\n", program, about, what, program);
    return 0;
}

/* Stores the value of an option; 0 (with a message) when it is missing or out of range. */
static inline int options_store(const char *program, const option *o, const char *text)
{
    char range[96], *end;
    double value;
    if (o->kind == OPTION_FLAG) {
        *o->flag_or_integer = 1;
        return 1;
    }
    if (!text)
        return options_complain(program, o->name, "needs a value");
    if (o->kind == OPTION_TEXT) {
        *o->text = text;
        return 1;
    }
    value = strtod(text, &end);
    if (end == text || *end || !(value >= o->low && value <= o->high) ||
        (o->kind == OPTION_INTEGER && value != floor(value))) {
        snprintf(range, sizeof range, "needs %s from %g to %g",
                 o->kind == OPTION_INTEGER ? "a whole number" : "a number", o->low, o->high);
        return options_complain(program, o->name, range);
    }
    if (o->kind == OPTION_INTEGER)
        *o->flag_or_integer = (int)value;
    else
        *o->number = value;
    return 1;
}

/* Reads the command line: options, and at most `file_count` other words into files[], which are NULL before.
 * Returns 1, or 0 with a message printed. */
static inline int options_parse(const char *program, const option *options, int count, const char **files,
                                int file_count, int argc, char **argv)
{
    int used = 0;
    for (int i = 1; i < argc; i++) {
        int k = 0;
        while (k < count && strcmp(argv[i], options[k].name) != 0)
            k++;
        if (k == count && argv[i][0] == '-' && argv[i][1])
            return options_complain(program, argv[i], "is no option");
        if (k == count && used == file_count)
            return options_complain(program, argv[i], file_count == 1 ? "is a second file" : "is one word too many");
        if (k == count) {
            files[used++] = argv[i];
            continue;
        }
        if (!options_store(program, options + k, i + 1 < argc ? argv[i + 1] : NULL))
            return 0;
        i += options[k].kind != OPTION_FLAG;
    }
    return 1;
}

#endif /* OPTIONS_H */
