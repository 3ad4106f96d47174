# The products are the headers here at the root, generated from src/; everything else is built into build/.
#
#   make            the examples                     make bench      benchmarks, one core and all cores, then the race
#   make demo       build and run examples/demo.c    make headers    writes the products from src/
#   make test       the tests in double without the slowest, 3 to 5 minutes on two cores
#   make check      all tests, and all else that CI runs, see tests/check.sh; CHECK_ALL=1 adds what takes as long again
#   make install    PREFIX=/usr/local, DESTDIR=
#   make test-float, test-cpp, test-openmp           make clean
#   make test-golden                                 the same bits from each compiler and optimisation
#   make test-tsan                                   the tests of threads under the thread sanitizer
#   make test-host                                   all tests in double as in a strict host: 128 kB of stack each, and invalid
#                                                    operations, divisions by 0 and overflows are signals
#   make test-programs                               examples, README, fuzz corpus
#   make test-ports                                  installed, and as packages of CMake, Meson, Zig, Conan, vcpkg
#   make shared     a library for other languages    make bindings   what calls it from Python and C#
#   make page       an organ in a browser: build/page.html
#   make verification                                writes tests/verification.md from the tests named verification_...
#   make sanitize   the tests under ASan and UBSan   make cross      MinGW-w64, wasm32 and ARM, run under wine, node, qemu
#   make dev        the tests of FILTER="..." with each source an object of its own: a change compiles little
#   make lint       warnings, split build, linkage   make fuzz       FUZZ_SECONDS=10 for each target
#   make soak       SOAK_STEPS=1000000 per element, SOAK_HOURS=24 per simulated hand, SOAK_SWEEPS=1000000 of tools through
#                   bodies, SOAK_CUTS=200 sequences of cuts in livers and 50 times as many strokes, or SOAK_SECONDS=20
#                   for all of each; SOAK_FIRST and SOAK_SEED give other ones, so that processes and nights can share it
#   make soak-cuts  what soak does of cuts alone
#   make coverage   lines of the header that the suite runs, room by room
#   make race       solvers against CHOLMOD, Eigen and hypre where they are installed: tests/bench/race.md and its plots
#
# Variables: CC, CXX, CFLAGS; FILTER="dense mesh/volume" picks tests by suite or start of suite/test.
CC = cc
CXX = c++
CFLAGS = -O2
PREFIX = /usr/local
PYTHON = $(shell for p in python3 /usr/bin/python3; do $$p -c 'import pycparser' 2>/dev/null && echo $$p && break; done || echo python3)
FILTER =
GCC = gcc
GXX = g++
CLANG = clang
CLANGXX = clang++

, := ,
WARNINGS = -Wall -Wextra -Wpedantic -Wconversion -Wsign-conversion -Wshadow -Wundef -Wdouble-promotion -Wcast-qual \
	-Wvla
C_WARNINGS = $(WARNINGS) -Wstrict-prototypes -Wmissing-prototypes
# Of what holds the implementation: gcc looks for each line's indentation from the file's start, which takes 17 s of 31
# without optimisation. The sources are looked at one by one (make lint).
WHOLE = -Wno-misleading-indentation
INCLUDES = -I. -Itests -Ibuild
TEST_INCLUDES = -Ibuild/include $(INCLUDES)
# Tests of what is internal include headers of src/ and link with the implementation that all share, whose internals are
# extern for them. With an implementation of its own each would take longer to compile than all others together.
# Headers cut_*.h of tests are internal, too.
INTERNAL_TESTS = $(shell grep -lE '^\#(define SB_SPLIT_BUILD|include "cut_)' tests/test_*.c)

