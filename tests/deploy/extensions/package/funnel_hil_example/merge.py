"""A merge whose targets are the mean of the old and the new chunk's."""

from controller.chunks.merge import ChunkMerge, MergeSettings, blended


class Halves(ChunkMerge):
    """Its rule."""

    def __init__(self, share):
        self._share = share

    def merged(self, old, new, now_s):
        return blended(old, new, now_s, lambda row: self._share)


class HalvesSettings(MergeSettings):
    """Its settings."""

    share: float = 0.5

    def build(self, timing):
        return Halves(self.share)
