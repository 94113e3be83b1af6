"""The compiled kernels; `kernels.cpp` of each chapter says what is in them."""

from typing import Any

def __getattr__(name: str) -> Any: ...
