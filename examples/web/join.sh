#!/bin/sh
# join.sh PAGE.wasm: one HTML file on standard output, with the module and both scripts in it.
folder=$(dirname "$0")
awk -v wasm="$1" -v folder="$folder" '
    function take(file, line) { while ((getline line < file) > 0) print line; close(file) }
    /@WASM@/ {
        split($0, around, "@WASM@")
        printf "%s", around[1]
        command = "base64 " wasm
        while ((command | getline line) > 0) printf "%s", line
        close(command)
        print around[2]
        next
    }
    /^@WORKER@$/ { take(folder "/worker.js"); next }
    /^@VIEW@$/ { take(folder "/view.js"); next }
    { print }' "$folder/page.html"
