/* input: files read as a whole. Floor 0, internal. */
#ifndef SB_INPUT_H
#define SB_INPUT_H

#include "core.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The content of a file. */
typedef struct sbi_file {
    char *data;
    size_t size;
} sbi_file;
/* The whole file; content->data is to be freed, also after a failure. SB_ERROR_FILE, SB_ERROR_MEMORY. */
SBI_API sb_result sbi_file_read(const sb_allocator *allocator, const char *path, sbi_file *content, sb_error *error);
#endif

#endif /* SB_INPUT_H */
