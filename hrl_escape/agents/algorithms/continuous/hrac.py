"""HRAC: HIRO whose manager is penalised for goals that the worker cannot reach in one window.

    manager's actor: maximise Q(s, mu(s)) - eta max(|psi(s) - psi(s + mu(s))| - eps, 0)
    psi: minimise max(|psi(x) - psi(y)| - eps, 0) over adjacent x, y, and max(eps + delta - |psi(x) - psi(y)|, 0) else

Points are adjacent if one was visited within a window of the other. Zhang, Guo, Tan, Hu and Chen (2020).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import gymnasium
import torch
from torch import Tensor

from hrl_escape.agents.algorithms.continuous.hiro import Hiro, HiroSettings
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import Learner, ObservationEncoder, make_generator, make_network
from hrl_escape.agents.state import Kept
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range

MOST_ADJACENCY_CELLS = 4_096
"""Largest number of cells of the goal space."""
EMBEDDING = 32
"""Dimensions of psi."""


@dataclass(frozen=True, kw_only=True)
class HracSettings(HiroSettings):
    """Settings of `hrac`: all of `hiro`, and adjacency."""

    adjacency_weight: Annotated[float, Range(0)] = 20.0
    """eta, weight of the penalty. 0 is HIRO."""
    adjacency_bins: Annotated[int, Range(2)] = 6
    """Cells of the goal space along each component, which record visits. More cells distinguish nearer points and fill
    more slowly. A cell should be smaller than the way of a window."""
    adjacency_radius: Annotated[float, Range(0, open_low=True)] = 1.0
    """eps, largest embedded distance of adjacent points."""
    adjacency_margin: Annotated[float, Range(0)] = 0.2
    """delta, margin of points that are not adjacent."""
    adjacency_hidden: tuple[Annotated[int, Range(1)], ...] = (128, 128)
    """Units of each hidden layer of psi."""


class Hrac(Hiro):
    """HIRO with adjacency constraints; the equations are in the module's text.

    Attributes:
        psi: embedding of points in [-1, 1]^size.
        is_adjacent: bool (cells, cells), symmetric.
        is_visited: bool (cells,).

    Raises:
        AgentSettingsError: the goal space is unbounded, or has more than `MOST_ADJACENCY_CELLS` cells.
    """

    Settings = HracSettings
    STATE = ("_adjacency_learner", Kept("is_adjacent", "adjacent"), Kept("is_visited", "visited"))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HracSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        chosen: HracSettings = self.settings
        settings, goals = chosen, self.goals
        cells = settings.adjacency_bins**goals.size
        if not bool(torch.isfinite(goals.high - goals.low).all()) or cells > MOST_ADJACENCY_CELLS:
            raise AgentSettingsError("adjacency_bins", settings.adjacency_bins, "at most "
                                     f"{MOST_ADJACENCY_CELLS:,} cells in all "
                                     f"{goals.size} components of a goal, with finite bounds")
        cube = ObservationEncoder(gymnasium.spaces.Box(-1, 1, (goals.size,)), False)
        self.psi = make_network(cube, EMBEDDING, replace(settings, hidden=settings.adjacency_hidden),
                                make_generator(make_rng(seed, "adjacency")))
        self._adjacency_learner = Learner(f"{self.name} adjacency", {"psi": self.psi}, ["psi"], settings)
        self.is_adjacent = torch.zeros((cells, cells), dtype=torch.bool)
        self.is_visited = torch.zeros(cells, dtype=torch.bool)

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; replay is kept if their number is unchanged."""
        super().begin_episodes(num_envs, device)
        where = self._arrays.device
        self._adjacency_learner.move(where)
        self.is_adjacent, self.is_visited = self.is_adjacent.to(where), self.is_visited.to(where)

    def _scale(self, point: Tensor) -> Tensor:
        """Return points over the bounds of the goal space, in [-1, 1]."""
        return 2 * (point - self.goals.low) / (self.goals.high - self.goals.low) - 1

    def find_cells(self, point: Tensor) -> Tensor:
        """Return the number of each point's cell, int64 (...) from (..., size)."""
        bins = self.settings.adjacency_bins
        axes = ((self._scale(point) + 1) / 2 * bins).long().clamp(0, bins - 1)
        return (axes * bins ** torch.arange(self.goals.size, device=axes.device)).sum(-1)

    def find_centres(self, cell: Tensor) -> Tensor:
        """Return the centres of cells in [-1, 1]^size, float32 (n, size)."""
        bins = self.settings.adjacency_bins
        axes = cell[:, None] // bins ** torch.arange(self.goals.size, device=cell.device) % bins
        return (axes + 0.5) / bins * 2 - 1

    def store_windows(self, **rows: Any) -> None:
        """Store windows that ended, and record all pairs of points in each as adjacent."""
        super().store_windows(**rows)
        cells = self.find_cells(rows["points"])
        last = rows["length"].long()[:, None]
        cells = torch.where(torch.arange(cells.shape[1], device=cells.device) <= last, cells, cells[:, :1])
        pairs = torch.broadcast_tensors(cells[:, :, None], cells[:, None])
        self.is_adjacent[pairs[0].reshape(-1), pairs[1].reshape(-1)] = True
        self.is_visited[cells.reshape(-1)] = True

    def measure(self, first: Tensor, second: Tensor) -> Tensor:
        """Return |psi(x) - psi(y)| of points in [-1, 1]^size, (n,)."""
        return ((self.psi(first) - self.psi(second)) ** 2).sum(1).add(1e-12).sqrt()

    def compute_adjacency_loss(self, first: Tensor, second: Tensor) -> Tensor:
        """Return the contrastive loss of pairs of cells, int64 (n,) each."""
        settings = self.settings
        distance = self.measure(self.find_centres(first), self.find_centres(second))
        near = (distance - settings.adjacency_radius).clamp(min=0)
        far = (settings.adjacency_radius + settings.adjacency_margin - distance).clamp(min=0)
        return torch.where(self.is_adjacent[first, second], near, far).mean()

    def update_manager(self, drawn: Mapping[str, Tensor]) -> dict[str, float]:
        """Make one update of psi, half from adjacent pairs, and one of the manager."""
        half = max(1, len(drawn["reward"]) // 2)
        visited = self.is_visited.nonzero().squeeze(1)
        ends = self.find_cells(drawn["points"])[:half]
        other = (self._arrays.draw_uniform(half) * (drawn["length"][:half] + 1)).long()
        adjacent = ends[:, 0], ends[torch.arange(len(ends), device=ends.device), other]
        any_pair = (visited[self._arrays.draw_numbers(len(visited), half)] for _ in range(2))
        first, second = (torch.cat(pair) for pair in zip(adjacent, any_pair, strict=True))
        loss = self._adjacency_learner.minimise(self.compute_adjacency_loss(first, second))
        return super().update_manager(drawn) | {"adjacency_loss": loss}

    def find_penalty(self, drawn: Mapping[str, Tensor]) -> Callable[[Tensor], Tensor]:
        """Return eta times the mean of max(|psi(s) - psi(s + g)| - eps, 0) as a function of the choices."""
        settings, start = self.settings, drawn["points"][:, 0]

        def penalise(unit: Tensor) -> Tensor:
            distance = self.measure(self._scale(start), self._scale(start + unit * self.goals.range))
            return settings.adjacency_weight * (distance - settings.adjacency_radius).clamp(min=0).mean()

        return penalise
