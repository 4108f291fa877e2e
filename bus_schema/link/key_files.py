"""The folder of keys and certificates: flat, with the same file names on every host.

A host needs ``authority.crt`` and the two files of each role it plays. The authority's own key is
needed to issue certificates, and belongs on no host that takes part in a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bus_schema.messages.topics import Role

DEFAULT_FOLDER = "~/.config/funnel-hil/keys"


@dataclass(frozen=True)
class KeyFolder:
    """Paths of the files in a folder of keys.

    Attributes:
        path: the folder.
    """

    path: Path

    @staticmethod
    def at(folder: str | Path) -> KeyFolder:
        """Return the folder at this path; ``~`` is the user's home.

        Raises:
            FileNotFoundError: the user has no home.
        """
        try:
            return KeyFolder(Path(folder).expanduser())
        except RuntimeError as error:
            raise FileNotFoundError(f"{folder}: {error}; use an absolute path") from error

    @property
    def authority(self) -> Path:
        """Certificate of the authority that all peers trust."""
        return self.path / "authority.crt"

    @property
    def authority_key(self) -> Path:
        """Private key of the authority."""
        return self.path / "authority.key"

    def certificate(self, role: Role) -> Path:
        """Certificate of a role."""
        return self.path / f"{role}.crt"

    def key(self, role: Role) -> Path:
        """Private key of a role."""
        return self.path / f"{role}.key"
