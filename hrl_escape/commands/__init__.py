"""The commands of `hrl-escape`, one file a verb, one folder a group of verbs.

A command is a module whose docstring's first line is its one-line help and that defines
`run(args)`; the annotation of `args`, a frozen dataclass, is its command line. Adding the
file registers it (`hrl_escape/cli.py`). A module without `run` is no command but a helper.
"""
