"""Submissions: equal to what training's own evaluation counts, found out where forged, harmless where crafted."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.agents.training.archive import RUN_ARCHIVE, pack_parts
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.training.train import load_agent
from hrl_escape.benchmark.submission import (
    RUN,
    SUBMISSION,
    Card,
    Submission,
    find_rung,
    make_view_env,
    pack_submission,
    read_submission,
    read_view,
    score_cells,
    verify_cells,
    write_submission,
)
from hrl_escape.cli import main
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.errors import ConfigError, EscapeError, TrustError, UnsupportedError, VerificationError
from hrl_escape.planning.best_known import find_best_known
from hrl_escape.sets.benchmark import load_benchmark
from tests.agents.training.test_hostile_runs import Watch
from tests.agents.training.test_hostile_runs import craft as craft_description
from tests.benchmark.submission.small import get_rung, make_bench, make_card, make_program, train_once
from tests.crafted import craft

ANSWER = "import sys\nfor line in sys.stdin: print(0, flush=True)\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    return train_once(tmp_path_factory.mktemp("runs") / "mine")


@pytest.fixture(scope="module")
def packed(run) -> Path:
    pack_submission(run.parent / "mine.zip", get_rung(), make_card(), str(run))
    return run.parent / "mine.zip"


def test_cells_are_what_the_evaluation_of_training_counts(run, packed):
    submission, rung = read_submission(packed), get_rung()
    order = {str(compute_episode_seed(0, "evaluation", n)): n for n in range(len(rung.test))}
    env, _ = make_view_env(submission.entry.card.view, rung.test, order)
    found = evaluate(load_agent(run, env), env, len(rung.test))
    env.close()
    for name, values in (("primitives", found.lengths), ("escaped", found.successes), ("total", found.returns),
                         ("decisions", found.decision_counts)):
        assert tuple(getattr(cell, name) for cell in submission.cells) == values
    best = [find_best_known(room, Kinematics(room).make_state(room.starts[0])).primitives for room in rung.test]
    assert [cell.fewest for cell in submission.cells] == best
    by_hand = np.mean([ok * min(1, few / length)
                       for ok, few, length in zip(found.successes, best, found.lengths, strict=True)])
    score = score_cells(submission.cells)
    assert score.value == pytest.approx(by_hand) and score.low <= score.value <= score.high
    card = submission.entry.card
    assert card.view.observation == "features" and not card.view.options.include_primitives
    assert card.primitives >= 300 and card.core_hours is not None


def test_rooms_played_again_alone_are_equal_and_a_forged_one_differs(packed, tmp_path):
    assert all(each.is_equal for each in verify_cells(packed, get_rung(), 4, seed=5))
    assert [each.stated.room for each in verify_cells(packed, get_rung(), 2, seed=5)] != [
        each.stated.room for each in verify_cells(packed, get_rung(), 2, seed=6)]
    submission = read_submission(packed)
    with zipfile.ZipFile(packed) as archive:
        agent = {RUN: archive.read(RUN)}
    forged = [dataclasses.replace(cell, primitives=cell.primitives - (cell.room == 2)) for cell in submission.cells]
    write_submission(tmp_path / "forged.zip", submission.entry, forged, agent)
    found = verify_cells(tmp_path / "forged.zip", get_rung(), 4, seed=0)
    assert [each.is_equal for each in found] == [True, True, False, True]
    assert Submission.from_json(json.loads(json.dumps(submission.to_json()))) == submission


@pytest.mark.nightly
def test_the_hash_of_an_agent_is_of_the_agent_alone(run, packed, tmp_path):
    here = read_submission(packed)
    fewer = pack_submission(tmp_path / "fewer.zip", get_rung(), make_card(name="other"), str(run), rooms=1)
    assert fewer.agent_digest == here.agent_digest and len(fewer.cells) == 1
    card = make_program(tmp_path / "own", ANSWER)
    own = pack_submission(tmp_path / "own.zip", get_rung(), card, files=tmp_path / "own", rooms=1)
    other = make_program(tmp_path / "own", ANSWER + "\n")
    changed = pack_submission(tmp_path / "own2.zip", get_rung(), other, files=tmp_path / "own", rooms=1)
    assert len({here.agent_digest, own.agent_digest, changed.agent_digest}) == 3


def test_hidden_rooms_are_those_of_the_round_that_was_announced(tmp_path, monkeypatch):
    monkeypatch.setattr("hrl_escape.benchmark.submission.HIDDEN_ROOMS", 2)
    rung, value = get_rung(), "5" * 64
    beacon = f"quicknet 7 {value}"
    made = pack_submission(tmp_path / "it.zip", rung, make_card(), "search-random", rooms=1, beacon=beacon)
    assert [(cell.set, cell.room) for cell in made.cells] == [("test", 0), ("hidden", 0), ("hidden", 1)]
    assert all(each.is_equal for each in verify_cells(tmp_path / "it.zip", rung, 3, seed=0))
    with pytest.raises(ConfigError, match="round 7"):
        pack_submission(tmp_path / "no.zip", rung, make_card(), "search-random", beacon=f"quicknet 8 {value}")
    with pytest.raises(ConfigError, match="has announced no round"):
        pack_submission(tmp_path / "no.zip", load_benchmark("marks-1")["told"], make_card(), "search-random",
                        beacon=f"quicknet 8 {value}")


def test_a_submission_is_about_the_test_set_that_it_names(packed, tmp_path):
    entry = read_submission(packed).entry
    make_bench().manifest.save(tmp_path / "small.json")
    assert find_rung(entry, str(tmp_path / "small.json")).name == "one"
    for changes in ({"root": "0" * 64}, {"rooms": 5}, {"benchmark": "other"}):
        with pytest.raises(VerificationError):
            find_rung(dataclasses.replace(entry, **changes), str(tmp_path / "small.json"))
    with pytest.raises(VerificationError, match="does not come with this package"):
        find_rung(dataclasses.replace(entry, benchmark=str(tmp_path / "small.json")))


@pytest.mark.parametrize("fields", [
    {"name": ""}, {"name": "a\nb"}, {"told": "x" * 201}, {"link": "javascript:alert(1)"}, {"link": "https://a b"},
    {"command": ["python", "../x"], "files": ["../x"]}, {"command": ["x"], "files": ["run.zip"]},
    {"command": ["x"], "files": ["a/b"]}, {"command": ["x"], "files": []}, {"files": ["a"]}, {"authors": []},
    {"command": ["x"], "files": ["a", "a"]}, {"command": ["x"], "files": [f"f{n}" for n in range(13)]},
    {"command": ["x"], "files": [".hidden"]}, {"core_hours": -1.0}, {"view": {"observation": "pixels"}},
])
def test_an_impossible_card_is_refused(fields):
    with pytest.raises(ConfigError):
        make_card(**fields)


def test_a_run_that_was_shown_rooms_otherwise_is_no_submission():
    described = {"environment": {"arguments": {"observation": "objects"}, "wrappers": [
        {"class": "gymnasium.wrappers.stateful_action:StickyAction", "arguments": {}}]}}
    with pytest.raises(UnsupportedError, match="StickyAction"):
        read_view(described)
    with pytest.raises(UnsupportedError, match="not made in rooms"):
        read_view({"environment": {"arguments": {}, "wrappers": []}})


def test_the_commands_submit_verify_and_say_what_they_start(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    make_bench().manifest.save("small.json")
    assert main(["ladder", "start", "mine"]) == 0
    asked = ["--benchmark", "small.json"]
    assert main(["ladder", "submit", "--card", "mine/card.toml", "--rung", "one", "--out", "it.zip", *asked]) == 0
    assert "starts python agent.py" in capsys.readouterr().out
    assert main(["ladder", "verify-submission", "it.zip", "--cells", "2", *asked]) == 2
    out, err = capsys.readouterr()
    assert "would start python agent.py" in out and "--trust" in err and err.count("\n") == 1
    again = ["ladder", "verify-submission", "it.zip", "--cells", "2", "--seed", "3", "--trust", *asked]
    assert main([*again, "--record", "it.json"]) == 0
    out = capsys.readouterr().out
    assert out.count("equal: escaped in") == 2 and "2 of 2 rooms equal, drawn by --seed 3" in out
    submission = read_submission("it.zip")
    agent = {"agent.py": Path("mine/agent.py").read_bytes()}
    write_submission("it.zip", submission.entry, [dataclasses.replace(c, total=c.total + 1) for c in submission.cells],
                     agent)
    assert main([*again, "--record", "forged.json"]) == 1
    assert capsys.readouterr().out.count("DIFFERS") == 2 and not Path("forged.json").exists()


# --- what a stranger could send -------------------------------------------------------------


def craft_submission(parts: dict[str, bytes], packed: bytes, run: Path, chance: random.Random, folder: Path) -> bytes:
    """A submission with something wrong: the archive, the archive inside, the run's description, card, cells."""
    kind, parts = chance.randrange(5), dict(parts)
    if kind == 0:
        return craft(parts, packed, chance)
    if kind == 1:
        inner = {name: (run / name).read_bytes() for name in ("run.json", "checkpoint.npz")}
        parts[RUN] = craft(inner, parts[RUN], chance)
    elif kind == 2:
        described = json.dumps(craft_description(json.loads((run / "run.json").read_text()), chance))
        inner = {"run.json": described.encode(), "checkpoint.npz": (run / "checkpoint.npz").read_bytes()}
        pack_parts(folder / "inner.zip", inner, RUN_ARCHIVE)
        parts[RUN] = (folder / "inner.zip").read_bytes()
    elif kind == 3:
        entry, odd = json.loads(parts["submission.json"]), chance.choice([
            "planted_payload:Payload", "../outside", "", None, 7, ["a"], {}, "text-agent", "oracle", "x" * 300])
        card = entry["card"]
        where = chance.choice([entry, card, card["view"]])
        where[chance.choice(list(where))] = odd
        if chance.random() < 0.5:
            entry["agent"], card["command"], card["files"] = "", ["touch", "../outside"], ["run.zip"]
        parts["submission.json"] = json.dumps(entry).encode()
    else:
        lines = parts["cells.csv"].decode().split("\n")
        lines[chance.randrange(len(lines))] = chance.choice(
            ["", "test,0", "hidden,0,1,1,1,1.0,1.0", "test,0,1,nan,1,inf,nan", "test,-1,1,5,5,1.0,5.0", '"', "\0",
             "=cmd()", "test,0,1,0,0,1.0,0.0"])
        parts["cells.csv"] = "\n".join(lines).encode()
    pack_parts(folder / "crafted.zip", parts, SUBMISSION)
    return (folder / "crafted.zip").read_bytes()


