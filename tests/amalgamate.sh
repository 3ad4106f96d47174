#!/bin/sh
# The rules of src/amalgamate.c: what must fail does, says why, and leaves the output alone.
#
#     tests/amalgamate.sh TOOL FOLDER        from the root; ends with `N passed, N failed, N skipped`
tool=$(pwd)/$1 folder=$2
passed=0 failed=0
rm -rf "$folder"
mkdir -p "$folder/src/room"
cd "$folder" || exit 1

report() {
    if [ "$1" = 0 ]; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        echo "FAILED: $2"
    fi
}
fresh() { # a small library that is right
    rm -rf src/room/* product.h
    echo "A licence" >LICENCE
    printf '%s\n' '#ifndef A_H' '#define A_H' '#define A_VERSION_STRING "1.2.3"' '#include <stddef.h>' \
        '#define A_API extern' '/* A_API int a_comment(void); */' 'A_API int' '    a_one(void);' '#endif' >src/room/a.h
    printf '%s\r\n' '  #  include "a.h"' '/* kept:' '#include "a.h"' '*/ static const char *text = "/*";' \
        '#include "a.h"' 'A_API int a_one(void) { return *text; }' >src/room/a.c
    printf '%s\n' '# a comment' 'output product.h' 'title  A library' 'version a.h A_VERSION_STRING' 'licence LICENCE' \
        'names names.h A_REAL A_API' 'section top' 'section declarations PRODUCT_H' 'names.h' 'a.h' \
        'section implementation A_IMPLEMENTATION' 'a.c' 'section bottom' >src/room/manifest.txt
}
run() { "$tool" src/room/manifest.txt $(find src/room -type f) 2>message.txt; }
refuses() { # refuses NAME TEXT: the tool fails, says TEXT and leaves the output as it was
    echo "old" >product.h
    ! run && grep -q "$2" message.txt && [ "$(cat product.h)" = old ] && [ ! -e product.h.tmp ]
    report $? "$1: $(cat message.txt)"
}

fresh
run && head -n 1 product.h | grep -q '^/\* product.h 1.2.3: A library$' && grep -q 'src/room/' product.h
report $? "first lines"
[ "$(grep -c '#include "a.h"' product.h)" = 1 ] && grep -q '#include <stddef.h>' product.h
report $? "local includes go, the rest stays"
! grep -q "$(printf '\r')" product.h && [ "$(tail -n 2 product.h | head -n 1)" = "A licence" ]
report $? "line ends and licence"
[ "$(grep -c '^/\* ==== src/room/a\.[ch] ==== \*/$' product.h)" = 2 ]
report $? "markers"
[ "$(grep '#define a_' src/room/names.h)" = "#define a_one a_one_f32" ]
report $? "names"
fresh
printf '%s\n' '#if defined(A_IMPLEMENTATION) || defined(A_SPLIT)' '#ifdef X' 'int inner;' '#endif' '#endif' 'int outer;' \
    >>src/room/a.h
sed -i 's/^names/internal A_SPLIT\nnames/' src/room/manifest.txt
run && [ "$(grep -n 'outer;\|^#endif /\* PRODUCT\|^#define A_IMPLEM\|inner;\|src/room/a.c' product.h | sed 's/.*://' |
    cut -c 1-12 | tr '\n' '.')" = "int outer;.#endif /* PR.#define A_IM.int inner;./* ==== src/." ] &&
    [ "$(grep -c '^#if' product.h)" = "$(grep -c '^#endif' product.h)" ] && ! grep -q A_SPLIT product.h
report $? "what is internal goes to the head of the implementation"
fresh
echo 'requires other.h' >>src/room/manifest.txt && echo '#include "../other/b.h"' >>src/room/a.h
run && [ "$(sed -n 4p product.h)" = '#include "other.h"' ] && ! grep -q 'b.h' product.h
report $? "a required header comes first, its rooms may be included"
fresh
run
cp product.h first.h && run && cmp -s first.h product.h
report $? "the same input gives the same bytes"

fresh && rm src/room/a.c && refuses "missing part" "src/room/a.c: cannot be opened"
fresh && echo "a.c" >>src/room/manifest.txt && refuses "part named twice" "a.c is named twice"
fresh && touch src/room/b.c && refuses "part forgotten" "src/room/b.c is in the folder"
fresh && echo '#include "b.h"' >>src/room/a.c && refuses "include of no part" "a.c:7: includes b.h, which is no part"
fresh && echo '#include "a.c"' >>src/room/a.h && refuses "include of a higher floor" "a.h:10: includes a.c, which stands"
fresh && mkdir -p src/room/low src/room/high && echo '#include "../high/h.h"' >src/room/low/l.c && echo '#define H' >src/room/high/h.h &&
    sed -i 's/^section top/folder high\nfolder low\nsection top/; s/^a.c/high\/h.h\nlow\/l.c\na.c/' src/room/manifest.txt &&
    refuses "include of a folder that it may not call" "low/l.c:1: includes ../high/h.h, but low may not call high"
sed -i 's/^folder low/folder low high/' src/room/manifest.txt && run && grep -q 'src/room/low/l.c' product.h
report $? "include of a folder that it may call"
sed -i 's/^folder high/folder other/' src/room/manifest.txt && refuses "folder without a line" "high does not stand above"
fresh && printf '%s\n' '#if defined(A_IMPLEMENTATION) || defined(A_SPLIT)' 'int inner;' '#endif' 'int outer;' >src/room/b.h &&
    sed -i 's/^names /internal A_SPLIT\nnames /; s/^a.h/a.h\nb.h unless A_NO_B A_SMALL/' src/room/manifest.txt && run &&
    [ "$(grep -A1 -B1 '^int [a-z]*er;' product.h | grep -v -- --)" = "$(printf '%s\n' '#if !defined(A_NO_B) && !defined(A_SMALL)' \
        'int outer;' '#endif /* !defined(A_NO_B) && !defined(A_SMALL) */' '#if !defined(A_NO_B) && !defined(A_SMALL)' \
        'int inner;' '#endif /* !defined(A_NO_B) && !defined(A_SMALL) */')" ]
report $? "a part that macros leave out, and what is internal in it"
echo '#include "b.h"' >>src/room/a.c && refuses "include of what may be left out" "includes b.h, which A_NO_B leaves out"
fresh && sed -i 's/1.2.3//; s/_STRING ""/ 1/' src/room/a.h && refuses "no version" "no #define A_VERSION_STRING"
fresh && rm LICENCE && refuses "no licence" "LICENCE: cannot be opened"
fresh && echo 'section cellar' >>src/room/manifest.txt && refuses "unknown section" "manifest.txt:14: no such section"
fresh && echo 'what is this' >>src/room/manifest.txt && refuses "unknown words" "manifest.txt:14: cannot be understood"

echo "$passed passed, $failed failed, 0 skipped"
[ "$failed" = 0 ]
