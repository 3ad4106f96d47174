#!/bin/bash
# All that must hold before a change goes in: what CI runs (make check). CHECK_ALL=1 adds what takes as long again: every lint
# and golden combination, C++ at run time, violent loops under the sanitizers, other systems. Two steps
# at a time, each of which keeps one core busy. Tools that only serve other systems may be missing and are then reported as skips.
# Ends with one line `N passed, N failed, N skipped`.
#
# The order is that of what has found defects so far, the longest of those first: what comes last is cut off first when
# time runs out. Every line says when it begins, and each step how long it took.
set -euo pipefail
cd "$(dirname "$0")/.."

lane=()
took='read -r _ && read -r user system && echo "${user%.*} of the processor"'
timed() { lane+=("begin=\$(date +%s); echo \"== \$(date +%T) $1\"; $2; status=\$?; times >$work/times.\$\$
    echo \"== \$(date +%T) took \$((\$(date +%s) - begin)) s, \$({ $took; } <$work/times.\$\$): $1\"; (exit \$status)"); }
counted() { timed "$1" "$2"; } # a command that ends with a closing line of its own
single() { timed "$1" "{ $2; } && echo '1 passed, 0 failed, 0 skipped'"; }
skipped() { lane+=("echo 'skip: $1'; echo '0 passed, 0 failed, 1 skipped'"); }
few() { [ -n "${CHECK_ALL:-}" ] || echo "$1"; } # what keeps a step short unless all is asked for

# Warnings are errors. No debugging symbols, programs linked with one object that holds the implementation, what calls it not
# optimised.
library=build/double/implementation.o
make="make --no-print-directory -s CFLAGS='-O2 -Werror' SANITIZE_CFLAGS=-O1 LIBRARY=$library"
unset MAKEFLAGS MFLAGS MAKELEVEL
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
git status --porcelain >"$work/before"

single "the generated files are those that src/ gives" "$make headers
    if [ -n \"\$(git status --porcelain -- *.h src/*/names.h examples/python examples/csharp)\" ]; then
        echo 'The headers are not what src/ gives. Mend them with these two commands:'
        echo '    make headers'
        echo '    git add *.h src/*/names.h examples/python examples/csharp'
        false
    fi"
single "the tests and examples build" "$make -j$(nproc) tested build/host/tests"
first=("${lane[@]}")

lane=()
counted "tests under the address and undefined-behaviour sanitizers" "$make sanitize"
counted "tests in double, each with 128 kB of stack and bad operations as signals" "$make test-host"
# gcc's warnings are errors of the tests' own builds, in double and in float.
counted "warnings, split build, order of calls, linkage" "$make lint LINT_OPTIMISED= $(few "LINTS=clangxx-double")"
counted "tests in float" "CHECK_QUICK=1 CHECK_SHORT=1 $make test-float FILTER='\$(SLOW) \$(SLOWER)'"
counted "examples, README, fuzz corpus" "$make test-programs"
counted "tests of threads under the thread sanitizer" "$make test-tsan"
# 38 of each kind are among the tests above: 10,008 in all.
counted "10,000 random sweeps of tools through bodies" "CHECK_FIRST=38 CHECK_SLOW=796 $make test-host FILTER=contact_sweep"
counted "golden results of compilers and optimisations" "$make test-golden $(few "GOLDEN_NAMES='gcc-O3 clang-O0'")"
counted "fuzz targets" "$make fuzz FUZZ_SECONDS=1 FUZZ_CFLAGS=-O0"
# Waiting threads leave their processor to the other step. Long tests that have no threads are left out.
counted "tests with OpenMP" "OMP_WAIT_POLICY=passive $make test-openmp FILTER='\$(SLOW) -step/rest -step/Newmark \
    -contact_sweep -contact_organ -contact_hung -contact_hostile -contact_static -contact_substeps'"
counted "the page in a browser" "$make test-page PAGE_CFLAGS=-O1"
counted "the headers from Python and C#" "$make test-bindings"
counted "random sessions on every element" "$make soak SOAK_SECONDS=5"
if [ -n "${CHECK_ALL:-}" ]; then
    counted "sanitizers over the suites of violent loops" "$make sanitize FILTER='step integrators stuffing schemes viscoelastic load bbar'"
    counted "tests as C++11" "CHECK_QUICK=1 $make test-cpp"
    counted "many random cases" "CHECK_SLOW=1 $make test FILTER=anything"
    counted "other systems: MinGW under wine, wasm32 under node, 64-bit ARM under qemu" "CHECK_QUICK=1 $make cross"
fi
counted "installed, and as packages" "$make test-ports"
single "benchmarks compile" "$make benches BENCH_CFLAGS='-fsyntax-only -std=gnu11 -fopenmp -DSB_USE_OPENMP'"
if [ "$(clang-format --version 2>/dev/null | sed 's/.*version \([0-9]*\).*/\1/')" = 14 ]; then
    single "the sources are formatted (make format)" "$make format FORMAT='--dry-run -Werror'"
else
    skipped "no clang-format 14: the sources are formatted"
fi
if command -v doxygen >/dev/null; then
    single "the reference of the headers is made without warnings" "$make docs"
else
    skipped "no doxygen: the reference of the headers"
fi
steps=("${lane[@]}")

lane=()
single "nothing left lying in the tree" "git status --porcelain | diff $work/before -"

tests/total.sh "${first[@]}" | tee "$work/first" || true
TOTAL_JOBS=2 tests/total.sh "${steps[@]}" | tee "$work/steps" || true
tests/total.sh "tail -n 1 $work/first" "tail -n 1 $work/steps" "${lane[@]}"
