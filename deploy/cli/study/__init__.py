"""Commands that make many runs, set runs side by side, or look again at recorded ones."""
