"""Comparisons as they are run: repeated, killed, resumed, with runs that fail and files that are damaged."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import forkserver
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison, Shard, count_missing, read_comparison
from hrl_escape.benchmark.launching.local import LocalLauncher, read_progress
from hrl_escape.benchmark.reporting.figures import is_level
from hrl_escape.benchmark.reporting.report import format_first_escape, write_report, write_tables
from hrl_escape.benchmark.run_results import get_run_folder, load_run_result, read_episodes
from hrl_escape.benchmark.summary import summarise
from hrl_escape.cli import main
from hrl_escape.errors import ComparisonError, ConfigError, EscapeError, FileWriteError, RunBusyError
from hrl_escape.files import write_json
from hrl_escape.version import find_versions
from tests.benchmark.small import SMALL, break_checkpoint, change, plant_strangers, run_quietly

TABLES = ("results.csv", "curves.csv")


def read_tables(comparison: Comparison) -> list[bytes]:
    write_tables(summarise(comparison), comparison.out)
    return [(comparison.out / name).read_bytes() for name in TABLES]


def start_cli(grid_file: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "hrl_escape.cli", "compare", str(grid_file), "--out", str(out), "--workers", "2"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
                            preexec_fn=heed_ctrl_c)


def heed_ctrl_c() -> None:
    """A shell starts what runs in its background with Ctrl-C ignored, and so these tests and their processes."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def find_processes_of_session(session: int) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
        except (OSError, IndexError):
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(entry.name))
    return found


# --- the same numbers ------------------------------------------------------------------


def test_every_run_has_a_result_with_the_evaluations_that_were_asked_for(finished: Comparison):
    assert len(finished.runs) == 8 and not finished.failures
    for run, result in finished.runs:
        assert result.primitives >= SMALL.primitives
        assert [e.primitives for e in result.evaluations][0] == 0
        assert {len(e.returns) for e in result.evaluations} == {SMALL.eval_episodes}
        assert (run.agent.chooses_options and result.planner_calls > 0) or result.decisions == result.primitives


def test_the_regret_without_training_is_that_of_the_evaluated_episodes(tmp_path: Path):
    grid = change(agents=("search-random",), runs=1, eval_episodes=4)
    result = run_quietly(grid, tmp_path).runs[0][1]
    final = result.evaluations[-1]
    assert result.escapes is None and sum(final.escaped) > 1
    assert result.first_escape == sum(final.lengths[: list(final.escaped).index(True) + 1])
    useful = sum(best for best, escaped in zip(result.score_range.fewest, final.escaped, strict=True) if escaped)
    assert result.regret == pytest.approx(1 - useful / sum(final.lengths)) and 0 < result.regret < 1


def test_the_recorded_episodes_are_those_of_the_last_evaluation(finished: Comparison):
    """Evaluated twice, in two environments, with the same outcome."""
    for run, result in finished.runs:
        last, episodes = result.evaluations[-1], read_episodes(finished.out, run)
        assert tuple(episode["return"] for episode in episodes) == last.returns
        assert tuple(episode["primitives"] for episode in episodes) == last.lengths
        assert tuple(len(episode["decisions"]) for episode in episodes) == last.decision_counts


def test_agents_of_one_training_seed_are_evaluated_from_the_same_starts(finished: Comparison):
    starts = {seed: {result.score_range.starts for run, result in finished.runs if run.seed == seed} for seed in (0, 1)}
    assert all(len(found) == 1 for found in starts.values())
    assert starts[0] != starts[1]


