/* Target: XML in pieces. Elements that are opened are closed, and an end is an end. */
#ifndef TARGET_XML_H
#define TARGET_XML_H

#include "fuzz.h"

#include "examples/xml.h"

static void fuzz_xml(const uint8_t *data, size_t size)
{
    char *text = (char *)malloc(size + 1);
    xml_reader xml;
    xml_piece piece = XML_DONE;
    size_t count = 0;
    int depth = 0, lines = 1;
    FUZZ_REQUIRE(text != NULL);
    if (size)
        memcpy(text, data, size);
    text[size] = 0;
    for (size_t i = 0; i < size; i++)
        lines += text[i] == '\n';
    xml = xml_open(text);
    while ((piece = xml_next(&xml)) > XML_DONE) {
        depth += piece == XML_OPEN ? 1 : piece == XML_CLOSE ? -1 : 0;
        FUZZ_REQUIRE(depth >= 0 && depth <= XML_MAX_DEPTH && ++count <= 2 * size);
        FUZZ_REQUIRE(xml.line >= 1 && xml.line <= lines);
        FUZZ_REQUIRE(piece == XML_TEXT ? strlen(xml.text) <= size : strlen(xml.name) <= size);
    }
    FUZZ_REQUIRE(piece == XML_ERROR ? xml.message[0] != 0 && xml.line <= lines : depth == 0);
    FUZZ_REQUIRE(xml_next(&xml) == piece);
    free(text);
}

#endif /* TARGET_XML_H */
