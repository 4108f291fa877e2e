"""What a recording says of the law: figures, bounds and their conditions."""
