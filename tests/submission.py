"""Which of the slow tests CI runs with every submission; the others are left to ``make nightly``.

With every submission: one test in a browser for each job that a person does, every page searched for faults once, and
the commands of README and tutorial. Nightly: Firefox, all other tests of pages, of documents and of the lab, those
marked ``slow`` (killed processes, long properties, whole experiments), and the tests of libraries on PostgreSQL.
"""

JOBS = {
    "studio/test_studio_axe.py": ("test_every_page_is_without_a_fault",),
    "studio/test_studio_estimate_page.py": ("test_from_silhouettes_to_a_search",),
    "studio/test_studio_evaluate_page.py": (
        "test_from_files_to_a_grade",
        "test_a_teacher_adds_notes_and_prints_what_a_pupil_needs",
    ),
    "studio/test_studio_export_page.py": ("test_hits_go_onto_the_character",),
    "studio/test_studio_journal_page.py": (
        "test_a_removal_and_a_label_are_undone_by_button_and_by_keys_also_after_a_reload",
    ),
    "studio/test_studio_library_page.py": (
        "test_an_empty_library_invites",
        "test_files_are_added_and_what_was_refused_is_listed_also_after_a_reload",
        "test_filters_and_words_narrow_the_list_and_stand_in_the_address",
        "test_relabelling_by_keyboard",
        "test_removal_asks_first",
    ),
    "studio/test_studio_live_page.py": ("test_the_camera_shows_the_skeleton_the_label_the_grade_and_how_quick_it_is",),
    "studio/test_studio_map.py": ("test_a_lasso_chooses_and_shift_adds_to_it",),
    "studio/test_studio_palette.py": ("test_pages_and_actions_are_found_by_parts_of_their_names",),
    "studio/test_studio_search_page.py": (
        "test_a_dropped_file_is_searched_for_and_plays_in_step",
        "test_a_hit_is_shown_beside_the_query_and_can_be_downloaded",
        "test_words_lead_to_motions",
    ),
    "studio/test_studio_serving.py": ("test_a_browser_comes_in_by_a_name_of_its_own_or_by_the_field",),
    "studio/test_studio_share_page.py": ("test_a_teacher_gets_the_code_takes_it_back_and_ends_it",),
    "studio/test_studio_takes.py": ("test_a_take_is_labelled_corrected_learned_and_taken_back",),
    "studio/test_studio_timeline.py": ("test_cuts_are_moved_added_and_taken_away",),
    "test_player.py": ("test_it_plays_and_pauses_and_seeks", "test_the_keyboard_does_it_all"),
    "test_player_miniatures.py": ("test_a_miniature_runs_and_only_while_it_is_visible",),
    "test_player_single.py": ("test_one_figure_plays_and_every_key_does_no_harm",),
    "test_report_browser.py": ("test_a_press_on_an_error_goes_there_and_loops",),
    "test_report_exercise.py": ("test_a_press_plays_a_repetition",),
}
"""Names of tests of pages, by their file below ``tests/app``."""

DOCUMENTS = (
    "test_every_command_has_a_rule",
    "test_every_program_of_the_lab_is_run",
    "test_pages_can_be_followed[README.md]",
    "test_the_answers_of_the_readme",
    "test_the_demo_and_the_tutorial",
)
"""Names of tests of documents."""
