"""The SMDP wrapper against the contract: every trap that SMDP code falls into has a test that names it."""

from __future__ import annotations

import dataclasses
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation, RecordEpisodeStatistics, TimeLimit, TransformReward

from hrl_escape.agents.agent import make_transition
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import (
    ActionError,
    ConfigError,
    OptionError,
    PlanningFailed,
    PlanningReason,
    ResetNeededError,
    UnknownNameError,
    UnsupportedError,
)
from hrl_escape.options.learned import LearnedOption
from hrl_escape.options.option import Option, ScriptedOption
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.planner import get_planner

GAMMA = 0.9
FORWARD, BACK, LEFT, RIGHT, TURN_LEFT, TURN_RIGHT = range(6)


def make_wait(env: gymnasium.Env) -> list[Option]:
    """Options that a function of a module makes."""
    return [ScriptedOption("wait", [0])]


def test_a_spec_with_a_function_of_a_module_is_written_as_json_and_makes_the_environment_again():
    env = OptionsEnv(gymnasium.make("CartPole-v1"), make_wait)
    assert env.spec is not None
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.get_wrapper_attr("action_names")[-1] == "wait"


def make_env(horizon: int | None = None, name: str = "paper-one-button", **arguments) -> EscapeRoomEnv:
    config = get_preset(name)
    if horizon is not None:
        config = dataclasses.replace(config, horizon=horizon)
    return EscapeRoomEnv(config, **arguments)


def make_walk(length: int, name: str = "walk") -> ScriptedOption:
    """Turns on the spot, so that it always runs its whole length."""
    return ScriptedOption(name, [TURN_LEFT] * length)


def begin(env: gymnasium.Env, seed: int = 0) -> tuple:
    return env.reset(seed=seed)


class Failing(Option):
    """Plans, and fails."""

    def start(self, state):
        super().start(state)
        raise PlanningFailed(PlanningReason.TIMEOUT, "nowhere", (0, 0, 0))

    def policy(self, state):
        raise AssertionError

    def termination(self, state):
        return 0.0


class Never(ScriptedOption):
    """May start nowhere."""

    def initiation(self, state):
        return False


# --- the traps -----------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1, 3, 10])
def test_trap_1_a_k_step_option_is_worth_the_discounted_sum_of_its_rewards(length):
    env = OptionsEnv(make_env(), [make_walk(length)], discount=GAMMA)
    begin(env)
    _, reward, _, _, info = env.step(6)
    assert info["duration"] == length
    assert info["discounted_reward"] == pytest.approx(-(1 - GAMMA**length) / (1 - GAMMA))
    assert reward == -length, "the default reward is the paper's undiscounted sum"
    assert env.last_rewards == (-1.0,) * length and "rewards" not in info


def test_trap_1_discounted_reward_makes_the_reward_the_discounted_sum():
    env = OptionsEnv(make_env(), [make_walk(7)], discount=GAMMA, discounted_reward=True)
    begin(env)
    assert env.step(6)[1] == pytest.approx(-(1 - GAMMA**7) / (1 - GAMMA))


def test_trap_2_cutting_an_option_into_halves_does_not_change_the_value():
    whole = OptionsEnv(make_env(), [make_walk(10)], discount=GAMMA)
    begin(whole)
    info = whole.step(6)[4]
    value_of_rest = -3.7  # any value of the state reached
    expected = info["discounted_reward"] + info["discount"] * value_of_rest

    halves = OptionsEnv(make_env(), [make_walk(4, "a"), make_walk(6, "b")], discount=GAMMA)
    begin(halves)
    first, second = halves.step(6)[4], halves.step(7)[4]
    inner = second["discounted_reward"] + second["discount"] * value_of_rest
    assert first["discounted_reward"] + first["discount"] * inner == pytest.approx(expected)
    assert whole.unwrapped.get_state()[:6] == halves.unwrapped.get_state()[:6]


def test_trap_3_the_cap_inside_an_option_truncates_and_the_state_reached_is_returned():
    env = OptionsEnv(make_env(horizon=7), [make_walk(10)], discount=GAMMA)
    begin(env)
    observation, reward, terminated, truncated, info = env.step(6)
    assert (terminated, truncated) == (False, True)
    assert info["duration"] == 7 and reward == -7
    assert info["discount"] == pytest.approx(GAMMA**7), "a truncated state is bootstrapped from"
    assert info["option"]["ended"] == "episode-over"
    assert env.unwrapped.get_state().heading_steps == 7
    assert observation[3] == pytest.approx(np.radians(70), abs=1e-6)


