"""An episode that a person plays: primitives, meta-actions, undo, the next room, and its file.

The module is independent of pages and keys. Undo restores the exact state before the last move, however many primitives
it ran. A file contains the room, the seed and every primitive, as JSON.

On a graph of buttons, presses are evidence: they make some edges certain and rule out others. A button that turns on
shows that all its parents were on; one that stays off, that some parent was off. Evidence is only collected if presses
have no other effect, which excludes buttons that can be turned off and buttons that lock others.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Collection, Sequence
from contextlib import closing
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
from hrl_escape.text.recordings import Game, record_game
from hrl_escape.text.text_env import RoomSession

SCHEMA = 3


@dataclasses.dataclass(frozen=True)
class SavedEpisode:
    """Content of an episode's file."""

    instance: RoomInstance  # the room
    seed: int  # seed of the episode
    moves: tuple[tuple[str, tuple[int, ...], str], ...]  # name, primitives and ending of each move, in order
    total: float  # undiscounted return
    end: EpisodeEnd | None
    """End of the episode, or None if the file comes from a version that only stored whether the robot escaped."""

    @property
    def primitives(self) -> tuple[int, ...]:
        """All primitives in order."""
        return tuple(primitive for _, primitives, _ in self.moves for primitive in primitives)

    @property
    def file_name(self) -> str:
        """Default name of the file: room, instance seed, number of primitives, and a hash of the episode."""
        content = json.dumps([self.instance.id, self.seed, self.moves])
        key = hashlib.sha256(content.encode()).hexdigest()[:8]
        room = make_file_name(f"{self.instance.name}-{self.instance.seed}")
        return f"{room}-{len(self.primitives)}-primitives-{key}.json"


def save_episode(path: str | Path, saved: SavedEpisode) -> None:
    """Write an episode as JSON atomically."""
    moves: Sequence[dict[str, Any]] = [
        {"name": name, "primitives": list(primitives), "ended": ended} for name, primitives, ended in saved.moves
    ]
    write_json(path, {"schema": SCHEMA, "kind": "episode", "seed": saved.seed, "return": saved.total,
                      "end": saved.end and saved.end.value, "primitives": len(saved.primitives), "moves": moves,
                      "instance": saved.instance.to_dict()})


def load_episode(path: str | Path) -> SavedEpisode:
    """Read an episode.

    Raises:
        EpisodeFileError: the file is damaged, or is not an episode.
        FileReadError: the file is missing, or not JSON.
    """
    content = read_json(path, "recorded episode")
    try:
        if not isinstance(content, dict) or content.get("kind") != "episode":
            raise EpisodeFileError("no recorded episode. Save one with the Save button of hrl-escape play")
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
    """Evidence on the graph from the presses in one room, over all its episodes."""

    def __init__(self, instance: RoomInstance) -> None:
        self._puzzle = instance.puzzle
        self._possible: dict[int, frozenset[int]] = {}
        self._failed: dict[int, set[frozenset[int]]] = {}

    def note(self, step: PrimitiveStep) -> None:
        """Record the presses of a primitive."""
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
        """Return the certain edges (parent, child), and all possible ones, of buttons that turned on."""
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

    name: str  # name of the primitive or option
    steps: tuple[PrimitiveStep, ...]  # executed primitives
    ended: str = "reached"  # value of `info["option"]["ended"]`
    reason: str = ""  # reason of a failed plan, otherwise empty


