"""Networks over rows of objects: equivariant under permutation of the objects, and indifferent to their number.

Deep sets (Zaheer et al. 2017, equation 4): every layer gives each object the same function of its own row and of the
mean and the maximum over all objects. An action that is about an object is valued from that object's row; all other
actions, and states, from the pooled rows. So what is learned about one button holds for any other button, under any
number, where a perceptron over the same numbers would have to learn it for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import torch
from torch import nn

from hrl_escape.agents.agent import count_actions
from hrl_escape.agents.components.networks import (
    Network,
    NetworkSettings,
    ObservationEncoder,
    initialise_layer,
    make_network,
)
from hrl_escape.agents.settings import AgentSettings
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

__all__ = ["ObjectLayers", "ObjectNetworkSettings", "make_action_network", "make_state_network"]


@dataclass(frozen=True)
class ObjectNetworkSettings(AgentSettings):
    """Kind of network."""

    network: Literal["mlp", "objects"] = "mlp"
    """`mlp`: a perceptron over the whole observation. `objects`: deep sets over its rows of objects, equivariant under
    permutation of the objects; for the observation `objects`."""


class ObjectLayers(nn.Module):
    """Deep-sets layers from observations in rows to one number an action, or to one number.

    Args:
        space: of the observations.
        about: for each action the name of its object, or None; no actions for the value of a state.
        settings: hidden layers and initialisation.
        generator: draws the weights.
        output_gain: factor on the last layer's initial weights.
        memory: numbers after the observation that belong to the rows, as many to each.
    """

    _columns: torch.Tensor

    def __init__(self, space: ObjectsBox, about: tuple[str | None, ...], settings: NetworkSettings,
                 generator: torch.Generator, output_gain: float, memory: int = 0) -> None:
        super().__init__()
        self._shape, self._present = (len(space.rows), len(space.words)), space.words.index("present")
        self._memory = memory // len(space.rows)
        is_tanh = settings.initialisation == "orthogonal"
        self._activation = nn.Tanh() if is_tanh else nn.ReLU()
        gain = nn.init.calculate_gain("tanh" if is_tanh else "relu")

        def make(inputs: int, outputs: int, factor: float, scale: float = 1.0) -> Any:
            linear: Any = nn.utils.skip_init(nn.Linear, inputs, outputs)  # the constructor would draw from global state
            initialise_layer(linear, settings.initialisation, factor, generator)
            with torch.no_grad():
                linear.weight.mul_(scale)
            return linear

        widths = settings.hidden
        self.enter = make(len(space.words) + space.context + self._memory, widths[0], gain)
        self.own, self.shared = nn.ModuleList(), nn.ModuleList()
        for width, units in zip(widths, widths[1:], strict=False):
            self.own.append(make(width, units, gain))
            self.shared.append(make(2 * width, units, gain))
        columns, heads, free = _lay_out(space.rows, about)
        self.register_buffer("_columns", torch.tensor(columns), persistent=False)
        self.point = make(widths[-1], heads, 1.0, output_gain) if heads else None
        self.whole = make(2 * widths[-1], free, 1.0, output_gain) if free else None

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Numbers of all actions, (batch, actions), or of the state, (batch, 1)."""
        count, width = self._shape
        rows = observation[:, : count * width].unflatten(1, self._shape)  # (batch, rows, words)
        rest = observation[:, count * width :]
        context, memory = rest.split((rest.shape[1] - count * self._memory, count * self._memory), dim=1)
        context = torch.cat([context[:, None].expand(-1, count, -1), memory.unflatten(1, (count, -1))], dim=2)
        present = rows[:, :, self._present, None] > 0.5
        hidden = self._activation(self.enter(torch.cat([rows, context], dim=2)))
        for own, shared in zip(self.own, self.shared, strict=True):
            hidden = self._activation(own(hidden) + shared(_pool(hidden, present))[:, None])
        parts = []
        if self.point is not None:
            parts.append(self.point(hidden).flatten(1))  # (batch, rows x heads)
        if self.whole is not None:
            parts.append(self.whole(_pool(hidden, present)))
        return torch.cat(parts, dim=1).index_select(1, self._columns)


def _pool(hidden: torch.Tensor, present: torch.Tensor) -> torch.Tensor:
    """Mean and maximum over the objects that are present: (batch, rows, units) -> (batch, 2 units)."""
    mean = (hidden * present).sum(dim=1) / present.sum(dim=1).clamp(min=1)
    most = hidden.masked_fill(~present, -1e9).amax(dim=1)  # no activation is that low
    return torch.cat([mean, most * present.any(dim=1)], dim=1)


def _lay_out(rows: tuple[str, ...], about: tuple[str | None, ...]) -> tuple[list[int], int, int]:
    """Column of each action among (rows x heads, free) numbers; number of heads; number of free ones.

    The k-th action about an object has head k; an action about nothing, or about what has no row, is free.
    """
    if not about:
        return [0], 0, 1
    places: list[tuple[int, int] | None] = []
    for number, name in enumerate(about):
        known = name is not None and name in rows
        places.append((rows.index(name), about[:number].count(name)) if known else None)  # type: ignore[arg-type]
    heads = max((place[1] + 1 for place in places if place), default=0)
    columns, free = [], 0
    for place in places:
        columns.append(len(rows) * heads + free if place is None else place[0] * heads + place[1])
        free += place is None
    return columns, heads, free


def make_action_network(encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                        generator: torch.Generator, output_gain: float = 1.0, memory: int = 0) -> Network:
    """Network of one number an action, as `settings.network` says.

    Args:
        encoder: of the observations.
        action_space: Discrete; a `PointingDiscrete` says what its actions are about.
        settings: `NetworkSettings` with `network`.
        generator: draws the weights.
        output_gain: factor on the last layer's initial weights.
        memory: numbers of a memory after the observation.

    Raises:
        UnsupportedSpaceError: `network=objects` with observations that are no rows of objects.
    """
    actions = count_actions(action_space, "network")
    if settings.network == "mlp":
        return make_network(encoder, actions, settings, generator, memory, output_gain)
    about = action_space.about if isinstance(action_space, PointingDiscrete) else (None,) * actions
    return Network(ObjectLayers(_get_rows(encoder), about, settings, generator, output_gain, memory))


def make_state_network(encoder: ObservationEncoder, settings: Any, generator: torch.Generator, memory: int = 0
                       ) -> Network:
    """Network of one number, the value of a state; see `make_action_network`."""
    if settings.network == "mlp":
        return make_network(encoder, 1, settings, generator, memory)
    return Network(ObjectLayers(_get_rows(encoder), (), settings, generator, 1.0, memory))


def _get_rows(encoder: ObservationEncoder) -> ObjectsBox:
    if not isinstance(encoder.space, ObjectsBox):
        raise UnsupportedSpaceError(f"network=objects needs observations in rows of objects, not {encoder.space}: make "
                                    "the environment with observation='objects'")
    return encoder.space
