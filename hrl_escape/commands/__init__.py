"""Commands of `hrl-escape`: one function each, with a folder for each group of commands.

A command is a function `run(args)` of a module, or `run_NAME(args)` in a module with several commands. The first line
of the docstring, of the module or of the function, is its one-line help. The annotation of `args`, a frozen dataclass,
is its command line. Adding the function registers the command (`hrl_escape/cli.py`). A module without such a function
is a helper.
"""