@pytest.mark.parametrize(("horizon", "length", "cut"), [(1, 10, True), (7, 10, True), (7, 7, False), (1, 1, False)])
def test_trap_3_what_the_cap_stops_is_cut_and_what_ends_there_is_not(horizon, length, cut):
    env = OptionsEnv(make_env(horizon=horizon), [make_walk(length)], discount=GAMMA)
    observation, info = begin(env)
    transition = make_transition(observation, 6, info["action_mask"] > 0, env.step(6), GAMMA)
    assert transition.truncated and transition.duration == horizon and transition.cut == cut


def test_trap_4_an_exit_inside_an_option_keeps_the_bonus_and_ends_it():
    env = OptionsEnv(make_env(), [ScriptedOption("press and go on", [LEFT] * 9 + [RIGHT] * 20)], discount=GAMMA)
    begin(env)
    _, reward, terminated, truncated, info = env.step(6)
    assert terminated and not truncated and info["is_success"]
    k = info["duration"]
    assert k == 9, "the paper's best of this room: nine strafes, the press is inside the exit"
    assert env.unwrapped.get_state().primitives == 9, "nothing ran after the exit"
    assert reward == 100 - k
    assert info["discounted_reward"] == pytest.approx(-(1 - GAMMA**k) / (1 - GAMMA) + 100 * GAMMA ** (k - 1))
    with pytest.raises(ResetNeededError):
        env.step(6)


ORDERS = {
    "bare": lambda env, options: OptionsEnv(env, options),
    "limit inside": lambda env, options: OptionsEnv(TimeLimit(env, 1_000_000), options),
    "limit outside": lambda env, options: TimeLimit(OptionsEnv(env, options), 1_000_000),
    "statistics inside": lambda env, options: OptionsEnv(RecordEpisodeStatistics(env), options),
    "statistics outside": lambda env, options: RecordEpisodeStatistics(OptionsEnv(env, options)),
    "both": lambda env, options: TimeLimit(
        OptionsEnv(RecordEpisodeStatistics(TimeLimit(env, 1_000_000)), options), 1_000_000
    ),
}


@pytest.mark.parametrize("order", ORDERS)
def test_trap_5_the_cap_counts_primitives_under_any_order_of_wrappers(order):
    env = ORDERS[order](make_env(horizon=50), [make_walk(8)])
    begin(env)
    durations, truncated = [], False
    while not truncated:
        *_, truncated, info = env.step(6)
        durations.append(info["duration"])
    assert durations == [8] * 6 + [2]
    assert info["primitives"] == 50
    if "episode" in info:
        assert info["episode"]["r"] == -50


def test_trap_5_a_time_limit_below_counts_primitives_and_cuts_options():
    env = OptionsEnv(TimeLimit(make_env(), 5), [make_walk(8)])
    begin(env)
    *_, truncated, info = env.step(6)
    assert truncated and info["duration"] == 5


def test_trap_10_there_is_always_a_legal_action():
    env = OptionsEnv(make_env(), [Never("never", [0]), Never("ever", [0])], include_primitives=False)
    _, info = begin(env)
    for _ in range(5):
        mask = info["action_mask"]
        assert mask.any() and mask.dtype == np.int8
        *_, info = env.step(env.action_space.sample(mask))
        assert info["duration"] == 1 and info["option"]["ended"] == "planning-failed"


def test_trap_12_termination_is_asked_at_the_state_reached():
    """beta fires where the count of primitives is a multiple of 4: also at s, where it must not be asked."""
    option = LearnedOption("four", lambda observation: TURN_LEFT, lambda s: float(s.primitives % 4 == 0),
                           observe=lambda state: state)
    env = OptionsEnv(make_env(), [option])
    begin(env)
    assert [env.step(6)[4]["duration"] for _ in range(3)] == [4, 4, 4]
    env.step(0)
    assert env.step(6)[4]["duration"] == 3


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_trap_13_autoreset_does_not_replace_the_state_reached(mode):
    mode = gymnasium.vector.AutoresetMode(mode)

    def make():
        return OptionsEnv(make_env(horizon=7), [make_walk(10)], discount=GAMMA)

    env = gymnasium.vector.SyncVectorEnv([make] * 2, autoreset_mode=mode)
    env.reset(seed=0)
    observation, _, _, truncated, info = env.step(np.array([6, 0]))
    assert truncated.tolist() == [True, False]
    if mode is gymnasium.vector.AutoresetMode.SAME_STEP:
        reached, told = info["final_obs"][0], info["final_info"]
        assert observation[0][3] == 0.0, "the new episode's first observation"
    else:
        reached, told = observation[0], info
    assert reached[3] == pytest.approx(np.radians(70), abs=1e-6), "the state reached"
    assert told["duration"][0] == 7 and told["discount"][0] == pytest.approx(GAMMA**7)
    assert told["action_mask"][0].tolist() == [1] * 7


