/* identify_case.h: moduli of a case's regions from what was measured of it. Include it after system.h and softbody.h.
 *
 *     CASE         a case, or a model of what case_open reads: the body, its loads and supports, a static solve; E and
 *                  nu are where the search starts
 *     READINGS     what was read of it, a line each; # starts a comment:
 *         NODE UX UY UZ                     displacement of a node (m), as case_solve writes it; nan: not read
 *         sigma S                           standard deviation of each coordinate (m)
 *         force NODES.txt FX FY FZ SIGMA    what supports at these nodes, a list beside the case, push with together
 *                                           (N); nan: not read
 *
 * Several states are several cases of one mesh, each with its readings. */
#ifndef IDENTIFY_CASE_H
#define IDENTIFY_CASE_H

#include "case_msml.h"

enum { IDENTIFY_STATES = 16, IDENTIFY_VALUES = 8 };

/* What was read of a state. */
typedef struct identify_readings {
    case_file file;
    const char *path;
    sb_measurement seen;
    sb_mapping rows;
    inp_map map;         /* of the mesh's numbers, where the file has some */
    inp_list nodes;      /* int: of the readings */
    inp_list points;     /* sb_vec3: displacements, then places (m) */
    inp_list force_list; /* int */
    int *starts;         /* [readings + 1] 0, 1, 2 ... */
    sb_real *weights;    /* 1 */
} identify_readings;

typedef struct identify_cases {
    identify_readings states[IDENTIFY_STATES];
    int state_count;
    sb_body *body;
    int *all;      /* [nodes] 0, 1, 2 ... */
    int *load_ids; /* pressures and springs that the body has now */
    int load_count;
    sb_parameter parameters[IDENTIFY_VALUES];
    sb_real values[IDENTIFY_VALUES];
    int count;
    char message[900]; /* what is wrong */
} identify_cases;

static inline int identify_fail(identify_cases *all, const char *path, int line, const char *what)
{
    if (line > 0)
        snprintf(all->message, sizeof all->message, "%.300s:%d: %.500s", path, line, what);
    else
        snprintf(all->message, sizeof all->message, "%.300s: %.500s", path, what);
    return 0;
}

/* What the library, or a reader, says of a case; "" where that is nothing: memory is short. */
static inline int identify_fail_case(identify_cases *all, const identify_readings *r)
{
    const case_file *c = &r->file;
    return identify_fail(all, r->path, c->error_line, c->message[0] ? c->message : "out of memory");
}

/* ---- readings ---------------------------------------------------------------------------------------------------- */

static inline int identify_add(inp_list *list, const void *item, size_t size)
{
    if (!case_reserve(&list->items, list->count, &list->capacity, size))
        return 0;
    memcpy((char *)list->items + (size_t)list->count++ * size, item, size);
    return 1;
}

/* The node of a number as the files of the case have it; -1: there is none. */
static inline int identify_node(const identify_readings *r, const char *word)
{
    int label;
    if (!word || !case_scan_integer(word, &label))
        return -1;
    if (r->map.pairs)
        return inp_find(&r->map, label);
    return label < r->file.mesh.node_count ? label : -1;
}

/* A number, or nan for what was not read. */
static inline int identify_scan(const char *word, sb_real *value)
{
    double number = 0;
    int is_nan = word && strcmp(word, "nan") == 0;
    if (!word || (!is_nan && !case_scan_number(word, &number)))
        return 0;
    *value = is_nan ? (sb_real)NAN : (sb_real)number;
    return 1;
}

static inline int identify_scan_vector(char **line, sb_vec3 *v)
{
    return identify_scan(case_next_word(line), &v->x) && identify_scan(case_next_word(line), &v->y) &&
           identify_scan(case_next_word(line), &v->z);
}

static inline int identify_scan_sigma(char **line, sb_real *sigma)
{
    return identify_scan(case_next_word(line), sigma) && *sigma > 0;
}

/* The nodes whose supports are read together, from a list as cases have them. */
static inline const char *identify_read_list(identify_readings *r, const char *name)
{
    const char *reason = "the list is empty";
    char *path = case_input_path(&r->file, name), *text = path ? case_read_text(path, &reason) : NULL, *cursor = text;
    char *line, *word;
    int good = text != NULL;
    while (good && (line = case_next_line(&cursor)) != NULL)
        if ((word = case_next_word(&line)) != NULL) {
            int node = identify_node(r, word);
            good = node >= 0 && identify_add(&r->force_list, &node, sizeof node);
            reason = good ? reason : "a line of the list is no node";
        }
    free(path);
    free(text);
    return good && r->force_list.count > 0 ? NULL : reason;
}

