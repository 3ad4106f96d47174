/* meshio_reader: what all mesh formats share, internal. A bounded reader that counts lines, exact number
 * parsing, and the loader that gathers nodes and cells of any kind. Part of the room meshio. */
#ifndef SB_MESHIO_READER_H
#define SB_MESHIO_READER_H

#include "meshio.h"

#include "../base/input.h"
#include "../base/output.h"
#include "../base/sort.h"

/* ---- numbers ---------------------------------------------------------------------------------------
 * strtod obeys the locale: where the decimal point is a comma it reads "0.5" as 0 and stops. These do not;
 * and all `length` characters must belong to the number. Both return 1, 0 (not a number) or -1. */

/* [+-]digits; -1: does not fit. */
SBI_API int sbi_parse_integer(const char *text, size_t length, int64_t *value);
/* [+-]digits[.digits][e[+-]digits], rounded correctly; -1: nan or infinite, as a word or by overflow. */
SBI_API int sbi_parse_real(const char *text, size_t length, double *value);

/* ---- reader ------------------------------------------------------------------------------------------- */

typedef struct sbi_reader {
    const char *data;
    size_t size;
    size_t at;         /* next byte, <= size */
    int line;          /* line of data[at], from 1 */
    int binary;        /* errors give the byte offset instead of the line */
    int big_endian;    /* byte order of the binary numbers */
    char comment;      /* character that starts a comment to the end of the line, or 0 */
    int continuation;  /* 1: a backslash at the end of a line joins the next one */
    int node, element; /* what is being read, for errors; -1: nothing */
    const char *name;  /* of the file */
    sb_error *error;
} sbi_reader;

/* A word of the file: characters up to the next blank. */
typedef struct sbi_word {
    const char *text;
    size_t length;
} sbi_word;

