"""Pages of studies: what stands on them, and how it is worded."""
