"""Contact sheets of the built site: every page at the size of a laptop and of a phone.

    python docs/contact_sheet.py build/docs

writes `build/docs/contact/laptop-1.png`, `phone-1.png` and so on through headless Chromium, and says which page is
where. `make contact-sheet` builds the site first. It needs Chromium.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZES = {"laptop": (1280, 800, 4, 16), "phone": (390, 844, 10, 40)}
"""Name: width and height of the window, pages a row, pages a sheet."""
ACROSS, LABEL = 1920, 22  # pixels: of a sheet, and of the line above a page
LEFT_OUT = ("genindex", "search", "py-modindex")
PAGE = """<!doctype html><meta charset="utf-8"><style>
body {{ margin: 0; background: #fff; font: 13px/{label}px sans-serif; }}
div {{ position: absolute; width: {wide}px; height: {tall}px; overflow: hidden; outline: 1px solid #999; }}
p {{ position: absolute; margin: 0 4px; white-space: nowrap; }}
iframe {{ border: 0; width: {width}px; height: {height}px; transform: scale({scale}); transform-origin: 0 0; }}
</style>{cells}"""


def list_pages(site: Path) -> list[Path]:
    """The site's pages, in the order of their paths; those at the root first."""
    pages = [page for page in site.rglob("*.html") if not page.relative_to(site).parts[0].startswith("_")
             and page.stem not in LEFT_OUT]
    return sorted(pages, key=lambda page: (len(page.relative_to(site).parts), page))


def write_sheet(site: Path, pages: list[Path], size: str) -> tuple[str, int]:
    """A page of frames, each with one page of the site, and its height."""
    width, height, columns, _ = SIZES[size]
    scale = (ACROSS / columns - 8) / width
    wide, tall = width * scale, height * scale
    cells = []
    for number, page in enumerate(pages):
        row, column = divmod(number, columns)
        left, top = column * ACROSS / columns + 4, row * (tall + LABEL + 6)
        cells.append(f'<p style="left:{left}px;top:{top}px">{escape(str(page.relative_to(site).with_suffix("")))}</p>'
                     f'<div style="left:{left}px;top:{top + LABEL}px"><iframe src="{page.as_uri()}"></iframe></div>')
    sheet = PAGE.format(label=LABEL, wide=wide, tall=tall, width=width, height=height, scale=scale,
                        cells="".join(cells))
    return sheet, math.ceil(math.ceil(len(pages) / columns) * (tall + LABEL + 6))


def main(site: Path) -> None:
    """Write all sheets."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        print(f"no contact sheets: none of {', '.join(BROWSERS)} is installed")
        return
    (folder := site / "contact").mkdir(exist_ok=True)
    pages = list_pages(site)

    def draw(sheet: tuple[str, int]) -> str:
        size, first = sheet
        shown = pages[first : first + SIZES[size][-1]]
        path = folder / f"{size}-{first // SIZES[size][-1] + 1}.png"
        with tempfile.TemporaryDirectory() as profile:
            text, height = write_sheet(site, shown, size)
            (page := Path(profile, "sheet.html")).write_text(text, encoding="utf-8")
            subprocess.run([browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                            "--allow-file-access-from-files", f"--user-data-dir={profile}/user",
                            f"--window-size={ACROSS},{height}", "--virtual-time-budget=8000",
                            f"--screenshot={path}", page.as_uri()], check=True, timeout=300, capture_output=True)
        return f"{path}: {len(shown)} pages from {shown[0].relative_to(site)}"

    with ThreadPoolExecutor(2) as pool:
        for line in pool.map(draw, [(size, first) for size, (*_, count) in SIZES.items()
                                    for first in range(0, len(pages), count)]):
            print(line, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