def verify_crafted(count: int, run: Path, packed: Path, tmp_path: Path, monkeypatch) -> None:
    """Crafted submissions are refused, or play as data; nothing is started, imported or written outside."""
    chance, inner, workshop = random.Random(39), tmp_path / "a" / "b", tmp_path / "workshop"
    inner.mkdir(parents=True)
    workshop.mkdir()
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "planted_payload.py").write_text(f"open({str(tmp_path / 'was-imported')!r}, 'w')\n")
    monkeypatch.syspath_prepend(tmp_path / "code")
    monkeypatch.chdir(inner)
    with zipfile.ZipFile(packed) as archive:
        parts = {name: archive.read(name) for name in archive.namelist() if name != "manifest.json"}
    verify_cells(packed, get_rung(), 1, 0)  # what is imported or compiled once
    watch, refused = Watch(), 0
    for _ in range(count):
        (inner / "it.zip").write_bytes(craft_submission(parts, packed.read_bytes(), run, chance, workshop))
        watch.is_on = True
        try:
            submission = read_submission(inner / "it.zip")
            verify_cells(inner / "it.zip", find_rung(submission.entry, str(tmp_path / "small.json")), 1, 0)
        except EscapeError as error:
            refused += 1
            assert 0 < len(str(error)) < 2_000
        finally:
            watch.is_on = False
        assert [path.name for path in inner.iterdir()] == ["it.zip"]
    assert refused > count // 2
    started = [event for event, _ in watch.seen if event in ("os.system", "subprocess.Popen", "os.exec")]
    assert not started and not (tmp_path / "was-imported").exists()
    opened = [arguments[0] for event, arguments in watch.seen if event == "open" and not isinstance(arguments[0], int)]
    written = {os.path.abspath(os.fsdecode(path)) for path in opened}
    outside = [path for path in written if not path.startswith(str(Path(os.environ.get("TMPDIR", "/tmp")) / "tmp"))]
    assert [path for path in outside if "__pycache__" not in path and path != os.devnull] == []


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("count", [50, pytest.param(1_000, marks=pytest.mark.slow)])
def test_crafted_submissions_neither_run_nor_write(run, packed, tmp_path, monkeypatch, count):
    make_bench().manifest.save(tmp_path / "small.json")
    verify_crafted(count, run, packed, tmp_path, monkeypatch)


def test_a_program_that_is_not_trusted_is_not_started(tmp_path):
    card = make_program(tmp_path / "own", ANSWER)
    pack_submission(tmp_path / "it.zip", get_rung(), card, files=tmp_path / "own", rooms=1)
    entry = read_submission(tmp_path / "it.zip").entry
    planted = dataclasses.replace(entry.card, command=("touch", str(tmp_path / "ran")))
    write_submission(tmp_path / "it.zip", dataclasses.replace(entry, card=planted),
                     read_submission(tmp_path / "it.zip").cells, {"agent.py": b""})
    with pytest.raises(TrustError, match="would start 'touch"):
        verify_cells(tmp_path / "it.zip", get_rung(), 1, 0)
    assert not (tmp_path / "ran").exists()


def test_a_card_reads_what_it_wrote():
    card = make_card(command=["x"], files=["a.py"], link="https://example.org/a?b=1")
    assert Card.from_dict(json.loads(json.dumps(card.to_dict()))) == card
