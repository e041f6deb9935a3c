"""Bugs of data sets and of agents that learn from them."""

from tests.mutations.mutation import Mutation

_TABLES = "agents/algorithms/offline/test_offline_tables.py"

MUTATIONS = [
    Mutation(
        "a medium learner is stopped by how it explores, not by what is recorded of it",
        "data/record.py",
        '"epsilon_start": RANDOM_SHARE, "epsilon_end": RANDOM_SHARE',
        "",
        "data/test_record.py::test_medium_learns_as_it_is_recorded_exploring_a_tenth_of_the_time",
    ),
    Mutation(
        "a table discounts by one gamma a decision",
        "agents/components/offline.py",
        "(data.reward, data.discount) if by_primitive else (",
        "(data.summed_reward, np.full(len(data.action), settings.gamma)) if by_primitive else (",
        _TABLES,
    ),
    Mutation(
        "values follow after the task has ended",
        "agents/components/offline.py",
        "discounts = np.where(over, 0.0, discounts)",
        "discounts = np.where(over & False, 0.0, discounts)",
        _TABLES,
    ),
    Mutation(
        "the best trajectories are those that were cut",
        "agents/components/offline.py",
        "candidates = np.flatnonzero(ended) if ended.any()",
        "candidates = np.flatnonzero(~ended) if ended.any()",
        _TABLES,
    ),
    Mutation(
        "an expectile weighs what is below as what is above",
        "agents/algorithms/offline/iql.py",
        "share = (1.0 - tau) * below + tau * above",
        "share = tau * below + tau * above",
        _TABLES,
    ),
    Mutation(
        "CQL rewards what the policy wants too often",
        "agents/algorithms/offline/cql.py",
        "- np.where(shown, alpha *",
        "+ np.where(shown, alpha *",
        _TABLES,
    ),
    Mutation(
        "Q-iteration follows what the data never shows",
        "agents/algorithms/offline/fitted_q.py",
        "np.where(table.shown, q, -np.inf).max(axis=1)",
        "np.where(table.shown, q, 0.0).max(axis=1)",
        _TABLES,
    ),
    Mutation(
        "the discount of a decision is that of one primitive less",
        "data/materialise.py",
        "range(int(duration.max()) + 1)])",
        "range(-1, int(duration.max()))])",
        "data/test_materialise.py::test_a_run_of_options_and_its_replay_agree_to_the_bit",
    ),
    Mutation(
        "the reward of the last primitive comes first",
        "data/materialise.py",
        "back = duration[rows] - 1 - place",
        "back = place",
        "data/test_materialise.py",
    ),
    Mutation(
        "the state reached is that of the decision itself",
        "data/materialise.py",
        "powers[duration], observation[after + 1], mask",
        "powers[duration], observation[after], mask",
        "data/test_materialise.py",
    ),
    Mutation(
        "an episode may end elsewhere than it was recorded",
        "data/materialise.py",
        "if end != self.tape.end[episode.number] or",
        "if False or",
        "data/test_materialise.py",
    ),
    Mutation(
        "a tape of another engine is replayed",
        "data/tape.py",
        "        if about[name] != value:",
        "        if name not in about:",
        "data/test_tape.py",
    ),
    Mutation(
        "a tape's hash is not looked at",
        "data/tape.py",
        "            if tape.digest != digest:",
        "            if not digest:",
        "data/test_tape.py",
    ),
    Mutation(
        "OGBench's file has no row for a trajectory's last state",
        "data/export.py",
        "    observations = np.concatenate([part.observation, part.next_observation[-1:]])\n    rows",
        "    observations = np.concatenate([part.observation, part.observation[-1:]])\n    rows",
        "data/test_export.py",
    ),
]
