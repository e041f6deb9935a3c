"""Why options help: sentences from data of other truths, and the learner that explores by them in real rooms."""

from __future__ import annotations

import dataclasses

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.train import train
from hrl_escape.options.options_env import OptionsEnv
from studies.league.analysis import SearcherRun
from studies.price.contestants import Contestant, sample_replicate_room
from studies.price.explorer import make_explorer
from studies.price.lookahead import EXIT, list_events, make_lookahead
from studies.price.over_primitives import count_primitives, measure_lengths
from studies.price.runs import PriceRun, compute_run_key
from studies.price.words import conclude_prices
from studies.study import find_study
from studies.why.analysis import (
    AHEAD,
    ESCAPE,
    EXPLORES,
    HALF,
    RANDOM_AHEAD,
    REPEATS,
    advise,
    compare,
    find_gains,
    list_families,
    tell_headline,
    tell_pairs,
    tell_planning,
    tell_rooms,
    tell_searcher,
)
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


def test_learners_that_are_one_until_they_escape_are_called_so():
    lines = make_lines({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000})
    first = {(line.buttons, line.replicate): line.first_escape for line in lines if line.agent == EXPLORES}

    def copy(count: int) -> list[PriceRun]:
        return [dataclasses.replace(line, first_escape=first[line.buttons, line.replicate])
                if line.agent == WHOLE and line.replicate < count else line for line in lines]

    for count, is_told in ((10, True), (6, True), (5, False), (0, False)):
        found = compare(STUDY, copy(count))
        told = tell_headline(STUDY, found)
        assert (f"and until then {2 * count} of 20 runs are the same with whole options, as both" in told) == is_told
        assert ("; whole options are not shown to bring it sooner still; it" in told) != is_told
        said = tell_pairs(STUDY, found, copy(count))
        assert (f"Until its first escape, `{EXPLORES}` and `{WHOLE}` pay as much in {2 * count} of 20 runs, so the "
                "factor does not change with the number of buttons." in said) == is_told
        assert len(said) == len(set(said)) == 12


def test_rooms_that_the_price_of_flatness_has_beyond_these_are_told_of():
    lines = make_lines({FLAT: 9_000}, {FLAT: 50_000})
    more = [dataclasses.replace(line, replicate=line.replicate + 10) for line in lines if line.buttons == 2]
    assert tell_rooms(lines, [*lines, *more]) == (
        "That page has 20 rooms with 2 buttons, of which 10 are here, so that its factors differ.")
    assert not tell_rooms(lines, lines)


def test_other_truths_give_other_sentences():
    told = say({FLAT: 9_000, WHOLE: 100}, {FLAT: 50_000, WHOLE: 1_000})
    assert "is not shown to bring the first escape sooner, and whole options bring it sooner still with 1 and 2" in told
    assert told.endswith("Repeats that last as long are not shown to do less.")
    told = say({FLAT: 9_000, EXPLORES: 100, REPEATS: 100, WHOLE: 100}, {FLAT: 5_000})
    assert "it is not shown to bring a greedy policy of half the efficiency sooner." in told


def plan(escapes: dict[str, float], halves: dict[str, float], sizes=(1, 2)) -> str:
    return tell_planning(STUDY, compare(STUDY, make_lines(escapes, halves, sizes)))


WAYS_AHEAD, STEPS_AHEAD = RANDOM_AHEAD


def test_planning_is_told_apart_from_imagining_at_random():
    told = plan({FLAT: 9_000, AHEAD: 1_000}, {FLAT: 50_000, AHEAD: 20_000})
    assert told.startswith("A learner that imagines options, and runs none, reaches its first escape sooner than `dqn` "
                           "with 1 and 2 buttons and a greedy policy of half the efficiency sooner than `dqn` with 1")
    assert told.endswith("of half the efficiency later with 1 and 2 buttons: where options lead is what helps.")
    told = plan({FLAT: 9_000, AHEAD: 1_000, WAYS_AHEAD: 3_000, STEPS_AHEAD: 3_000}, {FLAT: 50_000}, (1,))
    assert told.endswith("bring its first escape later with 1 button: where options lead is what helps, "
                         "beside imagining at all.")
    for control in RANDOM_AHEAD:  # as good as one of the two, or better
        for costs in ({control: 1_000}, {control: 200}):
            told = plan({FLAT: 9_000, AHEAD: 1_000} | costs, {FLAT: 50_000})
            assert told.endswith("As many random primitives are not shown to do less.") and "policy" not in told


def test_what_random_ways_lack_counts_only_where_options_gain():
    told = plan({FLAT: 9_000, AHEAD: 1_000, WAYS_AHEAD: 1_000, STEPS_AHEAD: 1_000},
                {FLAT: 20_000, WAYS_AHEAD: 90_000, STEPS_AHEAD: 90_000})
    assert told.endswith("sooner than `dqn` with 1 and 2 buttons. As many random primitives are not shown to do less.")


