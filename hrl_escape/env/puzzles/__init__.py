"""Puzzles: the rules that open the exit, one file a puzzle; importing this registers ours."""

from hrl_escape.env.puzzles.base import register_puzzle
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle

register_puzzle(ButtonsConfig, ButtonsPuzzle)