/* NULL, or what is wrong with the line. */
static inline const char *identify_take_line(identify_readings *r, char *line)
{
    char *word = case_next_word(&line);
    const char *wrong = NULL;
    if (!word)
        return NULL;
    if (strcmp(word, "sigma") == 0) {
        wrong = identify_scan_sigma(&line, &r->seen.sigma_point) ? NULL : "sigma needs metres > 0";
    } else if (strcmp(word, "force") == 0) {
        char *list = case_next_word(&line);
        if (r->seen.force_count)
            return "there is a force already";
        if (!list || !identify_scan_vector(&line, &r->seen.force) || !identify_scan_sigma(&line, &r->seen.sigma_force))
            return "a force is NODES.txt FX FY FZ SIGMA";
        wrong = identify_read_list(r, list);
        r->seen.force_count = r->force_list.count;
    } else {
        int node = identify_node(r, word);
        sb_vec3 u;
        if (node < 0)
            return "the line begins with no node of the mesh";
        if (!identify_scan_vector(&line, &u))
            return "a reading is NODE UX UY UZ";
        if (!identify_add(&r->nodes, &node, sizeof node) || !identify_add(&r->points, &u, sizeof u))
            return "out of memory";
    }
    return wrong ? wrong : case_next_word(&line) ? "the line holds more than it should" : NULL;
}

/* Places of nodes that were read, and the rows that the library follows them by. */
static inline int identify_connect(identify_readings *r)
{
    int count = r->nodes.count;
    sb_vec3 *points = (sb_vec3 *)r->points.items;
    r->starts = (int *)malloc(((size_t)count + 1) * sizeof *r->starts);
    r->weights = (sb_real *)malloc(((size_t)count + 1) * sizeof *r->weights);
    if (!r->starts || !r->weights)
        return 0;
    for (int i = 0; i <= count; i++) {
        r->starts[i] = i;
        r->weights[i] = 1;
    }
    for (int i = 0; i < count; i++)
        points[i] = sb_v3_add(points[i], r->file.mesh.nodes[((const int *)r->nodes.items)[i]]);
    r->rows.row_count = count;
    r->rows.row_start = r->starts;
    r->rows.nodes = (const int *)r->nodes.items;
    r->rows.weights = r->weights;
    r->seen.rows = count ? &r->rows : NULL;
    r->seen.points = points;
    r->seen.force_nodes = (const int *)r->force_list.items;
    return 1;
}

static inline int identify_read_readings(identify_cases *all, identify_readings *r, const char *path)
{
    const char *wrong = "it cannot be read";
    char *text = case_read_text(path, &wrong), *cursor = text, *line;
    int number = 0;
    if (text)
        for (wrong = NULL; !wrong && (line = case_next_line(&cursor)) != NULL; number++)
            wrong = identify_take_line(r, line);
    free(text);
    if (!wrong && r->nodes.count + r->seen.force_count == 0)
        wrong = "it holds no readings", number = 0;
    return wrong ? identify_fail(all, path, number, wrong)
                 : identify_connect(r) || identify_fail(all, path, 0, "out of memory");
}

/* ---- cases ------------------------------------------------------------------------------------------------------- */

/* Numbers of nodes that are the file's own, sorted. */
static inline int identify_make_map(identify_readings *r)
{
    const case_file *c = &r->file;
    size_t count = (size_t)c->mesh.node_count;
    if (!c->node_numbers)
        return 1;
    r->map.pairs = (inp_pair *)malloc(count * sizeof *r->map.pairs);
    if (!r->map.pairs)
        return 0;
    r->map.count = (int)count;
    for (int i = 0; i < r->map.count; i++) {
        r->map.pairs[i].label = c->node_numbers[i];
        r->map.pairs[i].at = i;
    }
    qsort(r->map.pairs, count, sizeof *r->map.pairs, inp_compare_pairs);
    return 1;
}

/* Whether two meshes are the same to the last bit. */
static inline int identify_same_mesh(const sb_mesh *a, const sb_mesh *b)
{
    return a->node_count == b->node_count && a->element_count == b->element_count &&
           a->element_type == b->element_type &&
           memcmp(a->nodes, b->nodes, (size_t)a->node_count * sizeof *a->nodes) == 0 &&
           memcmp(a->elements, b->elements,
                  (size_t)a->element_count * (size_t)sb_mesh_element_width(a) * sizeof *a->elements) == 0;
}

