"""Reports and tables of studies: comparisons, margins, sweeps, uncertain plants."""
