"""The command line as a user meets it: help that is quick, errors of one line, output one can pipe."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

import hrl_escape
from hrl_escape.cli import main
from hrl_escape.env.bullet_cameras import CAMERAS
from hrl_escape.env.generation import generate
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.observations import OBSERVATIONS
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.primitives import BASE_PRIMITIVES

PROGRAM = Path(sys.executable).with_name("hrl-escape")


def run_program(*arguments, cwd=None):
    return subprocess.run([PROGRAM, *arguments], cwd=cwd, capture_output=True, text=True)


def run_python(script, *arguments):
    return subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True)


def call(capsys, *arguments):
    """Exit code, stdout and stderr of a command run in this process."""
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


# --- the frame -----------------------------------------------------------------------------


def test_help_lists_every_command_with_one_line_each():
    done = run_program("--help")
    assert done.returncode == 0 and done.stderr == ""
    commands = dict(re.findall(r"^  (\S+) +(\S.*)$", done.stdout, re.MULTILINE))
    assert {"bench", "demo", "list", "room"} <= set(commands)
    assert all(len(line) <= 120 for line in done.stdout.splitlines())
    group = run_program("bench", "--help")
    assert group.returncode == 0 and re.search(r"^  env +\S", group.stdout, re.MULTILINE)


def test_without_a_command_help_is_shown_and_the_exit_code_says_so(capsys):
    code, out, _ = call(capsys)
    assert code == 2 and "usage: hrl-escape" in out


def test_version(capsys):
    assert call(capsys, "--version") == (0, f"hrl-escape {hrl_escape.__version__}\n", "")


def test_help_imports_nothing_that_takes_time():
    script = ("import sys; from hrl_escape.cli import main; main(['--help'])\n"
              "print('HEAVY', *({'torch', 'tyro', 'rich', 'matplotlib', 'pybullet', 'ompl', 'pinocchio', 'scipy'}"
              " & set(sys.modules)))")
    assert run_python(script).stdout.splitlines()[-1] == "HEAVY"


@pytest.mark.parametrize("missing", ["matplotlib", "ompl", "pinocchio", "imageio_ffmpeg", "viser"])
def test_a_missing_package_stops_only_the_commands_that_need_it(missing):
    script = ("import sys; sys.modules[sys.argv[1]] = None; from hrl_escape.cli import main\n"
              "sys.exit(main(['--help']) or main(['list', 'presets', '--json']))")
    done = run_python(script, missing)
    assert done.returncode == 0, done.stderr
    assert "clutter" in done.stdout


def test_every_command_explains_itself(capsys):
    for command in (["room"], ["list"], ["demo"], ["bench", "env"]):
        code, out, _ = call(capsys, *command, "--help")
        assert code == 0
        assert f"usage: hrl-escape {' '.join(command)}" in out and "Examples:" in out
        for option in re.findall(r"^│ (--[a-z-]+)", out, re.MULTILINE):
            after = out.split(option, 1)[1].split("│ --", 1)[0]
            assert re.search(r"[a-z]{3,}", after), f"{command} {option} has no help"


@pytest.mark.parametrize(("arguments", "said"), [
    (["rom"], "Perhaps you meant 'room'"),
    (["bench", "envs"], "Perhaps you meant 'env'"),
    (["room", "--preset", "cluter"], "Perhaps you meant 'clutter'"),
    (["room", "--arguments", "size=4"], "paper-two-button"),
    (["room", "--set", "room.width=3000"], "from 5 to 200 m"),
    (["room", "--set", "room.widht=30"], "fields are width, depth"),
    (["room", "--set", "rom.width=30"], "one of room, robot"),
    (["room", "--set", "room.width"], "name=value"),
    (["room", "--seed", "-1"], "whole number from 0"),
    (["room", "--load", "nowhere.json"], "nowhere.json: no such"),
    (["room", "--config", "nowhere.toml"], "nowhere.toml: no such"),
    (["room", "--drive", "forwards"], "Perhaps you meant 'forward'"),
    (["room", "--drive", "forward*x"], "name*n"),
    (["room", "--draw", "room.bmp"], ".svg"),
    (["room", "--draw", "room.png", "--camera", "chasse"], "Perhaps you meant 'chase'"),
    (["room", "--save", "/proc/nowhere/room.json"], "cannot write"),
    (["room", "--set", "obstacles.count=200", "obstacles.size_min=8", "obstacles.size_max=9"], "no solvable room"),
    (["bench", "env", "--presets", "cluter"], "Perhaps you meant 'clutter'"),
    (["bench", "env", "--repeats", "0"], "at least 1"),
    (["train", "dqn", "--settings", "gamma"], "--settings = 'gamma' is not possible: name=value is needed"),
    (["train", "dqn", "--threads", "0"], "threads = 0 is not possible"),
    (["compare", "quickstart", "--workers", "-1"], "workers = -1 is not possible"),
])
def test_a_users_mistake_is_one_line_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(capsys, *arguments)
    assert code == 2 and out == ""
    assert err.startswith("hrl-escape: ") and err.count("\n") == 1 and said in err
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_option_is_explained(capsys):
    code, out, err = call(capsys, "room", "--sed", "3")
    assert code == 2 and "--seed" in out + err


def test_mistakes_show_no_traceback_in_the_real_program(tmp_path):
    done = run_program("room", "--preset", "cluter", cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    done = subprocess.run(f"'{PROGRAM}' list | head -1", shell=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.stderr == ""


def test_a_missing_extra_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    code, _, err = call(capsys, "room", "--drive", "forward", "--draw", tmp_path / "drive.mp4")
    assert code == 2 and "hrl-escape[video]" in err and err.count("\n") == 1


# --- room ----------------------------------------------------------------------------------


def test_room_generates_checks_draws_and_saves(tmp_path):
    done = run_program("room", "--preset", "clutter", "--seed", "3", "--draw", "room.svg", "--save", "room.json",
                       "--json", "--check", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == ""
    report, instance = json.loads(done.stdout), generate(get_preset("clutter"), 3)
    assert report["id"] == instance.id and report["check"] == "solvable"
    assert [t["name"] for t in report["targets"]] == list(instance.puzzle.target_names)
    assert sorted(report["files"]) == ["room.json", "room.svg"]
    assert RoomInstance.load(tmp_path / "room.json") == instance
    assert ElementTree.parse(tmp_path / "room.svg").getroot().tag.endswith("svg")


def test_a_saved_room_is_loaded_as_it_was(capsys, tmp_path):
    call(capsys, "room", "--preset", "ten-button", "--seed", "2", "--save", tmp_path / "room.json")
    code, out, _ = call(capsys, "room", "--load", tmp_path / "room.json", "--json")
    assert code == 0 and json.loads(out)["id"] == generate(get_preset("ten-button"), 2).id
    code, _, err = call(capsys, "room", "--load", tmp_path / "room.json", "--set", "room.width=30")
    assert code == 2 and "--load" in err


def test_a_corrupted_room_is_refused(capsys, tmp_path):
    path = tmp_path / "room.json"
    call(capsys, "room", "--save", path)
    path.write_text(path.read_text().replace('"half_width": 10.0', '"half_width": 11.0'))
    code, _, err = call(capsys, "room", "--load", path)
    assert code == 2 and "corrupted" in err
    path.write_text(path.read_text()[:100])
    assert call(capsys, "room", "--load", path)[0] == 2


def test_check_finds_a_room_that_cannot_be_solved(capsys, tmp_path):
    path = tmp_path / "room.json"
    call(capsys, "room", "--preset", "paper-one-button", "--save", path)
    content = json.loads(path.read_text())
    del content["id"]
    wall = {"shape": "box", "x": 0.0, "y": 5.0, "half_x": 10.0, "half_y": 0.1, "height": 3.0, "role": "wall"}
    content["solids"].append(wall)  # across the room, between start and button
    path.write_text(json.dumps(content))
    code, out, _ = call(capsys, "room", "--load", path, "--check", "--json")
    assert code == 1 and "button-1" in json.loads(out)["check"]
    assert call(capsys, "room", "--load", path)[0] == 0  # only --check judges


def test_fields_presets_and_files_say_which_room(capsys, tmp_path):
    code, out, _ = call(capsys, "room", "--set", "room.width=30", "obstacles.count=7", "name=wide", "--json")
    report = json.loads(out)
    assert code == 0 and report["size"] == [30, 20] and report["obstacles"] == 7 and report["name"] == "wide"
    _, out, _ = call(capsys, "room", "--preset", "larg-2019", "--arguments", "size=4", "seed=3", "--json")
    assert json.loads(out)["id"] == generate(get_preset("larg-2019", size=4, seed=3), 0).id
    (tmp_path / "mine.toml").write_text('horizon = 50\n[room]\nwidth = 12\n[puzzle]\nkind = "buttons"\ncount = 3\n')
    _, out, _ = call(capsys, "room", "--config", tmp_path / "mine.toml", "--json")
    report = json.loads(out)
    assert (report["name"], report["size"], report["horizon"], len(report["targets"])) == ("mine", [12, 20], 50, 3)
    (tmp_path / "mine.json").write_text(json.dumps(get_preset("clutter").to_dict()))
    _, out, _ = call(capsys, "room", "--config", tmp_path / "mine.json", "--seed", "3", "--json")
    assert json.loads(out)["id"] == generate(get_preset("clutter"), 3).id
    (tmp_path / "mine.toml").write_text("[room\n")
    code, _, err = call(capsys, "room", "--config", tmp_path / "mine.toml")
    assert code == 2 and "not TOML" in err


def test_driving_nine_strafes_left_escapes_with_return_91(capsys, tmp_path):
    code, out, _ = call(capsys, "room", "--preset", "paper-one-button", "--drive", "strafe-left*20", "--json",
                        "--draw", tmp_path / "drive.gif", tmp_path / "end.png", "--camera", "overhead")
    drive = json.loads(out)["drive"]
    assert code == 0 and drive["return"] == 91 and drive["terminated"] and drive["primitives"] == ["strafe-left"] * 9
    assert drive["pressed"] == [{"primitive": 9, "targets": ["button-1"]}]
    assert Image.open(tmp_path / "drive.gif").n_frames == 10
    end = np.asarray(Image.open(tmp_path / "end.png")).astype(int)
    assert (end[..., 1] - end[..., 0] > 50).sum() > 1000  # the exit is open


def test_random_driving_is_decided_by_its_seed(capsys):
    def drive(seed):
        _, out, _ = call(capsys, "room", "--drive", "0, 4 random*30", "--episode-seed", seed, "--json")
        return json.loads(out)["drive"]

    assert drive(1) == drive(1) != drive(2)
    assert drive(1)["primitives"][:2] == ["forward", "turn-left"] and len(drive(1)["path"]) == 33


def test_tables_are_for_people(capsys):
    code, out, _ = call(capsys, "room", "--preset", "four-button-chain", "--check")
    assert code == 0
    assert all(word in out for word in ("four-button-chain", "button-1 before button-2", "solvable", "20 x 20 m"))


# --- list, bench, demo ---------------------------------------------------------------------


def test_list_shows_everything_there_is_with_a_line_about_it(capsys):
    code, out, _ = call(capsys, "list", "--json")
    lists = json.loads(out)
    assert code == 0
    assert set(lists["presets"]) == set(PRESETS) and set(lists["cameras"]) == set(CAMERAS)
    assert set(lists["observations"]) == set(OBSERVATIONS)
    assert {"buttons", "bit-flip", "push-block"} <= set(lists["puzzles"])
    assert list(lists["primitives"])[:6] == [primitive.name for primitive in BASE_PRIMITIVES]
    assert all(len(line) > 8 for entries in lists.values() for line in entries.values())
    assert "3-joint arm" in lists["presets"]["arm-two-button"]
    code, out, _ = call(capsys, "list", "cameras")
    assert code == 0 and "overhead" in out and "clutter" not in out
    assert call(capsys, "list", "camera")[0] == 2


def test_bench_agents_measures_ours_beside_stable_baselines3_in_one_run(capsys):
    code, out, _ = call(capsys, "bench", "agents", "--updates", "40", "--rounds", "1", "--json")
    assert code == 0
    rows = json.loads(out)
    assert {"dqn", "ppo", "sarsa", "Stable-Baselines3 DQN", "Stable-Baselines3 PPO"} <= set(rows)
    ours, theirs = rows["dqn"], rows["Stable-Baselines3 DQN"]
    assert theirs["ratio"] == 1
    assert ours["ratio"] == pytest.approx(ours["updates_per_second"] / theirs["updates_per_second"], rel=0.01)


def test_bench_env_compares_with_cartpole_and_taxi_in_one_run(capsys):
    code, out, err = call(capsys, "bench", "env", "--presets", "paper-one-button", "push-block", "--seconds", "0.02",
                          "--repeats", "2", "--json")
    report = json.loads(out)
    rows = {row["name"]: row for row in report["environments"]}
    assert code == 0 and err == ""
    assert {"paper-one-button", "push-block", "CartPole-v1"} <= set(rows)
    assert any(name.startswith("Taxi-v") for name in rows)
    base = rows["CartPole-v1"]["steps_per_second"]
    assert rows["CartPole-v1"]["ratio"] == 1
    for row in rows.values():
        assert row["ratio"] == pytest.approx(row["steps_per_second"] / base)
        assert row["make_ms"] > 0 and row["reset_ms"] > 0
    assert rows["push-block"]["steps_per_second"] < rows["paper-one-button"]["steps_per_second"]


def test_demo_leaves_pictures_and_says_where(tmp_path):
    done = run_program("demo", "--preset", "paper-one-button", "--folder", "out", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == ""
    assert "escaped" in done.stdout
    shown = done.stdout.strip().splitlines()[-1].split(": ")[-1]
    assert Path(shown) == tmp_path / "out" / "map.svg" and Path(shown).stat().st_size > 10_000
    assert Image.open(tmp_path / "out" / "filmstrip.png").width > 1000
    assert Image.open(tmp_path / "out" / "escape.gif").n_frames > 5


def test_a_killed_drawing_leaves_the_old_file(tmp_path):
    path = tmp_path / "room.svg"
    path.write_text("old")
    script = ("import os, sys, hrl_escape.files as files\n"
              "files.os.replace = lambda *_: os.kill(os.getpid(), 9)\n"
              "from hrl_escape.cli import main; main(['room', '--draw', sys.argv[1]])")
    assert run_python(script, str(path)).returncode != 0
    assert path.read_text() == "old"


def test_the_module_runs_like_the_program():
    done = subprocess.run([sys.executable, "-m", "hrl_escape.cli", "--version"], capture_output=True, text=True,
                          env=os.environ)
    assert done.stdout == f"hrl-escape {hrl_escape.__version__}\n"
