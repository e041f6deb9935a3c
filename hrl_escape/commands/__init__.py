"""The commands of `hrl-escape`: one file a command, one folder a group of commands.

A command is a module with a function `run(args)`. The first line of the module's docstring is
its one-line help; the annotation of `args`, a frozen dataclass, is its command line. Adding the
file registers the command (`hrl_escape/cli.py`). A module without `run` is a helper.
"""
