"""Options over options: environments of options above each other, and options that choose options."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit, TransformReward

from hrl_escape.agents import train
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import OptionError, PlanningFailed, PlanningReason, StepContractError
from hrl_escape.options.option import FunctionOption, Option, ScriptedOption
from hrl_escape.options.options_env import OptionsEnv
from tests.options.test_plain_envs import EAST, WEST, Corridor, go

GAMMA = 0.9


def make_levels(env=None, trace=True, **arguments):
    """Two steps east, or two west; above them: three times two steps east, then two west."""
    pairs = [ScriptedOption("two-east", [EAST] * 2), ScriptedOption("two-west", [WEST] * 2)]
    lower = OptionsEnv(env or Corridor(length=50), pairs, discount=GAMMA, trace=trace)
    there_and_back = ScriptedOption("there-and-back", [2, 2, 2, 3])
    return OptionsEnv(lower, [there_and_back], discount=GAMMA, trace=trace, **arguments)


def test_the_actions_below_are_the_primitives_above():
    env = make_levels()
    assert env.action_names == ("5", "6", "two-east", "two-west", "there-and-back")
    assert (env.level, env.primitive_count) == (1, 4)
    env.reset(seed=0)
    observation, _, _, _, info = env.step(2)
    assert observation == 2 and info["duration"] == 2 and info["option"]["name"] == "two-east"
    with pytest.raises(OptionError, match="name of a primitive"):
        OptionsEnv(env, [go("two-west")])


def test_durations_discounts_and_rewards_count_the_primitives_of_the_lowest_level():
    env = make_levels()
    env.reset(seed=0)
    observation, reward, _, _, info = env.step(4)
    assert observation == 4 and reward == -8 and info["duration"] == 8
    assert env.last_rewards == (-1.0,) * 8 and info["discount"] == pytest.approx(GAMMA**8)
    assert info["discounted_reward"] == pytest.approx(-(1 - GAMMA**8) / (1 - GAMMA))
    assert info["option"]["name"] == "there-and-back" and info["option"]["ended"] == "reached"


def test_three_levels_count_the_same_primitives():
    env = OptionsEnv(make_levels(), [ScriptedOption("twice", [4, 4])], discount=GAMMA, trace=True)
    env.reset(seed=0)
    observation, _, _, _, info = env.step(env.action_names.index("twice"))
    assert env.level == 2 and observation == 8 and info["duration"] == 16
    top = info["trace"]
    assert [step.name for step in top] == ["there-and-back"] * 2
    assert [step.name for step in top[1].trace] == ["two-east"] * 3 + ["two-west"]
    assert [step.name for step in top[1].trace[3].trace] == ["5", "5"]
    assert [step.next_state for step in top[1].trace[3].trace] == [9, 8]


def test_the_trace_has_each_levels_transitions_by_name():
    env = make_levels()
    env.reset(seed=0)
    trace = env.step(4)[4]["trace"]
    assert [(step.name, step.state, step.next_state, step.reward, len(step.rewards)) for step in trace] == [
        ("two-east", 0, 2, -2.0, 2), ("two-east", 2, 4, -2.0, 2), ("two-east", 4, 6, -2.0, 2),
        ("two-west", 6, 4, -2.0, 2)]
    assert [[lower.name for lower in step.trace] for step in trace] == [["6", "6"]] * 3 + [["5", "5"]]
    assert all(dict(step.consistent) == {step.action: 1.0} for step in trace), "a script is consistent with nothing"


def test_a_cap_of_the_lowest_level_cuts_every_level_at_once():
    env = make_levels(TimeLimit(Corridor(length=50), 5))
    env.reset(seed=0)
    observation, _, terminated, truncated, info = env.step(4)
    assert (observation, terminated, truncated) == (5, False, True)
    assert info["duration"] == 5 and info["discount"] == pytest.approx(GAMMA**5)
    assert info["option"]["ended"] == "episode-over" and len(info["trace"][-1].trace) == 1


def test_an_exit_inside_an_option_of_an_option_keeps_its_bonus():
    env = make_levels(Corridor(length=6))
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(4)
    assert terminated and reward == 5 and info["duration"] == 5
    assert info["discounted_reward"] == pytest.approx(-(1 - GAMMA**4) / (1 - GAMMA) + 9 * GAMMA**4)


def test_the_longest_duration_counts_primitives_and_no_decision_below_is_cut():
    env = make_levels(max_duration=3)
    env.reset(seed=0)
    *_, info = env.step(4)
    assert info["duration"] == 4 and info["option"]["ended"] == "timeout"


def test_interruption_above_is_after_each_decision_below():
    env = make_levels(interruptible=True)
    env.reset(seed=0)
    infos = [env.step(4)[4] for _ in range(4)]
    assert [info["duration"] for info in infos] == [2] * 4
    assert [info["option"]["ended"] for info in infos] == ["interrupted"] * 3 + ["reached"]
    assert [len(info["calls"]) for info in infos] == [0, 0, 0, 1]
    assert infos[3]["calls"][0].duration == 8, "one run of the option, over four decisions"


def test_what_is_masked_below_is_masked_above():
    lower = OptionsEnv(Corridor(), [go("far", start=lambda cell: cell > 4), go("near", to=5)],
                       include_primitives=False)
    env = OptionsEnv(lower, [ScriptedOption("both", [1, 0])])
    _, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [0, 1, 1]
    *_, info = env.step(1)
    assert info["action_mask"].tolist() == [1, 1, 1]


def test_a_step_below_that_hides_its_rewards_is_refused():
    class Hiding(Corridor):
        def step(self, action):
            observation, reward, terminated, truncated, info = super().step(action)
            return observation, reward, terminated, truncated, {**info, "duration": 3}

    env = OptionsEnv(Hiding(), [go()])
    env.reset(seed=0)
    with pytest.raises(StepContractError, match=r"of a step below OptionsEnv is 3, but info has neither"):
        env.step(2)


def test_levels_draw_from_streams_of_their_own():
    def draw(seen):
        return lambda state, rng: (seen.append(rng.random()), EAST)[1]

    below, above = [], []
    lower = OptionsEnv(Corridor(length=50), [FunctionOption("one", draw(below), lambda s: 1.0, is_stochastic=True)])
    env = OptionsEnv(lower, [FunctionOption("up", lambda s, rng: (above.append(rng.random()), 2)[1], lambda s: 1.0,
                                            is_stochastic=True)])
    env.reset(seed=7)
    for _ in range(3):
        env.step(3)
    assert len(below) == len(above) == 3 and not set(below) & set(above)


# --- options that choose options ----------------------------------------------------------------


class Sweep(Option):
    """Two scripts, one after the other."""

    def start(self, state):
        super().start(state)
        self.parts = [ScriptedOption("two-east", [EAST] * 2), ScriptedOption("one-west", [WEST])]

    def policy(self, state):
        return self.parts.pop(0)

    def termination(self, state):
        return float(not self.parts)


def test_runs_of_nested_options_are_transitions_of_their_levels():
    env = OptionsEnv(TransformReward(Corridor(length=50), lambda r: 2 * r), [Sweep("sweep")], discount=GAMMA,
                     trace=True)
    env.reset(seed=0)
    env.step(1)
    *_, info = env.step(2)
    assert [(call.name, call.level, call.state, call.next_state, call.duration, call.ended) for call in info["calls"]
            ] == [("two-east", 1, 1, 3, 2, "reached"), ("one-west", 1, 3, 2, 1, "reached"),
                  ("sweep", 0, 1, 2, 3, "reached")]
    assert info["calls"][2].rewards == info["rewards"] == (-2.0,) * 3
    assert [step.name for step in info["trace"]] == ["6", "6", "5"]


def test_a_cut_ends_every_running_option_as_it_ends_the_outermost():
    env = OptionsEnv(TimeLimit(Corridor(length=50), 1), [Sweep("sweep")], trace=True)
    env.reset(seed=0)
    calls = env.step(2)[4]["calls"]
    assert [(call.name, call.ended, call.duration) for call in calls] == [
        ("two-east", "episode-over", 1), ("sweep", "episode-over", 1)]


def test_a_lower_option_that_cannot_begin_ends_its_caller():
    class Lost(ScriptedOption):
        def start(self, state):
            raise PlanningFailed(PlanningReason.TIMEOUT, "nowhere", (0, 0, 0))

    env = OptionsEnv(Corridor(), [FunctionOption("outer", lambda s: Lost("lost", [EAST]), lambda s: 1.0)], trace=True)
    env.reset(seed=0)
    *_, info = env.step(2)
    assert info["option"]["ended"] == "planning-failed" and info["duration"] == 1
    assert [(call.name, call.duration) for call in info["calls"]] == [("lost", 1), ("outer", 1)]


# --- rooms and learners ---------------------------------------------------------------------------


def test_options_over_the_planned_options_of_a_room():
    lower = OptionsEnv(EscapeRoomEnv("paper-two-button"), discount=GAMMA)
    names = lower.action_names
    order = "press-button-1", "press-button-2", "go-to-exit"
    script = ScriptedOption("escape", [names.index(name) for name in order])
    env = OptionsEnv(lower, [script], discount=GAMMA, trace=True)
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(len(names))
    assert terminated and reward == 100 - info["duration"] and info["pressed"].tolist() == [1, 1]
    assert [step.name for step in info["trace"]] == list(names[6:9])
    assert info["duration"] == env.unwrapped.get_state().primitives
    assert not info["also_pressed"].any()
    with pytest.raises(OptionError, match="the actions below are options themselves"):
        OptionsEnv(lower)


@pytest.mark.parametrize("agent", ["smdp-q-learning+primitives", "smdp-intra-option-q+primitives"])
def test_agents_over_two_levels_learn_the_exact_values(agent):
    """Two cells a decision, or on to cell 4: each is worth what its primitives bring, discounted one by one."""
    lower = OptionsEnv(Corridor(length=7), [ScriptedOption("two-east", [EAST] * 2)], include_primitives=False,
                       discount=GAMMA)
    rest = FunctionOption("rest", lambda cell: 0, lambda cell: float(cell in (4, 6)))
    env = OptionsEnv(lower, [rest], discount=GAMMA, trace=True)
    settings = {"gamma": GAMMA, "learning_rate": 1.0, "epsilon_end": 1.0}
    result = train(agent, env, primitives=300, eval_episodes=0, settings=settings, progress=False)
    values = [sum(GAMMA**i * reward for i, reward in enumerate([-1.0] * (5 - cell) + [9.0])) for cell in (0, 2, 4)]
    learned = np.array([result.agent.compute_values(cell) for cell in (0, 2, 4)])
    np.testing.assert_allclose(learned, np.transpose([values] * 2), atol=1e-12)
