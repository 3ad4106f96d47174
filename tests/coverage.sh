#!/bin/sh
# Lines of the headers that the tests have run, by room, from gcov's counts of all units together:
#
#     tests/coverage.sh FOLDER        FOLDER holds the .gcno and .gcda files
#
# A line counts when some unit has code for it; it was run when some unit ran it.
cd "$1" || exit 1
for data in *.gcda; do
    (cd ../.. && gcov -t "$1/$data" 2>/dev/null)
done | awk -F: '
    $2 ~ /^ *0$/ && $3 == "Source" { ours = $4 ~ /(^|\/)(softbody|needle|register)\.h$/; first = $4 ~ /needle/ ? 100000 : $4 ~ /register/ ? 200000 : 0 }
    !ours { next }
    { line = $2 + 0 > 0 ? first + $2 : 0; count = $1; gsub(/[ *]/, "", count) }
    line > 0 && index($0, "/* ==== src/") {
        name = $0; sub(/.*src\//, "", name); sub(/ .*/, "", name); start[line] = name
    }
    count != "-" && line > 0 { has[line] = 1; if (count ~ /^[0-9]/ && count + 0 > 0) run[line] = 1 }
    line > last { last = line }
    END {
        for (i = 1; i <= last; i++) {
            if (i in start) room = start[i]
            if (!(i in has)) continue
            lines[room]++; total++
            if (i in run) { ran[room]++; all++ }
        }
        for (room in lines) printf "%-20s %6d of %6d lines  %5.1f %%\n", room, ran[room], lines[room], 100 * ran[room] / lines[room] | "sort"
        close("sort")
        printf "%-20s %6d of %6d lines  %5.1f %%\n", "all", all, total, 100 * all / total
    }'
