/* picture: the PNG writer against a decoder, what hides what, colours and text of examples/picture.h. */
#include "softbody.h"

#include "check.h"
#include "examples/picture.h"

#define FILE_NAME "test_picture.png"

/* ---- a decoder for the PNG files that picture.h writes ---- */

typedef struct bit_reader {
    const unsigned char *data;
    size_t size, bit;
} bit_reader;

static unsigned take_bits(bit_reader *r, int count)
{
    unsigned value = 0;
    for (int i = 0; i < count; i++, r->bit++)
        if (r->bit / 8 < r->size)
            value |= (unsigned)(r->data[r->bit / 8] >> (r->bit % 8) & 1) << i;
    return value;
}

static unsigned take_code(bit_reader *r, int count)
{
    unsigned code = 0;
    while (count-- > 0)
        code = code << 1 | take_bits(r, 1);
    return code;
}

/* Symbol of the fixed code, by the table of RFC 1951, 3.2.6. */
static unsigned take_symbol(bit_reader *r)
{
    unsigned code = take_code(r, 7);
    if (code <= 0x17)
        return 256 + code;
    code = code << 1 | take_bits(r, 1);
    if (code >= 0x30 && code <= 0xbf)
        return code - 0x30;
    if (code >= 0xc0 && code <= 0xc7)
        return 280 + code - 0xc0;
    return 144 + (code << 1 | take_bits(r, 1)) - 0x190;
}

/* Inflates a zlib stream of one fixed block to out[size]; 1 when it holds that many bytes and the checksum fits. */
static int inflate_fixed(const unsigned char *data, size_t data_size, unsigned char *out, size_t size)
{
    static const int base[] = {3,  4,  5,  6,  7,  8,  9,  10, 11,  13,  15,  17,  19,  23, 27,
                               31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258};
    static const int extra[] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0};
    bit_reader r = {data, data_size, 16};
    size_t n = 0;
    unsigned long a = 1, b = 0;
    if (take_bits(&r, 3) != 3 || (data[0] * 256 + data[1]) % 31 != 0)
        return 0;
    for (unsigned symbol; r.bit < 8 * data_size && (symbol = take_symbol(&r)) != 256;) {
        if (symbol < 256) {
            if (n == size)
                return 0;
            out[n++] = (unsigned char)symbol;
            continue;
        }
        size_t length = (size_t)base[symbol - 257] + take_bits(&r, extra[symbol - 257]);
        unsigned code = take_code(&r, 5);
        int more = code < 4 ? 0 : (int)code / 2 - 1;
        size_t distance = 1 + (code < 4 ? code : (size_t)(2 + code % 2) << more) + take_bits(&r, more);
        if (distance > n || length > size - n)
            return 0;
        for (; length > 0; length--, n++)
            out[n] = out[n - distance];
    }
    for (size_t i = 0; i < n; i++) {
        a = (a + out[i]) % 65521;
        b = (b + a) % 65521;
    }
    r.bit = (r.bit + 7) / 8 * 8;
    unsigned long stored = 0;
    for (int i = 0; i < 4; i++)
        stored = stored << 8 | take_bits(&r, 8);
    return n == size && stored == (b << 16 | a) && r.bit == 8 * data_size;
}

static size_t big_endian(const unsigned char *p)
{
    return (size_t)p[0] << 24 | (size_t)p[1] << 16 | (size_t)p[2] << 8 | (size_t)p[3];
}

