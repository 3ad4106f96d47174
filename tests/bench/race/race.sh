#!/bin/sh
# race.sh FOLDER: the solvers of softbody.h against CHOLMOD, Eigen and hypre on the same systems. Builds the racers whose
# libraries are installed (Debian: libsuitesparse-dev libopenblas-dev libeigen3-dev libhypre-dev openmpi-bin), runs all on
# one core and on two, and writes the tables to tests/bench/race.md and the plots beside it. Run by `make race` from the
# root, with CC, CXX and CFLAGS. RACE_SYSTEMS="beam_tet4_13k ..." picks systems: the tables and plots then stay in FOLDER.
set -eu
folder=$1
here=$(dirname "$0")
mkdir -p "$folder"

# build NAME COMPILE... : a racer, or a line that says why it does not take part
build() {
    name=$1
    package=$2
    shift 2
    if "$@" -o "$folder/$name" >"$folder/$name.log" 2>&1; then
        racers="$racers $name"
    else
        rm -f "$folder/$name"
        echo "skip: $name does not build, see $folder/$name.log (is $package installed?)"
    fi
}

own() { # own NAME: one of our programs
    if [ ! -x "$folder/$1" ] || [ -n "$(find "$here" softbody.h examples/plot.h tests/bench/elastic.h -newer "$folder/$1")" ]; then
        # shellcheck disable=SC2086
        $CC $CFLAGS -I. "$here/$1.c" -lm -o "$folder/$1"
    fi
}

racers=race_ours
for program in race_write race_ours race_machine race_plot; do
    own "$program"
done
build race_cholmod libsuitesparse-dev $CC -O3 -std=gnu11 "$here/race_cholmod.c" -lcholmod -lm
build race_eigen libeigen3-dev $CXX -O3 -march=native -fopenmp -isystem /usr/include/eigen3 "$here/race_eigen.cpp"
build race_hypre 'libhypre-dev, with openmpi-bin,' mpicc -O3 -std=gnu11 -I/usr/include/hypre "$here/race_hypre.c" -lHYPRE -lm

systems=${RACE_SYSTEMS:-beam_tet4_13k beam_tet4_100k beam_tet10_9k beam_tet10_9k_49 series_5k series_13k series_137k series_310k}
if [ ! -f "$folder/written" ] || [ "$folder/race_write" -nt "$folder/written" ]; then
    "$folder/race_write" "$folder" && touch "$folder/written"
fi
files=
for system in $systems; do
    files="$files $folder/$system.system"
done

processes() { # hypre takes processes, not threads
    mpirun --allow-run-as-root --oversubscribe --bind-to none -n "$RACE_THREADS" "$@"
}

: >"$folder/times.txt"
: >"$folder/machine.txt"
: >"$folder/steps.txt"
for RACE_THREADS in 1 2; do
    export RACE_THREADS OMP_NUM_THREADS="$RACE_THREADS" OPENBLAS_NUM_THREADS="$RACE_THREADS"
    export OMPI_MCA_btl_vader_single_copy_mechanism=none
    # shellcheck disable=SC2086
    "$folder/race_machine" $files | tee -a "$folder/machine.txt"
    for racer in $racers; do
        if [ "$racer" = race_hypre ]; then
            # shellcheck disable=SC2086
            OMP_NUM_THREADS=1 processes "$folder/$racer" $files | tee -a "$folder/times.txt" ||
                echo "skip: mpirun does not start $RACE_THREADS processes of $racer"
        else
            # shellcheck disable=SC2086
            "$folder/$racer" $files | tee -a "$folder/times.txt"
        fi
    done
    if [ -z "${RACE_SYSTEMS:-}" ]; then
        echo "# threads $RACE_THREADS" >>"$folder/steps.txt"
        build/bench/bench_step | tee -a "$folder/steps.txt"
    fi
done

target=tests/bench
if [ -n "${RACE_SYSTEMS:-}" ]; then
    target=$folder
fi
"$folder/race_plot" "$folder/times.txt" "$folder/machine.txt" "$folder/steps.txt" "$target"
echo "wrote $target/race.md, race_time.svg, race_phases.svg, race_roofline.svg"
