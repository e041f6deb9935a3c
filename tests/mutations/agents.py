"""Bugs of learners and of the training loop."""

from tests.mutations.mutation import Mutation

OPTIONS = "agents/algorithms/options"


def _streams(bug: str, file: str, old: str, new: str, test: str) -> Mutation:
    """A bug of learners of options over many streams."""
    return Mutation(bug, f"agents/{file}.py", old, new, f"{OPTIONS}/test_option_streams.py::test_{test}")


MUTATIONS = [
    Mutation(
        "a full replay overwrites its last row only",
        "agents/components/replay.py",
        "row = self.added % self.capacity",
        "row = min(self.added, self.capacity - 1)",
        "agents/components/test_replay.py",
    ),
    Mutation(
        "the target network follows at every update",
        "agents/algorithms/dqn.py",
        "if learner.updates % settings.target_every == 0:",
        "if True:",
        "agents/algorithms/test_deep_losses.py",
    ),
    Mutation(
        "the averaged network never forgets the first weights",
        "agents/algorithms/dqn.py",
        "max(settings.average_rate, 1 / learner.updates)",
        "settings.average_rate",
        "agents/algorithms/test_deep_losses.py agents/components/test_learner.py",
    ),
    Mutation(
        "the greedy policy follows the network that learns",
        "agents/algorithms/dqn.py",
        "make_forward(self.online), make_forward(self.average)",
        "make_forward(self.online), make_forward(self.online)",
        "agents/algorithms/test_deep_losses.py agents/components/test_learner.py",
    ),
    Mutation(
        "an option is followed by as many updates as a primitive",
        "agents/components/replay.py",
        "self._due += steps * self._rate",
        "self._due += self._rate",
        "agents/algorithms/test_deep_losses.py agents/training/test_train.py",
    ),
    Mutation(
        "masked actions are no samples",
        "agents/factored/model.py",
        "if action not in self._done and key not in self._masked:",
        "if False:",
        "agents/algorithms/test_model_based.py::test_where_an_action_is_masked_is_learned_like_what_it_does",
    ),
    Mutation(
        "an action that worked and is masked for it counts as doing nothing",
        "agents/factored/model.py",
        "self._done = {action for action in masked if previous >= 0 and (action == previous or action in self._done)}",
        "self._done = set()",
        "agents/algorithms/test_model_based.py::test_an_action_masked_since_it_was_done_is_no_sample",
    ),
    Mutation(
        "hindsight takes goals from the past",
        "agents/components/hindsight.py",
        "self._rng.integers(start, len(self._episode), size=self._goals)",
        "self._rng.integers(0, len(self._episode), size=self._goals)",
        "agents/components/test_hindsight.py"
        "::test_an_episode_is_stored_as_asked_and_under_goals_it_achieved_later",
    ),
    Mutation(
        "hindsight stores the goal that was asked for",
        "agents/components/hindsight.py",
        "observation=self._encoder.replace_goal(first.observation, goal),",
        "observation=first.observation,",
        "agents/components/test_hindsight.py"
        "::test_an_episode_is_stored_as_asked_and_under_goals_it_achieved_later",
    ),
    Mutation(
        "hindsight keeps the reward of the goal that was asked for",
        "agents/components/hindsight.py",
        "decision.transition._replace(reward=reward, summed_reward=reward, terminated=terminated), self._settings)",
        "decision.transition._replace(terminated=terminated), self._settings)",
        "agents/components/test_hindsight.py"
        "::test_an_episode_is_stored_as_asked_and_under_goals_it_achieved_later",
    ),
    Mutation(
        "hindsight keeps the termination of the goal that was asked for",
        "agents/components/hindsight.py",
        "summed_reward=reward, terminated=terminated)",
        "summed_reward=reward)",
        "agents/components/test_hindsight.py"
        "::test_an_episode_is_stored_as_asked_and_under_goals_it_achieved_later",
    ),
    Mutation(
        "hindsight goes on where the episode ended for a reason of its own",
        "agents/components/hindsight.py",
        "if decision.transition.terminated and not terminated:",
        "if False:",
        "agents/components/test_hindsight.py"
        "::test_where_achieving_ends_nothing_backups_go_on_and_other_ends_stay",
    ),
    Mutation(
        "hindsight stores decisions under goals achieved already",
        "agents/components/hindsight.py",
        "if not self._judge(decision.before, goal, known).terminated:",
        "if True:",
        "agents/components/test_hindsight.py"
        "::test_no_decision_is_stored_under_a_goal_that_was_achieved_before_it",
    ),
    Mutation(
        "a backup in hindsight goes on past its goal",
        "agents/components/hindsight.py",
        "bootstrap *= own_bootstrap",
        "bootstrap *= self._settings.gamma",
        "agents/components/test_hindsight.py"
        "::test_an_episode_is_stored_as_asked_and_under_goals_it_achieved_later",
    ),
    Mutation(
        "boltzmann multiplies by its temperature",
        "agents/components/exploration.py",
        "scaled = legal_values / settings.temperature",
        "scaled = legal_values * settings.temperature",
        "agents/components/test_exploration.py",
    ),
    Mutation(
        "noise with memory grows with dt, not with its root",
        "agents/components/exploration.py",
        "self.sigma * np.sqrt(self.dt) * rng",
        "self.sigma * self.dt * rng",
        "agents/components/test_exploration.py",
    ),
    Mutation(
        "option/failures is always 0",
        "agents/training/run.py",
        'self._failures += option.get("ended") == "planning-failed"',
        "self._failures += 0",
        "agents/training/test_train.py",
    ),
    Mutation(
        "an evaluation episode without an end goes on for ever",
        "agents/training/evaluation.py",
        "while primitives < max_primitives:",
        "while True:",
        "agents/training/test_train.py::test_an_evaluation_episode_without_an_end_is_cut_in_primitives",
    ),
    Mutation(
        "progress of an episode is that at its end",
        "agents/training/evaluation.py",
        'self.progress = max(self.progress, float(info.get("progress", self.success)))',
        'self.progress = float(info.get("progress", self.success))',
        "agents/training/test_train.py::test_progress_of_an_episode_is_the_best_on_its_way",
    ),
    Mutation(
        "a budget of decisions ends no run",
        "agents/training/run.py",
        "or (most is not None and self.decisions >= most)",
        "or most == 0",
        "agents/training/test_train.py::test_a_budget_of_decisions_ends_a_run_whichever_is_spent_first",
    ),
    Mutation(
        "a metric is a mean over all decisions",
        "agents/training/run.py",
        "total / self._counts[name] for name",
        "total / self.decisions for name",
        "agents/training/test_train.py::test_a_logged_metric_is_the_mean_over_the_decisions_that_gave_it",
    ),
    Mutation(
        "generators of streams' options are left out of checkpoints",
        "agents/components/options/choices.py",
        '"_decisions", "_generator")',
        '"_decisions")',
        "agents/training/test_streams.py::test_a_run_cut_off_resumes_to_the_same_bits",
    ),
    _streams("the decision after an option's is that of the next stream", "components/policy_gradient",
             "after = rows[place + 1, stream]", "after = rows[place + 1, (stream + 1) % shape[1]]",
             "both_processes_are_taught_stream_by_stream_what_the_formulas_say"),
    _streams("a stream's option goes on into the next episode", "components/options/choices",
             "        self._option[stream[over]] = NONE\n", "",
             "no_outcome_shows_the_next_episode_and_no_option_goes_on_into_it"),
    _streams("options of streams end with the chance that they go on", "components/options/choices",
             "(draws < take_column(", "(draws > take_column(",
             "streams_draw_ends_and_options_with_the_chances_that_are_kept_with_them"),
    _streams("a stream's option has the chance of a first one", "components/options/choices",
             "mix_with_former(betas, choice, former), option", "choice, option",
             "streams_draw_ends_and_options_with_the_chances_that_are_kept_with_them"),
    _streams("runs of a stream's options count from the first", "components/options/choices",
             "        self._decisions[stream] = 0\n", "",
             "runs_of_options_are_counted_in_every_stream"),
    _streams("an action of a stream has the chance that it has by now", "components/options/networks",
             "if choices.log_probability is not None:", "if False:",
             "a_decision_that_outlasts_its_rollout_keeps_the_chances_that_it_was_made_with"),
    _streams("a choice of a stream has the chance that it has by now", "algorithms/options/dac",
             "log_choice = choices.log_probability\n", "log_choice = None\n",
             "the_choice_of_an_option_is_taught_with_the_chance_that_it_was_made_with"),
    _streams("a dropped episode goes on in the next", "components/options/rollouts",
             "over = rollout.over | self._open[0].find_last(rollout.stream, rollout.place)", "over = rollout.over",
             "episodes_that_are_dropped_count_as_truncated_and_options_do_not_go_on"),
    _streams("an option outlives a dropped episode", "components/options/choices",
             "        self._option.fill_(NONE)\n", "",
             "episodes_that_are_dropped_count_as_truncated_and_options_do_not_go_on"),
    _streams("minibatches of many streams stay small", "components/options/rollouts",
             "size = max(size, collected * size // self.settings.rollout)", "size = max(size, 0)",
             "a_rollout_of_many_streams_is_cut_into_as_many_minibatches_as_one_of_one"),
    _streams("a masked stream acts as if it were not", "components/options/rollouts",
             "self.heads.compute_log_policies(seen, option, mask)",
             "self.heads.compute_log_policies(seen, option, mask | True)",
             "both_processes_are_taught_stream_by_stream_what_the_formulas_say"),
    Mutation(
        "ppo in one environment goes by what was kept of streams",
        "agents/algorithms/ppo.py",
        "            self._open = None\n",
        "            pass\n",
        "agents/training/test_streams.py"
        "::test_ppo_that_learned_from_many_goes_on_in_one_environment_with_the_chances_of_its_own_choices",
    ),
    Mutation(
        "the state reached is valued as the decision itself",
        "agents/components/policy_gradient.py",
        "after = rows[place + 1, stream]",
        "after = rows[place, stream]",
        "agents/training/test_streams.py::test_the_next_value_of_a_rollout_is_the_critics_of_the_state_reached",
    ),
    Mutation(
        "what follows in a rollout is the next episode's",
        "agents/components/policy_gradient.py",
        "(after >= 0) & ~rollout.over",
        "after >= 0",
        "agents/training/test_streams.py::test_the_next_value_of_a_rollout_is_the_critics_of_the_state_reached",
    ),
    Mutation(
        "gradients of later blocks take the place of earlier ones",
        "agents/components/networks.py",
        "of_biases[layer].add_(error.sum(0))",
        "of_biases[layer].copy_(error.sum(0))",
        "agents/components/test_many_rows.py",
    ),
    Mutation(
        "rows of streams learn with the discount of one primitive",
        "agents/streams.py",
        "float(summed), int(k),\n                self.gamma ** int(k),",
        "float(summed), int(k),\n                self.gamma,",
        "agents/components/test_stream_replay.py"
        "::test_values_of_decisions_of_any_duration_are_exact_in_many_environments_at_once",
    ),
    Mutation(
        "a resumed run makes only the last action of its episodes again",
        "agents/training/stream_run.py",
        "for actions in np.asarray(state[\"made\"]):",
        "for actions in np.asarray(state[\"made\"])[-1:]:",
        "agents/training/test_streams.py::test_a_run_cut_off_resumes_to_the_same_bits",
    ),
    Mutation(
        "streams share the running calls of a hierarchy",
        "agents/streams.py",
        "        self._place(stream)\n",
        "",
        "agents/algorithms/given/test_many_rooms.py::test_tasks_are_worth_what_they_earn_in_streams_that_each_have_their_"
        "own_calls",
    ),
    Mutation(
        "tasks that share a learner share its streams",
        "agents/hierarchy/runner.py",
        "len(tasks) + tasks.index(task)",
        "len(tasks)",
        "agents/algorithms/given/test_many_rooms.py::test_tasks_that_share_a_learner_keep_their_open_decisions_apart",
    ),
    Mutation(
        "an option that a stream was cut in leads where it was cut",
        "agents/streams.py",
        "cut=bool(truncated and not terminated and k > 1)",
        "cut=False",
        "agents/algorithms/given/test_many_rooms.py::test_values_of_choices_are_exact",
    ),
    Mutation(
        "sarsa in many environments values the best action",
        "agents/algorithms/sarsa.py",
        "(weights * self.values.target(batch.next_observation)).sum(dim=1)",
        "self.values.target(batch.next_observation).max(dim=1).values",
        "agents/components/test_stream_replay.py"
        "::test_values_of_decisions_of_any_duration_are_exact_in_many_environments_at_once",
    ),
    Mutation(
        "a run that a callback ended counts as finished",
        "agents/training/run.py",
        "if folder is not None and not self._is_stopped:",
        "if folder is not None:",
        "agents/training/test_callbacks.py::test_a_run_that_a_callback_ended_goes_on_to_the_same_bits_without_it",
    ),
    Mutation(
        "the best checkpoint is the last of equals",
        "agents/training/run.py",
        "evaluation.mean_return > earlier.mean_return for",
        "evaluation.mean_return >= earlier.mean_return for",
        "agents/training/test_resuming.py::test_of_equally_good_evaluations_the_first_is_kept",
    ),
    Mutation(
        "a run's folder runs whatever code it names",
        "agents/training/env_description.py",
        "if known == name), None)",
        "if known == name), lambda: import_part(name))",
        "agents/training/test_hostile_runs.py",
    ),
    Mutation(
        "an archive's parts are not held against their hashes",
        "agents/training/archive.py",
        "if found != part:",
        "if False:",
        "agents/training/test_run_archive.py",
    ),
    Mutation(
        "an archive may hold files of any name",
        "agents/training/archive.py",
        "if not (name == MANIFEST or kind.names.fullmatch(name)) or mode not in (0, stat.S_IFREG):",
        "if False:",
        "agents/training/test_run_archive.py",
    ),
    Mutation(
        "options of exploration are valued too",
        "agents/algorithms/intra_option_q.py",
        'np.asarray(mask) != 0, ("exploration", "nothing"))',
        'np.asarray(mask) != 0, ("nothing",))',
        "options/test_four_rooms.py::test_credit_crosses_a_room_in_one_backup_and_exploration_alone_does_not",
    ),
    Mutation(
        "options of credit are chosen",
        "agents/algorithms/intra_option_q.py",
        'drawn = self._leave_out(action_mask, ("credit", "nothing"))',
        'drawn = self._leave_out(action_mask, ("nothing",))',
        "options/test_four_rooms.py::"
        "test_options_of_one_use_leave_primitives_worth_what_they_are_and_act_by_them",
    ),
    *(Mutation(bug, "agents/algorithms/options/fun.py", old, new, f"agents/algorithms/options/test_fun.py::test_{test}")
      for bug, old, new, test in (
        ("a direction reaches over the end of an episode", "total[lag:] += directions[:-lag] * same",
         "total[lag:] += directions[:-lag]", "directions_are_summed_and_paid_within_episodes"),
        ("the worker is paid over the end of an episode", "pay[lag:] += same * functional", "pay[lag:] += functional",
         "directions_are_summed_and_paid_within_episodes"),
        ("the manager moves its latent states to where it points", "(states[start + c : end + c] - states[start:end])"
         ".detach()", "(states[start + c : end + c] - states[start:end])",
         "the_manager_turns_its_directions_and_leaves_states_where_they_are"),
        ("the manager learns of decisions one late", "(states[start + c : end + c]",
         "(states[start + c - 1 : end + c - 1]", "the_loss_is_that_of_its_equations"))),
]
