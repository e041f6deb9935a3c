"""Environments from elsewhere are compared as rooms are: same runs, seeds, tests and report, without a best return."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

from hrl_escape import OptionsEnv, train
from hrl_escape.agents import FrozenAgent
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.registry import agents
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.env_spec import EnvSpec
from hrl_escape.benchmark.grid import Grid, load_grid
from hrl_escape.benchmark.measures import RETURN, SUCCESS
from hrl_escape.benchmark.reporting.report import write_report
from hrl_escape.benchmark.summary import summarise
from hrl_escape.benchmark.verdict import write_verdict
from hrl_escape.cli import main
from hrl_escape.errors import ComparisonError, GridError
from hrl_escape.options import FunctionOption
from tests.benchmark.small import OneProcess, run_quietly

END = 9


class Walk(gymnasium.Env):
    """A line of ten cells; each step costs 1, and the right end is the goal."""

    action_space = gymnasium.spaces.Discrete(2)
    observation_space = gymnasium.spaces.Discrete(END + 1)

    def __init__(self, reports: bool = False) -> None:
        self.reports = reports
        self.place = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = int(self.np_random.integers(4))
        return self.place, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.place = int(np.clip(self.place + (1 if action else -1), 0, END))
        done = self.place == END
        return self.place, -1.0, done, False, {"is_success": done} if self.reports else {}


def make_walk(reports: bool = False) -> gymnasium.Env:
    return TimeLimit(Walk(reports), 30)


def make_options(env: gymnasium.Env) -> list[FunctionOption]:
    return [FunctionOption("to-the-end", lambda state: 1, lambda state: float(state == END))]


def make_grid(*names: Any, runs: int = 2, primitives: int = 300, **env: Any) -> Grid:
    return Grid("walks", agents=names, env=EnvSpec.make(**({"env": make_walk} | env)), runs=runs,
                primitives=primitives, eval_every=100, eval_episodes=2)


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    grid = make_grid("q-learning", "smdp-q-learning", "random-options", options=make_options, reference=-6.0)
    return run_quietly(grid, tmp_path_factory.mktemp("walks"), OneProcess())


def test_runs_are_those_of_train_with_the_same_seeds(comparison: Comparison):
    for run, result in comparison.runs:
        env: gymnasium.Env = make_walk()
        if run.agent.chooses_options:
            env = OptionsEnv(env, make_options, include_primitives=False)
        alone = train(run.agent.name, env, primitives=300, seed=run.seed, eval_every=100, eval_episodes=2,
                      eval_seed=run.seed, progress=False)
        assert result.evaluations == alone.evaluations and result.primitives == alone.primitives
    assert [run.seed for run, _ in comparison.runs] == [0, 0, 0, 1, 1, 1]


def test_without_a_known_optimum_agents_are_compared_by_their_returns(comparison: Comparison):
    summary = summarise(comparison)
    assert summary.measure is RETURN
    for number, agent in enumerate(summary.agents):
        finals = [result.get_final("mean_return") for run, result in comparison.runs if run.number == number]
        assert agent.primary.value == agent.returns.value == pytest.approx(np.mean(finals))
        assert agent.primaries[0].tolist() == finals and np.isnan(agent.efficiency.value)
        assert agent.curve.metrics["return"][0][-1] == pytest.approx(np.mean(
            [result.evaluations[-1].mean_return for run, result in comparison.runs if run.number == number]))
    said = " ".join(sentence.text for sentence in write_verdict(summary))
    assert "Two runs are too few for a verdict" in said and "over training seeds in make_walk alone" in said
    assert "The reference return is -6; `" in said and not re.search("escape|room|efficiency", said)


def test_the_report_is_that_of_rooms_without_their_parts(comparison: Comparison, tmp_path: Path):
    write_report(comparison, "compare(...)", tmp_path)
    page = (tmp_path / "report.html").read_text()
    said = "Intervals are over training seeds in make_walk alone."
    assert said in page and said in (tmp_path / "summary.md").read_text() and "two-way" not in page
    assert 'id="replays"' not in page and 'id="rooms"' not in page and "Student" in page and page.count("<tr") > 6
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1].replace("\\u003c", "<"))  # type: ignore[index]
    assert data["rooms"] == [] and len(data["agents"][0]["curve"]["return"]) == 3
    with open(tmp_path / "results.csv") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["return"]) for row in rows] == [result.get_final("mean_return") for _, result in comparison.runs]
    assert {row["efficiency"] + row["best"] for row in rows} == {""}
    assert (tmp_path / "figures/return-against-decisions.svg").exists()


def test_ten_seeds_give_a_verdict_by_corrected_tests(tmp_path: Path):
    right, back = FrozenAgent(lambda place: 1, "right"), FrozenAgent(lambda place, mask: np.array([place < 5]), "back")
    try:
        summary = summarise(run_quietly(make_grid(right, back, "random", runs=10), tmp_path, OneProcess()))
        headline = write_verdict(summary)[0].text
        assert headline.startswith("`right` is best: it has a return of -7")
        assert summary.agents[1].primary == (-30, -30, -30) and summary.agents[0].decisions == 0  # never trained
        assert summary.pairs[0][1].p < 0.05 and summary.pairs[0][1].difference.value > 20  # beyond the scale of scores
    finally:
        agents.unregister("right")
        agents.unregister("back")


def test_success_counts_where_every_episode_reports_it(tmp_path: Path):
    grid = make_grid("random", arguments={"reports": True}, runs=1, primitives=60)
    assert summarise(run_quietly(grid, tmp_path / "a", OneProcess())).measure is SUCCESS
    with pytest.raises(ComparisonError, match="make_walk reports no success"):
        summarise(run_quietly(make_grid("random", score="success", runs=1, primitives=60), tmp_path / "b",
                              OneProcess()))


def test_changed_code_makes_other_runs_and_equal_code_the_same(tmp_path: Path):
    def find_key(length: int, step: int = 1, **env: Any) -> str:
        options = [FunctionOption("go", lambda state: step, lambda state: 1.0)]
        grid = make_grid("random-options", env=lambda: TimeLimit(Walk(), length), options=lambda env: options)
        return grid.make_runs(grid.make_places())[0].key

    assert find_key(30) == find_key(30) != find_key(20)

    def find_agent_key(rate: float) -> str:
        kind = type("Changed", (QLearning,), {"__module__": __name__, "compute_rate": lambda self: rate})
        grid = make_grid(kind)
        return grid.make_runs(grid.make_places())[0].key

    try:
        assert find_agent_key(0.1) == find_agent_key(0.1) != find_agent_key(0.2)
    finally:
        agents.unregister("Changed")


@pytest.mark.parametrize(("names", "env", "says"), [
    (["smdp-q-learning"], {}, "make_walk has none: give options="),
    (["oracle"], {}, "oracle needs a room"),
    (["maxq-q+planned"], {}, "needs a room, because its hierarchy"),
    (["smdp-dqn+reactive"], {"options": make_options}, "give the options of make_walk"),
    (["random"], {"env": make_walk()}, "give a function that makes it"),
    (["random"], {"env": "NoSuchThing-v0"}, "NoSuchThing-v0 cannot be made"),
    (["random"], {"env": "nowhere.py:make"}, "nowhere.py"),
    (["random"], {"env": f"{__file__}:absent"}, "has no absent; it has"),
    (["random"], {"env": lambda: 3}, "made 3, which is not a gymnasium.Env"),
    (["smdp-q-learning"], {"options": lambda env: 1 / 0}, "cannot be made: ZeroDivisionError: division by zero"),
    (["smdp-q-learning"], {"options": lambda: []}, "cannot be made: TypeError"),
])
def test_what_cannot_be_compared_is_refused_before_any_run(names: list[str], env: dict[str, Any], says: str):
    with pytest.raises(Exception, match=re.escape(says)) as refused:
        make_grid(*names, **env).make_places()
    assert type(refused.value).__module__ == "hrl_escape.errors"


def test_a_script_that_ends_itself_is_refused(tmp_path: Path):
    (tmp_path / "script.py").write_text("import sys\nsys.exit(0)\n")
    with pytest.raises(GridError, match=r"script\.py cannot be loaded: SystemExit: 0"):
        make_grid("random", env=f"{tmp_path / 'script.py'}:make").make_places()


def test_a_grid_of_an_environment_is_read_from_its_file(tmp_path: Path):
    grid = make_grid("random", env="CartPole-v1", reference=500)
    (tmp_path / "grid.json").write_text(json.dumps(grid.to_dict()))
    assert load_grid(tmp_path / "grid.json") == grid
    with pytest.raises(GridError, match="does not go with rooms"):
        Grid("both", agents=("random",), rooms=("clutter",), env=EnvSpec("CartPole-v1"))


@pytest.mark.nightly
def test_the_command_compares_in_an_environment_and_options_of_a_file(tmp_path: Path, capsys: Any):
    assert main(["compare", "--env", f"{__file__}:make_walk", "--options", f"{__file__}:make_options", "--agents",
                 "q-learning", "smdp-q-learning", "--runs", "1", "--primitives", "120", "--out", str(tmp_path),
                 "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["measure"] == "return" and found["agents"][1]["primary"]["value"] > -10
    assert found["agents"][0]["efficiency"]["value"] is None
    assert main(["compare", "--env", "CartPole-v1", "--room", "clutter"]) != 0


SCRIPT = """
import sys
from hrl_escape import compare
from hrl_escape.agents import AgentSpec
from hrl_escape.agents.algorithms.q_learning import QLearning

