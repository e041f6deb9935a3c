"""Puzzles: the rules that open the exit, one file a puzzle; importing this registers ours."""

from hrl_escape.env.puzzles.base import register_puzzle
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig, BitFlipPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.push_block import PushBlockConfig, PushBlockPuzzle

register_puzzle(ButtonsConfig, ButtonsPuzzle)
register_puzzle(BitFlipConfig, BitFlipPuzzle)
register_puzzle(PushBlockConfig, PushBlockPuzzle)
