"""Lists the benchmarks, one line each; `python -m benchmarks.NAME --help` explains one."""

from __future__ import annotations

import ast
from pathlib import Path


def main() -> None:
    """Print the name and the claim of every benchmark that can be run."""
    sources = {path.stem: path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("[a-z]*.py"))}
    listed = {name: source for name, source in sources.items() if '__name__ == "__main__"' in source}
    width = max(map(len, listed))
    for name, source in listed.items():
        print(f"  {name:<{width}}  {(ast.get_docstring(ast.parse(source)) or '').splitlines()[0]}")
    print("\n`python -m benchmarks.NAME --help` explains a benchmark and its options.")


if __name__ == "__main__":
    main()
