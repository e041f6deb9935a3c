"""Options that need no planner, the runnable contract, and options that break it."""

from __future__ import annotations

import pytest

from hrl_escape.checks import check_option
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.observations.base import make_observer
from hrl_escape.errors import ContractError, OptionError
from hrl_escape.options.learned import LearnedOption
from hrl_escape.options.option import Option, ScriptedOption
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.route import PlanningReport


@pytest.fixture(scope="module")
def env():
    env = EscapeRoomEnv("paper-two-button")
    yield env
    env.close()


def test_a_script_runs_its_actions_in_order_and_keeps_its_own_count(env):
    wrapped = OptionsEnv(env, [ScriptedOption("some", [0, 4, 4, 2])], trace=True)
    wrapped.reset(seed=0)
    for _ in range(2):
        info = wrapped.step(6)[4]
        assert [step.action for step in info["trace"]] == [0, 4, 4, 2]
    check_option(ScriptedOption("some", [0, 4, 4, 2]), env)


def test_a_script_without_actions_is_refused():
    with pytest.raises(OptionError, match="at least one primitive"):
        ScriptedOption("none", [])


def test_a_learned_policy_sees_the_observation_it_was_trained_on(env):
    observer = make_observer("features", env.rules)
    seen = []

    def policy(observation):
        seen.append(observation)
        return 0 if observation[0] < 0.5 else 4

    option = LearnedOption("go east", policy, lambda state: float(state.x >= 5.0), observer.observe,
                           initiation=lambda state: state.x < 5.0)
    wrapped = OptionsEnv(env, [option])
    wrapped.reset(seed=0)
    info = wrapped.step(6)[4]
    assert info["duration"] == 5 and info["option"]["ended"] == "reached"
    assert all(env.observation_space.shape != o.shape for o in seen), "features, not the environment's own kind"
    assert [o[0] for o in seen] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert info["action_mask"][6] == 0, "it may not start where it ended"
    check_option(option, env)


def test_reports_of_nested_options_add_up():
    report = PlanningReport(1.0, 2, 1, 0, ("a",))
    report.add(PlanningReport(0.5, 1, 1, 3, ("b",)))
    assert report == PlanningReport(1.5, 3, 2, 3, ("a", "b"))


class _Base(Option):
    """A correct option that turns twice."""

    def start(self, state):
        super().start(state)
        self.turns = 0

    def policy(self, state):
        self.turns += 1
        return 4

    def termination(self, state):
        return float(self.turns >= 2)


class NoPrimitive(_Base):
    def policy(self, state):
        return 99


class NoProbability(_Base):
    def termination(self, state):
        return 1.5


class NoMemoryOfItsStart(_Base):
    """Goes on counting from the last run."""

    def start(self, state):
        self.report = PlanningReport()
        self.turns = getattr(self, "turns", 0)

    def policy(self, state):
        self.turns += 1
        return 4 if self.turns % 3 else 5


class NotMarkov(_Base):
    is_markov = True

    def policy(self, state):
        self.turns += 1
        return 4 if self.turns == 1 else 5


class Endless(_Base):
    def termination(self, state):
        return 0.0


class Moody(_Base):
    def initiation(self, state):
        self.mood = not getattr(self, "mood", False)
        return self.mood


class Bumping(_Base):
    """Says that it presses nothing, and drives into a button."""

    targets = ()

    def policy(self, state):
        self.turns += 1
        return 2

    def termination(self, state):
        return float(self.turns >= 12)


class Mixing(_Base):
    """Counts in a list that all runs share."""

    def __init__(self, name):
        super().__init__(name)
        self.counts = [0]

    def start(self, state):
        super().start(state)
        self.counts[0] = 0

    def policy(self, state):
        self.counts[0] += 1
        return self.counts[0] % 2

    def termination(self, state):
        return float(self.counts[0] >= 4)


def test_the_check_accepts_a_correct_option(env):
    check_option(_Base("base"), env)


@pytest.mark.parametrize(
    ("option", "claim"),
    [
        (NoPrimitive("x"), "the policy gives a primitive"),
        (NoProbability("x"), "termination gives a probability"),
        (NoMemoryOfItsStart("x"), "the same run"),
        (NotMarkov("x"), "is_markov"),
        (Mixing("x"), "a run does not change another one"),
        (Moody("x"), "initiation gives the same answer"),
        (Bumping("x"), "presses no target but its own"),
        (_Base(""), "the name is text"),
    ],
)
def test_the_check_finds_what_is_broken(env, option, claim):
    with pytest.raises(ContractError, match=claim):
        check_option(option, env)


def test_an_option_without_end_is_cut_by_the_horizon(env):
    wrapped = OptionsEnv(env, [Endless("endless")])
    wrapped.reset(seed=0)
    *_, truncated, info = wrapped.step(6)
    assert truncated and info["duration"] == 1000 and info["option"]["ended"] == "episode-over"
