/*
 * softbody.h - soft-tissue physics for surgical trainers and image-guided surgery, in one header.
 *
 * Loads a volume mesh of an organ (or makes one), gives it a material, moves it in real time or finds its
 * equilibrium, and lets you read forces and stresses. C99 or C++11, libc and libm, nothing else.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file:
 *
 *     #define SB_IMPLEMENTATION
 *     #include "softbody.h"
 *
 * and in all others only the second line. Link with -lm. Optimise (-O2 or -O3, and -march=native or your target's
 * vector flags if you can): the loops are written to be vectorised. What gcc and clang compile for every x86-64 holds
 * the loops over corotated tetrahedra twice, and runs those for AVX2 where the processor has it, with the same bits.
 *
 * OPTIONS (define before including, the same in every file)
 *
 *     SB_REAL            double (default) or float. The exported names of a float build end in _f32.
 *     SB_STATIC          everything static: two libraries in one process never clash. Put SB_IMPLEMENTATION in each
 *                        file that includes the header then.
 *     SB_SHARED          a shared library or DLL: the file with SB_IMPLEMENTATION exports the public functions, also
 *                        under -fvisibility=hidden; all others import them.
 *     SB_API             what stands before each public function in place of extern (in C++ extern "C"), of needle.h's
 *                        and register.h's too unless NDL_API and REG_API are defined.
 *     SB_ELEMENT         SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27 or SB_CUSTOM: compile the loops of this element
 *                        only. Other elements are refused with SB_ERROR_UNSUPPORTED. Default: all.
 *     SB_USE_OPENMP      with -fopenmp: sb_jobs_openmp() spreads the loops over OpenMP's threads.
 *     SB_ASSERT(c)       what checks the library's own invariants; default nothing. Bad input never reaches it.
 *     SB_NO_VECTORS      no compiler vector types in preconditioner and direct solver and nothing compiled twice: plain
 *                        loops, same bits, slower.
 *     SB_NO_FILES        leaves out what reads and writes files of meshes, images and point clouds: sb_mesh_load, _save
 *                        and theirs. Saved states and recordings stay, in memory and in files. register.h needs these
 *                        readers.
 *     SB_NO_GEOMETRY     leaves out surfaces, sb_mesh_stuff, grids, embeddings and what touches surfaces: tools, organs
 *                        and hands (SB_NO_CONTACT). needle.h and register.h need them.
 *     SB_NO_PARTICLES    leaves out sb_particles.
 *     SB_NO_CONTACT      leaves out sb_contact and sb_haptic.
 *     SB_NO_CUT          leaves out sb_cut.
 *     SB_NO_HEAT         leaves out sb_heat.
 *     SB_NO_NETWORK      leaves out sb_network.
 *     SB_NO_IDENTIFY     leaves out derivatives (sb_body_gradient and its kin) and what is identified by them.
 *                        docs/questions.md tells what these save.
 *     SB_ALLOW_FAST_MATH insist on -ffast-math, which otherwise is an error: it breaks determinism and NaN checks.
 *
 * WHAT IT DOES NOT DO
 *
 * No rendering. Cuts (sb_cut) are of tet4 and of tet10 with straight sides. What else is not there: README, Limits.
 * A linearised step (the real-time default) trades accuracy within a step for a bounded frame time.
 *
 * A FIRST PROGRAM
 *
 * A beam, clamped at one end, sags under its weight; then the same as a static solve:
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #include "softbody.h"
 *     #include <stdio.h>
 *
 *     static int fail(const sb_error *error)
 *     {
 *         fprintf(stderr, "%s: %s\n", sb_result_string(error->result), error->message);
 *         return 1;
 *     }
 *
 *     int main(void)
 *     {
 *         sb_mesh mesh = {0};
 *         sb_error error;
 *         if (sb_mesh_beam(SB_TET10, 10, 3, 3, sb_v3(0.2, 0.06, 0.06), NULL, &mesh, &error) != SB_OK)
 *             return fail(&error);
 *
 *         sb_body_def def = sb_default_body_def();
 *         def.mesh = &mesh;
 *         def.material = sb_material_corotated(50e3, 0.45, 1000);   // E (Pa), Poisson's ratio, density (kg/m^3)
 *         def.gravity = sb_v3(0, 0, -9.81);
 *         def.damping_stiffness = 0.02;                             // Rayleigh beta (s)
 *         sb_body *body = NULL;
 *         if (sb_body_create(&def, &body, &error) != SB_OK)
 *             return fail(&error);
 *
 *         for (int i = 0; i < mesh.node_count; i++)                 // clamp the end at x = 0
 *             if (mesh.nodes[i].x < 1e-9 && sb_body_fix_nodes(body, &i, 1, SB_XYZ) != SB_OK)
 *                 return 1;
 *
 *         sb_step_info info;
 *         for (int frame = 0; frame < 60; frame++)
 *             if (sb_body_step(body, 1.0 / 60, &info) != SB_OK)
 *                 return fail(&info.error);
 *         int tip = mesh.node_count - 1;
 *         printf("after a second: %.2f mm\n", 1e3 * sb_body_displacements(body)[tip].z);
 *
 *         if (sb_body_solve_static(body, NULL, &info) != SB_OK)
 *             return fail(&info.error);
 *         printf("at rest: %.2f mm after %d Newton iterations\n", 1e3 * sb_body_displacements(body)[tip].z,
 *                info.newton_iterations);
 *         sb_body_destroy(body);
 *         sb_mesh_free(&mesh);
 *         return 0;
 *     }
 *     ```
 *
 * CONCEPTS
 *
 * Units are SI: metre, kilogram, second, newton, pascal. Files in millimetres: sb_load_options.scale = 0.001.
 *
 * sb_mesh      nodes and elements of one type: tet4, tet10, hex8, hex20, hex27 (volumes), tri3, tri6, quad4, quad8,
 *              quad9 (surfaces), with VTK's node orders. Plain arrays: load them (sb_mesh_load), generate them
 *              (sb_mesh_beam, _cylinder, _ellipsoid, _organ) or fill them yourself. `regions` assigns materials.
 *              An element of your own is an sb_element_table (see examples/custom_element.c).
 * sb_material  a model and its parameters; made by sb_material_corotated() and others, by sb_material_preset() from
 *              the literature, or by sb_material_fit() from measurements. sb_material_with_fibres() and _with_prony()
 *              add fibres and relaxation.
 * sb_body      a mesh with materials, supports, loads and a state of motion. Created from a def, stepped, read.
 * supports     degrees of freedom that follow a target: sb_body_hold holds, sb_body_place moves (a tool),
 *              sb_body_place_rigid by a pose (a bone), whose force and torque sb_body_wrench reads.
 * loads        gravity, nodal forces, tractions: dead loads that stay until sb_body_clear_loads. Pressures, springs to
 *              moving points, mapped points drawn to targets, cables (sb_body_add_cable: ligaments, sutures) and
 *              membranes on faces (sb_body_add_membrane: capsules, walls) follow the body and have ids, as does what
 *              fills a hollow (sb_body_add_cavity: gas, liquid, a volume).
 * rigid bodies bones, ribs, plates and clamps with mass, which nodes hang on and which move freely
 *              (sb_body_add_rigid), their six unknowns solved with the nodes.
 * constraints  linear equations among displacements, exact: sb_body_add_constraint; sb_body_tie_faces glues meshes.
 * state        sb_body_state_save and _load: back to a moment, in memory or a file; what follows has the same bits.
 * sb_heat      temperatures in a body, perfused tissue that dies of them, and stiffness that follows: ablation.
 * sb_network   a trained network on the nodes of a lattice: loaded from a weights file and run; sb_network_predict
 *              weighs what it guesses of a static solve, takes it or starts the solve from it.
 * recording    sb_recording_start: every call on a body, to be replayed; says which step differs, and where.
 *
 * sb_surface   triangles that answer: closest point, ray, signed distance, winding number. sb_surface_check reports
 *              whether they bound a solid, sb_surface_repair mends what can be mended.
 * sb_image     labels of voxels, from a segmentation: sb_image_surface makes surfaces of them, sb_image_set_regions the
 *              regions of a mesh.
 * volumes      from surfaces: sb_mesh_stuff fills them with tets (several nested ones with regions); sb_grid_create
 *              lays them into a grid of bricks that they cut, sb_particles_create fills them with particles;
 *              sb_mixture_create gives elements of a mesh that lie in several organs shares of each. All take
 * an sb_shape: a surface, or a distance function. sb_cut       triangles that cut a body while it runs; sb_cut_surface:
 * what is drawn of it; sb_cut_fine: a fine skin of your own that is cut along. sb_embedding points and surfaces carried
 * along by a volume mesh, and forces on them brought back.
 *
 * Which material? sb_material_corotated for real time up to large rotations and moderate strains: it survives any
 * shape, inside out included. sb_material_stable_neo_hookean for large strains that must survive too.
 * sb_material_neo_hookean, _neo_hookean_isochoric, _mooney_rivlin, _reduced_polynomial and _svk to agree with textbooks
 * and industrial solvers.
 *
 * Which element? tet10 bends well; tet4 is fastest per element but too stiff in bending and above nu 0.35; hex8 for
 * structured blocks up to nu 0.4; hex20 and hex27 for accuracy on blocks. def.single_rotation makes tet10 take less
 * time. Near incompressibility all lock, quadratic elements too (on even meshes hex8 from nu 0.4, hex20 and hex27 from
 * 0.49, tet10 from 0.495: sb_body_check warns, sb_check_report says how much), unless def.integration is
 * SB_INTEGRATION_BBAR, which tet10, hex8, hex20 and hex27 have, or SB_INTEGRATION_PATCH, which tet4 have.
 *
 * Which integrator? SB_EULER for trainers. SB_GENERALISED_ALPHA for studies of large or fast motion, SB_NEWMARK for
 * small motion that must keep its energy, SB_CENTRAL_DIFFERENCE where many short steps without a solve pay: soft
 * tissue, coarse meshes.
 *
 * An organ from a file, held at its top, pulled by a tool, its force read:
 *
 *     ```c fragment
 *     sb_mesh organ = {0};
 *     sb_error error;
 *     if (sb_mesh_load(&organ, "liver.vtk", NULL, &error) != SB_OK) {
 *         fprintf(stderr, "%s:%d: %s\n", error.file, error.line, error.message);
 *         return 1;
 *     }
 *     sb_mesh_reorder(&organ, NULL, NULL, NULL);          // better cache use, fewer iterations
 *
 *     sb_body_def def = sb_default_body_def();
 *     def.mesh = &organ;
 *     def.material = sb_material_stable_neo_hookean(5e3, 0.45, 1060);
 *     sb_body *body = NULL;
 *     if (sb_body_create(&def, &body, &error) != SB_OK)
 *         return 1;
 *
 *     sb_check_report report;                             // units, slivers, missing supports?
 *     sb_body_check(body, &report);
 *     for (unsigned bit = 1; bit <= SB_CHECK_DUPLICATES; bit <<= 1)
 *         if (report.warnings & bit)
 *             fprintf(stderr, "warning: %s\n", sb_check_string(bit));
 *
 *     sb_vec3 low, high;
 *     sb_mesh_bounds(&organ, &low, &high);
 *     int tool = 0;                                       // the lowest node is what the tool grips
 *     for (int i = 0; i < organ.node_count; i++) {
 *         if (organ.nodes[i].z > low.z + (sb_real)0.9 * (high.z - low.z))
 *             sb_body_fix_nodes(body, &i, 1, SB_XYZ);
 *         if (organ.nodes[i].z < organ.nodes[tool].z)
 *             tool = i;
 *     }
 *     for (int frame = 0; frame < 30; frame++) {
 *         sb_vec3 pull = sb_v3(0, 0, (sb_real)(-0.0003 * frame));
 *         sb_step_info info;
 *         sb_body_prescribe(body, &tool, 1, SB_XYZ, &pull, 1);
 *         if (sb_body_step(body, (sb_real)(1.0 / 60), &info) != SB_OK)
 *             fprintf(stderr, "frame %d: %s\n", frame, info.error.message);   // the step was undone; go on
 *     }
 *     sb_vec3 force = sb_body_reactions(body)[tool];      // what the tool exerts on the organ (N)
 *     printf("pulling with %.3f N\n", -(double)force.z);
 *
 *     sb_field field = {"displacement", SB_FIELD_NODES, 3, &sb_body_displacements(body)[0].x};
 *     sb_mesh_save_vtk("pulled.vtk", &organ, &field, 1, NULL);
 *     sb_body_destroy(body);
 *     sb_mesh_free(&organ);
 *     ```
 *
 * A tool on a spring, whose force is read each frame; the liver remembers; a moment is saved and come back to:
 *
 *     ```c fragment
 *     sb_mesh block = {0};
 *     sb_error error;
 *     if (sb_mesh_beam(SB_HEX8, 6, 3, 3, sb_v3(0.1, 0.05, 0.05), NULL, &block, &error) != SB_OK)
 *         return 1;
 *     sb_body_def def = sb_default_body_def();
 *     def.mesh = &block;
 *     def.integration = SB_INTEGRATION_BBAR;               // this liver is nearly incompressible
 *     def.material = sb_material_preset(SB_LIVER_KIM, 1060);
 *     sb_body *body = NULL;
 *     if (sb_body_create(&def, &body, &error) != SB_OK)
 *         return 1;
 *     for (int i = 0; i < block.node_count; i++)
 *         if (block.nodes[i].x == 0)
 *             sb_body_fix_nodes(body, &i, 1, SB_XYZ);
 *
 *     int tip = block.node_count - 1, spring;
 *     sb_real stiffness = 20;                              // N/m
 *     sb_vec3 tool = block.nodes[tip], force = {0, 0, 0};
 *     if (sb_body_add_springs(body, &tip, 1, &stiffness, 1, &tool, &spring, &error) != SB_OK)
 *         return 1;
 *     size_t size = sb_body_state_size(body);
 *     void *moment = malloc(size);
 *     if (!moment || sb_body_state_save(body, moment, size) != SB_OK)
 *         return 1;
 *     for (int attempt = 0; attempt < 2; attempt++) {      // the second brings the same bits
 *         for (int frame = 1; frame <= 30; frame++) {
 *             tool = sb_v3_add(block.nodes[tip], sb_v3(0, 0, (sb_real)(-0.0005 * frame)));
 *             sb_body_move_springs(body, spring, &tool);
 *             if (sb_body_step(body, (sb_real)(1.0 / 60), NULL) != SB_OK)
 *                 return 1;
 *             sb_body_spring_forces(body, spring, &force); // on the tissue (N); the tool feels the opposite
 *         }
 *         printf("attempt %d: the tool feels %.4f N\n", attempt, -(double)force.z);
 *         if (sb_body_state_load(body, moment, size, &error) != SB_OK)
 *             return 1;
 *     }
 *     free(moment);
 *     sb_body_destroy(body);
 *     sb_mesh_free(&block);
 *     ```
 *
 * From a closed surface to a simulation, and back to the screen:
 *
 *     ```c fragment
 *     sb_mesh drawn = {0}, tets = {0};
 *     sb_surface *skin = NULL;
 *     sb_embedding *embedding = NULL;
 *     sb_error error;
 *     if (sb_mesh_load(&drawn, "liver.obj", NULL, &error) != SB_OK ||
 *         sb_surface_require(&drawn, SB_SURFACE_OPEN_EDGES | SB_SURFACE_FLIPPED, NULL, NULL, &error) != SB_OK ||
 *         sb_surface_create(&drawn, NULL, &skin, &error) != SB_OK) {
 *         fprintf(stderr, "%s\n", error.message);
 *         return 1;
 *     }
 *     sb_shape shape = {skin, NULL, NULL, 0, 0};
 *     sb_stuff_def stuff = sb_default_stuff_def();
 *     stuff.shapes = &shape;
 *     stuff.shape_count = 1;
 *     stuff.cell = (sb_real)0.02;                         // m
 *     if (sb_mesh_stuff(&stuff, &tets, NULL, &error) != SB_OK)
 *         return 1;
 *     sb_body_def def = sb_default_body_def();
 *     def.mesh = &tets;
 *     def.material = sb_material_corotated(5e3, 0.45, 1060);
 *     def.gravity = sb_v3(0, 0, (sb_real)-9.81);
 *     sb_body *body = NULL;
 *     if (sb_body_create(&def, &body, &error) != SB_OK)
 *         return 1;
 *     sb_vec3 low, high;
 *     sb_mesh_bounds(&tets, &low, &high);
 *     for (int i = 0; i < tets.node_count; i++)
 *         if (tets.nodes[i].z < low.z + (sb_real)0.2 * (high.z - low.z))
 *             sb_body_fix_nodes(body, &i, 1, SB_XYZ);
 *
 *     sb_embedding_def carried = sb_default_embedding_def();
 *     carried.mesh = &tets;
 *     carried.surface = &drawn;
 *     if (sb_embedding_create(&carried, &embedding, &error) != SB_OK)
 *         return 1;
 *     sb_vec3 *points = (sb_vec3 *)malloc((size_t)drawn.node_count * sizeof *points);
 *     for (int frame = 0; points && frame < 10; frame++) {
 *         if (sb_body_step(body, (sb_real)(1.0 / 60), NULL) != SB_OK)
 *             break;
 *         sb_embedding_update(embedding, sb_body_positions(body), points, NULL, NULL);   // draw these
 *     }
 *     free(points);
 *     sb_embedding_destroy(embedding);
 *     sb_body_destroy(body);
 *     sb_surface_destroy(skin);
 *     sb_mesh_free(&tets);
 *     sb_mesh_free(&drawn);
 *     ```
 *
 * From a segmented scan to tets whose regions are its labels (1 liver, 2 tumour, say):
 *
 *     ```c fragment
 *     sb_load_options options = sb_default_load_options();
 *     sb_label_def labels = sb_default_label_def();
 *     sb_image scan = {0};
 *     sb_mesh outside = {0}, tets = {0};
 *     sb_surface *skin = NULL;
 *     sb_error error;
 *     options.scale = (sb_real)0.001;                     // the file is in millimetres
 *     labels.image = &scan;                               // all labels but 0
 *     if (sb_image_load(&scan, "scan.nrrd", &options, &error) != SB_OK ||
 *         sb_image_surface(&labels, &outside, NULL, &error) != SB_OK ||
 *         sb_surface_create(&outside, NULL, &skin, &error) != SB_OK) {
 *         fprintf(stderr, "%s\n", error.message);
 *         return 1;
 *     }
 *     sb_shape shape = {skin, NULL, NULL, 0, 0};
 *     sb_stuff_def stuff = sb_default_stuff_def();
 *     stuff.shapes = &shape;
 *     stuff.shape_count = 1;
 *     stuff.cell = (sb_real)0.01;                         // m
 *     if (sb_mesh_stuff(&stuff, &tets, NULL, &error) != SB_OK || sb_image_set_regions(&scan, &tets, &error) != SB_OK)
 *         return 1;
 *     sb_surface_destroy(skin);
 *     sb_mesh_free(&tets);
 *     sb_mesh_free(&outside);
 *     sb_image_free(&scan);
 *     ```
 *
 * ERRORS
 *
 * Calls that can fail return an sb_result: SB_OK (0) or a negative SB_ERROR_. They leave their outputs untouched
 * then, and fill an optional sb_error: a sentence with file and line, element or node. Nothing prints, exits or
 * aborts. A step that fails is undone: the body is as before the call and can go on.
 *
 * MEMORY
 *
 * Every object takes an sb_allocator ({0}: malloc). All memory for stepping is taken at creation and when supports
 * are added; a step allocates nothing. When the allocator returns NULL the call fails with SB_ERROR_MEMORY and
 * nothing leaks. Calls of this header, of needle.h and of register.h need at most 128 kB of stack, most of it for the
 * stiffness of a cloud of 32 nodes (74 kB), on each thread that works for def.jobs too; your callbacks come on top of
 * it.
 *
 * THREADS
 *
 * No globals (but one record per thread that calls sb_jobs_openmp()'s loops). Different objects may be used from
 * different threads; one object by one thread at a time. A body's own loops spread over the threads behind def.jobs:
 * give it your job system's run function, or sb_jobs_openmp(), whose comment names the environment variables that
 * matter.
 *
 * DETERMINISM
 *
 * The same input gives the same bits with any number of threads, and with any compiler and optimisation that does
 * IEEE arithmetic without contraction: a pragma here says so to clang; with gcc compile as -std=c99 or
 * -ffp-contract=off where fused multiply-add exists (the header asks for it where it can).
 *
 * REFERENCE
 *
 * The declarations below are the reference, room by room: core (results, allocator, jobs), dense (vectors, matrices,
 * decompositions), element, mesh, meshgen, meshio, image, labels, surface, stuffing, material, material_fit, sparse,
 * domain, direct, multigrid, precond, pcg, grid, particles, body, live_mesh (meshes that change: sb_body_change_begin),
 * load, embed, body_embed (points that follow a body whose mesh changes), constraint, step, modes, state, record.
 */
