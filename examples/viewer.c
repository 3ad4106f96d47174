/* viewer: an organ in a window: pull at it, push a needle into it, change its material, record and play again.
 *
 *     viewer [ORGAN] [OPTIONS]              viewer --help lists the options, keys and buttons
 *
 * ORGAN is a volume mesh (VTK, VTU, gmsh, Medit, TetGen); without one an organ is made. A window of SDL 2, which is all
 * that this program needs besides the headers:
 *
 *     cc -O2 viewer.c $(sdl2-config --cflags --libs) -lm          or          make build/viewer
 *
 * The body makes a step of 1/60 s for each frame; where a step takes longer, time goes by slower, and the window says
 * so. A session that is recorded is a text file of what the hand did; played again it ends with the same bits, or the
 * program says that it does not. --frames and --picture need no screen (SDL_VIDEODRIVER=dummy). Exit status: 0, 1 a
 * session that was played ended with other bits, 2 wrong usage, a file, or no window, 3 no memory. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#endif
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "softbody.h"

#include "needle.h"

#include "viewer_scene.h"

#define SDL_MAIN_HANDLED
#include <SDL.h>

enum { EXIT_DIFFERS = 1, PANEL = 250, MARGIN = 16, ROW = 46, FIRST_ROW = 130 };

typedef struct settings {
    const char *mesh, *side, *record, *play, *picture;
    double scale, share;
    int cells, frames, help;
} settings;

/* A triangle to be drawn, and how near it is. */
typedef struct shown_triangle {
    float depth;
    int corners[3]; /* among the vertices */
} shown_triangle;

typedef struct viewer {
    const settings *set;
    viewer_scene scene;
    SDL_Window *window;
    SDL_Renderer *renderer;
    double azimuth, elevation, zoom, shift_x, shift_y; /* degrees, 1: the organ fills the window, pixels */
    picture_view view;
    SDL_Vertex *vertices;      /* [surface nodes] */
    sb_vec3 *normals;          /* [surface nodes] */
    shown_triangle *triangles; /* [4 surface elements] */
    int *indices;              /* [12 surface elements] */
    int slider, turning, shifting, pressed, piercing, paused, help, done, playing;
    double most;                        /* von Mises stress (Pa) at the end of the colours */
    double frame_seconds, step_seconds; /* means of the last ones */
    double start[VIEWER_SLIDERS];       /* of the session that is recorded */
    int fell, differs;
} viewer;

/* ---- what is seen ---- */

static sb_vec3 to_sb(picture_vec v) { return sb_v3((sb_real)v.x, (sb_real)v.y, (sb_real)v.z); }

static void set_view(viewer *v)
{
    const organ *o = &v->scene.o;
    picture_vec middle = picture_from(sb_v3_scale((sb_real)0.5, sb_v3_add(o->low, o->high))), at;
    double size = (double)sb_v3_norm(sb_v3_sub(o->high, o->low));
    int width, height;
    SDL_GetRendererOutputSize(v->renderer, &width, &height);
    v->view = picture_make_view(v->azimuth, v->elevation, width, height);
    v->view.scale = 0.9 * v->zoom * fmin(width - PANEL, height) / size;
    v->view.x = v->view.y = 0;
    at = picture_project(&v->view, middle);
    v->view.x = (width - PANEL) / 2.0 - at.x + v->shift_x;
    v->view.y = height / 2.0 - at.y + v->shift_y;
}

/* The pointer's ray: origin, direction. */
static void ray_of(const viewer *v, int x, int y, double ray[6])
{
    const picture_view *w = &v->view;
    double far = 10 * (double)sb_v3_norm(sb_v3_sub(v->scene.o.high, v->scene.o.low));
    picture_vec middle = picture_from(sb_v3_scale((sb_real)0.5, sb_v3_add(v->scene.o.low, v->scene.o.high)));
    picture_vec seen = picture_project(w, middle);
    picture_vec at = picture_madd(middle, (x - seen.x) / w->scale, w->right);
    at = picture_madd(picture_madd(at, (seen.y - y) / w->scale, w->up), far, w->toward);
    ray[0] = at.x, ray[1] = at.y, ray[2] = at.z;
    ray[3] = -w->toward.x, ray[4] = -w->toward.y, ray[5] = -w->toward.z;
}

