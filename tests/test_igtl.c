/* igtl: messages of OpenIGTLink against checksums of the reference library, hostile bytes, and an organ that peers move
 * over sockets: examples/igtl.h, igtl_socket.h, igtl_organ.h, igtl_service.h. */
#include "examples/system.h"

#include "softbody.h"

#include "check.h"
#include "examples/igtl.h"
#include "examples/igtl_socket.h"
#include "examples/options.h"
#include "examples/organ_scene.h"

#include "examples/igtl_organ.h"
#include "examples/igtl_service.h"

enum { ROOM = 4096 };
static igtl_crc crc;

/* As the reference library's messages of the tests' date: device "Organ", this time. */
static igtl_envelope dated(void)
{
    igtl_envelope e = igtl_default_envelope("Organ");
    e.time = UINT64_C(0x499602d27fffffff);
    igtl_crc_make(&crc);
    return e;
}

/* Closes a message and opens it; its checksum is the reference's, unless that is 0. */
static igtl_message closed(const char *type, size_t content, unsigned char *buffer, uint64_t reference)
{
    igtl_envelope e = dated();
    igtl_message m;
    sb_error error;
    size_t size = igtl_close(&crc, type, &e, content, buffer);
    CHECK_OK(igtl_open(&crc, buffer, size, &m, &error));
    if (reference)
        CHECK(igtl_get_u64(buffer + 50) == reference);
    CHECK(igtl_is(&m, type) && strcmp(m.header.device, "Organ") == 0 && m.header.time == e.time);
    CHECK(m.content_size == content);
    return m;
}

static unsigned char *content_of(unsigned char *buffer) { return buffer + IGTL_HEADER; }

/* ---- the reference's checksums ----------------------------------------------------------------------------------- */

static void test_checksum(void)
{
    unsigned char text[64];
    uint64_t state = 0;
    igtl_crc_make(&crc);
    CHECK(igtl_crc_of(&crc, (const unsigned char *)"123456789", 9) == UINT64_C(0x6c40df5f0b497347));
    CHECK(igtl_crc_of(&crc, text, 0) == 0);
    for (unsigned i = 0; i < sizeof text; i++)
        text[i] = (unsigned char)(i * 37 + 11);
    for (size_t size = 1; size <= sizeof text; size++) { /* eight bytes at a time as one by one, bit by bit */
        state ^= (uint64_t)text[size - 1] << 56;
        for (int bit = 0; bit < 8; bit++)
            state = state << 1 ^ (state >> 63 ? UINT64_C(0x42F0E1EBA9EA3693) : 0);
        CHECK(igtl_crc_of(&crc, text, size) == state);
    }
}

static void test_transform(void)
{
    unsigned char buffer[ROOM];
    igtl_transform t, back;
    igtl_position p, place;
    igtl_message m;
    sb_error error;
    for (int k = 0; k < 12; k++)
        *(k < 9 ? &t.rotation[k % 3][k / 3] : &t.translation[k - 9]) = -1.25 + 0.5 * k;
    m = closed("TRANSFORM", igtl_put_transform(content_of(buffer), &t), buffer, UINT64_C(0x12bed940ece01c2e));
    CHECK_OK(igtl_get_transform(&m, &back, &error));
    CHECK(memcmp(&t, &back, sizeof t) == 0);
    for (int i = 0; i < 3; i++)
        p.position[i] = i + 1, p.quaternion[i] = 0;
    p.quaternion[3] = 1;
    m = closed("POSITION", igtl_put_position(content_of(buffer), &p), buffer, UINT64_C(0xfda842b7e9d866e8));
    CHECK_OK(igtl_get_position(&m, &place, &error));
    CHECK(memcmp(&p, &place, sizeof p) == 0);
    p.quaternion[0] = 0.6; /* w = 0.8 is left out */
    igtl_put_position(content_of(buffer), &p);
    m = closed("POSITION", 24, buffer, 0);
    CHECK_OK(igtl_get_position(&m, &place, &error));
    CHECK_NEAR(place.quaternion[3], 0.8, 1e-7);
    m = closed("POSITION", 12, buffer, 0);
    CHECK_OK(igtl_get_position(&m, &place, &error));
    CHECK(place.quaternion[0] == 0 && place.quaternion[3] == 1 && place.position[2] == 3);
    m = closed("POSITION", 20, buffer, 0);
    CHECK_RESULT(igtl_get_position(&m, &place, &error), SB_ERROR_FORMAT);
}

static void test_texts(void)
{
    unsigned char buffer[ROOM];
    igtl_text text = igtl_text_of("hello"), got;
    igtl_status status = {1, 2, "OK", "fine"}, told;
    igtl_command command, asked;
    igtl_message m;
    sb_error error;
    m = closed("STRING", igtl_put_string(content_of(buffer), &text), buffer, UINT64_C(0x11bb731ffe031765));
    CHECK_OK(igtl_get_string(&m, &got, &error));
    CHECK(got.length == 5 && memcmp(got.text, "hello", 5) == 0 && got.encoding == 3);
    m = closed("STATUS", igtl_put_status(content_of(buffer), &status), buffer, UINT64_C(0x0ae7e732e3818874));
    CHECK_OK(igtl_get_status(&m, &told, &error));
    CHECK(told.code == 1 && told.subcode == 2 && !strcmp(told.name, "OK") && !strcmp(told.message, "fine"));
    memset(&command, 0, sizeof command);
    command.id = 4000000000u;
    snprintf(command.name, sizeof command.name, "young");
    command.text = igtl_text_of("5000");
    m = closed("COMMAND", igtl_put_command(content_of(buffer), &command), buffer, 0);
    CHECK_INT(m.content_size, 138 + 4);
    CHECK_OK(igtl_get_command(&m, &asked, &error));
    CHECK(asked.id == command.id && !strcmp(asked.name, "young") && asked.text.length == 4);
}