@pytest.mark.nightly
def test_finished_runs_are_kept_and_new_ones_added_to_the_same_numbers_in_one_process(
        finished: Comparison, tmp_path: Path):
    fewer = change(agents=SMALL.agents[:2], runs=1)
    first = run_quietly(fewer, tmp_path, LocalLauncher(1))
    files = [get_run_folder(tmp_path, run) / name for run, _ in first.runs
             for name in ("run_result.json", "training/log.jsonl", "training/checkpoint.npz")]
    stamps = [(file.stat().st_mtime_ns, file.stat().st_ino) for file in files]
    both = run_quietly(SMALL, tmp_path, LocalLauncher(1))
    assert [(file.stat().st_mtime_ns, file.stat().st_ino) for file in files] == stamps
    assert [result for _, result in both.runs] == [result for _, result in finished.runs]
    assert read_tables(both) == read_tables(finished)
    for run, _ in both.runs:
        assert read_episodes(tmp_path, run) == read_episodes(finished.out, run)


@pytest.mark.nightly
def test_what_killed_writers_left_is_cleared_and_other_parts_are_left_alone(tmp_path: Path):
    grid = change(agents=["random"], runs=2, primitives=60)
    runs = run_quietly(grid, tmp_path).runs
    folders = [tmp_path, tmp_path / "rooms", *(get_run_folder(tmp_path, run) for run, _ in runs)]
    for folder in folders:
        (folder / ".writing-abc").write_bytes(b"half")
    run_quietly(grid, tmp_path, shard=Shard(1, 2))
    assert [(folder / ".writing-abc").exists() for folder in folders] == [True, True, False, True]
    run_quietly(grid, tmp_path)
    assert not list(tmp_path.rglob(".writing-*"))


# --- killed ----------------------------------------------------------------------------


def wait_until(happens, seconds: float = 600.0) -> bool:
    deadline = time.monotonic() + seconds
    while not happens():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def count_log_bytes(out: Path) -> int:
    return sum(log.stat().st_size for log in out.glob("runs/*/training/log.jsonl"))


def start_and_wait_for_news(grid_file: Path, out: Path) -> subprocess.Popen[bytes]:
    """Start a comparison; returns once a run has logged something new, or all is over."""
    before = count_log_bytes(out)
    process = start_cli(grid_file, out)
    wait_until(lambda: process.poll() is not None or count_log_bytes(out) > before)
    return process