static int make_arrays(viewer *v)
{
    const sb_mesh *surface = &v->scene.o.boundary.surface;
    size_t nodes = (size_t)surface->node_count + 1, faces = (size_t)surface->element_count + 1;
    v->vertices = (SDL_Vertex *)calloc(nodes, sizeof *v->vertices);
    v->normals = (sb_vec3 *)calloc(nodes, sizeof *v->normals);
    v->triangles = (shown_triangle *)calloc(8 * faces, sizeof *v->triangles);
    v->indices = (int *)calloc(24 * faces, sizeof *v->indices);
    return v->vertices && v->normals && v->triangles && v->indices ? 0 : organ_complain_memory(&v->scene.o);
}

/* The triangles that face the viewer, and the normals of all nodes times an area. */
static int collect_triangles(viewer *v)
{
    const organ *o = &v->scene.o;
    const sb_mesh *surface = &o->boundary.surface;
    const sb_vec3 *x = sb_body_positions(o->body);
    sb_vec3 toward = to_sb(v->view.toward);
    const int(*split)[3];
    int pieces = picture_split(surface->element_type, &split), nodes = sb_element_node_count(surface->element_type);
    int count = 0;
    memset(v->normals, 0, (size_t)surface->node_count * sizeof *v->normals);
    for (int i = 0; i < surface->element_count * pieces; i++) {
        shown_triangle *t = &v->triangles[count];
        sb_vec3 p[3], normal;
        for (int k = 0; k < 3; k++) {
            t->corners[k] = surface->elements[(i / pieces) * nodes + split[i % pieces][k]];
            p[k] = x[o->boundary.nodes[t->corners[k]]];
        }
        normal = sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(p[2], p[0]));
        for (int k = 0; k < 3; k++)
            v->normals[t->corners[k]] = sb_v3_add(v->normals[t->corners[k]], normal);
        t->depth = (float)sb_v3_dot(toward, sb_v3_add(p[0], sb_v3_add(p[1], p[2])));
        count += sb_v3_dot(normal, toward) > 0;
    }
    return count;
}

static SDL_Color colour_of(picture_colour c)
{
    SDL_Color made = {picture_to_byte(c.r), picture_to_byte(c.g), picture_to_byte(c.b), 255};
    return made;
}

/* Colours by stress under a lamp at the viewer's upper left. */
static void light_vertices(viewer *v)
{
    organ *o = &v->scene.o;
    const sb_vec3 *x = sb_body_positions(o->body);
    picture_vec lamp = picture_unit(picture_madd(picture_madd(v->view.toward, -0.4, v->view.right), 0.6, v->view.up));
    double largest = 0;
    sb_body_nodal_von_mises(o->body, o->numbers);
    for (int i = 0; i < o->boundary.surface.node_count; i++) {
        int node = o->boundary.nodes[i];
        picture_vec seen = picture_project(&v->view, picture_from(x[node]));
        double light = picture_dot(picture_unit(picture_from(v->normals[i])), lamp), value = (double)o->numbers[node];
        picture_colour c = picture_map(picture_clamp(value / v->most, 0, 1));
        light = 0.25 + 0.75 * fmax(light, 0);
        v->vertices[i].position.x = (float)seen.x;
        v->vertices[i].position.y = (float)seen.y;
        v->vertices[i].color = colour_of(picture_rgb(c.r * light, c.g * light, c.b * light));
        largest = fmax(largest, value);
    }
    v->most = fmax(v->most + 0.05 * (largest - v->most), 1e-6 * v->scene.values[0]); /* colours follow slowly */
}

static int by_depth(const void *a, const void *b)
{
    float x = ((const shown_triangle *)a)->depth, y = ((const shown_triangle *)b)->depth;
    return (x > y) - (x < y);
}

static void draw_organ(viewer *v)
{
    int count = collect_triangles(v);
    light_vertices(v);
    qsort(v->triangles, (size_t)count, sizeof *v->triangles, by_depth);
    for (int i = 0; i < count; i++)
        memcpy(v->indices + 3 * (size_t)i, v->triangles[i].corners, sizeof v->triangles[i].corners);
    SDL_RenderGeometry(v->renderer, NULL, v->vertices, v->scene.o.boundary.surface.node_count, v->indices, 3 * count);
}

