"""`hrl-escape demo`: a way out, planned, driven and drawn."""

from pathlib import Path

from PIL import Image

from tests.command_line import run_program


def test_demo_leaves_pictures_and_says_where(tmp_path):
    done = run_program("demo", "--preset", "paper-one-button", "--folder", "out", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == ""
    assert "escaped" in done.stdout
    shown = done.stdout.strip().splitlines()[-1].split(": ")[-1]
    assert Path(shown) == tmp_path / "out" / "map.svg" and Path(shown).stat().st_size > 10_000
    assert Image.open(tmp_path / "out" / "filmstrip.png").width > 1000
    assert Image.open(tmp_path / "out" / "escape.gif").n_frames > 5