/* Reads a case, and makes its body once to see that its supports suffice. */
static inline int identify_read_case(identify_cases *all, identify_readings *r, const char *path)
{
    sb_body *body = NULL;
    r->path = path;
    if (!case_open(&r->file, path))
        return identify_fail_case(all, r);
    if (r->file.solve->form->code != CASE_STATIC)
        return identify_fail(all, path, r->file.solve->line, "moduli are sought in static solves");
    if (r->file.lattice)
        return identify_fail(all, path, 0, "moduli are not sought in bodies that are cut");
    if (!identify_same_mesh(&all->states[0].file.mesh, &r->file.mesh))
        return identify_fail(all, path, 0, "its mesh is not that of the first case");
    if (!case_create_body(&r->file, &body) || !identify_make_map(r))
        return identify_fail_case(all, r);
    sb_body_destroy(body);
    return 1;
}

/* A case with its readings. */
static inline int identify_add_state(identify_cases *all, const char *path, const char *readings, sb_real sigma)
{
    identify_readings *r;
    if (all->state_count == IDENTIFY_STATES)
        return identify_fail(all, path, 0, "there are too many cases");
    r = all->states + all->state_count++;
    r->seen.sigma_point = sigma;
    return identify_read_case(all, r, path) && identify_read_readings(all, r, readings);
}

/* Takes pressures and springs, and all else of the state before, away. */
static inline sb_result identify_clear(identify_cases *all, sb_body *body)
{
    sb_result result = SB_OK;
    while (all->load_count > 0 && result == SB_OK)
        result = sb_body_remove_load(body, all->load_ids[--all->load_count]);
    sb_body_clear_loads(body);
    sb_body_clear_constraints(body);
    return result == SB_OK ? sb_body_release_nodes(body, all->all, sb_body_node_count(body), SB_XYZ) : result;
}

static inline sb_result identify_press(identify_cases *all, const case_file *c, sb_body *body, sb_error *error)
{
    sb_result result = SB_OK;
    for (int i = 0; i < c->statement_count && result == SB_OK; i++) {
        const case_statement *s = c->statements + i;
        int *id = all->load_ids + all->load_count;
        if (s->form->kind != CASE_PRESSURE && s->form->kind != CASE_SPRING)
            continue;
        result = s->form->kind == CASE_PRESSURE
                     ? sb_body_add_pressure(body, s->faces, s->count, case_face_corners(c),
                                            (sb_real)s->number[CASE_PRESSURE_VALUE], id, error)
                     : sb_body_add_springs(body, s->nodes, s->count, s->stiffness, 0, s->vectors, id, error);
        all->load_count += result == SB_OK;
    }
    return result;
}

/* Loads and supports of a state: sb_identify_def.apply. */
static inline sb_result identify_apply(void *user, int state, const sb_real *free_values, sb_body *body,
                                       sb_error *error)
{
    identify_cases *all = (identify_cases *)user;
    case_file *c = &all->states[state].file;
    sb_result result = identify_clear(all, body);
    (void)free_values;
    if (result == SB_OK)
        result = sb_body_set_gravity(body, case_body_def(c).gravity);
    if (result == SB_OK)
        result = case_add_loads(c, body, CASE_DEAD_LOADS, error);
    if (result == SB_OK)
        result = identify_press(all, c, body, error);
    if (result == SB_OK)
        result = case_move_supports(c, body, 0);
    return result == SB_OK && !case_add_equations(c, body) ? SB_ERROR_ARGUMENT : result;
}

/* ---- what is sought ---------------------------------------------------------------------------------------------- */

/* The material of a region of the case. */
static inline const sb_material *identify_material(const case_file *c, int region)
{
    for (int i = 0; i < c->region_material_count; i++)
        if (c->region_materials[i].region == region)
            return &c->region_materials[i].material;
    return &c->material;
}

static inline int identify_has_region(const sb_mesh *mesh, int region)
{
    for (int e = 0; e < mesh->element_count; e++)
        if ((mesh->regions ? mesh->regions[e] : 0) == region)
            return 1;
    return 0;
}

