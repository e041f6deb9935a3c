"""An episode that a person plays: primitives, meta-actions, undo, the next room, and its file.

It knows no page and no keys. Undo restores the exact state before the last move, however many primitives it ran. A file
holds the room, the seed and every primitive, as JSON.

On a graph of buttons, presses are evidence: of edges that follow from it, and of those that still may be there. A
button that goes on shows that all its parents were on; one that stays off, that a parent was off. Only buttons whose
presses say no more than that are reasoned about: none that can be turned off, and none that locks another.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from hrl_escape.benchmark.episodes import PrimitiveStep, StateRecorder
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EpisodeFileError, EscapeError, FileReadError, OldFormatError, UnsupportedError
from hrl_escape.files import read_json, write_json
from hrl_escape.names import make_file_name
from hrl_escape.options.options_env import OptionsEnv

SCHEMA = 3


@dataclasses.dataclass(frozen=True)
class SavedEpisode:
    """Content of an episode's file."""

    instance: RoomInstance  # the room
    seed: int  # of the episode
    moves: tuple[tuple[str, tuple[int, ...], str], ...]  # name, primitives and ending of each move, in order
    total: float  # undiscounted return
    end: EpisodeEnd | None
    """The episode's end; None where the file came from one that only said whether the robot escaped."""

    @property
    def primitives(self) -> tuple[int, ...]:
        """All primitives in order."""
        return tuple(primitive for _, primitives, _ in self.moves for primitive in primitives)

    @property
    def file_name(self) -> str:
        """Default name of the file: room, instance seed, number of primitives, and a hash that tells episodes apart."""
        content = json.dumps([self.instance.id, self.seed, self.moves])
        key = hashlib.sha256(content.encode()).hexdigest()[:8]
        room = make_file_name(f"{self.instance.name}-{self.instance.seed}")
        return f"{room}-{len(self.primitives)}-primitives-{key}.json"


def save_episode(path: str | Path, saved: SavedEpisode) -> None:
    """Write an episode as JSON, atomically."""
    moves: Sequence[dict[str, Any]] = [
        {"name": name, "primitives": list(primitives), "ended": ended} for name, primitives, ended in saved.moves
    ]
    write_json(path, {"schema": SCHEMA, "kind": "episode", "seed": saved.seed, "return": saved.total,
                      "end": saved.end and saved.end.value, "primitives": len(saved.primitives), "moves": moves,
                      "instance": saved.instance.to_dict()})


