/* hostile.h: calls with absurd arguments, one at a time. build/calls.h, which tests/calls.awk generates from the public
 * headers, has a function for each public one: it makes valid arguments from a world (hostile_world.h), lets what is
 * here replace one of them, and calls. */
#ifndef HOSTILE_H
#define HOSTILE_H

#include <float.h>
#include <limits.h>
#include <stddef.h>

#include "hostile_world.h"

enum { HOSTILE_ARGUMENTS = 12 };

/* What an argument or a field is, which says by what it is replaced. */
typedef enum hostile_kind {
    HOSTILE_REALS, /* one sb_real or some: vectors, matrices */
    HOSTILE_DOUBLE,
    HOSTILE_INT,
    HOSTILE_COUNT, /* of the caller's arrays: INT_MAX only without them, for a caller may not lie about memory */
    HOSTILE_ENUM,
    HOSTILE_SIZE,
    HOSTILE_POINTER,
    HOSTILE_OTHER /* nothing */
} hostile_kind;

typedef struct hostile_field {
    const char *name;
    size_t offset, size;
    hostile_kind kind;
} hostile_field;
#define HOSTILE_FIELD(type, path, kind)                                                                                \
    {                                                                                                                  \
#path, offsetof(type, path), sizeof((type *)0)->path, kind                                                     \
    }

/* One argument of the call under way. */
typedef struct hostile_argument {
    const char *name;
    int values; /* number of replacements */
    hostile_kind kind;
    void *memory; /* what the function was given, and what that held before */
    void *before;
    size_t bytes;
    int is_object;  /* 1: a thing of the world's, to be given back as it was; 0: memory is ours */
    int may_change; /* also by calls that fail */
} hostile_argument;

typedef struct hostile {
    world things;
    const char *function;
    const char *const *trusted; /* what the documentation asks the caller to see to */
    int returns_result;
    int slot, value;  /* the argument that is replaced, and by which; slot -1: none */
    int dry;          /* 1: arguments are made, but nothing is called */
    char what[96];    /* the replacement in words */
    int must_fail;    /* it is an error, whatever the function does with it */
    int called, made; /* the call came back; with SB_OK */
    sb_result result;
    sb_error error;
    int error_slot;
    unsigned long long hash;
    const char *names[HOSTILE_ARGUMENTS];
    hostile_kind kinds[HOSTILE_ARGUMENTS]; /* of all arguments, those not made yet too */
    hostile_argument arguments[HOSTILE_ARGUMENTS];
} hostile;

typedef struct hostile_call {
    const char *name;
    void (*call)(hostile *h);
    int returns_result;
    int changes; /* 0: all that it is given is const */
} hostile_call;

static void hostile_complain(hostile *h, const char *text)
{
    check.failures++;
    printf("%s(%s): %s\n", h->function, h->slot < 0 ? "valid arguments" : h->what, text);
}

/* ---- replacements ---- */

static int hostile_value_count(hostile_kind kind)
{
    static const int counts[] = {7, 7, 4, 4, 3, 2, 1, 0};
    return counts[kind];
}

static double hostile_real(int value, int is_float)
{
    double none = 0, inf = HUGE_VAL;
    const double reals[7] = {
        inf - inf, inf, -inf, is_float ? (double)FLT_MAX : DBL_MAX, is_float ? (double)FLT_MIN : DBL_MIN, none, -1};
    return reals[value];
}

static const char *hostile_real_name(int value)
{
    static const char *const names[7] = {"NaN", "infinity", "-infinity", "the largest", "the smallest", "0", "-1"};
    return names[value];
}

/* Replaces what is at `at`; `name` says what that is. */
static void hostile_put(hostile *h, const char *name, const char *field, hostile_kind kind, int value, void *at,
                        size_t size)
{
    static const int ints[4] = {0, -1, INT_MIN, INT_MAX}, enums[3] = {-1, 99, INT_MAX};
    char *what = h->what;
    int room = (int)sizeof h->what, used = snprintf(what, sizeof h->what, "%s%s%s = ", name, *field ? "." : "", field);
    size_t left = used < room ? (size_t)(room - used) : 0;
    what += left ? used : 0;
    h->must_fail = 0;
    if (kind == HOSTILE_REALS) {
        sb_real *x = (sb_real *)at, real = (sb_real)hostile_real(value, sizeof *x == sizeof(float));
        int count = (int)(size / sizeof *x);
        for (int i = 0; i < count && value == 5; i++)
            x[i] = 0;
        x[value == 1 ? count - 1 : 0] = real;
        h->must_fail = value < 3;
        snprintf(what, left, "%s", hostile_real_name(value));
    } else if (kind == HOSTILE_DOUBLE) {
        double real = hostile_real(value, 0);
        memcpy(at, &real, sizeof real);
        h->must_fail = value == 0;
        snprintf(what, left, "%s", hostile_real_name(value));
    } else if (kind == HOSTILE_INT || kind == HOSTILE_COUNT || kind == HOSTILE_ENUM) {
        int number = kind == HOSTILE_ENUM ? enums[value] : ints[value];
        memcpy(at, &number, sizeof number);
        h->must_fail = kind == HOSTILE_ENUM || (kind == HOSTILE_COUNT && value > 0);
        snprintf(what, left, "%d", number);
    } else if (kind == HOSTILE_SIZE) {
        size_t number = (size_t)value;
        memcpy(at, &number, sizeof number);
        snprintf(what, left, "%d", value);
    } else if (kind == HOSTILE_POINTER) {
        memset(at, 0, size);
        snprintf(what, left, "NULL");
    }
}

