/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef REGI_NAMES_H
#define REGI_NAMES_H

#if defined(SB_REAL)
#define REGI_NAMES_PASTE_(a, b) a##b
#define REGI_NAMES_PASTE(a, b) REGI_NAMES_PASTE_(a, b)
#define REGI_NAMES_OF_double 0
#define REGI_NAMES_OF_float 1
#if REGI_NAMES_PASTE(REGI_NAMES_OF_, SB_REAL)
#define reg_rigid_identity reg_rigid_identity_f32
#define reg_rigid_apply reg_rigid_apply_f32
#define reg_rigid_compose reg_rigid_compose_f32
#define reg_rigid_inverse reg_rigid_inverse_f32
#define reg_rigid_angle reg_rigid_angle_f32
#define reg_rigid_fit reg_rigid_fit_f32
#define reg_kdtree_create reg_kdtree_create_f32
#define reg_kdtree_destroy reg_kdtree_destroy_f32
#define reg_kdtree_count reg_kdtree_count_f32
#define reg_kdtree_nearest reg_kdtree_nearest_f32
#define reg_kdtree_k_nearest reg_kdtree_k_nearest_f32
#define reg_kdtree_within reg_kdtree_within_f32
#define reg_cloud_free reg_cloud_free_f32
#define reg_cloud_from_points reg_cloud_from_points_f32
#define reg_cloud_from_mesh reg_cloud_from_mesh_f32
#define reg_cloud_load reg_cloud_load_f32
#define reg_cloud_load_memory reg_cloud_load_memory_f32
#define reg_cloud_save_ply reg_cloud_save_ply_f32
#define reg_cloud_estimate_normals reg_cloud_estimate_normals_f32
#define reg_cloud_thin reg_cloud_thin_f32
#define reg_cloud_spread reg_cloud_spread_f32
#define reg_outlier_limit reg_outlier_limit_f32
#define reg_cloud_remove_outliers reg_cloud_remove_outliers_f32
#define reg_cloud_smooth reg_cloud_smooth_f32
#define reg_cloud_smooth_mesh reg_cloud_smooth_mesh_f32
#define reg_default_field_def reg_default_field_def_f32
#define reg_field_create reg_field_create_f32
#define reg_field_destroy reg_field_destroy_f32
#define reg_field_closest reg_field_closest_f32
#define reg_field_along reg_field_along_f32
#define reg_field_at reg_field_at_f32
#define reg_field_bounds reg_field_bounds_f32
#define reg_field_sweeps reg_field_sweeps_f32
#define reg_default_icp_options reg_default_icp_options_f32
#define reg_icp_stop_string reg_icp_stop_string_f32
#define reg_icp reg_icp_f32
#define reg_default_cpd_options reg_default_cpd_options_f32
#define reg_cpd_fit reg_cpd_fit_f32
#define reg_cpd_destroy reg_cpd_destroy_f32
#define reg_cpd_get_info reg_cpd_get_info_f32
#define reg_cpd_moved reg_cpd_moved_f32
#define reg_cpd_partners reg_cpd_partners_f32
#define reg_cpd_probabilities reg_cpd_probabilities_f32
#define reg_cpd_linear reg_cpd_linear_f32
#define reg_cpd_apply reg_cpd_apply_f32
#define reg_default_match_def reg_default_match_def_f32
#define reg_match_create reg_match_create_f32
#define reg_match_destroy reg_match_destroy_f32
#define reg_match_step reg_match_step_f32
#define reg_match_run reg_match_run_f32
#define reg_match_restart reg_match_restart_f32
#define reg_match_move_landmarks reg_match_move_landmarks_f32
#define reg_match_landmarks reg_match_landmarks_f32
#define reg_match_body reg_match_body_f32
#define reg_match_get_info reg_match_get_info_f32
#define reg_match_sample_count reg_match_sample_count_f32
#define reg_match_get_sample reg_match_get_sample_f32
#define reg_default_nicp_def reg_default_nicp_def_f32
#define reg_nicp_create reg_nicp_create_f32
#define reg_nicp_destroy reg_nicp_destroy_f32
#define reg_nicp_step reg_nicp_step_f32
#define reg_nicp_run reg_nicp_run_f32
#define reg_nicp_restart reg_nicp_restart_f32
#define reg_nicp_move_landmarks reg_nicp_move_landmarks_f32
#define reg_nicp_landmarks reg_nicp_landmarks_f32
#define reg_nicp_body reg_nicp_body_f32
#define reg_nicp_get_info reg_nicp_get_info_f32
#define reg_nicp_surface_count reg_nicp_surface_count_f32
#define reg_nicp_positions reg_nicp_positions_f32
#define reg_nicp_source_count reg_nicp_source_count_f32
#define reg_nicp_get_source reg_nicp_get_source_f32
#define reg_default_loads_def reg_default_loads_def_f32
#define reg_loads_run reg_loads_run_f32
#endif
#endif

#endif /* REGI_NAMES_H */
