"""What presses prove of a hidden graph: never more than is true, in the end all of it, on the page nothing before."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from hrl_escape.benchmark.solved_probe import find_edges_that_matter
from hrl_escape.commands.play import PlayArgs
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from hrl_escape.env.sampling.generation import generate
from hrl_escape.viewer.pages.panels import KnownEdges, make_graph
from hrl_escape.viewer.play.episode import Episode


def make_room(preset: str, seed: int, **puzzle: object) -> RoomInstance:
    fields = get_preset(preset).to_dict()
    fields["puzzle"] |= puzzle
    return generate(RoomConfig.from_dict(fields), seed)


def press_in_every_state(episode: Episode, check: Callable[[], None], seen: set) -> None:
    """Press each button in each state that presses lead to, taking every press back."""
    seen.add(episode.state.puzzle)
    for action in range(episode.primitive_count, len(episode.names) - 1):
        if episode.do(action) is not None:
            check()
            if episode.state.puzzle not in seen and not episode.is_over:
                press_in_every_state(episode, check, seen)
            episode.undo()


@pytest.mark.nightly_for("1-puzzle1", "2-puzzle1", "2-puzzle0", "1-puzzle0")
@pytest.mark.parametrize("puzzle", [{}, {"on_violation": "reset"}])
@pytest.mark.parametrize("seed", range(3))
def test_edges_that_are_proved_are_true_and_true_ones_stay_possible(seed: int, puzzle: dict):
    room = make_room("clutter", seed, **puzzle)
    episode, true = Episode(room, is_hidden=True), set(get_mixin(room.puzzle, Graphed).edges)
    discovery = episode.discovery
    assert discovery is not None and true

    def check() -> None:
        proved, possible = map(set, discovery.list_edges())
        lit = {child for _, child in possible}
        assert proved <= true and {edge for edge in true if edge[1] in lit} <= possible

    press_in_every_state(episode, check, set())
    proved, possible = map(set, discovery.list_edges())
    assert proved == find_edges_that_matter(true, range(4)) and possible >= true


def test_nothing_is_concluded_where_a_button_can_lock_another(clutter):
    room = generate(get_preset("dead-ends"), 0)
    episode = Episode(room, is_hidden=True)
    episode.do(episode.primitive_count)
    assert episode.discovery is not None and episode.discovery.list_edges() == ((), ())


def test_the_command_hides_the_graph_where_it_is_asked_to():
    assert PlayArgs(hidden=True).make_episode().discovery is not None
    assert PlayArgs().make_episode().discovery is None


def test_a_hidden_graph_looks_the_same_whatever_it_is():
    drawn = set()
    for seed in range(3):
        puzzle = generate(get_preset("four-button-chain"), seed).puzzle
        drawn.add(make_graph(puzzle, puzzle.make_state(), believed=KnownEdges(), is_hidden=True))
    assert len(drawn) == 1 and "class=\"edge\"" not in drawn.pop()
    assert len({make_graph(generate(get_preset("four-button-chain"), seed).puzzle,
                           generate(get_preset("four-button-chain"), seed).puzzle.make_state())
                for seed in range(3)}) > 1


def test_a_drawn_graph_holds_all_its_discs():
    puzzle = generate(get_preset("ten-button"), 0).puzzle
    for is_hidden in (False, True):
        page = make_graph(puzzle, puzzle.make_state(), is_hidden=is_hidden)
        left, top, width, height = map(float, re.search(r'<svg [^>]*viewBox="([^"]*)"', page)[1].split())
        discs = [[float(re.search(rf'{key}="([^"]*)"', disc)[1]) for key in ("cx", "cy", "r")]
                 for disc in re.findall(r'<circle class="node"[^>]*>', page)]
        assert len(discs) == 10
        assert all(left <= x - r and x + r <= left + width and top <= y - r and y + r <= top + height
                   for x, y, r in discs)


def test_a_belief_is_drawn_with_what_is_wrong_in_red_and_what_is_open_dashed(two_buttons):
    puzzle = two_buttons.puzzle
    (edge,) = get_mixin(puzzle, Graphed).edges
    page = make_graph(puzzle, puzzle.make_state(), believed=KnownEdges([edge], [edge[::-1]]))
    right, wrong = (next(line for line in page.split("<") if f'data-edge="{a}-{b}"' in line)
                    for a, b in (edge, edge[::-1]))
    assert "dasharray" not in right and "dasharray" in wrong and right.split("stroke=")[1] != wrong.split("stroke=")[1]
