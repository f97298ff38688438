"""What SUMO's own collision detection sees at a junction, against the rectangles."""

from __future__ import annotations

import itertools
import multiprocessing

import numpy as np
import pytest

from sumo_env.contacts.rectangles import separation
from sumo_env.networks.mapping import network
from sumo_env.tasks import get_task
from sumo_env.traffic.drivers import vehicle_type
from tests.sumo_env.scenarios import drivers

PAIRS = 500
STEP = 0.1  # [s]
LONGEST = 60  # steps


def cross() -> list[tuple[float, bool]]:
    """Deepest overlap [m] of the outlines of pairs of vehicles that cross, and whether SUMO reported them.

    They drive on random ways across the intersection at constant speeds. Runs in a process of its own, because libsumo
    supports one simulation per process.
    """
    from sumo_env.sumo.session import ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES, Session
    from sumo_env.sumo.settings import placed_settings

    task, net = get_task("intersection"), network("intersection")
    attributes = vehicle_type(drivers("intersection", 0.0)[0], task.calibration)
    session = Session()
    settings = placed_settings(net.net_file, net.routes.items(), STEP, [("car", attributes)])
    rng = np.random.default_rng(1)
    arms = list(itertools.permutations(range(4), 2))
    results = []
    for _ in range(PAIRS):
        if not session.clear(settings):
            session.load(settings)
        for name, arm in zip("ab", arms[rng.integers(len(arms))], strict=True):
            goal = (arm + rng.integers(1, 4)) % 4
            speed = rng.uniform(5.0, 9.0)
            lane = (f"o{arm}", f"ir{arm}", 0)
            place = net.place(lane, net.road.lane(lane).length - 2.0 * speed + rng.uniform(-3, 3), f"o{goal}")
            modes = ALL_CHECKS_OFF, COMMANDED_LANE_CHANGES
            session.add(name, place[0], "car", *place[1:], speed, 10.0, modes)
            session.vehicle.setSpeed(name, speed)
        overlap, reported = -np.inf, False
        for _ in range(LONGEST):
            reported |= bool(session.step())
            states = session.read("ab")
            overlap = max(overlap, -separation(states["a"], states["b"]))
        results.append((overlap, reported))
    session.close()
    return results


@pytest.mark.long
def test_sumo_reports_every_contact_at_a_junction() -> None:
    """All but grazes of a few millimetres. Of this version of SUMO; every day test_recall.py counts what is noticed."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        results = pool.apply(cross)
    contacts = [(overlap, reported) for overlap, reported in results if overlap > 0.0]
    assert len(contacts) > 100
    assert max((overlap for overlap, reported in contacts if not reported), default=0.0) < 0.02
