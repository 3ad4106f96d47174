/* mailbox_threads: the tests of a mailbox, for each of the atomics that it can be made with. The unit that includes it
 * has included contact/haptic_mailbox.h. */
#ifndef MAILBOX_THREADS_H
#define MAILBOX_THREADS_H

#include "check.h"

#if defined(CHECK_THREADS)
#include <pthread.h>
#include <sched.h>
#endif

enum { MAILBOX_WORDS = 40 };

/* A record that shows when it is torn: all words are made from its number. */
typedef struct mailbox_record {
    unsigned number, words[MAILBOX_WORDS];
} mailbox_record;

typedef struct mailbox_test {
    sbi_mailbox box;
    mailbox_record slots[SBI_MAILBOX_SLOTS];
    unsigned count;                 /* records to write */
    unsigned read, torn, old, last; /* what the reader saw */
} mailbox_test;

static inline unsigned mailbox_word(unsigned number, unsigned i) { return number * 2654435761u + i; }

/* Fills words [from, to) of the writer's slot. */
static inline void mailbox_fill(mailbox_test *t, unsigned number, unsigned from, unsigned to)
{
    mailbox_record *record = t->slots + sbi_mailbox_back(&t->box);
    record->number = number;
    for (unsigned i = from; i < to; i++)
        record->words[i] = mailbox_word(number, i);
}

static inline void mailbox_look(mailbox_test *t)
{
    const mailbox_record *record;
    unsigned torn = 0;
    if (!sbi_mailbox_take(&t->box))
        return;
    record = t->slots + sbi_mailbox_front(&t->box);
    for (unsigned i = 0; i < MAILBOX_WORDS; i++)
        torn |= record->words[i] != mailbox_word(record->number, i);
    t->torn += torn;
    t->old += record->number <= t->last;
    t->last = record->number;
    t->read++;
}

static inline void mailbox_check(const mailbox_test *t)
{
    CHECK_INT(t->torn, 0);
    CHECK_INT(t->old, 0);
    CHECK_INT(t->last, t->count);
}

/* Reader and writer by turns at random, the writer stopped anywhere in a record. */
static void test_interleaved(void)
{
    mailbox_test t;
    unsigned long long seed = 1;
    unsigned number = 1, at = 0;
    memset(&t, 0, sizeof t);
    sbi_mailbox_begin(&t.box);
    CHECK_INT(sbi_mailbox_take(&t.box), 0);
    t.count = 20000;
    while (number <= t.count) {
        unsigned to = at + (unsigned)(check_random(&seed) * 30);
        if (to > MAILBOX_WORDS)
            to = MAILBOX_WORDS;
        mailbox_fill(&t, number, at, to);
        at = to;
        if (at == MAILBOX_WORDS) {
            sbi_mailbox_post(&t.box);
            number++;
            at = 0;
        }
        for (int k = (int)(check_random(&seed) * 3); k-- > 0;)
            mailbox_look(&t);
        CHECK(sbi_mailbox_front(&t.box) != sbi_mailbox_back(&t.box));
    }
    mailbox_look(&t);
    mailbox_check(&t);
    CHECK(t.read > t.count / 10 && t.read <= t.count);
}

/* A writer that stops in the middle of a record: the reader keeps the last whole one. */
static void test_stopped_writer(void)
{
    mailbox_test t;
    memset(&t, 0, sizeof t);
    sbi_mailbox_begin(&t.box);
    t.count = 2;
    for (unsigned number = 1; number <= 2; number++) {
        mailbox_fill(&t, number, 0, MAILBOX_WORDS);
        sbi_mailbox_post(&t.box);
    }
    mailbox_fill(&t, 3, 0, MAILBOX_WORDS / 2);
    mailbox_look(&t);
    CHECK_INT(sbi_mailbox_take(&t.box), 0);
    mailbox_check(&t);
    CHECK_INT(t.read, 1);
    CHECK_INT(t.slots[sbi_mailbox_front(&t.box)].number, 2);
}

#if defined(CHECK_THREADS)
static void *mailbox_write(void *user)
{
    mailbox_test *t = (mailbox_test *)user;
    for (unsigned number = 1; number <= t->count; number++) {
        mailbox_fill(t, number, 0, MAILBOX_WORDS);
        sbi_mailbox_post(&t->box);
        if (number % 8 == 0)
            sched_yield();
    }
    return NULL;
}

/* Two threads that never wait for each other. MAILBOX_RECORDS=10000000 for a night's run. */
static void test_threads(void)
{
    const char *records = getenv("MAILBOX_RECORDS");
    static mailbox_test t;
    pthread_t writer;
    memset(&t, 0, sizeof t);
    sbi_mailbox_begin(&t.box);
    t.count = records ? (unsigned)strtoul(records, NULL, 10) : 20000;
    if (!CHECK_INT(pthread_create(&writer, NULL, mailbox_write, &t), 0))
        return;
    while (t.last < t.count) {
        mailbox_look(&t);
        if (t.read % 8 == 0)
            sched_yield();
    }
    CHECK_INT(pthread_join(writer, NULL), 0);
    mailbox_look(&t);
    mailbox_check(&t);
    printf("    %u of %u records seen\n", t.read, t.count);
}
#define MAILBOX_THREADS                                                                                                \
    {                                                                                                                  \
        "threads", test_threads                                                                                        \
    }
#else
#define MAILBOX_THREADS                                                                                                \
    {                                                                                                                  \
        NULL, NULL                                                                                                     \
    } /* they are for make test-tsan */
#endif

#endif