/* What does not fit its field is the nearest that does; clocks that are wrong are the beginning of time. */
static void test_limits(void)
{
    const double values[4] = {1e300, -1e300, 2147483647.5, -7.9};
    unsigned char buffer[ROOM];
    igtl_array a, back;
    igtl_message m;
    sb_error error;
    memset(&a, 0, sizeof a);
    a.type = IGTL_INT32;
    a.dimensions = 1;
    a.sizes[0] = 4;
    m = closed("NDARRAY", igtl_put_array(content_of(buffer), &a, values), buffer, 0);
    CHECK_OK(igtl_get_array(&m, &back, &error));
    CHECK(igtl_array_number(&back, 0) == 2147483647 && igtl_array_number(&back, 1) == -2147483648.0);
    CHECK(igtl_array_number(&back, 2) == 2147483647 && igtl_array_number(&back, 3) == -7);
    CHECK(igtl_time(1234567890.5) == UINT64_C(0x499602d27fffffff));
    check_bad_numbers();
    CHECK(igtl_time(-1) == 0 && igtl_time(nan("")) == 0 && igtl_time(1e300) == UINT64_MAX);
}

static void test_points(void)
{
    unsigned char buffer[ROOM];
    igtl_point p, back;
    igtl_message m;
    sb_error error;
    size_t count;
    memset(&p, 0, sizeof p);
    snprintf(p.name, sizeof p.name, "tip");
    snprintf(p.group, sizeof p.group, "Landmark");
    snprintf(p.owner, sizeof p.owner, "ct");
    p.colour[0] = 255, p.colour[3] = 128;
    for (int i = 0; i < 3; i++)
        p.position[i] = i + 1;
    p.diameter = 4;
    m = closed("POINT", igtl_put_points(content_of(buffer), &p, 1), buffer, UINT64_C(0xf6de13f6f249923b));
    CHECK_OK(igtl_count_points(&m, &count, &error));
    CHECK_INT(count, 1);
    CHECK_OK(igtl_get_point(&m, 0, &back, &error));
    CHECK(!strcmp(back.name, "tip") && !strcmp(back.group, "Landmark") && !strcmp(back.owner, "ct"));
    CHECK(memcmp(back.colour, p.colour, 4) == 0 && back.position[1] == 2 && back.diameter == 4);
    memset(content_of(buffer), 'x', IGTL_POINT); /* fields that no 0 ends; the numbers are finite */
    m = closed("POINT", IGTL_POINT, buffer, 0);
    CHECK_OK(igtl_get_point(&m, 0, &back, &error));
    CHECK(strlen(back.name) == 64 && strlen(back.group) == 32 && strlen(back.owner) == 20);
    m = closed("POINT", IGTL_POINT - 1, buffer, 0);
    CHECK_RESULT(igtl_count_points(&m, &count, &error), SB_ERROR_FORMAT);
}

static void test_arrays(void)
{
    static const int types[] = {IGTL_INT32, IGTL_FLOAT32, IGTL_FLOAT64};
    const double values[6] = {0, 1, 2, 3, 4, 5}, signed_values[6] = {-1, 2147483647, -2147483647, 0, 7, -8};
    unsigned char buffer[ROOM];
    igtl_array a, back;
    igtl_message m;
    sb_error error;
    memset(&a, 0, sizeof a);
    a.type = IGTL_FLOAT32;
    a.dimensions = 2;
    a.sizes[0] = 2, a.sizes[1] = 3;
    closed("NDARRAY", igtl_put_array(content_of(buffer), &a, values), buffer, UINT64_C(0x12bc0f43de8e3a68));
    for (int t = 0; t < 3; t++) {
        a.type = types[t];
        m = closed("NDARRAY", igtl_put_array(content_of(buffer), &a, signed_values), buffer, 0);
        CHECK_OK(igtl_get_array(&m, &back, &error));
        CHECK_INT(back.count, 6);
        for (size_t i = 0; i < 6; i++)
            CHECK(igtl_array_number(&back, i) ==
                  (types[t] == IGTL_FLOAT32 ? (double)(float)signed_values[i] : signed_values[i]));
    }
    igtl_put_u16(content_of(buffer) + 2, 3); /* one row more than there are bytes for */
    m = closed("NDARRAY", m.content_size, buffer, 0);
    CHECK_RESULT(igtl_get_array(&m, &back, &error), SB_ERROR_FORMAT);
}

