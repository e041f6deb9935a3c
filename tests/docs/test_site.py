"""The site says what the package says, and its tutorials show what they teach."""

from __future__ import annotations

import ast
import html
import importlib
import json
import re
from pathlib import Path

import pytest

import hrl_escape
from hrl_escape.agents.registry import (
    list_across_rooms_agents,
    list_agents,
    list_continuous_agents,
    list_hierarchy_agents,
    list_offline_agents,
)
from hrl_escape.agents.training.results import METRICS
from hrl_escape.cli import find_commands
from hrl_escape.env.presets import PRESETS, TAGS, make_env_name
from tests.forks import run_module

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def site(request: pytest.FixtureRequest) -> Path:
    """The site that `make docs` has built."""
    folder = request.config.getoption("site")
    if folder is None:
        pytest.skip("`make docs` builds the site, a warning being an error, and then reads it here")
    return Path(folder)


def read(page: Path) -> str:
    """The words of a page."""
    return " ".join(html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))).split())


@pytest.mark.nightly
def test_a_page_that_is_wrong_fails_the_build(tmp_path: Path):
    """The strictness is real; pages alone, without what the package says."""
    (tmp_path / "conf.py").write_text((ROOT / "docs/conf.py").read_text().replace(
        "Path(__file__).parent", f"Path({str(ROOT / 'docs')!r})").replace('"_static"', ""))
    (tmp_path / "index.md").write_text("# Page\n\n[gone](nowhere.md)\n")
    done = run_module("sphinx", "-W", "-q", "-D", "extensions=myst_parser,mathematics", tmp_path, tmp_path / "out")
    assert done.returncode != 0 and "nowhere.md" in done.stderr


PACKAGES = ("env", "env.pictures", "planning", "options", "agents", "hierarchies", "sets", "data", "benchmark",
            "checks")
"""The packages whose exported names are public."""


def list_public_names() -> list[str]:
    packages = [importlib.import_module(f"hrl_escape.{name}") for name in PACKAGES]
    return [f"{package.__name__}.{name}" for package in packages for name in package.__all__]


def test_every_source_has_its_page(site: Path):
    """A page that one of several writers fails to write is not a warning."""
    docs = ROOT / "docs"
    sources = [path.relative_to(docs) for path in docs.rglob("*.md")
               if not path.relative_to(docs).parts[0].startswith("_")]
    assert not [str(path) for path in sources if not (site / path.with_suffix(".html")).is_file()]


def test_every_public_name_is_in_the_reference(site: Path):
    """By its anchor, so that links to it work."""
    anchors = "".join(page.read_text() for page in (site / "api").glob("*.html"))
    assert [name for name in list_public_names() if f'id="{name}"' not in anchors] == []


def test_public_names_are_few_and_the_package_offers_only_them():
    names = list_public_names()
    assert len(names) <= 220
    assert set(hrl_escape.__all__) <= {name.rpartition(".")[2] for name in names}


def test_the_strip_is_what_its_episodes_are(site: Path):
    """`python docs/_ext/strip.py` writes it anew."""
    assert (site / "_images/strip.svg").read_bytes() == (ROOT / "docs/images/strip.svg").read_bytes()


def test_every_agent_has_a_page_with_equation_settings_and_curve(site: Path):
    for name in list_agents():
        page = site / "agents" / f"{name}.html"
        source = page.read_text(encoding="utf-8")
        assert "<math" in source, name
        assert "make_curves.py" in source and "_images/" in source, name
        assert name in read(page), name


def test_every_metric_and_preset_is_explained(site: Path):
    metrics = read(site / "metrics.html")
    assert all(name in metrics for name in METRICS)
    index = (site / "environments" / "index.html").read_text(encoding="utf-8")
    for name in PRESETS:
        card = read(site / "environments" / f"{name}.html")
        assert f"hrl_escape/{make_env_name(name)}-v1" in card and all(tag in card for tag in TAGS[name])
        assert f'href="{name}.html"' in index


