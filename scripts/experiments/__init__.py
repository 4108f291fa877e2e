"""Experiments of the paper and of the README: `python -m scripts.experiments.<name>`."""
