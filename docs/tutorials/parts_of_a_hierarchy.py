"""Redraw a study's figure from its runs.

A study keeps one line of JSON per run, so you can redraw its figure or ask new questions of the data. This tutorial
redraws the figure of [*Learning structure*](../results/learning-structure.md). Run it from a checkout, which contains
`studies`.
"""

import json
from collections import defaultdict
from pathlib import Path

import numpy as np

import hrl_escape
from hrl_escape.figures import LINES, get_figure_class
from hrl_escape.files import read_toml

folder = Path(hrl_escape.__file__).parents[1] / "studies" / "parts"
runs = [json.loads(line) for line in (folder / "raw.jsonl").read_text().splitlines()[1:]]  # the first has the format
fresh = read_toml(folder / "study.toml")["slices"]["confirmation"]["first_seed"]
first = [run for run in runs if run["seed"] < fresh and not run["failure"]]  # without the confirmation
print(f"{len(first):,} runs of design {first[0]['design']}")

# A run without an escape has no first escape. It stays in the median as infinity.

ends = defaultdict(list)
for run in first:
    ends[run["cell"], run["rule"], run["buttons"]].append(run["first_escape"] or np.inf)
cells = ["flat", "flat + commitment", "learned walks", "options", "options + structure", "options + both"]

figure = get_figure_class()(figsize=(7.6, 3.2), layout="constrained")
for axes, rule in zip(figure.subplots(1, 2, sharey=True), ("ignore", "reset"), strict=True):
    for cell, colour in zip(cells, LINES, strict=True):
        medians = {size: np.median(found) for (name, its, size), found in sorted(ends.items())
                   if (name, its) == (cell, rule)}
        print(f"{rule}, {cell}: " + ", ".join(f"{size}: {middle:,.0f}" for size, middle in medians.items()))
        axes.loglog(list(medians), list(medians.values()), "o-", color=colour, label=cell, markersize=4)
    axes.set(title=f"rule {rule}", xlabel="buttons")
figure.supylabel("primitives to the first escape", fontsize=9)
axes.legend(fontsize=7, frameon=False)
figure
