"""Bugs of learners and of the training loop."""

from tests.mutations.mutation import Mutation

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
        "agents/components/action_value_agent.py",
        "if self._learner.updates % self.settings.target_every == 0:",
        "if True:",
        "agents/algorithms/test_deep_losses.py",
    ),
    Mutation(
        "the averaged network never forgets the first weights",
        "agents/components/action_value_agent.py",
        "max(self.settings.average_rate, 1 / self._learner.updates)",
        "self.settings.average_rate",
        "agents/algorithms/test_deep_losses.py agents/components/test_learner.py",
    ),
    Mutation(
        "the greedy policy follows the network that learns",
        "agents/components/action_value_agent.py",
        "self._exploit = make_forward(self.average)",
        "self._exploit = make_forward(self.online)",
        "agents/algorithms/test_deep_losses.py agents/components/test_learner.py",
    ),
    Mutation(
        "an option is followed by as many updates as a primitive",
        "agents/components/replay_agent.py",
        "self._updates_due += steps * self.settings.updates_per_step",
        "self._updates_due += self.settings.updates_per_step",
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
]
