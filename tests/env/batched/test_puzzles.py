"""Tensor forms of puzzles against the scalar rules: many instances at once, along random presses and grips."""

import numpy as np
import pytest
import torch

from hrl_escape.env.batched.puzzles.base import TensorContacts, as_signed, get_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig
from hrl_escape.env.puzzles.blocks_world import BlocksWorldConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.codes import CodeLockConfig, PinPadConfig
from hrl_escape.env.puzzles.deep_sea import DeepSeaConfig
from hrl_escape.env.puzzles.factored import FactoredConfig
from hrl_escape.env.puzzles.foraging import ForagingConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.hanoi import HanoiConfig
from hrl_escape.env.puzzles.light_box import LightBoxConfig
from hrl_escape.env.puzzles.lights_out import LightsOutConfig
from hrl_escape.env.puzzles.potions import PotionsConfig
from hrl_escape.env.puzzles.recipes import RecipesConfig
from hrl_escape.env.puzzles.taxi import TaxiConfig

KINDS = {
    "buttons": ButtonsConfig(count=7, graph=GraphConfig(kind="random"), on_violation="reset", allow_off=True),
    "buttons, rules drawn": ButtonsConfig(count=6, graph=GraphConfig(kind="random"), on_violation="drawn"),
    "buttons, dead ends": ButtonsConfig(count=7, graph=GraphConfig(kind="layered", max_parents=2), dead_ends=5),
    "bit-flip": BitFlipConfig(count=9),
    "lights-out": LightsOutConfig(rows=3, columns=5, scramble=4),
    "lights-out 4 x 6": LightsOutConfig(rows=4, columns=6, task=4),
    "hanoi": HanoiConfig(discs=4),
    "recipes": RecipesConfig("wood-pickaxe"),
    "code-lock": CodeLockConfig(digits=4, length=6, memory="slide"),
    "code-lock, hidden": CodeLockConfig(digits=3, length=4, shown=False),
    "light-box": LightBoxConfig(),
    "light-box, sure": LightBoxConfig(count=6, graph=GraphConfig(kind="random", max_parents=2), success=1.0),
    "deep-sea": DeepSeaConfig(size=5),
    "pin-pad": PinPadConfig(count=3),
    "potions": PotionsConfig(features=2, trials=2),
    "potions, three features": PotionsConfig(features=3, trials=1),
    "factored": FactoredConfig(count=3, success=0.7),
    "factored, sure": FactoredConfig(count=4, arity=2, max_parents=1, success=1.0),
    "blocks-world": BlocksWorldConfig(count=4),
    "foraging": ForagingConfig(worms=2),
    "taxi": TaxiConfig(),
}
MIXED = {
    "buttons": [ButtonsConfig(count=count, graph=GraphConfig(kind="chain")) for count in (2, 5, 3)],
    "bit-flip": [BitFlipConfig(count=count) for count in (4, 2)],
    "blocks-world": [BlocksWorldConfig(count=count) for count in (2, 4, 3)],
    "code-lock": [CodeLockConfig(digits=digits, length=2) for digits in (2, 4, 3)],
}
GRIPPING = ("blocks-world", "foraging", "taxi")


def encode(form, puzzles, states):
    return torch.tensor([as_signed(form.encode(*pair)) for pair in zip(puzzles, states, strict=True)])


@pytest.mark.nightly_for(
    "potions, three features", "blocks-world", "buttons", "buttons, dead ends", "bit-flip", "lights-out",
    "lights-out 4 x 6", "hanoi", "recipes", "code-lock", "light-box", "light-box, sure", "deep-sea", "pin-pad",
    "potions", "factored", "factored, sure", "foraging", "taxi", "buttons, rules drawn")
@pytest.mark.parametrize("name", KINDS)
def test_a_tensor_form_does_what_the_puzzle_does(name):
    compare(name, [KINDS[name].make_puzzle(np.random.default_rng(seed)) for seed in range(32)])


