"""One cell of a comparison: make the room, train the agent, keep its numbers and its last episodes.

`run_cell` leaves `cell.json` once everything else is on disk, so a folder that has it is finished.
Which cells there are is `grid.py`; starting and watching them is `launcher.py`.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.evaluation import Evaluation, compute_episode_seed
from hrl_escape.agents.results import TrainResult
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import FileReadError
from hrl_escape.experiments.grid import AgentSpec, Cell
from hrl_escape.experiments.replays import StateRecorder, record_episode
from hrl_escape.experiments.scale import Scale, measure_scale
from hrl_escape.experiments.statistics import compute_final
from hrl_escape.files import read_json, write_json

__all__ = ["CellResult", "get_cell_folder", "get_room_file", "make_env", "read_cell", "run_cell"]

RECORDED_VERSIONS = ("hrl-escape", "gymnasium", "numpy", "torch", "torchrl", "pybullet", "ompl", "pin")


@dataclass(frozen=True)
class CellResult:
    """What one run left; whose it is, its `Cell` says.

    Attributes:
        budget: primitives it was to train for; where decisions ended it, those it did train for.
        primitives: trained for; a last option may carry it beyond the budget.
        decisions: trained for.
        episodes: trained for.
        planner_calls: behind options, in training.
        evaluations: the first before training, the last after it.
        seconds: of training when each evaluation was made; left out of comparisons.
        scale: what its scores are measured by.
        planner_seconds: of training, in planners; left out of comparisons.
        versions: of the packages that made it; left out of comparisons.
    """

    budget: int
    primitives: int
    decisions: int
    episodes: int
    planner_calls: int
    evaluations: tuple[Evaluation, ...]
    scale: Scale
    seconds: tuple[float, ...] = dataclasses.field(compare=False)
    planner_seconds: float = dataclasses.field(compare=False)
    versions: Mapping[str, str] = dataclasses.field(compare=False)

    @classmethod
    def make(cls, budget: int, result: TrainResult, scale: Scale) -> CellResult:
        """From a finished training run."""
        return cls(
            budget, result.primitives, result.decisions, len(result.episodes), result.planner_calls, result.evaluations,
            scale, tuple(result.curve(against="seconds")[0].tolist()), result.planner_seconds, find_versions(),
        )

    def get_curve(self, metric: str) -> NDArray[np.float64]:
        """`primitives`, `decisions`, `seconds`, or a mean of `Evaluation`, at every evaluation: (evaluations,)."""
        if metric == "seconds":
            return np.array(self.seconds)
        return np.array([getattr(evaluation, metric) for evaluation in self.evaluations], dtype=np.float64)

    def get_final(self, metric: str) -> float:
        """What a mean of `Evaluation` comes to; see `compute_final`."""
        return compute_final(self.get_curve("primitives"), self.get_curve(metric), self.budget)

    @property
    def is_stuck(self) -> bool:
        """No evaluation episode succeeded in the last fifth of the budget."""
        return self.get_final("success_rate") == 0.0


def make_env(agent: AgentSpec, instance: RoomInstance, observation: str) -> tuple[gymnasium.Env, StateRecorder]:
    """The environment an agent acts in, and the recorder inside it."""
    import hrl_escape  # noqa: F401  # registers the environment

    flat = gymnasium.make("hrl_escape/EscapeRoom-v0", instance=instance, observation=observation,
                          disable_env_checker=True)
    recorder = StateRecorder(flat)
    if not agent.chooses_options:
        return recorder, recorder
    from hrl_escape.options.options_env import OptionsEnv  # brings the planners in

    return OptionsEnv(recorder, trace=agent.needs_trace, **agent.options.to_dict()), recorder


def run_cell(cell: Cell, out: Path, checkpoint_seconds: float) -> None:
    """Run a cell to its end, going on where an earlier try was stopped.

    Args:
        cell: which.
        out: the comparison's folder; it holds the room.
        checkpoint_seconds: between checkpoints of the training run.
    """
    from hrl_escape.agents.training import train

    folder = get_cell_folder(out, cell)
    instance = RoomInstance.load(get_room_file(out, cell.instance_id))
    env, recorder = make_env(cell.agent, instance, cell.grid.observation)
    try:
        result = train(
            cell.agent.name, env, primitives=cell.grid.primitives, decisions=cell.grid.decisions, seed=cell.seed,
            settings=cell.settings, eval_every=cell.grid.evaluation_step, eval_episodes=cell.grid.eval_episodes,
            eval_seed=cell.eval_seed, out=folder / "run", checkpoint_seconds=checkpoint_seconds, progress=False,
        )
        assert result.agent is not None, "a run that this process finished or loaded has its agent"
        seeds = [compute_episode_seed(cell.eval_seed, "evaluation", n) for n in range(cell.grid.eval_episodes)]
        episodes, starts = [], []
        for seed in seeds:
            episodes.append(record_episode(result.agent, env, recorder, seed))
            starts.append(recorder.states[0])
        scale = measure_scale(instance, cell.agent, starts)
    finally:
        env.close()
    write_json(folder / "episodes.json", episodes, indent=None)
    value = dataclasses.asdict(CellResult.make(min(cell.grid.primitives, result.primitives), result, scale))
    write_json(folder / "cell.json", {"identity": cell.identity, "result": value}, indent=None)


def read_cell(out: Path, cell: Cell) -> CellResult | None:
    """The result of a finished cell, or None if it is not finished.

    Raises:
        FileReadError: the file is damaged or belongs to another run.
    """
    path = get_cell_folder(out, cell) / "cell.json"
    if not path.exists():
        return None
    value = read_json(path, "result of a run")
    try:
        if value["identity"] != cell.identity:
            raise FileReadError(f"{path}: this result belongs to another run than its folder's name says")
        found = value["result"]
        evaluations = tuple(Evaluation.from_json(evaluation) for evaluation in found["evaluations"])
        scale = Scale.from_json(found["scale"])
        return CellResult(**{**found, "scale": scale, "evaluations": evaluations, "seconds": tuple(found["seconds"])})
    except (KeyError, TypeError, AttributeError) as error:
        raise FileReadError(f"{path}: this result of a run is damaged ({error!r})") from error


def read_episodes(out: Path, cell: Cell) -> list[dict[str, Any]]:
    """The recorded episodes of a finished cell; see `record_episode`.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    return read_json(get_cell_folder(out, cell) / "episodes.json", "record of episodes")


def get_cell_folder(out: Path, cell: Cell) -> Path:
    """Where a cell keeps its files."""
    return out / "cells" / cell.folder


def get_room_file(out: Path, instance_id: str) -> Path:
    """Where a comparison keeps a room."""
    return out / "rooms" / f"{instance_id}.json"


def find_versions() -> dict[str, str]:
    """Versions of what decides the numbers."""
    versions = {"python": platform.python_version()}
    for name in RECORDED_VERSIONS:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed as a package"
    return versions
