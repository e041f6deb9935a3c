"""Bugs of data sets and of agents that learn from them."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation("a table discounts by one gamma a decision", "agents/components/offline.py::OfflineAgent.begin",
             "(data.reward, data.discount) if by_primitive else (",
             "(data.summed_reward, np.full(len(data.action), settings.gamma)) if by_primitive else (",
             "agents/algorithms/offline/test_offline_tables.py"),
    Mutation("values follow after the task has ended", "agents/components/offline.py::OfflineAgent.begin",
             "discounts = np.where(over, 0.0, discounts)", "discounts = np.where(over & False, 0.0, discounts)",
             "agents/algorithms/offline/test_offline_tables.py"),
    Mutation("an expectile weighs what is below as what is above",
             "agents/algorithms/offline/iql.py::compute_expectile",
             "share = (1.0 - tau) * below + tau * above", "share = tau * below + tau * above",
             "agents/algorithms/offline/test_offline_tables.py"),
    Mutation("Q-iteration follows what the data never shows", "agents/algorithms/offline/fitted_q.py::FittedQ.improve",
             "np.where(table.shown, q, -np.inf).max(axis=1)", "np.where(table.shown, q, 0.0).max(axis=1)",
             "agents/algorithms/offline/test_offline_tables.py"),
    Mutation("the discount of a decision is that of one primitive less", "data/materialise.py::DataSet._make_decisions",
             "range(int(duration.max()) + 1)])", "range(-1, int(duration.max()))])",
             "data/test_materialise.py::test_a_run_of_options_and_its_replay_agree_to_the_bit"),
    Mutation("the reward of the last primitive comes first", "data/materialise.py::discount_rewards",
             "back = duration[rows] - 1 - place", "back = place",
             "data/test_materialise.py"),
    Mutation("the state reached is that of the decision itself", "data/materialise.py::DataSet._make_decisions",
             "powers[duration], observation[after + 1],", "powers[duration], observation[after],",
             "data/test_materialise.py"),
    Mutation("an episode may end elsewhere than it was recorded", "data/materialise.py::DataSet._replay",
             "if end != self.recording.end[episode.number] or", "if False or",
             "data/test_materialise.py"),
    Mutation("a recording of another engine is replayed", "data/recording.py::_check_version",
             "        if about[name] != value:", "        if name not in about:",
             "data/test_recording.py"),
    Mutation("a recording's hash is not looked at", "data/recording.py::load_recording",
             "            if recording.digest != digest:", "            if not digest:",
             "data/test_recording.py"),
    Mutation("OGBench's file has no row for a trajectory's last state", "data/export.py::_make_rows",
             "    observations = np.concatenate([part.observation, part.next_observation[-1:]])\n"
             "    rows",
             "    observations = np.concatenate([part.observation, part.observation[-1:]])\n"
             "    rows",
             "data/test_export.py"),
]
