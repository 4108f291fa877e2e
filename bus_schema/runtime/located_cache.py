"""numba's cache of machine code, whose places are the same for each copy of our sources."""

from __future__ import annotations

from typing import Any

from numba.core import caching

from bus_schema.runtime.kernel_cache import place_of

_Files: Any = caching.CompileResultCacheImpl
_FunctionCache: Any = caching.FunctionCache
_Locator: Any = getattr(caching, "UserProvidedCacheLocator", None) or getattr(
    caching, "_UserProvidedCacheLocator", object
)
"""The second name is that of older versions."""


class _ByPackage(_Locator):  # type: ignore[misc]
    @classmethod
    def get_suitable_cache_subpath(cls, source: str) -> str:
        return place_of(source) or str(super().get_suitable_cache_subpath(source))


class _CacheFiles(_Files):  # type: ignore[misc]
    _locator_classes = (_ByPackage, *_Files._locator_classes)


class LocatedCache(_FunctionCache):  # type: ignore[misc]
    """A cache for one function."""

    _impl_class = _CacheFiles
