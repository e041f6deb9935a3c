"""Room configuration of a given room: the preset or rung that samples it."""

from __future__ import annotations

from collections.abc import Iterator

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark


def find_own_config(instance: RoomInstance) -> RoomConfig:
    """Find the room configuration of a room: the preset or rung of its name that samples its puzzle.

    Raises:
        UnsupportedError: no preset and no rung of that name samples the puzzle.
    """
    for config in _list_configs(instance.name):
        if instance.seed is not None and sample_puzzle(config, instance.seed)[1] == instance.puzzle:
            return config
    raise UnsupportedError(f"the configuration of room {instance.id} ({instance.name}) is not known: take a "
                           "preset, a rung of a benchmark, or an InstanceSet, which holds its configuration")


def _list_configs(name: str) -> Iterator[RoomConfig]:
    if name in PRESETS:
        yield get_preset(name)
    for benchmark in list_benchmarks():
        try:
            yield load_benchmark(benchmark)[name].config
        except UnknownNameError:
            continue
