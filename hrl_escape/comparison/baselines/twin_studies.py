"""The studies of twins: hierarchies that are given or learned, and learning inside options. Data only."""

from __future__ import annotations

from hrl_escape.comparison.baselines.twins import Question, TwinStudy
from hrl_escape.comparison.presets import HIERARCHICAL, INTRA_OPTION_LEARNERS

__all__ = ["GIVEN_HIERARCHIES", "INTRA_OPTION", "LEARNED_HIERARCHIES"]


def _name_options(*algorithms: str) -> tuple[str, ...]:
    """Labels of agents that choose among a room's planned presses."""
    return tuple(f"smdp-{name}+no-primitives" for name in algorithms)


def _pair(twin: str, *algorithms: str) -> tuple[tuple[str, str], ...]:
    """Agents over options against one twin over options."""
    (other,) = _name_options(twin)
    return tuple((agent, other) for agent in _name_options(*algorithms))


_LEAVES, _PLANNED = (tuple(f"{name}+{leaves}" for name in HIERARCHICAL) for leaves in ("learned", "planned"))
_FLAT, (_OPTIONS,) = "q-learning", _name_options("q-learning")

GIVEN_HIERARCHIES = TwinStudy(
    name="hierarchies",
    command="hierarchies",
    title="Synthesised hierarchies: structure alone, and with planned leaves",
    introduction="[Hierarchies that are given](../hierarchies.md) explains the agents. All learn in tables, at their "
    "default settings, so that twins differ in the hierarchy and in what it tells them; agents with networks were not "
    "run.",
    questions=(
        Question("Structure alone", f"Learned leaves against `{_FLAT}`, which also learns over primitives, without a "
                 "hierarchy", "some hierarchy", tuple((agent, _FLAT) for agent in _LEAVES)),
        Question("Planned leaves", "Planned leaves against learned ones of the same hierarchy", "some hierarchy",
                 tuple(zip(_PLANNED, _LEAVES, strict=True))),
        Question("Structure where a planner walks anyway", f"Planned leaves against `{_OPTIONS}`, which chooses among "
                 "planned presses, without a hierarchy", "some hierarchy",
                 tuple((agent, _OPTIONS) for agent in _PLANNED)),
    ),
)

LEARNED_HIERARCHIES = TwinStudy(
    name="learned-hierarchies",
    command="learned",
    title="Learned hierarchies: options, skills and causal structure",
    introduction="[The agents](../agents/index.md) choose among the presses of a planner; options and skills are "
    "learned over these choices, as a second level. Settings are the defaults, but a run has only some 400 decisions, "
    "so that `ppo`, `dac`, `ppoc` and `diayn` learn from 32 at a time, and `eigenoptions` and `covering-options` look "
    "for options every 50. A room is called by its number of buttons, "
    "each with at most two parents, their numbers shuffled, and by what a press with unmet parents does: nothing "
    "(`ignore`), or all buttons go off (`reset`). One room of each kind; runs differ in the training seed. Runs that "
    "never escape are in all numbers.",
    questions=(
        Question("Options and skills in tables", "Against `smdp-q-learning+no-primitives`, which learns in the same "
                 "tables without them", "some learner of options",
                 _pair("q-learning", "option-critic", "eigenoptions", "covering-options", "skill-chaining")),
        Question("Options and skills over networks", "Against `smdp-ppo+no-primitives`, which has the same networks "
                 "without them", "some learner of options", _pair("ppo", "dac", "ppoc", "a2oc", "diayn")),
        Question("Structure", "Against `smdp-r-max+no-primitives`, which also learns a model and goes where it knows "
                 "least, but knows a state only as a whole", "some learner of structure",
                 _pair("r-max", "factored-r-max", "met-r-max", "vigorito-barto", "monte-carlo-model", "hrc")),
        Question("Ways to learn structure", "Against `smdp-factored-r-max+no-primitives`, which drops a structure at "
                 "its first miss", "some other way",
                 _pair("factored-r-max", "met-r-max", "vigorito-barto", "monte-carlo-model", "hrc")),
    ),
    notes=(
        "What each was told. All: presses planned with the room's geometry, and which of them are possible; no "
        "learner is told which button needs which. `smdp-index-order` and `smdp-shuffled-round` follow a rule; "
        "`planner` knows the room, its graph included.",
        "What each takes for granted. `r-max`, `factored-r-max`, `met-r-max`, `vigorito-barto`, `monte-carlo-model`, "
        "`hrc`, and the discriminator of `diayn`: what matters are the components of the observation that were only "
        "ever 0 or 1. All of these but the first and the last two: a result depends on few of them. `hrc`: bits stay "
        "on. All other learners take the observation as it is, with the robot's pose.",
    ),
)

INTRA_OPTION = TwinStudy(
    name="intra-option",
    command="intra-option",
    title="Intra-option learning: options that follow plans, and options that are functions of the state",
    introduction="`smdp-intra-option-q` learns from every primitive inside an option, for each option that would have "
    "done the same; `smdp-q-learning` learns from whole options. An option that follows a plan is no function of the "
    "state, so that a primitive inside one says nothing of another. With `+markov` they are functions of the "
    "state (`press-markov`): each primitive is the first of a route that is planned anew. Both agents "
    "learn in tables at their default settings. "
    "A room is called by its number of buttons, which have at most two parents each and shuffled numbers; a press "
    "with unmet parents does nothing. With noise, displacements err by 10 % and a tenth of all primitives do nothing. "
    "One room of each kind; runs differ in the training seed. Runs that never escape are in all numbers.",
    questions=(
        Question("Learning inside options that are functions of the state",
                 "Against `smdp-q-learning+markov+no-primitives`, which has the same options", "`intra-option-q`",
                 (("smdp-intra-option-q+markov+no-primitives", "smdp-q-learning+markov+no-primitives"),)),
        Question("Learning inside options that follow plans",
                 "Against `smdp-q-learning+no-primitives`, which has the same options", "`intra-option-q`",
                 _pair("q-learning", "intra-option-q")),
        Question("Functions of the state in place of plans", "Against the same learner with options that follow plans",
                 "some learner", tuple((f"smdp-{name}+markov+no-primitives", f"smdp-{name}+no-primitives")
                                       for name in INTRA_OPTION_LEARNERS)),
    ),
    episodes="rooms have one start, and chance where there is noise alone",
)
