#!/bin/sh
# A study on the cores of one machine, or with --sshlogin on those of many, by GNU parallel:
#
#     parallel.sh SHARDS WHOLE.csv PROGRAM [ARGUMENT...]
#
# for instance: parallel.sh 32 study.csv build/insilico liver.vtk --patterns gravity,respiration --seeds 200
# Killed and run again it goes on where it was: shards that are done take no time. PARALLEL_OPTIONS is handed on.
set -eu
[ $# -ge 3 ] || {
    echo "usage: parallel.sh SHARDS WHOLE.csv PROGRAM [ARGUMENT...]" >&2
    exit 2
}
shards=$1 whole=$2
shift 2
# shellcheck disable=SC2086 # several options
seq "$shards" | parallel --halt now,fail=1 ${PARALLEL_OPTIONS:-} --quote "$@" --study "$whole.{}" --shard "{}/$shards"
set --
for shard in $(seq "$shards"); do
    set -- "$@" "$whole.$shard"
done
"$(dirname "$0")/merge.sh" "$whole" "$@"
