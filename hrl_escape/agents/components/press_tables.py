"""Tables over what buttons show, learned from presses in several rooms, and the odds of presses in another room.

`PlaceTables` gives each button a distribution over its place in the order, by its symbol or its direction from the
middle of the floor. `PairTables` gives each pair (b, j) a probability q that b cannot light while j is off: by the plug
of b and the colour of j, by their numbers, or by scores of their directions (Bradley and Terry 1952). A press of b
lights if no button that is off blocks it, so its odds are the product of 1 - q(b, j): a noisy-or (Pearl 1988).

A room has one of several latent tasks, each with tables of its own, and presses in the room reveal which one: a
mixture of experts (Jacobs et al. 1991). Tables maximise the likelihood of all presses. The members of an ensemble leave
out different rooms, and each stops where it predicts the order of the rooms that it left out best. The kind of table is
chosen in the same way.
"""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.settings import Range

COLOUR_COUNT, PLUG_COUNT, SECTOR_COUNT = 8, 12, 16
"""Colours of a symbol; plugs, its shape and size; and directions from the middle of the floor."""
FOLDS = 4
"""Parts of the training rooms; each member leaves out one."""
STEPS_WITHOUT_GAIN = 25
"""Steps without a better prediction of the rooms left out, by any member, before training stops."""
CUE_DECAY, MIX_DECAY = 10.0, 1.0
"""Factors of the weight decay for tables, and for the weights that combine their columns."""


@dataclasses.dataclass
class RoomPresses:
    """Appearance of the buttons of a room, and results of presses.

    Attributes:
        symbols: symbol of each button, int64 (buttons,); -1 without.
        sectors: direction of each button from the middle of the floor, int64 (buttons,).
        cleared: whether each button is known not to wait for another, bool (buttons, buttons).
        failures: for each button the smallest sets of others that were off when a press failed, bool (buttons,) each.
        order: buttons in the order of the longest sequence of lights without a reset.
        lit: the same for the running sequence.
        goal: the button that opened the exit, or None before.
    """

    symbols: NDArray[np.int64]
    sectors: NDArray[np.int64]
    cleared: NDArray[np.bool_]
    failures: list[list[NDArray[np.bool_]]]
    order: list[int] = dataclasses.field(default_factory=list[int])
    lit: list[int] = dataclasses.field(default_factory=list[int])
    goal: int | None = None

    @classmethod
    def begin(cls, symbols: Sequence[int], sectors: Sequence[int]) -> RoomPresses:
        """Return a room without presses; symbols may be empty."""
        count = len(sectors)
        return cls(np.array(symbols or [-1] * count), np.array(sectors), np.zeros((count, count), dtype=bool),
                   [[] for _ in range(count)])

    def note(self, button: int, off: NDArray[np.bool_], has_lit: bool, has_opened: bool = False) -> None:
        """Note a press of a button; `off` are the buttons that were off before, bool (buttons,)."""
        if has_opened:
            self.goal = button
        others = off.copy()
        others[button] = False
        if not has_lit:
            if not self.fails(button, off):
                smaller = [other for other in self.failures[button] if not (others <= other).all()]
                self.failures[button] = [*smaller, others]
            return
        self.cleared[button] |= others
        self.lit = [*self.lit[: int((~off).sum())], button]
        if len(self.lit) >= len(self.order):
            self.order = self.lit

    def fails(self, button: int, off: NDArray[np.bool_]) -> bool:
        """Return whether a press is known to fail while these buttons are off."""
        others = off.copy()
        others[button] = False
        return any(bool((other <= others).all()) for other in self.failures[button])

    def lights(self, button: int, off: NDArray[np.bool_]) -> bool:
        """Return whether a press is known to turn the button on while these buttons are off."""
        others = off.copy()
        others[button] = False
        return bool((others <= self.cleared[button]).all())


class PressBatch(NamedTuple):
    """Rooms as tensors, with b buttons, s failures of a button and p places in an order."""

    symbols: Tensor  # int64 (rooms, b)
    sectors: Tensor  # int64 (rooms, b)
    present: Tensor  # bool (rooms, b)
    cleared: Tensor  # float32 (rooms, b, b)
    failed: Tensor  # float32 (rooms, b, s, b), buttons of which at least one blocked the press
    is_failure: Tensor  # float32 (rooms, b, s)
    off: Tensor  # float32 (rooms, p, b), buttons off at each place of the order
    following: Tensor  # int64 (rooms, p), the button that was next
    is_step: Tensor  # float32 (rooms, p), 0 after the end of an order
    earliest: Tensor  # int64 (rooms, b), first place that is still possible
    place: Tensor  # int64 (rooms, b), place in the order, or -1
    may_open: Tensor  # bool (rooms, b), whether the button may be the one that opens the exit


