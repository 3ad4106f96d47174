/* system.h: what the operating system lends the examples: wall time, folders, and a progress bar on stderr.
 *
 * Include it first: it asks for POSIX functions, which must happen before any system header comes in. */
#ifndef SYSTEM_H
#define SYSTEM_H

#if !defined(_WIN32) && !defined(_POSIX_C_SOURCE)
#define _POSIX_C_SOURCE 200809L /* clock_gettime, mkdir, isatty */
#endif
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#if defined(_WIN32)
#include <direct.h>
#include <io.h>
#include <sys/timeb.h>
#else
#include <unistd.h>
#endif

/* Wall time (s) since some fixed moment. */
static inline double seconds_now(void)
{
#if defined(_WIN32)
    return (double)clock() / CLOCKS_PER_SEC; /* wall time there */
#else
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
#endif
}

/* Time of the calendar: s since 1970. */
static inline double calendar_now(void)
{
#if defined(_WIN32)
    struct __timeb64 now;
    _ftime64_s(&now);
    return (double)now.time + 1e-3 * now.millitm;
#else
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
#endif
}

/* Whether stderr is a terminal, where a line can be written anew. */
static inline int is_terminal(void)
{
#if defined(_WIN32)
    return _isatty(2);
#else
    return isatty(2);
#endif
}

/* 1 when the folder is there afterwards. */
static inline int make_folder(const char *path)
{
#if defined(_WIN32)
    return _mkdir(path) == 0 || errno == EEXIST;
#else
    return mkdir(path, 0777) == 0 || errno == EEXIST;
#endif
}

/* 1 when two names stand for one file that exists. */
static inline int is_same_file(const char *a, const char *b)
{
#if defined(_WIN32)
    char full_a[_MAX_PATH], full_b[_MAX_PATH];
    return _fullpath(full_a, a, _MAX_PATH) && _fullpath(full_b, b, _MAX_PATH) && _stricmp(full_a, full_b) == 0;
#else
    struct stat of_a, of_b;
    return stat(a, &of_a) == 0 && stat(b, &of_b) == 0 && of_a.st_dev == of_b.st_dev && of_a.st_ino == of_b.st_ino;
#endif
}

/* A bar for `done` in [0, 1] of the work, and a few words on it: stays on its line in a terminal, nothing elsewhere. */
static inline void progress_show(double done, const char *words)
{
    const int length = 32;
    static const char full[] = "################################";
    static const char empty[] = "................................";
    int marks = (int)(length * (done < 0 ? 0 : done > 1 ? 1 : done));
    if (is_terminal())
        fprintf(stderr, "\r[%.*s%.*s] %-44.60s", marks, full, length - marks, empty, words);
}

/* Wipes the bar away. */
static inline void progress_end(void)
{
    if (is_terminal())
        fprintf(stderr, "\r%80s\r", "");
}

/* The exit status of a program that is done, by `status` so far: `failed` when what it printed did not all arrive, on a
 * full disk behind stdout say. */
static inline int finish(const char *program, int status, int failed)
{
    int bad = fflush(stdout) != 0;
    if (!bad && !ferror(stdout))
        return status;
    fprintf(stderr, "%s: stdout cannot be written: is the disk full?\n", program);
    return status ? status : failed;
}

#endif /* SYSTEM_H */