def test_trap_14_a_failed_plan_costs_one_primitive():
    env = OptionsEnv(make_env(horizon=5), [Failing("failing")], discount=GAMMA)
    begin(env)
    for count in range(1, 6):
        _, reward, _, truncated, info = env.step(6)
        assert (reward, info["duration"], info["discount"]) == (-1, 1, GAMMA)
        assert info["option"]["ended"] == "planning-failed" and "timeout" in info["option"]["reason"]
        assert env.unwrapped.get_state().primitives == count
    assert truncated, "no free self-loop: failing again and again runs out of time"


def test_trap_15_only_options_whose_policy_is_a_function_of_the_state_are_consistent():
    markov = LearnedOption("turner", lambda observation: TURN_LEFT, lambda s: 0.25 if s.heading_steps == 2 else 0.0,
                           observe=lambda state: state)
    env = OptionsEnv(make_env(), [make_walk(3), markov], trace=True)
    begin(env)
    *_, info = env.step(6)
    scripted, learned = 6, 7
    assert [step.action for step in info["trace"]] == [TURN_LEFT] * 3
    for step in info["trace"]:
        actions = dict(step.consistent)
        assert scripted not in actions, "a script depends on how far it has come, not on the state"
        assert actions[TURN_LEFT] == 1.0
        assert actions[learned] == (0.25 if step.next_state.heading_steps == 2 else 0.0), "beta at s'"


def test_trap_15_an_option_is_consistent_only_where_it_may_start():
    turner = LearnedOption("turner", lambda observation: TURN_LEFT, lambda s: 0.0, lambda s: s,
                           initiation=lambda s: s.heading_steps % 2 == 0)
    env = OptionsEnv(make_env(), [make_walk(4), turner], trace=True)
    begin(env)
    *_, info = env.step(6)
    assert [7 in dict(step.consistent) for step in info["trace"]] == [
        step.state.heading_steps % 2 == 0 for step in info["trace"]]
    assert {7 in dict(step.consistent) for step in info["trace"]} == {True, False}
    assert [bool(step.next_action_mask[7]) for step in info["trace"]] == [
        step.next_state.heading_steps % 2 == 0 for step in info["trace"]], "the mask is that of the state reached"


# --- one step is one transition ---------------------------------------------------------------


def test_the_trace_is_a_chain_from_the_state_before_to_the_state_reached():
    env = OptionsEnv(make_env(), trace=True)
    first, _ = begin(env)
    observation, reward, _, _, info = env.step(env.action_names.index("press-button-1"))
    trace = info["trace"]
    assert len(trace) == info["duration"] and sum(step.reward for step in trace) == reward
    np.testing.assert_array_equal(trace[0].observation, first)
    np.testing.assert_array_equal(trace[-1].next_observation, observation)
    np.testing.assert_array_equal(trace[-1].next_action_mask, info["action_mask"])
    for one, two in zip(trace, trace[1:], strict=False):
        assert one.next_state == two.state
        np.testing.assert_array_equal(one.next_observation, two.observation)
    rules = env.unwrapped.rules
    assert all(rules.step(step.state, step.action).state == step.next_state for step in trace)


def test_info_tells_what_ran_and_how_it_ended():
    env = OptionsEnv(make_env(name="paper-two-button"))
    _, info = begin(env)
    assert env.action_names[6:] == ("press-button-1", "press-button-2", "go-to-exit")
    *_, info = env.step(6)
    assert info["option"]["name"] == "press-button-1" and info["option"]["index"] == 6
    assert info["option"]["ended"] == "reached" and env.planning_report.planner_calls == 1
    assert env.planning_report.planner_seconds > 0 and info["also_pressed"].tolist() == [0, 0]
    assert info["pressed"].tolist() == [1, 0] and info["buttons_on"].tolist() == [1, 0]
    *_, info = env.step(TURN_LEFT)
    assert info["option"]["name"] == "turn-left" and info["option"]["ended"] == "reached"
    assert env.planning_report.planner_calls == 0 and info["duration"] == 1