/* A tetrahedron's skin with a field of each kind. */
static size_t write_surface(unsigned char *content, const igtl_space *space)
{
    static const sb_vec3 points[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const int triangles[12] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};
    static const sb_real vectors[12] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}, scalars[4] = {5, 6, 7, 8};
    const igtl_attribute fields[3] = {{IGTL_VECTORS, 3, "displacement", 4, vectors},
                                      {IGTL_NORMALS, 3, "normals", 4, vectors},
                                      {IGTL_SCALARS | IGTL_OF_CELLS, 1, "area", 4, scalars}};
    igtl_surface s;
    s.points = points;
    s.point_count = 4;
    s.triangles = triangles;
    s.triangle_count = 4;
    s.attributes = fields;
    s.attribute_count = 3;
    return igtl_put_surface(content, &s, space);
}

static void test_polydata(void)
{
    const igtl_space space = {1000, 1}, metres = {1, 0};
    unsigned char buffer[ROOM];
    igtl_polydata p;
    igtl_message m;
    sb_error error;
    sb_vec3 v;
    size_t size = write_surface(NULL, &space);
    CHECK_INT(size, 40 + 48 + 64 + 18 + 26 + 4 * (12 + 12 + 4));
    CHECK(write_surface(content_of(buffer), &space) == size);
    m = closed("POLYDATA", size, buffer, 0);
    CHECK_OK(igtl_get_polydata(&m, &p, &error));
    CHECK(p.point_count == 4 && p.polygons.count == 4 && p.polygons.bytes == 64 && p.attribute_count == 3);
    CHECK(p.vertices.count + p.lines.count + p.strips.count == 0);
    CHECK(!strcmp(p.attributes[0].name, "displacement") && !strcmp(p.attributes[2].name, "area"));
    CHECK(p.attributes[2].type == 0x10 && p.attributes[2].count == 4);
    v = igtl_get_vector(p.points, 1, &metres);
    CHECK(v.x == -1000 && v.y == 0 && v.z == 0);
    v = igtl_get_vector(p.attributes[0].bytes, 1, &metres);
    CHECK(v.x == -4000 && v.y == -5000 && v.z == 6000);
    v = igtl_get_vector(p.attributes[1].bytes, 1, &metres); /* normals are turned only */
    CHECK(v.x == -4 && v.y == -5 && v.z == 6);
    v = igtl_get_vector(p.attributes[0].bytes, 3, &space);
    CHECK_NEAR(v.x, 10, 1e-5);
    CHECK_NEAR(igtl_get_float(p.attributes[2].bytes + 8), 7, 0);
}

static void test_metadata(void)
{
    const igtl_entry entries[2] = {{"patient", "anonymous", 7, 9, 3}, {"empty", "", 5, 0, 106}};
    unsigned char buffer[ROOM];
    igtl_envelope e = dated();
    igtl_transform t;
    igtl_message m;
    igtl_entry got;
    sb_error error;
    size_t size;
    memset(&t, 0, sizeof t);
    e.version = 2;
    e.message_id = 77;
    e.entries = entries;
    e.entry_count = 2;
    size = igtl_close(&crc, "TRANSFORM", &e, igtl_put_transform(igtl_content(&e, buffer), &t), buffer);
    CHECK_INT(size, IGTL_HEADER + 12 + 48 + 2 + 16 + 21);
    CHECK_OK(igtl_open(&crc, buffer, size, &m, &error));
    CHECK(m.message_id == 77 && m.entry_count == 2 && m.content_size == 48);
    got = igtl_get_entry(&m, 0);
    CHECK(got.key_length == 7 && got.value_length == 9 && !memcmp(got.value, "anonymous", 9) && got.encoding == 3);
    got = igtl_get_entry(&m, 1);
    CHECK(got.key_length == 5 && got.value_length == 0 && !memcmp(got.key, "empty", 5) && got.encoding == 106);
    CHECK_OK(igtl_get_transform(&m, &t, &error));
    igtl_put_u16(buffer + IGTL_HEADER + 12 + 48, 3); /* one entry more than sizes */
    igtl_put_u64(buffer + 50, igtl_crc_of(&crc, buffer + IGTL_HEADER, size - IGTL_HEADER));
    CHECK_RESULT(igtl_open(&crc, buffer, size, &m, &error), SB_ERROR_FORMAT);
}

/* ---- hostile bytes ----------------------------------------------------------------------------------------------- */

/* 1 when these bytes are of the content. */
static int lies_within(const igtl_message *m, const void *at, size_t size)
{
    const unsigned char *first = (const unsigned char *)at, *end = m->content + m->content_size;
    return first >= m->content && first <= end && size <= (size_t)(end - first);
}

/* Reads a content in every way, whatever it says it is: what is accepted lies within the bytes, and is finite where
 * that is promised. */
