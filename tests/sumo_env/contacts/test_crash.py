"""The record of a crash, and how SUMO's reports and the geometry are joined."""

import dataclasses
import math

import numpy as np
import pytest

from sumo_env.contacts.crash import CrashDetector, CrashRecord, classify, crash_record, is_confirmed
from sumo_env.scene import Scene

from .shapes import CAR, state


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((4.9, 0.3, 0.1), "rear-end"),
        ((-4.9, 0.3, -0.1), "rear-end"),
        ((1.0, 1.9, 0.05), "side"),
        ((3.0, -1.8, 2 * math.pi - 0.2), "side"),
        ((4.8, 0.5, math.pi), "frontal"),
        ((4.8, 0.5, -3.0), "frontal"),
        ((3.4, 0.0, math.pi / 2), "junction"),
        ((2.0, 2.0, -math.pi / 2), "junction"),
    ],
)
def test_types_of_crash(pose, expected) -> None:
    assert classify(*pose) == expected


def test_record_is_in_the_frame_of_the_ego() -> None:
    scene = Scene(
        ids=("ego", "v3"),
        x=np.array([10.0, 10.0]),
        y=np.array([20.0, 16.0]),
        speed=np.array([12.0, 5.0]),
        heading=np.array([-math.pi / 2, math.pi]),
        crashed=np.array([True, True]),
        time=3.2,
    )
    record = crash_record(scene, 1, "both")
    assert (record.other, record.time, record.x, record.y) == ("v3", 3.2, 10.0, 20.0)
    assert (record.relative_x, record.relative_y) == pytest.approx((4.0, 0.0))
    assert record.relative_heading == pytest.approx(-math.pi / 2)
    assert record.closing_speed == pytest.approx(13.0)  # 12 m/s north against 5 m/s west
    assert (record.type, record.detected_by) == ("junction", "both")


IDS = ("ego", "v0", "v1")
FAR = state(100.0, 0.0)


def look(detector, before, after, reported=(), time=2.0, halves=(CAR,) * 3) -> CrashRecord | None:
    """One sub-step of 0.1 s in which the ego drives from x = 0 to x = 2 m."""
    first, last = [state(0.0, 0.0, 0.0, 20.0), *before], [state(2.0, 0.0, 0.0, 20.0), *after]
    return detector.detect(time, 0.1, IDS[: len(first)], first, last, reported, halves[: len(first)])


def test_the_geometry_alone_makes_a_crash_of_the_moment_of_the_touch() -> None:
    standing = [FAR, state(6.0, 0.0)]
    crash = look(CrashDetector(), standing, standing)
    assert (crash.other, crash.detected_by, crash.type) == ("v1", "geometry", "rear-end")
    assert crash.time == pytest.approx(1.95)  # 1 m between the bumpers at 20 m/s
    assert (crash.x, crash.relative_x, crash.closing_speed) == pytest.approx((1.0, 5.0, 20.0))


@pytest.mark.parametrize("gap, counts", [(0.0, True), (0.09, True), (0.11, False), (50.0, False)])
def test_a_report_of_sumo_alone_counts_within_a_tenth_of_a_metre(gap: float, counts: bool) -> None:
    """Of a car beside the ego, and of a lorry of 12 m by 2.5 m across its way."""
    across = [state(2.0 + 2.5 + 1.251 + gap, 0.0, math.pi / 2)]
    lorry = look(CrashDetector(), across, across, {"v0"}, halves=((2.5, 1.0), (6.0, 1.25)))
    assert (lorry is not None) == counts
    beside = [FAR, state(2.0, 2.001 + gap)]
    assert is_confirmed(state(2.0, 0.0), beside[1]) == counts
    crash = look(CrashDetector(), beside, beside, reported={"v1"})
    assert (crash is not None) == counts
    if crash is not None:
        assert (crash.other, crash.detected_by, crash.type, crash.time) == ("v1", "sumo", "side", 2.0)


def test_who_is_not_near_does_not_count_reported_or_not() -> None:
    assert look(CrashDetector(), [FAR, FAR], [FAR, FAR]) is None
    beside = [state(2.0, 2.05), FAR]
    assert look(CrashDetector(), beside, beside, reported={"v7", "v1"}) is None


def test_both_may_see_a_crash_in_the_same_sub_step_or_one_later() -> None:
    standing = [FAR, state(6.0, 0.0)]
    same = look(CrashDetector(), standing, standing, reported={"v1"})
    assert same.detected_by == "both"

    sumo_first = CrashDetector()
    nearly = [FAR, state(8.0, 0.0)]
    assert look(sumo_first, nearly, nearly, reported={"v1"}) is None  # still a metre apart
    crash = look(sumo_first, standing, standing)
    assert crash.detected_by == "both"

    geometry_first = CrashDetector()
    crash = look(geometry_first, standing, standing)
    assert crash.detected_by == "geometry"
    assert look(geometry_first, standing, standing, reported={"v0"}) == crash  # another vehicle
    later = look(geometry_first, standing, standing, reported={"v1"}, time=2.1)
    assert later == geometry_first.crash == dataclasses.replace(crash, detected_by="both")


def test_the_first_contact_of_an_episode_stays() -> None:
    detector = CrashDetector()
    crash = look(detector, [FAR, state(6.0, 0.0)], [FAR, state(6.0, 0.0)])
    assert look(detector, [state(5.5, 0.0), FAR], [state(5.5, 0.0), FAR], {"v0"}, time=2.1) == crash
