"""What is compiled of this package: kernels.cpp has it."""

from typing import Any

def __getattr__(name: str) -> Any: ...
