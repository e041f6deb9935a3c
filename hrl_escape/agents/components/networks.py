"""Networks of the deep agents: encoding of observations, layers and fast acting.

Multilayer perceptrons, with a convolutional front (Mnih et al. 2015) for images. Weights are drawn from a generator of
their own and lie in one vector, so that Adam, clipping and target networks are single operations. Acting on one
observation goes through numpy views of the same weights, four to five times faster on a CPU than torch. Learning is
plain torch because that measured fastest (`python -m benchmarks.agents`, beside TorchRL and Stable-Baselines3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeGuard

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.spaces.utils import flatten, flatten_space
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from hrl_escape.agents.settings import AgentSettings
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.settings import Range

__all__ = [
    "Network",
    "NetworkSettings",
    "ObservationEncoder",
    "compute_td_loss",
    "initialise_layer",
    "is_goal_space",
    "make_forward",
    "make_generator",
    "make_network",
]

MOST_KNOWN = 1_000
"""Most outputs of a network that are remembered."""


@dataclass(frozen=True)
class NetworkSettings(AgentSettings):
    """The networks and their optimiser (Adam)."""

    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: `torch` U(+-1/sqrt(fan in)); `glorot` Xavier uniform with zero bias, as Keras; `orthogonal`
    with zero bias, usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; Keras has 1e-7."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Gradients are scaled down to this Euclidean norm; 0 leaves them."""
    scale_observations: bool = True
    """Map components with finite bounds in the observation space to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Networks learn rewards times this; temperatures and logged values stay in units of return."""


class ObservationEncoder:
    """Turns observations of a space into network inputs.

    Images (uint8, three axes with 1, 3 or 4 channels last) stay uint8 and become channels first; every other space
    becomes a float32 vector, by `gymnasium.spaces.flatten` (one-hot for discrete parts) where it is not a Box. An
    observation with goals becomes the vector of the observation, then that of the desired goal.

    Attributes:
        space: of the observations.
        shape: shape of an encoded observation.
        dtype: uint8 for images, else float32.

    Raises:
        UnsupportedSpaceError: the space has no fixed size, or pictures come with goals.
    """

    def __init__(self, space: gymnasium.Space, scale: bool) -> None:
        self.space = space
        self._is_box = isinstance(space, spaces.Box)
        self.is_image = is_image_space(space)
        self._parts: dict[str, ObservationEncoder] = {}
        if is_goal_space(space):
            self._parts = {name: ObservationEncoder(space[name], scale) for name in ("observation", "desired_goal")}
            if any(part.is_image for part in self._parts.values()):
                raise UnsupportedSpaceError("pictures with goals cannot be used: observations with goals must be "
                                            "vectors")
            self.shape, self.dtype = (sum(part.shape[0] for part in self._parts.values()),), np.dtype(np.float32)
            return
        if self.is_image:
            height, width, channels = space.shape or (0, 0, 0)
            self.shape, self.dtype = (channels, height, width), np.dtype(np.uint8)
            return
        flat = flatten_space(space)
        if not isinstance(flat, spaces.Box):
            raise UnsupportedSpaceError(f"networks need observations of fixed size, which {space} does not give")
        self.shape, self.dtype = flat.shape, np.dtype(np.float32)
        low, high = flat.low.astype(np.float64), flat.high.astype(np.float64)
        bounded = (scale and self._is_box) & (low > -1e6) & (high < 1e6) & (high > low)
        middle = np.where(bounded, (low + np.where(bounded, high, 0)) / 2, 0.0)
        half = np.where(bounded, (np.where(bounded, high, 1) - np.where(bounded, low, 0)) / 2, 1.0)
        self._middle, self._factor = middle.astype(np.float32), (1 / half).astype(np.float32)
        self._is_identity = not middle.any() and bool((half == 1).all())

    def encode(self, observation: Any) -> NDArray:
        """Encode one observation; the result owns its memory."""
        if self.is_image:
            return np.moveaxis(np.asarray(observation), -1, 0).copy()
        if self._parts:
            return np.concatenate([part.encode(observation[name]) for name, part in self._parts.items()])
        if not self._is_box:
            observation = flatten(self.space, observation)
        flat = np.array(observation, dtype=np.float32).reshape(-1)
        if self._is_identity:
            return flat
        flat -= self._middle
        flat *= self._factor
        return flat

    def replace_goal(self, encoded: NDArray, goal: Any) -> NDArray:
        """An encoded observation with another desired goal, a copy."""
        vector = self._parts["desired_goal"].encode(goal)
        return np.concatenate([encoded[: -len(vector)], vector])

    def encode_many(self, observation: torch.Tensor) -> torch.Tensor:
        """Encode a batch of observations on its device, (n, ...) to (n, *shape).

        Raises:
            UnsupportedSpaceError: the space is neither a Box nor Discrete.
        """
        if self.is_image:
            return observation.movedim(-1, 1).contiguous()
        if isinstance(self.space, spaces.Discrete):
            return functional.one_hot(observation.long() - int(self.space.start), int(self.space.n)).float()
        if not self._is_box:
            raise UnsupportedSpaceError(f"streams show Box or Discrete observations, not {self.space}")
        flat = observation.to(torch.float32).flatten(1)
        if self._is_identity:
            return flat
        middle, factor = (torch.from_numpy(part).to(flat.device) for part in (self._middle, self._factor))
        return (flat - middle) * factor


