/* case_foreign: what case files and the input files of other solvers call the same thing. One table for each kind of
 * thing; readers and writers share them. Include case_reader.h first. */
#ifndef CASE_FOREIGN_H
#define CASE_FOREIGN_H

#include "case_reader.h"

#include <math.h>

/* ---- elements ------------------------------------------------------------------------------------------- */

/* Node orders of these are the same here and there, but for hex27: see foreign_feb_place. */
typedef struct foreign_element {
    sb_element_type type;
    const char *inp;      /* Abaqus, CalculiX; NULL: they have none */
    const char *feb;      /* FEBio */
    const char *feb_face; /* of its faces there */
} foreign_element;

static const foreign_element foreign_elements[] = {{SB_TET4, "C3D4", "tet4", "tri3"},
                                                   {SB_TET10, "C3D10", "tet10", "tri6"},
                                                   {SB_HEX8, "C3D8", "hex8", "quad4"},
                                                   {SB_HEX20, "C3D20", "hex20", "quad8"},
                                                   {SB_HEX27, NULL, "hex27", "quad9"}};
enum { FOREIGN_ELEMENT_COUNT = (int)(sizeof foreign_elements / sizeof foreign_elements[0]) };

/* Elements of fewer dimensions, which meshers write for named surfaces and lines. */
static const char *const foreign_flat_elements[] = {"CPS3",   "CPS4",   "CPS6", "CPS8", "CPE3", "CPE4",   "CPE6",
                                                    "CPE8",   "S3",     "S4",   "S6",   "S8",   "S8R",    "STRI3",
                                                    "STRI65", "M3D3",   "M3D4", "M3D6", "M3D8", "SFM3D3", "SFM3D4",
                                                    "SFM3D6", "SFM3D8", "T3D2", "T3D3", "B31",  "B32"};
enum { FOREIGN_FLAT_COUNT = (int)(sizeof foreign_flat_elements / sizeof foreign_flat_elements[0]) };

/* The element that the input file calls so; NULL: there is none here. */
static inline const foreign_element *foreign_find_element(const char *inp)
{
    for (int i = 0; i < FOREIGN_ELEMENT_COUNT; i++)
        if (foreign_elements[i].inp && strcmp(foreign_elements[i].inp, inp) == 0)
            return foreign_elements + i;
    return NULL;
}

/* Where FEBio's node number `place` of an element is here, both from 0: its hex27 has the middles of the faces y-, x+,
 * y+, x-, z-, z+ where this library has x-, x+, y-, y+, z-, z+. */
static inline int foreign_feb_place(sb_element_type type, int place)
{
    static const signed char middles[4] = {22, 21, 23, 20};
    return type == SB_HEX27 && place >= 20 && place < 24 ? middles[place - 20] : place;
}

static inline const foreign_element *foreign_element_of(sb_element_type type)
{
    for (int i = 0; i < FOREIGN_ELEMENT_COUNT; i++)
        if (foreign_elements[i].type == type)
            return foreign_elements + i;
    return NULL;
}

static inline int foreign_is_flat(const char *inp)
{
    for (int i = 0; i < FOREIGN_FLAT_COUNT; i++)
        if (strcmp(foreign_flat_elements[i], inp) == 0)
            return 1;
    return 0;
}

/* Corners of the faces P1, P2, ... of Abaqus and CalculiX, places in the element from 0. */
static const signed char foreign_tet_faces[4][4] = {{0, 1, 2, -1}, {0, 3, 1, -1}, {1, 3, 2, -1}, {2, 3, 0, -1}};
static const signed char foreign_hex_faces[6][4] = {{0, 1, 2, 3}, {4, 7, 6, 5}, {0, 4, 5, 1},
                                                    {1, 5, 6, 2}, {2, 6, 7, 3}, {3, 7, 4, 0}};

static inline int foreign_face_count(sb_element_type type) { return sb_element_corner_count(type) == 8 ? 6 : 4; }

