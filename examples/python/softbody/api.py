"""All of softbody.h, needle.h and register.h for ctypes. Written by src/bindings.py: do not edit."""
from ctypes import *

# fmt: off
SB_OK = 0
SB_ERROR_MEMORY = -1
SB_ERROR_ARGUMENT = -2
SB_ERROR_NOT_FINITE = -3
SB_ERROR_INDEX = -4
SB_ERROR_FILE = -5
SB_ERROR_FORMAT = -6
SB_ERROR_UNSUPPORTED = -7
SB_ERROR_MESH = -8
SB_ERROR_MATERIAL = -9
SB_ERROR_UNCONSTRAINED = -10
SB_ERROR_INVERTED = -11
SB_ERROR_DIVERGED = -12
SB_ERROR_NOT_CONVERGED = -13
SB_ERROR_INDEFINITE = -14
SB_ERROR_STATE = -15
SB_ERROR_CANCELLED = -16
SB_OUTPUT_PATH = 4096
SB_NO_ELEMENT = 0
SB_TRI3 = 1
SB_TRI6 = 2
SB_QUAD4 = 3
SB_QUAD8 = 4
SB_QUAD9 = 5
SB_TET4 = 10
SB_TET10 = 11
SB_HEX8 = 12
SB_HEX20 = 13
SB_HEX27 = 14
SB_CUSTOM = 15
SB_MAX_ELEMENT_NODES = 32
SB_MAX_FACE_NODES = 9
SB_MAX_ELEMENT_FACES = 12
SB_MAX_ELEMENT_EDGES = 24
SB_MAX_QUADRATURE_POINTS = 27
SB_QUADRATURE_STIFFNESS = 0
SB_QUADRATURE_STIFFNESS_CURVED = 1
SB_QUADRATURE_MASS = 2
SB_QUADRATURE_FACE = 3
SB_MESH_SOUND = 0
SB_MESH_INDEX_RANGE = 1
SB_MESH_NODE_NOT_FINITE = 2
SB_MESH_REPEATED_NODE = 3
SB_MESH_INVERTED = 4
SB_MESH_FLAT = 5
SB_MESH_BAD_MIDSIDE = 6
SB_MESH_DUPLICATE = 7
SB_MESH_DEFECT_COUNT = 8
SB_FILE_AUTO = 0
SB_FILE_VTK = 1
SB_FILE_GMSH = 2
SB_FILE_TETGEN = 3
SB_FILE_OBJ = 4
SB_FILE_STL = 5
SB_FILE_PLY = 6
SB_FILE_OFF = 7
SB_FILE_VTU = 8
SB_FILE_MEDIT = 9
SB_MESH_SET_NAME = 64
SB_LOAD_NOTES = 10
SB_LOAD_NOTE_LENGTH = 192
SB_FIELD_NODES = 0
SB_FIELD_ELEMENTS = 1
SB_LABEL_MAX_SMOOTHING = 8
SB_SURFACE_FACE = 0
SB_SURFACE_EDGE = 1
SB_SURFACE_VERTEX = 2
SB_SURFACE_OPEN_EDGES = 1
SB_SURFACE_FLIPPED = 2
SB_SURFACE_NONMANIFOLD_EDGES = 4
SB_SURFACE_NONMANIFOLD_NODES = 8
SB_SURFACE_DEGENERATE = 16
SB_SURFACE_DUPLICATES = 32
SB_SURFACE_UNWELDED = 64
SB_SURFACE_INSIDE_OUT = 128
SB_SURFACE_SELF_CROSSING = 256
SB_SURFACE_UNREFERENCED = 512
SB_SURFACE_SEVERAL_PARTS = 1024
SB_SURFACE_CROWDED = 2048
SB_SURFACE_FINDING_COUNT = 12
SB_SURFACE_NOT_SOLID = 2439
SB_LINEAR = 1
SB_COROTATED = 2
SB_COROTATED_INVERTIBLE = 3
SB_SVK = 4
SB_NEO_HOOKEAN = 5
SB_NEO_HOOKEAN_ISOCHORIC = 6
SB_STABLE_NEO_HOOKEAN = 7
SB_MOONEY_RIVLIN = 8
SB_REDUCED_POLYNOMIAL = 9
SB_OGDEN = 10
SB_FUNG = 11
SB_CUSTOM_LAW = 12
SB_MAX_PRONY_TERMS = 8
SB_MAX_OGDEN_TERMS = 4
SB_TANGENT_EXACT = 0
SB_TANGENT_SPD = 1
SB_TANGENT_QUASI = 2
SB_LIVER_JORDAN = 1
SB_LIVER_RAGHUNATHAN = 2
SB_LIVER_KIM = 3
SB_LIVER_NEO_HOOKEAN = 4
SB_LIVER_LINEAR = 5
SB_TEST_UNIAXIAL = 1
SB_TEST_EQUIBIAXIAL = 2
SB_TEST_PLANAR = 3
SB_TEST_SIMPLE_SHEAR = 4
SB_STRESS_NOMINAL = 0
SB_STRESS_CAUCHY = 1
SB_X = 1
SB_Y = 2
SB_Z = 4
SB_XYZ = 7
SB_DIRECT_CHOLESKY = 0
SB_DIRECT_LDLT = 1
SB_MAX_MEAN_POINTS = 4
SB_INTEGRATION_AUTO = 0
SB_INTEGRATION_STANDARD = 1
SB_INTEGRATION_CURVED = 2
SB_INTEGRATION_BBAR = 3
SB_INTEGRATION_PATCH = 4
SB_MASS_LUMPED = 0
SB_MASS_CONSISTENT = 1
SB_MASS_REDUCED = 2
SB_PRECOND_NONE = 0
SB_PRECOND_BLOCK_JACOBI = 1
SB_PRECOND_SSOR = 2
SB_PRECOND_IC0 = 3
SB_PRECOND_AUTO = 4
SB_PRECOND_FSAI = 5
SB_PRECOND_CHOLESKY = 6
SB_PRECOND_MULTIGRID = 7
SB_PRECOND_PIECES_AUTO = -1
SB_PRECOND_MAX_POWER = 3
SB_GRID_SPARSE = 1
SB_GRID_FINITE_CELL = 2
SB_GRID_WEIGHTED_CELL = 3
SB_GRID_EMPTY = -1
SB_GRID_MAX_SHAPES = 30
SB_GRID_MAX_LEVEL = 8
SB_MIXTURE_VOIGT = 1
SB_MIXTURE_GEOMETRIC = 2
SB_MIXTURE_REUSS = 3
SB_MIXTURE_MAX_SHAPES = 30
SB_MIXTURE_MAX_LEVEL = 16
SB_PARTICLES_SPH = 1
SB_PARTICLES_MLS = 2
SB_PARTICLES_GRID = 3
SB_KERNEL_SPIKY = 1
SB_KERNEL_POLY6 = 2
SB_KERNEL_COSINE = 3
SB_KERNEL_CUBIC = 4
SB_KERNEL_QUARTIC = 5
SB_RADIUS_FIXED = 1
SB_RADIUS_FARTHEST = 2
SB_RADIUS_MEAN = 3
SB_MAX_NEIGHBOURS = 31
SB_AUTO = -1
SB_EULER = 1
SB_NEWMARK = 2
SB_GENERALISED_ALPHA = 3
SB_CENTRAL_DIFFERENCE = 4
SB_CHECK_SIZE = 1
SB_CHECK_DENSITY = 2
SB_CHECK_STIFFNESS = 4
SB_CHECK_SLIVERS = 8
SB_CHECK_LOCKING = 16
SB_CHECK_UNREFERENCED = 32
SB_CHECK_UNSUPPORTED = 64
SB_CHECK_COMPONENTS = 128
SB_CHECK_DUPLICATES = 256
SB_TENSOR_STRESS = 1
SB_TENSOR_STRAIN = 2
SB_NODE_COPY = 1
SB_NODE_KEEP_X = 2
SB_NODE_KEEP_Y = 4
SB_NODE_KEEP_Z = 8
SB_MEMBRANE_SLACK = 0
SB_MEMBRANE_WRINKLED = 1
SB_MEMBRANE_TAUT = 2
SB_CAVITY_PRESSURE = 0
SB_CAVITY_GAS = 1
SB_CAVITY_LIQUID = 2
SB_CAVITY_VOLUME = 3
SB_CAVITY_TABLE = 4
SB_MAX_CAVITY_POINTS = 16
SB_MAX_RIGID = 96
SB_EMBED_SMOOTH = 0
SB_EMBED_PLAIN = 1
SB_EMBEDDED_INSIDE = 0
SB_EMBEDDED_OFFSET = 1
SB_EMBEDDED_FRAME = 2
SB_EMBEDDED_EXTRAPOLATED = 3
SB_TIE_CLOSE_GAPS = 1
SB_TIE_ALL = 2
SB_STOP_NONE = 0
SB_STOP_CONVERGED = 1
SB_STOP_FLOOR = 2
SB_NEWTON_AUTO = 0
SB_NEWTON_PLAIN = 1
SB_NEWTON_MIXED_POINTS = 2
SB_START_AUTO = 0
SB_START_PRESENT = 1
SB_START_ROTATIONS = 2
SB_PARAMETER_YOUNG = 1
SB_PARAMETER_POISSON = 2
SB_PARAMETER_CONSTANT = 3
SB_PARAMETER_DENSITY = 4
SB_PARAMETER_GRAVITY = 5
SB_PARAMETER_FORCE = 6
SB_PARAMETER_PRESSURE = 7
SB_PARAMETER_STIFFNESS = 8
SB_PARAMETER_TARGET = 9
SB_PARAMETER_SUPPORT = 10
SB_CONSTANT_LAMBDA = 1
SB_CONSTANT_MU = 2
SB_CONSTANT_C10 = 3
SB_CONSTANT_C01 = 4
SB_CONSTANT_C20 = 5
SB_CONSTANT_C30 = 6
SB_CONSTANT_D1 = 7
SB_CONSTANT_FIBRE_STIFFNESS = 8
SB_CONSTANT_FIBRE_TENSION = 9
SB_CONSTANT_OGDEN_MU = 10
SB_IDENTIFY_HIDDEN = 1
SB_IDENTIFY_MISFIT = 2
SB_IDENTIFY_BOUND = 4
SB_IDENTIFY_LOCKS = 8
SB_LAYER_CONVOLUTION = 1
SB_LAYER_POOL = 2
SB_LAYER_UPSAMPLE = 3
SB_LAYER_JOIN = 4
SB_ACTIVATION_NONE = 0
SB_ACTIVATION_RELU = 1
SB_NETWORK_CHANNELS = 7
SB_NETWORK_TAKE = 1
SB_NETWORK_START = 2
SB_NETWORK_KEEP = 3
SB_TOOL_SPHERE = 1
SB_TOOL_CAPSULES = 2
SB_TOOL_BOX = 3
SB_TOOL_PLANE = 4
SB_TOOL_MESH = 5
SB_TOOL_MAX_POINTS = 64
SB_TOOL_MIN_CELLS = 16
SB_TOOL_MAX_CELLS = 128
SB_CONTACT_SELF = 1
SB_CONTACT_ORGANS = 2
SB_CUT_LAG = 0
SB_CUT_GLUE = 1
SB_CUT_SKIN = 0
SB_CUT_LIP = 1
SB_CUT_CHAR = 2
SB_CUT_RIM = 3
NDL_STYLET_18G = 1
NDL_NITINOL_083 = 2
NDL_HYPODERMIC_22G = 3
NDL_REST_STRAIGHT = 1
NDL_REST_SHAPE = 2
NDL_REST_CURVATURE = 3
NDL_INTERFACE_KEEP_NODES = 0
NDL_INTERFACE_MOVE = 1
NDL_NO_OPERATION = 0
NDL_NODE_SNAP = 1
NDL_EDGE_SPLIT = 2
NDL_FACE_SPLIT = 3
NDL_TET_SPLIT = 4
NDL_BEVEL_ANGLE = 1
NDL_BEVEL_CURVATURE = 2
NDL_OBSTACLE_SPHERE = 1
NDL_OBSTACLE_CAPSULE = 2
NDL_OBSTACLE_CYLINDER = 3
NDL_OBSTACLE_SHAPE = 4
NDL_PLAN_PIECES = 3
NDL_PLAN_REACHES = 1
NDL_PLAN_SHORT = 2
NDL_PLAN_BLOCKED = 3
NDL_STEER_GOING = 0
NDL_STEER_REACHED = 1
NDL_STEER_CLOSEST = 2
NDL_STEER_LIMIT = 3
NDL_STEER_BLOCKED = 4
NDL_GUIDE_PHASES = 8
NDL_GUIDE_PLACES = 32
NDL_FREE = 0
NDL_STATIC = 1
NDL_DYNAMIC_FORWARD = 2
NDL_DYNAMIC_BACKWARD = 3
NDL_MAX_NEEDLES = 16
NDL_REMESH = 0
NDL_EMBED = 1
REG_CLOUD_AUTO = 0
REG_CLOUD_XYZ = 1
REG_CLOUD_PLY = 2
REG_CLOUD_MESH = 3
REG_OUTLIERS_NONE = 0
REG_OUTLIERS_DEVIATION = 1
REG_OUTLIERS_MEDIAN = 2
REG_OUTLIERS_TRIM = 3
REG_FIELD_DISTANCE = 0
REG_FIELD_LAPLACE = 1
REG_ICP_POINT = 0
REG_ICP_PLANE = 1
REG_ICP_WHOLE = 0
REG_ICP_TARGET_PART = 1
REG_ICP_MODEL_PART = 2
REG_ICP_CONVERGED = 0
REG_ICP_ITERATIONS = 1
REG_ICP_TIME = 2
REG_WARN_AMBIGUOUS = 1
REG_WARN_STRAIN = 256
REG_WARN_VOLUME = 512
REG_WARN_NOT_AT_REST = 1024
REG_WARN_INVERTED = 2
REG_WARN_MIXED_NORMALS = 4
REG_WARN_SCALE = 8
REG_WARN_VIEW_SMALL = 16
REG_WARN_MANY_OUTLIERS = 32
REG_WARN_LOW_CONTRAST = 64
REG_WARN_FREE_SPACE = 128
REG_ICP_POSES = 8
REG_CPD_RIGID = 0
REG_CPD_SIMILARITY = 1
REG_CPD_AFFINE = 2
REG_CPD_NONRIGID = 3
REG_CPD_CONVERGED = 0
REG_CPD_EXACT = 1
REG_CPD_ITERATIONS = 2
REG_CPD_TIME = 3
REG_PBSM = 0
REG_PBSM_LAPLACE = 1
REG_MATCH_RUNNING = 0
REG_MATCH_SETTLED = 1
REG_MATCH_STEP_CAP = 2
REG_MATCH_TIME_CAP = 3
REG_MATCH_NO_OVERLAP = 4
REG_MATCH_FAILED = 5
REG_NICP_ALL = 0
REG_NICP_FACING = 1
REG_NICP_VISIBLE = 2
REG_NICP_RUNNING = 0
REG_NICP_CONVERGED = 1
REG_NICP_INCREMENTS = 2
REG_NICP_STEP_CAP = 3
REG_NICP_TIME_CAP = 4
REG_NICP_NO_OVERLAP = 5
REG_NICP_FAILED = 6
REG_INFER_DRAWS = 32
REG_INFER_CONVERGED = 0
REG_INFER_ROUNDS = 1
REG_INFER_CAPPED = 2
REG_PRIOR_RIGID = 0
REG_PRIOR_SMOOTH = 1
REG_PRIOR_LOCAL = 2
REG_PRIOR_GRAVITY = 3
REG_PRIOR_PRESSURE = 4
REG_TRACK_FOLLOWS = 0
REG_TRACK_PREDICTS = 1
REG_TRACK_JUMPED = 2
REG_TRACK_LOST = 3

class sb_error(Structure): pass
class sb_allocator(Structure): pass
class sb_jobs(Structure): pass
class sb_output(Structure): pass
class sb_vec3(Structure): pass
class sb_mat3(Structure): pass
class sb_quat(Structure): pass
class sb_mapping(Structure): pass
class sb_element_table_face(Structure): pass
class sb_element_table(Structure): pass
class sb_mesh(Structure): pass
class sb_mesh_bad_element(Structure): pass
class sb_mesh_report(Structure): pass
class sb_index_table(Structure): pass
class sb_index_lists(Structure): pass
class sb_boundary(Structure): pass
class sb_mesh_change(Structure): pass
class sb_load_report(Structure): pass
class sb_mesh_set(Structure): pass
class sb_mesh_sets(Structure): pass
class sb_load_options(Structure): pass
class sb_field(Structure): pass
class sb_image(Structure): pass
class sb_label_def(Structure): pass
class sb_label_report(Structure): pass
class sb_surface(Structure): pass
class sb_surface_hit(Structure): pass
class sb_surface_place(Structure): pass
class sb_surface_report(Structure): pass
class sb_surface_repair_def(Structure): pass
class sb_surface_repair_report(Structure): pass
class sb_shape(Structure): pass
class sb_stuff_def(Structure): pass
class sb_stuff_report(Structure): pass
class sb_material_law(Structure): pass
class sb_material(Structure): pass
class sb_material_history(Structure): pass
class sb_test_point(Structure): pass
class sb_fit_options(Structure): pass
class sb_fit_info(Structure): pass
class sb_matrix(Structure): pass
class sb_direct_def(Structure): pass
class sb_direct_info(Structure): pass
class sb_direct(Structure): pass
class sb_domain(Structure): pass
class sb_multigrid_level(Structure): pass
class sb_preconditioner_def(Structure): pass
class sb_preconditioner_info(Structure): pass
class sb_preconditioner(Structure): pass
class sb_pcg_options(Structure): pass
class sb_pcg_info(Structure): pass
class sb_pcg_workspace(Structure): pass
class sb_grid_def(Structure): pass
class sb_grid(Structure): pass
class sb_grid_rows(Structure): pass
class sb_mixture_def(Structure): pass
class sb_mixture(Structure): pass
class sb_particles_def(Structure): pass
class sb_particles(Structure): pass
class sb_body(Structure): pass
class sb_region_material(Structure): pass
class sb_body_def(Structure): pass
class sb_energy(Structure): pass
class sb_part(Structure): pass
class sb_check_report(Structure): pass
class sb_body_change(Structure): pass
class sb_cell_moments(Structure): pass
class sb_change_cell(Structure): pass
class sb_body_listener(Structure): pass
class sb_cable_def(Structure): pass
class sb_membrane_def(Structure): pass
class sb_membrane_state(Structure): pass
class sb_cavity_def(Structure): pass
class sb_rigid_def(Structure): pass
class sb_rigid_motion(Structure): pass
class sb_embedding_def(Structure): pass
class sb_embedding(Structure): pass
class sb_embedding_report(Structure): pass
class sb_embedded_point(Structure): pass
class sb_embedding_rows(Structure): pass
class sb_skin(Structure): pass
class sb_constraint_term(Structure): pass
class sb_tie_report(Structure): pass
class sb_static_report(Structure): pass
class sb_step_info(Structure): pass
class sb_static_options(Structure): pass
class sb_modes_options(Structure): pass
class sb_modes_info(Structure): pass
class sb_unload_def(Structure): pass
class sb_unload_report(Structure): pass
class sb_recording(Structure): pass
class sb_recording_info(Structure): pass
class sb_recording_report(Structure): pass
class sb_parameter(Structure): pass
class sb_recording_loss(Structure): pass
class sb_recording_slopes(Structure): pass
class sb_measurement(Structure): pass
class sb_identify_def(Structure): pass
class sb_identify_info(Structure): pass
class sb_network(Structure): pass
class sb_network_def(Structure): pass
class sb_network_shape(Structure): pass
class sb_network_input(Structure): pass
class sb_network_info(Structure): pass
class sb_heat(Structure): pass
class sb_heat_tissue(Structure): pass
class sb_heat_region(Structure): pass
class sb_heat_def(Structure): pass
class sb_heat_flows(Structure): pass
class sb_heat_info(Structure): pass
class sb_pose(Structure): pass
class sb_tool_def(Structure): pass
class sb_contact(Structure): pass
class sb_contact_def(Structure): pass
class sb_wrench(Structure): pass
class sb_grip(Structure): pass
class sb_contact_point(Structure): pass
class sb_contact_info(Structure): pass
class sb_tool_state(Structure): pass
class sb_wrench_d(Structure): pass
class sb_haptic_def(Structure): pass
class sb_haptic_info(Structure): pass
class sb_haptic(Structure): pass
class sb_cut(Structure): pass
class sb_cut_def(Structure): pass
class sb_cut_info(Structure): pass
class sb_tear_options(Structure): pass
class sb_cut_surface(Structure): pass
class sb_cut_origin(Structure): pass
class sb_cut_drawing(Structure): pass
class sb_cut_fine(Structure): pass
class sb_cut_fine_source(Structure): pass
class sb_cut_fine_drawing(Structure): pass
class ndl_rod(Structure): pass
class ndl_rod_section(Structure): pass
class ndl_rod_stiffness(Structure): pass
class ndl_rod_def(Structure): pass
class ndl_rod_info(Structure): pass
class ndl_rod_static_options(Structure): pass
class ndl_frame(Structure): pass
class ndl_rod_energy(Structure): pass
class ndl_surface_hit(Structure): pass
class ndl_remesh_def(Structure): pass
class ndl_remesh(Structure): pass
class ndl_remesh_info(Structure): pass
class ndl_tip_pose(Structure): pass
class ndl_bevel(Structure): pass
class ndl_obstacle(Structure): pass
class ndl_plan_piece(Structure): pass
class ndl_plan(Structure): pass
class ndl_plan_def(Structure): pass
class ndl_steer_command(Structure): pass
class ndl_steer_def(Structure): pass
class ndl_steer(Structure): pass
class ndl_push_def(Structure): pass
class ndl_push(Structure): pass
class ndl_push_place(Structure): pass
class ndl_guide_def(Structure): pass
class ndl_guide_phase(Structure): pass
class ndl_guide(Structure): pass
class ndl_couple_info(Structure): pass
class ndl_needle(Structure): pass
class ndl_friction(Structure): pass
class ndl_membrane(Structure): pass
class ndl_needle_def(Structure): pass
class ndl_command(Structure): pass
class ndl_step_info(Structure): pass
class reg_rigid(Structure): pass
class reg_kdtree(Structure): pass
class reg_cloud(Structure): pass
class reg_smooth_info(Structure): pass
class reg_field_def(Structure): pass
class reg_field(Structure): pass
class reg_field_hit(Structure): pass
class reg_field_sample(Structure): pass
class reg_icp_shape(Structure): pass
class reg_icp_landmark(Structure): pass
class reg_icp_options(Structure): pass
class reg_icp_info(Structure): pass
class reg_cpd_info(Structure): pass
class reg_cpd_options(Structure): pass
class reg_cpd(Structure): pass
class reg_match_def(Structure): pass
class reg_match(Structure): pass
class reg_match_info(Structure): pass
class reg_match_sample(Structure): pass
class reg_nicp_def(Structure): pass
class reg_nicp(Structure): pass
class reg_nicp_info(Structure): pass
class reg_nicp_source(Structure): pass
class reg_loads_def(Structure): pass
class reg_loads_info(Structure): pass
class reg_model_def(Structure): pass
class reg_model(Structure): pass
class reg_points(Structure): pass
class reg_landmark(Structure): pass
class reg_curve(Structure): pass
class reg_infer_def(Structure): pass
class reg_infer(Structure): pass
class reg_quality(Structure): pass
class reg_track_def(Structure): pass
class reg_track(Structure): pass
class reg_track_info(Structure): pass

