"""Contenders of `benchmarks/batch.py`: built, stepped and timed."""

from __future__ import annotations

import dataclasses
import importlib.util
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.batched.tables import map_tensors
from hrl_escape.env.config import DynamicsConfig, ObstaclesConfig, RobotConfig, RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.velocities import Velocities

POOL = 16  # batches of random actions, drawn beforehand
SYNC_ROOMS = 8
CARTPOLE, XLAND, GYMNAX = "CartPole-v1", "XLand-MiniGrid-R1-9x9", "gymnax CartPole-v1"


@dataclasses.dataclass(frozen=True)
class BatchSettings:
    """Settings of our batches.

    Attributes:
        instances: number of different instances in a batch.
        observation: name of the observation.
        device: torch device.
        velocities: whether actions are velocities.
    """

    instances: int
    observation: str
    device: str
    velocities: bool = False


@dataclasses.dataclass
class Contender:
    """A batch of rooms that can be stepped, and its measurements.

    Attributes:
        name: name of the environment.
        engine: engine that steps it.
        rooms: number of rooms in the batch.
        step: runs a number of steps of the whole batch.
        build_seconds: time until it could step, compilation included, s.
        state_bytes: bytes of state of a room.
        moved_bytes: bytes that a step must at least read and write for a room; 0 if unknown.
        wall: best time of a step of the batch, s.
        cpu: best CPU time of a step of the batch, s.
        arithmetic_bound: steps a second if calls and memory were free, or None if it was not measured.
    """

    name: str
    engine: str
    rooms: int
    step: Callable[[int], None]
    build_seconds: float
    state_bytes: int = 0
    moved_bytes: int = 0
    wall: float = float("inf")
    cpu: float = float("inf")
    arithmetic_bound: float | None = None

    def measure(self, seconds: float) -> None:
        """Step for a while and keep the best times."""
        steps, spent = 1, 0.0
        while spent < seconds:
            wall, cpu = time.perf_counter(), time.process_time()
            self.step(steps)
            took = time.perf_counter() - wall
            self.wall, self.cpu = min(self.wall, took / steps), min(self.cpu, (time.process_time() - cpu) / steps)
            spent += took
            steps = max(1, min(1000, int(steps * 0.02 / max(took, 1e-6))))  # stretches of 20 ms

    def summarise(self, bandwidth: float) -> dict[str, Any]:
        """Results for table, plot and JSON; a bandwidth in bytes a second."""
        rate = self.rooms / self.wall
        memory_bound = bandwidth / self.moved_bytes if self.moved_bytes else None
        return {
            "name": self.name, "engine": self.engine, "rooms": self.rooms, "build_seconds": self.build_seconds,
            "steps_per_second": rate, "steps_per_cpu_second": self.rooms / max(self.cpu, 1e-9),
            "step_us": 1e6 * self.wall, "state_bytes": self.state_bytes, "moved_bytes": self.moved_bytes,
            "memory_bound": memory_bound, "arithmetic_bound": self.arithmetic_bound,
            "share_of_memory_bound": rate / memory_bound if memory_bound else None,
            "share_of_arithmetic_bound": rate / self.arithmetic_bound if self.arithmetic_bound else None,
        }


def set_arithmetic_bounds(contenders: Sequence[Contender]) -> None:
    """Find the arithmetic bound of every batch that was measured in more than one size.

    It is the best rate of the additional rooms of a batch over the next smaller one, which cancels the cost of a call.
    The smallest batch has no such rate.
    by their times, so that none is above the bound. Batches that take longer than a larger one are left out.
    """
    for one in contenders:
        others = [other for other in contenders if (other.name, other.engine) == (one.name, one.engine)]
        if len(others) < 2:
            continue
        rooms, wall, rates = 0, 0.0, []
        for other in sorted(others, key=lambda other: other.rooms):
            if all(other.wall < larger.wall for larger in others if larger.rooms > other.rooms):
                rates.append((other.rooms - rooms) / (other.wall - wall))
                rooms, wall = other.rooms, other.wall
        one.arithmetic_bound = max(rates)


def make_scene(name: str) -> RoomConfig:
    """Room configuration of a scene: a preset, or four buttons among ten rotated boxes, pressed by body or hand."""
    if name not in ("ten-obstacles", "ten-obstacles-by-hand"):
        return get_preset(name)
    by_hand = name == "ten-obstacles-by-hand"
    return RoomConfig(
        name=name,
        robot=RobotConfig(body_radius=0.5, joints=3 if by_hand else 0),
        puzzle=ButtonsConfig(count=4, graph=GraphConfig(kind="chain"), buttons=Panels(width=1.5)),
        obstacles=ObstaclesConfig(count=10, cylinder_share=0.0),
        dynamics=DynamicsConfig(press_with="hand" if by_hand else "body"),
    )


