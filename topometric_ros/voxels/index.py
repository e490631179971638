"""VoxelIndex: from a cell's coordinates to its row, exactly, whatever the extent (thesis §4.1.2).

Two levels of the draft's octree are one bucket here: a *brick* of 4 x 4 x 4 cells is an aligned
prefix of the Morton code (`code >> 6`), holds its occupied cells as the bits of one 64-bit word
and, because the rows are in Morton order, needs only the row of its first cell: the others follow
by counting bits. Bricks lie in a hash table, so memory grows with the voxels, not with the bounds.
`octree.py` has the whole tree; for single cells and balls this is faster.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.voxels.morton import morton_encode

BRICK_OFFSET = 1 << 19
"""Added to the coordinates of a brick, so that its key has no negative part."""
_HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio: Fibonacci hashing
EMPTY = -1
"""Key of an unused place in a hash table."""

Table = tuple[NDArray[np.int64], NDArray[np.uint64], NDArray[np.int64], NDArray[np.int64]]


class VoxelIndex:
    """Exact lookup of voxels by coordinates; build it once for a set of cells.

    Parameters
    ----------
    coords : (N, 3) int32, distinct cells; fastest to build in Morton order, as grids are

    Attributes
    ----------
    table : what compiled code takes (see :func:`row_at`): keys, masks and first rows of the hash
        table's bricks, and the row of each cell in Morton order

    Raises
    ------
    TopometricError
        Two rows hold the same cell.
    """

    def __init__(self, coords: NDArray[np.integer]) -> None:
        coords = np.asarray(coords).reshape(-1, 3)
        codes = morton_encode(coords)
        order = np.arange(len(codes))
        if not (codes[1:] > codes[:-1]).all():
            order = np.argsort(codes, kind="stable")
            codes = codes[order]
            if (codes[1:] == codes[:-1]).any():
                raise TopometricError(f"{len(codes)} cells of which {len(np.unique(codes))} differ")
        self.size = len(codes)
        self.table: Table = _build(codes, coords, order)

    def __len__(self) -> int:
        return self.size

    def rows(self, coords: NDArray[np.integer]) -> NDArray[np.int64]:
        """Return the row of each cell of `coords` (M, 3), -1 where it is not occupied: (M,)."""
        return _rows(self.table, np.asarray(coords, dtype=np.int64).reshape(-1, 3))

    def __contains__(self, cell: tuple[int, int, int]) -> bool:
        return bool(self.rows(np.asarray([cell]))[0] >= 0)

    def radius(self, position: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
        """Return the rows of the voxels whose centre lies within a distance (eq. 10), sorted.

        `position` (3,) float64 and `radius` are in cells, on the lattice of the coordinates.
        """
        found = rows_within(self.table, np.asarray(position, dtype=np.float64), float(radius))
        return np.sort(found)


@njit(cache=True, nogil=True)
def slot_of(keys, key):  # type: ignore[no-untyped-def]
    """Slot of a brick's key, or of the empty place where it would go."""
    last = np.int64(len(keys) - 1)
    slot = np.int64((np.uint64(key) * _HASH_FACTOR) >> np.uint64(32)) & last
    while keys[slot] != key and keys[slot] != EMPTY:
        slot = (slot + 1) & last
    return slot


@njit(cache=True, nogil=True)
def _build(codes, coords, order):  # type: ignore[no-untyped-def]
    """Return the hash table of bricks for sorted Morton `codes` and the cells they came from."""
    bricks = 0
    for i in range(len(codes)):
        bricks += i == 0 or codes[i] >> np.uint64(6) != codes[i - 1] >> np.uint64(6)
    capacity = 16
    while capacity <= 2 * bricks:
        capacity *= 2
    keys = np.full(capacity, EMPTY, np.int64)
    masks = np.zeros(capacity, np.uint64)
    first = np.zeros(capacity, np.int64)
    slot = 0
    for i in range(len(codes)):
        if i == 0 or codes[i] >> np.uint64(6) != codes[i - 1] >> np.uint64(6):
            key = brick_key(coords[order[i], 0], coords[order[i], 1], coords[order[i], 2])
            slot = slot_of(keys, key)
            keys[slot], first[slot] = key, i
        masks[slot] |= np.uint64(1) << (codes[i] & np.uint64(63))
    return keys, masks, first, order


