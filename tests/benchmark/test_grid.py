"""Grids: what they read, what they refuse, and which runs are the same run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.grid import Grid, load_grid
from hrl_escape.benchmark.presets import GRIDS, get_grid
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError, FileReadError, GridError, UnknownNameError
from hrl_escape.sets import make_room
from hrl_escape.sets.room_spec import RoomSpec
from tests.benchmark.small import SMALL, change


def make_runs(grid: Grid):
    return grid.make_runs(grid.make_places())


# --- reading ---------------------------------------------------------------------------


def test_short_texts_name_recipe_and_instance():
    assert AgentSpec.parse("smdp-dqn@keras-rl-2019") == AgentSpec("smdp-dqn", recipe="keras-rl-2019")
    assert AgentSpec.parse("smdp-dqn@keras-rl-2019").label == "smdp-dqn@keras-rl-2019"
    assert RoomSpec.parse("clutter#3") == RoomSpec("clutter#3")
    assert RoomSpec.parse("some/room.json") == RoomSpec("some/room.json")


def test_a_toml_file_gives_the_grid_that_it_says(tmp_path: Path):
    generate(get_preset("paper-one-button"), 0).save(tmp_path / "room.json")
    (tmp_path / "mine.toml").write_text("""
        format = 2
        primitives = 500
        runs = 3
        rooms = ["clutter#2", "larg-2019(size=3)", "room.json", "ladder-1/pair/test#3",
                 { room = "clutter", set = { horizon = 50 } }, { config = { horizon = 60 }, instance = 4 }]
        [[agents]]
        name = "dqn"
        [[agents]]
        name = "smdp-dqn"
        label = "far"
        settings = { gamma = 0.999 }
        options = { include_primitives = true }
    """)
    grid = load_grid(tmp_path / "mine.toml")
    assert (grid.name, grid.primitives, grid.runs) == ("mine", 500, 3)
    assert grid.agents == (AgentSpec("dqn"), AgentSpec("smdp-dqn", label="far", settings={"gamma": 0.999},
                                                       options=OptionsView(include_primitives=True)))
    assert [agent.label for agent in grid.agents] == ["dqn", "far"]
    instances = [room.make_instance() for room in grid.rooms]
    assert [(i.name, i.seed) for i in instances] == [
        ("clutter", 2), ("larg-2019", 0), ("paper-one-button", 0), ("pair", make_room("ladder-1/pair/test#3").seed),
        ("clutter", 0), ("custom", 4)]
    assert len(instances[1].targets) == 3 and [i.horizon for i in instances[4:]] == [50, 60]
    assert [place.name for place in grid.make_places()][:4] == [
        "clutter#2", "larg-2019(size=3)", "paper-one-button", "ladder-1/pair/test#3"]
    assert grid.agents[1].resolve_settings()["gamma"] == 0.999


@pytest.mark.parametrize(("room", "text"), [
    ('{ preset = "clutter", seed = 3 }', "clutter#3"), ('{ set = "ladder-1/pair/test[3]" }', "ladder-1/pair/test#3"),
    ('{ file = "room.json" }', "room.json"),
    ('{ preset = "larg-2019", arguments = { size = 4 }, seed = 2 }', r"larg-2019\(size=4\)#2"),
    ('"ladder-1/pair/test[3]"', "ladder-1/pair/test#3")])
def test_a_room_of_a_grid_of_version_0_3_is_refused_with_its_new_form(tmp_path: Path, room: str, text: str):
    (tmp_path / "old.toml").write_text(f"format = 2\nrooms = [{room}]")
    with pytest.raises(GridError, match=f"write '?{text}"):
        load_grid(tmp_path / "old.toml")


def test_rooms_of_a_grid_are_texts_in_python_too():
    assert Grid(rooms=("clutter#3",)) == Grid(rooms=(RoomSpec("clutter#3"),))


@pytest.mark.nightly_for("ladder")
@pytest.mark.parametrize("grid", [*GRIDS.values(), SMALL], ids=lambda grid: grid.name)
def test_a_grid_survives_json_and_makes_all_its_runs(grid: Grid):
    assert Grid.from_dict(grid.to_dict()) == grid
    runs = make_runs(grid)
    assert len(runs) == len(grid.agents) * len(grid.rooms) * grid.runs
    assert len({run.folder for run in runs}) == len({run.key for run in runs}) == len(runs)


def test_every_agent_meets_the_same_evaluation_episodes_and_each_seed_others():
    seeds = {(run.seed, run.eval_seed) for run in make_runs(SMALL)}
    assert len(seeds) == SMALL.runs == len({eval_seed for _, eval_seed in seeds})


def test_runs_come_seed_by_seed_so_that_early_results_compare_everybody():
    runs = make_runs(SMALL)
    assert [run.agent.label for run in runs[:4]] == [agent.label for agent in SMALL.agents]
    assert [run.seed for run in runs] == [0] * 4 + [1] * 4


# --- which runs are the same -----------------------------------------------------------


def find_key(**changes: object) -> str:
    return make_runs(change(**changes))[0].key


def test_a_runs_key_depends_on_what_decides_its_numbers_and_on_nothing_else():
    plain = find_key(agents=["smdp-dqn"])
    same = [
        find_key(agents=[AgentSpec("smdp-dqn", label="other")]),
        find_key(agents=["smdp-dqn", "dqn"]),
        find_key(agents=["smdp-dqn"], runs=7, name="other", description="words"),
        find_key(agents=[AgentSpec("smdp-dqn", settings={"gamma": 0.99})]),  # its default
    ]
    different = [
        find_key(agents=["dqn"]),
        find_key(agents=["smdp-dqn@keras-rl-2019"]),
        find_key(agents=[AgentSpec("smdp-dqn", settings={"gamma": 0.9})]),
        find_key(agents=["smdp-dqn+primitives"]),
        find_key(agents=["smdp-dqn"], rooms=["paper-two-button"]),
        find_key(agents=["smdp-dqn"], primitives=601),
        find_key(agents=["smdp-dqn"], decisions=300),
        find_key(agents=["smdp-dqn"], eval_every=100),
        find_key(agents=["smdp-dqn"], eval_episodes=4),
        find_key(agents=["smdp-dqn"], eval_seed=1),
        find_key(agents=["smdp-dqn"], observation="state"),
    ]
    assert set(same) == {plain}
    assert len({plain, *different}) == 1 + len(different)


def test_options_say_nothing_about_a_flat_agent():
    assert find_key(agents=["dqn"]) == find_key(agents=[AgentSpec("dqn", options=OptionsView(max_duration=3))])


# --- refusing --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"agents": ()}, "has no agents"),
        ({"rooms": ()}, "has no rooms"),
        ({"agents": ["dqn", "dqn"]}, "same agent label twice: dqn"),
        ({"agents": ["dqn", AgentSpec("dqn", label="twin")]}, "same agent with the same settings twice"),
        ({"rooms": ["clutter", "clutter#0"]}, "same room twice"),
        ({"agents": ["dqqn"]}, "did you mean 'dqn'"),
        ({"agents": ["dqn@patint"]}, "did you mean 'patient'"),
        ({"agents": [AgentSpec("dqn", settings={"gama": 1})]}, "did you mean 'gamma'"),
        ({"agents": [AgentSpec("dqn", settings={"gamma": 2})]}, r"gamma = 2 is not possible.*from 0 to 1"),
        ({"rooms": ["cluter"]}, "did you mean 'clutter'"),
        ({"rooms": ["clutter#x"]}, "after # write the number"),
        ({"runs": 0}, "grid.runs = 0 is not possible"),
        ({"primitives": "many"}, "grid.primitives = 'many' is not possible: a whole number"),
    ],
)
def test_an_impossible_grid_is_refused_with_its_reason(changes: dict, message: str):
    with pytest.raises(EscapeError, match=message):
        make_runs(change(**changes))


@pytest.mark.parametrize(("name", "message"), [
    ("dqqn", "unknown agent 'dqqn'; did you mean 'dqn'"), ("search-randm", "did you mean 'search-random'"),
    ("", "dqn")])
def test_an_unknown_agent_is_refused_where_it_is_named(name: str, message: str):
    for make in (lambda: AgentSpec(name), lambda: Grid(agents=(AgentSpec.parse(name),)),
                 lambda: Grid.from_dict({"agents": [name]})):
        with pytest.raises(UnknownNameError, match=message):
            make()
    assert AgentSpec("smdp-iql").name == "smdp-iql", "an agent that learns from data is one too"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("runs = ", "mine.toml: .*TOML"),
        ("run = 3", "mine.toml: unknown grid field .run.; did you mean .runs."),
        ('rooms = [{ room = "clutter", config = { horizon = 50 } }]', "a room is a text such as 'clutter#3'"),
        ('agents = [{ nam = "dqn" }]', "unknown agent field .nam.; did you mean .name."),
    ],
)
def test_a_file_that_is_no_grid_is_refused_by_name(tmp_path: Path, text: str, message: str):
    (tmp_path / "mine.toml").write_text(f"format = 2\n{text}")
    with pytest.raises((GridError, FileReadError), match=message):
        load_grid(tmp_path / "mine.toml")


def test_a_grid_of_version_0_3_is_refused_with_the_command_that_converts_it(tmp_path: Path):
    """`smdp-dqn` also chose primitives there, and its text does not say so."""
    (tmp_path / "mine.toml").write_text('agents = ["smdp-dqn"]')
    with pytest.raises(GridError, match=f"hrl-escape convert {tmp_path / 'mine.toml'}"):
        load_grid(tmp_path / "mine.toml")


def test_agents_of_a_grid_are_specs_texts_classes_or_tables():
    spec = AgentSpec.parse("q-learning(gamma=0.9)")
    grid = Grid(agents=("smdp-dqn", QLearning, spec, {"name": "smdp-ppo", "label": "mine"}))
    assert [agent.label for agent in grid.agents] == ["smdp-dqn", "q-learning", "q-learning(gamma=0.9)", "mine"]


def test_a_missing_file_and_an_unknown_name_are_told():
    with pytest.raises(FileReadError, match="no such grid"):
        load_grid("nowhere.toml")
    with pytest.raises(UnknownNameError, match="did you mean 'ladder'"):
        get_grid("lader")


def test_rooms_of_one_name_are_told_apart():
    other = RoomSpec(config=dataclasses.replace(get_preset("clutter"), horizon=50).to_dict())
    names = {run.room for run in make_runs(change(rooms=["clutter", "clutter#1", other]))}
    assert len(names) == 3 and "clutter#1" in names


def test_another_version_of_a_library_is_another_run(monkeypatch):
    places = SMALL.make_places()
    before = SMALL.make_runs(places)[0].key
    assert SMALL.make_runs(places)[0].key == before
    monkeypatch.setattr("hrl_escape.benchmark.grid.find_versions", lambda: {"torch": "99"})
    assert SMALL.make_runs(places)[0].key != before


# --- hierarchies that are synthesised ----------------------------------------------------------


def test_an_agent_with_a_synthesised_hierarchy_is_short_text_and_its_privileges_are_known():
    spec = AgentSpec.parse("maxq-q+planned")
    assert (spec.label, spec.low_level) == ("maxq-q+planned", "planned")
    assert spec.privileges == ("task graph", "state", "planner")
    assert AgentSpec.parse("hamq+learned").privileges == ("program", "state")
    assert AgentSpec.parse("dqn").privileges == ()
    with pytest.raises(EscapeError, match="planned.*learned"):
        AgentSpec.parse("maxq-q+plans")
    with pytest.raises(EscapeError, match="no hierarchy is synthesised for dqn, but for .*maxq-q"):
        AgentSpec.parse("dqn+planned").resolve_settings()
    with pytest.raises(EscapeError, match="chooses options.*take maxq-q"):
        AgentSpec.parse("smdp-maxq-q+planned").resolve_settings()


def test_leaves_tell_runs_apart_and_change_no_key_of_others():
    grid = Grid(agents=tuple(map(AgentSpec.parse, ("maxq-q", "maxq-q+planned", "maxq-q+learned"))), runs=1)
    flat, planned, learned = (run.identity for run in make_runs(grid))
    assert "low_level" not in flat and (planned["low_level"], learned["low_level"]) == ("planned", "learned")
