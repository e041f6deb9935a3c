"""Parts of what options provide: comparisons of known data, and learners that explore and plan by options."""

from __future__ import annotations

import dataclasses

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.train import train
from hrl_escape.options.options_env import OptionsEnv
from studies.price.contestants import Contestant, sample_replicate_room
from studies.price.explorer import make_explorer
from studies.price.lookahead import EXIT, list_events, make_lookahead
from studies.price.over_primitives import count_primitives, measure_lengths
from studies.price.runs import PriceRun, compute_run_key
from studies.study import find_study
from studies.why.analysis import (
    AHEAD,
    EXPLORES,
    RANDOM_AHEAD,
    REPEATS,
    Pair,
    compare,
    count_alike,
    list_families,
)

STUDY = find_study("why")
FLAT, WHOLE = STUDY.data["flat"], STUDY.data["whole"]
OTHERS = [learner["label"] for learner in STUDY.data["learners"]]


def make_lines(escapes: dict[str, float], halves: dict[str, float], sizes=(1, 2)) -> list[PriceRun]:
    """Ten runs of each learner and size around these costs; a learner that is not named has those of the flat one."""
    rng, lines = np.random.default_rng(3), []
    for label in (FLAT, WHOLE, *OTHERS):
        for size in sizes:
            for replicate in range(10):
                escape, half = (int(costs.get(label, costs[FLAT]) * np.exp(0.2 * rng.normal())) + 30
                                for costs in (escapes, halves))
                curve = ((half, 0.6), (half + 5_000, 0.6))
                lines.append(PriceRun(label, size, replicate, 30, 1_000_000, half + 5_000, escape, None, 0.6, 10, 5,
                                      1.0, "key", curve))
    return lines




def find_gains(one: str, other: str, cost: str, escapes: dict[str, float], halves: dict[str, float]) -> set[int]:
    """Numbers of buttons with which one learner is shown to pay more than another."""
    found = compare(STUDY, make_lines(escapes, halves))
    return {ratio.buttons for ratio in found[Pair(one, other), cost] if ratio.middle.low > 1}


def test_each_part_is_compared_with_the_flat_learner_and_its_control():
    escapes = {FLAT: 9_000, EXPLORES: 100, WHOLE: 100, AHEAD: 1_000}
    halves = {FLAT: 50_000, EXPLORES: 20_000, WHOLE: 1_000}
    for one, other, cost, sizes in ((FLAT, EXPLORES, "escape", {1, 2}), (FLAT, EXPLORES, "half", {1, 2}),
                                    (EXPLORES, WHOLE, "escape", set()), (EXPLORES, WHOLE, "half", {1, 2}),
                                    (REPEATS, EXPLORES, "escape", {1, 2}), (FLAT, AHEAD, "escape", {1, 2}),
                                    (FLAT, AHEAD, "half", set()), (RANDOM_AHEAD[0], AHEAD, "escape", {1, 2})):
        assert find_gains(one, other, cost, escapes, halves) == sizes, (one, other, cost)


def test_learners_with_the_same_costs_are_counted():
    lines = make_lines({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000})
    first = {(line.buttons, line.replicate): line.first_escape for line in lines if line.agent == EXPLORES}
    same = [dataclasses.replace(line, first_escape=first[line.buttons, line.replicate])
            if line.agent == WHOLE and line.replicate < 6 else line for line in lines]
    assert count_alike(compare(STUDY, same), Pair(EXPLORES, WHOLE), "escape") == (12, 20)


def test_questions_are_corrected_as_families():
    lines = make_lines({FLAT: 9_000}, {FLAT: 20_000, AHEAD: 15_000, EXPLORES: 15_000})
    found = compare(STUDY, lines)
    for pair in (pair for family in list_families(STUDY) for pair in family):
        for ratio in found[pair, "half"]:
            assert (ratio.middle.low > 1 or ratio.middle.high < 1) == (ratio.middle.p < 0.05)


@pytest.fixture(scope="module")
def room():
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=sample_replicate_room(1, 100),
                                    observation="features", disable_env_checker=True), trace=True)
    yield env
    env.close()


@pytest.mark.nightly
@pytest.mark.parametrize("explores_by", ["options", "repeats"])
def test_random_primitives_are_as_many_as_epsilon_says_and_all_are_learned_from(room, explores_by):
    settings = {"epsilon_start": 0.3, "epsilon_end": 0.3, "warmup": 10**6, "n_step": 1}
    agent = make_explorer(explores_by, room, 0, settings)
    first, chosen = count_primitives(room), []
    act = agent.act

    def note(observation, mask):
        before = agent._repeated
        choice = act(observation, mask)
        chosen.append((choice, before[1] > 0 or agent._repeated != before or choice >= first))
        return choice

    agent.act = note
    result = train(agent, room, primitives=6_000, eval_episodes=0, progress=False)
    spent = np.array([length for episode in result.episodes for length in [episode.length]]).sum()
    assert len(agent.replay) == pytest.approx(6_000, abs=60) and spent <= 6_100
    assert {choice < first for choice, _ in chosen} == ({True, False} if explores_by == "options" else {True})
    greedy = sum(not is_random for _, is_random in chosen)
    assert 1 - greedy / len(agent.replay) == pytest.approx(0.3, abs=0.08)
    rows = agent.replay.take(np.arange(len(agent.replay)))
    assert int(np.max(np.asarray(rows.action))) < first


