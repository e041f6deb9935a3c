"""`hrl-escape room` through the command line: generate, load, check, drive, draw, save."""

import json
from xml.etree import ElementTree

import pytest

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from tests.command_line import assert_refused, call, run_program
from tests.forks import run_fork


@pytest.mark.nightly
def test_room_generates_checks_draws_and_saves(tmp_path):
    done = run_program("room", "--room", "clutter#3", "--draw", "room.svg", "--save", "room.json",
                       "--json", "--check", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == ""
    report, instance = json.loads(done.stdout), generate(get_preset("clutter"), 3)
    assert report["id"] == instance.id and report["check"] == "solvable"
    assert [t["name"] for t in report["targets"]] == list(instance.puzzle.target_names)
    assert sorted(report["files"]) == ["room.json", "room.svg"]
    assert RoomInstance.load(tmp_path / "room.json") == instance
    assert ElementTree.parse(tmp_path / "room.svg").getroot().tag.endswith("svg")


def test_a_saved_room_is_loaded_as_it_was(capsys, tmp_path):
    call(capsys, "room", "--room", "ten-button#2", "--save", tmp_path / "room.json")
    code, out, _ = call(capsys, "room", "--room", tmp_path / "room.json", "--json")
    assert code == 0 and json.loads(out)["id"] == generate(get_preset("ten-button"), 2).id
    code, _, err = call(capsys, "room", "--room", tmp_path / "room.json", "--set", "room.width=30")
    assert code == 2 and "holds one finished room" in err


def test_a_corrupted_room_is_refused(capsys, tmp_path):
    path = tmp_path / "room.json"
    call(capsys, "room", "--save", path)
    path.write_text(path.read_text().replace('"half_width": 10.0', '"half_width": 11.0'))
    code, _, err = call(capsys, "room", "--room", path)
    assert code == 2 and "corrupted" in err
    path.write_text(path.read_text()[:100])
    assert call(capsys, "room", "--room", path)[0] == 2


def test_check_finds_a_room_that_cannot_be_solved(capsys, tmp_path):
    path = tmp_path / "room.json"
    call(capsys, "room", "--room", "paper-one-button", "--save", path)
    content = json.loads(path.read_text())
    del content["id"]
    wall = {"shape": "box", "x": 0.0, "y": 5.0, "half_x": 10.0, "half_y": 0.1, "yaw": 0.0, "height": 3.0,
            "role": "wall"}
    content["solids"].append(wall)  # across the room, between start and button
    RoomInstance.from_dict(content).save(path)
    code, out, _ = call(capsys, "room", "--room", path, "--check", "--json")
    assert code == 1 and "button-1" in json.loads(out)["check"]
    assert call(capsys, "room", "--room", path)[0] == 0  # only --check judges


def test_fields_presets_and_files_say_which_room(capsys, tmp_path):
    code, out, _ = call(capsys, "room", "--set", "room.width=30", "obstacles.count=7", "name=wide", "--json")
    report = json.loads(out)
    assert code == 0 and report["size"] == [30, 20] and report["name"] == "wide"
    assert report["walls"] == 4 and report["obstacles"] == 7
    _, out, _ = call(capsys, "room", "--room", "larg-2019(size=4, seed=3)", "--json")
    assert json.loads(out)["id"] == generate(get_preset("larg-2019", size=4, seed=3), 0).id
    (tmp_path / "mine.toml").write_text('horizon = 50\n[room]\nwidth = 12\n[puzzle]\nkind = "buttons"\ncount = 3\n')
    _, out, _ = call(capsys, "room", "--room", tmp_path / "mine.toml", "--json")
    report = json.loads(out)
    assert (report["name"], report["size"], report["horizon"], len(report["targets"])) == ("mine", [12, 20], 50, 3)
    (tmp_path / "mine.json").write_text(json.dumps(get_preset("clutter").to_dict()))
    _, out, _ = call(capsys, "room", "--room", f"{tmp_path / 'mine.json'}#3", "--json")
    assert json.loads(out)["id"] == generate(get_preset("clutter"), 3).id
    (tmp_path / "mine.toml").write_text("[room\n")
    code, _, err = call(capsys, "room", "--room", tmp_path / "mine.toml")
    assert code == 2 and "not TOML" in err


URDF = """<robot name="boom"><link name="foot"/>
<link name="boom"><collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>
<joint name="lift" type="revolute"><parent link="foot"/><child link="boom"/><axis xyz="0 -1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint><link name="tip"/>
<joint name="end" type="fixed"><parent link="boom"/><child link="tip"/><origin xyz="0.8 0 0"/></joint></robot>"""
MESH = "v 0 0 0\nv 0.8 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
ARM = ("robot.kind=urdf", "robot.joints=1", "robot.body_radius=0.4", "dynamics.press_with=hand",
       "puzzle.buttons.centre_height=1.0")


def test_a_bare_room_starts_from_the_defaults_of_a_room_configuration_and_a_preset_from_its_own(capsys):
    report = json.loads(call(capsys, "room", "--set", "puzzle.count=12", "--json", "--check")[1])
    room = generate(RoomConfig(puzzle=ButtonsConfig(count=12)), 0)
    assert (report["id"], report["name"], report["check"]) == (room.id, "custom", "solvable")
    assert json.loads(call(capsys, "room", "--json")[1])["name"] == "paper-two-button"
    wide = json.loads(call(capsys, "room", "--room", "paper-two-button", "--set", "horizon=5", "--json")[1])
    assert wide["name"] == "paper-two-button" and wide["horizon"] == 5
    graph = json.loads(call(capsys, "room", "--set", "puzzle.kind=hanoi", "puzzle.discs=2", "--json")[1])
    assert graph["puzzle"] == "hanoi"


def test_a_section_at_its_defaults_can_be_set(capsys, tmp_path):
    path = tmp_path / "room.json"
    assert call(capsys, "room", "--room", "four-button-chain", "--set", "puzzle.cues.kind=rank",
                "puzzle.cues.levels=4", "--save", path)[0] == 0
    assert len(RoomInstance.load(path).puzzle.cues) == 4


def test_the_robot_s_urdf_is_given_by_its_path(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "boom.obj").write_text(MESH)
    (tmp_path / "arm4.urdf").write_text(URDF.format(mesh="package://boom.obj"))
    code, out, _ = call(capsys, "room", "--set", *ARM, "robot.urdf=arm4.urdf", "--json", "--save",
                        "room.json", "--draw", "end.png", "--camera", "chase")
    assert code == 0 and json.loads(out)["joints"] == 1
    room = RoomInstance.load(tmp_path / "room.json")
    assert str(tmp_path / "boom.obj") in (room.robot.urdf or "") and room.robot.joints == 1
    (tmp_path / "robots").mkdir()
    (tmp_path / "arm4.urdf").rename(tmp_path / "robots" / "arm4.urdf")
    (tmp_path / "mine.json").write_text(json.dumps(
        get_preset("paper-two-button").to_dict() | {"robot": {"kind": "urdf", "joints": 1, "urdf": "arm4.urdf"}}))
    assert_refused(capsys, ["room", "--room", str(tmp_path / "mine.json")], "cannot read the URDF")
    (tmp_path / "mine.json").rename(tmp_path / "robots" / "mine.json")
    assert call(capsys, "room", "--room", tmp_path / "robots" / "mine.json")[0] == 0, "beside the room configuration"


@pytest.mark.parametrize("mesh", ["package://boom/boom.obj", "boom.obj", "/gone/boom.obj"])
def test_a_mesh_that_is_not_there_is_refused_before_a_room_is_sampled(capsys, tmp_path, mesh):
    (tmp_path / "arm4.urdf").write_text(URDF.format(mesh=mesh))
    assert_refused(capsys, ["room", "--set", *ARM, f"robot.urdf={tmp_path / 'arm4.urdf'}"], mesh.split("/")[-1])
    robot = {"kind": "urdf", "joints": 1, "urdf": URDF.format(mesh=mesh)}
    (tmp_path / "mine.json").write_text(json.dumps({"robot": robot}))
    assert_refused(capsys, ["room", "--room", str(tmp_path / "mine.json")], mesh.split("/")[-1])


def test_tables_are_for_people(capsys):
    code, out, _ = call(capsys, "room", "--room", "four-button-chain", "--check")
    assert code == 0
    words = ("four-button-chain", " before button-", ", goal button-", "solvable", "20 x 20 m")
    assert all(word in out for word in words)


def test_a_killed_drawing_leaves_the_old_file(tmp_path):
    path = tmp_path / "room.svg"
    path.write_text("old")
    script = ("import os, sys, hrl_escape.files as files\n"
              "files.os.replace = lambda *_: os.kill(os.getpid(), 9)\n"
              "from hrl_escape.cli import main; main(['room', '--draw', sys.argv[1]])")
    assert run_fork(script, str(path)).returncode != 0
    assert path.read_text() == "old"


@pytest.mark.nightly_for("arguments21-no solvable room")
@pytest.mark.parametrize(("arguments", "words"), [
    (["--room", "cluter"], "did you mean 'clutter'"),
    (["--room", "paper-two-button(size=4)"], "paper-two-button"),
    (["--set", "room.width=3000"], "from 5 to 200 m"),
    (["--set", "room.widht=30"], "unknown path of --set 'room.widht'; did you mean 'room.width'?"),
    (["--set", "rom.width=30"], "did you mean 'room.width'?"),
    (["--set", "rom=30"], "did you mean 'room'?"),
    (["--set", "puzzle.cuees.kind=rank"], "did you mean 'puzzle.cues.kind'?"),
    (["--set", "puzzle.buttons.count=12"], "'count' is in puzzle.count, "),
    (["--set", "puzzle.buttons.size=12"], "Known: puzzle.buttons.centre_height, puzzle.buttons.gap"),
    (["--set", "puzzle.kind=hanoi", "puzzle.count=3"], "puzzle.discs"),
    (["--set", "room.width"], "name=value"),
    (["--set", "=30"], "name=value"),
    (["--set", "horizon=" + "9" * 5_000], "--set horizon: this value cannot be read: it has a number of thousands"),
    (["--set", "horizon=" + "[" * 10_000 + "]" * 10_000], "nested more than 100 levels deep"),
    (["--room", "clutter#-1"], "after # write the number of a room"),
    (["--room", "nowhere.json"], "nowhere.json: no such"),
    (["--room", "nowhere.toml"], "nowhere.toml: no such"),
    (["--draw", "room.bmp"], ".svg"),
    (["--draw", "room.gif"], ".svg"),
    (["--draw", "room.png", "--camera", "chasse"], "did you mean 'chase'"),
    (["--save", "/proc/nowhere/room.json"], "cannot write"),
    (["--set", "obstacles.count=200", "obstacles.size_min=8", "obstacles.size_max=9"], "no solvable room"),
    (["--room", "nowhere.toml(size=4)"], "only presets take arguments in parentheses"),
])
def test_a_mistake_is_one_line_and_leaves_no_file(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, ["room", *arguments], words)
    assert list(tmp_path.iterdir()) == []
