/* Tests of cloud: files and their errors, normals, thinning, outlier rules, memory. */
#include "scene.h"

#include "register.h"

static const char *cloud_path = "build/test_cloud.ply";

static sb_result load_text(reg_cloud *cloud, const char *text, reg_cloud_format format, sb_error *error)
{
    return reg_cloud_load_memory(cloud, text, strlen(text), format, "memory", 1, NULL, error);
}

/* An ellipsoid: evenly spread points, and their true normals. */
static void ellipsoid(sb_vec3 *points, sb_vec3 *normals, int count)
{
    for (int i = 0; i < count; i++) {
        double z = 1 - (2 * i + 1.0) / count, a = 2.399963229728653 * i, r = sqrt(1 - z * z);
        sb_vec3 p = sb_v3(REAL(0.2 * r * cos(a)), REAL(0.12 * r * sin(a)), REAL(0.08 * z));
        sb_vec3 n = sb_v3(p.x / REAL(0.04), p.y / REAL(0.0144), p.z / REAL(0.0064));
        points[i] = p;
        normals[i] = sb_v3_scale(1 / sb_v3_norm(n), n);
    }
}

static void test_ascii_ply(void)
{
    static const char text[] = "ply\nformat ascii 1.0\ncomment made by hand\nelement camera 1\nproperty float w\n"
                               "element vertex 3\nproperty uchar red\nproperty float nx\nproperty double x\n"
                               "property float y\nproperty list uchar int tags\nproperty float z\nproperty float ny\n"
                               "property float nz\nelement face 1\nproperty list uchar int vertex_indices\n"
                               "end_header\n9\n255 0 1 2 2 7 8 3 0 2\n0 1 4 5 0 6 0 0\n0 0 7 8 1 1 9 0 0\n3 0 1 2\n";
    reg_cloud cloud;
    if (!CHECK_OK(load_text(&cloud, text, REG_CLOUD_AUTO, NULL)))
        return;
    CHECK_INT(cloud.count, 3);
    for (int i = 0; i < 3; i++) {
        CHECK_NEAR(cloud.points[i].x, 3 * i + 1, 0);
        CHECK_NEAR(cloud.points[i].y, 3 * i + 2, 0);
        CHECK_NEAR(cloud.points[i].z, 3 * i + 3, 0);
    }
    if (CHECK(cloud.normals != NULL)) {
        CHECK_NEAR(cloud.normals[0].z, 1, 0); /* made unit length */
        CHECK_NEAR(cloud.normals[1].x, 1, 0);
        CHECK_NEAR(sb_v3_norm(cloud.normals[2]), 0, 0);
    }
    reg_cloud_free(&cloud);
    CHECK(cloud.points == NULL && cloud.count == 0);
}

/* One vertex as short, float and double, in either byte order. */
static void test_binary_ply(void)
{
    static const unsigned char little[14] = {0xFE, 0xFF, 0, 0, 0xC0, 0x3F, 0, 0, 0, 0, 0, 0, 0x12, 0x40};
    static const unsigned char big[14] = {0xFF, 0xFE, 0x3F, 0xC0, 0, 0, 0x40, 0x12, 0, 0, 0, 0, 0, 0};
    for (int order = 0; order < 2; order++) {
        char file[256];
        reg_cloud cloud;
        int head = snprintf(file, sizeof file,
                            "ply\nformat binary_%s_endian 1.0\nelement vertex 1\nproperty short x\nproperty float y\n"
                            "property double z\nend_header\n",
                            order ? "big" : "little");
        memcpy(file + head, order ? big : little, 14);
        if (!CHECK_OK(
                reg_cloud_load_memory(&cloud, file, (size_t)head + 14, REG_CLOUD_PLY, NULL, REAL(0.5), NULL, NULL)))
            continue;
        CHECK_NEAR(cloud.points[0].x, -1, 0);
        CHECK_NEAR(cloud.points[0].y, 0.75, 0);
        CHECK_NEAR(cloud.points[0].z, 2.25, 0);
        CHECK(cloud.normals == NULL);
        reg_cloud_free(&cloud);
        CHECK_RESULT(reg_cloud_load_memory(&cloud, file, (size_t)head + 13, REG_CLOUD_PLY, NULL, 1, NULL, NULL),
                     SB_ERROR_FORMAT);
    }
}

