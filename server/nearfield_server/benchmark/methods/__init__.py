"""The methods of the papers as labelled baselines, next to Nearfield's own; all of them produce ordinary light packets."""

from nearfield_server.benchmark.methods.registry import METHODS, MethodEntry

__all__ = ["METHODS", "MethodEntry"]
