"""Loaded first by each worker process: garbage is not collected until all modules are loaded.

Collection would take a quarter of that time. `deploy.study.execution.dask_workers.dask_setup` ends
this.
"""

import gc

gc.disable()
