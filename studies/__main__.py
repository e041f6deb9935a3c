"""Studies of this project: `python -m studies` lists them, `python -m studies NAME` runs one and writes its page.

NAME is the name of a study, or the path of a folder with one. After an interruption, the same command continues.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import tyro
from rich.console import Console

from hrl_escape.cli import run_in_order
from studies.running import PAGES, get_args, run_study
from studies.study import find_study, list_studies

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code, as `hrl_escape.cli.main` does."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    return run_in_order("python -m studies", lambda: _run(given))


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        studies = list_studies()
        width = max(map(len, studies))
        lines = [f"  {name:<{width}}  {study.data['about'].splitlines()[0]}" for name, study in studies.items()]
        more = "`python -m studies NAME --help` explains a study and its options."
        print("\n".join([str(__doc__), *lines, "", more]))
        return 0
    study = find_study(arguments[0])
    args = tyro.cli(get_args(study), prog=f"python -m studies {arguments[0]}", args=arguments[1:],
                    description=study.data["about"], config=(tyro.conf.FlagCreatePairsOff,))
    console = Console(highlight=False, soft_wrap=True)
    for conclusion in run_study(study, args).conclusions:
        console.print(conclusion, markup=False)
    console.print(f"Page: {(args.docs or PAGES) / study.page}.md", markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
