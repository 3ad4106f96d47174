/* meshio: reads and writes mesh files. Floor 1: calls core, dense, element and mesh.
 *
 *     file ---> bounded reader ---> cells of any kind ---> one element type ---> checked sb_mesh
 *
 * A file is untrusted input: nothing is read outside it, no memory is taken for a count that the file is too
 * short to hold, and the time grows linearly with the file (n log n where node numbers are scattered or
 * vertices are merged).
 *
 * | format     | read                                                         | written              |
 * |------------|--------------------------------------------------------------|----------------------|
 * | VTK legacy | 2.0 to 5.1, ASCII and binary, UNSTRUCTURED_GRID and POLYDATA | 3.0, ASCII, binary   |
 * | VTU, VTP   | VTK's XML, UnstructuredGrid and PolyData: ASCII, base64, appended, zlib-compressed | |
 * | gmsh       | 1, 2.x, 3, 4.0 and 4.1, ASCII and binary                     |                      |
 * | Medit      | .mesh and .meshb, versions 1 to 4                            |                      |
 * | TetGen     | .node with .ele                                              |                      |
 * | OBJ        | vertices and faces                                           | ASCII                |
 * | STL        | ASCII and binary                                             | binary               |
 * | PLY        | ASCII, binary of both byte orders                            | binary little-endian |
 * | OFF        | ASCII, also COFF, NOFF, STOFF                                |                      |
 *
 * Numbers are parsed and written without regard to the locale; reading rounds correctly, so what is written
 * in full precision comes back with the same bits. */
#ifndef SB_MESHIO_H
#define SB_MESHIO_H

#include "mesh.h"

/* ---- reading ----------------------------------------------------------------------------------------- */

typedef enum sb_file_format {
    SB_FILE_AUTO = 0, /* by the content, else by the end of the name */
    SB_FILE_VTK = 1,
    SB_FILE_GMSH = 2,
    SB_FILE_TETGEN = 3,
    SB_FILE_OBJ = 4,
    SB_FILE_STL = 5,
    SB_FILE_PLY = 6,
    SB_FILE_OFF = 7,
    SB_FILE_VTU = 8,
    SB_FILE_MEDIT = 9
} sb_file_format;

enum { SB_MESH_SET_NAME = 64, SB_LOAD_NOTES = 10, SB_LOAD_NOTE_LENGTH = 192 };

/* What a successful load did besides copying numbers. */
typedef struct sb_load_report {
    sb_file_format format;  /* what the file turned out to be */
    int file_cells;         /* cells, elements or faces in the file */
    int skipped_cells;      /* left out, because their dimension is lower than the mesh's */
    int split_polygons;     /* faces of 4 or more corners, and strips, that were cut into triangles */
    int split_cells;        /* pyramids, wedges and hexahedra that were cut into tets */
    int merged_vertices;    /* STL: corners that were found to be a vertex met before */
    int flipped_elements;   /* renumbered, because they were inverted */
    int unreferenced_nodes; /* nodes of no element; kept, so that node numbers stay those of the file */
    int ignored;            /* fields, sections and the like of the file that were not taken; notes name them */
    int note_count;         /* sentences on what was taken, converted and left out beyond a plain copy */
    char notes[SB_LOAD_NOTES][SB_LOAD_NOTE_LENGTH]; /* each ends in 0, in UTF-8 */
} sb_load_report;

/* A group of a file: gmsh's physical groups, Medit's references, the regions of VTK files. */
typedef struct sb_mesh_set {
    char name[SB_MESH_SET_NAME]; /* as the file has it, cut where it is longer; "": the group has a number only */
    int number;                  /* of the group in the file */
    int dimension;               /* of its cells in the file: 0 points, 1 lines, 2 faces, 3 volumes */
    int element_count;
    int *elements; /* [element_count] elements of the mesh, ascending; when dimension is that of the mesh */
    int face_count, face_corners;
    int *faces; /* [face_count][face_corners] corner nodes of faces, as sb_body_add_pressure takes them; when dimension
                 * is 2 and the mesh a volume: those of the file that have the shape of the mesh's faces (3 corners
                 * for tets, 4 for hexahedra), and quadrilaterals of files whose cells were cut into tets cut
                 * alike */
    int node_count;
    int *nodes; /* [node_count] nodes of all its cells, ascending */
} sb_mesh_set;

/* All groups of a file, ascending by dimension and number. Zero-initialise; release with sb_mesh_sets_free. */
typedef struct sb_mesh_sets {
    int count;
    sb_mesh_set *sets;
    sb_allocator allocator;
} sb_mesh_sets;

/* Releases the arrays and zeroes the struct. Safe on {0} and on NULL. */
SB_API void sb_mesh_sets_free(sb_mesh_sets *sets);
/* The first set with the name (whole, case matters) and dimension (-1: any), or NULL. O(sets). */
SB_API const sb_mesh_set *sb_mesh_sets_find(const sb_mesh_sets *sets, const char *name, int dimension);

/* How to load. Start from sb_default_load_options(). */
typedef struct sb_load_options {
    sb_real scale;          /* > 0, multiplies every coordinate; 1; files in millimetres: 0.001 */
    int fix_orientation;    /* 0: an element that is inverted among others that are not is an error. 1: it is
                             * turned; surfaces are oriented by sb_mesh_orient_surface; tet10 with gmsh's node order in
                             * a file of another program are put in order */
    sb_allocator allocator; /* for the mesh and while loading; zeros: malloc */
    sb_load_report *report; /* filled on success; NULL: not wanted */
    sb_mesh_sets *sets;     /* the groups of the file, overwritten on success; NULL: not wanted */
    int cookie;             /* set by sb_default_load_options; detects options that were never initialised */
} sb_load_options;

