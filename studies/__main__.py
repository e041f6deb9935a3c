"""Studies of this project: `python -m studies` lists them, `python -m studies NAME` runs one and prints its tables.

NAME is a study, or the path of its folder. After an interruption the same command resumes.
`python -m studies pages` writes the result pages from the committed raw data, or the pages that it is given.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import tyro
from rich.console import Console

from hrl_escape.cli import run_in_order
from studies.publishing import list_pages, load_page, publish
from studies.running import get_args, run_study
from studies.study import find_study, list_studies

__all__ = ["main"]


@dataclasses.dataclass(frozen=True)
class PageArgs:
    """Write result pages from the committed raw data."""

    pages: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names of the pages; all by default."""
    docs: Path = Path("docs/results")
    """Folder that takes pages and figures."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code, as `hrl_escape.cli.main` does."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    return run_in_order("python -m studies", lambda: _run(given))


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        studies = list_studies()
        width = max(map(len, studies))
        lines = [f"  {name:<{width}}  {study.data['about'].splitlines()[0]}"
                 + (f" Data of {study.data['made_with']}." if study.holds_data_alone else "")
                 for name, study in studies.items()]
        more = "`python -m studies NAME --help` explains a study and its options."
        print("\n".join([str(__doc__), *lines, "", more]))
        return 0
    if arguments[0] == "pages":
        return _publish(tyro.cli(PageArgs, prog="python -m studies pages", args=arguments[1:]))
    study = find_study(arguments[0])
    args = tyro.cli(get_args(study), prog=f"python -m studies {arguments[0]}", args=arguments[1:],
                    description=study.data["about"], config=(tyro.conf.FlagCreatePairsOff,))
    console = Console(highlight=False, soft_wrap=True)
    found = run_study(study, args)
    for name, table in found.tables.items():
        console.print(f"\n{name}\n{table}", markup=False)
    if pages := [name for name in list_pages() if study.name in load_page(name).studies]:
        console.print(f"\nPages with these results: python -m studies pages {' '.join(pages)}", markup=False)
    return 0


def _publish(args: PageArgs) -> int:
    for name in args.pages or list_pages():
        publish(load_page(name), args.docs)
        print(f"Page: {args.docs / name}.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