static void draw_line(viewer *v, sb_vec3 from, sb_vec3 to, double thick, SDL_Color colour)
{
    static const int corners[6] = {0, 1, 2, 0, 2, 3};
    picture_vec a = picture_project(&v->view, picture_from(from)), b = picture_project(&v->view, picture_from(to));
    double length = fmax(hypot(b.x - a.x, b.y - a.y), 1e-9);
    double x = -(b.y - a.y) / length * thick / 2, y = (b.x - a.x) / length * thick / 2;
    SDL_Vertex quad[4];
    memset(quad, 0, sizeof quad);
    for (int i = 0; i < 4; i++) {
        picture_vec p = i < 2 ? a : b;
        double sign = i == 0 || i == 3 ? 1 : -1;
        quad[i].position.x = (float)(p.x + sign * x);
        quad[i].position.y = (float)(p.y + sign * y);
        quad[i].color = colour;
    }
    SDL_RenderGeometry(v->renderer, NULL, quad, 4, corners, 6);
}

/* Seen through the organ, paler inside. */
static void draw_needle(viewer *v)
{
    const viewer_scene *s = &v->scene;
    const ndl_rod *rod = s->needle ? ndl_needle_rod(s->needle) : NULL;
    int count = rod ? ndl_rod_node_count(rod) : 0;
    sb_real outside = rod ? -ndl_needle_depth(s->needle) : 0, along = 0; /* of its length */
    for (int i = 0; i + 1 < count; i++)
        outside += sb_v3_norm(sb_v3_sub(ndl_rod_positions(rod)[i + 1], ndl_rod_positions(rod)[i]));
    for (int i = 0; i + 1 < count; i++) {
        const sb_vec3 *x = ndl_rod_positions(rod) + i;
        SDL_Color colour = {40, 90, 140, 255};
        along += sb_v3_norm(sb_v3_sub(x[1], x[0]));
        colour.a = along > outside ? 150 : 255;
        draw_line(v, x[0], x[1], 4, colour);
    }
}

static void draw_hand(viewer *v)
{
    const SDL_Color colour = {190, 40, 60, 255};
    if (v->scene.spring >= 0)
        draw_line(v, sb_body_positions(v->scene.o.body)[v->scene.node], v->scene.hand, 3, colour);
}

/* ---- the panel ---- */

/* Text of dots, `dot` pixels each; y: of its line. */
static void draw_text(viewer *v, double x, double y, int dot, const char *text)
{
    for (; *text; text++) {
        const unsigned short *glyph = picture_glyph((unsigned char)*text);
        for (int column = 0; column < 5; column++)
            for (int row = 0; row < 9; row++)
                if (picture_glyph_dot(glyph, column, row)) {
                    SDL_Rect rect = {(int)x + dot * column, (int)y + dot * (row - 6), dot, dot};
                    SDL_RenderFillRect(v->renderer, &rect);
                }
        x += dot * picture_glyph_width((unsigned char)*text);
    }
}

static double slider_place(const viewer *v, int slider)
{
    double low = viewer_sliders[slider].low, high = viewer_sliders[slider].high, value = v->scene.values[slider];
    return viewer_sliders[slider].logarithmic ? log(value / low) / log(high / low) : (value - low) / (high - low);
}

static double slider_value(int slider, double place)
{
    double low = viewer_sliders[slider].low, high = viewer_sliders[slider].high;
    place = picture_clamp(place, 0, 1);
    return viewer_sliders[slider].logarithmic ? low * pow(high / low, place) : low + place * (high - low);
}

static void draw_sliders(viewer *v, int left)
{
    char text[320];
    for (int i = 0; i < VIEWER_SLIDERS; i++) {
        SDL_Rect bar = {left, FIRST_ROW + ROW * i + 10, PANEL - 2 * MARGIN, 6}, knob;
        SDL_SetRenderDrawColor(v->renderer, 60, 66, 80, 255);
        snprintf(text, sizeof text, "%s %.4g", viewer_sliders[i].name, v->scene.values[i]);
        draw_text(v, left, FIRST_ROW + ROW * i, 1, text);
        SDL_SetRenderDrawColor(v->renderer, 190, 196, 208, 255);
        SDL_RenderFillRect(v->renderer, &bar);
        knob.x = left + (int)(slider_place(v, i) * bar.w) - 5;
        knob.y = bar.y - 5;
        knob.w = 10;
        knob.h = 16;
        SDL_SetRenderDrawColor(v->renderer, 47, 111, 159, 255);
        SDL_RenderFillRect(v->renderer, &knob);
    }
}

