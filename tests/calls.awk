# calls.awk: writes a C function for each public function of the headers, which calls it with every argument in turn replaced
# by absurd ones (tests/hostile.h), and tables of the fields of the structs that are handed over.
#
#     awk -f tests/calls.awk tests/calls.txt src/*/*.h src/*/*/*.h >build/calls.h
#
# tests/calls.txt says what a valid argument is. Fails, naming function and parameter, where it does not.

function fail(text) { print "calls.awk: " text >"/dev/stderr"; failed = 1; exit 1 }
function trim(s) { sub(/^[ \t]+/, "", s); sub(/[ \t]+$/, "", s); return s }

# ---- tests/calls.txt ----
FILENAME ~ /calls\.txt$/ {
    sub(/^#.*/, "")
    if ($0 ~ /^[ \t]*$/)
        next
    if ($1 ~ /^(skip|release|open|made|fills|accepts|trusts)$/) {
        word = $1; key = $2
        if ($3 == "")
            fail("tests/calls.txt, line " FNR ": " word " " key " without a reason")
        $1 = ""; $2 = ""
        if (word == "skip") skipped[key] = trim($0)
        else if (word == "release") release[key] = trim($0)
        else if (word == "open") open_count[key] = trim($0)
        else if (word == "made") made[key] = trim($0)
        else if (word == "fills") fills[key] = trim($0)
        else { if (word == "accepts") accepts = accepts "    \"" key "\",\n"; else trusts = trusts "    \"" key "\",\n" }
        next
    }
    at = index($0 " ", " = ")
    if (!at)
        fail("tests/calls.txt, line " FNR ": no ` = `")
    key = trim(substr($0, 1, at)); value = trim(substr($0, at + 3))
    if (key in rule)
        fail("tests/calls.txt, line " FNR ": " key " is there twice")
    rule[key] = value
    next
}

# ---- headers: comments and preprocessor lines go, statements are joined ----
FNR == 1 { buffer = ""; depth = 0; in_comment = 0; in_macro = 0; hidden = 0 }
{
    line = $0
    sub(/\r$/, "", line)
    text = ""
    while (line != "") {
        if (in_comment) {
            at = index(line, "*/")
            if (!at) break
            line = substr(line, at + 2); in_comment = 0
        } else {
            at = index(line, "/*")
            if (!at) { text = text line; break }
            text = text substr(line, 1, at - 1) " "
            line = substr(line, at + 2); in_comment = 1
        }
    }
    if (in_macro || text ~ /^[ \t]*#/) {
        in_macro = text ~ /\\$/
        if (text ~ /^#if/) nested++
        if (text ~ /^#if defined\(SB_USE_OPENMP\)$/ && !hidden) hidden = nested
        if (text ~ /^#endif/) { if (hidden == nested) hidden = 0; nested-- }
        next
    }
    text = trim(text)
    if (text == "" || hidden)
        next
    buffer = trim(buffer " " text)
    copy = text
    depth += gsub(/{/, "", copy)
    depth -= gsub(/}/, "", copy)
    if (depth == 0 && buffer ~ /[;}]$/) {
        statement(buffer)
        buffer = ""
    }
}

function statement(s,    name, at) {
    if (s ~ /^typedef enum [a-z_0-9]+ \{/) {
        split(s, tokens, " "); is_enum[tokens[3]] = 1
    } else if (s ~ /^typedef struct [a-z_0-9]+ \{/) {
        split(s, tokens, " "); name = tokens[3]
        at = index(s, "{")
        sub(/}[^}]*$/, "", s)
        struct_body[name] = substr(s, at + 1)
    } else if (s ~ /^typedef struct [a-z_0-9]+ [a-z_0-9]+;/) {
        split(s, tokens, /[ ;]/); is_opaque[tokens[4]] = 1
    } else if (match(s, /^typedef [a-z_0-9 *]+\(\*[a-z_0-9]+\)/)) {
        name = substr(s, RSTART, RLENGTH); sub(/.*\(\*/, "", name); sub(/\)/, "", name)
        is_callback[name] = 1
    } else if (s ~ /^(SB_API|NDL_API|REG_API|SB_INLINE) /) {
        sub(/^[A-Z_]+ /, "", s)
        sub(/[ ]*[{;].*$/, "", s)
        at = index(s, "(")
        name = substr(s, 1, at - 1); sub(/.*[ *]/, "", name)
        if (name !~ /^(sb|ndl|reg)_/ || name in is_function)
            return
        is_function[name] = 1
        function_count++
        function_name[function_count] = name
        function_type[function_count] = trim(substr(s, 1, at - 1 - length(name)))
        sub(/\)$/, "", s)
        function_arguments[function_count] = substr(s, at + 1)
    }
}

# ---- types ----
# kind of one value of a type: what it is replaced by
function kind_of(type) {
    if (type == "sb_real" || type == "sb_vec3" || type == "sb_mat3" || type == "sb_quat") return "HOSTILE_REALS"
    if (type == "double") return "HOSTILE_DOUBLE"
    if (type == "int") return "HOSTILE_INT"
    if (type in is_enum) return "HOSTILE_ENUM"
    if (type == "unsigned" || type == "size_t" || type == "uint64_t" || type == "uint32_t" || type == "unsigned char" || type == "char" || type == "sb_clock") return "HOSTILE_OTHER"
    if (type in is_callback) return "HOSTILE_POINTER"
    return ""
}

# Lines of a struct's table of fields; those of structs within it too.
function fields_of(top, type, prefix,    body, n, i, decl, base, m, j, part, name, kind, declarations, parts) {
    n = split(struct_body[type], declarations, ";")
    for (i = 1; i <= n; i++) {
        decl = trim(declarations[i])
        if (decl == "") continue
        if (decl ~ /\(\*/) {
            name = decl; sub(/^[^(]*\(\*/, "", name); sub(/\).*/, "", name)
            field(top, prefix name, "HOSTILE_POINTER")
            continue
        }
        sub(/^const /, "", decl)
        if (!match(decl, /^(unsigned char|signed char|[a-z_0-9]+) */))
            fail("struct " type ": cannot read `" decl "`")
        base = trim(substr(decl, 1, RLENGTH))
        m = split(substr(decl, RLENGTH + 1), parts, ",")
        for (j = 1; j <= m; j++) {
            part = trim(parts[j])
            name = part
            if (part ~ /^\*/) {
                gsub(/[* ]|const /, "", name)
                sub(/\[.*/, "", name)
                field(top, prefix name, "HOSTILE_POINTER")
                continue
            }
            gsub(/\[[^]]*\]/, "[0]", name)
            kind = kind_of(base)
            if (kind == "HOSTILE_INT" && name ~ /(^|_)counts?(\[0\])?$/)
                kind = "HOSTILE_COUNT"
            if (kind != "")
                field(top, prefix name, kind)
            else if (base in struct_body)
                fields_of(top, base, prefix name ".")
            else
                fail("struct " type ": what is a `" base "`?")
        }
    }
}
function field(top, path, kind) {
    table[top] = table[top] "    HOSTILE_FIELD(" top ", " path ", " kind "),\n"
    table_size[top]++
}

# ---- functions ----
# The rule for a parameter: by function, by type and name, by type.
function rule_for(fn, type, name) {
    if ((fn "." name) in rule) return rule[fn "." name]
    if ((type " " name) in rule) return rule[type " " name]
    if (type in rule) return rule[type]
    return ""
}

function argument(fn, index_, text,    constant, base, stars, name, dims, type, r, kind, count, at, var, pointer) {
    text = trim(text)
    constant = text ~ /^const /
    sub(/^const /, "", text)
    gsub(/SB_RESTRICT /, "", text)
    match(text, /^(unsigned char|signed char|[a-z_0-9]+) */)
    base = trim(substr(text, 1, RLENGTH)); text = trim(substr(text, RLENGTH + 1))
    stars = 0; dims = ""
    if (text ~ /^\(\*/) { # pointer to rows
        name = text; sub(/^\(\*/, "", name); dims = name; sub(/\).*/, "", name); sub(/^[^)]*\)/, "", dims)
        stars = 1
    } else {
        while (text ~ /^\*/) { stars++; sub(/^\* */, "", text); sub(/^const /, "", text) }
        name = text
        if (match(text, /\[[^]]*\]/)) {
            stars++
            dims = substr(text, RSTART + RLENGTH)
            sub(/\[.*/, "", name)
        }
    }
    type = (constant ? "const " : "") base substr("***", 1, stars)
    r = rule_for(fn, type, name)
    count = "1"
    at = index(r, " ; ")
    if (at) { count = trim(substr(r, at + 3)); r = trim(substr(r, 1, at)) }
    var = "a" index_
    if (dims != "")
        pointer = base " (*" var ")" dims
    else
        pointer = (constant ? "const " : "") base " " substr("***", 1, stars) var
    cast = pointer; sub(var, "", cast); cast = "(" trim(cast) ")"
    slot = "h, " index_ ", \"" name "\""
    after = ""

    if (stars == 0) {
        kind = kind_of(base)
        if (r == "") fail(fn ": no rule for `" type " " name "`")
        if ((fn "." name) in open_count) kind = "HOSTILE_COUNT"
        else if (kind == "HOSTILE_INT" && name ~ /(^|_)count$/) kind = "HOSTILE_COUNT"
        else if (base == "size_t") kind = "HOSTILE_SIZE"
        if (kind == "" && !(base in struct_body)) fail(fn ": what is a `" base "`?")
        if (kind == "") kind = "HOSTILE_OTHER"
        return "    " base " " var " = " r ";\n    hostile_value(" slot ", &" var ", sizeof " var ", " kind ");\n"
    }
    if (base == "sb_error")
        return "    sb_error *" var " = (sb_error *)hostile_handle(" slot ", &h->error);\n"
    if (r ~ /^raw /)
        return "    " (base == "ndl_needle" && stars == 2 ? "ndl_needle *const *" var : pointer) " = (" substr(cast, 2, length(cast) - 2) ")hostile_handle(" slot ", " substr(r, 5) ");\n"
    if (stars == 1 && base == "char") {
        if (r == "") fail(fn ": no rule for `" type " " name "`")
        return "    const char *" var " = hostile_string(" slot ", " r ");\n"
    }
    if (stars == 1 && (base in is_opaque)) {
        if (r == "") fail(fn ": no rule for `" type " " name "`")
        if (!constant && changes < 2) changes = ((fn "." name) in fills) ? 2 : 1
        return "    " pointer " = " cast "hostile_handle(" slot ", " r ");\n"
    }
    if (constant && (base in struct_body) && kind_of(base) == "" && count == "1") {
        if (r == "") fail(fn ": no rule for `" type " " name "`")
        if (!(base in table) && !(base in made)) fields_of(base, base, "")
        return "    " pointer " = " cast "hostile_struct(" slot ", " r ", sizeof *" var ", " (base in made ? "NULL, 0" : "fields_" base ", " table_size[base]) ", \"" base "\");\n"
    }
    if (r != "" && (base in struct_body) && kind_of(base) == "") { # an object that is changed in place
        if (!changes) changes = 1
        return "    " pointer " = " cast "hostile_object(" slot ", " r ", sizeof *" var ");\n"
    }
    if (r != "") { # an array, read or changed in place
        kind = base == "void" || kind_of(base) == "" ? "HOSTILE_OTHER" : kind_of(base)
        if (!constant && !changes) changes = 1
        return "    const void *v" index_ " = " r ";\n    " pointer " = " cast "hostile_array(" slot ", v" index_ ", " (base == "void" ? 1 : "sizeof *" var) ", " count ", " kind ", " (constant || ((fn "." name) in fills) ? 1 : 0) ");\n"
    }
    if (constant || base == "void") fail(fn ": no rule for `" type " " name "`")
    if (stars == 2 && !(base in release)) fail(fn ": no `release " base "`, which it makes")
    if (stars == 2) finish = finish "    if (h->made && " var ")\n        " release[base] "(*" var ");\n"
    else if (base in release) finish = finish "    if (h->made && " var ")\n        " release[base] "(" var ");\n"
    return "    " pointer " = " cast "hostile_output(" slot ", sizeof *" var ", " ((base in fills) || ((fn "." name) in fills)) ");\n"
}

function emit(i,    fn, n, k, code, call, type, parts, depth_, c, k2, one, args) {
    fn = function_name[i]; type = function_type[i]; args = function_arguments[i]
    code = ""; call = ""; changes = 0; finish = ""
    n = 0
    if (args != "void") {
        k2 = split(args, parts, ",")
        for (k = 1; k <= k2; k++) {
            code = code argument(fn, n, parts[k])
            call = call (n ? ", " : "") "a" n
            n++
        }
    }
    call = fn "(" call ")"
    print "static void call_" fn "(hostile *h)\n{"
    if (n) print "    world *w = &h->things;"
    printf "%s", code
    if (n) print "    (void)w;"
    print "    if (!hostile_begin(h))\n        return;"
    if (type == "sb_result") print "    hostile_result(h, " call ");"
    else if (type == "void") print "    " call ";"
    else if (type == "const char *") print "    hostile_text(h, " call ");"
    else {
        print "    {\n        " type (type ~ /\*$/ ? "" : " ") "value = " call ";\n        hostile_read(h, &value, sizeof value);\n    }"
    }
    print "    hostile_end(h);"
    printf "%s", finish
    print "}"
    rows = rows "    {\"" fn "\", call_" fn ", " (type == "sb_result") ", " changes "},\n"
}

END {
    if (failed) exit 1
    if (function_count < 100) fail("found " function_count " functions only")
    for (name in skipped)
        if (!(name in is_function)) fail("tests/calls.txt skips " name ", which there is not")
    print "/* calls.h: generated from the headers by tests/calls.awk */"
    # field tables come first, but are known last
    saved = ""
    for (i = 1; i <= function_count; i++)
        if (!(function_name[i] in skipped))
            prepare(i)
    for (name in table)
        print "static const hostile_field fields_" name "[] = {\n" table[name] "};"
    for (i = 1; i <= function_count; i++)
        if (!(function_name[i] in skipped))
            emit(i)
    print "static const char *const hostile_accepted[] = {\n" accepts "    NULL};"
    print "static const char *const hostile_trusted[] = {\n" trusts "    NULL};"
    print "static const hostile_call hostile_calls[] = {\n" rows "};"
}
# First pass: only the tables.
function prepare(i,    parts, n, k, args) {
    args = function_arguments[i]
    if (args == "void") return
    changes = 0; finish = ""
    n = split(args, parts, ",")
    for (k = 1; k <= n; k++)
        argument(function_name[i], k - 1, parts[k])
}
