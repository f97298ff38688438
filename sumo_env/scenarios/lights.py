"""Traffic lights on the ego's way: how an ego that obeys them drives, and which ones it runs."""

from collections.abc import Sequence
from math import inf, sqrt

from sumo_env.scene import RED, YELLOW, Light
from sumo_env.sumo.session import ALL_CHECKS_OFF, REGULAR, Session

REACHED = 0.1  # [m] how exactly SUMO says where a stop line is
# [m/s2] usual and hardest braking before traffic lights; where one would need more than its own, the ego drives on
BRAKING, HARDEST = 4.0, 9.0
STOPS_FOR = {RED: 8.0, YELLOW: 5.0}
STOP_DISTANCE = 1.0  # [m] from its front to the stop line
ATTENTION = 1.0  # [s] before it would have to brake, SUMO decides about a stop at a light that allows to turn


class LightsAhead:
    """The lights on the way of one ego."""

    def __init__(self, session: Session, name: str) -> None:
        self._session, self._name = session, name
        self.run = 0  # red lights that it has run in this policy step
        self._signals: Sequence[tuple[str, int, float, str]] = ()

    def look(self) -> None:
        """Note the lights ahead before a step of SUMO."""
        self._signals = self._session.vehicle.getNextTLS(self._name)

    def pass_lines(self, metres: float) -> None:
        """Count the red lights whose stop lines are within these metres [m], which it has driven.

        A sign that lets vehicles turn after a stop does not forbid to drive.
        """
        for signal, connection, distance, _ in self._signals:
            if distance <= metres + REACHED:
                state = self._session.sumo.trafficlight.getRedYellowGreenState(signal)
                self.run += state[connection] in "ru"

    def allowed(self, speed: float, dt: float) -> tuple[float, int]:
        """Highest speed [m/s] after `dt` [s] of an ego that obeys all lights, and the speed mode in which it is driven.

        At a light that lets vehicles turn after a stop, SUMO stops and gives way.
        """
        least, mode = inf, ALL_CHECKS_OFF
        for light in self._session.lights(self._name):
            if not light.lets_turn:
                least = min(least, speed_before(light, speed, dt))
            elif light.distance < STOP_DISTANCE + speed * ATTENTION + speed * speed / (2.0 * BRAKING):
                mode = REGULAR
        return least, mode


def speed_before(light: Light, speed: float, dt: float) -> float:
    """Highest speed [m/s] after `dt` [s] of a vehicle that stops at a light; inf where it need not or no longer can."""
    if light.state not in STOPS_FOR or speed * speed > 2.0 * STOPS_FOR[light.state] * light.distance:
        return inf
    room = max(light.distance - STOP_DISTANCE, 0.0)
    return max(sqrt(2.0 * BRAKING * room), speed - HARDEST * dt)
