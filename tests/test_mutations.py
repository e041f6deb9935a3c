"""Shows that the tests of the SMDP traps can fail: each trap is sprung in a copy of the code, and its test sees it.

Every entry names the line that a test guards. Slow, but for the check that both exist: each breaks the code in a folder
of its own and runs pytest there.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.mutations import given

ROOT = Path(__file__).parents[1]


class Mutation(NamedTuple):
    trap: str
    file: str
    line: str
    broken: str
    test: str


MUTATIONS = [
    Mutation(
        "1 summed reward with gamma^k",
        "agents/agent.py",
        "discounted = float(primitive_reward) + gamma * discounted",
        "discounted = float(primitive_reward) + discounted",
        "agents/algorithms/test_tabular.py::test_trap_1_an_option_learned_from_its_primitive_rewards_is_worth_their_discounted_sum",
    ),
    Mutation(
        "2 bootstrapping with gamma^1",
        "agents/agent.py",
        "gamma**duration,",
        "gamma,",
        "agents/algorithms/test_tabular.py::test_trap_2_cutting_an_option_into_parts_does_not_change_values",
    ),
    Mutation(
        "3 truncation as termination, in the backup",
        "agents/agent.py",
        "transition.terminated or (transition.truncated and not settings.bootstrap_on_truncation)",
        "transition.terminated or transition.truncated",
        "agents/algorithms/test_tabular.py::test_trap_3_a_cap_inside_an_option_bootstraps_from_where_it_was_cut",
    ),
    Mutation(
        "3 truncation as termination, in deep sarsa",
        "agents/agent.py",
        "transition.terminated or (transition.truncated and not settings.bootstrap_on_truncation)",
        "transition.terminated or transition.truncated",
        "agents/algorithms/test_sarsa.py::test_trap_3_a_cut_episode_still_has_a_future",
    ),
    Mutation(
        "4 the exit's bonus loses its discount",
        "agents/agent.py",
        "return discounted, float(sum(rewards))",
        "return discounted - gamma ** (duration - 1) * rewards[-1] + rewards[-1], float(sum(rewards))",
        "agents/test_transition.py::test_trap_4_an_exit_inside_an_option_keeps_its_bonus_at_gamma_to_the_k_minus_1",
    ),
    Mutation(
        "6 budget in decisions",
        "agents/training/run.py",
        "self.primitives += transition.duration",
        "self.primitives += 1",
        "agents/training/test_train.py::test_trap_6_the_budget_and_every_curve_are_in_primitives_not_decisions",
    ),
    Mutation(
        "6 planner calls not counted",
        "agents/training/run.py",
        'self.planner_calls += option.get("planner_calls", 0)',
        "self.planner_calls += 0",
        "agents/training/test_train.py::test_trap_6_planner_calls_are_counted",
    ),
    Mutation(
        "7 discounts shuffled on the way out of a checkpoint",
        "agents/components/replay.py",
        "field[: len(self)] = stored",
        "field[: len(self)] = stored if name != 'bootstrap' else stored[::-1]",
        "agents/components/test_replay.py::test_trap_7_what_is_sampled_is_what_was_stored_also_after_a_checkpoint",
    ),
    Mutation(
        "8 n-step multiplies one gamma only",
        "agents/components/replay.py",
        "bootstrap=first.bootstrap * then.bootstrap,",
        "bootstrap=then.bootstrap,",
        "agents/components/test_replay.py::test_trap_8_n_step_returns_multiply_each_gamma_k_and_stop_at_ends",
    ),
    Mutation(
        "8 n-step runs over an episode's end",
        "agents/components/replay.py",
        "if episode_over:",
        "if False:",
        "agents/components/test_replay.py::test_trap_8_n_step_returns_multiply_each_gamma_k_and_stop_at_ends",
    ),
    Mutation(
        "9 an illegal action wins the maximum, deep",
        "agents/algorithms/dqn.py",
        "best = next_choice.masked_fill(~batch.next_mask, -torch.inf).argmax",
        "best = next_choice.argmax",
        "agents/algorithms/test_deep_losses.py::test_trap_9_an_illegal_action_of_value_a_million_leaves_every_target_alone",
    ),
    Mutation(
        "9 an illegal action wins the maximum, tabular",
        "agents/components/tabular_agent.py",
        "float(next_values[transition.next_action_mask].max())",
        "float(next_values.max())",
        "agents/algorithms/test_tabular.py::test_trap_9_an_illegal_action_of_high_value_does_not_win_the_maximum",
    ),
    Mutation(
        "10 a mask without a legal action is let through",
        "agents/agent.py",
        "if not legal.any():",
        "if False:",
        "agents/test_transition.py::test_trap_10_a_mask_without_a_legal_action_is_refused",
    ),
    Mutation(
        "11 exploration ignores the mask",
        "agents/components/exploration.py",
        "legal = mask.nonzero()[0]",
        "legal = np.arange(len(mask))",
        "agents/components/test_exploration.py::test_trap_11_exploration_never_draws_an_illegal_action",
    ),
    Mutation(
        "11 ddpg's argmax ignores the mask",
        "agents/components/exploration.py",
        "return int(np.where(mask, values, -np.inf).argmax())",
        "return int(values.argmax())",
        "agents/test_registry.py::test_trap_11_no_agent_ever_takes_an_illegal_action[ddpg]",
    ),
    Mutation(
        "12 beta weighed at the state left",
        "agents/algorithms/intra_option_q.py",
        "next_values = self.compute_values(next_observation)\n        ended",
        "next_values = self.compute_values(observation)\n        ended",
        "agents/algorithms/test_tabular.py::test_trap_12_termination_is_weighed_at_the_state_reached",
    ),
    Mutation(
        "14 a free self-loop",
        "agents/agent.py",
        "    if duration < 1:",
        "    if duration < 0:",
        "agents/test_transition.py::test_trap_14_an_action_that_costs_no_primitive_is_refused",
    ),
    Mutation(
        "15 intra-option updates for any option",
        "agents/algorithms/intra_option_q.py",
        'return getattr(item, "consistent", ())',
        'return (*getattr(item, "consistent", ()), (1, 0.0))',
        "agents/algorithms/test_tabular.py::test_trap_15_an_option_that_is_no_function_of_the_state_is_learned_as_a_whole_only",
    ),
    Mutation(
        "16 lambda per primitive whatever is set",
        "agents/algorithms/ppo.py",
        'powers = rollout.duration if settings.lambda_per == "primitive" else np.ones(len(delta))',
        "powers = rollout.duration",
        "agents/algorithms/test_deep_losses.py::test_trap_16_advantages_equal_the_sum_of_discounted_errors_with_lambda_as_named",
    ),
    Mutation(
        "17 evaluation draws from the agent's own generator",
        "agents/algorithms/random.py",
        "return sample_legal(action_mask, rng)",
        "return sample_legal(action_mask, self._rng)",
        "agents/training/test_train.py::test_trap_17_evaluating_twice_gives_the_same_bits_and_changes_nothing[random]",
    ),
    Mutation(
        "17 evaluation episodes follow the training seed",
        "agents/training/run.py",
        "self.arguments.eval_seed,\n            primitives",
        "self.arguments.seed,\n            primitives",
        "agents/training/test_train.py::test_evaluation_episodes_are_the_same_for_every_agent_and_training_seed",
    ),
    Mutation(
        "a checkpoint forgets a generator",
        "agents/components/replay_agent.py",
        'self._replay_rng.bit_generator.state = state["replay_rng"]',
        "pass",
        "agents/training/test_resuming.py::test_a_restored_agent_goes_on_to_the_same_bits[dqn-corrected-3]",
    ),
    Mutation(
        "resuming keeps the log's rows from after the checkpoint",
        "agents/training/run_folder.py",
        "self._log.truncate(offset)",
        "pass",
        "agents/training/test_resuming.py::test_an_interrupted_run_resumes_to_the_result_of_an_uninterrupted_one[q-learning-corrected-1]",
    ),
    Mutation(
        "1 the wrapper sums without discount",
        "options/options_env.py",
        "discounted = reward + self.gamma * discounted",
        "discounted = reward + discounted",
        "options/test_options_env.py::test_trap_1_a_k_step_option_is_worth_the_discounted_sum_of_its_rewards",
    ),
    Mutation(
        "2 the wrapper's discount is that of one primitive",
        "options/options_env.py",
        '"discount": self.gamma ** len(decision.rewards)',
        '"discount": self.gamma',
        "options/test_options_env.py::test_trap_2_cutting_an_option_into_halves_does_not_change_the_value",
    ),
    Mutation(
        "3 the cap inside an option is taken for an end",
        "options/options_env.py",
        "reward, decision.terminated, decision.truncated, info",
        "reward, decision.is_over, False, info",
        "options/test_options_env.py::test_trap_3_the_cap_inside_an_option_truncates_and_the_state_reached_is_returned",
    ),
    Mutation(
        "4 an option runs on after the exit",
        "options/options_env.py",
        "elif decision.is_over:",
        "elif decision.truncated:",
        "options/test_options_env.py::test_trap_4_an_exit_inside_an_option_keeps_the_bonus_and_ends_it",
    ),
    Mutation(
        "5 options step the bare room, past the wrappers below",
        "options/options_env.py",
        "decision = RunningDecision(self.env, self._domain",
        "decision = RunningDecision(self.env.unwrapped, self._domain",
        "options/test_options_env.py::test_trap_5_a_time_limit_below_counts_primitives_and_cuts_options",
    ),
    Mutation(
        "10 nothing is legal",
        "options/options_env.py",
        "            mask[:] = 1",
        "            pass",
        "options/test_options_env.py::test_trap_10_there_is_always_a_legal_action",
    ),
    Mutation(
        "12 termination is asked at the state left",
        "options/options_env.py",
        "                run.rewards += decision.do(self._domain.check_action(run.choose(decision.state)))\n"
        "                if run.ends_at(decision.state",
        "                left = decision.state\n"
        "                run.rewards += decision.do(self._domain.check_action(run.choose(left)))\n"
        "                if run.ends_at(left",
        "options/test_options_env.py::test_trap_12_termination_is_asked_at_the_state_reached",
    ),
    Mutation(
        "13 the new episode stands where the state reached belongs",
        "options/options_env.py",
        "mask = self._compute_mask(decision.state, self._lower_mask)\n        info",
        "mask = self._compute_mask(decision.state, self._lower_mask)\n"
        "        if decision.is_over:\n            decision.observation = self.env.reset()[0]\n        info",
        "options/test_options_env.py::test_trap_13_autoreset_does_not_replace_the_state_reached",
    ),
    Mutation(
        "14 a failed plan is free",
        "options/options_env.py",
        "            if not decision.rewards:\n                rewards",
        "            if False:\n                rewards",
        "options/test_options_env.py::test_trap_14_a_failed_plan_costs_one_primitive",
    ),
    Mutation(
        "15 any option counts as consistent",
        "options/options_env.py",
        "if option.is_markov and option.initiation(step.state)",
        "if option.initiation(step.state)",
        "options/test_options_env.py::test_trap_15_only_options_whose_policy_is_a_function_of_the_state_are_consistent",
    ),
    Mutation(
        "1 a decision of a level below counts as one primitive",
        "options/execution.py",
        "    if duration == 1:",
        "    if True:",
        "options/test_levels.py::test_durations_discounts_and_rewards_count_the_primitives_of_the_lowest_level",
    ),
    Mutation(
        "2 intra-option learning discounts a decision of a level below as one primitive",
        "agents/algorithms/intra_option_q.py",
        "discount * float(primitive_reward), discount * self.gamma",
        "discount * float(primitive_reward), self.gamma",
        "options/test_levels.py::test_agents_over_two_levels_learn_the_exact_values",
    ),
    Mutation(
        "9 what the environment itself masks is legal over options",
        "options/options_env.py",
        "mask[: self.primitive_count] = lower[: self.primitive_count]",
        "pass",
        "options/test_plain_envs.py::test_a_masked_option_costs_the_first_legal_primitive",
    ),
    Mutation(
        "18 a comparison without chance over the same options passes without a word",
        "experiments/verdict.py",
        "if unmatched:",
        "if False:",
        "experiments/test_verdict.py::test_cautions",
    ),
]

MUTATIONS += [Mutation(*fields) for fields in given.MUTATIONS]


def run_test(folder, test):
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"tests/{test}"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_every_guarded_line_and_its_test_exist():
    for trap, file, line, _, test in MUTATIONS:
        count = (ROOT / "hrl_escape" / file).read_text().count(line)
        assert count == 1, f"{trap}: {line!r} stands {count} times in {file}"
        path, _, name = test.partition("::")
        assert f"def {name.partition('[')[0]}(" in (ROOT / "tests" / path).read_text(), f"{trap}: {test}"


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.trap)
def test_a_sprung_trap_is_seen(tmp_path, mutation):
    for name in ("hrl_escape", "tests"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__", "data"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = tmp_path / "hrl_escape" / mutation.file
    path.write_text(path.read_text().replace(mutation.line, mutation.broken))
    done = run_test(tmp_path, mutation.test)
    assert done.returncode == 1, f"not seen:\n{done.stdout}{done.stderr}"
    assert " failed" in done.stdout and "SyntaxError" not in done.stdout
