"""Times and sizes of an installation: the base package, and each extra on top of it, in environments of their own.

    python -m benchmarks.installation                                    # prints the table; needs uv on the PATH
    python -m benchmarks.installation --extras viewer llm --find-links /opt/wheels

Every installation is made twice, into new environments: with an empty cache and with the cache that the first one has
filled. Sizes are sums of installed files without bytecode. An extra's environment has the base already.
"""

from __future__ import annotations

import dataclasses
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hrl_escape.cli import run_script

ROOT = Path(__file__).parents[1]
EXTRAS = ("viewer", "video", "data", "llm", "pddl", "bench", "tensorboard", "wandb", "optuna", "ray", "slurm",
          "docs", "release", "mutants", "dev")


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the benchmark."""

    extras: tuple[str, ...] = EXTRAS
    """Extras to install; the base package always is."""
    find_links: str = ""
    """Folder with wheels, such as torch's CPU build."""
    pip: bool = False
    """Install the base package by pip too, which takes minutes."""


@dataclasses.dataclass(frozen=True)
class Installation:
    """One installation.

    Attributes:
        seconds: wall-clock time.
        cpu: processor time, seconds.
        megabytes: installed files without bytecode, 10^6 bytes.
        failure: last line of the installer's message, empty if it succeeded.
    """

    seconds: float
    cpu: float
    megabytes: float
    failure: str = ""


def measure_folder(folder: Path) -> float:
    """Return the size of a folder's files without bytecode, 10^6 bytes."""
    return sum(path.stat().st_size for path in folder.rglob("*")
               if path.is_file() and not path.is_symlink() and path.suffix != ".pyc") / 1e6


def install(command: list[str | Path], environment: Path, **variables: str) -> Installation:
    """Run an installer, and measure what it adds to an environment."""
    before, used, began = measure_folder(environment), resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([str(word) for word in command], text=True, capture_output=True,
                          env={**os.environ, "VIRTUAL_ENV": str(environment), **variables})
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = done.stderr.strip().splitlines()
    return Installation(time.perf_counter() - began, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime,
                        measure_folder(environment) - before, (said or ["failed"])[-1] if done.returncode else "")


def describe(name: str, *found: Installation) -> str:
    """Row of a Markdown table."""
    if failure := next((each.failure for each in found if each.failure), ""):
        return f"| {name} | {failure} | | |"
    cells = [f"{each.seconds:.1f} ({each.cpu:.1f})" for each in found]
    return f"| {name} | {found[0].megabytes:,.1f} | {' | '.join(cells)} |"


def run(args: Args) -> None:
    """Install, measure and print the table."""
    uv = shutil.which("uv")
    assert uv is not None, "uv is not on the PATH: pip install uv"
    links = ["--find-links", args.find_links] if args.find_links else []
    print("| what | MB | empty cache, s (processor) | full cache, s (processor) |\n|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory(prefix="hrl-escape-") as place:
        folder = Path(place)
        subprocess.run([uv, "build", "--wheel", "--quiet", "--out-dir", folder, ROOT], check=True)
        wheel, cache = next(folder.glob("*.whl")), folder / "cache"
        options = ["-c", ROOT / "constraints.txt", *links]
        subprocess.run([uv, "venv", "--quiet", "--python", sys.executable, folder / "base"], check=True)
        base = [install([uv, "pip", "install", "--cache-dir", cache, *options, wheel], folder / "base")]
        subprocess.run([uv, "venv", "--quiet", "--python", sys.executable, folder / "again"], check=True)
        base.append(install([uv, "pip", "install", "--cache-dir", cache, *options, wheel], folder / "again"))
        print(describe("base", *base), flush=True)
        shutil.rmtree(folder / "again")
        for extra in args.extras:
            found = []
            for _ in range(2):  # links to the same files: an installer replaces files, and never writes into them
                shutil.copytree(folder / "base", folder / "extra", copy_function=os.link, symlinks=True)
                found.append(install([uv, "pip", "install", "--cache-dir", folder / f"cache-{extra}", *options,
                                      f"{wheel}[{extra}]"], folder / "extra"))
                shutil.rmtree(folder / "extra")
            shutil.rmtree(folder / f"cache-{extra}", ignore_errors=True)
            print(describe(f"`{extra}`", *found), flush=True)
        if args.pip:
            found = []
            for number in range(2):
                subprocess.run([sys.executable, "-m", "venv", folder / f"pip-{number}"], check=True)
                found.append(install([folder / f"pip-{number}/bin/python", "-m", "pip", "install", "--quiet",
                                      "--cache-dir", folder / "cache-pip", *options, wheel], folder / f"pip-{number}"))
                shutil.rmtree(folder / f"pip-{number}")
            print(describe("base, by pip", *found), flush=True)


if __name__ == "__main__":
    sys.exit(run_script(run))