static void read_all(const igtl_message *m)
{
    static igtl_polydata polydata;
    igtl_transform transform;
    igtl_position position;
    igtl_command command;
    igtl_status status;
    igtl_array array;
    igtl_point point;
    igtl_text text;
    sb_error error;
    size_t count = 0;
    if (igtl_get_transform(m, &transform, &error) == SB_OK)
        CHECK(isfinite(transform.translation[0]) && isfinite(transform.rotation[2][2]));
    if (igtl_get_position(m, &position, &error) == SB_OK)
        CHECK(isfinite(position.position[1]) && isfinite(position.quaternion[3]));
    if (igtl_get_status(m, &status, &error) == SB_OK)
        CHECK(strlen(status.name) < sizeof status.name && strlen(status.message) < sizeof status.message);
    if (igtl_get_string(m, &text, &error) == SB_OK)
        CHECK(lies_within(m, text.text, text.length));
    if (igtl_get_command(m, &command, &error) == SB_OK)
        CHECK(lies_within(m, command.text.text, command.text.length));
    if (igtl_get_array(m, &array, &error) == SB_OK)
        CHECK(lies_within(m, array.bytes, array.count * igtl_array_width(array.type)));
    if (igtl_count_points(m, &count, &error) == SB_OK)
        for (size_t i = 0; i < count; i++)
            if (igtl_get_point(m, i, &point, &error) == SB_OK)
                CHECK(isfinite(point.position[0]) && strlen(point.name) <= 64);
    if (igtl_get_polydata(m, &polydata, &error) == SB_OK) {
        CHECK(lies_within(m, polydata.points, 12 * polydata.point_count));
        for (int i = 0; i < polydata.attribute_count; i++) {
            const igtl_attribute_view *a = polydata.attributes + i;
            CHECK(lies_within(m, a->bytes, 4 * a->count * (size_t)a->components));
            CHECK(lies_within(m, a->name, strlen(a->name) + 1));
        }
    }
    for (int i = 0; i < m->entry_count; i++) {
        igtl_entry entry = igtl_get_entry(m, i);
        CHECK(entry.key_length + entry.value_length <= m->header.body); /* further is what sanitizers see */
    }
}

/* Every beginning of it, and many with a byte changed, in memory of their own size: a reader past the end is seen. */
static void test_hostile(void)
{
    const igtl_space space = {1000, 0};
    unsigned char whole[ROOM], *exact;
    unsigned long long seed = 5;
    igtl_envelope e = dated();
    igtl_message m;
    igtl_header header;
    sb_error error;
    size_t size;
    check_bad_numbers();
    e.version = 2;
    size = igtl_close(&crc, "POLYDATA", &e, write_surface(igtl_content(&e, whole), &space), whole);
    for (size_t length = 0; length < size; length++) {
        exact = (unsigned char *)malloc(length + 1);
        memcpy(exact, whole, length);
        CHECK_RESULT(igtl_open(&crc, exact, length, &m, &error), SB_ERROR_FORMAT);
        CHECK(error.message[0] && m.content_size == 0);
        free(exact);
    }
    for (int round = 0; round < check_rounds(20000); round++) {
        size_t length =
            round % 3 ? size : IGTL_HEADER + (size_t)check_random_in(&seed, 0, (double)(size - IGTL_HEADER));
        exact = (unsigned char *)malloc(length);
        memcpy(exact, whole, length);
        for (int k = 0; k < 3; k++)
            exact[(size_t)check_random_in(&seed, 0, (double)length)] = (unsigned char)check_random_in(&seed, 0, 256);
        igtl_put_u64(exact + 42, length - IGTL_HEADER); /* the checksum lets it pass */
        igtl_put_u64(exact + 50, igtl_crc_of(&crc, exact + IGTL_HEADER, length - IGTL_HEADER));
        if (igtl_open(&crc, exact, length, &m, &error) == SB_OK)
            read_all(&m);
        free(exact);
    }
    whole[60] ^= 1;
    CHECK_RESULT(igtl_open(&crc, whole, size, &m, &error), SB_ERROR_FORMAT);
    CHECK(strstr(error.message, "checksum") != NULL);
    igtl_put_u64(whole + 42, (uint64_t)IGTL_MAX_BODY + 1);
    CHECK_RESULT(igtl_read_header(whole, &header, &error), SB_ERROR_FORMAT);
    igtl_put_u64(whole + 42, UINT64_MAX);
    CHECK_RESULT(igtl_read_header(whole, &header, &error), SB_ERROR_FORMAT);
    igtl_put_u64(whole + 42, 0);
    igtl_put_u16(whole, 9);
    CHECK_RESULT(igtl_read_header(whole, &header, &error), SB_ERROR_FORMAT);
    igtl_put_u16(whole, 1);
    whole[3] = 7;
    CHECK_RESULT(igtl_read_header(whole, &header, &error), SB_ERROR_FORMAT);
}

/* ---- an organ at the other end ------------------------------------------------------------------------------------
 */

static igtl_organ liver;
static igtl_service service;

static int begin_service(void)
{
    const char *why = "";
    sb_error error;
    liver = igtl_organ_default("test");
    if (!CHECK(igtl_sockets_begin()) || !CHECK_OK(sb_mesh_organ(SB_TET4, 4, NULL, &liver.scene.mesh, &error)) ||
        !CHECK_INT(igtl_organ_make(&liver), 0))
        return 0;
    igtl_service_begin(&service, &liver);
    service.quiet = 1;
    crc = liver.crc;
    return CHECK(igtl_listen(&service.listener, "127.0.0.1", 0, &why));
}

static void end_service(void)
{
    igtl_service_end(&service);
    igtl_organ_free(&liver);
}

static int join(igtl_link *link)
{
    const char *why = "";
    int peers = igtl_service_peers(&service);
    int good = CHECK(igtl_connect(link, "127.0.0.1", igtl_port(&service.listener), &why));
    for (int i = 0; good && i < 100 && igtl_service_peers(&service) == peers; i++)
        igtl_service_round(&service, 0.01);
    return good && CHECK_INT(igtl_service_peers(&service), peers + 1);
}

