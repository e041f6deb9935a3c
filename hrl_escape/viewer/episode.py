"""An episode that a person plays: moves, meta-actions, undo, another room, and a file to keep it in.

It knows no page and no keys: browser, window and terminal all play one of these. Undo gives
back the exact state before the last move, however many primitives that move was.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.generation import generate
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EpisodeFileError, EscapeError, FileReadError, UnsupportedError
from hrl_escape.files import read_json, write_json
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.viewer.tap import Step, Tap

__all__ = ["Episode", "Move", "SavedEpisode", "load_episode", "save_episode"]

SCHEMA = 1


@dataclasses.dataclass(frozen=True)
class Move:
    """One decision: a primitive, or a meta-action that ran to its end.

    Attributes:
        name: of the primitive or option.
        steps: the primitives that ran.
        ended: how it ended, as in `info["option"]["ended"]`.
        reason: why planning failed, else empty.
    """

    name: str
    steps: tuple[Step, ...]
    ended: str = "reached"
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class SavedEpisode:
    """What a file of an episode holds.

    Attributes:
        instance: the room.
        seed: of the episode.
        moves: name, primitives and how it ended, of each decision in order.
        total: undiscounted return that it had.
        escaped: whether it ended in the exit.
    """

    instance: RoomInstance
    seed: int
    moves: tuple[tuple[str, tuple[int, ...], str], ...]
    total: float
    escaped: bool

    @property
    def primitives(self) -> tuple[int, ...]:
        """All primitives in order."""
        return tuple(primitive for _, primitives, _ in self.moves for primitive in primitives)


class Episode:
    """One room being played.

    Args:
        instance: the room.
        config: the schematic it comes from, for going on to the next room; None if there is none.
        seed: of the episode: which start, which noise.

    Attributes:
        instance: the room now.
        moves: what was done since the episode began.
        running: primitives so far of the move that is being made now.
        on_step: called after every primitive.
    """

    def __init__(self, instance: RoomInstance, config: RoomConfig | None = None, seed: int = 0) -> None:
        self.config, self.seed = config, seed
        self.on_step: Callable[[Step], None] | None = None
        self._open(instance)

    def _open(self, instance: RoomInstance) -> None:
        self.instance = instance
        self._env = EscapeRoomEnv(instance=instance)
        tap = Tap(self._env)
        tap.on_step = self._note
        self._options = OptionsEnv(tap)
        self.names = self._options.action_names
        self.primitive_count = len(self._env.rules.primitives)
        self.option_names = self.names[self.primitive_count :]
        self.reset()

    # --- what can be done --------------------------------------------------------------------

    def reset(self) -> None:
        """Begin the same episode again."""
        self._options.reset(seed=self.seed)
        self.moves: list[Move] = []
        self.running: list[Step] = []
        self.start = self._env.get_state()

    def go_on(self) -> None:
        """Enter the next room of the schematic.

        Raises:
            UnsupportedError: the room came from a file, without its schematic.
        """
        if self.config is None or self.instance.seed is None:
            raise UnsupportedError("there is no next room: this one was loaded from a file, without its schematic")
        following = generate(self.config, self.instance.seed + 1)
        self._env.close()
        self._open(following)

    def do(self, action: int) -> Move | None:
        """Run a primitive, or a meta-action to its end; None if the episode is over or it cannot start here."""
        if self.is_over or not self._options.action_masks()[action]:
            return None
        self.running = []
        *_, info = self._options.step(action)
        option, steps = info["option"], tuple(self.running)
        self.running = []
        self.moves.append(Move(option["name"], steps, option["ended"], option["reason"]))
        return self.moves[-1]

    def undo(self) -> Move | None:
        """Take the last move back, to the exact state before it; None if there is none."""
        if not self.moves:
            return None
        move = self.moves.pop()
        self._env.set_state(move.steps[0].before)
        self._options.resume()
        return move

    def replay(self, saved: SavedEpisode) -> None:
        """Do again what a file says, primitive by primitive; afterwards each of its decisions can be undone.

        Raises:
            EpisodeFileError: it does not play out as the file says.
        """
        for name, primitives, ended in saved.moves:
            steps: list[Step] = []
            for primitive in primitives:
                if self.is_over:
                    raise EpisodeFileError("the episode is over before its recorded end")
                self.running = steps
                self._options.step(primitive)
            self.running = []
            self.moves.append(Move(name, tuple(steps), ended))
        if abs(self.total - saved.total) > 1e-6 or self.escaped != saved.escaped:
            raise EpisodeFileError(f"played again it returns {self.total:g}, the file says {saved.total:g}")

    def close(self) -> None:
        """Free the engine."""
        self._env.close()

    def _note(self, step: Step) -> None:
        self.running.append(step)
        if self.on_step is not None:
            self.on_step(step)

    # --- how it stands -------------------------------------------------------------------------

    @property
    def state(self) -> RoomState:
        """The state now."""
        return self._env.get_state()

    @property
    def steps(self) -> list[Step]:
        """All primitives since the episode began, those of a move that is being made included."""
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
        """The robot escaped, or time is up."""
        last = self._last
        return last is not None and (last.terminated or last.truncated)

    @property
    def escaped(self) -> bool:
        """The robot escaped."""
        return self._last is not None and self._last.terminated

    @property
    def _last(self) -> Step | None:
        return self.running[-1] if self.running else self.moves[-1].steps[-1] if self.moves else None

    def is_legal(self, action: int) -> bool:
        """Say whether a primitive or meta-action can be done now."""
        return not self.is_over and bool(self._options.action_masks()[action])

    def to_saved(self) -> SavedEpisode:
        """What there is to keep."""
        moves = tuple((m.name, tuple(step.primitive for step in m.steps), m.ended) for m in self.moves)
        return SavedEpisode(self.instance, self.seed, moves, self.total, self.escaped)


def save_episode(path: str | Path, saved: SavedEpisode) -> None:
    """Write an episode as JSON, atomically."""
    moves: Sequence[dict[str, Any]] = [
        {"name": name, "primitives": list(primitives), "ended": ended} for name, primitives, ended in saved.moves
    ]
    write_json(path, {"schema": SCHEMA, "kind": "episode", "seed": saved.seed, "return": saved.total,
                      "escaped": saved.escaped, "primitives": len(saved.primitives), "moves": moves,
                      "instance": saved.instance.to_dict()})


def load_episode(path: str | Path) -> SavedEpisode:
    """Read an episode.

    Raises:
        EpisodeFileError: the file is damaged or holds something else.
        FileReadError: there is no such file, or it is no JSON.
    """
    content = read_json(path, "recorded episode")
    try:
        if not isinstance(content, dict) or content.get("kind") != "episode":
            raise EpisodeFileError("no recorded episode: save one with the Save button of hrl-escape play")
        if content["schema"] != SCHEMA:
            raise EpisodeFileError(f"it has schema {content['schema']!r}, this version reads {SCHEMA}")
        instance = RoomInstance.from_dict(content["instance"])
        count = 6 + 2 * instance.robot.joints
        moves = tuple((str(m["name"]), tuple(int(p) for p in m["primitives"]), str(m["ended"]))
                      for m in content["moves"])
        if any(not primitives or not all(0 <= p < count for p in primitives) for _, primitives, _ in moves):
            raise EpisodeFileError(f"its primitives are not all numbers from 0 to {count - 1}")
        return SavedEpisode(instance, int(content["seed"]), moves, float(content["return"]), bool(content["escaped"]))
    except FileReadError:
        raise
    except (EscapeError, KeyError, TypeError, ValueError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise EpisodeFileError(f"{path}: {reason}") from None
