"""Networks of the deep agents: encoding of observations, layers, acting on them and gradient descent.

Networks are multilayer perceptrons, with a convolutional front (Mnih et al. 2015) for images, deep sets over rows of
objects, or a module of the user's own. Weights come from a separate generator and are stored in one vector, which makes
Adam, clipping and target networks single operations. Acting on one observation uses numpy views of the same weights,
four to five times faster on a CPU than torch. Learning uses plain torch, which was the fastest in measurements (`python
-m benchmarks.agents` compares it with TorchRL and Stable-Baselines3).

Deep sets (Zaheer et al. 2017, equation 4) are equivariant under permutation of the objects and accept any number of
them. Every layer applies the same function to each object's row together with the mean and the maximum over all
objects. The value of an action that refers to an object comes from that object's row; values of other actions, and of
states, come from the pooled rows. What is learned about one button therefore transfers to every other button, while a
perceptron over the same numbers has to learn it for each.
"""

from __future__ import annotations

import math
import warnings
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any, TypeGuard

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.spaces.utils import flatdim, flatten, flatten_space
from numpy.typing import NDArray
from torch import nn
from torch.linalg import vector_norm
from torch.nn import functional
from torch.optim.adam import adam

from hrl_escape.agents.agent import count_actions
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.errors import AgentSettingsError, DivergenceError, UnsupportedSpaceError
from hrl_escape.spaces import ObjectsBox, PointingDiscrete

BLOCK_ROWS = 4096
"""Rows that pass through a perceptron together: two layers of 64 units take 2 MiB, the size of a core's cache."""
MOST_KNOWN = 1_000
"""Most cached outputs of a network."""
WILD_LOSS = 1e6
"""Loss above which values have diverged; in scaled rewards, losses are a few hundred at most."""
WILD_GROWTH, GROWTH_EVERY = 100.0, 50
"""Growth of the weights' norm above which steps are too large, and number of updates between two checks."""
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")
"""Names of Adam's state in a checkpoint, as in `torch.optim`."""


