"""The processes of a run: start, links, injected faults, recording."""
