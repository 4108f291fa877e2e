"""Rigid bodies under joint torques: physics engines, one of which a scenario names."""
