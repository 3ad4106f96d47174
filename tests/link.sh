#!/bin/sh
# How the headers link: run as `tests/link.sh FOLDER` from the root, objects go to FOLDER. Compilers from GCC, CLANG,
# GXX, MINGW, OBJDUMP; a missing one is a skip. Ends with `N passed, N failed, N skipped`.
folder=$1
gcc=${GCC:-gcc} clang=${CLANG:-clang} gxx=${GXX:-g++} objdump=${OBJDUMP:-objdump}
include="-I. -Itests"
whole=-Wno-misleading-indentation # gcc takes 17 s to look for it in the implementation; lint does so source by source
passed=0 failed=0 skipped=0
rm -rf "$folder"
mkdir -p "$folder"

report() { # report STATUS NAME: counts a check that is good when STATUS is 0
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
c() { # c OBJECT SOURCE [FLAG...]
    object=$folder/$1 source=$2
    shift 2
    "$compiler" -std=c99 $include -Wall -Wextra -Werror $whole "$@" -c "$source" -o "$object" || report 1 "compile $source $*"
}
cpp() {
    object=$folder/$1 source=$2
    shift 2
    "$gxx" -std=c++11 $include -Wall -Wextra -Werror "$@" -x c++ -c "$source" -o "$object" ||
        report 1 "compile $source as C++"
}
links() { # links NAME OBJECT...: the objects make a program that succeeds
    name=$1
    shift
    (cd "$folder" && "$gxx" "$@" -lm -o program && ./program)
    report $? "$name"
}

compiler=$gcc
c implementation.o tests/implementation.c
c implementation_float.o tests/implementation.c -DSB_REAL=float
c declarations.o tests/link/declarations.c
c declarations_float.o tests/link/declarations.c -DSB_REAL=float
cpp declarations_cpp.o tests/link/declarations.c
cpp implementation_cpp.o tests/implementation.c
# clang compiles implementations four times as fast, and a program has objects of both
command -v "$clang" >/dev/null && compiler=$clang
c late.o tests/link/late.c
c static_first.o tests/link/static_first.c
c static_second.o tests/link/static_second.c
c both_reals.o tests/link/both_reals.c
c both_reals_float.o tests/link/both_reals_float.c

links "two units" declarations.o implementation.o
links "two units in float" declarations_float.o implementation_float.o
links "C++ caller, C implementation" declarations_cpp.o implementation.o
links "C caller, C++ implementation" declarations.o implementation_cpp.o
links "declarations before the implementation in one unit" declarations.o late.o
links "SB_STATIC twice, two precisions" static_first.o static_second.o
links "double and float in one program" both_reals.o both_reals_float.o implementation.o
for element in SB_TET10 ${CHECK_ALL:+SB_TET4 SB_HEX27 SB_CUSTOM}; do
    c pinned.o tests/implementation.c -DSB_ELEMENT=$element
    links "SB_ELEMENT $element" declarations.o pinned.o
    rm -f "$folder/pinned.o"
done

# What a trainer may leave out: a body is made and stepped without it, and its public functions are gone.
for left_out in "" "-DSB_NO_FILES -DSB_NO_CUT" -DSB_NO_GEOMETRY "-DSB_NO_CONTACT -DSB_NO_IDENTIFY -DSB_NO_PARTICLES -DSB_NO_HEAT -DSB_NO_NETWORK" \
    "-DSB_NO_FILES -DSB_NO_GEOMETRY -DSB_NO_CONTACT -DSB_NO_CUT -DSB_NO_IDENTIFY -DSB_NO_HEAT -DSB_NO_NETWORK"; do
    c switches.o tests/link/switches.c $left_out
    links "made and stepped: ${left_out:-all}" switches.o
    files=1 geometry=1 contact=1 cut=1 identify=1 particles=1 heat=1 network=1
    case $left_out in *FILES*) files=0 ;; esac
    case $left_out in *GEOMETRY*) geometry=0 contact=0 particles=0 ;; esac # tools and particles need surfaces
    case $left_out in *PARTICLES*) particles=0 ;; esac
    case $left_out in *CONTACT*) contact=0 ;; esac
    case $left_out in *CUT*) cut=0 ;; esac
    case $left_out in *IDENTIFY*) identify=0 ;; esac
    case $left_out in *HEAT*) heat=0 ;; esac
    case $left_out in *NETWORK*) network=0 ;; esac
    there=
    for name in sb_mesh_load sb_surface_create sb_contact_create sb_cut_create sb_body_gradient sb_particles_create \
        sb_heat_create sb_network_load; do
        there=$there$(nm "$folder/switches.o" | grep -c " T $name\$")
    done
    [ "$there" = $files$geometry$contact$cut$identify$particles$heat$network ]
    report $? "left out: ${left_out:-nothing}"
