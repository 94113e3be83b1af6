"""Type stubs of the compiled kernels, which `kernels.cpp` binds."""

from typing import Any

def __getattr__(name: str) -> Any: ...