/* Pixels [height][width][3] of a file, or NULL after a failed check; free() them. */
static unsigned char *read_png(const char *path, int width, int height)
{
    static const unsigned char end[12] = {0, 0, 0, 0, 'I', 'E', 'N', 'D', 0xae, 0x42, 0x60, 0x82}; /* CRC known */
    size_t row = 1 + 3 * (size_t)width, rows = row * (size_t)height, size, most = 2 * rows + 1000;
    unsigned char *file = (unsigned char *)malloc(most), *raw = (unsigned char *)malloc(rows);
    unsigned char *pixels = (unsigned char *)malloc(rows);
    FILE *stream = fopen(path, "rb");
    int good = file && raw && pixels && stream;
    size = good ? fread(file, 1, most, stream) : 0;
    if (stream)
        fclose(stream);
    good = CHECK(good && size > 57 && size < most) && CHECK(memcmp(file, "\x89PNG\r\n\x1a\n", 8) == 0) &&
           CHECK(big_endian(file + 8) == 13) && CHECK(memcmp(file + 12, "IHDR", 4) == 0) &&
           CHECK_INT(big_endian(file + 16), width) && CHECK_INT(big_endian(file + 20), height) &&
           CHECK(memcmp(file + 24, "\x08\x02\x00\x00\x00", 5) == 0) && CHECK_INT(big_endian(file + 33), size - 57) &&
           CHECK(memcmp(file + 37, "IDAT", 4) == 0) && CHECK(memcmp(file + size - 12, end, 12) == 0) &&
           CHECK(inflate_fixed(file + 41, size - 57, raw, rows));
    for (size_t i = 0; good && i < rows; i++) {
        size_t y = i / row, x = i % row;
        if (x == 0)
            good = CHECK(raw[i] == 2);
        else
            pixels[y * (row - 1) + x - 1] = (unsigned char)(raw[i] + (y ? pixels[(y - 1) * (row - 1) + x - 1] : 0));
    }
    free(file);
    free(raw);
    if (good)
        return pixels;
    free(pixels);
    return NULL;
}

/* ---- scenes ---- */

/* A square of two triangles facing up at height z, from low to high in x and y. */
static sb_mesh make_square(sb_vec3 nodes[4], int elements[4], double low, double high, double z)
{
    sb_mesh square;
    memset(&square, 0, sizeof square);
    nodes[0] = sb_v3((sb_real)low, (sb_real)low, (sb_real)z);
    nodes[1] = sb_v3((sb_real)high, (sb_real)low, (sb_real)z);
    nodes[2] = sb_v3((sb_real)high, (sb_real)high, (sb_real)z);
    nodes[3] = sb_v3((sb_real)low, (sb_real)high, (sb_real)z);
    for (int i = 0; i < 4; i++)
        elements[i] = i;
    square.node_count = 4;
    square.nodes = nodes;
    square.element_type = SB_QUAD4;
    square.element_count = 1;
    square.elements = elements;
    return square;
}

static void add_square(picture *p, double low, double high, double z, double value)
{
    sb_vec3 nodes[4];
    int elements[4];
    sb_mesh square = make_square(nodes, elements, low, high, z);
    sb_real values[4];
    for (int i = 0; i < 4; i++)
        values[i] = (sb_real)value;
    picture_add_surface(p, &square, values, 0, 1);
}

/* Pixel that shows a point of space. */
static const float *pixel_of(const picture *p, double x, double y, double z)
{
    picture_vec at = picture_project(&p->camera, picture_v(x, y, z));
    return p->pixels + 3 * ((size_t)at.y * (size_t)p->width + (size_t)at.x);
}

/* 1 when a pixel has the hue that the map gives a value, whatever the light. */
static int has_hue(const float *pixel, double value)
{
    picture_colour c = picture_map(value);
    double most = fmax(fmax((double)pixel[0], (double)pixel[1]), (double)pixel[2]), least = fmax(c.r, fmax(c.g, c.b));
    return fabs((double)pixel[0] / most - c.r / least) < 0.1 && fabs((double)pixel[1] / most - c.g / least) < 0.1 &&
           fabs((double)pixel[2] / most - c.b / least) < 0.1;
}

/* ---- tests ---- */

static void check_round_trip(picture *p)
{
    unsigned char *pixels;
    CHECK_INT(picture_save_png(p, FILE_NAME), PICTURE_OK);
    pixels = read_png(FILE_NAME, p->width, p->height);
    int wrong = 0;
    for (size_t i = 0; pixels && i < 3 * (size_t)p->width * (size_t)p->height; i++)
        wrong += pixels[i] != picture_to_byte((double)p->pixels[i]);
    CHECK(pixels != NULL);
    CHECK_INT(wrong, 0);
    free(pixels);
    remove(FILE_NAME);
}

