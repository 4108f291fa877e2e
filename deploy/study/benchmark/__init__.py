"""The benchmark: laws and predictors on arms, networks and uncertain plants, run alike."""
