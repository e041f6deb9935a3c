"""Mutants drawn at random: small bugs in the package, each tried against the tests that import the file it is in.

    python -m benchmarks.mutants --count 40 --since HEAD~20    # in the files that have changed
    python -m benchmarks.mutants --count 50 --package floor --seed 1

A minute for three or so; extra `mutants`. It prints those that no test sees; some change nothing that anybody could
see, the others want a test. The seed is the day by default, so that a nightly run draws new ones.
"""

from __future__ import annotations

import argparse
import datetime
import difflib
import random
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import cosmic_ray.ast
import cosmic_ray.mutating
import cosmic_ray.plugins

from tests.mutations.mutation import ROOT, PackageCopy

LEFT_OUT = ("NoOp", "RemoveDecorator", "ExceptionReplacer", "Variable", "BinaryOperator_BitOr")
"""Operators that mostly break annotations, or what no test could see."""
MOST_MODULES = 6
"""Test modules tried against one mutant."""


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
    """Mutants of a file, those of one place in it together."""
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


def find_tests(file: str) -> list[str]:
    """Test modules that import a file, its own first."""
    path = Path(file)
    module = ".".join(("hrl_escape", *path.with_suffix("").parts))
    own = path.parent / f"test_{path.stem}.py"
    found = [test.relative_to(ROOT / "tests") for test in sorted((ROOT / "tests").rglob("test_*.py"))
             if re.search(rf"\b{re.escape(module)}\b", test.read_text(encoding="utf-8"))]
    beside = [test for test in found if test != own and test.parent == path.parent]
    others = [test for test in found if test != own and test.parent != path.parent]
    ordered = [own] * (ROOT / "tests" / own).is_file() + beside + others
    return [str(test) for test in ordered[:MOST_MODULES]]


def main() -> int:
    """Draw mutants and print those that survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--since", default="HEAD~20", help="commit since which files have changed")
    parser.add_argument("--package", help="folder within hrl_escape, in place of the files that have changed")
    parser.add_argument("--files", nargs="+", default=[], help="paths within hrl_escape, in place of those changed")
    parser.add_argument("--seed", type=int, default=datetime.date.today().toordinal())
    arguments = parser.parse_args()
    if arguments.package:
        package = ROOT / "hrl_escape" / arguments.package
        files = sorted(path.relative_to(ROOT / "hrl_escape").as_posix() for path in package.rglob("*.py"))
    else:
        files = arguments.files or list_changed(arguments.since)
    places = [place for file in files if find_tests(file)
              for place in list_places(file)]
    rng = random.Random(arguments.seed)
    drawn = rng.sample(places, len(places))[:arguments.count]  # a larger count begins with the same
    chosen = [rng.choice(mutants) for mutants in drawn]
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = PackageCopy(Path(folder))
        tests = list(dict.fromkeys(test for place in chosen for test in find_tests(place.file)))
        sound = (ROOT / "hrl_escape" / "__init__.py").read_text(encoding="utf-8")
        if copy.is_change_seen("__init__.py", sound, tests, seconds=3600):
            parser.error(f"without a mutant a test of these fails, so that nothing would be told: {' '.join(tests)}")
        for place in chosen:
            changed = mutate(place)
            if copy.is_change_seen(place.file, changed, find_tests(place.file)):
                continue
            survivors += 1
            sound = (ROOT / "hrl_escape" / place.file).read_text(encoding="utf-8")
            difference = difflib.unified_diff(sound.splitlines(), changed.splitlines(), place.file, place.file,
                                              lineterm="", n=0)
            print("\n".join(difference), flush=True)
    print(f"{len(chosen)} mutants drawn at {len(places):,} places with seed {arguments.seed}: "
          f"{len(chosen) - survivors} seen, {survivors} survived")
    return 0


if __name__ == "__main__":
    sys.exit(main())
