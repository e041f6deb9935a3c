"""What holds for the project as a whole: imports and their cost, names, words, randomness, versions.

Style, types and the imports of the package itself are `make lint`; here each contract on imports finds what breaks it.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from hrl_escape.files import read_toml
from tests.command_line import run_python
from tests.forks import run_fork
from tests.random_state import find_global_random_state, list_nodes, parse

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "hrl_escape"
SOURCES = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
STUDIES = {path: path.read_text(encoding="utf-8") for path in sorted((ROOT / "studies").rglob("*.py"))}


# --- which way imports run -------------------------------------------------------------

LINT_IMPORTS = ("--no-cache", "--no-logo", "--config", str(ROOT / "pyproject.toml"))

HOUSE = """
cli errors files settings checks.option commands.list
benchmark.grid benchmark.reporting.report viewer.scene
agents.agent agents.registry agents.components.networks agents.training.train
agents.algorithms.dqn agents.algorithms.sarsa agents.algorithms.task_hierarchies.hamq
agents.algorithms.task_hierarchies.maxq_q
agents.hierarchy.task agents.factored.search agents.keras_rl_2019.recipes
options.option options.options_env options.meta_actions
planning.goals planning.planner planning.paths.navigator planning.arm.model planning.search.a_star floor.clearance
env.config env.presets env.instance env.robot env.primitives env.geometry env.observations env.engine
env.puzzles.base env.puzzles.buttons env.puzzles.bit_flip env.sampling.generation env.pictures.maps
env.bullet.engine env.bullet.physics env.batched.engine env.batched.rules
env.escape_room env.vector_env env.torchrl_env
sets.benchmark sets.rung sets.instance_set benchmark.rung_references
data.recording data.materialise text.text_env
""".split()

ALLOWED_IMPORTS = {
    "cli": "hrl_escape.benchmark.reporting.report",
    "benchmark.reporting.report": "hrl_escape.agents.training.train",
    "agents.algorithms.dqn": "torchrl",
    "agents.algorithms.sarsa": "hrl_escape.agents.algorithms.dqn",
    "options.options_env": "hrl_escape.env.escape_room",
    "options.meta_actions": "hrl_escape.planning.planner",
    "planning.paths.navigator": "ompl",
    "planning.arm.model": "pinocchio",
    "sets.instance_set": "hrl_escape.env.escape_room",
    "benchmark.grid": "hrl_escape.sets.benchmark",
    "env.escape_room": "hrl_escape.env.engine",
    "env.vector_env": "gymnasium",
    "env.bullet.engine": "pybullet",
    "env.puzzles.buttons": "hrl_escape.env.puzzles.base",
    "env.instance": "hrl_escape.env.puzzles.buttons",
    "env.config": "hrl_escape.settings",
}

FORBIDDEN_IMPORTS = [  # (importer, imported, the contract that finds it); a file of a new name where globs must hold
    ("env.config", "hrl_escape.options.option", "errors <- env <- floor <- planning <- options"),
    ("env.config", "hrl_escape.planning.goals", "errors <- env <- floor <- planning <- options"),
    ("planning.planner", "hrl_escape.options.option", "errors <- env <- floor <- planning <- options"),
    ("errors", "hrl_escape.env.config", "errors <- env <- floor <- planning <- options"),
    ("options.option", "hrl_escape.agents.agent", "errors <- env <- floor <- planning <- options"),
    ("options.new", "hrl_escape.benchmark.reporting.report", "errors <- env <- floor <- planning <- options"),
    ("sets.new", "hrl_escape.benchmark.reporting.report", "errors <- env <- floor <- planning <- options"),
    ("agents.components.new", "hrl_escape.sets.rung", "errors <- env <- floor <- planning <- options"),
    ("viewer.scene", "hrl_escape.cli", "errors <- env <- floor <- planning <- options"),
    ("agents.algorithms.new", "hrl_escape.env.config", "agents know neither env, planning nor options"),
    ("agents.training.new", "hrl_escape.options.option", "agents know neither env, planning nor options"),
    ("env.geometry", "hrl_escape.env.bullet.engine", "rules of a room"),
    ("env.batched.new", "hrl_escape.env.bullet.engine", "rules of a room"),
    ("env.bullet.new", "hrl_escape.env.escape_room", "rules of a room"),
    ("env.sampling.new", "hrl_escape.env.batched.engine", "rules of a room"),
    ("planning.new", "hrl_escape.env.bullet.engine", "no engine but through"),
    ("commands.new", "hrl_escape.env.bullet.physics", "no engine but through"),
    ("data.new", "hrl_escape.benchmark.grid", "data sets and training name rooms"),
    ("env.puzzles.new", "hrl_escape.env.puzzles.buttons", "puzzles do not import puzzles"),
    ("agents.hierarchy.new", "hrl_escape.agents.algorithms.task_hierarchies.hamq", "agents: the protocol and parts"),
    ("agents.components.new", "hrl_escape.agents.training.train", "agents: the protocol and parts"),
    ("env.bullet.new", "gymnasium", "within env, gymnasium only"),
    ("benchmark.new", "studies.store", "the package knows neither"),
    ("agents.training.new", "benchmarks.machine", "the package knows neither"),
    ("viewer.new", "pybullet", "pybullet only in"),
    ("planning.arm.new", "ompl", "ompl only in"),
    ("planning.new", "pinocchio", "pinocchio only in"),
    ("options.new", "torchrl", "torchrl only in"),
]


def write_house(folder: Path, imports: Iterable[tuple[str, str]]) -> Path:
    """Writes a package with every planned module, empty but for the imports given, (importer, imported)."""
    package, imports = folder / "hrl_escape", list(imports)
    for module in {*HOUSE, *(importer for importer, _ in imports)}:
        path = package.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(f"import {imported}\n" for importer, imported in imports if importer == module))
        for parent in path.relative_to(folder).parents[:-1]:
            (folder / parent / "__init__.py").touch()
    return folder


def lint_imports(house: Path) -> subprocess.CompletedProcess[str]:
    """What `lint-imports` says of a package in a folder."""
    return run_fork("from importlinter.cli import lint_imports_command as run; run()", *LINT_IMPORTS, cwd=house)


def test_import_contracts_allow_what_the_house_plan_allows(tmp_path: Path):
    done = lint_imports(write_house(tmp_path, ALLOWED_IMPORTS.items()))
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(("one", "other"), [
    ("env.robot", "env.primitives"), ("agents.algorithms.dqn", "agents.algorithms.sarsa"),
    ("agents.algorithms.task_hierarchies.hamq", "agents.algorithms.dqn")])
def test_import_contracts_find_a_cycle(tmp_path: Path, one: str, other: str):
    imports = ((one, f"hrl_escape.{other}"), (other, f"hrl_escape.{one}"))
    assert "no cycles BROKEN" in lint_imports(write_house(tmp_path, imports)).stdout


def test_import_contracts_find_a_cycle_of_types(tmp_path: Path):
    house = write_house(tmp_path, [("planning.goals", "hrl_escape.planning.planner")])
    (house / "hrl_escape/planning/planner.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import hrl_escape.planning.goals\n")
    assert "no cycles BROKEN" in lint_imports(house).stdout


def test_import_contracts_find_planted_violations(tmp_path: Path):
    """All at once; each is told below the contract that it breaks."""
    report = lint_imports(write_house(tmp_path, (pair[:2] for pair in FORBIDDEN_IMPORTS))).stdout
    contracts = re.findall(r"^(.+) (?:BROKEN|KEPT)$", report, re.MULTILINE)
    assert len(contracts) == 14
    told = report.partition("Broken contracts")[2]
    places = sorted((told.index(f"\n{name}\n---"), name) for name in contracts)
    ends = [*(place for place, _ in places[1:]), len(told)]
    below = {name: " ".join(told[place:end].split()) for (place, name), end in zip(places, ends, strict=True)}
    for importer, imported, contract in FORBIDDEN_IMPORTS:
        (name,) = (name for name in contracts if name.startswith(contract))
        package = imported if imported.startswith("hrl_escape") else imported.partition(".")[0]
        assert f"- hrl_escape.{importer} -> {package} (" in below[name], (importer, imported, below[name])


# --- names -----------------------------------------------------------------------------

TENSOR_FORMS = [PACKAGE / "env", PACKAGE / "env/batched"]
"""The tensor rules of `env.batched` have the names of the scalar rules that they are."""
TENSOR_FILES = [PACKAGE / "env/geometry.py", PACKAGE / "env/tensor_geometry.py"]
"""So has the geometry of tensors."""


def list_names(source: str) -> set[str]:
    """Public names that a module defines at its top level."""
    names = set[str]()
    for node in parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return {name for name in names if not name.startswith("_")}


def find_homonyms(modules: dict[Path, str]) -> dict[str, list[Path]]:
    """Names that more than one module defines. Each command has its `run`, or `run_NAME` beside others."""
    homes: dict[str, list[Path]] = {}
    for path, source in modules.items():
        names = list_names(source)
        commands = {name for name in names if name.startswith("run_") and "commands" in path.parts}
        for name in names - {"run"} - commands:
            homes.setdefault(name, []).append(path)
    return {name: paths for name, paths in homes.items()
            if len(paths) > 1 and sorted(path.parent for path in paths) != TENSOR_FORMS
            and sorted(paths) != TENSOR_FILES}


def test_a_name_has_one_meaning():
    assert not find_homonyms(SOURCES)


def test_a_name_of_two_meanings_is_found():
    here, there = PACKAGE / "planning/plan.py", PACKAGE / "agents/training/run.py"
    assert find_homonyms({here: "class Plan: ...", there: "Plan = int"}) == {"Plan": [here, there]}
    assert not find_homonyms({here: "_Plan = 1", there: "_Plan = 2"})
    assert not find_homonyms({PACKAGE / "env/poses.py": "def turn(): ...",
                              PACKAGE / "env/batched/poses.py": "def turn(): ..."})
    assert not find_homonyms(dict.fromkeys(TENSOR_FILES, "def measure(): ..."))


# --- words -----------------------------------------------------------------------------

QUESTION = re.compile(r"(What|Who|Where|How|Whether|Whose|Which|When|Why)\b")


def list_docstrings(source: str) -> list[str]:
    """First lines of all docstrings of a module, those under attributes and constants included."""
    texts = (node.value.value for node in list_nodes(source)
             if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
    return [text.strip().splitlines()[0] for text in texts if isinstance(text, str)]


def test_no_docstring_opens_with_a_question_word():
    assert [(module, line) for module, source in (SOURCES | STUDIES).items() for line in list_docstrings(source)
            if QUESTION.match(line)] == []


# --- randomness ------------------------------------------------------------------------


def test_no_module_uses_global_random_state():
    """But one, which lends torch's generator to TorchRL, and whose own test sees that it is put back."""
    found = {module.name: uses for module, source in (SOURCES | STUDIES).items()
             if (uses := find_global_random_state(source))}
    assert list(found) == ["torchrl_agent.py"]
    assert [use.split()[-1] for use in found["torchrl_agent.py"]] == ["torch.random.fork_rng", "torch.set_rng_state"]


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
start = time.process_time()
import gymnasium
middle = time.process_time()
import hrl_escape
print((time.process_time() - middle) / (middle - start))
print(*{"torch", "ompl", "pinocchio", "numba", "matplotlib", "scipy", "pybullet"} & set(sys.modules))
"""


def test_import_is_quick_and_loads_nothing_heavy(monkeypatch):
    """Measured with bytecode, as what is installed has it: the first of two runs writes it where it is missing."""
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    runs = [run_python(IMPORT_COST) for _ in range(2)]
    assert all(done.returncode == 0 for done in runs), runs[0].stderr
    costs, heavy = zip(*(done.stdout.split("\n")[:2] for done in runs), strict=True)
    assert set(heavy) == {""}
    assert min(map(float, costs)) < 1, "more processor time than Gymnasium's own import"


# --- versions --------------------------------------------------------------------------


def find_one(pattern: str, file: str) -> str:
    found = re.search(pattern, (ROOT / file).read_text(), re.MULTILINE)
    assert found, f"{file} has no line {pattern}"
    return found[1]


def test_studies_are_in_the_source_and_not_in_the_wheel():
    targets = read_toml(ROOT / "pyproject.toml")["tool"]["hatch"]["build"]["targets"]
    assert targets["wheel"] == {"packages": ["hrl_escape"]}
    assert {"hrl_escape", "studies", "benchmarks"} <= set(targets["sdist"]["include"])


def test_versions_agree():
    version = find_one(r'^version = "(.+)"$', "pyproject.toml")
    assert find_one(r"^version: (\S+)$", "CITATION.cff") == version
    assert find_one(r"^## (\S+)", "CHANGELOG.md") == version


def test_changelog_marks_what_changes_results_at_the_end_of_an_entry():
    text = (ROOT / "CHANGELOG.md").read_text()
    entries = [entry.split("\n\n")[0] for entry in re.split(r"^- ", text, flags=re.MULTILINE)[1:]]
    marked = [entry for entry in entries if "Changes results" in entry]
    assert marked and "results affected" not in text
    assert all(re.search(r"\. \*\*Changes results\.\*\*\s*$", entry) for entry in marked)


def test_requirements_are_ranges_and_the_pins_that_were_tested_lie_in_them():
    """An exact pin in a library's requirements makes it uninstallable beside others; bits are the pins' affair."""
    project = read_toml(ROOT / "pyproject.toml")["project"]
    pins = dict(re.findall(r"^([\w.-]+)==([^;\s]+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    pins = {canonicalize_name(name): version for name, version in pins.items()}
    for text in sum(project["optional-dependencies"].values(), project["dependencies"]):
        requirement = Requirement(text)
        if requirement.name == "hrl-escape":
            continue
        assert not [part for part in requirement.specifier if part.operator in ("==", "~=", "===")], text
        pinned = pins.get(canonicalize_name(requirement.name))
        assert pinned is None or requirement.specifier.contains(pinned), text
    torch = Requirement(next(text for text in project["dependencies"] if text.startswith("torch>")))
    assert "torch" in pins and {version for version in ("2.8.0", "2.99.0") if torch.specifier.contains(version)} == {
        "2.8.0", "2.99.0"}, "a wide range"


WITHOUT_PLANNERS = """
import sys
sys.modules |= {"ompl": None, "pinocchio": None, "coal": None}
import gymnasium, hrl_escape
for name in ("Clutter", "ArmTwoButton", "BlocksWorld"):
    env = gymnasium.make(f"hrl_escape/{name}-v1")
    env.reset(seed=0)
    print(len(env.step(0)))
from hrl_escape.cli import main
print(main(["solve", "--room", "paper-one-button", "--planner", "RRTConnect"]))
print(main(["solve", "--room", "arm-two-button"]))
"""


def test_rooms_step_without_the_planners_packages_and_planning_names_what_is_missing():
    done = run_python(WITHOUT_PLANNERS)
    assert done.stdout.split() == [*3 * ["5"], "2", "2"], done.stderr
    paths, arm = done.stderr.splitlines()
    assert "Planning of paths needs the package ompl" in paths and "Planning for an arm needs the package pin" in arm


def test_pinned_versions_install_on_every_python_3_11():
    """Distributions ship early ones, such as 3.11.2, and pip would find no version of a pin that needs a later one."""
    late = [f"{found.name} {found.version} needs Python {needed}" for found in distributions()
            if (needed := found.metadata.get("Requires-Python")) and not SpecifierSet(needed).contains("3.11.0")]
    assert not late
