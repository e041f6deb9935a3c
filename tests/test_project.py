"""What holds for the project as a whole: style, types, imports and their cost, randomness, versions."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.random_state import find_global_random_state

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "hrl_escape"


def run(command: str, *arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Runs a command of this Python's environment."""
    program = Path(sys.executable).with_name(command)
    environment = os.environ | {"PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    return subprocess.run([program, *arguments], cwd=cwd, env=environment, capture_output=True, text=True)


def assert_passes(command: str, *arguments: str, cwd: Path = ROOT) -> None:
    done = run(command, *arguments, cwd=cwd)
    assert done.returncode == 0, done.stdout + done.stderr


# --- style and types -------------------------------------------------------------------


def test_ruff_finds_nothing():
    assert_passes("ruff", "check", ".")


def test_pyright_finds_nothing():
    assert_passes("pyright", "--pythonpath", sys.executable)


# --- which way imports run -------------------------------------------------------------

LINT_IMPORTS = ("lint-imports", "--no-cache", "--no-logo", "--config", str(ROOT / "pyproject.toml"))

HOUSE = """
cli checks errors files experiments.report viewer.scene
agents.agent agents.networks agents.training agents.dqn agents.sarsa
options.option options.options_env options.navigation options.arm.model options.planner
env.settings env.config env.presets env.instance env.robot env.primitives env.geometry env.observations
env.puzzles.base env.puzzles.buttons env.puzzles.bit_flip
env.bullet_room env.bullet_scene env.bullet_physics
env.tensor_room env.rendering env.escape_room env.vector_env env.torchrl_env
""".split()

ALLOWED_IMPORTS = {
    "cli": "hrl_escape.experiments.report",
    "experiments.report": "hrl_escape.agents.training",
    "agents.dqn": "torchrl",
    "options.options_env": "hrl_escape.env.escape_room",
    "options.navigation": "ompl",
    "options.arm.model": "pinocchio",
    "env.escape_room": "hrl_escape.env.bullet_room",
    "env.vector_env": "gymnasium",
    "env.bullet_room": "pybullet",
    "env.puzzles.buttons": "hrl_escape.env.puzzles.base",
    "env.instance": "hrl_escape.env.puzzles.buttons",
}

FORBIDDEN_IMPORTS = [
    ("env.config", "hrl_escape.options.option", "errors <- env <- options"),
    ("errors", "hrl_escape.env.config", "errors <- env <- options"),
    ("options.option", "hrl_escape.agents.agent", "errors <- env <- options"),
    ("options.option", "hrl_escape.experiments.report", "errors <- env <- options"),
    ("viewer.scene", "hrl_escape.cli", "errors <- env <- options"),
    ("agents.dqn", "hrl_escape.env.config", "agents know neither env nor options"),
    ("env.geometry", "hrl_escape.env.bullet_room", "rules of a room"),
    ("env.tensor_room", "hrl_escape.env.bullet_room", "rules of a room"),
    ("env.bullet_room", "hrl_escape.env.escape_room", "rules of a room"),
    ("options.option", "hrl_escape.env.bullet_room", "options never touch the Bullet engine"),
    ("env.puzzles.bit_flip", "hrl_escape.env.puzzles.buttons", "puzzles do not import puzzles"),
    ("agents.dqn", "hrl_escape.agents.sarsa", "algorithms do not import algorithms"),
    ("env.bullet_room", "gymnasium", "within env, gymnasium only"),
    ("options.option", "pybullet", "pybullet only in"),
    ("options.planner", "ompl", "ompl only in"),
    ("options.planner", "pinocchio", "pinocchio and coal only in"),
    ("options.option", "torchrl", "torchrl only in"),
]


def write_house(folder: Path, imports: dict[str, str]) -> Path:
    """Writes a package with every planned module, empty but for the import given for it."""
    package = folder / "hrl_escape"
    for module in HOUSE:
        path = package.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"import {imports[module]}\n" if module in imports else "")
        (path.parent / "__init__.py").touch()
    return folder


def test_imports_run_one_way():
    assert_passes(*LINT_IMPORTS)


def test_import_contracts_allow_what_the_house_plan_allows(tmp_path: Path):
    assert_passes(*LINT_IMPORTS, cwd=write_house(tmp_path, ALLOWED_IMPORTS))


