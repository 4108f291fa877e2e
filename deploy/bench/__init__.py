"""What things cost, as ratios of medians that are measured side by side in one run."""
