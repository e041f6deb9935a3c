"""What watching shows of a mind: a searcher's list, a learned graph, and the planner's plan of the whole escape."""

from __future__ import annotations

import dataclasses
import re

import pytest

from hrl_escape.benchmark.episodes import PrimitiveStep
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.planner import get_planner
from hrl_escape.settings import Between
from hrl_escape.viewer.recording import record_driver
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, ObservedChoice, Watch


def test_the_planner_drives_the_escape_that_it_solves_for(clutter):
    plan = get_planner(clutter).solve(open_driver("oracle", clutter).env.unwrapped.rules.make_state(clutter.starts[0]))
    recording = record_driver(open_driver("oracle", clutter))
    assert len(recording.rewards) == plan.cost
    assert [count for _, count in recording.decisions] == [part.stop - part.start for part in plan.parts]


@pytest.mark.parametrize("preset", ["four-rooms", "sokoban"])
def test_the_planner_escapes_where_no_plan_foresees_the_whole_way(preset: str):
    assert record_driver(open_driver("oracle", generate(get_preset(preset), 0))).end == "escaped"


def list_choices(name: str, room) -> list[ObservedChoice]:
    watch = Watch(open_driver(name, room), Gate(None))
    choices: list[ObservedChoice] = []

    def note(step: PrimitiveStep | None) -> None:
        if step is None and watch.choice is not None:
            choices.append(watch.choice)

    watch.on_change = note
    watch.run(1)
    assert watch.events[-1].endswith(f"escaped, return {watch.total:g}")
    assert watch.events[-1].startswith(f"1.{watch.primitives}  "), "episode and primitive"
    return choices


def test_a_searcher_shows_its_list_and_takes_the_nearest_untried():
    room = generate(get_preset("four-button-chain"), 0)
    choices = list_choices("search-nearest", room)
    *presses, leave = choices
    for choice in presses:
        untried = {action: float(re.search(r"[\d.]+", words)[0]) for action, words in choice.notes.items()
                   if words.startswith("untried") and choice.mask[action]}
        assert choice.meaning == "note" and choice.notes[choice.action] in choice.notes.values()
        assert choice.action == min(untried, key=untried.__getitem__)
    assert "tried in vain" in {words for choice in presses for words in choice.notes.values()}
    lit = room.puzzle.get_lit(leave.state.puzzle)
    assert [words == "lit" for words in leave.notes.values()] == list(lit)


@pytest.mark.parametrize(("name", "pattern"), [("search-backtrack", "untried, "), ("bayes", r"lights with \d+%")])
def test_other_searchers_say_what_they_know(name: str, pattern: str, two_buttons):
    first = list_choices(name, two_buttons)[0]
    assert len(first.notes) == 2 and all(re.match(pattern, words) for words in first.notes.values())


def test_a_learned_graph_is_that_of_the_room_once_the_agent_escapes_at_will(two_buttons):
    watch = Watch(open_driver("smdp-factored-r-max", two_buttons), Gate(None))
    assert watch.read_graph() == frozenset(), "nothing is believed before anything was met"

    def note(step: PrimitiveStep | None) -> None:
        if watch.primitives > 150:
            watch.gate.stop()

    watch.on_change = note
    watch.run()
    assert watch.read_graph() == set(get_mixin(two_buttons.puzzle, Graphed).edges)
    assert Watch(open_driver("smdp-q-learning", two_buttons), Gate(None)).read_graph() is None


@pytest.mark.parametrize("observation", ["features", "state"])
def test_a_learned_graph_names_the_targets_of_a_room_with_fewer_than_others_of_its_set_have(observation):
    preset = get_preset("four-button-chain")
    several = dataclasses.replace(preset, puzzle=dataclasses.replace(preset.puzzle, count=Between(2, 4)))
    room = next(room for room in (generate(several, seed) for seed in range(20)) if len(room.targets) == 2)
    assert len(room.frame.target_names) == 4
    watch = Watch(open_driver("smdp-factored-r-max", room, observation=observation), Gate(None))

    def note(step: PrimitiveStep | None) -> None:
        if watch.primitives > 300:
            watch.gate.stop()

    watch.on_change = note
    watch.run()
    assert watch.read_graph() == set(get_mixin(room.puzzle, Graphed).edges)
