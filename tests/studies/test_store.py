"""Results of a study: lines that are only ever added, read back by kind, and kept by processes that run at once."""

from __future__ import annotations

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hrl_escape.errors import FileReadError
from hrl_escape.processes import taking_turns
from studies.baseline import BaselineRun
from studies.learned.dial import DialLine
from studies.store import Store
from tests.forks import run_fork

LINE = BaselineRun("per-instance", "low", "x/low/test#0", "dqn", 0, 1000, 0.8, None, 1.0, 5, 1.0, 70, "abc")
DIAL = DialLine("room", "planned", 0, 0.5, 0, 0.25)


def test_lines_of_several_kinds_come_back_in_the_order_in_which_they_were_added(tmp_path: Path):
    store, other = Store(tmp_path / "raw.jsonl", (BaselineRun, DialLine)), dataclasses.replace(LINE, seen=0.4, seed=1)
    assert store.load() == []
    store.add([other, DIAL])
    store.add([LINE])
    assert store.load() == [other, DIAL, LINE]
    before = store.path.read_bytes()
    store.add([LINE, DIAL])
    assert store.path.read_bytes() == before, "known lines are not added again"


def test_a_run_made_again_counts_and_its_old_line_stays_in_the_file(tmp_path: Path):
    store, again = Store(tmp_path / "raw.jsonl", (BaselineRun,)), dataclasses.replace(LINE, efficiency=0.9, key="def")
    store.add([LINE, dataclasses.replace(LINE, agent="ppo")])
    published = store.path.read_text()
    store.add([again])
    assert store.load() == [again, dataclasses.replace(LINE, agent="ppo")]
    assert store.path.read_text().startswith(published) and store.path.read_text().count("\n") == 4


@pytest.mark.parametrize("damage", ['{"protocol": 3}', '{"room": "r", "option": "o"}', "[]", "{", '"word"', "null"])
def test_a_damaged_file_is_named_by_its_line_and_left_alone(tmp_path: Path, damage: str):
    store = Store(tmp_path / "raw.jsonl", (BaselineRun, DialLine))
    store.add([LINE])
    store.path.write_text(whole := f"{store.path.read_text()}{damage}\n")
    for call in (store.load, lambda: store.add([DIAL])):
        with pytest.raises(FileReadError, match="raw.jsonl, line 3: this is no result of the study"):
            call()
    assert store.path.read_text() == whole


ADD = """
import dataclasses, sys
from pathlib import Path
from studies.baseline import BaselineRun
from studies.store import Store
store = Store(Path(sys.argv[1]), (BaselineRun,))
first = store.load()[0]
for seed in range(1, 41):
    store.add([dataclasses.replace(first, agent=sys.argv[2], seed=seed)])
"""


@pytest.mark.nightly
def test_processes_that_add_at_once_lose_no_line_of_each_other(tmp_path: Path):
    store = Store(tmp_path / "raw.jsonl", (BaselineRun,))
    store.add([LINE])
    with ThreadPoolExecutor() as pool:
        both = [pool.submit(run_fork, ADD, store.path, agent) for agent in ("dqn", "ppo")]
    assert [each.result().returncode for each in both] == [0, 0]
    assert {(line.agent, line.seed) for line in store.load()} == {
        ("dqn", 0), *((agent, seed) for agent in ("dqn", "ppo") for seed in range(1, 41))}


def test_who_adds_waits_until_another_has_written(tmp_path: Path):
    store = Store(tmp_path / "raw.jsonl", (BaselineRun, DialLine))
    store.add([LINE])
    adding = threading.Thread(target=store.add, args=([DIAL],))
    with taking_turns(tmp_path):  # a lock is of who opened the folder, so a thread is kept out as a process is
        adding.start()
        adding.join(1.0)
        assert adding.is_alive() and store.load() == [LINE]
    adding.join()
    assert store.load() == [LINE, DIAL]


def test_results_of_version_0_3_are_refused_for_their_labels(tmp_path: Path):
    """`smdp-dqn` also chose primitives there, and no line says so."""
    store = Store(tmp_path / "raw.jsonl", (BaselineRun,))
    store.add([LINE])
    store.path.write_text("".join(store.path.read_text().splitlines(keepends=True)[1:]))
    for call in (store.load, lambda: store.add([DIAL])):
        with pytest.raises(FileReadError, match="can be of version 0.3"):
            call()
