"""Training in one rung and tests in others: sentences, the table and the figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hrl_escape.benchmark.inference import ALPHA, compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.pictures import palette
from hrl_escape.names import count_nouns, join_words
from studies.baseline import BaselineRun
from studies.figures import FIGURE_STYLE
from studies.generalisation.grids import CEILING, SEARCH_BASELINES, TRANSFER
from studies.page import make_table

__all__ = ["Transfers", "draw_transfers", "read_transfers", "tabulate_transfers", "tell_transfers"]

Efficiencies = NDArray[np.float64]


class Transfers(NamedTuple):
    """Efficiency in the test rooms of rungs.

    Attributes:
        learned: of the learner, (seeds,) in order of seeds, by the rungs trained and tested in.
        known: of agents that learn nothing, by rung tested in and label.
    """

    learned: Mapping[tuple[str, str], Efficiencies]
    known: Mapping[tuple[str, str], float]

    def get_best(self, rung: str) -> tuple[str, float]:
        """The best searcher in a rung, and its efficiency."""
        return max(((name, self.known[rung, name]) for name in SEARCH_BASELINES if (rung, name) in self.known),
                   key=lambda item: item[1])


def read_transfers(lines: Sequence[BaselineRun]) -> Transfers | None:
    """Lines of the part `transfer`; None unless every pair of rungs has `LEAST_RUNS` seeds and searchers beside it."""
    learned: dict[tuple[str, str], dict[int, float]] = {}
    known = {(line.rung, line.agent): line.efficiency for line in lines if not line.primitives}
    for line in lines:
        if line.primitives:
            source = line.rooms.split("/train")[0].rpartition("/")[2]
            learned.setdefault((source, line.rung), {})[line.seed] = line.efficiency
    pairs = [(source, target) for source in TRANSFER for target in TRANSFER]
    if any(len(learned.get(pair, ())) < LEAST_RUNS or not any((pair[1], name) in known for name in SEARCH_BASELINES)
           for pair in pairs):
        return None
    return Transfers({pair: np.array([learned[pair][seed] for seed in sorted(learned[pair])]) for pair in pairs}, known)


def tell_transfers(found: Transfers) -> list[str]:
    """Two sentences: against the best searcher in each rung, and training elsewhere against training there.

    Each is one family over its pairs of rungs (Student's t, Holm).
    """
    gains = {pair: values - found.get_best(pair[1])[1] for pair, values in found.learned.items()}
    better, worse = _sort(gains)
    at_home = [f"`{target}`" for source, target in better if source == target]
    abroad = [f"`{source}` to `{target}`" for source, target in better if source != target]
    parts = [f"in {count_nouns(len(at_home), 'rung')} of {len(TRANSFER)} that it was trained in"
             f" ({join_words(at_home)})" if at_home else f"in none of {len(TRANSFER)} rungs that it was trained in",
             f"in {len(abroad)} of {len(gains) - len(TRANSFER)} pairs with another rung"
             f" ({join_words(abroad)})" if abroad else
             f"in none of {len(gains) - len(TRANSFER)} pairs with another rung"]
    moved = {(source, target): _subtract(found, source, target) for source, target in found.learned if source != target}
    more, less = _sort(moved)
    told = [f"It reaches more than the best searcher {join_words(parts)}, and less in {len(worse)} of {len(gains)} "
            "pairs."]
    words = [f"`{target}` is learned better in {join_words(f'`{source}`' for source in sources)}"
             for target in TRANSFER if (sources := [source for source, other in more if other == target])]
    told.append(f"Of {len(moved)} pairs of two rungs, training in the other loses in {len(less)}, and "
                f"{f'gains in {len(more)}: {join_words(words)}' if more else 'gains in none'}.")
    return told


def _subtract(found: Transfers, source: str, target: str) -> Efficiencies:
    """Efficiency after training elsewhere less that after training there, seed by seed, (seeds,)."""
    other, own = found.learned[source, target], found.learned[target, target]
    count = min(len(other), len(own))
    return other[:count] - own[:count]


def _sort(differences: Mapping[tuple[str, str], Efficiencies]) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Pairs whose difference is shown, those above 0 and those below."""
    corrected = correct_by_holm([compare_pairs([values]).p for values in differences.values()])
    shown = [(pair, values.mean()) for (pair, values), p in zip(differences.items(), corrected, strict=True)
             if p < ALPHA]
    return [pair for pair, mean in shown if mean > 0], [pair for pair, mean in shown if mean < 0]


def tabulate_transfers(found: Transfers) -> str:
    """Mean efficiency: a row a rung trained in, a column a rung tested in; then those that learn nothing."""
    rows: list[list[Any]] = [[f"trained in `{source}`", *(f"{found.learned[source, target].mean():.2f}"
                                                          for target in TRANSFER)] for source in TRANSFER]
    rows.append(["the best searcher", *(f"{found.get_best(target)[1]:.2f}" for target in TRANSFER)])
    for name in CEILING:
        cells = [f"{found.known[target, name]:.2f}" if (target, name) in found.known else "-" for target in TRANSFER]
        if set(cells) != {"-"}:
            rows.append([f"`{name}`, which knows how graphs are drawn", *cells])
    return make_table(["", *(f"`{target}`" for target in TRANSFER)], rows)


def draw_transfers(found: Transfers) -> Figure:
    """A square a pair of rungs: what the learner reaches beyond the best searcher, in colour and number."""
    gains = np.array([[found.learned[source, target].mean() - found.get_best(target)[1] for target in TRANSFER]
                      for source in TRANSFER])
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(5.2, 4.0), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.subplots()
        most = float(np.abs(gains).max())
        axes.imshow(gains, cmap="RdBu", vmin=-most, vmax=most)
        for row, column in np.ndindex(gains.shape):
            value = gains[row, column]
            axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=9,
                      color=palette.BACKGROUND if abs(value) > 0.6 * most else palette.INK)
        axes.set_xticks(range(len(TRANSFER)), TRANSFER)
        axes.set_yticks(range(len(TRANSFER)), TRANSFER)
        axes.set(xlabel="tested in", ylabel="trained in", title="efficiency beyond the best searcher")
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
    return figure