def test_import_contracts_find_a_cycle(tmp_path: Path):
    imports = {"env.robot": "hrl_escape.env.primitives", "env.primitives": "hrl_escape.env.robot"}
    assert "no cycles BROKEN" in run(*LINT_IMPORTS, cwd=write_house(tmp_path, imports)).stdout


@pytest.mark.parametrize(("importer", "imported", "contract"), FORBIDDEN_IMPORTS)
def test_import_contracts_find_a_planted_violation(
    tmp_path: Path, importer: str, imported: str, contract: str
):
    report = run(*LINT_IMPORTS, cwd=write_house(tmp_path, {importer: imported})).stdout
    broken = [line for line in report.splitlines() if line.endswith(" BROKEN")]
    assert len(broken) == 1 and broken[0].startswith(contract), report


# --- randomness ------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(ROOT)))
def test_module_uses_no_global_random_state(path: Path):
    assert find_global_random_state(path.read_text()) == []


@pytest.mark.parametrize(
    "source",
    [
        "import numpy as np\nnp.random.seed(0)",
        "import numpy as np\nx = np.random.uniform()",
        "import numpy as np\nrng = np.random.default_rng()",
        "import numpy.random as nr\nnr.shuffle(x)",
        "from numpy import random\nrandom.rand()",
        "from numpy.random import choice\nchoice(3)",
        "import random\nrandom.seed(0)",
        "import random\nrng = random.Random()",
        "from random import shuffle\nshuffle(x)",
        "def f():\n    import random as r\n    return r.random()",
        "import torch\ntorch.manual_seed(0)",
        "import torch\nx = torch.rand(3)",
        "import torch\nsampler = torch.randn",
        "import torch\ntorch.cuda.manual_seed_all(0)",
        "import torch\nwith torch.random.fork_rng():\n    pass",
        "from torch import randperm\nrandperm(3)",
        "from torch import nn\nnn.init.orthogonal_(w)",
        "import torch\ntorch.empty(3).uniform_(0, 1)",
    ],
)
def test_global_random_state_is_found(source: str):
    assert len(find_global_random_state(source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        "import numpy as np\ndef f(rng: np.random.Generator): return rng.random()",
        "import numpy as np\nrng = np.random.default_rng(np.random.SeedSequence(3))",
        "import numpy as np\nrng = np.random.Generator(np.random.Philox(key=3))",
        "import random\nrng = random.Random(3)\nrng.shuffle(x)",
        "import torch\ng = torch.Generator()\ng.manual_seed(3)\ntorch.rand(3, generator=g)",
        "from torch import nn\nnn.init.orthogonal_(w, generator=g)",
        "import torch\ntorch.empty(3).uniform_(0, 1, generator=g)",
        "def f(random): return random.choice(3)",
    ],
)
def test_random_streams_of_one_s_own_are_allowed(source: str):
    assert find_global_random_state(source) == []


# --- import cost -----------------------------------------------------------------------

IMPORT_COST = """
import sys, time
import gymnasium
start = time.perf_counter()
import hrl_escape
print(time.perf_counter() - start)
print(*{"torch", "ompl", "pinocchio", "numba", "matplotlib", "scipy", "pybullet"} & set(sys.modules))
"""


def test_import_is_quick_and_loads_nothing_heavy():
    runs = [run("python", "-c", IMPORT_COST) for _ in range(5)]
    assert all(done.returncode == 0 for done in runs), runs[0].stderr
    seconds, heavy = zip(*(done.stdout.split("\n")[:2] for done in runs), strict=True)
    assert set(heavy) == {""}
    assert min(map(float, seconds)) < 0.2


# --- versions --------------------------------------------------------------------------


def find_one(pattern: str, file: str) -> str:
    found = re.search(pattern, (ROOT / file).read_text(), re.MULTILINE)
    assert found, f"{file} has no line {pattern}"
    return found[1]


def test_versions_agree():
    version = find_one(r'^version = "(.+)"$', "pyproject.toml")
    assert find_one(r"^version: (\S+)$", "CITATION.cff") == version
    assert find_one(r"^## (\S+)", "CHANGELOG.md") == version


def test_changelog_says_of_each_entry_whether_results_are_affected():
    entries = re.split(r"^- ", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[1:]
    assert entries
    for entry in entries:
        assert re.search(r"\(results affected: (yes|no)\)\s*$", entry.split("\n\n")[0]), entry
