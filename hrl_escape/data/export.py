"""Export of data sets: torch tensors, Minari data sets (Younis et al. 2024), OGBench files (Park et al. 2025).

Minari gets two sets of the same episodes, one of primitives and one of decisions. The `infos` of a decision hold its
duration, discount, discounted reward and legal actions; the first state has the same keys. OGBench gets a training file
and a validation file with every tenth trajectory.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from hrl_escape.agents.components.offline import Primitives, RecordedDecisions
from hrl_escape.agents.training.env_description import make_spec
from hrl_escape.data.materialise import DataLevel, DataSet
from hrl_escape.data.played_data import PlayedData
from hrl_escape.errors import MissingExtraError, UnsupportedError
from hrl_escape.files import atomic_writer

MINARI_FOLDER = "MINARI_DATASETS_PATH"
"""Environment variable with Minari's folder of data sets."""
VALIDATION = 10
"""One trajectory in this many is for validation."""


def to_torch(data: RecordedDecisions | Primitives) -> Any:
    """Return the data as tensors, which share memory where possible."""
    import torch

    kind: Any = type(data)
    return kind(*(torch.from_numpy(np.ascontiguousarray(field)) for field in data))


def iterate_trajectories(data: DataSet | PlayedData, level: DataLevel | None = None) -> Iterator[Any]:
    """Yield each trajectory as `Decisions` or `Primitives`, with one block in memory at a time."""
    for block in data.blocks(level):
        kind: Any = type(block)
        ends = np.flatnonzero(block.last) + 1
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):
            yield kind(*(field[begin:end] for field in block))


def import_minari() -> Any:
    """Import Minari.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import minari  # pyright: ignore[reportMissingImports]  # an extra
    except ImportError as error:
        raise MissingExtraError("minari", "data", "Minari's data sets") from error
    return minari


def to_minari(data: DataSet | PlayedData, namespace: str = "hrl_escape", folder: str | PathLike[str] | None = None
              ) -> tuple[Any, ...]:
    """Write the sets of decisions and primitives for Minari; returns the primitives first, if there are any.

    A data set of a rung becomes `NAMESPACE/RUNG/KIND-primitives-v1` and `-decisions-v1`. Their environments are
    `hrl_escape/Ladder-v1` over the rooms of the recording, and over its test rooms for evaluation. Reference scores are
    the returns of the random policy over options and the best known return.

    Own play becomes `NAMESPACE/NAME-primitives-v1` and `-decisions-v1`. Each set holds a description of its
    environment, from which `recover_environment` makes it again.

    Args:
        data: the data set, or what `record_play` returned.
        namespace: first part of the sets' names.
        folder: folder of data sets, as `MINARI_DATASETS_PATH`, or None for Minari's default.

    Raises:
        MissingExtraError: Minari is not installed.
        UnsupportedError: the environment cannot be made again: rooms of no rung, or options that are not a function of
            a module.
    """
    minari = import_minari()
    with using_minari_folder(folder):
        if isinstance(data, PlayedData):
            return tuple(_write_play(minari, data, level, namespace) for level in ("primitives", "decisions")
                         if level == "decisions" or data.primitives is not None)
        if data.recording.rooms.place is None:
            raise UnsupportedError(f"{data.name} has rooms of no rung, so that no id makes its environment again: "
                                   "export it to OGBench's files or to tensors")
        return tuple(_write_rung(minari, data, level, namespace) for level in ("primitives", "decisions"))


def _write_rung(minari: Any, data: DataSet, level: DataLevel, namespace: str) -> Any:
    """Write a level of a data set of a rung."""
    about, scores = data.recording.about, data.recording.about["scores"]
    place = f"{namespace}/{data.recording.rooms.place['rung']}/{about['kind']}"  # type: ignore[index]  # a rung
    has_options = level == "decisions" and len(about["actions"]) > data.recording.primitive_count
    options: Any = {"include_primitives": data.recording.primitive_count > 0} if has_options else False
    env, test = (rooms.make_env(options, observation=data.observation)
                 for rooms in (data.recording.rooms, data.test_rooms))
    made = minari.create_dataset_from_buffers(
        f"{place}-{level}-v1", _make_buffers(minari, data, level), env=env.spec, eval_env=test.spec,
        algorithm_name=about["kind"], author="hrl-escape", author_email="none@example.org",
        code_permalink=about["command"],
        description=f"{data.name}, {level} of the same trajectories; recording {data.recording.digest}",
        ref_min_score=scores.get("chance"), ref_max_score=scores.get("best_known"), num_episodes_average_score=20,
        observation_space=env.observation_space, action_space=env.action_space, requirements=["hrl-escape"])
    env.close()
    test.close()
    return made


def _write_play(minari: Any, data: PlayedData, level: DataLevel, namespace: str) -> Any:
    """Write a level of own play."""
    env = data.make_env(level == "decisions", data.gamma)
    spec = make_spec(env)
    return minari.create_dataset_from_buffers(
        f"{namespace}/{data.name}-{level}-v1", _make_buffers(minari, data, level), env=spec,
        eval_env=spec, algorithm_name="played", author="hrl-escape", author_email="none@example.org",
        code_permalink="hrl_escape.data.record_play", description=f"{data!r}, {level}",
        observation_space=env.observation_space, action_space=env.action_space, requirements=["hrl-escape"])


def _make_buffers(minari: Any, data: DataSet | PlayedData, level: DataLevel) -> list[Any]:
    kind = minari.data_collector.EpisodeBuffer
    return [_make_buffer(kind, number, part) for number, part in enumerate(iterate_trajectories(data, level))]


@contextmanager
def using_minari_folder(folder: str | PathLike[str] | None) -> Iterator[None]:
    """Set Minari's folder of data sets temporarily, unless it is None."""
    before = os.environ.get(MINARI_FOLDER)
    if folder is not None:
        os.environ[MINARI_FOLDER] = str(Path(folder).absolute())
    try:
        yield
    finally:
        if before is not None:
            os.environ[MINARI_FOLDER] = before
        else:
            os.environ.pop(MINARI_FOLDER, None)


