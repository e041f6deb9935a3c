"""Trained agents that come with the package; each replays its test rooms to the published results."""

from __future__ import annotations

import dataclasses
import tempfile
from contextlib import closing
from importlib.resources import files
from pathlib import Path

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.archive import unpack_run
from hrl_escape.agents.training.results import TrainResult, load_result
from hrl_escape.agents.training.train import load_agent
from hrl_escape.benchmark.agent_archive import (
    RUN,
    AgentArchive,
    AgentCard,
    RoomResult,
    describe_score,
    find_rung,
    read_archive,
    score_results,
)
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.replay import CheckedResult, make_view_env, replay
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import CheckpointError, UnknownNameError, show_value
from hrl_escape.sets.rung import Rung

_FOLDER = Path(str(files("hrl_escape.benchmark") / "data" / "pretrained"))


@dataclasses.dataclass(frozen=True, repr=False)
class Pretrained:
    """Trained agent with its card, learning curve and results room by room.

    Attributes:
        agent: acts with frozen weights.
        result: training that made it; `result.plot()` draws its learning curve.
        card: authors, training command and costs.
        results: published result in each test room.
        rung: the rung it was tested on.
        path: its archive.
    """

    agent: Agent
    result: TrainResult
    card: AgentCard
    results: tuple[RoomResult, ...]
    rung: Rung
    path: Path

    def __repr__(self) -> str:
        return f"<Pretrained {self.card.name}: {describe_score(self.results, self.rung)}>"

    @property
    def score(self) -> Estimate:
        """Published efficiency in the test rooms, with its interval."""
        return score_results(self.results, self.rung.config.dynamics.is_random)

    def make_env(self, role: str = "test") -> gymnasium.Env:
        """Make an environment over a set of the rung, with the agent's observation and actions.

        Args:
            role: `train`, `valid`, `test` or, if the rung has one, `test_task`.
        """
        return make_view_env(self.card.view, self.rung.sets[role])[0]

    def verify(self, rooms: int = 5, seed: int = 0) -> list[CheckedResult]:
        """Play some test rooms again and compare the results with the published ones.

        Args:
            rooms: number of rooms.
            seed: of the draw of rooms.
        """
        return verify_archive(self.path, rooms, seed)


def list_pretrained() -> dict[str, tuple[str, ...]]:
    """Return the rungs with pretrained agents, such as `ladder-1/chain`, and the specs of these agents."""
    found: dict[str, tuple[str, ...]] = {}
    for path in sorted(_FOLDER.glob("*/*/*.zip")):
        rung = f"{path.parent.parent.name}/{path.parent.name}"
        found[rung] = (*found.get(rung, ()), path.stem)
    return found


def load_pretrained(rung: str, agent: str | AgentSpec | type[Agent] = "") -> Pretrained:
    """Load a trained agent that comes with the package.

    Args:
        rung: benchmark and rung, such as `ladder-1/chain`.
        agent: spec of the agent, such as `smdp-ppo+objects+memory`; the rung's first one by default.

    Raises:
        UnknownNameError: no such agent; the message lists the agents of the rung.
    """
    path = find_pretrained(rung, str(AgentSpec.parse(agent)) if agent else "")
    with tempfile.TemporaryDirectory() as made:
        archive, run = open_archive(path, Path(made))
        found = find_rung(archive.card)
        with closing(make_view_env(archive.card.view, found.test)[0]) as env:
            loaded = load_agent(run, env)
        return Pretrained(loaded, load_result(run), archive.card, archive.results, found, path)


def unpack_pretrained(rung: str, folder: Path) -> tuple[Path, RoomInstance]:
    """Write the run of a rung's first agent to an empty folder; returns the run's folder and the first test room."""
    archive, run = open_archive(find_pretrained(rung), folder)
    return run, find_rung(archive.card).test[0]


def find_pretrained(rung: str, agent: str = "") -> Path:
    """Return the archive of a trained agent that comes with the package.

    Args:
        rung: benchmark and rung.
        agent: spec of the agent; the rung's first one by default.

    Raises:
        UnknownNameError: no such agent.
    """
    known = list_pretrained()
    if rung not in known:
        raise UnknownNameError("rung with a pretrained agent", rung, known)
    if agent not in ("", *known[rung]):
        raise UnknownNameError(f"pretrained agent on {rung}", agent, known[rung])
    return _FOLDER / rung / f"{agent or known[rung][0]}.zip"


def open_archive(path: Path, folder: Path) -> tuple[AgentArchive, Path]:
    """Unpack an archive into an empty folder; returns card with results, and the folder of the run.

    Raises:
        CheckpointError: the archive is damaged, or its run trained another agent than its card names.
    """
    archive = read_archive(path, folder)
    name = unpack_run(folder / RUN, folder / "run").described.get("name")
    if name != archive.card.agent:
        raise CheckpointError(f"{path}: the card names the agent {show_value(archive.card.agent)}, but the run trained "
                              f"{show_value(name)}")
    return archive, folder / "run"


def verify_archive(path: Path, rooms: int, seed: int, manifest: str = "") -> list[CheckedResult]:
    """Play some rooms of an archive again; see `replay`.

    Args:
        path: the archive.
        rooms: number of rooms.
        seed: of the draw of rooms.
        manifest: file of a benchmark that does not come with the package.
    """
    with tempfile.TemporaryDirectory() as made:
        archive, run = open_archive(path, Path(made))
        test = find_rung(archive.card, manifest).test
        return replay(archive.results, archive.card.view, test, rooms, seed, lambda env, recorder: load_agent(run, env))
