"""What one floor teaches: sentences from data of other truths, and real towers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.room_sequence import repeat_set
from studies.storeys.analysis import FloorRun, play_towers, tell
from studies.study import find_study
from tests.studies.pages import tell as write_page

STUDY = find_study("storeys")
DATA = STUDY.data


def make_lines(remembers: tuple[float, ...]) -> list[FloorRun]:
    """Forty towers around these efficiencies by floor; who forgets and the searcher stay where they are."""
    rng = np.random.default_rng(0)
    return [FloorRun(agent, repeats, floor, tuple(np.clip(mean + 0.05 * rng.normal(size=40), 0, 1).tolist()))
            for agent, repeats, means in ((DATA["ceiling"], True, remembers), (DATA["ceiling"], False, (0.8,) * 3),
                                          (DATA["searcher"], True, (0.7,) * 3))
            for floor, mean in enumerate(means, 1)]


@pytest.mark.parametrize(("remembers", "headline"), [
    ((0.8, 0.95, 0.96), "the first floor pays: from floor 1 to floor 3 efficiency rises by +0.1"),
    ((0.8, 0.8, 0.8), "no floor is shown to pay on another"), ((0.9, 0.8, 0.7), "efficiency falls by -0.2")])
def test_the_page_says_whether_the_first_floor_pays(remembers: tuple[float, ...], headline: str, tmp_path: Path):
    page = write_page("storeys", make_lines(remembers), tmp_path)
    assert headline in page.splitlines()[2] and page.splitlines()[2].startswith("**For an agent that knows")
    assert (tmp_path / "figures/storeys.svg").stat().st_size > 5_000
    assert page.count("no floor is shown to pay on another") == 2 + (remembers == (0.8, 0.8, 0.8))


def test_one_lucky_tower_is_no_payment():
    floors = [np.full(40, 0.8), np.append(np.full(39, 0.8), 1.0)]
    assert "no floor is shown to pay" in tell(floors, "someone")


def test_a_difference_that_rounds_to_nothing_has_no_sign():
    for last, gain in ((0.799, "0.00"), (0.801, "0.00"), (0.794, "-0.01")):
        floors = [np.full(40, 0.8), np.tile([last - 0.2, last + 0.2], 20)]
        assert f"shown to pay on another: {gain} (" in tell(floors, "someone")


def test_a_floor_that_was_not_played_is_missed():
    with pytest.raises(ComparisonError, match="not played on every floor"):
        write_page("storeys", make_lines((0.8, 0.9, 0.95))[1:])


@pytest.mark.nightly
def test_what_was_found_out_below_pays_above_and_only_where_it_is_carried():
    tower = repeat_set(load_benchmark("marks-3")["storeys"].test, 2)
    carried, forgotten = (play_towers(DATA["ceiling"], tower, repeats, 6) for repeats in (True, False))
    assert carried[0].efficiencies == forgotten[0].efficiencies, "nothing is known on the first floor"
    assert np.mean(carried[1].efficiencies) > np.mean(forgotten[1].efficiencies) + 0.05
    assert np.mean(carried[1].efficiencies) > 0.95
