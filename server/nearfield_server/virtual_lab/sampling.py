"""Low-discrepancy random numbers inside Dr.Jit kernels: Owen-scrambled Sobol pairs, one scramble per lane and dimension.

Sources: Burley 2020, "Practical Hash-based Owen Scrambling"; Laine and Karras 2011 for the hash.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nearfield_server.virtual_lab.backend import Backend

TABLE_BITS = 14
_UNIT = 2.0**-24


def _sobol_second_dimension_reversed() -> Any:
    """(2^TABLE_BITS,) uint32: bit-reversed second Sobol dimension of each index.

    The direction numbers are rows of Pascal's triangle modulo 2; bit-reversed, direction j is `1, 3, 5, 15, 17, ...`.
    """
    index = np.arange(1 << TABLE_BITS, dtype=np.uint32)
    reversed_value = np.zeros_like(index)
    direction = np.uint32(1)
    for bit in range(TABLE_BITS):
        reversed_value ^= np.where((index >> np.uint32(bit)) & np.uint32(1), direction, np.uint32(0))
        direction ^= np.uint32((int(direction) << 1) & 0xFFFFFFFF)
    return reversed_value


class Sampler:
    """Stratified pairs in [0, 1)^2 for many lanes."""

    def __init__(self, backend: Backend, lane_key: Any, seed: int) -> None:
        """`lane_key` is a UInt32 per lane: equal keys give equal numbers, whatever else is in the scene."""
        self._dr, self._uint, self._float = backend.dr, backend.mi.UInt32, backend.mi.Float
        self._table = self._uint(_sobol_second_dimension_reversed())
        self._lane = self._hash(self._uint(lane_key) ^ self._uint(seed * 0x9E3779B1 & 0xFFFFFFFF))

    def _hash(self, value: Any) -> Any:
        """Integer hash "lowbias32" by C. Wellons."""
        value = (value ^ (value >> 16)) * self._uint(0x7FEB352D)
        value = (value ^ (value >> 15)) * self._uint(0x846CA68B)
        return value ^ (value >> 16)

    def _owen(self, reversed_value: Any, key: Any) -> Any:
        """Owen scrambling of a bit-reversed number: each bit is flipped depending on the bits above it and the key."""
        x = reversed_value + key
        for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
            x = x ^ (x * self._uint(factor))
        return self._dr.brev(x)

    def pair(self, index: Any, dimension: int) -> tuple[Any, Any]:
        """Sample `index` of dimension pair `dimension`: two Floats in [0, 1).

        Any aligned power-of-two block of indices is stratified. The index order is shuffled per lane and dimension, so that
        different dimensions are independent.
        """
        key = self._hash(self._lane + self._uint((dimension + 1) * 0x85EBCA6B & 0xFFFFFFFF))
        shuffled = (self._uint(index) ^ self._hash(key + 3)) & self._uint((1 << TABLE_BITS) - 1)
        first = self._owen(shuffled, self._hash(key + 1))
        second = self._owen(self._dr.gather(self._uint, self._table, shuffled), self._hash(key + 2))
        return self._float(first >> 8) * _UNIT, self._float(second >> 8) * _UNIT
