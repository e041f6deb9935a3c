"""Bugs of the tools: what calls cost, what is said, and what a recording is held against."""

from tests.mutations.mutation import Mutation

SESSION, PLAY = "text/test_session.py", "text/test_same_play.py"

MUTATIONS = [
    Mutation("looking is free however often", "text/text_env.py", 'if self._looks >= MOST_LOOKS else ""',
             'if False else ""', f"{SESSION}::test_looking_is_free_ten_times_between_two_moves"),
    Mutation("an option that cannot start is no wrong call", "text/text_env.py", "if not self._mask[self.action]:",
             "if False:", f"{SESSION}::test_an_option_that_cannot_start_costs_what_a_masked_one_does"),
    Mutation("rewards of a move are not discounted", "text/text_env.py", "reward + discount * part.reward",
             "reward + part.reward", f"{SESSION}::test_a_move_repeats_and_stops_when_something_changes"),
    Mutation("a wrong call is not counted", "text/text_env.py", "self._invalid += bool(self._wrong)",
             "self._invalid += 0", f"{SESSION}::test_a_wrong_call_costs_one_primitive_and_says_what_would_be_valid"),
    Mutation("names from files are said as they are", "text/words.py", '"[^A-Za-z0-9 .,:;+#@()/_-]"', '"[%]"',
             f"{SESSION}::test_names_from_files_are_quoted_and_are_neither_markup_nor_instructions"),
    Mutation("places are told with the names", "text/text_env.py", 'self.state, self.reveal != "names"',
             "self.state, True", f"{SESSION}::test_levels_tell_more_and_more"),
    Mutation("the goal is listed first", "text/words.py", "for index, target in enumerate(instance.targets):",
             "for index, target in sorted(enumerate(instance.targets), key=lambda t: t[0] != puzzle.goal):",
             "text/test_leaks.py::test_what_is_said_holds_no_information_on_the_order"),
    Mutation("a recording that differs is taken", "text/recordings.py", "if said != heard:", "if False:",
             "text/test_recordings.py::test_a_changed_game_is_found"),
    Mutation("a recorded model answers without a look at the room", "text/recordings.py",
             "if turns[:done] == said and len(turns) > done:", "if len(turns) > done:",
             "text/test_recordings.py::test_a_recorded_model_plays_the_game_again_and_no_other"),
    Mutation("a manager forgets to begin again once all is tried", "text/managers.py", "if not set(able) - tried:",
             "if False:", "text/test_managers.py"),
]
