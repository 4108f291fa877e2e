"""Commands for many runs, comparisons of runs, and recorded runs."""
