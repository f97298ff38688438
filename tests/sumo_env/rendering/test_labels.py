"""Words beside cars."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from sumo_env.rendering.labels import Box, beside

PICTURE = Box(0.0, 0.0, 280.0, 200.0)
SIZE = 60.0, 20.0  # [px] of a word
CAR = 24.0, 10.0  # [px]
CORNER = Box(0.0, 0.0, 180.0, 26.0)  # where the time and the speed stand
REACH = 18.0  # [px] of a ring


@pytest.mark.parametrize("seed", range(40))
def test_words_cover_neither_the_ego_nor_each_other_and_are_not_cut_off(seed: int) -> None:
    """Of cars in a jam around the ego, which is where they would."""
    rng = np.random.default_rng(seed)
    others = rng.uniform((80.0, 50.0), (200.0, 150.0), (rng.integers(1, 6), 2)).tolist()
    middles = [(140.0, 100.0), *((x, y) for x, y in others)]
    cars = [Box.around(x, y, *CAR) for x, y in middles]
    words = [CORNER]
    for middle in middles[1:]:
        words.append(beside(middle, REACH, SIZE, PICTURE, words, cars))
    for one, other in combinations((cars[0], *words), 2):
        assert one.common(other) == 0.0
    for word in words:
        assert word.common(PICTURE) == pytest.approx((word.right - word.left) * (word.bottom - word.top))


def test_a_word_stands_above_its_car_where_there_is_room_else_below_else_beside() -> None:
    ego, alone = Box.around(20.0, 100.0, *CAR), (140.0, 100.0)
    above = Box.around(140.0, 100.0 - REACH - 10.0, *SIZE)
    below = Box.around(140.0, 100.0 + REACH + 10.0, *SIZE)
    right = Box.around(140.0 + REACH + 30.0, 100.0, *SIZE)
    for number, place in enumerate((above, below, right)):
        assert beside(alone, REACH, SIZE, PICTURE, (above, below)[:number], [ego]) == place
