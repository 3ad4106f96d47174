# The headers' comments as Doxygen wants them: awk -f docs/filter.awk HEADER. What stands before a declaration documents it, what
# stands after a member or a constant documents that, the first comment is that of the file; headings between lines and what
# stands inside of functions stay what they are.
function shown(text) { # in a comment: no tags, no commands
    gsub(/\\/, "\\\\", text)
    gsub(/&/, "\\&amp;", text)
    gsub(/</, "\\&lt;", text)
    gsub(/>/, "\\&gt;", text)
    gsub(/@/, "\\@", text)
    gsub(/#/, "\\#", text)
    return text
}
{
    line = $0
    if (!inside) {
        at = index(line, "/*")
        if (!at) {
            print line
            next
        }
        code = substr(line, 1, at - 1)
        rest = substr(line, at + 2)
        mark = ""
        if (rest !~ /^ ----/ && substr(rest, 1, 1) == " ") {
            if (NR == 1)
                mark = "** @file\n *"
            else if (code == "")
                mark = "**"
            else if (code ~ /[;,{] *$/ || code ~ /^ +[A-Z][A-Z0-9_]*( = [^,]*)? *$/)
                mark = "**<"
            else if (code ~ /^ +$/)
                mark = "**"
        }
        line = code "/" (mark == "" ? "*" : mark) shown(rest)
        inside = 1
        text = rest
    } else {
        text = line
        line = shown(line)
    }
    if (index(text, "*/"))
        inside = 0
    print line
}
