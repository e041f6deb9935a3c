"""The commands of `hrl-escape`: a function each, and a folder for each group of commands.

A command is a module with a function `run(args)` or, where a module holds several small ones, a function
`run_NAME(args)`. The first line of the docstring, of the module or of the function, is its one-line help; the
annotation of `args`, a frozen dataclass, is its command line. Adding the function registers the command
(`hrl_escape/cli.py`). A module without any is a helper.
"""
