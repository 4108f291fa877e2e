"""`openarm_can`, which Enactic publishes as a source archive alone, and its client here.

Building takes a C++ compiler and CMake, and fetches the C++ sources from GitHub. A folder with the
package already in it can be named in OPENARM_CAN.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

VERSION = "1.4.1"
_CLIENT = Path(__file__).with_name("openarm_client.py")
_HANG_S = 600


def build_openarm_can(folder: Path) -> Path:
    """Return the folder that holds the package; skip the test where it cannot be built."""
    if given := os.environ.get("OPENARM_CAN"):
        return Path(given)
    package = folder / f"openarm_can-{VERSION}"
    if not package.exists():
        words = ["pip", "wheel", "--no-deps", f"openarm_can=={VERSION}", "--wheel-dir", str(folder)]
        built = subprocess.run(
            [sys.executable, "-m", *words], capture_output=True, text=True, timeout=_HANG_S,
            check=False,
        )  # fmt: skip
        if built.returncode:
            errors = re.findall(r"(?:fatal|CMake Error|error:).*", built.stdout + built.stderr)
            pytest.skip(f"openarm_can {VERSION} cannot be built: {'; '.join(errors)[:200]}")
        zipfile.ZipFile(next(folder.glob(f"openarm_can-{VERSION}-*.whl"))).extractall(package)
    return package


def run_client(package, interface, frames, patience_s=60.0, **variables):
    """What the client saw on an interface."""
    command = [sys.executable, str(_CLIENT), interface, frames, str(patience_s)]
    ended = subprocess.run(
        command, capture_output=True, text=True,
        timeout=_HANG_S, check=False, env={**os.environ, "PYTHONPATH": str(package), **variables},
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    seen: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
    return seen
