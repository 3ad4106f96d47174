/* Tests of the mailbox between servo and simulation, with the compiler's own atomics. */
#define SB_SPLIT_BUILD /* what is internal is declared, and the mailbox is all inline */
#include "src/softbody/contact/haptic_mailbox.h"

#include "mailbox_threads.h"

CHECK_SUITE(mailbox, {"records are whole, in order and the newest", test_interleaved},
            {"a writer stopped in a record", test_stopped_writer}, MAILBOX_THREADS);