static void hostile_put_null(hostile *h, const char *name)
{
    h->must_fail = 0;
    snprintf(h->what, sizeof h->what, "%s = NULL", name);
}

/* ---- arguments ---- */

static hostile_argument *hostile_take(hostile *h, int slot, const char *name, int values, hostile_kind kind)
{
    hostile_argument *a = h->arguments + slot;
    memset(a, 0, sizeof *a);
    a->name = name;
    a->values = values;
    a->kind = kind;
    return a;
}

/* Whether a count is said to be INT_MAX: arrays are then left out. */
static int hostile_has_no_arrays(const hostile *h, int slot)
{
    return h->slot >= 0 && h->slot != slot && h->kinds[h->slot] == HOSTILE_COUNT && h->value == 3;
}

/* Whether it is these structs that are counted (fields, field_count). */
static int hostile_are_left_out(const hostile *h, int slot, const char *name)
{
    return hostile_has_no_arrays(h, slot) && strncmp(h->names[h->slot], name, strlen(name) - 1) == 0;
}

static void hostile_value(hostile *h, int slot, const char *name, void *at, size_t size, hostile_kind kind)
{
    hostile_take(h, slot, name, hostile_value_count(kind), kind);
    if (h->slot == slot)
        hostile_put(h, name, "", kind, h->value, at, size);
}

static void *hostile_handle(hostile *h, int slot, const char *name, const void *valid)
{
    hostile_take(h, slot, name, 1, HOSTILE_POINTER);
    if (valid == &h->error)
        h->error_slot = slot;
    if (h->slot != slot)
        return (void *)(uintptr_t)valid;
    hostile_put_null(h, name);
    return NULL;
}

static const char *hostile_string(hostile *h, int slot, const char *name, const char *valid)
{
    static const char *const texts[3] = {NULL, "", "build/no such directory/file"};
    hostile_take(h, slot, name, 3, HOSTILE_POINTER);
    if (h->slot != slot)
        return valid;
    snprintf(h->what, sizeof h->what, "%s = %s", name, texts[h->value] ? texts[h->value] : "NULL");
    h->must_fail = 0;
    return texts[h->value];
}

/* Memory for a call: exactly as much as it is told of, so that address sanitizers see the end. */
static void *hostile_memory(hostile_argument *a, const void *from, size_t bytes)
{
    a->memory = malloc(bytes + !bytes);
    a->before = malloc(bytes + !bytes);
    a->bytes = bytes;
    if (!a->memory || !a->before)
        abort();
    if (from)
        memcpy(a->memory, from, bytes);
    else
        memset(a->memory, 0xA5, bytes);
    return a->memory;
}

static void *hostile_output(hostile *h, int slot, const char *name, size_t item, int may_change)
{
    hostile_argument *a = hostile_take(h, slot, name, 1, HOSTILE_POINTER);
    if (h->slot == slot) {
        hostile_put_null(h, name);
        return NULL;
    }
    a->may_change = may_change;
    hostile_memory(a, NULL, item * 512);
    memcpy(a->before, a->memory, a->bytes);
    return a->memory;
}

static void *hostile_array(hostile *h, int slot, const char *name, const void *valid, size_t item, int count,
                           hostile_kind kind, int is_const)
{
    hostile_argument *a = hostile_take(h, slot, name, 1 + hostile_value_count(kind), HOSTILE_POINTER);
    void *memory;
    if ((h->slot == slot && h->value == 0) || hostile_has_no_arrays(h, slot)) {
        if (h->slot == slot)
            hostile_put_null(h, name);
        return NULL;
    }
    memory = hostile_memory(a, valid, item * (size_t)count);
    if (h->slot == slot)
        hostile_put(h, name, "[0]", kind, h->value - 1, memory, item);
    memcpy(a->before, a->memory, a->bytes);
    a->may_change = is_const;
    return memory;
}

/* Content of a mesh that no field shows. */
static void hostile_put_mesh(hostile *h, const char *name, sb_mesh *mesh, int value)
{
    world_spoil_mesh(&h->things, mesh, value);
    snprintf(h->what, sizeof h->what, "%s: %s", name,
             value == 0   ? "element 0 has node -1"
             : value == 1 ? "last element has node 2^31-1"
                          : "node 0 is NaN");
    h->must_fail = 1;
}

