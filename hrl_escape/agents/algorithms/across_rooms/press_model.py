"""Learner for unseen rooms: tables over what buttons show, trained on the presses of a search in training rooms.

In training rooms it searches, nearest button first, and keeps which presses lit. From these presses it learns the odds
that a button lights, by its symbol, direction, plug or number and by the presses in the room so far; see
`components/press_tables.py`. In an unseen room it presses the button with the fewest expected primitives for each
light:

    cost(b) = (c |x_b - x| + 1 + (1 - p_b) loss) / (p_b n_b^2)

p_b is the probability that b lights, and n_b that the exit needs it. c is the number of primitives per unit of
distance, and loss the mean number of primitives that a wrong press undoes, both estimated in training. The square
makes a detour to a button that is not needed dearer than one to a button that is needed later anyway.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import make_rng, sample_legal
from hrl_escape.agents.components.press_tables import (
    COLOUR_COUNT,
    SECTOR_COUNT,
    PressTables,
    RoomPresses,
    TableSettings,
    fit_press_tables,
    pack_press_tables,
    unpack_press_tables,
)
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.settings import Range
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

FIRST_FIT = 32
"""Rooms of the first training; the next ones are at twice as many, and at the end of the budget."""
LEAST_NEED = 0.02
"""Least probability that the exit needs a button, so that no button is left out for good."""
FAILED_EPISODES = 3.0
"""Loss of an episode that a wrong press ends, in lengths of the longest training episode."""


@dataclass(frozen=True, kw_only=True)
class PressModelSettings(TableSettings):
    """Settings of `press-model`: latent tasks and training."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive of logged returns; learning does not use it."""
    network: Literal["objects"] = "objects"
    """It reads the observation `objects`."""


class _View(NamedTuple):
    """Content of an observation; lengths are fractions of the floor's diagonal."""

    present: NDArray[np.bool_]  # (buttons,)
    lit: NDArray[np.bool_]  # (buttons,)
    places: NDArray[np.float64]  # (buttons, 2), relative to the robot, along the axes of the room
    facing: NDArray[np.float64]  # (buttons, 2), unit vectors from the wall into the room
    exit: NDArray[np.float64]  # (4,), its middle in the same way, and half its sizes
    symbols: tuple[int, ...]  # of each button; empty without symbols
    is_open: bool


@dataclass
class _Episode:
    """Presses in the room of an episode."""

    room: RoomPresses
    last: tuple[int, NDArray[np.bool_]] | None = None  # the press whose result is still to be read; off before it
    is_reset: bool | None = None  # whether wrong presses turn buttons off; None before one that shows it

    def read(self, view: _View) -> bool:
        """Read the result of the last press; return whether it failed."""
        if self.last is None:
            return False
        (button, off), self.last = self.last, None
        has_lit, before = bool(view.lit[button]), view.present & ~off
        self.room.note(button, off, has_lit, has_lit and view.is_open)
        if not has_lit and before.any():
            self.is_reset = bool((before & ~view.lit).any())
        return not has_lit


