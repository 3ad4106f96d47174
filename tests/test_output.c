/* output: every writer on a full disk, over an old file and where there was none; what is no plain file;
 * permissions. */
#if !defined(_WIN32)
#define _XOPEN_SOURCE 700 /* symlink, mkfifo, setrlimit */
#endif
#include "register.h"

#include "check.h"
#include "examples/picture.h"
#include "examples/plot.h"
#include "scene.h"

#if defined(__unix__) || defined(__APPLE__)
#define HAS_POSIX 1
#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>
#else
#define HAS_POSIX 0
#endif

/* ---- files ---- */

enum { MOST_BYTES = 1 << 16 };

typedef struct bytes {
    size_t size; /* 0 as well: no such file */
    unsigned char data[MOST_BYTES];
} bytes;

static int exists(const char *path)
{
    FILE *file = fopen(path, "rb");
    if (file)
        fclose(file);
    return file != NULL;
}

static void read_bytes(const char *path, bytes *out)
{
    FILE *file = fopen(path, "rb");
    out->size = file ? fread(out->data, 1, MOST_BYTES, file) : 0;
    if (file)
        fclose(file);
}

static int is_content(const char *path, const void *data, size_t size)
{
    static bytes got;
    read_bytes(path, &got);
    return got.size == size && memcmp(got.data, data, size) == 0;
}

static int is_text(const char *path, const char *text) { return is_content(path, text, strlen(text)); }

static int save_text(const char *path, const char *text, sb_error *error)
{
    return sb_file_save(path, text, strlen(text), error);
}

/* ---- all that writes files ---- */

/* What there is to write. */
typedef struct things {
    sb_mesh volume, surface;
    sb_body *body;
    sb_recording *recording;
    reg_cloud cloud;
    picture shot;
} things;

static int make_things(things *t)
{
    sb_body_def def = sb_default_body_def();
    sb_boundary boundary;
    sb_error error;
    memset(t, 0, sizeof *t);
    memset(&boundary, 0, sizeof boundary);
    t->volume = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.3), REAL(0.2), REAL(0.2)), 0.1);
    def.mesh = &t->volume;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    if (!CHECK_OK(sb_body_create(&def, &t->body, &error)) ||
        !CHECK_OK(sb_recording_start(t->body, 0, NULL, &t->recording, &error)) ||
        !CHECK_OK(sb_mesh_boundary(&t->volume, 1, NULL, &boundary, &error)) ||
        !CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &t->surface, &error)) ||
        !CHECK_OK(reg_cloud_from_mesh(&t->cloud, &t->surface, NULL, &error)))
        return 0;
    sb_boundary_free(&boundary);
    picture_begin(&t->shot, 40, 30);
    return 1;
}

static void free_things(things *t)
{
    picture_end(&t->shot);
    reg_cloud_free(&t->cloud);
    sb_recording_destroy(t->recording);
    sb_body_destroy(t->body);
    sb_mesh_free(&t->surface);
    sb_mesh_free(&t->volume);
}

/* Another content for every writer. */
static void change_things(things *t)
{
    sb_step_info info;
    CHECK_OK(sb_body_set_gravity(t->body, sb_v3(0, 0, REAL(-9.81))));
    CHECK_OK(sb_body_step(t->body, REAL(0.01), &info));
    t->volume.nodes[1].x += REAL(0.001);
    t->surface.nodes[0].x -= REAL(0.001);
    t->cloud.points[0].x -= REAL(0.001);
    t->shot.pixels[0] = t->shot.pixels[0] > 0.4f ? 0.2f : 0.7f;
}

static sb_result fail_picture(int failed, sb_error *error)
{
    memset(error, 0, sizeof *error); /* pictures have codes of their own */
    return failed ? SB_ERROR_FILE : SB_OK;
}