/* Of fields: a count of arrays that stay has no fourth. */
static int hostile_field_values(hostile_kind kind) { return kind == HOSTILE_COUNT ? 3 : hostile_value_count(kind); }

static void *hostile_struct(hostile *h, int slot, const char *name, const void *valid, size_t size,
                            const hostile_field *fields, int field_count, const char *type)
{
    int is_mesh = strcmp(type, "sb_mesh") == 0 && h->returns_result;
    hostile_argument *a = hostile_take(h, slot, name, 2 + (is_mesh ? 3 : 0), HOSTILE_POINTER);
    int value = h->value - 2;
    void *memory;
    for (int i = 0; i < field_count; i++)
        a->values += hostile_field_values(fields[i].kind);
    if ((h->slot == slot && h->value == 0) || hostile_are_left_out(h, slot, name)) {
        if (h->slot == slot)
            hostile_put_null(h, name);
        return NULL;
    }
    memory = hostile_memory(a, valid, size);
    if (h->slot == slot && value < 0) {
        memset(memory, 0, size);
        snprintf(h->what, sizeof h->what, "%s = {0}", name);
        h->must_fail = 0;
    } else if (h->slot == slot) {
        int i = 0;
        while (i < field_count && value >= hostile_field_values(fields[i].kind))
            value -= hostile_field_values(fields[i++].kind);
        if (i < field_count)
            hostile_put(h, name, fields[i].name, fields[i].kind, value, (char *)memory + fields[i].offset,
                        fields[i].size);
        else
            hostile_put_mesh(h, name, (sb_mesh *)memory, value);
    }
    memcpy(a->before, a->memory, a->bytes);
    return memory;
}

static void *hostile_object(hostile *h, int slot, const char *name, void *valid, size_t size)
{
    hostile_argument *a = hostile_take(h, slot, name, 1, HOSTILE_POINTER);
    if (h->slot == slot) {
        hostile_put_null(h, name);
        return NULL;
    }
    a->memory = valid;
    a->bytes = size;
    a->is_object = 1;
    a->before = malloc(size);
    if (!a->before)
        abort();
    memcpy(a->before, valid, size);
    return valid;
}

/* ---- the call ---- */

static int hostile_is_listed(const hostile *h, const char *const *list)
{
    char path[192];
    size_t length;
    snprintf(path, sizeof path, "%s.%s", h->function, h->what);
    for (; *list; list++) {
        const char *tried = **list == '*' ? h->what : path, *entry = *list + (**list == '*' ? 2 : 0);
        length = strlen(entry);
        if (strncmp(entry, tried, length) == 0 && strchr(" [:.", tried[length]))
            return 1;
    }
    return 0;
}

static int hostile_begin(hostile *h)
{
    memset(&h->error, 0, sizeof h->error);
    h->called = h->made = 0;
    h->result = SB_OK;
    return !h->dry && (h->slot < 0 || !hostile_is_listed(h, h->trusted));
}

static void hostile_text(hostile *h, const char *text)
{
    if (!text)
        hostile_complain(h, "gave NULL");
    else if (strlen(text) == 0 || strlen(text) > 200)
        hostile_complain(h, "gave no name");
}

static void hostile_read(hostile *h, const void *value, size_t size)
{
    volatile unsigned char sum = 0;
    for (size_t i = 0; i < size; i++) /* memory sanitizers look at it */
        sum = (unsigned char)(sum + ((const unsigned char *)value)[i]);
    (void)h;
    (void)sum;
}

static void hostile_result(hostile *h, sb_result result)
{
    char text[sizeof h->error.message + 64];
    h->result = result;
    h->made = result == SB_OK;
    if (h->slot < 0 && result != SB_OK) {
        snprintf(text, sizeof text, "%s: %s", sb_result_string(result), h->error.message);
        hostile_complain(h, text);
    }
    if (result > SB_OK || result < SB_ERROR_CANCELLED)
        hostile_complain(h, "gave no result that has a name");
    if (result != SB_OK && h->error_slot >= 0 && h->slot != h->error_slot &&
        (h->error.result != result || !h->error.message[0]))
        hostile_complain(h, "failed without saying why");
}

static void hostile_end(hostile *h) { h->called = 1; }

/* What a call that failed must have left alone. */
static void hostile_check_untouched(hostile *h)
{
    char text[96];
    for (int i = 0; i < HOSTILE_ARGUMENTS; i++) {
        hostile_argument *a = h->arguments + i;
        if (!a->memory || a->may_change || memcmp(a->memory, a->before, a->bytes) == 0)
            continue;
        snprintf(text, sizeof text, "failed, and yet changed `%s`", a->name);
        hostile_complain(h, text);
    }
}

static void hostile_release(hostile *h)
{
    for (int i = 0; i < HOSTILE_ARGUMENTS; i++) {
        hostile_argument *a = h->arguments + i;
        if (!a->is_object)
            free(a->memory);
        free(a->before);
        memset(a, 0, sizeof *a);
    }
    world_free(&h->things);
}

#endif /* HOSTILE_H */