class PressModel(Agent):
    """Presses the button with the fewest expected primitives for each light, by odds learned in training rooms."""

    settings: PressModelSettings
    STATE = ("learned", "_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: PressModelSettings | None = None) -> None:
        self.settings = settings or PressModelSettings()
        count_actions(action_space, self.name)
        if not isinstance(observation_space, ObjectsBox) or not isinstance(action_space, PointingDiscrete):
            raise UnsupportedSpaceError(f"{self.name} needs options over the observation objects: "
                                        f"smdp-{self.name}+objects, or an OptionsEnv over observation='objects'")
        self._shape = len(observation_space.rows), len(observation_space.words)
        self._words = observation_space.words
        names = [name for name in observation_space.rows if name != "exit"]
        self._exit = observation_space.rows.index("exit")
        self._rows = [observation_space.rows.index(name) for name in names]
        self._buttons = [names.index(name) if name in names else -1 for name in action_space.about]
        self._leave = [number for number, name in enumerate(action_space.about) if name == "exit"]
        self._seed, self._rng = seed, make_rng(seed, "actions")
        self._tables: PressTables | None = None
        self._rooms: dict[str, RoomPresses] = {}  # of each training room
        self._primitives, self._longest = 0, 0  # of training, and of its longest episode
        self._pace = np.zeros(2)  # primitives of presses, and their distances
        self._mistakes = np.zeros(4)  # wrong presses without effect, resets, failures; primitives that resets undid
        self._next_fit, self._budget = FIRST_FIT, np.inf
        self._episode: _Episode | None = None
        self._length = 0  # primitives of the training episode

    @property
    def learned(self) -> Mapping[str, Any]:
        """Results of training, as plain values and arrays."""
        rooms = {key: {"symbols": room.symbols, "sectors": room.sectors, "cleared": room.cleared,
                       "failures": [[others.tolist() for others in own] for own in room.failures],
                       "order": list(room.order),
                       "goal": room.goal}
                 for key, room in self._rooms.items()}
        return {"rooms": rooms, "primitives": self._primitives, "longest": self._longest, "pace": self._pace,
                "mistakes": self._mistakes, "next_fit": self._next_fit, "budget": float(self._budget),
                "tables": None if self._tables is None else pack_press_tables(self._tables)}

    @learned.setter
    def learned(self, value: Mapping[str, Any]) -> None:
        self._rooms = {key: RoomPresses(
            np.array(own["symbols"]), np.array(own["sectors"]), np.array(own["cleared"]),
            [[np.array(others, dtype=bool) for others in failures] for failures in own["failures"]],
            list(own["order"]), goal=own["goal"]) for key, own in value["rooms"].items()}
        self._primitives, self._longest = value["primitives"], value["longest"]
        self._pace, self._mistakes = np.array(value["pace"]), np.array(value["mistakes"])
        self._next_fit = value["next_fit"]
        self._budget, self._episode, self._length = value["budget"], None, 0
        self._tables = None if value["tables"] is None else unpack_press_tables(
            value["tables"], self.settings, len(self._rows))

    def note_budget(self, primitives: int) -> None:
        """Receive the budget: at its end the tables are trained once more."""
        self._budget = float(primitives)

    # --- training -------------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Search: press the nearest button that is not known to fail, or known buttons after a reset."""
        view = self._look(observation)
        if self._episode is None:
            key, room = self._describe(view)
            room = self._rooms.setdefault(key, room)
            room.lit, self._length = [], 0
            self._episode = _Episode(room)
        return self._choose(self._episode, view, action_mask, None, self._rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Note the result of a press; at some numbers of rooms, and at the end of the budget, train the tables."""
        episode, after = self._episode, self._look(transition.next_observation)
        self._primitives += transition.duration
        self._length += transition.duration
        self._longest = max(self._longest, self._length)
        if episode is not None and episode.last is not None:
            place = self._look(transition.observation).places[episode.last[0]]
            self._pace += transition.duration, np.hypot(*place)
            if transition.truncated and not transition.terminated:
                episode.last = None  # the press may be cut off
            elif episode.read(after):
                kind = 2 if transition.terminated else int(bool(episode.is_reset))
                self._mistakes[kind] += 1.0
                self._mistakes[3] += self._length if kind == 1 else 0.0
        if transition.terminated or transition.truncated:
            self._episode = None
            known = sum(bool(room.order) for room in self._rooms.values())
            if known >= self._next_fit and self._primitives < self._budget:
                self._fit()
                self._next_fit = 2 * known
        if self._primitives >= self._budget:
            self._budget = np.inf
            self._fit()
        return {"rooms": float(len(self._rooms))}

    def _fit(self) -> None:
        rooms = [room for room in self._rooms.values() if room.order]
        if len(rooms) > 1:
            self._tables = fit_press_tables(rooms, self.settings, len(self._rows), self._seed)

    # --- acting ---------------------------------------------------------------------------

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Press by the learned odds, given the presses of this episode."""
        view, memory = self._look(observation), self.recall(rng)
        episode: _Episode = _Episode(self._describe(view)[1]) if memory is None else memory[0]
        episode.read(view)
        self._evaluation = rng, episode
        return self._choose(episode, view, action_mask, self._tables, rng)

    def _choose(self, episode: _Episode, view: _View, action_mask: NDArray[np.bool_], tables: PressTables | None,
                rng: np.random.Generator) -> int:
        for action in self._leave:
            if view.is_open and action_mask[action]:
                return action
        off = view.present & ~view.lit
        odds, needs = self._weigh(episode.room, off, tables)
        open_ = [action for action in np.flatnonzero(action_mask).tolist()
                 if (button := self._buttons[action]) >= 0 and off[button] and odds[button] > 0]
        if not open_:
            return sample_legal(action_mask, rng)
        pace, loss = self._pace[0] / max(self._pace[1], 1e-9) or 1.0, self._expect_loss(episode.is_reset)

        def expect(action: int) -> float:
            button = self._buttons[action]
            way = pace * float(np.hypot(*view.places[button])) + 1
            return (way + (1 - odds[button]) * loss) / (odds[button] * max(needs[button], LEAST_NEED) ** 2)

        action = min(open_, key=expect)
        episode.last = self._buttons[action], off
        return action

    def _expect_loss(self, is_reset: bool | None) -> float:
        """Return the primitives that a wrong press loses in the mean."""
        ignored, resets, failures, undone = self._mistakes.tolist()
        if is_reset is not None:
            return undone / max(resets, 1.0) if is_reset else 0.0
        return (undone + failures * FAILED_EPISODES * self._longest) / max(ignored + resets + failures, 1.0)

    def _weigh(self, room: RoomPresses, off: NDArray[np.bool_], tables: PressTables | None
               ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the probability that each button lights now, at least 1 in sum, and that the exit needs it."""
        odds, needs = (off / off.sum(), np.ones(len(off))) if tables is None else tables.predict(room, off)
        for button in np.flatnonzero(off).tolist():
            if room.lights(button, off):
                odds[button] = 1.0
            elif room.fails(button, off):
                odds[button] = 0.0
        return odds / min(1.0, odds.sum() or 1.0), needs

    # --- content of an observation ----------------------------------------------------------

    def _look(self, observation: Any) -> _View:
        rows = np.asarray(observation, dtype=np.float64)[: self._shape[0] * self._shape[1]].reshape(self._shape)
        words = {word: rows[:, number] for number, word in enumerate(self._words)}
        cos, sin = words["cos"][self._exit], words["sin"][self._exit]
        turn = np.array([[cos, -sin], [sin, cos]])  # from axes of the robot to those of the room, which the exit has
        places = np.stack([words["ahead"], words["left"]], axis=1) @ turn
        symbols: tuple[int, ...] = ()
        if "red" in words:
            cues = rows[self._rows][:, self._words.index("red"):][:, : COLOUR_COUNT + 7]
            shapes = len(cues[0]) - COLOUR_COUNT - 3
            parts = (part.argmax(axis=1) for part in np.split(cues, (COLOUR_COUNT, COLOUR_COUNT + shapes), axis=1))
            colour, shape, size = parts
            symbols = tuple((colour + COLOUR_COUNT * (shape + shapes * size)).tolist())
        own = [words[name][self._exit] for name in ("half-x", "half-y")]
        facing = np.stack([-words["sin"], words["cos"]], axis=1) @ turn
        return _View((words["present"] * words["target"])[self._rows] > 0.5, words["lit"][self._rows] > 0.5,
                     places[self._rows], facing[self._rows], np.array([*places[self._exit], *own]), symbols,
                     bool(words["lit"][self._exit] > 0.5))

    def _describe(self, view: _View) -> tuple[str, RoomPresses]:
        """Return a key of the room that does not depend on the robot, and the room without presses."""
        count = int(view.present.sum())
        shown = view.places[view.present]
        away = shown - _find_middle(shown, view.facing[view.present], view.exit)
        turns = np.arctan2(away[:, 1], away[:, 0]) % (2 * np.pi) / (2 * np.pi)
        sectors = np.minimum((turns * SECTOR_COUNT).astype(int), SECTOR_COUNT - 1).tolist()
        key = f"{np.round(away, 3).tolist()} {view.symbols}"
        return key, RoomPresses.begin(view.symbols[:count], [*sectors, *[0] * (len(view.present) - count)])


def _find_middle(places: NDArray[np.float64], facing: NDArray[np.float64], exit_: NDArray[np.float64]
                 ) -> NDArray[np.float64]:
    """Estimate the middle of the floor from walls with buttons; a wall without is as far as along the other axis."""
    low = np.minimum(places.min(axis=0), exit_[:2] - exit_[2:])
    high = np.maximum(places.max(axis=0), exit_[:2] + exit_[2:])
    has_low, has_high = np.any(facing > 0.5, axis=0).tolist(), np.any(facing < -0.5, axis=0).tolist()
    sizes = high - low
    for axis in range(2):
        if has_low[axis] != has_high[axis]:
            size = max(sizes)
            low[axis], high[axis] = (low[axis], low[axis] + size) if has_low[axis] else (high[axis] - size, high[axis])
    return (low + high) / 2
