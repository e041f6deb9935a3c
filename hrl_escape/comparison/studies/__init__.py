"""Studies that a page of docs/results tells: grids of runs, what is measured in them, and the page itself."""