sb_error._fields_ = [
    ("result", c_int),
    ("line", c_int),
    ("element", c_int),
    ("node", c_int),
    ("file", c_char * 256),
    ("message", c_char * 256),
]
sb_allocator._fields_ = [
    ("alloc", CFUNCTYPE(c_void_p, c_void_p, c_size_t)),
    ("release", CFUNCTYPE(None, c_void_p, c_void_p)),
    ("user", c_void_p),
]
sb_jobs._fields_ = [
    ("run", CFUNCTYPE(None, c_void_p, CFUNCTYPE(None, c_void_p, c_int), c_void_p, c_int)),
    ("user", c_void_p),
]
sb_output._fields_ = [
    ("file", c_void_p),
    ("path", c_char_p),
    ("target", c_char * 4096),
    ("beside", c_char * 4096),
]
sb_vec3._fields_ = [
    ("x", c_double),
    ("y", c_double),
    ("z", c_double),
]
sb_mat3._fields_ = [
    ("m", c_double * 3 * 3),
]
sb_quat._fields_ = [
    ("w", c_double),
    ("x", c_double),
    ("y", c_double),
    ("z", c_double),
]
sb_mapping._fields_ = [
    ("row_count", c_int),
    ("row_start", POINTER(c_int)),
    ("nodes", POINTER(c_int)),
    ("weights", POINTER(c_double)),
]
sb_element_table_face._fields_ = [
    ("type", c_int),
    ("nodes", c_int * 9),
]
sb_element_table._fields_ = [
    ("name", c_char_p),
    ("node_count", c_int),
    ("corner_count", c_int),
    ("node_points", POINTER(c_double * 3)),
    ("shape", CFUNCTYPE(None, c_void_p, c_double * 3, POINTER(c_double), POINTER(c_double * 3))),
    ("user", c_void_p),
    ("point_count", c_int),
    ("points", POINTER(c_double * 3)),
    ("weights", POINTER(c_double)),
    ("mass_point_count", c_int),
    ("mass_points", POINTER(c_double * 3)),
    ("mass_weights", POINTER(c_double)),
    ("face_count", c_int),
    ("faces", POINTER(sb_element_table_face)),
    ("vtk_type", c_int),
]
sb_mesh._fields_ = [
    ("node_count", c_int),
    ("nodes", POINTER(sb_vec3)),
    ("element_type", c_int),
    ("element_count", c_int),
    ("elements", POINTER(c_int)),
    ("regions", POINTER(c_int)),
    ("allocator", sb_allocator),
    ("table", POINTER(sb_element_table)),
]
sb_mesh_bad_element._fields_ = [
    ("element", c_int),
    ("defect", c_int),
]
sb_mesh_report._fields_ = [
    ("bad_count", c_int),
    ("bad", POINTER(sb_mesh_bad_element)),
    ("defect_count", c_int * 8),
    ("not_finite_nodes", c_int),
    ("first_not_finite_node", c_int),
    ("unreferenced_nodes", c_int),
    ("first_unreferenced_node", c_int),
    ("duplicate_nodes", c_int),
    ("components", c_int),
    ("volume", c_double),
    ("area", c_double),
    ("min_edge", c_double),
    ("max_edge", c_double),
    ("worst_quality", c_double),
    ("worst_element", c_int),
    ("boundary_faces", c_int),
    ("nonmanifold_faces", c_int),
    ("open_edges", c_int),
    ("nonmanifold_edges", c_int),
    ("inconsistent_edges", c_int),
    ("nonmanifold_vertices", c_int),
    ("allocator", sb_allocator),
]
sb_index_table._fields_ = [
    ("rows", c_int),
    ("columns", c_int),
    ("items", POINTER(c_int)),
    ("allocator", sb_allocator),
]
sb_index_lists._fields_ = [
    ("count", c_int),
    ("offsets", POINTER(c_int)),
    ("items", POINTER(c_int)),
    ("allocator", sb_allocator),
]
sb_boundary._fields_ = [
    ("surface", sb_mesh),
    ("elements", POINTER(c_int)),
    ("faces", POINTER(c_int)),
    ("nodes", POINTER(c_int)),
]
sb_mesh_change._fields_ = [
    ("node_end", c_int),
    ("cell_end", c_int),
    ("nodes_per_cell", c_int),
    ("made_node_count", c_int),
    ("made_nodes", POINTER(c_int)),
    ("made_positions", POINTER(sb_vec3)),
    ("source_start", POINTER(c_int)),
    ("sources", POINTER(c_int)),
    ("source_weights", POINTER(c_double)),
    ("made_copies", POINTER(c_ubyte)),
    ("removed_node_count", c_int),
    ("removed_nodes", POINTER(c_int)),
    ("heir_start", POINTER(c_int)),
    ("heirs", POINTER(c_int)),
    ("heir_weights", POINTER(c_double)),
    ("moved_node_count", c_int),
    ("moved_nodes", POINTER(c_int)),
    ("moved_from", POINTER(sb_vec3)),
    ("moved_to", POINTER(sb_vec3)),
    ("moved_start", POINTER(c_int)),
    ("moved_sources", POINTER(c_int)),
    ("moved_weights", POINTER(c_double)),
    ("removed_cell_count", c_int),
    ("removed_cells", POINTER(c_int)),
    ("removed_cell_nodes", POINTER(c_int)),
    ("made_cell_count", c_int),
    ("made_cells", POINTER(c_int)),
    ("made_cell_nodes", POINTER(c_int)),
    ("made_parents", POINTER(c_int)),
    ("made_shares", POINTER(c_double)),
    ("reshaped_cell_count", c_int),
    ("reshaped_cells", POINTER(c_int)),
    ("reshaped_shares", POINTER(c_double)),
    ("find_cell", CFUNCTYPE(c_int, c_void_p, c_int, c_double * 3)),
    ("find_user", c_void_p),
]
sb_load_report._fields_ = [
    ("format", c_int),
    ("file_cells", c_int),
    ("skipped_cells", c_int),
    ("split_polygons", c_int),
    ("split_cells", c_int),
    ("merged_vertices", c_int),
    ("flipped_elements", c_int),
    ("unreferenced_nodes", c_int),
    ("ignored", c_int),
    ("note_count", c_int),
    ("notes", c_char * 192 * 10),
]
sb_mesh_set._fields_ = [
    ("name", c_char * 64),
    ("number", c_int),
    ("dimension", c_int),
    ("element_count", c_int),
    ("elements", POINTER(c_int)),
    ("face_count", c_int),
    ("face_corners", c_int),
    ("faces", POINTER(c_int)),
    ("node_count", c_int),
    ("nodes", POINTER(c_int)),
]
sb_mesh_sets._fields_ = [
    ("count", c_int),
    ("sets", POINTER(sb_mesh_set)),
    ("allocator", sb_allocator),
]
sb_load_options._fields_ = [
    ("scale", c_double),
    ("fix_orientation", c_int),
    ("allocator", sb_allocator),
    ("report", POINTER(sb_load_report)),
    ("sets", POINTER(sb_mesh_sets)),
    ("cookie", c_int),
]
sb_field._fields_ = [
    ("name", c_char_p),
    ("location", c_int),
    ("components", c_int),
    ("values", POINTER(c_double)),
]
sb_image._fields_ = [
    ("counts", c_int * 3),
    ("origin", sb_vec3),
    ("spacing", sb_vec3),
    ("direction", sb_mat3),
    ("labels", POINTER(c_int)),
    ("allocator", sb_allocator),
]
sb_label_def._fields_ = [
    ("image", POINTER(sb_image)),
    ("labels", POINTER(c_int)),
    ("label_count", c_int),
    ("smoothing", c_int),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
sb_label_report._fields_ = [
    ("voxels", c_int),
    ("voxel_volume", c_double),
    ("volume", c_double),
    ("held_voxels", c_int),
]
sb_surface_hit._fields_ = [
    ("triangle", c_int),
    ("element", c_int),
    ("feature", c_int),
    ("index", c_int),
    ("point", sb_vec3),
    ("weights", c_double * 3),
    ("distance", c_double),
]
sb_surface_place._fields_ = [
    ("count", c_int),
    ("element", c_int),
    ("other_element", c_int),
    ("node", c_int),
    ("other_node", c_int),
]
sb_surface_report._fields_ = [
    ("findings", c_int),
    ("place", sb_surface_place * 12),
    ("crossings_partial", c_int),
    ("parts", c_int),
    ("volume", c_double),
    ("area", c_double),
]
sb_surface_repair_def._fields_ = [
    ("weld", c_int),
    ("weld_tolerance", c_double),
    ("clean", c_int),
    ("orient", c_int),
    ("max_hole_edges", c_int),
]
sb_surface_repair_report._fields_ = [
    ("merged_nodes", c_int),
    ("removed_nodes", c_int),
    ("removed_degenerate", c_int),
    ("removed_duplicates", c_int),
    ("flipped_edges", c_int),
    ("turned_faces", c_int),
    ("filled_holes", c_int),
    ("added_faces", c_int),
    ("left_holes", c_int),
]
sb_shape._fields_ = [
    ("surface", POINTER(sb_surface)),
    ("distance", CFUNCTYPE(c_double, c_void_p, sb_vec3)),
    ("user", c_void_p),
    ("max_slope", c_double),
    ("region", c_int),
]
sb_stuff_def._fields_ = [
    ("shapes", POINTER(sb_shape)),
    ("shape_count", c_int),
    ("low", sb_vec3),
    ("high", sb_vec3),
    ("cell", c_double),
    ("levels", c_int),
    ("type", c_int),
    ("max_elements", c_int),
    ("least_share", c_double),
    ("progress", CFUNCTYPE(c_int, c_void_p, c_double)),
    ("progress_user", c_void_p),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("cookie", c_uint),
]
sb_stuff_report._fields_ = [
    ("cells", c_int * 3),
    ("node_count", c_int),
    ("element_count", c_int),
    ("min_dihedral", c_double),
    ("max_dihedral", c_double),
    ("distance", c_double),
    ("volume", c_double),
    ("volume_share", c_double * 64),
    ("surface_share", c_double * 64),
]
sb_material_law._fields_ = [
    ("name", c_char_p),
    ("user", c_void_p),
    ("energy", CFUNCTYPE(c_int, c_void_p, POINTER(sb_mat3), POINTER(c_double))),
    ("stress", CFUNCTYPE(c_int, c_void_p, POINTER(sb_mat3), POINTER(sb_mat3))),
    ("tangent", CFUNCTYPE(c_int, c_void_p, POINTER(sb_mat3), POINTER(c_double))),
]
sb_material._fields_ = [
    ("model", c_int),
    ("density", c_double),
    ("lambda", c_double),
    ("mu", c_double),
    ("c10", c_double),
    ("d1", c_double),
    ("c01", c_double),
    ("c20", c_double),
    ("c30", c_double),
    ("fung_exponent", c_double),
    ("ogden_mu", c_double * 4),
    ("ogden_alpha", c_double * 4),
    ("fibre_stiffness", c_double),
    ("fibre_exponent", c_double),
    ("fibre_dispersion", c_double),
    ("fibre_tension", c_double),
    ("fibre_optimum", c_double),
    ("fibre_width", c_double),
    ("prestretch", sb_mat3),
    ("prony_count", c_int),
    ("prony_g", c_double * 8),
    ("prony_tau", c_double * 8),
    ("law", POINTER(sb_material_law)),
    ("law_scale", c_double),
]
sb_material_history._fields_ = [
    ("stress", c_double * 6),
    ("memory", c_double * 6 * 8),
]
sb_test_point._fields_ = [
    ("kind", c_int),
    ("measure", c_int),
    ("strain", c_double),
    ("stress", c_double),
]
sb_fit_options._fields_ = [
    ("order", c_int),
    ("relative", c_int),
    ("nonnegative", c_int),
    ("compressible", c_int),
    ("poisson", c_double),
    ("d1", c_double),
    ("density", c_double),
]
sb_fit_info._fields_ = [
    ("points", c_int),
    ("constants", c_int),
    ("iterations", c_int),
    ("rms", c_double),
    ("r_squared", c_double),
    ("weakest", c_double),
    ("stable", c_int),
    ("unstable_kind", c_int),
    ("unstable_strain", c_double),
]
sb_matrix._fields_ = [
    ("row_count", c_int),
    ("block_count", c_int),
    ("row_start", POINTER(c_int)),
    ("row_end", POINTER(c_int)),
    ("columns", POINTER(c_int)),
    ("diagonal", POINTER(c_int)),
    ("transpose", POINTER(c_int)),
    ("part_count", c_int),
    ("part_start", POINTER(c_int)),
    ("part_rows", POINTER(c_int)),
    ("fixed", POINTER(c_ubyte)),
    ("blocks", POINTER(c_double * 9)),
    ("memory", c_void_p),
    ("live", c_void_p),
    ("allocator", sb_allocator),
]
sb_direct_def._fields_ = [
    ("kind", c_int),
    ("positions", POINTER(sb_vec3)),
]
sb_direct_info._fields_ = [
    ("unknowns", c_int),
    ("fronts", c_int),
    ("largest_front", c_int),
    ("factor_entries", c_double),
    ("multiply_adds", c_double),
    ("bytes", c_size_t),
    ("least_pivot", c_double),
    ("negative_pivots", c_int),
]
sb_domain._fields_ = [
    ("element_type", c_int),
    ("table", POINTER(sb_element_table)),
    ("single_rotation", c_int),
    ("mean_points", c_int),
    ("node_count", c_int),
    ("cell_count", c_int),
    ("nodes_per_cell", c_int),
    ("points_per_cell", c_int),
    ("cells", POINTER(c_int)),
    ("gradients", POINTER(c_double)),
    ("weights", POINTER(c_double)),
    ("cell_mass", POINTER(c_double)),
    ("patch_count", c_int),
    ("cell_patch", POINTER(c_int)),
    ("cell_capacity", c_int),
    ("allocator", sb_allocator),
]
sb_multigrid_level._fields_ = [
    ("mapping", sb_mapping),
    ("node_count", c_int),
    ("positions", POINTER(sb_vec3)),
]
sb_preconditioner_def._fields_ = [
    ("kind", c_int),
    ("positions", POINTER(sb_vec3)),
    ("piece_count", c_int),
    ("power", c_int),
    ("jobs", sb_jobs),
    ("poisson", c_double),
    ("levels", POINTER(sb_multigrid_level)),
    ("level_count", c_int),
    ("moduli", POINTER(c_double)),
]
sb_preconditioner_info._fields_ = [
    ("kind", c_int),
    ("piece_count", c_int),
    ("attempts", c_int),
    ("shift", c_double),
    ("level_count", c_int),
    ("bytes", c_size_t),
]
sb_pcg_options._fields_ = [
    ("tolerance", c_double),
    ("max_iterations", c_int),
    ("jobs", POINTER(sb_jobs)),
]
sb_pcg_info._fields_ = [
    ("iterations", c_int),
    ("residual", c_double),
    ("residual_is_true", c_int),
    ("negative_curvature", c_int),
    ("capped", c_int),
]
sb_pcg_workspace._fields_ = [
    ("row_count", c_int),
    ("start", POINTER(c_double)),
    ("residual", POINTER(c_double)),
    ("search", POINTER(c_double)),
    ("direction", POINTER(c_double)),
    ("product", POINTER(c_double)),
    ("partial", POINTER(c_double)),
    ("parts", c_void_p),
    ("memory", c_void_p),
    ("guests", c_void_p),
    ("guest_bytes", c_size_t),
    ("extra", c_void_p),
    ("unassembled", c_void_p),
    ("record", c_void_p),
    ("allocator", sb_allocator),
]
sb_grid_def._fields_ = [
    ("method", c_int),
    ("level", c_int),
    ("outer", sb_shape),
    ("inner", POINTER(sb_shape)),
    ("inner_count", c_int),
    ("low", sb_vec3),
    ("high", sb_vec3),
    ("cells", c_int),
    ("cell_size", c_double),
    ("counts", c_int * 3),
    ("void_stiffness", c_double),
    ("least_share", c_double),
    ("max_points", c_int),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("progress", CFUNCTYPE(c_int, c_void_p, c_double)),
    ("progress_user", c_void_p),
    ("cookie", c_uint),
]
sb_grid._fields_ = [
    ("mesh", sb_mesh),
    ("body_mesh", sb_mesh),
    ("domain", sb_domain),
    ("body_cells", POINTER(c_int)),
    ("shares", POINTER(c_double)),
    ("origin", sb_vec3),
    ("cell_size", sb_vec3),
    ("counts", c_int * 3),
    ("lattice", POINTER(c_int)),
    ("cut_count", c_int),
    ("region_count", c_int),
    ("regions", POINTER(c_int)),
    ("region_volumes", POINTER(c_double)),
    ("volume", c_double),
    ("allocator", sb_allocator),
]
sb_grid_rows._fields_ = [
    ("rows", sb_mapping),
    ("cells", POINTER(c_int)),
    ("points", POINTER(sb_vec3)),
    ("areas", POINTER(c_double)),
    ("normals", POINTER(sb_vec3)),
    ("farthest", c_double),
    ("memory", c_void_p),
    ("allocator", sb_allocator),
]
sb_mixture_def._fields_ = [
    ("mesh", POINTER(sb_mesh)),
    ("shapes", POINTER(sb_shape)),
    ("shape_count", c_int),
    ("level", c_int),
    ("least_share", c_double),
    ("mean", c_int),
    ("stiffness", POINTER(c_double)),
    ("integration", c_int),
    ("single_rotation", c_int),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
sb_mixture._fields_ = [
    ("body_mesh", sb_mesh),
    ("domain", sb_domain),
    ("elements", POINTER(c_int)),
    ("shares", POINTER(c_double)),
    ("mixed_count", c_int),
    ("region_count", c_int),
    ("regions", POINTER(c_int)),
    ("region_volumes", POINTER(c_double)),
    ("volume", c_double),
    ("allocator", sb_allocator),
]
sb_particles_def._fields_ = [
    ("method", c_int),
    ("kernel", c_int),
    ("radius_rule", c_int),
    ("radius", c_double),
    ("dilatation", c_double),
    ("neighbours", c_int),
    ("basis", c_int),
    ("points_per_cell", c_int),
    ("level", c_int),
    ("consistent", c_int),
    ("outer", sb_shape),
    ("inner", POINTER(sb_shape)),
    ("inner_count", c_int),
    ("low", sb_vec3),
    ("high", sb_vec3),
    ("cells", c_int),
    ("spacing", c_double),
    ("counts", c_int * 3),
    ("points", POINTER(sb_vec3)),
    ("point_count", c_int),
    ("volumes", POINTER(c_double)),
    ("volume", c_double),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("cookie", c_uint),
]
sb_particles._fields_ = [
    ("mesh", sb_mesh),
    ("domain", sb_domain),
    ("table", POINTER(sb_element_table)),
    ("points", POINTER(sb_vec3)),
    ("radii", POINTER(c_double)),
    ("shapes", POINTER(c_double)),
    ("inner", POINTER(c_ubyte)),
    ("volume", c_double),
    ("spacing", c_double),
    ("grown", c_int),
    ("lost", c_int),
    ("worst_condition", c_double),
    ("imbalance", c_double),
    ("def", sb_particles_def),
    ("cuts", POINTER(POINTER(sb_surface))),
    ("cut_count", c_int),
]
sb_region_material._fields_ = [
    ("region", c_int),
    ("material", sb_material),
]
sb_body_def._fields_ = [
    ("mesh", POINTER(sb_mesh)),
    ("domain", POINTER(sb_domain)),
    ("material", sb_material),
    ("region_materials", POINTER(sb_region_material)),
    ("region_material_count", c_int),
    ("fibres", POINTER(sb_vec3)),
    ("second_fibres", POINTER(sb_vec3)),
    ("integration", c_int),
    ("single_rotation", c_int),
    ("mass", c_int),
    ("integrator", c_int),
    ("spectral_radius", c_double),
    ("max_substeps", c_int),
    ("gravity", sb_vec3),
    ("damping_mass", c_double),
    ("damping_stiffness", c_double),
    ("preconditioner", c_int),
    ("levels", POINTER(sb_multigrid_level)),
    ("level_count", c_int),
    ("tolerance", c_double),
    ("max_iterations", c_int),
    ("max_newton", c_int),
    ("newton_tolerance", c_double),
    ("slack", c_double),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("clock", CFUNCTYPE(c_double)),
    ("cookie", c_uint),
]
sb_energy._fields_ = [
    ("elastic", c_double),
    ("kinetic", c_double),
    ("springs", c_double),
]
sb_part._fields_ = [
    ("node", c_int),
    ("node_count", c_int),
    ("volume", c_double),
    ("mass", c_double),
    ("centre", sb_vec3),
]
sb_check_report._fields_ = [
    ("warnings", c_uint),
    ("size", c_double),
    ("worst_quality", c_double),
    ("worst_element", c_int),
    ("sliver_count", c_int),
    ("unreferenced_count", c_int),
    ("component_count", c_int),
    ("duplicate_count", c_int),
    ("locking_count", c_int),
    ("locking_element", c_int),
    ("locking_limit", c_double),
    ("unsupported_component_node", c_int),
]
sb_cell_moments._fields_ = [
    ("centroid", sb_vec3),
    ("covariance", sb_mat3),
]
sb_change_cell._fields_ = [
    ("nodes", POINTER(c_int)),
    ("parent", c_int),
    ("region", c_int),
    ("fibre", POINTER(sb_vec3)),
    ("share", c_double),
    ("moments", POINTER(sb_cell_moments)),
    ("face_loads", POINTER(c_double)),
]
sb_body_listener._fields_ = [
    ("user", c_void_p),
    ("reserve", CFUNCTYPE(c_int, c_void_p, POINTER(sb_body), POINTER(sb_mesh_change), POINTER(sb_error))),
    ("follow", CFUNCTYPE(None, c_void_p, POINTER(sb_body), POINTER(sb_mesh_change))),
    ("give_up", CFUNCTYPE(None, c_void_p)),
    ("end", CFUNCTYPE(None, c_void_p)),
]
sb_cable_def._fields_ = [
    ("count", c_int),
    ("nodes", POINTER(c_int)),
    ("rows", POINTER(sb_mapping)),
    ("places", POINTER(sb_vec3)),
    ("rest_length", c_double),
    ("stiffness", c_double),
    ("toe_strain", c_double),
    ("pushes", c_int),
]
sb_membrane_def._fields_ = [
    ("faces", POINTER(c_int)),
    ("face_count", c_int),
    ("corners", c_int),
    ("thickness", c_double),
    ("shear", c_double),
    ("prestretch", c_double),
    ("wrinkles", c_int),
]
sb_membrane_state._fields_ = [
    ("stretch", c_double * 2),
    ("tension", c_double * 2),
    ("direction", sb_vec3),
    ("form", c_int),
]
sb_cavity_def._fields_ = [
    ("faces", POINTER(c_int)),
    ("face_count", c_int),
    ("corners", c_int),
    ("kind", c_int),
    ("pressure", c_double),
    ("ambient", c_double),
    ("exponent", c_double),
    ("bulk", c_double),
    ("point_count", c_int),
    ("table_volume", c_double * 16),
    ("table_pressure", c_double * 16),
]
sb_rigid_def._fields_ = [
    ("mass", c_double),
    ("inertia", sb_mat3),
    ("centre", sb_vec3),
    ("turn", sb_quat),
    ("velocity", sb_vec3),
    ("spin", sb_vec3),
    ("nodes", POINTER(c_int)),
    ("node_count", c_int),
]
sb_rigid_motion._fields_ = [
    ("centre", sb_vec3),
    ("turn", sb_quat),
    ("velocity", sb_vec3),
    ("spin", sb_vec3),
    ("force", sb_vec3),
    ("torque", sb_vec3),
]
sb_embedding_def._fields_ = [
    ("mesh", POINTER(sb_mesh)),
    ("points", POINTER(sb_vec3)),
    ("point_count", c_int),
    ("surface", POINTER(sb_mesh)),
    ("normals", POINTER(sb_vec3)),
    ("kind", c_int),
    ("max_distance", c_double),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("cookie", c_uint),
]
sb_embedding_report._fields_ = [
    ("point_count", c_int),
    ("node_count", c_int),
    ("inside", c_int),
    ("offset", c_int),
    ("frame", c_int),
    ("extrapolated", c_int),
    ("lost", c_int),
    ("max_distance", c_double),
    ("farthest_point", c_int),
]
sb_embedded_point._fields_ = [
    ("hold", c_int),
    ("element", c_int),
    ("xi", c_double * 3),
    ("distance", c_double),
    ("step", c_double * 3),
    ("lost", c_int),
]
sb_embedding_rows._fields_ = [
    ("mapping", sb_mapping),
    ("row_start", POINTER(c_int)),
    ("nodes", POINTER(c_int)),
    ("weights", POINTER(c_double)),
    ("allocator", sb_allocator),
]
sb_constraint_term._fields_ = [
    ("node", c_int),
    ("axis", c_int),
    ("coefficient", c_double),
]
sb_tie_report._fields_ = [
    ("tied_count", c_int),
    ("free_count", c_int),
    ("farthest_node", c_int),
    ("supported_count", c_int),
    ("largest_gap", c_double),
    ("first_constraint", c_int),
    ("constraint_count", c_int),
]
sb_static_report._fields_ = [
    ("reason", c_int),
    ("iterations", c_int),
    ("force", c_double),
    ("energy", c_double),
    ("increment", c_double),
    ("floor", c_double),
    ("newton", c_int),
    ("solver", c_int),
]
sb_step_info._fields_ = [
    ("newton_iterations", c_int),
    ("pcg_iterations", c_int),
    ("substeps", c_int),
    ("load_steps", c_int),
    ("load_factor", c_double),
    ("residual", c_double),
    ("capped", c_int),
    ("seconds_force", c_double),
    ("seconds_tangent", c_double),
    ("seconds_precond", c_double),
    ("seconds_solve", c_double),
    ("seconds_total", c_double),
    ("error", sb_error),
    ("statics", sb_static_report),
]
sb_static_options._fields_ = [
    ("load_steps", c_int),
    ("tolerance", c_double),
    ("max_newton", c_int),
    ("max_iterations", c_int),
    ("quasi_newton", c_int),
    ("newton", c_int),
    ("start", c_int),
    ("forces_only", c_int),
    ("keep_progress", c_int),
    ("instantaneous", c_int),
    ("progress", CFUNCTYPE(None, c_void_p, POINTER(sb_step_info))),
    ("progress_user", c_void_p),
    ("cookie", c_uint),
]
sb_modes_options._fields_ = [
    ("mass", c_int),
    ("at_present", c_int),
    ("tolerance", c_double),
    ("max_iterations", c_int),
    ("cookie", c_uint),
]
sb_modes_info._fields_ = [
    ("iterations", c_int),
    ("solves", c_int),
    ("pcg_iterations", c_int),
    ("residual", c_double),
    ("seconds", c_double),
]
sb_unload_def._fields_ = [
    ("body", sb_body_def),
    ("dress", CFUNCTYPE(c_int, c_void_p, POINTER(sb_body), c_double, POINTER(sb_error))),
    ("user", c_void_p),
    ("statics", sb_static_options),
    ("tolerance", c_double),
    ("max_iterations", c_int),
    ("load_steps", c_int),
    ("cookie", c_uint),
]
sb_unload_report._fields_ = [
    ("solves", c_int),
    ("load_steps", c_int),
    ("share", c_double),
    ("gap", c_double),
    ("size", c_double),
    ("moved", c_double),
    ("error", sb_error),
]
sb_recording_info._fields_ = [
    ("commands", c_int),
    ("steps", c_int),
    ("complete", c_int),
    ("recording", c_int),
    ("bytes", c_size_t),
]
sb_recording_report._fields_ = [
    ("commands", c_int),
    ("steps", c_int),
    ("step", c_int),
    ("expected", c_int),
    ("actual", c_int),
    ("expected_hash", c_uint64),
    ("actual_hash", c_uint64),
    ("first_node", c_int),
    ("last_node", c_int),
    ("distance", c_double),
    ("error", sb_error),
]
sb_parameter._fields_ = [
    ("kind", c_int),
    ("region", c_int),
    ("constant", c_int),
    ("load_id", c_int),
    ("row", c_int),
    ("axis", c_int),
    ("nodes", POINTER(c_int)),
    ("node_count", c_int),
]
sb_recording_loss._fields_ = [
    ("add_slope", CFUNCTYPE(None, c_void_p, c_int, POINTER(sb_vec3), POINTER(sb_vec3))),
    ("user", c_void_p),
]
sb_recording_slopes._fields_ = [
    ("gradient", POINTER(c_double)),
    ("displacement", POINTER(sb_vec3)),
    ("velocity", POINTER(sb_vec3)),
    ("force", POINTER(sb_vec3)),
]
sb_measurement._fields_ = [
    ("rows", POINTER(sb_mapping)),
    ("points", POINTER(sb_vec3)),
    ("sigma_point", c_double),
    ("force_nodes", POINTER(c_int)),
    ("force_count", c_int),
    ("force", sb_vec3),
    ("sigma_force", c_double),
]
sb_identify_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("parameters", POINTER(sb_parameter)),
    ("count", c_int),
    ("free_count", c_int),
    ("low", POINTER(c_double)),
    ("high", POINTER(c_double)),
    ("state_count", c_int),
    ("measurements", POINTER(sb_measurement)),
    ("apply", CFUNCTYPE(c_int, c_void_p, c_int, POINTER(c_double), POINTER(sb_body), POINTER(sb_error))),
    ("user", c_void_p),
    ("max_iterations", c_int),
    ("statics", sb_static_options),
    ("correlations", POINTER(c_double)),
    ("direction", POINTER(c_double)),
    ("cookie", c_uint),
]
sb_identify_info._fields_ = [
    ("iterations", c_int),
    ("solves", c_int),
    ("readings", c_int),
    ("chi2", c_double),
    ("start_chi2", c_double),
    ("warnings", c_int),
    ("weakest", c_double),
    ("weakest_parameter", c_int),
    ("hidden", c_char * 160),
]
sb_network_def._fields_ = [
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("max_bytes", c_size_t),
    ("cookie", c_uint),
]
sb_network_shape._fields_ = [
    ("counts", c_int * 3),
    ("inputs", c_int),
    ("outputs", c_int),
    ("layers", c_int),
    ("spacing", sb_vec3),
    ("length", c_double),
    ("poisson", c_double),
    ("multiply_adds", c_double),
    ("bytes", c_size_t),
]
sb_network_input._fields_ = [
    ("nodes", POINTER(c_int)),
    ("displacements", POINTER(sb_vec3)),
    ("count", c_int),
    ("policy", c_int),
    ("limit", c_double),
    ("statics", POINTER(sb_static_options)),
    ("cookie", c_uint),
]
sb_network_info._fields_ = [
    ("taken", c_int),
    ("size", c_double),
    ("force", c_double),
    ("residual", c_double),
    ("from_rest", c_double),
    ("from_last", c_double),
    ("solve", sb_step_info),
]
sb_heat_tissue._fields_ = [
    ("conductivity", c_double),
    ("capacity", c_double),
    ("perfusion", c_double),
    ("metabolic", c_double),
    ("latent_heat", c_double),
]
sb_heat_region._fields_ = [
    ("region", c_int),
    ("tissue", sb_heat_tissue),
]
sb_heat_def._fields_ = [
    ("tissue", sb_heat_tissue),
    ("regions", POINTER(sb_heat_region)),
    ("region_count", c_int),
    ("perfusion", POINTER(c_double)),
    ("metabolic", POINTER(c_double)),
    ("start", c_double),
    ("blood", c_double),
    ("latent_low", c_double),
    ("latent_high", c_double),
    ("log_frequency", c_double),
    ("activation", c_double),
    ("harmless", c_double),
    ("keeps_perfusion", c_int),
    ("stiffening", c_double),
    ("tolerance", c_double),
    ("max_iterations", c_int),
    ("cookie", c_uint),
]
sb_heat_flows._fields_ = [
    ("source", c_double),
    ("metabolic", c_double),
    ("perfused", c_double),
    ("convected", c_double),
    ("held", c_double),
    ("stored", c_double),
    ("error", c_double),
]
sb_heat_info._fields_ = [
    ("iterations", c_int),
    ("systems", c_int),
    ("residual", c_double),
    ("flows", sb_heat_flows),
    ("highest", c_double),
    ("highest_node", c_int),
    ("dead_volume", c_double),
]
sb_pose._fields_ = [
    ("position", sb_vec3),
    ("rotation", sb_quat),
]
sb_tool_def._fields_ = [
    ("shape", c_int),
    ("radius", c_double),
    ("points", POINTER(sb_vec3)),
    ("point_count", c_int),
    ("half", sb_vec3),
    ("surface", POINTER(sb_mesh)),
    ("cells", c_int),
    ("friction", c_double),
    ("pose", sb_pose),
    ("coupling_stiffness", c_double),
    ("coupling_turning", c_double),
    ("max_force", c_double),
    ("cookie", c_uint),
]
sb_contact_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("stiffness", c_double),
    ("max_iterations", c_int),
    ("max_contacts", c_int),
    ("max_tools", c_int),
    ("skin", POINTER(sb_skin)),
    ("pairs", c_int),
    ("pair_friction", c_double),
    ("pair_distance", c_double),
    ("allocator", POINTER(sb_allocator)),
    ("cookie", c_uint),
]
sb_wrench._fields_ = [
    ("force", sb_vec3),
    ("torque", sb_vec3),
]
sb_grip._fields_ = [
    ("axis", sb_vec3),
    ("force", c_double),
    ("place", sb_vec3),
    ("net", sb_wrench),
    ("sticking", c_double),
    ("used", c_double),
]
sb_contact_point._fields_ = [
    ("tool", c_int),
    ("element", c_int),
    ("face", c_int),
    ("other_element", c_int),
    ("other_face", c_int),
    ("sticks", c_int),
    ("gap", c_double),
    ("area", c_double),
    ("point", sb_vec3),
    ("normal", sb_vec3),
    ("force", sb_vec3),
]
sb_contact_info._fields_ = [
    ("candidates", c_int),
    ("touching", c_int),
    ("sticking", c_int),
    ("iterations", c_int),
    ("retries", c_int),
    ("capped", c_int),
    ("thinned", c_int),
    ("mended", c_int),
    ("inside", c_int),
    ("deepest", c_double),
    ("residual", c_double),
    ("lag", c_double),
]
sb_tool_state._fields_ = [
    ("position", c_double * 3),
    ("rotation", c_double * 9),
    ("velocity", c_double * 3),
    ("angular_velocity", c_double * 3),
    ("time", c_double),
    ("buttons", c_uint32),
]
sb_wrench_d._fields_ = [
    ("force", c_double * 3),
    ("torque", c_double * 3),
]
sb_haptic_def._fields_ = [
    ("contact", POINTER(sb_contact)),
    ("tool", c_int),
    ("max_force", c_double),
    ("max_torque", c_double),
    ("max_stiffness", c_double),
    ("max_damping", c_double),
    ("max_slew", c_double),
    ("coupling", c_double),
    ("coupling_turning", c_double),
    ("resolution", c_double),
    ("scale_motion", c_double),
    ("scale_force", c_double),
    ("timeout", c_double),
    ("energy_rate", c_double),
    ("cookie", c_uint),
]
sb_haptic_info._fields_ = [
    ("calls", c_int64),
    ("frames", c_int64),
    ("refused", c_int64),
    ("limited", c_int64),
    ("energy", c_double),
    ("age", c_double),
    ("period", c_double),
    ("gap", c_double),
    ("position", c_double * 3),
    ("rotation", c_double * 9),
]
sb_cut_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("lattice", c_int),
    ("front", c_int),
    ("glue", c_double),
    ("toughness", c_double),
    ("least_piece", c_double),
    ("max_strokes", c_int),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