/* Scale 1, nothing is repaired, malloc, no report, no sets. */
SB_API sb_load_options sb_default_load_options(void);

/* Reads a mesh from a file.
 *
 * mesh     overwritten on success (free it first when it owns arrays), untouched on failure; free it with
 *          sb_mesh_free
 * path     the format is by the content, else by the ending. TetGen: the .node or the .ele file, the
 *          other one is looked for beside it
 * options  NULL: sb_default_load_options()
 * error    may be NULL; says file and line (line 0 in binary parts, where the message has the byte offset),
 *          and the node or element: the cell of the file, counted from 0, or with SB_ERROR_MESH the element
 *          of the mesh it would have become
 *
 * The cells of the highest dimension become the mesh: tet4, tet10, hex8, hex20, hex27, or for surfaces tri3, tri6,
 * quad4, quad8, quad9. Triangles mixed with quadrilaterals, and polygons of OBJ, PLY, OFF and POLYDATA, become tri3;
 * polygons are cut into a fan at their first corner, which is right for convex ones. Pyramids, wedges, and hexahedra
 * that are mixed with other volume cells, are cut into tets that fit: each quadrilateral along the diagonal from its
 * lowest node. Linear cells give tet4, quadratic ones (tet10, hex20, hex27, wedge15, wedge18, pyramid13, pyramid14)
 * tet10, whose nodes on diagonals that are not in the file are new, behind those of the file. Linear cells mixed with
 * quadratic ones, and a quadrilateral against triangles that are cut along its other diagonal, are
 * SB_ERROR_UNSUPPORTED.
 *
 * Node orders of gmsh and TetGen are turned into VTK's. Regions come from the cell field `region` (VTK, VTU), else
 * `material`, `MaterialIds`, `gmsh:physical`, `medit:ref`, `CellEntityIds` or their like (the report names it), the
 * first physical group of the volume (gmsh; of the surface in a surface file), the reference (Medit) or the first
 * attribute (TetGen); regions is NULL when all are 0. VTU: pieces are joined as they are, see sb_mesh_merge_nodes.
 *
 * A volume mesh is checked with sb_mesh_validate. When all its elements are inverted, that is the file's
 * convention: they are turned and counted in the report. A surface is loaded as it is, since scans are seldom
 * perfect: look at it with sb_mesh_check.
 *
 * Not read: VTK's files that are compressed with LZ4 or LZMA, parallel files (.pvtu: load their pieces), polyhedra.
 *
 * SB_ERROR_ARGUMENT (null pointer, options), _FILE (cannot be read), _FORMAT, _NOT_FINITE (coordinate, also
 * one too large for sb_real), _INDEX (node that does not exist), _MESH (inverted or flat elements, no
 * elements), _UNSUPPORTED (names the version, data set or element type) or _MEMORY. */
SB_API sb_result sb_mesh_load(sb_mesh *mesh, const char *path, const sb_load_options *options, sb_error *error);

/* Reads a mesh from memory, as sb_mesh_load does from a file.
 *
 * data     [size] bytes, borrowed during the call; may be NULL when size is 0
 * format   SB_FILE_AUTO or any but SB_FILE_TETGEN, which needs two files
 * name     stands for the path in errors and in telling the format; may be NULL */
SB_API sb_result sb_mesh_load_memory(sb_mesh *mesh, const void *data, size_t size, sb_file_format format,
                                     const char *name, const sb_load_options *options, sb_error *error);

/* ---- writing -----------------------------------------------------------------------------------------
 * All writers check the mesh first (SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX; _UNSUPPORTED for custom elements whose
 * table has no vtk_type) and touch no file then. They take
 * no memory. When writing fails (SB_ERROR_FILE: no such folder, disk full) the file is what it was before, or is
 * not there: see sb_output_open. */

typedef enum sb_field_location { SB_FIELD_NODES = 0, SB_FIELD_ELEMENTS = 1 } sb_field_location;

/* Values to write along with a mesh; everything is borrowed. */
typedef struct sb_field {
    const char *name; /* printable ASCII without blanks */
    sb_field_location location;
    int components;        /* 1 scalar; 2 or 4 plain arrays; 3 vector; 6 symmetric tensor xx yy zz xy yz xz;
                            * 9 tensor, row by row */
    const sb_real *values; /* [nodes or elements][components], finite */
} sb_field;

/* Writes a legacy VTK 3.0 unstructured grid in ASCII, with fields, and mesh->regions as the cell field
 * `region`. The numbers are exact: %.17g (%.9g when sb_real is float). fields may be NULL when field_count
 * is 0. */
SB_API sb_result sb_mesh_save_vtk(const char *path, const sb_mesh *mesh, const sb_field *fields, int field_count,
                                  sb_error *error);
/* The same in VTK's big-endian binary form: smaller, faster, exact. */
SB_API sb_result sb_mesh_save_vtk_binary(const char *path, const sb_mesh *mesh, const sb_field *fields, int field_count,
                                         sb_error *error);

/* Surfaces of tri3 or quad4; other meshes are SB_ERROR_UNSUPPORTED (a volume: see sb_mesh_boundary). */

/* OBJ with v and f lines, exact numbers. */
SB_API sb_result sb_mesh_save_obj(const char *path, const sb_mesh *mesh, sb_error *error);
/* Binary STL: coordinates are rounded to float, shared vertices and unused nodes are lost, quad4 become two
 * triangles. */
SB_API sb_result sb_mesh_save_stl(const char *path, const sb_mesh *mesh, sb_error *error);
/* Binary little-endian PLY, coordinates in the precision of sb_real. */
SB_API sb_result sb_mesh_save_ply(const char *path, const sb_mesh *mesh, sb_error *error);

#endif /* SB_MESHIO_H */
