"""Numbers that pages state of the package's own contents."""

from __future__ import annotations

import re
from pathlib import Path

from hrl_escape.benchmark import list_pretrained
from hrl_escape.data.published import read_published
from hrl_escape.sets import load_benchmark

DOCS = Path(__file__).parents[2] / "docs"


def test_bytes_per_primitive_are_within_what_the_page_says():
    page = (DOCS / "data.md").read_text()
    (low, high), = re.findall(r"([\d.]+) to ([\d.]+) bytes per primitive", page)
    sizes = {"": 1e5, "1m": 1e6, "10m": 1e7}
    shares = [recording.bytes / sizes[(re.search(r"-(\d+m)-v\d+$", name) or [None, ""])[1]]
              for name, recording in read_published().items()]
    assert len(shares) > 50 and (round(min(shares), 1), round(max(shares), 1)) == (float(low), float(high))


def test_trained_agents_are_there_for_every_rung_of_the_ladder():
    assert "trained agents for every rung of `ladder-1`." in (DOCS / "ladder.md").read_text()
    assert {f"ladder-1/{rung.name}" for rung in load_benchmark("ladder-1")} <= list_pretrained().keys()
