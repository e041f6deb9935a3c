"""Taxi as a partial program: get, then put; open are where to go and each move on the way."""

from __future__ import annotations

from hrl_escape.agents.hierarchy.machine import choose, do, machine
from tests.classic.taxi import DEPOTS, EAST, NORTH, PICK_UP, PUT_DOWN, SOUTH, WEST, decode


def read(observation):
    return decode(int(observation))


@machine
def navigate(seen, depot):
    while (seen().state.row, seen().state.column) != DEPOTS[depot]:
        yield do((yield choose((SOUTH, NORTH, EAST, WEST))))


@machine
def fetch(seen):
    while not seen().state.riding:
        yield from navigate((yield choose(range(4))))
        yield do(PICK_UP)


@machine
def deliver(seen):
    while seen().state.riding:
        yield from navigate((yield choose(range(4))))
        yield do(PUT_DOWN)


@machine
def drive(seen):
    while True:
        yield from fetch()
        yield from deliver()
