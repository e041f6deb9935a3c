"""The command line as a user meets it: help that is quick, errors of one line, output one can pipe."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest

import hrl_escape
from tests.command_line import PROGRAM, assert_refused, call, run_program, run_python
from tests.forks import run_fork


def test_help_lists_every_command_with_one_line_each():
    done = run_program("--help")
    assert done.returncode == 0 and done.stderr == ""
    commands = dict(re.findall(r"^  (\S+) +(\S.*)$", done.stdout, re.MULTILINE))
    assert {"demo", "ladder", "list", "room"} <= set(commands)
    assert all(len(line) <= 120 for line in done.stdout.splitlines())
    group = run_program("ladder", "--help")
    assert group.returncode == 0 and re.search(r"^  verify +\S", group.stdout, re.MULTILINE)


def test_without_a_command_help_is_shown_and_the_exit_code_says_so(capsys):
    code, out, _ = call(capsys)
    assert code == 2 and "usage: hrl-escape" in out


def test_version(capsys):
    assert call(capsys, "--version") == (0, f"hrl-escape {hrl_escape.__version__}\n", "")


def test_the_module_runs_like_the_program():
    done = subprocess.run([sys.executable, "-m", "hrl_escape.cli", "--version"], capture_output=True, text=True,
                          env=os.environ)
    assert done.stdout == f"hrl-escape {hrl_escape.__version__}\n"


def test_help_imports_nothing_that_takes_time():
    script = ("import sys; from hrl_escape.cli import main; main(['--help'])\n"
              "print('HEAVY', *({'torch', 'tyro', 'rich', 'matplotlib', 'pybullet', 'ompl', 'pinocchio', 'scipy'}"
              " & set(sys.modules)))")
    assert run_python(script).stdout.splitlines()[-1] == "HEAVY"


@pytest.mark.nightly
def test_a_first_room_and_a_first_plan_load_little():
    """A room needs no compiler and no SciPy; a plan loads numba, and what numba loads of SciPy."""
    script = ("import sys, gymnasium, hrl_escape; heavy = {'PIL', 'matplotlib', 'ompl', 'pinocchio', 'pybullet', "
              "'torch', 'scipy.ndimage', 'scipy.sparse.csgraph', 'scipy.interpolate', 'scipy.optimize'}\n"
              "gymnasium.make('hrl_escape/Clutter-v1').reset(seed=0)\n"
              "print('ROOM', *({*heavy, 'numba', 'rich', 'scipy', 'tyro'} & set(sys.modules)))\n"
              "from hrl_escape.cli import main; main(['solve', '--room', 'clutter'])\n"
              "print('PLAN', *(heavy & set(sys.modules)))")
    lines = run_python(script).stdout.splitlines()
    assert lines[0] == "ROOM" and lines[-1] == "PLAN" and any("every state as predicted" in line for line in lines)


def test_missing_packages_stop_only_the_commands_that_need_them():
    missing = ("matplotlib", "ompl", "pinocchio", "imageio_ffmpeg", "viser")
    script = ("import sys; sys.modules |= dict.fromkeys(sys.argv[1:]); from hrl_escape.cli import main\n"
              "sys.exit(main(['--help']) or main(['list', 'presets', '--json']))")
    done = run_fork(script, *missing)
    assert done.returncode == 0, done.stderr
    assert "clutter" in done.stdout


def test_a_missing_extra_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    code, _, err = call(capsys, "solve", "--room", "paper-one-button", "--draw", tmp_path / "way.mp4")
    assert code == 2 and "'.[video]'" in err and err.count("\n") == 1


COMMANDS = [["room"], ["solve"], ["train"], ["play"], ["watch"], ["record"], ["list"], ["demo"], ["compare"],
            ["ladder", "run"]]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_command_explains_itself_and_every_option(capsys, command):
    code, out, _ = call(capsys, *command, "--help")
    assert code == 0
    assert f"usage: hrl-escape {' '.join(command)}" in out and re.search(r"hrl-escape " + " ".join(command), out)
    for option in re.findall(r"^│ (--[a-z-]+)", out, re.MULTILINE):
        after = out.split(option, 1)[1].split("│ --", 1)[0]
        assert re.search(r"[a-z]{3,}", after), f"{command} {option} has no help"


@pytest.mark.parametrize(("arguments", "words"), [
    (["rom"], "did you mean 'room'"),
    (["ladder", "runs"], "did you mean 'run'"),
    (["compare", "quickstart", "--workers", "-1"], "workers = -1 is not possible"),
])
def test_a_mistake_is_one_line_and_exit_code_2(capsys, arguments, words):
    assert_refused(capsys, arguments, words)


@pytest.mark.parametrize("command", ["solve", "record", "play", "watch", "mcp"])
def test_an_impossible_episode_seed_is_refused_before_anything_is_opened_or_written(capsys, tmp_path, monkeypatch,
                                                                                    command):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, [command, "--room", "paper-one-button", "--episode-seed", "-1"],
                   "seed = -1 is not possible: a whole number of at least 0")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_option_is_explained(capsys):
    code, out, err = call(capsys, "room", "--romm", "clutter")
    assert code == 2 and "--room" in out + err


def test_mistakes_show_no_traceback_in_the_real_program(tmp_path):
    done = subprocess.run([PROGRAM, "room", "--room", "cluter"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


@pytest.mark.nightly
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    done = subprocess.run(f"'{PROGRAM}' list | head -1", shell=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.stderr == ""


@pytest.mark.parametrize("command", [
    ["--help"], pytest.param(["list", "presets", "--json"], marks=pytest.mark.nightly)], ids=" ".join)
def test_output_that_cannot_be_written_is_one_line(tmp_path, command):
    with open("/dev/full", "w") as full:
        done = subprocess.run([PROGRAM, *command], stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "hrl-escape: cannot write the output: No space left on device\n"


@pytest.mark.nightly
def test_a_closed_pipe_ends_a_program_as_the_shell_expects(tmp_path):
    script = f"'{PROGRAM}' list | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == "141\n" and done.stderr == ""


@pytest.mark.parametrize("number", [
    signal.SIGTERM, *(pytest.param(number, marks=pytest.mark.nightly) for number in (signal.SIGHUP, signal.SIGINT))])
def test_a_signal_ends_a_run_in_order_and_with_its_own_exit_code(tmp_path, number):
    before = signal.signal(number, signal.default_int_handler)  # a child inherits what is ignored, as under nohup
    try:
        process = subprocess.Popen([PROGRAM, "train", "random", "--primitives", "100000000", "--out", tmp_path / "run"],
                                   stderr=subprocess.PIPE, text=True)
    finally:
        signal.signal(number, before)
    try:
        while not (tmp_path / "run" / "log.jsonl").exists():
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(number)
        error = process.communicate(timeout=600)[1]
    finally:
        process.kill()
    assert process.returncode == 128 + number
    assert error.count("\n") == 1 and error.startswith("hrl-escape: ")


@pytest.mark.parametrize("threads", ["0", "-1", "many", "", "\u0663", "9" * 5_000])
def test_a_wrong_number_of_threads_is_named(capsys, monkeypatch, threads):
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    assert_refused(capsys, ["solve"], "NUMBA_NUM_THREADS")


LONG = "a" * 300


@pytest.mark.parametrize("arguments", [
    ["room", "--room", LONG + ".json"], ["room", "--room", LONG + ".toml"], ["compare", LONG + ".toml"],
    ["record", LONG + ".json"], ["record", LONG], ["room", "--save", f"/tmp/{LONG}"],
    ["train", "random", "--primitives", "10", "--out", LONG], ["compare", "quickstart", "--out", LONG],
    ["room", "--room", "a\0b.json"], ["room", "--room", "/dev/zero.json"], ["room", "--room", "/dev/zero"],
    ["compare", "/dev/zero.toml"], ["room", "--room", "/"],
], ids=lambda arguments: " ".join(arguments)[:30])
def test_a_name_that_no_file_can_have_and_what_is_no_file_are_one_line(capsys, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, *arguments)
    assert code == 2 and err.count("\n") == 1


@pytest.mark.nightly
def test_an_animation_needs_no_viewer(tmp_path):
    script = ("import sys; sys.modules['viser'] = sys.modules['trimesh'] = None; from hrl_escape.cli import main\n"
              "sys.exit(main(['record', '--room', 'paper-one-button', '--out', sys.argv[1]]))")
    done = run_fork(script, str(tmp_path / "x.gif"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "x.gif").read_bytes()[:3] == b"GIF"


def test_last_words_of_a_library_that_aborts_reach_the_user(tmp_path):
    commands = tmp_path / "planted"
    commands.mkdir()
    (commands / "crash.py").write_text(
        '"""Abort while it is imported."""\nimport os\nfrom hrl_escape.env.bullet import engine\n'
        'os.write(2, b"double free or corruption\\n")\nos.abort()\n\ndef run(args): ...\n')
    script = ("import sys, pathlib; sys.path.insert(0, sys.argv[1]); from hrl_escape import cli\n"
              "cli._FOLDER, cli._COMMANDS = pathlib.Path(sys.argv[1], 'planted'), 'planted'; cli.main(['crash'])")
    done = run_fork(script, str(tmp_path))
    assert done.returncode == -6
    assert done.stderr == "double free or corruption\n"
