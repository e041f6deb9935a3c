"""One list of options, given to several environments whose decisions take turns."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from hrl_escape import OptionsEnv
from hrl_escape.agents.agent import FixedPolicy
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import OptionError
from hrl_escape.options import FunctionOption, ScriptedOption
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.learned import make_learned_options
from hrl_escape.options.meta_actions import make_meta_options
from hrl_escape.options.option import Option
from tests.covering import thin


class Count(gymnasium.Env):
    """Notes what is done in it."""

    observation_space = gymnasium.spaces.Box(0, 100, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(10)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.done = []
        return self._show(), {}

    def step(self, action):
        self.done.append(int(action))
        return self._show(), 0.0, False, False, {}

    def _show(self):
        return np.array([len(self.done)], np.float32)


class Nested(Option):
    """One script, then another one."""

    def __init__(self, name, parts):
        super().__init__(name)
        self.parts = parts

    def start(self, state):
        super().start(state)
        self.left = list(self.parts)
        self.report.planner_calls += 1

    def policy(self, state):
        return self.left.pop(0)

    def termination(self, state):
        return float(not self.left)


SCRIPT = [1, 2, 3, 4]
KINDS = {
    "scripted": lambda: ScriptedOption("count", SCRIPT),
    "nested": lambda: Nested("count", [ScriptedOption("low", SCRIPT[:2]), ScriptedOption("high", SCRIPT[2:])]),
    "degraded": lambda: Wasting("count", ScriptedOption("count", SCRIPT)),
}


class Wasting(Option):
    """An option around another one, as `DegradedOption` is."""

    def __init__(self, name, inner):
        super().__init__(name)
        self.inner = inner

    def make_run(self):
        run = super().make_run()
        run.inner = self.inner.make_run()
        return run

    def start(self, state):
        super().start(state)
        self.inner.start(state)

    def policy(self, state):
        return self.inner.policy(state)

    def termination(self, state):
        return self.inner.termination(state)


def make(option, **arguments):
    env = OptionsEnv(Count(), [option], include_primitives=False, interruptible=True, **arguments)
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("order", thin(["abababab", "aabaabbb", "aaaabbbb", "abbbbaaa"], 2))
def test_an_option_runs_in_each_environment_as_if_it_were_alone(kind, order):
    option = kind()
    envs = {name: make(option) for name in "ab"}
    ended = {}
    for name in order:
        ended.setdefault(name, []).append(envs[name].step(0)[4]["option"]["ended"])
    assert [env.unwrapped.done for env in envs.values()] == [SCRIPT, SCRIPT]
    assert all(ended[name] == ["interrupted"] * 3 + ["reached"] for name in "ab")


def test_planning_counts_in_the_environment_that_ran_it():
    envs = [make(KINDS["nested"]()) for _ in range(2)]
    envs[1] = make(envs[0].options[0])
    def count(env):
        env.step(0)
        return env.planning_report.planner_calls

    calls = [[count(env) for env in envs] for _ in range(4)]
    assert calls == [[1, 1], [0, 0], [0, 0], [0, 0]]


@pytest.mark.parametrize("vector", [SyncVectorEnv, pytest.param(AsyncVectorEnv, marks=pytest.mark.nightly)])
def test_copies_in_a_vector_environment_share_options(vector):
    option = ScriptedOption("count", SCRIPT)
    envs = vector([lambda: OptionsEnv(Count(), [option], include_primitives=False, interruptible=True)] * 2)
    try:
        envs.reset(seed=0)
        for _ in SCRIPT:
            envs.step(np.zeros(2, int))
        assert list(envs.get_attr("done")) == [SCRIPT, SCRIPT]
    finally:
        envs.close()


def test_a_run_leaves_nothing_in_the_option():
    option = KINDS["nested"]()
    before = vars(option).copy()
    env = make(option)
    env.step(0)
    assert vars(option) == before and option.report.planner_calls == 0


@pytest.mark.parametrize("make_options", [
    lambda instance: make_meta_options(instance),
    lambda instance: make_meta_options(instance, "press-with-ancestors"),
    lambda instance: make_meta_options(instance, "press-reactive"),
    OptionDegradation(detour=3, seed=1),
], ids=["planned", "with ancestors", "markov", "degraded"])
def test_planned_options_of_a_room_may_run_in_two_rooms_at_once(make_options):
    def play(envs, order):
        for env in envs:
            env.reset(seed=3)
        seen = [[] for _ in envs]
        for which in order:
            action = envs[which].primitive_count + (1 if len(seen[which]) >= 9 else 0)
            observation, _, _, _, info = envs[which].step(action)
            seen[which].append((observation.tolist(), info["option"]["ended"]))
        return seen

    def build(options):
        return OptionsEnv(EscapeRoomEnv(instance=room), options, interruptible=True)

    room = EscapeRoomEnv("paper-two-button").instance
    alone = play([build(make_options(room))], [0] * 16)[0]
    options = make_options(room)
    assert play([build(options), build(options)], [0, 0, 1] * 8 + [1] * 8) == [alone, alone]


class Counting(FixedPolicy):
    """Does in its n-th decision of an episode what has the number n."""

    def act(self, observation, action_mask):
        raise NotImplementedError

    def act_greedy(self, observation, action_mask, rng):
        (count,) = self.recall(rng) or (0,)
        self._evaluation = rng, count + 1
        return count


def test_an_agent_that_remembers_serves_several_runs_of_its_policy():
    options = make_learned_options(Counting(), 10)
    envs = [make(options[0]) for _ in range(3)]
    for _ in range(9):
        for env in envs:
            env.step(0)
    assert [env.unwrapped.done for env in envs] == [list(range(9))] * 3


def test_a_run_of_its_policy_does_not_disturb_an_evaluation_of_the_agent():
    agent, rng, legal = Counting(), np.random.default_rng(0), np.ones(10, bool)
    env = make(make_learned_options(agent, 10)[0])
    chosen = []
    for _ in range(4):
        chosen.append(agent.act_greedy(None, legal, rng))
        env.step(0)
    assert chosen == env.unwrapped.done == [0, 1, 2, 3]


# --- terminations that are no probabilities -------------------------------------------------------


@pytest.mark.parametrize("beta", [np.nan, np.inf, -np.inf, 1.5, -0.5, -1e-9, "often", None])
def test_a_termination_outside_0_and_1_is_refused(beta):
    class Ends(ScriptedOption):
        def termination(self, state):
            return beta

    env = make(Ends("count", SCRIPT))
    with pytest.raises(OptionError, match="option 'count' ends in state .* a probability from 0 to 1"):
        env.step(0)


def test_so_is_that_of_an_option_which_only_agrees_with_a_primitive():
    odd = FunctionOption("odd", lambda state: 0, lambda state: 2.0)
    env = OptionsEnv(Count(), [odd], trace=True)
    env.reset(seed=0)
    with pytest.raises(OptionError, match="option 'odd' ends in state"):
        env.step(0)


@pytest.mark.parametrize("beta", [0, 1, True, False, np.float32(1), np.array(0.0)])
def test_a_truth_value_and_the_bounds_are_probabilities(beta):
    class Ends(ScriptedOption):
        def termination(self, state):
            return beta

    assert make(Ends("count", SCRIPT)).step(0)[4]["option"]["ended"] == ("reached" if beta else "interrupted")
