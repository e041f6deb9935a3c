"""Files of finished runs: a stopped benchmark continues with what is missing."""

import json

from benchmarks.finished_runs import run_missing


def test_finished_runs_are_kept_and_missing_ones_added(tmp_path):
    made, file = [], tmp_path / "runs.jsonl"

    def run(name, seed):
        made.append((name, seed))
        return {"score": 10 * seed}

    cells = [{"name": "a", "seed": 0}, {"name": "a", "seed": 1}]
    assert [row["score"] for row in run_missing(file, cells, run)] == [0, 10]
    rows = run_missing(file, [*cells, {"name": "b", "seed": 1}], run)
    assert made == [("a", 0), ("a", 1), ("b", 1)]
    assert [(row["name"], row["seed"], row["score"]) for row in rows] == [("a", 0, 0), ("a", 1, 10), ("b", 1, 10)]
    assert [json.loads(line) for line in file.read_text().splitlines()] == rows
    assert all(row["seconds"] >= 0 for row in rows)
    assert run_missing(file, [], run) == rows and len(made) == 3
