#!/bin/sh
# The page of examples/web: run as `tests/page.sh FOLDER` from the root. Its wasm does natively what C does, and a headless Chromium
# shows it. MAKE, CLANG from the environment; what is missing is a skip. Ends with `N passed, N failed, N skipped`.
folder=$1
make=${MAKE:-make} clang=${CLANG:-clang}
passed=0 failed=0 skipped=0
mkdir -p "$folder"

report() { # report STATUS NAME
    if [ "$1" = 0 ]; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        echo "FAILED: $2"
    fi
}
skip() {
    skipped=$((skipped + 1))
    echo "skip: $1"
}
end() {
    echo "$passed passed, $failed failed, $skipped skipped"
    exit $((failed != 0))
}

echo 'int main(void) { return 0; }' >"$folder/probe.c"
if ! "$clang" --target=wasm32-wasi --sysroot=/usr "$folder/probe.c" -o "$folder/probe.wasm" 2>/dev/null; then
    skip "no clang for wasm32-wasi with wasi-libc and lld"
    end
fi
$make --no-print-directory build/page.html >"$folder/make.txt" 2>&1 || cat "$folder/make.txt"
[ -s build/page.html ] && [ "$(gzip -9 -c build/page.html | wc -c)" -lt 1048576 ]
report $? "the page in one file, under 1 MB compressed"

if command -v node >/dev/null; then
    # Hashes of the state too, but after the needle, whose rod takes sines from each system's own library.
    "$clang" -std=c99 -O0 -ffp-contract=off -DSB_ELEMENT=SB_TET4 -I. tests/web/native.c -lm -o "$folder/native" &&
        "$folder/native" >"$folder/native.txt" && node tests/web/page.mjs build/page.wasm >"$folder/wasm.txt" &&
        sed 's/^3 [0-9a-f]*/3/' "$folder/native.txt" >"$folder/native.same" &&
        sed 's/^3 [0-9a-f]*/3/' "$folder/wasm.txt" | diff "$folder/native.same" - && [ "$(wc -l <"$folder/native.same")" = 4 ]
    report $? "wasm does what native code does, to the last bit"
else
    skip "no node"
    end
fi
if command -v chromium >/dev/null; then
    node tests/web/browser.mjs "$(command -v chromium)" build/page.html "$folder/page.png"
    report $? "the page in Chromium"
else
    skip "no chromium"
fi
end