class ObservationEncoder:
    """Converts observations of a space to network inputs.

    Images (uint8, three axes with 1, 3 or 4 channels last) stay uint8 and become channels first. Every other space
    becomes a float32 vector, by `gymnasium.spaces.flatten` (one-hot for discrete parts) if it is not a Box. An
    observation with goals becomes the vector of the observation, then the vector of the desired goal. Parts of a `Dict`
    without a vector form, such as MiniGrid's mission, are omitted with a warning that names them.

    Args:
        space: observation space.
        scale: whether to map components of a Box with finite bounds to [-1, 1].

    Attributes:
        space: space of the encoded parts.
        shape: shape of an encoded observation.
        dtype: uint8 for images, otherwise float32.

    Raises:
        UnsupportedSpaceError: no part of the space has a vector form, or pictures have goals.
    """

    def __init__(self, space: gymnasium.Space, scale: bool) -> None:
        space = self.space = keep_vector_parts(space)
        self._is_box = isinstance(space, spaces.Box)
        self.is_image = is_image_space(space)
        self._parts: dict[str, ObservationEncoder] = {}
        if is_goal_space(space):
            self._parts = {name: ObservationEncoder(space[name], scale) for name in ("observation", "desired_goal")}
            if any(part.is_image for part in self._parts.values()):
                raise UnsupportedSpaceError("pictures with goals are not supported: observations with goals must be "
                                            "vectors")
            self.shape, self.dtype = (sum(part.shape[0] for part in self._parts.values()),), np.dtype(np.float32)
            return
        if self.is_image:
            height, width, channels = space.shape or (0, 0, 0)
            self.shape, self.dtype = (channels, height, width), np.dtype(np.uint8)
            return
        flat = flatten_space(space)
        assert isinstance(flat, spaces.Box)
        self.shape, self.dtype = flat.shape, np.dtype(np.float32)
        low, high = flat.low.astype(np.float64), flat.high.astype(np.float64)
        bounded = (scale and self._is_box) & (low > -1e6) & (high < 1e6) & (high > low)
        middle = np.where(bounded, (low + np.where(bounded, high, 0)) / 2, 0.0)
        half = np.where(bounded, (np.where(bounded, high, 1) - np.where(bounded, low, 0)) / 2, 1.0)
        self._middle, self._factor = middle.astype(np.float32), (1 / half).astype(np.float32)
        self._is_identity = not middle.any() and bool((half == 1).all())

    def encode(self, observation: Any) -> NDArray:
        """Encode one observation into a new array."""
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
        """Return a copy of an encoded observation with another desired goal."""
        vector = self._parts["desired_goal"].encode(goal)
        return np.concatenate([encoded[: -len(vector)], vector])

    def encode_goals(self, goals: torch.Tensor) -> torch.Tensor:
        """Return the part of encoded observations that holds desired goals, (n, size), from goals (n, size)."""
        return self._parts["desired_goal"].encode_many(goals)

    def encode_batch(self, observation: Any) -> Any:
        """Encode n observations, (n, *shape): a tensor on its device, a sequence of any other space as an array."""
        if isinstance(observation, torch.Tensor):
            return self.encode_many(observation)
        if len(observation) == 1:
            return self.encode(observation[0])[None]
        return np.stack([self.encode(each) for each in observation])

    def encode_many(self, observation: torch.Tensor) -> torch.Tensor:
        """Encode a batch of observations on its device, (n, ...) to (n, *shape).

        Raises:
            UnsupportedSpaceError: the space is neither a Box nor Discrete, and has no goals.
        """
        if self.is_image:
            return observation.movedim(-1, 1).contiguous()
        if self._parts:
            parts = split_goals(self.space, observation)
            return torch.cat([part.encode_many(parts[name]) for name, part in self._parts.items()], dim=1)
        if isinstance(self.space, spaces.Discrete):
            return functional.one_hot(observation.long() - int(self.space.start), int(self.space.n)).float()
        if not self._is_box:
            raise UnsupportedSpaceError(f"tensors must be Box or Discrete observations, got {self.space}")
        flat = observation.to(torch.float32).flatten(1)
        if self._is_identity:
            return flat
        middle, factor = (torch.from_numpy(part).to(flat.device) for part in (self._middle, self._factor))
        return (flat - middle) * factor


def keep_vector_parts(space: gymnasium.Space) -> gymnasium.Space:
    """Return the space without the parts of a Dict that `gymnasium.spaces.flatten` cannot convert to a vector.

    Warns about the omitted parts.

    Raises:
        UnsupportedSpaceError: no part of the space has a vector form.
    """
    left_out: dict[str, gymnasium.Space] = {}
    kept = _keep_vector_parts(space, "", left_out)
    listed = ", ".join(f"{name!r} ({type(part).__name__})" if name else str(part) for name, part in left_out.items())
    if kept is None:
        raise UnsupportedSpaceError(
            f"networks need observations that gymnasium.spaces.flatten converts to a vector, which it cannot for "
            f"{listed}. Encode it as a Box or a Discrete below, such as by gymnasium.wrappers.TransformObservation")
    if left_out:
        warnings.warn(
            f"the agent ignores these parts of the observation, which have no vector form: {listed}. If the task "
            "depends on them, encode them as a Box or a Discrete with gymnasium.wrappers.TransformObservation. If not, "
            "remove them with gymnasium.wrappers.FilterObservation", stacklevel=2)
    return kept


def _keep_vector_parts(space: gymnasium.Space, name: str, left_out: dict[str, gymnasium.Space]
                       ) -> gymnasium.Space | None:
    if isinstance(space, spaces.Dict) and len(space):
        parts = {key: _keep_vector_parts(part, f"{name}.{key}" if name else str(key), left_out)
                 for key, part in space.items()}
        if all(parts[key] is part for key, part in space.items()):
            return space
        kept = {key: part for key, part in parts.items() if part is not None}
        return spaces.Dict(kept) if kept else None
    try:
        is_vector = isinstance(flatten_space(space), spaces.Box)
    except NotImplementedError:
        is_vector = False
    if not is_vector:
        left_out[name] = space
    return space if is_vector else None