SBI_API void sbi_reader_init(sbi_reader *reader, const void *data, size_t size, const char *name, sb_error *error);
/* Fills the reader's error with file, line or byte offset, node and element; returns result. */
SBI_API sb_result sbi_reader_fail(const sbi_reader *reader, sb_result result, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;

/* SB_ERROR_UNSUPPORTED with what the file is, when it begins as no mesh, cloud or image does but as files do that take
 * their place: packed, a web page, a pointer of git LFS, UTF-16. A binary STL file may begin with anything: not for
 * these. */
SBI_API sb_result sbi_reader_check_kind(const sbi_reader *reader);

/* To be called where text begins that goes on to the end: forgives one NUL at the end, as programs write that know
 * strings by it; any other is an error with its line. */
SBI_API sb_result sbi_reader_check_text(sbi_reader *reader);

SB_INLINE size_t sbi_reader_left(const sbi_reader *reader) { return reader->size - reader->at; }
/* Steps over blanks; 1 when the line or the file ends here. */
SBI_API int sbi_reader_at_line_end(sbi_reader *reader);
/* Steps over the rest of the line. */
SBI_API void sbi_reader_next_line(sbi_reader *reader);
/* The next word, on this line or on a later one; 0 at the end of the file. */
SBI_API int sbi_reader_word(sbi_reader *reader, sbi_word *word);
/* The next word on this line; 0 at its end. */
SBI_API int sbi_reader_line_word(sbi_reader *reader, sbi_word *word);
/* sbi_reader_word without moving. */
SBI_API int sbi_reader_peek(const sbi_reader *reader, sbi_word *word);
/* 1 when the word is `text`, whatever the case of its letters. */
SBI_API int sbi_word_is(sbi_word word, const char *text);
/* The word as a string for messages, cut to the buffer, strange characters replaced; returns buffer. */
SBI_API SBI_NOINLINE const char *sbi_word_print(sbi_word word, char buffer[32]);

/* The next word as a number; `what` names it in errors. */
SBI_API sb_result sbi_reader_integer(sbi_reader *reader, const char *what, int64_t *value);
SBI_API sb_result sbi_reader_real(sbi_reader *reader, const char *what, double *value);
/* A number of things that take at least `bytes` bytes each of what is left of the file: more than fit is
 * an error, so that memory may be taken for them. bytes 0: unchecked. At most INT_MAX. */
SBI_API sb_result sbi_reader_count(sbi_reader *reader, const char *what, size_t bytes, int *count);
SBI_API sb_result sbi_reader_check_count(const sbi_reader *reader, const char *what, int64_t value, size_t bytes,
                                         int *count);
/* Steps over `count` words. */
SBI_API sb_result sbi_reader_skip_words(sbi_reader *reader, size_t count, const char *what);

/* The next `count` * `size` bytes, or NULL with an error when there are fewer. */
SBI_API const unsigned char *sbi_reader_bytes(sbi_reader *reader, size_t count, size_t size, const char *what);
/* Binary numbers in the reader's byte order. */
SBI_API uint64_t sbi_decode_bits(const sbi_reader *reader, const unsigned char *bytes, int size);
SBI_API int64_t sbi_decode_signed(const sbi_reader *reader, const unsigned char *bytes, int size);
SBI_API double sbi_decode_float(const sbi_reader *reader, const unsigned char *bytes, int size);

/* ---- XML (meshio_xml) ------------------------------------------------------------------------------
 * Elements and attributes as they stand in the file, one after the other: no entities, no document type definitions
 * (which is where XML files hide what unfolds into gigabytes), no CDATA. */
enum { SBI_XML_DEPTH = 64, SBI_XML_ATTRIBUTES = 32 };

typedef enum sbi_xml_event {
    SBI_XML_START = 0, /* <name ...>; <name .../> is a start and then an end */
    SBI_XML_STOP = 1,  /* </name> */
    SBI_XML_END = 2    /* of the file */
} sbi_xml_event;

typedef struct sbi_xml {
    sbi_reader *reader; /* behind the tag: at an element's text */
    sbi_xml_event event;
    sbi_word name;
    int attribute_count;
    sbi_word attributes[SBI_XML_ATTRIBUTES], values[SBI_XML_ATTRIBUTES];
    int depth;
    sbi_word open[SBI_XML_DEPTH]; /* names of the elements that are open */
    int stop_next;                /* the element just begun ends at once */
} sbi_xml;

/* Steps to the next tag. Tags must be closed in order. */
SBI_API sb_result sbi_xml_next(sbi_xml *xml);
/* An attribute of the element just begun; 0: it has none of that name. */
SBI_API int sbi_xml_attribute(const sbi_xml *xml, const char *name, sbi_word *value);
/* 1 when the word is `text`, case and all. */
SBI_API int sbi_word_equals(sbi_word word, const char *text);

/* ---- cells ---------------------------------------------------------------------------------------- */

/* Rows of the table of cell kinds that the code names; the others are found by a format's own number. */
enum { SBI_CELL_TRI3 = 0, SBI_CELL_QUAD4 = 1, SBI_CELL_TET4 = 2, SBI_CELL_TET10 = 3, SBI_CELL_KINDS = 55 };

/* How a format lists the nodes of a cell, against ours (VTK's). */
typedef enum sbi_node_order {
    SBI_ORDER_SAME = 0,
    SBI_ORDER_PIXEL = 1, /* VTK's pixel: rows instead of round */
    SBI_ORDER_VOXEL = 2,
    SBI_ORDER_GMSH_TET10 = 3, /* the last two mid-edge nodes exchanged */
    SBI_ORDER_GMSH_HEX = 4,   /* hex20 and hex27: edges by their lower corner, faces z- y- x- x+ y+ z+ */
    SBI_ORDER_GMSH_WEDGE = 5, /* wedge15 and wedge18, pyramid13 and pyramid14: edges by their lower corner */
    SBI_ORDER_GMSH_PYRAMID = 6
} sbi_node_order;

/* Volume cells that can be cut into tets. */
typedef enum sbi_cell_shape {
    SBI_SHAPE_NONE = 0,
    SBI_SHAPE_TET = 1,
    SBI_SHAPE_PYRAMID = 2,
    SBI_SHAPE_WEDGE = 3,
    SBI_SHAPE_HEX = 4
} sbi_cell_shape;

/* A kind of cell that some format knows. New element types: fill in `type` (and the order, if it is not
 * VTK's). */
typedef struct sbi_cell_kind {
    char name[24];
    sb_element_type type; /* SB_NO_ELEMENT: this library has no such element */
    int dimension;
    int nodes;     /* 0: any number */
    int vtk, gmsh; /* number of the kind in these formats; -1: none */
    sbi_node_order vtk_order, gmsh_order;
    sbi_cell_shape shape;
} sbi_cell_kind;
SBI_API const sbi_cell_kind *sbi_cell_kind_at(int kind);
/* Row of a format's number, or -1. */
SBI_API int sbi_cell_kind_of_vtk(int64_t number);
SBI_API int sbi_cell_kind_of_gmsh(int64_t number);

/* ---- loader --------------------------------------------------------------------------------------- */

/* A cell that may become an element; its nodes lie in `indices`, one cell after the other. */
typedef struct sbi_cell {
    int kind;
    int source; /* its number in the file; several triangles may come from one polygon */
    int region;
    int groups; /* where its list of groups begins in loader->groups; 0: none */
} sbi_cell;

/* A name that the file gives to a group of cells. */
typedef struct sbi_group_name {
    int dimension; /* of the cells; -1: any */
    int number;
    char text[SB_MESH_SET_NAME];
} sbi_group_name;

/* A node on the diagonal between two corners. */
typedef struct sbi_diagonal_node {
    int low, high, node;
} sbi_diagonal_node;

/* A label image being read. */
typedef struct sbi_voxels {
    int points[3]; /* of the file along each axis; 0: not read yet */
    int counts[3]; /* voxels */
    double origin[3], spacing[3];
    double direction[3][3]; /* [axis] its vector */
    int *labels;            /* NULL: none read yet */
} sbi_voxels;

typedef enum sbi_voxel_encoding {
    SBI_VOXELS_RAW = 0,
    SBI_VOXELS_TEXT = 1,
    SBI_VOXELS_ZLIB = 2,
    SBI_VOXELS_GZIP = 3
} sbi_voxel_encoding;

/* How a header describes the voxels. */
typedef struct sbi_voxel_data {
    char class_; /* i signed, u unsigned, f floating; 0: not given */
    int size;    /* bytes of a value */
    int big_endian;
    sbi_voxel_encoding encoding;
    int has_file;
    sbi_word file;       /* where the voxels are, when has_file; beside the header */
    size_t offset;       /* bytes before the voxels of what is unpacked, 0: the reader stands there */
    double slope, shift; /* of values, label = shift + slope value; slope 0: labels are the values */
} sbi_voxel_data;

/* Everything gathered from a file. */
typedef struct sbi_loader {
    sbi_reader reader;
    sbi_voxels *voxels; /* an image is wanted and this is where it goes; NULL: a mesh is */
    sb_allocator allocator;
    double scale;
    sb_vec3 *nodes;
    size_t node_count, node_capacity;
    int *indices;
    size_t index_count, index_capacity;
    sbi_cell *cells; /* surface and volume cells of supported types; points and lines when keep_low */
    size_t cell_count, cell_capacity;
    int points_only;  /* PLY: faces are stepped over, normals of vertices wanted */
    sb_vec3 *normals; /* [node_count] as they are in the file, or NULL */
    size_t normal_count, normal_capacity;
    int *scratch; /* nodes of the cell being read */
    size_t scratch_count, scratch_capacity;
    int *source_regions; /* [source_count] regions by number in the file, or NULL: see sbi_cell */
    int source_count;    /* cells met in the file */
    int kind_count[SBI_CELL_KINDS];
    int kind_line[SBI_CELL_KINDS]; /* where the kind was met first */
    int kind_first[SBI_CELL_KINDS];
    int split_polygons, merged_vertices, skipped_cells;
    int split_cells, split_tets, flipped_tets; /* volume cells that were cut, into how many tets, how many turned */
    sbi_diagonal_node *diagonals;              /* [diagonal_count] of quadratic cells, ascending by low and high */
    int diagonal_count, diagonal_nodes;        /* diagonal_nodes: how many of them are new */
    int pieces;                                /* VTU: parts of the file that were joined */
    /* groups and what becomes regions */
    int keep_low; /* points and lines are kept as well: sets are wanted */
    int *groups;  /* lists of groups: their count, then their numbers; [0] is an empty one */
    size_t group_count, group_capacity;
    int cell_groups; /* list of the cell being read, see sbi_cell */
    sbi_group_name *names;
    size_t name_count, name_capacity;
    int region_rank;  /* of the field in source_regions, see sbi_region_field_rank; 0: none */
    int region_cells; /* cells of source_regions */
    char region_field[SB_MESH_SET_NAME];
    int ignored_count; /* fields, sections and the like that were stepped over */
    char ignored[120]; /* their names */
} sbi_loader;

SBI_API void sbi_loader_init(sbi_loader *loader, const sb_load_options *options, sb_error *error);
SBI_API void sbi_loader_free(sbi_loader *loader);

/* An array for at least `needed` items with the `used` first ones of `old`, which is freed; NULL without
 * memory (old stays). Grows geometrically. */
SBI_API void *sbi_loader_grow(const sbi_loader *loader, void *old, size_t used, size_t *capacity, size_t needed,
                              size_t item);
SBI_API sb_result sbi_loader_no_memory(const sbi_loader *loader);

/* Takes memory for `count` more nodes, of which the caller knows that the file can hold them. */
SBI_API sb_result sbi_loader_reserve_nodes(sbi_loader *loader, int count);
/* Appends a node, scaled; a coordinate that is not finite or does not fit is an error. */
SBI_API sb_result sbi_loader_add_node(sbi_loader *loader, const double x[3]);
/* Appends a normal, not scaled; one for each node or none. */
SBI_API sb_result sbi_loader_add_normal(sbi_loader *loader, const double n[3]);
/* Reads three words as a node. */
SBI_API sb_result sbi_loader_read_node(sbi_loader *loader);

/* A cell: begin, then its nodes as numbered in the file (`base` is the first node's number), then end. */
SBI_API void sbi_loader_begin_cell(sbi_loader *loader);
SBI_API sb_result sbi_loader_cell_node(sbi_loader *loader, int64_t number, int64_t base);
SBI_API sb_result sbi_loader_end_cell(sbi_loader *loader, int kind, sbi_node_order order, int region);
/* A list of groups for loader->cell_groups; the same as the list before when the numbers are. */
SBI_API sb_result sbi_loader_add_groups(sbi_loader *loader, const int *numbers, int count, int *list);
SBI_API sb_result sbi_loader_add_name(sbi_loader *loader, int dimension, int number, sbi_word text);
/* Notes something of the file that is not taken. */
SBI_API void sbi_loader_ignore(sbi_loader *loader, sbi_word name);
/* How well a cell field of that name fits to be the regions, 1 is worst; 0: it is another field. */
SBI_API int sbi_region_field_rank(sbi_word name);
/* Decides whether a cell field becomes the regions; one that does not is noted as ignored, and so is the one that had
 * been chosen before it. */
SBI_API int sbi_loader_choose_regions(sbi_loader *loader, sbi_word name, int usable);
/* Room for the regions of all cells met so far; those that are there stay, new ones are 0. */
SBI_API sb_result sbi_loader_begin_regions(sbi_loader *loader);
/* The region of a cell. One that is no integer is an error of the field `region`; another field is dropped. */
SBI_API sb_result sbi_loader_set_region(sbi_loader *loader, sbi_word name, int cell, double value);
/* Ends a cell that is a polygon: one tri3 or a fan of them. */
SBI_API sb_result sbi_loader_end_polygon(sbi_loader *loader, int region);
/* Ends a cell of VTK's, whatever its kind. */
SBI_API sb_result sbi_loader_end_vtk_cell(sbi_loader *loader, int kind);
/* Ends a cell that is a strip of triangles, each with the last two nodes of the one before. */
SBI_API sb_result sbi_loader_end_strip(sbi_loader *loader, int region);

/* Makes the mesh of the cells with the highest dimension; its nodes are the loader's. Does not check
 * geometry. */
SBI_API sb_result sbi_loader_build(sbi_loader *loader, sb_mesh *mesh);
/* Elements that a cell of the mesh's dimension became: consecutive ones, in the order of the cells. */
SBI_API int sbi_cell_elements(const sbi_cell *cell, sb_element_type type);
SBI_API int sbi_cell_region(const sbi_loader *loader, const sbi_cell *cell);
SBI_API sb_result sbi_loader_fail_kind(const sbi_loader *loader, int kind, const char *format, const char *first,
                                       const char *second);

/* ---- cells cut into tets (meshio_split) ------------------------------------------------------------
 * 1 when the kinds of volume cells in the file are to become tets; *type then is SB_TET4 or SB_TET10. */
SBI_API int sbi_split_wanted(const sbi_loader *loader, sb_element_type *type);
/* Fills mesh->elements, for which there is room, with the tets of all volume cells; appends nodes to the loader. */
SBI_API sb_result sbi_split_cells(sbi_loader *loader, sb_mesh *mesh);
/* Where the diagonal of a quadrilateral begins: at its corner with the lowest number. */
SBI_API int sbi_split_first_corner(const int *corners, int count);
/* The node on the diagonal between two corners of quadratic cells that were cut, or -1. */
SBI_API int sbi_split_diagonal_node(const sbi_loader *loader, int a, int b);

/* ---- sets (meshio_sets) ---------------------------------------------------------------------------- */

/* The groups of the loader's cells as sets of the mesh that was built of them. */
SBI_API sb_result sbi_sets_make(const sbi_loader *loader, const sb_mesh *mesh, sb_mesh_sets *sets);

/* ---- compressed data (meshio_inflate) -------------------------------------------------------------- */

/* Unpacks a zlib stream (RFC 1950, 1951) behind *out [*out_size], which grows; at most `limit` bytes are unpacked.
 * NULL, or what is wrong with the stream; "" for want of memory. */
SBI_API const char *sbi_inflate(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t limit,
                                unsigned char **out, size_t *out_size, size_t *out_capacity);
/* The same for a gzip file (RFC 1952) of one member. */
SBI_API const char *sbi_gunzip(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t limit,
                               unsigned char **out, size_t *out_size, size_t *out_capacity);

/* The start of a gzip file: its first `least` bytes, or as many as there are, and perhaps some more. 0 for want of
 * memory; what is wrong with the file later on does not matter. */
SBI_API int sbi_gunzip_start(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t least,
                             unsigned char **out, size_t *out_size);

/* ---- label images (image) ------------------------------------------------------------------------------ */

SBI_API void sbi_voxels_init(sbi_voxels *voxels);
/* Numbers that `voxels` takes: all in a row and finite; spacing above 0. */
SBI_API sb_result sbi_voxels_read_reals(sbi_reader *reader, const char *what, int count, double *values);
SBI_API sb_result sbi_voxels_check_spacing(const sbi_reader *reader, const double spacing[3]);
/* Voxels of an image whose values stand at its points, or in its cells; 0 when there are more than an int counts. */
SBI_API int sbi_voxels_count(const sbi_voxels *voxels, int in_cells);
/* Takes memory for the labels, of which the caller knows that the file can hold them. */
SBI_API sb_result sbi_voxels_begin(sbi_loader *loader, int in_cells);
/* The value of a voxel: a whole number that an int holds. */
SBI_API sb_result sbi_voxels_set(const sbi_loader *loader, const sbi_reader *reader, int voxel, double value);

/* ---- files ---------------------------------------------------------------------------------------- */

/* Copies the options or their defaults; refuses those out of range. */
SBI_API sb_result sbi_load_options_resolve(const sb_load_options *options, sb_load_options *resolved, sb_error *error);

/* Points the loader's reader to a file's content, behind the byte order mark that some programs put before
 * text. */
SBI_API void sbi_loader_set_content(sbi_loader *loader, const char *data, size_t size, const char *name);
/* Replaces SB_FILE_AUTO by what the content or the name says. */
SBI_API sb_result sbi_file_detect(const sbi_reader *reader, sb_file_format *format);
/* Reads what the loader's reader holds; not TetGen's. */
SBI_API sb_result sbi_loader_parse(sbi_loader *loader, sb_file_format format);

/* A file being written. Failures are remembered and reported at the end. */
typedef struct sbi_export {
    sb_output output;
    int binary, failed;
} sbi_export;
SBI_API sb_result sbi_export_open(sbi_export *out, const char *path, int binary, sb_error *error);
SBI_API sb_result sbi_export_close(sbi_export *out, sb_error *error);
SBI_API void sbi_export_text(sbi_export *out, const char *text);
/* The low `size` bytes of a number. */
SBI_API void sbi_export_bits(sbi_export *out, uint64_t bits, int size, int big_endian);
SBI_API uint64_t sbi_export_real_bits(sb_real value);
/* All digits of a number, with a point whatever the locale's (which may take several bytes). */
SBI_API void sbi_export_print_real(sbi_export *out, sb_real value);

/* ---- formats ---------------------------------------------------------------------------------------
 * Each reads the whole file that the loader's reader holds into the loader. */
SBI_API sb_result sbi_vtk_read(sbi_loader *loader);
SBI_API sb_result sbi_gmsh_read(sbi_loader *loader);
SBI_API sb_result sbi_obj_read(sbi_loader *loader);
SBI_API sb_result sbi_stl_read(sbi_loader *loader);
SBI_API sb_result sbi_ply_read(sbi_loader *loader);
SBI_API sb_result sbi_off_read(sbi_loader *loader);
SBI_API sb_result sbi_vtu_read(sbi_loader *loader);
SBI_API sb_result sbi_medit_read(sbi_loader *loader);
/* These two read the header of a label image; the voxels follow in the file, or are all of the one named. */
SBI_API sb_result sbi_meta_read(sbi_loader *loader, sbi_voxel_data *data);
SBI_API sb_result sbi_nrrd_read(sbi_loader *loader, sbi_voxel_data *data);
/* The header of a NIfTI file, which `header` holds from its first byte on, unpacked; data->offset tells where the
 * voxels are. */
SBI_API sb_result sbi_nifti_read(const sbi_reader *header, sbi_voxels *voxels, sbi_voxel_data *data);
/* 1 when the content begins as a NIfTI file does, SBI_NIFTI_HEADER bytes of it are enough. */
enum { SBI_NIFTI_HEADER = 540 };
SBI_API int sbi_nifti_begins(const char *data, size_t size);
/* 1 when the content begins as a binary Medit file does. */
SBI_API int sbi_medit_is_binary(const char *data, size_t size);
/* TetGen's two files, one after the other; between them the caller changes the reader. *base: number of
 * the first node. */
SBI_API sb_result sbi_tetgen_read_nodes(sbi_loader *loader, int64_t *base);
SBI_API sb_result sbi_tetgen_read_elements(sbi_loader *loader, int64_t base);
/* 1 when the size is that of a binary STL file with the count it claims. */
SBI_API int sbi_stl_is_binary(const char *data, size_t size);

#endif /* SB_MESHIO_READER_H */
