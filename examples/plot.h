/* plot.h: line charts as SVG files, for the examples. Needs softbody.h, libc and libm only.
 *
 *     plot p;
 *     plot_begin(&p, "Relaxation");
 *     plot_panel *panel = plot_add_panel(&p, "stress after a step", "time (s)", "stress (Pa)");
 *     panel->log_x = 1;
 *     plot_add_curve(panel, "Kim et al. 2005", times, stresses, count);
 *     if (!plot_save_svg(&p, "relaxation.svg"))
 *         ...
 *
 * Panels stand side by side, each with axes that fit its curves, a grid at round numbers and the curves' names.
 * Numbers and texts are borrowed until the file is saved. Points that are not finite, or not positive on a
 * logarithmic axis, interrupt a curve. */
#ifndef PLOT_H
#define PLOT_H

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "softbody.h"

enum { PLOT_PANELS = 4, PLOT_CURVES = 8 };
enum { PLOT_PANEL_WIDTH = 560, PLOT_HEIGHT = 478, PLOT_LEFT = 78, PLOT_RIGHT = 22, PLOT_TOP = 92, PLOT_BOTTOM = 62 };

typedef struct plot_curve {
    const char *name;
    const double *x, *y; /* [count] */
    int count;
    int dashed;  /* 1: a broken line */
    int markers; /* 1: a dot at every point */
} plot_curve;

typedef struct plot_panel {
    const char *title, *x_label, *y_label;
    int log_x, log_y;
    const char *const *x_names; /* [x_name_count] for categories: what stands at x = 1, 2 ...; NULL: numbers */
    int x_name_count;
    plot_curve curves[PLOT_CURVES];
    int curve_count;
} plot_panel;

typedef struct plot {
    const char *title;
    plot_panel panels[PLOT_PANELS];
    int panel_count;
} plot;

/* One axis of a panel: `low` to `high` of the (logarithm of the) numbers lie between pixels `from` and `to`. */
typedef struct plot_axis {
    int logarithmic;
    double low, high, from, to;
} plot_axis;

static inline void plot_begin(plot *p, const char *title)
{
    memset(p, 0, sizeof *p);
    p->title = title;
}

/* A new panel to the right of the others; NULL when there are PLOT_PANELS of them. */
static inline plot_panel *plot_add_panel(plot *p, const char *title, const char *x_label, const char *y_label)
{
    plot_panel *panel = p->panels + p->panel_count;
    if (p->panel_count == PLOT_PANELS)
        return NULL;
    p->panel_count++;
    panel->title = title;
    panel->x_label = x_label;
    panel->y_label = y_label;
    return panel;
}

/* Adds a curve; NULL when the panel has PLOT_CURVES of them. */
static inline plot_curve *plot_add_curve(plot_panel *panel, const char *name, const double *x, const double *y,
                                         int count)
{
    plot_curve *curve = panel->curves + panel->curve_count;
    if (panel->curve_count == PLOT_CURVES)
        return NULL;
    panel->curve_count++;
    curve->name = name;
    curve->x = x;
    curve->y = y;
    curve->count = count;
    return curve;
}

/* ---- axes ---- */

static inline double plot_scaled(int logarithmic, double value)
{
    return !logarithmic ? value : value > 0 ? log10(value) : (double)NAN;
}

/* Pixel of a number; not finite when it has no place on the axis. */
static inline double plot_place(const plot_axis *a, double value)
{
    return a->from + (a->to - a->from) * (plot_scaled(a->logarithmic, value) - a->low) / (a->high - a->low);
}

/* The next distance of 1, 2 or 5 times a power of ten that puts at most `most` lines into a range. */
static inline double plot_stride(double range, int most)
{
    double stride = pow(10, floor(log10(range / most)));
    return range / stride <= most       ? stride
           : range / stride <= 2 * most ? 2 * stride
           : range / stride <= 5 * most ? 5 * stride
                                        : 10 * stride;
}