def list_makers(scenes: Sequence[str], sizes: Sequence[int], engines: Sequence[str], peers: bool,
                settings: BatchSettings) -> list[tuple[str, Callable[[], Contender]]]:
    """Name and builder of every contender.

    Args:
        scenes: names for `make_scene`.
        sizes: numbers of rooms in a batch.
        engines: `eager` or `compiled`.
        peers: include other environments.
        settings: settings of our batches.
    """
    makers: list[tuple[str, Callable[[], Contender]]] = []
    for scene in scenes:
        for size in sizes:
            for engine in engines:
                makers.append((f"{scene}, {size} rooms, {engine}",
                               lambda s=scene, n=size, e=engine: _make_batch(s, n, e, settings)))
    if peers:
        scene, size = scenes[0], max(sizes)
        makers.append(("SyncVectorEnv", lambda: _make_sync(scene, settings.observation)))
        makers.append((CARTPOLE, lambda: _make_cartpole(size)))
        if importlib.util.find_spec("xminigrid") is not None:
            makers.append((XLAND, lambda: _make_xland(min(size, 1024))))
        if importlib.util.find_spec("gymnax") is not None:
            makers.append((GYMNAX, lambda: _make_gymnax(size)))
    return makers


def _make_batch(scene: str, rooms: int, engine: str, settings: BatchSettings) -> Contender:
    instances = [generate(make_scene(scene), seed) for seed in range(settings.instances)]
    begun = time.perf_counter()
    batch = TensorRoom(Rooms(rooms, instance=instances, observation=settings.observation, device=settings.device,
                             compile=engine == "compiled"),
                       velocities=Velocities() if settings.velocities else None)
    batch.reset(torch.arange(rooms, device=batch.device))
    generator = torch.Generator().manual_seed(0)
    pool = [draw_uniformly(batch, generator) for _ in range(POOL)]
    before = batch.state
    outcome = batch.step(pool[0])
    _wait(batch.device)
    build_seconds = time.perf_counter() - begun
    moved = count_moved_bytes((before, pool[0]), (batch.state, outcome))

    def step(count: int) -> None:
        for number in range(count):
            batch.step(pool[number % POOL])
        _wait(batch.device)

    step(POOL)
    return Contender(scene, engine, rooms, step, build_seconds, count_bytes(before) // rooms, moved // rooms)


def _make_sync(scene: str, observation: str) -> Contender:
    config, begun = make_scene(scene), time.perf_counter()
    env = gymnasium.vector.SyncVectorEnv(
        [lambda: EscapeRoomEnv(config, observation=observation)] * SYNC_ROOMS)
    return _make_vector(scene, "Bullet, SyncVectorEnv", env, begun)


def _make_cartpole(rooms: int) -> Contender:
    begun = time.perf_counter()
    return _make_vector(CARTPOLE, "numpy, its own", gymnasium.make_vec(CARTPOLE, num_envs=rooms), begun)


def _make_vector(name: str, engine: str, env: gymnasium.vector.VectorEnv, begun: float) -> Contender:
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    count = env.single_action_space.n  # type: ignore[attr-defined]  # both have discrete actions
    pool = [rng.integers(count, size=env.num_envs) for _ in range(POOL)]

    def step(steps: int) -> None:
        for number in range(steps):
            env.step(pool[number % POOL])

    step(1)
    return Contender(name, engine, env.num_envs, step, time.perf_counter() - begun)


def _make_xland(rooms: int) -> Contender:
    begun = time.perf_counter()
    import jax  # pyright: ignore[reportMissingImports]  # a peer, if installed
    import xminigrid  # pyright: ignore[reportMissingImports]
    from xminigrid.wrappers import GymAutoResetWrapper  # pyright: ignore[reportMissingImports]

    env, params = xminigrid.make(XLAND)
    env = GymAutoResetWrapper(env)
    keys = jax.random.split(jax.random.key(0), rooms)
    reset, advance = jax.jit(jax.vmap(env.reset, in_axes=(None, 0))), jax.jit(jax.vmap(env.step, in_axes=(None, 0, 0)))
    pool = [jax.random.randint(jax.random.key(n), (rooms,), 0, env.num_actions(params)) for n in range(POOL)]
    now = [reset(params, keys)]

    def step(count: int) -> None:
        for number in range(count):
            now[0] = advance(params, now[0], pool[number % POOL])
        now[0].reward.block_until_ready()

    step(1)
    return Contender(XLAND, "JAX, compiled", rooms, step, time.perf_counter() - begun)


def _make_gymnax(count: int) -> Contender:
    begun = time.perf_counter()
    import gymnax  # pyright: ignore[reportMissingImports]  # a peer, if installed
    import jax  # pyright: ignore[reportMissingImports]

    env, params = gymnax.make(CARTPOLE)
    keys = jax.random.split(jax.random.key(0), count)
    advance = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))  # resets at the end of an episode
    pool = [jax.random.randint(jax.random.key(n), (count,), 0, env.num_actions) for n in range(POOL)]
    now = [jax.jit(jax.vmap(env.reset, in_axes=(0, None)))(keys, params)[1]]

    def step(steps: int) -> None:
        for number in range(steps):
            now[0] = advance(keys, now[0], pool[number % POOL], params)[1]
        jax.block_until_ready(now[0])

    step(1)
    return Contender(GYMNAX, "JAX, compiled", count, step, time.perf_counter() - begun)


