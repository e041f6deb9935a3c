"""`hrl-escape bench batch` through the command line: contenders, JSON, plot and refusals."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from hrl_escape.cli import main

QUICK = ("--seconds", "0.01", "--repeats", "1", "--threads", "1", "--engines", "eager", "--sizes", "2", "16")


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    code = main(["bench", "batch", *arguments])
    out, err = capsys.readouterr()
    return code, out, err


def test_it_measures_our_batches_beside_others_in_one_run(capsys, tmp_path):
    plot = tmp_path / "batch.png"
    code, out, _ = run(capsys, *QUICK, "--scenes", "paper-two-button", "ten-obstacles-by-hand", "--json",
                       "--plot", str(plot))
    report = json.loads(out)
    assert code == 0
    rows = report["contenders"]
    ours = [(row["name"], row["engine"], row["rooms"]) for row in rows if row["memory_bound"]]
    assert ours == [(scene, "eager", size) for scene in ("paper-two-button", "ten-obstacles-by-hand")
                    for size in (2, 16)]
    assert {"CartPole-v1", "paper-two-button"} <= {row["name"] for row in rows if not row["memory_bound"]}
    for row in rows:
        assert row["steps_per_second"] == pytest.approx(1e6 * row["rooms"] / row["step_us"])
        assert row["memory_bound"] is None or row["state_bytes"] < 200 < row["moved_bytes"] < 2000
    assert report["machine"]["threads"] == 1
    assert Image.open(plot).size[0] > 500


def test_the_table_says_what_the_numbers_are(capsys):
    code, out, _ = run(capsys, *QUICK, "--scenes", "bit-flip", "--no-peers")
    assert code == 0
    assert "bit-flip" in out and "memory bound" in out and "resets included" in out and "CartPole" not in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scenes", "cluter"], "did you mean 'clutter'"),
        (["--engines", "compile"], "did you mean 'compiled'"),
        (["--sizes", "0"], "sizes of at least 1"),
        (["--scenes", "push-block"], "physics"),
        (["--device", "cuda:77"], "device"),
    ],
)
def test_a_wrong_option_gets_one_clear_line(capsys, arguments, words):
    code, _, err = run(capsys, *QUICK, *arguments)
    assert code == 2
    assert words in err and len(err.strip().splitlines()) == 1
