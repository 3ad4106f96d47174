/* xml: reads XML piece by piece in one buffer, which it cuts into words: elements, attributes, text, comments, the
 * declaration, the five entities and character references. No DTD (refused: entities could be bombs), no CDATA, no
 * namespaces (a prefix is part of the name). Names and texts stay where they are in the buffer, as strings.
 *
 *     xml_reader xml = xml_open(text);
 *     while ((piece = xml_next(&xml)) > XML_DONE) ...        XML_ERROR: xml.message tells what is wrong in xml.line
 */
#ifndef XML_H
#define XML_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { XML_MAX_DEPTH = 64, XML_MAX_ATTRIBUTES = 32 };

typedef enum xml_piece {
    XML_ERROR = -1,
    XML_DONE = 0, /* the end of the file, after its one element */
    XML_OPEN,     /* <name attributes>: name, attributes */
    XML_CLOSE,    /* </name>, or the end of <name/>: name */
    XML_TEXT      /* text that is not blank: text */
} xml_piece;

typedef struct xml_attribute {
    const char *name, *value;
} xml_attribute;

typedef struct xml_level {
    const char *name;
    int line;
} xml_level;

typedef struct xml_reader {
    char *at;
    int at_tag;   /* the `<` at the place was overwritten by the end of a text */
    int is_empty; /* the last piece was <name/>, whose XML_CLOSE comes next */
    int has_root;
    int at_line; /* of the place */
    xml_level levels[XML_MAX_DEPTH];
    int depth; /* open elements */

    int line; /* of the last piece */
    const char *name;
    char *text;
    xml_attribute attributes[XML_MAX_ATTRIBUTES];
    int attribute_count;
    char message[240];
} xml_reader;

static inline xml_reader xml_open(char *text)
{
    xml_reader xml;
    memset(&xml, 0, sizeof xml);
    xml.at = text;
    xml.at_line = 1;
    return xml;
}

#if defined(__GNUC__)
#define XML_PRINTF __attribute__((format(printf, 2, 3)))
#else
#define XML_PRINTF
#endif

/* Says what is wrong at the place; nothing comes after it. */
XML_PRINTF static inline xml_piece xml_fail(xml_reader *xml, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(xml->message, sizeof xml->message, format, arguments);
    va_end(arguments);
    xml->line = xml->at_line;
    return XML_ERROR;
}

/* The value of an attribute of the last XML_OPEN; NULL: it has none. */
static inline const char *xml_attribute_of(const xml_reader *xml, const char *name)
{
    for (int i = 0; i < xml->attribute_count; i++)
        if (strcmp(xml->attributes[i].name, name) == 0)
            return xml->attributes[i].value;
    return NULL;
}

/* ---- characters -------------------------------------------------------------------------------------------- */

static inline int xml_is_blank(char letter)
{
    return letter == ' ' || letter == '\t' || letter == '\r' || letter == '\n';
}

static inline int xml_starts_name(char letter)
{
    return (letter >= 'a' && letter <= 'z') || (letter >= 'A' && letter <= 'Z') || letter == '_' || letter == ':' ||
           (unsigned char)letter >= 0x80;
}

static inline int xml_goes_on(char letter)
{
    return xml_starts_name(letter) || (letter >= '0' && letter <= '9') || letter == '-' || letter == '.';
}

/* Steps over blanks, and counts lines. */
static inline void xml_skip_blanks(xml_reader *xml)
{
    for (; xml_is_blank(*xml->at); xml->at++)
        xml->at_line += *xml->at == '\n';
}

/* Steps to the first `end` from the place on and over it; 0: there is none. */
static inline int xml_skip_to(xml_reader *xml, const char *end)
{
    char *found = strstr(xml->at, end);
    if (!found)
        return 0;
    for (; xml->at < found; xml->at++)
        xml->at_line += *xml->at == '\n';
    xml->at += strlen(end);
    return 1;
}

/* Writes a character in UTF-8, which is never longer than its reference; returns the place after it. */
static inline char *xml_put_character(char *to, unsigned long code)
{
    int more = code < 0x80 ? 0 : code < 0x800 ? 1 : code < 0x10000 ? 2 : 3;
    static const unsigned char first[] = {0, 0xc0, 0xe0, 0xf0};
    *to++ = (char)(first[more] | (code >> (6 * more)));
    while (more-- > 0)
        *to++ = (char)(0x80 | ((code >> (6 * more)) & 0x3f));
    return to;
}