static void test_round_trip(void)
{
    enum { N = 50 };
    sb_vec3 points[N], normals[N];
    ellipsoid(points, normals, N);
    for (int ascii = 0; ascii < 2; ascii++)
        for (int with = 0; with < 2; with++) {
            reg_cloud cloud, back;
            if (!CHECK_OK(reg_cloud_from_points(&cloud, points, with ? normals : NULL, N, NULL, NULL)))
                return;
            CHECK_OK(reg_cloud_save_ply(cloud_path, &cloud, ascii, NULL));
            if (CHECK_OK(reg_cloud_load(&back, cloud_path, 1, NULL, NULL))) {
                CHECK_INT(back.count, N);
                CHECK(memcmp(back.points, points, sizeof points) == 0);
                CHECK((back.normals != NULL) == with);
                if (with)
                    CHECK(scene_distance(back.normals, normals, N) <= 4 * (double)SB_EPSILON);
                reg_cloud_free(&back);
            }
            reg_cloud_free(&cloud);
        }
    remove(cloud_path);
}

static void test_text(void)
{
    static const struct {
        const char *text;
        int points, normals;
    } good[] = {{"1 2 3\n4 5 6\n", 2, 0},
                {"# heading\n\n 1,2,3\r\n4;5;6 // no more\n", 2, 0},
                {"x,y,z,nx,ny,nz\n1,2,3,0,0,1\n4,5,6,0,0,-1", 2, 1},
                {"2\n1 2 3 200 100 50\n4 5 6 0 0 1\n", 2, 0},
                {"1\t2\t3 red\n4 5 6#7\n", 2, 0},
                {"1 2 3 0.6 0.8 0 77\n4 5 6 0 0 0 78", 2, 1}};
    static const struct {
        const char *text;
        sb_result result;
        int line;
    } bad[] = {{"", SB_ERROR_FORMAT, -1},
               {"# nothing\n", SB_ERROR_FORMAT, -1},
               {"1 2 3\n4 5\n", SB_ERROR_FORMAT, 2},
               {"1 2 3\n\nx 5 6\n", SB_ERROR_FORMAT, 3},
               {"1 2 3\n1 nan 3\n", SB_ERROR_NOT_FINITE, 2},
               {"1 2 3\n1 2 1e999\n", SB_ERROR_NOT_FINITE, 2},
               {"1 2 3 0 0 1\n1 2 3\n", SB_ERROR_FORMAT, 2},
               {"a b c\nd e f\n", SB_ERROR_FORMAT, 2},
               {"1 2\n", SB_ERROR_FORMAT, 1}};
    reg_cloud cloud;
    sb_error error;
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
        if (!CHECK_OK(load_text(&cloud, good[i].text, i % 2 ? REG_CLOUD_XYZ : REG_CLOUD_AUTO, &error)))
            continue;
        CHECK_INT(cloud.count, good[i].points);
        CHECK_INT(cloud.normals != NULL, good[i].normals);
        CHECK_NEAR(cloud.points[1].y, 5, 0);
        CHECK_NEAR(cloud.points[0].z, 3, 0);
        reg_cloud_free(&cloud);
    }
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        cloud.count = -5;
        CHECK_RESULT(load_text(&cloud, bad[i].text, REG_CLOUD_XYZ, &error), bad[i].result);
        CHECK(cloud.count == -5 && strcmp(error.file, "memory") == 0 && error.message[0]);
        if (bad[i].line > 0)
            CHECK_INT(error.line, bad[i].line);
    }
}