static void test_png_round_trip(void)
{
    static const int sizes[][2] = {{1, 1}, {2, 3}, {97, 61}, {400, 300}};
    unsigned long long seed = 11;
    for (int kind = 0; kind < 3; kind++) /* flat, noise, sparse noise: literals, long and short repeats */
        for (int s = 0; s < 4; s++) {
            picture p;
            picture_begin(&p, sizes[s][0], sizes[s][1]);
            for (size_t i = 0; i < 3 * (size_t)p.width * (size_t)p.height; i++) {
                double noise = check_random(&seed);
                p.pixels[i] = (float)(kind == 0 || (kind == 2 && noise < 0.98) ? 0.3 : check_random(&seed) * 1.2 - 0.1);
            }
            check_round_trip(&p);
            picture_end(&p);
        }
}

static void test_png_failures(void)
{
    picture p;
    picture_begin(&p, 8, 8);
    CHECK_INT(picture_save_png(&p, "no-such-folder/picture.png"), PICTURE_NO_FILE);
    p.out_of_memory = 1;
    CHECK_INT(picture_save_png(&p, FILE_NAME), PICTURE_NO_MEMORY);
    FILE *left = fopen(FILE_NAME, "rb");
    CHECK(left == NULL);
    if (left)
        fclose(left);
    picture_end(&p);
}

static void test_nearer_hides_farther(void)
{
    for (int order = 0; order < 2; order++) {
        picture p;
        picture_begin(&p, 160, 120);
        if (order == 0)
            add_square(&p, -1, 1, 0, 0.2);
        add_square(&p, -0.4, 0.4, 0.3, 0.9);
        if (order == 1)
            add_square(&p, -1, 1, 0, 0.2);
        picture_render(&p, 0, 80);
        CHECK(has_hue(pixel_of(&p, 0, 0, 0.3), 0.9));
        CHECK(has_hue(pixel_of(&p, -0.8, -0.8, 0), 0.2));
        picture_end(&p);
    }
}

static void test_shadow_falls_away_from_the_light(void)
{
    picture p;
    picture_begin(&p, 200, 150);
    add_square(&p, -1, 1, 0, 0.2);
    add_square(&p, -0.3, 0.3, 0.8, 0.9);
    picture_render(&p, 0, 60);
    /* where the ray from the light through the middle of the small square meets the large one */
    picture_vec to = p.light.toward;
    double x = -to.x * 0.8 / to.z, y = -to.y * 0.8 / to.z;
    CHECK(fabs(x) < 0.9 && fabs(y) < 0.9);
    double in_shadow = (double)pixel_of(&p, x, y, 0)[0], in_light = (double)pixel_of(&p, -0.9, -0.9, 0)[0];
    CHECK(in_shadow < 0.75 * in_light);
    picture_end(&p);
}

static void test_frame_and_lengths(void)
{
    picture p;
    picture_begin(&p, 300, 200);
    add_square(&p, -0.01, 0.01, 0, 0.5);
    picture_render(&p, 0, 90);
    picture_vec left = picture_project(&p.camera, picture_v(-0.01, 0, 0));
    picture_vec right = picture_project(&p.camera, picture_v(0.01, 0, 0));
    CHECK_NEAR(right.x - left.x, 0.02 * p.camera.scale, 1e-6);
    CHECK(left.x > 0.05 * 300 && right.x < 0.84 * 300);
    picture_end(&p);
}

static void test_capsule_is_round(void)
{
    picture p;
    picture_begin(&p, 60, 40);
    picture_add_capsule(&p, sb_v3(1, 2, 3), sb_v3(1, 2, 5), 0.5, picture_rgb(0.5, 0.5, 0.5));
    double worst = 0;
    for (int i = 0; i < 3 * p.count; i++) {
        picture_vec x = p.triangles[i / 3].corner[i % 3];
        double along = picture_clamp(x.z, 3, 5);
        picture_vec out = picture_v(x.x - 1, x.y - 2, x.z - along);
        worst = fmax(worst, fabs(sqrt(picture_dot(out, out)) - 0.5));
        CHECK_NEAR(picture_dot(out, p.triangles[i / 3].normal[i % 3]), 0.5, 1e-6);
    }
    CHECK(p.count > 100 && worst < 1e-6);
    picture_end(&p);
}

