"""`hrl-escape watch RUNG`, the command itself, in a real headless Chromium."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from hrl_escape.sets.benchmark import load_benchmark
from tests.viewer.browser import Browser

FACTS = "document.querySelector('#facts')?.dataset"


@pytest.mark.nightly
def test_watch_shows_the_trained_agent_of_a_rung_at_once(browser: Browser):
    command = [sys.executable, "-c", "from hrl_escape.cli import main; main()", "watch", "lattice", "--no-open",
               "--port", "0", "--pace", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert process.stdout is not None
            address = next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
            page = browser.open(address.rstrip("."))
            page.wait(f"{FACTS}?.primitives > 20")
            page.wait("document.querySelectorAll('#values .action').length > 0")
            shown = page.run("document.body.innerText")
            count = len(load_benchmark("ladder-1")["lattice"].test[0].targets)
            names = page.run("[...document.querySelectorAll('#values .action')].map(row => row.dataset.name)")
            assert "as trained" in shown
            assert {*(f"press-button-{number}" for number in range(1, count + 1)), "go-to-exit"} <= set(names)
            page.close()
        finally:
            process.kill()
