"""Trained agents that come with the package, each a submission: it plays its rooms again to the published score."""

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
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.submission import (
    RUN,
    Card,
    CheckedCell,
    Submission,
    describe_score,
    find_rung,
    make_view_env,
    read_submission,
    score_cells,
    verify_cells,
)
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import UnknownNameError
from hrl_escape.sets.rung import Rung

_FOLDER = Path(str(files("hrl_escape.benchmark") / "data" / "pretrained"))


@dataclasses.dataclass(frozen=True, repr=False)
class Pretrained:
    """A trained agent, with its card, its learning curve and its results room by room.

    Attributes:
        agent: acts with frozen weights.
        result: training that made it; `result.plot()` is its learning curve.
        submission: its card and results.
        rung: it was tested on.
        path: its file, which `hrl-escape ladder verify-submission` reads.
    """

    agent: Agent
    result: TrainResult
    submission: Submission
    rung: Rung
    path: Path

    def __repr__(self) -> str:
        return f"<Pretrained {self.card.name}: {describe_score(self.submission, self.rung)}>"

    @property
    def card(self) -> Card:
        """Authors, training command and costs."""
        return self.submission.entry.card

    @property
    def score(self) -> Estimate:
        """Published efficiency in the test rooms, with its interval."""
        return score_cells(self.submission.cells, self.rung.config.dynamics.is_random)

    def make_env(self, role: str = "test") -> gymnasium.Env:
        """Make an environment over a set of its rung, as the agent sees it: `train`, `valid`, `test`."""
        return make_view_env(self.card.view, self.rung.sets[role])[0]

    def verify(self, rooms: int = 5, seed: int = 0) -> list[CheckedCell]:
        """Play some test rooms again, beside what is published of them."""
        return verify_cells(self.path, self.rung, rooms, seed)


def list_pretrained() -> dict[str, tuple[str, ...]]:
    """Rungs with pretrained agents, such as `marks-1/told`, and the names of these agents."""
    found: dict[str, tuple[str, ...]] = {}
    for path in sorted(_FOLDER.glob("*/*/*.zip")):
        rung = f"{path.parent.parent.name}/{path.parent.name}"
        found[rung] = (*found.get(rung, ()), path.stem)
    return found


def load_pretrained(rung: str, agent: str | AgentSpec | type[Agent] = "") -> Pretrained:
    """Load a trained agent that comes with the package.

    Args:
        rung: benchmark and rung, such as `marks-1/told`.
        agent: its spec, as `hrl-escape ladder run` takes it, such as `smdp-ppo+objects+memory`; the rung's first one
            by default.

    Raises:
        UnknownNameError: there is none; the message names those that there are.
    """
    path = _find_pretrained(rung, str(AgentSpec.parse(agent)) if agent else "")
    with tempfile.TemporaryDirectory() as made:
        submission, run = _unpack(path, Path(made))
        found = find_rung(submission.entry)
        with closing(make_view_env(submission.entry.card.view, found.test)[0]) as env:
            loaded = load_agent(run, env)
        return Pretrained(loaded, load_result(run), submission, found, path)


def unpack_pretrained(rung: str, folder: Path) -> tuple[Path, RoomInstance]:
    """Write the run of a rung's first agent to an empty folder; returns the run's folder and the first test room."""
    submission, run = _unpack(_find_pretrained(rung), folder)
    return run, find_rung(submission.entry).test[0]


def _find_pretrained(rung: str, agent: str = "") -> Path:
    known = list_pretrained()
    if rung not in known:
        raise UnknownNameError("rung with a pretrained agent", rung, known)
    if agent not in ("", *known[rung]):
        raise UnknownNameError(f"pretrained agent on {rung}", agent, known[rung])
    return _FOLDER / rung / f"{agent or known[rung][0]}.zip"


def _unpack(path: Path, folder: Path) -> tuple[Submission, Path]:
    """Submission of a file, and the folder of its run."""
    submission = read_submission(path, folder)
    unpack_run(folder / RUN, folder / "run")
    return submission, folder / "run"
