/* verification.h: rows of tests/verification.md, the table of what is known to be right and how well.
 *
 * A test calls verify() once for each case; the last test of a suite calls verify_table(), which compares the
 * rows with the committed file (`make verification` writes it). Errors are rounded there to one digit, and to
 * nothing below 1e-9, so that the file is the same whatever compiler built the tests. Each suite is a section
 * of its own. */
#ifndef VERIFICATION_H
#define VERIFICATION_H

#include "scene.h"

enum { VERIFY_MOST_ROWS = 400, VERIFY_LINE = 512 };

typedef struct verify_row {
    char text[VERIFY_LINE];    /* case, element and material, source, quantity: what the file must agree with */
    char numbers[VERIFY_LINE]; /* expected, computed, error today */
    char bound[96];
} verify_row;

/* The rows of this suite, which is one file. */
static verify_row verify_rows[VERIFY_MOST_ROWS];
static int verify_row_count;

/* 0 for what is rounding of a quantity of size `scale`. */
static inline void verify_print(char *text, size_t size, int digits, double value, double scale)
{
    snprintf(text, size, "%.*g", digits, fabs(value) < 1e-9 * scale ? 0.0 : value);
}

/* Adds the row of a case. */
static inline void verify_add_row(const char *name, const char *what, const char *source, const char *quantity,
                                  double expected, double computed, const char *bound)
{
    double scale = expected != 0 ? fabs(expected) : 1, error = fabs(computed - expected) / scale;
    char wanted[32], found[32], rounded[32];
    if (!CHECK(verify_row_count < VERIFY_MOST_ROWS))
        return;
    verify_row *row = verify_rows + verify_row_count++;
    verify_print(wanted, sizeof wanted, 6, expected, scale);
    /* a value that is right to rounding reads as the expected one; others show less than compilers agree
     * on */
    verify_print(found, sizeof found, error < 1e-9 ? 6 : 5, error < 1e-9 ? expected : computed, scale);
    snprintf(rounded, sizeof rounded, "%.0e", error);
    snprintf(row->text, sizeof row->text, "| %s | %s | %s | %s |", name, what, source, quantity);
    snprintf(row->numbers, sizeof row->numbers, " %s | %s | %s |", wanted, found, error < 1e-9 ? "< 1e-9" : rounded);
    snprintf(row->bound, sizeof row->bound, " %s |", bound);
}

/* Records the case `name` for `what` (element, material) and checks |computed - expected| <= bound
 * |expected|, or <= bound when expected is 0: such a quantity is one relative to a size of its own. A float
 * build gets 3e4 of its epsilons on top, which in double is nothing (7e-12).
 * A negative bound is minus the error on record of an element that is too stiff in this case: the error has to
 * be within a quarter of it, so that neither a stiffer answer nor a cure passes unseen. */
static inline int verify(const char *name, const char *what, const char *source, const char *quantity, double expected,
                         double computed, double bound)
{
    double scale = expected != 0 ? fabs(expected) : 1, error = fabs(computed - expected) / scale;
    double least = bound < 0 ? -0.75 * bound : 0, most = bound < 0 ? -1.25 * bound : bound;
    int ok = error >= least && error <= most + 3e4 * (double)SB_EPSILON;
    char text[80];
    if (!ok) {
        check.failures++;
        printf("[%s] %s, %s: %s is %.9g, expected %.9g; error %.2e, bounds %.2g and %.2g\n", check.test, name, what,
               quantity, computed, expected, error, least, most);
    }
    if (bound < 0)
        snprintf(text, sizeof text, "too stiff: %.2g to %.2g", least, most);
    else
        snprintf(text, sizeof text, "%.2g", most);
    verify_add_row(name, what, source, quantity, expected, computed, text);
    return ok;
}

/* The larger of two errors; a NaN wins and stays, which fmax would hide. */
static inline double verify_worse(double worst, double error)
{
    return worst != worst || error <= worst ? worst : error;
}

/* Writes this suite's section into the folder `folder`. */
static inline void verify_write(const char *folder, const char *suite)
{
    char path[512];
    snprintf(path, sizeof path, "%s/%s.md", folder, suite);
    FILE *file = fopen(path, "wb");
    if (!CHECK(file != NULL))
        return;
    fprintf(file,
            "\n## %s\n\n| case | element, material | source | quantity | expected | computed | error today | "
            "bound |\n|---|---|---|---|---|---|---|---|\n",
            suite);
    for (int i = 0; i < verify_row_count; i++)
        fprintf(file, "%s%s%s\n", verify_rows[i].text, verify_rows[i].numbers, verify_rows[i].bound);
    CHECK(fclose(file) == 0);
}

/* 1 when a line of the file is row `row` of this suite; numbers may differ. */
static inline int verify_row_is(int row, const char *line)
{
    size_t length = strcspn(line, "\r\n"), head, tail;
    if (row >= verify_row_count)
        return 0;
    head = strlen(verify_rows[row].text);
    tail = strlen(verify_rows[row].bound);
    return length > head + tail && strncmp(line, verify_rows[row].text, head) == 0 &&
           strncmp(line + length - tail, verify_rows[row].bound, tail) == 0;
}

/* Last test of a suite: the file's section lists the very cases that ran, in their order and with their
 * bounds. In float, where some cases are skipped, there is nothing to compare. */
static inline void verify_table(const char *suite)
{
    const char *folder = getenv("VERIFICATION");
    char line[VERIFY_LINE * 2], heading[80];
    FILE *file;
    int row = 0, inside = 0, same = 1;
    if (SB_REAL_IS_FLOAT || folder) {
        if (folder)
            verify_write(folder, suite);
        return;
    }
    file = fopen("tests/verification.md", "rb");
    if (!CHECK(file != NULL))
        return;
    snprintf(heading, sizeof heading, "## %s", suite);
    while (fgets(line, (int)sizeof line, file)) {
        if (line[0] == '#')
            inside = strncmp(line, heading, strlen(heading)) == 0 && strchr("\r\n", line[strlen(heading)]) != NULL;
        if (!inside || line[0] != '|' || line[1] == '-' || strncmp(line, "| case |", 8) == 0)
            continue;
        if (same && !verify_row_is(row, line)) {
            printf("tests/verification.md has the row\n    %sand the tests\n    %s...%s\n", line,
                   row < verify_row_count ? verify_rows[row].text : "(none)",
                   row < verify_row_count ? verify_rows[row].bound : "");
            same = 0;
        }
        row++;
    }
    fclose(file);
    if (!CHECK_INT(row, verify_row_count) || !CHECK(same))
        printf("tests/verification.md is out of date (or a part of %s was left out): make verification\n", suite);
}

#endif /* VERIFICATION_H */
