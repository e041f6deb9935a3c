"""The leaderboard: its page follows from result files, which replay; programs read observations and nothing else."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.leaderboard import program
from benchmarks.leaderboard.page import CUED, RESULTS, RULES, UNCUED, Row, read_rows, summarise
from benchmarks.leaderboard.program import ProgramAgent
from benchmarks.leaderboard.results import Result, check, load, make
from hrl_escape.benchmark.agent_archive import RoomView
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.replay import make_view_env
from hrl_escape.errors import ConfigError, ContractError, FileReadError, TrustError
from hrl_escape.files import read_toml
from tests.benchmark.trained import CARD, get_rung, make_bench, make_card
from tests.command_line import call_script

STARTER = RESULTS.parent / "starter"
PAGES = Path(__file__).parents[2] / "docs" / "results"
PYTHON = {**CARD, "command": ["python", "agent.py"]}
ANSWER = "import sys\nfor line in sys.stdin: print(0, flush=True)\n"


def write_program(folder: Path, code: str) -> str:
    folder.mkdir(exist_ok=True)
    (folder / "agent.py").write_text(code)
    return str(folder)


# --- the page ---------------------------------------------------------------------------


def test_the_page_is_what_the_command_makes(tmp_path, capsys):
    code, _, _ = call_script(capsys, "benchmarks.leaderboard.__main__", "page", "--docs", tmp_path)
    assert code == 0 and (tmp_path / "leaderboard.md").read_text() == (PAGES / "leaderboard.md").read_text()
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"leaderboard.svg", "leaderboard-dark.svg"}
    assert all((PAGES / "figures" / path.name).is_file() for path in (tmp_path / "figures").iterdir())


def make_row(name: str, value: float, agent: str = "") -> Row:
    rooms = np.full(8, value) + np.tile([-0.02, 0.02], 4) * (agent != "search-nearest")
    return Row(name, ("",) * 6, Estimate(value, value - 0.05, value + 0.05), rooms, agent)


def make_numbers(cued: list[Row], uncued: list[Row]) -> SimpleNamespace:
    return SimpleNamespace(leaderboard=summarise({CUED: cued, UNCUED: uncued}).numbers)


def test_claims_break_where_entries_refute_them():
    search, planner = make_row("nearest", 0.7, "search-nearest"), make_row("bayes", 0.98, "bayes")
    mine = make_row("mine", 0.97)
    holding = make_numbers([planner, mine, search], [planner, search])
    assert all(rule(holding) for rule in RULES.values())
    for value in (0.71, 0.9):
        found = make_numbers([planner, make_row("mine", value), search], [planner, search])
        assert not RULES["counting-reaches-the-planner"](found), "no better than search, or below the planner"
    assert not RULES["open-without-cues"](make_numbers([planner, mine, search], [planner, mine, search]))


def test_an_entry_is_compared_room_by_room_with_the_best_search_baseline():
    lower, search = make_row("dark", 0.5, "search-random"), make_row("nearest", 0.7, "search-nearest")
    table = summarise({CUED: [make_row("mine", 0.9), search, lower]}).numbers.rungs[CUED].table
    assert "| mine |  | 0.900 (0.850 to 0.950) | +0.20 (+0.18 to +0.22) |" in table
    assert "| nearest |  | 0.700 (0.650 to 0.750) |  |" in table


def test_text_of_a_card_is_no_markup(tmp_path):
    found = load(RESULTS / "cues-1-colours-bayes.json")
    card = dataclasses.replace(found.card, name="<b>|x|</b> [a](b)*", authors=("`me`",), information="{{ 7 * 7 }} $x$",
                               link="https://example.org/a")
    Result(card, found.results).save(tmp_path / "it.json")
    (rung,) = summarise(read_rows(tmp_path)).numbers.rungs.values()
    line = next(line for line in rung.table.splitlines() if "example.org" in line)
    assert line.count("|") == 10 and not set("<>`{}*$") & set(line) and "](https://example.org/a)" in line
    Result(dataclasses.replace(found.card, rooms=1), found.results[:1]).save(tmp_path / "it.json")
    assert not read_rows(tmp_path), "results of some rooms are not listed"


# --- result files -----------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_a_result_of_the_leaderboard_replays(path):
    assert all(each.is_equal for each in check(path, 2, 0, trust=True))


def test_a_damaged_result_file_is_named(tmp_path):
    value = json.loads((RESULTS / "cues-1-colours-bayes.json").read_text())
    value["results"][0]["primitives"] = 0
    (tmp_path / "a.json").write_text(json.dumps(value))
    with pytest.raises(FileReadError, match="a.json: this is no result file"):
        load(tmp_path / "a.json")


@pytest.mark.nightly
def test_the_commands_run_and_check_a_program(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    make_bench().manifest.save("small.json")
    where = ["--benchmark", "small.json"]
    card = STARTER / "card.toml"
    code, out, _ = call_script(capsys, "benchmarks.leaderboard.__main__", "run", STARTER, "--card", card, "--rung",
                               "one", "--out", "it.json", *where)
    assert code == 0 and "wrote it.json" in out and Path("it/agent.py").is_file()
    again = ["check", "it.json", "--rooms", "2", "--seed", "3", *where]
    code, _, err = call_script(capsys, "benchmarks.leaderboard.__main__", *again)
    assert code == 2 and "--trust" in err
    code, out, _ = call_script(capsys, "benchmarks.leaderboard.__main__", *again, "--trust")
    assert code == 0 and out.count("equal, success in") == 2 and "2 of 2 rooms equal, drawn by --seed 3" in out
    found = load(Path("it.json"))
    forged = [dataclasses.replace(each, total=each.total + 1) for each in found.results]
    dataclasses.replace(found, results=tuple(forged)).save(Path("it.json"))
    code, out, _ = call_script(capsys, "benchmarks.leaderboard.__main__", *again, "--trust")
    assert code == 1 and out.count("DIFFERS") == 2


def test_a_source_that_does_not_go_with_the_card_is_refused():
    with pytest.raises(ConfigError, match="name of a reference"):
        make(get_rung(), CARD, "runs/mine")
    with pytest.raises(ConfigError, match="from 1 to"):
        make(get_rung(), CARD, "search-random", rooms=99)


# --- programs ---------------------------------------------------------------------------

LISTENER = """
import json, os, sys
seen = {"environ": sorted(os.environ), "folder": sorted(os.listdir()), "lines": []}
for line in sys.stdin:
    seen["lines"].append(line)
    print(max(i for i, legal in enumerate(json.loads(line)["mask"]) if legal), flush=True)
    open(PATH, "w").write(json.dumps(seen))
