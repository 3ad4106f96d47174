/* meshio_xml: the tags of an XML file, as far as mesh files need them. Source: "Extensible Markup Language (XML) 1.0",
 * without entities, document type definitions and CDATA sections. */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

static int sbi_xml_is_blank(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

/* Steps over a character, counting lines. */
static void sbi_xml_step(sbi_reader *reader)
{
    char c = reader->data[reader->at++];
    int lone = c == '\r' && (reader->at >= reader->size || reader->data[reader->at] != '\n');
    if ((c == '\n' || lone) && reader->line < INT_MAX)
        reader->line++;
}

static void sbi_xml_skip_blanks(sbi_reader *reader)
{
    while (reader->at < reader->size && sbi_xml_is_blank(reader->data[reader->at]))
        sbi_xml_step(reader);
}

/* Steps behind the next `end`. */
static sb_result sbi_xml_skip_behind(sbi_reader *reader, const char *end)
{
    size_t length = strlen(end);
    for (; sbi_reader_left(reader) >= length; sbi_xml_step(reader))
        if (memcmp(reader->data + reader->at, end, length) == 0) {
            reader->at += length;
            return SB_OK;
        }
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where \"%s\" should be", end);
}

static int sbi_xml_starts_with(const sbi_reader *reader, const char *text)
{
    size_t length = strlen(text);
    return sbi_reader_left(reader) >= length && memcmp(reader->data + reader->at, text, length) == 0;
}

/* A name: up to a blank or a sign of the syntax. */
static sb_result sbi_xml_name(sbi_reader *reader, sbi_word *name)
{
    name->text = reader->data + reader->at;
    while (reader->at < reader->size && !sbi_xml_is_blank(reader->data[reader->at]) &&
           !memchr("<>/=\"'", reader->data[reader->at], 6))
        reader->at++;
    name->length = (size_t)(reader->data + reader->at - name->text);
    return name->length ? SB_OK : sbi_reader_fail(reader, SB_ERROR_FORMAT, "a name is missing in a tag");
}

/* name="value" or name='value' */
static sb_result sbi_xml_read_attribute(sbi_xml *xml)
{
    sbi_reader *reader = xml->reader;
    sbi_word *value;
    sb_result result;
    char quote;
    if (xml->attribute_count >= SBI_XML_ATTRIBUTES)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "an element with more than %d attributes",
                               SBI_XML_ATTRIBUTES);
    result = sbi_xml_name(reader, &xml->attributes[xml->attribute_count]);
    if (result)
        return result;
    sbi_xml_skip_blanks(reader);
    if (!sbi_xml_starts_with(reader, "="))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "an attribute without a value");
    reader->at++;
    sbi_xml_skip_blanks(reader);
    quote = reader->at < reader->size ? reader->data[reader->at] : 0;
    if (quote != '"' && quote != '\'')
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "an attribute's value is not quoted");
    reader->at++;
    value = &xml->values[xml->attribute_count++];
    value->text = reader->data + reader->at;
    while (reader->at < reader->size && reader->data[reader->at] != quote)
        sbi_xml_step(reader);
    if (reader->at >= reader->size)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in an attribute");
    value->length = (size_t)(reader->data + reader->at - value->text);
    reader->at++;
    return SB_OK;
}

/* Behind "<": name, attributes, ">" or "/>". */
static sb_result sbi_xml_start(sbi_xml *xml)
{
    sbi_reader *reader = xml->reader;
    sb_result result = sbi_xml_name(reader, &xml->name);
    xml->event = SBI_XML_START;
    xml->attribute_count = 0;
    if (!result && xml->depth >= SBI_XML_DEPTH)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "elements in each other more than %d deep", SBI_XML_DEPTH);
    while (!result) {
        sbi_xml_skip_blanks(reader);
        if (sbi_xml_starts_with(reader, "/>") || sbi_xml_starts_with(reader, ">"))
            break;
        if (reader->at >= reader->size)
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in a tag");
        result = sbi_xml_read_attribute(xml);
    }
    if (result)
        return result;
    xml->stop_next = reader->data[reader->at] == '/';
    reader->at += xml->stop_next ? 2u : 1u;
    xml->open[xml->depth++] = xml->name;
    return SB_OK;
}

static sb_result sbi_xml_stop(sbi_xml *xml)
{
    sbi_reader *reader = xml->reader;
    sbi_word open, name;
    char text[32], own[32];
    sb_result result;
    reader->at += 2;
    result = sbi_xml_name(reader, &name);
    if (result)
        return result;
    sbi_xml_skip_blanks(reader);
    if (!sbi_xml_starts_with(reader, ">"))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "an end tag without its \">\"");
    reader->at++;
    if (xml->depth == 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "</%s> closes nothing", sbi_word_print(name, text));
    open = xml->open[--xml->depth];
    if (open.length != name.length || memcmp(open.text, name.text, name.length) != 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "</%s> where </%s> should be", sbi_word_print(name, text),
                               sbi_word_print(open, own));
    xml->event = SBI_XML_STOP;
    xml->name = name;
    return SB_OK;
}

SBI_API sb_result sbi_xml_next(sbi_xml *xml)
{
    sbi_reader *reader = xml->reader;
    sb_result result = SB_OK;
    char text[32];
    if (xml->stop_next) {
        xml->stop_next = 0;
        xml->event = SBI_XML_STOP;
        xml->name = xml->open[--xml->depth];
        return SB_OK;
    }
    while (!result) {
        while (reader->at < reader->size && reader->data[reader->at] != '<')
            sbi_xml_step(reader);
        if (reader->at >= reader->size) {
            xml->event = SBI_XML_END;
            if (xml->depth > 0)
                return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in <%s>",
                                       sbi_word_print(xml->open[xml->depth - 1], text));
            return SB_OK;
        }
        if (sbi_xml_starts_with(reader, "<!--"))
            result = sbi_xml_skip_behind(reader, "-->");
        else if (sbi_xml_starts_with(reader, "<?"))
            result = sbi_xml_skip_behind(reader, "?>");
        else if (sbi_xml_starts_with(reader, "<!"))
            return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED,
                                   "XML with document type definitions or CDATA sections is not read");
        else if (sbi_xml_starts_with(reader, "</"))
            return sbi_xml_stop(xml);
        else {
            reader->at++;
            return sbi_xml_start(xml);
        }
    }
    return result;
}

SBI_API int sbi_xml_attribute(const sbi_xml *xml, const char *name, sbi_word *value)
{
    for (int i = 0; i < xml->attribute_count; i++)
        if (sbi_word_equals(xml->attributes[i], name)) {
            *value = xml->values[i];
            return 1;
        }
    return 0;
}