def test_every_agent_is_a_row_of_the_table(site: Path):
    page = read(site / "agents" / "index.html").partition("All agents")[2]
    agents = (*list_agents(), *list_hierarchy_agents(), *list_offline_agents(), *list_continuous_agents(),
              *list_across_rooms_agents())
    assert [name for name in agents if name not in page] == []


def test_every_command_is_on_the_page_of_the_command_line(site: Path):
    commands = set(find_commands(ROOT / "hrl_escape/commands"))
    assert commands <= set(re.findall(r"<h2>([\w-]+)<", (site / "cli.html").read_text()))


TUTORIALS = {
    "first_escape": r"escaped: True, return 61 best known return: 66",
    "flat_gets_stuck": r"paper-two-button: random, 5,000 primitives: 0 escapes, "
                       r".* q-learning: returns \[(-1000, )+-1000\] "
                       r"smdp-q-learning\+primitives: returns \[-?\d+, .* [3-6]\d\] ",
    "options_by_hand": r"reached, reward -8, discounted -7.73, gamma\^k 0.923 to-the-left-wall: cannot start here",
    "own_environment": r"fetch: 11 primitives, reached.* "
                       r"smdp-q-learning\+primitives: mean return (?:19|2\d)\.\d after .* "
                       r"q-learning: mean return -200.0 .* random-options\+primitives: mean return -?1?\d\.\d",
    "compare_door_key": r"`smdp-dqn` is best: it has a return of 0\.\d+ .* door-key/report\.html",
    "compare_cart_pole": r"dqn: return \d+ .* PPO of SB3: return \d+ .* RandomSearch: return \d+ .* "
                         r"lean-with-the-pole: return \d+.* cart-pole/report\.html",
    "planned_options": r"plan: (\d+) primitives, return \d+ .*by options: escaped True, return \d+ with noise .* True",
    "smdp_q_learning": r"episode 0: return .*greedy: return 64 by press-button-1, then press-button-2, then go-to-exit",
    "maxq_taxi": r"optimum of the graph 7.93, of all policies 7.93 maxq-q: mean return (7\.[5-9]|8\.[0-3])",
    "goals": r"primitive 11: on\(button-1\) primitive 21: touch\(button-2\) .* primitive 34: exit "
             r"left to go: \[3. 0.\] left to go: \[2. 0.\] option-keyboard: first escape after \d+ primitives",
    "own_agent": r"own network: return -1000 untrained, [56]\d at the end variant: .* own agent: .*, [56]\d at the end",
    "generalise": r"learner: [12]\d of 20 escapes, (\d+) primitives .*random policy: "
                  r".*search baseline: 20 of 20 .*oracle: 20 of 20",
    "many_rooms": r"16 rooms at once: 12,\d+ primitives in \d+ s .*an unseen room: escaped after \d+ primitives",
    "continuous_goals": r"6,\d+ primitives, 2 evaluations",
    "plan_arm": r"[1-9]\d postures, joint margin .* places of the arm tested on the way escape: [12]\d primitives",
    "torchrl_options": r"5,120 decisions: +[1-9]\d+ escapes .* targets of long walks: -?\d+\.\d with durations",
    "own_play": r"142 primitives, 16 decisions, 3 episodes.* smdp-fitted-q\+primitives: return 64 after 36 primitives",
    "own_play_minigrid": r"agent: mean return 0\.9\d, \d+ primitives an episode random choice: mean return 0\.\d+",
    "language_model_tools": r"Wrong call: There is no such tool.* The game is over: escaped.* invalid_calls=1",
    "parts_of_a_hierarchy": r"[\d,]+ runs of design [0-9a-f]{16} ignore, flat: 2: .* reset, options \+ both: 2: \d\d, ",
    "new_puzzle": r"combination: button-4, button-3, button-1, button-2 plan: press-button-4, .* return [1-9]\d",
}


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_shows_what_it_teaches(site: Path, name: str):
    """The notebook was run, prints what it is about, and draws."""
    notebook = json.loads((site / "_downloads" / f"{name}.ipynb").read_text(encoding="utf-8"))
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    printed = " ".join("".join(text) for output in outputs if (text := output.get("text"))).split()
    assert re.search(TUTORIALS[name], " ".join(printed))
    kinds = {kind for output in outputs for kind in output.get("data", ())}
    assert kinds & {"image/svg+xml", "text/html"}
    page = (site / "tutorials" / f"{name}.html").read_text(encoding="utf-8")
    assert 'class="tutorial-picture"' in page and f"_downloads/{name}.ipynb" in page
    last = [output for cell in notebook["cells"] for output in cell.get("outputs", ())][-1]
    assert {"image/svg+xml", "text/html"} & set(last.get("data", ())), "the last expression is a picture"


