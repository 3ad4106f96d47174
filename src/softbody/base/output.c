/* output: see output.h. */
#include "output.h"

#include <errno.h>
#include <string.h>
#include <time.h>

/* ---- what C99 leaves to the system: what a name stands for, and putting one file in the place of another ---- */

typedef enum sbi_output_kind {
    SBI_OUTPUT_NOTHING = 0, /* no such file */
    SBI_OUTPUT_FILE = 1,    /* a plain file */
    SBI_OUTPUT_OTHER = 2    /* a device, a pipe, a folder */
} sbi_output_kind;

#if defined(_WIN32)

#include <sys/stat.h>
#include <sys/types.h>
#define SBI_OUTPUT_NEW "wb"
#define SBI_OUTPUT_SEPARATORS "/\\:"

#if defined(__cplusplus)
extern "C"
#endif
    __declspec(dllimport) int __stdcall MoveFileExA(const char *from, const char *to, unsigned long flags);

static sbi_output_kind sbi_output_look(const char *path, unsigned *mode)
{
    struct _stat about;
    FILE *file = fopen(path, "rb"); /* _stat does not know that NUL and CON are devices */
    int plain;
    *mode = 0;
    if (!file)
        return SBI_OUTPUT_NOTHING;
    plain = _fstat(_fileno(file), &about) == 0 && (about.st_mode & _S_IFMT) == _S_IFREG;
    fclose(file);
    return plain ? SBI_OUTPUT_FILE : SBI_OUTPUT_OTHER;
}

/* rename() refuses a target that is there. */
static int sbi_output_move(const char *from, const char *to)
{
    const unsigned long replace_existing = 1;
    return MoveFileExA(from, to, replace_existing) != 0;
}

static void sbi_output_set_mode(const char *path, unsigned mode) { (void)path, (void)mode; }
static int sbi_output_follow(char path[SB_OUTPUT_PATH]) { return path != NULL; }

#elif defined(__unix__) || defined(__APPLE__) || defined(__wasi__)

#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>
#define SBI_OUTPUT_NEW "wbx" /* fails when the file is there, where x is known */
#define SBI_OUTPUT_SEPARATORS "/"

#if defined(__GLIBC__) && !defined(__USE_XOPEN2K) && !defined(__cplusplus)
extern ssize_t readlink(const char *path, char *link, size_t size); /* POSIX; -std=c99 hides it in glibc */
#endif

static sbi_output_kind sbi_output_look(const char *path, unsigned *mode)
{
    struct stat about;
    *mode = 0;
    if (stat(path, &about) != 0)
        return SBI_OUTPUT_NOTHING;
    *mode = (unsigned)about.st_mode & 07777u;
    return S_ISREG(about.st_mode) ? SBI_OUTPUT_FILE : SBI_OUTPUT_OTHER;
}

static int sbi_output_move(const char *from, const char *to) { return rename(from, to) == 0; }

/* Not every file system has permissions; the content is worth more. */
static void sbi_output_set_mode(const char *path, unsigned mode)
{
#if defined(__wasi__)
    (void)path, (void)mode;
#else
    (void)chmod(path, (mode_t)mode);
#endif
}

/* Replaces a symbolic link by what it names, from its own folder; 1, 0: no link, -1: too long. */
static int sbi_output_follow_once(char path[SB_OUTPUT_PATH])
{
    char link[SB_OUTPUT_PATH];
    const char *slash = strrchr(path, '/');
    size_t folder = slash ? (size_t)(slash - path) + 1 : 0, length;
    ssize_t got = readlink(path, link, sizeof link);
    if (got <= 0)
        return 0;
    length = (size_t)got;
    if (link[0] == '/')
        folder = 0;
    if (folder + length >= SB_OUTPUT_PATH)
        return -1;
    memcpy(path + folder, link, length);
    path[folder + length] = 0;
    return 1;
}

/* Leads the path to the file itself; 0 where the links have no end. */
static int sbi_output_follow(char path[SB_OUTPUT_PATH])
{
    for (int links = 0; links < 40; links++) {
        int followed = sbi_output_follow_once(path);
        if (followed <= 0)
            return followed == 0;
    }
    return 0;
}

#else

#define SBI_OUTPUT_NEW "wb"
#define SBI_OUTPUT_SEPARATORS "/"

static sbi_output_kind sbi_output_look(const char *path, unsigned *mode)
{
    FILE *file = fopen(path, "rb");
    *mode = 0;
    if (file)
        fclose(file);
    return file ? SBI_OUTPUT_FILE : SBI_OUTPUT_NOTHING;
}

static int sbi_output_move(const char *from, const char *to) { return rename(from, to) == 0; }
static void sbi_output_set_mode(const char *path, unsigned mode) { (void)path, (void)mode; }
static int sbi_output_follow(char path[SB_OUTPUT_PATH]) { return path != NULL; }

#endif

/* 1 for the names that POSIX systems give to files that are open already, like /dev/stdout: a file put in the place of
 * one would not be what is open. */
static int sbi_output_is_open_file(const char *path)
{
    return strncmp(path, "/dev/std", 8) == 0 || strncmp(path, "/dev/fd/", 8) == 0 || strncmp(path, "/proc/", 6) == 0;
}

/* ---- the file beside the target ---- */

enum {
    SBI_OUTPUT_STEM = 200, /* bytes of the target's name that are kept: file systems take 255 */
    SBI_OUTPUT_TAIL = 23,  /* of ".0123456789abcdef.part" and its end */
    SBI_OUTPUT_TRIES = 16
};

