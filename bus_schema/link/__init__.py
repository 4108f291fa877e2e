"""Interface of a link, and the scenario's section ``link``."""