static void test_colour_map(void)
{
    double before = 2;
    for (int i = 0; i <= 50; i++) { /* darker all the way: order can be read in grey */
        picture_colour c = picture_map(i / 50.0);
        double luminance = 0.2126 * c.r + 0.7152 * c.g + 0.0722 * c.b;
        CHECK(luminance < before);
        before = luminance;
    }
    CHECK_NEAR(picture_map(-3).r, picture_map(0).r, 0);
    CHECK_NEAR(picture_map(7).r, picture_map(1).r, 0);
    check_bad_numbers();
    CHECK_NEAR(picture_map((double)NAN).g, picture_map(0).g, 0);
    for (int byte = 0; byte < 256; byte++)
        CHECK_INT(picture_to_byte(picture_to_linear(byte)), byte);
}

/* Box of the pixels that text made darker than 0.5. */
static int dark_box(const picture *p, int box[4])
{
    int count = 0;
    box[0] = p->width, box[1] = p->height, box[2] = box[3] = -1;
    for (int y = 0; y < p->height; y++)
        for (int x = 0; x < p->width; x++)
            if (p->pixels[3 * (y * p->width + x)] < 0.5f) {
                count++;
                box[0] = x < box[0] ? x : box[0], box[2] = x > box[2] ? x : box[2];
                box[1] = y < box[1] ? y : box[1], box[3] = y > box[3] ? y : box[3];
            }
    return count;
}

static void test_text(void)
{
    char text[2] = "A";
    int box[4];
    for (int c = '!'; c <= '~'; c++) {
        picture p;
        picture_begin(&p, 60, 60);
        picture_box(&p, 0, 0, 60, 60, picture_rgb(1, 1, 1));
        text[0] = (char)c;
        picture_text(&p, 20, 40, 18, PICTURE_LEFT, picture_rgb(0, 0, 0), text);
        CHECK(dark_box(&p, box) >= 4);
        CHECK(box[0] >= 18 && box[2] <= 20 + 16 && box[1] >= 20 && box[3] <= 48);
        for (int other = '!'; other < c; other++) /* no two characters look the same */
            CHECK(memcmp(picture_glyph(c), picture_glyph(other), 5 * sizeof(unsigned short)) != 0);
        picture_end(&p);
    }
    CHECK(picture_text_width("WWW", 18) > picture_text_width("iii", 18));
}

static void test_text_outside_is_clipped(void)
{
    picture p;
    picture_begin(&p, 20, 10);
    picture_text(&p, -15, 5, 30, PICTURE_LEFT, picture_ink(), "edge to edge");
    picture_text(&p, 10, 500, 30, PICTURE_CENTRE, picture_ink(), "below \xc3\xa9");
    picture_box(&p, -5, -5, 500, 500, picture_rgb(1, 1, 1));
    CHECK_NEAR(p.pixels[0], 1, 0);
    CHECK_NEAR(p.pixels[3 * 20 * 10 - 1], 1, 0);
    picture_end(&p);
}

static void test_empty_scene(void)
{
    picture p;
    picture_begin(&p, 40, 30);
    picture_render(&p, 20, 30);
    picture_length_bar(&p);
    picture_colour_bar(&p, "nothing", "Pa", 0, 0, 0);
    for (int i = 0; i < 3 * 40 * 30; i++)
        CHECK(p.pixels[i] >= 0 && p.pixels[i] <= 1);
    picture_end(&p);
}

static picture_plane random_plane(unsigned long long *seed)
{
    picture_plane plane;
    plane.normal = picture_unit(picture_v(check_random_in(seed, -1, 1), check_random_in(seed, -1, 1), 1.2));
    plane.offset = picture_dot(plane.normal, picture_v(0.5, 0.5, 0.5)) + check_random_in(seed, -0.3, 0.3);
    return plane;
}

/* Volume that the triangles bound and area of those from `first` on; all lie on the plane's side and have the values of
 * their places. */
