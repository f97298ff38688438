"""What each policy step is paid of an ego's way through a network of a user's own."""


class Progress:
    """The metres that were driven in a policy step, as a share of the whole way as it then stands (driven and left).

    A step in which SUMO changes the route is paid its metres like any other. Where the route stays the same, the shares
    add up to 1: the way through a junction is some metres longer on one lane than on another, so that a step is paid
    its part of what has not been paid yet.
    """

    def __init__(self, route: str) -> None:
        """route: SUMO's id of it, which is another one when the route has changed."""
        self._route = route  # at the start of the policy step
        self._unpaid = 1.0  # share of the way, likewise
        self._driven = self._metres = 0.0  # [m] since the agent took over, and in this policy step
        self._has_agent = False

    def drive(self, metres: float) -> None:
        """Note metres that were driven."""
        self._driven += metres
        self._metres += metres

    def share(self, route: str, left: float) -> float:
        """Of the policy step so far, on this route and with so many metres left."""
        if route != self._route:
            return _part(self._metres, self._driven + left)
        return self._unpaid * _part(self._metres, self._metres + left)

    def begin_step(self, paid: float, route: str, left: float) -> None:
        """A policy step begins, with the first of which the agent takes over; paid: the share of the one before."""
        if self._has_agent:
            self._unpaid -= paid
        else:
            self._has_agent, self._driven = True, 0.0
        if route != self._route:
            self._unpaid = _part(left, self._driven + left)
        self._route, self._metres = route, 0.0


def _part(metres: float, whole: float) -> float:
    return metres / whole if whole > 0.0 else 1.0