/* The character of &#D; or &#xH; from after the #; 0: it is none. */
static inline unsigned long xml_scan_reference(const char *digits, char **end)
{
    int is_hex = *digits == 'x';
    unsigned long code;
    digits += is_hex;
    if (!*digits || !strchr(is_hex ? "0123456789abcdefABCDEF" : "0123456789", *digits))
        return 0;
    code = strtoul(digits, end, is_hex ? 16 : 10);
    if (code > 0x10ffff || (code >= 0xd800 && code < 0xe000) || (code < 0x20 && code != 9 && code != 10 && code != 13))
        return 0;
    return code;
}

/* Puts what the reference at *from means at *to; 0: it means nothing. */
static inline int xml_decode_one(char **from, char **to)
{
    static const struct {
        const char *text;
        char letter;
    } entities[] = {{"&lt;", '<'}, {"&gt;", '>'}, {"&amp;", '&'}, {"&apos;", '\''}, {"&quot;", '"'}};
    char *end = NULL;
    unsigned long code;
    for (int i = 0; i < 5; i++)
        if (strncmp(*from, entities[i].text, strlen(entities[i].text)) == 0) {
            *(*to)++ = entities[i].letter;
            *from += strlen(entities[i].text);
            return 1;
        }
    code = (*from)[1] == '#' ? xml_scan_reference(*from + 2, &end) : 0;
    if (code == 0 || *end != ';')
        return 0;
    *to = xml_put_character(*to, code);
    *from = end + 1;
    return 1;
}

/* Decodes what lies before `end`, in place and with a 0 behind it, and counts its lines; 0 and a message when a
 * reference is none. */
static inline int xml_decode(xml_reader *xml, char *from, const char *end)
{
    char *to = from;
    while (from < end) {
        xml->at_line += *from == '\n';
        if (*from != '&') {
            *to++ = *from++;
        } else if (!xml_decode_one(&from, &to) || from > end) {
            xml_fail(xml, "%.*s is no reference that is read: &lt; &gt; &amp; &apos; &quot; and &#N; are",
                     (int)strcspn(from, " \t\r\n<;\"") % 12, from);
            return 0;
        }
    }
    *to = 0;
    return 1;
}

/* ---- tags -------------------------------------------------------------------------------------------------- */

/* Cuts a name off; *after gets the letter behind it, which its end overwrites. NULL: there is no name. */
static inline const char *xml_take_name(xml_reader *xml, char *after)
{
    char *name = xml->at;
    if (!xml_starts_name(*name))
        return NULL;
    while (xml_goes_on(*xml->at))
        xml->at++;
    *after = *xml->at;
    if (*xml->at)
        *xml->at++ = 0;
    return name;
}

/* One name="value"; its name is cut off already, and `after` was behind it. */
static inline int xml_take_attribute(xml_reader *xml, const char *name, char after)
{
    char quote[2] = {0, 0}, *value, *end;
    if (xml_is_blank(after)) {
        xml->at_line += after == '\n';
        xml_skip_blanks(xml);
        after = *xml->at;
        xml->at += after != 0;
    }
    if (after == '=')
        xml_skip_blanks(xml);
    quote[0] = *xml->at;
    if (after != '=' || (quote[0] != '"' && quote[0] != '\'')) {
        xml_fail(xml, "attribute %.80s has no \"value\"", name);
        return 0;
    }
    value = ++xml->at;
    end = value + strcspn(value, quote);
    if (!*end || memchr(value, '<', (size_t)(end - value))) {
        xml_fail(xml, "the value of attribute %.80s has no end", name);
        return 0;
    }
    if (xml_attribute_of(xml, name) || xml->attribute_count == XML_MAX_ATTRIBUTES) {
        xml_fail(xml, "attribute %.80s is there twice, or one of more than %d", name, (int)XML_MAX_ATTRIBUTES);
        return 0;
    }
    if (!xml_decode(xml, value, end))
        return 0;
    xml->attributes[xml->attribute_count].name = name;
    xml->attributes[xml->attribute_count++].value = value;
    xml->at = end + 1;
    return 1;
}

