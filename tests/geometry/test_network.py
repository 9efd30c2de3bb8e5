"""What a bundle adjustment refuses before it begins, and what it takes as known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.network import Network, Pose, ScaleBar, check_network
from labdaemon.geometry.oriented_camera import OrientedCamera


@pytest.fixture
def network(look: Callable[..., OrientedCamera], control_mm: np.ndarray) -> Network:
    """Two images of eight points, without control."""
    cameras = [look((-300.0, -900.0, 500.0)), look((300.0, -900.0, 500.0))]
    image, point = np.repeat([0, 1], 8), np.tile(np.arange(8), 2)
    return Network(
        (cameras[0].lens,),
        tuple(Pose(camera.rotation, camera.position_mm) for camera in cameras),
        np.array([0, 0]),
        control_mm.copy(),
        image,
        point,
        np.concatenate([camera.project(control_mm) for camera in cameras]),
        datum=True,
    )


NAMES = [f"P{number}" for number in range(8)]


def test_a_free_network_of_two_images_is_fine(network: Network) -> None:
    check_network(network, NAMES)


def test_a_point_seen_once_is_named(network: Network) -> None:
    keep = np.ones(16, dtype=bool)
    keep[[8 + 2, 8 + 5]] = False
    once = replace(network, image=network.image[keep], point=network.point[keep], image_px=network.image_px[keep])
    with pytest.raises(DataError, match="not fixed: P2, P5"):
        check_network(once, NAMES)
    known = np.full((8, 3), np.inf)
    known[[2, 5]] = 0.1
    check_network(replace(once, control_sd=known), NAMES)


def test_an_image_of_two_points_is_named(network: Network) -> None:
    keep = np.concatenate([np.ones(8, dtype=bool), np.arange(8) < 2])
    few = replace(network, image=network.image[keep], point=network.point[keep], image_px=network.image_px[keep])
    with pytest.raises(DataError, match="image 2 shows only 2 points"):
        check_network(replace(few, control_sd=np.full((8, 3), 0.1)), NAMES)


def test_something_must_say_where_and_how_large_the_object_is(network: Network) -> None:
    with pytest.raises(DataError, match="neither control points nor a free network"):
        check_network(replace(network, datum=False), NAMES)
    known = np.full((8, 3), np.inf)
    known[:2] = 0.1
    with pytest.raises(DataError, match="neither control"):
        check_network(replace(network, datum=False, control_sd=known), NAMES)
    bar = (ScaleBar(0, 1, 100.0, 0.1),)
    check_network(replace(network, datum=False, control_sd=known, bars=bar), NAMES)


def test_defaults_are_of_the_right_shape(network: Network) -> None:
    assert network.weights.shape == (16,)
    assert np.all(np.isinf(network.survey_sd))
    assert [len(columns) for columns in network.interior_columns] == [0]
    mask = np.zeros(9, dtype=bool)
    mask[[0, 4]] = True
    assert replace(network, free_interior=(mask,)).interior_columns[0].tolist() == [0, 4]
    np.testing.assert_allclose(replace(network, sd_px=0.5).weights, 4.0)
