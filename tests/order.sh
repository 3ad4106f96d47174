#!/bin/sh
# Which source calls which: run as `tests/order.sh FOLDER` from the root, after the sources have been compiled one by one
# into FOLDER (build/split). Folders call only those that the manifests' `folder` lines allow, softbody.h calls neither
# needle.h nor register.h, these do not call each other, and no sources call each other in a circle.
# Ends with `N passed, N failed, N skipped`.
folder=$1
nm=${NM:-nm}
passed=0 failed=0
work=$folder/order
rm -rf "$work"
mkdir -p "$work"
trap 'rm -rf "$work"' EXIT

report() { # report FILE NAME: counts a check that is good when FILE is empty
    if [ -s "$1" ]; then
        failed=$((failed + 1))
        echo "FAILED: $2"
        sed 's/^/    /' "$1"
    else
        passed=$((passed + 1))
    fi
}

# Each name's object, then each object's calls: "CALLER CALLED name", without src/ and .c.
find src -name '*.c' ! -name amalgamate.c | sed 's/^src\///; s/\.c$//' | sort >"$work/sources"
while read -r source; do
    "$nm" -g "$folder/$source.o" | awk -v source="$source" 'NF == 3 {print "has", $3, source} NF == 2 {print "needs", $2, source}'
done <"$work/sources" >"$work/names" 2>"$work/missing"
report "$work/missing" "every source has its object in $folder"
awk '$1 == "has" {owner[$2] = $3} $1 == "needs" {needs[++n] = $2; by[n] = $3}
    END {for (i = 1; i <= n; i++) if (needs[i] in owner) print by[i], owner[needs[i]], needs[i]}' "$work/names" |
    sort -u >"$work/calls"
[ "$(wc -l <"$work/calls")" -gt 100 ] || echo "only $(wc -l <"$work/calls") calls found" >"$work/few"
touch "$work/few"
report "$work/few" "calls between sources found"

# Folders.
awk '$1 == "folder" {for (i = 3; i <= NF; i++) print $2, $i; print $2, $2}' src/softbody/manifest.txt >"$work/allowed"
awk -v allowed="$work/allowed" '
    BEGIN {while ((getline line <allowed) > 0) may[line] = 1}
    {
        split($1, from, "/"); split($2, to, "/")
        if (from[1] == "softbody")
            good = to[1] == "softbody" && ((from[2] " " to[2]) in may)
        else
            good = to[1] == from[1] || to[1] == "softbody"
        if (!good) print $1, "calls", $3, "of", $2
    }' "$work/calls" >"$work/upwards"
report "$work/upwards" "folders call lower folders only"

# Circles: tsort names the members of each.
cut -d ' ' -f 1,2 "$work/calls" | sort -u >"$work/pairs"
tsort <"$work/pairs" >/dev/null 2>"$work/circles"
report "$work/circles" "no circle of calls between sources"

echo "$passed passed, $failed failed, 0 skipped"
[ "$failed" = 0 ]
