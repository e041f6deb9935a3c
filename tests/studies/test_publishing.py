"""Result pages: claims are held against numbers, pages have one form, figures come in both themes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from studies.__main__ import main
from studies.figures import THEMES, Theme, make_figure
from studies.publishing import (
    ResultPage,
    Rules,
    UnsupportedClaimError,
    check_form,
    list_pages,
    load_findings,
    load_page,
    render_page,
)
from studies.study import Findings
from studies.tables import format_interval

RESULTS = Path(__file__).parents[2] / "docs" / "results"
WORDS = """# Do keys help?

**{% claim "keys-help" %}Agents with keys escape {{ doors.factor | num(".0f") }} times sooner.{% endclaim %}**

{{ figure("keys", "Primitives to the first escape") }}

Lines are medians over rooms.

**Takeaway.** {% claim "take-keys" %}Give an agent its keys, {{ doors.gain | interval("+.2f") }}.{% endclaim %}

## Setup

- Rooms with a door.
- {{ "smdp-dqn" | title }}.

Terms: {term}`option`.

## Limits

- One kind of room.

## Without keys

More words.

<details><summary>Numbers</summary>

{{ tables.doors }}

</details>
"""
RULES: Rules = {"keys-help": lambda n: n.doors.factor > 2, "take-keys": lambda n: n.doors.gain.low > 0}


def draw(theme: Theme) -> Figure:
    return make_figure(theme, lambda axes: axes.plot([1, 2], color=theme.lines[0]))


def make_findings(factor: float = 3.0, low: float = 0.1) -> dict[str, Findings]:
    numbers = SimpleNamespace(factor=factor, gain=SimpleNamespace(mean=0.2, low=low, high=0.3))
    return {"doors": Findings(numbers, {"doors": "| a |\n|---|\n| 1 |"}, {"keys": draw})}


def plant(folder: Path, words: str = WORDS, rules: Rules = RULES) -> ResultPage:
    template = folder / "keys.md.j2"
    template.write_text(words)
    return ResultPage("keys", ("doors",), rules, template)


def test_numbers_fill_the_words(tmp_path: Path):
    text, figures = render_page(plant(tmp_path), make_findings())
    assert "**Agents with keys escape 3 times sooner.**" in text
    assert "Give an agent its keys, +0.20 (+0.10 to +0.30)." in text
    assert "![Primitives to the first escape](figures/keys.svg)" in text and figures == ["keys"]
    assert "- DQN over options." in text and "| 1 |" in text


def test_a_claim_that_the_data_do_not_support_names_its_sentence(tmp_path: Path):
    with pytest.raises(UnsupportedClaimError) as caught:
        render_page(plant(tmp_path), make_findings(factor=1.5, low=-0.1))
    said = str(caught.value)
    assert "keys.md.j2:3: the data do not support 'Agents with keys escape 2 times sooner.' (rule 'keys-help')" in said
    assert "keys.md.j2:9:" in said and "'take-keys'" in said


@pytest.mark.parametrize(("words", "rules", "said"), [
    (WORDS, {"keys-help": RULES["keys-help"]}, "no rule is named 'take-keys'"),
    (WORDS, {**RULES, "more": lambda n: True}, "rule 'more' guards no sentence"),
    (WORDS.replace('{% claim "keys-help" %}', "").replace("{% endclaim %}**", "**"), {"take-keys": RULES["take-keys"]},
     "no rule guards the finding"),
    (WORDS.replace("times sooner", "times sooner than 4 agents"), RULES, "more than 1 number"),
    (WORDS.replace("times sooner", "times sooner" + " and sooner" * 10), RULES, "the finding has 27 words"),
    (WORDS.replace("- Rooms with a door.\n", "- Rooms.\n" * 3), RULES, "the setup has more than three lines"),
    (WORDS.replace("its keys, ", "its keys. They help "), RULES, "the takeaway has more than one sentence"),
    (WORDS.replace("## Limits\n\n- One kind of room.\n\n", ""), RULES, "the page is not in the order"),
])
def test_a_page_has_the_common_form_and_a_rule_for_each_claim(tmp_path: Path, words: str, rules: Rules, said: str):
    with pytest.raises(UnsupportedClaimError, match=said):
        render_page(plant(tmp_path, words, rules), make_findings())


def test_a_figure_has_the_colours_of_its_page():
    light, dark = (draw(theme) for theme in THEMES)
    for figure, theme in zip((light, dark), THEMES, strict=True):
        (axes,) = figure.axes
        assert axes.xaxis.label.get_color() == theme.ink
        figure.canvas.draw()
        assert {tick.label1.get_color() for tick in axes.xaxis.get_major_ticks()} == {theme.ink}
        assert to_hex(figure.get_facecolor(), keep_alpha=True).endswith("00")


def test_an_interval_is_written_with_its_mean():
    assert format_interval(SimpleNamespace(mean=26.4, low=19.0, high=36.0), ".0f") == "26 (19 to 36)"


@pytest.mark.nightly_for("all-algorithms")
@pytest.mark.parametrize("name", list_pages())
def test_a_published_page_is_what_its_data_give(name: str):
    """The claims of each page are held against the committed raw data here."""
    page = load_page(name)
    text, figures = render_page(page, {study: load_findings(study) for study in page.studies})
    assert text == (RESULTS / f"{name}.md").read_text(encoding="utf-8")
    shown = [RESULTS / f"figures/{figure}{theme.suffix}.svg" for figure in figures for theme in THEMES]
    assert [path.name for path in shown if not path.is_file()] == []


@pytest.mark.parametrize("name", list_pages())
def test_words_of_a_page_do_not_depend_on_its_numbers(name: str):
    """A person rewrites a sentence whose rule breaks; no template chooses among sentences."""
    assert "{% if" not in load_page(name).template.read_text(encoding="utf-8")


def test_an_unknown_page_is_refused(capsys: pytest.CaptureFixture[str]):
    assert main(["pages", "do-option-help"]) == 2
    assert "unknown result page 'do-option-help'" in capsys.readouterr().err


def test_a_page_without_a_finding_is_no_page():
    assert check_form("# Title\n\nWords.\n", []) != []
