"""Whole escapes: searches through all presses of a puzzle at once, by the body and by the hand."""