static size_t make_message(unsigned char *buffer, int version, const char *type, const char *device,
                           const void *content, size_t size)
{
    igtl_envelope e = igtl_default_envelope(device);
    e.version = version;
    e.message_id = 5;
    if (size)
        memcpy(igtl_content(&e, buffer), content, size);
    return igtl_close(&crc, type, &e, size, buffer);
}

static void tell(igtl_link *link, int version, const char *type, const char *device, const void *content, size_t size)
{
    unsigned char message[ROOM];
    igtl_answer(link, message, make_message(message, version, type, device, content, size));
}

static void say(igtl_link *link, const char *words)
{
    unsigned char content[300];
    igtl_text text = igtl_text_of(words);
    tell(link, 1, "STRING", "", content, igtl_put_string(content, &text));
}

/* The next message of the type, while the service goes on; 1 when it came. */
static int hear(igtl_link *link, const char *type, igtl_message *m)
{
    sb_error error;
    for (int i = 0; i < 200; i++) {
        int got = igtl_receive(link, &crc, m, &error);
        if (got == 1 && igtl_is(m, type))
            return 1;
        if (got == -2)
            return 0;
        if (got == 0) {
            igtl_flush(link);
            igtl_service_round(&service, 0.002);
        }
    }
    return 0;
}

static int hear_status(igtl_link *link, igtl_status *status)
{
    igtl_message m;
    sb_error error;
    memset(status, 0, sizeof *status);
    return CHECK(hear(link, "STATUS", &m)) && CHECK_OK(igtl_get_status(&m, status, &error));
}

/* 1 when a status comes that is good (0: one that is not). */
static int is_done(igtl_link *link)
{
    igtl_status status;
    return hear_status(link, &status) && status.code == IGTL_STATUS_OK;
}

static void step(void)
{
    CHECK_INT(organ_step(&liver.scene, 1.0 / 60), 0);
    igtl_service_send(&service);
}

static void send_tool(igtl_link *link, double z)
{
    unsigned char content[28];
    igtl_position p;
    memset(&p, 0, sizeof p);
    p.position[0] = 500 * (double)(liver.scene.low.x + liver.scene.high.x);
    p.position[1] = 500 * (double)(liver.scene.low.y + liver.scene.high.y);
    p.position[2] = z;
    p.quaternion[3] = 1;
    tell(link, 1, "POSITION", "Tool", content, igtl_put_position(content, &p));
}

static void test_organ(void)
{
    static igtl_polydata polydata;
    igtl_link link;
    igtl_message m;
    igtl_transform tool;
    igtl_array force;
    sb_error error;
    const igtl_space space = {1000, 0};
    double top, peak = 0;
    if (begin_service() && join(&link)) {
        step();
        if (CHECK(hear(&link, "POLYDATA", &m)) && CHECK_OK(igtl_get_polydata(&m, &polydata, &error))) {
            CHECK_INT(polydata.point_count, liver.scene.boundary.surface.node_count);
            CHECK_INT(polydata.polygons.count, liver.skin.element_count);
            for (size_t i = 0; i < polydata.point_count; i++) {
                sb_vec3 x = igtl_get_vector(polydata.points, i, &space);
                sb_vec3 y = sb_body_positions(liver.scene.body)[liver.scene.boundary.nodes[i]];
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(x, y)), 0, 1e-7);
            }
        }
        top = 1000 * (double)(liver.scene.high.z + (sb_real)liver.radius);
        for (int i = 0; i < 40; i++) {
            send_tool(&link, top + 20 - i);
            igtl_flush(&link);
            igtl_service_round(&service, 0.002);
            step();
            if (CHECK(hear(&link, "TRANSFORM", &m)) && CHECK_OK(igtl_get_transform(&m, &tool, &error)) && i == 1)
                CHECK_NEAR(tool.translation[2], top + 19, 1.5); /* it is on its way */
            if (CHECK(hear(&link, "NDARRAY", &m)) && CHECK_OK(igtl_get_array(&m, &force, &error)))
                peak = fmax(peak, igtl_array_number(&force, 2));
        }
        CHECK(peak > 0.01); /* the organ pushes the ball up (N) */
        check_bad_numbers();
        send_tool(&link, 1e9); /* m taken for mm, a lost tracker: not followed */
        CHECK(!is_done(&link));
        for (int i = 0; i < 5; i++)
            step();
        while (hear(&link, "TRANSFORM", &m) && igtl_get_transform(&m, &tool, &error) == SB_OK)
            CHECK(tool.translation[2] < top + 30);
        igtl_link_close(&link);
    }
    end_service();
}

static void send_targets(igtl_link *link, const igtl_point *points, size_t count)
{
    unsigned char content[3 * IGTL_POINT];
    tell(link, 1, "POINT", "Targets", content, igtl_put_points(content, points, count));
}

