"""Ends of an episode: one value that the rules decide and every page, file and command shows."""

from __future__ import annotations

from enum import Enum


class EpisodeEnd(str, Enum):
    """End of an episode; `STOPPED` means that the episode could go on."""

    ESCAPED = "escaped"
    """The puzzle is solved, and the robot stands in the exit."""
    FAILED = "failed"
    """The puzzle was failed, as in a deep sea whose last row is reached without its treasure."""
    TRUNCATED = "truncated"
    """The horizon was reached."""
    STOPPED = "stopped"
    """No primitive ended the episode; the driver stopped."""

    @classmethod
    def of_step(cls, success: bool, terminated: bool, truncated: bool) -> EpisodeEnd:
        """Return the end by the flags of a step; `success` is `info["success"]`, and only it means an escape."""
        if terminated:
            return cls.ESCAPED if success else cls.FAILED
        return cls.TRUNCATED if truncated else cls.STOPPED

    @property
    def is_over(self) -> bool:
        """True where the episode cannot go on."""
        return self is not EpisodeEnd.STOPPED

    @property
    def words(self) -> str:
        """Describe the end in words, for pages and commands."""
        return {"truncated": "out of time", "stopped": "still inside"}.get(self.value, self.value)