def is_goal_space(space: gymnasium.Space) -> TypeGuard[spaces.Dict]:
    """Return whether observations have goals: a Dict of `observation`, `achieved_goal` and `desired_goal`."""
    return isinstance(space, spaces.Dict) and set(space) == {"observation", "achieved_goal", "desired_goal"}


def split_goals(space: gymnasium.Space, rows: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return the parts of flat observations with goals, (n, ...) each, from (n, numbers) in the order of the keys."""
    assert isinstance(space, spaces.Dict)
    sizes = [flatdim(part) for part in space.values()]
    return dict(zip(space, rows.split(sizes, dim=1), strict=True))


def is_image_space(space: gymnasium.Space) -> bool:
    """Return whether observations are pictures: a uint8 Box (height, width, 1, 3 or 4)."""
    shape = space.shape or ()
    return isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(shape) == 3 and shape[2] in (1, 3, 4)


class NoisyLinear(nn.Module):
    """A linear layer with factorised Gaussian noise in its weights (Fortunato et al. 2018, equations 10 and 11).

    y = (mu + sigma * f(e_out) f(e_in)') x + (mu_b + sigma_b * f(e_out)), f(e) = sign(e) sqrt|e|. Without drawn noise it
    is the linear layer of its means. Every sigma begins at noise / sqrt(inputs).
    """

    _ins: torch.Tensor
    _outs: torch.Tensor

    def __init__(self, linear: nn.Linear, noise: float) -> None:
        super().__init__()
        self.mean = linear
        scale = noise * linear.in_features**-0.5
        self.weight_scale = nn.Parameter(torch.full_like(linear.weight.detach(), scale))
        self.bias_scale = nn.Parameter(torch.full_like(linear.bias.detach(), scale))
        self.register_buffer("_ins", torch.zeros(linear.in_features), persistent=False)
        self.register_buffer("_outs", torch.zeros(linear.out_features), persistent=False)

    def draw(self, generator: torch.Generator | None) -> None:
        """Draw new noise, or remove it if `generator` is None."""
        for part in (self._ins, self._outs):
            drawn = torch.zeros(len(part)) if generator is None else torch.randn(len(part), generator=generator)
            part.copy_(drawn.sign() * drawn.abs().sqrt())

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """Return (n, outputs) from (n, inputs), with the same noise for all rows."""
        weight = self.mean.weight + self.weight_scale * torch.outer(self._outs, self._ins)
        return functional.linear(input, weight, self.mean.bias + self.bias_scale * self._outs)


class Network(nn.Sequential):
    """Layers whose parameters, and their gradients, are views of one vector each.

    Attributes:
        weights: all parameters, float32 (parameters,).
        gradient: accumulated gradients of `backward`, float32 (parameters,).
        sizes: number of elements of each parameter, in order.
    """

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(*layers)
        parameters = list(self.parameters())
        self.weights = torch.cat([parameter.detach().reshape(-1) for parameter in parameters])
        self.gradient = torch.zeros_like(self.weights)
        self.sizes = [parameter.numel() for parameter in parameters]
        kinds = {type(layer) for layer in layers[1::2]}
        self._is_tanh = kinds == {nn.Tanh}
        self._is_perceptron = (self._is_tanh or kinds == {nn.ReLU}) and len(layers) % 2 == 1 and all(
            type(layer) is nn.Linear and [*dict(layer.named_parameters())] == ["weight", "bias"]
            for layer in layers[::2])
        self._tie(parameters)

    def _tie(self, parameters: list[nn.Parameter]) -> None:
        self._compute: Callable[[NDArray], NDArray] | None = None  # made at first use
        self._parameter_list = parameters  # `parameters()` searches the layers at each call
        pieces = zip(parameters, self.weights.split(self.sizes), self.gradient.split(self.sizes), strict=True)
        for parameter, weights, gradient in pieces:
            parameter.data = weights.view(parameter.shape)
            parameter.grad = gradient.view(parameter.shape)

    def move(self, device: torch.device) -> None:
        """Move parameters and gradients to a device."""
        self.to(device)  # moves buffers too
        parameters = list(self.parameters())
        self.weights, self.gradient = self.weights.to(device), self.gradient.to(device)
        self._tie(parameters)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state of a copy, which computes with its own weights."""
        return self.__dict__ | {"_compute": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state and re-tie parameters to the flat vectors, which pickle does not preserve."""
        super().__setstate__(state)
        self._tie(list(self.parameters()))

    def compute(self, observation: NDArray) -> NDArray:
        """Return outputs for one encoded observation, (outputs,), without gradients.

        Perceptrons on a CPU run in numpy on views of the network's weights. Deep sets on a CPU cache their outputs
        until the weights change.
        """
        if self._compute is None:
            self._compute = _make_forward(self)
        return self._compute(observation)

    def evaluate(self, observation: Any) -> Any:
        """Return outputs for encoded observations, (n, outputs) from (n, ...), without gradients, in their library."""
        if isinstance(observation, np.ndarray):
            if len(observation) == 1:
                return self.compute(observation[0])[None]
            return self.evaluate(torch.from_numpy(observation).to(self.weights.device)).cpu().numpy()
        with torch.no_grad():
            return self(observation)

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """Return outputs, (n, outputs) from (n, inputs); perceptrons process many rows in blocks."""
        if not self._is_perceptron:
            return super().forward(input)
        parameters = self._parameter_list
        if len(input) > BLOCK_ROWS and input.device.type == "cpu":
            return _Blocks.apply(input, self._is_tanh, torch.is_grad_enabled(), *parameters)
        activate, output = torch.tanh_ if self._is_tanh else torch.relu_, input  # in place saves passes over memory
        for layer in range(0, len(parameters), 2):  # calls of modules would take a third of the time of a minibatch
            output = functional.linear(activate(output) if layer else output, *parameters[layer : layer + 2])
        return output

    def blend(self, source: Network, rate: float) -> None:
        """Update a target network: weights <- (1 - rate) weights + rate source (Lillicrap et al. 2016)."""
        self.weights.lerp_(source.weights, rate)


class _Blocks(torch.autograd.Function):
    """A perceptron over many rows, `BLOCK_ROWS` at a time through all layers, which keeps them in cache.

    Layer by layer, all rows would go through main memory, which takes two to three times as long on a CPU. Units of
    tanh are computed as sigmoids, s = sigmoid(2 z) with tanh(z) = 2 s - 1, which take less than a third of the time.
    """

    @staticmethod
    def forward(ctx: Any, rows: torch.Tensor, is_tanh: bool, is_kept: bool, *parameters: torch.Tensor) -> torch.Tensor:
        own, biases = parameters[::2], parameters[1::2]
        weights, biases = _substitute_sigmoids(own, biases) if is_tanh else (own, biases)
        hidden = [rows.new_empty(len(rows) if is_kept else BLOCK_ROWS, len(bias)) for bias in biases[:-1]]
        output = rows.new_empty(len(rows), len(biases[-1]))
        for start in range(0, len(rows), BLOCK_ROWS):
            before = rows[start : start + BLOCK_ROWS]
            place = slice(start, start + BLOCK_ROWS) if is_kept else slice(len(before))
            for layer, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
                if layer < len(hidden):
                    before = torch.addmm(bias, before, weight.t(), out=hidden[layer][place])
                    before.sigmoid_() if is_tanh else before.relu_()
                else:
                    torch.addmm(bias, before, weight.t(), out=output[start : start + BLOCK_ROWS])
        if is_kept:
            ctx.save_for_backward(rows, *hidden, *own)
            ctx.is_tanh = is_tanh
        return output

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        saved = ctx.saved_tensors
        inputs, weights = saved[: len(saved) // 2], saved[len(saved) // 2 :]
        of_weights = [_make_long_rows(weight) for weight in weights]
        of_biases = [weight.new_zeros(len(weight)) for weight in weights]
        of_rows = torch.empty_like(inputs[0]) if ctx.needs_input_grad[0] else None
        if ctx.is_tanh:
            weights = [weights[0], *(4 * weight for weight in weights[1:])]  # 1 - tanh(z)^2 = 4 s (1 - s)
        for start in range(0, len(inputs[0]), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            error = gradients[0][part]
            for layer in reversed(range(len(weights))):
                before = inputs[layer][part]
                of_weights[layer].addmm_(error.t(), before)
                of_biases[layer].add_(error.sum(0))
                if layer == 0:
                    break
                error = error @ weights[layer]
                if ctx.is_tanh:
                    torch.ops.aten.sigmoid_backward.grad_input(error, before, grad_input=error)
                else:
                    torch.ops.aten.threshold_backward.grad_input(error, before, 0, grad_input=error)
            if of_rows is not None:
                torch.mm(error, weights[0], out=of_rows[part])
        if ctx.is_tanh:
            for of_weight, of_bias in zip(of_weights[1:], of_biases[1:], strict=True):
                of_weight.mul_(2).sub_(of_bias[:, None])  # of weights of tanh(z) = 2 s - 1
        pairs = (part for pair in zip(of_weights, of_biases, strict=True) for part in pair)
        return of_rows, None, None, *pairs


def _make_long_rows(weight: torch.Tensor) -> torch.Tensor:
    """Zeros of a weight's shape, with the longer side contiguous: products with short rows take five times as long."""
    outputs, inputs = weight.shape
    return weight.new_zeros(inputs, outputs).t() if inputs < outputs else torch.zeros_like(weight)


def _substitute_sigmoids(weights: Sequence[torch.Tensor], biases: Sequence[torch.Tensor]
                         ) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Weights and biases of the same perceptron with units sigmoid(2 z) in place of tanh(z)."""
    made = [(weight, bias) if layer == 0 else (2 * weight, bias - weight.sum(1))
            for layer, (weight, bias) in enumerate(zip(weights, biases, strict=True))]
    made[:-1] = [(2 * weight, 2 * bias) for weight, bias in made[:-1]]
    return [weight for weight, _ in made], [bias for _, bias in made]


def make_generator(rng: np.random.Generator) -> torch.Generator:
    """Make a torch generator seeded from a numpy one."""
    generator = torch.Generator()
    generator.manual_seed(int(rng.integers(2**63)))
    return generator


def make_network(encoder: ObservationEncoder, outputs: int, settings: Any, generator: torch.Generator,
                 extra_inputs: int = 0, output_gain: float = 1.0) -> Network:
    """Make a perceptron (after convolutions for images) from encoded observations to `outputs` numbers.

    `extra_inputs` follow a vector observation, such as a relaxed action. `output_gain` is a factor on the last layer's
    initial weights.

    Raises:
        UnsupportedSpaceError: images are smaller than 36 x 36, or there are images and extra inputs.
    """
    activation = nn.Tanh if settings.initialisation == "orthogonal" else nn.ReLU
    gain = nn.init.calculate_gain("tanh" if activation is nn.Tanh else "relu")
    layers: list[nn.Module] = []
    width = int(np.prod(encoder.shape)) + extra_inputs
    if encoder.is_image:
        layers, width = _make_convolutions(encoder.shape, settings.initialisation, generator, extra_inputs)
    for units in settings.hidden:
        layers += [make_linear(width, units, settings.initialisation, generator, gain), activation()]
        width = units
    return Network(*layers, make_linear(width, outputs, settings.initialisation, generator, 1.0, output_gain))


def make_linear(inputs: int, outputs: int, initialisation: str, generator: torch.Generator, gain: float = 1.0,
                scale: float = 1.0) -> Any:
    """Make a linear layer with initial weights of `initialise_layer`, times a scale."""
    linear: Any = nn.utils.skip_init(nn.Linear, inputs, outputs)  # the constructor would draw from the global state
    initialise_layer(linear, initialisation, gain, generator)
    with torch.no_grad():
        linear.weight.mul_(scale)
    return linear


class _Unit(nn.Module):
    """Scales bytes to [0, 1]."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return image.float() / 255


def _make_convolutions(shape: tuple[int, ...], initialisation: str, generator: torch.Generator, extra_inputs: int
                       ) -> tuple[list[nn.Module], int]:
    """The convolutional layers of Mnih et al. (2015), and their number of output units."""
    channels, height, width = shape
    if min(height, width) < 36 or extra_inputs:
        raise UnsupportedSpaceError(
            f"pictures of {height} x {width} are not supported: convolutions need at least 36 x 36, and an agent "
            "that feeds actions into its network (ddpg) needs vectors. Wrap the environment in "
            "gymnasium.wrappers.FlattenObservation, or resize its pictures with ResizeObservation"
        )
    layers: list[nn.Module] = [_Unit()]
    gain = nn.init.calculate_gain("relu")
    for filters, kernel, stride in ((32, 8, 4), (64, 4, 2), (64, 3, 1)):
        convolution = nn.utils.skip_init(nn.Conv2d, channels, filters, kernel, stride)
        layers += [initialise_layer(convolution, initialisation, gain, generator), nn.ReLU()]
        channels, height, width = filters, (height - kernel) // stride + 1, (width - kernel) // stride + 1
    return [*layers, nn.Flatten()], channels * height * width


def initialise_layer(layer: Any, initialisation: str, gain: float, generator: torch.Generator) -> Any:
    """Draw a layer's initial weights, as `initialisation` of `DQNSettings` describes; return the layer."""
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


class ObjectLayers(nn.Module):
    """Deep-sets layers from observations in rows to one number per action, or to one number.

    Args:
        about: name of each action's object, or None; empty for the value of a state.
        memory: count of numbers after the observation that belong to the rows, equally many for each.
    """

    _columns: torch.Tensor

    def __init__(self, space: ObjectsBox, about: tuple[str | None, ...], settings: Any,
                 generator: torch.Generator, output_gain: float, memory: int = 0) -> None:
        super().__init__()
        self._shape, self._present = (len(space.rows), len(space.words)), space.words.index("present")
        self._memory = memory // len(space.rows)
        is_tanh = settings.initialisation == "orthogonal"
        self._activation = nn.Tanh() if is_tanh else nn.ReLU()
        gain = nn.init.calculate_gain("tanh" if is_tanh else "relu")

        def make(inputs: int, outputs: int, factor: float, scale: float = 1.0) -> Any:
            return make_linear(inputs, outputs, settings.initialisation, generator, factor, scale)

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
        """Return numbers of all actions, (batch, actions), or of the state, (batch, 1)."""
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
    """Mean and maximum over the present objects: (batch, rows, units) -> (batch, 2 units)."""
    mean = (hidden * present).sum(dim=1) / present.sum(dim=1).clamp(min=1)
    most = hidden.masked_fill(~present, -1e9).amax(dim=1)  # below any activation
    return torch.cat([mean, most * present.any(dim=1)], dim=1)


def _lay_out(rows: tuple[str, ...], about: tuple[str | None, ...]) -> tuple[list[int], int, int]:
    """Column of each action among (rows x heads, free) numbers, number of heads, and number of free ones.

    The k-th action about an object has head k. An action without an object, or with one that has no row, is free.
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
    """Make the network of one number per action, of type `settings.network`; `PointingDiscrete` assigns the objects.

    In a Box it has one number per component.

    Raises:
        UnsupportedSpaceError: `network=objects` with observations that are not rows of objects.
    """
    is_box = isinstance(action_space, spaces.Box)
    actions = math.prod(action_space.shape) if is_box else count_actions(action_space, "network")
    if settings.network == "mlp":
        return make_network(encoder, actions, settings, generator, memory, output_gain)
    about = action_space.about if isinstance(action_space, PointingDiscrete) else (None,) * actions
    return Network(ObjectLayers(_get_rows(encoder), about, settings, generator, output_gain, memory))


def make_state_network(encoder: ObservationEncoder, settings: Any, generator: torch.Generator, memory: int = 0
                       ) -> Network:
    """Make the network of one number, the value of a state; see `make_action_network`."""
    if settings.network == "mlp":
        return make_network(encoder, 1, settings, generator, memory)
    return Network(ObjectLayers(_get_rows(encoder), (), settings, generator, 1.0, memory))


def _get_rows(encoder: ObservationEncoder) -> ObjectsBox:
    if not isinstance(encoder.space, ObjectsBox):
        raise UnsupportedSpaceError(f"network=objects needs observations in rows of objects, not {encoder.space}: make "
                                    "the environment with observation='objects'")
    return encoder.space


def copy_network(module: nn.Module, encoder: ObservationEncoder, action_space: gymnasium.Space) -> Network:
    """Copy a user's module, from encoded observations (batch, *encoder.shape) to (batch, actions).

    Raises:
        AgentSettingsError: the module has no weights, weights other than float32, or outputs of another shape.
    """
    actions = count_actions(action_space, "network")
    weights = list(module.parameters())
    if not weights or any(each.dtype != torch.float32 for each in weights):
        raise AgentSettingsError("network", type(module).__name__, "a module with float32 weights")
    own = deepcopy(module)
    made = Network(*own) if isinstance(own, nn.Sequential) else Network(own)
    with torch.no_grad():
        shape = tuple(made(torch.from_numpy(np.zeros((2, *encoder.shape), encoder.dtype))).shape)
    if shape != (2, actions):
        raise AgentSettingsError("network", f"outputs of shape {shape}", f"(2, {actions}) from two encoded "
                                 f"observations of shape {encoder.shape}")
    return made


def _make_forward(network: Network) -> Callable[[NDArray], NDArray]:
    """Function behind `Network.compute`, valid while the weights stay at their place in memory."""
    device = network.weights.device
    if device.type != "cpu" or not all(isinstance(layer, (nn.Linear, nn.ReLU, nn.Tanh)) for layer in network):
        get_network = weakref.ref(network)  # the network owns this function; a weak reference avoids a cycle

        def forward_torch(observation: NDArray) -> NDArray:
            own = get_network()
            assert own is not None
            with torch.no_grad():
                return own(torch.from_numpy(observation).unsqueeze(0).to(device)).squeeze(0).cpu().numpy()

        is_noisy = any(isinstance(layer, NoisyLinear) for layer in network.modules())
        if device.type != "cpu" or is_noisy or isinstance(network[0], _Unit):  # pictures rarely repeat
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
    """Add a cache of outputs of the latest inputs, valid while the weights stay unchanged.

    Agents without progress see the same few observations for hundreds of decisions.
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
    """Return the mean loss of values against targets: `huber`, or half the square (`squared`)."""
    if kind == "huber":
        return functional.smooth_l1_loss(values, targets)
    return 0.5 * functional.mse_loss(values, targets)


class Learner(Stateful):
    """Gradient descent on some networks: Adam, clipping, the check for divergence, and its checkpoint.

    It uses `learning_rate` (unless another one is given), `adam_epsilon` and `max_grad_norm` of the settings.

    Attributes:
        gradient_norm: Euclidean norm of the last step's gradient, before clipping.
    """

    STATE = ("updates", "_weights", "_moments")

    def __init__(self, name: str, networks: Mapping[str, Network], trained: Iterable[str], settings: Any,
                 learning_rate: float | None = None) -> None:
        self.name, self.updates, self.gradient_norm, self._is_wild = name, 0, 0.0, False
        self._networks = networks
        self._max_norm = settings.max_grad_norm
        self._trained = [networks[key] for key in trained]
        self._first_norm = self._measure_weights()
        self._inputs = [parameter for network in self._trained for parameter in network.parameters()]
        self._rate, self._epsilon = learning_rate or settings.learning_rate, settings.adam_epsilon
        self._begin_moments()

    def _begin_moments(self) -> None:
        """Set the averages of Adam to zero, on the device of the weights."""
        vectors = [network.weights for network in self._trained]
        self._means, self._squares = ([torch.zeros_like(vector) for vector in vectors] for _ in range(2))
        self._steps = [torch.zeros((), device=vector.device) for vector in vectors]

    def _step(self) -> None:
        """One step of Adam. `torch.optim.Adam.step` takes twice the time for networks of this size."""
        adam([network.weights for network in self._trained], [network.gradient for network in self._trained],
             self._means, self._squares, [], self._steps, fused=True, amsgrad=False, beta1=0.9, beta2=0.999,
             lr=self._rate, weight_decay=0.0, eps=self._epsilon, maximize=False)

    def move(self, device: torch.device) -> None:
        """Move networks and optimiser to a device."""
        if all(network.weights.device == device for network in self._networks.values()):
            return
        state = self.state_dict()
        for network in self._networks.values():
            network.move(device)
        self._inputs = [parameter for network in self._trained for parameter in network.parameters()]
        self._begin_moments()
        self.load_state_dict(state)

    def minimise(self, loss: torch.Tensor) -> float:
        """Make one gradient step; return the loss.

        Raises:
            DivergenceError: the loss or its gradient is NaN or infinite; the weights are unchanged.
        """
        value = loss.item()
        if not math.isfinite(value):
            raise DivergenceError(self.name, self.updates, loss=value)
        for network in self._trained:
            network.gradient.zero_()
        loss.backward(inputs=self._inputs)
        self.gradient_norm = norm = math.hypot(*(vector_norm(network.gradient).item() for network in self._trained))
        if not math.isfinite(norm):
            raise DivergenceError(self.name, self.updates, loss=value, gradient_norm=norm)
        if not self._is_wild and (reason := self._find_divergence(value)) is not None:
            self._is_wild = True
            warnings.warn(f"{self.name} diverges: {reason}its loss is {value:.3g} and the norm of its gradient "
                          f"{norm:.3g} (update {self.updates}). Lower learning_rate, or reward_scale if rewards are "
                          "large", stacklevel=2)
        if self._max_norm and norm > self._max_norm:
            for network in self._trained:
                network.gradient.mul_(self._max_norm / norm)
        self._step()
        self.updates += 1
        return value

    def minimise_each(self, losses: Iterable[Mapping[str, torch.Tensor]]) -> dict[str, float]:
        """Make one step on the first part of each before the next is computed; return the means of all parts."""
        totals: dict[str, torch.Tensor] = {}
        count = 0
        for parts in losses:
            self.minimise(next(iter(parts.values())))
            totals = {name: totals.get(name, 0.0) + part.detach() for name, part in parts.items()}
            count += 1
        return {name: float(total) / count for name, total in totals.items()}

    def _measure_weights(self) -> float:
        return math.hypot(*(network.weights.norm().item() for network in self._trained))

    def _find_divergence(self, loss: float) -> str | None:
        """Return why learning diverges, as the beginning of a sentence, or None."""
        if abs(loss) > WILD_LOSS:
            return ""
        if self.updates % GROWTH_EVERY or not self._first_norm:
            return None
        growth = self._measure_weights() / self._first_norm
        return f"its weights have grown {growth:.0f} times since they were drawn, " if growth > WILD_GROWTH else None

    @property
    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: network.weights for name, network in self._networks.items()}

    @property
    def _moments(self) -> list[StateTree]:
        """Averages of each trained network's gradient, as arrays; none before the first update."""
        columns = zip(self._steps, self._means, self._squares, strict=True) if self.updates else ()
        return [{name: tensor.cpu().numpy() for name, tensor in zip(_MOMENTS, column, strict=True)}
                for column in columns]

    @_moments.setter
    def _moments(self, saved: list[StateTree]) -> None:
        self._begin_moments()
        for each, *column in zip(saved, self._steps, self._means, self._squares, strict=bool(saved)):
            for name, tensor in zip(_MOMENTS, column, strict=True):
                tensor.copy_(torch.from_numpy(np.asarray(each[name])))