/* A point is held where it is first named, pulled to where it is named next, and let go. */
static void test_targets(void)
{
    igtl_link link;
    igtl_point p[2];
    igtl_status status;
    sb_vec3 before;
    int node;
    memset(p, 0, sizeof p);
    if (begin_service() && join(&link)) {
        node = igtl_organ_nearest(&liver, liver.scene.high);
        before = sb_body_positions(liver.scene.body)[node];
        snprintf(p[0].name, sizeof p[0].name, "a");
        p[0].position[0] = 1000 * (double)liver.scene.high.x;
        p[0].position[1] = 1000 * (double)liver.scene.high.y;
        p[0].position[2] = 1000 * (double)liver.scene.high.z;
        send_targets(&link, p, 1);
        for (int i = 0; i < 50 && !liver.target_count; i++)
            igtl_service_round(&service, 0.002);
        CHECK_INT(liver.target_count, 1);
        CHECK_INT(liver.targets[0].node, node);
        p[0].position[2] += 100;
        snprintf(p[1].name, sizeof p[1].name, "b");
        send_targets(&link, p, 2);
        for (int i = 0; i < 50 && liver.target_count < 2; i++)
            igtl_service_round(&service, 0.002);
        CHECK_INT(liver.target_count, 2);
        CHECK_INT(liver.targets[0].node, node);
        say(&link, "spring 500");
        hear_status(&link, &status);
        CHECK_INT(status.code, IGTL_STATUS_OK);
        for (int i = 0; i < 30; i++)
            step();
        CHECK(sb_body_positions(liver.scene.body)[node].z > before.z + (sb_real)0.01);
        p[0].position[0] = nan("");
        check_bad_numbers();
        send_targets(&link, p, 2);
        hear_status(&link, &status);
        CHECK(status.code != IGTL_STATUS_OK && liver.target_count == 2);
        p[0].position[0] = 1e10; /* mm */
        send_targets(&link, p, 2);
        CHECK(!is_done(&link) && liver.target_count == 2);
        p[0] = p[1]; /* of one name */
        send_targets(&link, p, 2);
        CHECK(!is_done(&link) && liver.target_count == 2);
        send_targets(&link, p, 0);
        for (int i = 0; i < 50 && liver.target_count; i++)
            igtl_service_round(&service, 0.002);
        CHECK_INT(liver.target_count, 0);
        igtl_link_close(&link);
    }
    end_service();
}

static void test_statements(void)
{
    static const char *const bad[] = {"young",        "young -5",       "young x",
                                      "young 1 2",    "gravity 1 2",    "young 1e999",
                                      "spring -1",    "friction -1",    "",
                                      "make coffee",  "young 1e300",    "young 0.1",
                                      "spring 1e300", "friction 1e300", "gravity 0 0 1e300"};
    unsigned char content[400];
    igtl_command command, answer;
    igtl_status status;
    igtl_message m;
    igtl_link link;
    sb_error error;
    if (begin_service() && join(&link)) {
        uint64_t hash;
        say(&link, "young 5000");
        hear_status(&link, &status);
        CHECK(status.code == IGTL_STATUS_OK && liver.young == 5000);
        say(&link, "gravity 0 0 -1");
        hear_status(&link, &status);
        CHECK_INT(status.code, IGTL_STATUS_OK);
        hash = sb_body_state_hash(liver.scene.body);
        check_bad_numbers();
        for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
            say(&link, bad[i]);
            hear_status(&link, &status);
            CHECK(status.code != IGTL_STATUS_OK && status.message[0]);
        }
        CHECK(sb_body_state_hash(liver.scene.body) == hash && liver.young == 5000);
        memset(&command, 0, sizeof command);
        command.id = 31;
        snprintf(command.name, sizeof command.name, "young");
        command.text = igtl_text_of("7000");
        tell(&link, 2, "COMMAND", "", content, igtl_put_command(content, &command));
        if (CHECK(hear(&link, "RTS_COMMAND", &m)) && CHECK_OK(igtl_get_command(&m, &answer, &error)))
            CHECK(answer.id == 31 && !answer.name[0] && m.header.version == 2 && m.message_id == 5 &&
                  liver.young == 7000);
        command.text = igtl_text_of("-7000");
        tell(&link, 2, "COMMAND", "", content, igtl_put_command(content, &command));
        if (CHECK(hear(&link, "RTS_COMMAND", &m)) && CHECK_OK(igtl_get_command(&m, &answer, &error)))
            CHECK(answer.name[0] && answer.text.length > 2 && liver.young == 7000);
        igtl_link_close(&link);
    }
    end_service();
}

