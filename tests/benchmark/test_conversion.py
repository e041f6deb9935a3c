"""Files that version 0.3 wrote, in `tests/data/version-0.3`: refused as they are, and as good as before converted."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from hrl_escape.agents import load_agent, load_env, load_result, unpack_run
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.benchmark.agent_archive import read_archive
from hrl_escape.benchmark.conversion import convert_file, convert_label, convert_text
from hrl_escape.benchmark.grid import load_grid
from hrl_escape.cli import main
from hrl_escape.errors import CheckpointError, FileReadError, GridError, UnsupportedError
from hrl_escape.options.options_env import OptionsEnv

OLD = Path(__file__).parents[1] / "data" / "version-0.3"
PLAYED = json.loads((OLD / "expected.json").read_text())
"""What version 0.3 itself measured with these agents."""


def extract(name: str, folder: Path) -> Path:
    """The folder of a run as version 0.3 left it."""
    with zipfile.ZipFile(OLD / f"{name}.zip") as archive:
        archive.extractall(folder, [member for member in archive.namelist() if member != "manifest.json"])
    return folder


@pytest.mark.parametrize(("name", "agent", "has_primitives"), [
    ("smdp-q-learning", "smdp-q-learning", True),
    ("smdp-random+no-primitives", "random-options", False),
    ("maxq-q+planned", "maxq-q", None),
])
def test_a_run_of_version_0_3_is_refused_and_plays_as_before_once_converted(
        tmp_path: Path, name: str, agent: str, has_primitives: bool | None):
    old = extract(name, tmp_path / "old")
    with pytest.raises(CheckpointError, match=f"hrl-escape convert {old}"):
        load_agent(old)
    with pytest.raises(CheckpointError, match=r"hrl-escape convert .*\.zip"):
        unpack_run(OLD / f"{name}.zip", tmp_path / "unpacked")
    assert convert_file(old, tmp_path / "new") == f"the run of {agent}, seed 0"
    convert_file(OLD / f"{name}.zip", tmp_path / "new.zip")
    unpack_run(tmp_path / "new.zip", tmp_path / "again")
    for folder in (tmp_path / "new", tmp_path / "again"):
        env = load_env(folder)
        found = evaluate(load_agent(folder, env), env, 3)
        assert {"returns": [*found.returns], "lengths": [*found.lengths], "actions": env.action_space.n} == PLAYED[name]
        result = load_result(folder)
        assert result.agent_name == agent and result.evaluations
        assert not isinstance(env, OptionsEnv) or (env.primitive_count > 0) == has_primitives
    assert {path.name for path in (tmp_path / "new").iterdir()} >= {"checkpoint.npz", "best.npz", "log.jsonl"}
    with pytest.raises(UnsupportedError, match="of format 3"):
        convert_file(tmp_path / "new", tmp_path / "twice")


def test_a_pretrained_agent_of_version_0_3_is_converted_with_its_card(tmp_path: Path):
    (tmp_path / "old").mkdir()
    with pytest.raises(CheckpointError, match="hrl-escape convert"):
        read_archive(OLD / "pretrained.zip", tmp_path / "old")
    with zipfile.ZipFile(OLD / "pretrained.zip") as archive:
        archive.extract("run.zip", tmp_path / "old")
    with pytest.raises(CheckpointError, match="hrl-escape convert"):
        unpack_run(tmp_path / "old" / "run.zip", tmp_path / "run")
    convert_file(OLD / "pretrained.zip", tmp_path / "new.zip")
    (tmp_path / "parts").mkdir()
    found = read_archive(tmp_path / "new.zip", tmp_path / "parts")
    assert found.card.name == "smdp-q-learning" and "ladder run smdp-q-learning " in found.card.training
    assert len(found.results) == found.card.rooms
    unpack_run(tmp_path / "parts" / "run.zip", tmp_path / "run")
    assert load_agent(tmp_path / "run").name == "q-learning"


def test_a_grid_of_version_0_3_is_refused_and_keeps_its_agents_once_converted(tmp_path: Path):
    for name in ("grid.toml", "grid.json"):
        with pytest.raises(GridError, match="hrl-escape convert"):
            load_grid(OLD / name)
        convert_file(OLD / name, tmp_path / name)
    assert (tmp_path / "grid.toml").read_text().startswith("# Does gamma matter?\nformat = 2\n")
    assert '\n    "dqn@patient",\n' in (tmp_path / "grid.toml").read_text(), "each agent has a line"
    grid = load_grid(tmp_path / "grid.toml")
    assert (grid.primitives, grid.runs) == (500, 3)
    assert [room.label for room in grid.rooms] == ["clutter#2", "larg-2019(size=3)"]
    assert [(agent.label, str(agent)) for agent in grid.agents] == [
        ("random-options+primitives", "random-options+primitives"), ("dqn@patient", "dqn@patient"),
        ("smdp-q-learning+reactive", "smdp-q-learning+reactive"), ("oracle", "oracle"),
        ("far-sighted", "smdp-dqn(gamma=0.999)+primitives"), ("no primitives", "smdp-dqn"), ("search", "search-random"),
        ("hamq+learned", "hamq+learned"), ("text-agent(model=search-random,reveal=names)",) * 2]
    assert [room.label for room in load_grid(tmp_path / "grid.json").rooms] == ["paper-two-button"]
    assert [agent.label for agent in load_grid(tmp_path / "grid.json").agents] == [
        "smdp-dqn+primitives", "smdp-dqn", "search-nearest", "dqn@keras-rl-2019", "maxq-q+planned", "far"]
    assert load_grid(tmp_path / "grid.json").agents[-1] == AgentSpec(
        "smdp-dqn", settings={"gamma": 0.999}, options=OptionsView(include_primitives=True))


def test_the_command_converts_beside_the_file_and_leaves_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "grid.toml"
    path.write_bytes((OLD / "grid.toml").read_bytes())
    assert main(["convert", str(path)]) in (0, None)
    assert "grid-converted.toml" in capsys.readouterr().out
    assert path.read_bytes() == (OLD / "grid.toml").read_bytes() and load_grid(tmp_path / "grid-converted.toml")
    assert main(["convert", str(path)]) == 2 and "is there already" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "content", "error", "words"), [
    ("game.jsonl", "{}", UnsupportedError, "convert takes"),
    ("room.json", '{"config": {}}', UnsupportedError, "not a grid"),
    ("odd.zip", "text", FileReadError, "no archive"),
    ("notes.txt", "text", UnsupportedError, "convert takes"),
    ("new.toml", "format = 2\nagents = []", UnsupportedError, "format 2 already"),
    ("solved.toml", 'agents = ["random"]\nuntil_solved = { score = 0.9 }', UnsupportedError, "no until_solved"),
])
def test_what_holds_nothing_to_convert_is_refused(tmp_path: Path, name: str, content: str, error: type, words: str):
    (tmp_path / name).write_text(content)
    with pytest.raises(error, match=words):
        convert_file(tmp_path / name, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_comparison_is_run_again(tmp_path: Path):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "grid.json").write_bytes((OLD / "grid.json").read_bytes())
    with pytest.raises(UnsupportedError, match=r"Convert .*grid\.json and run it"):
        convert_file(tmp_path / "old", tmp_path / "new")


def test_commands_in_text_are_converted_word_by_word():
    said = "hrl-escape ladder run smdp-dqn smdp-ppo+objects+memory+no-primitives --rung pair, see smdp_notes"
    assert convert_text(said) == ("hrl-escape ladder run smdp-dqn+primitives smdp-ppo+objects+memory --rung pair, see "
                                  "smdp_notes")
    assert convert_label("smdp-dqn", chooses_primitives=False) == "smdp-dqn"