def draw_uniformly(batch: TensorRoom, generator: torch.Generator) -> torch.Tensor:
    """Random primitives, int64 (rooms,), or velocities within their bounds, float64 (rooms, numbers)."""
    velocities = batch.layout.velocities
    if velocities is None:
        drawn = torch.randint(batch.actions, (batch.count,), generator=generator)
    else:
        top = torch.tensor(velocities.list_bounds(batch.layout.robot), dtype=torch.float64)
        drawn = top * (2.0 * torch.rand(batch.count, len(top), generator=generator, dtype=torch.float64) - 1.0)
    return drawn.to(batch.device)


def _wait(device: torch.device) -> None:
    if device.type != "cpu":
        torch.accelerator.synchronize(device)


def count_moved_bytes(arguments: Any, results: Any) -> int:
    """Bytes that a step must read and write: its arguments and results, each tensor once.

    Tensors that are passed on unchanged do not count, though some are read. The bound therefore holds for every step.
    """
    given, made = _collect(arguments), _collect(results)
    return sum(tensor.nbytes for key, tensor in (given | made).items() if key not in given or key not in made)


def count_bytes(tree: Any) -> int:
    """Bytes of the tensors in nested tuples and dicts, each once."""
    return sum(tensor.nbytes for tensor in _collect(tree).values())


def _collect(tree: Any) -> dict[int, torch.Tensor]:
    """Tensors by identity."""
    found: dict[int, torch.Tensor] = {}
    map_tensors(lambda tensor: found.setdefault(id(tensor), tensor), tree)
    return found


def set_threads(threads: int) -> None:
    """Set the number of torch threads; 0 keeps the default."""
    if threads:
        torch.set_num_threads(threads)


def measure_bandwidth(device: str) -> float:
    """Memory bandwidth: bytes a second that a large copy reads and writes."""
    source = torch.ones(2**26, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)
    best = float("inf")
    for _ in range(5):
        begun = time.perf_counter()
        target.copy_(source)
        _wait(source.device)
        best = min(best, time.perf_counter() - begun)
    return 2 * source.numel() / best


def describe_torch(device: str) -> dict[str, Any]:
    """Number of torch threads and name of the device."""
    cuda = torch.cuda.get_device_name(device) if device.startswith("cuda") else None
    return {"threads": torch.get_num_threads(), "device": cuda or device}


def draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Plot steps per second by batch size, with the peers as horizontal lines."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.8), layout="constrained")
    axes = figure.subplots()
    ours = [row for row in rows if row["memory_bound"]]
    scenes = list(dict.fromkeys(row["name"] for row in ours))
    for number, scene in enumerate(scenes):
        for engine, style in (("eager", "--"), ("compiled", "-")):
            rows_of = [row for row in ours if (row["name"], row["engine"]) == (scene, engine)]
            line = sorted((row["rooms"], row["steps_per_second"]) for row in rows_of)
            if line:
                axes.plot(*zip(*line, strict=True), style, marker="o", color=f"C{number}", label=f"{scene}, {engine}")
    shades = ("0.25", "0.5", "0.7")
    for row, shade in zip((row for row in rows if not row["memory_bound"]), shades, strict=False):
        label = f"{row['name']} ({row['engine']}, {row['rooms']:,} rooms)"
        axes.axhline(row["steps_per_second"], color=shade, linestyle=":", label=label)
    axes.set(xscale="log", yscale="log", xlabel="rooms in a batch", ylabel="steps per second", title="Batched rooms")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    figure.savefig(path, dpi=150)