@pytest.mark.nightly_for("blocks-world", "code-lock", "buttons")
@pytest.mark.parametrize("kind", MIXED)
def test_so_it_does_where_rooms_have_different_numbers_of_targets(kind):
    compare(kind, [config.make_puzzle(np.random.default_rng(seed)) for seed in range(10) for config in MIXED[kind]])


def compare(name, puzzles):
    """Press, grip and release at random targets of every puzzle, in the form and by the rules."""
    form, targets = get_tensor_puzzle(puzzles[0].kind), max(len(puzzle.target_names) for puzzle in puzzles)
    widest = max(puzzles, key=lambda puzzle: len(puzzle.bounds))
    richest = max(puzzles, key=lambda puzzle: len(puzzle.target_names))
    made = form.make_tables(puzzles, SpaceLayout(target_names=richest.target_names, bounds=widest.bounds))
    tables = {key: torch.from_numpy(np.array(value)) for key, value in made.items()}
    rng, solved, failed = np.random.default_rng(0), 0, 0
    for round_ in range(300):
        if round_ % 30 == 0:
            states = [starts[int(rng.integers(len(starts)))] for starts in map(type(puzzles[0]).list_starts, puzzles)]
            words = encode(form, puzzles, states)
        counts = [len(puzzle.target_names) for puzzle in puzzles]
        touched = [tuple(np.flatnonzero(rng.random(count) < 1.2 / count).tolist()) for count in counts]
        chances, grips = rng.random(len(puzzles)), rng.integers(-1, 2, len(puzzles)) * (puzzles[0].kind in GRIPPING)
        pressed = [() if grip else touch for grip, touch in zip(grips, touched, strict=True)]
        contacts = [Contacts(press, uniform=chance, touching=touch, grip=grip) for press, touch, chance, grip
                    in zip(pressed, touched, chances.tolist(), grips.tolist(), strict=True)]
        before, words_before = states, words
        states = [puzzle.update(*pair) for puzzle, *pair in zip(puzzles, states, contacts, strict=True)]
        bits, touching = (torch.tensor([sum(1 << target for target in some) for some in each])
                          for each in (pressed, touched))
        here, acts = torch.zeros(len(puzzles), dtype=torch.float64), (bits != 0) | torch.from_numpy(grips != 0)
        told = TensorContacts(bits, torch.from_numpy(chances), touching, torch.from_numpy(grips), bits != 0, here, here,
                              0 * bits - 1, 0 * bits - 1)
        words = form.update(tables, words, told, targets)
        assert words.tolist() == encode(form, puzzles, states).tolist()
        both = list(zip(puzzles, states, strict=True))
        steps = zip(puzzles, before, states, contacts, strict=True)
        rewards = [puzzle.compute_reward(*step) for puzzle, *step in steps]
        earned = form.compute_reward(tables, words_before, words, told, targets)
        earned = torch.zeros(len(bits)) if earned is None else torch.where(acts, earned, 0.0)
        assert np.array_equal(earned.to(torch.float32).numpy(), np.array(rewards, dtype=np.float32))
        lost = form.is_failed(tables, words)
        lost = [False] * len(bits) if lost is None else lost.tolist()
        assert lost == [puzzle.is_failed(state) for puzzle, state in both]
        failed += sum(lost)
        assert form.is_solved(tables, words).tolist() == [puzzle.is_solved(state) for puzzle, state in both]
        solved += int(form.is_solved(tables, words).sum())
        lit = [as_signed(sum(1 << i for i, on in enumerate(puzzle.get_lit(state)) if on)) for puzzle, state in both]
        assert form.get_lit(tables, words).tolist() == lit
        seen = np.zeros((len(puzzles), len(widest.bounds)), dtype=np.float32)
        for row, (puzzle, state) in enumerate(both):
            seen[row, : len(puzzle.bounds)] = puzzle.observe(state)
        assert np.array_equal(form.observe(tables, words, targets).numpy().T, seen)
    rare = ("bit-flip", "lights-out", "lights-out 4 x 6", "hanoi", "light-box")
    assert solved or name in rare, "also the end was compared"
    assert failed or name != "deep-sea"
