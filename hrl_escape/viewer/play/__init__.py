"""Manual mode: keys, the episode that they drive, episode files, and play without a browser."""
