#!/bin/sh
# Runs each argument as a shell command, shows what it prints and ends with one line: the sum of the commands'
# closing lines `N passed, N failed, N skipped`. A command without such a line, or that fails without a failed
# test, counts as one failed test. Exit status 1 when anything failed.
passed=0 failed=0 skipped=0
log=$(mktemp) status=$(mktemp)
trap 'rm -f "$log" "$status"' EXIT
closing='^[0-9][0-9]* passed, [0-9][0-9]* failed, [0-9][0-9]* skipped$'

for command; do
    { sh -c "$command" 2>&1; echo $? >"$status"; } | tr -d '\r' | tee "$log" | grep -v "$closing"
    line=$(grep "$closing" "$log" | tail -n 1)
    set -- $(echo "$line" | tr -cd '0-9 ')
    passed=$((passed + ${1:-0})) failed=$((failed + ${2:-0})) skipped=$((skipped + ${3:-0}))
    if [ -z "$line" ] || { [ "$(cat "$status")" != 0 ] && [ "$2" = 0 ]; }; then
        echo "FAILED (exit status $(cat "$status")): $command"
        failed=$((failed + 1))
    fi
done
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" = 0 ]
