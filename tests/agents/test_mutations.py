"""Shows that the tests of the SMDP traps can fail: each trap is sprung in a copy of the code, and its test sees it.

Every entry names the line that a test guards. Slow: each breaks the code in a folder of its own and runs pytest there.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow


class Mutation(NamedTuple):
    trap: str
    file: str
    line: str
    broken: str
    test: str


MUTATIONS = [
    Mutation(
        "1 summed reward with gamma^k",
        "agent.py",
        "discounted = float(primitive_reward) + gamma * discounted",
        "discounted = float(primitive_reward) + discounted",
        "test_tabular.py::test_trap_1_an_option_learned_from_its_primitive_rewards_is_worth_their_discounted_sum",
    ),
    Mutation(
        "2 bootstrapping with gamma^1",
        "agent.py",
        "gamma**duration,",
        "gamma,",
        "test_tabular.py::test_trap_2_cutting_an_option_into_parts_does_not_change_values",
    ),
    Mutation(
        "3 truncation as termination, in the backup",
        "agent.py",
        "transition.terminated or (transition.truncated and not settings.bootstrap_on_truncation)",
        "transition.terminated or transition.truncated",
        "test_tabular.py::test_trap_3_a_cap_inside_an_option_bootstraps_from_where_it_was_cut",
    ),
    Mutation(
        "3 truncation as termination, in deep sarsa",
        "agent.py",
        "transition.terminated or (transition.truncated and not settings.bootstrap_on_truncation)",
        "transition.terminated or transition.truncated",
        "test_sarsa.py::test_trap_3_a_cut_episode_still_has_a_future",
    ),
    Mutation(
        "4 the exit's bonus loses its discount",
        "agent.py",
        "return discounted, float(sum(rewards))",
        "return discounted - gamma ** (duration - 1) * rewards[-1] + rewards[-1], float(sum(rewards))",
        "test_transition.py::test_trap_4_an_exit_inside_an_option_keeps_its_bonus_at_gamma_to_the_k_minus_1",
    ),
    Mutation(
        "6 budget in decisions",
        "training.py",
        "self.primitives += transition.duration",
        "self.primitives += 1",
        "test_training.py::test_trap_6_the_budget_and_every_curve_are_in_primitives_not_decisions",
    ),
    Mutation(
        "6 planner calls not counted",
        "training.py",
        'self.planner_calls += option.get("planner_calls", 0)',
        "self.planner_calls += 0",
        "test_training.py::test_trap_6_planner_calls_are_counted",
    ),
    Mutation(
        "7 discounts shuffled on the way out of a checkpoint",
        "replay.py",
        "field[: len(self)] = stored",
        "field[: len(self)] = stored if name != 'bootstrap' else stored[::-1]",
        "test_replay.py::test_trap_7_what_is_sampled_is_what_was_stored_also_after_a_checkpoint",
    ),
    Mutation(
        "8 n-step multiplies one gamma only",
        "replay.py",
        "bootstrap=first.bootstrap * then.bootstrap,",
        "bootstrap=then.bootstrap,",
        "test_replay.py::test_trap_8_n_step_returns_multiply_each_gamma_k_and_stop_at_ends",
    ),
    Mutation(
        "8 n-step runs over an episode's end",
        "replay.py",
        "if episode_over:",
        "if False:",
        "test_replay.py::test_trap_8_n_step_returns_multiply_each_gamma_k_and_stop_at_ends",
    ),
    Mutation(
        "9 an illegal action wins the maximum, deep",
        "dqn.py",
        "best = next_choice.masked_fill(~next_mask, -torch.inf).argmax",
        "best = next_choice.argmax",
        "test_deep_losses.py::test_trap_9_an_illegal_action_of_value_a_million_leaves_every_target_alone",
    ),
    Mutation(
        "9 an illegal action wins the maximum, tabular",
        "q_learning.py",
        "float(next_values[transition.next_action_mask].max())",
        "float(next_values.max())",
        "test_tabular.py::test_trap_9_an_illegal_action_of_high_value_does_not_win_the_maximum",
    ),
    Mutation(
        "10 a mask without a legal action is let through",
        "agent.py",
        "if not legal.any():",
        "if False:",
        "test_transition.py::test_trap_10_a_mask_without_a_legal_action_is_refused",
    ),
    Mutation(
        "11 exploration ignores the mask",
        "exploration.py",
        "legal = mask.nonzero()[0]",
        "legal = np.arange(len(mask))",
        "test_exploration.py::test_trap_11_exploration_never_draws_an_illegal_action",
    ),
    Mutation(
        "11 ddpg's argmax ignores the mask",
        "exploration.py",
        "return int(np.where(mask, values, -np.inf).argmax())",
        "return int(values.argmax())",
        "test_registry.py::test_trap_11_no_agent_ever_takes_an_illegal_action[ddpg]",
    ),
    Mutation(
        "12 beta weighed at the state left",
        "intra_option_q.py",
        "next_values = self.compute_values(next_observation)\n        ended",
        "next_values = self.compute_values(observation)\n        ended",
        "test_tabular.py::test_trap_12_termination_is_weighed_at_the_state_reached",
    ),
    Mutation(
        "14 a free self-loop",
        "agent.py",
        "elif duration < 1:",
        "elif duration < 0:",
        "test_transition.py::test_trap_14_an_action_that_costs_no_primitive_is_refused",
    ),
    Mutation(
        "15 intra-option updates for any option",
        "intra_option_q.py",
        'return getattr(item, "consistent", ())',
        'return (*getattr(item, "consistent", ()), (1, 0.0))',
        "test_tabular.py::test_trap_15_an_option_that_is_no_function_of_the_state_is_learned_as_a_whole_only",
    ),
    Mutation(
        "16 lambda per primitive whatever is set",
        "ppo.py",
        'powers = rollout.duration if settings.lambda_per == "primitive" else np.ones(len(delta))',
        "powers = rollout.duration",
        "test_deep_losses.py::test_trap_16_advantages_equal_the_sum_of_discounted_errors_with_lambda_as_named",
    ),
    Mutation(
        "17 evaluation draws from the agent's own generator",
        "random.py",
        "return sample_legal(action_mask, rng)",
        "return sample_legal(action_mask, self._rng)",
        "test_training.py::test_trap_17_evaluating_twice_gives_the_same_bits_and_changes_nothing[random]",
    ),
    Mutation(
        "17 evaluation episodes follow the training seed",
        "training.py",
        "self.plan.eval_seed,\n            primitives",
        "self.plan.seed,\n            primitives",
        "test_training.py::test_evaluation_episodes_are_the_same_for_every_agent_and_training_seed",
    ),
    Mutation(
        "a checkpoint forgets a generator",
        "dqn.py",
        'self._replay_rng.bit_generator.state = state["replay_rng"]',
        "pass",
        "test_resuming.py::test_a_restored_agent_goes_on_to_the_same_bits[dqn-corrected-3]",
    ),
    Mutation(
        "resuming keeps the log's rows from after the checkpoint",
        "run_folder.py",
        "self._log.truncate(offset)",
        "pass",
        "test_resuming.py::test_an_interrupted_run_resumes_to_the_result_of_an_uninterrupted_one[q-learning-corrected-1]",
    ),
]


def run_test(folder, test):
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"tests/agents/{test}"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.trap)
def test_a_sprung_trap_is_seen(tmp_path, mutation):
    for name in ("hrl_escape", "tests"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__", "data"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = tmp_path / "hrl_escape" / "agents" / mutation.file
    source = path.read_text()
    assert source.count(mutation.line) == 1, f"{mutation.line!r} stands {source.count(mutation.line)} times"
    path.write_text(source.replace(mutation.line, mutation.broken))
    done = run_test(tmp_path, mutation.test)
    assert done.returncode == 1, f"not seen:\n{done.stdout}{done.stderr}"
    assert " failed" in done.stdout and "SyntaxError" not in done.stdout