static sb_result write_state(things *t, const char *path, sb_error *e)
{
    return sb_body_state_save_file(t->body, path, e);
}
static sb_result write_record(things *t, const char *path, sb_error *e)
{
    return sb_recording_save_file(t->recording, path, e);
}
static sb_result write_image(things *t, const char *path, sb_error *e) /* as needles and preconditioners have them */
{
    return sb_file_save(path, t->volume.nodes, (size_t)t->volume.node_count * sizeof *t->volume.nodes, e);
}
static sb_result write_vtk(things *t, const char *path, sb_error *e)
{
    return sb_mesh_save_vtk(path, &t->volume, NULL, 0, e);
}
static sb_result write_vtk_binary(things *t, const char *path, sb_error *e)
{
    return sb_mesh_save_vtk_binary(path, &t->volume, NULL, 0, e);
}
static sb_result write_obj(things *t, const char *path, sb_error *e) { return sb_mesh_save_obj(path, &t->surface, e); }
static sb_result write_stl(things *t, const char *path, sb_error *e) { return sb_mesh_save_stl(path, &t->surface, e); }
static sb_result write_ply(things *t, const char *path, sb_error *e) { return sb_mesh_save_ply(path, &t->surface, e); }
static sb_result write_cloud(things *t, const char *path, sb_error *e)
{
    return reg_cloud_save_ply(path, &t->cloud, 0, e);
}
static sb_result write_cloud_text(things *t, const char *path, sb_error *e)
{
    return reg_cloud_save_ply(path, &t->cloud, 1, e);
}
static sb_result write_picture(things *t, const char *path, sb_error *e)
{
    return fail_picture(picture_save_png(&t->shot, path) != PICTURE_OK, e);
}
static sb_result write_chart(things *t, const char *path, sb_error *e)
{
    static const double x[3] = {0, 1, 2};
    char title[32];
    double y[3];
    plot p;
    snprintf(title, sizeof title, "at %.6f", (double)t->volume.nodes[1].x);
    for (int i = 0; i < 3; i++)
        y[i] = (double)t->volume.nodes[1].x * i;
    plot_begin(&p, title);
    plot_add_curve(plot_add_panel(&p, "curve", "x", "y"), "y", x, y, 3);
    return fail_picture(!plot_save_svg(&p, path), e);
}

static const struct writer {
    const char *name;
    sb_result (*write)(things *t, const char *path, sb_error *error);
} writers[] = {{"state", write_state},
               {"recording", write_record},
               {"image", write_image},
               {"VTK", write_vtk},
               {"binary VTK", write_vtk_binary},
               {"OBJ", write_obj},
               {"STL", write_stl},
               {"PLY", write_ply},
               {"cloud", write_cloud},
               {"cloud as text", write_cloud_text},
               {"picture", write_picture},
               {"chart", write_chart}};
enum { WRITERS = (int)(sizeof writers / sizeof writers[0]) };

/* ---- a full disk ---- */

#if HAS_POSIX
static const char *const folder = "test_output_folder.tmp";

static const char *in_folder(const char *name)
{
    static char paths[8][512]; /* the last eight are good */
    static int turn;
    char *path = paths[turn++ % 8];
    snprintf(path, 512, "%s/%s", folder, name);
    return path;
}

/* Names in the folder; with `empty` they are removed. */
static int count_files(int empty)
{
    DIR *all = opendir(folder);
    int count = 0;
    for (struct dirent *entry = all ? readdir(all) : NULL; entry; entry = readdir(all)) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
            continue;
        count++;
        if (empty)
            remove(in_folder(entry->d_name));
    }
    if (all)
        closedir(all);
    return count;
}

static void begin_folder(void)
{
    mkdir(folder, 0777);
    count_files(1);
}

static void end_folder(void)
{
    count_files(1);
    rmdir(folder);
}

typedef struct small_disk {
    struct rlimit limit;
    void (*handler)(int);
} small_disk;

