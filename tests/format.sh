#!/bin/sh
# Whether the sources are laid out as .clang-format says: run as `tests/format.sh [--write]` from the root. Another
# version of clang-format lays out otherwise, so only the one that .clang-format was written for counts, from
# CLANG_FORMAT; without it the check is skipped. Ends with `N passed, N failed, N skipped`.
wanted=14
tool=
for name in ${CLANG_FORMAT:-clang-format clang-format-$wanted}; do
    case $("$name" --version 2>/dev/null) in *"version $wanted."*) tool=$name ;; esac
done
if [ -z "$tool" ]; then
    echo "skip: no clang-format $wanted"
    echo "0 passed, 0 failed, 1 skipped"
    exit 0
fi

# Files that a program writes, and those of tests/format.txt: rooms under work, to be laid out when they are done. The list is
# no place for new files.
files=$(find src tests examples -name '*.[ch]' | sort |
    grep -v '^src/.*/names\.h$' | grep -v -f tests/format.txt)
if [ "$1" = --write ]; then
    "$tool" -i $files
    exit
fi
passed=0 failed=0
for file in $files; do
    if "$tool" "$file" | cmp -s - "$file"; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        echo "FAILED: $file is not laid out by .clang-format (make format)"
    fi
done
[ "$failed" = 0 ] && echo "1 passed, 0 failed, 0 skipped" || echo "0 passed, $failed failed, 0 skipped"
[ "$failed" = 0 ]
