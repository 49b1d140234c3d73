"""Before a camera at rest, where pictures differ, something moves."""

import numpy as np
from wave_pictures import HEIGHT, WIDTH, Warp, wave_picture

from ttcvid.stages.tracking.changes import changed_places

BOX = np.s_[40:70, 50:80]


def noisy(picture, sigma_grey, seed):
    noise = np.random.default_rng(seed).normal(0.0, sigma_grey, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def with_box(picture, grey):
    picture = picture.copy()
    picture[BOX] = grey
    return picture


def test_what_has_come_is_a_changed_place_and_the_rest_is_none_whatever_the_noise():
    street = wave_picture()
    for sigma_grey in (0.0, 4.0):
        before, now = noisy(street, sigma_grey, 0), noisy(with_box(street, 250), sigma_grey, 1)
        changed = changed_places(before, now) > 0
        assert changed[BOX].mean() > 0.9
        far = np.ones_like(changed)
        far[30:80, 40:90] = False
        assert not changed[far].any()


def test_pictures_that_differ_by_noise_have_no_changed_place():
    street = wave_picture()
    assert not changed_places(noisy(street, 3.0, 0), noisy(street, 3.0, 1)).any()


def test_where_most_of_a_picture_changes_nothing_is_said():
    street = wave_picture()
    assert changed_places(street, wave_picture(Warp(shift_px=(6.0, 0.0)))) is None
    assert changed_places(street, np.full((HEIGHT, WIDTH), 20, np.uint8)) is None