static const char *const keys[] = {"left: pull at the organ",
                                   "N + left: needle in",
                                   "B: needle out",
                                   "right: turn the view",
                                   "middle: shift, wheel: zoom",
                                   "G: gravity",
                                   "R: record from rest, save",
                                   "P: play what was saved",
                                   "space: pause, H: keys",
                                   "backspace: begin anew",
                                   "Esc: end"};

static void draw_panel(viewer *v)
{
    const viewer_scene *s = &v->scene;
    double force = (double)sb_v3_norm(s->force), slow = fmax(1, v->frame_seconds * VIEWER_FPS);
    char text[6][96];
    int width, height, left;
    SDL_Rect panel;
    SDL_GetRendererOutputSize(v->renderer, &width, &height);
    panel.x = width - PANEL, panel.y = 0, panel.w = PANEL, panel.h = height;
    left = panel.x + MARGIN;
    SDL_SetRenderDrawColor(v->renderer, 236, 239, 244, 255);
    SDL_RenderFillRect(v->renderer, &panel);
    SDL_SetRenderDrawColor(v->renderer, 44, 52, 64, 255);
    snprintf(text[0], sizeof text[0], "%.2f N", force);
    snprintf(text[1], sizeof text[1], "%d elements, %d nodes", s->o.mesh.element_count, s->o.mesh.node_count);
    snprintf(text[2], sizeof text[2], "step %.1f ms, %.0f frames/s", 1e3 * v->step_seconds,
             v->frame_seconds > 0 ? 1 / v->frame_seconds : 0);
    snprintf(text[3], sizeof text[3], slow > 1.1 ? "%.1f times slower than real time" : "in real time", slow);
    snprintf(text[4], sizeof text[4], "%s%s%s",
             v->playing     ? "plays "
             : s->recording ? "records "
                            : "",
             v->paused ? "paused " : "", s->falls ? "" : "no gravity");
    draw_text(v, left, 34, 3, text[0]);
    for (int i = 1; i < 5; i++)
        draw_text(v, left, 42 + 16 * i, 1, text[i]);
    draw_sliders(v, left);
    SDL_SetRenderDrawColor(v->renderer, 44, 52, 64, 255);
    for (size_t i = 0; v->help && i < sizeof keys / sizeof keys[0]; i++)
        draw_text(v, left, FIRST_ROW + ROW * VIEWER_SLIDERS + 10 + 18 * (double)i, 1, keys[i]);
    SDL_SetRenderDrawColor(v->renderer, 170, 30, 40, 255);
    draw_text(v, MARGIN, height - MARGIN, 1, s->message);
}

static void draw(viewer *v)
{
    SDL_SetRenderDrawColor(v->renderer, 222, 227, 235, 255);
    SDL_RenderClear(v->renderer);
    draw_organ(v);
    draw_needle(v);
    draw_hand(v);
    draw_panel(v);
}

/* What was drawn last, as a PNG file. */
static int save_picture(viewer *v, const char *path)
{
    picture p;
    int width, height, good;
    unsigned char *bytes;
    SDL_GetRendererOutputSize(v->renderer, &width, &height);
    bytes = (unsigned char *)malloc(4 * (size_t)width * (size_t)height);
    picture_begin(&p, width, height);
    if (!bytes || p.out_of_memory) {
        free(bytes);
        picture_end(&p);
        return organ_complain_memory(&v->scene.o);
    }
    good = SDL_RenderReadPixels(v->renderer, NULL, SDL_PIXELFORMAT_RGBA32, bytes, 4 * width) == 0;
    for (size_t i = 0; good && i < (size_t)width * (size_t)height; i++)
        for (int k = 0; k < 3; k++)
            p.pixels[3 * i + (size_t)k] = (float)picture_to_linear(bytes[4 * i + (size_t)k]);
    free(bytes);
    if (good)
        return organ_save_picture(&v->scene.o, &p, path);
    picture_end(&p);
    return organ_complain(&v->scene.o, "the picture", SDL_GetError(), ORGAN_FAILED);
}

/* ---- sessions ---- */

static const char *session_path(const viewer *v) { return v->set->record ? v->set->record : "viewer.session"; }

