"""funnel-hil from Python: simulate, compare, sweep, find margins, tune, identify, read runs.

    >>> import funnel_hil
    >>> run = funnel_hil.simulate("paper_arm", {"duration_s": 2, "link.uplink.delay_ms": 4})
    >>> run.kept, run.margin
    (True, 0.4…)

This is the one public name of the package. Refused input raises an `InputError`,
whose message names the key, the value and what is allowed. A law of your own needs nothing else:
it has the methods of `ControlLaw`, gets `Tracking` and a `Dynamics`, and fills its `Diagnostics`.
"""

from importlib.metadata import version as _version

from funnel_hil import _own_modules  # noqa: F401  (first: it decides what imports find)
from funnel_hil.answers import Identification, datasheet, identify
from funnel_hil.results import Comparison, Diff, Run, Study
from funnel_hil.runs import compare, diff, load_run, simulate
from funnel_hil.scenarios import (
    ControlLaw,
    Demonstrator,
    Diagnostics,
    Dynamics,
    InputError,
    Scenario,
    Tracking,
    scenarios,
)
from funnel_hil.studies import benchmark, margin, policy, study, sweep, tune

__version__ = _version("funnel-hil")
__all__ = [
    "Comparison", "ControlLaw", "Demonstrator", "Diagnostics", "Diff", "Dynamics",
    "Identification", "InputError", "Run", "Scenario", "Study", "Tracking",
    "benchmark", "compare", "datasheet", "diff", "identify", "load_run", "margin", "policy",
    "scenarios", "simulate", "study", "sweep", "tune",
]  # fmt: skip
