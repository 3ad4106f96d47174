/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef NDLI_NAMES_H
#define NDLI_NAMES_H

#if defined(SB_REAL)
#define NDLI_NAMES_PASTE_(a, b) a##b
#define NDLI_NAMES_PASTE(a, b) NDLI_NAMES_PASTE_(a, b)
#define NDLI_NAMES_OF_double 0
#define NDLI_NAMES_OF_float 1
#if NDLI_NAMES_PASTE(NDLI_NAMES_OF_, SB_REAL)
#define ndl_rod_section_preset ndl_rod_section_preset_f32
#define ndl_rod_stiffness_of ndl_rod_stiffness_of_f32
#define ndl_default_rod_def ndl_default_rod_def_f32
#define ndl_rod_create ndl_rod_create_f32
#define ndl_rod_destroy ndl_rod_destroy_f32
#define ndl_rod_hold ndl_rod_hold_f32
#define ndl_rod_release ndl_rod_release_f32
#define ndl_rod_turn ndl_rod_turn_f32
#define ndl_rod_release_turn ndl_rod_release_turn_f32
#define ndl_rod_hold_base ndl_rod_hold_base_f32
#define ndl_rod_set_force ndl_rod_set_force_f32
#define ndl_rod_set_torque ndl_rod_set_torque_f32
#define ndl_rod_set_gravity ndl_rod_set_gravity_f32
#define ndl_rod_set_damping ndl_rod_set_damping_f32
#define ndl_rod_step ndl_rod_step_f32
#define ndl_default_rod_static_options ndl_default_rod_static_options_f32
#define ndl_rod_solve_static ndl_rod_solve_static_f32
#define ndl_rod_set_positions ndl_rod_set_positions_f32
#define ndl_rod_set_velocities ndl_rod_set_velocities_f32
#define ndl_rod_split_edge ndl_rod_split_edge_f32
#define ndl_rod_merge_node ndl_rod_merge_node_f32
#define ndl_rod_feed ndl_rod_feed_f32
#define ndl_rod_node_count ndl_rod_node_count_f32
#define ndl_rod_positions ndl_rod_positions_f32
#define ndl_rod_velocities ndl_rod_velocities_f32
#define ndl_rod_mass ndl_rod_mass_f32
#define ndl_rod_rest_length ndl_rod_rest_length_f32
#define ndl_rod_frame ndl_rod_frame_f32
#define ndl_rod_tip ndl_rod_tip_f32
#define ndl_rod_curvature ndl_rod_curvature_f32
#define ndl_rod_twist ndl_rod_twist_f32
#define ndl_rod_energies ndl_rod_energies_f32
#define ndl_rod_forces ndl_rod_forces_f32
#define ndl_rod_reactions ndl_rod_reactions_f32
#define ndl_rod_reaction_torque ndl_rod_reaction_torque_f32
#define ndl_rod_base_wrench ndl_rod_base_wrench_f32
#define ndl_tissue_mesh_create ndl_tissue_mesh_create_f32
#define ndl_tissue_mesh_free ndl_tissue_mesh_free_f32
#define ndl_tissue_mesh_find ndl_tissue_mesh_find_f32
#define ndl_tissue_mesh_hit ndl_tissue_mesh_hit_f32
#define ndl_tissue_mesh_quality ndl_tissue_mesh_quality_f32
#define ndl_tissue_mesh_volume ndl_tissue_mesh_volume_f32
#define ndl_tissue_mesh_mass ndl_tissue_mesh_mass_f32
#define ndl_tissue_mesh_check ndl_tissue_mesh_check_f32
#define ndl_tissue_mesh_is_original ndl_tissue_mesh_is_original_f32
#define ndl_default_remesh_def ndl_default_remesh_def_f32
#define ndl_remesh_create ndl_remesh_create_f32
#define ndl_remesh_destroy ndl_remesh_destroy_f32
#define ndl_remesh_puncture ndl_remesh_puncture_f32
#define ndl_remesh_penetrate ndl_remesh_penetrate_f32
#define ndl_remesh_retract ndl_remesh_retract_f32
#define ndl_remesh_withdraw ndl_remesh_withdraw_f32
#define ndl_remesh_nodes ndl_remesh_nodes_f32
#define ndl_remesh_limit ndl_remesh_limit_f32
#define ndl_remesh_material_point ndl_remesh_material_point_f32
#define ndl_remesh_split_count ndl_remesh_split_count_f32
#endif
#endif

#endif /* NDLI_NAMES_H */