/* Texts of other countries and programs: read right, or refused with the line; never something else. */
static void test_text_forms(void)
{
    static const char *const good[] = {"0,5;0,25;1,5\n-1,5;+2,25;3\n",
                                       "0.5;0.25;1.5\n-1.5;2.25;3;\n",
                                       "x;y;z\n,5;0,25;15e-1;\n-1,5; 2,25 ;3,000\n",
                                       "2\n0.5 .25 1.5\n-1.5 2.25 3\n",
                                       "\xEF\xBB\xBF"
                                       "0.5 0.25 1.5\n-1.5 2.25 3",
                                       "\xEF\xBB\xBF"
                                       "2\r\n0.5,0.25,1.5,\r\n-1.5, 2.25 , 3\r\n",
                                       "0.5 0.25 1.5 a,b;c\n-1.5 2.25 3 12:30\n",
                                       "0.5,0.25,1.5,,,\n-1.5,2.25,3,,,"};
    static const struct {
        const char *text, *message;
        int line;
    } bad[] = {{"0,5 0,25 1,5\n", "commas", 1},
               {"1 2 3\n0,5\t1\t2\n", "commas", 2},
               {"1,2,3 0,0,1\n", "commas", 1},
               {"0,05,0,25,1,5\n", "commas", 1},
               {"1,2,-05\n", "commas", 1},
               {"1,234;2,000;3,5\n999.5;1;2\n", "decimal points and decimal commas", 2},
               {"1.234,5;1;2\n1;2;3\n", "'1.234,5' is not a number", 1},
               {"1,2,3;255,0,0\n", "'1,2,3' is not a number", 1},
               {"1;;2;3\n", "between two separators", 1},
               {"1,2,,3\n", "between two separators", 1},
               {";1;2;3\n", "between two separators", 1},
               {"# c\n3\n1 2 3\n4 5 6\n", "says 3 points, there are 2", 2},
               {"1\n1 2 3\n4 5 6\n", "says 1 points, there are 2", 1},
               {"0\n1 2 3\n", "says 0 points, there are 1", 1},
               {"-1\n1 2 3\n", "needs three numbers", 1},
               {"0.5\n1 2 3\n", "needs three numbers", 1},
               {"99999999999\n1 2 3\n", "needs three numbers", 1},
               {"1d0 2 3\n4 5 6\n", "'1d0' is not a number", 1},
               {".5d0 2 3\n4 5 6\n", "'.5d0' is not a number", 1},
               {"x 2 3\n4 5 6\n", "'x' is not a number", 1},
               {"nan nan nan\n4 5 6\n", "not finite", 1},
               {"1 2 3\nx y z\n", "'x' is not a number", 2}};
    reg_cloud cloud;
    sb_error error;
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
        if (!CHECK_OK(load_text(&cloud, good[i], REG_CLOUD_XYZ, &error))) {
            printf("    %s: %s\n", good[i], error.message);
            continue;
        }
        CHECK_INT(cloud.count, 2);
        CHECK(cloud.points[0].x == REAL(0.5) && cloud.points[0].y == REAL(0.25) && cloud.points[0].z == REAL(1.5));
        CHECK(cloud.points[1].x == REAL(-1.5) && cloud.points[1].y == REAL(2.25) && cloud.points[1].z == 3);
        CHECK(cloud.normals == NULL);
        reg_cloud_free(&cloud);
    }
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        sb_result result = load_text(&cloud, bad[i].text, REG_CLOUD_XYZ, &error);
        if (!CHECK(result == SB_ERROR_FORMAT || result == SB_ERROR_NOT_FINITE) ||
            !CHECK(strstr(error.message, bad[i].message) != NULL) || !CHECK_INT(error.line, bad[i].line))
            printf("    %s: %s\n", bad[i].text, result ? error.message : "");
    }
}

/* A byte order mark before, a NUL in, and behind each format's text. */
static void test_marks_and_nuls(void)
{
    static const char ply[] = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                              "property float z\nend_header\n1 2 3\n4 5 6\n";
    static const char *const texts[3] = {"1 2 3\n4 5 6\n", ply, "v 1 2 3\nv 4 5 6\n"};
    static const reg_cloud_format formats[3] = {REG_CLOUD_XYZ, REG_CLOUD_PLY, REG_CLOUD_MESH};
    reg_cloud cloud;
    sb_error error;
    for (int i = 0; i < 3; i++) {
        char text[256] = "\xEF\xBB\xBF";
        size_t size = 3 + strlen(texts[i]), last = size - 3;
        int lines = 0;
        strcat(text, texts[i]);
        for (size_t k = 0; k < last; k++)
            lines += text[k] == '\n';
        for (size_t nuls = 0; nuls < 2; nuls++)
            if (CHECK_OK(reg_cloud_load_memory(&cloud, text, size + nuls, formats[i], "m.obj", 1, NULL, &error))) {
                CHECK(cloud.count == 2 && cloud.points[1].y == 5);
                reg_cloud_free(&cloud);
            }
        CHECK_RESULT(reg_cloud_load_memory(&cloud, text, size + 2, formats[i], "m.obj", 1, NULL, &error),
                     SB_ERROR_FORMAT);
        text[last] = 0;
        CHECK_RESULT(reg_cloud_load_memory(&cloud, text, size, formats[i], "m.obj", 1, NULL, &error), SB_ERROR_FORMAT);
        CHECK(strstr(error.message, "NUL") != NULL);
        CHECK_INT(error.line, lines + 1);
    }
    CHECK_RESULT(reg_cloud_load_memory(&cloud,
                                       "\xFF\xFE"
                                       "1\0 \0",
                                       6, REG_CLOUD_AUTO, "m.xyz", 1, NULL, &error),
                 SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "UTF-16") != NULL);
    CHECK_RESULT(reg_cloud_load_memory(&cloud, "\x1F\x8B\x08 1 2 3\n", 10, REG_CLOUD_XYZ, "m.xyz", 1, NULL, &error),
                 SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "gzip") != NULL);
}