/* From rest, where the caller has put the scene. */
static void start_recording(viewer *v)
{
    memcpy(v->start, v->scene.values, sizeof v->start);
    v->fell = v->scene.falls;
    v->scene.recorded.count = 0;
    v->scene.recording = 1;
}

static int stop_recording(viewer *v)
{
    int status = viewer_save(&v->scene, session_path(v), v->start, v->fell);
    snprintf(v->scene.message, sizeof v->scene.message, status ? "%.200s cannot be written" : "saved %.200s",
             session_path(v));
    return status;
}

static int start_playing(viewer *v, const char *path)
{
    int status = viewer_load(&v->scene, path);
    v->playing = status == 0;
    if (status)
        snprintf(v->scene.message, sizeof v->scene.message, "%.200s cannot be played", path);
    return status;
}

/* What happens before the next step; 0: the session is over. */
static int play_frame(viewer *v, int *next)
{
    viewer_scene *s = &v->scene;
    for (; *next < s->played.count && s->played.events[*next].frame == s->frame; ++*next)
        viewer_do(s, s->played.events[*next].kind, s->played.events[*next].numbers);
    if (s->frame < s->played.frames)
        return 1;
    v->differs = viewer_hash(s) != s->played.hash;
    snprintf(s->message, sizeof s->message, "%d frames played: %s bits", s->frame, v->differs ? "other" : "the same");
    v->playing = 0;
    return 0;
}

/* ---- the pointer and the keys ---- */

static void begin_anew(viewer *v)
{
    v->playing = v->scene.recording = 0;
    v->done = viewer_begin(&v->scene) != 0;
}

static void press_left(viewer *v, int x, int y)
{
    double ray[6];
    int width, height, row = (y - FIRST_ROW + 14) / ROW;
    SDL_GetRendererOutputSize(v->renderer, &width, &height);
    if (x >= width - PANEL) {
        v->slider = y >= FIRST_ROW - 14 && row < VIEWER_SLIDERS ? row : -1;
        return;
    }
    ray_of(v, x, y, ray);
    v->pressed = viewer_do(&v->scene, v->piercing ? VIEWER_PIERCE : VIEWER_PULL, ray);
    v->turning = !v->pressed;
}

static void move_pointer(viewer *v, const SDL_MouseMotionEvent *e)
{
    double numbers[6];
    int width, height;
    SDL_GetRendererOutputSize(v->renderer, &width, &height);
    if (v->slider >= 0) {
        numbers[0] = v->slider;
        numbers[1] = slider_value(v->slider, (e->x - (width - PANEL + MARGIN)) / (double)(PANEL - 2 * MARGIN));
        viewer_do(&v->scene, VIEWER_SET, numbers);
    } else if (v->pressed) {
        ray_of(v, e->x, e->y, numbers);
        viewer_do(&v->scene, VIEWER_MOVE, numbers);
    } else if (v->turning) {
        v->azimuth -= 0.4 * e->xrel;
        v->elevation = fmin(fmax(v->elevation + 0.4 * e->yrel, -89), 89);
    } else if (v->shifting) {
        v->shift_x += e->xrel;
        v->shift_y += e->yrel;
    }
}

static void release(viewer *v)
{
    if (v->pressed)
        viewer_do(&v->scene, VIEWER_RELEASE, NULL);
    v->pressed = v->turning = v->shifting = 0;
    v->slider = -1;
}

static void press_key(viewer *v, SDL_Keycode key)
{
    double on = 1, falls = !v->scene.falls;
    switch (key) {
    case SDLK_ESCAPE: v->done = 1; break;
    case SDLK_SPACE: v->paused = !v->paused; break;
    case SDLK_h: v->help = !v->help; break;
    case SDLK_n: v->piercing = 1; break;
    case SDLK_b: viewer_do(&v->scene, VIEWER_OUT, &on); break;
    case SDLK_g: viewer_do(&v->scene, VIEWER_GRAVITY, &falls); break;
    case SDLK_BACKSPACE: begin_anew(v); break;
    case SDLK_p:
        v->scene.recording = 0;
        start_playing(v, v->set->play ? v->set->play : session_path(v));
        break;
    case SDLK_r:
        if (v->scene.recording)
            stop_recording(v);
        else {
            begin_anew(v);
            start_recording(v);
        }
        break;
    default: break;
    }
}

