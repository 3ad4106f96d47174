#!/bin/sh
# Builds the tests for other systems and runs them where that is possible: MinGW-w64 under wine, wasm32-wasi under
# node, 64-bit ARM under qemu (the golden results with them: the same bits as elsewhere). A tool that is missing is a skip. From the root, through `make cross`; FILTER picks tests. Ends with
# `N passed, N failed, N skipped`.
make=${MAKE:-make}
skipped=0
set --

skip() {
    skipped=$((skipped + 1))
    echo "skip: $1"
}
has() { command -v "$1" >/dev/null; }

if ! has x86_64-w64-mingw32-gcc; then
    skip "no x86_64-w64-mingw32-gcc"
elif ! $make --no-print-directory build/mingw/tests.exe; then
    set -- "$@" "echo 'MinGW: the build failed'; false"
elif ! has wine64 && ! has wine && ! [ -x /usr/lib/wine/wine64 ]; then
    skip "no wine: the MinGW build was linked, not run"
else
    wine=$(command -v wine64 || command -v wine || echo /usr/lib/wine/wine64)
    WINEPREFIX=$(mktemp -d) WINEDEBUG=-all
    export WINEPREFIX WINEDEBUG
    trap 'rm -rf "$WINEPREFIX"' EXIT
    set -- "$@" "'$wine' build/mingw/tests.exe $FILTER"
fi

wasm_ready() { # whether clang can compile and link for WASI
    echo 'int main(void) { return 0; }' >build/wasm_probe.c &&
        clang --target=wasm32-wasi --sysroot=/usr build/wasm_probe.c -o build/wasm_probe 2>/dev/null
}
mkdir -p build
if ! wasm_ready; then
    skip "no clang for wasm32-wasi with wasi-libc"
elif ! $make --no-print-directory build/wasm/tests.wasm; then
    set -- "$@" "echo 'wasm32: the build failed'; false"
elif ! has node; then
    skip "no node: the wasm32 build was linked, not run"
else
    # before version 20 WASI had to be asked for
    flag=$(node -p 'parseInt(process.versions.node) < 20 ? "--experimental-wasi-unstable-preview1" : ""')
    # node 20 may crash while it takes its own WASI down, after the program has ended: what counts is the program's
    # closing line, without which tests/total.sh sees a failure
    set -- "$@" "node --no-warnings $flag tests/wasi.mjs build/wasm/tests.wasm $FILTER; true"
fi

arm=aarch64-linux-gnu-gcc
if ! has $arm; then
    skip "no $arm"
elif ! $make --no-print-directory build/aarch64/tests; then
    set -- "$@" "echo 'ARM: the build failed'; false"
elif [ "$(uname -m)" = aarch64 ]; then
    set -- "$@" "build/aarch64/tests $FILTER"
elif ! has qemu-aarch64; then
    skip "no qemu-aarch64: the ARM build was linked, not run"
else
    set -- "$@" "qemu-aarch64 build/aarch64/tests $FILTER"
fi

[ $# = 0 ] && set -- "true; echo '0 passed, 0 failed, 0 skipped'"
tests/total.sh "$@" "echo '0 passed, 0 failed, $skipped skipped'"