static void check_cut(const picture *p, int first, const picture_plane *plane, double *volume, double *section)
{
    *volume = *section = 0;
    for (int i = 0; i < p->count; i++) {
        const picture_triangle *t = &p->triangles[i];
        picture_vec n = picture_face_normal(t->corner);
        double turned = i < first || picture_dot(n, t->normal[0]) > 0 ? 1 : -1;
        *volume += turned * picture_dot(n, t->corner[0]) / 6;
        *section += i < first ? 0 : sqrt(picture_dot(n, n)) / 2;
        for (int k = 0; k < 3; k++) {
            CHECK(picture_above(plane, t->corner[k]) > -1e-6);
            CHECK_NEAR(t->value[k], t->corner[k].x, 1e-6);
        }
    }
}

/* A block that is cut open from both sides: the volumes make that of the block, the sections are the same. */
static void test_cut_open(void)
{
    sb_mesh block;
    sb_boundary boundary;
    sb_real values[60];
    unsigned long long seed = 77;
    if (!CHECK_OK(sb_mesh_beam(SB_TET4, 3, 2, 4, sb_v3(1, 1, 1), NULL, &block, NULL)))
        return;
    if (!CHECK_INT(block.node_count, 60) || !CHECK_OK(sb_mesh_boundary(&block, 1, NULL, &boundary, NULL)))
        return;
    for (int round = 0; round < 20; round++) {
        picture_plane plane = random_plane(&seed);
        double volume[2], section[2];
        for (int side = 0; side < 2; side++) {
            picture p;
            int first;
            picture_begin(&p, 8, 8);
            for (int i = 0; i < boundary.surface.node_count; i++)
                values[i] = boundary.surface.nodes[i].x;
            picture_add_surface(&p, &boundary.surface, values, 0, 1);
            picture_clip(&p, 0, plane);
            first = p.count;
            for (int i = 0; i < block.node_count; i++)
                values[i] = block.nodes[i].x;
            picture_add_section(&p, &block, values, 0, 1, plane);
            check_cut(&p, first, &plane, &volume[side], &section[side]);
            picture_end(&p);
            plane.normal = picture_madd(picture_v(0, 0, 0), -1, plane.normal);
            plane.offset = -plane.offset;
        }
        CHECK_NEAR(volume[0] + volume[1], 1, 1e-5);
        CHECK(volume[0] > 0.05 && volume[1] > 0.05);
        CHECK_NEAR(section[0], section[1], 1e-5);
    }
    sb_boundary_free(&boundary);
    sb_mesh_free(&block);
}

/* Skins of all elements: a cube's triangles cover it, each with the outer normal. */
static void test_skins(void)
{
    static const sb_element_type types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    for (int t = 0; t < 5; t++) {
        sb_mesh cube;
        sb_boundary boundary;
        sb_real *values;
        double area = 0, volume = 0;
        picture p;
        if (!CHECK_OK(sb_mesh_beam(types[t], 3, 3, 3, sb_v3(1, 1, 1), NULL, &cube, NULL)) ||
            !CHECK_OK(sb_mesh_boundary(&cube, 1, NULL, &boundary, NULL)))
            return;
        values = (sb_real *)calloc((size_t)boundary.surface.node_count, sizeof *values);
        picture_begin(&p, 8, 8);
        picture_add_surface(&p, &boundary.surface, values, 0, 1);
        CHECK(!p.out_of_memory);
        for (int i = 0; i < p.count; i++) {
            picture_vec twice = picture_face_normal(p.triangles[i].corner);
            area += sqrt(picture_dot(twice, twice)) / 2;
            volume += picture_dot(twice, p.triangles[i].corner[0]) / 6;
        }
        CHECK_NEAR(area, 6, SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
        CHECK_NEAR(volume, 1, SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
        picture_end(&p);
        free(values);
        sb_boundary_free(&boundary);
        sb_mesh_free(&cube);
    }
}

CHECK_SUITE(picture, {"png round trip", test_png_round_trip}, {"skins of all elements", test_skins},
            {"png failures", test_png_failures}, {"nearer hides farther", test_nearer_hides_farther},
            {"shadow falls away from the light", test_shadow_falls_away_from_the_light},
            {"frame and lengths", test_frame_and_lengths}, {"capsule is round", test_capsule_is_round},
            {"colour map", test_colour_map}, {"text", test_text},
            {"text outside is clipped", test_text_outside_is_clipped}, {"empty scene", test_empty_scene},
            {"cut open by a plane", test_cut_open});
