"""Pages of runs: of one, of several laws, of recorded runs side by side."""
