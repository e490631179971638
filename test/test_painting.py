"""Rasters of turned frames become one picture, pixel by pixel."""

from __future__ import annotations

import numpy as np

from topometric_ros.visualization.painting import Raster, painted, raster_on_sheet

RED, BLUE, CLEAR = (255, 0, 0, 255), (0, 0, 255, 51), (0, 0, 0, 0)


def test_a_turned_raster_lies_where_its_frame_does() -> None:
    # Two cells of 1 m along x in the frame, centred at (0, 0) and (1, 0); the frame is turned left
    # by a quarter and lies at (3, 1): on the sheet the cells are centred at (3, 1) and (3, 2).
    image = np.array([[RED], [BLUE]], np.uint8)
    raster = raster_on_sheet(image, (0.0, 0.0), 1.0, (np.pi / 2, 3.0, 1.0), order=1.0)
    picture = painted([raster], (0.0, 0.0), 0.5, (8, 10))
    assert picture.shape == (8, 10, 4)
    expected = np.full((8, 10, 3), 255, np.uint8)
    expected[1:3, 5:7] = RED[:3]
    expected[3:5, 5:7] = (204, 204, 255)
    np.testing.assert_array_equal(picture[..., :3], expected)
    assert (picture[..., 3] == 255).all()


def test_higher_orders_lie_on_top_and_clear_cells_hide_nothing() -> None:
    def one(colour: tuple[int, int, int, int], order: float, x: float = 0.5) -> Raster:
        return raster_on_sheet(np.array([[colour]], np.uint8), (x, 0.5), 1.0, (0, 0, 0), order)

    green = (0, 255, 0, 255)
    rasters = [one(CLEAR, 9.0), one(green, 2.0), one(RED, 1.0), one(RED, 3.0, x=400.0)]
    picture = painted(rasters, (0.0, 0.0), 1.0, (1, 2))
    assert picture[0].tolist() == [list(green), [255] * 4]