def is_goal_space(space: gymnasium.Space) -> TypeGuard[spaces.Dict]:
    """True for observations with goals: a Dict of `observation`, `achieved_goal` and `desired_goal`."""
    return isinstance(space, spaces.Dict) and set(space) == {"observation", "achieved_goal", "desired_goal"}


def is_image_space(space: gymnasium.Space) -> bool:
    """True for pictures: a uint8 Box (height, width, 1, 3 or 4)."""
    shape = space.shape or ()
    return isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(shape) == 3 and shape[2] in (1, 3, 4)


class Network(nn.Sequential):
    """Layers whose parameters, and their gradients, are views of one vector each.

    Attributes:
        weights: float32 (parameters,), all parameters.
        gradient: float32 (parameters,), where `backward` accumulates.
        sizes: elements of each parameter, in order.
    """

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(*layers)
        parameters = list(self.parameters())
        self.weights = torch.cat([parameter.detach().reshape(-1) for parameter in parameters])
        self.gradient = torch.zeros_like(self.weights)
        self.sizes = [parameter.numel() for parameter in parameters]
        self._tie(parameters)

    def _tie(self, parameters: list[nn.Parameter]) -> None:
        """Make each parameter and its gradient views of the vectors."""
        pieces = zip(parameters, self.weights.split(self.sizes), self.gradient.split(self.sizes), strict=True)
        for parameter, weights, gradient in pieces:
            parameter.data = weights.view(parameter.shape)
            parameter.grad = gradient.view(parameter.shape)

    def move(self, device: torch.device) -> None:
        """Move parameters and gradients to a device."""
        self.to(device)  # buffers too
        parameters = list(self.parameters())
        self.weights, self.gradient = self.weights.to(device), self.gradient.to(device)
        self._tie(parameters)

    def blend(self, source: Network, rate: float) -> None:
        """Move a target network: weights <- (1 - rate) weights + rate source (Lillicrap et al. 2016)."""
        self.weights.lerp_(source.weights, rate)


def make_generator(rng: np.random.Generator) -> torch.Generator:
    """A torch generator of its own, seeded from a numpy one."""
    generator = torch.Generator()
    generator.manual_seed(int(rng.integers(2**63)))
    return generator


def make_network(
    encoder: ObservationEncoder,
    outputs: int,
    settings: NetworkSettings,
    generator: torch.Generator,
    extra_inputs: int = 0,
    output_gain: float = 1.0,
) -> Network:
    """A perceptron (convolutions first for images) from encoded observations to `outputs` numbers.

    Args:
        encoder: says the input's shape.
        outputs: units of the linear last layer.
        settings: hidden layers and initialisation.
        generator: draws the weights.
        extra_inputs: further inputs after a vector observation, such as a relaxed action.
        output_gain: factor on the last layer's initial weights.

    Raises:
        UnsupportedSpaceError: images smaller than 36 x 36, or images with extra inputs.
    """
    activation = nn.Tanh if settings.initialisation == "orthogonal" else nn.ReLU
    gain = nn.init.calculate_gain("tanh" if activation is nn.Tanh else "relu")
    layers: list[nn.Module] = []
    width = int(np.prod(encoder.shape)) + extra_inputs
    if encoder.is_image:
        layers, width = _make_convolutions(encoder.shape, settings.initialisation, generator, extra_inputs)
    for units in settings.hidden:
        linear = nn.utils.skip_init(nn.Linear, width, units)  # the constructor would draw from global state
        layers += [initialise_layer(linear, settings.initialisation, gain, generator), activation()]
        width = units
    last = initialise_layer(nn.utils.skip_init(nn.Linear, width, outputs), settings.initialisation, 1.0, generator)
    with torch.no_grad():
        last.weight.mul_(output_gain)
    return Network(*layers, last)


