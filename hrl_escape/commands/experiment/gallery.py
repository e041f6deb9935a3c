"""Measure a room of every puzzle and write the gallery: pictures, rules, how exact each is, and how agents do.

Writes docs/results/gallery.md with a line of JSON for each finding. Killed, the same command goes on.

Examples:
    hrl-escape experiment gallery
    hrl-escape experiment gallery --presets hanoi taxi --primitives 1000 --docs /tmp/page
    hrl-escape experiment gallery --from-raw             # the page anew from the lines, nothing is measured
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from rich.console import Console

from hrl_escape.comparison.gallery.entries import load_entries
from hrl_escape.comparison.gallery.measure import GallerySettings, load_gallery, measure_gallery, save_gallery
from hrl_escape.comparison.gallery.page import GALLERY_PAGE, write_gallery
from hrl_escape.comparison.studies.running import get_raw_file
from hrl_escape.files import claim_folder


@dataclasses.dataclass(frozen=True)
class GalleryArgs(GallerySettings):
    """Options of `hrl-escape experiment gallery`."""

    presets: tuple[str, ...] = dataclasses.field(
        default_factory=lambda: tuple(entry.preset for entry in load_entries()))
    """Puzzles to measure."""
    docs: Path = Path("docs/results")
    """Folder of the page and the findings."""
    from_raw: bool = False
    """Measure nothing: write the page anew from the findings."""


def run(args: GalleryArgs) -> None:
    """Measure what is missing, keep every finding at once, and write the page."""
    raw = get_raw_file(args.docs, "gallery")
    found = load_gallery(raw) if args.from_raw or raw.exists() else []
    console = Console(highlight=False, soft_wrap=True)
    if not args.from_raw:
        claim_folder(raw.parent)
        for each in measure_gallery(args.presets, args, tuple(found)):
            found.append(each)
            save_gallery(raw, found)
            console.print(f"{each}")
    write_gallery(found, args.docs)
    console.print(f"Page: {args.docs / GALLERY_PAGE}")
