"""Difficulty of a room at a glance: the oracle, random options, a search baseline, and a random walk.

    difficulty = measure_difficulty(make_room("four-button-chain"))
    difficulty.search.success_rate, difficulty.is_horizon_short

The random walk is exact where the room has few states. The expected primitives h solve h(s) = 1 + mean over primitives
of h(s'), with h = 0 after an escape (Kemeny and Snell 1960, theorem 3.3.5).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.making import make_agent
from hrl_escape.agents.registry import RANDOM_OPTIONS
from hrl_escape.agents.spec import ORACLE, SEARCH_NEAREST, AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.benchmark.agent_env import find_starts, make_agent_env, make_player
from hrl_escape.benchmark.score_range import CEILING, ScoreRange, compute_score_range
from hrl_escape.benchmark.statistics import compute_mean_efficiency
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.figures import Pictured

MOST_WALK_STATES = 20_000
"""Most states of a room whose random walk is solved."""
POSE_DECIMALS = 6
"""Decimals of metres and radians that distinguish two poses."""


class BaselineResult(NamedTuple):
    """Evaluation episodes of an agent that does not learn."""

    name: str  # its spec
    success_rate: float
    efficiency: float | None  # mean efficiency (SPL), or None if no escape is known
    length: float  # mean primitives of an episode
    cut_off: float  # share of episodes that the horizon ended

    def __str__(self) -> str:
        rate = f"{self.success_rate:.0%} success"
        return rate if self.efficiency is None else f"{rate}, efficiency {self.efficiency:.2f}"


class RandomWalk(NamedTuple):
    """Uniformly random primitives in a room, exactly."""

    primitives: float  # expected primitives of an escape without a horizon; infinite if some walks never escape
    success_rate: float  # probability of an escape within the horizon
    states: int  # reachable states of the room

    def __str__(self) -> str:
        mean = f"{self.primitives:,.0f} primitives" if math.isfinite(self.primitives) else "some never escape"
        return f"{mean}, {self.success_rate:.2%} in time"


@dataclass(frozen=True, repr=False)
class Difficulty(Pictured):
    """Difficulty of a room; notebooks draw it as a map of the room."""

    room: RoomInstance
    oracle: float | None  # mean primitives of the best known escape, or None if none is known
    random_options: BaselineResult | None  # random legal options, or None if they cannot run
    search: BaselineResult | None  # the search baseline `search-nearest`, or None for puzzles that it cannot read
    random_walk: RandomWalk | None  # or None with chance, physics or more than `MOST_WALK_STATES` states

    _picture = "hrl_escape.benchmark.difficulty:draw_difficulty"

    def __repr__(self) -> str:
        return f"<Difficulty of {self.room.name}, id {self.room.id}: {'; '.join(f'{n} {v}' for n, v in self.rows)}>"

    @property
    def is_horizon_short(self) -> bool:
        """True if the horizon ends the oracle, or most episodes of every baseline over options."""
        baselines = [each for each in (self.random_options, self.search) if each is not None]
        return self._ends_oracle or (bool(baselines) and all(each.cut_off > 0.5 for each in baselines))

    @property
    def _ends_oracle(self) -> bool:
        return self.oracle is not None and self.oracle > self.room.horizon

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Names and values, for tables and pictures."""
        walk = "not computed" if self.random_walk is None else str(self.random_walk)
        oracle = "no plan known" if self.oracle is None else f"{self.oracle:,.0f} primitives"
        horizon = ("too short for the oracle" if self._ends_oracle else
                   "short, as baselines run out of time" if self.is_horizon_short else "long enough")
        return (
            ("oracle", oracle),
            ("search", "none for this puzzle" if self.search is None else str(self.search)),
            ("random options", "cannot run" if self.random_options is None else str(self.random_options)),
            ("random walk", walk),
            ("horizon", f"{self.room.horizon:,} primitives, {horizon}"),
        )

    @property
    def lines(self) -> tuple[str, ...]:
        """Lines of the rows, for the narrow panel of a picture."""
        return tuple(f"{name}: {value}" for name, value in self.rows)

    def to_json(self) -> dict[str, Any]:
        """Return the values as JSON; an infinite expectation is null."""
        walk = self.random_walk
        results = {name: None if each is None else each._asdict()
                   for name, each in (("random_options", self.random_options), ("search", self.search))}
        return {"oracle": self.oracle, **results, "random_walk": None if walk is None else {
            **walk._asdict(), "primitives": walk.primitives if math.isfinite(walk.primitives) else None},
            "horizon": self.room.horizon, "is_horizon_short": self.is_horizon_short}


def measure_difficulty(room: RoomInstance, episodes: int = 10, seed: int = 0) -> Difficulty:
    """Measure the difficulty of a room.

    Args:
        room: the room.
        episodes: evaluation episodes of each baseline.
        seed: of these episodes; their starts are the same for all baselines.

    Returns:
        The same numbers for the same room, episodes and seed.
    """
    scale = _find_scale(room, episodes, seed)
    random_options, search = (_run_baseline(name, room, scale, episodes, seed)
                              for name in (RANDOM_OPTIONS, SEARCH_NEAREST))
    oracle = None if scale is None else float(np.mean(scale.fewest))
    return Difficulty(room, oracle, random_options, search, solve_random_walk(room))


def draw_difficulty(difficulty: Difficulty) -> Any:
    """Draw the room's map with its difficulty, as a matplotlib figure."""
    from hrl_escape.env.pictures.maps import make_map  # loads matplotlib

    return make_map(difficulty.room, notes=difficulty.lines)