def test_lengths_are_those_of_options_and_a_greedy_choice_is_a_primitive(room):
    lengths = measure_lengths(room)
    assert len(lengths) == 40 and min(lengths) >= 1 and np.mean(lengths) > 3
    agent = make_explorer("options", room, 0, {})
    observation, info = room.reset(seed=1)
    choice = agent.act_greedy(observation, info["action_mask"].astype(bool), np.random.default_rng(0))
    assert choice < count_primitives(room)


def test_how_it_explores_is_part_of_a_run_s_key_and_nothing_changes_for_others():
    plain = Contestant("x", "dqn", 10, 5, (1,))
    room = sample_replicate_room(1, 0)
    keys = {compute_run_key(dataclasses.replace(plain, explores_by=way), room, 0) for way in ("", "options", "repeats")}
    assert len(keys) == 3
    ahead = {compute_run_key(dataclasses.replace(plain, looks_along=way), room, 0) for way in WAYS}
    assert len(keys | ahead) == 6


@pytest.fixture(scope="module")
def model():
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=sample_replicate_room(1, 100),
                                    observation="features", disable_env_checker=True), trace=True)
    yield env
    env.close()


WAYS = ("options", "random ways", "primitives")


def step_through(room, state, way):
    """Run a way's primitives in a room: states, observations and rewards of each."""
    room.reset(seed=5, options={"state": state})
    for imagined in way:
        observation, reward, *_ = room.step(int(imagined.action))
        yield room.unwrapped.get_state(), observation, reward


@pytest.mark.parametrize("looks_along", WAYS)
def test_what_is_imagined_is_what_the_room_does_also_near_the_end_of_an_episode(room, model, looks_along):
    agent = make_lookahead(looks_along, room, model, 0, {"warmup": 10**6})
    room.reset(seed=5)
    begin = room.unwrapped.get_state()
    lengths = set()
    for _ in range(5):
        way = list(agent.imagine(begin._replace(primitives=995)))
        lengths.add(len(way))
        for imagined, (_, observation, reward) in zip(way, step_through(room, begin, way), strict=True):
            assert np.array_equal(agent._encoder.encode(observation), imagined.next_observation)
            assert imagined.reward == reward * agent.settings.reward_scale and imagined.bootstrap == agent.gamma
            assert imagined.action < count_primitives(room)
    assert max(lengths) > 5


def test_an_option_is_imagined_up_to_the_touch_or_the_way_in_that_has_not_happened(room, model):
    agent = make_lookahead("options", room, model, 0, {"warmup": 10**6})
    room.reset(seed=5)
    begin = room.unwrapped.get_state()
    button, leave = (room.action_names.index(name) for name in ("press-button-1", "go-to-exit"))

    def imagine(state, option):
        agent._choose_way = lambda action_mask: [option]
        return list(agent.imagine(state))

    def run(state, option):
        room.reset(seed=5, options={"state": state})
        *_, info = room.step(option)
        return info["trace"]

    press, early, late = run(begin, button), run(begin, leave), run(run(begin, button)[-1].next_state, leave)
    pressed = press[-1].next_state
    for state, option, trace, escapes in ((begin, button, press, False), (begin, leave, early, False),
                                          (pressed, leave, late, True)):
        assert len(imagine(state, option)) == len(trace) - 1, "all but the last is known from the start"
        assert list(list_events(trace[-1], agent._exit)) and not list(list_events(trace[0], agent._exit))
        agent._known |= set(list_events(trace[-1], agent._exit))
        way = imagine(state, option)
        assert len(way) == len(trace) and way[-1].bootstrap == (0.0 if escapes else agent.gamma)
    assert late[-1].reward > 0 and imagine(pressed, leave)[-1].reward == late[-1].reward * agent.settings.reward_scale


@pytest.mark.nightly
@pytest.mark.nightly_for("random ways", "options")
@pytest.mark.parametrize("looks_along", WAYS)
def test_a_learner_that_looks_ahead_imagines_as_many_primitives_as_it_runs(room, model, looks_along):
    agent = make_lookahead(looks_along, room, model, 0, {"warmup": 10**6})
    result = train(agent, room, primitives=2_000, eval_episodes=0, progress=False)
    assert result.primitives == sum(episode.length for episode in result.episodes) == 2_000
    assert len(agent.replay) == pytest.approx(4_000, abs=100)
    bootstraps = agent.replay.take(np.arange(len(agent.replay))).bootstrap
    longest = round(np.log(bootstraps[bootstraps > 0].min()) / np.log(agent.gamma))
    assert longest == agent.settings.n_step if looks_along == "primitives" else longest > 8


def test_a_checkpoint_keeps_what_is_known(room, model, tmp_path):
    agent, other = (make_lookahead("options", room, model, seed, {"warmup": 10**6}) for seed in (0, 1))
    train(agent, room, primitives=500, eval_episodes=0, progress=False)
    agent._known |= {(0, 1), (1, EXIT)}
    save_checkpoint(tmp_path / "checkpoint.npz", {"agent": agent.state_dict()})
    other.load_state_dict(load_checkpoint(tmp_path / "checkpoint.npz")["agent"])
    assert other._known == agent._known and other._ahead == agent._ahead
