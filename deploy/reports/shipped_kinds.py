"""Kinds of study that ship, by the names of their packages in `deploy.studies`.

It imports nothing, so that the help of the program reads it.
"""

COMMANDS = {
    "datasheet": "datasheet", "margin": "margin", "policy": "policy", "sweep": "sweep",
    "comparison": "compare", "tune": "tune", "benchmark": "benchmark",
}  # fmt: skip
"""The command of each, a function of its module ``command``, in the order of the help."""
WITHOUT_COMMAND = ("diff", "robustness")
"""Kinds of results whose command is that of another kind, or is among those for results."""
