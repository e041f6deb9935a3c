"""`OptionsEnv` over environments that are no rooms: the SMDP contract, whatever observes and whatever acts."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import TimeLimit

from hrl_escape.checks import check_option
from hrl_escape.errors import ContractError, OptionError, ResetNeededError, StepContractError, UnsupportedError
from hrl_escape.options.domain import OptionDomain
from hrl_escape.options.option import FunctionOption, Option, ScriptedOption, TableOption
from hrl_escape.options.options_env import OptionsEnv

GAMMA = 0.9
LEFT, DOWN, RIGHT, UP = range(4)


class Corridor(gymnasium.Env):
    """A stranger's environment: cells 0 to 9 under numbers from 5, -1 a move, +10 and the end in cell 9.

    Args:
        mask: `info["action_mask"]` forbids moves into the wall.
    """

    def __init__(self, mask: bool = False, length: int = 10) -> None:
        self.observation_space = spaces.Discrete(length)
        self.action_space = spaces.Discrete(2, start=5)
        self.mask, self.last = mask, length - 1

    def _inform(self):
        return {"action_mask": np.array([self.cell > 0, 1], np.int8)} if self.mask else {}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.cell = 0
        return self.cell, self._inform()

    def step(self, action):
        assert self.action_space.contains(action), action
        self.cell = max(0, self.cell + 2 * (action - 5) - 1)
        ended = self.cell == self.last
        return self.cell, 9.0 if ended else -1.0, ended, False, self._inform()


WEST, EAST = 5, 6


def go(name="go", to=9, action=EAST, start=None):
    return FunctionOption(name, lambda cell: action, lambda cell: float(cell == to), start)


# --- environments of every kind ------------------------------------------------------------


def make_minigrid():
    pytest.importorskip("minigrid")
    return gymnasium.make("MiniGrid-Empty-5x5-v0")


class ForwardDomain(OptionDomain):
    """MiniGrid: options see whether the way is free."""

    action_names = ("left", "right", "forward", "pickup", "drop", "toggle", "done")

    def get_state(self, observation):
        grid = self.env.unwrapped
        cell = grid.grid.get(*grid.front_pos)
        return cell is None or cell.can_overlap()


KINDS = {
    "FrozenLake": (lambda: gymnasium.make("FrozenLake-v1", is_slippery=False),
                   lambda: FunctionOption("down", lambda cell: DOWN, lambda cell: float(cell >= 8)), None, 4),
    "Taxi": (lambda: gymnasium.make("Taxi-v4" if "Taxi-v4" in gymnasium.registry else "Taxi-v3"),
             lambda: FunctionOption("north", lambda s: 1, lambda s: float(s // 100 == 0)), None, 6),
    "CartPole": (lambda: gymnasium.make("CartPole-v1"),
                 lambda: FunctionOption("lean", lambda s: int(s[2] + 0.3 * s[3] > 0), lambda s: 0.02), None, 2),
    "Pendulum": (lambda: gymnasium.make("Pendulum-v1"),
                 lambda: FunctionOption("damp", lambda s: np.clip(-s[2:], -2, 2), lambda s: 0.02), None, 0),
    "MiniGrid": (make_minigrid, lambda: FunctionOption("run", lambda free: 2, lambda free: float(not free)),
                 ForwardDomain, 7),
    "stranger": (Corridor, go, None, 2),
}


@pytest.mark.parametrize("kind", KINDS)
def test_one_step_is_one_transition_of_the_primitives_it_ran(kind):
    make, make_option, domain, primitives = KINDS[kind]
    env, flat = OptionsEnv(make(), [make_option()], discount=GAMMA, trace=True, domain=domain), make()
    assert env.primitive_count == primitives and env.action_space.n == primitives + 1
    first, info = env.reset(seed=4)
    flat.reset(seed=4)
    assert "pressed" not in info and info["action_mask"].shape == (primitives + 1,)
    observation, reward, terminated, truncated, info = env.step(primitives)
    assert info["option"]["ended"] in ("reached", "episode-over")
    assert info["duration"] == len(info["trace"]) == len(info["rewards"]) >= 2
    assert info["discount"] == pytest.approx(GAMMA ** info["duration"])
    assert info["discounted_reward"] == pytest.approx(sum(r * GAMMA**i for i, r in enumerate(info["rewards"])))
    assert reward == pytest.approx(sum(info["rewards"]))
    for step in info["trace"]:  # the same primitives one by one
        seen, paid, ended, cut, _ = flat.step(step.action)
        assert paid == step.reward
        assert repr(seen) == repr(step.next_observation)
    assert (ended, cut) == (terminated, truncated) and repr(seen) == repr(observation)
    assert repr(info["trace"][0].observation) == repr(first)


@pytest.mark.parametrize("kind", ["FrozenLake", "CartPole", "Pendulum"])
def test_gymnasium_finds_nothing_wrong(kind):
    make, make_option, domain, _ = KINDS[kind]
    check_env(OptionsEnv(make(), [make_option()], domain=domain), skip_render_check=True)


def test_the_adapter_names_primitives_and_says_what_options_see():
    env = OptionsEnv(make_minigrid(), [KINDS["MiniGrid"][1]()], domain=ForwardDomain, trace=True)
    env.reset(seed=0)
    *_, info = env.step(env.action_names.index("run"))
    assert [step.name for step in info["trace"]] == ["forward", "forward"], "from the corner to the wall, 5 by 5"
    assert [step.next_state for step in info["trace"]] == [True, False]


def test_numbers_of_primitives_need_not_begin_at_zero():
    env = OptionsEnv(Corridor(), [go(to=3)], trace=True)
    assert env.action_names == ("5", "6", "go")
    env.reset(seed=0)
    assert env.step(1)[0] == 1, "the second choice is the primitive 6, east"
    *_, info = env.step(2)
    assert [step.action for step in info["trace"]] == [EAST] * 2
    assert all(dict(step.consistent)[1] == 1.0 for step in info["trace"]), "consistent by choice, not by number"


def test_continuous_actions_are_for_options_alone():
    class Torque(Option):
        is_markov = True

        def policy(self, state):
            return [0.5]

        def termination(self, state):
            return 1.0

    env = OptionsEnv(gymnasium.make("Pendulum-v1"), [Torque("a"), Torque("b")], trace=True)
    env.reset(seed=0)
    *_, info = env.step(0)
    assert env.action_names == ("a", "b")
    step = info["trace"][0]
    assert step.action.dtype == np.float32 and step.action.tolist() == [0.5] and step.name == ""
    assert step.consistent == ((0, 1.0), (1, 1.0)), "both would have done the same"
    with pytest.raises(OptionError, match="nothing to choose"):
        OptionsEnv(gymnasium.make("Pendulum-v1"), [])


# --- the traps, where no room is ---------------------------------------------------------


def test_a_cap_inside_an_option_truncates_and_an_exit_ends():
    env = OptionsEnv(TimeLimit(Corridor(), 4), [go()], discount=GAMMA)
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(2)
    assert (observation, reward, terminated, truncated) == (4, -4, False, True)
    assert info["duration"] == 4 and info["discount"] == pytest.approx(GAMMA**4)
    assert info["option"]["ended"] == "episode-over"
    env = OptionsEnv(Corridor(), [go(to=None)], discount=GAMMA)
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(2)
    assert terminated and not truncated and info["duration"] == 9 and info["option"]["ended"] == "episode-over"
    assert info["discounted_reward"] == pytest.approx(-(1 - GAMMA**9) / (1 - GAMMA) + 10 * GAMMA**8)
    with pytest.raises(ResetNeededError):
        env.step(2)


def test_a_masked_option_costs_the_first_legal_primitive():
    env = OptionsEnv(Corridor(mask=True), [go(start=lambda cell: cell > 3)])
    _, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [0, 1, 0], "the environment's own mask, and the initiation set"
    assert env.action_masks().tolist() == [False, True, False]
    observation, reward, _, _, info = env.step(2)
    assert (observation, reward, info["duration"]) == (1, -1, 1)
    assert info["option"]["ended"] == "planning-failed" and info["action_mask"].tolist() == [1, 1, 0]


def test_a_masked_option_costs_no_torque_where_actions_are_continuous():
    env = OptionsEnv(gymnasium.make("Pendulum-v1"), [FunctionOption("no", lambda s: [1.0], lambda s: 1.0,
                                                                    lambda s: False)], trace=True)
    env.reset(seed=0)
    *_, info = env.step(0)
    assert info["duration"] == 1 and info["trace"][0].action.tolist() == [0.0]
    assert info["action_mask"].tolist() == [1], "nothing can start: any choice costs one primitive"


def test_a_mask_of_another_length_is_refused():
    class Masked(Corridor):
        def _inform(self):
            return {"action_mask": np.ones(7, np.int8)}

    with pytest.raises(StepContractError, match=r"shape \(7,\); the action space needs \(2,\)"):
        OptionsEnv(Masked(), [go()]).reset(seed=0)


def test_interruption_and_longest_duration():
    env = OptionsEnv(Corridor(), [go(), go("west", to=0, action=WEST)], interruptible=True, max_duration=3)
    env.reset(seed=0)
    ends = [env.step(action)[4]["option"]["ended"] for action in (2, 2, 2, 2, 3, 3)]
    assert ends == ["interrupted", "interrupted", "timeout", "interrupted", "interrupted", "interrupted"]
    whole = OptionsEnv(Corridor(), [go()], max_duration=3)
    whole.reset(seed=0)
    assert [whole.step(2)[4]["duration"] for _ in range(3)] == [3, 3, 3]


def test_terminations_and_stochastic_policies_follow_the_seed_of_the_reset():
    def draw(rng_cell, rng):
        return EAST if rng.random() < 0.7 else WEST

    def play(seed, again=None):
        env = OptionsEnv(Corridor(length=1000), [FunctionOption("walk", draw, lambda cell: 0.1, is_stochastic=True)],
                         trace=True)
        env.reset(seed=seed)
        env.reset(seed=again) if again is not None else None
        return [step.action for _ in range(30) for step in env.step(2)[4]["trace"]]

    actions = play(3)
    assert actions == play(3) == play(8, again=3) != play(4)
    assert np.mean(np.array(actions) == EAST) == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / len(actions)))
    assert len(actions) == pytest.approx(300, abs=4 * np.sqrt(90 * 30))


def test_taking_over_an_episode_that_runs():
    flat = Corridor(mask=True)
    env = OptionsEnv(flat, [go(to=5)], trace=True)
    _, info = flat.reset(seed=0)
    assert env.resume(0, info).tolist() == [0, 1, 1]
    observation, _, _, _, info = env.step(2)
    assert observation == 5 and info["trace"][0].observation == 0


# --- what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize(("options", "error", "message"), [
    (None, UnsupportedError, "not a room, so there are no planned options"),
    ([lambda cell: EAST], OptionError, "is not an Option"),
    ([go("5")], OptionError, "name of a primitive"),
    ([go(), go()], OptionError, "names must differ"),
])
def test_impossible_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        OptionsEnv(Corridor(), options)


@pytest.mark.parametrize("action", [0, 7, 5.5, "east", None])
def test_an_option_that_chooses_no_action_of_the_environment_is_refused(action):
    env = OptionsEnv(Corridor(), [go(action=action)])
    env.reset(seed=0)
    with pytest.raises(OptionError, match=r"^option 'go' chose no action of Discrete\(2, start=5\): "):
        env.step(2)


def test_an_option_that_chooses_a_vector_of_another_size_is_refused():
    env = OptionsEnv(gymnasium.make("Pendulum-v1"), [ScriptedOption("push", [[0.5, 0.5]])])
    env.reset(seed=0)
    with pytest.raises(OptionError, match=r"^option 'push' chose no action of Box.*shape is \(1,\): .* of \(2,\)"):
        env.step(0)


def test_an_option_made_for_a_room_is_refused():
    option = go()
    option.instance = type("Room", (), {"id": "abc"})()
    with pytest.raises(OptionError, match="was made for room abc, this one is no room"):
        OptionsEnv(Corridor(), [option])


# --- options from tables ----------------------------------------------------------------------


def test_tables_say_where_to_start_what_to_do_and_when_to_end():
    option = TableOption("middle", {cell: EAST for cell in range(2, 5)}, {2: 0.0, 3: 0.0, 4: 0.0})
    env = OptionsEnv(Corridor(), [option], trace=True)
    _, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [1, 1, 0], "no entry: it may not start"
    env.step(1)
    *_, info = env.step(1)
    assert info["action_mask"][2] == 1
    observation, _, _, _, info = env.step(2)
    assert observation == 5 and info["duration"] == 3, "and it ends where it has no entry"
    assert dict(info["trace"][0].consistent)[2] == 0.0 and dict(info["trace"][2].consistent)[2] == 1.0


def test_tables_of_probabilities_are_drawn_from_and_are_markov_only_if_certain():
    rows = np.array([[0.0, 1.0], [0.25, 0.75], [0.0, 0.0]])
    option = TableOption("drift", rows, [0, 0, 1])
    rng = np.random.default_rng(0)
    assert not option.is_markov and [option.initiation(s) for s in range(3)] == [True, True, False]
    assert np.mean([option.sample_action(1, rng) for _ in range(2000)]) == pytest.approx(0.75, abs=0.04)
    assert option.sample_action(0, rng) == 1 and option.policy(1) == 1
    assert TableOption("sure", rows[:1], [0]).is_markov
    with pytest.raises(OptionError, match="no action for state 2"):
        option.policy(2)


@pytest.mark.parametrize(("policy", "termination", "message"), [
    ([[0.5, 0.4]], [0], "must be non-negative and sum to 1"), ([[1.5, -0.5]], [0], "non-negative and sum to 1"),
    ([1], [1.5], "must be from 0 to 1"),
])
def test_impossible_tables_are_refused(policy, termination, message):
    with pytest.raises(OptionError, match=message):
        TableOption("x", policy, termination)


def test_states_of_several_numbers_are_keys():
    option = TableOption("x", {(1, 2): 4}, {(1, 2): 0.5})
    assert option.policy(np.array([1, 2])) == 4 and option.termination(np.array([1, 2])) == 0.5
    assert option.initiation(np.array([1, 2])) and not option.initiation(np.array([2, 1]))


# --- the contract as a check --------------------------------------------------------------------


@pytest.mark.nightly_for("MiniGrid")
@pytest.mark.parametrize("kind", KINDS)
def test_the_check_accepts_a_correct_option_of_any_environment(kind):
    make, make_option, domain, _ = KINDS[kind]
    check_option(make_option(), make(), **({} if domain is None else {"domain": domain}))


class Counting(FunctionOption):
    """Says that it is a function of the state, and counts."""

    count = 0

    def policy(self, state):
        self.count += 1
        return EAST if self.count % 3 else WEST


@pytest.mark.parametrize(("option", "claim"), [
    (go(action=7), r"the policy gives an action of Discrete\(2, start=5\)"),
    (go(action=True), "the policy gives an action of"),
    (FunctionOption("x", lambda cell: EAST, lambda cell: 1.5), "termination gives a probability"),
    (FunctionOption("x", lambda cell: WEST, lambda cell: 0.0), "it ends with the episode at the latest"),
    (Counting("x", print, lambda cell: float(cell == 5)), "the same run|function of the state"),
    (go(start=lambda cell: False), "it starts somewhere"),
    (FunctionOption("x", lambda cell: go(start=lambda cell: False), lambda cell: 1.0), "entered where it may start"),
    (FunctionOption("x", lambda cell, rng: np.random.default_rng().choice([EAST, WEST]), lambda cell: 0.02,
                    is_stochastic=True), "the same run|does not change another one"),  # which is found is chance
])
def test_the_check_finds_what_is_broken(option, claim):
    with pytest.raises(ContractError, match=claim):
        check_option(option, Corridor(), horizon=200)


def test_the_check_accepts_a_stochastic_option_that_draws_from_its_callers_generator():
    check_option(FunctionOption("x", lambda cell, rng: rng.choice([EAST, WEST]), lambda cell: 0.02,
                                is_stochastic=True), Corridor())


def test_states_can_be_given_in_rooms_only():
    with pytest.raises(UnsupportedError, match="cannot be set to a state"):
        check_option(go(), Corridor(), states=[3])
