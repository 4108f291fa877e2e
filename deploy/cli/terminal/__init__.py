"""What commands write to a terminal: results, progress, and a reader that left."""
