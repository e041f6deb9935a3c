"""Taxi (Dietterich 2000): fetch the passenger at one of four depots, and set them down at another.

The depots are pads on the floor. `grip` on the passenger's pad picks them up, `release` on any pad sets them down.
`grip` and `release` without effect cost 10. A fickle passenger may change the destination on the first ride of one
cell. Episodes begin with any of the twelve pairs of depot and destination. The state encodes (passenger, destination,
has settled, is delivered) as an integer.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, NamedTuple

from hrl_escape.env.puzzles.base import Contacts, Pads, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.settings import Range

DEPOTS = ("red", "green", "yellow", "blue")
RIDING = len(DEPOTS)
"""Place of a passenger in the taxi; depots are places 0 to 3."""
REFUSED = -9.0
"""Reward of `grip` or `release` without effect, in addition to the reward of a primitive."""

Fickleness = Annotated[float, Range(0, 1, open_high=True)]


class Ride(NamedTuple):
    """Decoded state of the puzzle."""

    passenger: int  # index of a depot, or `RIDING`
    destination: int  # index of a depot
    settled: bool = False  # whether the destination is final
    delivered: bool = False  # whether the passenger has arrived


@dataclasses.dataclass(frozen=True)
class TaxiConfig(PuzzleConfig):
    """Configuration of Taxi, whose depots are pads."""

    kind = "taxi"
    fickleness: Fickleness = 0.0
    """Probability that the passenger changes the destination on the first ride of one cell."""
    depots: Pads = Pads()
    """Size and places of the red, green, yellow and blue depot."""


@dataclasses.dataclass(frozen=True)
class TaxiPuzzle(Modelled, Puzzle):
    """A concrete ride. The depots are named `red`, `green`, `yellow` and `blue`."""

    kind = "taxi"
    fixed_names = DEPOTS
    are_pads = True
    fickleness: Fickleness = 0.0
    """Probability that the passenger changes the destination on the first ride of one cell."""

    @property
    def chances(self) -> tuple[float, ...]:
        """Thresholds of the four outcomes of a first ride: no change, or a change to one of the other three depots."""
        share = self.fickleness / (RIDING - 1)
        return tuple(1.0 - self.fickleness + turn * share for turn in range(RIDING - 1)) if self.fickleness else ()

    @property
    def is_watching(self) -> bool:
        """True if the passenger is fickle: any move can be the first ride of one cell."""
        return self.fickleness > 0.0

    def encode(self, ride: Ride) -> int:
        """Return the state of a ride."""
        return ride.passenger | ride.destination << 3 | ride.settled << 5 | ride.delivered << 6

    def decode(self, state: int) -> Ride:
        """Return the ride of a state."""
        return Ride(state & 7, state >> 3 & 3, bool(state >> 5 & 1), bool(state >> 6 & 1))

    def list_starts(self) -> tuple[int, ...]:
        """List the twelve initial states, with the passenger at one depot and another depot as destination."""
        return tuple(self.encode(Ride(passenger, destination)) for passenger in range(RIDING)
                     for destination in range(RIDING) if passenger != destination)

    def make_state(self) -> int:
        """Return the state of the first pair of depot and destination."""
        return self.list_starts()[0]

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a ride."""
        if type(state) is not int or not 0 <= state < 1 << 7:
            return False
        ride = self.decode(state)
        return ride.passenger <= RIDING and (not ride.delivered or ride.passenger == ride.destination)

    def update(self, state: int, contacts: Contacts) -> int:
        """Pick the passenger up, set them down, or settle the destination on the first ride of one cell."""
        ride = self.decode(state)
        if ride.delivered:
            return state
        if contacts.grip > 0 and ride.passenger in contacts.touching:
            ride = ride._replace(passenger=RIDING)
        elif contacts.grip < 0 and ride.passenger == RIDING and contacts.touching:
            here = contacts.touching[0]
            ride = ride._replace(passenger=here, delivered=here == ride.destination)
        elif self.fickleness and contacts.has_moved and ride.passenger == RIDING and not ride.settled:
            share = (contacts.uniform - (1.0 - self.fickleness)) / self.fickleness
            turn = 1 + min(int(share * (RIDING - 1)), RIDING - 2) if share >= 0.0 else 0
            ride = ride._replace(destination=(ride.destination + turn) % RIDING, settled=True)
        return self.encode(ride)

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Return `REFUSED` for a `grip` or `release` without effect, otherwise 0."""
        return REFUSED if contacts.grip and after == before else 0.0

    def is_solved(self, state: int) -> bool:
        """Return whether the passenger was delivered."""
        return self.decode(state).delivered

    def observe(self, state: int) -> tuple[float, ...]:
        """Return one number per place of the passenger, the taxi last, then one per destination."""
        ride = self.decode(state)
        return tuple(float(ride.passenger == place) for place in range(RIDING + 1)) + tuple(
            float(ride.destination == depot) for depot in range(RIDING))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each depot is the destination."""
        return tuple(depot == self.decode(state).destination for depot in range(RIDING))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `waits(depot)` or `riding`, `to(depot)`, and `delivered`."""
        ride = self.decode(state)
        facts = {"riding" if ride.passenger == RIDING else f"waits({DEPOTS[ride.passenger]})",
                 f"to({DEPOTS[ride.destination]})"}
        return frozenset(facts | ({"delivered"} if ride.delivered else set()))

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per depot to pick up there, and one to set down at the destination there."""
        operators = []
        delivered, riding = frozenset({"delivered"}), frozenset({"riding"})
        for depot in DEPOTS:
            waits = frozenset({f"waits({depot})"})
            operators.append(Operator(f"pick-up-at-{depot}", depot, "grip", waits, delivered, riding, waits))
            operators.append(Operator(f"put-down-at-{depot}", depot, "release", riding | {f"to({depot})"},
                                      add=waits | delivered, delete=riding))
        facts = (*(f"waits({depot})" for depot in DEPOTS), *(f"to({depot})" for depot in DEPOTS), "riding", "delivered")
        return SymbolicModel(facts, tuple(operators), delivered)


register_puzzle(TaxiConfig, TaxiPuzzle)
