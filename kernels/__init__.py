"""Functions on arrays and bytes that are worth compiling, and the choice between their two forms, made once."""

from kernels.wire import read, write

__all__ = ["read", "write"]
