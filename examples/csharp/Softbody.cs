// All of softbody.h, needle.h and register.h for C#. Written by src/bindings.py: do not edit.
#pragma warning disable CS8981
using System;
using System.Runtime.InteropServices;

namespace Softbody
{
public enum sb_result
{
    SB_OK = 0,
    SB_ERROR_MEMORY = -1,
    SB_ERROR_ARGUMENT = -2,
    SB_ERROR_NOT_FINITE = -3,
    SB_ERROR_INDEX = -4,
    SB_ERROR_FILE = -5,
    SB_ERROR_FORMAT = -6,
    SB_ERROR_UNSUPPORTED = -7,
    SB_ERROR_MESH = -8,
    SB_ERROR_MATERIAL = -9,
    SB_ERROR_UNCONSTRAINED = -10,
    SB_ERROR_INVERTED = -11,
    SB_ERROR_DIVERGED = -12,
    SB_ERROR_NOT_CONVERGED = -13,
    SB_ERROR_INDEFINITE = -14,
    SB_ERROR_STATE = -15,
    SB_ERROR_CANCELLED = -16,
}
public enum sb_element_type
{
    SB_NO_ELEMENT = 0,
    SB_TRI3 = 1,
    SB_TRI6 = 2,
    SB_QUAD4 = 3,
    SB_QUAD8 = 4,
    SB_QUAD9 = 5,
    SB_TET4 = 10,
    SB_TET10 = 11,
    SB_HEX8 = 12,
    SB_HEX20 = 13,
    SB_HEX27 = 14,
    SB_CUSTOM = 15,
}
public enum sb_quadrature_kind
{
    SB_QUADRATURE_STIFFNESS = 0,
    SB_QUADRATURE_STIFFNESS_CURVED = 1,
    SB_QUADRATURE_MASS = 2,
    SB_QUADRATURE_FACE = 3,
}
public enum sb_mesh_defect
{
    SB_MESH_SOUND = 0,
    SB_MESH_INDEX_RANGE = 1,
    SB_MESH_NODE_NOT_FINITE = 2,
    SB_MESH_REPEATED_NODE = 3,
    SB_MESH_INVERTED = 4,
    SB_MESH_FLAT = 5,
    SB_MESH_BAD_MIDSIDE = 6,
    SB_MESH_DUPLICATE = 7,
    SB_MESH_DEFECT_COUNT = 8,
}
public enum sb_file_format
{
    SB_FILE_AUTO = 0,
    SB_FILE_VTK = 1,
    SB_FILE_GMSH = 2,
    SB_FILE_TETGEN = 3,
    SB_FILE_OBJ = 4,
    SB_FILE_STL = 5,
    SB_FILE_PLY = 6,
    SB_FILE_OFF = 7,
    SB_FILE_VTU = 8,
    SB_FILE_MEDIT = 9,
}
public enum sb_field_location
{
    SB_FIELD_NODES = 0,
    SB_FIELD_ELEMENTS = 1,
}
public enum sb_surface_feature
{
    SB_SURFACE_FACE = 0,
    SB_SURFACE_EDGE = 1,
    SB_SURFACE_VERTEX = 2,
}
public enum sb_surface_finding
{
    SB_SURFACE_OPEN_EDGES = 1,
    SB_SURFACE_FLIPPED = 2,
    SB_SURFACE_NONMANIFOLD_EDGES = 4,
    SB_SURFACE_NONMANIFOLD_NODES = 8,
    SB_SURFACE_DEGENERATE = 16,
    SB_SURFACE_DUPLICATES = 32,
    SB_SURFACE_UNWELDED = 64,
    SB_SURFACE_INSIDE_OUT = 128,
    SB_SURFACE_SELF_CROSSING = 256,
    SB_SURFACE_UNREFERENCED = 512,
    SB_SURFACE_SEVERAL_PARTS = 1024,
    SB_SURFACE_CROWDED = 2048,
}
public enum sb_material_model
{
    SB_LINEAR = 1,
    SB_COROTATED = 2,
    SB_COROTATED_INVERTIBLE = 3,
    SB_SVK = 4,
    SB_NEO_HOOKEAN = 5,
    SB_NEO_HOOKEAN_ISOCHORIC = 6,
    SB_STABLE_NEO_HOOKEAN = 7,
    SB_MOONEY_RIVLIN = 8,
    SB_REDUCED_POLYNOMIAL = 9,
    SB_OGDEN = 10,
    SB_FUNG = 11,
    SB_CUSTOM_LAW = 12,
}
public enum sb_tangent_kind
{
    SB_TANGENT_EXACT = 0,
    SB_TANGENT_SPD = 1,
    SB_TANGENT_QUASI = 2,
}
public enum sb_preset
{
    SB_LIVER_JORDAN = 1,
    SB_LIVER_RAGHUNATHAN = 2,
    SB_LIVER_KIM = 3,
    SB_LIVER_NEO_HOOKEAN = 4,
    SB_LIVER_LINEAR = 5,
}
public enum sb_test_kind
{
    SB_TEST_UNIAXIAL = 1,
    SB_TEST_EQUIBIAXIAL = 2,
    SB_TEST_PLANAR = 3,
    SB_TEST_SIMPLE_SHEAR = 4,
}
public enum sb_stress_measure
{
    SB_STRESS_NOMINAL = 0,
    SB_STRESS_CAUCHY = 1,
}
public enum sb_direct_kind
{
    SB_DIRECT_CHOLESKY = 0,
    SB_DIRECT_LDLT = 1,
}
public enum sb_integration
{
    SB_INTEGRATION_AUTO = 0,
    SB_INTEGRATION_STANDARD = 1,
    SB_INTEGRATION_CURVED = 2,
    SB_INTEGRATION_BBAR = 3,
    SB_INTEGRATION_PATCH = 4,
}
public enum sb_mass_kind
{
    SB_MASS_LUMPED = 0,
    SB_MASS_CONSISTENT = 1,
    SB_MASS_REDUCED = 2,
}
public enum sb_precond_kind
{
    SB_PRECOND_NONE = 0,
    SB_PRECOND_BLOCK_JACOBI = 1,
    SB_PRECOND_SSOR = 2,
    SB_PRECOND_IC0 = 3,
    SB_PRECOND_AUTO = 4,
    SB_PRECOND_FSAI = 5,
    SB_PRECOND_CHOLESKY = 6,
    SB_PRECOND_MULTIGRID = 7,
}
public enum sb_grid_method
{
    SB_GRID_SPARSE = 1,
    SB_GRID_FINITE_CELL = 2,
    SB_GRID_WEIGHTED_CELL = 3,
}
public enum sb_mixture_mean
{
    SB_MIXTURE_VOIGT = 1,
    SB_MIXTURE_GEOMETRIC = 2,
    SB_MIXTURE_REUSS = 3,
}
public enum sb_particle_method
{
    SB_PARTICLES_SPH = 1,
    SB_PARTICLES_MLS = 2,
    SB_PARTICLES_GRID = 3,
}
public enum sb_kernel
{
    SB_KERNEL_SPIKY = 1,
    SB_KERNEL_POLY6 = 2,
    SB_KERNEL_COSINE = 3,
    SB_KERNEL_CUBIC = 4,
    SB_KERNEL_QUARTIC = 5,
}
public enum sb_radius_rule
{
    SB_RADIUS_FIXED = 1,
    SB_RADIUS_FARTHEST = 2,
    SB_RADIUS_MEAN = 3,
}
public enum sb_integrator
{
    SB_EULER = 1,
    SB_NEWMARK = 2,
    SB_GENERALISED_ALPHA = 3,
    SB_CENTRAL_DIFFERENCE = 4,
}
public enum sb_tensor
{
    SB_TENSOR_STRESS = 1,
    SB_TENSOR_STRAIN = 2,
}
public enum sb_membrane_form
{
    SB_MEMBRANE_SLACK = 0,
    SB_MEMBRANE_WRINKLED = 1,
    SB_MEMBRANE_TAUT = 2,
}
public enum sb_cavity_kind
{
    SB_CAVITY_PRESSURE = 0,
    SB_CAVITY_GAS = 1,
    SB_CAVITY_LIQUID = 2,
    SB_CAVITY_VOLUME = 3,
    SB_CAVITY_TABLE = 4,
}
public enum sb_embedding_kind
{
    SB_EMBED_SMOOTH = 0,
    SB_EMBED_PLAIN = 1,
}
public enum sb_embedding_hold
{
    SB_EMBEDDED_INSIDE = 0,
    SB_EMBEDDED_OFFSET = 1,
    SB_EMBEDDED_FRAME = 2,
    SB_EMBEDDED_EXTRAPOLATED = 3,
}
public enum sb_stop_reason
{
    SB_STOP_NONE = 0,
    SB_STOP_CONVERGED = 1,
    SB_STOP_FLOOR = 2,
}
public enum sb_newton
{
    SB_NEWTON_AUTO = 0,
    SB_NEWTON_PLAIN = 1,
    SB_NEWTON_MIXED_POINTS = 2,
}
public enum sb_start
{
    SB_START_AUTO = 0,
    SB_START_PRESENT = 1,
    SB_START_ROTATIONS = 2,
}
public enum sb_parameter_kind
{
    SB_PARAMETER_YOUNG = 1,
    SB_PARAMETER_POISSON = 2,
    SB_PARAMETER_CONSTANT = 3,
    SB_PARAMETER_DENSITY = 4,
    SB_PARAMETER_GRAVITY = 5,
    SB_PARAMETER_FORCE = 6,
    SB_PARAMETER_PRESSURE = 7,
    SB_PARAMETER_STIFFNESS = 8,
    SB_PARAMETER_TARGET = 9,
    SB_PARAMETER_SUPPORT = 10,
}
public enum sb_constant
{
    SB_CONSTANT_LAMBDA = 1,
    SB_CONSTANT_MU = 2,
    SB_CONSTANT_C10 = 3,
    SB_CONSTANT_C01 = 4,
    SB_CONSTANT_C20 = 5,
    SB_CONSTANT_C30 = 6,
    SB_CONSTANT_D1 = 7,
    SB_CONSTANT_FIBRE_STIFFNESS = 8,
    SB_CONSTANT_FIBRE_TENSION = 9,
    SB_CONSTANT_OGDEN_MU = 10,
}
public enum sb_layer_kind
{
    SB_LAYER_CONVOLUTION = 1,
    SB_LAYER_POOL = 2,
    SB_LAYER_UPSAMPLE = 3,
    SB_LAYER_JOIN = 4,
}
public enum sb_activation
{
    SB_ACTIVATION_NONE = 0,
    SB_ACTIVATION_RELU = 1,
}
public enum sb_network_policy
{
    SB_NETWORK_TAKE = 1,
    SB_NETWORK_START = 2,
    SB_NETWORK_KEEP = 3,
}
public enum sb_tool_shape
{
    SB_TOOL_SPHERE = 1,
    SB_TOOL_CAPSULES = 2,
    SB_TOOL_BOX = 3,
    SB_TOOL_PLANE = 4,
    SB_TOOL_MESH = 5,
}
public enum sb_contact_pairs
{
    SB_CONTACT_SELF = 1,
    SB_CONTACT_ORGANS = 2,
}
public enum sb_cut_front
{
    SB_CUT_LAG = 0,
    SB_CUT_GLUE = 1,
}
public enum sb_cut_tag
{
    SB_CUT_SKIN = 0,
    SB_CUT_LIP = 1,
    SB_CUT_CHAR = 2,
    SB_CUT_RIM = 3,
}
public enum ndl_rod_preset
{
    NDL_STYLET_18G = 1,
    NDL_NITINOL_083 = 2,
    NDL_HYPODERMIC_22G = 3,
}
public enum ndl_rod_rest
{
    NDL_REST_STRAIGHT = 1,
    NDL_REST_SHAPE = 2,
    NDL_REST_CURVATURE = 3,
}
public enum ndl_interface_rule
{
    NDL_INTERFACE_KEEP_NODES = 0,
    NDL_INTERFACE_MOVE = 1,
}
public enum ndl_operation
{
    NDL_NO_OPERATION = 0,
    NDL_NODE_SNAP = 1,
    NDL_EDGE_SPLIT = 2,
    NDL_FACE_SPLIT = 3,
    NDL_TET_SPLIT = 4,
}
public enum ndl_bevel_law
{
    NDL_BEVEL_ANGLE = 1,
    NDL_BEVEL_CURVATURE = 2,
}
public enum ndl_obstacle_kind
{
    NDL_OBSTACLE_SPHERE = 1,
    NDL_OBSTACLE_CAPSULE = 2,
    NDL_OBSTACLE_CYLINDER = 3,
    NDL_OBSTACLE_SHAPE = 4,
}
public enum ndl_plan_outcome
{
    NDL_PLAN_REACHES = 1,
    NDL_PLAN_SHORT = 2,
    NDL_PLAN_BLOCKED = 3,
}
public enum ndl_steer_status
{
    NDL_STEER_GOING = 0,
    NDL_STEER_REACHED = 1,
    NDL_STEER_CLOSEST = 2,
    NDL_STEER_LIMIT = 3,
    NDL_STEER_BLOCKED = 4,
}
public enum ndl_contact
{
    NDL_FREE = 0,
    NDL_STATIC = 1,
    NDL_DYNAMIC_FORWARD = 2,
    NDL_DYNAMIC_BACKWARD = 3,
}
public enum ndl_follow
{
    NDL_REMESH = 0,
    NDL_EMBED = 1,
}
public enum reg_cloud_format
{
    REG_CLOUD_AUTO = 0,
    REG_CLOUD_XYZ = 1,
    REG_CLOUD_PLY = 2,
    REG_CLOUD_MESH = 3,
}
public enum reg_outliers
{
    REG_OUTLIERS_NONE = 0,
    REG_OUTLIERS_DEVIATION = 1,
    REG_OUTLIERS_MEDIAN = 2,
    REG_OUTLIERS_TRIM = 3,
}
public enum reg_field_kind
{
    REG_FIELD_DISTANCE = 0,
    REG_FIELD_LAPLACE = 1,
}
public enum reg_icp_metric
{
    REG_ICP_POINT = 0,
    REG_ICP_PLANE = 1,
}
public enum reg_icp_overlap
{
    REG_ICP_WHOLE = 0,
    REG_ICP_TARGET_PART = 1,
    REG_ICP_MODEL_PART = 2,
}
public enum reg_icp_stop
{
    REG_ICP_CONVERGED = 0,
    REG_ICP_ITERATIONS = 1,
    REG_ICP_TIME = 2,
}
public enum reg_warning
{
    REG_WARN_AMBIGUOUS = 1,
    REG_WARN_STRAIN = 256,
    REG_WARN_VOLUME = 512,
    REG_WARN_NOT_AT_REST = 1024,
    REG_WARN_INVERTED = 2,
    REG_WARN_MIXED_NORMALS = 4,
    REG_WARN_SCALE = 8,
    REG_WARN_VIEW_SMALL = 16,
    REG_WARN_MANY_OUTLIERS = 32,
    REG_WARN_LOW_CONTRAST = 64,
    REG_WARN_FREE_SPACE = 128,
}
public enum reg_cpd_kind
{
    REG_CPD_RIGID = 0,
    REG_CPD_SIMILARITY = 1,
    REG_CPD_AFFINE = 2,
    REG_CPD_NONRIGID = 3,
}
public enum reg_cpd_stop
{
    REG_CPD_CONVERGED = 0,
    REG_CPD_EXACT = 1,
    REG_CPD_ITERATIONS = 2,
    REG_CPD_TIME = 3,
}
public enum reg_match_method
{
    REG_PBSM = 0,
    REG_PBSM_LAPLACE = 1,
}
public enum reg_match_stop
{
    REG_MATCH_RUNNING = 0,
    REG_MATCH_SETTLED = 1,
    REG_MATCH_STEP_CAP = 2,
    REG_MATCH_TIME_CAP = 3,
    REG_MATCH_NO_OVERLAP = 4,
    REG_MATCH_FAILED = 5,
}
public enum reg_nicp_view
{
    REG_NICP_ALL = 0,
    REG_NICP_FACING = 1,
    REG_NICP_VISIBLE = 2,
}
public enum reg_nicp_stop
{
    REG_NICP_RUNNING = 0,
    REG_NICP_CONVERGED = 1,
    REG_NICP_INCREMENTS = 2,
    REG_NICP_STEP_CAP = 3,
    REG_NICP_TIME_CAP = 4,
    REG_NICP_NO_OVERLAP = 5,
    REG_NICP_FAILED = 6,
}
public enum reg_infer_stop
{
    REG_INFER_CONVERGED = 0,
    REG_INFER_ROUNDS = 1,
    REG_INFER_CAPPED = 2,
}
public enum reg_prior_kind
{
    REG_PRIOR_RIGID = 0,
    REG_PRIOR_SMOOTH = 1,
    REG_PRIOR_LOCAL = 2,
    REG_PRIOR_GRAVITY = 3,
    REG_PRIOR_PRESSURE = 4,
}
public enum reg_track_state
{
    REG_TRACK_FOLLOWS = 0,
    REG_TRACK_PREDICTS = 1,
    REG_TRACK_JUMPED = 2,
    REG_TRACK_LOST = 3,
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_error
{
    public sb_result result;
    public int line;
    public int element;
    public int node;
    public fixed byte file[256];
    public fixed byte message[256];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_allocator
{
    public IntPtr alloc;
    public IntPtr release;
    public void* user;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_jobs
{
    public IntPtr run;
    public void* user;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_output
{
    public IntPtr file;
    public byte* path;
    public fixed byte target[4096];
    public fixed byte beside[4096];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_vec3
{
    public double x;
    public double y;
    public double z;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mat3
{
    public fixed double m[9];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_quat
{
    public double w;
    public double x;
    public double y;
    public double z;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mapping
{
    public int row_count;
    public int* row_start;
    public int* nodes;
    public double* weights;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_element_table_face
{
    public sb_element_type type;
    public fixed int nodes[9];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_element_table
{
    public byte* name;
    public int node_count;
    public int corner_count;
    public IntPtr node_points;
    public IntPtr shape;
    public void* user;
    public int point_count;
    public IntPtr points;
    public double* weights;
    public int mass_point_count;
    public IntPtr mass_points;
    public double* mass_weights;
    public int face_count;
    public sb_element_table_face* faces;
    public int vtk_type;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mesh
{
    public int node_count;
    public sb_vec3* nodes;
    public sb_element_type element_type;
    public int element_count;
    public int* elements;
    public int* regions;
    public sb_allocator allocator;
    public sb_element_table* table;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mesh_bad_element
{
    public int element;
    public sb_mesh_defect defect;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mesh_report
{
    public int bad_count;
    public sb_mesh_bad_element* bad;
    public fixed int defect_count[8];
    public int not_finite_nodes;
    public int first_not_finite_node;
    public int unreferenced_nodes;
    public int first_unreferenced_node;
    public int duplicate_nodes;
    public int components;
    public double volume;
    public double area;
    public double min_edge;
    public double max_edge;
    public double worst_quality;
    public int worst_element;
    public int boundary_faces;
    public int nonmanifold_faces;
    public int open_edges;
    public int nonmanifold_edges;
    public int inconsistent_edges;
    public int nonmanifold_vertices;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_index_table
{
    public int rows;
    public int columns;
    public int* items;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_index_lists
{
    public int count;
    public int* offsets;
    public int* items;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_boundary
{
    public sb_mesh surface;
    public int* elements;
    public int* faces;
    public int* nodes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mesh_change
{
    public int node_end;
    public int cell_end;
    public int nodes_per_cell;
    public int made_node_count;
    public int* made_nodes;
    public sb_vec3* made_positions;
    public int* source_start;
    public int* sources;
    public double* source_weights;
    public byte* made_copies;
    public int removed_node_count;
    public int* removed_nodes;
    public int* heir_start;
    public int* heirs;
    public double* heir_weights;
    public int moved_node_count;
    public int* moved_nodes;
    public sb_vec3* moved_from;
    public sb_vec3* moved_to;
    public int* moved_start;
    public int* moved_sources;
    public double* moved_weights;
    public int removed_cell_count;
    public int* removed_cells;
    public int* removed_cell_nodes;
    public int made_cell_count;
    public int* made_cells;
    public int* made_cell_nodes;
    public int* made_parents;
    public double* made_shares;
    public int reshaped_cell_count;
    public int* reshaped_cells;
    public double* reshaped_shares;
    public IntPtr find_cell;
    public void* find_user;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_load_report
{
    public sb_file_format format;
    public int file_cells;
    public int skipped_cells;
    public int split_polygons;
    public int split_cells;
    public int merged_vertices;
    public int flipped_elements;
    public int unreferenced_nodes;
    public int ignored;
    public int note_count;
    public fixed byte notes[1920];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mesh_set
{
    public fixed byte name[64];
    public int number;
    public int dimension;
    public int element_count;
    public int* elements;
    public int face_count;
    public int face_corners;
    public int* faces;
    public int node_count;
    public int* nodes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mesh_sets
{
    public int count;
    public sb_mesh_set* sets;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_load_options
{
    public double scale;
    public int fix_orientation;
    public sb_allocator allocator;
    public sb_load_report* report;
    public sb_mesh_sets* sets;
    public int cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_field
{
    public byte* name;
    public sb_field_location location;
    public int components;
    public double* values;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_image
{
    public fixed int counts[3];
    public sb_vec3 origin;
    public sb_vec3 spacing;
    public sb_mat3 direction;
    public int* labels;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_label_def
{
    public sb_image* image;
    public int* labels;
    public int label_count;
    public int smoothing;
    public sb_allocator allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_label_report
{
    public int voxels;
    public double voxel_volume;
    public double volume;
    public int held_voxels;
}
public struct sb_surface { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_surface_hit
{
    public int triangle;
    public int element;
    public sb_surface_feature feature;
    public int index;
    public sb_vec3 point;
    public fixed double weights[3];
    public double distance;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_surface_place
{
    public int count;
    public int element;
    public int other_element;
    public int node;
    public int other_node;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_surface_report
{
    public int findings;
    public sb_surface_place place_0, place_1, place_2, place_3, place_4, place_5, place_6, place_7, place_8, place_9, place_10, place_11;
    public int crossings_partial;
    public int parts;
    public double volume;
    public double area;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_surface_repair_def
{
    public int weld;
    public double weld_tolerance;
    public int clean;
    public int orient;
    public int max_hole_edges;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_surface_repair_report
{
    public int merged_nodes;
    public int removed_nodes;
    public int removed_degenerate;
    public int removed_duplicates;
    public int flipped_edges;
    public int turned_faces;
    public int filled_holes;
    public int added_faces;
    public int left_holes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_shape
{
    public sb_surface* surface;
    public IntPtr distance;
    public void* user;
    public double max_slope;
    public int region;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_stuff_def
{
    public sb_shape* shapes;
    public int shape_count;
    public sb_vec3 low;
    public sb_vec3 high;
    public double cell;
    public int levels;
    public sb_element_type type;
    public int max_elements;
    public double least_share;
    public IntPtr progress;
    public void* progress_user;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_stuff_report
{
    public fixed int cells[3];
    public int node_count;
    public int element_count;
    public double min_dihedral;
    public double max_dihedral;
    public double distance;
    public double volume;
    public fixed double volume_share[64];
    public fixed double surface_share[64];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_material_law
{
    public byte* name;
    public void* user;
    public IntPtr energy;
    public IntPtr stress;
    public IntPtr tangent;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_material
{
    public sb_material_model model;
    public double density;
    public double lambda;
    public double mu;
    public double c10;
    public double d1;
    public double c01;
    public double c20;
    public double c30;
    public double fung_exponent;
    public fixed double ogden_mu[4];
    public fixed double ogden_alpha[4];
    public double fibre_stiffness;
    public double fibre_exponent;
    public double fibre_dispersion;
    public double fibre_tension;
    public double fibre_optimum;
    public double fibre_width;
    public sb_mat3 prestretch;
    public int prony_count;
    public fixed double prony_g[8];
    public fixed double prony_tau[8];
    public sb_material_law* law;
    public double law_scale;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_material_history
{
    public fixed double stress[6];
    public fixed double memory[48];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_test_point
{
    public sb_test_kind kind;
    public sb_stress_measure measure;
    public double strain;
    public double stress;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_fit_options
{
    public int order;
    public int relative;
    public int nonnegative;
    public int compressible;
    public double poisson;
    public double d1;
    public double density;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_fit_info
{
    public int points;
    public int constants;
    public int iterations;
    public double rms;
    public double r_squared;
    public double weakest;
    public int stable;
    public sb_test_kind unstable_kind;
    public double unstable_strain;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_matrix
{
    public int row_count;
    public int block_count;
    public int* row_start;
    public int* row_end;
    public int* columns;
    public int* diagonal;
    public int* transpose;
    public int part_count;
    public int* part_start;
    public int* part_rows;
    public byte* @fixed;
    public IntPtr blocks;
    public void* memory;
    public IntPtr live;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_direct_def
{
    public sb_direct_kind kind;
    public sb_vec3* positions;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_direct_info
{
    public int unknowns;
    public int fronts;
    public int largest_front;
    public double factor_entries;
    public double multiply_adds;
    public UIntPtr bytes;
    public double least_pivot;
    public int negative_pivots;
}
public struct sb_direct { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_domain
{
    public sb_element_type element_type;
    public sb_element_table* table;
    public int single_rotation;
    public int mean_points;
    public int node_count;
    public int cell_count;
    public int nodes_per_cell;
    public int points_per_cell;
    public int* cells;
    public double* gradients;
    public double* weights;
    public double* cell_mass;
    public int patch_count;
    public int* cell_patch;
    public int cell_capacity;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_multigrid_level
{
    public sb_mapping mapping;
    public int node_count;
    public sb_vec3* positions;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_preconditioner_def
{
    public sb_precond_kind kind;
    public sb_vec3* positions;
    public int piece_count;
    public int power;
    public sb_jobs jobs;
    public double poisson;
    public sb_multigrid_level* levels;
    public int level_count;
    public double* moduli;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_preconditioner_info
{
    public sb_precond_kind kind;
    public int piece_count;
    public int attempts;
    public double shift;
    public int level_count;
    public UIntPtr bytes;
}
public struct sb_preconditioner { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_pcg_options
{
    public double tolerance;
    public int max_iterations;
    public sb_jobs* jobs;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_pcg_info
{
    public int iterations;
    public double residual;
    public int residual_is_true;
    public int negative_curvature;
    public int capped;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_pcg_workspace
{
    public int row_count;
    public double* start;
    public double* residual;
    public double* search;
    public double* direction;
    public double* product;
    public double* partial;
    public void* parts;
    public void* memory;
    public void* guests;
    public UIntPtr guest_bytes;
    public IntPtr extra;
    public IntPtr unassembled;
    public IntPtr record;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_grid_def
{
    public sb_grid_method method;
    public int level;
    public sb_shape outer;
    public sb_shape* inner;
    public int inner_count;
    public sb_vec3 low;
    public sb_vec3 high;
    public int cells;
    public double cell_size;
    public fixed int counts[3];
    public double void_stiffness;
    public double least_share;
    public int max_points;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public IntPtr progress;
    public void* progress_user;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_grid
{
    public sb_mesh mesh;
    public sb_mesh body_mesh;
    public sb_domain domain;
    public int* body_cells;
    public double* shares;
    public sb_vec3 origin;
    public sb_vec3 cell_size;
    public fixed int counts[3];
    public int* lattice;
    public int cut_count;
    public int region_count;
    public int* regions;
    public double* region_volumes;
    public double volume;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_grid_rows
{
    public sb_mapping rows;
    public int* cells;
    public sb_vec3* points;
    public double* areas;
    public sb_vec3* normals;
    public double farthest;
    public void* memory;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mixture_def
{
    public sb_mesh* mesh;
    public sb_shape* shapes;
    public int shape_count;
    public int level;
    public double least_share;
    public sb_mixture_mean mean;
    public double* stiffness;
    public sb_integration integration;
    public int single_rotation;
    public sb_allocator allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_mixture
{
    public sb_mesh body_mesh;
    public sb_domain domain;
    public int* elements;
    public double* shares;
    public int mixed_count;
    public int region_count;
    public int* regions;
    public double* region_volumes;
    public double volume;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_particles_def
{
    public sb_particle_method method;
    public sb_kernel kernel;
    public sb_radius_rule radius_rule;
    public double radius;
    public double dilatation;
    public int neighbours;
    public int basis;
    public int points_per_cell;
    public int level;
    public int consistent;
    public sb_shape outer;
    public sb_shape* inner;
    public int inner_count;
    public sb_vec3 low;
    public sb_vec3 high;
    public int cells;
    public double spacing;
    public fixed int counts[3];
    public sb_vec3* points;
    public int point_count;
    public double* volumes;
    public double volume;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_particles
{
    public sb_mesh mesh;
    public sb_domain domain;
    public sb_element_table* table;
    public sb_vec3* points;
    public double* radii;
    public double* shapes;
    public byte* inner;
    public double volume;
    public double spacing;
    public int grown;
    public int lost;
    public double worst_condition;
    public double imbalance;
    public sb_particles_def def;
    public sb_surface** cuts;
    public int cut_count;
}
public struct sb_body { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_region_material
{
    public int region;
    public sb_material material;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_body_def
{
    public sb_mesh* mesh;
    public sb_domain* domain;
    public sb_material material;
    public sb_region_material* region_materials;
    public int region_material_count;
    public sb_vec3* fibres;
    public sb_vec3* second_fibres;
    public sb_integration integration;
    public int single_rotation;
    public sb_mass_kind mass;
    public sb_integrator integrator;
    public double spectral_radius;
    public int max_substeps;
    public sb_vec3 gravity;
    public double damping_mass;
    public double damping_stiffness;
    public sb_precond_kind preconditioner;
    public sb_multigrid_level* levels;
    public int level_count;
    public double tolerance;
    public int max_iterations;
    public int max_newton;
    public double newton_tolerance;
    public double slack;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public IntPtr clock;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_energy
{
    public double elastic;
    public double kinetic;
    public double springs;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_part
{
    public int node;
    public int node_count;
    public double volume;
    public double mass;
    public sb_vec3 centre;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_check_report
{
    public uint warnings;
    public double size;
    public double worst_quality;
    public int worst_element;
    public int sliver_count;
    public int unreferenced_count;
    public int component_count;
    public int duplicate_count;
    public int locking_count;
    public int locking_element;
    public double locking_limit;
    public int unsupported_component_node;
}
public struct sb_body_change { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cell_moments
{
    public sb_vec3 centroid;
    public sb_mat3 covariance;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_change_cell
{
    public int* nodes;
    public int parent;
    public int region;
    public sb_vec3* fibre;
    public double share;
    public sb_cell_moments* moments;
    public double* face_loads;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_body_listener
{
    public void* user;
    public IntPtr reserve;
    public IntPtr follow;
    public IntPtr give_up;
    public IntPtr end;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cable_def
{
    public int count;
    public int* nodes;
    public sb_mapping* rows;
    public sb_vec3* places;
    public double rest_length;
    public double stiffness;
    public double toe_strain;
    public int pushes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_membrane_def
{
    public int* faces;
    public int face_count;
    public int corners;
    public double thickness;
    public double shear;
    public double prestretch;
    public int wrinkles;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_membrane_state
{
    public fixed double stretch[2];
    public fixed double tension[2];
    public sb_vec3 direction;
    public sb_membrane_form form;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cavity_def
{
    public int* faces;
    public int face_count;
    public int corners;
    public sb_cavity_kind kind;
    public double pressure;
    public double ambient;
    public double exponent;
    public double bulk;
    public int point_count;
    public fixed double table_volume[16];
    public fixed double table_pressure[16];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_rigid_def
{
    public double mass;
    public sb_mat3 inertia;
    public sb_vec3 centre;
    public sb_quat turn;
    public sb_vec3 velocity;
    public sb_vec3 spin;
    public int* nodes;
    public int node_count;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_rigid_motion
{
    public sb_vec3 centre;
    public sb_quat turn;
    public sb_vec3 velocity;
    public sb_vec3 spin;
    public sb_vec3 force;
    public sb_vec3 torque;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_embedding_def
{
    public sb_mesh* mesh;
    public sb_vec3* points;
    public int point_count;
    public sb_mesh* surface;
    public sb_vec3* normals;
    public sb_embedding_kind kind;
    public double max_distance;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public uint cookie;
}
public struct sb_embedding { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_embedding_report
{
    public int point_count;
    public int node_count;
    public int inside;
    public int offset;
    public int frame;
    public int extrapolated;
    public int lost;
    public double max_distance;
    public int farthest_point;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_embedded_point
{
    public sb_embedding_hold hold;
    public int element;
    public fixed double xi[3];
    public double distance;
    public fixed double step[3];
    public int lost;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_embedding_rows
{
    public sb_mapping mapping;
    public int* row_start;
    public int* nodes;
    public double* weights;
    public sb_allocator allocator;
}
public struct sb_skin { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_constraint_term
{
    public int node;
    public int axis;
    public double coefficient;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_tie_report
{
    public int tied_count;
    public int free_count;
    public int farthest_node;
    public int supported_count;
    public double largest_gap;
    public int first_constraint;
    public int constraint_count;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_static_report
{
    public sb_stop_reason reason;
    public int iterations;
    public double force;
    public double energy;
    public double increment;
    public double floor;
    public sb_newton newton;
    public sb_precond_kind solver;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_step_info
{
    public int newton_iterations;
    public int pcg_iterations;
    public int substeps;
    public int load_steps;
    public double load_factor;
    public double residual;
    public int capped;
    public double seconds_force;
    public double seconds_tangent;
    public double seconds_precond;
    public double seconds_solve;
    public double seconds_total;
    public sb_error error;
    public sb_static_report statics;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_static_options
{
    public int load_steps;
    public double tolerance;
    public int max_newton;
    public int max_iterations;
    public int quasi_newton;
    public sb_newton newton;
    public sb_start start;
    public int forces_only;
    public int keep_progress;
    public int instantaneous;
    public IntPtr progress;
    public void* progress_user;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_modes_options
{
    public sb_mass_kind mass;
    public int at_present;
    public double tolerance;
    public int max_iterations;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_modes_info
{
    public int iterations;
    public int solves;
    public int pcg_iterations;
    public double residual;
    public double seconds;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_unload_def
{
    public sb_body_def body;
    public IntPtr dress;
    public void* user;
    public sb_static_options statics;
    public double tolerance;
    public int max_iterations;
    public int load_steps;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_unload_report
{
    public int solves;
    public int load_steps;
    public double share;
    public double gap;
    public double size;
    public double moved;
    public sb_error error;
}
public struct sb_recording { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_recording_info
{
    public int commands;
    public int steps;
    public int complete;
    public int recording;
    public UIntPtr bytes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_recording_report
{
    public int commands;
    public int steps;
    public int step;
    public sb_result expected;
    public sb_result actual;
    public ulong expected_hash;
    public ulong actual_hash;
    public int first_node;
    public int last_node;
    public double distance;
    public sb_error error;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_parameter
{
    public sb_parameter_kind kind;
    public int region;
    public int constant;
    public int load_id;
    public int row;
    public int axis;
    public int* nodes;
    public int node_count;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_recording_loss
{
    public IntPtr add_slope;
    public void* user;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_recording_slopes
{
    public double* gradient;
    public sb_vec3* displacement;
    public sb_vec3* velocity;
    public sb_vec3* force;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_measurement
{
    public sb_mapping* rows;
    public sb_vec3* points;
    public double sigma_point;
    public int* force_nodes;
    public int force_count;
    public sb_vec3 force;
    public double sigma_force;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_identify_def
{
    public sb_body* body;
    public sb_parameter* parameters;
    public int count;
    public int free_count;
    public double* low;
    public double* high;
    public int state_count;
    public sb_measurement* measurements;
    public IntPtr apply;
    public void* user;
    public int max_iterations;
    public sb_static_options statics;
    public double* correlations;
    public double* direction;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_identify_info
{
    public int iterations;
    public int solves;
    public int readings;
    public double chi2;
    public double start_chi2;
    public int warnings;
    public double weakest;
    public int weakest_parameter;
    public fixed byte hidden[160];
}
public struct sb_network { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_network_def
{
    public sb_allocator allocator;
    public sb_jobs jobs;
    public UIntPtr max_bytes;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_network_shape
{
    public fixed int counts[3];
    public int inputs;
    public int outputs;
    public int layers;
    public sb_vec3 spacing;
    public double length;
    public double poisson;
    public double multiply_adds;
    public UIntPtr bytes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_network_input
{
    public int* nodes;
    public sb_vec3* displacements;
    public int count;
    public sb_network_policy policy;
    public double limit;
    public sb_static_options* statics;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_network_info
{
    public int taken;
    public double size;
    public double force;
    public double residual;
    public double from_rest;
    public double from_last;
    public sb_step_info solve;
}
public struct sb_heat { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_heat_tissue
{
    public double conductivity;
    public double capacity;
    public double perfusion;
    public double metabolic;
    public double latent_heat;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_heat_region
{
    public int region;
    public sb_heat_tissue tissue;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_heat_def
{
    public sb_heat_tissue tissue;
    public sb_heat_region* regions;
    public int region_count;
    public double* perfusion;
    public double* metabolic;
    public double start;
    public double blood;
    public double latent_low;
    public double latent_high;
    public double log_frequency;
    public double activation;
    public double harmless;
    public int keeps_perfusion;
    public double stiffening;
    public double tolerance;
    public int max_iterations;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_heat_flows
{
    public double source;
    public double metabolic;
    public double perfused;
    public double convected;
    public double held;
    public double stored;
    public double error;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_heat_info
{
    public int iterations;
    public int systems;
    public double residual;
    public sb_heat_flows flows;
    public double highest;
    public int highest_node;
    public double dead_volume;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_pose
{
    public sb_vec3 position;
    public sb_quat rotation;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_tool_def
{
    public sb_tool_shape shape;
    public double radius;
    public sb_vec3* points;
    public int point_count;
    public sb_vec3 half;
    public sb_mesh* surface;
    public int cells;
    public double friction;
    public sb_pose pose;
    public double coupling_stiffness;
    public double coupling_turning;
    public double max_force;
    public uint cookie;
}
public struct sb_contact { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_contact_def
{
    public sb_body* body;
    public double stiffness;
    public int max_iterations;
    public int max_contacts;
    public int max_tools;
    public sb_skin* skin;
    public int pairs;
    public double pair_friction;
    public double pair_distance;
    public sb_allocator* allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_wrench
{
    public sb_vec3 force;
    public sb_vec3 torque;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_grip
{
    public sb_vec3 axis;
    public double force;
    public sb_vec3 place;
    public sb_wrench net;
    public double sticking;
    public double used;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_contact_point
{
    public int tool;
    public int element;
    public int face;
    public int other_element;
    public int other_face;
    public int sticks;
    public double gap;
    public double area;
    public sb_vec3 point;
    public sb_vec3 normal;
    public sb_vec3 force;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_contact_info
{
    public int candidates;
    public int touching;
    public int sticking;
    public int iterations;
    public int retries;
    public int capped;
    public int thinned;
    public int mended;
    public int inside;
    public double deepest;
    public double residual;
    public double lag;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_tool_state
{
    public fixed double position[3];
    public fixed double rotation[9];
    public fixed double velocity[3];
    public fixed double angular_velocity[3];
    public double time;
    public uint buttons;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_wrench_d
{
    public fixed double force[3];
    public fixed double torque[3];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_haptic_def
{
    public sb_contact* contact;
    public int tool;
    public double max_force;
    public double max_torque;
    public double max_stiffness;
    public double max_damping;
    public double max_slew;
    public double coupling;
    public double coupling_turning;
    public double resolution;
    public double scale_motion;
    public double scale_force;
    public double timeout;
    public double energy_rate;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_haptic_info
{
    public long calls;
    public long frames;
    public long refused;
    public long limited;
    public double energy;
    public double age;
    public double period;
    public double gap;
    public fixed double position[3];
    public fixed double rotation[9];
}
public struct sb_haptic { }
public struct sb_cut { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cut_def
{
    public sb_body* body;
    public int lattice;
    public sb_cut_front front;
    public double glue;
    public double toughness;
    public double least_piece;
    public int max_strokes;
    public sb_allocator allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cut_info
{
    public int links;
    public int ringed;
    public int torn;
    public int cells;
    public int nodes;
    public int parts;
    public int glued;
    public double glued_area;
    public double released_area;
    public double released_energy;
    public int crumbs;
    public double removed_volume;
    public double removed_mass;
    public sb_vec3 removed_momentum;
    public sb_vec3 force;
    public sb_vec3 torque;
    public double work;
    public double owed;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_tear_options
{
    public int nucleate;
    public int max_tears;
    public uint cookie;
}
public struct sb_cut_surface { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cut_origin
{
    public int element;
    public fixed int nodes[4];
    public fixed double weights[4];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cut_drawing
{
    public int vertex_count;
    public int triangle_count;
    public sb_vec3* positions;
    public sb_vec3* normals;
    public sb_vec3* rest;
    public IntPtr texture;
    public sb_cut_origin* origins;
    public int* points;
    public IntPtr triangles;
    public byte* tags;
    public int* cells;
    public int first_triangle;
    public int triangle_end;
    public int first_vertex;
}
public struct sb_cut_fine { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cut_fine_source
{
    public fixed int vertices[3];
    public fixed double weights[3];
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct sb_cut_fine_drawing
{
    public sb_cut_drawing drawn;
    public sb_cut_fine_source* sources;
    public int open_edges;
}
public struct ndl_rod { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_rod_section
{
    public double radius;
    public double inner_radius;
    public double young;
    public double poisson;
    public double density;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_rod_stiffness
{
    public double stretch;
    public fixed double bending[2];
    public double twist;
    public double line_density;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_rod_def
{
    public sb_vec3* nodes;
    public int node_count;
    public int capacity;
    public ndl_rod_section section;
    public ndl_rod_stiffness* stiffness;
    public ndl_rod_rest rest;
    public double* rest_curvature;
    public sb_vec3 director;
    public int clamped;
    public sb_vec3 gravity;
    public double damping_stretch;
    public double damping_bending;
    public int max_newton;
    public double tolerance;
    public sb_allocator allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_rod_info
{
    public int newton_iterations;
    public double residual;
    public int capped;
    public int damped;
    public sb_error error;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_rod_static_options
{
    public int max_newton;
    public double tolerance;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_frame
{
    public sb_vec3 m1;
    public sb_vec3 m2;
    public sb_vec3 t;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_rod_energy
{
    public double stretch;
    public double bend;
    public double twist;
    public double kinetic;
    public double grip;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_surface_hit
{
    public int tet;
    public int face;
    public double along;
    public sb_vec3 X;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_remesh_def
{
    public sb_body* body;
    public int max_needles;
    public ndl_interface_rule interfaces;
    public double smooth_below;
    public double release_above;
    public int max_smoothed;
    public double entry_slip;
    public sb_allocator allocator;
    public uint cookie;
}
public struct ndl_remesh { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_remesh_info
{
    public ndl_operation operation;
    public int undone;
    public int substeps;
    public int candidates;
    public int smoothed;
    public int released;
    public int outside;
    public double worst_quality;
    public sb_vec3 X;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_tip_pose
{
    public sb_vec3 position;
    public ndl_frame frame;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_bevel
{
    public ndl_bevel_law law;
    public double angle;
    public double curvature;
    public double guide;
    public double lag;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_obstacle
{
    public ndl_obstacle_kind kind;
    public sb_vec3 a;
    public sb_vec3 b;
    public double radius;
    public sb_shape* shape;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_plan_piece
{
    public double turn;
    public double twist;
    public double length;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_plan
{
    public ndl_plan_outcome outcome;
    public int piece_count;
    public ndl_plan_piece pieces_0, pieces_1, pieces_2;
    public double length;
    public double distance;
    public double bound;
    public double clearance;
    public int boxes;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_plan_def
{
    public double curvature;
    public double max_length;
    public double max_twist;
    public int turn;
    public double tolerance;
    public int max_boxes;
    public ndl_obstacle* obstacles;
    public int obstacle_count;
    public double clearance;
    public int max_pieces;
    public int samples;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_steer_command
{
    public ndl_steer_status status;
    public double insertion;
    public double turn;
    public double distance;
    public double expected;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_steer_def
{
    public ndl_plan_def plan;
    public double reserve;
    public double step;
    public double max_turn;
    public double turn_gain;
    public double turn_first;
    public int max_wait;
    public double reach;
    public int max_updates;
    public double learn;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_steer
{
    public ndl_steer_def def;
    public ndl_steer_status status;
    public double inserted;
    public int updates;
    public int plans;
    public int waited;
    public int next_search;
    public int waypoint_count;
    public sb_vec3 waypoints_0, waypoints_1;
    public ndl_plan plan;
    public double curvature;
    public sb_vec3 drift;
    public ndl_tip_pose tip;
    public sb_vec3 way;
    public sb_vec3 first;
    public double advance;
    public double weight;
    public int bends;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_push_def
{
    public sb_mat3 compliance;
    public sb_vec3 line_point;
    public sb_vec3 line_direction;
    public double clear_radius;
    public sb_vec3 direction;
    public double cone;
    public double max_force;
    public double proportional;
    public double integral;
    public double max_rate;
    public double tolerance;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_push
{
    public ndl_push_def def;
    public sb_vec3 integral;
    public sb_vec3 force;
    public sb_vec3 error;
    public int arrived;
    public int limited;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_push_place
{
    public sb_vec3 direction;
    public double cone;
    public double max_force;
    public double weight;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_guide_def
{
    public sb_vec3 target;
    public sb_vec3 entry;
    public sb_vec3 direction;
    public double entry_radius;
    public double max_lean;
    public double shift;
    public ndl_obstacle* obstacles;
    public int obstacle_count;
    public double clearance;
    public ndl_push_place* places;
    public int place_count;
    public IntPtr model;
    public void* user;
    public double tolerance;
    public int samples;
    public int climbs;
    public uint seed;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_guide_phase
{
    public ndl_push_def push;
    public sb_vec3 point;
    public int obstacle;
    public int place;
    public sb_vec3 force;
    public double depth;
    public double left;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_guide
{
    public int reaches;
    public sb_vec3 entry;
    public sb_vec3 direction;
    public double length;
    public double clearance;
    public double cost;
    public int phase_count;
    public ndl_guide_phase phases_0, phases_1, phases_2, phases_3, phases_4, phases_5, phases_6, phases_7;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_couple_info
{
    public int trials;
    public int consistent;
    public int iterations;
    public int capped;
    public double residual;
}
public struct ndl_needle { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_friction
{
    public double friction;
    public double viscous;
    public double cutting;
    public double twist_stiffness;
    public double twist_friction;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_membrane
{
    public fixed int regions[2];
    public double strength;
    public double thickness;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_needle_def
{
    public sb_body* body;
    public ndl_follow follow;
    public sb_vec3 @base;
    public sb_vec3 direction;
    public sb_vec3 director;
    public double length;
    public double edge_length;
    public int capacity;
    public ndl_rod_section section;
    public ndl_rod_stiffness* stiffness;
    public double damping_stretch;
    public double damping_bending;
    public sb_vec3 gravity;
    public ndl_bevel bevel;
    public double bend_length;
    public double bend_curvature;
    public ndl_friction* frictions;
    public int friction_count;
    public ndl_membrane* membranes;
    public int membrane_count;
    public IntPtr cutting;
    public void* cutting_user;
    public double entry_slip;
    public int max_trials;
    public sb_allocator allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_command
{
    public double insertion;
    public double twist;
    public sb_vec3 velocity;
    public sb_vec3 angular_velocity;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct ndl_step_info
{
    public int substeps;
    public double peak_base;
    public int trials;
    public int consistent;
    public int iterations;
    public int capped;
    public double residual;
    public int static_nodes;
    public int dynamic_nodes;
    public int operations;
    public double worst_quality;
    public int blocked;
    public int torn;
    public int limited;
    public int coarse;
    public sb_step_info body;
    public double seconds_body;
    public double seconds_couple;
    public double seconds_needle;
    public double seconds_remesh;
    public double seconds_total;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_rigid
{
    public sb_mat3 rotation;
    public sb_vec3 translation;
}
public struct reg_kdtree { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_cloud
{
    public sb_vec3* points;
    public sb_vec3* normals;
    public int count;
    public sb_allocator allocator;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_smooth_info
{
    public double noise;
    public double left;
    public int outliers;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_field_def
{
    public reg_field_kind kind;
    public sb_mesh* surface;
    public sb_vec3* points;
    public sb_vec3* normals;
    public int point_count;
    public sb_vec3 low;
    public sb_vec3 high;
    public int cells;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public uint cookie;
}
public struct reg_field { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_field_hit
{
    public sb_vec3 point;
    public sb_vec3 normal;
    public double distance;
    public int item;
    public int on_border;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_field_sample
{
    public double phi;
    public double phi_n;
    public double phi_nn;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_icp_shape
{
    public sb_vec3* points;
    public int count;
    public sb_vec3* normals;
    public double* weights;
    public double* sd;
    public sb_surface* surface;
    public reg_kdtree* tree;
    public int has_camera;
    public sb_vec3 camera;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_icp_landmark
{
    public sb_vec3 model;
    public sb_vec3 target;
    public double weight;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_icp_options
{
    public reg_icp_overlap overlap;
    public reg_icp_metric metric;
    public int search;
    public reg_rigid start;
    public double start_shift_sd;
    public double start_turn_sd;
    public sb_vec3 seen_from;
    public double seen_from_sd;
    public reg_icp_landmark* landmarks;
    public int landmark_count;
    public reg_outliers outliers;
    public double outlier_parameter;
    public double max_distance;
    public int sample;
    public int max_iterations;
    public double tolerance;
    public IntPtr clock;
    public double max_seconds;
    public sb_allocator allocator;
    public int cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_icp_info
{
    public reg_icp_stop stop;
    public int iterations;
    public int candidates;
    public int pairs;
    public double overlap;
    public double mean;
    public double rms;
    public double landmark_rms;
    public double seconds;
    public uint warnings;
    public int pose_count;
    public reg_rigid poses_0, poses_1, poses_2, poses_3, poses_4, poses_5, poses_6, poses_7;
    public fixed double likelihood[8];
    public double margin;
    public double noise;
    public double seen;
    public double scale_guess;
    public fixed double covariance[36];
    public sb_vec3 centre;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_cpd_info
{
    public int iterations;
    public int rank;
    public reg_cpd_stop stop;
    public double sigma;
    public double explained;
    public double change;
    public double objective;
    public double pairs;
    public double seconds;
    public double kernel_seconds;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_cpd_options
{
    public reg_cpd_kind kind;
    public double outliers;
    public double beta;
    public double lambda;
    public int shared_frame;
    public double start_sigma;
    public double kernel_tolerance;
    public int max_rank;
    public double sum_tolerance;
    public double tolerance;
    public int max_iterations;
    public double max_seconds;
    public double max_pairs;
    public int landmark_count;
    public int* landmark_points;
    public sb_vec3* landmark_targets;
    public double landmark_sigma;
    public IntPtr progress;
    public void* progress_user;
    public IntPtr clock;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public uint cookie;
}
public struct reg_cpd { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_match_def
{
    public sb_body* body;
    public sb_mesh* surface;
    public sb_mesh* target;
    public sb_vec3* target_points;
    public sb_vec3* target_normals;
    public int target_count;
    public reg_match_method method;
    public int cells;
    public int partial;
    public double reach;
    public double last_reach;
    public double least_cosine;
    public double least_active;
    public double sampling;
    public double first_charge;
    public double last_charge;
    public double least_growth;
    public double most_growth;
    public sb_vec3* landmarks;
    public sb_vec3* landmark_targets;
    public int landmark_count;
    public double landmark_stiffness;
    public double settled;
    public double max_seconds;
    public IntPtr clock;
    public sb_allocator allocator;
    public uint cookie;
}
public struct reg_match { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_match_info
{
    public int iterations;
    public reg_match_stop stop;
    public double mean_distance;
    public double max_distance;
    public double landmark_distance;
    public double active;
    public double charge;
    public double change;
    public int pcg_iterations;
    public double seconds;
    public double seconds_field;
    public double seconds_system;
    public double seconds_solve;
    public sb_error error;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_match_sample
{
    public sb_vec3 point;
    public double area;
    public double distance;
    public int active;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_nicp_def
{
    public sb_body* body;
    public sb_grid* grid;
    public sb_mesh* surface;
    public int sources;
    public sb_mesh* target;
    public sb_vec3* target_points;
    public sb_vec3* target_normals;
    public int target_count;
    public int samples;
    public reg_nicp_view view;
    public sb_vec3 camera;
    public double blending;
    public double sliding;
    public int noisy;
    public double least_cosine;
    public reg_outliers outliers;
    public double outlier_parameter;
    public double reach;
    public double last_reach;
    public double first_stiffness;
    public double last_stiffness;
    public int increments;
    public int iterations;
    public int newton;
    public double newton_tolerance;
    public double tolerance;
    public double least_active;
    public sb_vec3* landmarks;
    public sb_vec3* landmark_targets;
    public int landmark_count;
    public double landmark_stiffness;
    public double max_seconds;
    public IntPtr clock;
    public sb_allocator allocator;
    public uint cookie;
}
public struct reg_nicp { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_nicp_info
{
    public int iterations;
    public int increment;
    public reg_nicp_stop stop;
    public double mean_distance;
    public double max_distance;
    public double landmark_distance;
    public double active;
    public int visible;
    public int pruned;
    public double stiffness;
    public double change;
    public int newton_iterations;
    public int pcg_iterations;
    public double seconds;
    public double seconds_pairs;
    public double seconds_solve;
    public sb_error error;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_nicp_source
{
    public int vertex;
    public sb_vec3 point;
    public sb_vec3 goal;
    public double area;
    public double distance;
    public int visible;
    public int active;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_loads_def
{
    public reg_match* match;
    public int samples;
    public int rounds;
    public int reweights;
    public double misfit;
    public double power;
    public double floor;
    public double landmark;
    public double drag;
    public double pose;
    public double max_seconds;
    public IntPtr clock;
    public sb_allocator allocator;
    public uint cookie;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_loads_info
{
    public int rounds;
    public double mean_distance;
    public double sample_misfit;
    public double change;
    public sb_vec3 drag;
    public double loaded;
    public double seconds;
    public double seconds_response;
    public double seconds_dense;
    public sb_error error;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_model_def
{
    public sb_mesh* mesh;
    public sb_mesh* surface;
    public double poisson;
    public int* @fixed;
    public int fixed_count;
    public sb_allocator allocator;
    public sb_jobs jobs;
    public uint cookie;
}
public struct reg_model { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_points
{
    public sb_vec3* points;
    public sb_vec3* normals;
    public double* sd;
    public double* weights;
    public int count;
    public sb_mesh* surface;
    public int has_camera;
    public sb_vec3 camera;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_landmark
{
    public sb_vec3 model;
    public sb_vec3 seen;
    public double sd;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_curve
{
    public sb_vec3* model;
    public int model_count;
    public sb_vec3* seen;
    public int seen_count;
    public double sd;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_infer_def
{
    public reg_model* model;
    public reg_points target;
    public reg_landmark* landmarks;
    public int landmark_count;
    public reg_curve* curves;
    public int curve_count;
    public reg_rigid start;
    public double start_sd;
    public double start_turn;
    public int gravity;
    public double* pressed;
    public int samples;
    public int rounds;
    public double max_seconds;
    public IntPtr clock;
    public uint cookie;
}
public struct reg_infer { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_quality
{
    public reg_infer_stop stop;
    public uint warnings;
    public reg_prior_kind prior;
    public double prior_margin;
    public double pressure_margin;
    public double pressure;
    public double belief;
    public double sure;
    public double seen;
    public double used;
    public double noise;
    public double misfit;
    public double residual;
    public double residual_p95;
    public double expected;
    public double expected_worst;
    public fixed double pose_sd[2];
    public double largest_strain;
    public double volume_ratio;
    public double change;
    public int rounds;
    public double seconds;
    public double seconds_response;
    public double seconds_choice;
    public double seconds_draws;
}
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_track_def
{
    public reg_model* model;
    public reg_infer* start;
    public reg_rigid pose;
    public double pose_sd;
    public double pose_turn;
    public int modes;
    public int patches;
    public int most_points;
    public double motion;
    public double memory;
    public double wander;
    public double turn;
    public double misfit;
    public double lost_after;
    public reg_landmark* landmarks;
    public int landmark_count;
    public reg_curve* curves;
    public int curve_count;
    public IntPtr clock;
    public uint cookie;
}
public struct reg_track { }
[StructLayout(LayoutKind.Sequential)]
public unsafe struct reg_track_info
{
    public reg_track_state state;
    public double time;
    public double blind;
    public double seen;
    public double used;
    public double noise;
    public double trusted;
    public double residual;
    public double innovation;
    public double expected;
    public double seconds;
    public sb_error error;
}
public static unsafe class Native
{
    public const string Library = "softbody";
    public const int SB_OUTPUT_PATH = 4096;
    public const int SB_MAX_ELEMENT_NODES = 32;
    public const int SB_MAX_FACE_NODES = 9;
    public const int SB_MAX_ELEMENT_FACES = 12;
    public const int SB_MAX_ELEMENT_EDGES = 24;
    public const int SB_MAX_QUADRATURE_POINTS = 27;
    public const int SB_MESH_SET_NAME = 64;
    public const int SB_LOAD_NOTES = 10;
    public const int SB_LOAD_NOTE_LENGTH = 192;
    public const int SB_LABEL_MAX_SMOOTHING = 8;
    public const int SB_SURFACE_FINDING_COUNT = 12;
    public const int SB_SURFACE_NOT_SOLID = 2439;
    public const int SB_MAX_PRONY_TERMS = 8;
    public const int SB_MAX_OGDEN_TERMS = 4;
    public const int SB_X = 1;
    public const int SB_Y = 2;
    public const int SB_Z = 4;
    public const int SB_XYZ = 7;
    public const int SB_MAX_MEAN_POINTS = 4;
    public const int SB_PRECOND_PIECES_AUTO = -1;
    public const int SB_PRECOND_MAX_POWER = 3;
    public const int SB_GRID_EMPTY = -1;
    public const int SB_GRID_MAX_SHAPES = 30;
    public const int SB_GRID_MAX_LEVEL = 8;
    public const int SB_MIXTURE_MAX_SHAPES = 30;
    public const int SB_MIXTURE_MAX_LEVEL = 16;
    public const int SB_MAX_NEIGHBOURS = 31;
    public const int SB_AUTO = -1;
    public const int SB_CHECK_SIZE = 1;
    public const int SB_CHECK_DENSITY = 2;
    public const int SB_CHECK_STIFFNESS = 4;
    public const int SB_CHECK_SLIVERS = 8;
    public const int SB_CHECK_LOCKING = 16;
    public const int SB_CHECK_UNREFERENCED = 32;
    public const int SB_CHECK_UNSUPPORTED = 64;
    public const int SB_CHECK_COMPONENTS = 128;
    public const int SB_CHECK_DUPLICATES = 256;
    public const int SB_NODE_COPY = 1;
    public const int SB_NODE_KEEP_X = 2;
    public const int SB_NODE_KEEP_Y = 4;
    public const int SB_NODE_KEEP_Z = 8;
    public const int SB_MAX_CAVITY_POINTS = 16;
    public const int SB_MAX_RIGID = 96;
    public const int SB_TIE_CLOSE_GAPS = 1;
    public const int SB_TIE_ALL = 2;
    public const int SB_IDENTIFY_HIDDEN = 1;
    public const int SB_IDENTIFY_MISFIT = 2;
    public const int SB_IDENTIFY_BOUND = 4;
    public const int SB_IDENTIFY_LOCKS = 8;
    public const int SB_NETWORK_CHANNELS = 7;
    public const int SB_TOOL_MAX_POINTS = 64;
    public const int SB_TOOL_MIN_CELLS = 16;
    public const int SB_TOOL_MAX_CELLS = 128;
    public const int NDL_PLAN_PIECES = 3;
    public const int NDL_GUIDE_PHASES = 8;
    public const int NDL_GUIDE_PLACES = 32;
    public const int NDL_MAX_NEEDLES = 16;
    public const int REG_ICP_POSES = 8;
    public const int REG_INFER_DRAWS = 32;
    /// <summary>
    /// Name of a result, e.g. "SB_ERROR_MEMORY"; never NULL. Thread-safe, static storage.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* sb_result_string(sb_result result);
    /// <summary>
    /// Begins to write a file; binary, on every system. path is borrowed until it is closed.
    ///
    /// A file that is there stays as it is, and readable, until sb_output_close; its permissions pass on to the new one, its
    /// hard links stay with the old one, and symbolic links keep pointing to it. It must be writable, and a file can be made
    /// in its folder. Devices, pipes and other things that are no plain files are written where they stand.
    ///
    /// out is written on success and on failure. Nothing is allocated but by fopen. SB_ERROR_ARGUMENT (NULL) or
    /// SB_ERROR_FILE: then nothing is to be closed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_output_open(sb_output* @out, byte* path, sb_error* error);
    /// <summary>
    /// Ends it. SB_ERROR_FILE when anything could not be written since it was opened, or the target cannot be replaced: then
    /// the target is as it was before, and nothing is left beside it.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_output_close(sb_output* @out, sb_error* error);
    /// <summary>
    /// Ends it without a result: the target is as it was before.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_output_discard(sb_output* @out);
    /// <summary>
    /// Writes bytes[size] as a file, by the three above: a saved state, recording, needle or preconditioner, say. bytes may
    /// be NULL when size is 0. SB_ERROR_ARGUMENT or SB_ERROR_FILE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_file_save(byte* path, void* bytes, UIntPtr size, sb_error* error);
    /// <summary>
    /// out[row_count] = H^T x: what the rows are of x[nodes]: their points of positions, their displacements of
    /// displacements. Not checked: nodes must be within x. out and x do not overlap.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mapping_apply(sb_mapping* mapping, sb_vec3* x, sb_vec3* @out);
    /// <summary>
    /// forces[nodes] += H f: forces f[row_count] at the rows' points, brought to their nodes.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mapping_spread(sb_mapping* mapping, sb_vec3* f, sb_vec3* forces);
    /// <summary>
    /// Name of a type, e.g. "tet4"; "custom" for SB_CUSTOM, "unknown" for none of them. Static storage.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* sb_element_name(sb_element_type type);
    /// <summary>
    /// Local node numbers of face `face` in [0, face_count), counter-clockwise seen from outside, and the face's
    /// type (tri3, tri6, quad4, quad8, quad9; face_type may be NULL). Returns the number of nodes, 0 (nothing written)
    /// for no such face.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_element_face(sb_element_type type, int face, int* nodes, sb_element_type* face_type);
    /// <summary>
    /// Local node numbers of edge `edge` in [0, edge_count): both ends, then the node between them or -1. Returns
    /// the number of nodes on the edge (2 or 3), 0 (nothing written) for no such edge.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_element_edge(sb_element_type type, int edge, int* nodes);
    /// <summary>
    /// Parameters of local node `node`; returns 1, or 0 (nothing written) for no such node.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_element_node_point(sb_element_type type, int node, double* xi);
    /// <summary>
    /// Shape functions N and their gradients dN/dxi at xi. shape: [nodes] or NULL; gradient: [nodes][3] or NULL,
    /// the third component 0 for surfaces. Nothing is written for an unknown type.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_element_shape(sb_element_type type, double* xi, double* shape, IntPtr gradient);
    /// <summary>
    /// Points (parameters xi) and weights of a rule; the weights sum to the parameter domain's measure (tet 1/6,
    /// triangle 1/2, hex 8, quad 4). Returns the number of points, 0 (nothing written) when there is no such rule.
    /// Point order: tets by the corner a point is nearest to, hexes with xi fastest, as in Abaqus and CalculiX.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_element_quadrature(sb_element_type type, sb_quadrature_kind kind, IntPtr points, double* weights);
    /// <summary>
    /// Checks whether a table describes an element that can be computed with, or a cloud. SB_ERROR_ARGUMENT (null pointer, a
    /// count out of range, weights not positive or with another sum than the volume inside the faces, faces that do not
    /// close or look inward, functions that are not 1 at their node and 0 at others, do not sum to 1 or do not reproduce xi,
    /// gradients that are not their slopes, a node without mass), SB_ERROR_INDEX (a face's node), SB_ERROR_NOT_FINITE; the
    /// message names what, and error-&gt;node the local node where there is one. error may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_element_table_check(sb_element_table* table, sb_error* error);
    /// <summary>
    /// Releases the arrays through mesh-&gt;allocator and zeroes the struct. Safe on {0} and on NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mesh_free(sb_mesh* mesh);
    /// <summary>
    /// Deep copy with memory from `allocator`.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_copy(sb_mesh* mesh, sb_allocator* allocator, sb_mesh* copy, sb_error* error);
    /// <summary>
    /// Appends nodes and elements of `other`, which has the same element type (and table), to the mesh: they get the numbers
    /// after its own, and no node is merged. Regions are kept (0 where one of the two has none). New arrays come
    /// from mesh-&gt;allocator, the old ones go back to it; `other` may be the mesh itself. On failure
    /// (SB_ERROR_ARGUMENT also for different types, _MESH for more than 2^31-1 nodes or elements, _INDEX,
    /// _NOT_FINITE, _MEMORY) the mesh is as it was.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_append(sb_mesh* mesh, sb_mesh* other, sb_error* error);
    /// <summary>
    /// Checks whether a mesh can be computed with: counts, finite nodes, index range, repeated nodes and, for
    /// volumes, a positive Jacobian (at the corners; curved tet10, hex20 and hex27 also at their other nodes, on their faces
    /// and inside; custom elements, whose table is checked too, at their points). SB_ERROR_ARGUMENT, _NOT_FINITE
    /// (error-&gt;node is the first), _INDEX or _MESH (error-&gt;element is the first; the message lists up to 8 elements and
    /// the total). Allocates nothing; one pass.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_validate(sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Lists everything suspicious about a mesh in one report, whatever the arrays hold. SB_OK also for a bad
    /// mesh; fails with SB_ERROR_ARGUMENT (counts, type, null arrays) or SB_ERROR_MEMORY only. Elements with an
    /// index out of range or a repeated node take no part in the topology, bad ones none in volume, area and
    /// quality. O(nodes + elements).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_check(sb_mesh* mesh, sb_allocator* allocator, sb_mesh_report* report, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mesh_report_free(sb_mesh_report* report);
    /// <summary>
    /// Volume of an element (m^3), exact for curved ones too; negative when inverted; 0 for surfaces.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_mesh_element_volume(sb_mesh* mesh, int element);
    /// <summary>
    /// Volume mesh: its volume (m^3). Surface: the signed volume it encloses, meaningful when it is closed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_mesh_volume(sb_mesh* mesh);
    /// <summary>
    /// Area of a surface mesh (m^2), exact for tri3, by the face quadrature else; 0 for volumes (take the
    /// boundary).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_mesh_surface_area(sb_mesh* mesh);
    /// <summary>
    /// Smallest box around all nodes (m); both corners 0 for a mesh without nodes.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mesh_bounds(sb_mesh* mesh, sb_vec3* low, sb_vec3* high);
    /// <summary>
    /// Shape of an element: 1 is best, &lt;= 0 inverted or flat. tet4: mean ratio 12 (3V)^(2/3) / sum of squared
    /// edges; tet10: that of its corners times min/max of the Jacobian; hex8 and quads: smallest Jacobian at a
    /// corner of edges scaled to length 1; hex20, hex27, custom: the same of the columns dx/dxi at all nodes, face
    /// centres and points (custom: points only); triangles: 4 sqrt(3) A / sum of squared edges (of the corners).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_mesh_element_quality(sb_mesh* mesh, int element);
    /// <summary>
    /// Smallest and largest angle (degrees) between two faces of an element, over all elements of a tet4 or tet10 mesh (of
    /// its corners); both 0 for other types and without elements. Either place may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mesh_dihedral_range(sb_mesh* mesh, double* smallest, double* largest);
    /// <summary>
    /// Turns inverted volume elements (corner volume negative) by renumbering them; surfaces:
    /// sb_mesh_orient_surface. *flipped: how many. Mid-edge nodes move along. Custom elements are left alone. What cannot
    /// be mended that way stays for sb_mesh_validate.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_orient(sb_mesh* mesh, int* flipped, sb_error* error);
    /// <summary>
    /// Orients a surface consistently: floods over the edges of exactly two elements; a closed part is turned
    /// outward (its enclosed volume positive), an open one as most of its elements were. SB_ERROR_MESH when it is
    /// one-sided.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_orient_surface(sb_mesh* mesh, int* flipped, sb_error* error);
    /// <summary>
    /// Merges nodes that lie within `tolerance` (m) of a node before them; negative: 1e-6 of the longest side of
    /// the bounding box; 0: equal coordinates only. *merged: nodes removed. Elements may collapse: validate
    /// afterwards.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_merge_nodes(sb_mesh* mesh, double tolerance, int* merged, sb_error* error);
    /// <summary>
    /// Removes nodes of no element; *removed: how many.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_remove_unreferenced(sb_mesh* mesh, int* removed, sb_error* error);
    /// <summary>
    /// Removes elements with the same corners as an element before them; *removed: how many.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_remove_duplicate_elements(sb_mesh* mesh, int* removed, sb_error* error);
    /// <summary>
    /// Multiplies all coordinates by factor &gt; 0 (0.001: millimetres to metres).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_scale(sb_mesh* mesh, double factor, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_index_table_free(sb_index_table* table);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_index_lists_free(sb_index_lists* lists);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_boundary_free(sb_boundary* boundary);
    /// <summary>
    /// Faces that belong to one element only, in the order of elements and faces. compact 0: the surface keeps all
    /// nodes and the numbering of the volume; 1: it keeps the nodes it uses, in their order.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_boundary(sb_mesh* mesh, int compact, sb_allocator* allocator, sb_boundary* boundary, sb_error* error);
    /// <summary>
    /// Neighbour of each element across each face (surfaces: across each edge), [elements][faces or edges]; -1
    /// where there is none or more than one.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_neighbours(sb_mesh* mesh, sb_allocator* allocator, sb_index_table* neighbours, sb_error* error);
    /// <summary>
    /// Every edge once, corner to corner, [edges][2] with the smaller node first, sorted.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_edges(sb_mesh* mesh, sb_allocator* allocator, sb_index_table* edges, sb_error* error);
    /// <summary>
    /// The elements of each node, ascending.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_node_elements(sb_mesh* mesh, sb_allocator* allocator, sb_index_lists* lists, sb_error* error);
    /// <summary>
    /// Part number of each element, [elements][1], from 0 in the order of their first element; elements that share
    /// a node belong together. *count (or NULL): number of parts.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_components(sb_mesh* mesh, sb_allocator* allocator, sb_index_table* labels, int* count, sb_error* error);
    /// <summary>
    /// The tet10 mesh with straight edges of a tet4 mesh: old nodes first, then one node per edge. Regions are
    /// kept.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_to_tet10(sb_mesh* mesh, sb_allocator* allocator, sb_mesh* tet10, sb_error* error);
    /// <summary>
    /// The hex20 or hex27 mesh with straight edges of a hex8 mesh: old nodes first, then one node per edge, and for hex27
    /// one per face and one per element, each in the middle. Regions are kept.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_to_hex20(sb_mesh* mesh, sb_allocator* allocator, sb_mesh* hex20, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_to_hex27(sb_mesh* mesh, sb_allocator* allocator, sb_mesh* hex27, sb_error* error);
    /// <summary>
    /// Renumbers nodes by reverse Cuthill-McKee and sorts elements by their lowest node: small bandwidth, good
    /// cache use. Worth a call before a body is made of a mesh: a tangent of 9,600 tet10 is assembled in three
    /// quarters of the time it takes with nodes as sb_mesh_beam numbers them, and in less than along a
    /// space-filling curve; tet4 gain little. node_map [nodes] and element_map [elements] (each may be NULL)
    /// receive the new number of each old one.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_reorder(sb_mesh* mesh, int* node_map, int* element_map, sb_error* error);
    /// <summary>
    /// Box from the origin to `size` (m, each &gt; 0) of nx * ny * nz cells (each &gt;= 1); a cell is 1 hex or 6 tets
    /// (Kuhn's). Corner nodes are numbered with x fastest, then y.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_beam(sb_element_type type, int nx, int ny, int nz, sb_vec3 size, sb_allocator* allocator, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Solid cylinder of `radius` and `length` (m, &gt; 0) around coordinate axis 0 (x), 1 (y) or 2 (z), from 0 to
    /// length along it. across: cells over the diameter in [4, 20000], along &gt;= 1: layers. Boundary nodes lie on
    /// the cylinder, so the volume is too small by O(1/across^2). Nodes are numbered layer by layer.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_cylinder(sb_element_type type, int axis, double radius, double length, int across, int along, sb_allocator* allocator, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Solid ellipsoid around the origin with semi-axes (m, each &gt; 0); cells over each diameter in [4, 500].
    /// Boundary nodes lie on the ellipsoid.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_ellipsoid(sb_element_type type, sb_vec3 semi_axes, int cells, sb_allocator* allocator, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// A solid like a human liver for demonstrations: 1.5 litre (1.2 at 4 cells), 20 cm wide (x, the thick right
    /// lobe at negative x), dome above (z up), hollow below, a notch in the front edge (negative y). cells in [4,
    /// 60] over its width; every element is sound (sb_mesh_element_quality above 0.2).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_organ(sb_element_type type, int cells, sb_allocator* allocator, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Releases the arrays and zeroes the struct. Safe on {0} and on NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mesh_sets_free(sb_mesh_sets* sets);
    /// <summary>
    /// The first set with the name (whole, case matters) and dimension (-1: any), or NULL. O(sets).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_mesh_set* sb_mesh_sets_find(sb_mesh_sets* sets, byte* name, int dimension);
    /// <summary>
    /// Scale 1, nothing is repaired, malloc, no report, no sets.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_load_options sb_default_load_options();
    /// <summary>
    /// Reads a mesh from a file.
    ///
    /// mesh     overwritten on success (free it first when it owns arrays), untouched on failure; free it with
    ///          sb_mesh_free
    /// path     the format is by the content, else by the ending. TetGen: the .node or the .ele file, the
    ///          other one is looked for beside it
    /// options  NULL: sb_default_load_options()
    /// error    may be NULL; says file and line (line 0 in binary parts, where the message has the byte offset),
    ///          and the node or element: the cell of the file, counted from 0, or with SB_ERROR_MESH the element
    ///          of the mesh it would have become
    ///
    /// The cells of the highest dimension become the mesh: tet4, tet10, hex8, hex20, hex27, or for surfaces tri3, tri6,
    /// quad4, quad8, quad9. Triangles mixed with quadrilaterals, and polygons of OBJ, PLY, OFF and POLYDATA, become tri3;
    /// polygons are cut into a fan at their first corner, which is right for convex ones. Pyramids, wedges, and hexahedra
    /// that are mixed with other volume cells, are cut into tets that fit: each quadrilateral along the diagonal from its
    /// lowest node. Linear cells give tet4, quadratic ones (tet10, hex20, hex27, wedge15, wedge18, pyramid13, pyramid14)
    /// tet10, whose nodes on diagonals that are not in the file are new, behind those of the file. Linear cells mixed with
    /// quadratic ones, and a quadrilateral against triangles that are cut along its other diagonal, are
    /// SB_ERROR_UNSUPPORTED.
    ///
    /// Node orders of gmsh and TetGen are turned into VTK's. Regions come from the cell field `region` (VTK, VTU), else
    /// `material`, `MaterialIds`, `gmsh:physical`, `medit:ref`, `CellEntityIds` or their like (the report names it), the
    /// first physical group of the volume (gmsh; of the surface in a surface file), the reference (Medit) or the first
    /// attribute (TetGen); regions is NULL when all are 0. VTU: pieces are joined as they are, see sb_mesh_merge_nodes.
    ///
    /// A volume mesh is checked with sb_mesh_validate. When all its elements are inverted, that is the file's
    /// convention: they are turned and counted in the report. A surface is loaded as it is, since scans are seldom
    /// perfect: look at it with sb_mesh_check.
    ///
    /// Not read: VTK's files that are compressed with LZ4 or LZMA, parallel files (.pvtu: load their pieces), polyhedra.
    ///
    /// SB_ERROR_ARGUMENT (null pointer, options), _FILE (cannot be read), _FORMAT, _NOT_FINITE (coordinate, also
    /// one too large for sb_real), _INDEX (node that does not exist), _MESH (inverted or flat elements, no
    /// elements), _UNSUPPORTED (names the version, data set or element type) or _MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_load(sb_mesh* mesh, byte* path, sb_load_options* options, sb_error* error);
    /// <summary>
    /// Reads a mesh from memory, as sb_mesh_load does from a file.
    ///
    /// data     [size] bytes, borrowed during the call; may be NULL when size is 0
    /// format   SB_FILE_AUTO or any but SB_FILE_TETGEN, which needs two files
    /// name     stands for the path in errors and in telling the format; may be NULL
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_load_memory(sb_mesh* mesh, void* data, UIntPtr size, sb_file_format format, byte* name, sb_load_options* options, sb_error* error);
    /// <summary>
    /// Writes a legacy VTK 3.0 unstructured grid in ASCII, with fields, and mesh-&gt;regions as the cell field
    /// `region`. The numbers are exact: %.17g (%.9g when sb_real is float). fields may be NULL when field_count
    /// is 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_save_vtk(byte* path, sb_mesh* mesh, sb_field* fields, int field_count, sb_error* error);
    /// <summary>
    /// The same in VTK's big-endian binary form: smaller, faster, exact.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_save_vtk_binary(byte* path, sb_mesh* mesh, sb_field* fields, int field_count, sb_error* error);
    /// <summary>
    /// OBJ with v and f lines, exact numbers.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_save_obj(byte* path, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Binary STL: coordinates are rounded to float, shared vertices and unused nodes are lost, quad4 become two
    /// triangles.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_save_stl(byte* path, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Binary little-endian PLY, coordinates in the precision of sb_real.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_save_ply(byte* path, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Reads a label image; the format follows from the content.
    ///
    /// image    overwritten on success (free it first when it owns labels), untouched on failure; sb_image_free
    /// options  scale (multiplies origin and spacing) and allocator are read; NULL: sb_default_load_options()
    /// error    may be NULL; file and line (line 0 in binary parts, where the message has the byte offset)
    ///
    /// VTK files: the first array of one number per point (or cell, where no point has one) is taken. Images of two
    /// dimensions have one layer of voxels. Values of any numeric type are taken where they are whole numbers that fit an
    /// int. Header files (.mhd, .nhdr) name their data file, which is looked for beside them, and nowhere else.
    ///
    /// SB_ERROR_ARGUMENT, _FILE, _FORMAT (also: data cut off, more of it than the header says, a value that is no label),
    /// _NOT_FINITE (origin, spacing, a value), _UNSUPPORTED (names what: more dimensions, vectors, a compression, pieces),
    /// _MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_image_load(sb_image* image, byte* path, sb_load_options* options, sb_error* error);
    /// <summary>
    /// The same from data[size] in memory, borrowed during the call; files that name a data file are SB_ERROR_UNSUPPORTED.
    /// name stands for the path in errors; may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_image_load_memory(sb_image* image, void* data, UIntPtr size, byte* name, sb_load_options* options, sb_error* error);
    /// <summary>
    /// 1 when the file begins as a label image does: to choose between sb_image_load and sb_mesh_load. 0 also for a file
    /// that cannot be read.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_image_is_file(byte* path);
    /// <summary>
    /// Releases the labels and zeroes the struct. Safe on {0} and on NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_image_free(sb_image* image);
    /// <summary>
    /// Whether the fields are as described above: SB_ERROR_ARGUMENT (names the field), _NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_image_check(sb_image* image, sb_error* error);
    /// <summary>
    /// The smallest label above `after`: 1 and *label, or 0 when there is none. O(voxels). All labels but background:
    ///     for (int label = 0; sb_image_next_label(&amp;image, label, &amp;label);) ...   (those below 0: start at INT_MIN)
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_image_next_label(sb_image* image, int after, int* label);
    /// <summary>
    /// Label of the voxel that holds the point (m); 0 outside the image. Labels of many points: sb_image_set_regions.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_image_label_at(sb_image* image, sb_vec3 point);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_label_def sb_default_label_def();
    /// <summary>
    /// The boundary of labels as a mesh of tri3, oriented outward (cavities inward), closed and manifold whatever the
    /// voxels: no edge of more or fewer than two triangles, no node where parts touch, no two triangles that cross. It
    /// passes between the centres of voxels inside and outside, all of which stay on their side, so nothing is lost and
    /// nothing joins: also what is one voxel thick. Voxels that touch along an edge or in a corner only are parts of their
    /// own. Beyond the image is outside.
    ///
    /// The inside (1) and the outside (0) are filtered along each axis of the image by (1 2 1) / 4, `smoothing` times: G.
    /// What that takes from round parts comes back in (2 + sqrt 2) G - (1 + sqrt 2) G G, and the level near 1/2 (by up to
    /// 1/8) is taken at which the surface encloses the voxels' volume. Voxels that end up on the wrong side get a value that
    /// puts the surface half-way to their neighbours. Measured: the volume is that of the voxels to 1e-4 for balls of radius
    /// 2 to 22 voxels, a torus, and plates 1, 2 and 3 voxels thick; single voxels and the smallest parts lose up to 5/6 of
    /// theirs. Look at report-&gt;volume where parts are that small.
    ///
    /// mesh: overwritten, not freed. report: or NULL. Failures leave both untouched: SB_ERROR_ARGUMENT (a field, named; no
    /// voxel has the labels), _NOT_FINITE (of the image), _UNSUPPORTED (more nodes or triangles than an int counts),
    /// _MEMORY. Two triangles for each face between voxels, and more where the surface is rough. Scratch: 8 bytes for each
    /// voxel of the box round the labels. O(voxels). The same bits each time.
    ///
    /// Source: marching cubes (Lorensen, Cline 1987) with loops traced face by face instead of a table: on a face whose
    /// corners alternate, voxels inside stay apart, so that both its cubes agree. Loops of five and more nodes, and those of
    /// four that meet one face twice, are filled round a centre, which no other triangle can touch.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_image_surface(sb_label_def* def, sb_mesh* mesh, sb_label_report* report, sb_error* error);
    /// <summary>
    /// Makes the regions of a mesh's elements their labels: that of most of a sample of points (the centre, and the points
    /// half-way from there to each node). Background (0) does not count, since the skin of a mesh cuts through voxels; where
    /// all points lie in it the nearest label is taken, up to two voxels away, and 0 if there is none. mesh-&gt;regions is made
    /// with mesh-&gt;allocator where it is NULL. SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX, _MESH (of the mesh's arrays), _MEMORY:
    /// the mesh is as it was. O(elements).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_image_set_regions(sb_image* image, sb_mesh* mesh, sb_error* error);
    /// <summary>
    /// Makes a surface of a mesh of tri3, tri6, quad4, quad8 or quad9; faces other than tri3 are cut into flat triangles
    /// between their nodes. Nodes are copied. Surfaces that are open, touch themselves or have degenerate triangles are
    /// welcome (scans are like that): sb_surface_check reports it, and each query below says what it then means. One block
    /// of memory from `allocator` (NULL: malloc) for everything (about 280 bytes per triangle), plus scratch that goes back.
    /// O(triangles log triangles), about 0.1 s for 100,000. SB_ERROR_ARGUMENT (null pointer, a mesh of volumes: take
    /// sb_mesh_boundary), _MESH (empty, or too many triangles), _NOT_FINITE, _INDEX, _MEMORY; then *surface is untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_surface_create(sb_mesh* mesh, sb_allocator* allocator, sb_surface** surface, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_destroy(sb_surface* surface);
    /// <summary>
    /// Moves the nodes to nodes[sb_surface_node_count] (m) and refits boxes, normals and far fields in one pass over the
    /// triangles, in parallel on `jobs` (NULL: inline). The tree keeps its shape: answers stay right however far the surface
    /// deforms, and stay fast as long as neighbours stay near each other. Closest points, rays and signs are those of a new
    /// surface, to the bit. Allocates nothing. SB_ERROR_ARGUMENT or _NOT_FINITE (error-&gt;node): nothing has changed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_surface_move(sb_surface* surface, sb_vec3* nodes, sb_jobs* jobs, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_node_count(sb_surface* surface);
    /// <summary>
    /// nodes of the mesh, also those of no triangle
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_triangle_count(sb_surface* surface);
    /// <summary>
    /// Nodes of a triangle, in the order of the mesh's numbering; the mesh's element it was cut from is returned. -1
    /// (nothing written) when there is no such triangle. nodes may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_triangle(sb_surface* surface, int triangle, int* nodes);
    /// <summary>
    /// Smallest box around the triangles (m).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_bounds(sb_surface* surface, sb_vec3* low, sb_vec3* high);
    /// <summary>
    /// 1 when every edge is run through as often one way as the other: the surface then bounds a solid, its winding number
    /// is whole, and distances have an unquestionable sign.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_is_closed(sb_surface* surface);
    /// <summary>
    /// Bytes of its block of memory.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern UIntPtr sb_surface_bytes(sb_surface* surface);
    /// <summary>
    /// Closest point of the surface within max_distance (m, &gt;= 0; SB_REAL_MAX: any). 1 and *hit, or 0 when nothing is as
    /// near or an argument is NULL or NaN. hit may be NULL: only whether. O(log triangles).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_closest(sb_surface* surface, sb_vec3 point, double max_distance, sb_surface_hit* hit);
    /// <summary>
    /// The same with a triangle that is likely to be near (that of the last query, or of a neighbour; any other number: no
    /// idea): the same answer, sooner.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_closest_from(sb_surface* surface, sb_vec3 point, double max_distance, int triangle, sb_surface_hit* hit);
    /// <summary>
    /// First triangle that the ray from origin along direction (any length but 0) meets within max (m, &gt;= 0; SB_REAL_MAX:
    /// any), from either side. 1 and *hit (or NULL), or 0. No ray slips through between triangles that share an edge or
    /// corner; triangles seen exactly edge-on are not met. Source: Woop, Benthin, Wald 2013.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_ray(sb_surface* surface, sb_vec3 origin, sb_vec3 direction, double max, sb_surface_hit* hit);
    /// <summary>
    /// All triangles that the ray meets within max: returns how many, and the first `capacity` of them in hits (may be NULL
    /// with capacity 0: only count), nearest first. A ray through an edge meets both its triangles.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_ray_all(sb_surface* surface, sb_vec3 origin, sb_vec3 direction, double max, sb_surface_hit* hits, int capacity);
    /// <summary>
    /// Distance to the surface (m), negative inside. *hit (or NULL): the closest point. The sign is that of the
    /// angle-weighted pseudonormal at the closest point (Baerentzen, Aanaes 2005), exact for closed surfaces that do not
    /// cross themselves; where that normal means nothing (at degenerate triangles, edges of more or fewer than two
    /// triangles, corners where parts touch, folds), sb_surface_inside decides. On an open surface the sign says which side
    /// of the nearest triangle the point is on.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_surface_signed_distance(sb_surface* surface, sb_vec3 point, sb_surface_hit* hit);
    /// <summary>
    /// The same with the sign from sb_surface_inside everywhere: for surfaces with holes, overlaps or loose parts. About
    /// twice the time far from the surface, nine times close to it, where the winding number sums many triangles exactly.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_surface_signed_distance_winding(sb_surface* surface, sb_vec3 point, sb_surface_hit* hit);
    /// <summary>
    /// Generalised winding number: the solid angle under which the point sees the surface, over 4 pi. 1 inside a closed
    /// surface, 0 outside, in between near holes; 2 where two solids overlap. Near triangles are summed exactly, groups of
    /// far ones by their Taylor expansion to second order (Barill et al. 2018, beta 2): within 0.05 of the exact sum.
    /// O(log triangles).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_surface_winding_number(sb_surface* surface, sb_vec3 point);
    /// <summary>
    /// Every triangle summed exactly. O(triangles).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_surface_winding_number_exact(sb_surface* surface, sb_vec3 point);
    /// <summary>
    /// 1 where the winding number is 1/2 or more.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_surface_inside(sb_surface* surface, sb_vec3 point);
    /// <summary>
    /// Unit pseudonormal at a hit, pointing outward: of the face, the mean of the two at an edge, angle-weighted at a
    /// corner; 0 where there is none (degenerate triangles) or for no hit.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3 sb_surface_normal(sb_surface* surface, sb_surface_hit* hit);
    /// <summary>
    /// ---- many queries, in parallel on `jobs` (NULL: inline) ---------------------------------------------------------
    /// Each gives for points[count] what the single query gives, to the bit. Faster still when neighbours in the array are
    /// neighbours in space. Nothing happens for NULL or a count below 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_closest_batch(sb_surface* surface, sb_vec3* points, int count, double max_distance, sb_surface_hit* hits, sb_jobs* jobs);
    /// <summary>
    /// distances[count]; hits[count] or NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_signed_distance_batch(sb_surface* surface, sb_vec3* points, int count, double* distances, sb_surface_hit* hits, sb_jobs* jobs);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_signed_distance_winding_batch(sb_surface* surface, sb_vec3* points, int count, double* distances, sb_surface_hit* hits, sb_jobs* jobs);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_winding_number_batch(sb_surface* surface, sb_vec3* points, int count, double* numbers, sb_jobs* jobs);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_surface_inside_batch(sb_surface* surface, sb_vec3* points, int count, byte* inside, sb_jobs* jobs);
    /// <summary>
    /// Looks a mesh of tri3, tri6, quad4, quad8 or quad9 over. SB_OK also for a bad surface; fails as sb_surface_create
    /// does, and then leaves *report alone. Faces count as the mesh has them; crossings are looked for between the triangles
    /// they are cut into. Triangles that only touch do not cross. O(faces log faces), also where all faces coincide, share a
    /// node or are stacked; about 0.4 s for 100,000 triangles.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_surface_check(sb_mesh* mesh, sb_allocator* allocator, sb_surface_report* report, sb_error* error);
    /// <summary>
    /// One sentence that names the finding, e.g. "edges of one face only"; "unknown finding" for no single one. Static.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* sb_surface_check_string(int finding);
    /// <summary>
    /// sb_surface_check that fails with SB_ERROR_MESH when it finds one of `findings` (a sum of them, as
    /// SB_SURFACE_NOT_SOLID): the message names the first, how many and where, error-&gt;element the first element, or
    /// error-&gt;node the node. report (or NULL) is written then too.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_surface_require(sb_mesh* mesh, int findings, sb_allocator* allocator, sb_surface_report* report, sb_error* error);
    /// <summary>
    /// The mesh of flat triangles between the nodes of a surface's faces; regions and nodes are kept. Fails as
    /// sb_surface_create; the output is overwritten, not freed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_surface_triangulate(sb_mesh* mesh, sb_allocator* allocator, sb_mesh* triangles, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_surface_repair_def sb_default_surface_repair();
    /// <summary>
    /// Repairs a mesh of tri3 (others: sb_surface_triangulate first; SB_ERROR_UNSUPPORTED). def and report may be NULL
    /// (defaults; not wanted). What cannot be mended stays: check afterwards. New arrays come from mesh-&gt;allocator, the old
    /// ones go back to it. SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX, _MEMORY, _MESH (empty, nothing left, or one-sided like a
    /// Moebius strip): the mesh is as it was.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_surface_repair(sb_mesh* mesh, sb_surface_repair_def* def, sb_surface_repair_report* report, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_stuff_def sb_default_stuff_def();
    /// <summary>
    /// Makes the mesh: positively oriented tets with regions, all nodes used, ready for sb_body_create.
    ///
    /// Every dihedral angle lies in 10.7 to 164.8 degrees, for one shape or several, with levels or without: what is cut or
    /// moved belongs to cells of the finest size only, and the tets between sizes have 45 to 120 degrees.
    ///
    /// The boundary is closed and manifold. Its nodes lie on the surface, but for a few (by less than a third of a cell)
    /// where the shape is about as thin as a cell or angles would suffer. Where its triangles cut a corner by more than 0.3
    /// cells, nodes slide along the surface and edges are split as long as the angles allow it; when that does not bring the
    /// boundary within a third of a cell (a thin part ends between lattice points), up to twelve places of the lattice are
    /// tried and the nearest mesh is kept. Look at report-&gt;distance where it matters: it is larger still for some shapes
    /// with sharp thin parts. What is thinner than a cell may be missing, in part or as a whole, or join across a gap; parts
    /// that come loose stay (sb_mesh_components finds them). report-&gt;volume_share and surface_share report how much is
    /// missing; where it is more than def-&gt;least_share allows, there is no mesh but an error that names a cell for the
    /// thickness of what is missing.
    ///
    /// mesh: overwritten, not freed. report: or NULL. Nodes and elements are numbered as by sb_mesh_reorder; the same bits
    /// for any number of threads. Failures leave mesh and report untouched: SB_ERROR_ARGUMENT (field named; more cells or
    /// elements than allowed, the message has their number), SB_ERROR_NOT_FINITE (field, or a point where the distance is
    /// not), SB_ERROR_MESH (less than least_share is kept, or nothing: the cell is too large; a surface, or a part of it, is
    /// inside out: error-&gt;element is one of its faces),
    /// SB_ERROR_CANCELLED, SB_ERROR_MEMORY. Cost: distances are taken near the surfaces only, O(surface); two bytes per
    /// cell of the box, the rest O(mesh).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mesh_stuff(sb_stuff_def* def, sb_mesh* mesh, sb_stuff_report* report, sb_error* error);
    /// <summary>
    /// ---- constructors ------------------------------------------------------------------------------------
    /// young [Pa] &gt; 0, poisson in (-1, 0.5), density [kg/m^3] &gt; 0. Nothing is checked here: parameters out
    /// of range give a material that sb_material_check refuses.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_linear(double young, double poisson, double density);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_corotated(double young, double poisson, double density);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_corotated_invertible(double young, double poisson, double density);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_svk(double young, double poisson, double density);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_neo_hookean(double young, double poisson, double density);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_stable_neo_hookean(double young, double poisson, double density);
    /// <summary>
    /// c10 [Pa] &gt; 0, d1 [1/Pa] &gt; 0: Abaqus' and CalculiX' constants, mu = 2 c10 and bulk = 2/d1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_neo_hookean_isochoric(double c10, double d1, double density);
    /// <summary>
    /// The same convention with mu = 2 (c10 + c01) &gt; 0; c10 or c01 [Pa] may be 0 or negative, at the price of a
    /// material that softens or turns unstable under large strain.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_mooney_rivlin(double c10, double c01, double d1, double density);
    /// <summary>
    /// Reduced polynomial of order 3 (Yeoh 1993); c30 = 0: order 2. c10 [Pa] &gt; 0, mu = 2 c10; c20 and c30 [Pa] of
    /// any sign: a negative one that is not outweighed makes the material unstable under large strain.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_reduced_polynomial(double c10, double c20, double c30, double d1, double density);
    /// <summary>
    /// Ogden's material with 1 to SB_MAX_OGDEN_TERMS terms mu[terms] [Pa] and alpha[terms], of any sign; its shear modulus
    /// is sum of mu_i alpha_i/2 &gt; 0. (Abaqus' mu_i is alpha_i/2 times this one.) One term with alpha 2 is neo-Hookean, two
    /// with 2 and -2 are Mooney-Rivlin. Another number of terms gives a material that sb_material_check refuses.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_ogden(double* mu, double* alpha, int terms, double d1, double density);
    /// <summary>
    /// Fung's exponential: c10 [Pa] &gt; 0 as above, exponent b &gt;= 0 (0: neo-Hookean): stiffness grows with exp(b (I1b - 3)).
    /// Directions: sb_material_with_fibres.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_fung(double c10, double exponent, double d1, double density);
    /// <summary>
    /// A law of the caller's own, lent, see sb_material_law, and bulk [Pa] &gt;= 0 that the library adds as (J - 1)^2/d1,
    /// d1 = 2/bulk. A law of F J^(-1/3) alone with its bulk modulus here is what elements that do not lock (B-bar) need:
    /// they evaluate the law at each point and the bulk term in the mean. A law that has its own volume term goes with bulk
    /// 0, and locks as any fully integrated element. Prony terms relax the law and leave the bulk term. lambda and mu are
    /// those of the law's tangent at F = I, averaged over directions; they scale tolerances and steps. NULL, a call that is
    /// missing or a law without a tangent at F = I give a material that sb_material_check refuses.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_custom(sb_material_law* law, double bulk, double density);
    /// <summary>
    /// The hyperelastic material, reinforced by one family of fibres (Holzapfel, Gasser and Ogden 2000):
    ///     W += k1/(2 k2) (exp(k2 (I4 - 1)^2) - 1) for I4 &gt; 1, I4 = |F a0|^2, a0 the unit direction at rest,
    /// and k1/2 (I4 - 1)^2 for k2 = 0; slack fibres (I4 &lt;= 1) do nothing. k1 [Pa] &gt;= 0, k2 &gt;= 0. The moduli lambda, mu
    /// stay those of the matrix.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_with_fibres(sb_material material, double k1, double k2);
    /// <summary>
    /// Fibres that point not all alike (Gasser, Ogden and Holzapfel 2006): the strain I4 - 1 above becomes
    ///     E = kappa I1 + (1 - 3 kappa) I4 - 1,
    /// kappa in [0, 1/3]. I1 and I4 are those of F, as above, so that a growing volume stretches fibres; at constant volume
    /// this is the published model. Slack: E &lt;= 0. A body may have a second family of them, see sb_body_def.second_fibres.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_with_dispersion(sb_material material, double kappa);
    /// <summary>
    /// The hyperelastic material, contracting along its fibres with a tension [Pa] &gt;= 0 per area at rest, at stretch l = |F
    /// a0| P += T f(l) (F a0) (x) a0/l,   f = max(0, 1 - ((l - optimum)/width)^2), or 1 for width 0, along each family
    /// alike, dispersion left out, not relaxing. With or without passive fibres (k1 = 0). Drive the tension in time by
    /// sb_body_set_tension. Beyond the optimum the tangent is not positive definite.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_with_contraction(sb_material material, double tension, double optimum, double width);
    /// <summary>
    /// The hyperelastic material, strained where the mesh is at rest: G takes each piece of it from where it had no stress
    /// to its shape in the mesh, det G &gt; 0, so that
    ///     W'(F) = W(F G) / det G,   P = P(F G) G^T / det G
    /// per volume of the mesh, fibres included, whose directions are those in the mesh at rest. Stress that an organ has
    /// where it was imaged, by region: arteries that draw together when cut, tendons under tension, swelling (G = s I, s &lt;
    /// 1). The mesh's own shape is then balanced only where supports hold it, or the regions' stresses each other: statics
    /// find the balance, and a body of one G that nothing holds goes to F = G^-1, where it has no stress. Moduli, density
    /// and tolerances stay those of the material and the mesh. Prony terms let this stress relax as any other, from when the
    /// body first moves. G = I takes it away. Source: Hoger 1986; Gee, Foerster and Wall 2010.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_with_prestretch(sb_material material, sb_mat3 G);
    /// <summary>
    /// A count out of range is kept for sb_material_check to refuse; NULL counts as one.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_with_prony(sb_material material, double* g, double* tau, int count);
    /// <summary>
    /// A material by name; liver has a density of about 1060 kg/m^3. An unknown preset gives a material that
    /// sb_material_check refuses.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_material sb_material_preset(sb_preset preset, double density);
    /// <summary>
    /// Constants of the small-strain limit: Young's modulus [Pa], Poisson's ratio, bulk modulus [Pa].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_material_young(sb_material* material);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_material_poisson(sb_material* material);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_material_bulk(sb_material* material);
    /// <summary>
    /// Checks model, finiteness and ranges of a material (mu &gt; 0, bulk &gt; 0, density &gt; 0, Poisson's ratio in
    /// (-1, 0.5); isochoric: c10 + c01 &gt; 0, d1 &gt; 0 and in agreement with lambda, mu; fibres, prestretch and Prony terms as
    /// their constructors say, and on hyperelastic models only). Returns SB_OK, or SB_ERROR_ARGUMENT (NULL, unknown
    /// model, count of Prony terms), SB_ERROR_NOT_FINITE or SB_ERROR_MATERIAL with the offending value in error (may
    /// be NULL). It does not decide whether a material stays stable under large strain: see sb_material_fit.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_material_check(sb_material* material, sb_error* error);
    /// <summary>
    /// 1 when the model has a finite energy for J &lt;= 0; 0 when it needs J &gt; 0 (or is unknown, or a law that decides itself).
    /// SB_SVK has one, but does not oppose inversion: it has the same value for F and its mirror image, so an inverted
    /// element may come to rest.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_allows_inversion(sb_material_model model);
    /// <summary>
    /// 1 when the tangent does not depend on F.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_is_linear(sb_material_model model);
    /// <summary>
    /// 1 for the models that take fibres and Prony terms: all but the linear and corotated ones.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_is_hyperelastic(sb_material_model model);
    /// <summary>
    /// W = elastic energy per reference volume [J/m^3].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_energy(sb_material* material, sb_mat3* F, sb_quat* rotation, double* W);
    /// <summary>
    /// P = dW/dF, first Piola-Kirchhoff stress [Pa]: force per reference area, P N = traction.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_stress(sb_material* material, sb_mat3* F, sb_quat* rotation, sb_mat3* P);
    /// <summary>
    /// A[9*(3*i+j) + (3*k+l)] = dP_ij/dF_kl [Pa], 81 values, exactly symmetric.
    ///
    /// The corotated models' energy has a kink where the rotation is not unique, at s_2 + s_3 = 0 for principal
    /// stretches s_1 &gt;= s_2 &gt;= |s_3|: there the exact tangent is infinite. A divides by s_i + s_j, but never by
    /// less than 1e-6 max(1, s_1 + s_2 + s_3), so it stays finite; SB_TANGENT_SPD likewise. SB_TANGENT_QUASI does
    /// not divide by it.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_tangent(sb_material* material, sb_mat3* F, sb_quat* rotation, sb_tangent_kind kind, double* A);
    /// <summary>
    /// ---- fibres ----
    /// The fibres' share at F, ADDED to the output; the calls above are the matrix alone. direction: of the fibres at
    /// rest, of any length but 0. All return 1, or 0 with the output untouched when F or the direction is not finite,
    /// the direction is 0, the result overflows or a pointer is NULL. A material without fibres adds nothing. What is
    /// passive of the tangent is positive semidefinite as it stands; contraction included, it is exact.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_fibre_energy(sb_material* material, sb_mat3* F, sb_vec3 direction, double* W);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_fibre_stress(sb_material* material, sb_mat3* F, sb_vec3 direction, sb_mat3* P);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_fibre_tangent(sb_material* material, sb_mat3* F, sb_vec3 direction, double* A);
    /// <summary>
    /// g(t): the share of a relaxing stress that is left a time t [s] after a sudden strain; 1 for t &lt;= 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_material_relaxation(sb_material* material, double time);
    /// <summary>
    /// Storage and loss modulus [Pa] of small shear that oscillates with omega [rad/s] &gt;= 0:
    ///     G' = mu (1 - sum g_i/(1 + x_i^2)),   G'' = mu sum g_i x_i/(1 + x_i^2),   x_i = omega tau_i;
    /// mu and 0 without Prony terms, zeros for NULL. storage and loss may be NULL. Fit: sb_material_fit_moduli.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_material_shear_moduli(sb_material* material, double omega, double* storage, double* loss);
    /// <summary>
    /// Moves one point by dt [s] &gt;= 0 (0: a jump; infinite: fully relaxed) to F and gives its stress there, fibres
    /// included: the formula that bodies step by, to draw relaxation curves and to fit them. Exact where S0 changes
    /// evenly within each step, of second order otherwise. fibre: direction of the fibres at rest, NULL for none.
    /// *P [Pa]: first Piola-Kirchhoff stress. Returns 1, or 0 with history and P untouched when F is not admissible
    /// (see above; also J = 0), dt is negative or NaN, Prony terms are out of number or on a model that is not
    /// hyperelastic, or a pointer but fibre is NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_material_history_stress(sb_material* material, sb_material_history* history, sb_mat3* F, double dt, sb_vec3* fibre, sb_mat3* P);
    /// <summary>
    /// Cauchy stress P F^T/J [Pa]: force per current area. Not finite when J = 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_mat3 sb_cauchy_stress(sb_mat3 F, sb_mat3 P);
    /// <summary>
    /// The same for a material's P; P itself for SB_LINEAR: small strain does not distinguish the stresses.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_mat3 sb_material_cauchy_stress(sb_material* material, sb_mat3 F, sb_mat3 P);
    /// <summary>
    /// Von Mises equivalent sqrt(3/2 s:s) [Pa], s the deviator of a symmetric stress.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_von_mises(sb_mat3 sigma);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_fit_options sb_default_fit_options();
    /// <summary>
    /// Fits a model to count readings of any tests together: mu, or c10 and c01, or c10, c20, c30; the compressibility is
    /// the options'. options NULL: defaults; info, error may be NULL. Returns SB_OK and *material, which passes
    /// sb_material_check; or, with *material and *info untouched: SB_ERROR_ARGUMENT (fewer readings than constants, a
    /// stretch &lt;= 0, an option out of range, SB_OGDEN or SB_FUNG, whose exponents no linear fit finds), SB_ERROR_NOT_FINITE,
    /// SB_ERROR_INDEFINITE naming a constant that the data do not distinguish from the others (simple shear and planar tests
    /// alone see c10 + c01 only), SB_ERROR_MATERIAL (the data ask for mu &lt;= 0), SB_ERROR_NOT_CONVERGED or SB_ERROR_DIVERGED
    /// (compressible only). Cost: below a microsecond a reading at constant volume, about 0.1 ms when compressible.
    /// Formulas: Ogden, Non-Linear Elastic Deformations, 1984, ch. 7.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_material_fit(sb_material_model model, sb_test_point* data, int count, sb_fit_options* options, sb_material* material, sb_fit_info* info, sb_error* error);
    /// <summary>
    /// Fits Prony terms to the relaxation g(time[k]) of a sudden strain: stress over its value at time 0; time [s] &gt; 0.
    /// tau[terms] [s]: the relaxation times to use, each &gt; 0; NULL: spread evenly in log time from the first to the last
    /// reading. terms in 1 to SB_MAX_PRONY_TERMS. Nonnegative least squares: terms that the data do not ask for are left
    /// out, so fewer may come back. On SB_OK *material, which comes in hyperelastic and in order, has these Prony terms in
    /// place of its own. Else it and *info are untouched: SB_ERROR_ARGUMENT (fewer readings than terms, a time or tau &lt;= 0),
    /// SB_ERROR_NOT_FINITE, SB_ERROR_INDEFINITE naming a given tau that the data do not distinguish from the others, or
    /// SB_ERROR_MATERIAL (the data relax to nothing, or the material is not in order).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_material_fit_prony(double* time, double* g, int count, double* tau, int terms, sb_material* material, sb_fit_info* info, sb_error* error);
    /// <summary>
    /// Fits Prony terms and the shear modulus to storage[count] and loss[count] [Pa] &gt;= 0 of shear that oscillates with
    /// omega[count] [rad/s] &gt; 0 (a rheometer's G' and G''), errors relative to |G*| of each reading. tau, terms and errors
    /// as above; tau NULL: spread evenly in log time over 1/omega. On SB_OK *material has these terms in place of its own
    /// and all of its moduli in proportion, so that mu is the instantaneous modulus and Poisson's ratio stays; info-&gt;rms is
    /// the relative error of G*. SB_ERROR_ARGUMENT also for fewer than (terms + 1)/2 readings, a modulus below 0, or both 0;
    /// SB_ERROR_MATERIAL where the data have no modulus left at low frequencies: they are of a fluid, or end too early.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_material_fit_moduli(double* omega, double* storage, double* loss, int count, double* tau, int terms, sb_material* material, sb_fit_info* info, sb_error* error);
    /// <summary>
    /// Makes the matrix whose nodes are coupled when they share a cell (an element, a particle's neighbours ...);
    /// all values are zero. Nodes without a cell keep their diagonal block.
    /// node_count      number of nodes, &gt;= 1
    /// cell_count      number of cells, &gt;= 0
    /// nodes_per_cell  nodes of each cell, &gt;= 1; ignored when cell_start is given
    /// cell_start      [cell_count + 1] first entry of each cell in `cells`, ascending from 0; NULL: fixed size
    /// cells           node indices of the cells; a node may repeat within a cell
    /// allocator       NULL: malloc
    /// Returns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error-&gt;element is the cell) or SB_ERROR_MEMORY (also when there
    /// would be more than 2^31-1 blocks) with *matrix untouched. Release with sb_matrix_free. Time and scratch
    /// memory are proportional to the cells' node pairs.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_matrix_create(int node_count, int cell_count, int nodes_per_cell, int* cell_start, int* cells, sb_allocator* allocator, sb_matrix* matrix, sb_error* error);
    /// <summary>
    /// Releases the arrays and zeroes the struct; a zeroed matrix is fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_matrix_free(sb_matrix* matrix);
    /// <summary>
    /// Sets all values to zero and clears the constraint mask.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_matrix_clear(sb_matrix* matrix);
    /// <summary>
    /// Position of block (i, j), or -1 when the pattern has none or an index is out of range. Time O(log row).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_matrix_find(sb_matrix* matrix, int i, int j);
    /// <summary>
    /// y = A x; x and y are [row_count][3] and must not overlap. jobs NULL: inline.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_matrix_multiply(sb_matrix* matrix, double* x, double* y, sb_jobs* jobs);
    /// <summary>
    /// Largest |A_ij - A_ji| divided by the largest |A_ij|; 0 for a zero matrix, NaN when an entry is.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_matrix_asymmetry(sb_matrix* matrix);
    /// <summary>
    /// Mean of |A_kk| over the free scalar rows (mask NULL: all), the scale given to constrained ones; 1 when
    /// there are none or all are zero, not finite when an entry is not.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_matrix_diagonal_scale(sb_matrix* matrix, byte* mask);
    /// <summary>
    /// Replaces the equations of prescribed components by s x_k = s value_k, s = sb_matrix_diagonal_scale, keeping
    /// symmetry: the known terms move to the right-hand side, rhs -= A[:, k] value_k, before rows and columns k
    /// are zeroed.
    /// mask    [row_count] SB_X | SB_Y | SB_Z; copied into matrix-&gt;fixed
    /// values  [row_count][3] prescribed values, read where the mask says so; NULL: all zero
    /// rhs     [row_count][3] changed in place; NULL: only the matrix is changed
    /// Needs a symmetric matrix; touches the constrained rows and their transposed blocks only. The diagonal stays
    /// as large as its neighbours so that neither the condition number nor a relative residual notices the
    /// replaced rows.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_matrix_constrain(sb_matrix* matrix, byte* mask, double* values, double* rhs);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_direct_def sb_default_direct_def();
    /// <summary>
    /// Orders and analyses the pattern (values are not read) and takes all memory that is ever needed. allocator NULL:
    /// malloc. def NULL: the default. *direct is released with sb_direct_free and refers to neither def nor pattern.
    /// Returns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error-&gt;node) or SB_ERROR_MEMORY; *direct is then
    /// untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_direct_create(sb_direct_def* def, sb_matrix* pattern, sb_allocator* allocator, sb_direct** direct, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_direct_free(sb_direct* direct);
    /// <summary>
    /// Factors a symmetric matrix of the pattern; allocates nothing. Returns SB_ERROR_ARGUMENT (another pattern),
    /// SB_ERROR_NOT_FINITE (error-&gt;node) or SB_ERROR_INDEFINITE when a pivot is negative (Cholesky) or lost in rounding
    /// (error-&gt;node tells its node). After an error it must be updated again before it can solve.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_direct_update(sb_direct* direct, sb_matrix* matrix, sb_error* error);
    /// <summary>
    /// Solves A x = rhs for `count` right-hand sides; rhs and x are [count][row_count][3] and may be the same array. Several
    /// at once cost much less than one after the other, and each gives the bits that it gives alone. Uses the solver's
    /// scratch: one call at a time. Returns SB_ERROR_ARGUMENT (also when the last update failed): x is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_direct_solve(sb_direct* direct, double* rhs, double* x, int count);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_direct_info sb_direct_get_info(sb_direct* direct);
    /// <summary>
    /// Makes the domain of a volume mesh's elements. single_rotation: 1 for tet10 with one rotation per element.
    /// Fails with SB_ERROR_MESH naming the element when a Jacobian at an integration point is not positive,
    /// SB_ERROR_NOT_FINITE or SB_ERROR_INDEX naming the node, SB_ERROR_ARGUMENT for a surface mesh, single_rotation or
    /// SB_INTEGRATION_BBAR on another element, or both together, SB_INTEGRATION_PATCH on another than tet4,
    /// SB_ERROR_UNSUPPORTED for an element that SB_ELEMENT left out, SB_ERROR_MEMORY; *domain is then untouched. Release
    /// with sb_domain_free. Source: formula of the isoparametric map, g_a = Je^-T dN_a/dxi.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_domain_create(sb_mesh* mesh, sb_integration integration, int single_rotation, sb_allocator* allocator, sb_domain* domain, sb_error* error);
    /// <summary>
    /// Releases the arrays and leaves zeros; {0} and NULL are fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_domain_free(sb_domain* domain);
    /// <summary>
    /// What SB_PRECOND_AUTO becomes for matrices of this pattern when positions are given: SB_PRECOND_IC0 with its coarse
    /// space up to 140,000 blocks, which are some 10,000 nodes of tet4 and 5,500 of tet10 or hex8, and
    /// SB_PRECOND_MULTIGRID above, where it takes less time on one core already (tests/bench/RESULTS.md has the figures).
    /// Long steps, nu 0.49 and jumps of the modulus by 1,000 (that the def's moduli tell) take up to twice its iterations.
    /// From rest such jumps cost IC0 three times its own, many small stiff inclusions ten times: of tet10 multigrid then
    /// takes half the time from some 90,000 blocks on, so name it for bodies that are solved so. Steps of moving ones
    /// begin near the answer; of 107,000 to 253,000 blocks they take with IC0 0.4 to 1.6 times the time on two cores. The
    /// choice does not depend on the number of threads, so results do not. Without positions it is SB_PRECOND_IC0. NULL:
    /// SB_PRECOND_IC0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_precond_kind sb_solver_auto(sb_matrix* pattern);
    /// <summary>
    /// Name of a kind, as "multigrid"; never NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* sb_precond_string(sb_precond_kind kind);
    /// <summary>
    /// The defaults named at the fields.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_preconditioner_def sb_default_preconditioner_def();
    /// <summary>
    /// moduli[block_count] of a def from those of the cells.
    /// pattern         made of the cells, by sb_matrix_create or wider; blocks whose nodes share no cell get 0
    /// cells           [cell_count][nodes_per_cell]
    /// young           [cell_count] (Pa), &gt;= 0
    /// Returns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error-&gt;element: a node outside, or no block for two nodes) or
    /// SB_ERROR_NOT_FINITE; what moduli holds is then unspecified. Time as an assembly.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_preconditioner_moduli(sb_matrix* pattern, int cell_count, int nodes_per_cell, int* cells, double* young, double* moduli, sb_error* error);
    /// <summary>
    /// Makes a preconditioner for matrices of this pattern (values are not read) with all memory it ever needs.
    /// allocator NULL: malloc. *out is released with sb_preconditioner_free and refers to neither def nor pattern.
    /// Returns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error-&gt;node; a modulus) or SB_ERROR_MEMORY; *out
    /// stays.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_preconditioner_create(sb_preconditioner_def* def, sb_matrix* pattern, sb_allocator* allocator, sb_preconditioner** @out, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_preconditioner_free(sb_preconditioner* preconditioner);
    /// <summary>
    /// Takes over the values of a symmetric matrix of the pattern, without rotations; allocates nothing.
    /// positions  [row_count] where the nodes are now, for the rigid motions of the pieces, taken over even when the factor
    ///            fails; NULL: as before
    /// Returns SB_ERROR_ARGUMENT (another pattern), SB_ERROR_NOT_FINITE, or SB_ERROR_INDEFINITE when a diagonal
    /// block is not positive definite or no diagonal shift up to some 65 makes the incomplete factor exist. After an
    /// error the preconditioner must be updated again before use.
    /// An IC0 that breaks down starts again with a larger diagonal (at most 17 times), keeps that shift for the
    /// following updates, and after a run of successful ones tries a smaller one.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_preconditioner_update(sb_preconditioner* preconditioner, sb_matrix* matrix, sb_vec3* positions, sb_error* error);
    /// <summary>
    /// z = M^-1 r; both [row_count][3], not overlapping. Uses the preconditioner's scratch: one call at a time.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_preconditioner_apply(sb_preconditioner* preconditioner, double* r, double* z);
    /// <summary>
    /// Turns the smoother of the last update (or load) with the body instead of making it anew:
    ///     M^-1 = R S R^T on the free components, the inverse diagonal on those prescribed now
    /// with R of the nodes' rotations since then; the coarse space is that of the matrix. The tangent of a bent body is
    /// nearly that of the unbent one turned, so that M made at rest serves through large motions. Positive definite whatever
    /// the rotations.
    /// matrix     what is to be solved now, of the same pattern
    /// rotations  [row_count] unit quaternions, as sb_body_nodal_rotations gives; NULL: none
    /// positions  as in sb_preconditioner_update
    /// Returns SB_ERROR_ARGUMENT (another pattern, nothing to turn, or error-&gt;node's rotation is no unit quaternion),
    /// SB_ERROR_UNSUPPORTED (multigrid: update it) or SB_ERROR_NOT_FINITE; the preconditioner is then as it was. Costs a
    /// pass over the nodes, and for the coarse space one over the matrix; allocates nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_preconditioner_warp(sb_preconditioner* preconditioner, sb_matrix* matrix, sb_quat* rotations, sb_vec3* positions, sb_error* error);
    /// <summary>
    /// Bytes that sb_preconditioner_save writes; 0: more than size_t holds, or multigrid.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern UIntPtr sb_preconditioner_saved_size(sb_preconditioner* preconditioner);
    /// <summary>
    /// Writes the smoother of the last update, without rotations and coarse space, to buffer[size]; what is behind
    /// sb_preconditioner_saved_size stays. SB_ERROR_ARGUMENT: NULL, too small a buffer (then untouched), or never
    /// updated.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_preconditioner_save(sb_preconditioner* preconditioner, void* buffer, UIntPtr size);
    /// <summary>
    /// The smoother becomes what was saved from a preconditioner of the same kind, power and pattern, of IC0 also with a
    /// coarse space if this one has one, or without, where that changes the factor's order; it is without until
    /// sb_preconditioner_warp. All is checked before anything changes: SB_ERROR_FORMAT (no saved preconditioner, cut
    /// short, damaged, a value out of its range), SB_ERROR_UNSUPPORTED (other version or precision), SB_ERROR_STATE
    /// (another kind, power or pattern, or a factor in another order), SB_ERROR_NOT_FINITE, SB_ERROR_ARGUMENT. Allocates
    /// nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_preconditioner_load(sb_preconditioner* preconditioner, void* buffer, UIntPtr size, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_preconditioner_info sb_preconditioner_get_info(sb_preconditioner* preconditioner);
    /// <summary>
    /// The defaults named at the fields.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_pcg_options sb_default_pcg_options();
    /// <summary>
    /// Takes the vectors for systems of row_count &gt;= 1 nodes. SB_ERROR_ARGUMENT or SB_ERROR_MEMORY leave
    /// *workspace untouched. Release with sb_pcg_workspace_free. allocator NULL: malloc.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_pcg_workspace_create(int row_count, sb_allocator* allocator, sb_pcg_workspace* workspace, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_pcg_workspace_free(sb_pcg_workspace* workspace);
    /// <summary>
    /// Solves A x = rhs for a symmetric positive definite A.
    /// preconditioner  up to date with A; NULL: none
    /// rhs             [row_count][3]
    /// x               [row_count][3] in: the start; out: the solution. rhs = 0 gives x = 0 whatever the start, in each part
    /// options         NULL: defaults
    /// info            filled in every case but SB_ERROR_ARGUMENT; may be NULL
    /// Returns SB_OK;
    ///   SB_ERROR_NOT_CONVERGED  the cap was reached, or rounding stops progress (info-&gt;capped tells which); x is
    ///                           the last
    ///                           iterate, good enough for a real-time step that had no time for more
    ///   SB_ERROR_INDEFINITE     p.Ap &lt;= 0 (info-&gt;negative_curvature) or a preconditioner that is not positive
    ///                           definite;
    ///                           x is the last iterate before
    ///   SB_ERROR_DIVERGED       a NaN or infinity, in the input or grown; x is the start again
    ///   SB_ERROR_ARGUMENT       sizes that do not match, options out of range; x untouched
    /// Parts that the pattern of A does not connect are solved as if each were alone, side by side: with step lengths of its
    /// own and to a residual relative to its own rhs, so that a crumb of 1e-9 of the forces is as good as the organ beside
    /// it. Parts whose rhs is below some 1e-31 of the whole are left alone, which is what single precision holds beside 1.
    /// With levels of one's own that couple parts (sb_preconditioner_def) all rows are one part. Iterations are those of the
    /// part that needs most.
    /// Tolerances whose cube is below SB_EPSILON are near what the recurrence can hold: there the true residual is
    /// computed at the end, and the iteration goes on from it if it has drifted. No x of sb_real can have a
    /// smaller residual than about SB_EPSILON |A| |x|: in float builds that is 1e-4 |rhs| for a soft beam of 2,000
    /// nodes. Sums are taken in double over fixed chunks of rows, added in order: same bits for any number of
    /// threads.
    /// Multigrid has the matrix of its update in 32 bits an entry, which has half the bytes, but where moduli jump (and in
    /// float builds): directions are multiplied by that one, the true residual is computed with the matrix itself, and where
    /// the two part the iteration goes on from the true one, at last without the other. So the residual holds for the matrix
    /// given whatever the preconditioner was made of.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_pcg_solve(sb_matrix* matrix, sb_preconditioner* preconditioner, double* rhs, double* x, sb_pcg_options* options, sb_pcg_workspace* workspace, sb_pcg_info* info);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_grid_def sb_default_grid_def();
    /// <summary>
    /// Makes a grid. Same bits for any threads. SB_ERROR_ARGUMENT (a field out of range, named), SB_ERROR_NOT_FINITE (box,
    /// cell_size, or a distance), SB_ERROR_MESH (no cell has anything inside, or a surface or a part of it is inside out),
    /// SB_ERROR_UNSUPPORTED (more cells than an int counts, more points than max_points), SB_ERROR_CANCELLED,
    /// SB_ERROR_MEMORY; *grid is untouched. Cost: for each cut cell some 4^level distances.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_grid_create(sb_grid_def* def, sb_grid* grid, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_grid_free(sb_grid* grid);
    /// <summary>
    /// Rows of points[count] (m), in their order. A point outside all kept cells belongs to the nearest one, whose shape
    /// functions go on outside: rows give back positions, and carry the force and moment of a load, exactly all the same.
    /// SB_ERROR_ARGUMENT names (error-&gt;node) the first that is farther away than the longest edge of a cell,
    /// SB_ERROR_NOT_FINITE one that is not finite; SB_ERROR_MEMORY. *rows is untouched then. O(count). Source: eqs. 4.4,
    /// 4.16.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_grid_map_points(sb_grid* grid, sb_vec3* points, int count, sb_allocator* allocator, sb_grid_rows* rows, sb_error* error);
    /// <summary>
    /// Rows of integration points of triangles[count] (indices of elements; NULL: of all, count is not read) of a tri3 mesh,
    /// cut finely enough for the cells: one for a triangle with edges up to half a cell, otherwise three in each of its
    /// pieces with edges up to a cell. Their areas sum to that of the triangles, and their moments are exact. Errors as
    /// above, and SB_ERROR_INDEX (a triangle), SB_ERROR_MESH (one without area), SB_ERROR_UNSUPPORTED (more rows than an int
    /// counts).
    ///     Penalty displacements (eqs. 4.18-4.21): sb_body_add_mapping(body, &amp;rows.rows, stiffness, 0, targets, ...) with
    ///     stiffness[j] = kappa areas[j], kappa (Pa/m) some 10 to 100 times Young's modulus over the cell size.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_grid_map_surface(sb_grid* grid, sb_mesh* surface, int* triangles, int count, sb_allocator* allocator, sb_grid_rows* rows, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_grid_rows_free(sb_grid_rows* rows);
    /// <summary>
    /// forces[nodes of the grid] (N) += what tractions[row_count] (Pa on the undeformed area), or one for all when uniform
    /// is 1, exert on the nodes; hand them to sb_body_add_forces. Rows need areas; others change nothing. Source: eqs.
    /// 4.14-4.17.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_grid_add_traction(sb_grid_rows* rows, sb_vec3* tractions, int uniform, sb_vec3* forces);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_mixture_def sb_default_mixture_def();
    /// <summary>
    /// Makes a mixture. SB_ERROR_ARGUMENT (a field out of range, named; a surface mesh), SB_ERROR_NOT_FINITE (a distance;
    /// error-&gt;element), SB_ERROR_MESH (a surface or a part of it is inside out, or what sb_mesh_validate and
    /// sb_domain_create refuse), SB_ERROR_INDEX, SB_ERROR_UNSUPPORTED (SB_CUSTOM, an element left out by SB_ELEMENT, more
    /// elements than an int counts), SB_ERROR_MEMORY; *mixture is untouched. Calls `distance` from one thread.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_mixture_create(sb_mixture_def* def, sb_mixture* mixture, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_mixture_free(sb_mixture* mixture);
    /// <summary>
    /// W (1/m^3) and dW/dr (1/m^4) at distance r (m, &gt;= 0) for the radius h (m, &gt; 0); 0 for an unknown kernel and where an
    /// argument is out of range.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_kernel_value(sb_kernel kernel, double r, double h);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_kernel_slope(sb_kernel kernel, double r, double h);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_particles_def sb_default_particles_def();
    /// <summary>
    /// Makes particles. Same bits for any threads. SB_ERROR_ARGUMENT (a field out of range, named), SB_ERROR_NOT_FINITE (a
    /// point, a number, or what volumes sum up to), SB_ERROR_MESH (error-&gt;node names a particle at the place of another,
    /// error-&gt;element a point whose neighbours stay in a plane after growing; nothing is inside), SB_ERROR_UNSUPPORTED (a
    /// point with more particles than SB_MAX_ELEMENT_NODES), and what sb_grid_create returns; *particles is untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_particles_create(sb_particles_def* def, sb_particles* particles, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_particles_free(sb_particles* particles);
    /// <summary>
    /// Rows of points[count] (m), in their order, for sb_body_add_mapping, sb_body_add_constraints and sb_mapping_apply: a
    /// point is a sum of the positions of its neighbours by moving least squares functions, of four monomials for SPH and
    /// MLS. In rows, `cells` is the nearest particle and `farthest` the largest distance to it. Points outside are
    /// extrapolated, SB_ERROR_ARGUMENT names (error-&gt;node) the first farther than two spacings from any particle,
    /// SB_ERROR_NOT_FINITE one that is not finite, SB_ERROR_MESH one whose neighbours do not span space;
    /// SB_ERROR_MEMORY. *rows is untouched then. Release with sb_grid_rows_free. Source: eqs. 3.36, 3.37, where point-based
    /// bodies need moving least squares functions of their own.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_particles_map_points(sb_particles* particles, sb_vec3* points, int count, sb_allocator* allocator, sb_grid_rows* rows, sb_error* error);
    /// <summary>
    /// Rows of points of triangles[count] (indices of elements; NULL: of all, count is not read) of a tri3 mesh, one for
    /// each piece when triangles are cut into pieces no longer than a spacing; areas sum to those of the triangles and first
    /// moments are exact. sb_grid_add_traction makes forces of tractions. Errors as above, and SB_ERROR_INDEX (a triangle),
    /// SB_ERROR_UNSUPPORTED (more rows than an int counts).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_particles_map_surface(sb_particles* particles, sb_mesh* surface, int* triangles, int count, sb_allocator* allocator, sb_grid_rows* rows, sb_error* error);
    /// <summary>
    /// Cuts along a surface of triangles or quads, open or closed: no point has neighbours that a segment through it leads
    /// to, then or in cuts to come. Points are made anew where that changes something, with growing radii; one whose
    /// neighbours do not span space even then does without what they do not see (`lost`). Make a new body of the result; the
    /// old one keeps what it copied, but borrows a table that stays until sb_particles_free: destroy it before that. Errors
    /// as sb_surface_create, SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (as sb_particles_create), SB_ERROR_MEMORY; *particles
    /// is as it was.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_particles_cut(sb_particles* particles, sb_mesh* surface, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_body_def sb_default_body_def();
    /// <summary>
    /// Creates a body at rest in the mesh's shape. All memory that stepping needs is taken here. On failure *body is
    /// untouched and the error says what is wrong: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named),
    /// SB_ERROR_MESH (element named), SB_ERROR_INDEX (node index, or a region that the mesh does not have),
    /// SB_ERROR_MATERIAL (the material, or the element whose material has fibres but that no direction was given for),
    /// SB_ERROR_UNSUPPORTED (element left out by SB_ELEMENT), SB_ERROR_MEMORY. Destroy with sb_body_destroy.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_create(sb_body_def* def, sb_body** body, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_destroy(sb_body* body);
    /// <summary>
    /// ---- sizes ----
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_node_count(sb_body* body);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_element_count(sb_body* body);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_point_count(sb_body* body);
    /// <summary>
    /// points per element that sb_body_stress reads; hex8 8, B-bar too
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_matrix_blocks(sb_body* body);
    /// <summary>
    /// stored 3x3 blocks of the tangent
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_patch_count(sb_body* body);
    /// <summary>
    /// The patch of an element, from 0; -1 without patches, for an element that there is not, or NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_patch(sb_body* body, int element);
    /// <summary>
    /// What solves its linear systems, and how the last set-up went. The kind is never SB_PRECOND_AUTO;
    /// sb_precond_string names it.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_preconditioner_info sb_body_solver(sb_body* body);
    /// <summary>
    /// Diagonal of the body's bounding box over 3 V/A at rest, V its volume and A its surface: 3.5 of a cube, 5.2 of a ball,
    /// L/h of some 25 from 30 on: thin. Costs a pass over the integration points, and uses the body's scratch: between steps
    /// only. NULL: 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_body_slenderness(sb_body* body);
    /// <summary>
    /// ---- properties: may change between steps ----
    /// Each checks its arguments first and changes nothing on failure. A material may allocate when it is the first whose
    /// steps take several iterations, or that has so many Prony terms (SB_ERROR_MEMORY). An element whose material is set
    /// forgets what its Prony terms remember: it counts as long relaxed in its present shape.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_material(sb_body* body, sb_material* material, sb_error* error);
    /// <summary>
    /// all regions
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_region_material(sb_body* body, int region, sb_material* material, sb_error* error);
    /// <summary>
    /// Directions as in the def, copied; NULL takes them all away. SB_ERROR_NOT_FINITE names the element; SB_ERROR_MATERIAL
    /// when a material has fibres and fibres is NULL; the first call may allocate (SB_ERROR_MEMORY). What Prony terms
    /// remember of the stress along the old directions stays and fades.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_fibres(sb_body* body, sb_vec3* fibres, sb_error* error);
    /// <summary>
    /// The same of the second family (sb_body_def.second_fibres); NULL takes it away, as sb_body_set_fibres(NULL) does.
    /// SB_ERROR_ARGUMENT without a first one, SB_ERROR_UNSUPPORTED in a body whose mesh may change.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_second_fibres(sb_body* body, sb_vec3* fibres, sb_error* error);
    /// <summary>
    /// Tension (Pa) &gt;= 0 with which the fibres of a region contract from now on: sb_material.fibre_tension, changed without
    /// forgetting what Prony terms remember. Set it before each step to drive it in time. SB_ERROR_INDEX: no such region;
    /// SB_ERROR_MATERIAL: no fibres to contract, or a material without energy for them.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_tension(sb_body* body, int region, double tension, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_gravity(sb_body* body, sb_vec3 gravity);
    /// <summary>
    /// Of all regions. SB_ERROR_UNSUPPORTED: beta &gt; 0 with SB_CENTRAL_DIFFERENCE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_damping(sb_body* body, double alpha, double beta);
    /// <summary>
    /// Damping of a region's own, in place of the body's, which the others keep: its elements damp with beta (s) times their
    /// stiffness, and its share of the nodes' lumped masses with alpha (1/s), whatever def.mass is; both &gt;= 0. What ties
    /// cells of a cut keeps the body's beta. sb_body_set_damping gives all regions the same again. With SB_EULER steps cost
    /// what they did; steps of one iteration of other integrators assemble one matrix more, for which the first call
    /// allocates. SB_ERROR_ARGUMENT, SB_ERROR_INDEX (no such region), SB_ERROR_UNSUPPORTED (SB_CENTRAL_DIFFERENCE),
    /// SB_ERROR_MEMORY change nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_region_damping(sb_body* body, int region, double alpha, double beta, sb_error* error);
    /// <summary>
    /// Tolerance in (0, 1) and cap (&gt;= 1) of a step's linear solve.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_solver(sb_body* body, double tolerance, int max_iterations);
    /// <summary>
    /// Lets linearised steps (max_newton 1) go on with the tangent and the preconditioner of a step before, which are most
    /// of what a step costs that moves little. angle (rad, 0 to 1): they are made anew once an element has turned by more
    /// since; 0, as bodies are made: in each step. 0.02 to 0.1 serve. Forces and damping are those of the present shape in
    /// any case, and so is the tangent times the way that nodes coast: a step is off by about the angle times what its
    /// motion changes by within it, and bodies come to rest where they would otherwise. Where the works of the kept and of
    /// the present tangent on that change differ by more than a share of 0.25, or of the angle where that is less, the step
    /// is solved once more, with its own, which sb_step_info counts: nearly incompressible or slender bodies would gain
    /// energy in long steps. What is kept is part of the state.
    ///
    /// Made anew in each step all the same: where materials are not all SB_COROTATED, where there are constraints, loads
    /// that follow the body (springs, mappings, membranes ...), tools, contact, damping by region, glue or supports that
    /// move, with multigrid, and by needles with NDL_REMESH; and once after each change of dt, supports, materials or mesh.
    /// Allocates; the steps do not. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (elements other than tet4), SB_ERROR_MEMORY
    /// change nothing; error may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_keep_tangent(sb_body* body, double angle, sb_error* error);
    /// <summary>
    /// Holds the axes where the nodes are now.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_hold(sb_body* body, int* nodes, int count, int axes, sb_error* error);
    /// <summary>
    /// Supports the axes; the next step takes them to positions[count] (m, in space).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_place(sb_body* body, int* nodes, int count, int axes, sb_vec3* positions, sb_error* error);
    /// <summary>
    /// Nodes that hang on a rigid body moved by its pose (a bone, a clamp, a moving table): supports all axes, and the next
    /// step takes each node from its place X at rest to position + turn (X - centre). centre (m) is a point of the rest
    /// shape, position (m) where it goes; turn is taken at unit length. A step goes there exactly; the increments of a
    /// static solve go straight, so that a large turn is better made in several solves. SB_ERROR_NOT_FINITE;
    /// SB_ERROR_ARGUMENT (a turn of length 0). What the body feels of it: sb_body_wrench.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_place_rigid(sb_body* body, int* nodes, int count, sb_vec3 centre, sb_vec3 position, sb_quat turn, sb_error* error);
    /// <summary>
    /// Frees the axes; their velocity stays.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_release(sb_body* body, int* nodes, int count, int axes, sb_error* error);
    /// <summary>
    /// The same without an error, as earlier versions had them; sb_body_prescribe's targets are displacements from the
    /// reference shape: displacements[count] (m), or one for all when uniform is 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_fix_nodes(sb_body* body, int* nodes, int count, int axes);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_prescribe(sb_body* body, int* nodes, int count, int axes, sb_vec3* displacements, int uniform);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_release_nodes(sb_body* body, int* nodes, int count, int axes);
    /// <summary>
    /// Supported axes of every node as bits, [node_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* sb_body_supports(sb_body* body);
    /// <summary>
    /// ---- state ----
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* sb_body_positions(sb_body* body);
    /// <summary>
    /// [node_count] (m), valid until destroyed
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* sb_body_displacements(sb_body* body);
    /// <summary>
    /// [node_count] (m)
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* sb_body_velocities(sb_body* body);
    /// <summary>
    /// Overwrites the motion (any finite values, inside-out shapes included); SB_ERROR_NOT_FINITE changes nothing. To Prony
    /// terms a new shape is a sudden strain: their memory stays. What comes after agrees with the original run up to
    /// rounding, not to the last bit: solver warm starts are not part of it (sb_body_state_load has them), nor is a tangent
    /// that steps keep.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_displacements(sb_body* body, sb_vec3* displacements);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_velocities(sb_body* body, sb_vec3* velocities);
    /// <summary>
    /// Back to the reference shape at rest, with nothing remembered; supports, loads and materials stay.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_reset(sb_body* body);
    /// <summary>
    /// Force (N) of the supports on the body, per node, 0 on free axes, of the last step or static solve; with the
    /// loads it balances the rate of momentum. At the end of the step; with SB_GENERALISED_ALPHA where that scheme has its
    /// balance, a share 1/(1 + spectral_radius) of the way through it (at the end where it had to take 0). [node_count],
    /// valid until the next solve.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* sb_body_reactions(sb_body* body);
    /// <summary>
    /// The net force (N) of what holds these nodes on the body, and its torque (N m) about a point (m, in space), as
    /// sb_body_reactions has them: a clamp, a bone or a table feels the opposite. Either place may be NULL. nodes[count],
    /// each once. SB_ERROR_INDEX, SB_ERROR_NOT_FINITE leave both untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_wrench(sb_body* body, int* nodes, int count, sb_vec3 about, sb_vec3* force, sb_vec3* torque, sb_error* error);
    /// <summary>
    /// All loads of the last solve (gravity, forces, tractions, and what pressures, springs and mappings exerted in it) as
    /// nodal forces (N), [node_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* sb_body_external_forces(sb_body* body);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_energy(sb_body* body, sb_energy* energy);
    /// <summary>
    /// y = K x, the stiffness at the present displacements times x: the change of the internal forces (N) when the nodes
    /// move by x (m). x and y: [node_count], not overlapping. K is the derivative of the forces, symmetric but not always
    /// positive definite; Prony terms respond at once. With single_rotation it is that of the same elements with a rotation
    /// at each point. Supports, loads and constraints have no say. The state stays as it is, and nothing is allocated.
    /// SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error-&gt;node) and SB_ERROR_INVERTED (error-&gt;element) leave y untouched; error
    /// may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_multiply_stiffness(sb_body* body, sb_vec3* x, sb_vec3* y, sb_error* error);
    /// <summary>
    /// The same with the tangent that solves use: SB_TANGENT_EXACT is the derivative of above, SB_TANGENT_SPD its positive
    /// semidefinite projection at each point, and SB_TANGENT_QUASI what linearised steps take: of the corotated models the
    /// rotations stay as they are (K = R C R^T), others are projected. SB_TANGENT_QUASI of SB_COROTATED tet4 and tet10 needs
    /// no matrix: measured, that takes a tenth (tet10) to two fifths (tet4) of assembling one and multiplying.
    /// SB_ERROR_ARGUMENT: also an unknown kind.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_multiply_tangent(sb_body* body, sb_tangent_kind kind, sb_vec3* x, sb_vec3* y, sb_error* error);
    /// <summary>
    /// That matrix itself (N/m; for SB_TANGENT_EXACT the derivative of the internal forces by the nodes' places), lent until
    /// the next call on the body, whose copy of it this overwrites. Errors as above; *matrix is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_stiffness_matrix(sb_body* body, sb_tangent_kind kind, sb_matrix** matrix, sb_error* error);
    /// <summary>
    /// Total mass (kg) and momentum (kg m/s).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_body_mass(sb_body* body);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3 sb_body_momentum(sb_body* body);
    /// <summary>
    /// Cauchy stress (Pa) at an integration point of an element, from the current state, with what fibres and Prony terms
    /// add. SB_ERROR_INDEX,
    /// SB_ERROR_INVERTED (material has no stress there); *stress is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_stress(sb_body* body, int element, int point, sb_mat3* stress);
    /// <summary>
    /// Von Mises stress (Pa) of every element, mean over its points (over their weights where def.domain was given), 0 where
    /// there is none; values[element_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_von_mises(sb_body* body, double* values);
    /// <summary>
    /// The same as nodal averages weighted by volume, for colouring; values[node_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_nodal_von_mises(sb_body* body, double* values);
    /// <summary>
    /// How the material around each node has turned from the reference shape, as unit quaternions: the rotation of the mean
    /// deformation gradient, weighted by volume; identity where there is no material. rotations[node_count], as
    /// sb_preconditioner_warp takes them. Uses the body's scratch: between steps only.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_nodal_rotations(sb_body* body, sb_quat* rotations);
    /// <summary>
    /// Lists the parts by ascending `node`.
    /// parts     [capacity] the first `capacity` of them; NULL when capacity is 0
    /// *count    how many there are
    /// numbers   [sb_body_node_count] number of the part of each node, -1: it has no material; or NULL
    /// Allocates nothing; uses the body's scratch: between steps only. SB_ERROR_ARGUMENT.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_parts(sb_body* body, sb_part* parts, int capacity, int* count, int* numbers);
    /// <summary>
    /// SB_ERROR_ARGUMENT; SB_ERROR_MEMORY of a body with free rigid bodies.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_check(sb_body* body, sb_check_report* report);
    /// <summary>
    /// One sentence about one SB_CHECK_ bit; never NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* sb_check_string(uint warning);
    /// <summary>
    /// Deformation gradient dx/dX at an integration point of an element, [0, sb_body_point_count). SB_ERROR_INDEX: *F is
    /// untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_deformation(sb_body* body, int element, int point, sb_mat3* F);
    /// <summary>
    /// Strain there, see SB_TENSOR_STRAIN; errors as above. (Stress: sb_body_stress.)
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_strain(sb_body* body, int element, int point, sb_mat3* strain);
    /// <summary>
    /// A tensor at every node; values[sb_body_node_count], 0 where there is no material. In each element a linear function
    /// of its local coordinates is fitted to the integration points (tet4: a constant), taken to its nodes, and averaged
    /// there, weighted by volume; elements that are cut or have points of their own (sb_body_def.domain) give their mean.
    /// tensor is an sb_tensor. Measured on irregular meshes
    /// (tests/verification.md, verification_readings): halving elements divides errors by 3.5 of tet10, hex20 and hex27, by
    /// 2.4 of tet4 and hex8 and by 1.9 at the surface, where these two know the middle of the layer below only.
    /// SB_ERROR_ARGUMENT: NULL, or another tensor; SB_ERROR_INVERTED: error-&gt;element has no stress, its material does not
    /// admit the state; *values is then untouched. error may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_nodal_tensors(sb_body* body, int tensor, sb_mat3* values, sb_error* error);
    /// <summary>
    /// The same from the elements of one region alone, 0 at nodes of others: stresses jump where materials meet, and an
    /// average over both sides is neither. SB_ERROR_INDEX: the mesh has no such region.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_region_tensors(sb_body* body, int region, int tensor, sb_mat3* values, sb_error* error);
    /// <summary>
    /// Elastic energy of each element per volume at rest (J/m^3), mean over the element; values[sb_body_element_count].
    /// Times the volumes they sum to sb_energy.elastic, what ties pieces of a cut to each other left out; with Prony terms
    /// of the long-term response, as there. SB_ERROR_ARGUMENT; SB_ERROR_INVERTED names the element; SB_ERROR_NOT_FINITE: too
    /// large for sb_real; values are then untouched. error may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_energy_densities(sb_body* body, double* values, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_change_cell sb_default_change_cell();
    /// <summary>
    /// Begins a change; one at a time. Nothing happens to the body before the commit. Errors of the calls below leave the
    /// change as it was before them: it can go on. SB_ERROR_UNSUPPORTED: def.slack was 0. SB_ERROR_STATE: another change is
    /// open. SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_begin(sb_body* body, sb_body_change** change, sb_error* error);
    /// <summary>
    /// Makes a node at a place of the reference shape (m); *node is its number.
    /// sources, weights  [count] nodes in use before the change or made by it, &gt;= 1; weights &gt;= 0 that sum to 1
    /// flags             0 or SB_NODE_COPY with SB_NODE_KEEP_X ...
    /// SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_INDEX (error-&gt;node), SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_add_node(sb_body_change* change, sb_vec3 position, int* sources, double* weights, int count, int flags, int* node, sb_error* error);
    /// <summary>
    /// Moves a node in the reference shape (m). Its cells change shape, also those not named here. The last move of a node
    /// counts.
    /// sources, weights  [count] as of sb_body_change_add_node: those of the new place in the mesh before the change, so
    ///                   that the body's motion stays where it was while the node slides through it. count 0: the node keeps
    ///                   the motion it has, a made one that of its sources
    /// Errors as of sb_body_change_add_node.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_move_node(sb_body_change* change, int node, sb_vec3 position, int* sources, double* weights, int count, sb_error* error);
    /// <summary>
    /// Removes a node in use before the change.
    /// heirs, weights  [count] nodes, &gt;= 0, that what refers to the node goes over to; weights sum to 1. 0: nobody
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_remove_node(sb_body_change* change, int node, int* heirs, double* weights, int count, sb_error* error);
    /// <summary>
    /// Makes a cell; *number (may be NULL) is its number. Nodes may still be to come until the commit.
    /// SB_ERROR_ARGUMENT, SB_ERROR_INDEX, SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY; SB_ERROR_UNSUPPORTED: moments in a body of
    /// other cells than tet4 or tet10, with more than 4 points to a cell, or with consistent masses of tet10.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_add_cell(sb_body_change* change, sb_change_cell* cell, int* number, sb_error* error);
    /// <summary>
    /// Removes a cell and makes another in its slot.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_replace_cell(sb_body_change* change, int number, sb_change_cell* cell, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_remove_cell(sb_body_change* change, int number, sb_error* error);
    /// <summary>
    /// Checks the change as a whole, takes all memory that following needs, and makes it. On SB_OK the change is gone; on
    /// failure the body is as it was to the last bit, the change is still open, and the error names node or cell:
    /// SB_ERROR_INDEX (a cell with a node that is not in use, or twice the same; a removed node that still has a cell),
    /// SB_ERROR_MESH (a cell inside out or flat; a node left without a cell; no cell left), SB_ERROR_UNSUPPORTED (a piece of
    /// a tet10 with curved sides), SB_ERROR_ARGUMENT (what would lose its node, see above), SB_ERROR_STATE (a state with
    /// another mesh was loaded meanwhile, or a needle is in the tissue, whose mesh is the needle's alone then),
    /// SB_ERROR_MEMORY, or what a listener says.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_change_commit(sb_body_change* change, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_change_cancel(sb_body_change* change);
    /// <summary>
    /// ---- readings ----
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_node_in_use(sb_body* body, int node);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_cell_in_use(sb_body* body, int cell);
    /// <summary>
    /// Nodes of a cell in use, or NULL; valid until the next change.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int* sb_body_cell_nodes(sb_body* body, int cell);
    /// <summary>
    /// Share of a cell's volume that is material; 0 for a free one and an empty piece.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_body_cell_share(sb_body* body, int cell);
    /// <summary>
    /// [node_count] the reference shape (m).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* sb_body_rest_positions(sb_body* body);
    /// <summary>
    /// Rises with every change, and with every state loaded whose mesh is another; 0: none yet.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_mesh_version(sb_body* body);
    /// <summary>
    /// Where cells are pieces of elements, which all have the whole element's shape: the cell with the material at xi of the
    /// element that `cell` is a piece of (largest least barycentric coordinate, then the lowest piece), as the sb_cut that
    /// cut the body knows. The cell itself where it is none, or where nobody knows. -1: no such cell, or NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_find_cell(sb_body* body, int cell, double* xi);
    /// <summary>
    /// The mesh without free slots, in the order of the slots, with regions. nodes [sb_body_node_count] and cells
    /// [sb_body_element_count] become their numbers in it, -1 of free ones; may be NULL. Release with sb_mesh_free.
    /// SB_ERROR_ARGUMENT, SB_ERROR_MEMORY leave all untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_get_mesh(sb_body* body, sb_allocator* allocator, sb_mesh* mesh, int* nodes, int* cells, sb_error* error);
    /// <summary>
    /// Whether slots, masses, volumes, lists and matrix are what the mesh says: for tests. SB_ERROR_STATE names the first
    /// fault. Allocates scratch (SB_ERROR_MEMORY).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_live_check(sb_body* body, sb_error* error);
    /// <summary>
    /// Called in the order of registration, after the body's own loads and constraints and the embeddings that follow it.
    /// *id serves to end it; listeners end with the body, too. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (def.slack was 0),
    /// SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_listen(sb_body* body, sb_body_listener* listener, int* id, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_unlisten(sb_body* body, int id);
    /// <summary>
    /// Adds forces[count] (N), or one for all when uniform is 1, to the nodes. SB_ERROR_NOT_FINITE; SB_ERROR_INDEX: a node
    /// out of range, or a force other than 0 on a node of no element, which is held and would feel nothing. Nothing is added
    /// then, and error (NULL is fine) names the node.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_apply_forces(sb_body* body, int* nodes, int count, sb_vec3* forces, int uniform, sb_error* error);
    /// <summary>
    /// The same without an error, as earlier versions had it.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_forces(sb_body* body, int* nodes, int count, sb_vec3* forces, int uniform);
    /// <summary>
    /// Adds a traction (Pa on undeformed area) on element faces, each given by its 3 (tet) or 4 (hex) corner nodes in
    /// any order: faces[face_count][corners]. SB_ERROR_ARGUMENT names the first face that no element has.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_traction(sb_body* body, int* faces, int face_count, int corners, sb_vec3 traction, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_clear_loads(sb_body* body);
    /// <summary>
    /// Pressure (Pa on the deformed area; positive pushes inwards, along the present normal) on faces of the surface, given
    /// as for sb_body_add_traction. SB_ERROR_INDEX and SB_ERROR_ARGUMENT name the first face with a node that the mesh does
    /// not have, that no element has, or that lies between two elements; SB_ERROR_NOT_FINITE. f_a = -p int N_a x_r x x_s.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_pressure(sb_body* body, int* faces, int face_count, int corners, double pressure, int* load_id, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_pressure(sb_body* body, int load_id, double pressure);
    /// <summary>
    /// Springs of rest length 0 from nodes[count] to points in space points[count] (m): each pulls its node with
    /// stiffness (point - position). stiffness: N/m, &gt;= 0, one for each spring, or one for all when uniform is 1.
    /// SB_ERROR_INDEX: a node out of range or of no element.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_springs(sb_body* body, int* nodes, int count, double* stiffness, int uniform, sb_vec3* points, int* load_id, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_move_springs(sb_body* body, int load_id, sb_vec3* points);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_spring_stiffness(sb_body* body, int load_id, double* stiffness, int uniform);
    /// <summary>
    /// Penalty displacements: draws each row of the mapping to targets[row_count] (m, in space) with stiffness[row_count]
    /// (N/m, &gt;= 0; one for all when uniform is 1): f = -H k (H^T x - y), K = H k H^T. A row that couples nodes without a
    /// common element enlarges the body's tangent: its matrix and preconditioner are then made anew, and blocks grow with
    /// the square of the row's length. SB_ERROR_ARGUMENT (an empty or descending row), SB_ERROR_INDEX (a node out of range,
    /// or one of no element whose weight is not 0) and SB_ERROR_NOT_FINITE name the row (error-&gt;element) or its node.
    /// Source: Robin condition through a mapping.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_mapping(sb_body* body, sb_mapping* mapping, double* stiffness, int uniform, sb_vec3* targets, int* load_id, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_mapping_targets(sb_body* body, int load_id, sb_vec3* targets);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_mapping_stiffness(sb_body* body, int load_id, double* stiffness, int uniform);
    /// <summary>
    /// Where the rows are now (m): points[row_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_mapping_points(sb_body* body, int load_id, sb_vec3* points);
    /// <summary>
    /// Takes a pressure, springs, a mapping, a cable, a membrane or a cavity away; its id is then unknown. The next static
    /// solve lets its force fade.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_remove_load(sb_body* body, int load_id);
    /// <summary>
    /// Net force (N) of a load on the body, and its torque (N m) about a point (m); either place may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_load_force(sb_body* body, int load_id, sb_vec3 about, sb_vec3* force, sb_vec3* torque);
    /// <summary>
    /// Force (N) of each spring on its node, forces[count], and of each row on the body, forces[row_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_spring_forces(sb_body* body, int load_id, sb_vec3* forces);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_mapping_forces(sb_body* body, int load_id, sb_vec3* forces);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_cable_def sb_default_cable_def();
    /// <summary>
    /// Adds a cable as one load more, by whose id sb_body_load_force (of what it does to the body) and sb_body_remove_load
    /// know it, too. The def and its arrays are copied.
    /// - Forces come from the energy stiffness rest_length (e^2/2 - toe e/2 + toe^2/6), e = length / rest_length - 1, past
    /// the toe, and stiffness rest_length e^3 / (6 toe) within it; a slack cable has none at all. Statics, and steps of
    ///   several Newton iterations, find the balance with it; a linearised step (max_newton 1) takes what it is at the start
    ///   and its stiffness there: a cable that goes taut or slack within the step does so in the next one.
    /// - The stiffness is positive semidefinite and part of every tangent: a stiff cable is safe at any dt. Under pressure a
    ///   rod (pushes) buckles where exact tangents are asked for; others leave that part out.
    /// - A static solve goes evenly from the rest length, stiffness and places that the last one ended with to the present
    ///   ones, and starts a new cable from no tension. It takes a cable as something that holds its length; where cables
    ///   alone hold a body and are slack at first, give it more load steps, or a support.
    /// - Explicit steps are bounded by the stiffness of all cables, slack ones too.
    /// - When the mesh changes, points go with their nodes and their material as rows of mappings do: to heirs of nodes
    ///   that go, to the cell that has their material. Points in space stay.
    /// Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; fewer than 2 points; none of the body; a stiffness or toe strain
    /// below 0; rest_length below 0, or 0 where all points lie on one place; a point without a place, or whose weights do
    /// not sum to 1), SB_ERROR_INDEX (a node out of range, or of no element), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY;
    /// error-&gt;element names the point. Points without a common element enlarge the body's tangent as those of a mapping's
    /// row do.
    /// Source: Blemker and Delp 2005 (paths that slide), Weiss et al. 1996 (toe of ligaments).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_cable(sb_body* body, sb_cable_def* def, int* load_id, sb_error* error);
    /// <summary>
    /// Changes between steps, without allocation: a suture that is tightened, a ligament that was torn (stiffness 0).
    /// SB_ERROR_INDEX: no cable has this id; SB_ERROR_ARGUMENT (rest_length &lt;= 0, stiffness &lt; 0), SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_cable_rest_length(sb_body* body, int load_id, double rest_length);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_cable_stiffness(sb_body* body, int load_id, double stiffness);
    /// <summary>
    /// places[points] (m): those of points in space are taken, others are not read.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_move_cable(sb_body* body, int load_id, sb_vec3* places);
    /// <summary>
    /// Tension (N) in the last step or static solve, 0 before; negative in a rod under pressure, and where a linearised step
    /// let a cable go slack.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_cable_tension(sb_body* body, int load_id, double* tension);
    /// <summary>
    /// Of its present points: length (m), and points[points] (m).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_cable_length(sb_body* body, int load_id, double* length);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_cable_points(sb_body* body, int load_id, sb_vec3* points);
    /// <summary>
    /// forces[points] (N) on each point in the last step or static solve; they sum to 0. What a point in space feels is what
    /// its bone feels.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_cable_forces(sb_body* body, int load_id, sb_vec3* forces);
    /// <summary>
    /// corners 3, prestretch 1, it wrinkles; no faces, thickness and shear 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_membrane_def sb_default_membrane_def();
    /// <summary>
    /// Adds a membrane as one load more, by whose id sb_body_load_force (which is 0) and sb_body_remove_load know it, too.
    /// The def and its faces are copied; a face twice has two sheets.
    /// - Forces come from the energy thickness shear / 2 (tr C + 1 / det C - 3) per area of the sheet, C = F^T F in its
    ///   plane. One that wrinkles has Pipkin's relaxed energy: with stretches a &gt;= b, where b &lt; a^-1/2 it pulls along a
    /// alone (shear (1 - a^-3)), and not at all where a &lt;= 1. A point for each tri3, three for tri6, four for quad4, nine
    /// for quad8 and quad9.
    /// - Statics, and steps of several Newton iterations, find the balance with it; a linearised step (max_newton 1) takes
    ///   its forces at the start and its stiffness there, without what pressure in it takes off, plus 1e-4 thickness shear
    ///   where it wrinkles. Rayleigh damping leaves it out.
    /// - A static solve goes evenly from the thickness, shear and prestretch that the last one ended with to the present
    ///   ones; a new membrane has all of its stiffness at once, and starts from prestretch 1.
    /// - When the mesh changes, it goes with its faces as pressures do, and a face that is cut keeps what of it is material;
    ///   where the rest shape of nodes moves, so does its.
    /// Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; no faces; corners; a face that no element has, or between two:
    /// error-&gt;node is its first; a face without area; thickness, shear or prestretch out of range), SB_ERROR_INDEX (a node
    /// out of range: error-&gt;node), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY, SB_ERROR_UNSUPPORTED (in a body of
    /// SB_CENTRAL_DIFFERENCE one that does not wrinkle: it stiffens without bound as it is pressed together).
    /// Source: Pipkin 1986 (relaxed energy); Holzapfel 2000, 6.5, for incompressible sheets.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_membrane(sb_body* body, sb_membrane_def* def, int* load_id, sb_error* error);
    /// <summary>
    /// Changes between steps, without allocation; ranges and errors as above, SB_ERROR_INDEX: no membrane has this id.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_membrane(sb_body* body, int load_id, double thickness, double shear, double prestretch);
    /// <summary>
    /// Faces that a membrane has now (a change of the mesh may divide them), and their corner nodes, corners[count][corners]
    /// as its def had them; either may be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_membrane_faces(sb_body* body, int load_id, int* count, int* corners);
    /// <summary>
    /// states[count] at the present shape; no allocation. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_membrane_states(sb_body* body, int load_id, sb_membrane_state* states);
    /// <summary>
    /// SB_CAVITY_PRESSURE of 0, corners 3, ambient 101325, exponent 1, bulk 2.2e9; no faces.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_cavity_def sb_default_cavity_def();
    /// <summary>
    /// Adds a cavity as one load more, by whose id sb_body_load_force and sb_body_remove_load know it, too. The def is
    /// copied. `filled`, of gas, liquid and SB_CAVITY_VOLUME, is the cavity's volume when it is added; a table is of V less
    /// what was injected since.
    /// - V = 1/3 int x.n over the faces, outward of the cavity, and over the lids of open rims: fans from the mean of a
    /// rim's corner nodes, which hand the pressure on them to the rim as it follows from V. The force is p dV/dx. Where the
    ///   faces close and the pressure is of the contents alone, it sums to 0, as does its torque.
    /// - Its energy - int p dV is part of sb_energy.springs and of what line searches go down. The stiffness -dp/dV g g^T
    ///   (g = dV/dx) is in every linear system, as a product, not as a block; what the turning of its faces adds is as for
    ///   pressures, without that of lids.
    /// - Liquid and SB_CAVITY_VOLUME: where -dp/dV is more than 100 times the body's own stiffness to growing (g.Kg /
    /// |g|^4), solves take that, with a pressure that is corrected to the law's: static solves until the volume is that of
    /// the law's pressure to 1e-11 of it or the tolerance of the forces shows no more; steps of SB_EULER and
    ///   SB_GENERALISED_ALPHA once a step, so that the volume follows in a few steps. SB_NEWMARK and SB_CENTRAL_DIFFERENCE
    ///   keep energy, and such a correction would swing without end: there the volume is some hundredth of what it grew by
    ///   off, and what was injected at once rings. So no bulk is too stiff. Iterations of linear systems are up to 2.5
    ///   times those with a given pressure.
    /// - A static solve goes evenly from the pressure, `filled` and contents that the last one ended with to the present
    ///   ones, and begins a new cavity with no pressure and filled to its present volume.
    /// - When the mesh changes, it goes with its faces as pressures do, and rims are found anew. A face of it cannot be cut
    ///   through (SB_ERROR_UNSUPPORTED): remove the cavity first. sb_body_modes leaves its stiffness out.
    /// Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; no faces; corners; a face that no element has, twice, or between
    /// two elements: error-&gt;node is its first; rims that touch: error-&gt;node; a volume of gas, liquid or SB_CAVITY_VOLUME
    /// that is not positive, as that of faces that look out of a solid; numbers or a table out of range), SB_ERROR_INDEX
    /// (error-&gt;node), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY, SB_ERROR_UNSUPPORTED (faces of cut elements). Source: Bonet and
    /// Wood 2008, 8.6 (pressure of enclosed volumes); Rumpel and Schweizerhof 2003 (rank-one part).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_cavity(sb_body* body, sb_cavity_def* def, int* load_id, sb_error* error);
    /// <summary>
    /// Adds volume (m^3, at the contents' own pressure; negative: takes away) to the contents, between steps, without
    /// allocation. SB_ERROR_INDEX; SB_ERROR_ARGUMENT: of SB_CAVITY_PRESSURE, or more than there is; SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_inject_cavity(sb_body* body, int load_id, double volume);
    /// <summary>
    /// Of SB_CAVITY_PRESSURE. SB_ERROR_INDEX, SB_ERROR_ARGUMENT (another kind), SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_cavity_pressure(sb_body* body, int load_id, double pressure);
    /// <summary>
    /// Present volume (m^3), lids included. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_cavity_volume(sb_body* body, int load_id, double* volume);
    /// <summary>
    /// Pressure (Pa) in the last step or static solve; 0 before.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_cavity_pressure(sb_body* body, int load_id, double* pressure);
    /// <summary>
    /// mass 0 and inertia 0, to be set; turn the identity, the rest 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_rigid_def sb_default_rigid_def();
    /// <summary>
    /// Adds a rigid body that moves freely; *id (may be NULL) is its number, never used again by this body. The def is
    /// copied; allocates, so that steps do not. Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; a mass, an inertia or a
    /// turn that is none; a node that is supported, in no element, the slave of a constraint, twice in the list or on
    /// another rigid body: error-&gt;node), SB_ERROR_INDEX (error-&gt;node), SB_ERROR_NOT_FINITE, SB_ERROR_UNSUPPORTED (explicit
    /// steps; more than SB_MAX_RIGID), SB_ERROR_MEMORY. Nodes that hang can neither be supported nor become slaves of
    /// constraints (SB_ERROR_ARGUMENT); they may be masters.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_rigid(sb_body* body, sb_rigid_def* def, int* id, sb_error* error);
    /// <summary>
    /// What acts on it besides tissue and gravity, from the next step on until it is set again: a force (N) at its centre of
    /// mass and a torque (N m), both in space. Allocates nothing. SB_ERROR_ARGUMENT, SB_ERROR_INDEX (no such rigid body),
    /// SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_rigid_load(sb_body* body, int id, sb_vec3 force, sb_vec3 torque);
    /// <summary>
    /// SB_ERROR_ARGUMENT, SB_ERROR_INDEX leave *motion untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_rigid_motion(sb_body* body, int id, sb_rigid_motion* motion);
    /// <summary>
    /// Takes it away; its nodes go on as they move. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_remove_rigid(sb_body* body, int id);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_rigid_count(sb_body* body);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_embedding_def sb_default_embedding_def();
    /// <summary>
    /// Embeds points in a mesh. SB_ERROR_ARGUMENT (a field out of range, a point beyond max_distance: error-&gt;node),
    /// SB_ERROR_NOT_FINITE (error-&gt;node: the point), SB_ERROR_UNSUPPORTED for custom elements, what sb_mesh_validate says of
    /// the mesh, SB_ERROR_INDEX for the surface, SB_ERROR_MEMORY; *embedding is then untouched. Copies what it keeps. About
    /// 2 microseconds for each point of a tet mesh on one thread; the result does not depend on the threads. Release with
    /// sb_embedding_destroy.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_create(sb_embedding_def* def, sb_embedding** embedding, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_embedding_destroy(sb_embedding* embedding);
    /// <summary>
    /// Where the points are when the nodes of the mesh are at node_positions (m), such as sb_body_positions(body):
    /// points[point_count], and unless NULL unit normals[point_count]. node_positions: [node_count of
    /// sb_embedding_get_report], which is mesh.node_count, or the slots of the body that it follows. After a change of the
    /// body's mesh (sb_body_change_commit), as needles make, the points are wrong unless the embedding follows it
    /// (sb_embedding_follow). Normals are
    /// - with a surface, of its deformed triangles (quads: corner triangles) around each point, weighted by area: those of
    ///   what is drawn. Zero for a point without triangles;
    /// - with def.normals, F^-T N of the embedding's deformation gradient F at the point: no neighbours needed, but it jumps
    ///   a little where F does, between elements.
    /// SB_ERROR_ARGUMENT for a NULL array, or normals without either source; nothing is written. Positions that are not
    /// finite give points that are not. Output arrays must not overlap node_positions. Allocates nothing, but after a state
    /// was loaded without memory for it (SB_ERROR_MEMORY, see sb_embedding_follow); the same bits for any number of threads;
    /// one call at a time for each embedding. jobs: NULL for none.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_update(sb_embedding* embedding, sb_vec3* node_positions, sb_vec3* points, sb_vec3* normals, sb_jobs* jobs);
    /// <summary>
    /// Adds to node_forces[mesh.node_count] (N) the forces equivalent to point_forces[point_count] (N) at node_positions:
    /// the exact transpose of sb_embedding_update's derivative, with the same net force and moment. What is said there of
    /// allocation, threads and errors holds.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_forces(sb_embedding* embedding, sb_vec3* node_positions, sb_vec3* point_forces, sb_vec3* node_forces, sb_jobs* jobs);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_embedding_report sb_embedding_get_report(sb_embedding* embedding);
    /// <summary>
    /// SB_ERROR_INDEX for no such point; *point is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_get_point(sb_embedding* embedding, int index, sb_embedded_point* point);
    /// <summary>
    /// SB_ERROR_MEMORY, SB_ERROR_ARGUMENT; *rows is then untouched. A NULL allocator means malloc.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_mapping(sb_embedding* embedding, sb_allocator* allocator, sb_embedding_rows* rows, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_embedding_rows_free(sb_embedding_rows* rows);
    /// <summary>
    /// From now on the embedding follows every change of the body's mesh (sb_body_change_commit) and every state loaded with
    /// another mesh. Its node positions are those of the body's slots, sb_body_positions(body); def.mesh need not have their
    /// numbers, but has the body's rest shape: points are placed anew where they are at rest.
    /// - A point keeps its place at rest, that is its material, to rounding: in the cell made there when its cell was split
    ///   or a node slid in the material. Points in cells that did not change have the same bits as before.
    /// - A point whose cell was removed is held by the nearest of the cells around the change, as points outside are
    ///   (sb_embedding_kind), or by the nearest of all where these do not reach it; sb_embedded_point.lost and
    ///   sb_embedding_report.lost say so. It is back inside when cells are made there again.
    /// - Points outside that are held where the mesh changed are held anew from their places at rest.
    /// - In an element that is cut (sb_cut) a point goes with the piece that has its material, outside with the piece that
    ///   has its foot: it is where it was at the instant of the cut. Of a body that has an sb_cut the points are placed by
    ///   the first update after a state with another mesh; of one without nobody knows then which piece that is
    ///   (sb_body_find_cell), and points of cut elements may be held by the piece on the other side.
    /// - After a state with another mesh was loaded the points are placed anew from the mesh at rest: one on a face or
    /// outside may be held by another cell than before, and be drawn elsewhere by rounding, or outside by what that cell
    /// makes of it. Those of a skin that tools touch (sb_contact_def.skin) are held as they were when the state was saved.
    /// - A change that is refused leaves the embedding as it was, to the bit.
    /// - A listener (sb_body_listen) finds the embedding changed when its `follow` is called, whichever came first. Between
    ///   its `reserve` and that, the embedding is not to be read.
    /// Cost: a change searches the points of changed cells and makes anew what updates read of them; points and cells far
    /// from it cost nothing (tests/bench/RESULTS.md). The first call takes about as long as the creation. A change allocates
    /// when arrays have to grow, and to find a point that no cell around it holds. Without memory the change is refused
    /// (SB_ERROR_MEMORY). After a state was loaded without memory for this, the next sb_embedding_update or
    /// sb_embedding_forces tries again and says SB_ERROR_MEMORY in turn. It ends with either of the two, or
    /// sb_embedding_unfollow. SB_ERROR_ARGUMENT (NULL, or other elements than the body's), SB_ERROR_STATE (it follows a body
    /// already), SB_ERROR_UNSUPPORTED (def.slack was 0), SB_ERROR_MEMORY leave it as it was.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_follow(sb_embedding* embedding, sb_body* body, sb_error* error);
    /// <summary>
    /// It stays as it is, and does not follow any more. SB_ERROR_STATE: it follows no body. SB_ERROR_ARGUMENT: NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_embedding_unfollow(sb_embedding* embedding);
    /// <summary>
    /// A skin of triangles between the points of an embedding.
    /// embedding  borrowed: destroy the skin first. Follows the body (sb_embedding_follow) where its mesh may change, since
    ///            before what acts on the skin was made, and until after that is destroyed
    /// surface    tri3, whose nodes are the embedding's points; triangles counter-clockwise seen from outside. Copied
    /// allocator  NULL: malloc
    /// SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (other faces than tri3), SB_ERROR_INDEX (error-&gt;element: a triangle with a
    /// corner that is no point), SB_ERROR_MEMORY; *skin is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_skin_create(sb_embedding* embedding, sb_mesh* surface, sb_allocator* allocator, sb_skin** skin, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_skin_destroy(sb_skin* skin);
    /// <summary>
    /// Adds a load (sb_body_remove_load takes it away) that holds the neighbours of every point to the linear field of its
    /// gradient: a gradient that is centred on a particle does not see that particle, and one point in a brick does not see
    /// its hourglasses. With s_j = u_j - sum_a (phi_a + g_a . (X_j - X_p)) u_a its energy is
    ///     alpha / 2 (lambda + 2 mu) w_p sum_j W_j |s_j|^2 / sum_j W_j |X_j - X_p|^2,
    /// a constant tangent within that of the body: nothing for linear fields and rigid motions, of any size. alpha: (0, 10];
    /// 0.02 is enough. [after Ganzenmueller 2015, in linear form.] Moduli are those of now. body must have been made of
    /// particles-&gt;mesh and -&gt;domain: SB_ERROR_ARGUMENT where counts differ, alpha is out of range, or with gradients that
    /// miss linear fields (SPH, a basis of 1), which it would hold; SB_ERROR_MEMORY. Nothing is added then.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_particles_stabilise(sb_particles* particles, sb_body* body, double alpha, int* load_id, sb_error* error);
    /// <summary>
    /// Adds the equation sum_k coefficient_k u[node_k].axis_k = value (m). The first term is the slave: its displacement
    /// follows from the others, as in Abaqus' *EQUATION, so its coefficient must not be 0 (nor so small beside the others
    /// that a quotient overflows).
    ///   terms[count]  count &gt;= 1; other terms may name supported nodes (the slave follows), nodes of no element (as
    ///                 prescribed reference nodes) and slaves of other constraints (chains are resolved)
    ///   id            receives the constraint's number, &gt;= 0, never used again by this body; may be NULL
    /// A gap that a new constraint finds open is closed like the way of a moving support: at once by a time step, by load
    /// increments in a static solve. A slave's velocity becomes that of its masters.
    /// Errors, with nothing changed: SB_ERROR_INDEX (a node), SB_ERROR_ARGUMENT (an axis; a slave that is supported, as
    /// nodes of no element always are, the slave of another constraint, among its own masters, or in a circle of
    /// constraints; node and axis named), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY. A constraint with m master nodes couples
    /// them all: m^2 matrix blocks.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_constraint(sb_body* body, sb_constraint_term* terms, int count, double value, int* id, sb_error* error);
    /// <summary>
    /// Adds `count` constraints at once, all or none: constraint c has the next term_counts[c] of `terms` and values[c]
    /// (values NULL: all 0). They get the numbers *first_id, *first_id + 1, ... (first_id may be NULL).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_add_constraints(sb_body* body, sb_constraint_term* terms, int* term_counts, double* values, int count, int* first_id, sb_error* error);
    /// <summary>
    /// Changes the right-hand side (m) of one constraint; the next step or solve moves its slave there. Allocates nothing.
    /// SB_ERROR_INDEX: there is no such constraint; SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_set_constraint_value(sb_body* body, int id, double value);
    /// <summary>
    /// Removes the constraints first_id .. first_id + count - 1. SB_ERROR_INDEX when one of them does not exist,
    /// SB_ERROR_MEMORY: nothing removed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_remove_constraints(sb_body* body, int first_id, int count, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_remove_constraint(sb_body* body, int id, sb_error* error);
    /// <summary>
    /// Removes all; cannot fail.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_body_clear_constraints(sb_body* body);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_body_constraint_count(sb_body* body);
    /// <summary>
    /// Force of a constraint in the last step or static solve, its Lagrange multiplier (N per unit of coefficient): the
    /// constraint pushes node_k along axis_k with *force * coefficient_k. sb_body_reactions at supported masters include
    /// what their slaves pass on. SB_ERROR_INDEX leaves *force untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_constraint_force(sb_body* body, int id, double* force);
    /// <summary>
    /// Ties slave nodes to faces: each to the closest point of the present shape of all faces, u_s = sum_a N_a u_a + c with
    /// the face's shape functions there, along every axis that is not supported. To tie two meshes, put them in one body
    /// (sb_mesh_append) and let the finer or softer side be the slave.
    ///   faces         [face_count][corners]: corner nodes of element faces in any order, corners 3 (tet) or 4 (hex)
    ///   slave_nodes   [slave_count], different, none on the faces, none a slave already
    ///   max_distance  (m) nodes further away are left free; negative: a tenth of the closest face's diameter
    ///   options       sum of SB_TIE_..., 0: keep gaps, leave far nodes free
    ///   report        may be NULL
    /// c keeps each node's offset from the face as it is now, so that tying causes no stress by itself.
    /// What holds: slaves reproduce every displacement field that is linear in space exactly when gaps are 0, on flat and
    /// curved faces, and forces balance. Constant stress passes exactly across matching faces and where the slaves' grid
    /// refines the masters' (faces inside faces); else a node-to-surface tie leaves an error that falls with the element
    /// size, unless the interface carries no traction. Offsets do not turn with the faces: torque balances only for gaps
    /// of 0.
    /// Errors, with nothing changed: those of sb_body_add_constraint; SB_ERROR_ARGUMENT names the first face that no
    /// element has, or a node of both sides. Time O(slaves * faces), cheap each; memory during the call.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_tie_faces(sb_body* body, int* faces, int face_count, int corners, int* slave_nodes, int slave_count, double max_distance, int options, sb_tie_report* report, sb_error* error);
    /// <summary>
    /// Advances the body by dt (s, &gt; 0) with its integrator. Supports reach their targets exactly.
    ///
    /// With max_newton 1 the step is linearised (one system, Baraff and Witkin 1998): its cost is bounded and the
    /// result is taken even when max_iterations cut the linear solve short (info-&gt;capped). With hyperelastic materials,
    /// whose forces grow faster than displacements, it is shortened until no energy comes from nowhere. With more
    /// iterations each is followed by a line search on the step's potential, which also refuses inverted elements for
    /// materials that have no energy there.
    ///
    /// SB_CENTRAL_DIFFERENCE takes dt in equal substeps of at most 0.9 stable steps, as many as that needs; the stable step
    /// is found anew every 16 substeps as the body deforms; springs, mappings and constraints count in it, so that stiff
    /// ones make substeps short, and so does a tool that is near (contact.h). Substeps that go bad all the same (an element
    /// inverted, more energy than came in) are taken back, and the call is done again with shorter ones, up to three times.
    ///
    /// Prony terms move on with the step: exact where the relaxing stress changes evenly within it, of second order
    /// otherwise. Where a material that may turn inside out is nearly flat (det F &lt; 0.05) they remember less, and inside out
    /// nothing, lest the memory hold it there.
    ///
    /// info may be NULL. On failure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_DIVERGED,
    /// SB_ERROR_INDEFINITE; SB_ERROR_NOT_CONVERGED naming the stable step: more than max_substeps; SB_ERROR_UNSUPPORTED
    /// where Newmark meets SB_MASS_REDUCED, or central difference, and constraints that cannot be lumped) positions,
    /// velocities, accelerations, reactions and constraint forces are as before the call and the body can go on, to the last
    /// bit as if the call had not been; so is what Prony terms remember. Allocates nothing. Formulas: implicit Euler and
    /// Newmark in the increment du,
    ///     (ca M + cv D + K) du = f_ext - f_int - M a0 - D v0,  D = alpha M + beta K;
    /// generalised alpha the same with u at the time of its balance, from which the end of the step is extrapolated;
    /// supports and gaps of constraints are that share of their way along by then, pressures and the points of springs at
    /// their present values throughout. Where the material does not admit that end, the step is done again with spectral
    /// radius 0, whose balance is at the end. K in D is that of the start of the step, so that with beta &gt; 0 iterated
    /// steps of nonlinear bodies (Newmark, generalised alpha) are of first order in time.
    /// Central difference:
    ///     u' = u + h v + h^2/2 a,  (M + h/2 D) a' = f_ext(u') - f_int(u') - D (v + h/2 a),  v' = v + h/2 (a + a'),
    /// and of slaves u', v', a' follow from their masters, which carry the slaves' mass lumped (row sums of T^T M T).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_step(sb_body* body, double dt, sb_step_info* info);
    /// <summary>
    /// dt (s) = the longest step that is sure to be stable under SB_CENTRAL_DIFFERENCE at the present shape with the
    /// lumped mass, 2/omega_max from a bound of omega_max that is never below it: typically 0.8 to 0.99 of the true limit.
    /// Springs, mappings, pressures and constraints count, Prony terms with their instantaneous stiffness. Mass damping does
    /// not change it; supports of unconstrained bodies are left out of account. Works for bodies of any integrator and
    /// leaves their state as it is. Costs an assembly of the tangent and some products with it; allocates nothing. On
    /// failure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_NOT_FINITE, SB_ERROR_UNSUPPORTED for
    /// constraints that cannot be lumped) *dt is untouched; error may be NULL.
    /// Bound: max over rows of (|K| x)_i / (m_i x_i) for a positive x (Collatz 1942, Wielandt 1950), x by iteration.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_stable_step(sb_body* body, double* dt, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_static_options sb_default_static_options();
    /// <summary>
    /// Bodies made with SB_PRECOND_AUTO whose systems conjugate gradients would take long for, thin ones and those whose
    /// last solve took more than 1000 iterations, are factored (SB_PRECOND_CHOLESKY) up to 30,000 nodes; the factor is taken
    /// from the allocator and given back within the call; without memory for it conjugate gradients go on. Not with tools.
    ///
    /// Where rounding does not let a solve meet its tolerance, it ends with success and SB_STOP_FLOOR in info-&gt;statics.
    ///
    /// Finds the equilibrium under the present loads and supports: Newton with the exact tangent, projected to positive
    /// definite where it is not, a line search that refuses inverted elements, and adaptive load increments from the
    /// loads of the last static solve (0 at first) and the present shape. Velocities become 0. options NULL: defaults.
    ///
    /// Materials with Prony terms: the equilibrium long after, when all has relaxed that relaxes, with nothing else
    /// remembered; or (options-&gt;instantaneous) the one right after the loads changed in no time, from what is remembered.
    ///
    /// Errors: SB_ERROR_UNCONSTRAINED names a node of a part that can move freely; SB_ERROR_INVERTED names the element
    /// that would turn inside out; SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED after halving the increment six times.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_solve_static(sb_body* body, sb_static_options* options, sb_step_info* info);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_modes_options sb_default_modes_options();
    /// <summary>
    /// Finds the lowest `count` natural frequencies of the body with its supports (at rest where they are), constraints
    /// (their values play no part), springs and mappings. Other loads play none, but that pressures act at_present: with the
    /// symmetric part of their stiffness. Prony terms respond at once, as to the fastest of motions.
    /// Free rigid bodies (rigid.h) take part with their masses, about where they were added or, at_present, are now, where
    /// the forces on what hangs count with the turning of its arms.
    /// count        1 .. degrees of freedom that no support holds and no constraint eliminates; nodes that hang have none,
    ///              each free rigid body has six
    /// options      NULL: defaults
    /// frequencies  [count] (Hz), ascending, multiple ones as often as they are; rigid motions that the supports leave come
    ///              out as about 0 (rounding of K x), never as NaN
    /// shapes       [count][node_count] or NULL: displacements x (m) of unit modal mass, x^T M x = 1 kg m^2, at right
    ///              angles in M, rigid bodies' masses in it; 0 at supported axes; slaves follow their masters
    /// info, error  may be NULL
    /// Takes memory for about 2 count + 40 vectors from the body's allocator for the time of the call. The body's state is
    /// left as it is, to the last bit.
    /// Errors: SB_ERROR_ARGUMENT, SB_ERROR_MEMORY, SB_ERROR_INVERTED (at_present, naming the element), SB_ERROR_INDEFINITE
    /// (the present shape is not stable: it buckles), SB_ERROR_NOT_CONVERGED naming the mode; frequencies and shapes are
    /// then untouched.
    /// Method: Rayleigh-Ritz in a space that grows by (K + shift M)^-1 r of the residuals r of the lowest modes not yet
    /// found, from random vectors (block Davidson; Parlett 1998, 11 and 13); systems by PCG, loosely.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_modes(sb_body* body, int count, sb_modes_options* options, double* frequencies, sb_vec3* shapes, sb_modes_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_unload_def sb_default_unload_def();
    /// <summary>
    /// Finds the rest shape.
    /// rest    [node_count] (m) receives it; may be the imaged mesh's own nodes. Held nodes keep their place along the
    ///         held axes
    /// body    receives the body made from it, with its supports and loads, at rest in the imaged shape: destroy it with
    ///         sb_body_destroy. May be NULL. Quadratic elements with lumped masses weigh nodes otherwise in steps than in
    ///         statics, and move on from there by some thousandths of their size: SB_MASS_CONSISTENT stays
    /// report  may be NULL; written also on failure
    /// Makes a body for each trial, from def-&gt;body.allocator; the same bits for any number of threads. On failure rest and
    /// *body are untouched: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, whatever sb_body_create and dress say of the imaged
    /// mesh, SB_ERROR_MEMORY, SB_ERROR_UNCONSTRAINED, or that of the last trial where no rest shape is found
    /// (SB_ERROR_NOT_CONVERGED, SB_ERROR_INVERTED, SB_ERROR_INDEFINITE: the image is in balance but buckles away;
    /// report-&gt;gap and share tell how far it came). What asks too much: an image that its loads, put on as if it were at
    /// rest, would move by more than its size; a limit load.
    /// Success says that the image is in balance, not that it is stable: a straight column beyond its buckling load returns
    /// SB_OK (nothing pushes it aside), and under compression rest shapes need not be the only ones. Where that may be, ask
    /// sb_body_modes of *body with options.at_present: SB_ERROR_INDEFINITE where it would buckle.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_unload(sb_unload_def* def, sb_vec3* rest, sb_body** body, sb_unload_report* report, sb_error* error);
    /// <summary>
    /// Bytes that sb_body_state_save writes for this body. Loads, constraints, fibres and Prony terms change it, supports
    /// and other numbers of a material do not. 0: more than size_t holds. Cost: proportional to the body.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern UIntPtr sb_body_state_size(sb_body* body);
    /// <summary>
    /// Writes the state to buffer[size]; size must be at least sb_body_state_size, what is behind that stays. No allocation.
    /// SB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_state_save(sb_body* body, void* buffer, UIntPtr size);
    /// <summary>
    /// Makes the body what it was when buffer[size] was saved. Everything is checked before anything changes:
    /// SB_ERROR_FORMAT (no saved state, cut short, too long, damaged, a value out of its range), SB_ERROR_UNSUPPORTED (other
    /// version or precision), SB_ERROR_STATE (another body's), SB_ERROR_NOT_FINITE, SB_ERROR_ARGUMENT, SB_ERROR_MATERIAL;
    /// SB_ERROR_MEMORY when more room is needed than the allocator gives. On failure the body is as it was. Where supports,
    /// materials, loads and constraints need no more room and have the rows they had, nothing is allocated.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_state_load(sb_body* body, void* buffer, UIntPtr size, sb_error* error);
    /// <summary>
    /// The same with a file. The body's allocator lends the bytes meanwhile. SB_ERROR_FILE: cannot be opened, read or
    /// written; a file that could not be written whole is what it was before: see sb_output_open.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_state_save_file(sb_body* body, byte* path, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_state_load_file(sb_body* body, byte* path, sb_error* error);
    /// <summary>
    /// 64 bits that differ when anything a saved state holds does: equal for equal runs, whatever the machine or the number
    /// of threads. No allocation; cost: proportional to the body.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ulong sb_body_state_hash(sb_body* body);
    /// <summary>
    /// Begins to record a body, from its present state. One recording per body at a time.
    /// positions_every  &gt;= 0; 1: displacements of every step, k: of every k-th, the first included; 0: none
    /// allocator        of the recording, which grows geometrically; NULL: malloc
    /// Recording never makes a call on the body fail: when memory runs short the recording ends there and says so.
    /// SB_ERROR_ARGUMENT, SB_ERROR_MEMORY leave *recording untouched. Release with sb_recording_destroy.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_start(sb_body* body, int positions_every, sb_allocator* allocator, sb_recording** recording, sb_error* error);
    /// <summary>
    /// Stops listening; what was recorded stays. Also happens when the body is destroyed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_recording_stop(sb_recording* recording);
    /// <summary>
    /// Stops and releases; NULL is fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_recording_destroy(sb_recording* recording);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_recording_info sb_recording_get_info(sb_recording* recording);
    /// <summary>
    /// Writes sb_recording_info.bytes to buffer[size]; SB_ERROR_ARGUMENT when it is smaller (then untouched).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_save(sb_recording* recording, void* buffer, UIntPtr size);
    /// <summary>
    /// Makes a recording from what sb_recording_save wrote; whole and unharmed, or SB_ERROR_FORMAT, SB_ERROR_UNSUPPORTED
    /// (version, precision), SB_ERROR_MEMORY, SB_ERROR_ARGUMENT, with *recording untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_load(void* buffer, UIntPtr size, sb_allocator* allocator, sb_recording** recording, sb_error* error);
    /// <summary>
    /// The same with a file; SB_ERROR_FILE when it cannot be opened, read or written (then it is what it was before).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_save_file(sb_recording* recording, byte* path, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_load_file(byte* path, sb_allocator* allocator, sb_recording** recording, sb_error* error);
    /// <summary>
    /// Plays a recording on a body made from the same mesh with the same kinds of elements, mass and preconditioner (what
    /// else the def says comes with the recording): loads the state it began with, then repeats the calls.
    /// SB_OK when every step had its result and its hash. SB_ERROR_STATE: a step differed (the report says which; the body
    /// is as that step left it), or the body is not such a one. Another error: a call was refused that had not been (the
    /// body is as the calls before left it). SB_ERROR_ARGUMENT: NULL, or the body is the one being recorded. Of an
    /// incomplete recording what there is is played. report may be NULL. Takes memory from the recording's allocator for
    /// the longest list of arguments, and for constraints from the body's.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_replay(sb_recording* recording, sb_body* body, sb_recording_report* report);
    /// <summary>
    /// x = K^-1 rhs for `count` right-hand sides: what small forces (N) added to the present loads displace (m).
    ///   rhs        [count][node_count] (N); on supported axes it has no effect
    ///   x          [count][node_count] (m): 0 on supported axes, slaves of constraints follow their masters; may be rhs
    ///   tolerance  of conjugate gradients, |rhs - K x| / |rhs|, (0, 1); where rounding stops them above it, up to 1e4
    ///              SB_EPSILON will do. A factored solve is as exact as rounding lets it be
    /// A factored solve of many right-hand sides at once costs much less than one after the other.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_solve_tangent(sb_body* body, sb_vec3* rhs, sb_vec3* x, int count, double tolerance, sb_error* error);
    /// <summary>
    /// Derivatives of displacements and of reactions, one solve for each parameter.
    ///   parameters  [parameter_count]
    ///   du          [parameter_count][node_count]: du/dp (m per unit of the parameter)
    ///   dreaction   [parameter_count][node_count]: of sb_body_reactions, the force (N) of the supports on the body; or NULL
    /// More errors: SB_ERROR_ARGUMENT naming the parameter: no such kind, axis or constant in its material, a node that is
    /// not supported along the axis; SB_ERROR_INDEX: no such region, load or row.
    /// Method: K du/dp = -dr/dp, r = f_int - f_ext; reactions dr_s/dp + K_sf du_f/dp. dr/dp is exact: stresses are linear in
    /// constants, loads in theirs.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_sensitivities(sb_body* body, sb_parameter* parameters, int parameter_count, sb_vec3* du, sb_vec3* dreaction, sb_error* error);
    /// <summary>
    /// Gradient of a loss J(u, reactions) with respect to any number of parameters by one solve (adjoint).
    ///   dj_du         [node_count] dJ/du (J's unit per m); or NULL: 0
    ///   dj_dreaction  [node_count] dJ/d(reaction) (per N), of no effect on axes that are free; or NULL: 0
    ///   parameters    [parameter_count], NULL where parameter_count is 0
    ///   gradient      [parameter_count] dJ/dp: what goes through the equilibrium. What J has of p by itself is to be added
    ///   dj_dforce     [node_count] dJ/d(dead force on each node) (per N), or NULL
    /// Errors as sb_body_sensitivities.
    /// Method: K^T l = dJ/du + K^T w with w = dJ/dR on supports, m = l - w, dJ/dp = -m . dr/dp; of supports
    /// dJ/du - K^T m.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_body_gradient(sb_body* body, sb_vec3* dj_du, sb_vec3* dj_dreaction, sb_parameter* parameters, int parameter_count, double* gradient, sb_vec3* dj_dforce, sb_error* error);
    /// <summary>
    /// Gradient of a loss over all steps of a recording with respect to any number of parameters: one linear solve for each
    /// step, whatever their number.
    ///   recording   of steps of implicit Euler that are iterated (sb_body_def.max_newton &gt; 1) to newton_tolerance 1e-6 or
    ///               less, of any lengths; what was called before the first step is where it began
    ///   body        as of sb_recording_replay, and no recording listens to it. It ends as the recording does; on failure it
    ///               is what it was before
    ///   loss        see above
    ///   parameters  [parameter_count], of every kind but SB_PARAMETER_SUPPORT. A parameter that calls changed between steps
    ///               has all of its values shifted alike, and one of a load is of the steps in which the load was there
    /// Calls between steps count as given: a node held where it was is held at that place, whatever moves it there.
    /// Errors: those of sb_body_gradient and sb_recording_replay, about steps by number; SB_ERROR_UNSUPPORTED: another
    /// integrator or linearised steps, whose derivatives would need those of the tangent; Prony terms; damping in proportion
    /// to stiffness unless all materials are linear; damping by regions; a body whose mesh may change (def.slack); contact
    /// that presses; the density of a grid's elements; calls after the first step that set displacements, velocities or a
    /// state, or solve for a rest.
    /// Cost: the recording is played twice, and per step a tangent is made, factored up to 10,000 nodes, and solved with.
    /// Memory, for the time of the call: some 2 sqrt(steps) saved states and displacements.
    /// Method: adjoint. With A = M/dt^2 + D/dt + K at the end of a step, backwards: A l = dJ/du + U + V/dt, then
    /// U = (M/dt^2 + D/dt) l - V/dt and V = M l/dt of the step before; dJ/dp -= l . dr/dp, dJ/df = l.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_recording_gradient(sb_recording* recording, sb_body* body, sb_recording_loss* loss, sb_parameter* parameters, int parameter_count, sb_recording_slopes* slopes, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_identify_def sb_default_identify_def();
    /// <summary>
    /// Finds values[count + free_count], which come in as the start.
    ///   deviations   [count + free_count] standard deviations in the values' units, or NULL
    ///   own_shares   [count + free_count] or NULL: of what a value changes in the readings, the share (of its square, in
    ///                units of sigma) that no other values could change instead: 1 alone, 0 hidden by the others
    ///   info, error  may be NULL
    /// Derivatives are those of sb_body_sensitivities; one static solve for each state and trial, from the last accepted
    /// shape. The body ends with the values, at the equilibrium of the last state. On failure values and outputs are
    /// untouched and the body has its materials, shape and what `parameters` name again, but other loads and supports as
    /// `apply` has left them:
    /// SB_ERROR_ARGUMENT (the def; a start out of range; YOUNG or POISSON together with CONSTANT of one region),
    /// SB_ERROR_UNSUPPORTED (a kind that is not among those above; what sb_body_sensitivities does not derive),
    /// SB_ERROR_INDEX, SB_ERROR_NOT_FINITE, SB_ERROR_INDEFINITE (fewer readings than values, or a direction that no reading
    /// sees: the message names it), SB_ERROR_NOT_CONVERGED (max_iterations; or no step lowers chi2 any more, far from a
    /// minimum), SB_ERROR_MEMORY; what a static solve at the start, or `apply`, fails with.
    /// Method: Levenberg-Marquardt in log (nu: nu = 1/2 logistic(q); gravity, forces, pressures as they are), steps of at
    /// most 1 there; a trial whose solve fails counts as one that does not help. A value at a bound that would leave stays
    /// there, and the others take the step that is best with it there. Ends when chi2 falls by less than 1e-6 of itself or
    /// values move by less than 1e-8.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_identify(sb_identify_def* def, double* values, double* deviations, double* own_shares, sb_identify_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_network_def sb_default_network_def();
    /// <summary>
    /// Loads a weights file; def NULL: defaults. Takes all memory, about 4 bytes for each weight and for each channel of
    /// each node in each layer. The file may hold anything: all of it is checked before it is used. Errors, with *network
    /// untouched: SB_ERROR_FILE, SB_ERROR_FORMAT (not a weights file, cut off, too long, a checksum that differs, or layers
    /// that do not fit one another: error.message names the layer), SB_ERROR_NOT_FINITE (a weight), SB_ERROR_UNSUPPORTED
    /// (more memory than def.max_bytes), SB_ERROR_ARGUMENT, SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_network_load(byte* path, sb_network_def* def, sb_network** network, sb_error* error);
    /// <summary>
    /// The same of a file's bytes[size], which are not kept.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_network_load_memory(byte* bytes, UIntPtr size, sb_network_def* def, sb_network** network, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_network_destroy(sb_network* network);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_network_shape sb_network_get_shape(sb_network* network);
    /// <summary>
    /// output[z][y][x][outputs] = the network's answer to input[z][y][x][inputs], all nodes of the lattice. Allocates
    /// nothing; same bits for any threads, which share the planes of each layer. Not from two threads at a time. On failure
    /// the output is untouched: SB_ERROR_ARGUMENT (NULL), SB_ERROR_NOT_FINITE (the input, or what floats cannot hold came
    /// out). Denormal numbers are computed with as any, and take longer.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_network_run(sb_network* network, float* input, float* output);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_network_input sb_default_network_input();
    /// <summary>
    /// Guesses the equilibrium of a body of this grid (made from grid-&gt;body_mesh, with nodes as they were made) under its
    /// present loads and supports. Supports and slaves of constraints are put where they belong. info and error may be NULL.
    /// SB_NETWORK_TAKE allocates nothing. On failure the body is as it was: SB_ERROR_ARGUMENT (a field, or a grid that is
    /// not the body's or does not fit the network's lattice, spacing within 1e-3), SB_ERROR_MATERIAL (a material whose
    /// Poisson's ratio is off the network's by more than 0.005), SB_ERROR_INDEX and SB_ERROR_NOT_FINITE naming the node,
    /// SB_ERROR_UNSUPPORTED (a network with other channels; tools in the body's contact; def.slack), what the network
    /// refuses, what sb_body_solve_static refuses. A guess that is inside out is no failure: it does not pass.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_network_predict(sb_network* network, sb_grid* grid, sb_body* body, sb_network_input* input, sb_network_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_heat_tissue sb_default_heat_tissue();
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_heat_def sb_default_heat_def();
    /// <summary>
    /// Heat of a body, one for each at most. Takes all memory for steps from the body's allocator. It becomes part of the
    /// body's saved states, recordings and hashes: create it in the body that loads them, too. Destroy it before the body.
    /// The def's arrays are copied. Errors, with *heat untouched: SB_ERROR_ARGUMENT (the field, element or region is named;
    /// the body has one already), SB_ERROR_NOT_FINITE, SB_ERROR_INDEX (a region that the mesh does not have),
    /// SB_ERROR_UNSUPPORTED (def.slack, or clouds), SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_create(sb_body* body, sb_heat_def* def, sb_heat** heat, sb_error* error);
    /// <summary>
    /// The body is as stiff as its materials again. NULL is fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_heat_destroy(sb_heat* heat);
    /// <summary>
    /// The nodes have these temperatures (K, &gt; 0) from the next step on; one for all when uniform is 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_hold(sb_heat* heat, int* nodes, int count, double* temperatures, int uniform, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_release(sb_heat* heat, int* nodes, int count, sb_error* error);
    /// <summary>
    /// An applicator's power (W, below 0: it cools) around the line from one place of the rest shape to another (m; or the
    /// same: a ball): nodes get it by their volume times exp(-d^2 / (2 radius^2)), d their distance. All of it arrives,
    /// however coarse the mesh; radius 0: at the nearest nodes.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_add_source(sb_heat* heat, sb_vec3 from, sb_vec3 to, double radius, double power, int* id, sb_error* error);
    /// <summary>
    /// Power (W) at nodes by these shares[count], which sum to 1; NULL: evenly.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_add_node_source(sb_heat* heat, int* nodes, int count, double* shares, double power, int* id, sb_error* error);
    /// <summary>
    /// Power per volume (W/m^3) in elements; NULL and 0: in all.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_add_element_source(sb_heat* heat, int* elements, int count, double density, int* id, sb_error* error);
    /// <summary>
    /// Power per area (W/m^2) into faces.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_add_flux(sb_heat* heat, int* faces, int face_count, int corners, double flux, int* id, sb_error* error);
    /// <summary>
    /// Faces that give coefficient (W/(m^2 K), &gt;= 0) times their temperature above the surroundings' (K, &gt; 0).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_add_convection(sb_heat* heat, int* faces, int face_count, int corners, double coefficient, double surroundings, int* id, sb_error* error);
    /// <summary>
    /// Another power (W), density (W/m^3) or flux (W/m^2) of what was added as such; without allocation. SB_ERROR_INDEX: no
    /// source has this id.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_set_source(sb_heat* heat, int id, double value);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_set_convection(sb_heat* heat, int id, double coefficient, double surroundings);
    /// <summary>
    /// Takes a source or convection away.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_remove(sb_heat* heat, int id);
    /// <summary>
    /// What it gives the body at present (W).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_power(sb_heat* heat, int id, double* power);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_set_blood(sb_heat* heat, double temperature);
    /// <summary>
    /// temperatures[node_count] (K, &gt; 0), but for nodes that are held; SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT name the
    /// node. Damage stays.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_set_temperatures(sb_heat* heat, double* temperatures, sb_error* error);
    /// <summary>
    /// def.start everywhere, no damage, nothing in the balance; sources and held nodes stay.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_heat_reset(sb_heat* heat);
    /// <summary>
    /// Advances by dt (s, &gt; 0) with implicit Euler: temperatures, then damage, then the elements' stiffness. Keep dt where
    /// sources or damage change little within it, 1 s and less. Damage is integrated along the line between both
    /// temperatures, by trapezoids of 1 K and less. Allocates nothing. info and error may be NULL. A step that fails is
    /// undone: SB_ERROR_ARGUMENT, SB_ERROR_NOT_CONVERGED, SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (not finite, or below 0 K,
    /// naming the node).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_step(sb_heat* heat, double dt, sb_heat_info* info, sb_error* error);
    /// <summary>
    /// Temperatures that no longer change under the present sources, with blood where tissue is alive by now. Damage,
    /// stiffness and balance stay as they are. Also SB_ERROR_UNCONSTRAINED, naming a node of a part that nothing holds,
    /// cools or perfuses, but for what rounding would take beside what it conducts (2e-12 of that).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_heat_solve_steady(sb_heat* heat, sb_heat_info* info, sb_error* error);
    /// <summary>
    /// ---- readings: no allocation ----
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double* sb_heat_temperatures(sb_heat* heat);
    /// <summary>
    /// [node_count] (K), valid until destroyed
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double* sb_heat_damage(sb_heat* heat);
    /// <summary>
    /// shares[node_count]: 1 - exp(-Om), 0 alive to 1 dead.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_heat_dead_shares(sb_heat* heat, double* shares);
    /// <summary>
    /// Volume of tissue at rest (m^3) times the share of it that is dead, summed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double sb_heat_dead_volume(sb_heat* heat);
    /// <summary>
    /// factors[sb_body_element_count] of the elements' stiffness, see def.stiffening.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_heat_stiffness(sb_heat* heat, double* factors);
    /// <summary>
    /// Sums of all steps since creation or the last reset (J).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_heat_flows sb_heat_balance(sb_heat* heat);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_tool_def sb_default_tool_def();
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_contact_def sb_default_contact_def();
    /// <summary>
    /// SB_ERROR_ARGUMENT names the field; SB_ERROR_STATE: the body has a contact already; SB_ERROR_UNSUPPORTED: its steps
    /// are explicit and def.pairs is not 0, or it is of custom elements and def.skin is given; SB_ERROR_STATE also for a
    /// skin that is none of this body's mesh, or does not follow its changes; SB_ERROR_MESH: it has no surface, or def.pairs
    /// is not 0 and def.skin (one of sb_skin_create) is open, turned against itself or inside out: error-&gt;element is the
    /// triangle; SB_ERROR_MEMORY. *contact is then untouched. Nothing allocates afterwards but sb_contact_add_tool.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_create(sb_contact_def* def, sb_contact** contact, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_contact_destroy(sb_contact* contact);
    /// <summary>
    /// Makes a tool; *tool is its number, the lowest that is free. What sbi_tool_create refuses; SB_ERROR_ARGUMENT: it
    /// overlaps the body by more than half its inner radius (error-&gt;element: the cell of the deepest face), or lies inside
    /// the body, however small it is and whether or not it touches a face (error-&gt;element: the cell of a face near it; of a
    /// skin that is open: where lines along all axes of space leave it), or max_tools are there, or the pose takes it too
    /// far, see below; SB_ERROR_UNSUPPORTED: so thin that the faces would need too many samples (needle.h is for such).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_add_tool(sb_contact* contact, sb_tool_def* def, int* tool, sb_error* error);
    /// <summary>
    /// In all calls below SB_ERROR_ARGUMENT: no contact, or a point of the tool would be farther than 1e9 m from the origin,
    /// or so far that rounding moves it by a hundredth of its radius (of 1 cm in floats: 840 m); SB_ERROR_INDEX: no such
    /// tool; SB_ERROR_NOT_FINITE: a number that is none. Nothing changes then.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_remove_tool(sb_contact* contact, int tool);
    /// <summary>
    /// Where it is to be at the end of the next step.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_move_tool(sb_contact* contact, int tool, sb_pose* pose);
    /// <summary>
    /// At once, without a way, and with its contacts forgotten. SB_ERROR_ARGUMENT: too deep in the body or inside it, as at
    /// creation.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_place_tool(sb_contact* contact, int tool, sb_pose* pose, sb_error* error);
    /// <summary>
    /// Capsules: the chain at the end of the next step, points[as many as the def had] (m, in the tool's frame).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_bend_tool(sb_contact* contact, int tool, sb_vec3* points);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_set_friction(sb_contact* contact, int tool, double friction);
    /// <summary>
    /// What the body does to the tool: the sum of exactly the forces put on the body's nodes, with the opposite sign.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_wrench(sb_contact* contact, int tool, sb_wrench* on_tool);
    /// <summary>
    /// Where the tool is, and how far a point of it may still be from where it was sent (m). Either place may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_reached(sb_contact* contact, int tool, sb_pose* pose, double* lag);
    /// <summary>
    /// k[i][j]: what component i of the wrench (force, then torque about the tool's position, which goes along) would change
    /// by if the tool had gone farther along axis j (m), or turned (rad) about axis j - 3 through its position, with the
    /// tissue giving way as in the last step: N/m, N, N m. Of a step that was divided (info.substeps) as in its last part:
    /// inertia makes tissue stiffer over a shorter time. What slips keeps its bound, and normals their directions. Of a
    /// tool on a spring that of the surface alone. Six linear solves to 1e-3, which allocate nothing. 0 where nothing
    /// touches. SB_ERROR_STATE: something was done since the last step or static solve (a state loaded, a tool placed), so
    /// that its system is gone.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_stiffness(sb_contact* contact, int tool, IntPtr k);
    /// <summary>
    /// What its spring does to a tool with coupling_stiffness; 0 for others. It is the wrench with the opposite sign, to
    /// 1e-9, but in a step in which the tool went as far as it may, and for the torque of a tool that turns as it is sent
    /// to.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_coupling(sb_contact* contact, int tool, sb_wrench* on_tool);
    /// <summary>
    /// Reads two tools as one grip: any two, whatever holds them. SB_ERROR_INDEX: no such tool, or twice the same.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_grip(sb_contact* contact, int jaw, int other, sb_grip* grip);
    /// <summary>
    /// How many there are, the first `capacity` of them in points (NULL with capacity 0).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_contact_points(sb_contact* contact, sb_contact_point* points, int capacity);
    /// <summary>
    /// [node_count], with a skin [its points]: mean pressure (Pa at rest) that tools exert on the surface there: for
    /// drawing. 0 elsewhere.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_contact_pressures(sb_contact* contact, double* pressures);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_contact_info sb_contact_get_info(sb_contact* contact);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_haptic_def sb_default_haptic_def();
    /// <summary>
    /// Takes all memory that is ever needed. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE: the field is named; SB_ERROR_INDEX: the
    /// contact has no such tool; SB_ERROR_UNSUPPORTED: the body's steps are explicit, or the compiler has no atomics that
    /// are known here, so that SB_ATOMIC_EXCHANGE and SB_ATOMIC_LOAD must be defined before the implementation;
    /// SB_ERROR_MEMORY. *haptic is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_haptic_create(sb_haptic_def* def, sb_haptic** haptic, sb_error* error);
    /// <summary>
    /// NULL is fine. Neither thread may be in a call.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_haptic_destroy(sb_haptic* haptic);
    /// <summary>
    /// Simulation, before the step: the tool is to go where the hand drew it by its last call (sb_contact_move_tool); of a
    /// tool on a spring the spring's other end goes where the hand is.
    /// wanted (NULL: not asked for): that pose, and the hand's velocities, time and buttons; 0 before the first call. What
    /// sb_contact_move_tool returns; SB_ERROR_ARGUMENT: NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_haptic_take(sb_haptic* haptic, sb_tool_state* wanted);
    /// <summary>
    /// Simulation, right after the step, before anything else is asked of the body: what the tool feels, and how that
    /// changes with its pose. Costs about a tenth of the step: one solution of the step's system, for one stiffness in turn.
    /// SB_ERROR_ARGUMENT: NULL; SB_ERROR_INDEX: the tool was removed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_haptic_publish(sb_haptic* haptic);
    /// <summary>
    /// Device, about every 1 ms, one thread at a time: *out is finite and within the def's limits whatever `in` is. 1: it
    /// follows the hand; 0: it fades, or there is none. No lock, no allocation, no loop without a bound.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_haptic_force(sb_haptic* haptic, sb_tool_state* @in, sb_wrench_d* @out);
    /// <summary>
    /// Simulation: as of the last sb_haptic_take.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_haptic_info sb_haptic_get_info(sb_haptic* haptic);
    /// <summary>
    /// A device's state from what OpenHaptics gives: HD_CURRENT_TRANSFORM (column-major, mm) and HD_CURRENT_VELOCITY (mm/s).
    /// Time and buttons are the caller's to fill in; NULL: all 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_tool_state sb_haptic_from_hd(double* transform, double* velocity_mm);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_cut_def sb_default_cut_def();
    /// <summary>
    /// Makes what cuts a body; one at a time for each body, to be destroyed before or after it. SB_ERROR_ARGUMENT,
    /// SB_ERROR_UNSUPPORTED (slack 0, other elements), SB_ERROR_STATE (a body that is cut already), SB_ERROR_MEMORY. With
    /// multigrid it makes the levels once more (25 ms of 129,600 tets), so that the first cut takes as long as others.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_create(sb_cut_def* def, sb_cut** cut, sb_error* error);
    /// <summary>
    /// The body stays cut, and keeps what tells its pieces apart (sb_body_find_cell), for points and needles that are in
    /// them: in its own memory; where there is none left they are held as if nobody knew the pieces. NULL is fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_cut_destroy(sb_cut* cut);
    /// <summary>
    /// Cuts along triangles: a blade's way, a plane, a closed surface around what is to be taken out.
    /// triangles  [count][3] corners where the body is now (m); triangles without area are skipped
    /// info       may be NULL
    /// On failure body and cut are as they were: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_STATE (see above), and
    /// what sb_body_change_commit says. Between steps only. Allocates nothing while slack and room last. Cells look for
    /// triangles near them in a tree, on the body's jobs, and where cells are parted the mesh changes: 13,440 tets, m = 2,
    /// one thread: 0.02 ms beside the body, 4 ms for a frame that parts 100 cells, 18 ms for a plane through all.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_triangles(sb_cut* cut, sb_vec3* triangles, int count, sb_cut_info* info, sb_error* error);
    /// <summary>
    /// Begins a stroke of a blade.
    /// edge    [count] corners of the blade's edge, where it is now (m); 2 or more. It cuts nothing yet
    /// *stroke is its number
    /// SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_STATE (see above, or def.max_strokes are under way),
    /// SB_ERROR_MEMORY. Allocates nothing while edges go through some 200 faces of elements at most.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_begin(sb_cut* cut, sb_vec3* edge, int count, int* stroke, sb_error* error);
    /// <summary>
    /// Moves the blade: what lies between where its edge was in the tissue, which may have moved since, and where it is now
    /// is cut. Once a frame, between steps; also where the blade rests and the tissue moves.
    /// edge       as many corners as at the beginning, where they are now (m)
    /// info       may be NULL
    /// On failure body, cut and stroke are as they were, and the next move goes on from the last good one: SB_ERROR_INDEX
    /// (no such stroke), and as sb_cut_triangles.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_move(sb_cut* cut, int stroke, sb_vec3* edge, sb_cut_info* info, sb_error* error);
    /// <summary>
    /// Moves scissors: their stroke is begun with the edge tips[0], hinge, tips[1]. Closing cuts what the blades pass
    /// between where they were in the tissue and where they are now, until they meet; open or opening, at rest or shut they
    /// cut nothing, wherever they go.
    ///
    /// hinge  where both blades begin, now (m)
    ///
    /// tips   [2] their ends
    ///
    /// info   may be NULL. torque is about the hinge; work over the angle is the moment that closing takes
    ///
    /// Else as sb_cut_move; SB_ERROR_ARGUMENT also for a stroke that has not 3 corners.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_scissors(sb_cut* cut, int stroke, sb_vec3 hinge, sb_vec3* tips, sb_cut_info* info, sb_error* error);
    /// <summary>
    /// Ends a stroke; one that is not under way is fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_cut_end(sb_cut* cut, int stroke);
    /// <summary>
    /// Takes out what lies in a ball: as a cautery burns or a sucker draws it.
    /// centre, radius  where the body is now (m); radius &gt;= 0
    /// info            may be NULL
    /// Points of the lattice in the ball go, and links from them to others are cut at the ball's surface, where
    /// sb_cut_surface says SB_CUT_CHAR; what comes off thereby is a part of its own. Of a smooth ball of twice an element's
    /// size lattice 4 takes the volume to 2 %. Errors as sb_cut_triangles, and SB_ERROR_ARGUMENT: a negative radius. Cost as
    /// of a cut of the elements on the ball's surface.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_ablate(sb_cut* cut, sb_vec3 centre, double radius, sb_cut_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_tear_options sb_default_tear_options();
    /// <summary>
    /// Tears what is stretched too far: elements whose largest principal stress (Cauchy) is over sqrt((lambda + 2 mu) J_c /
    /// (4 h)), with def.toughness J_c and h their volume over the area of the section torn, come apart across it, the worst
    /// first. Those that a cut has come to tear first, on from there; else one in a call begins a new tear. Between steps;
    /// stresses are those of the body as it is, so that a tear goes on as steps bring stress to its front. Tears take J_c
    /// for their area within 20 %, for tet4 and Poisson's ratios up to 0.3; nearly incompressible tet4 half to twice that.
    /// options    NULL: defaults
    /// info       may be NULL
    ///
    /// On failure body and cut are as they were: SB_ERROR_ARGUMENT (toughness 0, too), SB_ERROR_STATE, SB_ERROR_MEMORY, and
    /// what sb_body_change_commit says. The first call allocates; each reads the stress of all cells (13,440 tets, one
    /// thread: 4 ms).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_tear(sb_cut* cut, sb_tear_options* options, sb_cut_info* info, sb_error* error);
    /// <summary>
    /// Node of the uncut mesh that a node is a copy of, or itself; -1: none. Of elements: the one that a cell is of.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_cut_node_origin(sb_cut* cut, int node);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int sb_cut_cell_element(sb_cut* cut, int cell);
    /// <summary>
    /// The surface of a body that is cut by `cut`, which it is to be destroyed before. allocator NULL: malloc. Has room for
    /// the lips of a cut half through the body from the start: 3 MB for 13,000 elements with a lattice of 2.
    /// SB_ERROR_ARGUMENT, SB_ERROR_STATE (as sb_cut_triangles), SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_surface_create(sb_cut* cut, sb_allocator* allocator, sb_cut_surface** surface, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_cut_surface_destroy(sb_cut_surface* surface);
    /// <summary>
    /// To what the body is now. Where it was cut since the last call, the triangles of all elements with cuts are made anew,
    /// and arrays may grow; else only vertices move. SB_ERROR_STATE: as sb_cut_triangles. SB_ERROR_MEMORY: what is drawn is
    /// not whole, and the next call tries again.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_surface_update(sb_cut_surface* surface, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_cut_drawing sb_cut_surface_get(sb_cut_surface* surface);
    /// <summary>
    /// The surface as a skin, for sb_contact_def.skin: tools touch the skin and the lips of the body where they are, not the
    /// whole elements whose pieces move there; and with sb_contact_def.pairs so do parts that were cut off, and the two lips
    /// of a cut. It is the surface's, and nothing of its own is to be destroyed; the contact
    /// goes first.
    /// Contact follows each call that cuts and each state that is loaded in the step that comes next, which may take memory
    /// then, and remembers what it did of triangles that are still there; until then it reads as before. It brings the
    /// surface up to date for that: arrays of sb_cut_surface_get are to be got again after a step, and the next
    /// sb_cut_surface_update still names all that was made since the one before. Where that fails, the step says so. NULL of
    /// NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_skin* sb_cut_surface_skin(sb_cut_surface* surface);
    /// <summary>
    /// A skin for the body that is cut by `cut`, which it is to be destroyed before.
    /// skin       SB_TRI3, at rest where the body's mesh is (m), copied
    /// allocator  NULL: malloc
    /// SB_ERROR_ARGUMENT (other elements), what sb_mesh_validate says of the skin, SB_ERROR_STATE (as sb_cut_triangles),
    /// SB_ERROR_MEMORY. Finds the element of each vertex: some 2 us each.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_fine_create(sb_cut* cut, sb_mesh* skin, sb_allocator* allocator, sb_cut_fine** fine, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void sb_cut_fine_destroy(sb_cut_fine* fine);
    /// <summary>
    /// To what the body is now. Where it was cut since the last call all triangles are listed anew, and arrays may grow;
    /// else only vertices move. SB_ERROR_STATE: as sb_cut_triangles. SB_ERROR_MEMORY: what is drawn is what it was, and the
    /// next call tries again.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result sb_cut_fine_update(sb_cut_fine* fine, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_cut_fine_drawing sb_cut_fine_get(sb_cut_fine* fine);
    /// <summary>
    /// The section of a known needle. Diameters: regular-wall gauge table after the Birmingham wire gauge (18 G: 1.270
    /// mm, 22 G: 0.7176 / 0.413 mm). Steel: AISI 304, annealed, 193 GPa, 0.29, 8000 kg/m^3. Nitinol: austenite, 75 GPa,
    /// 0.33, 6450 kg/m^3 (makers' sheets: 75 to 83 GPa; linear up to a strain of about 1 % only). SB_ERROR_ARGUMENT for
    /// an unknown preset leaves *section untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_section_preset(ndl_rod_preset preset, ndl_rod_section* section);
    /// <summary>
    /// E A, E pi (r^4 - ri^4)/4 twice, bending/(1 + nu), rho A. The section must be valid.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_rod_stiffness ndl_rod_stiffness_of(ndl_rod_section* section);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_rod_def ndl_default_rod_def();
    /// <summary>
    /// Creates a rod at rest, with no twist but what its rest shape asks for. All memory it will ever need is taken here.
    /// On failure *rod is untouched: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named), SB_ERROR_MESH (node
    /// named: an edge without length, or one turned back), SB_ERROR_MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_create(ndl_rod_def* def, ndl_rod** rod, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_rod_destroy(ndl_rod* rod);
    /// <summary>
    /// From the next step or static solve on the node is held at `position` (m), with `velocity` (m/s) at the end of the
    /// step; NULL: the mean velocity of its way there. Where both nodes of an end edge are held the end is clamped: the
    /// tangent is given at the inner one of them.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_hold(ndl_rod* rod, int node, sb_vec3 position, sb_vec3* velocity);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_release(ndl_rod* rod, int node);
    /// <summary>
    /// The material frame of an edge is held and will turn by `angle` (rad, any size) about the edge's tangent in the next
    /// step or static solve; otherwise it turns only as the edge does.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_turn(ndl_rod* rod, int edge, double angle);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_release_turn(ndl_rod* rod, int edge);
    /// <summary>
    /// The base as a sleeve holds it: node 0 at `position`, edge 0 along `tangent` (any length but 0) at its rest length, m1
    /// along `director` (projected). The frame is turned there the short way: less than half a turn from the last one,
    /// carried along with the tangent. velocity (m/s) of the sleeve's point and angular_velocity (rad/s); both NULL or
    /// both given.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_hold_base(ndl_rod* rod, sb_vec3 position, sb_vec3 tangent, sb_vec3 director, sb_vec3* velocity, sb_vec3* angular_velocity);
    /// <summary>
    /// Dead force (N) on a node, and torque (N m) about its tangent on an edge; they replace those before.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_force(ndl_rod* rod, int node, sb_vec3 force);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_torque(ndl_rod* rod, int edge, double torque);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_gravity(ndl_rod* rod, sb_vec3 gravity);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_damping(ndl_rod* rod, double stretch, double bending);
    /// <summary>
    /// What surrounds an edge holds it against turning about its tangent: a torsion spring of this stiffness (N m/rad, &gt;= 0;
    /// 0: none, the default) that slips at the torque `limit` (N m, &gt;= 0). In each motion it is wound by the turn of the
    /// material frame beyond what the edge's own way asks for. It replaces the grip before: a stiffer one keeps the torque
    /// (what comes to it is not yet wound), a softer one how far it is wound, both up to the new limit. For a grip per
    /// length give both times the edge's length. When edges are split, merged or set anew, their halves, sums or shares
    /// follow.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_grip(ndl_rod* rod, int edge, double stiffness, double limit);
    /// <summary>
    /// Advances the rod by dt (s, &gt; 0) with Newmark's average acceleration (beta 1/4, gamma 1/2: second order),
    ///     M a' = f(x', v'),  x' = x + dt v + dt^2 (a + a')/4,  v' = v + dt (a + a')/2,
    /// by Newton's method with a banded direct solve, frames eliminated together with the nodes; each iteration lowers the
    /// step's potential. While supports and loads do not change the energy is watched: a step that would raise it above
    /// where it was when they last changed by more than 1 % of what is in motion and in strain is taken by implicit Euler,
    /// which only loses energy. Without supports linear momentum is kept to rounding.
    /// info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED: a torque about a rod no edge of which is
    /// held; SB_ERROR_DIVERGED) the rod is as before the call, to the last bit. Allocates nothing; cost grows with
    /// node_count, about 30 us for 20 nodes and an iteration.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_step(ndl_rod* rod, double dt, ndl_rod_info* info);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_rod_static_options ndl_default_rod_static_options();
    /// <summary>
    /// Finds the equilibrium nearest downhill under the present loads and supports; velocities become 0. Newton with the
    /// exact Hessian of stretch, bending and twist where that is positive definite; where it is not, the lower end of two
    /// steps: of the same with the least diagonal that makes it so, and of Gauss-Newton. At a buckling load that takes some
    /// 30 iterations, well beyond it up to 110. Steps turn edges rather than stretch them, and a line search lets the energy
    /// only fall. Supports move there in pieces
    /// when their way is long. A straight rod under more than its buckling load is in equilibrium and stays so until
    /// something pushes it aside. options and info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED:
    /// the supports leave the rod free to move; SB_ERROR_NOT_CONVERGED; SB_ERROR_DIVERGED) the rod is as before the call.
    /// Allocates nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_solve_static(ndl_rod* rod, ndl_rod_static_options* options, ndl_rod_info* info);
    /// <summary>
    /// Overwrites positions [node_count] or velocities [node_count]; frames follow as if the rod had been moved there.
    /// SB_ERROR_NOT_FINITE, SB_ERROR_MESH (node named) change nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_positions(ndl_rod* rod, sb_vec3* positions, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_set_velocities(ndl_rod* rod, sb_vec3* velocities);
    /// <summary>
    /// A new node j + 1 in the middle of edge j, on the cubic through both ends with their tangents; it is held when both
    /// were.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_split_edge(ndl_rod* rod, int edge);
    /// <summary>
    /// Takes the inner node out: its edges become one.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_merge_node(ndl_rod* rod, int node);
    /// <summary>
    /// Feeds `length` (m, either sign) of rod through the base: edge 1 gets longer or shorter at rest. SB_ERROR_ARGUMENT
    /// when nothing would be left of it, or the rod has no edge 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_feed(ndl_rod* rod, double length);
    /// <summary>
    /// Gives the rod other nodes, `count` of them, on (about) its own curve; the first and the last should be its ends. What
    /// it carries follows by arc distance, scaled so that both ends agree: velocities and accelerations linearly, rest
    /// lengths, rest curvature and material frames by Akima's interpolation. Total rest length, mass and linear momentum
    /// stay, and so does the material frame of edge 0; the rest length of edge 0, too, where its nodes are held. Supports
    /// and loads of nodes 0 and 1 and of edge 0 stay, all others are dropped. positions [count] (m) are read during the
    /// call. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (count above capacity), SB_ERROR_NOT_FINITE and SB_ERROR_MESH (node
    /// named: an edge without length, or one turned back) change nothing. Allocates nothing. Source: Chentanez 2010,
    /// section 9.2.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_reparameterise(ndl_rod* rod, sb_vec3* positions, int count, sb_error* error);
    /// <summary>
    /// ---- readings: no allocation ----
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_rod_node_count(ndl_rod* rod);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* ndl_rod_positions(ndl_rod* rod);
    /// <summary>
    /// [node_count] (m), valid until destroyed
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* ndl_rod_velocities(ndl_rod* rod);
    /// <summary>
    /// [node_count] (m/s)
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_rod_mass(ndl_rod* rod, int node);
    /// <summary>
    /// kg
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_rod_rest_length(ndl_rod* rod, int edge);
    /// <summary>
    /// Material frame of an edge, 0 &lt;= edge &lt; node_count - 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_frame ndl_rod_frame(ndl_rod* rod, int edge);
    /// <summary>
    /// Tip position (m) and the frame of the last edge; either may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_rod_tip(ndl_rod* rod, sb_vec3* position, ndl_frame* frame);
    /// <summary>
    /// Curvature (1/m) at an inner node, 0 &lt; node &lt; node_count - 1, towards m1 and m2 (mean of the two edges' frames).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_rod_curvature(ndl_rod* rod, int node, double* curvature);
    /// <summary>
    /// Twist (rad) at an inner node: the turn of the material frame from one edge to the next beyond parallel transport.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_rod_twist(ndl_rod* rod, int node);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_rod_energy ndl_rod_energies(ndl_rod* rod);
    /// <summary>
    /// Elastic and viscous force (N) on every node from the present state, forces[node_count]: minus the gradient of the
    /// elastic energy at fixed material frames, and the damping.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_rod_forces(ndl_rod* rod, sb_vec3* forces);
    /// <summary>
    /// Force (N) of the supports on each node in the last step or static solve, 0 where free; [node_count].
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* ndl_rod_reactions(ndl_rod* rod);
    /// <summary>
    /// Torque (N m) about the tangent that holds an edge's frame, in the last step or static solve; 0 where free.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_rod_reaction_torque(ndl_rod* rod, int edge);
    /// <summary>
    /// Torque (N m) about the tangent with which the surroundings' grip turns an edge; 0 where there is none.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_rod_grip_torque(ndl_rod* rod, int edge);
    /// <summary>
    /// What holds the base, as force (N) and torque (N m) about node 0 on the rod: what a hand feels is the opposite.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_rod_base_wrench(ndl_rod* rod, sb_vec3* force, sb_vec3* torque);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_remesh_def ndl_default_remesh_def();
    /// <summary>
    /// SB_ERROR_ARGUMENT (field named; the body has a remesher already), _UNSUPPORTED (elements other than SB_TET4;
    /// def.slack was 0), _MEMORY leave *remesh untouched. While it has changed the mesh, changes by others are refused
    /// (SB_ERROR_STATE).
    ///
    /// From now on the remesher is part of the body's saved state, its hash and its recording: sb_body_state_load asks for a
    /// body with a remesher of the same def, and brings needles, splits and what is needed to undo them back to the last
    /// bit. A recording of the body holds the calls below; it is played on a body with such a remesher. Make remeshers
    /// before a recording is started, and destroy them after it has been stopped: what follows otherwise is refused when it
    /// is played.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_create(ndl_remesh_def* def, ndl_remesh** remesh, sb_error* error);
    /// <summary>
    /// Leaves the body as it is. Safe on NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_remesh_destroy(ndl_remesh* remesh);
    /// <summary>
    /// Takes the memory that a needle of up to so many nodes in the tissue usually needs, so that calls ask for none while
    /// the mesh keeps to its slack. SB_ERROR_INDEX, _ARGUMENT (nodes &lt; 0) and _MEMORY change nothing that can be seen.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_reserve(ndl_remesh* remesh, int needle, int nodes, sb_error* error);
    /// <summary>
    /// First contact: puts a node where the skin was hit, which is the needle's entry from then on, and its tip until it
    /// goes deeper. The skin keeps its shape: nodes of it move within flat parts only, edges are split where the point lies
    /// on them or their faces are in one plane; but see entry_slip. info-&gt;X: where the entry is.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_puncture(ndl_remesh* remesh, int needle, ndl_surface_hit* hit, ndl_remesh_info* info, sb_error* error);
    /// <summary>
    /// The tip cuts on (retracts) to X_new (m, in the material), by as many operations as ndl_remesh_limit asks for, in a
    /// straight line. After a failure it stays where the last operation brought it. A point outside: see
    /// ndl_remesh_info.outside.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_penetrate(ndl_remesh* remesh, int needle, sb_vec3 X_new, ndl_remesh_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_retract(ndl_remesh* remesh, int needle, sb_vec3 X_new, ndl_remesh_info* info, sb_error* error);
    /// <summary>
    /// The needle leaves: its nodes are released and its splits undone. When no other needle is in, the mesh is the
    /// original one, number by number and place by place; else what a near needle prevents follows later. Where the body
    /// refuses (SB_ERROR_MEMORY) it stays in. Does nothing for a needle that is not in.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_withdraw(ndl_remesh* remesh, int needle, ndl_remesh_info* info, sb_error* error);
    /// <summary>
    /// Nodes of the needle in the tissue, entry first, tip last; consecutive ones are joined by an edge. NULL and 0 when it
    /// is not in. Valid until the next call.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int* ndl_remesh_nodes(ndl_remesh* remesh, int needle, int* count);
    /// <summary>
    /// How far one operation may take the tip (m): half the shortest edge at the tip, but for the needle's own.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_remesh_limit(ndl_remesh* remesh, int needle);
    /// <summary>
    /// Material position of a point in space, looked for from the tip; 0 when it is outside (*X is then the continuation of
    /// the nearest tet's map), else 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_remesh_material_point(ndl_remesh* remesh, int needle, sb_vec3 x, sb_vec3* X);
    /// <summary>
    /// First face of the body's surface that the segment crosses from outside in space (m); 0 and *hit untouched when there
    /// is none. O(tets): for a needle that is not in yet.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_remesh_hit(ndl_remesh* remesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit* hit);
    /// <summary>
    /// Splits not undone yet.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_remesh_split_count(ndl_remesh* remesh, int needle);
    /// <summary>
    /// How good the mesh is in the material; any place may be NULL. Quality: 6 sqrt(2) V / l_rms^3, 1 for the regular tet;
    /// angles in degrees. O(tets).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_remesh_quality(ndl_remesh* remesh, double* worst_quality, double* min_dihedral, double* max_dihedral);
    /// <summary>
    /// 1 when the mesh is the one that the remesher was made on, number by number and place by place.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_remesh_is_original(ndl_remesh* remesh);
    /// <summary>
    /// Whether what the remesher knows of the mesh is consistent and the body's: for tests. SB_ERROR_MESH names the first
    /// fault.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_remesh_check(ndl_remesh* remesh, sb_error* error);
    /// <summary>
    /// The pose after `length` (m, either sign) of insertion at a steady twist (rad of turn per m of insertion, about t),
    /// for a tip that bends with `curvature` (1/m). Exact for any size, also for 0. Pure turning is ndl_tip_turn.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_tip_pose ndl_helix_pose(ndl_tip_pose* start, double curvature, double twist, double length);
    /// <summary>
    /// The pose turned in place by `angle` about t.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_tip_pose ndl_tip_turn(ndl_tip_pose* start, double angle);
    /// <summary>
    /// Radius (m) of that helix, k/(k^2 + w^2), and its way ahead per turn, 2 pi |w|/(k^2 + w^2); k and w not both 0.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_helix_radius(double curvature, double twist);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_helix_pitch(double curvature, double twist);
    /// <summary>
    /// Offset h (m) for an advance d (m) of a tip whose last edge is edge_length (m) long; 0 for d &lt;= 0 (retraction).
    /// SB_ERROR_ARGUMENT (law, angle, edge_length &lt;= 0, or an edge too long for the circle: |curvature| (l + d) &gt; 2) and
    /// SB_ERROR_NOT_FINITE leave *offset untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_bevel_offset(ndl_bevel* bevel, double advance, double edge_length, double* offset);
    /// <summary>
    /// The material displacement F^-1 (offset m2) of the tip's material point; F is the deformation gradient about the tip,
    /// averaged by volume over the tip's star (that of one element jumps). SB_ERROR_INVERTED when det F &lt;= 0,
    /// SB_ERROR_NOT_FINITE; *shift is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_bevel_shift(double offset, sb_vec3 m2, sb_mat3* deformation, sb_vec3* shift);
    /// <summary>
    /// Curvature (1/m) that a bevel gives in rigid tissue, with edges and advances as given (see above for errors). That of
    /// a needle has advance 0, edge_length the bevel's guide.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_bevel_curvature(ndl_bevel* bevel, double advance, double edge_length, double* curvature);
    /// <summary>
    /// Distance (m) of a point from an obstacle, negative inside; for functions of slopes up to max_slope their value
    /// divided by it: never more than the distance. SB_REAL_MAX for NULL or a kind that is none; what
    /// else is wrong with an obstacle ndl_plan_make says.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_obstacle_distance(ndl_obstacle* obstacle, sb_vec3 point);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_plan_def ndl_default_plan_def(double curvature, double max_length);
    /// <summary>
    /// The helix from the tip that ends nearest to the target (m), to the tolerance: branch and bound over length and twist,
    /// after a descent from a few starts which mostly settles it. Where obstacles are in its way, sequences of pieces: the
    /// first ones sampled and improved, the last one aimed at the target; of those that reach the target one that is short
    /// and has room on both sides. A path ends where it is nearest: it is never inserted further. A tip nearer to an
    /// obstacle than def.clearance keeps nine tenths of the distance it has. SB_OK with any outcome. SB_ERROR_ARGUMENT,
    /// _NOT_FINITE (field or obstacle named) leave *plan untouched. 2 us where turning gets there, else about 0.3 ms (1 ms
    /// where max_boxes run out), 1 to 10 ms past obstacles (without turning to 0.1 s). Deterministic to the bit.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_plan_make(ndl_plan_def* def, ndl_tip_pose* tip, sb_vec3 target, ndl_plan* plan, sb_error* error);
    /// <summary>
    /// The pose `length` (m) along a plan, in [0, plan-&gt;length] (clamped), from the tip it was made for; at 0
    /// with its first turn made.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_tip_pose ndl_plan_pose(ndl_plan* plan, double curvature, ndl_tip_pose* tip, double length);
    /// <summary>
    /// curvature and max_length as in ndl_default_plan_def.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_steer_def ndl_default_steer_def(double curvature, double max_length);
    /// <summary>
    /// SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE leave *steer untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_steer_begin(ndl_steer_def* def, ndl_steer* steer, sb_error* error);
    /// <summary>
    /// One round: the plan from the sensed tip to the sensed target (m; tissue moves it), and what to do. Pieces of a plan
    /// past obstacles are aimed anew at where they were to end, and the way is searched anew when that is no longer clear.
    /// The controller learns from the sensed tips, by averages that forget: how far their way leans from where they look
    /// (soft tissue gives way sideways under a needle that bends) over def.learn of insertion, and with what curvature their
    /// way turns over twice that. Plans begin along the way so found and use that curvature, which is never taken for more
    /// than the given one or less than half of it, less def.reserve. It is only measured once the tip has turned by 0.05
    /// rad: before, it may be in air.
    /// Once the status is not GOING it stays and nothing more is commanded; ndl_steer_begin starts over. SB_ERROR_NOT_FINITE
    /// and SB_ERROR_ARGUMENT (a frame that is none) change nothing. Cost: see ndl_plan_make.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_steer_update(ndl_steer* steer, ndl_tip_pose* tip, sb_vec3 target, ndl_steer_command* command);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_push_def ndl_default_push_def();
    /// <summary>
    /// SB_ERROR_ARGUMENT (field named; a compliance that moves nothing across the path), _NOT_FINITE leave *push untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_push_begin(ndl_push_def* def, ndl_push* push, sb_error* error);
    /// <summary>
    /// From the sensed point of interest (m) after another dt (s, &gt; 0) to the manipulator's force (N): the one within cone
    /// and max_force that comes nearest to displacing the point by proportional error + integral of the error. While a limit
    /// holds, the integral grows only where that leads away from the limit. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_push_update(ndl_push* push, sb_vec3 point, double dt, sb_vec3* force);
    /// <summary>
    /// The cheapest of `count` places to push at: def with each compliance and direction (directions may be NULL: def's) in
    /// turn, for a point of interest at `point`. *best: the index of the one that needs the least force, or, where none
    /// brings the point all the way, of the one that leaves the least; *force (N) and *left (m, may both be NULL): that
    /// force and what it leaves. SB_ERROR_ARGUMENT and _NOT_FINITE leave all untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_push_choose(ndl_push_def* def, sb_mat3* compliances, sb_vec3* directions, int count, sb_vec3 point, int* best, sb_vec3* force, double* left, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_guide_def ndl_default_guide_def(sb_vec3 target, sb_vec3 entry, sb_vec3 direction);
    /// <summary>
    /// The path, among `samples` random ones (the straight one to the target first) and `climbs` changes of the best, whose
    /// pushes cost least; paths that leave obstacles in the way or the target aside cost more than any that do not.
    /// Displacements add up (linear tissue); a place pushes in one phase only. Points of interest beyond NDL_GUIDE_PHASES -
    /// 1 are not pushed, but count. SB_OK with any outcome. Failures leave *guide untouched: SB_ERROR_ARGUMENT (field,
    /// obstacle or place named), SB_ERROR_NOT_FINITE (also of the model). Some 0.1 ms for a path and phase with 8 places,
    /// beside what the model takes, which is asked some 128 times for each of up to four tries of a path and each place in
    /// use. Distances are looked at in 64 points of a path: an obstacle thinner than 1/64 of it may lie between two, and
    /// `clearance` is too large by up to 1/32 of the path over 8 clearances. A distance that is no number is within an
    /// obstacle. Deterministic to the bit, nothing is allocated.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_guide_make(ndl_guide_def* def, ndl_guide* guide, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_needle_def ndl_default_needle_def();
    /// <summary>
    /// A needle at rest, at its body from then on. *needle is untouched on failure: SB_ERROR_ARGUMENT (field named; a tip
    /// that begins in the tissue; a membrane between regions that do not meet), _NOT_FINITE, _MATERIAL (section),
    /// _UNSUPPORTED (NDL_MAX_NEEDLES are there; what the body is made of, see def.body), _MEMORY.
    ///
    /// From then on it is part of the body's saved state, hash and recording. A state that was saved with needles, in
    /// mid-insertion too, is loaded (sb_body_state_load) into a body that has needles of the same defs, made in the same
    /// order, wherever they are: it goes on to the last bit. A recording holds ndl_step and ndl_needle_move_base, and is
    /// played on such a body. Make needles before a recording is started, and destroy them after it has been stopped: what
    /// follows otherwise is refused when it is played. A `cutting` of your own is not saved: both must do the same.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_needle_create(ndl_needle_def* def, ndl_needle** needle, sb_error* error);
    /// <summary>
    /// Takes it out of the tissue first. NULL is fine.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_needle_destroy(ndl_needle* needle);
    /// <summary>
    /// In the next step the sleeve goes to `base` (m), looks along `direction` and turns its m1 into `director` (any length
    /// but 0; the short way), beside what the command says: for sleeves that are tracked. director 0: turned only as the
    /// direction turns. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_needle_move_base(ndl_needle* needle, sb_vec3 @base, sb_vec3 direction, sb_vec3 director);
    /// <summary>
    /// Advances a body and all its needles by dt (s, &gt; 0): in place of sb_body_step, which moves the body without them.
    /// needles: [count], each needle of the body once, in any order; commands: [count] beside them, or NULL: zeros
    /// info may be NULL. On failure all is as before: SB_ERROR_ARGUMENT (needle missing or doubled; a command that would
    /// take over 1000 substeps), _NOT_FINITE (command named); SB_ERROR_UNSUPPORTED, a needle is at a node that constraints
    /// eliminate; with NDL_REMESH, two needles would share an element (which are, is said), or the body is cut
    /// (sb_cut_triangles);
    /// SB_ERROR_DIVERGED (node named); SB_ERROR_INVERTED (element named); SB_ERROR_MEMORY; SB_ERROR_STATE, another change of
    /// the body is open. Where the mesh has changed within a step that fails and there is no memory to take that back
    /// either, SB_ERROR_MEMORY says so: body and needles are then between two states until the next call of ndl_step or
    /// ndl_needle_create, which takes the step back first, or until a saved state is loaded. Steps that do without memory
    /// they asked for (info-&gt;blocked) are not repeated by a recording that has it.
    ///
    /// A step is divided where a tip comes to an edge of a membrane, and would go past it by more than a quarter of the
    /// membrane's thickness, or a command is fast, and where it fails as a whole: the rod would fold, tissue would turn
    /// inside out, or of hyperelastic tissue max_newton iterations do not bring it to where the needle has gone (what is
    /// read of a needle is never the force of that gap). Supports and tools of an sb_contact go evenly over its parts, and
    /// what tools feel, as a blade's forces, is of the step that was made, whatever was tried before. In parts cut short by
    /// a membrane a tool that just comes to the tissue feels the parts' shorter time: up to 8 % of the force that it has
    /// later (measured in 8 scenes).
    ///
    /// The linear systems of the body's own step are solved together with needles and friction (see couple.h), to its
    /// tolerance: one where it is linearised (max_newton 1), otherwise until body, needles and friction balance. Needles are
    /// stepped by implicit Euler, the body by its own integrator. SB_EULER and SB_GENERALISED_ALPHA with spectral_radius 0,
    /// which is of second order, let the force on the base settle at once when the needle stops; others do not damp the
    /// motion that friction leaves in the tissue. Measured (nitinol needle 3.5 cm deep in 50 kPa, push 1.20 N, steps of 20
    /// ms): half a second after the stop the force stays within 1e-4 N with the two; with SB_NEWMARK it goes on ringing by 5
    /// mN, without damping_stiffness by 0.34 N; with spectral_radius 0.8 it jumps by up to 0.45 N from step to step while
    /// the needle moves (0.007 N with 0).
    ///
    /// Steps of a millisecond, as hands ask for, take some 0.6 of the time with NDL_EMBED in a body of tet4 that keeps its
    /// tangent (sb_body_keep_tangent), and the force on the base stays the same to a millionth.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_step(sb_body* body, ndl_needle** needles, int count, double dt, ndl_command* commands, ndl_step_info* info, sb_error* error);
    /// <summary>
    /// The rod: positions, frames, curvature; nodes 0 and 1 are in the sleeve, node 1 at its outlet. Valid until the needle
    /// is destroyed, its arrays until the next step.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_rod* ndl_needle_rod(ndl_needle* needle);
    /// <summary>
    /// Where the tip is and looks, for ndl_steer_update; it bends towards frame.m2. With NDL_BEVEL_CURVATURE t is where the
    /// path goes on; the rod's last edge, a chord, lags behind by half of what it bends, and more after a turn.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_tip_pose ndl_needle_tip(ndl_needle* needle);
    /// <summary>
    /// What the sleeve exerts on the needle at its outlet: force (N) and torque (N m) about it, in the last step. What a
    /// hand feels is the opposite. Either may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void ndl_needle_base_wrench(ndl_needle* needle, sb_vec3* force, sb_vec3* torque);
    /// <summary>
    /// First node of the rod in the tissue; the rod's node_count when it is outside. With NDL_EMBED the edge before it goes
    /// in through the skin, and is held there, too: that node has a contact state and force.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_needle_entry(ndl_needle* needle);
    /// <summary>
    /// Tissue node that a rod node is at; -1: none, as with NDL_EMBED.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_needle_body_node(ndl_needle* needle, int node);
    /// <summary>
    /// What follows the tips of all needles of its body, for readings: ndl_remesh_quality, _is_original, _nodes ...; gone
    /// with the body's last needle. NULL with NDL_EMBED.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_remesh* ndl_needle_remesh(ndl_needle* needle);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern ndl_contact ndl_needle_contact(ndl_needle* needle, int node);
    /// <summary>
    /// Force (N) of the tissue on a node in the last step.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3 ndl_needle_contact_force(ndl_needle* needle, int node);
    /// <summary>
    /// Length of shaft in the tissue, in holes that were burnt in it, and out of one on its far side (m), and fed since
    /// creation.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_needle_depth(ndl_needle* needle);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_needle_fed(ndl_needle* needle);
    /// <summary>
    /// How far the tip went through the tissue in the last step (m, along the tip; negative: back).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_needle_advance(ndl_needle* needle);
    /// <summary>
    /// Force (N) that would let the tip go forward now; SB_REAL_MAX while it is held.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double ndl_needle_cutting(ndl_needle* needle);
    /// <summary>
    /// Material point (m) of the tip; 0 when the needle is outside, else 1.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int ndl_needle_tip_material(ndl_needle* needle, sb_vec3* X);
    /// <summary>
    /// For rods that are stepped by themselves: a needle's is part of its body's state (sb_body_state_save).
    ///
    /// A saved rod holds all that steps, setters and splits change. What follows a load is what followed the save, bit for
    /// bit, also in another process or machine with the same order of bytes. It is loaded into a rod that was made from the
    /// same def, in the same precision; capacity and allocator may differ.
    ///
    /// size: bytes that save writes for the rod as it is. save: size must be at least that, what is behind stays; nothing
    /// that a step could notice changes, nothing is allocated. load: size may be larger than what was saved; allocates
    /// nothing. Buffers need no alignment.
    ///
    /// Failures leave everything as it was (and `error` may be NULL): SB_ERROR_ARGUMENT (NULL, or too small a buffer);
    /// SB_ERROR_FORMAT (no saved rod, cut short, damaged, a count out of its range); SB_ERROR_UNSUPPORTED (other version,
    /// precision or order of bytes); SB_ERROR_STATE (another def's, or more nodes than there is room for);
    /// SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern UIntPtr ndl_rod_state_size(ndl_rod* rod);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_save(ndl_rod* rod, void* buffer, UIntPtr size, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result ndl_rod_load(ndl_rod* rod, void* buffer, UIntPtr size, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_rigid reg_rigid_identity();
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3 reg_rigid_apply(reg_rigid* motion, sb_vec3 point);
    /// <summary>
    /// First `first`, then `then`.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_rigid reg_rigid_compose(reg_rigid* then, reg_rigid* first);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_rigid reg_rigid_inverse(reg_rigid* motion);
    /// <summary>
    /// The axis times 2 sin, and 1 + 2 cos: together they determine small angles and angles near pi alike.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double reg_rigid_angle(reg_rigid* motion);
    /// <summary>
    /// The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).
    /// from, to: [count] partners (m); weights: [count] &gt;= 0, not all 0, or NULL: all 1; count &gt;= 1. Where the points leave
    /// the rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)
    /// leave *motion untouched. No allocation.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_rigid_fit(sb_vec3* from, sb_vec3* to, double* weights, int count, reg_rigid* motion, sb_error* error);
    /// <summary>
    /// Makes a tree of points[count] (m; count &gt;= 1, points may coincide), which are copied. One block of memory from
    /// `allocator` (NULL: malloc; at most 80 bytes per point) and scratch that goes back.
    /// O(count log count). SB_ERROR_ARGUMENT (null pointer, no points, or a coordinate whose square would overflow),
    /// _NOT_FINITE (error-&gt;node: the point), _MEMORY; then *tree is untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_kdtree_create(sb_vec3* points, int count, sb_allocator* allocator, reg_kdtree** tree, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_kdtree_destroy(reg_kdtree* tree);
    /// <summary>
    /// Number of its points; 0 for NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_kdtree_count(reg_kdtree* tree);
    /// <summary>
    /// Index of the point nearest to `point` among those at most `within` (m; SB_REAL_MAX: any) away, and its squared
    /// distance (m^2) in *squared (may be NULL). -1 (nothing written) when there is none, the tree is NULL, or an argument
    /// is not finite or negative. O(log count) for points near the cloud.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_kdtree_nearest(reg_kdtree* tree, sb_vec3 point, double within, double* squared);
    /// <summary>
    /// The k nearest points, nearest first: indices[k] and squared distances squared[k] (m^2; both needed). Returns how many
    /// were found: k, or all points when there are fewer; 0 for k &lt; 1, NULL, or a point that is not finite.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_kdtree_k_nearest(reg_kdtree* tree, sb_vec3 point, int k, int* indices, double* squared);
    /// <summary>
    /// All points at most `radius` (m) away: returns how many, of which the first `room` are written to indices[room] (may
    /// be NULL with room 0: only count). In no particular, yet always the same order. 0 as above.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_kdtree_within(reg_kdtree* tree, sb_vec3 point, double radius, int* indices, int room);
    /// <summary>
    /// Frees the arrays and leaves zeros; accepts NULL and a cloud of zeros.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_cloud_free(reg_cloud* cloud);
    /// <summary>
    /// Copies points[count] (count &gt;= 1) and normals[count] (or NULL; made unit length). SB_ERROR_ARGUMENT, _NOT_FINITE
    /// (error-&gt;node), _MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_from_points(reg_cloud* cloud, sb_vec3* points, sb_vec3* normals, int count, sb_allocator* allocator, sb_error* error);
    /// <summary>
    /// The nodes of a mesh. Of a surface (tri3 .. quad9) with normals: the mean of the faces around, weighted by area, 0
    /// where there is none; of a volume without. Fails as sb_surface_create does.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_from_mesh(reg_cloud* cloud, sb_mesh* mesh, sb_allocator* allocator, sb_error* error);
    /// <summary>
    /// Reads a cloud from a file; every coordinate is multiplied by `scale` (&gt; 0; files in millimetres: 0.001). A normal is
    /// made unit length, and 0 where its length is 0. SB_ERROR_ARGUMENT, _FILE (cannot be read), _FORMAT (also: no points),
    /// _NOT_FINITE, _UNSUPPORTED, _MEMORY; error says file and line, in binary parts the byte, and error-&gt;node the point.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_load(reg_cloud* cloud, byte* path, double scale, sb_allocator* allocator, sb_error* error);
    /// <summary>
    /// The same from memory: data[size], borrowed during the call. name stands for the path in errors and in telling the
    /// format; may be NULL.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_load_memory(reg_cloud* cloud, void* data, UIntPtr size, reg_cloud_format format, byte* name, double scale, sb_allocator* allocator, sb_error* error);
    /// <summary>
    /// Writes a PLY file, binary little-endian in the precision of sb_real or ASCII with all digits, with normals when there
    /// are. SB_ERROR_ARGUMENT, _NOT_FINITE, and _FILE as for the writers of meshes.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_save_ply(byte* path, reg_cloud* cloud, int ascii, sb_error* error);
    /// <summary>
    /// Gives the cloud normals (in place of any it had): across the plane fitted to each point and its k nearest (k &gt;= 3;
    /// 8 to 20 is usual). With a view point they face it. With view NULL neighbours are made to agree, each following the
    /// one it is most parallel to (Hoppe et al. 1992), and the highest point (largest z) of each connected part looks up:
    /// outward for closed surfaces. 0 where points are so few, or so much in one line or place, that there is no plane.
    /// jobs: NULL: inline; only the fits run on it. SB_ERROR_ARGUMENT, _NOT_FINITE, _MEMORY: the cloud is untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_estimate_normals(reg_cloud* cloud, int k, sb_vec3* view, sb_jobs* jobs, sb_error* error);
    /// <summary>
    /// One point for each cube [i, i+1) x [j, j+1) x [k, k+1) times `size` (m, &gt; 0) that holds any: the mean of its points,
    /// and of their normals made unit length. In the order in which the cubes were met first. SB_ERROR_ARGUMENT,
    /// _NOT_FINITE, _MEMORY; *thin (may be the same as cloud: then replaced) is untouched on failure.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_thin(reg_cloud* cloud, double size, reg_cloud* thin, sb_error* error);
    /// <summary>
    /// `wanted` points (or all) of points[count], evenly spread: first the one farthest from their mean, then always the one
    /// farthest from those chosen. Their indices go to chosen[wanted]; scratch[count]. Returns how many: fewer where points
    /// coincide. The same for any pose up to rounding. O(wanted count). No allocation.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_cloud_spread(sb_vec3* points, int count, int wanted, int* chosen, double* scratch);
    /// <summary>
    /// The largest of distances[count] that is no outlier may be so large; keep d &lt;= limit. Distances that are not finite
    /// (points without a partner) are outliers by themselves and do not count. scratch[count]. SB_REAL_MAX for NONE, -1 when
    /// no distance counts or the rule or parameter is out of range. O(count), no allocation.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double reg_outlier_limit(double* distances, int count, reg_outliers rule, double parameter, double* scratch);
    /// <summary>
    /// Takes out points whose mean distance to their k nearest (k &gt;= 1) is an outlier by the rule; the others keep their
    /// order. *removed (or NULL): how many. SB_ERROR_ARGUMENT, _NOT_FINITE, _MEMORY: the cloud is untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_remove_outliers(reg_cloud* cloud, int k, reg_outliers rule, double parameter, int* removed, sb_error* error);
    /// <summary>
    /// Takes noise off a cloud: each point goes to where quadratics fitted to its neighbours say the surface is, over as
    /// many neighbours (16 to 128) as agree with one another up to the noise, which is measured first, robustly: flat parts
    /// are smoothed widely, edges keep their shape. Where noise is under a twenty-fifth of the points' spacing none moves.
    /// Outliers are removed: points farther from a robust fit to their neighbours than 4 standard deviations of the noise
    /// and the points' spacing, 2.5 times as far from the next points as those are from theirs, or amid scattered ones.
    /// Normals, when there are any, keep unlike sides of thin parts apart, and become those of the fits.
    /// info: or NULL. jobs: NULL: inline. About 60 us per noisy point.
    /// SB_ERROR_ARGUMENT, _NOT_FINITE (error-&gt;node), _MEMORY: the cloud is untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_smooth(reg_cloud* cloud, sb_jobs* jobs, reg_smooth_info* info, sb_error* error);
    /// <summary>
    /// The same for the nodes of a surface, open or closed. Nodes whose shortest edge is 3 times as long as their
    /// neighbours' are outliers, too; all of these are put amid their neighbours in the mesh, so that no holes come about.
    /// Fails as reg_cloud_from_mesh does, too; the surface is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cloud_smooth_mesh(sb_mesh* surface, sb_jobs* jobs, reg_smooth_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_field_def reg_default_field_def();
    /// <summary>
    /// SB_ERROR_ARGUMENT (no target or two, a field out of range), SB_ERROR_NOT_FINITE (error-&gt;node: the point, or the
    /// normal), what sb_surface_create says of the surface, SB_ERROR_MEMORY; *field is then untouched. Everything is copied.
    /// Queries allocate nothing and may come from any number of threads. Release with reg_field_destroy.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_field_create(reg_field_def* def, reg_field** field, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_field_destroy(reg_field* field);
    /// <summary>
    /// 1 and *hit; 0 for a point that is not finite or absurdly far away (*hit untouched). guess: the item of a query
    /// nearby, or -1; it changes the time, not the answer. About 1 us with a good guess.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_field_closest(reg_field* field, sb_vec3 point, int guess, reg_field_hit* hit);
    /// <summary>
    /// Samples the potential at point (m) along the unit vector direction:
    ///     phi_n = [phi(s + h n/2) - phi(s - h n/2)] / h,  phi_nn = d phi_n / ds
    /// with h = step (m, &gt; 0), which rounds the potential's kink on the target off. phi_nn is the exact derivative of this
    /// phi_n, from the slopes at its two ends, not a difference of its own: Newton's method then converges as it should.
    /// Laplace's phi outside its box is that of the nearest point of the box. Returns 0 as above.
    /// Source: Suwelack 2014, (7.3), (7.15).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_field_along(reg_field* field, sb_vec3 point, sb_vec3 direction, double step, int guess, reg_field_sample* sample);
    /// <summary>
    /// phi (m) at a point, and its gradient unless NULL: away from the closest point, or of the trilinear interpolation. On
    /// the target itself, where the distance has none, it is 0. Returns 0 as above.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_field_at(reg_field* field, sb_vec3 point, int guess, double* phi, sb_vec3* gradient);
    /// <summary>
    /// Smallest box around the target (m).
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_field_bounds(reg_field* field, sb_vec3* low, sb_vec3* high);
    /// <summary>
    /// Laplace: sweeps that its solution took; 0 for distances.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_field_sweeps(reg_field* field);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_icp_options reg_default_icp_options();
    /// <summary>
    /// "converged", "iterations", "time"; static.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* reg_icp_stop_string(reg_icp_stop stop);
    /// <summary>
    /// "ambiguous", "inverted normals", ...: of one warning; static. "unknown" else.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* reg_warning_string(reg_warning warning);
    /// <summary>
    /// The motion that brings the model to the target.
    ///
    /// options  NULL: reg_default_icp_options()
    /// motion   written on success, also when a cap ended the run; info (or NULL) too
    /// SB_ERROR_ARGUMENT (what is said above; weights all 0), _NOT_FINITE (error-&gt;node: the point), _MEMORY,
    /// _NOT_CONVERGED (no pair within max_distance): outputs untouched.
    ///
    /// About 0.1 s for surfaces of 6,000 points with search, 0.02 s without. Points that lie in a line, a plane or one place
    /// leave motions open; it then takes one of the best.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_icp(reg_icp_shape* model, reg_icp_shape* target, reg_icp_options* options, reg_rigid* motion, reg_icp_info* info, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_cpd_options reg_default_cpd_options();
    /// <summary>
    /// Moves source onto target.
    /// source, target  [count] (m), at least one point each, in any order; copied
    /// options         NULL: defaults
    /// fit             made on success; the caller's, for reg_cpd_destroy; untouched otherwise
    /// A cap that was reached is no error: info.stop reports it, and the fit is as good as it got.
    /// Cost of an iteration: at most source_count target_count exponentials (about 5 ns each), and as sigma shrinks those of
    /// near blocks of points only; non-rigid in addition source_count rank^2 / 2 + rank^3 / 6 multiply-adds. Memory: rank
    /// (source_count + rank) doubles. The same bits for any jobs.
    /// SB_ERROR_ARGUMENT (also a landmark of no point: error-&gt;node is its index), _NOT_FINITE (error-&gt;node; the message
    /// names the cloud; also where a fit goes beyond what sb_real holds), _UNSUPPORTED (more than max_pairs), _CANCELLED,
    /// _NOT_CONVERGED (no target point is near enough any source point to be more than an outlier), _MEMORY.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_cpd_fit(sb_vec3* source, int source_count, sb_vec3* target, int target_count, reg_cpd_options* options, reg_cpd** fit, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_cpd_destroy(reg_cpd* fit);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_cpd_info reg_cpd_get_info(reg_cpd* fit);
    /// <summary>
    /// The source where it was moved to: [source_count] (m), in its order; the fit's.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_vec3* reg_cpd_moved(reg_cpd* fit);
    /// <summary>
    /// For each source point the target point that is most probably its partner, -1 where all probabilities are 0; the
    /// fit's. Several source points may name one target point: compare probabilities.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int* reg_cpd_partners(reg_cpd* fit);
    /// <summary>
    /// [source_count] the probability of that: that the target point was drawn from this source point.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern double* reg_cpd_probabilities(reg_cpd* fit);
    /// <summary>
    /// x -&gt; linear x + translation (m) of kinds rigid, similarity and affine; of non-rigid what the frames of the clouds
    /// make of a point far from the source.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_cpd_linear(reg_cpd* fit, sb_mat3* linear, sb_vec3* translation);
    /// <summary>
    /// moved[count]: where the points (m) go; in place is fine. `rank` exponentials for each point. Nothing happens for
    /// NULL. Points that are not finite give NaN. Thread-safe.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_cpd_apply(reg_cpd* fit, sb_vec3* points, int count, sb_vec3* moved);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_match_def reg_default_match_def();
    /// <summary>
    /// Makes a match; the body is not touched. SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no
    /// Young's modulus to measure charges with), SB_ERROR_UNSUPPORTED (a body with constraints or custom elements),
    /// what reg_field_create says of the target and sb_embedding_create of the surface (points far
    /// outside included), SB_ERROR_MEMORY; *match is then untouched. All memory that steps need is taken here.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_match_create(reg_match_def* def, reg_match** match, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_match_destroy(reg_match* match);
    /// <summary>
    /// One step: moves the body and raises the charge. info may be NULL. On failure the body is as before:
    /// SB_ERROR_INVERTED (element named), SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (also when at full charge the organ
    /// has less than a quarter or more than four times its volume); SB_ERROR_NOT_CONVERGED when too little of the
    /// surface is near the target; SB_ERROR_UNSUPPORTED when the body has got constraints; SB_ERROR_STATE when its mesh has
    /// changed: make a match of it anew. A recording of
    /// the body holds the shape that it comes to, and replays without the match. Allocates nothing, unless loads were added
    /// to the body since. The same bits for any number of threads. Landmarks and supports may move between steps: matching
    /// then follows them.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_match_step(reg_match* match, reg_match_info* info);
    /// <summary>
    /// Steps until the match settles, `steps` (&gt;= 0) are done or the time is up: all of these are SB_OK, and info-&gt;stop says
    /// which. Errors as of a step.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_match_run(reg_match* match, int steps, reg_match_info* info);
    /// <summary>
    /// Back to the first charge and reach, as if no step had been: for a body that was reset or moved. The time goes on.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_match_restart(reg_match* match);
    /// <summary>
    /// New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE names none and
    /// changes nothing; a settled match runs again.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_match_move_landmarks(reg_match* match, sb_vec3* targets);
    /// <summary>
    /// Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_match_landmarks(reg_match* match, sb_vec3* points);
    /// <summary>
    /// The body's: sb_body_positions and sb_body_displacements are the result.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_body* reg_match_body(reg_match* match);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_match_info reg_match_get_info(reg_match* match);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_match_sample_count(reg_match* match);
    /// <summary>
    /// SB_ERROR_INDEX for no such sample; *sample is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_match_get_sample(reg_match* match, int index, reg_match_sample* sample);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_nicp_def reg_default_nicp_def();
    /// <summary>
    /// Makes a registration; the body's shape is not touched, its loads get the penalties, with no force yet.
    /// SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no Young's modulus to measure the penalty
    /// with), what reg_field_create says of the target, what sb_surface_create, sb_embedding_create and sb_grid_map_points
    /// say of the surface and the landmarks, SB_ERROR_UNSUPPORTED (a body of custom elements), SB_ERROR_MEMORY; *nicp and
    /// the body are then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_nicp_create(reg_nicp_def* def, reg_nicp** nicp, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_nicp_destroy(reg_nicp* nicp);
    /// <summary>
    /// One look at the target and the balance after it. info may be NULL. On failure the body is as before:
    /// SB_ERROR_NOT_CONVERGED when too little of the surface has a partner, SB_ERROR_DIVERGED when the organ has less than a
    /// quarter or more than four times its volume, and what sb_body_solve_static says; SB_ERROR_STATE
    /// when its mesh has changed: make a registration of it anew. Allocates nothing. The same bits for any number
    /// of threads. A recording of the body holds the penalties and the balance, and replays without the registration.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_nicp_step(reg_nicp* nicp, reg_nicp_info* info);
    /// <summary>
    /// Steps until the shape converges, the increments or `steps` (&gt;= 1) are done, or the time is up: all of these are
    /// SB_OK, and info-&gt;stop says which. Errors as of a step.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_nicp_run(reg_nicp* nicp, int steps, reg_nicp_info* info);
    /// <summary>
    /// Back to the first increment, as if no step had been: for a body that was reset or moved. The time goes on.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_nicp_restart(reg_nicp* nicp);
    /// <summary>
    /// New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE changes nothing;
    /// a run that had ended goes on with the last increment.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_nicp_move_landmarks(reg_nicp* nicp, sb_vec3* targets);
    /// <summary>
    /// Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_nicp_landmarks(reg_nicp* nicp, sb_vec3* points);
    /// <summary>
    /// The body's: sb_body_positions and sb_body_displacements are the result.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_body* reg_nicp_body(reg_nicp* nicp);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_nicp_info reg_nicp_get_info(reg_nicp* nicp);
    /// <summary>
    /// Where the surface is now: points[reg_nicp_surface_count] (m), the vertices of def.surface, or the boundary's nodes in
    /// the order of sb_mesh_boundary; untouched when the body's mesh has changed. Through the grid's mapping for bodies in
    /// grids.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_nicp_surface_count(reg_nicp* nicp);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_nicp_positions(reg_nicp* nicp, sb_vec3* points);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_nicp_source_count(reg_nicp* nicp);
    /// <summary>
    /// SB_ERROR_INDEX for no such source; *source is then untouched.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_nicp_get_source(reg_nicp* nicp, int index, reg_nicp_source* source);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_loads_def reg_default_loads_def();
    /// <summary>
    /// Moves the body of a match to where loads on little of its surface bring it.
    /// forces  [nodes of the body] found (N), 0 inside and where nodes are held; or NULL
    /// info    or NULL
    /// Returns SB_ERROR_ARGUMENT (a field, named), SB_ERROR_UNSUPPORTED (a Laplacian match; a body with pressures, springs,
    /// mappings or constraints), SB_ERROR_STATE (its mesh has changed since the match was made), SB_ERROR_INVERTED (element
    /// named), SB_ERROR_INDEFINITE,
    /// SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED (nothing of the surface is near the target), SB_ERROR_MEMORY; the
    /// body is then as before and forces are untouched. All memory is taken at the beginning and released at the end.
    /// Deterministic.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_loads_run(reg_loads_def* def, sb_vec3* forces, reg_loads_info* info);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_model_def reg_default_model_def();
    /// <summary>
    /// Makes a model; everything is copied. SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INDEX (a fixed node),
    /// SB_ERROR_UNSUPPORTED (custom elements), what sb_body_create says of the mesh, sb_surface_create and
    /// sb_embedding_create of the surface; SB_ERROR_MEMORY. *model is then untouched. One inference at a time may use a
    /// model, and the model must outlive it.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_model_create(reg_model_def* def, reg_model** model, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_model_destroy(reg_model* model);
    /// <summary>
    /// NULL is fine
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int reg_model_node_count(reg_model* model);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_infer_def reg_default_infer_def();
    /// <summary>
    /// Infers; all memory is taken here, from the model's allocator. SB_ERROR_ARGUMENT (a field, named),
    /// SB_ERROR_NOT_FINITE (error-&gt;node: the point, the landmark or the curve), what sb_surface_create says of a target
    /// surface, SB_ERROR_NOT_CONVERGED (no point of the target has an allowed place of the model, or loads cannot be told),
    /// SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *infer is then untouched. Deterministic; the same bits for any number of
    /// threads, without a time limit.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_run(reg_infer_def* def, reg_infer** infer, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_infer_destroy(reg_infer* infer);
    /// <summary>
    /// displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame. Where less than 15 %
    /// of the surface is seen and no landmark or curve was given, a tenth tells too little of the rest: the answer is then
    /// half the way from the start to the elastic shape, or the start where loads explain no more than a pose does
    /// (quality.belief). Without landmarks and curves all answers stop short of the elastic shape by as much as it is unsure
    /// for how far from the start it is (quality.sure). What is left of the way is in the errors to expect.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_displacements(reg_infer* infer, sb_vec3* displacements);
    /// <summary>
    /// forces[nodes] (N for a Young's modulus of 1000 Pa: they scale with it) that are found to act, weight included: those
    /// of the whole way, of which the answer goes quality.sure.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_forces(reg_infer* infer, sb_vec3* forces);
    /// <summary>
    /// expected[nodes]: root mean square error (m) to expect of each node.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_expected(reg_infer* infer, double* expected);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_draw(reg_infer* infer, int index, sb_vec3* displacements);
    /// <summary>
    /// Where points[count] of the organ at rest (m) are, moved[count], and the covariance of that, covariances[count] (m^2);
    /// either may be NULL. SB_ERROR_NOT_FINITE, what sb_embedding_create says of points far off, SB_ERROR_MEMORY
    /// leave both untouched. From the draws, so that single covariances are known to a quarter.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_covariance(reg_infer* infer, sb_vec3* points, int count, sb_vec3* moved, sb_mat3* covariances, sb_error* error);
    /// <summary>
    /// Which of points[count] of the organ at rest (m) is worth touching: the one that, seen as a landmark of deviation `sd`
    /// (m, &gt;= 0), lowers the mean error to expect most, and what that would then be, expected (m); it may be NULL. It takes
    /// the draws for all that may be (regression on them); that with a landmark an answer goes the whole way is not in it.
    /// Of three random organs seen from above 7.0 to 7.8 mm became 5.2 to 5.8, foretold 5.5 to 6.3; the best of nine points
    /// was found in two of them, in the third one 1.2 times as good as that. SB_ERROR_ARGUMENT, and as above: nothing is
    /// written then. 1 ms per point for 2,000 nodes.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_best_landmark(reg_infer* infer, sb_vec3* points, int count, double sd, int* best, double* expected, sb_error* error);
    /// <summary>
    /// SB_ERROR_ARGUMENT.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_infer_get_quality(reg_infer* infer, reg_quality* quality);
    /// <summary>
    /// "rigid", "smooth", "local", "gravity", "pressure"; "converged", "rounds", "time".
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* reg_prior_string(reg_prior_kind prior);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* reg_infer_stop_string(reg_infer_stop stop);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern reg_track_def reg_default_track_def();
    /// <summary>
    /// Makes a tracker; all memory is taken here, from the model's allocator. Takes the time of a round of an inference.
    /// SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INVERTED, SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *track is then
    /// untouched. Deterministic, as steps are; the same bits for any number of threads.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_create(reg_track_def* def, reg_track** track, sb_error* error);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void reg_track_destroy(reg_track* track);
    /// <summary>
    /// Begins anew about an inference's answer, or, `start` NULL, about where the organ is now: shapes are linear about
    /// that, what was known of the amounts is forgotten, and the pose is as sure as at a start. For after it was lost, and
    /// for large deformations. Allocates nothing; takes as long as the creation. The errors of reg_track_create: nothing
    /// has changed then. A target that waits stays.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_restart(reg_track* track, reg_infer* start, sb_error* error);
    /// <summary>
    /// What is seen now, for the next step; replaces a target that waits. Copied. A surface is refused. SB_ERROR_ARGUMENT,
    /// also for more than def.most_points, and SB_ERROR_NOT_FINITE (error-&gt;node: the point): nothing has changed.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_set_target(reg_track* track, reg_points* target, sb_error* error);
    /// <summary>
    /// Which of the def's landmarks and curves are seen now, and where, for the next step: landmarks[def.landmark_count] and
    /// curves[def.curve_count] in the def's order, of which `seen` and `sd` are read and copied. An infinite sd stands for
    /// what is not seen now: it counts nothing, and its `seen` is not looked at. Replaces features that wait; a step takes
    /// them in beside a target or without one. They are rows of the state, as patches of the target are, but counted for
    /// what they are by themselves: the farther one is off what was expected of it, the less it counts (Student's t of three
    /// degrees of freedom), so that one that is taken for another does little, while all that move alike are followed.
    /// Deviations below a ten-thousandth of the organ's size count as that.
    ///
    /// NULL where the def has none. SB_ERROR_ARGUMENT (NULL, an sd out of its range, a line without length, a place farther
    /// than 100 of the organ's sizes from where it is: most often one in millimetres) and SB_ERROR_NOT_FINITE name the
    /// landmark or curve (error-&gt;node): nothing has changed. Allocates nothing.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_set_features(reg_track* track, reg_landmark* landmarks, reg_curve* curves, sb_error* error);
    /// <summary>
    /// Goes on by dt (s, &gt; 0), and takes in the target and the features that wait, if there are any. Allocates nothing. info
    /// may be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEFINITE, SB_ERROR_NOT_FINITE: nothing has changed but that target and
    /// features are gone.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_step(reg_track* track, double dt, reg_track_info* info);
    /// <summary>
    /// displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_displacements(reg_track* track, sb_vec3* displacements);
    /// <summary>
    /// covariances[nodes] (m^2) of that, in the target's frame. Some (modes + 6)^2 multiply-adds a node: for a look now and
    /// then, not for each frame.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_covariances(reg_track* track, sb_mat3* covariances);
    /// <summary>
    /// A saved tracker holds all that steps, restarts and targets change, what waits included: what follows a load
    /// is what followed the save, bit for bit, also in another process or machine. It is loaded into a tracker of the same
    /// model that was made with the same def (most_points may differ), in the same precision. Some
    /// 3 (modes + 1) reals a node. The model and its body are not part of it: steps leave them alone.
    ///
    /// size: bytes that save writes for the tracker as it is; 0 for NULL. save: what is behind them stays.
    /// SB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched). Neither allocates.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern UIntPtr reg_track_save_size(reg_track* track);
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_save(reg_track* track, void* buffer, UIntPtr size);
    /// <summary>
    /// Allocates nothing. Everything is checked first; on failure the tracker is as it was: SB_ERROR_ARGUMENT (NULL),
    /// SB_ERROR_FORMAT (no saved tracker, cut short, damaged, a number out of its range), SB_ERROR_UNSUPPORTED (other
    /// version or precision), SB_ERROR_STATE (another model's or def's), SB_ERROR_NOT_FINITE.
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern sb_result reg_track_load(reg_track* track, void* buffer, UIntPtr size, sb_error* error);
    /// <summary>
    /// "follows", "predicts", "jumped", "lost".
    /// </summary>
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern byte* reg_track_state_string(reg_track_state state);
}
}