/* No file grows beyond `size`: a write fails then as on a full disk. 0 where that cannot be had. */
static int begin_small_disk(small_disk *disk, size_t size)
{
    struct rlimit limit;
    fflush(stdout); /* what is printed may be a file, too */
    if (getrlimit(RLIMIT_FSIZE, &disk->limit) != 0)
        return 0;
    disk->handler = signal(SIGXFSZ, SIG_IGN);
    limit = disk->limit;
    limit.rlim_cur = (rlim_t)size;
    return setrlimit(RLIMIT_FSIZE, &limit) == 0;
}

static void end_small_disk(const small_disk *disk)
{
    setrlimit(RLIMIT_FSIZE, &disk->limit);
    signal(SIGXFSZ, disk->handler);
}

static void test_full_disk(void)
{
    static const double shares[5] = {0, 0.01, 0.5, 0.99, 1};
    static bytes old, whole;
    things t;
    begin_folder();
    if (!make_things(&t))
        return;
    for (int w = 0; w < WRITERS; w++) {
        const char *path = in_folder("old"), *fresh = in_folder("fresh");
        sb_error error;
        if (!CHECK_OK(writers[w].write(&t, path, &error)))
            printf("    %s\n", writers[w].name);
        read_bytes(path, &old);
        change_things(&t);
        CHECK_OK(writers[w].write(&t, fresh, &error));
        read_bytes(fresh, &whole);
        remove(fresh);
        CHECK(whole.size > 0 && whole.size < MOST_BYTES);
        CHECK(whole.size != old.size || memcmp(whole.data, old.data, old.size) != 0);
        for (int k = 0; k < 5; k++) {
            size_t room = (size_t)(shares[k] * (double)whole.size) - (shares[k] >= 1);
            small_disk disk;
            sb_result over, new_one;
            if (!begin_small_disk(&disk, room)) {
                CHECK_SKIP("the size of files cannot be limited");
                break;
            }
            over = writers[w].write(&t, path, &error);
            new_one = writers[w].write(&t, fresh, &error);
            end_small_disk(&disk);
            if (!CHECK_INT(over, SB_ERROR_FILE) || !CHECK_INT(new_one, SB_ERROR_FILE) ||
                !CHECK(is_content(path, old.data, old.size)) || !CHECK(!exists(fresh)) || !CHECK_INT(count_files(0), 1))
                printf("    %s, room for %lu of %lu bytes\n", writers[w].name, (unsigned long)room,
                       (unsigned long)whole.size);
            if (error.message[0])
                CHECK(strstr(error.message, "disk full") && strcmp(error.file, fresh) == 0);
        }
        CHECK_OK(writers[w].write(&t, path, &error));
        if (!CHECK(is_content(path, whole.data, whole.size)) || !CHECK_INT(count_files(1), 1))
            printf("    %s\n", writers[w].name);
    }
    free_things(&t);
    end_folder();
}

/* ---- what is no plain file ---- */

static void test_devices(void)
{
    things t;
    if (!exists("/dev/full") || !exists("/dev/null")) {
        CHECK_SKIP("there is no /dev/full");
        return;
    }
    if (!make_things(&t))
        return;
    for (int w = 0; w < WRITERS; w++) {
        struct stat about;
        sb_error error;
        if (!CHECK_RESULT(writers[w].write(&t, "/dev/full", &error), SB_ERROR_FILE) ||
            !CHECK_OK(writers[w].write(&t, "/dev/null", &error)))
            printf("    %s\n", writers[w].name);
        CHECK(stat("/dev/full", &about) == 0 && S_ISCHR(about.st_mode));
        CHECK(stat("/dev/null", &about) == 0 && S_ISCHR(about.st_mode));
    }
    free_things(&t);
}

