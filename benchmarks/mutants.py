"""Mutants drawn at random: small bugs in the package, each tried against tests that import the file it is in.

    python -m benchmarks.mutants --count 40 --since HEAD~20    # in the files that have changed
    python -m benchmarks.mutants --count 50 --packages floor --seed 1
    make mutants                                               # 20 of each of five packages, as every night

A minute for three or so; extra `mutants`. Up to four modules, the nearest first, run one after another until one sees
it. It prints the mutants that none sees, without those in `equivalent_mutants.toml`, which change nothing that anybody
could see. The others want a test; exits with 1 if they are more than one in twenty. The seed is the day by default, so
that a nightly run draws new ones; with one seed a larger count begins with the smaller.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import difflib
import functools
import itertools
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

try:
    import cosmic_ray.ast
    import cosmic_ray.mutating
    import cosmic_ray.plugins
except ImportError:
    sys.exit("benchmarks.mutants needs cosmic-ray: pip install 'hrl-escape[mutants]'")

from hrl_escape import kernels
from hrl_escape.files import read_toml
from tests.mutations.mutation import ROOT, PackageCopy

LEFT_OUT = ("NoOp", "RemoveDecorator", "ExceptionReplacer", "Variable", "BinaryOperator_BitOr")
"""Operators that mostly break annotations, or what no test could see."""
MOST_MODULES = 4
"""Test modules tried against one mutant."""
TO_COMPILE = 200
"""Further processor seconds where the mutant is in a kernel: all kernels are compiled again."""
PACKAGE = ROOT / "hrl_escape"
EQUIVALENT = ROOT / "benchmarks" / "equivalent_mutants.toml"
"""Mutants that change nothing that anybody could see, with the reason."""
MOST_LEFT = 0.05
"""Largest share of mutants that no test sees."""


class Place(NamedTuple):
    """A mutant: file within the package, operator, and which of its occurrences there."""

    file: str
    operator: str
    occurrence: int


def list_changed(since: str) -> list[str]:
    """Files of the package that have changed since a commit."""
    names = subprocess.run(["git", "diff", "--name-only", "--diff-filter=d", since, "--", "hrl_escape/*.py"], cwd=ROOT,
                           capture_output=True, text=True, check=True).stdout.split()
    return [name.removeprefix("hrl_escape/") for name in names]


def list_places(file: str) -> list[list[Place]]:
    """Mutants of a file, grouped by place."""
    tree = cosmic_ray.ast.get_ast((ROOT / "hrl_escape" / file).read_text(encoding="utf-8"))
    nodes = list(cosmic_ray.ast.ast_nodes(tree))
    places: dict[object, list[Place]] = {}
    for name in cosmic_ray.plugins.operator_names():
        if not any(part in name for part in LEFT_OUT):
            operator = cosmic_ray.plugins.get_operator(name)()
            found = (position for node in nodes for position in operator.mutation_positions(node))
            for occurrence, position in enumerate(found):
                places.setdefault(position, []).append(Place(file, name, occurrence))
    return list(places.values())


def mutate(place: Place) -> str:
    """Text of the file with the mutant in it."""
    source = (ROOT / "hrl_escape" / place.file).read_text(encoding="utf-8")
    operator = cosmic_ray.plugins.get_operator(place.operator)()
    return cosmic_ray.mutating.mutate_code(source, operator, place.occurrence)


@functools.cache
def list_imports(path: Path) -> frozenset[str]:
    """Files of the package that a file imports; a name that a package hands on is the file it comes from."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(filter(None, (_find_file(alias.name) for alias in node.names)))
        elif isinstance(node, ast.ImportFrom):
            base = [*path.parent.relative_to(ROOT).parts[: -node.level + 1 or None]] if node.level else []
            module = ".".join([*base, *filter(None, [node.module])])
            found.update(filter(None, (_find_origin(module, alias.name) for alias in node.names)))
    return frozenset(found)


def _find_file(module: str) -> str | None:
    path = ROOT.joinpath(*module.split("."))
    file = next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.is_file()), None)
    return file.relative_to(PACKAGE).as_posix() if file and file.is_relative_to(PACKAGE) else None