@pytest.mark.nightly
@pytest.mark.parametrize("most", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_killed_at_any_moment_and_resumed_gives_the_uninterrupted_results(
        finished: Comparison, tmp_path: Path, most: int):
    write_json(tmp_path / "small.json", SMALL.to_dict())
    out, rng, kills = tmp_path / "out", np.random.default_rng(4), 0
    while kills < most:
        process = start_and_wait_for_news(tmp_path / "small.json", out)
        time.sleep(rng.uniform(0.0, 0.8))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        process.wait()
        if process.returncode == 0:
            break
        assert wait_until(lambda session=process.pid: not find_processes_of_session(session)), "a run outlives it"
    assert kills >= 1
    resumed = run_quietly(SMALL, out)
    assert [result for _, result in resumed.runs] == [result for _, result in finished.runs]
    assert read_tables(resumed) == read_tables(finished)


@pytest.mark.nightly
def test_a_comparison_keeps_others_out_of_its_folder_and_no_process_outlives_it_when_ctrl_c_stops_it(tmp_path: Path):
    grid = change(primitives=1_000_000, runs=1)
    write_json(tmp_path / "long.json", grid.to_dict())
    process = start_cli(tmp_path / "long.json", tmp_path / "out")
    runs = grid.make_runs(grid.make_places())
    try:
        assert wait_until(lambda: any(read_progress(tmp_path / "out", run) for run in runs))
        with pytest.raises(RunBusyError, match="another comparison is running in this folder"):
            run_quietly(SMALL, tmp_path / "out")
        os.killpg(process.pid, signal.SIGINT)  # reaches every process of the terminal
        output = process.communicate(timeout=600)[0].decode()
        assert process.returncode == 130
        assert "the same command resumes" in output and "Traceback" not in output
        assert wait_until(lambda: not find_processes_of_session(process.pid))
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # leaves nobody behind where the test fails


# --- runs that fail --------------------------------------------------------------------


@pytest.fixture
def strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two agents of others are installed for one test, as any process of the package sees that begins then."""
    plant_strangers(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    find_versions.cache_clear()
    yield
    find_versions.cache_clear()


@pytest.mark.nightly
@pytest.mark.usefixtures("strangers")
def test_failed_runs_are_told_with_their_error_and_stop_no_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """One raises, one crashes its interpreter, one diverges; all are strangers' or settings' faults."""
    wild = {"reward_scale": 1e38, "loss": "squared", "warmup": 64}
    agents = ["random", "raiser", "crasher", AgentSpec("dqn", label="wild", settings=wild), "q-learning"]
    write_json(tmp_path / "mixed.json", change(runs=1, agents=agents).to_dict())
    code = main(["compare", str(tmp_path / "mixed.json"), "--out", str(tmp_path / "out"), "--workers", "2"])
    output = "".join(capsys.readouterr())
    assert code == 1, output
    assert "raiser, small, seed 0: failed: KeyError: 'what a stranger forgot'" in output
    assert "crasher, small, seed 0: failed: its process was ended by SIGSEGV" in output
    assert "wild, small, seed 0: failed: dqn, seed 0" in output and "no longer a finite number" in output
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Some runs have no result and count nowhere" in page and "what a stranger forgot" in page
    assert 'in fall' in page, "the report shows where a stranger's error came from"
    (printed,) = (tmp_path / "out" / "runs").glob("*raiser*/output.txt")
    assert printed.read_text() == "last words\n" and "last words" not in output
    rows = (tmp_path / "out" / "results.csv").read_text().splitlines()[1:]
    assert sorted(row.split(",")[0] for row in rows) == ["q-learning", "random"]


@pytest.mark.nightly
def test_a_failed_run_is_tried_again_the_next_time(finished: Comparison, tmp_path: Path):
    grid = change(agents=SMALL.agents[:1], runs=1)
    (run,) = grid.make_runs(grid.make_places())
    broken = break_checkpoint(tmp_path, run)
    failed = run_quietly(grid, tmp_path)
    (failure,) = failed.failures
    assert str(broken) in failure.message and "damaged" in failure.message and not failure.traceback
    with pytest.raises(ComparisonError, match="no run has finished.*damaged"):
        summarise(failed)
    broken.unlink()
    again = run_quietly(grid, tmp_path)
    assert not again.failures and again.runs[0][1] == finished.runs[0][1]


@pytest.mark.nightly
def test_a_damaged_result_is_made_again_from_its_run(finished: Comparison, tmp_path: Path):
    grid = change(agents=SMALL.agents[3:], runs=1)
    first = run_quietly(grid, tmp_path)
    (run, result), = first.runs
    folder = get_run_folder(tmp_path, run)
    log = (folder / "training" / "log.jsonl").read_bytes()
    for damage in (b"{", b"[]", b'{"identity": {}}', (folder / "run_result.json").read_bytes()[:-40]):
        (folder / "run_result.json").write_bytes(damage)
        assert run_quietly(grid, tmp_path).runs == ((run, result),)
        assert load_run_result(tmp_path, run) == result
    assert (folder / "training" / "log.jsonl").read_bytes() == log, "the finished training itself is not repeated"


# --- folders and disks -----------------------------------------------------------------


def test_a_folder_that_cannot_be_written_is_one_clear_message(tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileWriteError, match="cannot write .*file/out"):
        run_quietly(SMALL, tmp_path / "file" / "out")


@pytest.mark.nightly
def test_a_full_disk_fails_the_runs_that_need_it_and_keeps_what_is_finished(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The limit on a file's size stands for a disk that fills up: random's files are small, dqn's checkpoint is not.

    It is one of the process from which those of runs are forked, which a first comparison begins.
    """
    run_quietly(change(runs=1, agents=["random"], primitives=60), tmp_path / "begun")
    grid = change(runs=1, agents=["random", "dqn"])
    write_json(tmp_path / "full.json", grid.to_dict())
    server = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    before = resource.prlimit(server, resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))
    try:
        code = main(["compare", str(tmp_path / "full.json"), "--out", str(tmp_path / "out"), "--workers", "1"])
    finally:
        resource.prlimit(server, resource.RLIMIT_FSIZE, before)
    told = capsys.readouterr().err
    assert code == 1
    assert "dqn, small, seed 0: failed: cannot write" in told, told
    assert "random, small, seed 0: efficiency" in told
    assert not run_quietly(grid, tmp_path / "out").failures


