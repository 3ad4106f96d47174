/* input: see input.h. */
#include "input.h"

#include <stdio.h>
#include <string.h>

/* Twice the room; the content moves along. */
static int sbi_file_grow(const sb_allocator *allocator, sbi_file *content, size_t *capacity)
{
    char *grown;
    if (*capacity > ((size_t)-1) / 2)
        return 0;
    grown = (char *)sbi_alloc(allocator, 2 * *capacity, 1);
    if (!grown)
        return 0;
    memcpy(grown, content->data, content->size);
    sbi_free(allocator, content->data);
    content->data = grown;
    *capacity *= 2;
    return 1;
}

/* Reads until the end rather than asking for the size, which pipes do not have and folders make up. */
SBI_API sb_result sbi_file_read(const sb_allocator *allocator, const char *path, sbi_file *content, sb_error *error)
{
    size_t capacity = 1 << 16, got = 1;
    sb_result result = SB_OK;
    FILE *file = fopen(path, "rb");
    content->size = 0;
    content->data = NULL;
    if (!file)
        return sbi_fail_file(error, SB_ERROR_FILE, path, "the file cannot be opened");
    content->data = (char *)sbi_alloc(allocator, capacity, 1);
    if (!content->data)
        result = sbi_fail_file(error, SB_ERROR_MEMORY, path, "out of memory while reading a file");
    while (!result && got) {
        if (content->size == capacity && !sbi_file_grow(allocator, content, &capacity)) {
            result = sbi_fail_file(error, SB_ERROR_MEMORY, path, "out of memory while reading a file");
            break;
        }
        got = fread(content->data + content->size, 1, capacity - content->size, file);
        content->size += got;
    }
    if (!result && ferror(file))
        result = sbi_fail_file(error, SB_ERROR_FILE, path, "the file cannot be read");
    fclose(file);
    return result;
}