def test_a_plan_made_before_comes_from_the_cache():
    env = OptionsEnv(make_env(name="paper-two-button"))
    calls = []
    for _ in range(2):
        begin(env)
        env.step(6)
        calls.append(env.planning_report)
    assert [call.planner_calls for call in calls] == [1, 1]
    assert calls[1].cache_hits == 1 and env.planning_total.cache_hit_rate >= 0.5


def test_the_observation_after_an_option_is_that_of_the_flat_environment():
    flat, env = make_env(), OptionsEnv(make_env(), [ScriptedOption("some", [0, 4, 2, 0])])
    begin(flat)
    begin(env)
    for action in (0, 4, 2, 0):
        observation, *_ = flat.step(action)
    np.testing.assert_array_equal(env.step(6)[0], observation)
    assert env.unwrapped.get_state() == flat.get_state()


def test_wrappers_below_see_every_primitive():
    env = OptionsEnv(TransformReward(FlattenObservation(make_env()), lambda reward: 2 * reward), [make_walk(5)])
    begin(env)
    assert env.step(6)[1] == -10


def test_nested_options_run_to_their_end_before_the_outer_policy_is_asked_again():
    class Twice(Option):
        def start(self, state):
            super().start(state)
            self.left = 2

        def policy(self, state):
            self.left -= 1
            return make_walk(3, "inner")

        def termination(self, state):
            return float(self.left == 0)

    class Outermost(Twice):
        def policy(self, state):
            self.left -= 1
            return Twice("middle")

    env = OptionsEnv(make_env(), [Outermost("outer")])
    begin(env)
    info = env.step(6)[4]
    assert info["duration"] == 12 and info["option"]["ended"] == "reached"