"""


@pytest.mark.nightly
def test_a_program_reads_observations_and_masks_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "hidden from programs")
    folder = write_program(tmp_path / "own", LISTENER.replace("PATH", repr(str(tmp_path / "seen.json"))))
    made = make(get_rung(), PYTHON, folder, rooms=2)
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert set(seen["environ"]) <= {"PATH", "HOME", "TMPDIR", "LANG", "LC_CTYPE", "OMP_NUM_THREADS"}
    assert seen["folder"] == ["agent.py", "stderr.txt"]
    looks = [json.loads(line) for line in seen["lines"]]
    starts = [number for number, look in enumerate(looks) if look["start"]]
    assert starts == [0, made.results[0].decisions] and len(looks) == sum(each.decisions for each in made.results)
    env, _ = make_view_env(RoomView(), get_rung().test)
    for number, look in enumerate(looks):
        assert look.keys() == {"observation", "mask", "start"} | ({"words"} if number in starts else set())
    observation, info = env.reset(seed=0, options={"instance_index": 0})
    assert looks[0]["observation"] == observation.tolist() and looks[0]["mask"] == info["action_mask"].tolist()
    assert looks[0]["words"] == list(env.observation_space.words)
    env.close()


@pytest.mark.nightly
def test_a_program_that_is_not_trusted_is_not_started(tmp_path):
    made = make(get_rung(), PYTHON, write_program(tmp_path / "it", ANSWER), rooms=1)
    dataclasses.replace(made, command=("touch", str(tmp_path / "ran"))).save(tmp_path / "it.json")
    make_bench().manifest.save(tmp_path / "small.json")
    with pytest.raises(TrustError, match="would start 'touch"):
        check(tmp_path / "it.json", 1, 0, manifest=str(tmp_path / "small.json"))
    assert not (tmp_path / "ran").exists()


@pytest.mark.nightly_for("five")
@pytest.mark.parametrize("rung", ["one", "five"])
def test_the_starter_plays_as_the_search_baseline_does(rung):
    mine = make(make_bench()[rung], read_toml(STARTER / "card.toml", "card"), str(STARTER))
    assert mine.results == make(make_bench()[rung], CARD, "search-nearest").results


@pytest.mark.parametrize(("code", "words"), [
    ("raise SystemExit('no such weights')", "its end, and last 'no such weights'"),
    ("for _ in open(0): print(-1, flush=True)", "a legal action's number"),
    ("for _ in open(0): print(99, flush=True)", "a legal action's number"),
    ("for _ in open(0): print('0\\n1', flush=True)", "a legal action's number"),
    ("for _ in open(0): print('9' * 10**6, flush=True)", "a legal action's number"),
    ("import os; os.close(1); input()", "its end"),
    ("import time; time.sleep(60)", "it answers within 1 s; found nothing"),
])
def test_a_program_that_breaks_the_protocol_is_named(tmp_path, monkeypatch, code, words):
    monkeypatch.setattr(program, "ANSWER_SECONDS", 1.0 if "sleep" in code else 60.0)
    with pytest.raises(ContractError) as error:
        make(get_rung(), PYTHON, write_program(tmp_path / "own", code), rooms=1)
    assert words in str(error.value) and len(str(error.value)) < 500


@pytest.mark.nightly
def test_processes_of_a_program_end_with_it(tmp_path):
    code = ("import os, subprocess, sys\n"
            f"child = subprocess.Popen(['sleep', '300']); open({str(tmp_path / 'pid')!r}, 'w').write(str(child.pid))\n"
            "for _ in sys.stdin: print(0, flush=True)\n")
    make(get_rung(), PYTHON, write_program(tmp_path / "own", code), rooms=1)
    status = Path("/proc") / (tmp_path / "pid").read_text() / "stat"
    until = time.monotonic() + 10
    while status.exists() and status.read_text().split()[2] != "Z" and time.monotonic() < until:
        time.sleep(0.05)
    assert not status.exists() or status.read_text().split()[2] == "Z"


def test_a_command_that_is_missing_is_named(tmp_path):
    with pytest.raises(ContractError, match="no/such.*can be started"):
        ProgramAgent(make_card().name, ("no/such",), tmp_path)