class Episode:
    """One room being played; the seed fixes the start and the noise.

    The room configuration, `config`, is needed to enter the next room. If `is_hidden`, the player has to discover the
    graph.

    Attributes:
        instance: current room.
        discovery: evidence on a graph that has to be discovered, or None if the graph is shown.
        is_first_try: whether the episode is the first in its room, without a move taken back, so that a recording
            compares with an agent's episode.
        moves: all moves since the episode began.
        running: number of primitives of the current move so far.
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
        self.is_first_try = True

    # --- moves ---------------------------------------------------------------------------------

    def reset(self) -> None:
        """Restart the same episode."""
        self._options.reset(seed=self.seed)
        self.is_first_try = False
        self.moves: list[PlayedMove] = []
        self.running: list[PrimitiveStep] = []
        self.start = self._env.get_state()

    def enter_next_room(self) -> None:
        """Enter the configuration's next room. Raises `UnsupportedError` for a room from a file."""
        if self.config is None or self.instance.seed is None:
            raise UnsupportedError("this room was loaded from a file without its configuration, and has no next room")
        following = generate(self.config, self.instance.seed + 1)
        self._env.close()
        self._open(following)

    def do(self, action: int) -> PlayedMove | None:
        """Run a primitive, or a meta-action to its end; return None if it is not legal now."""
        if not self.is_legal(action):
            return None
        self.running = []
        *_, info = self._options.step(action)
        option, steps = info["option"], tuple(self.running)
        self.running = []
        self.moves.append(PlayedMove(option["name"], steps, option["ended"], option["reason"]))
        return self.moves[-1]

    def undo(self) -> PlayedMove | None:
        """Undo the last move, back to the exact state before it; return None if there is none."""
        if not self.moves:
            return None
        move = self.moves.pop()
        self.is_first_try = False
        self._env.set_state(move.steps[0].before)
        self._options.resume()
        return move

    def replay(self, saved: SavedEpisode) -> None:
        """Replay a saved episode by its primitives, as undoable moves. Raises `EpisodeFileError` if it differs."""
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
            raise EpisodeFileError(f"the replay returns {self.total:g}, the file states {saved.total:g}")
        if saved.end is not None and self.end is not saved.end:
            raise EpisodeFileError(f"the replay ends {self.end.value}, the file states {saved.end.value}")

    def close(self) -> None:
        """Close the room's environment. The moves so far stay readable."""
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
        """All primitives since the episode began, with the current move's."""
        return [*(step for move in self.moves for step in move.steps), *self.running]

    @property
    def states(self) -> list[RoomState]:
        """All states since the episode began, with the initial one."""
        return [self.start, *(step.after for step in self.steps)]

    @property
    def total(self) -> float:
        """Undiscounted return so far."""
        return float(sum(step.reward for step in self.steps))

    @property
    def is_over(self) -> bool:
        """True if the robot escaped, the puzzle failed, or the horizon was reached."""
        return self.end.is_over

    @property
    def end(self) -> EpisodeEnd:
        """End of the episode; `STOPPED` while it is running."""
        return EpisodeEnd.STOPPED if self._last is None else self._last.end

    @property
    def _last(self) -> PrimitiveStep | None:
        return self.running[-1] if self.running else self.moves[-1].steps[-1] if self.moves else None

    def is_legal(self, action: int) -> bool:
        """Return whether the episode is running and a primitive or meta-action can start now."""
        return not self.is_over and bool(self._options.action_masks()[action])

    def to_game(self) -> Game:
        """Return this episode as a game of tool calls, one a move, as a caller at level `places` would have played it.

        Raises:
            EpisodeFileError: the calls lead elsewhere than the moves did.
        """
        session = RoomSession(OptionsEnv(EscapeRoomEnv(instance=self.instance)), "places")
        with closing(session.env):
            session.reset(seed=self.seed)
            for move in self.moves:
                is_option = move.name in self.option_names
                session.call("run_option" if is_option else "move", {"option" if is_option else "primitive": move.name})
            if session.env.state != self.state:
                raise EpisodeFileError("the moves cannot be written as calls of options and primitives")
            return record_game(session)

    def to_saved(self) -> SavedEpisode:
        """Return the content of this episode's file."""
        moves = tuple((m.name, tuple(step.primitive for step in m.steps), m.ended) for m in self.moves)
        return SavedEpisode(self.instance, self.seed, moves, self.total, self.end)
