"""Morton order: exact, total and local."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from topometric_ros.errors import TopometricError
from topometric_ros.voxels.morton import COORDINATE_LIMIT, morton_decode, morton_encode

coordinate = st.integers(-COORDINATE_LIMIT, COORDINATE_LIMIT - 1)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=50))
def test_decoding_undoes_encoding(coords):
    array = np.array(coords, dtype=np.int64).reshape(-1, 3)
    assert np.array_equal(morton_decode(morton_encode(array)), array)


@given(coordinate, coordinate, coordinate)
def test_a_code_interleaves_the_bits_of_x_y_z(x, y, z):
    code = int(morton_encode(np.array([[x, y, z]]))[0])
    expected = 0
    for bit in range(21):
        for axis, value in enumerate((x, y, z)):
            expected |= (((value + COORDINATE_LIMIT) >> bit) & 1) << (3 * bit + axis)
    assert code == expected


def test_the_eight_cells_of_an_octant_are_neighbours_in_the_order():
    cells = np.stack(np.meshgrid([2, 3], [4, 5], [6, 7], indexing="ij"), -1).reshape(-1, 3)
    codes = np.sort(morton_encode(cells))
    assert np.array_equal(np.diff(codes), np.ones(7))
    assert len(np.unique(codes >> np.uint64(3))) == 1


def test_a_coordinate_beyond_the_limit_is_refused_with_its_value():
    with pytest.raises(TopometricError, match=str(COORDINATE_LIMIT)):
        morton_encode(np.array([[0, 0, COORDINATE_LIMIT]]))
