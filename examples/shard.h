/* shard.h: studies of many cases, dealt out to processes that may be killed and run again.
 *
 *     shard s;
 *     if (!shard_parse("program", "3/8", &s) || !shard_open("program", &s, "part_3.csv", heading, cases))
 *         return 2;
 *     for (int k = 0; k < cases; k++)
 *         if (shard_is_mine(&s, k) && !shard_write(&s, row))
 *             return 2;
 *     shard_close(&s);
 *
 * Cases are numbered from 0; shard I of N, from 1 to N, does those with k % N = I - 1. Its file has the heading, lines
 * that all shards of a study have in common, then a line for each case that begins with its number and a comma, in the
 * order they were done. What a file holds already is not done again; a line that was cut off is. A study's rows must
 * say nothing of time or place: then the file of shard 1/1 and what study/merge.sh makes of any number of shards have
 * the same bytes. */
#ifndef SHARD_H
#define SHARD_H

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct shard {
    int index, count; /* index: from 0 */
    const char *program, *path;
    FILE *file;
    int cases, left;     /* left: of this shard, not done yet */
    unsigned char *done; /* [cases] */
} shard;

static inline int shard_complain(const shard *s, const char *about, const char *what)
{
    fprintf(stderr, "%s: %s: %s\n", s->program, about, what);
    return 0;
}

/* Reads I/N; 0 (with a message) when it is anything else. */
static inline int shard_parse(const char *program, const char *text, shard *s)
{
    char *end = NULL;
    long index = strtol(text, &end, 10), count = 0;
    memset(s, 0, sizeof *s);
    s->program = program;
    if (end != text && *end == '/' && end[1] >= '0' && end[1] <= '9')
        count = strtol(end + 1, &end, 10);
    if (!end || *end || count < 1 || count > INT_MAX || index < 1 || index > count)
        return shard_complain(s, "--shard", "needs I/N with 1 <= I <= N, like 3/8");
    s->index = (int)index - 1;
    s->count = (int)count;
    return 1;
}

static inline void shard_close(shard *s)
{
    if (s->file)
        fclose(s->file);
    free(s->done);
    s->file = NULL;
    s->done = NULL;
}

/* 1 when the case is this shard's, and is not done yet. */
static inline int shard_is_mine(const shard *s, int k) { return k % s->count == s->index && !s->done[k]; }

/* The file, *used bytes and a 0, as a string of the caller; NULL when there is none, or (with a message, *bad = 1) it
 * cannot be read. */
static inline char *shard_read(const shard *s, size_t *used, int *bad)
{
    FILE *file = fopen(s->path, "rb");
    char *text = NULL, *larger;
    size_t got = 1;
    *used = 0;
    *bad = 0;
    while (file && got) {
        larger = (char *)realloc(text, *used + 65537);
        if (!larger) {
            *bad = 1;
            break;
        }
        text = larger;
        got = fread(text + *used, 1, 65536, file);
        *used += got;
        text[*used] = 0;
    }
    *bad = *bad || (file && ferror(file));
    if (file)
        fclose(file);
    if (!*bad)
        return text;
    shard_complain(s, s->path, "cannot be read");
    free(text);
    return NULL;
}

/* Marks the cases of the lines in `rows`; returns where the last whole line ends, or NULL with a message. */
static inline const char *shard_mark(shard *s, const char *rows)
{
    const char *end;
    for (; (end = strchr(rows, '\n')) != NULL; rows = end + 1) {
        char *behind;
        long k = strtol(rows, &behind, 10);
        if (behind == rows || *behind != ',' || k < 0 || k >= s->cases || !shard_is_mine(s, (int)k)) {
            shard_complain(s, s->path, "has a line that is not of this shard");
            return NULL;
        }
        s->done[k] = 1;
        s->left--;
    }
    return rows;
}

/* Writes `length` bytes of the text into a new file; 0 when they did not all arrive. */
static inline int shard_write_file(const char *path, const char *text, size_t length)
{
    FILE *file = fopen(path, "wb");
    int good = file && fwrite(text, 1, length, file) == length;
    return file && fclose(file) == 0 && good;
}

/* Puts the first `length` bytes of the text in the place of the file, at once: rows that are done are never at risk. */
static inline int shard_replace_file(const shard *s, const char *text, size_t length)
{
    size_t size = strlen(s->path) + 5;
    char *name = (char *)malloc(size);
    int good = name != NULL;
    if (good) {
        snprintf(name, size, "%s.new", s->path);
        good = shard_write_file(name, text, length);
#if defined(_WIN32)
        if (good)
            remove(s->path); /* rename replaces no file there */
#endif
        good = good && rename(name, s->path) == 0;
    }
    free(name);
    return good;
}

/* heading: whole lines. Returns 1, or 0 with a message: the file is of another study, or cannot be written. */
static inline int shard_open(shard *s, const char *path, const char *heading, int cases)
{
    size_t length = strlen(heading), used = 0;
    const char *end = NULL;
    char *text;
    int bad = 0, good = 1;
    s->path = path;
    s->cases = cases;
    s->left = cases > s->index ? (cases - s->index + s->count - 1) / s->count : 0;
    s->done = (unsigned char *)calloc((size_t)cases + 1, 1);
    if (!s->done)
        return shard_complain(s, path, "not enough memory");
    text = shard_read(s, &used, &bad);
    if (bad)
        return 0;
    if (used >= length && memcmp(text, heading, length) == 0) {
        end = shard_mark(s, text + length);
        if (end && end != text + used) /* a line was cut off */
            good = shard_replace_file(s, text, (size_t)(end - text));
    } else if (used > 0 && (used > length || memcmp(text, heading, used) != 0)) {
        shard_complain(s, path, "is of another study");
    } else { /* there is none, or its heading was cut off */
        end = heading;
        good = shard_write_file(path, heading, length);
    }
    free(text);
    if (end && good)
        s->file = fopen(path, "ab");
    return s->file ? 1 : end ? shard_complain(s, path, "cannot be written") : 0;
}

/* Adds the row of a case, which ends with a line's end; 0 (with a message) when it did not arrive. */
static inline int shard_write(shard *s, const char *row)
{
    size_t length = strlen(row);
    if (fwrite(row, 1, length, s->file) != length || fflush(s->file) != 0)
        return shard_complain(s, s->path, "cannot be written; is the disk full?");
    s->done[atoi(row)] = 1;
    s->left--;
    return 1;
}

#endif /* SHARD_H */