def _find_scale(room: RoomInstance, episodes: int, seed: int) -> ScoreRange | None:
    """Find the fewest known primitives from the start of each episode, or None without a known plan."""
    oracle = AgentSpec.parse(ORACLE)
    env, recorder = make_agent_env(oracle, room, "features")
    with tempfile.TemporaryDirectory() as cache:
        try:
            starts = find_starts(env, recorder, [compute_episode_seed(seed, "evaluation", n) for n in range(episodes)])
            found = compute_score_range(starts, oracle, Path(cache))
            return None if found.source == CEILING else found
        except EscapeError:
            return None
        finally:
            env.close()


def _run_baseline(name: str, room: RoomInstance, scale: ScoreRange | None, episodes: int, seed: int
                  ) -> BaselineResult | None:
    """Evaluate a baseline, or return None if it cannot run in this room."""
    spec = AgentSpec.parse(name)
    try:
        env, recorder = make_agent_env(spec, room, "features")
    except EscapeError:
        return None
    try:
        player = make_player(spec, env, recorder) if spec.is_reference else make_agent(
            spec, env.observation_space, env.action_space, seed)
        found = evaluate(player, env, episodes, seed)
    except EscapeError:  # a puzzle that the rule cannot read
        return None
    finally:
        env.close()
    escaped = found.escaped
    efficiency = None if scale is None else compute_mean_efficiency(escaped, found.lengths, scale.fewest,
                                                                    scale.is_expected)
    cut_off = [not done and length >= room.horizon for done, length in zip(escaped, found.lengths, strict=True)]
    return BaselineResult(name, float(np.mean(escaped)), efficiency, float(np.mean(found.lengths)),
                          float(np.mean(cut_off)))


# --- the random walk ---------------------------------------------------------------------


def solve_random_walk(room: RoomInstance, most: int = MOST_WALK_STATES) -> RandomWalk | None:
    """Solve the walk of uniformly random primitives from the room's starts.

    Args:
        room: the room.
        most: reachable states up to which it is solved.

    Returns:
        The walk, or None for rooms with chance or physics, and above `most` states.
    """
    if room.dynamics.is_random or room.dynamics.kind == "physics" or room.puzzle.is_random:
        return None
    found = _explore(Kinematics(room), most)
    if found is None:
        return None
    from scipy import sparse  # pyright: ignore[reportMissingTypeStubs]  # takes a fifth of a second to import
    from scipy.sparse import linalg  # pyright: ignore[reportMissingTypeStubs]

    following, escapes, starts = found
    states, actions = following.shape
    rows, columns = np.repeat(np.arange(states), actions), following.ravel()
    stays = columns >= 0
    walk = sparse.csr_matrix((np.full(int(stays.sum()), 1 / actions), (rows[stays], columns[stays])),
                             shape=(states, states))
    once = escapes / actions  # probability of an escape by the next primitive
    alive, escaped = np.zeros(states), 0.0
    np.add.at(alive, starts, 1 / len(starts))
    for _ in range(room.horizon):
        escaped += float(alive @ once)
        alive = alive @ walk
    expected: NDArray[np.float64] = linalg.spsolve(  # pyright: ignore[reportAssignmentType]
        sparse.eye(states, format="csc") - walk.tocsc(), np.ones(states)) if _always_escapes(
        walk, once) else np.full(states, math.inf)
    return RandomWalk(float(np.mean(expected[starts])), escaped, states)


def _explore(rules: Kinematics, most: int) -> tuple[NDArray[np.int64], NDArray[np.int64], list[int]] | None:
    """Find all reachable states.

    Returns:
        Index of the state after each primitive, int64 (states, primitives), -1 where the episode ends; the number of
        primitives that escape, int64 (states,); and the states of the starts. None above `most` states.
    """
    room, numbers = rules.instance, dict[tuple[Any, ...], int]()
    states: list[RoomState] = []

    def number(state: RoomState) -> int:
        pose = (round(state.x, POSE_DECIMALS), round(state.y, POSE_DECIMALS), state.heading_steps,
                round(state.heading_offset, POSE_DECIMALS), state.joint_steps)
        key = (*pose, state.puzzle, state.touching)
        if key not in numbers:
            numbers[key] = len(states)
            states.append(state)
        return numbers[key]

    starts = [number(state) for state in _list_starts(rules)]
    following, escapes = list[list[int]](), list[int]()
    while len(following) < len(states) <= most:
        here = states[len(following)]
        steps = [rules.step(here._replace(primitives=0), action) for action in range(len(room.robot.actions.names))]
        following.append([-1 if step.terminated else number(step.state) for step in steps])
        escapes.append(sum(step.terminated and rules.has_escaped(step.state) for step in steps))
    return None if len(states) > most else (np.array(following), np.array(escapes), starts)


def _list_starts(rules: Kinematics) -> Iterator[RoomState]:
    """Yield the first states of episodes: every start with every first state of the puzzle."""
    puzzles = rules.instance.puzzle.list_starts()
    for start in rules.instance.starts:
        state = rules.make_state(start)
        yield from [state] if len(puzzles) == 1 else [state._replace(puzzle=puzzle) for puzzle in puzzles]


def _always_escapes(walk: Any, once: NDArray[np.float64]) -> bool:
    """Return whether every state can escape, so that every walk escapes with probability 1."""
    leaves = np.asarray(walk.sum(axis=1)).ravel() + once
    if (leaves < 1 - 1e-9).any():  # some primitive fails the puzzle
        return False
    can = once > 0
    while True:
        more = can | (walk @ can > 0)
        if (more == can).all():
            return bool(can.all())
        can = more