/* While a session is played, only the view and the session itself obey. */
static void handle(viewer *v, const SDL_Event *e)
{
    double off = 0;
    switch (e->type) {
    case SDL_QUIT: v->done = 1; break;
    case SDL_MOUSEBUTTONDOWN:
        if (e->button.button == SDL_BUTTON_LEFT && !v->playing)
            press_left(v, e->button.x, e->button.y);
        v->turning |= e->button.button == SDL_BUTTON_RIGHT || (e->button.button == SDL_BUTTON_LEFT && v->playing);
        v->shifting |= e->button.button == SDL_BUTTON_MIDDLE;
        break;
    case SDL_MOUSEBUTTONUP: release(v); break;
    case SDL_MOUSEMOTION: move_pointer(v, &e->motion); break;
    case SDL_MOUSEWHEEL: v->zoom = fmin(fmax(v->zoom * pow(1.1, e->wheel.y), 0.1), 20); break;
    case SDL_KEYDOWN:
        if (!e->key.repeat && (!v->playing || (e->key.keysym.sym != SDLK_b && e->key.keysym.sym != SDLK_g)))
            press_key(v, e->key.keysym.sym);
        break;
    case SDL_KEYUP:
        if (e->key.keysym.sym == SDLK_n)
            v->piercing = 0;
        if (e->key.keysym.sym == SDLK_b && !v->playing)
            viewer_do(&v->scene, VIEWER_OUT, &off);
        break;
    default: break;
    }
}

/* ---- the run ---- */

static int open_window(viewer *v)
{
    SDL_SetMainReady();
    if (SDL_Init(SDL_INIT_VIDEO) == 0 &&
        SDL_CreateWindowAndRenderer(1100, 720, SDL_WINDOW_RESIZABLE, &v->window, &v->renderer) == 0) {
        SDL_SetWindowTitle(v->window, "softbody viewer");
        SDL_SetRenderDrawBlendMode(v->renderer, SDL_BLENDMODE_BLEND);
        return 0;
    }
    return organ_complain(&v->scene.o, "no window", SDL_GetError(), ORGAN_USAGE);
}

static int make_scene(viewer *v)
{
    const settings *set = v->set;
    viewer_scene *s = &v->scene;
    sb_error error;
    int status = 0;
    s->side = set->side[0];
    if (set->side[1] == '+')
        s->side = (char)(s->side - 'a' + 'A');
    s->share = set->share;
    s->falls = 1;
    for (int i = 0; i < VIEWER_SLIDERS; i++)
        s->values[i] = viewer_sliders[i].start;
    if (set->mesh)
        status = organ_load(&s->o, set->mesh, set->scale);
    else if (sb_mesh_organ(SB_TET4, set->cells, NULL, &s->o.mesh, &error) != SB_OK)
        status = organ_complain_of(&s->o, "--cells", &error, ORGAN_USAGE);
    status = status ? status : organ_make_skin(&s->o);
    status = status ? status : make_arrays(v);
    return status ? status : viewer_begin(s);
}

/* Of some ten values; the first one stands for those before it. */
static double mean_of_last(double mean, double value) { return mean > 0 ? mean + 0.1 * (value - mean) : value; }

/* Steps and pictures until the window is closed, or --frames are over. */
static int run_frames(viewer *v)
{
    const double interval = 1.0 / VIEWER_FPS;
    int status = 0, next = 0, was_playing = 0;
    for (int frame = 0; !v->done && !status && (!v->set->frames || frame < v->set->frames); frame++) {
        double start = seconds_now(), took;
        SDL_Event event;
        while (SDL_PollEvent(&event))
            handle(v, &event);
        next = v->playing && !was_playing ? 0 : next;
        was_playing = v->playing;
        if (!v->paused && (!v->playing || play_frame(v, &next))) {
            double begun = seconds_now();
            viewer_step(&v->scene);
            v->step_seconds = mean_of_last(v->step_seconds, seconds_now() - begun);
        }
        set_view(v);
        draw(v);
        if (v->set->picture && v->set->frames && frame + 1 == v->set->frames)
            status = save_picture(v, v->set->picture);
        SDL_RenderPresent(v->renderer);
        took = seconds_now() - start;
        if (!v->set->frames && took < interval)
            SDL_Delay((Uint32)(1e3 * (interval - took)));
        v->frame_seconds = mean_of_last(v->frame_seconds, seconds_now() - start);
    }
    return status;
}