def make_press_batch(rooms: Sequence[RoomPresses]) -> PressBatch:
    """Return rooms as tensors, padded to the most buttons and failures."""
    count = max(len(room.sectors) for room in rooms)
    most = max(1, *(len(own) for room in rooms for own in room.failures))
    shape = (len(rooms), count)
    batch = {"symbols": np.full(shape, -1), "sectors": np.zeros(shape, np.int64), "present": np.zeros(shape, bool),
             "cleared": np.zeros((*shape, count), np.float32), "failed": np.zeros((*shape, most, count), np.float32),
             "is_failure": np.zeros((*shape, most), np.float32), "off": np.zeros((*shape, count), np.float32),
             "following": np.zeros(shape, np.int64), "is_step": np.zeros(shape, np.float32),
             "earliest": np.zeros(shape, np.int64), "place": np.full(shape, -1), "may_open": np.zeros(shape, bool)}
    for at, room in enumerate(rooms):
        own = len(room.sectors)
        batch["symbols"][at, :own], batch["sectors"][at, :own] = room.symbols, room.sectors
        batch["present"][at, :own], batch["cleared"][at, :own, :own] = True, room.cleared
        batch["earliest"][at, :own] = len(room.order)
        closed = set(room.order) if room.goal is None else set(range(own)) - {room.goal}  # these do not open the exit
        batch["may_open"][at, :own] = [each not in closed or len(closed) == own for each in range(own)]
        for place, button in enumerate(room.order):
            batch["off"][at, place, :own], batch["off"][at, place, room.order[:place]] = 1.0, 0.0
            batch["following"][at, place], batch["is_step"][at, place] = button, 1.0
            batch["place"][at, button] = place
        for button, failures in enumerate(room.failures):
            for number, others in enumerate(failures):
                batch["failed"][at, button, number, :own] = others & ~room.cleared[button]
                batch["is_failure"][at, button, number] = 1.0
                batch["earliest"][at, button] = max(batch["earliest"][at, button], own - int(others.sum()))
    return PressBatch(*map(torch.from_numpy, batch.values()))


@dataclasses.dataclass(frozen=True, kw_only=True)
class TableSettings(AgentSettings):
    """Form of the tables, and their training."""

    tasks: Annotated[int, Range(1, 16)] = 4
    """Latent tasks, such as codes or graphs, of which each room has one. More of them need more rooms."""
    width: Annotated[int, Range(1, 64)] = 6
    """Columns of a table of symbols or directions. More fit more, and need more rooms."""
    members: Annotated[int, Range(4, 64)] = 4
    """Members of the ensemble; each leaves out a quarter of the rooms. More are slower and more stable."""
    learning_rate: Annotated[float, Range(1e-5, 1)] = 0.05
    """Step size of Adam."""
    weight_decay: Annotated[float, Range(0)] = 0.05
    """Weight of the squared tables in the loss. More of it trusts few rooms less."""
    steps: Annotated[int, Range(1)] = 200
    """Most steps over all presses."""


