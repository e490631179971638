"""What is packed comes back exactly; what is damaged or too large is refused before it costs."""

from __future__ import annotations

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from topometric_ros.io.packing import (
    MAXIMUM_ITEMS,
    PackingError,
    pack_array,
    pack_bits,
    pack_coords,
    pack_offsets,
    unpack_array,
    unpack_bits,
    unpack_coords,
    unpack_offsets,
)
from topometric_ros.voxels.grid import in_morton_order
from topometric_ros.voxels.morton import COORDINATE_LIMIT


@given(
    hnp.arrays(
        np.int64,
        st.tuples(st.integers(0, 60), st.just(3)),
        elements=st.integers(-COORDINATE_LIMIT, COORDINATE_LIMIT - 1),
    )
)
@settings(max_examples=60)
def test_any_set_of_voxels_round_trips(coords: np.ndarray) -> None:
    ordered = in_morton_order(coords)
    packed = pack_coords(ordered)
    np.testing.assert_array_equal(unpack_coords(packed, len(ordered)), ordered)
    assert packed == pack_coords(ordered)


@given(hnp.arrays(np.int8, st.tuples(st.integers(0, 9), st.just(3)), elements=st.integers(-2, 1)))
@settings(max_examples=40)
def test_offsets_round_trip(offsets: np.ndarray) -> None:
    np.testing.assert_array_equal(unpack_offsets(pack_offsets(offsets), len(offsets)), offsets)


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=20)))
@settings(max_examples=40)
def test_bits_round_trip(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(unpack_bits(pack_bits(mask), mask.shape), mask)


@pytest.mark.parametrize("dtype", ["int32", "uint32", "float32", "float64", ">i4"])
@pytest.mark.parametrize("shape", [(0,), (0, 3), (5, 0), (17,), (4, 3)])
def test_arrays_round_trip(dtype: str, shape: tuple[int, ...]) -> None:
    array = (np.random.default_rng(1).normal(size=shape) * 1e6).astype(dtype)
    back = unpack_array(pack_array(array), np.dtype(dtype).newbyteorder("="), shape)
    np.testing.assert_array_equal(back, array)


def test_a_room_s_surface_takes_under_three_bits_a_voxel() -> None:
    x, y, z = np.meshgrid(*(np.arange(n) for n in (80, 60, 26)), indexing="ij")
    shell = (x % 79 == 0) | (y % 59 == 0) | (z % 25 == 0)
    coords = in_morton_order(np.stack([x[shell], y[shell], z[shell]], 1))
    assert len(pack_coords(coords)) * 8 < 3 * len(coords)


def test_offsets_that_no_byte_stands_for_are_refused() -> None:
    with pytest.raises(PackingError, match=r"expected -2\.\.1, got 0\.\.2"):
        pack_offsets(np.array([[0, 0, 2]], np.int8))
    with pytest.raises(PackingError, match="expected bytes under 64, got 64"):
        unpack_offsets(zstandard.ZstdCompressor().compress(b"\x40"), 1)


def test_voxels_out_of_order_are_not_packed() -> None:
    coords = np.array([[1, 0, 0], [0, 0, 0]], np.int32)
    with pytest.raises(PackingError, match="Morton order"):
        pack_coords(coords)
    with pytest.raises(PackingError, match="Morton order"):
        pack_coords(coords[[0, 0]])


def test_another_number_of_voxels_is_refused() -> None:
    packed = pack_coords(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.int32))
    for count in (0, 1, 2, 4, 40):
        with pytest.raises(PackingError):
            unpack_coords(packed, count)


def test_a_bomb_is_refused_before_memory_is_taken() -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 27))
    assert len(bomb) < 20_000
    with pytest.raises(PackingError, match=r"expected 3\.\.27 bytes of content, got 134217728"):
        unpack_coords(bomb, 3)
    with pytest.raises(PackingError, match=r"expected 4\.\.4 bytes"):
        unpack_array(bomb, np.int32, (1,))
    with pytest.raises(PackingError, match=f"at most {MAXIMUM_ITEMS} are read"):
        unpack_array(bomb, np.int32, (1 << 40,))
    with pytest.raises(PackingError, match="are read"):
        unpack_bits(bomb, (1 << 20, 1 << 20))
    with pytest.raises(PackingError, match="are read"):
        unpack_coords(bomb, -1)


def test_a_frame_that_hides_its_size_is_refused() -> None:
    stream = zstandard.ZstdCompressor().compressobj()
    hidden = stream.compress(bytes(16)) + stream.flush()
    with pytest.raises(PackingError, match=r"expected 16\.\.16 bytes"):
        unpack_array(hidden, np.int32, (4,))


@given(st.integers(0, 10_000), st.integers(0, 7), st.booleans())
@settings(max_examples=80)
def test_damage_is_found(position: int, bit: int, cut: bool) -> None:
    coords = in_morton_order(np.random.default_rng(5).integers(-30, 30, (300, 3)))
    packed = bytearray(pack_coords(coords))
    at = position % len(packed)
    if cut:
        packed = packed[:at]
    else:
        packed[at] ^= 1 << bit
    try:
        result = unpack_coords(bytes(packed), len(coords))
    except PackingError:
        return
    np.testing.assert_array_equal(result, coords)