static inline int identify_add_value(identify_cases *all, sb_parameter_kind kind, int region)
{
    const case_file *c = &all->states[0].file;
    const sb_material *material = identify_material(c, region);
    char words[64];
    snprintf(words, sizeof words, "more than %d values, or region %d twice", (int)IDENTIFY_VALUES, region);
    for (int i = 0; i < all->count; i++)
        if (all->parameters[i].kind == kind && all->parameters[i].region == region)
            return identify_fail(all, all->states[0].path, 0, words);
    if (all->count == IDENTIFY_VALUES)
        return identify_fail(all, all->states[0].path, 0, words);
    snprintf(words, sizeof words, "its mesh has no region %d", region);
    if (!identify_has_region(&c->mesh, region))
        return identify_fail(all, all->states[0].path, 0, words);
    all->parameters[all->count].kind = kind;
    all->parameters[all->count].region = region;
    all->values[all->count++] =
        kind == SB_PARAMETER_YOUNG ? sb_material_young(material) : sb_material_poisson(material);
    return 1;
}

/* Values of the regions in a list like "1,2"; of all for "all". */
static inline int identify_add_values(identify_cases *all, sb_parameter_kind kind, const char *list)
{
    const sb_mesh *mesh = &all->states[0].file.mesh;
    int wants_all = strcmp(list, "all") == 0, good = 1;
    for (int e = 0; wants_all && good && e < mesh->element_count; e++) {
        int region = mesh->regions ? mesh->regions[e] : 0, seen = 0;
        for (int i = 0; i < all->count; i++)
            seen |= all->parameters[i].kind == kind && all->parameters[i].region == region;
        good = seen || identify_add_value(all, kind, region);
    }
    while (!wants_all && good) {
        char *end;
        long region = strtol(list, &end, 10);
        if (end == list || (*end && *end != ',') || region < INT_MIN || region > INT_MAX)
            return identify_fail(all, list, 0, "is no list of regions like 1,2, and not all");
        good = identify_add_value(all, kind, (int)region);
        if (!*end)
            break;
        list = end + 1;
    }
    return good;
}

/* The body of the first case, without loads and supports, and memory of what states add to it. */
static inline int identify_make_body(identify_cases *all)
{
    const case_file *c = &all->states[0].file;
    sb_body_def def = case_body_def(c);
    sb_error error;
    int most = 1;
    for (int k = 0; k < all->state_count; k++)
        most = all->states[k].file.statement_count > most ? all->states[k].file.statement_count : most;
    all->all = (int *)malloc((size_t)c->mesh.node_count * sizeof *all->all);
    all->load_ids = (int *)malloc((size_t)most * sizeof *all->load_ids);
    for (int i = 0; all->all && i < c->mesh.node_count; i++)
        all->all[i] = i;
    if (!all->all || !all->load_ids)
        return identify_fail(all, all->states[0].path, 0, "out of memory");
    return sb_body_create(&def, &all->body, &error) == SB_OK ||
           identify_fail(all, all->states[0].path, 0, error.message);
}

/* Finds all->values; deviations and shares [count]. SB_ERROR_... with the message. */
static inline sb_result identify_solve(identify_cases *all, sb_real *deviations, sb_real *shares,
                                       sb_identify_info *info)
{
    sb_identify_def def = sb_default_identify_def();
    sb_measurement seen[IDENTIFY_STATES];
    sb_error error;
    sb_result result;
    memset(&error, 0, sizeof error);
    for (int k = 0; k < all->state_count; k++)
        seen[k] = all->states[k].seen;
    def.body = all->body;
    def.parameters = all->parameters;
    def.count = all->count;
    def.state_count = all->state_count;
    def.measurements = seen;
    def.apply = identify_apply;
    def.user = all;
    result = sb_identify(&def, all->values, deviations, shares, info, &error);
    if (result != SB_OK)
        identify_fail(all, all->states[0].path, 0, error.message[0] ? error.message : sb_result_string(result));
    return result;
}

static inline void identify_free(identify_cases *all)
{
    for (int k = 0; k < all->state_count; k++) {
        identify_readings *r = all->states + k;
        case_free(&r->file);
        free(r->map.pairs);
        free(r->nodes.items);
        free(r->points.items);
        free(r->force_list.items);
        free(r->starts);
        free(r->weights);
    }
    sb_body_destroy(all->body);
    free(all->all);
    free(all->load_ids);
}

#endif /* IDENTIFY_CASE_H */