/* FOLDER/NAME.0123456789abcdef.part, other digits for each try, process and thread; 0 when it is too long. */
static int sbi_output_name_beside(sb_output *out, int try_number)
{
    const char *name = out->target;
    uint64_t digits = ((uint64_t)(uintptr_t)out ^ (uint64_t)time(NULL) << 32) + (uint64_t)(unsigned)try_number;
    size_t length;
    for (const char *p = out->target; *p; p++)
        if (strchr(SBI_OUTPUT_SEPARATORS, *p))
            name = p + 1;
    length = strlen(name);
    if (length > SBI_OUTPUT_STEM)
        for (length = SBI_OUTPUT_STEM; length > 0 && ((unsigned char)name[length] & 0xC0) == 0x80;)
            length--; /* no half of a character of UTF-8 */
    length += (size_t)(name - out->target);
    if (length + SBI_OUTPUT_TAIL > SB_OUTPUT_PATH)
        return 0;
    digits *= 0x9E3779B97F4A7C15u;
    digits ^= digits >> 32;
    memcpy(out->beside, out->target, length);
    out->beside[length++] = '.';
    for (int shift = 60; shift >= 0; shift -= 4)
        out->beside[length++] = "0123456789abcdef"[digits >> shift & 15];
    memcpy(out->beside + length, ".part", 6);
    return 1;
}

/* Makes the file beside the target; NULL with errno. */
static FILE *sbi_output_make_beside(sb_output *out)
{
    unsigned mode;
    for (int i = 0; i < SBI_OUTPUT_TRIES; i++) {
        FILE *file;
        if (!sbi_output_name_beside(out, i))
            return NULL;
        if (sbi_output_look(out->beside, &mode) != SBI_OUTPUT_NOTHING)
            continue;
        file = fopen(out->beside, SBI_OUTPUT_NEW);
        if (file || errno != EEXIST)
            return file;
    }
    return NULL;
}

/* ---- writing ---- */

/* Opens a target that is a device, pipe, folder or open file where it stands, which reports what it cannot be; any
 * other through a file beside it. */
static FILE *sbi_output_open_target(sb_output *out, const char **why)
{
    unsigned mode;
    FILE *file;
    int in_place = sbi_output_is_open_file(out->target);
    sbi_output_kind kind;
    *why = "the file cannot be opened for writing";
    if (!in_place && !sbi_output_follow(out->target))
        return NULL;
    in_place = in_place || sbi_output_is_open_file(out->target);
    kind = sbi_output_look(out->target, &mode);
    if (in_place || kind == SBI_OUTPUT_OTHER)
        return fopen(out->target, "wb");
    if (kind == SBI_OUTPUT_FILE) { /* replacing it would ask for no right to write to it */
        file = fopen(out->target, "ab");
        if (!file || fclose(file) != 0)
            return NULL;
        *why = "no file can be made beside it: is the disk full, or its folder write-protected?";
    }
    file = sbi_output_make_beside(out);
    if (!file)
        out->beside[0] = 0;
    else if (kind == SBI_OUTPUT_FILE)
        sbi_output_set_mode(out->beside, mode);
    return file;
}

SB_API sb_result sb_output_open(sb_output *out, const char *path, sb_error *error)
{
    const char *why;
    size_t length;
    if (!out || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", out ? "path" : "out");
    out->file = NULL;
    out->path = path;
    out->target[0] = out->beside[0] = 0;
    length = strlen(path);
    if (length == 0 || length >= SB_OUTPUT_PATH)
        return sbi_fail_file(error, SB_ERROR_FILE, path, length ? "the path is too long" : "the path is empty");
    memcpy(out->target, path, length + 1);
    out->file = sbi_output_open_target(out, &why);
    return out->file ? SB_OK : sbi_fail_file(error, SB_ERROR_FILE, path, why);
}

SB_API sb_result sb_output_close(sb_output *out, sb_error *error)
{
    int failed;
    if (!out || !out->file)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the output is not open");
    failed = fflush(out->file) != 0;
    failed |= ferror(out->file) != 0;
    failed |= fclose(out->file) != 0; /* some systems find only now that the disk is full */
    out->file = NULL;
    if (!failed && (!out->beside[0] || sbi_output_move(out->beside, out->target)))
        return SB_OK;
    if (out->beside[0])
        remove(out->beside);
    return sbi_fail_file(error, SB_ERROR_FILE, out->path,
                         failed ? "the file cannot be written: is the disk full?"
                                : "the file cannot be replaced by what was written beside it");
}

SB_API void sb_output_discard(sb_output *out)
{
    if (!out || !out->file)
        return;
    fclose(out->file);
    out->file = NULL;
    if (out->beside[0])
        remove(out->beside);
}

SB_API sb_result sb_file_save(const char *path, const void *bytes, size_t size, sb_error *error)
{
    sb_output out;
    sb_result result;
    if (!path || (!bytes && size))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", path ? "bytes" : "path");
    result = sb_output_open(&out, path, error);
    if (result != SB_OK)
        return result;
    if (size && fwrite(bytes, 1, size, out.file) != size) {
        sb_output_discard(&out);
        return sbi_fail_file(error, SB_ERROR_FILE, path, "the file cannot be written: is the disk full?");
    }
    return sb_output_close(&out, error);
}
#undef SBI_OUTPUT_NEW
#undef SBI_OUTPUT_SEPARATORS
