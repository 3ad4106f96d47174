#!/bin/sh
# Runs each argument as a shell command, shows what it prints and ends with one line: the sum of the commands'
# closing lines `N passed, N failed, N skipped`. A command without such a line, or that fails without a failed
# test, counts as one failed test. Exit status 1 when anything failed. With TOTAL_JOBS=N in the environment, N commands
# run at a time, the first ones first; what each prints is shown when it ends.
passed=0 failed=0 skipped=0
log=$(mktemp) status=$(mktemp)
trap 'rm -f "$log" "$status"' EXIT
closing='^[0-9][0-9]* passed, [0-9][0-9]* failed, [0-9][0-9]* skipped$'

if [ "${TOTAL_JOBS:-1}" != 1 ] && [ $# -gt 1 ]; then
    self=$0 work=$(mktemp -d)
    export self work closing
    trap 'rm -rf "$log" "$status" "$work"' EXIT
    i=0
    for command; do
        i=$((i + 1))
        printf '%s' "$command" >"$work/$i"
        echo $i
    done | TOTAL_JOBS=1 xargs -P "$TOTAL_JOBS" -I STEP sh -c '
        sh "$self" "$(cat "$work/STEP")" >"$work/STEP.out"; grep -v "$closing" "$work/STEP.out"'
    unset TOTAL_JOBS
    i=0
    for command; do
        i=$((i + 1))
        set -- "$@" "tail -n 1 $work/$i.out"
        shift
    done
fi

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
