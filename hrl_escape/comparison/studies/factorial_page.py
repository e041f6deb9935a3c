"""The page docs/results/why-it-worsens.md: main effects of the screening designs, their paths, and the conclusions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.comparison.studies.factorial import FACTORS
from hrl_escape.comparison.studies.factorial_cause import (
    FEWEST_ROOMS,
    FEWEST_SEEDS,
    Findings,
    analyse,
    conclude,
    tell_first_look,
    tell_fresh_runs,
)
from hrl_escape.comparison.studies.factorial_effects import SIGNIFICANT, MainEffect, Screening, mark_gaps
from hrl_escape.comparison.studies.paper_figures import FIGURE_STYLE, finish_axes
from hrl_escape.comparison.studies.raw import BINS, RawRun
from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.maps import save_figure
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, join_words

__all__ = ["write_factorial_page"]

_COMMAND = "hrl-escape experiment factorial"
FIFTHS = 5


def write_factorial_page(results: Mapping[str, Sequence[RawRun]], docs: Path,
                         fresh: Mapping[str, Sequence[RawRun]] | None = None) -> dict[str, Findings]:
    """Write the page and its figures; returns the findings by algorithm.

    Args:
        results: algorithm -> runs of its screening.
        docs: folder of the page.
        fresh: algorithm -> runs in rooms and with seeds that nobody had tried before, of those that have any.

    Raises:
        ComparisonError: runs are missing.
        FileWriteError: a file cannot be written.
    """
    found = {name: analyse(Screening.make(name, runs)) for name, runs in results.items()}
    for name, findings in found.items():
        save_figure(docs / "figures" / f"why-{name}.svg", draw_effects(findings.effects))
    again = {name: Screening.make(name, runs) for name, runs in (fresh or {}).items()}
    write_text(docs / "why-it-worsens.md", "\n".join(_write_lines(found, again)))
    return found


def draw_effects(effects: Sequence[MainEffect]) -> Figure:
    """Main effects on the area with their intervals over rooms; a dot a room."""
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(6.2, 3.2), facecolor=palette.BACKGROUND, layout="constrained")
        axes = figure.subplots()
        at = np.arange(len(effects))[::-1]
        reach = np.array([[effect.test.difference - effect.test.low, effect.test.high - effect.test.difference]
                          for effect in effects]).T
        axes.errorbar([effect.test.difference for effect in effects], at, xerr=reach, fmt="o", markersize=5,
                      color=palette.LINES[0], ecolor=palette.INK, capsize=2, label="mean over rooms, 95 % interval")
        for number, (place, effect) in enumerate(zip(at, effects, strict=True)):
            axes.plot(effect.rooms, [place - 0.25] * len(effect.rooms), ".", markersize=4, color=palette.LINES[4],
                      label=None if number else "a room")
        axes.axvline(0, color=palette.MUTED, linewidth=0.8)
        axes.set_yticks(at, [effect.factor for effect in effects])
        axes.set_xlabel("effect on the area under the efficiency curve", color=palette.INK)
        finish_axes(axes)
        axes.xaxis.set_major_formatter("{x:+.1f}")
        axes.grid(visible=False, axis="y")
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


# --- the page --------------------------------------------------------------------------------


def _write_lines(found: Mapping[str, Findings], again: Mapping[str, Screening]) -> list[str]:
    names = join_words(name.upper() for name in found)
    lines = [f"# Why {names} {'gets' if len(found) == 1 else 'get'} worse with meta-actions", "",
             "The response is the area under the efficiency curve of training episodes, from 0 (never escaping) to 1 "
             f"(always as fast as the best known). An effect is shown where p < {SIGNIFICANT:g} after correction for "
             "all factors of an algorithm (Holm); it is tested over rooms, as a random factor, so that it is claimed "
             "of rooms like these. The sentences are chosen by rule from the tables below.", ""]
    lines += [f"- **{name}**. {' '.join(conclude(findings))}" for name, findings in found.items()]
    lines += _write_replication(found, again)
    lines += ["", "## What was run", "",
              "A folded-over Plackett-Burman design of 24 agents: main effects are free of interactions of two "
              "factors, which are mixed with each other and not told. Low is what keras-rl 0.4.2 and the published "
              "program did, high what the recipe `corrected` does; the first agent is low in all, the last high in "
              "all. The clock of schedules is in primitives throughout, epsilon falls over three quarters of the "
              "budget, and keras-rl's late flag at the end of an episode (`late_terminal`) is left out, since replay "
              "knows none. Rooms are instances of one schematic: three buttons in a chain, 12 x 12 m, at most 300 "
              "primitives an episode. Their size, the budget and the fall of epsilon were set after pilots of sarsa's "
              "corrected and mixed agents in two of them, the first and the third; no other setting was tuned in "
              "them.", ""]
    lines += [part for name, findings in found.items() if (told := tell_first_look(name, findings))
              for part in (told, "")]
    for name, findings in found.items():
        lines += _write_design(name, findings.screening)
    for name, findings in found.items():
        lines += [f"## {name}", "", f"![Main effects on {name}](figures/why-{name}.svg)", "",
                  *_write_effects(findings), *_write_sufficient(findings), *_write_paths(findings),
                  *_write_course(findings.screening)]
    missing = [name for name in FACTORS if name not in found]
    lines += [*([f"{join_words(name.upper() for name in missing)} is not on this page; its design stands in the "
                 f"command, `--algorithms {' '.join(missing)}`, and was not run.", ""] if missing else []),
              "## Make it again", "",
              "Finished runs are kept, and with `--from-raw` nothing is trained. With fewer than "
              f"{FEWEST_SEEDS} training seeds a cell or {FEWEST_ROOMS} rooms the page concludes nothing. With another "
              "first seed rooms are others, too, and the runs are held against those that are published.", "",
              "```console", *(_make_command(name, findings.screening) for name, findings in found.items()),
              *(_make_command(name, screening) for name, screening in again.items()), "```", ""]
    return lines


def _write_replication(found: Mapping[str, Findings], again: Mapping[str, Screening]) -> list[str]:
    """Sentences on fresh rooms and seeds; none where there are no such runs."""
    told = [f"- **{name}** ({len(screening.rooms)} rooms, {sum(map(len, screening.runs.values()))} runs, from seed "
            f"{min(screening.seeds)} on). {tell_fresh_runs(screening, found[name])}"
            for name, screening in again.items()]
    return ["", "With training seeds and rooms that nobody had tried before; what is shown above is tested, or all "
            "where nothing is:", "", *told] if told else []


def _make_command(name: str, screening: Screening) -> str:
    budget = next(iter(screening.runs.values()))[0].budget
    first = f" --first-seed {min(screening.seeds)}" if min(screening.seeds) else ""
    return (f"{_COMMAND} --algorithms {name}{first} --rooms {len(screening.rooms)} --runs {len(screening.seeds)} "
            f"--primitives {budget}")


def _write_design(name: str, screening: Screening) -> list[str]:
    total = sum(map(len, screening.runs.values()))
    return [f"**{name}**: {len(screening.design)} agents in {len(screening.rooms)} rooms with "
            f"{count_nouns(len(screening.seeds), 'training seed')}, {total} runs of "
            f"{next(iter(screening.runs.values()))[0].budget:,} primitives.", "",
            "| factor | low: the published program | high: corrected |", "|---|---|---|",
            *(f"| {factor.name} | {factor.paper} | {factor.corrected} |" for factor in FACTORS[name]), ""]


def _write_effects(findings: Findings) -> list[str]:
    rooms = findings.screening.rooms
    lines = ["Main effects, low to high, with their 95 % intervals over rooms, which are not corrected; p is. The last "
             "column is the effect on how much efficiency changes from the beginning of a run to its end, with an "
             "interval and without a test.", "",
             f"| factor | on the area | p | {' | '.join(rooms)} | on its change |", "|---" * (len(rooms) + 4) + "|"]
    for effect, change in zip(findings.effects, findings.changes, strict=True):
        p = "< 0.001" if effect.p < 0.001 else f"{effect.p:.3f}"
        here = " | ".join(f"{value:+.2f}" for value in effect.rooms)
        lines.append(f"| {effect.factor} | {_tell_interval(effect)} | {p} | {here} | {_tell_interval(change)} |")
    return [*lines, ""]


def _tell_interval(effect: MainEffect) -> str:
    test = effect.test
    return f"{test.difference:+.3f} ({test.low:+.3f} to {test.high:+.3f})"


def _write_sufficient(findings: Findings) -> list[str]:
    if not findings.sufficient:
        return []
    words = {True: "yes", False: "no", None: "not shown"}
    return ["Corrections alone, the others of these as published: do they bring more than three quarters of what all "
            "of them bring together?", "", f"| {' | '.join(findings.sufficient)} |",
            "|---" * len(findings.sufficient) + "|",
            f"| {' | '.join(words[verdict] for verdict in findings.sufficient.values())} |", ""]


def _write_paths(findings: Findings) -> list[str]:
    if not findings.paths:
        return []
    lines = ["What the logs carry of these effects: the factor's effect on a quantity, the slope of the area on that "
             "quantity with all factors held fixed, and their product, whose interval (bootstrap over rooms and "
             "seeds) is corrected for all lines. The entropy of epsilon-greedy choices is set by its schedule, and "
             "what moves quantity and area together would look like a path; a repeat is in doublings.", "",
             "| factor | quantity | moves it by | slope of the area | product |", "|---|---|---|---|---|"]
    lines += [f"| {path.factor} | {path.mediator} | {path.moves:+.3f} | {path.slope:+.3f} | {path.carries:+.3f} "
              f"({path.low:+.3f} to {path.high:+.3f}) |" for path in findings.paths]
    return [*lines, ""]


def _write_course(screening: Screening) -> list[str]:
    """Training of the two recipes, fifth by fifth."""
    lines = ["The two recipes in training, means over rooms and seeds in each fifth of a run: as published, and with "
             "every factor corrected.", "",
             "| quantity | recipe | " + " | ".join(f"fifth {n + 1}" for n in range(FIFTHS)) + " |",
             "|---" * (FIFTHS + 2) + "|"]
    for title, key, digits in (("efficiency", "training_efficiencies", 2), ("entropy, nats", "entropy", 2),
                               ("longest repeat, decisions", "longest_repeat", 0), ("greedy choices", "greedy", 2)):
        for recipe, row in (("published", 0), ("corrected", -1)):
            values = np.array([mark_gaps(getattr(block[row], key)) for block in screening.runs.values()])
            fifths = values.reshape(len(values), FIFTHS, BINS // FIFTHS)
            means = [_average(fifths[:, number].ravel()) for number in range(FIFTHS)]
            lines.append(f"| {title} | {recipe} | " + " | ".join(f"{mean:.{digits}f}" for mean in means) + " |")
    return [*lines, ""]


def _average(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