static void test_pipe(void)
{
    const char *path;
    char text[16] = "";
    int reader;
    begin_folder();
    path = in_folder("pipe");
    if (mkfifo(path, 0600) != 0) {
        CHECK_SKIP("there are no named pipes here");
        return;
    }
    reader = open(path, O_RDONLY | O_NONBLOCK);
    CHECK_OK(save_text(path, "through", NULL));
    CHECK(read(reader, text, sizeof text) == 7 && strncmp(text, "through", 7) == 0);
    CHECK_INT(count_files(0), 1);
    close(reader);
    end_folder();
}

/* A file that stdout goes to is open: another one in its place would not get what is printed next. */
static void test_open_file(void)
{
    char name[64];
    struct stat before, after;
    int file;
    begin_folder();
    file = open(in_folder("log"), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    snprintf(name, sizeof name, "/dev/fd/%d", file);
    if (!exists(name)) {
        CHECK_SKIP("there is no /dev/fd");
    } else {
        CHECK(fstat(file, &before) == 0);
        CHECK_OK(save_text(name, "text", NULL));
        CHECK(stat(in_folder("log"), &after) == 0 && after.st_ino == before.st_ino);
        CHECK(is_text(in_folder("log"), "text"));
    }
    close(file);
    end_folder();
}

static void test_links(void)
{
    char absolute[512], here[400];
    struct stat about;
    sb_error error;
    begin_folder();
    if (!CHECK(getcwd(here, sizeof here) != NULL))
        return;
    snprintf(absolute, sizeof absolute, "%s/%s/file", here, folder);
    CHECK_OK(save_text(in_folder("file"), "old", &error));
    CHECK(symlink("file", in_folder("near")) == 0 && symlink(absolute, in_folder("far")) == 0);
    CHECK(symlink("near", in_folder("twice")) == 0 && symlink("later", in_folder("dangling")) == 0);
    CHECK(symlink("circle", in_folder("circle")) == 0);
    CHECK_OK(save_text(in_folder("near"), "near", &error));
    CHECK(is_text(in_folder("file"), "near"));
    CHECK_OK(save_text(in_folder("far"), "far", &error));
    CHECK(is_text(in_folder("file"), "far"));
    CHECK_OK(save_text(in_folder("twice"), "twice", &error));
    CHECK(is_text(in_folder("file"), "twice"));
    CHECK_OK(save_text(in_folder("dangling"), "new", &error));
    CHECK(is_text(in_folder("later"), "new"));
    CHECK_RESULT(save_text(in_folder("circle"), "never", &error), SB_ERROR_FILE);
    CHECK(lstat(in_folder("twice"), &about) == 0 && S_ISLNK(about.st_mode));
    CHECK(lstat(in_folder("far"), &about) == 0 && S_ISLNK(about.st_mode));
    CHECK_INT(count_files(0), 7);
    end_folder();
}

static void test_permissions(void)
{
    struct stat about;
    sb_error error;
    begin_folder();
    CHECK_OK(save_text(in_folder("private"), "old", &error));
    chmod(in_folder("private"), 0640);
    CHECK_OK(save_text(in_folder("private"), "new", &error));
    CHECK(stat(in_folder("private"), &about) == 0 && (about.st_mode & 07777) == 0640);
    CHECK_RESULT(save_text(folder, "text", &error), SB_ERROR_FILE);
    CHECK_RESULT(save_text(in_folder("private/below"), "text", &error), SB_ERROR_FILE);
    if (getuid() == 0) {
        CHECK_SKIP("root may write everywhere");
    } else {
        chmod(in_folder("private"), 0400);
        CHECK_RESULT(save_text(in_folder("private"), "never", &error), SB_ERROR_FILE);
        chmod(in_folder("private"), 0600);
        chmod(folder, 0500);
        CHECK_RESULT(save_text(in_folder("private"), "never", &error), SB_ERROR_FILE);
        CHECK(strstr(error.message, "write-protected") != NULL);
        chmod(folder, 0700);
    }
    CHECK(is_text(in_folder("private"), "new"));
    CHECK_INT(count_files(0), 1);
    end_folder();
}

/* As long as file systems take them, in bytes of one, two and three. */
static void test_long_names(void)
{
    static const char *const letters[3] = {"a", "\xC3\xA9", "\xE2\x82\xAC"};
    char name[300];
    sb_error error;
    begin_folder();
    for (size_t k = 0; k < 3; k++) {
        name[0] = 0;
        while (strlen(name) + k + 1 <= 255)
            strcat(name, letters[k]);
        CHECK_OK(save_text(in_folder(name), "old", &error));
        CHECK_OK(save_text(in_folder(name), "long", &error));
        CHECK(is_text(in_folder(name), "long"));
    }
    CHECK_INT(count_files(0), 3);
    end_folder();
}
#else
static void test_full_disk(void) { CHECK_SKIP("the size of files cannot be limited"); }
static void test_devices(void) { CHECK_SKIP("there is no /dev/full"); }
static void test_pipe(void) { CHECK_SKIP("there are no named pipes"); }
static void test_open_file(void) { CHECK_SKIP("there is no /dev/fd"); }
static void test_links(void) { CHECK_SKIP("there are no symbolic links"); }
static void test_permissions(void) { CHECK_SKIP("there are no permissions"); }
static void test_long_names(void) { CHECK_SKIP("lengths of names differ"); }
#endif

/* ---- the calls ---- */

static void test_calls(void)
{
    const char *path = "test_output.tmp";
    char too_long[SB_OUTPUT_PATH + 8];
    sb_output first, second;
    sb_error error;
    remove(path);
    CHECK_RESULT(sb_output_open(NULL, path, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_output_open(&first, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_output_open(&first, "", &error), SB_ERROR_FILE);
    CHECK_RESULT(sb_output_close(&first, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_output_close(NULL, &error), SB_ERROR_ARGUMENT);
    sb_output_discard(NULL);
    sb_output_discard(&first);
    CHECK_RESULT(sb_file_save(NULL, "x", 1, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_file_save(path, NULL, 1, &error), SB_ERROR_ARGUMENT);
    memset(too_long, 'a', sizeof too_long - 1);
    too_long[sizeof too_long - 1] = 0;
    for (size_t cut = 0; cut < 64; cut++)
        CHECK_RESULT(sb_file_save(too_long + cut, "x", 1, &error), SB_ERROR_FILE);
    CHECK_RESULT(sb_file_save("no such folder/x", "x", 1, NULL), SB_ERROR_FILE);
    CHECK_OK(sb_file_save(path, NULL, 0, &error));
    CHECK(exists(path) && is_text(path, ""));
    CHECK_OK(sb_file_save(path, "old", 3, &error));
    if (!CHECK_OK(sb_output_open(&first, path, &error)) || !CHECK_OK(sb_output_open(&second, path, &error)))
        return;
    fputs("of the first", first.file);
    fputs("second", second.file);
    CHECK(is_text(path, "old")); /* until one is closed */
    CHECK_OK(sb_output_close(&second, &error));
    CHECK(is_text(path, "second"));
    CHECK_OK(sb_output_close(&first, &error));
    CHECK(is_text(path, "of the first"));
    CHECK_RESULT(sb_output_close(&first, &error), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_output_open(&first, path, &error));
    fputs("discarded", first.file);
    sb_output_discard(&first);
    CHECK(is_text(path, "of the first") && !exists(first.beside));
    remove(path);
    CHECK_OK(sb_output_open(&first, path, &error));
    sb_output_discard(&first);
    CHECK(!exists(path) && !exists(first.beside));
}

CHECK_SUITE(output, {"a full disk, over a file and without one, every writer", test_full_disk},
            {"devices, every writer", test_devices}, {"a named pipe", test_pipe},
            {"a file that is open under a name of its own", test_open_file}, {"symbolic links", test_links},
            {"permissions and folders", test_permissions}, {"long names", test_long_names}, {"calls", test_calls});
