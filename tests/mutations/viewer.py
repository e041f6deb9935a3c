"""Bugs of the viewer: playing, watching, and who may do so."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "any page's socket is let in",
        "viewer/guard.py",
        "if origins and not _is_same_origin(origins[0], hosts[0]):",
        "if False:",
        "viewer/test_guard.py",
    ),
    Mutation(
        "a name that was rebound to this machine is let in",
        "viewer/guard.py",
        "if len(hosts) != 1 or not self._is_own_name(hosts[0]):",
        "if len(hosts) != 1:",
        "viewer/test_guard.py",
    ),
    Mutation(
        "other sites can send the cookie along",
        "viewer/guard.py",
        "Path=/; HttpOnly; SameSite=Strict",
        "Path=/; HttpOnly; SameSite=None",
        "viewer/test_guard.py",
    ),
    Mutation(
        "the title of a tab is not escaped",
        "viewer/guard.py",
        "<title>{html.escape(guard.title)}</title>",
        "<title>{guard.title}</title>",
        "viewer/test_guard.py viewer/pages/test_hostile_names.py",
    ),
    Mutation(
        "a page may set a slider beyond its ends",
        "viewer/incoming.py",
        "return not isinstance(value, (bool, str)) and handle.min <= value <= handle.max",
        "return not isinstance(value, (bool, str))",
        "viewer/test_guard.py",
    ),
    Mutation(
        "keys and clicks are queued without a bound",
        "viewer/pages/play.py",
        "if self._waiting.qsize() < MOST_WAITING:",
        "if True:",
        "viewer/test_guard.py viewer/pages/test_clients.py viewer/play/test_controls.py",
    ),
    Mutation(
        "pause does not pause",
        "viewer/watch/gate.py",
        "            self._paused = paused\n            self._primitives = self._decisions = 0",
        "            self._primitives = self._decisions = 0",
        "viewer/watch/test_gate.py viewer/watch/test_watch.py",
    ),
    Mutation(
        "the button Pause runs on",
        "viewer/pages/watch.py",
        'gate.pause(what == "Pause")',
        "gate.pause(False)",
        "viewer/pages/test_watch.py viewer/watch/test_watch.py viewer/pages/test_clients.py",
    ),
    Mutation(
        "a log without a bound",
        "viewer/watch/watch.py",
        "self.events: deque[str] = deque(maxlen=KEPT_EVENTS)",
        "self.events: deque[str] = deque()",
        "viewer/watch/test_watch.py",
    ),
    Mutation(
        "values are kept without a bound",
        "viewer/watch/watch.py",
        "self.values: deque[tuple[int, float]] = deque(maxlen=KEPT_VALUES)",
        "self.values: deque[tuple[int, float]] = deque()",
        "viewer/watch/test_watch.py",
    ),
    Mutation(
        "a replay that does not escape passes for one that did",
        "viewer/play/episode.py",
        "if self.escaped != saved.escaped:",
        "if False:",
        "viewer/play/test_episode.py viewer/play/test_commands.py",
    ),
    Mutation(
        "a trail lacks its first point",
        "viewer/pages/replay.py",
        "scene.draw_trail(recording.states[: number + 1])",
        "scene.draw_trail(recording.states[1 : number + 1])",
        "viewer/pages/test_replay.py::test_a_page_draws_the_whole_way_from_its_first_point",
    ),
]