def count_words_before_a_picture(page: str) -> int:
    """Words of an HTML page's article, its title included, above the first picture; a code block's count too."""
    article = page.partition('role="main"')[2]
    found = re.search(r'<img |<svg |<iframe |class="player|class="gallery', article)
    return len(re.sub(r"<[^>]+>", " ", article[: found.start()]).split()) if found else 10**6


def test_no_tutorial_and_no_guide_keeps_its_first_screen_without_a_picture(site: Path):
    """Some 110 words fill half of a laptop's screen."""
    guides = ("index", "quickstart", "options", "hierarchies", "planners", "ladder", "room-configuration", "puzzles",
              "viewer", "environments/index")
    pages = [f"tutorials/{name}" for name in TUTORIALS] + list(guides) + ["results/index"]
    words = {page: count_words_before_a_picture((site / f"{page}.html").read_text("utf-8")) for page in pages}
    assert {page: count for page, count in words.items() if count > 110} == {}
    assert count_words_before_a_picture('role="main" ' + "word " * 200 + "<img src>") == 200


def test_code_in_the_caption_of_a_player_is_code(site: Path):
    page = (site / "hierarchies.html").read_text(encoding="utf-8")
    assert "<code>get</code> the passenger" in page and "&lt;code&gt;" not in page


@pytest.mark.parametrize(("name", "most"), [("new_puzzle", 50), ("smdp_q_learning", 60),
                                             ("compare_door_key", 40), ("compare_cart_pole", 40)])
def test_a_tutorial_is_as_short_as_its_title_says(name: str, most: int):
    """Lines of code: no blank lines, comments or docstrings."""
    source = (ROOT / f"docs/tutorials/{name}.py").read_text()
    assert f"in {most} lines" in source or name.startswith("compare")
    documents = {number for node in ast.walk(ast.parse(source))
                 if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
                 for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    code = [number for number, line in enumerate(source.splitlines(), 1)
            if line.strip() and not line.lstrip().startswith("#") and number not in documents]
    assert len(code) <= most


def test_every_tutorial_is_on_the_site_and_tested():
    scripts = {path.stem for path in (ROOT / "docs/tutorials").glob("*.py")}
    assert scripts == set(TUTORIALS) == {path.stem for path in (ROOT / "docs/tutorials").glob("*.md")} - {"index"}


def test_figures_of_results_follow_the_theme(site: Path):
    page = (site / "results" / "do-options-help.html").read_text(encoding="utf-8")
    assert re.search(r'<img[^>]*class="only-light"[^>]*price\.svg', page)
    assert re.search(r'<img[^>]*class="only-dark"[^>]*price-dark\.svg', page)


def test_every_result_is_a_card_with_its_finding(site: Path):
    """The first words in bold on the result's own page."""
    index = (site / "results" / "index.html").read_text(encoding="utf-8")
    cards = index.split('class="finding-card')[1:]
    assert len(cards) == len(list((ROOT / "docs/results").glob("*.md"))) - 1
    first = re.search(r"\*\*(.+?)\*\*", (ROOT / "docs/results/do-options-help.md").read_text(encoding="utf-8"))
    assert first and first[1] in cards[0] and 'href="do-options-help.html"' in cards[0]
    assert "price.svg" in cards[0] and "price-dark.svg" in cards[0]
    assert all(len(re.sub(r"<[^>]*>", "", card.partition("</div>")[0]).split()) > 10 for card in cards)