/* This library's number of the face that Abaqus counts as `face` (from 0): the one with the same corners. */
static inline int foreign_face(sb_element_type type, int face)
{
    const signed char *corners = sb_element_corner_count(type) == 8 ? foreign_hex_faces[face] : foreign_tet_faces[face];
    for (int own = 0; own < sb_element_face_count(type); own++) {
        sb_element_type face_type;
        int local[SB_MAX_FACE_NODES], common = 0, count;
        sb_element_face(type, own, local, &face_type);
        count = sb_element_corner_count(face_type);
        for (int i = 0; i < count; i++)
            for (int k = 0; k < count; k++)
                common += local[i] == corners[k];
        if (common == count)
            return own;
    }
    return -1;
}

/* The other way round. */
static inline int foreign_face_of(sb_element_type type, int own)
{
    for (int face = 0; face < foreign_face_count(type); face++)
        if (foreign_face(type, face) == own)
            return face;
    return -1;
}

/* ---- materials ------------------------------------------------------------------------------------------ */

/* A kind of *HYPERELASTIC: its constants in order, as options of the case file's material. */
typedef struct foreign_law {
    const char *inp; /* parameter, blanks left out */
    int terms;       /* N=; 0: without */
    const char *model;
    int constants; /* before the D1 .. DN */
    case_key keys[3];
} foreign_law;

static const foreign_law foreign_laws[] = {
    {"NEOHOOKE", 0, "neo_hookean", 1, {CASE_C10, CASE_C10, CASE_C10}},
    {"REDUCEDPOLYNOMIAL", 1, "neo_hookean", 1, {CASE_C10, CASE_C10, CASE_C10}},
    {"MOONEY-RIVLIN", 0, "mooney_rivlin", 2, {CASE_C10, CASE_C01, CASE_C01}},
    {"POLYNOMIAL", 1, "mooney_rivlin", 2, {CASE_C10, CASE_C01, CASE_C01}},
    {"REDUCEDPOLYNOMIAL", 2, "reduced_polynomial", 2, {CASE_C10, CASE_C20, CASE_C20}},
    {"REDUCEDPOLYNOMIAL", 3, "reduced_polynomial", 3, {CASE_C10, CASE_C20, CASE_C30}},
    {"YEOH", 0, "reduced_polynomial", 3, {CASE_C10, CASE_C20, CASE_C30}},
};
enum { FOREIGN_LAW_COUNT = (int)(sizeof foreign_laws / sizeof foreign_laws[0]) };

/* D1, D2, ... that a law has. */
static inline int foreign_volume_terms(const foreign_law *law)
{
    return law->terms > 0 ? law->terms : strcmp(law->inp, "YEOH") == 0 ? 3 : 1;
}

static inline const foreign_law *foreign_find_law(const char *inp, int terms)
{
    for (int i = 0; i < FOREIGN_LAW_COUNT; i++)
        if (strcmp(foreign_laws[i].inp, inp) == 0 && foreign_laws[i].terms == terms)
            return foreign_laws + i;
    return NULL;
}

/* A material of FEBio: its constants as options of the case file's material. Laws with a volume term are uncoupled ones
 * with the bulk modulus k = 2/D1 and the pressure model of foreign_feb_pressure. */
typedef struct foreign_feb_law {
    const char *feb, *model;
    int is_uncoupled;
    int constants;
    struct {
        const char *name;
        case_key key;
    } constant[3];
} foreign_feb_law;

static const foreign_feb_law foreign_feb_laws[] = {
    {"isotropic elastic", "svk", 0, 2, {{"E", CASE_E}, {"v", CASE_NU}, {"", CASE_E}}},
    {"neo-Hookean", "neo_hookean", 0, 2, {{"E", CASE_E}, {"v", CASE_NU}, {"", CASE_E}}},
    {"Mooney-Rivlin", "neo_hookean", 1, 1, {{"c1", CASE_C10}, {"", CASE_E}, {"", CASE_E}}},
    {"Mooney-Rivlin", "mooney_rivlin", 1, 2, {{"c1", CASE_C10}, {"c2", CASE_C01}, {"", CASE_E}}},
    {"Yeoh", "reduced_polynomial", 1, 2, {{"c1", CASE_C10}, {"c2", CASE_C20}, {"", CASE_E}}},
    {"Yeoh", "reduced_polynomial", 1, 3, {{"c1", CASE_C10}, {"c2", CASE_C20}, {"c3", CASE_C30}}},
};
enum { FOREIGN_FEB_YEOH = 6 }; /* constants c1, c2, ... of Yeoh there; here are the first three */
enum { FOREIGN_FEB_LAW_COUNT = (int)(sizeof foreign_feb_laws / sizeof foreign_feb_laws[0]) };