@njit(cache=True, nogil=True)
def brick_key(x, y, z):  # type: ignore[no-untyped-def]
    """Key of the brick that holds a cell."""
    bx = (np.int64(x) >> 2) + BRICK_OFFSET
    by = (np.int64(y) >> 2) + BRICK_OFFSET
    bz = (np.int64(z) >> 2) + BRICK_OFFSET
    return (bx << 40) | (by << 20) | bz


@njit(cache=True, nogil=True)
def brick_slot(table, x, y, z):  # type: ignore[no-untyped-def]
    """Slot of the brick that holds a cell; its mask is 0 where no such brick is occupied."""
    return slot_of(table[0], brick_key(x, y, z))


@njit(cache=True, nogil=True)
def cell_in_brick(x, y, z):  # type: ignore[no-untyped-def]
    """Place of a cell in its brick, 0..63: the six low bits of its Morton code."""
    low = (x & 1) | ((y & 1) << 1) | ((z & 1) << 2)
    high = ((x & 2) << 2) | ((y & 2) << 3) | ((z & 2) << 4)
    return low | high


@njit(cache=True, nogil=True)
def bit_count(word):  # type: ignore[no-untyped-def]
    """Return the number of bits set in a 64-bit word (a pattern that compiles to one step)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    low = np.uint64(0x3333333333333333)
    word = (word & low) + ((word >> np.uint64(2)) & low)
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, nogil=True)
def row_at(table, x, y, z):  # type: ignore[no-untyped-def]
    """Row of the cell (x, y, z), -1 where it is not occupied."""
    slot = brick_slot(table, x, y, z)
    bit = np.uint64(1) << np.uint64(cell_in_brick(x, y, z))
    mask = table[1][slot]
    if mask & bit == np.uint64(0):
        return np.int64(-1)
    return table[3][table[2][slot] + bit_count(mask & (bit - np.uint64(1)))]


@njit(cache=True, nogil=True)
def cells_to_next(table, x, y, z, way, most):  # type: ignore[no-untyped-def]
    """Cells from (x, y, z) up (`way` 1) or down (-1) to the next occupied one; most + 1: none."""
    mask = np.uint64(0)
    for step in range(1, most + 1):
        height = z + way * step
        if step == 1 or height & 3 == (0 if way > 0 else 3):  # where another brick begins
            mask = table[1][brick_slot(table, x, y, height)]
        if (mask >> np.uint64(cell_in_brick(x, y, height))) & np.uint64(1):
            return step
    return most + 1


@njit(cache=True, nogil=True)
def _rows(table, coords):  # type: ignore[no-untyped-def]
    rows = np.empty(len(coords), np.int64)
    for i in range(len(coords)):
        rows[i] = row_at(table, coords[i, 0], coords[i, 1], coords[i, 2])
    return rows


@njit(cache=True, nogil=True)
def rows_within(table, position, radius):  # type: ignore[no-untyped-def]
    """Rows of the voxels within `radius` cells of `position`, brick by brick, not sorted."""
    low = np.floor(position - radius).astype(np.int64) >> 2
    high = np.floor(position + radius).astype(np.int64) >> 2
    found = np.empty(1024, np.int64)
    count = 0
    for bx in range(low[0], high[0] + 1):
        for by in range(low[1], high[1] + 1):
            for bz in range(low[2], high[2] + 1):
                slot = brick_slot(table, bx * 4, by * 4, bz * 4)
                mask = table[1][slot]
                if mask == np.uint64(0):
                    continue
                if count + 64 > len(found):
                    found = np.append(found, np.empty(len(found), np.int64))
                row = table[2][slot]
                for code in range(64):
                    if (mask >> np.uint64(code)) & np.uint64(1) == np.uint64(0):
                        continue
                    x = bx * 4 + (code & 1) + ((code >> 2) & 2) - position[0]
                    y = by * 4 + ((code >> 1) & 1) + ((code >> 3) & 2) - position[1]
                    z = bz * 4 + ((code >> 2) & 1) + ((code >> 4) & 2) - position[2]
                    if x * x + y * y + z * z <= radius * radius:
                        found[count] = table[3][row]
                        count += 1
                    row += 1
    return found[:count].copy()
