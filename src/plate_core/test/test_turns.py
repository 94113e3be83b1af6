"""Two publishers of one topic are noticed by the numbers of what they send."""

import itertools

import pytest

from plate_core.turns import Turns


def heard(numbers, period=0.1):
    turns = Turns()
    for k, number in enumerate(numbers):
        turns.came(number, k * period)
    return turns.several(period * len(numbers))


@pytest.mark.parametrize("ahead", [-40, -1, 0, 1, 40])
def test_two_that_take_turns(ahead):
    pairs = ((50 + k, 50 + k + ahead) for k in range(8))
    assert heard([*itertools.chain.from_iterable(pairs)])


@pytest.mark.parametrize("period", [0.1, 0.5])
def test_one_that_is_much_slower(period):
    assert heard([k if k % 3 else 900 + k // 3 for k in range(1, 12)], period) is (period == 0.1)


@pytest.mark.parametrize(
    "numbers",
    [
        range(100),
        [*range(50), *range(50)],  # it was started again
        [*range(5), *range(5), *range(50)],  # twice
        [k * k for k in range(20)],  # some were lost
        [None] * 20,  # the middleware has none
    ],
)
def test_one_alone(numbers):
    assert not heard(list(numbers))


def test_it_is_over_once_one_has_ended():
    turns = Turns()
    for k in range(10):
        turns.came(k // 2, 0.1 * k)
    assert turns.several(1.0)
    for k in range(40):
        turns.came(5 + k, 1.0 + 0.1 * k)
    assert not turns.several(5.0)


def test_a_single_message_of_a_stranger_does_not_follow():
    turns = Turns()
    came = [(7, True), (8, True), (1, False), (9, True), (10, True), (500, False), (11, True)]
    assert [(number, turns.came(number, 0.0)) for number, _ in came] == came


def test_another_publisher_may_take_the_place_of_one_that_is_gone():
    turns = Turns()
    came = [(7, True), (8, True), (1, False), (2, True), (3, True), (5, False), (6, True)]
    assert [(number, turns.came(number, 0.0)) for number, _ in came] == came
