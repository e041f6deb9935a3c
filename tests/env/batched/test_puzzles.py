"""Tensor forms of puzzles against the scalar rules: many instances at once, along random presses."""

import numpy as np
import pytest
import torch

from hrl_escape.env.batched.puzzles.base import as_signed, get_tensor_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.code_lock import CodeLockConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.hanoi import HanoiConfig
from hrl_escape.env.puzzles.lights_out import LightsOutConfig

KINDS = {
    "buttons": ButtonsConfig(count=7, graph=GraphConfig(kind="random"), on_violation="reset", allow_off=True),
    "bit-flip": BitFlipConfig(count=9),
    "lights-out": LightsOutConfig(rows=3, columns=5, scramble=4),
    "lights-out 4 x 6": LightsOutConfig(rows=4, columns=6, task=4),
    "hanoi": HanoiConfig(discs=4),
    "code-lock": CodeLockConfig(digits=4, length=6, memory="slide"),
    "code-lock, hidden": CodeLockConfig(digits=3, length=4, shown=False),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_tensor_form_does_what_the_puzzle_does(name):
    puzzles = [KINDS[name].make_puzzle(np.random.default_rng(seed)) for seed in range(32)]
    form, targets = get_tensor_puzzle(KINDS[name].kind), len(puzzles[0].target_names)
    tables = {key: torch.from_numpy(np.array(value)) for key, value in form.make_tables(puzzles, targets).items()}
    states = [puzzle.make_state() for puzzle in puzzles]
    words = torch.tensor([as_signed(form.encode(state)) for state in states])
    rng, solved = np.random.default_rng(0), 0
    for _ in range(300):
        pressed = [tuple(np.flatnonzero(rng.random(targets) < 1.2 / targets).tolist()) for _ in puzzles]
        states = [puzzle.update(state, Contacts(press)) for puzzle, state, press in
                  zip(puzzles, states, pressed, strict=True)]
        bits = torch.tensor([sum(1 << target for target in press) for press in pressed])
        words = form.update(tables, words, bits, targets)
        assert words.tolist() == [as_signed(form.encode(state)) for state in states]
        both = list(zip(puzzles, states, strict=True))
        assert form.is_solved(tables, words).tolist() == [puzzle.is_solved(state) for puzzle, state in both]
        solved += int(form.is_solved(tables, words).sum())
        lit = [as_signed(sum(1 << i for i, on in enumerate(puzzle.get_lit(state)) if on)) for puzzle, state in both]
        assert form.get_lit(tables, words).tolist() == lit
        seen = np.array([puzzle.observe(state) for puzzle, state in both], dtype=np.float32)
        assert np.array_equal(form.observe(tables, words, targets).numpy().T, seen)
    assert solved or name in ("bit-flip", "lights-out", "lights-out 4 x 6", "hanoi"), "also the end was compared"