def _make_buffer(kind: Any, number: int, part: Any) -> Any:
    """Make the buffer of one trajectory, with one more row of observations and infos than of actions."""
    observations = np.concatenate([part.observation, part.next_observation[-1:]])
    over, last = part.terminated, part.last
    if isinstance(part, Primitives):
        infos = {"option": np.concatenate([[-1], part.option]), "begins": np.concatenate([[False], part.begins])}
        rewards = part.reward
    else:
        rewards = part.summed_reward
        infos = {
            "duration": np.concatenate([[0], part.duration]), "discount": np.concatenate([[1.0], part.discount]),
            "discounted_reward": np.concatenate([[0.0], part.reward]),
            "action_mask": np.concatenate([part.mask, part.next_mask[-1:]]).astype(np.int8),
            "ended": np.concatenate([[-1], part.ended]),
        }
    return kind(id=number, observations=observations, actions=part.action, rewards=rewards.tolist(),
                terminations=over.tolist(), truncations=(last & ~over).tolist(), infos=infos)


def to_ogbench(data: DataSet, folder: str | PathLike[str]) -> tuple[Path, Path]:
    """Write `NAME.npz` and `NAME-val.npz` in the format of OGBench's loader; returns the two paths.

    Every tenth trajectory is for validation, or the last of fewer than ten. A trajectory has one row per state: float32
    `observations`, `actions`, and `terminals`, which is 1 in the last row. Further arrays are `rewards`, `masks` (0 at
    terminations, 1 at truncations) and, for decisions, `durations`, `discounts` and `action_masks`.

    Raises:
        UnsupportedError: there is only one trajectory, so none for validation.
    """
    split: list[dict[str, list[Any]]] = [{}, {}]
    for number, part in enumerate(iterate_trajectories(data)):
        rows = _make_rows(part)
        for name, values in rows.items():
            split[number % VALIDATION == VALIDATION - 1].setdefault(name, []).append(values)
    training, validation = split
    if not validation:
        validation.update({name: [values.pop()] for name, values in training.items() if len(values) > 1})
    if not validation:
        raise UnsupportedError(f"{data.name} has one trajectory or none, and OGBench's format wants two or more: one "
                               "is for validation")
    paths = Path(folder) / f"{data.name}.npz", Path(folder) / f"{data.name}-val.npz"
    for path, parts in zip(paths, split, strict=True):
        arrays = {name: np.concatenate(values) for name, values in parts.items()}
        with atomic_writer(path) as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)  # pyright: ignore[reportArgumentType]
    return paths


def _make_rows(part: Any) -> dict[str, Any]:
    """Return the arrays of one trajectory, one row per state."""
    count = len(part.action)
    observations = np.concatenate([part.observation, part.next_observation[-1:]])
    rows = {"observations": observations.reshape(count + 1, -1), "actions": np.append(part.action, 0),
            "terminals": np.arange(count + 1) == count, "rewards": np.append(part.reward, 0.0),
            "masks": np.append(~part.terminated, True)}
    if isinstance(part, RecordedDecisions):
        rows |= {"durations": np.append(part.duration, 0), "discounts": np.append(part.discount, 1.0),
                 "action_masks": np.concatenate([part.mask, part.next_mask[-1:]])}
    return {name: np.asarray(values, np.float32) for name, values in rows.items()}