@pytest.mark.parametrize("length", [1, 5], ids=["ended", "cut by the episode"])
def test_planning_of_a_nested_option_is_told_by_the_option_that_called_it(length):
    class Planning(ScriptedOption):
        def start(self, state):
            super().start(state)
            self.report.planner_calls += 3
            self.report.cache_hits += 1

    class Caller(Option):
        def start(self, state):
            super().start(state)
            self.report.planner_calls += 1
            self.left = 2

        def policy(self, state):
            self.left -= 1
            return Planning("inner", [TURN_LEFT] * length)

        def termination(self, state):
            return float(self.left == 0)

    env = OptionsEnv(make_env(horizon=4), [Caller("outer")])
    begin(env)
    env.step(6)
    calls = 7 if length == 1 else 4
    assert (env.planning_report.planner_calls, env.planning_report.cache_hits) == (calls, calls // 3)
    assert env.planning_report.cache_hit_rate == (calls // 3) / calls


class PlansTwice(ScriptedOption):
    """Plans twice at its start, once from the cache, and walks."""

    def start(self, state):
        super().start(state)
        self.report.planner_calls += 2
        self.report.cache_hits += 1


def test_the_caches_hit_rate_is_over_all_calls_of_the_environment():
    class PlansAnew(ScriptedOption):
        def start(self, state):
            super().start(state)
            self.report.planner_calls += 2

    env = OptionsEnv(make_env(), [PlansTwice("known", [TURN_LEFT]), PlansAnew("new", [TURN_LEFT])])
    begin(env)
    rates = []
    for action in (6, 7, 7, 6):
        env.step(action)
        rates.append(env.planning_total.cache_hit_rate)
    assert rates == [1 / 2, 1 / 4, 1 / 6, 2 / 8]


def test_planning_of_a_nested_option_is_told_while_it_still_runs():
    class Caller(Option):
        def policy(self, state):
            return PlansTwice("inner", [TURN_LEFT] * 3)

        def termination(self, state):
            return 0.0

    env = OptionsEnv(make_env(), [Caller("outer")], interruptible=True)
    begin(env)
    calls = []
    for _ in range(5):
        assert env.step(6)[4]["option"]["ended"] == "interrupted"
        calls.append(env.planning_report.planner_calls)
        assert env.planning_total.cache_hit_rate == 0.5
    assert calls == [2, 0, 0, 2, 0], "each plan is reported once, when it is made"


def test_endless_nesting_is_an_error():
    class Endless(Option):
        def policy(self, state):
            return self

        def termination(self, state):
            return 0.0

    env = OptionsEnv(make_env(), [Endless("endless")])
    begin(env)
    with pytest.raises(OptionError, match="nests deeper"):
        env.step(6)


@pytest.mark.parametrize("arguments", [{"domain": "x"}, {"domain": lambda env: 3}, {"options": 5}])
def test_what_is_no_domain_and_no_list_of_options_is_refused(arguments):
    with pytest.raises((ConfigError, OptionError), match="OptionsEnv.domain|give a list of options"):
        OptionsEnv(EscapeRoomEnv(config="paper-two-button"), **arguments)


def test_max_duration_ends_an_option():
    env = OptionsEnv(make_env(), [make_walk(10)], max_duration=4)
    begin(env)
    *_, info = env.step(6)
    assert info["duration"] == 4 and info["option"]["ended"] == "timeout"
    assert env.step(6)[4]["duration"] == 4, "it starts anew"


@pytest.mark.nightly
def test_stochastic_termination_obeys_its_probability_and_the_seed():
    option = LearnedOption("geometric", lambda observation: TURN_LEFT, lambda s: 0.25, observe=lambda s: s)

    def draw(seed):
        env = OptionsEnv(make_env(horizon=5000), [option])
        begin(env, seed)
        return [env.step(6)[4]["duration"] for _ in range(500)]

    assert draw(3) == draw(3) != draw(4)
    assert np.mean(draw(3)) == pytest.approx(4, abs=4 * np.sqrt(12 / 500))


# --- interruption -------------------------------------------------------------------------------


def test_interruptible_options_return_after_every_primitive_and_continue_when_chosen_again():
    env = OptionsEnv(make_env(), [make_walk(3), make_walk(2, "other")], interruptible=True)
    begin(env)
    ends = [env.step(6)[4] for _ in range(4)]
    assert [info["duration"] for info in ends] == [1] * 4
    assert [info["option"]["ended"] for info in ends] == ["interrupted", "interrupted", "reached", "interrupted"]
    env.step(7)
    assert env.step(6)[4]["option"]["ended"] == "interrupted", "another option dropped the first: it begins anew"
    assert env.step(6)[4]["option"]["ended"] == "interrupted"
    assert env.step(6)[4]["option"]["ended"] == "reached"


def test_an_option_that_runs_may_go_on_where_it_could_not_start():
    class AtFirst(ScriptedOption):
        def initiation(self, state):
            return state.primitives == 0

    env = OptionsEnv(make_env(), [AtFirst("once", [TURN_LEFT] * 3)], interruptible=True)
    begin(env)
    assert env.step(6)[4]["action_mask"][6] == 1
    assert env.step(TURN_RIGHT)[4]["action_mask"][6] == 0, "dropped, and it cannot start again"


def test_interruptible_max_duration_counts_over_steps():
    env = OptionsEnv(make_env(), [make_walk(10)], interruptible=True, max_duration=3)
    begin(env)
    assert [env.step(6)[4]["option"]["ended"] for _ in range(4)] == ["interrupted", "interrupted", "timeout",
                                                                      "interrupted"]


def test_interrupted_meta_action_reaches_the_same_state_as_in_one_go():
    whole, steps = OptionsEnv(make_env()), OptionsEnv(make_env(), interruptible=True)
    begin(whole)
    begin(steps)
    duration = whole.step(6)[4]["duration"]
    ended = [steps.step(6)[4]["option"]["ended"] for _ in range(duration)]
    assert ended == ["interrupted"] * (duration - 1) + ["reached"]
    assert whole.unwrapped.get_state() == steps.unwrapped.get_state()


# --- actions, masks, observations ------------------------------------------------------------------


def test_masks_are_valid_for_sampling_and_hide_what_cannot_start():
    env = OptionsEnv(make_env(), [Never("never", [0]), make_walk(2)])
    _, info = begin(env)
    assert info["action_mask"].tolist() == [1] * 6 + [0, 1]
    assert info["action_mask"].dtype == np.int8
    env.action_space.seed(0)
    assert {env.action_space.sample(info["action_mask"]) for _ in range(200)} == {0, 1, 2, 3, 4, 5, 7}


def test_a_masked_option_costs_one_primitive_when_chosen_all_the_same():
    env = OptionsEnv(make_env(), [Never("never", [0])])
    begin(env)
    *_, info = env.step(6)
    assert info["duration"] == 1 and info["option"]["ended"] == "planning-failed"
    assert "masked" in info["option"]["reason"]


def test_numbers_and_names_stay_when_rooms_are_resampled():
    env = OptionsEnv(make_env(name="four-button-chain", resample_instance=True))
    names, rooms = env.action_names, set()
    for seed in range(3):
        begin(env, seed)
        rooms.add(env.unwrapped.instance.id)
        assert env.step(env.action_names.index("press-button-1"))[4]["pressed"][0] == 1
        assert env.action_names == names
    assert len(rooms) == 3


def test_options_made_for_another_room_are_refused():
    from hrl_escape.options.meta_actions import make_meta_options

    options = make_meta_options(generate(get_preset("four-button-chain"), 5))
    with pytest.raises(OptionError, match="was made for room"):
        OptionsEnv(make_env(name="four-button-chain"), options)


def test_without_primitives_the_options_are_numbered_from_zero():
    env = OptionsEnv(make_env(), include_primitives=False)
    assert env.action_names == ("press-button-1", "go-to-exit") and env.action_space.n == 2
    begin(env)
    *_, terminated, _, info = env.step(0)
    assert terminated and info["duration"] == 9


def test_option_features_are_appended_to_the_observation():
    env = OptionsEnv(make_env(), [make_walk(3), Never("never", [0])], observation="options", interruptible=True)
    flat = make_env()
    observation, _ = begin(env)
    first, _ = begin(flat)
    np.testing.assert_array_equal(observation, [*first, 1, 0, 0, 0])
    observation, *_ = env.step(6)
    assert observation[-4:].tolist() == [1, 0, 1, 0], "walk is running"
    assert env.observation_space.contains(observation)
    with pytest.raises(UnsupportedError, match="flat Box"):
        OptionsEnv(make_env(observation="pixels"), [make_walk(3)], observation="options")


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"discount": 1.5}, ConfigError),
        ({"max_duration": 0}, ConfigError),
        ({"observation": "state"}, ConfigError),
        ({"option_set": "push"}, UnknownNameError),
        ({"options": [make_walk(1), make_walk(2)]}, OptionError),
        ({"options": [], "include_primitives": False}, OptionError),
    ],
)
def test_impossible_arguments_are_refused(arguments, error):
    with pytest.raises(error):
        OptionsEnv(make_env(), **arguments)


