"""Physics engines: rigid bodies under joint torques. A scenario names one of them."""