/* The rest of <name ...> or <name .../>, after its name; `after` was behind that. */
static inline xml_piece xml_take_open(xml_reader *xml, char after)
{
    for (;;) {
        int was_blank = xml_is_blank(after);
        const char *name;
        if (was_blank) {
            xml->at_line += after == '\n';
            xml_skip_blanks(xml);
            after = *xml->at;
            if (after == '/' || after == '>')
                xml->at++;
        }
        if (after == '>' || (after == '/' && *xml->at == '>')) {
            xml->is_empty = after == '/';
            xml->at += xml->is_empty;
            return XML_OPEN;
        }
        name = was_blank ? xml_take_name(xml, &after) : NULL;
        if (!name)
            return xml_fail(xml, "<%.80s> is no whole tag", xml->name);
        if (!xml_take_attribute(xml, name, after))
            return XML_ERROR;
        after = *xml->at;
        xml->at += after != 0;
    }
}

/* </name>, from its name on. */
static inline xml_piece xml_take_close(xml_reader *xml)
{
    char after = 0;
    const char *name = xml_take_name(xml, &after);
    const xml_level *level = xml->levels + xml->depth - 1;
    if (name && xml_is_blank(after)) {
        xml->at_line += after == '\n';
        xml_skip_blanks(xml);
        after = *xml->at;
        xml->at += after != 0;
    }
    if (!name || after != '>')
        return xml_fail(xml, "</ is no whole tag");
    if (xml->depth == 0)
        return xml_fail(xml, "</%.80s> ends nothing", name);
    if (strcmp(level->name, name) != 0)
        return xml_fail(xml, "</%.80s> where <%.80s> of line %d must end", name, level->name, level->line);
    xml->name = name;
    xml->depth--;
    return XML_CLOSE;
}

/* A tag, from after its <. XML_DONE: it was a comment or declaration, and the next piece is to be taken. */
static inline xml_piece xml_take_tag(xml_reader *xml)
{
    char after = 0;
    xml->line = xml->at_line;
    if (*xml->at == '/') {
        xml->at++;
        return xml_take_close(xml);
    }
    if (strncmp(xml->at, "!--", 3) == 0) {
        xml->at += 3;
        return xml_skip_to(xml, "-->") ? XML_DONE : xml_fail(xml, "the comment has no end");
    }
    if (*xml->at == '?')
        return xml_skip_to(xml, "?>") ? XML_DONE : xml_fail(xml, "<? has no ?>");
    if (*xml->at == '!')
        return xml_fail(xml, "<! is read in comments only: no DTD, no CDATA");
    xml->name = xml_take_name(xml, &after);
    if (!xml->name)
        return xml_fail(xml, "< without a name behind it");
    if (xml->depth == XML_MAX_DEPTH)
        return xml_fail(xml, "elements are nested more than %d deep", (int)XML_MAX_DEPTH);
    if (xml->depth == 0 && xml->has_root)
        return xml_fail(xml, "<%.80s> after the file's one element", xml->name);
    xml->has_root = 1;
    xml->levels[xml->depth].name = xml->name;
    xml->levels[xml->depth++].line = xml->line;
    xml->attribute_count = 0;
    return xml_take_open(xml, after);
}

/* The text up to the next tag, which is not blank. */
static inline xml_piece xml_take_text(xml_reader *xml)
{
    char *text = xml->at, *end = text + strcspn(text, "<");
    xml->line = xml->at_line;
    if (xml->depth == 0)
        return xml_fail(xml, "text outside the file's element");
    xml->at_tag = *end == '<';
    xml->at = end + xml->at_tag;
    if (!xml_decode(xml, text, end))
        return XML_ERROR;
    xml->text = text;
    return XML_TEXT;
}

/* The next piece. After XML_DONE and XML_ERROR there is none. */
static inline xml_piece xml_next(xml_reader *xml)
{
    xml_piece piece = XML_DONE;
    if (xml->message[0])
        return XML_ERROR;
    if (xml->is_empty) {
        xml->is_empty = 0;
        xml->name = xml->levels[--xml->depth].name;
        return XML_CLOSE;
    }
    while (piece == XML_DONE) {
        if (!xml->at_tag)
            xml_skip_blanks(xml);
        if (!xml->at_tag && !*xml->at) {
            if (xml->depth > 0)
                return xml_fail(xml, "the file ends within <%.80s> of line %d", xml->levels[xml->depth - 1].name,
                                xml->levels[xml->depth - 1].line);
            return xml->has_root ? XML_DONE : xml_fail(xml, "the file has no element");
        }
        if (!xml->at_tag && *xml->at != '<')
            return xml_take_text(xml);
        xml->at += !xml->at_tag;
        xml->at_tag = 0;
        piece = xml_take_tag(xml);
    }
    return piece;
}

#endif /* XML_H */
