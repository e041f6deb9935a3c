"""Predicted courses of options."""

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.options.meta_actions import make_meta_options
from hrl_escape.viewer.watch.watch import Previewer


def test_a_preview_that_cannot_start_says_so(clutter):
    previewer = Previewer(clutter, make_meta_options(clutter))
    env = EscapeRoomEnv(instance=clutter)
    env.reset(seed=0)
    preview = previewer.preview("go-to-exit", env.get_state())
    assert preview.problem == "it cannot start here" and len(preview.states) == 1