sb_cut_info._fields_ = [
    ("links", c_int),
    ("ringed", c_int),
    ("torn", c_int),
    ("cells", c_int),
    ("nodes", c_int),
    ("parts", c_int),
    ("glued", c_int),
    ("glued_area", c_double),
    ("released_area", c_double),
    ("released_energy", c_double),
    ("crumbs", c_int),
    ("removed_volume", c_double),
    ("removed_mass", c_double),
    ("removed_momentum", sb_vec3),
    ("force", sb_vec3),
    ("torque", sb_vec3),
    ("work", c_double),
    ("owed", c_double),
]
sb_tear_options._fields_ = [
    ("nucleate", c_int),
    ("max_tears", c_int),
    ("cookie", c_uint),
]
sb_cut_origin._fields_ = [
    ("element", c_int),
    ("nodes", c_int * 4),
    ("weights", c_double * 4),
]
sb_cut_drawing._fields_ = [
    ("vertex_count", c_int),
    ("triangle_count", c_int),
    ("positions", POINTER(sb_vec3)),
    ("normals", POINTER(sb_vec3)),
    ("rest", POINTER(sb_vec3)),
    ("texture", POINTER(c_double * 2)),
    ("origins", POINTER(sb_cut_origin)),
    ("points", POINTER(c_int)),
    ("triangles", POINTER(c_int * 3)),
    ("tags", POINTER(c_ubyte)),
    ("cells", POINTER(c_int)),
    ("first_triangle", c_int),
    ("triangle_end", c_int),
    ("first_vertex", c_int),
]
sb_cut_fine_source._fields_ = [
    ("vertices", c_int * 3),
    ("weights", c_double * 3),
]
sb_cut_fine_drawing._fields_ = [
    ("drawn", sb_cut_drawing),
    ("sources", POINTER(sb_cut_fine_source)),
    ("open_edges", c_int),
]
ndl_rod_section._fields_ = [
    ("radius", c_double),
    ("inner_radius", c_double),
    ("young", c_double),
    ("poisson", c_double),
    ("density", c_double),
]
ndl_rod_stiffness._fields_ = [
    ("stretch", c_double),
    ("bending", c_double * 2),
    ("twist", c_double),
    ("line_density", c_double),
]
ndl_rod_def._fields_ = [
    ("nodes", POINTER(sb_vec3)),
    ("node_count", c_int),
    ("capacity", c_int),
    ("section", ndl_rod_section),
    ("stiffness", POINTER(ndl_rod_stiffness)),
    ("rest", c_int),
    ("rest_curvature", POINTER(c_double)),
    ("director", sb_vec3),
    ("clamped", c_int),
    ("gravity", sb_vec3),
    ("damping_stretch", c_double),
    ("damping_bending", c_double),
    ("max_newton", c_int),
    ("tolerance", c_double),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
ndl_rod_info._fields_ = [
    ("newton_iterations", c_int),
    ("residual", c_double),
    ("capped", c_int),
    ("damped", c_int),
    ("error", sb_error),
]
ndl_rod_static_options._fields_ = [
    ("max_newton", c_int),
    ("tolerance", c_double),
    ("cookie", c_uint),
]
ndl_frame._fields_ = [
    ("m1", sb_vec3),
    ("m2", sb_vec3),
    ("t", sb_vec3),
]
ndl_rod_energy._fields_ = [
    ("stretch", c_double),
    ("bend", c_double),
    ("twist", c_double),
    ("kinetic", c_double),
    ("grip", c_double),
]
ndl_surface_hit._fields_ = [
    ("tet", c_int),
    ("face", c_int),
    ("along", c_double),
    ("X", sb_vec3),
]
ndl_remesh_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("max_needles", c_int),
    ("interfaces", c_int),
    ("smooth_below", c_double),
    ("release_above", c_double),
    ("max_smoothed", c_int),
    ("entry_slip", c_double),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
ndl_remesh_info._fields_ = [
    ("operation", c_int),
    ("undone", c_int),
    ("substeps", c_int),
    ("candidates", c_int),
    ("smoothed", c_int),
    ("released", c_int),
    ("outside", c_int),
    ("worst_quality", c_double),
    ("X", sb_vec3),
]
ndl_tip_pose._fields_ = [
    ("position", sb_vec3),
    ("frame", ndl_frame),
]
ndl_bevel._fields_ = [
    ("law", c_int),
    ("angle", c_double),
    ("curvature", c_double),
    ("guide", c_double),
    ("lag", c_double),
]
ndl_obstacle._fields_ = [
    ("kind", c_int),
    ("a", sb_vec3),
    ("b", sb_vec3),
    ("radius", c_double),
    ("shape", POINTER(sb_shape)),
]
ndl_plan_piece._fields_ = [
    ("turn", c_double),
    ("twist", c_double),
    ("length", c_double),
]
ndl_plan._fields_ = [
    ("outcome", c_int),
    ("piece_count", c_int),
    ("pieces", ndl_plan_piece * 3),
    ("length", c_double),
    ("distance", c_double),
    ("bound", c_double),
    ("clearance", c_double),
    ("boxes", c_int),
]
ndl_plan_def._fields_ = [
    ("curvature", c_double),
    ("max_length", c_double),
    ("max_twist", c_double),
    ("turn", c_int),
    ("tolerance", c_double),
    ("max_boxes", c_int),
    ("obstacles", POINTER(ndl_obstacle)),
    ("obstacle_count", c_int),
    ("clearance", c_double),
    ("max_pieces", c_int),
    ("samples", c_int),
    ("cookie", c_uint),
]
ndl_steer_command._fields_ = [
    ("status", c_int),
    ("insertion", c_double),
    ("turn", c_double),
    ("distance", c_double),
    ("expected", c_double),
]
ndl_steer_def._fields_ = [
    ("plan", ndl_plan_def),
    ("reserve", c_double),
    ("step", c_double),
    ("max_turn", c_double),
    ("turn_gain", c_double),
    ("turn_first", c_double),
    ("max_wait", c_int),
    ("reach", c_double),
    ("max_updates", c_int),
    ("learn", c_double),
    ("cookie", c_uint),
]
ndl_steer._fields_ = [
    ("def", ndl_steer_def),
    ("status", c_int),
    ("inserted", c_double),
    ("updates", c_int),
    ("plans", c_int),
    ("waited", c_int),
    ("next_search", c_int),
    ("waypoint_count", c_int),
    ("waypoints", sb_vec3 * 2),
    ("plan", ndl_plan),
    ("curvature", c_double),
    ("drift", sb_vec3),
    ("tip", ndl_tip_pose),
    ("way", sb_vec3),
    ("first", sb_vec3),
    ("advance", c_double),
    ("weight", c_double),
    ("bends", c_int),
]
ndl_push_def._fields_ = [
    ("compliance", sb_mat3),
    ("line_point", sb_vec3),
    ("line_direction", sb_vec3),
    ("clear_radius", c_double),
    ("direction", sb_vec3),
    ("cone", c_double),
    ("max_force", c_double),
    ("proportional", c_double),
    ("integral", c_double),
    ("max_rate", c_double),
    ("tolerance", c_double),
    ("cookie", c_uint),
]
ndl_push._fields_ = [
    ("def", ndl_push_def),
    ("integral", sb_vec3),
    ("force", sb_vec3),
    ("error", sb_vec3),
    ("arrived", c_int),
    ("limited", c_int),
]
ndl_push_place._fields_ = [
    ("direction", sb_vec3),
    ("cone", c_double),
    ("max_force", c_double),
    ("weight", c_double),
]
ndl_guide_def._fields_ = [
    ("target", sb_vec3),
    ("entry", sb_vec3),
    ("direction", sb_vec3),
    ("entry_radius", c_double),
    ("max_lean", c_double),
    ("shift", c_double),
    ("obstacles", POINTER(ndl_obstacle)),
    ("obstacle_count", c_int),
    ("clearance", c_double),
    ("places", POINTER(ndl_push_place)),
    ("place_count", c_int),
    ("model", CFUNCTYPE(c_int, c_void_p, sb_vec3, c_int, POINTER(sb_mat3))),
    ("user", c_void_p),
    ("tolerance", c_double),
    ("samples", c_int),
    ("climbs", c_int),
    ("seed", c_uint),
    ("cookie", c_uint),
]
ndl_guide_phase._fields_ = [
    ("push", ndl_push_def),
    ("point", sb_vec3),
    ("obstacle", c_int),
    ("place", c_int),
    ("force", sb_vec3),
    ("depth", c_double),
    ("left", c_double),
]
ndl_guide._fields_ = [
    ("reaches", c_int),
    ("entry", sb_vec3),
    ("direction", sb_vec3),
    ("length", c_double),
    ("clearance", c_double),
    ("cost", c_double),
    ("phase_count", c_int),
    ("phases", ndl_guide_phase * 8),
]
ndl_couple_info._fields_ = [
    ("trials", c_int),
    ("consistent", c_int),
    ("iterations", c_int),
    ("capped", c_int),
    ("residual", c_double),
]
ndl_friction._fields_ = [
    ("friction", c_double),
    ("viscous", c_double),
    ("cutting", c_double),
    ("twist_stiffness", c_double),
    ("twist_friction", c_double),
]
ndl_membrane._fields_ = [
    ("regions", c_int * 2),
    ("strength", c_double),
    ("thickness", c_double),
]
ndl_needle_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("follow", c_int),
    ("base", sb_vec3),
    ("direction", sb_vec3),
    ("director", sb_vec3),
    ("length", c_double),
    ("edge_length", c_double),
    ("capacity", c_int),
    ("section", ndl_rod_section),
    ("stiffness", POINTER(ndl_rod_stiffness)),
    ("damping_stretch", c_double),
    ("damping_bending", c_double),
    ("gravity", sb_vec3),
    ("bevel", ndl_bevel),
    ("bend_length", c_double),
    ("bend_curvature", c_double),
    ("frictions", POINTER(ndl_friction)),
    ("friction_count", c_int),
    ("membranes", POINTER(ndl_membrane)),
    ("membrane_count", c_int),
    ("cutting", CFUNCTYPE(c_double, c_void_p, sb_vec3, c_int)),
    ("cutting_user", c_void_p),
    ("entry_slip", c_double),
    ("max_trials", c_int),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
ndl_command._fields_ = [
    ("insertion", c_double),
    ("twist", c_double),
    ("velocity", sb_vec3),
    ("angular_velocity", sb_vec3),
]
ndl_step_info._fields_ = [
    ("substeps", c_int),
    ("peak_base", c_double),
    ("trials", c_int),
    ("consistent", c_int),
    ("iterations", c_int),
    ("capped", c_int),
    ("residual", c_double),
    ("static_nodes", c_int),
    ("dynamic_nodes", c_int),
    ("operations", c_int),
    ("worst_quality", c_double),
    ("blocked", c_int),
    ("torn", c_int),
    ("limited", c_int),
    ("coarse", c_int),
    ("body", sb_step_info),
    ("seconds_body", c_double),
    ("seconds_couple", c_double),
    ("seconds_needle", c_double),
    ("seconds_remesh", c_double),
    ("seconds_total", c_double),
]
reg_rigid._fields_ = [
    ("rotation", sb_mat3),
    ("translation", sb_vec3),
]
reg_cloud._fields_ = [
    ("points", POINTER(sb_vec3)),
    ("normals", POINTER(sb_vec3)),
    ("count", c_int),
    ("allocator", sb_allocator),
]
reg_smooth_info._fields_ = [
    ("noise", c_double),
    ("left", c_double),
    ("outliers", c_int),
]
reg_field_def._fields_ = [
    ("kind", c_int),
    ("surface", POINTER(sb_mesh)),
    ("points", POINTER(sb_vec3)),
    ("normals", POINTER(sb_vec3)),
    ("point_count", c_int),
    ("low", sb_vec3),
    ("high", sb_vec3),
    ("cells", c_int),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("cookie", c_uint),
]
reg_field_hit._fields_ = [
    ("point", sb_vec3),
    ("normal", sb_vec3),
    ("distance", c_double),
    ("item", c_int),
    ("on_border", c_int),
]
reg_field_sample._fields_ = [
    ("phi", c_double),
    ("phi_n", c_double),
    ("phi_nn", c_double),
]
reg_icp_shape._fields_ = [
    ("points", POINTER(sb_vec3)),
    ("count", c_int),
    ("normals", POINTER(sb_vec3)),
    ("weights", POINTER(c_double)),
    ("sd", POINTER(c_double)),
    ("surface", POINTER(sb_surface)),
    ("tree", POINTER(reg_kdtree)),
    ("has_camera", c_int),
    ("camera", sb_vec3),
]
reg_icp_landmark._fields_ = [
    ("model", sb_vec3),
    ("target", sb_vec3),
    ("weight", c_double),
]
reg_icp_options._fields_ = [
    ("overlap", c_int),
    ("metric", c_int),
    ("search", c_int),
    ("start", reg_rigid),
    ("start_shift_sd", c_double),
    ("start_turn_sd", c_double),
    ("seen_from", sb_vec3),
    ("seen_from_sd", c_double),
    ("landmarks", POINTER(reg_icp_landmark)),
    ("landmark_count", c_int),
    ("outliers", c_int),
    ("outlier_parameter", c_double),
    ("max_distance", c_double),
    ("sample", c_int),
    ("max_iterations", c_int),
    ("tolerance", c_double),
    ("clock", CFUNCTYPE(c_double)),
    ("max_seconds", c_double),
    ("allocator", sb_allocator),
    ("cookie", c_int),
]
reg_icp_info._fields_ = [
    ("stop", c_int),
    ("iterations", c_int),
    ("candidates", c_int),
    ("pairs", c_int),
    ("overlap", c_double),
    ("mean", c_double),
    ("rms", c_double),
    ("landmark_rms", c_double),
    ("seconds", c_double),
    ("warnings", c_uint),
    ("pose_count", c_int),
    ("poses", reg_rigid * 8),
    ("likelihood", c_double * 8),
    ("margin", c_double),
    ("noise", c_double),
    ("seen", c_double),
    ("scale_guess", c_double),
    ("covariance", c_double * 36),
    ("centre", sb_vec3),
]
reg_cpd_info._fields_ = [
    ("iterations", c_int),
    ("rank", c_int),
    ("stop", c_int),
    ("sigma", c_double),
    ("explained", c_double),
    ("change", c_double),
    ("objective", c_double),
    ("pairs", c_double),
    ("seconds", c_double),
    ("kernel_seconds", c_double),
]
reg_cpd_options._fields_ = [
    ("kind", c_int),
    ("outliers", c_double),
    ("beta", c_double),
    ("lambda", c_double),
    ("shared_frame", c_int),
    ("start_sigma", c_double),
    ("kernel_tolerance", c_double),
    ("max_rank", c_int),
    ("sum_tolerance", c_double),
    ("tolerance", c_double),
    ("max_iterations", c_int),
    ("max_seconds", c_double),
    ("max_pairs", c_double),
    ("landmark_count", c_int),
    ("landmark_points", POINTER(c_int)),
    ("landmark_targets", POINTER(sb_vec3)),
    ("landmark_sigma", c_double),
    ("progress", CFUNCTYPE(c_int, c_void_p, POINTER(reg_cpd_info))),
    ("progress_user", c_void_p),
    ("clock", CFUNCTYPE(c_double)),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("cookie", c_uint),
]
reg_match_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("surface", POINTER(sb_mesh)),
    ("target", POINTER(sb_mesh)),
    ("target_points", POINTER(sb_vec3)),
    ("target_normals", POINTER(sb_vec3)),
    ("target_count", c_int),
    ("method", c_int),
    ("cells", c_int),
    ("partial", c_int),
    ("reach", c_double),
    ("last_reach", c_double),
    ("least_cosine", c_double),
    ("least_active", c_double),
    ("sampling", c_double),
    ("first_charge", c_double),
    ("last_charge", c_double),
    ("least_growth", c_double),
    ("most_growth", c_double),
    ("landmarks", POINTER(sb_vec3)),
    ("landmark_targets", POINTER(sb_vec3)),
    ("landmark_count", c_int),
    ("landmark_stiffness", c_double),
    ("settled", c_double),
    ("max_seconds", c_double),
    ("clock", CFUNCTYPE(c_double)),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
reg_match_info._fields_ = [
    ("iterations", c_int),
    ("stop", c_int),
    ("mean_distance", c_double),
    ("max_distance", c_double),
    ("landmark_distance", c_double),
    ("active", c_double),
    ("charge", c_double),
    ("change", c_double),
    ("pcg_iterations", c_int),
    ("seconds", c_double),
    ("seconds_field", c_double),
    ("seconds_system", c_double),
    ("seconds_solve", c_double),
    ("error", sb_error),
]
reg_match_sample._fields_ = [
    ("point", sb_vec3),
    ("area", c_double),
    ("distance", c_double),
    ("active", c_int),
]
reg_nicp_def._fields_ = [
    ("body", POINTER(sb_body)),
    ("grid", POINTER(sb_grid)),
    ("surface", POINTER(sb_mesh)),
    ("sources", c_int),
    ("target", POINTER(sb_mesh)),
    ("target_points", POINTER(sb_vec3)),
    ("target_normals", POINTER(sb_vec3)),
    ("target_count", c_int),
    ("samples", c_int),
    ("view", c_int),
    ("camera", sb_vec3),
    ("blending", c_double),
    ("sliding", c_double),
    ("noisy", c_int),
    ("least_cosine", c_double),
    ("outliers", c_int),
    ("outlier_parameter", c_double),
    ("reach", c_double),
    ("last_reach", c_double),
    ("first_stiffness", c_double),
    ("last_stiffness", c_double),
    ("increments", c_int),
    ("iterations", c_int),
    ("newton", c_int),
    ("newton_tolerance", c_double),
    ("tolerance", c_double),
    ("least_active", c_double),
    ("landmarks", POINTER(sb_vec3)),
    ("landmark_targets", POINTER(sb_vec3)),
    ("landmark_count", c_int),
    ("landmark_stiffness", c_double),
    ("max_seconds", c_double),
    ("clock", CFUNCTYPE(c_double)),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
reg_nicp_info._fields_ = [
    ("iterations", c_int),
    ("increment", c_int),
    ("stop", c_int),
    ("mean_distance", c_double),
    ("max_distance", c_double),
    ("landmark_distance", c_double),
    ("active", c_double),
    ("visible", c_int),
    ("pruned", c_int),
    ("stiffness", c_double),
    ("change", c_double),
    ("newton_iterations", c_int),
    ("pcg_iterations", c_int),
    ("seconds", c_double),
    ("seconds_pairs", c_double),
    ("seconds_solve", c_double),
    ("error", sb_error),
]
reg_nicp_source._fields_ = [
    ("vertex", c_int),
    ("point", sb_vec3),
    ("goal", sb_vec3),
    ("area", c_double),
    ("distance", c_double),
    ("visible", c_int),
    ("active", c_int),
]
reg_loads_def._fields_ = [
    ("match", POINTER(reg_match)),
    ("samples", c_int),
    ("rounds", c_int),
    ("reweights", c_int),
    ("misfit", c_double),
    ("power", c_double),
    ("floor", c_double),
    ("landmark", c_double),
    ("drag", c_double),
    ("pose", c_double),
    ("max_seconds", c_double),
    ("clock", CFUNCTYPE(c_double)),
    ("allocator", sb_allocator),
    ("cookie", c_uint),
]
reg_loads_info._fields_ = [
    ("rounds", c_int),
    ("mean_distance", c_double),
    ("sample_misfit", c_double),
    ("change", c_double),
    ("drag", sb_vec3),
    ("loaded", c_double),
    ("seconds", c_double),
    ("seconds_response", c_double),
    ("seconds_dense", c_double),
    ("error", sb_error),
]
reg_model_def._fields_ = [
    ("mesh", POINTER(sb_mesh)),
    ("surface", POINTER(sb_mesh)),
    ("poisson", c_double),
    ("fixed", POINTER(c_int)),
    ("fixed_count", c_int),
    ("allocator", sb_allocator),
    ("jobs", sb_jobs),
    ("cookie", c_uint),
]
reg_points._fields_ = [
    ("points", POINTER(sb_vec3)),
    ("normals", POINTER(sb_vec3)),
    ("sd", POINTER(c_double)),
    ("weights", POINTER(c_double)),
    ("count", c_int),
    ("surface", POINTER(sb_mesh)),
    ("has_camera", c_int),
    ("camera", sb_vec3),
]
reg_landmark._fields_ = [
    ("model", sb_vec3),
    ("seen", sb_vec3),
    ("sd", c_double),
]
reg_curve._fields_ = [
    ("model", POINTER(sb_vec3)),
    ("model_count", c_int),
    ("seen", POINTER(sb_vec3)),
    ("seen_count", c_int),
    ("sd", c_double),
]
reg_infer_def._fields_ = [
    ("model", POINTER(reg_model)),
    ("target", reg_points),
    ("landmarks", POINTER(reg_landmark)),
    ("landmark_count", c_int),
    ("curves", POINTER(reg_curve)),
    ("curve_count", c_int),
    ("start", reg_rigid),
    ("start_sd", c_double),
    ("start_turn", c_double),
    ("gravity", c_int),
    ("pressed", POINTER(c_double)),
    ("samples", c_int),
    ("rounds", c_int),
    ("max_seconds", c_double),
    ("clock", CFUNCTYPE(c_double)),
    ("cookie", c_uint),
]
reg_quality._fields_ = [
    ("stop", c_int),
    ("warnings", c_uint),
    ("prior", c_int),
    ("prior_margin", c_double),
    ("pressure_margin", c_double),
    ("pressure", c_double),
    ("belief", c_double),
    ("sure", c_double),
    ("seen", c_double),
    ("used", c_double),
    ("noise", c_double),
    ("misfit", c_double),
    ("residual", c_double),
    ("residual_p95", c_double),
    ("expected", c_double),
    ("expected_worst", c_double),
    ("pose_sd", c_double * 2),
    ("largest_strain", c_double),
    ("volume_ratio", c_double),
    ("change", c_double),
    ("rounds", c_int),
    ("seconds", c_double),
    ("seconds_response", c_double),
    ("seconds_choice", c_double),
    ("seconds_draws", c_double),
]
reg_track_def._fields_ = [
    ("model", POINTER(reg_model)),
    ("start", POINTER(reg_infer)),
    ("pose", reg_rigid),
    ("pose_sd", c_double),
    ("pose_turn", c_double),
    ("modes", c_int),
    ("patches", c_int),
    ("most_points", c_int),
    ("motion", c_double),
    ("memory", c_double),
    ("wander", c_double),
    ("turn", c_double),
    ("misfit", c_double),
    ("lost_after", c_double),
    ("landmarks", POINTER(reg_landmark)),
    ("landmark_count", c_int),
    ("curves", POINTER(reg_curve)),
    ("curve_count", c_int),
    ("clock", CFUNCTYPE(c_double)),
    ("cookie", c_uint),
]
reg_track_info._fields_ = [
    ("state", c_int),
    ("time", c_double),
    ("blind", c_double),
    ("seen", c_double),
    ("used", c_double),
    ("noise", c_double),
    ("trusted", c_double),
    ("residual", c_double),
    ("innovation", c_double),
    ("expected", c_double),
    ("seconds", c_double),
    ("error", sb_error),
]


FUNCTIONS = {  # name: (what it returns, parameters)
    "sb_result_string": (c_char_p, (c_int, )),
    "sb_output_open": (c_int, (POINTER(sb_output), c_char_p, POINTER(sb_error), )),
    "sb_output_close": (c_int, (POINTER(sb_output), POINTER(sb_error), )),
    "sb_output_discard": (None, (POINTER(sb_output), )),
    "sb_file_save": (c_int, (c_char_p, c_void_p, c_size_t, POINTER(sb_error), )),
    "sb_mapping_apply": (None, (POINTER(sb_mapping), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "sb_mapping_spread": (None, (POINTER(sb_mapping), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "sb_element_name": (c_char_p, (c_int, )),
    "sb_element_face": (c_int, (c_int, c_int, POINTER(c_int), POINTER(c_int), )),
    "sb_element_edge": (c_int, (c_int, c_int, POINTER(c_int), )),
    "sb_element_node_point": (c_int, (c_int, c_int, POINTER(c_double), )),
    "sb_element_shape": (None, (c_int, POINTER(c_double), POINTER(c_double), POINTER(c_double * 3), )),
    "sb_element_quadrature": (c_int, (c_int, c_int, POINTER(c_double * 3), POINTER(c_double), )),
    "sb_element_table_check": (c_int, (POINTER(sb_element_table), POINTER(sb_error), )),
    "sb_mesh_free": (None, (POINTER(sb_mesh), )),
    "sb_mesh_copy": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_append": (c_int, (POINTER(sb_mesh), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_validate": (c_int, (POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_check": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_mesh_report), POINTER(sb_error), )),
    "sb_mesh_report_free": (None, (POINTER(sb_mesh_report), )),
    "sb_mesh_element_volume": (c_double, (POINTER(sb_mesh), c_int, )),
    "sb_mesh_volume": (c_double, (POINTER(sb_mesh), )),
    "sb_mesh_surface_area": (c_double, (POINTER(sb_mesh), )),
    "sb_mesh_bounds": (None, (POINTER(sb_mesh), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "sb_mesh_element_quality": (c_double, (POINTER(sb_mesh), c_int, )),
    "sb_mesh_dihedral_range": (None, (POINTER(sb_mesh), POINTER(c_double), POINTER(c_double), )),
    "sb_mesh_orient": (c_int, (POINTER(sb_mesh), POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_orient_surface": (c_int, (POINTER(sb_mesh), POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_merge_nodes": (c_int, (POINTER(sb_mesh), c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_remove_unreferenced": (c_int, (POINTER(sb_mesh), POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_remove_duplicate_elements": (c_int, (POINTER(sb_mesh), POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_scale": (c_int, (POINTER(sb_mesh), c_double, POINTER(sb_error), )),
    "sb_index_table_free": (None, (POINTER(sb_index_table), )),
    "sb_index_lists_free": (None, (POINTER(sb_index_lists), )),
    "sb_boundary_free": (None, (POINTER(sb_boundary), )),
    "sb_mesh_boundary": (c_int, (POINTER(sb_mesh), c_int, POINTER(sb_allocator), POINTER(sb_boundary), POINTER(sb_error), )),
    "sb_mesh_neighbours": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_index_table), POINTER(sb_error), )),
    "sb_mesh_edges": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_index_table), POINTER(sb_error), )),
    "sb_mesh_node_elements": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_index_lists), POINTER(sb_error), )),
    "sb_mesh_components": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_index_table), POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_to_tet10": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_to_hex20": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_to_hex27": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_reorder": (c_int, (POINTER(sb_mesh), POINTER(c_int), POINTER(c_int), POINTER(sb_error), )),
    "sb_mesh_beam": (c_int, (c_int, c_int, c_int, c_int, sb_vec3, POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_cylinder": (c_int, (c_int, c_int, c_double, c_double, c_int, c_int, POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_ellipsoid": (c_int, (c_int, sb_vec3, c_int, POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_organ": (c_int, (c_int, c_int, POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_sets_free": (None, (POINTER(sb_mesh_sets), )),
    "sb_mesh_sets_find": (POINTER(sb_mesh_set), (POINTER(sb_mesh_sets), c_char_p, c_int, )),
    "sb_default_load_options": (sb_load_options, ()),
    "sb_mesh_load": (c_int, (POINTER(sb_mesh), c_char_p, POINTER(sb_load_options), POINTER(sb_error), )),
    "sb_mesh_load_memory": (c_int, (POINTER(sb_mesh), c_void_p, c_size_t, c_int, c_char_p, POINTER(sb_load_options), POINTER(sb_error), )),
    "sb_mesh_save_vtk": (c_int, (c_char_p, POINTER(sb_mesh), POINTER(sb_field), c_int, POINTER(sb_error), )),
    "sb_mesh_save_vtk_binary": (c_int, (c_char_p, POINTER(sb_mesh), POINTER(sb_field), c_int, POINTER(sb_error), )),
    "sb_mesh_save_obj": (c_int, (c_char_p, POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_save_stl": (c_int, (c_char_p, POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_mesh_save_ply": (c_int, (c_char_p, POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_image_load": (c_int, (POINTER(sb_image), c_char_p, POINTER(sb_load_options), POINTER(sb_error), )),
    "sb_image_load_memory": (c_int, (POINTER(sb_image), c_void_p, c_size_t, c_char_p, POINTER(sb_load_options), POINTER(sb_error), )),
    "sb_image_is_file": (c_int, (c_char_p, )),
    "sb_image_free": (None, (POINTER(sb_image), )),
    "sb_image_check": (c_int, (POINTER(sb_image), POINTER(sb_error), )),
    "sb_image_next_label": (c_int, (POINTER(sb_image), c_int, POINTER(c_int), )),
    "sb_image_label_at": (c_int, (POINTER(sb_image), sb_vec3, )),
    "sb_default_label_def": (sb_label_def, ()),
    "sb_image_surface": (c_int, (POINTER(sb_label_def), POINTER(sb_mesh), POINTER(sb_label_report), POINTER(sb_error), )),
    "sb_image_set_regions": (c_int, (POINTER(sb_image), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_surface_create": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(POINTER(sb_surface)), POINTER(sb_error), )),
    "sb_surface_destroy": (None, (POINTER(sb_surface), )),
    "sb_surface_move": (c_int, (POINTER(sb_surface), POINTER(sb_vec3), POINTER(sb_jobs), POINTER(sb_error), )),
    "sb_surface_node_count": (c_int, (POINTER(sb_surface), )),
    "sb_surface_triangle_count": (c_int, (POINTER(sb_surface), )),
    "sb_surface_triangle": (c_int, (POINTER(sb_surface), c_int, POINTER(c_int), )),
    "sb_surface_bounds": (None, (POINTER(sb_surface), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "sb_surface_is_closed": (c_int, (POINTER(sb_surface), )),
    "sb_surface_bytes": (c_size_t, (POINTER(sb_surface), )),
    "sb_surface_closest": (c_int, (POINTER(sb_surface), sb_vec3, c_double, POINTER(sb_surface_hit), )),
    "sb_surface_closest_from": (c_int, (POINTER(sb_surface), sb_vec3, c_double, c_int, POINTER(sb_surface_hit), )),
    "sb_surface_ray": (c_int, (POINTER(sb_surface), sb_vec3, sb_vec3, c_double, POINTER(sb_surface_hit), )),
    "sb_surface_ray_all": (c_int, (POINTER(sb_surface), sb_vec3, sb_vec3, c_double, POINTER(sb_surface_hit), c_int, )),
    "sb_surface_signed_distance": (c_double, (POINTER(sb_surface), sb_vec3, POINTER(sb_surface_hit), )),
    "sb_surface_signed_distance_winding": (c_double, (POINTER(sb_surface), sb_vec3, POINTER(sb_surface_hit), )),
    "sb_surface_winding_number": (c_double, (POINTER(sb_surface), sb_vec3, )),
    "sb_surface_winding_number_exact": (c_double, (POINTER(sb_surface), sb_vec3, )),
    "sb_surface_inside": (c_int, (POINTER(sb_surface), sb_vec3, )),
    "sb_surface_normal": (sb_vec3, (POINTER(sb_surface), POINTER(sb_surface_hit), )),
    "sb_surface_closest_batch": (None, (POINTER(sb_surface), POINTER(sb_vec3), c_int, c_double, POINTER(sb_surface_hit), POINTER(sb_jobs), )),
    "sb_surface_signed_distance_batch": (None, (POINTER(sb_surface), POINTER(sb_vec3), c_int, POINTER(c_double), POINTER(sb_surface_hit), POINTER(sb_jobs), )),
    "sb_surface_signed_distance_winding_batch": (None, (POINTER(sb_surface), POINTER(sb_vec3), c_int, POINTER(c_double), POINTER(sb_surface_hit), POINTER(sb_jobs), )),
    "sb_surface_winding_number_batch": (None, (POINTER(sb_surface), POINTER(sb_vec3), c_int, POINTER(c_double), POINTER(sb_jobs), )),
    "sb_surface_inside_batch": (None, (POINTER(sb_surface), POINTER(sb_vec3), c_int, POINTER(c_ubyte), POINTER(sb_jobs), )),
    "sb_surface_check": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_surface_report), POINTER(sb_error), )),
    "sb_surface_check_string": (c_char_p, (c_int, )),
    "sb_surface_require": (c_int, (POINTER(sb_mesh), c_int, POINTER(sb_allocator), POINTER(sb_surface_report), POINTER(sb_error), )),
    "sb_surface_triangulate": (c_int, (POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_default_surface_repair": (sb_surface_repair_def, ()),
    "sb_surface_repair": (c_int, (POINTER(sb_mesh), POINTER(sb_surface_repair_def), POINTER(sb_surface_repair_report), POINTER(sb_error), )),
    "sb_default_stuff_def": (sb_stuff_def, ()),
    "sb_mesh_stuff": (c_int, (POINTER(sb_stuff_def), POINTER(sb_mesh), POINTER(sb_stuff_report), POINTER(sb_error), )),
    "sb_material_linear": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_corotated": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_corotated_invertible": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_svk": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_neo_hookean": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_stable_neo_hookean": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_neo_hookean_isochoric": (sb_material, (c_double, c_double, c_double, )),
    "sb_material_mooney_rivlin": (sb_material, (c_double, c_double, c_double, c_double, )),
    "sb_material_reduced_polynomial": (sb_material, (c_double, c_double, c_double, c_double, c_double, )),
    "sb_material_ogden": (sb_material, (POINTER(c_double), POINTER(c_double), c_int, c_double, c_double, )),
    "sb_material_fung": (sb_material, (c_double, c_double, c_double, c_double, )),
    "sb_material_custom": (sb_material, (POINTER(sb_material_law), c_double, c_double, )),
    "sb_material_with_fibres": (sb_material, (sb_material, c_double, c_double, )),
    "sb_material_with_dispersion": (sb_material, (sb_material, c_double, )),
    "sb_material_with_contraction": (sb_material, (sb_material, c_double, c_double, c_double, )),
    "sb_material_with_prestretch": (sb_material, (sb_material, sb_mat3, )),
    "sb_material_with_prony": (sb_material, (sb_material, POINTER(c_double), POINTER(c_double), c_int, )),
    "sb_material_preset": (sb_material, (c_int, c_double, )),
    "sb_material_young": (c_double, (POINTER(sb_material), )),
    "sb_material_poisson": (c_double, (POINTER(sb_material), )),
    "sb_material_bulk": (c_double, (POINTER(sb_material), )),
    "sb_material_check": (c_int, (POINTER(sb_material), POINTER(sb_error), )),
    "sb_material_allows_inversion": (c_int, (c_int, )),
    "sb_material_is_linear": (c_int, (c_int, )),
    "sb_material_is_hyperelastic": (c_int, (c_int, )),
    "sb_material_energy": (c_int, (POINTER(sb_material), POINTER(sb_mat3), POINTER(sb_quat), POINTER(c_double), )),
    "sb_material_stress": (c_int, (POINTER(sb_material), POINTER(sb_mat3), POINTER(sb_quat), POINTER(sb_mat3), )),
    "sb_material_tangent": (c_int, (POINTER(sb_material), POINTER(sb_mat3), POINTER(sb_quat), c_int, POINTER(c_double), )),
    "sb_fibre_energy": (c_int, (POINTER(sb_material), POINTER(sb_mat3), sb_vec3, POINTER(c_double), )),
    "sb_fibre_stress": (c_int, (POINTER(sb_material), POINTER(sb_mat3), sb_vec3, POINTER(sb_mat3), )),
    "sb_fibre_tangent": (c_int, (POINTER(sb_material), POINTER(sb_mat3), sb_vec3, POINTER(c_double), )),
    "sb_material_relaxation": (c_double, (POINTER(sb_material), c_double, )),
    "sb_material_shear_moduli": (None, (POINTER(sb_material), c_double, POINTER(c_double), POINTER(c_double), )),
    "sb_material_history_stress": (c_int, (POINTER(sb_material), POINTER(sb_material_history), POINTER(sb_mat3), c_double, POINTER(sb_vec3), POINTER(sb_mat3), )),
    "sb_cauchy_stress": (sb_mat3, (sb_mat3, sb_mat3, )),
    "sb_material_cauchy_stress": (sb_mat3, (POINTER(sb_material), sb_mat3, sb_mat3, )),
    "sb_von_mises": (c_double, (sb_mat3, )),
    "sb_default_fit_options": (sb_fit_options, ()),
    "sb_material_fit": (c_int, (c_int, POINTER(sb_test_point), c_int, POINTER(sb_fit_options), POINTER(sb_material), POINTER(sb_fit_info), POINTER(sb_error), )),
    "sb_material_fit_prony": (c_int, (POINTER(c_double), POINTER(c_double), c_int, POINTER(c_double), c_int, POINTER(sb_material), POINTER(sb_fit_info), POINTER(sb_error), )),
    "sb_material_fit_moduli": (c_int, (POINTER(c_double), POINTER(c_double), POINTER(c_double), c_int, POINTER(c_double), c_int, POINTER(sb_material), POINTER(sb_fit_info), POINTER(sb_error), )),
    "sb_matrix_create": (c_int, (c_int, c_int, c_int, POINTER(c_int), POINTER(c_int), POINTER(sb_allocator), POINTER(sb_matrix), POINTER(sb_error), )),
    "sb_matrix_free": (None, (POINTER(sb_matrix), )),
    "sb_matrix_clear": (None, (POINTER(sb_matrix), )),
    "sb_matrix_find": (c_int, (POINTER(sb_matrix), c_int, c_int, )),
    "sb_matrix_multiply": (None, (POINTER(sb_matrix), POINTER(c_double), POINTER(c_double), POINTER(sb_jobs), )),
    "sb_matrix_asymmetry": (c_double, (POINTER(sb_matrix), )),
    "sb_matrix_diagonal_scale": (c_double, (POINTER(sb_matrix), POINTER(c_ubyte), )),
    "sb_matrix_constrain": (None, (POINTER(sb_matrix), POINTER(c_ubyte), POINTER(c_double), POINTER(c_double), )),
    "sb_default_direct_def": (sb_direct_def, ()),
    "sb_direct_create": (c_int, (POINTER(sb_direct_def), POINTER(sb_matrix), POINTER(sb_allocator), POINTER(POINTER(sb_direct)), POINTER(sb_error), )),
    "sb_direct_free": (None, (POINTER(sb_direct), )),
    "sb_direct_update": (c_int, (POINTER(sb_direct), POINTER(sb_matrix), POINTER(sb_error), )),
    "sb_direct_solve": (c_int, (POINTER(sb_direct), POINTER(c_double), POINTER(c_double), c_int, )),
    "sb_direct_get_info": (sb_direct_info, (POINTER(sb_direct), )),
    "sb_domain_create": (c_int, (POINTER(sb_mesh), c_int, c_int, POINTER(sb_allocator), POINTER(sb_domain), POINTER(sb_error), )),
    "sb_domain_free": (None, (POINTER(sb_domain), )),
    "sb_solver_auto": (c_int, (POINTER(sb_matrix), )),
    "sb_precond_string": (c_char_p, (c_int, )),
    "sb_default_preconditioner_def": (sb_preconditioner_def, ()),
    "sb_preconditioner_moduli": (c_int, (POINTER(sb_matrix), c_int, c_int, POINTER(c_int), POINTER(c_double), POINTER(c_double), POINTER(sb_error), )),
    "sb_preconditioner_create": (c_int, (POINTER(sb_preconditioner_def), POINTER(sb_matrix), POINTER(sb_allocator), POINTER(POINTER(sb_preconditioner)), POINTER(sb_error), )),
    "sb_preconditioner_free": (None, (POINTER(sb_preconditioner), )),
    "sb_preconditioner_update": (c_int, (POINTER(sb_preconditioner), POINTER(sb_matrix), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_preconditioner_apply": (None, (POINTER(sb_preconditioner), POINTER(c_double), POINTER(c_double), )),
    "sb_preconditioner_warp": (c_int, (POINTER(sb_preconditioner), POINTER(sb_matrix), POINTER(sb_quat), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_preconditioner_saved_size": (c_size_t, (POINTER(sb_preconditioner), )),
    "sb_preconditioner_save": (c_int, (POINTER(sb_preconditioner), c_void_p, c_size_t, )),
    "sb_preconditioner_load": (c_int, (POINTER(sb_preconditioner), c_void_p, c_size_t, POINTER(sb_error), )),
    "sb_preconditioner_get_info": (sb_preconditioner_info, (POINTER(sb_preconditioner), )),
    "sb_default_pcg_options": (sb_pcg_options, ()),
    "sb_pcg_workspace_create": (c_int, (c_int, POINTER(sb_allocator), POINTER(sb_pcg_workspace), POINTER(sb_error), )),
    "sb_pcg_workspace_free": (None, (POINTER(sb_pcg_workspace), )),
    "sb_pcg_solve": (c_int, (POINTER(sb_matrix), POINTER(sb_preconditioner), POINTER(c_double), POINTER(c_double), POINTER(sb_pcg_options), POINTER(sb_pcg_workspace), POINTER(sb_pcg_info), )),
    "sb_default_grid_def": (sb_grid_def, ()),
    "sb_grid_create": (c_int, (POINTER(sb_grid_def), POINTER(sb_grid), POINTER(sb_error), )),
    "sb_grid_free": (None, (POINTER(sb_grid), )),
    "sb_grid_map_points": (c_int, (POINTER(sb_grid), POINTER(sb_vec3), c_int, POINTER(sb_allocator), POINTER(sb_grid_rows), POINTER(sb_error), )),
    "sb_grid_map_surface": (c_int, (POINTER(sb_grid), POINTER(sb_mesh), POINTER(c_int), c_int, POINTER(sb_allocator), POINTER(sb_grid_rows), POINTER(sb_error), )),
    "sb_grid_rows_free": (None, (POINTER(sb_grid_rows), )),
    "sb_grid_add_traction": (None, (POINTER(sb_grid_rows), POINTER(sb_vec3), c_int, POINTER(sb_vec3), )),
    "sb_default_mixture_def": (sb_mixture_def, ()),
    "sb_mixture_create": (c_int, (POINTER(sb_mixture_def), POINTER(sb_mixture), POINTER(sb_error), )),
    "sb_mixture_free": (None, (POINTER(sb_mixture), )),
    "sb_kernel_value": (c_double, (c_int, c_double, c_double, )),
    "sb_kernel_slope": (c_double, (c_int, c_double, c_double, )),
    "sb_default_particles_def": (sb_particles_def, ()),
    "sb_particles_create": (c_int, (POINTER(sb_particles_def), POINTER(sb_particles), POINTER(sb_error), )),
    "sb_particles_free": (None, (POINTER(sb_particles), )),
    "sb_particles_map_points": (c_int, (POINTER(sb_particles), POINTER(sb_vec3), c_int, POINTER(sb_allocator), POINTER(sb_grid_rows), POINTER(sb_error), )),
    "sb_particles_map_surface": (c_int, (POINTER(sb_particles), POINTER(sb_mesh), POINTER(c_int), c_int, POINTER(sb_allocator), POINTER(sb_grid_rows), POINTER(sb_error), )),
    "sb_particles_cut": (c_int, (POINTER(sb_particles), POINTER(sb_mesh), POINTER(sb_error), )),
    "sb_default_body_def": (sb_body_def, ()),
    "sb_body_create": (c_int, (POINTER(sb_body_def), POINTER(POINTER(sb_body)), POINTER(sb_error), )),
    "sb_body_destroy": (None, (POINTER(sb_body), )),
    "sb_body_node_count": (c_int, (POINTER(sb_body), )),
    "sb_body_element_count": (c_int, (POINTER(sb_body), )),
    "sb_body_point_count": (c_int, (POINTER(sb_body), )),
    "sb_body_matrix_blocks": (c_int, (POINTER(sb_body), )),
    "sb_body_patch_count": (c_int, (POINTER(sb_body), )),
    "sb_body_patch": (c_int, (POINTER(sb_body), c_int, )),
    "sb_body_solver": (sb_preconditioner_info, (POINTER(sb_body), )),
    "sb_body_slenderness": (c_double, (POINTER(sb_body), )),
    "sb_body_set_material": (c_int, (POINTER(sb_body), POINTER(sb_material), POINTER(sb_error), )),
    "sb_body_set_region_material": (c_int, (POINTER(sb_body), c_int, POINTER(sb_material), POINTER(sb_error), )),
    "sb_body_set_fibres": (c_int, (POINTER(sb_body), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_set_second_fibres": (c_int, (POINTER(sb_body), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_set_tension": (c_int, (POINTER(sb_body), c_int, c_double, POINTER(sb_error), )),
    "sb_body_set_gravity": (c_int, (POINTER(sb_body), sb_vec3, )),
    "sb_body_set_damping": (c_int, (POINTER(sb_body), c_double, c_double, )),
    "sb_body_set_region_damping": (c_int, (POINTER(sb_body), c_int, c_double, c_double, POINTER(sb_error), )),
    "sb_body_set_solver": (c_int, (POINTER(sb_body), c_double, c_int, )),
    "sb_body_keep_tangent": (c_int, (POINTER(sb_body), c_double, POINTER(sb_error), )),
    "sb_body_hold": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, POINTER(sb_error), )),
    "sb_body_place": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_place_rigid": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, sb_vec3, sb_vec3, sb_quat, POINTER(sb_error), )),
    "sb_body_release": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, POINTER(sb_error), )),
    "sb_body_fix_nodes": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, )),
    "sb_body_prescribe": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, POINTER(sb_vec3), c_int, )),
    "sb_body_release_nodes": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, )),
    "sb_body_supports": (POINTER(c_ubyte), (POINTER(sb_body), )),
    "sb_body_positions": (POINTER(sb_vec3), (POINTER(sb_body), )),
    "sb_body_displacements": (POINTER(sb_vec3), (POINTER(sb_body), )),
    "sb_body_velocities": (POINTER(sb_vec3), (POINTER(sb_body), )),
    "sb_body_set_displacements": (c_int, (POINTER(sb_body), POINTER(sb_vec3), )),
    "sb_body_set_velocities": (c_int, (POINTER(sb_body), POINTER(sb_vec3), )),
    "sb_body_reset": (None, (POINTER(sb_body), )),
    "sb_body_reactions": (POINTER(sb_vec3), (POINTER(sb_body), )),
    "sb_body_wrench": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, sb_vec3, POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_external_forces": (POINTER(sb_vec3), (POINTER(sb_body), )),
    "sb_body_energy": (c_int, (POINTER(sb_body), POINTER(sb_energy), )),
    "sb_body_multiply_stiffness": (c_int, (POINTER(sb_body), POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_multiply_tangent": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_stiffness_matrix": (c_int, (POINTER(sb_body), c_int, POINTER(POINTER(sb_matrix)), POINTER(sb_error), )),
    "sb_body_mass": (c_double, (POINTER(sb_body), )),
    "sb_body_momentum": (sb_vec3, (POINTER(sb_body), )),
    "sb_body_stress": (c_int, (POINTER(sb_body), c_int, c_int, POINTER(sb_mat3), )),
    "sb_body_von_mises": (None, (POINTER(sb_body), POINTER(c_double), )),
    "sb_body_nodal_von_mises": (None, (POINTER(sb_body), POINTER(c_double), )),
    "sb_body_nodal_rotations": (None, (POINTER(sb_body), POINTER(sb_quat), )),
    "sb_body_parts": (c_int, (POINTER(sb_body), POINTER(sb_part), c_int, POINTER(c_int), POINTER(c_int), )),
    "sb_body_check": (c_int, (POINTER(sb_body), POINTER(sb_check_report), )),
    "sb_check_string": (c_char_p, (c_uint, )),
    "sb_body_deformation": (c_int, (POINTER(sb_body), c_int, c_int, POINTER(sb_mat3), )),
    "sb_body_strain": (c_int, (POINTER(sb_body), c_int, c_int, POINTER(sb_mat3), )),
    "sb_body_nodal_tensors": (c_int, (POINTER(sb_body), c_int, POINTER(sb_mat3), POINTER(sb_error), )),
    "sb_body_region_tensors": (c_int, (POINTER(sb_body), c_int, c_int, POINTER(sb_mat3), POINTER(sb_error), )),
    "sb_body_energy_densities": (c_int, (POINTER(sb_body), POINTER(c_double), POINTER(sb_error), )),
    "sb_default_change_cell": (sb_change_cell, ()),
    "sb_body_change_begin": (c_int, (POINTER(sb_body), POINTER(POINTER(sb_body_change)), POINTER(sb_error), )),
    "sb_body_change_add_node": (c_int, (POINTER(sb_body_change), sb_vec3, POINTER(c_int), POINTER(c_double), c_int, c_int, POINTER(c_int), POINTER(sb_error), )),
    "sb_body_change_move_node": (c_int, (POINTER(sb_body_change), c_int, sb_vec3, POINTER(c_int), POINTER(c_double), c_int, POINTER(sb_error), )),
    "sb_body_change_remove_node": (c_int, (POINTER(sb_body_change), c_int, POINTER(c_int), POINTER(c_double), c_int, POINTER(sb_error), )),
    "sb_body_change_add_cell": (c_int, (POINTER(sb_body_change), POINTER(sb_change_cell), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_change_replace_cell": (c_int, (POINTER(sb_body_change), c_int, POINTER(sb_change_cell), POINTER(sb_error), )),
    "sb_body_change_remove_cell": (c_int, (POINTER(sb_body_change), c_int, POINTER(sb_error), )),
    "sb_body_change_commit": (c_int, (POINTER(sb_body_change), POINTER(sb_error), )),
    "sb_body_change_cancel": (None, (POINTER(sb_body_change), )),
    "sb_body_node_in_use": (c_int, (POINTER(sb_body), c_int, )),
    "sb_body_cell_in_use": (c_int, (POINTER(sb_body), c_int, )),
    "sb_body_cell_nodes": (POINTER(c_int), (POINTER(sb_body), c_int, )),
    "sb_body_cell_share": (c_double, (POINTER(sb_body), c_int, )),
    "sb_body_rest_positions": (POINTER(sb_vec3), (POINTER(sb_body), )),
    "sb_body_mesh_version": (c_int, (POINTER(sb_body), )),
    "sb_body_find_cell": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), )),
    "sb_body_get_mesh": (c_int, (POINTER(sb_body), POINTER(sb_allocator), POINTER(sb_mesh), POINTER(c_int), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_live_check": (c_int, (POINTER(sb_body), POINTER(sb_error), )),
    "sb_body_listen": (c_int, (POINTER(sb_body), POINTER(sb_body_listener), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_unlisten": (c_int, (POINTER(sb_body), c_int, )),
    "sb_body_apply_forces": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, POINTER(sb_vec3), c_int, POINTER(sb_error), )),
    "sb_body_add_forces": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, POINTER(sb_vec3), c_int, )),
    "sb_body_add_traction": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, sb_vec3, POINTER(sb_error), )),
    "sb_body_clear_loads": (None, (POINTER(sb_body), )),
    "sb_body_add_pressure": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_body_set_pressure": (c_int, (POINTER(sb_body), c_int, c_double, )),
    "sb_body_add_springs": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, POINTER(c_double), c_int, POINTER(sb_vec3), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_move_springs": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_body_set_spring_stiffness": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), c_int, )),
    "sb_body_add_mapping": (c_int, (POINTER(sb_body), POINTER(sb_mapping), POINTER(c_double), c_int, POINTER(sb_vec3), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_set_mapping_targets": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_body_set_mapping_stiffness": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), c_int, )),
    "sb_body_mapping_points": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_body_remove_load": (c_int, (POINTER(sb_body), c_int, )),
    "sb_body_load_force": (c_int, (POINTER(sb_body), c_int, sb_vec3, POINTER(sb_vec3), POINTER(sb_vec3), )),
    "sb_body_spring_forces": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_body_mapping_forces": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_default_cable_def": (sb_cable_def, ()),
    "sb_body_add_cable": (c_int, (POINTER(sb_body), POINTER(sb_cable_def), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_set_cable_rest_length": (c_int, (POINTER(sb_body), c_int, c_double, )),
    "sb_body_set_cable_stiffness": (c_int, (POINTER(sb_body), c_int, c_double, )),
    "sb_body_move_cable": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_body_cable_tension": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), )),
    "sb_body_cable_length": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), )),
    "sb_body_cable_points": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_body_cable_forces": (c_int, (POINTER(sb_body), c_int, POINTER(sb_vec3), )),
    "sb_default_membrane_def": (sb_membrane_def, ()),
    "sb_body_add_membrane": (c_int, (POINTER(sb_body), POINTER(sb_membrane_def), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_set_membrane": (c_int, (POINTER(sb_body), c_int, c_double, c_double, c_double, )),
    "sb_body_membrane_faces": (c_int, (POINTER(sb_body), c_int, POINTER(c_int), POINTER(c_int), )),
    "sb_body_membrane_states": (c_int, (POINTER(sb_body), c_int, POINTER(sb_membrane_state), )),
    "sb_default_cavity_def": (sb_cavity_def, ()),
    "sb_body_add_cavity": (c_int, (POINTER(sb_body), POINTER(sb_cavity_def), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_inject_cavity": (c_int, (POINTER(sb_body), c_int, c_double, )),
    "sb_body_set_cavity_pressure": (c_int, (POINTER(sb_body), c_int, c_double, )),
    "sb_body_cavity_volume": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), )),
    "sb_body_cavity_pressure": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), )),
    "sb_default_rigid_def": (sb_rigid_def, ()),
    "sb_body_add_rigid": (c_int, (POINTER(sb_body), POINTER(sb_rigid_def), POINTER(c_int), POINTER(sb_error), )),
    "sb_body_set_rigid_load": (c_int, (POINTER(sb_body), c_int, sb_vec3, sb_vec3, )),
    "sb_body_rigid_motion": (c_int, (POINTER(sb_body), c_int, POINTER(sb_rigid_motion), )),
    "sb_body_remove_rigid": (c_int, (POINTER(sb_body), c_int, )),
    "sb_body_rigid_count": (c_int, (POINTER(sb_body), )),
    "sb_default_embedding_def": (sb_embedding_def, ()),
    "sb_embedding_create": (c_int, (POINTER(sb_embedding_def), POINTER(POINTER(sb_embedding)), POINTER(sb_error), )),
    "sb_embedding_destroy": (None, (POINTER(sb_embedding), )),
    "sb_embedding_update": (c_int, (POINTER(sb_embedding), POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_jobs), )),
    "sb_embedding_forces": (c_int, (POINTER(sb_embedding), POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_jobs), )),
    "sb_embedding_get_report": (sb_embedding_report, (POINTER(sb_embedding), )),
    "sb_embedding_get_point": (c_int, (POINTER(sb_embedding), c_int, POINTER(sb_embedded_point), )),
    "sb_embedding_mapping": (c_int, (POINTER(sb_embedding), POINTER(sb_allocator), POINTER(sb_embedding_rows), POINTER(sb_error), )),
    "sb_embedding_rows_free": (None, (POINTER(sb_embedding_rows), )),
    "sb_embedding_follow": (c_int, (POINTER(sb_embedding), POINTER(sb_body), POINTER(sb_error), )),
    "sb_embedding_unfollow": (c_int, (POINTER(sb_embedding), )),
    "sb_skin_create": (c_int, (POINTER(sb_embedding), POINTER(sb_mesh), POINTER(sb_allocator), POINTER(POINTER(sb_skin)), POINTER(sb_error), )),
    "sb_skin_destroy": (None, (POINTER(sb_skin), )),
    "sb_particles_stabilise": (c_int, (POINTER(sb_particles), POINTER(sb_body), c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_body_add_constraint": (c_int, (POINTER(sb_body), POINTER(sb_constraint_term), c_int, c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_body_add_constraints": (c_int, (POINTER(sb_body), POINTER(sb_constraint_term), POINTER(c_int), POINTER(c_double), c_int, POINTER(c_int), POINTER(sb_error), )),
    "sb_body_set_constraint_value": (c_int, (POINTER(sb_body), c_int, c_double, )),
    "sb_body_remove_constraints": (c_int, (POINTER(sb_body), c_int, c_int, POINTER(sb_error), )),
    "sb_body_remove_constraint": (c_int, (POINTER(sb_body), c_int, POINTER(sb_error), )),
    "sb_body_clear_constraints": (None, (POINTER(sb_body), )),
    "sb_body_constraint_count": (c_int, (POINTER(sb_body), )),
    "sb_body_constraint_force": (c_int, (POINTER(sb_body), c_int, POINTER(c_double), )),
    "sb_body_tie_faces": (c_int, (POINTER(sb_body), POINTER(c_int), c_int, c_int, POINTER(c_int), c_int, c_double, c_int, POINTER(sb_tie_report), POINTER(sb_error), )),
    "sb_body_step": (c_int, (POINTER(sb_body), c_double, POINTER(sb_step_info), )),
    "sb_body_stable_step": (c_int, (POINTER(sb_body), POINTER(c_double), POINTER(sb_error), )),
    "sb_default_static_options": (sb_static_options, ()),
    "sb_body_solve_static": (c_int, (POINTER(sb_body), POINTER(sb_static_options), POINTER(sb_step_info), )),
    "sb_default_modes_options": (sb_modes_options, ()),
    "sb_body_modes": (c_int, (POINTER(sb_body), c_int, POINTER(sb_modes_options), POINTER(c_double), POINTER(sb_vec3), POINTER(sb_modes_info), POINTER(sb_error), )),
    "sb_default_unload_def": (sb_unload_def, ()),
    "sb_body_unload": (c_int, (POINTER(sb_unload_def), POINTER(sb_vec3), POINTER(POINTER(sb_body)), POINTER(sb_unload_report), POINTER(sb_error), )),
    "sb_body_state_size": (c_size_t, (POINTER(sb_body), )),
    "sb_body_state_save": (c_int, (POINTER(sb_body), c_void_p, c_size_t, )),
    "sb_body_state_load": (c_int, (POINTER(sb_body), c_void_p, c_size_t, POINTER(sb_error), )),
    "sb_body_state_save_file": (c_int, (POINTER(sb_body), c_char_p, POINTER(sb_error), )),
    "sb_body_state_load_file": (c_int, (POINTER(sb_body), c_char_p, POINTER(sb_error), )),
    "sb_body_state_hash": (c_uint64, (POINTER(sb_body), )),
    "sb_recording_start": (c_int, (POINTER(sb_body), c_int, POINTER(sb_allocator), POINTER(POINTER(sb_recording)), POINTER(sb_error), )),
    "sb_recording_stop": (None, (POINTER(sb_recording), )),
    "sb_recording_destroy": (None, (POINTER(sb_recording), )),
    "sb_recording_get_info": (sb_recording_info, (POINTER(sb_recording), )),
    "sb_recording_save": (c_int, (POINTER(sb_recording), c_void_p, c_size_t, )),
    "sb_recording_load": (c_int, (c_void_p, c_size_t, POINTER(sb_allocator), POINTER(POINTER(sb_recording)), POINTER(sb_error), )),
    "sb_recording_save_file": (c_int, (POINTER(sb_recording), c_char_p, POINTER(sb_error), )),
    "sb_recording_load_file": (c_int, (c_char_p, POINTER(sb_allocator), POINTER(POINTER(sb_recording)), POINTER(sb_error), )),
    "sb_recording_replay": (c_int, (POINTER(sb_recording), POINTER(sb_body), POINTER(sb_recording_report), )),
    "sb_body_solve_tangent": (c_int, (POINTER(sb_body), POINTER(sb_vec3), POINTER(sb_vec3), c_int, c_double, POINTER(sb_error), )),
    "sb_body_sensitivities": (c_int, (POINTER(sb_body), POINTER(sb_parameter), c_int, POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_body_gradient": (c_int, (POINTER(sb_body), POINTER(sb_vec3), POINTER(sb_vec3), POINTER(sb_parameter), c_int, POINTER(c_double), POINTER(sb_vec3), POINTER(sb_error), )),
    "sb_recording_gradient": (c_int, (POINTER(sb_recording), POINTER(sb_body), POINTER(sb_recording_loss), POINTER(sb_parameter), c_int, POINTER(sb_recording_slopes), POINTER(sb_error), )),
    "sb_default_identify_def": (sb_identify_def, ()),
    "sb_identify": (c_int, (POINTER(sb_identify_def), POINTER(c_double), POINTER(c_double), POINTER(c_double), POINTER(sb_identify_info), POINTER(sb_error), )),
    "sb_default_network_def": (sb_network_def, ()),
    "sb_network_load": (c_int, (c_char_p, POINTER(sb_network_def), POINTER(POINTER(sb_network)), POINTER(sb_error), )),
    "sb_network_load_memory": (c_int, (POINTER(c_ubyte), c_size_t, POINTER(sb_network_def), POINTER(POINTER(sb_network)), POINTER(sb_error), )),
    "sb_network_destroy": (None, (POINTER(sb_network), )),
    "sb_network_get_shape": (sb_network_shape, (POINTER(sb_network), )),
    "sb_network_run": (c_int, (POINTER(sb_network), POINTER(c_float), POINTER(c_float), )),
    "sb_default_network_input": (sb_network_input, ()),
    "sb_network_predict": (c_int, (POINTER(sb_network), POINTER(sb_grid), POINTER(sb_body), POINTER(sb_network_input), POINTER(sb_network_info), POINTER(sb_error), )),
    "sb_default_heat_tissue": (sb_heat_tissue, ()),
    "sb_default_heat_def": (sb_heat_def, ()),
    "sb_heat_create": (c_int, (POINTER(sb_body), POINTER(sb_heat_def), POINTER(POINTER(sb_heat)), POINTER(sb_error), )),
    "sb_heat_destroy": (None, (POINTER(sb_heat), )),
    "sb_heat_hold": (c_int, (POINTER(sb_heat), POINTER(c_int), c_int, POINTER(c_double), c_int, POINTER(sb_error), )),
    "sb_heat_release": (c_int, (POINTER(sb_heat), POINTER(c_int), c_int, POINTER(sb_error), )),
    "sb_heat_add_source": (c_int, (POINTER(sb_heat), sb_vec3, sb_vec3, c_double, c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_heat_add_node_source": (c_int, (POINTER(sb_heat), POINTER(c_int), c_int, POINTER(c_double), c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_heat_add_element_source": (c_int, (POINTER(sb_heat), POINTER(c_int), c_int, c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_heat_add_flux": (c_int, (POINTER(sb_heat), POINTER(c_int), c_int, c_int, c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_heat_add_convection": (c_int, (POINTER(sb_heat), POINTER(c_int), c_int, c_int, c_double, c_double, POINTER(c_int), POINTER(sb_error), )),
    "sb_heat_set_source": (c_int, (POINTER(sb_heat), c_int, c_double, )),
    "sb_heat_set_convection": (c_int, (POINTER(sb_heat), c_int, c_double, c_double, )),
    "sb_heat_remove": (c_int, (POINTER(sb_heat), c_int, )),
    "sb_heat_power": (c_int, (POINTER(sb_heat), c_int, POINTER(c_double), )),
    "sb_heat_set_blood": (c_int, (POINTER(sb_heat), c_double, )),
    "sb_heat_set_temperatures": (c_int, (POINTER(sb_heat), POINTER(c_double), POINTER(sb_error), )),
    "sb_heat_reset": (None, (POINTER(sb_heat), )),
    "sb_heat_step": (c_int, (POINTER(sb_heat), c_double, POINTER(sb_heat_info), POINTER(sb_error), )),
    "sb_heat_solve_steady": (c_int, (POINTER(sb_heat), POINTER(sb_heat_info), POINTER(sb_error), )),
    "sb_heat_temperatures": (POINTER(c_double), (POINTER(sb_heat), )),
    "sb_heat_damage": (POINTER(c_double), (POINTER(sb_heat), )),
    "sb_heat_dead_shares": (None, (POINTER(sb_heat), POINTER(c_double), )),
    "sb_heat_dead_volume": (c_double, (POINTER(sb_heat), )),
    "sb_heat_stiffness": (None, (POINTER(sb_heat), POINTER(c_double), )),
    "sb_heat_balance": (sb_heat_flows, (POINTER(sb_heat), )),
    "sb_default_tool_def": (sb_tool_def, ()),
    "sb_default_contact_def": (sb_contact_def, ()),
    "sb_contact_create": (c_int, (POINTER(sb_contact_def), POINTER(POINTER(sb_contact)), POINTER(sb_error), )),
    "sb_contact_destroy": (None, (POINTER(sb_contact), )),
    "sb_contact_add_tool": (c_int, (POINTER(sb_contact), POINTER(sb_tool_def), POINTER(c_int), POINTER(sb_error), )),
    "sb_contact_remove_tool": (c_int, (POINTER(sb_contact), c_int, )),
    "sb_contact_move_tool": (c_int, (POINTER(sb_contact), c_int, POINTER(sb_pose), )),
    "sb_contact_place_tool": (c_int, (POINTER(sb_contact), c_int, POINTER(sb_pose), POINTER(sb_error), )),
    "sb_contact_bend_tool": (c_int, (POINTER(sb_contact), c_int, POINTER(sb_vec3), )),
    "sb_contact_set_friction": (c_int, (POINTER(sb_contact), c_int, c_double, )),
    "sb_contact_wrench": (c_int, (POINTER(sb_contact), c_int, POINTER(sb_wrench), )),
    "sb_contact_reached": (c_int, (POINTER(sb_contact), c_int, POINTER(sb_pose), POINTER(c_double), )),
    "sb_contact_stiffness": (c_int, (POINTER(sb_contact), c_int, POINTER(c_double * 6), )),
    "sb_contact_coupling": (c_int, (POINTER(sb_contact), c_int, POINTER(sb_wrench), )),
    "sb_contact_grip": (c_int, (POINTER(sb_contact), c_int, c_int, POINTER(sb_grip), )),
    "sb_contact_points": (c_int, (POINTER(sb_contact), POINTER(sb_contact_point), c_int, )),
    "sb_contact_pressures": (c_int, (POINTER(sb_contact), POINTER(c_double), )),
    "sb_contact_get_info": (sb_contact_info, (POINTER(sb_contact), )),
    "sb_default_haptic_def": (sb_haptic_def, ()),
    "sb_haptic_create": (c_int, (POINTER(sb_haptic_def), POINTER(POINTER(sb_haptic)), POINTER(sb_error), )),
    "sb_haptic_destroy": (None, (POINTER(sb_haptic), )),
    "sb_haptic_take": (c_int, (POINTER(sb_haptic), POINTER(sb_tool_state), )),
    "sb_haptic_publish": (c_int, (POINTER(sb_haptic), )),
    "sb_haptic_force": (c_int, (POINTER(sb_haptic), POINTER(sb_tool_state), POINTER(sb_wrench_d), )),
    "sb_haptic_get_info": (sb_haptic_info, (POINTER(sb_haptic), )),
    "sb_haptic_from_hd": (sb_tool_state, (POINTER(c_double), POINTER(c_double), )),
    "sb_default_cut_def": (sb_cut_def, ()),
    "sb_cut_create": (c_int, (POINTER(sb_cut_def), POINTER(POINTER(sb_cut)), POINTER(sb_error), )),
    "sb_cut_destroy": (None, (POINTER(sb_cut), )),
    "sb_cut_triangles": (c_int, (POINTER(sb_cut), POINTER(sb_vec3), c_int, POINTER(sb_cut_info), POINTER(sb_error), )),
    "sb_cut_begin": (c_int, (POINTER(sb_cut), POINTER(sb_vec3), c_int, POINTER(c_int), POINTER(sb_error), )),
    "sb_cut_move": (c_int, (POINTER(sb_cut), c_int, POINTER(sb_vec3), POINTER(sb_cut_info), POINTER(sb_error), )),
    "sb_cut_scissors": (c_int, (POINTER(sb_cut), c_int, sb_vec3, POINTER(sb_vec3), POINTER(sb_cut_info), POINTER(sb_error), )),
    "sb_cut_end": (None, (POINTER(sb_cut), c_int, )),
    "sb_cut_ablate": (c_int, (POINTER(sb_cut), sb_vec3, c_double, POINTER(sb_cut_info), POINTER(sb_error), )),
    "sb_default_tear_options": (sb_tear_options, ()),
    "sb_cut_tear": (c_int, (POINTER(sb_cut), POINTER(sb_tear_options), POINTER(sb_cut_info), POINTER(sb_error), )),
    "sb_cut_node_origin": (c_int, (POINTER(sb_cut), c_int, )),
    "sb_cut_cell_element": (c_int, (POINTER(sb_cut), c_int, )),
    "sb_cut_surface_create": (c_int, (POINTER(sb_cut), POINTER(sb_allocator), POINTER(POINTER(sb_cut_surface)), POINTER(sb_error), )),
    "sb_cut_surface_destroy": (None, (POINTER(sb_cut_surface), )),
    "sb_cut_surface_update": (c_int, (POINTER(sb_cut_surface), POINTER(sb_error), )),
    "sb_cut_surface_get": (sb_cut_drawing, (POINTER(sb_cut_surface), )),
    "sb_cut_surface_skin": (POINTER(sb_skin), (POINTER(sb_cut_surface), )),
    "sb_cut_fine_create": (c_int, (POINTER(sb_cut), POINTER(sb_mesh), POINTER(sb_allocator), POINTER(POINTER(sb_cut_fine)), POINTER(sb_error), )),
    "sb_cut_fine_destroy": (None, (POINTER(sb_cut_fine), )),
    "sb_cut_fine_update": (c_int, (POINTER(sb_cut_fine), POINTER(sb_error), )),
    "sb_cut_fine_get": (sb_cut_fine_drawing, (POINTER(sb_cut_fine), )),
    "ndl_rod_section_preset": (c_int, (c_int, POINTER(ndl_rod_section), )),
    "ndl_rod_stiffness_of": (ndl_rod_stiffness, (POINTER(ndl_rod_section), )),
    "ndl_default_rod_def": (ndl_rod_def, ()),
    "ndl_rod_create": (c_int, (POINTER(ndl_rod_def), POINTER(POINTER(ndl_rod)), POINTER(sb_error), )),
    "ndl_rod_destroy": (None, (POINTER(ndl_rod), )),
    "ndl_rod_hold": (c_int, (POINTER(ndl_rod), c_int, sb_vec3, POINTER(sb_vec3), )),
    "ndl_rod_release": (c_int, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_turn": (c_int, (POINTER(ndl_rod), c_int, c_double, )),
    "ndl_rod_release_turn": (c_int, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_hold_base": (c_int, (POINTER(ndl_rod), sb_vec3, sb_vec3, sb_vec3, POINTER(sb_vec3), POINTER(sb_vec3), )),
    "ndl_rod_set_force": (c_int, (POINTER(ndl_rod), c_int, sb_vec3, )),
    "ndl_rod_set_torque": (c_int, (POINTER(ndl_rod), c_int, c_double, )),
    "ndl_rod_set_gravity": (c_int, (POINTER(ndl_rod), sb_vec3, )),
    "ndl_rod_set_damping": (c_int, (POINTER(ndl_rod), c_double, c_double, )),
    "ndl_rod_set_grip": (c_int, (POINTER(ndl_rod), c_int, c_double, c_double, )),
    "ndl_rod_step": (c_int, (POINTER(ndl_rod), c_double, POINTER(ndl_rod_info), )),
    "ndl_default_rod_static_options": (ndl_rod_static_options, ()),
    "ndl_rod_solve_static": (c_int, (POINTER(ndl_rod), POINTER(ndl_rod_static_options), POINTER(ndl_rod_info), )),
    "ndl_rod_set_positions": (c_int, (POINTER(ndl_rod), POINTER(sb_vec3), POINTER(sb_error), )),
    "ndl_rod_set_velocities": (c_int, (POINTER(ndl_rod), POINTER(sb_vec3), )),
    "ndl_rod_split_edge": (c_int, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_merge_node": (c_int, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_feed": (c_int, (POINTER(ndl_rod), c_double, )),
    "ndl_rod_reparameterise": (c_int, (POINTER(ndl_rod), POINTER(sb_vec3), c_int, POINTER(sb_error), )),
    "ndl_rod_node_count": (c_int, (POINTER(ndl_rod), )),
    "ndl_rod_positions": (POINTER(sb_vec3), (POINTER(ndl_rod), )),
    "ndl_rod_velocities": (POINTER(sb_vec3), (POINTER(ndl_rod), )),
    "ndl_rod_mass": (c_double, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_rest_length": (c_double, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_frame": (ndl_frame, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_tip": (None, (POINTER(ndl_rod), POINTER(sb_vec3), POINTER(ndl_frame), )),
    "ndl_rod_curvature": (None, (POINTER(ndl_rod), c_int, POINTER(c_double), )),
    "ndl_rod_twist": (c_double, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_energies": (ndl_rod_energy, (POINTER(ndl_rod), )),
    "ndl_rod_forces": (None, (POINTER(ndl_rod), POINTER(sb_vec3), )),
    "ndl_rod_reactions": (POINTER(sb_vec3), (POINTER(ndl_rod), )),
    "ndl_rod_reaction_torque": (c_double, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_grip_torque": (c_double, (POINTER(ndl_rod), c_int, )),
    "ndl_rod_base_wrench": (None, (POINTER(ndl_rod), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "ndl_default_remesh_def": (ndl_remesh_def, ()),
    "ndl_remesh_create": (c_int, (POINTER(ndl_remesh_def), POINTER(POINTER(ndl_remesh)), POINTER(sb_error), )),
    "ndl_remesh_destroy": (None, (POINTER(ndl_remesh), )),
    "ndl_remesh_reserve": (c_int, (POINTER(ndl_remesh), c_int, c_int, POINTER(sb_error), )),
    "ndl_remesh_puncture": (c_int, (POINTER(ndl_remesh), c_int, POINTER(ndl_surface_hit), POINTER(ndl_remesh_info), POINTER(sb_error), )),
    "ndl_remesh_penetrate": (c_int, (POINTER(ndl_remesh), c_int, sb_vec3, POINTER(ndl_remesh_info), POINTER(sb_error), )),
    "ndl_remesh_retract": (c_int, (POINTER(ndl_remesh), c_int, sb_vec3, POINTER(ndl_remesh_info), POINTER(sb_error), )),
    "ndl_remesh_withdraw": (c_int, (POINTER(ndl_remesh), c_int, POINTER(ndl_remesh_info), POINTER(sb_error), )),
    "ndl_remesh_nodes": (POINTER(c_int), (POINTER(ndl_remesh), c_int, POINTER(c_int), )),
    "ndl_remesh_limit": (c_double, (POINTER(ndl_remesh), c_int, )),
    "ndl_remesh_material_point": (c_int, (POINTER(ndl_remesh), c_int, sb_vec3, POINTER(sb_vec3), )),
    "ndl_remesh_hit": (c_int, (POINTER(ndl_remesh), sb_vec3, sb_vec3, POINTER(ndl_surface_hit), )),
    "ndl_remesh_split_count": (c_int, (POINTER(ndl_remesh), c_int, )),
    "ndl_remesh_quality": (None, (POINTER(ndl_remesh), POINTER(c_double), POINTER(c_double), POINTER(c_double), )),
    "ndl_remesh_is_original": (c_int, (POINTER(ndl_remesh), )),
    "ndl_remesh_check": (c_int, (POINTER(ndl_remesh), POINTER(sb_error), )),
    "ndl_helix_pose": (ndl_tip_pose, (POINTER(ndl_tip_pose), c_double, c_double, c_double, )),
    "ndl_tip_turn": (ndl_tip_pose, (POINTER(ndl_tip_pose), c_double, )),
    "ndl_helix_radius": (c_double, (c_double, c_double, )),
    "ndl_helix_pitch": (c_double, (c_double, c_double, )),
    "ndl_bevel_offset": (c_int, (POINTER(ndl_bevel), c_double, c_double, POINTER(c_double), )),
    "ndl_bevel_shift": (c_int, (c_double, sb_vec3, POINTER(sb_mat3), POINTER(sb_vec3), )),
    "ndl_bevel_curvature": (c_int, (POINTER(ndl_bevel), c_double, c_double, POINTER(c_double), )),
    "ndl_obstacle_distance": (c_double, (POINTER(ndl_obstacle), sb_vec3, )),
    "ndl_default_plan_def": (ndl_plan_def, (c_double, c_double, )),
    "ndl_plan_make": (c_int, (POINTER(ndl_plan_def), POINTER(ndl_tip_pose), sb_vec3, POINTER(ndl_plan), POINTER(sb_error), )),
    "ndl_plan_pose": (ndl_tip_pose, (POINTER(ndl_plan), c_double, POINTER(ndl_tip_pose), c_double, )),
    "ndl_default_steer_def": (ndl_steer_def, (c_double, c_double, )),
    "ndl_steer_begin": (c_int, (POINTER(ndl_steer_def), POINTER(ndl_steer), POINTER(sb_error), )),
    "ndl_steer_update": (c_int, (POINTER(ndl_steer), POINTER(ndl_tip_pose), sb_vec3, POINTER(ndl_steer_command), )),
    "ndl_default_push_def": (ndl_push_def, ()),
    "ndl_push_begin": (c_int, (POINTER(ndl_push_def), POINTER(ndl_push), POINTER(sb_error), )),
    "ndl_push_update": (c_int, (POINTER(ndl_push), sb_vec3, c_double, POINTER(sb_vec3), )),
    "ndl_push_choose": (c_int, (POINTER(ndl_push_def), POINTER(sb_mat3), POINTER(sb_vec3), c_int, sb_vec3, POINTER(c_int), POINTER(sb_vec3), POINTER(c_double), POINTER(sb_error), )),
    "ndl_default_guide_def": (ndl_guide_def, (sb_vec3, sb_vec3, sb_vec3, )),
    "ndl_guide_make": (c_int, (POINTER(ndl_guide_def), POINTER(ndl_guide), POINTER(sb_error), )),
    "ndl_default_needle_def": (ndl_needle_def, ()),
    "ndl_needle_create": (c_int, (POINTER(ndl_needle_def), POINTER(POINTER(ndl_needle)), POINTER(sb_error), )),
    "ndl_needle_destroy": (None, (POINTER(ndl_needle), )),
    "ndl_needle_move_base": (c_int, (POINTER(ndl_needle), sb_vec3, sb_vec3, sb_vec3, )),
    "ndl_step": (c_int, (POINTER(sb_body), POINTER(POINTER(ndl_needle)), c_int, c_double, POINTER(ndl_command), POINTER(ndl_step_info), POINTER(sb_error), )),
    "ndl_needle_rod": (POINTER(ndl_rod), (POINTER(ndl_needle), )),
    "ndl_needle_tip": (ndl_tip_pose, (POINTER(ndl_needle), )),
    "ndl_needle_base_wrench": (None, (POINTER(ndl_needle), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "ndl_needle_entry": (c_int, (POINTER(ndl_needle), )),
    "ndl_needle_body_node": (c_int, (POINTER(ndl_needle), c_int, )),
    "ndl_needle_remesh": (POINTER(ndl_remesh), (POINTER(ndl_needle), )),
    "ndl_needle_contact": (c_int, (POINTER(ndl_needle), c_int, )),
    "ndl_needle_contact_force": (sb_vec3, (POINTER(ndl_needle), c_int, )),
    "ndl_needle_depth": (c_double, (POINTER(ndl_needle), )),
    "ndl_needle_fed": (c_double, (POINTER(ndl_needle), )),
    "ndl_needle_advance": (c_double, (POINTER(ndl_needle), )),
    "ndl_needle_cutting": (c_double, (POINTER(ndl_needle), )),
    "ndl_needle_tip_material": (c_int, (POINTER(ndl_needle), POINTER(sb_vec3), )),
    "ndl_rod_state_size": (c_size_t, (POINTER(ndl_rod), )),
    "ndl_rod_save": (c_int, (POINTER(ndl_rod), c_void_p, c_size_t, POINTER(sb_error), )),
    "ndl_rod_load": (c_int, (POINTER(ndl_rod), c_void_p, c_size_t, POINTER(sb_error), )),
    "reg_rigid_identity": (reg_rigid, ()),
    "reg_rigid_apply": (sb_vec3, (POINTER(reg_rigid), sb_vec3, )),
    "reg_rigid_compose": (reg_rigid, (POINTER(reg_rigid), POINTER(reg_rigid), )),
    "reg_rigid_inverse": (reg_rigid, (POINTER(reg_rigid), )),
    "reg_rigid_angle": (c_double, (POINTER(reg_rigid), )),
    "reg_rigid_fit": (c_int, (POINTER(sb_vec3), POINTER(sb_vec3), POINTER(c_double), c_int, POINTER(reg_rigid), POINTER(sb_error), )),
    "reg_kdtree_create": (c_int, (POINTER(sb_vec3), c_int, POINTER(sb_allocator), POINTER(POINTER(reg_kdtree)), POINTER(sb_error), )),
    "reg_kdtree_destroy": (None, (POINTER(reg_kdtree), )),
    "reg_kdtree_count": (c_int, (POINTER(reg_kdtree), )),
    "reg_kdtree_nearest": (c_int, (POINTER(reg_kdtree), sb_vec3, c_double, POINTER(c_double), )),
    "reg_kdtree_k_nearest": (c_int, (POINTER(reg_kdtree), sb_vec3, c_int, POINTER(c_int), POINTER(c_double), )),
    "reg_kdtree_within": (c_int, (POINTER(reg_kdtree), sb_vec3, c_double, POINTER(c_int), c_int, )),
    "reg_cloud_free": (None, (POINTER(reg_cloud), )),
    "reg_cloud_from_points": (c_int, (POINTER(reg_cloud), POINTER(sb_vec3), POINTER(sb_vec3), c_int, POINTER(sb_allocator), POINTER(sb_error), )),
    "reg_cloud_from_mesh": (c_int, (POINTER(reg_cloud), POINTER(sb_mesh), POINTER(sb_allocator), POINTER(sb_error), )),
    "reg_cloud_load": (c_int, (POINTER(reg_cloud), c_char_p, c_double, POINTER(sb_allocator), POINTER(sb_error), )),
    "reg_cloud_load_memory": (c_int, (POINTER(reg_cloud), c_void_p, c_size_t, c_int, c_char_p, c_double, POINTER(sb_allocator), POINTER(sb_error), )),
    "reg_cloud_save_ply": (c_int, (c_char_p, POINTER(reg_cloud), c_int, POINTER(sb_error), )),
    "reg_cloud_estimate_normals": (c_int, (POINTER(reg_cloud), c_int, POINTER(sb_vec3), POINTER(sb_jobs), POINTER(sb_error), )),
    "reg_cloud_thin": (c_int, (POINTER(reg_cloud), c_double, POINTER(reg_cloud), POINTER(sb_error), )),
    "reg_cloud_spread": (c_int, (POINTER(sb_vec3), c_int, c_int, POINTER(c_int), POINTER(c_double), )),
    "reg_outlier_limit": (c_double, (POINTER(c_double), c_int, c_int, c_double, POINTER(c_double), )),
    "reg_cloud_remove_outliers": (c_int, (POINTER(reg_cloud), c_int, c_int, c_double, POINTER(c_int), POINTER(sb_error), )),
    "reg_cloud_smooth": (c_int, (POINTER(reg_cloud), POINTER(sb_jobs), POINTER(reg_smooth_info), POINTER(sb_error), )),
    "reg_cloud_smooth_mesh": (c_int, (POINTER(sb_mesh), POINTER(sb_jobs), POINTER(reg_smooth_info), POINTER(sb_error), )),
    "reg_default_field_def": (reg_field_def, ()),
    "reg_field_create": (c_int, (POINTER(reg_field_def), POINTER(POINTER(reg_field)), POINTER(sb_error), )),
    "reg_field_destroy": (None, (POINTER(reg_field), )),
    "reg_field_closest": (c_int, (POINTER(reg_field), sb_vec3, c_int, POINTER(reg_field_hit), )),
    "reg_field_along": (c_int, (POINTER(reg_field), sb_vec3, sb_vec3, c_double, c_int, POINTER(reg_field_sample), )),
    "reg_field_at": (c_int, (POINTER(reg_field), sb_vec3, c_int, POINTER(c_double), POINTER(sb_vec3), )),
    "reg_field_bounds": (None, (POINTER(reg_field), POINTER(sb_vec3), POINTER(sb_vec3), )),
    "reg_field_sweeps": (c_int, (POINTER(reg_field), )),
    "reg_default_icp_options": (reg_icp_options, ()),
    "reg_icp_stop_string": (c_char_p, (c_int, )),
    "reg_warning_string": (c_char_p, (c_int, )),
    "reg_icp": (c_int, (POINTER(reg_icp_shape), POINTER(reg_icp_shape), POINTER(reg_icp_options), POINTER(reg_rigid), POINTER(reg_icp_info), POINTER(sb_error), )),
    "reg_default_cpd_options": (reg_cpd_options, ()),
    "reg_cpd_fit": (c_int, (POINTER(sb_vec3), c_int, POINTER(sb_vec3), c_int, POINTER(reg_cpd_options), POINTER(POINTER(reg_cpd)), POINTER(sb_error), )),
    "reg_cpd_destroy": (None, (POINTER(reg_cpd), )),
    "reg_cpd_get_info": (reg_cpd_info, (POINTER(reg_cpd), )),
    "reg_cpd_moved": (POINTER(sb_vec3), (POINTER(reg_cpd), )),
    "reg_cpd_partners": (POINTER(c_int), (POINTER(reg_cpd), )),
    "reg_cpd_probabilities": (POINTER(c_double), (POINTER(reg_cpd), )),
    "reg_cpd_linear": (None, (POINTER(reg_cpd), POINTER(sb_mat3), POINTER(sb_vec3), )),
    "reg_cpd_apply": (None, (POINTER(reg_cpd), POINTER(sb_vec3), c_int, POINTER(sb_vec3), )),
    "reg_default_match_def": (reg_match_def, ()),
    "reg_match_create": (c_int, (POINTER(reg_match_def), POINTER(POINTER(reg_match)), POINTER(sb_error), )),
    "reg_match_destroy": (None, (POINTER(reg_match), )),
    "reg_match_step": (c_int, (POINTER(reg_match), POINTER(reg_match_info), )),
    "reg_match_run": (c_int, (POINTER(reg_match), c_int, POINTER(reg_match_info), )),
    "reg_match_restart": (None, (POINTER(reg_match), )),
    "reg_match_move_landmarks": (c_int, (POINTER(reg_match), POINTER(sb_vec3), )),
    "reg_match_landmarks": (None, (POINTER(reg_match), POINTER(sb_vec3), )),
    "reg_match_body": (POINTER(sb_body), (POINTER(reg_match), )),
    "reg_match_get_info": (reg_match_info, (POINTER(reg_match), )),
    "reg_match_sample_count": (c_int, (POINTER(reg_match), )),
    "reg_match_get_sample": (c_int, (POINTER(reg_match), c_int, POINTER(reg_match_sample), )),
    "reg_default_nicp_def": (reg_nicp_def, ()),
    "reg_nicp_create": (c_int, (POINTER(reg_nicp_def), POINTER(POINTER(reg_nicp)), POINTER(sb_error), )),
    "reg_nicp_destroy": (None, (POINTER(reg_nicp), )),
    "reg_nicp_step": (c_int, (POINTER(reg_nicp), POINTER(reg_nicp_info), )),
    "reg_nicp_run": (c_int, (POINTER(reg_nicp), c_int, POINTER(reg_nicp_info), )),
    "reg_nicp_restart": (None, (POINTER(reg_nicp), )),
    "reg_nicp_move_landmarks": (c_int, (POINTER(reg_nicp), POINTER(sb_vec3), )),
    "reg_nicp_landmarks": (None, (POINTER(reg_nicp), POINTER(sb_vec3), )),
    "reg_nicp_body": (POINTER(sb_body), (POINTER(reg_nicp), )),
    "reg_nicp_get_info": (reg_nicp_info, (POINTER(reg_nicp), )),
    "reg_nicp_surface_count": (c_int, (POINTER(reg_nicp), )),
    "reg_nicp_positions": (None, (POINTER(reg_nicp), POINTER(sb_vec3), )),
    "reg_nicp_source_count": (c_int, (POINTER(reg_nicp), )),
    "reg_nicp_get_source": (c_int, (POINTER(reg_nicp), c_int, POINTER(reg_nicp_source), )),
    "reg_default_loads_def": (reg_loads_def, ()),
    "reg_loads_run": (c_int, (POINTER(reg_loads_def), POINTER(sb_vec3), POINTER(reg_loads_info), )),
    "reg_default_model_def": (reg_model_def, ()),
    "reg_model_create": (c_int, (POINTER(reg_model_def), POINTER(POINTER(reg_model)), POINTER(sb_error), )),
    "reg_model_destroy": (None, (POINTER(reg_model), )),
    "reg_model_node_count": (c_int, (POINTER(reg_model), )),
    "reg_default_infer_def": (reg_infer_def, ()),
    "reg_infer_run": (c_int, (POINTER(reg_infer_def), POINTER(POINTER(reg_infer)), POINTER(sb_error), )),
    "reg_infer_destroy": (None, (POINTER(reg_infer), )),
    "reg_infer_displacements": (c_int, (POINTER(reg_infer), POINTER(sb_vec3), )),
    "reg_infer_forces": (c_int, (POINTER(reg_infer), POINTER(sb_vec3), )),
    "reg_infer_expected": (c_int, (POINTER(reg_infer), POINTER(c_double), )),
    "reg_infer_draw": (c_int, (POINTER(reg_infer), c_int, POINTER(sb_vec3), )),
    "reg_infer_covariance": (c_int, (POINTER(reg_infer), POINTER(sb_vec3), c_int, POINTER(sb_vec3), POINTER(sb_mat3), POINTER(sb_error), )),
    "reg_infer_best_landmark": (c_int, (POINTER(reg_infer), POINTER(sb_vec3), c_int, c_double, POINTER(c_int), POINTER(c_double), POINTER(sb_error), )),
    "reg_infer_get_quality": (c_int, (POINTER(reg_infer), POINTER(reg_quality), )),
    "reg_prior_string": (c_char_p, (c_int, )),
    "reg_infer_stop_string": (c_char_p, (c_int, )),
    "reg_default_track_def": (reg_track_def, ()),
    "reg_track_create": (c_int, (POINTER(reg_track_def), POINTER(POINTER(reg_track)), POINTER(sb_error), )),
    "reg_track_destroy": (None, (POINTER(reg_track), )),
    "reg_track_restart": (c_int, (POINTER(reg_track), POINTER(reg_infer), POINTER(sb_error), )),
    "reg_track_set_target": (c_int, (POINTER(reg_track), POINTER(reg_points), POINTER(sb_error), )),
    "reg_track_set_features": (c_int, (POINTER(reg_track), POINTER(reg_landmark), POINTER(reg_curve), POINTER(sb_error), )),
    "reg_track_step": (c_int, (POINTER(reg_track), c_double, POINTER(reg_track_info), )),
    "reg_track_displacements": (c_int, (POINTER(reg_track), POINTER(sb_vec3), )),
    "reg_track_covariances": (c_int, (POINTER(reg_track), POINTER(sb_mat3), )),
    "reg_track_save_size": (c_size_t, (POINTER(reg_track), )),
    "reg_track_save": (c_int, (POINTER(reg_track), c_void_p, c_size_t, )),
    "reg_track_load": (c_int, (POINTER(reg_track), c_void_p, c_size_t, POINTER(sb_error), )),
    "reg_track_state_string": (c_char_p, (c_int, )),
}

DOCUMENTATION = {
    'sb_result_string': 'Name of a result, e.g. "SB_ERROR_MEMORY"; never NULL. Thread-safe, static storage.',
    'sb_output_open': 'Begins to write a file; binary, on every system. path is borrowed until it is closed.\n\nA file that is there stays as it is, and readable, until sb_output_close; its permissions pass on to the new one, its\nhard links stay with the old one, and symbolic links keep pointing to it. It must be writable, and a file can be made\nin its folder. Devices, pipes and other things that are no plain files are written where they stand.\n\nout is written on success and on failure. Nothing is allocated but by fopen. SB_ERROR_ARGUMENT (NULL) or\nSB_ERROR_FILE: then nothing is to be closed.',
    'sb_output_close': 'Ends it. SB_ERROR_FILE when anything could not be written since it was opened, or the target cannot be replaced: then\nthe target is as it was before, and nothing is left beside it.',
    'sb_output_discard': 'Ends it without a result: the target is as it was before.',
    'sb_file_save': 'Writes bytes[size] as a file, by the three above: a saved state, recording, needle or preconditioner, say. bytes may\nbe NULL when size is 0. SB_ERROR_ARGUMENT or SB_ERROR_FILE.',
    'sb_mapping_apply': 'out[row_count] = H^T x: what the rows are of x[nodes]: their points of positions, their displacements of\ndisplacements. Not checked: nodes must be within x. out and x do not overlap.',
    'sb_mapping_spread': "forces[nodes] += H f: forces f[row_count] at the rows' points, brought to their nodes.",
    'sb_element_name': 'Name of a type, e.g. "tet4"; "custom" for SB_CUSTOM, "unknown" for none of them. Static storage.',
    'sb_element_face': "Local node numbers of face `face` in [0, face_count), counter-clockwise seen from outside, and the face's\ntype (tri3, tri6, quad4, quad8, quad9; face_type may be NULL). Returns the number of nodes, 0 (nothing written)\nfor no such face.",
    'sb_element_edge': 'Local node numbers of edge `edge` in [0, edge_count): both ends, then the node between them or -1. Returns\nthe number of nodes on the edge (2 or 3), 0 (nothing written) for no such edge.',
    'sb_element_node_point': 'Parameters of local node `node`; returns 1, or 0 (nothing written) for no such node.',
    'sb_element_shape': 'Shape functions N and their gradients dN/dxi at xi. shape: [nodes] or NULL; gradient: [nodes][3] or NULL,\nthe third component 0 for surfaces. Nothing is written for an unknown type.',
    'sb_element_quadrature': "Points (parameters xi) and weights of a rule; the weights sum to the parameter domain's measure (tet 1/6,\ntriangle 1/2, hex 8, quad 4). Returns the number of points, 0 (nothing written) when there is no such rule.\nPoint order: tets by the corner a point is nearest to, hexes with xi fastest, as in Abaqus and CalculiX.",
    'sb_element_table_check': "Checks whether a table describes an element that can be computed with, or a cloud. SB_ERROR_ARGUMENT (null pointer, a\ncount out of range, weights not positive or with another sum than the volume inside the faces, faces that do not\nclose or look inward, functions that are not 1 at their node and 0 at others, do not sum to 1 or do not reproduce xi,\ngradients that are not their slopes, a node without mass), SB_ERROR_INDEX (a face's node), SB_ERROR_NOT_FINITE; the\nmessage names what, and error->node the local node where there is one. error may be NULL.",
    'sb_mesh_free': 'Releases the arrays through mesh->allocator and zeroes the struct. Safe on {0} and on NULL.',
    'sb_mesh_copy': 'Deep copy with memory from `allocator`.',
    'sb_mesh_append': 'Appends nodes and elements of `other`, which has the same element type (and table), to the mesh: they get the numbers\nafter its own, and no node is merged. Regions are kept (0 where one of the two has none). New arrays come\nfrom mesh->allocator, the old ones go back to it; `other` may be the mesh itself. On failure\n(SB_ERROR_ARGUMENT also for different types, _MESH for more than 2^31-1 nodes or elements, _INDEX,\n_NOT_FINITE, _MEMORY) the mesh is as it was.',
    'sb_mesh_validate': 'Checks whether a mesh can be computed with: counts, finite nodes, index range, repeated nodes and, for\nvolumes, a positive Jacobian (at the corners; curved tet10, hex20 and hex27 also at their other nodes, on their faces\nand inside; custom elements, whose table is checked too, at their points). SB_ERROR_ARGUMENT, _NOT_FINITE\n(error->node is the first), _INDEX or _MESH (error->element is the first; the message lists up to 8 elements and\nthe total). Allocates nothing; one pass.',
    'sb_mesh_check': 'Lists everything suspicious about a mesh in one report, whatever the arrays hold. SB_OK also for a bad\nmesh; fails with SB_ERROR_ARGUMENT (counts, type, null arrays) or SB_ERROR_MEMORY only. Elements with an\nindex out of range or a repeated node take no part in the topology, bad ones none in volume, area and\nquality. O(nodes + elements).',
    'sb_mesh_element_volume': 'Volume of an element (m^3), exact for curved ones too; negative when inverted; 0 for surfaces.',
    'sb_mesh_volume': 'Volume mesh: its volume (m^3). Surface: the signed volume it encloses, meaningful when it is closed.',
    'sb_mesh_surface_area': 'Area of a surface mesh (m^2), exact for tri3, by the face quadrature else; 0 for volumes (take the\nboundary).',
    'sb_mesh_bounds': 'Smallest box around all nodes (m); both corners 0 for a mesh without nodes.',
    'sb_mesh_element_quality': 'Shape of an element: 1 is best, <= 0 inverted or flat. tet4: mean ratio 12 (3V)^(2/3) / sum of squared\nedges; tet10: that of its corners times min/max of the Jacobian; hex8 and quads: smallest Jacobian at a\ncorner of edges scaled to length 1; hex20, hex27, custom: the same of the columns dx/dxi at all nodes, face\ncentres and points (custom: points only); triangles: 4 sqrt(3) A / sum of squared edges (of the corners).',
    'sb_mesh_dihedral_range': 'Smallest and largest angle (degrees) between two faces of an element, over all elements of a tet4 or tet10 mesh (of\nits corners); both 0 for other types and without elements. Either place may be NULL.',
    'sb_mesh_orient': 'Turns inverted volume elements (corner volume negative) by renumbering them; surfaces:\nsb_mesh_orient_surface. *flipped: how many. Mid-edge nodes move along. Custom elements are left alone. What cannot\nbe mended that way stays for sb_mesh_validate.',
    'sb_mesh_orient_surface': 'Orients a surface consistently: floods over the edges of exactly two elements; a closed part is turned\noutward (its enclosed volume positive), an open one as most of its elements were. SB_ERROR_MESH when it is\none-sided.',
    'sb_mesh_merge_nodes': 'Merges nodes that lie within `tolerance` (m) of a node before them; negative: 1e-6 of the longest side of\nthe bounding box; 0: equal coordinates only. *merged: nodes removed. Elements may collapse: validate\nafterwards.',
    'sb_mesh_remove_unreferenced': 'Removes nodes of no element; *removed: how many.',
    'sb_mesh_remove_duplicate_elements': 'Removes elements with the same corners as an element before them; *removed: how many.',
    'sb_mesh_scale': 'Multiplies all coordinates by factor > 0 (0.001: millimetres to metres).',
    'sb_mesh_boundary': 'Faces that belong to one element only, in the order of elements and faces. compact 0: the surface keeps all\nnodes and the numbering of the volume; 1: it keeps the nodes it uses, in their order.',
    'sb_mesh_neighbours': 'Neighbour of each element across each face (surfaces: across each edge), [elements][faces or edges]; -1\nwhere there is none or more than one.',
    'sb_mesh_edges': 'Every edge once, corner to corner, [edges][2] with the smaller node first, sorted.',
    'sb_mesh_node_elements': 'The elements of each node, ascending.',
    'sb_mesh_components': 'Part number of each element, [elements][1], from 0 in the order of their first element; elements that share\na node belong together. *count (or NULL): number of parts.',
    'sb_mesh_to_tet10': 'The tet10 mesh with straight edges of a tet4 mesh: old nodes first, then one node per edge. Regions are\nkept.',
    'sb_mesh_to_hex20': 'The hex20 or hex27 mesh with straight edges of a hex8 mesh: old nodes first, then one node per edge, and for hex27\none per face and one per element, each in the middle. Regions are kept.',
    'sb_mesh_reorder': 'Renumbers nodes by reverse Cuthill-McKee and sorts elements by their lowest node: small bandwidth, good\ncache use. Worth a call before a body is made of a mesh: a tangent of 9,600 tet10 is assembled in three\nquarters of the time it takes with nodes as sb_mesh_beam numbers them, and in less than along a\nspace-filling curve; tet4 gain little. node_map [nodes] and element_map [elements] (each may be NULL)\nreceive the new number of each old one.',
    'sb_mesh_beam': "Box from the origin to `size` (m, each > 0) of nx * ny * nz cells (each >= 1); a cell is 1 hex or 6 tets\n(Kuhn's). Corner nodes are numbered with x fastest, then y.",
    'sb_mesh_cylinder': 'Solid cylinder of `radius` and `length` (m, > 0) around coordinate axis 0 (x), 1 (y) or 2 (z), from 0 to\nlength along it. across: cells over the diameter in [4, 20000], along >= 1: layers. Boundary nodes lie on\nthe cylinder, so the volume is too small by O(1/across^2). Nodes are numbered layer by layer.',
    'sb_mesh_ellipsoid': 'Solid ellipsoid around the origin with semi-axes (m, each > 0); cells over each diameter in [4, 500].\nBoundary nodes lie on the ellipsoid.',
    'sb_mesh_organ': 'A solid like a human liver for demonstrations: 1.5 litre (1.2 at 4 cells), 20 cm wide (x, the thick right\nlobe at negative x), dome above (z up), hollow below, a notch in the front edge (negative y). cells in [4,\n60] over its width; every element is sound (sb_mesh_element_quality above 0.2).',
    'sb_mesh_sets_free': 'Releases the arrays and zeroes the struct. Safe on {0} and on NULL.',
    'sb_mesh_sets_find': 'The first set with the name (whole, case matters) and dimension (-1: any), or NULL. O(sets).',
    'sb_default_load_options': 'Scale 1, nothing is repaired, malloc, no report, no sets.',
    'sb_mesh_load': "Reads a mesh from a file.\n\nmesh     overwritten on success (free it first when it owns arrays), untouched on failure; free it with\n         sb_mesh_free\npath     the format is by the content, else by the ending. TetGen: the .node or the .ele file, the\n         other one is looked for beside it\noptions  NULL: sb_default_load_options()\nerror    may be NULL; says file and line (line 0 in binary parts, where the message has the byte offset),\n         and the node or element: the cell of the file, counted from 0, or with SB_ERROR_MESH the element\n         of the mesh it would have become\n\nThe cells of the highest dimension become the mesh: tet4, tet10, hex8, hex20, hex27, or for surfaces tri3, tri6,\nquad4, quad8, quad9. Triangles mixed with quadrilaterals, and polygons of OBJ, PLY, OFF and POLYDATA, become tri3;\npolygons are cut into a fan at their first corner, which is right for convex ones. Pyramids, wedges, and hexahedra\nthat are mixed with other volume cells, are cut into tets that fit: each quadrilateral along the diagonal from its\nlowest node. Linear cells give tet4, quadratic ones (tet10, hex20, hex27, wedge15, wedge18, pyramid13, pyramid14)\ntet10, whose nodes on diagonals that are not in the file are new, behind those of the file. Linear cells mixed with\nquadratic ones, and a quadrilateral against triangles that are cut along its other diagonal, are\nSB_ERROR_UNSUPPORTED.\n\nNode orders of gmsh and TetGen are turned into VTK's. Regions come from the cell field `region` (VTK, VTU), else\n`material`, `MaterialIds`, `gmsh:physical`, `medit:ref`, `CellEntityIds` or their like (the report names it), the\nfirst physical group of the volume (gmsh; of the surface in a surface file), the reference (Medit) or the first\nattribute (TetGen); regions is NULL when all are 0. VTU: pieces are joined as they are, see sb_mesh_merge_nodes.\n\nA volume mesh is checked with sb_mesh_validate. When all its elements are inverted, that is the file's\nconvention: they are turned and counted in the report. A surface is loaded as it is, since scans are seldom\nperfect: look at it with sb_mesh_check.\n\nNot read: VTK's files that are compressed with LZ4 or LZMA, parallel files (.pvtu: load their pieces), polyhedra.\n\nSB_ERROR_ARGUMENT (null pointer, options), _FILE (cannot be read), _FORMAT, _NOT_FINITE (coordinate, also\none too large for sb_real), _INDEX (node that does not exist), _MESH (inverted or flat elements, no\nelements), _UNSUPPORTED (names the version, data set or element type) or _MEMORY.",
    'sb_mesh_load_memory': 'Reads a mesh from memory, as sb_mesh_load does from a file.\n\ndata     [size] bytes, borrowed during the call; may be NULL when size is 0\nformat   SB_FILE_AUTO or any but SB_FILE_TETGEN, which needs two files\nname     stands for the path in errors and in telling the format; may be NULL',
    'sb_mesh_save_vtk': 'Writes a legacy VTK 3.0 unstructured grid in ASCII, with fields, and mesh->regions as the cell field\n`region`. The numbers are exact: %.17g (%.9g when sb_real is float). fields may be NULL when field_count\nis 0.',
    'sb_mesh_save_vtk_binary': "The same in VTK's big-endian binary form: smaller, faster, exact.",
    'sb_mesh_save_obj': 'OBJ with v and f lines, exact numbers.',
    'sb_mesh_save_stl': 'Binary STL: coordinates are rounded to float, shared vertices and unused nodes are lost, quad4 become two\ntriangles.',
    'sb_mesh_save_ply': 'Binary little-endian PLY, coordinates in the precision of sb_real.',
    'sb_image_load': 'Reads a label image; the format follows from the content.\n\nimage    overwritten on success (free it first when it owns labels), untouched on failure; sb_image_free\noptions  scale (multiplies origin and spacing) and allocator are read; NULL: sb_default_load_options()\nerror    may be NULL; file and line (line 0 in binary parts, where the message has the byte offset)\n\nVTK files: the first array of one number per point (or cell, where no point has one) is taken. Images of two\ndimensions have one layer of voxels. Values of any numeric type are taken where they are whole numbers that fit an\nint. Header files (.mhd, .nhdr) name their data file, which is looked for beside them, and nowhere else.\n\nSB_ERROR_ARGUMENT, _FILE, _FORMAT (also: data cut off, more of it than the header says, a value that is no label),\n_NOT_FINITE (origin, spacing, a value), _UNSUPPORTED (names what: more dimensions, vectors, a compression, pieces),\n_MEMORY.',
    'sb_image_load_memory': 'The same from data[size] in memory, borrowed during the call; files that name a data file are SB_ERROR_UNSUPPORTED.\nname stands for the path in errors; may be NULL.',
    'sb_image_is_file': '1 when the file begins as a label image does: to choose between sb_image_load and sb_mesh_load. 0 also for a file\nthat cannot be read.',
    'sb_image_free': 'Releases the labels and zeroes the struct. Safe on {0} and on NULL.',
    'sb_image_check': 'Whether the fields are as described above: SB_ERROR_ARGUMENT (names the field), _NOT_FINITE.',
    'sb_image_next_label': 'The smallest label above `after`: 1 and *label, or 0 when there is none. O(voxels). All labels but background:\n    for (int label = 0; sb_image_next_label(&image, label, &label);) ...   (those below 0: start at INT_MIN)',
    'sb_image_label_at': 'Label of the voxel that holds the point (m); 0 outside the image. Labels of many points: sb_image_set_regions.',
    'sb_image_surface': "The boundary of labels as a mesh of tri3, oriented outward (cavities inward), closed and manifold whatever the\nvoxels: no edge of more or fewer than two triangles, no node where parts touch, no two triangles that cross. It\npasses between the centres of voxels inside and outside, all of which stay on their side, so nothing is lost and\nnothing joins: also what is one voxel thick. Voxels that touch along an edge or in a corner only are parts of their\nown. Beyond the image is outside.\n\nThe inside (1) and the outside (0) are filtered along each axis of the image by (1 2 1) / 4, `smoothing` times: G.\nWhat that takes from round parts comes back in (2 + sqrt 2) G - (1 + sqrt 2) G G, and the level near 1/2 (by up to\n1/8) is taken at which the surface encloses the voxels' volume. Voxels that end up on the wrong side get a value that\nputs the surface half-way to their neighbours. Measured: the volume is that of the voxels to 1e-4 for balls of radius\n2 to 22 voxels, a torus, and plates 1, 2 and 3 voxels thick; single voxels and the smallest parts lose up to 5/6 of\ntheirs. Look at report->volume where parts are that small.\n\nmesh: overwritten, not freed. report: or NULL. Failures leave both untouched: SB_ERROR_ARGUMENT (a field, named; no\nvoxel has the labels), _NOT_FINITE (of the image), _UNSUPPORTED (more nodes or triangles than an int counts),\n_MEMORY. Two triangles for each face between voxels, and more where the surface is rough. Scratch: 8 bytes for each\nvoxel of the box round the labels. O(voxels). The same bits each time.\n\nSource: marching cubes (Lorensen, Cline 1987) with loops traced face by face instead of a table: on a face whose\ncorners alternate, voxels inside stay apart, so that both its cubes agree. Loops of five and more nodes, and those of\nfour that meet one face twice, are filled round a centre, which no other triangle can touch.",
    'sb_image_set_regions': "Makes the regions of a mesh's elements their labels: that of most of a sample of points (the centre, and the points\nhalf-way from there to each node). Background (0) does not count, since the skin of a mesh cuts through voxels; where\nall points lie in it the nearest label is taken, up to two voxels away, and 0 if there is none. mesh->regions is made\nwith mesh->allocator where it is NULL. SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX, _MESH (of the mesh's arrays), _MEMORY:\nthe mesh is as it was. O(elements).",
    'sb_surface_create': 'Makes a surface of a mesh of tri3, tri6, quad4, quad8 or quad9; faces other than tri3 are cut into flat triangles\nbetween their nodes. Nodes are copied. Surfaces that are open, touch themselves or have degenerate triangles are\nwelcome (scans are like that): sb_surface_check reports it, and each query below says what it then means. One block\nof memory from `allocator` (NULL: malloc) for everything (about 280 bytes per triangle), plus scratch that goes back.\nO(triangles log triangles), about 0.1 s for 100,000. SB_ERROR_ARGUMENT (null pointer, a mesh of volumes: take\nsb_mesh_boundary), _MESH (empty, or too many triangles), _NOT_FINITE, _INDEX, _MEMORY; then *surface is untouched.',
    'sb_surface_move': 'Moves the nodes to nodes[sb_surface_node_count] (m) and refits boxes, normals and far fields in one pass over the\ntriangles, in parallel on `jobs` (NULL: inline). The tree keeps its shape: answers stay right however far the surface\ndeforms, and stay fast as long as neighbours stay near each other. Closest points, rays and signs are those of a new\nsurface, to the bit. Allocates nothing. SB_ERROR_ARGUMENT or _NOT_FINITE (error->node): nothing has changed.',
    'sb_surface_triangle_count': 'nodes of the mesh, also those of no triangle',
    'sb_surface_triangle': "Nodes of a triangle, in the order of the mesh's numbering; the mesh's element it was cut from is returned. -1\n(nothing written) when there is no such triangle. nodes may be NULL.",
    'sb_surface_bounds': 'Smallest box around the triangles (m).',
    'sb_surface_is_closed': '1 when every edge is run through as often one way as the other: the surface then bounds a solid, its winding number\nis whole, and distances have an unquestionable sign.',
    'sb_surface_bytes': 'Bytes of its block of memory.',
    'sb_surface_closest': 'Closest point of the surface within max_distance (m, >= 0; SB_REAL_MAX: any). 1 and *hit, or 0 when nothing is as\nnear or an argument is NULL or NaN. hit may be NULL: only whether. O(log triangles).',
    'sb_surface_closest_from': 'The same with a triangle that is likely to be near (that of the last query, or of a neighbour; any other number: no\nidea): the same answer, sooner.',
    'sb_surface_ray': 'First triangle that the ray from origin along direction (any length but 0) meets within max (m, >= 0; SB_REAL_MAX:\nany), from either side. 1 and *hit (or NULL), or 0. No ray slips through between triangles that share an edge or\ncorner; triangles seen exactly edge-on are not met. Source: Woop, Benthin, Wald 2013.',
    'sb_surface_ray_all': 'All triangles that the ray meets within max: returns how many, and the first `capacity` of them in hits (may be NULL\nwith capacity 0: only count), nearest first. A ray through an edge meets both its triangles.',
    'sb_surface_signed_distance': 'Distance to the surface (m), negative inside. *hit (or NULL): the closest point. The sign is that of the\nangle-weighted pseudonormal at the closest point (Baerentzen, Aanaes 2005), exact for closed surfaces that do not\ncross themselves; where that normal means nothing (at degenerate triangles, edges of more or fewer than two\ntriangles, corners where parts touch, folds), sb_surface_inside decides. On an open surface the sign says which side\nof the nearest triangle the point is on.',
    'sb_surface_signed_distance_winding': 'The same with the sign from sb_surface_inside everywhere: for surfaces with holes, overlaps or loose parts. About\ntwice the time far from the surface, nine times close to it, where the winding number sums many triangles exactly.',
    'sb_surface_winding_number': 'Generalised winding number: the solid angle under which the point sees the surface, over 4 pi. 1 inside a closed\nsurface, 0 outside, in between near holes; 2 where two solids overlap. Near triangles are summed exactly, groups of\nfar ones by their Taylor expansion to second order (Barill et al. 2018, beta 2): within 0.05 of the exact sum.\nO(log triangles).',
    'sb_surface_winding_number_exact': 'Every triangle summed exactly. O(triangles).',
    'sb_surface_inside': '1 where the winding number is 1/2 or more.',
    'sb_surface_normal': 'Unit pseudonormal at a hit, pointing outward: of the face, the mean of the two at an edge, angle-weighted at a\ncorner; 0 where there is none (degenerate triangles) or for no hit.',
    'sb_surface_closest_batch': '---- many queries, in parallel on `jobs` (NULL: inline) ---------------------------------------------------------\nEach gives for points[count] what the single query gives, to the bit. Faster still when neighbours in the array are\nneighbours in space. Nothing happens for NULL or a count below 1.',
    'sb_surface_signed_distance_batch': 'distances[count]; hits[count] or NULL.',
    'sb_surface_check': 'Looks a mesh of tri3, tri6, quad4, quad8 or quad9 over. SB_OK also for a bad surface; fails as sb_surface_create\ndoes, and then leaves *report alone. Faces count as the mesh has them; crossings are looked for between the triangles\nthey are cut into. Triangles that only touch do not cross. O(faces log faces), also where all faces coincide, share a\nnode or are stacked; about 0.4 s for 100,000 triangles.',
    'sb_surface_check_string': 'One sentence that names the finding, e.g. "edges of one face only"; "unknown finding" for no single one. Static.',
    'sb_surface_require': 'sb_surface_check that fails with SB_ERROR_MESH when it finds one of `findings` (a sum of them, as\nSB_SURFACE_NOT_SOLID): the message names the first, how many and where, error->element the first element, or\nerror->node the node. report (or NULL) is written then too.',
    'sb_surface_triangulate': "The mesh of flat triangles between the nodes of a surface's faces; regions and nodes are kept. Fails as\nsb_surface_create; the output is overwritten, not freed.",
    'sb_surface_repair': 'Repairs a mesh of tri3 (others: sb_surface_triangulate first; SB_ERROR_UNSUPPORTED). def and report may be NULL\n(defaults; not wanted). What cannot be mended stays: check afterwards. New arrays come from mesh->allocator, the old\nones go back to it. SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX, _MEMORY, _MESH (empty, nothing left, or one-sided like a\nMoebius strip): the mesh is as it was.',
    'sb_mesh_stuff': 'Makes the mesh: positively oriented tets with regions, all nodes used, ready for sb_body_create.\n\nEvery dihedral angle lies in 10.7 to 164.8 degrees, for one shape or several, with levels or without: what is cut or\nmoved belongs to cells of the finest size only, and the tets between sizes have 45 to 120 degrees.\n\nThe boundary is closed and manifold. Its nodes lie on the surface, but for a few (by less than a third of a cell)\nwhere the shape is about as thin as a cell or angles would suffer. Where its triangles cut a corner by more than 0.3\ncells, nodes slide along the surface and edges are split as long as the angles allow it; when that does not bring the\nboundary within a third of a cell (a thin part ends between lattice points), up to twelve places of the lattice are\ntried and the nearest mesh is kept. Look at report->distance where it matters: it is larger still for some shapes\nwith sharp thin parts. What is thinner than a cell may be missing, in part or as a whole, or join across a gap; parts\nthat come loose stay (sb_mesh_components finds them). report->volume_share and surface_share report how much is\nmissing; where it is more than def->least_share allows, there is no mesh but an error that names a cell for the\nthickness of what is missing.\n\nmesh: overwritten, not freed. report: or NULL. Nodes and elements are numbered as by sb_mesh_reorder; the same bits\nfor any number of threads. Failures leave mesh and report untouched: SB_ERROR_ARGUMENT (field named; more cells or\nelements than allowed, the message has their number), SB_ERROR_NOT_FINITE (field, or a point where the distance is\nnot), SB_ERROR_MESH (less than least_share is kept, or nothing: the cell is too large; a surface, or a part of it, is\ninside out: error->element is one of its faces),\nSB_ERROR_CANCELLED, SB_ERROR_MEMORY. Cost: distances are taken near the surfaces only, O(surface); two bytes per\ncell of the box, the rest O(mesh).',
    'sb_material_linear': '---- constructors ------------------------------------------------------------------------------------\nyoung [Pa] > 0, poisson in (-1, 0.5), density [kg/m^3] > 0. Nothing is checked here: parameters out\nof range give a material that sb_material_check refuses.',
    'sb_material_neo_hookean_isochoric': "c10 [Pa] > 0, d1 [1/Pa] > 0: Abaqus' and CalculiX' constants, mu = 2 c10 and bulk = 2/d1.",
    'sb_material_mooney_rivlin': 'The same convention with mu = 2 (c10 + c01) > 0; c10 or c01 [Pa] may be 0 or negative, at the price of a\nmaterial that softens or turns unstable under large strain.',
    'sb_material_reduced_polynomial': 'Reduced polynomial of order 3 (Yeoh 1993); c30 = 0: order 2. c10 [Pa] > 0, mu = 2 c10; c20 and c30 [Pa] of\nany sign: a negative one that is not outweighed makes the material unstable under large strain.',
    'sb_material_ogden': "Ogden's material with 1 to SB_MAX_OGDEN_TERMS terms mu[terms] [Pa] and alpha[terms], of any sign; its shear modulus\nis sum of mu_i alpha_i/2 > 0. (Abaqus' mu_i is alpha_i/2 times this one.) One term with alpha 2 is neo-Hookean, two\nwith 2 and -2 are Mooney-Rivlin. Another number of terms gives a material that sb_material_check refuses.",
    'sb_material_fung': "Fung's exponential: c10 [Pa] > 0 as above, exponent b >= 0 (0: neo-Hookean): stiffness grows with exp(b (I1b - 3)).\nDirections: sb_material_with_fibres.",
    'sb_material_custom': "A law of the caller's own, lent, see sb_material_law, and bulk [Pa] >= 0 that the library adds as (J - 1)^2/d1,\nd1 = 2/bulk. A law of F J^(-1/3) alone with its bulk modulus here is what elements that do not lock (B-bar) need:\nthey evaluate the law at each point and the bulk term in the mean. A law that has its own volume term goes with bulk\n0, and locks as any fully integrated element. Prony terms relax the law and leave the bulk term. lambda and mu are\nthose of the law's tangent at F = I, averaged over directions; they scale tolerances and steps. NULL, a call that is\nmissing or a law without a tangent at F = I give a material that sb_material_check refuses.",
    'sb_material_with_fibres': 'The hyperelastic material, reinforced by one family of fibres (Holzapfel, Gasser and Ogden 2000):\n    W += k1/(2 k2) (exp(k2 (I4 - 1)^2) - 1) for I4 > 1, I4 = |F a0|^2, a0 the unit direction at rest,\nand k1/2 (I4 - 1)^2 for k2 = 0; slack fibres (I4 <= 1) do nothing. k1 [Pa] >= 0, k2 >= 0. The moduli lambda, mu\nstay those of the matrix.',
    'sb_material_with_dispersion': 'Fibres that point not all alike (Gasser, Ogden and Holzapfel 2006): the strain I4 - 1 above becomes\n    E = kappa I1 + (1 - 3 kappa) I4 - 1,\nkappa in [0, 1/3]. I1 and I4 are those of F, as above, so that a growing volume stretches fibres; at constant volume\nthis is the published model. Slack: E <= 0. A body may have a second family of them, see sb_body_def.second_fibres.',
    'sb_material_with_contraction': 'The hyperelastic material, contracting along its fibres with a tension [Pa] >= 0 per area at rest, at stretch l = |F\na0| P += T f(l) (F a0) (x) a0/l,   f = max(0, 1 - ((l - optimum)/width)^2), or 1 for width 0, along each family\nalike, dispersion left out, not relaxing. With or without passive fibres (k1 = 0). Drive the tension in time by\nsb_body_set_tension. Beyond the optimum the tangent is not positive definite.',
    'sb_material_with_prestretch': "The hyperelastic material, strained where the mesh is at rest: G takes each piece of it from where it had no stress\nto its shape in the mesh, det G > 0, so that\n    W'(F) = W(F G) / det G,   P = P(F G) G^T / det G\nper volume of the mesh, fibres included, whose directions are those in the mesh at rest. Stress that an organ has\nwhere it was imaged, by region: arteries that draw together when cut, tendons under tension, swelling (G = s I, s <\n1). The mesh's own shape is then balanced only where supports hold it, or the regions' stresses each other: statics\nfind the balance, and a body of one G that nothing holds goes to F = G^-1, where it has no stress. Moduli, density\nand tolerances stay those of the material and the mesh. Prony terms let this stress relax as any other, from when the\nbody first moves. G = I takes it away. Source: Hoger 1986; Gee, Foerster and Wall 2010.",
    'sb_material_with_prony': 'A count out of range is kept for sb_material_check to refuse; NULL counts as one.',
    'sb_material_preset': 'A material by name; liver has a density of about 1060 kg/m^3. An unknown preset gives a material that\nsb_material_check refuses.',
    'sb_material_young': "Constants of the small-strain limit: Young's modulus [Pa], Poisson's ratio, bulk modulus [Pa].",
    'sb_material_check': "Checks model, finiteness and ranges of a material (mu > 0, bulk > 0, density > 0, Poisson's ratio in\n(-1, 0.5); isochoric: c10 + c01 > 0, d1 > 0 and in agreement with lambda, mu; fibres, prestretch and Prony terms as\ntheir constructors say, and on hyperelastic models only). Returns SB_OK, or SB_ERROR_ARGUMENT (NULL, unknown\nmodel, count of Prony terms), SB_ERROR_NOT_FINITE or SB_ERROR_MATERIAL with the offending value in error (may\nbe NULL). It does not decide whether a material stays stable under large strain: see sb_material_fit.",
    'sb_material_allows_inversion': '1 when the model has a finite energy for J <= 0; 0 when it needs J > 0 (or is unknown, or a law that decides itself).\nSB_SVK has one, but does not oppose inversion: it has the same value for F and its mirror image, so an inverted\nelement may come to rest.',
    'sb_material_is_linear': '1 when the tangent does not depend on F.',
    'sb_material_is_hyperelastic': '1 for the models that take fibres and Prony terms: all but the linear and corotated ones.',
    'sb_material_energy': 'W = elastic energy per reference volume [J/m^3].',
    'sb_material_stress': 'P = dW/dF, first Piola-Kirchhoff stress [Pa]: force per reference area, P N = traction.',
    'sb_material_tangent': "A[9*(3*i+j) + (3*k+l)] = dP_ij/dF_kl [Pa], 81 values, exactly symmetric.\n\nThe corotated models' energy has a kink where the rotation is not unique, at s_2 + s_3 = 0 for principal\nstretches s_1 >= s_2 >= |s_3|: there the exact tangent is infinite. A divides by s_i + s_j, but never by\nless than 1e-6 max(1, s_1 + s_2 + s_3), so it stays finite; SB_TANGENT_SPD likewise. SB_TANGENT_QUASI does\nnot divide by it.",
    'sb_fibre_energy': "---- fibres ----\nThe fibres' share at F, ADDED to the output; the calls above are the matrix alone. direction: of the fibres at\nrest, of any length but 0. All return 1, or 0 with the output untouched when F or the direction is not finite,\nthe direction is 0, the result overflows or a pointer is NULL. A material without fibres adds nothing. What is\npassive of the tangent is positive semidefinite as it stands; contraction included, it is exact.",
    'sb_material_relaxation': 'g(t): the share of a relaxing stress that is left a time t [s] after a sudden strain; 1 for t <= 0.',
    'sb_material_shear_moduli': "Storage and loss modulus [Pa] of small shear that oscillates with omega [rad/s] >= 0:\n    G' = mu (1 - sum g_i/(1 + x_i^2)),   G'' = mu sum g_i x_i/(1 + x_i^2),   x_i = omega tau_i;\nmu and 0 without Prony terms, zeros for NULL. storage and loss may be NULL. Fit: sb_material_fit_moduli.",
    'sb_material_history_stress': 'Moves one point by dt [s] >= 0 (0: a jump; infinite: fully relaxed) to F and gives its stress there, fibres\nincluded: the formula that bodies step by, to draw relaxation curves and to fit them. Exact where S0 changes\nevenly within each step, of second order otherwise. fibre: direction of the fibres at rest, NULL for none.\n*P [Pa]: first Piola-Kirchhoff stress. Returns 1, or 0 with history and P untouched when F is not admissible\n(see above; also J = 0), dt is negative or NaN, Prony terms are out of number or on a model that is not\nhyperelastic, or a pointer but fibre is NULL.',
    'sb_cauchy_stress': 'Cauchy stress P F^T/J [Pa]: force per current area. Not finite when J = 0.',
    'sb_material_cauchy_stress': "The same for a material's P; P itself for SB_LINEAR: small strain does not distinguish the stresses.",
    'sb_von_mises': 'Von Mises equivalent sqrt(3/2 s:s) [Pa], s the deviator of a symmetric stress.',
    'sb_material_fit': "Fits a model to count readings of any tests together: mu, or c10 and c01, or c10, c20, c30; the compressibility is\nthe options'. options NULL: defaults; info, error may be NULL. Returns SB_OK and *material, which passes\nsb_material_check; or, with *material and *info untouched: SB_ERROR_ARGUMENT (fewer readings than constants, a\nstretch <= 0, an option out of range, SB_OGDEN or SB_FUNG, whose exponents no linear fit finds), SB_ERROR_NOT_FINITE,\nSB_ERROR_INDEFINITE naming a constant that the data do not distinguish from the others (simple shear and planar tests\nalone see c10 + c01 only), SB_ERROR_MATERIAL (the data ask for mu <= 0), SB_ERROR_NOT_CONVERGED or SB_ERROR_DIVERGED\n(compressible only). Cost: below a microsecond a reading at constant volume, about 0.1 ms when compressible.\nFormulas: Ogden, Non-Linear Elastic Deformations, 1984, ch. 7.",
    'sb_material_fit_prony': 'Fits Prony terms to the relaxation g(time[k]) of a sudden strain: stress over its value at time 0; time [s] > 0.\ntau[terms] [s]: the relaxation times to use, each > 0; NULL: spread evenly in log time from the first to the last\nreading. terms in 1 to SB_MAX_PRONY_TERMS. Nonnegative least squares: terms that the data do not ask for are left\nout, so fewer may come back. On SB_OK *material, which comes in hyperelastic and in order, has these Prony terms in\nplace of its own. Else it and *info are untouched: SB_ERROR_ARGUMENT (fewer readings than terms, a time or tau <= 0),\nSB_ERROR_NOT_FINITE, SB_ERROR_INDEFINITE naming a given tau that the data do not distinguish from the others, or\nSB_ERROR_MATERIAL (the data relax to nothing, or the material is not in order).',
    'sb_material_fit_moduli': "Fits Prony terms and the shear modulus to storage[count] and loss[count] [Pa] >= 0 of shear that oscillates with\nomega[count] [rad/s] > 0 (a rheometer's G' and G''), errors relative to |G*| of each reading. tau, terms and errors\nas above; tau NULL: spread evenly in log time over 1/omega. On SB_OK *material has these terms in place of its own\nand all of its moduli in proportion, so that mu is the instantaneous modulus and Poisson's ratio stays; info->rms is\nthe relative error of G*. SB_ERROR_ARGUMENT also for fewer than (terms + 1)/2 readings, a modulus below 0, or both 0;\nSB_ERROR_MATERIAL where the data have no modulus left at low frequencies: they are of a fluid, or end too early.",
    'sb_matrix_create': "Makes the matrix whose nodes are coupled when they share a cell (an element, a particle's neighbours ...);\nall values are zero. Nodes without a cell keep their diagonal block.\nnode_count      number of nodes, >= 1\ncell_count      number of cells, >= 0\nnodes_per_cell  nodes of each cell, >= 1; ignored when cell_start is given\ncell_start      [cell_count + 1] first entry of each cell in `cells`, ascending from 0; NULL: fixed size\ncells           node indices of the cells; a node may repeat within a cell\nallocator       NULL: malloc\nReturns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error->element is the cell) or SB_ERROR_MEMORY (also when there\nwould be more than 2^31-1 blocks) with *matrix untouched. Release with sb_matrix_free. Time and scratch\nmemory are proportional to the cells' node pairs.",
    'sb_matrix_free': 'Releases the arrays and zeroes the struct; a zeroed matrix is fine.',
    'sb_matrix_clear': 'Sets all values to zero and clears the constraint mask.',
    'sb_matrix_find': 'Position of block (i, j), or -1 when the pattern has none or an index is out of range. Time O(log row).',
    'sb_matrix_multiply': 'y = A x; x and y are [row_count][3] and must not overlap. jobs NULL: inline.',
    'sb_matrix_asymmetry': 'Largest |A_ij - A_ji| divided by the largest |A_ij|; 0 for a zero matrix, NaN when an entry is.',
    'sb_matrix_diagonal_scale': 'Mean of |A_kk| over the free scalar rows (mask NULL: all), the scale given to constrained ones; 1 when\nthere are none or all are zero, not finite when an entry is not.',
    'sb_matrix_constrain': 'Replaces the equations of prescribed components by s x_k = s value_k, s = sb_matrix_diagonal_scale, keeping\nsymmetry: the known terms move to the right-hand side, rhs -= A[:, k] value_k, before rows and columns k\nare zeroed.\nmask    [row_count] SB_X | SB_Y | SB_Z; copied into matrix->fixed\nvalues  [row_count][3] prescribed values, read where the mask says so; NULL: all zero\nrhs     [row_count][3] changed in place; NULL: only the matrix is changed\nNeeds a symmetric matrix; touches the constrained rows and their transposed blocks only. The diagonal stays\nas large as its neighbours so that neither the condition number nor a relative residual notices the\nreplaced rows.',
    'sb_direct_create': 'Orders and analyses the pattern (values are not read) and takes all memory that is ever needed. allocator NULL:\nmalloc. def NULL: the default. *direct is released with sb_direct_free and refers to neither def nor pattern.\nReturns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error->node) or SB_ERROR_MEMORY; *direct is then\nuntouched.',
    'sb_direct_update': 'Factors a symmetric matrix of the pattern; allocates nothing. Returns SB_ERROR_ARGUMENT (another pattern),\nSB_ERROR_NOT_FINITE (error->node) or SB_ERROR_INDEFINITE when a pivot is negative (Cholesky) or lost in rounding\n(error->node tells its node). After an error it must be updated again before it can solve.',
    'sb_direct_solve': "Solves A x = rhs for `count` right-hand sides; rhs and x are [count][row_count][3] and may be the same array. Several\nat once cost much less than one after the other, and each gives the bits that it gives alone. Uses the solver's\nscratch: one call at a time. Returns SB_ERROR_ARGUMENT (also when the last update failed): x is then untouched.",
    'sb_domain_create': "Makes the domain of a volume mesh's elements. single_rotation: 1 for tet10 with one rotation per element.\nFails with SB_ERROR_MESH naming the element when a Jacobian at an integration point is not positive,\nSB_ERROR_NOT_FINITE or SB_ERROR_INDEX naming the node, SB_ERROR_ARGUMENT for a surface mesh, single_rotation or\nSB_INTEGRATION_BBAR on another element, or both together, SB_INTEGRATION_PATCH on another than tet4,\nSB_ERROR_UNSUPPORTED for an element that SB_ELEMENT left out, SB_ERROR_MEMORY; *domain is then untouched. Release\nwith sb_domain_free. Source: formula of the isoparametric map, g_a = Je^-T dN_a/dxi.",
    'sb_domain_free': 'Releases the arrays and leaves zeros; {0} and NULL are fine.',
    'sb_solver_auto': "What SB_PRECOND_AUTO becomes for matrices of this pattern when positions are given: SB_PRECOND_IC0 with its coarse\nspace up to 140,000 blocks, which are some 10,000 nodes of tet4 and 5,500 of tet10 or hex8, and\nSB_PRECOND_MULTIGRID above, where it takes less time on one core already (tests/bench/RESULTS.md has the figures).\nLong steps, nu 0.49 and jumps of the modulus by 1,000 (that the def's moduli tell) take up to twice its iterations.\nFrom rest such jumps cost IC0 three times its own, many small stiff inclusions ten times: of tet10 multigrid then\ntakes half the time from some 90,000 blocks on, so name it for bodies that are solved so. Steps of moving ones\nbegin near the answer; of 107,000 to 253,000 blocks they take with IC0 0.4 to 1.6 times the time on two cores. The\nchoice does not depend on the number of threads, so results do not. Without positions it is SB_PRECOND_IC0. NULL:\nSB_PRECOND_IC0.",
    'sb_precond_string': 'Name of a kind, as "multigrid"; never NULL.',
    'sb_default_preconditioner_def': 'The defaults named at the fields.',
    'sb_preconditioner_moduli': 'moduli[block_count] of a def from those of the cells.\npattern         made of the cells, by sb_matrix_create or wider; blocks whose nodes share no cell get 0\ncells           [cell_count][nodes_per_cell]\nyoung           [cell_count] (Pa), >= 0\nReturns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error->element: a node outside, or no block for two nodes) or\nSB_ERROR_NOT_FINITE; what moduli holds is then unspecified. Time as an assembly.',
    'sb_preconditioner_create': 'Makes a preconditioner for matrices of this pattern (values are not read) with all memory it ever needs.\nallocator NULL: malloc. *out is released with sb_preconditioner_free and refers to neither def nor pattern.\nReturns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error->node; a modulus) or SB_ERROR_MEMORY; *out\nstays.',
    'sb_preconditioner_update': 'Takes over the values of a symmetric matrix of the pattern, without rotations; allocates nothing.\npositions  [row_count] where the nodes are now, for the rigid motions of the pieces, taken over even when the factor\n           fails; NULL: as before\nReturns SB_ERROR_ARGUMENT (another pattern), SB_ERROR_NOT_FINITE, or SB_ERROR_INDEFINITE when a diagonal\nblock is not positive definite or no diagonal shift up to some 65 makes the incomplete factor exist. After an\nerror the preconditioner must be updated again before use.\nAn IC0 that breaks down starts again with a larger diagonal (at most 17 times), keeps that shift for the\nfollowing updates, and after a run of successful ones tries a smaller one.',
    'sb_preconditioner_apply': "z = M^-1 r; both [row_count][3], not overlapping. Uses the preconditioner's scratch: one call at a time.",
    'sb_preconditioner_warp': "Turns the smoother of the last update (or load) with the body instead of making it anew:\n    M^-1 = R S R^T on the free components, the inverse diagonal on those prescribed now\nwith R of the nodes' rotations since then; the coarse space is that of the matrix. The tangent of a bent body is\nnearly that of the unbent one turned, so that M made at rest serves through large motions. Positive definite whatever\nthe rotations.\nmatrix     what is to be solved now, of the same pattern\nrotations  [row_count] unit quaternions, as sb_body_nodal_rotations gives; NULL: none\npositions  as in sb_preconditioner_update\nReturns SB_ERROR_ARGUMENT (another pattern, nothing to turn, or error->node's rotation is no unit quaternion),\nSB_ERROR_UNSUPPORTED (multigrid: update it) or SB_ERROR_NOT_FINITE; the preconditioner is then as it was. Costs a\npass over the nodes, and for the coarse space one over the matrix; allocates nothing.",
    'sb_preconditioner_saved_size': 'Bytes that sb_preconditioner_save writes; 0: more than size_t holds, or multigrid.',
    'sb_preconditioner_save': 'Writes the smoother of the last update, without rotations and coarse space, to buffer[size]; what is behind\nsb_preconditioner_saved_size stays. SB_ERROR_ARGUMENT: NULL, too small a buffer (then untouched), or never\nupdated.',
    'sb_preconditioner_load': "The smoother becomes what was saved from a preconditioner of the same kind, power and pattern, of IC0 also with a\ncoarse space if this one has one, or without, where that changes the factor's order; it is without until\nsb_preconditioner_warp. All is checked before anything changes: SB_ERROR_FORMAT (no saved preconditioner, cut\nshort, damaged, a value out of its range), SB_ERROR_UNSUPPORTED (other version or precision), SB_ERROR_STATE\n(another kind, power or pattern, or a factor in another order), SB_ERROR_NOT_FINITE, SB_ERROR_ARGUMENT. Allocates\nnothing.",
    'sb_default_pcg_options': 'The defaults named at the fields.',
    'sb_pcg_workspace_create': 'Takes the vectors for systems of row_count >= 1 nodes. SB_ERROR_ARGUMENT or SB_ERROR_MEMORY leave\n*workspace untouched. Release with sb_pcg_workspace_free. allocator NULL: malloc.',
    'sb_pcg_solve': "Solves A x = rhs for a symmetric positive definite A.\npreconditioner  up to date with A; NULL: none\nrhs             [row_count][3]\nx               [row_count][3] in: the start; out: the solution. rhs = 0 gives x = 0 whatever the start, in each part\noptions         NULL: defaults\ninfo            filled in every case but SB_ERROR_ARGUMENT; may be NULL\nReturns SB_OK;\n  SB_ERROR_NOT_CONVERGED  the cap was reached, or rounding stops progress (info->capped tells which); x is\n                          the last\n                          iterate, good enough for a real-time step that had no time for more\n  SB_ERROR_INDEFINITE     p.Ap <= 0 (info->negative_curvature) or a preconditioner that is not positive\n                          definite;\n                          x is the last iterate before\n  SB_ERROR_DIVERGED       a NaN or infinity, in the input or grown; x is the start again\n  SB_ERROR_ARGUMENT       sizes that do not match, options out of range; x untouched\nParts that the pattern of A does not connect are solved as if each were alone, side by side: with step lengths of its\nown and to a residual relative to its own rhs, so that a crumb of 1e-9 of the forces is as good as the organ beside\nit. Parts whose rhs is below some 1e-31 of the whole are left alone, which is what single precision holds beside 1.\nWith levels of one's own that couple parts (sb_preconditioner_def) all rows are one part. Iterations are those of the\npart that needs most.\nTolerances whose cube is below SB_EPSILON are near what the recurrence can hold: there the true residual is\ncomputed at the end, and the iteration goes on from it if it has drifted. No x of sb_real can have a\nsmaller residual than about SB_EPSILON |A| |x|: in float builds that is 1e-4 |rhs| for a soft beam of 2,000\nnodes. Sums are taken in double over fixed chunks of rows, added in order: same bits for any number of\nthreads.\nMultigrid has the matrix of its update in 32 bits an entry, which has half the bytes, but where moduli jump (and in\nfloat builds): directions are multiplied by that one, the true residual is computed with the matrix itself, and where\nthe two part the iteration goes on from the true one, at last without the other. So the residual holds for the matrix\ngiven whatever the preconditioner was made of.",
    'sb_grid_create': 'Makes a grid. Same bits for any threads. SB_ERROR_ARGUMENT (a field out of range, named), SB_ERROR_NOT_FINITE (box,\ncell_size, or a distance), SB_ERROR_MESH (no cell has anything inside, or a surface or a part of it is inside out),\nSB_ERROR_UNSUPPORTED (more cells than an int counts, more points than max_points), SB_ERROR_CANCELLED,\nSB_ERROR_MEMORY; *grid is untouched. Cost: for each cut cell some 4^level distances.',
    'sb_grid_map_points': 'Rows of points[count] (m), in their order. A point outside all kept cells belongs to the nearest one, whose shape\nfunctions go on outside: rows give back positions, and carry the force and moment of a load, exactly all the same.\nSB_ERROR_ARGUMENT names (error->node) the first that is farther away than the longest edge of a cell,\nSB_ERROR_NOT_FINITE one that is not finite; SB_ERROR_MEMORY. *rows is untouched then. O(count). Source: eqs. 4.4,\n4.16.',
    'sb_grid_map_surface': "Rows of integration points of triangles[count] (indices of elements; NULL: of all, count is not read) of a tri3 mesh,\ncut finely enough for the cells: one for a triangle with edges up to half a cell, otherwise three in each of its\npieces with edges up to a cell. Their areas sum to that of the triangles, and their moments are exact. Errors as\nabove, and SB_ERROR_INDEX (a triangle), SB_ERROR_MESH (one without area), SB_ERROR_UNSUPPORTED (more rows than an int\ncounts).\n    Penalty displacements (eqs. 4.18-4.21): sb_body_add_mapping(body, &rows.rows, stiffness, 0, targets, ...) with\n    stiffness[j] = kappa areas[j], kappa (Pa/m) some 10 to 100 times Young's modulus over the cell size.",
    'sb_grid_add_traction': 'forces[nodes of the grid] (N) += what tractions[row_count] (Pa on the undeformed area), or one for all when uniform\nis 1, exert on the nodes; hand them to sb_body_add_forces. Rows need areas; others change nothing. Source: eqs.\n4.14-4.17.',
    'sb_mixture_create': 'Makes a mixture. SB_ERROR_ARGUMENT (a field out of range, named; a surface mesh), SB_ERROR_NOT_FINITE (a distance;\nerror->element), SB_ERROR_MESH (a surface or a part of it is inside out, or what sb_mesh_validate and\nsb_domain_create refuse), SB_ERROR_INDEX, SB_ERROR_UNSUPPORTED (SB_CUSTOM, an element left out by SB_ELEMENT, more\nelements than an int counts), SB_ERROR_MEMORY; *mixture is untouched. Calls `distance` from one thread.',
    'sb_kernel_value': 'W (1/m^3) and dW/dr (1/m^4) at distance r (m, >= 0) for the radius h (m, > 0); 0 for an unknown kernel and where an\nargument is out of range.',
    'sb_particles_create': 'Makes particles. Same bits for any threads. SB_ERROR_ARGUMENT (a field out of range, named), SB_ERROR_NOT_FINITE (a\npoint, a number, or what volumes sum up to), SB_ERROR_MESH (error->node names a particle at the place of another,\nerror->element a point whose neighbours stay in a plane after growing; nothing is inside), SB_ERROR_UNSUPPORTED (a\npoint with more particles than SB_MAX_ELEMENT_NODES), and what sb_grid_create returns; *particles is untouched.',
    'sb_particles_map_points': 'Rows of points[count] (m), in their order, for sb_body_add_mapping, sb_body_add_constraints and sb_mapping_apply: a\npoint is a sum of the positions of its neighbours by moving least squares functions, of four monomials for SPH and\nMLS. In rows, `cells` is the nearest particle and `farthest` the largest distance to it. Points outside are\nextrapolated, SB_ERROR_ARGUMENT names (error->node) the first farther than two spacings from any particle,\nSB_ERROR_NOT_FINITE one that is not finite, SB_ERROR_MESH one whose neighbours do not span space;\nSB_ERROR_MEMORY. *rows is untouched then. Release with sb_grid_rows_free. Source: eqs. 3.36, 3.37, where point-based\nbodies need moving least squares functions of their own.',
    'sb_particles_map_surface': 'Rows of points of triangles[count] (indices of elements; NULL: of all, count is not read) of a tri3 mesh, one for\neach piece when triangles are cut into pieces no longer than a spacing; areas sum to those of the triangles and first\nmoments are exact. sb_grid_add_traction makes forces of tractions. Errors as above, and SB_ERROR_INDEX (a triangle),\nSB_ERROR_UNSUPPORTED (more rows than an int counts).',
    'sb_particles_cut': 'Cuts along a surface of triangles or quads, open or closed: no point has neighbours that a segment through it leads\nto, then or in cuts to come. Points are made anew where that changes something, with growing radii; one whose\nneighbours do not span space even then does without what they do not see (`lost`). Make a new body of the result; the\nold one keeps what it copied, but borrows a table that stays until sb_particles_free: destroy it before that. Errors\nas sb_surface_create, SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (as sb_particles_create), SB_ERROR_MEMORY; *particles\nis as it was.',
    'sb_body_create': "Creates a body at rest in the mesh's shape. All memory that stepping needs is taken here. On failure *body is\nuntouched and the error says what is wrong: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named),\nSB_ERROR_MESH (element named), SB_ERROR_INDEX (node index, or a region that the mesh does not have),\nSB_ERROR_MATERIAL (the material, or the element whose material has fibres but that no direction was given for),\nSB_ERROR_UNSUPPORTED (element left out by SB_ELEMENT), SB_ERROR_MEMORY. Destroy with sb_body_destroy.",
    'sb_body_node_count': '---- sizes ----',
    'sb_body_matrix_blocks': 'points per element that sb_body_stress reads; hex8 8, B-bar too',
    'sb_body_patch_count': 'stored 3x3 blocks of the tangent',
    'sb_body_patch': 'The patch of an element, from 0; -1 without patches, for an element that there is not, or NULL.',
    'sb_body_solver': 'What solves its linear systems, and how the last set-up went. The kind is never SB_PRECOND_AUTO;\nsb_precond_string names it.',
    'sb_body_slenderness': "Diagonal of the body's bounding box over 3 V/A at rest, V its volume and A its surface: 3.5 of a cube, 5.2 of a ball,\nL/h of some 25 from 30 on: thin. Costs a pass over the integration points, and uses the body's scratch: between steps\nonly. NULL: 0.",
    'sb_body_set_material': '---- properties: may change between steps ----\nEach checks its arguments first and changes nothing on failure. A material may allocate when it is the first whose\nsteps take several iterations, or that has so many Prony terms (SB_ERROR_MEMORY). An element whose material is set\nforgets what its Prony terms remember: it counts as long relaxed in its present shape.',
    'sb_body_set_region_material': 'all regions',
    'sb_body_set_fibres': 'Directions as in the def, copied; NULL takes them all away. SB_ERROR_NOT_FINITE names the element; SB_ERROR_MATERIAL\nwhen a material has fibres and fibres is NULL; the first call may allocate (SB_ERROR_MEMORY). What Prony terms\nremember of the stress along the old directions stays and fades.',
    'sb_body_set_second_fibres': 'The same of the second family (sb_body_def.second_fibres); NULL takes it away, as sb_body_set_fibres(NULL) does.\nSB_ERROR_ARGUMENT without a first one, SB_ERROR_UNSUPPORTED in a body whose mesh may change.',
    'sb_body_set_tension': 'Tension (Pa) >= 0 with which the fibres of a region contract from now on: sb_material.fibre_tension, changed without\nforgetting what Prony terms remember. Set it before each step to drive it in time. SB_ERROR_INDEX: no such region;\nSB_ERROR_MATERIAL: no fibres to contract, or a material without energy for them.',
    'sb_body_set_damping': 'Of all regions. SB_ERROR_UNSUPPORTED: beta > 0 with SB_CENTRAL_DIFFERENCE.',
    'sb_body_set_region_damping': "Damping of a region's own, in place of the body's, which the others keep: its elements damp with beta (s) times their\nstiffness, and its share of the nodes' lumped masses with alpha (1/s), whatever def.mass is; both >= 0. What ties\ncells of a cut keeps the body's beta. sb_body_set_damping gives all regions the same again. With SB_EULER steps cost\nwhat they did; steps of one iteration of other integrators assemble one matrix more, for which the first call\nallocates. SB_ERROR_ARGUMENT, SB_ERROR_INDEX (no such region), SB_ERROR_UNSUPPORTED (SB_CENTRAL_DIFFERENCE),\nSB_ERROR_MEMORY change nothing.",
    'sb_body_set_solver': "Tolerance in (0, 1) and cap (>= 1) of a step's linear solve.",
    'sb_body_keep_tangent': 'Lets linearised steps (max_newton 1) go on with the tangent and the preconditioner of a step before, which are most\nof what a step costs that moves little. angle (rad, 0 to 1): they are made anew once an element has turned by more\nsince; 0, as bodies are made: in each step. 0.02 to 0.1 serve. Forces and damping are those of the present shape in\nany case, and so is the tangent times the way that nodes coast: a step is off by about the angle times what its\nmotion changes by within it, and bodies come to rest where they would otherwise. Where the works of the kept and of\nthe present tangent on that change differ by more than a share of 0.25, or of the angle where that is less, the step\nis solved once more, with its own, which sb_step_info counts: nearly incompressible or slender bodies would gain\nenergy in long steps. What is kept is part of the state.\n\nMade anew in each step all the same: where materials are not all SB_COROTATED, where there are constraints, loads\nthat follow the body (springs, mappings, membranes ...), tools, contact, damping by region, glue or supports that\nmove, with multigrid, and by needles with NDL_REMESH; and once after each change of dt, supports, materials or mesh.\nAllocates; the steps do not. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (elements other than tet4), SB_ERROR_MEMORY\nchange nothing; error may be NULL.',
    'sb_body_hold': 'Holds the axes where the nodes are now.',
    'sb_body_place': 'Supports the axes; the next step takes them to positions[count] (m, in space).',
    'sb_body_place_rigid': 'Nodes that hang on a rigid body moved by its pose (a bone, a clamp, a moving table): supports all axes, and the next\nstep takes each node from its place X at rest to position + turn (X - centre). centre (m) is a point of the rest\nshape, position (m) where it goes; turn is taken at unit length. A step goes there exactly; the increments of a\nstatic solve go straight, so that a large turn is better made in several solves. SB_ERROR_NOT_FINITE;\nSB_ERROR_ARGUMENT (a turn of length 0). What the body feels of it: sb_body_wrench.',
    'sb_body_release': 'Frees the axes; their velocity stays.',
    'sb_body_fix_nodes': "The same without an error, as earlier versions had them; sb_body_prescribe's targets are displacements from the\nreference shape: displacements[count] (m), or one for all when uniform is 1.",
    'sb_body_supports': 'Supported axes of every node as bits, [node_count].',
    'sb_body_positions': '---- state ----',
    'sb_body_displacements': '[node_count] (m), valid until destroyed',
    'sb_body_velocities': '[node_count] (m)',
    'sb_body_set_displacements': 'Overwrites the motion (any finite values, inside-out shapes included); SB_ERROR_NOT_FINITE changes nothing. To Prony\nterms a new shape is a sudden strain: their memory stays. What comes after agrees with the original run up to\nrounding, not to the last bit: solver warm starts are not part of it (sb_body_state_load has them), nor is a tangent\nthat steps keep.',
    'sb_body_reset': 'Back to the reference shape at rest, with nothing remembered; supports, loads and materials stay.',
    'sb_body_reactions': 'Force (N) of the supports on the body, per node, 0 on free axes, of the last step or static solve; with the\nloads it balances the rate of momentum. At the end of the step; with SB_GENERALISED_ALPHA where that scheme has its\nbalance, a share 1/(1 + spectral_radius) of the way through it (at the end where it had to take 0). [node_count],\nvalid until the next solve.',
    'sb_body_wrench': 'The net force (N) of what holds these nodes on the body, and its torque (N m) about a point (m, in space), as\nsb_body_reactions has them: a clamp, a bone or a table feels the opposite. Either place may be NULL. nodes[count],\neach once. SB_ERROR_INDEX, SB_ERROR_NOT_FINITE leave both untouched.',
    'sb_body_external_forces': 'All loads of the last solve (gravity, forces, tractions, and what pressures, springs and mappings exerted in it) as\nnodal forces (N), [node_count].',
    'sb_body_multiply_stiffness': 'y = K x, the stiffness at the present displacements times x: the change of the internal forces (N) when the nodes\nmove by x (m). x and y: [node_count], not overlapping. K is the derivative of the forces, symmetric but not always\npositive definite; Prony terms respond at once. With single_rotation it is that of the same elements with a rotation\nat each point. Supports, loads and constraints have no say. The state stays as it is, and nothing is allocated.\nSB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error->node) and SB_ERROR_INVERTED (error->element) leave y untouched; error\nmay be NULL.',
    'sb_body_multiply_tangent': 'The same with the tangent that solves use: SB_TANGENT_EXACT is the derivative of above, SB_TANGENT_SPD its positive\nsemidefinite projection at each point, and SB_TANGENT_QUASI what linearised steps take: of the corotated models the\nrotations stay as they are (K = R C R^T), others are projected. SB_TANGENT_QUASI of SB_COROTATED tet4 and tet10 needs\nno matrix: measured, that takes a tenth (tet10) to two fifths (tet4) of assembling one and multiplying.\nSB_ERROR_ARGUMENT: also an unknown kind.',
    'sb_body_stiffness_matrix': "That matrix itself (N/m; for SB_TANGENT_EXACT the derivative of the internal forces by the nodes' places), lent until\nthe next call on the body, whose copy of it this overwrites. Errors as above; *matrix is then untouched.",
    'sb_body_mass': 'Total mass (kg) and momentum (kg m/s).',
    'sb_body_stress': 'Cauchy stress (Pa) at an integration point of an element, from the current state, with what fibres and Prony terms\nadd. SB_ERROR_INDEX,\nSB_ERROR_INVERTED (material has no stress there); *stress is then untouched.',
    'sb_body_von_mises': 'Von Mises stress (Pa) of every element, mean over its points (over their weights where def.domain was given), 0 where\nthere is none; values[element_count].',
    'sb_body_nodal_von_mises': 'The same as nodal averages weighted by volume, for colouring; values[node_count].',
    'sb_body_nodal_rotations': "How the material around each node has turned from the reference shape, as unit quaternions: the rotation of the mean\ndeformation gradient, weighted by volume; identity where there is no material. rotations[node_count], as\nsb_preconditioner_warp takes them. Uses the body's scratch: between steps only.",
    'sb_body_parts': "Lists the parts by ascending `node`.\nparts     [capacity] the first `capacity` of them; NULL when capacity is 0\n*count    how many there are\nnumbers   [sb_body_node_count] number of the part of each node, -1: it has no material; or NULL\nAllocates nothing; uses the body's scratch: between steps only. SB_ERROR_ARGUMENT.",
    'sb_body_check': 'SB_ERROR_ARGUMENT; SB_ERROR_MEMORY of a body with free rigid bodies.',
    'sb_check_string': 'One sentence about one SB_CHECK_ bit; never NULL.',
    'sb_body_deformation': 'Deformation gradient dx/dX at an integration point of an element, [0, sb_body_point_count). SB_ERROR_INDEX: *F is\nuntouched.',
    'sb_body_strain': 'Strain there, see SB_TENSOR_STRAIN; errors as above. (Stress: sb_body_stress.)',
    'sb_body_nodal_tensors': 'A tensor at every node; values[sb_body_node_count], 0 where there is no material. In each element a linear function\nof its local coordinates is fitted to the integration points (tet4: a constant), taken to its nodes, and averaged\nthere, weighted by volume; elements that are cut or have points of their own (sb_body_def.domain) give their mean.\ntensor is an sb_tensor. Measured on irregular meshes\n(tests/verification.md, verification_readings): halving elements divides errors by 3.5 of tet10, hex20 and hex27, by\n2.4 of tet4 and hex8 and by 1.9 at the surface, where these two know the middle of the layer below only.\nSB_ERROR_ARGUMENT: NULL, or another tensor; SB_ERROR_INVERTED: error->element has no stress, its material does not\nadmit the state; *values is then untouched. error may be NULL.',
    'sb_body_region_tensors': 'The same from the elements of one region alone, 0 at nodes of others: stresses jump where materials meet, and an\naverage over both sides is neither. SB_ERROR_INDEX: the mesh has no such region.',
    'sb_body_energy_densities': 'Elastic energy of each element per volume at rest (J/m^3), mean over the element; values[sb_body_element_count].\nTimes the volumes they sum to sb_energy.elastic, what ties pieces of a cut to each other left out; with Prony terms\nof the long-term response, as there. SB_ERROR_ARGUMENT; SB_ERROR_INVERTED names the element; SB_ERROR_NOT_FINITE: too\nlarge for sb_real; values are then untouched. error may be NULL.',
    'sb_body_change_begin': 'Begins a change; one at a time. Nothing happens to the body before the commit. Errors of the calls below leave the\nchange as it was before them: it can go on. SB_ERROR_UNSUPPORTED: def.slack was 0. SB_ERROR_STATE: another change is\nopen. SB_ERROR_MEMORY.',
    'sb_body_change_add_node': 'Makes a node at a place of the reference shape (m); *node is its number.\nsources, weights  [count] nodes in use before the change or made by it, >= 1; weights >= 0 that sum to 1\nflags             0 or SB_NODE_COPY with SB_NODE_KEEP_X ...\nSB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_INDEX (error->node), SB_ERROR_MEMORY.',
    'sb_body_change_move_node': "Moves a node in the reference shape (m). Its cells change shape, also those not named here. The last move of a node\ncounts.\nsources, weights  [count] as of sb_body_change_add_node: those of the new place in the mesh before the change, so\n                  that the body's motion stays where it was while the node slides through it. count 0: the node keeps\n                  the motion it has, a made one that of its sources\nErrors as of sb_body_change_add_node.",
    'sb_body_change_remove_node': 'Removes a node in use before the change.\nheirs, weights  [count] nodes, >= 0, that what refers to the node goes over to; weights sum to 1. 0: nobody',
    'sb_body_change_add_cell': 'Makes a cell; *number (may be NULL) is its number. Nodes may still be to come until the commit.\nSB_ERROR_ARGUMENT, SB_ERROR_INDEX, SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY; SB_ERROR_UNSUPPORTED: moments in a body of\nother cells than tet4 or tet10, with more than 4 points to a cell, or with consistent masses of tet10.',
    'sb_body_change_replace_cell': 'Removes a cell and makes another in its slot.',
    'sb_body_change_commit': "Checks the change as a whole, takes all memory that following needs, and makes it. On SB_OK the change is gone; on\nfailure the body is as it was to the last bit, the change is still open, and the error names node or cell:\nSB_ERROR_INDEX (a cell with a node that is not in use, or twice the same; a removed node that still has a cell),\nSB_ERROR_MESH (a cell inside out or flat; a node left without a cell; no cell left), SB_ERROR_UNSUPPORTED (a piece of\na tet10 with curved sides), SB_ERROR_ARGUMENT (what would lose its node, see above), SB_ERROR_STATE (a state with\nanother mesh was loaded meanwhile, or a needle is in the tissue, whose mesh is the needle's alone then),\nSB_ERROR_MEMORY, or what a listener says.",
    'sb_body_node_in_use': '---- readings ----',
    'sb_body_cell_nodes': 'Nodes of a cell in use, or NULL; valid until the next change.',
    'sb_body_cell_share': "Share of a cell's volume that is material; 0 for a free one and an empty piece.",
    'sb_body_rest_positions': '[node_count] the reference shape (m).',
    'sb_body_mesh_version': 'Rises with every change, and with every state loaded whose mesh is another; 0: none yet.',
    'sb_body_find_cell': "Where cells are pieces of elements, which all have the whole element's shape: the cell with the material at xi of the\nelement that `cell` is a piece of (largest least barycentric coordinate, then the lowest piece), as the sb_cut that\ncut the body knows. The cell itself where it is none, or where nobody knows. -1: no such cell, or NULL.",
    'sb_body_get_mesh': 'The mesh without free slots, in the order of the slots, with regions. nodes [sb_body_node_count] and cells\n[sb_body_element_count] become their numbers in it, -1 of free ones; may be NULL. Release with sb_mesh_free.\nSB_ERROR_ARGUMENT, SB_ERROR_MEMORY leave all untouched.',
    'sb_body_live_check': 'Whether slots, masses, volumes, lists and matrix are what the mesh says: for tests. SB_ERROR_STATE names the first\nfault. Allocates scratch (SB_ERROR_MEMORY).',
    'sb_body_listen': "Called in the order of registration, after the body's own loads and constraints and the embeddings that follow it.\n*id serves to end it; listeners end with the body, too. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (def.slack was 0),\nSB_ERROR_MEMORY.",
    'sb_body_apply_forces': 'Adds forces[count] (N), or one for all when uniform is 1, to the nodes. SB_ERROR_NOT_FINITE; SB_ERROR_INDEX: a node\nout of range, or a force other than 0 on a node of no element, which is held and would feel nothing. Nothing is added\nthen, and error (NULL is fine) names the node.',
    'sb_body_add_forces': 'The same without an error, as earlier versions had it.',
    'sb_body_add_traction': 'Adds a traction (Pa on undeformed area) on element faces, each given by its 3 (tet) or 4 (hex) corner nodes in\nany order: faces[face_count][corners]. SB_ERROR_ARGUMENT names the first face that no element has.',
    'sb_body_add_pressure': 'Pressure (Pa on the deformed area; positive pushes inwards, along the present normal) on faces of the surface, given\nas for sb_body_add_traction. SB_ERROR_INDEX and SB_ERROR_ARGUMENT name the first face with a node that the mesh does\nnot have, that no element has, or that lies between two elements; SB_ERROR_NOT_FINITE. f_a = -p int N_a x_r x x_s.',
    'sb_body_add_springs': 'Springs of rest length 0 from nodes[count] to points in space points[count] (m): each pulls its node with\nstiffness (point - position). stiffness: N/m, >= 0, one for each spring, or one for all when uniform is 1.\nSB_ERROR_INDEX: a node out of range or of no element.',
    'sb_body_add_mapping': "Penalty displacements: draws each row of the mapping to targets[row_count] (m, in space) with stiffness[row_count]\n(N/m, >= 0; one for all when uniform is 1): f = -H k (H^T x - y), K = H k H^T. A row that couples nodes without a\ncommon element enlarges the body's tangent: its matrix and preconditioner are then made anew, and blocks grow with\nthe square of the row's length. SB_ERROR_ARGUMENT (an empty or descending row), SB_ERROR_INDEX (a node out of range,\nor one of no element whose weight is not 0) and SB_ERROR_NOT_FINITE name the row (error->element) or its node.\nSource: Robin condition through a mapping.",
    'sb_body_mapping_points': 'Where the rows are now (m): points[row_count].',
    'sb_body_remove_load': 'Takes a pressure, springs, a mapping, a cable, a membrane or a cavity away; its id is then unknown. The next static\nsolve lets its force fade.',
    'sb_body_load_force': 'Net force (N) of a load on the body, and its torque (N m) about a point (m); either place may be NULL.',
    'sb_body_spring_forces': 'Force (N) of each spring on its node, forces[count], and of each row on the body, forces[row_count].',
    'sb_body_add_cable': "Adds a cable as one load more, by whose id sb_body_load_force (of what it does to the body) and sb_body_remove_load\nknow it, too. The def and its arrays are copied.\n- Forces come from the energy stiffness rest_length (e^2/2 - toe e/2 + toe^2/6), e = length / rest_length - 1, past\nthe toe, and stiffness rest_length e^3 / (6 toe) within it; a slack cable has none at all. Statics, and steps of\n  several Newton iterations, find the balance with it; a linearised step (max_newton 1) takes what it is at the start\n  and its stiffness there: a cable that goes taut or slack within the step does so in the next one.\n- The stiffness is positive semidefinite and part of every tangent: a stiff cable is safe at any dt. Under pressure a\n  rod (pushes) buckles where exact tangents are asked for; others leave that part out.\n- A static solve goes evenly from the rest length, stiffness and places that the last one ended with to the present\n  ones, and starts a new cable from no tension. It takes a cable as something that holds its length; where cables\n  alone hold a body and are slack at first, give it more load steps, or a support.\n- Explicit steps are bounded by the stiffness of all cables, slack ones too.\n- When the mesh changes, points go with their nodes and their material as rows of mappings do: to heirs of nodes\n  that go, to the cell that has their material. Points in space stay.\nErrors, with nothing added: SB_ERROR_ARGUMENT (NULL; fewer than 2 points; none of the body; a stiffness or toe strain\nbelow 0; rest_length below 0, or 0 where all points lie on one place; a point without a place, or whose weights do\nnot sum to 1), SB_ERROR_INDEX (a node out of range, or of no element), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY;\nerror->element names the point. Points without a common element enlarge the body's tangent as those of a mapping's\nrow do.\nSource: Blemker and Delp 2005 (paths that slide), Weiss et al. 1996 (toe of ligaments).",
    'sb_body_set_cable_rest_length': 'Changes between steps, without allocation: a suture that is tightened, a ligament that was torn (stiffness 0).\nSB_ERROR_INDEX: no cable has this id; SB_ERROR_ARGUMENT (rest_length <= 0, stiffness < 0), SB_ERROR_NOT_FINITE.',
    'sb_body_move_cable': 'places[points] (m): those of points in space are taken, others are not read.',
    'sb_body_cable_tension': 'Tension (N) in the last step or static solve, 0 before; negative in a rod under pressure, and where a linearised step\nlet a cable go slack.',
    'sb_body_cable_length': 'Of its present points: length (m), and points[points] (m).',
    'sb_body_cable_forces': 'forces[points] (N) on each point in the last step or static solve; they sum to 0. What a point in space feels is what\nits bone feels.',
    'sb_default_membrane_def': 'corners 3, prestretch 1, it wrinkles; no faces, thickness and shear 0.',
    'sb_body_add_membrane': "Adds a membrane as one load more, by whose id sb_body_load_force (which is 0) and sb_body_remove_load know it, too.\nThe def and its faces are copied; a face twice has two sheets.\n- Forces come from the energy thickness shear / 2 (tr C + 1 / det C - 3) per area of the sheet, C = F^T F in its\n  plane. One that wrinkles has Pipkin's relaxed energy: with stretches a >= b, where b < a^-1/2 it pulls along a\nalone (shear (1 - a^-3)), and not at all where a <= 1. A point for each tri3, three for tri6, four for quad4, nine\nfor quad8 and quad9.\n- Statics, and steps of several Newton iterations, find the balance with it; a linearised step (max_newton 1) takes\n  its forces at the start and its stiffness there, without what pressure in it takes off, plus 1e-4 thickness shear\n  where it wrinkles. Rayleigh damping leaves it out.\n- A static solve goes evenly from the thickness, shear and prestretch that the last one ended with to the present\n  ones; a new membrane has all of its stiffness at once, and starts from prestretch 1.\n- When the mesh changes, it goes with its faces as pressures do, and a face that is cut keeps what of it is material;\n  where the rest shape of nodes moves, so does its.\nErrors, with nothing added: SB_ERROR_ARGUMENT (NULL; no faces; corners; a face that no element has, or between two:\nerror->node is its first; a face without area; thickness, shear or prestretch out of range), SB_ERROR_INDEX (a node\nout of range: error->node), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY, SB_ERROR_UNSUPPORTED (in a body of\nSB_CENTRAL_DIFFERENCE one that does not wrinkle: it stiffens without bound as it is pressed together).\nSource: Pipkin 1986 (relaxed energy); Holzapfel 2000, 6.5, for incompressible sheets.",
    'sb_body_set_membrane': 'Changes between steps, without allocation; ranges and errors as above, SB_ERROR_INDEX: no membrane has this id.',
    'sb_body_membrane_faces': 'Faces that a membrane has now (a change of the mesh may divide them), and their corner nodes, corners[count][corners]\nas its def had them; either may be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.',
    'sb_body_membrane_states': 'states[count] at the present shape; no allocation. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.',
    'sb_default_cavity_def': 'SB_CAVITY_PRESSURE of 0, corners 3, ambient 101325, exponent 1, bulk 2.2e9; no faces.',
    'sb_body_add_cavity': "Adds a cavity as one load more, by whose id sb_body_load_force and sb_body_remove_load know it, too. The def is\ncopied. `filled`, of gas, liquid and SB_CAVITY_VOLUME, is the cavity's volume when it is added; a table is of V less\nwhat was injected since.\n- V = 1/3 int x.n over the faces, outward of the cavity, and over the lids of open rims: fans from the mean of a\nrim's corner nodes, which hand the pressure on them to the rim as it follows from V. The force is p dV/dx. Where the\n  faces close and the pressure is of the contents alone, it sums to 0, as does its torque.\n- Its energy - int p dV is part of sb_energy.springs and of what line searches go down. The stiffness -dp/dV g g^T\n  (g = dV/dx) is in every linear system, as a product, not as a block; what the turning of its faces adds is as for\n  pressures, without that of lids.\n- Liquid and SB_CAVITY_VOLUME: where -dp/dV is more than 100 times the body's own stiffness to growing (g.Kg /\n|g|^4), solves take that, with a pressure that is corrected to the law's: static solves until the volume is that of\nthe law's pressure to 1e-11 of it or the tolerance of the forces shows no more; steps of SB_EULER and\n  SB_GENERALISED_ALPHA once a step, so that the volume follows in a few steps. SB_NEWMARK and SB_CENTRAL_DIFFERENCE\n  keep energy, and such a correction would swing without end: there the volume is some hundredth of what it grew by\n  off, and what was injected at once rings. So no bulk is too stiff. Iterations of linear systems are up to 2.5\n  times those with a given pressure.\n- A static solve goes evenly from the pressure, `filled` and contents that the last one ended with to the present\n  ones, and begins a new cavity with no pressure and filled to its present volume.\n- When the mesh changes, it goes with its faces as pressures do, and rims are found anew. A face of it cannot be cut\n  through (SB_ERROR_UNSUPPORTED): remove the cavity first. sb_body_modes leaves its stiffness out.\nErrors, with nothing added: SB_ERROR_ARGUMENT (NULL; no faces; corners; a face that no element has, twice, or between\ntwo elements: error->node is its first; rims that touch: error->node; a volume of gas, liquid or SB_CAVITY_VOLUME\nthat is not positive, as that of faces that look out of a solid; numbers or a table out of range), SB_ERROR_INDEX\n(error->node), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY, SB_ERROR_UNSUPPORTED (faces of cut elements). Source: Bonet and\nWood 2008, 8.6 (pressure of enclosed volumes); Rumpel and Schweizerhof 2003 (rank-one part).",
    'sb_body_inject_cavity': "Adds volume (m^3, at the contents' own pressure; negative: takes away) to the contents, between steps, without\nallocation. SB_ERROR_INDEX; SB_ERROR_ARGUMENT: of SB_CAVITY_PRESSURE, or more than there is; SB_ERROR_NOT_FINITE.",
    'sb_body_set_cavity_pressure': 'Of SB_CAVITY_PRESSURE. SB_ERROR_INDEX, SB_ERROR_ARGUMENT (another kind), SB_ERROR_NOT_FINITE.',
    'sb_body_cavity_volume': 'Present volume (m^3), lids included. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.',
    'sb_body_cavity_pressure': 'Pressure (Pa) in the last step or static solve; 0 before.',
    'sb_default_rigid_def': 'mass 0 and inertia 0, to be set; turn the identity, the rest 0.',
    'sb_body_add_rigid': 'Adds a rigid body that moves freely; *id (may be NULL) is its number, never used again by this body. The def is\ncopied; allocates, so that steps do not. Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; a mass, an inertia or a\nturn that is none; a node that is supported, in no element, the slave of a constraint, twice in the list or on\nanother rigid body: error->node), SB_ERROR_INDEX (error->node), SB_ERROR_NOT_FINITE, SB_ERROR_UNSUPPORTED (explicit\nsteps; more than SB_MAX_RIGID), SB_ERROR_MEMORY. Nodes that hang can neither be supported nor become slaves of\nconstraints (SB_ERROR_ARGUMENT); they may be masters.',
    'sb_body_set_rigid_load': 'What acts on it besides tissue and gravity, from the next step on until it is set again: a force (N) at its centre of\nmass and a torque (N m), both in space. Allocates nothing. SB_ERROR_ARGUMENT, SB_ERROR_INDEX (no such rigid body),\nSB_ERROR_NOT_FINITE.',
    'sb_body_rigid_motion': 'SB_ERROR_ARGUMENT, SB_ERROR_INDEX leave *motion untouched.',
    'sb_body_remove_rigid': 'Takes it away; its nodes go on as they move. SB_ERROR_ARGUMENT, SB_ERROR_INDEX.',
    'sb_embedding_create': 'Embeds points in a mesh. SB_ERROR_ARGUMENT (a field out of range, a point beyond max_distance: error->node),\nSB_ERROR_NOT_FINITE (error->node: the point), SB_ERROR_UNSUPPORTED for custom elements, what sb_mesh_validate says of\nthe mesh, SB_ERROR_INDEX for the surface, SB_ERROR_MEMORY; *embedding is then untouched. Copies what it keeps. About\n2 microseconds for each point of a tet mesh on one thread; the result does not depend on the threads. Release with\nsb_embedding_destroy.',
    'sb_embedding_update': "Where the points are when the nodes of the mesh are at node_positions (m), such as sb_body_positions(body):\npoints[point_count], and unless NULL unit normals[point_count]. node_positions: [node_count of\nsb_embedding_get_report], which is mesh.node_count, or the slots of the body that it follows. After a change of the\nbody's mesh (sb_body_change_commit), as needles make, the points are wrong unless the embedding follows it\n(sb_embedding_follow). Normals are\n- with a surface, of its deformed triangles (quads: corner triangles) around each point, weighted by area: those of\n  what is drawn. Zero for a point without triangles;\n- with def.normals, F^-T N of the embedding's deformation gradient F at the point: no neighbours needed, but it jumps\n  a little where F does, between elements.\nSB_ERROR_ARGUMENT for a NULL array, or normals without either source; nothing is written. Positions that are not\nfinite give points that are not. Output arrays must not overlap node_positions. Allocates nothing, but after a state\nwas loaded without memory for it (SB_ERROR_MEMORY, see sb_embedding_follow); the same bits for any number of threads;\none call at a time for each embedding. jobs: NULL for none.",
    'sb_embedding_forces': "Adds to node_forces[mesh.node_count] (N) the forces equivalent to point_forces[point_count] (N) at node_positions:\nthe exact transpose of sb_embedding_update's derivative, with the same net force and moment. What is said there of\nallocation, threads and errors holds.",
    'sb_embedding_get_point': 'SB_ERROR_INDEX for no such point; *point is then untouched.',
    'sb_embedding_mapping': 'SB_ERROR_MEMORY, SB_ERROR_ARGUMENT; *rows is then untouched. A NULL allocator means malloc.',
    'sb_embedding_follow': "From now on the embedding follows every change of the body's mesh (sb_body_change_commit) and every state loaded with\nanother mesh. Its node positions are those of the body's slots, sb_body_positions(body); def.mesh need not have their\nnumbers, but has the body's rest shape: points are placed anew where they are at rest.\n- A point keeps its place at rest, that is its material, to rounding: in the cell made there when its cell was split\n  or a node slid in the material. Points in cells that did not change have the same bits as before.\n- A point whose cell was removed is held by the nearest of the cells around the change, as points outside are\n  (sb_embedding_kind), or by the nearest of all where these do not reach it; sb_embedded_point.lost and\n  sb_embedding_report.lost say so. It is back inside when cells are made there again.\n- Points outside that are held where the mesh changed are held anew from their places at rest.\n- In an element that is cut (sb_cut) a point goes with the piece that has its material, outside with the piece that\n  has its foot: it is where it was at the instant of the cut. Of a body that has an sb_cut the points are placed by\n  the first update after a state with another mesh; of one without nobody knows then which piece that is\n  (sb_body_find_cell), and points of cut elements may be held by the piece on the other side.\n- After a state with another mesh was loaded the points are placed anew from the mesh at rest: one on a face or\noutside may be held by another cell than before, and be drawn elsewhere by rounding, or outside by what that cell\nmakes of it. Those of a skin that tools touch (sb_contact_def.skin) are held as they were when the state was saved.\n- A change that is refused leaves the embedding as it was, to the bit.\n- A listener (sb_body_listen) finds the embedding changed when its `follow` is called, whichever came first. Between\n  its `reserve` and that, the embedding is not to be read.\nCost: a change searches the points of changed cells and makes anew what updates read of them; points and cells far\nfrom it cost nothing (tests/bench/RESULTS.md). The first call takes about as long as the creation. A change allocates\nwhen arrays have to grow, and to find a point that no cell around it holds. Without memory the change is refused\n(SB_ERROR_MEMORY). After a state was loaded without memory for this, the next sb_embedding_update or\nsb_embedding_forces tries again and says SB_ERROR_MEMORY in turn. It ends with either of the two, or\nsb_embedding_unfollow. SB_ERROR_ARGUMENT (NULL, or other elements than the body's), SB_ERROR_STATE (it follows a body\nalready), SB_ERROR_UNSUPPORTED (def.slack was 0), SB_ERROR_MEMORY leave it as it was.",
    'sb_embedding_unfollow': 'It stays as it is, and does not follow any more. SB_ERROR_STATE: it follows no body. SB_ERROR_ARGUMENT: NULL.',
    'sb_skin_create': "A skin of triangles between the points of an embedding.\nembedding  borrowed: destroy the skin first. Follows the body (sb_embedding_follow) where its mesh may change, since\n           before what acts on the skin was made, and until after that is destroyed\nsurface    tri3, whose nodes are the embedding's points; triangles counter-clockwise seen from outside. Copied\nallocator  NULL: malloc\nSB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (other faces than tri3), SB_ERROR_INDEX (error->element: a triangle with a\ncorner that is no point), SB_ERROR_MEMORY; *skin is then untouched.",
    'sb_particles_stabilise': 'Adds a load (sb_body_remove_load takes it away) that holds the neighbours of every point to the linear field of its\ngradient: a gradient that is centred on a particle does not see that particle, and one point in a brick does not see\nits hourglasses. With s_j = u_j - sum_a (phi_a + g_a . (X_j - X_p)) u_a its energy is\n    alpha / 2 (lambda + 2 mu) w_p sum_j W_j |s_j|^2 / sum_j W_j |X_j - X_p|^2,\na constant tangent within that of the body: nothing for linear fields and rigid motions, of any size. alpha: (0, 10];\n0.02 is enough. [after Ganzenmueller 2015, in linear form.] Moduli are those of now. body must have been made of\nparticles->mesh and ->domain: SB_ERROR_ARGUMENT where counts differ, alpha is out of range, or with gradients that\nmiss linear fields (SPH, a basis of 1), which it would hold; SB_ERROR_MEMORY. Nothing is added then.',
    'sb_body_add_constraint': "Adds the equation sum_k coefficient_k u[node_k].axis_k = value (m). The first term is the slave: its displacement\nfollows from the others, as in Abaqus' *EQUATION, so its coefficient must not be 0 (nor so small beside the others\nthat a quotient overflows).\n  terms[count]  count >= 1; other terms may name supported nodes (the slave follows), nodes of no element (as\n                prescribed reference nodes) and slaves of other constraints (chains are resolved)\n  id            receives the constraint's number, >= 0, never used again by this body; may be NULL\nA gap that a new constraint finds open is closed like the way of a moving support: at once by a time step, by load\nincrements in a static solve. A slave's velocity becomes that of its masters.\nErrors, with nothing changed: SB_ERROR_INDEX (a node), SB_ERROR_ARGUMENT (an axis; a slave that is supported, as\nnodes of no element always are, the slave of another constraint, among its own masters, or in a circle of\nconstraints; node and axis named), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY. A constraint with m master nodes couples\nthem all: m^2 matrix blocks.",
    'sb_body_add_constraints': 'Adds `count` constraints at once, all or none: constraint c has the next term_counts[c] of `terms` and values[c]\n(values NULL: all 0). They get the numbers *first_id, *first_id + 1, ... (first_id may be NULL).',
    'sb_body_set_constraint_value': 'Changes the right-hand side (m) of one constraint; the next step or solve moves its slave there. Allocates nothing.\nSB_ERROR_INDEX: there is no such constraint; SB_ERROR_NOT_FINITE.',
    'sb_body_remove_constraints': 'Removes the constraints first_id .. first_id + count - 1. SB_ERROR_INDEX when one of them does not exist,\nSB_ERROR_MEMORY: nothing removed.',
    'sb_body_clear_constraints': 'Removes all; cannot fail.',
    'sb_body_constraint_force': 'Force of a constraint in the last step or static solve, its Lagrange multiplier (N per unit of coefficient): the\nconstraint pushes node_k along axis_k with *force * coefficient_k. sb_body_reactions at supported masters include\nwhat their slaves pass on. SB_ERROR_INDEX leaves *force untouched.',
    'sb_body_tie_faces': "Ties slave nodes to faces: each to the closest point of the present shape of all faces, u_s = sum_a N_a u_a + c with\nthe face's shape functions there, along every axis that is not supported. To tie two meshes, put them in one body\n(sb_mesh_append) and let the finer or softer side be the slave.\n  faces         [face_count][corners]: corner nodes of element faces in any order, corners 3 (tet) or 4 (hex)\n  slave_nodes   [slave_count], different, none on the faces, none a slave already\n  max_distance  (m) nodes further away are left free; negative: a tenth of the closest face's diameter\n  options       sum of SB_TIE_..., 0: keep gaps, leave far nodes free\n  report        may be NULL\nc keeps each node's offset from the face as it is now, so that tying causes no stress by itself.\nWhat holds: slaves reproduce every displacement field that is linear in space exactly when gaps are 0, on flat and\ncurved faces, and forces balance. Constant stress passes exactly across matching faces and where the slaves' grid\nrefines the masters' (faces inside faces); else a node-to-surface tie leaves an error that falls with the element\nsize, unless the interface carries no traction. Offsets do not turn with the faces: torque balances only for gaps\nof 0.\nErrors, with nothing changed: those of sb_body_add_constraint; SB_ERROR_ARGUMENT names the first face that no\nelement has, or a node of both sides. Time O(slaves * faces), cheap each; memory during the call.",
    'sb_body_step': "Advances the body by dt (s, > 0) with its integrator. Supports reach their targets exactly.\n\nWith max_newton 1 the step is linearised (one system, Baraff and Witkin 1998): its cost is bounded and the\nresult is taken even when max_iterations cut the linear solve short (info->capped). With hyperelastic materials,\nwhose forces grow faster than displacements, it is shortened until no energy comes from nowhere. With more\niterations each is followed by a line search on the step's potential, which also refuses inverted elements for\nmaterials that have no energy there.\n\nSB_CENTRAL_DIFFERENCE takes dt in equal substeps of at most 0.9 stable steps, as many as that needs; the stable step\nis found anew every 16 substeps as the body deforms; springs, mappings and constraints count in it, so that stiff\nones make substeps short, and so does a tool that is near (contact.h). Substeps that go bad all the same (an element\ninverted, more energy than came in) are taken back, and the call is done again with shorter ones, up to three times.\n\nProny terms move on with the step: exact where the relaxing stress changes evenly within it, of second order\notherwise. Where a material that may turn inside out is nearly flat (det F < 0.05) they remember less, and inside out\nnothing, lest the memory hold it there.\n\ninfo may be NULL. On failure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_DIVERGED,\nSB_ERROR_INDEFINITE; SB_ERROR_NOT_CONVERGED naming the stable step: more than max_substeps; SB_ERROR_UNSUPPORTED\nwhere Newmark meets SB_MASS_REDUCED, or central difference, and constraints that cannot be lumped) positions,\nvelocities, accelerations, reactions and constraint forces are as before the call and the body can go on, to the last\nbit as if the call had not been; so is what Prony terms remember. Allocates nothing. Formulas: implicit Euler and\nNewmark in the increment du,\n    (ca M + cv D + K) du = f_ext - f_int - M a0 - D v0,  D = alpha M + beta K;\ngeneralised alpha the same with u at the time of its balance, from which the end of the step is extrapolated;\nsupports and gaps of constraints are that share of their way along by then, pressures and the points of springs at\ntheir present values throughout. Where the material does not admit that end, the step is done again with spectral\nradius 0, whose balance is at the end. K in D is that of the start of the step, so that with beta > 0 iterated\nsteps of nonlinear bodies (Newmark, generalised alpha) are of first order in time.\nCentral difference:\n    u' = u + h v + h^2/2 a,  (M + h/2 D) a' = f_ext(u') - f_int(u') - D (v + h/2 a),  v' = v + h/2 (a + a'),\nand of slaves u', v', a' follow from their masters, which carry the slaves' mass lumped (row sums of T^T M T).",
    'sb_body_stable_step': 'dt (s) = the longest step that is sure to be stable under SB_CENTRAL_DIFFERENCE at the present shape with the\nlumped mass, 2/omega_max from a bound of omega_max that is never below it: typically 0.8 to 0.99 of the true limit.\nSprings, mappings, pressures and constraints count, Prony terms with their instantaneous stiffness. Mass damping does\nnot change it; supports of unconstrained bodies are left out of account. Works for bodies of any integrator and\nleaves their state as it is. Costs an assembly of the tangent and some products with it; allocates nothing. On\nfailure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_NOT_FINITE, SB_ERROR_UNSUPPORTED for\nconstraints that cannot be lumped) *dt is untouched; error may be NULL.\nBound: max over rows of (|K| x)_i / (m_i x_i) for a positive x (Collatz 1942, Wielandt 1950), x by iteration.',
    'sb_body_solve_static': 'Bodies made with SB_PRECOND_AUTO whose systems conjugate gradients would take long for, thin ones and those whose\nlast solve took more than 1000 iterations, are factored (SB_PRECOND_CHOLESKY) up to 30,000 nodes; the factor is taken\nfrom the allocator and given back within the call; without memory for it conjugate gradients go on. Not with tools.\n\nWhere rounding does not let a solve meet its tolerance, it ends with success and SB_STOP_FLOOR in info->statics.\n\nFinds the equilibrium under the present loads and supports: Newton with the exact tangent, projected to positive\ndefinite where it is not, a line search that refuses inverted elements, and adaptive load increments from the\nloads of the last static solve (0 at first) and the present shape. Velocities become 0. options NULL: defaults.\n\nMaterials with Prony terms: the equilibrium long after, when all has relaxed that relaxes, with nothing else\nremembered; or (options->instantaneous) the one right after the loads changed in no time, from what is remembered.\n\nErrors: SB_ERROR_UNCONSTRAINED names a node of a part that can move freely; SB_ERROR_INVERTED names the element\nthat would turn inside out; SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED after halving the increment six times.',
    'sb_body_modes': "Finds the lowest `count` natural frequencies of the body with its supports (at rest where they are), constraints\n(their values play no part), springs and mappings. Other loads play none, but that pressures act at_present: with the\nsymmetric part of their stiffness. Prony terms respond at once, as to the fastest of motions.\nFree rigid bodies (rigid.h) take part with their masses, about where they were added or, at_present, are now, where\nthe forces on what hangs count with the turning of its arms.\ncount        1 .. degrees of freedom that no support holds and no constraint eliminates; nodes that hang have none,\n             each free rigid body has six\noptions      NULL: defaults\nfrequencies  [count] (Hz), ascending, multiple ones as often as they are; rigid motions that the supports leave come\n             out as about 0 (rounding of K x), never as NaN\nshapes       [count][node_count] or NULL: displacements x (m) of unit modal mass, x^T M x = 1 kg m^2, at right\n             angles in M, rigid bodies' masses in it; 0 at supported axes; slaves follow their masters\ninfo, error  may be NULL\nTakes memory for about 2 count + 40 vectors from the body's allocator for the time of the call. The body's state is\nleft as it is, to the last bit.\nErrors: SB_ERROR_ARGUMENT, SB_ERROR_MEMORY, SB_ERROR_INVERTED (at_present, naming the element), SB_ERROR_INDEFINITE\n(the present shape is not stable: it buckles), SB_ERROR_NOT_CONVERGED naming the mode; frequencies and shapes are\nthen untouched.\nMethod: Rayleigh-Ritz in a space that grows by (K + shift M)^-1 r of the residuals r of the lowest modes not yet\nfound, from random vectors (block Davidson; Parlett 1998, 11 and 13); systems by PCG, loosely.",
    'sb_body_unload': "Finds the rest shape.\nrest    [node_count] (m) receives it; may be the imaged mesh's own nodes. Held nodes keep their place along the\n        held axes\nbody    receives the body made from it, with its supports and loads, at rest in the imaged shape: destroy it with\n        sb_body_destroy. May be NULL. Quadratic elements with lumped masses weigh nodes otherwise in steps than in\n        statics, and move on from there by some thousandths of their size: SB_MASS_CONSISTENT stays\nreport  may be NULL; written also on failure\nMakes a body for each trial, from def->body.allocator; the same bits for any number of threads. On failure rest and\n*body are untouched: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, whatever sb_body_create and dress say of the imaged\nmesh, SB_ERROR_MEMORY, SB_ERROR_UNCONSTRAINED, or that of the last trial where no rest shape is found\n(SB_ERROR_NOT_CONVERGED, SB_ERROR_INVERTED, SB_ERROR_INDEFINITE: the image is in balance but buckles away;\nreport->gap and share tell how far it came). What asks too much: an image that its loads, put on as if it were at\nrest, would move by more than its size; a limit load.\nSuccess says that the image is in balance, not that it is stable: a straight column beyond its buckling load returns\nSB_OK (nothing pushes it aside), and under compression rest shapes need not be the only ones. Where that may be, ask\nsb_body_modes of *body with options.at_present: SB_ERROR_INDEFINITE where it would buckle.",
    'sb_body_state_size': 'Bytes that sb_body_state_save writes for this body. Loads, constraints, fibres and Prony terms change it, supports\nand other numbers of a material do not. 0: more than size_t holds. Cost: proportional to the body.',
    'sb_body_state_save': 'Writes the state to buffer[size]; size must be at least sb_body_state_size, what is behind that stays. No allocation.\nSB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched).',
    'sb_body_state_load': "Makes the body what it was when buffer[size] was saved. Everything is checked before anything changes:\nSB_ERROR_FORMAT (no saved state, cut short, too long, damaged, a value out of its range), SB_ERROR_UNSUPPORTED (other\nversion or precision), SB_ERROR_STATE (another body's), SB_ERROR_NOT_FINITE, SB_ERROR_ARGUMENT, SB_ERROR_MATERIAL;\nSB_ERROR_MEMORY when more room is needed than the allocator gives. On failure the body is as it was. Where supports,\nmaterials, loads and constraints need no more room and have the rows they had, nothing is allocated.",
    'sb_body_state_save_file': "The same with a file. The body's allocator lends the bytes meanwhile. SB_ERROR_FILE: cannot be opened, read or\nwritten; a file that could not be written whole is what it was before: see sb_output_open.",
    'sb_body_state_hash': '64 bits that differ when anything a saved state holds does: equal for equal runs, whatever the machine or the number\nof threads. No allocation; cost: proportional to the body.',
    'sb_recording_start': 'Begins to record a body, from its present state. One recording per body at a time.\npositions_every  >= 0; 1: displacements of every step, k: of every k-th, the first included; 0: none\nallocator        of the recording, which grows geometrically; NULL: malloc\nRecording never makes a call on the body fail: when memory runs short the recording ends there and says so.\nSB_ERROR_ARGUMENT, SB_ERROR_MEMORY leave *recording untouched. Release with sb_recording_destroy.',
    'sb_recording_stop': 'Stops listening; what was recorded stays. Also happens when the body is destroyed.',
    'sb_recording_destroy': 'Stops and releases; NULL is fine.',
    'sb_recording_save': 'Writes sb_recording_info.bytes to buffer[size]; SB_ERROR_ARGUMENT when it is smaller (then untouched).',
    'sb_recording_load': 'Makes a recording from what sb_recording_save wrote; whole and unharmed, or SB_ERROR_FORMAT, SB_ERROR_UNSUPPORTED\n(version, precision), SB_ERROR_MEMORY, SB_ERROR_ARGUMENT, with *recording untouched.',
    'sb_recording_save_file': 'The same with a file; SB_ERROR_FILE when it cannot be opened, read or written (then it is what it was before).',
    'sb_recording_replay': "Plays a recording on a body made from the same mesh with the same kinds of elements, mass and preconditioner (what\nelse the def says comes with the recording): loads the state it began with, then repeats the calls.\nSB_OK when every step had its result and its hash. SB_ERROR_STATE: a step differed (the report says which; the body\nis as that step left it), or the body is not such a one. Another error: a call was refused that had not been (the\nbody is as the calls before left it). SB_ERROR_ARGUMENT: NULL, or the body is the one being recorded. Of an\nincomplete recording what there is is played. report may be NULL. Takes memory from the recording's allocator for\nthe longest list of arguments, and for constraints from the body's.",
    'sb_body_solve_tangent': 'x = K^-1 rhs for `count` right-hand sides: what small forces (N) added to the present loads displace (m).\n  rhs        [count][node_count] (N); on supported axes it has no effect\n  x          [count][node_count] (m): 0 on supported axes, slaves of constraints follow their masters; may be rhs\n  tolerance  of conjugate gradients, |rhs - K x| / |rhs|, (0, 1); where rounding stops them above it, up to 1e4\n             SB_EPSILON will do. A factored solve is as exact as rounding lets it be\nA factored solve of many right-hand sides at once costs much less than one after the other.',
    'sb_body_sensitivities': 'Derivatives of displacements and of reactions, one solve for each parameter.\n  parameters  [parameter_count]\n  du          [parameter_count][node_count]: du/dp (m per unit of the parameter)\n  dreaction   [parameter_count][node_count]: of sb_body_reactions, the force (N) of the supports on the body; or NULL\nMore errors: SB_ERROR_ARGUMENT naming the parameter: no such kind, axis or constant in its material, a node that is\nnot supported along the axis; SB_ERROR_INDEX: no such region, load or row.\nMethod: K du/dp = -dr/dp, r = f_int - f_ext; reactions dr_s/dp + K_sf du_f/dp. dr/dp is exact: stresses are linear in\nconstants, loads in theirs.',
    'sb_body_gradient': "Gradient of a loss J(u, reactions) with respect to any number of parameters by one solve (adjoint).\n  dj_du         [node_count] dJ/du (J's unit per m); or NULL: 0\n  dj_dreaction  [node_count] dJ/d(reaction) (per N), of no effect on axes that are free; or NULL: 0\n  parameters    [parameter_count], NULL where parameter_count is 0\n  gradient      [parameter_count] dJ/dp: what goes through the equilibrium. What J has of p by itself is to be added\n  dj_dforce     [node_count] dJ/d(dead force on each node) (per N), or NULL\nErrors as sb_body_sensitivities.\nMethod: K^T l = dJ/du + K^T w with w = dJ/dR on supports, m = l - w, dJ/dp = -m . dr/dp; of supports\ndJ/du - K^T m.",
    'sb_recording_gradient': "Gradient of a loss over all steps of a recording with respect to any number of parameters: one linear solve for each\nstep, whatever their number.\n  recording   of steps of implicit Euler that are iterated (sb_body_def.max_newton > 1) to newton_tolerance 1e-6 or\n              less, of any lengths; what was called before the first step is where it began\n  body        as of sb_recording_replay, and no recording listens to it. It ends as the recording does; on failure it\n              is what it was before\n  loss        see above\n  parameters  [parameter_count], of every kind but SB_PARAMETER_SUPPORT. A parameter that calls changed between steps\n              has all of its values shifted alike, and one of a load is of the steps in which the load was there\nCalls between steps count as given: a node held where it was is held at that place, whatever moves it there.\nErrors: those of sb_body_gradient and sb_recording_replay, about steps by number; SB_ERROR_UNSUPPORTED: another\nintegrator or linearised steps, whose derivatives would need those of the tangent; Prony terms; damping in proportion\nto stiffness unless all materials are linear; damping by regions; a body whose mesh may change (def.slack); contact\nthat presses; the density of a grid's elements; calls after the first step that set displacements, velocities or a\nstate, or solve for a rest.\nCost: the recording is played twice, and per step a tangent is made, factored up to 10,000 nodes, and solved with.\nMemory, for the time of the call: some 2 sqrt(steps) saved states and displacements.\nMethod: adjoint. With A = M/dt^2 + D/dt + K at the end of a step, backwards: A l = dJ/du + U + V/dt, then\nU = (M/dt^2 + D/dt) l - V/dt and V = M l/dt of the step before; dJ/dp -= l . dr/dp, dJ/df = l.",
    'sb_identify': "Finds values[count + free_count], which come in as the start.\n  deviations   [count + free_count] standard deviations in the values' units, or NULL\n  own_shares   [count + free_count] or NULL: of what a value changes in the readings, the share (of its square, in\n               units of sigma) that no other values could change instead: 1 alone, 0 hidden by the others\n  info, error  may be NULL\nDerivatives are those of sb_body_sensitivities; one static solve for each state and trial, from the last accepted\nshape. The body ends with the values, at the equilibrium of the last state. On failure values and outputs are\nuntouched and the body has its materials, shape and what `parameters` name again, but other loads and supports as\n`apply` has left them:\nSB_ERROR_ARGUMENT (the def; a start out of range; YOUNG or POISSON together with CONSTANT of one region),\nSB_ERROR_UNSUPPORTED (a kind that is not among those above; what sb_body_sensitivities does not derive),\nSB_ERROR_INDEX, SB_ERROR_NOT_FINITE, SB_ERROR_INDEFINITE (fewer readings than values, or a direction that no reading\nsees: the message names it), SB_ERROR_NOT_CONVERGED (max_iterations; or no step lowers chi2 any more, far from a\nminimum), SB_ERROR_MEMORY; what a static solve at the start, or `apply`, fails with.\nMethod: Levenberg-Marquardt in log (nu: nu = 1/2 logistic(q); gravity, forces, pressures as they are), steps of at\nmost 1 there; a trial whose solve fails counts as one that does not help. A value at a bound that would leave stays\nthere, and the others take the step that is best with it there. Ends when chi2 falls by less than 1e-6 of itself or\nvalues move by less than 1e-8.",
    'sb_network_load': 'Loads a weights file; def NULL: defaults. Takes all memory, about 4 bytes for each weight and for each channel of\neach node in each layer. The file may hold anything: all of it is checked before it is used. Errors, with *network\nuntouched: SB_ERROR_FILE, SB_ERROR_FORMAT (not a weights file, cut off, too long, a checksum that differs, or layers\nthat do not fit one another: error.message names the layer), SB_ERROR_NOT_FINITE (a weight), SB_ERROR_UNSUPPORTED\n(more memory than def.max_bytes), SB_ERROR_ARGUMENT, SB_ERROR_MEMORY.',
    'sb_network_load_memory': "The same of a file's bytes[size], which are not kept.",
    'sb_network_run': "output[z][y][x][outputs] = the network's answer to input[z][y][x][inputs], all nodes of the lattice. Allocates\nnothing; same bits for any threads, which share the planes of each layer. Not from two threads at a time. On failure\nthe output is untouched: SB_ERROR_ARGUMENT (NULL), SB_ERROR_NOT_FINITE (the input, or what floats cannot hold came\nout). Denormal numbers are computed with as any, and take longer.",
    'sb_network_predict': "Guesses the equilibrium of a body of this grid (made from grid->body_mesh, with nodes as they were made) under its\npresent loads and supports. Supports and slaves of constraints are put where they belong. info and error may be NULL.\nSB_NETWORK_TAKE allocates nothing. On failure the body is as it was: SB_ERROR_ARGUMENT (a field, or a grid that is\nnot the body's or does not fit the network's lattice, spacing within 1e-3), SB_ERROR_MATERIAL (a material whose\nPoisson's ratio is off the network's by more than 0.005), SB_ERROR_INDEX and SB_ERROR_NOT_FINITE naming the node,\nSB_ERROR_UNSUPPORTED (a network with other channels; tools in the body's contact; def.slack), what the network\nrefuses, what sb_body_solve_static refuses. A guess that is inside out is no failure: it does not pass.",
    'sb_heat_create': "Heat of a body, one for each at most. Takes all memory for steps from the body's allocator. It becomes part of the\nbody's saved states, recordings and hashes: create it in the body that loads them, too. Destroy it before the body.\nThe def's arrays are copied. Errors, with *heat untouched: SB_ERROR_ARGUMENT (the field, element or region is named;\nthe body has one already), SB_ERROR_NOT_FINITE, SB_ERROR_INDEX (a region that the mesh does not have),\nSB_ERROR_UNSUPPORTED (def.slack, or clouds), SB_ERROR_MEMORY.",
    'sb_heat_destroy': 'The body is as stiff as its materials again. NULL is fine.',
    'sb_heat_hold': 'The nodes have these temperatures (K, > 0) from the next step on; one for all when uniform is 1.',
    'sb_heat_add_source': "An applicator's power (W, below 0: it cools) around the line from one place of the rest shape to another (m; or the\nsame: a ball): nodes get it by their volume times exp(-d^2 / (2 radius^2)), d their distance. All of it arrives,\nhowever coarse the mesh; radius 0: at the nearest nodes.",
    'sb_heat_add_node_source': 'Power (W) at nodes by these shares[count], which sum to 1; NULL: evenly.',
    'sb_heat_add_element_source': 'Power per volume (W/m^3) in elements; NULL and 0: in all.',
    'sb_heat_add_flux': 'Power per area (W/m^2) into faces.',
    'sb_heat_add_convection': "Faces that give coefficient (W/(m^2 K), >= 0) times their temperature above the surroundings' (K, > 0).",
    'sb_heat_set_source': 'Another power (W), density (W/m^3) or flux (W/m^2) of what was added as such; without allocation. SB_ERROR_INDEX: no\nsource has this id.',
    'sb_heat_remove': 'Takes a source or convection away.',
    'sb_heat_power': 'What it gives the body at present (W).',
    'sb_heat_set_temperatures': 'temperatures[node_count] (K, > 0), but for nodes that are held; SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT name the\nnode. Damage stays.',
    'sb_heat_reset': 'def.start everywhere, no damage, nothing in the balance; sources and held nodes stay.',
    'sb_heat_step': "Advances by dt (s, > 0) with implicit Euler: temperatures, then damage, then the elements' stiffness. Keep dt where\nsources or damage change little within it, 1 s and less. Damage is integrated along the line between both\ntemperatures, by trapezoids of 1 K and less. Allocates nothing. info and error may be NULL. A step that fails is\nundone: SB_ERROR_ARGUMENT, SB_ERROR_NOT_CONVERGED, SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (not finite, or below 0 K,\nnaming the node).",
    'sb_heat_solve_steady': 'Temperatures that no longer change under the present sources, with blood where tissue is alive by now. Damage,\nstiffness and balance stay as they are. Also SB_ERROR_UNCONSTRAINED, naming a node of a part that nothing holds,\ncools or perfuses, but for what rounding would take beside what it conducts (2e-12 of that).',
    'sb_heat_temperatures': '---- readings: no allocation ----',
    'sb_heat_damage': '[node_count] (K), valid until destroyed',
    'sb_heat_dead_shares': 'shares[node_count]: 1 - exp(-Om), 0 alive to 1 dead.',
    'sb_heat_dead_volume': 'Volume of tissue at rest (m^3) times the share of it that is dead, summed.',
    'sb_heat_stiffness': "factors[sb_body_element_count] of the elements' stiffness, see def.stiffening.",
    'sb_heat_balance': 'Sums of all steps since creation or the last reset (J).',
    'sb_contact_create': "SB_ERROR_ARGUMENT names the field; SB_ERROR_STATE: the body has a contact already; SB_ERROR_UNSUPPORTED: its steps\nare explicit and def.pairs is not 0, or it is of custom elements and def.skin is given; SB_ERROR_STATE also for a\nskin that is none of this body's mesh, or does not follow its changes; SB_ERROR_MESH: it has no surface, or def.pairs\nis not 0 and def.skin (one of sb_skin_create) is open, turned against itself or inside out: error->element is the\ntriangle; SB_ERROR_MEMORY. *contact is then untouched. Nothing allocates afterwards but sb_contact_add_tool.",
    'sb_contact_add_tool': 'Makes a tool; *tool is its number, the lowest that is free. What sbi_tool_create refuses; SB_ERROR_ARGUMENT: it\noverlaps the body by more than half its inner radius (error->element: the cell of the deepest face), or lies inside\nthe body, however small it is and whether or not it touches a face (error->element: the cell of a face near it; of a\nskin that is open: where lines along all axes of space leave it), or max_tools are there, or the pose takes it too\nfar, see below; SB_ERROR_UNSUPPORTED: so thin that the faces would need too many samples (needle.h is for such).',
    'sb_contact_remove_tool': 'In all calls below SB_ERROR_ARGUMENT: no contact, or a point of the tool would be farther than 1e9 m from the origin,\nor so far that rounding moves it by a hundredth of its radius (of 1 cm in floats: 840 m); SB_ERROR_INDEX: no such\ntool; SB_ERROR_NOT_FINITE: a number that is none. Nothing changes then.',
    'sb_contact_move_tool': 'Where it is to be at the end of the next step.',
    'sb_contact_place_tool': 'At once, without a way, and with its contacts forgotten. SB_ERROR_ARGUMENT: too deep in the body or inside it, as at\ncreation.',
    'sb_contact_bend_tool': "Capsules: the chain at the end of the next step, points[as many as the def had] (m, in the tool's frame).",
    'sb_contact_wrench': "What the body does to the tool: the sum of exactly the forces put on the body's nodes, with the opposite sign.",
    'sb_contact_reached': 'Where the tool is, and how far a point of it may still be from where it was sent (m). Either place may be NULL.',
    'sb_contact_stiffness': "k[i][j]: what component i of the wrench (force, then torque about the tool's position, which goes along) would change\nby if the tool had gone farther along axis j (m), or turned (rad) about axis j - 3 through its position, with the\ntissue giving way as in the last step: N/m, N, N m. Of a step that was divided (info.substeps) as in its last part:\ninertia makes tissue stiffer over a shorter time. What slips keeps its bound, and normals their directions. Of a\ntool on a spring that of the surface alone. Six linear solves to 1e-3, which allocate nothing. 0 where nothing\ntouches. SB_ERROR_STATE: something was done since the last step or static solve (a state loaded, a tool placed), so\nthat its system is gone.",
    'sb_contact_coupling': 'What its spring does to a tool with coupling_stiffness; 0 for others. It is the wrench with the opposite sign, to\n1e-9, but in a step in which the tool went as far as it may, and for the torque of a tool that turns as it is sent\nto.',
    'sb_contact_grip': 'Reads two tools as one grip: any two, whatever holds them. SB_ERROR_INDEX: no such tool, or twice the same.',
    'sb_contact_points': 'How many there are, the first `capacity` of them in points (NULL with capacity 0).',
    'sb_contact_pressures': '[node_count], with a skin [its points]: mean pressure (Pa at rest) that tools exert on the surface there: for\ndrawing. 0 elsewhere.',
    'sb_haptic_create': "Takes all memory that is ever needed. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE: the field is named; SB_ERROR_INDEX: the\ncontact has no such tool; SB_ERROR_UNSUPPORTED: the body's steps are explicit, or the compiler has no atomics that\nare known here, so that SB_ATOMIC_EXCHANGE and SB_ATOMIC_LOAD must be defined before the implementation;\nSB_ERROR_MEMORY. *haptic is then untouched.",
    'sb_haptic_destroy': 'NULL is fine. Neither thread may be in a call.',
    'sb_haptic_take': "Simulation, before the step: the tool is to go where the hand drew it by its last call (sb_contact_move_tool); of a\ntool on a spring the spring's other end goes where the hand is.\nwanted (NULL: not asked for): that pose, and the hand's velocities, time and buttons; 0 before the first call. What\nsb_contact_move_tool returns; SB_ERROR_ARGUMENT: NULL.",
    'sb_haptic_publish': "Simulation, right after the step, before anything else is asked of the body: what the tool feels, and how that\nchanges with its pose. Costs about a tenth of the step: one solution of the step's system, for one stiffness in turn.\nSB_ERROR_ARGUMENT: NULL; SB_ERROR_INDEX: the tool was removed.",
    'sb_haptic_force': "Device, about every 1 ms, one thread at a time: *out is finite and within the def's limits whatever `in` is. 1: it\nfollows the hand; 0: it fades, or there is none. No lock, no allocation, no loop without a bound.",
    'sb_haptic_get_info': 'Simulation: as of the last sb_haptic_take.',
    'sb_haptic_from_hd': "A device's state from what OpenHaptics gives: HD_CURRENT_TRANSFORM (column-major, mm) and HD_CURRENT_VELOCITY (mm/s).\nTime and buttons are the caller's to fill in; NULL: all 0.",
    'sb_cut_create': 'Makes what cuts a body; one at a time for each body, to be destroyed before or after it. SB_ERROR_ARGUMENT,\nSB_ERROR_UNSUPPORTED (slack 0, other elements), SB_ERROR_STATE (a body that is cut already), SB_ERROR_MEMORY. With\nmultigrid it makes the levels once more (25 ms of 129,600 tets), so that the first cut takes as long as others.',
    'sb_cut_destroy': 'The body stays cut, and keeps what tells its pieces apart (sb_body_find_cell), for points and needles that are in\nthem: in its own memory; where there is none left they are held as if nobody knew the pieces. NULL is fine.',
    'sb_cut_triangles': "Cuts along triangles: a blade's way, a plane, a closed surface around what is to be taken out.\ntriangles  [count][3] corners where the body is now (m); triangles without area are skipped\ninfo       may be NULL\nOn failure body and cut are as they were: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_STATE (see above), and\nwhat sb_body_change_commit says. Between steps only. Allocates nothing while slack and room last. Cells look for\ntriangles near them in a tree, on the body's jobs, and where cells are parted the mesh changes: 13,440 tets, m = 2,\none thread: 0.02 ms beside the body, 4 ms for a frame that parts 100 cells, 18 ms for a plane through all.",
    'sb_cut_begin': "Begins a stroke of a blade.\nedge    [count] corners of the blade's edge, where it is now (m); 2 or more. It cuts nothing yet\n*stroke is its number\nSB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE, SB_ERROR_STATE (see above, or def.max_strokes are under way),\nSB_ERROR_MEMORY. Allocates nothing while edges go through some 200 faces of elements at most.",
    'sb_cut_move': 'Moves the blade: what lies between where its edge was in the tissue, which may have moved since, and where it is now\nis cut. Once a frame, between steps; also where the blade rests and the tissue moves.\nedge       as many corners as at the beginning, where they are now (m)\ninfo       may be NULL\nOn failure body, cut and stroke are as they were, and the next move goes on from the last good one: SB_ERROR_INDEX\n(no such stroke), and as sb_cut_triangles.',
    'sb_cut_scissors': 'Moves scissors: their stroke is begun with the edge tips[0], hinge, tips[1]. Closing cuts what the blades pass\nbetween where they were in the tissue and where they are now, until they meet; open or opening, at rest or shut they\ncut nothing, wherever they go.\n\nhinge  where both blades begin, now (m)\n\ntips   [2] their ends\n\ninfo   may be NULL. torque is about the hinge; work over the angle is the moment that closing takes\n\nElse as sb_cut_move; SB_ERROR_ARGUMENT also for a stroke that has not 3 corners.',
    'sb_cut_end': 'Ends a stroke; one that is not under way is fine.',
    'sb_cut_ablate': "Takes out what lies in a ball: as a cautery burns or a sucker draws it.\ncentre, radius  where the body is now (m); radius >= 0\ninfo            may be NULL\nPoints of the lattice in the ball go, and links from them to others are cut at the ball's surface, where\nsb_cut_surface says SB_CUT_CHAR; what comes off thereby is a part of its own. Of a smooth ball of twice an element's\nsize lattice 4 takes the volume to 2 %. Errors as sb_cut_triangles, and SB_ERROR_ARGUMENT: a negative radius. Cost as\nof a cut of the elements on the ball's surface.",
    'sb_cut_tear': "Tears what is stretched too far: elements whose largest principal stress (Cauchy) is over sqrt((lambda + 2 mu) J_c /\n(4 h)), with def.toughness J_c and h their volume over the area of the section torn, come apart across it, the worst\nfirst. Those that a cut has come to tear first, on from there; else one in a call begins a new tear. Between steps;\nstresses are those of the body as it is, so that a tear goes on as steps bring stress to its front. Tears take J_c\nfor their area within 20 %, for tet4 and Poisson's ratios up to 0.3; nearly incompressible tet4 half to twice that.\noptions    NULL: defaults\ninfo       may be NULL\n\nOn failure body and cut are as they were: SB_ERROR_ARGUMENT (toughness 0, too), SB_ERROR_STATE, SB_ERROR_MEMORY, and\nwhat sb_body_change_commit says. The first call allocates; each reads the stress of all cells (13,440 tets, one\nthread: 4 ms).",
    'sb_cut_node_origin': 'Node of the uncut mesh that a node is a copy of, or itself; -1: none. Of elements: the one that a cell is of.',
    'sb_cut_surface_create': 'The surface of a body that is cut by `cut`, which it is to be destroyed before. allocator NULL: malloc. Has room for\nthe lips of a cut half through the body from the start: 3 MB for 13,000 elements with a lattice of 2.\nSB_ERROR_ARGUMENT, SB_ERROR_STATE (as sb_cut_triangles), SB_ERROR_MEMORY.',
    'sb_cut_surface_update': 'To what the body is now. Where it was cut since the last call, the triangles of all elements with cuts are made anew,\nand arrays may grow; else only vertices move. SB_ERROR_STATE: as sb_cut_triangles. SB_ERROR_MEMORY: what is drawn is\nnot whole, and the next call tries again.',
    'sb_cut_surface_skin': "The surface as a skin, for sb_contact_def.skin: tools touch the skin and the lips of the body where they are, not the\nwhole elements whose pieces move there; and with sb_contact_def.pairs so do parts that were cut off, and the two lips\nof a cut. It is the surface's, and nothing of its own is to be destroyed; the contact\ngoes first.\nContact follows each call that cuts and each state that is loaded in the step that comes next, which may take memory\nthen, and remembers what it did of triangles that are still there; until then it reads as before. It brings the\nsurface up to date for that: arrays of sb_cut_surface_get are to be got again after a step, and the next\nsb_cut_surface_update still names all that was made since the one before. Where that fails, the step says so. NULL of\nNULL.",
    'sb_cut_fine_create': "A skin for the body that is cut by `cut`, which it is to be destroyed before.\nskin       SB_TRI3, at rest where the body's mesh is (m), copied\nallocator  NULL: malloc\nSB_ERROR_ARGUMENT (other elements), what sb_mesh_validate says of the skin, SB_ERROR_STATE (as sb_cut_triangles),\nSB_ERROR_MEMORY. Finds the element of each vertex: some 2 us each.",
    'sb_cut_fine_update': 'To what the body is now. Where it was cut since the last call all triangles are listed anew, and arrays may grow;\nelse only vertices move. SB_ERROR_STATE: as sb_cut_triangles. SB_ERROR_MEMORY: what is drawn is what it was, and the\nnext call tries again.',
    'ndl_rod_section_preset': "The section of a known needle. Diameters: regular-wall gauge table after the Birmingham wire gauge (18 G: 1.270\nmm, 22 G: 0.7176 / 0.413 mm). Steel: AISI 304, annealed, 193 GPa, 0.29, 8000 kg/m^3. Nitinol: austenite, 75 GPa,\n0.33, 6450 kg/m^3 (makers' sheets: 75 to 83 GPa; linear up to a strain of about 1 % only). SB_ERROR_ARGUMENT for\nan unknown preset leaves *section untouched.",
    'ndl_rod_stiffness_of': 'E A, E pi (r^4 - ri^4)/4 twice, bending/(1 + nu), rho A. The section must be valid.',
    'ndl_rod_create': 'Creates a rod at rest, with no twist but what its rest shape asks for. All memory it will ever need is taken here.\nOn failure *rod is untouched: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named), SB_ERROR_MESH (node\nnamed: an edge without length, or one turned back), SB_ERROR_MEMORY.',
    'ndl_rod_hold': 'From the next step or static solve on the node is held at `position` (m), with `velocity` (m/s) at the end of the\nstep; NULL: the mean velocity of its way there. Where both nodes of an end edge are held the end is clamped: the\ntangent is given at the inner one of them.',
    'ndl_rod_turn': "The material frame of an edge is held and will turn by `angle` (rad, any size) about the edge's tangent in the next\nstep or static solve; otherwise it turns only as the edge does.",
    'ndl_rod_hold_base': "The base as a sleeve holds it: node 0 at `position`, edge 0 along `tangent` (any length but 0) at its rest length, m1\nalong `director` (projected). The frame is turned there the short way: less than half a turn from the last one,\ncarried along with the tangent. velocity (m/s) of the sleeve's point and angular_velocity (rad/s); both NULL or\nboth given.",
    'ndl_rod_set_force': 'Dead force (N) on a node, and torque (N m) about its tangent on an edge; they replace those before.',
    'ndl_rod_set_grip': "What surrounds an edge holds it against turning about its tangent: a torsion spring of this stiffness (N m/rad, >= 0;\n0: none, the default) that slips at the torque `limit` (N m, >= 0). In each motion it is wound by the turn of the\nmaterial frame beyond what the edge's own way asks for. It replaces the grip before: a stiffer one keeps the torque\n(what comes to it is not yet wound), a softer one how far it is wound, both up to the new limit. For a grip per\nlength give both times the edge's length. When edges are split, merged or set anew, their halves, sums or shares\nfollow.",
    'ndl_rod_step': "Advances the rod by dt (s, > 0) with Newmark's average acceleration (beta 1/4, gamma 1/2: second order),\n    M a' = f(x', v'),  x' = x + dt v + dt^2 (a + a')/4,  v' = v + dt (a + a')/2,\nby Newton's method with a banded direct solve, frames eliminated together with the nodes; each iteration lowers the\nstep's potential. While supports and loads do not change the energy is watched: a step that would raise it above\nwhere it was when they last changed by more than 1 % of what is in motion and in strain is taken by implicit Euler,\nwhich only loses energy. Without supports linear momentum is kept to rounding.\ninfo may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED: a torque about a rod no edge of which is\nheld; SB_ERROR_DIVERGED) the rod is as before the call, to the last bit. Allocates nothing; cost grows with\nnode_count, about 30 us for 20 nodes and an iteration.",
    'ndl_rod_solve_static': 'Finds the equilibrium nearest downhill under the present loads and supports; velocities become 0. Newton with the\nexact Hessian of stretch, bending and twist where that is positive definite; where it is not, the lower end of two\nsteps: of the same with the least diagonal that makes it so, and of Gauss-Newton. At a buckling load that takes some\n30 iterations, well beyond it up to 110. Steps turn edges rather than stretch them, and a line search lets the energy\nonly fall. Supports move there in pieces\nwhen their way is long. A straight rod under more than its buckling load is in equilibrium and stays so until\nsomething pushes it aside. options and info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED:\nthe supports leave the rod free to move; SB_ERROR_NOT_CONVERGED; SB_ERROR_DIVERGED) the rod is as before the call.\nAllocates nothing.',
    'ndl_rod_set_positions': 'Overwrites positions [node_count] or velocities [node_count]; frames follow as if the rod had been moved there.\nSB_ERROR_NOT_FINITE, SB_ERROR_MESH (node named) change nothing.',
    'ndl_rod_split_edge': 'A new node j + 1 in the middle of edge j, on the cubic through both ends with their tangents; it is held when both\nwere.',
    'ndl_rod_merge_node': 'Takes the inner node out: its edges become one.',
    'ndl_rod_feed': 'Feeds `length` (m, either sign) of rod through the base: edge 1 gets longer or shorter at rest. SB_ERROR_ARGUMENT\nwhen nothing would be left of it, or the rod has no edge 1.',
    'ndl_rod_reparameterise': "Gives the rod other nodes, `count` of them, on (about) its own curve; the first and the last should be its ends. What\nit carries follows by arc distance, scaled so that both ends agree: velocities and accelerations linearly, rest\nlengths, rest curvature and material frames by Akima's interpolation. Total rest length, mass and linear momentum\nstay, and so does the material frame of edge 0; the rest length of edge 0, too, where its nodes are held. Supports\nand loads of nodes 0 and 1 and of edge 0 stay, all others are dropped. positions [count] (m) are read during the\ncall. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (count above capacity), SB_ERROR_NOT_FINITE and SB_ERROR_MESH (node\nnamed: an edge without length, or one turned back) change nothing. Allocates nothing. Source: Chentanez 2010,\nsection 9.2.",
    'ndl_rod_node_count': '---- readings: no allocation ----',
    'ndl_rod_velocities': '[node_count] (m), valid until destroyed',
    'ndl_rod_mass': '[node_count] (m/s)',
    'ndl_rod_rest_length': 'kg',
    'ndl_rod_frame': 'Material frame of an edge, 0 <= edge < node_count - 1.',
    'ndl_rod_tip': 'Tip position (m) and the frame of the last edge; either may be NULL.',
    'ndl_rod_curvature': "Curvature (1/m) at an inner node, 0 < node < node_count - 1, towards m1 and m2 (mean of the two edges' frames).",
    'ndl_rod_twist': 'Twist (rad) at an inner node: the turn of the material frame from one edge to the next beyond parallel transport.',
    'ndl_rod_forces': 'Elastic and viscous force (N) on every node from the present state, forces[node_count]: minus the gradient of the\nelastic energy at fixed material frames, and the damping.',
    'ndl_rod_reactions': 'Force (N) of the supports on each node in the last step or static solve, 0 where free; [node_count].',
    'ndl_rod_reaction_torque': "Torque (N m) about the tangent that holds an edge's frame, in the last step or static solve; 0 where free.",
    'ndl_rod_grip_torque': "Torque (N m) about the tangent with which the surroundings' grip turns an edge; 0 where there is none.",
    'ndl_rod_base_wrench': 'What holds the base, as force (N) and torque (N m) about node 0 on the rod: what a hand feels is the opposite.',
    'ndl_remesh_create': "SB_ERROR_ARGUMENT (field named; the body has a remesher already), _UNSUPPORTED (elements other than SB_TET4;\ndef.slack was 0), _MEMORY leave *remesh untouched. While it has changed the mesh, changes by others are refused\n(SB_ERROR_STATE).\n\nFrom now on the remesher is part of the body's saved state, its hash and its recording: sb_body_state_load asks for a\nbody with a remesher of the same def, and brings needles, splits and what is needed to undo them back to the last\nbit. A recording of the body holds the calls below; it is played on a body with such a remesher. Make remeshers\nbefore a recording is started, and destroy them after it has been stopped: what follows otherwise is refused when it\nis played.",
    'ndl_remesh_destroy': 'Leaves the body as it is. Safe on NULL.',
    'ndl_remesh_reserve': 'Takes the memory that a needle of up to so many nodes in the tissue usually needs, so that calls ask for none while\nthe mesh keeps to its slack. SB_ERROR_INDEX, _ARGUMENT (nodes < 0) and _MEMORY change nothing that can be seen.',
    'ndl_remesh_puncture': "First contact: puts a node where the skin was hit, which is the needle's entry from then on, and its tip until it\ngoes deeper. The skin keeps its shape: nodes of it move within flat parts only, edges are split where the point lies\non them or their faces are in one plane; but see entry_slip. info->X: where the entry is.",
    'ndl_remesh_penetrate': 'The tip cuts on (retracts) to X_new (m, in the material), by as many operations as ndl_remesh_limit asks for, in a\nstraight line. After a failure it stays where the last operation brought it. A point outside: see\nndl_remesh_info.outside.',
    'ndl_remesh_withdraw': 'The needle leaves: its nodes are released and its splits undone. When no other needle is in, the mesh is the\noriginal one, number by number and place by place; else what a near needle prevents follows later. Where the body\nrefuses (SB_ERROR_MEMORY) it stays in. Does nothing for a needle that is not in.',
    'ndl_remesh_nodes': 'Nodes of the needle in the tissue, entry first, tip last; consecutive ones are joined by an edge. NULL and 0 when it\nis not in. Valid until the next call.',
    'ndl_remesh_limit': "How far one operation may take the tip (m): half the shortest edge at the tip, but for the needle's own.",
    'ndl_remesh_material_point': "Material position of a point in space, looked for from the tip; 0 when it is outside (*X is then the continuation of\nthe nearest tet's map), else 1.",
    'ndl_remesh_hit': "First face of the body's surface that the segment crosses from outside in space (m); 0 and *hit untouched when there\nis none. O(tets): for a needle that is not in yet.",
    'ndl_remesh_split_count': 'Splits not undone yet.',
    'ndl_remesh_quality': 'How good the mesh is in the material; any place may be NULL. Quality: 6 sqrt(2) V / l_rms^3, 1 for the regular tet;\nangles in degrees. O(tets).',
    'ndl_remesh_is_original': '1 when the mesh is the one that the remesher was made on, number by number and place by place.',
    'ndl_remesh_check': "Whether what the remesher knows of the mesh is consistent and the body's: for tests. SB_ERROR_MESH names the first\nfault.",
    'ndl_helix_pose': 'The pose after `length` (m, either sign) of insertion at a steady twist (rad of turn per m of insertion, about t),\nfor a tip that bends with `curvature` (1/m). Exact for any size, also for 0. Pure turning is ndl_tip_turn.',
    'ndl_tip_turn': 'The pose turned in place by `angle` about t.',
    'ndl_helix_radius': 'Radius (m) of that helix, k/(k^2 + w^2), and its way ahead per turn, 2 pi |w|/(k^2 + w^2); k and w not both 0.',
    'ndl_bevel_offset': 'Offset h (m) for an advance d (m) of a tip whose last edge is edge_length (m) long; 0 for d <= 0 (retraction).\nSB_ERROR_ARGUMENT (law, angle, edge_length <= 0, or an edge too long for the circle: |curvature| (l + d) > 2) and\nSB_ERROR_NOT_FINITE leave *offset untouched.',
    'ndl_bevel_shift': "The material displacement F^-1 (offset m2) of the tip's material point; F is the deformation gradient about the tip,\naveraged by volume over the tip's star (that of one element jumps). SB_ERROR_INVERTED when det F <= 0,\nSB_ERROR_NOT_FINITE; *shift is then untouched.",
    'ndl_bevel_curvature': "Curvature (1/m) that a bevel gives in rigid tissue, with edges and advances as given (see above for errors). That of\na needle has advance 0, edge_length the bevel's guide.",
    'ndl_obstacle_distance': 'Distance (m) of a point from an obstacle, negative inside; for functions of slopes up to max_slope their value\ndivided by it: never more than the distance. SB_REAL_MAX for NULL or a kind that is none; what\nelse is wrong with an obstacle ndl_plan_make says.',
    'ndl_plan_make': 'The helix from the tip that ends nearest to the target (m), to the tolerance: branch and bound over length and twist,\nafter a descent from a few starts which mostly settles it. Where obstacles are in its way, sequences of pieces: the\nfirst ones sampled and improved, the last one aimed at the target; of those that reach the target one that is short\nand has room on both sides. A path ends where it is nearest: it is never inserted further. A tip nearer to an\nobstacle than def.clearance keeps nine tenths of the distance it has. SB_OK with any outcome. SB_ERROR_ARGUMENT,\n_NOT_FINITE (field or obstacle named) leave *plan untouched. 2 us where turning gets there, else about 0.3 ms (1 ms\nwhere max_boxes run out), 1 to 10 ms past obstacles (without turning to 0.1 s). Deterministic to the bit.',
    'ndl_plan_pose': 'The pose `length` (m) along a plan, in [0, plan->length] (clamped), from the tip it was made for; at 0\nwith its first turn made.',
    'ndl_default_steer_def': 'curvature and max_length as in ndl_default_plan_def.',
    'ndl_steer_begin': 'SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE leave *steer untouched.',
    'ndl_steer_update': 'One round: the plan from the sensed tip to the sensed target (m; tissue moves it), and what to do. Pieces of a plan\npast obstacles are aimed anew at where they were to end, and the way is searched anew when that is no longer clear.\nThe controller learns from the sensed tips, by averages that forget: how far their way leans from where they look\n(soft tissue gives way sideways under a needle that bends) over def.learn of insertion, and with what curvature their\nway turns over twice that. Plans begin along the way so found and use that curvature, which is never taken for more\nthan the given one or less than half of it, less def.reserve. It is only measured once the tip has turned by 0.05\nrad: before, it may be in air.\nOnce the status is not GOING it stays and nothing more is commanded; ndl_steer_begin starts over. SB_ERROR_NOT_FINITE\nand SB_ERROR_ARGUMENT (a frame that is none) change nothing. Cost: see ndl_plan_make.',
    'ndl_push_begin': 'SB_ERROR_ARGUMENT (field named; a compliance that moves nothing across the path), _NOT_FINITE leave *push untouched.',
    'ndl_push_update': "From the sensed point of interest (m) after another dt (s, > 0) to the manipulator's force (N): the one within cone\nand max_force that comes nearest to displacing the point by proportional error + integral of the error. While a limit\nholds, the integral grows only where that leads away from the limit. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing.",
    'ndl_push_choose': "The cheapest of `count` places to push at: def with each compliance and direction (directions may be NULL: def's) in\nturn, for a point of interest at `point`. *best: the index of the one that needs the least force, or, where none\nbrings the point all the way, of the one that leaves the least; *force (N) and *left (m, may both be NULL): that\nforce and what it leaves. SB_ERROR_ARGUMENT and _NOT_FINITE leave all untouched.",
    'ndl_guide_make': 'The path, among `samples` random ones (the straight one to the target first) and `climbs` changes of the best, whose\npushes cost least; paths that leave obstacles in the way or the target aside cost more than any that do not.\nDisplacements add up (linear tissue); a place pushes in one phase only. Points of interest beyond NDL_GUIDE_PHASES -\n1 are not pushed, but count. SB_OK with any outcome. Failures leave *guide untouched: SB_ERROR_ARGUMENT (field,\nobstacle or place named), SB_ERROR_NOT_FINITE (also of the model). Some 0.1 ms for a path and phase with 8 places,\nbeside what the model takes, which is asked some 128 times for each of up to four tries of a path and each place in\nuse. Distances are looked at in 64 points of a path: an obstacle thinner than 1/64 of it may lie between two, and\n`clearance` is too large by up to 1/32 of the path over 8 clearances. A distance that is no number is within an\nobstacle. Deterministic to the bit, nothing is allocated.',
    'ndl_needle_create': "A needle at rest, at its body from then on. *needle is untouched on failure: SB_ERROR_ARGUMENT (field named; a tip\nthat begins in the tissue; a membrane between regions that do not meet), _NOT_FINITE, _MATERIAL (section),\n_UNSUPPORTED (NDL_MAX_NEEDLES are there; what the body is made of, see def.body), _MEMORY.\n\nFrom then on it is part of the body's saved state, hash and recording. A state that was saved with needles, in\nmid-insertion too, is loaded (sb_body_state_load) into a body that has needles of the same defs, made in the same\norder, wherever they are: it goes on to the last bit. A recording holds ndl_step and ndl_needle_move_base, and is\nplayed on such a body. Make needles before a recording is started, and destroy them after it has been stopped: what\nfollows otherwise is refused when it is played. A `cutting` of your own is not saved: both must do the same.",
    'ndl_needle_destroy': 'Takes it out of the tissue first. NULL is fine.',
    'ndl_needle_move_base': 'In the next step the sleeve goes to `base` (m), looks along `direction` and turns its m1 into `director` (any length\nbut 0; the short way), beside what the command says: for sleeves that are tracked. director 0: turned only as the\ndirection turns. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing.',
    'ndl_step': "Advances a body and all its needles by dt (s, > 0): in place of sb_body_step, which moves the body without them.\nneedles: [count], each needle of the body once, in any order; commands: [count] beside them, or NULL: zeros\ninfo may be NULL. On failure all is as before: SB_ERROR_ARGUMENT (needle missing or doubled; a command that would\ntake over 1000 substeps), _NOT_FINITE (command named); SB_ERROR_UNSUPPORTED, a needle is at a node that constraints\neliminate; with NDL_REMESH, two needles would share an element (which are, is said), or the body is cut\n(sb_cut_triangles);\nSB_ERROR_DIVERGED (node named); SB_ERROR_INVERTED (element named); SB_ERROR_MEMORY; SB_ERROR_STATE, another change of\nthe body is open. Where the mesh has changed within a step that fails and there is no memory to take that back\neither, SB_ERROR_MEMORY says so: body and needles are then between two states until the next call of ndl_step or\nndl_needle_create, which takes the step back first, or until a saved state is loaded. Steps that do without memory\nthey asked for (info->blocked) are not repeated by a recording that has it.\n\nA step is divided where a tip comes to an edge of a membrane, and would go past it by more than a quarter of the\nmembrane's thickness, or a command is fast, and where it fails as a whole: the rod would fold, tissue would turn\ninside out, or of hyperelastic tissue max_newton iterations do not bring it to where the needle has gone (what is\nread of a needle is never the force of that gap). Supports and tools of an sb_contact go evenly over its parts, and\nwhat tools feel, as a blade's forces, is of the step that was made, whatever was tried before. In parts cut short by\na membrane a tool that just comes to the tissue feels the parts' shorter time: up to 8 % of the force that it has\nlater (measured in 8 scenes).\n\nThe linear systems of the body's own step are solved together with needles and friction (see couple.h), to its\ntolerance: one where it is linearised (max_newton 1), otherwise until body, needles and friction balance. Needles are\nstepped by implicit Euler, the body by its own integrator. SB_EULER and SB_GENERALISED_ALPHA with spectral_radius 0,\nwhich is of second order, let the force on the base settle at once when the needle stops; others do not damp the\nmotion that friction leaves in the tissue. Measured (nitinol needle 3.5 cm deep in 50 kPa, push 1.20 N, steps of 20\nms): half a second after the stop the force stays within 1e-4 N with the two; with SB_NEWMARK it goes on ringing by 5\nmN, without damping_stiffness by 0.34 N; with spectral_radius 0.8 it jumps by up to 0.45 N from step to step while\nthe needle moves (0.007 N with 0).\n\nSteps of a millisecond, as hands ask for, take some 0.6 of the time with NDL_EMBED in a body of tet4 that keeps its\ntangent (sb_body_keep_tangent), and the force on the base stays the same to a millionth.",
    'ndl_needle_rod': 'The rod: positions, frames, curvature; nodes 0 and 1 are in the sleeve, node 1 at its outlet. Valid until the needle\nis destroyed, its arrays until the next step.',
    'ndl_needle_tip': "Where the tip is and looks, for ndl_steer_update; it bends towards frame.m2. With NDL_BEVEL_CURVATURE t is where the\npath goes on; the rod's last edge, a chord, lags behind by half of what it bends, and more after a turn.",
    'ndl_needle_base_wrench': 'What the sleeve exerts on the needle at its outlet: force (N) and torque (N m) about it, in the last step. What a\nhand feels is the opposite. Either may be NULL.',
    'ndl_needle_entry': "First node of the rod in the tissue; the rod's node_count when it is outside. With NDL_EMBED the edge before it goes\nin through the skin, and is held there, too: that node has a contact state and force.",
    'ndl_needle_body_node': 'Tissue node that a rod node is at; -1: none, as with NDL_EMBED.',
    'ndl_needle_remesh': "What follows the tips of all needles of its body, for readings: ndl_remesh_quality, _is_original, _nodes ...; gone\nwith the body's last needle. NULL with NDL_EMBED.",
    'ndl_needle_contact_force': 'Force (N) of the tissue on a node in the last step.',
    'ndl_needle_depth': 'Length of shaft in the tissue, in holes that were burnt in it, and out of one on its far side (m), and fed since\ncreation.',
    'ndl_needle_advance': 'How far the tip went through the tissue in the last step (m, along the tip; negative: back).',
    'ndl_needle_cutting': 'Force (N) that would let the tip go forward now; SB_REAL_MAX while it is held.',
    'ndl_needle_tip_material': 'Material point (m) of the tip; 0 when the needle is outside, else 1.',
    'ndl_rod_state_size': "For rods that are stepped by themselves: a needle's is part of its body's state (sb_body_state_save).\n\nA saved rod holds all that steps, setters and splits change. What follows a load is what followed the save, bit for\nbit, also in another process or machine with the same order of bytes. It is loaded into a rod that was made from the\nsame def, in the same precision; capacity and allocator may differ.\n\nsize: bytes that save writes for the rod as it is. save: size must be at least that, what is behind stays; nothing\nthat a step could notice changes, nothing is allocated. load: size may be larger than what was saved; allocates\nnothing. Buffers need no alignment.\n\nFailures leave everything as it was (and `error` may be NULL): SB_ERROR_ARGUMENT (NULL, or too small a buffer);\nSB_ERROR_FORMAT (no saved rod, cut short, damaged, a count out of its range); SB_ERROR_UNSUPPORTED (other version,\nprecision or order of bytes); SB_ERROR_STATE (another def's, or more nodes than there is room for);\nSB_ERROR_NOT_FINITE.",
    'reg_rigid_compose': 'First `first`, then `then`.',
    'reg_rigid_angle': 'The axis times 2 sin, and 1 + 2 cos: together they determine small angles and angles near pi alike.',
    'reg_rigid_fit': 'The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).\nfrom, to: [count] partners (m); weights: [count] >= 0, not all 0, or NULL: all 1; count >= 1. Where the points leave\nthe rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)\nleave *motion untouched. No allocation.',
    'reg_kdtree_create': 'Makes a tree of points[count] (m; count >= 1, points may coincide), which are copied. One block of memory from\n`allocator` (NULL: malloc; at most 80 bytes per point) and scratch that goes back.\nO(count log count). SB_ERROR_ARGUMENT (null pointer, no points, or a coordinate whose square would overflow),\n_NOT_FINITE (error->node: the point), _MEMORY; then *tree is untouched.',
    'reg_kdtree_count': 'Number of its points; 0 for NULL.',
    'reg_kdtree_nearest': 'Index of the point nearest to `point` among those at most `within` (m; SB_REAL_MAX: any) away, and its squared\ndistance (m^2) in *squared (may be NULL). -1 (nothing written) when there is none, the tree is NULL, or an argument\nis not finite or negative. O(log count) for points near the cloud.',
    'reg_kdtree_k_nearest': 'The k nearest points, nearest first: indices[k] and squared distances squared[k] (m^2; both needed). Returns how many\nwere found: k, or all points when there are fewer; 0 for k < 1, NULL, or a point that is not finite.',
    'reg_kdtree_within': 'All points at most `radius` (m) away: returns how many, of which the first `room` are written to indices[room] (may\nbe NULL with room 0: only count). In no particular, yet always the same order. 0 as above.',
    'reg_cloud_free': 'Frees the arrays and leaves zeros; accepts NULL and a cloud of zeros.',
    'reg_cloud_from_points': 'Copies points[count] (count >= 1) and normals[count] (or NULL; made unit length). SB_ERROR_ARGUMENT, _NOT_FINITE\n(error->node), _MEMORY.',
    'reg_cloud_from_mesh': 'The nodes of a mesh. Of a surface (tri3 .. quad9) with normals: the mean of the faces around, weighted by area, 0\nwhere there is none; of a volume without. Fails as sb_surface_create does.',
    'reg_cloud_load': 'Reads a cloud from a file; every coordinate is multiplied by `scale` (> 0; files in millimetres: 0.001). A normal is\nmade unit length, and 0 where its length is 0. SB_ERROR_ARGUMENT, _FILE (cannot be read), _FORMAT (also: no points),\n_NOT_FINITE, _UNSUPPORTED, _MEMORY; error says file and line, in binary parts the byte, and error->node the point.',
    'reg_cloud_load_memory': 'The same from memory: data[size], borrowed during the call. name stands for the path in errors and in telling the\nformat; may be NULL.',
    'reg_cloud_save_ply': 'Writes a PLY file, binary little-endian in the precision of sb_real or ASCII with all digits, with normals when there\nare. SB_ERROR_ARGUMENT, _NOT_FINITE, and _FILE as for the writers of meshes.',
    'reg_cloud_estimate_normals': 'Gives the cloud normals (in place of any it had): across the plane fitted to each point and its k nearest (k >= 3;\n8 to 20 is usual). With a view point they face it. With view NULL neighbours are made to agree, each following the\none it is most parallel to (Hoppe et al. 1992), and the highest point (largest z) of each connected part looks up:\noutward for closed surfaces. 0 where points are so few, or so much in one line or place, that there is no plane.\njobs: NULL: inline; only the fits run on it. SB_ERROR_ARGUMENT, _NOT_FINITE, _MEMORY: the cloud is untouched.',
    'reg_cloud_thin': 'One point for each cube [i, i+1) x [j, j+1) x [k, k+1) times `size` (m, > 0) that holds any: the mean of its points,\nand of their normals made unit length. In the order in which the cubes were met first. SB_ERROR_ARGUMENT,\n_NOT_FINITE, _MEMORY; *thin (may be the same as cloud: then replaced) is untouched on failure.',
    'reg_cloud_spread': '`wanted` points (or all) of points[count], evenly spread: first the one farthest from their mean, then always the one\nfarthest from those chosen. Their indices go to chosen[wanted]; scratch[count]. Returns how many: fewer where points\ncoincide. The same for any pose up to rounding. O(wanted count). No allocation.',
    'reg_outlier_limit': 'The largest of distances[count] that is no outlier may be so large; keep d <= limit. Distances that are not finite\n(points without a partner) are outliers by themselves and do not count. scratch[count]. SB_REAL_MAX for NONE, -1 when\nno distance counts or the rule or parameter is out of range. O(count), no allocation.',
    'reg_cloud_remove_outliers': 'Takes out points whose mean distance to their k nearest (k >= 1) is an outlier by the rule; the others keep their\norder. *removed (or NULL): how many. SB_ERROR_ARGUMENT, _NOT_FINITE, _MEMORY: the cloud is untouched.',
    'reg_cloud_smooth': "Takes noise off a cloud: each point goes to where quadratics fitted to its neighbours say the surface is, over as\nmany neighbours (16 to 128) as agree with one another up to the noise, which is measured first, robustly: flat parts\nare smoothed widely, edges keep their shape. Where noise is under a twenty-fifth of the points' spacing none moves.\nOutliers are removed: points farther from a robust fit to their neighbours than 4 standard deviations of the noise\nand the points' spacing, 2.5 times as far from the next points as those are from theirs, or amid scattered ones.\nNormals, when there are any, keep unlike sides of thin parts apart, and become those of the fits.\ninfo: or NULL. jobs: NULL: inline. About 60 us per noisy point.\nSB_ERROR_ARGUMENT, _NOT_FINITE (error->node), _MEMORY: the cloud is untouched.",
    'reg_cloud_smooth_mesh': "The same for the nodes of a surface, open or closed. Nodes whose shortest edge is 3 times as long as their\nneighbours' are outliers, too; all of these are put amid their neighbours in the mesh, so that no holes come about.\nFails as reg_cloud_from_mesh does, too; the surface is then untouched.",
    'reg_field_create': 'SB_ERROR_ARGUMENT (no target or two, a field out of range), SB_ERROR_NOT_FINITE (error->node: the point, or the\nnormal), what sb_surface_create says of the surface, SB_ERROR_MEMORY; *field is then untouched. Everything is copied.\nQueries allocate nothing and may come from any number of threads. Release with reg_field_destroy.',
    'reg_field_closest': '1 and *hit; 0 for a point that is not finite or absurdly far away (*hit untouched). guess: the item of a query\nnearby, or -1; it changes the time, not the answer. About 1 us with a good guess.',
    'reg_field_along': "Samples the potential at point (m) along the unit vector direction:\n    phi_n = [phi(s + h n/2) - phi(s - h n/2)] / h,  phi_nn = d phi_n / ds\nwith h = step (m, > 0), which rounds the potential's kink on the target off. phi_nn is the exact derivative of this\nphi_n, from the slopes at its two ends, not a difference of its own: Newton's method then converges as it should.\nLaplace's phi outside its box is that of the nearest point of the box. Returns 0 as above.\nSource: Suwelack 2014, (7.3), (7.15).",
    'reg_field_at': 'phi (m) at a point, and its gradient unless NULL: away from the closest point, or of the trilinear interpolation. On\nthe target itself, where the distance has none, it is 0. Returns 0 as above.',
    'reg_field_bounds': 'Smallest box around the target (m).',
    'reg_field_sweeps': 'Laplace: sweeps that its solution took; 0 for distances.',
    'reg_icp_stop_string': '"converged", "iterations", "time"; static.',
    'reg_warning_string': '"ambiguous", "inverted normals", ...: of one warning; static. "unknown" else.',
    'reg_icp': 'The motion that brings the model to the target.\n\noptions  NULL: reg_default_icp_options()\nmotion   written on success, also when a cap ended the run; info (or NULL) too\nSB_ERROR_ARGUMENT (what is said above; weights all 0), _NOT_FINITE (error->node: the point), _MEMORY,\n_NOT_CONVERGED (no pair within max_distance): outputs untouched.\n\nAbout 0.1 s for surfaces of 6,000 points with search, 0.02 s without. Points that lie in a line, a plane or one place\nleave motions open; it then takes one of the best.',
    'reg_cpd_fit': "Moves source onto target.\nsource, target  [count] (m), at least one point each, in any order; copied\noptions         NULL: defaults\nfit             made on success; the caller's, for reg_cpd_destroy; untouched otherwise\nA cap that was reached is no error: info.stop reports it, and the fit is as good as it got.\nCost of an iteration: at most source_count target_count exponentials (about 5 ns each), and as sigma shrinks those of\nnear blocks of points only; non-rigid in addition source_count rank^2 / 2 + rank^3 / 6 multiply-adds. Memory: rank\n(source_count + rank) doubles. The same bits for any jobs.\nSB_ERROR_ARGUMENT (also a landmark of no point: error->node is its index), _NOT_FINITE (error->node; the message\nnames the cloud; also where a fit goes beyond what sb_real holds), _UNSUPPORTED (more than max_pairs), _CANCELLED,\n_NOT_CONVERGED (no target point is near enough any source point to be more than an outlier), _MEMORY.",
    'reg_cpd_moved': "The source where it was moved to: [source_count] (m), in its order; the fit's.",
    'reg_cpd_partners': "For each source point the target point that is most probably its partner, -1 where all probabilities are 0; the\nfit's. Several source points may name one target point: compare probabilities.",
    'reg_cpd_probabilities': '[source_count] the probability of that: that the target point was drawn from this source point.',
    'reg_cpd_linear': 'x -> linear x + translation (m) of kinds rigid, similarity and affine; of non-rigid what the frames of the clouds\nmake of a point far from the source.',
    'reg_cpd_apply': 'moved[count]: where the points (m) go; in place is fine. `rank` exponentials for each point. Nothing happens for\nNULL. Points that are not finite give NaN. Thread-safe.',
    'reg_match_create': "Makes a match; the body is not touched. SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no\nYoung's modulus to measure charges with), SB_ERROR_UNSUPPORTED (a body with constraints or custom elements),\nwhat reg_field_create says of the target and sb_embedding_create of the surface (points far\noutside included), SB_ERROR_MEMORY; *match is then untouched. All memory that steps need is taken here.",
    'reg_match_step': 'One step: moves the body and raises the charge. info may be NULL. On failure the body is as before:\nSB_ERROR_INVERTED (element named), SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (also when at full charge the organ\nhas less than a quarter or more than four times its volume); SB_ERROR_NOT_CONVERGED when too little of the\nsurface is near the target; SB_ERROR_UNSUPPORTED when the body has got constraints; SB_ERROR_STATE when its mesh has\nchanged: make a match of it anew. A recording of\nthe body holds the shape that it comes to, and replays without the match. Allocates nothing, unless loads were added\nto the body since. The same bits for any number of threads. Landmarks and supports may move between steps: matching\nthen follows them.',
    'reg_match_run': 'Steps until the match settles, `steps` (>= 0) are done or the time is up: all of these are SB_OK, and info->stop says\nwhich. Errors as of a step.',
    'reg_match_restart': 'Back to the first charge and reach, as if no step had been: for a body that was reset or moved. The time goes on.',
    'reg_match_move_landmarks': 'New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE names none and\nchanges nothing; a settled match runs again.',
    'reg_match_landmarks': "Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed.",
    'reg_match_body': "The body's: sb_body_positions and sb_body_displacements are the result.",
    'reg_match_get_sample': 'SB_ERROR_INDEX for no such sample; *sample is then untouched.',
    'reg_nicp_create': "Makes a registration; the body's shape is not touched, its loads get the penalties, with no force yet.\nSB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no Young's modulus to measure the penalty\nwith), what reg_field_create says of the target, what sb_surface_create, sb_embedding_create and sb_grid_map_points\nsay of the surface and the landmarks, SB_ERROR_UNSUPPORTED (a body of custom elements), SB_ERROR_MEMORY; *nicp and\nthe body are then untouched.",
    'reg_nicp_step': 'One look at the target and the balance after it. info may be NULL. On failure the body is as before:\nSB_ERROR_NOT_CONVERGED when too little of the surface has a partner, SB_ERROR_DIVERGED when the organ has less than a\nquarter or more than four times its volume, and what sb_body_solve_static says; SB_ERROR_STATE\nwhen its mesh has changed: make a registration of it anew. Allocates nothing. The same bits for any number\nof threads. A recording of the body holds the penalties and the balance, and replays without the registration.',
    'reg_nicp_run': 'Steps until the shape converges, the increments or `steps` (>= 1) are done, or the time is up: all of these are\nSB_OK, and info->stop says which. Errors as of a step.',
    'reg_nicp_restart': 'Back to the first increment, as if no step had been: for a body that was reset or moved. The time goes on.',
    'reg_nicp_move_landmarks': 'New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE changes nothing;\na run that had ended goes on with the last increment.',
    'reg_nicp_landmarks': "Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed.",
    'reg_nicp_body': "The body's: sb_body_positions and sb_body_displacements are the result.",
    'reg_nicp_surface_count': "Where the surface is now: points[reg_nicp_surface_count] (m), the vertices of def.surface, or the boundary's nodes in\nthe order of sb_mesh_boundary; untouched when the body's mesh has changed. Through the grid's mapping for bodies in\ngrids.",
    'reg_nicp_get_source': 'SB_ERROR_INDEX for no such source; *source is then untouched.',
    'reg_loads_run': 'Moves the body of a match to where loads on little of its surface bring it.\nforces  [nodes of the body] found (N), 0 inside and where nodes are held; or NULL\ninfo    or NULL\nReturns SB_ERROR_ARGUMENT (a field, named), SB_ERROR_UNSUPPORTED (a Laplacian match; a body with pressures, springs,\nmappings or constraints), SB_ERROR_STATE (its mesh has changed since the match was made), SB_ERROR_INVERTED (element\nnamed), SB_ERROR_INDEFINITE,\nSB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED (nothing of the surface is near the target), SB_ERROR_MEMORY; the\nbody is then as before and forces are untouched. All memory is taken at the beginning and released at the end.\nDeterministic.',
    'reg_model_create': 'Makes a model; everything is copied. SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INDEX (a fixed node),\nSB_ERROR_UNSUPPORTED (custom elements), what sb_body_create says of the mesh, sb_surface_create and\nsb_embedding_create of the surface; SB_ERROR_MEMORY. *model is then untouched. One inference at a time may use a\nmodel, and the model must outlive it.',
    'reg_model_node_count': 'NULL is fine',
    'reg_infer_run': "Infers; all memory is taken here, from the model's allocator. SB_ERROR_ARGUMENT (a field, named),\nSB_ERROR_NOT_FINITE (error->node: the point, the landmark or the curve), what sb_surface_create says of a target\nsurface, SB_ERROR_NOT_CONVERGED (no point of the target has an allowed place of the model, or loads cannot be told),\nSB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *infer is then untouched. Deterministic; the same bits for any number of\nthreads, without a time limit.",
    'reg_infer_displacements': "displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame. Where less than 15 %\nof the surface is seen and no landmark or curve was given, a tenth tells too little of the rest: the answer is then\nhalf the way from the start to the elastic shape, or the start where loads explain no more than a pose does\n(quality.belief). Without landmarks and curves all answers stop short of the elastic shape by as much as it is unsure\nfor how far from the start it is (quality.sure). What is left of the way is in the errors to expect.",
    'reg_infer_forces': "forces[nodes] (N for a Young's modulus of 1000 Pa: they scale with it) that are found to act, weight included: those\nof the whole way, of which the answer goes quality.sure.",
    'reg_infer_expected': 'expected[nodes]: root mean square error (m) to expect of each node.',
    'reg_infer_covariance': 'Where points[count] of the organ at rest (m) are, moved[count], and the covariance of that, covariances[count] (m^2);\neither may be NULL. SB_ERROR_NOT_FINITE, what sb_embedding_create says of points far off, SB_ERROR_MEMORY\nleave both untouched. From the draws, so that single covariances are known to a quarter.',
    'reg_infer_best_landmark': 'Which of points[count] of the organ at rest (m) is worth touching: the one that, seen as a landmark of deviation `sd`\n(m, >= 0), lowers the mean error to expect most, and what that would then be, expected (m); it may be NULL. It takes\nthe draws for all that may be (regression on them); that with a landmark an answer goes the whole way is not in it.\nOf three random organs seen from above 7.0 to 7.8 mm became 5.2 to 5.8, foretold 5.5 to 6.3; the best of nine points\nwas found in two of them, in the third one 1.2 times as good as that. SB_ERROR_ARGUMENT, and as above: nothing is\nwritten then. 1 ms per point for 2,000 nodes.',
    'reg_infer_get_quality': 'SB_ERROR_ARGUMENT.',
    'reg_prior_string': '"rigid", "smooth", "local", "gravity", "pressure"; "converged", "rounds", "time".',
    'reg_track_create': "Makes a tracker; all memory is taken here, from the model's allocator. Takes the time of a round of an inference.\nSB_ERROR_ARGUMENT (a field, named), SB_ERROR_INVERTED, SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *track is then\nuntouched. Deterministic, as steps are; the same bits for any number of threads.",
    'reg_track_restart': "Begins anew about an inference's answer, or, `start` NULL, about where the organ is now: shapes are linear about\nthat, what was known of the amounts is forgotten, and the pose is as sure as at a start. For after it was lost, and\nfor large deformations. Allocates nothing; takes as long as the creation. The errors of reg_track_create: nothing\nhas changed then. A target that waits stays.",
    'reg_track_set_target': 'What is seen now, for the next step; replaces a target that waits. Copied. A surface is refused. SB_ERROR_ARGUMENT,\nalso for more than def.most_points, and SB_ERROR_NOT_FINITE (error->node: the point): nothing has changed.',
    'reg_track_set_features': "Which of the def's landmarks and curves are seen now, and where, for the next step: landmarks[def.landmark_count] and\ncurves[def.curve_count] in the def's order, of which `seen` and `sd` are read and copied. An infinite sd stands for\nwhat is not seen now: it counts nothing, and its `seen` is not looked at. Replaces features that wait; a step takes\nthem in beside a target or without one. They are rows of the state, as patches of the target are, but counted for\nwhat they are by themselves: the farther one is off what was expected of it, the less it counts (Student's t of three\ndegrees of freedom), so that one that is taken for another does little, while all that move alike are followed.\nDeviations below a ten-thousandth of the organ's size count as that.\n\nNULL where the def has none. SB_ERROR_ARGUMENT (NULL, an sd out of its range, a line without length, a place farther\nthan 100 of the organ's sizes from where it is: most often one in millimetres) and SB_ERROR_NOT_FINITE name the\nlandmark or curve (error->node): nothing has changed. Allocates nothing.",
    'reg_track_step': 'Goes on by dt (s, > 0), and takes in the target and the features that wait, if there are any. Allocates nothing. info\nmay be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEFINITE, SB_ERROR_NOT_FINITE: nothing has changed but that target and\nfeatures are gone.',
    'reg_track_displacements': "displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame.",
    'reg_track_covariances': "covariances[nodes] (m^2) of that, in the target's frame. Some (modes + 6)^2 multiply-adds a node: for a look now and\nthen, not for each frame.",
    'reg_track_save_size': 'A saved tracker holds all that steps, restarts and targets change, what waits included: what follows a load\nis what followed the save, bit for bit, also in another process or machine. It is loaded into a tracker of the same\nmodel that was made with the same def (most_points may differ), in the same precision. Some\n3 (modes + 1) reals a node. The model and its body are not part of it: steps leave them alone.\n\nsize: bytes that save writes for the tracker as it is; 0 for NULL. save: what is behind them stays.\nSB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched). Neither allocates.',
    'reg_track_load': "Allocates nothing. Everything is checked first; on failure the tracker is as it was: SB_ERROR_ARGUMENT (NULL),\nSB_ERROR_FORMAT (no saved tracker, cut short, damaged, a number out of its range), SB_ERROR_UNSUPPORTED (other\nversion or precision), SB_ERROR_STATE (another model's or def's), SB_ERROR_NOT_FINITE.",
    'reg_track_state_string': '"follows", "predicts", "jumped", "lost".',
}
