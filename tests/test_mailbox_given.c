/* Tests of the mailbox with C11's atomics, and, where the language has none, with those of a user's own macros. */
#define SB_SPLIT_BUILD
#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L && !defined(__STDC_NO_ATOMICS__)
#define SB_USE_STDATOMIC
#else
#define SB_ATOMIC_TYPE unsigned long
#define SB_ATOMIC_EXCHANGE(p, v) ((int)__atomic_exchange_n((p), (unsigned long)(v), __ATOMIC_ACQ_REL))
#define SB_ATOMIC_LOAD(p) ((int)__atomic_load_n((p), __ATOMIC_RELAXED))
#endif
#include "src/softbody/contact/haptic_mailbox.h"

#include "mailbox_threads.h"

CHECK_SUITE(mailbox_given, {"records are whole, in order and the newest", test_interleaved},
            {"a writer stopped in a record", test_stopped_writer}, MAILBOX_THREADS);
