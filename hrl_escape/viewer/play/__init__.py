"""Manual mode: keys, the episode that they control, episode files, and play without a browser."""