class MyAgent(QLearning):
    def observe(self, transition):
        return super().observe(transition)

if __name__ == "__main__":
    AgentSpec.parse(MyAgent)
    result = compare(["random-options", MyAgent, "smdp-MyAgent"], room=["ladder-1/pair/test#0"], seeds=3,
                     primitives=1_500, eval_every=500, eval_episodes=1, out=sys.argv[1], workers=1)
    result.report(sys.argv[2])
"""


@pytest.mark.nightly
def test_an_own_agent_of_a_script_on_a_rung_is_killed_at_half_and_resumed(tmp_path: Path):
    script = tmp_path / "mine.py"
    script.write_text(SCRIPT)

    def start(out: str) -> subprocess.Popen[str]:
        return subprocess.Popen([sys.executable, str(script), str(tmp_path / out), str(tmp_path / f"{out}-report")],
                                stderr=subprocess.PIPE, text=True, start_new_session=True)

    def list_results() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in (tmp_path / "cut").glob("runs/*/run_result.json")}

    killed = start("cut")
    until = time.monotonic() + 600
    while len(list_results()) < 4 and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    before = list_results()
    assert 4 <= len(before) < 9
    for out in ("cut", "whole"):
        run = start(out)
        assert run.wait(600) == 0, run.communicate()[1]
    after = list_results()
    assert len(after) == 9 and {path: after[path] for path in before} == before
    for table in ("results.csv", "curves.csv"):
        assert (tmp_path / "cut-report" / table).read_text() == (tmp_path / "whole-report" / table).read_text()
    assert "MyAgent" in (tmp_path / "cut-report/summary.md").read_text()
