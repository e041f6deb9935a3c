"""Traps of algorithms that learn their hierarchy, each sprung."""

ALGORITHMS = "agents/algorithms"


def _trap(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """Fields of a mutation: what is wrong, file and test by family and name, sound text, broken text."""
    family, name = file.split("/")
    return bug, f"{ALGORITHMS}/{family}/{name}.py", old, new, f"{ALGORITHMS}/{family}/test_{name}.py{test}"


def _discovery(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for what discoveries share."""
    folder = "" if file == "discovery" else "algorithms/skills/"
    return bug, f"agents/{folder}{file}.py", old, new, f"agents/{test}"


def _meteorologists(bug: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for forecasters of structure."""
    file = "algorithms/structure/met_r_max.py"
    return bug, f"agents/{file}", old, new, f"{ALGORITHMS}/structure/test_met_r_max.py::{test}"


def _growth(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for sets of parents that grow."""
    return bug, f"agents/{file}.py", old, new, f"{ALGORITHMS}/structure/test_vigorito_barto.py::{test}"


def _hrc(bug: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for interventions."""
    return _trap(bug, "structure/hrc", old, new, f"::{test}")


def _networks(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for options over networks."""
    folder = f"{ALGORITHMS}/options" if file in ("dac", "ppoc", "a2oc") else "agents/components"
    return bug, f"{folder}/{file}.py", old, new, f"{ALGORITHMS}/options/test_option_networks.py::{test}"


def _ppoc(bug: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for what PPOC has of its own."""
    return _trap(bug, "options/ppoc", old, new, f"::{test}")


def _diayn(bug: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """The same for skills that are told apart."""
    return _trap(bug, "skills/diayn", old, new, f"::{test}")


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
    # options over networks
    _networks("the option before an episode's first is option 0", "option_networks",
              ".masked_fill((former == NONE)[:, None], 1.0)", "",
              "test_the_option_before_is_kept_unless_it_ends_and_a_first_one_is_drawn_from_the_policy_over_options"),
    _networks("terminations learn nothing of the choice", "option_networks",
              "kept + ends * (choice - kept)", "kept + ends.detach() * (choice - kept)",
              "test_terminations_learn_through_the_choice_of_options_and_the_value_s_error_moves_the_critic_alone"),
    ("the state reached at a time-out is worth the next episode's option",
     "agents/components/policy_gradient.py", "(after >= 0) & ~rollout.over", "after >= 0",
     f"{ALGORITHMS}/options/test_option_networks.py"
     "::test_the_state_reached_is_worth_the_option_that_ran_next_and_the_mean_where_none_did"),
    _networks("illegal actions have a share", "option_networks",
              "option], mask)", "option], torch.ones_like(mask))", "test_with_one_option_it_is_ppo_to_the_bit"),
    _networks("an option that is chosen again counts as going on", "option_networks",
              "self._is_chosen = self._option, True", "self._is_chosen = self._option, False",
              "test_rows_tell_which_option_ran_before_and_whether_one_was_chosen"),
    _networks("the value's error moves the choice of options", "dac",
              "choice.detach(), ", "choice, ",
              "test_terminations_learn_through_the_choice_of_options_and_the_value_s_error_moves_the_critic_alone"),
    _networks("the high process has the values of the low one", "dac",
              "compute_advantages(rollout, high_values, high_next, settings)",
              "compute_advantages(rollout, low_values, low_next, settings)",
              "test_both_processes_have_advantages_of_their_own_and_the_probabilities_of_the_networks_that_chose"),
    _networks("a choice among one is learned", "dac",
              "if self.options > 1:", "if self.options > 0:", "test_with_one_option_it_is_ppo_to_the_bit"),
    _networks("the high process has the probabilities of the policy over options", "dac",
              "choice = self.heads.compute_option_choice(rollout.observation, former)",
              "choice = self.heads.compute_fresh_choice(rollout.observation)",
              "test_both_processes_have_advantages_of_their_own_and_the_probabilities_of_the_networks_that_chose"),
    _networks("long options are dear", "dac",
              "+ settings.deliberation_cost * ending", "- settings.deliberation_cost * ending",
              "test_dacs_losses_equal_the_formulas_by_hand"),
    _ppoc("termination over networks is learned in the state that was left",
          "choices.is_chosen, rollout.next_observation,", "choices.is_chosen, rollout.observation,",
          "test_terminations_step_with_every_minibatch_of_the_option_s_own_decisions"),
    _networks("the best option over networks is ended more and more often", "option_networks",
              "* (worse + margin) * goes_on", "* -(worse + margin) * goes_on",
              "test_ppocs_terminations_fall_where_the_option_that_ran_is_better_than_the_mean_at_the_state_reached"),
    _ppoc("termination over networks is learned where the task ended",
          "                             rollout.bootstrap > 0)", "                             rollout.bootstrap >= 0)",
          "test_terminations_step_with_every_minibatch_of_the_option_s_own_decisions"),
    _ppoc("terminations hardly move", "termination_rate: Annotated[float, Range(0)] = 2e-4",
          "termination_rate: Annotated[float, Range(0)] = 5e-7",
          "test_the_rate_of_terminations_is_what_the_published_program_comes_to"),
    _networks("the deliberation cost over networks is a reward for ending", "option_networks",
              "next_values - cost * ends", "next_values + cost * ends",
              "test_ppoc_pays_for_ending_upon_arrival_and_learns_choices_where_they_were_made"),
    _networks("a choice is learned where none was made", "ppoc",
              "(target - mean) * choices.is_chosen,", "target - mean,",
              "test_ppoc_pays_for_ending_upon_arrival_and_learns_choices_where_they_were_made"),
    _networks("an option learns from a few samples", "ppoc",
              ">= settings.least_samples", ">= 2", "test_an_option_waits_for_its_samples_and_then_learns_from_its_own"),
    _networks("the value of ending is the best option's", "a2oc",
              "(1 - self.settings.epsilon) * best + self.settings.epsilon / self.options", "1.0 * best",
              "test_a2ocs_loss_equals_the_formula_by_hand"),
    _networks("the margin of terminations is the wrong way round", "a2oc",
              "margin = settings.deliberation_cost + settings.termination_margin",
              "margin = settings.deliberation_cost - settings.termination_margin",
              "test_a2ocs_loss_equals_the_formula_by_hand"),
    _networks("policies descend what they should climb", "a2oc",
              "policy_loss = -(take_column(", "policy_loss = (take_column(",
              "test_a2ocs_loss_equals_the_formula_by_hand"),
    _networks("the value upon arrival forgets that the option may end", "option_networks",
              "take_column(values, choices.option[after]), mean), mean",
              "take_column(values, choices.option[after]), take_column(values, choices.option)), mean",
              "test_the_state_reached_is_worth_the_option_that_ran_next_and_the_mean_where_none_did"),
    _networks("options over networks are driven to certainty", "a2oc",
              "- settings.entropy_weight * entropy", "+ settings.entropy_weight * entropy",
              "test_a2ocs_loss_equals_the_formula_by_hand"),
    _networks("the choice of options is driven to certainty", "dac",
              "- settings.option_entropy_weight * entropy", "+ settings.option_entropy_weight * entropy",
              "test_dacs_losses_equal_the_formulas_by_hand"),
    _networks("a time-out ends the high process", "dac",
              "compute_advantages(rollout, high_values, high_next, settings)",
              "compute_advantages(rollout, high_values, high_next * ~rollout.over, settings)",
              "test_both_processes_have_advantages_of_their_own_and_the_probabilities_of_the_networks_that_chose"),
    _networks("terminations learn as fast as all else", "ppoc",
              "self.settings.termination_rate or 1.0)", "self.settings.learning_rate)",
              "test_ppocs_terminations_move_at_their_own_rate"),
    _diayn("skills are told apart by the pose", "return observation * seen", "return observation",
           "test_the_pose_says_nothing_to_the_discriminator_and_bits_do"),
    _diayn("a skill is paid for where it was", "self.compute_rewards(rollout.next_observation, option)",
           "self.compute_rewards(rollout.observation, option)",
           "test_the_reward_is_the_forecast_at_the_state_reached_against_an_even_guess"),
    _diayn("staying alive costs where skills are alike", " + math.log(self.options)", "",
           "test_the_reward_is_the_forecast_at_the_state_reached_against_an_even_guess"),
    _diayn("the task's reward is learned from", "rollout._replace(reward=rewards)", "rollout",
           "test_the_reward_is_the_forecast_at_the_state_reached_against_an_even_guess"),
    _diayn("a skill ends within its episode", "return np.zeros(self.options)\n\n    def compute_betas",
           "return np.ones(self.options)\n\n    def compute_betas",
           "test_a_skill_is_drawn_evenly_and_lasts_its_episode"),
    _diayn("the last skill acts in evaluation", "return int(means.argmax())", "return self.options - 1",
           "test_skills_come_to_different_bits_wherever_they_are_and_the_best_one_acts"),
    # eigenvectors and their signs; ends and beginnings of found options
    _discovery("an eigenvector has one option", "eigenoptions",
               "enumerate((1.0, -1.0))", "enumerate((1.0, 1.0))",
               "algorithms/skills/test_discovery.py"
               "::test_eigenoptions_of_a_graph_that_was_met_are_those_of_the_graph_that_is"),
    _discovery("the constant direction counts", "discovery",
               "values[1 : count + 1], _orient(vectors[:, 1 : count + 1])",
               "values[:count], _orient(vectors[:, :count])", "discovery/test_spectral.py"),
    _discovery("directions of the walk keep the root of the degree", "discovery",
               "        vectors = vectors / np.sqrt(adjacency.sum(axis=1))[:, None]\n", "        pass\n",
               "discovery/test_spectral.py"),
    _discovery("an eigenoption never ends", "discovery",
               "lambda best: np.maximum(best, 0.0)", "lambda best: best",
               "discovery/test_spectral.py"),
    _discovery("an eigenoption is paid for where it is", "discovery",
               ".reshape(model.known.shape) - purpose[:, None], -np.inf)", ".reshape(model.known.shape), -np.inf)",
               "discovery/test_spectral.py"),
    _discovery("a covering option may begin anywhere", "discovery",
               "option.starts & (states == start)", "option.starts",
               "discovery/test_spectral.py"),
    _discovery("the same edge is found again and again", "covering_options",
               "joined[ends], joined[ends[::-1]] = 1.0, 1.0", "pass",
               "algorithms/skills/test_discovery.py::test_covering_options_join_the_corners_both_ways"),
    _discovery("an action leads one way in the graph", "discovery",
               "np.stack([after, before])], axis=1)", "np.stack([before, after])], axis=1)",
               "discovery/test_state_graph.py::test_an_action_joins_states_both_ways_and_one_that_stays_joins_none"),
    _discovery("states that nothing connects have directions", "discovery",
               "np.flatnonzero(parts == np.bincount(parts).argmax())", "np.arange(len(self))",
               "discovery/test_state_graph.py::test_directions_are_those_of_the_largest_connected_part"),
    _discovery("options of exploration are in the greedy policy", "discovery",
               "if not self._chooses:", "if False:",
               "algorithms/skills/test_discovery.py"
               "::test_exploration_runs_an_option_to_its_end_and_the_policy_is_over_primitives"),
    _discovery("an option that goes on is worth the best choice", "discovery",
               "if goes_on else best)", "if False else best)",
               "algorithms/skills/test_discovery.py"
               "::test_a_chosen_option_is_worth_what_it_earns_on_its_way_and_the_best_choice_where_it_ends"),
    _discovery("a choice of an option that may not begin", "discovery",
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
    # sets of parents that grow, and options of bits
    _growth("parents cost nothing", "factored/structure",
            "return likelihood - parameters / 2 * np.log(max(self.count_samples(action), 1))", "return likelihood",
            "test_a_parent_is_taken_in_where_the_history_is_worth_its_parameters_and_dropped_again"),
    _growth("a parent is never dropped", "factored/structure",
            "near = np.r_[smaller[believed], believed, larger[believed]]",
            "near = np.r_[believed, larger[believed]]", "test_a_parent_that_others_explain_away_is_dropped"),
    _growth("sets that explain much less are tried for ever", "factored/structure",
            "return tried[likelihoods >= likelihoods[0] - STRONG]", "return tried",
            "test_a_set_that_explains_much_less_is_tried_no_further"),
    _growth("nothing beside the present set is tried", "factored/structure",
            "return tried[likelihoods >= likelihoods[0] - STRONG]", "return tried[:1]",
            "test_a_set_that_explains_much_less_is_tried_no_further"),
    # decision trees, and the experiments that they ask for
    _growth("a split costs nothing", "factored/trees",
            "rise[best] - parameters / 2 * np.log(samples) > evidence", "rise[best] > evidence",
            "test_a_leaf_is_split_by_the_bit_that_says_most_once_that_is_worth_its_parameter"),
    _growth("what is random anyway counts as information", "factored/trees",
            "return (share * (digamma(weights + 1) - digamma(total + 1)) - xlogy(share, share)).sum(axis=-1)",
            "return -xlogy(share, share).sum(axis=-1)",
            "test_the_information_of_a_sample_is_that_of_its_outcome_about_the_distribution"),
    _growth("a leaf tells nothing of the values in it", "factored/trees",
            "on, off = gains[leaf, :self._factors], gains[leaf, self._factors:]",
            "on = off = gains[leaf, :self._factors]",
            "test_the_gain_of_an_action_is_what_its_leaves_expect_of_the_rarest_value"),
    _growth("trees do not grow", "factored/trees",
            "factor = outcome if is_root else find_split(on[rows], results[rows], len(on), self._evidence)",
            "factor = outcome if is_root else None", "test_trees_split_leaf_by_leaf_and_only_where_it_matters"),
    _growth("the experiment is made here, whatever options lead to", "algorithms/structure/vigorito_barto",
            "ends = [self._follow(bit, way, action_mask, durations, places) for bit in skills]", "ends = []",
            "test_an_experiment_is_no_worse_than_any_that_an_option_leads_to_and_is_on_its_way"),
    _growth("a far experiment is worth as much as a near one", "algorithms/structure/vigorito_barto",
            "* self.gamma ** (way.elapsed + durations[way.place])", "* 1.0",
            "test_an_experiment_is_no_worse_than_any_that_an_option_leads_to_and_is_on_its_way"),
    _growth("experiments are made for ever", "algorithms/structure/vigorito_barto",
            "return plan if best >= self.settings.least_gain else", "return plan if best >= 0 else",
            "test_it_finds_the_edges_that_matter_and_escapes"),
    _growth("an option begins without what it needs", "algorithms/structure/vigorito_barto",
            "            if bit not in skills:\n                return None\n",
            "            if bit not in skills:\n                return 0\n",
            "test_an_option_cannot_start_where_no_way_to_what_it_needs_is_known"),
    _growth("an option does not care for its parents", "algorithms/structure/vigorito_barto",
            "if not missing:", "if True:", "test_an_option_turns_its_bit_on_and_what_that_needs_before"),
    _growth("an option begins where its bit is on", "algorithms/structure/vigorito_barto",
            "        if state & bit:\n", "        if False:\n",
            "test_an_option_turns_its_bit_on_and_what_that_needs_before"),
    # interventions
    _hrc("a set that was off in a success may be the parents", "            common &= before\n", "            pass\n",
         "test_parents_are_the_smallest_set_on_in_successes_and_in_the_fewest_failures"),
    _hrc("failures say nothing", "count = sum(before & mask == mask for before in failed)", "count = 0",
         "test_parents_are_the_smallest_set_on_in_successes_and_in_the_fewest_failures"),
    _hrc("actions are tried whatever is on", "if all(before >> bit & 1 for bit in self.interventions):", "if True:",
         "test_an_action_counts_as_tried_only_where_all_that_was_chosen_is_on_and_anew_when_nothing_is_left"),
    _hrc("an action that failed is never tried again", "self._tried.clear()", "pass",
         "test_an_action_counts_as_tried_only_where_all_that_was_chosen_is_on_and_anew_when_nothing_is_left"),
    ("others are chosen the more the later", "agents/algorithms/structure/hrc.py",
     "made / (made + 1)", "1 / (made + 1)",
     f"{ALGORITHMS}/structure/test_hrc.py::test_expected_costs_are_those_of_a_simulation"),
    # initiation connected to its target
    _discovery("an initiation set is never connected to its target", "discovery",
               "return TableSkill(name, chosen, on_the_way)", "return TableSkill(name, chosen, inside & ~targets)",
               "algorithms/skills/test_skill_chaining.py"
               "::test_states_without_a_known_way_inside_the_set_are_left_out"),
    _discovery("the way to a target may leave the set", "discovery",
               "np.where(inside, best, 0.0))", "best)",
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