/* An axis over all numbers of a panel, from round number to round number. */
static inline plot_axis plot_make_axis(const plot_panel *panel, int vertical)
{
    plot_axis a;
    double stride;
    a.logarithmic = vertical ? panel->log_y : panel->log_x;
    a.low = HUGE_VAL;
    a.high = -HUGE_VAL;
    a.from = vertical ? PLOT_HEIGHT - PLOT_BOTTOM : PLOT_LEFT;
    a.to = vertical ? PLOT_TOP : PLOT_PANEL_WIDTH - PLOT_RIGHT;
    for (int c = 0; c < panel->curve_count; c++)
        for (int i = 0; i < panel->curves[c].count; i++) {
            double v = plot_scaled(a.logarithmic, (vertical ? panel->curves[c].y : panel->curves[c].x)[i]);
            if (v >= -HUGE_VAL && v <= HUGE_VAL) {
                a.low = fmin(a.low, v);
                a.high = fmax(a.high, v);
            }
        }
    if (!vertical && panel->x_names) {
        a.low = 0.5;
        a.high = panel->x_name_count + 0.5;
        return a;
    }
    if (!(a.high > a.low)) { /* nothing, or one value only */
        double centre = a.high >= a.low ? a.low : 0, reach = centre != 0 ? 0.5 * fabs(centre) : 1;
        a.low = centre - reach;
        a.high = centre + reach;
    }
    for (int i = 0; i < 3; i++) { /* a longer axis may want longer strides */
        stride = a.logarithmic ? 1 : plot_stride(a.high - a.low, 8);
        a.low = stride * floor(a.low / stride + 1e-6);
        a.high = stride * ceil(a.high / stride - 1e-6);
    }
    return a;
}

/* ---- SVG ---- */

/* Text with the characters that SVG keeps for itself written out. */
static inline void plot_write_text(FILE *file, const char *text)
{
    for (; *text; text++) {
        const char *name = *text == '&' ? "&amp;" : *text == '<' ? "&lt;" : *text == '>' ? "&gt;" : NULL;
        if (name)
            fputs(name, file);
        else
            fputc(*text, file);
    }
}

static inline void plot_write_label(FILE *file, double x, double y, const char *style, const char *text)
{
    fprintf(file, "<text x=\"%.1f\" y=\"%.1f\" %s>", x, y, style);
    plot_write_text(file, text);
    fputs("</text>\n", file);
}

static inline void plot_write_line(FILE *file, double x0, double y0, double x1, double y1, const char *colour)
{
    fprintf(file, "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\"/>\n", x0, y0, x1, y1, colour);
}

/* Grid lines and numbers of one axis, and the other's extent. */
static inline void plot_write_grid(FILE *file, const plot_axis *a, const plot_axis *other, int vertical)
{
    double stride = a->logarithmic ? fmax(1, plot_stride(a->high - a->low, 9)) : plot_stride(a->high - a->low, 8);
    int lines = (int)((a->high - a->low) / stride + 1.5);
    for (int i = 0; i < lines; i++) {
        double v = a->low + i * stride, at = a->from + (a->to - a->from) * (v - a->low) / (a->high - a->low);
        char number[40];
        snprintf(number, sizeof number, "%g", a->logarithmic ? pow(10, v) : fabs(v) < 1e-9 * stride ? 0.0 : v);
        if (vertical) {
            plot_write_line(file, other->from, at, other->to, at, "#dde2e8");
            plot_write_label(file, other->from - 8, at + 4, "text-anchor=\"end\"", number);
        } else {
            plot_write_line(file, at, other->from, at, other->to, "#dde2e8");
            plot_write_label(file, at, other->from + 18, "text-anchor=\"middle\"", number);
        }
    }
}

/* Names at 1, 2 ... on the horizontal axis, with lines between. */
static inline void plot_write_categories(FILE *file, const plot_panel *panel, const plot_axis *x, const plot_axis *y)
{
    for (int i = 0; i < panel->x_name_count; i++) {
        double edge = plot_place(x, i + 1.5);
        plot_write_line(file, edge, y->from, edge, y->to, "#dde2e8");
        plot_write_label(file, plot_place(x, i + 1), y->from + 18, "text-anchor=\"middle\"", panel->x_names[i]);
    }
}

/* Okabe and Ito's colours, which also the colour-blind can tell apart. */
static inline const char *plot_colour(int curve)
{
    static const char *const colours[PLOT_CURVES] = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                     "#e69f00", "#56b4e9", "#000000", "#8a6d3b"};
    return colours[curve % PLOT_CURVES];
}

