"""Two publishers of one topic are noticed by the numbers of what they send."""

import itertools

import pytest

from plate_core.publisher_monitor import PublisherMonitor


def two_detected(numbers, period=0.1):
    monitor = PublisherMonitor()
    for k, number in enumerate(numbers):
        monitor.accepts(number, k * period)
    return monitor.has_two(period * len(numbers))


@pytest.mark.parametrize("ahead", [-40, -1, 0, 1, 40])
def test_two_alternating_publishers_are_detected(ahead):
    pairs = ((50 + k, 50 + k + ahead) for k in range(8))
    assert two_detected([*itertools.chain.from_iterable(pairs)])


@pytest.mark.parametrize("period", [0.1, 0.5])
def test_detection_of_a_second_publisher_that_is_much_slower(period):
    assert two_detected([k if k % 3 else 900 + k // 3 for k in range(1, 12)], period) is (
        period == 0.1
    )


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
def test_a_single_publisher_is_not_reported(numbers):
    assert not two_detected(list(numbers))


def test_a_second_publisher_is_no_longer_reported_after_its_end():
    monitor = PublisherMonitor()
    for k in range(10):
        monitor.accepts(k // 2, 0.1 * k)
    assert monitor.has_two(1.0)
    for k in range(40):
        monitor.accepts(5 + k, 1.0 + 0.1 * k)
    assert not monitor.has_two(5.0)


def accepted(*arrivals):
    """Whether each message, given by number and time, is accepted."""
    monitor = PublisherMonitor()
    return [monitor.accepts(number, at) for number, at in arrivals]


def test_messages_of_a_second_publisher_are_not_accepted():
    ours = (7, 0.0), (8, 0.5), (10, 1.5), (11, 1.6)
    assert accepted(*ours) == [True] * 4
    strangers = (1, 0.6), (2, 0.6), (3, 0.6), (500, 0.7), (501, 0.7)
    assert accepted(*ours[:2], *strangers, *ours[2:]) == [True] * 2 + [False] * 5 + [True] * 2


def test_a_new_publisher_replaces_a_silent_publisher():
    assert accepted((7, 0.0), (8, 0.5), (1, 1.4), (2, 1.9), (3, 2.4)) == [
        True,
        True,
        False,
        True,
        True,
    ]