def test_planning_may_do_nothing_or_harm_or_be_unmeasured():
    told = plan({FLAT: 9_000, EXPLORES: 100}, {FLAT: 50_000})
    assert told.endswith("is not shown to reach anything sooner than `dqn`.")
    assert plan({FLAT: 1_000, AHEAD: 9_000}, {FLAT: 50_000}, (2,)).endswith(
        "reaches its first escape later than `dqn` with 2 buttons.")
    told = plan({FLAT: 1_000}, {FLAT: 5_000, WAYS_AHEAD: 30_000, STEPS_AHEAD: 40_000}, (1,))
    assert told.endswith("sooner than `dqn`. As many random primitives in their place bring a greedy policy of half "
                         "the efficiency later with 1 button.")
    lines = [line for line in make_lines({FLAT: 9_000}, {FLAT: 50_000}) if line.agent not in (AHEAD, *RANDOM_AHEAD)]
    assert not tell_planning(STUDY, compare(STUDY, lines))


def search(at: dict[int, int | None], seeds: range = range(10)) -> list[SearcherRun]:
    return [SearcherRun(STUDY.data["searcher"], size, seed, escape) for size, escape in at.items() for seed in seeds]


def test_the_searcher_that_learns_nothing_is_told_beside_all_learners():
    lines = make_lines({FLAT: 9_000, EXPLORES: 10}, {FLAT: 50_000})  # there after some 40 primitives, of 30 needed
    count = len(OTHERS) + 2
    assert tell_searcher(STUDY, lines, search({1: 40, 2: 150})) == (
        "`search-nearest`, which chooses among planned options and learns nothing, first escapes with 1 button "
        f"after 40 primitives, at an efficiency of 0.75, and {count - 1} of {count} learners later; with 2 buttons "
        f"after 150 primitives, at an efficiency of 0.20, and {count - 1} of {count} learners later, 1 sooner.")
    other = [dataclasses.replace(line, searcher="search-backtrack") for line in search({1: 20, 2: 20})]
    assert not tell_searcher(STUDY, lines, other) and not tell_searcher(STUDY, lines, search({1: 40}))
    assert not tell_searcher(STUDY, lines, search({1: 40, 2: None})), "it did not escape within the league's budget"
    few = tell_searcher(STUDY, lines, search({1: 40, 2: 150}, range(3)))
    assert f"and 0 of {count} learners later" in few, "three rooms show nothing"


def test_the_headline_claims_what_the_sentences_below_claim():
    claimed = []
    for saved in np.linspace(1.0, 1.7, 15):  # from what cannot be shown to what can
        lines = make_lines({FLAT: 9_000}, {FLAT: 20_000, AHEAD: 20_000 / saved, EXPLORES: 20_000 / saved})
        found = compare(STUDY, lines)
        for pair in (pair for family in list_families(STUDY) for pair in family):
            told = conclude_prices(lines, [(each.one, each.other, cost) for family in list_families(STUDY)
                                           if pair in family for each in family for cost in (ESCAPE, HALF)])
            (said,) = [sentence for sentence in told if sentence.startswith("Until an efficiency of 0.5, ")
                       and f"`{pair.one}`" in sentence and f"`{pair.other}`" in sentence]
            gains = find_gains(found, *pair, HALF.name)
            claimed.append(bool(gains))
            assert ("times the primitives" in said) == claimed[-1], (pair, said)
    assert 5 < sum(claimed) < len(claimed) - 5


def test_advice_follows_what_each_part_brings():
    def advise_by(escapes, halves):
        return advise(STUDY, compare(STUDY, make_lines(escapes, halves)))

    both = advise_by({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000, EXPLORES: 20_000, WHOLE: 1_000})
    assert both.startswith("Let planned options explore") and both.endswith("what makes it efficient soon.")
    explored = advise_by({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000})
    assert explored.endswith("That is all that they were shown to give.")
    assert "exploration by them alone was not" in advise_by({FLAT: 9_000, WHOLE: 100}, {FLAT: 50_000, WHOLE: 1_000})
    assert advise_by({FLAT: 9_000}, {FLAT: 50_000}).startswith("Planned options were not shown to help")
    assert advise_by({FLAT: 9_000, AHEAD: 100}, {FLAT: 50_000}).startswith("Let a learner look ahead along planned")
    assert advise_by({FLAT: 9_000, EXPLORES: 100, AHEAD: 100}, {FLAT: 50_000}).endswith("along them helps, too.")
    alike = {FLAT: 9_000, AHEAD: 100, WAYS_AHEAD: 100}
    assert advise_by(alike, {FLAT: 50_000}).startswith("Planned options were not shown to help")
    assert advise_by(alike | {WHOLE: 100}, {FLAT: 50_000}).endswith("alone was not shown to help.")
    assert advise_by({FLAT: 9_000, WHOLE: 100, AHEAD: 100}, {FLAT: 50_000}).endswith("Planning along them helps, too.")
    every = advise_by({FLAT: 9_000, EXPLORES: 1_000, AHEAD: 100, WHOLE: 100}, {FLAT: 50_000})
    assert every.endswith("that is what makes it efficient soon. Planning along them helps, too.")


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