done
c needle_alone.o tests/link/needle_alone.c -DSB_NO_FILES -DSB_NO_CONTACT -DSB_NO_CUT
links "needle.h without files, contact and cuts" needle_alone.o
refuses() { # refuses HEADER MESSAGE FLAG...: the header stops the compiler and says why
    header=$1 message=$2
    shift 2
    ! echo "#include \"$header\"" | "$gcc" -std=c99 $include "$@" -fsyntax-only -x c - 2>"$folder/message" &&
        grep -q "#error.*$message" "$folder/message"
    report $? "$header with $*"
}
refuses needle.h "needle.h needs the surfaces" -DSB_NO_GEOMETRY
refuses register.h "register.h needs the surfaces and file readers" -DSB_NO_GEOMETRY
refuses register.h "register.h needs the surfaces and file readers" -DSB_NO_FILES

(cd "$folder" && "$gcc" declarations_float.o implementation.o -lm -o mismatch 2>/dev/null)
report $((! $?)) "a float caller and a double object must not link"

# Exported names: sb_, ndl_, reg_ and nothing else; _f32 at the end in float and only there; none under SB_STATIC.
exported() { nm -g --defined-only "$folder/$1" | awk '{print $3}'; }
[ -n "$(exported implementation.o)" ] && ! exported implementation.o | grep -v '^\(sb\|ndl\|reg\)_' &&
    ! exported implementation.o | grep '_f32$'
report $? "names exported by a double object"
[ -n "$(exported implementation_float.o)" ] && ! exported implementation_float.o | grep -v '^\(sb\|ndl\|reg\)_.*_f32$'
report $? "names exported by a float object"
! exported static_first.o | grep -v '^main$'
report $? "names exported under SB_STATIC"

# A shared library under -fvisibility=hidden: with SB_SHARED it exports the public functions, all of them and nothing else,
# without it nothing; callers in C and C++ find them. What stands before public functions may also be given.
public() { nm -g --defined-only "$folder/$1" | awk '$2 == "T" {print $3}' | sort; }
shared() { # shared NAME [FLAG...]: builds NAME.so, writes what it exports to NAME.exports
    library=$1
    shift
    c "$library.o" tests/implementation.c -fPIC -fvisibility=hidden "$@"
    "$gcc" -shared "$folder/$library.o" -lm -o "$folder/$library.so" &&
        nm -D --defined-only "$folder/$library.so" | awk '$2 == "T" {print $3}' | sort >"$folder/$library.exports"
}
public implementation.o >"$folder/public"
shared shared -DSB_SHARED && cmp -s "$folder/public" "$folder/shared.exports"
report $? "SB_SHARED exports every public function"
shared hidden && ! grep . "$folder/hidden.exports"
report $? "nothing exported under hidden visibility without SB_SHARED"
shared given '-DSB_API=__attribute__((visibility("default")))' && cmp -s "$folder/public" "$folder/given.exports"
report $? "SB_API given: every public function of the three headers"
shared part '-DREG_API=__attribute__((visibility("default")))' && [ -s "$folder/part.exports" ] &&
    ! grep -v '^reg_' "$folder/part.exports"
report $? "REG_API given: that header's functions alone"
c shared_user.o tests/link/shared_user.c
cpp shared_user_cpp.o tests/link/shared_user.c
links "C caller of a shared library" shared_user.o shared.so -Wl,-rpath,.
links "C++ caller of a shared library" shared_user_cpp.o shared.so -Wl,-rpath,.
c room_static.o tests/link/room_static.c
links "NDL_STATIC and REG_STATIC" room_static.o
! exported room_static.o | grep -v "^sb_\|^main$"
report $? "names exported under NDL_STATIC and REG_STATIC"