static void test_streams(void)
{
    igtl_link link;
    igtl_message m;
    igtl_array a;
    sb_error error;
    if (begin_service() && join(&link)) {
        tell(&link, 1, "STP_POLYDATA", "", NULL, 0);
        CHECK(hear(&link, "RTS_POLYDATA", &m) && m.content[0] == 0);
        tell(&link, 1, "STP_TRANS", "Tool", NULL, 0);
        CHECK(hear(&link, "RTS_TRANS", &m));
        step();
        CHECK(hear(&link, "NDARRAY", &m) && strcmp(m.header.device, "Force") == 0);
        CHECK(!hear(&link, "POLYDATA", &m));
        tell(&link, 1, "GET_POLYDATA", "", NULL, 0);
        CHECK(hear(&link, "POLYDATA", &m));
        tell(&link, 1, "STT_NDARRAY", "Positions", NULL, 0);
        CHECK(hear(&link, "RTS_NDARRAY", &m));
        step();
        while (hear(&link, "NDARRAY", &m) && strcmp(m.header.device, "Positions") != 0)
            continue;
        if (CHECK_OK(igtl_get_array(&m, &a, &error))) {
            CHECK_INT(a.sizes[0], liver.scene.mesh.node_count);
            CHECK_NEAR(igtl_array_number(&a, 0), 1000 * (double)sb_body_positions(liver.scene.body)[0].x, 1e-4);
        }
        tell(&link, 1, "GET_IMAGE", "", NULL, 0);
        CHECK(hear(&link, "RTS_IMAGE", &m) && m.content[0] == 1);
        tell(&link, 1, "STP_IMAGE", "", NULL, 0);
        CHECK(hear(&link, "RTS_IMAGE", &m) && m.content[0] == 1);
        tell(&link, 1, "STP_NDARRAY", "Position", NULL, 0); /* no device of that name: nothing stops */
        CHECK(hear(&link, "RTS_NDARRAY", &m) && m.content[0] == 1);
        step();
        CHECK(hear(&link, "NDARRAY", &m) && strcmp(m.header.device, "Force") == 0);
        CHECK((m.header.time >> 32) + 2 >= (uint64_t)time(NULL) && m.header.time >> 32 <= (uint64_t)time(NULL));
        tell(&link, 1, "GET_CAPABIL", "", NULL, 0);
        CHECK(hear(&link, "CAPABILITY", &m) && m.content_size % 12 == 0 && m.content_size > 0);
        tell(&link, 1, "SENSOR", "", "?", 1); /* not known: passed over */
        tell(&link, 1, "GET_TRANS", "Tool", NULL, 0);
        CHECK(hear(&link, "TRANSFORM", &m));
        igtl_link_close(&link);
    }
    end_service();
}

/* Sends bytes one by one, or as they are. */
static void send_raw(igtl_link *link, const unsigned char *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        igtl_answer(link, bytes + i, 1);
        if (i % 16 == 0)
            igtl_service_round(&service, 0);
    }
}

/* Split reads, a bad checksum, two peers, one that never reads, garbage, one that goes in the middle of a message. */
static void test_peers(void)
{
    unsigned char message[ROOM];
    igtl_link first, second, idle, rude;
    igtl_status status;
    igtl_message m;
    igtl_text text = igtl_text_of("young 4000");
    unsigned char content[64];
    size_t size;
    if (begin_service() && join(&first) && join(&second) && join(&idle) && join(&rude)) {
        size = make_message(message, 1, "STRING", "", content, igtl_put_string(content, &text));
        send_raw(&first, message, size);
        hear_status(&first, &status);
        CHECK(status.code == IGTL_STATUS_OK && liver.young == 4000);
        message[IGTL_HEADER + 6] ^= 1;
        igtl_answer(&first, message, size);
        hear_status(&first, &status);
        CHECK(status.code == IGTL_STATUS_CHECKSUM && liver.young == 4000);
        say(&first, "young 4500"); /* the bad one was passed over by its size */
        hear_status(&first, &status);
        CHECK(status.code == IGTL_STATUS_OK && liver.young == 4500);
        memset(message, 0xee, sizeof message);
        igtl_answer(&rude, message, sizeof message);
        for (int i = 0; i < 50 && igtl_service_peers(&service) > 3; i++)
            igtl_service_round(&service, 0.002);
        CHECK_INT(igtl_service_peers(&service), 3);
        for (int i = 0; i < 400; i++) { /* more than the system holds for one that does not read */
            step();
            CHECK(hear(&first, "POLYDATA", &m));
            CHECK(hear(&second, "POLYDATA", &m));
        }
        CHECK(service.links[2].skipped > 0 || service.links[2].frame.used == 0);
        CHECK_INT(igtl_service_peers(&service), 3);
        size = make_message(message, 1, "STRING", "", content, igtl_put_string(content, &text));
        igtl_answer(&second, message, size / 2);
        igtl_link_close(&second);
        for (int i = 0; i < 50 && igtl_service_peers(&service) > 2; i++)
            igtl_service_round(&service, 0.002);
        CHECK_INT(igtl_service_peers(&service), 2);
        step();
        CHECK(hear(&first, "POLYDATA", &m));
        CHECK(liver.young == 4500);
        igtl_link_close(&first);
        igtl_link_close(&idle);
        igtl_link_close(&rude);
    }
    end_service();
}

/* Whether one more peer is let in while all places are taken: it is sent a frame. */
static int is_let_in(void)
{
    igtl_link link;
    const char *why = "";
    igtl_message m;
    int in = 0;
    if (!CHECK(igtl_connect(&link, "127.0.0.1", igtl_port(&service.listener), &why)))
        return 0;
    for (int i = 0; i < 20 && !in && igtl_is_open(&link); i++) {
        sb_error error;
        step();
        igtl_service_round(&service, 0.002);
        in = igtl_receive(&link, &crc, &m, &error) == 1;
    }
    igtl_link_close(&link);
    return in;
}