@pytest.mark.nightly
def test_a_folder_deleted_meanwhile_is_told_with_its_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    grid = change(primitives=1_000_000, runs=1, agents=["random", "random-options"])
    write_json(tmp_path / "long.json", grid.to_dict())
    runs = grid.make_runs(grid.make_places())

    def delete() -> None:
        assert wait_until(lambda: all(read_progress(tmp_path / "out", run) for run in runs))
        shutil.rmtree(tmp_path / "out")

    with ThreadPoolExecutor() as pool:
        deleted = pool.submit(delete)
        code = main(["compare", str(tmp_path / "long.json"), "--out", str(tmp_path / "out"), "--workers", "2"])
    deleted.result()
    output = "".join(capsys.readouterr())
    assert code == 2 and "Traceback" not in output, output
    about, *told = output.splitlines()
    assert about == "no agent is trained"
    assert len(told) == 3 and all("was deleted or moved while its run was writing it" in line for line in told), output
    assert told[2].startswith("hrl-escape: ") and "no run has finished, so there is nothing to report" in told[2]


@pytest.mark.nightly
def test_a_folder_deleted_after_the_last_run_is_told_with_its_reason(tmp_path: Path):
    class Deleting(LocalLauncher):
        def run(self, runs, out, listener):
            super().run(runs, out, listener)
            shutil.rmtree(out)

    comparison = run_quietly(change(runs=1, agents=["random"], primitives=60), tmp_path / "out", Deleting(1))
    with pytest.raises(EscapeError, match="no such"):
        write_report(comparison, "hrl-escape compare")


def test_a_reference_that_trains_has_a_first_escape_and_a_band(tmp_path: Path):
    grid = change(agents=("random-options", "search-memory", "oracle"), runs=1, primitives=160, eval_every=160)
    random, memory, oracle = summarise(run_quietly(grid, tmp_path)).agents
    assert [each.is_trained for each in (random, memory, oracle)] == [True, True, False]
    assert [is_level(each) for each in (random, memory, oracle)] == [True, False, True]
    assert format_first_escape(oracle) == "no training"
    first = memory.first_escape.value
    assert first < 160 and format_first_escape(memory) == f"{first:,.0f} (1 of 1)"


@pytest.mark.nightly
def test_parts_are_disjoint_resumable_and_together_the_whole(tmp_path: Path):
    grid = change(agents=("random-options", "oracle"), runs=2, primitives=60, eval_every=60, eval_episodes=1)
    runs = grid.make_runs(grid.make_places())
    parts = [Shard(number, 3).choose(runs) for number in (1, 2, 3)]
    assert sorted(run.key for part in parts for run in part) == sorted(run.key for run in runs)
    assert count_missing(grid, tmp_path) == (4, 4, None)
    for number in (2, 1, 2):
        made = run_quietly(grid, tmp_path, shard=Shard(number, 2))
        assert [run.key for run, _ in made.runs] == [run.key for run in runs[number - 1 :: 2]]
    assert count_missing(grid, tmp_path)[:2] == (4, 0)
    whole = read_comparison(tmp_path)
    assert [run.key for run, _ in whole.runs] == [run.key for run in runs] and whole.grid == grid
    for text in ("0/2", "3/2", "1", "a/b"):
        with pytest.raises(ConfigError, match="such as 2/8"):
            Shard.parse(text)
