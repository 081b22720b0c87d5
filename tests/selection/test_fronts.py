"""Pareto fronts of points made by hand."""

from __future__ import annotations

import math

import pytest

from hts.selection.fronts import crowding, dominates, gain_product, layers, most_even, non_dominated, spread, towards

NAN, INF = math.nan, math.inf


def test_a_point_dominates_if_it_is_nowhere_worse_and_somewhere_better():
    assert dominates((1, 2), (1, 1)) and dominates((2, 2), (1, 1))
    assert not dominates((2, 0), (1, 1)) and not dominates((1, 1), (2, 0))
    assert not dominates((1, 1), (1, 1))


def test_the_front_holds_what_nothing_beats_in_the_order_given():
    # (1, 1) is beaten by (2, 2); (3, 0) and (0, 3) are the ends.
    assert non_dominated([(1, 1), (0, 3), (2, 2), (3, 0), (2, 1)]) == [1, 2, 3]


def test_equal_points_are_all_on_the_front_or_none_is():
    assert non_dominated([(1, 2), (2, 1), (1, 2)]) == [0, 1, 2]
    assert non_dominated([(1, 2), (1, 2), (2, 3)]) == [2]


def test_a_tie_in_one_number_is_decided_by_the_other():
    assert non_dominated([(1, 2), (1, 3)]) == [1]


def test_a_point_with_a_nan_is_on_no_front_and_hides_nobody():
    assert non_dominated([(NAN, 9), (1, 1), (9, NAN)]) == [1]
    assert non_dominated([(NAN, 9)]) == []


def test_infinity_is_a_number_like_others():
    assert non_dominated([(-INF, -INF), (0, 0)]) == [1]
    assert non_dominated([(INF, 0), (0, 0), (0, 1)]) == [0, 2]


def test_no_points_have_no_front():
    assert (non_dominated([]), layers([]), crowding([])) == ([], [], [])


def test_in_one_number_the_front_is_the_largest_one():
    assert non_dominated([(1,), (3,), (2,)]) == [1]
    assert layers([(1,), (3,), (2,)]) == [[1], [2], [0]]


def test_three_numbers_are_compared_each():
    assert non_dominated([(1, 1, 1), (1, 1, 2), (2, 0, 0), (0, 0, 2)]) == [1, 2]


def test_layers_follow_one_behind_the_other_and_unknown_points_come_last():
    points = [(0, 0), (2, 0), (NAN, 9), (0, 2), (1, 0), (0, 1)]
    assert layers(points) == [[1, 3], [4, 5], [0], [2]]


def test_crowding_is_the_distance_of_the_neighbours_as_a_share_of_the_spread():
    # Spreads are 4 and 40. The middle point's neighbours are 4 and 40 apart: 1 + 1; (1, 30): 3/4 + 30/40.
    points = [(0, 40), (1, 30), (3, 10), (4, 0)]
    assert crowding(points) == [INF, 3 / 4 + 30 / 40, 3 / 4 + 30 / 40, INF]
    savings = [(x / 100, y / 1000) for x, y in points]  # in another unit the spreads are 0.04 and 0.04
    assert crowding(savings) == pytest.approx(crowding(points))


def test_a_number_in_which_all_are_equal_gives_no_room():
    assert crowding([(1, 5), (2, 5), (3, 5)]) == [INF, 1.0, INF]


def test_few_points_of_a_front_keep_its_ends_and_lose_the_dense_stretch():
    # Three points lie close together at 5; of them one has to be left, the ends stay.
    points = [(0, 10), (4.9, 5.1), (5, 5), (5.1, 4.9), (10, 0)]
    assert spread(points, 2) == [0, 4]
    kept = spread(points, 3)
    assert {0, 4} < set(kept) and len(set(kept) & {1, 2, 3}) == 1


def test_a_dense_stretch_is_thinned_and_not_emptied():
    # All at once the two lowest distances are those of the pair at 5, and both would leave: a hole in the middle.
    points = [(0, 10), (2, 8), (5, 5), (5.1, 4.9), (8, 2), (10, 0)]
    alone = crowding(points)
    assert max(alone[2], alone[3]) < min(alone[1], alone[4])
    assert len(set(spread(points, 4)) & {2, 3}) == 1


def test_as_many_as_there_are_stay_and_none_of_none():
    assert spread([(0, 1), (1, 0)], 2) == [0, 1]
    assert spread([(0, 1), (1, 0)], 5) == [0, 1]
    assert spread([(0, 1), (1, 0)], 0) == []


def test_one_point_of_a_front_is_the_most_even_one():
    # Shares of the spread: (0, 1), (0.6, 0.7), (1, 0): worst are 0, 0.6, 0.
    points = [(0, 10), (60, 7), (100, 0)]
    assert most_even(points) == 1 and spread(points, 1) == [1]


@pytest.mark.parametrize("level", [5, 0, -INF])
def test_a_number_that_tells_nobody_apart_does_not_decide_who_is_most_even(level):
    points = [(0, 10, level), (60, 7, level), (100, 0, level)]
    assert most_even(points) == 1 and spread(points, 1) == [1]
    assert most_even([(0, 10, -INF), (60, 7, 1), (100, 0, 2)]) == 1  # a range without an end has no shares
    assert most_even([(1, 1), (1, 1)]) == 0


def test_the_product_of_gains_is_zero_unless_all_gain():
    assert gain_product((0.1, 3.0)) == pytest.approx(0.3)
    assert (
        gain_product((0.1, 0.0)) == gain_product((0.5, -0.1)) == gain_product((-1, -1)) == gain_product((1, NAN)) == 0
    )


def test_another_unit_does_not_change_whose_product_is_larger():
    even, uneven = (0.1, 2.0), (0.15, 1.0)
    assert gain_product(even) > gain_product(uneven)
    assert gain_product((10, 0.2)) > gain_product((15, 0.1))


def test_weights_are_exponents_and_zero_takes_an_objective_out():
    assert gain_product((3, 2), (2, 1)) == 18
    assert gain_product((3, -1), (1, 0)) == 3
    assert gain_product((3, 2), (0, 0)) == 0


def test_the_point_furthest_in_a_direction_goes_by_shares_of_the_range():
    points = [(0, 0), (0.20, 1), (0.16, 3), (0.02, 4)]  # shares: 0 0, 1 0.25, 0.8 0.75, 0.1 1
    assert towards(points, (5, 0)) == 1
    assert towards(points, (0, 0.5)) == 3
    assert towards(points, (1, 1)) == 2


def test_where_nobody_gains_in_a_direction_the_way_starts_from_the_reference():
    assert towards([(0, 0), (0.1, -1)], (0, 1)) == 0
    assert towards([(0, 0)], (1, 1)) == 0


def test_equally_far_in_a_direction_goes_to_the_larger_sum():
    assert towards([(0, 5), (1, 5), (2, 0)], (0, 1)) == 1