static void test_formats(void)
{
    int wrong = 9;
    static const char obj[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\nf 1 2 3\n";
    static const char endless[] =
        "ply\nformat ascii 1.0\nelement vertex 2000000000\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n1 2 3\n";
    reg_cloud cloud;
    sb_error error;
    if (CHECK_OK(load_text(&cloud, obj, REG_CLOUD_AUTO, &error))) {
        CHECK_INT(cloud.count, 4);
        reg_cloud_free(&cloud);
    }
    CHECK_RESULT(load_text(&cloud, obj, REG_CLOUD_PLY, &error), SB_ERROR_FORMAT);
    CHECK_RESULT(load_text(&cloud, endless, REG_CLOUD_AUTO, &error), SB_ERROR_FORMAT);
    CHECK_RESULT(load_text(&cloud, "1 2 3", REG_CLOUD_MESH, &error), SB_ERROR_FORMAT);
    CHECK_RESULT(load_text(&cloud, "1 2 3", (reg_cloud_format)wrong, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_load(&cloud, "build/no such file.ply", 1, NULL, &error), SB_ERROR_FILE);
    CHECK(strstr(error.file, "no such file") != NULL);
    CHECK_RESULT(reg_cloud_load(&cloud, NULL, 1, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_load(NULL, "x", 1, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_load(&cloud, "x", 0, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_load_memory(&cloud, NULL, 3, REG_CLOUD_AUTO, NULL, 1, NULL, &error), SB_ERROR_ARGUMENT);
    memset(&cloud, 0, sizeof cloud);
    CHECK_RESULT(reg_cloud_save_ply(cloud_path, &cloud, 0, &error), SB_ERROR_ARGUMENT);
    if (CHECK_OK(load_text(&cloud, "1 2 3", REG_CLOUD_AUTO, &error))) {
        CHECK_RESULT(reg_cloud_save_ply("build/no/such/folder.ply", &cloud, 0, &error), SB_ERROR_FILE);
        CHECK(strstr(error.file, "folder") != NULL);
        reg_cloud_free(&cloud);
    }
}

/* A cube: each corner's normal is that of its faces. */
static void test_from_mesh(void)
{
    sb_mesh box = scene_box(SB_HEX8, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_boundary boundary;
    reg_cloud cloud;
    if (CHECK_OK(reg_cloud_from_mesh(&cloud, &box, NULL, NULL))) {
        CHECK(cloud.count == box.node_count && cloud.normals == NULL);
        reg_cloud_free(&cloud);
    }
    if (CHECK_OK(sb_mesh_boundary(&box, 1, NULL, &boundary, NULL)) &&
        CHECK_OK(reg_cloud_from_mesh(&cloud, &boundary.surface, NULL, NULL))) {
        for (int i = 0; i < cloud.count; i++) {
            sb_vec3 out = sb_v3_sub(cloud.points[i], sb_v3(REAL(0.5), REAL(0.5), REAL(0.5)));
            CHECK_NEAR(sb_v3_norm(cloud.normals[i]), 1, 8 * (double)SB_EPSILON);
            CHECK(sb_v3_dot(cloud.normals[i], out) > REAL(0.3));
        }
        reg_cloud_free(&cloud);
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&box);
}

static void test_normals(void)
{
    enum { N = 3000 };
    static sb_vec3 points[N], truth[N], serial[N];
    reg_cloud cloud;
    sb_vec3 view = sb_v3(0, 0, 2);
    int workers = 3;
    sb_jobs jobs = scene_jobs(&workers);
    ellipsoid(points, truth, N);
    if (!CHECK_OK(reg_cloud_from_points(&cloud, points, NULL, N, NULL, NULL)))
        return;
    if (CHECK_OK(reg_cloud_estimate_normals(&cloud, 10, NULL, NULL, NULL))) {
        double worst = 1;
        for (int i = 0; i < N; i++)
            worst = fmin(worst, (double)sb_v3_dot(cloud.normals[i], truth[i])); /* outward everywhere */
        CHECK(worst > cos(0.12));
        memcpy(serial, cloud.normals, sizeof serial);
        CHECK_OK(reg_cloud_estimate_normals(&cloud, 10, NULL, &jobs, NULL));
        CHECK(memcmp(serial, cloud.normals, sizeof serial) == 0);
    }
    if (CHECK_OK(reg_cloud_estimate_normals(&cloud, 10, &view, NULL, NULL)))
        for (int i = 0; i < N; i++)
            CHECK(sb_v3_dot(cloud.normals[i], sb_v3_sub(view, points[i])) >= 0);
    CHECK_RESULT(reg_cloud_estimate_normals(&cloud, 2, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_estimate_normals(NULL, 8, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    view.x = SB_REAL_MAX * 2;
    CHECK_RESULT(reg_cloud_estimate_normals(&cloud, 8, &view, NULL, NULL), SB_ERROR_NOT_FINITE);
    reg_cloud_free(&cloud);
}

/* Two sheets apart: each looks up. One point, a line, a heap of equal points: no plane, no normal. */
static void test_normals_of_little(void)
{
    sb_vec3 points[72];
    reg_cloud cloud;
    for (int i = 0; i < 72; i++)
        points[i] = sb_v3(REAL(i % 6), REAL(i / 6 % 6), REAL(i < 36 ? 0 : 50));
    if (!CHECK_OK(reg_cloud_from_points(&cloud, points, NULL, 72, NULL, NULL)))
        return;
    CHECK_OK(reg_cloud_estimate_normals(&cloud, 8, NULL, NULL, NULL));
    for (int i = 0; i < 72; i++)
        CHECK_NEAR(cloud.normals[i].z, 1, 16 * (double)SB_EPSILON);
    reg_cloud_free(&cloud);
    for (int kind = 0; kind < 3; kind++) {
        int count = kind == 0 ? 1 : 20;
        for (int i = 0; i < count; i++)
            points[i] = kind == 1 ? sb_v3(REAL(i), 0, 0) : sb_v3(1, 2, 3);
        if (!CHECK_OK(reg_cloud_from_points(&cloud, points, NULL, count, NULL, NULL)))
            return;
        CHECK_OK(reg_cloud_estimate_normals(&cloud, 8, NULL, NULL, NULL));
        for (int i = 0; i < count; i++)
            CHECK_NEAR(sb_v3_norm(cloud.normals[i]), 0, 0);
        reg_cloud_free(&cloud);
    }
}

static void test_thin(void)
{
    sb_vec3 points[6] = {{REAL(0.1), 0, 0},  {REAL(1.5), 0, 0}, {REAL(0.3), REAL(0.2), 0},
                         {REAL(-0.5), 0, 0}, {REAL(1.5), 0, 0}, {REAL(1e5), REAL(-1e5), REAL(1e5)}};
    sb_vec3 normals[6] = {{1, 0, 0}, {0, 0, 1}, {0, 1, 0}, {0, 0, 1}, {0, 0, -1}, {1, 0, 0}};
    reg_cloud cloud, thin;
    if (!CHECK_OK(reg_cloud_from_points(&cloud, points, normals, 6, NULL, NULL)))
        return;
    if (CHECK_OK(reg_cloud_thin(&cloud, 1, &thin, NULL))) {
        CHECK_INT(thin.count, 4); /* 0 and 2, 1 and 4, 3, 5 */
        CHECK_NEAR(thin.points[0].x, 0.2, 4 * (double)SB_EPSILON);
        CHECK_NEAR(thin.points[0].y, 0.1, 4 * (double)SB_EPSILON);
        CHECK_NEAR(thin.normals[0].x, sqrt(0.5), 4 * (double)SB_EPSILON);
        CHECK_NEAR(thin.points[1].x, 1.5, 0);
        CHECK_NEAR(sb_v3_norm(thin.normals[1]), 0, 0); /* they face each other */
        CHECK_NEAR(thin.points[2].x, -0.5, 0);
        CHECK_NEAR(thin.points[3].y, -1e5, 0);
        reg_cloud_free(&thin);
    }
    CHECK_RESULT(reg_cloud_thin(&cloud, 0, &thin, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_thin(&cloud, -1, &thin, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_thin(NULL, 1, &thin, NULL), SB_ERROR_ARGUMENT);
    CHECK_OK(reg_cloud_thin(&cloud, REAL(1e9), &cloud, NULL)); /* in place; the signs part them */
    CHECK_INT(cloud.count, 3);
    reg_cloud_free(&cloud);
}

static void test_spread(void)
{
    sb_vec3 line[11];
    sb_real scratch[11];
    int chosen[11];
    for (int i = 0; i < 11; i++)
        line[i] = sb_v3(REAL(i), 0, 0);
    CHECK_INT(reg_cloud_spread(line, 11, 3, chosen, scratch), 3);
    CHECK_INT(chosen[0] + chosen[1], 10); /* the ends, then the middle */
    CHECK_INT(chosen[0] * chosen[1], 0);
    CHECK_INT(chosen[2], 5);
    CHECK_INT(reg_cloud_spread(line, 11, 100, chosen, scratch), 11);
    for (int i = 0; i < 11; i++)
        line[i] = sb_v3(REAL(i % 2), 0, 0);
    CHECK_INT(reg_cloud_spread(line, 11, 5, chosen, scratch), 2);
    CHECK_INT(reg_cloud_spread(line, 0, 5, chosen, scratch), 0);
}

static void test_rules(void)
{
    int wrong = 7;
    check_bad_numbers();
    sb_real d[11] = {5, 5, 5, 5, 5, 5, 5, 5, 5, 5, 5}, scratch[11], infinite = SB_REAL_MAX * 2, limit;
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_DEVIATION, 2, scratch), 5, 0); /* equal ones all stay */
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_MEDIAN, 3, scratch), 5, 0);
    for (int i = 0; i < 11; i++)
        d[i] = REAL((i * 7) % 11); /* 0 .. 10 in another order */
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_DEVIATION, 2, scratch), 5 + 2 * sqrt(10), 1e-5);
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_MEDIAN, 3, scratch), 5 + 3 * 1.4826 * 3, 1e-5);
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_TRIM, REAL(0.5), scratch), 5, 0);
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_TRIM, 1, scratch), 10, 0);
    CHECK_NEAR(d[1], 7, 0); /* only read */
    limit = reg_outlier_limit(d, 11, REG_OUTLIERS_NONE, 0, scratch);
    CHECK(limit >= SB_REAL_MAX);
    d[3] = infinite;            /* was 10 */
    d[4] = infinite - infinite; /* was 6 */
    CHECK_NEAR(reg_outlier_limit(d, 11, REG_OUTLIERS_TRIM, 1, scratch), 9, 0);
    CHECK_NEAR(reg_outlier_limit(d + 3, 2, REG_OUTLIERS_MEDIAN, 3, scratch), -1, 0);
    CHECK_NEAR(reg_outlier_limit(d, 0, REG_OUTLIERS_MEDIAN, 3, scratch), -1, 0);
    CHECK_NEAR(reg_outlier_limit(d, 3, REG_OUTLIERS_TRIM, 0, scratch), -1, 0);
    CHECK_NEAR(reg_outlier_limit(d, 3, REG_OUTLIERS_TRIM, 2, scratch), -1, 0);
    CHECK_NEAR(reg_outlier_limit(d, 3, REG_OUTLIERS_MEDIAN, -1, scratch), -1, 0);
    CHECK_NEAR(reg_outlier_limit(d, 3, (reg_outliers)wrong, 1, scratch), -1, 0);
}

