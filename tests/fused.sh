#!/bin/sh
# Looks for fused multiply-add in objects of the library, where a product and a sum shall stay two roundings: run as
# `tests/fused.sh OBJECT...`. The disassembler from OBJDUMP. Ends with `N passed, N failed, N skipped`.
passed=0 failed=0 skipped=0
for object; do
    if [ "$(uname -m)" != x86_64 ]; then
        echo "skip: fused instructions are looked for on x86-64 only"
        skipped=$((skipped + 1))
        continue
    fi
    # gcc's vfmaddsub and vfmsubadd, too: - and + in turn, which it fuses (12.2) although contraction is off
    fused=$("${OBJDUMP:-objdump}" -d "$object" | awk '/^[0-9a-f]+ </ { name = $2 } /vfn?m(add|sub)/ { print name }' | sort | uniq -c)
    if [ -z "$fused" ] && [ -s "$object" ]; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        printf 'FAILED: fused multiply-add in %s\n%s\n' "$object" "$fused"
    fi
done
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" = 0 ]
