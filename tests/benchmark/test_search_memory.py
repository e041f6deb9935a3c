"""Search with memory: it learns from earlier episodes in a room, under every rule for wrong presses."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import SEARCH_BACKTRACK, SEARCH_MEMORY, AgentSpec
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.evaluation import Evaluation, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.comparison import run_grid
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import VIOLATION_RULES, ButtonsPuzzle, ViolationRule
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnsupportedError
from hrl_escape.sets.room_spec import RoomSpec

ROOM = generate(get_preset("four-button-chain"), 1)


def make_room(order: tuple[int, ...], rule: ViolationRule) -> RoomInstance:
    return dataclasses.replace(ROOM, puzzle=ButtonsPuzzle(4, tuple(itertools.pairwise(order)), order[-1], rule))


def learn(room: RoomInstance, primitives: int, out: Path | None = None, *callbacks: Callback):
    env, recorder = make_agent_env(AgentSpec(SEARCH_MEMORY), room, "features")
    player = make_reference(SEARCH_MEMORY, env, recorder)
    result = train(player, env, primitives=primitives, eval_every=100, eval_episodes=1, progress=False,
                   observed=False, out=out, checkpoint_seconds=0.0, callbacks=callbacks)
    env.close()
    return result


@pytest.mark.parametrize("rule", VIOLATION_RULES)
def test_it_finds_the_order_under_every_rule_and_never_repeats_a_press_that_failed(rule: ViolationRule):
    result = learn(make_room((2, 0, 3, 1), rule), 600)
    last = result.evaluations[-1]
    assert last.successes == (True,) and last.decision_counts == (5,), "four presses and the exit"
    wrong = sum(not episode.success for episode in result.episodes if episode.end == "terminated")
    assert wrong <= 3 + 2 + 1, "each wrong press ends one episode under fail, and happens once"
    assert rule == "fail" or wrong == 0


def test_an_unneeded_press_is_dropped_and_presses_are_moved_until_the_tour_is_short():
    puzzle = ButtonsPuzzle(4, ((0, 1),), 1)  # buttons 3 and 4 are not needed
    room = dataclasses.replace(ROOM, puzzle=puzzle)
    result = learn(room, 800)
    lengths = [episode.length for episode in result.episodes if episode.success]
    assert result.evaluations[-1].decision_counts == (3,)
    assert min(lengths) == result.evaluations[-1].lengths[0] < lengths[0]


def test_evaluation_does_not_change_it_and_trials_share_what_they_find_out():
    room = make_room((1, 3, 0, 2), "ignore")
    env, recorder = make_agent_env(AgentSpec(SEARCH_MEMORY), room, "features")
    player = make_reference(SEARCH_MEMORY, env, recorder)
    first, again = (evaluate(player, env, 2) for _ in range(2))
    assert first == again, "each episode begins with the same knowledge"
    env.close()
    searched = []
    for order in ((1, 3, 0, 2), (2, 0, 3, 1), (3, 2, 1, 0)):
        trials, recorder = make_agent_env(AgentSpec(SEARCH_MEMORY), make_room(order, "ignore"), "features", trials=3)
        player = make_reference(SEARCH_MEMORY, trials, recorder)
        found = evaluate(player, trials, 1, trials=3).decision_counts
        assert found[1:] == (5, 5), "four presses and the exit"
        searched.append(found[0])
        trials.close()
    assert max(searched) > 5


class StopsEarly(Callback):
    """Ends a run at its third evaluation."""

    def __init__(self) -> None:
        self.count = 0

    def on_evaluation(self, agent: Agent, evaluation: Evaluation) -> bool:
        """Count."""
        self.count += 1
        return self.count == 3


def test_a_run_that_is_cut_resumes_to_the_same_numbers(tmp_path: Path):
    room = make_room((2, 1, 3, 0), "reset")
    whole = learn(room, 700)
    cut = learn(room, 700, tmp_path / "run", StopsEarly())
    assert cut.primitives < 700
    assert learn(room, 700, tmp_path / "run") == whole


def test_other_puzzles_are_refused_by_name():
    room = generate(get_preset("lights-out"), 0)
    env, recorder = make_agent_env(AgentSpec(SEARCH_MEMORY), room, "features")
    with pytest.raises(UnsupportedError, match="supports button puzzles"):
        evaluate(make_reference(SEARCH_MEMORY, env, recorder), env, 1)
    env.close()


@pytest.mark.nightly
def test_a_comparison_trains_it_with_the_budget_of_learners_and_reports_its_regret(tmp_path: Path):
    grid = Grid("memory", "", (AgentSpec(SEARCH_MEMORY), AgentSpec(SEARCH_BACKTRACK)),
                (RoomSpec.parse("four-button-chain#1"),), runs=1, primitives=600, eval_every=300, eval_episodes=1)
    comparison = run_grid(grid, tmp_path, LocalLauncher(1))
    assert not comparison.failures
    memory, backtrack = (result for _, result in comparison.runs)
    assert [evaluation.primitives >= 300 for evaluation in memory.evaluations] == [False, True, True]
    lost = 1 - memory.escapes * memory.score_range.fewest[0] / memory.primitives
    assert memory.regret == pytest.approx(lost) and 0 < memory.regret < backtrack.regret < 1
    assert memory.get_final("efficiency") > backtrack.get_final("efficiency")
    assert np.all(np.diff(memory.get_curve("efficiency")) >= 0)
