"""Every PointCloud2 layout is read exactly, and a contradictory one is refused with its numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from test.helpers_io import cloud_fields, cloud_message
from topometric_ros.io.pointcloud2 import CloudError, points_from_fields, points_from_message

POINTS = np.array([[1.0, 2.0, 3.0], [-4.5, 0.25, 8.0], [0.0, -1.0, 1e3]])


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_both_precisions_and_byte_orders_are_read(dtype: str, order: str) -> None:
    points, dropped = points_from_message(cloud_message(POINTS, dtype, order))
    np.testing.assert_array_equal(points, POINTS)
    assert points.dtype == np.float64
    assert dropped == 0


def test_points_that_are_not_finite_are_dropped_and_counted() -> None:
    damaged = np.vstack([POINTS, [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]]])
    points, dropped = points_from_message(cloud_message(damaged))
    np.testing.assert_array_equal(points, POINTS)
    assert dropped == 3


def test_rows_of_an_organised_cloud_may_be_padded() -> None:
    layout, fields = cloud_fields()
    rows = np.arange(12, dtype=float).reshape(2, 2, 3)
    data = b""
    for row in rows:
        table = np.zeros(2, layout)
        for axis, name in enumerate("xyz"):
            table[name] = row[:, axis]
        data += table.tobytes() + b"\xff" * 8
    points, dropped = points_from_fields(2, 2, 16, 40, False, fields, data)
    np.testing.assert_array_equal(points, rows.reshape(-1, 3))
    assert dropped == 0


def test_an_empty_cloud_has_no_points() -> None:
    points, dropped = points_from_message(cloud_message(np.empty((0, 3))))
    assert points.shape == (0, 3)
    assert dropped == 0


def wrong(**changes: object) -> SimpleNamespace:
    message = cloud_message(POINTS)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def without(name: str) -> SimpleNamespace:
    message = cloud_message(POINTS)
    message.fields = [field for field in message.fields if field.name != name]
    return message


def field_with(**changes: object) -> SimpleNamespace:
    message = cloud_message(POINTS)
    for name, value in changes.items():
        setattr(message.fields[0], name, value)
    return message


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (wrong(point_step=12), "point_step: expected at least 16 bytes.*got 12"),
        (wrong(point_step=20), "row_step: expected 60 bytes.*got 48"),
        (wrong(point_step=0), "point_step: expected at least 4 bytes.*got 0"),
        (wrong(row_step=52), "row_step: expected 48 bytes.*got 52"),
        (wrong(row_step=40), "row_step: expected 48 bytes.*got 40"),
        (wrong(width=4), "row_step: expected 64 bytes.*got 48"),
        (wrong(height=2), "data: expected 96 bytes.*got 48"),
        (wrong(data=b"\0" * 47), "data: expected 48 bytes.*got 47"),
        (field_with(offset=13), "point_step: expected at least 17 bytes"),
        (field_with(datatype=5), "field 'x': expected one float32.*got 1 of datatype 5"),
        (field_with(datatype=9), "expected a datatype 1..8, got 9"),
        (field_with(count=3), "field 'x': expected one float32"),
        (without("z"), "expected fields x, y and z, got x, y, intensity"),
        (wrong(fields=[]), "expected fields x, y and z, got none"),
    ],
)
def test_a_contradictory_message_is_refused_with_its_numbers(
    message: SimpleNamespace, text: str
) -> None:
    with pytest.raises(CloudError, match=text):
        points_from_message(message)