def _find_origin(module: str, name: str) -> str | None:
    """File that a name imported from a module comes from."""
    stub = ROOT.joinpath(*module.split("."), "__init__.pyi")
    if stub.is_file():
        for node in ast.parse(stub.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and any(alias.name == name for alias in node.names):
                return _find_file(f"{module}.{node.module}")
    return _find_file(f"{module}.{name}") or _find_file(module)


@functools.cache
def find_tests(file: str) -> list[str]:
    """Test modules that may see a file's bugs, the nearest first.

    First the module's own, then modules that import the file directly or through one other file, first in its folder's
    mirror. Last the mirror's other modules that reach it through more.
    """
    tests, folder = ROOT / "tests", Path(file).parent
    own = [folder / f"test_{Path(file).stem}.py", folder.parent / f"test_{folder.name}.py"]
    steps = {file: 0}  # imports from a file of the package to this one
    for step in (1, 2, 3):
        steps |= {name: step for path in PACKAGE.rglob("*.py") if (name := path.relative_to(PACKAGE).as_posix())
                  not in steps and any(steps.get(each) == step - 1 for each in list_imports(path))}
    ranked = []
    for path in sorted(tests.rglob("test_*.py")):
        test = path.relative_to(tests)
        away = 0 if test in own else 1 + min((steps.get(each, 9) for each in list_imports(path)), default=9)
        beside = folder.parts[:1] == test.parts[:1]
        if away <= 2 or (beside and away <= 4):
            ranked.append((away > 2, away > 0, not test.parent == folder, not beside, away, str(test)))
    return [test for *_, test in sorted(ranked)]


def draw(files: Iterable[str], seed: int) -> Iterator[Place]:
    """Mutants of files that have tests, one of each place, in an order of its own for each seed.

    A file is drawn in proportion to its size, so that only files that are drawn are searched for places.
    """
    rng = random.Random(seed)
    sizes = {file: (PACKAGE / file).stat().st_size for file in files}
    places: dict[str, list[list[Place]]] = {}
    while sizes := {file: size for file, size in sizes.items() if size and places.get(file) != []}:
        (file,) = rng.choices(list(sizes), list(sizes.values()))
        if file not in places:
            places[file] = list_places(file) if find_tests(file) else []
            rng.shuffle(places[file])
        if places[file]:
            yield rng.choice(places[file].pop())


class Trial:
    """A copy of the package to try mutants in.

    Args:
        folder: where it is made.
        seconds: processor time of a test module; those that need more without a mutant are left out.
    """

    def __init__(self, folder: Path, seconds: int) -> None:
        self.copy, self.seconds = PackageCopy(folder), seconds
        self.passes: dict[str, bool] = {}
        """True if a module passes in time without a mutant."""

    def find_witness(self, place: Place) -> str | None:
        """The first test module that sees a mutant, or takes twice the time, or None if all pass."""
        changed = mutate(place)
        seconds = 2 * self.seconds + TO_COMPILE * (place.file in kernels.SOURCES)
        tests = itertools.islice(filter(self._does_pass, find_tests(place.file)), MOST_MODULES)
        return next((test for test in tests if self.copy.is_change_seen(place.file, changed, [test], seconds)), None)

    def _does_pass(self, test: str) -> bool:
        if test not in self.passes:
            sound = (PACKAGE / "__init__.py").read_text(encoding="utf-8")
            self.passes[test] = not self.copy.is_change_seen("__init__.py", sound, [test], self.seconds)
        return self.passes[test]


def show(place: Place) -> str:
    """What a mutant changes."""
    sound = (PACKAGE / place.file).read_text(encoding="utf-8")
    return "\n".join(difflib.unified_diff(sound.splitlines(), mutate(place).splitlines(), place.file, place.file,
                                          lineterm="", n=0))


def list_lines(place: Place) -> tuple[str, ...]:
    """Lines that a mutant removes and adds, without the space around them."""
    return tuple(f"{line[0]} {line[1:].strip()}" for line in show(place).splitlines()[3:] if line[:1] in ("-", "+"))


def read_equivalent() -> set[tuple[str, tuple[str, ...]]]:
    """Files and lines of the mutants that are known to change nothing."""
    listed = read_toml(EQUIVALENT, "list of mutants").get("mutant", [])
    return {(each["file"], tuple(each["lines"])) for each in listed}


def main() -> int:
    """Draw mutants and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40, help="mutants of each package")
    parser.add_argument("--skip", type=int, default=0, help="drawn before, with the same seed")
    parser.add_argument("--since", default="HEAD~20", help="commit since which files have changed")
    parser.add_argument("--packages", nargs="+", help="folders within hrl_escape, in place of files that have changed")
    parser.add_argument("--files", nargs="+", default=[], help="paths within hrl_escape, in place of those changed")
    parser.add_argument("--seed", type=int, default=datetime.date.today().toordinal())
    parser.add_argument("--seconds", type=int, default=25, help="processor time of a test module (default: 25)")
    arguments = parser.parse_args()
    groups = [sorted(path.relative_to(PACKAGE).as_posix() for path in (PACKAGE / package).rglob("*.py"))
              for package in arguments.packages or ()] or [arguments.files or list_changed(arguments.since)]
    chosen = [place for files in groups for place in itertools.islice(
        draw(files, arguments.seed), arguments.skip, arguments.skip + arguments.count)]
    survivors = equivalent = 0
    known = read_equivalent()
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder), arguments.seconds)
        for number, place in enumerate(chosen, 1):
            witness = trial.find_witness(place)
            print(f"{number} of {len(chosen)}: {place.file}, {witness or 'left'}", file=sys.stderr, flush=True)
            if not witness and (place.file, list_lines(place)) in known:
                equivalent += 1
            elif not witness:
                survivors += 1
                print(show(place), flush=True)
    print(f"{len(chosen)} mutants drawn with seed {arguments.seed}: {len(chosen) - survivors - equivalent} seen, "
          f"{equivalent} equivalent, {survivors} left")
    for test, passes in trial.passes.items():
        if not passes:
            print(f"left out: {test} fails without a mutant, or takes more than {arguments.seconds} s", file=sys.stderr)
    return int(survivors > MOST_LEFT * len(chosen))


if __name__ == "__main__":
    sys.exit(main())
