"""A service as a whole, built from its settings; the only package that names adapters."""

from worker.runtime.building import Runtime, build
from worker.runtime.parts import MakeEncoder

__all__ = ["MakeEncoder", "Runtime", "build"]
