"""Names of pictures: endings are read in any case, and others refused before anything is drawn."""

from pathlib import Path

import pytest

from hrl_escape.errors import UnsupportedError
from hrl_escape.figures import check_picture_name


@pytest.mark.parametrize("name", ["plan.svg", "plan.SVG", "a.b/plan.Png", "plan.pdf", "escape.MP4"])
def test_pictures_are_told_by_their_endings(name):
    check_picture_name(Path(name), "mp4")


@pytest.mark.parametrize("name", ["plan", "plan.jpg", "svg", "plan.svg.txt", ".svg", "escape.gif"])
def test_other_names_are_refused(name):
    with pytest.raises(UnsupportedError, match=f"^{name}: the name of a picture must end in .png, .svg, .pdf$"):
        check_picture_name(Path(name))
