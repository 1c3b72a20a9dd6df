"""The eye against references that share no code with it, on random scenes: brute force for distances, MuJoCo for depth."""

import functools

import numpy as np
import pytest
from eye_caster import check_raster
from eye_exact import check
from eye_random import name_of, scene

from hrc.vision.camera import Camera

SCENES = range(224)
FULL_SIZE = (2, 7, 10, 17, 22, 28, 46)
"""Scenes for the camera of 512 x 424 pixels."""


@functools.cache
def outcome(number):
    return check(scene(number))


@functools.cache
def sight(number, expanded):
    margins = np.random.default_rng(number).uniform(0.0, 0.06, 8) if expanded else None
    return check_raster(scene(number), margins)


@pytest.mark.parametrize("number", SCENES, ids=name_of)
def test_distances_are_those_of_brute_force(number):
    """Foreground, distance map and the minimum of every link."""
    outcome(number)


@pytest.mark.parametrize("number", FULL_SIZE, ids=name_of)
def test_distances_are_those_of_brute_force_at_full_size(number):
    assert check(scene(number, Camera()), pairs=1e7).coverage > 0


@pytest.mark.parametrize("number", SCENES, ids=name_of)
def test_the_virtual_depth_is_that_of_a_ray_caster(number):
    """The true surface, and in every second scene the expanded one."""
    sight(number, False)
    if number % 2:
        sight(number, True)


@pytest.mark.parametrize("number", FULL_SIZE, ids=name_of)
def test_the_virtual_depth_is_that_of_a_ray_caster_at_full_size(number):
    assert check_raster(scene(number, Camera())).pixels > 0


def test_the_scenes_span_what_they_should():
    """A comparison is worth what it compares."""
    outcomes, scenes = [outcome(i) for i in SCENES], [scene(i) for i in SCENES]
    within = [o for o in outcomes if o.within_reach > 0]
    assert len(within) >= 120
    assert min(o.coverage for o in within) < 0.002
    assert max(o.coverage for o in within) > 0.4
    assert sum(o.coverage == 0 for o in outcomes) >= 3
    assert sum(o.compared == 0 for o in outcomes) >= 10
    assert {0.0, 0.12, 1e6} <= {s.thickness for s in scenes}
    reaches = [s.config.reach for s in scenes]
    assert min(reaches) < 0.022
    assert max(reaches) > 0.38


def test_few_pixels_are_ambiguous_and_many_triangles_cross_the_near_plane():
    sights = [sight(i, False) for i in SCENES] + [sight(i, True) for i in SCENES[1::2]]
    pixels = sum(s.pixels for s in sights)
    assert pixels > 300_000
    assert sum(s.ambiguous for s in sights) <= 1e-5 * pixels
    assert sum(s.cut > 0 for s in sights) >= 20