/* Which of FEBio's terms of volume is k/2 (J - 1)^2, as here; its default is k/2 (ln J)^2. */
static const char foreign_feb_pressure[] = "Abaqus";

/* ---- names ---------------------------------------------------------------------------------------------- */

/* Whether the name of a file ends in `.ending`, in small or capital letters. */
static inline int foreign_ends_in(const char *path, const char *ending)
{
    size_t length = strlen(path), count = strlen(ending);
    int ok = length > count + 1 && path[length - count - 1] == '.';
    for (size_t i = 0; i < count && ok; i++) {
        char letter = path[length - count + i];
        ok = (letter >= 'A' && letter <= 'Z' ? letter - 'A' + 'a' : letter) == ending[i];
    }
    return ok;
}

/* Says what is no part of a model, so that files go without it. */
static inline void foreign_note_left_out(case_file *c)
{
    for (int i = 0; i < c->statement_count; i++) {
        const case_statement *s = c->statements + i;
        if (s->form->kind == CASE_EXPECT)
            case_add_message(&c->notes, c->path, s->line, "expect probe is left out: the file cannot say it");
        if (s->given & (CASE_BIT(CASE_ITERATIONS) | CASE_BIT(CASE_NEWTON)))
            case_add_message(&c->notes, c->path, s->line, "the most iterations are left out: solvers have their own");
    }
}

/* ---- numbers -------------------------------------------------------------------------------------------- */

/* The fewest digits that are read as the same number again. */
static inline const char *foreign_print_shortest(char text[32], double value)
{
    for (int precision = 15; precision <= 17; precision++) {
        snprintf(text, 32, "%.*g", precision, value);
        if (strtod(text, NULL) == value)
            break;
    }
    return text;
}

/* The other one of D1 and k = 2/D1: of the numbers about it one that leads back to the same, where there is one. */
static inline double foreign_other_modulus(double value)
{
    double first = 2 / value, down = first, up = first;
    for (int i = 0; i < 3; i++) {
        if (2 / down == value)
            return down;
        if (2 / up == value)
            return up;
        down = nextafter(down, 0);
        up = nextafter(up, HUGE_VAL);
    }
    return first;
}

/* Input files of soft bodies count forces in 1e-4 N and masses in 1e-4 kg: CalculiX takes forces out of balance below
 * 1e-6 of its unit for 0. This comment says so; readers turn numbers back by their decimal exponents, without a change
 * of their bits. */
static const char foreign_units[] = "units: m, s, force 1e-4 N, mass 1e-4 kg";
enum { FOREIGN_UNIT = 4 };

/* A decimal number in parts: digits x 10^exponent. */
typedef struct foreign_decimal {
    unsigned long long digits; /* of the first 19 */
    int count, exponent, negative;
    int length; /* characters of sign, digits and point */
} foreign_decimal;

/* Takes text apart: 1.5, .5, 15E-1, 15D-1 (Fortran) or 15-1 (an exponent in few columns). */
static inline int foreign_split_number(const char *text, foreign_decimal *d)
{
    int at, point = -1, exponent = 0;
    memset(d, 0, sizeof *d);
    d->negative = text[0] == '-';
    for (at = d->negative || text[0] == '+'; (text[at] >= '0' && text[at] <= '9') || (text[at] == '.' && point < 0);
         at++) {
        if (text[at] == '.')
            point = at + 1;
        else if (d->count++ < 19)
            d->digits = 10 * d->digits + (unsigned long long)(text[at] - '0');
    }
    d->length = at;
    if (d->count == 0)
        return 0;
    if (text[at] && strchr("eEdD", text[at]))
        at++;
    else if (text[at] && text[at] != '-' && text[at] != '+')
        return 0;
    if (d->length < at && !text[at])
        return 0;
    if (text[at] && (!case_scan_integer(text + at, &exponent) || exponent > 9999 || exponent < -9999))
        return 0;
    d->exponent = exponent - (point < 0 ? 0 : d->length - point);
    return 1;
}

