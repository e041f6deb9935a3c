"""The report: a page that stands alone and says what it must, and the files beside it."""

from __future__ import annotations

import csv
import dataclasses
import html
import json
import re
import shlex
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hrl_escape import __version__
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.launching.local import Failure
from hrl_escape.benchmark.reporting.figures import draw_curves
from hrl_escape.benchmark.reporting.report import choose_replays, describe_kind, write_markdown, write_report
from hrl_escape.benchmark.statistics import compute_iqm
from hrl_escape.benchmark.summary import Summary
from hrl_escape.benchmark.verdict import write_verdict
from hrl_escape.cli import main

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
COMMAND = "hrl-escape compare small.toml --runs 2 --out '/tmp/a b'"


class Page(HTMLParser):
    """Tags with their attributes, visible text, and the page's data."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text, self.data = "", ""
        self._inside = ""
        self.feed(source)
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = "data" if dict(attrs).get("id") == "data" else tag

    def handle_data(self, data: str) -> None:
        if self._inside == "data":
            self.data += data
        elif self._inside not in ("script", "style"):
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""


@pytest.fixture(scope="module")
def summary(finished: Comparison) -> Summary:
    return write_report(finished, COMMAND)


@pytest.fixture(scope="module")
def source(finished: Comparison, summary: Summary) -> str:
    return (finished.out / "report.html").read_text()


@pytest.fixture(scope="module")
def page(source: str) -> Page:
    return Page(source)


# --- it stands alone -------------------------------------------------------------------


@pytest.mark.nightly
def test_the_page_fetches_nothing(source: str, page: Page):
    assert not re.search(r"https?:|//[a-z0-9.-]+\.[a-z]{2,}/|@import|url\(|\bfetch\(|XMLHttpRequest|import\(", source)
    sources = [attributes[name] for _, attributes in page.tags for name in ("src", "href", "srcset", "data")
               if attributes.get(name)]
    assert sources and all(str(value).startswith("data:image/svg+xml;base64,") for value in sources)
    assert not {tag for tag, _ in page.tags} & {"link", "iframe", "object", "embed", "base"}
    policy = next(attributes["content"] for tag, attributes in page.tags if "http-equiv" in attributes)
    assert str(policy).startswith("default-src 'none'")


@pytest.mark.nightly
def test_the_same_runs_write_the_same_page(finished: Comparison, source: str):
    write_report(finished, COMMAND)
    assert (finished.out / "report.html").read_text() == source


# --- it says what it must --------------------------------------------------------------


@pytest.mark.nightly
def test_the_page_begins_with_the_verdict(finished: Comparison, summary: Summary, page: Page):
    """Labels are shown as the display names of their specs."""
    titles = {agent.label: agent.title for agent in finished.grid.agents}

    def show(text: str) -> str:
        return re.sub("`([^`]*)`", lambda label: titles.get(label[1], label[1]), text)

    for sentence in write_verdict(summary):
        assert show(sentence.text) in page.text
    headline = show(write_verdict(summary)[0].text)
    assert page.text.index(headline) < page.text.index("Learning curves") < page.text.index("What was run")


def test_the_page_names_settings_instances_versions_and_command(finished: Comparison, page: Page):
    assert COMMAND in page.text
    for instance in (place.instance for place in finished.places):
        assert instance.id in page.text
    for name in ("hrl-escape", "torch", "pybullet", "ompl", "python"):
        assert re.search(rf"{name} \d+\.\d+", page.text), name
    assert f"hrl-escape {__version__}" in page.text
    for run, _ in finished.runs:
        for name, value in run.settings.items():
            assert f"{name}{json.dumps(value)}" in page.text  # two cells of a table
    assert "0 to 1" in page.text and "600 primitives" in page.text


def test_the_table_gives_every_agents_score_and_interval(summary: Summary, page: Page):
    for agent in summary.agents:
        row = f"{agent.efficiency.value:.3f} {agent.efficiency.low:.3f} to {agent.efficiency.high:.3f}"
        assert row in page.text, agent.label


def test_the_table_says_what_an_agent_chooses_among():
    told = {text: describe_kind(AgentSpec.parse(text)) for text in (
        "dqn", "smdp-dqn+primitives", "smdp-dqn", "smdp-dqn+reactive+primitives", "random-options", "oracle")}
    assert told == {"dqn": "primitives only", "smdp-dqn+primitives": "options and primitives",
                    "smdp-dqn": "options only", "smdp-dqn+reactive+primitives": "options and primitives",
                    "random-options": "random policy, options only", "oracle": "reference, primitives only"}
    ancestors = AgentSpec("smdp-dqn", options=OptionsView(option_set="press-with-ancestors"))
    assert describe_kind(ancestors) == "options only, with ancestors"


def test_the_rooms_picture_is_a_drawing_of_it(page: Page):
    import base64

    (picture,) = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    drawing = ElementTree.fromstring(base64.b64decode(str(picture).split(",")[1]))
    assert drawing.tag.endswith("svg") and len(list(drawing.iter())) > 100


def test_the_page_carries_curves_against_three_axes_profiles_and_replays(summary: Summary, page: Page):
    data = json.loads(page.data)
    assert [agent["label"] for agent in data["agents"]] == [agent.label for agent in summary.agents]
    for shown, agent in zip(data["agents"], summary.agents, strict=True):
        for name in ("primitives", "decisions", "seconds"):
            assert shown["curve"][name] == pytest.approx(getattr(agent.curve, name), rel=1e-4)
        for name, lines in agent.curve.metrics.items():
            assert np.allclose(shown["curve"][name], lines, rtol=1e-4, atol=1e-6)
    for agent in summary.agents:
        kinds = [kind for replay in data["replays"] if replay["agent"] == agent.label for kind in replay["kinds"]]
        assert sorted(kinds) == ["best", "median"]
    assert data["rooms"][0]["options"] == ["go-to-exit", "press-button-1", "press-button-2"]


def test_replays_are_the_best_and_the_median_episode_of_all_runs(finished: Comparison):
    chosen = choose_replays(finished)
    for label in {run.agent.label for run, _ in finished.runs}:
        returns = sorted((value for run, result in finished.runs if run.agent.label == label
                          for value in result.evaluations[-1].returns), reverse=True)
        mine = {kind: replay["return"] for replay in chosen if replay["agent"] == label for kind in replay["kinds"]}
        assert mine == {"best": returns[0], "median": returns[2]}  # six episodes: the better of the two in the middle


NASTY = "</script><script>window.pwned=1</script>`<img src=x onerror=window.pwned=2> @DATA@ {{ data }}"


@pytest.fixture(scope="module")
def nasty(finished: Comparison, tmp_path_factory) -> str:
    """The page of a comparison whose every name is code."""
    out = tmp_path_factory.mktemp("nasty")
    agents = tuple(dataclasses.replace(agent, label=NASTY if n == 0 else agent.label)
                   for n, agent in enumerate(finished.grid.agents))
    grid = dataclasses.replace(finished.grid, agents=agents, name=NASTY, description=NASTY)
    runs = []
    for run, result in finished.runs:
        named = dataclasses.replace(run, grid=grid, room=NASTY)
        shutil.copytree(finished.out / "runs" / run.folder, out / "runs" / named.folder)
        runs.append((named, result))
    failures = (Failure(runs[0][0], NASTY, NASTY),)
    changed = dataclasses.replace(finished, grid=grid, runs=tuple(runs), out=out, failures=failures)
    write_report(changed, NASTY)
    return (out / "report.html").read_text()


def test_labels_are_text_never_markup(nasty: str, source: str):
    assert nasty.count("<script") == source.count("<script") and nasty.count("</script>") == source.count("</script>")
    assert nasty.count("<title>") == 1
    page = Page(nasty)
    assert not [tag for tag, _ in page.tags if tag == "img" and tag not in [found for found, _ in Page(source).tags]]
    assert not [attributes for _, attributes in page.tags if any(name.startswith("on") for name in attributes)]
    assert json.loads(page.data)["agents"][0]["label"] == NASTY
    assert page.text.count("onerror=window.pwned=2>") > 5, "shown as text"


@pytest.mark.skipif(CHROMIUM is None, reason="needs a Chromium (Debian: apt install chromium)")
def test_a_page_of_hostile_names_runs_nothing_in_a_browser(nasty: str, tmp_path: Path):
    told = "<script>addEventListener('load', () => setTimeout(() => {document.title = 'pwned: ' + window.pwned}, 500))"
    (tmp_path / "page.html").write_text(nasty.replace("</body>", f"{told}</script></body>"))
    assert "<title>pwned: undefined</title>" in dump_page(tmp_path / "page.html", tmp_path)


# --- the files beside it ---------------------------------------------------------------


def test_results_csv_has_a_row_a_run_from_which_the_table_follows(finished: Comparison, summary: Summary):
    with open(finished.out / "results.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(finished.runs)
    for agent in summary.agents:
        for name, value in (("efficiency", agent.efficiency.value), ("return_score", agent.score.value)):
            finals = [float(row[name]) for row in rows if row["agent"] == agent.label]
            assert compute_iqm([np.array(finals)]) == pytest.approx(value, abs=1e-15)
    for row in rows:
        span = float(row["best"]) - float(row["worst"])
        assert float(row["return_score"]) == pytest.approx((float(row["return"]) - float(row["worst"])) / span)


def test_curves_csv_has_a_row_an_evaluation(finished: Comparison):
    with open(finished.out / "curves.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(result.evaluations) for _, result in finished.runs)
    with open(finished.out / "timings.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == len(rows)


def test_figures_are_svg_and_markdown_has_the_verdict(finished: Comparison, summary: Summary):
    figures = sorted(path.name for path in (finished.out / "figures").iterdir())
    assert figures == sorted([f"{metric}-against-{axis}.svg" for metric in ("efficiency", "success", "score")
                              for axis in ("primitives", "decisions", "seconds")]
                             + ["performance-profile.svg", f"room-{finished.places[0].id}.svg"])
    for name in figures:
        assert ElementTree.parse(finished.out / "figures" / name).getroot().tag.endswith("svg")
    text = (finished.out / "summary.md").read_text()
    assert text.startswith(f"# small\n\n**{write_verdict(summary)[0].text}**") and COMMAND in text
    assert text.count("\n| ") == len(summary.agents) + 1
    assert f"{finished.grid.runs} runs in one room." in text
    write_markdown(dataclasses.replace(summary, rooms=summary.rooms * 3), write_verdict(summary), COMMAND,
                   finished.out / "thrice.md")
    assert "runs in each of 3 rooms." in (finished.out / "thrice.md").read_text()


def test_markdown_shows_names_from_files_as_they_are(summary: Summary, tmp_path: Path):
    hostile = "<script>x</script>|[a](b)\n# <img src=x>"
    grid = dataclasses.replace(summary.grid, name=hostile)
    verdict = [dataclasses.replace(sentence, text=f"{hostile} {sentence.text}") for sentence in write_verdict(summary)]
    rooms = tuple(dataclasses.replace(room, name=hostile) for room in summary.rooms)
    write_markdown(dataclasses.replace(summary, grid=grid, rooms=rooms), verdict, f"x '{hostile}\n```\n<b>'",
                   tmp_path / "x.md")
    before, _, after = (tmp_path / "x.md").read_text().partition("````console\n")
    assert "<" not in before and "|[" not in before and "\n# " not in before
    assert after.splitlines()[1] == "````" and after.count("\n") == 2


# --- it works in a browser -------------------------------------------------------------

PROBE = """
<script>
window.addEventListener("load", () => {
  const problems = [], report = {};
  const press = (selector) => document.querySelector(selector).click();
  const count = (selector) => document.querySelectorAll(selector).length;
  report.lines = count("#curve-chart polyline");
  report.names = [...document.querySelectorAll("#curve-chart .name")].map((n) => n.textContent);
  report.title = document.querySelector("#curve-chart .title").textContent;
  report.apart = spread([290, 20, 20, 20, 20, 20, 20, 20, 291, 150], 17, 18, 294);
  press('[data-value="decisions"]');
  report.switched = document.querySelector("#curve-chart .title").textContent;
  const rest = ["gap", "progress", "success", "length", "score", "seconds", "close", "best"];
  for (const value of rest) press(`[data-value="${value}"]`);
  press(".legend button");
  report.left = count("#curve-chart polyline");
  report.profile = count("#profile-chart polyline");
  report.cards = count(".card canvas");
  report.players = players.map((player) => {
    const c = player.canvas;
    const pixels = () => c.getContext("2d").getImageData(0, 0, c.width, c.height).data.join();
    player.show(0);
    const first = pixels();
    player.show(player.count);
    return { count: player.count, moved: pixels() !== first, words: player.now.textContent };
  });
  const out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify(report);
  document.body.append(out);
});
</script>
"""


def dump_page(path: Path, folder: Path) -> str:
    """The document that a browser without network makes of a page, scripts run."""
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1280,800", "--dump-dom",
         "--proxy-server=127.0.0.1:9", f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=3000",
         path.as_uri()],
        capture_output=True, text=True, timeout=600,
    )
    return done.stdout


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="needs a Chromium")
def test_the_page_works_in_a_browser_without_network(summary: Summary, source: str, tmp_path: Path):
    probed = tmp_path / "probed.html"
    probed.write_text(source.replace("</body>", PROBE + "</body>"))
    shown = dump_page(probed, tmp_path)
    found = re.search(r'<pre id="probe">(.*?)</pre>', shown, re.DOTALL)
    assert found, shown[-2000:]
    report = json.loads(found[1])
    labels = [agent.spec.title for agent in summary.agents]
    assert report["lines"] == len(labels) and sorted(report["names"]) == sorted(labels)
    assert report["title"] == "primitives of training" and report["switched"] == "decisions of training"
    assert report["left"] == report["profile"] == len(labels) - 1
    assert report["cards"] == len(labels)
    *seven, middle, last_but_one, last = sorted(report["apart"])
    assert seven == [18 + 17 * place for place in range(7)] and middle == 150 and last_but_one <= last - 17 <= 294 - 17
    assert report["apart"][0] == last_but_one and report["apart"][8] == last
    for player in report["players"]:
        assert player["moved"] and player["words"].endswith(f"of {player['count']:,}")


FRAMED = """
<iframe id="page" style="width:{width}px;height:900px;border:0"></iframe>
<script>
const frame = document.getElementById("page");
frame.srcdoc = JSON.parse(document.querySelector("pre").textContent);
frame.onload = () => {{
  const page = frame.contentDocument, right = (node) => node.getBoundingClientRect().right;
  const late = (selector, edge) => [...page.querySelectorAll(selector)].filter((node) => right(node) > edge + 1).length;
  document.querySelector("pre").textContent = JSON.stringify({{
    scrolls: page.documentElement.scrollWidth - frame.clientWidth,
    cut_words: late("#curve-chart text", right(page.querySelector("#curve-chart svg"))),
    cut_cells: late("#results > .scroll th, #results > .scroll td", right(page.querySelector("#results"))),
    size: parseFloat(frame.contentWindow.getComputedStyle(page.querySelector("#curve-chart text")).fontSize)
      * page.querySelector("#curve-chart svg").getBoundingClientRect().width
      / page.querySelector("#curve-chart svg").viewBox.baseVal.width,
  }});
}};
</script>"""


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="needs a Chromium")
@pytest.mark.parametrize("width", [pytest.param(1280, marks=pytest.mark.slow), 390])
def test_the_page_fits_a_laptop_and_a_phone(summary: Summary, source: str, tmp_path: Path, width: int):
    """With a long name, nothing is cut, nothing but tables scrolls, and words in charts are 9 pixels high or more."""
    longest = AgentSpec.parse("smdp-ppo+objects+memory+primitives").title
    content = json.dumps(source.replace(summary.agents[-1].spec.title, longest))
    (tmp_path / "framed.html").write_text(f"<pre>{html.escape(content)}</pre>{FRAMED.format(width=width)}")
    found = re.search(r"<pre>(.*?)</pre>", dump_page(tmp_path / "framed.html", tmp_path), re.DOTALL)
    assert found and len(found[1]) < 1000, "the page was not measured"
    measured = json.loads(html.unescape(found[1]))
    assert measured["scrolls"] <= 0 and measured["cut_words"] == 0 and measured["cut_cells"] == 0, measured
    assert measured["size"] >= 9


def test_what_learns_nothing_is_one_thin_line_without_a_band(summary: Summary, page: Page):
    levels = {agent.label for agent in summary.agents if agent.spec.is_reference or not agent.spec.learns}
    titles = {agent.spec.title for agent in summary.agents if agent.label in levels}
    assert levels and {agent.label for agent in summary.agents} - levels
    assert {agent["label"] for agent in json.loads(page.data)["agents"] if agent["is_level"]} == levels
    axes = draw_curves(summary, "efficiency", "primitives").axes[0]
    assert len(axes.collections) == len(summary.agents) - len(levels), "a band for each that learns"
    widths = {str(line.get_label()): line.get_linewidth() for line in axes.lines}
    assert max(widths[title] for title in titles) < min(widths[title] for title in set(widths) - titles)


@pytest.mark.nightly
def test_the_page_names_commands_that_show_the_best_run_in_three_dimensions(finished: Comparison, source: str,
                                                                          tmp_path: Path):
    commands = re.findall(r"hrl-escape (?:watch|record) .*", html.unescape(source))
    assert [shlex.split(command)[1] for command in commands] == ["watch", "record"]
    arguments = shlex.split(commands[1])[1:-1] + [str(tmp_path / "run.html")]
    assert main(arguments) == 0
    assert (tmp_path / "run.html").stat().st_size > 100_000