def load_episode(path: str | Path) -> SavedEpisode:
    """Read an episode.

    Raises:
        EpisodeFileError: the file is damaged or holds something else.
        FileReadError: there is no such file, or it is not JSON.
    """
    content = read_json(path, "recorded episode")
    try:
        if not isinstance(content, dict) or content.get("kind") != "episode":
            raise EpisodeFileError("no recorded episode: save one with the Save button of hrl-escape play")
        if content["schema"] in (1, 2):
            raise OldFormatError(path, "recorded episode")
        if content["schema"] != SCHEMA:
            raise EpisodeFileError(f"it has schema {content['schema']!r}, this version reads {SCHEMA}")
        instance = RoomInstance.from_dict(content["instance"])
        count = len(instance.robot.actions)
        moves = tuple((str(m["name"]), tuple(int(p) for p in m["primitives"]), str(m["ended"]))
                      for m in content["moves"])
        if any(not primitives or not all(0 <= p < count for p in primitives) for _, primitives, _ in moves):
            raise EpisodeFileError(f"its primitives are not all numbers from 0 to {count - 1}")
        end = None if content["end"] is None else EpisodeEnd(content["end"])
        return SavedEpisode(instance, int(content["seed"]), moves, float(content["return"]), end)
    except FileReadError:
        raise
    except (EscapeError, KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise EpisodeFileError(f"{path}: {reason}") from None


class PressEvidence:
    """Evidence from the presses in one room, over all its episodes."""

    def __init__(self, instance: RoomInstance) -> None:
        self._puzzle = instance.puzzle
        self._possible: dict[int, frozenset[int]] = {}
        self._failed: dict[int, set[frozenset[int]]] = {}

    def note(self, step: PrimitiveStep) -> None:
        """Take note of the presses of a primitive."""
        before, after = (self._puzzle.get_lit(state.puzzle) for state in (step.before, step.after))
        lit = frozenset(i for i, on in enumerate(before) if on)
        for target in step.pressed:
            if before[target]:
                continue
            if after[target]:
                self._possible[target] = self._possible.get(target, lit) & lit
            else:
                self._failed.setdefault(target, set()).add(lit)

    def list_edges(self) -> tuple[Collection[tuple[int, int]], Collection[tuple[int, int]]]:
        """Edges (parent, child) that are there for certain, and all that may be, of buttons that went on."""
        puzzle = self._puzzle
        if not isinstance(puzzle, ButtonsPuzzle) or puzzle.allow_off or puzzle.locks:
            return (), ()
        possible = {(parent, child) for child, parents in self._possible.items() for parent in parents}
        missing = [(child, self._possible.get(child, frozenset()) - lit)
                   for child, failures in self._failed.items() for lit in failures]
        return {(next(iter(lacked)), child) for child, lacked in missing if len(lacked) == 1}, possible


@dataclasses.dataclass(frozen=True)
class PlayedMove:
    """One decision: a primitive, or a meta-action that ran to its end."""

    name: str  # of the primitive or option
    steps: tuple[PrimitiveStep, ...]  # the primitives that ran
    ended: str = "reached"  # how it ended, as in `info["option"]["ended"]`
    reason: str = ""  # why planning failed, else empty


class Episode:
    """One room being played; the seed fixes the start and the noise.

    The room configuration, `config`, is needed to enter the next room. Where it `is_hidden`, the graph is to be
    discovered.

    Attributes:
        instance: the present room.
        discovery: what presses have shown of a graph that is to be discovered; None where it is shown.
        moves: all moves since the episode began.
        running: primitives so far of the move in progress.
        on_step: called after every primitive.
    """

    def __init__(self, instance: RoomInstance, config: RoomConfig | None = None, seed: int = 0,
                 is_hidden: bool = False) -> None:
        self.config, self.seed, self._is_hidden = config, seed, is_hidden
        self.on_step: Callable[[PrimitiveStep], None] | None = None
        self._open(instance)

    def _open(self, instance: RoomInstance) -> None:
        self.instance = instance
        self.discovery = PressEvidence(instance) if self._is_hidden else None
        self._env = EscapeRoomEnv(instance=instance)
        recorder = StateRecorder(self._env)
        recorder.on_step = self._note
        self._options = OptionsEnv(recorder)
        self.names = self._options.action_names
        self.primitive_count = len(self._env.rules.actions)
        self.option_names = self.names[self.primitive_count :]
        self.reset()

    # --- moves ---------------------------------------------------------------------------------

    def reset(self) -> None:
        """Begin the same episode again."""
        self._options.reset(seed=self.seed)
        self.moves: list[PlayedMove] = []
        self.running: list[PrimitiveStep] = []
        self.start = self._env.get_state()

    def enter_next_room(self) -> None:
        """Enter the configuration's next room; `UnsupportedError` where the room came without one, from a file."""
        if self.config is None or self.instance.seed is None:
            raise UnsupportedError("there is no next room: this one was loaded from a file, without its configuration")
        following = generate(self.config, self.instance.seed + 1)
        self._env.close()
        self._open(following)

    def do(self, action: int) -> PlayedMove | None:
        """Run a primitive, or a meta-action to its end; None if it is not legal now."""
        if not self.is_legal(action):
            return None
        self.running = []
        *_, info = self._options.step(action)
        option, steps = info["option"], tuple(self.running)
        self.running = []
        self.moves.append(PlayedMove(option["name"], steps, option["ended"], option["reason"]))
        return self.moves[-1]

    def undo(self) -> PlayedMove | None:
        """Take the last move back, to the exact state before it; None if there is none."""
        if not self.moves:
            return None
        move = self.moves.pop()
        self._env.set_state(move.steps[0].before)
        self._options.resume()
        return move

    def replay(self, saved: SavedEpisode) -> None:
        """Replay a saved episode by its primitives, each move to be undone; `EpisodeFileError` where it differs."""
        for name, primitives, ended in saved.moves:
            steps: list[PrimitiveStep] = []
            for primitive in primitives:
                if self.is_over:
                    raise EpisodeFileError("the episode is over before its recorded end")
                self.running = steps
                self._options.step(primitive)
            self.running = []
            self.moves.append(PlayedMove(name, tuple(steps), ended))
        if abs(self.total - saved.total) > 1e-6:
            raise EpisodeFileError(f"the replay returns {self.total:g}, the file says {saved.total:g}")
        if saved.end is not None and self.end is not saved.end:
            raise EpisodeFileError(f"the replay ends {self.end.value}, the file says {saved.end.value}")

    def close(self) -> None:
        """Close the room's environment; the moves so far stay readable."""
        self._env.close()

    def _note(self, step: PrimitiveStep) -> None:
        self.running.append(step)
        if self.discovery is not None:
            self.discovery.note(step)
        if self.on_step is not None:
            self.on_step(step)

    # --- status --------------------------------------------------------------------------------

    @property
    def state(self) -> RoomState:
        """State of the room after the last primitive."""
        return self._env.get_state()

    @property
    def steps(self) -> list[PrimitiveStep]:
        """All primitives since the episode began, those of the move in progress included."""
        return [*(step for move in self.moves for step in move.steps), *self.running]

    @property
    def states(self) -> list[RoomState]:
        """All states since the episode began, the first one included."""
        return [self.start, *(step.after for step in self.steps)]

    @property
    def total(self) -> float:
        """Undiscounted return so far."""
        return float(sum(step.reward for step in self.steps))

    @property
    def is_over(self) -> bool:
        """The robot escaped, the puzzle was failed, or the horizon is reached."""
        return self.end.is_over

    @property
    def end(self) -> EpisodeEnd:
        """End of the episode; `STOPPED` while it goes on."""
        return EpisodeEnd.STOPPED if self._last is None else self._last.end

    @property
    def _last(self) -> PrimitiveStep | None:
        return self.running[-1] if self.running else self.moves[-1].steps[-1] if self.moves else None

    def is_legal(self, action: int) -> bool:
        """True if the episode goes on and a primitive or meta-action can start now."""
        return not self.is_over and bool(self._options.action_masks()[action])

    def to_saved(self) -> SavedEpisode:
        """Content of this episode's file."""
        moves = tuple((m.name, tuple(step.primitive for step in m.steps), m.ended) for m in self.moves)
        return SavedEpisode(self.instance, self.seed, moves, self.total, self.end)