def test_an_environment_that_is_no_room_comes_without_options():
    with pytest.raises(UnsupportedError, match="is not a room, so there are no planned options"):
        OptionsEnv(gymnasium.make("CartPole-v1"))


@pytest.mark.parametrize("action", [-1, 9, 1.5, "press-button-1"])
def test_an_action_outside_the_space_is_refused(action):
    env = OptionsEnv(make_env(name="paper-two-button"))
    begin(env)
    with pytest.raises(ActionError):
        env.step(action)


@pytest.mark.parametrize("primitive", [7, -1, 2.5, "forward"])
def test_an_option_that_chooses_no_primitive_of_the_room_is_named(primitive):
    """The innermost one, which chose it."""
    class Outer(Option):
        def policy(self, state):
            return ScriptedOption("inner", [TURN_LEFT, primitive])

        def termination(self, state):
            return 0.0

    env = OptionsEnv(make_env(), [Outer("outer")])
    begin(env)
    with pytest.raises(OptionError, match=rf"^option 'inner' chose no action of Discrete\(6\): {primitive!r}$"):
        env.step(6)


def test_stepping_before_reset_is_refused():
    with pytest.raises(ResetNeededError):
        OptionsEnv(make_env(), [make_walk(1)]).step(0)


# --- with Gymnasium ----------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [{}, {"observation": "options"}, {"interruptible": True, "trace": True}])
def test_gymnasium_finds_nothing_wrong(arguments):
    check_env(OptionsEnv(make_env(name="paper-two-button"), **arguments), skip_render_check=True)


def test_vector_environments_run_options_in_step():
    def make():
        return OptionsEnv(make_env(name="paper-two-button"))

    env = gymnasium.vector.SyncVectorEnv([make] * 3)
    _, info = env.reset(seed=[1, 2, 3])
    assert info["action_mask"].shape == (3, 9)
    *_, info = env.step(np.array([0, 6, 7]))
    assert info["duration"][0] == 1 and info["duration"][1] > 1
    assert info["option"]["name"].tolist() == ["forward", "press-button-1", "press-button-2"]
    env.close()