static int run(const settings *set)
{
    viewer v;
    int status;
    memset(&v, 0, sizeof v);
    v.set = set;
    v.scene.o.program = "viewer";
    v.azimuth = 25, v.elevation = 20, v.zoom = 1;
    v.most = 1000;
    v.slider = -1;
    v.help = 1;
    status = make_scene(&v);
    if (!status && set->play)
        status = start_playing(&v, set->play);
    status = status ? status : open_window(&v);
    if (!status && set->record)
        start_recording(&v);
    status = status ? status : run_frames(&v);
    if (!status && v.scene.recording)
        status = stop_recording(&v);
    if (!status)
        printf("frames=%d force_N=%.4g step_ms=%.3g%s\n", v.scene.frame, (double)sb_v3_norm(v.scene.force),
               1e3 * v.step_seconds,
               !set->play  ? ""
               : v.differs ? " played=other bits"
               : v.playing ? " played=in part"
                           : " played=same bits");
    SDL_DestroyRenderer(v.renderer);
    SDL_DestroyWindow(v.window);
    SDL_Quit();
    free(v.vertices);
    free(v.normals);
    free(v.triangles);
    free(v.indices);
    viewer_free(&v.scene);
    return status ? status : v.differs ? EXIT_DIFFERS : 0;
}

static int check_settings(const settings *set)
{
    if (!strchr("xyz", set->side[0]) || !set->side[0] || (set->side[1] != '-' && set->side[1] != '+') || set->side[2])
        return options_complain("viewer", "--hold", "needs x-, x+, y-, y+, z- or z+");
    if (set->picture && !set->frames)
        return options_complain("viewer", "--picture", "needs --frames");
    return organ_check_name("viewer", "--record", set->record) && organ_check_name("viewer", "--play", set->play) &&
           organ_check_name("viewer", "--picture", set->picture);
}

int main(int argc, char **argv)
{
    settings s = {NULL, "y+", NULL, NULL, NULL, 1, 0.3, 14, 0, 0};
    const option options[] = {
        {"--scale", "F", OPTION_NUMBER, NULL, &s.scale, NULL, 1e-9, 1e9, "lengths in ORGAN times F are metres"},
        {"--cells", "N", OPTION_INTEGER, &s.cells, NULL, NULL, 2, 60, "of the organ that is made, along it"},
        {"--hold", "SIDE", OPTION_TEXT, NULL, NULL, &s.side, 0, 0, "x-, x+, y-, y+, z- or z+: where the organ is held"},
        {"--share", "P", OPTION_NUMBER, NULL, &s.share, NULL, 0.001, 0.9, "of its length that is held there"},
        {"--record", "FILE", OPTION_TEXT, NULL, NULL, &s.record, 0, 0,
         "records a session, from the start on (with --play: of what is played)"},
        {"--play", "FILE", OPTION_TEXT, NULL, NULL, &s.play, 0, 0, "plays a session"},
        {"--frames", "N", OPTION_INTEGER, &s.frames, NULL, NULL, 1, 1e6, "ends after N frames, as fast as they go"},
        {"--picture", "FILE", OPTION_TEXT, NULL, NULL, &s.picture, 0, 0, "the last of them (PNG)"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("viewer", options, count, &s.mesh, 1, argc, argv))
        return ORGAN_USAGE;
    if (s.help) {
        printf(
            "usage: viewer [ORGAN] [OPTIONS]\n\nShows an organ that hangs at one side (VTK, VTU, gmsh, Medit, TetGen, "
            "in metres; without a file one is\nmade), coloured by its von Mises stress, in a window.\n\n");
        options_print(options, count);
        printf("\nButtons and keys:\n");
        for (size_t i = 0; i < sizeof keys / sizeof keys[0]; i++)
            printf("  %s\n", keys[i]);
        printf("\nThe last line: frames, the force on the hand at the end, the mean time of the last steps, and of a "
               "session that was\nplayed whether it ended with the same bits.\n");
        return finish("viewer", 0, 0);
    }
    return check_settings(&s) ? finish("viewer", run(&s), ORGAN_USAGE) : ORGAN_USAGE;
}