# A DLL: exported from there, imported by its callers.
mingw=${MINGW:-x86_64-w64-mingw32-gcc}
if command -v "$mingw" >/dev/null; then
    "$mingw" -std=c99 $include -Wall -Wextra -Werror $whole -DSB_SHARED -shared tests/implementation.c -o "$folder/shared.dll" \
        -Wl,--out-implib,"$folder/shared.lib" &&
        "$mingw" -std=c99 $include -Wall -Wextra -Werror -c tests/link/shared_user.c -o "$folder/shared_user.obj" &&
        "$mingw" "$folder/shared_user.obj" "$folder/shared.lib" -o "$folder/shared_user.exe" &&
        "${mingw%gcc}nm" "$folder/shared_user.obj" | grep -q __imp_sb_result_string
    report $? "a DLL of MinGW and its caller"
    "${mingw%gcc}objdump" -p "$folder/shared.dll" | sed -n 's/^.*\[ *[0-9]*\].* \([a-z]*_[a-z0-9_]*\)$/\1/p' | sort |
        cmp -s "$folder/public" -
    report $? "a DLL exports every public function and nothing else"
else
    skip "no $mingw: DLL"
fi

# cl's language, as far as clang knows it: no GNU extension, and no `restrict` before /std:c11.
if command -v "$clang" >/dev/null && [ -d /usr/include ]; then
    cl="$clang --target=x86_64-pc-windows-msvc -fms-compatibility -fms-extensions -w -fsyntax-only -isystem /usr/include"
    cl="$cl -isystem /usr/include/$(uname -m)-linux-gnu $include -Drestrict=no_such_word"
    # this system's names for what a Windows C library has under others
    cl="$cl -include sys/stat.h -D_stat=stat -D_fstat=fstat -D_fileno=fileno -D_S_IFMT=0170000 -D_S_IFREG=0100000"
    for language in "-x c -std=c99" "-x c -std=c99 -DSB_REAL=float" "-x c++ -std=c++14" "-x c++ -std=c++20"; do
        $cl $language tests/implementation.c
        report $? "cl's dialect: $language"
    done
else
    skip "no $clang with system headers: cl's dialect"
fi

# Nothing that C++20 deprecates.
for compiler in "$gxx" "$clang++"; do
    if echo 'int main() { return 0; }' | "$compiler" -std=c++20 -x c++ -fsyntax-only - 2>/dev/null; then
        "$compiler" -std=c++20 $include -Wall -Wextra -Wpedantic -Wdeprecated -Werror -x c++ -fsyntax-only tests/implementation.c
        report $? "C++20 by $compiler"
    else
        skip "no $compiler for C++20"
    fi
done

# Writable data: no symbol in .data, .bss or a common block, in either precision. (Constant tables of pointers to
# functions lie in .data.rel.ro, which is read-only once the program has been loaded.)
for object in implementation.o implementation_float.o; do
    ! "$objdump" -t "$folder/$object" | grep -v '[.]data[.]rel[.]ro' | grep ' O .*[.]data\| O .*bss\|[*]COM[*]'
    report $? "no writable data in $object"
done

# A product and a sum stay two roundings even where the language mode and the target allow one.
case $(uname -m) in
x86_64)
    for compiler in "$gcc -O1" "$clang -O0"; do # where each of them fuses, if it may
        if ! command -v ${compiler% *} >/dev/null; then
            skip "no $compiler: contraction"
            continue
        fi
        $compiler -std=gnu99 $include -mavx2 -mfma -c tests/implementation.c -o "$folder/contraction.o"
        OBJDUMP=$objdump tests/fused.sh "$folder/contraction.o" >"$folder/message"
        fused=$?
        [ $fused = 0 ] || cat "$folder/message"
        report $fused "no fused multiply-add from $compiler -std=gnu99 -mfma"
    done
    ;;
*) skip "fused instructions are looked for on x86-64 only" ;;
esac

echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" = 0 ]
