"""Programs as agents: they see looks and nothing else, and nothing of them is left behind."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from pathlib import Path

import pytest

from hrl_escape.benchmark import submission
from hrl_escape.benchmark.submission import Card, ProgramAgent, make_view_env, pack_submission
from hrl_escape.errors import ContractError
from hrl_escape.files import read_toml
from tests.benchmark.submission.small import get_rung, make_bench, make_card, make_program

LISTENER = """
import json, os, sys
seen = {"environ": sorted(os.environ), "folder": sorted(os.listdir()), "lines": []}
for line in sys.stdin:
    seen["lines"].append(line)
    print(max(i for i, legal in enumerate(json.loads(line)["mask"]) if legal), flush=True)
    open(PATH, "w").write(json.dumps(seen))
"""


def test_a_program_sees_observations_masks_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "told to nobody")
    card = make_program(tmp_path / "own", LISTENER.replace("PATH", repr(str(tmp_path / "seen.json"))))
    made = pack_submission(tmp_path / "it.zip", get_rung(), card, files=tmp_path / "own", rooms=2)
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert set(seen["environ"]) <= {"PATH", "HOME", "TMPDIR", "LANG", "LC_CTYPE", "OMP_NUM_THREADS"}
    assert seen["folder"] == ["agent.py", "stderr.txt"]
    looks = [json.loads(line) for line in seen["lines"]]
    starts = [number for number, look in enumerate(looks) if look["start"]]
    assert starts == [0, made.cells[0].decisions] and len(looks) == sum(cell.decisions for cell in made.cells)
    env, _ = make_view_env(card.view, get_rung().test)
    for number, look in enumerate(looks):
        assert look.keys() == {"observation", "mask", "start"} | ({"words"} if number in starts else set())
    observation, info = env.reset(seed=0, options={"instance_index": 0})
    assert looks[0]["observation"] == observation.tolist() and looks[0]["mask"] == info["action_mask"].tolist()
    assert looks[0]["words"] == list(env.observation_space.words)
    env.close()


@pytest.mark.nightly_for("five")
@pytest.mark.parametrize("rung", ["one", "five"])
def test_the_program_to_begin_with_is_the_searcher_of_the_references_to_the_bit(tmp_path, rung):
    starter = Path(submission.__file__).with_name("starter")
    (tmp_path / "agent.py").write_text((starter / "agent.py.txt").read_text())
    card = Card.from_dict(read_toml(starter / "card.toml"))
    mine = pack_submission(tmp_path / "it.zip", make_bench()[rung], card, files=tmp_path)
    reference = pack_submission(tmp_path / "r.zip", make_bench()[rung], make_card(), "search-nearest")
    assert mine.cells == reference.cells


@pytest.mark.parametrize(("code", "words"), [
    ("raise SystemExit('no such weights')", "its end, and last 'no such weights'"),
    ("for _ in open(0): print(-1, flush=True)", "a legal action's number"),
    ("for _ in open(0): print(99, flush=True)", "a legal action's number"),
    ("for _ in open(0): print('0\\n1', flush=True)", "a legal action's number"),
    ("for _ in open(0): print('9' * 10**6, flush=True)", "a legal action's number"),
    ("import os; os.close(1); input()", "its end"),
    ("import time; time.sleep(60)", "it answers within 1 s; found nothing"),
])
def test_a_program_that_does_not_answer_as_agreed_is_told_so(tmp_path, monkeypatch, code, words):
    monkeypatch.setattr(submission, "ANSWER_SECONDS", 1.0 if "sleep" in code else 60.0)
    card = make_program(tmp_path / "own", code)
    with pytest.raises(ContractError) as error:
        pack_submission(tmp_path / "it.zip", get_rung(), card, files=tmp_path / "own", rooms=1)
    assert words in str(error.value) and len(str(error.value)) < 500 and not (tmp_path / "it.zip").exists()


@pytest.mark.nightly
def test_what_a_program_has_started_ends_with_it(tmp_path):
    code = ("import os, subprocess, sys\n"
            f"child = subprocess.Popen(['sleep', '300']); open({str(tmp_path / 'pid')!r}, 'w').write(str(child.pid))\n"
            "for _ in sys.stdin: print(0, flush=True)\n")
    card = make_program(tmp_path / "own", code)
    pack_submission(tmp_path / "it.zip", get_rung(), card, files=tmp_path / "own", rooms=1)
    status = Path("/proc") / (tmp_path / "pid").read_text() / "stat"
    until = time.monotonic() + 10
    while status.exists() and status.read_text().split()[2] != "Z" and time.monotonic() < until:
        time.sleep(0.05)
    assert not status.exists() or status.read_text().split()[2] == "Z"


def test_a_command_that_is_not_there_is_named(tmp_path):
    card = dataclasses.replace(make_card(command=["x"], files=["x"]), command=(os.path.join("no", "such"),))
    with pytest.raises(ContractError, match="no/such.*can be started"):
        ProgramAgent(card, tmp_path)
