"""All that a puzzle may have, by a stranger's one: first states, chance, rewards, failure, and a derived model."""

import dataclasses
import itertools
from typing import Annotated

import gymnasium
import numpy as np
import pytest
import torch

from hrl_escape import OptionsEnv, RoomConfig, RoomPlanner, generate
from hrl_escape.agents import train
from hrl_escape.checks import check_puzzle
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.puzzles.base import tabulate
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.config import RewardConfig, RobotConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.noise import CHANCE_PURPOSE, draw_chance, draw_puzzle_start, philox
from hrl_escape.env.puzzles.base import Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.options import pursue
from hrl_escape.planning.best_known import list_start_states
from hrl_escape.settings import Range

# --- a stranger's puzzle without a symbolic model: ring the wanted bell twice; another one may break it


@dataclasses.dataclass(frozen=True)
class BellsConfig(PuzzleConfig):
    kind, panels = "bells", Panels(width=1.5)
    success: Annotated[float, Range(0, 1)] = 0.75
    """Probability that a ring counts."""

    def make_puzzle(self, rng):
        return Bells(self.success)


@dataclasses.dataclass(frozen=True)
class Bells(Puzzle):
    """States (wanted bell, rings so far, broken)."""

    kind, target_names, bounds = "bells", ("a", "b", "c"), ((0.0, 2.0),) * 2 + ((0.0, 1.0),)
    success: float = 0.75
    chances = property(lambda self: (self.success,) if self.success < 1.0 else ())

    def make_state(self):
        return 0, 0, 0

    def list_starts(self):
        return tuple((wanted, 0, 0) for wanted in range(3))

    def update(self, state, contacts):
        for bell in contacts.pressed:
            wanted, rings, broken = state
            if not broken and rings < 2:
                state = (wanted, rings + (contacts.uniform < self.success), 0) if bell == wanted else (
                    wanted, rings, int(contacts.uniform >= self.success))
        return state

    def is_solved(self, state):
        return state[1] == 2

    def is_failed(self, state):
        return state[2] == 1

    def compute_reward(self, before, after, contacts):
        return 5.0 * (after[1] - before[1]) - 50.0 * (after[2] - before[2])

    def observe(self, state):
        return tuple(map(float, state))

    def get_lit(self, state):
        return tuple(state[0] == bell for bell in range(3))


register_puzzle(BellsConfig, Bells)

def make_room(success: float = 0.75, **parts):
    return generate(RoomConfig(name="bells", puzzle=BellsConfig(success), room=ShapeConfig(width=6, depth=6),
                               robot=RobotConfig(body_radius=0.4), **parts), 0)


# --- what follows from it


def test_the_contract_is_kept():
    check_puzzle(Bells(0.75))
    check_puzzle(Bells(1.0))


def test_chance_and_first_states_are_fair_and_have_numbers_of_their_own():
    chances = [draw_chance(key, n) for key, n in itertools.product(range(100), repeat=2)]
    counts, _ = np.histogram(chances, bins=20, range=(0, 1))
    assert ((counts - 500) ** 2 / 500).sum() < 43.8  # chi-square of 19 degrees of freedom, p = 0.001
    starts = np.bincount([draw_puzzle_start(key, 3) for key in range(3000)], minlength=3)
    assert ((starts - 1000) ** 2 / 1000).sum() < 13.8
    assert draw_chance(7, 5) == (philox((5, 0, CHANCE_PURPOSE, 0), (7, 0))[0] + 0.5) / 2**32 != draw_chance(7, 6)


@pytest.mark.nightly
def test_both_engines_draw_the_same_first_states_chances_rewards_and_failures():
    room = make_room()
    numbers, rooms = tabulate(room.puzzle).numbers, 32
    batch, rules = TensorRoom(Rooms(rooms, instance=room), autoreset="disabled"), Kinematics(room)
    batch.reset(torch.arange(rooms))
    states = [batch.get_room_state(i) for i in range(rooms)]
    assert {state.puzzle for state in states} == set(room.puzzle.list_starts())
    assert states == [rules.make_state(room.starts[0], state.noise_key) for state in states]
    rng, failed, rung = np.random.default_rng(0), 0, 0
    for _ in range(250):
        actions = rng.integers(4, size=rooms)
        outcome = batch.step(torch.from_numpy(actions))
        steps = [rules.step(state, action) for state, action in zip(states, actions.tolist(), strict=True)]
        states = [step.state for step in steps]
        assert batch.state.puzzle.tolist() == [numbers[state.puzzle] for state in states]
        assert outcome.reward.tolist() == [step.reward for step in steps]
        assert outcome.terminated.tolist() == [step.terminated for step in steps]
        escaped = [step.terminated and rules.has_escaped(step.state) for step in steps]
        assert (outcome.info.success != 0).tolist() == escaped
        failed += sum(step.terminated for step in steps) - sum(escaped)
        rung += sum(step.reward == 4.0 for step in steps)
        over = torch.tensor([step.terminated or step.truncated for step in steps])
        if over.any():
            batch.reset(where=over)
            states = [batch.get_room_state(i) if over[i] else state for i, state in enumerate(states)]
    assert failed > 5 and rung > 5


def test_an_episode_that_failed_is_over_and_no_success():
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=make_room(0.5))
    env.reset(seed=0)
    planner, endings = RoomPlanner(env.unwrapped.instance), set()
    for seed in range(12):
        env.reset(seed=seed)
        state = env.unwrapped.get_state()
        wrong = f"press-{'abc'[(state.puzzle[0] + 1) % 3]}"
        for primitive in planner.plan(state, wrong).primitives:
            _, reward, terminated, _, info = env.step(primitive)
        endings.add((reward, terminated, info["is_success"]))
    assert endings == {(-51.0, True, False), (-1.0, False, False)}


def test_plans_suppose_the_most_likely_outcome_and_know_no_other():
    room = make_room()
    planner = RoomPlanner(room)
    for key in range(5):
        state = planner.rules.make_state(room.starts[0], key)
        plan = planner.solve(state)
        assert [part.goal.target for part in plan.parts[:2]] == [state.puzzle[0]] * 2
        assert plan.primitives == planner.solve(state._replace(noise_key=key + 100)).primitives
        assert plan.compute_return() == -plan.cost + 10.0 + 100.0


def test_what_goes_otherwise_than_planned_is_planned_anew():
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=make_room(0.5))
    presses = []
    for seed in range(8):
        env.reset(seed=seed)
        wanted = env.unwrapped.get_state().puzzle[0]
        done = pursue(env)
        assert done.escaped and env.unwrapped.get_state().puzzle == (wanted, 2, 0)
        presses.append(sum(decision["name"].startswith("press-") for decision in done.decisions))
    assert max(presses) > 2, "some presses did nothing"


def test_reference_states_spread_over_the_puzzles_first_states():
    assert [state.puzzle for state in list_start_states(make_room())] == list(Bells().list_starts())


@pytest.mark.nightly
def test_a_strangers_puzzle_is_learned():
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=make_room(1.0, reward=RewardConfig(exit=50)),
                                    observation="features"), include_primitives=False)
    result = train("smdp-q-learning", env, primitives=1_500, seed=0, eval_every=1_500, eval_episodes=8)
    assert result.evaluations[-1].success_rate == 1.0
