"""Traps of algorithms that learn their hierarchy, each sprung."""

ALGORITHMS = "agents/algorithms"


def _trap(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """Fields of a mutation: what is wrong, file and test by family and name, sound text, broken text."""
    family, name = file.split("/")
    return bug, f"{ALGORITHMS}/{family}/{name}.py", old, new, f"{ALGORITHMS}/{family}/test_{name}.py{test}"


def _discovery(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for what discoveries share."""
    folder = "algorithms/skills" if file in ("eigenoptions", "covering_options") else "discovery"
    return bug, f"agents/{folder}/{file}.py", old, new, f"agents/{test}"


def _meteorologists(bug: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for forecasters of structure."""
    return bug, "agents/factored/meteorologists.py", old, new, f"{ALGORITHMS}/structure/test_met_r_max.py::{test}"


def _hrc(bug: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for interventions."""
    return _trap(bug, "structure/hrc", old, new, f"::{test}")


OPTION_CRITIC = "options/option_critic"

MUTATIONS = [
    _trap("the best option is ended more and more often", OPTION_CRITIC,
          "there.endings[:] -= settings", "there.endings[:] += settings",
          "::test_termination_climbs_the_value_upon_arrival_at_the_state_reached_for_the_option_that_ran"),
    _trap("termination is learned in the state that was left", OPTION_CRITIC,
          "there.endings[:] -= settings", "here.endings[:] -= settings",
          "::test_termination_climbs_the_value_upon_arrival_at_the_state_reached_for_the_option_that_ran"),
    _trap("the advantage of going on is that of the state that was left", OPTION_CRITIC,
          "worse = there.values - self._compute_mean_value(there.values)",
          "worse = here.values - self._compute_mean_value(here.values)",
          "::test_termination_climbs_the_value_upon_arrival_at_the_state_reached_for_the_option_that_ran"),
    _trap("policy and termination are those of the option drawn next", OPTION_CRITIC,
          "        error = self._learn(transition)\n        self._decisions += 1\n"
          "        ended = self._go_on(transition)\n",
          "        self._decisions += 1\n        ended = self._go_on(transition)\n"
          "        error = self._learn(transition)\n",
          ""),
    _trap("the value of ending is the best option's", OPTION_CRITIC,
          "(1 - self.settings.epsilon) * values.max() + self.settings.epsilon * values.mean()", "values.max()",
          "::test_the_best_option_is_worth_more_than_the_mean_choice_so_that_its_termination_can_fall"),
    _trap("termination is learned where the task ended", OPTION_CRITIC,
          "if not transition.terminated:", "if True:",
          "::test_nothing_is_learned_of_termination_where_the_task_ended"),
    _trap("the deliberation cost is a reward for ending", OPTION_CRITIC,
          "margin = settings.deliberation_cost + settings.termination_margin",
          "margin = settings.termination_margin - settings.deliberation_cost",
          "::test_termination_climbs_the_value_upon_arrival_at_the_state_reached_for_the_option_that_ran"),
    _trap("the deliberation cost is paid nowhere", OPTION_CRITIC,
          "self._compute_mean_value(there.values) - settings.deliberation_cost",
          "self._compute_mean_value(there.values)",
          "::test_values_of_fixed_options_are_exact_for_decisions_of_any_duration"),
    _trap("the chance of going on is that of the state that was left", OPTION_CRITIC,
          "beta = self.compute_terminations(transition.next_observation)\n        arrived",
          "beta = self.compute_terminations(transition.observation)\n        arrived",
          "::test_values_of_fixed_options_are_exact_for_decisions_of_any_duration"),
    _trap("a decision of k primitives discounts by gamma", OPTION_CRITIC,
          "bootstrap * ((1 - beta)", "(bootstrap > 0) * settings.gamma * ((1 - beta)",
          "::test_values_of_fixed_options_are_exact_for_decisions_of_any_duration"),
    _trap("every option learns as if it had chosen the action", OPTION_CRITIC,
          "weights * policies[:, action] / policies[option, action], 1.0", "weights, 1.0",
          "::test_the_policy_of_every_option_moves_by_its_own_advantage"),
    _trap("the weight of an option forgets which one ran before", OPTION_CRITIC,
          "self._likely = beta * choice + (1 - beta) * self._eye[self._option]", "self._likely = choice",
          "::test_the_weight_of_an_option_is_the_chance_that_it_runs_given_the_one_before"),
    # eigenvectors and their signs; ends and beginnings of found options
    _discovery("an eigenvector has one option", "eigenoptions",
               "enumerate((1.0, -1.0))", "enumerate((1.0, 1.0))",
               "algorithms/skills/test_discovery.py"
               "::test_eigenoptions_of_a_graph_that_was_met_are_those_of_the_graph_that_is"),
    _discovery("the constant direction counts", "spectral",
               "values[1 : count + 1], _orient(vectors[:, 1 : count + 1])",
               "values[:count], _orient(vectors[:, :count])", "discovery/test_spectral.py"),
    _discovery("directions of the walk keep the root of the degree", "spectral",
               "        vectors = vectors / np.sqrt(adjacency.sum(axis=1))[:, None]\n", "        pass\n",
               "discovery/test_spectral.py"),
    _discovery("an eigenoption never ends", "found_option",
               "swept = np.maximum(choices.max(axis=1), 0.0)", "swept = choices.max(axis=1)",
               "discovery/test_spectral.py"),
    _discovery("an eigenoption is paid for where it is", "found_option",
               ".reshape(states, actions) - purpose[:, None], -np.inf)", ".reshape(states, actions), -np.inf)",
               "discovery/test_spectral.py"),
    _discovery("a covering option may begin anywhere", "found_option",
               "option.starts & (states == start)", "option.starts",
               "discovery/test_spectral.py"),
    _discovery("the same edge is found again and again", "covering_options",
               "joined[ends], joined[ends[::-1]] = 1.0, 1.0", "pass",
               "algorithms/skills/test_discovery.py::test_covering_options_join_the_corners_both_ways"),
    _discovery("an option that goes on is worth the best choice", "discovering_agent",
               "if goes_on else best)", "if False else best)",
               "algorithms/skills/test_discovery.py"
               "::test_a_chosen_option_is_worth_what_it_earns_on_its_way_and_the_best_choice_where_it_ends"),
    _discovery("a choice of an option that may not begin", "discovering_agent",
               "if skill is not None and state < len(skill.actions) and skill.starts[state]:",
               "if skill is not None and state < len(skill.actions):",
               "algorithms/skills/test_discovery.py"
               "::test_a_chosen_option_is_worth_what_it_earns_on_its_way_and_the_best_choice_where_it_ends"),
    # forecasts under noise
    _meteorologists("a forecast is judged by a sample that it has seen",
                    "        self._counts[self._rows, contexts, own, result] += 1\n\n    def find_alive",
                    "\n    def find_alive",
                    "test_two_forecasts_by_hand"),
    _meteorologists("the better of two is dropped", "errors[:, None] - errors", "errors - errors[:, None]",
                    "test_two_forecasts_by_hand"),
    _meteorologists("any difference is enough to drop one", "(self._worse - np.sqrt(2 * log * self._ranges))",
                    "self._worse", "test_two_forecasts_by_hand"),
    _meteorologists("an action is what it mostly does", "np.rint(1_000 * share * counts)",
                    "np.rint(1_000 * (1 - share) * counts)",
                    "test_an_action_that_fails_most_of_the_time_still_does_what_it_does"),
    _meteorologists("samples before the first effect are lost", "for sample in samples[:-1]:", "for sample in ():",
                    "test_samples_before_the_first_effect_count"),
    _meteorologists("the smallest set left predicts",
                    "alive[np.argsort(np.round(self._code[alive], 6), kind=\"stable\")]", "alive",
                    "test_two_forecasts_by_hand"),
    # interventions
    _hrc("a set that was off in a success may be the parents", "            common &= before\n", "            pass\n",
         "test_parents_are_the_smallest_set_on_in_successes_and_in_the_fewest_failures"),
    _hrc("failures say nothing", "count = sum(before & mask == mask for before in failed)", "count = 0",
         "test_parents_are_the_smallest_set_on_in_successes_and_in_the_fewest_failures"),
    _hrc("actions are tried whatever is on", "if all(before >> bit & 1 for bit in self.interventions):", "if True:",
         "test_an_action_counts_as_tried_only_where_all_that_was_chosen_is_on_and_anew_when_nothing_is_left"),
    _hrc("an action that failed is never tried again", "self._tried.clear()", "pass",
         "test_an_action_counts_as_tried_only_where_all_that_was_chosen_is_on_and_anew_when_nothing_is_left"),
    ("a subgoal of an AND needs any parent", "agents/discovery/interventions.py",
     'test = all if gate == "and" else any', "test = any",
     f"{ALGORITHMS}/structure/test_hrc.py::test_expected_costs_are_those_of_a_simulation"),
    ("others are chosen the more the later", "agents/discovery/interventions.py",
     "made / (made + 1)", "1 / (made + 1)",
     f"{ALGORITHMS}/structure/test_hrc.py::test_expected_costs_are_those_of_a_simulation"),
    # initiation connected to its target
    _discovery("an initiation set is never connected to its target", "found_option",
               "return TableSkill(name, chosen, on_the_way)", "return TableSkill(name, chosen, inside & ~targets)",
               "algorithms/skills/test_skill_chaining.py"
               "::test_states_without_a_known_way_inside_the_set_are_left_out"),
    _discovery("the way to a target may leave the set", "found_option",
               "np.where(inside, choices.max(axis=1), 0.0))", "choices.max(axis=1))",
               "algorithms/skills/test_skill_chaining.py"
               "::test_states_without_a_known_way_inside_the_set_are_left_out"),
    _trap("the next target is the first one again", "skills/skill_chaining",
          "self.targets.setdefault(state, level + 1)", "self.targets.setdefault(state, 0)", ""),
    _trap("one arrival is enough", "skills/skill_chaining",
          "self._arrivals < self._settings.gestation or", "self._arrivals < 1 or",
          "::test_gestation_and_reach_are_counted_in_arrivals_and_decisions"),
    _trap("the chain grows past the start", "skills/skill_chaining",
          "level >= self.slots or self._begins_inside", "level >= self.slots",
          "::test_a_complete_chain_grows_no_further"),
]