static inline void plot_write_curve(FILE *file, const plot_panel *panel, int index, const plot_axis *x,
                                    const plot_axis *y)
{
    const plot_curve *curve = panel->curves + index;
    int pen_down = 0;
    fprintf(file, "<path fill=\"none\" stroke=\"%s\" stroke-width=\"2\"%s d=\"", plot_colour(index),
            curve->dashed ? " stroke-dasharray=\"6 4\"" : "");
    for (int i = 0; i < curve->count; i++) {
        double px = plot_place(x, curve->x[i]), py = plot_place(y, curve->y[i]);
        int drawn = px - px == 0 && py - py == 0;
        if (drawn)
            fprintf(file, "%c%.2f %.2f ", pen_down ? 'L' : 'M', px, py);
        pen_down = drawn;
    }
    fputs("\"/>\n", file);
    for (int i = 0; curve->markers && i < curve->count; i++) {
        double px = plot_place(x, curve->x[i]), py = plot_place(y, curve->y[i]);
        if (px - px == 0 && py - py == 0)
            fprintf(file, "<circle cx=\"%.2f\" cy=\"%.2f\" r=\"3\" fill=\"%s\"/>\n", px, py, plot_colour(index));
    }
}

/* The curves' names in two columns above the axes. */
static inline void plot_write_names(FILE *file, const plot_panel *panel)
{
    for (int c = 0; c < panel->curve_count; c++) {
        double x = PLOT_LEFT + (c % 2) * ((PLOT_PANEL_WIDTH - PLOT_LEFT - PLOT_RIGHT) / 2);
        double y = PLOT_TOP - 12 - 16 * ((panel->curve_count - 1) / 2 - c / 2);
        fprintf(file, "<path stroke=\"%s\" stroke-width=\"2\"%s d=\"M%.1f %.1f h22\"/>\n", plot_colour(c),
                panel->curves[c].dashed ? " stroke-dasharray=\"6 4\"" : "", x, y - 4);
        plot_write_label(file, x + 28, y, "", panel->curves[c].name);
    }
}

static inline void plot_write_panel(FILE *file, const plot_panel *panel, int place)
{
    plot_axis x = plot_make_axis(panel, 0), y = plot_make_axis(panel, 1);
    char turned[80];
    fprintf(file, "<g transform=\"translate(%d 30)\">\n", place * PLOT_PANEL_WIDTH);
    if (panel->x_names)
        plot_write_categories(file, panel, &x, &y);
    else
        plot_write_grid(file, &x, &y, 0);
    plot_write_grid(file, &y, &x, 1);
    plot_write_line(file, x.from, y.from, x.to, y.from, "#2c3440");
    plot_write_line(file, x.from, y.from, x.from, y.to, "#2c3440");
    for (int c = 0; c < panel->curve_count; c++)
        plot_write_curve(file, panel, c, &x, &y);
    plot_write_names(file, panel);
    plot_write_label(file, PLOT_LEFT, 12, "font-weight=\"bold\"", panel->title);
    plot_write_label(file, 0.5 * (x.from + x.to), PLOT_HEIGHT - 16, "text-anchor=\"middle\"", panel->x_label);
    snprintf(turned, sizeof turned, "text-anchor=\"middle\" transform=\"rotate(-90 18 %.0f)\"", 0.5 * (y.from + y.to));
    plot_write_label(file, 18, 0.5 * (y.from + y.to), turned, panel->y_label);
    fputs("</g>\n", file);
}

/* Writes the chart; 1, or 0 when the file cannot be written (then one that was there is what it was). */
static inline int plot_save_svg(const plot *p, const char *path)
{
    int width = PLOT_PANEL_WIDTH * (p->panel_count > 0 ? p->panel_count : 1);
    sb_output out;
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return 0;
    fprintf(out.file,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\" "
            "font-family=\"sans-serif\" font-size=\"12\" fill=\"#2c3440\">\n"
            "<rect width=\"100%%\" height=\"100%%\" fill=\"white\"/>\n",
            width, PLOT_HEIGHT + 36, width, PLOT_HEIGHT + 36);
    plot_write_label(out.file, PLOT_LEFT, 24, "font-size=\"17\" font-weight=\"bold\"", p->title);
    for (int i = 0; i < p->panel_count; i++)
        plot_write_panel(out.file, p->panels + i, i);
    fputs("</svg>\n", out.file);
    return sb_output_close(&out, NULL) == SB_OK;
}

#endif /* PLOT_H */
