"""One run: simulated, judged, replayed, and its folder."""