static void test_remove(void)
{
    enum { N = 1000 };
    static sb_vec3 points[N], normals[N];
    reg_cloud cloud;
    int removed = -1;
    ellipsoid(points, normals, N);
    points[10] = sb_v3(1, 1, 1);
    points[700] = sb_v3(0, 0, REAL(0.3));
    if (!CHECK_OK(reg_cloud_from_points(&cloud, points, normals, N, NULL, NULL)))
        return;
    CHECK_RESULT(reg_cloud_remove_outliers(&cloud, 0, REG_OUTLIERS_MEDIAN, 3, &removed, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_remove_outliers(&cloud, 8, REG_OUTLIERS_TRIM, 2, &removed, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(removed, -1);
    CHECK_OK(reg_cloud_remove_outliers(&cloud, 8, REG_OUTLIERS_DEVIATION, 2, &removed, NULL));
    CHECK_INT(removed, 2);
    CHECK_INT(cloud.count, N - 2);
    CHECK(memcmp(cloud.points + 10, points + 11, 600 * sizeof points[0]) == 0);
    CHECK(scene_distance(cloud.normals + 10, normals + 11, 600) < 4 * (double)SB_EPSILON);
    reg_cloud_free(&cloud);
    if (CHECK_OK(reg_cloud_from_points(&cloud, points, NULL, 1, NULL, NULL))) {
        CHECK_OK(reg_cloud_remove_outliers(&cloud, 8, REG_OUTLIERS_DEVIATION, 2, &removed, NULL));
        CHECK(removed == 0 && cloud.count == 1);
        reg_cloud_free(&cloud);
    }
}

/* Everything in a row, with the allocation that fails moving along. */
/* Of a normal distribution, nearly: the sum of twelve. */
static double noise(uint32_t *state)
{
    double sum = -6;
    for (int i = 0; i < 12; i++) {
        *state = *state * 1664525u + 1013904223u;
        sum += (*state >> 8) / 16777216.0;
    }
    return sum;
}

/* Root mean square of how far points are from the ellipsoid, to first order, over its size. */
static double off_ellipsoid(const sb_vec3 *points, int count, double size)
{
    double sum = 0;
    for (int i = 0; i < count; i++) {
        double x = (double)points[i].x / size, y = (double)points[i].y / size, z = (double)points[i].z / size;
        double f = x * x / 0.04 + y * y / 0.0144 + z * z / 0.0064 - 1;
        double slope = 2 * sqrt(x * x / 0.0016 + y * y / 0.00020736 + z * z / 0.00004096);
        sum += f * f / (slope * slope);
    }
    return sqrt(sum / count);
}

/* Noise is measured and mostly taken away, outliers are found, at any scale; a clean cloud stays as it is. */
static void test_smooth(void)
{
    enum { N = 3000, WRONG = 200 };
    static sb_vec3 points[N + WRONG], normals[N + WRONG];
    for (int kind = 0; kind < 8; kind++) {
        const double sizes[4] = {1, 1e-3, 1e3, 1};
        double size = sizes[kind % 4], sd = kind == 7 ? 0 : 0.001;
        int wrong = kind < 4 ? 0 : WRONG, kept;
        uint32_t state = 12345;
        reg_smooth_info info;
        reg_cloud cloud;
        ellipsoid(points, normals, N);
        for (int i = 0; i < N; i++) {
            double n = sd * noise(&state);
            points[i] = sb_v3_scale(REAL(size), sb_v3_madd(points[i], REAL(n), normals[i]));
        }
        for (int i = N; i < N + wrong; i++) {
            points[i] = sb_v3(REAL(0.1 * size * noise(&state)), REAL(0.07 * size * noise(&state)),
                              REAL(0.05 * size * noise(&state)));
            normals[i] = sb_v3(1, 0, 0);
        }
        if (!CHECK_OK(reg_cloud_from_points(&cloud, points, kind % 4 == 3 ? NULL : normals, N + wrong, NULL, NULL)))
            return;
        CHECK_OK(reg_cloud_smooth(&cloud, NULL, &info, NULL));
        kept = cloud.count;
        CHECK_INT(info.outliers, N + wrong - kept);
        CHECK(wrong ? info.outliers > WRONG / 2 && info.outliers < WRONG : info.outliers < 4);
        if (kind == 7) {
            CHECK((double)info.noise < 3e-4 && info.left == info.noise && memcmp(cloud.points, points, 999) == 0);
        } else {
            double left = off_ellipsoid(cloud.points, kept < N ? kept : N - 10, size);
            CHECK_NEAR(info.noise, sd * size, 0.1 * sd * size);
            CHECK((double)info.left < 0.4 * sd * size && left < (wrong ? 0.8 : 0.45) * sd);
        }
        if (cloud.normals && wrong == 0) {
            double worst = 1;
            for (int i = 0; i < N && kept == N; i++)
                worst = fmin(worst, (double)sb_v3_dot(cloud.normals[i], normals[i]));
            CHECK(worst > 0.9);
        }
        reg_cloud_free(&cloud);
    }
}

/* A closed surface with noise, and a tenth of its nodes anywhere: these come back to it. */
static void test_smooth_mesh(void)
{
    sb_mesh organ;
    sb_boundary skin;
    sb_surface *truth = NULL;
    uint32_t state = 99;
    reg_smooth_info info;
    double sum = 0, worst = 0;
    int wrong = 0;
    sb_mesh mesh;
    if (!CHECK_OK(sb_mesh_organ(SB_TET4, 24, NULL, &organ, NULL)) ||
        !CHECK_OK(sb_mesh_boundary(&organ, 1, NULL, &skin, NULL)) ||
        !CHECK_OK(sb_surface_triangulate(&skin.surface, NULL, &mesh, NULL)) ||
        !CHECK_OK(sb_surface_create(&mesh, NULL, &truth, NULL)))
        return;
    CHECK_OK(reg_cloud_smooth_mesh(&mesh, NULL, &info, NULL));
    CHECK_INT(info.outliers, 0);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 *x = mesh.nodes + i;
        int lost = i % 10 == 3;
        double sd = lost ? 0.05 : 5e-4;
        *x = sb_v3_add(*x, sb_v3(REAL(sd * noise(&state)), REAL(sd * noise(&state)), REAL(sd * noise(&state))));
        wrong += lost;
    }
    CHECK_OK(reg_cloud_smooth_mesh(&mesh, NULL, &info, NULL));
    CHECK(info.outliers > 0.95 * wrong && info.outliers < 1.1 * wrong);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_surface_hit hit;
        if (CHECK(sb_surface_closest(truth, mesh.nodes[i], SB_REAL_MAX, &hit))) {
            sum += (double)hit.distance / mesh.node_count;
            worst = fmax(worst, (double)hit.distance);
        }
    }
    CHECK(sum < 4e-4 && worst < 0.01); /* the spacing, within which nothing is an outlier */
    sb_surface_destroy(truth);
    sb_mesh_free(&mesh);
    sb_boundary_free(&skin);
    sb_mesh_free(&organ);
}

/* Few points, points in one place, in a line, and none: nothing is made of them. */
static void test_smooth_little(void)
{
    sb_vec3 points[40];
    reg_cloud cloud;
    reg_smooth_info info;
    for (int kind = 0; kind < 4; kind++) {
        for (int i = 0; i < 40; i++)
            points[i] = kind == 1 ? sb_v3(1, 2, 3) : sb_v3(REAL(i), REAL(kind == 3 ? i % 7 : 0), 0);
        if (!CHECK_OK(reg_cloud_from_points(&cloud, points, NULL, kind == 0 ? 1 : 40, NULL, NULL)))
            return;
        CHECK_OK(reg_cloud_smooth(&cloud, NULL, &info, NULL));
        CHECK(cloud.count == (kind == 0 ? 1 : 40) && memcmp(cloud.points, points, sizeof points[0]) == 0);
        CHECK(info.outliers == 0 && info.noise <= 64 * SB_EPSILON);
        reg_cloud_free(&cloud);
    }
    CHECK_RESULT(reg_cloud_smooth(NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_smooth_mesh(NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    memset(&cloud, 0, sizeof cloud);
    CHECK_RESULT(reg_cloud_smooth(&cloud, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
}

static sb_result everything(const sb_allocator *allocator, const char *file, size_t size)
{
    reg_cloud cloud, thin;
    sb_error error;
    sb_result result = reg_cloud_load_memory(&cloud, file, size, REG_CLOUD_AUTO, NULL, 1, allocator, &error);
    if (result != SB_OK)
        return result;
    result = reg_cloud_estimate_normals(&cloud, 8, NULL, NULL, &error);
    if (result == SB_OK)
        result = reg_cloud_thin(&cloud, REAL(0.05), &thin, &error);
    if (result == SB_OK) {
        reg_cloud_free(&thin);
        result = reg_cloud_remove_outliers(&cloud, 4, REG_OUTLIERS_MEDIAN, 3, NULL, &error);
    }
    if (result == SB_OK)
        result = reg_cloud_smooth(&cloud, NULL, NULL, &error);
    reg_cloud_free(&cloud);
    return result;
}

static void test_memory(void)
{
    enum { N = 60 };
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_vec3 points[N], normals[N];
    char file[16384];
    size_t size = 0;
    int needed;
    ellipsoid(points, normals, N);
    for (int i = 0; i < N; i++)
        size += (size_t)snprintf(file + size, sizeof file - size, "%.9g %.9g %.9g %.9g %.9g %.9g\n",
                                 (double)points[i].x, (double)points[i].y, (double)points[i].z, (double)normals[i].x,
                                 (double)normals[i].y, (double)normals[i].z);
    CHECK_OK(everything(&allocator, file, size));
    CHECK_INT(memory.live, 0);
    needed = memory.calls;
    CHECK(needed > 10);
    for (int fail = 1; fail <= needed; fail++) {
        memory.calls = 0;
        memory.fail_at = fail;
        CHECK_RESULT(everything(&allocator, file, size), SB_ERROR_MEMORY);
        CHECK_INT(memory.live, 0);
    }
}

static void test_bad_points(void)
{
    sb_vec3 points[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, normals[3] = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}};
    reg_cloud cloud;
    sb_error error;
    cloud.count = -5;
    CHECK_RESULT(reg_cloud_from_points(&cloud, points, normals, 0, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_from_points(&cloud, NULL, NULL, 3, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_from_points(NULL, points, NULL, 3, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_cloud_from_mesh(&cloud, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    normals[2].y = SB_REAL_MAX * 2;
    CHECK_RESULT(reg_cloud_from_points(&cloud, points, normals, 3, NULL, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 2);
    points[1].x = SB_REAL_MAX * 2;
    CHECK_RESULT(reg_cloud_from_points(&cloud, points, NULL, 3, NULL, &error), SB_ERROR_NOT_FINITE);
    CHECK(error.node == 1 && cloud.count == -5);
    reg_cloud_free(NULL);
}

CHECK_SUITE(cloud, {"ascii ply", test_ascii_ply}, {"binary ply", test_binary_ply}, {"round trip", test_round_trip},
            {"text", test_text}, {"texts of other countries and programs", test_text_forms},
            {"byte order marks and NUL bytes", test_marks_and_nuls}, {"formats", test_formats},
            {"from mesh", test_from_mesh}, {"normals", test_normals}, {"normals of little", test_normals_of_little},
            {"thin", test_thin}, {"spread", test_spread}, {"outlier rules", test_rules},
            {"remove outliers", test_remove}, {"smooth", test_smooth}, {"smooth a mesh", test_smooth_mesh},
            {"smooth little", test_smooth_little}, {"memory", test_memory}, {"bad points", test_bad_points});
