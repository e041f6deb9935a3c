"""Flat agents: repeated actions in many copies of a room, and comparisons of known data."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from hrl_escape.agents.components.policy_gradient import compute_clipped_loss
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ComparisonError
from studies.flat import ARCHIVE, FlatLearner, FlatRun, RepeatedStreams, count_untrained
from studies.flat_ppo.analysis import compare as compare_ppo
from studies.flat_ppo.analysis import find_untrained, read_corners, read_escape, take_exponent
from studies.league.analysis import (
    Attempt,
    choose_candidate,
    choose_course,
    compare,
    find_longer,
    find_source,
    list_candidates,
    read_flat,
    read_price,
)
from studies.price.runs import PriceRun
from studies.study import find_study

LINE = FlatRun("ppo", 2, 0, 30, 1_000, 500, ((0, 0.0), (500, 0.0), (1_000, 0.0)), (0.1,) * 10, (0.2,) * 10, (1.7,) * 10,
               1.0, "a")
PPO, LEAGUE = find_study("flat-ppo"), find_study("league")


# --- repeated actions -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def rooms() -> Any:
    env = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=3, config="paper-two-button", observation="features",
                             output="torch")
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("repeat", [1, 4])
def test_repeated_actions_are_decisions_of_that_many_primitives(rooms: Any, repeat: int):
    streams = RepeatedStreams(rooms, repeat, 0.9)
    streams.reset(0)
    seen, ended = [], 0
    for step in range(2 * repeat):
        assert bool(streams.is_waiting.all()) == (step % repeat == 0)
        before = streams.observation.clone()
        done = streams.step(torch.full((3,), 4))  # turn left
        seen.append(before)
        if bool(done.where.any()):
            ended += 1
            assert bool(done.where.all()) and done.duration.tolist() == [repeat] * 3
            assert torch.equal(done.observation, seen[(ended - 1) * repeat]), "where it was chosen"
            assert torch.equal(done.next_observation, streams.observation)
            assert done.reward.tolist() == [-repeat] * 3
            assert done.discounted_reward.tolist() == pytest.approx([-sum(0.9**n for n in range(repeat))] * 3)
    assert ended == 2


def test_an_action_that_is_given_between_decisions_changes_nothing(rooms: Any):
    streams, courses = RepeatedStreams(rooms, 3, 0.9), []
    for between in (0, 5):
        streams.reset(0)
        for action in (4, between, between):
            streams.step(torch.full((3,), action))
        courses.append(streams.observation.clone())
    assert torch.equal(*courses)


def test_a_decision_ends_with_its_episode_and_the_next_one_begins_anew():
    config = dataclasses.replace(get_preset("paper-two-button"), horizon=5)
    env: Any = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=2, config=config, observation="features",
                                  output="torch")
    env.reset(seed=0)
    streams = RepeatedStreams(env, 4, 0.9)
    streams.reset(0)
    durations = []
    for _ in range(12):
        done = streams.step(torch.zeros(2, dtype=torch.int64))
        durations += done.duration[done.where].tolist()[:1]
    assert durations == [4, 1, 4, 1], "five primitives an episode, and a reset between them"
    state = streams.state_dict()
    after = [streams.step(torch.full((2,), 4)).next_observation for _ in range(3)][-1]
    streams.reset(7)
    streams.load_state_dict(state)
    assert torch.equal([streams.step(torch.full((2,), 4)).next_observation for _ in range(3)][-1], after)


def test_advantages_as_they_are_make_the_loss_their_mean():
    """With a ratio of 1 the loss is -mean(A), which normalising makes 0; a ratio of 2 is clipped to 1.2 for A > 0."""
    advantage, log = torch.tensor([0.01, 0.03]), torch.zeros(2)
    assert float(compute_clipped_loss(log, log, advantage, 0.2, normalise=False)) == pytest.approx(-0.02)
    assert float(compute_clipped_loss(log, log, advantage, 0.2)) == pytest.approx(0.0, abs=1e-6)
    doubled = float(compute_clipped_loss(log + np.log(2), log, advantage, 0.2, normalise=False))
    assert doubled == pytest.approx(-1.2 * 0.02)


# --- why PPO falls ---------------------------------------------------------------------------


def make_runs(label: str, first: float, corners: float, runs: int = 10, **fields: Any) -> list[FlatRun]:
    return [dataclasses.replace(LINE, agent=label, seed=seed,
                                first_escape=round(first * (1 + 0.02 * ((7 * seed) % 10))),
                                corners=(corners + 0.001 * ((3 * seed) % 10),) * 10, **fields) for seed in range(runs)]


def test_a_change_of_ppo_is_compared_by_corners_and_first_escapes():
    lines = [*make_runs("ppo", 400, 0.3), *make_runs("good", 20, 0.05), *make_runs("bad", 900, 0.6),
             *make_runs("few", 20, 0.05, runs=9)]
    corners = compare_ppo(lines, ["good", "bad", "few"], "ppo", read_corners)
    escapes = {label: take_exponent(found) for label, found in
               compare_ppo(lines, ["good", "bad", "few"], "ppo", read_escape).items()}
    assert corners.keys() == escapes.keys() == {"good", "bad"}, "nine pairs are too few"
    assert corners["good"].high < -0.2 and corners["bad"].low > 0.2
    assert escapes["good"] is not None and escapes["good"].mean == pytest.approx(20 / 400, rel=1e-3)
    assert escapes["bad"] is not None and escapes["bad"].low > 2


def test_escapes_before_the_first_update_are_found():
    """Of 64 streams and 32 decisions a rollout, each of eight primitives, the first update comes after 16,384."""
    learners = {label: FlatLearner(label, "ppo", repeat=repeat) for label, repeat in (("a", 8), ("b", 8), ("c", 1))}
    lines = [*make_runs("a", 10_000, 0.1), *make_runs("b", 16_000, 0.2), *make_runs("c", 20_000, 0.3)]
    assert find_untrained(lines, learners) == {"a": (11_800, 16_384)}
    never = [dataclasses.replace(run, first_escape=None) if run.seed == 3 else run for run in lines]
    assert find_untrained(never, learners) == {}


def test_the_analysis_of_ppo_has_every_learner_and_counts_greedy_escapes():
    labels = [table["label"] for table in PPO.data["learners"]]
    lines = [run for number, label in enumerate(labels) for run in make_runs(label, 100 * (1 + number), 0.1)]
    lines += [dataclasses.replace(run, curve=((0, 0.0), (1_000, 0.5))) for run in make_runs("ppo", 300, 0.1)[3:4]]
    found = PPO.analysis.analyse(PPO, lines)
    assert found.numbers.greedy["ppo"] == 1 and set(found.numbers.corners) == set(labels)
    assert found.tables["flat_ppo"].count("\n") == len(labels) + 1


def test_the_first_update_is_where_a_run_s_settings_put_it():
    assert count_untrained(FlatLearner("x", "ppo", {"rollout_per_env": 16}, streams=64, repeat=4)) == 4_096
    assert count_untrained(FlatLearner("x", "ppo", streams=4)) == 256, "no rollout is shorter"
    assert count_untrained(FlatLearner("x", "ppo", streams=0)) == count_untrained(FlatLearner("x", ARCHIVE)) == 0


# --- the league ------------------------------------------------------------------------------


def make_cells(label: str, buttons: int, first: float | None, half: float | None, ninety: float | None, runs: int = 10,
               spent: int = 1_000_000) -> dict[tuple[str, int], list[Attempt]]:
    """A cell whose runs spread by 2 % about these waits; None for a level that none reaches."""
    def wait(time: float | None, seed: int) -> tuple[float, bool]:
        return (spent, False) if time is None else (time * (1 + 0.02 * ((7 * seed) % 10)), True)

    return {(label, buttons): [Attempt(label, buttons, seed, 20, spent, {
        0.0: wait(first, seed), 0.5: wait(half, seed), 0.9: wait(ninety, seed)}) for seed in range(runs)]}


GOOD, LATE = make_cells("a", 1, 100, 500, 900), make_cells("b", 1, 100, 900, 5_000)
LOST = make_cells("c", 1, 100, None, None)


def test_a_run_of_the_league_is_read_by_its_first_escape_and_pairs_of_evaluations():
    curve = ((0, 0.0), (500, 0.95), (900, 0.9), (950, 0.2))
    run = dataclasses.replace(LINE, first_escape=None, fewest=600, curve=curve)
    assert read_flat(run, (0.5, 0.9)).waits == {0.0: (950, False), 0.5: (600, True), 0.9: (600, True)}, "one escape"
    assert read_flat(dataclasses.replace(LINE, curve=((0, 0.0), (500, 0.95), (1_000, 0.8))), (0.5, 0.9)).waits == {
        0.0: (500, True), 0.5: (500, True), 0.9: (1_000, False)}
    price = PriceRun("dqn", 1, 3, 20, 60_000, 9_000, 400, 6_500, 0.9, 9, 9, 1.0, "a")
    told = read_price(price, "dqn, patient", (0.5, 0.9))
    assert told.waits == {0.0: (400, True), 0.9: (6_500, True)} and told.agent == "dqn, patient", "no curve, no 0.5"
    price = dataclasses.replace(price, curve=((0, 0.0), (500, 0.6), (750, 0.6)))
    assert read_price(price, "x", (0.5, 0.9)).waits[0.5] == (500, True)


def test_first_escapes_are_compared_room_by_room():
    others = {(1, seed): (20 * (1 + 0.02 * ((7 * seed) % 10)), True) for seed in range(10)}
    assert compare(GOOD["a", 1], others, 0.0).middle.factor == pytest.approx(5)
    lost = [run._replace(waits={0.0: (10_000, run.seed > 2)}) for run in GOOD["a", 1]]
    assert compare(lost, others, 0.0).middle.knowledge == "bound", "three never escaped, so there is no upper end"


def test_hopeless_cells_are_not_run():
    data = {"sizes": [1, 2, 3], "runs": 10, "efficient": [0.5, 0.9]}
    assert choose_course(data, [], 1) == "whole" and choose_course(data, GOOD["a", 1][:9], 2) == "later"
    assert choose_course(data, GOOD["a", 1], 2) == "whole", "some reached 0.5"
    assert choose_course(data, LOST["c", 1], 2) == "first escape", "all escaped, none reached 0.5"
    never = make_cells("d", 1, None, None, None)["d", 1]
    assert choose_course(data, never, 2) == choose_course(data, never, 3) == "none"
    assert choose_course(data, [*LOST["c", 1], *make_cells("c", 2, 300, None, None)["c", 2]], 3) == "first escape"


def test_runs_that_are_longer_are_of_the_fewest_buttons_that_were_too_many():
    label, other, _ = LEAGUE.data["longer"]["agents"]
    done, half = make_cells(label, 1, 1, 2, 3), make_cells(label, 2, 1, 2, None)
    cells = {**done, **half, **make_cells(label, 3, 1, None, None), **make_cells(other, 1, 1, 2, 3),
             **make_cells(other, 2, 1, 2, None, runs=9)}
    assert find_longer(LEAGUE, cells) == {label: 2}, "the other has run too few"


def test_settings_are_those_of_the_best_trials():
    label = LEAGUE.data["learners"][0]["label"]
    assert {len(table["candidates"]) for table in LEAGUE.data["learners"]} == {3}, "all are tuned alike"
    assert min(LEAGUE.data["trials"]["seeds"]) >= LEAGUE.data["runs"], "in other rooms"
    names = [candidate.label for candidate in list_candidates(LEAGUE, label)]
    lines = [dataclasses.replace(LINE, agent=name, seed=seed, buttons=1, first_escape=900 - 100 * number)
             for number, name in enumerate(names) for seed in LEAGUE.data["trials"]["seeds"]]
    chosen = [choose_candidate(LEAGUE, lines, label).settings]
    assert find_source(LEAGUE, choose_candidate(LEAGUE, lines, label)) is None, "the price study has other settings"
    lines[2] = dataclasses.replace(lines[2], escapes=(0.1,) * 9 + (0.2,))
    chosen.append(choose_candidate(LEAGUE, lines, label).settings)
    lines[0] = dataclasses.replace(lines[0], curve=((0, 0.0), (1_000, 0.4)))
    chosen.append(choose_candidate(LEAGUE, lines, label).settings)
    assert chosen == [list(list_candidates(LEAGUE, label))[number].settings for number in (2, 1, 0)]
    assert find_source(LEAGUE, choose_candidate(LEAGUE, lines, label)) == "dqn", "the first's settings"
    with pytest.raises(ComparisonError, match="has 1 trial"):
        choose_candidate(LEAGUE, lines[:-1], label)