PRODUCTS = softbody needle register
HEADERS = $(PRODUCTS:%=%.h)
PARTS = $(filter-out %/names.h,$(sort $(shell find $(PRODUCTS:%=src/%) -type f)))
TESTS = $(wildcard tests/test_*.c)
TEST_UNITS = $(TESTS) tests/main.c tests/implementation.c
# Programs for devices need an SDK; tests build them against names of our own in tests/stubs.
ADAPTERS = examples/haptic_openhaptics.c examples/haptic_chai3d.cpp
# One has a window, of a library from the system's packages; without it the viewer is left out.
SDL_CFLAGS := $(shell sdl2-config --cflags 2>/dev/null)
VIEWER = examples/viewer.c
EXAMPLES = $(filter-out $(ADAPTERS) $(VIEWER),$(wildcard examples/*.c))
BENCHES = $(wildcard tests/bench/*.c)
FUZZERS = tests/fuzz/fuzz.c

.SUFFIXES:
.DELETE_ON_ERROR:
.PHONY: shared docs gallery bindings page test-page test-ports test-bindings tested all examples demo headers dev test check test-float test-cpp \
	test-openmp test-golden test-programs test-tsan test-host verification sanitize cross bench race benches lint fuzz \
	test-corpus soak soak-cuts coverage format install clean FORCE

all: examples

# ---- the headers -----------------------------------------------------------------------------------------------

build/amalgamate: src/amalgamate.c
	@mkdir -p build
	$(CC) -std=c99 $(C_WARNINGS) -O1 $< -o $@

AMALGAMATE = build/amalgamate src/$(1)/manifest.txt $(filter src/$(1)/%,$(PARTS))
$(HEADERS): %.h: build/amalgamate LICENSE $(PARTS)
	$(call AMALGAMATE,$*)

# The headers without their implementation, new only when a declaration is: what calls the library is then compiled again,
# and not after each change of a source.
DECLARATIONS = $(HEADERS:%=build/include/%)
.PRECIOUS: $(DECLARATIONS)
build/include/%.h: %.h
	@mkdir -p $(@D)
	@sed '/^\#if .*_IMPLEMENTATION_DONE)$$/,/^\#endif \/\* [A-Z]*_IMPLEMENTATION \*\//d' $< >$@.new
	@cmp -s $@.new $@ && rm $@.new || mv $@.new $@

headers: build/amalgamate
	$(foreach product,$(PRODUCTS),$(call AMALGAMATE,$(product)) &&) true
	@! $(PYTHON) -c 'import pycparser' 2>/dev/null || CC='$(CC)' $(PYTHON) src/bindings.py

# ---- programs --------------------------------------------------------------------------------------------------
# Each holds a copy of the implementation, which takes most of the time to build it. LIBRARY=build/double/implementation.o
# links examples and the soak with that object instead.
LIBRARY =
WITHOUT_IMPLEMENTATION = sed '/^\#define [A-Z]*_IMPLEMENTATION$$/d'
ifeq ($(LIBRARY),)
PROGRAM = $(CC) $(1) $< -lm -o $@
else
PROGRAM = $(WITHOUT_IMPLEMENTATION) $< | $(CC) $(1) -I$(<D) -x c - -x none $(LIBRARY) -lm -o $@
endif

# Examples are built as a user would: the header, the compiler's default language and -lm.
EXAMPLE_CFLAGS = -O3
examples: $(EXAMPLES:examples/%.c=build/%)

build/%: examples/%.c $(HEADERS) $(wildcard examples/*.h) build/flags $(LIBRARY)
	$(call PROGRAM,$(EXAMPLE_CFLAGS) -I.)

build/viewer: examples/viewer.c $(HEADERS) $(wildcard examples/*.h) build/flags
	@sdl2-config --version >/dev/null || { echo 'viewer needs SDL 2: libsdl2-dev, or sdl2 by brew or vcpkg'; false; }
	$(CC) $(EXAMPLE_CFLAGS) -I. $(SDL_CFLAGS) $< $$(sdl2-config --libs) -lm -o $@

# What tests run of them: linked with the implementation that the tests have.
PROGRAMS = $(EXAMPLES:examples/%.c=build/programs/%)
build/programs/%: examples/%.c $(wildcard examples/*.h) build/double/implementation.o
	@mkdir -p $(@D)
	$(WITHOUT_IMPLEMENTATION) $< | $(CC) $(OTHER_CFLAGS) -I. -I$(<D) -x c - -x none build/double/implementation.o -lm -o $@

PROGRAMS += $(if $(SDL_CFLAGS),build/programs/viewer)
build/programs/viewer: examples/viewer.c $(wildcard examples/*.h) build/double/implementation.o
	@mkdir -p $(@D)
	$(WITHOUT_IMPLEMENTATION) $< | $(CC) $(OTHER_CFLAGS) $(C_WARNINGS) -Werror -I. -I$(<D) $(SDL_CFLAGS) -x c - -x none \
	    build/double/implementation.o $$(sdl2-config --libs) -lm -o $@

STUBS = $(shell find tests/stubs -name '*.h')
PROGRAMS += $(patsubst examples/%,build/programs/%,$(basename $(ADAPTERS)))
build/programs/haptic_openhaptics: examples/haptic_openhaptics.c $(STUBS) $(wildcard examples/*.h) build/double/implementation.o
	@mkdir -p $(@D)
	$(WITHOUT_IMPLEMENTATION) $< | $(CC) $(OTHER_CFLAGS) $(C_WARNINGS) -Werror -I. -I$(<D) -Itests/stubs -x c - -x none \
	    build/double/implementation.o -lm -lpthread -o $@
build/programs/haptic_chai3d: examples/haptic_chai3d.cpp $(STUBS) $(wildcard examples/*.h) build/double/implementation.o
	@mkdir -p $(@D)
	$(WITHOUT_IMPLEMENTATION) $< | $(CXX) -std=c++11 $(OTHER_CFLAGS) $(WARNINGS) -Werror -I. -I$(<D) -Itests/stubs -x c++ - \
	    -x none build/double/implementation.o -lm -lpthread -o $@

# By the headers that are there: a fresh clone's sources may look newer, and make headers is for who changes them.
SHIPPED = -o build/amalgamate -o LICENSE $(PARTS:%=-o %)
demo:
	@$(MAKE) --no-print-directory -s $(SHIPPED) build/demo
	build/demo

# The three headers as a library that other languages load: examples/python, examples/csharp.
SHARED = build/libsoftbody.$(if $(filter Darwin,$(shell uname)),dylib,so)
shared: $(SHARED)
$(SHARED): examples/shared/softbody.c $(HEADERS) build/flags
	$(CC) -std=c99 $(EXAMPLE_CFLAGS) -fPIC -shared -fvisibility=hidden -DSB_SHARED -I. $< -lm -o $@
# The page of examples/web, in one file: clang, wasi-libc and lld.
PAGE_CFLAGS = -O2
WASI = $(CLANG) --target=wasm32-wasi --sysroot=/usr
page: build/page.html
build/page_flags: FORCE
	@mkdir -p build
	@echo '$(PAGE_CFLAGS)' | cmp -s - $@ || echo '$(PAGE_CFLAGS)' >$@
build/page.wasm: examples/web/page.c $(HEADERS) build/page_flags
	$(WASI) -mexec-model=reactor -std=c99 $(PAGE_CFLAGS) -DSB_ELEMENT=SB_TET4 -msimd128 -ffp-contract=off \
	    -Wl,-z,stack-size=1048576 -Wl,--strip-all $< -lm -o $@
build/page.html: build/page.wasm $(wildcard examples/web/*)
	examples/web/join.sh $< >$@
# The reference of the headers as static files: docs/reference/index.html.
DOCS = $(wildcard src/*/*_doc.h) $(foreach product,$(PRODUCTS),$(shell awk '/^section/ { on = $$2 == "declarations" } \
	on && /[.]h/ && !/names[.]h/ { print "src/$(product)/" $$1 }' src/$(product)/manifest.txt)) README.md $(wildcard docs/*.md)
docs:
	DOCS_INPUT='$(DOCS)' doxygen docs/Doxyfile
# The pictures of docs/gallery.md, which name the programs.
GALLERY = $(shell sed -n 's/^`build\/\([a-z_]*\).*/\1/p' docs/gallery.md)
gallery: $(GALLERY:%=build/%)
	$(PYTHON) docs/gallery.py build
bindings: $(HEADERS)
	CC='$(CC)' $(PYTHON) src/bindings.py

# ---- tests -----------------------------------------------------------------------------------------------------
# Holds the compilers and flags of the last build: objects follow when they change.
BUILT_WITH = $(CC) $(CXX) $(CFLAGS) $(EXAMPLE_CFLAGS) $(LIBRARY)
build/flags: FORCE
	@mkdir -p build
	@echo '$(BUILT_WITH)' | cmp -s - $@ || echo '$(BUILT_WITH)' >$@

# One line SUITE(name) for each CHECK_SUITE, whose name a formatter may have put on the line after it
LIST_SUITES = sed -n '/^CHECK_SUITE($$/N;s/^CHECK_SUITE([^a-z]*\([a-z0-9_]*\).*/SUITE(\1)/p'
build/suites.h: $(TESTS) Makefile
	@mkdir -p build
	$(LIST_SUITES) $(TESTS) >$@

# A call of every public function with every argument in turn replaced by an absurd one. A new function whose arguments
# tests/calls.txt has no rule for stops the build, by name.
build/calls.h: tests/calls.awk tests/calls.txt $(filter %.h,$(PARTS))
	@mkdir -p build
	awk -f tests/calls.awk tests/calls.txt $(filter %.h,$(PARTS)) >$@

# One build of the test program: $(call suite,NAME,COMPILER AND FLAGS,COMPILE FLAGS,LINK FLAGS,SUFFIX,TESTS) makes
# build/NAME/testsSUFFIX of these files, or all.
define suite
build/$(1)/%.o: tests/%.c $(DECLARATIONS) $(wildcard tests/*.h examples/*.h) build/flags
	@mkdir -p $$(@D)
	$(2) -Ibuild/$(1) $$(TEST_INCLUDES) $(3) $$(UNIT_CFLAGS) -c $$< -o $$@
$(INTERNAL_TESTS:tests/%.c=build/$(1)/%.o): $(filter %.h,$(PARTS))
build/$(1)/implementation.o: tests/implementation.c $(HEADERS) build/flags
	@mkdir -p $$(@D)
	$(2) $(INCLUDES) $(3) $(WHOLE) $(if $(filter $(INTERNAL_TESTS),$(or $(6),$(TESTS))),-DSB_SPLIT_BUILD) -c $$< -o $$@
build/$(1)/suites.h: $(or $(6),$(TESTS)) Makefile
	@mkdir -p $$(@D)
	$$(LIST_SUITES) $(or $(6),$(TESTS)) >$$@
build/$(1)/main.o: build/$(1)/suites.h
build/$(1)/test_hostile.o: build/calls.h
build/$(1)/tests$(5): $$(patsubst tests/%.c,build/$(1)/%.o,$(or $(6),$(TESTS)) tests/main.c tests/implementation.c)
	$(2) $$^ -lm $(4) -o $$@
endef

UNIT_CFLAGS = -O0 # of tests and parts that are compiled beside the whole implementation: that takes a fraction of the time
build/double/test_contact_sweep.o: UNIT_CFLAGS =# its look at every face is a fifth of what a sweep takes, and there are many
build/double/test_network_train.o: UNIT_CFLAGS =# training is in its header
# Null pointers and what is beyond an object are the address sanitizer's to see. Alignment and sums of pointers, at every
# access, cost a third of the time: the fuzz targets have them, and CHECK_ALL=1.
FEW_SANITIZERS = $(if $(CHECK_ALL),,-fno-sanitize=null$(,)object-size$(,)alignment$(,)pointer-overflow)
SANITIZERS = -fsanitize=address,undefined $(FEW_SANITIZERS) -fno-sanitize-recover=undefined -fno-omit-frame-pointer
SANITIZE_CFLAGS = -O1 -g
# Suites that touch most of what a language, a system or threads could change; the other builds are of all.
PORTABLE = core dense element material mesh meshio sparse pcg body step state record surface embed grid rod steer \
	couple kdtree cloud cpd field picture
THREADED = core step golden couple precond multigrid
# Suites with tests on several threads, and those tests.
TSAN_SUITES = anything assembly bbar cloud constraint couple cpd custom embed grid haptic integrators load mailbox mailbox_given match \
	multigrid nicp parts precond record schemes step stuffing surface viscoelastic
TSAN_FILTER = /threads /same multigrid/the cloud/normals grid/surfaces surface/batches record/plays
LONG = $(wildcard tests/test_verification_*.c tests/test_reference.c)
FLOAT_TESTS = $(TESTS)
some = $(1:%=tests/test_%.c)
OTHER_CFLAGS = -O1 # of the builds that differ in language or system only: they compile faster
MINGW = x86_64-w64-mingw32-gcc
ARM = aarch64-linux-gnu-gcc
WASM = $(WASI) -D_WASI_EMULATED_PROCESS_CLOCKS

$(eval $(call suite,double,$(CC) $(CFLAGS),-std=c99 $(C_WARNINGS)))
$(eval $(call suite,float,$(CC) $(CFLAGS),-std=c99 $(C_WARNINGS) -DSB_REAL=float,,,$(FLOAT_TESTS)))
$(eval $(call suite,cpp,$(CXX) $(OTHER_CFLAGS),-std=c++11 $(WARNINGS) -x c++,,,$(call some,$(PORTABLE))))
$(eval $(call suite,openmp,$(CC) $(OTHER_CFLAGS) -fopenmp,-std=c99 $(C_WARNINGS) -DSB_USE_OPENMP,,,$(call some,$(THREADED))))
$(eval $(call suite,tsan,$(CC) $(SANITIZE_CFLAGS) -fsanitize=thread,-std=c99 $(C_WARNINGS) -DCHECK_THREADS,-lpthread,,$(call some,$(TSAN_SUITES))))
$(eval $(call suite,sanitize,$(CC) $(SANITIZE_CFLAGS) $(SANITIZERS),-std=c99 $(C_WARNINGS),,,$(filter-out $(LONG),$(TESTS))))
$(eval $(call suite,mingw,$(MINGW) $(OTHER_CFLAGS),-std=c99 $(C_WARNINGS),-static,.exe,$(call some,$(PORTABLE))))
$(eval $(call suite,wasm,$(WASM) $(OTHER_CFLAGS),-std=c99 $(C_WARNINGS),-lwasi-emulated-process-clocks -Wl$(,)-z$(,)stack-size=1048576,.wasm,$(call some,$(PORTABLE))))

# Takes most of the suite's time; the builds that differ in language or system only leave it out (SLOW= runs all).
SLOW = -step/10,000 -step/1,000 -reference -contact_series $(patsubst tests/test_%.c,-%,$(wildcard tests/test_verification_*.c)) \
	-grid/badly -grid/weighted -grid/convergence -grid/stretched -grid/bars -match/livers -nicp/livers -loads/livers
QUICK = $(or $(FILTER),$(SLOW))
# Long too, and left to make check by make test.
SLOWER = -anything/violence -bbar/violence -body/quasi -body/reactions -checkpoint/continues -checkpoint/forged \
	-cloud/smooth -contact/balance -contact/grip -contact/hertz -contact/slide -contact_explicit/crowd \
	-contact_explicit/rest -contact_hostile/fall -contact_hostile/materials -contact_hostile/squeezed \
	-contact_hung/dragged -contact_hung/springs -contact_needle/balance -contact_organ -contact_pairs/folded \
	-contact_pairs/incline -contact_pairs/patch -contact_pairs/threads -contact_pairs/thrown -contact_pairs/undo \
	-contact_pairs/weight -contact_skin/equilibrium -contact_skin/Hertz -contact_state/forged -contact_state/no \
	-contact_state/recorded -contact_state/saved -contact_state/threads -contact_state/undo -contact_static/Hertz \
	-contact_substeps/random -contact_substeps/squeezed -contact_sweep/on -couple/rest -cpd/truncated \
	-cut_lattice/planes -forged/changed -guest/joint -integrators/explicit -integrators/orders \
	-live_mesh/iterations -live_pieces/slivers -load/1,000 -mesh/hostile -modes/leaves -modes/references \
	-multigrid/bodies -multigrid/jumps -multigrid/slivers -multigrid/weighted -needle/capacity -needle/no \
	-needle/steps -needle_control/random -needle_entry/entries -needle_entry/programs -needle_materials -needle_programs/a \
	-needle_programs/the -parts/of -parts/parts -remesh/allocations -schemes/300 -schemes/one -sensitivity_random/large -state/continues \
	-steer/no -step/Newmark -step/linearised -step/momentum -step/same -step/scale -step_guest/elements \
	-step_guest/materials -stuffing/plates -stuffing/random -stuffing/side -stuffing/surfaces -stuffing/thin \
	-stuffing/threads -surface/check -viscoelastic/static -viscoelastic/violence
# What make test leaves to the other builds besides.
LATER = -contact_adverse -contact_cut -contact_lips -contact_thrown -cut_force/tissue -cut_force/work -cut_glue/every \
	-cut_quad/half -cut_quad/slivers -cut_tear/blocks -cut_tear/energy -needle_held/law -needle_held/membranes \
	-needle_held/stiffness -particles/consistent -particles_body -pose \
	-bbar/Newton -cavity/injection -contact_momentum/flights -contact_needle/random -contact_pairs/curled \
	-cut_explicit/random -cut_follow/cables -cut_force/every -cut_glue/slivers -cut_loads/undo -cut_needle/between \
	-cut_quad/curved -cut_quad/states -cut_scissors/closing -cut_stress -cut_surface/what -forged/body -guide/random \
	-haptic/a -haptic/on -hostile -identify/large -infer/best -infer/curves -infer/landmarks -infer/points -infer/still -infer_pressure -infer_suite \
	-live_mesh/in -mixture/a -motion/threads -msml/meshers -needle_bevel/a -needle_held/holes -needle_mixture/nodule \
	-network_train/by -particles/regions -recorded/multigrid -register_cut/errors -rigid_together/contact \
	-rigid_together/random -rigid_together/tied -stuffing/allocation -stuffing/open -stuffing/ridges -track/features \
	-track/organs -unassembled/the -unassembled/threads
# Those of forged bytes and of memory that runs out, which are what the sanitizers are for.
HARMED = %/forged %/changed %/no %/capacity %/allocations %/hostile
# Long loops that the sanitizers would make longer still (the fuzz target `body` runs random ones under them), and long
# searches whose code others reach.
VIOLENT = -anything -pose -step -integrators -stuffing/surfaces -stuffing/ridges -schemes/300 -schemes/one \
	-viscoelastic/violence -load/1,000 -bbar -contact_sweep -contact_explicit -contact_pairs -contact_static \
	-contact_hung/dragged -contact_skin/equilibrium -contact_skin/Hertz -contact_thrown/schemes -contact_thrown/thrown \
	-contact_thrown/too -contact_thrown/tied -couple -cpd -cut_force/tissue -cut_force/work -cut_quad/half -loads \
	-multigrid/bodies -needle_programs/a -parts/parts -thin -contact_lips/pressed -contact_lips/thrown -cut_quad/slivers \
	-cut_tear/blocks -cut_tear/energy -infer/frames -infer/organs -needle_held/law -needle_held/membranes \
	-needle_held/stiffness -particles/consistent -particles_body/drift -particles_body/zero
LINKED = mesh record # what the split build is tried with: their tests are those of the other builds

SNIPPET_CFLAGS = -O0
SNIPPETS = CC='$(CC)' CFLAGS='$(SNIPPET_CFLAGS)' tests/snippets.sh build/snippets build/double/implementation.o $(HEADERS) README.md docs/questions.md
TOOL_TEST = tests/amalgamate.sh build/amalgamate build/amalgamate_test

EXAMPLE_TEST = tests/examples.sh build/programs build/examples_test
SHORT_PROGRAM_TESTS = "$(TOOL_TEST)" "$(SNIPPETS)" "tests/case.sh build/programs/case_solve build/case_test" $(CORPUS_TESTS)
PROGRAM_TESTS = "$(EXAMPLE_TEST)" $(SHORT_PROGRAM_TESTS)
tested: build/double/tests build/amalgamate build/fuzz/plain $(PROGRAMS)

# What a user waits for: built and run on all cores, the longest pieces first so that no core waits for another, long loops
# cut short, the slowest tests left to make check. -O1 unless CFLAGS are given: the implementation takes half as long to
# compile, tests hardly longer.
ifeq ($(FILTER),)
test:
	@$(MAKE) --no-print-directory -j$$(nproc) tested $(if $(filter file,$(origin CFLAGS)),CFLAGS=-O1)
	CHECK_QUICK=1 CHECK_SHORT=1 TOTAL_JOBS=$$(nproc) tests/total.sh \
	    "$(EXAMPLE_TEST)" $(foreach part,1 2 3 4 5 6 7 8,"build/double/tests $(part)/8 $(SLOW) $(SLOWER) $(LATER)") \
	    $(SHORT_PROGRAM_TESTS)
else
test: build/double/tests
	build/double/tests $(FILTER)
endif
test-page:
	tests/total.sh "MAKE='$(MAKE)' CLANG='$(CLANG)' tests/page.sh build/page_test"
test-ports: $(HEADERS)
	tests/total.sh "MAKE='$(MAKE)' CC='$(CC)' tests/ports.sh build/ports"
test-bindings: $(HEADERS)
	tests/total.sh "CC='$(CC)' tests/bindings.sh build/bindings"
test-programs: tested
	tests/total.sh $(PROGRAM_TESTS)
test-float: build/float/tests
	build/float/tests $(FILTER)
test-cpp: build/cpp/tests
	build/cpp/tests $(QUICK)
test-openmp: build/openmp/tests
	build/openmp/tests $(or $(FILTER),$(SLOW))
test-tsan: build/tsan/tests
	CHECK_QUICK=1 TSAN_OPTIONS=halt_on_error=1 build/tsan/tests $(or $(FILTER),$(TSAN_FILTER))

# The tests in double, and what runs each of them as a strict host would: on a stack of its own, where an operation that is
# invalid, divides by 0 or overflows is a signal, and with memory that held something else before (glibc fills it).
STACK = 131072
build/host/main.o: tests/main.c tests/check.h build/double/suites.h build/flags
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) -Ibuild/double $(TEST_INCLUDES) -std=c99 $(C_WARNINGS) -DCHECK_STACK=$(STACK) -DCHECK_TRAPS -c $< -o $@
build/host/tests: build/host/main.o $(filter-out %/main.o,$(TEST_UNITS:tests/%.c=build/double/%.o))
	$(CC) $(CFLAGS) $^ -lm -lpthread -o $@
# Tests whose own variables take 80 kB and more, a suite that compares the NaN that it hands over, and one with a solid of
# 1e-7 of its sheet's stiffness, which leaves the range of the preconditioner's floats on the way, and steps of heat so
# long that numbers overflow: they run without traps.
LENIENT = -embed/no -live_mesh/random -live_mesh/the -material_fit/refused -verification_membranes -heat/long -output/a -output/devices -picture/png -hostile
test-host: build/host/tests build/double/tests
	MALLOC_PERTURB_=1 tests/total.sh "build/host/tests $(or $(FILTER),$(LENIENT))" $(if $(FILTER),,"build/double/tests $(LENIENT:-%=%)")
sanitize: build/sanitize/tests
	CHECK_QUICK=1 CHECK_SHORT=1 ASAN_OPTIONS=detect_leaks=1 build/sanitize/tests $(or $(FILTER),$(SLOW) $(filter-out $(HARMED),$(SLOWER)) $(VIOLENT))

# The table of cases against closed forms: its introduction is written by hand, its rows by the tests, a section for
# each suite. `make check` compares the list of cases with the committed one.
VERIFICATION = $(patsubst tests/test_%.c,%,$(wildcard tests/test_verification_*.c))
verification: build/double/tests
	rm -rf build/verification && mkdir -p build/verification
	VERIFICATION=build/verification build/double/tests $(VERIFICATION)
	sed '/^$$/N;/\n## /,$$d' tests/verification.md >build/verification/introduction
	cat build/verification/introduction $(VERIFICATION:%=build/verification/%.md) >tests/verification.md

# The tests named golden... hold results as constants: the library and these tests, built by each compiler at each
# optimisation, also where fused multiply-add is to be had, with wider vectors, narrower ones and none, must give the
# same bits. (The library sees to that for its own code only, so the tests' code gets the flag.)
GOLDEN_TESTS = $(shell grep -l '"golden' $(TESTS))
GOLDEN_UNITS = tests/implementation.c $(GOLDEN_TESTS)
GOLDEN_NAMES = gcc-O0 gcc-O2 gcc-O3 clang-O0 clang-O2 clang-O3
GOLDEN_FUSING = gcc-O2 gcc-O3 clang-O3 # those that could fuse a product and a sum, where the processor can

build/golden/suites.h: $(GOLDEN_TESTS) Makefile
	@mkdir -p $(@D)
	$(LIST_SUITES) $(GOLDEN_TESTS) >$@
build/golden/main.o: tests/main.c tests/check.h build/golden/suites.h build/flags
	$(CC) $(CFLAGS) -Ibuild/golden $(TEST_INCLUDES) -std=c99 $(C_WARNINGS) -c $< -o $@

NO_AVX512 = $(shell $(GCC) -mno-avx512f -E -x c /dev/null >/dev/null 2>&1 && echo -mno-avx512f)
define golden
build/golden-$(1)/%.o: tests/%.c $(HEADERS) $(wildcard tests/*.h examples/*.h)
	@mkdir -p $$(@D)
	$(2) $(INCLUDES) $$(if $$(filter %/implementation.c,$$<),,-ffp-contract=off) -c $$< -o $$@
build/golden-$(1)/tests: $$(GOLDEN_UNITS:tests/%.c=build/golden-$(1)/%.o) build/golden/main.o
	$(CC) $(CFLAGS) $$^ -lm -o $$@
endef
$(eval $(call golden,gcc-O0,$(GCC) -std=c99 -O0))
$(eval $(call golden,gcc-O2,$(GCC) -std=gnu99 -O2 -march=native $(NO_AVX512)))
$(eval $(call golden,gcc-O3,$(GCC) -std=gnu99 -O3 -march=native))
$(eval $(call golden,clang-O0,$(CLANG) -std=c99 -O0))
$(eval $(call golden,clang-O2,$(CLANG) -std=c99 -O2 -DSB_NO_VECTORS))
$(eval $(call golden,clang-O3,$(CLANG) -std=gnu99 -O3 -march=native))

test-golden: $(GOLDEN_NAMES:%=build/golden-%/tests)
	tests/total.sh $(^:%='% /golden') "tests/fused.sh $(patsubst %,build/golden-%/implementation.o,$(filter $(GOLDEN_NAMES),$(GOLDEN_FUSING)))"
# On 64-bit ARM the golden results, too.
$(eval $(call suite,aarch64,$(ARM) $(OTHER_CFLAGS),-std=c99 $(C_WARNINGS),-static,,$(sort $(call some,$(PORTABLE)) $(GOLDEN_TESTS))))

cross:
	MAKE='$(MAKE)' FILTER='$(QUICK)' tests/cross.sh

# ---- lint ------------------------------------------------------------------------------------------------------
# Every unit with every compiler, language and precision, warnings as errors: each source alone (which keeps the
# floors honest), the header with and without its implementation, tests; examples and benchmarks in double.

LINT_UNITS = $(filter %.c,$(PARTS)) $(TEST_UNITS) tests/link/declarations.c $(FUZZERS) \
	$(wildcard tests/snippets/*.c)
LINT_UNITS_double = $(EXAMPLES) $(BENCHES) tests/soak.c tests/soak_haptic.c
LINTS = gcc-double gcc-float clang-double clang-float gxx-double gxx-float clangxx-double clangxx-float
LINT_STD = $(if $(filter examples/% tests/bench/%,$<),-std=gnu11,-std=c99) # programs may read clocks
LINT_gcc = $(GCC) $(LINT_STD) $(C_WARNINGS)
LINT_clang = $(CLANG) $(LINT_STD) $(C_WARNINGS)
LINT_gxx = $(GXX) -std=c++11 $(WARNINGS) -x c++
LINT_clangxx = $(CLANGXX) -std=c++11 $(WARNINGS) -x c++

# $(call lint,COMPILER,REAL): gcc optimises the implementation, since some of its warnings need that. (make check leaves that
# to the builds of tests, which have the same warnings as errors.)
LINT_OPTIMISED = gcc gxx
define lint
build/lint/$(1)-$(2)/%.ok: %.c $(HEADERS) build/suites.h build/calls.h $(wildcard tests/*.h tests/*/*.h examples/*.h)
	@mkdir -p $$(@D)
	$$(LINT_$(1)) -Werror -DSB_REAL=$(2) $(INCLUDES) -fsyntax-only $$<
	@touch $$@
build/lint/$(1)-$(2)/src/%.ok: src/%.c $(HEADERS)
	@mkdir -p $$(@D)
	$$(LINT_$(1)) -Werror -DSB_REAL=$(2) -DSB_SPLIT_BUILD -fsyntax-only $$<
	@touch $$@
build/lint/$(1)-$(2)/tests/implementation.ok build/lint/$(1)-$(2)/tests/link/declarations.ok: \
build/lint/$(1)-$(2)/tests/%.ok: tests/%.c $(HEADERS)
	@mkdir -p $$(@D)
	$$(LINT_$(1)) -Werror -DSB_REAL=$(2) $(WHOLE) $(INCLUDES) $(if $(filter $(LINT_OPTIMISED),$(1)),-O2 -c -o $$(@:.ok=.o),-fsyntax-only) $$<
	@touch $$@
LINT_OK += $(patsubst %.c,build/lint/$(1)-$(2)/%.ok,$(LINT_UNITS) $(LINT_UNITS_$(2)))
endef
$(foreach pair,$(LINTS),$(eval $(call lint,$(word 1,$(subst -, ,$(pair))),$(word 2,$(subst -, ,$(pair))))))

# The rooms as objects of their own, linked into the test program. Each follows the sources it includes, so that a change
# of one room compiles one room: make dev FILTER="step load".
SPLIT = $(patsubst src/%.c,build/split/%.o,$(filter %.c,$(PARTS)))
build/split/%.o: src/%.c build/flags
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) -std=c99 $(C_WARNINGS) -Werror -DSB_SPLIT_BUILD $(UNIT_CFLAGS) -MMD -MP -c $< -o $@
build/split/tests: $(SPLIT) $(filter-out %/implementation.o,$(TEST_UNITS:tests/%.c=build/double/%.o))
	$(CC) $(CFLAGS) $^ -lm -o $@
-include $(SPLIT:.o=.d)

dev: build/split/tests
	build/split/tests $(FILTER)

lint: $(LINT_OK) build/split/tests
	tests/total.sh "build/split/tests $(or $(FILTER),$(LINKED))" "tests/order.sh build/split" "GCC='$(GCC)' CLANG='$(CLANG)' GXX='$(GXX)' tests/link.sh build/link"

# ---- all that CI runs ------------------------------------------------------------------------------------------

check:
	tests/check.sh

# ---- benchmarks and fuzzing ----------------------------------------------------------------------------------

BENCH_CFLAGS = -O3 -march=native -std=gnu11 -ffp-contract=off -fopenmp -DSB_USE_OPENMP
build/bench/%: tests/bench/%.c $(HEADERS) $(wildcard tests/*.h tests/bench/*.h examples/*.h)
	@mkdir -p $(@D)
	$(CC) $(BENCH_CFLAGS) $(INCLUDES) $< -lm -o $@

benches: $(BENCHES:tests/bench/%.c=build/bench/%)
bench: $(BENCHES:tests/bench/%.c=build/bench/%)
	@for bench in $^; do for threads in 1 $$(nproc); do \
	    echo "# $$bench, OMP_NUM_THREADS=$$threads" && OMP_NUM_THREADS=$$threads $$bench || exit 1; done; done
	@$(MAKE) --no-print-directory race

# The tables and plots of tests/bench/race.md, or, unless all racers take part, in build/race. Half an hour.
# RACE_SYSTEMS="beam_tet4_13k ..." tries some systems only.
race: $(HEADERS) build/bench/bench_step build/bench/bench_jumps
	CC='$(CC)' CXX='$(CXX)' CFLAGS='$(BENCH_CFLAGS)' tests/bench/race/race.sh build/race

# Fuzz targets are functions of one program. Where clang has libFuzzer it does the fuzzing, under the sanitizers;
# elsewhere the program mutates the corpus by itself. The corpus is also a test.
FUZZ_SECONDS = 10
FUZZ_CFLAGS = -O1 -g
FUZZ_TARGETS = vtk gmsh tetgen surface geometry mesh case inp xml feb msml state record network body cloud vtu medit \
	needle_state needle_program icp cpd match nicp precond image igtl
FUZZ_PARTS = $(FUZZERS) $(HEADERS) $(wildcard tests/fuzz/*.h examples/*.h)
CORPUS_TESTS = $(foreach target,$(FUZZ_TARGETS),"build/fuzz/plain $(target) tests/fuzz/corpus/$(target)/*")
CAN_FUZZ = $(shell echo 'int LLVMFuzzerTestOneInput(void); int LLVMFuzzerTestOneInput(void) { return 0; }' | \
	$(CLANG) -fsanitize=fuzzer,address -x c - -o /dev/null 2>/dev/null && echo yes)

# clang compiles it in a third of the time.
build/fuzz/plain: $(FUZZ_PARTS) build/flags
	@mkdir -p $(@D) build/fuzz_case
	$(shell command -v $(CLANG) || echo $(CC)) -std=c99 $(UNIT_CFLAGS) -w $(INCLUDES) $(FUZZERS) -lm -o $@
build/fuzz/libfuzzer: $(FUZZ_PARTS)
	@mkdir -p $(@D) build/fuzz_case
	$(CLANG) -std=c99 $(FUZZ_CFLAGS) -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=undefined -DFUZZ_LIBFUZZER \
	    $(INCLUDES) $(FUZZERS) -lm -o $@

test-corpus: build/fuzz/plain
	tests/total.sh $(CORPUS_TESTS)

# libFuzzer puts what it finds worth keeping into build/fuzz/found, and starts from it next time.
FUZZ_WITH = $(if $(CAN_FUZZ),libfuzzer,plain)
FUZZ_OPTIONS = -max_total_time=$(FUZZ_SECONDS) -max_len=4096 -timeout=60 -verbosity=0 -print_final_stats=1
FUZZ_RUN_plain = build/fuzz/plain $(1) -$(FUZZ_SECONDS) tests/fuzz/corpus/$(1)/*
define FUZZ_RUN_libfuzzer
FUZZ_TARGET=$(1) build/fuzz/libfuzzer $(FUZZ_OPTIONS) -artifact_prefix=build/fuzz/$(1)- build/fuzz/found/$(1) \
tests/fuzz/corpus/$(1) >build/fuzz/$(1).log 2>&1 || { tail -n 40 build/fuzz/$(1).log; false; } && \
sed -n 's/.*executed_units/$(1)/p' build/fuzz/$(1).log && echo '1 passed, 0 failed, 0 skipped'
endef

fuzz: build/fuzz/$(FUZZ_WITH)
	@mkdir -p $(FUZZ_TARGETS:%=build/fuzz/found/%)
	tests/total.sh $(foreach target,$(FUZZ_TARGETS),"$(call FUZZ_RUN_$(FUZZ_WITH),$(target))")

# ---- soak and coverage -----------------------------------------------------------------------------------------

build/soak: tests/soak.c $(HEADERS) tests/check.h tests/scene.h build/flags $(LIBRARY)
	$(call PROGRAM,-std=c99 $(CFLAGS) $(C_WARNINGS) $(WHOLE) $(INCLUDES))

build/soak_haptic: tests/soak_haptic.c $(HEADERS) tests/check.h tests/haptic_hand.h build/flags
	$(CC) -std=c99 $(CFLAGS) $(C_WARNINGS) $(WHOLE) $(INCLUDES) $< -lm -o $@

# Processes share a soak by ranges: sweeps CHECK_FIRST .. CHECK_FIRST + CHECK_SLOW - 1 of each kind, as here by SOAK_FIRST
# and SOAK_SWEEPS, and hours of other hands by SOAK_SEED. On N cores, for i of 0 .. N - 1 at a time:
#     CHECK_FIRST=$((i * 83334 / N)) CHECK_SLOW=$((83334 / N + 1)) build/sweeps/tests      a million sweeps in all
#     SOAK_SEED=$((2026 + i)) SOAK_HOURS=$((24 / N + 1)) build/soak_haptic                  a day of each hand
# make build/sweeps/tests build/soak_haptic CFLAGS='-O3 -march=native' UNIT_CFLAGS= makes both as fast as they get; -static
# too, to run them elsewhere.
$(eval $(call suite,sweeps,$(CC) $(CFLAGS),-std=c99 $(C_WARNINGS),,,$(call some,contact_sweep)))
SWEEP_KINDS = 12# of tests/test_contact_sweep.c, without meshes
SWEEPS = build/double/tests # as check has made it already
soak: build/soak build/soak_haptic build/double/tests $(SWEEPS)
	tests/total.sh "SOAK_STEPS='$(SOAK_STEPS)' SOAK_SECONDS='$(SOAK_SECONDS)' build/soak" \
	    "SOAK_HOURS='$(SOAK_HOURS)' SOAK_SECONDS='$(SOAK_SECONDS)' SOAK_SEED='$(SOAK_SEED)' build/soak_haptic" \
	    "CHECK_SLOW=$$(($(or $(SOAK_SWEEPS),1000000) / $(SWEEP_KINDS) + 1)) CHECK_FIRST='$(SOAK_FIRST)' \
	    CHECK_SECONDS='$(SOAK_SECONDS)' $(SWEEPS) contact_sweep" \
	    "$(SOAK_CUT)"

SOAK_CUT = CHECK_SLOW='$(or $(SOAK_CUTS),200)' CHECK_FIRST='$(SOAK_FIRST)' CHECK_SECONDS='$(SOAK_SECONDS)' \
	build/double/tests cut_stress -cut_stress/crumbs # which are the same each time, and among the tests
soak-cuts: build/double/tests
	tests/total.sh "$(SOAK_CUT)"

# gcc's counters; functions that every unit has of its own count as run when one of them was.
COVERAGE_UNITS = $(TEST_UNITS:tests/%.c=build/coverage/%.o)
$(eval $(call suite,coverage,$(GCC) -O1 -g --coverage -fno-inline,-std=c99))
coverage: build/coverage/tests build/coverage/case_solve
	rm -f build/coverage/*.gcda
	build/coverage/tests $(QUICK) >build/coverage/log; tail -n 1 build/coverage/log
	$(if $(FILTER),,tests/case.sh build/coverage/case_solve build/coverage/case | tail -n 1)
	tests/coverage.sh build/coverage

build/coverage/case_solve: examples/case_solve.c $(HEADERS) $(wildcard examples/*.h)
	@mkdir -p $(@D)
	$(GCC) -O1 -g --coverage -fno-inline -I. $< -lm -o $@

# ---- install ---------------------------------------------------------------------------------------------------

build/softbody.pc: Makefile softbody.h FORCE
	@mkdir -p build
	@printf '%s\n' 'prefix=$(PREFIX)' 'includedir=$${prefix}/include' '' 'Name: softbody' \
	    'Description: soft tissue, needles and registration, each in a single C header' \
	    "Version: $$(sed -n 's/^#define SB_VERSION_STRING "\(.*\)"/\1/p' softbody.h)" \
	    'Cflags: -I$${includedir}/softbody' 'Libs: -lm' >$@

install: $(HEADERS) build/softbody.pc
	mkdir -p '$(DESTDIR)$(PREFIX)/include/softbody' '$(DESTDIR)$(PREFIX)/share/pkgconfig'
	cp $(HEADERS) '$(DESTDIR)$(PREFIX)/include/softbody/'
	cp build/softbody.pc '$(DESTDIR)$(PREFIX)/share/pkgconfig/'

# Optional: lays out all sources by .clang-format.
# Other versions of clang-format break other lines; FORMAT=--dry-run only says what differs.
FORMATTED = $(shell find src tests examples -name '*.[ch]' ! -name names.h)
FORMAT = -i
format:
	clang-format $(FORMAT) $(FORMATTED)

clean:
	rm -rf build
