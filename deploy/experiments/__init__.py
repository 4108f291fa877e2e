"""Experiments with their own command: `python -m deploy.experiments.<name>`."""