class PressTables(nn.Module):
    """Base of tables. Shapes are (members, tasks, rooms, ...).

    Attributes:
        cue: what they read of buttons, one of `PRESS_CUES`.
        prior: logits of the latent tasks, (members, tasks).
        weights: log weights of the members, (members, 1).
    """

    def __init__(self, cue: str, settings: TableSettings) -> None:
        super().__init__()
        self.cue, self._settings = cue, settings
        self.prior = nn.Parameter(torch.zeros(settings.members, settings.tasks))
        self.weights: Tensor
        self.register_buffer("weights", torch.zeros(settings.members, 1))

    @abstractmethod
    def compute_evidence(self, rooms: PressBatch) -> Tensor:
        """Return the log likelihood of all presses in each room, (members, tasks, rooms)."""

    @abstractmethod
    def compute_steps(self, rooms: PressBatch) -> Tensor:
        """Return the log odds of each button at each place of the order, (members, tasks, rooms, p, b)."""

    @abstractmethod
    def compute_lights(self, room: RoomPresses, rooms: PressBatch, off: NDArray[np.bool_]) -> Tensor:
        """Return the probability that each button of a room lights now, (members x tasks, b)."""

    def compute_needs(self, rooms: PressBatch) -> Tensor:
        """Return the probability that the exit needs each button of a room, (members x tasks, b); 1 by default."""
        return torch.ones(self.prior.numel(), rooms.symbols.shape[1])

    @abstractmethod
    def compute_decay(self) -> Tensor:
        """Return the penalty of the tables."""

    def weigh_tasks(self, evidence: Tensor) -> Tensor:
        """Return the log likelihood of each room, (members, rooms), from that under each task."""
        return torch.logsumexp(evidence + torch.log_softmax(self.prior, 1)[..., None], 1)

    def score_orders(self, rooms: PressBatch) -> Tensor:
        """Return the log probability of the orders by the odds of each step, (members, rooms)."""
        odds = self.compute_steps(rooms).masked_fill(rooms.off == 0, -torch.inf)
        odds = torch.where(rooms.is_step[..., None] > 0, odds, 0.0).log_softmax(-1)
        index = rooms.following[None, None, ..., None].expand(*odds.shape[:-1], 1)
        return self.weigh_tasks((odds.gather(-1, index)[..., 0] * rooms.is_step).sum(-1))

    def predict(self, room: RoomPresses, off: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Predict presses.

        Args:
            room: the room and its presses so far.
            off: buttons that are off, bool (buttons,).

        Returns:
            Probability that each button lights if it is pressed now, (buttons,), 0 if it is on; and that the exit needs
            the button if it lights, (buttons,).
        """
        with torch.no_grad():
            rooms = make_press_batch([room])
            evidence = self.compute_evidence(rooms)[..., 0] + torch.log_softmax(self.prior, 1) + self.weights
            weights = torch.softmax(evidence.flatten(), 0)
            lights = self.compute_lights(room, rooms, off)
            odds = (weights @ lights).double().numpy()
            needed = (weights @ (lights * self.compute_needs(rooms))).double().numpy() / odds
        return odds * off, needed


class PlaceTables(PressTables):
    """Distributions over places: at each place exactly one button can light, as in a chain."""

    def __init__(self, cue: str, settings: TableSettings, buttons: int, generator: torch.Generator) -> None:
        super().__init__(cue, settings)
        rows = COLOUR_COUNT * PLUG_COUNT + 1 if cue == "symbol" else SECTOR_COUNT
        members, tasks, width = settings.members, settings.tasks, settings.width
        self.table = nn.Parameter(0.1 * torch.randn(members, rows, width, generator=generator))
        self.mix = nn.Parameter(torch.randn(members, tasks, width, buttons, generator=generator))

    def _rank(self, rooms: PressBatch) -> tuple[Tensor, Tensor]:
        """Return log P(place = p) and log P(place >= p), (members, tasks, rooms, b, p)."""
        own = self.table[:, rooms.symbols if self.cue == "symbol" else rooms.sectors]
        logits = torch.einsum("mrbw,mkwp->mkrbp", own, self.mix[..., : rooms.symbols.shape[1]])
        places = logits.masked_fill(~rooms.present[:, None], -1e4).log_softmax(-1)
        return places, places.flip(-1).logcumsumexp(-1).flip(-1)

    def compute_evidence(self, rooms: PressBatch) -> Tensor:
        """Return the log likelihood of known places, and of the places that are left for the other buttons."""
        places, later = self._rank(rooms)
        most = places.shape[-1] - 1
        known = places.gather(-1, _spread(rooms.place.clamp(min=0), places))[..., 0]
        left = later.gather(-1, _spread(rooms.earliest.clamp(max=most), places))[..., 0] * (rooms.earliest <= most)
        return (torch.where(rooms.place >= 0, known, left) * rooms.present).sum(-1)

    def compute_steps(self, rooms: PressBatch) -> Tensor:
        """Return log P(place = p | place >= p)."""
        places, later = self._rank(rooms)
        return (places - later).transpose(-1, -2)

    def compute_lights(self, room: RoomPresses, rooms: PressBatch, off: NDArray[np.bool_]) -> Tensor:
        """Return P(place = p | place >= p) at the present place."""
        return self.compute_steps(rooms)[:, :, 0, int((~off).sum())].flatten(0, 1).exp()

    def compute_decay(self) -> Tensor:
        """Return the penalty of the tables."""
        return CUE_DECAY * self.table.square().sum() + MIX_DECAY * self.mix.square().sum()


class PairTables(PressTables):
    """Probabilities q(b, j) that b cannot light while j is off."""

    def __init__(self, cue: str, settings: TableSettings, buttons: int, generator: torch.Generator) -> None:
        super().__init__(cue, settings)
        members, tasks = settings.members, settings.tasks
        shape = {"number": (buttons, buttons), "plug": (PLUG_COUNT, COLOUR_COUNT), "bearing": (SECTOR_COUNT, 1)}[cue]
        self.base = nn.Parameter(torch.zeros(members, tasks))
        spread = 1.0 if cue == "number" else 0.1  # more of it separates tasks, and less of it trusts few rooms less
        self.table = nn.Parameter(spread * torch.randn(members, tasks, *shape, generator=generator))
        self.rows = nn.Parameter(torch.zeros(members, tasks, shape[0]))
        self.opens = nn.Parameter(torch.zeros(members, tasks, buttons))

    def _free(self, rooms: PressBatch) -> Tensor:
        """Return log(1 - q), (members, tasks, rooms, b, b), 0 on the diagonal."""
        count = rooms.symbols.shape[1]
        if self.cue == "bearing":  # the higher score waits for the lower one
            scores = self.table[:, :, rooms.sectors, 0]
            logits = scores[..., :, None] - scores[..., None, :]
        elif self.cue == "number":
            logits = (self.table[:, :, :count, :count] + self.rows[:, :, :count, None])[:, :, None]
            logits = logits.expand(-1, -1, len(rooms.symbols), -1, -1)
        else:
            colours = rooms.symbols % COLOUR_COUNT
            plugs = rooms.symbols.clamp(min=0).div(COLOUR_COUNT, rounding_mode="floor")
            logits = self.table[:, :, plugs[:, :, None], colours[:, None, :]] + self.rows[:, :, plugs][..., None]
        free = nn.functional.logsigmoid(-(logits + self.base[:, :, None, None, None]))
        return free * (1 - torch.eye(count))

    def compute_evidence(self, rooms: PressBatch) -> Tensor:
        """Return the log likelihood that nothing blocked the lights, and that something blocked each failure."""
        free = self._free(rooms)
        passed = torch.einsum("mkrbj,rbsj->mkrbs", free, rooms.failed).clamp(max=-1e-6)
        blocked = torch.log(-torch.expm1(passed)) * rooms.is_failure
        found = (free * rooms.cleared).sum((-1, -2)) + blocked.sum((-1, -2))
        if self.cue != "number":
            return found
        return found + self._open(rooms).masked_fill(~rooms.may_open, -torch.inf).logsumexp(-1)

    def _open(self, rooms: PressBatch) -> Tensor:
        """Return the log probability that each number opens the exit, (members, tasks, rooms, b)."""
        logits = self.opens[:, :, None, : rooms.symbols.shape[1]].expand(-1, -1, len(rooms.symbols), -1)
        return logits.masked_fill(~rooms.present, -1e4).log_softmax(-1)

    def compute_needs(self, rooms: PressBatch) -> Tensor:
        """Return the probability that a button opens the exit, or blocks one that is needed, along the best path."""
        if self.cue != "number":
            return super().compute_needs(rooms)
        goals = self._open(rooms).masked_fill(~rooms.may_open, -1e4).softmax(-1)[:, :, 0].flatten(0, 1)
        blocks = 1 - self._free(rooms)[:, :, 0].flatten(0, 1).exp()  # 0 on the diagonal
        needs = torch.eye(goals.shape[1]).expand(len(goals), -1, -1)  # of each goal
        for _ in range(goals.shape[1] - 1):
            needs = torch.maximum(needs, (needs[..., None] * blocks[:, None]).amax(2))
        return (goals[..., None] * needs).sum(1)

    def compute_steps(self, rooms: PressBatch) -> Tensor:
        """Return the log probability that no button that is off blocks each button."""
        return torch.einsum("mkrbj,rpj->mkrpb", self._free(rooms), rooms.off)

    def compute_lights(self, room: RoomPresses, rooms: PressBatch, off: NDArray[np.bool_]) -> Tensor:
        """Return the probability that nothing blocks each button, given its failures."""
        free, found = self._free(rooms)[:, :, 0].flatten(0, 1), []
        for button in range(len(off)):
            others = off.copy()
            others[button] = False
            odds = free[:, button, others & ~room.cleared[button]].sum(1).exp()
            for failed in room.failures[button]:
                if (others <= failed).all():  # something in `failed` blocks it: P(A | not B) with A above B
                    all_free = free[:, button, failed & ~room.cleared[button]].sum(1).exp()
                    odds = (odds - all_free) / (1 - all_free).clamp(min=1e-9)
                    break
            found.append(odds.clamp(min=1e-12))
        return torch.stack(found, 1)

    def compute_decay(self) -> Tensor:
        """Return the penalty of the tables."""
        return CUE_DECAY * (self.table.square().sum() + self.rows.square().sum() + self.opens.square().sum())


def _spread(index: Tensor, places: Tensor) -> Tensor:
    return index[None, None, ..., None].expand(*places.shape[:-1], 1)


_FORMS: dict[str, type[PlaceTables | PairTables]] = {
    "symbol": PlaceTables, "sector": PlaceTables, "bearing": PairTables, "plug": PairTables, "number": PairTables}
PRESS_CUES = tuple(_FORMS)
"""Kinds of tables, by what they read of buttons: `sector` and `bearing` are two forms for directions."""


def fit_press_tables(rooms: Sequence[RoomPresses], settings: TableSettings, buttons: int, seed: int,
                     cues: Sequence[str] = PRESS_CUES) -> PressTables | None:
    """Train tables of every kind, with one task and with all, and return those that predict left-out rooms best.

    Args:
        rooms: training rooms with presses.
        settings: form and training.
        buttons: most buttons of a room.
        seed: of initial tables and of the parts of the rooms.
        cues: kinds of tables to train.

    Returns:
        The tables, or None if no kind predicts the order of the rooms better than chance.
    """
    has_symbols = bool((rooms[0].symbols >= 0).any())
    best, most = None, sum(-math.log(len(room.sectors) - place) for room in rooms for place in range(len(room.order)))
    for cue in cues:
        if has_symbols or cue not in ("symbol", "plug"):
            for tasks in dict.fromkeys((1, settings.tasks)):
                tables = _FORMS[cue](cue, dataclasses.replace(settings, tasks=tasks), buttons,
                                     torch.Generator().manual_seed(seed))
                score = _train(tables, rooms, settings, seed)
                if score > most:
                    best, most = tables, score
    return best


def _train(tables: PressTables, rooms: Sequence[RoomPresses], settings: TableSettings, seed: int) -> float:
    """Train tables, and return the log probability of the orders of all rooms, each by the members that left it out."""
    batch, folds = make_press_batch(rooms), min(FOLDS, len(rooms))
    part = torch.randperm(len(rooms), generator=torch.Generator().manual_seed(seed)) % folds
    left_out = (part[None] == (torch.arange(settings.members) % folds)[:, None]).float()
    optimiser = torch.optim.Adam(tables.parameters(), settings.learning_rate)
    best = torch.full((settings.members,), -torch.inf)
    kept = {name: weights.detach().clone() for name, weights in tables.named_parameters()}
    waited = 0
    for _ in range(settings.steps):
        with torch.no_grad():
            scores = (tables.score_orders(batch) * left_out).sum(1)
            is_better = scores > best + 1e-3
            best = torch.where(is_better, scores, best)
            for name, weights in tables.named_parameters():
                kept[name][is_better] = weights[is_better]
        waited = 0 if is_better.any() else waited + 1
        if waited > STEPS_WITHOUT_GAIN:
            break
        likelihood = (tables.weigh_tasks(tables.compute_evidence(batch)) * (1 - left_out)).sum()
        loss = settings.weight_decay / 2 * tables.compute_decay() - likelihood
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    tables.load_state_dict(kept, strict=False)
    if tables.cue == "number" and tables.prior.shape[1] > 1:  # members can stop in poor optima, with merged tasks
        with torch.no_grad():
            tables.weights.copy_(tables.weigh_tasks(tables.compute_evidence(batch)).sum(1).log_softmax(0)[:, None])
    return float(best.sum()) * folds / settings.members


def pack_press_tables(tables: PressTables) -> dict[str, Any]:
    """Return tables as plain values and arrays."""
    return {"cue": tables.cue, "tasks": tables.prior.shape[1],
            "weights": {name: weights.numpy() for name, weights in tables.state_dict().items()}}


def unpack_press_tables(packed: Mapping[str, Any], settings: TableSettings, buttons: int) -> PressTables:
    """Return the tables that `pack_press_tables` has packed."""
    settings = dataclasses.replace(settings, tasks=packed["tasks"])
    tables = _FORMS[packed["cue"]](packed["cue"], settings, buttons, torch.Generator())
    tables.load_state_dict({name: torch.from_numpy(np.array(weights)) for name, weights in packed["weights"].items()})
    return tables
