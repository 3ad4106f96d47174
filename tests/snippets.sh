#!/bin/sh
# Compiles and runs the programs that the documentation shows:
#
#     tests/snippets.sh FOLDER LIBRARY.o FILE...       from the root; CC and CFLAGS from the environment
#
# In each FILE (a C header's comment or Markdown) a snippet starts after a line that ends in ```c and goes to the next
# line with ```. The blanks and the comment's star before the opening fence are taken off every line. After ```c the
# snippet is a whole program; after ```c fragment it is the inside of the program in tests/snippets/fragment.c.
# A snippet must compile without a warning and return 0, in a folder where tests/snippets/prepare.c has put its
# files. Programs that hold the libraries' code are compiled by CLANG where there is one, which does so in a third of the
# time; with CHECK_QUICK in the environment they are linked with LIBRARY.o instead.
# Names of functions and constants in README.md and docs/ must be in the headers.
# Ends with `N passed, N failed, N skipped`.
folder=$1 library=$2
shift 2
cc=${CC:-cc} whole_cc=$cc
command -v "${CLANG:-clang}" >/dev/null && whole_cc=${CLANG:-clang}
warnings="-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Werror"
passed=0 failed=0
root=$(pwd)
rm -rf "$folder"
mkdir -p "$folder"

# Writes FOLDER/NAME_LINE.c for each snippet of a file.
extract() {
    awk -v stem="$folder/$(basename "$1" | tr . _)" '
        function finish() { close(output); output = "" }
        output != "" && index($0, "```") { finish(); next }
        output != "" {
            line = substr($0, 1, indent) ~ /^[ *]*$/ ? substr($0, indent + 1) : $0
            print line > output
            next
        }
        match($0, /```c( fragment)?$/) {
            indent = RSTART - 1
            output = stem "_" NR ($0 ~ /fragment$/ ? ".fragment" : ".c")
            printf "" > output
        }
        END { if (output != "") { print FILENAME ": a snippet without an end" > "/dev/stderr"; exit 1 } }' "$1"
}

build() { # build SOURCE PROGRAM [FLAG]: links the library unless the source holds it
    implementation='^#define [A-Z]*_IMPLEMENTATION$'
    if ! grep -q "$implementation" "$1"; then
        $cc $warnings -I"$root" ${CFLAGS:--O1} ${3:+"$3"} "$1" "$library" -lm -o "$2"
    elif [ -n "${CHECK_QUICK:-}" ]; then
        sed "/$implementation/d" "$1" | $cc $warnings -I"$root" ${CFLAGS:--O1} -x c - -x none "$library" -lm -o "$2"
    else
        # gcc's look at indentation takes half of its time
        $whole_cc $warnings -Wno-misleading-indentation -I"$root" ${CFLAGS:--O1} "$1" -lm -o "$2"
    fi
}
build_snippet() {
    case $1 in
    *.fragment) build tests/snippets/fragment.c "$2" "-DFRAGMENT=\"$root/$1\"" ;;
    *) build "$1" "$2" ;;
    esac
}

for file; do
    extract "$file" && ls "$folder/$(basename "$file" | tr . _)"_* >/dev/null && continue
    echo "FAILED: no snippet in $file"
    failed=$((failed + 1))
done
build "$root/tests/snippets/prepare.c" "$folder/prepare" && (cd "$folder" && ./prepare) || failed=$((failed + 1))
for source in "$folder"/*.c "$folder"/*.fragment; do
    [ -e "$source" ] || continue
    program=${source%.*}
    rm -f "$folder/output.txt"
    if build_snippet "$source" "$program" && (cd "$folder" && "./${program##*/}" >output.txt 2>&1); then
        passed=$((passed + 1))
    else
        echo "FAILED: $source"
        [ -e "$folder/output.txt" ] && tail -n 5 "$folder/output.txt"
        failed=$((failed + 1))
    fi
done
# The README's program is examples/hello.c, to the letter.
if ls "$folder"/README_md_*.c >/dev/null 2>&1 && cmp -s "$folder"/README_md_*.c examples/hello.c; then
    passed=$((passed + 1))
else
    echo "FAILED: the program in README.md is not examples/hello.c"
    failed=$((failed + 1))
fi
# What Markdown calls by name is there.
for file in README.md docs/*.md; do
    missing=$(grep -oE '\b(sb|ndl|reg|SB|NDL|REG)_[A-Za-z0-9_]*[A-Za-z0-9]' "$file" | sort -u | while read -r name; do
        grep -qw "$name" softbody.h needle.h register.h || echo "$name"
    done)
    if [ -z "$missing" ]; then
        passed=$((passed + 1))
    else
        echo "FAILED: $file has names that no header has:" $missing
        failed=$((failed + 1))
    fi
done
echo "$passed passed, $failed failed, 0 skipped"
[ "$failed" = 0 ]
