#!/bin/sh
# The headers from Python and C#: run as `tests/bindings.sh FOLDER` from the root. CC from the environment. A language that is
# missing is a skip. Ends with `N passed, N failed, N skipped`.
folder=$1
first_cc=${CC:-cc} cc=$first_cc
command -v clang >/dev/null && cc=clang # compiles the library in a third of the time
root=$(pwd)
passed=0 failed=0 skipped=0
rm -rf "$folder"
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)

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
python_with() { # the first Python that has a module
    for python in python3 /usr/bin/python3; do
        "$python" -c "import $1" 2>/dev/null && echo "$python" && return
    done
    return 1
}

if ! command -v python3 >/dev/null; then
    skip "no python3"
    end
fi
$first_cc -std=c99 -fvisibility=hidden -DSB_SHARED -fsyntax-only -I. examples/shared/softbody.c &&
    $cc -std=c99 -O0 -fPIC -shared -fvisibility=hidden -DSB_SHARED -I. examples/shared/softbody.c -lm -o "$folder/libsoftbody.so" &&
    $cc -std=c99 -O0 -DSB_NO_CUT -I. tests/bindings/native.c -lm -o "$folder/native" && hash=$("$folder/native")
report $? "the library"
export SOFTBODY_LIBRARY="$folder/libsoftbody.so" PYTHONDONTWRITEBYTECODE=1

if python=$(python_with pycparser); then
    CC=$cc "$python" src/bindings.py --check
    report $? "bindings are those of the headers"
    CC=$cc "$python" src/bindings.py --sizes >"$folder/sizes.c" && $cc -I. "$folder/sizes.c" -lm -o "$folder/sizes" &&
        "$folder/sizes" | sort >"$folder/sizes.txt"
    report $? "sizes of structs"
else
    skip "no pycparser: bindings are not compared with the headers"
fi
if [ -s "$folder/sizes.txt" ]; then
    check() { # check PYTHON [FLAG]: in the folder, where it writes
        (cd "$folder" && PYTHONPATH="$root/examples/python" "$@" "$root/tests/bindings/check.py" sizes.txt "$hash")
        report $? "$*"
    }
    if python=$(python_with numpy); then
        check "$python"
    else
        skip "no numpy"
    fi
    printf 'raise ImportError\n' >"$folder/numpy.py" # hides it: the program's own folder comes later
    (cd "$folder" && PYTHONPATH="$folder:$root/examples/python" python3 "$root/tests/bindings/check.py" sizes.txt "$hash")
    report $? "without numpy"
    rm "$folder/numpy.py"
fi
(cd "$folder" && PYTHONPATH="$root/examples/python" python3 "$root/examples/python/pull.py" >pull.txt) &&
    grep -q "^pulled by 30 mm it takes [1-9]" "$folder/pull.txt" && [ -s "$folder/pulled.vtk" ]
report $? "pull.py"
(cd "$folder" && PYTHONPATH="$root/examples/python" python3 "$root/tests/bindings/check_export.py" "$root/examples")
report $? "networks from Python"

# A wheel that works where it was put, with nothing else of ours about.
if python=$(python_with "setuptools, wheel") && "$python" -m pip --version >/dev/null 2>&1; then
    cp -r examples/python "$folder/python" && sed -i.old "s|^ROOT = .*|ROOT = '$root'|" "$folder/python/setup.py" &&
        (cd "$folder" && CC=$cc CFLAGS=-O0 "$python" -m pip wheel -q --no-build-isolation --no-deps ./python -w wheel >wheel.txt 2>&1 &&
            "$python" -m pip install -q --no-deps --no-index --target installed wheel/softbody-*.whl >>wheel.txt 2>&1 &&
            cp "$root/examples/python/pull.py" wheel && # a program's own folder comes first, and has the package
            env -u SOFTBODY_LIBRARY PYTHONPATH="$folder/installed" "$python" wheel/pull.py >installed.txt &&
            cmp -s pull.txt installed.txt) || { tail -n 5 "$folder/wheel.txt"; false; }
    report $? "a wheel"
else
    skip "no setuptools, wheel and pip"
fi

if ! command -v mcs >/dev/null || ! command -v mono >/dev/null; then
    skip "no mono"
    end
fi
(
    cd "$folder" && mcs -nologo -unsafe "$root"/examples/csharp/Pull.cs "$root"/examples/csharp/Organ.cs "$root"/examples/csharp/Softbody.cs \
        -out:Pull.exe && LD_LIBRARY_PATH=. mono Pull.exe >csharp.txt && grep -q "by 30 mm it takes [1-9]" csharp.txt
)
report $? "Pull.cs"
(
    cd "$folder" && mcs -nologo -unsafe "$root"/tests/bindings/Drive.cs "$root"/tests/stubs/unity/UnityEngine.cs \
        "$root"/examples/csharp/O*.cs "$root"/examples/csharp/Softbody.cs -out:Drive.exe && LD_LIBRARY_PATH=. mono Drive.exe "$hash"
)
report $? "C# and Unity's component"
if [ -s "$folder/sizes.txt" ]; then
    (cd "$folder" && mono Pull.exe --sizes | sort | cmp - sizes.txt)
    report $? "sizes of structs in C#"
fi
end
