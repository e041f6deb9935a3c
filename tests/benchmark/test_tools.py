"""The agent that calls tools stands in comparisons as the search baselines do: the same rooms, episodes and scores."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env, make_player
from hrl_escape.benchmark.protocols import LadderSettings, make_protocol_grid, make_sequence_grid
from hrl_escape.benchmark.summary import summarise
from hrl_escape.cli import main
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.text import record_game, save_games
from hrl_escape.text.text_env import find_text_env
from tests.benchmark.small import run_quietly
from tests.text.rooms import get_room, play_manager

UNTRIED = AgentSpec(name="text-agent", label="text", settings={"model": "search-random", "reveal": "names"})


@pytest.mark.nightly
def test_it_scores_what_the_search_baseline_scores_whose_choices_it_makes():
    found = []
    for spec in (AgentSpec("search-random"), UNTRIED, AgentSpec("text-agent", settings={"model": "random"})):
        env, recorder = make_agent_env(spec, get_room("chain-3"), "features")
        found.append(evaluate(make_player(spec, env, recorder), env, episodes=5))
    baseline, text, chance = found
    assert text == baseline != chance and text.success_rate == 1.0


@pytest.mark.slow
def test_a_ladder_takes_it_and_reports_it_as_a_reference(tmp_path: Path):
    told_all = AgentSpec("text-agent", settings={"model": "oracle", "reveal": "model"})
    agents = (AgentSpec("search-random"), UNTRIED, told_all)
    for protocol in ("generalise", "per-instance"):
        grid = make_protocol_grid(load_benchmark("ladder-1"), "chain-3", protocol, agents,
                                  LadderSettings(1, 500, 2, (2,), 2))
        baseline, text, planner = summarise(run_quietly(grid, tmp_path / protocol)).agents
        assert [*map(list, baseline.efficiencies)] == [*map(list, text.efficiencies)]
        assert text.success.value == 1.0 and planner.efficiency.value > text.efficiency.value


def test_settings_are_checked_and_decide_the_key(tmp_path: Path):
    with pytest.raises(UnknownNameError, match="models"):
        AgentSpec(name="text-agent", settings={"models": "search-random"}).resolve_settings()
    with pytest.raises(ConfigError, match="reveal"):
        AgentSpec(name="text-agent", settings={"reveal": "all"}).resolve_settings()
    with pytest.raises(FileReadError, match="mine.jsonl"):
        AgentSpec(name="text-agent", settings={"model": str(tmp_path / "mine.jsonl")}).resolve_settings()
    spec = AgentSpec(name="text-agent", settings={"model": str(tmp_path / "mine.jsonl")})
    found = []
    for seed in (1, 2):
        save_games(tmp_path / "mine.jsonl", [record_game(play_manager("random", get_room("pair"), seed, "names")[1])])
        found.append(spec.resolve_settings())
    assert found[0]["recorded"] != found[1]["recorded"] and spec.is_reference and not spec.learns


def test_a_sequence_is_refused():
    with pytest.raises(ConfigError, match="text-agent|text"):
        make_sequence_grid(load_benchmark("ladder-1"), ("pair", "chain"), (UNTRIED,), LadderSettings())


def test_train_takes_it_and_tells_runs_of_different_callers_apart(tmp_path: Path):
    room, keys = get_room("pair"), set()
    for model, told in (("search-random", "names"), ("search-random", "places"), ("random", "names")):
        spec = AgentSpec(name="text-agent", settings={"model": model, "reveal": told})
        env, recorder = make_agent_env(spec, room, "features")
        player = make_player(spec, env, recorder)
        result = train(player, env, primitives=60, seed=1, eval_episodes=1, out=tmp_path / "run-{key}", progress=False)
        keys.add(result.folder)
        assert result.primitives >= 60 and find_text_env(env).transcript
    assert len(keys) == 3


def test_the_command_trains_and_lists_its_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["train", "text-agent", "--settings", "model=search-random", "reveal=names", "--primitives", "60",
                 "--eval-episodes", "1", "--out", str(tmp_path / "run")]) == 0
    assert "text-agent, seed 0" in capsys.readouterr().out
    assert main(["train", "text-agent", "--list-settings"]) == 0
    assert "search-nearest" in capsys.readouterr().out
