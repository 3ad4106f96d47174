#!/bin/sh
# The headers as packages: run as `tests/ports.sh FOLDER` from the root. Each is installed into an empty prefix or taken as a
# dependency, and tests/ports/app.c is built with it and run. CC and MAKE from the environment. A tool that is missing is a skip; the
# recipes for vcpkg and Conan then run with the stubs of tests/ports. Ends with `N passed, N failed, N skipped`.
folder=$1
make=${MAKE:-make}
has() { command -v "$1" >/dev/null; }
cc=${CC:-cc}
has clang && cc=clang # compiles implementations four times as fast
CC=$cc && export CC   # CMake and Meson take it from there
unset CFLAGS CXXFLAGS # and these, which check gives to make: nothing here needs to be fast
passed=0 failed=0 skipped=0
rm -rf "$folder"
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
here=$(pwd)/tests/ports
app=$here/app.c

report() { # report STATUS NAME
    if [ "$1" = 0 ]; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        echo "FAILED: $2"
        tail -n 20 "$folder/log"
    fi
}
skip() {
    skipped=$((skipped + 1))
    echo "skip: $1"
}
runs() { # runs PROGRAM: it does a step and prints the version
    [ "$("$1")" = "$version" ]
}
sources() { # sources FOLDER: what a package is made of, away from the tree, into which some tools write
    mkdir -p "$1" && cp -r --parents ./*.h LICENSE CMakeLists.txt meson.build build.zig build.zig.zon conanfile.py \
        examples/shared ports "$1"
}
with_cmake() { # with_cmake NAME PREFIX: find_package there
    cmake -S "$here/cmake" -B "$folder/$1" -DCMAKE_PREFIX_PATH="$2" && cmake --build "$folder/$1" && runs "$folder/$1/app"
}

version=$(sed -n 's/^#define SB_VERSION_STRING "\(.*\)"/\1/p' softbody.h)
sources "$folder/softbody"
grep -q "\"version-semver\": \"$version\"" ports/vcpkg/softbody/vcpkg.json && grep -q "version = \"$version\"" build.zig.zon
report $? "ports have the header's version"

if has pkg-config; then
    (
        $make --no-print-directory install DESTDIR="$folder/root" PREFIX=/usr &&
            PKG_CONFIG_SYSROOT_DIR=$folder/root PKG_CONFIG_LIBDIR=$folder/root/usr/share/pkgconfig &&
            export PKG_CONFIG_SYSROOT_DIR PKG_CONFIG_LIBDIR && flags=$(pkg-config --cflags --libs softbody) &&
            $cc -Wall -Wextra -Wpedantic -Werror "$app" $flags -o "$folder/app" && runs "$folder/app" &&
            echo '#include <softbody/register.h>' | $cc "-I$folder/root/usr/include" -fsyntax-only -x c -
    ) >"$folder/log" 2>&1
    report $? "make install, pkg-config"
else
    skip "no pkg-config"
fi

if has cmake; then
    (
        cd "$folder/softbody" && cmake -S . -B "$folder/cmake" -DCMAKE_INSTALL_PREFIX="$folder/prefix" -DSOFTBODY_SHARED=ON \
            -DCMAKE_BUILD_TYPE=Debug && cmake --build "$folder/cmake" --target install &&
            with_cmake cmake_user "$folder/prefix" && runs "$folder/cmake_user/app_library"
    ) >"$folder/log" 2>&1
    report $? "CMake package, with a shared library"
    if has vcpkg; then
        vcpkg install softbody --overlay-ports="$folder/softbody/ports/vcpkg" --x-install-root="$folder/vcpkg" >"$folder/log" 2>&1 &&
            with_cmake vcpkg_user "$(echo "$folder"/vcpkg/*-*)" >>"$folder/log" 2>&1
        report $? "vcpkg port"
    else
        skip "no vcpkg: its port runs with a stub"
        cmake -DPORTFILE="$folder/softbody/ports/vcpkg/softbody/portfile.cmake" -DFEATURES=core -DWORK="$folder/vcpkg" \
            -P "$here/vcpkg.cmake" >"$folder/log" 2>&1 && with_cmake vcpkg_user "$folder/vcpkg/package" >>"$folder/log" 2>&1
        report $? "vcpkg port, with a stub"
    fi
else
    skip "no cmake"
fi

if has meson && has ninja; then
    (
        mkdir -p "$folder/meson/subprojects" && cp -r "$folder/softbody" "$folder/meson/subprojects/" &&
            cp "$app" "$here/meson/meson.build" "$folder/meson" && cd "$folder/meson" && meson setup build &&
            ninja -C build && runs build/app && DESTDIR=$folder/meson_root ninja -C build install &&
            [ -n "$(find "$folder/meson_root" -path '*include/softbody/needle.h')" ] &&
            [ -n "$(find "$folder/meson_root" -name softbody.pc)" ]
    ) >"$folder/log" 2>&1
    report $? "Meson subproject"
else
    skip "no meson with ninja"
fi

if has zig; then
    (
        mkdir "$folder/zig" && cp -r "$folder/softbody" "$folder/zig/" && cp "$app" "$here"/zig/* "$folder/zig" &&
            cd "$folder/zig" && ZIG_GLOBAL_CACHE_DIR=$folder/zig_cache zig build && runs zig-out/bin/app
    ) >"$folder/log" 2>&1
    report $? "Zig dependency"
else
    skip "no zig"
fi

if has conan; then
    (cd "$folder/softbody" && CONAN_HOME=$folder/conan_home && export CONAN_HOME && conan profile detect && conan create .) \
        >"$folder/log" 2>&1
    report $? "Conan recipe"
elif has python3; then
    skip "no conan: its recipe runs with a stub"
    (
        mkdir "$folder/conan" && PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$here/conan &&
            export PYTHONDONTWRITEBYTECODE PYTHONPATH &&
            flags=$(python3 "$here/conan/package.py" "$folder/softbody/conanfile.py" "$folder/conan") &&
            $cc "$app" $flags -o "$folder/conan/app" && runs "$folder/conan/app"
    ) >"$folder/log" 2>&1
    report $? "Conan recipe, with a stub"
else
    skip "no conan, no python3"
fi

echo "$passed passed, $failed failed, $skipped skipped"
exit $((failed != 0))
