#!/bin/sh
# race.sh FOLDER: the solvers of softbody.h against CHOLMOD, Eigen and hypre on the same systems. Builds the racers
# whose libraries are installed (Debian: libsuitesparse-dev libopenblas-dev libeigen3-dev libhypre-dev openmpi-bin),
# runs all on one core and on two, and writes the tables to tests/bench/race.md and the plots beside it. What is
# compared with itself, whole steps on one core and on two and multigrid on small systems and large, takes turns before,
# between and after: a machine whose neighbours come and go is another one ten minutes later. Jumps of the modulus come
# last. Run by `make race` from the root, with CC, CXX and CFLAGS. RACE_SYSTEMS="beam_tet4_13k ..." picks systems:
# there are neither turns nor jumps then, and the tables and plots stay in FOLDER, as they do unless all run.
set -eu
folder=$1
here=$(dirname "$0")
mkdir -p "$folder"

# build NAME PACKAGE COMPILE... : a racer, or a line that says why it does not take part
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
    if [ ! -x "$folder/$1" ] ||
        [ -n "$(find "$here" softbody.h examples/plot.h tests/bench/*.h -newer "$folder/$1")" ]; then
        # shellcheck disable=SC2086
        $CC $CFLAGS -I. "$here/$1.c" -lm -o "$folder/$1"
    fi
}

racers=race_ours # and those that build adds
for program in race_write race_ours race_machine race_plot; do
    own "$program"
done
build race_cholmod libsuitesparse-dev $CC -O3 -std=gnu11 "$here/race_cholmod.c" -lcholmod -lm
build race_eigen libeigen3-dev $CXX -O3 -march=native -fopenmp -isystem /usr/include/eigen3 "$here/race_eigen.cpp"
build race_hypre 'libhypre-dev, with openmpi-bin,' mpicc -O3 -std=gnu11 -I/usr/include/hypre "$here/race_hypre.c" \
    -lHYPRE -lm

systems='beam_tet4_13k beam_tet4_100k beam_tet10_9k beam_tet10_9k_49 series_5k series_13k series_137k series_310k'
systems=${RACE_SYSTEMS:-$systems}
if [ ! -f "$folder/written" ] || [ "$folder/race_write" -nt "$folder/written" ]; then
    "$folder/race_write" "$folder"
    touch "$folder/written"
fi
files=
for system in $systems; do
    files="$files $folder/$system.system"
done

# keep FILE COMMAND...: its lines, shown and kept; a line that says so when it ends badly
keep() {
    kept=$1
    shift
    "$@" >"$folder/lines.txt" 2>"$folder/complaints.txt" ||
        echo "skip: $* ended badly on $RACE_THREADS core(s): $(tail -n 1 "$folder/complaints.txt")" \
            >>"$folder/lines.txt"
    cat "$folder/lines.txt"
    cat "$folder/lines.txt" >>"$kept"
}

: >"$folder/times.txt"
: >"$folder/machine.txt"
: >"$folder/steps.txt"
: >"$folder/series.txt"
: >"$folder/jumps.txt"
export OMPI_MCA_btl_vader_single_copy_mechanism=none

# threads N : what is started from here on takes N
threads() {
    export RACE_THREADS="$1" OMP_NUM_THREADS="$1" OPENBLAS_NUM_THREADS="$1"
}

# Multigrid on the series and whole steps, each twice, on one core and on two by turns.
take_turn() {
    if [ -n "${RACE_SYSTEMS:-}" ]; then
        return
    fi
    series=
    for system in series_5k series_13k beam_tet10_9k series_137k series_310k; do
        series="$series $folder/$system.system"
    done
    for part in series steps series steps; do
        echo "# turn" >>"$folder/$part.txt"
        for turn_cores in 1 2; do
            threads $turn_cores
            if [ $part = series ]; then
                # shellcheck disable=SC2086
                keep "$folder/series.txt" env OMP_PROC_BIND=true RACE_SOLVER=ours-multigrid "$folder/race_ours" $series
            else
                echo "# threads $turn_cores" >>"$folder/steps.txt"
                keep "$folder/steps.txt" env OMP_PROC_BIND=true build/bench/bench_step
            fi
        done
    done
}

take_turn
for cores in 1 2; do
    threads $cores
    # shellcheck disable=SC2086
    keep "$folder/machine.txt" "$folder/race_machine" $files
    for racer in $racers; do
        program=$folder/$racer
        if [ "$racer" = race_hypre ]; then # it takes processes, not threads
            start="mpirun --allow-run-as-root --oversubscribe --bind-to none -n $RACE_THREADS"
            program="env OMP_NUM_THREADS=1 $start $program"
        elif [ "$racer" != race_cholmod ]; then
            # else both threads may be left on one core for a whole run; CHOLMOD's are not OpenMP's and would be
            program="env OMP_PROC_BIND=true $program"
        fi
        # shellcheck disable=SC2086
        keep "$folder/times.txt" $program $files
    done
    take_turn
done

target=tests/bench
if [ -n "${RACE_SYSTEMS:-}" ] || [ "$racers" != 'race_ours race_cholmod race_eigen race_hypre' ]; then
    target=$folder
fi
if [ -z "${RACE_SYSTEMS:-}" ]; then
    threads 2
    keep "$folder/jumps.txt" env OMP_PROC_BIND=true build/bench/bench_jumps
fi
"$folder/race_plot" "$folder/times.txt" "$folder/machine.txt" "$folder/steps.txt" "$folder/series.txt" \
    "$folder/jumps.txt" "$target"
echo "wrote $target/race.md, race_time.svg, race_phases.svg, race_roofline.svg"