@pytest.mark.nightly
def test_asynchronous_vector_environments_give_the_same():
    def make():
        return OptionsEnv(make_env(), discount=GAMMA)

    answers = []
    for vector in (gymnasium.vector.SyncVectorEnv, gymnasium.vector.AsyncVectorEnv):
        env = vector([make] * 2)
        env.reset(seed=[1, 2])
        observation, reward, _, _, info = env.step(np.array([7, 6]))
        answers.append((observation.tolist(), reward.tolist(), info["duration"].tolist(), info["discount"].tolist()))
        env.close()
    assert answers[0] == answers[1]


def test_the_same_seed_gives_the_same_episode():
    def play():
        config = get_preset("paper-two-button")
        config = dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, noise=0.1, slip=0.1))
        env = OptionsEnv(EscapeRoomEnv(config))
        _, info = begin(env, 5)
        env.action_space.seed(5)
        seen = []
        for _ in range(15):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
            seen.append((observation.tolist(), reward, info["duration"], info["option"]["ended"]))
            if terminated or truncated:
                break
        return seen

    assert play() == play()


def test_a_trace_survives_pickling():
    env = OptionsEnv(make_env(), [make_walk(2)], trace=True)
    begin(env)
    trace = env.step(6)[4]["trace"]
    copy = pickle.loads(pickle.dumps(trace))  # our own bytes, made here
    assert [step.state for step in copy] == [step.state for step in trace]


@pytest.mark.parametrize("name", [name for name in gymnasium.registry if name.startswith("hrl_escape/")
                                  and name.endswith("Options-v1")][::7])
def test_environments_over_options_pickle_within_an_episode_and_go_on_alike(name):
    env = gymnasium.make(name)
    _, info = env.reset(seed=1)
    env.step(int(np.flatnonzero(info["action_mask"])[0]))
    copy = pickle.loads(pickle.dumps(env))  # our own bytes, made here
    action = int(np.flatnonzero(info["action_mask"])[1])
    for (one, *rest), (other, *same) in [(env.step(action), copy.step(action))]:
        assert np.array_equal(one, other) and rest[:3] == same[:3]
    env.close()
    copy.close()


def list_keys(info):
    return {name: sorted(value) if isinstance(value, dict) else type(value) for name, value in info.items()}


@pytest.mark.parametrize("tracing", [False, True])
def test_a_reset_tells_the_keys_of_a_step_of_a_decision_in_which_nothing_ran(tracing):
    env = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", trace=tracing)
    _, begun = env.reset(seed=0)
    _, _, _, _, stepped = env.step(env.unwrapped.action_space.n)  # the first option
    assert list_keys(begun) == list_keys(stepped)
    assert [begun[name] for name in ("duration", "discount", "summed_reward", "discounted_reward")] == [0, 1.0, 0, 0]
    assert begun.get("rewards") == (() if tracing else None)
    assert begun["option"] == {"index": -1, "name": "", "ended": "", "reason": ""}
    assert not begun["pressed"].any() and begun["pressed"].shape == stepped["pressed"].shape
    assert stepped["option"]["index"] == 6 and stepped["duration"] > 1


def test_pressed_means_the_same_in_the_flat_room_under_options_and_in_the_batch():
    flat = gymnasium.make("hrl_escape/PaperTwoButton-v1")
    options = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1")
    batch = gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=1)
    _, flat_info = flat.reset(seed=3)
    _, info = options.reset(seed=3)
    _, batch_info = batch.reset(seed=[3])
    for meta in (6, 7):
        assert info["pressed"].tolist() == batch_info["pressed"][0].tolist()
        assert info["pressed"].dtype == flat_info["pressed"].dtype == batch_info["pressed"].dtype == np.int8
        plan = get_planner(options.unwrapped.instance).plan(options.unwrapped.get_state(), f"press-button-{meta - 5}")
        _, _, _, _, info = options.step(meta)
        _, _, _, _, batch_info = batch.step([meta])
        seen = np.zeros(2, np.int8)
        for primitive in plan.primitives:
            _, _, _, _, flat_info = flat.step(primitive)
            seen |= flat_info["pressed"]
        assert info["pressed"].tolist() == seen.tolist() and seen[meta - 6] == 1
    assert info["pressed"].tolist() == batch_info["pressed"][0].tolist()
