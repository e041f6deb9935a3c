"""Archives of trained agents: equal to what training's own evaluation counts, refused when forged or crafted."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.leaderboard.results import pack, read_view
from hrl_escape.agents.training.archive import RUN_ARCHIVE, pack_parts
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.training.train import load_agent
from hrl_escape.benchmark.agent_archive import (
    AGENT_ARCHIVE,
    CARD,
    ROOMS,
    RUN,
    AgentCard,
    find_rung,
    read_archive,
    score_results,
    write_archive,
)
from hrl_escape.benchmark.pretrained import verify_archive
from hrl_escape.benchmark.replay import make_view_env
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.errors import CheckpointError, ConfigError, EscapeError, UnsupportedError, VerificationError
from hrl_escape.planning.best_known import find_best_known
from tests.agents.training.test_hostile_runs import Watch
from tests.agents.training.test_hostile_runs import craft as craft_description
from tests.benchmark import trained
from tests.benchmark.trained import get_rung, make_bench, make_card, train_once
from tests.crafted import craft


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    return train_once(tmp_path_factory.mktemp("runs") / "mine")


@pytest.fixture(scope="module")
def packed(run) -> Path:
    pack(run.parent / "mine.zip", get_rung(), trained.CARD, run)
    return run.parent / "mine.zip"


@pytest.fixture(scope="module")
def manifest(run) -> str:
    make_bench().manifest.save(run.parent / "small.json")
    return str(run.parent / "small.json")


def test_results_are_what_the_evaluation_of_training_counts(run, packed):
    archive, rung = read_archive(packed), get_rung()
    order = {str(compute_episode_seed(0, "evaluation", n)): n for n in range(len(rung.test))}
    env, _ = make_view_env(archive.card.view, rung.test, order)
    found = evaluate(load_agent(run, env), env, len(rung.test))
    env.close()
    for name, values in (("primitives", found.lengths), ("escaped", found.successes), ("total", found.returns),
                         ("decisions", found.decision_counts)):
        assert tuple(getattr(each, name) for each in archive.results) == values
    best = [find_best_known(room, Kinematics(room).make_state(room.starts[0])).primitives for room in rung.test]
    assert [each.fewest for each in archive.results] == best
    by_hand = np.mean([ok * min(1, few / length)
                       for ok, few, length in zip(found.successes, best, found.lengths, strict=True)])
    score = score_results(archive.results)
    assert score.value == pytest.approx(by_hand) and score.low <= score.value <= score.high
    card = archive.card
    assert card.view.observation == "features" and not card.view.options.include_primitives
    assert card.primitives is not None and card.primitives >= 300 and card.core_hours is not None


def test_rooms_replayed_alone_are_equal_and_a_forged_one_differs(packed, manifest, tmp_path):
    assert all(each.is_equal for each in verify_archive(packed, 4, 5, manifest))
    assert [each.stated.room for each in verify_archive(packed, 2, 5, manifest)] != [
        each.stated.room for each in verify_archive(packed, 2, 6, manifest)]
    archive = read_archive(packed, tmp_path)
    forged = [dataclasses.replace(each, primitives=each.primitives - (each.room == 2)) for each in archive.results]
    write_archive(tmp_path / "forged.zip", archive.card, forged, tmp_path / RUN)
    found = verify_archive(tmp_path / "forged.zip", 4, 0, manifest)
    assert [each.is_equal for each in found] == [True, True, False, True]
    with pytest.raises(ConfigError, match="from 1 to"):
        verify_archive(packed, 99, 0, manifest)


def test_a_card_that_names_another_agent_than_its_run_is_refused(packed, manifest, tmp_path):
    archive = read_archive(packed, tmp_path)
    write_archive(tmp_path / "it.zip", dataclasses.replace(archive.card, agent="smdp-dqn"), archive.results,
                  tmp_path / RUN)
    with pytest.raises(CheckpointError, match="'smdp-dqn', but the run trained 'smdp-q-learning'"):
        verify_archive(tmp_path / "it.zip", 1, 0, manifest)


def test_a_card_is_about_the_test_set_that_it_names(packed, manifest):
    card = read_archive(packed).card
    assert find_rung(card, manifest).name == "one"
    for changes in ({"root": "0" * 64}, {"rooms": 5}, {"benchmark": "other"}):
        with pytest.raises(VerificationError):
            find_rung(dataclasses.replace(card, **changes), manifest)
    with pytest.raises(VerificationError, match="does not come with this package"):
        find_rung(dataclasses.replace(card, benchmark=manifest))


@pytest.mark.parametrize("fields", [
    {"name": ""}, {"name": "a\nb"}, {"information": "x" * 201}, {"link": "javascript:alert(1)"},
    {"link": "https://a b"}, {"authors": []}, {"core_hours": -1.0}, {"view": {"observation": "pixels"}}, {"rooms": 0},
])
def test_an_impossible_card_is_refused(fields):
    with pytest.raises(ConfigError):
        make_card(**fields)


def test_a_card_reads_what_it_wrote():
    card = make_card(link="https://example.org/a?b=1")
    assert AgentCard.from_dict(json.loads(json.dumps(card.to_dict()))) == card


def test_a_run_with_other_wrappers_is_not_packed():
    described = {"environment": {"arguments": {"observation": "objects"}, "wrappers": [
        {"class": "gymnasium.wrappers.stateful_action:StickyAction", "arguments": {}}]}}
    with pytest.raises(UnsupportedError, match="StickyAction"):
        read_view(described)
    with pytest.raises(UnsupportedError, match="not made in rooms"):
        read_view({"environment": {"arguments": {}, "wrappers": []}})


# --- crafted archives -----------------------------------------------------------------------


def craft_archive(parts: dict[str, bytes], packed: bytes, run: Path, chance: random.Random, folder: Path) -> bytes:
    """An archive with something wrong: itself, the archive inside, the run's description, the card or the results."""
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
        card, odd = json.loads(parts[CARD]), chance.choice([
            "planted_payload:Payload", "../outside", "", None, 7, ["a"], {}, "text-agent", "oracle", "x" * 300])
        where = chance.choice([card, card["view"]])
        where[chance.choice(list(where))] = odd
        parts[CARD] = json.dumps(card).encode()
    else:
        lines = parts[ROOMS].decode().split("\n")
        lines[chance.randrange(len(lines))] = chance.choice(
            ["", "0", "0,1,1,1,1.0,1.0,7", "0,1,nan,1,inf,nan", "-1,1,5,5,1.0,5.0", '"', "\0", "=cmd()",
             "0,1,0,0,1.0,0.0"])
        parts[ROOMS] = "\n".join(lines).encode()
    pack_parts(folder / "crafted.zip", parts, AGENT_ARCHIVE)
    return (folder / "crafted.zip").read_bytes()


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("count", [50, pytest.param(1_000, marks=pytest.mark.slow)])
def test_crafted_archives_neither_run_nor_write(run, packed, manifest, tmp_path, monkeypatch, count):
    """They are refused, or play as data; nothing is started, imported or written outside."""
    chance, inner, workshop = random.Random(39), tmp_path / "a" / "b", tmp_path / "workshop"
    inner.mkdir(parents=True)
    workshop.mkdir()
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "planted_payload.py").write_text(f"open({str(tmp_path / 'was-imported')!r}, 'w')\n")
    monkeypatch.syspath_prepend(tmp_path / "code")
    monkeypatch.chdir(inner)
    with zipfile.ZipFile(packed) as archive:
        parts = {name: archive.read(name) for name in archive.namelist() if name != "manifest.json"}
    verify_archive(packed, 1, 0, manifest)  # what is imported or compiled once
    watch, refused = Watch(), 0
    for _ in range(count):
        (inner / "it.zip").write_bytes(craft_archive(parts, packed.read_bytes(), run, chance, workshop))
        watch.is_on = True
        try:
            verify_archive(inner / "it.zip", 1, 0, manifest)
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
