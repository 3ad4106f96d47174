/* XML in pieces: examples/xml.h. */
#include "softbody.h"

#include "check.h"

#include "../examples/xml.h"

/* What the pieces of a text are: [name attribute=value for an opening, ] for a close, texts in quotes; with the line of
 * an error. The copy has its own size, so that reading past the end is seen. */
static const char *pieces(const char *text, int *line)
{
    static char seen[1024];
    size_t size = strlen(text) + 1, used = 0;
    char *copy = (char *)malloc(size);
    xml_reader xml;
    xml_piece piece = XML_DONE;
    if (!CHECK(copy != NULL))
        return "";
    memcpy(copy, text, size);
    xml = xml_open(copy);
    seen[0] = 0;
    while (used < 900 && (piece = xml_next(&xml)) > XML_DONE) {
        if (piece == XML_OPEN)
            used += (size_t)snprintf(seen + used, sizeof seen - used, "[%.99s", xml.name);
        for (int i = 0; i < xml.attribute_count && piece == XML_OPEN; i++)
            used += (size_t)snprintf(seen + used, sizeof seen - used, " %.99s=%.99s", xml.attributes[i].name,
                                     xml.attributes[i].value);
        if (piece == XML_CLOSE)
            used += (size_t)snprintf(seen + used, sizeof seen - used, "]");
        if (piece == XML_TEXT)
            used += (size_t)snprintf(seen + used, sizeof seen - used, "'%.99s'", xml.text);
    }
    if (piece == XML_ERROR)
        snprintf(seen, sizeof seen, "%s", xml.message);
    *line = piece == XML_ERROR ? xml.line : 0;
    CHECK(piece != XML_ERROR || xml_next(&xml) == XML_ERROR);
    free(copy);
    return seen;
}

static void check_pieces(const char *text, const char *expected)
{
    int line;
    const char *seen = pieces(text, &line);
    if (!CHECK(line == 0 && strcmp(seen, expected) == 0))
        printf("  %s\n  expected %s\n  got %s\n", text, expected, seen);
}

static void check_error(const char *text, int line, const char *words)
{
    int at;
    const char *seen = pieces(text, &at);
    if (!CHECK(at == line && strstr(seen, words)))
        printf("  %s\n  expected line %d: %s\n  got line %d: %s\n", text, line, words, at, seen);
}

static void test_good(void)
{
    check_pieces("<a/>", "[a]");
    check_pieces("<?xml version=\"1.0\"?>\r\n<!-- <b> -->\r\n<a>\r\n</a >\r\n<!-- -- -->", "[a]");
    check_pieces("<a x='1' y = \"two\"\n\tz=\"'\"><b.c-d:e/>text</a>", "[a x=1 y=two z='[b.c-d:e]'text']");
    check_pieces("<a>1<!-- and -->2</a>", "[a'1''2']");
    check_pieces("<a b='&lt;&gt;&amp;&apos;&quot;'>&#65;&#x42; &#xe9;&#x20ac;&#x1F600;</a>",
                 "[a b=<>&'\"'AB \xc3\xa9\xe2\x82\xac\xf0\x9f\x98\x80']");
    check_pieces("<a><b></b><b/><c>x</c></a>", "[a[b][b][c'x']]");
    check_pieces("<\xc3\xa9>&lt;b&gt;</\xc3\xa9>", "[\xc3\xa9'<b>']");
}

static void test_bad(void)
{
    check_error("", 1, "no element");
    check_error("text", 1, "text outside");
    check_error("<a/>text", 1, "text outside");
    check_error("<a/>\n<b/>", 2, "<b> after the file's one element");
    check_error("<a>\n\n<b>", 3, "ends within <b> of line 3");
    check_error("<a>\n<b>\n</a>", 3, "</a> where <b> of line 2 must end");
    check_error("</a>", 1, "ends nothing");
    check_error("<a", 1, "no whole tag");
    check_error("<a x", 1, "no \"value\"");
    check_error("<a x=1>", 1, "no \"value\"");
    check_error("<a x='1>", 1, "has no end");
    check_error("<a x='1'y='2'/>", 1, "no whole tag");
    check_error("<a x='1' x='2'/>", 1, "there twice");
    check_error("<a x='<'/>", 1, "has no end");
    check_error("<a / >", 1, "no whole tag");
    check_error("<a></a", 1, "no whole tag");
    check_error("<a>< b/></a>", 1, "without a name");
    check_error("<a><", 1, "without a name");
    check_error("<a>\n<!-- </a>", 2, "comment has no end");
    check_error("<?xml", 1, "no ?>");
    check_error("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", 1, "no DTD");
    check_error("<a><![CDATA[x]]></a>", 1, "no CDATA");
    check_error("<a>&b;</a>", 1, "is no reference");
    check_error("<a>&#0;</a>", 1, "is no reference");
    check_error("<a>&#xd800;</a>", 1, "is no reference");
    check_error("<a>&#1114112;</a>", 1, "is no reference");
    check_error("<a>&#99999999999999999999;</a>", 1, "is no reference");
    check_error("<a>&#-1;</a>", 1, "is no reference");
    check_error("<a>&#x;</a>", 1, "is no reference");
    check_error("<a>\n&am</a>", 2, "is no reference");
    check_error("<a>&", 1, "is no reference");
}

static void test_depth(void)
{
    char text[7 * (XML_MAX_DEPTH + 2)] = "";
    int line;
    for (int i = 0; i < XML_MAX_DEPTH; i++)
        strcat(text, "<a>");
    for (int i = 0; i < XML_MAX_DEPTH; i++)
        strcat(text, "</a>");
    CHECK(*pieces(text, &line) == '[' && line == 0);
    text[0] = 0;
    for (int i = 0; i <= XML_MAX_DEPTH; i++)
        strcat(text, "<a>");
    check_error(text, 1, "more than 64 deep");
}

CHECK_SUITE(xml, {"pieces", test_good}, {"mistakes", test_bad}, {"depth", test_depth});
