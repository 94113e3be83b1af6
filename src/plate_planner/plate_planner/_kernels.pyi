"""The compiled kernels; `kernels.cpp` says what is in them."""

from typing import Any

def __getattr__(name: str) -> Any: ...
