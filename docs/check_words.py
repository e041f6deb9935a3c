"""Check that prose uses the words of the field: `python docs/check_words.py`, part of `make lint`.

Reads Markdown, templates of pages, docstrings and comments. Fails where a folder has more than
`MOST` matches of `WORDS` in 1,000 words, and prints the lines. `--lines PATH` prints the lines of any file or folder.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST = 1.5
"""Matches in 1,000 words that pass."""
CHECKED = (
    "README.md",
    "CHANGELOG.md",
    "docs/*.md",
    "docs/api",
    "docs/environments",
    "docs/_ext",
    "docs/*.py",
    "docs/agents",
    "docs/extend",
    "docs/planning",
    "docs/tutorials",
    "docs/results",
    "hrl_escape",
    "examples",
    "benchmarks",
    "studies",
    "studies/pages",
)
"""Files and folders that are checked."""
WORDS = {
    "told, tell: write is given, shows, distinguishes": r"\b(?:tells?|told|telling)\b",
    "beside: write compared with, next to, in addition to": r"\bbeside\b",
    "anew: write again, regenerated": r"\banew\b",
    "stands in, stands for: write is in, replaces": r"\bstands? (?:in|for|here|there|alone|next|first|last)\b",
    "learns nothing: name the baseline": r"\blearns? nothing\b",
    "is shown to: write the result": r"\b(?:is|are|was|were) (?:not )?shown to\b",
    "searcher: write search baseline": r"\bsearchers?\b",
    "chance: write random policy": r"\b(?:by|over|than|above|below|beats?|beyond|against) chance\b"
                                          r"|\bchance (?:over|has|solves|escapes)\b",
    "schematic: write room configuration": r"\bschematics?\b",
    "tape: write recording": r"\btapes?\b",
    "flavour: write option set": r"\bflavours?\b",
    "recipe: write named settings": r"\brecipes? (?:of an agent|of 2019|`)|\b(?:agent|settings)'s recipes?\b",
    "streams: write many environments": r"\bstreams of (?:rooms|environments)\b",
    "twin: write control, ablation": r"\btwins?\b",
    "storeys: write room sequence": r"\bstoreys?\b(?!`)",
    "those of, that of: repeat the noun": r"\b(?:those|that) of\b",
    "of which, in whom: start a new sentence": r"\b(?:of|in|by|from|for|at|to|with|on|under|over|after) "
                                               r"(?:which|whom|whose)\b",
    "whoever, whatever": r"\b(?:who|what|which)ever\b",
    "but for, save for: write except": r"\bbut for\b|\bsave for\b",
    "Nobody, Nothing as subject": r"(?:^|[.;:] )(?:Nobody|Nothing|No one|Nor)\b",
    "learner of: write agent": r"\blearners? of\b",
    "goes on, comes to: write continues, becomes": r"\bgo(?:es)? on\b|\bcomes? (?:to|out|up to)\b",
    "hereby, thereof and the like": r"\b(?:wherein|thereby|hence|therein|thereof)\b",
    "heading that counts": r"^#+ (?:Two|Three|Four|Five|Six|Seven|Eight|Ten|Twelve) "
                           r"(?:doors|journeys|questions|reasons|recipes|things|ways)\b",
    "objects that know, want or say": r"\b(?:file|function|class|method|room|option|environment|table|command|page)s? "
                                         r"(?:knows?|wants?|says?|obeys?|remembers?)\b",
}
"""What to write in place of a pattern, and the pattern."""
SKIPPED = ("docs/check_words.py", "studies/parts/questions.md", "studies/learned_options/questions.md")
"""This list, and words that are registered with their study."""


def list_files(place: str) -> list[Path]:
    """Files of a place with prose; folders recursively, patterns in their folder only."""
    path = ROOT / place
    found = sorted(ROOT.glob(place)) if "*" in place else [path] if path.is_file() else sorted(path.rglob("*"))
    return [file for file in found if file.suffix in {".md", ".j2", ".py"}
            and str(file.relative_to(ROOT)) not in SKIPPED and not {"build", "__pycache__"} & set(file.parts)]


def read_prose(path: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines of what a person reads: no code blocks but directives, and `x` for code in a line."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        lines = [(node.lineno + offset, line) for node in ast.walk(ast.parse(text))
                 if isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value.split()) >= 8
                 for offset, line in enumerate(node.value.splitlines())]
        lines += [(token.start[0], token.string) for token in tokenize.generate_tokens(io.StringIO(text).readline)
                  if token.type == tokenize.COMMENT]
    else:
        lines, fenced = [], False
        for number, line in enumerate(text.splitlines(), 1):
            if line.lstrip().startswith("```"):
                fenced = not fenced and re.match(r"```+\w", line.lstrip()) is not None
            elif not fenced:
                lines.append((number, line))
    for number, line in lines:
        line = re.sub(r"\{\{.*?\}\}|\{%.*?%\}", "", line) if path.suffix == ".j2" else line
        yield number, re.sub(r"`[^`]*`", "`x`", re.sub(r"\]\([^)]*\)", "]", line))


def check_place(place: str) -> tuple[int, list[str]]:
    """Number of words of a place, and a line of text for each match."""
    words, found = 0, []
    for path in list_files(place):
        for number, line in read_prose(path):
            words += len(line.split())
            found += [f"{path.relative_to(ROOT)}:{number}: {match[0].strip()!r}: {advice}"
                      for advice, pattern in WORDS.items() for match in re.finditer(pattern, line, re.IGNORECASE)]
    return words, found


def main() -> int:
    """Check all places; return 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lines", metavar="PATH", help="print the lines of one file or folder only")
    options = parser.parse_args()
    if options.lines:
        words, found = check_place(options.lines)
        print(*found, f"{len(found)} in {words} words", sep="\n")
        return 0
    failed = False
    for place in CHECKED:
        words, found = check_place(place)
        if 1000 * len(found) > MOST * words:
            failed = True
            print(*found, f"{place}: {len(found)} matches in {words} words, more than {MOST} in 1,000", sep="\n")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
