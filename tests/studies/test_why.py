"""Why options help: sentences from data of other truths, and the learner that explores by them in real rooms."""

from __future__ import annotations

import dataclasses

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.training.train import train
from hrl_escape.options.options_env import OptionsEnv
from studies.price.contestants import Contestant, sample_replicate_room
from studies.price.explorer import count_primitives, make_explorer, measure_lengths
from studies.price.runs import PriceRun, compute_run_key
from studies.study import find_study
from studies.why.analysis import EXPLORES, REPEATS, advise, compare, tell_headline
from tests.studies.pages import tell as write_page

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


def say(escapes: dict[str, float], halves: dict[str, float]) -> str:
    return tell_headline(STUDY, compare(STUDY, make_lines(escapes, halves)))


def test_exploration_alone_is_told_apart_from_whole_options_and_from_repeats():
    told = say({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000, EXPLORES: 20_000, WHOLE: 1_000})
    assert "brings the first escape sooner with 1 and 2 buttons; whole options are not shown to bring it sooner" in told
    assert "policy of half the efficiency sooner with 1 and 2 buttons, and whole options bring it sooner still" in told
    assert told.endswith("Repeats that last as long do less, so what helps is where options lead, not that they last.")


def test_other_truths_give_other_sentences():
    told = say({FLAT: 9_000, WHOLE: 100}, {FLAT: 50_000, WHOLE: 1_000})
    assert "is not shown to bring the first escape sooner, and whole options bring it sooner still with 1 and 2" in told
    assert told.endswith("Repeats that last as long are not shown to do less.")
    told = say({FLAT: 9_000, EXPLORES: 100, REPEATS: 100, WHOLE: 100}, {FLAT: 5_000})
    assert "it is not shown to bring a greedy policy of half the efficiency sooner." in told


def test_advice_follows_what_each_part_brings():
    def advise_by(escapes, halves):
        return advise(STUDY, compare(STUDY, make_lines(escapes, halves)))

    both = advise_by({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000, EXPLORES: 20_000, WHOLE: 1_000})
    assert both.startswith("Let planned options explore") and both.endswith("what makes it efficient soon.")
    explored = advise_by({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000})
    assert explored.endswith("That is all that they were shown to give.")
    assert "exploration by them alone was not" in advise_by({FLAT: 9_000, WHOLE: 100}, {FLAT: 50_000, WHOLE: 1_000})
    assert advise_by({FLAT: 9_000}, {FLAT: 50_000}).startswith("Planned options were not shown to help")


def test_a_page_of_another_truth_says_another_thing(tmp_path):
    lines = [line for line in make_lines({FLAT: 9_000_000}, {FLAT: 9_000_000}) if line.agent in OTHERS]
    page = write_page("why", lines, tmp_path)
    assert "is not shown to bring the first escape sooner" in page and (tmp_path / "figures/why.svg").exists()
    assert all(f"| {label} |" in page for label in (*OTHERS, WHOLE))


@pytest.fixture(scope="module")
def room():
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=sample_replicate_room(1, 100),
                                    observation="features", disable_env_checker=True), trace=True)
    yield env
    env.close()


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