/* The decimal number `text` times 10^shift, correctly rounded; 1, or 0 when it is no finite number. */
static inline int foreign_scan_number(const char *text, int shift, double *value)
{
    static const double powers[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    foreign_decimal d;
    double number;
    if (!foreign_split_number(text, &d))
        return 0;
    d.exponent += shift;
    if (d.count < 16 && d.exponent > -23 && d.exponent < 23) { /* both exact, so the one operation rounds correctly */
        number = d.exponent < 0 ? (double)d.digits / powers[-d.exponent] : (double)d.digits * powers[d.exponent];
        number = d.negative ? -number : number;
    } else {
        char word[96], *end = word;
        if (d.length > 64)
            return 0;
        for (int i = 0; i < d.length; i++)
            if (text[i] != '.')
                *end++ = text[i];
        snprintf(end, 16, "e%d", d.exponent);
        number = strtod(word, NULL);
    }
    if (!sb_is_finite((sb_real)number))
        return 0;
    *value = number;
    return 1;
}

/* What a number is, for foreign_print_number. */
typedef enum foreign_quantity {
    FOREIGN_PLACE,   /* a coordinate, displacement or force: what is beyond 1e-19 of its unit is noise */
    FOREIGN_CONSTANT /* every digit counts, however small it is */
} foreign_quantity;

static inline int foreign_needs_exponent(int exponent, foreign_quantity quantity)
{
    return exponent > 16 || exponent < -22 || (quantity == FOREIGN_CONSTANT && exponent < -8);
}

/* The number times 10^shift as text that foreign_scan_number(..., -shift) turns into the same bits again. CalculiX
 * reads the first 20 characters of a number: an exponent behind them would be lost, digits there do no harm. So numbers
 * have no exponent, but for small constants, whose exponent is within 20 characters. */
static inline const char *foreign_print_number(char text[48], double value, int shift, foreign_quantity quantity)
{
    char digits[48], *mark, *at = text;
    int exponent, count, is_short;
    if (value == 0)
        return strcpy(text, "0");
    for (int precision = 14; precision < 17; precision++) {
        snprintf(digits, sizeof digits, "%.*e", precision, fabs(value));
        if (strtod(digits, NULL) == fabs(value))
            break;
    }
    is_short = foreign_needs_exponent((int)strtol(strchr(digits, 'e') + 1, NULL, 10) + shift, quantity);
    if (is_short && value < 0)
        snprintf(digits, sizeof digits, "%.15e", -value);
    mark = strchr(digits, 'e');
    exponent = (int)strtol(mark + 1, NULL, 10) + shift;
    *mark = 0;
    memmove(digits + 1, digits + 2, strlen(digits + 2) + 1); /* without the point */
    for (count = (int)strlen(digits); count > 1 && digits[count - 1] == '0'; count--)
        digits[count - 1] = 0;
    if (value < 0)
        *at++ = '-';
    if (is_short) {
        snprintf(at, 40, "%.17s%s%+d", digits, count > 13 ? "" : "e", exponent - count + 1);
    } else if (exponent < 0) {
        snprintf(at, 46, "0.%.*s%.17s", -exponent - 1, "0000000000000000000000", digits);
    } else {
        for (int i = 0; i <= exponent || i < count; i++) {
            if (i == exponent + 1)
                *at++ = '.';
            *at++ = i < count ? digits[i] : '0';
        }
        *at = 0;
    }
    return text;
}

#endif /* CASE_FOREIGN_H */
