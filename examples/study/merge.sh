#!/bin/sh
# Joins the files of a study's shards (examples/shard.h) to what one process would have written:
#
#     merge.sh WHOLE.csv SHARD.csv...
#
# Refused is what does not belong together, a case that is missing or there twice, and a line that was cut off when its
# shard was killed: run that shard again. WHOLE.csv is then untouched.
set -eu
[ $# -ge 2 ] || {
    echo "usage: merge.sh WHOLE.csv SHARD.csv..." >&2
    exit 2
}
whole=$1
shift
new=$whole.new
for shard; do
    [ -z "$(tail -c 1 "$shard")" ] || {
        echo "merge.sh: $shard: its last line is cut off" >&2
        exit 2
    }
done
trap 'rm -f "$new" "$new.rows"' EXIT
awk -v new="$new" '
    function refuse(what) { print "merge.sh: " FILENAME ": " what | "cat >&2"; bad = 1; exit 2 }
    FNR == 1 { file++; if (!match($0, / cases=[0-9]+ /)) refuse("is no study") }
    FNR == 1 && file == 1 { cases = substr($0, RSTART + 7, RLENGTH - 8) + 0 }
    FNR <= 2 && file == 1 { heading[FNR] = $0; print >new; next }
    FNR <= 2 { if ($0 != heading[FNR]) refuse("is of another study"); next }
    { k = $0; sub(/,.*/, "", k)
      if (k !~ /^[0-9]+$/ || k + 0 >= cases) refuse("has a line that is no case of it")
      if (seen[k]++) refuse("case " k " is there twice")
      rows++
      print >(new ".rows") }
    END { if (bad) exit 2
          for (k = 0; k < cases; k++)
              if (!seen[k]) { print "merge.sh: case " k " is missing" | "cat >&2"; exit 2 } }' "$@"
sort -t , -k 1 -n "$new.rows" >>"$new"
mv "$new" "$whole"
