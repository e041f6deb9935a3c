"""A study is a folder: a new one is planted, run by the public command, and analysed again from its results."""

from __future__ import annotations

import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from studies.__main__ import main
from studies.study import ROOT, find_study, list_studies
from tests.forks import run_module

DEFINITION = '''
about = "Measure whether a room of one button is escaped by chance."

[[grid]]
name = "chance"
agents = [{ name = "random" }, { name = "oracle" }]
rooms = ["paper-one-button"]
runs = 2
primitives = 400
eval_every = 400
eval_episodes = 1
'''
ANALYSIS = '''
"""Share of the runs of each agent that escape."""

from types import SimpleNamespace

from studies.study import Findings
from studies.tables import make_table


def analyse(study, lines):
    agents = {line.agent: [other for other in lines if other.agent == line.agent] for line in lines}
    shares = {agent: sum(run.escapes for run in runs) / len(runs) for agent, runs in agents.items()}
    rows = [[agent, len(agents[agent]), f"{share:.2f}"] for agent, share in shares.items()]
    return Findings(SimpleNamespace(shares=shares), {"shares": make_table(["agent", "runs", "success rate"], rows)})
'''


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    folder = tmp_path / "one_button"
    folder.mkdir()
    for name, text in (("study.toml", DEFINITION), ("analysis.py", ANALYSIS)):
        (folder / name).write_text(text)
    return folder


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run_module("studies", *arguments, cwd=ROOT.parent)


@pytest.mark.nightly
def test_a_new_study_is_a_folder_of_fewer_than_60_lines(planted: Path, capsys: pytest.CaptureFixture[str]):
    assert sum(len((planted / name).read_text().splitlines()) for name in ("study.toml", "analysis.py")) < 60
    docs = planted.parent / "docs"
    assert main([str(planted), "--docs", str(docs), "--out", str(planted.parent / "runs"), "--workers", "1"]) == 0
    assert "| oracle | 2 | 1.00 |" in capsys.readouterr().out
    raw = docs / "raw" / "one-button.jsonl"
    assert raw.read_text().count("\n") == 5
    raw.write_text(raw.read_text().replace('"escapes":1.0', '"escapes":0.0'))
    assert main([str(planted), "--docs", str(docs), "--from-raw"]) == 0
    assert "| oracle | 2 | 0.00 |" in capsys.readouterr().out


@pytest.mark.nightly
def test_two_processes_of_one_study_that_share_a_folder_keep_all_lines(planted: Path):
    docs = planted.parent / "docs"
    with ThreadPoolExecutor() as pool:
        both = [pool.submit(call, str(planted), "--docs", str(docs), "--workers", "1", "--out",
                            str(planted.parent / f"runs-{seed}"), "--first-seed", str(seed)) for seed in (0, 100)]
    assert [each.result().returncode for each in both] == [0, 0]
    assert call(str(planted), "--docs", str(docs), "--from-raw").stdout.count("| random | 4 | ") == 1


def test_results_without_another_folder_go_beside_the_study(planted: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(planted.parent)
    assert main([str(planted), "--runs", "1", "--primitives", "60", "--workers", "1"]) == 0
    assert (planted / "raw.jsonl").is_file()


def test_studies_are_listed_and_a_wrong_name_is_answered_with_the_right_ones(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert all(f"  {name} " in listed for name in list_studies())
    assert main(["prize"]) == 2
    assert "unknown study 'prize'" in (said := capsys.readouterr().err) and "price" in said


@pytest.mark.parametrize("name", list_studies())
def test_a_study_is_data_results_and_an_analysis(name: str):
    study = find_study(name)
    assert {"study.toml", "raw.jsonl"} <= {path.name for path in study.folder.iterdir()}
    if not study.holds_data_alone:
        assert callable(study.analysis.analyse)
        assert study.data["about"].startswith(("Measure ", "Run ", "Find "))
        assert f"python -m studies {name}" in study.data["about"]


@pytest.mark.parametrize("option", ["--runs=0", "--primitives=-1"])
def test_a_study_of_nothing_is_refused(planted: Path, capsys: pytest.CaptureFixture[str], option: str):
    assert main([str(planted), "--docs", str(planted / "docs"), option]) == 2
    assert "it must be above 0" in capsys.readouterr().err


def test_a_study_without_an_analysis_says_so(planted: Path, capsys: pytest.CaptureFixture[str]):
    (planted / "analysis.py").unlink()
    assert main([str(planted), "--from-raw"]) == 2
    assert "a study needs an analysis.py" in capsys.readouterr().err


def test_data_alone_names_the_last_version_with_its_code(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 0 and "Data of 0.3.0." in capsys.readouterr().out
    assert main(["tools"]) == 2
    assert "holds data alone. The last version with the code of this study is 0.3.0" in capsys.readouterr().err


def test_runs_of_an_earlier_version_are_read_and_not_made(planted: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(planted), "--runs", "1", "--primitives", "60", "--workers", "1", "--out",
                 str(planted.parent / "runs")]) == 0
    lines = (planted / "raw.jsonl").read_bytes()
    toml = planted / "study.toml"
    toml.write_text('made_with = "0.3.0"\n' + toml.read_text())
    assert main([str(planted)]) == 0
    assert "| oracle | 1 | 1.00 |" in capsys.readouterr().out and (planted / "raw.jsonl").read_bytes() == lines