class _Unit(nn.Module):
    """Bytes to [0, 1]."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return image.float() / 255


def _make_convolutions(
    shape: tuple[int, ...], initialisation: str, generator: torch.Generator, extra_inputs: int
) -> tuple[list[nn.Module], int]:
    """The convolutional layers of Mnih et al. (2015), and how many units come out."""
    channels, height, width = shape
    if min(height, width) < 36 or extra_inputs:
        raise UnsupportedSpaceError(
            f"pictures of {height} x {width} cannot be used here: convolutions need at least 36 x 36, and an agent "
            "that feeds actions into its network (ddpg) needs vector observations"
        )
    layers: list[nn.Module] = [_Unit()]
    gain = nn.init.calculate_gain("relu")
    for filters, kernel, stride in ((32, 8, 4), (64, 4, 2), (64, 3, 1)):
        convolution = nn.utils.skip_init(nn.Conv2d, channels, filters, kernel, stride)
        layers += [initialise_layer(convolution, initialisation, gain, generator), nn.ReLU()]
        channels, height, width = filters, (height - kernel) // stride + 1, (width - kernel) // stride + 1
    return [*layers, nn.Flatten()], channels * height * width


def initialise_layer(layer: Any, initialisation: str, gain: float, generator: torch.Generator) -> Any:
    """Draw a layer's initial weights as `NetworkSettings.initialisation` says; returns the layer."""
    if initialisation == "glorot":
        nn.init.xavier_uniform_(layer.weight, generator=generator)
    elif initialisation == "orthogonal":
        nn.init.orthogonal_(layer.weight, gain, generator=generator)
    else:
        nn.init.kaiming_uniform_(layer.weight, a=5**0.5, generator=generator)
        bound = layer.weight[0].numel() ** -0.5
        nn.init.uniform_(layer.bias, -bound, bound, generator=generator)
        return layer
    nn.init.zeros_(layer.bias)
    return layer


def make_forward(network: Network) -> Callable[[NDArray], NDArray]:
    """A function from one encoded observation to the network's outputs, (outputs,), without gradients.

    Perceptrons on a CPU run in numpy on views of the network's own weights, so later updates are seen; deep sets there
    remember their outputs while the weights stay. Make the function again after `Network.move`.
    """
    device = network.weights.device
    if device.type != "cpu" or not all(isinstance(layer, (nn.Linear, nn.ReLU, nn.Tanh)) for layer in network):

        def forward_torch(observation: NDArray) -> NDArray:
            with torch.no_grad():
                return network(torch.from_numpy(observation).unsqueeze(0).to(device)).squeeze(0).cpu().numpy()

        if device.type != "cpu" or isinstance(network[0], _Unit):  # pictures hardly repeat
            return forward_torch
        return _remember(forward_torch, network.weights.numpy())

    steps = [
        (layer.weight.detach().numpy(), layer.bias.detach().numpy()) if isinstance(layer, nn.Linear) else layer
        for layer in network
    ]

    def forward_numpy(observation: NDArray) -> NDArray:
        values = observation
        for step in steps:
            if isinstance(step, tuple):
                values = step[0] @ values
                values += step[1]
            elif isinstance(step, nn.ReLU):
                np.maximum(values, 0, out=values)
            else:
                np.tanh(values, out=values)
        return values

    return forward_numpy


def _remember(forward: Callable[[NDArray], NDArray], weights: NDArray) -> Callable[[NDArray], NDArray]:
    """Function with the same outputs, those of the latest inputs from memory while the weights stay as they are.

    Agents that get nowhere see the same few observations for hundreds of decisions.
    """
    known: dict[bytes, NDArray] = {}
    before = weights.copy()

    def recall(observation: NDArray) -> NDArray:
        if len(known) >= MOST_KNOWN or not np.array_equal(before, weights):
            known.clear()
            before[:] = weights
        key = observation.tobytes()
        if key not in known:
            known[key] = forward(observation)
        return known[key].copy()

    return recall


def compute_td_loss(values: torch.Tensor, targets: torch.Tensor, kind: str) -> torch.Tensor:
    """Mean loss of values against targets: `huber`, or half the square (`squared`)."""
    if kind == "huber":
        return functional.smooth_l1_loss(values, targets)
    return 0.5 * functional.mse_loss(values, targets)
