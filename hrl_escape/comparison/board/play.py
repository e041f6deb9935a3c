"""Cells of a submission: played to be submitted, and played again to be verified, each alone and to the same bits."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent, read_success
from hrl_escape.agents.training.archive import pack_run, unpack_run
from hrl_escape.agents.training.evaluation import compute_episode_seed, play_episode
from hrl_escape.agents.training.results import load_result
from hrl_escape.agents.training.run_folder import read_run
from hrl_escape.agents.training.train import load_agent
from hrl_escape.comparison.board.program import ProgramAgent, describe_command
from hrl_escape.comparison.board.submission import (
    HIDDEN_ROOMS,
    RUN,
    Card,
    Cell,
    Entry,
    RoomView,
    Submission,
    describe_package,
    read_submission,
    write_submission,
)
from hrl_escape.comparison.episodes import StateRecorder
from hrl_escape.comparison.grid import AgentSpec, OptionsView
from hrl_escape.comparison.references.registry import REFERENCES, make_reference
from hrl_escape.comparison.runs import make_env
from hrl_escape.comparison.score_range import compute_score_range
from hrl_escape.errors import CheckpointError, ConfigError, TrustError, UnsupportedError, show_value
from hrl_escape.files import read_bytes
from hrl_escape.ladder.hidden import read_beacon
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.ladder.rung import Rung
from hrl_escape.settings import replace_settings

_DEFAULTS = {"options": None, "discounted_reward": False, "observation": "pass", "planner": "auto"}
"""Arguments of `OptionsEnv` that a view leaves at their defaults."""


class CheckedCell(NamedTuple):
    """A cell of a submission, and what playing its room again gave."""

    stated: Cell
    found: Cell

    @property
    def is_equal(self) -> bool:
        """Equal to the last bit."""
        return self.stated == self.found


def read_view(described: Mapping[str, Any]) -> RoomView:
    """View that a described run gave its agent; `UnsupportedError` where a wrapper could change what counts."""
    env, options, memory = described["environment"], None, False
    try:
        for wrapper in env["wrappers"]:
            kind, given = wrapper["class"].rpartition(":")[2], wrapper["arguments"]
            if kind == "OptionsEnv" and options is None and _DEFAULTS.items() <= given.items():
                names = {field.name for field in dataclasses.fields(OptionsView)} - {"memory"}
                options = OptionsView(**{name: given[name] for name in names})
            elif kind == "DecisionMemory" and options is not None:
                memory = True
            elif kind != "RoomSchedule":
                raise UnsupportedError(f"a run with {kind} around its room cannot be submitted: a board knows rooms "
                                       "with OptionsEnv, of the package's own options, and DecisionMemory")
        seen = env["arguments"]["observation"]
        return RoomView(seen, "primitives") if options is None else RoomView(
            seen, options=dataclasses.replace(options, memory=memory))
    except (KeyError, TypeError, AttributeError) as error:
        raise UnsupportedError("this run was not made in rooms of this package, so that it cannot be submitted"
                               ) from error


def make_view_env(view: RoomView, rooms: InstanceSet, schedule: Mapping[str, int] | None = None
                  ) -> tuple[gymnasium.Env, StateRecorder]:
    """Environment over a set of rooms as a view shows it; see `make_env`."""
    name = "smdp-random" if view.choices == "options" else "random"
    return make_env(AgentSpec(name, options=view.options), rooms, view.observation, schedule)


def play_cells(entry: Entry, folder: Path, rooms: InstanceSet, role: str, numbers: Iterable[int], trust: bool = False
               ) -> Iterator[Cell]:
    """Play an episode in each of some rooms of a set; which others are played makes no difference.

    Raises:
        TrustError: the agent is a program, and is not trusted.
        ContractError: the program does not answer as agreed.
    """
    seeds = {number: compute_episode_seed(0, "evaluation" if role == "test" else role, number) for number in numbers}
    env, recorder = make_view_env(entry.card.view, rooms, {str(seed): number for number, seed in seeds.items()})
    room: Any = env.unwrapped
    with closing(env), _opening(entry, folder, env, recorder, trust) as player, tempfile.TemporaryDirectory() as cache:
        for number, seed in seeds.items():
            primitives, decisions, total, escaped = 0, 0, 0.0, False
            for step, info in play_episode(player, env, seed):
                primitives, decisions, total = primitives + step.duration, decisions + 1, total + step.summed_reward
                escaped = read_success(info, step.terminated)
            known = compute_score_range([(room.instance, recorder.states[0])], AgentSpec(), Path(cache))
            yield Cell(role, number, escaped, primitives, decisions, total, float(known.fewest[0]))


@contextmanager
def _opening(entry: Entry, folder: Path, env: gymnasium.Env, recorder: StateRecorder, trust: bool) -> Iterator[Agent]:
    if not entry.agent:
        if not trust:
            raise TrustError([describe_command(entry.card)], "this submission would start")
        with ProgramAgent(entry.card, folder, getattr(env.observation_space, "words", ())) as program:
            yield program
    elif entry.agent in REFERENCES:
        yield make_reference(entry.agent, env, recorder)
    else:
        if not (folder / "run").exists():
            named = unpack_run(folder / RUN, folder / "run").described.get("name")
            if named != entry.agent:
                raise CheckpointError(f"this submission is of {show_value(entry.agent)}, and its run trained "
                                      f"{show_value(named)}")
        yield load_agent(folder / "run", env)


def pack_submission(path: Path, rung: Rung, card: Card, source: str = "", files: Path = Path(),
                    rooms: int | None = None, beacon: str = "") -> Submission:
    """Test a frozen agent in a rung's rooms, and write the submission.

    Args:
        path: the file to write.
        rung: of a benchmark.
        card: of the agent; view and costs of a run are filled in from the run.
        source: folder of a training run, or a reference such as `smdp-untried-nearest`; empty for the card's program.
        files: folder of the program's files.
        rooms: number of test rooms, from the first; all by default.
        beacon: round that decides the hidden test, which the benchmark has announced; empty for no hidden test.

    Raises:
        ConfigError: an impossible number of rooms, or a round that was not announced.
        UnsupportedError: the run's environment is none that a board knows.
    """
    count = rung.record.test.count if rooms is None else rooms
    if not 1 <= count <= rung.record.test.count:
        raise ConfigError("rooms", count, f"from 1 to {rung.record.test.count}, the test rooms of {rung.name}")
    if beacon and rung.hidden_round is None:
        raise ConfigError("beacon", beacon, f"none, for {rung.benchmark} has announced no round")
    if bool(source) == bool(card.command):
        raise ConfigError("source", source, "a run or a reference, or a command in the card: one of the two")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        if source in REFERENCES:
            agent, parts = source, {}
        elif source:
            agent, card = read_run(source)["name"], _fill_in(card, Path(source))
            pack_run(source, folder / RUN, is_frozen=True)
            parts = {RUN: folder / RUN}
        else:
            agent, parts = "", {name: read_bytes(files / name, "file of a program") for name in card.files}
            for name, content in parts.items():
                (folder / name).write_bytes(content)
        entry = Entry(card, agent, rung.benchmark, rung.name, rung.record.test.root, count,
                      str(read_beacon(beacon)) if beacon else "", describe_package())
        cells = [cell for role, tested in _list_sets(entry, rung).items()
                 for cell in play_cells(entry, folder, tested, role, range(len(tested)), trust=True)]
        return write_submission(path, entry, cells, parts)


def _fill_in(card: Card, folder: Path) -> Card:
    """Card with what a run says itself: how rooms looked, and its cost where the run is finished."""
    card = dataclasses.replace(card, view=read_view(read_run(folder)))
    if not (folder / "result.json").exists():
        return card
    result = load_result(folder)
    return replace_settings(card, {"primitives": result.primitives, "core_hours": round(result.seconds / 3600, 4)})


def _list_sets(entry: Entry, rung: Rung) -> dict[str, InstanceSet]:
    hidden = {"hidden": rung.make_hidden_test(entry.beacon, HIDDEN_ROOMS)} if entry.beacon else {}
    return {"test": rung.test[: entry.rooms]} | hidden


def verify_cells(path: Path, rung: Rung, count: int, seed: int, trust: bool = False) -> list[CheckedCell]:
    """Play some cells of a submission again, drawn by a seed that whoever submits must not know.

    Raises:
        TrustError: it is needed, and not given; nothing was started.
        CheckpointError: the submission is damaged.
        ContractError: the program does not answer as agreed.
    """
    with tempfile.TemporaryDirectory() as made:
        submission = read_submission(path, Path(made))
        drawn = draw_cells(submission.cells, count, seed)
        found = {}
        for role, rooms in _list_sets(submission.entry, rung).items():
            numbers = [cell.room for cell in drawn if cell.set == role]
            if numbers:
                found |= {(role, cell.room): cell
                          for cell in play_cells(submission.entry, Path(made), rooms, role, numbers, trust)}
        return [CheckedCell(cell, found[cell.set, cell.room]) for cell in drawn]


def draw_cells(cells: Sequence[Cell], count: int, seed: int) -> list[Cell]:
    """Draw different cells, in order."""
    if not 1 <= count <= len(cells):
        raise ConfigError("cells", count, f"from 1 to {len(cells)}, those of the submission")
    return [cells[number] for number in sorted(np.random.default_rng(seed).choice(len(cells), count, replace=False))]