/* Peers that stop in the middle of a message keep nobody out, those that have nothing to say keep their place. */
static void test_stalled(void)
{
    unsigned char message[ROOM], content[64];
    igtl_text text = igtl_text_of("young 4000");
    igtl_link links[IGTL_LINKS];
    igtl_message m;
    int joined = 0;
    size_t size;
    if (!begin_service())
        return;
    size = make_message(message, 1, "STRING", "", content, igtl_put_string(content, &text));
    while (joined < IGTL_LINKS && join(links + joined))
        joined++;
    if (CHECK_INT(joined, IGTL_LINKS)) {
        CHECK(!is_let_in());
        for (int i = 2; i < IGTL_LINKS; i++)
            igtl_answer(links + i, message, size / 2);
        for (int i = 0; i < 20; i++)
            igtl_service_round(&service, 0.002);
        CHECK(!is_let_in()); /* they may be slow */
        service.patience = 0;
        CHECK(is_let_in());
        step();
        CHECK(hear(links, "POLYDATA", &m));
        CHECK(hear(links + 1, "POLYDATA", &m));
    }
    while (joined > 0)
        igtl_link_close(links + --joined);
    end_service();
}

/* A peer that never stops talking does not keep the others, or the organ's next step, from their turn. */
static void test_flood(void)
{
    enum { STATEMENTS = 4 * IGTL_ROUND_MESSAGES };
    unsigned char *large;
    igtl_link link, talks;
    char words[32];
    int rounds = 0;
    if (begin_service() && join(&link) && join(&talks)) {
        for (int i = 1; i <= STATEMENTS; i++) {
            snprintf(words, sizeof words, "young %d", 1000 + i);
            say(&talks, words);
        }
        igtl_service_round(&service, 0.1);
        CHECK(liver.young <= 1000 + IGTL_ROUND_MESSAGES);
        say(&link, "friction 0.1");
        igtl_service_round(&service, 0.1);
        CHECK(is_done(&link) && liver.young <= 1000 + 3 * IGTL_ROUND_MESSAGES);
        for (; rounds < 100 && liver.young < 1000 + STATEMENTS; rounds++)
            igtl_service_round(&service, 0.002);
        CHECK(liver.young == 1000 + STATEMENTS); /* none was lost */
        large = (unsigned char *)calloc(1, 1 << 20);
        if (CHECK(large)) { /* who says that much is to come is not given memory before it does */
            igtl_put_u16(large, 1);
            memcpy(large + 2, "SENSOR", 6);
            igtl_put_u64(large + 42, IGTL_MAX_BODY);
            igtl_answer(&talks, large, IGTL_HEADER + 1000);
            for (int i = 0; i < 10; i++)
                igtl_service_round(&service, 0.002);
            CHECK(service.links[1].in.used == IGTL_HEADER + 1000 && service.links[1].in.size < 1 << 20);
        }
        free(large);
        igtl_link_close(&link);
        igtl_link_close(&talks);
    }
    end_service();
}

/* Takes `size` bytes off a link, whatever they are. */
static int drain(igtl_link *link, igtl_link *sender, unsigned char *buffer, size_t size)
{
    for (int tries = 0; tries < 2000 && size > 0; tries++) {
        long got = (long)recv(link->handle, (char *)buffer, (igtl_length)size, 0);
        size -= got > 0 ? (size_t)got : 0;
        igtl_flush(sender);
        if (got <= 0)
            igtl_wait(NULL, link, 1, 0.01);
    }
    return size == 0;
}

/* A peer that reads on is not given up, though it is never through; one that does not read is. */
static void test_reader(void)
{
    enum { BLOCK = 50000, SYSTEM = 1 << 16, BLOCKS = 3 * IGTL_MAX_ANSWERS / BLOCK };
    unsigned char *block = (unsigned char *)calloc(1, BLOCK);
    igtl_link reader, *sender = service.links;
    int size = SYSTEM, sent = 0;
    if (CHECK(block) && begin_service() && join(&reader)) {
        setsockopt(sender->handle, SOL_SOCKET, SO_SNDBUF, (const char *)&size, sizeof size);
        setsockopt(reader.handle, SOL_SOCKET, SO_RCVBUF, (const char *)&size, sizeof size);
        while (sent < BLOCKS && CHECK(igtl_is_open(sender))) {
            if (sender->answers.used - sender->answers.done > IGTL_MAX_ANSWERS / 2) {
                CHECK(drain(&reader, sender, block, BLOCK));
                continue;
            }
            igtl_answer(sender, block, BLOCK);
            sent++;
        }
        for (int i = 0; i < 10 * BLOCKS && igtl_is_open(sender); i++)
            igtl_answer(sender, block, BLOCK);
        CHECK(!igtl_is_open(sender));
        igtl_link_close(&reader);
    }
    free(block);
    end_service();
}

CHECK_SUITE(igtl, {"checksum of ECMA-182", test_checksum},
            {"transform and position as the reference's", test_transform}, {"string, status, command", test_texts},
            {"limits of numbers and times", test_limits}, {"points", test_points}, {"arrays", test_arrays},
            {"polydata in the patient's axes", test_polydata}, {"protocol 3's metadata", test_metadata},
            {"hostile bytes", test_hostile}, {"an organ that a ball presses", test_organ},
            {"targets that pull", test_targets}, {"statements and commands", test_statements},
            {"streams on request", test_streams}, {"peers that are slow, rude or gone", test_peers},
            {"peers that stall", test_stalled}, {"a peer that talks without end", test_flood},
            {"a peer that reads slowly", test_reader});
